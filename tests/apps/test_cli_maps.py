"""Grating maps, surfaces of small rectangles with rotated and scaled gratings, on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

import warpdiff as wd
from warpdiff.apps import cli, cli_inputs

if TYPE_CHECKING:
    from pathlib import Path

LINE = "render card --heightfield sinusoidal:period_um=1.2 --width 16 --height 12 --tolerance 0.5 --no-refine"


def _run(*words: object) -> int:
    return cli.main([*LINE.split(), *map(str, words)])


def test_maps_of_numbers_and_images(tmp_path: Path) -> None:
    grey = np.array([[0, 51], [204, 255]], dtype=np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    cell = wd.gratings.sinusoidal(1.2, 0.2)
    texts = ["turn_deg=30", f"depth_scale={tmp_path / 'grey.png'}", f"pitch_scale={tmp_path / 'grey.png'},1.5,0.5"]
    made = cli_inputs.map_of(cell, texts)
    assert isinstance(made, wd.GratingMap)
    assert made.cell is cell
    assert made.dot(0, 1) == pytest.approx((30.0, 0.2, 1.3))
    assert cli_inputs.map_of(cell, None) is cell


def test_render_draws_a_map(tmp_path: Path) -> None:
    target = tmp_path / "card.exr"
    light = ["--light", 0, 0.5, 1, "--eye", 0, 0, 4, "--coherence", "source", "--source-diameter-deg", 20]
    assert _run("--map", "turn_deg=90", *light, "-o", target) == 0
    assert target.is_file()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("turn=3", "--map must be NAME=VALUE with a NAME of turn_deg, depth_scale, pitch_scale, got 'turn=3'; did you"),
        ("turn_deg", "--map must be NAME=VALUE"),
        ("turn_deg=missing.png", "--map turn_deg: there is no file 'missing.png'"),
        ("pitch_scale=missing.png", "write pitch_scale=IMAGE,BLACK,WHITE, such as pitch_scale=dots.png,0.8,1.25"),
        ("pitch_scale=g8.png,0.8", "--map must have two numbers after the image, the values of black and white, got"),
        ("depth_scale=g8.png,0.8", "write depth_scale=IMAGE,BLACK,WHITE"),
        ("turn_deg=", "--map must have a value after turn_deg=, got 'turn_deg=': a number, IMAGE or IMAGE,BLACK"),
        ("pitch_scale=missing.png,a,b", "--map must have two numbers after the image"),
        ("pitch_scale=-1", "--map pitch_scale must be at least 0.001 and at most 1000, got -1"),
    ],
)
def test_bad_maps_have_one_clear_error(value: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("--map", value, "-o", "x.png") == 2
    assert message in capsys.readouterr().err
    assert _run("--map", "turn_deg=1", "--map", "turn_deg=2", "-o", "x.png") == 2
    assert "--map must give each value once, got 'turn_deg' twice" in capsys.readouterr().err
