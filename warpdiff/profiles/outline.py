"""``Outline``: one period of a grating as a polygon, with exact Fourier coefficients."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


class Outline(ReadOnlyArrays):
    """One period of a grating along x as a polygon of straight segments; immutable.

    A height field represents the position of a vertical wall only to within a sample. An outline has exact Fourier
    coefficients instead, and derivatives with respect to the positions and heights of its vertices. The last segment
    leads from the last vertex to the first vertex of the next period.

    Args:
        positions: Positions of the vertices in periods, 0 to 1, in increasing order, shape (k,). Two equal positions
            are a vertical wall.
        heights_um: Heights of the vertices [µm], shape (k,).
        period_um: Period along x [µm].

    Raises:
        ValueError: Positions are outside of 0 to 1 or decrease, or there are fewer than two vertices.

    Examples:
        >>> import warpdiff as wd
        >>> outline = wd.profiles.Outline([0.0, 0.0, 0.4, 0.4], [0.0, 0.1, 0.1, 0.0], period_um=2.0)
        >>> outline
        Outline(4 vertices, period 2 µm, height range 0.1 µm)
        >>> value, vjp, _ = wd.adjoint.order_efficiencies(outline, (0, 0, 1), 550.0, wrt=("vertices",))
        >>> vjp([[0, 0, 0, 0, 1, 0, 0]])["vertices"].shape
        (4, 2)
    """

    def __init__(self, positions: ArrayLike, heights_um: ArrayLike, period_um: float) -> None:
        self._positions = validation.finite_array(positions, "positions", ndim=1)
        self._heights_um = validation.finite_array(heights_um, "heights_um", ndim=1, most=validation.MOST)
        self._period_um = validation.positive(period_um, "period_um")
        if self._positions.shape != self._heights_um.shape or len(self._positions) < 2:
            raise ArgumentValueError(
                f"{ref('positions')} and {ref('heights_um')} must have the same number of at least 2 vertices, got "
                f"{len(self._positions)} and {len(self._heights_um)}"
            )
        steps = np.diff(self._positions)
        if self._positions[0] < 0.0 or self._positions[-1] > 1.0 or np.any(steps < 0.0):
            raise ArgumentValueError(
                f"{ref('positions')} must increase from at least 0 to at most 1, got {self._positions.tolist()!s:.80}"
            )
        self._positions.setflags(write=False)
        self._heights_um.setflags(write=False)

    def __repr__(self) -> str:
        return (
            f"Outline({len(self._positions)} vertices, period {self._period_um:g} µm, height range "
            f"{self.height_range_um:.3g} µm)"
        )

    @property
    def positions(self) -> NDArray[np.float64]:
        """Positions of the polygon's vertices along x, in periods, 0 to 1, shape (k,), read-only."""
        return self._positions

    @property
    def heights_um(self) -> NDArray[np.float64]:
        """Heights of the polygon's vertices [µm], shape (k,), read-only."""
        return self._heights_um

    @property
    def period_um(self) -> float:
        """Period of the grating along x [µm]."""
        return self._period_um

    @property
    def height_range_um(self) -> float:
        """Height of the polygon's highest vertex minus that of its lowest vertex [µm]."""
        return float(np.ptp(self._heights_um))

    def height_field(self, samples: int = 1024) -> HeightField:
        """Return the outline as a height field with equally spaced samples, for pictures.

        Args:
            samples: Number of samples per period, at least 2, by default 1024. Walls are accurate to half a sample.

        Examples:
            >>> import warpdiff as wd
            >>> wd.profiles.Outline([0.0, 0.5], [0.0, 0.1], period_um=2.0).height_field(4).heights_um
            array([[0.  , 0.05, 0.1 , 0.05]])
        """
        count = validation.count(samples, "samples", least=2)
        x = np.arange(count) / count
        positions = np.concatenate([[self._positions[-1] - 1.0], self._positions, [self._positions[0] + 1.0]])
        heights = self._heights_um[[-1, *range(len(self._heights_um)), 0]]
        return HeightField.of_known_scale(np.interp(x, positions, heights)[None], self._period_um / count)
