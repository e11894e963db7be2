"""Rectangular blocks of a height field, and standard errors by the jackknife, which omits one block after the other."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Block = tuple[slice, slice]


def blocks_of(shape: tuple[int, int], counts: tuple[int, int]) -> list[Block]:
    """Split a field into ``counts`` (y, x) rectangular blocks of about equal size; return the blocks row by row."""
    edges = [
        np.linspace(0.0, n, count + 1).round().astype(int).tolist() for n, count in zip(shape, counts, strict=True)
    ]
    rows, columns = ([slice(low, high) for low, high in itertools.pairwise(ends)] for ends in edges)
    return [(row, column) for row in rows for column in columns]


def standard_error(without_one: NDArray[np.float64]) -> float:
    """Return the standard error of a quantity by the jackknife, from estimates that each omit one block of the field.

    For few blocks, the standard error is enlarged according to Student's distribution. The interval of two standard
    errors around the estimate then contains the value of the whole surface for 95 % of the fields cut from it.

    Args:
        without_one: Estimates from the field without its first block, without its second block and so on, shape (n,),
            n > 1.
    """
    from scipy import special

    count = len(without_one)
    variance = (count - 1) / count * float(np.sum((without_one - np.mean(without_one)) ** 2))
    return math.sqrt(variance) * float(special.stdtrit(count - 1, special.ndtr(2.0))) / 2.0
