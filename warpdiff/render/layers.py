"""Layers of a picture: shading normal, depth and geometry index where rays through pixel centres hit the mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.scene.camera_rays import rays_for

if TYPE_CHECKING:
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface


def layers_of(
    surface: Surface, view: View, names: tuple[str, ...], *, smooth: bool, device: wp.Device, threads: int
) -> dict[str, NDArray[Any]]:
    """Return a dictionary of the layers of a picture, which :attr:`warpdiff.Image.layers` describes."""
    rays = rays_for(surface, view, smooth=smooth, device=device, threads=threads)
    rays.launch(rays.trace(0, 1))
    pixels = rays.gbuffer.pixels
    hit, face, place, normal = (getattr(pixels, name).numpy() for name in ("hit", "face", "place", "normal"))
    hit, face, place = hit != 0, face[hit != 0], place[hit != 0].astype(np.float64)
    shape = (view.height, view.width)
    result: dict[str, NDArray[Any]] = {}
    for name in names:
        if name == "normal":
            result[name] = np.where(hit[:, None], normal, np.float32(0.0)).reshape(*shape, 3)
        elif name == "depth":
            depth = np.full(hit.shape, np.inf, dtype=np.float32)
            depth[hit] = _distances(surface, view, face, place)
            result[name] = depth.reshape(shape)
        else:
            geometry = np.full(hit.shape, -1, dtype=np.int32)
            geometry[hit] = surface.geometries[face]
            result[name] = geometry.reshape(shape)
    return result


def _distances(
    surface: Surface, view: View, face: NDArray[np.int32], place: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances from the camera to points on faces, in mesh units, shape (n,).

    ``place`` has the barycentric coordinates of each point for the first two corners of its face, shape (n, 2).
    """
    barycentric = np.column_stack([place, 1.0 - place.sum(axis=1)])
    corners = surface.vertices[surface.faces[face]].astype(np.float64)
    points = np.einsum("nk,nkc->nc", barycentric, corners) * surface.radius + surface.centre
    frame = view.frame()
    if frame.orthographic:
        return np.asarray((frame.origin - points) @ frame.back)
    return np.asarray(np.linalg.norm(points - frame.origin, axis=1))
