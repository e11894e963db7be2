"""Expansion of Fourier coefficients in functions of κ: each coefficient is a row of weights times a shared basis.

``"taylor"``, ``"taylor-uncentred"`` and ``"jacobi-anger"`` are series of the exponential (``phase_series``), whose rows
are amplitudes. Two other bases are fitted to the Jacobi-Anger series, for the range of κ that a call requires:

- ``"power"``: the Chebyshev series of |H_rs(κ)|², a real function of κ whose bandwidth is twice the height range. Its
  rows are half as long as those of amplitudes and need not be squared. It is available only if powers add.
- ``"low-rank"``: the principal functions of κ of the height field's own coefficients. The basis expands powers if
  powers add, and amplitudes otherwise. On an interval of length L, functions of bandwidth B have about B·L dimensions.
  Polynomials need π/2 times as many terms, and a series about κ = 0 several times as many. Coefficients of real
  surfaces span even fewer dimensions.
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

# Entries of the table of a basis per radian of the fastest oscillation of a power, e^{2πiκ(h − h')}. The error of cubic
# interpolation is 0.023/16⁴ = 4e-7. If heights are measured from the middle of their range, amplitudes oscillate half
# as fast, and their error is 2e-8.
_STEPS_PER_RADIAN = 16
# Smallest number of intervals in the table of a basis. It applies to shallow surfaces, whose powers do not oscillate
# but grow as κ²ⁿ.
_FEWEST_STEPS = 64
# Truncation error of the series to which bases are fitted, about the rounding error of float32.
_SERIES_TOLERANCE = 1e-7
# Truncation error at which no further terms of a fitted basis are added, about the rounding error of float32.
_LEAST_TRUNCATION_ERROR = 1e-7
# Number of the largest coefficients, which together have the same weight in a fit as all coefficients. Without this
# weight, the specular reflection would be only one coefficient of a million.
_STRONGEST_ROWS = 64
# Number of coefficients on which truncation errors are measured.
_SAMPLED_ROWS = 20_000
# Percentile of the truncation errors that is reported; 0.1 % of the coefficients may have larger errors.
_PERCENTILE = 99.9
# Power of the rounding noise of the Fourier transforms, relative to the power of a mirror. In a fit, errors of a
# coefficient are divided by its size, but at least by the size of this noise.
_NOISE_POWER = 1e-26
# Errors of coefficients are divided by |κ|, but by at least this share of the largest |κ|. If the share is smaller, the
# specular coefficient, which does not vanish at κ = 0, loses digits.
_SMALL_KAPPA = 0.1
# Limit: number of coefficients that are processed at once; memory is proportional to it.
_CHUNK = 65_536
# Limit on the values of a Taylor basis, within the range of float32. Only a series at a κ far beyond its range of
# convergence in float32 exceeds the limit.
_LARGEST = 1e30


@dataclass(frozen=True)
class Coefficients:
    """Fourier coefficients as functions of |κ|: rows times a basis.

    Attributes:
        rows: Weights of the basis functions, float32, shape (my, mx, parts, terms). Parts are one (powers) or two (real
            and imaginary parts of amplitudes).
        basis: Basis functions at |κ| = kappa_low − step, kappa_low, …, two steps beyond the range; float32, shape
            (entries, terms).
        kappa_low: Lower end of the range of |κ| [1/µm].
        step: Difference in |κ| of neighbouring entries of ``basis`` [1/µm].
        truncation_errors: Errors of a fitted basis with the first n terms, n = 0 … terms, relative to the largest value
            of a coefficient in the range. Empty for a series, because its error has a known bound.
    """

    rows: NDArray[np.float32]
    basis: NDArray[np.float32]
    kappa_low: float
    step: float
    truncation_errors: NDArray[np.float64]

    @property
    def terms(self) -> int:
        """Number of basis functions."""
        return int(self.rows.shape[-1])

    def basis_at(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the basis functions at |κ| [1/µm], by cubic interpolation, shape (len(kappas), terms)."""
        steps = (np.asarray(kappas) - self.kappa_low) / self.step
        entry = np.clip(np.floor(steps), 0, len(self.basis) - 4).astype(int)
        basis = self.basis.astype(np.float64)
        weights = chebyshev.cubic_weights((steps - entry)[:, None])
        return np.asarray(sum(weight * basis[entry + k] for k, weight in enumerate(weights)))

    @forks.cached_property
    def strongest(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Flat indices of the largest coefficients at a middle |κ| of the range, and their powers, descending."""
        high = self.kappa_low + self.step * (len(self.basis) - 3)
        middle = math.sqrt(max(self.kappa_low, _SMALL_KAPPA * high) * high)
        parts = np.einsum("yxpt,t->yxp", self.rows, self.basis_at(np.array([middle]))[0].astype(np.float32))
        powers = parts[..., 0] if parts.shape[2] == 1 else np.sum(parts.astype(np.float64) ** 2, axis=2)
        most = min(_STRONGEST_ROWS, powers.size)
        places = np.argpartition(powers.ravel(), -most)[-most:]
        places = places[np.argsort(-powers.ravel()[places], kind="stable")]
        return places, powers.ravel()[places].astype(np.float64)

    def terms_within(self, tolerance: float) -> int:
        """Return the smallest number of terms whose truncation error is within a tolerance; at most all terms."""
        enough = np.flatnonzero(self.truncation_errors <= tolerance)
        return max(1, int(enough[0])) if enough.size else self.terms


def holds_powers(method: str, *, adds_powers: bool) -> bool:
    """Whether a method expands powers |H|² instead of amplitudes H."""
    return method == "power" or (method == "low-rank" and adds_powers)


def series_terms(heightfield: HeightField, kappas: tuple[float, float]) -> int:
    """Return the number of terms of the Jacobi-Anger series to which a basis is fitted, for a range of |κ| [1/µm]."""
    series = EXPANSIONS["jacobi-anger"]
    argument = 2.0 * math.pi * _entries(heightfield, kappas)[-1] * series.offset_and_scale(heightfield)[1]
    return series.term_count(argument, _SERIES_TOLERANCE)


@np.errstate(under="ignore")
def of_series(
    heightfield: HeightField, method: str, grid: Grid, block: Block, kappas: tuple[float, float], *, terms: int,
    threads: int,
) -> Coefficients:  # fmt: skip
    """Expand the coefficients of a block of frequencies in a series of ``EXPANSIONS``, for a range of |κ| [1/µm].

    ``threads`` is the number of transforms that run in parallel.
    """
    expansion = EXPANSIONS[method]
    series = series_coefficients(
        heightfield, expansion, terms, block, taper=grid.taper, threads=threads, dtype=np.complex64
    )
    rows = np.stack([series.real, series.imag], axis=2).astype(np.float32, copy=False)
    step, table_kappas = _table_kappas(heightfield, kappas)
    # The argument of the series is negative, because κ = w/λ is negative.
    basis = expansion.basis(-2.0 * math.pi * expansion.offset_and_scale(heightfield)[1] * table_kappas, terms)
    bounded = np.clip(basis, -_LARGEST, _LARGEST).astype(np.float32)
    return Coefficients(rows, bounded, kappas[0], step, np.zeros(0))


@np.errstate(under="ignore")
def fitted(
    heightfield: HeightField, method: str, series: Coefficients, kappas: tuple[float, float], *, adds_powers: bool
) -> Coefficients:
    """Expand the coefficients in a basis fitted to them over a range of |κ| [1/µm], with the accuracy of float32.

    ``method`` is ``"low-rank"`` or ``"power"``; ``series`` is the Jacobi-Anger series of ``series_terms`` terms.
    """
    high = kappas[1]
    step, table_kappas = _table_kappas(heightfield, kappas)
    # The Chebyshev nodes cover all entries of the basis table, which extend slightly beyond the range of |κ|.
    # Extrapolation from the nodes is thus avoided.
    first, last = float(table_kappas[0]), float(table_kappas[-1])
    powers = holds_powers(method, adds_powers=adds_powers)
    bandwidth = (last - first) / 2.0 * _radians_per_kappa(heightfield) * (1.0 if powers else 0.5)
    count = math.ceil(bandwidth + 6.0 * bandwidth ** (1.0 / 3.0) + 10.0)
    nodes = chebyshev.nodes(first, last, count)
    values = _values_at(heightfield, series, nodes)
    if powers:
        values = (values[:, 0] ** 2 + values[:, 1] ** 2)[:, None]

    # Towards κ = 0, all coefficients except the specular one vanish like κ, and their powers like κ². The weights make
    # errors relative to κ or κ².
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
    """Return the fastest oscillation of a power over κ [rad·µm]."""
    return max(2.0 * math.pi * heightfield.height_range_um, 1e-3)


def _entries(heightfield: HeightField, kappas: tuple[float, float]) -> tuple[float, int, float]:
    """Return the step of |κ| in a table of a basis, its number of steps above the least |κ|, and its last |κ|."""
    low, high = kappas
    step = min(1.0 / (_STEPS_PER_RADIAN * _radians_per_kappa(heightfield)), (high - low) / _FEWEST_STEPS or 1.0)
    count = math.ceil((high - low) / step) + 2
    return step, count, low + step * count


def _table_kappas(heightfield: HeightField, kappas: tuple[float, float]) -> tuple[float, NDArray[np.float64]]:
    """Return the step of |κ| and all |κ| of the entries in the table of a basis [1/µm]."""
    step, count, _ = _entries(heightfield, kappas)
    return step, np.asarray(kappas[0] + step * np.arange(-1, count + 1), dtype=np.float64)


def _values_at(heightfield: HeightField, series: Coefficients, kappas: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the real and imaginary parts of the coefficients at −κ, shape (coefficients, 2, m)."""
    expansion = EXPANSIONS["jacobi-anger"]
    argument = -2.0 * math.pi * expansion.offset_and_scale(heightfield)[1] * kappas
    basis = expansion.basis(argument, series.terms).T.astype(np.float32)
    rows = series.rows.reshape(-1, series.terms)
    return (rows @ basis).reshape(-1, 2, len(kappas))


def _principal_functions(
    values: NDArray[np.float32], weights: NDArray[np.float64], scales: NDArray[np.float32], strongest: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the orthonormal principal functions of all coefficients over κ, at m nodes, by size, shape (m, m)."""
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
    """Return truncation errors with 0, 1, … terms: the percentile ``_PERCENTILE`` of coefficients' largest errors."""
    rows = sample @ principal
    remaining = sample.copy()
    result = [1.0]
    for n in range(rows.shape[1]):
        remaining -= rows[:, n : n + 1] * back[n]
        result.append(float(np.percentile(np.abs(remaining * weights).max(axis=1), _PERCENTILE)))
        if result[-1] <= _LEAST_TRUNCATION_ERROR:
            break
    return np.asarray(result)
