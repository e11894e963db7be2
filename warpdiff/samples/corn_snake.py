"""Sample body of a snake: overlapping scales, with the pattern of a corn snake (*Pantherophis guttatus*).

The shape is defined on the unrolled skin, in lattice coordinates (x, τ). x counts rows of scales across the back, from
one edge of the belly to the other. τ counts scales from the neck to the tail. A scale is a rhombus with half diagonals
(1, ½). The coordinates a and b on a scale, 0 to 1, increase along its two front edges from the front corner.
Neighbouring rows are shifted by half a scale. The half rhombi at the edges of the belly are the ends of the ventral
scutes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

Tangent = Literal["around", "along"]

# Length of the head, and largest length of the snake [radii of the body]. The centre line is sampled at 4,097 points.
# The length is limited because bends of a longer snake would be inaccurate with this number of points.
_HEAD_LENGTH, _LONGEST = 2.5, 1e3
# Cross sections of the head and of the body, chosen by eye. Columns: position as a fraction of the length of the head
# or of the body; half width, height above the centre line and depth below the centre line [radii of the body]; exponent
# of the superellipse (2 is an ellipse, larger exponents are squarer).
_HEAD = np.array([
    [0.00, 0.36, 0.22, 0.16, 2.4], [0.25, 0.47, 0.32, 0.22, 2.6], [0.50, 0.60, 0.41, 0.27, 2.7],
    [0.75, 0.71, 0.46, 0.33, 2.6], [0.90, 0.68, 0.46, 0.35, 2.4],
])  # fmt: skip
_BODY = np.array([
    [0.02, 0.55, 0.46, 0.39, 2.2], [0.06, 0.56, 0.52, 0.42, 2.2], [0.20, 0.80, 0.78, 0.60, 2.3],
    [0.40, 1.00, 0.96, 0.72, 2.4], [0.60, 0.98, 0.94, 0.70, 2.4], [0.78, 0.72, 0.68, 0.54, 2.3],
    [0.90, 0.38, 0.36, 0.30, 2.1], [1.00, 0.06, 0.06, 0.06, 2.0],
])  # fmt: skip
# Centres of the shields (large scales) on one side of the head, in the arrangement of colubrid snakes. Coordinates:
# fraction of the head's length, and fraction of the circumference from the middle of the back.
_SHIELDS = np.array(
    [(0.0, 0.0), (0.10, 0.05), (0.23, 0.055), (0.42, 0.0), (0.43, 0.095), (0.66, 0.06), (0.88, 0.0), (0.90, 0.06)]
    + [(0.07, 0.15), (0.15, 0.16), (0.25, 0.165), (0.33, 0.15), (0.54, 0.155), (0.64, 0.17), (0.77, 0.16), (0.89, 0.13)]
    + [(0.97, 0.03), (0.97, 0.095), (0.97, 0.16), (0.90, 0.19), (0.97, 0.23), (0.90, 0.25), (0.97, 0.30), (0.92, 0.32)]
    + [(at, 0.235) for at in (0.03, 0.12, 0.21, 0.31, 0.41, 0.52, 0.65, 0.79)]
    + [(at, 0.325) for at in (0.03, 0.13, 0.24, 0.35, 0.46, 0.58, 0.70, 0.82)]
    + [(at, 0.42) for at in (0.12, 0.32, 0.50, 0.66, 0.80, 0.93)]
)
# Position and size of the eye, and position of the mouth, chosen by eye. `_EYE` is the centre of the eye, as fractions
# of the head's length and of the circumference. `_EYE_RADIUS` is its radius [radii of the body]. `_MOUTH` is a fraction
# of the circumference.
_EYE, _EYE_RADIUS, _MOUTH = (0.43, 0.165), 0.18, 0.28
# Length and circumference of the head [radii of the body], by which positions on the head, given as fractions, are
# converted to distances.
_HEAD_SPREAD = np.array([_HEAD_LENGTH, 4.0])
# Lengths of the rounded ends of the head (snout) and of the tail (tip) [radii of the body].
_SNOUT, _TIP = 0.4, 0.3
# Width of one half of the belly as a fraction of the body's circumference, chosen by eye.
_BELLY = 0.15

# Relief of a scale [lengths of a scale], chosen by eye: height of its free rear end, length by which it overlaps the
# next scales, and height of its dome.
_STAND_OFF, _OVERHANG, _DOME = 0.10, 0.10, 0.035
# Curvature of the edges of a scale: largest displacement to the rear [lengths of a scale] and to the sides [rows].
_BOW, _BOW_SIDEWAYS = 0.07, 0.10
# Distance over which the relief of the scales increases from 0 at the neck and decreases to 0 at the tail [scales].
_FADE = 2.0
# Width of the walls under the free edges of scales, as drawn in the texture [scales].
_RISER = 0.05

# Colours of the pattern in sRGB, chosen by eye.
_GROUND, _FLANK, _SADDLE = (0.74, 0.42, 0.19), (0.70, 0.53, 0.36), (0.54, 0.14, 0.07)
_BLACK, _CREAM, _IRIS = (0.05, 0.04, 0.035), (0.90, 0.85, 0.74), (0.62, 0.24, 0.08)
# Lengths of the head and of the tip of the tail in the texture [lengths of a scale of the body].
_HEAD_SCALES, _TIP_SCALES = 16.0, 1.0
# Number of texels per scale along the body, and per row of scales around the body. If doubled, the texture is four
# times as large.
_TEXELS = 8


class _Patch(NamedTuple):
    """Part of the mesh on the unrolled skin.

    Texture coordinates are stored in addition to positions on the skin, because both differ where scales overlap.

    Attributes:
        x: Position around the body [rows], shape (k,).
        tau: Position along the body [scales], shape (k,).
        shift: Displacement of the vertex to the rear [scales], shape (k,).
        rise: Displacement of the vertex outwards [scales], shape (k,).
        u, v: Position around the body [rows] and along the body [scales] at which the texture has the colour of the
            vertex, shape (k,).
        wall: Whether the vertex belongs to the wall under a free edge of a scale, shape (k,).
        faces: Vertex indices, shape (m, 3).
    """

    x: Floats
    tau: Floats
    shift: Floats
    rise: Floats
    u: Floats
    v: Floats
    wall: NDArray[np.bool_]
    faces: NDArray[np.int64]


@np.errstate(under="ignore")
def snake(
    *, radius: float = 0.12, length: float = 4.6, bend_deg: float = 95.0, waves: float = 1.75,
    tangent: Tangent = "around", scale_rows: int = 27, ventrals: int = 130, segments: int = 4, seed: int = 0,
) -> trimesh.Trimesh:  # fmt: skip
    """Make a corn snake on the plane y = 0: overlapping scales, shields on its head, saddles on its back.

    The snake is centred at the y axis, from the head at −x to the tail at +x, with its back towards +y. The heading of
    the centre line is ``bend_deg`` · cos(2π ``waves`` s), with s from 0 to 1 behind the head. Every scale overlaps the
    next ones towards the tail, and the surface and its normals step at the free edge of a scale. The surface is closed.
    The texture is the pattern of *Pantherophis guttatus* and follows the scales. The seam of the texture runs along the
    belly.

    With ``tangent="around"`` the tangent t runs around the body, across the nano-fingers; (t, head to tail, outwards)
    is right-handed. With ``"along"`` t runs from head to tail. The tangents of ``tube`` have the same directions.

    Args:
        radius: Half of the largest width of the body [mesh units], more than 0, default 0.12.
        length: Length of the centre line [mesh units], 16 to 1000 radii, default 4.6.
        bend_deg: Largest angle between the centre line and the x axis [degrees], 0 (a straight body) to 120, default
            95.
        waves: Number of periods of the meander, at least 0, default 1.75.
        tangent: Direction of t, ``"around"`` (default) or ``"along"`` the body.
        scale_rows: Number of rows of scales across the back, odd and at least 5, default 27 as on a corn snake.
        ventrals: Number of scutes of the belly from neck to tail, and of scales in a row, at least 8, default 130.
        segments: Number of pieces into which an edge of a scale is divided, at least 2, default 4. A scale has
            2 · segments² faces, and the wall under its free edge has 4 · segments faces.
        seed: Seed of the pattern, at least 0, default 0.

    Returns:
        A mesh with texture coordinates, vertex normals and a texture, of about 200,000 faces by default. Vertices are
        doubled at the seam, at free edges, and where scales meet the head and the end of the tail.

    Raises:
        ValueError: An argument is out of its range, or the body would intersect itself.

    Examples:
        >>> import warpdiff as wd
        >>> snake = wd.meshes.snake(scale_rows=9, ventrals=20, segments=2)
        >>> len(snake.faces)
        5372
    """
    check_meander(radius, length, bend_deg, waves, tangent)
    if validation.count(scale_rows, "scale_rows", least=5) % 2 == 0:
        raise ArgumentValueError(
            f"{ref('scale_rows')} must be odd (a row on the spine and equal numbers on both sides), got {scale_rows}"
        )
    validation.count(ventrals, "ventrals", least=8)
    validation.count(segments, "segments", least=2)
    validation.count(seed, "seed", least=0)
    # The memory is the peak while the snake is constructed [bytes]. The formula was fitted to measurements. The belly
    # counts as two more rows of scales.
    memory.require_memory(
        (900.0 * segments**2 + 25_000.0) * (scale_rows + 2) * ventrals,
        f"a snake of {scale_rows} × {ventrals} scales of {segments} segments",
        f"take {{share}} of {ref('scale_rows')} or {ref('ventrals')}, or {{side}} of {ref('segments')}",
    )
    # Snakes shorter than 16 radii are refused. In a longer snake, the cross sections of the head and of the body are
    # both present, which the single spline through them requires.
    if not 16.0 * radius <= length <= _LONGEST * radius:
        raise ArgumentValueError(
            f"{ref('length')} must be 16 to {_LONGEST:g} radii ({16.0 * radius:g} to {_LONGEST * radius:g}), "
            f"got {length:g}"
        )

    skin = _Skin(radius, length, math.radians(bend_deg), waves, scale_rows + 1, ventrals)
    patch = _joined([*_scales(skin, segments), *_scutes(skin, segments), _head(skin, segments), _tip(skin, segments)])
    vertices = skin.points(patch)
    vertices[:, 1] -= vertices[:, 1].min()
    # Faces without area occur at the ends of free edges. They are removed.
    edges = vertices[np.roll(patch.faces, -1, axis=1)] - vertices[patch.faces]
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    patch = patch._replace(faces=patch.faces[twice_area > 1e-6 * np.max(np.sum(edges**2, axis=2), axis=1)])
    around = skin.turn(patch.u)
    along = (patch.v + _HEAD_SCALES) / (_HEAD_SCALES + ventrals + _TIP_SCALES)
    uvs = np.stack([around, along] if tangent == "around" else [along, 1.0 - around], axis=1)
    colours = _pigment(skin, np.random.default_rng(seed))
    # The rows of the texture are reversed, because the first row of an image is at the texture coordinate v = 1.
    colours = colours[::-1] if tangent == "around" else colours.transpose(1, 0, 2)
    return _mesh(vertices, patch.faces, _normals(vertices, patch, skin), uvs, colours)


def check_meander(radius: float, length: float, bend_deg: float, waves: float, tangent: str) -> None:
    """Raise an error if an argument that ``tube`` and ``snake`` share is out of its range."""
    validation.positive(radius, "radius")
    validation.positive(length, "length")
    validation.number(bend_deg, "bend_deg", least=0.0, most=120.0)
    validation.number(waves, "waves", least=0.0)
    validation.choice(tangent, "tangent", get_args(Tangent))


class _Skin:
    """Shape of the snake: a map from positions on the unrolled skin to positions in space.

    Attributes:
        radius: Half of the largest width of the body [mesh units].
        breadth: Width of the back [rows], which is the largest x of the back.
        belly: Half of the width of the belly [rows].
        count: Number of scales from the neck to the end of the tail, which is τ at the end of the tail.
    """

    def __init__(self, radius: float, length: float, bend: float, waves: float, breadth: int, count: int) -> None:
        self.radius, self.breadth, self.count = radius, breadth, count
        self.belly = breadth * _BELLY / (1.0 - 2.0 * _BELLY)
        head, last = _HEAD_LENGTH * radius, length - _TIP * radius
        self._length = length
        self._stations = np.concatenate([_HEAD[:, 0] * head, head + _BODY[:, 0] * (length - head)])
        self._outline = np.concatenate([_HEAD[:, 1:], _BODY[:, 1:]]) * [radius, radius, radius, 1.0]
        self._s = s = np.linspace(0.0, length, 4097)
        width = self.outline(s)[:, 0]

        # The centre line is straight in the head and bends behind it. The height of the centre line is such that the
        # whole belly touches the ground.
        frequency = 2.0 * math.pi * waves / (length - head)
        if bend * frequency * radius > 0.8:
            raise ArgumentValueError(
                f"{ref('bend_deg')} and {ref('waves')} must leave the bends wider than the body, got a bend of radius "
                f"{1.0 / (bend * frequency):g} for a body of radius {radius:g}; reduce one of them"
            )
        heading = bend * np.cos(frequency * np.maximum(s - head, 0.0))
        y = _hermite(s, self._stations, self._outline)[:, 2]
        slope = np.gradient(y, s)
        level = np.sqrt(1.0 - slope**2)
        x, z = _integral(s, level * np.cos(heading)), _integral(s, level * np.sin(heading))
        x, z = (places - (places.min() + places.max()) / 2.0 for places in (x, z))
        self._centre = np.stack([x, y, z], axis=1)
        self._forward = np.stack([level * np.cos(heading), slope, level * np.sin(heading)], axis=1)
        self._side = np.stack([np.sin(heading), np.zeros_like(s), -np.cos(heading)], axis=1)
        part = slice(None, None, 16)
        gap = np.hypot(x[part, None] - x[part], z[part, None] - z[part]) - 1.05 * (width[part, None] + width[part])
        if np.any((gap < 0.0) & (np.abs(s[part, None] - s[part]) > 4.0 * radius)):
            raise ArgumentValueError(
                f"{ref('bend_deg')} must leave the bends apart, got {math.degrees(bend):g}; reduce it, or "
                f"{ref('radius')}"
            )

        # The length of a scale is proportional to the local width of the body. At the thin end of the tail, the length
        # is constant.
        density = np.where((s < head) | (s > last), 0.0, 1.0 / np.maximum(width, 0.25 * radius))
        tau = _integral(s, density)
        tau *= count / tau[-1]
        tau = np.where(s < head, (s / head - 1.0) * _HEAD_SCALES, tau)
        self._tau = np.where(s > last, count + (s - last) / (length - last) * _TIP_SCALES, tau)
        self._scale = np.gradient(s, self._tau)

    def outline(self, s: Floats) -> Floats:
        """Return half width, height, depth and exponent of the cross sections at the arc lengths ``s``, shape (k, 4).

        Width, height and depth are 0 at both ends of the snake.
        """
        outline = _hermite(s, self._stations, self._outline)
        snout = np.clip(1.0 - s / (_SNOUT * self.radius), 0.0, 1.0)
        tip = np.clip((s - self._length) / (_TIP * self.radius) + 1.0, 0.0, 1.0)
        outline[:, :3] *= np.sqrt((1.0 - snout**2) * (1.0 - tip**2))[:, None]
        return outline

    def turn(self, x: Floats) -> Floats:
        """Return the position ``x`` as a fraction of the circumference, starting at the middle of the belly."""
        return (x + self.belly) / (self.breadth + 2.0 * self.belly)

    def points(self, patch: _Patch) -> Floats:
        """Return the positions in space of the vertices of a part of the skin, shape (k, 3)."""
        s = np.interp(patch.tau + patch.shift, self._tau, self._s)
        # The displacement `rise` moves a vertex away from the centre line of the body. This direction is nearly that of
        # the surface normal.
        width, height, depth, power = self.outline(s).T
        # The modulus maps both sides of the seam of the texture to the same angle, so that their vertices have exactly
        # the same position.
        phi = 2.0 * math.pi * (self.turn(patch.x) % 1.0) - math.pi / 2.0
        c, d = np.cos(phi), np.sin(phi)
        square = (np.abs(c) ** power + np.abs(d) ** power) ** (-1.0 / power)
        c, d = c * square * width, d * square * np.where(d > 0.0, height, depth)
        rise = patch.rise * np.interp(s, self._s, self._scale)
        factor = 1.0 + rise / np.maximum(np.hypot(c, d), 1e-9 * self.radius)

        def at(values: Floats) -> Floats:
            return np.stack([np.interp(s, self._s, values[:, k]) for k in range(3)], axis=1)

        side, forward = at(self._side), at(self._forward)
        across = (c * factor)[:, None] * side + (d * factor)[:, None] * np.cross(forward, side)
        return np.asarray(at(self._centre) + across)


def _integral(s: Floats, values: Floats) -> Floats:
    """Return the cumulative integral of ``values`` over ``s`` by the trapezoidal rule, starting at 0."""
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2.0 * np.diff(s))])


def _hermite(s: Floats, stations: Floats, values: Floats) -> Floats:
    """Interpolate the rows of ``values`` from the positions ``stations`` to ``s`` by cubic Hermite polynomials.

    The slope at a station is computed from the rows of the stations before and after it.
    """
    slopes = np.gradient(values, stations, axis=0)
    i = np.clip(np.searchsorted(stations, s) - 1, 0, len(stations) - 2)
    step = (stations[i + 1] - stations[i])[:, None]
    t = (s - stations[i])[:, None] / step
    return np.asarray(
        (1.0 + 2.0 * t) * (1.0 - t) ** 2 * values[i]
        + t * (1.0 - t) ** 2 * step * slopes[i]
        + t * t * (3.0 - 2.0 * t) * values[i + 1]
        + t * t * (t - 1.0) * step * slopes[i + 1]
    )


def _smoothstep(t: Floats) -> Floats:
    """Return a smooth step from 0 to 1 for t from 0 to 1, with zero slope at both ends."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _fade(skin: _Skin, tau: Floats) -> Floats:
    """Return the factor by which the relief of scales is multiplied at ``tau``: 0 at the neck and the tail's end."""
    return _smoothstep(tau / _FADE) * _smoothstep((skin.count - tau) / _FADE)


