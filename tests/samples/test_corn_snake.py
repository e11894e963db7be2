"""The snake: a closed surface with the requested number of scales, their free edges, tangents and colour pattern."""

import math

import numpy as np
import pytest

from warpdiff import meshes
from warpdiff.scene.mesh_import import prepare_surface

SMALL = {"scale_rows": 15, "ventrals": 40, "segments": 2}


@pytest.fixture(scope="module")
def snake():
    return meshes.snake(**SMALL)


@pytest.fixture(scope="module")
def surface(snake):
    return prepare_surface(snake)


def face_normals(corners):
    """Return the unit normals of triangles (m, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross / np.linalg.norm(cross, axis=1, keepdims=True)


def degrees(cosine):
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def places(mesh):
    """Return an index of the position of each vertex. Vertices at the same position have the same index."""
    cells = np.round(mesh.vertices / 1e-8).astype(np.int64)
    return np.unique(cells, axis=0, return_inverse=True)[1].ravel()


@pytest.mark.parametrize(
    "arguments", [SMALL, {"scale_rows": 5, "ventrals": 8, "segments": 3, "bend_deg": 0.0, "tangent": "along"}]
)
def test_the_snake_is_closed_and_its_faces_are_oriented_outwards(arguments):
    mesh = meshes.snake(**arguments)
    place = places(mesh)
    edges = place[mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    forward, backward = edges @ [len(place), 1], edges @ [1, len(place)]
    # The surface is closed if each edge belongs to two faces, which use it in opposite directions.
    assert len(np.unique(forward)) == len(forward)
    np.testing.assert_array_equal(np.sort(forward), np.sort(backward))
    # The surface must have no handle. This is so if its Euler characteristic is 2, as for a sphere.
    assert len(np.unique(place)) - len(edges) // 2 + len(mesh.faces) == 2
    corners = mesh.vertices[mesh.faces]
    assert np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0.0
    assert mesh.vertices[:, 1].min() == 0.0


def test_the_default_snake_has_few_faces_and_none_too_narrow_for_float32():
    mesh = meshes.snake()
    assert 100_000 < len(mesh.faces) < 210_000
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    twice_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # Faces must not be too narrow: in float32, a triangle with a height below 1e-7 would have no area.
    assert np.min(twice_area / sides.max(axis=1)) > 5e-6
    cosine = np.einsum("ij,ikj->ik", face_normals(corners), mesh.vertex_normals[mesh.faces])
    assert np.percentile(degrees(cosine), 99.0) < 15.0
    assert cosine.min() > 0.0


def test_normals_of_vertices_are_near_those_of_their_faces(snake, surface):
    assert len(surface.faces) == len(snake.faces)
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-6)
    # The compared faces include those at the free edges of scales, where surfaces with different directions meet.
    cosine = np.einsum("ij,ikj->ik", face_normals(surface.vertices[surface.faces]), surface.normals[surface.faces])
    assert np.percentile(degrees(cosine), 99.0) < 30.0
    np.testing.assert_allclose(surface.normals, snake.vertex_normals, atol=1e-6)


def test_normals_are_continuous_across_the_texture_seam(surface):
    # At the texture seam, each vertex must have a twin with the same position and normal. Vertices at the snout and at
    # the tip of the tail are excluded.
    left, right = (
        np.flatnonzero((surface.uvs[:, 0] == end) & (np.abs(surface.uvs[:, 1] - 0.5) < 0.49)) for end in (0, 1)
    )
    assert len(left) == len(right) > 200
    same = np.all(surface.vertices[left, None] == surface.vertices[right], axis=2)
    cosine = np.where(same, surface.normals[left] @ surface.normals[right].T, -1.0)
    assert np.all(degrees(cosine.max(axis=1)) < 0.5)


@pytest.mark.parametrize("scale_rows", [7, 9])
def test_scales_have_the_requested_number(scale_rows):
    ventrals = 12
    mesh = meshes.snake(scale_rows=scale_rows, ventrals=ventrals, segments=2)
    # Scales overlap. Vertices at their corners therefore share texture coordinates but not positions. In texture
    # coordinates, the corners must be on a lattice whose points are half a scale apart along the body.
    belly, head, tail = 0.15, 16.0, 1.0
    x = (mesh.visual.uv[:, 0] - belly) / (1.0 - 2.0 * belly) * (scale_rows + 1)
    tau = mesh.visual.uv[:, 1] * (head + ventrals + tail) - head
    inside = (tau > 0.1) & (tau < ventrals - 0.1) & (x > 0.1) & (x < scale_rows + 0.9)
    cells = np.round(np.stack([x, 2.0 * tau], axis=1)[inside] * 1e6).astype(np.int64)
    places_in_texture, group = np.unique(cells, axis=0, return_inverse=True)
    place = places(mesh)[inside]
    least, most = np.full(len(places_in_texture), place.max()), np.zeros(len(places_in_texture), place.dtype)
    np.minimum.at(least, group.ravel(), place)
    np.maximum.at(most, group.ravel(), place)
    apart = places_in_texture[most > least] / 1e6
    corners = apart[np.all(np.abs(apart - np.round(apart)) < 1e-4, axis=1)]
    middle = np.round(corners[:, 1]) // 2 == ventrals // 2
    assert len(np.unique(np.round(corners[middle, 0]))) == scale_rows
    on_spine = corners[np.round(corners[:, 0]) == (scale_rows + 1) // 2]
    assert len(on_spine) in (ventrals - 1, ventrals)


@pytest.mark.parametrize("tangent", ["around", "along"])
def test_tangents_run_around_the_body_or_along_it(tangent):
    mesh = meshes.snake(**SMALL, bend_deg=0.0, tangent=tangent)
    surface = prepare_surface(mesh)
    np.testing.assert_array_equal(surface.handedness, 1.0)
    np.testing.assert_allclose(np.linalg.norm(surface.tangents, axis=1), 1.0, atol=1e-6)
    # The back of a straight snake is along x, so that the expected tangents are known. Vertices whose normals point to
    # the rear belong to free edges of scales, and are not compared.
    back = (surface.normals[:, 1] > 0.3) & (surface.normals[:, 0] < 0.1) & (np.abs(surface.vertices[:, 0]) < 0.6)
    along = np.array([1.0, 0.0, 0.0])
    around = np.cross(along, surface.normals[back])
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    expected = around if tangent == "around" else np.cross(surface.normals[back], around)
    assert degrees(np.sum(surface.tangents[back] * expected, axis=1)).max() < 4.0


def test_tangents_are_smooth_on_scales(surface):
    corners = surface.tangents[surface.faces]
    rotated = degrees(np.einsum("ijk,ijk->ij", corners, np.roll(corners, 1, axis=1))).max(axis=1)
    assert np.median(rotated) < 12.0
    assert np.percentile(rotated, 95.0) < 40.0


def test_the_snake_does_not_intersect_itself(snake):
    corners = snake.vertices[snake.faces]
    rng = np.random.default_rng(7)
    # No line segment within a face may intersect a nearby face. Segments within 250 random faces are tested.
    weights = rng.dirichlet([2.0, 2.0, 2.0], (250, 2))
    chosen = rng.choice(len(corners), 250, replace=False)
    start, end = (np.einsum("ij,ijk->ik", weights[:, k], corners[chosen]) for k in (0, 1))
    middles = corners.mean(axis=1)
    extent = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    gap = np.linalg.norm(middles[chosen, None] - middles[None], axis=2) - extent[chosen, None] - extent
    i, j = np.nonzero((gap < 0.0) & (chosen[:, None] != np.arange(len(corners))))
    a, b, c = (corners[j, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    before, after = (np.einsum("ij,ij->i", normal, ends[i] - a) for ends in (start, end))
    share = before / np.where(before == after, np.inf, before - after)
    at = start[i] + share[:, None] * (end - start)[i]
    inside = [np.einsum("ij,ij->i", normal, np.cross(q - p, at - p)) > 0.0 for p, q in ((a, b), (b, c), (c, a))]
    assert len(i) > 2500
    assert not np.any((before * after < 0.0) & np.all(inside, axis=0))


def test_the_pattern_depends_only_on_the_seed(snake):
    again, other = meshes.snake(**SMALL), meshes.snake(**SMALL, seed=1)
    one, two, three = (np.asarray(mesh.visual.material.image) for mesh in (snake, again, other))
    np.testing.assert_array_equal(one, two)
    assert np.mean(one != three) > 0.2
    for name in ("vertices", "faces", "vertex_normals"):
        np.testing.assert_array_equal(getattr(snake, name), getattr(again, name))
        np.testing.assert_array_equal(getattr(snake, name), getattr(other, name))


def test_both_orientations_of_the_texture_paint_the_same_snake(surface):
    along = prepare_surface(meshes.snake(**SMALL, tangent="along"))
    # Both orientations of the texture are right-handed: (u, v) becomes (v, 1 − u).
    np.testing.assert_array_equal(along.vertices, surface.vertices)
    np.testing.assert_allclose(along.uvs, surface.uvs[:, ::-1] * [1.0, -1.0] + [0.0, 1.0], atol=1e-6)
    (texture,), (other,) = surface.textures, along.textures
    np.testing.assert_array_equal(other.texels, texture.texels[::-1].transpose(1, 0, 2))


def test_the_pattern_has_its_colours_at_the_right_positions(surface):
    texels = surface.textures[0].texels[..., :3]
    height, width, _ = texels.shape

    def colour(u, v):
        return texels[int((1.0 - v) * height), int(u * width)]

    # The eyes are on the sides, behind the snout by 0.43 of the head's length, and their centres are black.
    for u in (0.335, 0.665):
        assert colour(u, 0.43 * 16.0 / 57.0).max() < 0.02
        assert colour(u, 0.43 * 16.0 / 57.0 + 0.03).max() > 0.1
    # The back is red or orange, and the underside is black or white.
    back, below = (np.array([colour(u, v) for v in np.linspace(0.35, 0.95, 40)]) for u in (0.5, 0.05))
    assert np.median(back[:, 0] / back[:, 2]) > 6.0
    assert np.max(below[:, 0] / below[:, 2]) < 3.0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [({"radius": 0.0}, ValueError, "radius must be"),
     ({"length": 1.0}, ValueError, r"length must be 16 to 1000 radii \(1\.92 to 120\), got 1"),
     ({"bend_deg": -1.0}, ValueError, "bend_deg must be"),
     ({"waves": 6.0}, ValueError, "bend_deg and waves must leave the bends wider than the body"),
     ({"bend_deg": 120.0, "waves": 1.6}, ValueError, "bend_deg must leave the bends apart, got 120"),
     ({"scale_rows": 3}, ValueError, "scale_rows must be an integer, at least 5"),
     ({"scale_rows": 26}, ValueError, "scale_rows must be odd"),
     ({"ventrals": 7}, ValueError, "ventrals must be an integer, at least 8"),
     ({"seed": -1}, ValueError, "seed must be"),
     ({"radius": math.inf}, ValueError, "radius must be")],
)  # fmt: skip
def test_invalid_arguments_of_the_snake_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        meshes.snake(**arguments)
