"""Every public callable with one or two fuzzed arguments computes a result, or refuses an argument by its name."""

import contextlib
import re
import signal
import warnings
from collections.abc import Sequence
from pathlib import Path

import fuzz
import numpy as np
import pytest
import trimesh
import warp as wp
from endurance import examples, seconds_left
from fuzz import FUZZED_OWNERS, PUBLIC, call
from hypothesis import given
from hypothesis import strategies as st

import warpdiff as wd

resource = pytest.importorskip("resource", reason="memory limits require POSIX")

# Public functions that need seconds even with valid arguments.
SLOW = {"bake", "bake_spectrum", "export_html", "BakedLobes.cartesian", "gratings.fingers", "report"}
# Time limit of a call of a fuzzed function in seconds, including the compilation of kernels. A longer call counts as
# hanging.
MOST_S = 60
# Memory limit of a call of a fuzzed function in bytes, above the process's memory. Small calls need less, and calls
# that require much memory fail.
MOST_MORE_BYTES = 1 << 30


# Class of each argument that is an object. The function may refuse the object because of one of its fields, so the
# message may name a field of this class.
PARTS_OF = {
    "heightfield": "HeightField", "coherence": "Coherence", "light": "DirectionalLight", "lights": "DirectionalLight",
    "view": "View", "direction": "View", "plan": "Plan", "self": "HeightField",
}  # fmt: skip


def strategies_of(name):
    """Return Hypothesis strategies for the arguments of a public callable, and for ``self`` of methods to fuzz."""
    function, owner = PUBLIC[name]
    strategies = {option.name: fuzz.strategy(option) for option in fuzz.options_of(function)}
    return strategies | ({"self": fuzz.OBJECTS[FUZZED_OWNERS[owner]]} if owner in FUZZED_OWNERS else {})


# For each class of results of public functions, a function that lists the arrays of numbers in a result.
NUMBERS_OF = {
    np.ndarray: lambda array: [array] if array.dtype.kind == "f" else [], wp.array: lambda array: [array.numpy()],
    (float, np.floating): lambda number: [np.array(number)],
    wd.HeightField: lambda field: [field.heights_um[~field.missing],
                                   *map(np.array, (field.pitch_um, field.height_range_um, field.rms_um)),
                                   np.array([field.rms_slope, field.mean_slope])],
    wd.Image: lambda image: [image.xyz, image.error, image.coverage],
    wd.OrderEfficiencies: lambda orders: [orders.efficiencies], wd.ReflectanceSpectra: lambda spectra: [spectra.values],
    wd.Fit: lambda fit: [fit.values, fit.residuals], wd.Measured: lambda measured: [measured.values],
    wd.Design: lambda result: [result.parameters, result.achieved["achieved"]],
    wd.Target: lambda target: [target.to_light],
    wd.adjoint.Linearised: lambda linearised: [linearised.value],
    wd.Table: lambda table: [column for column in table.columns.values() if column.dtype.kind == "f"],
    trimesh.Trimesh: lambda mesh: [mesh.vertices.view(np.ndarray), mesh.vertex_normals, mesh.visual.uv],
    wd.BakedLobes: lambda lobes: [lobes.functions, lobes.zeroth, lobes.coefficients],
    wd.BakedSpectrum: lambda spectrum: [spectrum.powers, spectrum.functions, spectrum.zeroth],
    wd.Renderer: lambda renderer: numbers_of(renderer.image()), str: lambda _: [],
    Sequence: lambda items: [array for item in items for array in numbers_of(item)],
}  # fmt: skip


def numbers_of(result):
    """Return all numbers that a result contains, as a list of arrays."""
    return next((numbers(result) for kind, numbers in NUMBERS_OF.items() if isinstance(result, kind)), [])


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    """Change to a temporary folder with the files that valid arguments refer to."""
    monkeypatch.chdir(tmp_path)
    fuzz.write_files(tmp_path)


@contextlib.contextmanager
def no_hang():
    """Fail the test if the code in the ``with`` block exceeds the time limit."""
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail(f"the call exceeds {MOST_S} s"))
    signal.alarm(MOST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def little_memory():
    """Limit the memory of the process in the ``with`` block, on systems that report the memory in use."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(statm.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MORE_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_fuzzed_functions_include_methods_and_functions_of_submodules():
    assert {"shade", "plan", "Coherence", "gratings.disc", "meshes.snake", "HeightField.load"} <= set(PUBLIC)


def check(name, fuzzed):
    """Check that a call of ``name`` returns finite numbers, or raises an error that names one of its arguments."""
    message, names = "", {name.rpartition(".")[2], *strategies_of(name)}
    with warnings.catch_warnings(), little_memory(), no_hang():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = call(name, fuzzed)
        except MemoryError as error:
            message, names = str(error), {"are free: take"}
        except (ValueError, TypeError, OSError) as error:
            message = str(error)
        except (ImportError, RuntimeError):
            # Only ``register_mitsuba_bsdf`` may raise other errors, because Mitsuba may not be installed or not be set
            # up.
            if name != "register_mitsuba_bsdf":
                raise
        else:
            assert all(np.isfinite(array).all() for array in numbers_of(result))
    names |= {part for key in names & set(PARTS_OF) for part in strategies_of(PARTS_OF[key])}
    names |= {"heightfield"} & {FUZZED_OWNERS.get(PUBLIC[name][1])}
    assert not message or re.search(rf"\b({'|'.join(names)})\b", message), message


@pytest.mark.permanent("fuzzed arguments (extreme or invalid values)", shares=3)
@pytest.mark.parametrize("name", [name for name in PUBLIC if strategies_of(name)])
def test_fuzzed_arguments_are_refused_by_name_or_computed(name, tries):
    strategies = strategies_of(name)
    one_or_two = st.lists(st.sampled_from(list(strategies)), min_size=1, max_size=2, unique=True)

    @examples(*((1, 50) if name in SLOW else (3, 500)))
    @given(st.data())
    def attempt(data):
        # Each example that Hypothesis makes calls the function three times, with other random arguments each time. This
        # saves time, because making an example takes longer than most calls.
        for _ in range(3):
            fuzzed = {key: data.draw(strategies[key]) for key in data.draw(one_or_two)}
            # Hypothesis continues to draw examples (random arguments) after the time limit, so late examples are
            # skipped.
            if seconds_left():
                tries.number += 1
                check(name, fuzzed)

    attempt()
