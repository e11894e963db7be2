"""Random glTF scenes of two to four parts that lack textures, texture coordinates, colours or materials.

Each image has a single colour. The expected values at hits therefore follow from the rules of the format alone.
"""

import base64
import io

import numpy as np
import pytest
import warp as wp
from gltf_files import SQUARE, SQUARE_UVS, UP, GltfFile
from PIL import Image

import warpdiff as wd
from warpdiff.optics.colorimetry import srgb_decode
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import prepare_surface

FACTORS = {"baseColorFactor": 4, "metallicFactor": 0, "roughnessFactor": 0, "emissiveFactor": 3}
TEXTURES = ("baseColorTexture", "metallicRoughnessTexture", "emissiveTexture")


def random_material(rng, file):
    """Add a random material to a glTF file; return its factors, its textures, and whether its alpha mode is MASK.

    A texture is returned as the colour of its image (None if the image is missing), and the n of the texture
    coordinates TEXCOORD_n that it uses.
    """
    values = {name: rng.uniform(size=size or None) for name, size in FACTORS.items() if rng.random() < 0.7}
    textures = {}
    for name in TEXTURES:
        if rng.random() < 0.5:
            texel, number = rng.integers(0, 256, 4, dtype=np.uint8), int(rng.integers(2))
            stream = io.BytesIO()
            Image.fromarray(np.tile(texel, (2, 3, 1))).save(stream, "png")
            is_missing = rng.random() < 0.2
            uri = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
            file.tree["images"].append({"uri": "missing.png" if is_missing else uri})
            file.tree["textures"].append({"source": len(file.tree["images"]) - 1})
            textures[name] = (None if is_missing else texel / 255.0, number)
    mode = rng.choice(["OPAQUE", "OPAQUE", "MASK"])
    tree = {"alphaMode": str(mode), "pbrMetallicRoughness": {}}
    for name, value in values.items():
        own = tree if name.startswith("emissive") else tree["pbrMetallicRoughness"]
        own[name] = np.asarray(value).tolist()
    first = len(file.tree["textures"]) - len(textures)
    for index, (name, (_, number)) in enumerate(textures.items(), first):
        own = tree if name.startswith("emissive") else tree["pbrMetallicRoughness"]
        own[name] = {"index": index, "texCoord": number}
    file.tree["materials"].append(tree)
    return values, textures, mode == "MASK"


def expected_of(material, sets, vertex_colour):
    """Return the expected base colour (or None), visibility, metallic and roughness, and emission of a part of a scene.

    The values follow from the rules of the glTF format. ``sets`` are the n of the part's texture coordinates
    TEXCOORD_n.
    """
    values, textures, is_mask = material or ({}, {}, False)
    texel, number = textures.get("baseColorTexture", (None, 0))
    colour = values.get("baseColorFactor")
    if texel is not None:
        colour = np.ones(4) if colour is None else colour
    if texel is not None and number in sets:
        colour = colour * [*srgb_decode(texel[:3]), texel[3]]
    elif vertex_colour is not None:
        colour = vertex_colour * (1.0 if colour is None else colour)
    texel, _ = textures.get("metallicRoughnessTexture", (None, 0))
    # A part without the texture coordinates that a texture requires has the mean value of the texture. Here a texture
    # has one colour, so that its mean is this colour.
    gloss = [values.get("metallicFactor", 1.0), values.get("roughnessFactor", 1.0)]
    gloss *= np.ones(2) if texel is None else texel[[2, 1]]
    emission = values.get("emissiveFactor", np.zeros(3))
    if "emissiveTexture" in textures:
        texel, number = textures["emissiveTexture"]
        emission = emission * (0.0 if texel is None or number not in sets else srgb_decode(texel[:3]))
    is_visible = not is_mask or colour is None or colour[3] >= 0.5
    return colour, is_visible, gloss, emission


@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
@pytest.mark.parametrize("seed", range(4))
def test_parts_have_the_values_of_their_own_materials(tmp_path, seed):
    rng = np.random.default_rng(seed)
    for _ in range(12):
        file = GltfFile()
        file.tree |= {"images": [], "textures": [], "materials": [], "meshes": [], "nodes": []}
        materials = [random_material(rng, file) for _ in range(rng.integers(1, 4))]
        parts = []
        for number in range(rng.integers(2, 5)):
            sets = {0, 1} if rng.random() < 0.4 else {0} if rng.random() < 0.5 else set()
            colour = rng.uniform(size=4) if rng.random() < 0.4 else None
            attributes = {"POSITION": (SQUARE + np.array([1.2 * number, 0, 0])).astype("<f4"), "NORMAL": UP}
            attributes |= {f"TEXCOORD_{index}": SQUARE_UVS for index in sets}
            attributes |= {} if colour is None else {"COLOR_0": np.tile(colour, (4, 1)).astype("<f4")}
            chosen = int(rng.integers(-1, len(materials)))
            file.tree["meshes"].append({"primitives": [], "name": f"p{number}"})
            file.tree["nodes"].append({"mesh": number})
            file.primitive(attributes, mesh=number, **({} if chosen < 0 else {"material": chosen}))
            material = None if chosen < 0 else materials[chosen]
            parts.append((expected_of(material, sets, colour), chosen, bool(rng.random() < 0.7)))
        file.tree["scenes"] = [{"nodes": list(range(len(parts)))}]
        plain = {f"p{number}": is_plain for number, (_, _, is_plain) in enumerate(parts)}
        surface = prepare_surface(file.write(tmp_path / "a.gltf"), plain=plain, tangents="x")
        check(surface, parts, float(rng.choice([0.0, 0.5])))


def check(surface, parts, deviation):
    """Check that rays to the middle of each part of a scene find the expected colour, metallic, roughness and emission.

    ``deviation`` is the standard deviation of the filter of textures [pixels].
    """
    middle = 0.6 * len(parts) - 0.1
    view = wd.View.orthographic(
        (middle, 0.5, 5), (middle, 0.5, 0), extent_y=1.2, width=12 * len(parts), height=12
    )  # fmt: skip
    rays = rays_for(surface, view, device=wp.get_device("cpu"), threads=1)
    rays.launch(rays.trace(0, 1, deviation))
    pixels = rays.gbuffer.pixels
    has_colour = any(colour is not None for (colour, *_), _, _ in parts)
    assert surface.has_base_colour == has_colour
    for number, ((colour, is_visible, gloss, emission), chosen, is_plain) in enumerate(parts):
        ray = 6 * 12 * len(parts) + 12 * number + 6
        assert (pixels.hit.numpy()[ray] > 0) == is_visible
        if not is_visible:
            continue
        if has_colour:
            expected = (np.ones(3) if is_plain else np.zeros(3)) if colour is None else colour[:3]
            np.testing.assert_allclose(pixels.base_colour.numpy()[ray], expected, atol=3e-5)
        if is_plain and chosen >= 0:
            row, factors = surface.rows[pixels.face.numpy()[ray]], surface.material_factors
            own = np.array([factors.metallic[row], factors.roughness[row]])
            emitted = factors.emission[row]
            if rays.gbuffer.has_maps:
                own = own * pixels.metallic_roughness.numpy()[ray, :2]
                emitted = emitted * pixels.emission.numpy()[ray]
            np.testing.assert_allclose(own, gloss, atol=1e-4)
            np.testing.assert_allclose(emitted, emission, atol=1e-4)
