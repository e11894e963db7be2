"""Coordinate search with closed-form errors of plans: comparison with an exhaustive search, and single steps.

A plan holds the numbers of a computation. A search changes three numbers of a plan, its coordinates. The terms are the
number of terms of the series in which Fourier coefficients are expanded. The neighbourhood is the number of
neighbouring Fourier coefficients that contribute to a direction; the least Gaussian weight of these coefficients sets
it. The bandwidth is the number of wavelength samples per unit of 1/λ.
"""

import dataclasses
import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.planner import coordinate_search, cost_model
from warpdiff.planner.coordinate_search import Coordinate

# Tolerance of the tested computation, and largest error of a plan that the search accepts: the tolerance divided by the
# safety factor 1.6.
TOLERANCE, TARGET = 1e-2, 1e-2 / 1.6
# Ratio of successive bandwidths (wavelengths per unit of 1/λ) that a search tries, 4 steps per factor of 2; and number
# of terms of a series per SIMD register.
STEP, REGISTER = 2.0 ** (1 / 4), 8


@pytest.fixture(scope="module")
def start(fingers):
    """Return a plan (numbers of a computation) from which searches start.

    It has 32 terms of the series of a Fourier coefficient, and more neighbouring Fourier coefficients and wavelengths
    than are required.
    """
    plan = wd.plan(fingers, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], method="low-rank", tolerance=TOLERANCE)
    return dataclasses.replace(plan, terms=32, least_weight=math.exp(-20.0))


class ClosedForm:
    """Stand-in for a trial of plans, which measures the error of a plan (numbers of a computation).

    The error is a sum of three errors: by the numbers of terms, of neighbouring coefficients and of wavelengths.
    """

    integrates, max_order_rate, bright = True, 1.0, (math.inf, math.inf)
    validation_set = range(7)

    def __init__(self, heightfield, start, *, scale=1.0, validation_factor=1.0):
        self.heightfield, self._start, self._scale, self._factor = heightfield, start, scale, validation_factor
        self.reference = dataclasses.replace(start, method="jacobi-anger", terms=40)
        self.order_rate, self.w = np.array([start.max_order_rate]), np.array([start.max_w])
        self.rates = self.order_rate, self.w, np.ones(1)
        self.tried = []

    def parts(self, plan):
        """Return the three errors that a plan's numbers of terms, neighbouring coefficients and wavelengths cause."""
        of_rate, of_rest = (self._start.bandwidth_um[k] / plan.bandwidth_um[k] for k in (0, 2))
        quadrature = 2e-6 * (of_rate**6 + 0.1 * of_rest**6)
        return self._scale * np.array([math.exp(-0.7 * plan.terms), 0.1 * math.sqrt(plan.least_weight), quadrature])

    def training_error(self, plan):
        self.tried.append(plan)
        return float(self.parts(plan).sum())

    def validation_error(self, plan):
        return self._factor * self.training_error(plan)

    def most_terms(self, plan):
        return 40 if plan.method == "jacobi-anger" else 32

    def update_floors(self, plan):
        pass

    def refine_reference(self, plan):
        pass


def cost(trial, plan):
    return cost_model.sampling_multiply_adds(trial.heightfield, plan, *trial.rates)


