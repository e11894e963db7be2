"""Comparison of two devices: times of frames, and differences between the pictures of both devices.

::

    python -m bench.dev.device_check --device cuda --output check.json
    python -m bench.dev.device_check --device cpu --times 0

Frames have 640 × 480 pixels, and the light and the camera move from frame to frame. The compared pictures cover all
kinds of light and coherence, and both devices use the same plan (numbers of wavelengths and terms). Devices round
differently. Pixels are subdivided where an estimated error is too large, so that the devices may subdivide different
pixels. To show how large such differences may be, the CPU renders each picture twice. The second time, the directions
or positions of the lights are changed by a relative amount of 2e-7, about the rounding error of float32. The colours of
both devices should differ about as much as the two pictures of the CPU.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import warpdiff as wd
from bench import inputs
from bench.reproduce import crops
from bench.suite.frames import SUBJECTS, moved
from bench.suite.runner import write
from bench.truth.errors import relative

WAYS: dict[str, dict[str, Any]] = {
    "1e-1": {"tolerance": 1e-1}, "3e-2": {"tolerance": 3e-2}, "3e-2, unrefined": {"tolerance": 3e-2, "refine": False},
}  # fmt: skip
ABOVE = wd.DirectionalLight((0.1, 0.9, 1.2))
BESIDE = wd.DirectionalLight((-1.0, 0.6, 0.9), power=0.5, illuminant="A")
NEAR = wd.PointLight((1.2, 1.4, 0.4), power=2.0)
# Relative change of a light's direction or position. The value is derived from the rounding error of float32, which is
# about as large.
TURN = 2e-7
# Quantiles of the differences between pictures that the script reports.
QUANTILES = (0.5, 0.99, 0.999)


def frame_times(mesh: Any, surface: wd.HeightField, device: str, frames: int, **options: Any) -> dict[str, float]:
    """Return the time of the first frame, with preparation, and the median and maximum of the other frames [ms]."""
    seconds = []
    begin = time.perf_counter()
    renderer = wd.Renderer(mesh, surface, *moved(mesh, 0), device=device, pigment=0.0, **options)
    for index in range(frames + 1):
        # A GPU works asynchronously. Without this wait, the measured time would end before the frame is complete.
        wp.synchronize_device(renderer.draw(*moved(mesh, index)).device)
        end = time.perf_counter()
        seconds.append(end - begin)
        begin = end
    first, *others = (1e3 * value for value in seconds)
    return {"first_ms": first, "median_ms": float(np.median(others)), "longest_ms": max(others)}


def pictures(data: str | None) -> dict[str, tuple[Any, wd.HeightField, list[Any], dict[str, Any]]]:
    """Return body, height field, lights and options of each compared picture, by the name of the picture."""
    tube, fingers = wd.meshes.tube(), wd.gratings.fingers(size_um=12.8, pitch_um=0.09, seed=5)
    scan = inputs.levelled_scan(data)
    coarse: dict[str, Any] = {"tolerance": 1e-1}
    fine: dict[str, Any] = {"tolerance": 3e-2}
    periods = wd.Coherence("replicas", periods=(1, 10))
    return {
        "snake": (wd.meshes.snake(), fingers if scan is None else scan, [ABOVE], {**fine, "pigment": 0.0}),
        "three lights": (wd.meshes.snake(), fingers, [ABOVE, BESIDE, NEAR], fine),
        "tracks": (wd.meshes.disc(), wd.gratings.disc("CD", tracks=4, length_um=12.8, pitch_um=0.09), [ABOVE], fine),
        "points": (crops.lumpy(3), fingers, [ABOVE], {**fine, "footprint": False, "samples_per_pixel": 4}),
        "disc light": (tube, fingers, [replace(ABOVE, angular_diameter_deg=3.0)], coarse),
        "point light": (tube, fingers, [NEAR], coarse),
        "metal": (tube, fingers, [ABOVE], {**coarse, "material": wd.Material.metal("Au"), "energy": "normalised"}),
        "centred": (tube, fingers, [ABOVE], {**fine, "coherence": wd.Coherence("centred")}),
        "source": (tube, fingers, [ABOVE], {**coarse, "coherence": wd.Coherence("source", angular_diameter_deg=2.0)}),
        "periods": (wd.meshes.disc(), wd.gratings.lamellar(2.5, 0.14), [ABOVE], {**fine, "coherence": periods}),
    }


def turned(light: Any) -> Any:
    """Return the light with its direction or position changed by about the rounding error of float32."""
    name = "position" if isinstance(light, wd.PointLight) else "to_light"
    return replace(light, **{name: tuple(np.array(getattr(light, name)) * (1.0 + TURN * np.array([1.0, -1.0, 0.0])))})


def picture_differences(case: Any, device: str) -> dict[str, Any]:
    """Return quantiles of the relative differences of two pictures from the CPU's picture of the same scene.

    The first picture is that of the other device. The second picture is one that the CPU renders with slightly changed
    lights.
    """
    mesh, surface, lights, options = case
    view = replace(moved(mesh, 2)[1], width=320, height=240)
    on_cpu = wd.shade(mesh, surface, lights, view, device="cpu", **options)
    # A plan does not contain the options `material`, `energy`, `pigment` and `samples_per_pixel`. They are therefore
    # passed in addition to the plan.
    unplanned = {
        name: options[name] for name in ("material", "energy", "samples_per_pixel", "pigment") if name in options
    }
    others = {
        "device": wd.shade(mesh, surface, lights, view, device=device, plan=on_cpu.plan, **unplanned),
        "turned": wd.shade(mesh, surface, [turned(item) for item in lights], view, plan=on_cpu.plan, **unplanned),
    }
    result: dict[str, Any] = {}
    for name, image in others.items():
        both = on_cpu.mask & image.mask
        differences = relative(image.xyz[both].astype(np.float64), on_cpu.xyz[both].astype(np.float64))
        result[name] = [float(value) for value in np.quantile(differences, QUANTILES)]
        result[f"{name}: pixels covered in one picture only"] = int(np.sum(on_cpu.mask != image.mask))
    return result


def main() -> None:
    """Print times of frames and differences of pictures, and write both to a file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--device", default="cuda", help="device to compare with the CPU (default: cuda)")
    parser.add_argument(
        "--times", type=int, default=15, help="timed frames per body; the CPU renders a fifth (default: 15)"
    )
    parser.add_argument("--data", metavar="FOLDER", help=inputs.HELP)
    parser.add_argument("--output", type=Path, metavar="FILE", help="write all numbers to this .json file")
    options = parser.parse_args()
    os.environ["WARPDIFF_CACHE_DIR"] = ""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    results: dict[str, Any] = {}

    def keep(name: str, values: dict[str, Any]) -> None:
        results[name] = values
        print(name, json.dumps(values, default=float), flush=True)
        if options.output is not None:
            write(options.output, json.dumps(results, indent=1) + "\n")

    for name, case in pictures(options.data).items():
        keep(f"picture: {name}", picture_differences(case, options.device))
    bodies, surface = crops.bodies(options.data), wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=5)
    for body in SUBJECTS if options.times else ():
        if body not in bodies:
            print(f"No times of the {body}: its mesh is not in the data folder.")
            continue
        mesh = bodies[body]()
        for way, settings in WAYS.items():
            for device in dict.fromkeys((options.device, "cpu")):
                frames = options.times if device != "cpu" else -(-options.times // 5)
                keep(f"{body}, {way}, {device}", frame_times(mesh, surface, device, frames, **settings))


if __name__ == "__main__":
    main()
