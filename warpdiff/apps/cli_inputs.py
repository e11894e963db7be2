"""Inputs of the command line: height fields, meshes, materials and lights that the values of flags describe."""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import warpdiff as wd
from warpdiff.apps.cli_options import CLEANING, given
from warpdiff.core import validation
from warpdiff.core.options import describe
from warpdiff.core.wording import ArgumentValueError, did_you_mean, marked, ref, renaming
from warpdiff.optics import colorimetry
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import Metal
from warpdiff.scene.part_names import REST

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from warpdiff.heightfield.grating_map import DotValues


# Synthetic height fields by their name on the command line. An entry consists of the name of a function of
# ``wd.gratings`` and of default arguments for this function.
GRATINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "sinusoidal": ("sinusoidal", {"period_um": 2.0, "depth_um": 0.25}),
    "lamellar": ("lamellar", {"period_um": 2.0, "depth_um": 0.25}),
    "blazed": ("blazed", {"period_um": 2.0, "depth_um": 0.25}),
    "cd": ("disc", {"kind": "CD", "tracks": 40, "length_um": 64.0, "pitch_um": 0.08}),
    "dvd": ("disc", {"kind": "DVD", "tracks": 87, "length_um": 64.0, "pitch_um": 0.06}),
    "blu-ray": ("disc", {"kind": "Blu-ray", "tracks": 100, "length_um": 32.0, "pitch_um": 0.04}),
    "bumps": ("bumps", {}),
    "fingers": ("fingers", {"size_um": 64.0, "pitch_um": 0.08}),
}
BODIES: dict[str, tuple[str, dict[str, Any]]] = {
    "tube": ("tube", {}), "tube-along": ("tube", {"tangent": "along"}), "disc": ("disc", {}), "card": ("card", {}),
    "snake": ("snake", {}),
}  # fmt: skip
# Public lights by their kind on the command line: ``point`` is ``PointLight``.
_LIGHTS = {name.removesuffix("Light").lower(): name for name in dir(wd) if name.endswith("Light")}
# Text of ``--environment`` that selects a computed clear sky instead of a file; and the default direction to the sun of
# this sky, in the world frame. The direction points up, to the right and towards the default camera.
_CLEAR_SKY, _SUN_DIRECTION = "clear-sky", (0.6, 1.0, 0.4)
METAL_SYMBOLS = get_args(Metal)
# Quantities that the flag ``--map`` sets. A grating map divides a surface into small rectangles (dots), and each dot
# has a copy of one grating. The quantities are the rotation of a copy, the factor of its heights, and that of its
# lengths.
_MAPPED = ("turn_deg", "depth_scale", "pitch_scale")
# Flags that set the arguments of a grating map (small rectangles with one grating each), as messages name them.
MAP_FLAGS = {name: f"--map {name}" for name in _MAPPED}
# Value of ``--surface`` for a surface without a height field.
_PLAIN = "plain"


def _named(text: str, functions: dict[str, tuple[str, dict[str, Any]]], module: Any, flag: str) -> Any:
    """Return the object that a text such as ``fingers:size_um=25.6`` describes; None if the text names no function.

    Args:
        text: Text from the command line: the name of a function, optionally with parameters after a colon.
        functions: Functions of the module by their name on the command line, with default parameters.
        module: Module of the functions.
        flag: Name of the Python argument that the text sets. Error messages print its flag or operand.
    """
    name, colon, parameters = text.partition(":")
    if name.lower() in functions:
        function, defaults = functions[name.lower()]
    elif colon and inspect.isfunction(getattr(module, name, None)) and not name.startswith("_"):
        function, defaults = name, {}
    else:
        return None
    return _called(text, getattr(module, function), parameters, defaults, flag)


def _called(text: str, function: Callable[..., Any], parameters: str, defaults: dict[str, Any], flag: str) -> Any:
    """Call a function with parameters from a text ``name=value,…``, which override the defaults."""
    known = [name for name in inspect.signature(function).parameters if name != "_"]
    values = {}
    for assignment in filter(None, parameters.split(",")):
        name, equals, value = assignment.partition("=")
        if not equals or name not in known:
            raise ArgumentValueError(
                f"{ref(flag)} {text!r} has {assignment!r}, but its parameters are {', '.join(known)}, each as "
                "name=value"
                f"{did_you_mean(name, known)}"
            )
        values[name] = illuminant_of(value) if name == "illuminant" else _value(value)
    for parameter in inspect.signature(function).parameters.values():
        if parameter.default is parameter.empty and parameter.name not in defaults | values:
            raise ArgumentValueError(f"{ref(flag)} {text!r} requires the parameter {parameter.name}")
    try:
        return function(**defaults | values)
    except (TypeError, ValueError) as error:
        raise ArgumentValueError(f"{ref(flag)} {text!r}: {error}") from None


