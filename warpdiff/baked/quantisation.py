"""Quantisation: signed integers of one or two bytes with a shared exponent per group.

An entry's error is half a step of its own largest number, however much larger others are. Exponents are eighths of an
octave, of which a byte holds 32 octaves; what lies below them is 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Steps of an octave's exponent.
EIGHTHS = 8


def quantise(values: NDArray[np.float32], dtype: Any = np.int8) -> tuple[float, NDArray[np.uint8], NDArray[Any]]:
    """The scale of all, the exponents (...,) and the whole numbers (..., m), of a type, of values (..., m)."""
    largest = np.iinfo(dtype).max
    sizes = np.abs(values).max(axis=-1, initial=0.0)
    scale = float(sizes.max(initial=0.0)) or 1.0
    with np.errstate(divide="ignore"):
        exponents = np.clip(255.0 + np.ceil(EIGHTHS * np.log2(sizes / scale)), 0.0, 255.0)
    steps = scale * 2.0 ** ((exponents - 255.0) / EIGHTHS) / largest
    mantissas = np.clip(np.rint(values / steps[..., None]), -largest, largest)
    return scale, exponents.astype(np.uint8), mantissas.astype(dtype)


def dequantise(scale: float, exponents: NDArray[np.uint8], mantissas: NDArray[Any]) -> NDArray[np.float32]:
    """The values of exponents (...,) and whole numbers (..., m)."""
    steps = scale * 2.0 ** ((exponents.astype(np.float32) - 255.0) / EIGHTHS) / np.iinfo(mantissas.dtype).max
    return np.asarray(steps[..., None] * mantissas, dtype=np.float32)
