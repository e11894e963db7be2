"""A user-defined light with an emission profile and a kernel: here a spotlight with a cos⁸ profile."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
import warp as wp
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff import meshes
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import compile_options
from warpdiff.kernels.light_samples import Lights, away_from
from warpdiff.kernels.structs import Pixels
from warpdiff.lights.base import EmissionProfile, LobeSet

# The kernel of the user-defined spotlight. It has the package's compile options, because with other options Warp would
# precompile its own C++ headers once more.
wp.set_module_options(compile_options.options())


@wp.kernel
def emit_by_cosine(
    lights: Lights, lobe: wp.int32, axis: wp.vec3f, pixels: Pixels, first: wp.int32, run: wp.int32,
    towards_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Write directions to the light, and cos⁸ of the angle between the spotlight's axis and the direction from the
    spotlight to the surface.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        towards = wp.normalize(wp.vec3f(away_from(lights.places[lobe], pixels.shadow_origin[i])))
        weight = wp.pow(wp.max(-wp.dot(towards, axis), 0.0), 8.0)
        towards_out[i] = wp.vec4f(towards[0], towards[1], towards[2], weight)


@dataclass(frozen=True)
class CosineProfile(EmissionProfile):
    axis: tuple[float, float, float]

    def kernel_call(self, lights, lobe, batch):
        inputs = [lights, lobe, self.axis, batch.gbuffer.pixels]
        return KernelCall(emit_by_cosine, inputs, [batch.samples.towards], in_runs=True)


@dataclass(frozen=True)
class SpotLight(wd.PointLight):
    axis: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def lobes(self):
        return tuple(replace(lobe, profile=CosineProfile(self.axis)) for lobe in super().lobes())


# Axis of the spotlights of all tests in this file, from the light into the scene.

AXIS = (0.0, -0.8, -0.6)


def test_a_spotlight_is_a_point_light_times_its_profile(fingers):
    body, position = meshes.tube(segments_along=48, segments_around=24), (0.3, 1.7, 1.4)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=96, height=72)
    coherence = wd.Coherence(sigma_um=4.0)
    # Both pictures use the same plan (method and numbers of a computation). A plan for the spotlight would have other
    # numbers, because its light is darker in most directions.
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
    """Launches of kernels are recorded once for a picture, and are repeated for the next pictures.

    If a spotlight rotates, they must be recorded again, because a recorded launch contains the value of the axis. If
    the spotlight only moves, they must not.
    """
    body = meshes.tube(segments_along=12, segments_around=12)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=8, height=6)
    lights = [SpotLight((0.3, 1.7, 1.4), axis=AXIS), SpotLight((0.3, 1.7, 1.4)), SpotLight((0.2, 1.7, 1.4), axis=AXIS)]
    renderer = wd.Renderer(body, fingers, lights[0], view, coherence=wd.Coherence(sigma_um=4.0), tolerance=0.2)
    keys = []
    for light in [*lights, lights[0]]:
        renderer.draw(light)
        keys.append(renderer._mine.picture.graph_key)
    assert keys[0] == keys[2] == keys[3]
    assert len(set(keys)) == 2


@dataclass(frozen=True)
class Beam(wd.DirectionalLight):
    """Directional light with an emission profile that is 1 in the only direction of the light."""

    def lobes(self):
        axis = tuple(-np.array(self.to_light) / np.linalg.norm(self.to_light))
        return tuple(replace(lobe, profile=CosineProfile(axis)) for lobe in super().lobes())


def test_shadows_of_distant_lights_with_a_profile_equal_those_without(fingers):
    body, direction = meshes.snake(scale_rows=9, ventrals=20, segments=2), (1.0, 0.3, 0.2)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=48, height=36)
    options = {"coherence": wd.Coherence(sigma_um=4.0), "tolerance": 0.3, "pigment": 0.0, "strict": False}
    plain, beam = (wd.shade(body, fingers, kind(direction), view, **options) for kind in (wd.DirectionalLight, Beam))
    bright = wd.shade(body, fingers, wd.DirectionalLight(direction), view, shadows=False, **options)
    assert np.count_nonzero(bright.illuminated & ~plain.illuminated) > 30
    np.testing.assert_array_equal(beam.illuminated, plain.illuminated)
    np.testing.assert_allclose(beam.xyz, plain.xyz, rtol=1e-3, atol=1e-4 * plain.xyz.max())


def test_a_profile_dims_the_light_of_the_pigment(fingers):
    """The emission profile must also dim the light that the base colour of the mesh (pigment) reflects.

    Where the profile is 1, this light must be as bright as under a point light. Elsewhere it must be darker.
    """
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    texture = trimesh.visual.TextureVisuals(
        uv=[[0, 0], [1, 0], [1, 1], [0, 1]],
        material=trimesh.visual.material.SimpleMaterial(diffuse=[200, 100, 50, 255]),
    )
    square = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)
    view = wd.View.orthographic((0, 0, 4), (0, 0, 0), up=(0, 1, 0), extent_y=1.5, width=3, height=3)
    options = {"coherence": wd.Coherence(sigma_um=4.0), "footprint": False}
    options["plan"] = wd.plan(fingers, coherence=options["coherence"], tolerance=0.1)

    def pigment(light):
        pictures = [wd.shade(square, fingers, light, view, pigment=n, **options).xyz for n in (0.0, 100.0)]
        return (pictures[1] - pictures[0])[..., 1]

    ratios = pigment(SpotLight((0.0, 0.0, 1.0))) / pigment(wd.PointLight((0.0, 0.0, 1.0)))
    squared = np.array([[0.5, 0.25, 0.5], [0.25, 0.0, 0.25], [0.5, 0.25, 0.5]])
    np.testing.assert_allclose(ratios, (1.0 + squared) ** -4.0, rtol=1e-3)


def test_lobes_of_all_lights_are_refined_together_unless_a_part_has_its_own_pass(fingers):
    """A light consists of lobes (Gaussians of directions). One pass of the renderer samples a ``LobeSet`` of lobes.

    The lobes of all lights must form one set, including those of a light with an emission profile. Only lobes of a
    subclass of ``LobeSet`` with its own pass must stay separate.
    """

    class OwnPass(LobeSet):
        def make_pass(self, context):
            return super().make_pass(context)

    class OwnLight(wd.PointLight):
        def parts(self, coherence, **options):
            return [OwnPass(part.lobes) for part in super().parts(coherence, **options)]

    place = (0.3, 1.7, 1.4)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=8, height=6)
    lights = [wd.PointLight(place), OwnLight(place), SpotLight(place, axis=AXIS), wd.DirectionalLight(place)]
    renderer = wd.Renderer(
        meshes.tube(segments_along=12, segments_around=12), fingers, lights, view, tolerance=0.2,
        coherence=wd.Coherence(sigma_um=4.0),
    )  # fmt: skip
    assert [(type(part), len(part.lobes)) for part in renderer._mine.parts] == [(LobeSet, 3), (OwnPass, 1)]


def test_plain_surfaces_reflect_the_light_of_a_spotlight_times_its_profile():
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    steel = PBRMaterial(baseColorFactor=[200, 180, 160, 255], metallicFactor=0.7, roughnessFactor=0.4)
    bodies = {
        name: trimesh.Trimesh(
            corners + np.array([0.0, y, 0.0]), [[0, 1, 2], [0, 2, 3]], process=False,
            visual=trimesh.visual.TextureVisuals(uv=corners[:, :2], material=material),
        )
        for name, y, material in (("steel", 0.0, steel), ("grating", -4.0, None))
    }  # fmt: skip
    surfaces, view = (
        {"grating": wd.gratings.sinusoidal(1.5, 0.1), "*": None},
        wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=1.5, width=12, height=12),
    )
    options = {"coherence": wd.Coherence(sigma_um=5.0), "tolerance": 0.1, "refine": False, "footprint": False}
    position, axis = np.array([0.2, 0.3, 2.0]), (0.0, 0.0, -1.0)
    spot = wd.shade(
        trimesh.Scene(bodies), surfaces, SpotLight(tuple(position), axis=axis), view, **options, layers=["position"]
    )
    point = wd.shade(trimesh.Scene(bodies), surfaces, wd.PointLight(tuple(position)), view, **options)
    away = spot.layers["position"] - position
    profile = (-away[..., 2] / np.linalg.norm(away, axis=-1)) ** 8
    assert profile.min() < 0.5 * profile.max()
    np.testing.assert_allclose(spot.xyz, profile[..., None] * point.xyz, rtol=1e-4)
