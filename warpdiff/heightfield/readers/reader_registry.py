"""Registry of readers of height files, and conversion of the content of a file to heights [µm] and a pitch [µm]."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from warpdiff.core import files, memory, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, listed, marked, ref
from warpdiff.heightfield.readers import length_units

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from numpy.typing import NDArray

Rows = Literal["down", "up"]
# A file is refused if its height field is wider or higher than this [µm]: 1 m, larger than the field of any instrument.
# A reader that confuses the units of a file returns such sizes. If doubled, a few more of these wrong sizes are
# accepted.
_MOST_EXTENT_UM = 1e6
# Largest accepted difference between the pitch that a file states and the pitch that the caller states, relative to the
# pitch. Small differences are accepted, because the numbers in a file are rounded; the pitch of the file is then used.
# If doubled, an argument that contradicts the file by up to 0.2 % is ignored without an error.
_MOST_DIFFERENCE = 1e-3


@dataclass(frozen=True, eq=False)
class FileContent:
    """Contents of a file of heights, or of one channel of it.

    Attributes:
        samples: Array of shape (ny, nx), in the order of the rows of the picture that the instrument shows. ``uint8``
            and ``uint16`` samples have no unit; the caller states their full scale. Floating-point numbers are heights,
            NaN for a missing sample.
        pitch_um: Distance of the samples [µm], one number or a pair (dy, dx); None if the file does not state it.
        rows: Default orientation of the samples: ``"down"`` puts row 0 at y = 0, ``"up"`` makes row 0 the top of the
            picture.
        has_unit: Whether floating-point samples are in µm. If False, the caller states the unit of the samples.
        pitch_in_unit: Distance of the samples (dy, dx) in the unit that the caller states, for files with coordinates
            without a unit; otherwise None.
        is_known_scale: Whether the file was written by `HeightField.save`. The units of such a file are certain, and no
            check asks whether the sizes and heights are plausible.
        metadata: Facts about instrument and measurement that the file states, as text by name.
        notes: Changes of the samples by the reader, as sentences for the history of the field.
        why_no_pitch: Reason why the pitch in the file was not read, for the error that asks the caller for a pitch.
        why_no_unit: Reason why the unit in the file was not read, for the error that asks the caller for a unit.
    """

    samples: np.ndarray
    pitch_um: float | tuple[float, float] | None = None
    rows: Rows = "down"
    has_unit: bool = True
    pitch_in_unit: tuple[float, float] | None = None
    is_known_scale: bool = False
    metadata: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    why_no_pitch: str = ""
    why_no_unit: str = ""


# Channels of a file by name; the default channel is the first one. A channel is read only when its function is called.
Channels = Mapping[str, Callable[[], FileContent]]
Reader = Callable[[Path], FileContent | Channels]


@dataclass(frozen=True, eq=False)
class RegisteredReader:
    """A reader of files of heights, with the facts that the documentation lists about its format.

    Attributes:
        read: Function that reads a file of this format from its path.
        suffixes: Suffixes of files of this format, with their dot.
        title: Name of the format.
        states: Text for the documentation: the facts that a file contains, and the facts that the caller has to state.
        recognises: Function of a path that returns whether the content of the file has this format. The function is
            required if files of this format have other suffixes, or if other formats use the same suffixes. None if the
            suffix alone identifies the format.
        extra: Name of warpdiff's optional extra that installs the library for this format, or an empty string.
    """

    read: Reader
    suffixes: tuple[str, ...]
    title: str
    states: str = ""
    recognises: Callable[[Path], bool] | None = None
    extra: str = ""


class Source(NamedTuple):
    """File and channel from which heights were read.

    Attributes:
        path: Path of the file; an empty string for an object in memory.
        channel: Name of the channel; an empty string if the file has only one array of heights.
        rows: Orientation: ``"down"`` if row 0 of the file is at y = 0, ``"up"`` if row 0 is the top of the picture.
        metadata: Facts about instrument and measurement that the file states, as text by name.
        stated: Arguments by which the caller stated size, unit, channel or orientation, as text by name.
        clipped: Fraction of integer samples with the smallest or the largest value of their type; 0 for floating-point
            samples.
    """

    path: str
    channel: str
    rows: Rows
    metadata: Mapping[str, str]
    stated: Mapping[str, str]
    clipped: float


# Readers by suffix, in the order of registration. If several readers recognise the content of a file, the reader that
# was registered last reads it.
_readers: dict[str, tuple[RegisteredReader, ...]] = {}
# Suffix of the reader for files that no other reader recognises. This reader is OpenImageIO, which identifies images by
# their content.
_FALLBACK = ".png"


def register_reader(
    *suffixes: str, title: str = "", states: str = "", recognises: Callable[[Path], bool] | None = None,
    extra: str = "",
) -> Callable[[Reader], Reader]:  # fmt: skip
    """Register the decorated function as the reader of files with these suffixes, for `HeightField.load`.

    Args:
        suffixes: Suffixes with their dot, such as ``".spm"``, in upper or lower case. For the files that it recognises,
            the reader replaces readers of the same suffix that were registered before.
        title: Name of the format in the documentation; by default the suffixes.
        states: Text for the documentation: the facts that a file contains, and the facts that the caller has to state.
        recognises: Function of a path that returns whether the content of the file has this format. Without this
            function, the reader reads all files of its suffixes and no others. With this function, the reader also
            reads files with other suffixes whose content it recognises, unless a reader of these suffixes accepts them.
            Readers that were registered later are tried first.
        extra: Name of warpdiff's optional extra that installs the libraries of the reader.
    """

    def register(reader: Reader) -> Reader:
        lower = tuple(suffix.lower() for suffix in suffixes)
        entry = RegisteredReader(reader, lower, title or ", ".join(lower), states, recognises, extra)
        for suffix in lower:
            _readers[suffix] = (*_readers.get(suffix, ()), entry)
        return reader

    return register


def registered() -> tuple[RegisteredReader, ...]:
    """Return all registered readers of height files, in the order of registration."""
    return tuple(dict.fromkeys(entry for entries in _readers.values() for entry in entries))


def reader_of(file: Path) -> RegisteredReader:
    """Return the reader of a file, by its suffix and content."""
    own = _readers.get(file.suffix.lower(), ())[::-1]
    # Readers that were registered later are tried first. The text reader, for example, is registered before the
    # readers of instruments' files. It would accept some of these binary files, because they begin with a text.
    known = (*own, *(entry for entry in registered()[::-1] if entry not in own and entry.recognises))
    with files.naming_file(file):
        for entry in known:
            if entry.recognises is None or entry.recognises(file):
                return entry
    return own[0] if own else _readers[_FALLBACK][-1]


def existing(path: str | os.PathLike[str]) -> Path:
    """Return the argument ``path`` as the path of an existing file; raise an error if there is no such file."""
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
    """Add the name of the file to each error of a reader whose message does not contain this name."""
    try:
        yield
    except (ArgumentValueError, ArgumentTypeError):
        raise
    except ValueError as error:
        raise refusal(file, f"cannot be read: {one_line(error)}") from None


def channels_of(file: Path) -> tuple[str, ...]:
    """Return the names of the channels of a file; empty if the file has a single array without a name."""
    content = _read(file)
    return () if isinstance(content, FileContent) else tuple(content)


def _read(file: Path) -> FileContent | Channels:
    """Return the content of a file with one array of heights, or the channels of a file with several arrays."""
    reader = reader_of(file).read
    with _naming(file):
        return reader(file)


def read(file: Path, channel: str | None) -> tuple[FileContent, str]:
    """Return the content of one channel of a file, and the channel's name, empty if the file has a single array."""
    content = _read(file)
    name = ""
    if not isinstance(content, FileContent):
        name = next(iter(content)) if channel is None else channel
        if name not in content:
            raise ArgumentValueError(
                f"{ref('channel')} must be one of {listed([*map(repr, content)])}, which {str(file)!r} has, got "
                f"{name!r}{did_you_mean(name, content)}"
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


def check_texts(channel: object, unit: object) -> None:
    """Raise an error if ``channel`` or ``unit`` is not a string, or if ``unit`` is not a known unit."""
    if channel is not None and not isinstance(channel, str):
        raise ArgumentTypeError(f"{ref('channel')} must be a string, got {type(channel).__name__}")
    if unit is not None:
        length_units.factor_um(unit, "unit")


def rows_of(content: FileContent, rows: object) -> Rows:
    """Return the orientation of rows: the argument ``rows``, or the default of the file if the argument is None."""
    return content.rows if rows is None else validation.choice(rows, "rows", get_args(Rows))  # type: ignore[return-value]


def heights_of(
    content: FileContent, file: Path, height_range_um: float | None, unit: str | None
) -> NDArray[np.float64]:
    """Return samples as heights [µm]: integers are scaled by their full scale, floating-point numbers by their unit."""
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
    """Return the factor from floating-point samples to heights [µm].

    The factor is 1 for a file that states its unit, and otherwise follows from the argument ``unit``.
    """
    if content.has_unit:
        if unit is not None:
            raise ArgumentValueError(f"{ref('unit')} must not be given: heights of {str(file)!r} have a unit already")
        return 1.0
    if unit is None:
        text = "clear text" if content.why_no_unit else "text"
        raise ArgumentValueError(
            f"{ref('unit')} must be given: {str(file)!r} has no {text} that states the unit of its heights"
            f"{_because(content.why_no_unit)}; it is one of {', '.join(length_units.SYMBOLS)}"
        )
    return length_units.factor_um(unit, "unit")


def clipped_share(samples: NDArray[Any]) -> float:
    """Return the fraction of integer samples with the smallest or largest value of their type; 0 for other samples."""
    if samples.dtype.kind != "u" or not samples.size:
        return 0.0
    is_extreme = (samples == 0) | (samples == np.iinfo(samples.dtype).max)
    return float(np.count_nonzero(is_extreme)) / samples.size


def _because(reason: str) -> str:
    """Return the reason why a header line of a file was not read, in the form that continues an error message."""
    return f" (header: {reason})" if reason else ""


def refusal(file: Path, reason: str) -> ArgumentValueError:
    """Return the error for a refused file. The message is the file's name, continued by ``reason``."""
    return ArgumentValueError(f"{ref('path')}: {str(file)!r} {reason}")


def one_line(error: Exception) -> str:
    """Return the message of an exception as one line of at most about 200 characters."""
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
    """Return the pitch of a file [µm]: from the file itself, or from exactly one of ``extent_um`` and ``pitch_um``."""
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
            f"must be given, got {'both' if names else 'neither'}{'' if names else _because(content.why_no_pitch)}"
        )
    return _stated_pitch((ny, nx), extent_um, pitch_um)


