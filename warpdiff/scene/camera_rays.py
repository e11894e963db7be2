"""Camera rays: the faces that rays through the pixels of a picture hit.

The nearest face of a ray is found by rasterization, or by a bounding volume hierarchy of the faces ("hierarchy" below).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall, launch, launch_pipeline
from warpdiff.kernels import base_colours, bvh, plain_textures, primary_hits, refinement_levels, transparency
from warpdiff.kernels.structs import Cells, Sampling
from warpdiff.scene import device_mesh
from warpdiff.scene.gbuffer import GBuffer
from warpdiff.scene.occluder_grid import grid_for, no_grid

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.kernels.shadow_rays import ShadowGrid
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface

# Seed of the random positions of rays within pixels. Any constant makes pictures reproducible.
_SEED = 0
# Number of rays, and number of rasterized faces, that a CPU thread processes at once (a slice). The values were fitted
# so that a slice requires about 1 ms.
RAYS_OF_SLICE, _FACES_OF_SLICE = 8192, 2048
# Occluder grids (lists of the faces that may block a light) are made if the mesh has fewer than this number of faces
# per shadow ray. The value was fitted to measured times. Adding a face to a grid takes a fifth of the time of a shadow
# ray through a bounding volume hierarchy, and a shadow ray through the grid takes a quarter.
_FACES_PER_RAY = 3
# Approximate size of an occluder grid, which lists the faces that may block a light, per face of the mesh [bytes]; and
# largest size of all grids together [bytes]. The largest size is limited by memory. There is one grid per directional
# light: with 100 lights, for example, grids are used for meshes of up to 149,000 faces.
_BYTES_PER_FACE, _MOST_BYTES = 72, 1 << 30


class CameraRays:
    """Rays through the pixels of a picture, which find their hits by a bounding volume hierarchy of the mesh's faces.

    Attributes:
        surface: The prepared mesh.
        scene: The surface's arrays on the device.
        view: View that was set last.
        camera: The view that was set last, as the struct ``Camera`` of the kernels.
        width: Number of pixels per row, including the margin of additional pixels around the picture.
        height: Number of rows, including the margin.
        size: Number of pixels, including the margin.
        options: Keyword arguments of kernel launches: the device and the number of threads.
        gbuffer: Hits of one ray per pixel. They are computed by the kernel calls that :meth:`trace` returns.
        may_be_occluded: Whether the mesh may occlude a light from some point that is visible in the view.
    """

    def __init__(
        self, surface: Surface, view: View, *, smooth: bool, margin: int = 0, device: wp.Device, threads: int
    ) -> None:
        """Allocate arrays for views with as many pixels as ``view``, and set this view.

        The arguments are those of :func:`rays_for`.
        """
        self.surface, self._margin = surface, margin
        self.width, self.height = view.width + 2 * margin, view.height + 2 * margin
        self.size = self.width * self.height
        self.scene = device_mesh.arrays_for(surface, smooth=smooth, device=device)
        self._axes = wp.empty(5, dtype=wp.vec3d, device=device)
        # Position of the ray in each pixel, relative to the pixel's centre. If the array is empty, rays pass through
        # the centres.
        self._offsets = wp.empty(0, dtype=wp.vec2d, device=device)
        self.options: dict[str, Any] = {"device": device, "threads": threads}
        self.gbuffer = GBuffer.allocate(
            self.size, coloured=surface.has_base_colour, has_maps=surface.has_maps, device=device
        )
        self.set_view(view)

    def set_view(self, view: View) -> None:
        """Set the view, which must have the same size in pixels as the previous one."""
        self.view = view
        self.camera = device_mesh.camera(view, self.surface, axes=self._axes, margin=self._margin)
        self.may_be_occluded = device_mesh.needs_shadow_rays(self.surface, view)

    def trace(self, sample: int, samples: int, deviation: float = 0.0) -> list[KernelCall]:
        """Choose the position of one of ``samples`` rays in each pixel; return the kernel calls that trace this ray.

        ``deviation`` is the standard deviation of the pixel filter [pixels], as in :meth:`calls`.
        """
        return self.calls(self._sampling(sample, samples), self.gbuffer, deviation)

    def launch(self, calls: Sequence[KernelCall]) -> None:
        """Launch kernel calls over all pixels, with one ray per pixel."""
        launch_pipeline(calls, self.size, slice_size=RAYS_OF_SLICE, **self.options)

    def calls(self, sampling: Sampling, gbuffer: GBuffer, deviation: float) -> list[KernelCall]:
        """Return the kernel calls that find the hits of rays, and compute shading frames and base colours at the hits.

        Args:
            sampling: Positions of the rays within their pixels.
            gbuffer: Arrays to which the hits are written.
            deviation: Standard deviation of the pixel filter [pixels], by which textures are filtered; 0 is no filter.
        """
        inputs = [self.camera, self.scene.with_hierarchy(), sampling]
        trace = KernelCall(bvh.trace_bvh, inputs, [gbuffer.pixels.nearest], in_runs=True)
        return [trace, *self._known_face_calls(sampling, gbuffer, deviation)]

    def _known_face_calls(self, sampling: Sampling, gbuffer: GBuffer, deviation: float) -> list[KernelCall]:
        """Return the calls that compute hits, shading frames and base colours, from the nearest face of each ray."""
        inputs = [self.camera, self.scene.bare, sampling, gbuffer.pixels]
        calls = []
        if not self.scene.is_opaque:
            scene = self.scene
            passing = [self.camera, scene.with_hierarchy(), scene.textures, scene.transparency, sampling]
            calls.append(KernelCall(transparency.pass_transparent, passing, [gbuffer.pixels.nearest], in_runs=True))
        calls += [
            KernelCall(primary_hits.intersect_known_faces, inputs, [], in_runs=True),
            KernelCall(primary_hits.make_shading_frames, [self.scene.bare, gbuffer.pixels], [], in_runs=True),
        ]
        if self.scene.is_textured and gbuffer.is_coloured:
            inputs = [self.camera, self.scene.bare, self.scene.textures, gbuffer.pixels, deviation]
            calls.append(KernelCall(base_colours.sample_base_colours, inputs, [], in_runs=True))
        if self.scene.has_maps and gbuffer.has_maps:
            inputs = [self.camera, self.scene.bare, self.scene.textures, gbuffer.pixels, deviation]
            calls.append(KernelCall(plain_textures.sample_plain_textures, inputs, [], in_runs=True))
        return calls

    def _sampling(self, sample: int, samples: int) -> Sampling:
        """Return a struct with the position of one of ``samples`` rays in each pixel; a single ray is in the centre."""
        sampling = Sampling()
        if samples > 1:
            if not len(self._offsets):
                self._offsets = wp.empty(self.size, dtype=wp.vec2d, device=self.options["device"])
            launch(
                primary_hits.place_samples, self.size, [sample, _SEED], [self._offsets],
                slice_size=RAYS_OF_SLICE, in_runs=True, **self.options,
            )  # fmt: skip
            sampling.offsets = self._offsets
        return sampling

    def shadow_grids(
        self,
        to_lights: Sequence[Sequence[float] | None],
        shadow_rays: Callable[[], int],  # noqa: ARG002 (of rasterized rays)
    ) -> list[ShadowGrid]:
        """Return an empty occluder grid for each light, so that shadow rays use the hierarchy (tree of bounding boxes).

        Args:
            to_lights: Directions to directional lights; None for other lights.
            shadow_rays: Function that returns the number of shadow rays per light.
        """
        return [no_grid(self.scene) for _ in to_lights]


class RasterizedRays(CameraRays):
    """Camera rays on the CPU, where rasterization finds the nearest face of each ray.

    Rasterization takes a quarter of the time of a bounding volume hierarchy on the CPU. Its kernel launches cannot be
    recorded for later replay.
    """

    def trace(self, sample: int, samples: int, deviation: float = 0.0) -> list[KernelCall]:
        """Find the nearest faces for one of ``samples`` rays per pixel; return kernel calls for the hits."""
        sampling, nearest = self._sampling(sample, samples), self.gbuffer.pixels.nearest
        nearest.fill_(primary_hits.UNSEEN)
        self._rasterize(sampling, Cells(), 0.0 if samples == 1 else refinement_levels.FILTER_CUT, nearest)
        return self.calls(sampling, self.gbuffer, deviation)

    def calls(self, sampling: Sampling, gbuffer: GBuffer, deviation: float) -> list[KernelCall]:
        """Return the kernel calls for rays whose nearest faces are known from rasterization."""
        return self._known_face_calls(sampling, gbuffer, deviation)

    def rasterize_cells(self, cells: Cells, pixels: int) -> NDArray[np.uint64]:
        """Return the index of the nearest face at the centre of each subpixel cell, pixel after pixel.

        ``pixels`` is the number of pixels that are divided into cells.
        """
        nearest = wp.full(pixels * cells.across**2, primary_hits.UNSEEN, dtype=wp.uint64, device=self.options["device"])
        self._rasterize(self._sampling(0, 1), cells, 0.0, nearest)
        return np.asarray(nearest.numpy())

    def _rasterize(self, sampling: Sampling, cells: Cells, most_offset: float, nearest: wp.array) -> None:
        inputs = [self.camera, self.scene.bare, sampling, cells, most_offset]
        launch(
            primary_hits.rasterize, self.scene.face_count, inputs, [nearest], slice_size=_FACES_OF_SLICE, in_runs=True,
            **self.options,
        )  # fmt: skip

    def shadow_grids(
        self, to_lights: Sequence[Sequence[float] | None], shadow_rays: Callable[[], int]
    ) -> list[ShadowGrid]:
        """Return for each light a grid with the faces that may occlude it; empty if a grid is slower or too large."""
        faces = self.scene.face_count
        pays = _FACES_PER_RAY * shadow_rays() > faces and _BYTES_PER_FACE * faces * len(to_lights) <= _MOST_BYTES
        pays = pays and self.scene.is_opaque
        return [
            grid_for(self.surface, self.scene, to_light, **self.options)
            if pays and to_light is not None
            else no_grid(self.scene)
            for to_light in to_lights
        ]


def rays_for(
    surface: Surface, view: View, *, smooth: bool = True, margin: int = 0, device_driven: bool = False,
    device: wp.Device, threads: int,
) -> CameraRays:  # fmt: skip
    """Return camera rays of the faster class: rasterization on the CPU, a bounding volume hierarchy on a GPU.

    Args:
        surface: The prepared mesh.
        view: First view. Later views must have the same size in pixels.
        smooth: Whether vertex normals are interpolated.
        margin: Number of pixels that are added to the picture on each side.
        device_driven: Whether the CPU uses the hierarchy, too, whose kernel launches can be recorded for later replay.
        device: The Warp device.
        threads: Number of threads on the CPU.
    """
    rays = RasterizedRays if device.is_cpu and not device_driven else CameraRays
    return rays(surface, view, smooth=smooth, margin=margin, device=device, threads=threads)
