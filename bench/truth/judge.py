"""Errors of random calls relative to the float64 reference, on directions that were not used to make their plans.

A plan has the numbers of a computation, such as wavelengths and terms of a series. The planner computes the colours of
some directions of a call with several plans (trials), and selects one plan. A call with fewer directions than
``configurations.FEW`` is evaluated on all illuminated directions. For a larger call, about ``COUNT`` illuminated
directions are sampled, none of which these trials used. If bright directions are rare in the call, they are sampled
more often and have smaller weights.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from __future__ import annotations

import math
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import warpdiff as wd
from bench.suite import scenes
from bench.truth import reference
from bench.truth.configurations import FEW, Configuration
from bench.truth.errors import FLOOR, percentile, reference_luminance
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.planner import trial

if TYPE_CHECKING:
    from collections.abc import Iterator

# Number of illuminated directions on which the errors of a call with many directions are evaluated. The value is
# limited by the computing time of the reference.
COUNT = 2000
# Least number of bright directions in the sample, if the call has that many; a direction is bright if its luminance Y
# is at least the floor f of relative errors. With fewer directions, the 99th percentile of their errors is noisy.
BRIGHT = 600
# The reference is computed with half of this tolerance, or with half of the tolerance of the call if that is smaller.
TRUTH_TOLERANCE = 1e-3
# Least cosine between the normal and the direction to a light source. The value is limited by the reference: nearer to
# the horizon, the foreshortened spread of the source in (u, v) is so narrow that the reference requires half a million
# wavelengths.
LOWEST_SOURCE = 0.02
# Lower limit of the floor f (the smallest divisor of relative errors), as a share of the luminance Y of a mirror. For
# smaller Y the reference does not converge.
LEAST = 1e-10


class Result(NamedTuple):
    """Results of a random call of the library for its illuminated directions.

    ``read`` marks directions on which the planner has tried numbers of wavelengths and terms.
    """

    xyz: np.ndarray  # colours of the directions, shape (n, 3)
    to_light: np.ndarray  # directions to the light, shape (n, 3)
    to_view: np.ndarray  # directions to the viewer, shape (n, 3)
    read: np.ndarray  # whether the planner's trials used the direction, shape (n,)
    plan: wd.Plan
    warned: str

    @property
    def white(self) -> float:
        """Reference luminance Y* of the call, about that of its brightest directions, from the returned colours."""
        return reference_luminance(np.nan_to_num(self.xyz[:, 1].astype(np.float64)), np.ones(len(self.xyz)))


class Figure(NamedTuple):
    """Error of a call: 99th percentiles of relative errors over all, over bright (Y >= f) and over dim directions."""

    overall: float
    bright: float
    dim: float
    share_dim: float
    white: float  # reference luminance Y*
    errors: np.ndarray  # relative error of each direction

    @property
    def value(self) -> float:
        """Error that must not exceed the tolerance: the larger percentile, over all or over bright directions."""
        return max(self.overall, self.bright)


@contextmanager
def witnessed() -> Iterator[list[np.ndarray]]:
    """Record, in the ``with`` block, the scattering vectors for which the planner computes colours to compare plans.

    A plan has the numbers of a computation, such as wavelengths and terms of a series.
    """
    vectors: list[np.ndarray] = []

    class Witness(trial.Trial):
        def __init__(
            self, plan: Any, request: Any, direction_range: Any, sample: Any, *others: Any, **options: Any
        ) -> None:
            vectors.append(sample.scattering_vectors)
            super().__init__(plan, request, direction_range, sample, *others, **options)

    original, trial.Trial = trial.Trial, Witness  # type: ignore[misc]
    try:
        yield vectors
    finally:
        trial.Trial = original  # type: ignore[misc]


def evaluate(case: Configuration, *, threads: int | None = None, strict: bool = True) -> Result:
    """Make the random call that ``case`` describes, by public functions, and return the results of the call."""
    arguments: dict[str, Any] = {
        "tolerance": case.tolerance, "coherence": case.coherence, "material": case.material, "threads": threads,
        "strict": strict,
    }  # fmt: skip
    with witnessed() as planned, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", wd.WarpdiffWarning)
        # Warnings about the limits of scalar diffraction are ignored, because here only errors of the computation are
        # measured.
        warnings.filterwarnings("ignore", "scalar diffraction is", wd.WarpdiffWarning)
        if case.picture is not None:
            picture = case.picture
            image = wd.shade(
                picture.mesh, case.heightfield, picture.light, picture.view, footprint=False, pigment=0.0, **arguments
            )
            directions, illuminated = scenes.directions(
                picture.mesh, picture.light, picture.view, case.heightfield, case.coherence
            )
            xyz, plan = image.xyz.reshape(-1, 3)[illuminated], image.plan
            lights, views = directions.to_lights, -directions.scattering_vectors - directions.to_lights
        elif case.size:
            image = wd.reflectance_map(
                case.heightfield, case.to_light, size=case.size, illuminant=case.illuminant, **arguments
            )
            xyz, plan = image.xyz[image.mask], image.plan
            axis = (2.0 * np.arange(case.size) + 1.0) / case.size - 1.0
            x, y = np.meshgrid(axis, -axis)
            x, y = x[image.mask], y[image.mask]
            views = np.stack([x, y, np.sqrt(1.0 - (x * x + y * y))], axis=1)
            lights = np.broadcast_to(case.to_light, views.shape)
        else:
            operands = case.heightfield, case.to_light, case.to_view
            xyz = wd.reflectance(*operands, illuminant=case.illuminant, **arguments)
            warnings.simplefilter("ignore", wd.WarpdiffWarning)
            plan = wd.plan(*operands, illuminant=case.illuminant, **arguments)
            lights, views = case.to_light, case.to_view
    lowest = LOWEST_SOURCE if case.coherence.kind == "source" else HORIZON
    illuminated = (lights[:, 2] > lowest) & (views[:, 2] > HORIZON)
    scattering_vectors = -(lights + views)[illuminated]
    known = {row.tobytes() for vectors in planned for row in np.round(vectors + 0.0, 9)}
    read = np.array([row.tobytes() in known for row in np.round(scattering_vectors + 0.0, 9)], dtype=bool)
    messages = "; ".join(dict.fromkeys(str(warning.message) for warning in caught))
    return Result(np.asarray(xyz)[illuminated], lights[illuminated], views[illuminated], read, plan, messages)


def sampled(result: Result, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of a random sample of a call's directions, and how many directions each represents."""
    count = len(result.xyz)
    if count < FEW:
        return np.arange(count), np.ones(count)
    luminance = np.nan_to_num(result.xyz[:, 1].astype(np.float64), nan=np.inf, posinf=np.inf)
    bright = luminance >= 0.5 * FLOOR * reference_luminance(
        np.where(np.isinf(luminance), 0.0, luminance), np.ones(count)
    )
    unread = ~result.read
    chosen, weights = [], []
    groups = [np.flatnonzero(unread & bright), np.flatnonzero(unread & ~bright)]
    share = round(COUNT * len(groups[0]) / max(sum(map(len, groups)), 1))
    first = min(max(share, BRIGHT, COUNT - len(groups[1])), len(groups[0]))
    for group, among, most in zip(groups, (bright, ~bright), (first, COUNT - first), strict=True):
        if len(group):
            part = rng.permutation(group)[:most]
            chosen.append(part)
            weights.append(np.full(len(part), np.count_nonzero(among) / max(len(part), 1)))
    return np.concatenate(chosen), np.concatenate(weights)


