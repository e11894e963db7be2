"""Normals, tangents and convexity of a mesh, from its vertices, faces and texture coordinates.

Vectors are stored with their components along the first axis, shape (3, n), and faces with their corners along it,
shape (3, m). NumPy is several times faster if the long axis is the last axis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import forks
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from numpy.typing import NDArray

# A face counts as having no area if twice its area, divided by the square of its longest edge, is at most this number.
# The value was chosen because normals of narrower faces are unreliable.
ZERO_AREA = 1e-9
# Distance below which two vertices count as being at one position [radii of the mesh]. The value was chosen above the
# rounding errors of float32.
WELD = 1e-6
# Tangents on two sides of a texture seam are averaged if the cosine of the angle between them is at least this number.
# It is the cosine of 30°, a chosen value. Tangents with larger angles remain separate.
SEAM_COSINE = float(np.cos(np.radians(30.0)))


class FaceGeometry:
    """Edges, areas, normals and angles of faces; each quantity is computed at its first use.

    Attributes:
        edges: Edge vectors from each corner to the next corner, shape (3, 3, m): component, corner, face.
        cross: Cross product of the first and the second edge vector, shape (3, m).
        twice_area: Length of ``cross``, which is twice the area, shape (m,).
        products: Scalar products of the two edge vectors that start at each corner, shape (3, m).
    """

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        """Compute the edge vectors of ``faces``, shape (3, m), between positions ``vertices``, shape (3, n)."""
        self.edges = np.empty((3, *faces.shape))
        for edges, component in zip(self.edges, vertices, strict=True):
            corners = component.take(faces)
            np.subtract(corners[[1, 2, 0]], corners, out=edges)
        one, two, three = (self.edges[:, k] for k in range(3))
        self.cross = np.stack([one[i - 2] * two[i - 1] - one[i - 1] * two[i - 2] for i in range(3)])
        self.twice_area = length(self.cross)
        self.products = np.stack([-dot(three, one), -dot(one, two), -dot(two, three)])

    @property
    def has_area(self) -> NDArray[np.bool_]:
        """Whether each face has an area, and is not nearly a line or a point, shape (m,)."""
        # ``products`` has, for each corner, the scalar product of the two edges that start there. The squared length of
        # an edge is the sum of the products at its two ends.
        at = self.products
        longest_squared = np.maximum(np.maximum(at[0] + at[1], at[1] + at[2]), at[2] + at[0])
        return np.asarray(self.twice_area > ZERO_AREA * longest_squared)

    @forks.cached_property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals, shape (3, m), towards the side with counter-clockwise corners; zero for faces without area."""
        return np.asarray(self.cross / np.where(self.twice_area > 0.0, self.twice_area, 1.0))

    @forks.cached_property
    def angles(self) -> NDArray[np.float64]:
        """Angles at the corners [radians], shape (3, m)."""
        return np.asarray(np.arctan2(self.twice_area, self.products))

    def angle_weighted_normals(self, faces: NDArray[np.int64], count: int) -> NDArray[np.float64]:
        """Return the sums of face normals at each of ``count`` vertices, weighted by corner angles, (3, count)."""
        return np.stack([sum_at(faces, self.angles * normal, count) for normal in self.normals])


