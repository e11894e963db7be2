"""Upper-bound plans, which calls with few directions use, meet the tolerance. Each tested call once exceeded it.

A call is one call of a public function, such as ``wd.reflectance``. A plan holds the numbers of a computation, such as
wavelengths and terms of a series. An upper-bound plan must suffice for any surface.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ.
"""

import math
import warnings

import numpy as np
import pytest
from conftest import hemisphere, slow

import warpdiff as wd
from bench.truth import judge, reference
from warpdiff.planner import bounds, cost_model
from warpdiff.request.directions import DirectionRange
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings, SpectralSettings


def ratio(heightfield, lights, views, tolerance, **options):
    """Return the error of the colours of ``wd.reflectance``, relative to a float64 reference, over the tolerance."""
    with warnings.catch_warnings():
        # Ignore the warning that scalar diffraction is invalid for a deep surface.
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        assert not wd.plan(heightfield, lights, views, tolerance=tolerance, **options).is_measured
    xyz = wd.reflectance(heightfield, lights, views, tolerance=tolerance, **options)
    coherence, illuminant = options.get("coherence", wd.Coherence()), options.get("illuminant", "D65")
    exact = reference.reference_reflectance(
        heightfield, lights, views, coherence, tolerance=0.1 * min(tolerance, 1e-3), illuminant=illuminant
    )
    return judge.figure(xyz, exact).value / tolerance


def line_grating(levels, period_um):
    """Return a height field of one period along x, with the given heights in µm."""
    return wd.HeightField.of_known_scale(np.asarray(levels)[None], (1.0, period_um / len(levels)))


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
def test_third_orders_of_a_shallow_sine_meet_the_tolerance(rng, tolerance):
    """The error of the third orders of a shallow sine must be within the tolerance.

    The power of these orders is proportional to κ⁶. It is tiny at grazing views, where κ is small. Such tiny powers are
    inaccurate in float32.
    """
    heightfield = line_grating(0.05 * np.cos(2.0 * np.pi * np.arange(32) / 32), 1.5)
    x, z = -rng.uniform(0.45, 0.65, 98), rng.uniform(0.05, 0.1, 98)
    lights = np.stack([x, np.sqrt(1.0 - x * x - z * z), z], axis=1)
    lights, views = np.repeat(lights, 2, axis=0)[:100], np.repeat(lights * [1.0, -1.0, 1.0], 2, axis=0)[:100]
    # Two dark directions with a larger κ are added, so that the plan (numbers of the computation) must cover a wide
    # range of κ.
    lights[-2:], views[-2:] = [0.076, 0.064, 0.995], [-0.345, 0.588, 0.732]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    assert ratio(heightfield, lights, views, tolerance) <= 0.5


@pytest.mark.parametrize(("height_um", "illuminant"), [slow(3.0, "HP2"), (5.5, "FL12")])
def test_two_tall_levels_in_the_mirror_direction_meet_the_tolerance(rng, height_um, illuminant):
    """Tall steps must meet the tolerance in the mirror direction, under illuminants with narrow spectral lines.

    The spectra of tall steps oscillate quickly with the wavelength. Both the oscillation and the narrow lines require
    many wavelengths.
    """
    heightfield = line_grating(np.repeat([height_um, 0.0], 32), 4.0)
    lights = hemisphere(rng, 20, 0.95)
    assert ratio(heightfield, lights, lights * [-1.0, -1.0, 1.0], 1e-4, illuminant=illuminant) <= 0.5


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
def test_the_tail_of_the_lobe_around_a_mirrored_sun_meets_the_tolerance(rng, tolerance):
    """The errors in directions far from the mirror direction of the sun must be within the tolerance.

    The sun is a light source of finite size. All tested directions are 5 to 7 standard deviations of this source away
    from the mirror direction. Their reflectance is about a millionth of the peak or less.
    """
    source = wd.Coherence("source")
    away, turn = rng.uniform(5.2, 7.2, 120) * source.spread, rng.uniform(0.0, 2.0 * math.pi, 120)
    views = np.stack([away * np.cos(turn), away * np.sin(turn), np.sqrt(1.0 - away**2)], axis=1)
    lights = np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    assert ratio(wd.HeightField(np.zeros((8, 8)), 0.1), lights, views, tolerance, coherence=source) <= 0.5


@pytest.mark.parametrize("illuminant", ["FL11", slow("HP1")])
def test_maps_under_illuminants_with_narrow_lines_meet_the_tolerance(illuminant):
    """The errors of reflectance maps must be within the tolerance under illuminants with narrow spectral lines.

    In most view directions of a reflectance map, the wavelength of a diffraction order is between two lines of the
    illuminant.
    """
    heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.08, seed=4)
    rng = np.random.default_rng(3)
    lights = np.broadcast_to([0.0, 0.0, 1.0], (100, 3))
    assert ratio(heightfield, lights, hemisphere(rng, 100, 0.3), 1e-4, illuminant=illuminant) <= 0.5


def upper_bound(heightfield, direction_range, *, wavelengths_nm=None, **options):
    settings = PlanSettings(**options) if wavelengths_nm is None else SpectralSettings(**options)
    request = Evaluation.of(heightfield, settings, wavelengths_nm=wavelengths_nm)
    return bounds.upper_bound_plan(request, direction_range, method="low-rank", tolerance=request.tolerance)


