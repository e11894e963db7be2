"""The command line: ``demo``, ``render``, ``sequence``, ``brdf``, ``export-html``, ``info``, ``view`` and others.

Exit codes: 0 done, 1 failure, 2 bad input, 130 interrupted, 143 terminated, 129 hung up.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import inspect
import math
import re
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from warpdiff.core import disk_cache, validation
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.image.display_transform import DISPLAYS, GAMUTS
from warpdiff.image.image import check_target
from warpdiff.optics.materials import check_reflection
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray


GRATINGS: dict[str, Callable[[argparse.Namespace], wd.HeightField]] = {
    "sinusoidal": lambda a: wd.gratings.sinusoidal(a.period_um, a.depth_um),
    "lamellar": lambda a: wd.gratings.lamellar(a.period_um, a.depth_um),
    "blazed": lambda a: wd.gratings.blazed(a.period_um, a.depth_um),
    "cd": lambda _: wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08),
    "dvd": lambda _: wd.gratings.disc("DVD", tracks=87, length_um=64.0, pitch_um=0.06),
    "blu-ray": lambda _: wd.gratings.disc("Blu-ray", tracks=100, length_um=32.0, pitch_um=0.04),
    "bumps": lambda _: wd.gratings.bumps(),
    "fingers": lambda _: wd.gratings.fingers(size_um=64.0, pitch_um=0.08),
}
_BODIES: dict[str, Callable[[], Any]] = {
    "tube": wd.meshes.tube,
    "tube-along": lambda: wd.meshes.tube(tangent="along"),
    "disc": wd.meshes.disc,
    "snake": wd.meshes.snake,
}
METAL_SYMBOLS = ("Al", "Ag", "Au", "Cr", "Cu", "Ni")
# How else the library calls what the command line takes.
_FLAGS = {
    "mesh": "MESH", "heightfield": "HEIGHTFIELD", "path": "HEIGHTFIELD", "kind": "--coherence",
    "pitch_um": "--pixel-um", "size_um": "--crop-um", "filled()": "--fill", "cropped()": "--crop-um",
    "power": "--light-power", "periodic()": "--periodic", "despiked()": "--despike",
}  # fmt: skip
_MOST_PORT = 65_535
# What the file system says of a path that was given; a full disk is another matter.
_BAD_PATHS = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
_HEIGHT_FIELD_HELP = (
    f"an image (8 or 16 bit grey, or float), a .npy file, or one of {', '.join(GRATINGS)}; with parameters of "
    "warpdiff.gratings as in fingers:size_um=25.6,seed=3, where pairs are 2.0x1.0"
)


class _ParameterError(ValueError):
    """Raised for parameters that are named as the library names them."""


class Bar:
    """A progress bar on a terminal's standard error, shown once something has taken a second."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._start = time.monotonic()
        # What was there before.
        self._first: float | None = None
        self._shown = False
        self._enabled = sys.stderr.isatty()

    def __call__(self, share: float) -> None:
        """Show that a share of the work is done, 0 to 1."""
        elapsed = time.monotonic() - self._start
        self._first = share if self._first is None else self._first
        if not self._enabled or (elapsed < 1.0 and not self._shown):
            return
        self._shown = True
        begun = self._first if self._first < share else 0.0
        left = elapsed * (1.0 - share) / max(share - begun, 1e-3)
        blocks = int(30 * share)
        bar = "#" * blocks + "." * (30 - blocks)
        sys.stderr.write(f"\r{self._name}  [{bar}] {100.0 * share:3.0f} %  {left:4.0f} s left ")
        if share >= 1.0:
            sys.stderr.write("\r\x1b[K")
            self._shown = False
        sys.stderr.flush()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("always", WarpdiffWarning)
        warnings.showwarning = lambda message, *_, **__: _tell(f"warpdiff: warning: {_in_flags(message, options)}")
        try:
            options.run(options)
        except KeyboardInterrupt:
            _tell("\nwarpdiff: interrupted")
            return 130
        except BrokenPipeError:
            # Whoever read the output has had enough.
            return 1
        except (ValueError, TypeError, *_BAD_PATHS) as error:
            if options.debug:
                traceback.print_exc()
            _tell(f"warpdiff {options.command}: {_in_flags(error, options)}")
            return 2
        except Exception as error:
            if options.debug:
                traceback.print_exc()
            _tell(f"warpdiff {options.command}: failed: {type(error).__name__}: {_in_flags(error, options)}")
            return 1
    return 0


