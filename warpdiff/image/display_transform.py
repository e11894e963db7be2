"""Display transforms: scene-linear XYZ to display RGB (ACES 2.0 after chroma compression, colorimetric, clip).

ACES 2.0 is the output transform of Academy S-2025-001. This module uses the implementation of OpenColorIO, in a
built-in configuration of OpenImageIO with a fixed version. ACES clips negative components in its working space (AP1).
Narrow-band light has negative components there, and clipping them changes its hue. This module therefore compresses the
chroma before ACES, at constant lightness and hue of OKLab (B. Ottosson, 2020). The compression curve is that of ACES'
Reference Gamut Compression with a power of 1.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Unpack

import numpy as np

from warpdiff.core import openimageio, validation
from warpdiff.core.threads import cores, parallel_for, single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics import colorimetry
from warpdiff.request.settings import ColourSettings, Display, DisplaySettings, GamutName
from warpdiff.request.signatures import accepts

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.request.keywords import ColourKeywords

CONFIGURATION = "ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5"
SCENE = "CIE XYZ-D65 - Scene-referred"
# Mean luminance to which automatic exposure scales the illuminated pixels of a picture, by display transform; 1 is the
# white of the display. The value for ACES is larger, because ACES displays middle tones 0.8 stops darker and can
# display values above 1. The values were chosen by eye; if doubled, pictures are a stop brighter.
MEAN_SHOWN: dict[Display, float] = {"aces": 0.7, "colorimetric": 0.5, "clip": 0.5}
# Automatic exposure excludes this fraction of the illuminated pixels of a picture, namely the brightest ones. They are
# excluded because mirror reflections of a light may be a thousand times as bright as diffraction orders. If the
# fraction was doubled, pictures with small bright areas would become brighter.
_TOO_BRIGHT = 1e-4

# Matrix from CIE XYZ to linear Display P3 with the white point D65, from CSS Color Module Level 4.
_XYZ_TO_P3 = np.array([
    [446124 / 178915, -333277 / 357830, -72051 / 178915],
    [-14852 / 17905, 63121 / 35810, 423 / 17905],
    [11844 / 330415, -50337 / 660830, 316169 / 330415],
])  # fmt: skip
_P3_TO_XYZ = np.linalg.inv(_XYZ_TO_P3)
# Matrices of the colour space OKLab. The first matrix converts XYZ to cone responses. The second matrix converts the
# cube roots of the cone responses to the lightness L and the chroma coordinates a and b.
_XYZ_TO_CONES = np.array([
    [0.8189330101, 0.3618667424, -0.1288597137],
    [0.0329845436, 0.9293118715, 0.0361456387],
    [0.0482003018, 0.2643662691, 0.6338517070],
])  # fmt: skip
_ROOTS_TO_LAB = np.array([
    [0.2104542553, 0.7936177850, -0.0040720468],
    [1.9779984951, -2.4285922050, 0.4505937099],
    [0.0259040371, 0.7827717662, -0.8086757660],
])  # fmt: skip
_CONES_TO_XYZ, _LAB_TO_ROOTS = np.linalg.inv(_XYZ_TO_CONES), np.linalg.inv(_ROOTS_TO_LAB)
# Colour matrices that the shaders of web pages use, by their names in the shaders. A matrix multiplies a colour as a
# column vector.
MATRICES = {
    "xyzToP3": _XYZ_TO_P3, "xyzToCones": _XYZ_TO_CONES, "conesToXyz": _CONES_TO_XYZ, "rootsToLab": _ROOTS_TO_LAB,
    "labToRoots": _LAB_TO_ROOTS,
}  # fmt: skip

# Chromaticities x, y of the primaries R, G and B and of the white point D65 of linear sRGB (ITU-R BT.709).
SRGB_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
# Range of the chroma compression. Chromas are relative to the largest chroma of the same hue in Display P3. Chromas
# below `UNCHANGED` are unchanged. Chromas between `UNCHANGED` and `COMPRESSED` are compressed, so that `COMPRESSED`
# becomes 1. The second number is derived from monochromatic light, whose chroma is at most 3.96, at 495 nm.
UNCHANGED, COMPRESSED = 0.8, 4.0
# Number of hues for which the largest chroma in Display P3 is tabulated, one per 0.25°. The value was chosen so that
# linear interpolation between the hues suffices. If doubled, computing the table takes twice as long.
_HUES = 1440
# Largest linear RGB component that is passed to ACES. Larger components are replaced by this number. ACES displays this
# number as white already, and much larger components would overflow.
WHITE = 1024.0
# Table of ACES colours. `_NODES` is the number of its grid points along each axis: 33 points give an interpolation
# error of 0.6 ΔE2000 at the 99th percentile, and twice as many points require 8 times the memory. `TOE` is the linear
# RGB component up to which the grid points are nearly evenly spaced. Above it, the ratios of neighbouring grid points
# are nearly equal.
_NODES, TOE = 33, 0.01
# Number of bisections that find the largest chroma of a colour in a gamut. They reduce the interval that contains this
# chroma by a factor of 2^20. The number was chosen so that the rest is less than a step of a 16-bit file.
_BISECTIONS = 20
# Number of colours that one thread transforms at once. If it was doubled, small pictures would be transformed by fewer
# threads.
_TOGETHER = 8192
# Divisors that may be 0 are replaced by this number if they are smaller, which prevents a division by zero.
_LEAST = 1e-30


@dataclass(frozen=True)
class Gamut:
    """Gamut of a display, with its names in OpenColorIO and in files.

    Attributes:
        xyz_to_rgb: Matrix from XYZ to linear RGB, shape (3, 3).
        display: Name of the display in the OpenColorIO configuration.
        view: Name of the ACES view in the OpenColorIO configuration.
        name: Name of the gamut in the metadata of files.
        cicp: Codes of ITU-T H.273 for PNG files: primaries, transfer function, matrix and range. None if the name
            alone identifies the gamut.
    """

    xyz_to_rgb: NDArray[np.float64]
    display: str
    view: str
    name: str
    cicp: tuple[int, int, int, int] | None = None


GAMUTS: dict[GamutName, Gamut] = {
    "srgb": Gamut(colorimetry.XYZ_TO_RGB, "sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)", "sRGB"),
    "display-p3": Gamut(
        _XYZ_TO_P3, "Display P3 - Display", "ACES 2.0 - SDR 100 nits (P3 D65)", "Display P3", (12, 13, 0, 1)
    ),
}


def auto_exposure(luminances: ArrayLike, display: Display) -> float:
    """Return the exposure factor that scales the mean luminance, without the brightest 0.01 %, to `MEAN_SHOWN`.

    If all luminances are 0, the factor is 1.
    """
    luminance = np.sort(np.asarray(luminances, dtype=np.float64).ravel())
    most = luminance[: len(luminance) - math.ceil(_TOO_BRIGHT * len(luminance))]
    # The number of excluded luminances, 0.01 % of all, is rounded up. A single luminance would therefore be excluded.
    # In this case, it is the mean.
    mean = float(np.mean(most if most.size else luminance)) if luminance.size else 0.0
    return MEAN_SHOWN[display] / mean if mean > 0.0 else 1.0


def exposure_factor(shown: DisplaySettings, luminances: ArrayLike) -> float:
    """Return the factor by which linear colours are multiplied before display, by the options and the luminances."""
    # The automatic exposure factor of a nearly black picture may be so large that float32 overflows. The factor is
    # therefore limited.
    factor = shown.exposure or min(auto_exposure(luminances, shown.display), validation.MOST)
    return float(factor * 2.0**shown.exposure_stops)


@accepts(ColourSettings)
@np.errstate(under="ignore")
def to_srgb(xyz: ArrayLike, display: Display = "aces", **settings: Unpack[ColourKeywords]) -> NDArray[np.float64]:
    """Transform linear CIE XYZ to display colours, sRGB with its transfer function.

    Automatic exposure depends on all colours in ``xyz``. Pass ``exposure=`` to compare the results of several calls.

    Args:
        xyz: Linear CIE XYZ, shape (..., 3), for example from :func:`warpdiff.reflectance`.
        display: Display transform, as in :meth:`warpdiff.Image.display`: ``"aces"`` shows bright diffraction orders as
            smooth colour gradients, ``"colorimetric"`` is exact for colours within the gamut, ``"clip"`` clips each
            channel.

    Returns:
        R, G and B, each 0 to 1, shape (..., 3).

    Raises:
        ValueError: An argument is out of its range, or the last axis of ``xyz`` has not three elements.

    Examples:
        >>> import warpdiff as wd
        >>> wd.to_srgb([0.2, 0.1, 0.02], "colorimetric", exposure=1.0).round(2)
        array([0.71, 0.  , 0.13])
    """
    shown = DisplaySettings(display=display, **settings)
    colours = validation.finite_array(xyz, "xyz", most=validation.MOST)
    if colours.ndim < 1 or colours.shape[-1] != 3:
        raise ArgumentValueError(f"{ref('xyz')} must have shape (..., 3), got {colours.shape}")
    luminances = colours[..., 1]
    return encode(exposure_factor(shown, luminances[luminances > 0.0]) * colours, shown)


# The linear algebra library is restricted to one thread, because more threads do not make products with 3 × 3 matrices
# faster.
@single_threaded_blas()
def encode(xyz: ArrayLike, shown: DisplaySettings, *, exact: bool = True) -> NDArray[np.float64]:
    """Transform colours to display RGB from 0 to 1, with the transfer function of sRGB.

    Args:
        xyz: Linear CIE XYZ after exposure, shape (..., 3).
        shown: Options of the display; the options about exposure are not used.
        exact: Whether ACES is computed for each colour. Otherwise its result is interpolated in a table.

    Returns:
        R, G and B, shape (..., 3).
    """
    colours = np.asarray(xyz, dtype=np.float64)
    flat = colours.reshape(-1, 3)
    if exact or len(flat) <= _TOGETHER:
        return _encode(flat, shown, exact=exact).reshape(colours.shape)
    encoded = np.empty_like(flat)

    def encode_part(first: int) -> None:
        part = slice(first, first + _TOGETHER)
        encoded[part] = _encode(flat[part], shown, exact=False)

    parallel_for(encode_part, range(0, len(flat), _TOGETHER), threads=cores())
    return encoded.reshape(colours.shape)


def _encode(flat: NDArray[np.float64], shown: DisplaySettings, *, exact: bool) -> NDArray[np.float64]:
    """Return the display RGB of XYZ colours (n, 3); the arguments are those of :func:`encode`."""
    to_rgb = GAMUTS[shown.gamut].xyz_to_rgb
    if shown.display == "clip":
        return colorimetry.srgb_encode(flat @ to_rgb.T)
    if shown.display == "colorimetric":
        return colorimetry.srgb_encode(_reduce_chroma(flat, to_rgb))
    compressed = compress_chroma(flat)
    return aces(compressed, shown.gamut) if exact else _interpolate(compressed, shown.gamut)


def description(shown: DisplaySettings) -> str:
    """Return a text that describes a display transform, for the metadata of a file."""
    target = GAMUTS[shown.gamut]
    if shown.display == "aces":
        return f"{target.view}, {target.display}, {CONFIGURATION}, after compression of OKLab chroma towards Display P3"
    methods = {"colorimetric": "what is out of gamut at constant OKLab hue", "clip": "each channel cut off"}
    return f"{shown.display}, {target.name}, {methods[shown.display]}"


def aces(xyz: NDArray[np.float64], gamut: GamutName) -> NDArray[np.float64]:
    """Return the display RGB of XYZ colours (n, 3) by the ACES output transform, without chroma compression."""
    if not len(xyz):
        return np.zeros((0, 3))
    target = GAMUTS[gamut]
    row = np.minimum(xyz, WHITE).astype(np.float32)[None]
    with openimageio.in_use() as oiio:
        # OpenImageIO uses only the calling thread, because in a forked child process the library's other threads do not
        # exist.
        buffer = oiio.ImageBufAlgo.ociodisplay(
            oiio.ImageBuf(row), target.display, target.view, fromspace=SCENE, unpremult=False,
            colorconfig=CONFIGURATION, nthreads=1,
        )  # fmt: skip
        pixels = buffer.get_pixels(oiio.FLOAT)
        if buffer.has_error or pixels is None:
            raise RuntimeError(f"OpenColorIO has no {target.view} in {CONFIGURATION}: {buffer.geterror()}")
    return np.asarray(np.clip(np.asarray(pixels[0], dtype=np.float64), 0.0, 1.0))


def oklab(xyz: ArrayLike) -> NDArray[np.float64]:
    """Return OKLab's L, a and b of XYZ colours, shape (..., 3). Multiplying XYZ by k multiplies L, a and b by ∛k."""
    return np.asarray(np.cbrt(np.asarray(xyz, dtype=np.float64) @ _XYZ_TO_CONES.T) @ _ROOTS_TO_LAB.T)


