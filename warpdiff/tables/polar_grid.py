"""Polar grid of colour tables: sizes, errors, and the layout of rings, azimuth samples and mip levels.

The spectrum under a window, averaged or centred, is smooth: its Fourier transform is the surface's autocorrelation
under exp(−r²/4σ²). A table that resolves it, in logarithmic polar coordinates, holds the integral over λ of any number
of orders, and serves every light and view. ``colour_table`` makes it, once for a height field and a coherence.

A source blurs (u, v) by the same at all wavelengths, and so does what a pixel sees of it: a table of lines, hardly
blurred, is blurred at look-up by both. Lines that a grazing source blurs less than the table does, and what surrounds
the mirror direction, are left to sampling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.kernels.colour_lookup import HALF_TAPS
from warpdiff.optics import colorimetry
from warpdiff.tables import coefficient_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.request.plan import Plan

# Samples along an azimuth, in standard deviations of the spectrum's blur, where they are furthest apart: a sum of
# Gaussians is constant to 2 exp(−2π²/1.6²) = 9e-4 there, to 1e-13 at the octave's other end, and nodes are means of
# some samples.
_SAMPLE_SPACING_SIGMAS = 1.6
# From node to node at least so many, or a node's spline is no integral.
_FEWEST_DIVISIONS = 2.0
# The spectrum is flat to (1/50)²/2 = 2e-4 within this share of a standard deviation.
_FLAT_WITHIN_SIGMAS = 0.02
_FEWEST_AZIMUTHS = 16
# A wavelength in the middle [µm].
MIDDLE_UM = 0.55
# A source's lines are blurred by so many distances of azimuths, which makes them smooth splines, ...
_LINE_BLUR_SPACINGS = 0.8
# ... of which there are more by this factor: the less they are blurred, the less of a grazing source is left over.
_MORE_AZIMUTHS_OF_SOURCES = 1.5
# In deviations of a source: within, its blur is no range of angles and ratios.
_INNER_RADIUS_SPREADS = 30.0
# Azimuths of a level that is blurred for footprints, in a standard deviation of all its blur; the widest of these
# [rad].
_BLURRED_AZIMUTHS_PER_WIDTH = 1.2
_WIDEST_BLUR_RAD = 0.4
LOG_RED, LOG_BLUE = (math.log(1e3 / end) for end in (colorimetry.LAMBDA_MAX_NM, colorimetry.LAMBDA_MIN_NM))
# Nodes an octave and azimuths in a standard deviation of the blur, of which either errs as much as the other.
TABLE_SIZES = ((8, 0.9), (12, 1.0), (16, 1.1), (24, 1.3), (32, 1.5), (48, 1.8), (64, 2.1), (96, 2.6), (128, 3.0))
# Errors fall with this power of the nodes.
ERROR_ORDER = 2.0
# Orders so many standard deviations of the blur apart hardly touch.
_ORDERS_APART_SIGMAS = 4.0
# A table that is much larger than this takes longer to make than it saves.
MOST_MEGABYTES = 300.0


@dataclass(frozen=True)
class MipLayout:
    """Where the nodes of a table lie.

    The spectrum is sampled on octaves of frequencies. A node of |(u, v)| has the number of the frequency at its red
    end, and its octave's colours reach into the next one, whose azimuths it takes.

    Attributes:
        nodes: Nodes an octave.
        log_low: ln t of the first node.
        spectrum_azimuths: Azimuths of each octave of frequencies: as many as the one before, or twice as many.
        divisions: Samples from one node to the next, of each of them.
        blurs: Of each octave of |(u, v)|, the spectrum's own blur [rad].
        azimuths: Azimuths of each level and octave of |(u, v)|.
        level_blurs: What these are blurred by besides [rad].
        highest: Largest frequency that is looked up [1/µm].
    """

    rings_per_octave: int
    log_low: float
    spectrum_azimuths: tuple[int, ...]
    divisions: tuple[int, ...]
    blurs: tuple[float, ...]
    azimuths: tuple[tuple[int, ...], ...]
    level_blurs: tuple[tuple[float, ...], ...]
    highest: float

    @classmethod
    def for_plan(cls, plan: Plan, highest: float) -> MipLayout:
        """The layout for a plan and the largest frequency, without levels."""
        step = math.log(2.0) / plan.rings_per_octave
        if plan.coherence.kind == "source":
            return cls._for_lines(plan, highest, step)
        width = blur(plan.coherence)
        # A colour takes up to three nodes beyond its octave, and look-ups two more.
        top = math.log(max(highest, width)) + 5.0 * step
        octaves = max(math.ceil((top - math.log(_FLAT_WITHIN_SIGMAS * width)) / math.log(2.0)), 2)
        log_low = top - octaves * math.log(2.0)
        tops = np.exp(log_low + math.log(2.0) * (np.arange(octaves) + 1.0))
        divisions = np.maximum(np.ceil(tops * step / (_SAMPLE_SPACING_SIGMAS * width)), _FEWEST_DIVISIONS)
        most = 2.0 * math.pi * tops[-1] / width * plan.azimuths_per_width
        doublings = min(max(math.floor(math.log2(most / _FEWEST_AZIMUTHS)), 0), octaves - 1)
        # A multiple of those that are projected side by side.
        fewest = max(4 * math.ceil(most / 4.0 / 2.0**doublings), _FEWEST_AZIMUTHS)
        of_spectrum = fewest * 2 ** np.maximum(np.arange(octaves) - (octaves - 1 - doublings), 0)
        return cls(
            plan.rings_per_octave, log_low, tuple(of_spectrum.tolist()), tuple(divisions.astype(int).tolist()),
            tuple((width / tops[1:]).tolist()), (tuple(of_spectrum[1:].tolist()),), ((0.0,) * (octaves - 1),), highest,
        )  # fmt: skip

    @classmethod
    def _for_lines(cls, plan: Plan, highest: float, step: float) -> MipLayout:
        """A layout for a source, whose rows each octave of |(u, v)| takes from coefficients as they are."""
        spread = plan.coherence.spread
        # Look-ups take some nodes on either side.
        top = math.log(highest) + LOG_RED - LOG_BLUE + 3.0 * step
        low = math.log(inner_radius(plan.coherence)) + LOG_RED - 4.0 / _INNER_RADIUS_SPREADS
        octaves = max(math.ceil((top - low) / math.log(2.0)), 1)
        log_low = top - octaves * math.log(2.0)
        tops = np.exp(log_low + math.log(2.0) * (np.arange(octaves) + 1.0) - LOG_RED)
        azimuths = np.maximum(
            4 * np.ceil(2.0 * math.pi * tops / spread * plan.azimuths_per_width / 4.0), _FEWEST_AZIMUTHS
        )
        # Whole numbers that are refused for their memory.
        azimuths = np.minimum(azimuths, 2.0**60)
        blurs = _LINE_BLUR_SPACINGS * 2.0 * math.pi / azimuths
        counts = tuple(azimuths.astype(int).tolist())
        return cls(
            plan.rings_per_octave, log_low, (), (), tuple(blurs.tolist()), (counts,), ((0.0,) * octaves,), highest
        )

    def with_mip_levels(self) -> MipLayout:
        """The layout with mip levels, for footprints and for sources."""
        narrow = np.asarray(self.azimuths[0])
        azimuths, level_blurs = [narrow], [np.zeros(len(narrow))]
        first = 2.0 * math.pi / narrow
        levels = math.ceil(math.log2(_WIDEST_BLUR_RAD / float(first.min()))) + 1
        for level in range(levels):
            # An octave that is blurred enough already goes on as it is.
            blurred = np.minimum(first * 2.0**level, np.maximum(_WIDEST_BLUR_RAD, first))
            total = np.hypot(self.blurs, blurred)
            fewer = np.ceil(2.0 * math.pi / total * _BLURRED_AZIMUTHS_PER_WIDTH)
            azimuths.append(np.clip(fewer, _FEWEST_AZIMUTHS, narrow))
            level_blurs.append(blurred)
        return replace(
            self,
            azimuths=tuple(tuple(values.astype(int).tolist()) for values in azimuths),
            level_blurs=tuple(tuple(values.tolist()) for values in level_blurs),
        )

    @property
    def starts(self) -> NDArray[np.int64]:
        """The row of each octave's azimuth 0 among the spectrum's samples, and at the end the number of all."""
        return np.cumsum([0, *(azimuths * self.rings_per_octave for azimuths in self.spectrum_azimuths)])

    @property
    def first_rows(self) -> NDArray[np.int64]:
        """The row of each level's and octave's azimuth 0, and at the end the number of all rows."""
        counts = (np.asarray(self.azimuths).ravel() + 2 * HALF_TAPS) * self.rings_per_octave
        first = np.append(np.full(len(counts), HALF_TAPS * self.rings_per_octave), 0)
        return np.asarray(np.concatenate([[0], np.cumsum(counts)]) + first)

    def source(self, level: int, octave: int) -> int:
        """The widest level that another can be made from: what it lacks of the blur spans its azimuths."""
        width = self.level_blurs[level][octave]
        spacings = [2.0 * math.pi / azimuths[octave] for azimuths in self.azimuths[:level]]
        lacking = [width**2 - blurs[octave] ** 2 for blurs in self.level_blurs[:level]]
        return max((k for k in range(level) if lacking[k] >= spacings[k] ** 2), default=0)

    @property
    def rows(self) -> int:
        """Rows of the table, of any number."""
        return sum((azimuths + 2 * HALF_TAPS) * self.rings_per_octave for level in self.azimuths for azimuths in level)

    @property
    def level0_rows(self) -> int:
        """Rows that are projected, from which levels are made."""
        return sum(self.azimuths[0]) * self.rings_per_octave

    @property
    def samples(self) -> int:
        """Samples of the spectrum that fill it."""
        return sum(
            n * d * (self.rings_per_octave + 2) for n, d in zip(self.spectrum_azimuths, self.divisions, strict=True)
        )


def has_mip_levels(plan: Plan) -> bool:
    """Whether look-ups of a plan's table are blurred."""
    return plan.uses_footprints or plan.coherence.kind == "source"


