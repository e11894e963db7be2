"""Reader of ``.x3p`` files of ISO 25178-72: a zip archive of an XML header and of binary heights.

Files that deviate from the standard without an effect on the heights are accepted: other revisions, namespaces or
folders, and wrong checksums.
"""

from __future__ import annotations

import math
import zipfile
from typing import TYPE_CHECKING, NoReturn
from xml.parsers import expat

import numpy as np

from warpdiff.heightfield.readers.reader_registry import FileContent, refusal, register_reader, require_memory

if TYPE_CHECKING:
    from pathlib import Path

# Measured peak memory while a file is read [bytes per sample]: samples of the file, float64 heights, mask of missing
# samples, and the height field. If doubled, files that fit into memory are refused.
_BYTES_PER_SAMPLE = 40.0
# A file is refused if its XML header is larger than this size [bytes]. A header may contain the heights themselves; at
# this size it has about a million heights. The limit stops compressed headers that expand a thousandfold.
_MOST_XML_BYTES = 1 << 25
# A file is refused if elements of its XML header are nested deeper than this. The XML headers of the format have a
# depth of 6.
_MOST_DEPTH = 32
# The XML header is searched among the files in the zip archive. This is the largest number of files that are searched.
# Archives of the format have about 5 files.
_MOST_MEMBERS = 1000
_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}
# Micrometres per metre; the metre is the unit of all lengths in the format.
_UM_PER_M = 1e6
_HEADER, _ARCHIVE, _RESOURCES = "main.xml", b"PK\x03\x04", "__MACOSX"
# Paths of the XML header's elements whose texts are stored as metadata of the height field, by the name of the
# metadata.
_METADATA = {
    "date": "Record2/Date", "vendor": "Record2/Instrument/Manufacturer", "instrument": "Record2/Instrument/Model",
    "serial": "Record2/Instrument/Serial", "version": "Record2/Instrument/Version", "creator": "Record2/Creator",
    "probe": "Record2/ProbingSystem/Identification", "comment": "Record2/Comment",
}  # fmt: skip


def _is_x3p(file: Path) -> bool:
    """Whether a file is a zip archive that contains the XML header of the format."""
    with file.open("rb") as stream:
        if stream.read(4) != _ARCHIVE:
            return False
    try:
        with zipfile.ZipFile(file) as archive:
            return _header_name(archive) is not None
    except Exception:
        # All exceptions are caught, because damaged archives cause many types of exceptions.
        return False


def _header_name(archive: zipfile.ZipFile) -> str | None:
    """Return the name of the XML header in an archive, where it may be in a folder; None if there is no XML header."""
    for name in archive.namelist()[:_MOST_MEMBERS]:
        if name.rsplit("/", 1)[-1] == _HEADER and not name.startswith(_RESOURCES):
            return name
    return None


@register_reader(".x3p", title="X3P (ISO 25178-72)", states="everything in the file", recognises=_is_x3p)
def read_x3p(file: Path) -> FileContent:
    """Read the heights and the pitch of a surface from an ``.x3p`` file."""
    try:
        archive = zipfile.ZipFile(file)
    except OSError:
        raise
    except Exception as error:
        raise _damaged(file, f"it is no zip archive: {error}") from None
    with archive:
        name = _header_name(archive)
        if name is None:
            raise _damaged(file, f"it has no {_HEADER}")
        try:
            header = _Header(_member(archive, name, _MOST_XML_BYTES, file))
        except (expat.ExpatError, _HeaderError) as error:
            raise _damaged(file, f"{name}: {error}") from None
        return _content(file, archive, name.removesuffix(_HEADER), header)


def _damaged(file: Path, reason: str) -> Exception:
    """Return the error for a file that does not follow the ``.x3p`` format, with the reason."""
    return refusal(file, f"cannot be read as .x3p ({reason}); export it again")


def _member(archive: zipfile.ZipFile, name: str, most: int, file: Path, *, least: int = 0) -> bytes:
    """Return the bytes of a file in the archive, after a check of its size.

    An error is raised if the file has fewer than ``least`` bytes, the number that the header states. If ``least`` is 0,
    the header states no number, and an error is raised if the file has more than ``most`` bytes. To find this out, at
    most one byte more than ``most`` is decompressed. If ``least`` is not 0, further bytes are ignored.
    """
    try:
        with archive.open(name) as stream:
            data = stream.read(most + 1)
    except Exception as error:
        # zipfile raises errors of many types: for a file that does not exist, an unknown compression method, or a wrong
        # checksum.
        raise _damaged(file, f"{name}: {error}") from None
    if len(data) < least:
        raise _damaged(file, f"{name} has {len(data)} bytes, and the header states {least}")
    if not least and len(data) > most:
        raise _damaged(file, f"{name} is larger than {most} bytes")
    return data


class _HeaderError(ValueError):
    """Raised for an XML header in which a value is missing or invalid, or that describes an unsupported surface."""


