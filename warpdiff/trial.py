"""Samples of a call's directions that plans are tried on: some to search on, others to judge by.

A uniform sample of a call misses what decides where little of it is bright. So geometry alone is looked at for
thousands of directions; of these, a thousand are watched, uniform ones and all that are suspect (near the mirror
direction, near strong orders, of the largest gain, at the ends of the call's ranges), with a coarse plan that tells how
bright they are; and of the watched, pilots and a jury are drawn, a third of them for being bright. Each direction
weighs as much as the part of the call that it stands for.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import coefficients, colour_table, tables
from warpdiff.device import load
from warpdiff.integration import Integrator
from warpdiff.launches import launch
from warpdiff.scope import lateral, stratified

if TYPE_CHECKING:
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField
    from warpdiff.plans import Plan
    from warpdiff.scope import DirectionSample, Scope

# Directions whose brightness is looked at, besides the suspects; those that a search tries plans on; those that judge
# what it found.
_WATCHED, _PILOTS, _JURY = 1024, 128, 256
# Suspects of each kind, and the orders that count as strong.
_NEAR_ORDERS, _NEAR_MIRROR, _OF_LARGEST_GAIN, _AT_EACH_END = 96, 32, 32, 12
_STRONG_ORDERS = 24
# How often bright directions and suspects are drawn, where those that stand for the call are drawn once.
_BRIGHT_SHARE, _SUSPECT_SHARE = 1.0, 0.25
# Of what is watched, so many of the brightest do not tell how bright a call is that has more directions.
_LUCKY = 4
# Fewer bright directions of the jury than these do not stand for the others.
_FEW = 50
# Light that is this weak against a mirror's is darkness, whatever else a call sees.
DARK = 1e-10
# A picture's floor, as a share of its brightness.
_FLOOR = 1e-3
# Neighbours' share of what a truth may leave out.
_LEFT_OUT = 0.25
# Its amplitudes lose nothing in float32, however dim a coefficient is where κ is small.
TRUTH = "jacobi-anger"
_SPECTRAL_SAMPLES = 64
# Directions are few and dear: a launch is cut into slices that keep every thread busy.
_SLICE = 8
_SEED = 1


class Group:
    """Directions on a device, how much each of them weighs, and what is true of them.

    Attributes:
        sample: The directions and their weights.
        exact: What the finest plan makes of them, once it has been asked; shape as of ``Trial.run``.
        scale: What errors are relative to, (illuminants, n).
        above: Whether they are bright, (illuminants, n).
    """

    def __init__(self, sample: DirectionSample, device: wp.Device, points: int) -> None:
        import warp as wp

        self.sample = sample
        # A spectrum's points are its pixels.
        self.weights = np.repeat(sample.weights, points)
        self.deflections = wp.array(sample.deflections, dtype=wp.vec3d, device=device)
        self.to_lights = wp.array(sample.to_lights.astype(np.float32), dtype=wp.vec3f, device=device)
        self.gains = wp.array(sample.gains.astype(np.float32), dtype=wp.float32, device=device)
        self.exact: NDArray[np.float64] | None = None
        self.scale: NDArray[np.float64]
        self.above: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.sample)

    def weigh(self, floor: NDArray[np.float64]) -> None:
        """Find what errors are relative to, as the README defines them, for a floor of each illuminant."""
        assert self.exact is not None
        self.above = _luminance(self.exact) >= floor[:, None]
        self.scale = np.maximum(np.linalg.norm(self.exact, axis=2), floor[:, None])


class Trial:
    """Some directions of a call on a device, and what the finest plan makes of them.

    Args of its constructor: the plan from bounds, the height field, the range of the call, a sample of its directions,
    its illuminants, of which the worst counts, given wavelengths in place of an integral, the plan from bounds for a
    tolerance so large that it only tells what is bright, and where to try.
    """

    def __init__(
        self,
        plan: Plan,
        hf: HeightField,
        scope: Scope,
        sample: DirectionSample,
        illuminants: tuple[str, ...],
        wavelengths_nm: NDArray[np.float64] | None,
        *,
        coarse: Plan,
        device: wp.Device,
        threads: int,
    ) -> None:
        import warp as wp

        self.hf, self._scope, self._device, self._threads = hf, scope, device, threads
        self._illuminants = illuminants
        self._wavenumbers, self._points = None, 1
        self.integrates = wavelengths_nm is None
        if wavelengths_nm is not None:
            some = np.linspace(0, len(wavelengths_nm) - 1, min(_SPECTRAL_SAMPLES, len(wavelengths_nm))).astype(int)
            self._wavenumbers, self._points = wp.array(1e3 / wavelengths_nm[some], dtype=wp.float64, device=device), len(some)
        self._gain = float(np.percentile(sample.gains, 99.0))
        terms = coefficients.series_terms(hf, scope.kappas)
        self.finest = dataclasses.replace(plan, method=TRUTH, terms=terms, adaptive=False)
        kernels = kernels_tried(terms, plan.method, min(plan.terms, tables.LANES), plan.coherence)
        load([each.integrate if self.integrates else each.sample for each in kernels], device)

        suspects = np.zeros(0, dtype=np.int64)
        if len(sample) > _PILOTS + _JURY:
            suspects = _suspects(hf, scope, sample, coarse, threads=threads)
        watched, suspect = _watched(sample, suspects)
        self._watched, self._sees_all = self._group(watched), len(watched) == len(sample) == round(watched.weights.sum())
        luminance = _luminance(self.run(coarse, self._watched))
        self._find_floor(luminance)
        # Of a spectrum's points the brightest tells.
        luminance = luminance[0].reshape(len(watched), -1).max(axis=1)
        measure = watched.weights / watched.weights.sum()
        bright = luminance >= 0.5 * self._floor[0]
        measure = measure + _BRIGHT_SHARE * np.where(bright, watched.weights, 0.0) / max(watched.weights[bright].sum(), 1e-300)
        measure = measure + _SUSPECT_SHARE * suspect / max(np.count_nonzero(suspect), 1)
        # Every third of them by brightness may be a pilot, for either to have its share of what few there are.
        order = np.argsort(luminance, kind="stable")
        thirds = np.arange(len(order)) % 3
        if len(order) <= _PILOTS:
            self.pilots = self.jury = self._watched
        elif len(order) <= _PILOTS + _JURY:
            self.pilots, self.jury = self._group(_drawn(watched, order, measure, _PILOTS)), self._watched
        else:
            parts = (order[thirds == 0], 3.0, _PILOTS), (order[thirds > 0], 1.5, _JURY)
            self.pilots, self.jury = (
                self._group(_drawn(watched, among, measure, count, stands_for))
                for among, stands_for, count in parts
            )
        self.lateral = lateral(hf, plan.coherence, self.pilots.sample.deflections, self.pilots.sample.to_lights)
        self.w = np.abs(self.pilots.sample.deflections[:, 2])
        self.sharpen(plan)

    @property
    def any_light(self) -> bool:
        """Whether any of the directions sees more than darkness."""
        return bool(np.any(self._floor > DARK) or np.any(self.exact(self.pilots) > DARK))

    @property
    def is_sparse(self) -> bool:
        """Whether so few of the jury are bright that bright directions elsewhere may err by more."""
        if len(self.jury) == len(self._watched):
            return False
        self.exact(self.jury)
        return bool(np.count_nonzero(self.jury.above, axis=1).min() < _FEW)

    @property
    def least_weight(self) -> float:
        """The weight, as a share of the tolerance, at which the brightest that was seen is lost in the dark."""
        return float(np.min(self._floor / np.maximum(self._peak, self._floor)))

    @property
    def rates(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Lateral, |w| and weight of what is watched, as the call's cost depends on them."""
        seen = self._watched.sample
        reaches = lateral(self.hf, self.finest.coherence, seen.deflections, seen.to_lights)
        return reaches, np.abs(seen.deflections[:, 2]), seen.weights

    def _group(self, sample: DirectionSample) -> Group:
        return Group(sample, self._device, self._points)

    def _find_floor(self, luminance: NDArray[np.float64]) -> None:
        """Find the floor of each illuminant from luminances (illuminants, n) of what is watched.

        Where that is a part of the call, its few brightest directions tell of luck: others would hardly see them.
        """
        weights = self._watched.weights
        kept = slice(None) if self._sees_all else np.argsort(luminance[0])[: -_LUCKY * self._points]
        bright = [brightness(each[kept], weights[kept], with_median=self.integrates) for each in luminance]
        self._floor = np.maximum(_FLOOR * np.asarray(bright), DARK)
        self._peak = luminance.max(axis=1)

    def sharpen(self, plan: Plan) -> None:
        """Judge by twice the wavelengths of a plan."""
        if plan.coherence.adds_powers:
            # The mirror's coefficient, of power 1, must not show in what is far darker.
            needed = _LEFT_OUT * plan.tolerance * float(self._floor.min()) / self._gain
            self.finest = dataclasses.replace(self.finest, least_weight=min(self.finest.least_weight, needed))
        if self.integrates:
            self.finest = dataclasses.replace(self.finest, wavelengths=2 * plan.wavelengths - 1)
        for group in (self.pilots, self.jury):
            group.exact = None

    def settle(self, plan: Plan) -> None:
        """See with a plan that is nearly right how bright the call is, which errors are relative to."""
        self._find_floor(_luminance(self.run(plan, self._watched)))
        for group in (self.pilots, self.jury):
            if group.exact is not None:
                group.weigh(self._floor)

    def exact(self, group: Group) -> NDArray[np.float64]:
        """What the finest plan makes of directions."""
        if group.exact is None:
            group.exact = self.run(self.finest, group)
            group.weigh(self._floor)
        return group.exact

    def run(self, plan: Plan, on: Group | None = None) -> NDArray[np.float64]:
        """What a plan makes of directions, the pilots: XYZ, shape (illuminants, n, 3), or ρ, shape (1, n·m, 1)."""
        import warp as wp

        group = on or self.pilots
        seen = [group.deflections, group.to_lights, group.gains]
        if self._wavenumbers is not None:
            table = tables.table_for(self.hf, plan, self._scope, device=self._device, threads=self._threads)
            values = wp.empty((len(group), self._points), dtype=wp.float32, device=self._device)
            launch(
                table.sample, len(group), [table.arguments, *seen, self._wavenumbers], [values], device=self._device,
                threads=self._threads, slice_size=_SLICE,
            )  # fmt: skip
            return np.asarray(values.numpy(), dtype=np.float64).reshape(1, -1, 1)
        integrator = Integrator(self.hf, plan, self._scope, device=self._device, threads=self._threads)
        results = []
        for illuminant in self._illuminants:
            xyz = wp.zeros(len(group), dtype=wp.vec3f, device=self._device)
            integrator.add(*seen, illuminant, xyz, slice_size=_SLICE)
            results.append(xyz.numpy())
        return np.asarray(results, dtype=np.float64)

    def begin_to_load(self, plan: Plan) -> None:
        """Begin to load what a plan's table takes."""
        colour_table.begin_to_load(
            self.hf, plan, self._scope, self._illuminants[0], device=self._device, threads=self._threads
        )

    def fitted(self, plan: Plan) -> coefficients.Coefficients:
        """The coefficients of a plan with a fitted basis."""
        found, _, _ = tables.coefficients_for(
            self.hf, plan.method, plan.coherence, self._scope, tables.reach(plan, self.hf), terms=plan.terms,
            threads=self._threads,
        )  # fmt: skip
        return found

    def errors(self, values: NDArray[np.float64], against: NDArray[np.float64]) -> NDArray[np.float64]:
        """The error of each pilot, shape (illuminants, n)."""
        self.exact(self.pilots)
        return np.asarray(np.linalg.norm(values - against, axis=2) / self.pilots.scale)

    def error(self, values: NDArray[np.float64], against: NDArray[np.float64] | None = None) -> float:
        """Percentile 99 of the pilots' errors, of bright ones or of dim ones, whichever is larger."""
        exact = self.exact(self.pilots)
        return _worst(self.errors(values, exact if against is None else against), self.pilots)

    def judged(self, plan: Plan) -> float:
        """The same of a plan's errors on the jury, of what lies within the reach of its bounds, if anything does."""
        exact = self.exact(self.jury)
        errors = np.linalg.norm(self.run(plan, self.jury) - exact, axis=2) / self.jury.scale
        seen = self.jury.sample
        # Where bounds were cut short for a source at the horizon, a table is right and the truth is not.
        resolved = lateral(self.hf, plan.coherence, seen.deflections, seen.to_lights) <= plan.max_lateral
        return _worst(errors, self.jury, np.repeat(resolved, self._points) if resolved.any() else None)

    def keeps(self, errors: NDArray[np.float64], most: float) -> NDArray[np.bool_]:
        """Whether percentile 99 of pilots' errors (…, illuminants, n) is at most so much, shape (…)."""
        fine = errors <= most
        result = np.ones(errors.shape[:-2], dtype=bool)
        for index in range(errors.shape[-2]):
            for mask in (self.pilots.above[index], ~self.pilots.above[index]):
                weights = np.where(mask, self.pilots.weights, 0.0)
                result &= fine[..., index, :] @ weights >= (0.99 - 1e-9) * weights.sum()
        return result


