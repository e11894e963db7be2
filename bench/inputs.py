"""Where real inputs are found: ``--data``, ``WARPDIFF_DATA``, or ``../shared/data`` beside a checkout."""

from __future__ import annotations

from pathlib import Path

import warpdiff as wd
from warpdiff.apps.data_folder import data_folder

HELP = "folder with the scan; default WARPDIFF_DATA or ../shared/data beside a checkout"


def folder(given: str | Path | None = None) -> Path:
    """The folder with real inputs, which need not exist."""
    return data_folder(given) or Path("shared", "data")


def scan(given: str | Path | None = None) -> wd.HeightField | None:
    """The 65 µm scan of a corn snake's skin as it was measured, or None where it is absent."""
    path = folder(given) / "elaphe_65um.png"
    return wd.HeightField.load(path, extent_um=65.0, height_range_um=0.375) if path.is_file() else None


def levelled_scan(given: str | Path | None = None) -> wd.HeightField | None:
    """The same scan levelled, or None where it is absent."""
    found = scan(given)
    return None if found is None else found.levelled(order=2)
