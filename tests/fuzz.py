"""Values that nobody means, by the kind of parameter that gets them."""

from __future__ import annotations

import contextlib
import dataclasses
import decimal
import fractions
import functools
import math

import numpy as np
import trimesh
from hypothesis import strategies as st

import warpdiff as wd

UP = (0.0, 0.0, 1.0)
HF = wd.gratings.sinusoidal(1.0, 0.1)
LIGHT = wd.DirectionalLight((0.1, 0.2, 1.0))
VIEW = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), width=4, height=3)
MESH = wd.meshes.disc(segments=8, rings=1)
SHORT = wd.Coherence(sigma_um=3.0)
HUGE, TINY = 1e300, 1e-300


# What takes kernels is made where a test asks for it: each process that runs tests imports this file.
@functools.cache
def plan() -> wd.Plan:
    return wd.plan(HF, coherence=SHORT, tolerance=0.1)


@functools.cache
def picture() -> wd.Image:
    return wd.reflectance_map(HF, UP, size=4, plan=plan())


@functools.cache
def lobes() -> wd.BakedLobes:
    return wd.bake(HF, coherence=wd.Coherence(sigma_um=1.0), tolerance=10.0)


# No parameter takes all of these, and most take none.
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
_NUMBERS = st.one_of(st.floats(), _POWERS_OF_TEN, st.integers(-(10**30), 10**30), st.floats(0.0, 10.0))
_COUNTS = st.one_of(st.integers(-3, 40), st.integers(0, 70).map(lambda k: 2**k), st.floats(-3.0, 10.0))
# What is more is refused, and what is less is soon made.
_SEGMENTS = st.one_of(st.integers(-3, 9), st.integers(17, 70).map(lambda k: 2**k), st.floats(-3.0, 10.0))
_ROWS = st.lists(st.lists(_NUMBERS, min_size=0, max_size=4), min_size=0, max_size=4)
_VECTORS = st.one_of(st.lists(_NUMBERS, min_size=3, max_size=3), st.lists(_NUMBERS, max_size=4), _ROWS)
_FLAGS = st.sampled_from([0, 1, "yes", "no", np.bool_(0)])
_METHODS = [
    f"{expansion}{integration}"
    for expansion in ("auto", "low-rank", "power", "taylor", "taylor-uncentred", "jacobi-anger", "direct", "x")
    for integration in ("", "/sampled", "/order-wise", "/table", "/")
]
_NAMES = st.one_of(
    st.text(max_size=8),
    st.sampled_from(
        [
            "AVERAGED",
            "auto",
            "averaged",
            "centred",
            "source",
            "replicas",
            "A",
            "FL11",
            "D66",
            "CD",
            "x",
            "aces",
            "clip",
            "colorimetric",
            "display-p3",
        ]
    ),
)
_PATHS = st.sampled_from(
    [
        *("", ".", "/", "..", "a\0b.png", "\ud800.png", "no/such/a.png", "x" * 5000 + ".png", "a.jpg", ".png", "-"),
        *("/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "/dev/full/a.png", "https://127.0.0.1:9/a.png"),
    ]
)


def _surfaces():
    """Height fields that are legal."""
    with np.errstate(all="ignore"):
        waves = np.sin(np.arange(12.0))[None, :] + np.cos(np.arange(9.0))[:, None]
        of = wd.HeightField.of_known_scale
        yield of([[0.0]], 1.0)
        yield of([[math.nan, 1.0]], 1.0)
        for scale in (TINY, 1e-20, 1e-3, 100.0, 1e14):
            yield of(scale * waves, 0.05)
        for pitch in (1e-15, 1e-4, 50.0, 1e15, (1e-15, 1e15)):
            yield of(0.05 * waves, pitch)
        yield of(0.05 * waves + 1e9, 0.05)
        yield of(np.where(waves > 1.0, math.nan, 0.05 * waves), 0.05)


def _lights():
    for power in (0.0, 5e-324, TINY, 1e-30, 1e12):
        yield dataclasses.replace(LIGHT, power=power)
    for to_light in ((0, 0, -1), (1, 0, 0), (HUGE, 0, 1), (TINY, 0, TINY)):
        yield wd.DirectionalLight(to_light)
    yield dataclasses.replace(LIGHT, illuminant="nothing")
    yield dataclasses.replace(LIGHT, illuminant=wd.Spectrum([380.0, 780.0], [TINY, 1.0]))
    for diameter in (1e-15, 1e-3, 5.0, 60.0):
        yield dataclasses.replace(LIGHT, angular_diameter_deg=diameter)
    yield wd.Environment([[[0.0, 1.0, TINY]] * 2, [[-1.0, 0.0, 1e9]] * 2], directions=16)
    for position in ((0, 0, 0), (HUGE, 0, 0), (0, TINY, -TINY), (0.1, 0, 0.5), (1e15, -1e15, 1e15)):
        with contextlib.suppress(ValueError):
            yield wd.PointLight(position)
    yield (LIGHT, None)
    yield [LIGHT] * 3


def _views():
    for scale in (TINY, 1e-30, 1e-3, 1e3, 1e14):
        yield dataclasses.replace(VIEW, eye=(0.0, scale, 5.0 * scale))
    for fov in (1e-15, 1e-9, 179.999999):
        yield dataclasses.replace(VIEW, fov_y_deg=fov)
    for extent in (1e-15, 1e-9, 1e15):
        yield dataclasses.replace(VIEW, extent_y=extent)
    yield dataclasses.replace(VIEW, eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, 1.0))
    yield dataclasses.replace(VIEW, width=46340, height=46340)


