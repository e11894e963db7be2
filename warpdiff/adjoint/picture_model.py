"""Colours of the samples of a picture as a function of the heights, with adjoint and tangent.

The colours are linear in the powers of the coefficients. Points under a window are sums over rings of a polar grid, and
the zeroth order is a sum over wavelengths. All other samples are sums over wavelengths. Some bright and some random
samples are computed in both ways: grids become finer until both agree to the tolerance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from warpdiff.adjoint.coefficient_series import CoefficientSeries, SeriesSize
from warpdiff.adjoint.gaussian_lobes import GaussianLobes, block_of, exponent_of
from warpdiff.adjoint.polar_grid_sums import PolarGridSums, RingGrid, RingSizes, kappa_margin
from warpdiff.adjoint.sites import Block
from warpdiff.adjoint.wavelength_sums import HIGH, LOW, PAIRS_TOGETHER, WavelengthSums
from warpdiff.core import memory
from warpdiff.image.error_model import luminance_floor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.adjoint.surfaces import Relief
    from warpdiff.optics.coherence import Coherence
    from warpdiff.render.picture_samples import LitPixels

# Sizes of polar grids, from which the first one whose error is within the tolerance is used.
_SIZES = (RingSizes(24, 1.3), RingSizes(32, 1.6), RingSizes(48, 2.0), RingSizes(96, 2.6))
# Numbers of bright and of random samples on which the error of a grid is measured, and the share of them that must be
# within the tolerance.
_CHECKED, _SHARE = 64, 0.95
# Relative size of the truncated terms of series and sums, as a share of the tolerance.
_TRUNCATION_SHARE = 1e-2
# Counted memory [bytes]: per height sample, and per pair of a direction and a wavelength that is computed at once.
_BYTES_PER_SAMPLE, _BYTES_PER_PAIR = 120.0, 700.0
_REMEDY = "take a smaller picture, {share} of the area of heightfield, or a larger tolerance"


class Colours(Protocol):
    """Colours of samples as a linear function of the powers of coefficients."""

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return XYZ of the samples of each group, shape (n, 3), for series of the coefficients."""
        ...

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        """Add to the rows of the block, shape (size, k), what the adjoints of XYZ of each group contribute."""
        ...