def truth(case: Configuration, result: Result, chosen: np.ndarray, *, closer: float = 1.0) -> np.ndarray:
    """Return XYZ for the chosen directions of a random call, computed by the float64 reference."""
    tolerance = 0.5 * min(case.tolerance, TRUTH_TOLERANCE) / closer
    return np.asarray(
        reference.reference_reflectance(
            case.heightfield, result.to_light[chosen], result.to_view[chosen], case.coherence, tolerance=tolerance,
            illuminant=case.illuminant, material=case.material,
        )
    )  # fmt: skip


def figure(xyz: np.ndarray, exact: np.ndarray, weights: np.ndarray | None = None, *, white: float = math.inf) -> Figure:
    """Return the error of XYZ (n, 3) relative to the reference ``exact``, for illuminated directions.

    The floor f, the smallest divisor of relative errors, is a share of the reference luminance Y*, and at least
    ``LEAST``. Two values of Y* are known: that of the sampled directions, and that of the whole call, ``white``. The
    smaller value is used, because the sample may contain mirror reflections more often than the call.
    """
    weights = np.ones(len(exact)) if weights is None else weights
    distances = np.linalg.norm(xyz - exact, axis=1)
    distances[~np.isfinite(distances)] = math.inf
    white = min(reference_luminance(exact[:, 1], weights), white)
    floor = max(FLOOR * white, LEAST)
    errors = distances / np.maximum(np.linalg.norm(exact, axis=1), floor)
    above = exact[:, 1] >= floor
    overall, bright, dim = (percentile(errors[group], weights[group], 0.99) for group in (slice(None), above, ~above))
    share_dim = float(weights[~above].sum() / max(weights.sum(), 1e-300))
    return Figure(overall, bright, dim, share_dim, white, errors)
