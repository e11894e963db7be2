"""Compression of a web page's arrays: integers are stored as differences, all lowest bytes first, and deflated.

The function ``unpack`` of ``page/page.js`` decompresses the arrays.
"""

from __future__ import annotations

import base64
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Largest integer for a coordinate of a position or of an octahedral direction. A coordinate is stored in 16 bits.
STEPS = 65_535


class Arrays:
    """Arrays of a web page, such as vertices and baked colours, concatenated to one sequence of bytes.

    Attributes:
        entries: Table of contents of the bytes: name, type, shape, first byte and number of bytes of each array.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self.entries: list[dict[str, Any]] = []

    def add(self, name: str, kind: str, data: bytes, rows: int = 0, columns: int = 0) -> None:
        """Add an array as bytes.

        Args:
            name: Name of the array.
            kind: Type for the page: ``"float32"``, ``"int8"``, ``"int16"``, ``"bytes"`` or ``"differences"``.
            data: Bytes of the array.
            rows: Number of rows, for ``"differences"``.
            columns: Number of columns, for ``"differences"``.
        """
        begin = sum(map(len, self._parts))
        self.entries.append(
            {"name": name, "kind": kind, "rows": rows, "columns": columns, "begin": begin, "length": len(data)}
        )
        self._parts.append(data)

    def add_differences(self, name: str, values: NDArray[Any]) -> None:
        """Add integers from 0 to 2³⁰, shape (n, m), each stored as its difference from the row before.

        The lowest bit of a stored number is the sign of the difference. The lowest bytes of all numbers precede their
        second bytes, and so on, because similar bytes compress better.
        """
        values = np.asarray(values, dtype=np.int64)
        steps = np.diff(values, axis=0, prepend=0)
        coded = np.where(steps < 0, -2 * steps - 1, 2 * steps).T.ravel()
        planes = max(-(-int(coded.max(initial=0)).bit_length() // 8), 1)
        data = b"".join((coded >> 8 * p & 255).astype(np.uint8).tobytes() for p in range(planes))
        self.add(name, "differences", data, *values.shape)

    def base64(self) -> str:
        """Return the bytes of all arrays, concatenated and deflated, as a text in base64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode("ascii")


def quantised(values: NDArray[Any], low: Any, high: Any) -> NDArray[np.int64]:
    """Return values between ``low`` and ``high`` as integers from 0 to ``STEPS``, the largest integer of 16 bits."""
    share = (np.asarray(values, dtype=np.float64) - low) / (np.asarray(high, dtype=np.float64) - low)
    return np.asarray(np.rint(np.clip(share, 0.0, 1.0) * STEPS), dtype=np.int64)


def octahedral(vectors: NDArray[Any]) -> NDArray[np.int64]:
    """Return the octahedral encoding of unit vectors (n, 3), shape (n, 2).

    The unit sphere is projected to an octahedron, which is unfolded into a square (Cigolle et al. 2014).
    """
    size = np.abs(vectors).sum(axis=1, keepdims=True)
    points = vectors / np.where(size > 0.0, size, 1.0)
    folded = (1.0 - np.abs(points[:, 1::-1])) * np.where(points[:, :2] < 0.0, -1.0, 1.0)
    return quantised(np.where(points[:, 2:] < 0.0, folded, points[:, :2]), -1.0, 1.0)
