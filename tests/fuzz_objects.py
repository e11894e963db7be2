"""Hypothesis strategies for fuzzed arguments: legal and malformed surfaces, meshes, lights, cameras and results."""

import contextlib
import dataclasses
import decimal
import fractions
import functools
import math
import warnings
from types import SimpleNamespace

import numpy as np
import trimesh
from hypothesis import strategies as st

import warpdiff as wd
from warpdiff.request.settings import TANGENT_RULES

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
    """Return a plan (method, number of wavelengths and so on) for one direction, which is made without a kernel."""
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
ANYTHING = [
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
NUMBERS = st.one_of(st.floats(), _POWERS_OF_TEN, st.integers(-(10**30), 10**30), st.floats(0.0, 10.0))
# Random counts for fuzzing. Small counts are computed quickly; large ones must be refused.
COUNTS = st.one_of(st.integers(-3, 9), st.integers(17, 70).map(lambda k: 2**k), st.floats(-3.0, 10.0))
_ROWS = st.lists(st.lists(NUMBERS, max_size=4), max_size=4)
_VECTORS = st.one_of(st.lists(NUMBERS, min_size=3, max_size=3), st.lists(NUMBERS, max_size=4), _ROWS)
TEXTS = st.one_of(st.text(max_size=8), st.sampled_from(["auto", "averaged", "D65", "FL11", "cpu", "cuda:9", "Au"]))
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
    """Return a trapezoidal grating profile, which has few parameters."""
    return wd.profiles.Trapezoid(0.1, 0.5, 0.02, 1.0)


def measured():
    """Return measured efficiencies of five diffraction orders of a grating."""
    return wd.Measured.orders(
        (0.2, 0.0, 1.0), 300.0, [(0, m) for m in (-2, -1, 0, 1, 2)], [0.001, 0.01, 0.02, 0.01, 0.001]
    )


@functools.cache
def fitted():
    """Return the result of a fit of a grating profile to measured order efficiencies."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        return wd.fit(trapezoid(), measured(), sd=0.01, starts=1)


@functools.cache
def designed():
    """Return the result of an inverse design: heights that reflect light into two given orders."""
    return wd.design(wd.profiles.Pixels(0.2, np.zeros((1, 8))), [orders_target()], starts=1)


def orders_target():
    """Return the target of a design: equal power in two diffraction orders."""
    return wd.Target.equal([(0, -1), (0, 1)], UP, 500.0)


PERIOD = wd.Period(2.0, 0.01, 0.0, (0.1,), 1.0, (0.0, 0.5), is_coherent=True)

# Hypothesis strategies for arguments that are objects, by argument name.
OBJECTS = {
    "topography": st.sampled_from(_TOPOGRAPHIES),
    "heightfield": _one_of(_heightfields), "mesh": _one_of(malformed_meshes), "view": _one_of(_views),
    "coherence": _one_of(_coherences), "plan": _one_of(_plans), "shots": st.lists(_one_of(_shots), max_size=3),
    "lobes": _one_of(lambda: [lobes()]), "illuminant": TEXTS, "heights_um": _HEIGHTS,
    "pitch_um": st.one_of(NUMBERS, _VECTORS), "progress": st.just("bad"), "client": st.just("bad"),
    "previews": st.sampled_from([{1e-3: print}, {0.5: None}, {math.nan: print}, {HUGE: print}, {"x": print}, {}]),
    "lights": _one_of(_lights),
    **dict.fromkeys(("exposure_from", "renderer"), _one_of(lambda: [picture(), renderer()])),
    **dict.fromkeys(("material", "film"), _one_of(_materials)),
    **dict.fromkeys(("image", "reference"), _one_of(lambda: [picture(), picture().xyz, np.ones((2, 3, 3)), []])),
    **dict.fromkeys(("path", "folder", "animation", "compare"), _PATHS),
    **dict.fromkeys(("to_light", "to_view", "wavelengths_nm", "scattering_vectors", "angle_deg"), _VECTORS),
    **dict.fromkeys(("eye", "target", "up", "direction", "sun_direction", "background"), _VECTORS),
    "tangents": st.one_of(_VECTORS, st.sampled_from([*TANGENT_RULES, "radial"])),
    **dict.fromkeys(("n", "k", "values", "errors", "radiance_rgb", "pixels", "xyz"), _VECTORS),
    **dict.fromkeys(("theta_deg", "phi_deg", "angles_deg", "sigmas_um"), _VECTORS),
    "columns": st.dictionaries(TEXTS, _VECTORS),
    "efficiencies": _one_of(lambda: [efficiencies(), picture(), {(0, 1): 0.01}, {(0, 1): math.nan}, {1: 1}]),
    "labels": st.lists(TEXTS, max_size=2),
    "source": _one_of(lambda: [picture(), picture().xyz, [500.0], np.ones((2, 3)), HEIGHTFIELD.periods(), PERIOD]),
    "ax": st.builds(axes), "profile": _one_of(lambda: [trapezoid()]), "surface": _one_of(_heightfields),
    "measured": _one_of(lambda: [measured()]), **dict.fromkeys(("orders", "reflectances", "sd"), _VECTORS),
    **dict.fromkeys(("evaluate", "loss"), st.just("bad")),
    "targets": _one_of(lambda: [orders_target(), [orders_target()], [], ["x"], None]),
    "levels": st.one_of(COUNTS, _VECTORS), "dose": _VECTORS,
    "cell": _one_of(_heightfields), **dict.fromkeys(("first", "second"), _HEIGHTS), "eyes": _VECTORS,
    **dict.fromkeys(("turn_deg", "depth_scale", "pitch_scale"), st.one_of(NUMBERS, _VECTORS)),
    **dict.fromkeys(("depth_scales", "edge_widths_um", "tilts_deg", "least_feature_um"), _VECTORS),
    "wrt": st.sampled_from([("heights_um",), ("to_light", "ior"), ("duty",), ("x",), "heights_um", (), [1], (None,)]),
}  # fmt: skip
