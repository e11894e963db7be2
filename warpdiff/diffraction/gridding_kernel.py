"""Gridding kernel: Kaiser-Bessel interpolation of the spectrum of a patch between the frequencies of a grid.

The spectrum of a patch is a smooth function of frequency, because the patch has a finite length. First, the samples of
exp(2πiκh) at the heights h are divided by the Fourier transform of the kernel. Then the spectrum is computed at twice
as many frequencies as the patch has samples. At any other frequency, the spectrum is a weighted sum over a few of these
frequencies (non-uniform FFT; Fessler and Sutton 2003, Barnett et al. 2019).

κ is w/λ, the normal component w of the scattering vector divided by the wavelength.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Degree of the polynomials that approximate the Kaiser-Bessel kernel. Each interval between two frequencies of the grid
# has a separate polynomial. With this degree, the error of the polynomials is less than 1e-11 of the maximum of the
# kernel, which is below the rounding errors of float32.
_DEGREE = 12


def _shape(taps: int) -> float:
    """Return the shape parameter β of the Kaiser-Bessel kernel that covers ``taps`` frequencies.

    The formula is for an oversampling of 2 (Beatty et al. 2005, eq. 5).
    """
    return math.pi * math.sqrt((taps / 2.0 * 1.5) ** 2 - 0.8)


def kernel(distance: NDArray[np.float64], taps: int) -> NDArray[np.float64]:
    """Return the Kaiser-Bessel kernel at distances in steps of the frequency grid: 1 at 0, and 0 beyond ``taps``/2.

    The kernel covers ``taps`` frequencies of the grid.
    """
    inside = 1.0 - (2.0 * distance / taps) ** 2
    values = np.i0(_shape(taps) * np.sqrt(np.maximum(inside, 0.0))) / np.i0(_shape(taps))
    return np.where(inside >= 0.0, values, 0.0)


def kernel_transform(frequency: NDArray[np.float64], taps: int) -> NDArray[np.float64]:
    """Return the Fourier transform of the Kaiser-Bessel kernel, ∫ kernel(t) e^{2πiνt} dt, at frequencies |ν| <= 1/4.

    The transform is W sinh(b)/(b I0(β)) with b² = β² − (πWν)², where W = ``taps`` is the number of frequencies that the
    kernel covers, and β is the shape parameter.
    """
    root = np.sqrt(_shape(taps) ** 2 - (math.pi * taps * frequency) ** 2)
    return np.asarray(taps * np.sinh(root) / (root * np.i0(_shape(taps))))


def tap_polynomials(taps: int) -> NDArray[np.float64]:
    """Return polynomials for the weights of the ``taps`` frequencies around a position, shape (taps, degree + 1).

    The coefficients of each polynomial begin with the highest power. For a position t, in steps of the frequency grid,
    the i-th frequency is ⌊t⌋ − taps/2 + 1 + i, and its weight is the i-th polynomial at t − ⌊t⌋ − 1/2.
    """
    nodes = np.cos(math.pi * (np.arange(4 * _DEGREE) + 0.5) / (4 * _DEGREE)) / 2.0
    offsets = taps // 2 - 1 - np.arange(taps)
    values = kernel(nodes[:, None] + 0.5 + offsets, taps)
    return np.asarray(np.polynomial.polynomial.polyfit(nodes, values, _DEGREE).T[:, ::-1])
