"""Layers of a picture: values at the hits of the rays through pixel centres, single lights, and parts of EXR files.

Layers also contain the directions to single lights, and the light that each of them contributes to the picture.
"""

import json
import re
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the name its own documentation uses)
import pytest
import trimesh
from trimesh.visual import TextureVisuals

import warpdiff as wd
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.render.picture_inputs import PictureInputs
from warpdiff.request.layer_formats import LAYERS

NAMES = ("normal", "depth", "geometry")
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
    """Return a cube as modelling tools export it: three separate vertices per face, with the face normal as normals."""
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
    """Return origins and directions of the rays through all pixel centres, (height, width, 3) each."""
    frame = view.frame()
    x = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
    y = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
    across = x[None, :, None] * frame.right + y[:, None, None] * frame.up
    if frame.orthographic:
        return frame.origin + across, np.broadcast_to(-frame.back, across.shape)
    along = across - frame.back
    return np.broadcast_to(frame.origin, along.shape), along / np.linalg.norm(along, axis=2, keepdims=True)


def box_met(view, half=0.5):
    """Return distances and normals where rays through pixel centres hit a cube at the origin.

    Other rays have the distance infinity and the normal zero.
    """
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
    # trimesh writes PLY files without texture coordinates, so that the test passes tangents for PLY meshes.
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


def test_positions_texture_coordinates_tangents_and_colours_are_those_of_the_mesh():
    plain = box()
    distance, normal = box_met(VIEW)
    origin, along = rays(VIEW)
    hit = np.isfinite(distance)
    names = ("position", "uv", "tangent", "bitangent", "to_view")
    layers = shade(plain, layers=names).layers
    points = (origin + np.where(hit, distance, 0.0)[..., None] * along)[hit]
    np.testing.assert_allclose(layers["position"][hit], points, atol=1e-6)
    across = np.abs(normal[hit]) < 0.5
    np.testing.assert_allclose(layers["uv"][hit], points[across].reshape(-1, 2), atol=1e-6)
    # On each face of the cube, the texture coordinates are two of the world coordinates, along which u and v increase.
    first = np.eye(3)[across.argmax(axis=1)]
    second = np.eye(3)[2 - across[:, ::-1].argmax(axis=1)]
    np.testing.assert_allclose(layers["tangent"][hit], first, atol=1e-6)
    np.testing.assert_allclose(layers["bitangent"][hit], second, atol=1e-6)
    local = [np.sum(axes * -along[hit], axis=1) for axes in (first, second, normal[hit])]
    np.testing.assert_allclose(layers["to_view"][hit], np.transpose(local), atol=1e-6)
    assert not any(layers[name][~hit].any() for name in names)
    # The mesh has no base colour, so that the layer "albedo" (base colour) must be black.
    assert not shade(plain, layers=["albedo"]).layers["albedo"].any()


def test_base_colours_are_linear():
    corner = box()
    corner.visual = TextureVisuals(uv=corner.visual.uv, material=trimesh.visual.material.PBRMaterial(
        baseColorFactor=[0.2, 0.5, 1.0, 1.0]
    ))  # fmt: skip
    image = shade(corner, layers=["albedo"], pigment=0.0)
    hit = np.isfinite(box_met(VIEW)[0])
    (colour,) = np.unique(image.layers["albedo"][hit], axis=0)
    np.testing.assert_allclose(colour, [0.2, 0.5, 1.0], atol=5e-3)
    assert not image.layers["albedo"][~hit].any()


LIGHTS = [LIGHT, wd.PointLight((1.0, 2.0, 2.0), illuminant="A", power=3.0), wd.DirectionalLight((1.0, 0.1, 0.5))]


def two_boxes():
    """Return two boxes, of which the upper one casts a shadow on the lower one."""
    scene = trimesh.Scene()
    scene.add_geometry(box(), node_name="below", geom_name="below")
    scene.add_geometry(
        box(size=0.4), node_name="above", geom_name="above",
        transform=trimesh.transformations.translation_matrix((0.1, 0.2, 1.1)),
    )  # fmt: skip
    return scene


