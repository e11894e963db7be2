"""Import of meshes: checks, normals, tangents, mirrored textures, base colours and convexity."""

import math
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from warpdiff import meshes
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.scene.mesh_import import prepare_surface

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def mesh_of(vertices=SQUARE, faces=SQUARE_FACES, uv=None, material=None, **options):
    visual = None if uv is None else TextureVisuals(uv=np.asarray(uv, dtype=np.float64), material=material)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False, **options)


def square(**options):
    return mesh_of(uv=SQUARE[:, :2], **options)


def along_x(mesh, y=0.0, z=0.0):
    return np.broadcast_to([1.0, y, z], mesh.vertices.shape)


def decode(value):
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def test_a_surface_has_float32_arrays_relative_to_its_centre_and_radius():
    mesh = square()
    mesh.apply_translation([1e5, 0, 0])
    surface = prepare_surface(mesh)
    for name, dtype, width in [("vertices", "f4", 3), ("normals", "f4", 3), ("tangents", "f4", 3), ("uvs", "f4", 2)]:
        array = getattr(surface, name)
        assert (array.shape, array.dtype) == ((4, width), np.dtype(dtype))
    assert (surface.faces.shape, surface.faces.dtype) == ((2, 3), np.int32)
    assert np.linalg.norm(surface.vertices, axis=1).max() == pytest.approx(1.0)
    # In float32, positions near x = 1e5 are multiples of 0.008. The surface stores positions relative to the mesh's
    # centre, which are more accurate.
    world = surface.vertices.astype(np.float64) * surface.radius + surface.centre
    np.testing.assert_allclose(world, mesh.vertices, atol=1e-6)


def test_a_tiny_mesh_has_the_same_surface_as_a_large_one():
    small, large = (prepare_surface(mesh_of(SQUARE * size, uv=SQUARE[:, :2])) for size in (1e-9, 1e9))
    np.testing.assert_allclose(small.vertices, large.vertices, atol=1e-6)
    np.testing.assert_allclose(small.tangents, large.tangents, atol=1e-6)


def test_normals_of_a_sphere_are_smooth_across_unwelded_faces():
    sphere = trimesh.creation.icosphere(subdivisions=3)
    torn = mesh_of(sphere.vertices[sphere.faces.ravel()], np.arange(sphere.faces.size).reshape(-1, 3))
    surface = prepare_surface(torn, tangents=along_x(torn, 0.01, 0.02))
    np.testing.assert_allclose(surface.normals, torn.vertices, atol=6e-3)


def test_normals_of_the_mesh_are_used_and_those_computed_by_trimesh_are_not():
    normals = np.tile(np.array([[0.6, 0.0, 0.8]]), (4, 1))
    np.testing.assert_allclose(prepare_surface(square(vertex_normals=normals)).normals, normals, atol=1e-7)
    # Vertex normals that point to the wrong side of their faces must be reversed.
    np.testing.assert_allclose(prepare_surface(square(vertex_normals=-normals)).normals, normals, atol=1e-7)
    roof = np.array([[0, 0, 0], [1, 0, 1], [1, 1, 1], [1, 0, 1], [2, 0, 0], [1, 1, 1.0]])
    mesh = mesh_of(roof, [[0, 1, 2], [3, 4, 5]], uv=roof[:, :2])
    with pytest.warns(WarpdiffWarning, match="no normals, but separate vertices at 1 sharp edges"):
        before = prepare_surface(mesh).normals
    assert mesh.vertex_normals.shape == (6, 3)
    with pytest.warns(WarpdiffWarning, match="at 1 sharp edges"):
        np.testing.assert_array_equal(prepare_surface(mesh).normals, before)
    np.testing.assert_allclose(before[1], before[3], atol=1e-7)


