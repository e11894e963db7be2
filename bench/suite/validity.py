"""Validity of scalar diffraction: errors of order efficiencies relative to rigorous solutions, by period and depth.

The plane of incidence is perpendicular to the grooves, at three angles; both polarisations are averaged. The reference
is a published solver by boundary integrals (gratinglab; Goray and Schmidt 2010, J. Opt. Soc. Am. A 27, 585). The solver
requires minutes. Its efficiencies are therefore stored in ``rigorous.json``, which ``python -m bench.suite.validity``
writes. The file also has two estimates of the error of the solver: the violation of the energy balance, and the changes
of the efficiencies if its mesh is refined.

Errors are shares of the power that a flat surface reflects. For glass, the library computes the reflectance of a flat
surface by Schlick's formula, and the solver computes it by Fresnel's equations. The library's efficiencies are divided
by the former, and the solver's by the latter. This excludes the error of Schlick's formula.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench.suite import figures
from warpdiff.heightfield.theory_verdict import INVALID, QUALITATIVE, verdict_on
from warpdiff.optics import reflectance_factors

if TYPE_CHECKING:
    from bench.suite.runner import Setting

STORED = Path(__file__).with_name("rigorous.json")
# Gratings by title: profile and index of refraction (None is a perfect conductor).
CASES = {
    "Sine, perfect mirror": ("sine", None), "Square grooves, perfect mirror": ("square", None),
    "Sawtooth, perfect mirror": ("sawtooth", None), "Sine, n = 1.5": ("sine", 1.5),
}  # fmt: skip
GRATINGS = {"sine": wd.gratings.sinusoidal, "square": wd.gratings.lamellar, "sawtooth": wd.gratings.blazed}
# Angles of incidence [degrees].
ANGLES = (0.0, 30.0, 60.0)
# Periods and depths [wavelengths]. The values were chosen so that no order is within 4° of the horizon, neither in air
# nor in glass. Nearer to the horizon, rigorous efficiencies jump (Rayleigh anomalies).
PERIODS = np.geomspace(0.502, 19.16, 17)
DEPTHS = np.geomspace(0.02, 1.0, 11)
# Number of height samples per period.
SAMPLES = 2048
# Unit of the integers that store efficiencies. The value was chosen so that the rounding is small compared with the
# errors in the chart.
UNIT = 1e-5
# Largest error of an order's efficiency that counts as correct, as a share of the power that a flat surface reflects.
LIMIT = 0.1
# Errors of order efficiencies at which contour lines are drawn.
LEVELS = (0.02, 0.05, 0.1)
# Wavelength of the solver [nm]; periods and depths are relative to it. The value is limited by the spectral range of
# the solver's material files.
WAVELENGTH_NM = 500.0


class Integral:
    """Reference solver by boundary integrals. Periods and depths of gratings are relative to the wavelength."""

    def __init__(self) -> None:
        from gratinglab import Illumination, problem, profiles, solvers

        self._illumination, self._problem, self._profiles = Illumination.classical, problem.Problem, profiles
        self._solver = solvers.get_solver("integral")
        # The solver reads indices of refraction from files. An environment variable states the folder of these files.
        self._folder = tempfile.TemporaryDirectory()
        os.environ["GRATINGLAB_MATERIALS"] = self._folder.name

    def __call__(
        self, shape: str, period: float, depth: float, angle: float, index: float | None, *, finer: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray, float]:  # fmt: skip
        """Return the diffraction orders of a grating with their efficiencies, and the error of the energy balance."""
        profile = {
            "sine": lambda: self._profiles.Sinusoidal(depth_fraction=depth / period),
            "square": lambda: self._profiles.Lamellar(depth_fraction=depth / period),
            "sawtooth": lambda: self._profiles.Blazed(blaze_angle=math.degrees(math.atan(depth / period))),
        }[shape]()
        name = None
        if index is not None:
            name = f"n{index:g}"
            Path(self._folder.name, f"{name}.txt").write_text(f"2.0 {1.0 - index} 0.0\n3.0 {1.0 - index} 0.0\n")
        # The mesh of the profile is finer towards its corners. Where the mesh is coarsest, it has 6 points per
        # wavelength, by the solver's definition.
        points = 24.0 * (period + 2.0 * depth) * max(1.0, (index or 1.0) / 1.5)
        scan = self._solver.solve(
            self._problem(period=WAVELENGTH_NM * period, profile=profile, coating=name),
            self._illumination(alpha=angle, polarization="unpolarized"), [WAVELENGTH_NM],
            boundary_points=math.ceil(finer * max(224.0, points)), corner_grading=4,
            conductivity="perfect" if index is None else "tabulated",
        )  # fmt: skip
        efficiencies = np.asarray(scan.efficiency[0])
        absorbed = 0.0 if index is None else float(scan.absorption[0])
        return np.asarray(scan.orders), efficiencies, abs(float(efficiencies.sum()) + absorbed - 1.0)


def recompute() -> None:
    """Solve all gratings with the reference solver, and write the efficiencies to ``rigorous.json``."""
    solve, stored = Integral(), {}
    for case, (shape, index) in CASES.items():
        begin, rows, energy, finer = time.perf_counter(), [], [], []
        for i, period in enumerate(PERIODS):
            for j, depth in enumerate(DEPTHS):
                for k, angle in enumerate(ANGLES):
                    orders, powers, missed = solve(shape, period, depth, angle, index)
                    rows.append([int(orders[0]), *np.rint(powers / UNIT).astype(int).tolist()])
                    energy.append(missed)
                    if (i + j + k) % 10 == 0:
                        finer.append(
                            float(np.max(np.abs(solve(shape, period, depth, angle, index, finer=1.5)[1] - powers)))
                        )
        stored[case] = {
            "energy_missed": [float(f"{np.quantile(energy, q):.1e}") for q in (0.5, 0.99, 1.0)],
            "change_on_a_finer_mesh": [float(f"{np.quantile(finer, q):.1e}") for q in (0.5, 0.99, 1.0)],
            "first_order_and_efficiencies": rows,
        }
        print(f"{case}: {time.perf_counter() - begin:.0f} s, {stored[case]['energy_missed']}", flush=True)
    head = {
        "made_by": "python -m bench.suite.validity",
        "order_of_rows": "period, depth, angle; quantiles are 0.5, 0.99 and 1", "periods": PERIODS.round(6).tolist(),
        "depths": DEPTHS.round(6).tolist(), "angles_deg": ANGLES, "unit": UNIT,
    }  # fmt: skip
    STORED.write_text(json.dumps(head | {"cases": stored}, separators=(",", ":")) + "\n")


def flat_reflectance(index: float | None, angle: float) -> tuple[float, float]:
    """Return the reflectance of a flat surface for unpolarised light, by Fresnel's equations and by the library."""
    if index is None:
        return 1.0, 1.0
    cos_i = math.cos(math.radians(angle))
    cos_t = math.sqrt(1.0 - (math.sin(math.radians(angle)) / index) ** 2)
    across = ((cos_i - index * cos_t) / (cos_i + index * cos_t)) ** 2
    along = ((index * cos_i - cos_t) / (index * cos_i + cos_t)) ** 2
    return (across + along) / 2.0, float(
        reflectance_factors.schlick(np.array(cos_i), reflectance_factors.normal_reflectance(index))
    )


