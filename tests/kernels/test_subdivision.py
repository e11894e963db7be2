"""Subdivision of pixels: filtered sums over subpixel cells, and the choice of levels.

A tile is a pixel that is divided into subpixel cells. At level n, a tile has 2ⁿ × 2ⁿ cells.
"""

import numpy as np
import pytest
import warp as wp
from conftest import launch

from warpdiff.kernels import refinement_levels, subdivision


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


@pytest.mark.parametrize("level", [1, 2])
@pytest.mark.parametrize("is_base", [True, False])
def test_cells_add_up_by_the_filter_along_rows_and_columns(level, is_base, rng):
    """Filtered sums over the cells of a subdivided pixel must equal explicit sums.

    Pixel 5 of 9 pixels is subdivided. In each round of the loop, one of its cells is illuminated, misses the mesh, or
    is dark. All other cells are illuminated.
    """
    across = 2**level
    weights = rng.uniform(size=(3, across))
    for cell in range(across**2):
        colours = rng.uniform(size=(across**2, 3)).astype(np.float32)
        hit, gains = np.ones(across**2, dtype=int), np.ones(across**2)
        kind = cell % 3
        hit[cell], gains[cell] = kind != 1, kind != 2
        before = rng.uniform(size=(9, 3)).astype(np.float32)
        sums, quadrants = wp.zeros((9, 9), dtype=wp.vec4f, device="cpu"), wp.zeros((9, 4), dtype=wp.vec3f, device="cpu")
        changes = wp.zeros(9, dtype=wp.float32, device="cpu")
        levels, lighting = (wp.zeros(9, dtype=wp.uint8, device="cpu") for _ in range(2))
        inputs = [
            array(colours * gains[:, None], wp.vec3f), array(hit, wp.int32), array([5], wp.int32),
            array(before, wp.vec3f), array([], wp.int32), array(weights.ravel(), wp.float32), level, is_base, False,
            0, 1,
        ]  # fmt: skip
        outputs = [sums, quadrants, changes, levels, lighting]
        launch(subdivision.splat_cells, (1, 1), inputs, outputs, device="cpu")
        values = (np.column_stack([colours * gains[:, None], np.ones(across**2)]) * hit[:, None]).reshape(
            across, across, 4
        )
        expected = np.einsum("ir,jc,rcx->ijx", weights, weights, values)
        np.testing.assert_allclose(sums.numpy()[5], expected.reshape(9, 4), rtol=1e-5)
        half = across // 2
        means = values[..., :3].reshape(2, half, 2, half, 3).mean(axis=(1, 3)).reshape(4, 3)
        np.testing.assert_allclose(quadrants.numpy()[5], is_base * means, rtol=1e-5)
        change = np.linalg.norm(means.mean(axis=0) - before[5])
        assert changes.numpy()[5] == pytest.approx(is_base * change, rel=1e-4)
        assert lighting.numpy()[5] == (1, 1 | 4, 1 | 2)[kind]
        assert levels.numpy().tolist() == 5 * [0] + [level] + 3 * [0]


@pytest.mark.parametrize("level", [2, 3])
def test_the_scatter_of_samples_follows_from_squares_of_four_cells(level, rng):
    """The scatter of a pixel is the standard deviation of its mean over samples of a light.

    The kernel's scatter of a subdivided pixel must equal that from the variances within 2 × 2 cells. Cells that miss
    the mesh do not add to the variance. In this test, one square of 2 × 2 cells misses the mesh completely.
    """
    across = 2**level
    colours, hit = rng.lognormal(size=(across, across, 3)).astype(np.float32), rng.uniform(size=(across, across)) < 0.8
    hit[:2, :2] = False
    changes = wp.zeros(9, dtype=wp.float32, device="cpu")
    inputs = [
        array(colours.reshape(-1, 3), wp.vec3f), array(hit.ravel(), wp.int32), array([5], wp.int32),
        array(np.zeros((9, 3)), wp.vec3f), array([], wp.int32), array(np.ones(3 * across), wp.float32), level,
        level == 2, True, 0, 1,
    ]  # fmt: skip
    unread = [wp.zeros((9, size), dtype=dtype, device="cpu") for size, dtype in ((9, wp.vec4f), (4, wp.vec3f))]
    outputs = [*unread, changes, *(wp.zeros(9, dtype=wp.uint8, device="cpu") for _ in range(2))]
    launch(subdivision.splat_cells, (1, 1), inputs, outputs, device="cpu")
    square = 0.0
    for row in range(0, across, 2):
        for column in range(0, across, 2):
            cells = colours[row : row + 2, column : column + 2][hit[row : row + 2, column : column + 2]]
            square += len(cells) * np.var(cells, axis=0, ddof=1).sum() if len(cells) > 1 else 0.0
    expected = np.sqrt(square) / across**2
    assert changes.numpy()[5] == pytest.approx(expected, rel=1e-4)
    # Equal colours have no variance, even if some subpixel cells miss the mesh.
    inputs[0] = array(np.ones((across**2, 3)), wp.vec3f)
    launch(subdivision.splat_cells, (1, 1), inputs, outputs, device="cpu")
    assert changes.numpy()[5] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("level", [2, 3])
