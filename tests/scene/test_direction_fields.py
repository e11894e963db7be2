"""Directions on meshes without texture coordinates: directions along and around axes, and smooth direction fields.

A direction field has a tangential vector at each vertex. A smooth field minimises the differences between neighbours.
"""

import os

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

import warpdiff as wd
from warpdiff import meshes
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.request.settings import TANGENT_RULES
from warpdiff.scene import direction_fields
from warpdiff.scene.mesh_import import prepare_surface

TURN = trimesh.transformations.rotation_matrix(0.4, (1.0, 2.0, 3.0))


def plate(steps=7, *, uv=False):
    """Return the mesh of a square plate in the plane z = 0, with triangles of different sizes."""
    sides = np.linspace(0.0, 1.0, steps) ** 1.3
    points = np.stack([*(axis.ravel() for axis in np.meshgrid(sides, sides, indexing="ij")), np.zeros(steps**2)], 1)
    corner = (np.arange(steps - 1)[:, None] * steps + np.arange(steps - 1)).ravel()
    faces = np.concatenate([corner[:, None] + (0, steps, steps + 1), corner[:, None] + (0, steps + 1, 1)])
    visual = TextureVisuals(uv=points[:, :2]) if uv else None
    return trimesh.Trimesh(points, faces, process=False, visual=visual)


def open_cylinder(length):
    mesh = trimesh.creation.cylinder(1.0, length, sections=24).subdivide().subdivide()
    is_cap = np.abs(mesh.face_normals[:, 2]) > 0.9
    mesh.update_faces(~is_cap)
    mesh.remove_unreferenced_vertices()
    return mesh


def blob(seed):
    """Return the mesh of a closed body with a random smooth shape."""
    rng, body = np.random.default_rng(seed), trimesh.creation.icosphere(subdivisions=2)
    waves = rng.normal(size=(3, 3))
    size = 1.0 + 0.2 * np.sin(body.vertices @ waves.T * 2.0).sum(axis=1)
    return trimesh.Trimesh(body.vertices * size[:, None] * rng.uniform(0.6, 1.4, 3), body.faces, process=False)


def moved_along(vector, start_normal, end_normal):
    """Return a tangential vector after the smallest rotation from one unit normal to another (Rodrigues' formula)."""
    axis = np.cross(start_normal, end_normal)
    sine, cosine = np.linalg.norm(axis), start_normal @ end_normal
    if sine < 1e-12:
        return vector
    axis = axis / sine
    return vector * cosine + np.cross(axis, vector) * sine + axis * (axis @ vector) * (1.0 - cosine)


def edge_weights(vertices, faces):
    """Return the cotangent weight of each mesh edge, by the indices of the edge's two vertices."""
    weights = {}
    for face in faces.tolist():
        for k in range(3):
            one, two, opposite = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            a, b = vertices[one] - vertices[opposite], vertices[two] - vertices[opposite]
            cotangent = a @ b / np.linalg.norm(np.cross(a, b))
            key = min(one, two), max(one, two)
            weights[key] = weights.get(key, 0.0) + 0.5 * max(cotangent, 2e-3)
    return weights


def dense_problem(surface):
    """Return the matrix of the smoothness energy of a direction field, and the area and the basis of each vertex.

    The energy is the sum of weighted squared differences between the vectors of neighbouring vertices. The basis of a
    vertex is two tangential unit vectors. For n vertices, the matrix has the shape (2n, 2n).
    """
    vertices, normals = surface.vertices.astype(float), surface.normals.astype(float)
    count = len(vertices)
    bases = []
    for normal in normals:
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        bases.append(np.stack([first, np.cross(normal, first)]))
    energy, areas = np.zeros((count, 2, count, 2)), np.zeros(count)
    for (i, j), weight in edge_weights(vertices, surface.faces).items():
        transport = np.stack([bases[i] @ moved_along(axis, normals[j], normals[i]) for axis in bases[j]], axis=1)
        energy[i, :, i] += weight * np.eye(2)
        energy[j, :, j] += weight * np.eye(2)
        energy[i, :, j] -= weight * transport
        energy[j, :, i] -= weight * transport.T
    for face in surface.faces:
        a, b, c = vertices[face]
        areas[face] += np.linalg.norm(np.cross(b - a, c - a)) / 6.0
    return energy.reshape(2 * count, 2 * count), areas, np.array(bases)


