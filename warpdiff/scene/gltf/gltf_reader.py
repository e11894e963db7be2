"""Reading of glTF 2.0 files into parts of a scene, each with the triangles of one mesh and one material.

One warning per file names the features of the file that are not read, such as skins.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from warpdiff.core import memory
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, listed, ref
from warpdiff.scene.gltf import gltf_nodes
from warpdiff.scene.gltf.gltf_accessors import Accessors
from warpdiff.scene.gltf.gltf_buffers import Container
from warpdiff.scene.gltf.gltf_materials import Materials
from warpdiff.scene.gltf.gltf_meshes import BYTES_PER_CORNER, Meshes

if TYPE_CHECKING:
    from pathlib import Path

    from warpdiff.scene.gltf.gltf_values import Element
    from warpdiff.scene.scene_parts import ScenePart

# Names of glTF extensions that a file may require, apart from those of materials. Some extensions are read. Some do not
# change triangles, texture coordinates and base colours. For the others, a warning names the objects of the file that
# use them.
_ACCEPTED = {
    "EXT_lights_ies", "EXT_lights_image_based", "EXT_mesh_gpu_instancing", "EXT_texture_avif", "EXT_texture_webp",
    "KHR_animation_pointer", "KHR_draco_mesh_compression", "KHR_lights_punctual", "KHR_mesh_quantization",
    "KHR_node_visibility", "KHR_texture_basisu", "KHR_texture_transform", "KHR_xmp", "KHR_xmp_json_ld",
    "MSFT_texture_dds",
}  # fmt: skip


def load(file: Path) -> list[ScenePart]:
    """Return the parts of a file's scene: triangles with their attributes, transform and material.

    Raises:
        MemoryError: The triangles do not fit into memory.
        ValueError: The file is damaged, or requires an extension that is not supported.
    """
    container = Container(file)
    _check_version(container.root)
    accessors, materials = Accessors(container), Materials(container)
    meshes = Meshes(container, accessors, materials)
    placements = list(gltf_nodes.placements(container.root, len(meshes), accessors))
    corners = sum(meshes.size(placement.mesh) * len(placement.matrices) for placement in placements)
    memory.require_memory(BYTES_PER_CORNER * corners, f"a mesh of {corners // 3} faces", "use a smaller one")
    parts: list[ScenePart] = []
    for placement in placements:
        read = meshes.parts(placement.mesh, placement.weights)
        parts += [replace(part, transform=matrix) for matrix in placement.matrices for part in read]
        if placement.is_skinned:
            meshes.not_read[f"skin of node {placement.node!r}, shown where its vertices are in the file"] = None
    for name, reason in materials.ignored.items():
        warn(f"{ref('mesh')}: {str(file)!r} refers to {name!r}, which is ignored: {reason}")
    _warn_of_parts_not_read(file, [*meshes.not_read, *materials.not_read])
    return parts


def _check_version(root: Element) -> None:
    """Raise an error for a glTF version other than 2, and for required extensions that are not supported."""
    version = root.stated_element("asset").text("version")
    if not version.startswith("2"):
        raise ArgumentValueError(f"{ref('mesh')} must be glTF of version 2.0, got version {version[:20]!r}")
    required = root.texts("extensionsRequired")
    unknown = sorted({name for name in required if name not in _ACCEPTED and not name.startswith("KHR_materials_")})
    if unknown:
        names = ", ".join(unknown[:5])
        plural = "s" if len(unknown) > 1 else ""
        raise ArgumentValueError(
            f"{ref('mesh')} requires the glTF extension{plural} {names[:200]}, not supported here; export it without"
        )


def _warn_of_parts_not_read(file: Path, names: list[str]) -> None:
    """Warn once of all features of a file that are not read; ``names`` names these features."""
    if names:
        listing = listed(names, "; ", "; and {} more")
        warn(f"{ref('mesh')}: {str(file)!r} has parts that are not read: {listing}")
