"""The command line: its commands, and the messages and exit codes of errors.

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
from warpdiff.apps import cli_commands, cli_flags, cli_tables
from warpdiff.apps.cli_options import CLEANING, Flags, with_joined_vectors, word
from warpdiff.apps.cli_progress import CommandProgress
from warpdiff.core.wording import did_you_mean, spelled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


# File errors that count as bad input (exit code 2). Other file errors, such as a full disk, are failures (exit code 1).
_BAD_PATHS = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
# For each argument of the library's Python functions, the flag or operand of the command line that sets it. Error
# messages print the flag or operand instead of the argument's name. Flags that ``cli_options.py`` generates from the
# options of a Python function are not in this dictionary.
_WORDS = {
    **{f"{method}()": flag for method, (flag, _) in CLEANING.items()},
    "mesh": "MESH", "heightfield": "--heightfield", "material": "--material", "film": "--film", "lights": "--light",
    "light": "--light", "to_light": "--light", "illuminant": "--illuminant", "coherence": "--coherence",
    "surface": "--surface", "map": "--map", "view": "--width and --height", "size_um": "--crop-um", "order": "--level",
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code.

    Args:
        arguments: Arguments without the program's name; None is ``sys.argv[1:]``.
    """
    arguments = with_joined_vectors(sys.argv[1:] if arguments is None else arguments)
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


class _Command(NamedTuple):
    """Command of the command line.

    Attributes:
        what: One-line description in the help.
        example: Examples in the help.
        add_flags: Function that adds the command's flags to its parser.
        run: Function that runs the command.
        words: For each Python argument, the flag that sets it, for error messages. Flags that
            :mod:`warpdiff.apps.cli_options` generates are not listed.
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
        cli_flags.add_demo, cli_commands.demo, {"scale": "--scale", "output": "--output"},
    ),
    "render": _Command(
        "render a mesh whose surface carries a height field",
        "warpdiff render snake.obj --heightfield scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --light 0.3 1 1 -o snake.png\n"
        "  warpdiff render tube --heightfield fingers --layers normal light --wavelengths-nm 450 550 650 -o tube.exr",
        cli_flags.add_render, cli_commands.render, _WORDS | {"wavelengths_nm": "--wavelengths-nm"},
    ),
    "sequence": _Command(
        "render the frames of a sequence: a rotating body, moving lights, or a camera path",
        "warpdiff sequence snake --heightfield fingers --count 72 --tolerance 0.03 --pigment 0.1 -o turn \\\n"
        "      --animation turn.webp\n"
        "  warpdiff sequence disc --heightfield cd --light 0 0.5 1 --light-to 0.8 0.1 1 -o sweep\n"
        "  warpdiff sequence snake --heightfield fingers --environment clear-sky --lights-turn --tolerance 0.1 -o day\n"
        "  warpdiff sequence snake --heightfield fingers --path camera.csv -o flight",
        cli_flags.add_sequence, cli_commands.sequence,
        _WORDS | {
            "path": "--path", "folder": "--output", "count": "--count", "turns": "--turns", "to_light": "--light-to",
        },
    ),
    "brdf": _Command(
        "save a map of the reflectance over all view directions",
        "warpdiff brdf --heightfield blazed:period_um=2.5,depth_um=0.25 --incidence-deg 20 -o blazed.png",
        cli_flags.add_brdf, cli_commands.brdf, _WORDS | {"to_light": "--incidence-deg"},
    ),
    "orders": _Command(
        "print the efficiencies of the diffraction orders",
        "warpdiff orders blazed:period_um=2.5,depth_um=0.25 --material Au --incidence-deg 10 --csv orders.csv\n"
        "  warpdiff orders scan.x3p --level 1 --periodic --wavelengths-nm 450 550 650 --count 10",
        cli_flags.add_orders, cli_tables.orders,
        _WORDS | {"to_light": "--incidence-deg", "wavelengths_nm": "--wavelengths-nm", "path": "--csv"},
    ),
    "angles": _Command(
        "print the angles of the orders of the periods of a height field",
        "warpdiff angles scan.x3p --level 1 --incidence-deg 20 --wavelengths-nm 450 550 650\n"
        "  warpdiff angles cd --most-order 2 --csv angles.csv",
        cli_flags.add_angles, cli_tables.angles,
        _WORDS | {"to_light": "--incidence-deg", "wavelengths_nm": "--wavelengths-nm", "source": "--heightfield"},
    ),
    "spectrum": _Command(
        "print the reflectance spectrum in a view direction",
        "warpdiff spectrum sinusoidal:period_um=2,depth_um=0.2 --view-deg 15 --from-nm 300 --csv spectrum.csv\n"
        "  warpdiff spectrum scan.x3p --level 1 --periodic --incidence-deg 30 --view-deg -10",
        cli_flags.add_spectrum, cli_tables.spectrum,
        _WORDS | {"to_light": "--incidence-deg", "to_view": "--view-deg", "wavelengths_nm": "--from-nm"},
    ),
    "report": _Command(
        "write a page with everything about a scan: roughness, periods, orders and colours",
        "warpdiff report scan.x3p --level 1 --despike -o report\n"
        "  warpdiff report scan.x3p --level 1 --compare spectrum.csv --incidence-deg 20 --view-deg -10",
        cli_flags.add_report, cli_commands.report,
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
        cli_flags.add_export_html, cli_commands.export_html, _WORDS | {"path": "OUT"},
    ),
    "info": _Command(
        "print a summary of a height field and the plan of its evaluation",
        "warpdiff info scan.x3p --level 1\n"
        "  warpdiff info --heightfield scan.png --extent-um 65 --height-range-um 0.375 --level 2",
        cli_flags.add_info, cli_commands.info,
    ),
    "view": _Command(
        "start the interactive viewer, a page in the browser",
        "warpdiff view\n"
        "  warpdiff view snake.obj --heightfield scan.png --extent-um 65 --height-range-um 0.375 --periodic",
        cli_flags.add_view, cli_commands.view,
    ),
    "cache": _Command(
        "show, trim or clear the disk cache of height fields",
        "warpdiff cache\n  warpdiff cache --trim-mib 200\n  warpdiff cache --clear",
        cli_flags.add_cache, cli_commands.cache, {},
    ),
}  # fmt: skip
