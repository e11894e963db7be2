"""Hidden pictures: a card of dots that shows one picture to one eye, and another picture to another eye.

Dots are small rectangles of the card. All dots have the same grating, but each dot turns it, and has its own depth
scale, the factor of the heights.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref, renaming
from warpdiff.heightfield.field import HeightField, check_whole
from warpdiff.heightfield.grating_map import LEAST_SCALE, MOST_PITCH_RATIO, MOST_SCALE, GratingMap
from warpdiff.heightfield.grey_levels import grey_levels
from warpdiff.optics import colorimetry, reflectance_factors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

# Number of depth scales (factors of the heights of a dot, a small rectangle of the card) at which the power of the
# first order is tabulated. The value was chosen so that the error of linear interpolation between them is below 1e-4 of
# the largest power.
_DEPTHS = 513
# Smallest angle between the directions to both eyes, as viewed from the middle of the card [degrees]. The angular
# diameter of the sun (0.53°) blurs diffraction orders. With half of this angle, each eye would also see the dots (small
# rectangles) of the other picture.
_LEAST_ANGLE_DEG = 2.0
# Smallest component along the normal of the card, for unit vectors to the eyes and to the light. The value is limited
# because kernels treat directions with a smaller component as below the horizon, where the dots (small rectangles) of
# the card are black.
_LEAST_ELEVATION = 1e-6


def hidden_pictures(
    first: ArrayLike | str | os.PathLike[str], second: ArrayLike | str | os.PathLike[str],
    eyes: Sequence[Sequence[float]], to_light: Sequence[float], *, cell: HeightField, width: float = 1.0,
    wavelength_nm: float = 545.0,
) -> GratingMap:  # fmt: skip
    """Make a grating map for a flat card that shows one picture to one eye, and another picture to another eye.

    The dots (small rectangles) form a checkerboard and belong to the two pictures in turn. The pitch and the turn of a
    dot aim its first diffraction order at ``wavelength_nm`` at the eye of its picture, from the dot's own place on the
    card. The depth makes the luminance of the dot proportional to the picture, with the same maximum for both eyes. The
    card is ``wd.meshes.card(width)`` with the height of the picture: it lies in the xy plane around the origin, with x
    to the right, and faces +z.

    The luminance of dots assumes ``Coherence("source")``, an index of refraction of infinity and no masking. Other
    materials change both pictures alike.

    Args:
        first: Luminances of the picture for the first eye, 0 to 1, shape (rows, columns) with at least 2 each, or the
            path of a grey image, whose levels are linear from 0 to 1.
        second: The picture for the second eye, of the same shape.
        eyes: Positions of the two eyes, shape (2, 3), with z above 0 [mesh units].
        to_light: Direction to a distant light, with z above 0, shape (3,), of any length.
        cell: Grating that varies along x, with one period along x. A symmetric one, such as a sine, is best.
        width: Width of the card [mesh units], default 1.
        wavelength_nm: Wavelength that arrives at the eyes, 380 to 780, default 545, green.

    Returns:
        A grating map of rows × columns dots.

    Raises:
        FileNotFoundError: A picture is a path without a file.
        ValueError: The pictures differ in shape or exceed 0 to 1, an eye or the light is not above the card, the eyes
            are less than 2° apart, or no pitch aims at an eye, because it is in the mirror direction.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> first, second = np.indices((6, 8)) / [[[5.0]], [[7.0]]]
        >>> cell = wd.gratings.sinusoidal(1.3, 0.2)
        >>> wd.hidden_pictures(first, second, [(0, 0, 8), (5, 1, 6)], (0, 0.6, 0.8), cell=cell).shape
        (6, 8)
    """
    pictures = [_picture(value, name) for name, value in (("first", first), ("second", second))]
    if pictures[0].shape != pictures[1].shape:
        raise ArgumentValueError(
            f"{ref('second')} must have the shape of {ref('first')}, {pictures[0].shape}, got {pictures[1].shape}: "
            "resample it"
        )
    with renaming({"heightfield": "cell"}):
        check_whole(cell)
    validation.positive(width, "width")
    shortest, longest = colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM
    wavelength_um = 1e-3 * validation.number(wavelength_nm, "wavelength_nm", least=shortest, most=longest)
    places = np.asarray(eyes, dtype=np.float64) if _is_numeric(eyes) else np.zeros(0)
    if places.shape != (2, 3) or not (np.abs(places) <= validation.MOST).all() or places[:, 2].min() <= 0.0:
        raise ArgumentValueError(
            f"{ref('eyes')} must be two positions (x, y, z) within ±{validation.MOST:g} with z above 0, in front of "
            f"the card, got {eyes!r:.80}"
        )
    directions, _ = validation.unit_directions(to_light, "to_light")
    if directions.shape != (1, 3) or directions[0, 2] <= _LEAST_ELEVATION:
        raise ArgumentValueError(
            f"{ref('to_light')} must be one direction with z above 0, and at least {_LEAST_ELEVATION:g} of its length, "
            f"got {to_light!r:.80}"
        )
    towards = places / np.linalg.norm(places, axis=1)[:, None]
    angle = float(np.degrees(np.arccos(np.clip(towards[0] @ towards[1], -1.0, 1.0))))
    if angle < _LEAST_ANGLE_DEG:
        raise ArgumentValueError(
            f"{ref('eyes')} must be at least {_LEAST_ANGLE_DEG:g}° apart from the middle of the card, got {angle:.2g}°"
        )
    return _aimed(np.array(pictures), places, directions[0], cell, width, wavelength_um)


def _aimed(
    pictures: NDArray[np.float64], eyes: NDArray[np.float64], to_light: NDArray[np.float64], cell: HeightField,
    width: float, wavelength_um: float,
) -> GratingMap:  # fmt: skip
    """Return the grating map whose dots diffract their first order to the eyes; the arguments are already checked.

    Dots are small rectangles of the card, each with a grating.
    """
    rows, columns = pictures.shape[1:]
    row, column = np.indices((rows, columns))
    of_dot = (row + column) % 2
    brightness = np.where(of_dot == 0, pictures[0], pictures[1])
    side = width / columns
    places = np.stack([(column + 0.5 - columns / 2.0) * side, (rows / 2.0 - row - 0.5) * side, 0.0 * row], axis=-1)
    to_eye = eyes[of_dot] - places
    to_eye /= np.linalg.norm(to_eye, axis=-1, keepdims=True)
    if not to_eye[..., 2].min() > _LEAST_ELEVATION:
        raise ArgumentValueError(
            f"{ref('eyes')} must be visible from all dots, at least {np.degrees(_LEAST_ELEVATION):.1g}° above the "
            f"card, got {eyes.tolist()} for a {ref('width')} of {width:g}: raise the eyes, or give a smaller width"
        )
    # The order with the frequency q scatters light of the wavelength λ by the vector λ q. Light arrives at the eye if
    # this vector is −(ωi + ωr), for the directions ωi to the light and ωr to the eye. `vector` has the opposite sign.
    vector = to_light + to_eye
    lateral = np.hypot(vector[..., 0], vector[..., 1])
    period = cell.size_um[1]
    with np.errstate(divide="ignore"):
        pitch = wavelength_um / (lateral * period)
    if not (np.isfinite(pitch).all() and pitch.max() <= MOST_PITCH_RATIO * pitch.min()):
        raise ArgumentValueError(
            f"{ref('eyes')} must be away from the mirror direction of {ref('to_light')}, got pitch scales from "
            f"{pitch.min():.3g} to {pitch.max():.3g}: move an eye or the light"
        )
    if not (pitch.min() >= LEAST_SCALE and pitch.max() <= MOST_SCALE):
        raise ArgumentValueError(
            f"{ref('cell')} must have a period that pitch scales of {LEAST_SCALE:g} to {MOST_SCALE:g} aim at the eyes, "
            f"got {period:g} µm, which requires {pitch.min():.3g} to {pitch.max():.3g}: give a cell with a period of "
            f"about {period * float(np.median(pitch)):.3g} µm"
        )
    turn = np.degrees(np.arctan2(-vector[..., 1], -vector[..., 0])) % 360.0
    power = brightness / _largest_luminance(to_light, to_eye, vector, lateral)
    depth = _depth_scales(cell, power / power.max() * brightness.max(), vector[..., 2] / wavelength_um)
    if not depth.max() <= MOST_SCALE:
        raise ArgumentValueError(
            f"{ref('cell')} must have a height range that depth scales of at most {MOST_SCALE:g} suffice for, got "
            f"{cell.height_range_um:.3g} µm, which requires {depth.max():.3g}: deepen the cell"
        )
    return GratingMap(cell, turn_deg=turn, depth_scale=depth, pitch_scale=pitch)


def _largest_luminance(
    to_light: NDArray[np.float64],
    to_eye: NDArray[np.float64],
    vector: NDArray[np.float64],
    lateral: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return relative luminances of dots if the first orders of all dots had equal powers |H|², shape (rows, columns).

    A dot is a small rectangle of a card. H is the Fourier coefficient of the order. Under an extended source, an eye
    sees the order of the frequency q in a range of wavelengths that is proportional to 1/√(qᵀ Σ⁻¹ q). Σ is the
    covariance of the scattering vectors (u, v) of the source. Its inverse is proportional to 1 + t tᵀ/cos²θ, where t is
    the tangential part of the unit vector to the light, and θ is the angle of the light from the normal.
    """
    lights = np.broadcast_to(to_light, to_eye.shape)
    gains = reflectance_factors.gain(
        lights.reshape(-1, 3), to_eye.reshape(-1, 3), normal=1.0, masking=False, per_light_cosine=True
    ).reshape(lateral.shape)
    along = (vector[..., :2] @ to_light[:2]) / to_light[2]
    return np.asarray(gains / np.hypot(lateral, along))