def test_the_level_of_a_tile_rises_if_its_scatter_causes_an_error_above_the_tolerance(level, rng):
    """A pixel at level n has 2ⁿ × 2ⁿ cells. Its level must rise if the scatter causes an error above the tolerance.

    The scatter is the standard deviation of the pixel's mean over random directions to the light. Only the levels of
    pixels that were shaded last, which are at ``level``, may change.
    """
    height, width, floor, tolerance, most = 7, 9, 0.5, 0.05, 5
    shaded = rng.choice([level - 1, level], (height, width), p=[0.3, 0.7])
    scatter = rng.lognormal(-2.5, 1.5, (height, width)).astype(np.float32)
    colours = rng.lognormal(size=(height, width, 3)).astype(np.float32)
    errors = rng.lognormal(-2.0, 1.5, (height, width)).astype(np.float32)
    marks = rng.uniform(size=(height, width)) < 0.8
    sums = subdivision.FilteredSums()
    sums.changes = array(scatter.ravel(), wp.float32)
    levels = array(shaded.ravel().astype(np.uint8), wp.uint8)
    inputs = [
        sums, array([], wp.int32), array(marks.ravel(), wp.uint8), array(colours.reshape(-1, 3), wp.vec3f),
        array(errors.ravel(), wp.float32), width, height, array([floor], wp.float32), tolerance, level, most, 0,
        height * width,
    ]  # fmt: skip
    launch(subdivision.raise_levels, (1, 1), inputs, [levels], device="cpu")
    shares = np.outer(refinement_levels.FILTER_SHARES, refinement_levels.FILTER_SHARES)
    expected = shaded.copy()
    for row, column in zip(*np.nonzero(shaded == level), strict=True):
        near = [(y, x) for y in range(row - 1, row + 2) for x in range(column - 1, column + 2)]
        near = [(y, x, shares[y - row + 1, x - column + 1]) for y, x in near if 0 <= y < height and 0 <= x < width]
        own = scatter[row, column]
        if level == 2:
            values, weights = np.array([(scatter[y, x], share) for y, x, share in near]).T
            own = np.sqrt(np.average(values**2, weights=weights))
        own *= refinement_levels.SCATTER_CAUTION * refinement_levels.SCATTER_FACTOR
        excesses = [
            min(errors[y, x], share * own) / max(np.linalg.norm(colours[y, x]), floor) / tolerance
            for y, x, share in near
            if marks[y, x]
        ]
        excess = max(excesses, default=0.0)
        expected[row, column] = min(level + int(np.floor(np.log2(max(excess, 1.0)) + 0.5)), most)
    assert {level - 1, level, 4, 5} <= set(expected.ravel())
    np.testing.assert_array_equal(levels.numpy().reshape(height, width), expected)


