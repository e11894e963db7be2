"""A cache on disk of what height fields took to compute: another process finds it, and the oldest goes when it is full.

The folder is ``WARPDIFF_CACHE_DIR``, or ``warpdiff`` in the user's folder for such things; an empty name is none.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core.files import atomic_write

if TYPE_CHECKING:
    from collections.abc import Callable
    from io import BufferedRandom, BufferedReader

    from numpy.typing import NDArray

# Counted up when what is computed changes.
_VERSION = 1
MOST_BYTES = 2**30
# What is computed faster is not worth a file.
_LEAST_SECONDS = 0.25
_CHECKSUM_BYTES = 32
_NAME = re.compile(r"[0-9a-f]{32}\.npz")
_UNFINISHED = ".part"
_TEMPORARY = re.compile(rf"\.warpdiff-[0-9a-f]{{16}}\{_UNFINISHED}")
# Nobody writes that long without a change.
_STALE_SECONDS = 3600.0


class Entry(NamedTuple):
    """A file that is kept.

    Attributes:
        used: When it was last used [s since 1970].
        size: Its bytes.
        path: Where it is.
    """

    used: float
    size: int
    path: Path


def cached_on_disk(key: Any, heights: NDArray[np.float64], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Arrays by name, found again or made.

    Args:
        key: What was asked for, told apart by its ``repr``.
        heights: Of what.
        make: Makes them.
    """
    folder = cache_folder()
    if folder is None:
        return make()
    digest = hashlib.sha256(repr((_VERSION, key, heights.shape)).encode())
    digest.update(np.ascontiguousarray(heights).data)
    path = folder / f"{digest.hexdigest()[:32]}.npz"
    found = _read(path, digest.digest())
    if found is not None:
        return found
    begin = time.perf_counter()
    made = make()
    if time.perf_counter() - begin >= _LEAST_SECONDS:
        # A full disk or a folder that may not be written to costs time, not pictures.
        with contextlib.suppress(OSError):
            _write(path, digest.digest(), made)
            trim(folder, MOST_BYTES)
    return made


def cache_folder() -> Path | None:
    """Where things are kept; None where that is turned off or the user has no folder for it."""
    named = os.environ.get("WARPDIFF_CACHE_DIR")
    if named is not None:
        return Path(named) if named else None
    try:
        return _user_folder()
    except RuntimeError:
        # A user without a home.
        return None


def _user_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "warpdiff" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "warpdiff"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "warpdiff"


def _read(path: Path, key: bytes) -> dict[str, Any] | None:
    """The arrays of a file; one that is not as it was written, or not under this key, goes and is none."""
    found = None
    # A damaged archive makes NumPy and zipfile raise all sorts of things; it must not do so again each time.
    with contextlib.suppress(Exception), path.open("rb") as file:
        if file.read(_CHECKSUM_BYTES) == _checksum(file, key):
            file.seek(_CHECKSUM_BYTES)
            with np.load(file, allow_pickle=False) as archive:
                found = {name: archive[name][()] for name in archive.files}
    with contextlib.suppress(OSError):
        if found is None:
            path.unlink()
        else:
            # The oldest is what was not used for longest; a folder may be shared and read-only.
            os.utime(path)
    return found


def _write(path: Path, key: bytes, arrays: dict[str, Any]) -> None:
    """A checksum, then the archive."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # What a crash of the system leaves is told by its checksum.
    with atomic_write(path, suffix=_UNFINISHED, durable=False) as temporary, temporary.open("rb+") as file:
        file.write(bytes(_CHECKSUM_BYTES))
        np.savez(file, **arrays)
        checksum = _checksum(file, key)
        file.seek(0)
        file.write(checksum)


def _checksum(file: BufferedRandom | BufferedReader, key: bytes) -> bytes:
    """The checksum of all that follows it; with the key, or a file could stand in for another."""
    file.seek(_CHECKSUM_BYTES)
    return hashlib.file_digest(file, lambda: hashlib.sha256(key)).digest()


def entries(folder: Path) -> list[Entry]:
    """Entries of a folder, the last used first."""
    return sorted(_listed(folder, _NAME), reverse=True)


def trim(folder: Path, most_bytes: int) -> None:
    """Delete the oldest files until the others fit, and what processes that were killed have left unfinished."""
    total = 0
    for _, size, path in entries(folder):
        total += size
        if total > most_bytes:
            path.unlink(missing_ok=True)
    for changed, _, path in _listed(folder, _TEMPORARY):
        # Other processes may be writing theirs.
        if changed < time.time() - _STALE_SECONDS:
            path.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Delete all that is kept in a folder; who is writing there now keeps nothing."""
    for _, _, path in entries(folder) + _listed(folder, _TEMPORARY):
        path.unlink(missing_ok=True)


def _listed(folder: Path, name: re.Pattern[str]) -> list[Entry]:
    """Files of a folder by their names; it may hold other files, and other processes may delete these."""
    found = []
    with contextlib.suppress(FileNotFoundError):
        for path in folder.iterdir():
            if name.fullmatch(path.name):
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    found.append(Entry(status.st_mtime, status.st_size, path))
    return found
