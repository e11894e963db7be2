"""Disk cache of arrays that are slow to compute. Several processes share the cache.

If the cache is too large, the files that were not used for the longest time are deleted.

The environment variable ``WARPDIFF_CACHE_DIR`` names the folder of the cache; an empty value disables the cache.
Without the variable, the folder is ``warpdiff`` in the user's cache folder.
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
    from collections.abc import Callable, Mapping
    from io import BufferedRandom, BufferedReader

    from numpy.typing import NDArray

# Maximum total size of all files of the cache [bytes]. A larger maximum only uses more disk space.
MOST_BYTES = 2**30
# Least computing time of arrays that are stored in a file [s]. Arrays that are computed faster are computed again in
# each process.
_LEAST_SECONDS = 0.25
# Size of a SHA-256 checksum [bytes].
_CHECKSUM_BYTES = 32
_NAME = re.compile(r"[0-9a-f]{32}\.npz")
_UNFINISHED = ".part"
_TEMPORARY = re.compile(rf"\.warpdiff-[0-9a-f]{{16}}\{_UNFINISHED}")
# Time after which an unfinished file without a new write is deleted [s]. It was chosen because a process that has not
# written for an hour was probably killed. If doubled, such files use disk space for longer.
_STALE_SECONDS = 3600.0


class Entry(NamedTuple):
    """File of the disk cache.

    Attributes:
        used: Time of the file's last use [s since 1970].
        size: Size of the file [bytes].
        path: Path of the file.
    """

    used: float
    size: int
    path: Path


def cached_on_disk(key: object, heights: NDArray[np.float64], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return arrays by name from the disk cache; if the cache does not contain them, make them and store them.

    Args:
        key: Object whose ``repr`` identifies the arrays, together with ``heights``.
        heights: Array of heights from which the arrays are computed. It is a part of the key, too.
        make: Function that makes the arrays. Its result may depend on the code of the package and on NumPy's version,
            because both are a part of the key.
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
        # If the disk is full or the folder is not writable, the arrays are returned to the caller, but not stored in
        # the cache.
        with contextlib.suppress(OSError):
            _write(path, digest.digest(), made)
            trim(folder, MOST_BYTES)
    return made


@functools.cache
def _code_digest(*folders: Path) -> str:
    """Return a hash of the contents of all source files in ``folders``, which contain the code of the package.

    The hash is a part of the cache's keys, so that arrays that older source code has made are not reused. The version
    number of the package would not suffice, because it does not change with each edit of the code.
    """
    digest = hashlib.sha256()
    for path in sorted(path for folder in folders for path in folder.rglob("*") if path.suffix in (".py", ".h")):
        # Some editors put a symbolic link without a target next to a source file that is open. Such a link is excluded
        # from the hash, because it cannot be read.
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def cache_folder() -> Path | None:
    """Return the folder of the cache; None if the cache is disabled or the user has no home folder."""
    variable = os.environ.get("WARPDIFF_CACHE_DIR")
    if variable is not None:
        return Path(variable) if variable else None
    try:
        return _user_folder()
    except RuntimeError:
        # If the user has no home folder, pathlib raises a RuntimeError. The cache is then disabled.
        return None


def _user_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "warpdiff" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "warpdiff"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "warpdiff"


def _read(path: Path, key: bytes) -> dict[str, Any] | None:
    """Return the arrays of a cache file; None if it is damaged or was written for another key than ``key``.

    A file for which the result is None is deleted.
    """
    arrays = None
    # A damaged archive can cause errors of many types in NumPy and zipfile. All of them mean that the file cannot be
    # used.
    with contextlib.suppress(Exception), path.open("rb") as file:
        if file.read(_CHECKSUM_BYTES) == _checksum(file, key):
            file.seek(_CHECKSUM_BYTES)
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name][()] for name in archive.files}
    with contextlib.suppress(OSError):
        if arrays is None:
            path.unlink()
        else:
            # Each use sets the modification time of a file to the present time, which marks it as recently used. In a
            # read-only folder this fails, which has no consequence.
            os.utime(path)
    return arrays


def _write(path: Path, key: bytes, arrays: Mapping[str, Any]) -> None:
    """Write arrays to a file of the cache: a checksum, followed by a NumPy archive."""
    objects = [name for name, value in arrays.items() if np.asarray(value).dtype == object]
    if objects:
        raise TypeError(f"arrays of Python objects cannot be read from the cache: {', '.join(objects)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    # To save time, the function does not wait until the file is on the disk. If the system crashes, the file may be
    # incomplete, which the checksum detects.
    with atomic_write(path, suffix=_UNFINISHED, durable=False) as temporary, temporary.open("rb+") as file:
        file.write(bytes(_CHECKSUM_BYTES))
        np.savez(file, **arrays)
        checksum = _checksum(file, key)
        file.seek(0)
        file.write(checksum)


def _checksum(file: BufferedRandom | BufferedReader, key: bytes) -> bytes:
    """Return a checksum of the key and of a cache file's archive. It detects damaged files and files of other keys."""
    file.seek(_CHECKSUM_BYTES)
    return hashlib.file_digest(file, lambda: hashlib.sha256(key)).digest()


def entries(folder: Path) -> list[Entry]:
    """Return the files of the cache in a folder, the most recently used first."""
    return sorted(_matching_files(folder, _NAME), reverse=True)


def trim(folder: Path, most_bytes: int) -> None:
    """Delete the least recently used files until the others have at most ``most_bytes`` in total.

    Old unfinished files, which killed processes have left, are deleted, too.
    """
    total = 0
    for _, size, path in entries(folder):
        total += size
        if total > most_bytes:
            path.unlink(missing_ok=True)
    for changed, _, path in _matching_files(folder, _TEMPORARY):
        # Recent unfinished files are not deleted, because other processes may still be writing them.
        if changed < time.time() - _STALE_SECONDS:
            path.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Delete all files of the cache in a folder, unfinished ones included."""
    for _, _, path in entries(folder) + _matching_files(folder, _TEMPORARY):
        path.unlink(missing_ok=True)


def _matching_files(folder: Path, name: re.Pattern[str]) -> list[Entry]:
    """Return the files of a folder whose names match a pattern, without files that other processes delete meanwhile."""
    files = []
    with contextlib.suppress(FileNotFoundError):
        for path in folder.iterdir():
            if name.fullmatch(path.name):
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    files.append(Entry(status.st_mtime, status.st_size, path))
    return files