def kernels_tried(series_terms: int, method: str, terms: int, coherence: Coherence) -> list[Any]:
    """The kernels of the truth and of a plan."""
    return [tables.kernels_for(TRUTH, coherence, series_terms), tables.kernels_for(method, coherence, terms)]


def brightness(luminance: NDArray[np.float64], weights: NDArray[np.float64], *, with_median: bool = True) -> float:
    """How bright a call is: percentile 99 of Y, or the luminance-weighted median of Y if that is larger."""
    bright = _percentile(luminance, weights, 0.99)
    return max(bright, _percentile(luminance, weights * luminance, 0.5)) if with_median else bright


def _percentile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """The least value that so large a share of all weight does not exceed; 0 of nothing."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    if not len(total) or not total[-1] > 0.0:
        return 0.0
    return float(values[order[min(np.searchsorted(total, (share - 1e-9) * total[-1]), len(order) - 1)]])


def _worst(errors: NDArray[np.float64], group: Group, some: NDArray[np.bool_] | None = None) -> float:
    """Percentile 99 of errors (illuminants, n), of bright directions or of dim ones, whichever is larger."""
    kept = np.ones(errors.shape[1], dtype=bool) if some is None else some
    return max(
        _percentile(each[mask & kept], group.weights[mask & kept], 0.99)
        for each, above in zip(errors, group.above, strict=True)
        for mask in (above, ~above)
    )


def _luminance(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Y of XYZ (..., 3), or ρ of (..., 1)."""
    return np.asarray(values[..., 1 if values.shape[-1] == 3 else 0])