def error(shape: str, index: float | None, period: float, depth: float, angle: float, row: list[int]) -> float:
    """Return the error of scalar diffraction for a grating, compared with a rigorous solution.

    The error is that of the order with the largest difference in power, divided by the power that a flat surface
    reflects.
    """
    flat, ours = flat_reflectance(index, angle)
    rigorous = np.array(row[1:]) * UNIT / flat
    heightfield = GRATINGS[shape](period, depth, samples=SAMPLES)
    light = (math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle)))
    # Periods and depths are stored in units of the wavelength. In this call the wavelength is 1 µm, so that the stored
    # numbers are lengths in µm.
    scalar = wd.order_efficiencies(heightfield, light, 1000.0, ior=index or math.inf, energy="stam")
    efficiencies = np.array([scalar[0, row[0] + n][0] for n in range(len(rigorous))]) / ours
    return float(np.max(np.abs(efficiencies - rigorous)))


def measure(setting: Setting) -> dict[str, Any]:
    """Return maps of the measured error and of the error that the library expects, and counts of gratings by grade."""
    stored, step = json.loads(STORED.read_text()), 2 if setting.quick else 1
    periods, depths = np.array(stored["periods"][::step]), np.array(stored["depths"][::step])
    results: dict[str, Any] = {"periods_in_wavelengths": periods.tolist(), "depths_in_wavelengths": depths.tolist()}
    maps, verdicts, rules = {}, {}, {}
    for case, (shape, index) in CASES.items():
        rows = iter(stored["cases"][case]["first_order_and_efficiencies"])
        worst = []
        for i, period in enumerate(stored["periods"]):
            for j, depth in enumerate(stored["depths"]):
                angles = [next(rows) for _ in ANGLES]
                if i % step == j % step == 0:
                    every = zip(ANGLES, angles, strict=True)
                    worst.append(max(error(shape, index, period, depth, angle, row) for angle, row in every))
        errors = np.array(worst).reshape(len(periods), len(depths)).round(5)
        # Periods and depths are stored in units of the wavelength. Here the wavelength is 1 µm, so that the stored
        # numbers are lengths in µm.
        expected = [[verdict_on(GRATINGS[shape](p, d, samples=SAMPLES), 1000.0).error for d in depths] for p in periods]
        maps[case], verdicts[case], rules[case] = errors.tolist(), expected, rule(errors, np.array(expected))
    return results | {"maps": maps, "verdicts": verdicts, "rule": rules}