@pytest.mark.parametrize("seed", range(3))
def test_the_smooth_field_is_the_least_eigenvector_of_a_dense_matrix(seed):
    surface = prepare_surface(blob(seed), tangents="smooth")
    energy, areas, bases = dense_problem(surface)
    scale = np.repeat(areas**-0.5, 2)
    eigenvalues, vectors = np.linalg.eigh(energy * scale[:, None] * scale)
    least = vectors[:, eigenvalues <= 1.02 * eigenvalues[0]] * scale[:, None]
    got = np.einsum("nij,nj->ni", bases, surface.tangents.astype(float))
    # Each eigenvalue has two eigenvectors: a direction field, and the same field rotated by 90°. The tested field must
    # be a combination of the eigenvectors of the smallest eigenvalue, scaled to unit length at each vertex.
    lengths = np.linalg.norm((least @ np.linalg.lstsq(least, got.ravel(), rcond=None)[0]).reshape(-1, 2), axis=1)
    for _ in range(200):
        fitted = (least @ np.linalg.lstsq(least, (got * lengths[:, None]).ravel(), rcond=None)[0]).reshape(-1, 2)
        lengths = np.linalg.norm(fitted, axis=1)
    cosines = np.sum(fitted * got, axis=1) / lengths
    # Directions are uncertain near singular points, where the eigenvector's value at a vertex is nearly zero.
    assert np.degrees(np.arccos(np.clip(cosines[lengths > 0.1 * lengths.max()].min(), -1.0, 1.0))) < 0.5


def test_the_smooth_field_of_a_plate_is_constant_along_x():
    flat = plate()
    np.testing.assert_allclose(prepare_surface(flat, tangents="smooth").tangents, np.eye(3)[[0] * 49], atol=1e-6)
    flat.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2.0, (0, 1, 0)))
    # On a plate perpendicular to the x axis, the field must be along the y axis instead.
    np.testing.assert_allclose(prepare_surface(flat, tangents="smooth").tangents, np.eye(3)[[1] * 49], atol=1e-6)


@pytest.mark.parametrize("length", [0.5, 6.0])
def test_the_smooth_field_of_a_cylinder_keeps_its_angle_to_the_axis(length):
    surface = prepare_surface(open_cylinder(length), tangents="smooth")
    along = surface.tangents[:, 2]
    np.testing.assert_allclose(along, along[0], atol=1e-3)


def singular_indices(surface):
    """Return the index (winding number) of a mesh's tangent field in each face.

    The index is the number of turns of the field along the border of the face, plus the curvature of the face in turns.
    """
    normals, tangents = surface.normals.astype(float), surface.tangents.astype(float)
    indices = []
    for face in surface.faces:
        angle, start = 0.0, tangents[face[0]]
        carried = start
        for i, j in zip(face, np.roll(face, -1), strict=True):
            moved = moved_along(tangents[i], normals[i], normals[j])
            angle += np.arctan2(normals[j] @ np.cross(moved, tangents[j]), moved @ tangents[j])
            carried = moved_along(carried, normals[i], normals[j])
        # After parallel transport around the face, a vector has turned by the angle that equals the enclosed curvature.
        angle += np.arctan2(normals[face[0]] @ np.cross(start, carried), start @ carried)
        indices.append(angle / (2.0 * np.pi))
    return np.array(indices)


