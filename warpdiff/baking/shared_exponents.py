"""Bytes in place of floats: numbers that belong together share an exponent, and each has a byte of its own.

An entry's error is half a byte's step of its own largest number, however much larger others are. Exponents are eighths
of an octave, of which a byte holds 32 octaves; what lies below them is 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

EIGHTHS = 8
_LARGEST = 127


def packed(values: NDArray[np.float32]) -> tuple[float, NDArray[np.uint8], NDArray[np.int8]]:
    """The scale of all, the exponents (...,) and the bytes (..., m) of values (..., m)."""
    sizes = np.abs(values).max(axis=-1, initial=0.0)
    scale = float(sizes.max(initial=0.0)) or 1.0
    with np.errstate(divide="ignore"):
        exponents = np.clip(255.0 + np.ceil(EIGHTHS * np.log2(sizes / scale)), 0.0, 255.0)
    steps = scale * 2.0 ** ((exponents - 255.0) / EIGHTHS) / _LARGEST
    mantissas = np.clip(np.rint(values / steps[..., None]), -_LARGEST, _LARGEST)
    return scale, exponents.astype(np.uint8), mantissas.astype(np.int8)


def unpacked(scale: float, exponents: NDArray[np.uint8], mantissas: NDArray[np.int8]) -> NDArray[np.float32]:
    """The values of exponents (...,) and bytes (..., m)."""
    steps = scale * 2.0 ** ((exponents.astype(np.float32) - 255.0) / EIGHTHS) / _LARGEST
    return np.asarray(steps[..., None] * mantissas, dtype=np.float32)
