"""Sample bodies with texture coordinates, which also define the x axis of the height field.

This axis is the tangent t of a body, along the increasing texture coordinate u. A grating that varies along x diffracts
along t. On ``tube`` and ``snake``, t runs around the body with ``tangent="around"``, and from head to tail with
``"along"``. On ``disc``, t runs radially outwards. On ``card``, t is +x.

Examples:
    >>> import warpdiff as wd
    >>> len(wd.meshes.disc(segments=64, rings=4).faces)
    512
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.samples.corn_snake import Tangent, check_meander, grid_faces, snake

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray

__all__ = ["card", "disc", "snake", "tube"]


@memory.as_memory_error(
    "a body of this many faces", f"take fewer {ref('segments_along')}, or fewer {ref('segments_around')}"
)
def tube(
    *, radius: float = 0.12, length: float = 3.0, bend_deg: float = 50.0, waves: float = 1.5,
    tangent: Tangent = "around", segments_along: int = 256, segments_around: int = 96,
) -> trimesh.Trimesh:  # fmt: skip
    """Make the body of a snake: a round tube along a meander, with a blunt head and a tapering tail.

    The tube is centred at the origin in the xz plane, from the head at −x to the tail at +x, with its back towards +y.
    The heading of the centre line is ``bend_deg`` · cos(2π ``waves`` s / ``length``). The seam of the texture runs
    along the belly.

    With ``tangent="around"`` the tangent t runs around the body. Nano-fingers on a snake are oriented in this way: the
    colours form bands along the body, and (t, head to tail, outwards) is right-handed. With ``"along"`` t runs from
    head to tail, and the bands run across the body.

    Args:
        radius: Largest radius of the body [mesh units], more than 0, default 0.12.
        length: Length of the centre line [mesh units], at least 5 radii, default 3.
        bend_deg: Largest angle between the centre line and the x axis [degrees], 0 (a straight body) to 120, default
            50.
        waves: Number of periods of the meander, at least 0, default 1.5.
        tangent: Direction of t, ``"around"`` (default) or ``"along"`` the body.
        segments_along: Number of rings of quadrilaterals from head to tail, at least 12, default 256.
        segments_around: Number of quadrilaterals per ring, at least 3, default 96.

    Returns:
        A mesh with texture coordinates and vertex normals, of 2 · (segments_along − 1) · segments_around faces. It is
        closed; vertices are doubled along the seam.

    Raises:
        ValueError: An argument is out of its range, or the bends are narrower than the body.

    Examples:
        >>> import warpdiff as wd
        >>> tube = wd.meshes.tube(segments_along=12, segments_around=8)
        >>> len(tube.faces)
        176
    """
    check_meander(radius, length, bend_deg, waves, tangent)
    validation.count(segments_along, "segments_along", least=12)
    validation.count(segments_around, "segments_around", least=3)
    memory.require_faces(
        2 * segments_along * segments_around,
        f"take {{share}} of {ref('segments_along')}, or of {ref('segments_around')}",
    )
    if length < 5.0 * radius:
        raise ArgumentValueError(f"{ref('length')} must be at least 5 radii ({5.0 * radius:g}), got {length:g}")
    bend = math.radians(bend_deg)
    curvature = bend * 2.0 * math.pi * waves / length
    if curvature * radius > 0.9:
        raise ArgumentValueError(
            f"{ref('bend_deg')} and {ref('waves')} must leave the bends wider than the body, got a bend of radius "
            f"{1.0 / curvature:g} for a body of radius {radius:g}; reduce one of them"
        )

    # At the head and at the tail, the radius of the body as a function of arc length is a half ellipse. The rings of
    # vertices are at equal steps in the angle of the ellipse, so that they are dense at the tips.
    head, tail = 2.0 * radius, max(2.0 * radius, 0.4 * length)
    at_head, at_tail = segments_along // 8, segments_along // 3
    head_angle = np.linspace(0.0, math.pi / 2.0, at_head + 1)
    tail_angle = np.linspace(math.pi / 2.0, 0.0, at_tail + 1)
    middle = np.linspace(head, length - tail, segments_along - at_head - at_tail + 1)
    s = np.concatenate([head * (1.0 - np.cos(head_angle)), middle[1:-1], length - tail * (1.0 - np.cos(tail_angle))])
    angle = np.concatenate([head_angle, np.full(len(middle) - 2, math.pi / 2.0), tail_angle])
    semi_axis = np.where(s <= head, head, -tail)
    rings_radius = radius * np.sin(angle)
    rings_radius[[0, -1]] = 0.0

    centre, theta, bending = _meander(s, bend, 2.0 * math.pi * waves / length)
    forward = np.stack([np.cos(theta), np.zeros_like(s), np.sin(theta)], axis=1)
    sideways = np.stack([np.sin(theta), np.zeros_like(s), -np.cos(theta)], axis=1)

    # The texture coordinate u increases around the body from the belly, in the direction for which (around, forward,
    # outward) are right-handed.
    turn = np.arange(segments_around + 1) / segments_around
    phi = 2.0 * math.pi * turn - math.pi / 2.0
    phi[-1] = phi[0]  # The first and last vertex of a ring get exactly the same position.
    out = np.cos(phi)[None, :, None] * sideways[:, None, :] + np.sin(phi)[None, :, None] * np.array([0.0, 1.0, 0.0])
    vertices = centre[:, None, :] + rings_radius[:, None, None] * out
    # The normal is proportional to ds/dψ · stretch · out − dr/dψ · forward, where s is the arc length, r the radius and
    # ψ the angle of the half ellipse. In this form the normal is finite at the tips. The factor `stretch` is the length
    # of the surface divided by that of the centre line; on the inner side of a bend the factor is less than 1.
    stretch = 1.0 + bending[:, None] * rings_radius[:, None] * np.cos(phi)
    ds = semi_axis * np.sin(angle)
    dr = radius * np.cos(angle)
    normals = np.sign(semi_axis)[:, None, None] * (
        (ds[:, None] * stretch)[:, :, None] * out - dr[:, None, None] * forward[:, None, :]
    )
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)

    ring = s / length
    around, along = np.meshgrid(turn, ring)
    # At a tip of the body, each triangle has a vertex of its own, whose texture coordinate u is that of the middle of
    # the triangle.
    around[[0, -1]] += 0.5 / segments_around
    uvs = np.stack([around, along] if tangent == "around" else [along, 1.0 - around], axis=2)
    faces = _alternating_faces(len(s), segments_around + 1)
    # The rings of vertices at the two tips of the body have zero radius. The quadrilaterals next to them are therefore
    # triangles.
    columns = segments_around + 1
    last = (len(s) - 1) * columns
    i = np.arange(segments_around)
    inner = faces[np.all((faces >= columns) & (faces < last), axis=1)]
    first_cap = np.stack([i, columns + i + 1, columns + i], axis=1)
    last_cap = np.stack([last + i, last - columns + i, last - columns + i + 1], axis=1)
    return _mesh(vertices, np.concatenate([first_cap, inner, last_cap]), normals, uvs)


def card(width: float = 1.0, height: float = 0.75) -> trimesh.Trimesh:
    """Make a card: a flat rectangle in the xy plane, centred at the origin, that faces +z.

    The texture coordinates are those of an image: u increases from 0 to 1 along +x, and v from 0 to 1 along +y. The
    tangent t is +x.

    Args:
        width: Length along x [mesh units], more than 0, default 1.
        height: Length along y [mesh units], more than 0, default 0.75.

    Returns:
        A mesh of two triangles with texture coordinates and vertex normals.

    Raises:
        ValueError: A length is not positive.

    Examples:
        >>> import warpdiff as wd
        >>> wd.meshes.card(60.0, 45.0).extents.tolist()
        [60.0, 45.0, 0.0]
    """
    half = np.array([validation.positive(width, "width"), validation.positive(height, "height")]) / 2.0
    uvs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = np.column_stack([(2.0 * uvs - 1.0) * half, np.zeros(4)])
    return _mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0.0, 1.0], (4, 1)), uvs)


@memory.as_memory_error("a body of this many faces", f"take fewer {ref('segments')}, or fewer {ref('rings')}")
def disc(
    *, inner_radius: float = 0.4, outer_radius: float = 1.0, segments: int = 512, rings: int = 24
) -> trimesh.Trimesh:
    """Make an optical disc: a flat ring in the xy plane, centred at the origin, that faces +z.

    The tangent t runs radially outwards, across the tracks. The texture coordinate u increases from the inner to the
    outer rim, and v increases counter-clockwise as viewed from +z. The seam is on the +x axis.

    Args:
        inner_radius: Radius of the hole [mesh units], at least 0 (no hole), less than ``outer_radius``, default 0.4.
        outer_radius: Radius of the rim [mesh units], more than 0, default 1.
        segments: Number of quadrilaterals around the disc, at least 3, default 512.
        rings: Number of quadrilaterals from the inner to the outer rim, at least 1, default 24. More quadrilaterals
            make t more exactly radial.

    Returns:
        A mesh with texture coordinates and vertex normals, of 2 · segments · rings faces; without a hole it has
        ``segments`` triangles fewer.

    Raises:
        ValueError: An argument is out of its range.

    Examples:
        >>> import warpdiff as wd
        >>> disc = wd.meshes.disc(inner_radius=0.2, segments=64, rings=4)
        >>> disc.bounds[1].round(3)
        array([1., 1., 0.])
    """
    validation.number(inner_radius, "inner_radius", least=0.0)
    validation.positive(outer_radius, "outer_radius")
    if inner_radius >= outer_radius:
        raise ArgumentValueError(
            f"{ref('inner_radius')} must be below {ref('outer_radius')} ({outer_radius:g}), got {inner_radius:g}"
        )
    validation.count(segments, "segments", least=3)
    validation.count(rings, "rings", least=1)
    memory.require_faces(2 * segments * rings, f"take {{share}} of {ref('segments')}, or of {ref('rings')}")
    turn = np.arange(segments + 1) / segments
    phi = 2.0 * math.pi * turn
    phi[-1] = 0.0
    share = np.arange(rings + 1) / rings
    r = inner_radius + share * (outer_radius - inner_radius)
    vertices = np.stack([r * np.cos(phi)[:, None], r * np.sin(phi)[:, None], np.zeros((segments + 1, rings + 1))], 2)
    v, u = np.meshgrid(turn, share, indexing="ij")
    faces = _alternating_faces(segments + 1, rings + 1)
    if inner_radius == 0.0:
        # Faces with two corners at the centre of the disc have no area and are removed. In the remaining triangles, the
        # vertex at the centre has the texture coordinate v of the triangle's middle.
        v[:, 0] += 0.5 / segments
        column = np.arange(segments) * (rings + 1)
        fan = np.stack([column, column + 1, column + rings + 2], axis=1)
        faces = np.concatenate([fan, faces[np.all(faces % (rings + 1) != 0, axis=1)]])
    normals = np.broadcast_to([0.0, 0.0, 1.0], vertices.shape)
    return _mesh(vertices, faces, normals, np.stack([u, v], axis=2))


def _meander(
    s: NDArray[np.float64], bend: float, frequency: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return points (k, 3), headings (k,) [rad] and curvatures (k,) of a tube's centre line at arc lengths ``s``."""
    # The positions are integrated from the headings by the midpoint rule, with steps much finer than the distance of
    # rings.
    parts = 16
    step = np.diff(s)[:, None] / parts
    fine = bend * np.cos(frequency * (s[:-1, None] + step * (np.arange(parts) + 0.5)))
    x = np.concatenate([[0.0], np.cumsum(np.sum(np.cos(fine) * step, axis=1))])
    z = np.concatenate([[0.0], np.cumsum(np.sum(np.sin(fine) * step, axis=1))])
    points = np.stack([x, np.zeros_like(x), z], axis=1)
    points -= (points.min(axis=0) + points.max(axis=0)) / 2.0
    return points, bend * np.cos(frequency * s), -bend * frequency * np.sin(frequency * s)


def _alternating_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Return two triangles per quadrilateral of a grid of vertices, oriented like the faces of ``grid_faces``.

    The direction of the diagonals alternates from one quadrilateral to the next. Means over the faces around a vertex
    are therefore not biased to one side.
    """
    row, column = np.indices((rows - 1, columns - 1))
    is_even = np.repeat((row + column) % 2 == 0, 2)[:, None]
    return np.where(is_even, grid_faces(columns, rows, rising=True), grid_faces(columns, rows))


def _mesh(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], normals: NDArray[np.float64], uvs: NDArray[np.float64]
) -> trimesh.Trimesh:
    """Return a mesh from vertices, normals and texture coordinates. Doubled vertices at the seam are not merged."""
    import trimesh

    return trimesh.Trimesh(
        vertices=vertices.reshape(-1, 3), faces=faces, vertex_normals=normals.reshape(-1, 3),
        visual=trimesh.visual.TextureVisuals(uv=uvs.reshape(-1, 2)), process=False,
    )  # fmt: skip
