"""Comparison of the library with its BSDF in Mitsuba 3, under skies and disc lights: processor time at equal errors.

``python -m bench.reproduce.mitsuba_skies`` renders scenes of ``lit_scenes`` with the library and with Mitsuba. Sums
over directions (``bench/truth/sky_sums.py``) are the reference for both pictures. Each row has the errors of the
library's picture relative to the tolerance, and the processor time of this picture. Errors and times of Mitsuba follow,
for several numbers of paths (Monte Carlo samples) per pixel. The next columns are the ratio of Mitsuba's time to the
library's time, at equal 90th and at equal 99th percentiles (P90, P99) of the errors; Mitsuba's time is interpolated
between numbers of paths. The last column is the sum of Y over Mitsuba's picture, divided by the same sum of the
reference. Times exclude the preparation. The library prepares numerical settings (plans) and tables of colours.
Mitsuba's preparation is compilation and the baked spectrum: the surface's colours, sampled into an array.

The script requires ``pip install 'warpdiff[mitsuba]'`` and LLVM 17 or newer, which ``DRJIT_LIBLLVM_PATH`` names.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.reproduce.lights import distances
from bench.reproduce.lit_scenes import SCENES, SKIES, TOWARDS, reference
from bench.truth.sky_sums import SkySums
from warpdiff.optics import colorimetry, reflectance_factors

CASES = ["whole_sun", "whole_nosun", "whole_room", "close_sun", "close_room", "coils_sun", "tube_room", "whole_10"]
COHERENCE = wd.Coherence(sigma_um=16.25)
WAVELENGTHS_NM = np.arange(380.0, 781.0)
# Reflectance at normal incidence for an index of refraction of 1.5. Mitsuba's pictures include this reflectance, while
# pictures of the library are relative to it.
NORMAL_REFLECTANCE = 0.04
# Number of texels along each axis of the baked spectrum, an array of the surface's colours for Mitsuba. The value is
# limited by memory; with fewer texels, the colours are more blurred.
SPECTRUM_SIZE = 1024
# Largest number of light paths per pixel in one call of Mitsuba. The value is limited by memory.
PATHS_OF_LAUNCH = 16


def main() -> int:
    """Print a table with the errors and times of the library and of Mitsuba for all cases."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--cases", nargs="+", default=CASES, metavar="SCENE_LIGHT", help="cases to render (default: all)"
    )
    parser.add_argument(
        "--tolerance", type=float, default=1e-1, help="tolerance of the library's pictures (default: 0.1)"
    )
    parser.add_argument("--pixels", type=int, default=48, help="number of evaluated pixels (default: 48)")
    parser.add_argument(
        "--across", type=int, default=192, help="rays of the reference along each axis of a pixel (default: 192)"
    )
    parser.add_argument("--paths", type=int, nargs="+", default=[4, 16, 64, 256], help="numbers of paths per pixel")
    parser.add_argument("--variant", default="llvm_ad_spectral", help="variant of Mitsuba (default: llvm_ad_spectral)")
    options = parser.parse_args()
    import mitsuba as mi

    mi.set_variant(options.variant)
    wd.register_mitsuba_bsdf()
    scan = inputs.levelled_scan()
    if scan is None:
        print("error: the scan is missing in the folder that WARPDIFF_DATA names")
        return 1
    print("| case | P50 / P90 / P99 | s | Mitsuba: paths, errors, s | time at equal P90 | at equal P99 | sum of Y |")
    print(7 * "| --- " + "|")
    with tempfile.TemporaryDirectory() as folder:
        spectrum = Path(folder) / "spectrum.npz"
        wd.bake_spectrum(scan, coherence=COHERENCE, size=SPECTRUM_SIZE).save(spectrum)
        for case in options.cases:
            compare(case, mi, scan, spectrum, options)
    return 0


def compare(case: str, mi: Any, scan: wd.HeightField, spectrum: Path, options: argparse.Namespace) -> None:
    """Render a case such as "tube_scan_sun" with the library and with Mitsuba; print a row with errors and times."""
    scene, name = case.split("_")
    make, view = SCENES[scene]
    body = make()
    sky = SKIES[name]() if name in SKIES else None
    disc = wd.DirectionalLight(TOWARDS, angular_diameter_deg=2.0 if sky is not None else float(name))
    light = wd.Environment(sky) if sky is not None else disc
    renderer = wd.Renderer(body, scan, light, view, coherence=COHERENCE, tolerance=options.tolerance, pigment=0.0)
    renderer.draw()
    seconds = measured(renderer.draw)
    image = renderer.image()
    sums = SkySums(body, scan, view, COHERENCE)
    places, exact, converged = reference(
        sums, sky if sky is not None else disc, options.pixels, options.across, options.tolerance
    )
    at = tuple(places[converged].T)
    bright = float(np.percentile(image.xyz[image.illuminated][:, 1], 99.0))

    def percentiles(xyz: np.ndarray) -> np.ndarray:
        errors = distances(xyz[at], exact[converged], bright) / options.tolerance
        return np.percentile(errors, [50.0, 90.0, 99.0])

    library = percentiles(image.xyz)
    emitter = sky_emitter(mi, sky) if sky is not None else disc_emitter(mi, disc)
    traced = mi.load_dict(
        {
            "type": "scene", "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sensor": sensor(mi, view), "body": mesh(mi, body, spectrum), "light": emitter,
        }
    )  # fmt: skip
    mi.render(traced, spp=1, seed=99)
    rows, total, paths, spent = [], np.zeros((view.height, view.width, 3)), 0, 0.0
    for goal in sorted(options.paths):
        while paths < goal:
            count = min(PATHS_OF_LAUNCH, goal - paths)
            begin = time.process_time()
            total += count * np.array(mi.render(traced, spp=count, seed=paths + 1))[..., :3].astype(np.float64)
            spent += time.process_time() - begin
            paths += count
        scale = 1.0 / (NORMAL_REFLECTANCE * paths) if sky is not None else 1.0 / paths
        rows.append((paths, percentiles(scale * total), spent))
    text = "; ".join(f"{paths}: {' / '.join(f'{p:.2f}' for p in errors)}, {spent:.1f}" for paths, errors, spent in rows)
    times = [equal_error_time(rows, k, library[k]) / seconds for k in (1, 2)]
    print(
        f"| {case} | {' / '.join(f'{p:.2f}' for p in library)} | {seconds:.1f} | {text} | {times[0]:.2f} | "
        f"{times[1]:.2f} | {(scale * total)[at][:, 1].sum() / exact[converged][:, 1].sum():.3f} |", flush=True,
    )  # fmt: skip