class TextureGeometry:
    """Edges and orientation of faces in texture coordinates.

    Attributes:
        one: Edge vector from the first corner to the second, in texture coordinates, shape (2, m).
        two: Edge vector from the first corner to the third, in texture coordinates, shape (2, m).
        orientation: 1; −1 where the texture is mirrored; 0 where a face has no area in the texture, shape (m,).
    """

    def __init__(self, uvs: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        """Compute the edges of ``faces``, shape (3, m), between the texture coordinates ``uvs``, shape (2, n)."""
        corners = uvs.take(faces, axis=1)
        self.one = corners[:, 1] - corners[:, 0]
        self.two = corners[:, 2] - corners[:, 0]
        determinant = self.one[0] * self.two[1] - self.one[1] * self.two[0]
        longest_squared = np.maximum(dot(self.one, self.one), dot(self.two, self.two))
        self.orientation = np.sign(determinant)
        self.orientation[~(np.abs(determinant) > ZERO_AREA * longest_squared)] = 0.0

    def mirrored(self, faces: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
        """Return whether the texture is mirrored on each face, shape (m,).

        A face without area in the texture is mirrored if the faces around it are.
        """
        mirrored = self.orientation < 0.0
        unknown = self.orientation == 0.0
        if unknown.any():
            votes = sum_at(faces, np.broadcast_to(self.orientation, faces.shape), count)
            mirrored[unknown] = votes[faces[:, unknown]].sum(axis=0) < 0.0
        return np.asarray(mirrored)


def dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the scalar products of pairs of vectors, whose components are along the first axis, shape (3, n)."""
    return np.asarray(np.einsum("i...,i...->...", a, b))


def length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of vectors, whose components are along the first axis, shape (3, n)."""
    return np.asarray(np.sqrt(dot(vectors, vectors)))


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors scaled to unit length; vectors that are zero except for rounding errors become zero."""
    size = length(vectors)
    zero = ~(size > 1e-9)
    size[zero] = 1.0
    result = vectors / size
    result[:, zero] = 0.0
    return np.asarray(result)


def tangential(vectors: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the component of each vector that is perpendicular to the unit normal at the same index."""
    return np.asarray(vectors - dot(vectors, normals) * normals)


def sum_at(index: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return for each index from 0 to ``count`` − 1 the sum of the ``values`` that have this index, shape (count,)."""
    return np.asarray(np.bincount(index.ravel(), values.ravel(), count))


def compacted(indices: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the sorted indices that occur in ``indices``, and ``indices`` renumbered as positions in this sorted list.

    All indices must be below ``count``.
    """
    is_used = np.zeros(count, dtype=np.bool_)
    is_used[indices] = True
    if is_used.all():
        return np.arange(count), indices
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1).take(indices)


def weld(vertices: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return a number for each vertex that identifies its position: vertices at the same position have equal numbers.

    The second result has the indices of the vertices in the order of these numbers.
    """
    x, y, z = np.round(vertices / WELD).astype(np.int64) + 2**20
    # The three coordinates are rounded to integers of 21 bits and joined to one integer per vertex. One integer is
    # faster to sort than three numbers.
    key = (x * 2**21 + y) * 2**21 + z
    order = np.argsort(key)
    key = key[order]
    number = np.zeros(len(key), dtype=np.int64)
    number[order[1:]] = np.cumsum(key[1:] != key[:-1])
    return number, order


def vertex_normals(
    geometry: FaceGeometry, faces: NDArray[np.int64], welded: NDArray[np.int64], own: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return unit vertex normals, shape (3, n): the normals of the input mesh, or computed normals if it has none."""
    beside = geometry.angle_weighted_normals(faces, len(welded))
    if own is not None:
        own = unit(np.nan_to_num(own))
        # A normal of the input mesh is reversed if it points against the mean normal of the faces of its vertex. Faces
        # of other vertices at the same position do not count: where two surfaces touch, most of these faces may point
        # to the other side.
        own = np.where(dot(own, beside) < 0.0, -own, own)
        missing = ~own.any(axis=0)
        if not missing.any():
            return own
    count = int(welded.max()) + 1
    total = np.stack([sum_at(welded, component, count) for component in beside])
    weight = sum_at(welded, sum_at(faces, geometry.angles, len(welded)), count)
    # On a thin sheet, faces of both sides meet at a position, and their normals add up to zero. The normal of a vertex
    # is then computed from the faces of this vertex only.
    cancelled = (length(total) <= 1e-6 * weight)[welded]
    computed = unit(np.where(cancelled, beside, total.take(welded, axis=1)))
    return computed if own is None else np.where(missing, computed, own)


def tangents_from_uvs(
    geometry: FaceGeometry, texture: TextureGeometry, faces: NDArray[np.int64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return tangents ∂P/∂u at vertices: means over the faces of each vertex, weighted by angles, shape (3, n)."""
    along_u = geometry.edges[:, 0] * texture.two[1] + geometry.edges[:, 2] * texture.one[1]
    size = length(along_u)
    along_u *= texture.orientation / np.where(size > 0.0, size, 1.0)
    # The direction ∂P/∂u of a face is scaled so that its projection onto the tangent plane of the vertex has unit
    # length. Otherwise faces with steep directions would have less weight in the mean. The projection itself is
    # computed after the sum over faces.
    cosines = np.zeros(faces.shape)
    for component, normal in zip(along_u, normals, strict=True):
        cosines += component * normal.take(faces)
    sines = np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
    weights = np.divide(geometry.angles, sines, out=np.zeros_like(sines), where=sines > 1e-6)
    total = np.stack([sum_at(faces, weights * component, normals.shape[1]) for component in along_u])
    return tangential(total, normals)


def join_seams(
    field: NDArray[np.float64], welded: NDArray[np.int64], order: NDArray[np.int64], handedness: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Add to the tangent of each vertex the tangents of other vertices at its position that have a similar direction.

    Tangents of two vertices are added only if the vertices have the same handedness.
    """
    count = len(order)
    ends = np.cumsum(np.bincount(welded))
    following = ends[welded[order]] - 1 - np.arange(count)
    directions = unit(field)
    result = field.copy()
    # Vertices are sorted by position. Each vertex is compared with the next vertex at its position, then with the
    # vertex after that, and so on. A round of the loop makes many comparisons at once. To limit memory, a round
    # compares at most about as many pairs of vertices as the mesh has vertices.
    step = 1
    while len(start := np.flatnonzero(following >= step)):
        steps = max(1, count // len(start))
        pairs = np.minimum(following[start] - step + 1, steps)
        first = np.repeat(start, pairs)
        ahead = step + np.arange(len(first)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        a, b = order[first], order[first + ahead]
        agree = dot(directions.take(a, axis=1), directions.take(b, axis=1)) > SEAM_COSINE
        agree &= handedness[a] == handedness[b]
        a, b = a[agree], b[agree]
        result += [sum_at(a, component[b], count) + sum_at(b, component[a], count) for component in field]
        step += steps
    return result


def fill(
    field: NDArray[np.float64], normals: NDArray[np.float64], faces: NDArray[np.int64], welded: NDArray[np.int64],
    is_needed: NDArray[np.bool_], name: str, *, has_poles: bool = False,
) -> NDArray[np.float64]:  # fmt: skip
    """Return tangents at all vertices. A missing tangent is the mean over neighbouring vertices with known tangents.

    Args:
        field: Tangents, shape (3, n); zero where missing.
        normals: Unit vertex normals, shape (3, n).
        faces: Vertex indices, shape (3, m).
        welded: Index of each vertex's position, which is equal for vertices at one position, shape (n,).
        is_needed: Whether pictures need the tangent of each vertex, shape (n,). A warning counts only these vertices.
        name: Name of the source of the tangents, for messages.
        has_poles: Whether single vertices without a tangent are expected, such as the poles of a direction field. The
            warning then counts only the vertices of faces that have no tangent at any corner.
    """
    missing = (field == 0.0).all(axis=0)
    if not missing.any():
        return field
    counted = missing & is_needed
    if has_poles:
        counted &= np.isin(np.arange(len(missing)), faces[:, missing[faces].all(axis=0)])
    lacking, needed = int(np.count_nonzero(counted)), int(np.count_nonzero(is_needed))
    if lacking:
        if lacking == needed:
            raise ArgumentValueError(
                f"{name} must define a direction along the surface, got none at any vertex: give another direction, "
                f"such as {ref('tangents', 'smooth')}"
            )
        warn(
            f"{name}: no direction along the surface at {lacking} of {needed} vertices; they get the mean direction of "
            "their neighbours"
        )
    count = int(welded.max()) + 1
    corners = welded[faces]
    start = corners[[0, 1, 2, 0, 1, 2]].ravel()
    end = corners[[1, 2, 0, 2, 0, 1]].ravel()
    at = unit(np.stack([sum_at(welded, component, count) for component in field]))
    while True:
        known = (at != 0.0).any(axis=0)
        useful = known[start] & ~known[end]
        new = unit(np.stack([sum_at(end[useful], component[start[useful]], count) for component in at]))
        if not new.any():
            break
        at += new
    # In a connected part of the mesh where no vertex has a tangent, all vertices get the sum of the tangents of the
    # whole mesh, projected onto their tangent planes.
    at = np.where(at.any(axis=0), at, field.sum(axis=1)[:, None])
    field = np.where(missing, unit(tangential(at.take(welded, axis=1), normals)), field)
    # Some faces still have no tangent at any corner, for example faces perpendicular to all tangents around them. Their
    # vertices get any vector perpendicular to the normal.
    is_zero = (field == 0.0).all(axis=0)
    if is_zero.any():
        corners = np.unique(faces[:, is_zero[faces].all(axis=0)])
        field[:, corners] = any_tangents(normals[:, corners])
    return field


def any_tangents(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a unit vector perpendicular to each normal, from the coordinate axis that is least parallel to it."""
    return unit(tangential(np.eye(3)[:, np.argmin(np.abs(normals), axis=0)], normals))


def _sides_of_edges(
    faces: NDArray[np.integer[Any]], welded: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return for each mesh edge the corners of its two faces at which the edge starts, as indices of ``faces.ravel()``.

    The result is None unless every edge has exactly two faces, which traverse the edge in opposite directions.
    """
    start = welded.take(faces)
    end = start[[1, 2, 0]]
    edges = (np.minimum(start, end) * (int(welded.max()) + 1) + np.maximum(start, end)).ravel()
    order = np.argsort(edges)
    edges = edges[order]
    one, other = order[::2], order[1::2]
    if len(edges) % 2 or np.any(edges[::2] != edges[1::2]) or np.any(edges[2::2] == edges[1:-1:2]):
        return None
    ascends = (start < end).ravel()
    return None if np.any(ascends[one] == ascends[other]) else (one, other)


def is_closed(vertices: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> bool:
    """Return whether the faces bound bodies, with counter-clockwise corners as viewed from outside of each body.

    In such a mesh, the volume of each body is positive. As many faces traverse an edge in one direction as in the
    opposite direction.
    """
    welded = weld(vertices)[0]
    start = welded.take(faces)
    end, count = start[[1, 2, 0]], int(welded.max()) + 1
    if not np.array_equal(np.sort(start * count + end, axis=None), np.sort(end * count + start, axis=None)):
        return False
    from scipy.sparse import coo_array, csgraph

    ends = start[:2].ravel(), end[:2].ravel()
    bodies, body = csgraph.connected_components(coo_array((np.ones(len(ends[0])), ends), shape=(count, count)))
    first, second, third = (vertices.take(corner, axis=1) for corner in faces)
    sixfold = np.bincount(body[start[0]], dot(first, np.cross(second, third, axis=0)), bodies)
    return bool(np.all(sixfold[np.unique(body[start[0]])] > 0.0))


def is_convex(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], outward: NDArray[np.float64], welded: NDArray[np.int64]
) -> bool:
    """Return whether the faces lie in one plane or bound one convex body. ``outward`` are the normals of the faces.

    A convex body is closed, bent outwards at every edge, and has the Euler characteristic of a sphere.
    """

    def heights_over(face: int) -> NDArray[np.float64]:
        normal = outward[:, face]
        return np.asarray(normal @ vertices - normal @ vertices[:, faces[0, face]])

    if np.all(np.abs(heights_over(0)) <= 1e-6):
        return True
    # Most bodies are not convex. A quick test finds this for most of them: no vertex may be above the planes of a few
    # faces.
    number = faces.shape[1]
    if any(heights_over(face).max() > 1e-5 for face in range(0, number, number // 16 + 1)):
        return False
    both = _sides_of_edges(faces, welded)
    if both is None or int(welded.max()) + 1 - len(both[0]) + number != 2:
        return False
    one, other = both
    # At each edge of a convex body, neither of the two faces rises above the plane of the other.
    level = dot(outward, vertices.take(faces[0], axis=1))
    opposite = faces[[2, 0, 1]].ravel()
    for here, beyond in ((one, other), (other, one)):
        face = here % number
        if np.any(dot(outward.take(face, axis=1), vertices.take(opposite[beyond], axis=1)) > level[face] + 1e-6):
            return False
    return True
