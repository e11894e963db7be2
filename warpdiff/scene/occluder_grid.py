"""Occluder grids: lists of the faces that may occlude a directional light.

Shadow rays use such a grid, or a hierarchy (tree of bounding boxes of all faces). The faces are projected onto a plane
perpendicular to the light. The plane is divided into square cells, and each cell has the list of the faces that overlap
it.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import single_threaded_blas
from warpdiff.device.kernel_calls import launch
from warpdiff.kernels import shadow_rays

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.scene.device_mesh import SceneArrays
    from warpdiff.scene.mesh_import import Surface

# Limits above which a hierarchy (tree of bounding boxes) is used instead of a grid. `_MOST_CELLS` is the mean number of
# cells that a face overlaps. `_MOST_LISTED` is the mean length of the cells' lists of faces, weighted by their length.
# Meshes whose faces have very different sizes exceed these limits, and a hierarchy is then faster.
_MOST_CELLS, _MOST_LISTED = 16, 48
# Number of faces that a CPU thread processes at once (a slice). Other values would change only the time.
_SLICE = 4096


def no_grid(scene: SceneArrays) -> shadow_rays.ShadowGrid:
    """Return an empty occluder grid, with which shadow rays use the hierarchy of the faces' bounding boxes."""
    grid = shadow_rays.ShadowGrid()
    grid.mesh_id = scene.with_hierarchy().mesh_id
    return grid


def grid_for(
    surface: Surface, scene: SceneArrays, to_light: Sequence[float], *, device: wp.Device, threads: int
) -> shadow_rays.ShadowGrid:
    """Return the occluder grid (lists of faces that may block a light) for a light's direction, from a cache, on a CPU.

    If faces have very uneven sizes, the lists of a few grid cells would contain most of the faces. The grid is then
    empty.
    """
    make = functools.partial(_made, surface, scene, to_light, device=device, threads=threads)
    return scene.grids.get_or_make(tuple(to_light), make)


def _made(
    surface: Surface, scene: SceneArrays, to_light: Sequence[float], *, device: wp.Device, threads: int
) -> shadow_rays.ShadowGrid:
    towards = np.array(to_light)
    across = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
    across /= np.linalg.norm(across)
    up = np.cross(towards, across)
    with single_threaded_blas():
        projected = np.stack([across, up]) @ surface.vertices.T * float(shadow_rays.STEPS)
    # Projected positions are rounded to steps of 1/STEPS of the mesh's radius, and the kernel and NumPy round
    # differently. A margin of two steps keeps the positions inside the grid.
    low, high = np.floor(projected.min(axis=1)) - 2.0, np.ceil(projected.max(axis=1)) + 2.0
    wide, tall = high - low
    faces = len(surface.faces)
    # Side of a square grid cell. It is chosen so that the grid has about as many cells as the mesh has faces.
    side = max(math.sqrt(wide * tall / faces), max(wide, tall) / faces)
    grid = shadow_rays.ShadowGrid()
    grid.across, grid.up, grid.towards = wp.vec3d(*across), wp.vec3d(*up), wp.vec3d(*towards)
    grid.low_x, grid.low_y, grid.per_step = low[0], low[1], 1.0 / side
    grid.columns, grid.rows = int(wide / side) + 1, int(tall / side) + 1
    grid.is_closed = surface.is_closed
    grid.corners = wp.empty(faces, dtype=wp.mat33f, device=device)
    options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _SLICE, "in_runs": True}
    spans = wp.empty(faces, dtype=wp.int32, device=device)
    launch(shadow_rays.project, faces, [grid, scene.bare.positions, scene.bare.faces], [spans], **options)
    listed = int(spans.numpy().sum(dtype=np.int64))
    if listed > _MOST_CELLS * faces:
        return no_grid(scene)
    counts = wp.zeros(grid.columns * grid.rows, dtype=wp.int32, device=device)
    launch(shadow_rays.count, faces, [grid], [counts], **options)
    face_counts = counts.numpy().astype(np.int64)
    if face_counts @ face_counts > _MOST_LISTED * listed:
        return no_grid(scene)
    starts = np.concatenate([[0], np.cumsum(face_counts)]).astype(np.int32)
    grid.faces = wp.empty(listed, dtype=wp.int32, device=device)
    grid.tops = wp.empty(listed, dtype=wp.float32, device=device)
    counts.assign(starts[:-1])
    launch(shadow_rays.fill, faces, [grid], [counts], **options)
    grid.starts = wp.array(starts, dtype=wp.int32, device=device)
    return grid