def exhaustive(trial, start, target):
    """Return the least cost of all plans (numbers of a computation) whose error is at most ``target``.

    The plans are all combinations of several numbers of terms, neighbours and wavelengths (bandwidths).
    """
    counts = range(REGISTER, start.terms + 1, REGISTER), range(12), range(13)
    per_rate, per_w, constant = start.bandwidth_um
    least = math.inf
    for terms, neighbours, rate in itertools.product(*counts):
        sufficient = {}
        for rest in range(13):
            bandwidth = per_rate / STEP**rate, per_w / STEP**rest, constant / STEP**rest
            weight = start.least_weight * math.exp(neighbours)
            numbers = {"terms": terms, "least_weight": weight, "bandwidth_um": bandwidth}
            if trial.parts(SimpleNamespace(**numbers)).sum() <= target:
                sufficient = numbers
        # Among plans (numbers of computations) with the same number of terms and of neighbouring Fourier coefficients,
        # the plan with the smallest sufficient bandwidth has the least cost. It is the last sufficient plan of this
        # loop.
        if sufficient:
            least = min(least, cost(trial, dataclasses.replace(start, **sufficient)))
    return least


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_a_search_is_near_the_least_cost_and_reports_what_it_measured(fingers, start, factor):
    """The cost of the plan that a search finds must be near the least cost of all sufficient plans.

    The plan must report the errors that the search has measured. The error on the validation directions is the error on
    the training directions times ``factor``. With a factor of 2.5, it exceeds the target (largest accepted error), so
    that the search must refine its plan again.
    """
    trial = ClosedForm(fingers, start, validation_factor=factor)
    plan = coordinate_search.search(start, trial, automatic=True)
    parts = factor * trial.parts(plan)
    assert parts.sum() <= TARGET
    # Bisection must try at most 20 plans in total: it searches 4 numbers of terms, 9 numbers of neighbouring
    # coefficients, and three parts of the bandwidth with 13 values each.
    assert len(trial.tried) <= 20 + 5 * (factor > 1.0)
    assert plan.method == start.method
    assert plan.is_measured
    assert plan.validation_size == 7
    assert plan.multiply_adds == pytest.approx(cost(trial, plan))
    assert plan.multiply_adds <= (1.15 if factor == 1.0 else 1.3) * exhaustive(trial, start, TARGET / factor)
    assert plan.error == pytest.approx(1.6 * parts.sum())
    if factor == 1.0:
        reported = [plan.truncation, plan.neighbourhood, plan.quadrature]
        np.testing.assert_allclose(reported, 1.6 * parts, rtol=0.02, atol=2e-5)


@pytest.mark.parametrize("most", [0, 1, 5, 12])
def test_a_bisection_ends_at_the_last_step_within_the_budget(start, most):
    coarser = dataclasses.replace
    for limit in range(-1, most + 2):
        trial = SimpleNamespace(training_error=lambda plan: float(start.terms - plan.terms))
        coordinate = Coordinate("truncation", limit + 0.5, most, lambda plan, n: coarser(plan, terms=plan.terms - n))
        plan, error = coordinate_search._coarsened(start, 0.0, trial, coordinate)
        assert start.terms - plan.terms == error == min(max(limit, 0), most)


def test_steps_beyond_the_fewest_wavelengths_are_withdrawn(fingers, start):
    trial = ClosedForm(fingers, start, scale=0.0)
    bandwidth = coordinate_search._coordinates(start, trial, 0.0, TARGET)[2]
    bandwidth = dataclasses.replace(bandwidth, most=40)
    plan, _ = coordinate_search._coarsened(start, 0.0, trial, bandwidth)
    assert plan.wavelengths == 16
    assert bandwidth.coarser(plan, -1).wavelengths > 16


class Steps:
    """Stand-in for a trial of plans, which measures the error of a plan (numbers of a computation).

    The error is a function, chosen by the test, of the numbers of added terms and wavelengths.
    """

    rates = np.array([0.5]), np.array([1.0]), np.ones(1)

    def __init__(self, heightfield, start, error):
        self.heightfield, self._start, self._error = heightfield, start, error

    def validation_error(self, plan):
        return self._error(plan.terms - self._start.terms, plan.wavelengths - self._start.wavelengths)

    def update_floors(self, plan):
        pass


