"""Readers of instrument files by the library SurfaceTopography, and conversion of its objects."""

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

# Memory at the peak while a file is read [bytes per sample]: the library copies and scales. A doubled value refuses
# files that fit.
_BYTES_PER_SAMPLE = 64.0
# Tag of the TIFF files of Park Systems that contains a constant, see their description of the format.
_PARK_TAG = 50432
_TIFF = {b"II*\0": "<", b"MM\0*": ">"}
# Largest number of entries of the directory of a TIFF file that are searched for the tag.
_MOST_TAGS = 1000
# First bytes of files whose suffixes are shared with other formats.
_NANOSCOPE = (b"\\*File list", b"\\*Force file list", b"?*File list")
_METROPRO = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
# Words of channels that are no heights, although some programs state a length as their unit.
_OTHER_SIGNALS = ("amplitude", "error", "deflection", "phase", "friction", "lateral", "potential", "current")


def _begins_with(*magic: bytes) -> Callable[[Path], bool]:
    """Return a function of a path: whether the file begins with one of these bytes."""

    def recognises(file: Path) -> bool:
        with file.open("rb") as stream:
            return stream.read(max(map(len, magic))).startswith(magic)

    return recognises


def _is_park(file: Path) -> bool:
    """Whether a TIFF file is a scan of Park Systems: its pixels are a coloured preview, and a tag has the heights."""
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


# Formats: title, name in the library, suffixes, and how files of shared suffixes are recognised. Formats are absent
# that the library reads without sizes (.h5, .mat), reads with wrong sizes (.nms), or that are profiles (.xlsx).
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
    """List the channels of heights in a file of a format of the library."""
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
        # Readers of damaged files raise errors of many types.
        raise _damaged(file, name, error) from None
    # The library's own default comes first, unless its name says that it is another signal.
    listed.sort(key=lambda entry: (_is_other_signal(entry[1]), entry[0] != default))
    if not listed:
        raise refusal(file, "has no channel of heights with a unit of length on a grid; export the height channel")
    channels: dict[str, Callable[[], FileContent]] = {}
    for _, label, channel in listed:
        unique = next(name for name in _numbered(label) if name not in channels)
        channels[unique] = functools.partial(_content, channel, file, name)
    return channels


def _numbered(label: str) -> Iterator[str]:
    """Return a name and its variants, for channels of the same name."""
    yield label
    number = 2
    while True:
        yield f"{label} ({number})"
        number += 1


def _damaged(file: Path, name: str, error: Exception) -> ArgumentValueError:
    """Return the error for a file that the library cannot read."""
    return refusal(
        file, f"cannot be read as a file of {name.upper()} ({one_line(error)}); export it again, or as .x3p or text"
    )


def _name(channel: Any) -> str:
    """Return the name of a channel on one line."""
    return " ".join(str(channel.name).split()) or "height"


def _is_other_signal(name: str) -> bool:
    """Whether the name of a channel says that it is no height."""
    return any(word in name.lower() for word in _OTHER_SIGNALS)


def _is_height(channel: Any) -> bool:
    """Whether a channel has heights on a grid: other signals have another unit, or a pair of units."""
    if channel.dim != 2 or not isinstance(channel.unit, (str, type(None))):
        return False
    units = (channel.unit, channel.data_unit)
    return channel.is_height_channel and all(unit is None or length_units.factor_of(str(unit)) for unit in units)


def _content(channel: Any, file: Path, name: str) -> FileContent:
    """Read a channel."""
    nx, ny = channel.nb_grid_pts
    require_memory(file, (ny, nx), _BYTES_PER_SAMPLE)
    # The library requires a size; the pitch that it implies is not used.
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
    """Return the heights of a 2-D topography of SurfaceTopography, as the picture that Gwyddion shows.

    Its heights have the shape (nx, ny); their transpose needs no flip.
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
    """Return nested metadata as text by dotted name, without the raw header."""
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
    """Register the formats of the library."""
    for title, name, suffixes, recognises in _FORMATS:
        register_reader(*suffixes, title=title, states="everything in the file", recognises=recognises, extra="scans")(
            functools.partial(_read, name)
        )


_register()
