"""Text formats of mesh files: concave polygons, encodings, and names of objects and materials."""

import struct
import warnings

import numpy as np
import pytest
import trimesh

from warpdiff.core.wording import WarpdiffWarning
from warpdiff.scene.mesh_files import load
from warpdiff.scene.mesh_import import prepare_surface


def regular(count, inner=1.0):
    """Return a polygon around the origin: corners at the radius 1 alternate with corners at the radius ``inner``."""
    angle = 2.0 * np.pi * np.arange(count) / count
    radius = np.where(np.arange(count) % 2, 1.0, inner)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


# Test polygons by name. The last three polygons are convex, and all others are concave.
POLYGONS = {
    "L": np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2.0)]),
    "dart": np.array([(0, 0), (2, 0), (0.5, 0.5), (0, 2.0)]),
    "star": regular(10, inner=0.35),
    "fine star": regular(64, inner=0.35),
    "comb": np.array([(0, 0), (8, 0), *((8 - k, 2.0 if k % 2 else 0.5) for k in range(9))]),
    "square": np.array([(0, 0), (2, 0), (2, 2), (0, 2.0)]),
    "octagon": regular(8),
    "collinear": np.array([(0, 0), (1, 0), (2, 0), (2, 2), (0, 2.0)]),
}
TILT = trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 3.0))[:3, :3]


def area_of(polygon):
    """Return the area of a polygon."""
    x, y = polygon.T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def rows(numbers):
    """Return a two-dimensional array of numbers as text, with one line per row of the array."""
    return "".join(f"{' '.join(map(str, row))}\n" for row in np.asarray(numbers).tolist())


def obj(vertices, faces):
    return "".join(f"v {line}\n" for line in rows(vertices).splitlines()) + "".join(
        f"f {' '.join(str(corner + 1) for corner in face)}\n" for face in faces
    )


def off(vertices, faces):
    return f"OFF\n{len(vertices)} {len(faces)} 0\n{rows(vertices)}" + "".join(
        f"{len(face)} {' '.join(map(str, face))}\n" for face in faces
    )


def ply_header(encoding, vertex_count, face_count, *, extra=""):
    return (
        f"ply\nformat {encoding} 1.0\nelement vertex {vertex_count}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {face_count}\nproperty list uchar int vertex_indices\n{extra}end_header\n"
    )


def ply(vertices, faces):
    return ply_header("ascii", len(vertices), len(faces)) + off(vertices, faces).partition(" 0\n")[2]


def binary_ply(order):
    def write(vertices, faces):
        header = ply_header({"<": "binary_little_endian", ">": "binary_big_endian"}[order], len(vertices), len(faces))
        body = np.asarray(vertices, f"{order}f8").tobytes()
        body += b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
        return header.encode() + body

    return write


FORMATS = {"obj": obj, "off": off, "ply": ply, "le.ply": binary_ply("<"), "be.ply": binary_ply(">")}


