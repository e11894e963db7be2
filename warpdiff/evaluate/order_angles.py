"""Angles at which the diffraction orders of a surface's periods leave it, by the grating equation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge

from warpdiff.core import memory, validation
from warpdiff.core.angles import angles_deg
from warpdiff.core.table import Table
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.periods import Period
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.request.signatures import checked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

# Measured memory of `order_angles` [bytes per diffraction order and wavelength].
_BYTES_PER_ORDER = 150
# If the sine of an angle from the normal is a divisor, it counts as at least this number. This prevents a division by
# zero.
_LEAST_SINE = 1e-12


@checked
def order_angles(
    source: HeightField | Period | Sequence[Period], to_light: ArrayLike, wavelengths_nm: ArrayLike, *,
    most_order: Annotated[int, Ge(1)] = 3,
) -> Table:  # fmt: skip
    """Return the angles at which the orders of each period leave the surface, with their standard errors.

    The angles follow from the grating equation: if ωi and ωr are the unit vectors to the light and along the order m,
    ωi + ωr has the component mλ/d along the wave vector of the period d. The standard error of an angle follows from
    the standard error of the period. The efficiency of an order is not considered; see
    :func:`warpdiff.order_efficiencies`.

    Args:
        source: Periods, or a height field, whose :meth:`~warpdiff.HeightField.periods` are used. A field in which
            nothing repeats counts as one period of a grating, with the exact periods Lx and Ly.
        to_light: Direction to the light in the local frame, above the horizon, shape (3,).
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        most_order: Largest absolute value of the orders in the result, at least 1, default 3.

    Returns:
        A row per period, wavelength and order that propagates: ``period_um``, ``wavelength_nm``, ``order``, angles
        ``view_theta_deg`` from the normal and ``view_phi_deg`` from the x axis, and ``standard_error_deg``, the
        standard error of ``view_theta_deg``.

    Raises:
        TypeError: ``source`` is no height field and no period.
        ValueError: An argument is out of its range, or the light is not above the horizon.

    Examples:
        >>> import warpdiff as wd
        >>> print(wd.order_angles(wd.gratings.sinusoidal(2.0, 0.1), (0, 0, 1), 500.0, most_order=1))
        period_um  wavelength_nm  order  view_theta_deg  view_phi_deg  standard_error_deg
                2            500     -1          14.478           180                   0
                2            500      0               0             0                   0
                2            500      1          14.478             0                   0
    """
    light = validation.unit_directions(validation.vector(to_light, "to_light"), "to_light")[0][0]
    if light[2] <= HORIZON:
        raise ArgumentValueError(f"{ref('to_light')} must be above the horizon (z > 0), got {to_light!r}")
    wavelengths_um = 1e-3 * colorimetry.check_wavelengths(wavelengths_nm)
    waves = _waves(source)
    # By the grating equation, the components of the unit vectors ωi and ωr along the wave vector of a period d have the
    # sum mλ/d for the order m. Each component is at most 1, so |mλ/d| is at most 2.
    highest = [min(most_order, math.floor(2.0 * period / wavelengths_um.min())) for _, period, _ in waves]
    memory.require_memory(
        _BYTES_PER_ORDER * len(wavelengths_um) * sum(2 * order + 1 for order in highest),
        f"angles of {sum(highest)} orders at {len(wavelengths_um)} wavelengths",
        f"take a smaller {ref('most_order')}, or fewer wavelengths at a time",
    )
    columns: dict[str, list[NDArray[Any]]] = {
        name: []
        for name in (
            "period_um", "wavelength_nm", "order", "view_theta_deg", "view_phi_deg", "standard_error_deg",
        )
    }  # fmt: skip
    for (frequency, period, error), most in zip(waves, highest, strict=True):
        orders = np.arange(-most, most + 1)
        # By the grating equation, these are the x and y components of the sum of the unit vectors to the light and
        # along the order, shape (wavelengths, orders, 2).
        steps = wavelengths_um[:, None, None] * orders[:, None] * frequency[::-1]
        tangential = steps - light[:2]
        upward = 1.0 - np.sum(tangential**2, axis=-1)
        lives = upward > HORIZON**2
        rows, places = np.nonzero(lives)
        views = np.concatenate([tangential[lives], np.sqrt(upward[lives])[:, None]], axis=1)
        theta, phi = angles_deg(views)
        # An error of the period shifts the direction of an order. Only the component of the shift away from the normal
        # changes the angle between this direction and the normal. If the direction is along the normal, every shift
        # changes the angle.
        shift = steps[lives] * error / period
        sine = np.hypot(views[:, 0], views[:, 1])
        along = np.abs(np.sum(views[:, :2] * shift, axis=1)) / np.maximum(sine, _LEAST_SINE)
        change = np.where(sine > _LEAST_SINE, along, np.hypot(shift[:, 0], shift[:, 1]))
        new = (
            np.full(len(rows), period), 1e3 * wavelengths_um[rows], orders[places], theta, phi,
            np.degrees(change / views[:, 2]),
        )  # fmt: skip
        for column, values in zip(columns.values(), new, strict=True):
            column.append(values)
    return Table({name: np.concatenate(values) for name, values in columns.items()})


def _waves(source: object) -> list[tuple[NDArray[np.float64], float, float]]:
    """Return wave vector (y, x) [1/µm], length [µm] and standard error of the length [µm] of each period."""
    if isinstance(source, HeightField):
        if repeating := source.periods():
            return _waves(repeating)
        axes = [axis for axis in (1, 0) if source.shape[axis] > 1]
        if not axes:
            raise ArgumentValueError(
                f"{ref('source')} must have a period, but the field has a single sample: give a larger field"
            )
        return [(np.eye(2)[axis] / source.size_um[axis], source.size_um[axis], 0.0) for axis in axes]
    periods = [source] if isinstance(source, Period) else source
    if not isinstance(periods, (list, tuple)) or not all(isinstance(period, Period) for period in periods):
        raise ArgumentTypeError(
            f"{ref('source')} must be a warpdiff.HeightField, or periods of HeightField.periods(), got "
            f"{type(source).__name__}"
        )
    if not periods:
        raise ArgumentValueError(f"{ref('source')} must have at least one period, got none")
    return [(np.array(period.frequency), period.period_um, period.standard_error_um) for period in periods]
