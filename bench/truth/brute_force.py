"""Intersections of rays with triangles, and shading frames, in NumPy and float64; shares no code with the library."""

from __future__ import annotations

import numpy as np


def pixel_rays(eye, target, up, *, width, height, fov_y_deg=None, extent_y=None, offsets=(0.0, 0.0)):
    """Return origins and unit directions of the camera rays of a picture, both of shape (height * width, 3).

    The camera looks along its negative z-axis.
    """
    eye, target, up = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    z = (eye - target) / np.linalg.norm(eye - target)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    to_world = np.stack([x, np.cross(z, x), z], axis=1)
    rows, columns = np.divmod(np.arange(width * height), width)
    unit = 2.0 * np.tan(np.deg2rad(fov_y_deg) / 2.0) / height if extent_y is None else extent_y / height
    film_x = (columns + 0.5 + offsets[0] - width / 2.0) * unit
    film_y = (height / 2.0 - rows - 0.5 - offsets[1]) * unit
    if extent_y is None:
        directions = np.stack([film_x, film_y, -np.ones_like(film_x)], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(eye, directions.shape), directions @ to_world.T
    film = np.stack([film_x, film_y, np.zeros_like(film_x)], axis=1)
    return eye + film @ to_world.T, np.broadcast_to(-z, film.shape)


def intersect(origins, directions, vertices, faces, chunk=256):
    """Find the nearest hits of rays by the Möller-Trumbore test of all pairs of rays and triangles.

    Return the distance t along the ray (inf for a miss), face index (−1 for a miss), barycentric coordinates (k, 3),
    and the margin to the nearest edge. The margin is the least |barycentric coordinate| over the hit face and over
    faces in front of it that the ray misses. A small margin means that rounding may change the hit.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    n = len(origins)
    t_best, face_best = np.full(n, np.inf), np.full(n, -1)
    bary = np.zeros((n, 3))
    margin = np.full(n, np.inf)
    for begin in range(0, n, chunk):
        rays = slice(begin, begin + chunk)
        o, d = origins[rays, None, :], directions[rays, None, :]
        p = np.cross(d, e2)
        det = np.einsum("rfk,fk->rf", p, e1)
        det = np.where(det == 0.0, 1e-300, det)
        s = o - a
        q = np.cross(s, e1)
        with np.errstate(over="ignore", invalid="ignore"):
            v = np.einsum("rfk,rfk->rf", s, p) / det
            w = np.einsum("rfk,rfk->rf", np.broadcast_to(d, q.shape), q) / det
            t = np.einsum("rfk,fk->rf", q, e2) / det
        u = 1.0 - v - w
        least = np.minimum(np.minimum(u, v), w)
        t_hit = np.where((least >= 0.0) & (t > 0.0), t, np.inf)
        index = np.argmin(t_hit, axis=1)
        row = np.arange(len(index))
        is_hit = np.isfinite(t_hit[row, index])
        t_best[rays] = t_hit[row, index]
        face_best[rays] = np.where(is_hit, index, -1)
        bary[rays] = np.where(is_hit[:, None], np.stack([u, v, w], axis=2)[row, index], 0.0)
        relevant = (t > 0.0) & (t <= t_hit[row, index][:, None] * (1.0 + 1e-9)) & np.isfinite(least)
        margin[rays] = np.min(np.where(relevant, np.abs(least), np.inf), axis=1)
    return t_best, face_best, bary, margin


def shading_frame(face, bary, directions, vertices, faces, *, normals, tangents, handedness, smooth=True):
    """Return the shading frames where rays hit triangles: tangent t, bitangent b, normal n, each of shape (k, 3)."""
    corners = faces[face]
    p0, p1, p2 = (vertices[corners[:, k]] for k in range(3))
    geometric = np.cross(p1 - p0, p2 - p0)
    geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
    away = -directions
    rotated = np.where(np.sum(geometric * away, axis=1) < 0.0, -1.0, 1.0)[:, None]
    n = np.einsum("kc,kcd->kd", bary, normals[corners]) if smooth else geometric
    n = rotated * n / np.linalg.norm(n, axis=1, keepdims=True)
    cosine = np.sum(n * away, axis=1, keepdims=True)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 1e-30))
    # A normal that is perpendicular to the view direction or points away from it is rotated towards the view direction,
    # until the cosine of the angle between both is 0.01.
    tilted = 0.01 * away + np.sqrt(1.0 - 1e-4) * (n - cosine * away) / sine
    n = np.where(cosine < 0.01, tilted, n)
    t = np.einsum("kc,kcd->kd", bary, tangents[corners])
    t -= np.sum(t * n, axis=1, keepdims=True) * n
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    return t, np.cross(n, t) * handedness[corners[:, 0]][:, None], n
