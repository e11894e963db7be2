"""``fit``: parameters of a profile that explain measured data, with standard errors and all equivalent minima.

χ² is the sum of the squared residuals (prediction − measured)/sd, where sd is the standard deviation of a value.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, WarpdiffWarning, ref
from warpdiff.fitting.measured_data import Measured
from warpdiff.plot.axes import axes_for, clean_grid
from warpdiff.profiles.profile_base import Profile

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

# Minima of χ² are listed in the result if their χ² exceeds that of the best minimum by at most this value. The value
# was chosen because a larger difference excludes a minimum by more than two standard deviations of one parameter.
_LISTED_CHI2 = 4.0
# Two minima of χ² count as one minimum if their distance is below this value, in standard errors of the parameters. The
# value must exceed the error of the minimiser, which is a small fraction of a standard error.
_SAME = 0.5
# The minimiser ends if the relative changes of the parameters or of χ² in a step are below the first value, or after
# the second value, its largest number of steps. The number of steps was chosen because a start near a minimum needs
# fewer than 30 steps.
_CHANGE, _MOST_STEPS = 1e-9, 60
# The minimiser ends if the gradient of χ² is at most this value. The gradient is relative to the χ² at the start, and
# each parameter is in units of its range. The value is limited by rounding errors of float64.
_ROUNDING = 2.3e-16
# Largest number of starts of a fit, each with other parameters. The value is limited by the computing time, which is
# proportional to it.
_MOST_STARTS = 1000
# Two minima are equally good if their χ² differs by less than the sum of two tolerances. The result is then the minimum
# of the earlier start. The first tolerance is relative to χ². It must exceed the error of the minimiser. The second
# tolerance is relative to the sum of (value/sd)². It must exceed rounding errors, of which χ² consists if the data have
# no noise. Both are relative, so that a common factor of all standard deviations does not change the best minimum.
_TIE, _TIE_OF_DATA = 1e-6, 1e-12
# The data do not determine a change of the parameters that hardly changes the residuals. Such a change is a singular
# vector of the Jacobian matrix of the residuals with a singular value of at most `_LEAST_SINGULAR` times the largest
# one. If a component of the vector exceeds `_SHARE`, the standard error of that parameter is NaN. Both numbers are
# limited by rounding errors.
_LEAST_SINGULAR, _SHARE = 1e-9, 1e-3
# A fit warns if the measured power in an order that does not propagate exceeds this value, in standard deviations of
# the measurement. The value was chosen because noise exceeds it only once in 16,000 measured values.
_SIGNIFICANT = 4.0
# A report states that the model does not explain the data if χ² per degree of freedom exceeds this value. The value was
# chosen because noise alone exceeds it once in a thousand fits, for ten degrees of freedom.
_BAD_CHI2 = 3.0
# Least distance of a start from a bound of a parameter, relative to the range of the parameter (the difference of both
# bounds). A best value within ten times this distance counts as being at the bound.
_AT_BOUND = 1e-6


@dataclass(frozen=True, eq=False)
class Minimum:
    """Parameters of one minimum of χ² (the sum of squared residuals in standard deviations).

    Attributes:
        values: Parameters, shape (p,).
        chi2: Sum of the squared residuals, each divided by its standard deviation.
        has_converged: Whether the minimiser ended because neither parameters nor χ² changed. Otherwise it reached its
            largest number of steps, and a smaller χ² may exist near these parameters.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> minimum = wd.Minimum(np.array([0.1]), 3.0, has_converged=True)
        >>> minimum.chi2, minimum.has_converged
        (3.0, True)
    """

    values: Array
    chi2: float
    has_converged: bool


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of :func:`warpdiff.fit`.

    Attributes:
        names: Names of the parameters.
        values: Parameters of the best minimum, shape (p,).
        standard_errors: Standard errors of the parameters, shape (p,). NaN for parameters at a bound, and for those
            that the data do not determine within their bounds.
        covariance: Covariance matrix of the parameters, shape (p, p). Parameters at a bound count as constants.
        correlations: Correlation matrix of the parameters, shape (p, p).
        chi2: Sum of the squared residuals, each divided by its standard deviation.
        degrees_of_freedom: Number of measured values minus the number of parameters, at least 0.
        residuals: (prediction − measured)/sd for each of the n measured values, shape (n,).
        minima: All minima whose χ² exceeds that of the best by at most 4, the best first. The data cannot distinguish
            them.
        evaluations: Number of computed predictions with derivatives, summed over all starts.
        at_bounds: Names of the parameters whose best value is at a bound.

    Examples:
        >>> import math
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> grating = wd.profiles.Trapezoid(depth_um=0.14, duty=0.42, wall=0.04, period_um=2.0)
        >>> lights, pairs = np.repeat(wd.direction([10.0, 40.0]), 5, axis=0), [(0, m) for m in (-2, -1, 0, 1, 2)] * 2
        >>> values = wd.Measured.orders(lights, 550.0, pairs, np.zeros(10), ior=math.inf)
        >>> values = values.predict(grating.surface(grating.start)).value + 1e-4 * np.cos(np.arange(10.0))
        >>> measured = wd.Measured.orders(lights, 550.0, pairs, values, ior=math.inf)
        >>> print(wd.fit(grating, measured, sd=1e-4, starts=1).report())
        χ² = ... for 6 degrees of freedom
        depth_um   0.1... ± ...
        duty       0.4... ± ...
        wall       0.0... ± ...
        period_um  ... ± ...
        ...
    """

    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    covariance: Array
    correlations: Array
    chi2: float
    degrees_of_freedom: int
    residuals: Array
    minima: tuple[Minimum, ...]
    evaluations: int
    at_bounds: tuple[str, ...]

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value:.4g}" for name, value in zip(self.names[:6], self.values[:6], strict=True))
        return f"Fit({shown}; χ² = {self.chi2:.3g} for {self.degrees_of_freedom} degrees of freedom)"

    def report(self) -> str:
        """Return parameters, standard errors, correlations, and other minima that the data cannot exclude, as text."""
        lines = [f"χ² = {self.chi2:.4g} for {self.degrees_of_freedom} degrees of freedom"]
        if not self.minima[0].has_converged:
            lines.append("the minimiser has not converged")
        if self.chi2 > _BAD_CHI2 * max(self.degrees_of_freedom, 1):
            lines.append("the model does not explain the data, or sd is too small: standard errors are too small")
        width = max(len(name) for name in self.names)
        for name, value, error in zip(self.names, self.values, self.standard_errors, strict=True):
            text = "not determined" if math.isnan(error) else f"± {error:.2g}"
            text = "at a bound" if name in self.at_bounds else text
            lines.append(f"{name:<{width}}  {value:.6g} {text}")
        for i, j in zip(*np.triu_indices(len(self.names), 1), strict=True):
            if abs(self.correlations[i, j]) >= 0.5:
                lines.append(f"correlation of {self.names[i]} and {self.names[j]}: {self.correlations[i, j]:+.2f}")
        for minimum in self.minima[1:]:
            values = ", ".join(f"{name} = {value:.4g}" for name, value in zip(self.names, minimum.values, strict=True))
            state = "" if minimum.has_converged else " (not converged)"
            lines.append(f"equivalent minimum{state}, χ² = {minimum.chi2:.4g}: {values}")
        return "\n".join(lines)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot the residuals, in standard deviations, against the index of the measured value.

        Args:
            ax: Matplotlib axes to draw into; None makes a figure.
        """
        axes = axes_for(ax, width=6.0, height=3.0)
        for level in (-2.0, 0.0, 2.0):
            axes.axhline(level, color="0.7", linewidth=0.8, zorder=0)
        axes.plot(np.arange(len(self.residuals)), self.residuals, "o", markersize=4)
        axes.set_xlabel("measured value")
        axes.set_ylabel("residual [standard deviations]")
        clean_grid(axes)
        return axes


class _Problem:
    """Residuals of a fit and their Jacobian matrix; the results for the most recent parameters are stored for reuse.

    Attributes:
        data_size: Sum of the squares of the data, each divided by its standard deviation.
        evaluations: Number of computed predictions.
    """

    def __init__(self, profile: Profile, measured: Measured, sd: Array) -> None:
        self._profile, self._measured, self._sd = profile, measured, sd
        self._last: Array | None = None
        self.data_size = float(np.sum((measured.values / sd) ** 2))
        self.evaluations = 0

    def forget(self) -> None:
        """Delete the stored results, so that the next evaluation computes them again and issues its warnings."""
        self._last = None

    def residuals(self, x: Array) -> Array:
        """Return the residuals (prediction − measured)/sd for the parameters ``x``, shape (n,)."""
        self._evaluate(x)
        return self._residuals

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the n residuals with respect to the p parameters, shape (n, p)."""
        self._evaluate(x)
        columns = [
            self._result.jvp(**self._profile.pushforward(x, direction)) / self._sd for direction in np.eye(len(x))
        ]
        return np.stack(columns, axis=1)

    def warn_of_evanescent_orders(self, x: Array) -> None:
        """Warn if power was measured in orders that do not propagate, and whose prediction is therefore 0."""
        self._evaluate(x)
        is_dark = (self._result.value == 0.0) & (np.abs(self._residuals) > _SIGNIFICANT)
        if self._measured.kind == "orders" and is_dark.any():
            warn(
                f"{np.count_nonzero(is_dark)} of {len(is_dark)} measured orders do not propagate, such as value "
                f"{np.flatnonzero(is_dark)[0]}, so that their prediction is 0: check that {ref('orders')} are pairs "
                "(m_y, m_x), and the period of the profile"
            )

    def _evaluate(self, x: Array) -> None:
        if self._last is None or not np.array_equal(x, self._last):
            self._result = self._measured.predict(self._profile.surface(x), self._profile.wrt)
            self._residuals = (self._result.value - self._measured.values) / self._sd
            self._last = x.copy()
            self.evaluations += 1


