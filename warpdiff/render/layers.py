"""Layers of a picture: values where rays through pixel centres hit the mesh, and directions of the lights there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import forks
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.lights.base import LobeChoice, LobeSet
from warpdiff.request.layer_formats import layer_format

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.base import Light, LightPart
    from warpdiff.render.picture import Picture
    from warpdiff.scene.camera_rays import CameraRays
    from warpdiff.scene.mesh_import import Surface

# Name of the layer (additional array of a picture) with the colours under each single light. These colours are computed
# like the picture itself. All other layers have values of the rays through pixel centres.
LIGHT = "light"


def expanded(names: Sequence[str], lights: Sequence[Light], parts: Sequence[LightPart]) -> tuple[str, ...]:
    """Return the names of a picture's layers. A name such as ``"light"`` is replaced by one name for each light.

    A layer is an additional array of a picture, such as the depths of its pixels.

    Args:
        names: Names that the caller gave; each name has been checked.
        lights: Lights of the picture.
        parts: Parts of these lights (lobes, discs and skies) as a picture without layers renders them.

    Raises:
        ValueError: A name has an index that no light has, or the picture cannot separate its lights.
    """
    result: dict[str, None] = {}
    for name in names:
        base, _, index = name.partition(".")
        if not layer_format(base).by_light:
            result[name] = None
            continue
        if index and int(index) >= len(lights):
            raise ArgumentValueError(
                f"{ref('layers')} must name one of the {ref('lights')}, {base}.0 to {base}.{len(lights) - 1}, got "
                f"{name!r}"
            )
        if base == LIGHT and any(isinstance(part, LobeChoice) for part in parts):
            raise ArgumentValueError(
                f"{ref('layers')} must not have {LIGHT!r} for {len(lights)} {ref('lights')}, of which each subpixel "
                f"cell chooses one, got {name!r}: give {ref('refine', False)}, which renders every light"
            )
        result |= dict.fromkeys([name] if index else [f"{base}.{light}" for light in range(len(lights))])
    return tuple(result)


def directed(parts: Sequence[LightPart], name: str) -> LobeSet:
    """Return a set of one lobe, which is the single or mean direction of a light.

    Args:
        parts: Parts of the light.
        name: Name of the layer that requires the direction, for the error.

    Raises:
        ValueError: The light has no single direction.
    """
    if len(parts) == 1 and isinstance(parts[0], LobeSet) and len(parts[0].lobes) == 1:
        return LobeSet(parts[0].lobes)
    base, _, index = name.partition(".")
    raise ArgumentValueError(
        f"{ref('layers')} must not have {name!r}, because {ref(f'lights[{index}]')} has no single direction: name only "
        f"lights with one, such as '{base}.0'"
    )


class CentralHits:
    """Hits of the rays through the centres of all pixels.

    Attributes:
        surface: The prepared mesh.
        hit: Whether the ray of each pixel hits the mesh, shape (n,).
    """

    def __init__(self, rays: CameraRays) -> None:
        self.surface: Surface = rays.surface
        self._view, self._pixels = rays.view, rays.gbuffer.pixels
        self.hit: NDArray[np.bool_] = self._pixels.hit.numpy() != 0

    @forks.cached_property
    def faces(self) -> NDArray[np.int32]:
        """Indices of the faces that are hit, shape (hits,)."""
        return np.asarray(self._pixels.face.numpy()[self.hit])

    @forks.cached_property
    def _barycentric(self) -> NDArray[np.float64]:
        place = self._pixels.place.numpy()[self.hit].astype(np.float64)
        return np.column_stack([place, 1.0 - place.sum(axis=1)])

    def interpolated(self, values: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return values that are given at vertices, interpolated at the hits, shape (hits, components)."""
        corners = values[self.surface.faces[self.faces]].astype(np.float64)
        return np.asarray(np.einsum("nk,nkc->nc", self._barycentric, corners))

    def vectors(self, name: str) -> NDArray[np.float32]:
        """Return vectors of the G-buffer (arrays of the rays' hits) by the name of the array, shape (hits, 3)."""
        return np.asarray(getattr(self._pixels, name).numpy()[self.hit])

    @forks.cached_property
    def positions(self) -> NDArray[np.float64]:
        """Positions of the hits, world frame, shape (hits, 3)."""
        return self.interpolated(self.surface.vertices) * self.surface.radius + self.surface.centre

    def depths(self) -> NDArray[np.float64]:
        """Return the distances of the hits from the camera along the rays, in mesh units, shape (hits,)."""
        frame = self._view.frame()
        if frame.orthographic:
            return np.asarray((frame.origin - self.positions) @ frame.back)
        return np.asarray(np.linalg.norm(self.positions - frame.origin, axis=1))

    def base_colours(self) -> NDArray[np.float32]:
        """Return the linear base colours at the hits, shape (hits, 3); black if the mesh has none."""
        has_colour = self.surface.has_base_colour
        return self.vectors("base_colour") if has_colour else np.zeros((len(self.faces), 3), dtype=np.float32)

    def local(self, directions: NDArray[np.float32 | np.float64]) -> NDArray[np.float64]:
        """Return unit vectors in the local frame for directions in the world frame at the hits, both (hits, 3)."""
        axes = np.stack([self.vectors(name) for name in ("tangent", "bitangent", "normal")], axis=1).astype(np.float64)
        local = np.einsum("nac,nc->na", axes, directions)
        return np.asarray(local / np.linalg.norm(local, axis=1, keepdims=True))

    def to_view(self) -> NDArray[np.float64]:
        """Return unit vectors to the viewer in the local frame, shape (hits, 3)."""
        return self.local(self.vectors("to_view"))


