"""STL solids of one period of a height field, closed by walls and a flat base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import files, memory

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# Smallest thickness of the solid below the lowest point of its surface [µm]. The thickness is the height range of the
# surface, or this value if the height range is smaller, so that flat surfaces also give a solid.
_LEAST_BASE_UM = 1.0
# Memory that is required while a file is written [bytes per sample]: two triangles of 50 bytes, their corners in
# float64, and copies. If doubled, fields are refused that would fit into memory.
_BYTES_PER_SAMPLE = 800.0
# Layout of one triangle in a binary STL file.
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(target: Path, heights_um: NDArray[np.float64], pitch_um: tuple[float, float]) -> None:
    """Write one period of a surface as a solid to a binary STL file.

    Samples are vertices. The first row and column are repeated after the last ones, so that the solid has the full
    length of the period.
    """
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
    # The flat base of the solid is a fan of triangles around one vertex in its middle. Its outer vertices are the lower
    # vertices of the walls, so that the solid has no gaps.
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