@pytest.mark.parametrize("vertex", [0, 80, 161])
def test_a_single_changed_normal_is_used(vertex):
    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = mesh_of(ball.vertices, ball.faces)
    computed = prepare_surface(mesh, tangents=along_x(mesh, 0.01, 0.02)).normals
    normals = np.array(mesh.vertex_normals)
    normals[vertex] += 0.1 * normals[vertex, [1, 2, 0]]
    mesh.vertex_normals = normals
    expected = computed.copy()
    expected[vertex] = normals[vertex] / np.linalg.norm(normals[vertex])
    np.testing.assert_allclose(prepare_surface(mesh, tangents=along_x(mesh, 0.01, 0.02)).normals, expected, atol=1e-6)


def test_a_mesh_changed_in_place_has_another_surface():
    texture = Image.fromarray(np.full((4, 4, 3), 200, dtype=np.uint8))
    upwards = np.tile([[0.0, 0.0, 1.0]], (4, 1))
    visual = TextureVisuals(uv=SQUARE[:, :2].copy(), image=texture)
    mesh = trimesh.Trimesh(SQUARE.copy(), SQUARE_FACES, visual=visual, process=False, vertex_normals=upwards)
    first = prepare_surface(mesh)
    # The vertices are changed through a view of the array, which trimesh's tracking of changes does not notice.
    np.asarray(mesh.vertices).view(np.ndarray)[0] += 0.1
    moved = prepare_surface(mesh)
    assert not np.array_equal(moved.vertices, first.vertices)
    texture.putpixel((1, 2), (10, 20, 30))
    painted = prepare_surface(mesh)
    assert not np.array_equal(painted.textures[0].texels, moved.textures[0].texels)
    mesh.vertex_normals = np.tile([[0.0, 0.6, 0.8]], (4, 1))
    assert not np.array_equal(prepare_surface(mesh).normals, painted.normals)


def test_a_single_tangent_applies_to_all_vertices():
    mesh = square()
    one = prepare_surface(mesh, tangents=(0.0, 1.0, 3.0))
    many = prepare_surface(mesh, tangents=np.tile([0.0, 1.0, 3.0], (len(mesh.vertices), 1)))
    np.testing.assert_array_equal(one.tangents, many.tangents)
    np.testing.assert_allclose(one.tangents, np.tile([0.0, 1.0, 0.0], (4, 1)), atol=1e-6)


def test_normals_stay_on_the_side_of_their_faces_under_an_overhang():
    # Three faces share a position: two larger ones face down, and one faces up. The mean of their normals points down,
    # but each vertex must have a normal on the side of its own face.
    x, y = [0, 1, 0, 0, -1, 0, 0, 1, 0], [0, 0, 1, 0, 0, 1, 0, 0, -1]
    corners = np.stack([x, y, np.zeros(9, int)], axis=1)
    up = np.repeat([1.0, -1.0, -1.0], 3)[:, None] * [0.0, 0.6, 0.8]
    mesh = mesh_of(corners.astype(float), np.arange(9).reshape(3, 3), uv=corners[:, :2] * 1.0, vertex_normals=up)
    assert np.sign(prepare_surface(mesh).normals[:, 2]).tolist() == [1.0] * 3 + [-1.0] * 6


@pytest.mark.parametrize("write", [trimesh.exchange.stl.export_stl, trimesh.exchange.stl.export_stl_ascii])
def test_an_stl_file_has_the_normals_of_its_facets(write, tmp_path):
    ball, file = trimesh.creation.icosphere(subdivisions=1), tmp_path / "ball.stl"
    written = write(ball)
    file.write_bytes(written if isinstance(written, bytes) else written.encode())
    tangents = np.broadcast_to([1.0, 0.3, 0.2], (3 * len(ball.faces), 3))
    opened = trimesh.load(file, process=False)
    # An access to the vertex normals of a mesh makes trimesh compute and store them.
    accessed = trimesh.load(file, process=False)
    assert accessed.vertex_normals.shape == (3 * len(ball.faces), 3)
    for mesh in (file, opened, accessed):
        surface = prepare_surface(mesh, tangents=tangents)
        corners = surface.vertices[surface.faces].astype(np.float64)
        facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facets /= np.linalg.norm(facets, axis=1, keepdims=True)
        np.testing.assert_allclose(surface.normals[surface.faces], np.repeat(facets[:, None], 3, axis=1), atol=1e-3)
    # Separate triangles that do not come from an STL file are shaded smoothly, as are meshes with explicit vertex
    # normals.
    loose = trimesh.Trimesh(opened.vertices, opened.faces, process=False)
    np.testing.assert_allclose(prepare_surface(loose, tangents=tangents).normals, loose.vertices, atol=2e-2)
    opened.vertex_normals = loose.vertices
    np.testing.assert_allclose(prepare_surface(opened, tangents=tangents).normals, loose.vertices, atol=1e-3)


