"""Table of the textures of a scene on a device, with the pyramids of their images.

A row is the appearance of one material on one part of the scene.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.core.memory import MOST_ELEMENTS, require_memory
from warpdiff.core.wording import ref
from warpdiff.kernels.structs import Textures
from warpdiff.scene.texture_pyramid import pyramid, sizes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.scene_parts import Wrap
    from warpdiff.scene.textures import MaterialMaps, Texture

# `_BYTES_PER_TEXEL` is the size of a texel [bytes]: four float32. `_BYTES_OF_REDUCTIONS` is the memory that an image's
# reductions to half the size require while they are made [bytes per texel of the image]. All reductions together have a
# third of the image's texels. The first reduction has half of them before it is reduced along the second axis.
_BYTES_PER_TEXEL, _BYTES_OF_REDUCTIONS = 16.0, 16.0 / 3.0 + 8.0
# Codes of the wrap modes of textures, as in kernels/native/textures.h.
_WRAPS: dict[Wrap, int] = {"repeat": 0, "clamp": 1, "mirror": 2}


def table_of(
    of_base_colour: Sequence[Texture | None], rows: NDArray[np.int32], device: wp.DeviceLike,
    maps: MaterialMaps | None = None,
) -> Textures:  # fmt: skip
    """Return the textures of a scene on a device, with the pyramids (reductions to half the size) of their images.

    Args:
        of_base_colour: Base-colour texture of each row (one material on one part); None without one.
        rows: Index of each face's row; −1 without a material.
        device: Warp device.
        maps: Textures of metallic, roughness and emission; None if there are none. The result does not contain their
            texture coordinates.

    Raises:
        MemoryError: The pyramids require more memory than is free, or more than 2,147,483,647 texels.
    """
    images: dict[int, int] = {}
    levels: list[tuple[int, int, int]] = []
    arrays: list[NDArray[np.float32]] = []
    entries: dict[Texture, tuple[int, int, int, int]] = {}
    count = 0
    by_use = [of_base_colour] if maps is None else [of_base_colour, maps.metallic_roughness, maps.emission]
    for texture in itertools.chain(*by_use):
        if texture is None or texture in entries:
            continue
        height, width, _ = texture.texels.shape
        if id(texture.texels) not in images:
            images[id(texture.texels)] = len(levels)
            arrays.append(texture.texels)
            for size in sizes(height, width):
                levels.append((count, size[1], size[0]))
                count += size[0] * size[1]
        along_u, along_v = (_WRAPS[wrap] for wrap in texture.wrap)
        entries[texture] = images[id(texture.texels)], len(sizes(height, width)), along_u, along_v
    _require_texels(count, max((texels.size // 4 for texels in arrays), default=0))
    result = Textures()
    result.texels = wp.empty(count, dtype=wp.vec4f, device=device)
    place = 0
    for texels in arrays:
        for level in pyramid(texels):
            size = level.shape[0] * level.shape[1]
            result.texels[place : place + size].assign(level.reshape(-1, 4))
            place += size
    result.levels = wp.array(np.array(levels, np.int32).reshape(-1, 3), dtype=wp.int32, device=device)
    result.table = wp.array(np.array([*entries.values()], np.int32).reshape(-1, 4), dtype=wp.int32, device=device)
    numbers = {texture: number for number, texture in enumerate(entries)}
    for name, textures in zip(("of_base_colour", "of_metallic_roughness", "of_emission"), by_use, strict=False):
        of_rows = [-1 if texture is None else numbers[texture] for texture in textures]
        setattr(result, name, wp.array(np.array(of_rows, np.int32), dtype=wp.int32, device=device))
    result.rows = wp.array(rows, dtype=wp.int32, device=device)
    return result


def _require_texels(count: int, largest: int) -> None:
    """Raise an error unless texture pyramids fit into memory, and int32 can index their texels.

    Args:
        count: Number of texels of all pyramids.
        largest: Number of texels of the largest image. Its pyramid is also in host memory while it is copied.
    """
    what = f"the textures of {ref('mesh')}, {count} texels with their reductions,"
    needed = _BYTES_PER_TEXEL * count + _BYTES_OF_REDUCTIONS * largest
    remedy = "give images with {side} times the width and height"
    require_memory(np.inf if count > MOST_ELEMENTS else needed, what, remedy)
