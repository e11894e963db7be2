"""Random calls that test plans: surface, coherence, tolerance and directions, each determined by an index and a seed.

A plan has the numbers of a computation, such as wavelengths and terms of a series; the library selects it for a call.
Coherence states how far light interferes. Combinations of coherence and tolerance occur in a fixed cycle:
``len(STRATA)`` consecutive indices contain each combination once. All other parameters are random. Calls are lists of
directions (few and many, shuffled and sorted), grids of directions in row order, reflectance maps, and frames of a
mesh. ``bench.truth.judge`` evaluates their errors.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

import warpdiff as wd

KINDS = ("averaged", "centred", "source", "replicas")
# Combinations of coherence and tolerance of the random calls. Replicated patches have only two tolerances: their
# periods interfere with narrow maxima, and tight tolerances would require too many wavelengths.
STRATA = [(kind, t) for kind in KINDS for t in (1e-1, 1e-2, 1e-3, 1e-4) if kind != "replicas" or t >= 1e-2]
SURFACES = ("scan", "fingers", "diagonal", "sinusoidal", "lamellar", "blazed", "disc", "bumps", "sparse", "rough")
GRATINGS = ("fingers", "sinusoidal", "lamellar", "blazed", "disc", "bumps")
LAYOUTS = ("few", "some", "many", "many", "grid", "grid", "map", "map", "frame")
WAYS = ("random", "mirror", "orders", "grazing", "mixed")
ILLUMINANTS = ("D65", "D65", "D65", "A", "FL11", "HP1", "E")
# Materials from which one is drawn for half of the random calls. None is the default material, as in the other half.
MATERIALS = (
    None, *map(wd.Material.metal, ("Al", "Au", "Cu", "Cr")), wd.Material.dielectric(1.5),
    wd.Material.metal("Ni").coated(wd.Material.dielectric(1.46), 220.0),
    wd.Material.dielectric(1.5).coated(wd.Material.dielectric(2.3), 90.0),
)  # fmt: skip
# Sizes of the random calls: number of directions along each side of a grid, width of a reflectance map [pixels], and
# width and height of a frame [pixels].
SIDES = (64, 70, 96, 128, 200, 256, 333, 512, 512, 512, 1000, 1024)
MAP_SIZES = (48, 70, 128, 256, 512)
FRAMES = ((320, 240), (640, 480), (640, 512), (512, 512))
# Number of directions of a call below which the errors of all its directions are evaluated.
FEW = 4096
# Largest number of directions of a call. The value is limited by computing time.
MOST = 262_144
# Largest numbers of directions of two kinds of calls: calls that sample wavelengths instead of using a colour table,
# and calls with replicated patches. The values are limited by computing time, because each of these directions takes at
# least 0.1 ms.
MOST_SAMPLED = 32_768
MOST_REPLICAS = 8_192
# Largest angle of random light and view directions from the normal [degrees], and the cosine of this angle.
STEEPEST_DEG = 85.0
LOWEST = math.cos(math.radians(STEEPEST_DEG))
# Largest sample spacing [µm] of resampled surfaces. The value is slightly below 95 nm. It was derived: the largest
# |(u, v)| is 2, and at 380 nm the first order of a period of 190 nm has this value. A period requires two samples.
COARSEST_PITCH_UM = 0.0945
# Largest number of samples of a replicated patch, and largest total length of its periods [µm]. The values are limited
# by the time of the reference, which sums every sample and resolves every maximum of interference over the wavelength.
MOST_PATCH_SAMPLES = 1 << 14
MOST_IN_STEP_UM = 3000.0
# Largest angle of incidence of the light of a reflectance map [degrees].
MAP_LIGHT_DEG = 75.0


class Picture(NamedTuple):
    """Inputs of a random call that renders a picture: name of the body, light and view."""

    body: str
    light: wd.DirectionalLight
    view: wd.View

    @property
    def mesh(self):
        return body(self.body)


class Configuration(NamedTuple):
    """One random call of the library: its arguments, and a description in words."""

    index: int
    seed: int
    heightfield: wd.HeightField
    coherence: wd.Coherence
    tolerance: float
    illuminant: str
    surface: str
    layout: str
    words: str
    to_light: np.ndarray | None = None  # directions to the light (n, 3), or (3,) for a map
    to_view: np.ndarray | None = None  # directions to the viewer (n, 3)
    size: int = 0  # width of a reflectance map [pixels]
    picture: Picture | None = None
    material: wd.Material | None = None

    @property
    def stratum(self):
        return self.coherence.kind, self.tolerance

    def __str__(self):
        pitch = " × ".join(f"{p:.3g}" for p in self.heightfield.pitch_um)
        size = " × ".join(f"{s:.3g}" for s in self.heightfield.size_um)
        return (
            f"{self.surface}, {size} µm, pitch {pitch}, height range {self.heightfield.height_range_um:.3g} µm; "
            f"{self.coherence}; tolerance {self.tolerance:g}; {self.words}; {self.illuminant}"
            f"{'' if self.material is None else f'; {self.material}'}"
        )


def configuration(index, seed=0, scan=None, layouts=LAYOUTS):
    """Return the random call that ``index`` and ``seed`` determine.

    Its surface may be a part of ``scan``, or a synthetic snake skin with finger-like bumps if ``scan`` is None.
    """
    rng = np.random.default_rng([seed, index])
    kind, tolerance = STRATA[index % len(STRATA)]
    layout = layouts[rng.integers(len(layouts))]
    names = GRATINGS if layout == "map" else SURFACES
    heightfield, name = surface(rng, names[rng.integers(len(names))], scan, small=kind == "replicas")
    coherence = a_coherence(rng, kind, heightfield)
    illuminant = ILLUMINANTS[rng.integers(len(ILLUMINANTS))]
    # The material is drawn from a separate random generator, so that the other parameters of a seed do not depend on
    # the material.
    apart = np.random.default_rng([seed, index, 26])
    material = MATERIALS[apart.integers(len(MATERIALS))] if apart.random() < 0.5 else None
    case = Configuration(
        index, seed, heightfield, coherence, tolerance, illuminant, name, layout, "", material=material
    )
    most = MOST_REPLICAS if kind == "replicas" else MOST_SAMPLED if tolerance < 1e-2 else MOST
    if layout == "frame":
        return a_frame(rng, case, most)
    if layout == "map":
        return a_map(rng, case, most)
    if layout == "grid":
        return a_grid(rng, case, most)
    return a_list(rng, case, most)


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def surface(rng, name, scan, *, small=False):
    """Return a random height field of the named kind, and a name that describes it in more detail.

    If ``scan`` is None, synthetic snake skins with finger-like bumps replace crops of the scan. Height ranges are 0.001
    to 3 µm. With ``small``, the height field has at most ``MOST_PATCH_SAMPLES`` samples.
    """
    seed = int(rng.integers(1 << 30))
    if name == "scan" and scan is not None:
        size = log_uniform(rng, 2.0, 60.0)
        place = tuple(rng.uniform(0.0, length - size - 0.1) for length in scan.size_um)
        heightfield = scan.cropped(size, offset_um=place)
        if rng.random() < 0.3 or heightfield.heights_um.size > MOST_PATCH_SAMPLES >= (size / COARSEST_PITCH_UM) ** 2:
            heightfield = heightfield.resampled(rng.uniform(heightfield.pitch_um[0], 0.09) if not small else 0.09)
    elif name in {"scan", "fingers", "diagonal"}:
        name = "fingers" if name == "scan" else name
        period, length = log_uniform(rng, 0.8, 2.0), log_uniform(rng, 1.0, 5.0)
        size = tuple(max(log_uniform(rng, 2.0, 30.0), least) for least in (1.1 * length, 1.1 * period))
        pitch = 0.09 if small else rng.uniform(0.05, 0.09)
        if name == "diagonal":
            size = (max(size), max(size))
        heightfield = wd.gratings.fingers(size_um=size, pitch_um=pitch, period_um=period, length_um=length, seed=seed)
        if name == "diagonal":
            heightfield = diagonal(rng, heightfield)
    elif name in {"sinusoidal", "blazed"}:
        heightfield = getattr(wd.gratings, name)(log_uniform(rng, 0.5, 20.0), 1.0)
    elif name == "lamellar":
        heightfield = wd.gratings.lamellar(log_uniform(rng, 0.5, 20.0), 1.0, duty=rng.uniform(0.1, 0.9))
    elif name == "disc":
        kind = ("CD", "DVD", "Blu-ray")[rng.integers(3)]
        track, least, pitch = {"CD": (1.6, 12.3, 0.09), "DVD": (0.74, 5.9, 0.09), "Blu-ray": (0.32, 2.4, 0.064)}[kind]
        tracks, length = max(1, round(log_uniform(rng, 2.0, 25.6) / track)), log_uniform(rng, least, 25.6)
        if not small:
            pitch = rng.uniform(0.04, pitch)
        heightfield = wd.gratings.disc(kind, tracks=tracks, length_um=length, pitch_um=pitch, seed=seed)
        name = f"disc {kind}"
    elif name == "rough":
        heightfield = rough(rng)
    else:
        length, width = log_uniform(rng, 0.3, 3.0), log_uniform(rng, 0.3, 3.0)
        apart = (1.0, 3.0) if name == "bumps" else (5.0, 12.0)
        spacing = tuple(min(extent * log_uniform(rng, *apart), 25.0) for extent in (length, width))
        pitch = rng.uniform(0.04, 0.09)
        heightfield = wd.gratings.bumps(width_um=width, length_um=length, spacing_um=spacing, pitch_um=pitch)
    heights, pitch = heightfield.heights_um, heightfield.pitch_um
    if small:
        heights = fewer(heights)
    scale = np.ptp(heights)
    if scale == 0.0:
        heights, scale = heights + np.cos(2.0 * np.pi * np.arange(heights.shape[1]) / heights.shape[1]), 2.0
    return wd.HeightField.of_known_scale(heights * (log_uniform(rng, 0.001, 3.0) / scale), pitch), name


def diagonal(rng, heightfield):
    """Return a square periodic height field with ridges along the diagonal and with added roughness."""
    n = min(heightfield.shape)
    rows, columns = np.mgrid[:n, :n]
    ridges = heightfield.heights_um[rows, (columns + rows) % n]
    return wd.HeightField.of_known_scale(ridges + 0.1 * np.ptp(ridges) * rng.normal(size=(n, n)), heightfield.pitch_um)


def rough(rng):
    """Return a height field of Gaussian noise with a Gaussian or an exponential autocorrelation."""
    shape = tuple(int(n) for n in rng.integers(32, 257, size=2))
    pitch = rng.uniform(0.04, 0.09)
    fy, fx = (np.fft.fftfreq(n, pitch) for n in shape)
    f = 2.0 * np.pi * np.hypot(fy[:, None], fx) * log_uniform(rng, 0.05, 1.0)
    power = np.exp(-(f**2) / 4.0) if rng.random() < 0.5 else (1.0 + f**2) ** -1.5
    heights = np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * np.sqrt(power)).real
    return wd.HeightField.of_known_scale(heights, pitch)


def fewer(heights):
    """Return a corner of an array of heights that has at most ``MOST_PATCH_SAMPLES`` samples."""
    ny, nx = heights.shape
    while ny * nx > MOST_PATCH_SAMPLES:
        ny, nx = (ny - ny // 8, nx) if ny >= nx else (ny, nx - nx // 8)
    return heights[:ny, :nx]


def a_coherence(rng, kind, heightfield):
    """Return a random coherence of the given kind: a window, a light source or numbers of periods."""
    if kind == "source":
        return wd.Coherence(kind, angular_diameter_deg=log_uniform(rng, 0.1, 3.0))
    if kind == "replicas":
        most = [max(1.0, min(3000.0, MOST_IN_STEP_UM / length)) for length in heightfield.size_um]
        return wd.Coherence(kind, periods=tuple(max(1, round(log_uniform(rng, 1.0, count))) for count in most))
    centre = None
    if kind == "centred" and rng.random() < 0.5:
        centre = tuple(float(rng.uniform(0.0, length)) for length in heightfield.size_um)
    # Half of the coherence windows have the default width of 16.25 µm.
    sigma = 16.25 if rng.random() < 0.5 else log_uniform(rng, 3.0, 65.0)
    return wd.Coherence(kind, sigma, centre_um=centre)


def a_light(rng, count=1, steepest_deg=STEEPEST_DEG):
    """Return random directions to the light (count, 3); the angle of incidence is distributed uniformly."""
    theta, phi = np.radians(rng.uniform(0.0, steepest_deg, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


def a_list(rng, case, most):
    """Return ``case`` with a random list of directions to the light and to the viewer, in random or sorted order."""
    low, high = {"few": (16, 128), "some": (129, FEW - 1), "many": (FEW, most)}[case.layout]
    count = round(log_uniform(rng, low, high))
    way = WAYS[rng.integers(len(WAYS))]
    one = rng.random() < 0.5
    lights = np.broadcast_to(a_light(rng, 1 if one else count), (count, 3)).copy()
    spread = math.radians(log_uniform(rng, 0.3, 30.0))
    views = np.zeros((count, 3))
    ways = np.array(WAYS[:4])[rng.integers(4, size=count)] if way == "mixed" else np.full(count, way)
    for kind in np.unique(ways):
        views[ways == kind] = some_views(rng, kind, lights[ways == kind], spread, case.heightfield, case.coherence)
    order = ("as drawn", "sorted by u", "sorted by w")[rng.integers(3)]
    if order != "as drawn":
        by = np.argsort((lights + views)[:, 0 if order == "sorted by u" else 2], kind="stable")
        lights, views = lights[by], views[by]
    words = {
        "random": "views anywhere", "mirror": f"views within about {math.degrees(spread):.2g}° of the mirror direction",
        "orders": "views near orders", "grazing": "views within 15° of the horizon",
        "mixed": f"views anywhere, grazing, near orders and within about {math.degrees(spread):.2g}° of the mirror",
    }  # fmt: skip
    words = f"{count} directions, {'one light' if one else 'one light per view'}, {words[way]}, {order}"
    return case._replace(to_light=lights, to_view=views, words=words)


def some_views(rng, way, lights, spread, heightfield, coherence):
    """Return one random view direction per light direction, at most ``STEEPEST_DEG`` from the normal.

    ``way`` is the name of the distribution of the views.
    """
    views = np.zeros_like(lights)
    pending = np.arange(len(lights))
    while len(pending):
        light = lights[pending]
        low, high = (LOWEST, math.cos(math.radians(75.0))) if way == "grazing" else (LOWEST, 1.0)
        z, phi = rng.uniform(low, high, len(pending)), rng.uniform(0.0, 2.0 * np.pi, len(pending))
        s = np.sqrt(1.0 - z * z)
        candidates = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)
        if way == "mirror":
            # View directions are normally distributed around the mirror direction. Views beyond the largest angle from
            # the normal are drawn again. If the mirror direction is at the largest angle, about half of all views are
            # drawn again, otherwise fewer, so that the loop ends soon.
            candidates = light * [-1.0, -1.0, 1.0] + spread * rng.normal(size=(len(pending), 3))
            candidates /= np.linalg.norm(candidates, axis=1, keepdims=True)
        elif way == "orders":
            candidates = by_an_order(rng, light, candidates, heightfield, coherence)
        accepted = candidates[:, 2] >= LOWEST
        views[pending[accepted]] = candidates[accepted]
        pending = pending[~accepted]
    return views


def by_an_order(rng, lights, views, heightfield, coherence):
    """Return, for each view, a direction near the diffraction order that is nearest to the view at a random wavelength.

    Deviations from the order are normally distributed with the standard deviation of the order's peak in (u, v). A
    result with x² + y² > 1 is no direction; the returned vector then has these x and y, and z = −1.
    """
    wavelength = rng.uniform(0.38, 0.78, (len(lights), 1))
    lengths = np.array([heightfield.size_um[1], heightfield.size_um[0]])
    orders = np.rint(-(lights + views)[:, :2] / wavelength * lengths)
    # Along an axis with one height sample, the surface is constant, and only the diffraction order 0 exists.
    orders[:, [heightfield.shape[1] == 1, heightfield.shape[0] == 1]] = 0.0
    if coherence.kind == "replicas":
        width = wavelength / (lengths * np.array(coherence.periods[::-1]))
    elif coherence.kind == "source":
        width = coherence.spread
    else:
        width = wavelength / (2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um)
    across = -lights[:, :2] - wavelength * orders / lengths + width * rng.normal(size=(len(lights), 2))
    height2 = 1.0 - np.sum(across**2, axis=1)
    return np.column_stack([across, np.where(height2 > 0.0, np.sqrt(np.maximum(height2, 0.0)), -1.0)])


def a_grid(rng, case, most):
    """Return ``case`` with a random grid of view directions, in row order, and one light direction.

    The grid is over x and y of the view directions. Points outside the unit disc become directions below the horizon.
    """
    sides = [side for side in SIDES if side * side <= max(most, 64 * 64) * (4 if most == MOST else 1)]
    side = sides[rng.integers(len(sides))]
    light = a_light(rng)[0]
    extent = log_uniform(rng, 0.05, 2.0)
    middle = -light[:2] if rng.random() < 0.5 else rng.uniform(-0.5, 0.5, 2)
    turn = rng.uniform(0.0, 2.0 * np.pi) if rng.random() < 0.5 else 0.0
    a = extent * ((np.arange(side) + 0.5) / side - 0.5)
    x, y = np.meshgrid(a, -a)
    x, y = middle[0] + np.cos(turn) * x - np.sin(turn) * y, middle[1] + np.sin(turn) * x + np.cos(turn) * y
    square = (x * x + y * y).ravel()
    above = square < 1.0
    if not above.any():
        return a_grid(rng, case, most)
    z = np.where(above, np.sqrt(np.maximum(1.0 - square, 0.0)), -0.5)
    views = np.column_stack([x.ravel(), y.ravel(), z])
    words = f"a grid of {side} × {side} views over {extent:.2g}, rotated by {math.degrees(turn):.0f}°"
    return case._replace(to_light=np.broadcast_to(light, views.shape), to_view=views, words=words)


def a_map(rng, case, most):
    sizes = [size for size in MAP_SIZES if 0.785 * size * size <= max(most, 4000)]
    size = int(sizes[rng.integers(len(sizes))])
    light = a_light(rng, steepest_deg=MAP_LIGHT_DEG)[0] if rng.random() < 0.7 else np.array([0.0, 0.0, 1.0])
    words = f"a map of {size} × {size}, incidence {math.degrees(math.acos(min(light[2], 1.0))):.0f}°"
    return case._replace(to_light=light, size=size, words=words)


@functools.cache
def body(name):
    """Return the mesh of a body by its name: "snake", "disc" or "tube"."""
    if name == "snake":
        return wd.meshes.snake(segments=2)
    if name == "disc":
        return wd.meshes.disc()
    return wd.meshes.tube(segments_along=128, segments_around=64)


def a_frame(rng, case, most):
    name = ("snake", "tube", "disc")[rng.integers(3)]
    sizes = [size for size in FRAMES if size[0] * size[1] <= 4 * most] or [(128, 96)]
    width, height = sizes[rng.integers(len(sizes))]
    theta, phi = math.radians(rng.uniform(5.0, 80.0)), rng.uniform(0.0, 2.0 * np.pi)
    up = np.array([0.0, 0.0, 1.0] if name == "disc" else [0.0, 1.0, 0.0])
    along = np.array([1.0, 0.0, 0.0])
    other = np.cross(up, along)

    def direction(theta, phi):
        return math.cos(theta) * up + math.sin(theta) * (math.cos(phi) * along + math.sin(phi) * other)

    target = 0.3 * rng.normal(size=3) * (1.0 - up)
    eye = target + log_uniform(rng, 1.5, 5.0) * direction(theta, phi)
    light = direction(math.radians(rng.uniform(0.0, 70.0)), rng.uniform(0.0, 2.0 * np.pi))
    view = wd.View(eye, target, up=tuple(direction(math.pi / 2.0, phi + 0.3)), width=width, height=height)
    picture = Picture(name, wd.DirectionalLight(tuple(light), illuminant=case.illuminant), view)
    words = f"a frame of the {name}, {width} × {height}, camera {math.degrees(theta):.0f}° from above"
    return case._replace(picture=picture, words=words)