def _plate(skin: _Skin, x: ArrayLike, tau: ArrayLike, a: Floats, b: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the positions x and τ, the shift and the rise of points on scales.

    The shift (to the rear) and the rise (outwards) increase linearly from the front corner to the rear corner of a
    scale. The step from a free edge to the scale below therefore has the same height along the edge, and neighbouring
    scales meet at their corners.

    Args:
        skin: Map from the unrolled skin to space.
        x: Centres of the scales across the back [rows].
        tau: Centres of the scales along the body [scales].
        a: First coordinate of the points on a scale, 0 to 1, broadcast with the centres.
        b: Second coordinate of the points on a scale, 0 to 1, broadcast with the centres.
    """
    rear = (a + b) / 2.0
    x, tau = np.asarray(x) + a - b, np.asarray(tau) - 0.5 + rear
    fade = _fade(skin, tau)
    bow_a, bow_b = np.sin(math.pi * a), np.sin(math.pi * b)
    dome = 16.0 * a * (1.0 - a) * b * (1.0 - b)
    return (
        x + fade * _BOW_SIDEWAYS * (bow_b - bow_a), tau + fade * _BOW * (bow_a + bow_b), fade * _OVERHANG * rear,
        fade * (_STAND_OFF * rear + _DOME * dome),
    )  # fmt: skip


def _patches(
    corners: tuple[Floats, ...], texture: tuple[Floats, Floats], faces: NDArray[np.int64], *, wall: bool = False
) -> _Patch:
    """Join m parts of the mesh (patches) of k vertices each, all with the same ``faces``, to one patch."""
    m, k = np.broadcast_shapes(*(corner.shape for corner in corners))
    x, tau, shift, rise, u, v = (np.broadcast_to(array, (m, k)).ravel() for array in (*corners, *texture))
    return _Patch(
        x, tau, shift, rise, u, v, np.full(m * k, wall), (k * np.arange(m)[:, None, None] + faces).reshape(-1, 3)
    )


def _joined(patches: list[_Patch]) -> _Patch:
    """Join several parts of the mesh (patches) to one patch with all vertices and faces."""
    start = np.cumsum([0, *(len(patch.x) for patch in patches)])
    shifted = [patch._replace(faces=patch.faces + at) for patch, at in zip(patches, start[:-1], strict=True)]
    return _Patch._make(np.concatenate(parts) for parts in zip(*shifted, strict=True))


def grid_faces(columns: int, rows: int, *, rising: bool = False) -> NDArray[np.int64]:
    """Return two triangles per quadrilateral of a grid of vertices.

    The normals of the triangles are along c × r; c and r are the directions of increasing column and row index.

    With ``rising``, the diagonal connects the corner of least row and column to the opposite one.
    """
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (row * columns + column).ravel()
    b, c, d = a + 1, a + columns, a + columns + 1
    two = [[a, b, d], [a, d, c]] if rising else [[a, b, c], [b, d, c]]
    return np.stack([np.stack(one, axis=1) for one in two], axis=1).reshape(-1, 3)


def _scales(skin: _Skin, n: int) -> list[_Patch]:
    """Return the rhombic scales with their free edges, cut at the neck, at the end of the tail and at the belly."""
    step = np.arange(n + 1) / n
    b, a = (grid.ravel() for grid in np.meshgrid(step, step, indexing="ij"))
    odd, even = np.arange(1, skin.breadth, 2), np.arange(2, skin.breadth, 2)
    middles = np.arange(skin.count) + 0.5
    # Each entry describes one kind of scale: row numbers; positions along the rows; mask of the points (a, b) of the
    # scale that remain after a cut; whether its two rear edges are free; and direction of the faces' diagonals, which
    # are parallel to the cut.
    kinds: list[tuple[ArrayLike, ArrayLike, NDArray[np.bool_], tuple[bool, bool], bool]] = [
        (odd, np.arange(1, skin.count), a < 2.0, (True, True), False), (even, middles, a < 2.0, (True, True), False),
        (odd, 0, a + b > 1.0 - 1e-9, (True, True), False), (odd, skin.count, a + b < 1.0 + 1e-9, (False, False), False),
        (0, middles, a > b - 1e-9, (True, False), True), (skin.breadth, middles, a < b + 1e-9, (False, True), True),
    ]  # fmt: skip
    patches = []
    for rows, along, is_inside, free, rising in kinds:
        x, tau = (grid.reshape(-1, 1) for grid in np.meshgrid(rows, along))
        corners = _plate(skin, x, tau, a, b)
        faces = grid_faces(n + 1, n + 1, rising=rising)
        patches.append(_patches(corners, corners[:2], faces[np.all(is_inside[faces], axis=1)]))
        # A wall connects a free edge to the front edge of the scale below. In the texture, the wall continues the
        # colours of the upper scale.
        ones, zeros = np.ones(n + 1), np.zeros(n + 1)
        if free[0]:
            top, low = _plate(skin, x, tau, ones, step), _plate(skin, x + 1, tau + 0.5, zeros, step)
            patches.append(_wall(top, low, _RISER, grid_faces(n + 1, 2)[:, ::-1]))
        if free[1]:
            top, low = _plate(skin, x, tau, step, ones), _plate(skin, x - 1, tau + 0.5, step, zeros)
            patches.append(_wall(top, low, -_RISER, grid_faces(n + 1, 2)))
    return patches


def _wall(top: tuple[Floats, ...], low: tuple[Floats, ...], u: float, faces: NDArray[np.int64]) -> _Patch:
    """Return the walls between free edges (``top``) and the edges below (``low``).

    In the texture, a wall extends ``u`` rows of scales across the body, and |u|/2 scales along the body.
    """
    corners = tuple(np.concatenate(pair, axis=1) for pair in zip(top, low, strict=True))
    texture = (np.concatenate([top[0], top[0] + u], axis=1), np.concatenate([top[1], top[1] + abs(u) / 2.0], axis=1))
    return _patches(corners, texture, faces, wall=True)


def _belly_columns(skin: _Skin, n: int) -> list[Floats]:
    """Return the positions x of the vertices across the two halves of the belly, on both sides of the seam."""
    part = np.arange(n + 1) / n * skin.belly
    return [part - skin.belly, skin.breadth + part]


def _scutes(skin: _Skin, n: int) -> list[_Patch]:
    """Return the ventral scutes (the broad scales of the belly), which overlap like the other scales."""
    patches = []
    step = np.arange(n + 1) / n
    tau0 = np.arange(skin.count)[:, None] + 0.5
    for columns in _belly_columns(skin, n):
        t, x = (grid.ravel() for grid in np.meshgrid(step, columns, indexing="ij"))
        _, *rest = _plate(skin, 0.0, tau0, t, t)
        patches.append(_patches((x[None], *rest), (x[None], rest[0]), grid_faces(n + 1, n + 1)))
        ones, zeros = np.ones(n + 1), np.zeros(n + 1)
        top, low = _plate(skin, 0.0, tau0[:-1], ones, ones), _plate(skin, 0.0, tau0[1:], zeros, zeros)
        # The wall of a scute consists of two strips of faces, because a corner of the neighbouring scale lies at half
        # the height of the wall.
        three = [np.concatenate([high, (high + deep) / 2.0, deep], axis=1) for high, deep in zip(top, low, strict=True)]
        x, v = np.tile(columns, 3)[None], three[1] + np.repeat([0.0, 1.0, 2.0], n + 1) * _RISER
        patches.append(_patches((x, *three[1:]), (x, v), grid_faces(n + 1, 3), wall=True))
    return patches


def _ring(skin: _Skin, n: int) -> Floats:
    """Return the positions x of the vertices on a ring (cross section of the body), as at the neck."""
    left, right = _belly_columns(skin, n)
    back = np.arange(skin.breadth * n // 2 + 1) * (2.0 / n)
    return np.concatenate([left[:-1], back, right[1:]])


def _cap(x: Floats, tau: Floats, rise: Floats, *, first: bool) -> _Patch:
    """Return a part of the mesh that closes the skin at a tip: rings of vertices, of which one has zero radius.

    Args:
        x: Positions of the vertices around the body, shape (n,).
        tau: Positions of the rings along the body, shape (m,).
        rise: Displacement of the vertices outwards, shape (m, n).
        first: Whether the first ring has zero radius, otherwise the last.
    """
    rows, columns = len(tau), len(x)
    u, v = np.tile(x, rows), np.repeat(tau, columns)
    faces = grid_faces(columns, rows, rising=not first)
    at = 0 if first else (rows - 1) * columns
    # At a tip, each triangle has a vertex of its own. The texture coordinate u of this vertex is that of the middle of
    # the triangle.
    u[at : at + columns - 1] = (x[1:] + x[:-1]) / 2.0
    return _Patch(np.tile(x, rows), v, np.zeros_like(v), rise.ravel(), u, v, np.zeros(len(v), np.bool_), faces)


def _head(skin: _Skin, n: int) -> _Patch:
    """Return the patch of the head, whose rings have twice as many vertices as the ring at which the scales begin."""
    coarse = _ring(skin, n)
    x = np.sort(np.concatenate([coarse, (coarse[1:] + coarse[:-1]) / 2.0]))
    q = np.linspace(0.0, 1.0, 14 * n + 1)
    f = np.where(q < 0.5, 0.75 * q * (q + 0.5), 0.0) + np.where(q < 0.5, 0.0, 0.375 + 1.25 * (q - 0.5))
    border, eye, mouth = _head_marks(f[:, None], skin.turn(x) - 0.5)
    rise = -0.015 * np.exp(-((border / 0.04) ** 2)) * (eye > 1.2) - 0.012 * np.exp(-((mouth / 0.06) ** 2))
    rise += 0.07 * np.clip(1.0 - eye**2, 0.0, None)
    rise *= (_smoothstep(f / 0.06) * _smoothstep((1.0 - f) / 0.1))[:, None]
    patch = _cap(x, (f - 1.0) * _HEAD_SCALES, rise * (_HEAD_SCALES / _HEAD_LENGTH), first=True)
    # The last strip of faces joins the last fine ring of the head to the ring at which the scales begin, which has only
    # every second vertex.
    columns = len(x)
    last = (len(f) - 2) * columns + np.arange(0, columns - 1, 2)
    c = last + columns
    fan = [[last, last + 1, c], [last + 1, c + 2, c], [last + 1, last + 2, c + 2]]
    inner = patch.faces[np.all(patch.faces < last[0] + columns, axis=1)]
    faces = np.concatenate([inner, *(np.stack(corners, axis=1) for corners in fan)])
    return patch._replace(faces=faces)


def _head_marks(f: Floats, across: Floats) -> tuple[Floats, Floats, Floats]:
    """Return distances from borders of shields [body radii], from the eye [eye radii] and the mouth [body radii].

    Args:
        f: Position from the snout to the neck, 0 to 1.
        across: Fraction of the circumference from the middle of the back, −0.5 to 0.5.
    """
    f, across = np.broadcast_arrays(f, np.abs(across))
    nearest = np.full(f.shape, np.inf)
    second = nearest.copy()
    # Shields on the midline of the head have no mirror image. All others are mirrored to the other side.
    for seed in (*_SHIELDS, *(_SHIELDS * [1.0, -1.0])[_SHIELDS[:, 1] > 0.0]):
        away = np.hypot((f - seed[0]) * _HEAD_SPREAD[0], (across - seed[1]) * _HEAD_SPREAD[1])
        np.minimum(second, np.maximum(nearest, away), out=second)
        np.minimum(nearest, away, out=nearest)
    eye = np.hypot((f - _EYE[0]) * _HEAD_SPREAD[0], (across - _EYE[1]) * _HEAD_SPREAD[1]) / _EYE_RADIUS
    mouth = np.where(f < 0.85, np.abs(across - _MOUTH) * _HEAD_SPREAD[1], 1.0)
    return (second - nearest) / 2.0, eye, mouth


def _tip(skin: _Skin, n: int) -> _Patch:
    """Return the patch of the tail's end, a smooth cone without scales."""
    x = _ring(skin, n)
    q = np.linspace(0.0, 1.0, n + 1)
    tau = skin.count + (1.0 - (1.0 - q) ** 2) * _TIP_SCALES
    return _cap(x, tau, np.zeros((len(tau), len(x))), first=False)


def _normals(vertices: Floats, patch: _Patch, skin: _Skin) -> Floats:
    """Return area-weighted normals of vertices; doubled vertices at the seam, neck and tail get the same normal."""
    corners = vertices[patch.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    index = patch.faces.ravel()
    total = np.stack([np.bincount(index, np.repeat(normal[:, k], 3), len(vertices)) for k in range(3)], axis=1)
    ends = np.isin(patch.x, (-skin.belly, skin.breadth + skin.belly)) | np.isin(patch.tau, (0.0, skin.count))
    joined = np.flatnonzero(ends)
    place = np.column_stack([np.round(vertices[joined] / (1e-7 * skin.radius)), patch.wall[joined]])
    _, group = np.unique(place, axis=0, return_inverse=True)
    for k in range(3):
        total[joined, k] = np.bincount(group.ravel(), total[joined, k])[group.ravel()]
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))


