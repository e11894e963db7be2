"""The folder with the real inputs: named, or in ``WARPDIFF_DATA``, or ``../shared/data`` beside a checkout."""

from __future__ import annotations

import os
from pathlib import Path


def data_folder(given: str | os.PathLike[str] | None = None) -> Path | None:
    """The folder with the real inputs, if there is one; one that is named must be there."""
    named = given or os.environ.get("WARPDIFF_DATA")
    if named:
        folder = Path(named)
        if not folder.is_dir():
            raise FileNotFoundError(f"the data folder {folder} does not exist; check --data or WARPDIFF_DATA")
        return folder
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return beside if beside.is_dir() else None
