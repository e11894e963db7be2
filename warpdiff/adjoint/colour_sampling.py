"""Wavelengths at which a colour must be sampled to meet a truncation error.

The relative reflectance ρ is interpolated between the sampled wavelengths λ by quintic polynomials in 1/λ. The error of
the interpolation is computed from the fastest change of ρ with 1/λ. The index of refraction of a material is linear
between the entries of its table. The reflectance of the material therefore has kinks, which polynomials cannot follow.
The number of wavelengths is doubled until the colour of the flat material meets the truncation error.

σ is the standard deviation of a coherence window, q = (u, v)/λ the spatial frequency of a direction, and θd half of the
angle between the directions to light and viewer.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint import reflection
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum

# Smallest and largest number of wavelengths at which a colour is sampled. The smallest number is limited by quintic
# polynomials, which need six nodes (wavelengths). The largest number is limited by the computing time, which is
# proportional to the number.
LEAST_WAVELENGTHS, MOST_WAVELENGTHS = 12, 20_000
# Error of the quintic interpolation of a sine wave of amplitude 1, divided by (angular frequency × step)⁶. The value
# was derived from the error formula of polynomial interpolation. At the middle of six nodes, the distances from the
# nodes are 0.5, 1.5 and 2.5 steps to each side; their product is divided by 6!.
_QUINTIC = (0.5 * 1.5 * 2.5) ** 2 / 720.0
# Angular frequency ω of a sine wave that is interpolated with the same error as a Gaussian of standard deviation 1. The
# error is proportional to the sixth derivative. This derivative is at most ω⁶ for the sine wave, and at most 15 times
# the maximum for the Gaussian.
OF_GAUSSIAN = 15.0 ** (1.0 / 6.0)
# Largest permitted error of the colour of the flat material, as a fraction of the truncation error. The error is
# computed at three angles only. The fraction leaves a margin of a factor of 2 for the angles between them.
_SHARE_OF_MATERIAL = 0.5
# Number of points of the Gauss quadrature between two neighbouring kinks (jumps of the slope) of the integrand, which
# are at most 1 nm apart. With this number, the error for thin films of up to 1 µm is a rounding error.
_GAUSS_POINTS = 4


def counts_of(rates: NDArray[np.float64], span: float, truncation: float) -> NDArray[np.int64]:
    """Return how many equally spaced samples (nodes) quintic interpolation of each of n functions requires.

    Args:
        rates: Largest angular frequency of each function [radians per unit of its argument], shape (n,).
        span: Length of the range of the argument that the nodes cover.
        truncation: Permitted relative error of the interpolation.
    """
    step = (truncation / _QUINTIC) ** (1.0 / 6.0) / np.maximum(rates, 1e-9)
    return np.asarray(np.maximum(np.ceil(span / step).astype(np.int64) + 1, LEAST_WAVELENGTHS))


def sampling(
    lights: NDArray[np.float64], views: NDArray[np.float64], scale_um: float, size_um: tuple[float, float],
    coherence: Coherence, material: Material | None, illuminant: str | Spectrum, truncation: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Return the wavelengths [nm] of a colour, shape (m,), and the weights that sum reflectances to XYZ, (m, 3).

    The wavelengths are equally spaced in 1/λ, or in ln λ if the coherence is that of a light source of finite size.

    Args:
        lights: Unit vectors to the light, shape (n, 3).
        views: Unit vectors to the viewer, shape (n, 3).
        scale_um: Half of the height range [µm].
        size_um: Size of the surface (y, x) [µm].
        coherence: Coherence of the light.
        material: Material of the surface, or None.
        illuminant: Illuminant of the colours.
        truncation: Largest error of XYZ, relative to XYZ of the flat material.

    Raises:
        ValueError: The truncation error requires too many wavelengths.
    """
    half = lights + views
    count, geometric = _count_of_surface(half, scale_um, size_um, coherence, truncation), coherence.kind == "source"
    if material is not None and len(half):
        count = count_of_material(count, half, material, illuminant, truncation, geometric=geometric)
    if count <= MOST_WAVELENGTHS:
        wavenumbers, weights = colorimetry.uniform_quadrature(count, illuminant, geometric=geometric, signed=True)
        return colorimetry.NM_PER_UM / wavenumbers, weights
    raise ArgumentValueError(
        f"{ref('truncation')} must be larger than {truncation:g}, which requires {count} wavelengths; at most "
        f"{MOST_WAVELENGTHS} are supported: increase it, or use spectral_reflectance"
    )


