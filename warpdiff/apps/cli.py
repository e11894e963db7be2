"""The command line: its commands, their flags, and the messages and exit codes of errors.

Exit codes: 0 success, 1 failure, 2 bad input, 129 SIGHUP, 130 SIGINT (Ctrl+C), 143 SIGTERM.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import traceback
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import warpdiff as wd
from warpdiff.apps import cli_commands, cli_inputs, cli_tables
from warpdiff.apps.cli_options import CLEANING, COHERENCE_FLAGS, Flags, integer, number, with_joined_tangents, word
from warpdiff.apps.cli_progress import CommandProgress
from warpdiff.core.options import describe
from warpdiff.core.wording import did_you_mean, spelled
from warpdiff.optics.coherence import Coherence
from warpdiff.request.settings import EvaluationSettings, PictureSettings, SinglePictureSettings, SpectralSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


# File errors that count as bad input (exit code 2). Other file errors, such as a full disk, are failures (exit code 1).
_BAD_PATHS = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
_HEIGHT_FIELD_HELP = (
    "file of heights (an image of 8 or 16 bit grey or float, .npy, .npz, text, .x3p or a file of an instrument), or a "
    f"synthetic height field: one of {', '.join(cli_inputs.GRATINGS)}, with parameters of warpdiff.gratings, for "
    "example fingers:size_um=25.6,seed=3; pairs are written as 2.0x1.0"
)
_MESH_HELP = (
    "mesh file, which requires --tangents if it has no texture coordinates, or one of "
    f"{', '.join(cli_inputs.BODIES)}, with parameters of warpdiff.meshes, for example snake:tangent=along"
)
# Flag or operand of the command line that sets an argument of the library's Python functions. Error messages print the
# flag or operand instead of the argument's name. Flags that ``cli_options.py`` generates from the options of a Python
# function are not in this dictionary.
_WORDS = {
    **{f"{method}()": flag for method, (flag, _) in CLEANING.items()},
    "mesh": "MESH", "heightfield": "--heightfield", "material": "--material", "film": "--film", "lights": "--light",
    "light": "--light", "to_light": "--light", "illuminant": "--illuminant", "coherence": "--coherence",
    "surface": "--surface", "view": "--width and --height", "size_um": "--crop-um", "order": "--level",
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Args:
        arguments: Arguments without the program's name; None is ``sys.argv[1:]``.
    """
    arguments = with_joined_tangents(sys.argv[1:] if arguments is None else arguments)
    options, unknown = _parser(arguments).parse_known_args(arguments)
    options.progress = progress = CommandProgress(options.command)

    def say(kind: str, message: object) -> None:
        text = spelled(message, lambda name, value: word(name, value, options.words))
        with contextlib.suppress(OSError):
            progress.print(f"warpdiff{kind}{text}", sys.stderr)

    if unknown:
        near = did_you_mean(unknown[0], options.flags)
        text = f"there is no argument {unknown[0]!r}{near or '.'} See warpdiff {options.command} --help"
        say(f" {options.command}: ", text)
        raise SystemExit(2)
    if "scan" in options and (options.scan is None) == (options.heightfield is None):
        say(
            f" {options.command}: ",
            f"one of HEIGHTFIELD and --heightfield is required. See warpdiff {options.command} --help",
        )
        raise SystemExit(2)
    with warnings.catch_warnings():
        warnings.simplefilter("always", wd.WarpdiffWarning)
        warnings.showwarning = lambda message, *_, **__: say(": warning: ", message)
        try:
            # The command ``view`` has no progress bar in the terminal: it runs until it is interrupted, and its page
            # shows progress.
            with progress if options.command != "view" else contextlib.nullcontext():
                options.run(options)
        except KeyboardInterrupt:
            say(": ", "interrupted")
            return 130
        except BrokenPipeError:
            # The program that reads this command's output, such as ``head``, has closed the pipe. No message is
            # printed.
            return 1
        except Exception as error:
            if options.debug:
                traceback.print_exc()
            is_bad_input = isinstance(error, (ValueError, TypeError, *_BAD_PATHS))
            say(f" {options.command}: {'' if is_bad_input else f'failed: {type(error).__name__}: '}", error)
            return 2 if is_bad_input else 1
    return 0


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of the command line. To start fast, only the command in ``arguments`` gets its flags."""
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
    """Argument parser that prints an error as one line, without the usage text."""

    def error(self, message: str) -> NoReturn:
        text = message.removeprefix("argument ").replace(": must ", " must ", 1)
        self.exit(2, f"{self.prog}: {text}{'' if text.endswith('?') else '.'} See {self.prog} --help\n")


class _Version(argparse.Action):
    """Action of ``--version``. The version is computed only when it is printed, because the computation is slow."""

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
    flags.add(demo, describe(wd.Image.save))


def _add_render(flags: Flags) -> None:
    _add_picture(flags, SinglePictureSettings)
    _add_output(flags)
    flags.parser.add_argument(
        "--wavelengths-nm", type=number, nargs="+", metavar="NM",
        help="wavelengths of a spectral .exr file, which has the radiance of each pixel",
    )  # fmt: skip
    group = _add_environment(flags)
    group.add_argument("--environment-behind", action="store_true", help="show the environment as background of a PNG")


def _add_environment(flags: Flags) -> Any:
    """Add the flags of an environment light, and return their group in the help."""
    group = flags.group("environment")
    group.add_argument(
        "--environment", metavar="SKY",
        help="environment light: an EXR or HDR file in latitude and longitude, linear sRGB, or clear-sky, with "
        "parameters of warpdiff.Environment.clear_sky, for example clear-sky:sun_direction=1x1x0.5,ground_albedo=0.1",
    )  # fmt: skip
    loading = describe(wd.Environment.load)
    flags.add(group, loading, only=loading.keys() - {"path"}, prefix="environment-")
    return group


def _add_sequence(flags: Flags) -> None:
    _add_picture(flags, PictureSettings)
    _add_environment(flags)
    group = flags.group("frames")
    group.add_argument(
        "-o", "--output", required=True, metavar="FOLDER",
        help="folder of the frames; existing frames of the same sequence are not rendered again",
    )  # fmt: skip
    group.add_argument("--count", type=integer, help="number of frames (default: 36, or the rows of --path)")
    kind = group.add_mutually_exclusive_group()
    kind.add_argument("--turns", type=number, default=1.0, help="turns of the body or the lights (default: 1)")
    kind.add_argument(
        "--light-to", type=number, nargs=3, metavar=("X", "Y", "Z"),
        help="direction of the first light in the last frame; all lights move together, see warpdiff.light_sweep",
    )  # fmt: skip
    kind.add_argument("--path", metavar="FILE", help="the camera's path: a CSV file, see warpdiff.camera_path")
    at_rest = group.add_mutually_exclusive_group()
    at_rest.add_argument(
        "--lights-stay", action="store_true", help="the camera moves around the body; otherwise the body rotates"
    )
    at_rest.add_argument(
        "--lights-turn", action="store_true", help="the lights rotate around the body; otherwise the body rotates"
    )
    flags.add(group, describe(wd.sequence), only=("formats", "animation", "frames_per_second", "overwrite"))
    group.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster whose workers render")


def _add_brdf(flags: Flags) -> None:
    _add_height_field(flags, has_position=True)
    _add_evaluation(flags, EvaluationSettings)
    _add_saving(flags)
    _add_output(flags)
    group = flags.group("map")
    _add_incidence(group)
    flags.add(group, describe(wd.reflectance_map), only=("size", "samples_per_pixel"))


def _add_incidence(group: Any) -> None:
    group.add_argument("--incidence-deg", type=number, default=0.0, help="light's angle from the normal (default: 0)")
    group.add_argument("--azimuth-deg", type=number, default=0.0, help="light's angle from the x axis (default: 0)")


def _add_orders(flags: Flags) -> None:
    _add_height_field(flags, has_position=True)
    group = flags.group("orders")
    _add_incidence(group)
    _add_wavelengths(group, [550.0])
    group.add_argument(
        "--count", type=integer, default=20,
        help="number of orders per wavelength that are printed, the strongest ones (default: 20)",
    )  # fmt: skip
    flags.add(group, describe(wd.order_efficiencies), only=("ior", "energy"))
    _add_material(group)
    _add_csv(flags)


def _add_angles(flags: Flags) -> None:
    _add_height_field(flags, has_position=True)
    group = flags.group("orders")
    _add_incidence(group)
    _add_wavelengths(group, [450.0, 550.0, 650.0])
    flags.add(group, describe(wd.order_angles), only=("most_order",))
    _add_csv(flags)


def _add_spectrum(flags: Flags) -> None:
    _add_height_field(flags, has_position=True)
    group = flags.group("evaluation")
    flags.add(group, describe(SpectralSettings))
    flags.add(group, describe(Coherence), names=COHERENCE_FLAGS)
    _add_material(group)
    group = flags.group("spectrum")
    _add_incidence(group)
    group.add_argument("--view-deg", type=number, default=0.0, help="viewer's angle from the normal (default: 0)")
    group.add_argument(
        "--view-azimuth-deg", type=number, default=0.0, help="viewer's angle from the x axis (default: 0)"
    )
    group.add_argument("--from-nm", type=number, default=380.0, help="first wavelength, from 200 nm (default: 380)")
    group.add_argument("--to-nm", type=number, default=780.0, help="last wavelength (default: 780)")
    group.add_argument("--step-nm", type=number, default=5.0, help="step of the wavelengths (default: 5)")
    _add_csv(flags)


def _add_report(flags: Flags) -> None:
    _add_height_field(flags, has_position=True)
    _add_evaluation(flags, EvaluationSettings)
    flags.parser.add_argument(
        "-o", "--output", default="report", metavar="FOLDER", help="folder of the page and its files (default: report)"
    )
    group = flags.group("report")
    group.add_argument(
        "--compare", metavar="FILE",
        help="text of a measured curve, with a column wavelength_nm or angle_deg and a column of values",
    )  # fmt: skip
    group.add_argument("--incidence-deg", type=number, help="light's angle from the normal (default: 30)")
    group.add_argument(
        "--azimuth-deg", type=number, help="light's angle from the x axis (default: that of the strongest wave vector)"
    )
    group.add_argument(
        "--view-deg", type=number,
        help="view angle of a measured spectrum, in the plane of the light (default: the mirror direction)",
    )  # fmt: skip
    _add_wavelengths(group, [450.0, 550.0, 650.0])
    group.add_argument(
        "--sigmas-um", type=number, nargs="+", default=[5.0, 16.25, 50.0], metavar="UM",
        help="coherence windows whose colours are shown (default: 5 16.25 50)",
    )  # fmt: skip
    flags.add(group, describe(wd.report), only=("title",))


def _add_wavelengths(group: Any, default: list[float]) -> None:
    group.add_argument(
        "--wavelengths-nm", type=number, nargs="+", default=default, metavar="NM",
        help=f"wavelengths, from 200 nm (default: {' '.join(f'{wavelength:g}' for wavelength in default)})",
    )  # fmt: skip


def _add_csv(flags: Flags) -> None:
    flags.parser.add_argument("--csv", metavar="FILE", help="also write all rows to a CSV file, with all digits")


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
    _add_height_field(flags, has_position=True)
    flags.add(flags.parser, describe(EvaluationSettings), only=("tolerance",))


def _add_view(flags: Flags) -> None:
    view = flags.parser
    view.add_argument("mesh", nargs="*", metavar="MESH", help="mesh files that the page offers with the sample bodies")
    _add_height_field(flags, several=True)
    view.add_argument(
        "--environment", nargs="+", action="extend", default=[], metavar="FILE",
        help="environment lights that the page offers: EXR or HDR in latitude and longitude, linear sRGB",
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
    less.add_argument("--trim-mib", type=number, metavar="MIB", help="limit the size; the last used files stay")
    less.add_argument("--clear", action="store_true", help="delete all files")


def _add_picture(flags: Flags, settings: type) -> None:
    """Add the flags of pictures: mesh, height field, evaluation, lights, camera and picture file."""
    flags.parser.add_argument("mesh", metavar="MESH", help=_MESH_HELP)
    _add_height_field(flags)
    flags.parser.add_argument(
        "--surface", action="append", metavar="PART=HEIGHTFIELD",
        help="height field of the parts with this geometry or material, or 'plain' for a surface with the "
        "material of the mesh; other parts have --heightfield; may be repeated",
    )  # fmt: skip
    _add_evaluation(flags, settings)
    _add_scene(flags)
    _add_saving(flags)


def _add_height_field(
    flags: Flags, *, default: str | None = None, several: bool = False, has_position: bool = False
) -> None:
    group = flags.group("height field")
    how: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []} if several else {"default": default}
    if has_position:
        group.add_argument("scan", metavar="HEIGHTFIELD", nargs="?", help="the same as --heightfield")
    else:
        how["required"] = default is None and not several
    group.add_argument(
        "--heightfield", metavar="HEIGHTFIELD",
        help=_HEIGHT_FIELD_HELP + (f" (default: {default})" if default else ""), **how,
    )  # fmt: skip
    loading = ("extent_um", "pitch_um", "height_range_um", "channel", "rows", "unit")
    flags.add(group, describe(wd.HeightField.load), only=loading)
    group.add_argument(
        "--level", type=integer, metavar="ORDER", help="subtract a polynomial of this order (1: a plane)"
    )
    group.add_argument("--despike", action="store_true", help="remove dust")
    group.add_argument("--fill", action="store_true", help="interpolate missing samples")
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
        help=f"material of the surface, instead of --ior: {', '.join(cli_inputs.METAL_SYMBOLS)}, an index of "
        "refraction, or a file of refractiveindex.info, YAML or CSV",
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
        help="light: the direction towards it, X Y Z, or one of warpdiff's lights, KIND:name=value,…, for example "
        "directional:to_light=0x1x1,angular_diameter_deg=3 or point:position=0x2x1,power=4; may be repeated (default: "
        "a directional light from above and to the right of the camera)",
    )  # fmt: skip
    group = flags.group("camera")
    flags.add(group, describe(wd.View), defaults={"eye": None, "target": None})


def _add_saving(flags: Flags) -> None:
    group = flags.group("picture file")
    flags.add(group, describe(wd.Image.save))
    flags.add(group, describe(wd.sequence), only=("background",))


def _add_output(flags: Flags) -> None:
    flags.parser.add_argument(
        "-o", "--output", required=True, metavar="FILE", help="picture, .png (display) or .exr (linear XYZ and RGB)"
    )


class _Command(NamedTuple):
    """Command of the command line.

    Attributes:
        what: One-line description in the help.
        example: Examples in the help.
        add_flags: Function that adds the command's flags to its parser.
        run: Function that runs the command.
        words: Flag by Python argument, for error messages. Flags that :mod:`warpdiff.apps.cli_options` generates are
            not listed.
    """

    what: str
    example: str
    add_flags: Callable[[Flags], None]
    run: Callable[[argparse.Namespace], None]
    words: dict[str, str] = _WORDS


_COMMANDS = {
    "demo": _Command(
        "render a set of demonstration pictures",
        "warpdiff demo --output pictures",
        _add_demo, cli_commands.demo, {"scale": "--scale", "output": "--output"},
    ),
    "render": _Command(
        "render a mesh whose surface carries a height field",
        "warpdiff render snake.obj --heightfield scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --light 0.3 1 1 -o snake.png\n"
        "  warpdiff render tube --heightfield fingers --layers normal light --wavelengths-nm 450 550 650 -o tube.exr",
        _add_render, cli_commands.render, _WORDS | {"wavelengths_nm": "--wavelengths-nm"},
    ),
    "sequence": _Command(
        "render the frames of a sequence: a rotating body, moving lights, or a camera path",
        "warpdiff sequence snake --heightfield fingers --count 72 --tolerance 0.03 --pigment 0.1 -o turn \\\n"
        "      --animation turn.webp\n"
        "  warpdiff sequence disc --heightfield cd --light 0 0.5 1 --light-to 0.8 0.1 1 -o sweep\n"
        "  warpdiff sequence snake --heightfield fingers --environment clear-sky --lights-turn --tolerance 0.1 -o day\n"
        "  warpdiff sequence snake --heightfield fingers --path camera.csv -o flight",
        _add_sequence, cli_commands.sequence,
        _WORDS | {
            "path": "--path", "folder": "--output", "count": "--count", "turns": "--turns", "to_light": "--light-to",
        },
    ),
    "brdf": _Command(
        "save a map of the reflectance over all view directions",
        "warpdiff brdf --heightfield blazed:period_um=2.5,depth_um=0.25 --incidence-deg 20 -o blazed.png",
        _add_brdf, cli_commands.brdf, _WORDS | {"to_light": "--incidence-deg"},
    ),
    "orders": _Command(
        "print the efficiencies of the diffraction orders",
        "warpdiff orders blazed:period_um=2.5,depth_um=0.25 --material Au --incidence-deg 10 --csv orders.csv\n"
        "  warpdiff orders scan.x3p --level 1 --periodic --wavelengths-nm 450 550 650 --count 10",
        _add_orders, cli_tables.orders,
        _WORDS | {"to_light": "--incidence-deg", "wavelengths_nm": "--wavelengths-nm", "path": "--csv"},
    ),
    "angles": _Command(
        "print the angles of the orders of the periods of a height field",
        "warpdiff angles scan.x3p --level 1 --incidence-deg 20 --wavelengths-nm 450 550 650\n"
        "  warpdiff angles cd --most-order 2 --csv angles.csv",
        _add_angles, cli_tables.angles,
        _WORDS | {"to_light": "--incidence-deg", "wavelengths_nm": "--wavelengths-nm", "source": "--heightfield"},
    ),
    "spectrum": _Command(
        "print the reflectance spectrum in a view direction",
        "warpdiff spectrum sinusoidal:period_um=2,depth_um=0.2 --view-deg 15 --from-nm 300 --csv spectrum.csv\n"
        "  warpdiff spectrum scan.x3p --level 1 --periodic --incidence-deg 30 --view-deg -10",
        _add_spectrum, cli_tables.spectrum,
        _WORDS | {"to_light": "--incidence-deg", "to_view": "--view-deg", "wavelengths_nm": "--from-nm"},
    ),
    "report": _Command(
        "write a page with everything about a scan: roughness, periods, orders and colours",
        "warpdiff report scan.x3p --level 1 --despike -o report\n"
        "  warpdiff report scan.x3p --level 1 --compare spectrum.csv --incidence-deg 20 --view-deg -10",
        _add_report, cli_commands.report,
        _WORDS | {
            "folder": "--output", "compare": "--compare", "to_light": "--incidence-deg", "to_view": "--view-deg",
            "wavelengths_nm": "--wavelengths-nm", "sigmas_um": "--sigmas-um",
        },
    ),
    "export-html": _Command(
        "write a page that shows a mesh in any browser",
        "warpdiff export-html snake.html\n"
        "  warpdiff export-html snake.html snake --heightfield scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --pigment 0.1",
        _add_export_html, cli_commands.export_html, _WORDS | {"path": "OUT"},
    ),
    "info": _Command(
        "print a summary of a height field and the plan of its evaluation",
        "warpdiff info scan.x3p --level 1\n"
        "  warpdiff info --heightfield scan.png --extent-um 65 --height-range-um 0.375 --level 2",
        _add_info, cli_commands.info,
    ),
    "view": _Command(
        "start the interactive viewer, a page in the browser",
        "warpdiff view\n"
        "  warpdiff view snake.obj --heightfield scan.png --extent-um 65 --height-range-um 0.375 --periodic",
        _add_view, cli_commands.view,
    ),
    "cache": _Command(
        "show, trim or clear the disk cache of height fields",
        "warpdiff cache\n  warpdiff cache --trim-mib 200\n  warpdiff cache --clear",
        _add_cache, cli_commands.cache, {},
    ),
}  # fmt: skip
