"""Data sets as height fields, from the user's folder or from the network. The package pooch downloads files."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import disk_cache
from warpdiff.core.wording import ArgumentValueError
from warpdiff.datasets.registry import info
from warpdiff.heightfield.field import HeightField

if TYPE_CHECKING:
    from warpdiff.datasets.registry import Dataset

# Subfolder for downloads within the folder of the disk cache. The disk cache can be trimmed or cleared without a loss
# of downloads, because it deletes only its own files.
_SUBFOLDER = "datasets"
# Image formats of the published files, by their names in Pillow.
_FORMATS = ("PNG", "TIFF")
# Accepted image modes, by Pillow's names: grey or colour with 8 bits per channel, without or with alpha.
_MODES = ("L", "LA", "RGB", "RGBA")


def fetch(name: str) -> HeightField:
    """Return a published height field as it was measured; download it at the first call.

    The function looks for the file in three places:

    1. The folder that the environment variable ``WARPDIFF_DATA`` names. A file there is used without a check.
    2. The folder of earlier downloads, in the user's cache folder or in ``WARPDIFF_CACHE_DIR``. If the disk cache is
       disabled, downloads are not kept.
    3. The address of the data set. Downloads require the extra ``data``, and their SHA-256 checksum is verified.

    The scan is tilted and has dust on it: call :meth:`~warpdiff.HeightField.levelled`,
    :meth:`~warpdiff.HeightField.despiked` and :meth:`~warpdiff.HeightField.periodic` before you compute colours.

    Args:
        name: Name of the data set: ``"corn_snake_scan"``, 65 µm × 65 µm of a shed snake skin. The file does not record
            its height range, which is assumed to be 0.375 µm.

    Returns:
        The height field.

    Raises:
        ValueError: There is no data set of this name, or the file in ``WARPDIFF_DATA`` is not an 8-bit image.
        FileNotFoundError: ``WARPDIFF_DATA`` names a folder that does not exist.
        ImportError: A download is necessary, and pooch is not installed: ``pip install 'warpdiff[data]'``.
        OSError: The download failed or has another checksum. The message says where to put a file that you download
            yourself.

    Examples:
        >>> import warpdiff as wd
        >>> skin = wd.datasets.fetch("corn_snake_scan").levelled(order=2)  # doctest: +SKIP
        >>> try:
        ...     wd.datasets.fetch("corn_snake")
        ... except ValueError as error:
        ...     print(error)
        name must be one of 'corn_snake_scan', got 'corn_snake'; did you mean 'corn_snake_scan'?
    """
    dataset = info(name)
    local = _local_file(dataset)
    if local is not None:
        return read(dataset, local)
    cache = disk_cache.cache_folder()
    if cache is not None:
        return read(dataset, _download(dataset, cache / _SUBFOLDER))
    with tempfile.TemporaryDirectory() as folder:
        return read(dataset, _download(dataset, Path(folder)))


def read(dataset: Dataset, path: str | os.PathLike[str]) -> HeightField:
    """Return the height field in the image file of a data set. The first channel contains the heights.

    Raises:
        ValueError: The file is not an image with 8 bits per channel.
    """
    import PIL.Image

    try:
        with PIL.Image.open(path, formats=_FORMATS) as image:
            mode = image.mode
            samples = np.asarray(image.getchannel(0)) if mode in _MODES else None
    except (OSError, SyntaxError, ValueError) as error:
        raise ArgumentValueError(f"{str(path)!r} cannot be read as an image ({error}); download it again") from None
    if samples is None:
        raise ArgumentValueError(
            f"{str(path)!r} has pixels of mode {mode}, must have channels of 8 bit ({', '.join(_MODES)}); download it "
            "again"
        )
    heights_um = np.multiply(samples, dataset.height_range_um / 255, dtype=np.float64)
    return HeightField(heights_um, dataset.extent_um / samples.shape[1])


def _local_file(dataset: Dataset) -> Path | None:
    """Return a data set's file in the folder that ``WARPDIFF_DATA`` names; None without this variable or this file."""
    variable = os.environ.get("WARPDIFF_DATA")
    if not variable:
        return None
    folder = Path(variable)
    if not folder.is_dir():
        raise FileNotFoundError(f"the data folder {variable!r} does not exist; check WARPDIFF_DATA")
    file = folder / dataset.local_name
    return file if file.is_file() else None


def _download(dataset: Dataset, folder: Path) -> Path:
    """Return the path of a data set's file in a folder. Download the file if it is absent or has a wrong checksum."""
    try:
        import pooch
    except ImportError as error:
        raise ImportError(
            f"pooch, which downloads data sets, is not installed ({error}): pip install 'warpdiff[data]', or "
            f"{_remedy(dataset)}"
        ) from error
    try:
        return Path(pooch.retrieve(dataset.address, f"sha256:{dataset.sha256}", dataset.local_name, folder))
    except PermissionError as error:
        raise PermissionError(f"the folder {str(folder)!r} is not writable ({error}); set WARPDIFF_CACHE_DIR") from None
    # Network errors are OSErrors. pooch raises ValueError for a wrong checksum.
    except (OSError, ValueError) as error:
        raise OSError(f"{dataset.local_name} could not be downloaded ({error}); {_remedy(dataset)}") from None


def _remedy(dataset: Dataset) -> str:
    """Return advice for error messages after a failed download: how to download the file by other means."""
    folder = os.environ.get("WARPDIFF_DATA")
    place = f"in the folder {folder!r}" if folder else "in a folder, and set WARPDIFF_DATA to that folder"
    return (
        f"download {dataset.address} ({dataset.size_bytes:,} bytes, SHA-256 {dataset.sha256}) by other means, "
        f"save it as {dataset.local_name} {place}"
    )
