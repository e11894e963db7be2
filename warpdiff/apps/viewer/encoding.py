"""Pictures of the viewer as bytes: JPEG on the way, PNG for the finest, PNG and EXR files to be kept."""

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

# JPEG shows colours of narrow orders wrongly where it subsamples them.
_JPEG = {"quality": 92, "subsampling": 0}
KINDS = ("png", "exr")


def shown(image: wd.Image, *, exact: bool, **how: Any) -> NDArray[np.uint8]:
    """What :meth:`warpdiff.Image.display` gives, in 8 bits as its files have them."""
    encoded: NDArray[np.float64] = image.display(exact=exact, **how).astype(np.float64)
    return np.round(255.0 * encoded).astype(np.uint8)


def encoded(pixels: NDArray[np.uint8], *, lossless: bool) -> bytes:
    """A PNG or a JPEG file."""
    from PIL import Image

    buffer = io.BytesIO()
    picture = Image.fromarray(pixels)
    if lossless:
        picture.save(buffer, "PNG", compress_level=1)
    else:
        picture.save(buffer, "JPEG", **_JPEG)
    return buffer.getvalue()


def saved(image: wd.Image, kind: str, how: Mapping[str, Any]) -> bytes:
    """A file as :meth:`warpdiff.Image.save` writes it."""
    # EXR is linear, and holds alpha.
    how = how if kind == "png" else {}
    with tempfile.TemporaryDirectory(prefix="warpdiff-") as folder:
        return image.save(Path(folder) / f"picture.{kind}", **how).read_bytes()
