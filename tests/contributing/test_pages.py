"""Pages for contributors: the code on these pages works as printed."""

import contextlib
import importlib.util
import io
import re
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

FOLDER = Path(__file__).parents[2] / "docs" / "contributing"


@pytest.fixture
def module_of(tmp_path, monkeypatch):
    """Return a function that imports the Python block of a page from a temporary file, as Warp requires."""

    def load(page):
        (code,) = re.findall(r"```python\n(.*?)```", (FOLDER / f"{page}.md").read_text(encoding="utf-8"), re.DOTALL)
        path = tmp_path / f"page_{page}.py"
        path.write_text(code, encoding="utf-8")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, path.stem, module)
        spec.loader.exec_module(module)
        return module

    return load


def test_the_light_of_the_page_about_lights_works(module_of, fingers):
    """The spotlight illuminates the body if its axis points at the body, and not if it points away."""
    page = module_of("add_a_light")
    body = wd.meshes.tube(segments_along=12, segments_around=12)
    view = wd.View.fit(body, width=24, height=18)
    window = wd.Coherence(sigma_um=4.0)
    towards, away = (
        wd.shade(
            body, fingers, page.SpotLight((0.3, 1.7, 1.4), axis=axis), view, coherence=window, tolerance=0.3,
            pigment=0.0, refine=False,
        )
        for axis in ((0.0, -0.8, -0.6), (0.0, 0.8, 0.6))
    )  # fmt: skip
    assert towards.xyz.max() > 0.0
    assert away.xyz.max() == 0.0


def test_the_reader_of_the_page_about_readers_works(module_of, tmp_path, monkeypatch):
    """A reader inside of the library must not import its package, which imports the reader."""
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
    page = (FOLDER / "add_an_option.md").read_text(encoding="utf-8")
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
