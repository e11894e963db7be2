"""Evil values, one and two at a time, for every parameter of whatever is public: served, or refused by name."""

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

import numpy as np
import pytest
import trimesh
import warp as wp
from endurance import examples, seconds_left
from fuzz import HF, LIGHT, MESH, SHORT, UP, VIEW, legal_kind, lobes, picture, plan, strategy
from hypothesis import given
from hypothesis import strategies as st

import warpdiff as wd

resource = pytest.importorskip("resource", reason="limits of memory are POSIX")

WAVY = wd.HeightField(0.05 * np.sin(np.arange(120.0)).reshape(1, -1) + np.zeros((8, 1)), 0.1)
# What results are made of is for the library to give; a warning takes any words.
MADE_BY_THE_LIBRARY = {"BakedLobes", "BakedSpectrum", "Image", "OrderEfficiencies", "Period", "WarpdiffWarning"}
# What stands for ``self`` where it is not evil, by a call, and the kind of what is.
OWNERS = {
    "Environment": lambda: wd.Environment(np.ones((2, 4, 3)), directions=16),
    "Material": lambda: wd.Material.metal("Au"),
    "Spectrum": lambda: wd.Spectrum.blackbody(3000.0),
    "HeightField": lambda: WAVY,
    "Image": picture,
    "Renderer": functools.cache(lambda: wd.Renderer(MESH, HF, LIGHT, VIEW, plan=plan())),
    "View": lambda: VIEW,
    "BakedLobes": lobes,
    "BakedSpectrum": functools.cache(lambda: wd.bake_spectrum(HF, coherence=SHORT, size=16, tolerance=0.1)),
}
KIND_OF_OWNER = {"HeightField": "heightfield", "View": "view"}
# Arguments that are legal beside an evil one, and those that take kernels, by a call.
LEGAL = {
    "heightfield": HF, "mesh": MESH, "light": LIGHT, "view": VIEW, "to_light": UP, "to_view": UP, "wavelengths_nm": [500.0],
    "coherence": SHORT, "eye": (0.0, 0.0, 5.0), "target": (0.0, 0.0, 0.0), "extent_y": 1.0, "period_um": 1.0,
    "depth_um": 0.1, "path": Path("a.npy"), "heights_um": [[0.0, 0.1], [0.1, 0.0]], "pitch_um": 0.1, "size": 4,
    "tolerance": 0.1, "extent_um": 1.0, "scale_rows": 5, "ventrals": 8, "segments": 3, "rings": 1, "segments_along": 12,
    "segments_around": 3, "shots": [wd.Shot((LIGHT,), VIEW)], "folder": "frames",
    "scattering_vectors": [[0.1, 0.2, -1.5]],
    "radiance_rgb": np.ones((2, 4, 3)), "directions": 16, "position": (0.0, 0.0, 2.0),
}  # fmt: skip
LEGAL_BY_CALL = {"renderer": OWNERS["Renderer"], "lobes": lobes}
PATHS = {
    "Image.save": "a.png", "export_html": "a.html", "BakedLobes.save": "a.npz", "BakedSpectrum.save": "a.npz",
    "HeightField.save": "a.npz",
}  # fmt: skip
# What takes seconds by its nature.
SLOW = {"bake", "bake_spectrum", "export_html", "BakedLobes.cartesian", "gratings.fingers"}
# Beyond that a call hangs; kernels may be compiled in it.
MOST_S = 60
# More than a small call takes, so that what asks for too much fails wherever the tests run.
MOST_MORE_BYTES = 1 << 30


def public():
    """Everything that a user may call, by its name: a function, and the class that it is a method of."""
    for name in wd.__all__:
        each = getattr(wd, name)
        if inspect.ismodule(each):
            own = [key for key, value in vars(each).items() if getattr(value, "__module__", "") == each.__name__]
            for key in getattr(each, "__all__", own):
                if inspect.isfunction(getattr(each, key)) and not key.startswith("_"):
                    yield f"{name}.{key}", getattr(each, key), None
            continue
        if name not in MADE_BY_THE_LIBRARY:
            yield name, each, None
        if inspect.isclass(each):
            for key, value in vars(each).items():
                if not key.startswith("_") and (inspect.isfunction(value) or isinstance(value, classmethod)):
                    yield f"{name}.{key}", getattr(each, key), None if isinstance(value, classmethod) else name


PUBLIC = {name: (function, owner) for name, function, owner in public()}
# What an argument that is legal in itself may be refused for: by what it is made of.
MADE_OF = {
    "heightfield": "HeightField", "coherence": "Coherence", "light": "DirectionalLight", "view": "View", "plan": "Plan",
    "self": "HeightField",
}  # fmt: skip


def parameters_of(name):
    """The kind of ``self``, if it may be evil, and the names of what else a public callable takes."""
    function, owner = PUBLIC[name]
    names = [key for key in inspect.signature(function).parameters if key != "self"]
    return (["self"] if owner in KIND_OF_OWNER else []), names


