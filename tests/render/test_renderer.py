"""Successive pictures of a ``Renderer`` must equal those of ``shade``, also with launches recorded as on a GPU.

A launch runs a kernel, a loop over pixels or rays. On a GPU, the launches of a picture are recorded once and then
repeated. Warp can do the same on the CPU, so that these tests need no GPU.
"""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor

import endurance
import numpy as np
import pytest
import trimesh
import warp as wp
from conftest import slow
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

import warpdiff as wd
from warpdiff import meshes
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.render import device_tiles, renderer

SHORT = wd.Coherence(sigma_um=2.0)
LIGHTS = [wd.DirectionalLight((0.1, 0.9, 1.2)), wd.DirectionalLight((-0.8, 0.3, 0.5), illuminant="A", power=0.5)]
WIDTH, HEIGHT = 40, 30
# Number of pictures that each of two concurrent threads renders.
TURNS = endurance.count(10, 150)


def view(angle=0.0, size=(WIDTH, HEIGHT)):
    eye = (3.1 * np.sin(angle), 1.6, 3.1 * np.cos(angle))
    return wd.View(eye, (0.0, 0.0, 0.0), fov_y_deg=27.0, width=size[0], height=size[1])


def rotated(angle):
    return [wd.DirectionalLight((0.1 + angle, 0.9, 1.2)), dataclasses.replace(LIGHTS[1], power=0.5 + angle)]


@pytest.fixture(scope="module")
def tube():
    return meshes.tube(segments_along=48, segments_around=32)


@pytest.fixture(scope="module")
def painted(tube):
    result = tube.copy()
    result.visual = TextureVisuals(uv=tube.visual.uv, material=SimpleMaterial(diffuse=(200, 120, 60, 255)))
    return result


@pytest.fixture(scope="module")
def plans(fingers):
    """Return plans (method, number of wavelengths and so on) by name. A renderer and ``shade`` use the same plan."""
    table = wd.plan(fingers, coherence=SHORT, method="low-rank", integration="table", tolerance=5e-2)
    source = wd.Coherence("source", angular_diameter_deg=4.0)
    return {
        "footprints": dataclasses.replace(table, footprint=True), "points": table,
        "sampled": wd.plan(fingers, coherence=SHORT, method="low-rank", tolerance=5e-2),
        "source": dataclasses.replace(wd.plan(fingers, coherence=source, method="low-rank", integration="table",
                                              tolerance=0.1, strict=False), footprint=True),
    }  # fmt: skip


CASES = {
    "footprints": ("footprints", 1, {}), "footprints and two lights": ("footprints", 2, {}),
    "four rays with footprints": ("footprints", 1, {"samples_per_pixel": 4}), "points": ("points", 2, {}),
    "four rays": ("points", 1, {"samples_per_pixel": 4}), "sampled": ("sampled", 1, {}), "source": ("source", 1, {}),
    "no shadows": ("footprints", 1, {"shadows": False}),
}  # fmt: skip


@pytest.fixture
def recorded(monkeypatch):
    """Make renderers record their launches, as on a GPU. Return a list that gets an element with each recording."""
    begun = []
    capture = wp.ScopedCapture
    monkeypatch.setattr(renderer, "records", lambda _: True)
    # A recorded launch always has the largest number of threads that a picture may need. On the CPU, a smaller limit of
    # this number saves time.
    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 1 << 15)
    monkeypatch.setattr(wp, "ScopedCapture", lambda *a, **k: begun.append(1) or capture(*a, **k))
    return begun


def same(found, expected):
    np.testing.assert_array_equal(found.xyz, expected.xyz)
    np.testing.assert_array_equal(found.illuminated, expected.illuminated)
    np.testing.assert_array_equal(found.coverage, expected.coverage)


@pytest.mark.parametrize(("name", "count", "options"), CASES.values(), ids=CASES)
def test_pictures_equal_those_of_shade(tube, fingers, plans, name, count, options):
    drawn = wd.Renderer(tube, fingers, LIGHTS[:count], view(), plan=plans[name], **options)
    for angle in (0.0, 0.4):
        lights, camera = rotated(angle)[:count], view(angle)
        xyz = drawn.draw(lights, camera)
        expected = wd.shade(tube, fingers, lights, camera, plan=plans[name], **options)
        same(drawn.image(), expected)
        assert drawn.image().report.refined_share == expected.report.refined_share
        assert xyz.shape == (HEIGHT, WIDTH)
        np.testing.assert_array_equal(xyz.numpy(), expected.xyz)