def test_an_stl_file_of_several_bodies_has_facets_too(tmp_path):
    boxes = [trimesh.creation.box(transform=trimesh.transformations.translation_matrix((x, 0, 0))) for x in (0.0, 3.0)]
    file = tmp_path / "boxes.stl"
    file.write_text("\n".join(trimesh.exchange.stl.export_stl_ascii(box) for box in boxes))
    surface = prepare_surface(file, tangents=np.broadcast_to([1.0, 0.3, 0.2], (72, 3)))
    assert surface.geometries.tolist() == [0] * 12 + [1] * 12
    np.testing.assert_allclose(np.abs(surface.normals).max(axis=1), 1.0, atol=1e-6)


def test_messages_name_the_geometry_that_is_meant():
    lid = mesh_of(np.nan * SQUARE, uv=SQUARE[:, :2])
    with pytest.raises(ValueError, match=r"^mesh's geometry 'lid' must have finite vertices, got 4 with NaN"):
        prepare_surface(trimesh.Scene({"body": square(), "lid": lid}))
    with pytest.raises(ValueError, match=r"^mesh must have finite vertices"):
        prepare_surface(trimesh.Scene({"lid": lid}))


def test_two_sided_sheets_have_normals():
    both = mesh_of(faces=np.concatenate([SQUARE_FACES, SQUARE_FACES[:, ::-1] + 4]), vertices=np.tile(SQUARE, (2, 1)))
    surface = prepare_surface(both, tangents=along_x(both))
    np.testing.assert_array_equal(surface.normals[:, 2], [1, 1, 1, 1, -1, -1, -1, -1])


def test_tangents_follow_u_and_mirrored_textures_are_detected():
    surface = prepare_surface(square())
    np.testing.assert_allclose(surface.tangents, along_x(square()), atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, 1.0)
    mirrored = prepare_surface(mesh_of(uv=SQUARE[:, :2] * [-1, 1]))
    np.testing.assert_allclose(mirrored.tangents, -along_x(square()), atol=1e-6)
    np.testing.assert_array_equal(mirrored.handedness, -1.0)
    rotated = prepare_surface(mesh_of(uv=SQUARE[:, [1, 0]] * [1, -1]))
    np.testing.assert_allclose(rotated.tangents, np.tile([[0, 1, 0]], (4, 1)), atol=1e-6)
    np.testing.assert_array_equal(rotated.handedness, 1.0)


def test_a_fold_of_the_texture_splits_its_vertices():
    # Two adjacent squares share an edge. The texture of the second square is mirrored about this edge, so that both
    # squares cannot have the same tangents.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0.0]])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    uv = np.array([[0, 0], [1, 0], [0, 0], [0, 1], [1, 1], [0, 1.0]])
    surface = prepare_surface(mesh_of(vertices, faces, uv))
    assert len(surface.vertices) == 8
    np.testing.assert_array_equal(surface.handedness[surface.faces], [[1] * 3, [1] * 3, [-1] * 3, [-1] * 3])
    left, right = surface.tangents[surface.faces[:2]], surface.tangents[surface.faces[2:]]
    np.testing.assert_allclose(left[..., 0], 1.0, atol=1e-6)
    np.testing.assert_allclose(right[..., 0], -1.0, atol=1e-6)


