"""``design``: a surface with requested colours and orders, within limits of manufacture.

Levels are the equally spaced heights that a manufactured pixel may have. A full cycle is the height that changes the
phase of the reflected light by 2π. The exposure is the common factor of all colours.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.core import validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.table import Table
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield.writers.height_levels import MOST_LEVELS
from warpdiff.inverse_design.design_result import Design, make_design
from warpdiff.inverse_design.first_heights import first_heights
from warpdiff.inverse_design.goal import Goal, places_of, silenced
from warpdiff.inverse_design.pixel_exchange import PixelExchange, edge_moves
from warpdiff.inverse_design.targets import Target
from warpdiff.inverse_design.transposition import is_column, transposed_column, transposed_targets
from warpdiff.profiles.profile_base import Profile
from warpdiff.profiles.sampled_profiles import Pixels

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.inverse_design.pixel_exchange import Rule

    Array = NDArray[np.float64]

# Largest number of random starts of the search for a design. The value is limited by the computing time, which is
# proportional to it.
_MOST_STARTS = 1000
# Largest numbers of iterations of the minimiser: for each random start, for the best starts, which are continued, and
# for each weight of the penalty that draws heights of pixels to levels. The first number was chosen because further
# iterations rarely change which starts have the least loss. The second number was chosen because further iterations
# rarely change the loss.
_MOST_FIRST, _MOST_ITERATIONS, _MOST_PENALISED = 60, 300, 50
# Number of earlier gradients that the minimiser L-BFGS-B stores. The value was chosen because more gradients do not
# reduce the number of iterations.
_MEMORY = 20
# Weights of the penalty that draws heights h of pixels to the levels that can be manufactured, in the order of their
# use. The penalty is the mean of sin²(πh/step) over all heights, where step is the distance of two levels. It is 0 if
# all heights are levels. With the last weight, rounding to levels raises the loss so little that changes of single
# pixels make up for it.
_PENALTIES = (10.0, 100.0, 1000.0, 10_000.0)
# Number of random starts of a search that are continued after their first iterations, those with the least loss. The
# value was chosen because the third start hardly ever gives the best design.
_CONTINUED = 2
# If the user states height levels but no depth, the depth of the pixels is adjusted within this range. It is relative
# to the depth at which the levels divide a full cycle of the phase of the reflected light. The best depth is inside the
# range: the loss is larger at both of its ends.
_DEPTH_RANGE = 0.8, 1.2
# Largest depth of pixels [µm]. The value is limited because scalar diffraction does not describe deeper pixels.
_DEEPEST_UM = 10.0


class Limits(NamedTuple):
    """Limits of manufacture of the pixels of a design.

    Profiles of other classes than `Pixels` have no such limits; their parameters have bounds instead.

    Attributes:
        levels: Number of height levels that a pixel may have; None if the heights are not restricted to levels.
        depths_um: Least and largest depth of the relief [µm].
        feature: Least width of a ridge or a groove [pixels].
    """

    levels: int | None
    depths_um: tuple[float, float]
    feature: int


class _Candidate(NamedTuple):
    """Parameters and loss after one stage of the search, for one random start.

    Attributes:
        start: Index of the random start.
        loss: Loss (weighted sum of all errors) at the parameters.
        x: Parameters of the profile. For pixels, these are heights [µm] of blocks, squares of the least feature width.
        log_exposure: Logarithm of the exposure, the common factor of all colours.
    """

    start: int
    loss: float
    x: Array
    log_exposure: float


@single_threaded_blas()
def design(
    profile: Profile, targets: Sequence[Target], *, levels: int | None = None,
    depth_um: float | tuple[float, float] | None = None, least_feature_um: float | None = None, seed: int = 0,
    starts: int = 6, progress: Progress = None,
) -> Design:  # fmt: skip
    """Find a surface with requested colours and order efficiencies.

    The search has four stages. First heights of pixels come from iterative Fourier transforms (Wyrowski and Bryngdahl
    1988) for orders, and from a sum of waves for colours. L-BFGS-B (Byrd et al. 1995) minimises the loss, which is the
    weighted sum of all errors, with its exact gradient. With ``levels``, a penalty draws the heights of the best starts
    to levels. Then the levels of single pixels are changed, and the depth is adjusted, until no change improves the
    design. Colours are compared in CIE Lab after a multiplication by a common factor, the exposure, which is fitted.
    A term of the loss favours bright designs, which require a small exposure. The theory is scalar: confirm a design
    of one-dimensional pixels by ``check_rigorously()`` of the result.

    Args:
        profile: Profile from ``warpdiff.profiles``. The number and the size of ``Pixels`` determine the period.
        targets: One target or more from ``Target.colour``, ``Target.orders`` and ``Target.equal``.
        levels: Number of equally spaced levels of ``Pixels``, 2 to 256; None, the default, does not restrict heights.
        depth_um: Depth of ``Pixels`` [µm], more than 0 and at most 10, one number or a range (least, largest). With
            ``levels``, it is the height of the highest level, which is adjusted within a range. Without ``levels``, it
            is the largest height, and only the upper end of a range is used. None, the default, is a full cycle of the
            phase; with ``levels``, it is multiplied by 1 − 1/levels and adjusted by up to 20 %.
        least_feature_um: Least width of a feature of ``Pixels`` along x and y [µm], at least the size of a pixel. It is
            rounded up to whole pixels. Features of two-dimensional pixels may touch at corners. None is one pixel.
        seed: Seed of the random starts, by default 0. Equal arguments give equal designs.
        starts: Number of starts, 1 to 1000, by default 6.
        progress: Function that is called with the finished fraction, 0 to 1; True shows a progress bar.

    Returns:
        The height field, with requested and achieved values, history and robustness.

    Warns:
        WarpdiffWarning: Scalar diffraction is invalid for the result.

    Raises:
        TypeError: An argument has a wrong type.
        ValueError: An argument is out of its range, an order does not propagate, or ``levels``, ``depth_um`` or
            ``least_feature_um`` is given for a profile without pixels.

    Examples:
        >>> import math
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> pixels = wd.profiles.Pixels(0.4, np.zeros((1, 24)))
        >>> orders = [(0, m) for m in (-1, 0, 1)]
        >>> target = wd.Target.equal(orders, (0, 0, 1), 632.8, ior=math.inf)
        >>> result = wd.design(pixels, [target], levels=4, starts=2)
        >>> result
        Design(24 pixels of 0.4 µm, 4 levels, depth 0...)
        >>> print(f"share {result.shares[0]:.1f}, uniformity error {result.uniformity_errors[0]:.1f}")
        share 0.8, uniformity error 0.0
    """
    validation.instance(profile, Profile, "profile")
    requested = _checked_targets(targets)
    limits = _limits(profile, requested, levels, depth_um, least_feature_um)
    rng = np.random.default_rng(validation.count(seed, "seed", least=0))
    count = validation.count(starts, "starts", most=_MOST_STARTS)
    report = reporter(progress, "design")
    search = _search_of(profile, requested, limits)
    continued = min(_CONTINUED, count)
    with silenced():
        firsts = []
        for start in range(count):
            firsts.append(search.first(start, rng))
            if report is not None:
                report(len(firsts) / (count + continued + 1.0))
        firsts.sort(key=lambda candidate: candidate.loss)
        results = []
        for candidate in firsts[:continued]:
            refined = search.refined(candidate)
            results.append(search.stepped(refined, rng) if limits.levels else (refined, 0.0))
            if report is not None:
                report((count + len(results)) / (count + continued + 1.0))
        best, depth = min(results, key=lambda pair: pair[0].loss)
    levels_um = depth * np.arange(limits.levels) / (limits.levels - 1) if limits.levels else None
    result = make_design(profile, tuple(requested), best.x, best.log_exposure, levels_um, best.loss, search.history())
    if report is not None:
        report(1.0)
    return result


def _checked_targets(targets: Sequence[Target]) -> list[Target]:
    """Return the targets (requested colours or orders) as a list; raise an error for an empty list or other objects."""
    if not isinstance(targets, (Target, list, tuple)):
        raise ArgumentTypeError(f"{ref('targets')} must be a list of warpdiff.Target, got {type(targets).__name__}")
    result: list[Target] = [targets] if isinstance(targets, Target) else list(targets)
    for k, target in enumerate(result):
        if not isinstance(target, Target):
            raise ArgumentTypeError(f"{ref(f'targets[{k}]')} must be a warpdiff.Target, got {type(target).__name__}")
    if not result:
        raise ArgumentValueError(f"{ref('targets')} must have at least one target, got an empty list")
    return result


def _limits(
    profile: Profile, targets: list[Target], levels: object, depth_um: object, least_feature_um: object
) -> Limits:
    """Return the limits of manufacture, after a check of the arguments of `design`."""
    restricted = {"levels": levels, "depth_um": depth_um, "least_feature_um": least_feature_um}
    if not isinstance(profile, Pixels):
        for name, value in restricted.items():
            if value is not None:
                raise ArgumentValueError(
                    f"{ref(name)} must not be given for a profile of the class {type(profile).__name__}, got "
                    f"{value!r:.40}: only {ref('Pixels')} have levels, and other profiles have {ref('bounds')}"
                )
        return Limits(None, (0.0, 0.0), 1)
    count = None if levels is None else validation.count(levels, "levels", least=2, most=MOST_LEVELS)
    cycle = float(np.mean([target.cycle_um for target in targets]))
    if depth_um is None:
        depth = cycle * (1.0 - 1.0 / count if count else 1.0)
        depths = (_DEPTH_RANGE[0] * depth, _DEPTH_RANGE[1] * depth) if count else (depth, depth)
    elif validation.is_sequence(depth_um):
        depths = validation.pair(depth_um, "depth_um")
        if not depths[0] <= depths[1] <= _DEEPEST_UM:
            raise ArgumentValueError(
                f"{ref('depth_um')} must be a range from a smaller to a larger depth of at most {_DEEPEST_UM:g} µm, "
                f"got {depths}"
            )
    else:
        depth = validation.positive(depth_um, "depth_um", most=_DEEPEST_UM)
        depths = depth, depth
    feature = 1
    if least_feature_um is not None:
        width = validation.positive(least_feature_um, "least_feature_um")
        if width < profile.pixel_um * (1.0 - 1e-9):
            raise ArgumentValueError(
                f"{ref('least_feature_um')} must be at least the size of a pixel, {profile.pixel_um:g} µm, got "
                f"{width:g}: use smaller pixels"
            )
        feature = math.ceil(width / profile.pixel_um - 1e-9)
        ny, nx = profile.pixels
        if any(n > 1 and n % feature for n in (ny, nx)) or max(ny, nx) < feature:
            raise ArgumentValueError(
                f"{ref('least_feature_um')} is {feature} pixels, which must divide the numbers of pixels, {ny} × {nx} "
                f"(y × x), got {width:g} µm: change the number of pixels"
            )
    return Limits(count, depths, feature)


def _search_of(profile: Profile, targets: list[Target], limits: Limits) -> _Search:
    """Return the search for a design. A single column of pixels is searched as a row, with x and y exchanged."""
    surface = profile.surface(profile.start)
    for target in targets:
        if target.kind != "colour":
            places_of(target, surface)
    if isinstance(profile, Pixels) and is_column(profile):
        return _Search(transposed_column(profile), transposed_targets(targets), limits)
    return _Search(profile, targets, limits)


class _Search:
    """Search for a design in stages, with the history of the loss after each stage."""

    def __init__(self, profile: Profile, targets: list[Target], limits: Limits) -> None:
        self._profile, self._targets, self._limits = profile, targets, limits
        self._goal = Goal(targets)
        self._pixels = profile if isinstance(profile, Pixels) else None
        # The search varies the heights of blocks of pixels instead of single pixels. A block is a square with the least
        # width of a feature as its side, so that no feature is narrower.
        self._blocks: Profile = profile
        if self._pixels is not None and limits.feature > 1:
            ny, nx = self._pixels.pixels
            shape = ny // limits.feature if ny > 1 else 1, nx // limits.feature
            samples = self._pixels.samples * limits.feature
            self._blocks = Pixels(self._pixels.pixel_um * limits.feature, np.zeros(shape), samples)
        self._rows: list[tuple[int, str, int, float]] = []

    def history(self) -> Table:
        """Return a table with a row per stage of each random start: number of evaluations of the loss, and the loss."""
        names = ("start", "stage", "evaluations", "loss")
        return Table(dict(zip(names, map(np.array, zip(*self._rows, strict=True)), strict=True)))

    @property
    def _wraps(self) -> bool:
        """Whether heights that differ by a full cycle of the phase are equivalent for all targets (colours or orders).

        The cycle is the height that changes the phase of the reflected light by 2π. Colours have no common cycle,
        because they are sums over wavelengths. With levels, the levels must also divide the cycle, so that the level
        above the highest one would be equivalent to the lowest one. This requires about the default depth.
        """
        if self._pixels is None or self._goal.has_colours:
            return False
        if not self._limits.levels:
            return True
        levels = self._limits.levels
        cycle = float(np.mean([target.cycle_um for target in self._targets]))
        depth = float(np.mean(self._limits.depths_um)) * levels / (levels - 1)
        return _DEPTH_RANGE[0] * cycle <= depth <= _DEPTH_RANGE[1] * cycle

    @property
    def _is_normalised(self) -> bool:
        """Whether a target of the design requests normalised efficiencies, which are scaled to conserve energy."""
        return any(target.optics.energy != "stam" for target in self._targets)

    @property
    def _top_um(self) -> float:
        """Largest height of pixels before heights are rounded to levels [µm].

        If the levels divide a full cycle of the phase (2π), this height is one step above the highest level.
        """
        levels, (_, depth) = self._limits.levels, self._limits.depths_um
        return depth * levels / (levels - 1) if levels and self._wraps else depth

    def first(self, start: int, rng: np.random.Generator) -> _Candidate:
        """Minimise the loss from one random start by at most `_MOST_FIRST` iterations; heights need not be levels."""
        goal, blocks = self._goal, self._blocks
        goal.factors = [np.ones_like(factors) for factors in goal.factors]
        if not isinstance(blocks, Pixels):
            low, high = blocks.bounds.T
            x = blocks.start if start == 0 else rng.uniform(low, high)
            return self._minimised(x, blocks.bounds, start, "first", _MOST_FIRST)
        top, cycle = self._top_um, self._targets[0].cycle_um
        x = first_heights(blocks, self._targets, top, rng)
        if start == 0 and np.ptp(self._profile.start) > 0.0:
            x = np.clip(self._means(self._profile.start), 0.0, top)
        if not self._wraps or top < 0.9 * cycle:
            return self._minimised(x, np.tile([0.0, top], (len(x), 1)), start, "first", _MOST_FIRST)
        free = self._minimised(x, np.tile([-np.inf, np.inf], (len(x), 1)), start, "first", _MOST_FIRST)
        return free._replace(x=np.minimum(free.x % cycle, top))

    def refined(self, candidate: _Candidate) -> _Candidate:
        """Continue the minimisation of the loss from a random start, without height levels.

        If a target requests normalised (energy-conserving) efficiencies, they are normalised here.
        """
        blocks = self._blocks
        bounds = np.tile([0.0, self._top_um], (len(candidate.x), 1)) if isinstance(blocks, Pixels) else blocks.bounds
        most = _MOST_FIRST if self._limits.levels else _MOST_ITERATIONS
        # Factors convert efficiencies of Stam's theory to normalised ones, which conserve energy. They depend on the
        # heights, but a minimisation keeps them constant. A second minimisation therefore follows, with the factors of
        # the heights that the first one found.
        for _ in range(2 if self._is_normalised and not self._limits.levels else 1):
            self._goal.update_factors(blocks.surface(candidate.x))
            candidate = self._minimised(candidate.x, bounds, candidate.start, "refined", most)
        return candidate

    def _means(self, heights: Array) -> Array:
        """Return the mean height of each block of pixels [µm] from the heights of all pixels."""
        assert self._pixels is not None  # noqa: S101 (blocks are pixels)
        ny, nx = self._pixels.pixels
        n = self._limits.feature
        rows = n if ny > 1 else 1
        return np.asarray(heights.reshape(ny // rows, rows, nx // n, n).mean(axis=(1, 3)).ravel())

    def _minimised(
        self, x: Array, bounds: Array, start: int, stage: str, most: int, *, log_exposure: float | None = None,
        penalty: Callable[[Array], tuple[float, Array]] | None = None,
    ) -> _Candidate:  # fmt: skip
        from scipy.optimize import minimize

        goal = self._goal
        function = goal.objective(self._blocks)

        def penalised(z: Array) -> tuple[float, Array]:
            value, gradient = function(z)
            if penalty is not None:
                more, slope = penalty(z[:-1])
                value, gradient = value + more, gradient + np.append(slope, 0.0)
            return value, gradient

        if log_exposure is None:
            log_exposure = goal.best_log_exposure(goal.values(self._blocks.surface(x))[0])
        ends = np.append(bounds, [[-20.0, 40.0] if goal.has_colours else [0.0, 0.0]], axis=0)
        result = minimize(
            penalised, np.append(x, log_exposure), jac=True, method="L-BFGS-B", bounds=ends,
            options={"maxiter": most, "maxcor": _MEMORY},
        )  # fmt: skip
        loss = float(result.fun) if penalty is None else float(function(result.x)[0])
        self._rows.append((start, stage, int(result.nfev), loss))
        return _Candidate(start, loss, result.x[:-1], float(result.x[-1]))

    def stepped(self, candidate: _Candidate, rng: np.random.Generator) -> tuple[_Candidate, float]:
        """Draw pixels to the permitted height levels by a penalty, round them, and change the levels of single pixels.

        Return the result and its depth [µm].
        """
        count, (low, high) = self._limits.levels, self._limits.depths_um
        assert count is not None  # noqa: S101 (called only with levels)
        assert self._pixels is not None  # noqa: S101 (only pixels have levels)
        assert isinstance(self._blocks, Pixels)  # noqa: S101 (the same)
        goal, step = self._goal, 0.5 * (low + high) / (count - 1)
        top = step * (count if self._wraps else count - 1)
        bounds = np.tile([0.0, top], (len(candidate.x), 1))
        goal.update_factors(self._blocks.surface(candidate.x))
        x, log_exposure = np.clip(candidate.x, 0.0, top), candidate.log_exposure
        for weight in _PENALTIES:

            def penalty(heights: Array, weight: float = weight) -> tuple[float, Array]:
                angle = np.pi * heights / step
                slope = weight * np.pi / (step * len(heights)) * np.sin(2.0 * angle)
                return weight * float(np.mean(np.sin(angle) ** 2)), slope

            x, log_exposure = self._minimised(
                x,
                bounds,
                candidate.start,
                f"penalty {weight:g}",
                _MOST_PENALISED,
                log_exposure=log_exposure,
                penalty=penalty,
            )[2:]
        # If the height levels of pixels divide a full cycle of the phase, the level above the highest one is equivalent
        # to the lowest.
        indices = np.rint(x / step).astype(np.int64)
        indices = (indices % count if self._wraps else np.clip(indices, 0, count - 1)).reshape(self._blocks.pixels)
        depth = 0.5 * (low + high)
        rules: list[tuple[Pixels, Rule | None]] = [(self._blocks, None)]
        if self._limits.feature > 1 and self._pixels.pixels[0] == 1:
            rules.append((self._pixels, edge_moves(self._limits.feature)))
        # The search that changes the levels of single pixels keeps the factors from Stam's efficiencies to normalised
        # ones constant, although they depend on the heights. It is therefore repeated with the factors of the new
        # heights.
        if self._is_normalised:
            rules.append(rules[-1])
        for pixels, rule in rules:
            if pixels.pixels != indices.shape:
                indices = np.repeat(indices, self._limits.feature, axis=1)
            goal.update_factors(pixels.surface((depth * indices / (count - 1)).ravel().astype(float)))
            exchange = PixelExchange(goal, pixels, count)
            if exchange.is_affordable:
                indices, depth, log_exposure = exchange.run(indices, log_exposure, (low, high), rng, rule)
            else:
                depth, log_exposure = exchange.best_depth(indices, log_exposure, (low, high))
            values = goal.values(pixels.surface((depth * indices / (count - 1)).ravel()))[0]
            loss = float(goal.costs(values, log_exposure))
            stage = "exchange of pixels" if exchange.is_affordable else "rounding (too many pixels for an exchange)"
            self._rows.append((candidate.start, stage, 0, loss))
        if self._pixels.pixels != indices.shape:
            indices = np.repeat(np.repeat(indices, self._limits.feature, axis=0), self._limits.feature, axis=1)
        heights = (depth * indices / (count - 1)).ravel()
        return _Candidate(candidate.start, loss, heights, log_exposure), depth
