"""Verdicts on scalar diffraction, compared with rigorous solutions: number of gratings with large errors in each grade.

The grade of a verdict is reliable, qualitative or invalid, by the error that it predicts
(``warpdiff.heightfield.theory_verdict``).

::

    python -m bench.reproduce.theory_verdict
    python -m bench.reproduce.theory_verdict --rise

The 748 gratings of ``bench/suite/rigorous.json`` are sines, square grooves and sawteeth of perfect mirrors and sines of
glass. The error of a grating is that of its worst order for light from 0°, 30° and 60°, relative to the reflected power
of a flat surface. The verdict on a grating is the worst verdict that ``order_efficiencies`` returns for the three
angles; the verdict on the heights alone is judged separately. Every third period and every third depth was never used
for fitting. Gratings with such a period or depth are held out.

The energy normalisation gives an order its full weight only if its direction is high enough above the horizon.
``--rise`` compares several limits of this elevation.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from typing import NamedTuple

import numpy as np

import warpdiff as wd
from bench.suite.validity import CASES, GRATINGS, STORED, UNIT, flat_reflectance
from warpdiff.diffraction import energy_normalisation
from warpdiff.heightfield.theory_verdict import INVALID, QUALITATIVE, verdict_on

# Error of an order's efficiency above which its grating counts as wrong, as a share of the reflected power.
WRONG = 0.1
# A verdict grades a grating as reliable, qualitative or invalid for scalar diffraction. These are targets for verdicts,
# as shares of gratings. A grating is wrong if its error exceeds ``WRONG``. `MOST_WRONG` is the largest share of wrong
# gratings among the reliable ones. `LEAST_RELIABLE` is the least share of reliable gratings among those that are not
# wrong. `MOST_QUALITATIVE` is the largest share of qualitative gratings among all.
MOST_WRONG, LEAST_RELIABLE, MOST_QUALITATIVE = 0.02, 0.8, 0.3
# Gratings are held out, so that no fit uses them, if the index of their period or depth, divided by three, leaves this
# remainder.
HELD_OUT = 2
# Number of height samples per period. The value is limited by the number of orders of a grating: it must be well above
# 80, twice the largest number of orders.
SAMPLES = 512
# Wavelength of all calls [nm]. Periods and depths are stored in units of the wavelength; at this wavelength these
# numbers are also their lengths in µm.
WAVELENGTH_NM = 1000.0
# Limits that ``--rise`` compares. A limit is the least cosine of the angle between order and normal for which the
# energy normalisation gives the order its full weight.
RISES = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)


class Grating(NamedTuple):
    """Error of scalar diffraction for one grating, and the errors that the verdicts predict for it.

    Attributes:
        is_held_out: Whether the period or the depth of the grating was never used for fitting.
        error: Largest difference of an order's efficiency from the rigorous efficiency, as a share of the reflected
            power.
        of_calls: Largest error that the verdicts of the calls predict, one call per angle of incidence.
        of_heights: Error that the verdict on the heights alone predicts.
    """

    is_held_out: bool
    error: float
    of_calls: float
    of_heights: float


class Shares(NamedTuple):
    """Counts and shares of gratings by the grade of their verdict: reliable, qualitative or invalid.

    The grade follows from the predicted error of scalar diffraction. Three shares have targets, see ``meets_targets``.
    """

    gratings: int
    reliable: int
    wrong_of_reliable: float
    reliable_of_right: float
    qualitative: float
    wrong_of_invalid: float

    @classmethod
    def of(cls, errors: np.ndarray, verdicts: np.ndarray) -> Shares:
        """Compute counts and shares from the actual errors of gratings and from the errors that verdicts predict."""
        wrong, reliable, invalid = errors > WRONG, verdicts < QUALITATIVE, verdicts >= INVALID
        return cls(
            len(errors), int(reliable.sum()), _share(wrong[reliable]), _share(reliable[~wrong]),
            _share(~reliable & ~invalid), _share(wrong[invalid]),
        )  # fmt: skip

    @property
    def meets_targets(self) -> bool:
        """Whether the shares meet ``MOST_WRONG``, ``LEAST_RELIABLE`` and ``MOST_QUALITATIVE``."""
        return (
            self.wrong_of_reliable <= MOST_WRONG
            and self.reliable_of_right >= LEAST_RELIABLE
            and self.qualitative <= MOST_QUALITATIVE
        )


def _share(values: np.ndarray) -> float:
    """Return the share of array entries that are True, or 0 if the array is empty."""
    return float(np.mean(values)) if len(values) else 0.0


def gratings(energy: str | None, *, step: int = 1) -> list[Grating]:
    """Return errors and verdicts of every ``step``-th grating of each profile, such as sine or sawtooth.

    ``energy`` is passed to `order_efficiencies` as the argument of this name. If it is None, the default applies.
    """
    stored, result = json.loads(STORED.read_text()), []
    for case, (shape, index) in CASES.items():
        rows = iter(stored["cases"][case]["first_order_and_efficiencies"])
        for i, period in enumerate(stored["periods"]):
            for j, depth in enumerate(stored["depths"]):
                of_angles = [next(rows) for _ in stored["angles_deg"]]
                if (i * len(stored["depths"]) + j) % step:
                    continue
                heightfield = GRATINGS[shape](period, depth, samples=SAMPLES)
                errors, verdicts = [], []
                for angle, (first, *efficiencies) in zip(stored["angles_deg"], of_angles, strict=True):
                    theta = math.radians(angle)
                    orders = wd.order_efficiencies(
                        heightfield, (math.sin(theta), 0.0, math.cos(theta)), WAVELENGTH_NM, ior=index or math.inf,
                        energy=energy,
                    )  # fmt: skip
                    flat, ours = flat_reflectance(index, angle)
                    scalar = np.array([orders[0, first + n][0] for n in range(len(efficiencies))]) / ours
                    errors.append(np.max(np.abs(scalar - np.array(efficiencies) * UNIT / flat)))
                    verdicts.append(orders.verdict.error)
                conserves = energy != "stam" and index is None
                alone = verdict_on(heightfield, WAVELENGTH_NM, conserves=conserves).error
                is_held_out = HELD_OUT in (i % 3, j % 3)
                result.append(Grating(is_held_out, float(max(errors)), max(verdicts), alone))
    return result


def judged(energy: str | None, *, step: int = 1) -> dict[str, Shares]:
    """Return counts and shares of gratings by the grade of their verdict, for three sets of gratings.

    The sets are all gratings, those to which the verdicts were fitted, and held-out gratings. The verdicts are those of
    calls of ``order_efficiencies``, and those on the heights alone.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        population = gratings(energy, step=step)
    is_held_out = np.array([grating.is_held_out for grating in population])
    errors = np.array([grating.error for grating in population])
    result = {}
    for of, verdicts in (
        ("calls", np.array([grating.of_calls for grating in population])),
        ("heights", np.array([grating.of_heights for grating in population])),
    ):
        for part, mask in (("all", is_held_out | True), ("fitted", ~is_held_out), ("held out", is_held_out)):
            result[f"{of}, {part}"] = Shares.of(errors[mask], verdicts[mask])
    return result