def _value(text: str) -> Any:
    """Return the value in a text: a number, a tuple for numbers that ``x`` joins (``2x3``), or else the text itself."""
    if re.fullmatch(r"[-+\d.e]+(x[-+\d.e]+)+", text):
        return tuple(map(_value, text.split("x")))
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def height_field_of(options: argparse.Namespace) -> wd.HeightField:
    """Return the height field that the command line names, a file or a synthetic grating, after cleaning."""
    # Commands that use no mesh accept the height field as a positional argument instead of a flag.
    return _height_field(options.scan if options.heightfield is None else options.heightfield, "heightfield", options)


def surfaces_of(
    options: argparse.Namespace,
) -> wd.HeightField | wd.GratingMap | dict[str, wd.HeightField | wd.GratingMap | None]:
    """Return the height field of the whole mesh; with ``--surface``, return a dictionary of height fields by mesh part.

    The dictionary has one entry for all parts of the mesh that ``--surface`` does not name. The value None is a surface
    without a height field. With ``--map``, the height field of ``--heightfield`` is a grating, which a grating map
    repeats in small rectangles (dots).
    """
    maps = getattr(options, "map", None)
    heightfield = map_of(height_field_of(options), maps)
    # A page shows one height field, so that the command ``export-html`` has no flag ``--surface``.
    texts = getattr(options, "surface", None)
    if not texts:
        return heightfield
    surfaces: dict[str, wd.HeightField | wd.GratingMap | None] = {}
    for text in texts:
        part, equals, surface = text.partition("=")
        if not equals or not part or not surface:
            raise ArgumentValueError(
                f"{ref('surface')} must be PART=HEIGHTFIELD or PART={_PLAIN}, got {text!r}; a part is the name of a "
                "geometry or a material"
            )
        if part in surfaces:
            raise ArgumentValueError(f"{ref('surface')} must name each part once, got {part!r} twice")
        surfaces[part] = None if surface == _PLAIN else _height_field(surface, "surface", options)
    if REST not in surfaces:
        return surfaces | {REST: heightfield}
    if maps:
        raise ArgumentValueError(
            f"{ref('map')} changes {ref('heightfield')}, which no part has with {ref('surface')} {REST}=…: omit one of "
            "them"
        )
    return surfaces


def map_of(cell: wd.HeightField, texts: list[str] | None) -> wd.HeightField | wd.GratingMap:
    """Return the grating map of ``--map`` flags; without such flags, the height field ``cell`` unchanged.

    A grating map divides the surface into small rectangles (dots). Each dot has the grating ``cell`` with its own
    direction, depth and pitch.
    """
    values = dots_of(texts)
    if not values:
        return cell
    with renaming(MAP_FLAGS | {"cell": "--heightfield"}):
        return wd.GratingMap(cell, **values)


def dots_of(texts: list[str] | None) -> dict[str, DotValues]:
    """Return the arguments of ``GratingMap`` by name, from the texts of ``--map`` flags; empty without flags.

    A grating map divides a surface into small rectangles (dots). The arguments are the rotation of the grating in each
    dot, and the factors of its heights and lengths.
    """
    values: dict[str, DotValues] = {}
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not equals or name not in _MAPPED:
            near = "" if name in _MAPPED else did_you_mean(name, _MAPPED)
            raise ArgumentValueError(
                f"{ref('map')} must be NAME=VALUE with a NAME of {', '.join(_MAPPED)}, got {text!r}{near}"
            )
        if not value:
            raise ArgumentValueError(
                f"{ref('map')} must have a value after {name}=, got {text!r}: a number, IMAGE or IMAGE,BLACK,WHITE"
            )
        if name in values:
            raise ArgumentValueError(f"{ref('map')} must give each value once, got {name!r} twice")
        values[name] = _dot_value(text, name, value)
    return values


def _dot_value(text: str, name: str, value: str) -> Any:
    """Return the values of the dots (small rectangles) of a grating map, from the text after ``NAME=`` of ``--map``.

    The result is a number for all dots, or the path of an image with a pixel per dot. The path may be in a tuple with
    the values for which black and white in the image stand.
    """
    number = _value(value)
    if not isinstance(number, str):
        return number
    path, *ends = value.rsplit(",", 2)
    numbers = [_value(end) for end in ends]
    if len(ends) == 2 and all(isinstance(number, (int, float)) for number in numbers):
        return path, *numbers
    # A text with one comma is accepted as the name of a file, unless the text ends in a number. With two commas, both
    # texts after the name must be numbers. An image for ``pitch_scale`` always needs the two numbers, the values of
    # black and white.
    if len(ends) == 2 or (ends and isinstance(numbers[-1], (int, float))) or name == "pitch_scale":
        raise ArgumentValueError(
            f"{ref('map')} must have two numbers after the image, the values of black and white, got {text!r}: write "
            f"{name}=IMAGE,BLACK,WHITE, such as {name}=dots.png,0.8,1.25"
        )
    return value