def test_local_directions_give_the_colours_of_the_picture():
    options = {"tolerance": 0.1, "footprint": False, "coherence": wd.Coherence(sigma_um=4.0)}
    image = wd.shade(two_boxes(), HF, LIGHTS, VIEW, layers=("position", "to_light", "to_view", "scattering"), **options)
    expected = np.zeros_like(image.xyz)
    reached = np.zeros_like(image.mask)
    for index, light in enumerate(LIGHTS):
        to_light, to_view = image.layers[f"to_light.{index}"], image.layers["to_view"]
        lit = to_light.any(axis=2)
        np.testing.assert_array_equal(
            lit, wd.shade(two_boxes(), HF, light, VIEW, plan=image.plan).illuminated, err_msg=str(light)
        )
        for vectors in (to_light[lit], to_view[lit]):
            np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-6)
        np.testing.assert_allclose(image.layers[f"scattering.{index}"][lit], -(to_light + to_view)[lit], atol=1e-6)
        distance = 1.0
        if isinstance(light, wd.PointLight):
            distance = np.linalg.norm(image.layers["position"][lit] - light.position, axis=1)[:, None]
        colours = wd.reflectance(HF, to_light[lit], to_view[lit], illuminant=light.illuminant, plan=image.plan)
        expected[lit] += light.power * colours / distance**2
        reached |= lit
    np.testing.assert_array_equal(reached, image.illuminated)
    # In the shadow of the upper box, the layer with the directions to the first light must be 0.
    everywhere = wd.shade(two_boxes(), HF, LIGHT, VIEW, plan=image.plan, shadows=False).illuminated
    assert np.count_nonzero(image.layers["to_light.0"].any(axis=2)) < 0.95 * np.count_nonzero(everywhere)
    np.testing.assert_allclose(image.xyz, expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize(
    "options",
    [{}, {"samples_per_pixel": 4}, {"footprint": True}, {"method": "direct", "coherence": wd.Coherence(sigma_um=2.0)}],
    ids=["points", "samples", "means", "direct"],
)
def test_the_light_of_single_lights_sums_to_the_picture(options):
    # The direct sum is slow, so its picture has few pixels.
    size = {"width": 4, "height": 3} if "method" in options else {"width": 16, "height": 12}
    view = wd.View(VIEW.eye, VIEW.target, fov_y_deg=30.0, **size)

    def render(lights, **more):
        more = {"tolerance": 0.1, "footprint": False, "strict": False, **options, **more}
        return wd.shade(two_boxes(), HF, lights, view, **more)

    image = render(LIGHTS, layers=["light"])
    assert list(image.layers) == ["light.0", "light.1", "light.2"]
    total = sum(layer.astype(np.float64) for layer in image.layers.values())
    np.testing.assert_allclose(image.xyz, total, atol=1e-6 * total.max())
    # The layer of each light must equal the picture under this light alone, within the tolerance.
    again = {key: value for key, value in options.items() if key not in ("coherence", "method")} | {"plan": image.plan}
    for index, light in enumerate(LIGHTS):
        alone = wd.shade(two_boxes(), HF, light, view, **{"footprint": False, "strict": False, **again})
        np.testing.assert_allclose(image.layers[f"light.{index}"], alone.xyz, atol=1e-6 * total.max())
    error = 1e-6 if "footprint" not in options else 0.1
    together = render(LIGHTS)
    np.testing.assert_allclose(image.xyz, together.xyz, atol=error * total.max())
    np.testing.assert_array_equal(image.coverage, together.coverage)
    np.testing.assert_array_equal(image.illuminated, together.illuminated)


REFUSED = {
    "misspelt": (["lihgt"], [LIGHT], r"layers must be one of 'normal'.*'light', got 'lihgt'; did you mean 'light'\?"),
    "index": (["light.1"], [LIGHT], r"layers must name one of the lights, light\.0 to light\.0, got 'light\.1'"),
    "choice": (["light.3"], [LIGHT] * 64, "layers must not have 'light' for 64 lights, of which .* got 'light.3': "),
    "sky": (
        ["to_light"], [LIGHT, wd.Environment(np.ones((2, 4, 3)))],
        r"layers must not have 'to_light\.1', because lights\[1\] has no single direction: name only .*'to_light\.0'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_layers_are_refused_before_the_picture_is_drawn(case, monkeypatch):
    names, lights, message = REFUSED[case]
    monkeypatch.setattr("warpdiff.render.shade.prepare_surface", lambda *_, **__: pytest.fail("work has begun"))
    with pytest.raises(ValueError, match=message):
        wd.shade(box(), HF, lights, VIEW, layers=names)


def test_a_picture_without_layers_does_no_work_for_them(monkeypatch):
    monkeypatch.setattr("warpdiff.render.shade.layers_of", lambda *_: pytest.fail("layers were computed"))
    image = shade(box(), layers=())
    assert not image.layers
    assert not image.names


def test_the_light_of_single_lights_requires_no_second_picture(monkeypatch):
    made = []
    make = PictureInputs.picture

    def counted(self, *args):
        made.append(args)
        return make(self, *args)

    monkeypatch.setattr(PictureInputs, "picture", counted)
    assert list(shade(box(), layers=("light",)).layers) == ["light.0"]
    assert len(made) == 1
    assert list(shade(box(), layers=("light", "normal")).layers) == ["light.0", "normal"]
    assert len(made) == 3


def test_the_documentation_lists_all_layers():
    page = Path(__file__).parents[2] / "docs" / "how-to" / "layers_and_exr_files.md"
    section = page.read_text(encoding="utf-8").partition("## Layers")[2].partition("##")[0]
    listed = re.findall(r"^\| `([a-z_]+)(?:\.0)?` \|", section, re.MULTILINE)
    assert sorted(listed) == sorted(LAYERS)


def test_layers_are_parts_of_an_exr(tmp_path):
    image = shade(two_boxes(), layers=list(LAYERS))
    path = image.save(tmp_path / "a.exr")
    file = oiio.ImageInput.open(str(path))
    parts = {}
    while file.seek_subimage(len(parts), 0):
        spec = file.spec()
        parts[spec.getattribute("oiio:subimagename")] = spec
    assert list(parts) == ["picture", *image.layers]
    assert tuple(parts["picture"].channelnames) == ("R", "G", "B", "A", "XYZ.X", "XYZ.Y", "XYZ.Z", "error.Y")
    assert {str(spec.format) for spec in parts.values()} == {"float"}
    # The file must state the names of the geometries in the header of the layer with the geometry numbers.
    assert json.loads(parts["geometry"].getattribute("warpdiff:names")) == ["below", "above"]
    copy = wd.Image.load(path)
    assert copy.names == image.names == {"geometry": ("below", "above")}
    assert list(copy.layers) == list(image.layers)
    for name, layer in image.layers.items():
        np.testing.assert_array_equal(copy.layers[name], layer, strict=True)
        pixels = file.read_image(list(parts).index(name), 0, 0, parts[name].nchannels, "float")
        channels = dict(zip(parts[name].channelnames, np.moveaxis(pixels, 2, 0), strict=True))
        for component, suffix in enumerate(LAYERS[name.partition(".")[0]].channels):
            expected = layer[..., component] if layer.ndim == 3 else layer
            np.testing.assert_array_equal(channels[f"{name}.{suffix}"], expected)
    # The layer with the contribution of one light is scaled by the exposure, like the colours of the picture.
    bright = wd.Image.load(image.save(tmp_path / "b.exr", exposure=4.0))
    np.testing.assert_array_equal(bright.layers["light.0"], 4.0 * image.layers["light.0"])
    np.testing.assert_array_equal(bright.layers["position"], image.layers["position"])
    red_and_blue = np.stack([channels["light.0.R"], channels["light.0.B"]], axis=2)
    np.testing.assert_allclose(red_and_blue, image.rgb[..., ::2], atol=1e-6)
    image.save(tmp_path / "a.png")
