"""Fuzzed arguments: Hypothesis strategies for all options, and calls of every public function with them."""

import ast
import contextlib
import dataclasses
import decimal
import doctest
import fractions
import functools
import inspect
import math
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import trimesh
from conftest import public_members
from hypothesis import strategies as st

import warpdiff as wd
from warpdiff.core.options import SPELLINGS, Option, describe
from warpdiff.lights.base import Light
from warpdiff.request.settings import TANGENT_RULES, SinglePictureSettings

UP = (0.0, 0.0, 1.0)
HEIGHTFIELD = wd.gratings.sinusoidal(1.0, 0.1)
LIGHT = wd.DirectionalLight((0.1, 0.2, 1.0))
VIEW = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), width=4, height=3)
MESH = wd.meshes.disc(segments=8, rings=1)
SHORT = wd.Coherence(sigma_um=3.0)
HUGE, TINY = 1e300, 1e-300


# Objects that require compiled kernels are created on first use, because every test process imports this file.
@functools.cache
def plan() -> wd.Plan:
    return wd.plan(HEIGHTFIELD, coherence=SHORT, tolerance=0.1)


@functools.cache
def picture() -> wd.Image:
    return wd.reflectance_map(HEIGHTFIELD, UP, size=4, plan=plan())


@functools.cache
def lobes() -> wd.BakedLobes:
    return wd.bake(HEIGHTFIELD, coherence=wd.Coherence(sigma_um=1.0), delta_e=10.0)


def axes():
    """Return new axes of matplotlib, without a window."""
    from matplotlib.figure import Figure

    return Figure().add_subplot()


@functools.cache
def simple_plan() -> wd.Plan:
    """Return a plan for one direction, which needs no kernel."""
    return wd.plan(HEIGHTFIELD, UP, UP, coherence=SHORT)


@functools.cache
def still() -> wd.Image:
    """Return a picture that needs no kernel."""
    grey, all_pixels = np.full((2, 3), 0.5, np.float32), np.ones((2, 3), dtype=bool)
    return wd.Image(np.ones((2, 3, 3), np.float32), all_pixels, all_pixels, 2.0 * grey, grey, None)


@functools.cache
def efficiencies() -> wd.OrderEfficiencies:
    return wd.order_efficiencies(HEIGHTFIELD, UP, [400.0, 500.0])


@functools.cache
def renderer() -> wd.Renderer:
    return wd.Renderer(MESH, HEIGHTFIELD, LIGHT, VIEW, plan=plan())


