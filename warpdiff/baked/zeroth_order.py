"""Zeroth order of a height field: its power as a function of κ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField

# Heights are counted in so many steps: phases err by 1e-4.
_HEIGHTS = 65_536


def zeroth_powers(heightfield: HeightField, kappas: NDArray[np.float64]) -> NDArray[np.float32]:
    """|H₀₀|², the power of the mean plane's coefficient, at equal steps of |κ| [1/µm], from how often heights occur."""
    import scipy.signal

    heights = heightfield.heights_um - heightfield.heights_um.min()
    span = float(heights.max())
    if span == 0.0:
        return np.ones(len(kappas), dtype=np.float32)
    per_um = (_HEIGHTS - 1) / span
    counts = np.bincount(np.rint(heights.ravel() * per_um).astype(np.int64), minlength=_HEIGHTS)
    ends = float(kappas[0]), float(kappas[-1])
    means = scipy.signal.zoom_fft(counts / heights.size, ends, len(kappas), fs=per_um, endpoint=True)
    return np.asarray(np.abs(means) ** 2, dtype=np.float32)