def count_of_material(
    count: int, half: NDArray[np.float64], material: Material, illuminant: str | Spectrum, truncation: float, *,
    geometric: bool,
) -> int:  # fmt: skip
    """Return a number of wavelengths: ``count``, doubled until the colour of the flat material is accurate enough.

    The result may be larger than ``MOST_WAVELENGTHS``. ``half`` has the sums of the unit vectors to light and viewer,
    shape (n, 3).
    """
    cosines = np.unique(np.minimum(np.quantile(np.linalg.norm(half, axis=1) / 2.0, [0.0, 0.5, 1.0]), 1.0))
    exact = _exact_colours(cosines, material, illuminant)
    while count <= MOST_WAVELENGTHS:
        wavenumbers, weights = colorimetry.uniform_quadrature(count, illuminant, geometric=geometric, signed=True)
        off = np.abs(_reflectances(cosines, material, colorimetry.NM_PER_UM / wavenumbers) @ weights - exact)
        if np.all(off.max(axis=1) <= _SHARE_OF_MATERIAL * truncation * exact.max(axis=1)):
            break
        count *= 2
    return count


def _count_of_surface(
    half: NDArray[np.float64], scale_um: float, size_um: tuple[float, float], coherence: Coherence, truncation: float
) -> int:
    """Return the number of wavelengths that the change of the reflectance ρ with the wavelength requires.

    The index of refraction is assumed to be constant. ``half`` has the sums of the unit vectors to light and viewer,
    shape (n, 3).
    """
    along = float(np.max(np.hypot(half[:, 0], half[:, 1]), initial=0.0))
    high, low = 1e3 / colorimetry.LAMBDA_MIN_NM, 1e3 / colorimetry.LAMBDA_MAX_NM
    phase = 2.0 * math.pi * float(np.max(half[:, 2], initial=0.0)) * 2.0 * scale_um
    if coherence.kind == "source":
        span, rate = math.log(high / low), high * phase + OF_GAUSSIAN * along / coherence.spread
    elif coherence.periods is not None:
        reach = math.hypot(*np.multiply(coherence.periods, size_um))
        span, rate = high - low, phase + 2.0 * math.pi * along * reach
    else:
        # A Fourier coefficient at the distance d [1/µm] from q = (u, v)/λ has a Gaussian weight with the standard
        # deviation 1/(√8 πσ). `sharpness` is the inverse of this number [µm].
        sharpness = math.sqrt(8.0) * math.pi * (coherence.sigma_um or 0.0)
        span, rate = high - low, phase + OF_GAUSSIAN * along * sharpness
    return int(counts_of(np.array([rate]), span, truncation)[0])


def _exact_colours(cosines: NDArray[np.float64], material: Material, illuminant: str | Spectrum) -> NDArray[np.float64]:
    """Return XYZ of a flat material at n values of cos θd, shape (n, 3).

    θd is half of the angle between light and view. The integral over the wavelength is a Gauss quadrature between
    neighbouring kinks of the integrand.
    """
    grid, products = colorimetry.VISIBLE_NM, colorimetry.colour_products(illuminant)
    entries = [np.asarray(part.wavelengths_nm) for part in (material, material.film) if part is not None]
    cuts = np.unique(np.clip(np.concatenate([grid, *entries]), grid[0], grid[-1]))
    gauss, measure = np.polynomial.legendre.leggauss(_GAUSS_POINTS)
    points = (cuts[:-1, None] + np.diff(cuts)[:, None] * (gauss + 1.0) / 2.0).ravel()
    # Sums over whole nanometres give 380 and 780 nm the same weight as other wavelengths. The integral therefore
    # extends half a nanometre beyond each end of the range, as in `colorimetry.quadrature_weights`.
    points = np.concatenate([points, grid[[0, -1]]])
    measures = np.concatenate([(np.diff(cuts)[:, None] * measure / 2.0).ravel(), [0.5, 0.5]])
    masses = measures[:, None] * np.stack([np.interp(points, grid, column) for column in products.T], axis=1)
    masses *= products.sum(axis=0) / masses.sum(axis=0)
    return np.asarray(_reflectances(cosines, material, points) @ masses)


def _reflectances(
    cosines: NDArray[np.float64], material: Material, wavelengths_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the reflectance of a material at n cosines of the angle of incidence and m wavelengths [nm], (n, m)."""
    angles, wavelengths = np.meshgrid(cosines, wavelengths_nm, indexing="ij")
    return reflection.fresnel(angles, material, wavelengths).value
