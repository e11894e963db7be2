"""Nodes of a glTF file: the meshes that its scene shows, and their positions."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.scene.gltf.gltf_values import refuse

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.gltf.gltf_accessors import Accessors
    from warpdiff.scene.gltf.gltf_values import Element

_INSTANCING = "EXT_mesh_gpu_instancing"


class Placement(NamedTuple):
    """Mesh of a node, and the matrices from the mesh's coordinates to the world, shape (k, 4, 4), one per instance."""

    node: str
    mesh: int
    matrices: NDArray[np.float64]
    weights: list[float] | None
    is_skinned: bool


def placements(root: Element, mesh_count: int, accessors: Accessors) -> Iterator[Placement]:
    """Yield the meshes of the default scene in the order of its nodes; if there is no scene, those of all nodes."""
    nodes = root.elements("nodes")
    children = [node.indices("children", len(nodes)) for node in nodes]
    visited: set[int] = set()
    stack = [(index, np.eye(4)) for index in reversed(_roots(root, children))]
    while stack:
        index, parent = stack.pop()
        node = nodes[index]
        if index in visited:
            refuse(node.place, "must have one parent, got two, or is its own ancestor")
        visited.add(index)
        with np.errstate(all="ignore"):  # vertices that are not finite are refused later
            world = parent @ _local(node)
        visibility = node.extension("KHR_node_visibility")
        if visibility is not None and not visibility.flag("visible", default=True):
            visited.update(_below(index, children))
            continue
        stack += [(child, world) for child in reversed(children[index])]
        mesh = node.index("mesh", mesh_count)
        if mesh is None:
            continue
        name = node.text("name") or node.place
        weights = node.numbers("weights") if "weights" in node else None
        yield Placement(name, mesh, _instances(node, world, accessors), weights, "skin" in node)


def _roots(root: Element, children: list[list[int]]) -> list[int]:
    """Return the nodes without a parent in the default scene; if there is no scene, those of the whole file."""
    scenes = root.elements("scenes")
    if scenes:
        return scenes[root.integer("scene", 0, most=len(scenes) - 1)].indices("nodes", len(children))
    below = {child for of_node in children for child in of_node}
    return [index for index in range(len(children)) if index not in below]


def _below(index: int, children: list[list[int]]) -> set[int]:
    """Return the indices of all descendants of a node."""
    below: set[int] = set()
    stack = list(children[index])
    while stack:
        child = stack.pop()
        if child not in below:
            below.add(child)
            stack += children[child]
    return below


def _local(node: Element) -> NDArray[np.float64]:
    """Return the matrix from a node's coordinates to those of its parent, shape (4, 4)."""
    if "matrix" in node:
        # glTF lists the elements of a matrix column by column.
        return np.array(node.numbers("matrix", np.eye(4).ravel().tolist())).reshape(4, 4).T
    return _composed(
        node.numbers("translation", (0.0, 0.0, 0.0)), node.numbers("rotation", (0.0, 0.0, 0.0, 1.0)),
        node.numbers("scale", (1.0, 1.0, 1.0)),
    )  # fmt: skip


def _composed(shift: Sequence[float], rotation: Sequence[float], scale: Sequence[float]) -> NDArray[np.float64]:
    """Return the matrix that scales, then rotates (quaternion x, y, z, w), and then shifts, shape (4, 4)."""
    quaternion = np.asarray(rotation, dtype=np.float64)
    length = float(np.linalg.norm(quaternion))
    x, y, z, w = quaternion / length if length > 0.0 else (0.0, 0.0, 0.0, 1.0)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.asarray(scale)
    matrix[:3, 3] = shift
    return matrix


def _instances(node: Element, world: NDArray[np.float64], accessors: Accessors) -> NDArray[np.float64]:
    """Return the matrices of the instances of a node's mesh, (k, 4, 4); without instances, there is one matrix."""
    instancing = node.extension(_INSTANCING)
    if instancing is None:
        return world[None]
    attributes = instancing.stated_element("attributes")
    values = {}
    for name, width in (("TRANSLATION", 3), ("ROTATION", 4), ("SCALE", 3)):
        index = attributes.index(name, len(accessors))
        if index is not None:
            values[name] = accessors.vectors(index, (width,))
    if not values:
        return world[None]
    counts = {len(array) for array in values.values()}
    if len(counts) > 1:
        refuse(attributes.place, f"must have accessors of one length, got {', '.join(map(str, sorted(counts)))}")
    count = counts.pop()
    shifts = values.get("TRANSLATION", np.zeros((count, 3)))
    rotations = values.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
    scales = values.get("SCALE", np.ones((count, 3)))
    with np.errstate(all="ignore"):  # vertices that are not finite are refused later
        matrices = [_composed(*parts) for parts in zip(shifts, rotations, scales, strict=True)]
        return np.asarray(world @ np.array(matrices))
