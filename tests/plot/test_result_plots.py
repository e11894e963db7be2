"""Plots of results (orders, spectra, colours, errors, plans): drawn values equal closed forms and the results.

κ is w/λ, the normal component w of the scattering vector divided by the wavelength. H is the Fourier coefficient of an
order.
"""

import dataclasses
import math

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import warpdiff as wd
from warpdiff.plot.order_plots import wavelength_colour

mpl.use("Agg")
PERIOD, DEPTH = 2.5, 0.2


@pytest.fixture
def ax():
    return Figure().add_subplot()


@pytest.fixture(scope="module")
def picture():
    """Return a reflectance map of 24 × 24 pixels for oblique light."""
    return wd.reflectance_map(wd.gratings.sinusoidal(2.0, 0.1), (0.3, 0.2, 1.0), size=24, tolerance=0.1)


def blazed(order, kappa):
    """Return the power |H|² of an order of a blazed grating at a value of κ."""
    return np.sinc(kappa * DEPTH - order) ** 2


def efficiency(order, wavelength_nm, incidence_deg):
    """Return the efficiency [%] of an order of a perfectly reflecting blazed grating; NaN for an evanescent order."""
    sin_i = math.sin(math.radians(incidence_deg))
    sin_r = order * wavelength_nm * 1e-3 / PERIOD - sin_i
    if abs(sin_r) >= 1.0:
        return math.nan
    cos_i, cos_r = math.sqrt(1.0 - sin_i**2), math.sqrt(1.0 - sin_r**2)
    geometry = (1.0 + sin_i * sin_r + cos_i * cos_r) ** 2 / (cos_i * cos_r * (cos_i + cos_r) ** 2)
    return 100.0 * geometry * blazed(order, -(cos_i + cos_r) / (wavelength_nm * 1e-3))


def orders(to_light, wavelengths_nm):
    grating = wd.gratings.blazed(PERIOD, DEPTH, samples=2000)
    return wd.order_efficiencies(grating, to_light, wavelengths_nm, ior=math.inf, energy="stam")


def lines_of(axes):
    """Return the lines of a plot of orders, by the number of the diffraction order that a line shows."""
    return {int(line.get_label().replace("−", "-")): line for line in axes.lines}


def test_lines_over_wavelengths_are_closed_forms_in_percent(ax):
    wavelengths = [650.0, 450.0, 550.0]
    wd.plot.orders(orders(wd.direction(20.0), wavelengths), ax=ax, count=4)
    lines = lines_of(ax)
    assert len(lines) == 4
    assert -1 in lines
    for order, line in lines.items():
        assert line.get_xdata().tolist() == sorted(wavelengths)
        expected = [efficiency(order, wavelength, 20.0) for wavelength in sorted(wavelengths)]
        np.testing.assert_allclose(line.get_ydata(), expected, atol=0.05)
    assert ax.get_xlim() == (450.0, 650.0)
    assert ax.get_title() == "Efficiency of the orders, the 4 strongest of 11"


def test_orders_over_angles_are_at_the_angles_of_the_grating_equation(ax):
    wd.plot.orders(orders(wd.direction(-20.0), 550.0), ax=ax)
    (line,) = [line for line in ax.lines if line.get_marker() == "o"]
    expected = [
        math.degrees(math.asin(m * 0.55 / PERIOD + math.sin(math.radians(20.0))))
        for m in range(-6, 7)
        if abs(m * 0.55 / PERIOD + math.sin(math.radians(20.0))) < 1.0
    ]
    np.testing.assert_allclose(line.get_xdata(), expected, atol=1e-9)
    assert [text.get_text() for text in ax.texts] == ["−6", "−5", "−4", "−3", "−2", "−1", "0", "+1", "+2"]
    assert ax.get_title() == "Orders at 550 nm"


def test_errors_of_orders_are_bars_of_their_wavelength(ax):
    result = orders(wd.direction(-20.0), [450.0, 650.0])
    wd.plot.orders(result, ax=ax, against="angle", errors=[0.01, 0.03])
    for row, bars in enumerate(ax.containers):
        segments = bars.lines[2][0].get_segments()
        heights = [segment[1, 1] - segment[0, 1] for segment in segments]
        np.testing.assert_allclose(heights, 2.0 * (1.0, 3.0)[row])
        assert len(segments) == np.count_nonzero(~np.isnan(result.to_view[row, :, 0]))
    assert len(ax.texts) == np.count_nonzero(~np.isnan(result.to_view[..., 0]))
    with pytest.raises(ValueError, match=r"errors must have the shape \(2,\), one number of at least 0 per wavelength"):
        wd.plot.orders(result, ax=ax, against="angle", errors=[0.1, 0.1, 0.1])


