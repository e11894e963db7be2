"""Images that mesh files refer to: opened from bytes, and decoded to linear RGBA."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ref
from warpdiff.optics.colorimetry import srgb_decode

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image

# Key under which the dictionary ``info`` of a Pillow image stores the reason why the image cannot be decoded.
_DAMAGE = "warpdiff:damage"
# Names of the image formats in Pillow that textures may have. Other decoders of Pillow do not read files of a mesh.
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "TGA", "PPM", "DDS", "MPO")
# Pillow's image modes with an alpha channel.
_MODES_WITH_ALPHA = ("RGBA", "RGBa", "LA", "La", "PA")


def opened(data: bytes) -> Image.Image:
    """Open an image; its pixels are not decoded.

    Raises:
        OSError: Pillow cannot open it. The message is the reason.
    """
    from PIL import Image

    try:
        return Image.open(io.BytesIO(data), formats=_FORMATS)
    except Image.DecompressionBombError as error:
        raise OSError(str(error)) from None
    except Exception:
        # Pillow raises errors of several classes for damaged data.
        raise OSError(f"Pillow cannot read it as an image of the formats {', '.join(_FORMATS)}") from None


def linear_rgba(image: Image.Image) -> NDArray[np.float32] | None:
    """Return an image in linear RGBA, shape (h, w, 4), or None with a warning if it is damaged.

    Alpha is 1 in images without an alpha channel.
    """
    if damage := _damage(image):
        _warn_of_damage(image, damage)
        return None
    result = np.ones((image.height, image.width, 4), np.float32)
    if image.mode.startswith("I"):
        # Pillow's image modes that begin with the letter I have 16-bit grey values. Pillow's own conversion to RGB
        # would clip these at 255.
        result[..., :3] = srgb_decode(np.asarray(image, dtype=np.float64) / 65535.0)[:, :, None]
        return result
    has_alpha = image.mode in ("P", *_MODES_WITH_ALPHA) or "transparency" in image.info
    values = np.asarray(image.convert("RGBA" if has_alpha else "RGB"), dtype=np.uint8)
    # For speed, the sRGB transfer function is computed once for each of the 256 possible values, not for every pixel.
    table = srgb_decode(np.arange(256) / 255.0).astype(np.float32)
    result[..., :3] = table[values[..., :3]]
    if has_alpha:
        result[..., 3] = values[..., 3] / np.float32(255.0)
    return result


def mean_values(image: Image.Image) -> tuple[float, float, float] | None:
    """Return the means of red, green and blue, 0 to 1, without decoding from sRGB; None with a warning if damaged."""
    if damage := _damage(image):
        _warn_of_damage(image, damage)
        return None
    if image.mode == "P":
        image = image.convert("RGBA")
    red, green, blue = np.asarray(image.convert("RGB"), dtype=np.float64).reshape(-1, 3).mean(axis=0) / 255.0
    return float(red), float(green), float(blue)


def _warn_of_damage(image: Image.Image, damage: str) -> None:
    texture = image.info.get("file_path") or "an image"
    warn(f"{ref('mesh')}: texture {texture!r} is damaged and ignored: {damage}")


def _damage(image: Image.Image) -> str:
    """Return the reason why an image cannot be decoded, or an empty string."""
    if _DAMAGE not in image.info:
        # trimesh opens images of .mtl and .ply files by any decoder, which then has read only the header. An image that
        # a program made has no format.
        if image.format is not None and image.format not in _FORMATS:
            image.info[_DAMAGE] = f"the format {image.format} is not read; use one of {', '.join(_FORMATS)}"
            return str(image.info[_DAMAGE])
        try:
            image.load()
            image.info[_DAMAGE] = ""
        except Exception as error:
            # Image decoders raise errors of any type. The error is stored, because a second attempt may return a
            # partial image without an error.
            image.info[_DAMAGE] = str(error) or type(error).__name__
    return str(image.info[_DAMAGE])
