"""Skies and rooms as lights: a picture of all directions, cut into as many lobes as a scene can afford."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import checks, free_memory, image_library
from warpdiff.core.file_reading import check_there
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import Spectrum, colour_science
from warpdiff.scene.camera import View
from warpdiff.scene.lights import LOBE_WIDTH, MOST_POWER, DirectionalLight, Lobe, PointLight

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike, NDArray


# Of radiances: squares of colours are float32.
_MOST_RADIANCE = 1e9
_FEWEST_DIRECTIONS, _MOST_DIRECTIONS = 16, 4096
# Cells of equal area, along a side: the coarsest, 45° wide, and the finest, 0.7°, and rows of the picture for these.
_COARSEST, _FINEST, _ROWS_FOR_FINEST = 4, 256, 768
# Lobes share so many spectra: each is a table of its own.
_COLOURS = 8
_ROWS_AT_A_TIME = 64
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
        directions: At most so many lobes, 16 to 4096, stand for it, smaller ones where it is bright: each takes as
            long as a light.
    """

    radiance_rgb: ArrayLike = field(repr=False)
    _: KW_ONLY
    rotation_deg: float = 0.0
    scale: float = 1.0
    directions: int = 256

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
        count = checks.count(self.directions, "directions", least=_FEWEST_DIRECTIONS)
        if count > _MOST_DIRECTIONS:
            raise ValueError(f"directions must be at most {_MOST_DIRECTIONS}, got {count}")
        object.__setattr__(self, "directions", count)

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, rotation_deg: float = 0.0, scale: float = 1.0, directions: int = 256
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


def lobes_of_environment(environment: Environment, sigma_um: float) -> list[Lobe]:
    """The lobes that stand for an environment, for windows of a deviation.

    Of radiance L from a solid angle dω comes ρ L dω 4πσ²/λ² (the absolute reflectance over ρ), so that L/λ² is what
    a directional light's illuminant is. Spectra are those of the RGB under D65 by Mallett and Yuksel's functions
    (Spectral Primary Decomposition for Rendering with sRGB Reflectance, 2019).
    """
    power, directions = _cells(np.asarray(environment.radiance_rgb), math.radians(environment.rotation_deg))
    found, towards, areas = _leaves(power, directions, environment.directions)
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
            spread = LOBE_WIDTH * math.sqrt(areas[index] / math.pi)
            result.append(Lobe((x, y, z), spectrum, float(strength), spread))
    return result


