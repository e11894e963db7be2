"""Small text files that a caller names."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def text_of(file: Path, most_bytes: int) -> str:
    """The text of a file of at most so many bytes; what is no UTF-8 becomes question marks.

    Raises:
        FileNotFoundError: There is no such file.
        OSError: It cannot be read.
        ValueError: It is larger.
    """
    if not file.is_file():
        raise FileNotFoundError(f"path: there is no file {str(file)!r}")
    try:
        with file.open("rb") as opened:
            raw = opened.read(most_bytes + 1)
    except OSError as error:
        raise type(error)(f"path: {str(file)!r} cannot be read ({error.strerror or error})") from error
    if len(raw) > most_bytes:
        raise ValueError(f"{file.name}: such a table has at most {most_bytes} bytes")
    return raw.decode("utf-8", errors="replace").lstrip("\ufeff")
