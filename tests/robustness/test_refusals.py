"""Error messages for single invalid arguments in Python, on the command line and in the viewer.

``python tests/robustness/test_refusals.py --write FILE`` writes all messages to a file, so that they can be read.
"""

import argparse
import contextlib
import dataclasses
import functools
import io
import math
import re
import shlex
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from warpdiff.core.options import Option

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))

import fuzz
import pytest
import warp as wp

import warpdiff as wd
from warpdiff.apps import cli
from warpdiff.apps.viewer import controls, server
from warpdiff.core.options import describe
from warpdiff.core.wording import spelled
from warpdiff.request.settings import SinglePictureSettings


class Row(NamedTuple):
    """Request with one invalid argument, and the error message with the pattern that it must match.

    Attributes:
        front: Way of the request: Python, command line or viewer.
        request: Text of the request.
        word: Name of the argument in the message.
        rule: Pattern of the rule that the message must state.
        message: Function that makes the request and returns the message.
    """

    front: str
    request: str
    word: str
    rule: str
    message: Callable[[], str]


def bad_values(option: Option) -> Iterator[tuple[object, str]]:
    """Yield values that the description of an option forbids, each with a pattern of the expected message."""
    rules = re.escape(option.range) + ".* got "
    below = option.gt if option.ge is None else option.ge - 1
    outside = [value for value in (below, option.le and option.le + 1) if value not in (None, math.inf)]
    match option.kind:
        case "flag":
            yield "no", "must be True or False, got 'no'"
        case "integer":
            yield from ((value, f"must be an integer.*{rules}{value}") for value in outside)
            yield "x", "must be an integer, got "
            yield 1.5, "must be an integer, got "
        case "number":
            yield from ((value, f"must be a .*number.*{rules}") for value in outside)
            yield "x", "must be a number, got "
            yield math.nan, "must be an? .*got nan"
        case "choice" | "choices":
            longest = max(map(str, option.choices), key=len)
            wrong = {"nonsense": "", longest[1:]: f"'; did you mean '{longest}'"} if len(longest) > 3 else {"?": ""}
            for name, near in wrong.items() if isinstance(option.choices[0], str) else [(7, "")]:
                yield (
                    name if option.kind == "choice" else (name,),
                    f"must be (one of|8 or 16).*, got '?{re.escape(str(name))}{near}",
                )
            if option.kind == "choices":
                yield longest, "must be a tuple or list"
        case "text":
            yield 5, "must be (a string|an identifier|one of)"
        case "pair":
            yield (1.0, 2.0, 3.0), r"must be one number or (a pair|two).* got"
            yield math.nan, "must be .*got nan"
            yield "x", "must be a number, got "
        case "numbers" | "integers":
            yield (1.0,) * (option.length + 1), "must "
            yield (math.nan,) * option.length, "must "
            yield from (((value,) * option.length, "must ") for value in outside)
        case "object" if option.instance_of is not None:
            yield ..., f"must be a warpdiff.{option.instance_of.__name__}, got ellipsis"


@contextlib.contextmanager
def prepared(folder: Path) -> Iterator[None]:
    """Work in a folder with the files that valid arguments refer to; kernels and servers must not start."""

    def work(*_: object, **__: object) -> None:
        raise AssertionError("work begins")

    fuzz.write_files(folder)
    with pytest.MonkeyPatch.context() as patches:
        patches.chdir(folder)
        patches.setattr(wp, "launch", work)
        patches.setattr(server, "run", work)
        yield


# The code below makes calls of public functions with one invalid argument each.

# Objects of classes that require kernels, made without initialisation. The tests only need methods of these objects to
# refuse their arguments.
BARE = {
    **{owner: object.__new__(getattr(wd, owner)) for owner in ("Image", "BakedLobes", "BakedSpectrum")},
    "renderer": object.__new__(wd.Renderer), "lobes": object.__new__(wd.BakedLobes),
}  # fmt: skip


def changed_plan(**fields: object) -> wd.Plan:
    """Return a plan (method, number of wavelengths and so on) for one direction, with other values in some fields."""
    return dataclasses.replace(wd.plan(fuzz.HEIGHTFIELD, fuzz.UP, fuzz.UP), **fields)


