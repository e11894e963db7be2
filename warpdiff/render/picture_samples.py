"""Samples of an unrefined picture: directions, geometry factors and footprints at its illuminated pixels.

A footprint is the change of (u, v) over a pixel's filter, and (u, v, w) is the scattering vector. A lobe is a Gaussian
of directions to a light, or a single direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.kernels.thresholds import TINY
from warpdiff.lights.base import LobeSet, listed
from warpdiff.render import pixel_filter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.base import Light, LightPart
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.render.picture import Picture
    from warpdiff.render.picture_inputs import PictureInputs
    from warpdiff.render.pixel_sampler import LobeIndex
    from warpdiff.render.renderer import Renderer

# Largest standard deviation of a footprint in (u, v), the tangential components of the scattering vector. At
# silhouettes, directions change so fast that footprints, which are linear approximations, would exceed the hemisphere
# without this limit.
_WIDEST = 0.35
# Names of the fields of :class:`LitPixels` with one entry per sample, except for the optional footprints.
_ARRAYS = ("pixels", "scattering_vectors", "to_lights", "gains")


@dataclass(frozen=True)
class LitPixels:
    """Samples of one lobe of a light (direction or Gaussian of directions), at the pixels that it illuminates.

    Attributes:
        pixels: Index of each sample's pixel among all pixels of the picture, shape (n,).
        scattering_vectors: Scattering vectors (u, v, w), shape (n, 3).
        to_lights: Unit vectors to the light in the local frame, shape (n, 3).
        gains: Factors of the colours: cosines, masking, reflectance by angle, and the power of the light, shape (n,).
        footprints: Covariances uu, uv and vv of the scattering vector's components u and v over the filter of each
            pixel, shape (n, 3); None for points. Standard deviations are at most 0.35.
        illuminated: Illuminant of the light with the material of the surface.
    """

    pixels: NDArray[np.int64]
    scattering_vectors: NDArray[np.float64]
    to_lights: NDArray[np.float64]
    gains: NDArray[np.float64]
    footprints: NDArray[np.float64] | None
    illuminated: IlluminatedMaterial

    def among(self, chosen: NDArray[np.int64]) -> LitPixels:
        """Return the samples (illuminated pixels with their directions) that have the indices ``chosen``."""
        footprints = None if self.footprints is None else self.footprints[chosen]
        return replace(
            self, pixels=self.pixels[chosen], scattering_vectors=self.scattering_vectors[chosen],
            to_lights=self.to_lights[chosen], gains=self.gains[chosen], footprints=footprints,
        )  # fmt: skip

    @staticmethod
    def joined(others: Sequence[LitPixels]) -> LitPixels:
        """Join several sets of samples (pixels with their directions) that have the same illuminant and material."""
        footprints = [other.footprints for other in others if other.footprints is not None]
        pixels, vectors, lights, gains = (
            np.concatenate([getattr(other, name) for other in others]) for name in _ARRAYS
        )
        covariances = np.concatenate(footprints) if footprints else None
        return LitPixels(pixels, vectors, lights, gains, covariances, others[0].illuminated)


@dataclass(frozen=True)
class PictureSamples:
    """Directions and pigment colours of an unrefined picture. The diffraction of its height field is not included.

    Attributes:
        inputs: Checked inputs of the picture.
        lobes: Samples by lobe (direction to a light, or Gaussian of directions) and material.
        illuminated: Whether light reaches each pixel, shape (height, width).
        pigment: XYZ of the light that the pigment reflects at the illuminated pixels, shape (n, 3).
        has_pigment: Whether the base colour of the mesh is visible.
    """

    inputs: PictureInputs
    lobes: list[LitPixels]
    illuminated: NDArray[np.bool_]
    pigment: NDArray[np.float64]
    has_pigment: bool


def samples_of(renderer: Renderer, lights: Light | Sequence[Light]) -> PictureSamples:
    """Return the samples of the picture that a renderer draws under some lights, one sample per pixel and lobe.

    A lobe is a direction to a light, or a Gaussian of such directions. The renderer itself, and its last picture, do
    not change.

    Raises:
        ValueError: The picture has refined pixels, several samples per pixel, several surfaces, normalised energy, or
            lights whose directions are drawn at random.
    """
    inputs, plans, surface, view = renderer._made_of
    _check(inputs)
    means = inputs.evaluation.footprint
    if means and not all(plan.uses_footprints for plan in plans):
        raise ArgumentValueError(
            f"{ref('renderer')} must draw one sample per pixel, got footprint=True with a plan without footprints, "
            "whose pixels have several: make it with footprint=False"
        )
    lights = listed(lights)
    parts = inputs.parts_of(lights, means=means)
    _check_parts(parts)
    picture = inputs.picture(surface, view)
    picture.set_lights(parts)
    lobes = [lit for index in picture.sampler.lobes() for lit in _lit(picture, index, means=means)]
    illuminated = picture.sums.illuminated.numpy()
    pigment = picture.sums.xyz.numpy()[illuminated].astype(np.float64)
    return PictureSamples(
        inputs, lobes, illuminated.reshape(view.height, view.width), pigment, picture.context.is_pigmented
    )


def _check(inputs: PictureInputs) -> None:
    """Raise an error unless the picture has one sample per pixel and a single surface."""
    settings = inputs.settings
    if isinstance(inputs.heightfield, Mapping):
        raise ArgumentValueError(
            f"{ref('renderer')} must have one heightfield, got {len(inputs.surfaces)} surfaces: pictures of several "
            "surfaces have no derivative"
        )
    if settings.refine:
        raise ArgumentValueError(
            f"{ref('renderer')} must draw unrefined pictures, got refine=True: refined pictures have no derivative; "
            "make it with refine=False, or use renderer.resized(view, refine=False)"
        )
    if settings.samples_per_pixel != 1:
        raise ArgumentValueError(
            f"{ref('renderer')} must draw one sample per pixel, got samples_per_pixel={settings.samples_per_pixel}: "
            "make it with samples_per_pixel=1"
        )
    if inputs.evaluation.energy != "stam":
        raise ArgumentValueError(
            f"{ref('renderer')} must have energy='stam', got {inputs.evaluation.energy!r}: factors of the normalised "
            "energy of colours are interpolated on a grid, and have no derivative"
        )


def _check_parts(parts: Sequence[LightPart]) -> None:
    """Raise an error for lights whose directions are drawn at random."""
    for part in parts:
        if type(part) is not LobeSet:
            raise ArgumentValueError(
                f"{ref('lights')} must be directional or point lights, or discs of at most 5°, got a light with "
                f"{part.sample_count} random directions per pixel: skies and wide discs have no derivative; use "
                "several lights without an extent"
            )


def _lit(picture: Picture, index: LobeIndex, *, means: bool) -> list[LitPixels]:
    """Return the scattering vectors and geometry factors of all illuminated pixels, separately for each material.

    The light is a single lobe: a direction or a Gaussian of directions.
    """
    sampler, context = picture.sampler, picture.context
    sampler.scatter(0, index, picture.sums)
    vectors, to_lights, gains = sampler.directions()
    covariances = _covariances(picture, index) if means else None
    finishes = context.finishes_of_hits()
    result = []
    for finish, (illuminated,) in enumerate(picture.illuminated(index)):
        is_lit = gains > 0.0 if finishes is None else (gains > 0.0) & (finishes == finish)
        pixels = np.flatnonzero(is_lit)
        if not pixels.size:
            continue
        result.append(
            LitPixels(
                pixels, vectors[pixels].astype(np.float64), to_lights[pixels].astype(np.float64),
                gains[pixels].astype(np.float64), None if covariances is None else covariances[pixels], illuminated,
            )
        )  # fmt: skip
    return result


def _covariances(picture: Picture, index: LobeIndex) -> NDArray[np.float64]:
    """Return the covariances uu, uv and vv of the scattering vector (u, v) over the filter of each pixel.

    The shape is (pixels, 3).
    """
    deviation = pixel_filter.deviation_at(0, means=True)
    batch = picture.sampler.batch(picture.sums, deviation=deviation)
    picture.rays.launch(picture.footprint_calls(index, batch))
    wp.synchronize_device(picture.context.device)
    row_u, row_v, column_u, column_v = batch.samples.footprints.numpy().astype(np.float64).T
    uu, uv = row_u * row_u + column_u * column_u, row_u * row_v + column_u * column_v
    vv = row_v * row_v + column_v * column_v
    # Footprints that are too wide are scaled, so that their variance along the longest axis is the square of `_WIDEST`.
    largest = (uu + vv) / 2.0 + np.hypot((uu - vv) / 2.0, uv)
    share = np.minimum(_WIDEST**2 / np.maximum(largest, TINY), 1.0)
    return np.asarray(share[:, None] * np.stack([uu, uv, vv], axis=1))
