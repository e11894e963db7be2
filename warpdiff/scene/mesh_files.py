"""Mesh files as parts of a scene. A reader of this package reads glTF files; trimesh reads the other formats."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from warpdiff.core import validation
from warpdiff.core.text_encodings import decoded
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, marked, ref
from warpdiff.scene import gltf, mesh_images, obj_text, ply_polygons, trimesh_parts
from warpdiff.scene.scene_parts import Appearance, ScenePart

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    import trimesh
    from PIL import Image
    from trimesh.resolvers import FilePathResolver

# Name of the only mesh of a file whose format stores no names.
UNNAMED = "mesh 0"
# Size of the header of a binary .stl file, and of each of its triangles [bytes].
_STL_HEADER_BYTES, _STL_TRIANGLE_BYTES = 84, 50
# Suffixes of formats in which a file has one mesh without a name.
_SINGLE = (".ply", ".stl", ".off")
# Formats that trimesh reads here. For the last two it uses other packages. The readers of trimesh for archives and for
# other formats are not used, so that a file can neither contain files nor select another decoder.
_BY_TRIMESH = (".obj", *_SINGLE, ".3mf", ".dae")


def load(path: str | os.PathLike[str]) -> list[ScenePart]:
    """Read a mesh file and the files that it refers to in the same folder; files elsewhere are not opened.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file cannot be read.
    """
    file = validation.path(path, "mesh")
    if not file.exists():
        raise marked(FileNotFoundError, f"the {ref('mesh')} file {str(file)!r} does not exist")
    if not file.is_file():
        raise ArgumentValueError(f"{ref('mesh')} must be a file, got the folder {str(file)!r}")
    if file.suffix.lower() in (".gltf", ".glb"):
        parts = gltf.load(file)
    elif file.suffix.lower() in _BY_TRIMESH:
        parts = _load_by_trimesh(file)
    else:
        names = ", ".join((".gltf", ".glb", *_BY_TRIMESH))
        raise ArgumentValueError(f"{ref('mesh')} must be a file of the formats {names}, got {str(file)!r}; convert it")
    if not parts:
        raise ArgumentValueError(f"{ref('mesh')} must have triangles, got a scene or file without any")
    return parts


def _load_by_trimesh(file: Path) -> list[ScenePart]:
    """Read a mesh file by the package trimesh, and return its parts."""
    import trimesh

    contents: dict[str, bytes] = {}
    reasons: dict[str, str] = {}
    suffix = file.suffix.lower()
    names: list[obj_text.PartName] = []
    try:
        source: Path | io.BytesIO = file
        if suffix in (".obj", *_SINGLE):
            data, names = _rewritten(file.read_bytes(), suffix)
            source = io.BytesIO(data)
        # With ``process=False``, trimesh does not merge vertices. Merged vertices would have wrong texture coordinates
        # along texture seams.
        scene = trimesh.load_scene(
            source, file_type=suffix.removeprefix("."), process=False, split_objects=True,
            resolver=_resolver(file, contents, reasons),
        )  # fmt: skip
    except Exception as error:
        # For a damaged file, the loaders of trimesh raise errors of any type, so that all types are caught here.
        raise ArgumentValueError(
            f"{ref('mesh')} must be a file that trimesh can read, got {str(file)!r}, which is damaged, truncated or of "
            f"another format: {str(error) or type(error).__name__}"
        ) from error
    if suffix == ".stl":
        # For STL files with several bodies, trimesh merges vertices despite process=False. Merged vertices would have
        # smooth normals instead of those of their faces.
        for geometry in scene.geometry.values():
            geometry.unmerge_vertices()
    for name, data in contents.items():
        reason = _why_no_image(name, data)
        if reason:
            reasons[name] = reason
    for name, reason in reasons.items():
        warn(f"{ref('mesh')}: {str(file)!r} refers to {name!r}, which is ignored: {reason}")
    _name_images(scene, contents, file)
    parts = trimesh_parts.parts_of(scene)
    if suffix == ".obj":
        return _named_parts(parts, names)
    if suffix in _SINGLE:
        return [replace(part, geometry=f"mesh {number}") for number, part in enumerate(parts)]
    return parts


def _rewritten(data: bytes, suffix: str) -> tuple[bytes, list[obj_text.PartName]]:
    """Rewrite the contents of a mesh file so that trimesh reads them correctly.

    Texts are encoded in UTF-8. Concave polygons are divided into triangles. The second result has the names of the
    parts of an .obj file.
    """
    if suffix == ".obj":
        text = decoded(data).replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
        text = obj_text.spaced_obj(text)
        text, names = obj_text.numbered_obj(obj_text.triangulated_obj(obj_text.absolute_obj(text)))
        return text.encode(), names
    if suffix == ".off":
        return obj_text.triangulated_off(decoded(data)).encode(), []
    if suffix == ".stl":
        is_binary = len(data) >= _STL_HEADER_BYTES and len(data) == _STL_HEADER_BYTES + _STL_TRIANGLE_BYTES * (
            int.from_bytes(data[_STL_HEADER_BYTES - 4 : _STL_HEADER_BYTES], "little")
        )
        text = "" if is_binary else decoded(data)
        return (text.encode() if text.lstrip().startswith("solid") else data), []
    text = decoded(data[:1000])
    if "format ascii" in text:
        return ply_polygons.triangulated_ply(decoded(data).replace("\r\n", "\n").replace("\r", "\n").encode()), []
    try:
        size = ply_polygons.header_size(data)
    except ValueError:
        return data, []
    return ply_polygons.triangulated_ply(decoded(data[:size]).encode() + data[size:]), []


def _named_parts(parts: list[ScenePart], names: list[obj_text.PartName]) -> list[ScenePart]:
    """Return the parts of an .obj file, named after the objects and materials in the file."""
    appearances: dict[str, Appearance] = {}
    named = []
    for part in parts:
        number = re.match(r"\d+", part.geometry)
        name = names[int(number[0])] if number and int(number[0]) < len(names) else obj_text.PartName(None, None)
        appearance = None
        if name.material is not None:
            known = replace(part.appearance or Appearance(""), name=name.material)
            appearance = appearances.setdefault(name.material, known)
        named.append(replace(part, geometry=name.geometry or UNNAMED, appearance=appearance))
    return named


def _resolver(file: Path, contents: dict[str, bytes], reasons: dict[str, str]) -> FilePathResolver:
    """Return the object by which trimesh opens the files to which a mesh file refers.

    The object stores the content of each opened file in ``contents``, and the reason of each failure in ``reasons``.
    """
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):  # type: ignore[misc]
        def get(self, name: str) -> bytes:
            try:
                data: bytes = super().get(name)
            except FileNotFoundError:
                reasons[name] = "the file does not exist"
                raise
            except (OSError, ValueError) as error:
                outside = not isinstance(error, OSError)
                reasons[name] = "it lies outside the mesh's folder" if outside else str(error)
                raise
            contents[name] = data
            return decoded(data).encode() if Path(name).suffix.lower() == ".mtl" else data

    return Resolver(str(file))


def _why_no_image(name: str, data: bytes) -> str:
    """Return the reason why Pillow cannot open bytes as an image; an empty string if it can. No pixel is decoded."""
    from PIL import Image

    if Path(name).suffix.lower() not in Image.registered_extensions():
        return ""
    try:
        mesh_images.opened(data).close()
    except OSError as error:
        return str(error)
    return ""


def _name_images(scene: trimesh.Scene, contents: dict[str, bytes], file: Path) -> None:
    """Store the name of each image's file in the image, for later warnings.

    In images of OBJ files, trimesh has already stored ``file_path``.
    """
    for image in _images(scene):
        stream = getattr(image, "fp", None)
        content = stream.getvalue() if isinstance(stream, io.BytesIO) else None
        names = [name for name, data in contents.items() if data == content]
        image.info.setdefault("file_path", names[0] if names else f"an image in {file.name}")


def _images(scene: trimesh.Scene) -> Iterator[Image.Image]:
    """Yield the base-colour images of a scene."""
    for geometry in scene.geometry.values():
        material = getattr(getattr(geometry, "visual", None), "material", None)
        for name in ("image", "baseColorTexture"):
            image = getattr(material, name, None)
            if image is not None:
                yield image
