"""Textures of a scene: decoded images times constant colours, and their table on a device."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.core.memory import MOST_ELEMENTS, require_memory
from warpdiff.core.wording import ref
from warpdiff.kernels.structs import Textures
from warpdiff.scene import mesh_images
from warpdiff.scene.texture_pyramid import pyramid, sizes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL import Image

    from warpdiff.scene.scene_parts import TextureMap, Wrap

# Codes of continuations, as in kernels/native/textures.h.
_WRAPS: dict[Wrap, int] = {"repeat": 0, "clamp": 1, "mirror": 2}
# Memory for a texel of an image: 16 bytes decoded, 21.3 bytes for its pyramid on the device and as much while it is
# made, and 8 bytes while it is decoded. If doubled, scenes that would fit are refused.
_BYTES_PER_TEXEL = 67.0


@dataclass(frozen=True, eq=False)
class Texture:
    """Image times a constant colour.

    Attributes:
        texels: Linear RGBA, row 0 at v = 1, shape (h, w, 4), float32.
        wrap: Continuation outside of the image along u and along v.
    """

    texels: NDArray[np.float32]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


class TextureImages:
    """Decoded images of a scene. Equal images times equal colours are stored once."""

    def __init__(self) -> None:
        self._decoded: list[tuple[Image.Image, NDArray[np.float32] | None]] = []
        self._by_content: dict[bytes, NDArray[np.float32]] = {}
        self._textures: list[tuple[NDArray[np.float32], NDArray[np.float64], Texture]] = []

    def texture(self, source: TextureMap, colour: Sequence[float]) -> Texture | None:
        """Return an image times a linear RGBA, or None with a warning if the image is damaged.

        Raises:
            MemoryError: The image requires more memory than is free.
        """
        if source.image is None:
            return None
        pixels = self._pixels(source.image)
        if pixels is None:
            return None
        factor = np.array(colour, dtype=np.float64)
        for decoded, known, texture in self._textures:
            if decoded is pixels and np.array_equal(known, factor):
                if texture.wrap == source.wrap:
                    return texture
                return self._stored(pixels, factor, Texture(texture.texels, source.wrap))
        texels = pixels if np.all(factor == 1.0) else (pixels * factor).astype(np.float32)
        return self._stored(pixels, factor, Texture(texels, source.wrap))

    def _stored(self, pixels: NDArray[np.float32], factor: NDArray[np.float64], texture: Texture) -> Texture:
        self._textures.append((pixels, factor, texture))
        return texture

    def _pixels(self, image: Image.Image) -> NDArray[np.float32] | None:
        for known, pixels in self._decoded:
            if known is image:
                return pixels
        name = image.info.get("file_path") or "an image"
        require_memory(
            _BYTES_PER_TEXEL * image.width * image.height,
            f"the texture {name!r} of {ref('mesh')}, {image.width} × {image.height} pixels,",
            "give an image with {side} times the width and height",
        )
        pixels = mesh_images.linear_rgba(image)
        if pixels is not None:
            digest = hashlib.blake2b(str(pixels.shape).encode() + pixels.tobytes()).digest()
            pixels = self._by_content.setdefault(digest, pixels)
        self._decoded.append((image, pixels))
        return pixels


def table_of(of_base_colour: Sequence[Texture | None], materials: NDArray[np.int32], device: wp.DeviceLike) -> Textures:
    """Return the textures of a scene on a device, with the pyramids of their images.

    Args:
        of_base_colour: Texture of each material's base colour; None without one.
        materials: Material of each face; −1 without one.
        device: Warp device.

    Raises:
        MemoryError: The pyramids require more memory than is free, or more than 2,147,483,647 texels.
    """
    images: dict[int, int] = {}
    levels: list[tuple[int, int, int]] = []
    arrays: list[NDArray[np.float32]] = []
    rows: dict[Texture, tuple[int, int, int, int]] = {}
    count = 0
    for texture in of_base_colour:
        if texture is None or texture in rows:
            continue
        height, width, _ = texture.texels.shape
        if id(texture.texels) not in images:
            images[id(texture.texels)] = len(levels)
            arrays.append(texture.texels)
            for size in sizes(height, width):
                levels.append((count, size[1], size[0]))
                count += size[0] * size[1]
        along_u, along_v = (_WRAPS[wrap] for wrap in texture.wrap)
        rows[texture] = images[id(texture.texels)], len(sizes(height, width)), along_u, along_v
    _require_texels(count)
    result = Textures()
    result.texels = wp.empty(count, dtype=wp.vec4f, device=device)
    place = 0
    for texels in arrays:
        for level in pyramid(texels):
            size = level.shape[0] * level.shape[1]
            result.texels[place : place + size].assign(level.reshape(-1, 4))
            place += size
    result.levels = wp.array(np.array(levels, np.int32).reshape(-1, 3), dtype=wp.int32, device=device)
    result.table = wp.array(np.array([*rows.values()], np.int32).reshape(-1, 4), dtype=wp.int32, device=device)
    numbers = {texture: number for number, texture in enumerate(rows)}
    of_materials = [-1 if texture is None else numbers[texture] for texture in of_base_colour]
    result.of_base_colour = wp.array(np.array(of_materials, np.int32), dtype=wp.int32, device=device)
    result.materials = wp.array(materials, dtype=wp.int32, device=device)
    return result


def _require_texels(count: int) -> None:
    """Raise an error unless pyramids with ``count`` texels fit into memory and can be indexed."""
    what = f"the textures of {ref('mesh')}, {count} texels with their reductions,"
    require_memory(
        np.inf if count > MOST_ELEMENTS else 16.0 * count, what, "give images with {side} times the width and height"
    )
