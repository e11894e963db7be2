"""Designs of foils: a colour for each of two angles, beam splitters, and their errors relative to rigorous solutions.

::

    python -m bench.reproduce.designs --colours       # green at 20°, red at 35°, 8 levels and binary
    python -m bench.reproduce.designs --splitter      # 7 × 7 orders in reflection at 632.8 nm
    python -m bench.reproduce.designs --rigorous-splitters   # 1 × 7 orders on aluminium (extra rigorous)
    python -m bench.reproduce.designs --rigorous-colours     # the two colours on aluminium; minutes per design

A design is a height field of square pixels. ``levels`` is the number of different heights; "binary" means two. Colours
are those of light along the normal on a perfect mirror, with a period of 32 µm, pixels of 0.25 µm and a coherence
window with σ = 16.25 µm. The efficiencies of splitters are normalised: all orders together reflect the whole light. For
designs with 7 × 7 orders, they are computed again with eight samples along each side of a pixel. No phase profile
exceeds the printed upper bound of the efficiency. The bound is the largest ⟨|s|⟩²/⟨|s|²⟩ over the phases of the orders,
where s is a wave that consists of these orders with equal amplitudes (Wyrowski 1991, Krackhardt et al. 1992). Times are
seconds of processor time and of a clock.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings

import numpy as np

import warpdiff as wd

UP = (0.0, 0.0, 1.0)
WAVELENGTH_NM = 632.8
MIRROR = {"ior": math.inf}
# Two colours as CIE x, y and luminance Y, each with the view angle at which it is requested [degrees].
COLOURS = ((0.30, 0.60, 0.55, 20.0), (0.62, 0.335, 0.25, 35.0))
# Sizes of the square height pixels of the beam splitters that are compared with rigorous solutions [wavelengths].
PIXELS = (0.6, 1.2, 2.5, 5.0)


def colour_targets() -> list[wd.Target]:
    """Return the targets of a design: green at 20° and red at 35°."""
    return [
        wd.Target.colour(
            (x / y * luminance, luminance, (1.0 - x - y) / y * luminance), UP, wd.direction(angle), **MIRROR
        )
        for x, y, luminance, angle in COLOURS
    ]


def timed(profile: wd.profiles.Pixels, targets: object, **options: object) -> tuple[wd.Design, str]:
    """Design a height field that reflects the target colours or orders; return it, and a text with computing times."""
    clock, processor = time.perf_counter(), time.process_time()
    result = wd.design(profile, targets, **options)
    return result, f"{time.process_time() - processor:.1f} s processor, {time.perf_counter() - clock:.1f} s clock"


def foil(levels: int, seed: int) -> tuple[wd.Design, str]:
    """Design a foil that is green at 20° and red at 35°; return it, and a text with the computing times."""
    return timed(wd.profiles.Pixels(0.25, np.zeros((1, 128))), colour_targets(), levels=levels, seed=seed)


def colours(seeds: range) -> None:
    """Print colour differences ΔE2000 between designed foils and the requested colours, for 8 and 2 height levels."""
    for levels in (8, 2):
        for seed in seeds:
            result, times = foil(levels, seed)
            text = f"ΔE2000 {result.delta_e.round(2)}, exposure {result.exposure:.1f}, {times}"
            print(f"{levels} levels, seed {seed}: {text}")
    print(result.robustness())


def upper_bound(shape: tuple[int, ...], starts: int = 20, iterations: int = 400) -> float:
    """Return the largest efficiency of a phase profile that diffracts light into orders of equal power.

    ``shape`` is the number of orders along each axis. The phases of the orders are optimised by iteration, from
    ``starts`` sets of random values.
    """
    best, rng, size = 0.0, np.random.default_rng(0), 64
    place = np.ix_(*[np.arange(-(n // 2), n - n // 2) % size for n in shape])
    for _ in range(starts):
        phases = rng.uniform(0.0, 2.0 * np.pi, shape)
        for _ in range(iterations):
            spectrum = np.zeros((size,) * len(shape), dtype=np.complex128)
            spectrum[place] = np.exp(1j * phases)
            wave = np.fft.ifftn(spectrum)
            share = np.abs(wave).mean() ** 2 / (np.abs(wave) ** 2).mean()
            phases = np.angle(np.fft.fftn(np.exp(1j * np.angle(wave)))[place])
        best = max(best, share)
    return best


def splitter(seeds: range) -> None:
    """Print uniformity errors and efficiencies of beam splitters that are designed for 7 × 7 orders of equal power.

    They have 8, unlimited or 2 levels of height.
    """
    orders = [(y, x) for y in range(-3, 4) for x in range(-3, 4)]
    target = wd.Target.equal(orders, UP, WAVELENGTH_NM, **MIRROR)
    print(f"upper bound of the share: 7 × 7 orders {upper_bound((7, 7)):.3f}, 1 × 7 orders {upper_bound((7,)):.3f}")
    for levels in (8, None, 2):
        for seed in seeds:
            result, times = timed(
                wd.profiles.Pixels(0.1, np.zeros((72, 72)), samples=2), target, levels=levels, seed=seed, starts=1
            )
            fine = wd.profiles.Pixels(0.1, np.zeros((72, 72)), samples=8).height_field(result.parameters)
            exact = wd.order_efficiencies(fine, UP, WAVELENGTH_NM, **MIRROR)
            values = np.array([exact[pair][0] for pair in orders])
            uniformity = np.ptp(values) / (values.max() + values.min())
            print(
                f"{levels or 'no'} levels, seed {seed}, one start: uniformity error {uniformity:.4f}, share "
                f"{values.sum() / exact.efficiencies.sum():.3f}, {times}"
            )


def rigorous_splitters(seed: int) -> None:
    """Print uniformity errors of 1 × 7 beam splitters that are designed for a perfect mirror.

    The errors are computed by scalar diffraction for the mirror, and by a rigorous solver for aluminium.
    """
    target = wd.Target.equal([(0, m) for m in range(-3, 4)], UP, WAVELENGTH_NM, **MIRROR)
    for levels in (8, 2):
        for size in PIXELS:
            # Height samples are at most a quarter of a wavelength apart.
            samples = max(4, math.ceil(4.0 * size))
            profile = wd.profiles.Pixels(1e-3 * size * WAVELENGTH_NM, np.zeros((1, 36)), samples=samples)
            result, _ = timed(profile, target, levels=levels, seed=seed)
            start = time.perf_counter()
            check = result.check_rigorously(max_harmonics=512)
            print(
                f"{levels} levels, pixels {size:g} λ: uniformity error scalar {result.uniformity_errors[0]:.3f}, "
                f"rigorous {check.uniformity_errors[0]:.3f}, converged {check.converged:.0%} (change "
                f"{check.change:.1e}), share {result.shares[0]:.3f}, {time.perf_counter() - start:.0f} s"
            )


def rigorous_colours(seeds: range, max_harmonics: int) -> None:
    """Print colour differences ΔE2000 between foils and the requested colours.

    The foils are designed for a perfect mirror. Colours are computed by scalar diffraction for the mirror, and by a
    rigorous solver for aluminium.
    """
    for levels in (2, 8):
        for seed in seeds:
            result, _ = foil(levels, seed)
            start = time.perf_counter()
            check = result.check_rigorously(wavelengths=11, max_harmonics=max_harmonics)
            print(
                f"{levels} levels, seed {seed}: ΔE2000 scalar {result.delta_e.round(2)}, rigorous "
                f"{check.delta_e.round(2)}, converged {check.converged:.0%} (largest change {check.change:.1e}), "
                f"{time.perf_counter() - start:.0f} s",
                flush=True,
            )


def main() -> None:
    """Design foils and beam splitters as the command line options select, and print their errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("--colours", "--splitter", "--rigorous-splitters", "--rigorous-colours"):
        parser.add_argument(name, action="store_true")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--max-harmonics", type=int, default=256, help="of the colours; 512 requires 12 minutes")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    if options.colours:
        colours(seeds)
    if options.splitter:
        splitter(seeds)
    if options.rigorous_splitters:
        rigorous_splitters(options.first_seed)
    if options.rigorous_colours:
        rigorous_colours(seeds, options.max_harmonics)


if __name__ == "__main__":
    main()
