"""Small text files: read whole, or refused by their name."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_MOST_BYTES = 16 << 20


def read(file: Path) -> str:
    """A file's text, whatever its bytes are.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It cannot be read, or is of more than 16 MiB.
    """
    if not file.is_file():
        raise FileNotFoundError(f"path: there is no file {str(file)!r}")
    try:
        with file.open("rb") as opened:
            raw = opened.read(_MOST_BYTES + 1)
    except OSError as error:
        raise ValueError(f"path: {str(file)!r} cannot be read ({error.strerror})") from None
    if len(raw) > _MOST_BYTES:
        raise ValueError(f"path: {str(file)!r} has more than {_MOST_BYTES} bytes; give a table in text")
    return raw.decode("utf-8-sig", errors="replace")