def _watched(sample: DirectionSample, suspects: NDArray[np.int64]) -> tuple[DirectionSample, NDArray[np.bool_]]:
    """All suspects and ``_WATCHED`` others, spread over the sample's order; and which of them are suspects."""
    others = np.setdiff1d(np.arange(len(sample)), suspects)
    some = others[stratified(len(others), _WATCHED)]
    chosen = np.concatenate([suspects, some])
    weights = sample.weights[chosen]
    weights[len(suspects) :] *= len(others) / max(len(some), 1)
    return sample.some(chosen, weights), np.arange(len(chosen)) < len(suspects)


def _drawn(
    sample: DirectionSample,
    among: NDArray[np.int64],
    measure: NDArray[np.float64],
    count: int,
    stands_for: float = 1.0,
) -> DirectionSample:
    """``count`` of some directions, drawn in proportion to a measure, evenly along their order, each at most once."""
    share = measure[among] / measure[among].sum() * count
    if len(among) <= count:
        share = np.ones(len(among))
    # What would be drawn more than once is drawn surely, and the others the more.
    for _ in range(4):
        sure = share >= 1.0
        share = np.where(sure, 1.0, share * max(count - np.count_nonzero(sure), 0) / max(share[~sure].sum(), 1e-300))
    edges = np.cumsum(np.minimum(share, 1.0))
    start = np.random.default_rng(_SEED).uniform()
    picked = np.minimum(np.searchsorted(edges, np.arange(start, edges[-1], 1.0), side="right"), len(among) - 1)
    chosen = among[picked]
    return sample.some(chosen, stands_for * sample.weights[chosen] / np.minimum(share[picked], 1.0))


