"""Primary rays, shading frames and base colours of the kernels, compared with brute force in float64."""

import dataclasses
import itertools

import numpy as np
import pytest
import trimesh
import warp as wp
from conftest import launch, slow
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from bench.truth.brute_force import intersect, pixel_rays, shading_frame
from warpdiff import meshes
from warpdiff.kernels import base_colours, bvh, compile_options, primary_hits, refinement_levels
from warpdiff.kernels.structs import Cells, Pixels, Sampling
from warpdiff.render import pixel_filter
from warpdiff.scene.camera import View
from warpdiff.scene.device_mesh import SceneArrays, camera, needs_shadow_rays
from warpdiff.scene.mesh_import import prepare_surface

OUTPUTS = ("hit", "face", "tangent", "bitangent", "normal", "to_view", "shadow_origin", "base_colour")


def cast(surface, view, *, smooth=True, sample=0, samples=1, seed=0, slices=1, scene=None, covers=False):
    """Return the kernels' outputs by name, each of shape (height * width, ...).

    With ``covers`` the kernels rasterize the faces, otherwise they trace camera rays.
    """
    scene = scene or SceneArrays(surface, smooth=smooth, device="cpu")
    sampling = Sampling()
    count = view.width * view.height
    pixels = pixels_for(count)
    axes = camera_of(view, surface)
    pixels.nearest = wp.full(count, primary_hits.UNSEEN, dtype=wp.uint64, device="cpu")
    sampling.offsets = wp.empty(count if samples > 1 else 0, dtype=wp.vec2d, device="cpu")
    find = (bvh.trace_bvh, count, [axes, scene.with_hierarchy(), sampling])
    if covers:
        neighbour_extent = refinement_levels.FILTER_CUT if samples > 1 else 0.0
        find = (primary_hits.rasterize, scene.face_count, [axes, scene.bare, sampling, Cells(), neighbour_extent])
    launches = [
        (primary_hits.place_samples, len(sampling.offsets), [sample, seed], [sampling.offsets]),
        (*find, [pixels.nearest]),
        (primary_hits.intersect_known_faces, count, [axes, scene.bare, sampling, pixels], []),
        (primary_hits.make_shading_frames, count, [scene.bare, pixels], []),
    ]
    if scene.is_textured:
        inputs = [axes, scene.bare, scene.textures, pixels, 0.0]
        launches.append((base_colours.sample_base_colours, count, inputs, []))
    for kernel, size, arguments, outputs in launches:
        for begin, end in itertools.pairwise(np.linspace(0, size, slices + 1).astype(int)):
            shape = (1, 1) if kernel is base_colours.sample_base_colours else 1
            launch(kernel, shape, [*arguments, int(begin), int(end - begin)], outputs, device="cpu")
    return {name: getattr(pixels, name).numpy() for name in OUTPUTS}


def pixels_for(count):
    """Return output arrays for ``count`` camera rays."""
    pixels = Pixels()
    for name in OUTPUTS:
        dtype = wp.int32 if name in ("hit", "face") else wp.vec3f
        setattr(pixels, name, wp.zeros(count, dtype=dtype, device="cpu"))
    pixels.place = wp.zeros(count, dtype=wp.vec2f, device="cpu")
    return pixels


def camera_of(view, surface):
    return camera(view, surface, axes=wp.empty(5, dtype=wp.vec3d, device="cpu"))


def world(surface):
    return surface.vertices.astype(np.float64) * surface.radius + surface.centre


def torn(surface):
    """Return the same surface with three vertices per face, whose base colours are barycentric coordinates."""
    corner = surface.faces.ravel()
    arrays = {
        name: np.ascontiguousarray(getattr(surface, name)[corner])
        for name in ("vertices", "normals", "tangents", "handedness", "uvs")
    }
    faces = np.arange(len(corner), dtype=np.int32).reshape(-1, 3)
    colours = np.tile(np.eye(3, dtype=np.float32), (len(faces), 1))
    return dataclasses.replace(surface, faces=faces, vertex_colours=colours, **arrays)