def _pigment(skin: _Skin, rng: np.random.Generator) -> Floats:
    """Return the texture of the skin in sRGB, shape (h, w, 3). Rows go from snout to tail, columns around the body."""
    height = round(_TEXELS * (_HEAD_SCALES + skin.count + _TIP_SCALES))
    width = round(_TEXELS * (skin.breadth + 2.0 * skin.belly))
    around = (np.arange(width) + 0.5) / width
    tau = (np.arange(height) + 0.5) / _TEXELS - _HEAD_SCALES
    body = tau > 0.0
    x = around * (skin.breadth + 2.0 * skin.belly) - skin.belly
    head = _head_pigment((1.0 + tau[~body, None] / _HEAD_SCALES), around - 0.5)
    return np.asarray(np.clip(np.concatenate([head, _body_pigment(skin, x, tau[body, None], rng)]), 0.0, 1.0))


def _mix(colour: Floats, other: tuple[float, float, float], share: Floats) -> Floats:
    """Return a mixture of two sRGB colours; ``share`` is the fraction of the second colour."""
    return colour + share[..., None] * (np.array(other) - colour)


def _body_pigment(skin: _Skin, x: Floats, tau: Floats, rng: np.random.Generator) -> Floats:
    """Return colours of scales at (x, tau) in sRGB: saddles on the back, blotches on the flanks, a checkered belly."""
    x, tau = np.broadcast_arrays(x, tau)
    belly = (x < 0.0) | (x > skin.breadth)
    # The edges of scales are curved. A fixed-point iteration inverts this curvature: it gives the scale to which a
    # texel belongs, and the position (a, b) of the texel on this scale.
    fade = _fade(skin, tau)
    x0, tau0 = x, tau
    for _ in range(4):
        bow_a, bow_b = np.abs(np.sin(math.pi * (tau0 + x0 / 2.0))), np.abs(np.sin(math.pi * (tau0 - x0 / 2.0)))
        x0, tau0 = x - fade * _BOW_SIDEWAYS * (bow_b - bow_a), tau - fade * _BOW * (bow_a + bow_b)
    x0 = np.clip(x0, 0.0, skin.breadth)
    a, b = tau0 + x0 / 2.0, tau0 - x0 / 2.0
    cell_a, cell_b = np.floor(a).astype(np.int64), np.floor(b).astype(np.int64)
    a, b = a - cell_a, b - cell_b
    # The pattern is evaluated between the texel and the centre of its scale, nearer to the centre (65 %). The colour of
    # a scale is then nearly constant, and the outline of the pattern follows the edges of scales.
    share = 0.65
    across = np.abs((1.0 - share) * x0 + share * (cell_a - cell_b) - skin.breadth / 2.0) * (28.0 / skin.breadth)
    along = (1.0 - share) * tau0 + share * (cell_a + cell_b + 1.0) / 2.0

    blotches = max(2, round(skin.count / 6.2))
    # The offset of 0.4 periods of the pattern places the first blotch on the neck.
    phase = along / skin.count * blotches + 0.4
    period = skin.count / blotches

    def blotch(
        at: Floats, offset: float, middle: float, half_length: float, half_width: float, spread: float
    ) -> Floats:
        """Return each texel's distance from the centre of the nearest blotch; the edge of the blotch is at 1."""
        index = np.floor(at - offset).astype(np.int64)
        jitter = rng.normal(0.0, spread, (3, blotches + 2))[:, index + 1]
        back = (at - offset - index - 0.5) * period - jitter[0]
        long = half_length * (1.0 + 0.4 * jitter[1]) * (1.0 + 0.25 * ((across - middle) / half_width) ** 2)
        wide = half_width * (1.0 + 0.2 * jitter[2])
        return np.asarray(np.cbrt(np.abs(back / long) ** 3 + np.abs((across - middle) / wide) ** 3))

    marks = [
        blotch(phase, 0.0, 0.0, 1.75, 5.6, 0.25),
        blotch(phase, 0.5, 8.9, 1.3, 2.2, 0.3),
        blotch(phase, 0.0, 12.2, 1.0, 1.5, 0.3),
    ]
    level = np.min(marks, axis=0)
    tone = rng.normal(0.0, 1.0, (skin.count + skin.breadth, 2 * skin.breadth + skin.count))
    tone = np.clip(tone, -2.0, 2.0)[cell_a % len(tone), cell_b % tone.shape[1]]
    flank = _smoothstep((across - 5.0) / 9.0)
    colour = _mix(np.broadcast_to(_GROUND, (*x.shape, 3)), _FLANK, flank)
    colour = colour * (1.0 + 0.07 * tone[..., None])
    colour = _mix(colour, _BLACK, _smoothstep((1.16 - level) / 0.08))
    red = np.array(_SADDLE) * (1.0 + 0.10 * tone[..., None])
    inside = _smoothstep((0.90 - level) / 0.10)
    colour = colour + inside[..., None] * (red - colour)
    # The front of a scale is darkened, as if it were in the shadow of the overlapping scales. The skin between scales
    # is dark.
    edge = np.minimum(np.minimum(1.0 - a, 1.0 - b), np.minimum(a, b))
    colour = colour * (0.72 + 0.28 * _smoothstep((a + b) / 0.9) * _smoothstep(edge / 0.10 + 0.35))[..., None]
    # The scutes of the belly are cream with random black squares.
    scute = np.floor(tau).astype(np.int64)
    column = np.floor((x % (skin.breadth + 2.0 * skin.belly)) / 3.0).astype(np.int64)
    black = rng.random((skin.count + 2, 64))[scute // 2 + column % 2, column % 64] < 0.5
    cream = _mix(np.broadcast_to(_CREAM, (*x.shape, 3)), _BLACK, 0.95 * black)
    cream = cream * (0.75 + 0.25 * _smoothstep((tau % 1.0) / 0.2))[..., None]
    return np.where(belly[..., None], cream, colour)


def _head_pigment(f: Floats, across: Floats) -> Floats:
    """Return colours of the head in sRGB: a spearhead between the eyes, a bar before them, and stripes to the jaw."""
    border, eye, mouth = _head_marks(f, across)
    f, across = np.broadcast_arrays(f, np.abs(across))

    # The variable `red` is the signed distance from the nearest edge of a red mark, negative inside of the mark. The
    # marks are two prongs from the neck that meet between the eyes, a bar before the eyes, a stripe behind each eye,
    # and the neck.
    prong = 0.095 * np.clip((f - 0.36) / 0.40, 0.0, 1.0) ** 0.8
    stripe = _EYE[1] + 0.14 * (f - _EYE[0])
    red = np.minimum.reduce(
        [
            np.where(f > 0.38, np.abs(across - prong), 1.0) - 0.030,
            np.where(across < 0.17, 0.6 * np.abs(f - 0.31 - 0.5 * across), 1.0) - 0.028,
            np.where(f > _EYE[0], np.abs(across - stripe), 1.0) - 0.024,
            np.maximum(0.6 * (0.95 - f), across - 0.16),
        ]
    )
    lips = _smoothstep((across - 0.19) / 0.03)
    colour = _mix(np.broadcast_to(_GROUND, (*f.shape, 3)), _CREAM, lips)
    colour = _mix(colour, _BLACK, _smoothstep((0.016 - red) / 0.010))
    colour = _mix(colour, _SADDLE, _smoothstep(-red / 0.010))
    colour = colour * (0.55 + 0.45 * _smoothstep((border - 0.008) / 0.03))[..., None]
    colour = colour * (1.0 - 0.85 * np.exp(-((mouth / 0.025) ** 2)))[..., None]
    nostril = np.hypot((f - 0.07) * _HEAD_SPREAD[0], (across - 0.13) * _HEAD_SPREAD[1])
    colour = _mix(colour, _BLACK, _smoothstep((0.07 - nostril) / 0.03) + _smoothstep((1.15 - eye) / 0.1))
    colour = _mix(colour, _IRIS, _smoothstep((0.95 - eye) / 0.1))
    return _mix(colour, _BLACK, _smoothstep((0.62 - eye) / 0.1))


def _mesh(vertices: Floats, faces: NDArray[np.int64], normals: Floats, uvs: Floats, colours: Floats) -> trimesh.Trimesh:
    """Return a textured mesh without unused vertices. Vertices with equal positions, as at the seam, are not merged."""
    import PIL.Image
    import trimesh

    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    image = PIL.Image.fromarray(np.round(255.0 * colours).astype(np.uint8))
    material = trimesh.visual.material.SimpleMaterial(image=image)
    return trimesh.Trimesh(
        vertices=vertices[used], faces=(np.cumsum(used) - 1)[faces], vertex_normals=normals[used],
        visual=trimesh.visual.TextureVisuals(uv=uvs[used], material=material), process=False,
    )  # fmt: skip
