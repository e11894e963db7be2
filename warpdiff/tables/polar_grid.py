"""Polar grids of (u, v) and of frequencies, and the sizes of colour tables on them.

The spectrum under a window, averaged or centred, is smooth: its Fourier transform is the surface's autocorrelation
under exp(−r²/4σ²). A table that resolves it, in logarithmic polar coordinates, holds the integral over λ of any number
of orders, and serves every light and view. ``colour_table`` makes it, once for a height field and a coherence.

A source blurs (u, v) by the same at all wavelengths, and so does what a pixel sees of it: a table of lines, hardly
blurred, is blurred at look-up by both. Lines that a grazing source blurs less than the table does, and what surrounds
the mirror direction, are left to sampling.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.request.plan import Plan

# Limit: azimuth samples of the innermost rings.
FEWEST_AZIMUTHS = 16
# Wavelength in the middle of the visible range [µm].
MIDDLE_UM = 0.55
# Tables of a source have more azimuth samples by this factor: the less its lines are blurred, the fewer grazing
# directions remain for sampling.
_MORE_AZIMUTHS_OF_SOURCES = 1.5
# |(u, v)| in standard deviations of a source, below which its blur is no range of angles and ratios.
INNER_RADIUS_SPREADS = 30.0
LOG_RED, LOG_BLUE = (
    math.log(colorimetry.NM_PER_UM / end) for end in (colorimetry.LAMBDA_MAX_NM, colorimetry.LAMBDA_MIN_NM)
)
# Rings per octave, and azimuth samples per standard deviation of the blur that have about the same error.
TABLE_SIZES = ((8, 0.9), (12, 1.0), (16, 1.1), (24, 1.3), (32, 1.5), (48, 1.8), (64, 2.1), (96, 2.6), (128, 3.0))
# Errors fall with this power of the number of rings.
ERROR_ORDER = 2.0
# Orders so many standard deviations of the blur apart hardly overlap.
_ORDERS_APART_SIGMAS = 4.0
# Share of the tolerance that the table of a sky is expected to need; the scatter of samples needs the rest. Fitted: at
# a tolerance of 0.1, colours under a smooth sky at 80° are wrong by 2.4 % with a share of 1, by under 2 % with this.
_SHARE_OF_SKIES = 1.0 / 3.0
# Limit: a much larger table takes longer to make than it saves [MB].
MOST_MEGABYTES = 300.0


@dataclass(frozen=True)
class PolarGrid:
    """Rings around the origin of a plane whose radii have equal ratios, with samples at equal steps of the azimuth.

    Rings are numbered from the innermost one on, and the samples of a ring from the first axis of the plane on.

    Attributes:
        rings: Rings per octave of the radius.
        log_radius: ln of the first ring's radius.
        azimuths: Number of samples on each ring of each octave, the innermost octave first.
    """

    rings: int
    log_radius: float
    azimuths: tuple[int, ...]

    @property
    def nodes(self) -> int:
        """Number of samples on all rings."""
        return self.rings * sum(self.azimuths)

    @property
    def ring_azimuths(self) -> NDArray[np.int64]:
        """Number of samples on each ring."""
        return np.repeat(self.azimuths, self.rings)

    @property
    def starts(self) -> NDArray[np.int64]:
        """Number of samples before each ring, and at the end that of all."""
        return np.concatenate([[0], np.cumsum(self.ring_azimuths)])

    @property
    def radii(self) -> NDArray[np.float64]:
        """Radii of the rings, shape (octaves, rings)."""
        octaves = np.arange(len(self.azimuths))[:, None] + np.arange(self.rings) / self.rings
        return np.asarray(np.exp(self.log_radius + octaves * math.log(2.0)))

    def places(self) -> NDArray[np.float64]:
        """Places of all samples in the plane, ring by ring, shape (nodes, 2)."""
        azimuths = self.ring_azimuths
        node = np.arange(self.nodes) - np.repeat(self.starts[:-1], azimuths)
        angles = 2.0 * math.pi * node / np.repeat(azimuths, azimuths)
        radii = np.repeat(self.radii.ravel(), azimuths)
        return np.asarray(radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def azimuth_counts(radii: NDArray[np.floating[Any]], width: float, per_width: float) -> NDArray[np.float64]:
    """Samples on circles of some radii, ``per_width`` of them per ``width`` of a lobe: multiples of 4."""
    return np.asarray(np.maximum(4.0 * np.ceil(2.0 * math.pi * radii / width * per_width / 4.0), FEWEST_AZIMUTHS))


def inner_radius(coherence: Coherence) -> float:
    """The |(u, v)| from which on a table serves: within, the blur of a source is no range of angles and ratios."""
    return INNER_RADIUS_SPREADS * coherence.spread


def blur(coherence: Coherence) -> float:
    """Standard deviation of the power spectrum's blur [1/µm]; that of a source is at a middle wavelength."""
    if coherence.sigma_um is None:
        return coherence.spread / MIDDLE_UM
    return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um)


def ring_count(rings_per_octave: int) -> int:
    """Rings of a table that a colour takes, with so many per octave."""
    return math.ceil((LOG_BLUE - LOG_RED) / math.log(2.0) * rings_per_octave) + 3


def table_error(rings_per_octave: int, *, few_orders: bool = False) -> float:
    """Error of colours from a table of a surface with many orders in sight, or with a few separate ones."""
    return float((0.024 if few_orders else 0.008) * (20.0 / rings_per_octave) ** 1.7)


def orders_are_separate(heightfield: HeightField, coherence: Coherence) -> bool:
    """Whether a patch is so small that its orders are further apart than the spectrum's blur spreads them."""
    lengths = [length for n, length in zip(heightfield.shape, heightfield.size_um, strict=True) if n > 1]
    return max(lengths, default=0.0) * _ORDERS_APART_SIGMAS * blur(coherence) < 1.0


def table_sizes(coherence: Coherence) -> list[tuple[int, float]]:
    """Rings per octave and azimuth samples per standard deviation of the blur that tables have, the smallest first."""
    factor = _MORE_AZIMUTHS_OF_SOURCES if coherence.kind == "source" else 1.0
    return [(rings_per_octave, factor * azimuths) for rings_per_octave, azimuths in TABLE_SIZES]


def smallest_sufficient_size(plan: Plan, share: float = 1.0) -> tuple[int, float] | None:
    """Return the smallest size whose expected error is at most a share of a plan's tolerance; None if there is none."""
    sizes = table_sizes(plan.coherence)
    return next((size for size in sizes if table_error(size[0]) <= share * plan.tolerance), None)


def size_for_skies(plan: Plan) -> tuple[int, float]:
    """Return the size of the tables that colours under a sky are looked up in, at most that of the plan's own table.

    Errors of a table change their sign between neighbouring directions, and cancel in the sum over a sky.
    """
    rings = plan.rings_per_octave or math.inf
    size = smallest_sufficient_size(plan, _SHARE_OF_SKIES) or table_sizes(plan.coherence)[-1]
    return size if size[0] < rings else (plan.rings_per_octave, plan.azimuths_per_width)
