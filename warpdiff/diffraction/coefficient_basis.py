"""Bases of the Fourier coefficients as functions of κ: a row of numbers per coefficient times a shared basis.

``"taylor"``, ``"taylor-uncentred"`` and ``"jacobi-anger"`` are series of the exponential (``phase_series``), whose rows
are amplitudes. The other two are made from the last, for the range of κ that a scene reaches:

- ``"power"``: the Chebyshev series of |H_rs(κ)|², a real function of κ of a bandwidth of twice the height range. Where
  powers add, its rows are half as long and need not be squared.
- ``"low-rank"``: the principal functions of κ of the height field's own coefficients, powers where powers add and
  amplitudes elsewhere. On an interval an exponential of bandwidth B takes some B·length functions, of which polynomials
  need π/2 as many and a series about κ = 0 several times; and real coefficients do not even span those.
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

# Entries of a basis' table per radian of a power's fastest oscillation, e^{2πiκ(h − h')}: the cubic errs by 0.023/16⁴ =
# 4e-7. Amplitudes of centred heights oscillate half as fast and err by 2e-8.
_STEPS_PER_RADIAN = 16
# Of a shallow surface nothing oscillates, but what it scatters n times is in proportion to κ²ⁿ.
_FEWEST_STEPS = 64
# What is left out of the series that fitted bases are made from, and the least of what is kept of them: float32.
_SERIES_TOLERANCE = 1e-7
_LEAST_TRUNCATION_ERROR = 1e-7
# The largest coefficients count as much as all others together: the mirror direction is one of a million.
_STRONGEST_ROWS = 64
# Residuals are measured on this many coefficients, and this share of them may exceed the figure.
_SAMPLED_ROWS = 20_000
_PERCENTILE = 99.9
# Powers this far below the mirror's are the transforms' rounding and weigh no more than it.
_NOISE_POWER = 1e-26
# Below this share of the largest |κ| errors count as at it. The mirror's coefficient does not vanish, and float32 loses
# the square of this factor of it.
_SMALL_KAPPA = 0.1
_CHUNK = 65_536
# A Taylor basis far beyond its range, which is computed on request only, stays within float32.
_LARGEST = 1e30


@dataclass(frozen=True)
class Coefficients:
    """Rows and basis.

    Attributes:
        rows: Shape (my, mx, parts, terms), float32: one part, powers, or two, real and imaginary parts.
        basis: Shape (entries, terms), float32, at |κ| = kappa_low − step, kappa_low, …, two steps beyond the range.
        kappa_low: Lower end of the range of |κ| [1/µm].
        step: Distance of the entries [1/µm].
        truncation_errors: Errors with the first n terms, n = 0 … terms, relative to a coefficient's largest value in
            the range; for the fitted bases. Empty for a series, whose remainder is bounded.
    """

    rows: NDArray[np.float32]
    basis: NDArray[np.float32]
    kappa_low: float
    step: float
    truncation_errors: NDArray[np.float64]

    @property
    def terms(self) -> int:
        """Number of terms."""
        return int(self.rows.shape[-1])

    def basis_at(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """The basis at |κ| [1/µm] within its range, shape (len(kappas), terms), by the cubics that the kernels take."""
        steps = (np.asarray(kappas) - self.kappa_low) / self.step
        entry = np.clip(np.floor(steps), 0, len(self.basis) - 4).astype(int)
        basis = self.basis.astype(np.float64)
        weights = chebyshev.cubic_weights((steps - entry)[:, None])
        return np.asarray(sum(weight * basis[entry + k] for k, weight in enumerate(weights)))

    @forks.cached_property
    def strongest(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The few dozen largest coefficients at a |κ| in the middle of the range: places, flattened, and powers."""
        high = self.kappa_low + self.step * (len(self.basis) - 3)
        middle = math.sqrt(max(self.kappa_low, _SMALL_KAPPA * high) * high)
        parts = np.einsum("yxpt,t->yxp", self.rows, self.basis_at(np.array([middle]))[0].astype(np.float32))
        powers = parts[..., 0] if parts.shape[2] == 1 else np.sum(parts.astype(np.float64) ** 2, axis=2)
        most = min(_STRONGEST_ROWS, powers.size)
        places = np.argpartition(powers.ravel(), -most)[-most:]
        places = places[np.argsort(-powers.ravel()[places], kind="stable")]
        return places, powers.ravel()[places].astype(np.float64)

    def terms_within(self, tolerance: float) -> int:
        """The fewest terms of a fitted basis that leave out no more than a tolerance, or all of them."""
        enough = np.flatnonzero(self.truncation_errors <= tolerance)
        return max(1, int(enough[0])) if enough.size else self.terms


def holds_powers(method: str, *, adds_powers: bool) -> bool:
    """Whether the rows of a method are powers."""
    return method == "power" or (method == "low-rank" and adds_powers)


