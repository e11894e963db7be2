"""G-buffers: hits of rays and the shading frames at the hits, independent of lights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warpdiff.kernels.structs import Pixels

# Names of the fields of the struct ``Pixels`` that store a vector of three floats per ray.
_VECTORS = ("tangent", "bitangent", "normal", "to_view", "shadow_origin")


@dataclass(frozen=True)
class GBuffer:
    """Hits of rays. The arrays are written by the kernel calls of :class:`~warpdiff.scene.camera_rays.CameraRays`.

    Attributes:
        pixels: The struct ``Pixels`` of the kernels, whose arrays have one entry per ray.
    """

    pixels: Pixels

    @classmethod
    def allocate(cls, rays: int, *, coloured: bool, has_maps: bool = False, device: wp.Device) -> GBuffer:
        """Return a G-buffer with uninitialised arrays for a number of rays.

        Args:
            rays: Number of rays.
            coloured: Whether the arrays include base colours.
            has_maps: Whether the arrays include metallic, roughness and emission from textures.
            device: The Warp device.
        """

        def empty(dtype: type, size: int = rays) -> wp.array:
            return wp.empty(size, dtype=dtype, device=device)

        pixels = Pixels()
        pixels.nearest = empty(wp.uint64)
        pixels.hit, pixels.face, pixels.place = empty(wp.int32), empty(wp.int32), empty(wp.vec2f)
        for name in _VECTORS:
            setattr(pixels, name, empty(wp.vec3f))
        pixels.base_colour = empty(wp.vec3f, rays * coloured)
        pixels.metallic_roughness = empty(wp.vec4f, rays * has_maps)
        pixels.emission = empty(wp.vec3f, rays * has_maps)
        return cls(pixels)

    @property
    def is_coloured(self) -> bool:
        """Whether the G-buffer includes the base colour at each hit."""
        return len(self.pixels.base_colour) > 0

    @property
    def has_maps(self) -> bool:
        """Whether the G-buffer includes metallic, roughness and emission of textures."""
        return len(self.pixels.emission) > 0

    @property
    def hit_count(self) -> int:
        """Number of rays that hit the mesh. The array of hits is copied to the host to count them."""
        return int(np.count_nonzero(self.pixels.hit.numpy()))
