"""Look-up of the colours of dots with different pitch scales under an averaged coherence window.

All dots of a grating map are copies of one height field, the cell. In a dot with the pitch scale p, the lengths along
the surface are multiplied by p. At scattering vectors multiplied by p, the power spectrum of the cell under a coherence
window of the standard deviation σ/p is that of the dot under a window of σ. The colours of all dots are therefore
interpolated between tables of the cell for several widths of the window: a ladder of tables. The ratio of σ of
neighbouring tables is constant, unless there are so few pitch scales that each has its own table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import dot_transforms
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Number of colour tables per factor of two of the window width σ, for a tolerance of 0.1. The error of cubic
# interpolation is proportional to the fourth power of the step, so that the number for other tolerances follows from
# this one. It was measured by ``bench/reproduce/grating_maps.py --pitches``. If the number is halved, errors exceed the
# tolerance. If it is doubled, maps have twice as many tables.
_TABLES_PER_OCTAVE = 8.0
# Least distance between the binary logarithms of two pitch scales that get colour tables of their own. Smaller
# distances would be lost among the rounding errors of the logarithm in float32.
_LEAST_GAP = 1e-3
# Rounding error of the logarithm of pitch scales [steps of the interpolation between tables]. Without it, a range of a
# whole number of steps may get one table more.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class PitchLadder:
    """Coherence windows of the tables between which the colours of dots with different pitch scales are interpolated.

    Attributes:
        octaves: Binary logarithm of the pitch scale of which each table has the exact colours, relative to the smallest
            pitch scale of the map.
        coherences: Coherence of each table, the longest window first.
        per_octave: Number of steps per factor of two of the pitch scale. The steps are the unit of the interpolation.
    """

    octaves: tuple[float, ...]
    coherences: tuple[Coherence, ...]
    per_octave: float

    @classmethod
    def of(cls, pitch_scales: NDArray[np.float64], coherence: Coherence, tolerance: float) -> PitchLadder:
        """Return the ladder for the pitch scales of a map, and for coherence and tolerance of a picture.

        If the map has few different pitch scales, each of them has a table, and colours are not interpolated.
        """
        places = np.log2(np.unique(pitch_scales))
        places -= places[0]
        per_octave = float(math.ceil(_TABLES_PER_OCTAVE * (0.1 / tolerance) ** 0.25))
        # Cubic interpolation requires one more table at each end of the range of pitch scales.
        steps = np.arange(-1, math.ceil(places[-1] * per_octave - _ROUNDING) + 2)
        octaves, least_gap = steps / per_octave, float(np.diff(places).min())
        if len(places) <= len(steps) and least_gap >= _LEAST_GAP:
            # A table has the weight 0 for dots that are two or more steps away. With a step of a third of the least
            # gap, rounding gives neighbouring tables no weight.
            octaves, per_octave = places, 3.0 / least_gap
        # All tables are made for the height field at the largest pitch scale. The window of a table is that of the
        # picture, multiplied by the largest pitch scale and divided by that of the table.
        widths = float(coherence.sigma_um or 0.0) * 2.0 ** (places[-1] - octaves)
        windows = tuple(replace(coherence, sigma_um=float(width)) for width in widths)
        return cls(tuple(octaves.tolist()), windows, per_octave)


class LadderLookup(ColourLookup):
    """Look-up of the colours of dots with different pitch scales, interpolated between tables for several windows."""

    def __init__(
        self, ladder: PitchLadder, heightfield: HeightField, plan: Plan, direction_range: DirectionRange, *,
        device: wp.Device, threads: int,
    ) -> None:  # fmt: skip
        """Prepare the look-ups in all tables; tables are computed at the first use.

        ``heightfield`` is that of the dots, at the largest pitch scale. ``plan`` is a plan for the longest coherence
        window of all tables, which suffices for the others.
        """
        super().__init__(heightfield, plan, direction_range, device=device, threads=threads)
        self._ladder, self._no_gains = ladder, wp.empty(0, dtype=wp.float32, device=device)
        self._lookups = [
            ColourLookup(heightfield, replace(plan, coherence=window), direction_range, device=device, threads=threads)
            for window in ladder.coherences
        ]

    @property
    def overwrites_gains(self) -> bool:
        """Whether `kernel_calls` overwrites its array ``unserved_gain``: the weighed gains are written there."""
        return True

    def copy_with(self, plan: Plan) -> LadderLookup:
        """Return a look-up for the same range of directions by another plan (numbers of a computation)."""
        return LadderLookup(
            self._ladder, self.heightfield, plan, self._range, device=self.device, threads=self._threads
        )

    def kernel_calls(
        self, scattering_vectors: wp.array, to_lights: wp.array, gains: wp.array, illuminated: IlluminatedMaterial,
        xyz: wp.array, footprints: wp.array | None = None, unserved_gain: wp.array | None = None,
    ) -> list[KernelCall]:  # fmt: skip
        """Return the kernel calls of all tables. Each adds its colours, multiplied by its weight for each dot.

        The length of a direction in ``to_lights`` is the pitch scale relative to the smallest one of the map.
        """
        # Each table overwrites one array with its weighted geometry factors (gains). One array is enough, because the
        # calls run one after the other. Other look-ups use this array for the gains of directions that their table
        # excludes. Tables of averaged windows exclude no direction.
        weighed = unserved_gain
        if weighed is None or not len(weighed):
            weighed = wp.empty(len(gains), dtype=wp.float32, device=self.device)
        calls = []
        for octaves, lookup in zip(self._ladder.octaves, self._lookups, strict=True):
            inputs = [to_lights, gains, octaves, self._ladder.per_octave]
            calls.append(KernelCall(dot_transforms.weigh_gains, inputs, [weighed], in_runs=True))
            calls += lookup.kernel_calls(
                scattering_vectors, to_lights, weighed, illuminated, xyz, footprints, self._no_gains
            )
        return calls
