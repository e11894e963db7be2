"""Flicker: how much more pixels change from frame to frame than they should, as the camera moves towards a body.

Frames are crops, see ``crops``, each nearer than the last by a hundredth, and each with a plan of its own. Pixels show
display values at one exposure. What they change by differs from what the truth's change by; percentile 99 of that is to
be a fifth at most of percentile 99 of the truth's own changes.
"""

from __future__ import annotations

import argparse
import dataclasses
import zlib
from pathlib import Path

import numpy as np

import warpdiff as wd
from warpdiff.bench import inputs
from warpdiff.bench.studies import crops
from warpdiff.optics import colorimetry

SURFACE = "fingers 25.6 µm"
FRAMES, NEARER = 60, 0.5
# Along a side of a pixel; the truth of pictures by themselves takes twice as many.
POINTS = 48
BAR = 0.2
# Of a strip: every so many frames, and how large a pixel is.
APART, ENLARGED = 10, 6


def frames(body: str, mesh: object, count: int, seed: int) -> list[crops.Crop]:
    """Crops of a body, one after the other."""
    rng = np.random.default_rng([seed, zlib.crc32(body.encode())])
    first = crops.crop(body, mesh, crops.surfaces(None)[SURFACE](), 1.0, rng)
    eye, target = np.array(first.view.eye), np.array(first.view.target)
    nearer = NEARER ** (np.arange(count) / (FRAMES - 1))
    views = (dataclasses.replace(first.view, eye=tuple(target + each * (eye - target))) for each in nearer)
    return [first._replace(view=view) for view in views]


def shown(xyz: np.ndarray, exposure: float) -> np.ndarray:
    """Display values of XYZ."""
    return colorimetry.srgb_encode(exposure * colorimetry.xyz_to_rgb(xyz))


def main() -> None:
    """Print the table, and write strips."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", nargs="+", default=["snake", "low-poly"], help="by name")
    parser.add_argument("--tolerances", nargs="+", type=float, default=[1e-1, 3e-2])
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"how many ({FRAMES})")
    parser.add_argument("--seed", type=int, default=0, help="of where crops lie (0)")
    parser.add_argument("--strips", type=Path, help="folder for strips: the truth above, pictures of each tolerance")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    known = crops.bodies(options.data, [])
    print(
        "| body | tolerance | P99 of the truth's changes | P99 of the difference | ratio, at most 0.2 |\n"
        + "| --- " * 5
        + "|"
    )
    inner = (slice(crops.MARGIN, -crops.MARGIN),) * 2
    for body in options.bodies:
        moving = frames(body, known[body](), options.frames, options.seed)
        exact = [crops.filtered(each, min(options.tolerances), POINTS).xyz for each in moving]
        exposure = 0.5 / max(float(np.mean(exact[0][..., 1])), 1e-30)
        true = np.array([shown(each, exposure) for each in exact])
        strip = [true[::APART]]
        for tolerance in options.tolerances:
            drawn = []
            for each in moving:
                image = wd.shade(each.mesh, each.hf, each.light, each.view, tolerance=tolerance, pigment=0.0)
                covered = np.maximum(image.coverage[inner], 1e-6)[..., None]
                drawn.append(shown(image.xyz[inner] / covered, exposure))
            strip.append(np.array(drawn)[::APART])
            changes = np.linalg.norm(np.diff(true, axis=0), axis=-1)
            apart = np.linalg.norm(np.diff(np.array(drawn) - true, axis=0), axis=-1)
            most, beside = np.percentile(changes, 99.0), np.percentile(apart, 99.0)
            print(f"| {body} | {tolerance:g} | {most:.3f} | {beside:.3f} | {beside / most:.2f} |", flush=True)
        if options.strips:
            _save(strip, options.strips / f"dolly-{body}.png")


def _save(strip: list[np.ndarray], path: Path) -> None:
    """Rows of frames, enlarged."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import image

    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.concatenate([np.concatenate(list(row), axis=1) for row in strip], axis=0)
    image.imsave(path, rows.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1))


if __name__ == "__main__":
    main()
