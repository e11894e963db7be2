"""Disk cache of arrays that took long to compute, for other processes; it removes the least recently used ones.

The folder is ``WARPDIFF_CACHE_DIR``, or ``warpdiff`` in the user's cache folder; an empty name disables the cache.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core.files import atomic_write
from warpdiff.kernels import thresholds

if TYPE_CHECKING:
    from collections.abc import Callable
    from io import BufferedRandom, BufferedReader

    from numpy.typing import NDArray

# Limit: size of all files [bytes].
MOST_BYTES = 2**30
# Arrays that are computed faster are not written to a file [s].
_LEAST_SECONDS = 0.25
# Size of a SHA-256.
_CHECKSUM_BYTES = 32
_NAME = re.compile(r"[0-9a-f]{32}\.npz")
_UNFINISHED = ".part"
_TEMPORARY = re.compile(rf"\.warpdiff-[0-9a-f]{{16}}\{_UNFINISHED}")
# A file that is being written changes more often [s].
_STALE_SECONDS = 3600.0


class Entry(NamedTuple):
    """File of the cache.

    Attributes:
        used: Time of its last use [s since 1970].
        size: Size [bytes].
        path: Path of the file.
    """

    used: float
    size: int
    path: Path


def cached_on_disk(key: Any, heights: NDArray[np.float64], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return arrays by name, from the cache, or made and then cached.

    Args:
        key: Identifies the arrays by its ``repr``.
        heights: Heights that the arrays depend on.
        make: Function that makes the arrays; another version of the package, or of NumPy, makes others.
    """
    folder = cache_folder()
    if folder is None:
        return make()
    code = _code_digest(Path(__file__).parents[1], Path(thresholds.__file__).parent)
    digest = hashlib.sha256(repr((code, np.__version__, key, heights.shape)).encode())
    digest.update(np.ascontiguousarray(heights).data)
    path = folder / f"{digest.hexdigest()[:32]}.npz"
    cached = _read(path, digest.digest())
    if cached is not None:
        return cached
    begin = time.perf_counter()
    made = make()
    if time.perf_counter() - begin >= _LEAST_SECONDS:
        # A full disk or a folder that is not writable costs time, not pictures.
        with contextlib.suppress(OSError):
            _write(path, digest.digest(), made)
            trim(folder, MOST_BYTES)
    return made


@functools.cache
def _code_digest(*folders: Path) -> str:
    """Hash of the code in folders: unlike a version, it changes with every change that may change arrays."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in (".py", ".h")):
        # An editor's mark of an open file is a link to nothing.
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_folder() -> Path | None:
    """The folder of the cache; None if it is disabled or the user has no folder for it."""
    variable = os.environ.get("WARPDIFF_CACHE_DIR")
    if variable is not None:
        return Path(variable) if variable else None
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
    """The arrays of a file; one that is damaged, or belongs to another key, is deleted and gives None."""
    arrays = None
    # A damaged archive makes NumPy and zipfile raise errors of many types; it must not do so again each time.
    with contextlib.suppress(Exception), path.open("rb") as file:
        if file.read(_CHECKSUM_BYTES) == _checksum(file, key):
            file.seek(_CHECKSUM_BYTES)
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name][()] for name in archive.files}
    with contextlib.suppress(OSError):
        if arrays is None:
            path.unlink()
        else:
            # The file was used now; a folder may be shared and read-only.
            os.utime(path)
    return arrays


def _write(path: Path, key: bytes, arrays: dict[str, Any]) -> None:
    """A checksum, then the archive."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The checksum reveals a file that a crash of the system has left incomplete.
    with atomic_write(path, suffix=_UNFINISHED, durable=False) as temporary, temporary.open("rb+") as file:
        file.write(bytes(_CHECKSUM_BYTES))
        np.savez(file, **arrays)
        checksum = _checksum(file, key)
        file.seek(0)
        file.write(checksum)


def _checksum(file: BufferedRandom | BufferedReader, key: bytes) -> bytes:
    """The checksum of all that follows it, and of the key, so that no file can stand in for another."""
    file.seek(_CHECKSUM_BYTES)
    return hashlib.file_digest(file, lambda: hashlib.sha256(key)).digest()


def entries(folder: Path) -> list[Entry]:
    """Entries of a folder, the most recently used first."""
    return sorted(_matching_files(folder, _NAME), reverse=True)


def trim(folder: Path, most_bytes: int) -> None:
    """Delete the least recently used files until the others fit, and unfinished files of processes that were killed."""
    total = 0
    for _, size, path in entries(folder):
        total += size
        if total > most_bytes:
            path.unlink(missing_ok=True)
    for changed, _, path in _matching_files(folder, _TEMPORARY):
        # Other processes may be writing theirs.
        if changed < time.time() - _STALE_SECONDS:
            path.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Delete all files of the cache in a folder, unfinished ones included."""
    for _, _, path in entries(folder) + _matching_files(folder, _TEMPORARY):
        path.unlink(missing_ok=True)


def _matching_files(folder: Path, name: re.Pattern[str]) -> list[Entry]:
    """Files of a folder by a pattern of their names; other processes may delete them meanwhile."""
    files = []
    with contextlib.suppress(FileNotFoundError):
        for path in folder.iterdir():
            if name.fullmatch(path.name):
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    files.append(Entry(status.st_mtime, status.st_size, path))
    return files
