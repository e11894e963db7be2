"""Trial of plans: errors on a training set and on a validation set, against a reference plan.

A plan holds the method and the numbers of a computation. A search may try any number of plans on the training set. The
validation set judges only the result of the search. Both sets are samples of the directions of a call.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal. The floor is the smallest number by which an error is
divided to give a relative error. "Candidates" are sampled directions, of which some are drawn into the two sets.
"Source" means a light source of finite size (coherence of the kind "source").
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core import forks
from warpdiff.device.devices import load
from warpdiff.device.kernel_calls import launch
from warpdiff.diffraction import coefficient_basis
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.kernels.thresholds import FLOOR, PERCENTILE
from warpdiff.optics.colorimetry import NM_PER_UM
from warpdiff.optics.materials import reflectances
from warpdiff.planner import validation_directions
from warpdiff.request.directions import order_rate
from warpdiff.tables import coefficient_table, colour_table
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.evaluation import Evaluation
    from warpdiff.request.plan import Plan

# Safety factor. A plan (numbers of a computation) is accepted if its error on the validation set (sampled directions of
# a call) is at most the tolerance divided by this factor. The factor was fitted by bench.reproduce.tolerance_sweep. In
# one call of a hundred, the error over all directions exceeds the error on the validation set by more than this factor.
SEARCH_SAFETY = 1.6
# If a call has more directions than candidates (sampled directions of the call), this number of the brightest
# candidates may be outliers. Relative errors have a smallest divisor, which is proportional to the luminance of bright
# directions. It is therefore computed both with and without these candidates. The number was fitted to a call in which
# one of 6,312 directions, in the mirror direction, had half of the total luminance.
_LUCKY_BRIGHTEST = 4
# Least luminance that counts as light, as a share of the luminance of a perfect mirror. Light with a smaller luminance
# is invisible.
DARK = 1e-10
# An error of the reference plan (numbers of an accurate computation), or of basis functions that are fitted to Fourier
# coefficients, is neglected if it is below this share of the tolerance. The share was chosen so that such an error is
# small compared with the errors that a trial measures.
NEGLIGIBLE_SHARE = 1e-2
# Evaluation method of the reference plan, against which errors are measured. It expands the amplitudes of Fourier
# coefficients in a series. In float32, amplitudes are accurate even for coefficients that vanish like a high power of κ
# = w/λ. Series of powers are not accurate there.
REFERENCE_METHOD = "jacobi-anger"
# Largest number of wavelengths at which a trial (a test of plans) evaluates a spectrum. The value is limited by time,
# which is proportional to it.
_SPECTRAL_SAMPLES = 64


class Group:
    """Directions of a training or validation set on a device, with their weights and reference values.

    Attributes:
        sample: Directions of the set, and the weight of each direction in percentiles of the errors.
        exact: Values of the directions by the reference plan, whose results count as exact, in the shape that
            ``Trial.run`` returns; None before ``Trial.exact`` computes them.
        scale: Divisor of the error of each direction, shape (rows, n): the reference value or the floor (smallest
            divisor), whichever is larger. There is one row for each pair of illuminant and floor.
        above: Whether the luminance of a direction is at least the floor, shape (rows, n).
    """

    def __init__(self, sample: DirectionSample, device: wp.Device, points: int) -> None:
        self.sample = sample
        # A spectrum has several values per direction. A percentile of errors counts each of these values separately,
        # with the weight of the direction.
        self.weights = np.repeat(sample.weights, points)
        self.scattering_vectors = wp.array(sample.scattering_vectors, dtype=wp.vec3d, device=device)
        self.to_lights = wp.array(sample.to_lights.astype(np.float32), dtype=wp.vec3f, device=device)
        self.gains = wp.array(sample.gains.astype(np.float32), dtype=wp.float32, device=device)
        self.exact: NDArray[np.float64] | None = None
        self.scale: NDArray[np.float64]
        self.above: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.sample)

    def weigh(self, exact: NDArray[np.float64], floors: NDArray[np.float64]) -> None:
        """Store the reference values ``exact``, and compute the divisors of relative errors from the floors.

        ``floors`` contains the smallest permitted divisors, shape (illuminants, m): m floors per illuminant.
        """
        self.exact, rows = exact, floors.reshape(-1, 1)
        self.above = np.repeat(_luminance(exact), floors.shape[1], axis=0) >= rows
        self.scale = np.maximum(np.repeat(np.linalg.norm(exact, axis=2), floors.shape[1], axis=0), rows)

    def errors(self, values: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return relative errors, shape (rows, n): distances of ``values`` from ``reference``, over the divisors.

        :meth:`weigh` has computed the divisors ``scale``.
        """
        differences = np.linalg.norm(values - reference, axis=2)
        return np.asarray(np.repeat(differences, len(self.scale) // len(differences), axis=0) / self.scale)


class Trial:
    """Trial of plans: evaluates plans on some directions of a call, and measures their errors against a reference plan.

    Attributes:
        reference: Plan whose results count as exact: the upper-bound plan with twice the wavelengths.
        training_set: Directions on which a search compares plans.
        validation_set: Directions that judge the result of the search.
        order_rate: Order rate of each training direction, shape (n,): how fast orders pass it as 1/λ changes.
        w: |w| of each training direction, shape (n,), from its scattering vector (u, v, w).
    """

    def __init__(
        self, plan: Plan, request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, *, coarse: Plan
    ) -> None:
        """Draw the training set and the validation set from the directions of a call.

        Args:
            plan: Upper-bound plan.
            request: Evaluation of the call: height field, coherence, illuminants and device.
            direction_range: Range of the call's directions and wavelengths.
            sample: Sample of the call's directions. Candidates for both sets are selected from this sample.
            coarse: Cheap plan that estimates which candidates are bright.
        """
        heightfield, device, threads = request.heightfield, request.device, request.threads
        self.heightfield, self._range, self._device, self._threads = heightfield, direction_range, device, threads
        wavelengths_nm = request.wavelengths_nm
        self._illuminated = request.illuminated
        self._wavenumbers, self._points = None, 1
        self.integrates = wavelengths_nm is None
        if wavelengths_nm is not None:
            self._points = min(_SPECTRAL_SAMPLES, len(wavelengths_nm))
            places = np.linspace(0, len(wavelengths_nm) - 1, self._points).astype(int)
            self._wavenumbers = wp.array(NM_PER_UM / wavelengths_nm[places], dtype=wp.float64, device=device)
        self._gain = float(np.quantile(sample.gains, PERCENTILE))
        self._series_terms = plan.terms
        terms = coefficient_basis.series_terms(heightfield, direction_range.kappas)
        self.reference = dataclasses.replace(plan, method=REFERENCE_METHOD, terms=terms)
        methods = ((REFERENCE_METHOD, terms), (plan.method, min(plan.terms, coefficient_table.LANES)))
        kernels = [coefficient_table.kernels_for(method, plan.coherence, count) for method, count in methods]
        load([namespace.integrate if self.integrates else namespace.sample for namespace in kernels], device)

        candidates, is_edge_case = validation_directions.candidates(
            heightfield, direction_range, sample, coarse, threads=threads
        )
        self._candidates = self._group(candidates)
        self._sees_all = len(candidates) == round(candidates.weights.sum())
        luminance = _luminance(self.run(coarse, self._candidates))
        self._find_floors(luminance)
        # For a spectrum, the luminance of a direction is its largest reflectance over the wavelengths.
        brightest = luminance[0].reshape(len(candidates), -1).max(axis=1)
        training, validation = validation_directions.sampled(
            candidates, is_edge_case, brightest, float(self._floors[0].min())
        )
        self.training_set = self._candidates if training is candidates else self._group(training)
        self.validation_set = self._candidates if validation is candidates else self._group(validation)
        self.order_rate = self._order_rates(self.training_set.sample)
        self.w = np.abs(self.training_set.sample.scattering_vectors[:, 2])
        self.refine_reference(plan)

    @property
    def any_light(self) -> bool:
        """Whether any direction has visible light: a luminance above ``DARK``.

        The luminances of the training directions and the floors (smallest divisors of relative errors) are compared
        with it.
        """
        return bool(np.any(self._floors > DARK) or np.any(self.exact(self.training_set) > DARK))

    @property
    def bright(self) -> tuple[float, float]:
        """Numbers of bright validation directions: for the highest floor and for the lowest floor.

        A direction is bright if its luminance is at least the floor (smallest divisor) of relative errors. If there are
        several illuminants, each number is for the illuminant with the fewest bright directions. Both numbers are
        infinite if the validation set has all candidates (sampled directions).
        """
        if len(self.validation_set) == len(self._candidates):
            return math.inf, math.inf
        self.exact(self.validation_set)
        counts = np.count_nonzero(self.validation_set.above, axis=1).reshape(self._floors.shape)
        return float(counts.min()), float(counts.max(axis=1).min())

    @property
    def max_order_rate(self) -> float:
        """Largest order rate of the call's directions.

        The order rate is how fast orders pass a direction as 1/λ changes. The result may exceed the largest rate of the
        upper-bound plan.
        """
        return self._range.max_order_rate

    @forks.cached_property
    def rates(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Order rate, |w| and weight of each candidate direction: three arrays of the shape (n,).

        The weight is proportional to the number of the call's directions that a candidate represents. The predicted
        cost of a call is the weighted mean of the costs of all candidates. The cost of a candidate depends on its order
        rate and |w|.
        """
        sample = self._candidates.sample
        return self._order_rates(sample), np.abs(sample.scattering_vectors[:, 2]), sample.weights

    def _order_rates(self, sample: DirectionSample) -> NDArray[np.float64]:
        return order_rate(self.heightfield, self.reference.coherence, sample.scattering_vectors, sample.to_lights)

    def _group(self, sample: DirectionSample) -> Group:
        return Group(sample, self._device, self._points)

    def _find_floors(self, luminance: NDArray[np.float64]) -> None:
        """Compute the floors (smallest divisors) of relative errors for each illuminant from the candidates.

        ``luminance`` has the luminances of the candidates (sampled directions), shape (illuminants, n). If the
        candidates are only a part of the call's directions, the brightest candidates may be outliers. There are then
        two floors, one computed with these candidates and one without. Errors relative to each of the two floors must
        be small.
        """
        order = np.argsort(luminance[0])
        subsets = [order] if self._sees_all else [order, order[: -_LUCKY_BRIGHTEST * self._points]]
        weights = self._candidates.weights
        bright = [
            [reference_luminance(row[subset], weights[subset], with_median=self.integrates) for subset in subsets]
            for row in luminance
        ]
        self._floors = np.maximum(FLOOR * np.asarray(bright), DARK)

    def refine_reference(self, plan: Plan) -> None:
        """Set the reference plan to twice the number of wavelengths of ``plan``, and discard its computed colours."""
        if plan.coherence.adds_powers:
            # All directions of a call may be much darker than the zeroth order, which has the power 1. The reference
            # plan, whose results count as exact, therefore includes Fourier coefficients up to a large distance from
            # each direction. At this distance, the truncated tail of the zeroth order is negligible even compared with
            # the dark directions.
            needed = NEGLIGIBLE_SHARE * plan.tolerance * float(self._floors.min()) / self._gain
            self.reference = dataclasses.replace(self.reference, least_weight=min(self.reference.least_weight, needed))
        if self.integrates:
            self.reference = dataclasses.replace(self.reference, wavelengths=2 * plan.wavelengths - 1)
        for group in (self.training_set, self.validation_set):
            group.exact = None

    def update_floors(self, plan: Plan) -> None:
        """Compute the floors (smallest divisors of relative errors) again, by a more accurate plan.

        A plan holds the numbers of a computation, such as the number of wavelengths.
        """
        self._find_floors(_luminance(self.run(plan, self._candidates)))
        for group in (self.training_set, self.validation_set):
            if group.exact is not None:
                group.weigh(group.exact, self._floors)

    def exact(self, group: Group) -> NDArray[np.float64]:
        """Return the colours or spectra of a training or validation set, computed by the reference plan.

        Both sets are samples of the directions of a call. The results of the reference plan count as exact.
        """
        if group.exact is None:
            group.weigh(self.run(self.reference, group), self._floors)
        return np.asarray(group.exact)

    def run(self, plan: Plan, group: Group) -> NDArray[np.float64]:
        """Compute the colours or spectra of a training or validation set by a plan.

        Both sets are samples of the directions of a call. Return colours XYZ, shape (illuminants, n, 3), or for spectra
        reflectances ρ at m wavelengths, shape (1, n·m, 1).
        """
        arrays = group.scattering_vectors, group.to_lights, group.gains
        # The directions are divided into two slices per thread, so that all threads end at about the same time.
        slice_size = math.ceil(len(group) / self._threads / 2.0)
        if self._wavenumbers is not None:
            table = coefficient_table.table_for(
                self.heightfield, plan, self._range, device=self._device, threads=self._threads
            )
            values = wp.empty((len(group), self._points), dtype=wp.float32, device=self._device)
            launch(
                table.sample, len(group), [table.arguments, *arrays, self._wavenumbers], [values], device=self._device,
                threads=self._threads, slice_size=slice_size,
            )  # fmt: skip
            reflectance = np.asarray(values.numpy(), dtype=np.float64)
            reflectance = reflectance * reflectances(
                self._illuminated[0].material, group.sample.scattering_vectors,
                NM_PER_UM / self._wavenumbers.numpy(),
            )  # fmt: skip
            return np.asarray(reflectance).reshape(1, -1, 1)
        lookup = ColourLookup(self.heightfield, plan, self._range, device=self._device, threads=self._threads)
        results = []
        for illuminated in self._illuminated:
            xyz = wp.zeros(len(group), dtype=wp.vec3f, device=self._device)
            lookup.accumulate(*arrays, illuminated, xyz, slice_size=slice_size)
            results.append(xyz.numpy())
        return np.asarray(results, dtype=np.float64)

    def with_w_basis(self, plan: Plan) -> Plan:
        """Return the plan with ``w_basis_size``, the number of functions of w that its colour table requires.

        w is the normal component of the scattering vector. All colours of a table are sums of the same functions of w.
        """
        options: dict[str, Any] = {"device": self._device, "threads": self._threads}
        counts = [
            colour_table.function_count(self.heightfield, plan, self._range, light, **options)
            for light in self._illuminated
        ]
        return dataclasses.replace(plan, w_basis_size=max(counts))

    def most_terms(self, plan: Plan) -> int:
        """Return the largest number of terms of a Fourier coefficient's expansion that a plan's method can use."""
        if plan.method == self.reference.method:
            return self.reference.terms
        return self._series_terms if plan.method in EXPANSIONS else self.fitted(plan).terms

    def fitted(self, plan: Plan) -> coefficient_basis.Coefficients:
        """Return the Fourier coefficients of the height field in basis functions of κ = w/λ, fitted for a plan."""
        extent = coefficient_table.neighbour_extent(plan, self.heightfield)
        coefficients, _, _ = coefficient_table.coefficients_for(
            self.heightfield, plan.method, plan.coherence, self._range, extent, terms=plan.terms, threads=self._threads
        )
        return coefficients

    def training_error(self, plan: Plan) -> float:
        """Return the 99.5th percentile of a plan's errors on the training set.

        The set is a sample of the directions of a call. Bright and dim directions have separate percentiles. The result
        is the larger one.
        """
        exact = self.exact(self.training_set)
        return worst_percentile(self.training_set.errors(self.run(plan, self.training_set), exact), self.training_set)

    def validation_error(self, plan: Plan) -> float:
        """Return the 99.5th percentile of a plan's errors on the validation set.

        The set is a sample of the directions of a call. Bright and dim directions have separate percentiles; the result
        is the larger percentile. A direction is excluded if diffraction orders pass it faster, as 1/λ changes, than the
        wavelengths of the reference plan resolve. If this is true of all directions, all are included.
        """
        exact = self.exact(self.validation_set)
        errors = self.validation_set.errors(self.run(plan, self.validation_set), exact)
        # The reference plan has a limited number of wavelengths, which may be too few if a light source of finite size
        # is near the horizon. The reference values are then wrong for directions which orders pass faster, as 1/λ
        # changes, than these wavelengths resolve.
        resolved = self._order_rates(self.validation_set.sample) <= self.reference.max_order_rate
        return worst_percentile(
            errors, self.validation_set, np.repeat(resolved, self._points) if resolved.any() else None
        )


def reference_luminance(
    luminance: NDArray[np.float64], weights: NDArray[np.float64], *, with_median: bool = True
) -> float:
    """Return the reference luminance Y*: the 99th percentile of the luminance Y, or a median of Y if that is larger.

    ``Y`` has one value for each direction of a call. The median is weighted by Y. It counts only if ``with_median`` is
    True.
    """
    bright = _percentile(luminance, weights, PERCENTILE)
    return max(bright, _percentile(luminance, weights * luminance, 0.5)) if with_median else bright


def _percentile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """Return the percentile ``share`` (0 to 1) of weighted values: values up to it have this share of the total weight.

    The result is 0 if there are no values, or if all weights are 0.
    """
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    if not len(total) or not total[-1] > 0.0:
        return 0.0
    # The share of the total weight is reduced by a small margin. Without the margin, rounding errors in the sum of
    # equal weights could select the next larger value.
    least = (share - float(np.finfo(np.float32).eps)) * total[-1]
    return float(values[order[min(np.searchsorted(total, least), len(order) - 1)]])


def worst_percentile(errors: NDArray[np.float64], group: Group, included: NDArray[np.bool_] | None = None) -> float:
    """Return the larger of the 99.5th percentiles of the errors of bright and of dim directions.

    A direction is bright if its luminance is at least the floor (the smallest divisor of relative errors), and
    otherwise dim. ``errors`` has the shape (rows, n), with one row for each pair of illuminant and floor of relative
    errors. The result is the largest percentile of all rows. Only the directions in the mask ``included`` count.
    """
    included = np.ones(errors.shape[1], dtype=bool) if included is None else included
    # The tolerance limits the 99th percentile of the errors of all directions of a call. Percentiles of a small sample
    # are less certain. The stricter 99.5th percentile is therefore used here.
    share = 0.5 * (1.0 + PERCENTILE)
    return max(
        _percentile(row[mask & included], group.weights[mask & included], share)
        for row, above in zip(errors, group.above, strict=True)
        for mask in (above, ~above)
    )


def _luminance(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the luminance Y of colours XYZ, shape (..., 3), or unchanged reflectances ρ, shape (..., 1)."""
    return np.asarray(values[..., values.shape[-1] // 2])