def _in_flags(message: object, options: argparse.Namespace) -> str:
    """What the library says of its arguments, said of the command's."""
    if isinstance(message, _ParameterError):
        return str(message)
    flags = {name: f"--{name.replace('_', '-')}" for name in vars(options)} | _FLAGS
    flags["to_light"] = "--light" if "light" in options else "--incidence-deg"
    if "environment" in options:
        flags |= {name: f"--environment-{name.replace('_', '-')}" for name in ("rotation_deg", "scale", "directions")}
    # Some names are words as well, and are meant as names where something is said of them.
    names = "|".join(map(re.escape, sorted(flags, key=len, reverse=True)))
    of_argument = rf"(?<![\w.'/-])(?:heightfield\.)?({names})(?=\[|=|:| must | has | is for )"
    of_itself = r"(?<![\w.'/-])(?:heightfield\.)?(\w+_(?:um|deg|light)\b|\w+\(\))"
    return re.sub(f"{of_argument}|{of_itself}", lambda found: flags.get(found[1] or found[2], found[0]), str(message))


def _tell(line: str) -> None:
    """Say something on standard error, if anyone listens."""
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="warpdiff",
        description="Iridescent colours of diffraction gratings given as measured height fields.",
        epilog="start with:\n  warpdiff demo\n  warpdiff render tube fingers -o tube.png\n  warpdiff render --help",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"warpdiff {wd.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the full traceback of an error")

    demo = _add(
        commands, common, "demo", _demo, "render a set of pictures and say where they are",
        "warpdiff demo --output pictures",
    )  # fmt: skip
    demo.add_argument("-o", "--output", default="demo", metavar="FOLDER", help="where to put them (default: demo)")
    demo.add_argument(
        "--data", metavar="FOLDER", help="folder with the real scan (default: $WARPDIFF_DATA, ../shared/data)"
    )
    demo.add_argument("--scale", type=float, default=1.0, help="factor on the pictures' sizes (default: 1)")
    _add_display(demo)

    surface = _surface_options()
    evaluation = _evaluation_options()

    render = _add(
        commands, common, "render", _render, "render a mesh whose surface carries a height field",
        "warpdiff render snake.obj scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --light 0.3 1 1 -o snake.png",
        _picture_options(), surface, evaluation,
    )  # fmt: skip
    render.add_argument(
        "-o", "--output", required=True, metavar="FILE", help=".png (sRGB) or .exr (linear XYZ and RGB)"
    )
    _add_surroundings(render)

    _add_sequence(commands, common, surface, evaluation)

    brdf = _add(
        commands, common, "brdf", _brdf, "map the reflectance over all view directions, seen from above",
        "warpdiff brdf blazed --period-um 2.5 --depth-um 0.25 --incidence-deg 20 -o blazed.png",
        surface, evaluation,
    )  # fmt: skip
    brdf.add_argument("heightfield", metavar="HEIGHTFIELD", help=_HEIGHT_FIELD_HELP)
    brdf.add_argument("-o", "--output", required=True, metavar="FILE", help=".png (sRGB) or .exr (linear XYZ and RGB)")
    brdf.add_argument("--incidence-deg", type=float, default=0.0, help="light's angle from the normal (default: 0)")
    brdf.add_argument("--azimuth-deg", type=float, default=0.0, help="light's angle from the x axis (default: 0)")
    brdf.add_argument("--size", type=int, default=512, help="width and height in pixels (default: 512)")

    _add_export_html(commands, common, surface)

    info = _add(
        commands, common, "info", _info, "describe a height field, and what an evaluation of it would compute",
        "warpdiff info scan.png --extent-um 65 --height-range-um 0.375 --level 2",
        surface,
    )  # fmt: skip
    info.add_argument("heightfield", metavar="HEIGHTFIELD", help=_HEIGHT_FIELD_HELP)
    _add_tolerance(info)

    _add_view(commands, common, surface)

    _add_cache(commands, common)
    return parser


def _add_point_light(group: Any) -> None:
    group.add_argument(
        "--point-light", type=float, nargs=4, action="append", default=[], metavar=("X", "Y", "Z", "POWER"),
        help="a light at a place, and its power at a distance of 1 of the mesh's unit; may be repeated",
    )  # fmt: skip


def _add_surroundings(render: argparse.ArgumentParser) -> None:
    """Lights that are no directions; the default light is left out where there are any."""
    group = render.add_argument_group("lights of other kinds")
    _add_point_light(group)
    group.add_argument(
        "--environment", metavar="FILE", help="a sky or room, EXR or HDR in latitude and longitude, linear sRGB"
    )
    group.add_argument(
        "--environment-rotation-deg", type=float, default=0.0, metavar="DEG",
        help="turn it about +y, counter-clockwise from above (default: 0)",
    )  # fmt: skip
    group.add_argument("--environment-scale", type=float, default=1.0, help="factor on its radiance (default: 1)")
    group.add_argument(
        "--environment-directions", type=int, metavar="COUNT",
        help="most directions that a pixel sums (default: by --tolerance)",
    )  # fmt: skip
    group.add_argument("--environment-behind", action="store_true", help="show it behind the picture, in a PNG")


