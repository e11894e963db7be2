"""The command line: ``demo``, ``render``, ``sequence``, ``brdf``, ``export-html``, ``info``, ``view`` and ``cache``.

Exit codes: 0 done, 1 failure, 2 bad input, 130 interrupted, 143 terminated, 129 hung up.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import importlib.util
import inspect
import math
import re
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, get_args

import numpy as np

import warpdiff as wd
from warpdiff.apps.cli_options import CLEANING, COHERENCE_FLAGS, Flags, given, integer, number, word
from warpdiff.core import disk_cache, files, validation
from warpdiff.core.options import describe
from warpdiff.core.wording import ArgumentValueError, did_you_mean, marked, ref, renaming, spelled
from warpdiff.image.image import check_target
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import Metal, check_reflection
from warpdiff.request.settings import EvaluationSettings, PictureSettings, SinglePictureSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

# Synthetic height fields by name: function of ``wd.gratings``, with the parameters that the command line begins with.
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
_BODIES: dict[str, tuple[str, dict[str, Any]]] = {
    "tube": ("tube", {}), "tube-along": ("tube", {"tangent": "along"}), "disc": ("disc", {}), "snake": ("snake", {}),
}  # fmt: skip
_LIGHTS = {"directional": "DirectionalLight", "point": "PointLight"}
METAL_SYMBOLS = get_args(Metal)
_MOST_PORT, _GRAZING_DEG = 65_535, 90.0
# Errors of the file system that concern a path of the user; a full disk is a failure.
_BAD_PATHS = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
_HEIGHT_FIELD_HELP = (
    "scan, or a synthetic height field: an image (8 or 16 bit grey, or float), .npy or .npz; or one of "
    f"{', '.join(GRATINGS)}, with parameters of warpdiff.gratings as in fingers:size_um=25.6,seed=3, where pairs are "
    "2.0x1.0"
)
_MESH_HELP = (
    f"mesh file with texture coordinates, or one of {', '.join(_BODIES)}, with parameters of warpdiff.meshes as in "
    "snake:tangent=along"
)
# The command line's words for arguments that no flag is made from.
_WORDS = {
    **{f"{method}()": flag for method, (flag, _) in CLEANING.items()},
    "mesh": "MESH", "heightfield": "--heightfield", "material": "--material", "film": "--film", "lights": "--light",
    "light": "--light", "to_light": "--light", "illuminant": "--illuminant", "coherence": "--coherence",
    "view": "--width and --height", "size_um": "--crop-um", "order": "--level",
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    options, unknown = _parser(arguments).parse_known_args(arguments)

    def say(kind: str, message: object) -> None:
        text = spelled(message, lambda name, value: word(name, value, options.words))
        with contextlib.suppress(OSError):
            print(f"warpdiff{kind}{text}", file=sys.stderr)

    if unknown:
        near = did_you_mean(unknown[0], options.flags)
        text = f"there is no argument {unknown[0]!r}{near or '.'} See warpdiff {options.command} --help"
        say(f" {options.command}: ", text)
        raise SystemExit(2)
    with warnings.catch_warnings():
        warnings.simplefilter("always", wd.WarpdiffWarning)
        warnings.showwarning = lambda message, *_, **__: say(": warning: ", message)
        try:
            options.run(options)
        except KeyboardInterrupt:
            say(": ", "interrupted")
            return 130
        except BrokenPipeError:
            # The reader of the output has closed it.
            return 1
        except Exception as error:
            if options.debug:
                traceback.print_exc()
            is_bad_input = isinstance(error, (ValueError, TypeError, *_BAD_PATHS))
            say(f" {options.command}: {'' if is_bad_input else f'failed: {type(error).__name__}: '}", error)
            return 2 if is_bad_input else 1
    return 0


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of the command line; only the named command gets flags, which are imported."""
    parser = _Parser(
        prog="warpdiff",
        description="Iridescent colours of diffraction gratings given as measured height fields.",
        epilog="start with:\n  warpdiff demo\n  warpdiff render tube --heightfield fingers -o tube.png\n"
        "  warpdiff render --help",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    named = next((argument for argument in arguments if argument in _COMMANDS), None)
    for name, known in _COMMANDS.items():
        description = f"{known.what[0].upper()}{known.what[1:]}."
        command = commands.add_parser(
            name, help=known.what, description=description, epilog=f"example:\n  {known.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
        )  # fmt: skip
        command.add_argument("--debug", action="store_true", help="show the full traceback of an error")
        command.set_defaults(run=known.run, words={}, stored=frozenset())
        if name == named:
            flags = Flags(command)
            known.add_flags(flags)
            flags.finish(**known.words)
        command.set_defaults(flags=tuple(command._option_string_actions))
    return parser


class _Parser(argparse.ArgumentParser):
    """Report an error in one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        text = message.removeprefix("argument ").replace(": must ", " must ", 1)
        self.exit(2, f"{self.prog}: {text}. See {self.prog} --help\n")


class _Version(argparse.Action):
    """Print the version, which takes long to find."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print(f"warpdiff {wd.__version__}")
        parser.exit()


def _add_demo(flags: Flags) -> None:
    demo = flags.parser
    demo.add_argument("-o", "--output", default="demo", metavar="FOLDER", help="folder of the pictures (default: demo)")
    demo.add_argument(
        "--data", metavar="FOLDER", help="folder with the real scan (default: $WARPDIFF_DATA, ../shared/data)"
    )
    demo.add_argument("--scale", type=number, default=1.0, help="factor on the pictures' sizes (default: 1)")
    flags.add(demo, describe(wd.Image.save), only=("display", "gamut"))


def _add_render(flags: Flags) -> None:
    _add_picture(flags, SinglePictureSettings)
    _add_output(flags)
    group = flags.group("environment")
    group.add_argument(
        "--environment", metavar="FILE", help="sky or room, EXR or HDR in latitude and longitude, linear sRGB"
    )
    loading = describe(wd.Environment.load)
    flags.add(group, loading, only=loading.keys() - {"path"}, prefix="environment-")
    group.add_argument("--environment-behind", action="store_true", help="show it behind the picture, in a PNG")


def _add_sequence(flags: Flags) -> None:
    _add_picture(flags, PictureSettings)
    group = flags.group("frames")
    group.add_argument(
        "-o", "--output", required=True, metavar="FOLDER",
        help="folder of the frames; frames of the same sequence that exist are kept",
    )  # fmt: skip
    group.add_argument("--count", type=integer, help="number of frames (default: 36, or the rows of --path)")
    kind = group.add_mutually_exclusive_group()
    kind.add_argument("--turns", type=number, default=1.0, help="turns of the body about its target (default: 1)")
    kind.add_argument(
        "--light-to", type=number, nargs=3, metavar=("X", "Y", "Z"), help="last direction of a light that moves"
    )
    kind.add_argument("--path", metavar="FILE", help="the camera's path: a CSV file, see warpdiff.camera_path")
    group.add_argument(
        "--lights-stay", action="store_true", help="the camera goes around the body; otherwise the body turns"
    )
    flags.add(group, describe(wd.sequence), only=("formats", "animation", "frames_per_second", "overwrite"))
    group.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster whose workers render")


def _add_brdf(flags: Flags) -> None:
    _add_height_field(flags)
    _add_evaluation(flags, EvaluationSettings)
    _add_saving(flags)
    _add_output(flags)
    group = flags.group("map")
    group.add_argument("--incidence-deg", type=number, default=0.0, help="light's angle from the normal (default: 0)")
    group.add_argument("--azimuth-deg", type=number, default=0.0, help="light's angle from the x axis (default: 0)")
    flags.add(group, describe(wd.reflectance_map), only=("size", "samples_per_pixel"))


def _add_export_html(flags: Flags) -> None:
    flags.parser.add_argument("output", metavar="OUT", help="the page, .html")
    flags.parser.add_argument("mesh", metavar="MESH", nargs="?", default="snake", help=f"{_MESH_HELP} (default: snake)")
    _add_height_field(flags, default="fingers")
    group = flags.group("lobes")
    flags.add(group, describe(wd.bake), only=("delta_e", "strict", "device", "threads"))
    flags.add(group, describe(Coherence), only=("kind", "sigma_um", "angular_diameter_deg"), names=COHERENCE_FLAGS)
    _add_material(group)
    _add_illuminant(group)
    group = flags.group("page")
    of_page = ("masking", "pigment", "shadows", "smooth", "exposure", "title")
    flags.add(group, describe(wd.export_html), only=of_page)
    flags.add(group, describe(PictureSettings), only=("ior", "tangents"))
    _add_scene(flags)


def _add_info(flags: Flags) -> None:
    _add_height_field(flags)
    flags.add(flags.parser, describe(EvaluationSettings), only=("tolerance",))


def _add_view(flags: Flags) -> None:
    view = flags.parser
    view.add_argument("mesh", nargs="*", metavar="MESH", help="mesh files that the page offers with the sample bodies")
    _add_height_field(flags, several=True)
    view.add_argument(
        "--environment", nargs="+", action="extend", default=[], metavar="FILE",
        help="skies or rooms that the page offers as lights, EXR or HDR in latitude and longitude, linear sRGB",
    )  # fmt: skip
    view.add_argument("--port", type=integer, default=0, help="port of the server (default: pick a free port)")
    view.add_argument(
        "--host", default="127.0.0.1",
        help="address to listen on; for other machines the page's address contains a token (default: 127.0.0.1)",
    )  # fmt: skip
    view.add_argument("--no-browser", action="store_true", help="only print the page's address")
    flags.add(view, describe(EvaluationSettings), only=("device", "threads"))


def _add_cache(flags: Flags) -> None:
    less = flags.parser.add_mutually_exclusive_group()
    less.add_argument("--trim-mib", type=number, metavar="MIB", help="keep at most this size, the last used files")
    less.add_argument("--clear", action="store_true", help="delete all files")


def _add_picture(flags: Flags, settings: type) -> None:
    """Add the flags of pictures: mesh, height field, evaluation, lights and camera, and how files are saved."""
    flags.parser.add_argument("mesh", metavar="MESH", help=_MESH_HELP)
    _add_height_field(flags)
    _add_evaluation(flags, settings)
    _add_scene(flags)
    _add_saving(flags)


def _add_height_field(flags: Flags, *, default: str | None = None, several: bool = False) -> None:
    group = flags.group("height field")
    how: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []} if several else {"default": default}
    group.add_argument(
        "--heightfield", metavar="HEIGHTFIELD", required=default is None and not several,
        help=_HEIGHT_FIELD_HELP + (f" (default: {default})" if default else ""), **how,
    )  # fmt: skip
    flags.add(group, describe(wd.HeightField.load), only=("extent_um", "pitch_um", "height_range_um"))
    group.add_argument(
        "--level", type=integer, metavar="ORDER", help="subtract a polynomial of this order (1: a plane)"
    )
    group.add_argument("--despike", action="store_true", help="remove dust")
    group.add_argument("--fill", action="store_true", help="fill missing samples from those around them")
    group.add_argument("--crop-um", type=number, metavar="SIZE", help="keep a square of this size from the middle")
    group.add_argument("--periodic", action="store_true", help="make opposite edges match")