# Values of arbitrary types for fuzzing, most of which most arguments reject.
_ANYTHING = [
    *(None, ..., "", "bad", "a\0b", "\ud800", b"bytes", True, False, object(), object, len),
    *([], (), {}, set(), [[]], [None], ["x"], [[1, 2], [3]], {"a": 1}, range(3), iter([1.0]), slice(2)),
    *(0, -1, 1, 3, 10**9, 2**31, 2**63, 10**400, -(10**400)),
    *(math.nan, math.inf, -math.inf, 0.0, -0.0, 0.5, 5e-324, TINY, HUGE, -HUGE, 1j),
    *(decimal.Decimal("0.1"), fractions.Fraction(1, 3), np.float64(math.nan), np.float32(1.0), np.int8(-3)),
    *(np.bool_(1), np.ma.masked, np.datetime64("NaT"), np.str_("x"), np.array(3.0), np.array([None, 1.0])),
    *(np.zeros(0), np.zeros((2, 0)), np.zeros((2, 2, 2)), np.full((3, 3), math.nan), np.array([1j, 2.0])),
    *(np.ma.masked_all((4, 4)), np.array([math.inf] * 3), np.array([HUGE] * 3), np.array([TINY] * 3)),
    *((0.0, 0.0), (1.0, -1.0), (1, 2, 3), (math.nan,) * 3, (HUGE, HUGE), (TINY, TINY), (HUGE, TINY, -HUGE)),
    *(np.array([(1, 2.0)], dtype=[("a", int), ("b", float)]), np.array(["2020"], dtype="datetime64")),
]
_POWERS_OF_TEN = st.integers(-320, 308).map(lambda k: float(f"1e{k}"))
_NUMBERS = st.one_of(st.floats(), _POWERS_OF_TEN, st.integers(-(10**30), 10**30), st.floats(0.0, 10.0))
# Random counts for fuzzing. Small counts are computed quickly; large ones must be refused.
_COUNTS = st.one_of(st.integers(-3, 9), st.integers(17, 70).map(lambda k: 2**k), st.floats(-3.0, 10.0))
_ROWS = st.lists(st.lists(_NUMBERS, max_size=4), max_size=4)
_VECTORS = st.one_of(st.lists(_NUMBERS, min_size=3, max_size=3), st.lists(_NUMBERS, max_size=4), _ROWS)
_TEXTS = st.one_of(st.text(max_size=8), st.sampled_from(["auto", "averaged", "D65", "FL11", "cpu", "cuda:9", "Au"]))
_PATHS = st.sampled_from([
    *("", ".", "/", "..", "a\0b.png", "\ud800.png", "no/such/a.png", "x" * 5000 + ".png", "a.jpg", ".png", "-"),
    *("/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "/dev/full/a.png", "https://127.0.0.1:9/a.png"),
    *("new/one", "a.npy"),
])  # fmt: skip
_HEIGHTS = st.one_of(
    _ROWS,
    st.tuples(st.sampled_from([TINY, 1.0, 1e150, HUGE]), st.sampled_from([(1, 1), (1, 9), (7, 5), (0, 3)])).map(
        lambda drawn: drawn[0] * np.arange(math.prod(drawn[1]), dtype=float).reshape(drawn[1])
    ),
)


def _heightfields():
    """Yield valid height fields, including extreme heights and pitches."""
    with np.errstate(all="ignore"):
        waves = np.sin(np.arange(12.0))[None, :] + np.cos(np.arange(9.0))[:, None]
        make = wd.HeightField.of_known_scale
        yield make([[0.0]], 1.0)
        yield make([[math.nan, 1.0]], 1.0)
        for scale in (TINY, 1e-20, 1e-3, 100.0, 1e14):
            yield make(scale * waves, 0.05)
        for pitch in (1e-15, 1e-4, 50.0, 1e15, (1e-15, 1e15)):
            yield make(0.05 * waves, pitch)
        yield make(0.05 * waves + 1e9, 0.05)
        yield make(np.where(waves > 1.0, math.nan, 0.05 * waves), 0.05)


def _variants(base, **values):
    """Yield copies of an object with one field changed, for each given value of each given field."""
    for name, alternatives in values.items():
        for value in alternatives:
            yield dataclasses.replace(base, **{name: value})


def _lights():
    yield from _variants(
        LIGHT, power=(0.0, 5e-324, TINY, 1e-30, 1e12), to_light=((0, 0, -1), (1, 0, 0), (HUGE, 0, 1), (TINY, 0, TINY)),
        illuminant=("nothing", wd.Spectrum([380.0, 780.0], [TINY, 1.0])), angular_diameter_deg=(1e-15, 1e-3, 5.0, 60.0),
    )  # fmt: skip
    yield wd.Environment([[[0.0, 1.0, TINY]] * 2, [[-1.0, 0.0, 1e9]] * 2], directions=16)
    for position in ((0, 0, 0), (HUGE, 0, 0), (0, TINY, -TINY), (0.1, 0, 0.5), (1e15, -1e15, 1e15)):
        with contextlib.suppress(ValueError):
            yield wd.PointLight(position)
    yield (LIGHT, None)
    yield [LIGHT] * 3


def _views():
    yield from _variants(
        VIEW, eye=[(0.0, scale, 5.0 * scale) for scale in (TINY, 1e-30, 1e-3, 1e3, 1e14)],
        fov_y_deg=(1e-15, 1e-9, 179.999999), extent_y=(1e-15, 1e-9, 1e15),
    )  # fmt: skip
    yield dataclasses.replace(VIEW, eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, 1.0))
    yield dataclasses.replace(VIEW, width=46340, height=46340)


