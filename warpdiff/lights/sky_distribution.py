"""Distributions from which directions to a sky are drawn: by the sky's brightness, and by the surface's colours.

(u, v, w) is the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the light and to the viewer. A ring
is a circle of constant |(u, v)|. The lobe of a diffraction order is its peak over (u, v).
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.kernels import sky_samples
from warpdiff.kernels.structs import Footprint
from warpdiff.tables import polar_grid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.sky_grid import SkyGrid
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.tables.lookup import ColourLookup

# Polar grid of scattering vectors (u, v), from which directions to the sky are drawn by the surface's colours. A ring
# of the grid is a circle of constant |(u, v)|. `_RINGS_PER_OCTAVE` is the number of rings per octave of |(u, v)|, and
# `_FARTHEST` the largest |(u, v)|. `_DISC_RADIUS` is the radius of a disc in the middle without rings. Its unit is the
# standard deviation of the peak of a diffraction order over (u, v). Other values would change only the noise.
_RINGS_PER_OCTAVE, _FARTHEST, _DISC_RADIUS = 6, 2.05, 0.5
# Limits of the azimuth samples on a ring (circle of constant |(u, v)|). `_SPOKES_APART` is the distance of neighbouring
# samples, in standard deviations of the peak of a diffraction order. `_FEWEST_SPOKES` and `_MOST_SPOKES` are the
# smallest and the largest number of samples per ring. The largest number was chosen by the errors of pictures: with at
# most 64 samples per ring, the errors are 1.5 times as large (docs/decisions/environments.md).
_SPOKES_APART, _FEWEST_SPOKES, _MOST_SPOKES = 1.0, 16, 512
# Normal components |w| = cos θi + cos θr of the scattering vectors at which colours of the surface are looked up. θi
# and θr are the angles of light and view from the normal. The mean of the colours over these |w| determines the
# probability of a direction. The values were chosen freely: they change only the noise of pictures.
_WS = (0.8, 1.3, 1.8)
# The colour at each sample of the polar grid of scattering vectors (u, v) is a mean over (u, v) with a Gaussian weight.
# This is the standard deviation of the weight, relative to the distance of neighbouring samples. Larger values would
# blur the distribution of directions.
_WIDTH = 0.4
# Fraction of the probability that is distributed evenly, both over the azimuths of a ring (circle of constant |(u, v)|)
# and over all rings. It is necessary because a surface that is dark at (u, v) and the few |w| in `_WS` may be bright at
# another |w| of the scattering vector (u, v, w). Such a direction must have a chance to be drawn.
_EVEN_SHARE = 0.05
# Number of grid cells per side of a block of the sky's latitude-longitude grid. All cells of a block have the same
# probability per solid angle. The value is limited by memory and by the time of drawing a direction, which are larger
# for smaller blocks.
_CELLS_OF_BLOCK = 4


def upload_sky(grid: SkyGrid, device: wp.Device) -> tuple[wp.array, ...]:
    """Copy a sky to a device: powers by direction, and the distribution from which bright directions are drawn."""
    arrays = _of_sky(grid)
    return (
        wp.array(grid.powers, dtype=wp.vec3f, device=device),
        *(wp.array(values, dtype=wp.float32, device=device) for values in arrays),
    )


def lookup_for_skies(lookup: ColourLookup | None) -> ColourLookup | None:
    """Return a look-up with the smaller colour table that suffices for skies, from a cache.

    For directional lights, the same picture may require a colour table with up to eight times as many rings (circles of
    constant |(u, v)|). A sky has three spectra, and each spectrum requires a table of its own. Three large tables would
    take too much memory and time. The smaller table suffices, because errors in single directions partly cancel in the
    sum over a sky.
    """
    if lookup is None:
        return None
    plan = lookup.plan
    rings, azimuths = polar_grid.size_for_skies(plan)
    if rings == plan.rings_per_octave:
        return lookup
    smaller = replace(plan, rings_per_octave=rings, azimuths_per_width=azimuths)
    result: ColourLookup = lookup.derived.get_or_make(smaller, lambda: lookup.copy_with(smaller))
    return result


def distribution_for(
    lookup: ColourLookup | None, illuminated: Sequence[Sequence[IlluminatedMaterial]], blocks: Sequence[wp.array], *,
    sky_share: float,
) -> sky_samples.SkyDistribution:  # fmt: skip
    """Return the distribution from which kernels draw directions to a sky, by the colours of surface and sky.

    The part of the distribution that depends on the surface alone is cached in ``lookup``.

    Args:
        lookup: Look-up of the surface's colours; None for a surface without a height field.
        illuminated: Three spectra of the sky with the materials that they illuminate, by material and spectrum.
        blocks: Cumulative probabilities, and probabilities per solid angle, of the sky's blocks (squares of grid
            cells), as :func:`upload_sky` returns them.
        sky_share: Fraction of the samples that are drawn by the brightness of the sky.
    """
    result = surface_distribution(lookup, illuminated, blocks[0].device)
    result.row_cdf, result.column_cdf, result.block_densities = blocks
    result.sky_share = sky_share
    return result


def distribution_of_blocks(blocks: Sequence[wp.array]) -> sky_samples.SkyDistribution:
    """Return the struct of :func:`distribution_for` for the sky alone; the fields for a surface are empty.

    A block is a square of cells of the sky's grid; ``blocks`` has the probabilities that :func:`upload_sky` returns.
    """
    result = sky_samples.SkyDistribution()
    result.row_cdf, result.column_cdf, result.block_densities = blocks
    return result


def surface_distribution(
    lookup: ColourLookup | None, illuminated: Sequence[Sequence[IlluminatedMaterial]], device: wp.Device
) -> sky_samples.SkyDistribution:
    """Return the struct of :func:`distribution_for` for the surface alone; the fields about the sky are empty.

    For a surface without a height field, the scattering vector (u, v) is drawn uniformly from a disc that contains all
    values of (u, v).
    """
    result = sky_samples.SkyDistribution()
    if lookup is None:
        of_surface = _of_plain_surface(device.alias)
    else:
        of_surface = lookup.derived.get_or_make(
            tuple(map(tuple, illuminated)), lambda: _of_surface(lookup, illuminated)
        )
    result.ring_cdf, result.starts, result.spoke_cdf, result.densities, result.least_log, result.per_log = of_surface
    return result


@functools.cache
def _of_plain_surface(device: str) -> tuple[wp.array | float, ...]:
    """Return the distribution for a surface without a height field.

    It is uniform over a disc that contains all scattering vectors (u, v).
    """
    ones = wp.full(1, 1.0, dtype=wp.float32, device=device)
    densities = wp.full(1, 1.0 / (math.pi * _FARTHEST**2), dtype=wp.float32, device=device)
    return ones, wp.array([0, 1], dtype=wp.int32, device=device), ones, densities, math.log(_FARTHEST), 1.0


def _of_surface(
    lookup: ColourLookup, illuminated: Sequence[Sequence[IlluminatedMaterial]]
) -> tuple[wp.array | float, ...]:
    """Return the probabilities with which scattering vectors (u, v) are drawn, by the colours of the surface alone.

    The probabilities are stored by rings (circles of constant |(u, v)|), and by azimuths on each ring.
    """
    lobe_uv = polar_grid.blur(lookup.plan.coherence) * polar_grid.MIDDLE_UM
    least = _DISC_RADIUS * lobe_uv
    per_log = _RINGS_PER_OCTAVE / math.log(2.0)
    rings = math.ceil(per_log * math.log(_FARTHEST / least))
    radii = np.append(0.0, least * np.exp((np.arange(rings) + 0.5) / per_log))
    spokes = np.clip(2.0 * math.pi * radii / (_SPOKES_APART * lobe_uv), _FEWEST_SPOKES, _MOST_SPOKES).astype(int)
    starts = np.append(0, np.cumsum(spokes))
    ring = np.repeat(np.arange(rings + 1), spokes)
    angle = 2.0 * math.pi * (np.arange(starts[-1]) - starts[ring] + 0.5) / spokes[ring]
    radius = radii[ring]
    outwards = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around = outwards[:, ::-1] * [-1.0, 1.0]
    across, along = _WIDTH / per_log * radius, _WIDTH * 2.0 * math.pi * radius / spokes[ring]
    footprints = np.concatenate([across[:, None] * outwards, along[:, None] * around], axis=1)
    bright = _luminances(lookup, illuminated, radius[:, None] * outwards, footprints)
    # The power of a sample of the polar grid is the X + Y + Z of its colour, times the area in (u, v) that it
    # represents.
    area = np.append(math.pi * least**2, radii[1:] ** 2 * 2.0 * math.pi / per_log)[ring] / spokes[ring]
    means = np.add.reduceat(bright, starts[:-1]) / spokes
    power = ((1.0 - _EVEN_SHARE) * bright + _EVEN_SHARE * means[ring] + 1e-30) * area
    of_rings = np.add.reduceat(power, starts[:-1])
    share_of_rings = (1.0 - _EVEN_SHARE) * of_rings / of_rings.sum() + _EVEN_SHARE / (rings + 1)
    probability = power / of_rings[ring] * share_of_rings[ring]
    size = np.where(ring == 0, math.pi * least**2, 2.0 * math.pi / per_log) / spokes[ring]
    cumulative = np.cumsum(power) - np.repeat(np.append(0.0, np.cumsum(of_rings)[:-1]), spokes)
    device = lookup.device
    arrays = share_of_rings.cumsum(), starts, cumulative / of_rings[ring], probability / size
    types = wp.float32, wp.int32, wp.float32, wp.float32
    uploaded = [wp.array(values, dtype=dtype, device=device) for values, dtype in zip(arrays, types, strict=True)]
    return *uploaded, math.log(least), per_log


def _luminances(
    lookup: ColourLookup, illuminated: Sequence[Sequence[IlluminatedMaterial]], places: NDArray[np.float64],
    footprints: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """Return the sum X + Y + Z of the light that a surface scatters, for n scattering vectors (u, v, w), shape (n,).

    ``places`` are (u, v). The result is a mean over the |w| in `_WS`, and a sum over materials and spectra of the
    light.
    """
    device, count = lookup.device, len(places)
    vectors = np.concatenate([np.column_stack([places, np.full(count, -w)]) for w in _WS])
    vectors_on_device = wp.array(vectors, dtype=wp.vec3d, device=device)
    spreads = wp.array(np.tile(footprints.astype(np.float32), (len(_WS), 1)), dtype=Footprint, device=device)
    to_lights = wp.zeros(len(vectors), dtype=wp.vec3f, device=device)
    gains = wp.full(len(vectors), 1.0, dtype=wp.float32, device=device)
    xyz = wp.zeros(len(vectors), dtype=wp.vec3f, device=device)
    for spectra in illuminated:
        for light in spectra:
            lookup.accumulate(vectors_on_device, to_lights, gains, light, xyz, footprints=spreads)
    return np.asarray(np.maximum(xyz.numpy().astype(np.float64), 0.0).sum(axis=1).reshape(len(_WS), count).mean(axis=0))


def _of_sky(grid: SkyGrid) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the distribution from which directions are drawn by the brightness of a sky.

    A block is a square of cells of the sky's grid. The arrays have the cumulative probability of rows of blocks, the
    cumulative probability of blocks within each row, and the probability per solid angle of each block.
    """
    bright = grid.powers.sum(axis=2)
    # Kernels interpolate the sky between the centres of cells, so that a bright cell brightens its neighbours. A
    # neighbour may be in another block. A cell therefore counts with the brightness of the brightest cell around it.
    bright = np.maximum.reduce([np.roll(bright, shift, axis=1) for shift in (-1, 0, 1)])
    bright[1:-1] = np.maximum.reduce([bright[:-2], bright[1:-1], bright[2:]])
    rows, columns = (size // _CELLS_OF_BLOCK for size in bright.shape)
    bright = bright.reshape(rows, _CELLS_OF_BLOCK, columns, _CELLS_OF_BLOCK).mean(axis=(1, 3), dtype=np.float64)
    solid = -np.diff(np.cos(np.arange(rows + 1) / rows * math.pi))[:, None] * 2.0 * math.pi / columns
    power = bright * solid + 1e-300
    power /= power.sum()
    of_rows = power.sum(axis=1)
    return np.cumsum(of_rows), np.cumsum(power, axis=1) / of_rows[:, None], power / solid
