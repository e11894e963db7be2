"""Kernels that list tiles (subdivided pixels), and the floor of luminance, the smallest divisor of relative errors."""

import numpy as np
import pytest
import warp as wp
from conftest import launch

from warpdiff.kernels import tile_lists


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
