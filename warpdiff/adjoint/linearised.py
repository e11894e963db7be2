"""``Linearised``: a value with its derivatives, in the form of products of the Jacobian matrix with vectors."""

from __future__ import annotations

from collections.abc import Callable  # noqa: TC003 (fields are described at run time)
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref

if TYPE_CHECKING:
    from collections.abc import Mapping

Derivatives = dict[str, NDArray[np.float64]]


class Linearised(NamedTuple):
    """Value of a function with its derivatives at one point; it unpacks as ``value, vjp, jvp``.

    The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.

    Attributes:
        value: The value of the function, float64.
        vjp: Vector-Jacobian product: a function of the adjoint of the value, which has the shape of the value. It
            returns the adjoint of each variable by the name of the variable, in the order of ``wrt``. If the argument
            is the gradient of a loss with respect to the value, the results are the gradients of the loss with respect
            to the variables.
        jvp: Jacobian-vector product: a function of changes of variables, such as ``jvp(sigma_um=0.1)``. It returns the
            change of the value to first order.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> value, vjp, jvp = wd.adjoint.order_efficiencies(grating, (0, 0, 1), 550.0, wrt=("height_scale",))
        >>> slope = vjp([[0, 0, 0, 0, 1, 0, 0]])["height_scale"]
        >>> print(f"order 1: {value[0, 4]:.4f}, {slope:+.4f} per unit of the scale")
        order 1: 0.0095, +0.0126 per unit of the scale
        >>> print(f"{jvp(height_scale=0.01)[0, 4]:+.6f}")
        +0.000126
    """

    value: NDArray[np.float64]
    vjp: Callable[[ArrayLike], Derivatives]
    jvp: Callable[..., NDArray[np.float64]]


def linearised(
    value: NDArray[np.float64],
    shapes: Mapping[str, tuple[int, ...]],
    adjoint: Callable[[NDArray[np.float64]], Derivatives],
    tangent: Callable[[Derivatives], NDArray[np.float64]],
) -> Linearised:
    """Return a linearised value; its ``vjp`` and ``jvp`` check arguments and then call ``adjoint`` and ``tangent``.

    Args:
        value: Value of the differentiated function.
        shapes: Shape of each variable by the name of the variable.
        adjoint: Function that computes the adjoints of all variables from the adjoint of the value.
        tangent: Function that computes the change of the value from changes of some of the variables.
    """

    def vjp(adjoint_of_value: ArrayLike) -> Derivatives:
        array = validation.finite_array(adjoint_of_value, "adjoint_of_value")
        if array.shape != value.shape:
            raise ArgumentValueError(
                f"{ref('adjoint_of_value')} must have the shape of the value, {value.shape}, got {array.shape}"
            )
        adjoints = adjoint(array)
        return {name: adjoints[name].reshape(shape) for name, shape in shapes.items()}

    def jvp(**changes: ArrayLike) -> NDArray[np.float64]:
        checked = {}
        for name, change in changes.items():
            if name not in shapes:
                raise ArgumentTypeError(
                    f"jvp() has no argument {ref(name)}{did_you_mean(name, shapes)}: "
                    f"{ref('wrt')} contains {', '.join(shapes)}"
                )
            array = validation.finite_array(change, name)
            if array.shape != shapes[name]:
                raise ArgumentValueError(f"{ref(name)} must have the shape {shapes[name]}, got {array.shape}")
            checked[name] = array
        return tangent(checked)

    return Linearised(value, vjp, jvp)
