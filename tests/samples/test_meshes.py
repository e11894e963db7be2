"""The sample bodies: shape, texture seam, and direction of the tangents."""

import math

import numpy as np
import pytest
import trimesh

from warpdiff import meshes
from warpdiff.scene.mesh_geometry import is_closed
from warpdiff.scene.mesh_import import prepare_surface


def world(surface):
    return surface.vertices.astype(np.float64) * surface.radius + surface.centre


def test_disc_tangents_are_radial_and_normals_face_z():
    surface = prepare_surface(meshes.disc(segments=96, rings=6))
    points = world(surface)
    radial = points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.tangents, radial, atol=2e-3)
    np.testing.assert_array_equal(surface.normals, np.broadcast_to([0, 0, 1], points.shape))
    np.testing.assert_array_equal(surface.handedness, 1.0)
    assert not surface.has_base_colour


def test_a_disc_has_the_area_of_its_ring():
    mesh = meshes.disc(inner_radius=0.25, outer_radius=2.0)
    assert mesh.area == pytest.approx(math.pi * (4.0 - 0.0625), rel=1e-4)
    assert len(mesh.faces) < 60_000
    # A disc without a hole must have triangles around its centre, and no face without area.
    full = prepare_surface(meshes.disc(inner_radius=0.0, segments=64, rings=4))
    assert len(full.faces) == 64 * (2 * 3 + 1)


@pytest.mark.parametrize("tangent", ["around", "along"])
def test_a_straight_tube_has_exact_normals_and_tangents(tangent):
    mesh = meshes.tube(radius=0.1, length=2.0, bend_deg=0.0, tangent=tangent, segments_along=96, segments_around=48)
    surface = prepare_surface(mesh)
    points = world(surface)
    # Only the cylindrical part of the tube is tested; its axis is along x.
    body = (points[:, 0] > -0.7) & (points[:, 0] < 0.1)
    outward = points[body] * [0.0, 1.0, 1.0] / 0.1
    np.testing.assert_allclose(surface.normals[body], outward, atol=1e-5)
    along = np.array([1.0, 0.0, 0.0])
    expected = np.cross(along, outward) if tangent == "around" else np.broadcast_to(along, outward.shape)
    # Tangents around the tube and the v axis along the tube form a right-handed frame with the normal.
    np.testing.assert_allclose(surface.tangents[body], expected, atol=1e-3)
    np.testing.assert_array_equal(surface.handedness, 1.0)


def test_the_default_tube_has_few_faces_that_are_oriented_outwards():
    mesh = meshes.tube()
    surface = prepare_surface(mesh)
    assert len(surface.faces) == len(mesh.faces) == 2 * 255 * 96 < 60_000
    # The faces are oriented outwards, so the volume is positive.
    volume = np.einsum("ij,ij->", mesh.triangles[:, 0], np.cross(mesh.triangles[:, 1], mesh.triangles[:, 2])) / 6.0
    assert volume > 0.0
    # The analytic normals must agree with normals that are computed from the faces around each vertex.
    bare = type(mesh)(mesh.vertices, mesh.faces, visual=mesh.visual, process=False)
    cosine = np.sum(surface.normals * prepare_surface(bare).normals, axis=1)
    assert cosine.min() > math.cos(math.radians(3.0))


@pytest.mark.parametrize(
    ("mesh", "axis"), [(meshes.tube(segments_along=48, segments_around=24), 0), (meshes.disc(segments=48), 1)]
)
def test_vertices_and_frames_are_equal_on_both_sides_of_the_texture_seam(mesh, axis):
    surface = prepare_surface(mesh)
    first, last = (np.flatnonzero(surface.uvs[:, axis] == end) for end in (0.0, 1.0))
    assert len(first) == len(last) > 2
    np.testing.assert_array_equal(surface.vertices[first], surface.vertices[last])
    np.testing.assert_allclose(surface.normals[first], surface.normals[last], atol=1e-6)
    np.testing.assert_allclose(surface.tangents[first], surface.tangents[last], atol=1e-6)


@pytest.mark.parametrize(
    ("make", "arguments", "error", "message"),
    [(meshes.tube, {"radius": 0.0}, ValueError, "radius must be"),
     (meshes.tube, {"length": 0.3}, ValueError, "length must be at least 5 radii"),
     (meshes.tube, {"bend_deg": -1.0}, ValueError, "bend_deg must be"),
     (meshes.tube, {"waves": 20.0}, ValueError, "bend_deg and waves must leave the bends wider"),
     (meshes.tube, {"segments_along": 3}, ValueError, "segments_along must be an integer, at least 12"),
     (meshes.disc, {"inner_radius": 1.0}, ValueError, "inner_radius must be below outer_radius"),
     (meshes.disc, {"inner_radius": -0.1}, ValueError, "inner_radius must be"),
     (meshes.disc, {"segments": 2}, ValueError, "segments must be an integer, at least 3"),
     (meshes.disc, {"rings": 0}, ValueError, "rings must be an integer, at least 1")],
)  # fmt: skip
def test_invalid_arguments_of_bodies_are_refused(make, arguments, error, message):
    with pytest.raises(error, match=message):
        make(**arguments)


def test_closed_bodies_are_distinguished_from_sheets():
    closed = {name: is_closed_body(getattr(meshes, name)()) for name in ("snake", "tube", "disc")}
    assert closed == {"snake": True, "tube": True, "disc": False}
    box = trimesh.creation.box()
    assert is_closed_body(box)
    box.invert()
    assert not is_closed_body(box), "its faces look inwards"
    box.invert()
    larger = trimesh.creation.icosphere(subdivisions=2, radius=3.0).apply_translation((9.0, 0.0, 0.0))
    assert is_closed_body(trimesh.util.concatenate([larger, box]))
    box.invert()
    assert not is_closed_body(trimesh.util.concatenate([larger, box])), "a part of it looks inwards"
    box.invert()
    box.update_faces(np.arange(12) != 3)
    assert not is_closed_body(box)


def is_closed_body(mesh):
    return is_closed(mesh.vertices.T, mesh.faces.T)


def test_a_card_has_the_texture_coordinates_of_an_image():
    card = meshes.card(4.0, 2.0)
    np.testing.assert_allclose(card.visual.uv, card.vertices[:, :2] / [4.0, 2.0] + 0.5)
    np.testing.assert_allclose(card.face_normals, [[0.0, 0.0, 1.0]] * 2)
    with pytest.raises(ValueError, match="height must be"):
        meshes.card(1.0, 0.0)
