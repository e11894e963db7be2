"""ISO 25178 parameters: closed forms, gaps, non-square pixels, standard errors, and reasons for missing values."""

import math

import numpy as np
import pytest

import warpdiff as wd
from bench.reproduce.iso_25178 import random_field
from warpdiff.heightfield.autocorrelation import lag_sums
from warpdiff.heightfield.blocks import blocks_of

LN5 = math.log(5.0)


def sine(shape=(120, 1000), *, along="x", period_um=2.0, amplitude_um=0.1, pitch_um=0.01):
    axis = pitch_um * np.arange(shape[1] if along == "x" else shape[0])
    wave = amplitude_um * np.sin(2.0 * np.pi * axis / period_um)
    return wd.HeightField(np.tile(wave, (shape[0], 1)) if along == "x" else np.tile(wave[:, None], shape[1]), pitch_um)


def length_of_sine(period_um=2.0, size_um=10.0):
    """Return the lag at which the autocorrelation of a sine over whole periods falls to 0.2 [µm].

    The autocorrelation at a lag t is the mean of sin kx · sin k(x + t) over all x with both points in the field,
    relative to that at t = 0.
    """
    k = 2.0 * np.pi / period_um
    lags = np.linspace(0.3, 0.6, 100_001)
    return float(lags[np.argmax(np.cos(k * lags) + np.sin(k * lags) / (k * (size_um - lags)) < 0.2)])


@pytest.mark.parametrize(("along", "shape", "lay"), [("x", (120, 1000), 90.0), ("y", (1000, 120), 0.0)])
def test_a_sine_has_its_closed_forms(along, shape, lay):
    # The field has 5 whole periods of a sine. A plane fitted to them would be tilted. Therefore ``order=0`` subtracts
    # only the mean height.
    roughness = sine(shape, along=along).roughness(order=0)
    assert roughness["Sa"].value == pytest.approx(0.2 / math.pi, rel=1e-4)
    assert roughness["Sq"].value == pytest.approx(0.1 / math.sqrt(2.0), rel=1e-6)
    assert roughness["Sdq"].value == pytest.approx(0.1 * math.pi / math.sqrt(2.0), rel=1e-3)
    # Sdr is the mean of √(1 + s²) over one period, minus 1, for the slopes s of the sine.
    slopes = 0.1 * math.pi * np.cos(np.linspace(0.0, 2.0 * np.pi, 10_001)[:-1])
    assert roughness["Sdr"].value == pytest.approx(100.0 * (np.sqrt(1.0 + slopes**2).mean() - 1.0), rel=2e-3)
    assert roughness["Sal"].value == pytest.approx(length_of_sine(), rel=1e-4)
    assert roughness["Str"].value is None
    assert "along the grooves" in roughness["Str"].reason
    assert abs((roughness.lay_deg - lay + 90.0) % 180.0 - 90.0) < 1.0


def test_a_tilted_plane_has_the_area_of_its_slope_and_none_when_levelled():
    y, x = np.mgrid[:40, :60] * 0.1
    plane = wd.HeightField.of_known_scale(0.3 * x - 0.4 * y, 0.1)
    tilted = plane.roughness(order=0)
    assert tilted["Sdr"].value == pytest.approx(100.0 * (math.sqrt(1.25) - 1.0), rel=1e-9)
    assert tilted["Sdq"].value == pytest.approx(0.5, rel=1e-9)
    levelled = plane.roughness()
    assert [levelled[name].value for name in ("Sa", "Sq", "Sdq", "Sdr")] == [0.0] * 4
    assert levelled["Sal"].value is None
    assert levelled["Sal"].reason == "the levelled field is flat"


def test_isotropic_and_anisotropic_surfaces_have_their_lengths_and_aspect():
    # Both surfaces have the autocorrelation exp(−r²/l²) along an axis, with the correlation length l of this axis. It
    # falls to 0.2 at the distance l·√(ln 5).
    isotropic = random_field(1, (0.5, 0.5), (0.1, 0.1), (250, 250)).roughness()
    assert isotropic["Sal"].value == pytest.approx(0.5 * math.sqrt(LN5), rel=0.1)
    assert isotropic["Str"].value > 0.85
    anisotropic = random_field(2, (0.3, 1.2), (0.1, 0.1), (300, 300), angle_deg=30.0).roughness()
    assert anisotropic["Sal"].value == pytest.approx(0.3 * math.sqrt(LN5), rel=0.1)
    assert anisotropic["Str"].value == pytest.approx(0.25, rel=0.15)
    assert min(anisotropic.lay_deg % 30.0, 30.0 - anisotropic.lay_deg % 30.0) < 4.0


