"""Power spectrum on a polar grid of the frequency plane, and colours as sums over its rings, with transposes.

All steps from the series of Fourier coefficients to colours are linear. First, the spectrum is sampled on rings at
equally spaced azimuths. Second, cubic splines interpolate between azimuths. Third, a colour is a sum over the rings
between its longest and its shortest visible wavelength. A ring is a circle of frequencies q = (u, v)/λ of fixed
magnitude, for the wavelength λ and the scattering vector (u, v, w). A block of rings has consecutive rings with the
same number of azimuth samples; a block of orders is a rectangle of orders. κ is w/λ. A lobe is the Gaussian weight of a
coefficient in the spectrum, and σ is its standard deviation. The adjoint of a quantity is the derivative of a scalar
loss with respect to it.
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
from warpdiff.optics.colorimetry import VISIBLE_NM
from warpdiff.optics.materials import reflectance_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.adjoint.gaussian_lobes import GaussianLobes
    from warpdiff.render.picture_samples import LitPixels

# Distance of the samples of the power spectrum along a radius of the frequency plane, in standard deviations of its
# lobes. Each lobe is the Gaussian peak of one Fourier coefficient. At this distance, a sum of equal Gaussians varies by
# only 2 exp(−2π²/1.5²) = 3e-4.
_SAMPLE_SPACING_SIGMAS = 1.5
# Radius around the origin of the frequency plane within which the power spectrum counts as constant, in standard
# deviations of its lobes (Gaussian peaks). A Gaussian changes by at most 0.02²/2 = 2e-4 within this radius of its
# centre.
_FLAT_WITHIN_SIGMAS = 0.02
# Smallest number of azimuth samples of a ring (circle of constant frequency). With this number, the four samples
# between which a value is interpolated are different.
_FEWEST_AZIMUTHS = 16
# The power spectrum is sampled at the azimuths (polar angles) of the directions' (u, v), and at this number of further
# azimuths on both sides of them. At this distance, a value changes the coefficient of a cubic spline by only 0.27^16 =
# 8e-10 of itself.
_NEIGHBOURS = 16
# Number of cosines of the angle of incidence at which the reflectance of a material is tabulated, for each whole
# nanometre. For metals, the error of linear interpolation is at most 1e-5. If the error is larger, the comparison of
# colours in `PictureModel` rejects the grid.
_ANGLES = 513
# Longest and shortest visible wavelength [µm].
_RED_UM, _BLUE_UM = 1e-3 * colorimetry.LAMBDA_MAX_NM, 1e-3 * colorimetry.LAMBDA_MIN_NM
# Numbers of azimuth samples of the polar grid, of cells (orders) and of directions that a thread processes together.
# Some of them require much more time than others. Larger numbers would therefore distribute the work unevenly.
_AZIMUTHS_OF_SLICE, _CELLS_OF_SLICE, _PIXELS_OF_SLICE = 64, 1024, 512


@dataclass(frozen=True)
class RingSizes:
    """Size of a polar grid of spatial frequencies.

    Attributes:
        rings_per_octave: Number of rings (circles of constant frequency) per octave (factor of 2) of the frequency.
        azimuths_per_sigma: Number of azimuth samples per standard deviation of the lobes (Gaussian peaks) of the power
            spectrum.
    """

    rings_per_octave: int
    azimuths_per_sigma: float

    @property
    def step(self) -> float:
        """Difference of the natural logarithm of the frequency between neighbouring rings (circles of the grid)."""
        return math.log(2.0) / self.rings_per_octave


def kappa_margin(sizes: RingSizes) -> float:
    """Return the factor by which the range of κ = w/λ is widened at both ends.

    The reason is that rings (circles of constant frequency) extend beyond the visible wavelengths.
    """
    return math.exp(4.0 * sizes.step)


class RingGrid:
    """Rings and azimuths at which the power spectrum of a surface is sampled for some directions.

    Attributes:
        sizes: Size of the polar grid: rings (circles of constant frequency) and azimuth samples.
        log_first: Natural logarithm of the frequency of the innermost ring [1/µm].
        azimuths: Number of azimuth samples of a ring, for each block (group of consecutive rings).
        rows: Number of samples of the power spectrum on all rings together.
    """

    def __init__(self, groups: list[LitPixels], sizes: RingSizes, falloff: float) -> None:
        """Choose the rings (circles) and azimuth samples of the polar grid for the directions of some groups.

        Args:
            groups: Groups of directions by illuminant and material.
            sizes: Size of the grid.
            falloff: Factor a [µm²] of the weights exp(−a d²) of Fourier coefficients at the distance d [1/µm].
        """
        self.sizes, self._falloff, self._sigma = sizes, falloff, 1.0 / math.sqrt(2.0 * falloff)
        step = sizes.step
        radii = [self.radii_of(group) for group in groups]
        # A colour is a sum over rings (circles of constant |(u, v)|/λ). For one direction they extend from two rings
        # inside that of the longest visible wavelength to two rings outside that of the shortest.
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
        """Return |(u, v)| of the n directions of a group, shape (n,).

        Near the mirror direction, |(u, v)| is replaced by a lower limit, because a ring of the grid (circle of constant
        |(u, v)|/λ) cannot have the radius 0.
        """
        least = _FLAT_WITHIN_SIGMAS * self._sigma * _BLUE_UM
        return np.asarray(np.maximum(np.hypot(*group.scattering_vectors[:, :2].T), least))

    def places(self, radii: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the fractional index of the ring |(u, v)|/λ at λ = 780 nm, for directions with given |(u, v)|."""
        return np.asarray((np.log(radii / _RED_UM) - self.log_first) / self.sizes.step)

    def _mark(self, group: LitPixels, places: NDArray[np.float64]) -> None:
        """Mark the azimuth samples that the directions of a group use, and neighbours for spline interpolation."""
        first = np.ceil(places).astype(np.int64) - 2
        turns, count = turns_of(group), ring_count(self.sizes.rings_per_octave)
        for block, azimuths in enumerate(self.azimuths.tolist()):
            uses = (first < (block + 1) * BLOCK_RINGS) & (first + count > block * BLOCK_RINGS)
            own = np.unique(np.floor(turns[uses] * azimuths).astype(np.int64))
            near = own[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
            self._is_used[block][near.ravel() % azimuths] = True

    @property
    def directions(self) -> int:
        """Number of azimuth samples, added over all blocks (groups of rings with equally many azimuth samples)."""
        return int(self.azimuths.sum())

    @property
    def groups(self) -> int:
        """Number of groups of consecutive rings of the polar grid; one thread sums the adjoints of one group."""
        return int(self._blocks * BLOCK_RINGS // TOGETHER)

    def _radii(self, block: int) -> NDArray[np.float64]:
        """Return the frequencies at which the power spectrum is sampled in a block of consecutive rings [1/µm]."""
        count = int(self._divisions[block])
        places = (np.arange((BLOCK_RINGS + 2) * count) + 0.5) / count - 1.5
        return np.asarray(np.exp(self._log_firsts[block] + self.sizes.step * places))

    def _angles(self, block: int) -> NDArray[np.float64]:
        return np.asarray(2.0 * math.pi * np.arange(self.azimuths[block]) / self.azimuths[block])

    def block(self, exponent: float, shape: tuple[int, int], size_um: tuple[float, float]) -> Block:
        """Return the smallest rectangle of orders with all Fourier coefficients that samples on the grid require.

        Weights below e^−exponent are neglected. Along an axis with a single height sample, the only order is 0.
        """
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
        """Return the polar grid as the struct of the kernels.

        ``excluded`` is the index, in the block of orders, of a Fourier coefficient to omit; −1 omits none.
        """
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
    """Colours of directions from samples of the power spectrum on a polar grid of frequencies.

    The colours are a linear function of the Chebyshev series of the powers of Fourier coefficients.
    """

    def __init__(self, grid: RingGrid, lobes: GaussianLobes, groups: list[LitPixels], excluded: int) -> None:
        """Compute the positions of the directions on the polar grid.

        Args:
            grid: Polar grid that was chosen for these directions.
            lobes: Block of orders, and the Chebyshev series of their Fourier coefficients.
            groups: Groups of directions by illuminant and material.
            excluded: Index, in the block of orders, of a coefficient that is omitted from the sums, or −1.
        """
        self._lobes, self._rings, self._struct = lobes, grid, grid.struct(excluded)
        self._where = {"device": resolve_device(None), "threads": resolve_threads(None)}
        self._pixels = [self._placed(group) for group in groups]

    def _placed(self, group: LitPixels) -> _Placed:
        """Return the directions of a group, sorted by their positions on the polar grid, in the form of the kernels."""
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
        if group.illuminated.material is not None:
            reflectances = self._reflectances(group.among(order), curves.shape[1])
            pixels.reflectances = wp.array(reflectances, dtype=wp.float64, device="cpu")
        pixels.least_kappa, pixels.places_per_kappa = low, 2.0 / (high - low)
        # The colour of a direction is a sum over consecutive rings (circles of the grid), and the directions are sorted
        # by their first rings. The directions that use any ring of a group of rings are therefore consecutive; `begins`
        # and `ends` are their limits.
        first = np.ceil(places[order]).astype(np.int64) - 2
        groups = TOGETHER * np.arange(self._rings.groups)
        begins = np.searchsorted(first, groups - curves.shape[1] + 1)
        ends = np.searchsorted(first, groups + TOGETHER)
        pixels.begins = wp.array(begins.astype(np.int32), dtype=wp.int32, device="cpu")
        pixels.ends = wp.array(ends.astype(np.int32), dtype=wp.int32, device="cpu")
        return _Placed(pixels, order)

    def _reflectances(self, group: LitPixels, count: int) -> NDArray[np.float64]:
        """Return the material's reflectance per direction at the wavelengths of its rings (circles), (n, count)."""
        from scipy import ndimage

        material = group.illuminated.material
        assert material is not None  # noqa: S101 (callers have checked it)
        radii = self._rings.radii_of(group)
        first = np.ceil(self._rings.places(radii)) - 2.0
        frequencies = np.exp(self._rings.log_first + self._rings.sizes.step * (first[:, None] + np.arange(count)))
        nm = np.clip(1e3 * radii[:, None] / frequencies, VISIBLE_NM[0], VISIBLE_NM[-1])
        cosines = np.minimum(0.5 * np.linalg.norm(group.scattering_vectors, axis=1), 1.0)
        table = reflectance_at(material, VISIBLE_NM, np.linspace(0.0, 1.0, _ANGLES)[:, None])
        places = np.stack([np.broadcast_to((_ANGLES - 1) * cosines[:, None], nm.shape), nm - VISIBLE_NM[0]])
        return np.asarray(ndimage.map_coordinates(table, places, order=1))

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return XYZ of the directions of each group, shape (n, 3), from the Chebyshev series of the powers |H|²."""
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
        """Add the adjoints of the powers |H|² to ``rows``, shape (orders, k): the transpose of ``sums``.

        ``adjoints`` has the derivatives of a loss with respect to XYZ of each group of directions, shape (n, 3).
        """
        values = np.zeros((self._rings.rows, rows.shape[1]))
        for placed, adjoint in zip(self._pixels, adjoints, strict=True):
            placed.pixels.adjoints = wp.array(adjoint[placed.order], dtype=wp.float64, device="cpu")
            launch(
                polar_sums.spread_pixels_to_rings, self._rings.groups, [self._struct, placed.pixels],
                [_shared(values)], slice_size=1, **self._where,
            )  # fmt: skip
        # The matrix of the spline interpolation over azimuths is symmetric, so that the same function is its transpose.
        self._filter(values)
        table = self._lobes.table(np.zeros((1, rows.shape[1])))
        launch(
            polar_sums.spread_spectrum_rings, len(rows), [table, self._struct, _shared(values)], [_shared(rows)],
            slice_size=_CELLS_OF_SLICE, **self._where,
        )  # fmt: skip

    def _filter(self, values: NDArray[np.float64]) -> None:
        """Replace samples of the power spectrum along azimuth by coefficients of their interpolating cubic splines."""
        from scipy import ndimage

        begin = 0
        for azimuths in self._rings.azimuths.tolist():
            end = begin + BLOCK_RINGS * azimuths
            block = values[begin:end].reshape(BLOCK_RINGS, azimuths, -1)
            ndimage.spline_filter1d(block, 3, axis=1, output=block, mode="grid-wrap")
            begin = end


@dataclass(frozen=True)
class _Placed:
    """Directions of a group (one illuminant and material) in the form that the kernels require.

    Attributes:
        pixels: The struct ``PolarPixels`` of the kernels.
        order: Index in the group of each direction in the struct.
    """

    pixels: polar_sums.PolarPixels
    order: NDArray[np.int64]


def turns_of(group: LitPixels) -> NDArray[np.float64]:
    """Return the azimuths of (u, v) of the directions of a group [turns], 0 to 1, shape (n,)."""
    u, v, _ = group.scattering_vectors.T
    turns = np.arctan2(v, u) / (2.0 * math.pi) % 1.0
    # A tiny negative angle is rounded to 1 turn, which is the same angle as 0.
    return np.where(turns < 1.0, turns, 0.0)


def _starts(counts: NDArray[np.int32]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)[:-1]])


def _shared(values: NDArray[np.float64]) -> wp.array:
    """Return a Warp array that uses the memory of a NumPy array without a copy."""
    return wp.array(values, dtype=wp.float64, device="cpu", copy=False)