def python_rows() -> Iterator[Row]:
    """Yield invalid requests for the options of all public callables except the methods of ``Renderer``."""
    for name, (function, owner) in fuzz.PUBLIC.items():
        if owner == "Renderer":
            continue
        described = {option.name: option for option in fuzz.options_of(function)}
        others = {key: BARE[key] for key in BARE.keys() & described} | ({"self": BARE[owner]} if owner in BARE else {})
        for option in described.values():
            for value, rule in bad_values(option):
                call = functools.partial(fuzz.call, name, others | {option.name: value})
                if name == "Plan":
                    call = functools.partial(changed_plan, **{option.name: value})
                request = f"{name}({option.name}={value!r})"
                yield Row("python", request, option.name, rule, functools.partial(error_of, call))


# The code below makes command lines that have one invalid argument each.

FILES = ["--heightfield", "a.npy", "--pitch-um", "0.1"]
COMMANDS = {
    "render": ["disc", *FILES, "-o", "a.png"], "sequence": ["disc", *FILES, "-o", "frames"],
    "brdf": [*FILES, "-o", "a.png"], "export-html": ["a.html", "disc", *FILES], "info": FILES, "view": [], "demo": [],
}  # fmt: skip
# Arguments that replace ``FILES`` in a command, for flags that exclude ``--pitch-um`` or need another file.
INSTEAD = {"extent_um": FILES[:2], "height_range_um": ["--heightfield", "integers.npy", *FILES[2:]]}
# Functions whose options are flags of a single command. ``OWNERS`` have the options that all commands share.
FUNCTIONS = {"sequence": wd.sequence, "brdf": wd.reflectance_map, "export-html": wd.export_html}
OWNERS = (SinglePictureSettings, wd.Coherence, wd.View, wd.Image.save, wd.HeightField.load, wd.bake)


def described_flags(name: str) -> Iterator[tuple[str, str, Option]]:
    """Yield each flag of a command that has a value: its name in argparse's result, the flag and the option."""
    described = {f"environment_{key}": option for key, option in describe(wd.Environment.load).items()}
    for owner in (*OWNERS, *([FUNCTIONS[name]] if name in FUNCTIONS else [])):
        described |= {key: option for key, option in describe(owner).items() if option.kind != "object"}
    parser = cli._parser([name])
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    for action in commands.choices[name]._actions:
        option = described.get(action.dest)
        if option and action.option_strings and option.kind not in ("flag", "text"):
            yield action.dest, action.option_strings[0], option


def command_line_rows() -> Iterator[Row]:
    """Yield invalid command lines of every command, for each flag that is made from an option description."""
    for name, arguments in COMMANDS.items():
        for key, flag, option in described_flags(name):
            more = ["--environment", "sky.exr"] if key.startswith("environment_") else []
            base = [text for text in arguments if text not in FILES] + INSTEAD[key] if key in INSTEAD else arguments
            for value, rule in bad_values(option):
                texts = [str(part) for part in (value if isinstance(value, tuple) else [value])]
                # Shell arguments are texts, and each flag has a fixed number of values, so some errors cannot occur.
                if (option.kind == "choices" and isinstance(value, str)) or len(texts) == option.length + 1 > 1:
                    continue
                line = [name, *base, *more, flag, *texts]
                yield Row("command line", " ".join(line), flag, rule, functools.partial(error_of_command, line))


# Arguments that the refused Python calls and command lines below share. In a command line, ``…`` stands for the text
# ``DISC``.
DISC = "disc --heightfield a.npy --pitch-um 0.1 -o a.png"
SKY = wd.Environment([[[1.0, 1.0, 1.0]] * 4] * 2)
Z_UP = wd.View((0.0, -5.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))


def shade(heightfield: wd.HeightField = fuzz.HEIGHTFIELD, **options: object) -> wd.Image:
    return wd.shade(fuzz.MESH, heightfield, fuzz.LIGHT, fuzz.VIEW, **options)


