"""Layers of a picture: normal, depth and geometry number at the hits of central rays, and normals of mesh files."""

from typing import get_args

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the name its own documentation uses)
import pytest
import trimesh
from trimesh.visual import TextureVisuals

import warpdiff as wd
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.request.settings import Layer

NAMES = get_args(Layer)
HF = wd.gratings.sinusoidal(2.0, 0.2)
LIGHT = wd.DirectionalLight((0.2, 0.3, 1.0))
# Matrix by which the vertex positions of the ball are multiplied to give its texture coordinates. Both coordinates vary
# along the surface.
MIXED = np.array([[1.0, 0.1], [0.3, 1.0], [0.2, -0.4]])
VIEW = wd.View((1.9, 2.3, 2.9), (0.0, 0.0, 0.0), width=40, height=30)


def shade(mesh, view=VIEW, **options):
    options = {"layers": NAMES, "tolerance": 0.1, "footprint": False, "strict": False, **options}
    return wd.shade(mesh, HF, LIGHT, view, **options)


def box(*, size=1.0, normals=True):
    """Return a cube with three separate corners per face and face normals as vertex normals, like modelling tools."""
    body = trimesh.creation.box(extents=(size, size, size))
    corners = body.faces.ravel()
    facets = np.repeat(body.face_normals, 3, axis=0)
    vertices = body.vertices[corners]
    # On each face of the cube, u and v are the two coordinate axes perpendicular to the face normal.
    uvs = np.array([v[np.abs(n) < 0.5] for v, n in zip(vertices, facets, strict=True)])
    return trimesh.Trimesh(
        vertices, np.arange(len(corners)).reshape(-1, 3), vertex_normals=facets if normals else None,
        visual=TextureVisuals(uv=uvs), process=False,
    )  # fmt: skip


def ball():
    body = trimesh.creation.uv_sphere(radius=0.5, count=[24, 24])
    return trimesh.Trimesh(body.vertices, body.faces, visual=TextureVisuals(uv=body.vertices @ MIXED), process=False)


def rays(view):
    """Return origins and directions of the central rays of all pixels, (height, width, 3) each."""
    frame = view.frame()
    x = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
    y = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
    across = x[None, :, None] * frame.right + y[:, None, None] * frame.up
    if frame.orthographic:
        return frame.origin + across, np.broadcast_to(-frame.back, across.shape)
    along = across - frame.back
    return np.broadcast_to(frame.origin, along.shape), along / np.linalg.norm(along, axis=2, keepdims=True)


def box_met(view, half=0.5):
    """Return distances and normals where central rays hit a cube at the origin; infinity and zero for other rays."""
    origin, along = rays(view)
    with np.errstate(divide="ignore"):
        one, two = (-half - origin) / along, (half - origin) / along
    near, far = np.minimum(one, two), np.maximum(one, two).min(axis=2)
    axis, distance = near.argmax(axis=2), near.max(axis=2)
    met = distance < far
    normal = -np.sign(np.take_along_axis(along, axis[..., None], 2)) * np.eye(3)[axis]
    return np.where(met, distance, np.inf), np.where(met[..., None], normal, 0.0)


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb"])
@pytest.mark.parametrize("how", ["path", "scene", "process"])
def test_normals_of_a_file_are_used_even_if_they_equal_the_face_normals(tmp_path, suffix, how):
    path = tmp_path / f"box.{suffix}"
    given = box()
    # trimesh writes PLY files without texture coordinates, so PLY meshes get explicit tangents.
    tangents = np.roll(given.vertex_normals, 1, axis=1) if suffix == "ply" else None
    given.export(path, **({"vertex_normal": True} if suffix == "ply" else {"include_normals": True}))
    # trimesh.load_mesh drops the normals of a file; load_scene keeps them.
    mesh = path if how == "path" else trimesh.load_scene(path, process=how == "process")
    if how == "process" and tangents is not None:
        (merged,) = mesh.geometry.values()
        tangents = np.roll(merged.vertex_normals, 1, axis=1)
    distance, normal = box_met(VIEW)
    image = shade(mesh, tangents=tangents, layers=("normal",))
    assert list(image.layers) == ["normal"]
    assert (image.layers["normal"].shape, image.layers["normal"].dtype) == ((30, 40, 3), np.float32)
    assert np.isfinite(distance).mean() > 0.1
    np.testing.assert_allclose(image.layers["normal"], normal, atol=1e-6)