@pytest.mark.parametrize(("angle_deg", "joined"), [(20.0, True), (45.0, False)])
def test_tangents_are_joined_across_seams_of_nearly_equal_direction(angle_deg, joined):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0.0]])
    faces = np.concatenate([SQUARE_FACES, SQUARE_FACES + 4])
    a = math.radians(angle_deg)
    turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    uv = np.concatenate([SQUARE[:, :2], SQUARE[:, :2] @ turn + 5.0])
    tangents = prepare_surface(mesh_of(vertices, faces, uv)).tangents
    across = np.degrees(np.arccos(np.clip(tangents[1] @ tangents[4], -1, 1)))
    assert across == pytest.approx(0.0 if joined else angle_deg, abs=0.1)
    assert np.degrees(np.arccos(np.clip(tangents[0] @ tangents[5], -1, 1))) == pytest.approx(angle_deg, abs=0.1)


def test_similar_tangents_at_one_position_are_joined():
    # The triangles around a point of the mesh have separate vertices there. Their textures have different directions,
    # and some textures are mirrored.
    rng = np.random.default_rng(3)
    count = 40
    turn = 2.0 * math.pi * np.arange(count) / count
    rim = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    vertices = np.stack([np.zeros_like(rim), rim, np.roll(rim, -1, axis=0)], axis=1)
    angle = rng.uniform(-math.pi, math.pi, count)
    side = np.where(rng.random(count) < 0.3, -1.0, 1.0)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=1) * side[:, None]
    uv = np.einsum("fcx,fkx->fck", vertices[..., :2], np.stack([along, across], axis=1))
    surface = prepare_surface(mesh_of(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), uv.reshape(-1, 2)))
    np.testing.assert_array_equal(surface.handedness[::3], side)
    agree = (along @ along.T > math.cos(math.radians(30.0))) & (side[:, None] == side)
    assert agree.sum() > 3 * count
    expected = agree @ along
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.tangents[::3, :2], expected, atol=1e-6)


def test_explicit_tangents_are_used_and_made_tangential():
    mesh = square()
    surface = prepare_surface(mesh, tangents=[[0, 7.0, 5.0]] * 4)
    np.testing.assert_allclose(surface.tangents, np.tile([[0, 1, 0]], (4, 1)), atol=1e-7)
    np.testing.assert_array_equal(surface.handedness, 1.0)


def test_zero_tangents_are_filled_from_neighbours():
    tangents = [[0, 1, 0], [0, 0, 0], [0, 1, 0], [0, 0, 3.0]]
    with pytest.warns(WarpdiffWarning, match=r"tangents: no direction .* at 2 of 4 vertices") as caught:
        surface = prepare_surface(square(), tangents=tangents)
    assert len(caught) == 1
    np.testing.assert_allclose(surface.tangents, np.tile([[0, 1, 0]], (4, 1)), atol=1e-6)


