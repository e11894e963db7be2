"""Colorimetry: CIE 1931 2° observer, illuminants, quadrature weights, XYZ to linear sRGB, sRGB encoding.

The colour of a reflectance ρ(λ) is ∫ ρ S x̄ȳz̄ dλ / ∫ S ȳ dλ over 380 to 780 nm. The products S·x̄ȳz̄ are taken at
1 nm from colour-science and interpolated linearly in between; the two end points count with full weight, so that
ρ = 1 gives exactly the 1 nm sum. Those of D65 are precomputed in a file, as colour-science takes 0.7 s to import.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref
from warpdiff.optics.spectra import Spectrum, colour_science

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Illuminant = str | Spectrum

NM_PER_UM = 1e3
# The visible range, over which colours are integrated [nm].
LAMBDA_MIN_NM = 380
LAMBDA_MAX_NM = 780
VISIBLE_NM = np.arange(LAMBDA_MIN_NM, LAMBDA_MAX_NM + 1, dtype=np.float64)
VISIBLE_NM.setflags(write=False)
# Limits of the wavelengths that a caller may pass.
SHORTEST_NM, LONGEST_NM = 100.0, 10_000.0

PRECOMPUTED = {"D65": Path(__file__).with_name("d65.npy")}

# Samples that an interpolant goes through.
_STENCIL = 6
# Negative weights are shared out so often at most, and down to this share of all.
_SHARED_OUT, _NOTHING = 64, 1e-12

# IEC 61966-2-1.
XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
XYZ_TO_RGB.setflags(write=False)
RGB_TO_XYZ = np.linalg.inv(XYZ_TO_RGB)
RGB_TO_XYZ.setflags(write=False)


def check_illuminant_type(illuminant: object, name: str = "illuminant") -> Illuminant:
    """Return a spectrum or a name, which may be of no illuminant, or raise ``TypeError``."""
    if not isinstance(illuminant, (str, Spectrum)):
        raise ArgumentTypeError(
            f"{ref(name)} must be the name of a CIE illuminant, such as 'D65', or a warpdiff.Spectrum, got "
            f"{type(illuminant).__name__}"
        )
    return illuminant


def check_illuminant(illuminant: Any, name: str = "illuminant") -> Illuminant:
    """Return an illuminant, a spectrum or a name of one that covers 380 to 780 nm, or raise ``ValueError``."""
    checked = check_illuminant_type(illuminant, name)
    if isinstance(checked, Spectrum) or checked in PRECOMPUTED:
        return checked
    range_nm = _tabulated_nm(checked)
    if range_nm is None:
        names = sorted(colour_science().SDS_ILLUMINANTS)
        raise ArgumentValueError(
            f"{ref(name)} must be one of {', '.join(names[:12])}, … ({len(names)} illuminants and the light sources of "
            f"colour-science), or a spectrum, got {illuminant!r}{did_you_mean(checked, names)}"
        )
    start, end = range_nm
    if start > LAMBDA_MIN_NM or end < LAMBDA_MAX_NM:
        raise ArgumentValueError(
            f"{ref(name)} must cover {LAMBDA_MIN_NM} to {LAMBDA_MAX_NM} nm, "
            f"but {illuminant!r} is tabulated from {start:g} to {end:g} nm"
        )
    return checked


def _distribution(illuminant: str) -> Any:
    """The spectrum of colour-science of a name, of an illuminant or a light source; None if there is none."""
    for distributions in (colour_science().SDS_ILLUMINANTS, colour_science().SDS_LIGHT_SOURCES):
        if illuminant in distributions:
            return distributions[illuminant]
    return None


@functools.cache
def _tabulated_nm(illuminant: str) -> tuple[float, float] | None:
    """The first and the last wavelength of an illuminant of this name; to look one up takes half a millisecond."""
    distribution = _distribution(illuminant)
    return None if distribution is None else (float(distribution.shape.start), float(distribution.shape.end))


@functools.lru_cache(maxsize=256)
def colour_products(illuminant: Illuminant = "D65") -> NDArray[np.float64]:
    """S·(x̄, ȳ, z̄) at 380, 381, … 780 nm over the 1 nm sum of S·ȳ, shape (401, 3).

    Args:
        illuminant: A name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a spectrum.

    Returns:
        The products; their column sums are the XYZ of a perfect mirror, (0.950423, 1, 1.088610) for D65.
    """
    name = check_illuminant(illuminant)
    if isinstance(name, Spectrum):
        products = _products(np.interp(VISIBLE_NM, np.asarray(name.wavelengths_nm), np.asarray(name.values)))
    else:
        products = np.load(PRECOMPUTED[name]) if name in PRECOMPUTED else products_by_colour_science(name)
    products.setflags(write=False)
    return products


def products_by_colour_science(name: str) -> NDArray[np.float64]:
    """``colour_products`` of an illuminant, without the precomputed ones."""
    return _products(_distribution(name).copy().align(_shape()).values)


def _shape() -> Any:
    return colour_science().SpectralShape(LAMBDA_MIN_NM, LAMBDA_MAX_NM, 1)


def _products(source: NDArray[np.float64]) -> NDArray[np.float64]:
    """S·(x̄, ȳ, z̄) over the sum of S·ȳ, of a spectrum at 1 nm."""
    observer = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(_shape()).values
    # The interpolation to 1 nm leaves values of −1e-24 where the curves end.
    products = np.maximum(np.asarray(observer * source[:, None], dtype=np.float64), 0.0)
    return np.asarray(products / products[:, 1].sum())


def quadrature_weights(wavelengths_nm: ArrayLike, illuminant: Illuminant = "D65") -> NDArray[np.float64]:
    """Weights that turn samples of ρ(λ) into XYZ.

    ρ is interpolated in 1/λ by the quintic through the six nearest samples and held constant outside them; its product
    with the colour curves is integrated, and the weights are scaled to the exact white. Interpolated linearly, a narrow
    order would see the curves blurred over the distance of two samples, which costs 1e-2 where they are steep; cubics
    take up to twice the samples at a tolerance of 1e-4. Where a curve ends, or between samples further apart than
    lines of the illuminant, weights may turn negative: their neighbours take these over.

    Args:
        wavelengths_nm: Strictly increasing wavelengths [nm], shape (m,).
        illuminant: A name in colour-science's ``SDS_ILLUMINANTS``.

    Returns:
        Weights, shape (m, 3), none negative: XYZ = ρ @ weights.
    """
    nodes = check_wavelengths(wavelengths_nm)
    if np.any(np.diff(nodes) <= 0.0):
        raise ArgumentValueError(f"{ref('wavelengths_nm')} must be strictly increasing")
    products = colour_products(illuminant)
    grid = VISIBLE_NM
    # Between two of these both the curves and the interpolant are smooth: three Gauss points each.
    cuts = np.union1d(grid, nodes[(nodes > grid[0]) & (nodes < grid[-1])])
    left, length = cuts[:-1, None], np.diff(cuts)[:, None]
    gauss, measure = np.polynomial.legendre.leggauss(3)
    points = np.concatenate([(left + length * (gauss + 1.0) / 2.0).ravel(), grid[[0, -1]]])
    measures = np.concatenate([(length * measure / 2.0).ravel(), [0.5, 0.5]])
    masses = measures[:, None] * np.stack([np.interp(points, grid, products[:, c]) for c in range(3)], axis=1)

    weights = _without_negative(_interpolation_weights(nodes, points, masses))
    return np.asarray(weights * (products.sum(axis=0) / weights.sum(axis=0)))


def _interpolation_weights(
    nodes: NDArray[np.float64], points: NDArray[np.float64], masses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Masses at points, shape (p, 3), given to the nearest nodes by Lagrange interpolation in 1/λ, shape (m, 3)."""
    stencil = min(_STENCIL, nodes.size)
    tau, targets = 1.0 / nodes, 1.0 / np.clip(points, nodes[0], nodes[-1])
    first = np.clip(np.searchsorted(nodes, points) - stencil // 2, 0, nodes.size - stencil)
    weights = np.zeros((nodes.size, 3))
    for k in range(stencil):
        share = np.ones_like(points)
        for j in range(stencil):
            if j != k:
                share *= (targets - tau[first + j]) / (tau[first + k] - tau[first + j])
        np.add.at(weights, first + k, share[:, None] * masses)
    return weights


def _without_negative(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights with half of what is negative given to either side, over and over: a smooth ρ sees no difference."""
    for _ in range(_SHARED_OUT):
        negative = np.minimum(weights, 0.0)
        if np.all(negative.sum(axis=0) >= -_NOTHING * weights.sum(axis=0)):
            break
        halves = np.pad(0.5 * negative, ((1, 1), (0, 0)), "edge")
        weights = weights - negative + halves[:-2] + halves[2:]
    return np.maximum(weights, 0.0)


def wavelengths_uniform_in_wavenumber(count: int) -> NDArray[np.float64]:
    """``count`` wavelengths [nm], increasing, equally spaced in 1/λ over the visible range, ends included.

    A Fourier coefficient crosses a direction as a Gaussian in 1/λ, of the same width throughout the spectrum.
    """
    validation.count(count, "count", least=2)
    return 1.0 / np.linspace(1.0 / LAMBDA_MIN_NM, 1.0 / LAMBDA_MAX_NM, count)


@functools.lru_cache(maxsize=256)
def uniform_quadrature(
    count: int, illuminant: Illuminant, *, geometric: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``count`` wavenumbers [1/µm] over the visible range, shape (m,), and weights, shape (m, 3).

    They are equally spaced, or, ``geometric``, have equal ratios: under a source of some angular size a coefficient's
    Gaussian has a width in proportion to λ.
    """
    wavelengths = wavelengths_uniform_in_wavenumber(count)
    if geometric:
        wavelengths = np.geomspace(LAMBDA_MIN_NM, LAMBDA_MAX_NM, count)
    wavenumbers, weights = NM_PER_UM / wavelengths, quadrature_weights(wavelengths, illuminant)
    wavenumbers.setflags(write=False)
    weights.setflags(write=False)
    return wavenumbers, weights


def check_wavelengths(wavelengths_nm: ArrayLike) -> NDArray[np.float64]:
    """Return wavelengths [nm] as a float64 array of shape (m,), each within 100 to 10,000 nm.

    The wide range admits infrared and ultraviolet; micrometres given for nanometres are refused.
    """
    nodes = np.atleast_1d(validation.finite_array(wavelengths_nm, "wavelengths_nm"))
    if nodes.ndim != 1 or nodes.size == 0:
        raise ArgumentValueError(f"{ref('wavelengths_nm')} must have shape (m,), got {nodes.shape}")
    if nodes.min() < SHORTEST_NM or nodes.max() > LONGEST_NM:
        raise ArgumentValueError(
            f"{ref('wavelengths_nm')} must lie within {SHORTEST_NM:g} to {LONGEST_NM:g} nm, got {nodes.min():g} to "
            f"{nodes.max():g}: give wavelengths in nanometres"
        )
    return nodes


def xyz_to_rgb(xyz: ArrayLike) -> NDArray[np.float64]:
    """Linear sRGB of CIE XYZ, shape (..., 3); colours out of gamut keep their negative components."""
    return np.asarray(np.asarray(xyz, dtype=np.float64) @ XYZ_TO_RGB.T)


def rgb_to_xyz(rgb: ArrayLike) -> NDArray[np.float64]:
    """CIE XYZ of linear sRGB, shape (..., 3)."""
    return np.asarray(np.asarray(rgb, dtype=np.float64) @ RGB_TO_XYZ.T)


def colour_difference(xyz: ArrayLike, other: ArrayLike) -> NDArray[np.float64]:
    """ΔE2000 (CIE 142) between XYZ, shape (..., 3), relative to D65's white of Y = 1."""
    colour = colour_science()
    white = colour.XYZ_to_xy(colour_products("D65").sum(axis=0))
    labs = [colour.XYZ_to_Lab(np.asarray(colours, dtype=np.float64), white) for colours in (xyz, other)]
    return np.asarray(colour.delta_E(*labs, method="CIE 2000"))


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """SRGB transfer function (IEC 61966-2-1): linear values, clipped to [0, 1], to encoded ones."""
    clipped = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Inverse of :func:`srgb_encode` for values in [0, 1]."""
    values = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