def test_a_box_without_normals_is_shaded_smoothly_even_after_trimesh_has_computed_normals():
    bare = box(normals=False)
    with pytest.warns(WarpdiffWarning, match="no normals, but separate vertices at 3 sharp edges"):
        before = shade(bare).layers["normal"]
    corner = np.abs(before - box_met(VIEW)[1]).max()
    assert corner > 0.5
    assert bare.vertex_normals.shape == (36, 3)
    with pytest.warns(WarpdiffWarning, match="at 3 sharp edges"):
        np.testing.assert_array_equal(shade(bare).layers["normal"], before)


@pytest.mark.parametrize(
    "view",
    [VIEW, wd.View.orthographic((1.9, 2.3, 2.9), (0, 0, 0), extent_y=2.5, width=40, height=30)],
    ids=["perspective", "orthographic"],
)
@pytest.mark.parametrize("options", [{}, {"footprint": True}, {"samples_per_pixel": 4}], ids=str)
def test_layers_have_the_values_at_the_hits_of_central_rays(view, options):
    distance, normal = box_met(view)
    image = shade(box(), view, **options)
    np.testing.assert_allclose(image.layers["depth"], distance, rtol=1e-6)
    np.testing.assert_allclose(image.layers["normal"], normal, atol=1e-6)
    np.testing.assert_array_equal(image.layers["geometry"], np.where(np.isfinite(distance), 0, -1))
    assert [image.layers[name].dtype for name in NAMES] == [np.float32, np.float32, np.int32]
    assert not shade(box(), view, **options, layers=()).layers


def test_geometries_are_numbered_by_the_scenes_nodes():
    scene = trimesh.Scene()
    # The mesh on the left has a face without area, which must not change the numbers of the geometries.
    flat = ball()
    flat.faces = np.concatenate([[[0, 0, 0]], flat.faces])
    for name, mesh, x in (("left", flat, -1.5), ("middle", box(), 0.0), ("right", ball(), 1.5)):
        scene.add_geometry(mesh, node_name=name, transform=trimesh.transformations.translation_matrix((x, 0, 0)))
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=1.4, width=48, height=14)
    with pytest.warns(wd.WarpdiffWarning, match="no area"):
        result = shade(scene, view).layers["geometry"]
    assert list(scene.graph.nodes_geometry) == ["left", "middle", "right"]
    assert [result[7, column] for column in (9, 24, 39)] == [0, 1, 2]
    assert set(np.unique(result)) == {-1, 0, 1, 2}


def test_facets_show_their_own_normals():
    mesh = ball()
    smooth, flat = (shade(mesh, smooth=smooth).layers["normal"] for smooth in (True, False))
    # The facets of the ball span 7.5° × 15°, so their normals differ from smooth normals by a few degrees.
    assert 0.01 < np.abs(smooth - flat).max() < 0.2
    met = smooth.any(axis=2)
    distance = shade(mesh, layers=["depth"]).layers["depth"]
    origin, along = rays(VIEW)
    points = origin[met] + distance[met][:, None] * along[met]
    np.testing.assert_allclose(smooth[met], points / np.linalg.norm(points, axis=1, keepdims=True), atol=0.02)


def test_layers_are_channels_of_an_exr(tmp_path):
    image = shade(box())
    pixels = oiio.ImageBuf(str(image.save(tmp_path / "a.exr")))
    names = list(pixels.spec().channelnames)
    values = dict(zip(names, np.moveaxis(pixels.get_pixels(oiio.FLOAT), 2, 0), strict=True))
    assert len(names) == 13
    for index, name in enumerate(("normal.X", "normal.Y", "normal.Z")):
        np.testing.assert_array_equal(values[name], image.layers["normal"][..., index])
    np.testing.assert_array_equal(values["depth.Z"], image.layers["depth"])
    np.testing.assert_array_equal(values["geometry.Y"], image.layers["geometry"])
    image.save(tmp_path / "a.png")