def test_degenerate_texture_triangles_are_skipped():
    # Two faces have no area in the texture, so their tangents are those of neighbouring faces.
    vertices = np.concatenate([SQUARE, [[2, 0, 0], [2, 1, 0]]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    uv = np.concatenate([SQUARE[:, :2], [[1, 0.5], [1, 0.7]]])
    with pytest.warns(WarpdiffWarning, match=r"texture coordinates: no direction .* at 2 of 6"):
        surface = prepare_surface(mesh_of(vertices, faces, uv))
    np.testing.assert_allclose(surface.tangents[:, 0], 1.0, atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, 1.0)


def test_faces_without_area_are_ignored_with_one_warning():
    faces = np.concatenate([SQUARE_FACES, [[0, 0, 1], [1, 1, 1], [0, 2, 0]]])
    with pytest.warns(WarpdiffWarning, match="3 of 5 faces have no area and are ignored") as caught:
        surface = prepare_surface(mesh_of(faces=faces, uv=SQUARE[:, :2]))
    assert len(caught) == 1
    assert len(surface.faces) == 2


def test_a_mesh_without_material_has_no_base_colour():
    for mesh in (square(), mesh_of()):
        surface = prepare_surface(mesh, tangents=along_x(mesh))
        assert not surface.has_base_colour
        assert surface.vertex_colours is None
        np.testing.assert_array_equal(surface.plain_colour, 0.0)


def test_a_plain_material_has_one_colour():
    for material, expected in [
        (SimpleMaterial(diffuse=[255, 51, 0, 255]), (1.0, decode(0.2), 0.0)),
        # The base colour factor of glTF is linear. The diffuse colour of other formats is encoded in sRGB.
        (PBRMaterial(baseColorFactor=[255, 51, 0, 255]), (1.0, 0.2, 0.0)),
    ]:
        surface = prepare_surface(square(material=material))
        assert surface.has_base_colour
        np.testing.assert_allclose(surface.plain_colour, expected, atol=1e-6)


def test_textures_are_decoded_row_0_first():
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [51, 51, 51]], [[0, 0, 0], [255] * 3]], np.uint8)
    image = Image.fromarray(pixels)
    surface = prepare_surface(square(material=SimpleMaterial(image=image)))
    texels = surface.textures[0].texels
    assert texels.shape == (3, 2, 4)
    np.testing.assert_array_equal(texels[0], [[1, 0, 0, 1], [0, 1, 0, 1]])
    np.testing.assert_allclose(texels[1, 1, :3], decode(0.2), atol=1e-6)
    halved = PBRMaterial(baseColorTexture=image, baseColorFactor=[255, 51, 255, 255])
    np.testing.assert_allclose(
        prepare_surface(square(material=halved)).textures[0].texels[0, 1], [0, 0.2, 0, 1], atol=1e-6
    )
    deep = Image.fromarray(np.array([[65535, 13107]], np.uint16))
    grey = prepare_surface(square(material=SimpleMaterial(image=deep))).textures[0].texels
    np.testing.assert_allclose(grey[0, :, 0], [1.0, decode(0.2)], atol=1e-6)


def test_colours_of_vertices_and_of_faces_are_decoded():
    mesh = mesh_of()
    mesh.visual = ColorVisuals(mesh, vertex_colors=[[255, 0, 0], [0, 255, 0], [0, 0, 255], [51, 51, 51]])
    surface = prepare_surface(mesh, tangents=along_x(mesh))
    np.testing.assert_allclose(surface.vertex_colours[[0, 3]], [[1, 0, 0], [decode(0.2)] * 3], atol=1e-6)
    mesh = mesh_of()
    mesh.visual = ColorVisuals(mesh, face_colors=[[255, 0, 0], [0, 255, 0]])
    surface = prepare_surface(mesh, tangents=along_x(mesh))
    assert len(surface.vertices) == 6
    np.testing.assert_array_equal(surface.vertex_colours[surface.faces[0]], [[1, 0, 0]] * 3)
    np.testing.assert_array_equal(surface.vertex_colours[surface.faces[1]], [[0, 1, 0]] * 3)
    np.testing.assert_allclose(surface.normals, [[0, 0, 1]] * 6, atol=1e-7)


def test_scenes_are_joined_with_their_transforms():
    scene = trimesh.Scene()
    scene.add_geometry(square(material=SimpleMaterial(image=Image.new("RGB", (4, 4), (255, 0, 0)))))
    move = trimesh.transformations.translation_matrix([0, 0, 3.0])
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene.add_geometry(square(material=SimpleMaterial(diffuse=[0, 255, 0, 255])), transform=move @ mirror)
    surface = prepare_surface(scene)
    world = surface.vertices * surface.radius + surface.centre
    np.testing.assert_allclose(world[4:, 0], -SQUARE[:, 0], atol=1e-6)
    np.testing.assert_allclose(world[4:, 2], 3.0, atol=1e-6)
    # The second square is mirrored by its transform, which reverses the vertex order. Its normals are corrected, and
    # its texture is marked as mirrored.
    np.testing.assert_allclose(surface.normals[:, 2], 1.0, atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, [1] * 4 + [-1] * 4)
    assert surface.textures[0].texels.shape == (4, 4, 4)
    assert surface.textures[1] is None
    np.testing.assert_array_equal(surface.vertex_colours, [[-1] * 3] * 4 + [[0, 1, 0]] * 4)


