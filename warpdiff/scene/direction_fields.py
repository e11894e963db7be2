"""Direction fields on a mesh without texture coordinates: along or around an axis, or as smooth as possible.

A smooth field is the least eigenvector of the connection Laplacian, a complex matrix with one row per node. A node is a
position of the mesh with its tangent plane. Vertices at one position share a node unless their normals are opposite.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.scene.mesh_geometry import FaceGeometry, compacted, dot, sum_at, tangential, unit

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from scipy.sparse import csr_array

    from warpdiff.request.settings import TangentRule

# Largest number of vertex positions in a connected part of a mesh for which a smooth direction field is computed. The
# number is limited by time and memory: a torus of 99,000 positions required 5 s and 0.6 GB. Twice as many positions
# require more than twice as much of both.
MOST_POSITIONS = 100_000
# Vertices at one position belong to opposite sides of a thin sheet if the cosine of the angle between their normals is
# below this number. It is the cosine of 150°, which was chosen because normals at edges of solid bodies have smaller
# angles.
_OPPOSITE_COSINE = float(np.cos(np.radians(150.0)))
# Smallest and largest weight of a mesh edge in the connection Laplacian. With a negative weight, which obtuse angles
# cause, a direction field that rotates along the edge would count as smoother. Weights of extremely narrow triangles
# would exceed the accuracy of float64.
_LEAST_WEIGHT, _MOST_WEIGHT = 1e-3, 1e3
# Smallest area of a node, relative to the mean area of all nodes. A node is a vertex position, and its area is a third
# of the area of its faces. Areas of extremely narrow triangles would underflow.
_LEAST_MASS = 1e-9
# Shift that is added to the eigenvalues of the connection Laplacian, in units of 1 / area of a connected part. The
# least eigenvalue of a plane is 0, so that its matrix could not be factorised without a shift. The eigenvalues of round
# bodies are about 10.
_SHIFT = 1e-4
# Inverse iteration for the eigenvectors of the connection Laplacian: number of random vectors among the start vectors,
# largest number of iterations, and relative change of the least eigenvalue at which the iterations end. With these
# values, the integral of the squared derivative of the direction field is within 0.1 % of the minimum.
_RANDOM, _MOST_ITERATIONS, _CONVERGED = 2, 40, 1e-4
# Eigenvectors count as equally smooth if their eigenvalues exceed the least eigenvalue by at most this fraction. On a
# sphere, several eigenvalues are equal, but on a mesh that approximates the sphere they differ by about this fraction.
_EQUAL_SHARE = 0.02
# Largest number of nodes of a connected part of the mesh whose connection Laplacian is a dense matrix, and largest
# number of elements of a batch of such matrices. Sparse matrices of small parts would require 5 ms each, mainly for
# function calls. A batch has 4 MB.
_MOST_DENSE, _MOST_ELEMENTS = 64, 2**18
# The direction field is zero at a node (vertex position) where the magnitude of the eigenvector, relative to its
# largest magnitude, is below this number. Such values are only rounding errors.
_LEAST_SIZE = 1e-13


@dataclass(frozen=True, eq=False)
class Body:
    """Vertices and faces on which a direction field is computed.

    Attributes:
        vertices: Positions, shape (3, n).
        faces: Vertex indices, shape (3, m).
        normals: Unit vertex normals, shape (3, n); zero where no direction is defined.
        welded: Index of each vertex's position, which is equal for vertices at one position, shape (n,).
        objects: Number of the object to which each face belongs, shape (m,).
        is_used: Whether each face needs directions, shape (m,). Smooth fields are zero elsewhere.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64]
    welded: NDArray[np.int64]
    objects: NDArray[np.int64]
    is_used: NDArray[np.bool_]

    @property
    def needs_directions(self) -> NDArray[np.bool_]:
        """Whether each vertex belongs to a face that needs tangent directions, shape (n,)."""
        result = np.zeros(self.vertices.shape[1], np.bool_)
        result[self.faces[:, self.is_used]] = True
        return result


def direction_field(rule: TangentRule, body: Body) -> NDArray[np.float64]:
    """Return directions at the vertices of a body by a rule such as ``"x"`` or ``"around-x"``, shape (3, n).

    The directions have any length, and some rules return directions that are not tangential.
    """
    if rule == "smooth":
        return _smooth(body)
    axis = np.eye(3)["xyz".index(rule[-1])]
    if rule.startswith("around"):
        return _around(axis, body)
    return np.tile(axis[:, None], body.vertices.shape[1])


