"""Smooth direction fields on a folder of glTF files: angles between neighbouring vertices, and computing time.

A direction field gives each vertex of a mesh a tangent direction, for example of the grooves of a grating. ``python -m
bench.reproduce.smooth_fields FOLDER`` prints a row for each file, and a summary. Test files are in the repository
KhronosGroup/glTF-Sample-Assets. The angle of an edge is the angle between the directions at its two ends. Before the
comparison, the direction at the start is rotated by the smallest rotation that maps the normal there to the normal at
the end.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.scene.mesh_import import Surface, prepare_surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Largest number of faces of a tested file. The value is limited by computing time: larger files need minutes.
MOST_FACES = 60_000


def angles_deg(surface: Surface) -> NDArray[np.float64]:
    """Return, for each edge of a mesh, the angle between the tangent directions at its two ends [degrees].

    The direction at the start is first rotated by the rotation from the normal there to the normal at the end.
    """
    faces = surface.faces
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])), axis=0)
    before, after = (surface.normals[edges[:, end]].astype(np.float64) for end in (0, 1))
    vectors, others = (surface.tangents[edges[:, end]].astype(np.float64) for end in (0, 1))
    axis = np.cross(before, after)
    sine, cosine = np.linalg.norm(axis, axis=1, keepdims=True), np.sum(before * after, axis=1, keepdims=True)
    axis /= np.maximum(sine, 1e-12)
    moved = vectors * cosine + np.cross(axis, vectors) * sine
    moved += axis * np.sum(axis * vectors, axis=1, keepdims=True) * (1.0 - cosine)
    return np.degrees(np.arccos(np.clip(np.sum(moved * others, axis=1), -1.0, 1.0)))


def main() -> None:
    """Print, for each glTF file, the mean angle between neighbouring tangent directions and the computing time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    warnings.simplefilter("ignore")
    worst, rates, count = 0.0, [], 0
    for path in sorted(parser.parse_args().folder.rglob("*.gl[tb]*")):
        try:
            faces = len(prepare_surface(path, tangents=(0.2, 1.0, 0.3)).faces)
            if faces > MOST_FACES:
                continue
            start = time.process_time()
            surface = prepare_surface(path, tangents="smooth")
            seconds = time.process_time() - start
        except (ValueError, FileNotFoundError) as error:
            print(f"{path.stem:32s} refused: {str(error)[:80]}")
            continue
        deviations = (
            np.abs(np.linalg.norm(surface.tangents, axis=1) - 1.0),
            np.abs(np.sum(surface.tangents * surface.normals, axis=1)),
        )
        worst = max(worst, *(float(values.max()) for values in deviations))
        angles = angles_deg(surface)
        count += 1
        rates += [seconds / faces * 1e4] * (faces > 1000)
        print(f"{path.stem:32s} {faces:6d} faces {seconds:6.2f} s, mean angle {angles.mean():5.1f}°", flush=True)
    print(f"{count} files, {np.median(rates):.2f} s per 10,000 faces (median), unit and tangential within {worst:.1e}")


if __name__ == "__main__":
    main()
