"""Energy normalisation: reciprocal factors that make the sum of Stam's order efficiencies 1.

With a perfect mirror, order m of light from ωi has the efficiency K = (1 + ωi·ωr)² |H|² / (cos θi cos θr w²), which is
symmetric in light and view, but whose sum over orders, the directional albedo, is not 1: it exceeds 1 at grazing angles
and falls short where few orders propagate. Dividing by the albedo of the incidence alone conserves energy and loses
reciprocity. Here K becomes a(ωi) K a(ωr), with the one function a of directions and wavelengths that makes the sums
over orders 1 from everywhere (Sinkhorn 1967, Diagonal equivalence to matrices with prescribed row and column sums),
which does both.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.caching import LruCache
from warpdiff.core.threads import single_threaded_blas
from warpdiff.diffraction import chebyshev
from warpdiff.diffraction.phase_series import check_cycles
from warpdiff.kernels.thresholds import HORIZON, LOWEST, TINY
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField

# Orders of a family whose sums are made 1 by themselves; the factors of more come from a grid of directions.
MOST_EXACT = 600
# That grid: from the normal and around it, and how wide orders that go together are, in parts of directions.
_ELEVATIONS, _AZIMUTHS, _BIN = 16, 16, 0.08
_SWEEPS, _CONVERGENCE = 200, 1e-10
# Entries over |κ| for each half radian that a power turns by, between which it is a parabola.
_PER_RADIAN = 6.0
_CACHED = 8
# Of colours: lights that factors are of, their shortest and longest wavelength [nm]; the ratio of Roberts' recurrence.
_LIGHTS, _VISIBLE_RANGE_NM, _PLASTIC = 4096, (400.0, 700.0), 1.22074408460575947536
# Up to which angle from the normal it is told what factors leave out.
_STEEPEST = math.radians(80.0)
# Factors of single wavelengths are linear between so many nodes of a band [nm], or of another one in the same ratio
# beside it: they do not depend on what else is asked for.
_NODES, _BAND_NM = 5, (colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM)
# Lights whose sums are made 1 exactly.
_MOST_LIGHTS = 64
# A share of the light that no sum is divided by less than: no order propagates whose coefficient does not vanish.
_LEAST_SUM = 1e-12


class Powers:
    """|H_q(κ)|² of a height field, parabolas between equally spaced |κ|, those of neighbouring orders summed up.

    Attributes:
        frequencies: Middles of the bins of orders, (u, v) [1/µm], shape (p, 2).
    """

    def __init__(self, heightfield: HeightField, highest_kappa: float, bin_um: float) -> None:
        """Up to ``highest_kappa`` [1/µm], in bins of frequencies of at most ``bin_um`` [1/µm]; 0 leaves all apart."""
        # As a function of κ a power is a polynomial of so many terms.
        argument = math.pi * highest_kappa * heightfield.height_range_um
        count = math.ceil(argument + 4.0 * math.cbrt(argument)) + 6
        heights = heightfield.heights_um - (heightfield.heights_um.max() + heightfield.heights_um.min()) / 2.0
        # An even number of samples has an order as far out as any on one side, which is on the other as well.
        counts = [n + 1 - n % 2 if n > 1 else 1 for n in heightfield.shape]
        starts = [
            _block_starts(n, max(1, min(round(bin_um * length), n)))
            for length, n in zip(heightfield.size_um, counts, strict=True)
        ]
        sums = []
        for kappa in chebyshev.nodes(0.0, highest_kappa, count):
            # κ is negative.
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
        # As |(u, v)| and |w| are at most 2, no order beyond the largest |κ| is ever seen.
        reachable = np.flatnonzero(np.hypot(u, v).ravel() <= highest_kappa)
        self.frequencies = np.stack([u.ravel()[reachable], v.ravel()[reachable]], axis=1)
        cardinals = chebyshev.cardinals(np.linspace(0.0, highest_kappa, dense), 0.0, highest_kappa, count)
        self._values = np.maximum(cardinals @ np.stack(sums)[:, reachable], 0.0).astype(np.float32)

    def at(self, places: NDArray[np.int64], kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Powers of some bins, each at a |κ| of its own."""
        steps = kappas * self._per_kappa
        middle = np.clip(np.rint(steps).astype(np.int64), 1, len(self._values) - 2)
        t = steps - middle
        before, at, after = (self._values[middle + k, places] for k in (-1, 0, 1))
        return np.asarray(np.maximum(at + 0.5 * t * (after - before) + 0.5 * t * t * (after - 2.0 * at + before), 0.0))


