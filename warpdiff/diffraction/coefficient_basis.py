"""Expansion of Fourier coefficients in functions of κ, which all coefficients share: a coefficient is a row of weights.

κ is w/λ, the normal component of the scattering vector divided by the wavelength. The functions of κ are called the
basis. ``"taylor"``, ``"taylor-uncentred"`` and ``"jacobi-anger"`` are series of the exponential (``phase_series``),
whose rows are amplitudes H. Two other bases are fitted to the Jacobi-Anger series, for the range of κ that a call
requires:

- ``"power"``: the Chebyshev series of |H_rs(κ)|², a real function of κ whose bandwidth is twice the height range. Its
  rows are half as long as those of amplitudes and need not be squared. This basis is available only if powers add.
- ``"low-rank"``: the principal functions of κ of the coefficients of this height field. The basis expands powers if
  powers add, and amplitudes otherwise. On an interval of length L, functions of bandwidth B have about B·L dimensions.
  Polynomials need π/2 times as many terms, and a series about κ = 0 several times as many. Coefficients of real
  surfaces span even fewer dimensions.

H_rs is the Fourier coefficient of exp(2πiκh) at the frequency (r/Lx, s/Ly), where h are the heights and Lx and Ly the
sides of the period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import forks
from warpdiff.diffraction import chebyshev
from warpdiff.diffraction.fourier_coefficients import series_coefficients
from warpdiff.diffraction.phase_series import EXPANSIONS, MAX_TERMS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.diffraction.fourier_coefficients import Block, Grid
    from warpdiff.heightfield.field import HeightField

METHODS = ("low-rank", "power", *EXPANSIONS)
POWER_METHODS = ("power",)

# Number n of entries in the table of basis functions over κ = w/λ, per radian of the phase 2πκ · (height range). A
# power oscillates at most as fast as this phase. With n entries, the error of cubic interpolation is 3/(128 n⁴), which
# is 4e-7. Amplitudes oscillate half as fast if heights are measured from the middle of the height range. For
# amplitudes, the error is therefore 2e-8.
_STEPS_PER_RADIAN = 16
# Smallest number of steps in the table of the basis functions of κ = w/λ. Only shallow surfaces would need fewer steps.
# Their powers do not oscillate over κ, but grow in proportion to κ², κ⁴ or a higher power of κ.
_FEWEST_STEPS = 64
# Largest truncation error of the Jacobi-Anger series to which other basis functions are fitted. The value was chosen as
# about the rounding error of float32.
_SERIES_TOLERANCE = 1e-7
# Truncation error below which no further functions are added to a fitted basis (the functions of κ = w/λ that all
# coefficients share). The value was chosen as about the rounding error of float32.
_LEAST_TRUNCATION_ERROR = 1e-7
# In the fit of a basis (functions of κ = w/λ), this number of the largest Fourier coefficients has a special weight:
# their total weight equals that of all coefficients together. Without this weight, the specular reflection, which is
# only one of a million coefficients, would hardly affect the fit.
_STRONGEST_ROWS = 64
# Number of Fourier coefficients of a height field on which the truncation error of fitted basis functions is measured.
_SAMPLED_ROWS = 20_000
# Percentile of the truncation errors of coefficients that is reported; 0.1 % of the coefficients may have larger
# errors.
_PERCENTILE = 99.9
# A fit of basis functions minimises the errors of coefficients relative to the size of each coefficient. This number is
# the power of the rounding errors of the Fourier transforms, relative to the power of a mirror. A coefficient with a
# smaller power counts as if it had this power.
_NOISE_POWER = 1e-26
# In a fit of basis functions to Fourier coefficients, errors are divided by |κ| = |w|/λ, because all of them except the
# specular one vanish at κ = 0. The divisor is at least this share of the largest |κ|. With a smaller share, the
# specular coefficient would lose digits.
_SMALL_KAPPA = 0.1
# Number of Fourier coefficients that a fit of basis functions processes at once. The value is limited by memory, which
# is proportional to it.
_CHUNK = 65_536
# Largest magnitude of the basis functions of a Taylor series, which is within the range of float32. If |κ| = |w|/λ is
# too large for the series to converge in float32, larger values occur. They are clipped to this magnitude.
_LARGEST = 1e30


@dataclass(frozen=True)
class Coefficients:
    """Fourier coefficients as functions of |κ| = |w|/λ: rows of weights times basis functions.

    Attributes:
        rows: Weights of the basis functions, float32, shape (my, mx, parts, terms). There is one part for powers, and
            there are two for amplitudes: the real and the imaginary part.
        basis: Basis functions at |κ| = kappa_low − step, kappa_low, …, up to two steps beyond the range; float32, shape
            (entries, terms).
        kappa_low: Lower end of the range of |κ| [1/µm].
        step: Difference in |κ| of neighbouring entries of ``basis`` [1/µm].
        truncation_errors: Error of a fitted basis with the first n terms, n = 0 … terms: the 99.9th percentile over the
            coefficients. The error of one coefficient is its largest error at any κ in the range, relative to its
            largest value in the range. Errors and values are first divided by |κ|, or by κ² for powers. The array is
            empty for a series, whose error has a known bound.
    """

    rows: NDArray[np.float32]
    basis: NDArray[np.float32]
    kappa_low: float
    step: float
    truncation_errors: NDArray[np.float64]

    @property
    def terms(self) -> int:
        """Number of basis functions of κ = w/λ."""
        return int(self.rows.shape[-1])

    def basis_at(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the basis functions at |κ| = |w|/λ [1/µm], by cubic interpolation, shape (len(kappas), terms)."""
        steps = (np.asarray(kappas) - self.kappa_low) / self.step
        entry = np.clip(np.floor(steps), 0, len(self.basis) - 4).astype(int)
        basis = self.basis.astype(np.float64)
        weights = chebyshev.cubic_weights((steps - entry)[:, None])
        return np.asarray(sum(weight * basis[entry + k] for k, weight in enumerate(weights)))

    @forks.cached_property
    def strongest(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the flat indices of the largest Fourier coefficients H, and their powers |H|² in descending order.

        The powers are computed at one |κ| = |w|/λ in the middle of the range.
        """
        high = self.kappa_low + self.step * (len(self.basis) - 3)
        middle = math.sqrt(max(self.kappa_low, _SMALL_KAPPA * high) * high)
        parts = np.einsum("yxpt,t->yxp", self.rows, self.basis_at(np.array([middle]))[0].astype(np.float32))
        powers = parts[..., 0] if parts.shape[2] == 1 else np.sum(parts.astype(np.float64) ** 2, axis=2)
        most = min(_STRONGEST_ROWS, powers.size)
        places = np.argpartition(powers.ravel(), -most)[-most:]
        places = places[np.argsort(-powers.ravel()[places], kind="stable")]
        return places, powers.ravel()[places].astype(np.float64)

    def terms_within(self, tolerance: float) -> int:
        """Return the smallest number of basis functions with a truncation error within a tolerance.

        If no number suffices, return the number of all basis functions.
        """
        enough = np.flatnonzero(self.truncation_errors <= tolerance)
        return max(1, int(enough[0])) if enough.size else self.terms


def holds_powers(method: str, *, adds_powers: bool) -> bool:
    """Whether the rows (weights of basis functions) of a method expand powers |H|², and not amplitudes H."""
    return method == "power" or (method == "low-rank" and adds_powers)


def series_terms(heightfield: HeightField, kappas: tuple[float, float]) -> int:
    """Return the number of terms of the Jacobi-Anger series to which basis functions are fitted, for a |w|/λ range."""
    series = EXPANSIONS["jacobi-anger"]
    argument = 2.0 * math.pi * _entries(heightfield, kappas)[-1] * series.offset_and_scale(heightfield)[1]
    return series.term_count(argument, _SERIES_TOLERANCE)


@np.errstate(under="ignore")
def of_series(
    heightfield: HeightField, method: str, grid: Grid, block: Block, kappas: tuple[float, float], *, terms: int,
    threads: int,
) -> Coefficients:  # fmt: skip
    """Return the Fourier coefficients of a block of frequencies, expanded in one of the series ``EXPANSIONS``.

    ``kappas`` is the range of |κ| = |w|/λ [1/µm] for which the basis functions are tabulated. ``threads`` is the number
    of Fourier transforms that run in parallel.
    """
    expansion = EXPANSIONS[method]
    series = series_coefficients(
        heightfield, expansion, terms, block, taper=grid.taper, threads=threads, dtype=np.complex64
    )
    rows = np.stack([series.real, series.imag], axis=2).astype(np.float32, copy=False)
    step, table_kappas = _table_kappas(heightfield, kappas)
    # The argument of the basis functions is x = 2πκa, where a is the scale by which the expansion divides heights. κ =
    # w/λ is negative, but ``table_kappas`` contains |κ|. The sign of the argument is therefore reversed here.
    basis = expansion.basis(-2.0 * math.pi * expansion.offset_and_scale(heightfield)[1] * table_kappas, terms)
    bounded = np.clip(basis, -_LARGEST, _LARGEST).astype(np.float32)
    return Coefficients(rows, bounded, kappas[0], step, np.zeros(0))


@np.errstate(under="ignore")
def fitted(
    heightfield: HeightField, method: str, series: Coefficients, kappas: tuple[float, float], *, adds_powers: bool
) -> Coefficients:
    """Return Fourier coefficients in a basis that is fitted to these coefficients, with the accuracy of float32.

    ``kappas`` is the range of |κ| = |w|/λ [1/µm]. ``method`` is ``"low-rank"`` or ``"power"``; ``series`` has the
    coefficients in the Jacobi-Anger series with as many terms as :func:`series_terms` returns.
    """
    high = kappas[1]
    step, table_kappas = _table_kappas(heightfield, kappas)
    # The coefficients are evaluated at Chebyshev nodes over all |κ| = |w|/λ of the table of basis functions. This table
    # and the nodes extend slightly beyond the required range of |κ|, because extrapolation would be inaccurate.
    first, last = float(table_kappas[0]), float(table_kappas[-1])
    powers = holds_powers(method, adds_powers=adds_powers)
    bandwidth = (last - first) / 2.0 * _radians_per_kappa(heightfield) * (1.0 if powers else 0.5)
    count = math.ceil(bandwidth + 6.0 * bandwidth ** (1.0 / 3.0) + 10.0)
    nodes = chebyshev.nodes(first, last, count)
    values = _values_at(heightfield, series, nodes)
    if powers:
        values = (values[:, 0] ** 2 + values[:, 1] ** 2)[:, None]

    # Near κ = w/λ = 0, all Fourier coefficients except the specular one are proportional to κ or to a higher power of
    # κ. The powers of these coefficients are proportional to κ² or to a higher power. The weights therefore make the
    # fit minimise errors relative to κ, or relative to κ² for powers.
    weights = 1.0 / np.hypot(nodes, _SMALL_KAPPA * high or 1.0) ** (2 if powers else 1)
    shape = (*series.rows.shape[:2], values.shape[1], -1)
    scales = np.abs(values * weights.astype(np.float32)).max(axis=(1, 2), initial=0.0)
    noise = weights.max() * (_NOISE_POWER if powers else math.sqrt(_NOISE_POWER))
    scales = np.maximum(scales, noise)[:, None, None]
    strongest = np.argsort(-scales[:, 0, 0])[:_STRONGEST_ROWS]
    if method == "power":
        principal = chebyshev.to_series(count)
        back = chebyshev.terms(count)
    else:
        principal_functions = _principal_functions(values, weights, scales, strongest)
        principal = weights[:, None] * principal_functions
        back = principal_functions.T / weights
    sampled = np.union1d(strongest, np.arange(0, len(values), math.ceil(len(values) / _SAMPLED_ROWS)))
    sampled_values = (values[sampled] / scales[sampled]).astype(np.float64).reshape(-1, count)
    errors = _truncation_errors(sampled_values, principal, back, weights)
    terms = int(np.argmax(errors <= _LEAST_TRUNCATION_ERROR)) if errors.min() <= _LEAST_TRUNCATION_ERROR else count
    terms = min(max(terms, 1), MAX_TERMS)
    basis = chebyshev.cardinals(table_kappas, first, last, count) @ back[:terms].T
    rows = values.reshape(-1, count) @ principal[:, :terms].astype(np.float32)
    return Coefficients(rows.reshape(shape), basis.astype(np.float32), kappas[0], step, errors[: terms + 1])


def _radians_per_kappa(heightfield: HeightField) -> float:
    """Return the highest angular frequency at which a power oscillates over κ = w/λ [rad·µm].

    The result is 2π times the height range, and at least 1e-3.
    """
    return max(2.0 * math.pi * heightfield.height_range_um, 1e-3)


def _entries(heightfield: HeightField, kappas: tuple[float, float]) -> tuple[float, int, float]:
    """Return the step of |κ| in a table of basis functions, the number of steps, and the largest |κ|.

    κ is w/λ, where w is the component of the scattering vector along the normal. Fourier coefficients of the height
    field at any |κ| are weighted sums of the basis functions.
    """
    low, high = kappas
    step = min(1.0 / (_STEPS_PER_RADIAN * _radians_per_kappa(heightfield)), (high - low) / _FEWEST_STEPS or 1.0)
    count = math.ceil((high - low) / step) + 2
    return step, count, low + step * count


def _table_kappas(heightfield: HeightField, kappas: tuple[float, float]) -> tuple[float, NDArray[np.float64]]:
    """Return the step of |κ| = |w|/λ in a table of basis functions [1/µm], and the |κ| of all entries."""
    step, count, _ = _entries(heightfield, kappas)
    return step, np.asarray(kappas[0] + step * np.arange(-1, count + 1), dtype=np.float64)


def _values_at(heightfield: HeightField, series: Coefficients, kappas: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return Fourier coefficients, summed from a series at κ = −``kappas``, shape (coefficients, 2, m).

    The second axis has the real and the imaginary part.
    """
    expansion = EXPANSIONS["jacobi-anger"]
    argument = -2.0 * math.pi * expansion.offset_and_scale(heightfield)[1] * kappas
    basis = expansion.basis(argument, series.terms).T.astype(np.float32)
    rows = series.rows.reshape(-1, series.terms)
    return (rows @ basis).reshape(-1, 2, len(kappas))


def _principal_functions(
    values: NDArray[np.float32], weights: NDArray[np.float64], scales: NDArray[np.float32], strongest: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the principal functions of κ of all coefficients, orthonormal, in order of importance, shape (m, m).

    κ is w/λ. The functions are sampled at m Chebyshev nodes. With the first n functions, the sum of the squared errors
    of all coefficients is smaller than with any other n functions. In this sum, the error of a coefficient is relative
    to the largest value of this coefficient. The strongest coefficients have a larger weight.
    """
    count = values.shape[-1]
    gram = np.zeros((count, count))
    for first in range(0, len(values), _CHUNK):
        part = slice(first, first + _CHUNK)
        scaled = (values[part] / scales[part]).astype(np.float64).reshape(-1, count) * weights
        gram += scaled.T @ scaled
    strong = (values[strongest] / scales[strongest]).astype(np.float64).reshape(-1, count) * weights
    gram = gram / len(values) + strong.T @ strong / len(strongest)
    return np.asarray(np.linalg.eigh(gram)[1][:, ::-1])


def _truncation_errors(
    sample: NDArray[np.float64], principal: NDArray[np.float64], back: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the truncation error of an expansion of Fourier coefficients in the first 0, 1, 2, … basis functions.

    The error of a coefficient is its largest error over all κ = w/λ. The truncation error is the percentile
    ``_PERCENTILE`` of the errors of the sampled coefficients.
    """
    rows = sample @ principal
    remaining = sample.copy()
    result = [1.0]
    for n in range(rows.shape[1]):
        remaining -= rows[:, n : n + 1] * back[n]
        result.append(float(np.percentile(np.abs(remaining * weights).max(axis=1), _PERCENTILE)))
        if result[-1] <= _LEAST_TRUNCATION_ERROR:
            break
    return np.asarray(result)
