"""Layout of a colour table: grids of the spectrum and of the mip levels, blurs of the grids, and order of rows.

A mip level is a blurred copy of the table with fewer samples. A ring is a circle of a polar grid, and an octave is the
set of rings between one radius and twice this radius. "Source" means a light source of finite size (coherence of the
kind "source"); its spectrum is a sum of spectral lines.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.kernels.colour_lookup import HALF_TAPS
from warpdiff.tables import coefficient_table, polar_grid
from warpdiff.tables.polar_grid import LOG_BLUE, LOG_RED, PolarGrid, azimuth_counts, blur, inner_radius

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.request.plan import Plan

# Largest distance along the radius between samples of the spectrum, in standard deviations of the blur by the coherence
# window. The number was derived from a sum of equal Gaussians at this distance, which varies by 2 exp(−2π²/1.6²) =
# 9e-4. At the inner end of each octave, the distance is half as large, and the variation is 1e-13.
_SAMPLE_SPACING_SIGMAS = 1.6
# The spectrum is integrated along the radius, from one ring (circle) to the next. This is the smallest number of
# samples per ring. The 99th percentile of the error was measured: 7e-4 with one sample, and 2e-5 with two samples.
_FEWEST_DIVISIONS = 2.0
# Radius of the innermost ring (circle of constant |(u, v)|/λ), in standard deviations of the spectrum's blur by the
# coherence window. The number was derived from a Gaussian of this width: within the radius, it deviates from a constant
# by at most (1/50)²/2 = 2e-4.
_FLAT_WITHIN_SIGMAS = 0.02
# Standard deviation by which the spectral lines under a light source are blurred in a colour table, in distances of
# azimuth samples. Splines represent lines of this width accurately.
_LINE_BLUR_SPACINGS = 0.8
# Number of azimuth samples of a mip level per standard deviation of the total blur of this level along the azimuth.
_BLURRED_AZIMUTHS_PER_WIDTH = 1.2
# Largest standard deviation of the blur that a mip level adds to level 0, as an angle of azimuth [rad].
_WIDEST_BLUR_RAD = 0.4
# Largest number of azimuth samples of a table's ring (circle). Larger numbers, which would overflow 64-bit integers,
# are replaced by it. A table with so many samples is refused later, by a ``MemoryError``.
_MOST_AZIMUTHS = 2.0**60


@dataclass(frozen=True)
class MipLayout:
    """Layout of a colour table: its grids, and the order of its rows (by mip level, then octave, azimuth and ring).

    The grid of |(u, v)| has the radii of the grid of frequencies, times the longest visible wavelength. At the longest
    wavelength, octave k of |(u, v)| therefore corresponds to octave k of the frequencies. At shorter wavelengths the
    frequencies of this octave of |(u, v)| are higher, so that its colours also use octave k + 1 of the frequencies. For
    a coherence window, octave k of |(u, v)| has as many azimuth samples as octave k + 1 of the frequencies.

    Attributes:
        spectrum: Grid of frequencies [1/µm] from which level 0 is projected.
        divisions: Number of spectrum samples along the radius from one ring (circle) to the next, for each octave; 0
            for spectral lines.
        blurs: Standard deviation of the blur that the spectrum itself has along the azimuth [rad], for each octave of
            |(u, v)|.
        levels: Grid of |(u, v)| for each mip level.
        level_blurs: Standard deviation of the blur that each mip level adds along the azimuth [rad], for each octave.
        highest: Largest frequency of a look-up [1/µm].
    """

    spectrum: PolarGrid
    divisions: tuple[int, ...]
    blurs: tuple[float, ...]
    levels: tuple[PolarGrid, ...]
    level_blurs: tuple[tuple[float, ...], ...]
    highest: float

    @classmethod
    def for_plan(cls, plan: Plan, highest: float) -> MipLayout:
        """Return the layout of a plan's table with mip level 0 only, for frequencies up to ``highest`` [1/µm]."""
        return (cls._of_lines if plan.coherence.kind == "source" else cls._of_window)(plan, highest)

    @classmethod
    def _of_window(cls, plan: Plan, highest: float) -> MipLayout:
        """Return the layout of a colour table for a coherence window, whose power spectrum is smooth and is sampled."""
        rings, width = plan.rings_per_octave, blur(plan.coherence)
        step = math.log(2.0) / rings
        # A colour uses up to three rings (circles of constant frequency) beyond its octave of frequencies, and the
        # spline of a look-up uses two further rings. The outermost octave of frequencies therefore ends five rings
        # beyond the largest frequency.
        top = math.log(max(highest, width)) + 5.0 * step
        octaves = max(math.ceil((top - math.log(_FLAT_WITHIN_SIGMAS * width)) / math.log(2.0)), 2)
        log_low = top - octaves * math.log(2.0)
        tops = np.exp(log_low + math.log(2.0) * (np.arange(octaves) + 1.0))
        divisions = np.maximum(np.ceil(tops * step / (_SAMPLE_SPACING_SIGMAS * width)), _FEWEST_DIVISIONS)
        most = 2.0 * math.pi * tops[-1] / width * plan.azimuths_per_width
        doublings = min(max(math.floor(math.log2(most / polar_grid.FEWEST_AZIMUTHS)), 0), octaves - 1)
        # The number of azimuth samples is a multiple of 4, because the kernel that converts the spectrum to colours
        # processes four of them at once.
        fewest = max(4 * math.ceil(most / 4.0 / 2.0**doublings), polar_grid.FEWEST_AZIMUTHS)
        azimuths = tuple((fewest * 2 ** np.maximum(np.arange(octaves) - (octaves - 1 - doublings), 0)).tolist())
        level0 = PolarGrid(rings, log_low - LOG_RED, azimuths[1:])
        return cls(
            PolarGrid(rings, log_low, azimuths), tuple(divisions.astype(int).tolist()),
            tuple((width / tops[1:]).tolist()), (level0,), ((0.0,) * (octaves - 1),), highest,
        )  # fmt: skip

    @classmethod
    def _of_lines(cls, plan: Plan, highest: float) -> MipLayout:
        """Return the layout of a colour table for a light source of finite size, whose spectrum is a sum of lines."""
        rings, spread = plan.rings_per_octave, plan.coherence.spread
        step = math.log(2.0) / rings
        # The grid ends three rings (circles) beyond the largest frequency, because the spline of a look-up uses these
        # rings, too.
        top = math.log(highest) + LOG_RED - LOG_BLUE + 3.0 * step
        low = math.log(inner_radius(plan.coherence)) + LOG_RED - 4.0 / polar_grid.INNER_RADIUS_SPREADS
        octaves = max(math.ceil((top - low) / math.log(2.0)), 1)
        log_low = top - octaves * math.log(2.0)
        tops = np.exp(log_low + math.log(2.0) * (np.arange(octaves) + 1.0) - LOG_RED)
        counts = np.minimum(azimuth_counts(tops, spread, plan.azimuths_per_width), _MOST_AZIMUTHS)
        azimuths, blurs = tuple(counts.astype(int).tolist()), _LINE_BLUR_SPACINGS * 2.0 * math.pi / counts
        return cls(
            PolarGrid(rings, log_low, azimuths), (0,) * octaves, tuple(blurs.tolist()),
            (PolarGrid(rings, log_low - LOG_RED, azimuths),), ((0.0,) * octaves,), highest,
        )  # fmt: skip

    def with_mip_levels(self) -> MipLayout:
        """Return the layout with all mip levels, as means over footprints or over light sources require."""
        narrow = np.asarray(self.levels[0].azimuths)
        first = 2.0 * math.pi / narrow
        levels, level_blurs = [self.levels[0]], [self.level_blurs[0]]
        for level in range(math.ceil(math.log2(_WIDEST_BLUR_RAD / float(first.min()))) + 1):
            # The blur of an octave of |(u, v)| doubles from mip level to mip level, up to ``_WIDEST_BLUR_RAD``. All
            # further levels have the same grid in this octave.
            blurred = np.minimum(first * 2.0**level, np.maximum(_WIDEST_BLUR_RAD, first))
            total = np.hypot(self.blurs, blurred)
            fewer = np.ceil(2.0 * math.pi / total * _BLURRED_AZIMUTHS_PER_WIDTH)
            azimuths = np.clip(fewer, polar_grid.FEWEST_AZIMUTHS, narrow).astype(int)
            levels.append(replace(self.levels[0], azimuths=tuple(azimuths.tolist())))
            level_blurs.append(tuple(blurred.tolist()))
        return replace(self, levels=tuple(levels), level_blurs=tuple(level_blurs))

    @property
    def first_rows(self) -> NDArray[np.int64]:
        """Index of the first row at azimuth 0 in each mip level and octave of |(u, v)|, shape (levels, octaves)."""
        first = np.cumsum([0, *self._row_counts[:-1]]) + HALF_TAPS * self.levels[0].rings
        return np.asarray(first.reshape(len(self.levels), -1))

    @property
    def rows(self) -> int:
        """Total number of rows of the table, including azimuth samples repeated at both ends of each ring (circle)."""
        return sum(self._row_counts)

    @property
    def _row_counts(self) -> list[int]:
        return [grid.rings * (azimuths + 2 * HALF_TAPS) for grid in self.levels for azimuths in grid.azimuths]

    @property
    def samples(self) -> int:
        """Number of samples of the spectrum that are computed for the grid of frequencies."""
        grid = self.spectrum
        return sum(n * d * (grid.rings + 2) for n, d in zip(grid.azimuths, self.divisions, strict=True))

    def source(self, level: int, octave: int) -> int:
        """Return the less blurred mip level from which one octave (of |(u, v)|) of ``level`` is computed by a blur.

        The result is the most blurred level that permits an accurate further blur: the standard deviation of this blur
        is at least the distance of azimuth samples in the returned level.
        """
        width = self.level_blurs[level][octave]
        spacings = [2.0 * math.pi / grid.azimuths[octave] for grid in self.levels[:level]]
        lacking = [width**2 - blurs[octave] ** 2 for blurs in self.level_blurs[:level]]
        return max((k for k in range(level) if lacking[k] >= spacings[k] ** 2), default=0)


def has_mip_levels(plan: Plan) -> bool:
    """Whether the table of a plan has mip levels (blurred copies), for means over footprints or over a light source."""
    return plan.uses_footprints or plan.coherence.kind == "source"


def megabytes(plan: Plan) -> float:
    """Return the size of a plan's table [MB].

    If the plan does not state the number of functions of w (the normal component) in the table, the number of basis
    terms replaces it.
    """
    return layout_of(plan).rows * 3 * (plan.w_basis_size or plan.terms) * 4e-6


def layout_of(plan: Plan) -> MipLayout:
    """Return the layout of the table that a plan describes, with mip levels if look-ups in the table are blurred."""
    layout = MipLayout.for_plan(plan, coefficient_table.CoefficientRange.covering(plan.direction_range).frequency)
    return layout.with_mip_levels() if has_mip_levels(plan) else layout
