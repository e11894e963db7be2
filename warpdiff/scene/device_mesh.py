"""Meshes and cameras on a Warp device, in the structs of the ray kernels."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.core import forks
from warpdiff.core.caching import LruCache
from warpdiff.kernels.structs import Camera, SurfaceArrays

if TYPE_CHECKING:
    from warpdiff.kernels.shadow_rays import ShadowGrid
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface


# Number of faces per leaf of a hierarchy on the CPU. Limit: other values change the time of rays, not their hits.
_LEAF = 4
# A hierarchy is built once, by one thread.
_once = forks.lock()
_cached: weakref.WeakKeyDictionary[Surface, LruCache[SceneArrays]] = weakref.WeakKeyDictionary()
# Number of cached grids, for the last lights. Limit: memory.
_MOST_GRIDS = 4


class SceneArrays:
    """A :class:`~warpdiff.scene.mesh_import.Surface` on a device.

    The kernels know the mesh only by its number, so this object must outlive every launch that uses it.

    Attributes:
        bare: The struct for kernels; it has a hierarchy after the first call of :meth:`with_hierarchy`.
        face_count: Number of faces.
        grids: The last lights' grids for shadow rays.
    """

    def __init__(self, surface: Surface, *, smooth: bool = True, device: wp.DeviceLike = None) -> None:
        """Copy the arrays to the device; unless ``smooth``, every face shows its own normal, not the vertices'."""
        colours = np.zeros((1, 3), np.float32) if surface.vertex_colours is None else surface.vertex_colours
        arrays = SurfaceArrays()
        for name, values, dtype in (
            ("positions", surface.vertices, wp.vec3f), ("faces", surface.faces, wp.int32),
            ("normals", surface.normals, wp.vec3f), ("tangents", surface.tangents, wp.vec3f),
            ("handedness", surface.handedness, wp.float32), ("uvs", surface.uvs, wp.vec2f),
            ("vertex_colours", colours, wp.vec3f), ("texture", surface.texture, wp.vec3f),
        ):  # fmt: skip
            setattr(arrays, name, wp.array(values, dtype=dtype, device=device))
        arrays.has_vertex_colours = surface.vertex_colours is not None
        arrays.smooth = bool(smooth)
        self.face_count = len(surface.faces)
        self.bare = arrays
        self._mesh: wp.Mesh | None = None
        self.grids: LruCache[ShadowGrid] = LruCache(_MOST_GRIDS)

    def with_hierarchy(self) -> SurfaceArrays:
        """Return the struct with a hierarchy, which is built once."""
        with _once:
            if self._mesh is None:
                # On the CPU this constructor takes half the time of the default one.
                constructor, leaf = ("cubql", _LEAF) if self.bare.positions.device.is_cpu else (None, None)
                self._mesh = wp.Mesh(
                    points=self.bare.positions, indices=self.bare.faces.flatten(), bvh_constructor=constructor,
                    bvh_leaf_size=leaf,
                )  # fmt: skip
                self.bare.mesh_id = self._mesh.id
        return self.bare


def arrays_for(surface: Surface, *, smooth: bool, device: wp.DeviceLike) -> SceneArrays:
    """Return the cached arrays of a surface."""
    scenes = _cached.setdefault(surface, LruCache())
    return scenes.get_or_make((str(device), smooth), lambda: SceneArrays(surface, smooth=smooth, device=device))


def camera(view: View, surface: Surface, *, axes: wp.array, margin: int = 0) -> Camera:
    """The :class:`warpdiff.kernels.structs.Camera` of a view, in the units of the surface.

    It has a ``margin`` of so many more pixels on each side. Its ``axes``, (5,) of ``wp.vec3d``, are set.
    """
    frame = view.frame()
    result = Camera()
    scale = surface.radius if frame.orthographic else 1.0
    result.width, result.height = view.width + 2 * margin, view.height + 2 * margin
    halves = (
        frame.half_width / scale * (result.width / view.width),
        frame.half_height / scale * (result.height / view.height),
        0.0,
    )
    origin = (frame.origin - surface.centre) / surface.radius
    axes.assign(np.array([origin, frame.right, frame.up, frame.back, halves]))
    result.axes = axes
    result.orthographic = frame.orthographic
    return result


def needs_shadow_rays(surface: Surface, view: View) -> bool:
    """Return whether any visible point could be shadowed; on a convex body viewed from outside none can."""
    if not surface.is_convex:
        return True
    frame = view.frame()
    eye = (frame.origin - surface.centre) / surface.radius
    vertices = surface.vertices.astype(np.float64)
    if frame.orthographic:
        # Rays leave from a plane, which must not cut the body.
        return bool(np.max(vertices @ frame.back) > eye @ frame.back)
    a, b, c = (vertices[surface.faces[:, k]] for k in range(3))
    return not np.any(np.einsum("ij,ij->i", np.cross(b - a, c - a), eye - a) > 0.0)
