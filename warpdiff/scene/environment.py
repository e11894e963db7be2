"""Skies and rooms as lights: a picture of all directions, cut into as many lobes as a scene can afford."""

from __future__ import annotations

import heapq
import math
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import checks, free_memory, image_library
from warpdiff.core.file_reading import check_there
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import Spectrum, colour_science
from warpdiff.scene.camera import View
from warpdiff.scene.lights import MOST_POWER, DirectionalLight, Lobe, PointLight

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike, NDArray


# Of radiances: squares of colours are float32.
_MOST_RADIANCE = 1e9
_FEWEST_DIRECTIONS, _MOST_DIRECTIONS = 16, 8192
# Those of a tolerance of 0.1 and below, as a picture would take minutes for little more; by its square for larger ones.
_FEWEST_CHOSEN, _MOST_CHOSEN = 128, 1024
# Rows of the grid that is cut into cells, of 0.7°, points along a side of a cell that its moments are taken from, and
# how much wider than a cell, in variance, its lobe is, so that lobes side by side are even.
_ROWS, _POINTS, _WIDER = 256, 8, 3.0
# What an even sky over a cell counts for, as if so much changed over a radian; how far beyond a cell changes count, in
# its sizes; turns of lobes' powers.
_EVEN, _REACH, _TURNS = 3.0, 0.5, 8
# Lobes share so many spectra: each is a table of its own.
_COLOURS = 8
_BYTES_A_PIXEL, _BYTES_SEEN = 24.0, 400.0
_NM = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Environment:
    """Light from all directions, by a picture of them in latitude and longitude, +y up.

    The middle column lies at −z and azimuth grows to the right, towards +x; row 0 is +y. A perfect mirror shows the
    picture's own colours. Lights take windows of the kind ``"averaged"``, and footprints.

    Attributes:
        radiance_rgb: Linear sRGB radiance, shape (height, width, 3); negative components count as 0.
        rotation_deg: By so much the environment is turned about +y, counter-clockwise as seen from above [degrees].
        scale: Linear factor.
        directions: So many lobes, 16 to 8192, stand for it at most, narrow across edges: each takes as long as a light.
            None is by the picture's tolerance: 1024 up to 0.1, and by its square above that down to 128.
    """

    radiance_rgb: ArrayLike = field(repr=False)
    _: KW_ONLY
    rotation_deg: float = 0.0
    scale: float = 1.0
    directions: int | None = None

    def __post_init__(self) -> None:
        given = checks.finite_array(self.radiance_rgb, "radiance_rgb", most=_MOST_RADIANCE)
        if given.ndim != 3 or given.shape[2] != 3 or min(given.shape[:2]) < 2:
            raise ValueError(f"radiance_rgb must have shape (height, width, 3), 2 × 2 at least, got {given.shape}")
        radiance = np.maximum(given, 0.0).astype(np.float32)
        if not radiance.any():
            raise ValueError("radiance_rgb must hold light somewhere, got none above 0")
        radiance.setflags(write=False)
        object.__setattr__(self, "radiance_rgb", radiance)
        object.__setattr__(
            self, "rotation_deg", checks.number(self.rotation_deg, "rotation_deg", least=-360.0, most=360.0)
        )
        object.__setattr__(self, "scale", checks.number(self.scale, "scale", least=0.0, most=_MOST_RADIANCE))
        if self.directions is not None:
            count = checks.count(self.directions, "directions", least=_FEWEST_DIRECTIONS)
            if count > _MOST_DIRECTIONS:
                raise ValueError(f"directions must be at most {_MOST_DIRECTIONS}, got {count}")
            object.__setattr__(self, "directions", count)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        rotation_deg: float = 0.0,
        scale: float = 1.0,
        directions: int | None = None,
    ) -> Environment:
        """An environment of an EXR or HDR file in latitude and longitude, of linear sRGB.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is no such picture.
        """
        file = checks.path(path, "path")
        check_there(file)
        with image_library.in_use() as oiio:
            image = oiio.ImageInput.open(str(file))
            if image is None:
                oiio.geterror()
                raise ValueError(f"path: {str(file)!r} cannot be read as an image; give an EXR or HDR file")
            try:
                spec = image.spec()
                if spec.nchannels < 3:
                    raise ValueError(f"path: {str(file)!r} has {spec.nchannels} channels; give one of R, G and B")
                free_memory.require(
                    _BYTES_A_PIXEL * spec.width * spec.height, f"path: {str(file)!r} of {spec.width} × {spec.height}",
                    "take {share} of its pixels",
                )  # fmt: skip
                samples = image.read_image(0, 0, 0, 3, "float")
                if samples is None or image.has_error:
                    image.geterror()
                    raise ValueError(f"path: {str(file)!r} is damaged; export the image again")
            finally:
                image.close()
        try:
            return cls(np.asarray(samples), rotation_deg=rotation_deg, scale=scale, directions=directions)
        except ValueError as error:
            raise ValueError(str(error).replace("radiance_rgb", f"path: {str(file)!r}", 1)) from None

    def seen(self, view: View) -> NDArray[np.float32]:
        """What a view sees of it where nothing is before it: linear sRGB, shape (height, width, 3), a ``background=``.

        It is as bright as a perfect mirror shows it. Pictures by ``ior=``, which are relative to what is reflected at
        normal incidence, go with a ``scale`` divided by that.
        """
        checks.instance(view, View, "view")
        free_memory.require(
            _BYTES_SEEN * view.width * view.height, f"view of {view.width} × {view.height} pixels",
            "take {share} of its pixels",
        )  # fmt: skip
        frame = view.frame()
        x = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
        y = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
        across = x[None, :, None] * frame.right + y[:, None, None] * frame.up
        along = -frame.back + (0.0 if frame.orthographic else 1.0) * across
        return np.asarray(self.scale * self._at(along), dtype=np.float32)

    def _at(self, along: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance from directions, linear between pixels."""
        radiance = np.asarray(self.radiance_rgb, dtype=np.float64)
        height, width = radiance.shape[:2]
        polar = np.arctan2(np.hypot(along[..., 0], along[..., 2]), along[..., 1])
        row = np.clip(polar / math.pi * height - 0.5, 0.0, height - 1.0)
        turned = np.arctan2(along[..., 0], -along[..., 2]) + math.radians(self.rotation_deg)
        column = (turned / (2.0 * math.pi) + 0.5) * width - 0.5
        top, left = np.minimum(row.astype(int), height - 2), np.floor(column).astype(int)
        down, right = (row - top)[..., None], (column - left)[..., None]
        left, beside = left % width, (left + 1) % width
        upper = (1.0 - right) * radiance[top, left] + right * radiance[top, beside]
        lower = (1.0 - right) * radiance[top + 1, left] + right * radiance[top + 1, beside]
        return np.asarray((1.0 - down) * upper + down * lower)


Light = DirectionalLight | PointLight | Environment


@np.errstate(under="ignore")
def lobes_of_environment(environment: Environment, sigma_um: float, tolerance: float) -> list[Lobe]:
    """The lobes that stand for an environment, for windows of a deviation and pictures of a tolerance.

    Of radiance L from a solid angle dω comes ρ L dω 4πσ²/λ² (the absolute reflectance over ρ), so that L/λ² is what
    a directional light's illuminant is. Spectra are those of the RGB under D65 by Mallett and Yuksel's functions
    (Spectral Primary Decomposition for Rendering with sRGB Reflectance, 2019).
    """
    chosen = round(_MOST_CHOSEN * (0.1 / tolerance) ** 2)
    most = environment.directions or min(max(chosen, _FEWEST_CHOSEN), _MOST_CHOSEN)
    radiance = _on_grid(np.asarray(environment.radiance_rgb))
    cells = _cells(radiance @ colorimetry.RGB_TO_XYZ[1], most)
    means = np.array([radiance[slice(*rows), slice(*columns)].mean(axis=(0, 1)) for rows, columns in cells])
    towards, axes = _gaussians(cells, math.radians(environment.rotation_deg))
    ends = np.array(cells) * math.pi / _ROWS
    areas = (np.cos(ends[:, 0, 0]) - np.cos(ends[:, 0, 1])) * (ends[:, 1, 1] - ends[:, 1, 0])
    found = _powers(means, towards, axes)
    # The middles are where lobes that are alike are brightest.
    found *= (means * areas[:, None]).sum(axis=0) / np.maximum(found.sum(axis=0), 1e-300)
    there = found.max(axis=1) > 0.0
    found, towards, axes = found[there], towards[there], axes[there]
    luminances = found @ colorimetry.RGB_TO_XYZ[1]
    of_colours = _clusters(found / luminances[:, None], luminances, _COLOURS)
    result = []
    for members in of_colours:
        spectrum, per_luminance = _spectrum(found[members].sum(axis=0))
        for index in members:
            strength = environment.scale * luminances[index] * per_luminance * 4.0 * math.pi * sigma_um**2
            if strength > MOST_POWER:
                raise ValueError(
                    f"light: radiance_rgb times scale of an Environment is too bright: a part has a power of "
                    f"{strength:g}, and {MOST_POWER:g} is the most; give a smaller scale"
                )
            x, y, z = map(float, towards[index])
            result.append(Lobe((x, y, z), spectrum, float(strength), axes[index]))
    return result


def _on_grid(radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Means of the radiance over the cells of a grid of the same directions, (_ROWS, 2 _ROWS, 3)."""
    result = radiance.astype(np.float64)
    for axis, count in enumerate((_ROWS, 2 * _ROWS)):
        given = np.linspace(0.0, 1.0, result.shape[axis] + 1)
        wanted = np.linspace(0.0, 1.0, count + 1)
        if axis == 0:
            # By solid angle.
            given, wanted = (0.5 - 0.5 * np.cos(math.pi * each) for each in (given, wanted))
        result = np.moveaxis(result, axis, 0)
        sums = np.concatenate([np.zeros((1, *result.shape[1:])), np.cumsum(result * np.diff(given)[:, None, None], 0)])
        place = np.interp(wanted, given, np.arange(len(given)))
        first = np.minimum(place.astype(int), len(given) - 2)
        sums = sums[first] + (place - first)[:, None, None] * (sums[first + 1] - sums[first])
        result = np.moveaxis(np.diff(sums, axis=0) / np.diff(wanted)[:, None, None], 0, axis)
    return result


_Cell = tuple[tuple[int, int], tuple[int, int]]


def _cells(luminance: NDArray[np.float64], most: int) -> list[_Cell]:
    """Rows and columns of at most so many rectangles of the grid, narrow across what changes.

    Halved is, again and again, the cell and the side across which the sky changes most, within it and half of it beyond
    either end, where its lobe reaches: next to an edge cells grow narrow one by one.
    """
    solid = -np.diff(np.cos(np.arange(_ROWS + 1) / _ROWS * math.pi)) * math.pi / _ROWS
    size = _ROWS, 2 * _ROWS
    # Sums over columns before each, once more around; and over rows.
    along = np.concatenate([np.zeros((_ROWS, 1)), np.cumsum(luminance, axis=1)], axis=1)
    down = np.concatenate([np.zeros((1, 2 * _ROWS)), np.cumsum(luminance * solid[:, None], axis=0)])
    solids = np.concatenate([[0.0], np.cumsum(solid)])

    def changes(cell: _Cell, axis: int) -> float:
        """How much light is elsewhere than were it even across an axis."""
        (top, bottom), (left, right) = cell
        begin, end = cell[axis]
        reach = math.ceil(_REACH * (end - begin))
        if end - begin < 2:
            return 0.0
        area = (solids[bottom] - solids[top]) * (right - left)
        if axis == 0:
            rows = slice(max(begin - reach, 0), min(end + reach, size[0]))
            profile = (along[rows, right] - along[rows, left]) / (right - left)
            weights = solid[rows]
            extent = (bottom - top) * math.pi / _ROWS
        else:
            columns = np.arange(begin - reach, end + reach) % size[1]
            profile = (down[bottom, columns] - down[top, columns]) / (solids[bottom] - solids[top])
            weights = np.ones(len(columns))
            extent = (right - left) * math.pi / _ROWS * math.sin(0.5 * (top + bottom) * math.pi / _ROWS)
        mean = float(np.average(profile, weights=weights))
        away = float(np.average(np.abs(profile - mean), weights=weights))
        return float(area * (away + _EVEN * mean * extent**2))

    queue: list[tuple[float, int, int, _Cell]] = []

    def add(rows: tuple[int, int], columns: tuple[int, int]) -> None:
        both = [changes((rows, columns), axis) for axis in (0, 1)]
        axis = int(both[1] > both[0])
        heapq.heappush(queue, (-both[axis], len(queue), axis, (rows, columns)))

    for row in range(2):
        for column in range(4):
            add((row * _ROWS // 2, (row + 1) * _ROWS // 2), (column * _ROWS // 2, (column + 1) * _ROWS // 2))
    while len(queue) < most and queue[0][0] < 0.0:
        _, _, axis, cell = heapq.heappop(queue)
        middle = sum(cell[axis]) // 2
        for part in ((cell[axis][0], middle), (middle, cell[axis][1])):
            add(*((part, cell[1]) if axis == 0 else (cell[0], part)))
    return [cell for _, _, _, cell in queue]


def _gaussians(cells: list[_Cell], turn: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors to the middles of cells, (n, 3), and the deviations of the lobes in their place, (n, 2, 3)."""
    ends = np.array(cells) * math.pi / _ROWS
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    polar, azimuth = (ends[:, axis, :1] + share * (ends[:, axis, 1:] - ends[:, axis, :1]) for axis in (0, 1))
    azimuth = azimuth[:, None, :] - math.pi - turn
    level = np.sin(polar)[:, :, None]
    along = np.stack(
        np.broadcast_arrays(level * np.sin(azimuth), np.cos(polar)[:, :, None], -level * np.cos(azimuth)), axis=-1
    ).reshape(len(cells), -1, 3)
    weights = np.repeat(np.sin(polar), _POINTS, axis=1)[:, :, None]
    weights /= weights.sum(axis=1, keepdims=True)
    means = (weights * along).sum(axis=1)
    towards = means / np.linalg.norm(means, axis=1, keepdims=True)
    away = along - means[:, None]
    away -= (away @ towards[:, :, None]) * towards[:, None]
    values, vectors = np.linalg.eigh(np.swapaxes(weights * away, 1, 2) @ away)
    deviations = np.sqrt(_WIDER * np.maximum(values[:, 1:], 1e-12))
    return towards, deviations[:, :, None] * np.swapaxes(vectors, 1, 2)[:, 1:]


def _powers(means: NDArray[np.float64], towards: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The power of RGB of lobes that together are as bright in the middles of cells as these are, (n, 3).

    By Gold's ratio: each is multiplied by what it lacks, over and over, and stays positive.
    """
    deviations = np.linalg.norm(axes, axis=2)
    middles = towards.astype(np.float32)
    seen = np.maximum(middles @ middles.T, np.float32(0.0))
    seen /= 2.0 * math.pi * deviations.prod(axis=1).astype(np.float32)
    for axis in (0, 1):
        across = middles @ (axes[:, axis] / deviations[:, axis, None] ** 2).T.astype(np.float32)
        seen *= np.exp(np.float32(-0.5) * across**2)
    result = means / seen.sum(axis=1, keepdims=True)
    for _ in range(_TURNS):
        result = result * means / np.maximum(seen @ result, 1e-30)
    return np.asarray(result)


def _clusters(colours: NDArray[np.float64], weights: NDArray[np.float64], most: int) -> list[NDArray[np.int64]]:
    """Indices of colours that are alike: the group that differs most is cut at its mean, again and again."""
    groups = [np.arange(len(colours))]

    def spread(group: NDArray[np.int64]) -> tuple[float, NDArray[np.float64]]:
        """How much a group differs, and how far along its principal axis each of it lies."""
        away = colours[group] - np.average(colours[group], axis=0, weights=weights[group])
        values, axes = np.linalg.eigh((away * weights[group, None]).T @ away)
        return float(values[-1]), away @ axes[:, -1]

    while len(groups) < most:
        sizes = [spread(group)[0] if len(group) > 1 else 0.0 for group in groups]
        index = int(np.argmax(sizes))
        if sizes[index] <= 1e-12 * weights.sum():
            break
        group = groups.pop(index)
        beyond = spread(group)[1] > 0.0
        groups += [group[beyond], group[~beyond]]
    return [group for group in groups if len(group)]


def _spectrum(rgb: NDArray[np.float64]) -> tuple[Spectrum, float]:
    """The illuminant L/λ² of light of a colour, and ∫ L ȳ/λ² dλ [1/µm²] over its luminance."""
    colour: Any = colour_science()
    shape = colour.SpectralShape(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, 1)
    basis = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019.copy().align(shape).values
    share = np.maximum(basis @ (rgb / rgb.max()), 0.0)
    per_square = 1e6 / _NM**2
    bright = colorimetry.colour_products("D65")[:, 1]
    values = share * colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    spectrum = Spectrum(_NM, values * per_square, name="environment")
    return spectrum, float((bright * share) @ per_square / (bright @ share))