@single_threaded_blas()
def fit(
    profile: Profile, measured: Measured, *, sd: ArrayLike, starts: int = 8, seed: int = 0, progress: Progress = None
) -> Fit:
    """Fit the parameters of a profile to measured orders, spectra or colours.

    The residuals are minimised by least squares with exact Jacobian matrices, from several starts. The method is the
    trust region method of Branch, Coleman and Li (1999), as in SciPy. The first start is that of the profile, and the
    other starts are random within the bounds of the parameters. With more than one start, the fit also starts from
    parameters that are equivalent to the best ones, if the profile states such parameters.

    Args:
        profile: Profile from ``warpdiff.profiles``, with start values and bounds.
        measured: Measured values with their geometry and optics.
        sd: Standard deviation of the measured values, more than 0, one number or shape (n,). A common factor of all
            standard deviations does not change the best parameters; it changes only their standard errors and χ².
        starts: Number of starts, 1 to 1000, by default 8.
        seed: Seed of the random starts, by default 0.
        progress: Function that is called with the finished fraction, 0 to 1; True shows a progress bar.

    Returns:
        Parameters with standard errors, correlations, χ², residuals and all equivalent minima.

    Warns:
        WarpdiffWarning: The best minimum has not converged, parameters are at a bound, the data do not determine
            parameters, there are fewer values than parameters, or measured orders do not propagate.

    Raises:
        TypeError: An argument has a wrong type.
        ValueError: ``sd`` is not positive or has a wrong shape, or bounds of the profile are equal.

    Examples:
        >>> import math
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> true = wd.profiles.Trapezoid(depth_um=0.14, duty=0.42, wall=0.04, period_um=2.0)
        >>> light, orders = wd.direction([10.0, 40.0]), [(0, m) for m in (-2, -1, 0, 1, 2)]
        >>> lights, pairs = np.repeat(light, 5, axis=0), np.tile(orders, (2, 1))
        >>> made = wd.Measured.orders(lights, 550.0, pairs, np.zeros(10), ior=math.inf)
        >>> values = made.predict(true.surface(true.start)).value
        >>> measured = wd.Measured.orders(lights, 550.0, pairs, values, ior=math.inf)
        >>> guess = wd.profiles.Trapezoid(depth_um=0.12, duty=0.45, wall=0.03, period_um=2.0)
        >>> result = wd.fit(guess, measured, sd=1e-3, starts=2)
        >>> result.values.round(3)
        array([0.14, 0.42, 0.04, 2.  ])
        >>> [round(float(minimum.values[1]), 2) for minimum in result.minima]
        [0.42, 0.58]
    """
    validation.instance(profile, Profile, "profile")
    validation.instance(measured, Measured, "measured")
    count, parameters = len(measured.values), len(profile.start)
    deviations = validation.finite_array(sd, "sd")
    if deviations.shape not in ((), (1,), (count,)):
        raise ArgumentValueError(
            f"{ref('sd')} must be one number or one per measured value, shape ({count},), got shape {deviations.shape}"
        )
    if deviations.min() < validation.LEAST:
        raise ArgumentValueError(
            f"{ref('sd')} must be more than 0, at least {validation.LEAST:g}, got {deviations.min():g}: give the "
            "standard deviation of each measured value"
        )
    if count < parameters:
        warn(
            f"{ref('measured')} has {count} values for {parameters} parameters, which they cannot determine: measure "
            "other angles or wavelengths, or take a profile with fewer parameters"
        )
    report = reporter(progress, "fit")
    rng = np.random.default_rng(validation.count(seed, "seed", least=0))
    low, high = profile.bounds.T
    if np.any(low >= high):
        k = int(np.argmax(low >= high))
        raise ArgumentValueError(
            f"{ref('profile')} must have lower bounds below the upper ones, got {low[k]:g} to {high[k]:g} for "
            f"{profile.names[k]}: widen its bounds, or remove the parameter"
        )
    points = [profile.start]
    points += [rng.uniform(low, high) for _ in range(validation.count(starts, "starts", most=_MOST_STARTS) - 1)]
    problem = _Problem(profile, measured, np.broadcast_to(deviations, (count,)))
    minima: list[Minimum] = []
    for k, point in enumerate(points):
        minima.append(_minimum(problem, point, profile.bounds))
        if report is not None:
            report((k + 1.0) / (len(points) + 1.0))
    best = _best(minima, problem.data_size)
    if len(points) > 1:
        others = profile.equivalents(best.values)
        minima.extend(_minimum(problem, np.clip(other, low, high), profile.bounds) for other in others)
    return _result(profile, problem, minima, report)


