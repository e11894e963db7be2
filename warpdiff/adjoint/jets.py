"""``Jet``: values with partial derivatives with respect to a few variables, for formulas of geometry and reflection."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Numbers = NDArray[np.float64]


class Jet:
    """Array of values with their partial derivatives with respect to p variables.

    Arithmetic with jets applies the rules of differentiation.

    Complex values, such as amplitudes of reflection, are possible. For type checkers they count as real, because the
    final results of all formulas are real.

    Attributes:
        value: Values, real or complex, shape (...).
        partials: Partial derivatives with respect to the variables, shape (p, ...).
    """

    # None makes NumPy call the operators of `Jet` for products and sums of a NumPy array with a jet.
    __array_ufunc__ = None

    def __init__(self, value: NDArray[np.inexact], partials: NDArray[np.inexact]) -> None:
        self.value, self.partials = cast("Numbers", value), cast("Numbers", partials)

    @classmethod
    def variables(cls, *values: NDArray[np.float64]) -> list[Jet]:
        """Return one jet per variable, with the derivative 1 with respect to this variable, and 0 for the others.

        All values have one shape.
        """
        count = len(values)
        unit = np.eye(count).reshape(count, count, *(1,) * np.ndim(values[0]))
        return [cls(np.asarray(value), unit[k] + np.zeros(np.shape(value))) for k, value in enumerate(values)]

    def __add__(self, other: Jet | Numbers | complex) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.partials + other.partials)
        return Jet(self.value + other, self.partials + np.zeros(np.shape(other)))

    __radd__ = __add__

    def __neg__(self) -> Jet:
        return self * -1.0

    def __sub__(self, other: Jet | Numbers | complex) -> Jet:
        return self + -1.0 * other

    def __rsub__(self, other: Numbers | complex) -> Jet:
        return -self + other

    def __mul__(self, other: Jet | Numbers | complex) -> Jet:
        if isinstance(other, Jet):
            return Jet(self.value * other.value, self.partials * other.value + self.value * other.partials)
        return Jet(self.value * other, self.partials * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Jet | Numbers | complex) -> Jet:
        return self * (other.power(-1) if isinstance(other, Jet) else 1.0 / other)

    def __rtruediv__(self, other: Numbers | complex) -> Jet:
        return self.power(-1) * other

    def power(self, exponent: float) -> Jet:
        """Return the values raised to a power. For complex values, the result is the principal value."""
        return Jet(self.value**exponent, self.partials * (exponent * self.value ** (exponent - 1)))

    def exp(self) -> Jet:
        """Return e to the power of the values."""
        value = np.exp(self.value)
        return Jet(value, self.partials * value)

    def abs2(self) -> Jet:
        """Return the squared magnitudes, as real numbers."""
        return Jet(np.abs(self.value) ** 2, 2.0 * (np.conj(self.value) * self.partials).real)

    def where(self, condition: NDArray[np.bool_], other: Jet) -> Jet:
        """Return the jet itself where a condition holds, and ``other`` elsewhere."""
        partials = np.where(condition, self.partials, other.partials)
        return Jet(np.where(condition, self.value, other.value), partials)
