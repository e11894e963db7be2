"""Colours of the samples of a picture as a function of the heights, with adjoint and tangent.

The colours are linear in the powers of the Fourier coefficients. If the coherence is an averaged window, and pixels
have no footprint (the range of (u, v) within a pixel), the colours are sums over the rings of a polar grid of the power
spectrum. A ring is a circle of constant frequency |(u, v)|/λ. The zeroth order is then a sum over wavelengths. In all
other cases, all colours are sums over wavelengths. As a test of the grid, the colours of bright samples and of random
samples are also computed as sums over wavelengths. The grid becomes finer until both results agree to the tolerance.

A group has the samples with one illuminant and material. κ = w/λ, where w is the normal component of the scattering
vector and λ the wavelength. The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from warpdiff.adjoint.coefficient_series import CoefficientSeries, SeriesSize
from warpdiff.adjoint.colour_splines import ring_count
from warpdiff.adjoint.gaussian_lobes import GaussianLobes, block_of, exponent_of
from warpdiff.adjoint.lobe_pyramid import LobePyramid
from warpdiff.adjoint.polar_grid_sums import PolarGridSums, RingGrid, RingSizes, kappa_margin
from warpdiff.adjoint.sites import Block
from warpdiff.adjoint.wavelength_sums import HIGH, LOW, PAIRS_TOGETHER, WavelengthSums
from warpdiff.core import memory
from warpdiff.image.error_model import luminance_floor
from warpdiff.kernels.polar_sums import MOST_TERMS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.adjoint.surfaces import Relief
    from warpdiff.optics.coherence import Coherence
    from warpdiff.render.picture_samples import LitPixels

# Sizes of polar grids, from coarse to fine: number of rings (circles of constant frequency) per octave, and number of
# azimuth samples per standard deviation of the peak of a diffraction order. The first grid whose error is within the
# tolerance is used.
_SIZES = (RingSizes(24, 1.3), RingSizes(32, 1.6), RingSizes(48, 2.0), RingSizes(96, 2.6))
# The error of a polar grid is measured on `_CHECKED` bright samples and the same number of random samples of each group
# (one illuminant and material). For at least the fraction `_SHARE` of these samples, it must be within the tolerance.
_CHECKED, _SHARE = 64, 0.95
# Permitted error of colours by truncated series of Fourier coefficients and truncated sums over them, divided by the
# tolerance of the colours.
_TRUNCATION_SHARE = 1e-2
# Memory of a call [bytes]: per height sample; per pair of a direction and a wavelength that is computed at once; and
# per reflectance of a material, which is stored for each direction at each ring (wavelength).
_BYTES_PER_SAMPLE, _BYTES_PER_PAIR, _BYTES_PER_REFLECTANCE = 120.0, 700.0, 60.0
_REMEDY = "take a smaller picture, {share} of the area of heightfield, or a larger tolerance"


class Colours(Protocol):
    """Colours of the samples of a picture, as a linear function of the powers of Fourier coefficients."""

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return XYZ of each group of samples (one illuminant and material), (n, 3), from the series of |H|²."""
        ...

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        """Add the adjoints of |H|² (derivatives of a loss) to ``rows``, shape (orders, k), for series of k terms.

        ``adjoints`` has those of XYZ of each group of samples (one illuminant and material). The function is the
        transpose of ``sums``.
        """
        ...