def call(name, arguments):
    """Call something public with evil arguments and legal ones beside them."""
    function, owner = PUBLIC[name]
    given_ones = dict(arguments)
    if name == "Plan":
        evil_plan = dataclasses.replace(plan(), **given_ones)
        return [str(evil_plan), wd.reflectance(HF, UP, (0.1, 0.2, 1.0), plan=evil_plan)]
    this = [] if owner is None else [given_ones.pop("self") if "self" in given_ones else OWNERS[owner]()]
    taken = inspect.signature(function).parameters
    # Something must be given, or is of a costly default.
    legal = {key: value for key, value in LEGAL.items() if key in taken}
    legal |= {key: made() for key, made in LEGAL_BY_CALL.items() if key in taken and key not in given_ones}
    if name in PATHS:
        legal["path"] = PATHS[name]
    if name == "bake":
        legal["tolerance"] = 10.0
    if "plan" in given_ones:
        legal.pop("coherence", None)
    if "pitch_um" in given_ones:
        legal.pop("extent_um", None)
    elif name == "HeightField.load":
        legal.pop("pitch_um")
    if name.startswith("gratings."):
        legal = {key: value for key, value in legal.items() if taken[key].default is inspect.Parameter.empty}
    if name == "gratings.fingers":
        legal["size_um"] = 6.4
    positional = [key for key, each in taken.items() if each.kind is each.POSITIONAL_OR_KEYWORD and key != "self"]
    all_of_them = legal | given_ones
    operands = [
        all_of_them.pop(key) for key in positional if key in all_of_them and taken[key].default is taken[key].empty
    ]
    return function(*this, *operands, **all_of_them)


def numbers_of(result):
    """All numbers that a result holds."""
    if isinstance(result, np.ndarray):
        if result.dtype.kind == "f":
            yield result
    elif isinstance(result, wp.array):
        yield result.numpy()
    elif isinstance(result, wd.HeightField):
        yield result.heights_um[~result.missing]
        yield np.array([*result.pitch_um, result.height_range_um, result.rms_um, result.rms_slope, result.mean_slope])
    elif isinstance(result, wd.Image):
        yield from (result.xyz, result.error, result.coverage)
    elif isinstance(result, wd.OrderEfficiencies):
        yield result.efficiencies
    elif isinstance(result, trimesh.Trimesh):
        yield result.vertices.view(np.ndarray)
        yield result.vertex_normals
        yield result.visual.uv
    elif isinstance(result, (float, np.floating)):
        yield np.array(result)
    elif isinstance(result, wd.BakedLobes):
        yield from (result.functions, result.zeroth, result.coefficients)
    elif isinstance(result, wd.BakedSpectrum):
        yield from (result.powers, result.functions, result.zeroth)
    elif isinstance(result, wd.Renderer):
        yield from numbers_of(result.image())
    elif isinstance(result, Sequence) and not isinstance(result, str):
        for each in result:
            yield from numbers_of(each)


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    """With the file that is legal."""
    monkeypatch.chdir(tmp_path)
    np.save(LEGAL["path"], WAVY.heights_um)


@contextlib.contextmanager
def no_hang():
    """Ends the test where a call takes too long."""
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail(f"it takes more than {MOST_S} s"))
    signal.alarm(MOST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def little_memory():
    """A limit, where the system tells what is taken already."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(statm.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MOST_MORE_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_every_parameter_has_evil_values():
    for name in PUBLIC:
        for parameter in parameters_of(name)[1]:
            assert strategy(parameter) is not None
    assert {"shade", "plan", "Coherence", "gratings.disc", "meshes.snake", "HeightField.load"} <= set(PUBLIC)


def check(name, arguments):
    """Call it: it must serve these arguments, or refuse them by name."""
    with warnings.catch_warnings(), little_memory(), no_hang():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        warnings.simplefilter("error", RuntimeWarning)
        try:
            result = call(name, arguments)
        except (ValueError, TypeError, OSError, MemoryError) as error:
            said = error
        except (ImportError, RuntimeError) as error:
            # What is not installed, or not set up, is no argument's fault.
            if name != "register_mitsuba_bsdf":
                raise
            said = ValueError(f"name is right: {error}")
        else:
            assert all(np.isfinite(each).all() for each in numbers_of(result))
            said = None
    if isinstance(said, MemoryError):
        assert "are free: take" in str(said), repr(said)
    elif said is not None:
        own, names = parameters_of(name)
        names = {name.rpartition(".")[2], *own, *names, *(["heightfield"] if own else [])}
        names |= {part for each in names if each in MADE_OF for part in parameters_of(MADE_OF[each])[1]}
        assert re.search(rf"\b({'|'.join(names)})\b", str(said)), repr(said)


@pytest.mark.permanent("evil values", shares=3)
@pytest.mark.parametrize("name", [name for name in PUBLIC if sum(map(len, parameters_of(name)))])
def test_evil_values_are_refused_by_name_or_served(name, tries):
    own, names = parameters_of(name)
    values = {each: strategy(each) for each in names} | {
        each: legal_kind(KIND_OF_OWNER[PUBLIC[name][1]]) for each in own
    }
    one_or_two = st.lists(st.sampled_from(list(values)), min_size=1, max_size=2, unique=True)

    @examples(*((3, 50) if name in SLOW else (24, 500)))
    @given(st.data())
    def attempt(data):
        # What Hypothesis does for each example takes longer than most calls.
        for _ in range(3):
            arguments = {each: data.draw(values[each]) for each in data.draw(one_or_two)}
            # It draws to the end.
            if seconds_left():
                tries.number += 1
                check(name, arguments)

    attempt()
