"""Reader of grey images, by OpenImageIO."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core import openimageio
from warpdiff.heightfield.readers.reader_registry import FileContent, refusal, register_reader, require_memory

if TYPE_CHECKING:
    from pathlib import Path


# Measured peak memory while an image is read [bytes per sample]. Images that need more than the free memory are
# refused. If doubled, images are refused that would fit into memory.
_BYTES_PER_SAMPLE = 28.0


# Names of the accepted formats in OpenImageIO. Other decoders of the library do not read files of heights.
_FORMATS = (
    "png", "tiff", "openexr", "bmp", "pnm", "jpeg", "jpeg2000", "webp", "hdr", "dpx", "fits", "gif", "psd", "targa",
)  # fmt: skip
_SUFFIXES = (
    ".png", ".tif", ".tiff", ".exr", ".bmp", ".tga", ".pgm", ".pfm", ".pnm", ".jpg", ".jpeg", ".jp2", ".webp", ".hdr",
    ".dpx", ".fits", ".gif", ".psd",
)  # fmt: skip


class ImageRemedies(NamedTuple):
    """Texts of error messages about an image. Images of heights and images of other values have different texts.

    Attributes:
        other_format: Message about a file of another format.
        unreadable: Remedy for a file that cannot be read.
        channels: Remedy for several channels.
        images: Remedy for several images.
    """

    other_format: str
    unreadable: str
    channels: str
    images: str


_OF_HEIGHTS = ImageRemedies(
    "has a format that is not read; export it as .x3p, as text, or as a grey image of 16 bit or of floats, or see the "
    "table of formats in the documentation",
    "give a grey image, .npy, .npz, .x3p or a text",
    "save its heights as one grey channel, 8-bit, 16-bit or float",
    "save the one with the heights alone",
)


@register_reader(
    *_SUFFIXES, title="grey image of 8 or 16 bit, or of floats",
    states="integers: you state the height of the full scale and the pitch; floats: µm, you state the pitch",
)  # fmt: skip
def read_image(file: Path) -> FileContent:
    """Read the heights from a grey image; its samples are not converted."""
    return FileContent(image_samples(file))


def image_samples(file: Path, remedies: ImageRemedies = _OF_HEIGHTS) -> np.ndarray:
    """Return the samples of a grey image as the file has them, shape (rows, columns)."""
    with openimageio.in_use() as oiio:
        # Files in the format PFM store the bottom row first. This attribute makes OpenImageIO return the top row first;
        # for other formats, OpenImageIO ignores the attribute.
        configuration = oiio.ImageSpec()
        configuration.attribute("pnm:pfmflip", 1)
        image = openimageio.opened(oiio, file, _FORMATS, configuration)
        if image is None:
            # The error message is read even if it is not used, because OpenImageIO prints unread messages when the
            # process ends.
            reason = f"cannot be read as an image ({openimageio.error_text(oiio)}); {remedies.unreadable}"
            raise refusal(file, reason if file.suffix.lower() in _SUFFIXES else remedies.other_format)
        try:
            return _samples_of(image, file, remedies)
        finally:
            image.close()


def _samples_of(image: Any, file: Path, remedies: ImageRemedies) -> np.ndarray:
    """Return the samples of an open image file; raise an error if the file has several images or several channels."""
    spec = image.spec()
    channels = spec.nchannels
    if channels != 1:
        kind = "a grey image with alpha" if channels == 2 else f"a colour image ({channels} channels)"
        raise refusal(file, f"is {kind}; {remedies.channels}")
    require_memory(file, (spec.height, spec.width), _BYTES_PER_SAMPLE)
    # The argument "unknown" makes OpenImageIO return the samples in the type that they have in the file.
    samples = image.read_image("unknown")
    if samples is None or image.has_error:
        raise refusal(file, f"is damaged ({openimageio.error_text(image)}); export the image again")
    if image.seek_subimage(1, 0):
        raise refusal(file, f"contains several images; {remedies.images}")
    return _upright(np.asarray(samples)[..., 0], spec.getattribute("Orientation"))


def _upright(samples: np.ndarray, orientation: object) -> np.ndarray:
    """Return samples in the orientation in which an image is displayed, by its orientation tag (TIFF, EXIF), 1 to 8."""
    if orientation not in range(2, 9):
        return samples
    turned = {5: samples.T, 6: np.rot90(samples, -1), 7: np.rot90(samples, 2).T, 8: np.rot90(samples)}
    flipped = {2: samples[:, ::-1], 3: samples[::-1, ::-1], 4: samples[::-1]}
    return np.ascontiguousarray((flipped | turned)[orientation])  # type: ignore[index]
