"""Layout of a colour table: the grids of the spectrum and of the mip levels, their blurs, and where their rows lie."""

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

# Samples along an azimuth where they are furthest apart, in standard deviations of the spectrum's blur: a sum of
# Gaussians is constant to 2 exp(−2π²/1.6²) = 9e-4 there, to 1e-13 at the octave's other end, and rings are means of
# several samples.
_SAMPLE_SPACING_SIGMAS = 1.6
# Limit: samples from ring to ring; with fewer, a ring's spline is no integral.
_FEWEST_DIVISIONS = 2.0
# The spectrum is flat to (1/50)²/2 = 2e-4 within this share of a standard deviation.
_FLAT_WITHIN_SIGMAS = 0.02
# Blur of a source's lines, in distances of azimuth samples: it makes them smooth splines.
_LINE_BLUR_SPACINGS = 0.8
# Azimuth samples of a level that is blurred for footprints, per standard deviation of all its blur; the widest blur of
# a level [rad].
_BLURRED_AZIMUTHS_PER_WIDTH = 1.2
# Largest blur of a mip level [rad].
_WIDEST_BLUR_RAD = 0.4
# Limit: numbers of samples are integers of 64 bits, until a table is refused for its memory.
_MOST_AZIMUTHS = 2.0**60


@dataclass(frozen=True)
class MipLayout:
    """Grids of a colour table, and the order of its rows: level, octave, azimuth, ring, slowest first.

    A ring of |(u, v)| has the number of the frequency at its red end, and its octave's colours reach into the next
    octave of frequencies, whose azimuths it takes.

    Attributes:
        spectrum: Grid of frequencies [1/µm] from which level 0 is projected.
        divisions: Samples of the spectrum from ring to ring, by octave; 0 for lines, which are gathered.
        blurs: Blur of the spectrum itself, by octave of |(u, v)| [rad].
        levels: Grids of |(u, v)|, level by level.
        level_blurs: Further blur of each level and octave [rad].
        highest: Largest frequency that is looked up [1/µm].
    """

    spectrum: PolarGrid
    divisions: tuple[int, ...]
    blurs: tuple[float, ...]
    levels: tuple[PolarGrid, ...]
    level_blurs: tuple[tuple[float, ...], ...]
    highest: float

    @classmethod
    def for_plan(cls, plan: Plan, highest: float) -> MipLayout:
        """The layout for a plan and the largest frequency, with level 0 alone."""
        return (cls._of_lines if plan.coherence.kind == "source" else cls._of_window)(plan, highest)

    @classmethod
    def _of_window(cls, plan: Plan, highest: float) -> MipLayout:
        """The layout for a window, under which the spectrum is smooth."""
        rings, width = plan.rings_per_octave, blur(plan.coherence)
        step = math.log(2.0) / rings
        # A colour takes up to three rings beyond its octave, and look-ups two more.
        top = math.log(max(highest, width)) + 5.0 * step
        octaves = max(math.ceil((top - math.log(_FLAT_WITHIN_SIGMAS * width)) / math.log(2.0)), 2)
        log_low = top - octaves * math.log(2.0)
        tops = np.exp(log_low + math.log(2.0) * (np.arange(octaves) + 1.0))
        divisions = np.maximum(np.ceil(tops * step / (_SAMPLE_SPACING_SIGMAS * width)), _FEWEST_DIVISIONS)
        most = 2.0 * math.pi * tops[-1] / width * plan.azimuths_per_width
        doublings = min(max(math.floor(math.log2(most / polar_grid.FEWEST_AZIMUTHS)), 0), octaves - 1)
        # A multiple of those that are projected together.
        fewest = max(4 * math.ceil(most / 4.0 / 2.0**doublings), polar_grid.FEWEST_AZIMUTHS)
        azimuths = tuple((fewest * 2 ** np.maximum(np.arange(octaves) - (octaves - 1 - doublings), 0)).tolist())
        level0 = PolarGrid(rings, log_low - LOG_RED, azimuths[1:])
        return cls(
            PolarGrid(rings, log_low, azimuths), tuple(divisions.astype(int).tolist()),
            tuple((width / tops[1:]).tolist()), (level0,), ((0.0,) * (octaves - 1),), highest,
        )  # fmt: skip

    @classmethod
    def _of_lines(cls, plan: Plan, highest: float) -> MipLayout:
        """The layout for a source, whose lines are gathered at the rings and azimuths of level 0."""
        rings, spread = plan.rings_per_octave, plan.coherence.spread
        step = math.log(2.0) / rings
        # Look-ups take some rings on either side.
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
        """The layout with all mip levels, for footprints and for sources."""
        narrow = np.asarray(self.levels[0].azimuths)
        first = 2.0 * math.pi / narrow
        levels, level_blurs = [self.levels[0]], [self.level_blurs[0]]
        for level in range(math.ceil(math.log2(_WIDEST_BLUR_RAD / float(first.min()))) + 1):
            # An octave that is blurred enough already stays unchanged.
            blurred = np.minimum(first * 2.0**level, np.maximum(_WIDEST_BLUR_RAD, first))
            total = np.hypot(self.blurs, blurred)
            fewer = np.ceil(2.0 * math.pi / total * _BLURRED_AZIMUTHS_PER_WIDTH)
            azimuths = np.clip(fewer, polar_grid.FEWEST_AZIMUTHS, narrow).astype(int)
            levels.append(replace(self.levels[0], azimuths=tuple(azimuths.tolist())))
            level_blurs.append(tuple(blurred.tolist()))
        return replace(self, levels=tuple(levels), level_blurs=tuple(level_blurs))

    @property
    def first_rows(self) -> NDArray[np.int64]:
        """The row of azimuth 0 of each level and octave, shape (levels, octaves)."""
        first = np.cumsum([0, *self._row_counts[:-1]]) + HALF_TAPS * self.levels[0].rings
        return np.asarray(first.reshape(len(self.levels), -1))

    @property
    def rows(self) -> int:
        """Number of rows, with those of azimuths that are repeated on either side of a turn."""
        return sum(self._row_counts)

    @property
    def _row_counts(self) -> list[int]:
        return [grid.rings * (azimuths + 2 * HALF_TAPS) for grid in self.levels for azimuths in grid.azimuths]

    @property
    def samples(self) -> int:
        """Samples of the spectrum that fill its grid."""
        grid = self.spectrum
        return sum(n * d * (grid.rings + 2) for n, d in zip(grid.azimuths, self.divisions, strict=True))

    def source(self, level: int, octave: int) -> int:
        """The widest level that another can be made from: what it lacks of the blur spans its azimuths."""
        width = self.level_blurs[level][octave]
        spacings = [2.0 * math.pi / grid.azimuths[octave] for grid in self.levels[:level]]
        lacking = [width**2 - blurs[octave] ** 2 for blurs in self.level_blurs[:level]]
        return max((k for k in range(level) if lacking[k] >= spacings[k] ** 2), default=0)


def has_mip_levels(plan: Plan) -> bool:
    """Whether look-ups in a plan's table are blurred."""
    return plan.uses_footprints or plan.coherence.kind == "source"


def megabytes(plan: Plan) -> float:
    """Size of a plan's table; a plan without a number of functions of w has about as many as terms."""
    return layout_of(plan).rows * 3 * (plan.w_basis_size or plan.terms) * 4e-6


def layout_of(plan: Plan) -> MipLayout:
    """The layout of a plan's table, with its mip levels if it has any."""
    layout = MipLayout.for_plan(plan, coefficient_table.CoefficientRange.covering(plan.direction_range).frequency)
    return layout.with_mip_levels() if has_mip_levels(plan) else layout