def _minimum(problem: _Problem, start: Array, bounds: Array) -> Minimum:
    from scipy.optimize import least_squares

    low, high = bounds.T
    inside = np.clip(start, low + _AT_BOUND * (high - low), high - _AT_BOUND * (high - low))
    with warnings.catch_warnings():
        # Warnings about start and intermediate parameters, such as an order at the horizon, do not concern the result.
        warnings.simplefilter("ignore", WarpdiffWarning)
        # The residuals are divided by their norm at the start, so that the tolerances of the minimiser have the same
        # meaning for all data.
        size = float(np.linalg.norm(problem.residuals(inside))) or 1.0
        result = least_squares(
            lambda x: problem.residuals(x) / size, inside, lambda x: problem.jacobian(x) / size, bounds=(low, high),
            x_scale=high - low, xtol=_CHANGE, ftol=_CHANGE, gtol=_ROUNDING, max_nfev=_MOST_STEPS,
        )  # fmt: skip
    return Minimum(np.asarray(result.x), float(2.0 * result.cost) * size**2, has_converged=bool(result.status > 0))


def _best(minima: list[Minimum], data_size: float) -> Minimum:
    """Return the minimum with the smallest χ²; among equally good minima, return that of the earliest start.

    ``data_size`` is the sum of the squares of the data, each divided by its standard deviation.
    """
    least = min(minimum.chi2 for minimum in minima)
    most = least + _TIE * least + _TIE_OF_DATA * data_size
    return next(minimum for minimum in minima if minimum.chi2 <= most)


