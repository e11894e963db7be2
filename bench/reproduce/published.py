"""The published algorithm against the automatic plan, on one frame: error at equal cost and cost at equal error.

The frame is the tube with the levelled 65 µm scan. Both methods shade the same directions of a stratified sample of its
illuminated pixels. The error against the float64 reference is P99 of ‖ΔXYZ‖ / max(‖XYZ‖, f) over the pixels with
Y >= f, f as in ``errors``. A time is that of the shading kernel alone on a larger sample, with warm tables: the median
of interleaved rounds.

The published setting is 81 wavelengths equally spaced in λ (380 to 780 nm, 5 nm), 37 Taylor terms (n = 0 … 36) of
heights that are not centred, 3 × 3 coefficients around the one that floor() selects, and a rectangle rule, in Numba. It
is refined until it reaches the error of the automatic choice: once with its 37 terms, once by the cheapest combination
of wavelengths, neighbours and terms, heights centred or not. Rounding, which it does not have, is listed as well.
"""

from __future__ import annotations

import argparse
import copy
import functools
import math
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.peers import numba_published
from bench.truth import reference
from warpdiff import meshes
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.lights.base import lobes_of
from warpdiff.optics import reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.planner import strategy
from warpdiff.render.picture import Picture
from warpdiff.request.directions import DirectionRange, DirectionSample
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables.lookup import ColourLookup

# The published numbers.
WAVELENGTHS, TERMS, REACH = 81, 37, 1
LANES = numba_published.LANES
# Finer settings of the published algorithm: quarter octaves of wavelengths, whole registers of terms.
MORE_WAVELENGTHS = [round(81 * 2 ** (k / 4)) for k in range(-4, 21)]
MORE_TERMS = (8, 16, 24, 32, 37, 48)
# Limit: beyond these the Gaussian's recurrence would begin below float32's least number; its tail is below rounding.
MOST_REACH = {"averaged": 3, "centred": 4}
FINALISTS = 3
TOLERANCES = [0.5 * 2.0 ** (-k) for k in range(9)]
TRUTH = 1e-3
SLICE = 1024


class Setting(NamedTuple):
    """A setting of the published algorithm."""

    wavelengths: int = WAVELENGTHS
    terms: int = TERMS
    neighbour_extent: int = REACH
    centred: bool = False
    rounded: bool = False

    @property
    def lanes(self) -> int:
        """Number of terms with padding."""
        return LANES * math.ceil(self.terms / LANES)

    @property
    def as_published(self) -> bool:
        """Whether the series is the published one."""
        return self.terms == TERMS and not self.centred

    @property
    def multiply_adds(self) -> float:
        """Multiply-adds of the sum over terms and neighbours, in thousands per pixel."""
        return self.wavelengths * 2 * self.lanes * (2 * self.neighbour_extent + 1) ** 2 / 1e3

    def __str__(self) -> str:
        side = 2 * self.neighbour_extent + 1
        heights = "centred" if self.centred else "not centred"
        rule = "rounding" if self.rounded else "floor"
        return f"{self.wavelengths} λ, {self.terms} terms, {side} × {side} by {rule}, heights {heights}"


class Frame:
    """Illuminated pixels of the frame, a sample that is shaded, and the arrays of both methods."""

    def __init__(self, heightfield: wd.HeightField, *, pixels: int, width: int, threads: int | None) -> None:
        self.heightfield, self.device, self.threads = heightfield, resolve_device(None), resolve_threads(threads)
        surface = prepare_surface(meshes.tube(segments_along=128, segments_around=64))
        view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=width, height=width * 3 // 4)
        frame, window = Picture(surface, view, device=self.device, threads=self.threads), wd.Coherence()
        light = wd.DirectionalLight((0.1, 0.9, 1.2))
        frame.set_lights(lobes_of(light), window, 1.0, normal=reflectance_factors.normal_reflectance(1.5))
        frame.measure_directions(heightfield, window)
        self.all = frame.directions()
        self._choose(pixels)

    def more(self, pixels: int) -> Frame:
        """Return the same frame with a larger sample, to be timed."""
        result = copy.copy(self)
        result._choose(pixels)
        return result

    def _choose(self, pixels: int) -> None:
        """Choose a stratified sample of the illuminated pixels, in the order of the frame."""
        illuminated = self.all[2] > 0.0
        chosen = np.sort(reference.stratified(illuminated, pixels))
        self.illuminated, self.count = int(np.count_nonzero(illuminated)), len(chosen)
        self.scattering_vectors, self.to_lights, self.gains = (part[chosen] for part in self.all)
        import warp as wp

        self.on_device = [
            wp.array(self.scattering_vectors, dtype=wp.vec3d, device=self.device),
            wp.array(self.to_lights.astype(np.float32), dtype=wp.vec3f, device=self.device),
            wp.array(self.gains, dtype=wp.float32, device=self.device),
        ]
        self.xyz = wp.zeros(self.count, dtype=wp.vec3f, device=self.device)

    def judge(self, coherence: wd.Coherence) -> None:
        """Compute the reference for a coherence."""
        xyz = reference.colours(self.heightfield, self.scattering_vectors, self.to_lights, coherence, tolerance=TRUTH)
        every, none = np.ones(self.count, dtype=bool), np.zeros(self.count, dtype=bool)
        self.truth = reference.Pixels(self.gains[:, None] * xyz, every, every, none, none)

    def error(self, xyz: Any) -> Any:
        """Return the error of a shaded sample."""
        return reference.picture_error(xyz, self.truth)