class _Header:
    """Texts of the elements of the XML header, by path without namespaces; heights in the header are separate.

    Attributes:
        texts: Text of each element by its path below the root, such as ``"Record1/Axes/CX/Increment"``. Of several
            elements with the same path, the first one counts.
        data: Texts of the heights, if the header contains the heights themselves.
    """

    def __init__(self, xml: bytes) -> None:
        self.texts: dict[str, str] = {}
        self.data: list[str] = []
        self._path: list[str] = []
        self._text: list[str] = []
        parser = expat.ParserCreate()
        # A document type is refused. Only a document type could define entities, which may expand without limit or read
        # other files.
        parser.StartDoctypeDeclHandler = self._refuse
        parser.StartElementHandler = self._begin
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._text.append
        parser.Parse(xml, True)

    def _refuse(self, *_: object) -> NoReturn:
        raise _HeaderError("a document type is not accepted")

    def _begin(self, name: str, _: object) -> None:
        self._path.append(name.rsplit(":", 1)[-1])
        self._text.clear()
        if len(self._path) > _MOST_DEPTH:
            raise _HeaderError(f"elements are nested deeper than {_MOST_DEPTH}")

    def _end(self, _: str) -> None:
        path, text = "/".join(self._path[1:]), "".join(self._text).strip()
        if path == "Record3/DataList/Datum":
            self.data.append(text)
        elif text:
            self.texts.setdefault(path, text)
        self._path.pop()
        self._text.clear()

    def number(self, path: str) -> float:
        """Return the number at a path of the XML header; raise an error if there is no number."""
        try:
            return float(self.texts[path])
        except (KeyError, ValueError):
            raise _HeaderError(f"{path} is no number: {self.texts.get(path, '')[:40]!r}") from None

    def count(self, path: str) -> int:
        """Return the number of samples at a path of the header; raise an error unless it is a positive integer."""
        value = self.number(path)
        if not (1.0 <= value < 2**31 and value == int(value)):
            raise _HeaderError(f"{path} is no number of samples: {value:g}")
        return int(value)

    def check_layers(self) -> None:
        """Raise an error if the file contains several surfaces (layers)."""
        layers = self.texts.get("Record3/MatrixDimension/SizeZ", "1")
        if layers != "1":
            raise _HeaderError(f"it has {layers[:20]} layers, and one is read")


def _content(file: Path, archive: zipfile.ZipFile, folder: str, header: _Header) -> FileContent:
    """Return the heights and the pitch of the surface that the XML header describes."""
    kind = header.texts.get("Record1/FeatureType", "SUR")
    if kind != "SUR":
        names = {"PRF": "a profile", "PCL": "a cloud of points without a grid"}
        raise refusal(file, f"is {names.get(kind, f'of type {kind[:20]!r}')}, not a surface; export a surface")
    try:
        pitch = [_increment(header, axis) for axis in ("CY", "CX")]
        header.check_layers()
        shape = header.count("Record3/MatrixDimension/SizeY"), header.count("Record3/MatrixDimension/SizeX")
        require_memory(file, shape, _BYTES_PER_SAMPLE)
        link = header.texts.get("Record3/DataLink/PointDataLink")
        heights = _of_list(header, shape) if link is None else _of_member(file, archive, folder + link, header, shape)
    except _HeaderError as error:
        raise _damaged(file, str(error)) from None
    mask = header.texts.get("Record3/DataLink/ValidPointsLink")
    if mask is not None:
        size = -(-heights.size // 8)
        bits = np.frombuffer(_member(archive, folder + mask, size, file, least=size), np.uint8)[:size]
        heights[np.unpackbits(bits, bitorder="little")[: heights.size].reshape(shape) == 0] = np.nan
    # Some programs of the manufacturer Alicona write infinity for a missing sample.
    heights[~np.isfinite(heights)] = np.nan
    metadata = {name: header.texts[path] for name, path in _METADATA.items() if path in header.texts}
    return FileContent(_UM_PER_M * heights, (pitch[0], pitch[1]), rows="up", metadata=metadata)


def _increment(header: _Header, axis: str) -> float:
    """Return the distance of samples [µm] along the axis ``"CX"`` (x) or ``"CY"`` (y)."""
    path = f"Record1/Axes/{axis}"
    if header.texts.get(f"{path}/AxisType", "I") != "I":
        raise _HeaderError(f"positions along {axis} are stated one by one, and a regular grid is required")
    step = header.number(f"{path}/Increment")
    if not 0.0 < step < math.inf:
        raise _HeaderError(f"{path}/Increment must be positive: {step:g}")
    return _UM_PER_M * step


def _of_member(file: Path, archive: zipfile.ZipFile, name: str, header: _Header, shape: tuple[int, int]) -> np.ndarray:
    """Return the heights [m] from a binary file in the archive."""
    letter = header.texts.get("Record1/Axes/CZ/DataType", "")
    if letter not in _TYPES:
        raise _HeaderError(f"heights are of an unknown type {letter[:20]!r}")
    dtype = np.dtype(_TYPES[letter])
    size = math.prod(shape) * dtype.itemsize
    samples = np.frombuffer(_member(archive, name, size, file, least=size)[:size], dtype).reshape(shape)
    return samples.astype(np.float64) if dtype.kind == "f" else _scaled(samples, header)


def _scaled(samples: np.ndarray, header: _Header) -> np.ndarray:
    """Convert integer samples to heights [m] by the increment and the offset in the header."""
    offset = header.number("Record1/Axes/CZ/Offset") if "Record1/Axes/CZ/Offset" in header.texts else 0.0
    return samples * header.number("Record1/Axes/CZ/Increment") + offset


def _of_list(header: _Header, shape: tuple[int, int]) -> np.ndarray:
    """Return the heights [m] that the XML header lists as texts of the form "z" or "x;y;z"."""
    if len(header.data) != math.prod(shape):
        raise _HeaderError(f"it lists {len(header.data)} heights, and the header states {math.prod(shape)}")
    last = (text.replace(",", ";").rsplit(";", 1)[-1].strip() for text in header.data)
    try:
        heights = np.array([float(text) if text else math.nan for text in last]).reshape(shape)
    except ValueError as error:
        raise _HeaderError(str(error)) from None
    return _scaled(heights, header) if header.texts.get("Record1/Axes/CZ/DataType", "") in ("I", "L") else heights