def _agrees(
    content: FileContent, own: object, extent_um: float | tuple[float, float] | None,
    pitch_um: float | tuple[float, float] | None,
) -> bool:  # fmt: skip
    """Whether the pitch that a file states agrees with the pitch that the arguments state.

    The result is False for a file of `HeightField.save`: the pitch in such a file is exact, and an argument for the
    pitch is refused.
    """
    if content.is_known_scale or (extent_um is not None and pitch_um is not None):
        return False
    stated = _stated_pitch(content.samples.shape, extent_um, pitch_um)
    pairs = zip(validation.pair(stated, "pitch_um"), validation.pair(own, "path"), strict=True)
    return all(abs(value - step) <= _MOST_DIFFERENCE * step for value, step in pairs)


def _stated_pitch(
    shape: tuple[int, ...], extent_um: float | tuple[float, float] | None, pitch_um: float | tuple[float, float] | None
) -> float | tuple[float, float]:
    """Return the pitch [µm] from the argument ``pitch_um``, or from ``extent_um`` and the number of samples."""
    if pitch_um is not None:
        return validation.pair(pitch_um, "pitch_um")
    ny, nx = shape
    if validation.is_sequence(extent_um):
        size = validation.pair(extent_um, "extent_um")
        return size[0] / ny, size[1] / nx
    return validation.positive(extent_um, "extent_um") / nx


def _is_too_large(shape: tuple[int, int], pitch_um: object) -> bool:
    """Whether the width or the height of a field exceeds 1 m, which is more than any instrument measures."""
    try:
        pitch = validation.pair(pitch_um, "pitch_um")
    except (ArgumentValueError, ArgumentTypeError):
        # A pitch that is no positive number or pair of such numbers is refused later, by the constructor of
        # `HeightField`.
        return False
    return any(n * step > _MOST_EXTENT_UM for n, step in zip(shape, pitch, strict=True))
