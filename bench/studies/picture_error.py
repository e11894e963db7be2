"""Error of ``shade`` against the float64 reference, beside its time: a table of tolerances.

Pictures are of the tube with synthetic fingers and, where the data is present, with the levelled scan. The error is
the design's: ‖ΔXYZ‖ / max(‖XYZ‖, f), f as in ``errors``; no pigment, one
light.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.truth import reference
from warpdiff import meshes
from warpdiff.scene.mesh_import import prepare_surface

LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))


def height_fields(data: Path) -> dict[str, wd.HeightField]:
    """The synthetic fingers, and the scan where it is present."""
    made = {"fingers, 6.4 µm": wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=2)}
    scan = data / "elaphe_65um.png"
    if scan.is_file():
        loaded = wd.HeightField.load(scan, extent_um=65.0, height_range_um=0.375)
        made["scan, 65 µm, levelled"] = loaded.levelled(order=2)
    else:
        print(f"{scan.name} is not in {data}: the synthetic fingers only")
    return made


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=2000, help="stratified random pixels to judge (2000)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument("--width", type=int, default=320, help="width of the picture; 4:3 (320)")
    parser.add_argument("--tolerances", type=float, nargs="+", default=[1e-1, 1e-2, 1e-3], metavar="TOLERANCE")
    parser.add_argument("--kinds", nargs="+", default=["averaged", "centred", "source"], metavar="KIND")
    parser.add_argument("--sigma-um", type=float, default=16.25, help="standard deviation of the window (16.25)")
    options = parser.parse_args()
    data = inputs.folder(options.data)

    mesh = meshes.tube(segments_along=128, segments_around=64)
    body = reference.Body.of(prepare_surface(mesh))
    height = options.width * 3 // 4
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=options.width, height=height)
    print("| height field | form | tolerance | median | P99 | lit below f | P99 there, in f | µs a lit pixel |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, hf in height_fields(data).items():
        for kind in options.kinds:
            coherence = wd.Coherence(kind, options.sigma_um if kind in ("averaged", "centred") else None)
            truth = chosen = None
            for tolerance in options.tolerances:
                image = wd.shade(mesh, hf, LIGHT, view, tolerance=tolerance, coherence=coherence, footprint=False)
                # The second call has its kernels and coefficients at hand; its time includes the rays.
                begin = time.perf_counter()
                wd.shade(mesh, hf, LIGHT, view, tolerance=tolerance, coherence=coherence, footprint=False)
                seconds = time.perf_counter() - begin
                if truth is None:
                    chosen = reference.stratified(image.mask, options.pixels)
                    truth = reference.reference_picture(
                        body, hf, [LIGHT], view, chosen, coherence, tolerance=min(options.tolerances)
                    )
                error = reference.picture_error(image.xyz.reshape(-1, 3)[chosen], truth)
                lit = np.count_nonzero(image.mask) * error.lit / len(chosen)
                share = f"{100.0 * error.share_below:.0f} % of {error.lit}"
                print(
                    f"| {name} | {kind} | {tolerance:g} | {error.median:.1e} | {error.p99:.1e} "
                    f"| {share} | {error.below:.1e} | {1e6 * seconds / lit:.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
