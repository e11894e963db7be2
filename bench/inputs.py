"""Location of the folder of measured height fields.

The option ``--data`` of a benchmark selects the folder. Without it, the environment variable ``WARPDIFF_DATA`` does. If
neither is set, the folder is ``shared/data`` in the folder that contains the repository.
"""

from __future__ import annotations

from pathlib import Path

import warpdiff as wd
from warpdiff.apps.demo import data_folder
from warpdiff.datasets.download import read

HELP = "folder with the scan (default: WARPDIFF_DATA or ../shared/data next to a checkout)"


def folder(data: str | Path | None = None) -> Path:
    """Return the path of the folder of measured height fields. The folder may not exist."""
    return data_folder(data) or Path("shared", "data")


def scan(data: str | Path | None = None) -> wd.HeightField | None:
    """Return the scan of a 65 µm square of a corn snake's skin as measured, or None if the file is absent."""
    dataset = wd.datasets.info("corn_snake_scan")
    path = folder(data) / dataset.local_name
    return read(dataset, path) if path.is_file() else None


def levelled_scan(data: str | Path | None = None) -> wd.HeightField | None:
    """Return the scan of a 65 µm square of a corn snake's skin, or None if the file is absent.

    The scan is levelled: a polynomial of degree 2, fitted by least squares, is subtracted from the heights.
    """
    heightfield = scan(data)
    return None if heightfield is None else heightfield.levelled(order=2)