def _add_evaluation(flags: Flags, settings: type) -> None:
    group = flags.group("evaluation")
    flags.add(group, describe(settings))
    flags.add(group, describe(Coherence), names=COHERENCE_FLAGS)
    if settings is not EvaluationSettings:
        flags.add(group, describe(settings), only=("tangents",))
    _add_material(group)
    _add_illuminant(group)


def _add_material(group: Any) -> None:
    group.add_argument(
        "--material",
        help=f"material of the surface, instead of --ior: {', '.join(METAL_SYMBOLS)}, an index of refraction, or a "
        "file of refractiveindex.info, YAML or CSV",
    )
    group.add_argument(
        "--film", nargs=2, metavar=("MATERIAL", "NM"), help="film on the material: its material and thickness in nm"
    )


def _add_illuminant(group: Any) -> None:
    group.add_argument(
        "--illuminant", default="D65",
        help="CIE illuminant or light source by name, temperature of a black body, such as 2856K, or a CSV file of "
        "wavelengths in nm and powers (default: D65)",
    )  # fmt: skip


def _add_scene(flags: Flags) -> None:
    """Add the flags of lights and camera."""
    group = flags.group("lights")
    group.add_argument(
        "--light", nargs="+", action="append", metavar="LIGHT",
        help="a light: X Y Z, the direction towards it, or KIND:name=value,… of warpdiff's lights, as in "
        "directional:to_light=0x1x1,angular_diameter_deg=3 or point:position=0x2x1,power=4; may be repeated (default: "
        "directional, from behind the camera's shoulder)",
    )  # fmt: skip
    group = flags.group("camera")
    flags.add(group, describe(wd.View), defaults={"eye": None, "target": None})


