"""Reading and writing of files. A write first makes a temporary file, and errors name the file."""

from __future__ import annotations

import contextlib
import math
import os
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, marked, ref

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

_unfinished: set[Path] = set()


@contextlib.contextmanager
def atomic_write(target: Path, *, suffix: str = "", durable: bool = True) -> Iterator[Path]:
    """Provide an empty temporary file, which replaces the file ``target`` at the end of the context.

    If the context ends with an error, the temporary file is deleted and ``target`` is unchanged.

    Args:
        target: File to make or replace. The temporary file is in the same folder.
        suffix: Suffix of the temporary file's name.
        durable: Whether to wait until the new file is on the disk before it replaces the old one.
    """
    temporary = target.with_name(f".warpdiff-{os.urandom(8).hex()}{suffix}")
    _unfinished.add(temporary)
    try:
        # `os.open` applies the umask of the process to the permissions of the new file. The alternative would be to
        # read the umask by `os.umask`. This function can only change the umask, which would for a moment affect files
        # that other threads create.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield temporary
        if durable:
            # Some file systems allocate disk space only some time after a write. If the disk is full, only `fsync` then
            # raises an error.
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
        _unfinished.discard(temporary)


def save_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any], *, compressed: bool = True) -> Path:
    """Write arrays by name to a ``.npz`` file. Errors name the argument ``path``.

    An existing file is replaced only after the new one is complete. After an error, the existing file is unchanged.
    """
    target = check_output(path, (".npz",))
    with atomic_write(target) as temporary, temporary.open("rb+") as file:
        (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return target


def discard_unfinished() -> None:
    """Delete the temporary files of all active :func:`atomic_write` contexts, before the process ends abruptly."""
    for temporary in tuple(_unfinished):
        with contextlib.suppress(OSError):
            temporary.unlink()


def check_output(path: Any, suffixes: tuple[str, ...], name: str = "path") -> Path:
    """Return the checked path of a file to write; raise an error if the suffix is wrong or the file cannot be written.

    Args:
        path: Path that the user gave.
        suffixes: Accepted suffixes in lower case, such as ``".exr"``.
        name: Name of the argument for error messages.
    """
    target = validation.path(path, name)
    if target.suffix.lower() not in suffixes:
        raise ArgumentValueError(f"{ref(name)} must end in {' or '.join(suffixes)}, got {target.name!r}")
    check_folder(target.parent, name)
    if target.is_dir():
        raise marked(
            IsADirectoryError, f"{ref(name)} must be a file, got the folder {str(target)!r}; name a file in it"
        )
    return target


def made_folder(folder: Any) -> Path:
    """Create a folder for files unless it exists; return its path after a check that it is writable.

    Args:
        folder: Path that the user gave.
    """
    target = validation.path(folder, "folder")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise marked(type(error), f"{ref('folder')}: {target} cannot be created: {error.strerror}") from None
    check_folder(target, "folder")
    return target


def check_new_folder(folder: Any) -> None:
    """Raise an error if :func:`made_folder` could not create a folder; nothing is created here.

    Args:
        folder: Path that the user gave.
    """
    target = validation.path(folder, "folder")
    existing = next(parent for parent in (target, *target.absolute().parents) if parent.exists())
    if not existing.is_dir():
        raise marked(NotADirectoryError, f"{ref('folder')}: {str(existing)!r} is a file; name a folder")
    check_folder(existing, "folder")


def check_folder(folder: Path, name: str) -> None:
    """Raise an error if a folder does not exist or is not writable. The error names the argument ``name``."""
    if not folder.is_dir():
        raise marked(FileNotFoundError, f"{ref(name)}: the folder {str(folder)!r} does not exist; create it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise marked(PermissionError, f"{ref(name)}: the folder {folder} is not writable; use another one")


def check_file(file: Path) -> None:
    """Raise an error that names the argument ``path`` if a file does not exist."""
    if not file.is_file():
        raise marked(FileNotFoundError, f"{ref('path')}: there is no file {str(file)!r}")


@contextlib.contextmanager
def naming_file(file: Path) -> Iterator[None]:
    """Context for reading a file. It checks that the file exists, and adds the file's name to system errors.

    The errors name the argument ``path``.

    Raises:
        FileNotFoundError: The file does not exist.
        OSError: The file cannot be read.
    """
    check_file(file)
    try:
        yield
    except OSError as error:
        message = f"{ref('path')}: {str(file)!r} cannot be read: {error.strerror or error}"
        raise marked(type(error), message) from error


@contextlib.contextmanager
def holding(argument: str, file: Path) -> Iterator[None]:
    """Context for checking a value from a file. Error messages then name the argument ``path`` and the file.

    Args:
        argument: Name of the checked value in errors that are raised within the context. In the messages of these
            errors, ``path`` and the name of the file replace this name.
        file: File from which the value was read.
    """
    try:
        yield
    except ArgumentValueError as error:
        named = error.marked.replace(ref(argument), f"{ref('path')}: {str(file)!r}", 1)
        raise ArgumentValueError(named) from None


@contextlib.contextmanager
def describing(file: Path) -> Iterator[None]:
    """Context for checking the contents of a file. The file's name is put before messages that do not contain it."""
    try:
        yield
    except ArgumentValueError as error:
        if file.name in str(error):
            raise
        raise ArgumentValueError(f"{ref('path')}: {str(file)!r}: {error.marked}") from None


def read_text(file: Path, most_bytes: int = 16 << 20) -> str:
    """Read the text of a file; bytes that are not UTF-8 become question marks. Errors name the argument ``path``.

    Raises:
        FileNotFoundError: The file does not exist.
        OSError: The file cannot be read.
        ValueError: The file is larger than ``most_bytes``.
    """
    with naming_file(file), file.open("rb") as opened:
        raw = opened.read(most_bytes + 1)
    if len(raw) > most_bytes:
        raise ArgumentValueError(f"{ref('path')}: {file.name} must have at most {most_bytes} bytes")
    return raw.decode("utf-8", errors="replace").lstrip("\ufeff")


def shape_of_array(stream: IO[bytes]) -> tuple[int, ...]:
    """Return the shape of an array in NumPy's format, after a check that the stream has as many numbers.

    NumPy would first allocate memory for the shape, and then find out that the numbers are missing.

    Raises:
        ValueError: The header is damaged, or states more numbers than the stream has.
    """
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version = np.lib.format.read_magic(stream)
    if version not in headers:
        raise ValueError(f"version {version} of NumPy's format is unknown")
    shape, _, dtype = headers[version](stream)
    if dtype.itemsize == 0:
        # Elements without bytes, such as empty texts, need no space in the file. The header could therefore state more
        # of them than fit into memory.
        raise ValueError(f"its elements have the type {dtype}, which has no bytes")
    begin = stream.tell()
    missing = math.prod(shape) * dtype.itemsize - (stream.seek(0, os.SEEK_END) - begin)
    if missing > 0:
        raise ValueError(f"its header states shape {shape} of {dtype}, and {missing} bytes are missing")
    return shape