def written(path, content):
    """Write a text or bytes to a file and return its path."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("name", POLYGONS)
def test_polygons_keep_their_area_from_every_first_corner(kind, name, tmp_path):
    polygon = POLYGONS[name]
    for first in range(0, len(polygon), max(1, len(polygon) // 6)):
        flat = np.roll(polygon, -first, axis=0)
        vertices = np.concatenate([np.c_[flat, np.zeros(len(flat))] @ TILT.T, [[9, 9, 9], [8, 9, 9], [8, 8, 9]]])
        faces = [[*range(len(flat))], [len(flat), len(flat) + 1, len(flat) + 2]]
        (part,) = load(written(tmp_path / f"a{first}.{kind}", FORMATS[kind](vertices, faces)))
        corners = part.vertices[part.faces]
        cross = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inside = np.abs(corners @ TILT)[:, :, 2].max(axis=1) < 1e-9
        # The normals of all triangles must point to the same side, and the triangles must cover the polygon once.
        along = cross[inside] @ TILT[:, 2]
        assert np.all(along > -1e-9)
        assert along.sum() == pytest.approx(area_of(polygon), rel=1e-9)


def test_corners_of_concave_polygons_keep_their_data(tmp_path):
    polygon = POLYGONS["L"]
    vertices = "".join(f"v {x} {y} 0\n" for x, y in polygon)
    uvs = "".join(f"vt {x / 10 + 0.5} {y / 10}\n" for x, y in polygon)
    normals = "".join(f"vn {x} {y} 5\n" for x, y in polygon)
    for face in ("f 1/1/1 2/2/2 3/3/3 4/4/4 5/5/5 6/6/6  # a comment",
                 "f -6/-6/-6 -5/-5/-5 -4/-4/-4 \\\n-3/-3/-3 -2/-2/-2 -1/-1/-1"):  # fmt: skip
        path = written(tmp_path / "a.obj", f"{vertices}{uvs}{normals}{face}\nv 9 9 9\n")
        (part,) = load(path)
        np.testing.assert_allclose(part.uvs[0], part.vertices[:, :2] / 10 + [0.5, 0], atol=1e-12)
        expected = part.vertices + np.array([0, 0, 5])
        np.testing.assert_allclose(part.normals, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-9)
    # Faces of .ply files may have texture coordinates of their corners and other values, which must be skipped.
    header = ply_header("ascii", 6, 1, extra="property list uchar float texcoord\nproperty int texnumber\n")
    texts = " ".join(f"{x / 10 + 0.5} {y / 10}" for x, y in polygon)
    body = "".join(f"{x} {y} 0\n" for x, y in polygon) + f"6 0 1 2 3 4 5 12 {texts} 7\n"
    (part,) = load(written(tmp_path / "a.ply", header + body))
    assert len(part.faces) == 4
    np.testing.assert_allclose(part.uvs[0], part.vertices[:, :2] / 10 + [0.5, 0], atol=1e-7)


def test_only_concave_polygons_are_cut_by_earcut(tmp_path, monkeypatch):
    cut = []
    monkeypatch.setattr("warpdiff.scene.polygons.triangulated", lambda polygon: cut.append(polygon) or [])
    for kind in ("obj", "off", "le.ply"):
        for name in ("square", "octagon", "collinear"):
            vertices = np.c_[POLYGONS[name], np.zeros(len(POLYGONS[name]))]
            load(written(tmp_path / f"a.{kind}", FORMATS[kind](vertices, [list(range(len(vertices)))])))
    assert cut == []


OBJ = "# von Jörg\no Kübel\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl Öl\nf 1/1 2/2 3/3\n"
TEXTS = {
    "obj": OBJ,
    "off": "OFF\n# Jörg\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "stl": "solid Jörg\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    "endsolid\n",
    "ply": ply_header("ascii", 3, 1).replace("1.0\n", "1.0\ncomment Jörg\n") + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
}


@pytest.mark.parametrize(
    "code", ["utf-8", "utf-8-sig", "latin-1", "cp1252", "utf-16", "utf-16-le", "utf-16-be", "mac-roman"]
)
@pytest.mark.parametrize("kind", TEXTS)
def test_texts_in_other_encodings_are_read(kind, code, tmp_path):
    for text in (TEXTS[kind], TEXTS[kind].replace("\n", "\r\n")):
        path = written(tmp_path / f"a.{kind}", text.encode(code))
        (part,) = load(path)
        np.testing.assert_allclose(part.vertices[part.faces[0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]], atol=1e-6)
        if kind == "obj" and code != "mac-roman":
            assert (part.geometry, part.appearance.name) == ("Kübel", "Öl")


def test_a_binary_ply_with_a_comment_in_another_encoding_is_read(tmp_path):
    content = binary_ply("<")([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    path = written(tmp_path / "a.ply", content.replace(b"1.0\n", "1.0\ncomment Jörg\n".encode("latin-1"), 1))
    assert len(load(path)[0].faces) == 1


def test_a_material_library_in_another_encoding_is_read(tmp_path):
    mtl = "newmtl Öl\nKd 1 0 0\n"
    for code in ("latin-1", "utf-16"):
        (tmp_path / "a.mtl").write_bytes(mtl.encode(code))
        surface = prepare_surface(written(tmp_path / "a.obj", f"mtllib a.mtl\n{OBJ}".encode(code)))
        np.testing.assert_allclose(surface.plain_colour, [1, 0, 0], atol=1e-6)
        assert surface.material_names == ("Öl",)


TWO = (
    "mtllib two.mtl\no body\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl gold\nf 1/1 2/2 3/3\n"
    "usemtl silver\nf 1/1 2/2 4/3\no lid\nf 1/1 3/2 4/3\nusemtl gold\nf 2/1 3/2 4/3\n"
)


@pytest.mark.parametrize(
    "library", ["newmtl gold\nKd 1 0 0\nnewmtl silver\nKd 0 0 1\n", "newmtl gold\nKd 1 0 0\n", None]
)
def test_objects_and_materials_of_obj_files_keep_their_names(library, tmp_path):
    if library is not None:
        (tmp_path / "two.mtl").write_text(library)
    path = written(tmp_path / "two.obj", TWO)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if library is None else "error", WarpdiffWarning)
        surface = prepare_surface(path)
    pairs = zip(surface.geometries, surface.materials, strict=True)
    names = sorted((surface.geometry_names[one], surface.material_names[two]) for one, two in pairs)
    assert names == [("body", "gold"), ("body", "silver"), ("lid", "gold"), ("lid", "silver")]
    groups = written(tmp_path / "groups.obj", TWO.replace("\no ", "\ng ").replace("mtllib two.mtl\n", ""))
    assert set(prepare_surface(groups).geometry_names) == {"body", "lid"}


@pytest.mark.parametrize("keyword_end", [" ", "\t", " \t "])
@pytest.mark.parametrize("indent", ["", "  ", "\t"])
@pytest.mark.parametrize("between", [" ", "\t"])
def test_obj_files_may_have_tabs_and_indented_lines(indent, keyword_end, between, tmp_path):
    # The name of the material library has a space and a tab, which belong to the name.
    (tmp_path / "two \t a.mtl").write_text("newmtl gold\nKd 1 0 0\nnewmtl silver\nKd 0 0 1\n")
    lines = []
    for line in TWO.replace("2/2 3/3", "-3/-2 -2/-1").splitlines():
        keyword, name = line.split(" ", 1)
        name = "two \t a.mtl" if keyword == "mtllib" else name.replace(" ", between)
        lines.append(f"{indent}{keyword}{keyword_end}{name}\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error", WarpdiffWarning)
        parts = load(written(tmp_path / "a.obj", "".join(lines)))
        expected = load(written(tmp_path / "b.obj", TWO.replace("two.mtl", "two \t a.mtl")))
    assert len(parts) == len(expected) == 4
    for part, same in zip(parts, expected, strict=True):
        assert (part.geometry, part.appearance.name) == (same.geometry, same.appearance.name)
        assert part.appearance.base_colour == same.appearance.base_colour
        np.testing.assert_array_equal(part.vertices[part.faces], same.vertices[same.faces])
        np.testing.assert_array_equal(part.uvs[0][part.faces], same.uvs[0][same.faces])


@pytest.mark.parametrize("name", ["folder", "folder.obj", "folder.glb", "folder.other"])
def test_a_folder_is_no_mesh(name, tmp_path):
    (tmp_path / name).mkdir()
    with pytest.raises(ValueError, match=f"mesh must be a file, got the folder '.*{name}'"):
        load(tmp_path / name)


def test_files_without_names_have_numbers(tmp_path):
    path = written(tmp_path / "a.obj", OBJ.replace("o Kübel\n", "").replace("usemtl Öl\n", ""))
    surface = prepare_surface(path)
    assert (surface.geometry_names, surface.material_names, surface.materials.tolist()) == (("mesh 0",), (), [-1])
