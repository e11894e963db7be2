"""Cameras: position, orientation and pixels of a view."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Interval, Unit

from warpdiff.core import forks, validation
from warpdiff.core.memory import MOST_ELEMENTS
from warpdiff.core.options import Checked
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.scene.mesh_import import normalised_positions

if TYPE_CHECKING:
    import os

    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.scene.mesh_import import Surface


# Fraction of the image that a mesh fills after `View.fit`: of its width or of its height, whichever limits the size of
# the mesh. The value was chosen so that a margin of 4 % remains on each side.
_FILLED = 0.92
# Smallest distance of the camera that `View.fit` places in front of a mesh, in radii of the mesh. Without this limit,
# a mesh that looks like a point, such as a line along the viewing direction, would have the distance 0.
_LEAST_DISTANCE = 1e-2


class ViewFrame(NamedTuple):
    """Origin and axes of a view.

    A pixel's position along ``right`` is x = half_width · (2 (column + 0.5) / width − 1). The position along ``up`` is
    y = half_height · (1 − 2 (row + 0.5) / height). A perspective ray starts at ``origin`` in the direction
    x right + y up − back. An orthographic ray starts at origin + x right + y up in the direction −back.

    Attributes:
        origin: The eye, world frame, shape (3,).
        right: Unit vector to the right of the image, shape (3,).
        up: Unit vector to the top of the image, shape (3,).
        back: Unit vector from the target to the eye, shape (3,).
        half_width: Half of the image's width: a tangent for a perspective camera, a length for an orthographic camera.
        half_height: Half of the image's height, as a tangent or a length like ``half_width``.
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
class View(ReadOnlyArrays, Checked):
    """Camera: right-handed, it looks along its −z axis from ``eye`` to ``target``, with its +y axis up.

    Pixels are square. The centre of the pixel (row, column) is at (row + 0.5, column + 0.5), and row 0 is at the top.
    The camera is perspective. :meth:`orthographic` makes an orthographic camera, and :meth:`fit` frames a mesh.

    Attributes:
        eye: Position of the camera, world frame.
        target: Point in the middle of the image, world frame.
        up: Direction that points up in the image; it need not be perpendicular to the line of sight.
        fov_y_deg: Vertical field of view, less than 180; ignored for orthographic cameras.
        width: Width of the image.
        height: Height of the image.
        extent_y: Height of an orthographic image in the unit of the mesh; None is a perspective camera.

    Examples:
        >>> import warpdiff as wd
        >>> view = wd.View((0.0, 1.5, 4.0), (0.0, 0.0, 0.0), fov_y_deg=14.0, width=320, height=180)
        >>> view.eye
        (0.0, 1.5, 4.0)
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    _: KW_ONLY
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov_y_deg: Annotated[float, Interval(gt=0.0, lt=180.0), Unit("degrees")] = 40.0
    width: Annotated[int, Ge(1), Unit("pixels")] = 640
    height: Annotated[int, Ge(1), Unit("pixels")] = 480
    extent_y: Annotated[float, Gt(0.0)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if validation.positive(self.fov_y_deg, "fov_y_deg") >= 180.0:
            raise ArgumentValueError(f"{ref('fov_y_deg')} must be less than 180, got {self.fov_y_deg!r}")
        if self.extent_y is not None:
            validation.positive(self.extent_y, "extent_y")
        if self.width * self.height > MOST_ELEMENTS:
            raise ArgumentValueError(
                f"{ref('width')} times {ref('height')} must be at most {MOST_ELEMENTS} pixels, "
                f"got {self.width} × {self.height}"
            )
        # The camera's axes are computed here although they are not stored, because their computation raises errors if
        # the arguments do not define a camera.
        self.frame()

    @classmethod
    def orthographic(
        cls, eye: ArrayLike, target: ArrayLike, *, up: ArrayLike = (0.0, 1.0, 0.0), extent_y: float, width: int = 640,
        height: int = 480,
    ) -> View:  # fmt: skip
        """Make an orthographic camera; points behind the plane through ``eye`` are invisible.

        Args:
            eye: Point of the plane where the rays start, world frame, shape (3,).
            target: Point in the middle of the image, world frame, shape (3,).
            up: Direction that points up in the image, shape (3,).
            extent_y: Height of the image in the unit of the mesh.
            width: Width of the image in pixels.
            height: Height of the image in pixels.
        """
        # The arguments may be arrays, but the fields of a view are tuples. The arguments are annotated as Any, because
        # ``__post_init__`` converts them.
        operands: Any = (eye, target, up)
        extent = validation.positive(extent_y, "extent_y")
        return cls(operands[0], operands[1], up=operands[2], extent_y=extent, width=width, height=height)

    @classmethod
    def fit(
        cls, mesh: trimesh.Trimesh | trimesh.Scene | Surface | str | os.PathLike[str],
        direction: ArrayLike | None = None, *, target: ArrayLike | None = None, up: ArrayLike = (0.0, 1.0, 0.0),
        fov_y_deg: float = 40.0, width: int = 640, height: int = 480, turning: bool = False,
    ) -> View:  # fmt: skip
        """Frame a mesh, so that it fills the image.

        Args:
            mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene``, or the path of a mesh file.
            direction: Direction from the mesh to the camera, world frame, shape (3,). None is the front, which is +z,
                or −y for an ``up`` near ±z, raised by 31° towards ``up``.
            target: Point in the middle of the image, world frame, shape (3,). None centres the mesh in the image, or,
                with ``turning``, is the centre of the bounding sphere. If you give a point, the camera moves back until
                the whole mesh is in the image.
            up: Direction that points up in the image, shape (3,).
            fov_y_deg: Vertical field of view [degrees], less than 180.
            width: Width of the image in pixels.
            height: Height of the image in pixels.
            turning: Whether the mesh or the camera turns about the target, as in :func:`warpdiff.turntable`. If so, the
                camera is so far away that the whole mesh is in the image at all angles; the mesh then does not fill the
                image.

        Raises:
            FileNotFoundError: The mesh file does not exist.
            ValueError: An argument is not accepted, or the mesh file cannot be read.

        Examples:
            >>> import warpdiff as wd
            >>> view = wd.View.fit(wd.meshes.disc(), (0.0, 0.0, 1.0), width=320, height=180)
            >>> tuple(round(x, 2) for x in view.eye)
            (0.0, 0.0, 2.99)
        """
        if direction is None:
            above = validation.directions(validation.vector(up, "up"), "up")[0][0]
            front = np.array([0.0, 0.0, 1.0]) if abs(above[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
            front = front - (front @ above) * above
            back = front / np.linalg.norm(front) + 0.6 * above
        else:
            back = validation.directions(validation.vector(direction, "direction"), "direction")[0][0]
        # The arguments may be arrays, but the fields of a view are tuples. The arguments are annotated as Any, because
        # ``__post_init__`` converts them.
        operands: Any = (back, up)
        view = cls(operands[0], (0.0, 0.0, 0.0), up=operands[1], fov_y_deg=fov_y_deg, width=width, height=height)
        validation.flag(turning, "turning")
        centre, radius, points = normalised_positions(mesh)
        middle: Any = centre if target is None else validation.vector(target, "target")
        frame = view.frame()
        if turning:
            # The bounding sphere of a turning mesh must fit into the narrower of the horizontal and the vertical field
            # of view.
            half = math.atan(min(frame.half_height, frame.half_width))
            reach = radius + math.dist(middle, centre)
            return replace(view, eye=middle + reach / math.sin(half) * frame.back, target=middle)
        # Let the middle of the image be at cₓ, and let tₓ be the tangent of half the horizontal field of view. A point
        # (x, z), with z towards the eye, is in the image if |x − cₓ| ≤ tₓ (d − z). Here d is the distance of the eye
        # from z = 0. The least d follows from the largest x + tₓ z and the least x − tₓ z. The condition along y is
        # similar.
        points = points + (centre - middle) / radius
        towards = points @ frame.back
        distance, moved = float(towards.max()) + _LEAST_DISTANCE, np.zeros(3)
        for axis, tangent in ((frame.right, _FILLED * frame.half_width), (frame.up, _FILLED * frame.half_height)):
            along = points @ axis
            high, low = float((along + tangent * towards).max()), float((along - tangent * towards).min())
            offset = 0.5 * (high + low) if target is None else 0.0
            distance = max(distance, (high - offset) / tangent, (offset - low) / tangent)
            moved += offset * axis
        middle = middle + radius * moved
        return replace(view, eye=middle + radius * distance * frame.back, target=middle)

    def frame(self) -> ViewFrame:
        """Return the camera's origin and axes, in float64, read-only."""
        return self._frame

    @forks.cached_property
    def _frame(self) -> ViewFrame:
        origin = np.array(self.eye)
        distance = origin - np.array(self.target)
        if not np.any(distance):
            raise ArgumentValueError(
                f"{ref('eye')} and {ref('target')} must be two different points, got {self.eye!r} and {self.target!r}"
            )
        back = validation.directions(distance, "eye - target")[0][0]
        across = _cross(validation.directions(self.up, "up")[0][0], back)
        if float(np.linalg.norm(across)) < 1e-6:
            raise ArgumentValueError(
                f"{ref('up')} must not be parallel to the line of sight from {ref('eye')} to {ref('target')}, "
                f"got {self.up!r}"
            )
        right = validation.directions(across, "up")[0][0]
        up = _cross(back, right)
        for vector in (origin, right, up, back):
            vector.setflags(write=False)
        half_height = float(np.tan(np.radians(self.fov_y_deg) / 2.0)) if self.extent_y is None else self.extent_y / 2.0
        half_width = half_height * self.width / self.height
        return ViewFrame(origin, right, up, back, half_width, half_height, self.extent_y is not None)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross product of two vectors. The function takes a tenth of the time of ``numpy.cross``."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
