"""Mesh files: read by trimesh, with a word on whatever they name that cannot be had."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdiff.core import validation
from warpdiff.core.warnings import warn

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    import trimesh
    from PIL import Image


def load(path: str | os.PathLike[str]) -> trimesh.Scene:
    """Read a mesh file, and what it names in its own folder; what lies elsewhere is not opened.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It cannot be read.
    """
    import trimesh

    file = validation.path(path, "mesh")
    if not file.exists():
        raise FileNotFoundError(f"mesh: there is no file {str(file)!r}")
    found: dict[str, bytes] = {}
    lost: dict[str, str] = {}
    try:
        # process=False: merging vertices would tear the texture along its seams.
        scene = trimesh.load_scene(file, process=False, resolver=_resolver(file, found, lost))
    except Exception as error:
        # trimesh's loaders raise whatever their parser happened to stumble over.
        raise ValueError(
            f"mesh must be a file that trimesh can read, got {str(file)!r}, which is damaged, cut off or of another "
            f"kind: {error}"
        ) from error
    if file.suffix.lower() == ".stl":
        # Of several bodies trimesh merges vertices all the same: their faces would be smooth.
        for geometry in scene.geometry.values():
            geometry.unmerge_vertices()
    for name, data in found.items():
        reason = _why_no_image(name, data)
        if reason:
            lost[name] = reason
    for name, reason in lost.items():
        warn(f"mesh: {str(file)!r} names {name!r}, which is left out: {reason}")
    for image in _images(scene):
        # Where it is found to be damaged once it is decoded: OBJ files' images tell their names themselves.
        stream = getattr(image, "fp", None)
        held = stream.getvalue() if isinstance(stream, io.BytesIO) else None
        names = [name for name, data in found.items() if data == held]
        image.info.setdefault("file_path", names[0] if names else f"an image in {file.name}")
    return scene


def _resolver(file: Path, found: dict[str, bytes], lost: dict[str, str]) -> Any:
    """A resolver of the files that a mesh names, which notes what was ``found`` and why others were ``lost``."""
    from trimesh.resolvers import FilePathResolver

    class Resolver(FilePathResolver):  # type: ignore[misc]
        def get(self, name: str) -> bytes:
            try:
                data: bytes = super().get(name)
            except FileNotFoundError:
                lost[name] = "there is no such file"
                raise
            except (OSError, ValueError) as error:
                outside = not isinstance(error, OSError)
                lost[name] = "it lies outside of the mesh's folder" if outside else str(error)
                raise
            found[name] = data
            return data

    return Resolver(str(file))


def _why_no_image(name: str, data: bytes) -> str:
    """Why what is called an image cannot be opened as one, or nothing; pixels are not yet decoded."""
    from PIL import Image

    if Path(name).suffix.lower() not in Image.registered_extensions():
        return ""
    try:
        with Image.open(io.BytesIO(data)):
            return ""
    except Image.DecompressionBombError as error:
        return str(error)
    except Exception:
        return "it is no image that Pillow can read"


def _images(scene: trimesh.Scene) -> Iterator[Image.Image]:
    """The base colours' images of a scene."""
    for geometry in scene.geometry.values():
        material = getattr(getattr(geometry, "visual", None), "material", None)
        for name in ("image", "baseColorTexture"):
            image = getattr(material, name, None)
            if image is not None:
                yield image