def _suspects(
    hf: HeightField, scope: Scope, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.int64]:
    """Directions that may decide, if few of them: by the mirror and strong orders, of large gain, at the ranges' ends."""
    u, v, w = sample.deflections.T
    across, light = np.hypot(u, v), sample.to_lights[:, 2]
    passing = lateral(hf, plan.coherence, sample.deflections, sample.to_lights)
    kinds = [
        (-across, _NEAR_MIRROR),
        (_near_orders(hf, scope, sample, plan, threads=threads), _NEAR_ORDERS),
        (sample.gains, _OF_LARGEST_GAIN),
        *((each, _AT_EACH_END) for each in (across, passing, w, -w, -light, light + w)),
    ]
    return np.unique(np.concatenate([np.argsort(each, kind="stable")[-most:] for each, most in kinds]))


def _near_orders(
    hf: HeightField, scope: Scope, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.float64]:
    """How much light directions may see of the strongest orders but the mirror's, by the logarithm."""
    found, block, grid = tables.coefficients_for(
        hf, plan.method, plan.coherence, scope, tables.reach(plan, hf), terms=plan.terms, threads=threads
    )
    middle = np.array([math.sqrt(max(scope.kappas[0], 0.1 * scope.kappas[1]) * scope.kappas[1])])
    parts = found.rows[..., : plan.terms] @ found.basis_at(middle)[0, : plan.terms].astype(np.float32)
    holds_powers = coefficients.holds_powers(plan.method, adds_powers=plan.coherence.adds_powers)
    powers = parts[..., 0] if holds_powers else np.sum(parts**2, axis=-1)
    rows, columns = block.orders()
    powers = np.where((rows == 0)[:, None] & (columns == 0), 0.0, powers)
    strongest = np.argpartition(powers.ravel(), -min(_STRONG_ORDERS, powers.size))[-_STRONG_ORDERS:]
    row, column = np.unravel_index(strongest, powers.shape)
    q = np.stack([columns[column] / grid.lengths_um[1], rows[row] / grid.lengths_um[0]], axis=1)
    u = sample.deflections[:, :2]
    # The place on the way from red to blue that is nearest to each order.
    foot = (u @ q.T) / np.maximum(np.sum(u * u, axis=1), 1e-12)[:, None]
    foot = np.clip(foot, 1e3 / scope.lambda_max_nm, 1e3 / scope.lambda_min_nm)
    away = (foot * u[:, :1] - q[:, 0]) ** 2 + (foot * u[:, 1:] - q[:, 1]) ** 2
    falloff = 1.0
    if plan.coherence.kind != "replicas":
        falloff = tables.falloff_um2(plan.coherence, 0.5)
    strength = np.log(np.maximum(powers.ravel()[strongest], 1e-30)) - falloff * away
    return np.asarray(strength.max(axis=1) + np.log(np.maximum(sample.gains, 1e-30)))
