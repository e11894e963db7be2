"""Height fields: the class, cropping, orientation, and invalid arguments."""

import math
import weakref
from typing import Any

import numpy as np
import pytest
from conftest import noise

from warpdiff import gratings
from warpdiff.heightfield.field import HeightField


def test_a_height_field_has_a_read_only_copy_of_the_heights() -> None:
    heights = 0.1 * np.arange(6.0).reshape(2, 3)
    field = HeightField(heights, (0.5, 0.25))
    heights[0, 0] = 9.0
    assert field.heights_um[0, 0] == 0.0
    assert field.heights_um.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        field.heights_um[0, 0] = 1.0
    with pytest.raises(AttributeError):
        field.pitch_um = (1.0, 1.0)  # type: ignore[misc]
    assert (field.shape, field.pitch_um, field.size_um) == ((2, 3), (0.5, 0.25), (1.0, 0.75))


def test_a_height_field_is_compared_by_identity_and_can_be_a_weak_key() -> None:
    first, second = noise((2, 3)), noise((2, 3))
    assert first != second
    assert weakref.WeakKeyDictionary({first: 1, second: 2})[second] == 2
    assert repr(noise((2, 3)).levelled(0)).startswith(
        "HeightField(2 × 3 samples (y × x), pitch 0.1 × 0.05 µm, size 0.2 × 0.15 µm, height range 0."
    )
    assert "\n" not in repr(first)


def test_range_rms_and_slope_have_closed_forms() -> None:
    sine = gratings.sinusoidal(2.0, 0.2, samples=2000)
    assert sine.height_range_um == pytest.approx(0.2)
    assert sine.rms_um == pytest.approx(0.1 / math.sqrt(2.0))
    assert sine.rms_slope == pytest.approx(0.1 * math.pi / math.sqrt(2.0), rel=2e-3)
    plane = HeightField(np.add.outer(0.3 * np.arange(5) * 0.1, 0.4 * np.arange(7) * 0.2), (0.1, 0.2))
    assert plane.rms_slope == pytest.approx(0.5)
    assert HeightField([[1.0]], 1.0).rms_slope == 0.0


def test_cropping_selects_the_requested_samples() -> None:
    field = noise((20, 30), (0.1, 0.2))
    middle = field.cropped((1.0, 2.0))
    np.testing.assert_array_equal(middle.heights_um, field.heights_um[5:15, 10:20])
    corner = field.cropped((0.52, 1.58), offset_um=(0.31, 0.0))
    np.testing.assert_array_equal(corner.heights_um, field.heights_um[3:8, 0:8])
    np.testing.assert_array_equal(field.cropped(field.size_um).heights_um, field.heights_um)
    assert gratings.sinusoidal(2.0, 0.1).cropped(1.0).shape == (1, 32)


def test_flipping_reverses_one_axis() -> None:
    field = noise((3, 4))
    np.testing.assert_array_equal(field.flipped("x").heights_um, field.heights_um[:, ::-1])
    np.testing.assert_array_equal(field.flipped("y").heights_um, field.heights_um[::-1])
    for axis in ("y", "x"):
        assert field.flipped(axis).pitch_um == field.pitch_um
        np.testing.assert_array_equal(field.flipped(axis).flipped(axis).heights_um, field.heights_um)


def test_rotation_is_counter_clockwise_seen_from_the_light() -> None:
    blaze = HeightField(gratings.blazed(2.0, 0.3, samples=8).heights_um, (0.5, 0.25))
    quarter = blaze.rotated()
    # The blazed grating rises along x before the rotation, and along y after it.
    np.testing.assert_array_equal(quarter.heights_um[:, 0], blaze.heights_um[0])
    assert (quarter.pitch_um, quarter.size_um) == ((0.25, 0.5), (2.0, 0.5))
    assert quarter.heights_um.flags.c_contiguous
    np.testing.assert_array_equal(blaze.rotated(2).heights_um, blaze.heights_um[:, ::-1])
    # The rotation moves a height sample at (x, y) to (−y, x).
    field = noise((3, 4))
    np.testing.assert_array_equal(field.rotated(1).heights_um[2], field.heights_um[::-1, 2])
    np.testing.assert_array_equal(field.rotated(-3).heights_um, field.rotated(1).heights_um)
    np.testing.assert_array_equal(field.rotated(3).rotated(1).heights_um, field.heights_um)
    assert field.rotated(4).pitch_um == field.pitch_um


@pytest.mark.parametrize(("turns", "direction"), [(0, 20.0), (1, -70.0), (2, 20.0), (-1, -70.0)])
def test_rotation_turns_the_direction_of_a_period(turns: int, direction: float) -> None:
    y, x = np.meshgrid(np.arange(120) * 0.1, np.arange(150) * 0.08, indexing="ij")
    along = math.cos(math.radians(20.0)) * x + math.sin(math.radians(20.0)) * y
    field = HeightField(0.1 * np.cos(2.0 * np.pi * along / 1.3), (0.1, 0.08))
    (period,) = field.rotated(turns).periods(1)
    assert (period.period_um, period.direction_deg) == pytest.approx((1.3, direction), abs=1e-3)


def test_missing_samples_move_with_the_others() -> None:
    field = HeightField([[0.0, np.nan, 0.1]], (0.2, 0.1))
    np.testing.assert_array_equal(field.flipped("x").missing, [[False, True, False]])
    np.testing.assert_array_equal(field.rotated().missing, [[False], [True], [False]])


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [(lambda _: HeightField("scan.png", 0.1), TypeError, "heights_um must be an array"),
     (lambda f: f.despiked(0.0), ValueError, "threshold must be a finite number, more than 0"),
     (lambda f: f.despiked(size_um=-1.0), ValueError, "size_um must be a finite number, more than 0"),
     (lambda f: f.cropped((1.0, 1e-3)), ValueError, "size_um along x must be from 0.2 to 6, got 0.001"),
     (lambda f: f.cropped(1.0, offset_um=(0.0, 5.5)), ValueError, "offset_um along x must be from 0 to 5"),
     (lambda f: f.cropped(1.0, offset_um=(-0.1, 0)), ValueError, "offset_um along y must be from 0 to 1"),
     (lambda f: f.cropped(1.0, offset_um=1.0), ValueError, r"offset_um must be a pair \(y, x\) or None"),
     (lambda f: f.resampled(0.0), ValueError, "pitch_um must be a finite number, more than 0"),
     (lambda f: f.resampled((0.1, 20.0)), ValueError, "pitch_um along x must be at most the size 6"),
     (lambda f: f.periods(0), ValueError, "count must be an integer, at least 1")],
)  # fmt: skip
def test_invalid_arguments_are_refused_by_their_name(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(noise((20, 30), (0.1, 0.2)))