@pytest.mark.parametrize(
    ("error", "finer"),
    [
        (lambda _terms, _wavelengths: TARGET, (0, 0)),
        (lambda terms, wavelengths: 2.0 * TARGET * (terms + wavelengths == 0), (1, 0)),
        (lambda _terms, wavelengths: 2.0 * TARGET * (wavelengths == 0), (0, 1)),
        (lambda terms, wavelengths: (4.0 - terms - 0.9 * wavelengths) * TARGET, (3, 0)),
        (lambda terms, wavelengths: 2.0 * TARGET * (terms == 0 or wavelengths == 0), (1, 1)),
        (lambda _terms, _wavelengths: 2.0 * TARGET, (0, 0)),
        (lambda terms, wavelengths: (20.0 - terms - 0.9 * wavelengths) * TARGET, (7, 0)),
    ],
    ids=["enough", "the cheaper one", "the other one", "1 and 2 steps", "both", "neither", "1, 2 and 4 steps"],
)
def test_repairs_use_the_cheapest_sufficient_step_or_the_one_with_the_least_error(fingers, start, error, finer):
    """A plan with too large an error must be refined by the cheapest sufficient step, or else the most accurate one.

    The plan has 9 terms and 100 wavelengths. One of the two possible steps adds a term, the other one a wavelength. The
    step that adds a term is cheaper.
    """
    plan = dataclasses.replace(start, terms=9, wavelengths=100, adaptive=False)
    replace = dataclasses.replace
    coordinates = [
        Coordinate("quadrature", 0.0, 3, lambda plan, n: replace(plan, wavelengths=plan.wavelengths - n)),
        Coordinate("truncation", 0.0, 3, lambda plan, n: replace(plan, terms=plan.terms - n)),
    ]
    result, least = coordinate_search.refine(plan, Steps(fingers, plan, error), coordinates, TARGET)
    assert (result.terms - 9, result.wavelengths - 100) == finer
    assert least == error(*finer)


@pytest.mark.parametrize(
    ("error", "bright", "predicted"),
    [
        (5e-3, math.inf, 8e-3),
        (1e-2, math.inf, 1.6e-2),
        (1e-5, math.inf, 1e-3),
        (4e-3, 100.0, 8e-3),
        (6e-3, 100.0, 1e-2),
        (7e-3, 100.0, 1.12e-2),
    ],
)
def test_the_safety_factor_of_predicted_errors_depends_on_the_directions_that_were_tried(
    start, error, bright, predicted
):
    """If the validation set has all directions of a call, the predicted error must be 1.6 times the measured error.

    The validation set has the directions on which the error of a plan is measured. If it has only a part of them, the
    factor must be up to 2. In all cases the predicted error must be at least a tenth of the tolerance.
    """
    trial = SimpleNamespace(bright=(bright, bright))
    assert coordinate_search.predicted_error(error, start, trial) == pytest.approx(predicted)


def test_terms_fill_whole_registers_up_to_the_size_of_the_basis(start):
    trial = SimpleNamespace(most_terms=lambda _plan: 29)
    for terms, registers, expected in [(9, 0, 16), (9, 1, 24), (9, 2, 29), (9, -1, 8), (9, -5, 8), (24, -1, 16)]:
        plan = dataclasses.replace(start, terms=terms)
        assert coordinate_search.more_terms(plan, trial, registers).terms == expected
    trial = SimpleNamespace(most_terms=lambda _plan: 5)
    assert coordinate_search.more_terms(start, trial, -9).terms == 5


@pytest.mark.parametrize(("of_amplitudes", "automatic"), [(0.4, True), (0.6, True), (0.4, False)])
def test_a_series_of_amplitudes_replaces_powers_that_cancel(start, of_amplitudes, automatic):
    """A method that adds amplitudes must replace one that adds powers only if its error is less than half as large.

    Amplitudes and powers are those of Fourier coefficients. In a series of powers, large terms can cancel in float32.
    """
    trial = SimpleNamespace(integrates=False, reference=dataclasses.replace(start, method="jacobi-anger", terms=40))
    trial.order_rate = trial.w = np.ones(1)
    trial.training_error = lambda plan: of_amplitudes if plan.method == "jacobi-anger" else 1.0
    plan, error = coordinate_search._sufficient(start, trial, TARGET, automatic=automatic)
    switches = automatic and of_amplitudes < 0.5
    assert (plan.method, plan.terms) == (("jacobi-anger", 40) if switches else ("low-rank", 32))
    assert error == (of_amplitudes if switches else 1.0)