@pytest.mark.parametrize("name", [slow("footprints"), "footprints and two lights", "four rays with footprints"])
def test_previews_equal_pictures_of_their_tolerances_and_the_last_picture_is_unchanged(tube, fingers, plans, name):
    of, count, options = CASES[name]
    drawn = wd.Renderer(tube, fingers, LIGHTS[:count], view(), plan=plans[of], **options)
    for angle in (0.0, 0.4):
        lights, camera = rotated(angle)[:count], view(angle)
        found = {}

        def keep(found=found):
            image = drawn.image()
            found[image.plan.tolerance] = image

        drawn.draw(lights, camera, previews={0.2: keep, 0.4: keep})
        assert list(found) == [0.4, 0.2]
        found[plans[of].tolerance] = drawn.image()
        for tolerance, image in found.items():
            plan = dataclasses.replace(plans[of], tolerance=tolerance)
            expected = wd.shade(tube, fingers, lights, camera, plan=plan, **options)
            same(image, expected)
            np.testing.assert_array_equal(image.error, expected.error)
            assert image.plan == expected.plan


DISC = wd.DirectionalLight((0.3, 0.8, 0.9), angular_diameter_deg=9.0)
SMALL_DISC = dataclasses.replace(DISC, angular_diameter_deg=4.0)
BEHIND = wd.DirectionalLight((0.0, -0.62, -1.0), power=3.0)


