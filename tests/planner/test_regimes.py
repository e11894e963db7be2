"""Automatic plans where fixed methods or settings fail: results meet the tolerance or are refused with a reason.

An automatic plan has the numbers of a computation, such as wavelengths and terms of a series, as the library selects
them.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. H_m is the Fourier coefficient of order m.
"""

import math

import numpy as np
import pytest
from conftest import slow

import warpdiff as wd
from bench.truth import numpy_methods as methods
from bench.truth import reference
from warpdiff.diffraction import direct_sum

TOLERANCE = 1e-2
WINDOW = wd.Coherence()


class Case:
    """Arguments of ``wd.reflectance`` (height field, directions, coherence model), and the colours it must return."""

    def __init__(self, heightfield, directions, coherence=WINDOW):
        self.heightfield, (self.lights, self.views), self.coherence = heightfield, directions, coherence
        self.exact = reference.reference_reflectance(heightfield, self.lights, self.views, coherence)

    def error_of(self, xyz):
        return methods.colour_error(xyz, self.exact)

    @property
    def automatic(self):
        """Return the error of the colours that the library computes with its own settings, relative to ``exact``.

        A warning or a refusal fails the test.
        """
        xyz = wd.reflectance(self.heightfield, self.lights, self.views, coherence=self.coherence, tolerance=TOLERANCE)
        return self.error_of(xyz)

    def fixed_steps(self, step_nm):
        return self.error_of(
            methods.fixed_step_colour(self.heightfield, self.lights, self.views, step_nm, self.coherence)
        )

    def neighbours(self, **keywords):
        wavelengths, weights = methods.fixed_steps(1.0)
        rho = methods.series_reflectance(
            self.heightfield, self.lights, self.views, 1e-3 * wavelengths, sigma=self.coherence.sigma_um,
            neighbour_extent=1, **keywords,
        )  # fmt: skip
        return self.error_of(rho @ weights)


# Tests with coherence windows of different sizes. Short windows require many neighbouring Fourier coefficients. With
# long windows, diffraction orders are narrower than wavelength steps of 1 nm.


@pytest.fixture(scope="module")
def line():
    return methods.finger_rows(25.6)


@pytest.mark.parametrize(
    ("kind", "sigma"),
    [("averaged", 1.0), ("averaged", 20.0), ("averaged", 400.0), ("centred", 1.0), ("centred", 20.0),
     slow("centred", 400.0)],
)  # fmt: skip
def test_automatic_plans_meet_the_tolerance_for_all_windows(line, kind, sigma):
    assert Case(line, methods.in_plane(32, 1.8), wd.Coherence(kind, sigma)).automatic <= TOLERANCE


def test_fixed_neighbours_and_wavelength_steps_fail_for_some_windows(line):
    directions = methods.in_plane(48, 1.8)
    short, middle, long = (Case(line, directions, wd.Coherence(sigma_um=sigma)) for sigma in (3.0, 10.0, 100.0))
    assert short.neighbours() > 0.1
    assert short.neighbours(floor=True) > 0.1
    assert middle.neighbours() < TOLERANCE < middle.neighbours(floor=True)
    assert middle.fixed_steps(1.0) < TOLERANCE < middle.fixed_steps(5.0)
    assert long.fixed_steps(1.0) > 0.1


def test_windows_that_are_too_short_or_too_long_are_refused_with_the_remedy(line):
    up = [0.0, 0.0, 1.0]
    with pytest.raises(ValueError, match=r"sigma_um=0\.01 is too short.* crop the height field"):
        wd.reflectance(wd.gratings.fingers(), up, [0.5, 0.0, 0.8], coherence=wd.Coherence(sigma_um=0.01))
    lights, views = methods.in_plane(4, 1.8)
    with pytest.raises(ValueError, match=r"sigma_um=50000\.0 .*wavelengths.*smaller sigma_um"):
        wd.reflectance(line, lights, views, coherence=wd.Coherence(sigma_um=5e4))


# Tests with patches of different sizes. The diffraction orders of large patches are so close that 3 × 3 neighbouring
# Fourier coefficients do not suffice. For all patches, 81 wavelengths (steps of 5 nm) are too few.


@pytest.mark.parametrize("size", [2.0, 12.8, 32.0])
def test_automatic_plans_meet_the_tolerance_for_all_patch_sizes(size):
    heightfield = wd.gratings.fingers(size_um=size, pitch_um=0.09, length_um=min(3.0, size), seed=4)
    assert Case(heightfield, methods.hemisphere_pairs(32, 0.4)).automatic <= TOLERANCE


