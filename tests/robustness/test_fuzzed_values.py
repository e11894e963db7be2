"""Fuzzed arguments, one and two at a time, of every public callable: computed, or refused by name."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
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
from fuzz import HEIGHTFIELD, LIGHT, MESH, SHORT, UP, VIEW
from hypothesis import given
from hypothesis import strategies as st

import warpdiff as wd

resource = pytest.importorskip("resource", reason="limits of memory are POSIX")

WAVY = wd.HeightField(0.05 * np.sin(np.arange(120.0)).reshape(1, -1) + np.zeros((8, 1)), 0.1)
# The library makes these, not a user; errors and warnings accept any text.
MADE_BY_THE_LIBRARY = {"BakedLobes", "BakedSpectrum", "Image", "OrderEfficiencies", "Period"}
MADE_BY_THE_LIBRARY |= {"ToleranceError", "WarpdiffWarning"}
# ``self`` where it is not fuzzed, by a call, and the arguments whose strategy it takes where it is.
OWNERS = {
    "Environment": lambda: wd.Environment(np.ones((2, 4, 3)), directions=16),
    "Material": lambda: wd.Material.metal("Au"),
    "Spectrum": lambda: wd.Spectrum.blackbody(3000.0),
    "HeightField": lambda: WAVY,
    "Image": fuzz.picture,
    "Renderer": fuzz.renderer,
    "View": lambda: VIEW,
    "BakedLobes": fuzz.lobes,
    "BakedSpectrum": functools.cache(lambda: wd.bake_spectrum(HEIGHTFIELD, coherence=SHORT, size=16, tolerance=0.1)),
}
FUZZED_OWNERS = {"HeightField": "heightfield", "View": "view"}
# Legal arguments that go with a fuzzed one; those of functions override those of all.
LEGAL = {
    "heightfield": HEIGHTFIELD, "mesh": MESH, "light": LIGHT, "lights": LIGHT, "view": VIEW, "to_light": UP,
    "to_view": UP, "wavelengths_nm": [500.0], "coherence": SHORT, "eye": (0.0, 0.0, 5.0), "target": (0.0, 0.0, 0.0),
    "extent_y": 1.0, "period_um": 1.0, "depth_um": 0.1, "path": Path("a.npy"), "heights_um": [[0.0, 0.1], [0.1, 0.0]],
    "pitch_um": 0.1, "size": 4, "tolerance": 0.1, "scale_rows": 5, "ventrals": 8, "segments": 3, "rings": 1,
    "segments_along": 12, "segments_around": 3, "shots": [wd.Shot((LIGHT,), VIEW)], "folder": "frames",
    "scattering_vectors": [[0.1, 0.2, -1.5]], "radiance_rgb": np.ones((2, 4, 3)), "directions": 16,
    "position": (0.0, 0.0, 2.0), "delta_e": 10.0,
}  # fmt: skip
LEGAL_OF = {
    "gratings.fingers": {"size_um": 6.4}, "HeightField.cropped": {"size_um": 0.5}, "Image.save": {"path": "a.png"},
    "export_html": {"path": "a.html"}, "BakedLobes.save": {"path": "a.npz"}, "BakedSpectrum.save": {"path": "a.npz"},
    "HeightField.save": {"path": "a.npz"},
}  # fmt: skip
LEGAL_BY_CALL = {"renderer": fuzz.renderer, "lobes": fuzz.lobes}
# These require seconds by their nature.
SLOW = {"bake", "bake_spectrum", "export_html", "BakedLobes.cartesian", "gratings.fingers"}
# Seconds: a longer call hangs; it may compile kernels.
MOST_S = 60
# Bytes: more than a small call requires, so that large requests fail on every machine.
MOST_MORE_BYTES = 1 << 30


def public():
    """Every public callable by its name: the callable, and the class that it is a method of."""
    for name in wd.__all__:
        member = getattr(wd, name)
        if inspect.ismodule(member):
            own = [key for key, value in vars(member).items() if getattr(value, "__module__", "") == member.__name__]
            for key in getattr(member, "__all__", own):
                if inspect.isfunction(getattr(member, key)) and not key.startswith("_"):
                    yield f"{name}.{key}", getattr(member, key), None
            continue
        if name not in MADE_BY_THE_LIBRARY:
            yield name, member, None
        if inspect.isclass(member):
            for key, value in vars(member).items():
                if not key.startswith("_") and (inspect.isfunction(value) or isinstance(value, classmethod)):
                    yield f"{name}.{key}", getattr(member, key), None if isinstance(value, classmethod) else name


PUBLIC = {name: (function, owner) for name, function, owner in public()}
# A legal argument may be refused for a property of its own.
PARTS_OF = {
    "heightfield": "HeightField", "coherence": "Coherence", "light": "DirectionalLight", "lights": "DirectionalLight",
    "view": "View", "direction": "View", "plan": "Plan", "self": "HeightField",
}  # fmt: skip


def strategies_of(name):
    """Strategies of the arguments of a public callable, ``self`` among them if it is fuzzed."""
    function, owner = PUBLIC[name]
    strategies = {option.name: fuzz.strategy(option) for option in fuzz.options_of(function)}
    return strategies | ({"self": fuzz.OBJECTS[FUZZED_OWNERS[owner]]} if owner in FUZZED_OWNERS else {})


def call(name, fuzzed):
    """Call something public with fuzzed arguments, and legal ones for the rest."""
    function, owner = PUBLIC[name]
    if name == "Plan":
        plan = dataclasses.replace(fuzz.plan(), **fuzzed)
        return [str(plan), wd.reflectance(HEIGHTFIELD, UP, (0.1, 0.2, 1.0), plan=plan)]
    arguments = {}
    for key, parameter in inspect.signature(function).parameters.items():
        # The arguments of gratings that have a default are quick.
        if key in LEGAL and (parameter.default is parameter.empty or not name.startswith("gratings.")):
            arguments[key] = LEGAL[key]
        elif key in LEGAL_BY_CALL and key not in fuzzed:
            arguments[key] = LEGAL_BY_CALL[key]()
    if "plan" in fuzzed:
        arguments.pop("coherence")
    if "extent_um" in fuzzed:
        arguments.pop("pitch_um")
    arguments |= LEGAL_OF.get(name, {}) | fuzzed
    if owner is None:
        return function(**arguments)
    return function(arguments.pop("self", None) or OWNERS[owner](), **arguments)


# Numbers of a result, by its class.
NUMBERS_OF = {
    np.ndarray: lambda array: [array] if array.dtype.kind == "f" else [],
    wp.array: lambda array: [array.numpy()],
    (float, np.floating): lambda number: [np.array(number)],
    wd.HeightField: lambda field: [
        field.heights_um[~field.missing], *map(np.array, (field.pitch_um, field.height_range_um, field.rms_um)),
        np.array([field.rms_slope, field.mean_slope]),
    ],
    wd.Image: lambda image: [image.xyz, image.error, image.coverage],
    wd.OrderEfficiencies: lambda orders: [orders.efficiencies],
    trimesh.Trimesh: lambda mesh: [mesh.vertices.view(np.ndarray), mesh.vertex_normals, mesh.visual.uv],
    wd.BakedLobes: lambda lobes: [lobes.functions, lobes.zeroth, lobes.coefficients],
    wd.BakedSpectrum: lambda spectrum: [spectrum.powers, spectrum.functions, spectrum.zeroth],
    wd.Renderer: lambda renderer: numbers_of(renderer.image()),
    str: lambda _: [],
    Sequence: lambda items: [array for item in items for array in numbers_of(item)],
}  # fmt: skip


def numbers_of(result):
    """All numbers that a result contains."""
    return next((numbers(result) for kind, numbers in NUMBERS_OF.items() if isinstance(result, kind)), [])


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    """A folder with the file that is legal."""
    monkeypatch.chdir(tmp_path)
    np.save(LEGAL["path"], WAVY.heights_um)


@contextlib.contextmanager
def no_hang():
    """Within it, a call that takes too long fails the test."""
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail(f"it takes more than {MOST_S} s"))
    signal.alarm(MOST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def little_memory():
    """Within it, memory is limited, where the system reports how much the process uses."""
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


def test_every_argument_has_a_strategy():
    for name in PUBLIC:
        strategies_of(name)
    assert {"shade", "plan", "Coherence", "gratings.disc", "meshes.snake", "HeightField.load"} <= set(PUBLIC)


def check(name, fuzzed):
    """Call it: it must compute a result of finite numbers, or refuse an argument by name."""
    message, names = (
        "",
        {name.rpartition(".")[2], *strategies_of(name)} | ({"heightfield"} if "self" in fuzzed else set()),
    )
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
            # Mitsuba may not be installed or set up.
            if name != "register_mitsuba_bsdf":
                raise
        else:
            assert all(np.isfinite(array).all() for array in numbers_of(result))
    names |= {part for key in names & set(PARTS_OF) for part in strategies_of(PARTS_OF[key])}
    names |= {"heightfield"} & {FUZZED_OWNERS.get(PUBLIC[name][1])}
    assert not message or re.search(rf"\b({'|'.join(names)})\b", message), message


@pytest.mark.permanent("fuzzed arguments", shares=3)
@pytest.mark.parametrize("name", [name for name in PUBLIC if strategies_of(name)])
def test_fuzzed_arguments_are_refused_by_name_or_computed(name, tries):
    strategies = strategies_of(name)
    one_or_two = st.lists(st.sampled_from(list(strategies)), min_size=1, max_size=2, unique=True)

    @examples(*((3, 50) if name in SLOW else (24, 500)))
    @given(st.data())
    def attempt(data):
        # Hypothesis requires more time for an example than most calls do.
        for _ in range(3):
            fuzzed = {key: data.draw(strategies[key]) for key in data.draw(one_or_two)}
            # Hypothesis draws all examples.
            if seconds_left():
                tries.number += 1
                check(name, fuzzed)

    attempt()
