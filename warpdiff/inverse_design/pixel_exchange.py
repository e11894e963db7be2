"""Exchange of pixels: a design with few levels is improved by changes of single pixels and of the depth.

The values of a design are the XYZ of its colours and the efficiencies of its orders. They are linear in powers |H|².
Here H is a Fourier coefficient of exp(−2πi|κ|h) for heights h and a given κ. It is a sum over pixels of
``basis`` · exp(−2πi|κ|h), where ``basis`` depends on the indices of H and on the position of the pixel. If a pixel
changes its level, one summand of each coefficient changes, so that a trial of all levels of a pixel requires one
product of matrices.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.gaussian_lobes import exponent_of
from warpdiff.adjoint.reflection import index_of
from warpdiff.adjoint.spectral_derivatives import SpectralCall
from warpdiff.adjoint.spectral_model import Illumination
from warpdiff.core import memory
from warpdiff.core.threads import single_threaded_blas
from warpdiff.evaluate.orders import propagating
from warpdiff.inverse_design.goal import SEARCH_TRUNCATION
from warpdiff.optics import reflectance_factors
from warpdiff.optics.materials import check_reflection, reflectances

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.inverse_design.goal import Goal
    from warpdiff.inverse_design.targets import Target
    from warpdiff.profiles.sampled_profiles import Pixels

    Array = NDArray[np.float64]
    Indices = NDArray[np.int64]
    # Function of the levels of all pixels, and of the row and column of one pixel. It returns the height levels to
    # which this pixel may change.
    Rule = Callable[[Indices, int, int], list[int]]

# Largest number of passes over all pixels, each of which tries other height levels for every pixel. The value is
# limited by computing time: a seventh pass would lower the loss by less than 1 %.
_MOST_SWEEPS = 6
# Least decrease of the loss for which a pixel changes its height level. The value is limited by rounding errors.
_LEAST_GAIN = 1e-9
# Largest number of complex multiplications in a pass over all pixels, which tries other height levels for every pixel.
# Designs that need more are only rounded to levels. The value is limited by the computing time, about a minute.
_MOST_PRODUCTS = 2e10
# The best depth is searched in `_REFINEMENTS` passes, each of which tries `_DEPTHS` depths with equal steps. A pass
# after the first one covers one step of the previous pass on both sides of the best depth. Both numbers were chosen
# because they find the depth to 1/2000 of its range. If doubled, the depth does not change visibly.
_DEPTHS, _REFINEMENTS = 21, 3


@dataclass(frozen=True)
class Coefficients:
    """Fourier coefficients H of exp(−2πi|κ|h), on which colours or efficiencies of one group of targets depend.

    Attributes:
        orders: Indices (s, r) of the p coefficients along y and x, shape (p, 2).
        kappas: |κ| of the coefficients [1/µm], shape (p,).
        weights: Factors from the powers |H|² to the n values (XYZ or efficiencies) of the group, shape (n, p). The
            shape is (p,) if each value depends on one power only.
        shape: Shape of the values of the group.
    """

    orders: Indices
    kappas: Array
    weights: Array
    shape: tuple[int, ...]


def coefficients_of(group: list[Target], factors: Array, surface: HeightField) -> Coefficients:
    """Return the Fourier coefficients on which a group of targets depends; weights of orders include ``factors``."""
    return _of_colours(group, surface) if group[0].kind == "colour" else _of_orders(group[0], factors, surface)


def _of_orders(target: Target, factors: Array, surface: HeightField) -> Coefficients:
    wavelengths = np.array([target.wavelength_nm])
    known, views = propagating(surface, target.to_light[None], wavelengths)
    places = np.argmax(np.all(known == target.pairs[:, None], axis=2), axis=1)
    view = views[0, 0, places]
    lights = np.broadcast_to(target.to_light, view.shape)
    normal, material = check_reflection(target.optics.ior, target.optics.material)
    factor = reflectance_factors.gain(lights, view, normal=1.0, masking=False, per_light_cosine=True)
    if material is None:
        cosines = np.minimum(np.linalg.norm(lights + view, axis=1) / 2.0, 1.0)
        factor = factor * reflectance_factors.schlick(cosines, normal)
    else:
        factor = factor * reflectances(material, -lights - view, wavelengths)[:, 0]
    kappas = (lights[:, 2] + view[:, 2]) / (1e-3 * target.wavelength_nm)
    return Coefficients(-target.pairs, kappas, factor * factors, (len(factor),))


def _of_colours(group: list[Target], surface: HeightField) -> Coefficients:
    optics = group[0].optics
    lights, views = (np.stack([getattr(target, name) for target in group]) for name in ("to_light", "to_view"))
    call = SpectralCall(
        "reflectance", surface, lights, views, wrt=(), coherence=optics.coherence, ior=optics.ior,
        material=optics.material, masking=optics.masking, truncation=SEARCH_TRUNCATION,
    )  # fmt: skip
    wavelengths, quadrature = call.sampling(optics.illuminant)
    illumination = Illumination(
        lights, views, wavelengths, optics.coherence, index_of(optics.ior), optics.material, optics.masking
    )
    every = slice(0, len(group))
    pairs = illumination.pairs(every)
    gains, cosines = illumination.gains(every)
    rho = np.broadcast_to(
        gains.value[:, None] * illumination.reflectances(cosines.value).value, (len(group), len(wavelengths))
    ).ravel()
    exponent = exponent_of(SEARCH_TRUNCATION)
    reach = pairs.reaches(exponent)
    ranges = []
    for axis, length, count in zip((0, 1), surface.size_um[::-1], surface.shape[::-1], strict=True):
        low = np.ceil((pairs.centres[:, axis] - reach[:, axis]) * length)
        high = np.floor((pairs.centres[:, axis] + reach[:, axis]) * length)
        steps = np.arange(int((high - low).max()) + 1) if count > 1 else np.arange(1)
        ranges.append(low[:, None] + steps if count > 1 else np.zeros((len(pairs), 1)))
    r, s = np.broadcast_arrays(ranges[0][:, None, :], ranges[1][:, :, None])
    dx = pairs.centres[:, 0, None, None] - r / surface.size_um[1]
    dy = pairs.centres[:, 1, None, None] - s / surface.size_um[0]
    xx, xy, yy = (form[:, None, None] for form in pairs.forms.T)
    exponents = xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy
    pair, *place = np.nonzero(exponents <= exponent)
    lobes = rho[pair] * np.exp(-exponents[pair, place[0], place[1]])
    direction, wavelength = np.divmod(pair, len(wavelengths))
    weights = np.zeros((len(group), 3, len(pair)))
    weights[direction, :, np.arange(len(pair))] = lobes[:, None] * quadrature[wavelength]
    orders = np.stack([s[pair, place[0], place[1]], r[pair, place[0], place[1]]], axis=1).astype(np.int64)
    return Coefficients(orders, pairs.kappas[pair], weights.reshape(-1, len(pair)), (len(group), 3))


class PixelExchange:
    """Colours and efficiencies of a design as a function of the height levels of its pixels and of its depth."""

    def __init__(self, goal: Goal, profile: Pixels, count: int) -> None:
        """Compute ``basis`` of each Fourier coefficient and pixel: sums of waves over the samples of the pixel.

        Args:
            goal: Loss of the targets, with the factors from Stam's efficiencies to normalised ones.
            profile: Profile whose pixels are exchanged.
            count: Number of height levels.
        """
        surface = profile.surface(profile.start)
        self._goal, self._shape, self._count = goal, profile.pixels, count
        self._parts = [
            coefficients_of(group, factors, surface)
            for group, factors in zip(goal.groups, goal.factors, strict=True)
        ]  # fmt: skip
        self._ends = np.cumsum([len(part.kappas) for part in self._parts])[:-1]
        self._kappas = np.concatenate([part.kappas for part in self._parts])
        orders = np.concatenate([part.orders for part in self._parts])
        memory.require_memory(
            16.0 * len(orders) * (sum(self._shape) + 4.0 * count),
            f"an exchange of {self._shape[0]} × {self._shape[1]} pixels for {len(orders)} coefficients",
            "take {share} of the orders",
        )
        self._along = [
            _sums(orders[:, axis], self._shape[axis], surface.shape[axis]) for axis in (0, 1)
        ]  # fmt: skip
        self.is_affordable = len(orders) * np.prod(self._shape) * count < _MOST_PRODUCTS

    def values(self, powers: Array) -> list[Array]:
        """Return colours and efficiencies of all targets from powers |H|², shape (p,), or (p, n) for n designs."""
        parts = np.split(powers, self._ends)
        return [
            (power.T @ part.weights.T if part.weights.ndim > 1 else power.T * part.weights).reshape(
                *power.shape[1:], *part.shape
            )
            for part, power in zip(self._parts, parts, strict=True)
        ]

    def _phases(self, depth_um: float) -> NDArray[np.complex128]:
        heights = depth_um * np.arange(self._count) / (self._count - 1)
        return np.asarray(np.exp(-2j * np.pi * np.outer(self._kappas, heights)))

    def by_level(self, levels: Indices) -> NDArray[np.complex128]:
        """Return, for each Fourier coefficient, the sum of ``basis`` over the pixels of each height level, (p, levels).

        ``basis`` is the contribution of a pixel with height 0 to the coefficient.
        """
        result = np.empty((len(self._kappas), self._count), dtype=np.complex128)
        for level in range(self._count):
            mask = (levels == level).astype(np.complex128)
            result[:, level] = np.einsum("pj,pj->p", self._along[0], self._along[1] @ mask.T)
        return result

    def best_depth(self, levels: Indices, log_exposure: float, depths_um: tuple[float, float]) -> tuple[float, float]:
        """Return the depth [µm] and the logarithm of the exposure with the least loss, for given levels of pixels.

        Levels are the permitted heights. The exposure is the common factor of all colours. ``depths_um`` is the least
        and the largest accepted depth.
        """
        sums = self.by_level(levels)
        low, high = depths_um
        best = np.inf, high, log_exposure
        for _ in range(_REFINEMENTS if high > low else 1):
            depths = np.linspace(low, high, _DEPTHS) if high > low else np.array([high])
            for depth in depths:
                values = self.values(_powers((sums * self._phases(depth)).sum(axis=1)))
                exposure = self._refined(values, log_exposure)
                loss = float(self._goal.costs(values, exposure))
                if loss < best[0]:
                    best = loss, float(depth), exposure
            step = (high - low) / (_DEPTHS - 1)
            low, high = max(best[1] - step, depths_um[0]), min(best[1] + step, depths_um[1])
        return best[1], best[2]

    def _refined(self, values: list[Array], log_exposure: float) -> float:
        """Return the logarithm of the exposure (common factor of all colours) with the least loss near an estimate."""
        if not self._goal.has_colours:
            return 0.0
        for width in (0.4, 0.04):
            trials = log_exposure + width * np.linspace(-1.0, 1.0, 11)
            log_exposure = float(trials[int(np.argmin([self._goal.costs(values, trial) for trial in trials]))])
        return log_exposure

    @single_threaded_blas()
    def run(
        self, levels: Indices, log_exposure: float, depths_um: tuple[float, float], rng: np.random.Generator,
        allowed: Rule | None = None,
    ) -> tuple[Indices, float, float]:  # fmt: skip
        """Change the height levels of single pixels until no change improves the design.

        Args:
            levels: Index of the height level of each pixel, shape (ny, nx).
            log_exposure: Logarithm of the exposure, the common factor of all colours.
            depths_um: Least and largest depth [µm].
            rng: Random generator of the sequence in which pixels are tried.
            allowed: Function of the levels of all pixels and of the row and column of one pixel, which returns the
                levels to which this pixel may change; None allows all levels.

        Returns:
            Levels, depth [µm] and the logarithm of the exposure.
        """
        levels = levels.copy()
        depth, log_exposure = self.best_depth(levels, log_exposure, depths_um)
        places = list(itertools.product(*(range(n) for n in self._shape)))
        every = list(range(self._count))
        for _ in range(_MOST_SWEEPS):
            phases, changes = self._phases(depth), 0
            sums = (self.by_level(levels) * phases).sum(axis=1)
            loss = float(self._goal.costs(self.values(_powers(sums)), log_exposure))
            for k in rng.permutation(len(places)):
                j, i = places[k]
                trials = every if allowed is None else allowed(levels, j, i)
                if not trials:
                    continue
                basis = self._along[0][:, j] * self._along[1][:, i]
                options = phases if allowed is None else phases[:, trials]
                candidates = (sums - basis * phases[:, levels[j, i]])[:, None] + basis[:, None] * options
                losses = self._goal.costs(self.values(_powers(candidates)), log_exposure)
                best = int(np.argmin(losses))
                if losses[best] < loss - _LEAST_GAIN:
                    sums, loss, changes = candidates[:, best], float(losses[best]), changes + 1
                    levels[j, i] = trials[best]
            depth, log_exposure = self.best_depth(levels, log_exposure, depths_um)
            if not changes:
                break
        return levels, depth, log_exposure


def _powers(amplitudes: NDArray[np.complex128]) -> Array:
    """Return the powers |H|² of ``amplitudes`` H, as sums of two squares, which are faster than squares of |H|."""
    return np.asarray(amplitudes.real**2 + amplitudes.imag**2)


def _sums(orders: Indices, pixels: int, samples: int) -> NDArray[np.complex128]:
    """Return the sums of exp(2πi·order·place) over the samples of each pixel along an axis, shape (p, pixels).

    There is one sum for each of the p orders of the Fourier coefficients. The place of a sample is its position in
    periods. The sums are divided by the number of all samples.
    """
    places = np.arange(samples) / samples
    distinct, which = np.unique(orders, return_inverse=True)
    waves = np.exp(2j * np.pi * np.outer(distinct, places)).reshape(len(distinct), pixels, -1).mean(axis=2) / pixels
    return np.asarray(waves[which.ravel()])


def edge_moves(least: int) -> Rule:
    """Return the rule that lists the height levels to which a pixel of a single row may change.

    A run is a group of neighbouring pixels of equal level. No run becomes shorter than ``least`` pixels. Only pixels at
    the ends of runs change, to the level of the neighbouring run, so that an edge moves by a pixel.
    """

    def allowed(levels: Indices, j: int, i: int) -> list[int]:
        row = levels[j]
        before, after = int(row[i - 1]), int(row[(i + 1) % len(row)])
        run = np.roll(row, -i) == row[i]
        if run.all() or (before == row[i]) == (after == row[i]):
            return []
        ahead = int(np.argmin(run))
        behind = int(np.argmin(np.roll(run[::-1], 1)))
        return [after if before == row[i] else before] if ahead + behind - 1 > least else []

    return allowed
