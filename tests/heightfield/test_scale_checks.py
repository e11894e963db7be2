"""Warnings about heights in a wrong unit and about codes for missing data, and large reliefs that cause no warning."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps.cli_inputs import GRATINGS

# Synthetic skin with a height range of 0.3 µm, at a pitch of 50 nm.
SCAN = wd.gratings.fingers(size_um=12.8, pitch_um=0.05, seed=3)
X = 0.05 * np.arange(512)
SURFACES = {
    "fingers": (SCAN.heights_um, 0.05), "lamellar": (np.where(np.arange(200) % 40 < 20, 0.15, 0.0)[None], 0.05),
    "smooth": (0.05 * np.sin(X)[:, None] * np.cos(1.3 * X), 0.1), "deep": (2.0 * np.sin(0.4 * X)[None], 0.05),
}  # fmt: skip
# Factors by which heights and pitch are multiplied (wrong units), and the words of the warning that must follow.
UNITS = {
    "heights in nm": (1e3, 1.0, "are heights in nanometres? Multiply them by 0.001"),
    "heights in m": (1e-6, 1.0, "are heights in metres? Multiply them by 1e+06"),
    "pitch in nm": (1.0, 1e3, "is the pitch in nanometres? Multiply it by 0.001"),
    "pitch in m": (1.0, 1e-6, "is the pitch in metres? Multiply it by 1e+06"),
    "all in nm": (1e3, 1e3, "are heights and pitch in nanometres? Multiply both by 0.001"),
    "all in mm": (1e-3, 1e-3, "are heights and pitch in millimetres? Multiply both by 1000"),
    "all in m": (1e-6, 1e-6, "are heights and pitch in metres? Multiply both by 1e+06"),
    "heights in nm, pitch in mm": (1e3, 1e-3, "are heights in nanometres and the pitch in millimetres?"),
}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("surface", SURFACES)
def test_units_are_named_with_their_factors(surface: str, unit: str) -> None:
    heights, pitch = SURFACES[surface]
    of_heights, of_pitch, words = UNITS[unit]
    with pytest.warns(wd.WarpdiffWarning, match=re.escape(words)) as caught:
        wd.HeightField(of_heights * heights, of_pitch * pitch)
    assert len(caught) == 1
    assert "If the scale is right, make the field with HeightField.of_known_scale()" in str(caught[0].message)


@pytest.mark.parametrize("depth", [0.3, 0.9, 1.2, 2.0, 5.0])
def test_deep_reliefs_in_nanometres_are_not_taken_for_angstroms(depth: float) -> None:
    with pytest.warns(wd.WarpdiffWarning, match=r"are heights in nanometres\? Multiply them by 0\.001"):
        wd.HeightField(500.0 * depth * np.sin(0.25 * math.pi * X)[None], 0.05)


def test_symptoms_are_named() -> None:
    for heights, pitch, words in (
        (SCAN.heights_um, 5e-8, "pitch_um of 5e-08 µm is less than an atom"),
        (1e-6 * SCAN.heights_um, 0.05, "heights_um has a range of 3e-07 µm, less than an atom"),
        (SCAN.heights_um, 4.0, "pitch_um of 4 µm is too coarse for the diffraction of light"),
        (1e3 * SCAN.heights_um, 0.05, "heights_um has a range of 300 µm, more than the size of 12.8 µm"),
        (40.0 * SCAN.heights_um, 0.05, "heights_um has a mean slope of 1"),
        (1e-3 * SCAN.heights_um, 2e-4, "the field has a size of 0.051 µm, less than half a wavelength"),
        (1e-3 * SCAN.heights_um, 0.5, "heights_um has a range of 0.0003 µm, hardly more than an atom"),
        (1e7 * SCAN.heights_um, 0.05, "check the units: heights and pitch must be in µm"),
    ):
        with pytest.warns(wd.WarpdiffWarning, match=re.escape(words)):
            wd.HeightField(heights, pitch)


@pytest.mark.parametrize("code", [-9999.0, -32768.0, 32767.0, 1e10, -99.0, -12345.6])
@pytest.mark.parametrize("pitch", [0.05, 1.5])
def test_codes_for_missing_data_are_named(code: float, pitch: float) -> None:
    heights = SCAN.heights_um.copy()
    heights[10:14, 20:30] = code
    words = f"heights_um has 40 sample(s) of exactly {code:.10g}, far from all others, probably a code for missing"
    with pytest.warns(wd.WarpdiffWarning, match=re.escape(words)) as caught:
        field = wd.HeightField(heights, pitch)
    # There must be only one warning. Apart from the code for missing data, heights are in µm, so that no warning about
    # their unit follows.
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert wd.HeightField(np.where(heights == code, np.nan, heights), pitch).height_range_um < 0.5
    assert field.height_range_um > 50.0


def test_numbers_beyond_all_heights_are_refused_as_codes() -> None:
    for code in (3.4e38, -3.4e38, 1e20):
        with pytest.raises(ValueError, match=r"at 8 sample\(s\), probably a code for missing data: replace"):
            wd.HeightField(np.where(np.eye(8) > 0, code, 0.1), 0.05)


def test_files_are_warned_of_and_what_is_made_of_them_is_not(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", 1e-6 * SCAN.heights_um)
    with pytest.warns(wd.WarpdiffWarning, match="metres.*HeightField.of_known_scale") as caught:
        field = wd.HeightField.load(tmp_path / "scan.npy", extent_um=12.8)
    assert len(caught) == 1
    for made in (field.levelled(), field.cropped(5.0), field.periodic(), field.despiked(), field.resampled(0.1)):
        assert made.height_range_um < 1e-4


def test_surfaces_that_are_meant_are_not_warned_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for heights, pitch in SURFACES.values():
            wd.HeightField(heights, pitch)
        for flat in (0.0, 0.37, -1e-7):
            field = wd.HeightField(np.full((8, 8), flat), 0.05)
            wd.HeightField(field.levelled(2).heights_um, 0.05)
        # Rounding errors of about 1e-16 µm remain after a tilt is subtracted from a flat field. They must cause no
        # warning.
        wd.HeightField(0.37 + 1e-16 * np.random.default_rng(0).normal(size=(8, 8)), 0.05)
        wd.HeightField([[0.2]], 0.05)
        for function, arguments in GRATINGS.values():
            made = getattr(wd.gratings, function)(**arguments)
            wd.HeightField(made.heights_um, made.pitch_um)
        wd.gratings.sinusoidal(1.0, 0.0)
        wd.gratings.lamellar(0.5, 3.0)
        # The two heights of a binary grating, and the equal extreme heights of a clipped scan, must not be mistaken for
        # codes for missing data.
        wd.HeightField(np.where(np.arange(100) % 10 < 3, 1.0, 0.0)[None], 0.05)
        wd.HeightField(np.clip(SCAN.heights_um, -0.05, 0.05), 0.05)
        # Echelle gratings must cause no warning although their facets are steep. The tested gratings have six periods
        # with facets of 63 degrees, six with facets of 76 degrees, and one period with a facet of 63 degrees.
        for period, depth, count in ((31.6, 63.2, 6), (13.3, 53.2, 6), (31.6, 63.2, 1)):
            x = np.arange(round(count * period / 0.02)) * 0.02
            wd.HeightField((depth / period * (x % period))[None], 0.02)
        wd.HeightField.of_known_scale(1e-6 * SCAN.heights_um, SCAN.pitch_um)


@pytest.mark.parametrize(
    ("make", "words"),
    [(lambda: wd.gratings.sinusoidal(2e-6, 1e-7), "period_um of 2e-06 µm is less than an atom; is it in metres?"),
     (lambda: wd.gratings.blazed(2e-3, 2e-5), "depth_um of 2e-05 µm is less than an atom; is it in millimetres?"),
     (lambda: wd.gratings.lamellar(2e3, 150.0, samples=64), "period_um of 2000 µm is very long; is it in nanometres?"),
     (lambda: wd.gratings.lamellar(2.0, 150.0), "depth_um of 150 µm is more than 50 periods of 2 µm; is it in nano"),
     (lambda: wd.gratings.bumps(height_um=150.0), "height_um of 150 µm is more than 50 periods of 1 µm")],
)  # fmt: skip
def test_gratings_in_other_units_are_warned_of(make, words: str) -> None:
    with pytest.warns(wd.WarpdiffWarning, match=re.escape(words)):
        make()


def test_a_large_relief_is_refused_by_its_limit_and_evaluated_directly() -> None:
    x = np.arange(400) * 0.1
    echelle = wd.HeightField((2.0 * (x % 20.0))[None], 0.1)
    words = r"series and energy factors support at most 100, a range of \S+ µm: .*levelled\(\) .*method='direct'"
    with pytest.raises(ValueError, match=words) as refused:
        wd.reflectance(echelle, (0, 0, 1), (0, 0, 1))
    assert "unit" not in str(refused.value)
    value = wd.spectral_reflectance(echelle, (0, 0, 1), (0.3, 0, 1), [500.0, 501.0], method="direct")
    assert np.isfinite(value).all()