@pytest.mark.parametrize("octaves", [0.0, 0.7, 2.5])
def test_a_bandwidth_that_is_too_small_is_doubled_as_often_as_required(fingers, start, octaves):
    """The bandwidth must be doubled until the error, proportional to bandwidth⁻⁶, is at most half of the target.

    The target is the largest accepted error. The bandwidth is the number of wavelength samples per unit of 1/λ.
    """
    trial = ClosedForm(fingers, start)
    trial.training_error = lambda plan: (
        TARGET / 2.0 * (2.0**octaves * start.bandwidth_um[0] / plan.bandwidth_um[0]) ** 6
    )
    plan, error = coordinate_search._sufficient(start, trial, TARGET, automatic=True)
    assert error == trial.training_error(plan)
    assert math.log2(plan.bandwidth_um[0] / start.bandwidth_um[0]) == pytest.approx(math.ceil(octaves))
    np.testing.assert_allclose(np.divide(plan.bandwidth_um, start.bandwidth_um), 2.0 ** math.ceil(octaves))


def test_a_bandwidth_is_not_doubled_where_that_does_not_halve_the_error(fingers, start):
    trial = ClosedForm(fingers, start)
    trial.training_error = lambda plan: TARGET * (1.0 if plan == start else 0.6)
    assert coordinate_search._sufficient(start, trial, TARGET, automatic=True) == (start, TARGET)


def test_a_bandwidth_is_doubled_until_the_fastest_orders_are_resolved(fingers, start):
    """The search must double the bandwidth even if the error does not decrease at first.

    The bandwidth is the number of wavelength samples per unit of 1/λ. The error can stay the same until a plan has
    enough wavelengths for the direction with the largest order rate (how fast diffraction orders pass the direction as
    1/λ changes).
    """
    trial = ClosedForm(fingers, start)
    rate = 6.0 * start.max_order_rate
    trial.order_rate, trial.w = np.array([0.0, rate]), np.array([start.max_w, start.max_w])
    needed = cost_model.wavelength_count(start, rate, start.max_w)
    assert start.wavelengths < needed / 3.0
    trial.training_error = lambda plan: TARGET if plan.wavelengths < needed else 0.0
    plan, error = coordinate_search._sufficient(start, trial, TARGET, automatic=True)
    assert error == 0.0
    assert needed <= plan.wavelengths < 2.5 * needed


def test_a_smaller_bandwidth_allows_larger_order_rates_or_fewer_wavelengths(fingers):
    """With half of the bandwidth, a plan must cover larger order rates, or have fewer wavelengths.

    The bandwidth is the number of wavelengths per unit of 1/λ. The order rate of a direction is how fast diffraction
    orders pass it as 1/λ changes. The original plan has only the wavelengths that its bandwidth requires. If the call
    has larger order rates than the plan covers, the range of order rates must grow. Otherwise the number of wavelengths
    must decrease.
    """
    source = wd.Coherence("source", angular_diameter_deg=3.0)
    plan = wd.plan(fingers, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], coherence=source, method="low-rank")
    count = cost_model.wavelength_count(plan, plan.max_order_rate, plan.max_w)
    plan = dataclasses.replace(plan, wavelengths=math.floor(count))
    bandwidth = tuple(part / 2.0 for part in plan.bandwidth_um)
    result = coordinate_search._with_bandwidth(plan, SimpleNamespace(max_order_rate=1e9), bandwidth)
    served = cost_model.wavelength_count(result, result.max_order_rate, result.max_w)
    assert served == pytest.approx(plan.wavelengths)
    assert served <= result.wavelengths * 1.05
    result = coordinate_search._with_bandwidth(plan, SimpleNamespace(max_order_rate=0.5), bandwidth)
    assert result.max_order_rate == plan.max_order_rate
    assert result.wavelengths < 0.7 * plan.wavelengths


