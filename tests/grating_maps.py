"""Cards with a grating map, and the same cards without a map, with one mesh part per dot, as a reference.

A grating map is an array of dots. Each dot turns the same height field, the cell, and scales its depth and pitch. A
card is a flat rectangle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import trimesh

import warpdiff as wd

if TYPE_CHECKING:
    from numpy.typing import NDArray

WIDTH, HEIGHT = 1.0, 0.75
VIEW = wd.View((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov_y_deg=12.0, width=24, height=18)
LIGHT = wd.DirectionalLight((0.0, 0.5, 1.0))


def card(
    *, uvs: bool = True, left: float = 0.0, right: float = 1.0, top: float = 1.0, bottom: float = 0.0
) -> trimesh.Trimesh:
    """Return a part of a flat card, with sides as shares of the whole card and texture coordinates from 0 to 1."""
    x = WIDTH * (np.array([left, right, right, left]) - 0.5)
    y = HEIGHT * (np.array([bottom, bottom, top, top]) - 0.5)
    visual = trimesh.visual.TextureVisuals(uv=np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    return trimesh.Trimesh(
        np.column_stack([x, y, np.zeros(4)]), [[0, 1, 2], [0, 2, 3]], vertex_normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        visual=visual if uvs else None, process=False,
    )  # fmt: skip


def parts_of(
    grating_map: wd.GratingMap, coherence: wd.Coherence
) -> tuple[trimesh.Scene, dict[str, wd.Surface], NDArray[np.float64]]:
    """Return the reference of a grating map: a scene of one part per dot, heights by part, and tangents by vertex.

    The height field of a part has the scaled depth and pitch of the dot. Its tangents are turned.
    """
    rows, columns = grating_map.shape
    scene, surfaces, tangents = trimesh.Scene(), {}, []
    for row in range(rows):
        for column in range(columns):
            dot, name = grating_map.dot(row, column), f"dot {row} {column}"
            rectangle = card(
                left=column / columns, right=(column + 1) / columns, top=1.0 - row / rows, bottom=1.0 - (row + 1) / rows
            )
            scene.add_geometry(rectangle, geom_name=name, node_name=name)
            cell = grating_map.cell
            dy, dx = cell.pitch_um
            field = wd.HeightField.of_known_scale(
                dot.depth_scale * cell.heights_um, (dot.pitch_scale * dy, dot.pitch_scale * dx)
            )
            surfaces[name] = wd.Surface(field, coherence=coherence)
            turn = np.radians(dot.turn_deg)
            tangents += 4 * [[np.cos(turn), np.sin(turn), 0.0]]
    return scene, surfaces, np.array(tangents)


def error_of(image: wd.Image, reference: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return relative errors of the XYZ of illuminated pixels, compared with a reference picture.

    They are relative to the norm of the reference's XYZ, or to 0.001 of the 99th percentile of Y if that is larger.
    """
    lit = image.illuminated & (image.coverage > 0.999)
    xyz, exact = image.xyz[lit].astype(np.float64), reference[lit].astype(np.float64)
    floor = 1e-3 * np.percentile(exact[:, 1], 99.0)
    return np.linalg.norm(xyz - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor)
