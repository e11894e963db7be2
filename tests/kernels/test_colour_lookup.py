"""The native table look-ups give the same colours as their reference implementation in plain Warp.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import dataclasses

import lookup_specification
import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, relative_errors
from scipy.stats import truncnorm

import warpdiff as wd
from warpdiff.device.kernel_calls import launch_pipeline
from warpdiff.kernels import colour_lookup
from warpdiff.kernels.structs import Footprint
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.request.directions import DirectionRange
from warpdiff.tables.lookup import ColourLookup

COUNT = 3000


def directions(rng):
    """Return scattering vectors (a third near the mirror direction), directions to the light, gains and footprints.

    Gains are geometry factors. A footprint is the change of (u, v) over one standard deviation of the pixel filter.
    """
    to_lights, to_views = hemisphere(rng, COUNT), hemisphere(rng, COUNT)
    to_views[::3] = to_lights[::3] * [-1.0, -1.0, 1.0] + 0.02 * rng.normal(size=(COUNT // 3, 3))
    to_views /= np.linalg.norm(to_views, axis=1, keepdims=True)
    gains = rng.random(COUNT) * (rng.random(COUNT) > 0.1)
    # The footprints of the test have standard deviations of 1e-4 to 0.3 in (u, v). The widest footprints include all
    # polar angles of (u, v).
    footprints = rng.normal(size=(COUNT, 4)) * 10.0 ** rng.uniform(-4.0, -0.5, size=(COUNT, 1))
    return -(to_lights + to_views), to_lights, gains, footprints


@pytest.fixture(
    scope="module", params=[wd.Coherence(sigma_um=3.25), wd.Coherence("source", angular_diameter_deg=2.0)],
    ids=lambda coherence: coherence.kind,
)  # fmt: skip
def plan(request, fingers):
    made = wd.plan(fingers, coherence=request.param, method="low-rank", integration="table", tolerance=1e-1)
    return dataclasses.replace(made, footprint=True)


def lookup_for(fingers, plan, scattering_vectors, to_lights):
    """Return look-ups of a colour table whose range contains all directions."""
    every = np.ones(COUNT, dtype=bool)
    direction_range = DirectionRange.of(fingers, plan.coherence, scattering_vectors, to_lights, every)
    return ColourLookup(fingers, plan, direction_range, device=wp.get_device("cpu"), threads=2)


@pytest.mark.parametrize("footprints_are_given", [False, True])
def test_native_look_ups_equal_the_reference_implementation(fingers, plan, footprints_are_given, rng):
    scattering_vectors, to_lights, gains, footprints = directions(rng)
    lookup = lookup_for(fingers, plan, scattering_vectors, to_lights)
    arrays = [
        wp.array(scattering_vectors, dtype=wp.vec3d, device="cpu"),
        wp.array(to_lights, dtype=wp.vec3f, device="cpu"),
        wp.array(gains, dtype=wp.float32, device="cpu"),
    ]
    spreads = wp.array(footprints, dtype=Footprint, device="cpu") if footprints_are_given else None
    results = {}
    for kind in ("native", "plain"):
        xyz, unserved_gain = (
            wp.zeros(COUNT, dtype=wp.vec3f, device="cpu"),
            wp.full(COUNT, -1.0, dtype=wp.float32, device="cpu"),
        )
        look_up = lookup.kernel_calls(*arrays, IlluminatedMaterial("D65"), xyz, spreads, unserved_gain)[0]
        if kind == "plain":
            w_basis_size = len(look_up.inputs[0].w_basis.dtype())
            kernel = lookup_specification.lookup(w_basis_size, plan.coherence.kind == "source")
            look_up = dataclasses.replace(look_up, kernel=kernel)
        launch_pipeline([look_up], COUNT, device=wp.get_device("cpu"), threads=2)
        results[kind] = xyz.numpy().astype(np.float64), unserved_gain.numpy()
    (native, native_unserved), (plain, plain_unserved) = results["native"], results["plain"]
    served = native_unserved == plain_unserved
    # For a direction near the limit of the colour table, rounding decides whether the direction is looked up in the
    # table. Directions for which the native look-up and its reference implementation decide differently are excluded.
    assert np.mean(served) > 0.999
    errors = relative_errors(native, plain)[served]
    # The table is a polar grid of (u, v). Native look-ups round positions between two azimuth samples of this grid, or
    # between two of its rings (circles), to 1/64 of their distance.
    assert np.median(errors) < 1e-5
    assert np.percentile(errors, 99.0) < 2e-3
    assert errors.max() < 5e-2
    assert np.count_nonzero(np.any(plain, axis=1)) > COUNT // 2


@pytest.mark.parametrize("deviations", [2.25, 2.5, 3.0, 5.0])
def test_a_truncated_normal_distribution_has_the_variance_1(deviations):
    """The variance before the truncation must give the variance 1 after it, by SciPy's truncated distribution."""
    variance = colour_lookup.variance_before(deviations)
    end = deviations / np.sqrt(variance)
    assert truncnorm(-end, end, scale=np.sqrt(variance)).var() == pytest.approx(1.0, abs=1e-6)


def test_a_colour_does_not_depend_on_which_other_directions_have_a_gain(fingers, plan, rng):
    """Look-ups leave out directions with the gain 0. The colours of the others must stay the same to the bit."""
    scattering_vectors, to_lights, _, footprints = directions(rng)
    lookup = lookup_for(fingers, plan, scattering_vectors, to_lights)
    # Few directions have a gain. Some batches of directions have none with a gain.
    few = rng.random(COUNT) < 0.3
    few[500:1200] = False
    results = []
    for has_gain in (np.ones(COUNT, dtype=bool), few):
        outputs = [wp.zeros(COUNT, dtype=dtype, device="cpu") for dtype in (wp.vec3f, wp.float32)]
        inputs = [
            wp.array(values, dtype=dtype, device="cpu")
            for values, dtype in ((scattering_vectors, wp.vec3d), (to_lights, wp.vec3f), (has_gain, wp.float32))
        ]
        spreads = wp.array(footprints, dtype=Footprint, device="cpu")
        calls = lookup.kernel_calls(*inputs, IlluminatedMaterial("D65"), outputs[0], spreads, outputs[1])
        launch_pipeline(calls[:1], COUNT, device=wp.get_device("cpu"), threads=2)
        results.append([values.numpy()[has_gain] for values in outputs])
        assert not outputs[0].numpy()[~has_gain].any()
    for whole, part in zip(*results, strict=True):
        np.testing.assert_array_equal(part, whole[has_gain])
