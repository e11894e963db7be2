"""Colorimetry: CIE 1931 2° observer, illuminants, quadrature weights, XYZ to linear sRGB, sRGB encoding.

The colour of a reflectance ρ(λ) under an illuminant S(λ) is ∫ ρ S x̄ȳz̄ dλ / ∫ S ȳ dλ over 380 to 780 nm. The products
S·x̄ȳz̄ come from colour-science at steps of 1 nm and are interpolated linearly. Spectral lines of S that are narrower
than a step keep their power. Sums give the products at 380 and 780 nm the same weight as all others, as is usual in
colorimetry. The products of D65 are stored in a file, because the import of colour-science takes 0.7 s.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref
from warpdiff.optics.spectra import Spectrum, colour_science

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Illuminant = str | Spectrum

# Nanometres per micrometre.
NM_PER_UM = 1e3
# Shortest wavelength of the visible range [nm], over which colours are integrated (a convention). The stored colour
# products of D65 cover exactly this range.
LAMBDA_MIN_NM = 380
# Longest wavelength of the visible range [nm]; see `LAMBDA_MIN_NM`.
LAMBDA_MAX_NM = 780
VISIBLE_NM = np.arange(LAMBDA_MIN_NM, LAMBDA_MAX_NM + 1, dtype=np.float64)
VISIBLE_NM.setflags(write=False)
# Shortest and longest wavelength [nm] of calls, plans and tables of materials; `check_wavelengths` refuses others.
SHORTEST_NM, LONGEST_NM = 100.0, 10_000.0

PRECOMPUTED = {"D65": Path(__file__).with_name("d65.npy")}

# The reflectance ρ is interpolated by a polynomial through this number of wavelengths: six, for a quintic. Cubics
# require up to twice as many wavelengths as quintics for a colour error of 1e-4.
_STENCIL = 6
# The loop that removes negative quadrature weights ends after `_MOST_ROUNDS` rounds. The loop ends earlier if the sum
# of the negative weights is at most `_NEGLIGIBLE` times the sum of all weights, which is the size of rounding errors.
_MOST_ROUNDS, _NEGLIGIBLE = 64, 1e-12

# If a step between tabulated wavelengths is shorter than 1 nm by at most this number [nm], it counts as 1 nm.
# Wavelengths in files are rounded, so that their steps are not exact.
_STEP_ROUNDING = 1e-6

# Matrix from XYZ to linear sRGB (IEC 61966-2-1).
XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
XYZ_TO_RGB.setflags(write=False)
RGB_TO_XYZ = np.linalg.inv(XYZ_TO_RGB)
RGB_TO_XYZ.setflags(write=False)


def check_illuminant_type(illuminant: object, name: str = "illuminant") -> Illuminant:
    """Return ``illuminant`` if it is a spectrum or a string; raise ``TypeError`` otherwise. The name is not checked."""
    if not isinstance(illuminant, (str, Spectrum)):
        raise ArgumentTypeError(
            f"{ref(name)} must be the name of a CIE illuminant, such as 'D65', or a warpdiff.Spectrum, got "
            f"{type(illuminant).__name__}"
        )
    return illuminant


def check_illuminant(illuminant: object, name: str = "illuminant") -> Illuminant:
    """Return a spectrum, or the name of an illuminant that covers 380 to 780 nm; raise ``ValueError`` otherwise."""
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


def is_known_illuminant(name: str) -> bool:
    """Return whether a text is the name of an illuminant or light source, such as ``"D65"`` or ``"FL3.1"``."""
    return name in PRECOMPUTED or _distribution(name) is not None


def _distribution(illuminant: str) -> Any:
    """Return the spectrum of an illuminant or light source in colour-science by its name; None if there is none."""
    for distributions in (colour_science().SDS_ILLUMINANTS, colour_science().SDS_LIGHT_SOURCES):
        if illuminant in distributions:
            return distributions[illuminant]
    return None


@functools.cache
def _tabulated_nm(illuminant: str) -> tuple[float, float] | None:
    """Return the first and last tabulated wavelength of an illuminant [nm] by its name; None if the name is unknown.

    The result is cached, because the look-up in colour-science requires half a millisecond.
    """
    distribution = _distribution(illuminant)
    return None if distribution is None else (float(distribution.shape.start), float(distribution.shape.end))


@functools.lru_cache(maxsize=256)
def colour_products(illuminant: Illuminant = "D65") -> NDArray[np.float64]:
    """Return S·(x̄, ȳ, z̄) at 380, 381, … 780 nm for an illuminant S, divided by the sum of S·ȳ, shape (401, 3).

    Args:
        illuminant: Name in ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES`` of colour-science, or a spectrum.

    Returns:
        The products. Their column sums are the XYZ of a perfect mirror, (0.950423, 1, 1.088610) for D65.
    """
    name = check_illuminant(illuminant)
    if isinstance(name, Spectrum):
        products = _products(_at_whole_nanometres(np.asarray(name.wavelengths_nm), np.asarray(name.values)))
    else:
        products = np.load(PRECOMPUTED[name]) if name in PRECOMPUTED else products_by_colour_science(name)
    products.setflags(write=False)
    return products


def _at_whole_nanometres(wavelengths_nm: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values of a spectrum at 380, 381, … 780 nm, whose sum is the power of the spectrum, shape (401,).

    A spectrum with steps of at least 1 nm is interpolated linearly. A spectrum with finer steps may have narrow lines
    between whole nanometres, which interpolation would miss. The power between two whole nanometres is therefore
    distributed to both: a whole nanometre at the distance d [nm] from a wavelength gets the share 1 − d of the power at
    this wavelength.
    """
    inside = (wavelengths_nm > LAMBDA_MIN_NM - 1) & (wavelengths_nm < LAMBDA_MAX_NM + 1)
    if np.min(np.diff(wavelengths_nm[inside]), initial=1.0) >= 1.0 - _STEP_ROUNDING:
        return np.asarray(np.interp(VISIBLE_NM, wavelengths_nm, values))
    cuts = np.unique(np.concatenate([VISIBLE_NM, np.clip(wavelengths_nm, LAMBDA_MIN_NM, LAMBDA_MAX_NM)]))
    # The power is integrated between consecutive cuts, which are all whole nanometres and all wavelengths of the
    # spectrum. Between two cuts, the spectrum and the share of each whole nanometre are linear functions of the
    # wavelength. Simpson's rule is exact for the product of two linear functions.
    left, length = cuts[:-1], np.diff(cuts)
    result = np.zeros(len(VISIBLE_NM))
    for place, weight in ((0.0, 1.0 / 6.0), (0.5, 4.0 / 6.0), (1.0, 1.0 / 6.0)):
        points = left + place * length
        power = weight * length * np.interp(points, wavelengths_nm, values)
        before = np.clip(np.floor(left - LAMBDA_MIN_NM).astype(np.int64), 0, len(VISIBLE_NM) - 2)
        share = points - VISIBLE_NM[before]
        np.add.at(result, before, power * (1.0 - share))
        np.add.at(result, before + 1, power * share)
    # The first and the last value contain the spectrum of only half a nanometre, because the visible range ends there.
    # Both values are doubled, because sums over wavelengths give all values the same weight.
    result[[0, -1]] *= 2.0
    return result


