"""Comparison of the algorithm of Single (2014) with the library on a picture, at equal time or equal error.

The library selects its own numerical settings (automatic plan). The picture shows the tube with the levelled 65 µm
scan. Both methods evaluate the same directions, those of a stratified sample of the picture's illuminated pixels.
Errors are relative to the float64 reference: the 99th percentile (P99) of ‖ΔXYZ‖ / max(‖XYZ‖, f) over the pixels with Y
>= f, where f is a thousandth of the reference luminance (``bench.truth.errors``). Times are those of calls with
prepared tables on a larger sample of pixels, as medians of interleaved rounds.

The setting of the publication is 81 equally spaced wavelengths (380 to 780 nm, 5 nm), 37 Taylor terms (n = 0 … 36) of
heights that are not centred, 3 × 3 Fourier coefficients around the one that floor() selects, and a rectangle rule. The
algorithm is computed in Numba. Finer settings of the algorithm reach the error of the automatic plan. Two of these are
compared: the cheapest setting with the publication's series (37 terms, heights not centred), and the cheapest of all
combinations of wavelengths, neighbouring coefficients and terms, with heights centred or not. The printed table also
has the setting of the publication with rounding instead of floor().
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.peers import numba_published
from bench.suite import pareto
from bench.suite.scenes import Directions, Scene, scenes
from bench.suite.timing import interleaved
from bench.truth import errors, pixel_reference, reference
from warpdiff.device.devices import resolve_device, resolve_threads

if TYPE_CHECKING:
    from collections.abc import Callable

LANES = numba_published.LANES
# Numbers of wavelengths and of terms of the Taylor series in the height, from which the settings of the published
# algorithm are combined. The numbers of wavelengths are in steps of a factor 2^(1/4).
MORE_WAVELENGTHS = [round(81 * 2 ** (k / 4)) for k in range(-4, 21)]
MORE_TERMS = (8, 16, 24, 32, 37, 48)
# Largest number of Fourier coefficients on each side of the central one that are summed, by kind of coherence. The
# published algorithm computes their Gaussian weights by recurrence, from the outermost coefficient inwards. With larger
# numbers, the outermost weight would be below the smallest float32. Coefficients at that distance contribute less than
# rounding errors.
MOST_REACH = {"averaged": 3, "centred": 4}
# Number of settings that are timed; these have the fewest multiply-adds of all settings that reach the target error.
FINALISTS = 3
TOLERANCE, TOLERANCES = 1e-2, sorted([1e-2, *(0.5 * 2.0 ** (-k) for k in range(9))], reverse=True)
# Tolerance of the reference colours. It must be small compared with the errors of the compared methods.
TRUTH = 1e-3
# Width of the picture [pixels], number of pixels per timed call, and number of rounds of timed calls.
WIDTH, TIMED, ROUNDS = 640, 12_000, 9


class Setting(NamedTuple):
    """Setting of the published algorithm (Single 2014).

    It has the numbers of wavelengths, of terms of the Taylor series, and of neighbouring Fourier coefficients on each
    side of the central one. With ``centred``, heights are relative to the middle of their range. ``rounded`` selects
    the central coefficient by rounding instead of floor().
    """

    wavelengths: int = 81
    terms: int = 37
    neighbour_extent: int = 1
    centred: bool = False
    rounded: bool = False

    @property
    def as_published(self) -> bool:
        """Return whether the Taylor series is that of the publication: 37 terms, heights that are not centred."""
        return self.terms == Setting().terms and not self.centred

    @property
    def multiply_adds(self) -> float:
        """Return the cost of a setting: multiply-adds per pixel for the series of all summed Fourier coefficients.

        Only the real parts are counted; the imaginary parts require as many. The sum over the coefficients is excluded.
        """
        return self.wavelengths * LANES * math.ceil(self.terms / LANES) * (2 * self.neighbour_extent + 1) ** 2

    def __str__(self) -> str:
        return f"{pareto.label(self._asdict())}, heights {'centred' if self.centred else 'not centred'}"


def refined(error_of: Callable[[Setting], float], most: int, target: float) -> tuple[list[Setting], float]:
    """Return settings that reach a target error with the fewest multiply-adds, and the least error that was measured.

    A setting has the numbers of Taylor terms, of neighbouring Fourier coefficients, and of wavelengths. More of one of
    them, with the other two unchanged, are assumed to reduce the error. The function first finds the two smallest
    numbers of terms that reach the target with the most coefficients and wavelengths. It also tries the 37 terms of
    the publication. For each number of terms and of coefficients, bisection then finds the smallest sufficient number
    of wavelengths. If settings with the publication's Taylor series reach the target, the cheapest one is included.
    """
    successes: list[Setting] = []
    found: list[float] = []

    def error(setting: Setting) -> float:
        p99 = error_of(setting)
        found.append(p99 if math.isfinite(p99) else math.inf)
        return found[-1]

    for centred in (False, True):
        finest = Setting(MORE_WAVELENGTHS[-1], Setting().terms, most, centred)
        enough: list[int] = []
        for terms in MORE_TERMS:
            if len(enough) < 2 and error(finest._replace(terms=terms)) <= target:
                enough.append(terms)
        if not centred and finest.terms not in enough:
            enough.append(finest.terms)
        for terms in enough:
            for neighbour_extent in range(1, most + 1):
                candidate = finest._replace(terms=terms, neighbour_extent=neighbour_extent)
                if error(candidate) > target:
                    continue
                low, high = -1, len(MORE_WAVELENGTHS) - 1
                while high - low > 1:
                    middle = (low + high) // 2
                    if error(candidate._replace(wavelengths=MORE_WAVELENGTHS[middle])) <= target:
                        high = middle
                    else:
                        low = middle
                successes.append(candidate._replace(wavelengths=MORE_WAVELENGTHS[high]))
    successes.sort(key=lambda setting: setting.multiply_adds)
    as_published = [setting for setting in successes if setting.as_published][:1]
    return list(dict.fromkeys(successes[:FINALISTS] + as_published)), min(found)


def compare(scene: Scene, coherence: wd.Coherence, pixels: int) -> None:
    """Print a table with errors and times of the library and of settings of the published algorithm.

    ``coherence`` limits the interference in both. Two comparisons follow: errors at equal time, and times at equal
    error.
    """
    heightfield, device, threads = scene.heightfield, resolve_device(None), resolve_threads(None)
    whole, _ = scene.directions(coherence, WIDTH)
    every = np.ones(len(whole.gains), dtype=bool)
    few, many = (
        Directions(*(part[np.sort(pixel_reference.stratified(every, count))] for part in whole))
        for count in (pixels, TIMED)
    )
    exact = few.gains[:, None] * reference.colours(
        heightfield, few.scattering_vectors, few.to_lights, coherence, tolerance=TRUTH
    )
    bright = exact[:, 1] >= errors.FLOOR * errors.reference_luminance(exact[:, 1])

    def p99(shade: pareto.Shade) -> float:
        xyz = shade(few.scattering_vectors, few.gains, threads)
        return float(np.percentile(errors.relative(xyz, exact)[bright], 99.0))

    def published(setting: Setting) -> pareto.Shade:
        return numba_published.prepare(heightfield, coherence, **setting._asdict())

    pairs = whole.to_lights, -whole.scattering_vectors - whole.to_lights
    plans = {
        f"tolerance {tolerance:.2g}": wd.plan(heightfield, *pairs, tolerance=tolerance, coherence=coherence)
        for tolerance in TOLERANCES
    }
    p99s = {name: p99(pareto.ours(heightfield, plan, few, device)) for name, plan in plans.items()}
    chosen, as_published = f"tolerance {TOLERANCE:.2g}", str(Setting())
    sufficient, least = refined(lambda setting: p99(published(setting)), MOST_REACH[coherence.kind], p99s[chosen])
    shades = {name: pareto.ours(heightfield, plan, many, device) for name, plan in plans.items()}
    for setting in (Setting(), Setting(rounded=True), Setting(centred=True), *sufficient):
        shades[str(setting)] = published(setting)
        p99s[str(setting)] = p99(shades[str(setting)])
    times = interleaved(
        {name: lambda s=shade: s(many.scattering_vectors, many.gains, threads) for name, shade in shades.items()},
        ROUNDS,
    )
    us = {name: 1e6 * times[name].median / len(many.gains) for name in shades}
    print(f"\n{coherence}, {len(few.gains)} of {len(every)} illuminated pixels\n")
    print("| setting | P99 | µs per pixel |\n| --- | --- | --- |")
    print("\n".join(f"| {name} | {p99s[name]:.1e} | {us[name]:.2f} |" for name in shades))
    cheap = [name for name in plans if us[name] <= us[as_published]] or [min(plans, key=lambda name: us[name])]
    best = min(cheap, key=lambda name: p99s[name])
    print(
        f"\nEqual cost, {best}: {p99s[as_published] / p99s[best]:.0f} times smaller error than the published setting."
    )
    with_terms = [setting for setting in sufficient if setting.as_published]
    for label, which in {"with its terms": with_terms, "at the lowest cost": sufficient}.items():
        if which:
            cheapest = min(map(str, which), key=lambda name: us[name])
            ratio = us[cheapest] / us[chosen]
            print(f"Equal error, refined {label} ({cheapest}): {ratio:.1f} times the time of {chosen}.", flush=True)
        else:
            print(f"Refined {label}, the published algorithm has an error of at least {least:.1e}.", flush=True)


def main() -> None:
    """Compare the published algorithm with the library under an averaged and under a centred coherence window."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=2000, help="number of stratified random pixels (default: 2000)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    options = parser.parse_args()
    (scene,) = [scene for scene in scenes(options.data) if scene.name == "skin"] or [None]
    if scene is None:
        raise SystemExit("error: the scan is missing; name its folder by --data")
    for kind in MOST_REACH:
        compare(scene, wd.Coherence(kind), options.pixels)


if __name__ == "__main__":
    main()