def test_fixed_neighbours_and_wavelength_steps_fail_for_some_patch_sizes():
    usual = Case(wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=4), methods.hemisphere_pairs(24))
    assert usual.fixed_steps(5.0) > 0.1
    assert usual.fixed_steps(1.0) < TOLERANCE
    assert usual.automatic <= TOLERANCE
    for step, limit in ((10.0, 0.3), (25.0, 1.0), (50.0, 1.0)):
        assert usual.fixed_steps(step) > limit
    line = Case(methods.finger_rows(100.0), methods.in_plane(32, 1.8))
    assert line.neighbours() > 0.03
    assert line.neighbours(floor=True) > 0.1
    assert line.automatic <= TOLERANCE


# Tests of large and small |(u, v)|. Far from the mirror direction, 81 wavelengths are too few. Near the mirror
# direction, one wavelength per diffraction order is too few.


@pytest.mark.parametrize("uv", [0.003, 0.1, slow(0.7), 1.98])
def test_automatic_plans_meet_the_tolerance_for_all_scattering_vectors(uv):
    heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.09, seed=4)
    case = Case(heightfield, methods.with_lateral(64, uv, seed=1))
    assert case.automatic <= TOLERANCE
    order_wise = case.error_of(methods.order_wise_colour(heightfield, case.lights, case.views, sigma=16.25))
    if uv <= 0.1:
        assert order_wise > 0.3
    if uv >= 1.4:
        assert order_wise < 3.0 * TOLERANCE
        assert case.fixed_steps(5.0) > 0.1


# Tests of grazing directions. For them, the sum 1 + ωi·ωr loses precision by cancellation, and light sources are
# foreshortened.


@pytest.mark.parametrize("elevation", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("spread", [0.1, None])
def test_automatic_plans_meet_the_tolerance_towards_the_horizon(elevation, spread):
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=4)
    case = Case(heightfield, methods.at_elevation(48, elevation, spread))
    assert case.automatic <= TOLERANCE
    if (elevation, spread) == (0.1, 0.1):
        wavelengths, weights = methods.fixed_steps(1.0)
        single = methods.single_precision(heightfield, case.lights, case.views, 1e-3 * wavelengths, sigma=16.25)
        assert case.error_of(single @ weights) > TOLERANCE


@pytest.mark.parametrize(("count", "seed"), [(64, 0), (15, 1)])
def test_directions_far_darker_than_the_mirror_direction_meet_the_tolerance(count, seed):
    """Errors in directions with a millionth of the mirror direction's reflectance must be within the tolerance.

    The light in the mirror direction must not affect the results in these directions. In such dark directions the terms
    of a series of powers cancel. Another series must replace it, also in calls with few directions, for which the
    library does not search for a plan.
    """
    heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.08, seed=4)
    assert Case(heightfield, methods.at_elevation(count, 0.1, None, seed)).automatic <= TOLERANCE


@pytest.mark.parametrize("elevation", [0.1, slow(0.5), 3.0, slow(30.0)])
@pytest.mark.parametrize("spread", [0.1, None])
def test_spectra_of_sources_towards_the_horizon_meet_the_tolerance(elevation, spread):
    heightfield, source = wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=4), wd.Coherence("source")
    lights, views = methods.at_elevation(24, elevation, spread)
    wavelengths = np.linspace(0.38, 0.78, 21)
    exact = reference.reference_spectral(heightfield, lights, views, wavelengths, source)
    rho = wd.spectral_reflectance(heightfield, lights, views, 1e3 * wavelengths, coherence=source, tolerance=TOLERANCE)
    assert methods.spectral_error(rho, exact) <= TOLERANCE
    if elevation >= 3.0 and spread is None:
        assert Case(heightfield, (lights, views), source).automatic <= TOLERANCE


@pytest.mark.parametrize(("elevation", "count", "seed"), [(0.5, 4, 0), slow(0.5, 20, 1), slow(0.2, 8, 1)])
def test_colours_of_a_source_at_the_horizon_meet_the_tolerance(elevation, count, seed):
    """Colours for a light source of finite size at most half a degree above the horizon must meet the tolerance.

    Such a source is foreshortened by a factor of more than 100.
    """
    heightfield = wd.gratings.fingers(size_um=3.2, pitch_um=0.09, seed=4)
    assert (
        Case(heightfield, methods.at_elevation(count, elevation, None, seed), wd.Coherence("source")).automatic
        <= TOLERANCE
    )


