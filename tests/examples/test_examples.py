"""Examples: every script must run alone at a small size, and write a picture that is not empty."""

import runpy
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image
from small_pictures import draw_reports_roughly, draw_roughly, rough

import warpdiff as wd

FOLDER = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(FOLDER.glob("*/plot_*.py"))
# Largest number of lines of an example's script.
MOST_LINES = 40


@pytest.fixture
def _small(monkeypatch, request):
    mpl.use("Agg")
    monkeypatch.setattr(wd, "reflectance_map", rough(wd.reflectance_map, size=16, tolerance=0.3))
    monkeypatch.setattr(wd, "reflectance", rough(wd.reflectance, tolerance=0.3))
    if request.node.callspec.params["script"].parent.name != "scans":
        monkeypatch.setattr(wd.gratings, "fingers", rough(wd.gratings.fingers, size_um=3.2, pitch_um=0.1))
        monkeypatch.setattr(wd.gratings, "disc", rough(wd.gratings.disc, tracks=2, length_um=12.5, pitch_um=0.1))
    monkeypatch.setattr(wd.meshes, "tube", rough(wd.meshes.tube, segments_along=48, segments_around=16))
    monkeypatch.setattr(wd.meshes, "disc", rough(wd.meshes.disc, segments=64, rings=4))
    monkeypatch.setattr(wd.meshes, "snake", rough(wd.meshes.snake, scale_rows=9, ventrals=20, segments=2))
    monkeypatch.setattr(wd, "report", rough(wd.report, sigmas_um=[1.5], tolerance=0.5, wavelengths_nm=550.0))
    draw_roughly(monkeypatch)
    draw_reports_roughly(monkeypatch)


@pytest.mark.usefixtures("_small")
@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_examples_write_their_pictures(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script))
    pictures = list(tmp_path.glob("*.png"))
    assert pictures
    for path in pictures:
        with Image.open(path) as picture:
            assert np.ptp(np.asarray(picture.convert("RGB"))) > 0


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_examples_are_short_and_have_a_title(script):
    lines = script.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MOST_LINES
    title, rule = lines[1:3]
    assert rule == len(title) * "="


def test_there_are_examples_of_every_topic():
    assert len(SCRIPTS) >= 20
    assert all((script.parent / "README.rst").is_file() for script in SCRIPTS)