def _around(axis: NDArray[np.float64], body: Body) -> NDArray[np.float64]:
    """Return directions around an axis that passes through the centroid of each object's surface."""
    areas = FaceGeometry(body.vertices, body.faces).twice_area
    count = int(body.objects.max()) + 1
    middles = np.stack([component.take(body.faces).mean(axis=0) for component in body.vertices])
    centres = np.stack([sum_at(body.objects, areas * middle, count) for middle in middles])
    # An object without any face of non-zero area has a total area of 0, which must not be a divisor.
    centres /= np.maximum(sum_at(body.objects, areas, count), np.finfo(float).tiny)
    of_vertices = np.zeros(body.vertices.shape[1], np.int64)
    of_vertices[body.faces] = body.objects
    return np.cross(axis, body.vertices - centres.take(of_vertices, axis=1), axisb=0, axisc=0)


def _smooth(body: Body) -> NDArray[np.float64]:
    """Return unit directions at vertices that change as little as possible along the surface.

    The field is the least eigenvector of the connection Laplacian, which minimises the integral of the squared
    derivative (Knöppel, Crane, Pinkall and Schröder, "Globally optimal direction fields", 2013, section 3). A vector is
    transported along an edge by the smallest rotation between the normals at its ends. This transport also works on
    meshes that are no manifolds, unlike the angles of Sharp, Soliman and Crane ("The vector heat method", 2019, section
    5).
    """
    used, faces = compacted(body.faces.compress(body.is_used, axis=1), body.vertices.shape[1])
    result = np.zeros_like(body.vertices)
    if len(used):
        normals = body.normals.take(used, axis=1)
        net = _Net.of(body.vertices.take(used, axis=1), faces, normals, body.welded[used])
        field = np.zeros(len(net.mass), np.complex128)
        for nodes in net.components():
            field[nodes] = _smoothest(net, nodes)
        at_nodes = field.real * net.first + field.imag * net.second
        node = net.node
        result[:, used] = _rotated(at_nodes.take(node, axis=1), net.normals.take(node, axis=1), normals)
    return result


