"""What was computed of a height field, on disk: another process finds it again, and the oldest goes where it is full.

The folder is ``WARPDIFF_CACHE_DIR``, or ``warpdiff`` in the user's folder for such things; an empty name is none.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

# Counted up when what is computed changes.
_VERSION = 1
_MOST_BYTES = 2**30
# What is computed faster is not worth a file.
_LEAST_SECONDS = 0.25


def kept_on_disk(key: Any, heights: NDArray[np.float64], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Arrays by name, found again or made.

    Args:
        key: What was asked for, told apart by its ``repr``.
        heights: Of what.
        make: Makes them.
    """
    folder = _folder()
    if folder is None:
        return make()
    digest = hashlib.sha256(repr((_VERSION, key, heights.shape)).encode())
    digest.update(np.ascontiguousarray(heights).data)
    path = folder / f"{digest.hexdigest()[:32]}.npz"
    found = _read(path)
    if found is not None:
        return found
    begin = time.perf_counter()
    made = make()
    if time.perf_counter() - begin >= _LEAST_SECONDS:
        # A full disk or a folder that may not be written to costs time, not pictures.
        with contextlib.suppress(OSError):
            _write(path, made)
            _trim(folder)
    return made


def _folder() -> Path | None:
    named = os.environ.get("WARPDIFF_CACHE_DIR")
    if named is not None:
        return Path(named) if named else None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "warpdiff" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "warpdiff"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "warpdiff"


def _read(path: Path) -> dict[str, Any] | None:
    """The arrays of a file; one that is damaged is none."""
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name][()] for name in file.files}
        # The oldest is what was not used for longest.
        os.utime(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        with contextlib.suppress(OSError):
            path.unlink()
        return None
    return found


def _write(path: Path, arrays: dict[str, Any]) -> None:
    """Write to a temporary name, then rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
        Path(temporary).replace(path)
    finally:
        Path(temporary).unlink(missing_ok=True)


def _trim(folder: Path) -> None:
    """Delete the oldest files until the others fit."""
    files = sorted(((each.stat().st_mtime, each.stat().st_size, each) for each in folder.glob("*.npz")), reverse=True)
    total = 0
    for _, size, path in files:
        total += size
        if total > _MOST_BYTES:
            path.unlink(missing_ok=True)