# Rules about pairs of arguments and about files: a call in Python with the expected error message, and a command line
# with its message.
RULES = [
    (lambda: wd.Coherence(centre_um=(1, 1)), "centre_um is for kind='centred', not 'averaged': remove it",
     "render … --centre-um 1 1", "--centre-um is for --coherence centred, not 'averaged': remove it"),
    (lambda: wd.Coherence("source", 3.0), "sigma_um is for kind='averaged' or kind='centred', not 'source': remove it",
     "render … --coherence source --sigma-um 3",
     "--sigma-um is for --coherence averaged or --coherence centred, not 'source': remove it"),
    (lambda: wd.Coherence("replicas"), "periods must be given for kind='replicas', such as periods=(1, 100)",
     "render … --coherence replicas",
     "--periods must be given for --coherence replicas, such as --periods 1 100"),
    (lambda: wd.Coherence(periods=(2, 2)), "periods is for kind='replicas', not 'averaged': remove it",
     "render … --periods 2 2", "--periods is for --coherence replicas, not 'averaged': remove it"),
    (lambda: wd.Coherence(angular_diameter_deg=1.0), "angular_diameter_deg is for kind='source', not 'averaged'",
     "render … --source-diameter-deg 1", "--source-diameter-deg is for --coherence source, not 'averaged'"),
    (lambda: shade(integration="table", method="direct"), "integration must be 'auto' for method='direct'",
     "render … --integration table --method direct", "--integration must be 'auto' for --method direct"),
    (lambda: shade(integration="table", method="taylor"), "method='taylor' has no table for ",
     "render … --integration table --method taylor", "--method taylor has no table for "),
    (lambda: shade(method="power", coherence=wd.Coherence("centred")), "method='power' cannot be used with kind='cen",
     "render … --method power --coherence centred", "--method power cannot be used with --coherence centred"),
    (lambda: shade(ior=1.5, material=wd.Material.metal("Au")), "ior must not be given with material, got 1.5",
     "render … --ior 1.5 --material Au", "--ior must not be given with --material, got 1.5"),
    (lambda: shade(footprint=True, method="direct"), "footprint=True cannot be used with method='direct', which sums",
     "render … --footprint --method direct", "--footprint cannot be used with --method direct, which sums"),
    (lambda: wd.View((0, 0, 5), (0, 0, 5)), "eye and target must be two different points, got (0.0, 0.0, 5.0)",
     "render … --eye 0 0 5 --target 0 0 5", "--eye and --target must be two different points"),
    (lambda: wd.View((0, 0, 5), (0, 0, 0), up=(0, 0, 1)), "up must not be parallel to the line of sight from eye to ",
     "render … --eye 0 0 5 --target 0 0 0 --up 0 0 1", "--up must not be parallel to the line of sight from --eye to "),
    (lambda: wd.View((0, 0, 5), (0, 0, 0), width=10**5, height=10**5), "width times height must be at most 2147483647",
     "render … --width 100000 --height 100000", "--width times --height must be at most 2147483647 pixels"),
    (lambda: wd.HeightField.load("a.npy"), "exactly one of extent_um (size of the field) and pitch_um",
     "info --heightfield a.npy", "exactly one of --extent-um (size of the field) and --pitch-um"),
    (lambda: wd.HeightField.load("a.npy", pitch_um=1, height_range_um=1), "height_range_um must not be given: 'a.npy'",
     "info --heightfield a.npy --pitch-um 1 --height-range-um 1", "--height-range-um must not be given: 'a.npy'"),
    (lambda: wd.HeightField.load("integers.npy", pitch_um=1), "height_range_um must be given: 'integers.npy' has integ",
     "info --heightfield integers.npy --pitch-um 1", "--height-range-um must be given: 'integers.npy' has integ"),
    (lambda: shade(wd.HeightField([[0.0, math.nan]], 1.0)), "heightfield must have all samples, but 1 of 2 are ",
     "brdf --heightfield gaps.npy --pitch-um 1 -o a.png", "--heightfield must have all samples, but 1 of 2 are "),
    (lambda: fuzz.WAVY.cropped(99.0), "size_um along y must be from 0.1 to 0.8, got 99",
     "render … --crop-um 99", "--crop-um along y must be from 0.1 to 0.8, got 99"),
    (lambda: fuzz.WAVY.levelled(-1), "order must be an integer, at least 0, got -1",
     "render … --level -1", "--level must be an integer, at least 0, got -1"),
    (lambda: shade(device="gpu"), "device must be 'cpu', or 'cuda' on a machine with a CUDA device, got 'gpu'",
     "render … --device gpu", "--device must be 'cpu', or 'cuda' on a machine with a CUDA device, got 'gpu'"),
    (lambda: shade(tangents=(0, 0, 0)), "tangents must define a direction along the surface, got none at any vertex",
     "render … --tangents 0 0 0", "--tangents must define a direction along the surface, got none"),
    (lambda: shade(tangents="smoth"), "tangents must be one of 'x', 'y', 'z', 'around-x', 'around-y', 'around-z', ",
     "render … --tangents smoth", "--tangents must be one of x, y, z, around-x, around-y, around-z, smooth, or three"),
    (lambda: wd.DirectionalLight((0, 0, 0)), "to_light must not contain zero vectors, got 1",
     "render … --light 0 0 0", "--light must not contain zero vectors, got 1"),
    (lambda: wd.light_sweep(fuzz.LIGHT, fuzz.VIEW, (0, 0, 0)), "to_light must not contain zero vectors, got 1",
     "sequence … --light-to 0 0 0", "--light-to must not contain zero vectors, got 1"),
    (lambda: wd.camera_path("a.npy", fuzz.LIGHT, fuzz.VIEW), "path: 'a.npy' is not a CSV file: ",
     "sequence … --path a.npy", "--path: 'a.npy' is not a CSV file: "),
    (lambda: wd.camera_path("no.csv", fuzz.LIGHT, fuzz.VIEW), "path: there is no file 'no.csv'",
     "sequence … --path no.csv", "--path: there is no file 'no.csv'"),
    (lambda: wd.light_sweep(SKY, fuzz.VIEW, (0, 0, 1)), "lights[0] must be a DirectionalLight or a PointLight",
     "sequence … --environment clear-sky --light-to 0 0 1", "--light must be a DirectionalLight or a PointLight"),
    (lambda: wd.turntable(SKY, Z_UP), "lights[0] is an Environment, which rotates about +y only, got a rotation ",
     "sequence … --environment clear-sky --up 0 0 1", "--light is an Environment, which rotates about +y only, got "),
    (lambda: wd.reflectance_map(fuzz.HEIGHTFIELD, (1, 0, 0)), "to_light must lie above the horizon (z > 0)",
     "brdf --heightfield cd -o a.png --incidence-deg 95", "--incidence-deg must be more than -90 and less than 90"),
    (lambda: wd.reflectance_map(fuzz.HEIGHTFIELD, fuzz.UP, samples_per_pixel=3), "samples_per_pixel must be a square",
     "brdf --heightfield cd -o a.png --samples-per-pixel 3", "--samples-per-pixel must be a square number, got 3"),
    (lambda: wd.reflectance_map(fuzz.HEIGHTFIELD, fuzz.UP, size=10**5), "size × size × samples_per_pixel must be at",
     "brdf --heightfield cd -o a.png --size 100000", "--size × --size × --samples-per-pixel must be at "),
    (lambda: wd.bake(fuzz.HEIGHTFIELD, coherence=wd.Coherence("centred")), "coherence must be of kind 'averaged' or",
     "export-html a.html --coherence centred", "--coherence must be of kind 'averaged' or"),
    (lambda: wd.Environment.load("no.exr"), "path: there is no file 'no.exr'",
     "render … --environment no.exr", "--environment: there is no file 'no.exr'"),
    (lambda: wd.Environment.load("sky.exr", scale=-2), "scale must be a finite number, at least 0 and at most 1e+09",
     "render … --environment sky.exr --environment-scale -2", "--environment-scale must be a finite number, at least"),
    (lambda: wd.shade("no.obj", fuzz.HEIGHTFIELD, fuzz.LIGHT, fuzz.VIEW), "the mesh file 'no.obj' does not exist",
     "render no.obj --heightfield cd -o a.png", "the MESH file 'no.obj' does not exist"),
    (lambda: BARE["Image"].save("a.jpg"), "path must end in .exr or .png, got 'a.jpg'",
     "render disc --heightfield cd -o a.jpg", "--output must end in .exr or .png, got 'a.jpg'"),
    (lambda: BARE["Image"].save("no/a.png"), "path: the folder 'no' does not exist; create it first",
     "render disc --heightfield cd -o no/a.png", "--output: the folder 'no' does not exist; create it first"),
]  # fmt: skip
# Expected error messages of rules that only the command line has.
LINES = {
    "render … --film Au 100": "--film requires --material: give both",
    "render … --material Au --film 1.5 x": "--film must be a material and a number of nanometres, got 'x'",
    "render … --material Au --film 1.5 -3": "--film must be a finite number, more than 0 and at most 1000, got -3.0",
    "render … --material Auu": "--material must be one of Al, Ag, Au, Cr, Cu, Ni, an index of refraction, or a file, g",
    "render … --material Agg": ".*got 'Agg'; did you mean 'Ag'?",
    "render … --material 0.5": "--material must be a finite number, more than 1, got 0.5",
    "render … --illuminant D66": "--illuminant must be one of A, B, C, D50",
    "render … --illuminant 20K": "--illuminant must be a temperature of 500K to 100000K, got '20K'",
    "render … --illuminant x.csv": "--illuminant: there is no file 'x.csv'",
    "render … --light 0 0": "--light must be three numbers X Y Z, or KIND:name=value,…, got '0 0'",
    "render … --light pont:power=3": ".*'point:'; did you mean 'point'?",
    "render … --light point:power=3": "--light 'point:power=3' requires the parameter position",
    "render … --light point:powr=3": "--light 'point:powr=3' has 'powr=3', but its parameters are position, ",
    "render … --light point:position=0x0x1,power=-3": ".*power must be a finite number, at least 0 and at most 1e+12, ",
    "render … --background 2 0 0": "--background must be a finite number, at least 0 and at most 1, got 2.0",
    "render … --background 1 x 0": "--background must be a number, got 'x'",
    "brdf --heightfield cd -o a.exr --background 0 0 0": "--background is for .png files, got --output a.exr",
    "render … --environment-behind": "--environment-behind requires --environment",
    "sequence … --light-to 0 0 1 --lights-turn": "--lights-turn is for --turns, not for --light-to: give one of them",
    "render … --environment-scale 2": "--environment-scale requires --environment",
    "render … --environment sky.exr --environment-behind --background 0 0 0": "--environment-behind and --background b",
    "render disc --heightfield cd -o a.exr --environment sky.exr --environment-behind": "--environment-behind is for .",
    "info --heightfield fingrs": "--heightfield: there is no file 'fingrs'; a synthetic one is called by its name, one",
    "info --heightfield bloo-ray": ".*; did you mean 'blu-ray'?",
    "info --heightfield 'kind of order=1, size_um must.png'": ".*there is no file 'kind of order=1, size_um must.png'",
    "info --heightfield fingers:size_um=-3": "--heightfield 'fingers:size_um=-3': size_um must be a finite number, mor",
    "info --heightfield fingers:sise_um=3": "--heightfield 'fingers:sise_um=3' has 'sise_um=3', but its parameters are",
    "info --heightfield disc:kind=CDD": "--heightfield 'disc:kind=CDD': kind must be one of 'CD', 'DVD', 'Blu-ray', go",
    "info --heightfield sky.exr --pitch-um 1": "--heightfield: 'sky.exr' is a colour image (3 channels); save its heig",
    "info --heightfield a.npy --pitch-um 1 2 3": "--pitch-um must be one number or two, got 3",
    "render a.npy --heightfield cd -o a.png": "MESH must be a file of the formats .gltf, .glb, .obj, .ply, ",
    "render snake:tangent=alng --heightfield cd -o a.png": "MESH 'snake:tangent=alng': tangent must be one of 'around'",
    "render tube:foo=3 --heightfield cd -o a.png": "MESH 'tube:foo=3' has 'foo=3', but its parameters are radius, leng",
    "sequence … --turns nan": "--turns must be a finite number, at least -1e+06 and at most 1e+06, got nan",
    "sequence … --light-to 0 0 1 --turns 2": "--turns: not allowed with argument --light-to",
    "export-html a.txt": "OUT must end in .html or .htm, got 'a.txt'", "view no.obj": "MESH: there is no file 'no.obj'",
    "view --heightfield no.png": "--heightfield: there is no file 'no.png'",
    "view --port -1": "--port must be 0 to 65535, got -1",
    "demo --scale 0": "--scale must be a finite number, more than 0, got 0.0",
    "cache --trim-mib -1": "--trim-mib must be a finite number, at least 0, got -1.0",
    "info --tolernce 3 --heightfield cd": "there is no argument '--tolernce'; did you mean '--tolerance'?",
    "render": "the following arguments are required: MESH, --heightfield, -o/--output",
}  # fmt: skip


