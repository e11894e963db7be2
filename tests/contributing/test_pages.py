"""Pages for contributors: the code on these pages works as printed."""

import contextlib
import importlib.util
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps import cli
from warpdiff.core.options import describe
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.heightfield.readers import reader_registry
from warpdiff.request import settings

ROOT = Path(__file__).parents[2]


def page_text(page):
    return (ROOT / "docs" / "contributing" / f"{page}.md").read_text(encoding="utf-8")


def blocks(page):
    """Return the Python blocks of a page."""
    return re.findall(r"```python\n(.*?)```", page_text(page), re.DOTALL)


@pytest.fixture
def module_of(tmp_path, monkeypatch):
    """Return a function that imports code, or the first block of a page, from a temporary file, as Warp requires."""

    def load(page, code=None):
        code = blocks(page)[0] if code is None else code
        path = tmp_path / f"page_{page}.py"
        path.write_text(code, encoding="utf-8")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, path.stem, module)
        spec.loader.exec_module(module)
        return module

    return load


LINE = (-0.7, 1.8, 1.0), (0.7, 1.8, 1.0)


def picture(light, fingers):
    body = wd.meshes.tube(segments_along=12, segments_around=12)
    view = wd.View.fit(body, width=24, height=18)
    return wd.shade(body, fingers, light, view, coherence=wd.Coherence(sigma_um=2.0), tolerance=0.1, pigment=0.0)


def relative_errors(image, reference):
    """Return the errors of a picture's pixels relative to the luminance of a reference picture.

    In dark pixels, errors are relative to 5 % of the largest luminance of the reference.
    """
    luminance = np.maximum(reference.xyz[..., 1], 0.05 * reference.xyz[..., 1].max())
    return np.abs(image.xyz - reference.xyz).max(axis=2) / luminance


def test_the_light_of_the_page_about_lights_equals_many_point_lights(module_of, fingers):
    """The line light on the page must give the same picture as 32 point lights along the line.

    Both pictures have a tolerance of 0.1, so that they may differ by 0.2.
    """
    start, end = np.array(LINE)
    points = [wd.PointLight(tuple(start + t * (end - start)), power=3.0 / 32) for t in (np.arange(32) + 0.5) / 32]
    page = module_of("add_a_light")
    errors = relative_errors(picture(page.LineLight(*LINE, power=3.0), fingers), picture(points, fingers))
    assert np.percentile(errors, 99.0) < 0.2


@pytest.mark.parametrize("count", [1, 3])
def test_lobes_of_the_page_about_lights_have_power_mean_and_variance_of_the_line(module_of, count):
    """Lobes without their Gaussian extents (``deviations``) would have a smaller variance than the uniform line."""
    start, end = np.array(LINE)
    lobes = module_of("add_a_light").LineLight(*LINE, power=3.0, lobe_count=count).lobes()
    positions, extents = (np.array([getattr(lobe, name) for lobe in lobes]) for name in ("position", "deviations"))
    assert sum(lobe.power for lobe in lobes) == pytest.approx(3.0)
    np.testing.assert_allclose(positions.mean(axis=0), 0.5 * (start + end), atol=1e-12)
    covariance = np.cov(positions.T, bias=True) + np.einsum("lki,lkj->ij", extents, extents) / count
    np.testing.assert_allclose(covariance, np.outer(end - start, end - start) / 12.0, atol=1e-12)


def test_the_profile_of_the_page_about_lights_works_in_a_file_of_a_user(module_of, fingers):
    """The emission profile on the page must dim the light by the sine of the angle to the axis of a tube.

    The tube is so short that it would give the picture of a point light if it had no profile. The ratio of the two
    pictures is therefore this sine, whose median must be clearly below 1.
    """
    light, kernel, profile = blocks("add_a_light")
    future = "from __future__ import annotations\n"
    code = future + f"{kernel}{light}{profile}".replace(future, "")
    page = module_of("add_a_light", changed(code, (IMPORT_OF_KERNEL, ""), *WITH_PROFILE))
    light = page.LineLight((0.3, 1.5, 1.4), (0.3, 1.5001, 1.4), lobe_count=1)
    ratio = picture(light, fingers).xyz[..., 1] / np.maximum(
        picture(wd.PointLight(light.start), fingers).xyz[..., 1], 1e-9
    )
    assert 0.2 < np.median(ratio[ratio > 0.0]) < 0.95


def changed(code, *replacements):
    for before, after in replacements:
        assert before in code
        code = code.replace(before, after)
    return code


# Import statement in the code of the page. It is needed if the page's kernel and its emission profile are in two files
# of the library. The tests below that put all code of the page into one file remove it.
IMPORT_OF_KERNEL = "        from warpdiff.kernels.tube_emission import emit_from_tube\n"
# Pairs of a text in the page's class of lights, and its replacement. After the replacements, each lobe of the light (a
# Gaussian, by which the light is represented) has the emission profile of the page.
WITH_PROFILE = (
    ("deviations, tuple(position))", "deviations, tuple(position), TubeProfile(axis))"),
    ("        along = np", "        axis = tuple((spacing / np.linalg.norm(spacing)).tolist())\n        along = np"),
)


