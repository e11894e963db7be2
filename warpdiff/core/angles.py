"""Conversion between unit vectors and their angles: from the normal, and around the normal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# The azimuth of the normal is not defined, and counts as 0. A direction counts as the normal if the sine of its angle
# from the normal is smaller than this number. The number is far above the rounding errors of unit vectors.
_LEAST_SINE = 1e-12
# Decimal places of angles [degrees]. The rounding error of unit vectors changes angles by about 1e-14°, so that ten
# decimal places are reliable.
_DECIMALS = 10
# Largest angle from the normal, and largest angle around the normal, that `direction` accepts [degrees].
_MOST_THETA_DEG, _MOST_PHI_DEG = 90.0, 360.0


def direction(theta_deg: ArrayLike, phi_deg: ArrayLike = 0.0) -> NDArray[np.float64]:
    """Return the unit vectors of angles, for ``to_light`` and ``to_view``.

    Args:
        theta_deg: Angles from the normal [degrees], −90 to 90, one number or an array; negative angles are on the other
            side of the normal.
        phi_deg: Angles around the normal from the x axis towards y [degrees], −360 to 360, one number or an array of
            the same shape.

    Returns:
        Unit vectors (sin θ cos φ, sin θ sin φ, cos θ): shape (3,) for two numbers, otherwise (..., 3).

    Raises:
        ValueError: An angle is out of its range, or the shapes do not match.

    Examples:
        >>> import warpdiff as wd
        >>> wd.direction(30.0).round(3)
        array([0.5  , 0.   , 0.866])
        >>> wd.direction([-30.0, 0.0, 30.0]).shape
        (3, 3)
    """
    theta = validation.finite_array(theta_deg, "theta_deg")
    phi = validation.finite_array(phi_deg, "phi_deg")
    for values, name, most in ((theta, "theta_deg", _MOST_THETA_DEG), (phi, "phi_deg", _MOST_PHI_DEG)):
        if (largest := np.max(np.abs(values), initial=0.0)) > most:
            raise ArgumentValueError(f"{ref(name)} must be {-most:g} to {most:g} degrees, got ±{largest:g}")
    try:
        theta, phi = np.broadcast_arrays(np.radians(theta), np.radians(phi))
    except ValueError:
        raise ArgumentValueError(
            f"{ref('theta_deg')} and {ref('phi_deg')} must have the same shape, got {theta.shape} and {phi.shape}"
        ) from None
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def angles_deg(directions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the angles of unit vectors [degrees]: θ from the normal, 0 to 180, and φ around the normal from x.

    ``directions`` has the shape (..., 3), and each of the two results has the shape (...).
    """
    x, y, z = np.moveaxis(directions, -1, 0)
    sine = np.hypot(x, y)
    theta = np.degrees(np.arctan2(sine, z))
    # Adding 0 turns −0 into 0. Without this, the azimuth of a direction towards −x could be −180° instead of 180°.
    phi = np.where(sine < _LEAST_SINE, 0.0, np.degrees(np.arctan2(y + 0.0, x + 0.0)) + 0.0)
    # The angles are rounded, so that the angle of `direction(20)` is exactly 20°, and rows of a table with the angle 20
    # can be found.
    return theta.round(_DECIMALS), phi.round(_DECIMALS)


def signed_angles_deg(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles between unit vectors, shape (..., 3), and the normal [degrees]. Angles may be negative.

    An angle is negative if the x component of its vector is negative, or if this component is 0 and the y component is
    negative.
    """
    theta, _ = angles_deg(directions)
    x, y = directions[..., 0], directions[..., 1]
    is_negative = (x < -_LEAST_SINE) | ((np.abs(x) <= _LEAST_SINE) & (y < 0.0))
    return np.asarray(np.where(is_negative, -theta, theta))
