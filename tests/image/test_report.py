"""Reports of pictures: shares of converged pixels, and a sentence ("verdict") on whether the tolerance is met."""

import numpy as np
import pytest

from warpdiff.image.report import report_of

ILLUMINATED = np.ones((20, 50), dtype=np.bool_)
EDGES = np.zeros_like(ILLUMINATED)
EDGES[:5] = True


def report(interior, edges, *, refined=True):
    error = np.where(EDGES, np.float32(edges), np.float32(interior))
    return report_of(error, ILLUMINATED, EDGES if refined else None, tolerance=0.1, refined_share=0.5,
                     light_sample_count=1)  # fmt: skip


def test_edges_may_have_three_times_the_error():
    assert report(0.1, 0.1).is_converged
    assert not report(0.3, 0.1).is_converged
    assert report(0.05, 0.3).is_converged
    assert not report(0.05, 0.6).is_converged


def test_the_verdict_names_the_shares_of_unconverged_pixels():
    """The sentence must state the shares of unconverged pixels at edges and in the interior separately.

    Errors at edges may be three times the tolerance.
    """
    met = report(0.05, 0.3)
    assert met.errors[1] > met.tolerance
    assert met.verdict == (
        "The picture meets its tolerance of 0.1: 0.062 % of the interior pixels are expected to exceed it, and 0.99 % "
        "of those at edges three times as much."
    )
    assert report(0.3, 0.1).verdict.startswith("The picture does not meet its tolerance of 0.1 everywhere")


def test_unrefined_pictures_have_no_shares_of_unconverged_pixels():
    unrefined = report(0.3, 0.3, refined=False)
    assert unrefined.verdict.startswith("Pixels were not refined: 99 % of the illuminated pixels")
    assert (unrefined.unconverged_share, unrefined.unconverged_edge_share) == (0.0, 0.0)


def test_errors_are_percentiles_of_illuminated_pixels():
    error = np.arange(1000, dtype=np.float32).reshape(20, 50)
    illuminated = error < 101.0
    result = report_of(error, illuminated, None, tolerance=0.1, refined_share=0.0, light_sample_count=3)
    assert result.errors == pytest.approx((50.0, 99.0))
    assert report_of(
        error, illuminated & False, None, tolerance=0.1, refined_share=0.0, light_sample_count=3
    ).errors == (0, 0)