@pytest.mark.parametrize("count", [2, slow(8), slow(12)])
def test_a_source_too_close_to_the_horizon_is_accurate_or_refused(count):
    """Colours for a light source of finite size at 0.2° above the horizon must be accurate, or the call refused.

    The call may require more wavelengths than a plan can have.
    """
    heightfield, source = wd.gratings.fingers(size_um=3.2, pitch_um=0.09, seed=4), wd.Coherence("source")
    lights, views = methods.at_elevation(count, 0.2)
    xyz, message = methods.outcome(wd.reflectance, heightfield, lights, views, coherence=source)
    if message:
        assert xyz is None
        assert "larger angular_diameter_deg" in message
    else:
        exact = reference.reference_reflectance(heightfield, lights, views, source)
        assert methods.colour_error(xyz, exact) <= TOLERANCE


# Tests with different pitches (distances of height samples). Reference colours computed from the same samples would
# have the same aliasing. The expected colours are therefore closed forms.


PERIOD, DEPTH, SINE_WINDOW = 1.6, 0.3, wd.Coherence(sigma_um=3.0)


def sine_colour(lights, views):
    """Return XYZ of a continuous sine grating. The power of order m is J_m(πκ·depth)², with the Bessel function J_m."""
    tau, weights = reference.quadrature(64, "D65")
    scattering_vectors = -(lights + views)
    theta = 2.0 * math.pi * np.arange(64) / 64
    phase = math.pi * DEPTH * scattering_vectors[:, 2][:, None, None] * tau[:, None] * np.sin(theta)
    orders = np.abs(np.fft.fft(np.exp(1j * phase), axis=-1) / 64) ** 2
    away = (scattering_vectors[:, :1] * tau)[..., None] - np.fft.fftfreq(64, 1.0 / 64) / PERIOD
    rho = np.sum(orders * np.exp(-4.0 * (math.pi * SINE_WINDOW.sigma_um * away) ** 2), axis=-1)
    return reference.gain(lights, views)[:, None] * rho @ weights


def test_pitches_beyond_the_nyquist_limit_cause_a_warning():
    lights, views = methods.in_plane(64, 1.9)
    exact = sine_colour(lights, views)
    arguments = {"to_light": lights, "to_view": views, "coherence": SINE_WINDOW, "tolerance": TOLERANCE}
    # Without aliasing, the pitch may be at most 0.1 µm. A period of 1.6 µm therefore needs 16 samples. With 12 samples,
    # aliasing must cause a warning.
    for samples in (80, 20, 16):
        xyz = wd.reflectance(wd.gratings.sinusoidal(PERIOD, DEPTH, samples=samples), **arguments)
        assert methods.colour_error(xyz, exact) <= TOLERANCE
    for samples in (12, 6):
        coarse = wd.gratings.sinusoidal(PERIOD, DEPTH, samples=samples)
        # The colours must equal those of a reference computation with the same coarse height samples, because aliasing
        # causes the same errors in both.
        on_samples = reference.reference_reflectance(coarse, lights, views, SINE_WINDOW)
        with pytest.warns(wd.WarpdiffWarning, match=rf"a pitch of {PERIOD / samples:.3g} µm supports") as caught:
            xyz = wd.reflectance(coarse, **arguments)
        assert len(caught) == 1
        assert methods.colour_error(xyz, on_samples) <= TOLERANCE
        assert methods.colour_error(xyz, exact) > TOLERANCE
        # The warning recommends to resample the field to a smaller pitch. The resampled field must have accurate
        # colours.
        xyz = wd.reflectance(coarse.resampled(0.04), **arguments)
        assert methods.colour_error(xyz, exact) <= TOLERANCE


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("seed", [0, 1, 4])
def test_a_window_between_samples_close_to_the_nyquist_limit_is_accurate_or_refused(seed, side):
    """Close to the Nyquist limit, results for a window between height samples must be accurate, warn, or be refused.

    Close to the limit, a direction requires Fourier coefficients beyond the limit, which are copies of coefficients
    below it. For a coherence window centred between height samples, the copies have wrong phases.
    """
    heightfield = wd.HeightField(np.random.default_rng(seed).uniform(-0.15, 0.15, (1, 12)), 0.1353)
    window = wd.Coherence("centred", 1.0, centre_um=(0.0, side * 0.4 * heightfield.size_um[1]))
    arguments = heightfield, [0.0, 0.0, 1.0], [side * 0.345, 0.0, 0.9386], 102.0
    exact = wd.spectral_reflectance(*arguments, coherence=window, method="direct")
    rho, message = methods.outcome(wd.spectral_reflectance, *arguments, coherence=window, tolerance=1e-3)
    assert message or rho[0] == pytest.approx(exact[0], rel=1e-3)


