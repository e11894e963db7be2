"""What metals reflect: gratings against rigorous solutions, flat surfaces against Fresnel's equations, time a frame.

``--gratings`` solves sines of aluminium, gold and silver with finite conductivity by boundary integrals (gratinglab),
which their own finer meshes judge, and square grooves by coupled waves (meent) beside them; orders are told by the
equations of Fresnel for the metal, and by Schlick's formula of the same R(0), as the library had it before materials.
``--flat`` renders flat metals; ``--frames`` times frames of gold and of n = 1.5 in turns.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
import sys
import time
from typing import Any

import numpy as np

import warpdiff as wd
from bench.suite import validity
from bench.truth import flat_materials
from warpdiff.optics import colorimetry, reflectance_factors

METALS = ("Al", "Au", "Ag")
PERIODS = {"sine": np.geomspace(1.07, 18.7, 7), "square": np.array([1.07, 1.6, 2.3, 3.4, 4.7])}
DEPTHS = {"sine": (0.04, 0.1, 0.2), "square": (0.04, 0.1)}
ANGLES = (5.0, 35.0, 65.0)
WAVELENGTHS_NM = (450.0, 550.0, 650.0)
# Of the integral's points, whose own change is a hundredth of what is judged; a grating of 18.7 λ takes 7 s with them.
WAVES, POINTS = 100, 0.5
FEW = 7


def by_schlick(hf: wd.HeightField, light: np.ndarray, wavelength: float, material: wd.Material) -> wd.OrderEfficiencies:
    """Efficiencies with Schlick's curve of the metal's own R(0), as they were before there were materials."""
    found = wd.order_efficiencies(hf, light, wavelength, ior=math.inf, energy="stam")
    cosines = np.linalg.norm(light + found.to_view, axis=-1) / 2.0
    normal = float(material.reflectance(wavelength, 0.0))
    found.efficiencies[:] *= np.nan_to_num(reflectance_factors.schlick(np.minimum(cosines, 1.0), normal))
    return found


def gratings(quick: bool) -> list[str]:
    """Tables of errors: sines by boundary integrals, then square grooves by coupled waves."""
    solve = validity.Integral()
    lines = [
        "| metal | solver | gratings | largest error, median / P90, Schlick | Fresnel | normalised | by itself, P90 |",
        "| --- " * 7 + "|",
    ]
    print("\n".join(lines), flush=True)
    for symbol in METALS:
        material = wd.Material.metal(symbol)
        for shape in ("sine", "square"):
            rows, own = [], []
            # Each period and depth at one of the angles, and one of the wavelengths, in turn.
            pairs = [(period, depth) for period in PERIODS[shape] for depth in DEPTHS[shape]]
            cases = [(*pair, ANGLES[(number + number // 3) % 3]) for number, pair in enumerate(pairs)]
            for number, (period, depth, angle) in enumerate(cases[:: FEW if quick else 1]):
                wavelength = WAVELENGTHS_NM[number % len(WAVELENGTHS_NM)]
                right, changed = _solved(
                    solve, shape, material, (period, depth, angle), wavelength, check=number % 4 == 0
                )
                own += changed
                light = np.array([math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))])
                scale = 1e-3 * wavelength
                hf = validity.GRATINGS[shape](period * scale, depth * scale, samples=validity.SAMPLES)
                told_by = [by_schlick(hf, light, wavelength, material)] + [
                    wd.order_efficiencies(hf, light, wavelength, material=material, energy=energy)
                    for energy in ("stam", "normalised")
                ]
                rows.append([max(abs(each[0, order][0] - value) for order, value in right.items()) for each in told_by])
            told = [" / ".join(f"{np.quantile(column, q):.4f}" for q in (0.5, 0.9)) for column in np.array(rows).T]
            name = "boundary integrals, sines" if shape == "sine" else "coupled waves, square grooves"
            lines.append(f"| {symbol} | {name} | {len(rows)} | {' | '.join(told)} | {np.quantile(own, 0.9):.4f} |")
            print(lines[-1], flush=True)
    return lines


def _solved(
    solve: validity.Integral, shape: str, material: wd.Material, grating: tuple[float, float, float], wavelength: float,
    *, check: bool,
) -> tuple[dict[int, float], list[float]]:  # fmt: skip
    """Efficiencies by order, and how much they change on a finer mesh, or with more waves, where that is checked."""
    period, depth, angle = grating
    index = complex(
        np.interp(wavelength, material.wavelengths_nm, material.n),
        np.interp(wavelength, material.wavelengths_nm, material.k),
    )
    if shape == "sine":
        orders, found, _ = solve(shape, period, depth, angle, index, finer=POINTS)
        finer = solve(shape, period, depth, angle, index, finer=1.5 * POINTS)[1] if check else found
    else:
        both = [_waves(grating, index, terms) for terms in ((WAVES, WAVES * 5 // 4) if check else (WAVES,))]
        reach = math.floor(period * (1.0 + math.sin(math.radians(angle))))
        orders = np.array(
            [m for m in range(-reach - 1, reach + 2) if abs(m / period - math.sin(math.radians(angle))) < 1]
        )
        found, finer = (each[len(each) // 2 + orders] for each in (both[0], both[-1]))
    changed = [float(np.max(np.abs(finer - found)))] if check else []
    return dict(zip(orders.tolist(), found.tolist(), strict=True)), changed


def _waves(grating: tuple[float, float, float], index: complex, terms: int) -> np.ndarray:
    """Unpolarised efficiencies of square grooves by coupled waves."""
    return np.asarray(
        np.mean([validity.coupled_waves(*grating, index, polarisation=p, terms=terms) for p in ("TE", "TM")], axis=0)
    )


def flat() -> list[str]:
    """Largest relative error of R(λ, θ) of flat metals, seen in the mirror direction through the library."""
    hf = wd.HeightField(np.zeros((64, 64)), 0.09)
    angles, wavelengths = np.arange(0.0, 81.0, 5.0), np.arange(380.0, 781.0, 20.0)
    theta = np.radians(angles)
    lights = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1)
    lines = ["| metal | spectra | colours, sampled | colours, from a table |", "| --- | --- | --- | --- |"]
    sampled = wd.plan(hf, method="low-rank")
    tabled = dataclasses.replace(sampled, nodes=32, rays_per_width=1.3)
    mirror = {"ior": math.inf}
    for symbol in ("Al", "Ag", "Au", "Cr", "Cu", "Ni"):
        material = wd.Material.metal(symbol)
        views = lights * [-1.0, 1.0, 1.0]
        exact = flat_materials.reflectance(material, 1e-3 * wavelengths, np.cos(theta)[:, None])
        spectra = wd.spectral_reflectance(hf, lights, views, wavelengths, material=material)
        spectra = spectra / wd.spectral_reflectance(hf, lights, views, wavelengths, **mirror)
        cells = [f"{np.max(np.abs(spectra / exact - 1.0)):.1e}"]
        grid = np.arange(380, 781)
        products = colorimetry.colour_products()
        colours = flat_materials.reflectance(material, 1e-3 * grid, np.cos(theta)[:, None]) @ products
        for plan in (sampled, tabled):
            found = wd.reflectance(hf, lights, views, plan=plan, material=material)
            white = wd.reflectance(hf, lights, views, plan=plan, **mirror) / products.sum(axis=0)
            cells.append(
                f"{np.max(np.linalg.norm(found / white - colours, axis=1) / np.linalg.norm(colours, axis=1)):.1e}"
            )
        lines.append(f"| {symbol} | {' | '.join(cells)} |")
    return lines


def frames(repeats: int, materials: dict[str, dict[str, Any]]) -> list[str]:
    """Times of frames of a tube and of the snake, in turns."""
    hf = wd.gratings.fingers(size_um=25.6, pitch_um=0.08)
    bodies = {"tube": wd.meshes.tube(), "snake": wd.meshes.snake()}
    lines = [
        "| body | material | first picture [s] | a frame [ms] | of a core [ms] | functions of w |",
        "| --- " * 6 + "|",
    ]
    for body, mesh in bodies.items():
        distance = 4.0 if body == "tube" else 9.0
        view = wd.View((0.0, 0.5 * distance, distance), (0, 0, 0), fov_y_deg=25, width=640, height=480)
        light = wd.DirectionalLight((0.6, 1.0, 0.3))
        made = {}
        for name, options in materials.items():
            begin = time.perf_counter()
            made[name] = wd.Renderer(mesh, hf, light, view, tolerance=1e-1, pigment=0.0, refine=False, **options)
            made[name].draw()
            first = time.perf_counter() - begin
            made[name] = made[name], first
        wall: dict[str, list[float]] = {name: [] for name in made}
        core: dict[str, list[float]] = {name: [] for name in made}
        for turn in range(repeats):
            for name, (renderer, _) in made.items():
                towards = wd.DirectionalLight((0.6, 1.0, 0.3 + 0.01 * turn))
                begins = time.perf_counter(), time.process_time()
                renderer.draw(towards)
                wall[name].append(time.perf_counter() - begins[0])
                core[name].append(time.process_time() - begins[1])
        for name, (renderer, first) in made.items():
            lines.append(
                f"| {body} | {name} | {first:.2f} | {1e3 * statistics.median(wall[name]):.1f} "
                f"| {1e3 * statistics.median(core[name]):.1f} | {renderer.plan.functions} |"
            )
    return lines


def main() -> int:
    """Print the tables that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gratings", action="store_true", help="orders of metal gratings against rigorous solvers")
    parser.add_argument("--flat", action="store_true", help="flat metals against Fresnel's equations")
    parser.add_argument("--frames", action="store_true", help="times of frames of gold and of n = 1.5")
    parser.add_argument("--quick", action="store_true", help="every seventh grating alone")
    parser.add_argument("--repeats", type=int, default=15, help="frames of each material (15)")
    options = parser.parse_args()
    asked = options.gratings or options.flat or options.frames
    if options.flat or not asked:
        print("\n".join(flat()))
    if options.frames or not asked:
        kinds: dict[str, dict[str, Any]] = {
            "n = 1.5": {},
            **{material.name: {"material": material} for material in map(wd.Material.metal, ("Au", "Al"))},
        }
        print("\n".join(frames(options.repeats, kinds)))
    if options.gratings or not asked:
        gratings(options.quick)
    return 0


if __name__ == "__main__":
    sys.exit(main())