def _shots():
    for view in (VIEW, dataclasses.replace(VIEW, width=5), dataclasses.replace(VIEW, eye=(0.0, 0.0, 1e14))):
        yield wd.Shot((LIGHT,), view)
    yield wd.Shot((LIGHT, wd.PointLight((0.0, 1.0, 2.0)), LIGHT), VIEW)
    yield wd.Shot((dataclasses.replace(LIGHT, power=0.0),), VIEW)


MOST_PERIODS = wd.Coherence("replicas", periods=(1, 100_000))


def _coherences():
    for sigma in (1e-15, 0.1, 1e3, 1e15):
        yield wd.Coherence(sigma_um=sigma)
        yield wd.Coherence("centred", sigma_um=sigma)
    for centre in (1e6, 1e15, -1e15):
        yield wd.Coherence("centred", centre_um=(centre, 0.0))
    for diameter in (1e-15, 1e-9, 30.0):
        yield wd.Coherence("source", angular_diameter_deg=diameter)
    yield MOST_PERIODS
    yield wd.Coherence("replicas", periods=(100, 100))


def malformed_meshes():
    """Yield invalid meshes: zero area, extreme sizes, vertex indices or texture coordinates out of range."""
    triangle, face = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2]]
    for scale in (5e-324, TINY, 1e-30, 1e30, HUGE, math.nan):
        with np.errstate(all="ignore"):
            yield _textured(scale * triangle, face)
    yield _textured(np.zeros((3, 3)), face)
    for faces in ([[0, 0, 0]], [[0, 1, 9]], [[0, -1, 2]]):
        yield _textured(triangle, faces)
    for uv in (0.0, math.nan, HUGE, TINY):
        yield _textured(triangle, face, uv * triangle[:, :2])
    yield trimesh.Trimesh(triangle, face, process=False)
    yield trimesh.Trimesh()
    yield trimesh.Scene()
    yield trimesh.PointCloud(triangle)


def _textured(vertices, faces, uv=((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))):
    visual = trimesh.visual.TextureVisuals(uv=np.array(uv))
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)


def _plans():
    return _variants(
        plan(), terms=(1, 128), wavelengths=(0, 2, 3, 65_536), least_weight=(5e-324, TINY, 0.999999),
        bandwidth_um=((0.0, 0.0, TINY), (1e15,) * 3), max_uv=(0.0, 2.0), height_range_um=(0.0, 1e15),
        coherence=[wd.Coherence("centred")],
    )  # fmt: skip


def _materials():
    yield wd.Material.metal("Au")
    yield wd.Material([400.0, 600.0], 1.5)
    for n, k in ((1e-3, 0.0), (100.0, 100.0), (1.0, 0.0), (0.5, 0.0), (1e-3, 100.0)):
        yield wd.Material([500.0], n, k)
    yield wd.Material.dielectric(1.5).coated(wd.Material([500.0], 100.0, 100.0), 1000.0)
    yield {"": wd.Material.metal("Al")}
    yield {"body": wd.Material.metal("Al")}


def _one_of(make):
    return st.deferred(lambda: st.sampled_from(list(make())))


def topography(**changes) -> SimpleNamespace:
    """Return a stand-in for a height map of the library SurfaceTopography. ``changes`` replaces its attributes."""
    known = {"heights": lambda: np.zeros((3, 2)), "physical_sizes": (3.0, 2.0), "unit": "um", "dim": 2}
    return SimpleNamespace(**known | changes)


_TOPOGRAPHIES = [
    topography(), topography(unit="V"), topography(unit=None), topography(dim=1), topography(physical_sizes=None),
    topography(physical_sizes=(0.0, math.nan)), topography(heights=lambda: np.zeros(3)), "scan.sur",
]  # fmt: skip


def trapezoid():
    """Return a profile with few parameters."""
    return wd.profiles.Trapezoid(0.1, 0.5, 0.02, 1.0)


def measured():
    """Return measured efficiencies of a grating."""
    return wd.Measured.orders(
        (0.2, 0.0, 1.0), 300.0, [(0, m) for m in (-2, -1, 0, 1, 2)], [0.001, 0.01, 0.02, 0.01, 0.001]
    )


@functools.cache
def fitted():
    """Return the result of a fit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        return wd.fit(trapezoid(), measured(), sd=0.01, starts=1)


@functools.cache
def designed():
    """Return the result of a design."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        return wd.design(wd.profiles.Pixels(0.5, np.zeros((1, 4))), [orders_target()], starts=1)