def _shots():
    for view in (dataclasses.replace(VIEW, width=5), dataclasses.replace(VIEW, eye=(0.0, 0.0, 1e14))):
        yield wd.Shot((LIGHT,), view)
    yield wd.Shot((LIGHT,) * 3, VIEW)
    yield wd.Shot((dataclasses.replace(LIGHT, power=0.0),), VIEW)


def _coherences():
    for sigma in (1e-15, 0.1, 1e3, 1e15):
        yield wd.Coherence(sigma_um=sigma)
        yield wd.Coherence("centred", sigma_um=sigma)
    for centre in (1e6, 1e15, -1e15):
        yield wd.Coherence("centred", centre_um=(centre, 0.0))
    for diameter in (1e-15, 1e-9, 30.0):
        yield wd.Coherence("source", angular_diameter_deg=diameter)
    yield wd.Coherence("replicas", periods=(1, 100_000))
    yield wd.Coherence("replicas", periods=(100, 100))


def hostile_meshes():
    """Bodies without an area, of any size, with indices and texture coordinates beyond what is."""
    triangle, face = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2]]
    for scale in (5e-324, TINY, 1e-30, 1e30, HUGE, math.nan):
        with np.errstate(all="ignore"):
            yield _painted(scale * triangle, face)
    yield _painted(np.zeros((3, 3)), face)
    yield _painted(triangle, [[0, 0, 0]])
    yield _painted(triangle, [[0, 1, 9]])
    yield _painted(triangle, [[0, -1, 2]])
    for uv in (0.0, math.nan, HUGE, TINY):
        yield _painted(triangle, face, uv * triangle[:, :2])
    yield trimesh.Trimesh(triangle, face, process=False)
    yield trimesh.Trimesh()
    yield trimesh.Scene()
    yield trimesh.PointCloud(triangle)


def _painted(vertices, faces, uv=None):
    visual = trimesh.visual.TextureVisuals(uv=np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) if uv is None else uv)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)


def _plans():
    for name, values in {
        "terms": (1, 128),
        "wavelengths": (0, 2, 3, 65_536),
        "least_weight": (5e-324, TINY, 0.999999),
        "bandwidth_um": ((0.0, 0.0, TINY), (1e15,) * 3),
        "max_uv": (0.0, 2.0),
        "height_range_um": (0.0, 1e15),
        "coherence": (wd.Coherence("centred"),),
    }.items():
        for value in values:
            yield dataclasses.replace(plan(), **{name: value})


def _materials():
    yield wd.Material.metal("Au")
    yield wd.Material([400.0, 600.0], 1.5)
    for n, k in ((1e-3, 0.0), (100.0, 100.0), (1.0, 0.0), (0.5, 0.0), (1e-3, 100.0)):
        yield wd.Material([500.0], n, k)
    yield wd.Material.dielectric(1.5).coated(wd.Material([500.0], 100.0, 100.0), 1000.0)
    yield {"": wd.Material.metal("Al")}
    yield {"body": wd.Material.metal("Al")}


