"""Ladders of tables for dots with different pitch scales: windows of the tables, and weights of the interpolation.

A dot is a small rectangle of a grating map. Its pitch scale is the factor of the lengths of its grating.
"""

import numpy as np
import pytest
import warp as wp

import warpdiff as wd
from warpdiff.device.kernel_calls import launch
from warpdiff.kernels import dot_transforms
from warpdiff.tables.pitch_ladder import PitchLadder

WINDOW = wd.Coherence(sigma_um=5.0)


def weights_of(ladder, scales):
    """Return the weight of each table of a ladder for pitch scales relative to the smallest one, (tables, scales)."""
    to_lights = wp.array(np.asarray(scales)[:, None] * [0.6, 0.0, 0.8], dtype=wp.vec3f, device="cpu")
    gains, result = wp.full(len(scales), 1.0, dtype=wp.float32, device="cpu"), []
    for octaves in ladder.octaves:
        weighed = wp.empty_like(gains)
        launch(
            dot_transforms.weigh_gains, len(scales), [to_lights, gains, octaves, ladder.per_octave], [weighed],
            in_runs=True, device=wp.get_device("cpu"), threads=1,
        )  # fmt: skip
        result.append(weighed.numpy().astype(float))
    return np.array(result)


@pytest.mark.parametrize("tolerance", [0.1, 1e-2])
def test_weights_interpolate_cubic_functions_of_the_logarithm_of_the_pitch(tolerance, rng):
    scales = rng.uniform(0.7, 1.4, 200)
    ladder = PitchLadder.of(scales, WINDOW, tolerance)
    relative = scales / scales.min()
    weights = weights_of(ladder, relative)
    assert (np.abs(weights) > 1e-6).sum(axis=0).max() == 4
    assert weights.min() < -0.01
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=2e-5)
    cubic = np.polynomial.Polynomial([0.3, -1.0, 0.7, 0.4])
    np.testing.assert_allclose(cubic(np.array(ladder.octaves)) @ weights, cubic(np.log2(relative)), atol=5e-5)


def test_few_pitches_have_tables_of_their_own():
    scales = np.array([1.0, 0.8, 1.25, 0.8])
    ladder = PitchLadder.of(scales, WINDOW, 0.1)
    sigmas = [coherence.sigma_um for coherence in ladder.coherences]
    assert sigmas == pytest.approx([5.0 * 1.25 / scale for scale in (0.8, 1.0, 1.25)])
    weights = weights_of(ladder, scales / 0.8)
    np.testing.assert_allclose(weights, [[0, 1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0]], atol=1e-5)
    assert np.count_nonzero(weights) == 4


def test_windows_reach_one_step_beyond_the_pitches():
    """Cubic interpolation requires two tables on each side of every pitch scale."""
    scales = np.linspace(0.5, 2.0, 101)
    ladder = PitchLadder.of(scales, WINDOW, 0.1)
    assert ladder.octaves == pytest.approx(np.arange(-1, 18) / 8.0)
    sigmas = [coherence.sigma_um for coherence in ladder.coherences]
    assert sigmas == pytest.approx(5.0 * 2.0 ** (2.0 - np.array(ladder.octaves)))
