"""A user-defined light needs a light class, a lobe set, a pass and a kernel: here a spotlight with a cos⁸ profile."""

from dataclasses import dataclass

import numpy as np
import pytest
import warp as wp

import warpdiff as wd
from warpdiff import meshes
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels.structs import Pixels
from warpdiff.lights.base import LobeSet
from warpdiff.lights.lobe_pass import LobePass

# The kernel of the user-defined spotlight.


@wp.kernel
def dim_by_profile(
    pixels: Pixels, position: wp.vec3f, axis: wp.vec3f, first: wp.int32, run: wp.int32,
    gains_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Multiply the gains of pixels by cos⁸ of the angle between the spotlight's axis and the direction to the pixel."""
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        towards = wp.normalize(pixels.shadow_origin[i] - position)
        gains_out[i] = gains_out[i] * wp.pow(wp.max(wp.dot(towards, axis), 0.0), 8.0)


class SpotPass(LobePass):
    @property
    def graph_key(self):
        return *super().graph_key, self.part.lobes[0].position, self.part.axis

    def gain_calls(self, lobe, batch):
        surface = self.context.rays.surface
        position = (np.array(self.part.lobes[lobe].position) - surface.centre) / surface.radius
        inputs = [batch.gbuffer.pixels, wp.vec3f(*position), wp.vec3f(*self.part.axis)]
        return [KernelCall(dim_by_profile, inputs, [batch.samples.gains], in_runs=True)]


@dataclass(frozen=True, eq=False)
class SpotLobes(LobeSet):
    axis: tuple[float, float, float]

    def make_pass(self, context):
        return SpotPass(self, context)


@dataclass(frozen=True)
class SpotLight(wd.PointLight):
    axis: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def parts(self, coherence, **options):
        (part,) = super().parts(coherence, **options)
        return [SpotLobes(part.lobes, self.axis)]


# Axis of the spotlights of all tests in this file, from the light into the scene.

AXIS = (0.0, -0.8, -0.6)


def test_a_spotlight_is_a_point_light_times_its_profile(fingers):
    body, position = meshes.tube(segments_along=48, segments_around=24), (0.3, 1.7, 1.4)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=96, height=72)
    coherence = wd.Coherence(sigma_um=4.0)
    # Both lights use the same plan. Otherwise the plan of the spotlight would differ, because its directions are
    # darker.
    plan = wd.plan(fingers, coherence=coherence, integration="table", tolerance=0.1)
    point, spot = (
        wd.shade(body, fingers, light, view, plan=plan, pigment=0.0, refine=False, layers=("depth",))
        for light in (wd.PointLight(position), SpotLight(position, axis=AXIS))
    )
    frame = view.frame()
    x = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
    y = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
    rays = x[None, :, None] * frame.right + y[:, None, None] * frame.up - frame.back
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    illuminated = point.illuminated & (point.xyz[..., 1] > 0.0)
    towards = frame.origin + point.layers["depth"][illuminated][:, None] * rays[illuminated] - position
    profile = np.maximum(towards @ AXIS / np.linalg.norm(towards, axis=1), 0.0) ** 8
    assert profile.min() < 0.5 < profile.max()
    ratios = spot.xyz[illuminated][:, 1] / (profile * point.xyz[illuminated][:, 1])
    assert len(ratios) > 500
    assert np.median(ratios) == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(np.percentile(ratios, (1.0, 99.0)), 1.0, atol=1e-2)


def test_launches_are_recorded_again_if_a_spotlight_rotates(fingers):
    """Position and axis of a spotlight are values in recorded launches, so the key of a recording depends on them."""
    body = meshes.tube(segments_along=12, segments_around=12)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=8, height=6)
    lights = [SpotLight((0.3, 1.7, 1.4), axis=AXIS), SpotLight((0.3, 1.7, 1.4)), SpotLight((0.2, 1.7, 1.4), axis=AXIS)]
    renderer = wd.Renderer(body, fingers, lights[0], view, coherence=wd.Coherence(sigma_um=4.0), tolerance=0.2)
    keys = []
    for light in [*lights, lights[0]]:
        renderer.draw(light)
        keys.append(renderer._mine.picture.graph_key)
    assert keys[0] == keys[3]
    assert len(set(keys)) == 3