def _add_saving(flags: Flags) -> None:
    saving = ("exposure", "exposure_stops", "display", "gamut", "background", "bits")
    flags.add(flags.group("picture file"), describe(wd.Image.save), only=saving)


def _add_output(flags: Flags) -> None:
    flags.parser.add_argument(
        "-o", "--output", required=True, metavar="FILE", help="picture, .png (display) or .exr (linear XYZ and RGB)"
    )


def _progress() -> bool:
    """Whether progress is shown: on a terminal."""
    return sys.stderr.isatty()


def _named(text: str, functions: dict[str, tuple[str, dict[str, Any]]], module: Any, flag: str) -> Any:
    """Return what a name such as ``fingers:size_um=25.6`` makes by a function of a module; None for another text."""
    name, colon, parameters = text.partition(":")
    if name.lower() in functions:
        function, defaults = functions[name.lower()]
    elif colon and inspect.isfunction(getattr(module, name, None)) and not name.startswith("_"):
        function, defaults = name, {}
    else:
        return None
    return _called(text, getattr(module, function), parameters, defaults, flag)


def _called(text: str, function: Callable[..., Any], parameters: str, defaults: dict[str, Any], flag: str) -> Any:
    """Call a function with parameters ``name=value,…`` over defaults."""
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
        values[name] = _illuminant(value) if name == "illuminant" else _value(value)
    for parameter in inspect.signature(function).parameters.values():
        if parameter.default is parameter.empty and parameter.name not in defaults | values:
            raise ArgumentValueError(f"{ref(flag)} {text!r} requires the parameter {parameter.name}")
    try:
        return function(**defaults | values)
    except (TypeError, ValueError) as error:
        raise ArgumentValueError(f"{ref(flag)} {text!r}: {error}") from None


