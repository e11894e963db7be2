"""Metallic, roughness and emission of materials: reading them from files, and their use on plain surfaces.

A plain surface has no height field, and reflects by base colour, metallic and roughness.
"""

import warnings

import numpy as np
import pytest
import trimesh
from gltf_files import SQUARE, SQUARE_UVS, UP, square_file
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.scene.mesh_files import load
from warpdiff.scene.mesh_import import prepare_surface

OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"


def factors(path):
    return prepare_surface(path, plain={"*": True}).material_factors


def test_the_defaults_of_gltf_materials_are_those_of_the_specification(tmp_path):
    file = square_file(material=0)
    file.material(pbrMetallicRoughness={"baseColorFactor": [0.5, 0.5, 0.5, 1.0]})
    for number, values in enumerate(({"metallicFactor": 0.25}, {"roughnessFactor": 0.5, "metallicFactor": 0.0}), 1):
        file.primitive({"POSITION": SQUARE + number, "NORMAL": UP, "TEXCOORD_0": SQUARE_UVS}, material=number)
        strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
        file.material(pbrMetallicRoughness=values, emissiveFactor=[0.5, 0.0, 0.25], extensions=strength)
    read = factors(file.write(tmp_path / "a.gltf"))
    np.testing.assert_allclose(read.metallic, [1.0, 0.25, 0.0])
    np.testing.assert_allclose(read.roughness, [1.0, 1.0, 0.5])
    np.testing.assert_allclose(read.emission, [[0, 0, 0], [2, 0, 1], [2, 0, 1]])


def test_textures_without_their_coordinates_are_named_and_roughness_counts_with_its_mean(tmp_path):
    file = square_file(material=0)
    file.material(texture={}, name="body")
    elsewhere = {"index": 0, "texCoord": 3}
    metal = {"metallicFactor": 0.5, "roughnessFactor": 1.0, "metallicRoughnessTexture": elsewhere}
    file.tree["materials"][0] |= {
        "pbrMetallicRoughness": metal, "emissiveFactor": [1, 1, 1], "emissiveTexture": elsewhere,
    }  # fmt: skip
    path = file.write(tmp_path / "a.gltf")
    names = "metallic-roughness texture except for its mean, emission texture that cannot be sampled of 'body'"
    with pytest.warns(WarpdiffWarning, match=names):
        read = factors(path)
    (image,) = (part.appearance.metallic_roughness_texture.image for part in load(path))
    _, green, blue = np.asarray(image.convert("RGB"), dtype=float).reshape(-1, 3).mean(axis=0) / 255.0
    np.testing.assert_allclose([read.metallic[0], read.roughness[0]], [0.5 * blue, green], rtol=1e-6)
    assert not read.emission.any()
    # The material's texture requires the texture coordinates TEXCOORD_3. The first part of the mesh lacks them. Its
    # metallic and roughness are multiplied by the mean of the texture, and its emission is 0. A second part with
    # TEXCOORD_3 is added. Its metallic, roughness and emission are those of the material.
    attributes = {"POSITION": SQUARE + 2, "NORMAL": UP, "TEXCOORD_0": SQUARE_UVS, "TEXCOORD_3": SQUARE_UVS}
    file.primitive(attributes, material=0)
    with pytest.warns(WarpdiffWarning, match=names):
        surface = prepare_surface(file.write(tmp_path / "b.gltf"), plain={"*": True})
    read = surface.material_factors
    np.testing.assert_array_equal(surface.rows, [0, 0, 1, 1])
    np.testing.assert_allclose([read.metallic[1], read.roughness[1]], [0.5, 1.0])
    np.testing.assert_array_equal(read.emission, [[0, 0, 0], [1, 1, 1]])
    assert [texture is None for texture in surface.maps.metallic_roughness] == [True, False]