def rule(error: np.ndarray, expected: np.ndarray) -> dict[str, float]:
    """Return counts of gratings by grade and error, and the errors of reliable and of invalid gratings.

    The grade is the library's verdict on scalar diffraction. For gratings with the grade reliable, the largest error is
    returned; for gratings with the grade invalid, the median.
    """
    reliable, invalid = expected < QUALITATIVE, expected >= INVALID
    return {
        "gratings": error.size, "right_within_a_tenth": int(np.sum(error <= LIMIT)), "reliable": int(np.sum(reliable)),
        "reliable_and_beyond_a_tenth": int(np.sum(reliable & (error > LIMIT))),
        "worst_reliable": float(error[reliable].max()), "invalid": int(np.sum(invalid)),
        "invalid_and_beyond_a_tenth": int(np.sum(invalid & (error > LIMIT))),
        "median_error_of_invalid": float(np.median(error[invalid])),
    }  # fmt: skip


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw maps of the error. Return the chart's name and sentences about gratings that the library grades reliable."""
    from matplotlib.colors import LogNorm

    plt = figures.pyplot()
    periods, depths = np.array(results["periods_in_wavelengths"]), np.array(results["depths_in_wavelengths"])
    figure, axes = plt.subplots(2, 2, figsize=(10.0, 8.6), sharex=True, sharey=True, layout="constrained")
    for axis, case in zip(axes.flat, CASES, strict=True):
        error = np.maximum(np.array(results["maps"][case]).T, 1e-4)
        colours = axis.pcolormesh(
            periods, depths, error, norm=LogNorm(1e-3, 1.0), cmap="viridis", shading="nearest", rasterized=True
        )
        lines = axis.contour(
            periods, depths, np.log10(error), np.log10(LEVELS), colors="white", linewidths=(0.7, 1, 1.6),
            linestyles="solid",
        )  # fmt: skip
        axis.clabel(lines, fmt=lambda level: f"{10**level:.2g}", fontsize=8)
        expected = np.log10(np.maximum(np.array(results["verdicts"][case]).T, 1e-4))
        axis.contour(
            periods, depths, expected, np.log10((QUALITATIVE, INVALID)), colors="#ff5a36", linewidths=2.4,
            linestyles=("solid", "dashed"),
        )  # fmt: skip
        axis.set(xscale="log", yscale="log", xlim=(periods[0], periods[-1]), ylim=(depths[0], depths[-1]))
        axis.set_title(case, loc="left", fontweight="bold")
        axis.set_xticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
        axis.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1], ["0.02", "0.05", "0.1", "0.2", "0.5", "1"])
        axis.minorticks_off()
    for axis in axes[1]:
        axis.set_xlabel("period / wavelength")
    for axis in axes[:, 0]:
        axis.set_ylabel("depth, peak to valley / wavelength")
    bar = figure.colorbar(colours, ax=axes, extend="both", shrink=0.7, ticks=(1e-3, 1e-2, 1e-1, 1.0))
    bar.ax.set_yticklabels(["0.001", "0.01", "0.1", "1"])
    bar.set_label("largest error of any order, as a share of the reflected power (worst of 0°, 30°, 60°)")
    figure.suptitle(
        "Error of scalar diffraction in the efficiency of an order, against rigorous solutions\n"
        "red lines: the verdict on the heights is reliable below the solid and invalid above the dashed one",
        fontsize=11,
    )
    figures.save(figure, folder, "validity")
    cases = list(results["rule"].values())
    total = {name: sum(counts[name] for counts in cases) for name in cases[0]}
    worst = max(counts["worst_reliable"] for counts in cases)
    right = total["reliable"] - total["reliable_and_beyond_a_tenth"]
    text = (
        f"Of the {total['reliable']} gratings that the verdict grades as reliable, the orders of {right} have errors "
        f"of at most 10 % of the reflected power (worst: {100.0 * worst:.0f} %). The grade covers "
        f"{right / total['right_within_a_tenth']:.0%} of the {total['right_within_a_tenth']} gratings with such errors."
    )
    return {"validity": text}


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the counts and errors that ``rule`` computes, by name.

    Each value is stored as a list [value, value, value, unit], because other charts have lists [median, minimum,
    maximum, unit].
    """
    return {
        f"validity/{case}/{name}": [value] * 3 + ["gratings" if isinstance(value, int) else "share of the light"]
        for case, counts in results["rule"].items()
        for name, value in counts.items()
    }


if __name__ == "__main__":
    recompute()