def test_scenes_have_a_texture_for_each_material():
    images = [Image.new("RGB", (2, 2), colour) for colour in ((255, 0, 0), (0, 255, 0), (255, 0, 0))]
    surface = prepare_surface(trimesh.Scene([square(material=SimpleMaterial(image=image)) for image in images]))
    red, green, again = surface.textures
    np.testing.assert_array_equal(surface.materials, [0, 0, 1, 1, 2, 2])
    np.testing.assert_array_equal([red.texels[0, 0, :3], green.texels[0, 0, :3]], [[1, 0, 0], [0, 1, 0]])
    # The first and the third image are equal, and must be stored only once.
    assert again.texels is red.texels


def test_parts_of_scenes_without_texture_coordinates_are_named():
    mixed = trimesh.Scene([square(), mesh_of()])
    with pytest.raises(ValueError, match="geometry 'geometry_1' has no texture coordinates; give tangents="):
        prepare_surface(mixed)


def folded(mesh):
    """Return a mesh without normals, whose texture is mirrored about a line along the mesh."""
    uv = np.array(mesh.visual.uv)
    return mesh_of(mesh.vertices, mesh.faces, np.stack([np.abs(uv[:, 0] - 0.32), uv[:, 1]], axis=1))


# Tangents of several vertices at one position are averaged if they differ by less than 30°. At a tip of the tube, all
# triangles meet at one position. With 24 faces around the tube, tangents of some triangles would differ by exactly 30°,
# and rounding errors would decide whether they are averaged. The tube therefore has 25 faces around its axis.
@pytest.mark.parametrize(
    "mesh",
    [meshes.tube(segments_along=40, segments_around=25), folded(meshes.tube(segments_along=40, segments_around=25)),
     meshes.disc(segments=48, rings=3)],
    ids=["given normals", "folded", "flat"],
)  # fmt: skip
def test_the_surface_of_a_moved_mesh_is_the_surface_moved(mesh):
    before = prepare_surface(mesh)
    turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3))
    moved = mesh.copy(include_cache=True)
    moved.apply_transform(trimesh.transformations.translation_matrix([3, -2, 1]) @ turn @ np.diag([4.0, 4, 4, 1]))
    after = prepare_surface(moved)
    world, world_after = (each.vertices * each.radius + each.centre for each in (before, after))
    np.testing.assert_allclose(world_after, 4.0 * world @ turn[:3, :3].T + [3, -2, 1], atol=2e-6)
    # The vertices are rounded to float32 after the rotation. This changes the directions of faces by about 5e-5 rad.
    for name in ("normals", "tangents"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name) @ turn[:3, :3].T, atol=5e-5)
    for name in ("faces", "handedness", "uvs", "is_convex"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_mesh_files_are_read_and_other_files_refused(tmp_path, fuze_path):
    with pytest.raises(FileNotFoundError, match=r"the mesh file '.*absent\.obj' does not exist"):
        prepare_surface(tmp_path / "absent.obj")
    for name, text in [("noise.ply", "no mesh"), ("noise.xyz123", "no mesh"), ("points.obj", "v 0 0 0\n")]:
        (tmp_path / name).write_text(text)
        with pytest.raises(ValueError, match="mesh must"):
            prepare_surface(tmp_path / name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        surface = prepare_surface(str(fuze_path))
    assert len(surface.faces) == 1000
    assert surface.textures[0].texels.shape == (1024, 1024, 4)
    assert surface.has_base_colour
    np.testing.assert_allclose(np.sum(surface.tangents * surface.normals, axis=1), 0.0, atol=1e-6)


def nearly_convex(fault):
    """Return a mesh that is convex except for a fault: a flipped face, a dent, or a small separate part."""
    if fault == "flipped":
        box = trimesh.creation.box().subdivide().subdivide()
        # The flipped face is within a side of the box, so all of its neighbours lie in the same plane.
        within = np.flatnonzero(np.all(np.count_nonzero(np.abs(box.triangles) == 0.5, axis=2) == 1, axis=1))
        faces = np.array(box.faces)
        faces[within[1]] = faces[within[1], ::-1]
        return mesh_of(box.vertices, faces)
    ball = trimesh.creation.icosphere(subdivisions=3)
    far = np.argmin(np.max(ball.vertices @ ball.triangles_center[::81].T, axis=1))
    if fault == "dented":
        return mesh_of(np.where(np.arange(len(ball.vertices))[:, None] == far, 0.99, 1.0) * ball.vertices, ball.faces)
    speck = trimesh.creation.icosahedron().apply_scale(1e-3).apply_translation(1.003 * ball.vertices[far])
    return trimesh.util.concatenate([ball, speck])


@pytest.mark.parametrize(
    ("mesh", "convex"),
    [(trimesh.creation.icosphere(subdivisions=2), True), (trimesh.creation.box(), True),
     (trimesh.creation.capsule(), True), (meshes.disc(segments=12, rings=2), True),
     (trimesh.creation.torus(1.0, 0.3), False),
     (mesh_of(trimesh.creation.icosphere().vertices, trimesh.creation.icosphere().faces[1:]), False),
     (trimesh.util.concatenate([trimesh.creation.box(), trimesh.creation.box().apply_translation([3, 0, 0])]), False),
     (trimesh.creation.annulus(0.5, 1.0, 1.0), False),
     *((nearly_convex(fault), False) for fault in ("flipped", "dented", "speck"))],
)  # fmt: skip
def test_convex_and_nearly_convex_meshes_are_distinguished(mesh, convex):
    surface = prepare_surface(mesh, tangents=along_x(mesh, 0.01, 0.02))
    assert surface.is_convex is convex


@pytest.mark.parametrize(
    ("mesh", "tangents", "error", "message"),
    [(5, None, TypeError, "mesh must be a trimesh.Trimesh, a trimesh.Scene or a path, got int"),
     (trimesh.PointCloud(SQUARE), None, TypeError, "got PointCloud"),
     (mesh_of(SQUARE * [1, math.nan, 1]), None, ValueError, "mesh must have finite vertices, got 4"),
     (mesh_of(faces=[[0, 1, 4]]), None, ValueError, "face indices within 0 to 3 .* got 0 to 4"),
     (mesh_of(faces=[[0, 1, -1]]), None, ValueError, "face indices within 0 to 3 .* got -1 to 1"),
     (mesh_of(), None, ValueError, "neither texture coordinates nor tangents; give tangents=.*or a mesh with"),
     (mesh_of(SQUARE * [1, 0, 0], uv=SQUARE[:, :2]), None, ValueError, "mesh must have a face with an area, got 2"),
     (mesh_of(SQUARE * 0, uv=SQUARE[:, :2]), None, ValueError, "mesh must have a face with an area, got 2"),
     (mesh_of(uv=SQUARE[:, :2] * 0), None, ValueError, "texture coordinates must define a direction"),
     (mesh_of(uv=SQUARE[:, :2] + math.inf), None, ValueError, "finite texture coordinates"),
     (square(), np.zeros((4, 3)), ValueError, "tangents must define a direction"),
     (square(), np.tile([[0, 0, 1.0]], (4, 1)), ValueError, "tangents must define a direction")],
)  # fmt: skip
def test_invalid_meshes_are_refused(mesh, tangents, error, message):
    with pytest.raises(error, match=message):
        prepare_surface(mesh, tangents=tangents)
