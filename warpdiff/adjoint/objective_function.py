"""Function ``objective``: loss as a function of the parameters of a profile, with its gradient, for minimisers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.linearised import Linearised
from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.profiles.profile_base import Profile

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.profiles.outline import Outline


def objective(
    profile: Profile,
    evaluate: Callable[[HeightField | Outline, tuple[str, ...]], Linearised],
    loss: Callable[[NDArray[np.float64]], tuple[float, ArrayLike]],
) -> Callable[[ArrayLike], tuple[float, NDArray[np.float64]]]:
    """Return a function that computes a loss and its gradient from the parameters of a profile.

    Pass the function to a minimiser: ``scipy.optimize.minimize(function, profile.start, jac=True,
    bounds=profile.bounds)``.

    Args:
        profile: Profile from ``warpdiff.profiles``.
        evaluate: Function of a surface and of ``wrt``, the names of variables. It returns a ``Linearised`` value, such
            as the result of ``wd.adjoint.order_efficiencies``.
        loss: Function of this value that returns the loss, and the gradient of the loss with respect to the value.

    Returns:
        Function of p parameters, shape (p,). It returns the loss and the gradient with respect to the parameters, (p,).

    Raises:
        TypeError: ``profile`` is not a profile, or another argument is not a function. The returned function raises
            this error if ``evaluate`` or ``loss`` returns a wrong type. It raises ``ValueError`` if the result of
            ``evaluate`` has no derivatives with respect to ``wrt``.

    Examples:
        >>> import math
        >>> import numpy as np
        >>> from scipy.optimize import minimize
        >>> import warpdiff as wd
        >>> profile = wd.profiles.Trapezoid(depth_um=0.1, duty=0.5, wall=0.02, period_um=2.0)
        >>> def orders(surface, wrt):
        ...     return wd.adjoint.order_efficiencies(surface, (0, 0, 1), 550.0, wrt=wrt, ior=math.inf)
        >>> def power_of_order_0(value):
        ...     is_order_0 = np.arange(value.size) == value.size // 2
        ...     return value[0, is_order_0][0], 1.0 * is_order_0[None]
        >>> function = wd.adjoint.objective(profile, orders, power_of_order_0)
        >>> best = minimize(function, profile.start, jac=True, bounds=profile.bounds)
        >>> print(f"order 0 falls from {function(profile.start)[0]:.2f} to {best.fun:.4f}")
        order 0 falls from 0.18 to 0.0000
    """
    validation.instance(profile, Profile, "profile")
    for name, value in (("evaluate", evaluate), ("loss", loss)):
        if not callable(value):
            raise ArgumentTypeError(f"{ref(name)} must be a function, got {type(value).__name__}")

    def function(x: ArrayLike) -> tuple[float, NDArray[np.float64]]:
        parameters = profile.check(x)
        result = evaluate(profile.surface(parameters), profile.wrt)
        if not isinstance(result, Linearised):
            raise ArgumentTypeError(
                f"{ref('evaluate')} must return a result of wd.adjoint, such as wd.adjoint.reflectance(surface, …, "
                f"wrt=wrt), got {type(result).__name__}"
            )
        pair = loss(result.value)
        if not isinstance(pair, (tuple, list)) or len(pair) != 2 or np.ndim(pair[0]) != 0:
            raise ArgumentTypeError(
                f"{ref('loss')} must return a number and its gradient by the value, got {type(pair).__name__}"
                + (f" of {len(pair)} elements" if isinstance(pair, (tuple, list)) else "")
            )
        adjoints = result.vjp(pair[1])
        if missing := [name for name in profile.wrt if name not in adjoints]:
            raise ArgumentValueError(
                f"{ref('evaluate')} must return derivatives by {', '.join(profile.wrt)}, {', '.join(missing)} are "
                "missing: pass its argument wrt to the function of wd.adjoint"
            )
        return float(pair[0]), profile.pullback(parameters, adjoints)

    return function
