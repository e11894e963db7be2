"""Previews: pictures of each scene by warpdiff and by every peer (other program) at its most accurate setting."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench.suite import figures, pareto
from bench.suite.scenes import scenes
from bench.truth import errors
from warpdiff.device.devices import resolve_device
from warpdiff.optics.colorimetry import srgb_encode, xyz_to_rgb

if TYPE_CHECKING:
    from pathlib import Path

    from bench.suite.runner import Setting

# Width of a preview [pixels].
WIDTH = 320
# Luminance to which the exposure of previews maps the 99th percentile of Y. The value was chosen; larger values clip
# more pixels to white.
EXPOSURE = 5.0


def measure(setting: Setting) -> dict[str, Any]:
    """Return sRGB pictures (height, width, 3) of all scenes, and the errors of these pictures.

    Errors are relative to the picture by warpdiff with a tolerance of 1e-3.
    """
    results = {}
    for scene in scenes(setting.data):
        coherence = scene.coherences[0]
        if coherence.kind != "averaged" or (setting.quick and scene.name != "fingers"):
            continue
        setting.say(f"previews: {scene.title}")
        directions, illuminated = scene.directions(coherence, WIDTH)
        finest = wd.plan(
            scene.heightfield, coherence=coherence, tolerance=1e-3, device=setting.device, threads=setting.threads
        )
        shades = {"warpdiff, 1e-3": pareto.ours(scene.heightfield, finest, directions, resolve_device(setting.device))}
        for name, (peer, settings) in pareto.peers(coherence, setting).items():
            shades[pareto.style(name)[2]] = pareto.best(peer, settings, scene.heightfield, coherence)
        pictures, reference_xyz = {}, None
        for name, shade in shades.items():
            xyz = np.float64(shade(directions.scattering_vectors, directions.gains, setting.threads))
            reference_xyz = xyz if reference_xyz is None else reference_xyz
            error = errors.relative(xyz, reference_xyz)
            # Stam's chapter does not define the brightness of its rainbow. The exposure of the rainbow is therefore
            # relative to its own luminance, and the exposure of the other pictures is relative to warpdiff's luminance.
            by, exposure = (xyz, 1.0) if "rainbow" in name else (reference_xyz, EXPOSURE)
            image = np.zeros((3 * WIDTH // 4 * WIDTH, 3))
            image[illuminated] = srgb_encode(exposure / np.percentile(by[:, 1], 99.0) * xyz_to_rgb(xyz))
            pictures[name] = {
                "srgb": np.uint8(np.round(255.0 * np.clip(image, 0.0, 1.0))).reshape(-1, WIDTH, 3),
                "median": float(np.median(error)),
                "p99": float(np.percentile(error, 99.0)),
            }
        results[scene.name] = {"scene": scene.title, "coherence": str(coherence), "pictures": pictures}
    return results


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return errors of the peers (other programs), relative to warpdiff, by name.

    The values are the median and the 99th percentile (P99) over the pixels of a scene. Each value is stored as a list
    [value, value, value, unit], because other charts have lists [median, minimum, maximum, unit].
    """
    return {
        f"previews/{name}/{by}/{quantity}": [picture[quantity]] * 3 + ["error against ours"]
        for name, scene in results.items()
        for by, picture in scene["pictures"].items()
        if not by.startswith("warpdiff")
        for quantity in ("median", "p99")
    }


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw the pictures of all scenes on one sheet. Return the chart's name and a sentence about differences."""
    plt = figures.pyplot()
    columns = max(len(scene["pictures"]) for scene in results.values())
    figure, axes = plt.subplots(
        len(results), columns, figsize=(3.1 * columns, 2.75 * len(results)), squeeze=False, layout="constrained"
    )
    for row, scene in zip(axes, results.values(), strict=True):
        for axis in row:
            axis.set_axis_off()
        for axis, (name, picture) in zip(row, scene["pictures"].items(), strict=False):
            axis.imshow(picture["srgb"])
            caption = scene["scene"]
            if not name.startswith("warpdiff"):
                caption = f"error {picture['median']:.0e} (median), {picture['p99']:.0e} (P99)"
            axis.set_title(f"{name}\n{caption}", fontsize=8.5, fontweight="normal")
    figures.save(figure, folder, "previews")
    lines = []
    for scene in results.values():
        stam = scene["pictures"].get(pareto.STYLES["Stam, CIE"][2])
        if stam:
            lines.append(f"{stam['median']:.2g} ({scene['scene']})")
    text = "The published algorithm at its best setting looks the same as warpdiff."
    if lines:
        medians = ", ".join(lines)
        text += f" The analytic shader with CIE colours, which models tracks only, has a median error of {medians}."
    return {"previews": text}
