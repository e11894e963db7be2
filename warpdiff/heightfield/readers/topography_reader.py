"""Readers of instrument files by the library SurfaceTopography, and conversion of the library's objects."""

from __future__ import annotations

import functools
import math
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield.readers import length_units
from warpdiff.heightfield.readers.reader_registry import (
    FileContent,
    one_line,
    refusal,
    register_reader,
    require_memory,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from warpdiff.heightfield.readers.reader_registry import Channels

# Measured peak memory while a file is read [bytes per sample]; the library copies the samples several times. If
# doubled, files that fit into memory are refused.
_BYTES_PER_SAMPLE = 64.0
# Number of the TIFF tag by which files of Park Systems microscopes are recognised: all of them have the tag, according
# to the description of the format.
_PARK_TAG = 50432
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
# Largest number of tags of a TIFF file that are compared with the tag of Park Systems.
_MOST_TAGS = 1000
# First bytes by which the files of two kinds of instruments are recognised. Other formats use the same suffixes.
_NANOSCOPE = (b"\\*File list", b"\\*Force file list", b"?*File list")
_METROPRO = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
# Words in the names of channels that contain no heights. Some programs state a length as the unit of such channels, so
# that only the name shows that a channel contains no heights.
_OTHER_SIGNALS = ("amplitude", "error", "deflection", "phase", "friction", "lateral", "potential", "current")


def _begins_with(*magic: bytes) -> Callable[[Path], bool]:
    """Return a function of a path that returns whether the file begins with one of the byte strings ``magic``."""

    def recognises(file: Path) -> bool:
        with file.open("rb") as stream:
            return stream.read(max(map(len, magic))).startswith(magic)

    return recognises


def _is_park(file: Path) -> bool:
    """Whether a file is a scan of Park Systems: a TIFF file whose pixels are a preview, with the heights in a tag."""
    with file.open("rb") as stream:
        order = _TIFF.get(stream.read(4))
        if order is None:
            return False
        try:
            stream.seek(*struct.unpack(f"{order}I", stream.read(4)))
            (count,) = struct.unpack(f"{order}H", stream.read(2))
            directory = stream.read(12 * min(count, _MOST_TAGS))
            return any(tag == _PARK_TAG for tag, *_ in struct.iter_unpack(f"{order}H10s", directory))
        except struct.error:
            return False


# Formats that the library SurfaceTopography reads: title, name in the library, suffixes, and a function that recognises
# files by content if other formats share the suffixes. Other formats of the library are absent, because the library
# reads no sizes (.h5, .mat) or wrong sizes (.nms), or because the files are profiles (.xlsx).
_FORMATS: tuple[tuple[str, str, tuple[str, ...], Callable[[Path], bool] | None], ...] = (
    ("Alicona", "al3d", (".al3d",), None),
    ("BCR-STM", "bcr", (".bcr", ".bcrf"), None),
    ("Bruker Nanoscope", "di", (".spm", ".di", ".001", ".002", ".003"), _begins_with(*_NANOSCOPE)),
    ("Digital Surf SURF", "sur", (".sur",), None),
    ("FRT MicroProf", "frt", (".frt",), None),
    ("Gwyddion", "gwy", (".gwy",), None),
    ("Asylum Research, Igor Pro", "ibw", (".ibw",), None),
    ("ISO 25178-71 SDF", "sdf", (".sdf",), None),
    ("JPK", "jpk", (".jpk", ".jpk-qi-image"), None),
    ("Keyence VK", "vk", (".vk3", ".vk4", ".vk6", ".vk7"), None),
    ("Keyence ZON", "zon", (".zon",), None),
    ("Keysight, Agilent, Molecular Imaging", "mi", (".mi",), None),
    ("Digital Surf Mountains", "mnt", (".mnt",), None),
    ("Nanosurf", "ezd", (".ezd", ".nid"), None),
    ("NT-MDT", "mdt", (".mdt",), None),
    ("Olympus LEXT", "lext", (".lext",), None),
    ("Olympus OIR", "oir", (".oir",), None),
    ("Olympus POIR", "poir", (".poir",), None),
    ("OS3D", "os3d", (".os3d",), None),
    ("Park Systems TIFF", "ps", (".tif", ".tiff"), _is_park),
    ("Sensofar", "plu", (".plu", ".apx"), None),
    ("Sensofar PLUX", "plux", (".plux",), None),
    ("SurfaceTopography NetCDF", "nc", (".nc",), None),
    ("TrueMap", "tmd", (".tmd",), None),
    ("WSxM", "wsxm", (".stp", ".top", ".tom"), None),
    ("Wyko OPD", "opd", (".opd",), None),
    ("Dektak, Bruker OPDx", "opdx", (".opdx",), None),
    ("Zygo DATX", "datx", (".datx",), None),
    ("Zygo MetroPro", "metropro", (".dat",), _begins_with(*_METROPRO)),
    ("KLA Zeta", "zmg", (".zmg",), None),
)


def _read(name: str, file: Path) -> Channels:
    """Return the channels of a file that contain heights. ``name`` is SurfaceTopography's name of the file format."""
    try:
        from SurfaceTopography.IO import open_topography
    except ImportError as error:
        reason = "" if isinstance(error, ModuleNotFoundError) else f" ({one_line(error)})"
        raise refusal(
            file, f"requires the extra scans, which is not installed{reason}: pip install 'warpdiff[scans]'"
        ) from None
    try:
        reader = open_topography(str(file), format=name)
        default = reader.default_channel.index
        listed = [(channel.index, _name(channel), channel) for channel in reader.channels if _is_height(channel)]
    except MemoryError:
        raise
    except Exception as error:
        # All exceptions are converted, because the library's readers raise many types of exceptions for damaged files.
        raise _damaged(file, name, error) from None
    # The default channel of the library comes first, unless its name shows that it has no heights but another signal,
    # such as a phase.
    listed.sort(key=lambda entry: (_is_other_signal(entry[1]), entry[0] != default))
    if not listed:
        raise refusal(file, "has no channel of heights with a unit of length on a grid; export the height channel")
    channels: dict[str, Callable[[], FileContent]] = {}
    for _, label, channel in listed:
        unique = next(name for name in _numbered(label) if name not in channels)
        channels[unique] = functools.partial(_content, channel, file, name)
    return channels


def _numbered(label: str) -> Iterator[str]:
    """Yield the name of a channel, then the name with the numbers 2, 3, …, for further channels of the same name."""
    yield label
    number = 2
    while True:
        yield f"{label} ({number})"
        number += 1


def _damaged(file: Path, name: str, error: Exception) -> ArgumentValueError:
    """Return the error for a file that the library SurfaceTopography cannot read."""
    return refusal(
        file, f"cannot be read as a file of {name.upper()} ({one_line(error)}); export it again, or as .x3p or text"
    )


def _name(channel: Any) -> str:
    """Return the name of a channel without line breaks; "height" if it has none."""
    return " ".join(str(channel.name).split()) or "height"


def _is_other_signal(name: str) -> bool:
    """Whether the name of a channel shows that it has no heights but another signal, such as a phase or a current."""
    return any(word in name.lower() for word in _OTHER_SIGNALS)


def _is_height(channel: Any) -> bool:
    """Whether a channel has heights on a grid: it has two dimensions, and its unit is a length or not stated."""
    if channel.dim != 2 or not isinstance(channel.unit, (str, type(None))):
        return False
    units = (channel.unit, channel.data_unit)
    return channel.is_height_channel and all(unit is None or length_units.factor_of(str(unit)) for unit in units)


def _content(channel: Any, file: Path, name: str) -> FileContent:
    """Read the heights of one channel of a file."""
    nx, ny = channel.nb_grid_pts
    require_memory(file, (ny, nx), _BYTES_PER_SAMPLE)
    # If the file states no size, the library requires a size as an argument. This arbitrary size is discarded below.
    sizes = {} if channel.physical_sizes is not None else {"physical_sizes": (1.0, 1.0)}
    try:
        content = content_of(channel.topography(**sizes))
    except MemoryError:
        raise
    except Exception as error:
        raise _damaged(file, name, error) from None
    if not sizes:
        return content
    return FileContent(content.samples, None, content.rows, content.has_unit, metadata=content.metadata)


def content_of(topography: Any) -> FileContent:
    """Return the heights of a 2-D topography of SurfaceTopography, in the orientation in which Gwyddion shows them.

    The heights of the library have the shape (nx, ny). Transposed heights are in the order of the picture, and are not
    flipped.
    """
    for name in ("heights", "physical_sizes", "unit", "dim"):
        if not hasattr(topography, name):
            raise ArgumentTypeError(
                f"{ref('topography')} must be a topography of SurfaceTopography, got {type(topography).__name__}"
            )
    if topography.dim != 2:
        raise ArgumentValueError(f"{ref('topography')} must be a map, got a line scan")
    values = np.ma.asarray(topography.heights())
    if values.ndim != 2 or 0 in values.shape:
        raise ArgumentValueError(f"{ref('topography')} must have heights on a grid, got shape {values.shape}")
    heights = np.ma.filled(values.astype(np.float64), np.nan).T
    ny, nx = heights.shape
    sizes = None if topography.physical_sizes is None else [float(size) for size in topography.physical_sizes]
    if sizes is not None and not (len(sizes) == 2 and all(0.0 < size < math.inf for size in sizes)):
        raise ArgumentValueError(f"{ref('topography')} must have two positive sizes, got {sizes}")
    metadata = _flat(getattr(topography, "info", None) or {})
    if topography.unit is None:
        pitch = None if sizes is None else (sizes[1] / ny, sizes[0] / nx)
        return FileContent(heights, None, "up", has_unit=False, pitch_in_unit=pitch, metadata=metadata)
    factor = length_units.factor_of(str(topography.unit))
    if factor is None:
        raise ArgumentValueError(f"{ref('topography')} must have a unit of length, got {topography.unit!r}")
    pitch = None if sizes is None else (factor * sizes[1] / ny, factor * sizes[0] / nx)
    return FileContent(factor * heights, pitch, "up", metadata=metadata)


def _flat(info: Any, prefix: str = "") -> dict[str, str]:
    """Return nested metadata as text, with names like "instrument.name", and without the raw header of the file."""
    result: dict[str, str] = {}
    for key, value in dict(info).items():
        if key == "raw_metadata":
            continue
        if hasattr(value, "items"):
            result |= _flat(value, f"{prefix}{key}.")
        elif value is not None:
            result[f"{prefix}{key}"] = str(value)
    return result


def _register() -> None:
    """Register a reader for each of the formats of the library SurfaceTopography."""
    for title, name, suffixes, recognises in _FORMATS:
        register_reader(*suffixes, title=title, states="everything in the file", recognises=recognises, extra="scans")(
            functools.partial(_read, name)
        )


_register()