def test_textures_that_cannot_be_read_are_named(tmp_path):
    file = square_file(material=0)
    file.material(texture={}, name="body")
    file.tree["images"].append({"uri": "missing.png"})
    file.tree["textures"].append({"source": 1})
    metal = {"metallicFactor": 0.5, "roughnessFactor": 0.25, "metallicRoughnessTexture": {"index": 1}}
    file.tree["materials"][0] |= {
        "pbrMetallicRoughness": metal, "emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 1},
    }  # fmt: skip
    with pytest.warns(WarpdiffWarning) as caught:
        read = factors(file.write(tmp_path / "a.gltf"))
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == 2
    assert "refers to 'missing.png', which is ignored" in messages[0]
    assert messages[1].endswith(
        "not rendered: metallic-roughness texture, emission texture that cannot be sampled of 'body'"
    )
    assert (read.metallic[0], read.roughness[0]) == (0.5, 0.25)
    assert not read.emission.any()


def mtl(folder, lines):
    (folder / "a.obj").write_text(OBJ)
    (folder / "a.mtl").write_text("newmtl a\n" + lines)
    return folder / "a.obj"


def check(read, expected):
    """Assert that material factors equal (metallic, roughness, emission), or are None if ``expected`` is None."""
    if expected is None:
        assert read is None
        return
    assert (read.metallic[0], read.roughness[0]) == expected[:2]
    np.testing.assert_allclose(read.emission[0], expected[2])


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("Kd 0.5 0.5 0.5\nKs 1 1 1\nNs 200\nd 1\nTr 0\n", None),
        ("Tr 1\n", None),
        ("Pm 1\nPr 0.25\n", (1.0, 0.25, (0, 0, 0))),
        ("Kd 1 0 0\nPr 0.5\nKe 1 2 3\n", (0.0, 0.5, (1, 2, 3))),
        ("Ke 0 1 0\n", (0.0, -1.0, (0, 1, 0))),
    ],
)
def test_keys_of_mtl_files(tmp_path, lines, expected):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = factors(mtl(tmp_path, lines))
    check(read, expected)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("Pm nan\n", "finite Pm, got nan"),
        ("Pr -inf\n", "finite Pr, got -inf"),
        ("Ke 0 1 inf\n", "finite Ke, got 0, 1, inf"),
        ("Kd nan 0 1\n", "finite Kd, got nan, 0, 1"),
    ],
)
def test_keys_of_mtl_files_that_are_not_finite_are_refused(tmp_path, lines, message):
    with pytest.raises(ValueError, match=f"material 'a' must have a {message}"):
        factors(mtl(tmp_path, "Kd 1 0 0\n" + lines))


@pytest.mark.parametrize(
    ("lines", "message", "expected"),
    [
        ("Pm 7\n", "set to 0 or 1: metallic 7 of 'a'", (1.0, 1.0, (0, 0, 0))),
        ("Pr -1\nKe -1 5 0\n", "roughness -1 of 'a'; emission -1, 5, 0 of 'a'", (0.0, 0.0, (0, 5, 0))),
        ("Pm one\nPr\nKe 1 2\n", "not rendered: .*'one' of Pm, the unreadable value '1 2' of Ke of 'a'", None),
        ("map_Pr a.png\nmap_Ke b.png\n", "not rendered: texture of roughness, texture of emission of 'a'", None),
        ("map_d a.png\nbump b.png\nd 0.5\n", "texture of transparency, bump map, transparency of 'a'", None),
    ],
)
def test_keys_of_mtl_files_without_their_effect_are_named(tmp_path, lines, message, expected):
    with pytest.warns(WarpdiffWarning, match=message):
        read = factors(mtl(tmp_path, lines))
    check(read, expected)


