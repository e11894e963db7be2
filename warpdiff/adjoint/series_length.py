"""Numbers of terms of Jacobi-Anger and Chebyshev series for a relative truncation error."""

from __future__ import annotations

import math

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.diffraction.phase_series import bessel_j

# Share of the truncation error that the series of a value may have. Derivatives of the last terms are larger than the
# terms by about their number, which is at most some hundreds.
_MARGIN = 1e-2
# Largest argument of a series. Limit: kernels have space for 1024 terms; a height range of about 250 wavelengths.
_MOST_ARGUMENT = 800.0
# Sum of Bessel functions that may consist of rounding errors alone.
_ROUNDING = 4e-15
# Least width of a range of |κ|, relative to |κ|, and least change of the phase of half of the height range over the
# width [radians]. Limit: rounding errors of a series become errors of its derivative in proportion to 1/width. If
# doubled, series need one more term.
_LEAST_RANGE, _LEAST_PHASE = 0.1, 1.0
# Share of the width by which a range is widened, so that rounding errors place no |κ| outside of it.
_MARGIN_OF_RANGE = 1e-6


def term_count(argument: float, truncation: float) -> int:
    """Return the number of terms of e^{ixg}, |g| <= 1, for arguments up to |x|, so that the rest is negligible.

    The terms are Chebyshev polynomials in g with Bessel functions as coefficients. Their sum beyond the returned number
    is at most a small share of ``truncation``.

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
    """Return a range of |κ| [1/µm] that contains another, and is wide enough for derivatives of a series by κ.

    Args:
        low: Least |κ| [1/µm], more than 0.
        high: Largest |κ| [1/µm].
        scale_um: Half of the height range [µm].
    """
    least = min(_LEAST_RANGE * high, _LEAST_PHASE / (2.0 * math.pi * scale_um))
    middle, half = (low + high) / 2.0, (1.0 + _MARGIN_OF_RANGE) * max(high - low, least) / 2.0
    return middle - half, middle + half
