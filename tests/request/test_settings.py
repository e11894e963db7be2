"""Settings: each field is an option of Python, command line and viewer; misspelt or invalid ones raise one error."""

import inspect
import json
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import warpdiff as wd
from warpdiff.core.options import REQUIRED, Option, describe
from warpdiff.request import settings

ROOT = Path(__file__).resolve().parents[2]
GROUPS = {
    wd.spectral_reflectance: settings.SpectralSettings, wd.reflectance: settings.EvaluationSettings,
    wd.reflectance_map: settings.EvaluationSettings, wd.brdf: settings.BrdfSettings, wd.plan: settings.PlanSettings,
    wd.shade: settings.SinglePictureSettings, wd.Renderer.__init__: settings.PictureSettings,
    wd.to_srgb: settings.ColourSettings, wd.plot.reflectance_map: settings.ColourSettings,
    wd.plot.colour_strip: settings.ColourSettings, wd.Image.display: settings.GamutSettings,
    wd.Image.save: settings.DisplaySettings, wd.sequence: settings.DisplaySettings,
}  # fmt: skip
UP = (0.0, 0.0, 1.0)
FIELD = """    sparkle: Annotated[float, Interval(ge=0.0, le=2.0)] = 0.5
"""
MEANING = """        sparkle: Strength of a probe.
"""
FACTS = "sparkle: Strength of a probe. (at least 0 and at most 2; default 0.5)"
REFUSED = "sparkle must be a finite number, at least 0 and at most 2, got 3.0"
PROBE = """
import contextlib, inspect, io, json, warpdiff as wd
from warpdiff.apps import cli
from warpdiff.apps.viewer import controls
try:
    wd.shade(wd.meshes.disc(), wd.gratings.bumps(), wd.DirectionalLight((0, 0, 1)),
             wd.View((0, 0, 3), (0, 0, 0), width=4, height=3), sparkle=3.0)
except ValueError as error:
    refused = str(error)
schema = controls.described(controls.controls())
with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
    cli.main(["render", "--help"])
print(json.dumps({
    "signature": str(inspect.signature(wd.shade).parameters["sparkle"]), "help": wd.shade.__doc__, "refused": refused,
    "viewer": [each for each in schema if each["name"] == "sparkle"], "options": shown.getvalue(),
}))
"""
# Script that calls public functions with an option of display transforms. Each function must pass the option to the
# transform.
DISPLAY_PROBE = """
import inspect, json, types, warpdiff as wd
from warpdiff.apps.cli import main
from warpdiff.apps.viewer import controls, page_calls
from warpdiff.apps.viewer.session import Studio
from warpdiff.image import display_transform

body, surface, window = wd.meshes.disc(segments=8, rings=1), wd.gratings.bumps(), wd.Coherence(sigma_um=2.0)
light, view = wd.DirectionalLight((0, 0, 1)), wd.View((0, 0, 3), (0, 0, 0), width=4, height=3)
renderer = wd.Renderer(body, surface, light, view, coherence=window, tolerance=0.3, refine=False)
renderer.draw()
image = renderer.image()
calls = {
    "to_srgb": (wd.to_srgb, lambda **options: wd.to_srgb([0.2, 0.1, 0.1], **options)),
    "display": (wd.Image.display, image.display),
    "save": (wd.Image.save, lambda **options: image.save("a.png", **options)),
    "reflectance_map": (wd.plot.reflectance_map, lambda **options: wd.plot.reflectance_map(image, **options)),
    "colour_strip": (
        wd.plot.colour_strip,
        lambda **options: wd.plot.colour_strip([[0.2, 0.1, 0.1]] * 2, angles_deg=[0.0, 1.0], **options),
    ),
    "sequence": (
        wd.sequence,
        lambda **options: wd.sequence(renderer, wd.turntable(light, view, count=1), "turn", overwrite=True, **options),
    ),
}
used = []
encode = display_transform.encode
display_transform.encode = lambda xyz, shown, **more: used.append(shown.sparkle) or encode(xyz, shown, **more)
result = {}
for name, (function, call) in calls.items():
    used.clear()
    call(sparkle=1.5)
    try:
        call(sparkle=3.0)
    except ValueError as error:
        refused = str(error)
    signature = str(inspect.signature(function).parameters["sparkle"])
    result[name] = {"signature": signature, "help": function.__doc__, "refused": refused, "used": list(used)}

used.clear()
command = "brdf --heightfield bumps --size 4 --sigma-um 2 --tolerance 0.3 -o map.png --sparkle 1.5"
assert main(command.split()) == 0
result["command"] = list(used)
files = page_calls.NamedFiles()
values = controls.checked(files.controls, {"sparkle": 1.5})
session, request = types.SimpleNamespace(exposure=None), types.SimpleNamespace(values=values)
studio = types.SimpleNamespace(files=files)
result["page"] = Studio._display_options(studio, session, request, image, moving=False)["sparkle"]
print(json.dumps(result))
"""