def mean_error_by_rise(cosine: float) -> float:
    """Return the mean error of the efficiencies of perfect-mirror gratings, with the energy normalisation.

    The normalisation gives full weight to orders if the cosine of their angle from the normal exceeds a limit.
    ``cosine`` replaces this limit. Held-out gratings are excluded.
    """
    before = energy_normalisation.RISEN
    energy_normalisation.RISEN = cosine
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wd.WarpdiffWarning)
            mirrors = gratings("normalised")[: -len(_glass_cells())]
    finally:
        energy_normalisation.RISEN = before
    return float(np.mean([grating.error for grating in mirrors if not grating.is_held_out]))


def _glass_cells() -> list[tuple[float, float]]:
    """Return period and depth of each glass grating; glass gratings are the last kind in ``rigorous.json``."""
    stored = json.loads(STORED.read_text())
    return [(period, depth) for period in stored["periods"] for depth in stored["depths"]]


def main(arguments: list[str] | None = None) -> int:
    """Print the shares of gratings by grade; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rise", action="store_true", help="compare heights of the full weight above the horizon")
    if parser.parse_args(arguments).rise:
        for cosine in RISES:
            print(f"full weight from a cosine of {cosine:g}: mean error {mean_error_by_rise(cosine):.4f}", flush=True)
        return 0
    missed = 0
    print("| energy | verdict of | gratings | reliable | of them wrong | of right ones reliable | qualitative | "
          "invalid ones wrong |\n" + 8 * "| --- " + "|")  # fmt: skip
    for energy in (None, "stam"):
        for name, shares in judged(energy).items():
            missed += not shares.meets_targets
            print(
                f"| {energy or 'default'} | {name} | {shares.gratings} | {shares.reliable} | "
                f"{shares.wrong_of_reliable:.1%} | {shares.reliable_of_right:.0%} | {shares.qualitative:.0%} | "
                f"{shares.wrong_of_invalid:.0%} |{'' if shares.meets_targets else ' MISSED'}",
                flush=True,
            )
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
