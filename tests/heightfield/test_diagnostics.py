"""Diagnostics: the summary, and wrong units."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps.cli_inputs import GRATINGS

# Synthetic surface of the size of a scan: 0.3 µm high, with a pitch of 50 nm.
SCAN = wd.gratings.fingers(size_um=12.8, pitch_um=0.05, seed=3)


def test_a_summary_states_size_pitch_heights_periods_and_limits() -> None:
    summary = wd.gratings.sinusoidal(1.6, 0.2, samples=8).summary()
    assert summary.max_uv == pytest.approx(0.38 / 0.4)
    text = str(summary)
    for part in (
        "1.6 ×",
        "200 × 200 nm",
        "0.2 µm",
        "no feature repeats at least three times (field is one period)",
        "up to 0.95 at 380 nm",
    ):
        assert part in text
    assert "whole hemisphere" in str(wd.gratings.sinusoidal(1.6, 0.2).summary())
    assert "no feature repeats" in str(wd.HeightField([[0.0]], 1.0).summary())


def test_the_mean_slope_does_not_depend_on_the_samples():
    walls = [wd.gratings.lamellar(2.0, 0.2, samples=n) for n in (10, 400)]
    assert walls[0].mean_slope == pytest.approx(walls[1].mean_slope) == pytest.approx(2.0 * 0.2 / 2.0)
    assert walls[1].rms_slope > 3.0 * walls[0].rms_slope
    y = np.arange(40)[:, None] * 0.1
    sloped = wd.HeightField(0.3 * np.cos(2.0 * np.pi * y / 4.0) * np.ones((1, 3)), 0.1)
    assert sloped.mean_slope == pytest.approx(4.0 * 0.3 / 4.0, rel=1e-2)


@pytest.mark.parametrize(
    ("height_factor", "pitch_factor", "message"),
    [(1e-6, 1.0, r"less than an atom; are heights in metres\? Multiply them by 1e\+06"),
     (1e-6, 1e-6, r"less than an atom; are heights in metres, and the pitch as well\?"),
     (1e-3 * 0.3, 1.0, r"less than an atom; are heights in millimetres\? Multiply them by 1000"),
     (1e3, 1.0, r"more than the size of 12\.8 µm; are heights in nanometres\? Multiply them by 0\.001"),
     (1.0, 1e-6, r"more than the size of 1\.28e-05 µm; is the pitch in metres\?"),
     (25.0, 1.0, r"a mean slope of \d\.\d+; are heights in nanometres\?")],
)  # fmt: skip
def test_implausible_scales_cause_a_warning(height_factor: float, pitch_factor: float, message: str) -> None:
    dy, dx = SCAN.pitch_um
    with pytest.warns(wd.WarpdiffWarning, match=message):
        wd.HeightField(SCAN.heights_um * height_factor, (dy * pitch_factor, dx * pitch_factor))


def test_only_loading_an_implausible_file_causes_a_warning(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", 1e-6 * SCAN.heights_um)
    with pytest.warns(wd.WarpdiffWarning, match="metres.*HeightField.of_known_scale") as caught:
        field = wd.HeightField.load(tmp_path / "scan.npy", extent_um=12.8)
    assert len(caught) == 1
    for made in (field.levelled(), field.cropped(5.0), field.periodic(), field.despiked(), field.resampled(0.1)):
        assert made.height_range_um < 1e-4


def test_plausible_and_explicitly_scaled_surfaces_cause_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for flat in (0.0, 0.37, -1e-7):
            field = wd.HeightField(np.full((8, 8), flat), 0.05)
            wd.HeightField(field.levelled(2).heights_um, 0.05)
        # After subtraction of a tilt, heights may be as small as rounding errors, which is not suspicious.
        wd.HeightField(0.37 + 1e-16 * np.random.default_rng(0).normal(size=(8, 8)), 0.05)
        wd.HeightField([[0.2]], 0.05)
        for function, arguments in GRATINGS.values():
            made = getattr(wd.gratings, function)(**arguments)
            wd.HeightField(made.heights_um, made.pitch_um)
        wd.gratings.sinusoidal(1.0, 0.0)
        wd.gratings.lamellar(0.5, 3.0)
        wd.HeightField.of_known_scale(1e-6 * SCAN.heights_um, SCAN.pitch_um)
