"""Trials evaluate plans on sampled directions: their colours and errors are those of the public functions.

A plan holds the numbers of a computation, such as wavelengths and terms of a series. The upper-bound plan suffices for
any surface. The reference of a trial is this plan with twice the wavelengths. Directions are dim if their luminance is
below a floor, the smallest divisor of relative errors.
"""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import hemisphere

import warpdiff as wd
from warpdiff.planner import strategy, trial
from warpdiff.request.directions import DirectionSample
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings, SpectralSettings

SHORT = wd.Coherence(sigma_um=3.25)
ILLUMINANTS = "D65", "A"


def trial_of(request, lights, views):
    """Return the trial of a call, and the upper-bound plan of the call.

    A trial evaluates plans (numbers of wavelengths and terms) on sampled directions. The upper-bound plan suffices for
    any surface.
    """
    direction_range, sample, _ = strategy.directions_of(request, lights, views)
    coarse = strategy._coarse_plan(request, direction_range)
    upper = strategy.bounds.upper_bound_plan(request, direction_range, method="low-rank", tolerance=request.tolerance)
    plan = strategy._with_basis(upper, request, direction_range)
    return trial.Trial(plan, request, direction_range, sample, coarse=coarse), plan


@pytest.fixture(scope="module")
def colours(fingers):
    """Return a trial of 60 directions under two illuminants, an upper-bound plan, and the directions.

    A trial evaluates plans (numbers of wavelengths and terms) on sampled directions.
    """
    rng = np.random.default_rng(7)
    lights, views = hemisphere(rng, 60, 0.3), hemisphere(rng, 60, 0.3)
    request = Evaluation.of(fingers, PlanSettings(coherence=SHORT, tolerance=1e-1), illuminants=ILLUMINANTS)
    return *trial_of(request, lights, views), lights, views


def test_the_reference_has_twice_the_wavelengths_and_the_values_of_the_public_function(fingers, colours):
    measured, plan, lights, views = colours
    assert measured.reference.wavelengths == 2 * plan.wavelengths - 1
    assert measured.reference.method == "jacobi-anger"
    exact = measured.exact(measured.validation_set)
    for values, illuminant in zip(exact, ILLUMINANTS, strict=True):
        expected = wd.reflectance(fingers, lights, views, plan=measured.reference, illuminant=illuminant)
        np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-6 * expected.max())


def test_errors_of_few_directions_are_the_largest_error_relative_to_the_colour_or_the_floor(fingers, colours):
    """The error of few directions must be the largest relative error, with the colour's norm or the floor as divisor.

    The floor is the smallest divisor. Each of the 60 directions has more than 0.5 % of the weight. The 99.5th
    percentile of the errors is therefore their maximum.
    """
    measured, plan, lights, views = colours
    coarse = dataclasses.replace(plan, wavelengths=16, adaptive=False)
    largest, of_half = [], []
    half = np.hypot(*(lights + views)[:, :2].T) <= 0.8
    assert 10 < np.count_nonzero(half) < 50
    for illuminant in ILLUMINANTS:
        exact, values = (
            wd.reflectance(fingers, lights, views, plan=numbers, illuminant=illuminant)
            for numbers in (measured.reference, coarse)
        )
        scale = np.maximum(np.linalg.norm(exact, axis=1), 1e-3 * exact[:, 1].max())
        errors = np.linalg.norm(values - exact, axis=1) / scale
        largest.append(errors.max())
        of_half.append(errors[half].max())
    assert measured.validation_error(coarse) == pytest.approx(max(largest), rel=1e-2)
    assert measured.training_error(coarse) == measured.validation_error(coarse)
    assert measured.bright == (math.inf, math.inf)
    assert measured.any_light
    # The order rate of a direction is how fast diffraction orders pass it as 1/λ changes. The reference plan of the
    # trial resolves order rates up to ``max_order_rate``. Directions with larger order rates must be excluded from the
    # error.
    complete = measured.reference
    measured.reference = dataclasses.replace(complete, max_order_rate=0.8)
    assert measured.validation_error(coarse) == pytest.approx(max(of_half), rel=1e-2)
    measured.reference = complete


