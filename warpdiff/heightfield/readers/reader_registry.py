"""Registry of readers, and the way from the content of a file to heights [µm] and their pitch."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from warpdiff.core import files, memory, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, marked, ref
from warpdiff.heightfield.readers import length_units

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from numpy.typing import NDArray

Rows = Literal["down", "up"]
# Extent above which a file is refused [µm]: 1 m, larger than the field of any instrument. Readers that confuse units
# give such sizes. If doubled, one more factor of two of wrong sizes passes.
_MOST_EXTENT_UM = 1e6
# Relative difference of the pitch of a file and a stated one up to which they agree, because headers are rounded. If
# doubled, arguments that contradict a file slightly more are ignored.
_MOST_DIFFERENCE = 1e-3
# Number of channels that an error lists; more make it unreadable.
_MOST_NAMES = 12


@dataclass(frozen=True, eq=False)
class FileContent:
    """Contents of a file of heights, or of one channel of it.

    Attributes:
        samples: Array of shape (ny, nx), in the order of the rows of the picture that the instrument shows. ``uint8``
            and ``uint16`` samples have no unit; the caller states their full scale. Floating-point numbers are heights,
            NaN for a missing sample.
        pitch_um: Distance of the samples [µm], one number or a pair (dy, dx); None if the file does not state it.
        rows: Default orientation: ``"down"`` puts row 0 at y = 0, ``"up"`` makes row 0 the top of the picture.
        has_unit: Whether floating-point samples are in µm. If False, the caller states their unit.
        pitch_in_unit: Pair (dy, dx) in the unit that the caller states, for files with coordinates without a unit.
        is_known_scale: Whether the scale is intended, so that it is not checked.
        metadata: What the file says about instrument and measurement, as text by name.
    """

    samples: np.ndarray
    pitch_um: float | tuple[float, float] | None = None
    rows: Rows = "down"
    has_unit: bool = True
    pitch_in_unit: tuple[float, float] | None = None
    is_known_scale: bool = False
    metadata: Mapping[str, str] = field(default_factory=dict)


# Channels of a file by name, the default one first; each is read when its function is called.
Channels = Mapping[str, Callable[[], FileContent]]
Reader = Callable[[Path], FileContent | Channels]


@dataclass(frozen=True, eq=False)
class RegisteredReader:
    """A reader with the facts of the table of formats.

    Attributes:
        read: The function.
        suffixes: Suffixes of its files.
        title: Name of the format.
        states: Facts that the file contains and facts that the caller states, for the table.
        recognises: Whether a file of another suffix, or of a suffix of several formats, has this format by its content;
            None for formats that the suffix alone identifies.
        extra: Extra of the package that it requires, or an empty string.
    """

    read: Reader
    suffixes: tuple[str, ...]
    title: str
    states: str = ""
    recognises: Callable[[Path], bool] | None = None
    extra: str = ""


class Source(NamedTuple):
    """Where heights were read from.

    Attributes:
        path: Path of the file; an empty string for an object in memory.
        channel: Name of the channel; an empty string for a file of one.
        rows: Orientation: ``"down"`` if row 0 of the file is at y = 0, ``"up"`` if it is the top of the picture.
        metadata: What the file says about instrument and measurement, as text by name.
    """

    path: str
    channel: str
    rows: Rows
    metadata: Mapping[str, str]


# Readers by suffix in the order of registration. A later one is preferred.
_readers: dict[str, tuple[RegisteredReader, ...]] = {}
# Suffix whose reader reads files that no reader knows: OpenImageIO recognises images by their content.
_FALLBACK = ".png"


def register_reader(
    *suffixes: str, title: str = "", states: str = "", recognises: Callable[[Path], bool] | None = None,
    extra: str = "",
) -> Callable[[Reader], Reader]:  # fmt: skip
    """Register the decorated function as the reader of files with these suffixes, for `HeightField.load`.

    Args:
        suffixes: Suffixes with their dot, such as ``".spm"``, in upper or lower case. A reader replaces an earlier one
            of the same suffix, for the files that it recognises.
        title: Name of the format, for the table of formats; by default the suffixes.
        states: Facts that the file contains and facts that the caller states, for the table.
        recognises: Function of a path that returns whether the file has this format by its content. Files of other
            suffixes are read by the first reader that recognises them. Without it, the suffix alone decides.
        extra: Extra of the package that the reader requires.
    """

    def register(reader: Reader) -> Reader:
        lower = tuple(suffix.lower() for suffix in suffixes)
        entry = RegisteredReader(reader, lower, title or ", ".join(lower), states, recognises, extra)
        for suffix in lower:
            _readers[suffix] = (*_readers.get(suffix, ()), entry)
        return reader

    return register


def registered() -> tuple[RegisteredReader, ...]:
    """Return all readers, in the order of registration."""
    return tuple(dict.fromkeys(entry for entries in _readers.values() for entry in entries))


def reader_of(file: Path) -> RegisteredReader:
    """Return the reader of a file, by its suffix and content."""
    own = _readers.get(file.suffix.lower(), ())[::-1]
    # Later readers are preferred: headers of some instruments begin as the texts of an earlier one.
    known = (*own, *(entry for entry in registered()[::-1] if entry not in own and entry.recognises))
    with files.naming_file(file):
        for entry in known:
            if entry.recognises is None or entry.recognises(file):
                return entry
    return own[0] if own else _readers[_FALLBACK][-1]


def existing(path: str | os.PathLike[str]) -> Path:
    """Return the argument ``path`` as the path of a file; raise an error if it is none."""
    file = validation.path(path, "path")
    if not file.exists():
        raise marked(
            FileNotFoundError,
            f"{ref('path')}: there is no file {str(file)!r}; check the name and the working directory",
        )
    if not file.is_file():
        raise refusal(file, "is not a file; give a grey image, .npy or .npz")
    return file


@contextlib.contextmanager
def _naming(file: Path) -> Iterator[None]:
    """Name the file in errors of readers that do not."""
    try:
        yield
    except (ArgumentValueError, ArgumentTypeError):
        raise
    except ValueError as error:
        raise refusal(file, f"cannot be read: {one_line(error)}") from None


def channels_of(file: Path) -> tuple[str, ...]:
    """Return the names of the channels of a file; none for a file of one array without a name."""
    content = _read(file)
    return () if isinstance(content, FileContent) else tuple(content)


def _read(file: Path) -> FileContent | Channels:
    """Read a file, or list its channels."""
    reader = reader_of(file).read
    with _naming(file):
        return reader(file)


def read(file: Path, channel: str | None) -> tuple[FileContent, str]:
    """Return the content of a file, and the name of its channel or an empty string."""
    content = _read(file)
    name = ""
    if not isinstance(content, FileContent):
        name = next(iter(content)) if channel is None else channel
        if name not in content:
            raise ArgumentValueError(
                f"{ref('channel')} must be one of {_listed(tuple(content))}, which {str(file)!r} has, got {name!r}"
                f"{did_you_mean(name, content)}"
            )
        with _naming(file):
            content = content[name]()
    elif channel is not None:
        raise ArgumentValueError(
            f"{ref('channel')} must not be given: {str(file)!r} has one array of heights, got {channel!r}"
        )
    shape = content.samples.shape
    if len(shape) != 2 or 0 in shape:
        raise refusal(file, f"has shape {shape}; save one array of shape (ny, nx)")
    return content, name


def _listed(names: tuple[str, ...]) -> str:
    """Return names for an error, at most so many."""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(map(repr, names[:_MOST_NAMES])) + more


def check_texts(channel: object, unit: object) -> None:
    """Raise an error for a channel or a unit of a wrong type, and for an unknown unit."""
    if channel is not None and not isinstance(channel, str):
        raise ArgumentTypeError(f"{ref('channel')} must be a string, got {type(channel).__name__}")
    if unit is not None:
        length_units.factor_um(unit, "unit")


def rows_of(content: FileContent, rows: object) -> Rows:
    """Return the orientation of rows: the argument ``rows``, or the default of the file."""
    return content.rows if rows is None else validation.choice(rows, "rows", get_args(Rows))  # type: ignore[return-value]


def heights_of(
    content: FileContent, file: Path, height_range_um: float | None, unit: str | None
) -> NDArray[np.float64]:
    """Return samples as heights [µm]: scale integers by their full scale, and floating-point numbers by their unit."""
    samples = content.samples
    if samples.dtype in (np.uint8, np.uint16):
        full = int(np.iinfo(samples.dtype).max)
        if height_range_um is None:
            raise ArgumentValueError(
                f"{ref('height_range_um')} must be given: {str(file)!r} has integer samples without a unit; it is the "
                f"height [µm] of the full scale 0 to {full}"
            )
        if unit is not None:
            raise ArgumentValueError(f"{ref('unit')} must not be given: {ref('height_range_um')} scales the integers")
        scale = validation.positive(height_range_um, "height_range_um") / full
        return np.asarray(np.multiply(samples, scale, dtype=np.float64))
    if samples.dtype.kind != "f":
        raise refusal(file, f"has samples of type {samples.dtype}; save uint8, uint16 or floating-point µm")
    if height_range_um is not None:
        which = "which are in µm already" if content.has_unit else f"whose unit {ref('unit')} states"
        raise ArgumentValueError(
            f"{ref('height_range_um')} must not be given: {str(file)!r} has floating-point samples, {which}"
        )
    heights = samples.astype(np.float64)
    infinite = int(np.count_nonzero(np.isinf(heights)))
    if infinite:
        raise refusal(file, f"has {infinite} infinite sample(s); save missing ones as NaN")
    factor = _factor(content, file, unit)
    return heights if factor == 1.0 else heights * factor


def _factor(content: FileContent, file: Path, unit: str | None) -> float:
    """Return the size [µm] of the unit of floating-point samples."""
    if content.has_unit:
        if unit is not None:
            raise ArgumentValueError(f"{ref('unit')} must not be given: heights of {str(file)!r} have a unit already")
        return 1.0
    if unit is None:
        raise ArgumentValueError(
            f"{ref('unit')} must be given: {str(file)!r} has no text that states the unit of its heights; it is one of "
            f"{', '.join(length_units.SYMBOLS)}"
        )
    return length_units.factor_um(unit, "unit")


def refusal(file: Path, reason: str) -> ArgumentValueError:
    """Return an error that names a file and the reason why it is refused."""
    return ArgumentValueError(f"{ref('path')}: {str(file)!r} {reason}")


def one_line(error: Exception) -> str:
    """Return the message of an error of another library as one line of limited length."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else f"{text[:200]} …"


