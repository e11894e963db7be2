"""Materials, textures and images of a glTF file."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, cast

import numpy as np

from warpdiff.scene.gltf.gltf_buffers import UnreadableUriError
from warpdiff.scene.gltf.gltf_values import Element
from warpdiff.scene.mesh_images import opened
from warpdiff.scene.scene_parts import Appearance, TextureMap, identity_transform, unique_names

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image

    from warpdiff.scene.gltf.gltf_buffers import Container
    from warpdiff.scene.scene_parts import AlphaMode, Wrap

_SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
# Names of extensions of textures whose images Pillow can read.
_IMAGE_EXTENSIONS = ("EXT_texture_webp", "EXT_texture_avif")
_WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
# Features of materials that have no effect on pictures, by the names of their extensions.
_NOT_RENDERED = {
    "KHR_materials_anisotropy": "anisotropy",
    "KHR_materials_clearcoat": "clearcoat",
    "KHR_materials_diffuse_transmission": "diffuse transmission",
    "KHR_materials_dispersion": "dispersion",
    "KHR_materials_iridescence": "iridescence",
    "KHR_materials_sheen": "sheen",
    "KHR_materials_specular": "specular colour",
    "KHR_materials_subsurface": "subsurface scattering",
    "KHR_materials_transmission": "transmission",
    "KHR_materials_unlit": "unlit shading",
    "KHR_materials_volume": "volume",
    _SPECULAR_GLOSSINESS: "specular colour",
}
# Index of refraction of dielectric materials, from appendix B of the glTF specification. Other indices that a file
# states have no effect on pictures.
_IOR = 1.5
# Names of material extensions about which no warning is required: extensions that are read, or that have no effect on
# their own.
_READ = ("KHR_materials_emissive_strength", "KHR_materials_ior")


class Materials:
    """Materials of a glTF file. Images are opened when they are first used, and their pixels are decoded later.

    Attributes:
        names: Names of the materials, which all differ.
        not_read: Texts about textures of the file that are not read, for a warning.
        ignored: Reasons why images are ignored, by the names of their files.
    """

    def __init__(self, container: Container) -> None:
        """Store the container of a glTF file. Materials are read from it later."""
        root = container.root
        self._container = container
        self._elements = root.elements("materials")
        self._textures, self._samplers = root.elements("textures"), root.elements("samplers")
        self._images = root.elements("images")
        self._appearances: dict[int, Appearance] = {}
        self._opened: dict[int, Image.Image | None] = {}
        self.names = unique_names((material.text("name") for material in self._elements), "material")
        self.not_read: dict[str, None] = {}
        self.ignored: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._elements)

    def appearance(self, index: int) -> Appearance:
        """Return the appearance of the material with the index ``index`` in the file."""
        if index not in self._appearances:
            self._appearances[index] = self._appearance(index)
        return self._appearances[index]

    def _appearance(self, index: int) -> Appearance:
        material = self._elements[index]
        name = self.names[index]
        alpha_mode = material.text("alphaMode", "OPAQUE")
        if alpha_mode not in ("OPAQUE", "MASK", "BLEND"):
            material.refuse("alphaMode", f"must be OPAQUE, MASK or BLEND, got {alpha_mode[:20]!r}")
        strength = material.extension("KHR_materials_emissive_strength")
        emission = np.array(material.numbers("emissiveFactor", (0.0, 0.0, 0.0)))
        emission *= 1.0 if strength is None else strength.number("emissiveStrength", 1.0, least=0.0)
        metal = material.element("pbrMetallicRoughness") or Element({}, material.place)
        metallic, roughness = metal.number("metallicFactor", 1.0), metal.number("roughnessFactor", 1.0)
        colour, texture = self._base(metal, "baseColorFactor", "baseColorTexture")
        glossy = material.extension(_SPECULAR_GLOSSINESS)
        if glossy is not None:
            metallic, roughness = 0.0, 1.0 - glossy.number("glossinessFactor", 1.0)
            colour, texture = self._base(glossy, "diffuseFactor", "diffuseTexture")
        return Appearance(
            name=name, base_colour=colour, base_texture=texture,
            metallic=metallic, roughness=roughness,
            metallic_roughness_texture=None if glossy else self._texture(metal, "metallicRoughnessTexture"),
            emission=cast("tuple[float, float, float]", tuple(emission.tolist())),
            emission_texture=self._texture(material, "emissiveTexture"),
            alpha_mode=cast("AlphaMode", alpha_mode.lower()), alpha_cutoff=material.number("alphaCutoff", 0.5),
            not_rendered=_not_rendered(material),
        )  # fmt: skip

    def normal_uv_set(self, index: int) -> int:
        """Return n for the texture coordinates TEXCOORD_n of a material's normal map, to which tangents belong."""
        reference = self._elements[index].element("normalTexture")
        return 0 if reference is None else _uv_set(reference)

    def _base(
        self, owner: Element, factor: str, texture: str
    ) -> tuple[tuple[float, float, float, float] | None, TextureMap | None]:
        """Return base colour and base-colour texture of a material.

        The colour is None if the file states none and no texture can be read.
        """
        image = self._texture(owner, texture)
        if factor not in owner and (image is None or image.image is None):
            return None, image
        red, green, blue, alpha = owner.numbers(factor, (1.0,) * 4)
        return (red, green, blue, alpha), image

    def _texture(self, owner: Element, name: str) -> TextureMap | None:
        """Return the texture to which the JSON member ``name`` of a material refers, or None."""
        reference = owner.element(name)
        if reference is None:
            return None
        texture = self._textures[reference.integer("index", most=len(self._textures) - 1)]
        wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
        number = texture.index("sampler", len(self._samplers))
        if number is not None:
            sampler = self._samplers[number]
            wrap = (_wrap(sampler, "wrapS"), _wrap(sampler, "wrapT"))
        return TextureMap(self._image_of(texture), _uv_set(reference), _uv_transform(reference), wrap)

    def _image_of(self, texture: Element) -> Image.Image | None:
        """Return the image of a texture, or None if the texture has no image that can be read."""
        source = texture.index("source", len(self._images))
        for name in _IMAGE_EXTENSIONS:
            extension = texture.extension(name)
            if source is None and extension is not None:
                source = extension.index("source", len(self._images))
        if source is not None:
            return self._image(source)
        kinds = texture.element("extensions")
        compressed = ", ".join(sorted(kinds.values)) if kinds is not None else ""
        self.not_read[f"{texture.place} ({compressed or 'which has no image'})"] = None
        return None

    def _image(self, index: int) -> Image.Image | None:
        """Return the image with the index ``index`` in the file, or None if it cannot be read."""
        if index not in self._opened:
            image = self._images[index]
            uri = image.text("uri")
            is_file = bool(uri) and not uri.startswith("data:")
            label = uri[:200] if is_file else image.text("name")[:200] or image.place
            result = None
            try:
                if uri:
                    data = self._container.resource(uri)
                else:
                    data = bytes(self._container.view(image.integer("bufferView", most=len(self._container.views) - 1)))
                result = opened(data)
            except (UnreadableUriError, OSError) as error:
                self.ignored[label] = str(error)
            if result is not None:
                # The file name is stored in the image for warnings about pixels that cannot be decoded later.
                result.info["file_path"] = uri if is_file else f"an image in {self._container.name}"
            self._opened[index] = result
        return self._opened[index]


