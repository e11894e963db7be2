"""Pages of the documentation: their Python code runs unchanged, and their links refer to existing files."""

import re
from pathlib import Path

import pytest
from small_pictures import draw_roughly

import warpdiff as wd
from warpdiff.heightfield.readers import reader_registry

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"(<!-- requires [^\n]*-->\n)?```python\n(.*?)```", re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
HOW_TO = [path for path in sorted((DOCS / "how-to").glob("*.md")) if "```python" in path.read_text(encoding="utf-8")]
# Pages that are generated when the documentation is built.
_GENERATED = ("api", "derivatives", "options", "command_line", "formats", "lights")
BUILT = [*(f"reference/{name}" for name in _GENERATED), "gallery/index"]


@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_python_blocks_run_one_after_the_other(page, tmp_path, monkeypatch):
    """All Python blocks of a page must run in order, except those marked as requiring an extra package or a GPU.

    The pictures are small and rough, to save time.
    """
    monkeypatch.chdir(tmp_path)
    draw_roughly(monkeypatch)
    names: dict = {}
    for mark, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        if not mark:
            exec(compile(code, str(page), "exec"), names)  # noqa: S102 (the tested code)


@pytest.fixture(scope="module")
def generator():
    code = (DOCS / "extensions" / "generated_reference.py").read_text(encoding="utf-8")
    names: dict = {"__name__": "generated_reference"}
    exec(compile(code, "generated_reference.py", "exec"), names)  # noqa: S102 (the generator)
    return names


def test_the_table_of_lights_has_every_public_light(generator):
    table = generator["lights_page"]()
    assert "| `PointLight(position)` | Light from a point in the scene, equal in all directions;" in table
    lights = [name for name in wd.__all__ if name.endswith("Light")] + ["Environment"]
    assert len(lights) >= 3
    assert all(f"| `{name}(" in table for name in lights)
    assert len(table.splitlines()) == 2 + len(lights)


def test_the_table_of_formats_is_the_registry(generator):
    table = generator["formats_page"]()
    assert len(table.splitlines()) == 2 + len(reader_registry.registered())
    for suffix in (".png", ".npy", ".npz", ".txt", ".x3p", ".sur"):
        assert f"`{suffix}`" in table
    assert all(entry.states for entry in reader_registry.registered())


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))], ids=lambda page: str(page.relative_to(ROOT))
)
def test_links_lead_to_files(page):
    if page.is_relative_to(DOCS / "_build") or page.is_relative_to(DOCS / "reference"):
        pytest.skip("the build of the site writes this page")
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        path = (page.parent / target).resolve()
        built = path.is_relative_to(DOCS) and path.relative_to(DOCS).with_suffix("").as_posix() in BUILT
        assert built or path.exists(), f"{page.name}: {target}"
