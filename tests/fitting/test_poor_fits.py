"""Fits with unreliable results must warn: no convergence, bounds, singular covariances, few data, or wrong data."""

import math
import warnings

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.core.warnings import warn
from warpdiff.fitting import least_squares

TRUE = np.array([0.14, 0.42, 0.04, 2.0])
ORDERS = [(0, m) for m in (-2, -1, 0, 1, 2)] * 2
LIGHTS = np.repeat(wd.direction([10.0, 20.0]), 5, axis=0)


def profile(*values):
    return wd.profiles.Trapezoid(*(values or TRUE))


def measured(values, orders=ORDERS):
    return wd.Measured.orders(LIGHTS[: len(values)], 450.0, orders, values, ior=math.inf)


EXACT = measured(np.zeros(10)).predict(profile().surface(TRUE)).value
NOISY = EXACT + 1e-3 * np.random.default_rng(0).normal(size=10)
GUESS = profile(*(TRUE * [1.1, 0.95, 1.2, 1.0]))


def test_each_minimum_says_whether_it_has_converged(monkeypatch):
    result = wd.fit(GUESS, measured(NOISY), sd=1e-3, starts=2)
    assert all(minimum.has_converged for minimum in result.minima)
    assert "not converged" not in result.report()
    monkeypatch.setattr(least_squares, "_MOST_STEPS", 3)
    with pytest.warns(wd.WarpdiffWarning, match="best minimum has not converged in 3 steps"):
        result = wd.fit(GUESS, measured(NOISY), sd=1e-3, starts=1)
    assert not result.minima[0].has_converged
    assert "has not converged" in result.report()