# This test compiles kernels in a copy of the package, which takes 15 s.
@pytest.mark.slow
def test_the_light_of_the_page_about_lights_can_be_added_to_the_library(tmp_path):
    """The test adds the source files of a light, which the page prints, to a copy of the package.

    import-linter must find no broken rule, and the command line must accept the light by its name.
    """
    for folder in ("warpdiff", "kernels"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    light, kernel, profile = blocks("add_a_light")
    light = changed(light, ("import MOST_POWER", "import MOST_POWER, EmissionProfile"), *WITH_PROFILE)
    light += profile[profile.index("if TYPE_CHECKING") :]
    Path(tmp_path, "warpdiff/lights/line.py").write_text(light, encoding="utf-8")
    Path(tmp_path, "kernels/tube_emission.py").write_text(kernel, encoding="utf-8")
    (line,) = re.findall(r"from \S+ import LineLight as LineLight", page_text("add_a_light"))
    with Path(tmp_path, "warpdiff/__init__.pyi").open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")
    run(tmp_path, Path(sys.executable).with_name("lint-imports"), "--no-cache")
    run(tmp_path, sys.executable, "-c", USE_OF_COPY)


USE_OF_COPY = """
import argparse, doctest, sys
from pathlib import Path
import warpdiff as wd

assert Path(wd.__file__).parents[1] == Path.cwd()
finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
(examples,) = finder.find(wd.LineLight, globs={})
assert runner.run(examples) == (0, len(examples.examples)) and examples.examples
from warpdiff.apps import cli_inputs
assert "warp" not in sys.modules
options = argparse.Namespace(illuminant="D65", light=[["line:start=0x2x1,end=1x2x1,lobe_count=2"]])
(light,) = cli_inputs.lights_of(options, None)
body = wd.meshes.tube(segments_along=12, segments_around=12)
image = wd.shade(body, wd.gratings.sinusoidal(2.0, 0.1), light, wd.View.fit(body, width=8, height=6), tolerance=0.3)
assert image.illuminated.any()
"""


def run(folder, *command):
    """Run a command in a folder from which Python imports modules."""
    result = subprocess.run(
        command, cwd=folder, env=os.environ | {"PYTHONPATH": str(folder)}, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_reader_of_the_page_about_readers_works(module_of, tmp_path, monkeypatch):
    """A reader inside of the library must not import the package of the readers, because that package imports it."""
    monkeypatch.setattr(reader_registry, "_readers", dict(reader_registry._readers))
    module = module_of("add_a_reader")
    assert "from warpdiff.heightfield.readers import FileContent" not in Path(module.__file__).read_text("utf-8")
    (tmp_path / "scan.foo").write_text("0.25\n0 100 200\n50 150 250\n")
    scan = wd.HeightField.load(tmp_path / "scan.foo")
    np.testing.assert_allclose(scan.heights_um, [[0.05, 0.15, 0.25], [0.0, 0.1, 0.2]])
    assert scan.pitch_um == (0.25, 0.25)


def test_the_option_of_the_page_about_options_works(module_of, capsys):
    page = module_of("add_an_option")
    assert capsys.readouterr().out == "Strength of the sparkle, relative to the surface. at least 0 and at most 2 0.5\n"
    with pytest.raises(ValueError, match=r"^sparkle must be a finite number, at least 0 and at most 2, got 3\.0$"):
        page.ProbeSettings(sparkle=3.0)


def test_the_table_of_the_page_about_options_names_every_class_its_functions_and_its_commands():
    page = page_text("add_an_option")
    rows = [[re.findall(r"`([\w.]+)`", cell) for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    rows = {row[0][0]: row[1:] for row in rows if len(row) == 4 and row[0]}
    classes = {name: value for name, value in vars(settings).items() if name.endswith("Settings")}
    assert set(rows) == set(classes)
    accepting = {name: getattr(wd, name) for name in wd.__all__ if callable(getattr(wd, name))} | {
        f"{owner.__name__.removeprefix('warpdiff.')}.{name}": member
        for owner in (wd.Image, wd.plot) for name, member in vars(owner).items() if callable(member)
    } | {"Renderer": wd.Renderer.__init__}  # fmt: skip
    for name, (fields, functions, commands) in rows.items():
        used = {key for key, value in accepting.items() if getattr(value, "__settings__", None) is classes[name]}
        assert used == set(functions), name
        assert set(fields) <= set(classes[name].__annotations__), name
        for command in commands:
            with pytest.raises(SystemExit), contextlib.redirect_stdout(io.StringIO()) as text:
                cli.main([command, "--help"])
            for option in describe(classes[name]).values():
                no = "no-" if option.kind == "flag" and option.default else ""
                assert option.kind == "object" or f"--{no}{option.dashed}" in text.getvalue(), (command, option.name)


def test_the_expansion_of_the_page_about_expansions_works(module_of, monkeypatch):
    monkeypatch.setattr("warpdiff.diffraction.phase_series.EXPANSIONS", dict(EXPANSIONS))
    page = module_of("add_an_expansion")
    expansion = page.EXPANSIONS["probe"]
    x, g = 1.5, np.linspace(-1.0, 1.0, 21)
    terms = expansion.term_count(x, 1e-6)
    polynomials = [p for p, _ in zip(expansion.polynomials(g), range(terms), strict=False)]
    value = sum(1j**n * b * p for n, (b, p) in enumerate(zip(expansion.basis(x, terms), polynomials, strict=True)))
    np.testing.assert_allclose(value, np.exp(1j * x * g), atol=1e-6)