def test_fewer_wavelengths_are_subdivided_more_under_replicated_periods(fingers):
    coherence = wd.Coherence("replicas", periods=(40, 40))
    plan = wd.plan(fingers, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], coherence=coherence, method="low-rank")
    assert plan.subdivisions > 1
    bandwidth = tuple(part / 3.0 for part in plan.bandwidth_um)
    trial = SimpleNamespace(max_order_rate=plan.max_order_rate)
    result = coordinate_search._with_bandwidth(plan, trial, bandwidth)
    samples = plan.wavelengths * plan.subdivisions
    assert result.wavelengths < plan.wavelengths
    assert samples <= result.wavelengths * result.subdivisions < samples + result.wavelengths


@pytest.mark.parametrize("tolerance", [1e-1, 3e-3])
def test_searches_of_all_tolerances_try_the_same_bandwidths_and_weights(fingers, tolerance):
    """Searches at all tolerances must try plans on the same grid of bandwidths and least weights.

    The bandwidth is the number of wavelengths per unit of 1/λ, and the least weight selects the Fourier coefficients of
    a sum. The bandwidths are those of a tolerance of 0.01 times powers of 2^(1/4). The least weights are powers of e.
    """
    plans = [
        wd.plan(fingers, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], method="low-rank", tolerance=t) for t in (1e-2, tolerance)
    ]
    trial = SimpleNamespace(heightfield=fingers, integrates=True, max_order_rate=0.6)
    usual, plan = (coordinate_search._on_grid(plan, trial) for plan in plans)
    np.testing.assert_allclose(usual.bandwidth_um, plans[0].bandwidth_um)
    steps = 4.0 * np.log2(np.divide(plan.bandwidth_um, usual.bandwidth_um))
    np.testing.assert_allclose(steps, round(steps[0]), atol=1e-9)
    assert abs(4.0 * math.log2(plan.bandwidth_um[0] / plans[1].bandwidth_um[0])) <= 0.5
    power = math.log(plan.least_weight)
    assert power == pytest.approx(round(power))
    assert math.log(plans[1].least_weight) - 1.0 < power <= math.log(plans[1].least_weight)


def test_budgets_grow_evenly_from_the_error_of_the_start_to_the_target(fingers, start):
    """Error budgets must increase in equal steps from the error of the first plan to the target.

    The target is the largest accepted error. A search reduces one number of the plan (a coordinate) after another. The
    budget of a number is the limit of the plan's error while this number is reduced. Few bright directions in the
    sample do not represent all bright directions of a call well. The budgets of terms and of the neighbourhood, which
    are reduced first, must then increase by only a tenth of an equal step. The neighbourhood must then not be reduced.
    """
    trial, error = ClosedForm(fingers, start), 0.4 * TARGET
    coordinates = coordinate_search._coordinates(start, trial, error, TARGET)
    np.testing.assert_allclose([c.budget for c in coordinates], np.linspace(error, TARGET, 6)[1:])
    # Largest numbers of steps by which a search may reduce a plan: 3 of the 4 SIMD registers that its terms fill, 8
    # factors of e in the least weight of Fourier coefficients (up to 1e-5), and 12 factors of 2^(1/4) in each part of
    # the bandwidth.
    assert [c.most for c in coordinates] == [3, 8, 12, 12, 12]
    trial.bright = (63.0, 64.0)
    few = coordinate_search._coordinates(start, trial, error, TARGET)
    shares = [(c.budget - error) / (TARGET - error) for c in few]
    np.testing.assert_allclose(shares, [0.02, 0.04, 0.6, 0.8, 1.0])
    assert [c.most for c in few] == [3, 0, 12, 12, 12]
    late = coordinate_search._coordinates(start, trial, 2.0 * TARGET, TARGET)
    assert {c.budget for c in late} == {2.0 * TARGET}