def _block_starts(n: int, block: int) -> NDArray[np.int64]:
    """Where blocks of indices begin, one of which lies around the middle, n // 2: the mean plane's."""
    first = (n // 2 - block // 2) % block
    return np.arange(first, n, block) if first == 0 else np.concatenate([[0], np.arange(first, n, block)])


def stam(
    cos_light: NDArray[np.float64], cos_view: NDArray[np.float64], tangential: NDArray[np.float64]
) -> NDArray[np.float64]:
    """K/|H|² = (1 + ωi·ωr)² / (cos θi cos θr w²), ``tangential`` the part of ωi·ωr along the surface."""
    w = cos_light + cos_view
    return np.asarray((1.0 + cos_light * cos_view + tangential) ** 2 / (cos_light * cos_view * w**2))


@dataclass(frozen=True)
class EnergyFactors:
    """The factor a of directions and wavelengths, on a grid.

    Attributes:
        wavelengths_nm: Wavelengths [nm], increasing, shape (k,).
        values: On the grid of ``grid_weights``, shape (k, n, m).
    """

    wavelengths_nm: NDArray[np.float64]
    values: NDArray[np.float64]

    def at(self, directions: NDArray[np.float64], wavelength_nm: float) -> NDArray[np.float64]:
        """The factors at unit vectors (n, 3) and a wavelength [nm], shape (n,); linear between what is there."""
        nodes, weights = grid_weights(directions)
        place = float(np.interp(wavelength_nm, self.wavelengths_nm, np.arange(len(self.wavelengths_nm))))
        before = min(int(place), len(self.wavelengths_nm) - 2)
        values = (before + 1.0 - place) * self.values[before] + (place - before) * self.values[before + 1]
        return np.asarray(np.sum(weights * values.ravel()[nodes], axis=1))


@dataclass(frozen=True)
class AchromaticFactors:
    """The factor a of directions alone, for colours: with it what is seen of all wavelengths together is sent back.

    Attributes:
        values: On the grid of ``grid_weights``, float32, shape (n, m).
        spread: By how much what single wavelengths and directions send back differs from what comes in, relative to
            it: a root mean square, weighed by the cosine, up to 80° from the normal.
    """

    values: NDArray[np.float32]
    spread: float

    def between(self, lights: NDArray[np.float64], views: NDArray[np.float64]) -> NDArray[np.float64]:
        """a(ωi) a(ωr) of pairs of unit vectors above the horizon, (n, 3) both, shape (n,)."""
        factors = []
        for directions in (lights, views):
            nodes, weights = grid_weights(directions)
            factors.append(np.sum(weights * self.values.ravel()[nodes], axis=1))
        return np.asarray(factors[0] * factors[1])


@single_threaded_blas()
def achromatic_factors(heightfield: HeightField) -> AchromaticFactors:
    """The factors of a height field for colours; kept for the next call.

    Sums from single directions jump where orders pass the horizon, so that the grid's are means over lights from
    everywhere, each of a wavelength and shared out to the nodes around it, as what leaves is.
    """
    check_cycles(heightfield, 2e3 / _VISIBLE_RANGE_NM[0])

    def make() -> AchromaticFactors:
        lights, wavelengths_um = _sample_lights()
        powers = Powers(heightfield, 2.0 / float(wavelengths_um.min()), _BIN / float(wavelengths_um.max()))
        nodes, weights = grid_weights(lights)
        entering = np.zeros((len(lights), _ELEVATIONS * _AZIMUTHS))
        np.put_along_axis(entering, nodes, weights, axis=1)
        # The normal is one direction, whatever the angle around it.
        entering, leaving = (
            np.column_stack([matrix[:, :_AZIMUTHS].sum(axis=1), matrix[:, _AZIMUTHS:]])
            for matrix in (entering, _distributed(powers, lights, wavelengths_um))
        )
        # dω cos θ of each light.
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
    """What factors depend on; a hash of the heights, which may be large."""
    digest = hashlib.sha256(np.ascontiguousarray(heightfield.heights_um).data).digest()
    return digest, heightfield.shape, heightfield.pitch_um


def _sample_lights() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions that fill the hemisphere evenly by both angles, (n, 3), and a wavelength of each [µm], (n,).

    By the additive recurrence of Roberts (2018) in three dimensions; wavelengths are as many as is seen of them. Each
    light has a twin in its mirror direction: what one order sends back fixes but the product of both factors there, and
    theirs are then alike.
    """
    places = (0.5 + np.outer(np.arange(_LIGHTS // 2), _PLASTIC ** -np.arange(1.0, 4.0))) % 1.0
    polar, around = places[:, 0] * math.pi / 2.0, places[:, 1] * 2.0 * math.pi
    sine = np.sin(polar)
    lights = np.stack([sine * np.cos(around), sine * np.sin(around), np.cos(polar)], axis=1)
    visible = np.cumsum(colorimetry.colour_products().sum(axis=1))
    nm = np.clip(np.interp(places[:, 2], visible / visible[-1], colorimetry.VISIBLE_NM), *_VISIBLE_RANGE_NM)
    return np.concatenate([lights, lights * (-1.0, -1.0, 1.0)]), np.tile(1e-3 * nm, 2)


def grid_weights(directions: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The grid's four nodes around unit vectors (n, 3), and their weights, both (n, 4).

    Rows are even in √(1 − cos θ), nearly so in θ, columns in the share that y has of |x| + |y|, quadrant by quadrant.
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
    """The grid's directions, (n, 3), with each also its mirror direction."""
    z = 1.0 - (1.0 - LOWEST) * (np.arange(_ELEVATIONS)[:, None] / (_ELEVATIONS - 1.0)) ** 2
    turn = 4.0 * np.arange(_AZIMUTHS) / _AZIMUTHS
    # The inverse of ``grid_weights``: y's share of |x| + |y|, and x's.
    y = 1.0 - np.abs((turn + 1.0) % 4.0 - 2.0)
    x = 1.0 - np.abs((turn + 2.0) % 4.0 - 2.0)
    level = np.sqrt(1.0 - z**2) / np.hypot(x, y)
    return np.stack([level * x, level * y, z + 0.0 * x], axis=-1).reshape(-1, 3)


def _outgoing(
    powers: Powers, light: NDArray[np.float64], wavelength_um: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where bins of orders leave from a light, unit vectors (n, 3), and their K, (n,)."""
    # Coefficient q leaves where ωi + ωr = −λq along the surface.
    tangential = -powers.frequencies * wavelength_um - light[:2]
    upward2 = 1.0 - np.sum(tangential**2, axis=1)
    live = np.flatnonzero(upward2 > HORIZON**2)
    cosines = np.sqrt(upward2[live])
    views = np.column_stack([tangential[live], cosines])
    power = powers.at(live, (light[2] + cosines) / wavelength_um)
    return views, power * stam(np.full_like(cosines, light[2]), cosines, views[:, :2] @ light[:2])


@single_threaded_blas()
def factors_around(heightfield: HeightField, wavelength_nm: float) -> EnergyFactors:
    """The factors of a height field on a grid of directions, in a wavelength's band; kept for the next call."""
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
    """K from lights (n, 3), of a wavelength each, to the grid's directions, which orders are shared out to, (n, m)."""
    result = np.empty((len(lights), _ELEVATIONS * _AZIMUTHS))
    for row, (light, wavelength_um) in enumerate(zip(lights, wavelengths_um.tolist(), strict=True)):
        views, efficiencies = _outgoing(powers, light, wavelength_um)
        nodes, weights = grid_weights(views)
        result[row] = np.bincount(nodes.ravel(), (weights * efficiencies[:, None]).ravel(), result.shape[1])
    return result


def balanced(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Factors a of rows and b of columns with a (K b) = 1 and b (Kᵀ a) = 1, (n,) and (m,)."""
    first, second = np.ones(matrix.shape[0]), np.ones(matrix.shape[1])
    for _ in range(_SWEEPS):
        before = first
        first = 1.0 / np.maximum(matrix @ second, _LEAST_SUM)
        second = 1.0 / np.maximum(matrix.T @ first, _LEAST_SUM)
        if np.max(np.abs(first / before - 1.0)) < _CONVERGENCE:
            break
    return 1.0 / np.maximum(matrix @ second, _LEAST_SUM), second


def _balanced(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The factors a with a (K a) = 1 of a matrix that is symmetric but for what quadratures leave, (n,)."""
    factors = np.ones(len(matrix))
    for _ in range(_SWEEPS):
        before, factors = factors, np.sqrt(factors / np.maximum(matrix @ factors, _LEAST_SUM))
        if np.max(np.abs(factors / before - 1.0)) < _CONVERGENCE:
            break
    return factors


def sums_from(
    factors: EnergyFactors, powers: Powers, lights: NDArray[np.float64], wavelength_nm: float
) -> NDArray[np.float64]:
    """Σ K a(ωr) over all orders, which lie apart, of each light (n, 3), shape (n,)."""
    result = np.ones(len(lights))
    for row, light in enumerate(lights):
        views, efficiencies = _outgoing(powers, light, 1e-3 * wavelength_nm)
        result[row] = max(float(efficiencies @ factors.at(views, wavelength_nm)), _LEAST_SUM)
    return result


def between(
    heightfield: HeightField,
    lights: NDArray[np.float64],
    views: NDArray[np.float64],
    wavelengths_nm: NDArray[np.float64],
) -> NDArray[np.float64]:
    """a(ωi) a(ωr) of pairs of directions above the horizon, (n, 3) both, at wavelengths [nm] (m,), shape (n, m).

    Of few lights a(ωi) is such that the sum over all orders is 1; of many it comes from the grid, too.
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
        result[:, column] = first[which.ravel()] * factors.at(views, wavelength_nm)
    return result
