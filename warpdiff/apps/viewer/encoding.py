"""Encoding of pictures: JPEG for previews, PNG for the final picture, PNG and EXR for files."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from numpy.typing import NDArray

    import warpdiff as wd

# JPEG settings of previews (unrefined pictures). Chroma subsampling is off, because it would average colours over 2 × 2
# pixels and falsify narrow diffraction orders.
_JPEG = {"quality": 92, "subsampling": 0}


def displayed(image: wd.Image, *, exact: bool, **options: Any) -> NDArray[np.uint8]:
    """Return the pixels of :meth:`warpdiff.Image.display` in 8 bits per channel, as in PNG files."""
    return np.round(255.0 * image.display(exact=exact, **options).astype(np.float64)).astype(np.uint8)


def encoded(pixels: NDArray[np.uint8], *, lossless: bool) -> bytes:
    """Return the bytes of a PNG file (``lossless``) or of a JPEG file."""
    from PIL import Image

    buffer = io.BytesIO()
    picture = Image.fromarray(pixels)
    if lossless:
        picture.save(buffer, "PNG", compress_level=1)
    else:
        picture.save(buffer, "JPEG", **_JPEG)
    return buffer.getvalue()


def saved(image: wd.Image, suffix: str, options: Mapping[str, Any]) -> bytes:
    """Return the bytes of the file that :meth:`warpdiff.Image.save` writes for the suffix ``png`` or ``exr``."""
    # EXR files contain scene-linear colours and an alpha channel. Display transform and background do not apply to
    # them.
    options = options if suffix == "png" else {}
    with tempfile.TemporaryDirectory(prefix="warpdiff-") as folder:
        return image.save(Path(folder) / f"picture.{suffix}", **options).read_bytes()