@dataclass(frozen=True, eq=False)
class _Net:
    """Nodes of a mesh, with the connection Laplacian of tangential vectors at the nodes.

    A node is a position of the mesh with its tangent plane. A complex number z at a node stands for the tangential
    vector Re z · ``first`` + Im z · ``second``.

    Attributes:
        node: Node of each vertex, shape (n,).
        positions: Positions of the nodes, shape (3, k).
        normals: Unit normals of the nodes, shape (3, k).
        first: First unit vector of each plane, shape (3, k).
        second: Second unit vector of each plane, shape (3, k).
        mass: Area of each node, shape (k,).
        laplacian: Connection Laplacian, complex and Hermitian, shape (k, k).
    """

    node: NDArray[np.int64]
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    mass: NDArray[np.float64]
    laplacian: csr_array

    @classmethod
    def of(
        cls, vertices: NDArray[np.float64], faces: NDArray[np.int64], normals: NDArray[np.float64],
        welded: NDArray[np.int64],
    ) -> _Net:  # fmt: skip
        """Return the nodes of a mesh. Vertices at one position share a node unless they have opposite normals."""
        from scipy.sparse import coo_array

        geometry = FaceGeometry(vertices, faces)
        first_vertex = np.zeros(int(welded.max()) + 1, np.int64)
        first_vertex[welded[::-1]] = np.arange(len(welded))[::-1]
        is_opposite = dot(normals, normals.take(first_vertex[welded], axis=1)) < _OPPOSITE_COSINE
        _, node = np.unique(2 * welded + is_opposite, return_inverse=True)
        count = int(node.max()) + 1
        positions = np.stack([sum_at(node, component, count) for component in vertices]) / np.bincount(node)
        weights = sum_at(faces, geometry.angles, len(welded))
        of_nodes = unit(np.stack([sum_at(node, weights * component, count) for component in normals]))
        first, second = _planes(of_nodes)

        # The weight of an edge is half of the sum of the cotangents of the two angles opposite to the edge.
        corners = node[faces]
        start, end = corners[[1, 2, 0]].ravel(), corners[[2, 0, 1]].ravel()
        weight = 0.5 * (geometry.products / geometry.twice_area).ravel().clip(_LEAST_WEIGHT, _MOST_WEIGHT)
        moved = _rotated(first.take(end, axis=1), of_nodes.take(end, axis=1), of_nodes.take(start, axis=1))
        turn = unit(np.stack([dot(moved, axes.take(start, axis=1)) for axes in (first, second)]))
        entries = -weight * (turn[0] + 1j * turn[1])
        ends = np.concatenate([start, end])
        diagonal = sum_at(ends, np.concatenate([weight, weight]), count)
        laplacian = coo_array(
            (np.concatenate([entries, entries.conj(), diagonal]),
             (np.concatenate([ends, np.arange(count)]), np.concatenate([end, start, np.arange(count)]))),
            shape=(count, count),
        ).tocsr()  # fmt: skip
        mass = sum_at(corners, np.broadcast_to(geometry.twice_area / 6.0, corners.shape), count)
        return cls(node, positions, of_nodes, first, second, mass, laplacian)

    def components(self) -> Iterator[NDArray[np.int64]]:
        """Yield the nodes of connected components of the mesh. Components of equal size form one array each.

        The shape of an array is (components, size). Components of more than ``_MOST_DENSE`` nodes are separate. Before
        the first one, an error is raised if any component is too large.
        """
        from scipy.sparse import csgraph

        _, component = csgraph.connected_components(abs(self.laplacian), directed=False)
        sizes = np.bincount(component)
        if sizes.max() > MOST_POSITIONS:
            raise ArgumentValueError(
                f"{ref('tangents', 'smooth')} requires connected parts of at most {MOST_POSITIONS:,} positions, got "
                f"{sizes.max():,}: use a mesh with fewer faces, or another rule, such as {ref('tangents', 'x')}"
            )
        order, start = np.lexsort((component, sizes[component])), 0
        for size, count in zip(*np.unique(sizes, return_counts=True), strict=True):
            group = order[start : start + size * count].reshape(count, size)
            step = max(1, _MOST_ELEMENTS // size**2) if size <= _MOST_DENSE else 1
            yield from (group[first : first + step] for first in range(0, count, step))
            start += size * count

    def matrices(self, nodes: NDArray[np.int64]) -> NDArray[np.complex128]:
        """Return the connection Laplacians of components of k nodes as dense matrices, shape (components, k, k).

        A component is a connected part of the mesh, and a node is a vertex position.
        """
        result = np.zeros((*nodes.shape, nodes.shape[1]), np.complex128)
        local = np.zeros(len(self.mass), np.int64)
        local[nodes] = np.arange(nodes.shape[1])
        rows = self.laplacian[nodes.ravel()].tocoo()
        result.reshape(-1, nodes.shape[1])[rows.coords[0], local[rows.coords[1]]] = rows.data
        return result

    def candidates(self, nodes: NDArray[np.int64]) -> NDArray[np.complex128]:
        """Return six candidate fields of unit vectors at the nodes of components, as complex numbers, shape (…, 6).

        A component is a connected part of the mesh, and a node is a vertex position. The fields are along the three
        coordinate axes and around them. For bodies of revolution, plates and other symmetric bodies, one of these
        fields is the smooth field.
        """
        positions, mass, normals = (
            self.positions.take(nodes, axis=1),
            self.mass[nodes],
            self.normals.take(nodes, axis=1),
        )
        arms = positions - np.sum(positions * mass, axis=-1, keepdims=True) / mass.sum(axis=-1, keepdims=True)
        axes = np.eye(3)
        fields = [np.broadcast_to(axis[:, None, None], arms.shape) for axis in axes]
        fields += [np.cross(axis, arms, axisb=0, axisc=0) for axis in axes]
        units = [unit(tangential(field, normals)) for field in fields]
        first, second = self.first.take(nodes, axis=1), self.second.take(nodes, axis=1)
        return np.stack([dot(field, first) + 1j * dot(field, second) for field in units], axis=-1)


def _smoothest(net: _Net, nodes: NDArray[np.int64]) -> NDArray[np.complex128]:
    """Return the smoothest direction fields on connected components of equal size, as complex numbers at the nodes.

    The numbers have a magnitude of 1. Several eigenvectors may be equally smooth. A common rotation of all vectors, for
    example, never changes the smoothness. The field is then the combination of these eigenvectors that is nearest to a
    candidate: a field along or around a coordinate axis. Candidates are ordered by preference. The first candidate is
    chosen whose projection onto the eigenvectors has at least half of the squared norm of the largest projection.

    Args:
        net: Nodes of the mesh, with their connection Laplacian.
        nodes: Nodes of the components, shape (components, size).
    """
    mass, size = net.mass[nodes], nodes.shape[1]
    root = np.sqrt(np.maximum(mass / mass.sum(axis=1, keepdims=True), _LEAST_MASS / size))
    candidates = root[..., None] * net.candidates(nodes)
    if size <= _MOST_DENSE:
        eigenvalues, eigenvectors = np.linalg.eigh(net.matrices(nodes) / (root[..., None] * root[:, None]))
    else:
        (one,) = nodes
        results = _least_eigenvectors(net.laplacian[one][:, one], root[0], candidates[0])
        eigenvalues, eigenvectors = (result[None] for result in results)
    is_least = eigenvalues <= (1.0 + _EQUAL_SHARE) * eigenvalues[:, :1] + _SHIFT
    eigenvectors = eigenvectors * is_least[:, None]
    parts = eigenvectors.conj().swapaxes(1, 2) @ candidates
    shares = np.sum(np.abs(parts) ** 2, axis=1)
    largest = shares.max(axis=1, keepdims=True)
    chosen = np.take_along_axis(parts, np.argmax(shares >= 0.5 * largest, axis=1)[:, None, None], axis=2)
    # If the projections of all candidate fields onto the eigenvectors are 0, the field is the first eigenvector.
    chosen[:, 0] += largest == 0.0
    field = (eigenvectors @ chosen)[..., 0]
    sizes = np.abs(field)
    is_zero = sizes <= _LEAST_SIZE * sizes.max(axis=1, keepdims=True)
    return np.asarray(np.where(is_zero, 0.0, field / np.where(is_zero, 1.0, sizes)))


def _least_eigenvectors(
    laplacian: csr_array, root: NDArray[np.float64], start: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return the least eigenvalues of a matrix and their eigenvectors, by inverse subspace iteration (Rayleigh–Ritz).

    Args:
        laplacian: Connection Laplacian of one connected component, shape (k, k).
        root: Square roots of the areas of the nodes, shape (k,). The sum of the areas is 1.
        start: Vectors with which the iteration starts, besides random vectors, shape (k, columns).

    Returns:
        Eigenvalues in ascending order, shape (columns,), and orthonormal eigenvectors, shape (k, columns). A direction
        field is an eigenvector divided by ``root``.
    """
    from scipy.sparse import diags_array, eye_array
    from scipy.sparse.linalg import splu

    scale = diags_array(1.0 / root)
    matrix = (scale @ laplacian @ scale).tocsc()
    shifted = (matrix + _SHIFT * eye_array(len(root))).tocsc()
    factors = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    # Random start vectors are added. If all start vectors were perpendicular to the least eigenvector, the iteration
    # could not find it.
    random = np.exp(2j * np.pi * np.random.default_rng(0).random((len(root), _RANDOM)))
    block, least = np.concatenate([start, root[:, None] * random], axis=1), np.inf
    for _ in range(_MOST_ITERATIONS):
        block = np.linalg.qr(factors.solve(block)).Q
        eigenvalues, rotation = np.linalg.eigh(block.conj().T @ (matrix @ block))
        block, last, least = block @ rotation, least, eigenvalues[0]
        if last - least <= _CONVERGED * least + _SHIFT:
            break
    return eigenvalues, block


def _planes(normals: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors perpendicular to each unit normal and to each other (Duff et al. 2017)."""
    x, y, z = normals
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x**2 * a, sign * b, -sign * x]), np.stack([b, sign + y**2 * a, -y])


def _rotated(
    vectors: NDArray[np.float64], before: NDArray[np.float64], after: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return vectors, perpendicular to the normals ``before``, after the smallest rotation to the normals ``after``."""
    # Between opposite normals, the axis of the rotation is undefined. The limit 1e-6 then keeps the divisor positive.
    factor = dot(vectors, after) / np.maximum(1.0 + dot(before, after), 1e-6)
    return np.asarray(vectors - factor * (before + after))
