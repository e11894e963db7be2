"""Packed arrays of a page: quantised, as differences, in planes of bytes, deflated together.

The function ``unpack`` of ``page/page.js`` reads them.
"""

from __future__ import annotations

import base64
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Places along an axis, and of a direction along either axis of an octahedron.
STEPS = 65_535


class Arrays:
    """Arrays by name, one after the other.

    Attributes:
        entries: Name, type, shape, begin and length of each array, by which the page reads it.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self.entries: list[dict[str, Any]] = []

    def add(self, name: str, kind: str, data: bytes, rows: int = 0, columns: int = 0) -> None:
        """Add bytes."""
        begin = sum(map(len, self._parts))
        self.entries.append(
            {"name": name, "kind": kind, "rows": rows, "columns": columns, "begin": begin, "length": len(data)}
        )
        self._parts.append(data)

    def add_differences(self, name: str, values: NDArray[Any]) -> None:
        """Add whole numbers of shape (n, m) from 0 to 2³⁰, each as its difference from the one in the row before."""
        values = np.asarray(values, dtype=np.int64)
        steps = np.diff(values, axis=0, prepend=0)
        coded = np.where(steps < 0, -2 * steps - 1, 2 * steps).T.ravel()
        planes = max(-(-int(coded.max(initial=0)).bit_length() // 8), 1)
        data = b"".join((coded >> 8 * p & 255).astype(np.uint8).tobytes() for p in range(planes))
        self.add(name, "differences", data, *values.shape)

    def base64(self) -> str:
        """Return all arrays, deflated, as base64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode("ascii")


def quantised(values: NDArray[Any], low: Any, high: Any) -> NDArray[np.int64]:
    """Values from ``low`` to ``high`` as whole numbers from 0 to ``STEPS``."""
    share = (np.asarray(values, dtype=np.float64) - low) / (np.asarray(high, dtype=np.float64) - low)
    return np.asarray(np.rint(np.clip(share, 0.0, 1.0) * STEPS), dtype=np.int64)


def octahedral(vectors: NDArray[Any]) -> NDArray[np.int64]:
    """Places of unit vectors (n, 3) on an octahedron unfolded into a square (Cigolle et al. 2014), (n, 2)."""
    size = np.abs(vectors).sum(axis=1, keepdims=True)
    points = vectors / np.where(size > 0.0, size, 1.0)
    folded = (1.0 - np.abs(points[:, 1::-1])) * np.where(points[:, :2] < 0.0, -1.0, 1.0)
    return quantised(np.where(points[:, 2:] < 0.0, folded, points[:, :2]), -1.0, 1.0)
