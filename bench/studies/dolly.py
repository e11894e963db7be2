"""Flicker: how much more pixels change from frame to frame than they should, as the camera moves towards a body.

Frames are crops, see ``crops``, each nearer than the last by a hundredth, drawn by one renderer, as sequences are: by
plans of their own they would flicker more. Pixels show display values at the exposure that brings the white of the
whole picture to 1. What they change by differs from what the truth's change by; percentile 99 of that is to be a fifth
at most of percentile 99 of the truth's own changes.

Points on a grid flicker themselves where edges of shadows pass: a truth of fewer points is judged in the same way over
the first frames, which bounds what the truth's own share of a ratio can be.
"""

from __future__ import annotations

import argparse
import dataclasses
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.studies import crops
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

SURFACE = "fingers 25.6 µm"
FRAMES, NEARER = 60, 0.5
# Of which a truth's points keep a part, see ``crops``.
TOLERANCE = 3e-2
# Along a side of a pixel, and of the truth that is judged over so many frames. By 48 points flicker is as much as 0.9
# of the truth's own changes, by 64 0.35, by 96 0.2.
POINTS, FEWER, FRAMES_OF_FEWER = 144, 96, 5
BAR = 0.2
# Of the white of the whole picture, what a crop is around: what is black does not flicker.
LEAST = 0.05
# Of a strip: every so many frames, and how large a pixel is.
APART, ENLARGED = 10, 6


def frames(first: crops.Crop, count: int) -> list[crops.Crop]:
    """A crop and those that are nearer, one after the other."""
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
    parser.add_argument("--crops", type=int, default=3, help="of each body (3)")
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"how many ({FRAMES})")
    parser.add_argument("--seed", type=int, default=0, help="of where crops lie (0)")
    parser.add_argument("--strips", type=Path, help="folder for strips: the truth above, pictures of each tolerance")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    known, hf = crops.bodies(options.data, []), crops.surfaces(options.data)[SURFACE]()
    print(
        "| body | tolerance | P99 of the truth's changes | P99 of the difference | ratio, at most 0.2 "
        "| of a truth of fewer points |\n" + "| --- " * 6 + "|"
    )
    for body in options.bodies:
        rng, mesh = np.random.default_rng([options.seed, zlib.crc32(body.encode())]), known[body]()
        for number in range(options.crops):
            first = crops.crop(body, mesh, hf, 1.0, rng, LEAST)
            moving = frames(first, options.frames)
            exact = [crops.filtered(each, TOLERANCE, POINTS).xyz for each in moving]
            true = np.array([shown(each, 1.0 / first.white) for each in exact])
            changes = np.linalg.norm(np.diff(true, axis=0), axis=-1)
            most, strip = np.percentile(changes, 99.0), [true[::APART]]
            few = [crops.filtered(each, TOLERANCE, FEWER).xyz for each in moving[:FRAMES_OF_FEWER]]
            own = _flicker(np.array([shown(each, 1.0 / first.white) for each in few]), true[:FRAMES_OF_FEWER])
            for tolerance in options.tolerances:
                drawn = np.array([shown(each, 1.0 / first.white) for each in pictures(moving, tolerance)])
                strip.append(drawn[::APART])
                beside = _flicker(drawn, true)
                name = f"{body}, {number + 1}"
                print(
                    f"| {name} | {tolerance:g} | {most:.3f} | {beside:.3f} | {beside / most:.2f} | {own / most:.2f} |",
                    flush=True,
                )
            if options.strips:
                _save(strip, options.strips / f"dolly-{body}-{number + 1}.png")


def pictures(moving: list[crops.Crop], tolerance: float) -> Iterator[NDArray[np.float64]]:
    """The colours of frames as a sequence renders them, by one plan, of what is covered."""
    first = moving[0]
    renderer = wd.Renderer(first.mesh, first.hf, first.light, first.view, tolerance=tolerance, pigment=0.0)
    for each in moving:
        renderer.draw(view=each.view)
        image = renderer.image()
        yield np.asarray(image.xyz / np.maximum(image.coverage, 1e-6)[..., None])


def _flicker(drawn: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    """Percentile 99 of what display values change by otherwise than the truth's, from frame to frame."""
    return float(np.percentile(np.linalg.norm(np.diff(drawn - true, axis=0), axis=-1), 99.0))


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