class PictureModel:
    """Colours of samples, and their derivatives by the heights."""

    def __init__(self, relief: Relief, groups: list[LitPixels], coherence: Coherence, tolerance: float) -> None:
        """Compute the colours.

        Args:
            relief: Height field.
            groups: Samples by illuminant and material, without empty groups.
            coherence: Averaged window, or source.
            tolerance: Relative error of the colours.

        Raises:
            MemoryError: The colours require more memory than is free.
        """
        self._relief, self._groups, self._coherence, self._tolerance = relief, groups, coherence, tolerance
        self._truncation = _TRUNCATION_SHARE * tolerance
        self._exponent = exponent_of(self._truncation)
        has_rings = coherence.kind == "averaged" and all(
            group.footprints is None and group.illuminated.material is None for group in groups
        )
        for sizes in _SIZES if has_rings else ():
            self._colours: Colours = self._by_rings(sizes)
            self.values = self._colours.sums(self._coefficients)
            if self._is_accurate():
                return
        self._colours = self._by_wavelengths()
        self.values = self._colours.sums(self._coefficients)

    def adjoint(self, adjoints: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the adjoint of the heights from those of XYZ of each group, shape (n, 3)."""
        rows = np.zeros((self._series.block.size, self._series.rows.terms))
        self._colours.spread(adjoints, rows)
        return self._series.adjoint(rows)

    def tangent(self, change: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the change of XYZ of each group, shape (n, 3), for a change of the heights [µm]."""
        return self._colours.sums(self._series.tangent(change))

    def _by_rings(self, sizes: RingSizes) -> Colours:
        """Return colours by a polar grid, and compute the coefficients that they require."""
        relief, falloff = self._relief, 4.0 * (math.pi * (self._coherence.sigma_um or 1.0)) ** 2
        grid = RingGrid(self._groups, sizes, falloff)
        margin = kappa_margin(sizes)
        low, high = self._kappas()
        block = grid.block(self._exponent, relief.shape, relief.size_um)
        self._begin(block, (low / margin, high * margin), grid.rows)
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
        """Return colours by wavelengths, and compute the coefficients that they require."""
        sums = self._sums_over_wavelengths(self._groups)
        block = None
        for _, _, pairs, _, _ in sums.parts():
            own = block_of(pairs, self._exponent, self._relief.shape, self._relief.size_um)
            block = own if block is None else block.joined(own)
        assert block is not None  # noqa: S101 (groups are not empty)
        self._begin(block, self._kappas(), 0)
        return _OnLobes(sums, self._series.lobes(self._exponent))

    def _sums_over_wavelengths(self, groups: list[LitPixels]) -> WavelengthSums:
        return WavelengthSums(groups, self._coherence, self._truncation, 2.0 * self._relief.scale_um)

    def _kappas(self) -> tuple[float, float]:
        """Return the range of |κ| of all samples at visible wavelengths [1/µm]."""
        ws = np.concatenate([-group.scattering_vectors[:, 2] for group in self._groups])
        return LOW * float(ws.min()), HIGH * float(ws.max())

    def _begin(self, block: Block, kappas: tuple[float, float], ring_values: int) -> None:
        """Compute the coefficients of a block; raise ``MemoryError`` before if they do not fit."""
        size = SeriesSize.of(self._relief, kappas, self._truncation, powers=True)
        ny, nx = self._relief.shape
        sites = min(block.size, ny * (nx // 2 + 1))
        memory.require_memory(
            _BYTES_PER_SAMPLE * self._relief.samples + 32.0 * size.terms * sites
            + 8.0 * size.count * (2 * sites + 3 * block.size + 2 * ring_values)
            + (_BYTES_PER_PAIR + 16.0 * size.count) * PAIRS_TOGETHER,
            f"a gradient by {block.shape[0]} × {block.shape[1]} coefficients", _REMEDY,
        )  # fmt: skip
        self._series = CoefficientSeries(self._relief, block, size, powers=True)
        self._coefficients = self._series.powers()

    def _near_mirror(self, group: LitPixels, falloff: float) -> NDArray[np.int64]:
        """Return the samples at which the zeroth order is not negligible."""
        u, v, _ = group.scattering_vectors.T
        return np.flatnonzero(falloff * (u * u + v * v) * LOW**2 < self._exponent)

    def _is_accurate(self) -> bool:
        """Whether the colours of bright and of random samples agree with sums over wavelengths."""
        rng, floor = np.random.default_rng(0), luminance_floor(np.concatenate([xyz[:, 1] for xyz in self.values]))
        lobes, errors = self._series.lobes(self._exponent), []
        for group, xyz in zip(self._groups, self.values, strict=True):
            bright = np.argsort(-xyz[:, 1], kind="stable")[:_CHECKED]
            chosen = np.union1d(bright, rng.integers(len(xyz), size=_CHECKED))
            (exact,) = self._sums_over_wavelengths([group.among(chosen)]).sums(lobes, self._coefficients)
            size = np.maximum(np.linalg.norm(exact, axis=1), floor)
            errors.append(np.linalg.norm(xyz[chosen] - exact, axis=1) / size)
        return bool(np.quantile(np.concatenate(errors), _SHARE) <= self._tolerance)


class _OnLobes:
    """Sums over wavelengths of the coefficients of one block."""

    def __init__(self, sums: WavelengthSums, lobes: GaussianLobes) -> None:
        self._sums, self._lobes = sums, lobes

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        return self._sums.sums(self._lobes, coefficients)

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        self._sums.spread(self._lobes, adjoints, rows)


class _WithZeroth:
    """Sums over rings, and the zeroth order at the samples near the mirror direction."""

    def __init__(
        self, rings: PolarGridSums, sums: WavelengthSums, lobes: GaussianLobes, near: list[NDArray[np.int64]],
        zeroth: int,
    ) -> None:  # fmt: skip
        self._rings, self._sums, self._lobes, self._near, self._zeroth = rings, sums, lobes, near, zeroth

    def sums(self, coefficients: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        result = self._rings.sums(coefficients)
        for xyz, near, own in zip(result, self._near, self._sums.sums(self._lobes, coefficients), strict=True):
            xyz[near] += own
        return result

    def spread(self, adjoints: list[NDArray[np.float64]], rows: NDArray[np.float64]) -> None:
        self._rings.spread(adjoints, rows)
        own = [adjoint[near] for adjoint, near in zip(adjoints, self._near, strict=True)]
        self._sums.spread(self._lobes, own, rows[self._zeroth : self._zeroth + 1])


def _cell_of_zeroth(block: Block) -> int:
    """Return the cell of a block with the order (0, 0), or −1."""
    row, column = -block.first[0], -block.first[1]
    inside = 0 <= row < block.shape[0] and 0 <= column < block.shape[1]
    return row * block.shape[1] + column if inside else -1