def orders_target():
    """Return a target of two orders."""
    return wd.Target.equal([(0, -1), (0, 1)], UP, 500.0)


# Hypothesis strategies for arguments that are objects, by argument name.
OBJECTS = {
    "topography": st.sampled_from(_TOPOGRAPHIES),
    "heightfield": _one_of(_heightfields), "mesh": _one_of(malformed_meshes), "view": _one_of(_views),
    "coherence": _one_of(_coherences), "plan": _one_of(_plans), "shots": st.lists(_one_of(_shots), max_size=3),
    "lobes": _one_of(lambda: [lobes()]), "illuminant": _TEXTS, "heights_um": _HEIGHTS,
    "pitch_um": st.one_of(_NUMBERS, _VECTORS), "progress": st.just("bad"), "client": st.just("bad"),
    "previews": st.sampled_from([{1e-3: print}, {0.5: None}, {math.nan: print}, {HUGE: print}, {"x": print}, {}]),
    **dict.fromkeys(("light", "lights"), _one_of(_lights)),
    **dict.fromkeys(("exposure_from", "renderer"), _one_of(lambda: [picture(), renderer()])),
    **dict.fromkeys(("material", "film"), _one_of(_materials)),
    **dict.fromkeys(("image", "reference"), _one_of(lambda: [picture(), picture().xyz, np.ones((2, 3, 3)), []])),
    **dict.fromkeys(("path", "folder", "animation", "compare"), _PATHS),
    **dict.fromkeys(("to_light", "to_view", "wavelengths_nm", "scattering_vectors", "angle_deg"), _VECTORS),
    **dict.fromkeys(("eye", "target", "up", "direction", "sun_direction", "background"), _VECTORS),
    "tangents": st.one_of(_VECTORS, st.sampled_from([*TANGENT_RULES, "radial"])),
    **dict.fromkeys(("n", "k", "values", "errors", "radiance_rgb", "pixels", "xyz"), _VECTORS),
    **dict.fromkeys(("theta_deg", "phi_deg", "angles_deg", "sigmas_um"), _VECTORS),
    "columns": st.dictionaries(_TEXTS, _VECTORS),
    "efficiencies": _one_of(lambda: [efficiencies(), picture(), {(0, 1): 0.01}, {(0, 1): math.nan}, {1: 1}]),
    "labels": st.lists(_TEXTS, max_size=2),
    "source": _one_of(lambda: [picture(), picture().xyz, [500.0], np.ones((2, 3)), HEIGHTFIELD.periods(), PERIOD]),
    "ax": _one_of(lambda: [axes()]), "profile": _one_of(lambda: [trapezoid()]), "surface": _one_of(_heightfields),
    "measured": _one_of(lambda: [measured()]), **dict.fromkeys(("orders", "reflectances", "sd"), _VECTORS),
    **dict.fromkeys(("evaluate", "loss"), st.just("bad")),
    "targets": _one_of(lambda: [orders_target(), [orders_target()], [], ["x"], None]),
    "levels": st.one_of(_COUNTS, _VECTORS), "dose": _VECTORS,
    **dict.fromkeys(("depth_scales", "edge_widths_um", "tilts_deg", "least_feature_um"), _VECTORS),
    "wrt": st.sampled_from([("heights_um",), ("to_light", "ior"), ("duty",), ("x",), "heights_um", (), [1], (None,)]),
}  # fmt: skip
_SETTINGS = describe(SinglePictureSettings)


def options_of(function) -> list[Option]:
    """Return the options of a public callable, including the settings that it shares with other functions."""
    return [
        _SETTINGS.get(name, option) if option.kind == "object" else option
        for name, option in describe(function).items()
    ]


def strategy(option: Option) -> st.SearchStrategy:
    """Return a Hypothesis strategy for the values of one option.

    Raises:
        KeyError: ``OBJECTS`` has no strategy for an object of this name.
    """
    # Fuzzed values of ``progress`` are never callable, because an error in the caller's own function would look like a
    # refusal of an argument.
    anything = [value for value in _ANYTHING if option.name != "progress" or not callable(value)]
    return st.one_of(st.sampled_from(anything), *[_of_its_kind(option)] * 2)