def series_terms(heightfield: HeightField, kappas: tuple[float, float]) -> int:
    """Terms of the Jacobi-Anger series that fitted bases are made from, for |κ| in a range [1/µm]."""
    series = EXPANSIONS["jacobi-anger"]
    argument = 2.0 * math.pi * _entries(heightfield, kappas)[-1] * series.offset_and_scale(heightfield)[1]
    return series.term_count(argument, _SERIES_TOLERANCE)


@np.errstate(under="ignore")
def of_series(
    heightfield: HeightField, method: str, grid: Grid, block: Block, kappas: tuple[float, float], *, terms: int,
    threads: int,
) -> Coefficients:  # fmt: skip
    """The coefficients of a block of frequencies by a series of ``EXPANSIONS``, for |κ| in a range [1/µm].

    As many transforms run side by side as there are ``threads``.
    """
    expansion = EXPANSIONS[method]
    series = series_coefficients(
        heightfield, expansion, terms, block, taper=grid.taper, threads=threads, dtype=np.complex64
    )
    rows = np.stack([series.real, series.imag], axis=2).astype(np.float32, copy=False)
    step, table_kappas = _table_kappas(heightfield, kappas)
    # κ is negative: w is.
    basis = expansion.basis(-2.0 * math.pi * expansion.offset_and_scale(heightfield)[1] * table_kappas, terms)
    bounded = np.clip(basis, -_LARGEST, _LARGEST).astype(np.float32)
    return Coefficients(rows, bounded, kappas[0], step, np.zeros(0))


@np.errstate(under="ignore")
def fitted(
    heightfield: HeightField, method: str, series: Coefficients, kappas: tuple[float, float], *, adds_powers: bool
) -> Coefficients:
    """The coefficients in a basis fitted to a range of |κ| [1/µm], with as many terms as float32 can tell apart.

    ``method`` is ``"low-rank"`` or ``"power"``, ``series`` the Jacobi-Anger series of ``series_terms`` terms.
    """
    high = kappas[1]
    step, table_kappas = _table_kappas(heightfield, kappas)
    # Chebyshev nodes over the table's whole range, so that nothing is extrapolated.
    first, last = float(table_kappas[0]), float(table_kappas[-1])
    powers = holds_powers(method, adds_powers=adds_powers)
    bandwidth = (last - first) / 2.0 * _radians_per_kappa(heightfield) * (1.0 if powers else 0.5)
    count = math.ceil(bandwidth + 6.0 * bandwidth ** (1.0 / 3.0) + 10.0)
    nodes = chebyshev.nodes(first, last, count)
    values = _values_at(heightfield, series, nodes)
    if powers:
        values = (values[:, 0] ** 2 + values[:, 1] ** 2)[:, None]

    # All but the mirror's coefficient vanish with κ, powers with its square: errors count relative to that.
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
    """Fastest oscillation of a power."""
    return max(2.0 * math.pi * heightfield.height_range_um, 1e-3)


def _entries(heightfield: HeightField, kappas: tuple[float, float]) -> tuple[float, int, float]:
    """The step of |κ| in a basis' table, how many steps it has beyond the least, and the last |κ|."""
    low, high = kappas
    step = min(1.0 / (_STEPS_PER_RADIAN * _radians_per_kappa(heightfield)), (high - low) / _FEWEST_STEPS or 1.0)
    count = math.ceil((high - low) / step) + 2
    return step, count, low + step * count


def _table_kappas(heightfield: HeightField, kappas: tuple[float, float]) -> tuple[float, NDArray[np.float64]]:
    """The step and the |κ| of the entries of a basis' table."""
    step, count, _ = _entries(heightfield, kappas)
    return step, np.asarray(kappas[0] + step * np.arange(-1, count + 1), dtype=np.float64)


def _values_at(heightfield: HeightField, series: Coefficients, kappas: NDArray[np.float64]) -> NDArray[np.float32]:
    """Real and imaginary parts of the coefficients at −κ, shape (coefficients, 2, m)."""
    expansion = EXPANSIONS["jacobi-anger"]
    argument = -2.0 * math.pi * expansion.offset_and_scale(heightfield)[1] * kappas
    basis = expansion.basis(argument, series.terms).T.astype(np.float32)
    rows = series.rows.reshape(-1, series.terms)
    return (rows @ basis).reshape(-1, 2, len(kappas))


def _principal_functions(
    values: NDArray[np.float32], weights: NDArray[np.float64], scales: NDArray[np.float32], strongest: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Orthonormal functions of κ at its nodes, shape (m, m): those that span weighted coefficients best come first."""
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
    """Largest weighted error over κ with 0, 1, … terms, at a percentile of the sample."""
    rows = sample @ principal
    remaining = sample.copy()
    result = [1.0]
    for n in range(rows.shape[1]):
        remaining -= rows[:, n : n + 1] * back[n]
        result.append(float(np.percentile(np.abs(remaining * weights).max(axis=1), _PERCENTILE)))
        if result[-1] <= _LEAST_TRUNCATION_ERROR:
            break
    return np.asarray(result)
