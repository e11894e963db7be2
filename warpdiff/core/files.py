"""Files: atomic writes under a temporary name, and reads whose errors name the file."""

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


def check_there(file: Path) -> None:
    """Refuse a path that leads to no file."""
    if not file.is_file():
        raise FileNotFoundError(f"path: there is no file {str(file)!r}")


@contextlib.contextmanager
def naming_file(file: Path) -> Iterator[None]:
    """Check that a file is there, and name it where the system cannot read it.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: It cannot be read.
    """
    check_there(file)
    try:
        yield
    except OSError as error:
        raise type(error)(f"path: {str(file)!r} cannot be read: {error.strerror or error}") from error


def text_of(file: Path, most_bytes: int) -> str:
    """The text of a file of at most so many bytes; what is no UTF-8 becomes question marks.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: It cannot be read.
        ValueError: It is larger.
    """
    with naming_file(file), file.open("rb") as opened:
        raw = opened.read(most_bytes + 1)
    if len(raw) > most_bytes:
        raise ValueError(f"{file.name}: such a table has at most {most_bytes} bytes")
    return raw.decode("utf-8", errors="replace").lstrip("\ufeff")