def _of_its_kind(option: Option) -> st.SearchStrategy:
    """Return a strategy for values of the type that an option expects, including extreme values and its limits."""
    simple = {
        "flag": st.sampled_from([0, 1, "yes", "no", np.bool_(0), True, False]),
        "choice": st.sampled_from([*option.choices, *SPELLINGS, "x"]),
        "choices": st.lists(
            st.sampled_from(
                [*option.choices, *(f"{name}.{k}" for name in option.indexed for k in (0, 9)), "x", 1, None]
            ),
            max_size=3,
        ),
        "text": _TEXTS,
    }
    if option.kind == "object":
        return OBJECTS[option.name]
    if option.kind in simple:
        return simple[option.kind]
    one = _COUNTS if option.kind.startswith("integer") else _NUMBERS
    # Counts at their upper limit are legal but slow. Therefore only the next larger count is tested, which must be
    # refused.
    steps = {option.gt: (0, 1), option.ge: (-1, 0), option.le: (1,) if one is _COUNTS else (0, 1)}
    limits = [bound + step for bound in steps if bound not in (None, math.inf) for step in steps[bound]]
    one = st.one_of(one, st.sampled_from(limits)) if limits else one
    if option.kind in ("integer", "number"):
        return one
    length = option.length or 2
    pairs = st.one_of(st.lists(one, min_size=length, max_size=length), st.lists(one, max_size=4))
    return st.one_of(one, pairs) if option.kind == "pair" else pairs


