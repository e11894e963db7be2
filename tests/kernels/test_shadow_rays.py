"""Shadow rays, traced by occluder grids and by the bounding-box hierarchy, compared with brute force in float64."""

import dataclasses

import numpy as np
import pytest
import trimesh
import warp as wp
from conftest import hemisphere, slow
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from bench.truth.brute_force import intersect
from warpdiff import meshes
from warpdiff.device.kernel_calls import launch
from warpdiff.kernels.shading_frames import LIFT
from warpdiff.kernels.shadow_rays import trace_shadow_rays
from warpdiff.kernels.structs import Pixels
from warpdiff.kernels.transparency import trace_shadow_rays_through
from warpdiff.scene import camera_rays, occluder_grid
from warpdiff.scene.device_mesh import SceneArrays
from warpdiff.scene.mesh_import import prepare_surface

UP = (0.0, 0.0, 1.0)


def unit(vector):
    return np.array(vector) / np.linalg.norm(vector)


def surface_of(mesh):
    """Return the prepared surface of a mesh, with constant tangents, which do not affect shadows."""
    return prepare_surface(mesh, tangents=[[0.3, 0.5, 0.7]] * len(mesh.vertices))


def box_on_floor():
    """Return a floor of two large faces with a sphere of 5,000 tiny faces on it, below a square lid."""
    floor = trimesh.creation.box((20.0, 20.0, 0.1))
    body = trimesh.creation.icosphere(subdivisions=4).apply_translation((1.0, 2.0, 1.2))
    return trimesh.util.concatenate([floor, body, lid(4.0).apply_translation((0.0, 0.0, 5.0))])