# Test meshes with camera views. The disc is viewed from behind.
SCENES = {
    "tube": (meshes.tube(segments_along=40, segments_around=24),
             View((0.5, 1.9, 1.2), (0.1, 0, 0), width=50, height=34)),
    "disc": (meshes.disc(segments=48, rings=3), View((0.4, 0.3, -2.2), (0, 0, 0), width=42, height=40)),
    "sphere": (trimesh.creation.icosphere(subdivisions=2),
               View((1.5, 2.5, 1.0), (0, 0, 0), fov_y_deg=36, width=42, height=40)),
    "bottle": (None, View.orthographic((0.3,) * 3, (0, 0, 0.11), up=(0, 0, 1), extent_y=0.25, width=36, height=44)),
}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("covers", [True, False], ids=["cover", "rays"])
def test_hits_and_shading_frames_equal_brute_force(scene, covers, smooth, request):
    mesh, view = SCENES[scene]
    mesh = mesh or request.getfixturevalue("fuze_path")
    tangents = [[0.2, 1.0, 0.3]] * len(mesh.vertices) if scene == "sphere" else None
    surface = torn(prepare_surface(mesh, tangents=tangents))
    got = cast(surface, view, smooth=smooth, covers=covers)

    fov = None if view.extent_y else view.fov_y_deg
    size = {"width": view.width, "height": view.height, "fov_y_deg": fov, "extent_y": view.extent_y}
    origins, directions = pixel_rays(view.eye, view.target, view.up, **size)
    vertices = world(surface)
    t, face, bary, margin = intersect(origins, directions, vertices, surface.faces)

    # If a ray passes through an edge, rounding to float32 decides which face it hits. The faces of such rays are not
    # compared, but the distances of their hit points are.
    edge = margin < 1e-5
    assert np.count_nonzero(edge) < 0.005 * len(edge)
    sure = ~edge
    np.testing.assert_array_equal(got["hit"][sure], (face >= 0)[sure])
    np.testing.assert_array_equal(got["face"][sure], face[sure])
    hit = (got["hit"] == 1) & (face >= 0)
    assert np.count_nonzero(hit) > 0.1 * len(hit)
    place = np.einsum("kc,kcd->kd", got["base_colour"][hit], vertices[surface.faces[got["face"][hit]]])
    np.testing.assert_allclose(np.sum((place - origins[hit]) * directions[hit], axis=1) / t[hit], 1.0, atol=2e-5)
    hit &= sure
    # Faces viewed at grazing angles are excluded, because 1 / cos θ magnifies rounding errors of the position there.
    corners = vertices[surface.faces[face]]
    geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    grazing = np.abs(np.sum(geometric * directions, axis=1)) / np.linalg.norm(geometric, axis=1)
    hit &= grazing > 0.02
    np.testing.assert_allclose(got["base_colour"][hit], bary[hit], atol=2e-4)
    frame = shading_frame(
        face[hit], bary[hit], directions[hit], vertices, surface.faces,
        **{name: getattr(surface, name).astype(np.float64) for name in ("normals", "tangents", "handedness")},
        smooth=smooth,
    )  # fmt: skip
    for name, expected in zip(("tangent", "bitangent", "normal"), frame, strict=True):
        error = np.linalg.norm(got[name][hit] - expected, axis=1)
        assert np.median(error) < 1e-6, name
        assert np.max(error) < 1e-3, name
        assert np.mean(error > 2e-5) < 0.01, name
    np.testing.assert_allclose(got["to_view"][hit], -directions[hit], atol=3e-7)
    for name in OUTPUTS[2:]:
        np.testing.assert_array_equal(got[name][got["hit"] == 0], 0.0)
    np.testing.assert_array_equal(got["face"] == -1, got["hit"] == 0)