def _value(text: str) -> Any:
    """Return a number, several numbers joined by ``x``, or the text itself."""
    if re.fullmatch(r"[-+\d.e]+(x[-+\d.e]+)+", text):
        return tuple(map(_value, text.split("x")))
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _height_field(options: argparse.Namespace) -> wd.HeightField:
    text = options.heightfield
    made = _named(text, GRATINGS, wd.gratings, "heightfield")
    if made is None:
        if not validation.path(text, "heightfield").is_file():
            names = list(GRATINGS)
            raise marked(
                FileNotFoundError,
                f"{ref('heightfield')}: there is no file {text!r}; a synthetic one is called by its name, one of "
                f"{', '.join(names)}{did_you_mean(text, names)}",
            )
        made = _scan(text, options)
    return _cleaned(made, options)


def _scan(path: str, options: argparse.Namespace) -> wd.HeightField:
    with renaming({"path": "--heightfield"}):
        return wd.HeightField.load(path, **given(options, describe(wd.HeightField.load)))


def _cleaning(options: argparse.Namespace) -> list[tuple[str, tuple[tuple[str, Any], ...]]]:
    """Return the methods of a height field that flags call, in their order, with their arguments."""
    result: list[tuple[str, tuple[tuple[str, Any], ...]]] = []
    for method, (flag, argument) in CLEANING.items():
        value = getattr(options, flag.removeprefix("--").replace("-", "_"))
        if value not in (None, False):
            result.append((method, () if argument is None else ((argument, value),)))
    return result


def _cleaned(heightfield: wd.HeightField, options: argparse.Namespace) -> wd.HeightField:
    for name, arguments in _cleaning(options):
        heightfield = getattr(heightfield, name)(**dict(arguments))
    return heightfield


def _coherence(options: argparse.Namespace) -> Coherence | None:
    values = given(options, describe(Coherence))
    return Coherence(**values) if values else None


def _settings(options: argparse.Namespace, settings: Any) -> dict[str, Any]:
    """Return the settings that flags gave, with material and coherence."""
    return given(options, describe(settings)) | {"coherence": _coherence(options), "material": _material(options)}


def _material(options: argparse.Namespace) -> wd.Material | None:
    """Return the material that flags name, under its film."""
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
    """Return a metal, a dielectric of a constant index, or the material of a file."""
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


def _illuminant(text: str) -> str | wd.Spectrum:
    """Return the illuminant of a name, or the spectrum of a temperature or a file."""
    with renaming({"path": "--illuminant", "temperature_k": "--illuminant"}):
        if re.fullmatch(r"[0-9.]+K", text):
            with contextlib.suppress(ValueError):
                return wd.Spectrum.blackbody(float(text[:-1]))
            raise ArgumentValueError(
                f"{ref('illuminant')} must be a temperature of 500K to 100000K, got {text!r}"
            ) from None
        return wd.Spectrum.from_csv(text) if Path(text).suffix else text