def lid(size=1.0):
    """Return a square in the plane z = 0 with two faces."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) * size / 2.0
    return trimesh.Trimesh(square, [[0, 1, 2], [0, 2, 3]], process=False)


def plates():
    """Return a finely subdivided square with a square lid above it."""
    plane = lid(2.0)
    for _ in range(4):
        plane = plane.subdivide()
    return trimesh.util.concatenate([plane, lid().apply_translation((0.1, 0.2, 0.5))])


def bodies():
    """Return two spheres that intersect and a box above them."""
    one, other = (trimesh.creation.icosphere(subdivisions=3).apply_translation((x, 0.0, 0.0)) for x in (-0.4, 0.6))
    above = trimesh.creation.box((0.8, 0.8, 0.2)).apply_translation((0.2, 0.1, 1.5))
    return trimesh.util.concatenate([one, other, above])


MESHES = {
    "tube": lambda: meshes.tube(segments_along=40, segments_around=24),
    "snake": lambda: meshes.snake(scale_rows=9, ventrals=20, segments=2),
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=3), "large and tiny faces": box_on_floor,
    "plates": plates, "bodies": bodies,
}  # fmt: skip


def points_on(surface, light, count, rng):
    """Return starting points of shadow rays on random faces, moved a small distance from the face towards the light."""
    face = rng.integers(0, len(surface.faces), count)
    shares = rng.dirichlet((1.0, 1.0, 1.0), count)
    corners = surface.vertices[surface.faces[face]].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal *= np.where(normal @ light < 0.0, -1.0, 1.0)[:, None] / np.linalg.norm(normal, axis=1, keepdims=True)
    return (np.einsum("kc,kcd->kd", shares, corners) + float(LIFT) * normal).astype(np.float32)


def traced(kernel, of_mesh, light, origins, directions=(), threads=1):
    """Return the results of a shadow kernel for rays from ``origins`` to the light: True for each occluded ray.

    If ``directions`` has a direction for each ray, (n, 3), the rays have these directions instead.
    """
    places = wp.array([(*light, 0.0)], dtype=wp.vec4d, device="cpu")
    pixels = Pixels()
    pixels.hit = wp.ones(len(origins), dtype=wp.int32, device="cpu")
    pixels.normal = wp.full(len(origins), wp.vec3f(*light), dtype=wp.vec3f, device="cpu")
    pixels.shadow_origin = wp.array(origins, dtype=wp.vec3f, device="cpu")
    result = wp.empty(len(origins), dtype=wp.bool, device="cpu")
    towards = wp.array([(*direction, 1.0) for direction in directions], dtype=wp.vec4f, device="cpu")
    inputs = [*of_mesh, places, 0, towards, pixels]
    launch(kernel, len(origins), inputs, [result], device=wp.get_device("cpu"), threads=threads, in_runs=True)
    return result.numpy()


def occluded(grid, light, origins, threads=1, directions=()):
    """Return the results of the shadow kernel for opaque scenes: True for each occluded ray."""
    return traced(trace_shadow_rays, [grid], light, origins, directions, threads)


def scene_of(surface):
    return SceneArrays(surface, device="cpu")


def grid_of(surface, scene, light, threads=1):
    return occluder_grid.grid_for(surface, scene, light, device=wp.get_device("cpu"), threads=threads)


@pytest.mark.parametrize(
    "light", [(0.3, 0.5, 0.8), slow((0.0, 0.0, 1.0)), (1.0, 0.0, 0.0), slow((0.05, -1.0, 0.0))], ids=str
)
@pytest.mark.parametrize("make", MESHES.values(), ids=MESHES)
def test_shadows_equal_brute_force(make, light, rng):
    light = unit(light)
    surface = surface_of(make())
    scene = scene_of(surface)
    origins = points_on(surface, light, 400, rng)
    rays = np.tile(light, (len(origins), 1))
    t, _, _, margin = intersect(origins.astype(float), rays, surface.vertices.astype(float), surface.faces, 64)
    # Rays that pass near an edge are excluded, because rounding decides whether they hit the face.
    sure = margin > 1e-4
    assert np.count_nonzero(sure) > 0.99 * len(sure)
    for grid in (grid_of(surface, scene, light), occluder_grid.no_grid(scene)):
        np.testing.assert_array_equal(occluded(grid, light, origins)[sure], np.isfinite(t)[sure])


def through(scene, light, origins, directions=()):
    """Return the results of the shadow kernel for scenes with transparent faces, like those of :func:`occluded`."""
    scene.with_hierarchy()
    return traced(
        trace_shadow_rays_through, [scene.bare, scene.textures, scene.transparency], light, origins, directions
    )


@pytest.mark.parametrize("is_opaque", [True, False])
def test_rays_with_directions_of_their_own_hit_a_rectangle_as_plane_geometry_states(is_opaque, rng):
    """Rays to directions on a disc light must be occluded where they pass through a rectangle above their origins."""
    plate = trimesh.Trimesh([[-0.5, -0.2, 0], [0.7, -0.2, 0], [0.7, 0.3, 0], [-0.5, 0.3, 0]], [[0, 1, 2], [0, 2, 3]])
    surface = surface_of(plate)
    # The surface is scaled to the unit sphere, so that the edges of the rectangle are read from its vertices.
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    origins = rng.uniform(-0.5, 0.5, (400, 3)) - (0.0, 0.0, 1.0)
    directions = hemisphere(rng, 400, 0.5)
    met = (origins + (low[2] - origins[:, 2:]) / directions[:, 2:] * directions)[:, :2]
    expected = np.all((met > low[:2]) & (met < high[:2]), axis=1)
    assert 20 < np.count_nonzero(expected) < 380
    sure = np.minimum(np.abs(met - low[:2]), np.abs(met - high[:2])).min(axis=1) > 1e-4
    scene, starts = scene_of(surface), origins.astype(np.float32)
    if is_opaque:
        result = occluded(occluder_grid.no_grid(scene), UP, starts, directions=directions)
    else:
        result = through(scene, UP, starts, directions)
    np.testing.assert_array_equal(result[sure], expected[sure])


@pytest.mark.parametrize("layers", [1, 64, 65])
def test_a_ray_passes_64_transparent_faces_and_no_more(layers):
    cut = PBRMaterial(name="cut", baseColorFactor=[255, 255, 255, 0], alphaMode="MASK", alphaCutoff=0.5)
    panes = [lid().apply_translation((0.0, 0.0, 0.01 * layer)) for layer in range(layers)]
    stack = trimesh.util.concatenate(panes)
    stack.visual = trimesh.visual.TextureVisuals(uv=stack.vertices[:, :2], material=cut)
    surface = surface_of(stack)
    scene = scene_of(surface)
    assert not scene.is_opaque
    origins = np.array([[0.1, 0.2, surface.vertices[:, 2].min() - 0.1]], dtype=np.float32)
    assert through(scene, UP, origins).tolist() == [layers > 64]


def test_shadows_have_no_gap_at_common_edges_of_faces(rng):
    # Shadow rays pass through vertices and edge centres of a crumpled sheet. Rounding moves each ray to one side of an
    # edge. At least one of the faces at the edge must occlude the ray.
    sheet = lid(2.0)
    for _ in range(5):
        sheet = sheet.subdivide()
    inside = np.max(np.abs(sheet.vertices[:, :2]), axis=1) < 0.99
    sheet.vertices[inside] += rng.uniform(-0.01, 0.01, (np.count_nonzero(inside), 3))
    surface = surface_of(sheet)
    scene = scene_of(surface)
    edges = sheet.edges_unique[inside[sheet.edges_unique].any(axis=1)]
    for light in (unit((0.1, 0.2, 0.9)), unit((0.0, 0.0, 1.0))):
        grid = grid_of(surface, scene, light)
        assert grid.starts.shape[0] > 0
        for places in (surface.vertices[inside], surface.vertices[edges].mean(axis=1)):
            assert np.all(occluded(grid, light, places - 0.3 * light))
            assert not np.any(occluded(grid, light, places + 0.3 * light))


def test_other_points_in_a_grid_cell_do_not_change_a_shadow(rng):
    # A sheet must occlude points below it, but not points in its own plane, even if both are in the same cell of the
    # occluder grid.
    sheet = lid(2.0)
    for _ in range(4):
        sheet = sheet.subdivide()
    height = np.float32(0.1234567)
    flat = surface_of(sheet)
    vertices = flat.vertices.copy()
    vertices[:, 2] = height
    surface = dataclasses.replace(flat, vertices=vertices)
    light = unit((0.0, 0.0, 1.0))
    grid = grid_of(surface, scene_of(surface), light)
    assert grid.starts.shape[0] > 0
    above = np.column_stack([rng.uniform(-0.5, 0.5, (4000, 2)), np.full(4000, height)]).astype(np.float32)
    both = np.repeat(above, 2, axis=0)
    both[1::2, 2] -= 0.1
    assert not np.any(occluded(grid, light, above))
    result = occluded(grid, light, both)
    assert not np.any(result[::2])
    assert np.all(result[1::2])


def test_grid_cells_with_many_faces_occlude_the_points_below(rng):
    # Stacked sheets put more faces into a cell of the occluder grid than one SIMD batch has. Each cell also has several
    # shaded points.
    sheets = [lid(2.0).subdivide().subdivide().apply_translation((0.0, 0.0, 0.01 * k)) for k in range(5)]
    surface = surface_of(trimesh.util.concatenate(sheets))
    light = unit((0.0, 0.0, 1.0))
    scene = scene_of(surface)
    grid = grid_of(surface, scene, light)
    assert np.diff(grid.starts.numpy()).max() > 32
    places = rng.uniform(-0.3, 0.3, (500, 3)).astype(np.float32)
    result = occluded(grid, light, places)
    assert 0 < np.count_nonzero(result) < len(result)
    np.testing.assert_array_equal(result, occluded(occluder_grid.no_grid(scene), light, places))


def test_threads_make_the_same_grid(rng):
    surface = surface_of(meshes.tube(segments_along=96, segments_around=64))
    light = unit((0.3, 0.5, 0.8))
    origins = points_on(surface, light, 20_000, rng)
    alone, others = (grid_of(surface, scene_of(surface), light, threads) for threads in (1, 3))
    np.testing.assert_array_equal(alone.starts.numpy(), others.starts.numpy())
    cells = np.repeat(np.arange(alone.columns * alone.rows), np.diff(alone.starts.numpy()))
    listed = [set(zip(cells, grid.faces.numpy(), grid.tops.numpy(), strict=True)) for grid in (alone, others)]
    assert listed[0] == listed[1]
    np.testing.assert_array_equal(occluded(alone, light, origins), occluded(others, light, origins, threads=3))


def test_meshes_with_very_uneven_face_sizes_use_the_hierarchy():
    light = unit((0.1, 0.2, 0.9))
    body = trimesh.creation.icosphere(subdivisions=4)
    assert grid_of(surface_of(body), scene_of(surface_of(body)), light).starts is not None
    stadium = surface_of(trimesh.util.concatenate([body, lid(300.0).apply_translation((0.0, 0.0, -2.0))]))
    assert grid_of(stadium, scene_of(stadium), light).starts is None
    needles = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, 3, 3))
    needles[:, 1] = needles[:, 0] + 1e-3
    bundle = surface_of(trimesh.Trimesh(needles.reshape(-1, 3), np.arange(9000).reshape(-1, 3), process=False))
    assert grid_of(bundle, scene_of(bundle), light).starts is None


def test_a_moving_view_reuses_the_occluder_grids_of_its_lights(monkeypatch):
    made = []
    monkeypatch.setattr(
        occluder_grid, "_made", lambda *a, make=occluder_grid._made, **k: made.append(a[2]) or make(*a, **k)
    )
    mesh = meshes.tube(segments_along=24, segments_around=16)
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    light, other = wd.DirectionalLight((0.3, 0.5, 1.0)), wd.DirectionalLight((-0.8, 0.1, 0.2))
    plan = wd.plan(heightfield, coherence=wd.Coherence(sigma_um=3.25), tolerance=3e-2)
    views = [wd.View((x, 1.0, 1.5), (0.0, 0.0, 0.0), width=96, height=72) for x in (0.0, 0.2)]
    renderer = wd.Renderer(mesh, heightfield, light, views[0], plan=plan)
    renderer.draw(light, views[1])
    renderer.draw(other)
    assert made == [light.to_light, other.to_light]


@pytest.mark.parametrize("samples", [1, 4])
def test_pictures_with_occluder_grids_equal_pictures_with_the_hierarchy(samples, monkeypatch):
    mesh = meshes.tube(segments_along=24, segments_around=16)
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    lights = [wd.DirectionalLight((0.3, 0.5, 1.0)), wd.DirectionalLight((-0.8, 0.1, 0.2))]
    view = wd.View((0.0, 1.0, 1.5), (0.0, 0.0, 0.0), width=96, height=72)
    options = {"coherence": wd.Coherence(sigma_um=2.0), "tolerance": 0.1, "samples_per_pixel": samples}
    made = []
    monkeypatch.setattr(
        camera_rays, "grid_for", lambda *a, **k: made.append(occluder_grid.grid_for(*a, **k)) or made[-1]
    )
    result = wd.shade(mesh, heightfield, lights, view, **options)
    # An occluder grid lists the faces that a shadow ray may hit. The renderer requests grids several times (``made``),
    # but each light must have only one grid.
    assert all(grid.starts.shape[0] for grid in made)
    grid_count = len(made)
    assert len({grid.starts.ptr for grid in made}) == len(lights)
    monkeypatch.setattr(camera_rays.RasterizedRays, "shadow_grids", camera_rays.CameraRays.shadow_grids)
    expected = wd.shade(mesh, heightfield, lights, view, **options)
    assert len(made) == grid_count
    np.testing.assert_array_equal(result.xyz, expected.xyz)
    np.testing.assert_array_equal(result.illuminated, expected.illuminated)
    unhidden = wd.shade(mesh, heightfield, lights, view, shadows=False, **options)
    assert np.any(unhidden.xyz != result.xyz)


@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
def test_pixels_that_face_away_from_the_light_may_contain_shadowed_cells_that_face_it():
    # A snake is viewed from below and illuminated from behind. None of its pixels faces the light. Some of the subpixel
    # cells into which the pixels are subdivided face the light, but these cells are in shadow.
    heightfield, light = wd.gratings.fingers(size_um=6.4, seed=1), wd.DirectionalLight((0.5, 0.75, -0.8))
    eye, along = np.array([0.0, 3.4, 4.0]), unit((0.08311891, -0.69686178, -0.71237273))
    view = wd.View(tuple(eye), tuple(eye + along), fov_y_deg=0.148, width=4, height=4)
    options = {"coherence": wd.Coherence(sigma_um=3.25), "tolerance": 0.1, "pigment": 0.0, "strict": False}
    many = wd.View(tuple(eye), tuple(eye + along), fov_y_deg=0.148, width=96, height=96)
    snake = meshes.snake()
    points = wd.shade(snake, heightfield, light, many, footprint=False, **options)
    assert points.mask.sum() > 1000
    assert not points.illuminated.any()
    assert not wd.shade(snake, heightfield, light, view, refine=False, **options).illuminated.any()


def test_a_box_with_rounded_normals_is_in_the_shadow_of_a_plate():
    box, plate = trimesh.creation.box((2.0, 2.0, 0.2)), trimesh.creation.box((0.6, 0.6, 0.02))
    plate.apply_translation((0.0, 0.0, 0.5))
    mesh = trimesh.util.concatenate([box, plate])
    assert len(mesh.vertices) == 16, "corners of different sides must share their normals"
    view = wd.View((0.0, -4.0, 3.0), (0.0, 0.0, 0.0), fov_y_deg=30.0, width=48, height=36)
    options = {"coherence": wd.Coherence(sigma_um=2.0), "tolerance": 0.1, "tangents": "x", "footprint": False}
    light = wd.DirectionalLight((0.1, 0.05, 1.0))
    surface = wd.gratings.sinusoidal(2.0, 0.05)
    round_sides, flat_sides = (
        wd.shade(mesh, surface, light, view, smooth=smooth, **options) for smooth in (True, False)
    )
    unhidden = wd.shade(mesh, surface, light, view, smooth=False, shadows=False, **options)
    in_shadow = unhidden.illuminated & ~flat_sides.illuminated
    assert np.count_nonzero(in_shadow) > 20
    assert not round_sides.illuminated[in_shadow].any()