def _add_sequence(commands: Any, common: Any, surface: Any, evaluation: Any) -> None:
    sequence = _add(
        commands, common, "sequence", _sequence,
        "render frames: a body that turns, or under a light that moves, or along a camera's path",
        "warpdiff sequence snake fingers --count 72 --tolerance 0.03 --pigment 0.1 -o turn --animation turn.webp\n"
        "  warpdiff sequence disc cd --light 0 0.5 1 --light-to 0.8 0.1 1 -o sweep\n"
        "  warpdiff sequence snake fingers --path camera.csv -o flight",
        _picture_options(), surface, evaluation,
    )  # fmt: skip
    sequence.add_argument(
        "-o", "--output", required=True, metavar="FOLDER",
        help="where frames go; frames of the same sequence that are there already are kept",
    )  # fmt: skip
    sequence.add_argument("--count", type=int, help="frames (default: 36, or the rows of --path)")
    kind = sequence.add_mutually_exclusive_group()
    kind.add_argument("--turns", type=float, default=1.0, help="turns of the body about its target (default: 1)")
    kind.add_argument(
        "--light-to", type=float, nargs=3, metavar=("X", "Y", "Z"), help="the light moves to this direction"
    )
    kind.add_argument("--path", metavar="FILE", help="the camera's path: a CSV file, see warpdiff.camera_path")
    sequence.add_argument(
        "--lights-stay", action="store_true", help="the camera goes around the body; otherwise the body turns"
    )
    sequence.add_argument(
        "--formats", nargs="+", default=[".png"], metavar="SUFFIX", help=".png, .exr, or both (default: .png)"
    )
    sequence.add_argument("--animation", metavar="FILE", help="an animated .webp, .png or .gif of the frames")
    sequence.add_argument("--frames-per-second", type=float, default=24.0, help="of the animation (default: 24)")
    sequence.add_argument("--bits", type=int, default=8, help="of PNG: 8 or 16 (default: 8)")
    sequence.add_argument("--overwrite", action="store_true", help="replace frames of another sequence")
    sequence.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster whose workers draw")


def _add_cache(commands: Any, common: argparse.ArgumentParser) -> None:
    cache = _add(
        commands, common, "cache", _cache, "show, trim or clear what is kept on disk of height fields",
        "warpdiff cache\n  warpdiff cache --trim-mib 200\n  warpdiff cache --clear",
    )  # fmt: skip
    less = cache.add_mutually_exclusive_group()
    less.add_argument("--trim-mib", type=float, metavar="MIB", help="keep so much at most, of what was used last")
    less.add_argument("--clear", action="store_true", help="delete all of it")


def _add_view(commands: Any, common: argparse.ArgumentParser, surface: argparse.ArgumentParser) -> None:
    view = _add(
        commands, common, "view", _view, "turn body, light and surface by hand, on a page in the browser",
        "warpdiff view\n  warpdiff view snake.obj --height scan.png --extent-um 65 --height-range-um 0.375 --periodic",
        surface,
    )  # fmt: skip
    view.add_argument(
        "mesh", nargs="*", metavar="MESH", help="mesh files that the page offers, beside the sample bodies"
    )
    view.add_argument(
        "--height", nargs="+", action="extend", default=[], metavar="FILE",
        help="scans that the page offers, beside the synthetic gratings",
    )  # fmt: skip
    view.add_argument(
        "--environment", nargs="+", action="extend", default=[], metavar="FILE",
        help="skies or rooms that the page offers as lights, EXR or HDR in latitude and longitude, linear sRGB",
    )  # fmt: skip
    view.add_argument("--port", type=int, default=0, help="(default: a free one)")
    view.add_argument(
        "--host", default="127.0.0.1", help="address to listen on; beyond this machine the page has a token (default: "
        "127.0.0.1)"
    )  # fmt: skip
    view.add_argument("--no-browser", action="store_true", help="only print the page's address")
    view.add_argument("--device", help="cpu (default) or cuda")
    view.add_argument("--threads", type=int, help="threads on the CPU (default: one a core)")


def _add_export_html(commands: Any, common: argparse.ArgumentParser, surface: argparse.ArgumentParser) -> None:
    page = _add(
        commands, common, "export-html", _export_html, "write a page that shows a mesh in any browser",
        "warpdiff export-html snake.html\n"
        "  warpdiff export-html snake.html snake --height scan.png --extent-um 65 --height-range-um 0.375 \\\n"
        "      --level 2 --despike --periodic --pigment 0.1",
        surface,
    )  # fmt: skip
    page.add_argument("output", metavar="OUT", help="the page, .html")
    page.add_argument(
        "mesh", metavar="MESH", nargs="?", default="snake",
        help=f"a mesh file with texture coordinates, or one of {', '.join(_BODIES)} (default: snake)",
    )  # fmt: skip
    page.add_argument(
        "--height", dest="heightfield", metavar="HEIGHTFIELD", default="fingers",
        help=f"{_HEIGHT_FIELD_HELP} (default: fingers)",
    )  # fmt: skip
    lobes = page.add_argument_group("lobes")
    lobes.add_argument("--tolerance", type=float, default=2.0, help="ΔE2000 of baked colours (default: 2)")
    lobes.add_argument("--coherence", default="averaged", help="averaged or source (default: averaged)")
    lobes.add_argument("--sigma-um", type=float, help="σ of a window (default: 16.25)")
    lobes.add_argument(
        "--angular-diameter-deg", type=float, metavar="DEG", help="diameter of a source (default: the sun's, 0.53)"
    )
    _add_material(lobes)
    lobes.add_argument("--illuminant", default="D65", help="a CIE illuminant (default: D65)")
    lobes.add_argument("--device", help="cpu (default) or cuda")
    lobes.add_argument("--threads", type=int, help="threads on the CPU (default: one a core)")
    page.add_argument("--exposure", type=float, help="linear factor (default: for the first picture)")
    _add_point_light(page)
    page.add_argument("--title", default="warpdiff", help="of the page")
    _add_scene(page)
    page.set_defaults(width=640, height=480)


