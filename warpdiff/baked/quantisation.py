"""Quantisation: groups of numbers as signed integers of one or two bytes, with an exponent per group.

The integers of a group count steps. A step is the largest magnitude of the group, rounded up to a power of 2^(1/8),
divided by 127 or 32767. The error of a number is at most half a step. The exponent of the group is the power of
2^(1/8). One byte therefore covers magnitudes in a ratio of 2^32. Groups of smaller numbers have the smallest exponent,
so that they are less accurate or 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Each group of quantised numbers has a common scale, which is a power of 2^(1/8). The value is the number of scales per
# factor of 2.
EIGHTHS = 8


def quantise(values: NDArray[np.float32], dtype: Any = np.int8) -> tuple[float, NDArray[np.uint8], NDArray[Any]]:
    """Convert values, shape (..., m), to integers with one exponent (scale) per group of m values.

    Returns:
        Magnitude of the largest value; exponents, shape (...,); and integers of the type ``dtype``, shape (..., m).
    """
    largest = np.iinfo(dtype).max
    sizes = np.abs(values).max(axis=-1, initial=0.0)
    scale = float(sizes.max(initial=0.0)) or 1.0
    with np.errstate(divide="ignore"):
        exponents = np.clip(255.0 + np.ceil(EIGHTHS * np.log2(sizes / scale)), 0.0, 255.0)
    steps = scale * 2.0 ** ((exponents - 255.0) / EIGHTHS) / largest
    mantissas = np.clip(np.rint(values / steps[..., None]), -largest, largest)
    return scale, exponents.astype(np.uint8), mantissas.astype(dtype)


def dequantise(scale: float, exponents: NDArray[np.uint8], mantissas: NDArray[Any]) -> NDArray[np.float32]:
    """Return the values that exponents, shape (...,), and integers, shape (..., m), represent."""
    steps = scale * 2.0 ** ((exponents.astype(np.float32) - 255.0) / EIGHTHS) / np.iinfo(mantissas.dtype).max
    return np.asarray(steps[..., None] * mantissas, dtype=np.float32)
