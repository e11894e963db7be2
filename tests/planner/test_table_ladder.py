"""Choice of the table size with closed-form errors: the smallest sufficient table, in few steps.

A table stores colours on rings, and interpolates between rings. A ring is a circle of constant |(u, v)|, and w is the
normal component of the scattering vector (u, v, w). A colour is a sum of basis functions of w. The size of a table is
its number of rings per octave (factor of two in |(u, v)|/λ). A table is sufficient if its error is at most the target.
"""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.planner import cost_model, table_ladder
from warpdiff.tables import mip_layout, polar_grid

TOLERANCE, TARGET = 1e-2, 1e-2 / 1.6
SIZES = dict(polar_grid.TABLE_SIZES)
# Size of the colour table that the search tries first at ``TOLERANCE``: number of rings per factor of two in |(u, v)|.
FIRST = 48


@pytest.fixture(scope="module")
def plan(fingers):
    options = {"method": "low-rank", "tolerance": TOLERANCE, "coherence": wd.Coherence(sigma_um=3.25)}
    result = wd.plan(fingers, [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], **options)
    return dataclasses.replace(result, terms=8)


class Tables:
    """Stand-in for a trial of colour tables. The error is a closed form, by default of second order in ring spacing.

    Tables with at least ``sufficient`` rings per octave meet the target, the largest accepted error. For plans without
    a table, the function ``sampled`` returns the error as a function of the number of basis terms, by which a plan
    expands Fourier coefficients.
    """

    validation_set = range(5)

    def __init__(self, heightfield, plan, sufficient=0, *, bright=math.inf, law=None, sampled=lambda _terms: 0.0):
        self.heightfield, self.reference, self.bright = heightfield, plan, (bright, bright)
        self._law = law or (lambda table: 0.99 * TARGET * (sufficient / table.rings_per_octave) ** 2)
        self._sampled, self.tried = sampled, []

    def validation_error(self, plan):
        self.tried.append(plan)
        return self._law(plan) if plan.rings_per_octave else self._sampled(plan.terms)

    def with_w_basis(self, plan):
        return dataclasses.replace(plan, w_basis_size=plan.w_basis_size or 8)

    def most_terms(self, _plan):
        return 32

    def fitted(self, _plan):
        return SimpleNamespace(truncation_errors=10.0 ** (-np.arange(33) / 4.0))

    def update_floors(self, plan):
        pass

    def smallest(self, **options):
        defaults = {"footprint": False, "needed": False, "affordable": math.inf}
        return table_ladder.smallest_table(self.reference, self, **defaults | options)


def cost(trial, rings):
    sized = dataclasses.replace(
        trial.reference, rings_per_octave=rings, azimuths_per_width=SIZES[rings], w_basis_size=8
    )
    return cost_model.table_multiply_adds(trial.heightfield, sized), mip_layout.megabytes(sized)


@pytest.mark.parametrize(("sufficient", "count"), [(16, 1), (32, 1), (48, 1), (64, 2), (96, 2), (128, 3)])
def test_the_smallest_sufficient_table_is_found_in_few_steps(fingers, plan, sufficient, count):
    """The search must find the smallest colour table that meets the target error, in few steps.

    The size of a table is its number of rings (circles of constant |(u, v)|). Each tried table has at most twice the
    rings of the previous one, and no table smaller than the first one is tried.
    """
    trial = Tables(fingers, plan, sufficient)
    table = trial.smallest()
    assert table.rings_per_octave == max(sufficient, FIRST)
    assert table.azimuths_per_width == SIZES[table.rings_per_octave]
    sizes = [tried.rings_per_octave for tried in trial.tried if tried.rings_per_octave]
    assert len(set(sizes)) == count
    assert max(np.divide(sizes[1:], sizes[:-1]), default=1.0) <= 2.0
    assert table.error == pytest.approx(1.6 * trial.validation_error(table))
    assert (table.is_measured, table.validation_size, table.footprint) == (True, 5, False)
    assert (table.truncation, table.neighbourhood, table.rounding) == (0.0, 0.0, 0.0)
    assert table.table_multiply_adds == cost(trial, table.rings_per_octave)[0]
    assert table.multiply_adds == cost_model.look_up_multiply_adds(table)


def test_few_bright_directions_or_separate_orders_begin_with_a_larger_table(fingers, plan):
    assert Tables(fingers, plan, 16, bright=63).smallest().rings_per_octave == 64
    assert Tables(fingers, plan, 16, bright=64).smallest().rings_per_octave == FIRST
    assert Tables(wd.gratings.sinusoidal(2.0, 0.1), plan, 16).smallest().rings_per_octave == 64


def test_tables_that_miss_the_target_are_used_only_for_footprints_and_explicit_calls(fingers, plan):
    for options, rings in [({}, None), ({"footprint": True}, FIRST), ({"needed": True}, 128)]:
        table = Tables(fingers, plan, 500).smallest(**options)
        assert (table and table.rings_per_octave) == rings


def test_a_footprint_or_an_explicit_call_begins_in_the_middle_where_no_size_is_expected_to_suffice(fingers, plan):
    tight = dataclasses.replace(plan, tolerance=1e-4)
    assert Tables(fingers, tight, law=lambda _table: 0.0).smallest() is None
    for options in ({"footprint": True}, {"needed": True}):
        assert Tables(fingers, tight, law=lambda _table: 0.0).smallest(**options).rings_per_octave == 32