def fit_with_warnings(guess, data, sd):
    """Return a fit with one start, and the texts of the warnings that it issued."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = wd.fit(guess, data, sd=sd, starts=1)
    return result, "; ".join(str(warning.message) for warning in caught)


@pytest.mark.parametrize("sd", [1e-12, 1.0, 1e3, 1e9])
def test_the_best_values_do_not_depend_on_the_size_of_sd(sd):
    """Fits must have the same best values for any common standard deviation ``sd``.

    A minimiser that compares the gradient of χ² with a constant would end at the start for a large ``sd``.
    """
    expected = wd.fit(GUESS, measured(NOISY), sd=1e-3, starts=1)
    result, _ = fit_with_warnings(GUESS, measured(NOISY), sd)
    np.testing.assert_allclose(result.values, expected.values, rtol=1e-6)
    assert result.chi2 == pytest.approx(expected.chi2 * (1e-3 / sd) ** 2, rel=1e-9)


@pytest.mark.parametrize("sd", [1e-4, 1e3])
def test_the_best_start_does_not_depend_on_the_size_of_sd(sd):
    """If the standard deviation ``sd`` is large, all χ² are tiny. The fit must still choose the smallest χ²."""
    far = profile(*(TRUE * [2.2, 1.0, 1.0, 1.0]))
    one, _ = fit_with_warnings(far, measured(NOISY), sd)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = wd.fit(far, measured(NOISY), sd=sd, starts=2, seed=2)
    assert result.chi2 < 0.1 * one.chi2
    np.testing.assert_allclose(result.values[[0, 3]], TRUE[[0, 3]], rtol=0.02)
    minima = [least_squares.Minimum(TRUE, chi2 * sd**-2, has_converged=True) for chi2 in (85e-6, 1.000_000_1e-6, 1e-6)]
    assert least_squares._best(minima, sd**-2) is minima[1]


def test_warnings_about_starts_are_not_shown(monkeypatch):
    """A fit must not show warnings about its starts, such as one about an order at the horizon."""
    predict, starts = wd.Measured.predict, []

    def warning(data, surface, wrt=()):
        if not starts:
            starts.append(surface)
            warn("an order at the horizon")
        return predict(data, surface, wrt)

    monkeypatch.setattr(wd.Measured, "predict", warning)
    _, texts = fit_with_warnings(GUESS, measured(NOISY), 1e-3)
    assert starts
    assert texts == ""


def test_exact_starts_and_surfaces_without_gradient_end_at_once():
    result = wd.fit(profile(), measured(EXACT), sd=1e-3, starts=1)
    assert result.chi2 < 1e-20
    flat = wd.profiles.ScanModes(wd.HeightField(np.zeros((4, 4)), 0.5))
    data = wd.Measured.spectra((0, 0, 1), wd.direction([5.0, 15.0, 25.0, 35.0, 45.0]), 550.0, np.full(5, 0.1))
    with pytest.warns(wd.WarpdiffWarning, match="does not determine scale, tilt_y_um, tilt_x_um, bow_um"):
        result = wd.fit(flat, data, sd=1e-3, starts=1)
    assert np.isnan(result.standard_errors).all()
    assert "does not explain the data" in result.report()


def test_parameters_at_bounds_are_named():
    """If a best value is at a bound, the fit must name the parameter and give no standard error for it.

    Sloped walls lower the efficiencies of high orders. The efficiencies in the data are higher than those for vertical
    walls, so that the fit ends at the bound of vertical walls.
    """
    vertical = measured(EXACT).predict(profile().surface([0.14, 0.42, 0.0, 2.0])).value
    result, texts = fit_with_warnings(profile(), measured(vertical + 0.2 * (vertical - EXACT)), 1e-3)
    assert "best wall is at a bound of profile" in texts
    assert "does not determine" not in texts
    assert result.at_bounds == ("wall",)
    assert math.isnan(result.standard_errors[2])
    assert np.isfinite(result.standard_errors[[0, 1, 3]]).all()
    assert "at a bound" in result.report()


def test_fewer_values_than_parameters_give_a_warning():
    result, texts = fit_with_warnings(GUESS, measured(NOISY[:3], ORDERS[:3]), 1e-3)
    assert "has 3 values for 4 parameters" in texts
    assert "does not determine" in texts
    assert result.degrees_of_freedom == 0
    assert np.isnan(result.standard_errors).any()


def test_a_change_of_all_pixels_is_not_determined():
    """If all pixels change by the same height, no colour changes. The standard errors of all heights must be NaN.

    Truncation errors of colours can make this change seem to be determined, with standard errors of a millimetre.
    """
    rng = np.random.default_rng(1)
    pixels = wd.profiles.Pixels(0.5, rng.uniform(0.0, 0.1, (1, 3)), samples=2)
    views, coherence = wd.direction([5.0, 15.0, 25.0, 35.0]), wd.Coherence(sigma_um=1.0)
    empty = wd.Measured.colours((0, 0, 1), views, np.zeros((4, 3)), coherence=coherence)
    xyz = empty.predict(pixels.surface(pixels.start)).value + 1e-3 * rng.normal(size=12)
    data = wd.Measured.colours((0, 0, 1), views, xyz.reshape(-1, 3), coherence=coherence)
    with pytest.warns(wd.WarpdiffWarning, match="does not determine level_um"):
        result = wd.fit(pixels, data, sd=1e-3, starts=1)
    assert np.isnan(result.standard_errors).all()


@pytest.mark.parametrize("orders", [np.array(ORDERS)[:, ::-1], [(0, 20 * m) for _, m in ORDERS]])
def test_measured_power_in_orders_that_do_not_propagate_gives_a_warning(orders):
    _, texts = fit_with_warnings(GUESS, measured(NOISY, orders), 1e-2)
    assert "of 10 measured orders do not propagate" in texts


def test_noise_in_orders_that_do_not_propagate_gives_no_warning():
    light, orders = wd.direction([40.0]), [(0, m) for m in (-2, -1, 0, 1, 2)]
    data = wd.Measured.orders(light, 650.0, orders, np.zeros(5), ior=math.inf)
    values = data.predict(profile().surface(TRUE)).value
    assert values[0] == 0.0
    values[0] = 2e-3
    _, texts = fit_with_warnings(profile(), wd.Measured.orders(light, 650.0, orders, values, ior=math.inf), 1e-3)
    assert "propagate" not in texts


def test_equal_bounds_are_refused():
    fixed = profile()
    fixed.bounds[3] = 2.0
    with pytest.raises(ValueError, match="got 2 to 2 for period_um"):
        wd.fit(fixed, measured(NOISY), sd=1e-3)


def test_all_parameters_may_be_at_bounds():
    narrow = profile()
    narrow.bounds = np.stack([TRUE * 1.01, TRUE * 1.02], axis=1)
    narrow.start = TRUE * 1.015
    result, texts = fit_with_warnings(narrow, measured(EXACT), 1e-6)
    assert len(result.at_bounds) >= 1
    assert np.isnan(result.standard_errors[[name in result.at_bounds for name in result.names]]).all()
    assert "at a bound" in texts
    assert least_squares._covariance(np.zeros((5, 0))).shape == (0, 0)


def test_percent_gives_a_warning():
    with pytest.warns(wd.WarpdiffWarning, match="divide percent by 100"):
        measured(100.0 * NOISY)


def test_parameters_without_a_surface_are_refused():
    """Parameters whose vertices are beyond the period, or not in order, must raise an error.

    If such vertices were moved into the period instead, the gradient would be wrong, because it excludes the move.
    """
    for x in ([0.14, 1.4, 0.04, 2.0], [0.14, 0.42, 0.9, 2.0], [0.14, -0.1, 0.0, 2.0]):
        with pytest.raises(ValueError, match="vertices in increasing order within one period"):
            profile().surface(x)
    with pytest.raises(ValueError, match="three equal positions"):
        wd.profiles.Polygon([(0.0, 0.0), (0.4, 0.0), (0.4, 0.1), (0.4, 0.05), (0.6, 0.0)], 2.0)
