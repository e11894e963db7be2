"""Dots of grating maps on a device: conversion of samples to the frames of dots, in which colours are looked up.

A grating map divides a surface into dots. All dots have the same height field (the cell), but each dot rotates it and
scales its depth and pitch. A sample is the scattering vector (u, v, w), direction to the light and footprint at one
hit. In the frame of the cell, the rotation and scaling of the dot are undone, so that one colour table serves all dots.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import dot_transforms
from warpdiff.kernels.structs import Footprint
from warpdiff.optics.fixed_reflectance import FixedReflectance, luminance_ratios

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.heightfield.grating_map import GratingMap
    from warpdiff.optics.materials import Material
    from warpdiff.scene.camera_rays import CameraRays
    from warpdiff.scene.gbuffer import GBuffer
    from warpdiff.scene.mesh_import import Surface


# Largest number of dots whose shares in a subpixel cell are computed: two along each axis of the grating map. A larger
# number would require other kernels.
MOST_DOTS = 4
# Distance beyond 0 and 1 from which on texture coordinates count as those of a map that repeats. Smaller distances are
# rounding errors of files. With a value of 1, maps that repeat would end at their border.
_ROUNDING_OF_UVS = 1e-4


class LookupSamples(NamedTuple):
    """Arrays from which colours are looked up, with one entry per ray. Geometry factors are passed separately.

    Attributes:
        scattering_vectors: Scattering vectors (u, v, w), (n,) of ``wp.vec3d``.
        to_lights: Directions to the light, (n,) of ``wp.vec3f``.
        footprints: Footprints of the rays' filters, (n,); None for pixels that show points.
    """

    scattering_vectors: wp.array
    to_lights: wp.array
    footprints: wp.array | None


@dataclass(frozen=True)
class DotSamples:
    """Samples of one surface in the frames of its dots; the samples of the next surface overwrite them.

    A dot rotates and scales the height field of the surface, which is called its cell. In the frame of the cell, the
    dot's rotation and scaling are undone.

    Attributes:
        scattering_vectors: Scattering vectors in the frames of the cells, (n,) of ``wp.vec3d``. After the look-ups of
            one ray per pixel, they are overwritten by signals, from which refinement finds the edges of dots.
        to_lights: Directions to the light in the frames of the cells, (n,) of ``wp.vec3f``.
        footprints: Footprints in the frames of the cells, (n,); empty if pixels show points.
        dots: Indices of the dots, row by row, (n,); −1 without a hit. If a subpixel cell overlaps several dots, the
            index is that of the dot with the smallest u and v.
        shares: Shares of the area of each subpixel cell in up to four dots, (n,) of ``wp.vec4f``.
        gains: Geometry factors, multiplied by the share of one dot in the subpixel cell. If looked-up colours include
            the reflectance at normal incidence, the factors also contain the reflectance at the angle relative to it,
            (n,).
    """

    scattering_vectors: wp.array
    to_lights: wp.array
    footprints: wp.array
    dots: wp.array
    shares: wp.array
    gains: wp.array

    @classmethod
    def allocate(cls, rays: int, *, means: bool, device: wp.Device) -> DotSamples:
        """Return uninitialised arrays for a number of rays.

        If ``means`` is False, pixels show points instead of means over footprints, and the array of footprints is
        empty.
        """

        def empty(dtype: type, size: int = rays) -> wp.array:
            return wp.empty(size, dtype=dtype, device=device)

        return cls(
            empty(wp.vec3d), empty(wp.vec3f), empty(Footprint, rays * means), empty(wp.int32), empty(wp.vec4f),
            empty(wp.float32),
        )  # fmt: skip


def material_of_dots(material: Material | None, grating_map: GratingMap | None) -> Material | None:
    """Return the material whose reflectance is included in the looked-up colours of a surface with a grating map.

    If depths or pitches differ between the dots of the map, look-ups use scaled scattering vectors, which have other
    angles than the light and the viewer. The included reflectance must then not depend on the angle.
    """
    if material is None or grating_map is None or grating_map.has_one_shape:
        return material
    return FixedReflectance.of(material)


def _repeats(mesh: Surface, surface_of_faces: NDArray[np.int32], surface: int) -> bool:
    """Whether the map of a surface repeats, because its faces have texture coordinates below 0 or above 1.

    ``surface_of_faces`` is empty if all faces have the same surface.
    """
    faces = mesh.faces[surface_of_faces == surface] if len(surface_of_faces) else mesh.faces
    uvs = mesh.uvs[faces]
    return bool(uvs.size and (uvs.min() < -_ROUNDING_OF_UVS or uvs.max() > 1.0 + _ROUNDING_OF_UVS))


class GratingDots:
    """Dots of all surfaces with a grating map (a height field that each dot rotates and scales), on the device."""

    def __init__(
        self, maps: dict[int, GratingMap], surface_of_faces: NDArray[np.int32], rays: CameraRays
    ) -> None:  # fmt: skip
        """Copy maps to the device of the rays; ``maps`` is a dictionary of the maps by the index of their surface.

        ``surface_of_faces`` is empty if all faces have the same surface.
        """
        device = rays.options["device"]
        self._rays = rays
        self._ratios: dict[Material, wp.array] = {}
        self._no_footprints = wp.empty(0, dtype=Footprint, device=device)
        self._no_ratios = wp.empty(0, dtype=wp.float32, device=device)
        self._repeats = {surface: _repeats(rays.surface, surface_of_faces, surface) for surface in maps}
        self._shapes = {surface: grating_map.shape for surface, grating_map in maps.items()}
        self._transforms = {
            surface: wp.array(grating_map.transforms, dtype=wp.vec4f, device=device)
            for surface, grating_map in maps.items()
        }
        self._surface_of_faces = wp.array(surface_of_faces, dtype=wp.int32, device=device)

    @classmethod
    def of(
        cls, maps: Sequence[GratingMap | None], surface_of_faces: NDArray[np.int32], rays: CameraRays
    ) -> GratingDots | None:
        """Return the dots of the surfaces that have a grating map; None if no surface has one."""
        by_surface = {surface: own for surface, own in enumerate(maps) if own is not None}
        if not by_surface:
            return None
        return cls(by_surface, surface_of_faces, rays)

    def has_map(self, surface: int) -> bool:
        """Whether the surface with the index ``surface`` has a grating map."""
        return surface in self._transforms

    def scaled_gains(
        self, material: Material | None, scattering_vectors: wp.array, gains: wp.array, of_dots: DotSamples, part: int
    ) -> KernelCall:
        """Return the kernel call that writes the factors of looked-up colours of a material to ``of_dots.gains``.

        The geometry factors ``gains`` are multiplied by the share of each subpixel cell in its dot ``part``, from 0 to
        3. If looked-up colours include a reflectance that does not depend on the angle, the gains are also multiplied
        by the reflectance at the angle, divided by the included one. ``scattering_vectors`` are those before
        :meth:`transform`.
        """
        ratios = self._no_ratios
        if isinstance(material, FixedReflectance):
            if material not in self._ratios:
                device = self._rays.options["device"]
                self._ratios[material] = wp.array(luminance_ratios(material), dtype=wp.float32, device=device)
            ratios = self._ratios[material]
        inputs = [ratios, scattering_vectors, gains, of_dots.shares, part]
        return KernelCall(dot_transforms.scale_gains, inputs, [of_dots.gains], in_runs=True)

    def transform(
        self, surface: int, gbuffer: GBuffer, samples: LookupSamples, of_dots: DotSamples, part: int
    ) -> tuple[LookupSamples, KernelCall]:
        """Return the samples of a surface in the frames of its dots, and the kernel call that computes them.

        A sample is a scattering vector with the direction to the light and the footprint of the pixel. In the frame of
        a dot, the dot's rotation and scaling of the height field are undone. The dots must have been found by
        :meth:`find`.

        Args:
            surface: Index of a surface with a grating map.
            gbuffer: Hits of the rays.
            samples: Samples in the frames of the hits.
            of_dots: Dots and shares from :meth:`find`, and arrays for the result, which the next call overwrites.
            part: Index of the dot among those that each subpixel cell overlaps, from 0 to 3.
        """
        footprints = self._no_footprints if samples.footprints is None else samples.footprints
        inputs = [
            self._transforms[surface], of_dots.dots, of_dots.shares, part, gbuffer.pixels.face, self._surface_of_faces,
            surface, samples.scattering_vectors, samples.to_lights, footprints,
        ]  # fmt: skip
        outputs = [of_dots.scattering_vectors, of_dots.to_lights, of_dots.footprints]
        result = LookupSamples(outputs[0], outputs[1], None if samples.footprints is None else outputs[2])
        return result, KernelCall(dot_transforms.transform_samples, inputs, outputs, in_runs=True)

    def find(self, surface: int, gbuffer: GBuffer, of_dots: DotSamples, level: int) -> KernelCall:
        """Return the kernel call that finds the dots of a surface's grating map that each ray's subpixel cell overlaps.

        ``level`` is the level of the cells; at level 0, there is one ray per pixel, which has a single dot.
        """
        inputs = [
            self._rays.camera, self._rays.scene.bare, gbuffer.pixels, *self._shapes[surface],
            self._repeats[surface], 1 << level,
        ]  # fmt: skip
        return KernelCall(dot_transforms.find_dots, inputs, [of_dots.dots, of_dots.shares], in_runs=True)

    def signal_calls(self, gbuffer: GBuffer, scattering_vectors: wp.array, of_dots: DotSamples) -> list[KernelCall]:
        """Return the kernel calls that write signals to ``of_dots.scattering_vectors``, for one ray per pixel.

        A signal is the scattering vector plus a large number times the row and column of the dot. Between neighbouring
        dots it changes by more than any scattering vector. Refinement thereby finds the edges of dots.
        """
        calls = []
        for place, surface in enumerate(self._transforms):
            inputs = [
                of_dots.dots, self._shapes[surface][1], gbuffer.pixels.face, self._surface_of_faces, surface,
                scattering_vectors, place == 0,
            ]  # fmt: skip
            calls += [
                self.find(surface, gbuffer, of_dots, 0),
                KernelCall(dot_transforms.signals_of_dots, inputs, [of_dots.scattering_vectors], in_runs=True),
            ]
        return calls