def of_oklab(lab: ArrayLike) -> NDArray[np.float64]:
    """Return the XYZ colours of OKLab's L, a and b, shape (..., 3)."""
    roots = np.asarray(lab, dtype=np.float64) @ _LAB_TO_ROOTS.T
    # Cubes are computed as products, because NumPy's power function requires a hundred times as long.
    return np.asarray(roots * roots * roots @ _CONES_TO_XYZ.T)


def compress_chroma(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return XYZ colours (n, 3) with the chroma compressed into Display P3, at constant lightness and hue of OKLab.

    Colours that are brighter than white stay brighter than white. OKLab is homogeneous: the largest chroma of a colour
    in Display P3 is the colour's lightness L times a function of its hue.
    """
    lab = oklab(xyz)
    chroma = np.hypot(lab[:, 1], lab[:, 2])
    most = np.interp(np.arctan2(lab[:, 2], lab[:, 1]), *most_chroma())
    ratio = chroma / np.maximum(most * lab[:, 0], _LEAST)
    beyond = np.flatnonzero(ratio > UNCHANGED)
    excess = ratio[beyond] - UNCHANGED
    bend = 1.0 / (1.0 - UNCHANGED) - 1.0 / (COMPRESSED - UNCHANGED)
    lab[beyond, 1:] *= ((UNCHANGED + excess / (1.0 + bend * excess)) / ratio[beyond])[:, None]
    compressed = xyz.copy()
    compressed[beyond] = of_oklab(lab[beyond])
    return compressed


@functools.cache
def most_chroma() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return hues [rad] and, for each hue, the largest ratio of chroma to lightness of any colour in Display P3."""
    hues = np.linspace(-np.pi, np.pi, _HUES + 1)
    towards = np.stack([np.zeros_like(hues), np.cos(hues), np.sin(hues)], axis=1)

    def is_in_gamut(chroma: NDArray[np.float64]) -> NDArray[np.bool_]:
        lab = [1.0, 0.0, 0.0] + chroma[:, None] * towards
        return np.asarray((of_oklab(lab) @ _XYZ_TO_P3.T).min(axis=1) >= 0.0)

    return hues, _largest_in_gamut(is_in_gamut, np.full(hues.shape, 2.0))


def _reduce_chroma(xyz: NDArray[np.float64], to_rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the linear RGB of XYZ colours (n, 3), with reduced chroma for colours outside of the gamut.

    Colours with components from 0 to 1 are unchanged. Colours that are brighter than white become white.
    """
    rgb = xyz @ to_rgb.T
    out = np.flatnonzero((rgb < 0.0).any(axis=1) | (rgb > 1.0).any(axis=1))
    lab = oklab(xyz[out])
    lab[:, 0] = np.clip(lab[:, 0], 0.0, 1.0)

    grey, slopes = lab[:, :1], lab[:, 1:] @ _LAB_TO_ROOTS.T[1:]
    roots_to_rgb = (to_rgb @ _CONES_TO_XYZ).T

    def with_chroma(share: NDArray[np.float64]) -> NDArray[np.float64]:
        # The three cone responses of a grey have equal cube roots, the lightness L of the grey. ``slopes`` is the
        # change of the three roots with the fraction of the colour's chroma that is added to the grey.
        roots = grey + share[:, None] * slopes
        return np.asarray((roots * roots * roots) @ roots_to_rgb)

    def is_in_gamut(share: NDArray[np.float64]) -> NDArray[np.bool_]:
        linear = with_chroma(share)
        return np.asarray((linear >= 0.0).all(axis=1) & (linear <= 1.0).all(axis=1))

    rgb[out] = with_chroma(_largest_in_gamut(is_in_gamut, np.ones(len(out))))
    return np.asarray(np.clip(rgb, 0.0, 1.0))


def _largest_in_gamut(
    is_in_gamut: Callable[[NDArray[np.float64]], NDArray[np.bool_]], most: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the largest chroma from 0 to ``most`` for which each colour is in the gamut, by bisection.

    Args:
        is_in_gamut: Function that returns, for an array with the chroma of each colour, whether each colour is in the
            gamut.
        most: Upper bound of the chroma of each colour, shape (n,).
    """
    low, high = np.zeros_like(most), most
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = is_in_gamut(middle)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return low


@functools.cache
def aces_table(gamut: GamutName) -> NDArray[np.float32]:
    """Return the table of ACES display RGB over a cubic grid in linear Display P3, shape (nodes³, 3).

    The grid is in Display P3, because colours after chroma compression have no negative components in this space.
    """
    axis = TOE * np.expm1(np.linspace(0.0, 1.0, _NODES) * np.log1p(WHITE / TOE))
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return aces(nodes @ _P3_TO_XYZ.T, gamut).astype(np.float32)


def _interpolate(xyz: NDArray[np.float64], gamut: GamutName) -> NDArray[np.float64]:
    """Return the ACES display RGB of chroma-compressed XYZ (n, 3), interpolated in tetrahedra of the table.

    A colour is interpolated between four corners of its cubic grid cell. The four corners are those of a path along
    edges of the cell, from the corner with the smallest to the corner with the largest coordinates. The path follows
    the axes in the order of decreasing fractional coordinates of the colour.
    """
    light = np.clip(xyz @ _XYZ_TO_P3.T, 0.0, WHITE)
    places = np.log1p(light / TOE) / np.log1p(WHITE / TOE) * (_NODES - 1)
    first = np.minimum(places.astype(np.int64), _NODES - 2)
    fractions = places - first
    steps = np.array([_NODES * _NODES, _NODES, 1])
    order = np.argsort(-fractions, axis=1, kind="stable")
    weights = np.take_along_axis(fractions, order, axis=1)
    weights = -np.diff(weights, axis=1, prepend=1.0, append=0.0)
    corners = first @ steps
    table = aces_table(gamut)
    encoded = weights[:, :1] * table[corners]
    for k in range(3):
        corners = corners + steps[order[:, k]]
        encoded += weights[:, k + 1 : k + 2] * table[corners]
    return np.asarray(encoded)