@pytest.mark.parametrize(("body", "sum_"), [("sphere", 2), ("blob", 2), ("torus", 0)])
def test_indices_of_singular_points_add_up_to_the_euler_characteristic(body, sum_):
    mesh = {
        "sphere": trimesh.creation.icosphere(subdivisions=3), "blob": blob(7),
        "torus": trimesh.creation.torus(1.0, 0.35, major_sections=48, minor_sections=24),
    }[body]  # fmt: skip
    mesh.apply_transform(TURN)
    indices = singular_indices(prepare_surface(mesh, tangents="smooth"))
    np.testing.assert_allclose(indices, np.rint(indices), atol=1e-6)
    assert round(indices.sum()) == sum_
    assert np.count_nonzero(np.abs(indices) > 0.5) >= sum_
    if body == "torus":
        assert not np.any(np.abs(indices) > 0.5)


@pytest.mark.parametrize("rule", TANGENT_RULES)
@pytest.mark.parametrize(
    "mesh", [trimesh.creation.torus(1.0, 0.3), trimesh.creation.capsule(), meshes.tube(segments_along=24)],
    ids=["torus", "capsule", "tube"],
)  # fmt: skip
def test_every_rule_gives_unit_tangential_vectors(mesh, rule):
    mesh = mesh.copy(include_cache=True).apply_transform(TURN)
    surface = prepare_surface(mesh, tangents=rule)
    np.testing.assert_allclose(np.linalg.norm(surface.tangents, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.sum(surface.tangents * surface.normals, axis=1), 0.0, atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, 1.0)


def test_rules_of_an_axis_equal_an_array_of_this_axis():
    mesh = trimesh.creation.capsule().apply_transform(TURN)
    for rule, axis in zip("xyz", np.eye(3), strict=True):
        expected = prepare_surface(mesh, tangents=axis).tangents
        np.testing.assert_array_equal(prepare_surface(mesh, tangents=rule).tangents, expected)


def test_directions_run_around_the_centre_of_each_object():
    ring = trimesh.creation.annulus(0.5, 1.0, 0.2)
    scene = trimesh.Scene()
    for x in (-3.0, 4.0):
        scene.add_geometry(ring, transform=trimesh.transformations.translation_matrix((x, 1.0, 0.0)))
    surface = prepare_surface(scene, tangents="around-z")
    world = surface.vertices * surface.radius + surface.centre
    arms = world - np.where(world[:, :1] > 0.0, [4.0, 1.0, 0.0], [-3.0, 1.0, 0.0])
    expected = np.cross([0.0, 0.0, 1.0], arms)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.tangents, expected, atol=2e-3)


def test_a_rule_overrides_texture_coordinates():
    turned = plate(uv=True)
    turned.visual.uv = turned.visual.uv[:, ::-1] * (-1.0, 1.0)
    np.testing.assert_allclose(prepare_surface(turned).tangents[:, 1], -1.0, atol=1e-6)
    np.testing.assert_allclose(prepare_surface(turned, tangents="x").tangents[:, 0], 1.0, atol=1e-6)


