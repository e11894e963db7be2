"""Polar grids of (u, v) and of frequencies, and the sizes of colour tables on these grids.

The power spectrum under an averaged or centred window is smooth: its Fourier transform is the autocorrelation of the
surface times exp(−r²/4σ²). A table over logarithmic polar coordinates (rings whose radii have equal ratios) resolves
it. Such a table contains the integral over λ of any number of orders, for every direction of light and view.
``colour_table`` computes the table once per height field and coherence.

A source (light source of finite size, coherence of the kind "source") blurs (u, v) equally at all wavelengths, and so
does the footprint of a pixel. The table of a source contains spectral lines with little blur; each look-up adds the
blur of the source and of the footprint. Tables of sources exclude directions near the mirror direction. They also
exclude directions where a source near the horizon blurs less than the table does. The colours of excluded directions
are integrated over sampled wavelengths.
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

# Smallest number of azimuth samples of a ring (circle of constant |(u, v)|) of a colour table.
FEWEST_AZIMUTHS = 16
# Wavelength in the middle of the visible range [µm].
MIDDLE_UM = 0.55
# Number of azimuth samples in tables of light sources of finite size, relative to other tables. More samples reduce the
# blur of the table itself. If a source is near the horizon, fewer directions are then excluded from the table and
# computed by sampled wavelengths. Memory is proportional to the factor.
_MORE_AZIMUTHS_OF_SOURCES = 1.5
# Smallest |(u, v)| for which tables of light sources of finite size are used, in standard deviations of the directions
# to the source. Nearer to the mirror direction, where (u, v) = 0, a blur in polar coordinates is inaccurate. At a
# quarter of this limit, the median error was measured as 4e-2.
INNER_RADIUS_SPREADS = 30.0
LOG_RED, LOG_BLUE = (
    math.log(colorimetry.NM_PER_UM / end) for end in (colorimetry.LAMBDA_MAX_NM, colorimetry.LAMBDA_MIN_NM)
)
# Sizes of colour tables, as pairs: rings per octave (factor of 2) of |(u, v)|, and azimuth samples per standard
# deviation of the spectrum's blur. The two numbers of a pair were chosen so that the errors along the radius and along
# the azimuth are of similar size.
TABLE_SIZES = ((8, 0.9), (12, 1.0), (16, 1.1), (24, 1.3), (32, 1.5), (48, 1.8), (64, 2.1), (96, 2.6), (128, 3.0))
# Order of convergence p. Searches for a table size assume that the error of a table with n rings per octave of |(u, v)|
# is proportional to n^−p.
ERROR_ORDER = 2.0
# Distance above which neighbouring diffraction orders count as separate, in standard deviations of the peak of an order
# in the spectrum.
_ORDERS_APART_SIGMAS = 4.0
# Expected error of a table for skies, as a share of the tolerance. The remaining part of the tolerance is for the
# random scatter of the sky samples. The share was fitted to a smooth sky viewed at 80°, with a tolerance of 0.1. There,
# the mean colour of several pixels has little scatter, so that its error is mainly the error of the table. With this
# share, the error is within the limit of a test, 2 % (tests/lights/test_environment.py). With a share of 1 it is 2.4 %.
_SHARE_OF_SKIES = 1.0 / 3.0
# Largest size of a colour table [MB]. The value is limited by time: larger tables require more time to compute than
# they save.
MOST_MEGABYTES = 300.0


@dataclass(frozen=True)
class PolarGrid:
    """Polar grid of a plane: rings (circles) with a constant ratio of radii, with equally spaced azimuth samples.

    The innermost ring has the index 0. The first sample of each ring is on the first axis of the plane, such as the u
    axis.

    Attributes:
        rings: Number of rings per octave of the radius.
        log_radius: Natural logarithm of the innermost radius.
        azimuths: Number of samples per ring, for each octave from the innermost one.
    """

    rings: int
    log_radius: float
    azimuths: tuple[int, ...]

    @property
    def nodes(self) -> int:
        """Total number of samples of the grid, on all rings (circles)."""
        return self.rings * sum(self.azimuths)

    @property
    def ring_azimuths(self) -> NDArray[np.int64]:
        """Number of azimuth samples on each ring (circle) of the grid."""
        return np.repeat(self.azimuths, self.rings)

    @property
    def starts(self) -> NDArray[np.int64]:
        """Index of the first sample of each ring (circle) of the grid, followed by the total number of samples."""
        return np.concatenate([[0], np.cumsum(self.ring_azimuths)])

    @property
    def radii(self) -> NDArray[np.float64]:
        """Radii of the rings (circles) of the grid, shape (octaves, rings); an octave is a factor of 2 in radius."""
        octaves = np.arange(len(self.azimuths))[:, None] + np.arange(self.rings) / self.rings
        return np.asarray(np.exp(self.log_radius + octaves * math.log(2.0)))

    def places(self) -> NDArray[np.float64]:
        """Return the positions of all samples of the grid in its plane, ring by ring, shape (nodes, 2)."""
        azimuths = self.ring_azimuths
        node = np.arange(self.nodes) - np.repeat(self.starts[:-1], azimuths)
        angles = 2.0 * math.pi * node / np.repeat(azimuths, azimuths)
        radii = np.repeat(self.radii.ravel(), azimuths)
        return np.asarray(radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def azimuth_counts(radii: NDArray[np.floating[Any]], width: float, per_width: float) -> NDArray[np.float64]:
    """Return the number of azimuth samples on rings (circles) with the radii ``radii``, a multiple of 4.

    Neighbouring samples are at most ``width / per_width`` apart; ``width`` is the width of the finest feature on the
    rings, in the unit of ``radii``.
    """
    return np.asarray(np.maximum(4.0 * np.ceil(2.0 * math.pi * radii / width * per_width / 4.0), FEWEST_AZIMUTHS))


def inner_radius(coherence: Coherence) -> float:
    """Return the smallest |(u, v)| for which a table has colours, limited by the coherence.

    It is 0 for a coherence window. For a source it is a multiple of the spread, the standard deviation of its
    directions.
    """
    return INNER_RADIUS_SPREADS * coherence.spread


def blur(coherence: Coherence) -> float:
    """Return the standard deviation of the peak of a diffraction order in the power spectrum [1/µm].

    For a light source of finite size, the standard deviation depends on the wavelength; the result is for 0.55 µm.
    """
    if coherence.sigma_um is None:
        return coherence.spread / MIDDLE_UM
    return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um)


def ring_count(rings_per_octave: int) -> int:
    """Return the number of rings (circles of constant |(u, v)|/λ) of the spectrum that contribute to one colour."""
    return math.ceil((LOG_BLUE - LOG_RED) / math.log(2.0) * rings_per_octave) + 3


def table_error(rings_per_octave: int, *, few_orders: bool = False) -> float:
    """Return the typical error of a colour table; ``few_orders``: few, separate diffraction orders contribute."""
    return float((0.024 if few_orders else 0.008) * (20.0 / rings_per_octave) ** 1.7)


def orders_are_separate(heightfield: HeightField, coherence: Coherence) -> bool:
    """Whether neighbouring diffraction orders do not overlap in the spectrum, because the patch is small."""
    lengths = [length for n, length in zip(heightfield.shape, heightfield.size_um, strict=True) if n > 1]
    return max(lengths, default=0.0) * _ORDERS_APART_SIGMAS * blur(coherence) < 1.0


def table_sizes(coherence: Coherence) -> list[tuple[int, float]]:
    """Return the available table sizes in ascending order.

    A size is a pair: rings per octave (factor of 2) of |(u, v)|, and azimuth samples per standard deviation of the
    spectrum's blur.
    """
    factor = _MORE_AZIMUTHS_OF_SOURCES if coherence.kind == "source" else 1.0
    return [(rings_per_octave, factor * azimuths) for rings_per_octave, azimuths in TABLE_SIZES]


def smallest_sufficient_size(plan: Plan, share: float = 1.0) -> tuple[int, float] | None:
    """Return the smallest table size whose typical error is at most ``share`` of a plan's tolerance, or None.

    A size is a pair: rings per octave (factor of 2) of |(u, v)|, and azimuth samples per standard deviation of the
    spectrum's blur. None means that no size suffices.
    """
    sizes = table_sizes(plan.coherence)
    return next((size for size in sizes if table_error(size[0]) <= share * plan.tolerance), None)


def size_for_skies(plan: Plan) -> tuple[int, float]:
    """Return the size of colour tables for look-ups under a sky, at most the size of the plan's own table.

    A smaller table suffices for a sky, because the errors of a table change their sign between neighbouring directions
    and partly cancel in the sum over the sky.
    """
    rings = plan.rings_per_octave or math.inf
    size = smallest_sufficient_size(plan, _SHARE_OF_SKIES) or table_sizes(plan.coherence)[-1]
    return size if size[0] < rings else (plan.rings_per_octave, plan.azimuths_per_width)
