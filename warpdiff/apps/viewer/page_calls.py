"""Library calls that correspond to the values of a page's controls. They are executed, or printed as code."""

from __future__ import annotations

import functools
import math
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from warpdiff.apps.cli_options import CLEANING, COHERENCE_FLAGS
from warpdiff.apps.viewer.controls import LONG_BODIES, METALS, RULES, arguments, controls
from warpdiff.core import forks
from warpdiff.core.options import REQUIRED, describe
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.materials import check_reflection
from warpdiff.request.settings import PictureSettings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from warpdiff.apps.viewer.controls import Control
    from warpdiff.request.settings import TangentRule

# Number of directions in which an environment light is sampled per pixel of an unrefined preview. With 16 directions,
# the viewer shows about 14 pictures per second while the user drags; with more directions, it shows fewer pictures.
_MOVING_DIRECTIONS = 16
# Decimal places of coordinates in printed code. Further decimals would not change a picture.
_DIGITS = 7
_DISC_PITCHES_UM = {"CD": 0.08, "DVD": 0.06, "Blu-ray": 0.04}


@dataclass(frozen=True)
class Call:
    """Call of a public function or method, stored as data.

    Attributes:
        function: Name of the function in ``warpdiff``, or of a method if there is a ``receiver``.
        operands: Positional arguments of the call.
        options: Keyword arguments as pairs of name and value.
        receiver: Call that returns the object of the method; None for a function.
    """

    function: str
    operands: tuple[Any, ...] = ()
    options: tuple[tuple[str, Any], ...] = ()
    receiver: Call | None = None

    @classmethod
    def of(cls, function: str, *operands: Any, **options: Any) -> Call:
        """Return a stored call of a function with positional and keyword arguments."""
        return cls(function, operands, tuple(options.items()))

    def make(self) -> Any:
        """Execute the call, and first the calls among its arguments, and return the result."""
        owner: Any = wd if self.receiver is None else self.receiver.make()
        function = functools.reduce(getattr, self.function.split("."), owner)
        return function(*map(_result, self.operands), **{name: _result(value) for name, value in self.options})

    def __str__(self) -> str:
        """Return the call as Python source."""
        texts = [*map(_source, self.operands), *(f"{name}={_source(value)}" for name, value in self.options)]
        return f"{'wd' if self.receiver is None else self.receiver}.{self.function}({', '.join(texts)})"


def _rounded(vector: Iterable[float]) -> tuple[float, ...]:
    return tuple(round(float(component), _DIGITS) for component in vector)


def _result(value: Any) -> Any:
    return value.make() if isinstance(value, Call) else value


def _source(value: Any) -> str:
    """Return a value as Python source."""
    if isinstance(value, (Call, Path)):
        return str(value) if isinstance(value, Call) else repr(str(value))
    return 'float("inf")' if value == math.inf else repr(value)


@dataclass(frozen=True)
class NamedFiles:
    """Files that the command line names for the page, and options for loading height fields.

    Attributes:
        meshes: Mesh files that the page offers.
        heights: Files of height fields that the page offers.
        environments: Image files of environment lights that the page offers.
        loading: Options of ``HeightField.load``.
        cleaning: Cleaning methods of ``HeightField`` with their options, in order of application.
        dots: Arguments by name of a ``GratingMap``, which repeats every height field in small rectangles (dots) of the
            surface; empty without a map.
    """

    meshes: tuple[Path, ...] = ()
    heights: tuple[Path, ...] = ()
    environments: tuple[Path, ...] = ()
    loading: tuple[tuple[str, Any], ...] = ()
    cleaning: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...] = ()
    dots: tuple[tuple[str, Any], ...] = ()

    @forks.cached_property
    def controls(self) -> dict[str, Control]:
        """Controls of a page that offers these files, by name."""
        return controls(*([path.name for path in paths] for paths in (self.meshes, self.heights, self.environments)))