def test_the_level_of_a_tile_in_the_first_column_ignores_the_end_of_the_row_above():
    """The level of a pixel must not depend on a pixel of the last column, if it is itself in the first column.

    In memory, the last pixel of a row is directly before the first pixel of the next row. Here, only the last pixel of
    the first row has a mark and a large error. The level of its neighbour to the left must rise.
    """
    sums = subdivision.FilteredSums()
    sums.changes = array(np.ones(8), wp.float32)
    levels = array(np.full(8, 3), wp.uint8)
    inputs = [
        sums, array([], wp.int32), array(np.arange(8) == 3, wp.uint8), array(np.ones((8, 3)), wp.vec3f),
        array(np.full(8, 10.0), wp.float32), 4, 2, array([0.5], wp.float32), 0.01, 3, 6, 0, 8,
    ]  # fmt: skip
    launch(subdivision.raise_levels, (1, 1), inputs, [levels], device="cpu")
    rises = levels.numpy().reshape(2, 4) > 3
    np.testing.assert_array_equal(rises, np.tile([False, False, True, True], (2, 1)))


def test_a_single_listed_pixel_is_resolved(rng):
    """If only one pixel is listed, the kernel must set only this pixel, to the sum over its nine tiles."""
    sums = subdivision.FilteredSums()
    filtered = rng.uniform(size=(12, 9, 4))
    sums.filtered_sums, sums.changes = array(filtered, wp.vec4f), array(np.ones(12), wp.float32)
    sums.levels, sums.lighting = array(np.ones(12), wp.uint8), array(np.ones(12), wp.uint8)
    sums.filter_normalisation = array(np.ones((2, 3)), wp.float32)
    outputs = [
        wp.zeros(12, dtype=dtype, device="cpu")
        for dtype in (wp.vec3f, wp.float32, wp.float64, wp.uint8, wp.bool, wp.bool)
    ]
    inputs = [sums, array([6], wp.int32), array(np.ones(12), wp.uint8), 4, 3, 1.0, 1.0, 0, 1]
    launch(subdivision.resolve_pixels, (1, 1), inputs, outputs, device="cpu")
    expected = np.zeros((12, 3))
    expected[6] = filtered[[1, 2, 3, 5, 6, 7, 9, 10, 11], np.arange(9), :3].sum(axis=0)
    np.testing.assert_allclose(outputs[0].numpy(), expected, rtol=1e-5)


def levels_by_hand(quadrants, marks, colours, lighting, floor, tolerance, most, share):
    """Return the levels that the kernel ``select_levels`` must compute, and the changes on which they depend.

    The change of a pixel is half the root mean square second difference of the colours of its quadrants, times
    ``share``. At edges of the mesh or of shadows, it is multiplied by a factor. All pixels are subdivided.
    """
    height, width = marks.shape
    cells = quadrants.reshape(height, width, 2, 2, 3).transpose(0, 2, 1, 3, 4).reshape(2 * height, 2 * width, 3)
    square = np.zeros(cells.shape[:2])
    square[1:-1] += np.sum((cells[2:] - 2.0 * cells[1:-1] + cells[:-2]) ** 2, axis=2)
    square[:, 1:-1] += np.sum((cells[:, 2:] - 2.0 * cells[:, 1:-1] + cells[:, :-2]) ** 2, axis=2)
    changes = 0.5 * share * np.sqrt(square.reshape(height, 2, width, 2).mean(axis=(1, 3)))
    levels = np.zeros(marks.shape, dtype=int)
    for row, column in np.ndindex(height, width):
        near = [(y, x) for y in range(row - 1, row + 2) for x in range(column - 1, column + 2)]
        near = [(y, x) for y, x in near if 0 <= y < height and 0 <= x < width]
        shown = {bit for place in near for bit in (1, 2, 4) if lighting[place] & bit}
        if {1} < shown:
            changes[row, column] *= refinement_levels.EDGE_FACTOR
        shares = refinement_levels.FILTER_SHARES
        need = max(
            (shares[row - y + 1] * shares[column - x + 1] / max(np.linalg.norm(colours[y, x]), floor)
             for y, x in near if marks[y, x]), default=0.0,
        )  # fmt: skip
        across = 2.0 * np.sqrt(refinement_levels.CAUTION * need * changes[row, column] / tolerance)
        least = 2 if 4 in shown and shown > {4} else 1
        levels[row, column] = min(max(int(np.floor(np.log2(max(across, 1.0)) + 0.5)), least), most)
    return changes, levels


