"""Reference colours of pixels under a sky or a disc light, by sums of the reflectance over directions, with shadows.

The sums use none of the library's code for environments, disc lights, shadows or footprints.

The rays of a pixel are distributed over the pixel filter, a Gaussian with σ = 0.5 pixels, truncated at 1.5 pixels. Each
ray has one direction to the light: half of these directions are drawn from the light, and half around the mirror
direction (multiple importance sampling with the balance heuristic). Shadow rays are traced through a hierarchy of the
mesh that is built here. An element dω of solid angle with the radiance L adds 4πσ²/λ² · ρ L dω to a colour. Here ρ is
the reflectance and σ the standard deviation of the coherence window. The spectrum of L is derived from the RGB of the
sky under D65 (Mallett and Yuksel 2019).

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from scipy.special import ndtr, ndtri

import warpdiff as wd
from warpdiff.device.devices import load_now, resolve_device
from warpdiff.kernels import compile_options
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import colour_science
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

# Number of traced rays along each axis of a pixel. A sample of the pixel filter uses the nearest traced ray. With a
# much smaller number, the sampled filter would differ from the exact filter.
_ACROSS = 16
# Half of the directions to the light are drawn around the mirror direction, where the scattering vector has (u, v) = 0.
# The number is the share of these directions with |(u, v)| below a radius, the first value of `_mirror`. Below it, the
# density is uniform. The mean of the sums does not depend on this share, only their noise does.
_CORE = 0.25
# Number of pairs of light and view directions whose colours are computed in one call. The value is limited by memory.
_DIRECTIONS = 1 << 17
# Length of shadow rays [mesh radii]. The value is twice the largest distance between two points of a mesh, so that no
# occluder is missed.
_FAR = 4.0


# The kernel has the compile options of the package. With other options, Warp would precompile its own C++ headers once
# more, which takes 2 s.
@wp.kernel(module="unique", module_options=compile_options.options())
def _find_occluded(
    mesh: wp.uint64, origins: wp.array(dtype=wp.vec3f), towards: wp.array(dtype=wp.vec3f), far: wp.float32,
    occluded: wp.array(dtype=wp.bool),
):  # fmt: skip
    i = wp.tid()
    occluded[i] = wp.mesh_query_ray_anyhit(mesh, origins[i], towards[i], far)


class SkySums:
    """Sums, over directions of a sky, of the light that a mesh with a height field reflects into pixels."""

    def __init__(
        self, mesh: Any, heightfield: wd.HeightField, view: wd.View, coherence: wd.Coherence, *, shadows: bool = True
    ) -> None:
        """Trace the camera rays of all pixels."""
        fine = replace(view, width=_ACROSS * view.width, height=_ACROSS * view.height)
        surface, device = prepare_surface(mesh), resolve_device(None)
        rays = rays_for(surface, fine, device=device, threads=1)
        rays.launch(rays.trace(0, 1))
        pixels, shape = rays.gbuffer.pixels, (fine.height, fine.width)
        self._hit = pixels.hit.numpy().reshape(shape) != 0
        axes = [
            getattr(pixels, name).numpy() for name in ("tangent", "bitangent", "normal", "to_view", "shadow_origin")
        ]
        self._axes = np.stack(axes, axis=1).reshape(*shape, 5, 3)
        points = wp.array(surface.vertices, dtype=wp.vec3f, device=device)
        indices = wp.array(surface.faces.ravel(), dtype=wp.int32, device=device)
        self._mesh, self._device = wp.Mesh(points, indices) if shadows else None, device
        self._heightfield, self._coherence = heightfield, coherence
        self._plan = wd.plan(heightfield, tolerance=1e-2, coherence=coherence)

    def interior(self) -> NDArray[np.int64]:
        """Return rows and columns (n, 2) of pixels for which all rays of the pixel filter hit the mesh."""
        margin = 3 * _ACROSS // 2
        edges = np.pad(~self._hit, margin, constant_values=True).cumsum(axis=0).cumsum(axis=1)
        edges = np.pad(edges, ((1, 0), (1, 0)))
        width = _ACROSS + 2 * margin
        windows = edges[width:, width:] - edges[:-width, width:] - edges[width:, :-width] + edges[:-width, :-width]
        return np.argwhere(windows[::_ACROSS, ::_ACROSS] == 0)

    def under_disc(self, pixels: NDArray[np.int64], light: wd.DirectionalLight, across: int, seed: int) -> NDArray[Any]:
        """Return XYZ of pixels under a disc light, by ``across``² rays per pixel, shape (n, 3).

        Rays and light directions are stratified independently. Half of the light directions are drawn around the mirror
        direction, because nearly all directions that are drawn from the disc would miss a narrow mirror lobe.
        """
        axis = np.asarray(light.to_light)
        aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        aside /= np.linalg.norm(aside)
        ends = np.stack([aside, np.cross(axis, aside), axis])
        narrowest = math.cos(math.radians(light.angular_diameter_deg / 2.0))
        solid_angle = 2.0 * math.pi * (1.0 - narrowest)

        def draw(share: NDArray[np.float64]) -> NDArray[np.float64]:
            # Uniform random numbers are transformed to directions that are uniform over the solid angle of the disc.
            cosine = 1.0 - share[:, 0] * (1.0 - narrowest)
            sine, around = np.sqrt(1.0 - cosine**2), 2.0 * math.pi * share[:, 1]
            return np.asarray(np.stack([sine * np.cos(around), sine * np.sin(around), cosine], axis=-1) @ ends)

        def density(along: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.where(along @ axis >= narrowest * (1.0 - 1e-12), 1.0 / solid_angle, 0.0)

        def colours(lights: NDArray[Any], views: NDArray[Any], along: NDArray[Any]) -> NDArray[Any]:
            rho = wd.reflectance(
                self._heightfield,
                lights,
                views,
                illuminant=light.illuminant,
                coherence=self._coherence,
                plan=self._plan,
            )
            return np.asarray(density(along)[:, None] * rho)

        return light.power * self._sums(pixels, draw, density, colours, across, seed)

    def under_sky(self, pixels: NDArray[np.int64], sky: NDArray[np.float64], across: int, seed: int) -> NDArray[Any]:
        """Return XYZ of pixels under a sky, by ``across``² rays per pixel, shape (n, 3).

        ``sky`` has the shape (height, width), or (height, width, 3) with RGB.
        """
        sky = np.repeat(sky[..., None], 3, axis=2) if sky.ndim == 2 else sky
        height, width = sky.shape[:2]
        share_of = sky.sum(axis=2) * np.sin((np.arange(height) + 0.5) / height * math.pi)[:, None]
        share_of = share_of / share_of.sum()
        cumulative = np.cumsum(share_of)

        def draw(share: NDArray[np.float64]) -> NDArray[np.float64]:
            # The radiance of the sky is interpolated linearly between the centres of its pixels. The contribution of a
            # sky pixel therefore extends to the centres of neighbouring pixels, and is triangular along each axis.
            pixel = np.minimum(np.searchsorted(cumulative, share[:, 0]), cumulative.size - 1)
            within = (share[:, 0] - np.append(0.0, cumulative)[pixel]) / share_of.ravel()[pixel]
            down, right = (_triangular(number) for number in (within, share[:, 1]))
            polar = (pixel // width + 0.5 + down) / height * math.pi
            azimuth = ((pixel % width + 0.5 + right) / width - 0.5) * 2.0 * math.pi
            along = [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)]
            # Directions beyond a pole of the sky become zero vectors. They do not contribute, because a zero vector
            # does not count as above the surface.
            return np.where((polar > 0.0) & (polar < math.pi), along, 0.0).T

        def density(along: NDArray[np.float64]) -> NDArray[np.float64]:
            sine = np.maximum(np.hypot(along[:, 0], along[:, 2]), 1e-9)
            padded = np.pad(share_of, ((1, 1), (0, 0)))
            per_cell = radiance(padded[..., None], along, beyond=1)[:, 0]
            return np.asarray(per_cell * height * width / (2.0 * math.pi**2 * sine))

        spectra = _primaries(self._coherence.sigma_um or 0.0)

        def colours(lights: NDArray[Any], views: NDArray[Any], along: NDArray[Any]) -> NDArray[Any]:
            light, result = radiance(sky, along), np.zeros((len(lights), 3))
            for channel, (spectrum, scale) in enumerate(spectra):
                rho = wd.reflectance(
                    self._heightfield, lights, views, illuminant=spectrum, coherence=self._coherence, plan=self._plan
                )
                result += scale * light[:, channel : channel + 1] * rho
            return result

        return self._sums(pixels, draw, density, colours, across, seed)

    def _sums(
        self, pixels: NDArray[np.int64], draw: Callable[..., Any], density: Callable[..., Any],
        colours: Callable[..., Any], across: int, seed: int,
    ) -> NDArray[np.float64]:  # fmt: skip
        """Return XYZ of pixels as sums over directions to the light.

        Half of the directions are drawn from the light, and half around the mirror direction. ``draw`` returns
        directions to the light from random numbers. ``density`` returns the probability density of these directions per
        solid angle, and ``colours`` the reflected XYZ per solid angle.
        """
        rng = np.random.default_rng(seed)
        cells = np.stack(np.meshgrid(np.arange(across), np.arange(across)), axis=-1).reshape(-1, 2)
        result = np.zeros((len(pixels), 3))
        together = max(_DIRECTIONS // len(cells), 1)
        for first in range(0, len(pixels), together):
            part = pixels[first : first + together]
            at = np.concatenate([self._rays(pixel, cells, across, rng) for pixel in part])
            share = np.concatenate([(rng.permutation(cells) + rng.random(cells.shape)) / across for _ in part])
            owner = np.repeat(np.arange(first, first + len(part)), len(cells))
            hit = self._hit[at[:, 0], at[:, 1]]
            at, share, owner = at[hit], share[hit], owner[hit]
            axes = self._axes[at[:, 0], at[:, 1]].astype(np.float64)
            frame, views = axes[:, :3], np.einsum("nkc,nc->nk", axes[:, :3], axes[:, 3])
            along = draw(share)
            mirrored = rng.random(len(share)) < 0.5
            lights = np.einsum("nkc,nc->nk", frame, along)
            lights[mirrored, :2] = (-views[:, :2] + self._far_from_mirror(share))[mirrored]
            level2 = np.sum(lights[mirrored, :2] ** 2, axis=1)
            lights[mirrored, 2] = np.sqrt(np.maximum(1.0 - level2, 0.0))
            along = np.where(mirrored[:, None], np.einsum("nk,nkc->nc", lights, frame), along)
            seen = np.flatnonzero(lights[:, 2] > 0.0)
            seen = seen[~self._occluded(axes[seen, 4], along[seen])]
            lights, views, along = lights[seen], views[seen], along[seen]
            mirror_density = lights[:, 2] * self._density(np.hypot(*(lights + views)[:, :2].T))
            both = 0.5 * density(along) + 0.5 * mirror_density
            added = colours(lights, views, along) / (both * len(cells))[:, None]
            for channel in range(3):
                result[:, channel] += np.bincount(owner[seen], weights=added[:, channel], minlength=len(pixels))
        return result

    def _occluded(self, origins: NDArray[np.float64], towards: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return, for each shadow ray, whether the mesh occludes the light."""
        if self._mesh is None:
            return np.zeros(len(origins), dtype=np.bool_)
        arrays = [wp.array(values, dtype=wp.vec3f, device=self._device) for values in (origins, towards)]
        occluded = wp.empty(len(origins), dtype=wp.bool, device=self._device)
        load_now([_find_occluded], self._device)
        wp.launch(_find_occluded, len(origins), [self._mesh.id, *arrays, _FAR], [occluded], device=self._device)
        return np.asarray(occluded.numpy())

    @property
    def _mirror(self) -> tuple[float, float]:
        """Parameters of the distribution from which light directions around the mirror direction are drawn.

        The distribution is over (u, v), the tangential part of the scattering vector. The first value is a radius
        |(u, v)| within which the density is uniform. Beyond it, the logarithm of |(u, v)| is distributed uniformly. The
        second value is the logarithm of 2 over this radius, where 2 is the largest |(u, v)|.
        """
        within = 0.05 / (self._coherence.sigma_um or math.inf)
        return within, math.log(2.0 / within)

    def _far_from_mirror(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (u, v) of the scattering vectors of light directions around the mirror direction, shape (n, 2).

        ``share`` has two uniform random numbers for each direction.
        """
        within, digits = self._mirror
        radius = np.where(
            share[:, 0] < _CORE,
            within * np.sqrt(share[:, 0] / _CORE),
            within * np.exp(digits * (share[:, 0] - _CORE) / (1.0 - _CORE)),
        )
        around = 2.0 * math.pi * share[:, 1]
        return np.stack([radius * np.cos(around), radius * np.sin(around)], axis=-1)

    def _density(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability density over (u, v) of light directions that are drawn around the mirror direction.

        (u, v) is the tangential part of the scattering vector, and ``radius`` is |(u, v)|.
        """
        within, digits = self._mirror
        beyond = (1.0 - _CORE) / (2.0 * math.pi * digits * np.maximum(radius, within) ** 2)
        return np.where(radius < within, _CORE / (math.pi * within**2), np.where(radius < 2.0, beyond, 0.0))

    @staticmethod
    def _rays(
        pixel: NDArray[np.int64], cells: NDArray[np.int64], across: int, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """Return indices of traced camera rays that sample the filter of a pixel, one ray per stratum of the filter.

        The filter has ``across``² strata.
        """
        share = ndtr(-3.0) + (1.0 - 2.0 * ndtr(-3.0)) * (cells + rng.random(cells.shape)) / across
        return ((pixel + 0.5 + 0.5 * ndtri(share)) * _ACROSS).astype(np.int64)


def _triangular(number: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return numbers with a triangular distribution from −1 to 1, for uniform numbers between 0 and 1."""
    return np.where(number < 0.5, np.sqrt(2.0 * number) - 1.0, 1.0 - np.sqrt(np.maximum(2.0 - 2.0 * number, 0.0)))


def _primaries(sigma_um: float) -> list[tuple[wd.Spectrum, float]]:
    """Return the spectra of red, green and blue light under D65, divided by λ², with a factor for the brightness.

    The factor is 4πσ² times the luminance Y of the divided spectrum (λ in µm), relative to Y of D65; σ is the standard
    deviation of the coherence window.
    """
    colour: Any = colour_science()
    nm = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64)
    basis = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    d65, bright = colour.SDS_ILLUMINANTS["D65"].copy(), colorimetry.colour_products("D65")[:, 1]
    white = np.interp(nm, d65.wavelengths, d65.values)
    result = []
    for channel in range(3):
        reflected = np.maximum(np.interp(nm, basis.wavelengths, basis.values[:, channel]), 0.0)
        scale = 4.0 * math.pi * sigma_um**2 * (bright * reflected / (1e-3 * nm) ** 2).sum() / bright.sum()
        result.append((wd.Spectrum(nm, white * reflected / nm**2), float(scale)))
    return result


def radiance(sky: NDArray[np.float64], along: NDArray[np.float64], *, beyond: int = 0) -> NDArray[np.float64]:
    """Return the radiance of a sky in directions (n, 3), interpolated linearly between pixel centres.

    The middle column of the sky is at −z and row 0 at +y. ``beyond`` is the number of rows that the array has beyond
    each pole.
    """
    width, last = sky.shape[1], len(sky) - 1.000001
    height = len(sky) - 2 * beyond
    row = np.clip(np.arccos(np.clip(along[:, 1], -1.0, 1.0)) / math.pi * height - 0.5 + beyond, 0.0, last)
    column = (np.arctan2(along[:, 0], -along[:, 2]) / (2.0 * math.pi) + 0.5) * width - 0.5
    north, west = row.astype(int), np.floor(column).astype(int)
    descent, fraction = (row - north)[:, None], (column - west)[:, None]
    west, east = west % width, (west + 1) % width
    upper = (1.0 - fraction) * sky[north, west] + fraction * sky[north, east]
    lower = (1.0 - fraction) * sky[north + 1, west] + fraction * sky[north + 1, east]
    return np.asarray((1.0 - descent) * upper + descent * lower)