def copied(folder, first="pigment: Strength", field="pigment: Annotated"):
    """Copy the package with one additional field in a class of settings (options of public functions).

    Args:
        folder: Folder of the copy.
        first: Start of the entry in the docstring before which the meaning of the new field is inserted.
        field: Start of the field before which the new field is inserted.
    """
    shutil.copytree(ROOT / "warpdiff", folder / "warpdiff", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "kernels", folder / "warpdiff" / "kernels", ignore=shutil.ignore_patterns("__pycache__"))
    path = folder / "warpdiff" / "request" / "settings.py"
    source = path.read_text(encoding="utf-8")
    for mark, text in ((f"        {first}", MEANING), (f"    {field}", FIELD)):
        assert source.count(mark) == 1
        source = source.replace(mark, text + mark)
    path.write_text(source, encoding="utf-8")
    return source


def run(folder, *arguments):
    code = "import sys; sys.path.insert(0, sys.argv.pop(1)); "
    done = subprocess.run(
        [sys.executable, "-c", code + arguments[0], str(folder), *arguments[1:]], capture_output=True, text=True,
        timeout=300, check=False, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_field_is_an_option_everywhere(tmp_path):
    from bench.dev.write_keywords import keywords

    source = copied(tmp_path)
    result = json.loads(run(tmp_path, PROBE))
    assert result["signature"] == "sparkle=0.5"
    assert FACTS in result["help"]
    assert result["refused"] == REFUSED
    (control,) = result["viewer"]
    assert (control["minimum"], control["maximum"], control["default"]) == (0.0, 2.0, 0.5)
    assert "--sparkle X" in result["options"]
    assert "Strength of a probe. (at least 0 and at most 2; default:" in " ".join(result["options"].split())
    assert "    sparkle: float\n" in keywords(source)


# This test starts five processes with a copy of the package, which takes 17 s.
@pytest.mark.slow
def test_a_field_of_the_display_is_an_option_everywhere(tmp_path):
    copied(tmp_path, "exposure: Linear factor", "exposure: Annotated")
    *_, result = run(tmp_path, DISPLAY_PROBE).splitlines()
    result = json.loads(result)
    for name in ("to_srgb", "display", "save", "reflectance_map", "colour_strip", "sequence"):
        assert result[name] == {
            "signature": "sparkle=0.5", "help": result[name]["help"], "refused": REFUSED, "used": [1.5],
        }  # fmt: skip
        assert FACTS in result[name]["help"]
    assert result["command"] == [1.5]
    assert result["page"] == 1.5
    for command in ("render", "sequence", "brdf", "demo"):
        shown = run(tmp_path, "from warpdiff.apps.cli import main; main(sys.argv[1:])", command, "--help")
        assert "--sparkle X" in shown


def test_generated_keywords_equal_the_settings():
    from bench.dev.write_keywords import KEYWORDS, SETTINGS, keywords

    written = KEYWORDS.read_text(encoding="utf-8")
    assert written == keywords(SETTINGS.read_text(encoding="utf-8")), "run python -m bench.dev.write_keywords"


@pytest.mark.parametrize("function", GROUPS, ids=lambda each: each.__qualname__)
def test_signatures_and_docstrings_list_every_option(function):
    options = describe(GROUPS[function])
    parameters = inspect.signature(function).parameters
    for option in options.values():
        assert parameters[option.name].default == option.default
        assert option.help, option.name
        assert f"{option.name}: " in function.__doc__
    assert not [each for each in parameters.values() if each.kind is each.VAR_KEYWORD]


def test_errors_of_misspelt_names_propose_the_correct_name():
    heightfield = wd.gratings.bumps()
    with pytest.raises(TypeError, match=r"^reflectance\(\) has no argument tolernce; did you mean 'tolerance'\?$"):
        wd.reflectance(heightfield, UP, UP, tolernce=0.1)
    with pytest.raises(TypeError, match=r"^bake\(\) has no argument tolerance; did you mean"):
        wd.bake(heightfield, tolerance=2.0)
    with pytest.raises(ValueError, match=r"^method must be one of .*, got 'lowrank'; did you mean 'low-rank'\?$"):
        wd.reflectance(heightfield, UP, UP, method="lowrank")
    with pytest.raises(TypeError, match=r"^coherence must be a warpdiff\.Coherence, got str$"):
        wd.reflectance(heightfield, UP, UP, coherence="centred")


def test_american_spellings_are_accepted():
    assert settings.EvaluationSettings(energy="normalized").energy == "normalised"
    assert settings.EvaluationSettings(method="taylor-uncentered").method == "taylor-uncentred"
    assert wd.Coherence("centered") == wd.Coherence("centred")


MISSPELT = """
import warpdiff as wd
surface = wd.gratings.bumps()
up = (0.0, 0.0, 1.0)
wd.reflectance(surface, up, up, tolerance=0.1, method="low-rank")
wd.reflectance(surface, up, up, tolernce=0.1)  # misspelt name
wd.reflectance(surface, up, up, tolerance="0.1")  # wrong type
wd.reflectance(surface, up, up, method="lowrank")  # wrong literal
wd.Coherence("centerd")  # wrong literal
"""


# This test is slow, because type checkers read the whole package.
@pytest.mark.slow
@pytest.mark.parametrize("checker", ["mypy", "pyright"])
def test_type_checkers_report_misspelt_options(checker, tmp_path):
    command = shutil.which(checker, path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip(f"{checker} is not installed: make lint installs it")
    (tmp_path / "calls.py").write_text(MISSPELT, encoding="utf-8")
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({"extraPaths": [str(ROOT)]}), encoding="utf-8")
    ini = f"[mypy]\nmypy_path = {ROOT}\nfollow_imports = silent\nignore_missing_imports = True\n"
    (tmp_path / "mypy.ini").write_text(ini, encoding="utf-8")
    done = subprocess.run(
        [command, "calls.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )  # fmt: skip
    lines = {number: line for number, line in enumerate(MISSPELT.splitlines(), 1) if "# " in line}
    for number in range(1, len(MISSPELT.splitlines()) + 1):
        assert (f"calls.py:{number}:" in done.stdout) == (number in lines), done.stdout


def legal(option: Option) -> st.SearchStrategy:
    """Return a Hypothesis strategy (random values) for the legal values of an option, derived from its description."""
    if option.choices:
        return st.sampled_from(option.choices)
    if option.kind == "flag":
        return st.booleans()
    low = option.gt if option.ge is None else option.ge
    low, high = (-1e3 if low is None else low), (1e3 if option.le is None else option.le)
    if option.kind == "integer":
        return st.integers(int(low), int(high))
    return st.floats(low, high, exclude_min=option.ge is None, allow_nan=False)


SIMPLE = {
    name: legal(option)
    for name, option in describe(settings.PictureSettings).items()
    if option.kind in ("flag", "choice", "integer", "number")
}


@given(st.fixed_dictionaries({}, optional=SIMPLE))
def test_settings_accept_the_values_that_their_descriptions_allow(values):
    try:
        made = settings.PictureSettings(**values)
    except ValueError as error:
        # A legal value of an option may be refused only if it does not fit to the value of ``method``. The message must
        # then name ``method``.
        assert "method" in str(error)  # noqa: PT017
    else:
        for name, value in values.items():
            assert getattr(made, name) == value


def test_every_option_has_a_default_and_a_description():
    for group in set(GROUPS.values()):
        for option in describe(group).values():
            assert option.default is not REQUIRED
            assert option.help.endswith(".")
            assert isinstance(option, Option)


def warned(call):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", wd.WarpdiffWarning)
        call()
    return [each.filename for each in caught if issubclass(each.category, wd.WarpdiffWarning)]


def test_warnings_name_the_line_of_the_caller():
    coarse = wd.HeightField(0.1 * np.sin(np.arange(64.0))[None, :] * np.ones((8, 1)), 0.4)
    light, view = wd.DirectionalLight((0.3, 0.2, 1.0)), wd.View((0, 0, 3), (0, 0, 0), width=6, height=4)
    window, disc = {"coherence": wd.Coherence(sigma_um=2.0), "tolerance": 0.1}, wd.meshes.disc(segments=8, rings=1)
    steep = np.array([[0.9, 0.0, 0.4]]), np.array([[0.9, 0.1, 0.4]])
    calls = [
        lambda: wd.reflectance(coarse, *steep, **window),
        lambda: wd.spectral_reflectance(coarse, *steep, [400.0], **window),
        lambda: wd.brdf(coarse, *steep, [400.0], **window), lambda: wd.reflectance_map(coarse, UP, size=8, **window),
        lambda: wd.plan(coarse, **window), lambda: wd.order_efficiencies(coarse, UP, 400.0),
        lambda: wd.Renderer(disc, coarse, light, view, **window),
        lambda: wd.shade(disc, coarse, light, wd.View((0, -2.9, 0.4), (0, 0, 0), width=6, height=4), **window),
        lambda: wd.HeightField(1e3 * coarse.heights_um, 0.4),
    ]  # fmt: skip
    for number, call in enumerate(calls):
        files = warned(call)
        assert files, number
        assert set(files) == {__file__}, number
