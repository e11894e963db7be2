"""Meshes and cameras on a Warp device, in the structs that kernels read.

Rays find the faces that they hit by a bounding volume hierarchy of the faces ("hierarchy" below). An occluder grid
lists the faces that may block one light; shadow rays use it instead of the hierarchy. A face is plain if its part of
the mesh has no height field.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.core import forks
from warpdiff.core.caching import LruCache
from warpdiff.kernels.structs import Camera, SurfaceArrays, Textures, Transparency
from warpdiff.scene.texture_table import table_of

if TYPE_CHECKING:
    from warpdiff.kernels.shadow_rays import ShadowGrid
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface


# Largest number of faces per leaf of a bounding volume hierarchy on the CPU. The value changes the time that rays
# require, not their hits.
_LEAF = 4
# Lock that is held while a bounding volume hierarchy is built, so that two threads do not build that of the same mesh.
_once = forks.lock()
_cached: weakref.WeakKeyDictionary[Surface, LruCache[SceneArrays]] = weakref.WeakKeyDictionary()
# Number of cached occluder grids per mesh. A grid lists the faces that may block light from one direction. The grids
# for the last light directions remain in the cache. The number is limited by memory: a grid requires about 72 bytes per
# face.
_MOST_GRIDS = 4


class SceneArrays:
    """Arrays of a :class:`~warpdiff.scene.mesh_import.Surface` on a device.

    Kernels refer to the mesh by an id only. Keep this object until all launches that use the id have finished.

    Attributes:
        bare: The mesh as a struct for kernels. It has a hierarchy of faces (tree of bounding boxes) only after the
            first call of :meth:`with_hierarchy`.
        textures: Textures as a struct for kernels; empty if there are no textures.
        transparency: Transparency as a struct for kernels; empty if all faces are opaque.
        is_textured: Whether any base colour is that of a texture.
        is_opaque: Whether no ray passes through a face.
        has_maps: Whether any face without a height field has a texture of metallic, roughness or emission.
        face_count: Number of faces.
        grids: Cache of occluder grids (lists of the faces that may block a light), by the direction to the light.
    """

    def __init__(self, surface: Surface, *, smooth: bool = True, device: wp.DeviceLike = None) -> None:
        """Copy the arrays of a prepared mesh (surface) to a device.

        If ``smooth`` is False, kernels use face normals instead of vertex normals.
        """
        colours = np.zeros((0, 3), np.float32) if surface.vertex_colours is None else surface.vertex_colours
        arrays = SurfaceArrays()
        for name, values, dtype in (
            ("positions", surface.vertices, wp.vec3f), ("faces", surface.faces, wp.int32),
            ("normals", surface.normals, wp.vec3f), ("tangents", surface.tangents, wp.vec3f),
            ("handedness", surface.handedness, wp.float32), ("uvs", surface.uvs, wp.vec2f),
            ("vertex_colours", colours, wp.vec3f),
        ):  # fmt: skip
            setattr(arrays, name, wp.array(values, dtype=dtype, device=device))
        arrays.plain_colour = wp.vec3f(*surface.plain_colour)
        arrays.smooth = bool(smooth)
        self.face_count = len(surface.faces)
        self.bare = arrays
        self.is_textured, self.is_opaque, self.has_maps = surface.is_textured, surface.is_opaque, surface.has_maps
        self.textures, self.transparency = Textures(), Transparency()
        if surface.is_textured or surface.has_maps or not surface.is_opaque:
            self.textures = table_of(surface.textures, surface.rows, device, surface.maps)
        if surface.maps is not None:
            for name in ("metallic_roughness_uvs", "emission_uvs"):
                uvs = getattr(surface.maps, name)
                array = arrays.uvs if uvs is None else wp.array(uvs, dtype=wp.vec2f, device=device)
                setattr(self.textures, name, array)
        if not surface.is_opaque:
            self.transparency.cutoffs = wp.array(surface.alpha_cutoffs, dtype=wp.float32, device=device)
            alphas = np.zeros(0, np.float32) if surface.vertex_alphas is None else surface.vertex_alphas
            self.transparency.vertex_alphas = wp.array(alphas, dtype=wp.float32, device=device)
        self._mesh: wp.Mesh | None = None
        self.grids: LruCache[ShadowGrid] = LruCache(_MOST_GRIDS)

    def with_hierarchy(self) -> SurfaceArrays:
        """Return the mesh as a struct for kernels, with a bounding volume hierarchy, which the first call builds."""
        with _once:
            if self._mesh is None:
                # On the CPU, Warp's builder "cubql" makes a bounding volume hierarchy in half the time of the default
                # builder.
                constructor, leaf = ("cubql", _LEAF) if self.bare.positions.device.is_cpu else (None, None)
                self._mesh = wp.Mesh(
                    points=self.bare.positions, indices=self.bare.faces.flatten(), bvh_constructor=constructor,
                    bvh_leaf_size=leaf,
                )  # fmt: skip
                self.bare.mesh_id = self._mesh.id
        return self.bare


def arrays_for(surface: Surface, *, smooth: bool, device: wp.DeviceLike) -> SceneArrays:
    """Return the arrays of a prepared mesh (surface) on a device. They are cached as long as the mesh exists."""
    scenes = _cached.setdefault(surface, LruCache())
    return scenes.get_or_make((str(device), smooth), lambda: SceneArrays(surface, smooth=smooth, device=device))


def camera(view: View, surface: Surface, *, axes: wp.array, margin: int = 0) -> Camera:
    """Return the struct :class:`warpdiff.kernels.structs.Camera` of a view, in the units of the surface.

    The camera has ``margin`` additional pixels on each side. The function writes the camera's origin and axes to the
    array ``axes``, (5,) of ``wp.vec3d``.
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
    """Return whether shadow rays are required.

    They are not required for a convex body that is viewed from outside: each visible point that faces a light is
    illuminated by it, because no face is between the point and the light.
    """
    if not (surface.is_convex and surface.is_opaque):
        return True
    frame = view.frame()
    eye = (frame.origin - surface.centre) / surface.radius
    vertices = surface.vertices.astype(np.float64)
    if frame.orthographic:
        # Orthographic rays start on a plane. If a vertex is behind the plane, the plane may intersect the body, so that
        # the inside of the body is visible.
        return bool(np.max(vertices @ frame.back) > eye @ frame.back)
    a, b, c = (vertices[surface.faces[:, k]] for k in range(3))
    return not np.any(np.einsum("ij,ij->i", np.cross(b - a, c - a), eye - a) > 0.0)