@pytest.mark.parametrize("lights", [[SMALL_DISC, LIGHTS[1]], [BEHIND, LIGHTS[0]]], ids=["disc", "behind"])
def test_progress_increases_and_the_order_of_lights_does_not_matter(tube, fingers, plans, lights):
    drawn = wd.Renderer(tube, fingers, lights, view(), plan=plans["footprints"], pigment=0.0)
    shares = []
    drawn.draw(previews={0.4: lambda: shares.append(shares[-1])}, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    result, other = (wd.shade(tube, fingers, each, view(), plan=plans["footprints"], pigment=0.0)
                    for each in (lights, lights[::-1]))  # fmt: skip
    same(drawn.image(), result)
    np.testing.assert_allclose(result.xyz, other.xyz, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(result.error, other.error, rtol=1e-4, atol=1e-7)
    np.testing.assert_array_equal(result.mask, other.mask)
    # A pixel is divided into subpixel cells, differently for each light. Its coverage is computed from the smallest
    # cells among all lights. It must therefore hardly depend on the order of the lights.
    np.testing.assert_allclose(result.coverage, other.coverage, atol=0.01)


def test_lights_that_are_refused_change_nothing(tube, fingers, plans):
    lights = [wd.PointLight((0.1, 0.9, 4.0)), LIGHTS[1]]
    drawn = wd.Renderer(tube, fingers, lights, view(), plan=plans["footprints"])
    before = drawn.image()
    for refused in ([wd.PointLight((0.1, 0.9, 1.2), power=1e12), LIGHTS[1]],
                    [wd.Environment(np.ones((2, 4, 3))), wd.PointLight((0.1, 0.9, 1.2), power=1e12)]):  # fmt: skip
        with pytest.raises(ValueError, match=r"\(PointLight\) has a power"):
            drawn.draw(refused, view(0.4))
        same(drawn.image(), before)
    drawn.draw(lights[::-1])
    drawn.draw(lights)
    same(drawn.image(), before)


def test_a_replayed_disc_light_equals_that_of_shade(painted, fingers, plans, recorded):
    size = (24, 18)
    drawn = wd.Renderer(painted, fingers, DISC, view(size=size), plan=plans["footprints"], threads=1)
    assert len(recorded) == 1
    light = dataclasses.replace(DISC, to_light=(0.6, 0.8, 0.9), angular_diameter_deg=9.3)
    drawn.draw(light, view(0.3, size))
    expected = wd.shade(painted, fingers, light, view(0.3, size), plan=plans["footprints"])
    result = drawn.image()
    floor = 1e-3 * np.percentile(expected.xyz[..., 1], 99.0)
    differ = np.linalg.norm(result.xyz - expected.xyz, axis=-1) / (floor + np.linalg.norm(expected.xyz, axis=-1))
    assert np.percentile(differ[expected.illuminated], 99.0) <= 0.1 * drawn.plan.tolerance
    assert np.mean(result.illuminated != expected.illuminated) <= 0.01
    assert len(recorded) == 1


SAMPLED = {
    "disc": DISC, "sky": wd.Environment(np.ones((8, 16, 3)) * np.linspace(2.0, 0.1, 8)[:, None, None]),
    "clear sky": wd.Environment.clear_sky((0.3, 0.8, 0.5)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "together"),
    [
        ("disc", True),
        ("sky", False),
        ("clear sky", True),
        *map(slow, ("disc", "sky", "clear sky"), (False, True, False)),
    ],
)
def test_a_sampled_light_after_another_light_equals_that_of_shade(name, together, tube, fingers, plans, monkeypatch):
    """A picture by recorded launches must equal that of ``shade``, if a sampled light follows a light without samples.

    Discs and skies are sampled: each ray has a random direction to the light. The launches are first recorded for a
    light without samples. The sampled light then needs additional arrays.
    """
    monkeypatch.setattr(renderer, "records", lambda _: True)
    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 1 << 15)
    lights = [LIGHTS[0], SAMPLED[name]] if together else [SAMPLED[name]]
    size, plan = (16, 12), dataclasses.replace(plans["footprints"], tolerance=0.2)
    drawn = wd.Renderer(tube, fingers, LIGHTS[0], view(size=size), plan=plan, threads=1)
    drawn.draw(lights)
    result, expected = drawn.image(), wd.shade(tube, fingers, lights, view(size=size), plan=plan)
    same_places = result.illuminated & expected.illuminated
    assert same_places.sum() > 20
    size = np.linalg.norm(expected.xyz[same_places], axis=1)
    differ = np.linalg.norm(result.xyz - expected.xyz, axis=2)[same_places] / size
    assert np.percentile(differ, 90.0) < 0.1 * plan.tolerance


@pytest.mark.parametrize(
    "second",
    [wd.DirectionalLight((0.0, 0.0, 1.0), angular_diameter_deg=8.0), wd.PointLight((0.3, 1.0, 2.0))],
    ids=["disc", "point"],
)
def test_another_kind_of_light_in_the_same_direction_does_not_use_the_occluder_grids_of_the_first(
    second, tube, fingers, plans
):
    """A disc or point light must not use the occluder grids of a directional light that was rendered before.

    An occluder grid lists the faces that may shadow a place, for one direction to a light. All of these lights store
    the same direction (0, 0, 1), although a point light does not use it.
    """
    first, plan = wd.DirectionalLight((0.0, 0.0, 1.0)), plans["footprints"]
    drawn = wd.Renderer(tube, fingers, first, view(), plan=plan)
    drawn.draw(second)
    same(drawn.image(), wd.shade(tube, fingers, second, view(), plan=plan))


def test_a_preview_callback_that_fails_leaves_a_complete_picture(tube, fingers, plans):
    drawn = wd.Renderer(tube, fingers, LIGHTS[:1], view(), plan=plans["footprints"])
    before = drawn.image()

    def fails():
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        drawn.draw(previews={0.4: fails})
    # The callback for previews (pictures at larger tolerances) raised an error during this picture. The picture must
    # still be complete.
    same(drawn.image(), before)
    with pytest.raises(RuntimeError, match="was called from its own progress"):
        drawn.draw(previews={0.4: drawn.draw})
    requested = {0.2: print}
    requested[0.4] = requested.clear
    drawn.draw(previews=requested)
    assert not requested
    same(drawn.image(), before)


def test_pictures_without_refinement_have_no_previews(tube, fingers, plans):
    drawn = wd.Renderer(tube, fingers, LIGHTS[:1], view(), plan=plans["points"])
    before = drawn.image()
    drawn.draw(previews={0.5: lambda: pytest.fail("a preview is shown")})
    same(drawn.image(), before)


@pytest.mark.parametrize("name", [slow("footprints"), "footprints and two lights", "points", slow("source")])
def test_pictures_contain_no_remains_of_earlier_views(tube, fingers, plans, name):
    """Pictures with very different views follow each other, and each must equal a picture by a new renderer.

    The mesh is near, far, outside of the view, or around the eye, with a part of the mesh behind it.
    """
    plan, count, options = CASES[name]
    size = {"width": WIDTH, "height": HEIGHT}
    near, far = wd.View((0.0, 1.0, 1.5), (0, 0, 0), **size), wd.View((0.0, 4.0, 6.0), (0, 0.5, 0), **size)
    beside = wd.View((0.0, 0.0, 5.0), (0.0, 4.5, 4.0), up=(0, 0, 1), fov_y_deg=20.0, **size)
    within = wd.View((0.2, 0.0, 0.1), (1.0, 0.0, 0.0), **size)
    drawn = wd.Renderer(tube, fingers, LIGHTS[:count], near, plan=plans[plan], **options)
    covered = []
    for camera in (far, near, beside, near, within, far, beside):
        drawn.draw(view=camera)
        expected = wd.shade(tube, fingers, LIGHTS[:count], camera, plan=plans[plan], **options)
        same(drawn.image(), expected)
        np.testing.assert_array_equal(expected.xyz[~expected.mask], 0.0)
        covered.append(np.count_nonzero(expected.mask))
    assert 0 == covered[2] == covered[6] < covered[0] == covered[5] < covered[1] == covered[3] < covered[4]


def test_a_picture_that_failed_does_not_spoil_the_next(tube, fingers, plans, monkeypatch):
    drawn = wd.Renderer(tube, fingers, LIGHTS[:1], view(), plan=plans["footprints"], threads=2)
    recorded = KernelCall.recorded

    def fail(step):
        if step.kernel.key == "rasterize":
            raise MemoryError
        return recorded(step)

    monkeypatch.setattr(KernelCall, "recorded", fail)
    with pytest.raises(MemoryError):
        drawn.draw(view=view(0.3))
    monkeypatch.setattr(KernelCall, "recorded", recorded)
    drawn.draw(view=view(0.2))
    same(drawn.image(), wd.shade(tube, fingers, LIGHTS[:1], view(0.2), plan=plans["footprints"]))


@pytest.mark.parametrize("name", ["footprints", "footprints and two lights", "points"])
def test_a_picture_that_is_abandoned_does_not_spoil_the_next(tube, fingers, plans, name):
    class AbandonedError(Exception):
        pass

    plan, count, options = CASES[name]
    drawn = wd.Renderer(tube, fingers, LIGHTS[:count], view(), plan=plans[plan], threads=2, **options)
    shares = []
    drawn.draw(view=view(0.1), progress=shares.append)
    assert shares == sorted(shares)
    assert len(shares) > 1
    assert shares[-1] == 1.0
    for most in (0.0, 0.4, 0.8):

        def tell(share, most=most):
            if share > most:
                raise AbandonedError

        with pytest.raises(AbandonedError):
            drawn.draw(rotated(most)[:count], view(most), progress=tell)
    # An exception in the progress callable has interrupted the picture. A request for its image renders it completely.
    same(drawn.image(), wd.shade(tube, fingers, rotated(0.8)[:count], view(0.8), plan=plans[plan], **options))
    drawn.draw(rotated(0.2)[:count])
    same(drawn.image(), wd.shade(tube, fingers, rotated(0.2)[:count], view(0.8), plan=plans[plan], **options))


@pytest.mark.parametrize("name", ["footprints", "four rays with footprints", "points", slow("source")])
def test_lights_can_change_without_the_view(tube, fingers, plans, name):
    plan, count, options = CASES[name]
    drawn = wd.Renderer(tube, fingers, LIGHTS[:count], view(), plan=plans[plan], **options)
    first = drawn.image()
    for angle in (0.3, 0.0):
        drawn.draw(rotated(angle)[:count])
        same(drawn.image(), wd.shade(tube, fingers, rotated(angle)[:count], view(), plan=plans[plan], **options))
    # An image that was returned before is not changed by later pictures.
    same(first, wd.shade(tube, fingers, LIGHTS[:count], view(), plan=plans[plan], **options))
    drawn.draw(view=view(0.2))
    same(drawn.image(), wd.shade(tube, fingers, rotated(0.0)[:count], view(0.2), plan=plans[plan], **options))


def test_footprints_stay_on_without_a_table_for_means(tube):
    heightfield = wd.gratings.blazed(2.5, 0.25)
    options = {"tolerance": 0.5, "coherence": SHORT}
    drawn = wd.Renderer(tube, heightfield, LIGHTS[0], view(size=(24, 18)), **options)
    assert drawn.plan.footprint
    same(drawn.image(), wd.shade(tube, heightfield, LIGHTS[0], view(size=(24, 18)), plan=drawn.plan))
    by_itself = wd.shade(tube, heightfield, LIGHTS[0], view(size=(24, 18)), **options)
    assert by_itself.plan.footprint
    np.testing.assert_allclose(by_itself.xyz, drawn.image().xyz, rtol=0.5, atol=2e-3 * by_itself.xyz.max())


# Names of the cases that only slow tests repeat with recorded launches. The kernels that these cases launch also occur
# in the other cases.
SLOW_TO_REPLAY = {"footprints", "points", "sampled", "no shadows"}
REPLAYED = [
    pytest.param(*case, id=key, marks=[pytest.mark.slow] * (key in SLOW_TO_REPLAY)) for key, case in CASES.items()
]


@pytest.mark.parametrize(("name", "count", "options"), REPLAYED)
def test_replayed_pictures_equal_those_of_shade(painted, fingers, plans, name, count, options, recorded):
    # The picture is twice as wide and high as in other tests, so that the limit of differing pixels can be a small
    # share.
    size = 2 * WIDTH, 2 * HEIGHT
    drawn = wd.Renderer(painted, fingers, LIGHTS[:count], view(size=size), plan=plans[name], threads=1, **options)
    for angle in (0.4, -0.3):
        lights, camera = rotated(angle)[:count], view(angle, size)
        drawn.draw(lights, camera)
        result, expected = drawn.image(), wd.shade(painted, fingers, lights, camera, plan=plans[name], **options)
        # With recorded launches, the brightness that decides whether a pixel is refined is rounded to 1/128. Rays are
        # traced through a tree of boxes around the faces, and may miss a face at its edge. A few pixels may therefore
        # differ.
        few = 0.01 if drawn.plan.footprint else 0.0
        assert np.mean(result.illuminated != expected.illuminated) <= few
        assert np.mean(result.coverage != expected.coverage) <= few
        differ = np.linalg.norm(result.xyz - expected.xyz, axis=-1) / np.linalg.norm(expected.xyz, axis=-1).clip(1e-6)
        # The filter of a pixel includes subpixel cells of neighbouring pixels. A pixel that is divided differently
        # therefore also changes the pixels around it.
        assert np.mean(differ[expected.illuminated] > 0.0) <= 6.0 * few
        assert np.percentile(differ[expected.illuminated], 99.0) <= 0.1 * drawn.plan.tolerance * drawn.plan.footprint
        assert result.report.refined_share == pytest.approx(expected.report.refined_share, rel=0.05)
    assert len(recorded) == 1
    if name == "footprints" and "samples_per_pixel" not in options:
        assert result.report.refined_share > 0.1


@pytest.mark.usefixtures("recorded")
def test_pictures_do_not_depend_on_the_number_of_parts_of_a_tile_list(tube, fingers, plans, monkeypatch):
    def picture():
        drawn = wd.Renderer(tube, fingers, LIGHTS[0], view(), plan=plans["footprints"], threads=1)
        drawn.draw(rotated(0.2)[0])
        return drawn.image()

    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 1 << 15)
    whole = picture()
    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 300)
    parts = picture()
    same(parts, whole)
    assert parts.report.refined_share == whole.report.refined_share