def written_rows() -> Iterator[Row]:
    """Yield invalid requests that break rules about several values.

    The rules are about two arguments, about files, or about names of height fields and meshes.
    """
    for call, text, line, line_text in RULES:
        yield Row("python", text, "", re.escape(text), functools.partial(error_of, call))
        yield of_line(line, line_text)
    for line, text in LINES.items():
        yield of_line(line, text)


def of_line(line: str, text: str) -> Row:
    """Return the invalid request that a command line makes.

    The error message must begin with ``text``, or contain it if ``text`` begins with ``.*``.
    """
    rule = re.escape(text.removeprefix(".*"))
    call = functools.partial(error_of_command, shlex.split(line.replace("…", DISC)))
    return Row("command line", line, "", f".*{rule}" if text.startswith(".*") else rule, call)


def error_of_command(line: list[str]) -> str:
    """Return the error message of a command line, without the name of the command."""
    error = io.StringIO()
    with contextlib.redirect_stderr(error), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = cli.main(line)
        except SystemExit as stopped:
            code = stopped.code
    # On a slow machine, lines of progress precede the error message. They are removed.
    text = re.sub(r"warpdiff [\w-]+: \d+ % after \d+ s\n", "", error.getvalue())
    return text.removeprefix(f"warpdiff {line[0]}: ") if code == 2 else f"exit code {code}: {text}"


