"""Energy normalisation: reciprocal factors by which the order efficiencies of a perfect mirror sum to 1.

For a perfect mirror, Stam's model gives order m of light from ωi the efficiency K = (1 + ωi·ωr)² |H|² / (cos θi cos θr
w²). K is symmetric in light and view, but its sum over orders, the directional albedo, is not 1. The sum exceeds 1 at
grazing angles and is below 1 where few orders propagate. Division by the albedo of the incident direction conserves
energy but violates reciprocity. Here K becomes a(ωi) K a(ωr). The function a of direction and wavelength makes the sums
over orders 1 for every incident direction and preserves reciprocity (Sinkhorn 1967, Diagonal equivalence to matrices
with prescribed row and column sums).

K grows without bound where an order leaves along the horizon. For directions near the horizon, the prescribed sum is
therefore not 1. It is given by the function `rise`, which falls to 0 at the horizon, so that efficiencies are
continuous where an order begins or ceases to propagate. The remaining power of such a direction goes to its mirror
direction: at grazing incidence every surface becomes a mirror.

ωi and ωr are the unit vectors to the light and along an order, with the angles θi and θr from the normal. (u, v, w) is
−ωi − ωr, and κ is w/λ. H_q is the Fourier coefficient of exp(2πiκh) at the frequency q, where h are the heights.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.caching import LruCache
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ref
from warpdiff.diffraction import chebyshev
from warpdiff.diffraction.phase_series import check_cycles
from warpdiff.kernels.thresholds import HORIZON, LOWEST, TINY
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField

# Largest number of orders for which ``order_efficiencies`` computes the energy factors a(ω) exactly. For more orders,
# the function interpolates the factors on a grid of directions. The computing time of exact factors is proportional to
# the square of the number of orders.
MOST_EXACT = 600
# Numbers of elevations and of azimuths of the grid of directions at which energy factors are computed and between which
# they are interpolated. A finer grid has smaller errors and requires more time.
_ELEVATIONS, _AZIMUTHS = 16, 16
# Width of the bins in which the powers |H|² of neighbouring orders are summed, to save time [units of (u, v), the
# tangential components of ωi + ωr]. The value is about the distance between two nodes of the grid of directions.
_BIN = 0.08
# Number of sweeps of Sinkhorn's iteration before Newton's method starts. A sweep scales each row and each column of the
# matrix of efficiencies once. Sweeps always converge towards the balanced factors. Newton's method is faster, but must
# start near the solution. Measurements show that Newton's method needs one to five steps after 20 sweeps, even for
# shallow profiles, for which even 200 sweeps leave an error of 3e-4 of a weak order. If the number was doubled, only
# computing time would be lost.
_SWEEPS = 20
# Largest number of steps of Newton's method. If the method has not converged after this number of steps, it never
# converges: too many elements of the matrix of efficiencies are 0, so that no factors give the prescribed sums.
_MOST_STEPS = 60
# The energy factors count as converged if no sum over orders deviates from its prescribed value by more than this
# number, relative to the value. The number is about the rounding error of a sum over `MOST_EXACT` orders.
_CONVERGED = 2e-13
# Largest change of the logarithm of an energy factor in one step of Newton's method. The value was chosen because the
# linear equations of a step are not a good approximation for larger changes.
_LONGEST_STEP = 1.0
# Number that is added to the diagonal of Newton's equations, relative to the largest element of the diagonal. Without
# it, the equations would have no unique solution: in each group of orders that exchange no power with other orders, all
# factors may be multiplied by one number. The value was derived from the rounding error of float64.
_RIDGE = 1e-15
# The energy factors on the grid of directions are balanced by sweeps of Sinkhorn's iteration. `_MOST_GRID_SWEEPS` is
# the largest number of sweeps. Sweeps end earlier if no factor changes by more than `_GRID_CONVERGED`, relative to the
# factor. If the factors have not converged, Newton's method continues.
_MOST_GRID_SWEEPS, _GRID_CONVERGED = 200, 1e-10
# The power of a bin of orders is tabulated over |κ|. This number is the number of entries per radian of π|κ| · (height
# range). The fastest oscillation of a power has twice this phase. Parabolas interpolate between entries.
_PER_RADIAN = 6.0
# Largest number of entries of each cache of energy factors; an entry belongs to one height field.
_CACHED = 8
# Number of random light directions, each with a wavelength, over which the energy factors for colours are balanced.
# Computing time is proportional to this number.
_LIGHTS = 4096
# Range of the wavelengths of the random lights [nm]; it contains nearly all visible power.
_VISIBLE_RANGE_NM = (400.0, 700.0)
# Constant of Roberts' quasi-random sequence in three dimensions, the real root of x⁴ = x + 1.
_PLASTIC = 1.22074408460575947536
# `AchromaticFactors.spread` is measured for directions to the light within this angle of the normal [radians]. The
# energy factors for colours conserve only the total power of all wavelengths. At a single wavelength, the reflected
# power therefore deviates from the incident power, and `spread` states by how much.
_STEEPEST = math.radians(80.0)
# Wavelengths are divided into fixed bands, so that the energy factors of a wavelength do not depend on the other
# wavelengths of a call. In each band, the factors are computed at this number of wavelengths and interpolated linearly.
# The second value is the visible band [nm]; the longest and shortest wavelength of every band have the same ratio.
_NODES, _BAND_NM = 5, (colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM)
# Largest number of different incident directions in a call for which the efficiencies of all orders are made to sum to
# exactly 1. For more directions, exact sums would require too much time, and the factors are interpolated instead.
_MOST_LIGHTS = 64
# The prescribed sum over orders (`rise`) reaches 1 at this cosine of the angle from the normal, which is 5.7° above the
# horizon. The value was fitted among values from 0.05 to 1. It gives the smallest mean error of the efficiencies of
# perfect mirrors, compared with rigorous solutions (bench/reproduce/theory_verdict.py). If the value is doubled, the
# mean error is 3 % larger.
RISEN = 0.1
# Smallest sum of efficiencies over orders that is used as a divisor. A sum is smaller only if the power of all
# propagating orders is zero.
_LEAST_SUM = 1e-12


class Powers:
    """Powers |H_q(κ)|² of the orders of a height field, added in bins of neighbouring orders, for any |κ| = |w|/λ.

    Attributes:
        frequencies: Centres of the bins of orders, (u, v)/λ [1/µm], shape (p, 2).
    """

    def __init__(self, heightfield: HeightField, highest_kappa: float, bin_um: float) -> None:
        """Compute the powers |H|² of the orders, summed in bins of neighbouring orders.

        Args:
            heightfield: Height field, one period.
            highest_kappa: Largest |κ| [1/µm].
            bin_um: Largest width of a bin [1/µm]; 0 gives each order a bin of its own.
        """
        # Number of Chebyshev polynomials in κ that represent the power of an order. The number is computed from the
        # number of oscillations of the power over κ.
        argument = math.pi * highest_kappa * heightfield.height_range_um
        count = math.ceil(argument + 4.0 * math.cbrt(argument)) + 6
        heights = heightfield.heights_um - (heightfield.heights_um.max() + heightfield.heights_um.min()) / 2.0
        # If the number n of samples is even, the orders n/2 and −n/2 are aliases of each other. The Fourier transform
        # contains their common coefficient only once. The coefficient is copied, so that both orders have it.
        counts = [n + 1 - n % 2 if n > 1 else 1 for n in heightfield.shape]
        starts = [
            _block_starts(n, max(1, min(round(bin_um * length), n)))
            for length, n in zip(heightfield.size_um, counts, strict=True)
        ]
        sums = []
        for kappa in chebyshev.nodes(0.0, highest_kappa, count):
            # κ = w/λ is negative and `kappa` is its magnitude, so exp(2πiκh) is computed as exp(−2πi · kappa · h).
            power = np.abs(np.fft.fftshift(np.fft.ifft2(np.exp(-2j * math.pi * kappa * heights)))) ** 2
            power = np.pad(power, [(0, k - n) for k, n in zip(counts, heightfield.shape, strict=True)], mode="wrap")
            sums.append(np.add.reduceat(np.add.reduceat(power, starts[0], axis=0), starts[1], axis=1).ravel())
        dense = math.ceil(_PER_RADIAN * argument) + 32
        self._per_kappa = (dense - 1) / highest_kappa
        places = [
            ((first + np.append(first[1:], n) - 1) / 2.0 - n // 2) / length * (n > 1)
            for first, n, length in zip(starts, counts, heightfield.size_um, strict=True)
        ]
        v, u = np.meshgrid(*places, indexing="ij")
        # Bins of orders beyond the largest |κ| = 2/λ are dropped. Their orders never propagate, because |(u, v)| is at
        # most 2.
        reachable = np.flatnonzero(np.hypot(u, v).ravel() <= highest_kappa)
        self.frequencies = np.stack([u.ravel()[reachable], v.ravel()[reachable]], axis=1)
        cardinals = chebyshev.cardinals(np.linspace(0.0, highest_kappa, dense), 0.0, highest_kappa, count)
        self._values = np.maximum(cardinals @ np.stack(sums)[:, reachable], 0.0).astype(np.float32)

    def at(self, places: NDArray[np.int64], kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the powers of the bins (of orders) ``places``, each at its own |κ| [1/µm] from ``kappas``."""
        steps = kappas * self._per_kappa
        middle = np.clip(np.rint(steps).astype(np.int64), 1, len(self._values) - 2)
        t = steps - middle
        before, at, after = (self._values[middle + k, places] for k in (-1, 0, 1))
        return np.asarray(np.maximum(at + 0.5 * t * (after - before) + 0.5 * t * t * (after - 2.0 * at + before), 0.0))