def products_by_colour_science(name: str) -> NDArray[np.float64]:
    """Return the result of `colour_products` for the name of an illuminant, computed by colour-science."""
    return _products(_distribution(name).copy().align(_shape()).values)


@functools.cache
def _tabulated(illuminant: Illuminant) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return wavelengths [nm] and spectral powers of an illuminant, and the mean of the powers with the weight ȳ."""
    if isinstance(illuminant, Spectrum):
        wavelengths, values = np.asarray(illuminant.wavelengths_nm), np.asarray(illuminant.values)
        visible = _at_whole_nanometres(wavelengths, values)
    else:
        start, end = _tabulated_nm(illuminant) or (LAMBDA_MIN_NM, LAMBDA_MAX_NM)
        shape = colour_science().SpectralShape(math.ceil(start), math.floor(end), 1)
        distribution = _distribution(illuminant).copy().align(shape)
        wavelengths, values = distribution.wavelengths, distribution.values
        visible = np.interp(VISIBLE_NM, wavelengths, values)
    luminous = _observer()[:, 1]
    return wavelengths, values, float(visible @ luminous / luminous.sum())


def relative_powers(illuminant: Illuminant, wavelengths_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return S(λ) / S̄ of an illuminant S at wavelengths [nm], shape (m,).

    S̄ is the mean of S with the weight ȳ. The equal-energy illuminant has the relative power 1.

    Raises:
        ValueError: The spectrum of the illuminant does not cover one of the wavelengths.
    """
    known_nm, values, mean = _tabulated(check_illuminant(illuminant))
    if wavelengths_nm.min() < known_nm[0] or wavelengths_nm.max() > known_nm[-1]:
        raise ArgumentValueError(
            f"{ref('wavelengths_nm')} must lie within the range of the illuminant {str(illuminant)!r}, {known_nm[0]:g} "
            f"to {known_nm[-1]:g} nm, got {wavelengths_nm.min():g} to {wavelengths_nm.max():g} nm"
        )
    return np.asarray(np.interp(wavelengths_nm, known_nm, values) / mean)


