"""Colours of pixels under a grey sky or a disc light, by sums of the reflectance over directions.

The sums use no code of environments, disc lights or footprints.

A pixel's rays are distributed over its filter (a Gaussian, σ 0.5 pixel, truncated at 1.5). Each has its own directions
on a grid of (x, y) in its shading frame; the grids of a pixel are shifted, so that together they are finer. dω cos θ is
dx dy, and the radiance from there is ρ L dω 4πσ²/λ² for light with the spectrum of D65.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr, ndtri

import warpdiff as wd
from warpdiff.device.devices import resolve_device
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import colour_science
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Traced rays along a side of a pixel, to which samples are rounded.
_ACROSS = 16
# Distance of a ray's directions, in standard deviations of the lobes, and number of rays that are summed together.
_STEP, _RAYS = 1.2, 16
# Share of the mirror directions that lie within the mirror's lobe.
_CORE = 0.25


class SkySums:
    """Sums for the pixels of a mesh with a height field."""

    def __init__(self, mesh: Any, heightfield: wd.HeightField, view: wd.View, coherence: wd.Coherence) -> None:
        """Trace the rays."""
        fine = replace(view, width=_ACROSS * view.width, height=_ACROSS * view.height)
        rays = rays_for(prepare_surface(mesh), fine, device=resolve_device(None), threads=1)
        rays.launch(rays.trace(0, 1))
        pixels, shape = rays.gbuffer.pixels, (fine.height, fine.width)
        self._hit = pixels.hit.numpy().reshape(shape) != 0
        axes = [getattr(pixels, name).numpy() for name in ("tangent", "bitangent", "normal", "to_view")]
        self._axes = np.stack(axes, axis=1).reshape(*shape, 4, 3)
        self._heightfield, self._coherence = heightfield, coherence
        self._plan = wd.plan(heightfield, tolerance=1e-2, coherence=coherence)
        nm = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64)
        d65 = colour_science().SDS_ILLUMINANTS["D65"].copy()
        self._light = wd.Spectrum(nm, np.interp(nm, d65.wavelengths, d65.values) / nm**2)
        bright = colorimetry.colour_products("D65")[:, 1]
        sigma = coherence.sigma_um or 0.0
        self._scale = 4.0 * math.pi * sigma**2 * (bright / (1e-3 * nm) ** 2).sum() / bright.sum()
        self._step = _STEP * 0.5 / (2.0 * math.pi * sigma)

    def interior(self) -> NDArray[np.int64]:
        """Return row and column of the pixels whose filter rays all hit the mesh, (n, 2)."""
        margin = 3 * _ACROSS // 2
        edges = np.pad(~self._hit, margin, constant_values=True).cumsum(axis=0).cumsum(axis=1)
        edges = np.pad(edges, ((1, 0), (1, 0)))
        width = _ACROSS + 2 * margin
        windows = edges[width:, width:] - edges[:-width, width:] - edges[width:, :-width] + edges[:-width, :-width]
        return np.argwhere(windows[::_ACROSS, ::_ACROSS] == 0)

    def under_disc(self, pixels: NDArray[np.int64], light: wd.DirectionalLight, across: int, seed: int) -> NDArray[Any]:
        """Return XYZ of pixels under a disc light, by ``across``² rays per pixel, (n, 3).

        Rays and directions are stratified independently. Half of the directions are points of the disc; the other half
        lie around the mirror direction, at distances that are evenly spaced in their logarithm. Points of the disc
        alone would miss a narrow mirror lobe in nearly all rays.
        """
        rng = np.random.default_rng(seed)
        cells = np.stack(np.meshgrid(np.arange(across), np.arange(across)), axis=-1).reshape(-1, 2)
        axis = np.asarray(light.to_light)
        aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        aside /= np.linalg.norm(aside)
        ends = np.stack([aside, np.cross(axis, aside), axis])
        narrowest = math.cos(math.radians(light.angular_diameter_deg / 2.0))
        solid_angle = 2.0 * math.pi * (1.0 - narrowest)
        result = np.zeros((len(pixels), 3))
        for index, pixel in enumerate(pixels):
            at = self._rays(pixel, cells, across, rng)
            axes = self._axes[at[:, 0], at[:, 1]].astype(np.float64)
            share = (rng.permutation(cells) + rng.random(cells.shape)) / across
            views = np.einsum("nkc,nc->nk", axes[:, :3], axes[:, 3])
            # Equal shares of the solid angle.
            cosine = 1.0 - share[:, 0] * (1.0 - narrowest)
            sine, around = np.sqrt(1.0 - cosine**2), 2.0 * math.pi * share[:, 1]
            along = np.stack([sine * np.cos(around), sine * np.sin(around), cosine], axis=-1) @ ends
            lights = np.einsum("nkc,nc->nk", axes[:, :3], along)
            mirrored = rng.random(len(cells)) < 0.5
            aside_xy = self._far_from_mirror(share)
            lights[mirrored, :2] = -views[mirrored, :2] + aside_xy[mirrored]
            level2 = np.sum(lights[mirrored, :2] ** 2, axis=1)
            lights[mirrored, 2] = np.sqrt(np.maximum(1.0 - level2, 0.0))
            inside = np.einsum("nk,nkc,c->n", lights, axes[:, :3], axis) >= narrowest * (1.0 - 1e-12)
            counted = inside & (lights[:, 2] > 0.0)
            lights, views = lights[counted], views[counted]
            # The density of both kinds of directions.
            density = 0.5 / solid_angle + 0.5 * lights[:, 2] * self._density(np.hypot(*(lights + views)[:, :2].T))
            rho = wd.reflectance(self._heightfield, lights, views, coherence=self._coherence, plan=self._plan)
            result[index] = (1.0 / (solid_angle * density)) @ rho / len(cells)
        return light.power * result

    @property
    def _mirror(self) -> tuple[float, float]:
        """Radius within which mirror directions are uniform in (u, v), and the logarithm of the largest over it."""
        within = 0.05 / (self._coherence.sigma_um or math.inf)
        return within, math.log(2.0 / within)

    def _far_from_mirror(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (u, v) of mirror directions for pairs of numbers from 0 to 1, (n, 2)."""
        within, digits = self._mirror
        radius = np.where(
            share[:, 0] < _CORE,
            within * np.sqrt(share[:, 0] / _CORE),
            within * np.exp(digits * (share[:, 0] - _CORE) / (1.0 - _CORE)),
        )
        around = 2.0 * math.pi * share[:, 1]
        return np.stack([radius * np.cos(around), radius * np.sin(around)], axis=-1)

    def _density(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density of mirror directions over (u, v)."""
        within, digits = self._mirror
        beyond = (1.0 - _CORE) / (2.0 * math.pi * digits * np.maximum(radius, within) ** 2)
        return np.where(radius < within, _CORE / (math.pi * within**2), np.where(radius < 2.0, beyond, 0.0))

    @staticmethod
    def _rays(
        pixel: NDArray[np.int64], cells: NDArray[np.int64], across: int, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """Return the indices of the traced rays of a pixel's filter, one in each of its ``across``² parts."""
        share = ndtr(-3.0) + (1.0 - 2.0 * ndtr(-3.0)) * (cells + rng.random(cells.shape)) / across
        return ((pixel + 0.5 + 0.5 * ndtri(share)) * _ACROSS).astype(np.int64)

    def under_sky(self, pixels: NDArray[np.int64], sky: NDArray[np.float64], across: int, seed: int) -> NDArray[Any]:
        """Return XYZ of pixels under a sky (height, width), by ``across``² rays per pixel, (n, 3)."""
        rng = np.random.default_rng(seed)
        cells = np.stack(np.meshgrid(np.arange(across), np.arange(across)), axis=-1).reshape(-1, 2)
        result = np.zeros((len(pixels), 3))
        for index, pixel in enumerate(pixels):
            at = self._rays(pixel, cells, across, rng)
            # Every ray has its own shift of the grid.
            shift = (rng.permutation(cells) + rng.random(cells.shape)) / across * self._step
            for first in range(0, len(cells), _RAYS):
                part = slice(first, first + _RAYS)
                axes = self._axes[at[part, 0], at[part, 1]].astype(np.float64)
                result[index] += self._sum(axes, shift[part], sky) / len(cells)
        return result * self._step**2 * self._scale

    def _sum(self, axes: NDArray[np.float64], shift: NDArray[np.float64], sky: NDArray[np.float64]) -> NDArray[Any]:
        """Return sums over directions of all rays, with shifted grids."""
        grid = np.arange(-1.0 - self._step, 1.0 + self._step, self._step)
        x = (grid + shift[:, :1])[:, :, None] + 0.0 * grid
        y = (grid + shift[:, 1:])[:, None, :] + 0.0 * grid[:, None]
        inside = x**2 + y**2 < 1.0 - 1e-6
        ray = np.nonzero(inside)[0]
        lights = np.stack([x[inside], y[inside], np.sqrt(1.0 - x[inside] ** 2 - y[inside] ** 2)], axis=-1)
        along = np.einsum("nk,nkc->nc", lights, axes[ray, :3])
        views = np.einsum("nkc,nc->nk", axes[:, :3], axes[:, 3])[ray]
        rho = wd.reflectance(
            self._heightfield, lights, views, illuminant=self._light, coherence=self._coherence, plan=self._plan
        )
        return np.asarray((radiance(sky, along) / lights[:, 2]) @ rho)


def radiance(sky: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a sky's radiance in directions (n, 3): middle column at −z, row 0 at +y, linear between centres."""
    height, width = sky.shape
    row = np.clip(np.arccos(np.clip(along[:, 1], -1.0, 1.0)) / math.pi * height - 0.5, 0.0, height - 1.000001)
    column = (np.arctan2(along[:, 0], -along[:, 2]) / (2.0 * math.pi) + 0.5) * width - 0.5
    north, west = row.astype(int), np.floor(column).astype(int)
    descent, fraction = row - north, column - west
    west, east = west % width, (west + 1) % width
    upper = (1.0 - fraction) * sky[north, west] + fraction * sky[north, east]
    lower = (1.0 - fraction) * sky[north + 1, west] + fraction * sky[north + 1, east]
    return np.asarray((1.0 - descent) * upper + descent * lower)
