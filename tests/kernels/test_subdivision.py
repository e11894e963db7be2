"""Subdivision: sums over the cells of a split pixel."""

import numpy as np
import pytest
import warp as wp

from warpdiff.kernels import subdivision


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


@pytest.mark.parametrize("level", [1, 2])
def test_cells_add_up_by_the_filter_along_rows_and_columns(level, rng):
    """Pixel 5 of nine is split; one cell after the other is lit, meets nothing, or is not lit."""
    across = 2**level
    weights = rng.uniform(size=(3, across))
    for cell in range(across**2):
        colours = rng.uniform(size=(across**2, 3)).astype(np.float32)
        hit, gains = np.ones(across**2, dtype=int), np.ones(across**2)
        kind = cell % 3
        hit[cell], gains[cell] = kind != 1, kind != 2
        before = rng.uniform(size=(9, 3)).astype(np.float32)
        sums, means = wp.zeros((9, 9), dtype=wp.vec4f, device="cpu"), wp.zeros(9, dtype=wp.vec3f, device="cpu")
        difference = wp.zeros(9, dtype=wp.float32, device="cpu")
        levels = wp.zeros(9, dtype=wp.uint8, device="cpu")
        has_edge = wp.zeros(9, dtype=wp.bool, device="cpu")
        inputs = [
            array(colours, wp.vec3f), array(hit, wp.int32), array(gains, wp.float32), array([5], wp.int32),
            array(before, wp.vec3f), array(np.full(9, 1e-6), wp.float32), array([], wp.int32),
            array(weights.ravel(), wp.float32), level, 0, 1,
        ]  # fmt: skip
        outputs = [sums, means, difference, levels, has_edge]
        wp.launch(subdivision.splat_cells, (1, 1), inputs, outputs, device="cpu")
        values = np.column_stack([colours, np.ones(across**2)]) * hit[:, None]
        expected = np.einsum("ir,jc,rcx->ijx", weights, weights, values.reshape(across, across, 4))
        np.testing.assert_allclose(sums.numpy()[5], expected.reshape(9, 4), rtol=1e-5)
        mean = values[:, :3].mean(axis=0)
        np.testing.assert_allclose(means.numpy()[5], mean, rtol=1e-5)
        if level == 1:
            assert difference.numpy()[5] == pytest.approx(np.linalg.norm(mean - before[5]), rel=1e-4)
        assert has_edge.numpy()[5] == (kind > 0)
        assert levels.numpy().tolist() == 5 * [0] + [level] + 3 * [0]


def test_each_pixel_of_all_threads_gets_a_lights_share_once(rng):
    colours, others = rng.uniform(size=(2, 12, 3))
    errors, other_errors = rng.uniform(size=(2, 12))
    illuminated, others_illuminated = rng.uniform(size=(2, 12)) < 0.5
    inputs = [array(colours, wp.vec3f), array(errors, wp.float32), array(illuminated, wp.bool), 1, 5]
    outputs = [array(others, wp.vec3f), array(other_errors, wp.float32), array(others_illuminated, wp.bool)]
    wp.launch(subdivision.accumulate, (2, 1), inputs, outputs, device="cpu")
    # The first pixel and the last one belong to no thread.
    share = np.arange(12) % 11 > 0
    np.testing.assert_allclose(outputs[0].numpy(), others + share[:, None] * colours, rtol=1e-6)
    np.testing.assert_allclose(outputs[1].numpy(), other_errors + share * errors, rtol=1e-6)
    np.testing.assert_array_equal(outputs[2].numpy(), others_illuminated | (share & illuminated))