@dataclass(frozen=True)
class PageRequest:
    """Request of a page for a picture.

    Attributes:
        generation: Number of the request; the page increases it with every change.
        values: Values of all controls by name.
        camera: Camera, of which the image size is ignored; None selects the initial view of the body.
        aspect: Width of the requested picture divided by its height.
        moving: Whether a mouse button or finger is down, so that further changes may follow soon.
        probe: Position of the point whose local directions are shown, from the left and the top of the picture, 0 to 1.
    """

    generation: int
    values: Mapping[str, Any]
    camera: wd.View | None
    aspect: float
    moving: bool
    probe: tuple[float, float]


@dataclass(frozen=True)
class Scene:
    """Everything that determines a picture except the view: mesh (body), height field, lights and options.

    Attributes:
        mesh: Call that makes a sample body, or path of a mesh file.
        heightfield: Call that makes the height field.
        light: Call that makes the light; None if the environment is the only light.
        to_light: Direction from the body's centre to the light, world frame.
        distance: Distance of a point light from the body's centre, in radii of the body; 0 for a directional light.
        options: Options of ``Renderer`` and ``shade`` that differ from their defaults.
        tolerance: Tolerance of the final picture.
        sky: Call that makes the environment light; None without one.
        is_behind: Whether the environment is the background of the picture.
        dots: Arguments of the ``GratingMap`` that repeats the height field in small rectangles (dots) of the surface;
            empty without a map.
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
    dots: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, values: Mapping[str, Any], files: NamedFiles) -> Scene:
        """Return the scene that the checked values of the controls describe.

        If the selected light is a point light, this scene has a directional light instead. :meth:`placed` replaces this
        light by the point light, once centre and radius of the body are known.
        """
        known = files.controls
        mesh, tangents = _mesh(values, files)
        to_light = _towards(values["azimuth_deg"], values["elevation_deg"])
        sky, light = _environment(values, files), None
        if values["light"] != "none":
            light = Call.of("DirectionalLight", to_light=_rounded(to_light), **arguments(known, values, "light"))
        elif sky is None:
            raise ArgumentValueError(
                f"there is no light: select a {ref('light')}, or an {ref('environment')}, which requires "
                f"{ref('coherence', 'averaged')}"
            )
        options = arguments(known, values, "picture") | {"tangents": tangents}
        window = arguments(known, values, "coherence")
        if files.dots:
            # The default coherence of a grating map is not that of a height field. With a map, the coherence that the
            # page shows is therefore always passed explicitly.
            window = {"kind": values["coherence"]} | window
        if window:
            options["coherence"] = Call.of("Coherence", **window)
        if values["material"] in METALS:
            options["material"] = Call.of("Material.metal", values["material"])
        elif values["material"] == "mirror":
            options["ior"] = math.inf
        ordered = tuple((name, options[name]) for name in describe(PictureSettings) if options.get(name) is not None)
        return cls(
            mesh, _height_field(values, files), light, to_light, values["distance"] * (values["light"] == "point"),
            ordered, values["tolerance"], sky, sky is not None and values["environment_behind"], files.dots,
        )  # fmt: skip

    def placed(self, centre: Sequence[float], radius: float) -> Scene:
        """Return the scene with a point light at its position, which depends on centre and radius of the body.

        The power of the point light is such that the body's centre is as bright as in the light of the directional
        light, which the point light replaces.

        Args:
            centre: Centre of the body, world frame.
            radius: Radius of the body, world units.
        """
        if not self.distance or self.light is None:
            return self
        away = self.distance * radius
        position = _rounded(middle + away * along for middle, along in zip(centre, self.to_light, strict=True))
        options = dict(self.light.options) | {"to_light": position}
        options["power"] = float(f"{options.get('power', 1.0) * away * away:.{_DIGITS}g}")
        return replace(self, light=Call.of("PointLight", position=options.pop("to_light"), **options))

    @property
    def surface(self) -> Call:
        """Call that makes the surface: the height field, or the grating map with the height field as its cell.

        A grating map divides the surface into small rectangles, each with a copy of its cell.
        """
        return Call("GratingMap", (self.heightfield,), self.dots) if self.dots else self.heightfield

    @property
    def normal(self) -> float:
        """Reflectance at normal incidence by which pictures are divided; 1 if the mesh has a ``Material``."""
        shading = self.shading
        return check_reflection(shading.get("ior"), shading.get("material"))[0]

    def at(self, tolerance: float | None) -> Scene:
        """Return the scene for a preview or an intermediate picture, in which an environment light is simplified.

        The larger the tolerance, the fewer directions of an environment are sampled. The value None of ``tolerance`` is
        an unrefined preview. Such a preview samples 16 directions per pixel and has no shadows, because shadows
        increase the time for 320 × 240 pixels from 0.1 s to 1.9 s.
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
        """Options of ``Renderer`` and ``shade`` by name; values that are calls, as for a material, are executed."""
        return {name: _result(value) for name, value in self.options}

    def python(self, view: wd.View, tolerance: float, saving: Mapping[str, Any]) -> str:
        """Return Python code that renders the scene and saves the picture.

        Args:
            view: Camera of the picture.
            tolerance: Tolerance of the picture.
            saving: Options of ``Image.save``.
        """
        lights = [str(light) for light in (self.light, self.sky and "environment") if light is not None]
        camera = Call.of("View", view.eye, view.target, **_further(view))
        first = [f"environment = {self.sky}"] if self.sky is not None else []
        shown = {name: _source(value) for name, value in saving.items()}
        if self.is_behind:
            first.append(f"view = {camera}")
            # With a constant index of refraction, pictures are relative to the reflectance at normal incidence. The
            # radiance of the background is divided by the same reflectance.
            of_normal = "" if self.normal == 1.0 else f" / {self.normal!r}"
            shown["background"] = f"environment.background(view){of_normal}"
        lines = [
            _source(self.mesh), str(self.surface), lights[0] if len(lights) == 1 else f"[{', '.join(lights)}]",
            "view" if self.is_behind else str(camera), f"tolerance={tolerance!r}",
            *(f"{name}={_source(value)}" for name, value in self.options),
        ]  # fmt: skip
        end = "".join(f", {name}={text}" for name, text in shown.items())
        return "\n".join(
            [
                "import warpdiff as wd", "", *first, "renderer = wd.Renderer(", *(f"    {line}," for line in lines),
                ")", f'renderer.image().save("picture.png"{end})',
            ]
        )  # fmt: skip

    def command(self, view: wd.View, tolerance: float, saving: Mapping[str, Any]) -> str:
        """Return the command line that renders the scene and saves the picture.

        The picture of the command may differ from the viewer's picture by up to twice the tolerance, because each has
        an error of up to the tolerance. The command plans its computation for this one camera, and the viewer plans its
        computations for many cameras.
        """
        words = ["warpdiff", "render", _named(self.mesh), "--heightfield", *_height_field_words(self.heightfield)]
        for name, value in self.dots:
            words += ["--map", f"{name}={','.join(_texts(value))}"]
        if self.light is not None:
            words += ["--light", _named(self.light)]
        if self.sky is not None:
            words += _environment_words(self.sky)
        if self.is_behind:
            words.append("--environment-behind")
            saving = {name: value for name, value in saving.items() if name != "background"}
        words += _flags({"eye": view.eye, "target": view.target} | _further(view))
        words += _flags({"tolerance": tolerance} | dict(self.options))
        return shlex.join([*words, *_flags(saving), "-o", "picture.png"])


