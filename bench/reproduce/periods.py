"""Tests `HeightField.periods` on synthetic fields of known period, on noise, and on the quarters of the real scan.

Each synthetic field is a part of an endless surface whose mean period is known: a sine, a groove with soft walls or a
ridge. The local period of the surface varies at random around the mean. Noise, a tilt, waviness, gaps and steps between
scan lines are added. The search for periods was tuned on other seeds than those below.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import warpdiff as wd
from bench import inputs

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

PITCH_UM = 0.05
# Standard deviations of the local period of the synthetic fields, relative to the mean period.
VARIATIONS = (0.0, 0.003, 0.01, 0.03, 0.06, 0.1)
# First seed of the fields on which the search for periods is tested. The search was tuned on seeds below 30,000.
SEED = 50_000


@dataclass(frozen=True)
class Judged:
    """Synthetic field with its true mean period.

    Attributes:
        heightfield: The field.
        period_um: Mean period of the endless surface of which the field is a part [µm].
        variation: Relative standard deviation of the local period.
    """

    heightfield: wd.HeightField
    period_um: float
    variation: float


def correlated(
    rng: np.random.Generator, shape: tuple[int, int], power: Callable[[NDArray, NDArray], NDArray]
) -> NDArray[np.float64]:
    """Return Gaussian noise of variance 1 with the spectrum ``power``, a function of frequencies in cycles per sample.

    The noise is a part of a larger field, so that opposite edges do not match.
    """
    larger = tuple(1 if n == 1 else 2 * n for n in shape)
    fy, fx = np.fft.fftfreq(larger[0])[:, None], np.fft.rfftfreq(larger[1])[None, :]
    with np.errstate(divide="ignore"):
        amplitude = np.sqrt(power(fy, fx) + 0.0 * (fy + fx))
    amplitude[0, 0] = 0.0
    noise = np.fft.irfft2(np.fft.rfft2(rng.normal(size=larger)) * amplitude, larger)[: shape[0], : shape[1]]
    return np.asarray(noise / np.std(noise))


def _phase(
    rng: np.random.Generator, shape: tuple[int, int], unit: tuple[float, float], length: float, *, walks: bool
) -> NDArray[np.float64]:
    """Return random deviations of the phase of a wave over a height field [rad], with mean 0.

    The derivative of the phase along ``unit``, a unit vector (y, x), has a standard deviation of 1 rad per sample.
    """
    larger = tuple(1 if n == 1 else 4 * n for n in shape)
    fy, fx = np.fft.fftfreq(larger[0])[:, None], np.fft.rfftfreq(larger[1])[None, :]
    squares = fy**2 + fx**2
    with np.errstate(divide="ignore"):
        power = np.exp(-0.5 * (2.0 * np.pi * length) ** 2 * squares) / (squares if walks else 1.0)
    power[0, 0] = 0.0
    spectrum = np.fft.rfft2(rng.normal(size=larger)) * np.sqrt(power)
    derivative = np.fft.irfft2(spectrum * 2j * np.pi * (unit[0] * fy + unit[1] * fx), larger)
    return np.asarray(np.fft.irfft2(spectrum, larger)[: shape[0], : shape[1]] / np.std(derivative))


def wavering(seed: int) -> Judged:
    """Return a synthetic field with a known mean period; every fourth field is a profile of a single row."""
    rng = np.random.default_rng(seed)
    is_profile = seed % 4 == 3
    shape = (1, int(rng.integers(300, 1500))) if is_profile else tuple(rng.integers(100, 300, 2).tolist())
    y, x = np.mgrid[: shape[0], : shape[1]] * PITCH_UM
    period = max(max(shape) * PITCH_UM / rng.uniform(8.0, 40.0), 4.5 * PITCH_UM)
    angle = 0.0 if is_profile else float(rng.choice([0.0, np.pi / 2.0, rng.uniform(-np.pi / 2.0, np.pi / 2.0)]))
    unit = np.sin(angle), np.cos(angle)
    variation = float(rng.choice(VARIATIONS))
    length = rng.uniform(0.5, 2.0) * period / PITCH_UM
    phase = 2.0 * np.pi * (y * unit[0] + x * unit[1]) / period + rng.uniform(0.0, 2.0 * np.pi)
    local = _phase(rng, shape, unit, length, walks=bool(rng.random() < 0.7))
    phase = phase + variation * 2.0 * np.pi * PITCH_UM / period * local
    waves = (np.cos(phase), np.tanh(3.0 * np.sin(phase)), np.exp(np.cos(phase)))
    heights = waves[rng.integers(3)]
    heights = heights / np.std(heights) + rng.choice([0.02, 0.1, 0.3, 1.0]) * rng.normal(size=shape)
    v, u = y / max(float(y.max()), PITCH_UM), x / float(x.max())
    heights += rng.uniform(0.0, 5.0) * u + rng.uniform(0.0, 5.0) * v
    if rng.random() < 0.3:
        heights += rng.uniform(0.3, 3.0) * np.cos(
            2.0 * np.pi * (rng.uniform(0.3, 1.2) * u + rng.uniform(-1.0, 1.0) * v)
        )
    if rng.random() < 0.4:
        heights += rng.uniform(0.05, 0.5) * rng.normal(size=(shape[0], 1))
    if rng.random() < 0.4:
        for _ in range(rng.integers(1, 8)):
            row, column = rng.integers(0, shape[0]), rng.integers(0, shape[1])
            heights[row : row + rng.integers(3, 30), column : column + rng.integers(3, 30)] = np.nan
    heights *= rng.choice([0.02, 0.1])
    return Judged(wd.HeightField.of_known_scale(heights, PITCH_UM), period, variation)


def noise_field(seed: int) -> wd.HeightField:
    """Return a field of noise without a period, of one of ten kinds."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(60, 300, 2).tolist())
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    white, length, angle = rng.normal(size=shape), rng.uniform(1.0, 20.0), rng.uniform(0.0, np.pi)
    exponent = rng.uniform(1.0, 4.0)

    def exponential(fy: NDArray, fx: NDArray) -> NDArray:
        return np.asarray((1.0 + (2.0 * np.pi * length) ** 2 * (fy**2 + fx**2)) ** -1.5)

    def anisotropic(fy: NDArray, fx: NDArray) -> NDArray:
        along, across = fx * np.cos(angle) + fy * np.sin(angle), fy * np.cos(angle) - fx * np.sin(angle)
        return np.asarray((1.0 + (2.0 * np.pi * length) ** 2 * (along**2 + 9.0 * across**2)) ** -1.5)

    def bumps() -> NDArray[np.float64]:
        result, radius = np.zeros(shape), rng.uniform(2.0, 8.0)
        for row, column in rng.uniform(0.0, 1.0, (100, 2)) * shape:
            result += np.exp(-0.5 * ((y - row) ** 2 + (x - column) ** 2) / radius**2)
        return result

    def ground() -> NDArray[np.float64]:
        marks = correlated(rng, (1, 1000), lambda _, fx: 1.0 / (1.0 + (20.0 * fx) ** 2))[0]
        along = x * np.cos(angle) + y * np.sin(angle)
        return np.asarray(np.interp(along - along.min(), np.arange(1000.0), marks) + 0.3 * white)

    def gappy() -> NDArray[np.float64]:
        result = correlated(rng, shape, exponential)
        for _ in range(6):
            row, column = rng.integers(0, shape[0]), rng.integers(0, shape[1])
            result[row : row + 30, column : column + 25] = np.nan
        return result

    kinds: tuple[Callable[[], NDArray], ...] = (
        lambda: white,
        lambda: correlated(rng, shape, lambda fy, fx: np.exp(-0.5 * (2.0 * np.pi * length) ** 2 * (fy**2 + fx**2))),
        lambda: correlated(rng, shape, exponential),
        lambda: correlated(rng, shape, lambda fy, fx: (fy**2 + fx**2) ** (-0.5 * exponent)),
        lambda: correlated(rng, shape, anisotropic),
        ground,
        lambda: white + rng.uniform(0.3, 3.0) * rng.normal(size=(shape[0], 1)),
        bumps,
        lambda: np.round(3.0 * white) + 20.0 * x / shape[1] + 30.0 * (y / shape[0]) ** 2,
        gappy,
    )
    return wd.HeightField.of_known_scale(0.05 * kinds[seed % len(kinds)](), PITCH_UM)