def test_bandwidths_scale_with_coherence_height_and_tolerance(fingers):
    """The bandwidth of a plan must be proportional to the coherence, to the heights and to a power of the tolerance.

    The bandwidth is the number of wavelength samples per unit of 1/λ. It has three parts: one for order rates (how fast
    diffraction orders pass a direction as 1/λ changes), one for heights, and a constant. The first part must be
    proportional to the σ of the coherence window, and the second to the heights. For Gaussian windows, both must be
    proportional to tolerance^(−1/6).
    """
    tall = wd.HeightField.of_known_scale(3.0 * fingers.heights_um, fingers.pitch_um)
    rate, height, colour = bounds.bandwidth_um(fingers, wd.Coherence(sigma_um=5.0), 1e-2)
    np.testing.assert_allclose(
        bounds.bandwidth_um(tall, wd.Coherence(sigma_um=10.0), 1e-2), (2.0 * rate, 3.0 * height, colour)
    )
    finer = 10.0 ** (1 / 3)
    np.testing.assert_allclose(
        bounds.bandwidth_um(fingers, wd.Coherence(sigma_um=5.0), 1e-4), (finer * rate, finer * height, colour)
    )
    # For replicated patches (kind "replicas"), the first part of the bandwidth (number of wavelength samples) is a
    # number of wavelengths per diffraction order of the patch that passes a direction while λ changes. It must be
    # proportional to tolerance^(−1/4).
    replicas = wd.Coherence("replicas", periods=(2, 2))
    order, height, _ = bounds.bandwidth_um(fingers, replicas, 1e-2)
    assert height == pytest.approx(order * fingers.height_range_um)
    assert bounds.bandwidth_um(fingers, replicas, 1e-4)[0] == pytest.approx(math.sqrt(10.0) * order)


def test_a_source_requires_the_samples_of_a_window_at_equal_ratios_of_the_wavelength(fingers):
    """At 380 nm, wavelengths must be as close in 1/λ for a light source of finite size as for a coherence window.

    The wavelengths for a source have equal ratios. Their distance in 1/λ is therefore largest at 380 nm.
    """
    source, window = wd.Coherence("source", angular_diameter_deg=3.0), wd.Coherence(sigma_um=5.0)
    of_source, of_window = (bounds.bandwidth_um(fingers, coherence, 1e-2) for coherence in (source, window))
    band, band_of_log = 1.0 / 0.38 - 1.0 / 0.78, math.log(0.78 / 0.38)
    wider = band_of_log / 0.38 / band
    np.testing.assert_allclose(of_source[1:], wider * np.array(of_window[1:]))
    # In a spectrum, a diffraction order is a Gaussian of 1/λ or of ln λ. A light source of finite size and a coherence
    # window require the same number of wavelengths per standard deviation of this Gaussian.
    of_deviation = 1.0 / (2.0 * math.sqrt(2.0) * math.pi * 5.0)
    assert of_source[0] * band * source.spread / band_of_log == pytest.approx(of_window[0] * of_deviation)


def test_bounds_of_a_grazing_source_limit_the_order_rate_to_what_the_most_wavelengths_resolve(fingers):
    source = wd.Coherence("source", angular_diameter_deg=1.0)
    near, grazing = (DirectionRange(1.9, rate, 0.01, 1.2) for rate in (3.0, 1e4))
    plan = upper_bound(fingers, near, coherence=source)
    assert plan.max_order_rate == 3.0
    assert plan.wavelengths >= 0.98 * cost_model.wavelength_count(plan, 3.0, 1.2)
    plan = upper_bound(fingers, grazing, coherence=source)
    assert plan.wavelengths == 16_384
    assert 1.9 < plan.max_order_rate < 1e4
    # ``wavelength_count`` adds 1 to the number of intervals between wavelengths, so its result exceeds the limit of
    # 16,384 by 1.
    assert cost_model.wavelength_count(plan, plan.max_order_rate, 1.2) == pytest.approx(16_385, rel=1e-9)


def test_bounds_are_valid_for_the_range_of_a_call_and_predict_no_quadrature_error_for_spectra(fingers):
    direction_range = DirectionRange(1.5, 1.5, 0.3, 1.7, 400.0, 700.0)
    plan = upper_bound(fingers, direction_range, wavelengths_nm=np.array([400.0, 700.0]))
    assert plan.direction_range == direction_range
    assert plan.wavelengths == plan.quadrature == 0
    assert plan.error < plan.tolerance
    colour = upper_bound(fingers, direction_range)
    assert colour.quadrature > 0.0
    assert colour.truncation == plan.truncation
    rates, w = np.array([1.5]), np.array([1.7])
    assert colour.multiply_adds == cost_model.sampling_multiply_adds(fingers, colour, rates, w)


def test_periods_have_two_samples_per_lobe_in_the_steepest_direction(fingers):
    """For replicated patches, the interference between periods must be sampled at least twice per maximum.

    As a function of (u, v), the interference of N periods has N maxima from one diffraction order of the patch to the
    next. Along the diagonal of (u, v), the maxima are closer by a factor of √2.
    """
    rate, band = 1.9 * max(fingers.size_um), 1.0 / 0.38 - 1.0 / 0.78
    plan = upper_bound(
        fingers, DirectionRange(1.9, rate, 0.1, 2.0), coherence=wd.Coherence("replicas", periods=(60, 9))
    )
    lobes = math.sqrt(2.0) * 60 * rate * band
    assert plan.subdivisions > 4
    assert 0.97 * 2.0 * lobes < plan.wavelengths * plan.subdivisions < 1.5 * 2.0 * lobes