def _height_field(text: str, flag: str, options: argparse.Namespace) -> wd.HeightField:
    """Return the height field of a file or a synthetic grating after cleaning. Errors name the argument ``flag``."""
    made = _named(text, GRATINGS, wd.gratings, flag)
    if made is None:
        if not validation.path(text, flag).is_file():
            names = list(GRATINGS)
            raise marked(
                FileNotFoundError,
                f"{ref(flag)}: there is no file {text!r}; a synthetic one is called by its name, one of "
                f"{', '.join(names)}{did_you_mean(text, names)}",
            )
        return cleaned_of(scan_of(text, options), options)
    loading = given(options, describe(wd.HeightField.load))
    # Options for loading files have no effect on a synthetic grating and are refused. With ``--surface`` they are
    # accepted, because the height field of another part of the mesh may be a file.
    if loading and not getattr(options, "surface", None):
        raise ArgumentValueError(f"{ref(next(iter(loading)))} is for files, got {ref(flag)} {text!r}: omit it")
    return cleaned_of(made, options)


def scan_of(path: str, options: argparse.Namespace) -> wd.HeightField:
    """Return the height field of a file, before cleaning."""
    with renaming({"path": "--heightfield"}):
        return wd.HeightField.load(path, **given(options, describe(wd.HeightField.load)))


def cleaning_of(options: argparse.Namespace) -> list[tuple[str, tuple[tuple[str, Any], ...]]]:
    """Return the cleaning methods of ``HeightField`` that the flags select, in order of application, with arguments."""
    result: list[tuple[str, tuple[tuple[str, Any], ...]]] = []
    for method, (flag, argument) in CLEANING.items():
        value = getattr(options, flag.removeprefix("--").replace("-", "_"))
        if value not in (None, False):
            result.append((method, () if argument is None else ((argument, value),)))
    return result


def cleaned_of(heightfield: wd.HeightField, options: argparse.Namespace) -> wd.HeightField:
    """Return the height field after the cleaning methods that the flags select."""
    for name, arguments in cleaning_of(options):
        heightfield = getattr(heightfield, name)(**dict(arguments))
    return heightfield


def coherence_of(options: argparse.Namespace) -> Coherence | None:
    """Return the coherence (how far light interferes) that the flags describe; None without such flags."""
    values = given(options, describe(Coherence))
    return Coherence(**values) if values else None


def settings_of(options: argparse.Namespace, settings: Any) -> dict[str, Any]:
    """Return the settings of a computation that the flags set, including ``material`` and ``coherence``, by name."""
    return given(options, describe(settings)) | {"coherence": coherence_of(options), "material": material_of(options)}


def material_of(options: argparse.Namespace) -> wd.Material | None:
    """Return the material of ``--material``, coated with the film of ``--film``; None without ``--material``."""
    if options.material is None:
        if options.film is not None:
            raise ArgumentValueError(f"{ref('film')} requires {ref('material')}: give both")
        return None
    material = _named_material(options.material, "material")
    if options.film is None:
        return material
    name, thickness = options.film
    try:
        thickness_nm = float(thickness)
    except ValueError:
        raise ArgumentValueError(
            f"{ref('film')} must be a material and a number of nanometres, got {thickness!r}"
        ) from None
    with renaming({"thickness_nm": "--film"}):
        return material.coated(_named_material(name, "film"), thickness_nm)


def _named_material(name: str, option: str) -> wd.Material:
    """Return the material of a name: a metal's symbol, a constant index of refraction, or a file's path."""
    if name in METAL_SYMBOLS:
        return wd.Material.metal(name)  # type: ignore[arg-type]
    with renaming({"path": f"--{option}", "n": f"--{option}"}):
        try:
            index = float(name)
        except ValueError:
            if not validation.path(name, option).is_file():
                raise ArgumentValueError(
                    f"{ref(option)} must be one of {', '.join(METAL_SYMBOLS)}, an index of refraction, or a file, got "
                    f"{name!r}{did_you_mean(name, METAL_SYMBOLS)}"
                ) from None
            return wd.Material.from_file(name)
        return wd.Material.dielectric(index)


