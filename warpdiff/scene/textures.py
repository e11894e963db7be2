"""Textures of a scene: decoded images, multiplied by constant colours.

A pyramid is an image with its reductions to half the size. A row is the appearance of one material on one part of the
scene.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.memory import require_memory
from warpdiff.core.wording import ref
from warpdiff.scene import mesh_images
from warpdiff.scene.texture_pyramid import mean_products

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL import Image

    from warpdiff.scene.scene_parts import TextureMap, Wrap

# Memory per texel of an image [bytes]: 16 for the decoded image, 21.3 for the image and its reductions on the device,
# as much while these are made, and 8 while the image is decoded. If doubled, scenes that would fit are refused.
_BYTES_PER_TEXEL = 67.0
# Memory per texel of an image that is multiplied by a colour [bytes]: 32 in double precision, 16 for the result, and
# about 21 on the device with its reductions. If doubled, scenes that would fit are refused.
_BYTES_PER_PRODUCT = 70.0


@dataclass(frozen=True, eq=False)
class Texture:
    """Image that is multiplied by a constant colour.

    Attributes:
        texels: Linear RGBA, row 0 at v = 1, shape (h, w, 4), float32.
        wrap: Wrap modes outside of the image, along u and along v: ``"repeat"``, ``"clamp"`` or ``"mirror"``.
    """

    texels: NDArray[np.float32]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True, eq=False)
class MaterialMaps:
    """Textures of metallic, roughness and emission of a mesh, by row (appearance of one material on one part).

    Attributes:
        metallic_roughness: Texture with roughness in green and metallic in blue, linear; None where a row has none.
        emission: Texture of emission; None where a row has none.
        metallic_roughness_uvs: Texture coordinates of the textures in ``metallic_roughness``, shape (n, 2); NaN at
            vertices without them. None if they are the texture coordinates of the base colour.
        emission_uvs: Texture coordinates of the textures in ``emission``, in the same form.
    """

    metallic_roughness: tuple[Texture | None, ...]
    emission: tuple[Texture | None, ...]
    metallic_roughness_uvs: NDArray[np.floating] | None
    emission_uvs: NDArray[np.floating] | None

    def at(self, index: NDArray[np.int64], uvs: NDArray[np.float32]) -> MaterialMaps:
        """Return these textures for a mesh whose vertices have been duplicated or removed.

        Args:
            index: For each new vertex, the index of the old vertex from which it comes.
            uvs: Texture coordinates of the base colour at the new vertices, shape (n, 2).
        """

        def moved(values: NDArray[np.floating] | None) -> NDArray[np.float32] | None:
            if values is None:
                return None
            own = values[index].astype(np.float32)
            own = np.where(np.isnan(own), uvs, own)
            return None if np.array_equal(own, uvs) else own

        return MaterialMaps(
            self.metallic_roughness, self.emission, moved(self.metallic_roughness_uvs), moved(self.emission_uvs)
        )


class TextureImages:
    """Decoded images of a scene, multiplied by colours. Equal images with equal colours are stored once."""

    def __init__(self) -> None:
        self._decoded: list[tuple[Image.Image, bool, NDArray[np.float32] | None]] = []
        self._by_content: dict[bytes, NDArray[np.float32]] = {}
        self._textures: list[tuple[NDArray[np.float32], NDArray[np.float64], Texture]] = []

    def texture(self, source: TextureMap, colour: Sequence[float], *, is_roughness: bool = False) -> Texture | None:
        """Return an image multiplied by a linear RGBA colour, or None with a warning if the image is damaged.

        Args:
            source: The image, and how texture coordinates address it.
            colour: Linear RGBA.
            is_roughness: Whether the image has roughness in green and metallic in blue, which are linear. The texture
                then has two further values in red and alpha, as means over each texel: the squared roughness, and the
                product of roughness and metallic.

        Raises:
            MemoryError: The image requires more memory than is free.
        """
        if source.image is None:
            return None
        pixels = self._pixels(source.image, is_roughness=is_roughness)
        if pixels is None:
            return None
        factor = np.array(colour, dtype=np.float64)
        for decoded, known, texture in self._textures:
            if decoded is pixels and np.array_equal(known, factor):
                if texture.wrap == source.wrap:
                    return texture
                return self._stored(pixels, factor, Texture(texture.texels, source.wrap))
        if np.all(factor == 1.0):
            return self._stored(pixels, factor, Texture(pixels, source.wrap))
        height, width, _ = pixels.shape
        require_memory(
            _BYTES_PER_PRODUCT * height * width,
            f"the texture {_name_of(source.image)!r} of {ref('mesh')} times a colour, {width} × {height} pixels,",
            "give an image with {side} times the width and height",
        )
        texels = (pixels * factor).astype(np.float32)
        return self._stored(pixels, factor, Texture(texels, source.wrap))

    def _stored(self, pixels: NDArray[np.float32], factor: NDArray[np.float64], texture: Texture) -> Texture:
        self._textures.append((pixels, factor, texture))
        return texture

    def _pixels(self, image: Image.Image, *, is_roughness: bool) -> NDArray[np.float32] | None:
        for known, as_roughness, pixels in self._decoded:
            if known is image and as_roughness == is_roughness:
                return pixels
        require_memory(
            _BYTES_PER_TEXEL * image.width * image.height,
            f"the texture {_name_of(image)!r} of {ref('mesh')}, {image.width} × {image.height} pixels,",
            "give an image with {side} times the width and height",
        )
        pixels = mesh_images.linear_rgba(image, is_data=is_roughness)
        if pixels is not None:
            if is_roughness:
                pixels[..., 0] = mean_products(pixels[..., 1], pixels[..., 1])
                pixels[..., 3] = mean_products(pixels[..., 1], pixels[..., 2])
            digest = hashlib.blake2b(str(pixels.shape).encode() + pixels.tobytes()).digest()
            pixels = self._by_content.setdefault(digest, pixels)
        self._decoded.append((image, is_roughness, pixels))
        return pixels


def _name_of(image: Image.Image) -> str:
    """Return the name of an image for messages."""
    return str(image.info.get("file_path") or "an image")
