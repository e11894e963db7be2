"""Gratings with a few parameters (profiles), whose period is a polygon or a trapezoid.

The positions of walls are exact, and the surface has derivatives with respect to all parameters. The adjoint of a
quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.profiles.outline import Outline
from warpdiff.profiles.profile_base import HEIGHT_MARGIN_UM, Profile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField

    Array = NDArray[np.float64]

# Least and largest period of the grating in a fit, relative to the start value of the period. The range is narrow,
# because fits that start further from the true period end at wrong minima. The measured angle of a diffraction order
# gives a start value within 5 % of the true period.
_PERIOD_RANGE = 0.95, 1.05
# Upper bound of the depth of the grating in a fit, relative to the start value of the depth. The random starts of a fit
# lie between the bounds of the parameters. A factor of 3 was chosen because more of the starts end at wrong minima with
# a larger factor.
_DEPTH_RANGE = 3.0
# Largest rounding error of the position of a polygon's vertex [periods]. Vertices that are out of order, or outside of
# the period, by at most this distance are moved to the nearest valid position.
_ROUNDING = 1e-9
# In a fit, the upper bound of the width of a grating's sloped walls is at least this value [periods]. It is above 0, so
# that a fit that starts from vertical walls (width 0) can make them sloped.
_WIDEST_WALL = 0.05


class _OutlineProfile(Profile):
    """Grating with a polygon as its period; the vertices are linear functions of all parameters except the period."""

    def __init__(
        self, names: tuple[str, ...], start: list[float], bounds: list[list[float]], base: Array, modes: Array,
        period_um: float,
    ) -> None:  # fmt: skip
        """Set the linear function that computes the vertices from the parameters.

        Args:
            names: Names of the parameters except the period.
            start: Start values of these parameters.
            bounds: Smallest and largest values of these parameters.
            base: Positions and heights of the k vertices if all of these parameters are 0, shape (k, 2).
            modes: Derivatives of positions and heights with respect to these parameters, shape (p − 1, k, 2).
            period_um: Start value of the period [µm].
        """
        self._base, self._modes = base, modes
        period = validation.positive(period_um, "period_um")
        limits = [*bounds, [share * period for share in _PERIOD_RANGE]]
        super().__init__((*names, "period_um"), [*start, period], limits)

    @property
    def wrt(self) -> tuple[str, ...]:
        """Names of the properties of the surface that depend on the parameters, as ``warpdiff.adjoint`` names them."""
        return ("vertices", "period_um")

    def surface(self, x: ArrayLike) -> Outline:
        """Return the polygon of the grating for the parameter values ``x``, shape (p,)."""
        values = self.check(x)
        vertices = self._base + np.tensordot(values[:-1], self._modes, axes=1)
        positions = np.clip(vertices[:, 0], 0.0, 1.0)
        positions = np.maximum.accumulate(positions)
        if np.max(np.abs(positions - vertices[:, 0])) > _ROUNDING:
            shown = ", ".join(f"{name} = {value:.4g}" for name, value in zip(self.names[:6], values[:6], strict=True))
            raise ArgumentValueError(
                f"{ref('x')} must give vertices in increasing order within one period, got {shown}: keep within "
                f"{ref('bounds')} of the profile"
            )
        return Outline(positions, vertices[:, 1], float(values[-1]))

    def height_field(self, x: ArrayLike) -> HeightField:
        """Return the grating for the parameter values ``x``, shape (p,), as a height field for pictures."""
        return self.surface(x).height_field()

    def pullback(self, x: ArrayLike, adjoints: Mapping[str, Array]) -> Array:
        """Return the adjoints (derivatives of a loss) of the parameters, from those of the vertices and the period."""
        self.check(x)
        return np.append(np.tensordot(self._modes, adjoints["vertices"], axes=2), adjoints["period_um"])

    def pushforward(self, x: ArrayLike, dx: ArrayLike) -> dict[str, Array]:
        """Return the changes of the vertices and of the period for a change ``dx`` of the parameters, shape (p,)."""
        self.check(x)
        change = self.check(dx)
        return {"vertices": np.tensordot(change[:-1], self._modes, axes=1), "period_um": np.asarray(change[-1])}


class Polygon(_OutlineProfile):
    """Grating whose period is a polygon; the parameters are its vertices, except the first vertex, and the period.

    Each vertex has two parameters, its position and its height. The first vertex is fixed, because a shift of the whole
    polygon changes no efficiency of a diffraction order.

    Args:
        vertices: Start values of positions [periods] and heights [µm], shape (k, 2), in the order of the positions.
        period_um: Start value of the period [µm]; its range is ± 5 %.

    Raises:
        ValueError: Positions are outside of 0 to 1 or decrease, or three of them are equal.

    Examples:
        >>> import warpdiff as wd
        >>> profile = wd.profiles.Polygon([(0.0, 0.0), (0.5, 0.1)], period_um=2.0)
        >>> profile.names
        ('position[1]', 'height_um[1]', 'period_um')
    """

    def __init__(self, vertices: ArrayLike, period_um: float) -> None:
        array = validation.finite_array(vertices, "vertices", ndim=2)
        if array.shape[1] != 2:
            raise ArgumentValueError(f"{ref('vertices')} must have shape (k, 2), got {array.shape}")
        Outline(array[:, 0], array[:, 1], period_um)  # checks positions
        count = len(array)
        names = tuple(f"{name}[{k}]" for k in range(1, count) for name in ("position", "height_um"))
        bounds = []
        for k in range(1, count):
            # The position of each vertex may change by less than half of its distance to the neighbouring vertices, so
            # that the vertices remain in order.
            gaps = np.diff(
                np.concatenate([array[: k + 1, 0][-2:], array[k + 1 : k + 2, 0] if k + 1 < count else [1.0]])
            )
            if not gaps.any():
                raise ArgumentValueError(
                    f"{ref('vertices')} must not have three equal positions, got {array[k, 0]:g} of vertex {k} and of "
                    "both of its neighbours: remove it"
                )
            position, height = array[k]
            bounds += [
                [position - 0.499 * gaps[0], position + 0.499 * gaps[1]],
                [height - HEIGHT_MARGIN_UM, height + HEIGHT_MARGIN_UM],
            ]
        base = np.zeros_like(array)
        base[0] = array[0]
        modes = np.zeros((2 * (count - 1), count, 2))
        modes.reshape(count - 1, 2, count, 2)[np.arange(count - 1), :, np.arange(1, count), :] = np.eye(2)
        super().__init__(names, array[1:].ravel().tolist(), bounds, base, modes, period_um)


class Trapezoid(_OutlineProfile):
    """Lamellar grating with sloped walls: depth, duty cycle, width of a wall and period as parameters.

    Scalar diffraction gives the same efficiencies for a duty cycle and for 1 minus this duty cycle. The method
    ``equivalents`` therefore returns the parameters with the other duty cycle.

    Args:
        depth_um: Start value of the depth [µm], more than 0. Its range is 0 to three times this value.
        duty: Start value of the width of the ridge at half of its height, in periods. Its range is limited so that
            ridge and groove are wider than the widest wall.
        wall: Start value of the width of each wall, in periods. Its range is 0 to twice this value, or 0 to 0.05 if
            this is larger.
        period_um: Start value of the period [µm]; its range is ± 5 %.

    Raises:
        ValueError: A start value is out of its range, or the walls are wider than the ridge or the groove.

    Examples:
        >>> import warpdiff as wd
        >>> profile = wd.profiles.Trapezoid(depth_um=0.14, duty=0.4, wall=0.05, period_um=2.0)
        >>> profile.surface(profile.start).positions
        array([0.275, 0.325, 0.675, 0.725])
        >>> print(profile.height_field(profile.start).shape)
        (1, 1024)
    """

    def __init__(self, depth_um: float, duty: float, wall: float, period_um: float) -> None:
        start = [
            validation.positive(depth_um, "depth_um"), validation.number(duty, "duty"), validation.number(wall, "wall"),
        ]  # fmt: skip
        widest = max(2.0 * start[2], _WIDEST_WALL)
        if not start[2] >= 0.0 or widest > min(start[1], 1.0 - start[1]):
            raise ArgumentValueError(
                f"{ref('wall')} must be at least 0 and at most half of ridge and groove, and {ref('duty')} within "
                f"{_WIDEST_WALL:g} to {1.0 - _WIDEST_WALL:g}, got {start[2]:g} and {start[1]:g}: take a narrower wall"
            )
        base = np.array([[0.5, 0.0]] * 4)
        modes = np.zeros((3, 4, 2))
        modes[0, 1:3, 1] = 1.0
        modes[1, :, 0] = [-0.5, -0.5, 0.5, 0.5]
        modes[2, :, 0] = [-0.5, 0.5, -0.5, 0.5]
        # Ridge and groove are at least as wide as the widest wall, so that the two walls of a ridge never meet.
        bounds = [[0.0, _DEPTH_RANGE * start[0]], [widest, 1.0 - widest], [0.0, widest]]
        super().__init__(("depth_um", "duty", "wall"), start, bounds, base, modes, period_um)

    def equivalents(self, x: Array) -> list[Array]:
        """Return the parameters with the duty cycle 1 − duty, which give the same efficiencies of all orders."""
        other = x.copy()
        other[1] = 1.0 - x[1]
        return [other]