def require_memory(file: Path, shape: tuple[int, ...], bytes_per_sample: float) -> None:
    """Raise ``MemoryError`` if a file has more samples than fit into memory."""
    if len(shape) == 2:
        memory.require_memory(
            bytes_per_sample * math.prod(shape),
            f"{ref('path')}: {str(file)!r} of {shape[0]} × {shape[1]} samples",
            "take {share} of its area, or save it at a coarser pitch",
        )


def pitch_of(
    content: FileContent, file: Path, extent_um: float | tuple[float, float] | None,
    pitch_um: float | tuple[float, float] | None, unit: str | None,
) -> float | tuple[float, float]:  # fmt: skip
    """Return the pitch of a file [µm]: its own, or from exactly one of the arguments of `HeightField.load`."""
    ny, nx = content.samples.shape
    names = [name for name, value in (("extent_um", extent_um), ("pitch_um", pitch_um)) if value is not None]
    own = content.pitch_um
    if own is None and content.pitch_in_unit is not None and unit is not None and not names:
        factor = length_units.factor_um(unit, "unit")
        own = content.pitch_in_unit[0] * factor, content.pitch_in_unit[1] * factor
    if own is not None:
        if names and not _agrees(content, own, extent_um, pitch_um):
            pitch = " × ".join(f"{step:.6g}" for step in validation.pair(own, "path"))
            raise ArgumentValueError(
                f"{ref(names[0])} must not be given: {str(file)!r} states its own pitch, {pitch} µm (y × x)"
            )
        if validation.is_sequence(own) and len(own) == 2 and _is_too_large((ny, nx), own):
            size = " × ".join(f"{1e-6 * n * float(step):.3g}" for n, step in zip((ny, nx), own, strict=True))  # type: ignore[arg-type]
            raise refusal(file, f"states a size of {size} m, beyond any instrument; export it in another format")
        return own
    if len(names) != 1:
        raise ArgumentValueError(
            f"exactly one of {ref('extent_um')} (size of the field) and {ref('pitch_um')} (distance of the samples) "
            f"must be given, got {'both' if names else 'neither'}"
        )
    return _stated_pitch((ny, nx), extent_um, pitch_um)


