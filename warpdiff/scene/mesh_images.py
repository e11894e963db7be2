"""Images to which mesh files refer: opening from bytes, and decoding to linear RGBA."""

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
# Names in Pillow of the image formats that textures may have. Textures in other formats are refused, so that no other
# decoder of Pillow reads files from untrusted sources.
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "TGA", "PPM", "DDS", "MPO")
# Pillow's image modes with an alpha channel.
_MODES_WITH_ALPHA = ("RGBA", "RGBa", "LA", "La", "PA")


def opened(data: bytes) -> Image.Image:
    """Open an image; its pixels are not decoded.

    Raises:
        OSError: Pillow cannot open the image. The message is the reason.
    """
    from PIL import Image

    try:
        return Image.open(io.BytesIO(data), formats=_FORMATS)
    except Image.DecompressionBombError as error:
        raise OSError(str(error)) from None
    except Exception:
        # Pillow raises errors of several classes for damaged image files.
        raise OSError(f"Pillow cannot read it as an image of the formats {', '.join(_FORMATS)}") from None


def linear_rgba(image: Image.Image, *, is_data: bool = False) -> NDArray[np.float32] | None:
    """Return an image in linear RGBA, shape (h, w, 4), or None with a warning if it is damaged.

    Alpha is 1 in images without an alpha channel. Images of floating-point numbers are linear already.

    Args:
        image: The image.
        is_data: Whether the numbers of the image are linear and not encoded in sRGB.
    """
    try:
        return _linear_rgba(image, is_data=is_data)
    except OSError as error:
        texture = image.info.get("file_path") or "an image"
        warn(f"{ref('mesh')}: texture {texture!r} is damaged and ignored: {error}")
        return None


def _linear_rgba(image: Image.Image, *, is_data: bool) -> NDArray[np.float32]:
    """Return the result of :func:`linear_rgba`, or raise an OSError whose message states why decoding failed."""
    if damage := _damage(image):
        raise OSError(damage)
    result = np.ones((image.height, image.width, 4), np.float32)
    if image.mode == "F":
        grey = np.asarray(image, dtype=np.float32)
        if not np.all((grey >= 0.0) & (grey < np.inf)):
            raise OSError("its numbers must be finite and at least 0")
        result[..., :3] = grey[:, :, None]
        return result
    if image.mode.startswith("I"):
        # Pillow's image modes that begin with the letter I have 16-bit grey values. Pillow's own conversion to RGB
        # would clip these at 255.
        whole = np.asarray(image, dtype=np.float64)
        if whole.min() < 0.0 or whole.max() > 65535.0:
            raise OSError(f"its numbers must be from 0 to 65535, got {whole.min():g} to {whole.max():g}")
        result[..., :3] = (whole / 65535.0 if is_data else srgb_decode(whole / 65535.0))[:, :, None]
        if "transparency" in image.info:
            result[..., 3] = whole != image.info["transparency"]
        return result
    has_alpha = image.mode in ("P", *_MODES_WITH_ALPHA) or "transparency" in image.info
    # Pillow converts its mode "La" to the mode "LA" only.
    source = image.convert("LA") if image.mode == "La" else image
    values = np.asarray(source.convert("RGBA" if has_alpha else "RGB"), dtype=np.uint8)
    # For speed, the sRGB transfer function is computed once for each of the 256 possible 8-bit values, not for every
    # pixel.
    table = np.arange(256) / 255.0
    result[..., :3] = (table if is_data else srgb_decode(table)).astype(np.float32)[values[..., :3]]
    if has_alpha:
        result[..., 3] = values[..., 3] / np.float32(255.0)
    return result


def mean_values(image: Image.Image) -> tuple[float, float, float] | None:
    """Return the means of red, green and blue, 0 to 1, without decoding from sRGB; None with a warning if damaged."""
    values = linear_rgba(image, is_data=True)
    if values is None:
        return None
    red, green, blue, _ = values.mean(axis=(0, 1), dtype=np.float64)
    return float(red), float(green), float(blue)


def _damage(image: Image.Image) -> str:
    """Return the reason why an image cannot be decoded, or an empty string."""
    if _DAMAGE not in image.info:
        # trimesh opens images of .mtl and .ply files by any decoder of Pillow, but reads only the header. Images of
        # other formats are refused here, before their pixels are decoded. An image that a program made has no format,
        # and is accepted.
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