def test_faces_perpendicular_to_the_axis_get_another_direction_with_a_warning():
    box = trimesh.creation.box()
    faces = box.vertices[box.faces].reshape(-1, 3)
    flat = trimesh.Trimesh(
        faces, np.arange(36).reshape(-1, 3), vertex_normals=np.repeat(box.face_normals, 3, axis=0), process=False
    )
    with pytest.warns(WarpdiffWarning, match=r"tangents='z': no direction along the surface at 12 of 36 vertices"):
        surface = prepare_surface(flat, tangents="z")
    np.testing.assert_allclose(np.linalg.norm(surface.tangents, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.sum(surface.tangents * surface.normals, axis=1), 0.0, atol=1e-6)


def test_a_face_whose_corners_all_lie_between_opposite_directions_gets_a_direction():
    # No corner of the first face has a direction of its own. Each corner has two further neighbouring vertices, whose
    # directions are opposite.
    middle = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]])
    points = np.concatenate([middle, middle - [1, 1, 0], middle - [1, 2, 0]])
    body = trimesh.Trimesh(points, [[0, 1, 2], [0, 3, 6], [1, 4, 7], [2, 5, 8]], process=False)
    tangents = np.repeat([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 3, axis=0)
    with pytest.warns(WarpdiffWarning, match="no direction along the surface at 3 of 9 vertices"):
        surface = prepare_surface(body, tangents=tangents)
    np.testing.assert_allclose(np.linalg.norm(surface.tangents, axis=1), 1.0, atol=1e-6)


def test_poles_of_a_rule_are_filled_without_a_warning(recwarn):
    ball = trimesh.creation.icosphere(subdivisions=2)
    surface = prepare_surface(ball, tangents="around-z")
    assert not recwarn.list
    np.testing.assert_allclose(np.sum(surface.tangents * surface.normals, axis=1), 0.0, atol=1e-6)
    assert np.count_nonzero(np.linalg.norm(surface.tangents, axis=1) < 0.999) <= 2


def test_smooth_fields_of_separate_parts_do_not_depend_on_each_other():
    one, other = blob(1), trimesh.creation.torus(1.0, 0.3).apply_translation((5.0, 0.0, 0.0))
    together = prepare_surface(trimesh.util.concatenate([one, other]), tangents="smooth").tangents
    alone = [prepare_surface(mesh, tangents="smooth").tangents for mesh in (one, other)]
    np.testing.assert_allclose(together, np.concatenate(alone), atol=2e-3)


def test_many_small_parts_have_their_own_fields_and_share_few_solves(monkeypatch):
    rng = np.random.default_rng(4)
    kinds = [trimesh.Trimesh(rng.normal(size=(3, 3)), [[0, 1, 2]], process=False), plate(3), blob(1), blob(2)]
    kinds = [kind.apply_scale(1.0 / kind.scale) for kind in kinds]
    chosen = [*rng.integers(0, 3, 40), 3, *rng.integers(0, 2, 3000)]
    places = 3.0 * np.stack([np.arange(len(chosen)) // 60, np.arange(len(chosen)) % 60, np.zeros(len(chosen))], axis=1)
    parts = [kinds[kind].copy().apply_translation(place) for kind, place in zip(chosen, places, strict=True)]
    solves = []
    smoothest = direction_fields._smoothest
    monkeypatch.setattr(direction_fields, "_smoothest", lambda *a: solves.append(1) or smoothest(*a))
    surface = prepare_surface(trimesh.util.concatenate(parts), tangents="smooth")
    # Direction fields on connected parts with equally many vertices must be computed together, as one batch of
    # matrices. To solve all 3,041 parts separately would take half a minute.
    assert len(solves) < 20
    alone = [prepare_surface(kind, tangents="smooth").tangents for kind in kinds]
    np.testing.assert_allclose(surface.tangents, np.concatenate([alone[kind] for kind in chosen]), atol=0.02)


def test_both_sides_of_a_thin_sheet_have_a_field():
    front = plate()
    sheet = trimesh.Trimesh(
        np.tile(front.vertices, (2, 1)), np.concatenate([front.faces, front.faces[:, ::-1] + 49]), process=False
    )
    surface = prepare_surface(sheet, tangents="smooth")
    np.testing.assert_allclose(surface.tangents[:, 0], 1.0, atol=1e-6)


def test_flat_faces_have_the_smooth_field_turned_to_their_normals():
    body = blob(3)
    smooth = prepare_surface(body, tangents="smooth")
    corners = body.faces.ravel()
    normals = np.repeat(body.face_normals, 3, axis=0)
    separate = trimesh.Trimesh(
        body.vertices[corners], np.arange(len(corners)).reshape(-1, 3), vertex_normals=normals, process=False
    )
    flat = prepare_surface(separate, tangents="smooth")
    inputs = smooth.tangents[corners].astype(float), smooth.normals[corners].astype(float), normals
    expected = [moved_along(*row) for row in zip(*inputs, strict=True)]
    np.testing.assert_allclose(flat.tangents, expected, atol=5e-3)


def test_too_many_positions_are_refused(monkeypatch):
    monkeypatch.setattr(direction_fields, "MOST_POSITIONS", 48)
    with pytest.raises(ValueError, match="tangents='smooth' requires connected parts of at most 48 positions, got 49"):
        prepare_surface(plate(), tangents="smooth")
    # The limit of vertex positions applies to each connected part. Two parts together may have more positions.
    pair = trimesh.util.concatenate([plate(6), plate(6).apply_translation((3.0, 0.0, 0.0))])
    assert len(prepare_surface(pair, tangents="smooth").vertices) == 72


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_smooth_fields_in_forked_processes_equal_those_of_the_parent():
    expected = prepare_surface(blob(2), tangents="smooth").tangents
    child = os.fork()
    if child == 0:
        os._exit(0 if np.array_equal(prepare_surface(blob(2), tangents="smooth").tangents, expected) else 1)
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize("rule", ["radial", "around", "X", ""])
def test_unknown_rules_are_refused(rule):
    with pytest.raises(ValueError, match="tangents must be one of 'x', 'y', 'z', 'around-x'"):
        prepare_surface(plate(), tangents=rule)


def scene(**parts):
    result = trimesh.Scene()
    for x, (name, mesh) in enumerate(parts.items()):
        result.add_geometry(mesh.copy().apply_translation((1.5 * x, 0.0, 0.0)), geom_name=name, node_name=name)
    return result


def test_plain_parts_need_no_texture_coordinates():
    both = scene(disc=plate(uv=True), table=plate())
    with pytest.raises(ValueError, match="geometry 'table' has no texture coordinates; give tangents='smooth', anoth"):
        prepare_surface(both)
    surface = prepare_surface(both, plain={"table": True, "*": False})
    np.testing.assert_allclose(surface.tangents, np.eye(3)[[0] * 98], atol=1e-6)
    without = scene(table=plate(uv=True), disc=plate())
    with pytest.raises(ValueError, match="geometry 'disc' has no texture coordinates"):
        prepare_surface(without, plain={"table": True, "*": False})


def test_plain_parts_cause_no_warning_about_tangents(recwarn):
    collapsed = plate(uv=True)
    collapsed.visual.uv = collapsed.visual.uv * 0.0
    prepare_surface(scene(disc=plate(uv=True), table=collapsed), plain={"table": True, "*": False})
    assert not recwarn.list
    with pytest.warns(WarpdiffWarning, match="no direction along the surface at 49 of 98 vertices"):
        prepare_surface(scene(disc=plate(uv=True), table=collapsed))


def test_pictures_with_plain_parts_need_no_texture_coordinates():
    wave, light = wd.gratings.sinusoidal(1.5, 0.1), wd.DirectionalLight((0.3, 0.0, 1.0))
    view = wd.View.orthographic((1.3, 0.5, 5.0), (1.3, 0.5, 0.0), extent_y=1.5, width=24, height=12)
    options = {"tolerance": 0.3, "refine": False, "coherence": wd.Coherence(sigma_um=2.0)}
    surfaces = {"disc": wave, "table": None}
    image = wd.shade(scene(disc=plate(uv=True), table=plate()), surfaces, light, view, **options)
    expected = wd.shade(scene(disc=plate(uv=True), table=plate(uv=True)), surfaces, light, view, **options)
    np.testing.assert_array_equal(image.xyz, expected.xyz)
    by_rule = wd.shade(scene(disc=plate(), table=plate()), surfaces, light, view, tangents="x", **options)
    np.testing.assert_array_equal(by_rule.xyz, expected.xyz)
    drawn = wd.Renderer(scene(disc=plate(uv=True), table=plate()), surfaces, light, view, **options)
    assert drawn.image().illuminated.any()


def test_a_texture_without_texture_coordinates_is_named_in_a_warning():
    image = SimpleMaterial(image=Image.new("RGB", (2, 2), (255, 0, 0)), name="paint")
    body = plate()
    body.visual = TextureVisuals(material=image)
    with pytest.warns(WarpdiffWarning, match="not rendered: texture without texture coordinates of 'paint'"):
        surface = prepare_surface(body, tangents="x")
    assert not surface.is_textured
    np.testing.assert_array_equal(surface.plain_colour, 1.0)
