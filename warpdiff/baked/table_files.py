"""Files of named arrays: compressed ``.npz`` of NumPy, checked before they are unpacked."""

from __future__ import annotations

import contextlib
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.files import naming_file
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator


@contextlib.contextmanager
def loaded(path: str | os.PathLike[str], format_name: str, kind: str) -> Iterator[dict[str, Any]]:
    """The arrays of a file whose ``format`` is what is told; whatever is wrong with them within, too, is a ValueError.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is not one of the kind, or damaged.
    """
    source = validation.path(path, "path")
    try:
        with naming_file(source), source.open("rb") as file:
            with zipfile.ZipFile(file) as archive:
                size = sum(entry.file_size for entry in archive.infolist())
            memory.require_memory(size, f"{ref('path')}: {str(path)!r}", "take a smaller one")
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        _check_format(str(arrays["format"]), format_name)
        yield arrays
    except (OSError, MemoryError):
        raise
    except Exception as error:
        # Damaged archives make zipfile, zlib and NumPy raise all sorts of things.
        raise ArgumentValueError(
            f"{ref('path')} must be a file that {kind}.save wrote, got {str(path)!r}: {type(error).__name__}: {error}"
        ) from error


def _check_format(actual: str, expected: str) -> None:
    if actual != expected:
        raise ValueError(f"format is {actual!r}, not {expected!r}")


def check(owner: Any, **expected: tuple[Any, tuple[int, ...]]) -> None:
    """Refuse attributes that are not arrays of a type and a shape, or not finite; from now on they are read-only."""
    for name, (dtype, shape) in expected.items():
        array = getattr(owner, name)
        if not isinstance(array, np.ndarray) or array.dtype != dtype:
            kind = array.dtype.name if isinstance(array, np.ndarray) else type(array).__name__
            raise ArgumentTypeError(f"{ref(name)} must be an array of {np.dtype(dtype).name}, got {kind}")
        if array.shape != shape or 0 in shape:
            raise ArgumentValueError(f"{ref(name)} must have shape {shape}, without an empty axis, got {array.shape}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            count = int(np.count_nonzero(~np.isfinite(array)))
            raise ArgumentValueError(f"{ref(name)} must be finite, got {count} NaN or infinite value(s)")
        array.setflags(write=False)