def test_colours_of_mtl_files_are_from_0_to_1(tmp_path):
    with pytest.warns(WarpdiffWarning, match="base colour 2, -1, 0[.]214[0-9]*, 1 of 'a'"):
        surface = prepare_surface(mtl(tmp_path, "Kd 2 -1 0.5\n"), plain={"*": True})
    np.testing.assert_allclose(surface.plain_colour, [1.0, 0.0, 0.214], atol=1e-3)


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999"])
@pytest.mark.parametrize("name", ["baseColorFactor", "metallicFactor", "roughnessFactor", "emissiveFactor"])
def test_factors_of_gltf_files_that_are_not_finite_are_refused(tmp_path, name, value):
    file = square_file(material=0)
    numbers = {"baseColorFactor": [1.0, 0.125, 1.0, 1.0], "emissiveFactor": [1.0, 0.125, 1.0]}.get(name, 0.125)
    file.material(**({name: numbers} if name == "emissiveFactor" else {"pbrMetallicRoughness": {name: numbers}}))
    path = file.write(tmp_path / "a.gltf")
    path.write_text(path.read_text().replace("0.125", value))
    with pytest.raises(ValueError, match=rf"{name}.* must be a finite number"):
        factors(path)


@pytest.mark.parametrize("name", ["metallicFactor", "roughnessFactor", "emissiveFactor", "alphaCutoff"])
def test_factors_in_memory_that_are_not_finite_are_refused(name):
    value = [0.0, np.nan, 0.0] if name == "emissiveFactor" else np.nan
    label = {"emissiveFactor": "emission", "alphaCutoff": "alpha cut-off"}.get(name, name.removesuffix("Factor"))
    with pytest.raises(ValueError, match=f"material 'm' must have a finite {label}, got .*nan"):
        prepare_surface(quad(0.0, PBRMaterial(name="m", **{name: value})), plain={"*": True})


def test_factors_of_gltf_files_outside_of_their_limits_are_named_once(tmp_path):
    colours = np.array([[2.0, 0.5, -1.0, 1.0]] * 4, "<f4")
    file = square_file({"COLOR_0": colours}, material=0)
    strange = {"baseColorFactor": [0.5, 1.0, 1.0, 1.0], "metallicFactor": -0.5, "roughnessFactor": 3.0}
    file.material(name="odd", pbrMetallicRoughness=strange, emissiveFactor=[-2.0, 3.0, 0.0])
    with pytest.warns(WarpdiffWarning) as caught:
        surface = prepare_surface(file.write(tmp_path / "a.gltf"), plain={"*": True})
    (message,) = (str(warning.message) for warning in caught)
    listing = "metallic -0.5 of 'odd'; roughness 3 of 'odd'; emission -2, 3, 0 of 'odd'; vertex colours of 'mesh 0'"
    assert message.endswith(f"outside of 0 to 1, which are set to 0 or 1: {listing}")
    read = surface.material_factors
    np.testing.assert_array_equal([read.metallic[0], read.roughness[0]], [0.0, 1.0])
    np.testing.assert_array_equal(read.emission[0], [0.0, 3.0, 0.0])
    np.testing.assert_allclose(surface.plain_colour, [0.5, 0.5, 0.0])


