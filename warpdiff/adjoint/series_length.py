"""Numbers of terms of Jacobi-Anger and Chebyshev series that meet a relative truncation error.

The series expand e^{ixg} for |g| ≤ 1 in terms that are Bessel functions of the argument x times Chebyshev polynomials
of g. κ = w/λ, where w is the normal component of the scattering vector and λ the wavelength.
"""

from __future__ import annotations

import math

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.diffraction.phase_series import bessel_j

# Truncation error of a series of e^{ixg}, as a fraction of the permitted error of the result. The derivatives of the
# last terms are larger than these terms by a factor of about the number of terms, which is at most a few hundred. With
# this fraction, derivatives also meet the permitted error.
_MARGIN = 1e-2
# Largest argument x of a series of e^{ixg}. The value is limited by kernels, which have memory for
# `lobe_sums.MOST_TERMS` terms: a series of this argument has up to 970 terms. It corresponds to a height range of about
# 250 wavelengths.
_MOST_ARGUMENT = 800.0
# Smallest truncation error of a series that can be required. The error is computed as a sum of the magnitudes of Bessel
# functions. Below this value, the sum may consist of rounding errors only.
_ROUNDING = 4e-15
# A range of |κ| = |w|/λ must not be too narrow, because rounding errors of a series in κ become errors of its
# derivative in proportion to 1/width. `_LEAST_RANGE` is the smallest width relative to |κ|. `_LEAST_PHASE` is the
# smallest change of the phase over the width, for a height of half of the height range [radians]. The smaller of both
# widths is used. If both numbers are doubled, series need one more term.
_LEAST_RANGE, _LEAST_PHASE = 0.1, 1.0
# Fraction of its width by which a range of |κ| = |w|/λ is widened. Without this margin, rounding errors would place
# some |κ| outside of the range.
_MARGIN_OF_RANGE = 1e-6


def term_count(argument: float, truncation: float) -> int:
    """Return the number of terms of the series of e^{ixg} for |x| up to ``argument`` and |g| ≤ 1.

    The terms are Chebyshev polynomials in g with Bessel functions as coefficients. The sum of all further terms is at
    most a hundredth of ``truncation``, or a rounding error.

    Raises:
        ValueError: The height range is too large.
    """
    if argument > _MOST_ARGUMENT:
        raise ArgumentValueError(
            f"{ref('heightfield')} has a height range whose series requires about {argument:.2g} terms; at most "
            f"{_MOST_ARGUMENT:g} are supported: reduce the range with {ref('levelled()')} or {ref('cropped()')}"
        )
    count = math.ceil(argument + 14.0 * math.cbrt(argument)) + 40
    rest = np.cumsum(np.abs(bessel_j(argument, count))[::-1])[::-1]
    is_enough = 2.0 * rest <= max(_MARGIN * truncation, _ROUNDING)
    return max(int(np.argmax(is_enough)), 2) if is_enough.any() else count


def kappa_range(low: float, high: float, scale_um: float) -> tuple[float, float]:
    """Return a range of |κ| [1/µm] that contains the range ``low`` to ``high`` and is wide enough for derivatives by κ.

    Args:
        low: Smallest |κ| [1/µm], more than 0.
        high: Largest |κ| [1/µm].
        scale_um: Half of the height range [µm].
    """
    least = min(_LEAST_RANGE * high, _LEAST_PHASE / (2.0 * math.pi * scale_um))
    middle, half = (low + high) / 2.0, (1.0 + _MARGIN_OF_RANGE) * max(high - low, least) / 2.0
    return middle - half, middle + half