def _uv_set(reference: Element) -> int:
    """Return n for the texture coordinates TEXCOORD_n that a material's reference to a texture uses."""
    number = reference.integer("texCoord", 0)
    transform = reference.extension("KHR_texture_transform")
    return number if transform is None else transform.integer("texCoord", number)


def _uv_transform(reference: Element) -> NDArray[np.float64]:
    """Return the transform of texture coordinates that a reference to a texture states, v upwards, shape (2, 3)."""
    transform = reference.extension("KHR_texture_transform")
    if transform is None:
        return identity_transform()
    (u0, v0), (su, sv) = transform.numbers("offset", (0.0, 0.0)), transform.numbers("scale", (1.0, 1.0))
    angle = transform.number("rotation", 0.0)
    cosine, sine = math.cos(angle), math.sin(angle)
    # The glTF extension defines the matrix of a texture transform for texture coordinates with v downwards. Here v
    # points upwards, so that v is replaced by 1 − v on both sides.
    a, b, d, e = cosine * su, sine * sv, -sine * su, cosine * sv
    return np.array([[a, -b, b + u0], [-d, e, 1.0 - e - v0]])


def _wrap(sampler: Element, name: str) -> Wrap:
    """Return the wrap mode of a texture, which continues it outside of its image: repeat, clamp or mirror."""
    kind = sampler.integer(name, 10497)
    if kind not in _WRAPS:
        sampler.refuse(name, f"must be one of {', '.join(map(str, _WRAPS))}, got {kind}")
    return _WRAPS[kind]


def _not_rendered(material: Element) -> tuple[str, ...]:
    """Return the features of a material that have no effect on pictures."""
    features = []
    if "normalTexture" in material:
        features.append("normal map")
    if "occlusionTexture" in material:
        features.append("occlusion")
    extensions = material.element("extensions")
    names = () if extensions is None else (name for name in extensions.values if name not in _READ)
    ior = material.extension("KHR_materials_ior")
    if ior is not None and ior.number("ior", _IOR) != _IOR:
        features.append("index of refraction")
    features += [_NOT_RENDERED.get(name, re.sub(r"[^\w]", "?", name)[:60]) for name in names]
    return tuple(dict.fromkeys(features))
