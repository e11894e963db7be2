"""Files of baked tables: compressed ``.npz`` files of NumPy with named arrays, checked before they are unpacked."""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from warpdiff.core import files, memory, validation
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

if TYPE_CHECKING:
    import os
    from pathlib import Path


class SavedTable(ReadOnlyArrays):
    """Base class of tables that can be saved in a file.

    By default, the file contains all attributes by name. A subclass that stores other arrays overrides ``_arrays`` and
    ``_from_arrays``.

    Attributes:
        FORMAT: Value of ``format`` in the file.
    """

    FORMAT: ClassVar[str]

    def _arrays(self) -> dict[str, Any]:
        """Return the numbers, strings and arrays of a file by name."""
        return vars(self)

    @classmethod
    def _from_arrays(cls, arrays: dict[str, Any]) -> Self:
        """Make a table from the arrays of a file. Invalid arrays may raise an exception of any type."""
        return cls(**{name: value if value.ndim else float(value) for name, value in arrays.items()})

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the table to a file; an existing file is replaced only after the new one is complete.

        The file is a compressed ``.npz`` of NumPy. The file contains ``format`` and the arrays that the class lists.

        Args:
            path: Path of the file, ending in ``.npz``.

        Returns:
            Path of the file.
        """
        return files.save_arrays(path, {"format": self.FORMAT, **self._arrays()})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a table from a file that :meth:`save` wrote.

        Args:
            path: Path of the file.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file is damaged or of another format.
        """
        source = validation.path(path, "path")
        try:
            return cls._from_arrays(_read(source, cls.FORMAT))
        except (OSError, MemoryError):
            raise
        except Exception as error:
            # A damaged archive can cause errors of many types in zipfile, zlib and NumPy. All of them are replaced by
            # one error that names the file.
            raise ArgumentValueError(
                f"{ref('path')} must be a file that {cls.__name__}.save wrote, got {str(path)!r}: "
                f"{type(error).__name__}: {error}"
            ) from error


def _read(source: Path, expected: str) -> dict[str, Any]:
    """Return the arrays of a file by name; raise an error if its ``format`` is not the expected one."""
    with files.naming_file(source):
        memory.require_memory(source.stat().st_size, f"{ref('path')}: {str(source)!r}", "take a smaller one")
        content = io.BytesIO(source.read_bytes())
    # The content is in memory, so that an ``OSError`` from here on is not an error of the file system, but of a damaged
    # archive.
    try:
        with zipfile.ZipFile(content) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
            memory.require_memory(size, f"{ref('path')}: {str(source)!r}", "take a smaller one")
            for entry in archive.infolist():
                with archive.open(entry) as stream:
                    files.shape_of_array(stream)
        content.seek(0)
        with np.load(content, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except OSError as error:
        raise ValueError(str(error)) from None
    actual = str(arrays.pop("format"))
    if actual != expected:
        raise ValueError(f"format is {actual!r}, not {expected!r}")
    return arrays


def check(owner: Any, **expected: tuple[Any, tuple[int | None, ...]]) -> None:
    """Check the type, shape and finiteness of array attributes, and make the arrays read-only.

    None in a shape means an axis of at least two entries.
    """
    for name, (dtype, shape) in expected.items():
        array = getattr(owner, name)
        if not isinstance(array, np.ndarray) or array.dtype != dtype:
            kind = array.dtype.name if isinstance(array, np.ndarray) else type(array).__name__
            raise ArgumentTypeError(f"{ref(name)} must be an array of {np.dtype(dtype).name}, got {kind}")
        pairs = zip(array.shape, shape, strict=False)
        if len(shape) != array.ndim or 0 in shape or any(n < 2 if m is None else n != m for n, m in pairs):
            lengths = ", ".join("at least 2" if length is None else f"{length}" for length in shape)
            raise ArgumentValueError(f"{ref(name)} must have shape ({lengths}), no axis empty, got {array.shape}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            count = int(np.count_nonzero(~np.isfinite(array)))
            raise ArgumentValueError(f"{ref(name)} must be finite, got {count} NaN or infinite value(s)")
        array.setflags(write=False)
