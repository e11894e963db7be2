"""Heights and pitches in other units than µm are warned of, with the unit; surfaces that are meant are not."""

from __future__ import annotations

import argparse
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pytest

import warpdiff as wd
from warpdiff import gratings
from warpdiff.apps.cli import GRATINGS

if TYPE_CHECKING:
    from pathlib import Path

OPTIONS = argparse.Namespace(period_um=2.0, depth_um=0.25)
# 0.3 µm high, at 50 nm.
SCAN = gratings.fingers(size_um=12.8, pitch_um=0.05, seed=3)


@pytest.mark.parametrize(
    ("height_factor", "pitch_factor", "message"),
    [
        (1e-6, 1.0, r"less than an atom; are heights in metres\? Multiply them by 1e\+06"),
        (1e-6, 1e-6, r"less than an atom; are heights in metres, and the pitch as well\?"),
        (1e-3 * 0.3, 1.0, r"less than an atom; are heights in millimetres\? Multiply them by 1000"),
        (1e3, 1.0, r"more than the size of 12\.8 µm; are heights in nanometres\? Multiply them by 0\.001"),
        (1.0, 1e-6, r"more than the size of 1\.28e-05 µm; is the pitch in metres\?"),
        (25.0, 1.0, r"the mean slope is \d\.\d+; are heights in nanometres\?"),
    ],
)
def test_implausible_scales_are_warned_of(height_factor: float, pitch_factor: float, message: str) -> None:
    dy, dx = SCAN.pitch_um
    with pytest.warns(wd.WarpdiffWarning, match=message):
        wd.HeightField(SCAN.heights_um * height_factor, (dy * pitch_factor, dx * pitch_factor))


def test_files_are_warned_of_and_what_is_made_of_them_is_not(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", 1e-6 * SCAN.heights_um)
    with pytest.warns(wd.WarpdiffWarning, match="metres.*HeightField.of_known_scale") as told:
        field = wd.HeightField.load(tmp_path / "scan.npy", extent_um=12.8)
    assert len(told) == 1
    for made in (field.levelled(), field.cropped(5.0), field.periodic(), field.despiked(), field.resampled(0.1)):
        assert made.height_range_um < 1e-4


def test_surfaces_that_are_meant_are_not_warned_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for flat in (0.0, 0.37, -1e-7):
            field = wd.HeightField(np.full((8, 8), flat), 0.05)
            wd.HeightField(field.levelled(2).heights_um, 0.05)
        # Rounding of a tilt that was subtracted.
        wd.HeightField(0.37 + 1e-16 * np.random.default_rng(0).normal(size=(8, 8)), 0.05)
        wd.HeightField([[0.2]], 0.05)
        for make in GRATINGS.values():
            made = make(OPTIONS)
            wd.HeightField(made.heights_um, made.pitch_um)
        gratings.sinusoidal(1.0, 0.0)
        gratings.lamellar(0.5, 3.0)
        wd.HeightField.of_known_scale(1e-6 * SCAN.heights_um, SCAN.pitch_um)