def test_lines_over_the_incidence_are_closed_forms(ax):
    angles = [40.0, -40.0, 0.0]
    wd.plot.orders(orders(wd.direction(angles), 550.0), ax=ax, count=3)
    for order, line in lines_of(ax).items():
        np.testing.assert_allclose(line.get_xdata(), sorted(angles), atol=1e-12)
        np.testing.assert_allclose(line.get_ydata(), [efficiency(order, 550.0, a) for a in sorted(angles)], atol=0.05)


def test_plots_that_a_result_does_not_allow_are_refused(ax):
    single, several = orders((0, 0, 1), [450.0, 550.0]), orders(wd.direction([0.0, 10.0]), [450.0, 550.0])
    with pytest.raises(ValueError, match="against='incidence' requires the efficiencies for several lights"):
        wd.plot.orders(single, ax=ax, against="incidence")
    with pytest.raises(ValueError, match="against='angle' requires the efficiencies for one light"):
        wd.plot.orders(several, ax=ax, against="angle")
    with pytest.raises(TypeError, match=r"efficiencies must be a warpdiff\.OrderEfficiencies, got HeightField"):
        wd.plot.orders(wd.gratings.bumps(), ax=ax)
    with pytest.raises(ValueError, match="against='incidence' requires one wavelength, got 2"):
        wd.plot.orders(several, ax=ax)


def test_spectra_are_drawn_from_a_result_and_from_arrays(ax):
    values = np.arange(6.0).reshape(2, 3)
    light, views = wd.direction([0.0, 0.0]), wd.direction([-15.0, 12.0])
    spectra = wd.ReflectanceSpectra(np.array([600.0, 300.0, 510.0]), light, views, values)
    wd.plot.spectra(spectra, ax=ax)
    for line, row in zip(ax.lines, spectra.values, strict=True):
        assert line.get_xdata().tolist() == [300.0, 510.0, 600.0]
        np.testing.assert_array_equal(line.get_ydata(), row[[1, 2, 0]])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["view at -15°", "view at 12°"]
    wd.plot.spectra([300.0, 510.0, 600.0], spectra.values[0], ax=ax)
    np.testing.assert_array_equal(ax.lines[-1].get_ydata(), spectra.values[0])
    assert ax.get_xlim() == (300.0, 600.0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [(([400.0, 500.0],), TypeError, "source must be the result of reflectance_spectra, or wavelengths with values"),
     (([400.0, 500.0], [1.0]), ValueError, r"values must have the shape \(2,\) or \(n, 2\), got \(1, 1\)"),
     (([0.4, 0.5], [1.0, 1.0]), ValueError, "source must lie within")],
)  # fmt: skip
def test_spectra_of_other_shapes_are_refused(ax, arguments, error, message):
    with pytest.raises(error, match=message):
        wd.plot.spectra(*arguments, ax=ax)


def test_a_reflectance_map_shows_the_picture_and_the_mirror_direction(ax, picture):
    wd.plot.reflectance_map(picture, (0.3, 0.2, 1.0), ax=ax, exposure=2.0, display="clip")
    np.testing.assert_array_equal(ax.images[0].get_array(), picture.display("clip", exposure=2.0))
    assert ax.images[0].get_extent() == [-1.0, 1.0, -1.0, 1.0]
    length = math.sqrt(0.3**2 + 0.2**2 + 1.0)
    assert (ax.lines[0].get_xdata()[0], ax.lines[0].get_ydata()[0]) == pytest.approx((-0.3 / length, -0.2 / length))
    assert ax.get_title() == "Reflectance, light at 19.8° from the normal"
    radii = sorted(patch.get_radius() for patch in ax.patches)
    assert radii == pytest.approx([0.5, math.sqrt(0.75), 1.0])


def test_a_height_field_is_evaluated_for_the_light(ax, monkeypatch, picture):
    calls = []
    monkeypatch.setattr(
        "warpdiff.evaluate.reflectance.reflectance_map", lambda *a, **k: calls.append((a, k)) or picture
    )
    grating = wd.gratings.sinusoidal(2.0, 0.1)
    wd.plot.reflectance_map(grating, (0.3, 0.2, 1.0), ax=ax)
    assert calls == [((grating, (0.3, 0.2, 1.0)), {"size": 480})]
    with pytest.raises(ValueError, match="to_light is required with a height field, got None"):
        wd.plot.reflectance_map(grating, ax=ax)
    with pytest.raises(TypeError, match=r"source must be a warpdiff\.HeightField or the picture of .*, got str"):
        wd.plot.reflectance_map("scan.x3p", ax=ax)