def _result(profile: Profile, problem: _Problem, minima: list[Minimum], report: Callable[[float], None] | None) -> Fit:
    """Return the result of a fit: the best minimum of χ² with its covariance, and other minima nearly as good."""
    best = _best(minima, problem.data_size)
    problem.forget()
    jacobian, residuals = problem.jacobian(best.values), problem.residuals(best.values)
    problem.warn_of_evanescent_orders(best.values)
    low, high = profile.bounds.T
    margin = _AT_BOUND * 10.0 * (high - low)
    is_free = (best.values > low + margin) & (best.values < high - margin)
    covariance = np.full((len(low), len(low)), np.nan)
    ranges = (high - low)[is_free]
    covariance[np.ix_(is_free, is_free)] = _covariance(jacobian[:, is_free] * ranges) * np.outer(ranges, ranges)
    errors = np.sqrt(np.diag(covariance))
    # If a standard error exceeds the distance between both bounds of a parameter, the data say less about the parameter
    # than the bounds do.
    beyond = errors > high - low
    covariance[beyond] = covariance[:, beyond] = errors[beyond] = np.nan
    names = np.array(profile.names)
    at_bounds = tuple(names[~is_free].tolist())
    _warn_of_result(best, at_bounds, names[is_free & np.isnan(errors)].tolist())
    distinct: list[Minimum] = []
    scale = np.where(np.isnan(errors), high - low, errors)
    for minimum in [best, *sorted(minima, key=lambda minimum: minimum.chi2)]:
        is_known = any(np.all(np.abs(minimum.values - other.values) <= _SAME * scale) for other in distinct)
        if minimum.chi2 <= best.chi2 + _LISTED_CHI2 and not is_known:
            distinct.append(minimum)
    if report is not None:
        report(1.0)
    return Fit(
        profile.names, best.values, errors, covariance, covariance / np.outer(errors, errors), best.chi2,
        max(len(residuals) - len(best.values), 0), residuals, tuple(distinct), problem.evaluations, at_bounds,
    )  # fmt: skip