def noise_profile(seed: int) -> wd.HeightField:
    """Return a profile of noise without a period, of one of seven kinds."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(100, 2000))
    white, length, exponent = rng.normal(size=count), rng.uniform(1.0, 30.0), rng.uniform(0.5, 3.0)
    kinds: tuple[Callable[[], NDArray], ...] = (
        lambda: white,
        lambda: correlated(rng, (1, count), lambda _, fx: np.exp(-0.5 * (2.0 * np.pi * length * fx) ** 2))[0],
        lambda: correlated(rng, (1, count), lambda _, fx: 1.0 / (1.0 + (2.0 * np.pi * length * fx) ** 2))[0],
        lambda: np.cumsum(white),
        lambda: correlated(rng, (1, count), lambda _, fx: fx**-exponent)[0],
        lambda: np.cumsum(white * (rng.random(count) < 0.03)),
        lambda: np.sign(np.cumsum(rng.normal(size=count))) + 0.2 * white,
    )
    return wd.HeightField.of_known_scale(0.05 * kinds[seed % len(kinds)]()[None, :], PITCH_UM)


def score(judged: Judged) -> float | None:
    """Return the error of the strongest period found, divided by its standard error; None if no period is found."""
    periods = judged.heightfield.periods(1)
    return (periods[0].period_um - judged.period_um) / periods[0].standard_error_um if periods else None


def quarters(scan: wd.HeightField) -> tuple[list[wd.Period], float]:
    """Return the strongest period of each quarter of a scan, and the largest difference between two of these periods.

    The difference is divided by its standard error.
    """
    half = scan.size_um[0] / 2.0, scan.size_um[1] / 2.0
    periods = [scan.cropped(half, offset_um=(y, x)).periods(1)[0] for y in (0.0, half[0]) for x in (0.0, half[1])]
    differences = [
        abs(a.period_um - b.period_um) / np.hypot(a.standard_error_um, b.standard_error_um)
        for a in periods
        for b in periods
    ]
    return periods, float(max(differences))


def main() -> None:
    """Print the accuracy of the periods found in synthetic fields, false periods in noise, and periods of the scan."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fields", type=int, default=200, help="number of synthetic fields (200)")
    parser.add_argument("--noise", type=int, nargs=2, default=(60, 70), help="fields and profiles of noise (60 70)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"first seed ({SEED})")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    seeds = range(options.seed, options.seed + options.fields)
    rows = [(judged.variation, score(judged)) for judged in map(wavering, seeds)]
    print("| variation of the period | fields | found | within 2 standard errors | rms score |\n" + "| --- " * 5 + "|")
    for variation in (*VARIATIONS, None):
        scores = [value for amount, value in rows if variation in (None, amount)]
        if not scores:
            continue
        found = np.array([value for value in scores if value is not None])
        within = 100.0 * np.mean(np.abs(found) <= 2.0)
        name = "all" if variation is None else f"{100.0 * variation:g} %"
        print(f"| {name} | {len(scores)} | {len(found)} | {within:.1f} % | {np.sqrt(np.mean(found**2)):.2f} |")
    fields = [noise_field(seed) for seed in range(options.seed, options.seed + options.noise[0])]
    profiles = [noise_profile(seed) for seed in range(options.seed, options.seed + options.noise[1])]
    false = sum(bool(field.periods()) for field in fields), sum(bool(profile.periods()) for profile in profiles)
    print(f"\nFalse periods: {false[0]} of {len(fields)} fields, {false[1]} of {len(profiles)} profiles.")
    scan = inputs.scan(options.data)
    if scan is not None:
        periods, largest = quarters(scan)
        print(f"Raw scan: {', '.join(map(str, scan.periods()))}.")
        print(f"Quarters: {', '.join(map(str, periods))}; they differ by at most {largest:.2f} standard errors.")


if __name__ == "__main__":
    main()
