"""Grey levels of images, 0 for black to 1 for white: one pixel for each dot (rectangle) of a grating map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, marked, ref, renaming
from warpdiff.heightfield.readers.image_reader import ImageRemedies, image_samples

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

_REMEDIES = ImageRemedies(
    "has a format that is not read; save it as a grey image of 8 or 16 bit or of floats, such as .png or .tif, or give "
    "an array",
    "give a grey image or an array",
    "save it as one grey channel, 8-bit, 16-bit or float",
    "save one of them alone",
)


def grey_levels(path: str | os.PathLike[str], name: str) -> NDArray[np.float64]:
    """Return the grey levels of an image, 0 to 1, shape (rows, columns).

    Args:
        path: File of the image: unsigned integers of 8 or 16 bit, whose full scale is white, or floats from 0 to 1.
        name: Name of the argument, for messages.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is a folder, is not a grey image, or has other samples.
    """
    file = validation.path(path, name)
    if file.is_dir():
        raise ArgumentValueError(f"{ref(name)} must be an image, got the folder {str(file)!r}: name a file in it")
    if not file.is_file():
        raise marked(FileNotFoundError, f"{ref(name)}: there is no file {str(file)!r}")
    with renaming({"path": name}):
        samples = image_samples(file, _REMEDIES)
    if samples.dtype in (np.uint8, np.uint16):
        return np.asarray(samples / float(np.iinfo(samples.dtype).max))
    if samples.dtype.kind != "f":
        raise ArgumentValueError(
            f"{ref(name)} must have unsigned integers of 8 or 16 bit, whose full scale is white, or floats from 0 to "
            f"1, got {samples.dtype} in {str(file)!r}: save it in one of these formats"
        )
    levels = validation.finite_array(samples, name)
    if levels.min() < 0.0 or levels.max() > 1.0:
        raise ArgumentValueError(
            f"{ref(name)} must have floats from 0 (black) to 1 (white), got {levels.min():g} to {levels.max():g} in "
            f"{str(file)!r}: rescale them, or give an array"
        )
    return levels