def inner_radius(coherence: Coherence) -> float:
    """The |(u, v)| from which on a table serves: within, the blur of a source is no range of angles and ratios."""
    return _INNER_RADIUS_SPREADS * coherence.spread


def blur(coherence: Coherence) -> float:
    """Standard deviation of the power spectrum's blur [1/µm]; that of a source is at a middle wavelength."""
    if coherence.sigma_um is None:
        return coherence.spread / MIDDLE_UM
    return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um)


def ring_count(rings_per_octave: int) -> int:
    """Nodes that a colour takes of a table with so many an octave."""
    return math.ceil((LOG_BLUE - LOG_RED) / math.log(2.0) * rings_per_octave) + 3


def table_error(rings_per_octave: int, *, few_orders: bool = False) -> float:
    """Error of colours from a table of a surface with many orders in sight, or with a few that stand apart."""
    return float((0.024 if few_orders else 0.008) * (20.0 / rings_per_octave) ** 1.7)


def orders_are_separate(heightfield: HeightField, coherence: Coherence) -> bool:
    """Whether a patch is so small that its orders are further apart than the spectrum's blur spreads them."""
    lengths = [length for n, length in zip(heightfield.shape, heightfield.size_um, strict=True) if n > 1]
    return max(lengths, default=0.0) * _ORDERS_APART_SIGMAS * blur(coherence) < 1.0


def table_sizes(coherence: Coherence) -> list[tuple[int, float]]:
    """Nodes an octave and azimuths in a standard deviation of the blur that tables come in, the smallest first."""
    factor = _MORE_AZIMUTHS_OF_SOURCES if coherence.kind == "source" else 1.0
    return [(rings_per_octave, factor * azimuths) for rings_per_octave, azimuths in TABLE_SIZES]


def smallest_sufficient_size(plan: Plan) -> tuple[int, float] | None:
    """The smallest size that may keep a plan's tolerance."""
    return next(
        (table_size for table_size in table_sizes(plan.coherence) if table_error(table_size[0]) <= plan.tolerance), None
    )


def megabytes(plan: Plan) -> float:
    """Size of a table, of about as many functions of w as there are terms where these are not said."""
    return layout_of(plan).rows * 3 * (plan.w_basis_size or plan.terms) * 4e-6


def layout_of(plan: Plan) -> MipLayout:
    """The layout of a plan's table, with its levels if it has any."""
    layout = MipLayout.for_plan(plan, coefficient_table.CoefficientRange.covering(plan.direction_range).frequency)
    return layout.with_mip_levels() if has_mip_levels(plan) else layout
