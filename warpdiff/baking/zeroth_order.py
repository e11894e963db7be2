"""The zeroth order, which the mean plane reflects: its power as a function of κ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.surface.heightfield import HeightField

# Heights are counted in so many steps: phases err by 1e-4.
_HEIGHTS = 65_536


def zeroth_powers(hf: HeightField, kappas: NDArray[np.float64]) -> NDArray[np.float32]:
    """|H₀₀|², the power of the mean plane's coefficient, at |κ| [1/µm], from how often each height occurs."""
    heights = hf.heights_um - hf.heights_um.min()
    span = float(heights.max())
    if span == 0.0:
        return np.ones(len(kappas), dtype=np.float32)
    counts = np.bincount(np.rint(heights.ravel() * ((_HEIGHTS - 1) / span)).astype(np.int64), minlength=_HEIGHTS)
    at = np.linspace(0.0, span, _HEIGHTS)
    means = [np.exp(2j * math.pi * kappa * at) @ counts / heights.size for kappa in kappas]
    return np.asarray(np.abs(means) ** 2, dtype=np.float32)