def _lights(options: argparse.Namespace, view: wd.View | None) -> list[Any]:
    """Return the lights that flags give; of none, one from behind the shoulder of a view's camera."""
    illuminant, lights = _illuminant(options.illuminant), []
    for texts in options.light or ():
        kind, colon, parameters = texts[0].partition(":")
        if len(texts) == 1 and colon:
            if kind not in _LIGHTS:
                raise ArgumentValueError(
                    f"{ref('light')} {texts[0]!r} must begin with {' or '.join(repr(f'{name}:') for name in _LIGHTS)}"
                    f"{did_you_mean(kind, _LIGHTS)}"
                )
            lights.append(
                _called(texts[0], getattr(wd, _LIGHTS[kind]), parameters, {"illuminant": illuminant}, "light")
            )
            continue
        try:
            x, y, z = map(float, texts)
        except ValueError:
            raise ArgumentValueError(
                f"{ref('light')} must be three numbers X Y Z, or KIND:name=value,…, got {' '.join(texts)!r}"
            ) from None
        lights.append(wd.DirectionalLight((x, y, z), illuminant=illuminant))
    if not lights and view is not None:
        frame = view.frame()
        to_light = tuple((frame.back + 0.6 * frame.up + 0.3 * frame.right).tolist())
        lights.append(wd.DirectionalLight(to_light, illuminant=illuminant))
    return lights


def _environment(options: argparse.Namespace) -> wd.Environment | None:
    """Return the environment that flags give."""
    described = describe(wd.Environment.load)
    values = given(options, described, "environment_")
    words = {name: f"--environment-{described[name].dashed}" for name in described} | {"path": "--environment"}
    if options.environment is None:
        if values or options.environment_behind:
            flag = words[next(iter(values))] if values else "--environment-behind"
            raise ArgumentValueError(f"{flag} requires --environment")
        return None
    if options.environment_behind and "background" in options:
        raise ArgumentValueError("--environment-behind and --background both set the background: give one of them")
    if options.environment_behind and Path(options.output).suffix.lower() != ".png":
        raise ArgumentValueError(f"--environment-behind is for .png files, got --output {options.output}")
    with renaming(words):
        return wd.Environment.load(options.environment, **values)


def _scene(options: argparse.Namespace) -> tuple[Any, wd.HeightField, wd.View]:
    """Return mesh, height field and view of a picture."""
    heightfield = _height_field(options)
    mesh = _named(options.mesh, _BODIES, wd.meshes, "mesh")
    mesh = options.mesh if mesh is None else mesh
    values = given(options, describe(wd.View))
    eye, extent_y = values.pop("eye", None), values.pop("extent_y", None)
    if eye is not None and "target" in values:
        return mesh, heightfield, wd.View(eye, extent_y=extent_y, **values)
    view = wd.View.fit(mesh, **values)
    return mesh, heightfield, dataclasses.replace(view, eye=view.eye if eye is None else eye, extent_y=extent_y)


def _render(options: argparse.Namespace) -> None:
    _check_output(options)
    environment = _environment(options)
    mesh, heightfield, view = _scene(options)
    lights = _lights(options, None if environment else view) + ([environment] if environment else [])
    settings = _settings(options, SinglePictureSettings)
    image = wd.shade(mesh, heightfield, lights, view, **settings, progress=_progress())
    background = None
    if environment is not None and options.environment_behind:
        # Pictures by an index of refraction are relative to the reflectance at normal incidence.
        normal, _ = check_reflection(settings.get("ior"), settings["material"])
        background = environment.background(view) / np.float32(normal)
    _save(image, options, background)


def _check_output(options: argparse.Namespace) -> None:
    """Refuse a file that cannot be written, before minutes are spent on it."""
    check_target(options.output, "--output")
    given(options, describe(wd.Image.save))
    if "background" in options:
        if Path(options.output).suffix.lower() != ".png":
            raise ArgumentValueError(f"--background is for .png files, got --output {options.output}")
        for component in options.background:
            validation.number(component, "background", least=0.0, most=1.0)


def _save(image: wd.Image, options: argparse.Namespace, background: NDArray[np.float32] | None = None) -> None:
    saving = given(options, describe(wd.Image.save)) | ({} if background is None else {"background": background})
    path = image.save(options.output, **saving)
    print(image.report)
    print(image.plan)
    print(path)