PERIOD = wd.Period(2.0, 0.01, 0.0, (0.1,), 1.0, (0.0, 0.5), is_coherent=True)
WAVY = wd.HeightField(0.05 * np.sin(np.arange(120.0)).reshape(1, -1) + np.zeros((8, 1)), 0.1)
# Classes that only the library creates are not fuzzed. Errors and warnings are excluded because they accept any text.
MADE_BY_THE_LIBRARY = {"BakedLobes", "BakedSpectrum", "Comparison", "Image", "OrderEfficiencies", "Period"}
MADE_BY_THE_LIBRARY |= {"Periods", "ReflectanceSpectra", "Report", "Roughness", "ScanReport", "ToleranceError"}
MADE_BY_THE_LIBRARY |= {"WarpdiffWarning", "Fit", "Measured", "Minimum", "Design", "Target", "RigorousEfficiencies"}
# Methods that only the renderer calls are not fuzzed, because their arguments are already checked.
CALLED_BY_PICTURES = {"lobes", "parts"}
# Objects on which methods are called, by class. Methods of the classes in ``FUZZED_OWNERS`` are also called on fuzzed
# objects of these classes.
OWNERS = {
    "Environment": lambda: wd.Environment(np.ones((2, 4, 3)), directions=16),
    "Material": lambda: wd.Material.metal("Au"), "Spectrum": lambda: wd.Spectrum.blackbody(3000.0),
    "HeightField": lambda: WAVY, "Image": picture, "Plan": plan, "Renderer": renderer, "View": lambda: VIEW,
    "BakedLobes": lobes, "Comparison": lambda: wd.compare(np.ones((2, 3, 3)), np.ones((2, 3, 3)), tolerance=0.1),
    "OrderEfficiencies": efficiencies, "Periods": lambda: wd.Periods([PERIOD]),
    "RigorousEfficiencies": lambda: wd.RigorousEfficiencies(
        np.array([500.0]), np.eye(3)[2], np.zeros((1, 2), dtype=int), np.eye(3)[2].reshape(1, 1, 3),
        *(np.ones((1, 1)) for _ in range(3)), np.array([8]), np.array([0.0]), np.array([True]),
    ),
    "Roughness": WAVY.roughness, "Fit": fitted, "Measured": measured, "Design": designed,
    "Table": lambda: wd.Table({"number": [1.0]}),
    "ReflectanceSpectra": lambda: wd.ReflectanceSpectra(np.ones(1), np.eye(3)[2:], np.eye(3)[2:], np.ones((1, 1))),
    "BakedSpectrum": functools.cache(lambda: wd.bake_spectrum(HEIGHTFIELD, coherence=SHORT, size=16, tolerance=0.1)),
}  # fmt: skip
FUZZED_OWNERS = {"HeightField": "heightfield", "View": "view"}
# Legal values for arguments that are not fuzzed in a call. ``LEGAL_OF`` overrides them for single functions.
LEGAL = {
    "heightfield": HEIGHTFIELD, "mesh": MESH, "light": LIGHT, "lights": LIGHT, "view": VIEW, "to_light": UP,
    "to_view": UP, "wavelengths_nm": [500.0], "coherence": SHORT, "eye": (0.0, 0.0, 5.0), "target": (0.0, 0.0, 0.0),
    "extent_y": 1.0, "period_um": 1.0, "depth_um": 0.1, "path": Path("a.npy"), "heights_um": [[0.0, 0.1], [0.1, 0.0]],
    "pitch_um": 0.1, "size": 4, "tolerance": 0.1, "scale_rows": 5, "ventrals": 8, "segments": 3, "rings": 1,
    "segments_along": 12, "segments_around": 3, "shots": [wd.Shot((LIGHT,), VIEW)], "folder": "frames",
    "scattering_vectors": [[0.1, 0.2, -1.5]], "radiance_rgb": np.ones((2, 4, 3)), "directions": 16,
    "topography": topography(), "xyz": [0.1, 0.2, 0.3], "theta_deg": 30.0, "columns": {"number": [1.0]},
    "position": (0.0, 0.0, 2.0), "delta_e": 10.0, "n": 1.5, "angle_deg": 30.0, "sun_direction": (1.0, 1.0, 0.0),
}  # fmt: skip
LEGAL_OF = {
    "gratings.fingers": {"size_um": 6.4}, "HeightField.cropped": {"size_um": 0.5}, "Image.save": {"path": "a.png"},
    "export_html": {"path": "a.html"}, "BakedLobes.save": {"path": "a.npz"}, "BakedSpectrum.save": {"path": "a.npz"},
    "HeightField.save": {"path": "a.npz"}, "Plan.save": {"path": "a.json"}, "Plan.load": {"path": "plan.json"},
    "bake_spectrum": {"size": 16}, "Environment.load": {"path": "sky.exr"},
    "HeightField.load": {"path": "integers.npy", "height_range_um": 0.3},
    "compare": {"image": np.ones((2, 3, 3)), "reference": np.ones((2, 3, 3))},
    "Spectrum": {"wavelengths_nm": [300.0, 900.0], "values": [1.0, 2.0]},
    "Material.coated": {"film": wd.Material.dielectric(1.4), "thickness_nm": 100.0},
}  # fmt: skip
LEGAL_OF |= {
    f"{name}.save": {"path": "a.csv"}
    for name in ("OrderEfficiencies", "Periods", "ReflectanceSpectra", "RigorousEfficiencies", "Roughness", "Table")
}
LEGAL_OF |= {
    "order_angles": {"source": PERIOD}, "plot.colour_strip": {"source": np.ones((2, 3)), "angles_deg": [0.0, 10.0]},
    "plot.spectra": {"source": [500.0], "values": [0.5]},
}  # fmt: skip
LEGAL_OF |= {
    "Measured.orders": {"orders": [(0, 1)], "efficiencies": [0.1]}, "Measured.spectra": {"reflectances": [0.1]},
    "Measured.colours": {"xyz": [[0.1, 0.2, 0.3]]}, "Measured.from_csv": {"path": "orders.csv"},
    "Measured.predict": {"surface": HEIGHTFIELD}, "fit": {"sd": 0.1, "starts": 1},
    "adjoint.objective": {"evaluate": print, "loss": print},
    "Target.orders": {"efficiencies": {(0, 1): 0.01}, "wavelength_nm": 500.0},
    "Target.equal": {"orders": [(0, 1)], "wavelength_nm": 500.0}, "design": {"starts": 1},
    "measure_layout": {"path": "foil.gds"},
    "rigorous_order_efficiencies": {"heightfield": wd.gratings.lamellar(1.0, 0.1, samples=8), "layers": 1},
}  # fmt: skip
LEGAL_BY_CALL = {"renderer": renderer, "lobes": lobes, "ax": axes, "efficiencies": efficiencies}
# Functions that make a legal value of an argument for each call. The values are those of single functions, and override
# ``LEGAL_BY_CALL``.
LEGAL_OF_BY_CALL = {
    "fit": {"profile": trapezoid, "measured": measured},
    "design": {"profile": lambda: wd.profiles.Pixels(0.5, np.zeros((1, 4))), "targets": lambda: [orders_target()]},
    "adjoint.objective": {"profile": trapezoid},
    "plot.plan": {"plan": simple_plan}, "plot.error_image": {"image": still}, "plot.reflectance_map": {"source": still},
}  # fmt: skip


