"""Energy: Stam's order efficiencies and normalised ones against rigorous solutions, and what surfaces send back.

``--table`` takes the gratings of ``bench/suite/rigorous.json``: the largest error of an order, median and 90th
percentile, by cells of period and depth, for Stam's efficiencies, for these over their sum, and for what the library
normalises, a(ωi) K a(ωr). ``--held-out`` solves others, drawn by a seed: periods, depths and angles between these,
conical mounts among them, by boundary integrals (gratinglab). ``--albedo`` adds up what surfaces send back.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.suite import validity

PERIOD_EDGES, DEPTH_EDGES = (1.0, 2.0, 5.0), (0.06, 0.25)
PERIOD_NAMES, DEPTH_NAMES = ("below 1", "1 to 2", "2 to 5", "above 5"), ("below 0.06", "0.06 to 0.25", "above 0.25")
SAMPLES = {"sine": 256, "square": 1024, "sawtooth": 1024}
FORMS = ("Stam", "over the sum", "normalised")
WAVELENGTH_NM = 1000.0

Cells = dict[tuple[int, int], list[list[float]]]


def errors(
    shape: str, index: float | None, grating: tuple[float, float], light: Any, right: dict[int, float], flat: float
) -> list[float]:
    """The largest error of an order by each form, relative to what a flat surface reflects."""
    hf = validity.GRATINGS[shape](*grating, samples=SAMPLES[shape])
    material = None if index is None else wd.Material.dielectric(index)
    options: dict[str, Any] = {"ior": math.inf} if material is None else {"material": material}
    stam, balanced = (
        wd.order_efficiencies(hf, light, WAVELENGTH_NM, energy=energy, **options) for energy in ("stam", "normalised")
    )
    mirror = wd.order_efficiencies(hf, light, WAVELENGTH_NM, ior=math.inf, energy="stam").efficiencies.sum()
    forms = [
        {order: found[0, order][0] / over for order in right}
        for found, over in ((stam, 1.0), (stam, mirror), (balanced, 1.0))
    ]
    return [max(abs(form[order] - right[order]) for order in right) / flat for form in forms]


def cell_of(period: float, depth: float) -> tuple[int, int]:
    """Which cell of the tables a grating is in."""
    return int(np.searchsorted(PERIOD_EDGES, period)), int(np.searchsorted(DEPTH_EDGES, depth))


def rows_of(cells: Cells) -> list[str]:
    """A table's rows, and a mark where the 90th percentile is worse than Stam's."""
    lines = []
    for (period, depth), values in sorted(cells.items()):
        found = np.quantile(np.array(values), (0.5, 0.9), axis=0)
        told = " | ".join(f"{median:.4f} / {most:.4f}" for median, most in found.T)
        worse = " (worse)" if found[1, -1] > found[1, 0] else ""
        lines.append(f"| {PERIOD_NAMES[period]} | {DEPTH_NAMES[depth]} | {len(values)} | {told}{worse} |")
    return lines


HEAD = [f"| period / λ | depth / λ | gratings | {' | '.join(FORMS)} |", "| --- " * 6 + "|"]


def table() -> None:
    """The stored gratings."""
    stored = json.loads(validity.STORED.read_text())
    for case, (shape, index) in validity.CASES.items():
        rows, cells = iter(stored["cases"][case]["first_order_and_efficiencies"]), Cells()
        for period in stored["periods"]:
            for depth in stored["depths"]:
                for angle in stored["angles_deg"]:
                    first, *efficiencies = next(rows)
                    right = {first + k: each * validity.UNIT for k, each in enumerate(efficiencies)}
                    theta = math.radians(angle)
                    light = (math.sin(theta), 0.0, math.cos(theta))
                    flat = validity.flat_reflectance(index, angle)[0]
                    found = errors(shape, index, (period, depth), light, right, flat)
                    cells.setdefault(cell_of(period, depth), []).append(found)
        print("\n".join(["", f"**{case}**", "", *HEAD, *rows_of(cells)]), flush=True)


def held_out(count: int, seed: int) -> None:
    """Gratings that nothing was chosen by, a third of them in conical mounts."""
    from gratinglab import Illumination, problem

    solve = validity.Integral()
    rng = np.random.default_rng(seed)
    for shape in validity.GRATINGS:
        cells: Cells = {}
        missed = []
        for number in range(count):
            period = float(np.exp(rng.uniform(math.log(0.7), math.log(14.0))))
            depth = float(np.exp(rng.uniform(math.log(0.025), math.log(0.25))))
            theta, phi = math.radians(rng.uniform(0.0, 72.0)), 0.0
            if number % 3 == 0:
                phi = rng.uniform(0.05, math.pi - 0.05)
            light = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
            illumination = Illumination.conical(
                theta=math.degrees(theta), phi=math.degrees(phi), polarization="unpolarized"
            )
            scan = solve._solver.solve(
                problem.Problem(period=500.0 * period, profile=_profile(solve, shape, depth / period)),
                illumination, [500.0], boundary_points=math.ceil(max(224.0, 24.0 * (period + 2.0 * depth))),
                corner_grading=4, conductivity="perfect",
            )  # fmt: skip
            efficiencies = np.asarray(scan.efficiency[0])
            missed.append(abs(float(efficiencies.sum()) - 1.0))
            # The library's light comes from +x, and so does a solver's with its angle.
            right = {int(m): float(each) for m, each in zip(scan.orders, efficiencies, strict=True) if each > 0.0}
            if not math.isfinite(missed[-1]) or missed[-1] > 1e-3:
                continue
            cells.setdefault(cell_of(period, depth), []).append(errors(shape, None, (period, depth), light, right, 1.0))
        title = f"**{shape}, seed {seed}**, energy missed by the solver: P90 {np.quantile(missed, 0.9):.0e}"
        print("\n".join(["", title, "", *HEAD, *rows_of(cells)]), flush=True)


def _profile(solve: validity.Integral, shape: str, fraction: float) -> Any:
    profiles = solve._profiles
    return {
        "sine": lambda: profiles.Sinusoidal(depth_fraction=fraction),
        "square": lambda: profiles.Lamellar(depth_fraction=fraction),
        "sawtooth": lambda: profiles.Blazed(blaze_angle=math.degrees(math.atan(fraction))),
    }[shape]()


def albedo(data: str | None) -> None:
    """Σ of all orders of perfect mirrors, which is ∫ BRDF cos θ dω over R, before and after."""
    surfaces = {
        "fingers, 12.8 µm": wd.gratings.fingers(size_um=12.8, pitch_um=0.08),
        "compact disc, 12.8 µm": wd.gratings.disc("CD", tracks=8, length_um=12.8, pitch_um=0.08),
    }
    scan = inputs.scan(data)
    if scan is not None:
        surfaces["scan, a crop of 20 µm"] = scan.cropped(20.0)
    print("| surface | λ [nm] | incidence | Stam | normalised |\n| --- | --- | --- | --- | --- |")
    for name, hf in surfaces.items():
        for wavelength in (450.0, 650.0):
            for angle in (0.0, 45.0, 75.0):
                theta = math.radians(angle)
                light = (math.sin(theta), 0.0, math.cos(theta))
                told = [
                    wd.order_efficiencies(hf, light, wavelength, ior=math.inf, energy=energy).efficiencies.sum()
                    for energy in ("stam", "normalised")
                ]
                print(f"| {name} | {wavelength:g} | {angle:g}° | {told[0]:.4f} | {told[1]:.4f} |", flush=True)


def main() -> int:
    """Print the tables that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--table", action="store_true", help="the stored gratings")
    parser.add_argument("--held-out", action="store_true", help="other gratings, solved anew")
    parser.add_argument("--albedo", action="store_true", help="what surfaces send back of all light")
    parser.add_argument("--count", type=int, default=90, help="held-out gratings of a profile (90)")
    parser.add_argument("--seed", type=int, default=0, help="what they are drawn by (0)")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    asked = options.table or options.held_out or options.albedo
    if options.albedo or not asked:
        albedo(options.data)
    if options.held_out or not asked:
        held_out(options.count, options.seed)
    if options.table or not asked:
        table()
    return 0


if __name__ == "__main__":
    sys.exit(main())
