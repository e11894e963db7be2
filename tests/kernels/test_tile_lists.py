"""Kernels that list tiles (subdivided pixels), and the floor of luminance, the smallest divisor of relative errors."""

import numpy as np
import pytest
import warp as wp
from conftest import launch
from scipy import ndimage

from warpdiff.kernels import pixel_contrast, tile_lists


@pytest.mark.parametrize("count", [0, 1, 7, 99, 100, 101, 5000])
@pytest.mark.parametrize("octaves", [0.0, 0.01, 60.0])
def test_the_luminance_floor_is_0_001_of_the_99th_percentile(count, octaves, rng):
    luminance = 2.0 ** rng.uniform(-octaves, octaves, 2 * count + 3)
    illuminated = np.zeros(len(luminance), dtype=np.bool_)
    illuminated[rng.permutation(len(illuminated))[:count]] = True
    colours = wp.array(np.stack([luminance * 1e9, luminance, luminance], axis=1), dtype=wp.vec3f, device="cpu")
    flags = wp.array(illuminated, dtype=wp.bool, device="cpu")
    tallies = wp.zeros(tile_lists.GROUPS * (1 + tile_lists.BINS), dtype=wp.int32, device="cpu")
    floor = wp.empty(1, dtype=wp.float32, device="cpu")
    launch(
        tile_lists.luminance_histogram, dim=1, inputs=[colours, flags, 0, len(illuminated)], outputs=[tallies],
        device="cpu",
    )  # fmt: skip
    launch(tile_lists.luminance_floor, dim=1, inputs=[tallies], outputs=[floor], device="cpu")
    bright = np.sort(luminance[illuminated])
    # The 99th percentile is the luminance that 1 % of the illuminated pixels exceed; the number of these pixels is
    # rounded down.
    expected = 1e-3 * bright[-1 - count // 100] if count else 0.0
    assert floor.numpy()[0] == pytest.approx(expected, rel=1.0 / 128.0, abs=2e-38)


def launched(kernel, inputs, output):
    """Launch a kernel with two threads of five indices each, from index 1 on, and return its output."""
    result = wp.array(output, device="cpu")
    launch(kernel, dim=2, inputs=[*inputs, 1, 5], outputs=[result], device="cpu")
    return result.numpy()


def test_marks_are_counted_dilated_and_completed_as_by_numpy(rng):
    """Kernels must process exactly the pixels 1 to 10 of 12, which are the indices of their threads.

    Marked pixels and their neighbours get a level. Pixels without a mark are ``SHARED`` if they and all their
    neighbours have a level.
    """
    width, height = 4, 3
    for count in range(1, 5):
        marks = np.zeros(12, dtype=np.uint8)
        marks[rng.permutation(12)[:count]] = pixel_contrast.ACTIVE
        device = wp.array(marks, dtype=wp.uint8, device="cpu")
        number = launched(tile_lists.count_marks, [device], np.array([7], dtype=np.int32))
        assert number[0] == 7 + np.count_nonzero(marks[1:11])
        near = ndimage.maximum_filter(marks.reshape(height, width), 3, mode="constant").ravel() > 0
        levels = launched(tile_lists.dilate_marks, [device, width, height, wp.uint8(3)], np.full(12, 9, dtype=np.uint8))
        np.testing.assert_array_equal(levels, [9, *np.where(near, 3, 0)[1:11], 9])
        is_inside = ndimage.minimum_filter(near.reshape(height, width), 3, mode="nearest").ravel()
        shared = launched(
            tile_lists.mark_shared, [wp.array(near.astype(np.uint8), dtype=wp.uint8, device="cpu"), width, height],
            marks,
        )  # fmt: skip
        expected = np.where((marks == 0) & is_inside, pixel_contrast.SHARED, marks)
        np.testing.assert_array_equal(shared, [marks[0], *expected[1:11], marks[11]])
        levels = wp.array(np.where(near, 3, 1).astype(np.uint8), dtype=wp.uint8, device="cpu")
        places, number = np.full(12, -5, dtype=np.int32), wp.array([2], dtype=wp.int32, device="cpu")
        listed = wp.array(places, dtype=wp.int32, device="cpu")
        launch(
            tile_lists.compact_level, dim=2, inputs=[levels, wp.uint8(3), 1, 5], outputs=[listed, number], device="cpu"
        )
        found = 1 + np.flatnonzero(near[1:11])
        assert number.numpy()[0] == 2 + len(found)
        np.testing.assert_array_equal(np.sort(listed.numpy()[2 : 2 + len(found)]), found)


@pytest.mark.parametrize(("listed", "copied"), [(9, 0), (9, 3), (9, 8), (3, 3)])
def test_batches_are_the_next_pixels_of_a_list(listed, copied):
    pixels = wp.array(np.arange(100, 120), dtype=wp.int32, device="cpu")
    counts, begin = (wp.array([number], dtype=wp.int32, device="cpu") for number in (listed, copied))
    batch = launched(tile_lists.copy_batch, [pixels, counts, begin], np.full(12, 77, dtype=np.int32))
    expected = [100 + copied + k if copied + k < listed else -1 for k in range(1, 11)]
    np.testing.assert_array_equal(batch, [77, *expected, 77])
    has_more = wp.array([5], dtype=wp.int32, device="cpu")
    launch(tile_lists.advance_batch, dim=1, inputs=[counts, 4], outputs=[begin, has_more], device="cpu")
    assert (begin.numpy()[0], has_more.numpy()[0]) == (copied + 4, int(copied + 4 < listed))


@pytest.mark.parametrize(("begins", "expected"), [(True, 3), (False, 5)])
def test_the_largest_count_begins_again_for_each_picture(begins, expected):
    most = wp.array([5], dtype=wp.int32, device="cpu")
    counts = wp.array([3], dtype=wp.int32, device="cpu")
    launch(tile_lists.running_max, dim=1, inputs=[counts, begins], outputs=[most], device="cpu")
    assert most.numpy()[0] == expected