# Tests of replicated patches near a resonance, where periods interfere constructively. There the published form of the
# sum over periods (Single 2014, eq. 3.47) is a quotient of two small differences, which loses all digits. The quotient
# of sines sin²(πNt)/(N sin πt)² also loses all digits in float32 if its arguments are large.


@pytest.mark.parametrize("periods", [10, 1000, 5000])
@pytest.mark.parametrize("away", [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 0.0])
def test_replicated_periods_near_resonance_are_accurate(periods, away):
    heightfield, wavelength = methods.finger_rows(6.4, pitch_um=0.08), np.array([0.5])
    coherence = wd.Coherence("replicas", periods=(1, periods))
    lights, views = methods.near_resonance(heightfield, away, 0.5)
    power = direct_sum.window_power(heightfield, coherence, -(lights + views), wavelength)
    patch = direct_sum.window_power(
        heightfield, wd.Coherence("replicas", periods=(1, 1)), -(lights + views), wavelength
    )
    rho = wd.spectral_reflectance(heightfield, lights, views, 500.0, coherence=coherence, tolerance=1e-5)
    exact = reference.gain(lights, views)[:, None] * power
    assert methods.spectral_error(rho, exact) <= 1e-5
    turns = -(lights + views)[:, :1] / 0.5 * heightfield.size_um[1]
    single, double, plain = (
        methods.spectral_error(form(turns, periods, dtype) * patch, power)
        for form, dtype in (
            (methods.published_replicas, np.float32),
            (methods.published_replicas, np.float64),
            (methods.plain_replicas, np.float32),
        )
    )
    if away <= 1e-4:
        assert single > 1.0
    if away <= 1e-9:
        assert not double < 0.1
    if periods >= 1000 and away <= 1e-6:
        assert plain > 0.1


def test_the_published_form_of_replicated_periods_fails_in_float32():
    """The published sum over periods must fail in float32: this is the reason why the library uses another form.

    At a phase of 1e-3 radians per period its error must exceed 2 %; at 1e-4 radians it is not finite.
    """
    for periods in (10, 100, 1000):
        exact, single = (
            methods.published_replicas(np.array([1e-3, 1e-4]) / (2.0 * np.pi), periods, dtype)
            for dtype in (np.float64, np.float32)
        )
        angle = np.array([1e-3, 1e-4]) / 2.0
        closed = (np.sin(periods * angle) / (periods * np.sin(angle))) ** 2
        np.testing.assert_allclose(exact, closed, rtol=1e-4)
        assert abs(single[0] / closed[0] - 1.0) > 0.02
        assert not math.isfinite(single[1])


def test_seven_orders_do_not_suffice_for_a_patch():
    """A sum of only seven diffraction orders must have an error of more than 5 %.

    This is the reason why the library adds more orders. Between the orders of a patch, the spectrum converges slowly
    with the number of orders.
    """
    heightfield, one_copy = methods.finger_rows(6.4, pitch_um=0.08), wd.Coherence("replicas", periods=(1, 1))
    scattering_vectors = np.array(
        [[turns * 0.5 / heightfield.size_um[1], 0.0, -1.6] for turns in (1.5, 2.4, 3.5, 5.45, 7.5)]
    )
    exact = direct_sum.window_power(heightfield, one_copy, scattering_vectors, np.array([0.5]))[:, 0]
    every, seven = (
        np.array(
            [
                methods.nearest_orders_power(heightfield, scattering_vector, 0.5, neighbour_extent)
                for scattering_vector in scattering_vectors
            ]
        )
        for neighbour_extent in (heightfield.shape[1] // 2 - 1, 3)
    )
    assert np.abs(seven / exact - 1.0).max() > 0.05
    assert np.abs(seven / exact - 1.0).max() > 10.0 * np.abs(every / exact - 1.0).max()


def test_too_many_periods_are_refused_with_the_remedy():
    lights, views = methods.in_plane(4, 1.8)
    with pytest.raises(ValueError, match=r"periods=\(1, 100000\) of .*wavelengths.*fewer periods"):
        wd.reflectance(
            methods.finger_rows(25.6), lights, views, coherence=wd.Coherence("replicas", periods=(1, 100_000))
        )
