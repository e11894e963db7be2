"""STL solids of one period of a height field, closed by walls and a flat base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import files, memory

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# Least distance of the base from the lowest point [µm]. Choice: the solid is at least as thick as its relief is high.
_LEAST_BASE_UM = 1.0
# Memory per sample [bytes]: two triangles of the surface of 50 bytes, their corners in float64, and copies.
_BYTES_PER_SAMPLE = 800.0
# One triangle of a binary STL file.
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(target: Path, heights_um: NDArray[np.float64], pitch_um: tuple[float, float]) -> None:
    """Write a binary STL file: samples are vertices, and the first row and column follow the last ones again."""
    memory.require_memory(
        _BYTES_PER_SAMPLE * heights_um.size, f"an STL file of {heights_um.shape[0]} × {heights_um.shape[1]} samples",
        "take {share} of its area",
    )  # fmt: skip
    closed = np.pad(heights_um, ((0, 1), (0, 1)), mode="wrap")
    y, x = (np.arange(n) * pitch for n, pitch in zip(closed.shape, pitch_um, strict=True))
    top = np.stack([*np.broadcast_arrays(x[None], y[:, None]), closed], axis=-1)
    base = float(closed.min()) - max(float(np.ptp(closed)), _LEAST_BASE_UM)
    triangles = [_quads(top[:-1, :-1], top[:-1, 1:], top[1:, 1:], top[1:, :-1])]
    below = top.copy()
    below[..., 2] = base
    edges = [top[0], top[:, -1], top[-1, ::-1], top[::-1, 0]]
    bases = [below[0], below[:, -1], below[-1, ::-1], below[::-1, 0]]
    triangles += [_quads(b[:-1], b[1:], t[1:], t[:-1]) for t, b in zip(edges, bases, strict=True)]
    # The base has the vertices of the walls, so that the solid is closed, and one vertex in its middle.
    ring = np.concatenate([b[:-1] for b in bases])
    middle = np.broadcast_to([x[-1] / 2.0, y[-1] / 2.0, base], ring.shape)
    triangles.append(np.stack([np.roll(ring, -1, axis=0), ring, middle], axis=1))
    corners = np.concatenate(triangles)
    records = np.zeros(len(corners), dtype=_TRIANGLE)
    records["corners"] = corners
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    with files.atomic_write(target, suffix=".stl") as temporary, temporary.open("rb+") as file:
        file.write(b"heights in micrometres".ljust(80))
        file.write(np.array([len(records)], dtype="<u4").tobytes())
        file.write(records.tobytes())


def _quads(*corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two triangles per quadrilateral, shape (2n, 3, 3), from its four corners in counter-clockwise order."""
    a, b, c, d = (corner.reshape(-1, 3) for corner in corners)
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