def _cells(radiance: NDArray[np.float32], turn: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The power of RGB from cells of equal area, (n, n, 3), and unit vectors to where in them it is, in the world.

    The sphere is a square of equal areas (Clarberg, Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD, 2008).
    """
    repeats = -(-_ROWS_FOR_FINEST // len(radiance)), -(-2 * _ROWS_FOR_FINEST // radiance.shape[1])
    height, width = len(radiance) * repeats[0], radiance.shape[1] * repeats[1]
    azimuth = (np.arange(width) + 0.5) / width * 2.0 * math.pi - math.pi - turn
    edges = np.cos(np.arange(height + 1) / height * math.pi)
    size = _FINEST**2
    power, moments = np.zeros((size, 3)), np.zeros((size, 3))
    for first in range(0, height, _ROWS_AT_A_TIME):
        rows = np.arange(first, min(first + _ROWS_AT_A_TIME, height))
        upward = 0.5 * (edges[rows] + edges[rows + 1])
        level = np.sqrt(1.0 - upward**2)
        along = np.stack(
            np.broadcast_arrays(level[:, None] * np.sin(azimuth), upward[:, None], -level[:, None] * np.cos(azimuth)),
            axis=-1,
        ).reshape(-1, 3)
        solid = ((edges[rows] - edges[rows + 1]) * 2.0 * math.pi / width)[:, None, None]
        taken = (np.repeat(radiance[rows // repeats[0]], repeats[1], axis=1) * solid).reshape(-1, 3)
        cells = _cell_of(along)
        weights = taken @ colorimetry.RGB_TO_XYZ[1]
        for c in range(3):
            power[:, c] += np.bincount(cells, taken[:, c], size)
            moments[:, c] += np.bincount(cells, weights * along[:, c], size)
    return power.reshape(_FINEST, _FINEST, 3), moments.reshape(_FINEST, _FINEST, 3)


def _cell_of(along: NDArray[np.float64]) -> NDArray[np.int64]:
    """The cell of unit vectors, row by row."""
    x, y, z = np.abs(along[:, 0]), np.abs(along[:, 2]), along[:, 1]
    radius = np.sqrt(np.maximum(1.0 - np.abs(z), 0.0))
    v = np.arctan2(y, x) * 2.0 / math.pi * radius
    u = radius - v
    u, v = np.where(z < 0.0, 1.0 - v, u), np.where(z < 0.0, 1.0 - u, v)
    places = np.stack([np.copysign(v, along[:, 2]), np.copysign(u, along[:, 0])])
    row, column = np.clip(((places + 1.0) / 2.0 * _FINEST).astype(np.int64), 0, _FINEST - 1)
    return np.asarray(row * _FINEST + column)


def _leaves(
    power: NDArray[np.float64], moments: NDArray[np.float64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Cells that are as small as their power asks for: their RGB (n, 3), directions (n, 3) and solid angles (n,).

    Split are those in which luminance times solid angle, what a lobe in their place would misplace, is above what
    leaves at most so many.
    """
    levels = [(power, moments)]
    while len(levels[-1][0]) > _COARSEST:
        half = len(levels[-1][0]) // 2
        levels.append(tuple(each.reshape(half, 2, half, 2, 3).sum(axis=(1, 3)) for each in levels[-1]))
    levels.reverse()
    luminances = [each @ colorimetry.RGB_TO_XYZ[1] for each, _ in levels]
    areas = [4.0 * math.pi / each.size for each in luminances]

    # In whole powers of 2, so that cells that are alike are split alike: lobes of one size side by side are even.
    with np.errstate(divide="ignore"):
        worth = [np.rint(np.log2(each * area)) for each, area in zip(luminances, areas, strict=True)]

    def kept(least: float) -> list[NDArray[np.bool_]]:
        result, there = [], np.ones(luminances[0].shape, dtype=bool)
        for index, luminance in enumerate(luminances):
            there = there & (luminance > 0.0)
            split = there & (worth[index] > least) & (index + 1 < len(luminances))
            result.append(there & ~split)
            there = np.kron(split, np.ones((2, 2), dtype=bool))
        return result

    # From no cell split on: the least threshold that leaves no more cells than are allowed.
    least = float(worth[0].max())
    while sum(np.count_nonzero(each) for each in kept(least - 1.0)) <= most and least > worth[0].max() - 100.0:
        least -= 1.0
    chosen = kept(least)
    found = np.concatenate([each[cells] for (each, _), cells in zip(levels, chosen, strict=True)])
    # From a cell's middle, which is evener than its mean where octants meet, as far as the power is from its mean.
    middles = _cell_middles(2 * _FINEST)
    towards = []
    for (_, moment), luminance, cells in zip(levels, luminances, chosen, strict=True):
        size = len(cells)
        means = middles.reshape(size, 2 * _FINEST // size, size, 2 * _FINEST // size, 3).mean(axis=(1, 3))[cells]
        towards.append(_cell_middles(size)[cells] + moment[cells] / luminance[cells][:, None] - means)
    found_towards = np.concatenate(towards)
    found_towards /= np.linalg.norm(found_towards, axis=1, keepdims=True)
    sizes = np.concatenate([np.full(np.count_nonzero(cells), area) for cells, area in zip(chosen, areas, strict=True)])
    return found, found_towards, sizes


def _cell_middles(count: int) -> NDArray[np.float64]:
    """Unit vectors to the middles of so many by so many cells, (n, n, 3)."""
    places = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    v, u = np.meshgrid(places, places, indexing="ij")
    beyond = 1.0 - np.abs(u) - np.abs(v)
    radius = 1.0 - np.abs(beyond)
    turn = ((np.abs(v) - np.abs(u)) / np.maximum(radius, 1e-30) + 1.0) * math.pi / 4.0
    level = radius * np.sqrt(2.0 - radius**2)
    upward = np.copysign(1.0 - radius**2, beyond)
    return np.stack([np.copysign(np.cos(turn), u) * level, upward, np.copysign(np.sin(turn), v) * level], axis=-1)


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
