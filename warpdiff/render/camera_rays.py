"""Camera rays: the faces that rays through the pixels of a picture hit, by rasterization or by a hierarchy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall, launch
from warpdiff.kernels import bvh, light_samples, primary_hits
from warpdiff.kernels.structs import Cells, Sampling
from warpdiff.render.gbuffer import GBuffer
from warpdiff.scene import device_mesh
from warpdiff.scene.occluder_grid import grid_for, no_grid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface

_SEED = 0
# Of a slice: pixels whose rays are found, and faces.
RAYS_OF_SLICE, _FACES_OF_SLICE = 8192, 2048
# As many faces are made a grid of while a shadow ray goes through the hierarchy, beyond what it takes in the grid.
_FACES_PER_RAY = 3


class PixelRays:
    """Rays through the pixels of a picture of a surface, cast through a hierarchy by the device alone.

    Attributes:
        view: The last view.
        width: Pixels in a row, with those of the margin.
        height: Rows, likewise.
        options: The device and the number of threads of launches.
        gbuffer: The G-buffer of the pixels' own rays, under the last light.
    """

    def __init__(
        self, surface: Surface, view: View, *, smooth: bool, means: bool, materials: bool, margin: int,
        device: wp.Device, threads: int,
    ) -> None:  # fmt: skip
        """Rays of a view, and of others of as many pixels.

        They have footprints if they show ``means``, gains of one of several ``materials``, and so many pixels more on
        each side as the ``margin`` is wide.
        """
        self._surface, self._margin = surface, margin
        self.width, self.height = view.width + 2 * margin, view.height + 2 * margin
        self._size = self.width * self.height
        self._scene = device_mesh.arrays_for(surface, smooth=smooth, device=device)
        self._axes = wp.empty(5, dtype=wp.vec3d, device=device)
        # Where rays of a sample lie, if each pixel's lies elsewhere.
        self._offsets = wp.empty(0, dtype=wp.vec2d, device=device)
        self.options: dict[str, Any] = {"device": device, "threads": threads}
        coloured = surface.has_base_colour
        self.gbuffer = GBuffer.allocate(self._size, device=device, means=means, coloured=coloured, materials=materials)
        self.set_view(view)

    def set_view(self, view: View) -> None:
        """Set the view, of the same size as any before."""
        self.view = view
        self._camera = device_mesh.camera(view, self._surface, axes=self._axes, margin=self._margin)
        self.may_be_occluded = device_mesh.needs_shadow_rays(self._surface, view)

    def trace(self, sample: int, samples: int) -> list[KernelCall]:
        """The calls that send one ray through every pixel."""
        return self.calls(self._sampling(sample, samples), self.gbuffer.pixels)

    def calls(self, sampling: Any, pixels: Any) -> list[KernelCall]:
        """The calls that find where rays meet the mesh, and its shading frames there."""
        inputs = [self._camera, self._scene.with_hierarchy(), sampling]
        trace = KernelCall(bvh.trace_bvh, inputs, [pixels.nearest], in_runs=True)
        return [trace, *self._known_face_calls(sampling, pixels)]

    def _known_face_calls(self, sampling: Any, pixels: Any) -> list[KernelCall]:
        """The calls that find where rays meet the faces that are known to be nearest, and shading frames there."""
        inputs = [self._camera, self._scene.bare, sampling, pixels]
        return [
            KernelCall(primary_hits.intersect_known_faces, inputs, [], in_runs=True),
            KernelCall(primary_hits.make_shading_frames, [self._scene.bare, pixels], [], in_runs=True),
        ]

    def _sampling(self, sample: int, samples: int) -> Any:
        """Where a sample of every pixel lies: a single one in its centre."""
        sampling = Sampling()
        if samples > 1:
            if not len(self._offsets):
                self._offsets = wp.empty(self._size, dtype=wp.vec2d, device=self.options["device"])
            launch(
                primary_hits.place_samples, self._size, [sample, samples, _SEED], [self._offsets],
                slice_size=RAYS_OF_SLICE, in_runs=True, **self.options,
            )  # fmt: skip
            sampling.offsets = self._offsets
        return sampling

    def footprints(self, gbuffer: GBuffer, deviation: float) -> KernelCall:
        """The call that finds the footprints of filters of a deviation [pixels]."""
        inputs = [self._camera, self._scene.bare, gbuffer.pixels, gbuffer.scattering_vectors, deviation]
        return KernelCall(light_samples.pixel_footprints, inputs, [gbuffer.footprints], in_runs=True)

    def rotated_footprints(self, gbuffer: GBuffer, lights: Any, light_index: int, deviation: float) -> KernelCall:
        """The call that adds to footprints how the direction to a light at a place changes over them."""
        inputs = [self._camera, self._scene.bare, gbuffer.pixels, lights, light_index, deviation]
        return KernelCall(light_samples.add_light_rotation, inputs, [gbuffer.footprints], in_runs=True)

    def shadow_grid(self, _to_light: Sequence[float] | None, _rays: int, _pixels: int | None = None) -> Any:
        """What asks the hierarchy, for any light."""
        return no_grid(self._scene)


class RasterizedRays(PixelRays):
    """Rays through pixels on the CPU, where faces are rasterized first: a ray then meets a known one, or none."""

    def trace(self, sample: int, samples: int) -> list[KernelCall]:
        """The calls that send one ray through every pixel, whose faces are found at once."""
        sampling, nearest = self._sampling(sample, samples), self.gbuffer.pixels.nearest
        nearest.fill_(primary_hits.UNSEEN)
        self._rasterize(sampling, Cells(), 0.0 if samples == 1 else primary_hits.MOST_OFFSET, nearest)
        return self.calls(sampling, self.gbuffer.pixels)

    def calls(self, sampling: Any, pixels: Any) -> list[KernelCall]:
        """The calls that find where rays meet the mesh, and its shading frames there."""
        return self._known_face_calls(sampling, pixels)

    def rasterize_cells(self, cells: Any, pixels: int) -> NDArray[np.uint64]:
        """Rasterize the cells of so many pixels: the nearest faces, one pixel's after the other."""
        nearest = wp.full(pixels * cells.across**2, primary_hits.UNSEEN, dtype=wp.uint64, device=self.options["device"])
        self._rasterize(self._sampling(0, 1), cells, 0.0, nearest)
        return np.asarray(nearest.numpy())

    def _rasterize(self, sampling: Any, cells: Any, most_offset: float, nearest: wp.array) -> None:
        """Let faces find their rays."""
        inputs = [self._camera, self._scene.bare, sampling, cells, most_offset]
        launch(
            primary_hits.rasterize, self._scene.face_count, inputs, [nearest], slice_size=_FACES_OF_SLICE, in_runs=True,
            **self.options,
        )  # fmt: skip

    def shadow_grid(self, to_light: Sequence[float] | None, rays: int, pixels: int | None = None) -> Any:
        """A grid of faces where it is worth it for so many rays of each pixel, once the first are cast.

        Without a number of pixels, those that hit the mesh count. Otherwise, and for a point light, which has no single
        direction, shadow rays go through the hierarchy.
        """
        pixels = int(np.count_nonzero(self.gbuffer.pixels.hit.numpy())) if pixels is None else pixels
        # A face takes a fifth of the time in a grid that a ray does through the hierarchy, and a ray a quarter.
        if to_light is None or _FACES_PER_RAY * rays * pixels <= self._scene.face_count:
            return no_grid(self._scene)
        return grid_for(self._surface, self._scene, to_light, **self.options)
