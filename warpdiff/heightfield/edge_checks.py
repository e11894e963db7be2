"""Checks of a height field before its reflectance is computed: whether it is levelled, and whether its edges match."""

from __future__ import annotations

import math
import weakref
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield import cleaning

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence

# A field counts as tilted if the ratio of two standard deviations exceeds this value: that of a plane fitted to the
# heights, and that of the remaining roughness. The value was measured on a patch of 18 µm, in comparison with the same
# patch without tilt: at a ratio of 0.3 colours are equal, at a ratio of 1 the scattered power is smaller by 29 %.
_MOST_TILT = 1.0
# A field counts as an exact plane if the ratio of two standard deviations exceeds this value: that of a plane fitted to
# the heights, and that of the remaining roughness. An exact plane causes no warning, because it is a synthetic surface
# such as one period of a blazed grating, and not a tilted specimen.
_EXACT = 1e6
# A warning about unequal edges may follow if the ratio of two height differences exceeds this value: the jump between
# opposite edges of a field, and the largest steps between neighbouring samples. A smaller jump may be a wall of a
# grating, because walls inside the field are as high.
_MOST_JUMP = 1.5
# A warning about unequal edges follows if at least this fraction of all pairs of interfering points have an edge of the
# repeated field between them. Two points of a surface interfere if both are in the coherence window.
_LEAST_SHARE = 0.1
_warned: weakref.WeakSet[HeightField] = weakref.WeakSet()


def warn_of_edges(heightfield: HeightField, coherence: Coherence, longest_um: float) -> None:
    """Warn once of a field that is not levelled or whose edges do not match, if this changes its reflectance.

    Args:
        heightfield: Field without missing samples.
        coherence: Coherence window, source or number of periods for which the reflectance will be computed.
        longest_um: Longest wavelength for which the reflectance will be computed [µm].
    """
    if heightfield in _warned:
        return
    heights = heightfield.heights_um
    jumps = [_jump(heights, axis) for axis in (0, 1)]
    if max(jumps) <= _MOST_JUMP:
        return
    plane = heights - cleaning.level(heights, heightfield.missing, 1)
    rough = float(np.std(heights - plane))
    tilt = float(np.std(plane))
    if _MOST_TILT * rough < tilt < _EXACT * rough:
        _warned.add(heightfield)
        warn(
            f"{ref('heightfield')} is not levelled: its tilt has a standard deviation of {tilt:.3g} µm, its roughness "
            f"of {rough:.3g} µm; remove the tilt with {ref('levelled()')}, then make the edges match with "
            f"{ref('periodic()')}"
        )
        return
    size = heightfield.size_um
    shares = [_share(coherence, size[axis], axis, longest_um) if jumps[axis] > _MOST_JUMP else 0.0 for axis in (0, 1)]
    if tilt >= _EXACT * rough or max(shares) < _LEAST_SHARE:
        return
    change = float(np.sqrt(np.mean(cleaning.smooth_part(heights) ** 2)))
    if change > cleaning.MOST_CHANGE * heightfield.rms_um:
        _warned.add(heightfield)
        worst = jumps.index(max(jumps))
        warn(
            f"opposite edges of {ref('heightfield')} do not match along {'yx'[worst]}: they differ by "
            f"{jumps[worst]:.2g} times the largest steps of its roughness, and {100.0 * max(shares):.2g} % of the "
            f"interfering pairs of points have an edge between them; use {ref('periodic()')}, or cut whole periods "
            f"with {ref('whole_periods()')}"
        )


def check_periodic(heightfield: HeightField) -> None:
    """Raise an error if opposite edges of a field do not match, for example because the field is tilted."""
    heights = heightfield.heights_um
    jumps = [_jump(heights, axis) for axis in (0, 1)]
    plane = heights - cleaning.level(heights, heightfield.missing, 1)
    if max(jumps) <= _MOST_JUMP or float(np.std(plane)) >= _EXACT * float(np.std(heights - plane)):
        return
    change = float(np.sqrt(np.mean(cleaning.smooth_part(heights) ** 2)))
    if change > cleaning.MOST_CHANGE * heightfield.rms_um:
        worst = jumps.index(max(jumps))
        raise ArgumentValueError(
            f"{ref('heightfield')} must be periodic, but its opposite edges differ along {'yx'[worst]} by "
            f"{jumps[worst]:.2g} times the largest steps of its roughness: use {ref('periodic()')}, or cut whole "
            f"periods with {ref('whole_periods()')}"
        )


def _jump(heights: NDArray[np.float64], axis: int) -> float:
    """Return the rms jump of the heights from one edge of the field to the opposite edge, along an axis.

    The jump is relative to the largest steps between neighbouring samples. It is 0 if opposite edges match.
    """
    if heights.shape[axis] < 3:
        return 0.0
    jump = float(np.sqrt(np.mean((np.take(heights, 0, axis) - np.take(heights, -1, axis)) ** 2)))
    if jump <= 1e-9 * float(np.max(np.abs(heights))):
        return 0.0
    # The largest step between neighbouring samples is computed in each row (or column) along the axis, and the median
    # of these steps is used. The median includes walls of a grating, which are in most rows. It excludes dust grains,
    # which are in few rows.
    largest = float(np.median(np.max(np.abs(np.diff(heights, axis=axis)), axis=axis)))
    return jump / largest if largest > 0.0 else 0.0


def _share(coherence: Coherence, size_um: float, axis: int, longest_um: float) -> float:
    """Return the fraction of interfering pairs of points of the repeated field that have an edge between them.

    Points interfere within a Gaussian coherence window of standard deviation σ. Two points in the window have a mean
    distance of 2σ/√π along an axis. Edges of the repeated field are one length of the field apart, so that the fraction
    is this distance over the length.
    """
    if coherence.periods is not None:
        return 0.0 if coherence.periods[axis] == 1 else 1.0
    sigma = coherence.sigma_um
    if sigma is None:
        sigma = longest_um / (2.0 * math.sqrt(2.0) * math.pi * coherence.spread)
    if coherence.kind == "centred" and coherence.centre_um is None:
        # A single coherence window is centred on the patch. The part of the window beyond the edges contains points of
        # a neighbouring period, so that an edge lies between them and the middle. The result is the weight of this
        # part, relative to the weight of the window.
        return math.erfc(0.5 * size_um / (math.sqrt(2.0) * sigma))
    return min(2.0 * sigma / (math.sqrt(math.pi) * size_um), 1.0)