def _agrees(
    content: FileContent, own: object, extent_um: float | tuple[float, float] | None,
    pitch_um: float | tuple[float, float] | None,
) -> bool:  # fmt: skip
    """Whether the pitch of a file is also the one that the arguments state; files of `HeightField.save` need none."""
    if content.is_known_scale or (extent_um is not None and pitch_um is not None):
        return False
    stated = _stated_pitch(content.samples.shape, extent_um, pitch_um)
    pairs = zip(validation.pair(stated, "pitch_um"), validation.pair(own, "path"), strict=True)
    return all(abs(value - step) <= _MOST_DIFFERENCE * step for value, step in pairs)


def _stated_pitch(
    shape: tuple[int, ...], extent_um: float | tuple[float, float] | None, pitch_um: float | tuple[float, float] | None
) -> float | tuple[float, float]:
    """Return the pitch [µm] that one of the arguments states."""
    if pitch_um is not None:
        return validation.pair(pitch_um, "pitch_um")
    ny, nx = shape
    if validation.is_sequence(extent_um):
        size = validation.pair(extent_um, "extent_um")
        return size[0] / ny, size[1] / nx
    return validation.positive(extent_um, "extent_um") / nx


def _is_too_large(shape: tuple[int, int], pitch_um: object) -> bool:
    """Whether a size is beyond any instrument."""
    try:
        pitch = validation.pair(pitch_um, "pitch_um")
    except (ArgumentValueError, ArgumentTypeError):
        # The constructor of the height field refuses it.
        return False
    return any(n * step > _MOST_EXTENT_UM for n, step in zip(shape, pitch, strict=True))
