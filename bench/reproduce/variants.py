"""Methods of Single (2014) with known defects, which ``thesis.py`` compares with the library.

- ``neighbours``: the power under a Gaussian coherence window, as a sum over the 3 × 3 Fourier coefficients around the
  one that floor() selects. The sum lacks a phase factor (Single 2014, eq. 3.34) that would move the window from the
  corner of the patch to its middle. The window therefore lies at the corner, on the seam between repeated patches.
- ``periods``: interference of whole periods of the patch (eq. 3.50). Coefficients are interpolated linearly or by a
  truncated sinc (eq. 3.51). The interpolation by the sinc also lacks a phase factor. Its result is therefore that of a
  patch with swapped halves, so that the seam is in the middle.

The module uses NumPy. The coefficients are series in κ. These are truncated, which causes errors of at most 1e-6.

H_rs is the Fourier coefficient of exp(2πiκh) at the frequency (r/Lx, s/Ly), with the heights h and κ = w/λ. Here, (u,
v, w) is the scattering vector: minus the sum of the unit vectors to light and viewer. Lx and Ly are the sides of the
patch. C is the geometry factor, and ρ the reflectance relative to a flat mirror.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.diffraction import fourier_coefficients
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.optics import reflectance_factors

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    import warpdiff as wd

    Floats = NDArray[np.float64]

SERIES = EXPANSIONS["jacobi-anger"]
# Largest error of a Fourier coefficient that truncation of its series may cause. The error must be small compared with
# the differences between the methods.
ACCURACY = 1e-6
# Number of Fourier coefficients on either side of the nearest one over which the sinc interpolation extends. The value
# is that of the publication (Single 2014).
SINC_REACH = 3
# Standard deviation of the coherence window [µm]. The value is that of the publication (Single 2014).
SIGMA_UM = 16.25
# Number of pairs of direction and wavelength that are evaluated at once. The value is limited by memory.
CHUNK = 1 << 15


def neighbours(heightfield: wd.HeightField, to_light: Floats, to_view: Floats, wavelengths_nm: Floats) -> Floats:
    """Return the reflectance ρ by 3 × 3 Fourier coefficients around the one that floor() selects, without masking.

    Args:
        heightfield: Height field.
        to_light: Unit vector to the light, shape (3,).
        to_view: Unit vectors to the viewer, shape (n, 3).
        wavelengths_nm: Wavelengths [nm], shape (m,).

    Returns:
        ρ, shape (n, m).
    """

    def weights(position: Floats, axis: int) -> tuple[Floats, Floats]:
        order = _spread(np.floor(position), -1, 1, heightfield.shape[axis])
        away = (order - position[:, None]) / heightfield.size_um[axis]
        return order, np.exp(-2.0 * (math.pi * SIGMA_UM * away) ** 2)

    return _reflectance(heightfield, to_light, to_view, wavelengths_nm, weights)


def periods(
    heightfield: wd.HeightField, to_light: Floats, to_view: Floats, wavelengths_nm: Floats, *,
    count: tuple[int, int], interpolation: str,
) -> Floats:  # fmt: skip
    """Return the reflectance ρ of a height field that is repeated ``count`` times along y and x.

    ``interpolation`` of its Fourier coefficients is "linear" or "sinc". The other arguments are those of
    :func:`neighbours`.
    """

    def weights(position: Floats, axis: int) -> tuple[Floats, Floats]:
        if heightfield.shape[axis] == 1:
            # Along an axis with one sample, the Fourier coefficients do not depend on the frequency, and are not
            # interpolated.
            order = np.zeros((len(position), 1))
            weight = order + 1.0
        elif interpolation == "linear":
            order = _spread(np.floor(position), 0, 1, heightfield.shape[axis])
            weight = 1.0 - np.abs(order - position[:, None])
        else:
            order = _spread(np.rint(position), -SINC_REACH, SINC_REACH, heightfield.shape[axis])
            weight = np.sinc(order - position[:, None])
        # The amplitude of N repeated patches has the factor sin(πNt) / (N sin(πt)). Here, t is the distance of a
        # frequency from that of the nearest Fourier coefficient, in units of the spacing of these coefficients.
        away = position - np.rint(position)
        return order, weight * (np.sinc(count[axis] * away) / np.sinc(away))[:, None]

    return _reflectance(heightfield, to_light, to_view, wavelengths_nm, weights)


def _spread(order: Floats, first: int, last: int, samples: int) -> Floats:
    """Return the numbers of diffraction orders near each order in ``order``, shape (orders, neighbours).

    They are the number of the order plus ``first`` to plus ``last``. An axis with one height sample has only the order
    0.
    """
    return order[:, None] + np.arange(first, last + 1) if samples > 1 else np.zeros((len(order), 1))


def _reflectance(
    heightfield: wd.HeightField, to_light: Floats, to_view: Floats, wavelengths_nm: Floats,
    weights: Callable[[Floats, int], tuple[Floats, Floats]],
) -> Floats:  # fmt: skip
    """Return the reflectance ρ = C·|Σ weight_s weight_r H_rs|² for all views and wavelengths, shape (n, m).

    ``weights(position, axis)`` returns, for an axis, the orders that are added (r or s) and their weights. A position
    is uLx/λ or vLy/λ, a frequency in units of the spacing of orders.
    """
    lights = np.broadcast_to(to_light, to_view.shape)
    gains = reflectance_factors.gain(lights, to_view, normal=reflectance_factors.normal_reflectance(1.5), masking=False)
    scattering_vectors = -lights - to_view
    tau = 1e3 / np.asarray(wavelengths_nm)
    frequency = float(np.max(np.hypot(scattering_vectors[:, 0], scattering_vectors[:, 1])) * tau.max())
    rows, block, scale = _coefficients(heightfield, math.ceil(frequency))
    u, v, w = (np.outer(part, tau).ravel() for part in scattering_vectors.T)
    result = np.empty(len(w))
    for first in range(0, len(w), CHUNK):
        part = slice(first, first + CHUNK)
        places, factors = [], []
        for axis, along in enumerate((v, u)):
            order, weight = weights(along[part] * heightfield.size_um[axis], axis)
            places.append((order.astype(int) + block.origin[axis]) % block.shape[axis])
            factors.append(weight.astype(np.float32))
        basis = SERIES.basis(scale * w[part], rows.shape[2]).astype(np.float32)
        amplitude = np.zeros(len(basis), dtype=np.complex64)
        for j in range(places[0].shape[1]):
            # If light and views are in the xz plane, v is 0. The interpolation along y then gives the weight 0 to all
            # rows of Fourier coefficients except the middle row. Rows of weight 0 are skipped.
            for k in range(places[1].shape[1]) if factors[0][:, j].any() else ():
                coefficients = np.einsum("pt,pt->p", rows[places[0][:, j], places[1][:, k]], basis)
                amplitude += factors[0][:, j] * factors[1][:, k] * coefficients
        result[part] = np.abs(amplitude) ** 2
    return gains[:, None] * result.reshape(len(scattering_vectors), len(tau))


@functools.lru_cache(maxsize=2)
def _coefficients(
    heightfield: wd.HeightField, frequency: int
) -> tuple[NDArray[np.complex64], fourier_coefficients.Block, float]:
    """Return the series of all Fourier coefficients up to a frequency [1/µm], with their indices and a scale [µm].

    A Fourier coefficient is a series in x = scale · |κ|, where κ = w/λ. The `Block` contains the indices.
    """
    scale = 2.0 * math.pi * SERIES.offset_and_scale(heightfield)[1]
    terms = SERIES.term_count(scale * 2.0 / 0.38, ACCURACY)
    block = fourier_coefficients.Block.covering(
        fourier_coefficients.patch_grid(heightfield), frequency, (SINC_REACH + 1,) * 2
    )
    return fourier_coefficients.series_coefficients(heightfield, SERIES, terms, block, dtype=np.complex64), block, scale
