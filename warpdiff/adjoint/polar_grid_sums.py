"""Power spectrum on a polar grid of the frequency plane, and colours as sums over its rings, with transposes.

The steps from rows of coefficients to colours are linear: sampling of the spectrum on rings and azimuths, interpolation
between azimuths by cubic splines, and sums over the rings between the longest and the shortest visible wavelength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.adjoint.colour_splines import curve_weights, ring_count
from warpdiff.adjoint.sites import Block
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.device.kernel_calls import launch
from warpdiff.kernels import polar_sums
from warpdiff.kernels.polar_sums import BLOCK_RINGS, TOGETHER
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.adjoint.gaussian_lobes import GaussianLobes
    from warpdiff.render.picture_samples import LitPixels

# Distance of samples of the spectrum along the radius, in standard deviations of its lobes. Derived: a sum of Gaussians
# at this distance varies by 2 exp(−2π²/1.5²) = 3e-4.
_SAMPLE_SPACING_SIGMAS = 1.5
# Radius within which the spectrum counts as constant, in standard deviations of its lobes. Derived: a Gaussian of this
# width changes by at most (1/50)²/2 = 2e-4.
_FLAT_WITHIN_SIGMAS = 0.02
# Smallest number of azimuth samples of a ring. Limit: four consecutive ones are distinct.
_FEWEST_AZIMUTHS = 16
# Number of azimuths on either side of a used one at which the spectrum is sampled, too. Derived: the coefficient of a
# cubic spline depends on a value at this distance by 0.27^16 = 8e-10.
_NEIGHBOURS = 16
# Longest and shortest visible wavelength [µm].
_RED_UM, _BLUE_UM = 1e-3 * colorimetry.LAMBDA_MAX_NM, 1e-3 * colorimetry.LAMBDA_MIN_NM
# Numbers of elements per launch on a thread. Limits: elements of one launch differ in cost.
_AZIMUTHS_OF_SLICE, _CELLS_OF_SLICE, _PIXELS_OF_SLICE = 64, 1024, 512


@dataclass(frozen=True)
class RingSizes:
    """Size of a polar grid.

    Attributes:
        rings_per_octave: Number of rings per octave of the radius.
        azimuths_per_sigma: Number of azimuth samples per standard deviation of the lobes of the spectrum.
    """

    rings_per_octave: int
    azimuths_per_sigma: float

    @property
    def step(self) -> float:
        """Distance of rings in the logarithm of the radius."""
        return math.log(2.0) / self.rings_per_octave


def kappa_margin(sizes: RingSizes) -> float:
    """Return the factor by which the rings of a colour exceed the visible range of κ at both ends."""
    return math.exp(4.0 * sizes.step)


class RingGrid:
    """Rings and azimuths at which the spectrum is sampled for given directions.

    Attributes:
        sizes: Size of the grid.
        log_first: ln of the frequency of the innermost ring.
        azimuths: Number of azimuths of the rings of each block.
        rows: Number of values on all rings.
    """

    def __init__(self, groups: list[LitPixels], sizes: RingSizes, falloff: float) -> None:
        """Choose the rings.

        Args:
            groups: Directions by illuminant.
            sizes: Size of the grid.
            falloff: Factor a [µm²] of the weights exp(−a d²) of coefficients.
        """
        self.sizes, self._falloff, self._sigma = sizes, falloff, 1.0 / math.sqrt(2.0 * falloff)
        step = sizes.step
        radii = [self.radii_of(group) for group in groups]
        # A colour uses rings from two before the longest wavelength to two beyond the shortest one.
        low = min(float(part.min()) for part in radii) / _RED_UM * math.exp(-3.0 * step)
        high = max(float(part.max()) for part in radii) / _BLUE_UM * math.exp(4.0 * step)
        self._blocks: int = math.ceil(math.log(high / low) / (BLOCK_RINGS * step))
        self.log_first = math.log(low)
        self._log_firsts = self.log_first + step * BLOCK_RINGS * np.arange(self._blocks)
        ends = np.exp(self._log_firsts + (BLOCK_RINGS + 0.5) * step)
        azimuths = np.ceil(2.0 * math.pi * ends / self._sigma * sizes.azimuths_per_sigma).astype(np.int32)
        self.azimuths = np.maximum(azimuths, _FEWEST_AZIMUTHS)
        self._divisions = np.maximum(np.ceil(ends * step / (_SAMPLE_SPACING_SIGMAS * self._sigma)), 2).astype(np.int32)
        self.rows = int(BLOCK_RINGS * self.azimuths.sum())
        self._is_used = [np.zeros(count, dtype=bool) for count in self.azimuths.tolist()]
        for group, part in zip(groups, radii, strict=True):
            self._mark(group, self.places(part))

    def radii_of(self, group: LitPixels) -> NDArray[np.float64]:
        """Return |(u, v)| of directions, and a small number near the mirror direction, shape (n,)."""
        least = _FLAT_WITHIN_SIGMAS * self._sigma * _BLUE_UM
        return np.asarray(np.maximum(np.hypot(*group.scattering_vectors[:, :2].T), least))

    def places(self, radii: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions of the longest wavelength among the rings, for |(u, v)| of directions."""
        return np.asarray((np.log(radii / _RED_UM) - self.log_first) / self.sizes.step)

    def _mark(self, group: LitPixels, places: NDArray[np.float64]) -> None:
        """Mark the azimuths that directions use, and their neighbours on which the coefficients of splines depend."""
        first = np.ceil(places).astype(np.int64) - 2
        turns, count = turns_of(group), ring_count(self.sizes.rings_per_octave)
        for block, azimuths in enumerate(self.azimuths.tolist()):
            uses = (first < (block + 1) * BLOCK_RINGS) & (first + count > block * BLOCK_RINGS)
            own = np.unique(np.floor(turns[uses] * azimuths).astype(np.int64))
            near = own[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
            self._is_used[block][near.ravel() % azimuths] = True

    @property
    def directions(self) -> int:
        """Number of azimuths of all blocks."""
        return int(self.azimuths.sum())

    @property
    def groups(self) -> int:
        """Number of groups of rings that one thread of a transposed sum processes."""
        return int(self._blocks * BLOCK_RINGS // TOGETHER)

    def _radii(self, block: int) -> NDArray[np.float64]:
        """Return the frequencies of the samples of the spectrum in a block [1/µm]."""
        count = int(self._divisions[block])
        places = (np.arange((BLOCK_RINGS + 2) * count) + 0.5) / count - 1.5
        return np.asarray(np.exp(self._log_firsts[block] + self.sizes.step * places))

    def _angles(self, block: int) -> NDArray[np.float64]:
        return np.asarray(2.0 * math.pi * np.arange(self.azimuths[block]) / self.azimuths[block])

    def block(self, exponent: float, shape: tuple[int, int], size_um: tuple[float, float]) -> Block:
        """Return the block of all coefficients that the samples sum. An axis of a single sample has order 0 only."""
        reach = math.sqrt(exponent / self._falloff)
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for block, is_used in enumerate(self._is_used):
            if not is_used.any():
                continue
            angles, radii = self._angles(block)[is_used], self._radii(block)
            ends = radii[[0, -1], None, None] * np.stack([np.sin(angles), np.cos(angles)])
            low, high = np.minimum(low, ends.min(axis=(0, 2))), np.maximum(high, ends.max(axis=(0, 2)))
        first = np.where(np.array(shape) > 1, np.floor((low - reach) * size_um), 0.0).astype(int)
        last = np.where(np.array(shape) > 1, np.ceil((high + reach) * size_um), 0.0).astype(int)
        counts = last - first + 1
        return Block((int(first[0]), int(first[1])), (int(counts[0]), int(counts[1])))

    def struct(self, excluded: int) -> polar_sums.RingBlocks:
        """Return the struct of the kernels, without one cell of the block of coefficients; −1 excludes none."""
        blocks = range(self._blocks)
        radii, angles = [self._radii(block) for block in blocks], np.concatenate([self._angles(b) for b in blocks])
        grid = polar_sums.RingBlocks()
        counts = {
            "azimuths": self.azimuths, "divisions": self._divisions, "starts": _starts(BLOCK_RINGS * self.azimuths),
            "first_directions": _starts(self.azimuths), "first_radii": _starts(np.array([len(part) for part in radii])),
            "block_of": np.repeat(np.arange(self._blocks), self.azimuths),
        }  # fmt: skip
        for name, values in counts.items():
            setattr(grid, name, wp.array(values.astype(np.int32), dtype=wp.int32, device="cpu"))
        grid.is_used = wp.array(np.concatenate(self._is_used), dtype=wp.bool, device="cpu")
        grid.directions = wp.array(np.stack([np.cos(angles), np.sin(angles)], axis=1), dtype=wp.vec2d, device="cpu")
        grid.radii = wp.array(np.concatenate(radii), dtype=wp.float64, device="cpu")
        grid.log_first, grid.step, grid.falloff, grid.excluded = (
            self.log_first, self.sizes.step, self._falloff, excluded,
        )  # fmt: skip
        return grid


class PolarGridSums:
    """Colours of directions by a polar grid of the power spectrum, as a linear function of rows of coefficients."""

    def __init__(self, grid: RingGrid, lobes: GaussianLobes, groups: list[LitPixels], excluded: int) -> None:
        """Place the directions on the grid.

        Args:
            grid: Rings for these directions.
            lobes: Block of coefficients and their series.
            groups: Directions by illuminant.
            excluded: Cell of the block that is not summed, or −1.
        """
        self._lobes, self._rings, self._struct = lobes, grid, grid.struct(excluded)
        self._where = {"device": resolve_device(None), "threads": resolve_threads(None)}
        self._pixels = [self._placed(group) for group in groups]

    def _placed(self, group: LitPixels) -> _Placed:
        """Return the directions of a group in ascending order of their places on the grid."""
        radii = self._rings.radii_of(group)
        places = self._rings.places(radii)
        order = np.argsort(places, kind="stable")
        pixels = polar_sums.PolarPixels()
        curves = curve_weights(group.illuminated.illuminant, self._rings.sizes.rings_per_octave)
        low, high = self._lobes.series.kappas
        columns = {
            "places": places, "turns": turns_of(group), "slopes": -group.scattering_vectors[:, 2] / radii,
            "gains": group.gains,
        }  # fmt: skip
        for name, values in columns.items():
            setattr(pixels, name, wp.array(values[order], dtype=wp.float64, device="cpu"))
        pixels.curves = wp.array(curves, dtype=wp.float64, device="cpu")
        pixels.least_kappa, pixels.places_per_kappa = low, 2.0 / (high - low)
        # A direction uses consecutive rings, of which each group of rings has some.
        first = np.ceil(places[order]).astype(np.int64) - 2
        groups = TOGETHER * np.arange(self._rings.groups)
        begins = np.searchsorted(first, groups - curves.shape[1] + 1)
        ends = np.searchsorted(first, groups + TOGETHER)
        pixels.begins = wp.array(begins.astype(np.int32), dtype=wp.int32, device="cpu")
        pixels.ends = wp.array(ends.astype(np.int32), dtype=wp.int32, device="cpu")
        return _Placed(pixels, order)

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return XYZ of the directions of each group, shape (n, 3), for series of the coefficients."""
        table = self._lobes.table(coefficients)
        values = np.zeros((self._rings.rows, coefficients.shape[1]))
        launch(
            polar_sums.sample_spectrum_rings, self._rings.directions, [table, self._struct], [_shared(values)],
            slice_size=_AZIMUTHS_OF_SLICE, **self._where,
        )  # fmt: skip
        self._filter(values)
        result = []
        for placed in self._pixels:
            xyz = np.empty((len(placed.order), 3))
            inputs = [self._struct, _shared(values), placed.pixels]
            launch(
                polar_sums.sum_rings_of_pixels, len(xyz), inputs, [_shared(xyz)], slice_size=_PIXELS_OF_SLICE,
                **self._where,
            )  # fmt: skip
            in_order = np.empty_like(xyz)
            in_order[placed.order] = xyz
            result.append(in_order)
        return result

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        """Add to the rows of the block, shape (size, k), what the adjoints of XYZ of each group contribute."""
        values = np.zeros((self._rings.rows, rows.shape[1]))
        for placed, adjoint in zip(self._pixels, adjoints, strict=True):
            placed.pixels.adjoints = wp.array(adjoint[placed.order], dtype=wp.float64, device="cpu")
            launch(
                polar_sums.spread_pixels_to_rings, self._rings.groups, [self._struct, placed.pixels],
                [_shared(values)], slice_size=1, **self._where,
            )  # fmt: skip
        # The filter is symmetric, and therefore its own transpose.
        self._filter(values)
        table = self._lobes.table(np.zeros((1, rows.shape[1])))
        launch(
            polar_sums.spread_spectrum_rings, len(rows), [table, self._struct, _shared(values)], [_shared(rows)],
            slice_size=_CELLS_OF_SLICE, **self._where,
        )  # fmt: skip

    def _filter(self, values: NDArray[np.float64]) -> None:
        """Replace values at azimuths by coefficients of the cubic splines through them."""
        from scipy import ndimage

        begin = 0
        for azimuths in self._rings.azimuths.tolist():
            end = begin + BLOCK_RINGS * azimuths
            block = values[begin:end].reshape(BLOCK_RINGS, azimuths, -1)
            ndimage.spline_filter1d(block, 3, axis=1, output=block, mode="grid-wrap")
            begin = end


@dataclass(frozen=True)
class _Placed:
    """Directions of a group as the kernels read them.

    Attributes:
        pixels: Struct of the kernels.
        order: Index of each direction of the struct in the group.
    """

    pixels: polar_sums.PolarPixels
    order: NDArray[np.int64]


def turns_of(group: LitPixels) -> NDArray[np.float64]:
    """Return the polar angles of (u, v) of directions [turns], 0 to 1, shape (n,)."""
    u, v, _ = group.scattering_vectors.T
    turns = np.arctan2(v, u) / (2.0 * math.pi) % 1.0
    # A tiny negative angle becomes 1 by rounding.
    return np.where(turns < 1.0, turns, 0.0)


def _starts(counts: NDArray[np.int32]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)[:-1]])


def _shared(values: NDArray[np.float64]) -> wp.array:
    """Return a Warp array that shares the memory of a NumPy array."""
    return wp.array(values, dtype=wp.float64, device="cpu", copy=False)