_HEIGHTS = st.one_of(
    _ROWS,
    st.tuples(st.sampled_from([TINY, 1.0, 1e150, HUGE]), st.sampled_from([(1, 1), (1, 9), (7, 5), (0, 3)])).map(
        lambda each: each[0] * np.arange(math.prod(each[1]), dtype=float).reshape(each[1])
    ),
)
_KINDS = {
    "number": _NUMBERS,
    "count": _COUNTS,
    "segments": _SEGMENTS,
    "vector": _VECTORS,
    "flag": _FLAGS,
    "name": _NAMES,
    "path": _PATHS,
    "method": st.sampled_from(_METHODS),
    "layers": st.lists(st.sampled_from(["normal", "depth", "geometry", "x", 1, None]), max_size=3),
    "heights": _HEIGHTS,
    "surface": st.sampled_from(list(_surfaces())),
    "light": st.sampled_from(list(_lights())),
    "view": st.sampled_from(list(_views())),
    "coherence": st.sampled_from(list(_coherences())),
    "mesh": st.sampled_from(list(hostile_meshes())),
    "plan": st.deferred(lambda: st.sampled_from(list(_plans()))),
    "callback": st.just("bad"),
    "callbacks": st.sampled_from([{1e-3: print}, {0.5: None}, {math.nan: print}, {HUGE: print}, {"x": print}, {}]),
    "shots": st.lists(st.sampled_from([wd.Shot((LIGHT,), VIEW), *_shots()]), max_size=3),
    "formats": st.lists(st.sampled_from([".png", ".exr", ".jpg", "png", 1, None]), max_size=3),
    "folder": st.sampled_from(["", ".", "new/one", "a.npy", "a\0b", "\ud800", "x" * 5000, "/dev/null", "/dev/full/a"]),
    "material": st.sampled_from(list(_materials())),
    "picture": st.deferred(lambda: st.just(picture())),
    "lobes": st.deferred(lambda: st.just(lobes())),
    "rays": st.one_of(st.floats(max_value=3.0), st.sampled_from([math.nan, HUGE, 10**30])),
}
# Every parameter of whatever is public; of a pair of them, either.
KIND_OF = {
    "heightfield": "surface", "mesh": "mesh", "light": "light", "view": "view", "coherence": "coherence", "plan": "plan",
    "heights_um": "heights", "tangents": "vector", "layers": "layers", "path": "path", "method": "method",
    "previews": "callbacks",
    "progress": "callback", "client": "callback", "exposure_from": "picture", "renderer": "picture", "shots": "shots",
    "formats": "formats", "folder": "folder", "animation": "path", "background": "vector", "azimuths_per_width": "rays",
    **dict.fromkeys(["material", "film"], "material"),
    **dict.fromkeys(["n", "k", "values", "radiance_rgb"], "vector"),
    **dict.fromkeys(["symbol", "source", "polarisation", "energy"], "name"),
    **dict.fromkeys(["to_light", "to_view", "wavelengths_nm", "eye", "target", "up", "centre_um", "periods"], "vector"),
    **dict.fromkeys(["bandwidth_um", "errors", "offset_um", "spacing_um", "position"], "vector"),
    **dict.fromkeys(["masking", "strict", "shadows", "smooth", "footprint", "refine", "adaptive", "is_measured"], "flag"),
    **dict.fromkeys(["exact", "overwrite", "lights_follow", "zeroth_order"], "flag"),
    "lobes": "lobes", "scattering_vectors": "vector",
    **dict.fromkeys(["name", "title"], "name"),
    **dict.fromkeys(["illuminant", "device", "kind", "tangent", "display", "gamut", "axis"], "name"),
    **dict.fromkeys(["threads", "size", "samples", "tracks", "seed", "order", "count"], "count"),
    **dict.fromkeys(["bits", "width", "height", "light_sample_count", "quarter_turns"], "count"),
    **dict.fromkeys(["terms", "wavelengths", "subdivisions", "nodes", "functions", "validation_size", "directions"], "count"),
    **dict.fromkeys(["segments", "rings", "segments_along", "segments_around", "scale_rows", "ventrals"], "segments"),
    "samples_per_pixel": "segments",
}  # fmt: skip
_IS_NUMBER = ("_um", "_deg", "_nm", "_y", "_uv", "_w", "_lateral", "_weight", "_error", "_adds", "radius", "length")
_NUMBER_NAMES = {
    "tolerance",
    "ior",
    "pigment",
    "power",
    "exposure",
    "duty",
    "waves",
    "threshold",
    "split",
    "unconverged_share",
}
_NUMBER_NAMES |= {"exposure_stops", "truncation", "neighbourhood", "quadrature", "rounding", "aliasing"}
_NUMBER_NAMES |= {"temperature_k", "scale", "unconverged_edge_share", "energy_spread"}
_NUMBER_NAMES |= {"turns", "frames_per_second", "radiance"}


@functools.cache
def strategy(name: str) -> st.SearchStrategy:
    """What a parameter of a public callable is tried with.

    Raises:
        KeyError: There is no such parameter yet: say above of what kind it is.
    """
    # What a callback of the caller's own raises is the caller's.
    anything = [each for each in ANYTHING if name != "progress" or not callable(each)]
    return st.one_of(st.sampled_from(anything), legal_kind(name), legal_kind(name))


@functools.cache
def legal_kind(name: str) -> st.SearchStrategy:
    """Values of a parameter's own kind, extreme ones among them."""
    kind = KIND_OF.get(name) or ("number" if name in _NUMBER_NAMES or name.endswith(_IS_NUMBER) else None)
    if kind is None:
        raise KeyError(name)
    return _KINDS[kind]