def illuminant_of(text: str) -> str | wd.Spectrum:
    """Return the name of an illuminant unchanged, or a spectrum: of a black body such as ``2856K``, or from a file."""
    with renaming({"path": "--illuminant", "temperature_k": "--illuminant"}):
        if re.fullmatch(r"[0-9.]+K", text):
            with contextlib.suppress(ValueError):
                return wd.Spectrum.blackbody(float(text[:-1]))
            raise ArgumentValueError(
                f"{ref('illuminant')} must be a temperature of 500K to 100000K, got {text!r}"
            ) from None
        # Names of illuminants may contain a full stop, such as FL3.1, so that a suffix alone does not indicate a file.
        is_file = Path(text).suffix and not colorimetry.is_known_illuminant(text)
        return wd.Spectrum.from_csv(text) if is_file else text


def lights_of(options: argparse.Namespace, view: wd.View, environment: wd.Environment | None = None) -> list[Any]:
    """Return the lights of the ``--light`` flags and the environment.

    Without any light, return one directional light that comes from above and to the right of the camera.
    """
    illuminant, lights = illuminant_of(options.illuminant), []
    for text in options.light or ():
        kind, colon, parameters = text.partition(":")
        if colon:
            if kind not in _LIGHTS:
                raise ArgumentValueError(
                    f"{ref('light')} {text!r} must begin with {' or '.join(repr(f'{name}:') for name in _LIGHTS)}"
                    f"{did_you_mean(kind, _LIGHTS)}"
                )
            lights.append(_called(text, getattr(wd, _LIGHTS[kind]), parameters, {"illuminant": illuminant}, "light"))
            continue
        try:
            x, y, z = map(float, text.split())
        except ValueError:
            raise ArgumentValueError(
                f"{ref('light')} must be three numbers X Y Z, or KIND:name=value,…, got {text!r}"
            ) from None
        lights.append(wd.DirectionalLight((x, y, z), illuminant=illuminant))
    if environment is not None:
        lights.append(environment)
    if not lights:
        frame = view.frame()
        to_light = tuple((frame.back + 0.6 * frame.up + 0.3 * frame.right).tolist())
        lights.append(wd.DirectionalLight(to_light, illuminant=illuminant))
    return lights


def environment_of(options: argparse.Namespace) -> wd.Environment | None:
    """Return the environment light of the ``--environment`` flags; None without them."""
    described = describe(wd.Environment.load)
    values = given(options, described, "environment_")
    words = {name: f"--environment-{described[name].dashed}" for name in described} | {"path": "--environment"}
    # The command ``sequence`` has no flag ``--environment-behind``, so the parsed arguments may lack it.
    is_behind = getattr(options, "environment_behind", False)
    if options.environment is None:
        if values or is_behind:
            flag = words[next(iter(values))] if values else "--environment-behind"
            raise ArgumentValueError(f"{flag} requires --environment")
        return None
    if is_behind and "background" in options:
        raise ArgumentValueError("--environment-behind and --background both set the background: give one of them")
    if is_behind and Path(options.output).suffix.lower() != ".png":
        raise ArgumentValueError(f"--environment-behind is for .png files, got --output {options.output}")
    name, _, parameters = options.environment.partition(":")
    if name == _CLEAR_SKY:
        if "rotation_deg" in values:
            raise ArgumentValueError(
                f"{words['rotation_deg']} is for files, got {options.environment}: give its sun_direction"
            )
        defaults = {"sun_direction": _SUN_DIRECTION} | values
        sky: wd.Environment = _called(
            options.environment, wd.Environment.clear_sky, parameters, defaults, "environment"
        )
        return sky
    with renaming(words):
        return wd.Environment.load(options.environment, **values)


def scene_of(options: argparse.Namespace, *, turning: bool = False) -> tuple[Any, Any, wd.View]:
    """Return the mesh, the height fields of its surfaces, and the camera (`View`) that the command line names.

    Unless the user gives the position of the camera, the camera is placed so that the whole mesh fits into the picture.
    With ``turning``, the mesh fits into all pictures of a rotation.
    """
    heightfield = surfaces_of(options)
    mesh = _named(options.mesh, BODIES, wd.meshes, "mesh")
    mesh = options.mesh if mesh is None else mesh
    values = given(options, describe(wd.View))
    eye, extent_y = values.pop("eye", None), values.pop("extent_y", None)
    if eye is not None and "target" in values:
        return mesh, heightfield, wd.View(eye, extent_y=extent_y, **values)
    view = wd.View.fit(mesh, **values, turning=turning)
    return mesh, heightfield, dataclasses.replace(view, eye=view.eye if eye is None else eye, extent_y=extent_y)
