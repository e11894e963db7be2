"""Texts of .obj and .off files, which are changed before trimesh reads them.

Concave polygons become triangles, because trimesh cuts every polygon into a fan from its first corner. Parts get names
of objects and materials, because trimesh names the parts of an .obj file by their materials alone.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.scene import polygons

if TYPE_CHECKING:
    from numpy.typing import NDArray

_VERTEX = re.compile(r"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
# Matches the line of a face with more than three corners in an .obj file.
_POLYGON = re.compile(r"^[ \t]*f((?:[ \t]+[^\s#]+){4,})[^\n]*$", re.MULTILINE)
# Matches the line of a face with a negative index in an .obj file.
_NEGATIVE = re.compile(r"^[ \t]*f[^\n]*[\s/]-\d", re.MULTILINE)
_NAME = re.compile(r"^[ \t]*(o|g|usemtl)(?:[ \t]+([^\n]*))?$", re.MULTILINE)
# Matches the start of a line that is indented or has a tab, in an .obj file.
_TABBED = re.compile(r"^(?:[ \t]|[^\n\t]*\t)", re.MULTILINE)
# Keywords of .obj lines that contain a name of an object, group, material or file. Tabs within the name belong to it.
_NAMING = ("o", "g", "usemtl", "mtllib")
_AFTER_SLASH = re.compile(r"/\S*")


class PartName(NamedTuple):
    """Names of the object (or group) and of the material of a part of an .obj file; None is a missing name."""

    geometry: str | None
    material: str | None


def spaced_obj(text: str) -> str:
    """Return the text of an .obj file without indentation, and with spaces instead of the tabs between its words.

    trimesh ignores lines whose keyword is indented or has a tab after it. Tabs within the name of an object, a material
    or a file remain.
    """
    if not _TABBED.search(text):
        return text
    lines = text.split("\n")
    for number, line in enumerate(lines):
        keyword, *rest = line.split(None, 1)[:2] or [""]
        if keyword in _NAMING:
            lines[number] = " ".join([keyword, *rest])
        else:
            lines[number] = line.strip().replace("\t", " ")
    return "\n".join(lines)


def triangulated_obj(text: str) -> str:
    """Return the text of an .obj file in which triangles replace concave polygons.

    The corners of the triangles have the indices of the polygon's corners: vertex, texture coordinates and normal.
    """
    found_polygons = list(_POLYGON.finditer(text))
    if not found_polygons:
        return text
    try:
        positions = np.array(_VERTEX.findall(text), dtype=np.float64).reshape(-1, 3)
        corners = _vertex_indices(found_polygons)
    except ValueError:
        return text  # trimesh refuses numbers that cannot be read
    concave = polygons.concave(corners, positions)
    pieces, end = [], 0
    for number in concave:
        match = found_polygons[number]
        tokens = match[1].split()
        triangles = polygons.triangulated(positions[corners[number]])
        lines = (f"f {' '.join(tokens[corner] for corner in triangle)}" for triangle in triangles)
        pieces += [text[end : match.start()], "\n".join(lines)]
        end = match.end()
    return "".join([*pieces, text[end:]])


def absolute_obj(text: str) -> str:
    """Return the text of an .obj file with positive indices instead of negative ones.

    A negative index counts back from the face: −1 is the last vertex, texture coordinate or normal (line v, vt or vn)
    before the line of the face. trimesh would count back from the end of the file instead.
    """
    if not _NEGATIVE.search(text):
        return text
    counts = {"v": 0, "vt": 0, "vn": 0}
    lines = text.split("\n")
    for number, line in enumerate(lines):
        kind, _, rest = line.strip().partition(" ")
        if kind in counts:
            counts[kind] += 1
        elif kind == "f" and "-" in rest:
            totals = tuple(counts.values())
            tokens = (_absolute(token, totals) for token in rest.partition("#")[0].split())
            lines[number] = f"f {' '.join(tokens)}"
    return "\n".join(lines)


def numbered_obj(text: str) -> tuple[str, list[PartName]]:
    """Return the text of an .obj file whose object names are replaced by numbers, and the names for which they stand.

    A number stands for one object with one material. In a file without objects, groups count as objects.
    """
    kind = "o" if re.search(r"^[ \t]*o[ \t]", text, re.MULTILINE) else "g"
    numbers: dict[PartName, int] = {PartName(None, None): 0}
    geometry: str | None = None
    material: str | None = None

    def numbered(match: re.Match[str]) -> str:
        nonlocal geometry, material
        name = (match[2] or "").strip() or None
        if match[1] == "usemtl":
            material = name
        elif match[1] == kind:
            geometry = name
        else:
            return ""
        number = numbers.setdefault(PartName(geometry, material), len(numbers))
        return f"usemtl {name}\no {number}" if match[1] == "usemtl" and name else f"o {number}"

    return "o 0\n" + _NAME.sub(numbered, text), list(numbers)


def triangulated_off(text: str) -> str:
    """Return the text of an .off file in which concave polygons are triangles."""
    lines = [line for line in (line.partition("#")[0].strip() for line in text.splitlines()) if line]
    if not lines or not lines[0].upper().startswith(("OFF", "COFF")):
        return text
    header = re.match("C?OFF", lines[0], re.IGNORECASE)
    if header is None:
        return text
    rest = [line for line in (lines[0][header.end() :].strip(), *lines[1:]) if line]
    try:
        vertex_count, face_count = map(int, rest[0].split()[:2])
        faces = [line.split() for line in rest[1 + vertex_count : 1 + vertex_count + face_count]]
        counts = np.array([int(face[0]) for face in faces])
        if not np.any(counts > 3):
            return text
        positions = np.array([line.split()[:3] for line in rest[1 : 1 + vertex_count]], dtype=np.float64)
        corners = {
            number: np.array(faces[number][1 : 1 + counts[number]], dtype=np.int64)
            for number in np.flatnonzero(counts > 3).tolist()
        }
    except (ValueError, IndexError):
        return text  # trimesh refuses such a file
    rows: list[str] = [" ".join(face) for face in faces]
    concave = set(polygons.concave(corners, positions))
    for number, index in corners.items():
        if len(index) <= 4 and number not in concave:
            continue
        # trimesh cannot read .off files whose faces have different numbers of corners, if these numbers exceed four.
        is_concave = number in concave
        triangles = polygons.triangulated(positions[index]) if is_concave else polygons.fan(len(index))
        colour = faces[number][1 + counts[number] :]
        triangle_rows = (["3", *(str(index[corner]) for corner in triangle), *colour] for triangle in triangles)
        rows[number] = "\n".join(" ".join(row) for row in triangle_rows)
    body = "\n".join(rows)
    count = body.count("\n") + 1
    return "\n".join([header[0].upper(), f"{vertex_count} {count} 0", *rest[1 : 1 + vertex_count], body, ""])


def _absolute(token: str, totals: tuple[int, ...]) -> str:
    """Return the text of a face's corner with positive indices; ``totals`` counts the lines v, vt and vn before it."""
    indices = token.split("/")
    for place, (index, total) in enumerate(zip(indices, totals, strict=False)):
        if index.startswith("-") and index[1:].isdigit():
            indices[place] = str(total + 1 + int(index))
    return "/".join(indices)


def _vertex_indices(matches: list[re.Match[str]]) -> dict[int, NDArray[np.int64]]:
    """Return the vertex indices of the corners of each polygon, by the polygon's number."""
    by_count: dict[int, list[int]] = {}
    for number, match in enumerate(matches):
        by_count.setdefault(len(match[1].split()), []).append(number)
    result: dict[int, NDArray[np.int64]] = {}
    for count, numbers in by_count.items():
        joined = " ".join(matches[number][1] for number in numbers)
        index = np.array(_AFTER_SLASH.sub("", joined).split(), dtype=np.int64).reshape(-1, count)
        result.update(zip(numbers, index - 1, strict=True))
    return result