def _add(
    commands: Any,
    common: argparse.ArgumentParser,
    name: str,
    run: Callable[[argparse.Namespace], None],
    what: str,
    example: str,
    *parents: argparse.ArgumentParser,
) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(
        name,
        parents=[common, *parents],
        help=what,
        description=f"{what[0].upper()}{what[1:]}.",
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.set_defaults(run=run)
    return command


def _picture_options() -> argparse.ArgumentParser:
    group = argparse.ArgumentParser(add_help=False)
    group.add_argument(
        "mesh", metavar="MESH", help=f"a mesh file with texture coordinates, or one of {', '.join(_BODIES)}; with "
        "parameters of warpdiff.meshes as in snake:tangent=along"
    )  # fmt: skip
    group.add_argument("heightfield", metavar="HEIGHTFIELD", help=_HEIGHT_FIELD_HELP)
    _add_scene(group)
    group.add_argument("--width", type=int, default=640, help="pixels (default: 640)")
    group.add_argument("--height", type=int, default=480, help="pixels (default: 480)")
    group.add_argument("--samples-per-pixel", type=int, default=1, help="rays a pixel (default: 1)")
    group.add_argument(
        "--no-refine", action="store_true", help="no pixel is split to keep the tolerance: fast, without a promise"
    )
    return group


def _surface_options() -> argparse.ArgumentParser:
    group_parser = argparse.ArgumentParser(add_help=False)
    group = group_parser.add_argument_group("height field")
    group.add_argument("--extent-um", type=float, help="width of a scan in x")
    group.add_argument("--pixel-um", type=float, help="size of a scan's pixel, in place of --extent-um")
    group.add_argument("--height-range-um", type=float, help="height that an integer image's full scale stands for")
    group.add_argument("--level", type=int, metavar="ORDER", help="subtract a polynomial of this order (1: a plane)")
    group.add_argument("--despike", action="store_true", help="remove dust")
    group.add_argument("--fill", action="store_true", help="fill missing samples from those around them")
    group.add_argument("--crop-um", type=float, metavar="SIZE", help="keep a square of this size from the middle")
    group.add_argument("--periodic", action="store_true", help="make opposite edges match")
    group.add_argument(
        "--period-um", type=float, default=2.0, help="period of sinusoidal, lamellar, blazed (default: 2)"
    )
    group.add_argument("--depth-um", type=float, default=0.25, help="depth of these, peak to valley (default: 0.25)")
    return group_parser


def _add_material(group: Any) -> None:
    group.add_argument("--ior", type=float, help="index of refraction; inf is a perfect mirror (default: 1.5)")
    group.add_argument(
        "--material",
        help="what the surface is made of, in place of --ior: Al, Ag, Au, Cr, Cu, Ni, an index of refraction, or a "
        "file of refractiveindex.info, YAML or CSV",
    )
    group.add_argument(
        "--film", nargs=2, metavar=("MATERIAL", "NM"), help="a film on it of so many nanometres, of a material as above"
    )
    group.add_argument(
        "--no-masking", action="store_true", help="leave masking and shadowing of the microstructure out"
    )


def _evaluation_options() -> argparse.ArgumentParser:
    group_parser = argparse.ArgumentParser(add_help=False)
    group = group_parser.add_argument_group("evaluation")
    _add_tolerance(group)
    group.add_argument(
        "--method",
        default="auto",
        help="auto, low-rank, power, jacobi-anger, taylor, taylor-uncentred, or direct, which is slow and certain "
        "(default: auto)",
    )
    group.add_argument(
        "--coherence", default="averaged", help="averaged, centred, source or replicas (default: averaged)"
    )
    group.add_argument("--sigma-um", type=float, help="σ of a window, averaged or centred (default: 16.25)")
    group.add_argument(
        "--angular-diameter-deg", type=float, metavar="DEG", help="diameter of a source (default: the sun's, 0.53)"
    )
    group.add_argument("--copies", type=int, nargs=2, metavar=("NY", "NX"), help="copies of the patch, for replicas")
    _add_material(group)
    group.add_argument(
        "--energy", default="stam", help="stam, or normalised: what comes in is sent back, in place of masking"
    )
    group.add_argument(
        "--illuminant",
        default="D65",
        help="a CIE illuminant or light source by name, a temperature of a black body, such as 2856K, or a CSV file of "
        "wavelengths in nm and powers (default: D65)",
    )
    group.add_argument("--exposure", type=float, help="linear factor (default for PNG: from the picture; for EXR: 1)")
    group.add_argument("--exposure-stops", type=float, default=0.0, help="doublings of light on top of it (default: 0)")
    _add_display(group)
    group.add_argument(
        "--background", type=float, nargs=3, metavar=("R", "G", "B"),
        help="colour behind the picture in a PNG, each 0 to 1 (default: transparent)",
    )  # fmt: skip
    group.add_argument("--device", help="cpu (default) or cuda")
    group.add_argument("--threads", type=int, help="threads on the CPU (default: one a core)")
    return group_parser


def _add_scene(command: Any) -> None:
    """Lights, the camera and what the mesh is drawn with."""
    command.add_argument(
        "--light", type=float, nargs=3, action="append", metavar=("X", "Y", "Z"),
        help="direction towards a light, world frame; may be repeated (default: from behind the camera's shoulder)",
    )  # fmt: skip
    command.add_argument(
        "--light-diameter-deg", type=float, default=0.0, metavar="DEG", help="size of these in the sky (default: 0)"
    )
    command.add_argument("--light-power", type=float, default=1.0, metavar="POWER", help="of these (default: 1)")
    command.add_argument(
        "--eye", type=float, nargs=3, metavar=("X", "Y", "Z"), help="camera (default: frames the mesh)"
    )
    command.add_argument(
        "--target", type=float, nargs=3, metavar=("X", "Y", "Z"), help="what it looks at (default: centre)"
    )
    command.add_argument(
        "--up", type=float, nargs=3, metavar=("X", "Y", "Z"), default=(0.0, 1.0, 0.0), help="up (default: y)"
    )
    command.add_argument("--fov-y-deg", type=float, default=40.0, help="vertical field of view (default: 40)")
    command.add_argument("--pigment", type=float, default=1.0, help="strength of the mesh's base colour (default: 1)")
    command.add_argument("--no-shadows", action="store_true", help="the mesh does not shadow itself")
    command.add_argument(
        "--tangent", type=float, nargs=3, metavar=("X", "Y", "Z"),
        help="direction of the height field's x, world frame (default: the texture's u)",
    )  # fmt: skip
    command.add_argument("--flat", action="store_true", help="show facets rather than interpolated normals")


def _add_display(group: Any) -> None:
    group.add_argument("--display", default="aces", help="of PNG: aces, colorimetric or clip (default: aces)")
    group.add_argument("--gamut", default="srgb", help="of PNG: srgb or display-p3 (default: srgb)")


def _add_tolerance(group: Any) -> None:
    group.add_argument("--tolerance", type=float, default=1e-2, help="error asked for (default: 0.01)")


def _with_parameters(text: str, module: Any) -> Any:
    """What ``name:parameter=value,…`` makes of a public module's function of that name; None where there is none."""
    name, colon, given = text.partition(":")
    if not colon or name not in module.__all__:
        return None
    function = getattr(module, name)
    taken = {}
    for each in filter(None, given.split(",")):
        key, equals, value = each.partition("=")
        if not equals or key not in inspect.signature(function).parameters:
            raise _ParameterError(f"{text!r} must be {name}:parameter=value,…, of {inspect.signature(function)}")
        parts = [_number(part) for part in (value.split("x") if re.fullmatch(r"[\d.]+x[\d.]+", value) else [value])]
        taken[key] = parts[0] if len(parts) == 1 else tuple(parts)
    try:
        return function(**taken)
    except (TypeError, ValueError) as error:
        raise _ParameterError(f"{text!r}: {error}") from None


def _number(text: str) -> Any:
    """An integer or a float, or the text itself."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _height_field(options: argparse.Namespace) -> wd.HeightField:
    named = GRATINGS.get(options.heightfield.lower())
    if named is not None:
        heightfield = named(options)
    elif (made := _with_parameters(options.heightfield, wd.gratings)) is not None:
        heightfield = made
    else:
        if not validation.path(options.heightfield, "HEIGHTFIELD").is_file():
            raise FileNotFoundError(
                f"HEIGHTFIELD: there is no file {options.heightfield!r}; "
                f"a synthetic one is called by its name, one of {', '.join(GRATINGS)}"
            )
        return _scan(options.heightfield, options)
    return _cleaned(heightfield, options)


def _scan(path: str, options: argparse.Namespace) -> wd.HeightField:
    return _cleaned(wd.HeightField.load(path, **_loading(options)), options)


def _loading(options: argparse.Namespace) -> dict[str, float]:
    """What of the options ``HeightField.load`` takes."""
    given = {
        "extent_um": options.extent_um, "pitch_um": options.pixel_um, "height_range_um": options.height_range_um
    }  # fmt: skip
    return {name: value for name, value in given.items() if value is not None}


def _cleaning(options: argparse.Namespace) -> list[tuple[str, tuple[tuple[str, Any], ...]]]:
    """Methods of a height field that the options ask for, one after the other, with their arguments."""
    asked: dict[str, tuple[bool, tuple[tuple[str, Any], ...]]] = {
        "cropped": (options.crop_um is not None, (("size_um", options.crop_um),)),
        "levelled": (options.level is not None, (("order", options.level),)),
        "despiked": (options.despike, ()),
        "filled": (options.fill, ()),
        "periodic": (options.periodic, ()),
    }
    return [(name, arguments) for name, (is_asked, arguments) in asked.items() if is_asked]


def _cleaned(heightfield: wd.HeightField, options: argparse.Namespace) -> wd.HeightField:
    for name, arguments in _cleaning(options):
        heightfield = getattr(heightfield, name)(**dict(arguments))
    return heightfield


def _shared(options: argparse.Namespace) -> dict[str, Any]:
    return {
        "tolerance": options.tolerance,
        "method": options.method,
        "coherence": wd.Coherence(
            options.coherence,
            options.sigma_um,
            angular_diameter_deg=options.angular_diameter_deg,
            periods=options.periods and tuple(options.periods),
        ),
        "ior": options.ior,
        "material": _material(options),
        "masking": not options.no_masking,
        "energy": options.energy,
        "device": options.device,
        "threads": options.threads,
    }


def _material(options: argparse.Namespace) -> wd.Material | None:
    """The material that options name, under its film."""
    if options.material is None:
        if options.film is not None:
            raise ValueError("--film lies on a --material: give both")
        return None
    found = _named_material(options.material, "--material")
    if options.film is None:
        return found
    name, thickness = options.film
    try:
        thickness_nm = float(thickness)
    except ValueError:
        raise ValueError(f"--film must be a material and a number of nanometres, got {thickness!r}") from None
    return found.coated(_named_material(name, "--film"), thickness_nm)


def _illuminant(options: argparse.Namespace) -> str | wd.Spectrum:
    """The illuminant by its name, or the spectrum of a temperature or a file."""
    given: str = options.illuminant
    if re.fullmatch(r"[0-9.]+K", given):
        try:
            return wd.Spectrum.blackbody(float(given[:-1]))
        except ValueError:
            raise ValueError(f"--illuminant must be a temperature of 500K to 100000K, got {given!r}") from None
    return wd.Spectrum.from_csv(given) if Path(given).suffix else given


def _named_material(name: str, option: str) -> wd.Material:
    """A metal, a dielectric of a constant index, or what a file says."""
    if name in METAL_SYMBOLS:
        return wd.Material.metal(name)
    try:
        index = float(name)
    except ValueError:
        if not validation.path(name, option).is_file():
            raise ValueError(
                f"{option} must be one of {', '.join(METAL_SYMBOLS)}, an index of refraction, or a file, got {name!r}"
            ) from None
        return wd.Material.from_file(name)
    return wd.Material.dielectric(index)


def _demo(options: argparse.Namespace) -> None:
    from warpdiff.apps import demo

    written = demo.run(
        options.output, data=options.data, scale=options.scale, display=options.display, gamut=options.gamut,
        say=print, progress=Bar,
    )  # fmt: skip
    print(f"{len(written)} pictures in {Path(options.output).resolve()}")


def _view(options: argparse.Namespace) -> None:
    if importlib.util.find_spec("websockets") is None:
        raise ValueError("the page is served with websockets, which is not installed: pip install 'warpdiff[view]'")
    from warpdiff.apps.viewer.command import run
    from warpdiff.apps.viewer.page_calls import NamedFiles

    if not 0 <= options.port <= _MOST_PORT:
        raise ValueError(f"--port must be 0 to {_MOST_PORT}, got {options.port}")
    named = ("MESH", options.mesh), ("--height", options.height), ("--environment", options.environment)
    for name, paths in named:
        for each in paths:
            if not validation.path(each, name).is_file():
                raise FileNotFoundError(f"{name}: there is no file {each!r}")
    # What cannot be loaded is told here, rather than on the page.
    for path in options.height:
        _scan(path, options)
    for path in options.environment:
        _loaded_environment(path)
    loading, cleaning = _loading(options), _cleaning(options)
    files = NamedFiles(
        tuple(map(Path, options.mesh)), tuple(map(Path, options.height)), tuple(map(Path, options.environment)),
        tuple(loading.items()), tuple(cleaning),
    )  # fmt: skip
    run(
        files, host=options.host, port=options.port, opens_browser=not options.no_browser, device=options.device,
        threads=options.threads, say=lambda line: print(line, flush=True),
    )  # fmt: skip


def _render(options: argparse.Namespace) -> None:
    _check_output(options)
    sky = _environment(options)
    mesh, heightfield, directional, view = _scene(options)
    lights = [*_lights(options, directional, others=sky is not None), *([] if sky is None else [sky])]
    shading = _shading(options)
    image = wd.shade(mesh, heightfield, lights, view, **shading, progress=Bar(options.command))
    behind = None
    if sky is not None and options.environment_behind:
        # Pictures by an index of refraction are relative to what it reflects at normal incidence.
        normal, _ = check_reflection(shading["ior"], shading["material"])
        behind = sky.background(view) / np.float32(normal)
    _report(image, options, behind)


def _lights(
    options: argparse.Namespace, directional: list[wd.DirectionalLight], *, others: bool = False
) -> list[wd.DirectionalLight | wd.PointLight]:
    """Directional lights and those at a place; the default one is left out where there are ``others``."""
    near = [
        wd.PointLight((x, y, z), illuminant=directional[0].illuminant, power=power)
        for x, y, z, power in options.point_light
    ]
    return [*(directional if options.light or not (near or others) else ()), *near]


def _environment(options: argparse.Namespace) -> wd.Environment | None:
    """The sky that options name."""
    if options.environment is None:
        for name in ("rotation_deg", "scale", "directions", "behind"):
            if getattr(options, f"environment_{name}") not in (0.0, 1.0, None, False):
                raise ValueError(f"--environment-{name.replace('_', '-')} is of an --environment: give both")
        return None
    if options.environment_behind and options.background is not None:
        raise ValueError("--environment-behind and --background are both behind the picture: give one of them")
    if options.environment_behind and Path(options.output).suffix.lower() != ".png":
        raise ValueError(f"--environment-behind is for .png files, got --output {options.output}")
    return _loaded_environment(
        options.environment, rotation_deg=options.environment_rotation_deg, scale=options.environment_scale,
        directions=options.environment_directions,
    )  # fmt: skip


def _loaded_environment(path: str, **options: Any) -> wd.Environment:
    try:
        return wd.Environment.load(path, **options)
    except (ValueError, *_BAD_PATHS) as error:
        # Other commands' paths are height fields.
        raise type(error)(str(error).replace("path", "--environment", 1)) from None


def _scene(options: argparse.Namespace) -> tuple[Any, wd.HeightField, list[wd.DirectionalLight], wd.View]:
    """Mesh, height field, lights and view of a picture."""
    heightfield = _height_field(options)
    body = _BODIES.get(options.mesh)
    mesh = body() if body else _with_parameters(options.mesh, wd.meshes) or options.mesh
    eye, target = _frame(mesh, options)
    view = wd.View(
        eye, target, up=tuple(options.up), fov_y_deg=options.fov_y_deg, width=options.width, height=options.height
    )
    frame = view.frame()
    directions = options.light or [list(frame.back + 0.6 * frame.up + 0.3 * frame.right)]
    alike = {
        "illuminant": _illuminant(options), "angular_diameter_deg": options.light_diameter_deg,
        "power": options.light_power,
    }  # fmt: skip
    lights = [wd.DirectionalLight(tuple(each), **alike) for each in directions]
    return mesh, heightfield, lights, view


def _shading(options: argparse.Namespace) -> dict[str, Any]:
    """Options of ``shade`` and ``Renderer``."""
    return _shared(options) | {
        "pigment": options.pigment,
        "shadows": not options.no_shadows,
        "smooth": not options.flat,
        "samples_per_pixel": options.samples_per_pixel,
        "refine": not options.no_refine,
        "tangents": options.tangent,
    }


def _sequence(options: argparse.Namespace) -> None:
    for each in options.formats:
        validation.choice(each, "--formats", (".png", ".exr"))
    if options.scheduler is not None and importlib.util.find_spec("distributed") is None:
        raise ValueError("workers of Dask are asked for, which is not installed: pip install 'warpdiff[dask]'")
    mesh, heightfield, lights, view = _scene(options)
    count = 36 if options.count is None else options.count
    if options.path is not None:
        shots = wd.camera_path(options.path, lights, view, count=options.count)
    elif options.light_to is not None:
        shots = wd.light_sweep(lights[0], view, options.light_to, count=count)
    else:
        shots = wd.turntable(lights, view, count=count, turns=options.turns, lights_follow=not options.lights_stay)
    renderer = wd.Renderer(mesh, heightfield, shots[0].light, shots[0].view, **_shading(options))
    with contextlib.ExitStack() as stack:
        client = None
        if options.scheduler is not None:
            from distributed import Client

            client = stack.enter_context(Client(options.scheduler))
        paths = wd.sequence(
            renderer, shots, options.output, formats=options.formats, animation=options.animation,
            frames_per_second=options.frames_per_second, display=options.display, exposure=options.exposure,
            exposure_stops=options.exposure_stops, gamut=options.gamut, background=options.background,
            bits=options.bits, overwrite=options.overwrite, client=client, progress=Bar(options.command),
        )  # fmt: skip
    print(renderer.plan)
    print(f"{len(paths)} frames in {Path(options.output).resolve()}")
    if options.animation is not None:
        print(options.animation)


def _export_html(options: argparse.Namespace) -> None:
    target = validation.path(options.output, "OUT")
    if target.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"OUT must end in .html or .htm, got {options.output!r}")
    mesh, heightfield, lights, view = _scene(options)
    coherence = wd.Coherence(options.coherence, options.sigma_um, angular_diameter_deg=options.angular_diameter_deg)
    lobes = wd.bake(
        heightfield, illuminant=options.illuminant, material=_material(options), tolerance=options.tolerance,
        coherence=coherence, device=options.device, threads=options.threads, progress=Bar(options.command),
    )  # fmt: skip
    path = wd.export_html(
        target, mesh, lobes, _lights(options, lights), view, ior=options.ior, masking=not options.no_masking,
        pigment=options.pigment, shadows=not options.no_shadows, smooth=not options.flat, tangents=options.tangent,
        exposure=options.exposure, title=options.title,
    )  # fmt: skip
    print(lobes)
    print(f"{path}, {path.stat().st_size / 1e6:.1f} MB")


def _frame(mesh: Any, options: argparse.Namespace) -> tuple[Any, Any]:
    """The eye and target given, or such that the mesh fills the picture, seen a little from above."""
    for name in ("width", "height"):
        validation.count(getattr(options, name), name)
    validation.positive(options.fov_y_deg, "fov_y_deg", most=179.0)
    validation.directions(options.up, "up")
    if options.eye is not None and options.target is not None:
        return tuple(options.eye), tuple(options.target)
    surface = prepare_surface(mesh, tangents=options.tangent)
    target = np.asarray(surface.centre if options.target is None else options.target, dtype=np.float64)
    if options.eye is not None:
        return tuple(options.eye), tuple(target)
    up = np.asarray(options.up) / np.linalg.norm(options.up)
    # Any direction across `up` will do; +z where it can be.
    front = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    front = front - (front @ up) * up
    half = math.radians(options.fov_y_deg) / 2.0
    # The narrower of the two fields of view holds the bounding sphere.
    half = min(half, math.atan(math.tan(half) * options.width / options.height))
    distance = surface.radius / math.sin(half)
    toward = front / np.linalg.norm(front) + 0.6 * up
    return tuple(target + distance * toward / np.linalg.norm(toward)), tuple(target)


def _brdf(options: argparse.Namespace) -> None:
    _check_output(options)
    theta, phi = math.radians(options.incidence_deg), math.radians(options.azimuth_deg)
    to_light = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
    image = wd.reflectance_map(
        _height_field(options), to_light, size=options.size, illuminant=_illuminant(options), **_shared(options),
        progress=Bar(options.command),
    )  # fmt: skip
    _report(image, options)


def _check_output(options: argparse.Namespace) -> None:
    """Refuse what cannot be written, before minutes are spent on what should go there."""
    check_target(options.output, "--output")
    validation.choice(options.display, "--display", DISPLAYS)
    validation.choice(options.gamut, "--gamut", tuple(GAMUTS))
    if options.background is not None and Path(options.output).suffix.lower() != ".png":
        raise ValueError(f"--background is for .png files, got --output {options.output}")
    for each in options.background or ():
        validation.number(each, "--background", least=0.0, most=1.0)


def _report(image: wd.Image, options: argparse.Namespace, behind: NDArray[np.float32] | None = None) -> None:
    path = image.save(
        options.output, exposure=options.exposure, exposure_stops=options.exposure_stops, display=options.display,
        gamut=options.gamut, background=options.background if behind is None else behind,
    )  # fmt: skip
    print(image.plan)
    print(path)


def _info(options: argparse.Namespace) -> None:
    heightfield = _height_field(options)
    print(heightfield.summary())
    if heightfield.missing.any():
        print("\nTo be rendered, missing samples must be filled: --fill")
    else:
        print(f"\nFor the whole hemisphere: {wd.plan(heightfield, tolerance=options.tolerance, strict=False)}")


def _cache(options: argparse.Namespace) -> None:
    if options.trim_mib is not None:
        validation.number(options.trim_mib, "--trim-mib", least=0.0)
    folder = disk_cache.cache_folder()
    if folder is None:
        print("nothing is kept: WARPDIFF_CACHE_DIR is empty, or the user has no home folder")
        return
    if options.clear:
        disk_cache.clear(folder)
    elif options.trim_mib is not None:
        disk_cache.trim(folder, round(options.trim_mib * 2**20))
    kept = disk_cache.entries(folder)
    used = f", last used on {time.strftime('%Y-%m-%d', time.localtime(kept[0].used))}" if kept else ""
    total = sum(each.size for each in kept)
    print(
        f"{folder}: {len(kept)} files, {total / 2**20:.1f} MiB of at most {disk_cache.MOST_BYTES / 2**20:.0f} MiB{used}"
    )
