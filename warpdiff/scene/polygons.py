"""Triangulation of the polygons of mesh files: mapbox_earcut cuts concave polygons, and other polygons are fans."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# A corner is concave if the sine of its turn, times the lengths of its two edges, divided by the square of the
# polygon's longest edge, is below this negative number. The turn is positive at the corners of a convex polygon. The
# magnitude was chosen above the rounding errors of float32, so that corners on a straight line do not count as concave.
_CONCAVE = -1e-6


def are_concave(polygons: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether each of m polygons has a concave corner, shape (m,).

    Args:
        polygons: Positions of the corners of polygons with n corners, shape (m, n, 3).
    """
    with np.errstate(all="ignore"):  # positions that are not finite are refused later
        edges = np.roll(polygons, -1, axis=1) - polygons
        turns = np.cross(np.roll(edges, 1, axis=1), edges)
        normals = _normals(polygons)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        longest_squared = np.max(np.sum(edges**2, axis=2), axis=1)
        lowest = np.min(np.sum(turns * normals[:, None], axis=2), axis=1)
        return np.asarray(lowest < _CONCAVE * longest_squared)


def concave(corners: dict[int, NDArray[np.int64]], positions: NDArray[np.float64]) -> list[int]:
    """Return the sorted numbers of concave polygons. Polygons with an index that no vertex has are ignored.

    Args:
        corners: Vertex indices of the corners of each polygon, by the polygon's number.
        positions: Positions of the vertices, shape (n, 3).
    """
    by_count: dict[int, list[int]] = {}
    for number, index in corners.items():
        by_count.setdefault(len(index), []).append(number)
    result: list[int] = []
    for numbers in by_count.values():
        index = np.stack([corners[number] for number in numbers])
        is_valid = np.all((index >= 0) & (index < len(positions)), axis=1)
        result += np.array(numbers)[is_valid][are_concave(positions[index[is_valid]])].tolist()
    return sorted(result)


def triangulated(polygon: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return triangles that cover a polygon, as indices of its corners, shape (m, 3).

    Args:
        polygon: Positions of the corners, shape (n, 3).
    """
    import mapbox_earcut

    normal = _normals(polygon[None])[0]
    axis = int(np.argmax(np.abs(normal)))
    # The polygon is projected along the coordinate axis that is closest to its normal. The projection does not change
    # the orientation (clockwise or not) of its corners.
    first, second = (axis + 1) % 3, (axis + 2) % 3
    flat = np.ascontiguousarray(polygon[:, [first, second] if normal[axis] > 0.0 else [second, first]])
    triangles = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32))
    triangles = triangles.reshape(-1, 3).astype(np.int64)
    if not len(triangles):
        return fan(len(polygon))
    one, two, three = (flat[triangles[:, corner]] for corner in range(3))
    (ax, ay), (bx, by) = (two - one).T, (three - one).T
    is_turned = ax * by - ay * bx < 0.0
    triangles[is_turned] = triangles[is_turned][:, ::-1]
    return np.asarray(triangles)


def fan(count: int) -> NDArray[np.int64]:
    """Return the triangles from the first corner of a convex polygon of ``count`` corners, shape (count − 2, 3)."""
    second = np.arange(1, count - 1)
    return np.stack([np.zeros_like(second), second, second + 1], axis=1)


def _normals(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return normals of polygons by Newell's method, of any length, shape (m, 3)."""
    centred = polygons - polygons[:, :1]
    return np.asarray(np.sum(np.cross(centred, np.roll(centred, -1, axis=1)), axis=1))
