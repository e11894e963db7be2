"""Comparison of two pictures: relative errors, their smallest divisor, masks, and the errors of ``image.error``."""

import dataclasses
import json

import numpy as np
import pytest

import warpdiff as wd


@pytest.fixture(scope="module")
def pictures(fingers):
    """Return two pictures of the same view of a tube, rendered with tolerances of 0.1 and 0.01."""
    light, view = wd.DirectionalLight((0.6, 1.0, -0.1)), wd.View((0, 1.5, 4), (0, 0, 0), width=40, height=24)
    body, window = wd.meshes.tube(), wd.Coherence(sigma_um=3.25)
    return [
        wd.shade(body, fingers, light, view, coherence=window, tolerance=tolerance, pigment=0.0)
        for tolerance in (1e-1, 1e-2)
    ]


def test_errors_are_relative_to_the_reference_or_to_a_thousandth_of_its_white(rng):
    exact = rng.uniform(0.2, 1.0, (20, 30, 3))
    exact[:2] = 1e-6
    differences = rng.normal(0.0, 0.01, exact.shape)
    result = wd.compare(exact + differences, exact, tolerance=0.02)
    # Errors are relative to a luminance Y*. It is the larger of two values: the 99th percentile of Y, and the median of
    # Y weighted by Y. In this picture of 600 pixels, Y* is the percentile.
    white = np.sort(exact[..., 1].ravel())[593]
    size = np.maximum(np.linalg.norm(exact, axis=2), 1e-3 * white)
    expected = np.linalg.norm(differences, axis=2) / size
    np.testing.assert_allclose(result.error, expected)
    assert (result.p50, result.p90, result.p99) == pytest.approx(tuple(np.percentile(expected, [50, 90, 99])))
    assert result.share_beyond_tolerance == np.mean(expected > 0.02)
    assert result.reported_share is None
    assert result.luminance_ratio == pytest.approx((exact + differences)[..., 1].sum() / exact[..., 1].sum())


def test_a_picture_meets_its_own_tolerance(pictures):
    result = wd.compare(*pictures)
    assert result.tolerance == 0.1
    assert 1e-3 < result.p50 < result.p90 < result.p99 < 0.2
    assert result.share_beyond_tolerance < 0.1
    assert result.luminance_ratio == pytest.approx(1.0, abs=0.02)
    assert not result.pixels[~pictures[1].illuminated].any()
    assert json.loads(json.dumps(result.as_dict()))["p99"] == result.p99
    assert wd.compare(pictures[0], pictures[0]).p99 == 0.0


def test_the_share_of_wrong_pixels_that_the_picture_reports(pictures):
    image, reference = pictures
    wrong = image.xyz.copy()
    rows, columns = np.nonzero(reference.illuminated)
    wrong[rows[:4], columns[:4]] = 50.0
    error = np.where(np.arange(image.error.size).reshape(image.error.shape) == rows[1] * 40 + columns[1], 9.0, 0.0)
    pixels = np.zeros(reference.mask.shape, dtype=bool)
    pixels[rows[:4], columns[:4]] = True
    result = wd.compare(dataclasses.replace(image, xyz=wrong, error=error), reference, pixels=pixels)
    assert result.share_beyond_tolerance == 1.0
    assert result.reported_share == 0.25


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"image": np.ones((3, 4, 3))}, "tolerance is required"),
        ({"image": np.ones((3, 4, 3)), "tolerance": 0.0}, "tolerance must be"),
        ({"image": np.ones((4, 3, 3)), "tolerance": 0.1}, r"same size, got 3 × 4 and 4 × 3 pixels"),
        ({"image": np.ones((3, 4)), "tolerance": 0.1}, r"image must be an Image or linear XYZ .* got shape \(3, 4\)"),
        ({"image": np.full((3, 4, 3), np.nan), "tolerance": 0.1}, "image"),
        ({"image": np.ones((3, 4, 3)), "tolerance": 0.1, "pixels": [True]}, r"pixels must have the shape \(3, 4\)"),
        ({"image": np.ones((3, 4, 3)), "tolerance": 0.1, "pixels": np.zeros((3, 4))}, "no pixel is compared"),
    ],
)
def test_refusals_name_the_argument(arguments, message):
    with pytest.raises(ValueError, match=message):
        wd.compare(reference=np.ones((3, 4, 3)), **arguments)
