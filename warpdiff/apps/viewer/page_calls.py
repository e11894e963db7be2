"""What a page of the viewer has set, as calls of the library: to be made, or to be written down."""

from __future__ import annotations

import functools
import math
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import warpdiff as wd
from warpdiff.apps.viewer.controls import AXES, LONG_BODIES, METALS
from warpdiff.optics.materials import check_reflection

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

# Of an environment while something moves.
_MOVING_DIRECTIONS = 128
# Digits of a direction in lines: beyond them no picture changes.
_DIGITS = 7
_DISC_PITCHES_UM = {"CD": 0.08, "DVD": 0.06, "Blu-ray": 0.04}


@dataclass(frozen=True)
class Call:
    """A call of something public.

    Attributes:
        function: Its name in ``warpdiff``, or of a method of what ``on`` makes.
        operands: What it takes by position.
        options: What it takes by name.
        on: Whose method it is.
    """

    function: str
    operands: tuple[Any, ...] = ()
    options: tuple[tuple[str, Any], ...] = ()
    on: Call | None = None

    @classmethod
    def of(cls, function: str, *operands: Any, on: Call | None = None, **options: Any) -> Call:
        """A call with these arguments."""
        return cls(function, operands, tuple(options.items()), on)

    def make(self) -> Any:
        """Call it."""
        owner: Any = wd if self.on is None else self.on.make()
        function = functools.reduce(getattr, self.function.split("."), owner)
        return function(*map(_made, self.operands), **{name: _made(each) for name, each in self.options})

    def __str__(self) -> str:
        """The line of Python."""
        taken = [*map(_said, self.operands), *(f"{name}={_said(each)}" for name, each in self.options)]
        return f"{'wd' if self.on is None else self.on}.{self.function}({', '.join(taken)})"


def _rounded(vector: Iterable[float]) -> tuple[float, ...]:
    return tuple(round(float(each), _DIGITS) for each in vector)


def _made(value: Any) -> Any:
    return value.make() if isinstance(value, Call) else value


def _said(value: Any) -> str:
    if isinstance(value, Call):
        return str(value)
    if isinstance(value, Path):
        return repr(str(value))
    if isinstance(value, float) and math.isinf(value):
        return 'float("inf")'
    return repr(value)


@dataclass(frozen=True)
class NamedFiles:
    """Files that were named when the viewer was started, and how the scans among them are loaded.

    Attributes:
        meshes: Of bodies.
        heights: Of height fields.
        environments: Of skies and rooms.
        loading: Options of ``HeightField.load``.
        cleaning: Methods of a height field with their options, one after the other.
    """

    meshes: tuple[Path, ...] = ()
    heights: tuple[Path, ...] = ()
    environments: tuple[Path, ...] = ()
    loading: tuple[tuple[str, Any], ...] = ()
    cleaning: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...] = ()


