"""Polygons of .ply files, rewritten as triangles before trimesh reads them.

trimesh cuts every polygon into a fan from its first corner, which is wrong for concave polygons. It also cannot read
binary files whose faces have different numbers of corners.

A .ply file consists of elements, such as vertices and faces. An element is a table: it has rows, and its columns are
called properties. The value of a property is a number or a list of numbers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.scene import polygons

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# NumPy types, by the names of number types in the header of a .ply file.
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_INDEX_NAMES = ("vertex_index", "vertex_indices")


@dataclass(frozen=True)
class _Property:
    """Property (column) of an element (table) of a .ply file.

    It has the type of its values, and for a list also the type of the number that states the list's length.
    """

    name: str
    dtype: str
    length_dtype: str | None


@dataclass(frozen=True)
class _Element:
    """Element (table) of a .ply file: name, number of rows, and properties."""

    name: str
    count: int
    properties: list[_Property]


class _UnknownLayoutError(ValueError):
    """Error for a file with a layout that this module does not read; trimesh then reads or refuses the file."""


def triangulated_ply(data: bytes) -> bytes:
    """Return a .ply file in which triangles replace all polygons, if trimesh could not read the polygons correctly.

    These are files with a concave polygon, and binary files whose faces have different numbers of corners. Other files
    are returned unchanged.
    """
    try:
        return _triangulated(data)
    except (ValueError, IndexError, KeyError, OverflowError, struct.error):
        return data  # trimesh reads or refuses the file


def header_size(data: bytes) -> int:
    """Return the number of bytes of the header of a .ply file, including the end of its last line."""
    at = data.find(b"end_header")
    if at < 0:
        raise _UnknownLayoutError
    return data.index(b"\n", at) + 1


def _triangulated(data: bytes) -> bytes:
    begin = header_size(data)
    lines = data[:begin].decode("utf-8", errors="replace").splitlines()
    encoding = next(line.split()[1] for line in lines if line.startswith("format"))
    elements = list(_elements(lines))
    if [element.name for element in elements[:2]] != ["vertex", "face"]:
        raise _UnknownLayoutError
    vertex, face = elements[:2]
    if encoding == "ascii":
        return _triangulated_text(data, begin, lines, vertex, face)
    order = "<" if "little" in encoding else ">"
    dtype = np.dtype([(entry.name, order + _scalar(entry)) for entry in vertex.properties])
    vertices = np.frombuffer(data, dtype, vertex.count, begin)
    positions = np.stack([vertices[name].astype(np.float64) for name in "xyz"], axis=1)
    start = begin + vertex.count * dtype.itemsize
    uniform = _uniform_rows(data, start, face, order)
    if uniform is not None:
        index = next(uniform[entry.name]["list"] for entry in face.properties if entry.name in _INDEX_NAMES)
        if index.shape[1] <= 3 or not polygons.are_concave(positions[index.astype(np.int64)]).any():
            return data
    rows, end = _binary_rows(data, start, face, order)
    triangles = _triangles(rows, face, positions, _concave(rows, face, positions))
    body = b"".join(_packed(row, face, order) for row in triangles)
    return _header(lines, face, len(triangles)) + data[begin:start] + body + data[end:]


def _triangulated_text(data: bytes, begin: int, lines: list[str], vertex: _Element, face: _Element) -> bytes:
    body = data[begin:].decode("utf-8").splitlines()
    rows_of_text = body[vertex.count : vertex.count + face.count]
    names = [entry.name for entry in face.properties]
    is_index_first = names[0] in _INDEX_NAMES
    if is_index_first and all(row.lstrip().startswith("3 ") for row in rows_of_text):
        return data
    xyz = [[entry.name for entry in vertex.properties].index(name) for name in "xyz"]
    values = [line.split() for line in body[: vertex.count]]
    positions = np.array([[row[column] for column in xyz] for row in values], dtype=np.float64)
    rows = [_row_of_text(row.split(), face) for row in rows_of_text]
    concave = _concave(rows, face, positions)
    if not concave:
        return data
    triangles = _triangles(rows, face, positions, concave)
    texts = (" ".join(map(str, _flattened(row, face))) for row in triangles)
    rest = body[vertex.count + face.count :]
    text = "\n".join([*body[: vertex.count], *texts, *rest, ""])
    return _header(lines, face, len(triangles)) + text.encode()


def _elements(lines: list[str]) -> Iterator[_Element]:
    """Yield the elements (tables) that the header of a .ply file describes."""
    element: _Element | None = None
    for line in lines:
        words = line.split()
        if words[:1] == ["element"]:
            if element is not None:
                yield element
            element = _Element(words[1], int(words[2]), [])
        elif words[:1] == ["property"] and element is not None:
            is_list = words[1] == "list"
            dtype, name = words[-2:]
            element.properties.append(_Property(name, _TYPES[dtype], _TYPES[words[2]] if is_list else None))
    if element is not None:
        yield element


def _scalar(entry: _Property) -> str:
    """Return the type of a property whose values are numbers; raise an error if they are lists."""
    if entry.length_dtype is not None:
        raise _UnknownLayoutError
    return entry.dtype


def _uniform_rows(data: bytes, start: int, face: _Element, order: str) -> NDArray[Any] | None:
    """Return the faces of a binary file as an array, one row per face; None if lists of corners differ in length."""
    fields: list[tuple[str, Any]] = []
    at = start
    for entry in face.properties:
        if entry.length_dtype is None:
            fields.append((entry.name, order + entry.dtype))
            at += np.dtype(entry.dtype).itemsize
        else:
            length = np.dtype(order + entry.length_dtype)
            count = int(np.frombuffer(data, length, 1, at)[0])
            items = [("length", length), ("list", order + entry.dtype, (count,))]
            fields.append((entry.name, np.dtype(items)))
            at += fields[-1][1].itemsize
    dtype = np.dtype(fields)
    if len(data) < start + face.count * dtype.itemsize:
        return None
    rows = np.frombuffer(data, dtype, face.count, start)
    for entry in face.properties:
        if entry.length_dtype is not None and np.any(rows[entry.name]["length"] != rows[entry.name]["length"][0]):
            return None
    return rows


def _binary_rows(data: bytes, start: int, face: _Element, order: str) -> tuple[list[list[list[Any]]], int]:
    """Return the values of each face by property, from a binary file, and the position of the byte after the faces."""
    rows, at = [], start
    for _ in range(face.count):
        row = []
        for entry in face.properties:
            count = 1
            if entry.length_dtype is not None:
                code = order + np.dtype(entry.length_dtype).char
                (count,) = struct.unpack_from(code, data, at)
                at += struct.calcsize(code)
            code = f"{order}{count}{np.dtype(entry.dtype).char}"
            row.append(list(struct.unpack_from(code, data, at)))
            at += struct.calcsize(code)
        rows.append(row)
    return rows, at


def _row_of_text(words: list[str], face: _Element) -> list[list[Any]]:
    """Return the values of each property of a face, from the words of its line in a text file."""
    row, at = [], 0
    for entry in face.properties:
        count = 1
        if entry.length_dtype is not None:
            count, at = int(words[at]), at + 1
        if at + count > len(words):
            raise _UnknownLayoutError
        values: list[Any] = words[at : at + count]
        row.append([int(value) for value in values] if entry.name in _INDEX_NAMES else values)
        at += count
    return row


def _index_of(row: list[list[Any]], face: _Element) -> list[Any]:
    """Return the vertex indices of the corners of a face."""
    return next(values for values, entry in zip(row, face.properties, strict=True) if entry.name in _INDEX_NAMES)


def _concave(rows: list[list[list[Any]]], face: _Element, positions: NDArray[np.float64]) -> set[int]:
    """Return the indices of the faces that are concave polygons."""
    indices = (_index_of(row, face) for row in rows)
    corners = {number: np.array(index) for number, index in enumerate(indices) if len(index) > 3}
    return set(polygons.concave(corners, positions))


def _triangles(
    rows: list[list[list[Any]]], face: _Element, positions: NDArray[np.float64], concave: set[int]
) -> list[list[list[Any]]]:
    """Cut all polygons into triangles, and return the property values of each triangle.

    ``rows`` has the property values of each polygon, and ``concave`` the indices of the concave polygons.
    """
    return [
        triangle
        for number, row in enumerate(rows)
        for triangle in _triangles_of(row, face, positions, is_concave=number in concave)
    ]


def _triangles_of(
    row: list[list[Any]], face: _Element, positions: NDArray[np.float64], *, is_concave: bool
) -> list[list[list[Any]]]:
    """Cut a polygon into triangles; return the property values of each, with the texture coordinates of its corners."""
    index = _index_of(row, face)
    count = len(index)
    if count < 3:
        return []
    if min(index) < 0 or max(index) >= len(positions):
        raise _UnknownLayoutError
    triangles = polygons.triangulated(positions[np.array(index)]) if is_concave else polygons.fan(count)
    result = []
    for triangle in triangles.tolist():
        values_of_triangle = []
        for values, entry in zip(row, face.properties, strict=True):
            if entry.length_dtype is None or not values or len(values) % count:
                values_of_triangle.append(values)
            else:
                width = len(values) // count
                values_of_triangle.append([v for corner in triangle for v in values[corner * width :][:width]])
        result.append(values_of_triangle)
    return result


def _flattened(row: list[list[Any]], face: _Element) -> Iterator[Any]:
    """Yield the property values of a face in the order of the file. A list is preceded by its length."""
    for values, entry in zip(row, face.properties, strict=True):
        if entry.length_dtype is not None:
            yield len(values)
        yield from values


def _packed(row: list[list[Any]], face: _Element, order: str) -> bytes:
    """Return the property values of a face as bytes of a binary file."""
    code = order
    for values, entry in zip(row, face.properties, strict=True):
        if entry.length_dtype is not None:
            code += np.dtype(entry.length_dtype).char
        code += np.dtype(entry.dtype).char * len(values)
    return struct.pack(code, *_flattened(row, face))


def _header(lines: list[str], face: _Element, count: int) -> bytes:
    """Return the header of a .ply file with the number of faces changed to ``count``."""
    old = next(line for line in lines if line.split()[:2] == ["element", face.name])
    return "".join(f"{f'element {face.name} {count}' if line is old else line}\n" for line in lines).encode()