def test_a_strip_has_the_colours_of_its_directions(ax, rng):
    xyz, angles = rng.uniform(0.0, 0.5, (9, 3)), np.linspace(-80.0, 80.0, 9)
    wd.plot.colour_strip(xyz, angles_deg=angles, ax=ax, display="clip", exposure=1.0)
    np.testing.assert_allclose(ax.collections[0].get_array()[0], wd.to_srgb(xyz, "clip", exposure=1.0))
    assert ax.get_xlim() == (-80.0, 80.0)


@pytest.mark.parametrize("azimuth", [0.0, 60.0])
def test_a_strip_of_a_height_field_is_in_the_plane_of_the_light(ax, monkeypatch, azimuth):
    """A colour strip must show view directions in the plane of the light and the normal.

    The view angle of 30° must be the direction to the light. The view angle of −30° must be its mirror direction, which
    the plot marks.
    """
    views = []

    def reflectance(_heightfield, _to_light, to_view):
        views.append(to_view)
        return np.full((len(to_view), 3), 0.5)

    monkeypatch.setattr("warpdiff.evaluate.reflectance.reflectance", reflectance)
    light = wd.direction(30.0, azimuth)
    wd.plot.colour_strip(wd.gratings.sinusoidal(2.0, 0.1), light, angles_deg=[-30.0, 0.0, 30.0], ax=ax)
    np.testing.assert_allclose(views[0][2], light, atol=1e-12)
    np.testing.assert_allclose(views[0][0], [-light[0], -light[1], light[2]], atol=1e-12)
    assert ax.lines[0].get_xdata()[0] == pytest.approx(-30.0)
    assert ax.get_title() == "Colour against view angle, light at 30°"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"source": np.ones((3, 3))}, "angles_deg is required with XYZ, got None"),
     ({"source": np.ones((3, 3)), "angles_deg": [0.0, 1.0]}, r"source must have the shape \(2, 3\), .* got \(3, 3\)"),
     ({"source": np.ones((2, 3)), "angles_deg": [1.0, 0.0]}, "angles_deg must be at least two increasing angles"),
     ({"source": wd.gratings.sinusoidal(2.0, 0.1)}, "to_light is required with a height field")],
)  # fmt: skip
def test_strips_without_angles_or_light_are_refused(ax, arguments, message):
    with pytest.raises(ValueError, match=message):
        wd.plot.colour_strip(**arguments, ax=ax)


def test_errors_equal_to_the_tolerance_have_the_middle_colour(ax, picture):
    error = np.where(picture.illuminated, 0.1, 0.0).astype(np.float32)
    error[12, 12] = 0.2
    wd.plot.error_image(dataclasses.replace(picture, error=error), ax=ax)
    shown = ax.images[0]
    np.testing.assert_array_equal(np.ma.getmaskarray(shown.get_array()), ~picture.illuminated)
    assert float(shown.norm(0.1)) == pytest.approx(0.5)
    share = 100.0 * (1.0 - 1.0 / np.count_nonzero(picture.illuminated))
    assert ax.get_title() == f"Estimated error: {share:.3g} % of the pixels meet the tolerance of 0.1"


def test_a_picture_from_a_file_needs_a_tolerance(ax, picture):
    loaded = dataclasses.replace(picture, report=None, plan=None)
    with pytest.raises(ValueError, match="tolerance is required for a picture from a file, got None"):
        wd.plot.error_image(loaded, ax=ax)
    wd.plot.error_image(loaded, ax=ax, tolerance=0.05)
    assert float(ax.images[0].norm(0.05)) == pytest.approx(0.5)


def test_bars_of_a_plan_have_the_lengths_of_its_errors(ax, picture):
    plan = picture.plan
    wd.plot.plan(plan, ax=ax)
    names = [label.get_text() for label in ax.get_yticklabels()]
    widths = dict(zip(names, (bar.get_width() for bar in ax.patches), strict=True))
    for name, error in (plan.predicted_errors | {"total": plan.error}).items():
        assert widths[name] == pytest.approx(max(error, 1e-4 * plan.tolerance))
    assert ax.lines[0].get_xdata()[0] == plan.tolerance
    assert ax.get_title().startswith("The plan meets its tolerance of 0.1\n")


def test_lines_of_wavelengths_are_dark_enough_on_white():
    """The colour of a line must have the hue of its wavelength, and a contrast of more than 2.9 to white."""
    for wavelength, channel in ((450.0, 2), (530.0, 1), (650.0, 0)):
        colour = np.array(to_rgb(tuple(wavelength_colour(wavelength))))
        assert np.argmax(colour) == channel
        luminance = wd.plot.order_plots.colorimetry.srgb_decode(colour) @ [0.2126, 0.7152, 0.0722]
        assert 1.05 / (luminance + 0.05) > 2.9
    assert np.ptp(wavelength_colour(300.0)) == 0.0