# Functions that return the values of layers (additional arrays of a picture, such as depths), by the layer's name.
# Layers that depend on lights, or that show numbers of geometries or materials, have no entry.
VALUES: dict[str, Callable[[CentralHits], NDArray[Any]]] = {
    "normal": lambda hits: hits.vectors("normal"), "tangent": lambda hits: hits.vectors("tangent"),
    "bitangent": lambda hits: hits.vectors("bitangent"), "depth": CentralHits.depths,
    "position": lambda hits: hits.positions, "albedo": CentralHits.base_colours,
    "uv": lambda hits: hits.interpolated(hits.surface.uvs), "to_view": CentralHits.to_view,
}  # fmt: skip


def lights_of(names: Sequence[str]) -> dict[int, str]:
    """Return the indices of the lights whose directions layers show, each with the name of such a layer.

    A layer is an additional array of a picture, such as the directions to one light at its pixels.
    """
    directions = {
        int(index): name for name in names for base, _, index in [name.partition(".")] if index and base != LIGHT
    }
    return dict(sorted(directions.items()))


def layers_of(picture: Picture, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the layers (arrays such as depths and normals) of a picture with one ray per pixel, by name.

    Args:
        picture: Picture of points (single directions), one ray per pixel. Its lights are the results of
            :func:`directed` for the lights of :func:`lights_of`.
        names: Names of the layers, as :func:`expanded` returns them, without layers of the light.
    """
    picture.sampler.trace(0)
    hits, shape = CentralHits(picture.rays), (picture.view.height, picture.view.width)
    lights = list(lights_of(names))
    result: dict[str, NDArray[Any]] = {}
    for name in names:
        base, _, index = name.partition(".")
        layer = layer_format(base)
        values = np.full((hits.hit.size, len(layer.channels)), layer.empty)
        if layer.by_light:
            scattering_vectors, to_lights, gains = picture.directions_to(lights.index(int(index)))
            reached = gains > 0.0
            values[reached] = (to_lights if base == "to_light" else scattering_vectors)[reached]
        else:
            of_hits = getattr(hits.surface, layer.faces)[hits.faces] if layer.faces else VALUES[base](hits)
            values[hits.hit] = of_hits.reshape(len(hits.faces), -1)
        result[name] = layer.shaped(values, shape)
    return result


def names_of(surface: Surface, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the names (of geometries or materials) for which the numbers in layers stand, by the layer's name.

    A layer is an additional array of a picture, such as the number of the visible geometry.
    """
    return {name: getattr(surface, attribute) for name in names if (attribute := layer_format(name).names)}
