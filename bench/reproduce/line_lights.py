"""Errors of pictures if a line light is replaced by several lobes or by several point lights.

::

    python -m bench.reproduce.line_lights

The line light is that of ``docs/contributing/add_a_light.md``. A lobe represents the light from a part of the line by a
Gaussian of directions, with a mean direction and a spread. The reference has 256 lobes and a tolerance of 0.03. The
error of a pixel is relative to its colour, or to 2 % of the colour of bright pixels if that is larger. Errors are
printed in units of the tolerance of 0.1. The printed spacing is the angle between neighbouring lobes as viewed from the
nearest point of the body.
"""

from __future__ import annotations

import math
import re
import sys
import types
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import warpdiff as wd

PAGE = Path(__file__).parents[2] / "docs" / "contributing" / "add_a_light.md"
# Tolerance of the compared pictures, and tolerance of the reference picture.
TOLERANCE, OF_REFERENCE = 0.1, 0.03
# Numbers of lobes that are compared, and number of lobes of the reference. A lobe is a Gaussian of directions that
# replaces a part of the line light.
COUNTS, MOST = (4, 8, 16, 32), 256
# Relative errors are divided by the colour of the pixel, or by this share of the 99th percentile of ‖XYZ‖ over
# illuminated pixels if that is larger.
DARK = 0.02


def line_light() -> Any:
    """Return the class ``LineLight`` from the code of the page ``docs/contributing/add_a_light.md``."""
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    module = types.ModuleType("line_light_of_the_page")
    sys.modules[module.__name__] = module
    exec(code, vars(module))  # noqa: S102 (code of this repository)
    return vars(module)["LineLight"]


def cases() -> dict[str, tuple[Any, wd.View, tuple[Any, Any], float]]:
    """Return bodies with a view, the ends of a line light, and the least distance of the line from the body.

    Two bodies are used: a square in the xy plane, and a tube. In the case ``sine``, the square has a sine grating with
    a period of 2 µm as its height field; in the other cases, the height field has nano-fingers (``gratings.fingers``).
    """
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    texture = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    square = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)
    above = wd.View.orthographic((0.5, 0.4, 4.0), (0, 0, 0), extent_y=1.6, width=32, height=20)
    tube = wd.meshes.tube()
    ends = (-0.8, 1.6, 0.6), (0.8, 1.6, 0.6)
    points = np.linspace(*ends, 65)
    nearest = float(np.linalg.norm(np.asarray(tube.vertices)[:, None] - points, axis=2).min())
    return {
        "square": (square, above, ((-0.7, -0.9, 0.9), (0.7, -0.9, 0.9)), 0.9),
        "sine": (square, above, ((-0.7, -0.9, 0.9), (0.7, -0.9, 0.9)), 0.9),
        "tube": (tube, wd.View.fit(tube, width=32, height=20), ends, nearest),
    }


def errors(image: wd.Image, reference: wd.Image) -> np.ndarray:
    """Return the errors of a picture's illuminated pixels, compared with a reference, in units of the tolerance."""
    colours = np.linalg.norm(reference.xyz, axis=2)
    floor = DARK * np.percentile(colours[reference.illuminated], 99.0)
    away = np.linalg.norm(image.xyz - reference.xyz, axis=2) / np.maximum(colours, floor)
    return np.asarray(away[reference.illuminated] / TOLERANCE)


def main() -> int:
    """Print a table with the errors of two approximations of a line light: by lobes, and by point lights."""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    light, skins = line_light(), {"sine": wd.gratings.sinusoidal(2.0, 0.1)}
    print("| case | lobes | spacing | P50 / P90 / P99 | above the tolerance | reported |")
    print(6 * "| --- " + "|")
    for name, (body, view, ends, nearest) in cases().items():
        start, end = np.array(ends)
        skin = skins.get(name, wd.gratings.fingers(size_um=12.8, pitch_um=0.1))
        reference = wd.shade(
            body, skin, light(*ends, lobe_count=MOST), view, tolerance=OF_REFERENCE, pigment=0.0
        )  # fmt: skip
        for count in COUNTS:
            shares = (np.arange(count) + 0.5) / count
            points = [wd.PointLight(tuple(start + share * (end - start)), power=1.0 / count) for share in shares]
            angle = math.degrees(math.atan(float(np.linalg.norm(end - start)) / math.sqrt(count**2 + 2) / nearest))
            for kind, lights in (("lobes", light(*ends, lobe_count=count)), ("points", points)):
                image = wd.shade(body, skin, lights, view, tolerance=TOLERANCE, pigment=0.0)
                away = errors(image, reference)
                parts = " / ".join(f"{value:.2f}" for value in np.percentile(away, (50.0, 90.0, 99.0)))
                print(
                    f"| {name} | {count} {kind} | {angle:.0f}° | {parts} | {np.mean(away > 1.0):.1%} | "
                    f"{image.report.unconverged_share:.1%} |", flush=True,
                )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
