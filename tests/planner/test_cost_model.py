"""Cost model: how its estimates scale with the numbers of a plan.

A plan has the numbers of a computation, and the model predicts its cost in multiply-adds. Terms are the terms of the
series in which a Fourier coefficient is expanded. Neighbours are the Fourier coefficients that contribute to a
direction; the set of them is the neighbourhood of the direction. q is a spatial frequency, and σ the standard deviation
of the coherence window.
"""

import dataclasses
import math

import numpy as np
import pytest
from conftest import noise

import warpdiff as wd
from warpdiff.planner import cost_model
from warpdiff.tables import mip_layout


def sampling(heightfield, plan, **changes):
    """Return the predicted multiply-adds of one direction that uses all wavelengths (``adaptive=False``)."""
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
    # Neighbours are Fourier coefficients with at least the weight ``least_weight``. They lie within an ellipse of
    # frequencies. The axes of the ellipse are proportional to the square root of −ln(least_weight), and so are the
    # numbers of neighbours along each axis.
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


def table_plan(heightfield, coherence, method="low-rank"):
    plan = wd.plan(heightfield, [0, 0, 1], [0.6, 0, 0.8], coherence=coherence, method=method)
    return dataclasses.replace(plan, rings_per_octave=24, azimuths_per_width=1.3)


def test_samples_of_a_spectrum_cost_in_proportion_to_their_terms_and_neighbours(fingers):
    """A sample of the power spectrum for a table must cost in proportion to its terms and neighbouring coefficients.

    Neighbours lie in the circle of frequencies q in which their weight exp(−4π²σ²q²) is at least ``least_weight``.
    Their number is the area of this circle times the area of the patch.
    """
    plan = table_plan(fingers, wd.Coherence(sigma_um=3.25))
    costs = [
        cost_model.table_multiply_adds(fingers, dataclasses.replace(plan, terms=terms, least_weight=math.exp(-n)))
        for terms, n in ((8, 4.0), (8, 9.0), (16, 4.0), (16, 9.0))
    ]
    circles = math.pi * (9.0 - 4.0) / (4.0 * (math.pi * 3.25) ** 2) * math.prod(fingers.size_um)
    increases = np.array([costs[1] - costs[0], costs[3] - costs[2]])
    np.testing.assert_allclose(increases, mip_layout.layout_of(plan).samples * circles * np.array([8.0, 16.0]))


def test_lines_of_a_source_cost_in_proportion_to_the_area_and_grow_with_terms():
    heightfields = [noise((12, columns)) for columns in (16, 32, 48)]
    source = wd.Coherence("source", angular_diameter_deg=3.0)
    plan = dataclasses.replace(table_plan(heightfields[0], source), max_uv=1.9)
    costs = np.array([
        [cost_model.table_multiply_adds(field, dataclasses.replace(plan, terms=terms)) for field in heightfields]
        for terms in (8, 16, 24)
    ])  # fmt: skip
    increases = np.diff(costs, axis=1)
    assert increases.min() > 0.0
    np.testing.assert_allclose(increases[:, 0], increases[:, 1], rtol=1e-6)
    np.testing.assert_allclose(np.diff(increases[:, 0]), increases[1, 0] - increases[0, 0], rtol=1e-6)
    # A colour table of a light source adds spectral lines to its entries. The number of lines is twice the number of
    # Fourier coefficients whose frequency is at most ``highest``.
    lines = 2.0 * math.pi * mip_layout.layout_of(plan).highest ** 2
    area = math.prod(heightfields[1].size_um) - math.prod(heightfields[0].size_um)
    assert increases[0, 0] == pytest.approx(lines * area * (150.0 + 42.0 * 8.0))
    # When a colour table is made, each spectral line costs 150 multiply-adds. It is added to 42 table entries, each
    # with one multiply-add per term.
    assert increases[1, 0] / increases[0, 0] == pytest.approx((150.0 + 42.0 * 16.0) / (150.0 + 42.0 * 8.0))


def test_directions_cost_as_many_wavelengths_as_they_require():
    """The predicted cost of a direction must be that of the number of wavelengths it requires, times 2^(1/8).

    The sizes of the available sets of wavelengths increase in steps of a factor 2^(1/4). On average, a direction uses a
    set that is half a step, a factor of 2^(1/8), larger than required.
    """
    heightfield = noise((6, 16))
    plan = wd.plan(heightfield, [0, 0, 1], [0.6, 0, 0.8])
    plan = dataclasses.replace(plan, wavelengths=400, bandwidth_um=(200.0, 20.0, 10.0))
    rates, w = np.array([0.1, 0.5, 5.0]), np.array([1.0, 2.0, 1.5])
    required = np.minimum((200.0 * rates + 20.0 * w + 10.0) * (1 / 0.38 - 1 / 0.78) + 1.0, 400.0 / 2.0**0.125)
    costs = [cost_model.sampling_multiply_adds(heightfield, plan, rates[k : k + 1], w[k : k + 1]) for k in range(3)]
    np.testing.assert_allclose(np.divide(costs, costs[2]), required * 2.0**0.125 / 400.0)
    weights = np.array([1.0, 2.0, 5.0])
    mean = cost_model.sampling_multiply_adds(heightfield, plan, rates, w, weights)
    assert mean == pytest.approx(np.average(costs, weights=weights))


def test_neighbours_lie_in_a_rectangle_of_orders_around_a_direction():
    """The number of neighbours must be the product of 2 · radius · length over all axes with more than one sample.

    Neighbours are the Fourier coefficients that contribute to a direction. The radius is that of their frequencies
    around the direction in 1/µm, and the length is that of the patch in µm.
    """
    line, field = noise((1, 16)), noise((6, 16))
    plan = dataclasses.replace(wd.plan(field, [0, 0, 1], [0.6, 0, 0.8]), terms=8, adaptive=False)
    radius = math.sqrt(-math.log(plan.least_weight)) / (2.0 * math.pi * plan.coherence.sigma_um)
    of_one, of_terms = (
        [sampling(heightfield, plan, terms=terms) for heightfield in (line, field)] for terms in (8, 16)
    )
    increases = np.subtract(of_terms, of_one)
    expected = 2.0 * radius * np.array([line.size_um[1], 2.0 * radius * math.prod(field.size_um)])
    steps = 18.0 * np.minimum(expected, 1.0)
    parts = 2.0 if plan.method == "jacobi-anger" else 1.0
    np.testing.assert_allclose(increases[1] / increases[0], np.divide(*(steps + parts * expected)[::-1]), rtol=1e-6)


def test_a_look_up_costs_nine_nodes_of_three_channels_for_each_basis_function_of_w():
    """A look-up in a colour table adds nine rows. A row must cost one unit per basis function of w and colour channel.

    A row has the coefficients of one point of the table. w is the normal component of the scattering vector. The table
    stores colours as sums of basis functions of w.

    If a plan states no number of basis functions of w, the table must have as many as the plan has terms, rounded up to
    whole SIMD registers.
    """
    plan = table_plan(noise((6, 16)), wd.Coherence(sigma_um=3.25))
    for size, terms, functions in [(12, 9, 12), (0, 9, 16)]:
        sized = dataclasses.replace(plan, w_basis_size=size, terms=terms)
        assert cost_model.look_up_multiply_adds(sized) == 27.0 * functions
