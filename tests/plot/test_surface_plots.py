"""Plots of height fields: the drawn values are the heights, in the units of the axis labels."""

import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import warpdiff as wd
from warpdiff.plot.axes import round_length

mpl.use("Agg")
PITCH = (0.05, 0.02)


@pytest.fixture
def ax():
    return Figure().add_subplot()


@pytest.fixture(scope="module")
def wave():
    """Return a height field: a wave with periods of 0.5 µm along x and 2 µm along y, with noise."""
    y, x = np.mgrid[:80, :150]
    heights = 0.1 * np.cos(2.0 * np.pi * (x * PITCH[1] / 0.5 + y * PITCH[0] / 2.0))
    return wd.HeightField(heights + np.random.default_rng(0).normal(0.0, 1e-3, heights.shape), PITCH)


def test_a_map_shows_heights_in_nm_over_positions_in_um(ax, wave):
    assert wd.plot.height_map(wave, ax=ax) is ax
    (picture,) = ax.images
    np.testing.assert_allclose(picture.get_array(), 1e3 * wave.heights_um)
    assert picture.get_extent() == pytest.approx([0.0, 3.0, 0.0, 4.0])
    assert picture.origin == "lower"
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_title()) == ("x [µm]", "y [µm]", "Heights, 3 × 4 µm")
    assert [child.get_ylabel() for child in ax.child_axes] == ["height [nm]"]
    (bar,) = [artist for artist in ax.artists if hasattr(artist, "size_bar")]
    assert bar.size_bar.get_children()[0].get_width() == 0.5
    assert bar.txt_label.get_text() == "500 nm"


def test_tall_fields_are_shown_in_um_and_missing_samples_are_masked(ax):
    heights = np.array([[0.0, 1.5], [np.nan, 0.5]])
    wd.plot.height_map(wd.HeightField(heights, 1.0), ax=ax)
    shown = ax.images[0].get_array()
    np.testing.assert_array_equal(shown.mask, np.isnan(heights))
    np.testing.assert_array_equal(shown.compressed(), [0.0, 1.5, 0.5])
    assert ax.child_axes[0].get_ylabel() == "height [µm]"
    assert ax.get_title() == "Heights, 2 × 2 µm, 1 samples missing (white)"


@pytest.mark.parametrize("turns", [0, 1])
def test_gratings_are_bands_that_name_their_constant_axis(ax, turns):
    wd.plot.height_map(wd.gratings.blazed(2.0, 0.2).rotated(turns), ax=ax)
    labels = ax.get_xlabel(), ax.get_ylabel()
    assert labels == [("x [µm]", "constant along y"), ("constant along x", "y [µm]")][turns]
    assert ax.get_title() == "Heights, 2 µm"


@pytest.mark.parametrize(
    ("along", "at_um", "index"), [("x", 1.01, 20), ("y", 0.3, 15), ("x", None, 40), ("y", 3.0, 149)]
)
def test_profiles_are_a_row_or_a_column_of_the_samples(ax, wave, along, at_um, index):
    wd.plot.profile(wave, ax=ax, along=along, at_um=at_um)
    heights = wave.heights_um[index] if along == "x" else wave.heights_um[:, index]
    np.testing.assert_allclose(ax.lines[0].get_ydata(), 1e3 * heights)
    np.testing.assert_allclose(ax.lines[0].get_xdata(), PITCH[along == "x"] * np.arange(len(heights)))
    wd.plot.height_map(wave, ax=Figure().add_subplot(), profile_along=along, at_um=at_um)


def test_a_second_profile_has_the_unit_of_the_axis_and_another_colour(ax):
    for depth in (0.2, 2.0):
        wd.plot.profile(wd.HeightField([[0.0, depth]], 1.0), ax=ax, label=f"{depth} µm")
    assert [line.get_ydata().max() for line in ax.lines] == [200.0, 2000.0]
    assert ax.get_ylabel() == "height [nm]"
    assert ax.lines[0].get_color() != ax.lines[1].get_color()


def test_marks_of_a_spectrum_are_at_the_inverse_of_the_period(ax, wave):
    wd.plot.power_spectrum(wave, ax=ax)
    (mark,) = ax.lines
    assert sorted(zip(mark.get_xdata(), mark.get_ydata(), strict=True))[1] == pytest.approx((2.0, 0.5), abs=1e-3)
    assert mark.get_label().startswith("period 0.485")
    assert ax.get_title() == "Power spectrum, 1 period marked"
    (picture,) = ax.images
    powers, (left, right, bottom, top) = picture.get_array(), picture.get_extent()
    row, column = np.unravel_index(np.argmax(powers), powers.shape)
    peak = left + (column + 0.5) * (right - left) / 150, bottom + (row + 0.5) * (top - bottom) / 80
    assert np.abs(peak) == pytest.approx((2.0, 0.5), abs=0.34)