def test_tables_that_cost_too_much_are_not_made(fingers, plan):
    trial = Tables(fingers, plan, 64)
    least, more = cost(trial, FIRST)[0], cost(trial, 64)[0]
    assert trial.smallest(affordable=0.99 * least) is None
    assert not trial.tried
    assert trial.smallest(affordable=0.99 * more) is None
    # A call that needs a colour table must get the largest one whose cost is at most ``affordable``.
    assert trial.smallest(affordable=0.99 * least, needed=True).rings_per_octave == 32
    assert trial.smallest(affordable=0.99 * more, needed=True).rings_per_octave == FIRST
    assert trial.smallest(affordable=0.99 * cost(trial, 12)[0], needed=True).rings_per_octave == 8
    assert trial.smallest(affordable=0.99 * cost(trial, 8)[0], needed=True) is None


def test_the_largest_table_is_the_largest_that_fits_into_memory(fingers, plan, monkeypatch):
    trial = Tables(fingers, plan, 500)
    for rings, next_rings in [(16, 24), (96, 128)]:
        monkeypatch.setattr(polar_grid, "MOST_MEGABYTES", 0.5 * (cost(trial, rings)[1] + cost(trial, next_rings)[1]))
        assert trial.smallest(needed=True).rings_per_octave == rings


@pytest.mark.parametrize(("richer", "expected"), [(0.6, (64, 12)), (0.8, None)])
def test_more_functions_of_w_are_tried_where_rings_do_not_help(fingers, plan, richer, expected):
    """If more rings do not reduce the error, a table with more basis functions of w must be tried.

    If the second table does not meet the target either, the search must end without a table. Rings are circles of
    constant |(u, v)|, at which a table has colours as functions of w.
    """
    trial = Tables(fingers, plan, law=lambda table: 1.5 * TARGET * (richer if table.w_basis_size > 8 else 1.0))
    table = trial.smallest()
    assert (table and (table.rings_per_octave, table.w_basis_size)) == expected
    tables = [tried for tried in trial.tried if tried.rings_per_octave]
    assert [(tried.rings_per_octave, tried.w_basis_size) for tried in tables] == [(48, 8), (64, 8), (64, 12)]


def test_more_functions_of_w_are_tried_where_rings_help_by_less_than_their_order(fingers, plan):
    """If twice as many rings do not divide the error by 4, a table with more basis functions of w must be tried.

    Errors of interpolation between rings are of second order. A smaller improvement shows that the basis functions of w
    limit the accuracy.
    """
    law = {(48, 8): 2.9, (96, 8): 1.6, (96, 12): 0.9}
    trial = Tables(fingers, plan, law=lambda table: TARGET * law[table.rings_per_octave, table.w_basis_size])
    table = trial.smallest()
    assert (table.rings_per_octave, table.w_basis_size) == (96, 12)


def test_the_last_table_is_tried_with_more_functions_of_w(fingers, plan):
    def law(table):
        return TARGET * max(30.0 * (24 / table.rings_per_octave) ** 2, 1.1) * (0.8 if table.w_basis_size > 8 else 1.0)

    table = Tables(fingers, plan, law=law).smallest(needed=True)
    assert (table.rings_per_octave, table.w_basis_size) == (128, 12)


def test_the_fewest_terms_whose_expected_error_is_within_half_of_the_target_are_used(fingers, plan):
    """The colour table must have the smallest number of basis terms whose expected error is at most half of the target.

    The target is the largest accepted error. The terms are those of the functions that expand Fourier coefficients.

    With 8 terms, the measured error equals the target. The residuals of the fit of the basis functions predict that 10
    terms reduce this error by a factor of 3.2.
    """
    several = dataclasses.replace(plan, terms=24)
    trial = Tables(fingers, several, law=lambda _table: 0.5 * TARGET, sampled=lambda _terms: TARGET)
    table = trial.smallest()
    assert table.terms == 10
    assert table.truncation == pytest.approx(TARGET / math.sqrt(10.0))
    assert table.truncation + table.quadrature == pytest.approx(0.8 * TARGET)
    assert [(tried.terms, tried.rings_per_octave) for tried in trial.tried] == [(8, 0), (10, FIRST)]


@pytest.mark.parametrize(("sampled", "terms", "rings"), [(0.8, 14, FIRST), (0.6, 14, 64), (0.4, 10, 64)])
def test_terms_are_added_once_if_sampling_with_them_misses_its_half_of_the_target(fingers, plan, sampled, terms, rings):
    """If the first colour table fails because it has too few basis terms, the next table must have more terms.

    The first table has 10 terms, by an estimate. If it fails, a plan with 10 terms but without a table is tried. If the
    error of that plan exceeds half of the target (largest accepted error), terms are added. If it also exceeds half of
    the error of the first table, the terms cause most of the table's error, and the next table has the same size.
    Otherwise the next table is larger.
    """

    def law(table):
        return TARGET * (1.5 if table.terms == 10 and table.rings_per_octave == FIRST else 0.5)

    several = dataclasses.replace(plan, terms=24)
    trial = Tables(fingers, several, law=law, sampled=lambda count: TARGET * (1.0 if count == 8 else sampled))
    table = trial.smallest()
    assert (table.terms, table.rings_per_octave) == (terms, rings)
    assert sum(not tried.rings_per_octave for tried in trial.tried) == 2