def measured(draw: Any) -> float:
    """Draw a picture three times. Return the median of the processor times of the drawings [s]."""
    times = []
    for _ in range(3):
        begin = time.process_time()
        draw()
        times.append(time.process_time() - begin)
    return float(np.median(times))


def equal_error_time(rows: list[tuple[int, np.ndarray, float]], k: int, error: float) -> float:
    """Return the time in which Mitsuba reaches an error, by linear interpolation of the logarithms of time and error.

    Each of ``rows`` has a number of light paths per pixel, percentiles of the errors with this number, and the time.
    ``k`` selects the percentile. The time is infinite if Mitsuba does not reach the error with any number of paths.
    """
    errors, times = (np.log([row[1][k] for row in rows]), np.log([row[2] for row in rows]))
    reached = np.flatnonzero(errors <= np.log(error))
    if not len(reached):
        return float("inf")
    j = max(int(reached[0]), 1)
    slope = (times[j] - times[j - 1]) / min(errors[j] - errors[j - 1], -1e-6)
    return float(np.exp(times[j] + slope * (np.log(error) - errors[j])))


def sensor(mi: Any, view: wd.View) -> dict[str, Any]:
    """Return Mitsuba's camera for a view."""
    return {
        "type": "perspective", "fov": view.fov_y_deg, "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at(list(view.eye), list(view.target), list(view.up)),
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm", "width": view.width, "height": view.height, "pixel_format": "xyz",
            "component_format": "float32", "rfilter": {"type": "gaussian", "stddev": 0.5},
        },
    }  # fmt: skip


def mesh(mi: Any, body: Any, spectrum: Path) -> Any:
    """Return Mitsuba's mesh of a body, with the normals and texture coordinates of the body."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "warpdiff", "filename": str(spectrum)})
    result = mi.Mesh(
        "body", len(body.vertices), len(body.faces), properties, has_vertex_normals=True, has_vertex_texcoords=True
    )
    parameters = mi.traverse(result)
    for name, values in (
        ("vertex_positions", body.vertices), ("vertex_normals", body.vertex_normals),
        ("vertex_texcoords", body.visual.uv),
    ):  # fmt: skip
        parameters[name] = np.asarray(values, dtype=np.float32).ravel()
    parameters["faces"] = np.asarray(body.faces, dtype=np.uint32).ravel()
    parameters.update()
    return result


def sky_emitter(mi: Any, sky: np.ndarray) -> dict[str, Any]:
    """Return Mitsuba's environment emitter for a sky.

    The environment map is rotated by half a turn, because Mitsuba's orientation differs from the library's.
    """
    rgb = np.broadcast_to(sky, (*sky.shape[:2], 3)).astype(np.float32)
    return {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(np.roll(rgb, rgb.shape[0], axis=1)))}


def disc_emitter(mi: Any, light: wd.DirectionalLight) -> dict[str, Any]:
    """Return a distant disc emitter whose irradiance equals that of the library's disc light under D65."""
    half = np.radians(light.angular_diameter_deg / 2.0)
    towards = np.asarray(light.to_light) / np.linalg.norm(light.to_light)
    distance = 200.0
    to_world = mi.ScalarTransform4f().look_at(list(distance * towards), [0, 0, 0], [0, 1, 0.1])
    products = colorimetry.colour_products("D65")
    observer = np.array([np.array(mi.cie1931_xyz(float(nm))).ravel() for nm in WAVELENGTHS_NM])
    power = products.sum(axis=1) / observer.sum(axis=1) / mi.MI_CIE_Y_NORMALIZATION
    solid_angle = reflectance_factors.light_solid_angle(1e-3 * WAVELENGTHS_NM, COHERENCE, 1.0)
    radiance = power * solid_angle / NORMAL_REFLECTANCE / (np.pi * np.sin(half) ** 2)
    values = {
        "type": "irregular", "wavelengths": ", ".join(f"{nm:g}" for nm in [379.0, *WAVELENGTHS_NM, 781.0]),
        "values": ", ".join(f"{value:.9g}" for value in [0.0, *radiance, 0.0]),
    }  # fmt: skip
    scale = distance * np.tan(half)
    return {
        "type": "disk", "to_world": to_world @ mi.ScalarTransform4f().scale([scale, scale, 1.0]),
        "emitter": {"type": "area", "radiance": values},
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