def test_a_spectrum_may_end_at_a_lower_frequency(ax, wave):
    wd.plot.power_spectrum(wave, ax=ax, most_frequency=3.0)
    assert ax.get_xlim() == ax.get_ylim() == (-3.0, 3.0)


def test_the_integral_of_the_density_is_the_variance():
    """The integral of the power spectral density of a cosine with amplitude a must be its variance a²/2.

    This must hold for the density over two axes and for the density over one axis.
    """
    x = 0.02 * np.arange(800)
    heights = 0.1 * np.cos(2.0 * np.pi * x / 0.8)
    field, profile = (Figure().add_subplot() for _ in range(2))
    wd.plot.power_spectrum(wd.HeightField(heights[None], 0.02), ax=profile)
    line = profile.lines[0]
    assert np.sum(line.get_ydata()) * line.get_xdata()[0] == pytest.approx(0.005, rel=1e-3)
    assert profile.get_ylabel() == "power spectral density [µm³]"
    assert profile.lines[1].get_xdata()[0] == pytest.approx(1.25, rel=1e-4)
    wd.plot.power_spectrum(wd.HeightField(np.tile(heights[:200], (12, 1)), (0.05, 0.02)), ax=field)
    assert np.sum(field.images[0].get_array()) / (4.0 * 0.6) == pytest.approx(0.005, rel=1e-2)


def test_flat_fields_and_fields_with_gaps_have_a_spectrum(ax):
    wd.plot.power_spectrum(wd.HeightField(np.zeros((20, 30)), 0.1), ax=ax)
    assert ax.get_title() == "Power spectrum, no period"
    heights = np.zeros((20, 30))
    heights[3, 4] = np.nan
    wd.plot.power_spectrum(wd.HeightField(heights, 0.1), ax=ax)
    assert np.isfinite(ax.images[-1].get_array()).all()


@pytest.mark.parametrize(
    ("most", "length"), [(0.25 * 65.0, 10.0), (1.0, 1.0), (0.0499, 0.02), (199.0, 100.0), (5.0, 5.0)]
)
def test_scale_bars_have_round_lengths(most, length):
    assert round_length(most) == pytest.approx(length)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [({"ax": "new"}, TypeError, r"ax must be matplotlib axes, got str: pass one element of plt\.subplots"),
     ({"profile_along": "z"}, ValueError, "profile_along must be one of 'y', 'x', got 'z'"),
     ({"profile_along": "x", "at_um": 4.1}, ValueError, "at_um must be 0 to 4, the size of the field, got 4.1"),
     ({"cmap": "rainbows"}, ValueError, "cmap must be the name of a colour map of matplotlib, got 'rainbows'"),
     ({"axes": None}, TypeError, r"height_map\(\) has no argument axes; did you mean 'ax'")],
)  # fmt: skip
def test_arguments_that_are_not_accepted_are_refused(wave, arguments, error, message):
    with pytest.raises(error, match=message):
        wd.plot.height_map(wave, **{"ax": Figure().add_subplot()} | arguments)


def test_without_matplotlib_the_error_names_the_extra(monkeypatch, wave):
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    with pytest.raises(ImportError, match=r"plots require matplotlib .*: pip install 'warpdiff\[plot\]'"):
        wd.plot.profile(wave)


def test_a_new_figure_is_made_without_axes_and_written(wave, tmp_path):
    import matplotlib.pyplot as plt

    axes = wd.plot.profile(wave)
    axes.figure.savefig(tmp_path / "profile.png", dpi=20)
    assert (tmp_path / "profile.png").stat().st_size > 0
    plt.close(axes.figure)


def test_a_shaded_map_is_lit_from_the_upper_left_and_keeps_gaps(ax):
    y, x = np.mgrid[:60, :60] * 0.1 - 3.0
    heights = 0.3 * np.exp(-(x**2 + y**2) / 2.0)
    heights[5:8, 5:8] = np.nan
    wd.plot.height_map(wd.HeightField(heights, 0.1), ax=ax, is_shaded=True, cmap="gray")
    flat, shaded = (image.to_rgba(image.get_array()) for image in ax.images)
    # The plotted bump is symmetric, so that without shading two opposite sides have the same colour. The rows of the
    # picture run upwards.
    np.testing.assert_allclose(flat[40, 20], flat[20, 40], atol=1e-6)
    assert shaded[40, 20, 0] > shaded[20, 40, 0] + 0.2
    np.testing.assert_array_equal(shaded[6, 6], flat[6, 6])