def test_pixels_that_are_not_square_give_the_same_lengths():
    fine = random_field(3, (0.8, 0.8), (0.1, 0.1), (150, 300))
    coarse = wd.HeightField.of_known_scale(fine.heights_um[:, ::2], (0.1, 0.2))
    first, second = fine.roughness(), coarse.roughness()
    for name, tolerance in (("Sq", 2e-3), ("Sal", 5e-3), ("Str", 5e-3)):
        assert second[name].value == pytest.approx(first[name].value, rel=tolerance)
    assert second.lay_deg == pytest.approx(first.lay_deg, abs=1.0)


def test_gaps_count_neither_as_heights_nor_as_pairs():
    field = sine((60, 1000))
    heights = field.heights_um.copy()
    heights[10:50, 320:480] = np.nan
    heights[np.random.default_rng(0).random(heights.shape) < 0.2] = np.nan
    gappy = wd.HeightField(heights, field.pitch_um).roughness(order=0)
    whole = field.roughness(order=0)
    for name, tolerance in (("Sa", 0.02), ("Sq", 0.02), ("Sdq", 0.02), ("Sdr", 0.03), ("Sal", 0.02)):
        assert gappy[name].value == pytest.approx(whole[name].value, rel=tolerance)


def test_sums_over_lags_equal_loops_and_add_up_over_blocks():
    rng = np.random.default_rng(4)
    heights = rng.normal(size=(9, 11))
    known = rng.random(heights.shape) < 0.7
    heights[~known] = 0.0
    reach = (3, 4)
    parts = [lag_sums(heights, known, block, reach) for block in blocks_of(heights.shape, (2, 3))]
    products, pairs = sum(part[0] for part in parts), sum(part[1] for part in parts)
    for ty in range(-3, 4):
        for tx in range(-4, 5):
            terms = [
                (heights[y, x] * heights[y + ty, x + tx], known[y, x] and known[y + ty, x + tx])
                for y in range(9)
                for x in range(11)
                if 0 <= y + ty < 9 and 0 <= x + tx < 11
            ]
            assert products[ty + 3, tx + 4] == pytest.approx(sum(product for product, _ in terms), abs=1e-12)
            assert pairs[ty + 3, tx + 4] == sum(both for _, both in terms)


def test_a_profile_has_no_aspect_and_the_length_of_its_line():
    profile = sine((1, 1000)).roughness(order=0)
    assert profile["Sdr"].value == pytest.approx(sine((50, 1000)).roughness(order=0)["Sdr"].value, rel=1e-9)
    assert profile["Sal"].value == pytest.approx(length_of_sine(), rel=1e-4)
    assert profile["Str"].value is None
    assert profile.lay_deg is None


def test_fields_that_are_averaged_to_find_the_decay_have_the_same_lengths():
    # The decay of the autocorrelation is first estimated with at most 1,024 samples along an axis. For this, the field
    # of 1,200 samples is averaged over pairs of samples, and the field of 600 samples is not averaged.
    field = random_field(6, (0.5, 1.0), (0.05, 0.05), (100, 1200))
    fine, coarse = field.roughness(), wd.HeightField.of_known_scale(field.heights_um[:, ::2], (0.05, 0.1)).roughness()
    assert fine["Sal"].value == pytest.approx(coarse["Sal"].value, rel=3e-3)
    assert fine["Str"].value == pytest.approx(coarse["Str"].value, rel=3e-3)


def test_two_standard_errors_contain_the_value_of_the_surface():
    # Fields are random samples of a surface. In 95 % of the fields, a parameter of the field is expected to differ by
    # at most two standard errors from that of the surface. The probability of fewer than 15 such fields of 20 is then
    # 0.03 %, so that correct standard errors nearly always pass the limit of 15.
    fields = [random_field(900 + seed, (0.3, 0.3), (0.1, 0.1), (60, 60)).roughness() for seed in range(20)]
    for name in ("Sa", "Sq", "Sdq", "Sal"):
        values = [field[name].value for field in fields]
        truth = 0.05 if name == "Sq" else np.mean(values)
        errors = [field[name].standard_error for field in fields]
        within = [abs(value - truth) <= 2.0 * error for value, error in zip(values, errors, strict=True)]
        assert sum(within) >= 15, name
        assert np.mean(errors) < 2.0 * np.std(values), name


def test_a_field_of_few_lengths_says_why_there_is_no_error():
    small = random_field(7, (2.0, 2.0), (0.1, 0.1), (60, 60)).roughness()
    assert small["Sq"].value > 0.0
    assert small["Sq"].standard_error is None
    assert "four independent parts" in small["Sq"].reason
    assert "no standard error" in str(small["Sq"])


def test_arguments_are_checked():
    with pytest.raises(ValueError, match="order must be an integer, at least 0, got -1"):
        sine().roughness(order=-1)
    with pytest.raises(ValueError, match=r"name must be one of Sa, Sq, .* got 'Sz'"):
        sine().roughness()["Sz"]


def test_the_table_has_a_row_per_parameter():
    table = sine().roughness().table()
    assert table["unit"].tolist() == ["µm", "µm", "", "%", "µm", ""]
    assert np.isnan(table["value"]).tolist() == [False] * 5 + [True]