def write_files(folder: Path) -> None:
    """Write the files that the legal arguments refer to."""
    np.save(folder / "a.npy", WAVY.heights_um)
    np.save(folder / "integers.npy", np.arange(96, dtype=np.uint8).reshape(8, 12))
    np.save(folder / "gaps.npy", [[0.0, math.nan]])
    plan().save(folder / "plan.json")
    efficiencies().save(folder / "orders.csv")
    sky = oiio.ImageOutput.create(str(folder / "sky.exr"))
    sky.open(str(folder / "sky.exr"), oiio.ImageSpec(4, 2, 3, "float"))
    sky.write_image(np.ones((2, 4, 3), np.float32))
    sky.close()


def public():
    """Yield the name, the callable and the owning class (or None) of every public function, class and method."""
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
            for key, value in public_members(member).items():
                is_public = key not in CALLED_BY_PICTURES
                if is_public and (inspect.isfunction(value) or isinstance(value, classmethod)):
                    yield f"{name}.{key}", getattr(member, key), None if isinstance(value, classmethod) else name


PUBLIC = {name: (function, owner) for name, function, owner in public()}


def example_of(function):
    """Return the arguments with which the docstring of a class of lights creates its first example."""
    source = "\n".join(example.source for example in doctest.DocTestParser().get_examples(function.__doc__))
    calls = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    first = next(node for node in calls if ast.unparse(node.func) == f"wd.{function.__name__}")
    arguments = [ast.literal_eval(value) for value in first.args]
    named = {keyword.arg: ast.literal_eval(keyword.value) for keyword in first.keywords}
    return inspect.signature(function).bind(*arguments, **named).arguments


def call(name, fuzzed):
    """Call a public function with the fuzzed arguments, and with legal values for all other arguments."""
    function, owner = PUBLIC[name]
    if name == "Plan":
        fuzzed_plan = dataclasses.replace(plan(), **fuzzed)
        return [str(fuzzed_plan), wd.reflectance(HEIGHTFIELD, UP, (0.1, 0.2, 1.0), plan=fuzzed_plan)]
    parameters = inspect.signature(function).parameters
    required = {key for key, parameter in parameters.items() if parameter.default is parameter.empty}
    is_light = inspect.isclass(function) and issubclass(function, Light)
    # Required arguments of a new light have the values of its example.
    arguments = example_of(function) if is_light and not required <= set(LEGAL) else {}
    for key, parameter in parameters.items():
        # Gratings are called with their default arguments instead of the legal values, because the defaults are
        # computed quickly.
        if key in LEGAL and (parameter.default is parameter.empty or not name.startswith("gratings.")):
            arguments[key] = LEGAL[key]
        elif key in LEGAL_BY_CALL and key not in fuzzed:
            arguments[key] = LEGAL_BY_CALL[key]()
    if "plan" in fuzzed:
        arguments.pop("coherence", None)
    if "extent_um" in fuzzed:
        arguments.pop("pitch_um")
    arguments |= LEGAL_OF.get(name, {}) | {key: make() for key, make in LEGAL_OF_BY_CALL.get(name, {}).items()} | fuzzed
    if arguments.get("coherence") is MOST_PERIODS and str(arguments.get("method")) == "direct":
        # The float64 direct sum over 100,000 periods requires a minute per direction, so 100 periods are used instead.
        arguments["coherence"] = wd.Coherence("replicas", periods=(1, 100))
    if owner is None:
        return function(**arguments)
    return function(arguments.pop("self", None) or OWNERS[owner](), **arguments)
