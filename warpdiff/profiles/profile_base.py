"""``Profile``: base class of surfaces whose heights or vertices depend linearly on a few parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.profiles.outline import Outline

    Array = NDArray[np.float64]

# Largest change of the height of a sample or of a polygon's vertex in a fit or a design, from its start value [µm].
# Larger changes would make slopes that are too steep for scalar diffraction.
HEIGHT_MARGIN_UM = 10.0


class Profile(ABC):
    """Surface with p parameters: start values, bounds, and the derivatives of the surface by its parameters.

    Attributes:
        names: Names of the parameters, with units, shape (p,).
        start: Start values, shape (p,).
        bounds: Least and largest value of each parameter, shape (p, 2).

    Examples:
        >>> import warpdiff as wd
        >>> profile = wd.profiles.ScanModes(wd.gratings.bumps())
        >>> isinstance(profile, wd.profiles.Profile), profile.bounds[0]
        (True, array([ 0., 10.]))
    """

    def __init__(self, names: tuple[str, ...], start: ArrayLike, bounds: ArrayLike) -> None:
        self.names, self.start = names, np.asarray(start, dtype=np.float64)
        self.bounds = np.asarray(bounds, dtype=np.float64)
        outside = (self.start < self.bounds[:, 0]) | (self.start > self.bounds[:, 1])
        if outside.any():
            k = int(np.flatnonzero(outside)[0])
            low, high = self.bounds[k]
            raise ArgumentValueError(f"{ref(names[k])} must lie within {low:g} to {high:g}, got {self.start[k]:g}")

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value:.6g}" for name, value in zip(self.names[:6], self.start[:6], strict=True))
        return f"{type(self).__name__}({shown}{', …' if len(self.names) > 6 else ''})"

    @property
    @abstractmethod
    def wrt(self) -> tuple[str, ...]:
        """Properties of the surface that depend on the parameters, by name: the argument ``wrt`` in ``wd.adjoint``."""

    @abstractmethod
    def surface(self, x: ArrayLike) -> HeightField | Outline:
        """Return the surface with the parameters ``x``, shape (p,), for the functions of ``warpdiff.adjoint``."""

    @abstractmethod
    def height_field(self, x: ArrayLike) -> HeightField:
        """Return the surface with the parameters ``x``, shape (p,), as a height field for pictures."""

    @abstractmethod
    def pullback(self, x: ArrayLike, adjoints: Mapping[str, Array]) -> Array:
        """Return the adjoints of the parameters, shape (p,), from the adjoints of the surface's heights or vertices.

        The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
        """

    @abstractmethod
    def pushforward(self, x: ArrayLike, dx: ArrayLike) -> dict[str, Array]:
        """Return the changes of the surface's heights or vertices for a change ``dx`` of the parameters, shape (p,)."""

    def equivalents(self, x: Array) -> list[Array]:
        """Return other parameters with equal efficiencies of all orders, which measured efficiencies cannot exclude."""
        del x
        return []

    def check(self, x: ArrayLike) -> Array:
        """Return the parameters ``x`` as an array of shape (p,); raise ``ValueError`` if they have another shape."""
        array = validation.finite_array(x, "x")
        if array.shape != self.start.shape:
            raise ArgumentValueError(
                f"{ref('x')} must have one number per parameter, shape {self.start.shape}, got {array.shape}"
            )
        return array
