"""Grids by which shadow rays find the few faces that may hide a light."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.device import launch

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.kernels.raycast import SurfaceArrays
    from warpdiff.surface import Surface

# Cells for each face, and what they list, for each face, at most: a mesh of more has long faces one above the other.
_CELLS, _MOST_LISTED = 2.0, 16
# Faces in the lists that faces are in, on average, beyond which a hierarchy is faster.
_MOST_IN_CELL = 48.0
# Faces that are sorted into a grid in the time of one shadow ray through the hierarchy.
_FACES_A_RAY = 2
# Faces of a slice.
_SLICE = 4096


def pays(faces: int, rays: int) -> bool:
    """Whether a grid over so many faces takes less than so many rays through the hierarchy."""
    return faces < _FACES_A_RAY * rays


def grid_for(
    surface: Surface, arrays: SurfaceArrays, to_light: tuple[float, float, float], *, device: wp.Device, threads: int
) -> Any:
    """The :class:`warpdiff.kernels.shadows.ShadowGrid` of a surface under a light on the CPU, or an empty one.

    It is empty for a mesh whose faces' sizes are too uneven: a few cells would list most of them.
    """
    import warp as wp

    from warpdiff.kernels import shadows

    towards = np.array(to_light)
    across = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
    across /= np.linalg.norm(across)
    up = np.cross(towards, across)
    seen = surface.vertices @ np.stack([across, up], axis=1) * float(shadows.STEPS)
    # What a kernel rounds otherwise is within a step or two.
    low, high = np.floor(seen.min(axis=0)) - 2.0, np.ceil(seen.max(axis=0)) + 2.0
    wide, tall = high - low
    faces = len(surface.faces)
    side = max(math.sqrt(wide * tall / (_CELLS * faces)), max(wide, tall) / (_CELLS * faces))
    grid = shadows.ShadowGrid()
    grid.across, grid.up, grid.towards = wp.vec3d(*across), wp.vec3d(*up), wp.vec3d(*towards)
    grid.low_x, grid.low_y, grid.per_step = low[0], low[1], 1.0 / side
    grid.columns, grid.rows = int(wide / side) + 1, int(tall / side) + 1
    grid.corners = wp.empty(faces, dtype=wp.mat33f, device=device)
    options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _SLICE, "in_runs": True}
    spans = wp.empty(faces, dtype=wp.int32, device=device)
    launch(shadows.project, faces, [grid, arrays.positions, arrays.faces], [spans], **options)
    listed = int(spans.numpy().sum(dtype=np.int64))
    if listed > _MOST_LISTED * faces:
        return shadows.ShadowGrid()
    counts = wp.zeros(grid.columns * grid.rows, dtype=wp.int32, device=device)
    launch(shadows.count, faces, [grid], [counts], **options)
    found = counts.numpy().astype(np.int64)
    if found @ found > _MOST_IN_CELL * listed:
        return shadows.ShadowGrid()
    starts = np.concatenate([[0], np.cumsum(found)]).astype(np.int32)
    grid.faces = wp.empty(listed, dtype=wp.int32, device=device)
    grid.tops = wp.empty(listed, dtype=wp.float32, device=device)
    counts.assign(starts[:-1])
    launch(shadows.fill, faces, [grid], [counts], **options)
    grid.starts = wp.array(starts, dtype=wp.int32, device=device)
    return grid
