"""Readers of height field files, in a registry by suffix: grey images, ``.npy`` and ``.npz``."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import memory, openimageio, validation
from warpdiff.core.wording import ArgumentValueError, marked, ref

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

# Memory at the peak while a file is read [bytes per sample], as measured. A doubled value refuses files that fit.
_BYTES_PER_SAMPLE = 28.0


@dataclass(frozen=True, eq=False)
class FileContent:
    """Contents of a file of heights.

    Attributes:
        samples: Array of shape (ny, nx), rows along y. ``uint8`` and ``uint16`` samples have no unit; the caller states
            their full scale. Floating-point numbers are heights [µm], NaN for a missing sample.
        pitch_um: Distance of the samples [µm], one number or a pair (dy, dx); None if the file does not state it.
    """

    samples: np.ndarray
    pitch_um: float | tuple[float, float] | None = None


Reader = Callable[[Path], FileContent]
_readers: dict[str, Reader] = {}


def register_reader(*suffixes: str) -> Callable[[Reader], Reader]:
    """Register the decorated function as the reader of files with these suffixes, for `HeightField.load`.

    Args:
        suffixes: Suffixes with their dot, such as ``".spm"``, in upper or lower case. A reader replaces an earlier one
            of the same suffix.
    """

    def register(reader: Reader) -> Reader:
        _readers.update({suffix.lower(): reader for suffix in suffixes})
        return reader

    return register


def existing(path: str | os.PathLike[str]) -> Path:
    """Return the argument ``path`` as the path of a file; raise an error if it is none."""
    file = validation.path(path, "path")
    if not file.exists():
        raise marked(
            FileNotFoundError,
            f"{ref('path')}: there is no file {str(file)!r}; check the name and the working directory",
        )
    if not file.is_file():
        raise _refusal(file, "is not a file; give a grey image, .npy or .npz")
    return file


def read(file: Path, height_range_um: float | None) -> tuple[NDArray[np.float64], float | tuple[float, float] | None]:
    """Return the heights [µm] of a file, and its pitch or None; files of unregistered suffixes are read as images."""
    content = _readers.get(file.suffix.lower(), read_image)(file)
    shape = content.samples.shape
    if len(shape) != 2 or 0 in shape:
        raise _refusal(file, f"has shape {shape}; save one array of shape (ny, nx)")
    return _in_micrometres(content.samples, file, height_range_um), content.pitch_um


def _in_micrometres(samples: np.ndarray, file: Path, height_range_um: float | None) -> NDArray[np.float64]:
    """Return samples as heights [µm]: scale integers by their full scale, leave floating-point numbers unchanged."""
    if samples.dtype in (np.uint8, np.uint16):
        full = int(np.iinfo(samples.dtype).max)
        if height_range_um is None:
            raise ArgumentValueError(
                f"{ref('height_range_um')} must be given: {str(file)!r} has integer samples without a unit; it is the "
                f"height [µm] of the full scale 0 to {full}"
            )
        scale = validation.positive(height_range_um, "height_range_um") / full
        return np.asarray(np.multiply(samples, scale, dtype=np.float64))
    if samples.dtype.kind != "f":
        raise _refusal(file, f"has samples of type {samples.dtype}; save uint8, uint16 or floating-point µm")
    if height_range_um is not None:
        raise ArgumentValueError(
            f"{ref('height_range_um')} must not be given: {str(file)!r} has floating-point samples, which are in µm "
            "already"
        )
    heights = samples.astype(np.float64)
    infinite = int(np.count_nonzero(np.isinf(heights)))
    if infinite:
        raise _refusal(file, f"has {infinite} infinite sample(s); save missing ones as NaN")
    return heights


def _require_memory(file: Path, shape: tuple[int, ...]) -> None:
    """Raise ``MemoryError`` if a file has more samples than fit into memory."""
    if len(shape) == 2:
        memory.require_memory(
            _BYTES_PER_SAMPLE * math.prod(shape),
            f"{ref('path')}: {str(file)!r} of {shape[0]} × {shape[1]} samples",
            "take {share} of its area, or save it at a coarser pitch",
        )


@register_reader(".npy")
def read_npy(file: Path) -> FileContent:
    """Read a NumPy array of heights."""
    return FileContent(_read_array(file, lambda: file.open("rb"), "numpy.save, as plain numbers"))


@register_reader(".npz")
def read_npz(file: Path) -> FileContent:
    """Read heights and pitch, as `HeightField.save` writes them."""
    heights, pitch = (
        _read_array(file, functools.partial(_member, file, name), "HeightField.save")
        for name in ("heights_um", "pitch_um")
    )
    return FileContent(heights, pitch.tolist())


@contextlib.contextmanager
def _member(file: Path, name: str) -> Iterator[IO[bytes]]:
    """Open an array of a ``.npz`` file."""
    with zipfile.ZipFile(file) as archive, archive.open(f"{name}.npy") as stream:
        yield stream


def _read_array(file: Path, opened: Callable[[], AbstractContextManager[IO[bytes]]], writer: str) -> np.ndarray:
    """Read an array from a stream, which is opened once for the shape and once for the numbers."""
    try:
        with opened() as stream:
            shape = _shape_of_array(stream)
    except Exception as error:
        raise _unreadable(file, error, writer) from None
    _require_memory(file, shape)
    try:
        with opened() as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
    except Exception as error:
        raise _unreadable(file, error, writer) from None


def _unreadable(file: Path, error: Exception, writer: str) -> ArgumentValueError:
    """Return the error for a file that NumPy cannot read; parsers of damaged files raise errors of many types."""
    return _refusal(file, f"cannot be read as {file.suffix.lower()} ({error}); write it with {writer}")


def _refusal(file: Path, reason: str) -> ArgumentValueError:
    """Return an error that names a file and the reason why it is refused."""
    return ArgumentValueError(f"{ref('path')}: {str(file)!r} {reason}")


def _shape_of_array(stream: IO[bytes]) -> tuple[int, ...]:
    """Return the shape from the header of a ``.npy`` stream; () if it is truncated or of an unknown version."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version = np.lib.format.read_magic(stream)
    if version not in headers:
        return ()
    shape, _, dtype = headers[version](stream)
    begin = stream.tell()
    return shape if math.prod(shape) * dtype.itemsize <= stream.seek(0, os.SEEK_END) - begin else ()


