"""Pictures for tests: cameras with several pixels for each pixel of another camera, and the white-furnace test.

The white-furnace test renders a mirror sphere under a uniform sky. If energy is conserved, the sphere is as bright as
the sky.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import trimesh

import warpdiff as wd


def scaled(fov_deg: float, factor: float) -> float:
    """Return the vertical field of view [degrees] of a picture with ``factor`` times as many rows of equal pixels."""
    return 2.0 * math.degrees(math.atan(math.tan(math.radians(fov_deg) / 2.0) * factor))


def finer(view: wd.View, points: int, margin: int) -> wd.View:
    """Return a view with ``points``² pixels for each pixel of another view and of a margin around that view."""
    width, height = view.width + 2 * margin, view.height + 2 * margin
    fov = scaled(view.fov_y_deg, height / view.height)
    return dataclasses.replace(view, fov_y_deg=fov, width=points * width, height=points * height)


def furnace_picture(
    heightfield: wd.HeightField, energy: str, *, tolerance: float, size: int
) -> tuple[wd.Image, np.ndarray]:
    """Render a perfect mirror sphere under a uniform sky of radiance 1.

    Return the picture and the distance of each pixel from the centre of the sphere [radii of the sphere].
    """
    ball = trimesh.creation.icosphere(4)
    radius = 1.01 * np.hypot(*np.meshgrid(*2 * [(2.0 * np.arange(size) + 1.0) / size - 1.0]))
    image = wd.shade(
        ball, heightfield, wd.Environment(np.ones((4, 8, 3))),
        wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.02, width=size, height=size),
        coherence=wd.Coherence(sigma_um=8.0),
        tolerance=tolerance, ior=math.inf, masking=False, energy=energy, shadows=False,
        tangents=np.cross([0.0, 1.0, 0.01], ball.vertex_normals),
    )  # fmt: skip
    return image, radius