def _covariance(jacobian: Array) -> Array:
    """Return the covariance matrix of parameters, shape (p, p); NaN for parameters that the data do not determine."""
    count = jacobian.shape[1]
    _, values, rows = np.linalg.svd(jacobian, full_matrices=len(jacobian) < count)
    singular = np.zeros(count)
    singular[: len(values)] = values
    is_weak = singular <= _LEAST_SINGULAR * singular.max(initial=0.0)
    undetermined = np.any(np.abs(rows[is_weak]) > _SHARE, axis=0)
    result = (rows[~is_weak].T / singular[~is_weak] ** 2) @ rows[~is_weak]
    result[undetermined] = result[:, undetermined] = np.nan
    return np.asarray(result)


def _warn_of_result(best: Minimum, at_bounds: tuple[str, ...], undetermined: list[str]) -> None:
    """Warn if the best parameters of a fit or their standard errors are not reliable, and state why."""
    if not best.has_converged:
        warn(
            f"the best minimum has not converged in {_MOST_STEPS} steps, χ² = {best.chi2:.3g}: increase "
            f"{ref('starts')}, start nearer to the solution, or take a profile with fewer parameters"
        )
    if at_bounds:
        warn(
            f"the best {_listed(at_bounds)} is at a bound of {ref('profile')}, so that its standard error is NaN and "
            "others are those for a constant: change the start values, from which the bounds follow"
        )
    if undetermined:
        warn(
            f"{ref('measured')} does not determine {_listed(undetermined)} within the bounds, so that the covariance "
            "is singular and standard errors are NaN: measure other angles or wavelengths, or fit fewer parameters"
        )


def _listed(names: Sequence[str]) -> str:
    """Return names as text: at most six names, and the number of further names."""
    return ", ".join(names[:6]) + (f" and {len(names) - 6} others" if len(names) > 6 else "")