class PictureModel:
    """Colours of the samples of a picture, and their derivatives with respect to the heights."""

    def __init__(self, relief: Relief, groups: list[LitPixels], coherence: Coherence, tolerance: float) -> None:
        """Compute the colours of all samples of a picture.

        Args:
            relief: Height field or outline.
            groups: Groups of samples by illuminant and material; no group is empty.
            coherence: Coherence of the light: an averaged window, or a source.
            tolerance: Relative error of the colours.

        Raises:
            MemoryError: The colours require more memory than is free.
        """
        self._relief, self._groups, self._coherence, self._tolerance = relief, groups, coherence, tolerance
        self._truncation = _TRUNCATION_SHARE * tolerance
        self._exponent = exponent_of(self._truncation)
        has_rings = coherence.kind == "averaged" and all(group.footprints is None for group in groups)
        for sizes in _SIZES if has_rings else ():
            if (size := self._size_of_rings(sizes)) is None:
                continue
            self._colours: Colours = self._by_rings(sizes, size)
            self.values = self._colours.sums(self._coefficients)
            if self._is_accurate():
                return
        self._colours = self._by_wavelengths()
        self.values = self._colours.sums(self._coefficients)

    def adjoint(self, adjoints: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the adjoint (derivative of a loss) of the heights from those of XYZ of each group of samples.

        A group has one illuminant and material.
        """
        rows = np.zeros((self._series.block.size, self._series.rows.terms))
        self._colours.spread(adjoints, rows)
        return self._series.adjoint(rows)

    def tangent(self, change: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the change of XYZ of each group of samples, shape (n, 3), for a change of the heights [µm].

        A group has one illuminant and material.
        """
        return self._colours.sums(self._series.tangent(change))

    def _size_of_rings(self, sizes: RingSizes) -> SeriesSize | None:
        """Return the numbers of series terms for a polar grid; None if kernels have no memory for so many terms."""
        margin = kappa_margin(sizes)
        low, high = self._kappas()
        kappas = low / margin, high * margin
        # The series of a Fourier coefficient has more terms than its argument, the phase below; a larger argument
        # exceeds the limit of the kernels. This is tested first, because `SeriesSize.of` raises an error for very large
        # arguments. Sums over wavelengths have a smaller range of κ and may still be possible.
        if 2.0 * math.pi * (kappas[1] - kappas[0]) * self._relief.scale_um > MOST_TERMS:
            return None
        size = SeriesSize.of(self._relief, kappas, self._truncation, powers=True)
        return size if size.count <= MOST_TERMS else None

    def _by_rings(self, sizes: RingSizes, size: SeriesSize) -> Colours:
        """Compute the Fourier coefficients for a polar grid of frequencies; return the object that sums them."""
        relief, falloff = self._relief, 4.0 * (math.pi * (self._coherence.sigma_um or 1.0)) ** 2
        grid = RingGrid(self._groups, sizes, falloff)
        block = grid.block(self._exponent, relief.shape, relief.size_um)
        samples = sum(len(group.gains) for group in self._groups if group.illuminated.material is not None)
        self._begin(block, size, grid.rows, samples * ring_count(sizes.rings_per_octave))
        lobes = self._series.lobes(self._exponent)
        zeroth = _cell_of_zeroth(block)
        rings = PolarGridSums(grid, lobes, self._groups, zeroth)
        if zeroth < 0:
            return rings
        place = self._series.sites.places[[zeroth]]
        central = GaussianLobes(self._series.rows, Block((0, 0), (1, 1)), place, relief.size_um, self._exponent)
        near = [self._near_mirror(group, falloff) for group in self._groups]
        chosen = [group.among(samples) for group, samples in zip(self._groups, near, strict=True)]
        return _WithZeroth(rings, self._sums_over_wavelengths(chosen), central, near, zeroth)

    def _by_wavelengths(self) -> Colours:
        """Compute the Fourier coefficients for sums over wavelengths; return the object that sums them to colours."""
        sums = self._sums_over_wavelengths(self._groups)
        block = None
        for _, _, pairs, _, _ in sums.parts():
            own = block_of(pairs, self._exponent, self._relief.shape, self._relief.size_um)
            block = own if block is None else block.joined(own)
        assert block is not None  # noqa: S101 (groups are not empty)
        size = SeriesSize.of(self._relief, self._kappas(), self._truncation, powers=True)
        self._begin(block, size, 0, 0)
        return _OnLobes(sums, LobePyramid(self._series, self._relief.size_um, self._exponent))

    def _sums_over_wavelengths(self, groups: list[LitPixels]) -> WavelengthSums:
        return WavelengthSums(groups, self._coherence, self._truncation, 2.0 * self._relief.scale_um)

    def _kappas(self) -> tuple[float, float]:
        """Return the range of |κ| of all samples at visible wavelengths [1/µm]."""
        ws = np.concatenate([-group.scattering_vectors[:, 2] for group in self._groups])
        return LOW * float(ws.min()), HIGH * float(ws.max())

    def _begin(self, block: Block, size: SeriesSize, ring_values: int, reflectances: int) -> None:
        """Compute the Fourier coefficients of a block of orders; raise ``MemoryError`` first if memory is too small.

        Args:
            block: Rectangle of orders whose Fourier coefficients are computed.
            size: Range of |κ| = |w|/λ, and numbers of terms of the series of the coefficients.
            ring_values: Number of samples of the power spectrum on the rings (circles of constant frequency) of a polar
                grid; 0 without a grid.
            reflectances: Number of stored reflectances, one per direction and ring if the surface has a material.
        """
        ny, nx = self._relief.shape
        sites = min(block.size, ny * (nx // 2 + 1))
        memory.require_memory(
            _BYTES_PER_SAMPLE * self._relief.samples + 32.0 * size.terms * sites
            + 8.0 * size.count * (2 * sites + 3 * block.size + 2 * ring_values)
            + _BYTES_PER_REFLECTANCE * reflectances + (_BYTES_PER_PAIR + 16.0 * size.count) * PAIRS_TOGETHER,
            f"a gradient by {block.shape[0]} × {block.shape[1]} coefficients", _REMEDY,
        )  # fmt: skip
        self._series = CoefficientSeries(self._relief, block, size, powers=True)
        self._coefficients = self._series.powers()

    def _near_mirror(self, group: LitPixels, falloff: float) -> NDArray[np.int64]:
        """Return the indices of the samples near the mirror direction, at which the zeroth order is not negligible."""
        u, v, _ = group.scattering_vectors.T
        return np.flatnonzero(falloff * (u * u + v * v) * LOW**2 < self._exponent)

    def _is_accurate(self) -> bool:
        """Whether the colours of bright and of random samples agree with sums over wavelengths to the tolerance."""
        rng, floor = np.random.default_rng(0), luminance_floor(np.concatenate([xyz[:, 1] for xyz in self.values]))
        lobes, errors = self._series.lobes(self._exponent), []
        for group, xyz in zip(self._groups, self.values, strict=True):
            bright = np.argsort(-xyz[:, 1], kind="stable")[:_CHECKED]
            chosen = np.union1d(bright, rng.integers(len(xyz), size=_CHECKED))
            sums = self._sums_over_wavelengths([group.among(chosen)])
            (exact,) = sums.colours(lambda pairs: lobes.sums(pairs, self._coefficients))
            size = np.maximum(np.linalg.norm(exact, axis=1), floor)
            errors.append(np.linalg.norm(xyz[chosen] - exact, axis=1) / size)
        return bool(np.quantile(np.concatenate(errors), _SHARE) <= self._tolerance)


class _OnLobes:
    """Colours as sums over wavelengths of the Fourier coefficients of one block (rectangle) of orders."""

    def __init__(self, sums: WavelengthSums, lobes: LobePyramid) -> None:
        self._sums, self._lobes = sums, lobes

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        return self._sums.colours(self._lobes.sums_of(coefficients))

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        self._lobes.spread(self._sums.adjoints(adjoints), rows)


class _WithZeroth:
    """Colours as sums over rings of a polar grid (circles of constant frequency), plus the zeroth order near mirrors.

    The zeroth order is added only at samples near the mirror direction.
    """

    def __init__(
        self, rings: PolarGridSums, sums: WavelengthSums, lobes: GaussianLobes, near: list[NDArray[np.int64]],
        zeroth: int,
    ) -> None:  # fmt: skip
        self._rings, self._sums, self._lobes, self._near, self._zeroth = rings, sums, lobes, near, zeroth

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        result = self._rings.sums(coefficients)
        central = self._sums.colours(lambda pairs: self._lobes.sums(pairs, coefficients))
        for xyz, near, own in zip(result, self._near, central, strict=True):
            xyz[near] += own
        return result

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        self._rings.spread(adjoints, rows)
        of_near = [adjoint[near] for adjoint, near in zip(adjoints, self._near, strict=True)]
        for pairs, own in self._sums.adjoints(of_near):
            self._lobes.spread(pairs, own, rows[self._zeroth : self._zeroth + 1])


def _cell_of_zeroth(block: Block) -> int:
    """Return the index of the zeroth diffraction order in a block of orders; −1 if the block does not contain it."""
    row, column = -block.first[0], -block.first[1]
    inside = 0 <= row < block.shape[0] and 0 <= column < block.shape[1]
    return row * block.shape[1] + column if inside else -1
