"""Shots: the lights and the view of each frame of a sequence."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Interval

from warpdiff.apps.sequences.light_motion import Rotation, direction_of
from warpdiff.core import validation
from warpdiff.core.files import naming_file
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.lights.base import Light, LobeLight, listed
from warpdiff.optics import colorimetry
from warpdiff.request.signatures import checked
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

# Largest number of shots (lights and camera of one frame each) of a sequence. It was chosen so that a sequence of one
# hour is possible, which has 86,400 frames at 24 frames per second. A shot requires a few kilobytes.
MOST_SHOTS = 100_000
# Largest number of turns of a turntable or of moving lights. A larger number is probably an angle in degrees.
_MOST_TURNS = 1e6
Count = Annotated[int, Interval(ge=1, le=MOST_SHOTS)]
Turns = Annotated[float, Interval(ge=-_MOST_TURNS, le=_MOST_TURNS)]
# Smallest sine of the angle between two directions that define a great circle. For smaller angles, the axis of the
# rotation would consist of rounding errors.
_LEAST_SINE = 1e-9
_COLUMNS = ("eye_x", "eye_y", "eye_z", "target_x", "target_y", "target_z")
_MORE_COLUMNS = ("up_x", "up_y", "up_z", "fov_y_deg")


@dataclass(frozen=True)
class Shot:
    """Lights and camera of one frame.

    Attributes:
        lights: One light of any kind, or several; stored as a tuple.
        view: Camera.

    Examples:
        >>> import warpdiff as wd
        >>> shot = wd.Shot(wd.DirectionalLight((0, 1, 0)), wd.View((0, 1, 3), (0, 0, 0)))
        >>> shot.view.width
        640
    """

    lights: tuple[Light, ...]
    view: View

    def __post_init__(self) -> None:
        object.__setattr__(self, "lights", tuple(_check_lights(self.lights)))
        validation.instance(self.view, View, "view")


@checked
def turntable(
    lights: Light | Sequence[Light], view: View, *, count: Count = 36, turns: Turns = 1.0, lights_follow: bool = True,
) -> list[Shot]:  # fmt: skip
    """Make the shots of a body that rotates about the axis through the view's target along the view's ``up``.

    A shot has the lights and the camera of one frame.

    :meth:`warpdiff.View.fit` returns a view that shows the whole body in all frames::

        body, sky = wd.meshes.snake(), wd.Environment.clear_sky((1.0, 1.0, 0.5))
        shots = wd.turntable([sky, wd.PointLight((0.0, 2.0, 1.0))], wd.View.fit(body, turning=True))

    Args:
        lights: Light of the first frame, or several: directional lights and discs, point lights, environments.
        view: Camera of the first frame.
        count: Number of frames, evenly spaced; the frame after the last one equals the first.
        turns: Number of turns in total, counter-clockwise as seen from above; negative numbers turn clockwise.
        lights_follow: Whether the lights move with the camera around the body, as if the body turned in front of them.
            Otherwise only the camera moves. With True, environments require an ``up`` of +y or −y.

    Returns:
        The shots.

    Raises:
        ValueError: An argument is not accepted.

    Examples:
        >>> import warpdiff as wd
        >>> view = wd.View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0))
        >>> shots = wd.turntable(wd.DirectionalLight((0, 1, 0)), view, count=4)
        >>> [round(x, 3) + 0.0 for x in shots[1].view.eye]
        [-3.0, 0.0, 0.0]
    """
    lights = _check_lights(lights)
    axis = validation.directions(view.up, "view.up")[0][0]
    angle = 2.0 * math.pi * turns / count
    target, offset = np.array(view.target), np.subtract(view.eye, view.target)
    shots = []
    for k in range(count):
        # The frames are those of a rotating body. The body itself stays fixed in the world frame; camera and lights
        # rotate in the opposite direction.
        rotation = Rotation(axis, -angle * k, target)
        eye = target + rotation.matrix @ offset if k else np.array(view.eye)
        moved = rotation.rotated(lights) if lights_follow else tuple(lights)
        shots.append(Shot(moved, replace(view, eye=tuple(eye.tolist()))))
    return shots


@checked
def light_sweep(
    lights: Light | Sequence[Light], view: View, to_light: ArrayLike | None = None, *, turns: Turns | None = None,
    count: Count = 36,
) -> list[Shot]:  # fmt: skip
    """Make the shots of lights that move at a constant rate while body and camera are at rest.

    A shot has the lights and the camera of one frame. Directional lights and discs change their direction. Point lights
    move on a circle around the view's target. Environments rotate about +y. Several lights move together, as if they
    were fixed to each other::

        view = wd.View.fit(wd.meshes.snake(), width=480, height=260)
        shots = wd.light_sweep(wd.PointLight((0.0, 2.0, 1.0)), view, (1.0, 1.0, 0.0))  # along a great circle
        shots = wd.light_sweep(wd.Environment.clear_sky((1.0, 1.0, 0.5)), view, turns=1.0)  # the sun goes around

    Args:
        lights: Light of the first frame, or several; with ``to_light`` the first one is a directional or a point light.
        view: Camera of all frames.
        to_light: Direction from the view's target to the first light in the last frame, world frame, shape (3,); it is
            normalised. Seen from the target, the light moves along the shortest arc of a great circle. The arc begins
            at the light's direction in the first frame and ends at ``to_light`` in the last frame.
        turns: Number of turns around the view's ``up``, instead of ``to_light``, counter-clockwise as seen from above;
            negative numbers turn clockwise. The frame after the last one would complete the turns. Environments require
            an ``up`` of +y or −y.
        count: Number of frames.

    Returns:
        The shots.

    Raises:
        ValueError: An argument is not accepted, or the directions are opposite and have no shortest path.

    Examples:
        >>> import warpdiff as wd
        >>> light, view = wd.DirectionalLight((0, 1, 0)), wd.View((0, 1, 3), (0, 0, 0))
        >>> shots = wd.light_sweep(light, view, (1, 0, 0), count=3)
        >>> [round(x, 3) for x in shots[1].lights[0].to_light]
        [0.707, 0.707, 0.0]
    """
    lights, target = _check_lights(lights), np.array(view.target)
    if (to_light is None) == (turns is None):
        raise ArgumentValueError(
            f"{ref('to_light')} or {ref('turns')} must be given, got {'neither' if turns is None else 'both'}: give one"
        )
    if turns is not None:
        axis, angle, steps = validation.directions(view.up, "view.up")[0][0], 2.0 * math.pi * turns, count
    else:
        axis, angle = _great_circle(direction_of(lights[0], target), to_light)
        steps = max(count - 1, 1)
    return [Shot(Rotation(axis, angle * k / steps, target).rotated(lights), view) for k in range(count)]


def _great_circle(begin: NDArray[np.float64], to_light: Any) -> tuple[NDArray[np.float64], float]:
    """Return axis and angle [rad] of the shortest rotation from the direction ``begin`` to ``to_light``."""
    end = validation.unit_directions(validation.vector(to_light, "to_light"), "to_light")[0][0]
    axis = np.cross(begin, end)
    sine, cosine = float(np.linalg.norm(axis)), float(begin @ end)
    if sine >= _LEAST_SINE:
        return axis / sine, math.atan2(sine, cosine)
    if cosine < 0.0:
        raise ArgumentValueError(
            f"{ref('to_light')} must not be opposite to the first direction, got {end.tolist()}: make two sweeps"
        )
    return np.array([0.0, 1.0, 0.0]), 0.0


@checked
def camera_path(
    path: str | os.PathLike[str], lights: Light | Sequence[Light], view: View, *,
    count: Count | None = None,
) -> list[Shot]:  # fmt: skip
    r"""Make the shots of a camera whose path is in a file.

    A shot has the lights and the camera of one frame.

    Args:
        path: CSV file with a header and one row per frame or key frame. The columns are ``eye_x``, ``eye_y``,
            ``eye_z``, ``target_x``, ``target_y``, ``target_z`` and optionally ``up_x``, ``up_y``, ``up_z`` and
            ``fov_y_deg``.
        lights: Light of all frames, or several, of any kind; they are at rest.
        view: Camera that supplies the image size, and ``up`` and ``fov_y_deg`` if the file has none.
        count: Number of frames, interpolated by monotone cubics through the rows, which are evenly spaced in time. The
            first and the last frame are the first and the last row. None makes one frame per row.

    Returns:
        The shots.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: An argument or the file is not accepted; the message names the row.

    Examples:
        >>> import warpdiff as wd
        >>> from pathlib import Path
        >>> rows = "eye_x,eye_y,eye_z,target_x,target_y,target_z\n0,0,3,0,0,0\n1,0,3,0,0,0\n"
        >>> _ = Path("path.csv").write_text(rows)
        >>> light, view = wd.DirectionalLight((0, 1, 0)), wd.View((0, 1, 3), (0, 0, 0))
        >>> len(wd.camera_path("path.csv", light, view, count=5))
        5
    """
    lights = tuple(_check_lights(lights))
    names, rows = _rows(path)
    if count is not None:
        try:
            rows = _between(rows, count)
        except ValueError:
            # SciPy raises an error if the slope between two rows (key frames) of a camera path exceeds the largest
            # number of float64.
            raise ArgumentValueError(
                f"{ref('path')}: numbers of {str(path)!r} are too large for positions of a camera"
            ) from None
    shots = []
    for index, row in enumerate(rows.tolist()):
        values: dict[str, Any] = dict(zip(names, row, strict=True))
        changes: dict[str, Any] = {
            name: tuple(values[f"{name}_{axis}"] for axis in "xyz")
            for name in ("eye", "target", "up")
            if f"{name}_x" in values
        }
        if "fov_y_deg" in values:
            changes["fov_y_deg"] = values["fov_y_deg"]
        try:
            shots.append(Shot(lights, replace(view, **changes)))
        except ValueError as error:
            raise ArgumentValueError(f"{ref('path')}: frame {index} of {str(path)!r}: {error}") from None
    return shots


def _check_lights(lights: Any) -> list[Light]:
    """Return the lights of a frame as a checked list. The argument is one light or several."""
    result = listed(lights)
    for index, light in enumerate(result):
        if isinstance(light, LobeLight):
            colorimetry.check_illuminant(light.illuminant, f"lights[{index}].illuminant")
    return result


def _rows(path: Any) -> tuple[list[str], NDArray[np.float64]]:
    """Return the names of the columns of a camera path's CSV file, and its numbers, shape (rows, columns)."""
    source = validation.path(path, "path")
    try:
        with naming_file(source), source.open(encoding="utf-8-sig", newline="") as file:
            header, *rows = [row for row in csv.reader(file) if any(map(str.strip, row))] or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ArgumentValueError(f"{ref('path')}: {str(source)!r} is not a CSV file: {error}") from None
    names = [name.strip() for name in header]
    known = {*_COLUMNS, *_MORE_COLUMNS}
    up = _MORE_COLUMNS[:3]
    required = (*_COLUMNS, *up) if any(name in names for name in up) else _COLUMNS
    if not set(required) <= set(names) <= known or len(set(names)) != len(names):
        raise ArgumentValueError(
            f"{ref('path')}: {str(source)!r} must begin with columns {', '.join(required)}, and "
            f"optionally {', '.join(name for name in _MORE_COLUMNS if name not in required)}, each once, got "
            f"{', '.join(map(repr, names[:12]))}"
        )
    if not rows or len(rows) > MOST_SHOTS:
        raise ArgumentValueError(
            f"{ref('path')}: {str(source)!r} must have 1 to {MOST_SHOTS} rows below its header, got {len(rows)}"
        )
    numbers = np.empty((len(rows), len(names)))
    for index, row in enumerate(rows):
        try:
            numbers[index] = [float(text) for text in row]
        except ValueError:
            raise ArgumentValueError(
                f"{ref('path')}: row {index + 1} of {str(source)!r} must be {len(names)} numbers, got {row!r:.60}"
            ) from None
    if not np.isfinite(numbers).all():
        raise ArgumentValueError(f"{ref('path')}: {str(source)!r} must hold finite numbers")
    return names, numbers


def _between(rows: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Interpolate ``count`` rows of a camera path by monotone cubics through ``rows``; the end rows are unchanged."""
    from scipy.interpolate import PchipInterpolator

    if len(rows) == 1:
        return np.repeat(rows, count, axis=0)
    places = np.linspace(0.0, len(rows) - 1.0, count)
    # If numbers in the rows are too large, interpolated numbers are not finite. The class ``View`` raises an error for
    # them.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(PchipInterpolator(np.arange(len(rows)), rows, axis=0)(places), dtype=np.float64)
