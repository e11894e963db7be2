"""Colour: CIE 1931 2° observer, illuminants, quadrature weights, XYZ to linear sRGB, sRGB encoding.

The colour of a reflectance ρ(λ) is ∫ ρ S x̄ȳz̄ dλ / ∫ S ȳ dλ over 380 to 780 nm. The products S·x̄ȳz̄ are taken at
1 nm from colour-science and interpolated linearly in between; the two end points count with full weight, so that
ρ = 1 gives exactly the 1 nm sum.
"""

from __future__ import annotations

import functools
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import checks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

LAMBDA_MIN_NM = 380
LAMBDA_MAX_NM = 780

# IEC 61966-2-1.
XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
XYZ_TO_RGB.setflags(write=False)
RGB_TO_XYZ = np.linalg.inv(XYZ_TO_RGB)
RGB_TO_XYZ.setflags(write=False)


def _colour() -> Any:
    with warnings.catch_warnings():
        # colour-science announces at import which of its optional packages are absent; none is used here.
        warnings.simplefilter("ignore")
        import colour

    return colour


def check_illuminant(illuminant: Any, name: str = "illuminant") -> str:
    """Return the name of an illuminant that covers 380 to 780 nm, or raise ``ValueError``."""
    if not isinstance(illuminant, str):
        raise TypeError(f"{name} must be the name of a CIE illuminant, such as 'D65', got {type(illuminant).__name__}")
    distributions = _colour().SDS_ILLUMINANTS
    if illuminant not in distributions:
        raise ValueError(f"{name} must be one of {', '.join(sorted(distributions))}, got {illuminant!r}")
    shape = distributions[illuminant].shape
    if shape.start > LAMBDA_MIN_NM or shape.end < LAMBDA_MAX_NM:
        raise ValueError(
            f"{name} must cover {LAMBDA_MIN_NM} to {LAMBDA_MAX_NM} nm, "
            f"but {illuminant!r} is tabulated from {shape.start:g} to {shape.end:g} nm"
        )
    return illuminant


@functools.cache
def colour_products(illuminant: str = "D65") -> NDArray[np.float64]:
    """S·(x̄, ȳ, z̄) at 380, 381, … 780 nm over the 1 nm sum of S·ȳ, shape (401, 3).

    Args:
        illuminant: A name in colour-science's ``SDS_ILLUMINANTS``.

    Returns:
        The products; their column sums are the XYZ of a perfect mirror, (0.950423, 1, 1.088610) for D65.
    """
    name = check_illuminant(illuminant)
    colour = _colour()
    shape = colour.SpectralShape(LAMBDA_MIN_NM, LAMBDA_MAX_NM, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    source = colour.SDS_ILLUMINANTS[name].copy().align(shape).values
    # The interpolation to 1 nm leaves values of −1e-24 where the curves end.
    products = np.maximum(np.asarray(observer * source[:, None], dtype=np.float64), 0.0)
    products /= products[:, 1].sum()
    products.setflags(write=False)
    return products


def quadrature_weights(wavelengths_nm: ArrayLike, illuminant: str = "D65") -> NDArray[np.float64]:
    """Weights that turn samples of ρ(λ) into XYZ.

    ρ is taken as linear between the samples and constant outside them; its product with the colour curves is then
    integrated exactly. The weights are never negative, and a constant ρ gives the exact white for any set.

    Args:
        wavelengths_nm: Strictly increasing wavelengths [nm], shape (m,).
        illuminant: A name in colour-science's ``SDS_ILLUMINANTS``.

    Returns:
        Weights, shape (m, 3): XYZ = ρ @ weights.
    """
    nodes = check_wavelengths(wavelengths_nm)
    if np.any(np.diff(nodes) <= 0.0):
        raise ValueError("wavelengths_nm must be strictly increasing")
    products = colour_products(illuminant)
    grid = np.arange(LAMBDA_MIN_NM, LAMBDA_MAX_NM + 1, dtype=np.float64)
    inside = nodes[(nodes > grid[0]) & (nodes < grid[-1])]
    cuts = np.union1d(grid, inside)
    # Between two cuts both factors are linear, so that Simpson's rule is exact.
    left, right = cuts[:-1], cuts[1:]
    length = right - left
    points = np.concatenate([left, (left + right) / 2.0, right, grid[[0, -1]]])
    measure = np.concatenate([length / 6.0, length * (4.0 / 6.0), length / 6.0, [0.5, 0.5]])
    masses = measure[:, None] * np.stack([np.interp(points, grid, products[:, c]) for c in range(3)], axis=1)
    if nodes.size == 1:
        return np.asarray(masses.sum(axis=0, keepdims=True))
    weights = np.zeros((nodes.size, 3))
    upper = np.clip(np.searchsorted(nodes, points, side="right"), 1, nodes.size - 1)
    fraction = np.clip((points - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1]), 0.0, 1.0)
    np.add.at(weights, upper - 1, (1.0 - fraction)[:, None] * masses)
    np.add.at(weights, upper, fraction[:, None] * masses)
    return weights


def wavelengths_uniform_in_wavenumber(count: int) -> NDArray[np.float64]:
    """``count`` wavelengths [nm], increasing, equally spaced in 1/λ over the visible range, ends included.

    A Fourier coefficient crosses a direction as a Gaussian in 1/λ, of the same width throughout the spectrum.
    """
    checks.count(count, "count", least=2)
    return 1.0 / np.linspace(1.0 / LAMBDA_MIN_NM, 1.0 / LAMBDA_MAX_NM, count)


def check_wavelengths(wavelengths_nm: ArrayLike) -> NDArray[np.float64]:
    """Return wavelengths [nm] as a float64 array of shape (m,), each within 100 to 10,000 nm.

    The wide range admits infrared and ultraviolet; micrometres given for nanometres are refused.
    """
    nodes = np.atleast_1d(checks.finite_array(wavelengths_nm, "wavelengths_nm"))
    if nodes.ndim != 1 or nodes.size == 0:
        raise ValueError(f"wavelengths_nm must have shape (m,), got {nodes.shape}")
    if nodes.min() < 100.0 or nodes.max() > 10_000.0:
        raise ValueError(
            f"wavelengths_nm must lie within 100 to 10000 nm, got {nodes.min():g} to {nodes.max():g}; "
            "they are nanometres"
        )
    return nodes


def xyz_to_rgb(xyz: ArrayLike) -> NDArray[np.float64]:
    """Linear sRGB of CIE XYZ, shape (..., 3); colours out of gamut keep their negative components."""
    return np.asarray(np.asarray(xyz, dtype=np.float64) @ XYZ_TO_RGB.T)


def rgb_to_xyz(rgb: ArrayLike) -> NDArray[np.float64]:
    """CIE XYZ of linear sRGB, shape (..., 3)."""
    return np.asarray(np.asarray(rgb, dtype=np.float64) @ RGB_TO_XYZ.T)


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """SRGB transfer function (IEC 61966-2-1): linear values, clipped to [0, 1], to encoded ones."""
    clipped = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Inverse of :func:`srgb_encode` for values in [0, 1]."""
    values = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