@pytest.mark.parametrize(("before", "share"), [(1e9, 1.0), (0.0, 0.5)])
def test_levels_follow_from_second_differences_of_colours(before, share, rng):
    """Changes of pixels and their levels must follow from the second differences of the colours of quadrants.

    A change is limited to the range from half of the change by second differences to all of it. ``before`` is the
    change before this limit, which is the difference from the colour by one ray.
    """
    height, width, floor, tolerance = 7, 9, 0.5, 0.05
    quadrants = rng.lognormal(0.0, 1.0, (height, width, 4, 3)).astype(np.float32)
    # Where colours change linearly along a row, a pixel needs no further subdivision: the kernel must not select a
    # higher level.
    x = np.arange(2 * width, dtype=np.float32).reshape(width, 2)
    quadrants[3:] = (1.0 + x[:, [0, 1, 0, 1], None]) * np.array([1.0, 2.0, 3.0], dtype=np.float32)
    marks = rng.uniform(size=(height, width)) < 0.8
    lighting = rng.choice([1, 2, 3, 4, 5], (height, width), p=[0.9, 0.04, 0.02, 0.02, 0.02])
    lighting[3:] = 1
    colours = quadrants.mean(axis=2)
    sums = subdivision.FilteredSums()
    sums.quadrants = array(quadrants.reshape(-1, 4, 3), wp.vec3f)
    sums.lighting = array(lighting.ravel().astype(np.uint8), wp.uint8)
    changes, chosen = array(np.full(height * width, before), wp.float32), array(np.ones(height * width), wp.uint8)
    inputs = [
        sums, array([], wp.int32), array(marks.ravel(), wp.uint8), array(colours.reshape(-1, 3), wp.vec3f),
        width, height, array([floor], wp.float32), tolerance, 1, 6, 2, 0,
        height * width,
    ]  # fmt: skip
    launch(subdivision.select_levels, (1, 1), inputs, [changes, chosen], device="cpu")
    expected, levels = levels_by_hand(quadrants.astype(float), marks, colours, lighting, floor, tolerance, 6, share)
    np.testing.assert_allclose(changes.numpy().reshape(height, width), expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(chosen.numpy().reshape(height, width), levels)
    assert len(np.unique(levels[:2])) > 2
    # Level 1, which is 2 × 2 cells, suffices for a pixel if its colour and those of its neighbours change linearly.
    assert np.all(levels[4:, :] == 1)


def test_threads_add_the_colours_of_a_light_to_each_pixel_once(rng):
    colours, others = rng.uniform(size=(2, 12, 3))
    errors, other_errors = rng.uniform(size=(2, 12))
    illuminated, others_illuminated = rng.uniform(size=(2, 12)) < 0.5
    inputs = [array(colours, wp.vec3f), array(errors, wp.float32), array(illuminated, wp.bool), 1, 5]
    outputs = [array(others, wp.vec3f), array(other_errors, wp.float32), array(others_illuminated, wp.bool)]
    launch(subdivision.accumulate, (2, 1), inputs, outputs, device="cpu")
    # Two threads process the pixels 1 to 10. The pixels 0 and 11 are outside of the ranges of both threads and must not
    # change.
    share = np.arange(12) % 11 > 0
    np.testing.assert_allclose(outputs[0].numpy(), others + share[:, None] * colours, rtol=1e-6)
    np.testing.assert_allclose(outputs[1].numpy(), other_errors + share * errors, rtol=1e-6)
    np.testing.assert_array_equal(outputs[2].numpy(), others_illuminated | (share & illuminated))


def test_shares_of_the_filter_are_integrals_of_a_truncated_gaussian():
    """The shares of the pixel filter in a pixel and in its two neighbours must be integrals of a truncated Gaussian.

    The Gaussian is truncated at 1.5 pixels from its centre.
    """
    place = (np.arange(3000) + 0.5) / 1000.0 - 1.5
    values = np.exp(-0.5 * (place / refinement_levels.FILTER_SIGMA) ** 2).reshape(3, 1000).sum(axis=1)
    np.testing.assert_allclose(refinement_levels.FILTER_SHARES, values / values.sum(), rtol=1e-5)
    assert refinement_levels.FILTER_CUT == 1.5
    beyond = [refinement_levels.share_beyond(distance) for distance in (0.0, 0.5, 1.5)]
    np.testing.assert_allclose(beyond, [0.5, values[2] / values.sum(), 0.0], atol=1e-6)