def _further(view: wd.View) -> dict[str, Any]:
    """Return the keyword arguments of ``View`` for a camera, except ``eye`` and ``target``."""
    return {name: getattr(view, name) for name in ("up", "fov_y_deg", "width", "height")}


def _texts(value: Any) -> Iterator[str]:
    """Yield a value as words of a command line. Numbers have no exponents, because argparse takes -1e-3 for a flag."""
    for element in value if isinstance(value, tuple) else (value,):
        yield np.format_float_positional(element, trim="0") if isinstance(element, float) else str(element)


def _flags(options: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield options as words of a command line.

    A value that a function call makes, such as ``Material.dielectric(1.4)``, becomes the arguments of the call.
    """
    for name, value in options.items():
        flag = COHERENCE_FLAGS.get(name, f"--{'no-' if value is False else ''}{prefix}{name.replace('_', '-')}")
        if isinstance(value, Call):
            yield from (flag, *value.operands) if value.operands else _flags(dict(value.options))
        else:
            yield from (flag,) if isinstance(value, bool) else (flag, *_texts(value))


def _named(call: Call | Path) -> str:
    """Return the word that stands for a mesh, a grating or a light on a command line: ``fingers:size_um=25.6``."""
    if isinstance(call, Path):
        return str(call)
    parameters = ",".join(f"{name}={'x'.join(_texts(value))}" for name, value in call.options)
    name = call.function.rpartition(".")[2].removesuffix("Light").lower()
    return f"{name}:{parameters}" if parameters else name


def _height_field_words(call: Call) -> list[str]:
    cleaning: list[str] = []
    while call.receiver is not None:
        cleaning[:0] = [CLEANING[call.function][0], *(str(value) for _, value in call.options)]
        call = call.receiver
    if call.function == "HeightField.load":
        return [call.operands[0], *_flags(dict(call.options)), *cleaning]
    # For gratings, the command line has other default values than the library. All parameters are therefore written.
    function = getattr(wd.gratings, call.function.rpartition(".")[2])
    defaults = {option.name: option.default for option in describe(function).values()} | dict(call.options)
    options = {name: value for name, value in defaults.items() if value not in (None, REQUIRED)}
    return [_named(Call.of(call.function, **options))]


def _environment_words(call: Call) -> Iterator[str]:
    """Yield the words of an environment light on the command line: ``--environment`` and its options."""
    options, (operand,) = dict(call.options), call.operands
    if call.function == "Environment.clear_sky":
        own = {name: options.pop(name) for name in tuple(options) if name not in describe(wd.Environment)}
        sky = Call.of("clear-sky", sun_direction=operand, **own)
        operand = _named(sky)
    yield from ("--environment", operand, *_flags(options, "environment-"))


def _towards(azimuth_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    """Return a unit vector by its azimuth (from the front, +z, to the right, +x) and its elevation (towards +y)."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    return math.cos(elevation) * math.sin(azimuth), math.sin(elevation), math.cos(elevation) * math.cos(azimuth)


def _environment(values: Mapping[str, Any], files: NamedFiles) -> Call | None:
    """Return the call that makes the selected environment light, from a file or as a clear sky; None without one."""
    known, name = files.controls, values["environment"]
    if name == "none" or not known["environment"].is_shown(values):
        return None
    options = arguments(known, values, "environment")
    if (path := _file(name, files.environments)) is not None:
        return Call.of("Environment.load", str(path), **options)
    to_sun = _towards(values["sun_azimuth_deg"], values["sun_elevation_deg"])
    return Call.of("Environment.clear_sky", _rounded(to_sun), **options)


def _mesh(values: Mapping[str, Any], files: NamedFiles) -> tuple[Call | Path, TangentRule | None]:
    """Return the selected mesh (body), and the rule for the direction of the height field's x axis.

    The rule is None if the texture coordinates of the body determine the direction.
    """
    name = values["mesh"]
    axis = values["along" if name in LONG_BODIES else "tangent"]
    tangents = axis if axis in RULES else None
    if (path := _file(name, files.meshes)) is not None:
        return path, tangents
    return Call(f"meshes.{name}", options=(("tangent", "along"),) if axis == "along" else ()), tangents


def _file(name: str, paths: Sequence[Path]) -> Path | None:
    """Return the file that a control's value such as "file 0" selects by its index; None for other values."""
    kind, _, index = name.partition(" ")
    return paths[int(index)] if kind == "file" else None


def _height_field(values: Mapping[str, Any], files: NamedFiles) -> Call:
    name = values["surface"]
    if (path := _file(name, files.heights)) is not None:
        call = Call("HeightField.load", (str(path),), files.loading)
        for method, options in files.cleaning:
            call = Call(method, (), options, call)
        return call
    pitch = {"pitch_um": _DISC_PITCHES_UM[values["disc_kind"]]} if name == "disc" else {}
    return Call.of(f"gratings.{name}", **arguments(files.controls, values, "heightfield"), **pitch)
