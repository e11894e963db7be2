"""Folder of the real inputs: an argument, ``WARPDIFF_DATA``, or ``../shared/data`` next to a checkout."""

from __future__ import annotations

import os
from pathlib import Path

from warpdiff.core.wording import marked, ref


def data_folder(data: str | os.PathLike[str] | None = None) -> Path | None:
    """Return the folder of the real inputs, or None; a folder that is named must exist."""
    name = data or os.environ.get("WARPDIFF_DATA")
    if name:
        folder = Path(name)
        if not folder.is_dir():
            raise marked(
                FileNotFoundError, f"the data folder {folder} does not exist; check {ref('data')} or WARPDIFF_DATA"
            )
        return folder
    folder = Path(__file__).resolve().parents[3] / "shared" / "data"
    return folder if folder.is_dir() else None