# The code below makes requests of the viewer's page that have one invalid value each.


def viewer_rows() -> Iterator[Row]:
    """Yield invalid requests for all controls of the viewer, with values that the page itself cannot send."""
    known = controls.controls(environments=["sky.exr"])
    for control in known.values():
        low, high, _ = control.slider or (0.0, 0.0, 0.0)
        if control.labels:
            values = {"nonsense": "must be one of .*, got 'nonsense'", 1e9: "must be one of .*, got 1000000000.0"}
        elif control.slider:
            values = {"x": "must be a number, got 'x'", math.nan: "must be a finite number, .*got nan"}
            values |= {value: f"must be a finite number, .*got {value}" for value in (low - 1, high + 1)}
        else:
            values = {"no": "must be on or off, got 'no'", 1: "must be on or off, got 1"}
        for value, rule in values.items():
            call = functools.partial(error_on_page, known, {control.name: value})
            yield Row("viewer", f"{control.name}: {value!r}", control.label, rule, call)


def error_on_page(known: dict[str, controls.Control], values: dict[str, object]) -> str:
    """Return the error message for values sent by the viewer's page."""
    try:
        controls.checked(known, values)
    except (TypeError, ValueError) as error:
        return spelled(error, controls.word(known, controls.defaults(known)))
    return "it is accepted"


