"""Cost and errors of exact gradients, coverage of fits of synthetic gratings, depths fitted to rigorous solutions.

::

    python -m bench.reproduce.gradients --cost path/to/scan.png
    python -m bench.reproduce.gradients --errors 200
    python -m bench.reproduce.gradients --fits 1000
    python -m bench.reproduce.gradients --fits 50 --starts 8
    python -m bench.reproduce.gradients --depths

``--cost`` measures the processor time of all threads [s]. Each time is the least of three calls, so that other
processes have little influence. The column "value" is a call without variables. The gradient is by all heights, the
pitch, σ and all directions. The column "library" has the time of the function without derivatives for a new surface,
and in parentheses the time of a second call for the same surface.

``--errors`` prints errors of derivatives for random surfaces, directions and optical properties. The reference is
computed by complex steps: the imaginary part of f(x + ih), divided by h. The function f is a sum that shares no code
with the library (``tests/complex_step.py``). Errors are relative to the largest derivative by the same variable.

``--fits`` fits the profile of a trapezoid to efficiencies of the orders −2 to 2 of a perfect mirror, at three
wavelengths and two angles, with noise of 1 % and 5e-4. The first starting point deviates from the true values by 10 %
in depth and by 5 % in duty cycle. A fit that ends at 1 minus the true duty cycle counts as correct.

``--depths`` fits the depths of the perfect mirrors in ``bench/suite/rigorous.json``, at 0°, 30° and 60°.
"""

from __future__ import annotations

import argparse
import collections
import importlib
import json
import math
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import warpdiff as wd
from bench.suite.validity import STORED

if TYPE_CHECKING:
    from collections.abc import Callable

# True parameters of the fitted trapezoidal grating: depth [µm], duty cycle, width of a wall [periods], period [µm].
TRUE = np.array([0.14, 0.42, 0.04, 2.0])
VARIABLES = ("heights_um", "pitch_um", "sigma_um", "to_light", "to_view")
# Angles of incidence for which rigorous solutions are stored [degrees].
ANGLES = (0.0, 30.0, 60.0)
# Gratings with rigorous solutions, by title. Each entry has the function that makes the height field, the least period
# and the largest depth [wavelengths], and the largest accepted relative error of the fitted depth.
CASES = {
    "Sine, perfect mirror": (wd.gratings.sinusoidal, 1.0, 0.3, 0.03),
    "Square grooves, perfect mirror": (wd.gratings.lamellar, 2.0, 0.15, 0.025),
    "Sawtooth, perfect mirror": (wd.gratings.blazed, 5.0, 0.3, 0.04),
}


def seconds(function: Callable, *arguments: object, **options: object) -> tuple[float, object]:
    """Return the processor time of a call in seconds, and its result."""
    start = time.process_time()
    result = function(*arguments, **options)
    return time.process_time() - start, result


