"""Files that are either whole or not there: written under a temporary name, then renamed."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_unfinished: set[Path] = set()


@contextlib.contextmanager
def atomic_write(target: Path, *, suffix: str = "", durable: bool = True) -> Iterator[Path]:
    """An empty file beside ``target`` to write to, which takes its place at the end of the context.

    Whatever is raised in the context, the temporary file goes and the old one stays.

    Args:
        target: The file to be made or replaced.
        suffix: How the temporary name ends.
        durable: Whether to wait until the disk holds the new file before the old one goes.
    """
    temporary = target.with_name(f".warpdiff-{os.urandom(8).hex()}{suffix}")
    _unfinished.add(temporary)
    try:
        # The system applies the process's umask, which no thread can read without changing it.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        if durable:
            # A file system may allocate late, and tell only now that it is full.
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
        _unfinished.discard(temporary)


def discard_unfinished() -> None:
    """Delete what this process has not finished writing: for when it ends without leaving its contexts."""
    for temporary in tuple(_unfinished):
        with contextlib.suppress(OSError):
            temporary.unlink()


def check_folder(folder: Path, name: str) -> None:
    """Raise where no file can be made in a folder; ``name`` is the argument's that named it."""
    if not folder.is_dir():
        raise FileNotFoundError(f"{name}: the folder {folder} does not exist; create it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{name}: the folder {folder} may not be written to; name another one")
