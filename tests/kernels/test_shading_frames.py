"""Shading frames: a perpendicular of any vector."""

import numpy as np
import warp as wp
from conftest import hemisphere, launch

from warpdiff.kernels import compile_options, shading_frames


@wp.kernel(module="unique", module_options=compile_options.options())
def perpendiculars_of(vectors: wp.array(dtype=wp.vec3f), result: wp.array(dtype=wp.vec3f)):
    i = wp.tid()
    result[i] = shading_frames.perpendicular(vectors[i])


def test_a_perpendicular_is_a_unit_vector_nearest_to_the_least_parallel_axis(rng):
    """The vector must have the length 1 and be perpendicular, also to each axis of the coordinates.

    It must be in the plane of the vector and of the coordinate axis that is least parallel to the vector.
    """
    vectors = np.concatenate([np.eye(3), -np.eye(3), hemisphere(rng, 50) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]])
    result = wp.zeros(len(vectors), dtype=wp.vec3f, device="cpu")
    launch(perpendiculars_of, len(vectors), [wp.array(vectors, dtype=wp.vec3f, device="cpu")], [result], device="cpu")
    axes = np.eye(3)[np.argmin(np.abs(vectors), axis=1)]
    expected = axes - np.sum(axes * vectors, axis=1, keepdims=True) * vectors
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(result.numpy(), expected, atol=1e-6)