def test_extensions_without_effect_are_named(tmp_path):
    file = square_file(material=0, extensions={"KHR_materials_variants": {"mappings": []}})
    file.material(name="glass", extensions={"KHR_materials_ior": {"ior": 1.3}})
    with pytest.warns(WarpdiffWarning) as caught:
        prepare_surface(file.write(tmp_path / "a.gltf"))
    messages = [str(warning.message) for warning in caught]
    assert any("not rendered: index of refraction of 'glass'" in message for message in messages)
    assert any("not read: variants of the materials of mesh 'mesh 0'" in message for message in messages)
    file.tree["materials"][0]["extensions"]["KHR_materials_ior"]["ior"] = 1.5
    del file.tree["meshes"][0]["primitives"][0]["extensions"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prepare_surface(file.write(tmp_path / "b.gltf"))


def quad(x, material):
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return trimesh.Trimesh(
        corners + np.array([x, 0.0, 0.0]), [[0, 1, 2], [0, 2, 3]], process=False,
        visual=TextureVisuals(uv=corners[:, :2], material=material),
    )  # fmt: skip


def metal(name, **values):
    """Return a material of trimesh for a rough metal."""
    return PBRMaterial(name=name, metallicFactor=1.0, roughnessFactor=0.4, **values)


WAVE = wd.gratings.sinusoidal(1.5, 0.1)
LIGHT = wd.DirectionalLight((0.3, 0.0, 1.0))
VIEW = wd.View.orthographic((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), extent_y=2.0, width=24, height=8)
OPTIONS = {"coherence": wd.Coherence(sigma_um=5.0), "tolerance": 0.1, "refine": False}


def test_materials_without_metallic_and_roughness_are_matte_beside_glossy_ones():
    parts = {"matte": PBRMaterial(name="matte", baseColorFactor=[255, 100, 50, 255]), "grating": None}
    bodies = {name: quad(2.1 * index, material) for index, (name, material) in enumerate(parts.items())}
    gold = quad(
        -2.1, PBRMaterial(name="gold", baseColorFactor=[255, 200, 90, 255], metallicFactor=1.0, roughnessFactor=0.3)
    )
    surfaces = {"grating": WAVE, "*": None}
    alone = wd.shade(trimesh.Scene(bodies), surfaces, LIGHT, VIEW, **OPTIONS, footprint=False)
    together = wd.shade(trimesh.Scene(bodies | {"gold": gold}), surfaces, LIGHT, VIEW, **OPTIONS, footprint=False)
    # Positions and normals are stored relative to the bounding sphere of the mesh. The mesh with the part "gold" has a
    # larger sphere, so that positions and normals are rounded differently.
    np.testing.assert_allclose(together.xyz[:, 9:], alone.xyz[:, 9:], rtol=1e-5, atol=1e-9)
    assert np.all(alone.xyz[:, :7] == 0.0)
    assert np.all(together.xyz[1:-1, 1:7, 1] > 0.0)


def test_textures_of_trimesh_without_effect_are_named():
    image = Image.new("RGB", (2, 2))
    own = PBRMaterial(name="bumpy", normalTexture=image, occlusionTexture=image)
    with pytest.warns(WarpdiffWarning, match="not rendered: normal map, occlusion of 'bumpy'"):
        prepare_surface(quad(0.0, own))


def test_emission_on_a_height_field_is_named_in_a_warning():
    lamp = PBRMaterial(name="lamp", baseColorFactor=[255] * 4, emissiveFactor=[1.0, 0.0, 0.0])
    match = r"emission is not rendered where faces have a height field: 'lamp'"
    with pytest.warns(WarpdiffWarning, match=match):
        wd.shade(quad(0.0, lamp), WAVE, LIGHT, VIEW, **OPTIONS)
    body = trimesh.Scene({"lamp": quad(-1.1, lamp), "other": quad(1.1, None)})
    with pytest.warns(WarpdiffWarning, match=match):
        wd.Renderer(body, {"lamp": WAVE, "*": None}, LIGHT, VIEW, **OPTIONS)
    wd.shade(body, {"other": WAVE, "*": None}, LIGHT, VIEW, **OPTIONS)


def test_a_renderer_draws_the_plain_surfaces_of_shade():
    gold = metal("gold", baseColorFactor=[255, 200, 90, 255], emissiveFactor=[0.1, 0.0, 0.0])
    body = trimesh.Scene({"gold": quad(-1.1, gold), "other": quad(1.1, None)})
    surfaces = {"other": WAVE, "*": None}
    renderer = wd.Renderer(body, surfaces, LIGHT, VIEW, **OPTIONS)
    for lights in (
        wd.PointLight((0.0, 1.0, 3.0), power=5.0),
        [LIGHT, wd.Environment.clear_sky((0.3, 1.0, 0.8))],
        LIGHT,
    ):
        renderer.draw(lights)
        expected = wd.shade(body, surfaces, lights, VIEW, **OPTIONS, plan=renderer.plan)
        np.testing.assert_array_equal(renderer.image().xyz[:, 2:11], expected.xyz[:, 2:11])
        assert expected.xyz[4, 6, 0] > 0.0
