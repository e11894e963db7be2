"""Cost model: proportions of its numbers."""

import dataclasses

import numpy as np
import pytest
from conftest import noise

import warpdiff as wd
from warpdiff.planner import cost_model


def sampling(heightfield, plan, **changes):
    """Cost of one direction of a plan that takes all its wavelengths."""
    plan = dataclasses.replace(plan, adaptive=False, **changes)
    return cost_model.sampling_multiply_adds(heightfield, plan, np.array([0.5]), np.array([1.0]))


def test_subdivisions_under_replicated_periods_cost_in_proportion_to_their_number():
    heightfield = noise((6, 16))
    plan = wd.plan(heightfield, [0, 0, 1], [0.6, 0, 0.8], coherence=wd.Coherence("replicas", periods=(2, 3)))
    costs = [sampling(heightfield, plan, subdivisions=n) for n in (1, 2, 4)]
    assert costs[2] - costs[1] == pytest.approx(2.0 * (costs[1] - costs[0]))
    assert costs[0] < costs[1]


def test_costs_are_in_proportion_to_wavelengths_and_grow_with_terms_and_neighbours():
    heightfield = noise((6, 16))
    plan = wd.plan(heightfield, [0, 0, 1], [0.6, 0, 0.8])
    cost = sampling(heightfield, plan)
    assert sampling(heightfield, plan, wavelengths=2 * plan.wavelengths) == pytest.approx(2.0 * cost)
    increases = np.diff([sampling(heightfield, plan, terms=n) for n in (32, 64, 96, 128)])
    np.testing.assert_allclose(increases, increases[0], rtol=1e-6)
    assert increases[0] > 0.0
    # Neighbours lie in an ellipse whose axes grow with the root of the exponent.
    costs = [sampling(heightfield, plan, least_weight=float(np.exp(-n))) for n in (1.0, 4.0, 9.0)]
    sides = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(costs, np.polyval(np.polyfit(sides**2, costs, 1), sides**2), rtol=1e-6)


def test_the_cost_of_a_table_is_quadratic_in_its_terms(fingers):
    options = {"coherence": wd.Coherence(sigma_um=3.25), "method": "low-rank", "integration": "table"}
    plan = wd.plan(fingers, tolerance=1e-1, **options)
    plans = [dataclasses.replace(plan, terms=n) for n in (32, 64, 96, 128)]
    first, second = np.diff([cost_model.table_multiply_adds(fingers, plan) for plan in plans], 2)
    assert first > 0.0
    assert second == pytest.approx(first)
