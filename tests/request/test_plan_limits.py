"""Limits of plans: height ranges, coherence windows, directions and pitches are refused, or used with a warning.

A plan has the numbers of a computation, such as wavelengths and terms of a series. The order rate of a direction is the
speed at which orders pass the direction as 1/λ changes. It grows with |(u, v)|, the tangential part of the scattering
vector.
"""

import dataclasses
import math
import warnings

import numpy as np
import pytest
from conftest import at_angle, hemisphere, slow

import warpdiff as wd
from warpdiff.diffraction.phase_series import EXPANSIONS

UP = [0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def rough() -> wd.HeightField:
    """Return a small patch with structure along both axes, sampled finely enough for all directions."""
    return wd.gratings.fingers(size_um=6.4, seed=3)


def deep(height_um: float) -> wd.HeightField:
    """Return a random surface with a given height range."""
    heights = np.random.default_rng(8).uniform(size=(16, 16))
    heights = (heights - heights.min()) / np.ptp(heights) * height_um
    return wd.HeightField.of_known_scale(heights, 0.05)


@pytest.mark.parametrize(
    ("directions", "how"),
    # The second tested call of ``wd.plan`` has no directions, so that the plan is for the whole hemisphere. It requires
    # a search, which is slow because it compiles a kernel for each number of terms.
    [((UP, hemisphere(np.random.default_rng(2), 20)), "by its bound"), slow((), "measured on")],
    ids=["few", "all"],
)
def test_a_height_range_beyond_float32_is_refused_and_computed_with_strict_false(directions, how):
    views = hemisphere(np.random.default_rng(2), 20)
    for height, method in ((3.0, "taylor"), (8.0, "auto")):
        heightfield = deep(height)
        for call, given in ((wd.plan, directions), (wd.reflectance, (UP, views))):
            message = rf"tolerance=0\.01: .* of {height:g} µm.*levelled\(\).*strict=False"
            with pytest.raises(ValueError, match=message) as refused:
                call(heightfield, *given, method=method)
            assert call is wd.reflectance or how in str(refused.value)
            with pytest.warns(wd.WarpdiffWarning, match=r"cannot meet tolerance=0\.01"):
                result = call(heightfield, *given, method=method, strict=False)
        assert np.all(np.isfinite(result))
        assert result.min() >= 0.0
    # The direct sum uses no series of exp(2πiκh), so any height range can be computed.
    assert np.all(np.isfinite(wd.spectral_reflectance(heightfield, UP, UP, 500.0, method="direct")))


def test_a_remainder_of_amplitudes_is_refused_where_the_series_ends():
    """A height range of 6.9 µm must be refused, because even the largest number of terms gives too large errors.

    Amplitudes of Fourier coefficients then have an error of 3e-3, relative to a flat surface. Relative to weak orders
    the error is 1000 times as large. A height range of 6.2 µm must be accepted.
    """
    with pytest.raises(wd.ToleranceError, match=r"terms are too few for a height range of 6\.9 µm"):
        wd.plan(deep(6.9), UP, UP)
    wd.plan(deep(6.2), UP, UP)


def test_a_plan_reports_a_thousand_times_the_remainder_of_amplitudes_where_the_series_ends():
    """The truncation error of a plan must be 1,000 times the remainder of the series of amplitudes.

    This holds for a height range of 6.5 µm, for which even the largest number of terms gives too large errors.
    """
    with pytest.warns(wd.WarpdiffWarning, match="128 terms are too few"):
        plan = wd.plan(deep(6.5), UP, UP, strict=False)
    argument = math.pi * 6.5 * 2.0 / 0.38
    assert plan.truncation == pytest.approx(1e3 * EXPANSIONS["jacobi-anger"].remainder(argument, 128), rel=1e-6)


def test_the_largest_height_range_of_a_series_depends_on_the_shortest_wavelength():
    """Height ranges above 100 wavelengths of 380 nm must be refused, and smaller ranges must be accepted.

    The path is twice the height range, so that the limit is 19 µm. At 780 nm the limit would be 39 µm.
    """
    with pytest.raises(ValueError, match=r"25 µm, which is 1\.3e\+02 wavelengths of path"):
        wd.plan(deep(25.0), UP, UP, strict=False)
    with pytest.warns(wd.WarpdiffWarning, match="terms are too few"):
        wd.plan(deep(18.9), UP, UP, strict=False)


def test_the_automatic_series_is_accurate_at_heights_where_taylor_fails(rng):
    heightfield = deep(3.0)
    lights, views = hemisphere(rng, 60), hemisphere(rng, 60)
    options = {"coherence": wd.Coherence(sigma_um=0.5), "tolerance": 1e-4}
    exact = wd.spectral_reflectance(heightfield, lights, views, [400.0, 600.0], method="direct", **options)
    result = wd.spectral_reflectance(heightfield, lights, views, [400.0, 600.0], **options)
    np.testing.assert_allclose(result, exact, rtol=1e-4, atol=1e-7 * np.percentile(exact, 99.0))


def test_height_ranges_beyond_the_expansions_are_refused_and_the_direct_sum_computes_them(rough):
    plan = wd.plan(rough, UP, UP)
    for height_um in (375.0, 1e9):
        for method in ("auto", "taylor"):
            with pytest.raises(ValueError, match=r"wavelengths of path.*method='direct'"):
                wd.reflectance(deep(height_um), UP, UP, method=method, strict=False)
        with pytest.raises(ValueError, match="method='direct'"), pytest.warns(wd.WarpdiffWarning, match="beyond"):
            wd.reflectance(deep(height_um), UP, UP, plan=plan)
    with pytest.warns(wd.WarpdiffWarning, match="invalid"):
        assert np.isfinite(
            wd.reflectance(deep(375.0), UP, UP, method="direct", coherence=wd.Coherence(sigma_um=0.5))
        ).all()


def test_an_explicit_plan_is_used_with_a_warning_beyond_its_range(rough):
    narrow, whole = wd.plan(rough, UP, at_angle(5.0)), wd.plan(rough, coherence=wd.Coherence(sigma_um=3.0))
    calls = {
        "height range": lambda: wd.reflectance(deep(3.0), UP, UP, plan=narrow, strict=True),
        "up to 0.643, planned 0.0872": lambda: wd.reflectance(rough, UP, at_angle(40.0), plan=narrow),
        "1/λ": lambda: wd.spectral_reflectance(rough, UP, UP, 200.0, plan=narrow),
    }
    for what, call in calls.items():
        with pytest.warns(wd.WarpdiffWarning, match=f"beyond its valid range: .*{what}"):
            result = call()
        assert np.all(np.isfinite(result))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wd.reflectance(rough, UP, at_angle(5.0), plan=narrow)
        wd.spectral_reflectance(rough, UP, at_angle(3.0), [400.0, 700.0], plan=whole)


@pytest.mark.parametrize(
    "coherence", [wd.Coherence("source", angular_diameter_deg=2.0), wd.Coherence("replicas", periods=(4, 4))], ids=str
)
def test_a_plan_beyond_its_order_rate_causes_a_warning(coherence):
    fine = wd.gratings.fingers(size_um=3.2, pitch_um=0.1, seed=1)
    narrow = wd.plan(fine, UP, at_angle(5.0), coherence=coherence)
    with pytest.warns(wd.WarpdiffWarning, match="order rate up to"):
        wd.reflectance(fine, UP, at_angle(40.0), plan=narrow)


def test_a_fitted_basis_below_its_range_causes_a_warning(rough):
    steep = wd.plan(rough, UP, at_angle(5.0), method="low-rank")
    blue = dataclasses.replace(steep, lambda_max_nm=500.0)
    with pytest.warns(wd.WarpdiffWarning, match=r"1/λ \[1/µm\] down to 1.28, planned 2"):
        wd.reflectance(rough, UP, at_angle(5.0), plan=blue)
    series = dataclasses.replace(blue, method="jacobi-anger")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wd.reflectance(rough, UP, at_angle(5.0), plan=series)


def test_windows_too_long_for_a_colour_are_refused(rough):
    with pytest.raises(ValueError, match=r"sigma_um=20000\.0 .* wavelengths"):
        wd.plan(rough, coherence=wd.Coherence(sigma_um=2e4))


def test_a_coarse_pitch_causes_a_warning_about_aliasing(rough):
    coarse = wd.gratings.sinusoidal(6.4, 0.1).resampled(0.2)
    with pytest.warns(wd.WarpdiffWarning, match=r"a pitch of 0\.2 µm supports \|\(u, v\)\| up to 0\.95 at 380 nm"):
        wd.plan(coarse, method="direct")
    with pytest.warns(wd.WarpdiffWarning, match=r"directions reach 1\.5: higher orders alias onto lower ones"):
        wd.plan(coarse, at_angle(30.0), method="direct")
    with pytest.warns(wd.WarpdiffWarning, match="finer pitch"):
        wd.reflectance(coarse, at_angle(60.0), at_angle(50.0))
    # Directions with large |(u, v)| require a small pitch of the height samples. Directions for which the pitch
    # suffices cause no warning. At longer wavelengths, it suffices for more directions.
    wd.plan(coarse, at_angle(20.0), at_angle(20.0))
    wd.spectral_reflectance(coarse, at_angle(30.0), at_angle(45.0), [700.0])
    wd.plan(rough, method="direct")


def test_a_renderer_of_another_size_under_a_source_does_not_warn():
    """A renderer for a light source of finite size must not warn that its plan does not cover the whole hemisphere.

    No plan for such a source covers the whole hemisphere. The tested renderer is that of ``Renderer.resized``.
    """
    tube, light = wd.meshes.tube(segments_along=12, segments_around=12), wd.DirectionalLight((0.1, 0.9, 1.2))
    options = {"coherence": wd.Coherence("source"), "tolerance": 0.3, "refine": False}
    renderer = wd.Renderer(
        tube, wd.gratings.sinusoidal(1.0, 0.1), light, wd.View.fit(tube, width=8, height=6), **options
    )
    renderer.resized(wd.View.fit(tube, width=16, height=12)).draw(light)