def _block_starts(n: int, block: int) -> NDArray[np.int64]:
    """Split n diffraction orders into blocks; return the index of the first order of each block.

    The zeroth order, which has the index n // 2, is in the middle of its block.
    """
    first = (n // 2 - block // 2) % block
    return np.arange(first, n, block) if first == 0 else np.concatenate([[0], np.arange(first, n, block)])


def rise(cosines: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the prescribed sum of efficiencies by the cosine of a direction: 0 at the horizon, 1 from `RISEN` on."""
    share = np.minimum(cosines / RISEN, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def stam(
    cos_light: NDArray[np.float64], cos_view: NDArray[np.float64], tangential: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return K/|H|² = (1 + ωi·ωr)² / (cos θi cos θr w²), the geometry factor of Stam's efficiencies.

    w is −(cos θi + cos θr). ``tangential`` is ωi·ωr minus the product of the cosines.
    """
    w = cos_light + cos_view
    return np.asarray((1.0 + cos_light * cos_view + tangential) ** 2 / (cos_light * cos_view * w**2))


@dataclass(frozen=True)
class EnergyFactors:
    """Energy factor a, by which efficiencies are multiplied, on a grid of directions, for several wavelengths.

    Attributes:
        wavelengths_nm: Wavelengths [nm], increasing, shape (k,).
        values: Factors for k wavelengths on the grid of ``grid_weights``, which has n elevations and m azimuths, shape
            (k, n, m).
    """

    wavelengths_nm: NDArray[np.float64]
    values: NDArray[np.float64]

    def at(self, directions: NDArray[np.float64], wavelength_nm: float) -> NDArray[np.float64]:
        """Return energy factors at unit vectors (n, 3) and a wavelength [nm], by linear interpolation, shape (n,)."""
        nodes, weights = grid_weights(directions)
        place = float(np.interp(wavelength_nm, self.wavelengths_nm, np.arange(len(self.wavelengths_nm))))
        before = min(int(place), len(self.wavelengths_nm) - 2)
        values = (before + 1.0 - place) * self.values[before] + (place - before) * self.values[before + 1]
        return np.asarray(np.sum(weights * values.ravel()[nodes], axis=1))

    def risen(self, views: NDArray[np.float64], wavelength_nm: float) -> NDArray[np.float64]:
        """Return the energy factors at view directions, times `rise`, which is 0 at the horizon, shape (n,)."""
        return self.at(views, wavelength_nm) * rise(views[:, 2])


@dataclass(frozen=True)
class AchromaticFactors:
    """Energy factor a for colours, as a function of direction only: it conserves the total power of all wavelengths.

    Attributes:
        values: Factors on the grid of ``grid_weights``, which has n elevations and m azimuths, float32, shape (n, m).
        spread: Relative deviation of the reflected power from the incident power, for single wavelengths and directions
            to the light: root mean square, weighted by the power that the light sends to the surface, which is
            proportional to the cosine of its angle from the normal. Lights beyond 80° from the normal are excluded.
    """

    values: NDArray[np.float32]
    spread: float

    def between(self, lights: NDArray[np.float64], views: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return products of energy factors a(ωi) a(ωr) for n pairs of unit vectors above the horizon, shape (n,)."""
        factors = []
        for directions in (lights, views):
            nodes, weights = grid_weights(directions)
            factors.append(np.sum(weights * self.values.ravel()[nodes], axis=1))
        return np.asarray(factors[0] * factors[1])


@single_threaded_blas()
def achromatic_factors(heightfield: HeightField) -> AchromaticFactors:
    """Return the energy factors of a height field for colours, from the cache if possible.

    For a single incident direction, the sum of efficiencies over orders jumps when an order passes the horizon. The
    factors therefore balance averages over many incident directions and wavelengths. The power of each incident light
    and of each order is distributed to the nearest nodes of the grid of directions.
    """
    check_cycles(heightfield, 2e3 / _VISIBLE_RANGE_NM[0])

    def make() -> AchromaticFactors:
        lights, wavelengths_um = _sample_lights()
        powers = Powers(heightfield, 2.0 / float(wavelengths_um.min()), _BIN / float(wavelengths_um.max()))
        nodes, weights = grid_weights(lights)
        entering = np.zeros((len(lights), _ELEVATIONS * _AZIMUTHS))
        np.put_along_axis(entering, nodes, weights, axis=1)
        # All nodes in the first row of the grid of directions have the same direction, the normal. Their columns of the
        # matrix are therefore added to one column.
        entering, leaving = (
            np.column_stack([matrix[:, :_AZIMUTHS].sum(axis=1), matrix[:, _AZIMUTHS:]])
            for matrix in (entering, _distributed(powers, lights, wavelengths_um))
        )
        # The weight of a light in the energy balance is its power on the surface: cos θ times its solid angle. The
        # solid angle is proportional to sin θ, because the lights are uniform in the polar angle θ.
        flux = lights[:, 2] * np.sqrt(1.0 - lights[:, 2] ** 2)
        incoming = entering * flux[:, None]
        exchanged = incoming.T @ leaving
        factors = _balanced((exchanged + exchanged.T) / (2.0 * incoming.sum(axis=0)[:, None]))
        sent = (entering @ factors) * (leaving @ factors)
        is_counted = lights[:, 2] > math.cos(_STEEPEST)
        spread = math.sqrt(np.average((sent[is_counted] - 1.0) ** 2, weights=flux[is_counted]))
        values = np.concatenate([np.full(_AZIMUTHS, factors[0]), factors[1:]]).reshape(_ELEVATIONS, _AZIMUTHS)
        return AchromaticFactors(values.astype(np.float32), spread)

    return _achromatic_cache.get_or_make(_cache_key(heightfield), make)


def _cache_key(heightfield: HeightField) -> tuple[object, ...]:
    """Return the cache key for the factors of a height field, which contains a hash of the heights."""
    digest = hashlib.sha256(np.ascontiguousarray(heightfield.heights_um).data).digest()
    return digest, heightfield.shape, heightfield.pitch_um


def _sample_lights() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions (n, 3), uniform in both angles of the hemisphere, and a wavelength [µm] for each, (n,).

    Directions and wavelengths follow the additive recurrence of Roberts (2018) in three dimensions. The density of the
    wavelengths is proportional to the sum of the colour-matching functions under D65. Each direction is accompanied by
    its mirror direction. If one order reflects nearly all light, the energy balance determines only the product of the
    factors of the incident and the outgoing direction. With mirror directions, these two factors become similar.
    """
    places = (0.5 + np.outer(np.arange(_LIGHTS // 2), _PLASTIC ** -np.arange(1.0, 4.0))) % 1.0
    polar, around = places[:, 0] * math.pi / 2.0, places[:, 1] * 2.0 * math.pi
    sine = np.sin(polar)
    lights = np.stack([sine * np.cos(around), sine * np.sin(around), np.cos(polar)], axis=1)
    visible = np.cumsum(colorimetry.colour_products().sum(axis=1))
    nm = np.clip(np.interp(places[:, 2], visible / visible[-1], colorimetry.VISIBLE_NM), *_VISIBLE_RANGE_NM)
    return np.concatenate([lights, lights * (-1.0, -1.0, 1.0)]), np.tile(1e-3 * nm, 2)


def grid_weights(directions: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the four nodes of the grid of directions around unit vectors, and their interpolation weights, (n, 4).

    The rows of the grid are equally spaced in √(1 − cos θ), which is nearly proportional to θ. In each quadrant, the
    columns are equally spaced in y/(|x| + |y|).
    """
    x, y, z = directions.T
    row = np.sqrt(np.clip((1.0 - z) / (1.0 - LOWEST), 0.0, 1.0)) * (_ELEVATIONS - 1)
    share = y / np.maximum(np.abs(x) + np.abs(y), TINY)
    column = np.where(x < 0.0, 2.0 - share, share) % 4.0 / 4.0 * _AZIMUTHS
    r = np.minimum(row.astype(np.int64), _ELEVATIONS - 2)
    c = np.minimum(column.astype(np.int64), _AZIMUTHS - 1)
    s, t = row - r, column - c
    nodes = np.stack([r * _AZIMUTHS + c, r * _AZIMUTHS + (c + 1) % _AZIMUTHS], axis=1)
    weights = np.stack([(1.0 - s) * (1.0 - t), (1.0 - s) * t, s * (1.0 - t), s * t], axis=1)
    return np.concatenate([nodes, nodes + _AZIMUTHS], axis=1), weights


def _grid() -> NDArray[np.float64]:
    """Return the directions of the grid nodes, shape (n, 3), which include the mirror direction of every node."""
    z = 1.0 - (1.0 - LOWEST) * (np.arange(_ELEVATIONS)[:, None] / (_ELEVATIONS - 1.0)) ** 2
    turn = 4.0 * np.arange(_AZIMUTHS) / _AZIMUTHS
    # For each column of the grid of directions, x and y are a point on the square |x| + |y| = 1. This inverts the
    # formula of ``grid_weights``, where the columns are equally spaced in y/(|x| + |y|).
    y = 1.0 - np.abs((turn + 1.0) % 4.0 - 2.0)
    x = 1.0 - np.abs((turn + 2.0) % 4.0 - 2.0)
    level = np.sqrt(1.0 - z**2) / np.hypot(x, y)
    return np.stack([level * x, level * y, z + 0.0 * x], axis=-1).reshape(-1, 3)


def _outgoing(
    powers: Powers, light: NDArray[np.float64], wavelength_um: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the n directions into which bins of orders diffract a light, (n, 3), and their efficiencies K, (n,)."""
    # The coefficient at q diffracts into the direction ωr for which the tangential part of ωi + ωr is −λq.
    tangential = -powers.frequencies * wavelength_um - light[:2]
    upward2 = 1.0 - np.sum(tangential**2, axis=1)
    live = np.flatnonzero(upward2 > HORIZON**2)
    cosines = np.sqrt(upward2[live])
    views = np.column_stack([tangential[live], cosines])
    power = powers.at(live, (light[2] + cosines) / wavelength_um)
    return views, power * stam(np.full_like(cosines, light[2]), cosines, views[:, :2] @ light[:2])


@single_threaded_blas()
def factors_around(heightfield: HeightField, wavelength_nm: float) -> EnergyFactors:
    """Return the energy factors for the band of wavelengths around ``wavelength_nm``, from the cache if possible."""
    shortest, longest = _BAND_NM
    band = math.floor(math.log(wavelength_nm / shortest) / math.log(longest / shortest))
    nodes = np.geomspace(shortest, longest, _NODES) * (longest / shortest) ** band
    check_cycles(heightfield, 2e3 / wavelength_nm)

    def make() -> EnergyFactors:
        powers = Powers(heightfield, 2e3 / nodes[0], 1e3 * _BIN / nodes[-1])
        grid = _grid()
        values = [_balanced(_distributed(powers, grid, np.full(len(grid), node))) for node in 1e-3 * nodes]
        return EnergyFactors(nodes, np.stack(values).reshape(-1, _ELEVATIONS, _AZIMUTHS))

    return _factors_cache.get_or_make((*_cache_key(heightfield), band), make)


_factors_cache: LruCache[EnergyFactors] = LruCache(_CACHED)
_achromatic_cache: LruCache[AchromaticFactors] = LruCache(_CACHED)


def _distributed(
    powers: Powers, lights: NDArray[np.float64], wavelengths_um: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the efficiencies K of n lights into the m nodes of the grid of directions, shape (n, m).

    The efficiency of each order is distributed to the four nodes around its direction.
    """
    result = np.empty((len(lights), _ELEVATIONS * _AZIMUTHS))
    for row, (light, wavelength_um) in enumerate(zip(lights, wavelengths_um.tolist(), strict=True)):
        views, efficiencies = _outgoing(powers, light, wavelength_um)
        nodes, weights = grid_weights(views)
        result[row] = np.bincount(nodes.ravel(), (weights * efficiencies[:, None]).ravel(), result.shape[1])
    return result


@single_threaded_blas()
def balanced(
    matrix: NDArray[np.float64], rows: NDArray[np.float64], columns: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return factors a of rows, (n,), and b of columns, (m,), so that the matrix a_i K_ij b_j has prescribed sums.

    Sinkhorn's iteration finds a start for Newton's method, which converges quadratically.

    Args:
        matrix: K, shape (n, m).
        rows: Prescribed sums of the rows, more than 0, shape (n,).
        columns: Prescribed sums of the columns, more than 0, with the same total, shape (m,).

    Warns:
        WarpdiffWarning: The factors have not converged, because no factors give the prescribed sums.
    """
    first, second = np.ones(matrix.shape[0]), np.ones(matrix.shape[1])
    for _ in range(_SWEEPS):
        first = rows / np.maximum(matrix @ second, _LEAST_SUM)
        second = columns / np.maximum(matrix.T @ first, _LEAST_SUM)
    for _ in range(_MOST_STEPS):
        shares = first[:, None] * matrix * second
        off_rows, off_columns = rows - shares.sum(axis=1), columns - shares.sum(axis=0)
        deviation = float(max(np.max(np.abs(off_rows) / rows), np.max(np.abs(off_columns) / columns)))
        if deviation <= _CONVERGED:
            return rows / np.maximum(matrix @ second, _LEAST_SUM), second
        log_first, log_second = balance_response(shares, off_rows, off_columns)
        longest = max(np.max(np.abs(log_first)), np.max(np.abs(log_second)))
        damping = min(1.0, _LONGEST_STEP / longest) if longest > 0.0 else 1.0
        first, second = first * np.exp(damping * log_first), second * np.exp(damping * log_second)
    _warn_unconverged(deviation)
    return rows / np.maximum(matrix @ second, _LEAST_SUM), second


def balance_response(
    shares: NDArray[np.float64], rows: NDArray[np.float64], columns: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return changes x, y of the logarithms of row and column factors that cause given changes of sums of a matrix P.

    They solve diag(P1) x + P y = ``rows`` and Pᵀ x + diag(Pᵀ1) y = ``columns``, where 1 is a vector of ones. The matrix
    of these equations is symmetric, so that the function is also its own transpose, which derivatives require.

    Args:
        shares: Balanced matrix P, shape (n, m).
        rows: Changes of the sums of rows, shape (n,) or (n, k).
        columns: Changes of the sums of columns, with the same total, shape (m,) or (m, k).
    """
    sums = np.maximum(shares.sum(axis=1), _LEAST_SUM)
    per_row = (1.0 / sums).reshape(-1, *(1,) * (rows.ndim - 1))
    # The Schur complement of diag(P1) is a Laplacian matrix: its product with a constant vector is 0. The mean of y is
    # therefore not determined by the equations, and is set to 0.
    complement = np.diag(shares.sum(axis=0)) - shares.T @ (shares / sums[:, None])
    scale = float(np.max(np.abs(complement.diagonal()), initial=_LEAST_SUM))
    complement += scale / len(complement) + scale * _RIDGE * np.eye(len(complement))
    y = np.linalg.solve(complement, columns - shares.T @ (rows * per_row))
    return np.asarray((rows - shares @ y) * per_row), np.asarray(y)


def _warn_unconverged(deviation: float) -> None:
    warn(
        f"the energy normalisation has not converged: sums over orders may be wrong by {deviation:.2g} of their value, "
        f"because single orders carry no power; use {ref('energy', 'stam')}"
    )


def _balanced(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Balance a matrix K that is symmetric up to quadrature errors: return factors a with a (K a) = 1, shape (n,)."""
    factors = np.ones(len(matrix))
    for _ in range(_MOST_GRID_SWEEPS):
        before, factors = factors, np.sqrt(factors / np.maximum(matrix @ factors, _LEAST_SUM))
        if np.max(np.abs(factors / before - 1.0)) < _GRID_CONVERGED:
            return factors
    for _ in range(_MOST_STEPS):
        shares = factors[:, None] * matrix * factors
        off = 1.0 - shares.sum(axis=1)
        if np.max(np.abs(off)) < _GRID_CONVERGED:
            return factors
        step = np.linalg.lstsq(np.diag(shares.sum(axis=1)) + shares, off, rcond=None)[0]
        factors = factors * np.exp(step * min(1.0, _LONGEST_STEP / max(float(np.max(np.abs(step))), TINY)))
    _warn_unconverged(float(np.max(np.abs(off))))
    return factors


def sums_from(
    factors: EnergyFactors, powers: Powers, lights: NDArray[np.float64], wavelength_nm: float
) -> NDArray[np.float64]:
    """Return the sum of K a(ωr) over all orders of each light, shape (n,). K is the efficiency, a the energy factor.

    ``powers`` has the powers |H|² of the orders, and must have a separate bin for each order.
    """
    result = np.ones(len(lights))
    for row, light in enumerate(lights):
        views, efficiencies = _outgoing(powers, light, 1e-3 * wavelength_nm)
        result[row] = max(float(efficiencies @ factors.risen(views, wavelength_nm)), _LEAST_SUM)
    return result


def between(
    heightfield: HeightField,
    lights: NDArray[np.float64],
    views: NDArray[np.float64],
    wavelengths_nm: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the products a(ωi) a(ωr) of energy factors for n pairs of directions and m wavelengths [nm], shape (n, m).

    For at most ``_MOST_LIGHTS`` different lights, a(ωi) makes the sum over all orders exactly 1. For more lights, a(ωi)
    is interpolated on the grid of directions.
    """
    distinct, which = np.unique(lights, axis=0, return_inverse=True)
    powers = Powers(heightfield, 2e3 / float(wavelengths_nm.min()), 0.0) if len(distinct) <= _MOST_LIGHTS else None
    result = np.empty((len(views), len(wavelengths_nm)))
    for column, wavelength_nm in enumerate(wavelengths_nm.tolist()):
        factors = factors_around(heightfield, wavelength_nm)
        if powers is None:
            first = factors.at(distinct, wavelength_nm)
        else:
            first = 1.0 / sums_from(factors, powers, distinct, wavelength_nm)
        result[:, column] = first[which.ravel()] * factors.risen(views, wavelength_nm)
    return result
