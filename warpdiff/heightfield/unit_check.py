"""Heights and pitches in different units, told by scales that no diffracting surface has."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField

# Less than an atom [µm], unless it is the rounding of a flat field's heights.
LEAST_RANGE_UM = 1e-4
_ROUNDING = 1e-12
# Mean absolute slope.
MOST_SLOPE = 5.0
# In µm; and what heights are like, nearest to which a unit is chosen.
_UNITS = {"metres": 1e6, "millimetres": 1e3, "nanometres": 1e-3, "ångströms": 1e-4}
_TYPICAL_RANGE_UM, _MOST_RANGE_UM, _TYPICAL_PITCH_UM = 0.3, 20.0, 0.05


def warn_of_scale(heightfield: HeightField) -> None:
    """Warn of a height field that is a mirror, or all walls, by a wrong unit."""
    height = heightfield.height_range_um
    extents = [size for size, n in zip(heightfield.size_um, heightfield.shape, strict=True) if n > 1]
    if height <= _ROUNDING * max(float(np.nanmax(np.abs(heightfield.heights_um))), 1.0) or not extents:
        return
    size = max(extents)
    if height < LEAST_RANGE_UM:
        found = f"heights range over {height:.2g} µm, less than an atom"
    elif height > size:
        found = f"heights range over {height:.4g} µm, more than the size of {size:.4g} µm"
    elif height > MOST_SLOPE * min(heightfield.pitch_um) and heightfield.mean_slope > MOST_SLOPE:
        found = f"the mean slope is {heightfield.mean_slope:.3g}"
    else:
        return
    warn(f"heights_um: {found}; {_likely(heightfield)}. If they are meant, use HeightField.of_known_scale(...)")


def _likely(heightfield: HeightField) -> str:
    """The unit that a length is likely to be in."""
    pitch = max(heightfield.pitch_um)
    heights = heightfield.height_range_um
    if LEAST_RANGE_UM <= heights <= _MOST_RANGE_UM and pitch < LEAST_RANGE_UM:
        return f"is the pitch in {_nearest(pitch, _TYPICAL_PITCH_UM)}? It must be in µm"
    unit = _nearest(heights, _TYPICAL_RANGE_UM)
    as_well = ", and the pitch as well" if pitch < LEAST_RANGE_UM else ""
    return f"are heights in {unit}{as_well}? Multiply them by {_UNITS[unit]:g}"


def _nearest(value: float, typical: float) -> str:
    """The unit in which a value comes nearest to a typical one [µm]."""
    return min(_UNITS, key=lambda name: abs(math.log(value * _UNITS[name] / typical)))