def read_image(file: Path) -> FileContent:
    """Read a grey image without a conversion of its samples."""
    with openimageio.in_use() as oiio:
        image = oiio.ImageInput.open(str(file))
        if image is None:
            raise _refusal(file, f"cannot be read as an image ({_reason(oiio)}); give a grey image, .npy or .npz")
        try:
            return FileContent(_samples_of(image, file))
        finally:
            image.close()


def _samples_of(image: Any, file: Path) -> np.ndarray:
    """Return the samples of an open file, which must contain one grey image."""
    spec = image.spec()
    channels = spec.nchannels
    if channels != 1:
        kind = "a grey image with alpha" if channels == 2 else f"a colour image ({channels} channels)"
        raise _refusal(file, f"is {kind}; save its heights as one grey channel, 8-bit, 16-bit or float")
    _require_memory(file, (spec.height, spec.width))
    # "unknown" selects the type of the file, which avoids a conversion.
    samples = image.read_image("unknown")
    if samples is None or image.has_error:
        raise _refusal(file, f"is damaged ({_reason(image)}); export the image again")
    if image.seek_subimage(1, 0):
        raise _refusal(file, "contains several images; save the one with the heights alone")
    return np.asarray(samples)[..., 0]


def _reason(source: Any) -> str:
    """Return the last message of OpenImageIO as one line; it may contain bytes of the file that are not text."""
    try:
        return " ".join(source.geterror().split())
    except UnicodeDecodeError:
        return "its header is damaged"


def pitch_of(
    file: Path, own_pitch: float | tuple[float, float] | None, shape: tuple[int, ...],
    extent_um: float | tuple[float, float] | None, pitch_um: float | tuple[float, float] | None,
) -> float | tuple[float, float]:  # fmt: skip
    """Return the pitch of a file [µm]: its own, or from exactly one of the arguments of `HeightField.load`."""
    names = [name for name, value in (("extent_um", extent_um), ("pitch_um", pitch_um)) if value is not None]
    if own_pitch is not None:
        if names:
            raise ArgumentValueError(f"{ref(names[0])} must not be given: {str(file)!r} states its own pitch")
        return own_pitch
    if len(names) != 1:
        raise ArgumentValueError(
            f"exactly one of {ref('extent_um')} (size of the field) and {ref('pitch_um')} (distance of the samples) "
            f"must be given, got {'both' if names else 'neither'}"
        )
    if pitch_um is not None:
        return validation.pair(pitch_um, "pitch_um")
    ny, nx = shape
    if validation.is_sequence(extent_um):
        size = validation.pair(extent_um, "extent_um")
        return size[0] / ny, size[1] / nx
    return validation.positive(extent_um, "extent_um") / nx