def _depth_scales(
    cell: HeightField, power: NDArray[np.float64], kappa: NDArray[np.float64]
) -> NDArray[np.float64]:  # fmt: skip
    """Return the smallest depth scales for which the first order has the fractions ``power`` of its largest power.

    A depth scale is the factor of the heights of a dot, a small rectangle of the card. The power of the first order
    depends on the product of depth scale and κ = |w|/λ [1/µm]. It increases from 0 to its first maximum.
    """
    heights = cell.heights_um[0] - cell.heights_um[0].mean()
    range_um = cell.height_range_um
    if not range_um > 0.0:
        raise ArgumentValueError(f"{ref('cell')} must have heights that differ, got a flat field")
    # The first maximum of the power is at the phase 2πκ · (height range): 1.17π for a sine, π for a lamellar grating,
    # and 2π for a blazed grating.
    products = np.linspace(0.0, 1.1 / range_um, _DEPTHS)
    order = np.exp(-2j * np.pi * np.arange(len(heights)) / len(heights))
    powers = np.abs(np.exp(2j * np.pi * products[:, None] * heights) @ order / len(heights)) ** 2
    most = int(np.argmax(np.append(np.diff(powers) < 0.0, True)))
    if powers[most] < 1e-6:
        raise ArgumentValueError(
            f"{ref('cell')} must have one period along x, whose first order is bright, got none: cut it with "
            f"{ref('whole_periods()')}"
        )
    return np.asarray(np.interp(power * powers[most], powers[: most + 1], products[: most + 1]) / kappa)


def _is_numeric(value: object) -> bool:
    try:
        return np.asarray(value).dtype.kind in "iuf"
    except (TypeError, ValueError):
        return False


def _picture(value: Any, name: str) -> NDArray[np.float64]:
    """Return the luminances of a picture, from an array or a grey image."""
    if isinstance(value, (str, os.PathLike)):
        picture = grey_levels(value, name)
    else:
        picture = validation.finite_array(value, name, ndim=2)
    if min(picture.shape) < 2:
        raise ArgumentValueError(f"{ref(name)} must have at least 2 rows and 2 columns, got {picture.shape}")
    if picture.min() < 0.0 or picture.max() > 1.0 or picture.max() == 0.0:
        raise ArgumentValueError(
            f"{ref(name)} must lie within 0 to 1, with a value above 0, got {picture.min():g} to {picture.max():g}: "
            "divide it by its largest value"
        )
    return picture
