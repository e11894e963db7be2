"""Bodies of the viewer: meshes and height fields from the disk cache, cameras, and local directions at a pixel."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff.core import disk_cache
from warpdiff.render.layers import CentralHits
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import Surface, prepare_surface

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import warp as wp

    from warpdiff.apps.viewer.page_calls import Call, PageRequest
    from warpdiff.request.settings import TangentRule

# Vertical field of view of the initial camera [degrees]. A small angle was chosen because a wide one distorts the mesh.
_FOV_Y_DEG = 25.0
# Direction from the mesh to the initial camera, a unit vector in the world frame.
_TOWARDS_EYE = (0.0, 0.6, 0.8)


def surface_of(mesh: Call | Path, tangents: TangentRule | None) -> Surface:
    """Return the prepared mesh (surface) of a mesh file or of a sample mesh (body).

    Sample bodies are stored in the disk cache, because making one requires more time than rendering a picture.

    Args:
        mesh: Path of a mesh file, or the call that makes a sample body.
        tangents: Rule for the direction of the height field's x axis; None uses the texture coordinates.
    """
    if not hasattr(mesh, "make"):
        return prepare_surface(str(mesh), tangents=tangents)

    # The disk cache stores only arrays and numbers. The names and materials of a sample body are not stored, because
    # every sample body is a single mesh of one matte, opaque material without a texture.
    left_out = ("geometry_names", "material_names", "material_factors", "textures", "alpha_cutoffs")
    fields = {field.name: None for field in dataclasses.fields(Surface) if field.name not in left_out}

    def arrays() -> dict[str, Any]:
        made = dataclasses.asdict(prepare_surface(mesh.make(), tangents=tangents))
        return {name: made[name] for name in fields if made[name] is not None}

    cached = disk_cache.cached_on_disk(("surface", tuple(fields), str(mesh), tangents), np.zeros(0), arrays)
    plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in cached.items()}
    return Surface(**fields | plain)


def framed(surface: Surface, width: int, height: int) -> wd.View:
    """Return the initial view of a mesh, in which the mesh fills the picture."""
    view = wd.View.fit(surface, _TOWARDS_EYE, fov_y_deg=_FOV_Y_DEG, width=width, height=height)
    x, y, z = np.round(view.eye, 6).tolist()
    return dataclasses.replace(view, eye=(x, y, z), target=tuple(np.round(view.target, 6).tolist()))


class LocalDirections(NamedTuple):
    """Directions to the light and to the viewer in the local frame of a point, unit vectors."""

    to_light: tuple[float, ...]
    to_view: tuple[float, ...]


def local_directions(
    surface: Surface, view: wd.View, light: wd.DirectionalLight | wd.PointLight, column: int, row: int, *, smooth: bool,
    device: wp.Device, threads: int,
) -> LocalDirections | None:  # fmt: skip
    """Return the directions to light and viewer at the point where the ray through a pixel's centre hits the mesh.

    The directions are in the local frame of the point. Without a hit, the result is None.
    """
    frame = view.frame()
    x = frame.half_width * (2.0 * (column + 0.5) / view.width - 1.0)
    y = frame.half_height * (1.0 - 2.0 * (row + 0.5) / view.height)
    ray = x * frame.right + y * frame.up - frame.back
    # The hit point is computed by rendering a picture of one pixel, whose ray is the same as that of the given pixel.
    one = wd.View(
        view.eye, tuple((frame.origin + ray * np.linalg.norm(frame.origin - np.array(view.target))).tolist()),
        up=view.up, fov_y_deg=0.01, width=1, height=1,
    )  # fmt: skip
    rays = rays_for(surface, one, smooth=smooth, device=device, threads=threads)
    rays.launch(rays.trace(0, 1))
    hits = CentralHits(rays)
    if not hits.hit[0]:
        return None
    if isinstance(light, wd.PointLight):
        to_light = np.array([light.position]) - hits.positions
    else:
        to_light = np.array([light.to_light])
    return LocalDirections(tuple(hits.local(to_light)[0].tolist()), tuple(hits.to_view()[0].tolist()))


def nearest_pixel(mask: Any, probe: Sequence[float]) -> tuple[int, int] | None:
    """Return the pixel (column, row) of a mask that is nearest to a position, or None if the mask is empty.

    Args:
        mask: Boolean array of pixels.
        probe: Position in the picture, as fractions of its width from the left and of its height from the top, 0 to 1.
    """
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return None
    height, width = mask.shape
    nearest = int(np.argmin((columns + 0.5 - probe[0] * width) ** 2 + (rows + 0.5 - probe[1] * height) ** 2))
    return int(columns[nearest]), int(rows[nearest])


def angles_deg(direction: Sequence[float]) -> dict[str, float]:
    """Return the angles of a local unit vector from the normal and from the height field's x axis [degrees]."""
    x, y, z = direction
    theta, phi = np.degrees(np.arccos(np.clip(z, -1.0, 1.0))), np.degrees(np.arctan2(y, x))
    return {"theta_deg": float(theta), "phi_deg": float(phi)}


def height_field_of(call: Call) -> wd.HeightField:
    """Return the height field that a library call makes.

    Synthetic gratings are stored in the disk cache, because making the grating with nano-fingers requires half a
    second.
    """
    if not call.function.startswith("gratings."):
        result: wd.HeightField = call.make()
        return result

    def make() -> dict[str, Any]:
        heightfield = call.make()
        return {"heights_um": heightfield.heights_um, "pitch_um": np.array(heightfield.pitch_um)}

    arrays = disk_cache.cached_on_disk(("height field", str(call)), np.zeros(0), make)
    return wd.HeightField.of_known_scale(arrays["heights_um"], tuple(arrays["pitch_um"].tolist()))


def resting_view(request: PageRequest, body: Surface) -> wd.View:
    """Return the camera of a page's full-size picture: that of the request, or else the initial camera of the mesh."""
    height = request.values["height"]
    width = max(round(request.aspect * height), 1)
    if request.camera is None:
        return framed(body, width, height)
    return dataclasses.replace(request.camera, width=width, height=height)