def hemisphere(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random unit vectors at most 60° from the z axis, shape (count, 3)."""
    z, phi = rng.uniform(0.5, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def cost(path: str) -> None:
    """Print the processor time of reflectances and their gradients, relative to the time of the reflectances alone."""
    scan = wd.HeightField.load(path, extent_um=65.0, height_range_um=0.375).levelled(order=2)
    rng, wavelengths = np.random.default_rng(1), np.linspace(380.0, 780.0, 81)
    small = wd.gratings.fingers(size_um=3.2, pitch_um=0.1)
    wd.adjoint.spectral_reflectance(small, (0, 0.1, 1), (0.3, 0, 1), 550.0, wrt=VARIABLES).vjp([1.0])  # compiles
    print("| call | library, new surface (again) | value | value + gradient | ratio |")
    print("| --- | --- | --- | --- | --- |")
    for count, truncation in ((None, 1e-13), (100, 1e-6), (10_000, 1e-6), (100_000, 1e-6)):
        if count is None:
            name = "orders, one wavelength"
            arguments: tuple = ((0.2, 0.1, 1.0), 550.0)
            plain, function = wd.order_efficiencies, wd.adjoint.order_efficiencies
            names, options = ("heights_um", "pitch_um", "to_light", "wavelengths_nm"), {}
        else:
            name = f"{count} × 81"
            arguments = hemisphere(rng, count), hemisphere(rng, count), wavelengths
            plain, function = wd.spectral_reflectance, wd.adjoint.spectral_reflectance
            names, options = VARIABLES, {"truncation": truncation}
        new = wd.HeightField.of_known_scale(scan.heights_um + 1e-9 * (count or 1), scan.pitch_um)
        first, _ = seconds(plain, new, *arguments)
        again, _ = seconds(plain, new, *arguments)
        values, sums = [], []
        for _ in range(3):
            values.append(seconds(function, scan, *arguments, wrt=(), **options)[0])
            forward, result = seconds(function, scan, *arguments, wrt=names, **options)
            weights = rng.normal(size=result.value.shape)
            sums.append(forward + seconds(result.vjp, weights)[0])
        value, both = min(values), min(sums)
        print(
            f"| {name}, {truncation:g} | {first:.2f} ({again:.2f}) | {value:.2f} | {both:.2f} | {both / value:.2f} |",
            flush=True,
        )


def errors(count: int) -> None:
    """Print the largest relative error of the derivatives of reflectances and order efficiencies, by each variable.

    There are ``count`` random calls for each kind of coherence and for each energy normalisation.
    """
    folder = Path(__file__).parents[2] / "tests"
    sys.path[:0] = [str(folder), str(folder / "adjoint")]
    tests = importlib.import_module("test_against_complex_steps")
    largest: dict[str, float] = collections.defaultdict(float)
    plain = tests.error_of

    def recorded(kind: str) -> Callable[..., float]:
        def error_of(*arguments: object) -> float:
            error = float(plain(*arguments))
            # The test function, which calls this function, differentiates by one variable after the other. The name of
            # the present variable is in the local variable ``name`` of the test function.
            name = sys._getframe(1).f_locals["name"]
            largest[f"{kind}: {name}"] = max(largest[f"{kind}: {name}"], error)
            return error

        return error_of

    for seed in range(count):
        for kind in tests.KINDS:
            tests.error_of = recorded(kind)
            tests.test_spectral_derivatives(kind, seed)
        for energy in ("stam", "normalised"):
            tests.error_of = recorded(f"orders, {energy}")
            tests.test_derivatives_of_orders(energy, seed)
    for name, error in largest.items():
        print(f"{name}: {error:.1e}")


def measured(values: np.ndarray | None = None) -> wd.Measured:
    """Return data as if measured: efficiencies of orders of the synthetic grating, 0 if no values are given."""
    wavelengths, orders = (450.0, 550.0, 650.0), [(0, m) for m in (-2, -1, 0, 1, 2)]
    lights = np.repeat(wd.direction([10.0, 40.0]), 15, axis=0)
    values = np.zeros(30) if values is None else values
    return wd.Measured.orders(
        lights, np.tile(np.repeat(wavelengths, 5), 2), np.tile(orders, (6, 1)), values, ior=math.inf
    )


def fits(count: int, starts: int) -> None:
    """Print how well fits find the parameters of a grating.

    The printed numbers are the share of fitted parameters that deviate from the true values by at most two standard
    errors, χ² per degree of freedom, and the share of fits that list both possible duty cycles (d and 1 − d).
    """
    grating, guess = wd.profiles.Trapezoid(*TRUE), wd.profiles.Trapezoid(*(TRUE * [1.1, 0.95, 1.2, 1.0]))
    exact, rng = measured().predict(grating.surface(TRUE)).value, np.random.default_rng(0)
    sd = 0.01 * exact + 5e-4
    within, chi2, evaluations, converged, both = [], [], [], [], []
    start = time.process_time()
    for seed in range(count):
        result = wd.fit(guess, measured(exact + sd * rng.normal(size=30)), sd=sd, starts=starts, seed=seed)
        off = [np.abs(result.values - other) for other in (TRUE, *grating.equivalents(TRUE))]
        within.append(np.minimum(*off) <= 2.0 * result.standard_errors)
        chi2.append(result.chi2 / result.degrees_of_freedom)
        evaluations.append(result.evaluations)
        converged.append(result.minima[0].has_converged)
        duties = np.array([minimum.values[1] for minimum in result.minima])
        both.append(all(np.any(np.abs(duties - duty) < 0.01) for duty in (TRUE[1], 1.0 - TRUE[1])))
    shares = dict(zip(grating.names, np.mean(within, axis=0).round(3).tolist(), strict=True))
    print(f"{count} fits, {(time.process_time() - start) / count:.2f} s each, {np.mean(evaluations):.1f} evaluations")
    print(f"within two standard errors: {np.mean(within):.3f} pooled, {shares}")
    print(f"χ² per degree of freedom: {np.mean(chi2):.3f}; converged: {np.mean(converged):.3f}")
    print(f"fits that list duty and 1 - duty: {np.mean(both):.3f}")
    compare_minimisers(guess, exact + sd * rng.normal(size=30), sd)


def compare_minimisers(guess: wd.profiles.Trapezoid, values: np.ndarray, sd: np.ndarray) -> None:
    """Print how often three methods of minimisation evaluate the model of a grating for the same fit.

    The methods are the fit of the library, least squares with finite differences, and the method of Nelder and Mead.
    """
    from scipy.optimize import least_squares, minimize

    counted, (low, high) = measured(values), guess.bounds.T
    calls = [0]

    def residuals(x: np.ndarray) -> np.ndarray:
        calls[0] += 1
        return (counted.predict(guess.surface(np.clip(x, low, high))).value - values) / sd

    result = wd.fit(guess, counted, sd=sd, starts=1)
    print(f"fit: {result.evaluations} evaluations, χ² = {result.chi2:.3f}")
    by_differences = least_squares(residuals, guess.start, bounds=(low, high), x_scale=high - low)
    print(f"least squares by differences: {calls[0]} evaluations, χ² = {2.0 * by_differences.cost:.3f}")
    calls[0] = 0
    limits = {"xatol": 1e-6, "fatol": 1e-6, "maxfev": 4000}
    free = minimize(lambda x: np.sum(residuals(x) ** 2), guess.start, method="Nelder-Mead", options=limits)
    print(f"Nelder-Mead: {calls[0]} evaluations, χ² = {free.fun:.3f}")


class Depth(wd.profiles.ScanModes):
    """Surface with one parameter: a factor by which all heights of a height field are multiplied."""

    def __init__(self, heightfield: wd.HeightField) -> None:
        super().__init__(heightfield)
        self.names, self.start, self.bounds = self.names[:1], self.start[:1], np.array([[0.3, 3.0]])
        self._modes = self._modes[:1]


def depths() -> None:
    """Print errors of depths that are fitted to rigorous solutions: number of gratings, median and largest error."""
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    periods, all_depths = np.array(stored["periods"]), np.array(stored["depths"])
    for case, (make, least_period, most_depth, limit) in CASES.items():
        rows = stored["cases"][case]["first_order_and_efficiencies"]
        errors = []
        for i, period in enumerate(periods):
            for j, depth in enumerate(all_depths):
                if period < least_period or depth > most_depth:
                    continue
                orders, lights, values = [], [], []
                for k, light in enumerate(wd.direction(ANGLES)):
                    first, *efficiencies = rows[(i * len(all_depths) + j) * 3 + k]
                    known = set(wd.order_efficiencies(make(period, depth), light, 1000.0).orders[:, 1].tolist())
                    numbers = np.arange(first, first + len(efficiencies))
                    orders += (numbers if set(numbers.tolist()) == known else -numbers).tolist()
                    lights += [light] * len(efficiencies)
                    values += efficiencies
                pairs = np.stack([np.zeros(len(orders)), orders], axis=1)
                data = wd.Measured.orders(lights, 1000.0, pairs, 1e-5 * np.array(values), ior=math.inf)
                result = wd.fit(Depth(make(period, depth)), data, sd=0.01, starts=1)
                errors.append(abs(result.values[0] - 1.0))
        text = f"{len(errors)} gratings, median {100 * np.median(errors):.2f} %, largest {100 * max(errors):.2f} %"
        print(f"{case}, period >= {least_period:g} λ, depth <= {most_depth:g} λ: {text}, limit {100 * limit:g} %")


def main() -> None:
    """Run the measurements of gradients and fits that the command line options select."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cost", metavar="SCAN")
    parser.add_argument("--errors", type=int, default=0)
    parser.add_argument("--fits", type=int, default=0)
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--depths", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    if arguments.cost:
        cost(arguments.cost)
    if arguments.fits:
        fits(arguments.fits, arguments.starts)
    if arguments.errors:
        errors(arguments.errors)
    if arguments.depths:
        depths()


if __name__ == "__main__":
    main()
