"""Shots: the lights and the view of each frame of a sequence."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import validation
from warpdiff.core.files import naming_file
from warpdiff.lights.light_types import DirectionalLight
from warpdiff.optics import colorimetry
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

# An hour at 24 a second; each takes some kilobytes.
MOST_SHOTS = 100_000
_MOST_TURNS = 1e6
_COLUMNS = ("eye_x", "eye_y", "eye_z", "target_x", "target_y", "target_z")
_MORE_COLUMNS = ("up_x", "up_y", "up_z", "fov_y_deg")


@dataclass(frozen=True)
class Shot:
    """What one frame shows.

    Attributes:
        light: One light, or several; a tuple of them.
        view: The camera.
    """

    light: tuple[DirectionalLight, ...]
    view: View

    def __post_init__(self) -> None:
        object.__setattr__(self, "light", tuple(_checked(self.light)))
        validation.instance(self.view, View, "view")


def turntable(
    light: DirectionalLight | Sequence[DirectionalLight],
    view: View,
    *,
    count: int = 36,
    turns: float = 1.0,
    lights_follow: bool = True,
) -> list[Shot]:
    """Shots of a body that turns about the view's target, around its ``up``.

    Args:
        light: The lights of the first frame.
        view: The camera of the first frame.
        count: Frames, evenly spaced; after the last one comes the first again.
        turns: Turns in all, counter-clockwise as seen from above; negative ones go the other way round.
        lights_follow: Whether the body turns before a camera and lights at rest, which then keep their places to each
            other; otherwise the camera goes around a body under lights at rest.

    Returns:
        The shots.

    Raises:
        ValueError: A bad argument.
    """
    lights = _checked(light)
    validation.instance(view, View, "view")
    count = _count(count)
    angle = 2.0 * math.pi * validation.number(turns, "turns", least=-_MOST_TURNS, most=_MOST_TURNS) / count
    follow = validation.flag(lights_follow, "lights_follow")
    axis = validation.directions(view.up, "view.up")[0][0]
    target, offset = np.array(view.target), np.subtract(view.eye, view.target)
    shots = []
    for k in range(count):
        # Against the body's turn.
        turn = _rotation(axis, -angle * k)
        eye = target + turn @ offset if k else np.array(view.eye)
        moved = lights
        if follow and k:
            moved = [replace(each, to_light=tuple((turn @ np.array(each.to_light)).tolist())) for each in lights]
        shots.append(Shot(tuple(moved), replace(view, eye=tuple(eye.tolist()))))
    return shots


def light_sweep(light: DirectionalLight, view: View, to_light: ArrayLike, *, count: int = 36) -> list[Shot]:
    """Shots under a light that moves along the great circle to another direction, at a constant pace.

    Args:
        light: The light of the first frame.
        view: The camera.
        to_light: Direction towards the light in the last frame, world frame, shape (3,).
        count: Frames, both ends among them.

    Returns:
        The shots.

    Raises:
        ValueError: A bad argument, or opposite directions, between which there is no shortest way.
    """
    first, *others = _checked(light)
    if others:
        raise ValueError(f"light must be one light, which moves, got {1 + len(others)}")
    validation.instance(view, View, "view")
    count = _count(count)
    begin = np.array(first.to_light)
    end = validation.directions(validation.vector(to_light, "to_light"), "to_light")[0][0]
    axis = np.cross(begin, end)
    sine, cosine = float(np.linalg.norm(axis)), float(begin @ end)
    angle = math.atan2(sine, cosine)
    if sine < 1e-9:
        if cosine < 0.0:
            raise ValueError(f"to_light must not be opposite to the first direction, got {end.tolist()}")
        return [Shot((first,), view)] * count
    shots = []
    for k in range(count):
        towards = _rotation(axis / sine, angle * k / max(count - 1, 1)) @ begin
        shots.append(Shot((replace(first, to_light=tuple(towards.tolist())),), view))
    return shots


def camera_path(
    path: str | os.PathLike[str],
    light: DirectionalLight | Sequence[DirectionalLight],
    view: View,
    *,
    count: int | None = None,
) -> list[Shot]:
    """Shots by a camera whose path is in a file.

    Args:
        path: A CSV file: a header with ``eye_x``, ``eye_y``, ``eye_z``, ``target_x``, ``target_y``, ``target_z`` and,
            if need be, ``up_x``, ``up_y``, ``up_z`` and ``fov_y_deg``, then a row for each frame or key frame.
        light: The lights.
        view: Whose size it is, and whose ``up`` and ``fov_y_deg`` where the file has none.
        count: Frames between the first and the last row, both among them, by monotone cubics through the rows, which
            are evenly spaced; None takes the rows themselves.

    Returns:
        The shots.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A bad argument or file; the message names the row.
    """
    lights = tuple(_checked(light))
    validation.instance(view, View, "view")
    names, rows = _rows(path)
    if count is not None:
        count = _count(count)
        rows = _between(rows, count)
    shots = []
    for index, row in enumerate(rows.tolist()):
        told: dict[str, Any] = dict(zip(names, row, strict=True))
        changes: dict[str, Any] = {
            what: tuple(told[f"{what}_{axis}"] for axis in "xyz")
            for what in ("eye", "target", "up")
            if f"{what}_x" in told
        }
        if "fov_y_deg" in told:
            changes["fov_y_deg"] = told["fov_y_deg"]
        try:
            shots.append(Shot(lights, replace(view, **changes)))
        except ValueError as error:
            raise ValueError(f"path: frame {index} of {str(path)!r}: {error}") from None
    return shots


def _checked(light: Any) -> list[DirectionalLight]:
    """Lights of a shot, which are directional."""
    lights = [light] if isinstance(light, DirectionalLight) else light
    if not isinstance(lights, (list, tuple)) or not lights:
        raise TypeError(f"light must be a DirectionalLight, or a non-empty sequence of them, got {light!r}")
    for index, each in enumerate(lights):
        validation.instance(each, DirectionalLight, f"light[{index}]")
        colorimetry.check_illuminant(each.illuminant, f"light[{index}].illuminant")
    return list(lights)


def _rows(path: Any) -> tuple[list[str], NDArray[np.float64]]:
    """Names of a file's columns, and its numbers."""
    source = validation.path(path, "path")
    try:
        with naming_file(source), source.open(encoding="utf-8-sig", newline="") as file:
            header, *rows = [each for each in csv.reader(file) if any(map(str.strip, each))] or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"path: {str(source)!r} is no CSV file: {error}") from None
    names = [each.strip() for each in header]
    known = {*_COLUMNS, *_MORE_COLUMNS}
    missing = [each for each in _COLUMNS if each not in names]
    missing += [
        each for each in _MORE_COLUMNS[:3] if each not in names and any(name in names for name in _MORE_COLUMNS[:3])
    ]
    if missing or len(set(names)) != len(names) or not set(names) <= known:
        raise ValueError(
            f"path: {str(source)!r} must begin with columns {', '.join(_COLUMNS)}, and may have "
            f"{', '.join(_MORE_COLUMNS)}, each once, got {', '.join(map(repr, names[:12]))}"
        )
    if not rows or len(rows) > MOST_SHOTS:
        raise ValueError(f"path: {str(source)!r} must have 1 to {MOST_SHOTS} rows below its header, got {len(rows)}")
    numbers = np.empty((len(rows), len(names)))
    for index, row in enumerate(rows):
        try:
            numbers[index] = [float(each) for each in row]
        except ValueError:
            raise ValueError(f"path: row {index + 1} of {str(source)!r} must be {len(names)} numbers") from None
    if not np.isfinite(numbers).all():
        raise ValueError(f"path: {str(source)!r} must hold finite numbers")
    return names, numbers


def _between(rows: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """So many rows from the first to the last."""
    from scipy.interpolate import PchipInterpolator

    if len(rows) == 1:
        return np.repeat(rows, count, axis=0)
    places = np.linspace(0.0, len(rows) - 1.0, count)
    return np.asarray(PchipInterpolator(np.arange(len(rows)), rows, axis=0)(places), dtype=np.float64)


def _count(value: Any) -> int:
    count = validation.count(value, "count")
    if count > MOST_SHOTS:
        raise ValueError(f"count must be at most {MOST_SHOTS} frames, got {count}")
    return count


def _rotation(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """The matrix of a turn about a unit vector (Rodrigues)."""
    x, y, z = axis.tolist()
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)