def error_of(call: Callable[[], object]) -> str:
    """Return the message of the error that a call raises."""
    try:
        call()
    except (TypeError, ValueError, OSError) as error:
        return str(error)
    return "it is accepted"


ROWS = [*python_rows(), *command_line_rows(), *written_rows(), *viewer_rows()]
NAMES = {option.name for function, _ in fuzz.PUBLIC.values() for option in describe(function).values()}
# Words that only have a meaning in Python: argument names with an underscore, and constants.
PYTHON_ONLY = re.compile(
    rf"(?<![-\w])(?:{'|'.join(name for name in NAMES if '_' in name)}|True|False|None)(?!\w)|kind="
)


@pytest.fixture(autouse=True, scope="module")
def _prepared(tmp_path_factory):
    with prepared(tmp_path_factory.mktemp("refusals")):
        yield


def test_each_front_end_refuses_at_least_150_requests():
    fronts = [row.front for row in ROWS]
    assert all(fronts.count(front) >= 150 for front in ("python", "command line", "viewer"))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.front}: {row.request}")
def test_messages_name_an_argument_as_the_user_wrote_it(row):
    message = row.message()
    assert re.match(rf"{re.escape(row.word)}(?!\w).*?{row.rule}" if row.word else row.rule, message)
    assert "\n" not in message.strip()
    assert not re.search("[\ue000-\uf8ff]", message)
    if row.front != "python":
        # Quotations from the user's input and lists of valid parameters may contain names of Python. They are removed
        # before the test.
        prose = re.sub(r"'[^']*'|but its parameters are .*", "", message)
        assert not {word for word in PYTHON_ONLY.findall(prose) if word not in row.request}


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    target = Path(sys.argv[2]).resolve()
    with tempfile.TemporaryDirectory() as name, prepared(Path(name)):
        lines = [f"{row.front} | {row.request} | {row.message().strip()}" for row in ROWS]
    target.write_text("\n".join(lines), encoding="utf-8")