@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
def test_launches_are_recorded_again_if_others_are_needed(fingers, plans, recorded):
    ball = trimesh.creation.icosphere(subdivisions=3)
    along_x = np.cross([0.0, 0.0, 1.0], ball.vertices) + np.array([1e-3, 0.0, 0.0])
    drawn = wd.Renderer(ball, fingers, LIGHTS[0], view(), plan=plans["footprints"], tangents=along_x, threads=1)
    inside = wd.View((0.0, 0.0, 0.3), (0.0, 0.0, -1.0), fov_y_deg=60.0, width=WIDTH, height=HEIGHT)
    changes = [
        (LIGHTS[0], view(0.1), 1),
        # For a camera inside of a convex mesh, the mesh occludes the light, and kernel launches with shadow rays are
        # recorded.
        (LIGHTS[0], inside, 2),
        (LIGHTS, inside, 3),
        (LIGHTS[1], view(), 4),
        (LIGHTS[1], view(0.1), 4),
    ]
    for light, camera, count in changes:
        drawn.draw(light, camera)
        expected = wd.shade(ball, fingers, light, camera, plan=plans["footprints"], tangents=along_x)
        np.testing.assert_array_equal(drawn.image().illuminated, expected.illuminated)
        assert len(recorded) == count


@pytest.mark.usefixtures("recorded")
def test_a_dark_picture_is_black(tube, fingers, plans):
    drawn = wd.Renderer(tube, fingers, LIGHTS[0], view(), plan=plans["footprints"], threads=1)
    drawn.draw(dataclasses.replace(LIGHTS[0], power=0.0))
    dark = drawn.image()
    assert not dark.xyz.any()
    drawn.draw(LIGHTS[0])
    same(drawn.image(), wd.Renderer(tube, fingers, LIGHTS[0], view(), plan=plans["footprints"], threads=1).image())


