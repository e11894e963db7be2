"""Readers of arrays: ``.npy``, and the ``.npz`` files of ``HeightField.save``."""

from __future__ import annotations

import zipfile
from typing import IO, TYPE_CHECKING

import numpy as np

from warpdiff.core import files
from warpdiff.heightfield.readers.reader_registry import FileContent, refusal, register_reader, require_memory

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path

    from warpdiff.core.wording import ArgumentValueError

# Measured peak memory while an array is read [bytes per sample]. Files that need more than the free memory are refused.
# If doubled, files are refused that would fit into memory.
_BYTES_PER_SAMPLE = 28.0


@register_reader(
    ".npy", title="NumPy array", states="floats: µm, you state the pitch; integers: also the height of the full scale"
)
def read_npy(file: Path) -> FileContent:
    """Read a NumPy array of heights."""
    return FileContent(_read_array(file, lambda: file.open("rb"), "numpy.save, as plain numbers"))


@register_reader(".npz", title="file of `HeightField.save`", states="everything in the file")
def read_npz(file: Path) -> FileContent:
    """Read heights, pitch and history, as `HeightField.save` writes them. A file without a history is accepted."""
    writer = "HeightField.save"
    try:
        archive = zipfile.ZipFile(file)
    except Exception as error:
        raise _unreadable(file, error, writer) from None

    def member(name: str) -> np.ndarray:
        return _read_array(file, lambda: archive.open(f"{name}.npy"), writer)

    with archive:
        heights, pitch = member("heights_um"), member("pitch_um")
        history = member("history") if "history.npy" in archive.namelist() else np.zeros(0, dtype=np.str_)
    if history.ndim != 1 or history.dtype.kind != "U":
        raise refusal(
            file, f"must have a list of sentences as history, got shape {history.shape} of type {history.dtype}"
        )
    return FileContent(heights, pitch.tolist(), is_known_scale=True, notes=tuple(history.tolist()))


def _read_array(file: Path, opened: Callable[[], AbstractContextManager[IO[bytes]]], writer: str) -> np.ndarray:
    """Read an array in NumPy's format from a stream.

    The function ``opened`` opens the stream. The function is called twice: first to read the shape, by which the memory
    is checked, and then to read the numbers.
    """
    try:
        with opened() as stream:
            shape = files.shape_of_array(stream)
    except Exception as error:
        raise _unreadable(file, error, writer) from None
    require_memory(file, shape, _BYTES_PER_SAMPLE)
    try:
        with opened() as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
    except Exception as error:
        raise _unreadable(file, error, writer) from None


def _unreadable(file: Path, error: Exception, writer: str) -> ArgumentValueError:
    """Return the error for a file that NumPy cannot read. NumPy's own exceptions for damaged files have many types."""
    return refusal(file, f"cannot be read as {file.suffix.lower()} ({error}); write it with {writer}")