def test_a_basis_has_the_terms_that_were_fitted_and_a_series_those_of_the_bounds(colours):
    measured, plan, _, _ = colours
    assert measured.most_terms(measured.reference) == measured.reference.terms
    assert measured.most_terms(plan) == measured.fitted(plan).terms >= plan.terms
    assert measured.most_terms(dataclasses.replace(plan, method="taylor")) == plan.terms


def test_spectra_equal_those_of_the_public_function(fingers, rng):
    gold, wavelengths = wd.Material.metal("Au"), np.linspace(400.0, 700.0, 5)
    lights, views = hemisphere(rng, 40, 0.3), hemisphere(rng, 40, 0.3)
    settings = SpectralSettings(coherence=SHORT, tolerance=1e-1, material=gold)
    request = Evaluation.of(fingers, settings, wavelengths_nm=wavelengths)
    measured, plan = trial_of(request, lights, views)
    assert not measured.integrates
    assert measured.reference.wavelengths == 0
    expected = wd.spectral_reflectance(fingers, lights, views, wavelengths, plan=plan, material=gold)
    result = measured.run(plan, measured.validation_set)
    assert result.shape == (1, 200, 1)
    np.testing.assert_allclose(result.reshape(40, 5), expected, rtol=1e-5)
    exact = measured.exact(measured.validation_set).reshape(40, 5)
    floor = 1e-3 * exact.max()
    largest = np.max(np.abs(expected - exact) / np.maximum(exact, floor))
    assert measured.validation_error(plan) == pytest.approx(largest, rel=1e-2)


def test_the_reference_luminance_is_a_percentile_or_the_median_of_the_light():
    luminance = np.concatenate([np.full(1000, 1.0), np.full(5, 1000.0)])
    weights = np.ones(1005)
    assert trial.reference_luminance(luminance, weights) == 1000.0
    assert trial.reference_luminance(luminance, weights, with_median=False) == 1.0
    # The tested call has 1,005 directions, of which 20 (2 %) are bright. The 99th percentile of the luminance is
    # therefore the luminance of these bright directions.
    luminance[-20:] = 50.0
    assert trial.reference_luminance(luminance, weights, with_median=False) == 50.0
    # If the weight of each bright direction is reduced to a quarter, the bright directions have 0.5 % of the total
    # weight. The percentile and the luminance-weighted median are then the luminance of the dim directions.
    weights[-20:] = 0.25
    assert trial.reference_luminance(luminance, weights) == 1.0
    assert trial.reference_luminance(luminance[:0], weights[:0]) == 0.0
    assert trial.reference_luminance(np.zeros(9), np.zeros(9)) == 0.0


def test_the_worst_percentile_is_the_maximum_over_bright_and_dim_directions():
    """``worst_percentile`` must return the largest percentile of errors over illuminants and groups of directions.

    The groups are the bright and the dim directions. The percentile of a group is the error that 0.5 % of the weight of
    this group exceeds.
    """
    errors = np.array([np.arange(2000.0), np.zeros(2000)])
    above = np.array([np.arange(2000) < 1000, np.arange(2000) < 1000])
    group = SimpleNamespace(weights=np.ones(2000), above=above)
    assert trial.worst_percentile(errors, group) == 1994.0
    assert trial.worst_percentile(errors[::-1], group) == 1994.0
    assert trial.worst_percentile(errors, group, np.arange(2000) < 1000) == 994.0
    assert trial.worst_percentile(-errors, group) == 0.0
    group.weights[1000:] = 1e-3
    group.weights[1999] = 1.0
    assert trial.worst_percentile(errors, group) == 1999.0


def test_errors_of_a_group_have_a_row_for_each_illuminant_and_floor(rng):
    lights = hemisphere(rng, 6)
    group = trial.Group(DirectionSample(-2.0 * lights, lights, np.ones(6), np.arange(6.0)), "cpu", 1)
    exact = rng.uniform(0.1, 1.0, (2, 6, 3))
    exact[:, 0] = 1e-3
    floors = np.array([[0.05, 0.01], [0.5, 0.3]])
    group.weigh(exact, floors)
    values = exact + rng.normal(0.0, 0.01, exact.shape)
    errors = group.errors(values, exact)
    assert errors.shape == group.above.shape == (4, 6)
    for row, (illuminant, k) in enumerate(np.ndindex(2, 2)):
        floor, bright = floors[illuminant, k], exact[illuminant]
        scale = np.maximum(np.linalg.norm(bright, axis=1), floor)
        np.testing.assert_allclose(errors[row], np.linalg.norm(values[illuminant] - bright, axis=1) / scale)
        np.testing.assert_array_equal(group.above[row], bright[:, 1] >= floor)