class Published:
    """The published algorithm at one setting, ready to shade a frame."""

    def __init__(self, frame: Frame, coherence: wd.Coherence, setting: Setting) -> None:
        self.frame, self._setting, self._powers = frame, setting, coherence.adds_powers
        frequency = float(np.max(np.hypot(frame.all[0][:, 0], frame.all[0][:, 1]))) / 0.38
        self._tables = _tables(frame.heightfield, setting.terms, frequency, centred=setting.centred)
        self._xyz: Any = None

    def shade(self) -> None:
        """Shade the sample."""
        setting, frame = self._setting, self.frame
        self._xyz = numba_published.shade(
            self._tables, frame.scattering_vectors, frame.gains, wavelengths=setting.wavelengths,
            neighbour_extent=setting.neighbour_extent, rounded=setting.rounded, powers=self._powers,
        )  # fmt: skip

    @property
    def xyz(self) -> Any:
        """What was shaded last."""
        return self._xyz


@functools.lru_cache(maxsize=3)
def _tables(heightfield: wd.HeightField, terms: int, frequency: float, *, centred: bool) -> numba_published.Tables:
    """Return the tables of a series; they serve both kinds of coherence."""
    return numba_published.tables(heightfield, terms=terms, centred=centred, frequency=frequency)


class Automatic:
    """The automatic plan for a tolerance, ready to shade a frame."""

    def __init__(self, frame: Frame, coherence: wd.Coherence, tolerance: float) -> None:
        self.frame, self.tolerance = frame, tolerance
        heightfield, (scattering_vectors, to_lights, gains) = frame.heightfield, frame.all
        direction_range = DirectionRange.of(heightfield, coherence, scattering_vectors, to_lights, gains > 0.0)
        begin = time.perf_counter()
        settings = PlanSettings(tolerance=tolerance, coherence=coherence, threads=frame.threads)
        evaluation = Evaluation.of(heightfield, settings)
        sample = DirectionSample.among(scattering_vectors, to_lights, gains)
        self.plan = strategy.plan_for(evaluation, direction_range, sample, float(frame.illuminated))
        self.seconds = time.perf_counter() - begin
        self._lookup = ColourLookup(heightfield, self.plan, direction_range, device=frame.device, threads=frame.threads)

    def shade(self) -> None:
        """Shade the sample."""
        self.frame.xyz.zero_()
        self._lookup.accumulate(*self.frame.on_device, IlluminatedMaterial("D65"), self.frame.xyz, slice_size=SLICE)

    def with_frame(self, frame: Frame) -> Automatic:
        """Return the same plan for other pixels of the frame."""
        result = copy.copy(self)
        result.frame = frame
        return result

    @property
    def xyz(self) -> Any:
        """What was shaded last."""
        return self.frame.xyz.numpy()

    def __str__(self) -> str:
        plan = self.plan
        how = (
            f"a table of {plan.rings_per_octave} rings per octave"
            if plan.rings_per_octave
            else f"up to {plan.wavelengths} λ"
        )
        return f"tolerance {self.tolerance:.2g}: {plan.method}, {plan.terms} terms, {how}"


def seconds_of(shaders: dict[str, Any], rounds: int) -> dict[str, float]:
    """Return the median wall-clock time of each shader, interleaved."""
    seconds: dict[str, list[float]] = {name: [] for name in shaders}
    for _ in range(rounds + 1):
        for name, shader in shaders.items():
            begin = time.perf_counter()
            shader.shade()
            seconds[name].append(time.perf_counter() - begin)
    return {name: float(np.median(times[1:])) for name, times in seconds.items()}


def error_of(shader: Any) -> Any:
    """Return the error of a shader."""
    shader.shade()
    return shader.frame.error(shader.xyz)


def refined(frame: Frame, coherence: wd.Coherence, target: float) -> tuple[list[Setting], float]:
    """Return the settings with the fewest multiply-adds that reach an error, also as published, and the least error.

    The error falls with each of the numbers, all else equal. For heights centred and not centred, the two smallest
    numbers of terms are taken that reach it with the most neighbours and wavelengths, and the published number. With
    these, for every number of neighbours that reaches it with the most wavelengths, the fewest wavelengths are taken.
    """
    successes: list[Setting] = []
    errors: list[float] = []

    def error(setting: Setting) -> float:
        p99 = float(error_of(Published(frame, coherence, setting)).p99)
        errors.append(p99 if math.isfinite(p99) else math.inf)
        return errors[-1]

    most = MOST_REACH[coherence.kind]
    for centred in (False, True):
        finest = Setting(MORE_WAVELENGTHS[-1], TERMS, most, centred)
        enough: list[int] = []
        for terms in MORE_TERMS:
            if len(enough) < 2 and error(finest._replace(terms=terms)) <= target:
                enough.append(terms)
        if not centred and TERMS not in enough:
            enough.append(TERMS)
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
    return list(dict.fromkeys(successes[:FINALISTS] + as_published)), min(errors)


