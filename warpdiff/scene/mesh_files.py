"""Mesh files, read by trimesh, with warnings about referenced files that cannot be read."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from warpdiff.core import validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, marked, ref

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    import trimesh
    from PIL import Image
    from trimesh.resolvers import FilePathResolver


def load(path: str | os.PathLike[str]) -> trimesh.Scene:
    """Read a mesh file and the files that it refers to in the same folder; files elsewhere are not opened.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file cannot be read.
    """
    import trimesh

    file = validation.path(path, "mesh")
    if not file.exists():
        raise marked(FileNotFoundError, f"the {ref('mesh')} file {str(file)!r} does not exist")
    contents: dict[str, bytes] = {}
    reasons: dict[str, str] = {}
    try:
        # With ``process=False``, trimesh does not merge vertices. Merging would break the texture along its seams.
        scene = trimesh.load_scene(file, process=False, resolver=_resolver(file, contents, reasons))
    except Exception as error:
        # For a damaged file, the loaders of trimesh raise errors of any type, so that all types are caught here.
        raise ArgumentValueError(
            f"{ref('mesh')} must be a file that trimesh can read, got {str(file)!r}, which is damaged, truncated or of "
            f"another format: {error}"
        ) from error
    if file.suffix.lower() == ".stl":
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
    for image in _images(scene):
        # The name of the image's file is stored for later warnings. In images of OBJ files, trimesh has already stored
        # ``file_path``.
        stream = getattr(image, "fp", None)
        content = stream.getvalue() if isinstance(stream, io.BytesIO) else None
        names = [name for name, data in contents.items() if data == content]
        image.info.setdefault("file_path", names[0] if names else f"an image in {file.name}")
    return scene


def _resolver(file: Path, contents: dict[str, bytes], reasons: dict[str, str]) -> FilePathResolver:
    """Return the object by which trimesh opens referenced files.

    It records their ``contents``, or ``reasons`` for failure.
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
            return data

    return Resolver(str(file))


def _why_no_image(name: str, data: bytes) -> str:
    """Return why Pillow cannot open the content of a file as an image, or an empty string. Pixels are not decoded."""
    from PIL import Image

    if Path(name).suffix.lower() not in Image.registered_extensions():
        return ""
    try:
        with Image.open(io.BytesIO(data)):
            return ""
    except Image.DecompressionBombError as error:
        return str(error)
    except Exception:
        return "Pillow cannot read it as an image"


def _images(scene: trimesh.Scene) -> Iterator[Image.Image]:
    """Yield the base-colour images of a scene."""
    for geometry in scene.geometry.values():
        material = getattr(getattr(geometry, "visual", None), "material", None)
        for name in ("image", "baseColorTexture"):
            image = getattr(material, name, None)
            if image is not None:
                yield image