def _sequence(options: argparse.Namespace) -> None:
    if options.scheduler is not None and importlib.util.find_spec("distributed") is None:
        raise ArgumentValueError("--scheduler requires Dask, which is not installed: pip install 'warpdiff[dask]'")
    saving = given(options, describe(wd.sequence))
    mesh, heightfield, view = _scene(options)
    lights = _lights(options, view)
    count = 36 if options.count is None else options.count
    if options.path is not None:
        shots = wd.camera_path(options.path, lights, view, count=options.count)
    elif options.light_to is not None:
        shots = wd.light_sweep(lights[0], view, options.light_to, count=count)
    else:
        shots = wd.turntable(lights, view, count=count, turns=options.turns, lights_follow=not options.lights_stay)
    settings = _settings(options, PictureSettings)
    renderer = wd.Renderer(mesh, heightfield, list(shots[0].lights), shots[0].view, **settings)
    with contextlib.ExitStack() as stack:
        client = None
        if options.scheduler is not None:
            from distributed import Client

            client = stack.enter_context(Client(options.scheduler))
        paths = wd.sequence(renderer, shots, options.output, **saving, client=client, progress=_progress())
    print(renderer.plan)
    print(f"{len(paths)} frames in {Path(options.output).resolve()}")
    if "animation" in options:
        print(options.animation)


def _export_html(options: argparse.Namespace) -> None:
    target = validation.path(options.output, "path")
    if target.suffix.lower() not in (".html", ".htm"):
        raise ArgumentValueError(f"{ref('path')} must end in .html or .htm, got {options.output!r}")
    files.check_folder(target.parent, "path")
    page = given(options, describe(wd.export_html))
    mesh, heightfield, view = _scene(options)
    baking = given(options, describe(wd.bake)) | {"coherence": _coherence(options), "material": _material(options)}
    baking["illuminant"] = _illuminant(options.illuminant)
    lobes = wd.bake(heightfield, **baking, progress=_progress())
    path = wd.export_html(target, mesh, lobes, _lights(options, view), view, **page)
    print(lobes)
    print(f"{path}, {path.stat().st_size / 1e6:.1f} MB")


def _brdf(options: argparse.Namespace) -> None:
    _check_output(options)
    if not abs(options.incidence_deg) < _GRAZING_DEG:
        raise ArgumentValueError(
            f"--incidence-deg must be more than -90 and less than 90, got {options.incidence_deg:g}"
        )
    theta, phi = math.radians(options.incidence_deg), math.radians(options.azimuth_deg)
    to_light = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
    image = wd.reflectance_map(
        _height_field(options), to_light, illuminant=_illuminant(options.illuminant),
        **_settings(options, wd.reflectance_map), progress=_progress(),
    )  # fmt: skip
    _save(image, options)


def _demo(options: argparse.Namespace) -> None:
    from warpdiff.apps import demo

    shown = given(options, describe(wd.Image.save))
    paths = demo.run(options.output, data=options.data, scale=options.scale, **shown, say=print, progress=_progress())
    print(f"{len(paths)} pictures in {Path(options.output).resolve()}")


def _info(options: argparse.Namespace) -> None:
    heightfield = _height_field(options)
    print(heightfield.summary())
    if heightfield.missing.any():
        print("\nMissing samples must be filled before rendering: --fill")
    else:
        plan = wd.plan(heightfield, **given(options, describe(EvaluationSettings)), strict=False)
        print(f"\nFor the whole hemisphere: {plan}")


def _view(options: argparse.Namespace) -> None:
    if importlib.util.find_spec("websockets") is None:
        raise ArgumentValueError("the page requires websockets, which is not installed: pip install 'warpdiff[view]'")
    from warpdiff.apps.viewer.command import run
    from warpdiff.apps.viewer.page_calls import NamedFiles

    if not 0 <= options.port <= _MOST_PORT:
        raise ArgumentValueError(f"--port must be 0 to {_MOST_PORT}, got {options.port}")
    device = given(options, {name: describe(EvaluationSettings)[name] for name in ("device", "threads")})
    loading = given(options, describe(wd.HeightField.load))
    inputs = {"mesh": options.mesh, "heightfield": options.heightfield, "--environment": options.environment}
    for name, paths in inputs.items():
        for path in paths:
            if not validation.path(path, name).is_file():
                raise marked(FileNotFoundError, f"{ref(name)}: there is no file {path!r}")
    # Files that cannot be loaded are reported here rather than on the page.
    for path in options.heightfield:
        _cleaned(_scan(path, options), options)
    for path in options.environment:
        with renaming({"path": "--environment"}):
            wd.Environment.load(path)
    named = NamedFiles(
        tuple(map(Path, options.mesh)), tuple(map(Path, options.heightfield)), tuple(map(Path, options.environment)),
        tuple(loading.items()), tuple(_cleaning(options)),
    )  # fmt: skip
    run(
        named, host=options.host, port=options.port, opens_browser=not options.no_browser, **device,
        say=functools.partial(print, flush=True),
    )  # fmt: skip


