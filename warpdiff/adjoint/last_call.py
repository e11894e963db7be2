"""``LastCall``: stores the last result of a linearised function of arrays, for adapters to JAX and PyTorch.

The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.adjoint.linearised import Linearised

    Arrays = Sequence[NDArray[np.float64]]


class LastCall:
    """Linearised function of arrays that stores its last result. For the same arrays, adjoints reuse this result."""

    def __init__(self, function: Callable[..., Linearised], wrt: Sequence[str], shape: Sequence[int]) -> None:
        """Check and store the arguments of an adapter to JAX or PyTorch.

        Args:
            function: Function of arrays, one per name in ``wrt``. It returns a ``Linearised`` value.
            wrt: Names of the variables, in the order of the arrays.
            shape: Shape of the function's value.
        """
        if not callable(function):
            raise ArgumentTypeError(f"{ref('function')} must be a function, got {type(function).__name__}")
        if isinstance(wrt, str) or not all(isinstance(name, str) for name in wrt):
            raise ArgumentTypeError(f"{ref('wrt')} must be a tuple of names, such as ('heights_um',), got {wrt!r}")
        self.names, self.shape = tuple(wrt), tuple(int(length) for length in shape)
        self._function = function
        self._last: tuple[list[NDArray[np.float64]], Linearised] | None = None

    def check(self, types: Sequence[str], remedy: str) -> None:
        """Raise an error unless there is one float64 array per variable; ``types`` are the types of the arrays."""
        if len(types) != len(self.names):
            raise ArgumentTypeError(
                f"the function takes {len(self.names)} arrays, {', '.join(self.names)}, got {len(types)}"
            )
        for name, kind in zip(self.names, types, strict=True):
            if not kind.endswith("float64"):
                raise ArgumentTypeError(f"{ref(name)} must be float64, got {kind}: {remedy}")

    def value(self, arrays: Arrays) -> NDArray[np.float64]:
        """Return the value of the function for arrays, one per variable."""
        return np.array(self._at(arrays).value)

    def adjoints(self, arrays: Arrays, of_value: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the adjoint of each array (derivative of a scalar loss) from the adjoint of the value."""
        result = self._at(arrays).vjp(of_value)
        return [np.array(result[name]) for name in self.names]

    def _at(self, arrays: Arrays) -> Linearised:
        last = self._last
        if last is not None and all(map(np.array_equal, last[0], arrays)):
            return last[1]
        copies = [np.array(array) for array in arrays]
        result = self._function(*copies)
        if result.value.shape != self.shape:
            raise ArgumentValueError(
                f"{ref('shape')} must be that of the value, {result.value.shape}, got {self.shape}"
            )
        self._last = copies, result
        return result
