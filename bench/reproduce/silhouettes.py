"""Coverage of pixels at silhouettes, against 64 × 64 samples per pixel of an independent rasterizer.

``python -m bench.reproduce.silhouettes [--seed N]`` prints rows for each body: errors of the coverage of pictures at
pixels that the body covers in part. The reference projects the triangles with NumPy, fills them with Pillow, and
weights the samples by the pixel filter: a Gaussian with a standard deviation of 0.5 pixel that ends at 1.5 pixels.
"""

from __future__ import annotations

import argparse
import warnings
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from PIL import Image, ImageDraw

import warpdiff as wd

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Number of samples of the reference along each side of a pixel.
SAMPLES = 64
# Width and height of the pictures [pixels]. Larger pictures make the reference slow: Pillow fills a mask of about 240
# million samples for this size.
SIZE = (320, 180)
# Least and largest coverage with which a pixel counts as being at a silhouette.
LEAST, MOST = 0.02, 0.98


def coverage_of(mesh: trimesh.Trimesh, view: wd.View) -> NDArray[np.float64]:
    """Return the coverage of each pixel: the share of the pixel filter that a mesh covers, shape (height, width)."""
    frame = view.frame()
    away = np.asarray(mesh.vertices) - frame.origin
    depth = -(away @ frame.back)
    x, y = away @ frame.right / depth / frame.half_width, away @ frame.up / depth / frame.half_height
    # The mask marks the samples that the mesh covers. It extends one pixel beyond the picture on each side, because the
    # filter of a pixel at the border does, too.
    places = np.column_stack([(x + 1.0) / 2.0 * view.width + 1.0, (1.0 - y) / 2.0 * view.height + 1.0])
    mask = Image.new("1", ((view.width + 2) * SAMPLES, (view.height + 2) * SAMPLES))
    draw = ImageDraw.Draw(mask)
    for corners in (places * SAMPLES - 0.5)[np.asarray(mesh.faces)].tolist():
        draw.polygon([tuple(corner) for corner in corners], fill=1)
    offsets = (np.arange(3 * SAMPLES) + 0.5) / SAMPLES - 1.5
    weights = np.exp(-0.5 * (offsets / 0.5) ** 2)
    along = np.asarray(mask, dtype=np.float32)
    for length in (view.height, view.width):
        windows = np.lib.stride_tricks.sliding_window_view(along, 3 * SAMPLES, axis=0)[::SAMPLES][:length]
        along = np.ascontiguousarray((windows @ (weights / weights.sum()).astype(np.float32)).T)
    return along.astype(np.float64)


def bodies() -> dict[str, trimesh.Trimesh]:
    """Return the meshes whose silhouettes are rendered, by name of the body."""
    return {
        "ball": trimesh.creation.icosphere(subdivisions=6), "snake": wd.meshes.snake(), "tube": wd.meshes.tube(),
        "disc": wd.meshes.disc(), "box": trimesh.creation.box((1.0, 0.7, 0.4)),
        "torus": trimesh.creation.torus(1.0, 0.35, major_sections=192, minor_sections=96),
        "wire of 1 pixel": trimesh.creation.torus(1.0, 0.006, major_sections=192, minor_sections=12),
    }  # fmt: skip


def main() -> None:
    """Print the errors of the coverage at silhouettes, in rows for each body."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="seed of the camera directions")
    rng = np.random.default_rng(parser.parse_args().seed)
    warnings.simplefilter("ignore")
    Image.MAX_IMAGE_PIXELS = None
    skin, light = wd.gratings.fingers(size_um=32.0, pitch_um=0.08), wd.DirectionalLight((0.3, 1.0, 0.8))
    for name, mesh in bodies().items():
        direction = tuple(rng.normal(size=3).tolist())
        view = wd.View.fit(mesh, direction, width=SIZE[0], height=SIZE[1])
        expected = coverage_of(mesh, view)
        rim = (expected > LEAST) & (expected < MOST)
        for label, options in (
            ("default", {}),
            ("tolerance 0.1", {"tolerance": 0.1}),
            ("no refine", {"refine": False}),
        ):
            image = wd.shade(mesh, skin, light, view, tangents="x", **options)
            errors = np.abs(image.coverage.astype(np.float64) - expected)[rim]
            print(
                f"{name:16s} {label:14s} {rim.sum():5d} pixels, error of the coverage: median {np.median(errors):.3f}, "
                f"P95 {np.percentile(errors, 95.0):.3f}, largest {errors.max():.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
