"""Colours of meshes: textures and uniform colours of materials in linear RGB."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ref
from warpdiff.optics.colorimetry import srgb_decode

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image

# Key under which the dictionary ``info`` of a Pillow image stores the reason why the image cannot be decoded.
_DAMAGE = "warpdiff:damage"


def colours_of(material: Any) -> tuple[NDArray[np.float32] | None, NDArray[np.float64] | None]:
    """Return a material's texture, (h, w, 3), and its uniform colour, (3,), in linear RGB; None where undefined."""
    from trimesh.visual import DEFAULT_COLOR
    from trimesh.visual.material import PBRMaterial, color_image

    if isinstance(material, PBRMaterial):
        # The colour factor of a glTF material is linear. It multiplies the texture after decoding from sRGB.
        factor = material.baseColorFactor
        linear = None if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255.0
        if material.baseColorTexture is None:
            return None, linear
        texture = _image(material.baseColorTexture)
        if texture is None or linear is None:
            return texture, linear
        return (texture * linear).astype(np.float32), None
    image = getattr(material, "image", None)
    if image is not None:
        # trimesh gives a mesh without a material a texture of 2 × 2 grey pixels, which is ignored here.
        invented = image.size == (2, 2) and np.array_equal(np.asarray(image), np.asarray(color_image()))
        texture = None if invented else _image(image)
        if invented or texture is not None:
            return texture, None
    diffuse = getattr(material, "diffuse", None)
    if diffuse is None:
        return None, None
    colour = np.asarray(diffuse, dtype=np.float64)[:3] / 255.0
    return None, (None if np.array_equal(diffuse, DEFAULT_COLOR) else srgb_decode(colour))


def _image(image: Image.Image) -> NDArray[np.float32] | None:
    """Return a PIL image in linear RGB, shape (h, w, 3), or None with a warning if it is damaged."""
    if damage := _damage(image):
        texture = image.info.get("file_path") or "an image"
        warn(f"{ref('mesh')}: texture {texture!r} is damaged and ignored: {damage}")
        return None
    if image.mode.startswith("I"):
        # Pillow's image modes that begin with the letter I have 16-bit grey values. Pillow's own conversion to RGB
        # would clip these at 255.
        grey = srgb_decode(np.asarray(image, dtype=np.float64) / 65535.0)
        return np.repeat(grey[:, :, None], 3, axis=2).astype(np.float32)
    # For speed, the sRGB transfer function is computed once for each of the 256 possible values, not for every pixel.
    table = srgb_decode(np.arange(256) / 255.0).astype(np.float32)
    return np.ascontiguousarray(table[np.asarray(image.convert("RGB"), dtype=np.uint8)])


def _damage(image: Image.Image) -> str:
    """Return the reason why a PIL image cannot be decoded, or an empty string."""
    if _DAMAGE not in image.info:
        try:
            image.load()
            image.info[_DAMAGE] = ""
        except Exception as error:
            # Image decoders raise errors of any type. The error is stored, because a second attempt may return a
            # partial image without an error.
            image.info[_DAMAGE] = str(error) or type(error).__name__
    return str(image.info[_DAMAGE])