@dataclass(frozen=True)
class Scene:
    """What is to be seen but for the view: everything that pictures of a renderer share, and the light.

    Attributes:
        mesh: A call of ``meshes``, or a file.
        heightfield: The height field.
        light: The light; None is none beside the environment.
        to_light: The direction from the body's centre to it, world frame.
        distance: Its distance from there, in the body's radii; 0 is far away.
        options: Of ``Renderer`` and ``shade``, those that are not the default.
        tolerance: Of the finest picture.
        sky: The environment, if there is one.
        is_behind: Whether it is seen behind the body.
    """

    mesh: Call | Path
    heightfield: Call
    light: Call | None
    to_light: tuple[float, float, float]
    distance: float
    options: tuple[tuple[str, Any], ...]
    tolerance: float
    sky: Call | None = None
    is_behind: bool = False

    @classmethod
    def of(cls, values: Mapping[str, Any], files: NamedFiles) -> Scene:
        """The scene of checked settings; a light beside the body is at its place once :meth:`placed`."""
        mesh, tangents = _mesh(values, files)
        azimuth, elevation = math.radians(values["azimuth_deg"]), math.radians(values["elevation_deg"])
        # From the front, +z, to the right, +x; y is up.
        to_light = (
            math.cos(elevation) * math.sin(azimuth), math.sin(elevation), math.cos(elevation) * math.cos(azimuth),
        )  # fmt: skip
        illuminant = {} if values["illuminant"] == "D65" else {"illuminant": values["illuminant"]}
        is_near, coherence = values["light"] == "near", _coherence(values)
        has_extent = values["light_diameter_deg"] > 0.0 and not is_near and values["coherence"] == "averaged"
        size = {"angular_diameter_deg": values["light_diameter_deg"]} if has_extent else {}
        sky = _sky(values, files)
        light = None
        if values["light"] != "none":
            power = {} if sky is None else {"power": values["light_power"]}
            light = Call.of("DirectionalLight", _rounded(to_light), **illuminant, **size, **power)
        elif sky is None:
            raise ValueError("there is no light: choose one, or an environment, which takes averaged coherence")
        options = {
            "method": values["method"],
            "coherence": coherence,
            "ior": {"dielectric": values["ior"], "mirror": math.inf}.get(values["material"], 1.5),
            "material": Call.of("Material.metal", values["material"]) if values["material"] in METALS else None,
            "masking": values["masking"] or values["energy"] == "normalised",
            "energy": values["energy"],
            "pigment": values["pigment"],
            "shadows": values["shadows"],
            "smooth": values["smooth"],
            "tangents": tangents,
        }
        usual = {
            "method": "auto", "coherence": None, "ior": 1.5, "material": None, "masking": True, "energy": "stam",
            "pigment": 1.0, "shadows": True, "smooth": True, "tangents": None,
        }  # fmt: skip
        changed = tuple((name, value) for name, value in options.items() if value != usual[name])
        distance = values["distance"] if is_near else 0.0
        return cls(
            mesh, _height_field(values, files), light, to_light, distance, changed, values["tolerance"], sky,
            sky is not None and values["environment_behind"],
        )  # fmt: skip

    def placed(self, centre: Sequence[float], radius: float) -> Scene:
        """The scene with its light beside a body of this centre and radius, as bright there as one far away."""
        if not self.distance or self.light is None:
            return self
        away = self.distance * radius
        position = _rounded(middle + away * along for middle, along in zip(centre, self.to_light, strict=True))
        options = dict(self.light.options)
        options["power"] = float(f"{options.get('power', 1.0) * away * away:.{_DIGITS}g}")
        return replace(self, light=Call.of("PointLight", position, **options))

    @property
    def normal(self) -> float:
        """What pictures are relative to."""
        shading = self.shading
        return check_reflection(shading.get("ior"), shading.get("material"))[0]

    def at(self, tolerance: float | None) -> Scene:
        """What is drawn on the way: fewer directions of an environment serve a larger tolerance.

        Unrefined, where that is None, it has fewer still, and casts no shadows: with them, a picture of 320 × 240 takes
        1.9 s, without 0.1.
        """
        if self.sky is None:
            return self
        if tolerance is not None:
            return replace(self, tolerance=tolerance)
        quick = dict(self.sky.options) | {"directions": _MOVING_DIRECTIONS}
        options = dict(self.options) | {"shadows": False}
        return replace(self, sky=replace(self.sky, options=tuple(quick.items())), options=tuple(options.items()))

    @property
    def shading(self) -> dict[str, Any]:
        """The options, made."""
        return {name: _made(value) for name, value in self.options}

    def python(self, view: wd.View, tolerance: float, saved: Mapping[str, Any]) -> str:
        """Lines of Python that make a picture of a view and save it."""
        lights = [str(self.light)] if self.light is not None else []
        lights += ["environment"] if self.sky is not None else []
        behind, first = "", [f"environment = {self.sky}"] if self.sky is not None else []
        first += [f"view = {_view_call(view)}"] if self.is_behind else []
        if self.is_behind:
            # Pictures by an index of refraction are relative to what it reflects at normal incidence.
            of_normal = "" if self.normal == 1.0 else f" / {self.normal!r}"
            behind = f", background=environment.background(view){of_normal}"
        shown = {name: value for name, value in saved.items() if not (self.is_behind and name == "background")}
        operands = [
            _said(self.mesh), str(self.heightfield), lights[0] if len(lights) == 1 else f"[{', '.join(lights)}]",
            "view" if self.is_behind else str(_view_call(view)),
        ]  # fmt: skip
        options = [f"tolerance={tolerance!r}", *(f"{name}={_said(value)}" for name, value in self.options)]
        saving = "".join(f", {name}={_said(value)}" for name, value in shown.items()) + behind
        return "\n".join(
            [
                "import warpdiff as wd",
                "",
                *first,
                "renderer = wd.Renderer(",
                *(f"    {each}," for each in [*operands, *options]),
                ")",
                f'renderer.image().save("picture.png"{saving})',
            ]
        )

    def command(self, view: wd.View, tolerance: float, saved: Mapping[str, Any], files: NamedFiles) -> str:
        """The command that makes the picture by a plan for its own directions: the same within both tolerances."""
        words: list[Any] = ["warpdiff", "render", _word(self.mesh)]
        heightfield, cleaning = self.heightfield, []
        while heightfield.on is not None:
            cleaning.append(heightfield)
            heightfield = heightfield.on
        words.append(heightfield.operands[0] if heightfield.function == "HeightField.load" else _word(heightfield))
        if heightfield.function == "HeightField.load":
            words += _flags(dict(files.loading), {"pitch_um": "--pixel-um"})
            for each in reversed(cleaning):
                words += [_CLEANING[each.function], *(value for _, value in each.options)]
        if self.light is not None:
            (at,), illuminated = self.light.operands, dict(self.light.options)
            words += ["--point-light", *at, illuminated.pop("power")] if self.distance else ["--light", *at]
            words += _flags(illuminated, {"angular_diameter_deg": "--light-diameter-deg", "power": "--light-power"})
        if self.sky is not None:
            words += ["--environment", *self.sky.operands]
            words += _flags({f"environment_{name}": value for name, value in self.sky.options})
        if self.is_behind:
            words.append("--environment-behind")
            saved = {name: value for name, value in saved.items() if name != "background"}
        words += ["--eye", *view.eye, "--target", *view.target, "--up", *view.up]
        words += _flags({"fov_y_deg": view.fov_y_deg, "width": view.width, "height": view.height})
        words += _flags({"tolerance": tolerance})
        for name, value in self.options:
            if isinstance(value, Call):
                words += [f"--{name}", *value.operands, *_flags(dict(value.options))]
            elif isinstance(value, bool):
                words.append({"masking": "--no-masking", "shadows": "--no-shadows", "smooth": "--flat"}[name])
            else:
                words += _flags({name: value}, {"tangents": "--tangent"})
        words += _flags(saved)
        return shlex.join([*map(str, words), "-o", "picture.png"])


