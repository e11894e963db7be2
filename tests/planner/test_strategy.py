"""Strategy: range of the directions of a call, and choice of an upper-bound plan, a searched plan or a colour table.

A plan holds the numbers of a computation, such as wavelengths and terms of a series. An upper-bound plan suffices for
any surface. A search evaluates cheaper plans on sampled directions. A table stores colours by scattering vector.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import at_angle, hemisphere

import warpdiff as wd
from warpdiff.heightfield import diagnostics
from warpdiff.planner import bounds, cost_model, strategy
from warpdiff.request.directions import order_rate
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings


@pytest.fixture(scope="module")
def request_of_fingers(fingers):
    return Evaluation.of(fingers, PlanSettings(), illuminants=("D65",))


def test_a_sample_has_the_directions_of_the_call(request_of_fingers, rng):
    lights, views = hemisphere(rng, 500), hemisphere(rng, 500)
    direction_range, sample, count = strategy.directions_of(request_of_fingers, lights, views)
    assert count == len(sample) == 500
    np.testing.assert_allclose(sample.to_lights, lights)
    np.testing.assert_allclose(-sample.scattering_vectors - sample.to_lights, views)
    vectors = lights + views
    assert np.hypot(*vectors.T[:2]).max() <= direction_range.max_uv * (1.0 + 1e-9)
    assert direction_range.min_w <= vectors[:, 2].min() * (1.0 + 1e-9)
    assert vectors[:, 2].max() <= direction_range.max_w * (1.0 + 1e-9)


@pytest.mark.parametrize("is_light", [True, False])
def test_directions_below_the_horizon_do_not_widen_the_range(is_light, request_of_fingers):
    ends = np.array([at_angle(0.0), at_angle(0.0)]), np.array([at_angle(30.0), at_angle(100.0)])
    direction_range, sample, _ = strategy.directions_of(request_of_fingers, *(ends[::-1] if is_light else ends))
    assert direction_range.max_uv == pytest.approx(0.5)
    assert len(sample) == 1


@pytest.mark.parametrize(("side", "light", "view"), [("light", at_angle(30.0), None), ("view", None, at_angle(30.0))])
def test_the_whole_hemisphere_is_assumed_on_the_other_side(side, light, view, request_of_fingers):
    """If only one of two directions is known, the range must cover the whole hemisphere of the other direction.

    The call states only the direction to the light, or only the direction to the viewer. For a known direction at the
    angle θ from the normal, |(u, v)| is then at most 1 + sin θ, and |w| is between cos θ and 1 + cos θ.
    """
    direction_range, sample, count = strategy.directions_of(request_of_fingers, light, view)
    assert math.isinf(count)
    assert direction_range.max_uv == pytest.approx(1.5)
    assert direction_range.min_w == pytest.approx(math.cos(math.pi / 6.0))
    assert direction_range.max_w == pytest.approx(1.0 + math.cos(math.pi / 6.0))
    views = -sample.scattering_vectors - sample.to_lights
    fixed, other = (sample.to_lights, views) if side == "light" else (views, sample.to_lights)
    np.testing.assert_allclose(fixed, np.broadcast_to(at_angle(30.0), fixed.shape), atol=1e-12)
    # The unknown directions are drawn uniformly in z over the hemisphere, so that their mean z is 0.5.
    assert other[:, 2].mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.filterwarnings("ignore:no pair of")
def test_the_range_of_several_directions_and_the_whole_hemisphere_covers_each(request_of_fingers):
    lights = np.array([at_angle(60.0), at_angle(20.0), at_angle(100.0)])
    direction_range, _, _ = strategy.directions_of(request_of_fingers, lights)
    assert direction_range.max_uv == direction_range.max_order_rate == pytest.approx(1.0 + math.sin(math.pi / 3.0))
    assert direction_range.min_w == pytest.approx(0.5)
    assert direction_range.max_w == pytest.approx(1.0 + math.cos(math.pi / 9.0))
    below, _, _ = strategy.directions_of(request_of_fingers, at_angle(100.0))
    assert (below.max_uv, below.min_w, below.max_w) == (0.0, 0.0, 0.0)
    everything, sample, _ = strategy.directions_of(request_of_fingers)
    assert (everything.max_uv, everything.min_w, everything.max_w) == (2.0, 0.0, 2.0)
    assert len(sample) > 4000


@pytest.mark.parametrize(("kind", "saving"), [("averaged", 2.6), ("centred", 3.0), ("source", 2.2), ("replicas", 4.0)])
def test_a_search_starts_from_the_number_of_directions_that_repay_its_time(kind, saving):
    """A search for a cheaper plan must start only if it costs less than this plan saves in the call.

    A plan has the numbers of a computation. A search costs as much as the evaluation of 16,000 directions with the plan
    that it finds. An evaluation with the upper-bound plan costs ``saving`` times as much as with the plan of the
    search.
    """
    request = SimpleNamespace(method="auto", integration="auto")
    upper = SimpleNamespace(max_order_rate=1.0, method="low-rank", coherence=SimpleNamespace(kind=kind))
    count = 16_000.0 / (saving - 1.0)
    for share, pays in [(0.99, False), (1.01, True)]:
        assert strategy._pays_to_search(request, upper, SimpleNamespace(max_order_rate=1.0), share * count) is pays
    # The order rate is how fast diffraction orders pass a direction as 1/λ changes. Here, the wavelengths of the
    # upper-bound plan suffice up to a rate of 1.0, and the directions of the call have 1.1. A search must then start
    # for any number of directions.
    assert strategy._pays_to_search(request, upper, SimpleNamespace(max_order_rate=1.1), 1.0)


def test_an_explicit_method_that_adds_powers_is_tried_on_sixteen_directions():
    request = SimpleNamespace(method="power", integration="auto")
    coherence = SimpleNamespace(kind="averaged", adds_powers=True)
    upper = SimpleNamespace(max_order_rate=1.0, method="power", coherence=coherence)
    for count, pays in [(15, False), (16, True)]:
        assert strategy._pays_to_search(request, upper, SimpleNamespace(max_order_rate=1.0), count) is pays


def test_a_table_may_cost_what_it_saves_in_three_calls(fingers):
    """A table of colours may cost at most as much as it saves in three calls.

    Without a table, each of these calls would use the plan of a search, which is 2.6 times cheaper than the upper-bound
    plan. The search costs as much as the evaluation of 16,000 directions with its plan.
    """
    settings = PlanSettings(coherence=wd.Coherence(sigma_um=3.25), tolerance=1e-1)
    request = Evaluation.of(fingers, settings, illuminants=("D65",))
    bounded = wd.plan(fingers, at_angle(0.0), at_angle(30.0), coherence=settings.coherence, tolerance=1e-1)
    smallest = dataclasses.replace(bounded, method="low-rank", rings_per_octave=8, azimuths_per_width=0.9)
    table, saving = cost_model.table_multiply_adds(fingers, smallest), bounded.multiply_adds / 2.6
    count = (table / saving + 16_000.0) / 3.0
    assert strategy._affordable_table_cost(request, lambda: bounded, 0.99 * count) == 0.0
    affordable = strategy._affordable_table_cost(request, lambda: bounded, 2.0 * count)
    assert affordable == pytest.approx((6.0 * count - 16_000.0) * saving)
    explicit = dataclasses.replace(request, integration="table")
    assert strategy._affordable_table_cost(explicit, lambda: bounded, 1.0) == math.inf
    for other in ({"method": "power"}, {"wavelengths_nm": np.array([500.0])}):
        assert strategy._affordable_table_cost(dataclasses.replace(request, **other), lambda: bounded, 1e9) == 0.0
    footprint = dataclasses.replace(request, footprint=True)
    assert strategy._affordable_table_cost(footprint, lambda: bounded, 1.0) == math.inf


def test_a_plan_states_the_power_that_aliases_at_the_highest_frequency_of_its_directions(fingers):
    near, far = (wd.plan(fingers, at_angle(0.0), at_angle(angle)) for angle in (10.0, 80.0))
    for plan, angle in ((near, 10.0), (far, 80.0)):
        frequency = math.sin(math.radians(angle)) / 0.38
        assert plan.aliasing == pytest.approx(diagnostics.folded_power(fingers, frequency), rel=1e-6)
    assert 0.0 < near.aliasing < far.aliasing < 1.0


def test_an_explicit_integration_selects_the_low_rank_basis_unless_a_method_is_given(fingers):
    directions = at_angle(0.0), at_angle(30.0)
    for method, integration, expected in [
        ("auto", "sampled", "low-rank"), ("power", "sampled", "power"), ("taylor", "auto", "taylor"),
        ("auto", "auto", "jacobi-anger"),
    ]:  # fmt: skip
        plan = wd.plan(fingers, *directions, method=method, integration=integration, tolerance=1e-1)
        assert plan.method == expected


def test_the_coarse_plan_that_finds_bright_directions_has_8_terms_and_half_of_the_wavelengths(
    request_of_fingers,
):
    direction_range, _, _ = strategy.directions_of(request_of_fingers)
    for request in (dataclasses.replace(request_of_fingers, method=name) for name in ("low-rank", "jacobi-anger")):
        coarse = strategy._coarse_plan(request, direction_range)
        upper = bounds.upper_bound_plan(request, direction_range, method=request.method, tolerance=0.5)
        assert coarse.terms == (8 if request.method == "low-rank" else upper.terms)
        assert upper.terms > 8
        assert coarse.wavelengths == math.ceil(upper.wavelengths / 2.0)


@pytest.mark.parametrize(
    ("options", "error", "expected"),
    [
        ({"integration": "table"}, 1.7, "table"),
        ({"integration": "table"}, None, "refusal"),
        ({"footprint": True}, 1.5, "table"),
        ({"footprint": True}, 1.7, "search"),
        ({}, 1.0, "table"),
        ({}, 1.1, "search"),
        ({}, None, "search"),
    ],
)
def test_a_table_is_used_if_it_meets_the_tolerance_or_is_explicit(
    request_of_fingers, monkeypatch, options, error, expected
):
    """A table of colours must be used if its error is within the tolerance, or if the caller requests a table.

    For pixels with a footprint, colours are means over a part of the table. Their errors are smaller than those of
    single points of the table, so that the error is not multiplied by the safety factor of 1.6.
    """
    request = dataclasses.replace(request_of_fingers, **options)
    direction_range, sample, _ = strategy.directions_of(request, at_angle(0.0), at_angle(30.0))
    upper = bounds.upper_bound_plan(request, direction_range, method="low-rank", tolerance=request.tolerance)
    table = error and dataclasses.replace(
        upper, rings_per_octave=24, azimuths_per_width=1.3, truncation=0.0, neighbourhood=0.0, rounding=0.0,
        quadrature=error * request.tolerance,
    )  # fmt: skip
    searched = dataclasses.replace(upper, is_measured=True)
    monkeypatch.setattr(strategy.trial, "Trial", lambda *_, **__: SimpleNamespace(any_light=True))
    monkeypatch.setattr(strategy.table_ladder, "smallest_table", lambda *_, **__: table)
    monkeypatch.setattr(strategy.coordinate_search, "search", lambda *_, **__: searched)
    arguments = request, direction_range, sample, upper
    if expected == "refusal":
        with pytest.raises(ValueError, match="'table' requires more than 300 MB"):
            strategy._measured(*arguments, math.inf)
    else:
        assert strategy._measured(*arguments, math.inf) is {"table": table, "search": searched}[expected]
    assert strategy._measured(*arguments, 0.0) is searched
    # If all directions are dark, the upper-bound plan must be used. If the order rates of the call (how fast orders
    # pass its directions as 1/λ changes) exceed the largest one for which that plan has enough wavelengths, a search
    # must be used instead.
    monkeypatch.setattr(strategy.trial, "Trial", lambda *_, **__: SimpleNamespace(any_light=False))
    assert not strategy._measured(*arguments, 0.0).is_measured
    cut = dataclasses.replace(upper, max_order_rate=0.9 * direction_range.max_order_rate)
    assert strategy._measured(request, direction_range, sample, cut, 0.0) is searched


@pytest.mark.parametrize(("kind", "factor"), [("averaged", 1.0), ("centred", 16.0)])
def test_a_pixel_that_cannot_use_footprints_counts_as_16_directions(fingers, monkeypatch, kind, factor):
    coherence = wd.Coherence(kind, 3.25)
    request = Evaluation.of(fingers, PlanSettings(coherence=coherence), illuminants=("D65",), footprint=True)
    counts = []

    def recorded(*arguments):
        counts.append(arguments[-1])
        return 0.0

    monkeypatch.setattr(strategy, "_affordable_table_cost", recorded)
    monkeypatch.setattr(strategy, "_pays_to_search", recorded)
    direction_range, sample, _ = strategy.directions_of(request, at_angle(0.0), at_angle(30.0))
    plan = strategy.plan_for(request, direction_range, sample, 100.0)
    assert plan.footprint
    assert counts == [100.0 * factor] * 2


def test_a_plan_without_a_search_has_the_mean_cost_of_its_directions(fingers, rng):
    """For few directions, no search is made. The plan must state their mean cost."""
    lights, views = hemisphere(rng, 5, 0.5), hemisphere(rng, 5, 0.5)
    plan = wd.plan(fingers, lights, views)
    vectors = -lights - views
    rates = order_rate(fingers, plan.coherence, vectors, lights)
    assert plan.multiply_adds == pytest.approx(
        cost_model.sampling_multiply_adds(fingers, plan, rates, np.abs(vectors[:, 2])), rel=1e-6
    )
    steepest = cost_model.sampling_multiply_adds(fingers, plan, rates[:1] * 0.0 + rates.max(), np.array([2.0]))
    assert plan.multiply_adds < 0.99 * steepest