def _cache(options: argparse.Namespace) -> None:
    if options.trim_mib is not None:
        validation.number(options.trim_mib, "--trim-mib", least=0.0)
    folder = disk_cache.cache_folder()
    if folder is None:
        print("the disk cache is disabled: WARPDIFF_CACHE_DIR is empty, or the user has no home folder")
        return
    if options.clear:
        disk_cache.clear(folder)
    elif options.trim_mib is not None:
        disk_cache.trim(folder, round(options.trim_mib * 2**20))
    entries = disk_cache.entries(folder)
    used = f", last used on {time.strftime('%Y-%m-%d', time.localtime(entries[0].used))}" if entries else ""
    total, most = sum(entry.size for entry in entries) / 2**20, disk_cache.MOST_BYTES / 2**20
    print(f"{folder}: {len(entries)} files, {total:.1f} MiB of at most {most:.0f} MiB{used}")


class _Command(NamedTuple):
    """A command: its description, an example, and the functions that add its flags and run it.

    ``words`` are the command line's words for arguments that no flag is made from.
    """

    what: str
    example: str
    add_flags: Callable[[Flags], None]
    run: Callable[[argparse.Namespace], None]
    words: dict[str, str] = _WORDS


_COMMANDS = {
    "demo": _Command(
        "render a set of pictures and say where they are",
        "warpdiff demo --output pictures",
        _add_demo, _demo, {"scale": "--scale", "output": "--output"},
    ),
    "render": _Command(
        "render a mesh whose surface carries a height field",
        "warpdiff render snake.obj --heightfield scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --light 0.3 1 1 -o snake.png",
        _add_render, _render,
    ),
    "sequence": _Command(
        "render frames: a body that turns, or under a light that moves, or along a camera's path",
        "warpdiff sequence snake --heightfield fingers --count 72 --tolerance 0.03 --pigment 0.1 -o turn \\\n"
        "      --animation turn.webp\n"
        "  warpdiff sequence disc --heightfield cd --light 0 0.5 1 --light-to 0.8 0.1 1 -o sweep\n"
        "  warpdiff sequence snake --heightfield fingers --path camera.csv -o flight",
        _add_sequence, _sequence,
        _WORDS | {
            "path": "--path", "folder": "--output", "count": "--count", "turns": "--turns", "to_light": "--light-to",
        },
    ),
    "brdf": _Command(
        "map the reflectance over all view directions, seen from above",
        "warpdiff brdf --heightfield blazed:period_um=2.5,depth_um=0.25 --incidence-deg 20 -o blazed.png",
        _add_brdf, _brdf, _WORDS | {"to_light": "--incidence-deg"},
    ),
    "export-html": _Command(
        "write a page that shows a mesh in any browser",
        "warpdiff export-html snake.html\n"
        "  warpdiff export-html snake.html snake --heightfield scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --pigment 0.1",
        _add_export_html, _export_html, _WORDS | {"path": "OUT"},
    ),
    "info": _Command(
        "describe a height field, and what an evaluation of it would compute",
        "warpdiff info --heightfield scan.png --extent-um 65 --height-range-um 0.375 --level 2",
        _add_info, _info,
    ),
    "view": _Command(
        "turn body, light and surface by hand, on a page in the browser",
        "warpdiff view\n"
        "  warpdiff view snake.obj --heightfield scan.png --extent-um 65 --height-range-um 0.375 --periodic",
        _add_view, _view,
    ),
    "cache": _Command(
        "show, trim or clear the disk cache of height fields",
        "warpdiff cache\n  warpdiff cache --trim-mib 200\n  warpdiff cache --clear",
        _add_cache, _cache, {},
    ),
}  # fmt: skip
