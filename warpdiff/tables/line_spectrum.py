"""Line spectrum of a periodic surface: one line at the frequency of each Fourier coefficient."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core import memory
from warpdiff.core.wording import ref
from warpdiff.device.kernel_calls import launch

if TYPE_CHECKING:
    from numpy.typing import NDArray

# What a line takes while they are listed, as counted.
_BYTES_PER_LINE = 80.0
# Deviations that a line's blur in angle reaches.
_FAR_IN_BLURS = 4.5


@dataclass(frozen=True)
class LineSpectrum:
    """Lines of a spectrum but for the zeroth order, in the order of their angles.

    Attributes:
        which: Where their coefficients lie among a table's rows.
        angles: Of their frequencies, 0 to 2π.
        log_frequencies: ln |q|, |q| in 1/µm.
    """

    rows: NDArray[np.int32]
    angles: NDArray[np.float64]
    log_frequencies: NDArray[np.float64]


def lines_of(arguments: Any, highest: float) -> LineSpectrum:
    """The lines up to a frequency [1/µm], of coefficients as the kernels' struct ``Table`` has them."""
    lengths = arguments.length_y, arguments.length_x
    most = math.prod(2.0 * highest * length + 1.0 for length in lengths)
    memory.require_memory(
        _BYTES_PER_LINE * most, f"a table of {most:.3g} lines",
        f"take {ref('integration', 'sampled')}, or {{share}} of the area of {ref('heightfield')}",
    )  # fmt: skip
    s, r = (np.arange(-math.floor(highest * length), math.floor(highest * length) + 1) for length in lengths)
    qy, qx = s[:, None] / lengths[0], r[None, :] / lengths[1]
    squared = qy**2 + qx**2
    inside = (squared <= highest**2) & (squared > 0.0)
    # Beyond the pitch's limit they repeat.
    rows = (s + arguments.origin_y) % arguments.count_y
    columns = (r + arguments.origin_x) % arguments.count_x
    coefficient_rows = (rows[:, None] * arguments.count_x + columns[None, :])[inside].astype(np.int32)
    angles = (np.arctan2(qy, qx) % (2.0 * math.pi))[inside]
    order = np.argsort(angles, kind="stable")
    return LineSpectrum(coefficient_rows[order], angles[order], 0.5 * np.log(squared[inside][order]))


def gathered(
    lines: LineSpectrum, coefficients: wp.array, sampler: Any, *, log_begin: float, per_log: float, rings: int,
    azimuths: int, blur: float, device: wp.Device, **options: Any,
) -> wp.array:  # fmt: skip
    """The density of lines over frequency on azimuths, azimuth after azimuth and node by node.

    Args:
        lines: What to gather.
        coefficients: Powers, a row each.
        sampler: The namespace of :func:`warpdiff.kernels.spectrum_sampling.gatherer`.
        log_begin: ln |q| of the first node.
        per_log: Nodes per unit of ln |q|.
        rings: Of an azimuth.
        azimuths: Their number.
        blur: Standard deviation of a line's angle [rad].
        device: Where.
        options: Of ``launch``.
    """
    places = (lines.log_frequencies - log_begin) * per_log
    inside = np.flatnonzero((places > -0.5) & (places < rings - 0.5))
    angles = lines.angles[inside]
    # A turn, and what of it reaches beyond its ends.
    far = _FAR_IN_BLURS * blur
    after, before = np.searchsorted(angles, far), np.searchsorted(angles, 2.0 * math.pi - far)
    rotated = np.concatenate([angles[before:] - 2.0 * math.pi, angles, angles[:after] + 2.0 * math.pi])
    repeated = inside[np.concatenate([np.arange(before, len(inside)), np.arange(len(inside)), np.arange(after)])]
    at = 2.0 * math.pi * np.arange(azimuths) / azimuths
    values = wp.empty(azimuths * rings, dtype=sampler.row, device=device)
    inputs = [
        coefficients, wp.array(lines.rows[repeated], dtype=wp.int32, device=device),
        wp.array(rotated, dtype=wp.float32, device=device), wp.array(places[repeated], dtype=wp.float32, device=device),
        wp.array(np.exp(-2.0 * lines.log_frequencies[repeated]), dtype=wp.float32, device=device),
        wp.array(np.searchsorted(rotated, at - far), dtype=wp.int32, device=device),
        wp.array(np.searchsorted(rotated, at + far), dtype=wp.int32, device=device), rings, blur,
    ]  # fmt: skip
    launch(sampler.gather, azimuths, inputs, [values], device=device, **options)
    return values