def compare(frame: Frame, coherence: wd.Coherence, *, tolerance: float, rounds: int, timed: int) -> None:
    """Measure and time all settings of a coherence, and print their table and the four numbers."""
    frame.judge(coherence)
    print(f"\n{coherence}, {frame.count} of {frame.illuminated} illuminated pixels\n", flush=True)
    published = str(Setting())
    chosen = Automatic(frame, coherence, tolerance)
    plans = {str(chosen): chosen}
    for other in TOLERANCES:
        automatic = Automatic(frame, coherence, other)
        plans.setdefault(str(automatic), automatic)
    target = float(error_of(chosen).p99)
    sufficient, least = refined(frame, coherence, target)
    settings = [Setting(), Setting(rounded=True), Setting(centred=True), *sufficient]
    published_shaders: dict[str, Any] = {str(setting): Published(frame, coherence, setting) for setting in settings}
    errors = {name: error_of(shader) for name, shader in (published_shaders | plans).items()}
    many = frame.more(timed)
    timed_shaders: dict[str, Any] = {str(setting): Published(many, coherence, setting) for setting in settings}
    timed_shaders |= {name: plan.with_frame(many) for name, plan in plans.items()}
    seconds = seconds_of(timed_shaders, rounds)

    def us(name: str) -> float:
        return 1e6 * seconds[name] / many.count

    print("| setting | median | P99 | P99 below f, in f | µs per pixel |")
    print("| --- | --- | --- | --- | --- |")
    for name, error in errors.items():
        print(f"| {name} | {error.median:.1e} | {error.p99:.1e} | {error.below:.1e} | {us(name):.2f} |")

    print(f"\nPlanning at {tolerance:g} took {chosen.seconds:.2f} s, which the times exclude.")
    cheap = [name for name in plans if us(name) <= us(published)]
    print("\nEqual cost:", end=" ")
    print(f"published {errors[published].p99:.1e} at {us(published):.2f} µs (1);", end=" ")
    if cheap:
        best = min(cheap, key=lambda name: errors[name].p99)
        ratio = errors[published].p99 / errors[best].p99
        print(f"automatic {errors[best].p99:.1e} at {us(best):.2f} µs (2): {ratio:.0f} times less error, target 10.")
    else:
        best = min(plans, key=us)
        ratio = errors[published].p99 / errors[best].p99
        times = us(best) / us(published)
        print(
            f"no automatic plan is as cheap, the cheapest is {errors[best].p99:.1e} at {us(best):.2f} µs (2): "
            f"{ratio:.0f} times less error at {times:.1f} times the cost. The target is missed."
        )
    print(f"Equal error: automatic at {tolerance:g} {target:.1e} at {us(str(chosen)):.2f} µs (3);")
    for label, which in (
        ("refined with its terms", [setting for setting in sufficient if setting.as_published]),
        ("refined at the lowest cost", sufficient),
    ):
        if not which:
            print(f"- published {label}: does not reach it; the least error is {least:.1e}.")
            continue
        cheapest = min(map(str, which), key=us)
        ratio = us(cheapest) / us(str(chosen))
        verdict = "target 10" if ratio >= 10.0 else "target 10, missed"
        print(f"- published {label} to {cheapest}: {us(cheapest):.2f} µs (4), {ratio:.1f} times, {verdict}.")
    sys.stdout.flush()


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pixels", type=int, default=2000, help="stratified random pixels to evaluate (2000)")
    parser.add_argument("--timed", type=int, default=12_000, help="stratified random pixels to time (12000)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument("--width", type=int, default=640, help="width of the picture; 4:3 (640)")
    parser.add_argument("--tolerance", type=float, default=1e-2, help="tolerance of the automatic choice (1e-2)")
    parser.add_argument("--kinds", nargs="+", choices=list(MOST_REACH), default=list(MOST_REACH), metavar="KIND")
    parser.add_argument("--rounds", type=int, default=9, help="timed rounds (9)")
    parser.add_argument("--threads", type=int, help="threads on the CPU (default: one per core)")
    options = parser.parse_args()
    scan = inputs.levelled_scan(options.data)
    if scan is None:
        raise SystemExit("the comparison requires the scan: name its folder by --data")
    frame = Frame(scan, pixels=options.pixels, width=options.width, threads=options.threads)
    for kind in options.kinds:
        compare(frame, wd.Coherence(kind), tolerance=options.tolerance, rounds=options.rounds, timed=options.timed)


if __name__ == "__main__":
    main()