def test_the_plan_covers_all_lights_and_views(tube):
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    drawn = wd.Renderer(tube, heightfield, LIGHTS[0], view(), coherence=wd.Coherence(sigma_um=3.25), tolerance=5e-2)
    assert drawn.plan.max_uv == 2.0
    assert drawn.plan.footprint
    assert drawn.plan.error <= 5e-2


def test_a_plan_with_a_smaller_range_of_directions_causes_a_warning(tube, fingers, plans):
    narrow = dataclasses.replace(plans["points"], max_uv=0.5)
    with pytest.warns(wd.WarpdiffWarning, match=r"\|\(u, v\)\| up to 2, planned 0\.5"):
        wd.Renderer(tube, fingers, LIGHTS[0], view(), plan=narrow)


def test_bad_input_is_refused(tube, fingers, plans):
    with pytest.raises(ValueError, match=r"use warpdiff\.shade"):
        wd.Renderer(tube, fingers, LIGHTS[0], view(), method="direct")
    with pytest.raises(TypeError, match="light"):
        wd.Renderer(tube, fingers, [], view(), plan=plans["points"])
    drawn = wd.Renderer(tube, fingers, LIGHTS[0], view(), plan=plans["points"])
    before = drawn.image()
    with pytest.raises(ValueError, match="40 × 30 pixels as before, got 80 × 60"):
        drawn.draw(view=view(size=(80, 60)))
    with pytest.raises(TypeError, match="view"):
        drawn.draw(view=(0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="illuminant"):
        drawn.draw(wd.DirectionalLight((0.0, 0.0, 1.0), illuminant="nothing"))
    with pytest.raises(ValueError, match=r"previews must have tolerances above the plan's 0\.05, got 0\.05"):
        drawn.draw(previews={0.05: print})
    with pytest.raises(TypeError, match=r"previews\[0\.5\] must be callable, got int"):
        drawn.draw(previews={0.5: 1})
    with pytest.raises(TypeError, match="previews must be"):
        drawn.draw(previews=[0.5])
    drawn.draw()
    same(drawn.image(), before)


@pytest.mark.permanent("concurrent rendering threads")
def test_threads_render_different_pictures_concurrently(tube, fingers, plans, tries):
    views = [[view(angle + k / 50.0, size=(24, 18)) for k in range(3)] for angle in (0.0, 1.0)]
    drawn = wd.Renderer(tube, fingers, LIGHTS[:1], views[0][0], plan=plans["footprints"], threads=2)
    first = drawn.image()
    expected = [[drawn.draw(view=each).numpy().copy() for each in one] for one in views]
    together = threading.Barrier(2)

    def draw(index):
        same(drawn.image(), first)
        together.wait(60.0)
        wrong = 0
        for k in range(TURNS):
            xyz = drawn.draw(view=views[index][k % 3])
            wrong += not np.array_equal(drawn.image().xyz, expected[index][k % 3])
            wrong += not np.array_equal(xyz.numpy(), expected[index][k % 3])
        return wrong

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(draw, range(2))) == [0, 0]
    tries.number = 2 * TURNS
    # The main thread rendered a picture before. The pictures of the two other threads must not have changed it.
    np.testing.assert_array_equal(drawn.image().xyz, expected[1][2])