# Of methods that clean a height field, what the command line calls them.
_CLEANING = {
    "cropped": "--crop-um",
    "levelled": "--level",
    "despiked": "--despike",
    "filled": "--fill",
    "periodic": "--periodic",
}


def _flags(options: Mapping[str, Any], names: Mapping[str, str] | None = None) -> list[Any]:
    """Words of the command line."""
    found: list[Any] = []
    for name, value in options.items():
        found.append((names or {}).get(name) or f"--{name.replace('_', '-')}")
        found += value if isinstance(value, tuple) else [value]
    return found


def _word(what: Call | Path) -> str:
    """How the command line calls a body or a grating with its parameters."""
    if isinstance(what, Path):
        return str(what)
    name = what.function.rpartition(".")[2]
    taken = ",".join(
        f"{key}={'x'.join(map(str, value)) if isinstance(value, tuple) else value}" for key, value in what.options
    )
    return f"{name}:{taken}" if taken else name


def _view_call(view: wd.View) -> Call:
    return Call.of(
        "View", view.eye, view.target, up=view.up, fov_y_deg=view.fov_y_deg, width=view.width, height=view.height
    )


def _mesh(values: Mapping[str, Any], files: NamedFiles) -> tuple[Call | Path, tuple[float, float, float] | None]:
    """The body, and the direction of the height field's x where the body does not have it."""
    name = values["mesh"]
    lies = values["along" if name in LONG_BODIES else "tangent"]
    unit = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    tangents = unit[lies] if lies in AXES else None
    if (path := _file(name, files.meshes)) is not None:
        return path, tangents
    return Call(f"meshes.{name}", options=(("tangent", "along"),) if lies == "along" else ()), tangents


def _file(name: str, paths: Sequence[Path]) -> Path | None:
    """The file that a control calls "file 0", "file 1" and so on."""
    kind, _, index = name.partition(" ")
    return paths[int(index)] if kind == "file" else None


def _height_field(values: Mapping[str, Any], files: NamedFiles) -> Call:
    name = values["surface"]
    if (path := _file(name, files.heights)) is not None:
        found = Call("HeightField.load", (str(path),), files.loading)
        for method, options in files.cleaning:
            found = Call(method, (), options, found)
        return found
    call = functools.partial(Call.of, f"gratings.{name}")
    if name == "fingers":
        return call(
            size_um=values["fingers_size_um"], period_um=values["fingers_period_um"],
            length_um=values["fingers_length_um"], height_um=values["fingers_height_um"], seed=values["seed"],
        )  # fmt: skip
    if name == "bumps":
        return call(
            height_um=values["bumps_height_um"], width_um=values["bumps_width_um"],
            length_um=values["bumps_length_um"],
            spacing_um=(values["bumps_spacing_y_um"], values["bumps_spacing_x_um"]),
        )  # fmt: skip
    if name == "disc":
        kind = values["disc_kind"]
        return call(kind=kind, length_um=values["disc_length_um"], pitch_um=_DISC_PITCHES_UM[kind], seed=values["seed"])
    duty = {"duty": values["duty"]} if name == "lamellar" else {}
    return call(period_um=values["period_um"], depth_um=values["depth_um"], **duty)


def _sky(values: Mapping[str, Any], files: NamedFiles) -> Call | None:
    """The environment, of averaged windows alone."""
    path = _file(values.get("environment", "none"), files.environments)
    if path is None or values["coherence"] != "averaged":
        return None
    taken = {name: values[f"environment_{name}"] for name in ("rotation_deg", "scale", "directions")}
    usual = {"rotation_deg": 0.0, "scale": 1.0, "directions": 0}
    return Call.of(
        "Environment.load", str(path), **{name: value for name, value in taken.items() if value != usual[name]}
    )


def _coherence(values: Mapping[str, Any]) -> Call | None:
    """None where it is the default."""
    kind = values["coherence"]
    call = functools.partial(Call.of, "Coherence", kind)
    if kind == "source":
        return call(angular_diameter_deg=values["angular_diameter_deg"])
    if kind == "replicas":
        return call(periods=(values["copies_y"], values["copies_x"]))
    found = call(sigma_um=values["sigma_um"])
    return None if found.make() == wd.Coherence() else found
