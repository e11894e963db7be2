"""Cameras: from where, and through which pixels, a mesh is seen."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core import forks, validation
from warpdiff.core.memory import MOST_ELEMENTS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


class ViewFrame(NamedTuple):
    """A view as the rays need it.

    A pixel's place on the image plane is x = half_width · (2 (column + 0.5) / width − 1) along ``right`` and
    y = half_height · (1 − 2 (row + 0.5) / height) along ``up``. A perspective ray leaves ``origin`` along
    x right + y up − back, an orthographic one leaves origin + x right + y up along −back.

    Attributes:
        origin: The eye, world frame, shape (3,).
        right: Unit vector to the right of the image, shape (3,).
        up: Unit vector to the top of the image, shape (3,).
        back: Unit vector from the target to the eye, shape (3,).
        half_width: Half the image's width: a tangent (perspective) or a length (orthographic).
        half_height: Half the image's height, likewise.
        orthographic: Whether the rays are parallel.
    """

    origin: NDArray[np.float64]
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    back: NDArray[np.float64]
    half_width: float
    half_height: float
    orthographic: bool


@dataclass(frozen=True)
class View:
    """A camera: right-handed, it looks along its −z from ``eye`` to ``target``, with +y up.

    Pixels are square, their centres lie at +0.5, and row 0 is the top one. The camera is a perspective one;
    :meth:`orthographic` makes the other kind.

    Attributes:
        eye: Where the camera is, world frame.
        target: The point in the middle of the image, world frame.
        up: A direction that points up in the image; it need not be perpendicular to the line of sight.
        fov_y_deg: Vertical field of view [degrees], within 0 to 180; an orthographic camera has no use for it.
        width: Pixels in a row.
        height: Rows.
        extent_y: Height of an orthographic image [the mesh's unit]; ``None`` is a perspective camera.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    _: KW_ONLY
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov_y_deg: float = 40.0
    width: int = 640
    height: int = 480
    extent_y: float | None = None

    def __post_init__(self) -> None:
        for name, most in {"eye": validation.MOST, "target": validation.MOST, "up": math.inf}.items():
            x, y, z = validation.vector(getattr(self, name), name, most=most).tolist()
            object.__setattr__(self, name, (x, y, z))
        fov = validation.positive(self.fov_y_deg, "fov_y_deg")
        if fov >= 180.0:
            raise ValueError(f"fov_y_deg must be a finite number > 0 and < 180, got {self.fov_y_deg!r}")
        object.__setattr__(self, "fov_y_deg", fov)
        object.__setattr__(self, "width", validation.count(self.width, "width"))
        object.__setattr__(self, "height", validation.count(self.height, "height"))
        if self.width * self.height > MOST_ELEMENTS:
            raise ValueError(
                f"width times height must be at most {MOST_ELEMENTS} pixels, got {self.width} × {self.height}"
            )
        if self.extent_y is not None:
            object.__setattr__(self, "extent_y", validation.positive(self.extent_y, "extent_y"))
        # Refuses what makes none.
        self.frame()

    @classmethod
    def orthographic(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        *,
        up: ArrayLike = (0.0, 1.0, 0.0),
        extent_y: float,
        width: int = 640,
        height: int = 480,
    ) -> View:
        """A camera with parallel rays; what lies behind the plane through ``eye`` is not seen.

        Args:
            eye: A point of the plane that the rays leave from, world frame, shape (3,).
            target: The point in the middle of the image, world frame, shape (3,).
            up: A direction that points up in the image, shape (3,).
            extent_y: Height of the image [the mesh's unit].
            width: Pixels in a row.
            height: Rows.
        """
        # Any: the fields hold tuples, and __post_init__ makes them from what it accepts.
        operands: Any = (eye, target, up)
        extent = validation.positive(extent_y, "extent_y")
        return cls(operands[0], operands[1], up=operands[2], extent_y=extent, width=width, height=height)

    def frame(self) -> ViewFrame:
        """The camera's origin and axes, in float64, not to be written to."""
        return self._frame

    @forks.cached_property
    def _frame(self) -> ViewFrame:
        origin = np.array(self.eye)
        distance = origin - np.array(self.target)
        if not np.any(distance):
            raise ValueError(
                f"eye and target must be two different points, got eye={self.eye!r}, target={self.target!r}"
            )
        back = validation.directions(distance, "eye - target")[0][0]
        across = _cross(validation.directions(self.up, "up")[0][0], back)
        if float(np.linalg.norm(across)) < 1e-6:
            raise ValueError(f"up must not be parallel to the line of sight from eye to target, got {self.up!r}")
        right = validation.directions(across, "up")[0][0]
        up = _cross(back, right)
        for each in (origin, right, up, back):
            each.setflags(write=False)
        half_height = float(np.tan(np.radians(self.fov_y_deg) / 2.0)) if self.extent_y is None else self.extent_y / 2.0
        half_width = half_height * self.width / self.height
        return ViewFrame(origin, right, up, back, half_width, half_height, self.extent_y is not None)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The vector product of two vectors, for which NumPy takes ten times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