def test_bright_directions_are_counted_by_the_highest_and_by_the_lowest_floor():
    """For each of two floors, the number of bright directions must be that of the illuminant with the fewest.

    A floor is the smallest luminance of a bright direction. A call can have two floors. The higher floor is computed
    with outliers among the brightest directions, the lower floor without them.
    """
    above = np.arange(100) < np.array([[40], [60], [30], [80]])
    group = trial.Group(DirectionSample(*np.ones((2, 100, 3)), *np.ones((2, 100))), "cpu", 1)
    group.above = above
    measured = SimpleNamespace(
        validation_set=group, _candidates=range(1000), _floors=np.ones((2, 2)), exact=lambda _group: None
    )
    assert trial.Trial.bright.fget(measured) == (30.0, 60.0)


@pytest.mark.parametrize(
    ("floor", "light", "expected"),
    [(0.5e-10, 0.5e-10, False), (2e-10, 0.5e-10, True), (0.5e-10, 2e-10, True)],
    ids=["darkness", "a bright call", "a call between darkness and light"],
)
def test_a_call_has_light_if_its_floor_or_one_training_direction_exceeds_darkness(floor, light, expected):
    measured = SimpleNamespace(
        _floors=np.array([[1e-11], [floor]]), training_set=None, exact=lambda _group: np.array([[[1e-11], [light]]])
    )
    assert trial.Trial.any_light.fget(measured) is expected


def test_the_luminance_of_a_spectrum_is_its_maximum_and_the_lowest_floor_limits_bright_directions(fingers, monkeypatch):
    """If a request is for spectra, the largest value of each spectrum must replace the luminance of its direction.

    A floor is the smallest luminance of a bright direction. The trial draws two sets of directions, one to search a
    plan and one to validate it. The draw must use these maxima and the lowest floor, because minima or other floors
    would select other directions.
    """
    rng = np.random.default_rng(11)
    lights, views = hemisphere(rng, 4000, 0.3), hemisphere(rng, 4000, 0.3)
    wavelengths = np.array([400.0, 700.0])
    request = Evaluation.of(fingers, SpectralSettings(coherence=SHORT, tolerance=0.5), wavelengths_nm=wavelengths)
    calls = []

    def record(candidates, _is_edge_case, luminance, floor):
        calls.append((candidates, luminance, floor))
        return candidates, candidates

    monkeypatch.setattr(trial.validation_directions, "sampled", record)
    measured, _ = trial_of(request, lights, views)
    ((candidates, luminance, floor),) = calls
    direction_range, _, _ = strategy.directions_of(request, lights, views)
    coarse = strategy._coarse_plan(request, direction_range)
    spectra = measured.run(coarse, measured.validation_set).reshape(len(candidates), 2)
    assert np.count_nonzero(np.diff(spectra)) > 1000
    np.testing.assert_allclose(luminance, spectra.max(axis=1))
    assert measured._floors.shape == (1, 2)
    assert floor == measured._floors.min() < measured._floors.max()


def test_sets_of_a_larger_call_are_disjoint_parts_of_the_candidates(fingers):
    rng = np.random.default_rng(9)
    lights, views = hemisphere(rng, 500, 0.3), hemisphere(rng, 500, 0.3)
    request = Evaluation.of(fingers, PlanSettings(coherence=SHORT, tolerance=0.5), illuminants=("D65",))
    measured, _ = trial_of(request, lights, views)
    training, validation = (
        set(map(tuple, group.sample.scattering_vectors)) for group in (measured.training_set, measured.validation_set)
    )
    assert (len(training), len(validation)) == (128, 256)
    assert not training & validation
    assert len(measured.order_rate) == len(measured.w) == 128
    assert all(len(values) == 500 for values in measured.rates)
    # Candidates are the directions from which the training and the validation set are drawn. This call is small, so
    # that all of its directions are candidates, and there is one luminance floor. In larger calls the brightest
    # candidates may be outliers; a second floor is then computed without them.
    assert measured._floors.shape == (1, 1)
    assert 0.0 < measured.bright[0] <= 256.0
