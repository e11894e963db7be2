"""Selection of the directions that the planner evaluates, among all directions of a call."""

import numpy as np
import pytest

from warpdiff.request.directions import sample_ranks, stratified


@pytest.mark.parametrize("count", [0, 5, 4095, 4096, 20_000, 300_000])
def test_at_most_half_of_a_large_call_is_sampled(count):
    ranks = sample_ranks(count)
    assert np.all(np.diff(ranks) > 0)
    if count < 4096:
        np.testing.assert_array_equal(ranks, np.arange(count))
    else:
        assert 2000 < len(ranks) <= min(count // 2, 8192)


def test_samples_of_a_picture_are_in_different_columns():
    columns = stratified(512 * 512, 512) % 512
    assert len(np.unique(columns)) > 250
    assert abs(np.corrcoef(np.arange(len(columns)), columns)[0, 1]) < 0.2
