"""Pictures of the documentation: each one has a command that makes it, and is shown on a page."""

import json
from pathlib import Path

import numpy as np
import pytest

import warpdiff as wd
from bench.suite import runner
from warpdiff.apps import demo

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "pictures"
MAKERS = json.loads((FOLDER / "makers.json").read_text(encoding="utf-8"))


def test_every_picture_has_a_command():
    assert {path.name for path in FOLDER.glob("*.png")} == set(MAKERS)


@pytest.mark.parametrize("name", MAKERS)
def test_the_command_of_a_picture_exists(name, monkeypatch):
    command = MAKERS[name].split()
    if command[0] == "warpdiff":
        # The demonstration can make its pictures of the scan from any height field, so that this test requires no scan.
        monkeypatch.setattr(demo, "cleaned_scan", lambda _path: wd.HeightField(np.zeros((4, 4)), 0.1))
        monkeypatch.setattr(demo.Path, "is_file", lambda _path: True)
        assert Path(name).stem in {picture.name for picture in demo.pictures(ROOT)}
    elif command[1].endswith(".py"):
        assert f'"{name}"' in (ROOT / command[1]).read_text(encoding="utf-8")
    elif command[2] == "bench":
        assert command[4] in runner.PARTS
    else:
        module = ROOT.joinpath(*command[2].split(".")).with_suffix(".py")
        assert command[4].split(".")[0] in module.read_text(encoding="utf-8") or command[3] == "--picture"
        assert command[3] in module.read_text(encoding="utf-8")


def test_every_picture_is_shown():
    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
    assert not [name for name in MAKERS if f"pictures/{name}" not in pages]