def _observer() -> NDArray[np.float64]:
    """Return x̄, ȳ and z̄ of the CIE 1931 observer at 380, 381, … 780 nm, shape (401, 3)."""
    curves = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(_shape()).values
    return np.asarray(curves, dtype=np.float64)


def _shape() -> Any:
    return colour_science().SpectralShape(LAMBDA_MIN_NM, LAMBDA_MAX_NM, 1)


def _products(source: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return S·(x̄, ȳ, z̄) divided by the sum of S·ȳ, for a spectrum S with steps of 1 nm."""
    observer = _observer()
    # Negative values are replaced by 0. They occur because colour-science interpolates the colour-matching functions to
    # 1 nm, which gives −1e-24 at their ends.
    products = np.maximum(np.asarray(observer * source[:, None], dtype=np.float64), 0.0)
    return np.asarray(products / products[:, 1].sum())


def quadrature_weights(
    wavelengths_nm: ArrayLike, illuminant: Illuminant = "D65", *, signed: bool = False
) -> NDArray[np.float64]:
    """Return the weights by which samples of the reflectance ρ(λ) are summed to XYZ.

    ρ is interpolated in 1/λ by the quintic polynomial through the six nearest samples, and is constant outside them.
    The product of this polynomial with S·(x̄, ȳ, z̄) of the illuminant S is integrated. The weights are scaled so that
    ρ = 1 has exactly the colour of a perfect mirror. Linear interpolation would have an error of 1e-2 for a narrow
    diffraction order at a wavelength at which x̄, ȳ or z̄ is steep. Cubic interpolation would require up to twice as
    many samples at a tolerance of 1e-4. Weights can become negative where x̄, ȳ or z̄ falls to 0, or where lines of the
    illuminant are closer together than the samples. Half of a negative weight is added to each of its two neighbours.
    This changes colours by up to 1e-3, or 1e-10 with hundreds of samples; ``signed`` weights are exact instead.

    Args:
        wavelengths_nm: Strictly increasing wavelengths [nm], shape (m,).
        illuminant: Name in ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES`` of colour-science, or a spectrum.
        signed: Whether weights may be negative, by default False.

    Returns:
        Weights, shape (m, 3), none negative unless ``signed``: XYZ = ρ @ weights.
    """
    nodes = check_wavelengths(wavelengths_nm)
    if np.any(np.diff(nodes) <= 0.0):
        raise ArgumentValueError(f"{ref('wavelengths_nm')} must be strictly increasing")
    products = colour_products(illuminant)
    grid = VISIBLE_NM
    # The integral is computed over intervals between consecutive cuts. The cuts are all whole nanometres and all
    # wavelengths of the samples. The integrand has kinks only at the cuts, so that three Gauss points per interval
    # suffice.
    cuts = np.union1d(grid, nodes[(nodes > grid[0]) & (nodes < grid[-1])])
    left, length = cuts[:-1, None], np.diff(cuts)[:, None]
    gauss, measure = np.polynomial.legendre.leggauss(3)
    points = np.concatenate([(left + length * (gauss + 1.0) / 2.0).ravel(), grid[[0, -1]]])
    measures = np.concatenate([(length * measure / 2.0).ravel(), [0.5, 0.5]])
    masses = measures[:, None] * np.stack([np.interp(points, grid, products[:, c]) for c in range(3)], axis=1)

    weights = _interpolation_weights(nodes, points, masses)
    if not signed:
        weights = _without_negative(weights)
    return np.asarray(weights * (products.sum(axis=0) / weights.sum(axis=0)))


def _interpolation_weights(
    nodes: NDArray[np.float64], points: NDArray[np.float64], masses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return weights of values of the reflectance ρ at ``nodes``, for a weighted sum of interpolated values of ρ.

    Lagrange polynomials in 1/λ interpolate ρ from the m wavelengths ``nodes`` to the p wavelengths ``points``. The sum
    gives the interpolated values the weights ``masses``, shape (p, 3). The result has the shape (m, 3).
    """
    stencil = min(_STENCIL, nodes.size)
    tau, targets = 1.0 / nodes, 1.0 / np.clip(points, nodes[0], nodes[-1])
    first = np.clip(np.searchsorted(nodes, points) - stencil // 2, 0, nodes.size - stencil)
    weights = np.zeros((3, nodes.size))
    near = tau[first[:, None] + np.arange(stencil)].T
    for k in range(stencil):
        share = np.ones_like(points)
        for j in range(stencil):
            if j != k:
                share *= (targets - near[j]) / (near[k] - near[j])
        for channel in range(3):
            weights[channel] += np.bincount(first + k, share * masses[:, channel], nodes.size)
    return np.ascontiguousarray(weights.T)


def _without_negative(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Add half of each negative weight of a wavelength to each of its two neighbours, and replace it by 0.

    The addition is repeated, because it can make neighbouring weights negative. Weighted sums over a smooth reflectance
    hardly change.
    """
    for _ in range(_MOST_ROUNDS):
        negative = np.minimum(weights, 0.0)
        if np.all(negative.sum(axis=0) >= -_NEGLIGIBLE * weights.sum(axis=0)):
            break
        halves = 0.5 * negative
        weights = weights - negative
        weights[1:] += halves[:-1]
        weights[:-1] += halves[1:]
        # The weights of the first and the last wavelength have only one neighbour. The other half of a negative weight
        # remains there.
        weights[0] += halves[0]
        weights[-1] += halves[-1]
    return np.maximum(weights, 0.0)


def wavelengths_uniform_in_wavenumber(count: int) -> NDArray[np.float64]:
    """Return ``count`` increasing wavelengths [nm], equally spaced in 1/λ over the visible range, ends included.

    Steps are equal in 1/λ because, in a fixed direction, the light of a Fourier coefficient is a Gaussian function of
    1/λ, whose width is the same for all coefficients.
    """
    validation.count(count, "count", least=2)
    return 1.0 / np.linspace(1.0 / LAMBDA_MIN_NM, 1.0 / LAMBDA_MAX_NM, count)


@functools.lru_cache(maxsize=256)
def uniform_quadrature(
    count: int, illuminant: Illuminant, *, geometric: bool = False, signed: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``count`` wavenumbers 1/λ [1/µm] over the visible range, shape (m,), and their weights, shape (m, 3).

    The wavenumbers are equally spaced. With ``geometric``, the ratios of consecutive wavenumbers are equal. This is for
    a source of finite size: the light of a Fourier coefficient is then a peak over 1/λ whose width is proportional to
    1/λ.
    """
    wavelengths = wavelengths_uniform_in_wavenumber(count)
    if geometric:
        wavelengths = np.geomspace(LAMBDA_MIN_NM, LAMBDA_MAX_NM, count)
    wavenumbers, weights = NM_PER_UM / wavelengths, quadrature_weights(wavelengths, illuminant, signed=signed)
    wavenumbers.setflags(write=False)
    weights.setflags(write=False)
    return wavenumbers, weights


def check_wavelengths(wavelengths_nm: ArrayLike) -> NDArray[np.float64]:
    """Return wavelengths [nm] as a float64 array of shape (m,); refuse values outside 100 to 10,000 nm."""
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
    """Return linear sRGB of CIE XYZ, shape (..., 3). Colours outside the gamut of sRGB have negative components."""
    return np.asarray(np.asarray(xyz, dtype=np.float64) @ XYZ_TO_RGB.T)


def rgb_to_xyz(rgb: ArrayLike) -> NDArray[np.float64]:
    """CIE XYZ of linear sRGB, shape (..., 3)."""
    return np.asarray(np.asarray(rgb, dtype=np.float64) @ RGB_TO_XYZ.T)


def colour_difference(xyz: ArrayLike, other: ArrayLike) -> NDArray[np.float64]:
    """Return the colour difference ΔE2000 (CIE 142) of XYZ colours, shape (..., 3); white is D65 with Y = 1."""
    colour = colour_science()
    white = colour.XYZ_to_xy(colour_products("D65").sum(axis=0))
    labs = [colour.XYZ_to_Lab(np.asarray(colours, dtype=np.float64), white) for colours in (xyz, other)]
    return np.asarray(colour.delta_E(*labs, method="CIE 2000"))


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """Encode linear values, clipped to [0, 1], by the sRGB transfer function (IEC 61966-2-1)."""
    clipped = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Inverse of :func:`srgb_encode` for values in [0, 1]."""
    values = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
