"""Moving lights, which rotate about an axis through a point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref, renaming
from warpdiff.lights.directional import DirectionalLight
from warpdiff.lights.environment import Environment, with_settings
from warpdiff.lights.point import PointLight

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.base import Light

# Environment lights can rotate only about a vertical axis, because their horizon is always level. The number is the
# largest permitted sine of the angle between the axis and the vertical. Rounding errors of an axis are far smaller.
_VERTICAL = 1e-6


@dataclass(frozen=True)
class Rotation:
    """Rotation of lights about an axis.

    Attributes:
        axis: Unit vector along the axis, world frame.
        angle: Rotation angle, counter-clockwise as seen from the axis's tip [rad].
        centre: Point on the axis, world frame.
    """

    axis: NDArray[np.float64]
    angle: float
    centre: NDArray[np.float64]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Rotation matrix, shape (3, 3), by Rodrigues' formula; it applies to directions."""
        x, y, z = self.axis.tolist()
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.asarray(np.eye(3) + math.sin(self.angle) * cross + (1.0 - math.cos(self.angle)) * cross @ cross)

    def rotated(self, lights: Sequence[Light]) -> tuple[Light, ...]:
        """Return the lights after the rotation. Environment lights can rotate about +y or −y only."""
        if self.angle == 0.0:
            return tuple(lights)
        return tuple(self._rotated(light, f"lights[{index}]") for index, light in enumerate(lights))

    def _rotated(self, light: Light, name: str) -> Light:
        # Only the known classes of lights are accepted, not their subclasses, which may have additional directions that
        # this method would not rotate.
        if type(light) is DirectionalLight:
            return replace(light, to_light=tuple((self.matrix @ np.array(light.to_light)).tolist()))
        if type(light) is PointLight:
            position = self.centre + self.matrix @ (np.array(light.position) - self.centre)
            with renaming({"position": f"{name}.position"}):
                return replace(light, position=tuple(position.tolist()))
        if type(light) is not Environment:
            raise ArgumentValueError(
                f"{ref(name)} must be a DirectionalLight, a PointLight or an Environment to be moved, got "
                f"{type(light).__name__}; make warpdiff.Shot objects with the light of each frame"
            )
        if math.hypot(self.axis[0], self.axis[2]) > _VERTICAL:
            raise ArgumentValueError(
                f"{ref(name)} is an Environment, which rotates about +y only, got a rotation about "
                f"{tuple(self.axis.round(3).tolist())}; take a view whose {ref('up')} is (0, 1, 0) and {ref('turns')}, "
                "or let the light stay"
            )
        degrees = light.rotation_deg + math.copysign(1.0, self.axis[1]) * math.degrees(self.angle)
        # The rotated environment light is a copy that shares the radiance maps of the original.
        return with_settings(light, math.remainder(degrees, 360.0), light.scale, light.directions)


def direction_of(light: Light, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vector from the point ``centre`` to a directional or point light, the first light of a frame."""
    if isinstance(light, DirectionalLight):
        return np.array(light.to_light)
    if isinstance(light, PointLight):
        offset = np.array(light.position) - centre
        return np.asarray(validation.directions(offset, "lights[0].position - view.target")[0][0])
    raise ArgumentValueError(
        f"{ref('lights[0]')} must be a DirectionalLight or a PointLight, which has a direction that leads to "
        f"{ref('to_light')}, got {type(light).__name__}; give {ref('turns')}"
    )