def wall(corner_colours=None, size=100.0):
    """Return a square in the plane z = 0 with u along x and v along y, covered by one repetition of the texture."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) * size / 2.0
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    material = None if corner_colours is None else SimpleMaterial(image=corner_colours)
    visual = TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


def test_perspective_rays_pass_through_pixel_centres():
    surface = prepare_surface(wall())
    width, height = 8, 6
    got = cast(surface, View((0, 0, 2.0), (0, 0, 0), fov_y_deg=90, width=width, height=height))
    away = got["to_view"].reshape(height, width, 3).astype(np.float64)
    # Positions at which the camera rays cross a plane at the distance 1 in front of the eye. As the field of view is
    # 90°, the unit is half the height of the picture. Row 0 of the picture is at the top.
    place = -away[..., :2] / away[..., 2:]
    np.testing.assert_allclose(place[..., 1], np.broadcast_to(((2.5 - np.arange(6)) / 3.0)[:, None], (6, 8)), atol=1e-6)
    np.testing.assert_allclose(place[..., 0], np.broadcast_to((np.arange(8) - 3.5) / 3.0, (6, 8)), atol=1e-6)


def test_orthographic_rays_pass_through_pixel_centres():
    surface = prepare_surface(wall(size=4.0))
    got = cast(surface, View.orthographic((0, 0, 2.0), (0, 0, 0), extent_y=3.0, width=8, height=6), smooth=False)
    np.testing.assert_allclose(got["to_view"], np.tile([[0, 0, 1.0]], (48, 1)), atol=1e-7)
    place = (got["shadow_origin"] * surface.radius + surface.centre).reshape(6, 8, 3)
    np.testing.assert_allclose(place[..., 0], np.broadcast_to((np.arange(8) - 3.5) * 0.5, (6, 8)), atol=1e-6)
    np.testing.assert_allclose(place[..., 1], np.broadcast_to(((2.5 - np.arange(6)) * 0.5)[:, None], (6, 8)), atol=1e-6)


@pytest.mark.parametrize("covers", [True, False], ids=["cover", "rays"])
def test_a_distant_eye_loses_no_precision(covers):
    mesh = meshes.disc(segments=24, rings=2)
    surface = prepare_surface(mesh)
    frames = []
    for distance in (1e3, 1e7):
        fov = np.degrees(2.0 * np.arctan(1.2 / distance))
        view = View((0, 0, distance), (0, 0, 0), fov_y_deg=float(fov), width=64, height=64)
        frames.append(cast(surface, view, covers=covers))
    assert np.mean(frames[0]["hit"] != frames[1]["hit"]) < 0.002
    both = (frames[0]["hit"] == 1) & (frames[1]["hit"] == 1)
    np.testing.assert_allclose(frames[0]["tangent"][both], frames[1]["tangent"][both], atol=3e-3)


def test_rasterized_faces_leave_no_gap_at_common_edges():
    # The camera looks at the mesh once frontally and twice obliquely. A vertex is at a pixel centre in all pictures. In
    # the frontal picture, the four edges from this vertex pass through pixel centres.
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0.0]])
    mesh = trimesh.Trimesh(vertices, [[4, 0, 1], [4, 1, 2], [4, 2, 3], [4, 3, 0]], process=False)
    surface = prepare_surface(mesh, tangents=[[1.0, 0.0, 0.0]] * 5)
    for eye in ((0, 0, 3.0), (0.3, -0.2, 2.0), (1.1, 0.9, 1.7)):
        got = cast(surface, View(eye, (0, 0, 0), fov_y_deg=10, width=65, height=65), covers=True)
        assert np.all(got["hit"] == 1)


# The mesh named "plane" has two faces that extend far behind the eye.
AROUND_THE_EYE = {
    "tube": (meshes.tube(segments_along=24, segments_around=12),
             View((0.2, 0.05, 0.0), (1.0, 0.1, 0.2), width=70, height=50)),
    "plane": (wall(size=40.0), View((0.3, -0.2, 0.5), (0.9, 4.0, 0.1), up=(0, 0, 1), width=64, height=48)),
    "sphere": (trimesh.creation.icosphere(subdivisions=3),
               View.orthographic((0.2, 0.1, 0.3), (0, 0, 0), extent_y=1.6, width=60, height=44)),
}  # fmt: skip


@pytest.mark.parametrize(("mesh", "view"), AROUND_THE_EYE.values(), ids=AROUND_THE_EYE)
@pytest.mark.parametrize("samples", [1, 8])
def test_faces_are_clipped_behind_the_eye(mesh, view, samples):
    surface = prepare_surface(mesh, tangents=np.tile([0.3, 1.0, 0.2], (len(mesh.vertices), 1)))
    scene = SceneArrays(surface, device="cpu")
    options = {"scene": scene, "sample": samples // 2, "samples": samples}
    result, by_rays = (cast(surface, view, covers=covers, **options) for covers in (True, False))
    assert by_rays["hit"].mean() > 0.2
    # If a ray passes through the common edge of two faces, it must hit one of them, but rounding decides which.
    # Rasterization and traced rays may therefore find different faces in a few pixels.
    np.testing.assert_array_equal(result["hit"], by_rays["hit"])
    same = result["face"] == by_rays["face"]
    assert same.mean() > 0.998
    for name in ("normal", "to_view"):
        np.testing.assert_allclose(result[name][same], by_rays[name][same], atol=1e-5)


def test_an_eye_close_to_a_face_sees_no_gap():
    """A camera ray from an eye inside a closed mesh must hit a face in every direction."""
    surface = prepare_surface(trimesh.creation.icosphere(subdivisions=2), tangents=np.tile([0.3, 1.0, 0.2], (162, 1)))
    scene = SceneArrays(surface, device="cpu")
    rng = np.random.default_rng(5)
    for depth in np.geomspace(3e-6, 0.1, 24):
        face = surface.vertices[surface.faces[rng.integers(len(surface.faces))]].astype(np.float64)
        eye = (1.0 - depth) * rng.dirichlet((1.0, 1.0, 1.0)) @ face * surface.radius + surface.centre
        camera_view = View(tuple(eye), tuple(eye + rng.normal(size=3)), fov_y_deg=100.0, width=40, height=30)
        assert np.all(cast(surface, camera_view, scene=scene, covers=True)["hit"] == 1)


# Meshes and views for tests of refined pixels. The mesh named "plates" is a small plate above a large one. In pixels at
# the border of the upper plate, some subpixel cells show the upper and others the lower plate. In the mesh named "far
# away", faces are smaller than a pixel.
CELLS = {
    "plates": (trimesh.Scene([wall(size=2.0), wall(size=1.0).apply_translation([0.0, 0.0, 0.3])]),
               View((0.4, -2.0, 2.5), (0, 0, 0), fov_y_deg=22, width=70, height=44)),
    "far away": (meshes.tube(segments_along=64, segments_around=48),
                 View((1.0, 4.0, 9.0), (0, 0, 0), width=130, height=96)),
    "head on": (meshes.disc(segments=24, rings=4),
                View.orthographic((0.3, 0.2, 3.0), (0, 0, 0), extent_y=1.5, width=64, height=40)),
}  # fmt: skip


@pytest.mark.parametrize(("mesh", "view"), CELLS.values(), ids=CELLS)
@pytest.mark.parametrize("level", refinement_levels.LEVELS)
@pytest.mark.parametrize("slices", [slow(1), 7])
def test_rasterized_cells_equal_traced_cells(mesh, view, level, slices):
    surface = prepare_surface(mesh)
    scene = SceneArrays(surface, device="cpu")
    # The refined pixels, which are divided into subpixel cells, are random and unsorted. They include pixels at the
    # picture's border and outside of the mesh.
    rng = np.random.default_rng(3)
    chosen = rng.permutation(view.width * view.height)[: view.width * view.height // (2 * level)].astype(np.int32)
    cells = pixel_filter.grid_of(chosen, level, view.width, view.height, wp.get_device("cpu"))
    count = len(chosen) * refinement_levels.rays_at(level)
    nearest = wp.full(count, primary_hits.UNSEEN, dtype=wp.uint64, device="cpu")
    camera = camera_of(view, surface)
    for begin, end in itertools.pairwise(np.linspace(0, scene.face_count, slices + 1).astype(int)):
        inputs = [camera, scene.bare, Sampling(), cells, 0.0, int(begin), int(end - begin)]
        launch(primary_hits.rasterize, 1, inputs, [nearest], device="cpu")
    sampling = Sampling()
    sampling.tiles = wp.array(chosen, dtype=wp.int32, device="cpu")
    sampling.places = pixel_filter.places_at(level, "cpu")
    result = []
    by_rays = wp.empty_like(nearest)
    launch(bvh.trace_bvh, 1, [camera, scene.with_hierarchy(), sampling, 0, count], [by_rays], device="cpu")
    for faces in (nearest, by_rays):
        pixels = pixels_for(count)
        pixels.nearest = faces
        # The subpixel cells are divided into slices, which are processed one after another. With 7 slices, some slices
        # begin in the middle of a pixel.
        for begin, end in itertools.pairwise(np.linspace(0, count, slices + 1).astype(int)):
            inputs = [camera, scene.bare, sampling, pixels, int(begin), int(end - begin)]
            launch(primary_hits.intersect_known_faces, 1, inputs, device="cpu")
        result.append([getattr(pixels, name).numpy() for name in ("face", "hit", "place", "to_view")])
    (face, hit, place, to_view), (face_by_rays, _, place_by_rays, view_by_rays) = result
    np.testing.assert_array_equal(hit, face >= 0)
    # If a ray passes through an edge, rounding decides which face it hits. A few subpixel cells may therefore have
    # another face than traced rays find.
    assert np.mean(face != face_by_rays) < 2e-3
    same = (face == face_by_rays) & (face >= 0)
    assert np.count_nonzero(same) > 200
    np.testing.assert_allclose(place[same], place_by_rays[same], atol=1e-3)
    np.testing.assert_allclose(to_view[same], view_by_rays[same], atol=1e-6)


def test_rasterization_writes_only_the_cells_of_refined_pixels():
    surface = prepare_surface(wall(size=400.0))
    scene = SceneArrays(surface, device="cpu")
    view = View((0, 0, 3.0), (0, 0, 0), width=130, height=3)
    # A mask with one bit per pixel, in words of 64 bits, marks the refined pixels. In this test they are at the ends of
    # words and of picture rows.
    pixels = np.array([0, 63, 64, 129, 130, 193, 389], dtype=np.int32)
    cells = pixel_filter.grid_of(pixels, 2, view.width, view.height, wp.get_device("cpu"))
    count = 16 * len(pixels)
    nearest = wp.full(count + 500, primary_hits.UNSEEN, dtype=wp.uint64, device="cpu")
    inputs = [camera_of(view, surface), scene.bare, Sampling(), cells, 0.0, 0, scene.face_count]
    launch(primary_hits.rasterize, 1, inputs, [nearest], device="cpu")
    met = nearest.numpy() != int(primary_hits.UNSEEN)
    assert np.all(met[:count])
    assert not np.any(met[count:])


@pytest.mark.parametrize("covers", [True, False], ids=["cover", "rays"])
def test_the_number_of_slices_does_not_change_a_picture(covers):
    surface = prepare_surface(meshes.tube(segments_along=24, segments_around=12))
    view = View((0.5, 2, 2), (0, 0, 0), width=33, height=21)
    scene = SceneArrays(surface, device="cpu")
    sampling = {} if covers else {"samples": 4, "sample": 1}
    whole, parts = (cast(surface, view, scene=scene, slices=n, covers=covers, **sampling) for n in (1, 7))
    for name in OUTPUTS:
        np.testing.assert_array_equal(whole[name], parts[name])


def offsets(sample, samples, seed=0, width=64, height=48):
    """Return ray offsets (right, down) in pixels, computed from the hits of orthographic rays on a wall."""
    surface = prepare_surface(wall(size=200.0))
    view = View.orthographic((0, 0, 2.0), (0, 0, 0), extent_y=float(height), width=width, height=height)
    got = cast(surface, view, smooth=False, sample=sample, samples=samples, seed=seed)
    place = got["shadow_origin"] * surface.radius + surface.centre
    rows, columns = np.divmod(np.arange(width * height), width)
    return np.stack([place[:, 0] - (columns + 0.5 - width / 2), height / 2 - rows - 0.5 - place[:, 1]], axis=1)


def test_offsets_of_rays_are_samples_of_a_truncated_gaussian():
    np.testing.assert_allclose(offsets(0, 1), 0.0, atol=3e-5)
    np.testing.assert_array_equal(offsets(3, 8), offsets(3, 8))
    all_of_them = np.stack([offsets(k, 16) for k in range(16)])
    assert np.linalg.norm(all_of_them, axis=2).max() < 1.5 + 3e-5
    flat = all_of_them.reshape(-1, 2)
    np.testing.assert_allclose(flat.mean(axis=0), 0.0, atol=0.005)
    # The offsets of rays have a Gaussian distribution with the standard deviation σ = 0.5, truncated at the radius
    # c = 1.5. The mean of the squared offset is 2σ² − c² e / (1 − e) with e = exp(−c² / 2σ²) = exp(−4.5).
    e = np.exp(-4.5)
    std = np.sqrt((0.5 - 2.25 * e / (1.0 - e)) / 2.0)
    np.testing.assert_allclose(flat.std(axis=0), std, rtol=0.01)
    assert abs(np.corrcoef(flat.T)[0, 1]) < 0.01
    # The offsets of a pixel's 16 rays have low discrepancy: their mean is much closer to 0 than for independent random
    # offsets, whose mean has a standard deviation of σ / 4.
    assert all_of_them.mean(axis=0).std() < 0.5 * std / 4.0
    # The sample pattern is rotated differently in each pixel and for each seed, so that samples of neighbouring pixels,
    # and those of two seeds, are uncorrelated.
    assert abs(np.corrcoef(all_of_them[0, :-1, 0], all_of_them[0, 1:, 0])[0, 1]) < 0.1
    assert np.mean(offsets(0, 16, seed=1) == all_of_them[0]) < 0.01


@pytest.mark.parametrize("mirrored", [False, True])
def test_both_sides_of_a_face_have_a_shading_frame(mirrored):
    mesh = wall(size=2.0)
    if mirrored:
        mesh.visual.uv = mesh.visual.uv * [1.0, -1.0]
    surface = prepare_surface(mesh)
    sign = -1.0 if mirrored else 1.0
    for z in (2.0, -2.0):
        got = cast(surface, View((0, 0, z), (0, 0, 0), fov_y_deg=20, width=4, height=4))
        assert np.all(got["hit"] == 1)
        np.testing.assert_allclose(got["normal"], np.tile([[0, 0, np.sign(z)]], (16, 1)), atol=1e-6)
        np.testing.assert_allclose(got["tangent"], np.tile([[1, 0, 0]], (16, 1)), atol=1e-6)
        # The bitangent is n × t with the normal turned to the viewer, times the handedness of the texture coordinates.
        np.testing.assert_allclose(got["bitangent"], np.tile([[0, sign * np.sign(z), 0]], (16, 1)), atol=1e-6)
        assert np.all(got["shadow_origin"][:, 2] * np.sign(z) > 0.0)


def test_shading_normals_that_face_away_are_tilted_to_a_cosine_of_0_01():
    mesh = wall(size=2.0)
    # Two shading normals are tested with their viewers. One normal is tilted away from the viewer, and the other points
    # almost directly away from the viewer. The kernel must tilt both until their cosine to the viewer is 0.01.
    for normal, eye in [((-0.8, 0.0, 0.6), (5.0, 0.0, 1.0)), ((-0.99, 0.0, -0.14), (5.0, 0.0, 1.0))]:
        normals = np.tile(np.array(normal) / np.linalg.norm(normal), (4, 1)).astype(np.float32)
        surface = dataclasses.replace(prepare_surface(mesh), normals=normals)
        got = cast(surface, View(eye, (0, 0, 0), up=(0, 0, 1), fov_y_deg=5, width=16, height=4))
        hit = got["hit"] == 1
        cosine = np.sum(got["normal"] * got["to_view"], axis=1, dtype=np.float64)[hit]
        np.testing.assert_allclose(cosine, 0.01, atol=2e-7)
        np.testing.assert_allclose(np.linalg.norm(got["normal"][hit], axis=1), 1.0, atol=1e-6)
        # The tilted normal stays in the plane of the original normal and the view direction.
        aside = np.cross(got["normal"][hit], got["to_view"][hit])
        np.testing.assert_allclose(np.sum(aside * surface.normals[0], axis=1), 0.0, atol=1e-6)


def test_a_normal_directly_away_from_the_viewer_has_a_defined_frame():
    surface = dataclasses.replace(prepare_surface(wall(size=2.0)), normals=np.tile(np.float32([[0, 0, -1]]), (4, 1)))
    got = cast(surface, View.orthographic((0, 0, 2), (0, 0, 0), extent_y=1.0, width=3, height=3))
    assert np.all(got["hit"] == 1)
    for name in ("tangent", "bitangent", "normal"):
        np.testing.assert_allclose(np.linalg.norm(got[name], axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(got["normal"][:, 2], 0.01, atol=1e-7)


@pytest.mark.parametrize("tangent", [(0, 0, 1), (0, 0, 0), (1e-30, 0, 1)])
def test_a_tangent_along_the_normal_has_a_defined_frame(tangent):
    surface = dataclasses.replace(prepare_surface(wall(size=2.0)), tangents=np.tile(np.float32([tangent]), (4, 1)))
    got = cast(surface, View((0, 0, 2), (0, 0, 0), fov_y_deg=20, width=3, height=3))
    frame = np.stack([got["tangent"], got["bitangent"], got["normal"]], axis=1)
    np.testing.assert_allclose(frame @ np.swapaxes(frame, 1, 2), np.tile(np.eye(3), (9, 1, 1)), atol=1e-6)


def test_textures_are_bilinear_and_periodic_with_row_0_at_the_top():
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    mesh = wall(Image.fromarray(pixels), size=2.0)
    view = View.orthographic((0, 0, 2), (0, 0, 0), extent_y=2.0, width=2, height=2)
    # Pixel centres coincide with texel centres in this view. Each pixel must therefore show the colour of one texel.
    got = cast(prepare_surface(mesh), view)["base_colour"].reshape(2, 2, 3)
    np.testing.assert_allclose(got, pixels / 255.0, atol=1e-5)
    # After a shift of the texture by half a texel, each pixel must show the mean of four texels, also across the
    # border.
    mesh.visual.uv = mesh.visual.uv + np.array([0.25, 0.25])
    got = cast(prepare_surface(mesh), view)["base_colour"]
    np.testing.assert_allclose(got, 0.5, atol=1e-5)
    mesh.visual.uv = mesh.visual.uv + np.array([-3.25, 6.75])
    got = cast(prepare_surface(mesh), view)["base_colour"].reshape(2, 2, 3)
    np.testing.assert_allclose(got, pixels / 255.0, atol=1e-5)


# The kernel of this test has the package's compile options. With other options, Warp would precompile its own C++
# headers once more.
wp.set_module_options(compile_options.options())


@wp.kernel
def shadow_rays(
    mesh_id: wp.uint64,
    origins: wp.array(dtype=wp.vec3f),
    direction: wp.vec3f,
    # Output of this kernel: 1 for each ray that hits a face, otherwise 0.
    occluded_out: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    occluded_out[i] = wp.where(wp.mesh_query_ray_anyhit(mesh_id, origins[i], direction, bvh.FAR), 1, 0)


def shadowed(scene, origins, direction):
    result = wp.zeros(len(origins), dtype=wp.int32, device="cpu")
    start = wp.array(origins, dtype=wp.vec3f, device="cpu")
    inputs = [scene.with_hierarchy().mesh_id, start, wp.vec3f(*(float(c) for c in direction))]
    launch(shadow_rays, dim=len(origins), inputs=inputs, outputs=[result], device="cpu")
    return result.numpy() == 1


def test_smooth_shading_has_no_jagged_terminator():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    surface = prepare_surface(sphere, tangents=[[0.2, 1.0, 0.3]] * len(sphere.vertices))
    scene = SceneArrays(surface, device="cpu")
    got = cast(surface, View((3, 0, 0), (0, 0, 0), width=96, height=96), scene=scene)
    hit = got["hit"] == 1
    direction = np.array([0.1, 0.3, 1.0]) / np.linalg.norm([0.1, 0.3, 1.0])
    illuminated = np.sum(got["normal"][hit] * direction, axis=1) > 0.0
    origins = got["shadow_origin"][hit]
    assert np.mean(shadowed(scene, origins[illuminated], direction)) < 0.005
    # Points on the half of a sphere opposite to the light are in the sphere's own shadow.
    dark = np.sum(got["normal"][hit] * direction, axis=1) < -0.3
    assert np.all(shadowed(scene, origins[dark], direction))


def test_shadows_are_cast():
    plates = trimesh.Scene([wall(size=2.0), wall(size=1.0).apply_translation([0, 0, 1.0])])
    surface = prepare_surface(plates)
    scene = SceneArrays(surface, smooth=False, device="cpu")
    view = View((0, -6, 0.3), (0, 0, 0), fov_y_deg=25, width=80, height=60)
    got = cast(surface, view, scene=scene)
    place = got["shadow_origin"] * surface.radius + surface.centre
    lower = (got["hit"] == 1) & (place[:, 2] < 0.5)
    below = np.max(np.abs(place[:, :2]), axis=1) < 0.5
    clear = np.abs(np.max(np.abs(place[:, :2]), axis=1) - 0.5) > 1e-3
    assert np.count_nonzero(lower & below) > 10
    dark = shadowed(scene, got["shadow_origin"], (0, 0, 1))
    np.testing.assert_array_equal(dark[lower & clear], below[lower & clear])


def test_convex_bodies_need_no_shadow_rays_from_outside():
    box = trimesh.creation.box()
    surface = prepare_surface(box, tangents=[[0.3, 0.5, 0.7]] * len(box.vertices))
    outside, inside = View((2, 1, 1), (0, 0, 0)), View((0.1, 0, 0), (1, 0, 0))
    assert not needs_shadow_rays(surface, outside)
    assert needs_shadow_rays(surface, inside)
    assert not needs_shadow_rays(surface, View.orthographic((2, 0, 0), (0, 0, 0), extent_y=1))
    assert needs_shadow_rays(surface, View.orthographic((0.4, 0, 0), (0, 0, 0), extent_y=1))
    assert needs_shadow_rays(prepare_surface(meshes.tube(segments_along=24, segments_around=12)), outside)
