"""Files that a caller names: told of by name where they are not there or cannot be read."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


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
