"""Series expansions of exp(2πiκh) in float32: height ranges at which each series fails, and the messages that report
the failure.

κ is w/λ, the normal component w of the scattering vector divided by the wavelength.
"""

import itertools

import numpy as np
import pytest

import warpdiff as wd
from bench.truth import numpy_methods as methods
from bench.truth import reference
from warpdiff.diffraction import phase_series
from warpdiff.diffraction.phase_series import EXPANSIONS

SIGMA = 2.0
WINDOW = wd.Coherence(sigma_um=SIGMA)
WAVELENGTHS_UM = np.array([0.4, 0.45, 0.55, 0.65, 0.75])
HEIGHTS_UM = [0.05, 0.3, 1.0, 2.5, 5.0]


class Surface:
    """Synthetic snake skin (finger-like bumps) of a given height range, and its exact spectra in random directions."""

    def __init__(self, height):
        flat = wd.gratings.fingers(size_um=6.4, pitch_um=0.08, seed=3)
        self.heightfield = wd.HeightField.of_known_scale(
            flat.heights_um * (height / flat.height_range_um), flat.pitch_um
        )
        self.lights, self.views = methods.hemisphere_pairs(48)
        self.exact = reference.reference_spectral(self.heightfield, self.lights, self.views, WAVELENGTHS_UM, WINDOW)
        self.arguments = self.heightfield, self.lights, self.views, 1e3 * WAVELENGTHS_UM

    def error_of(self, rho):
        return methods.spectral_error(rho, self.exact)

    def library(self, method, tolerance=1e-5):
        call = wd.spectral_reflectance
        return self.error_of(
            methods.best_effort(call, *self.arguments, coherence=WINDOW, method=method, tolerance=tolerance)
        )

    def series(self, method, dtype, terms=None):
        terms = terms or methods.most_terms(self.heightfield, method, 2.0 / WAVELENGTHS_UM.min())
        return self.error_of(methods.series_reflectance(
            self.heightfield, self.lights, self.views, WAVELENGTHS_UM, sigma=SIGMA, method=method, terms=terms,
            dtype=dtype,
        ))  # fmt: skip


@pytest.fixture(scope="module")
def surfaces():
    return {height: Surface(height) for height in [*HEIGHTS_UM, 1.6]}


def in_float32(method, height_range_um, terms=None):
    """Return the largest error of a series of exp(2πiκh) that is evaluated in float32, and the number of its terms.

    The error is the maximum over samples of κ and of heights h up to ``height_range_um``.
    """
    series = EXPANSIONS[method]
    h = np.linspace(0.0, height_range_um, 2001)
    g = h / height_range_um
    g = 2.0 * g - 1.0 if series.centred else g
    kappa = np.float32(-2.0 / 0.38) * np.linspace(0.05, 1.0, 37, dtype=np.float32)
    x = 2.0 * np.pi * kappa.astype(np.float64) * height_range_um * (0.5 if series.centred else 1.0)
    terms = terms or series.term_count(float(np.abs(x).max()), 1e-6)
    basis = series.basis(x, terms).astype(np.float32)
    polynomials = np.stack(list(itertools.islice(series.polynomials(g), terms))).astype(np.float32)
    even, odd = np.arange(0, terms, 2), np.arange(1, terms, 2)
    sign_even, sign_odd = ((-1.0) ** (even // 2)).astype(np.float32), ((-1.0) ** (odd // 2)).astype(np.float32)
    real = (basis[:, even] * sign_even) @ polynomials[even]
    imaginary = (basis[:, odd] * sign_odd) @ polynomials[odd]
    assert real.dtype == np.float32
    return np.abs(real + 1j * imaginary - np.exp(1j * x[:, None] * g)).max(), terms


@pytest.mark.parametrize("height_range_um", [0.05, 0.3, 1.0, 2.0, 5.0])
def test_jacobi_anger_is_stable_in_float32(height_range_um):
    error, terms = in_float32("jacobi-anger", height_range_um)
    assert error <= 1e-5
    assert terms < phase_series.MAX_TERMS


def test_taylor_series_of_high_surfaces_fail_in_float32():
    """At a height range of 1 µm, no number of terms may make Taylor series accurate in float32.

    The least error over all tested numbers of terms must exceed 1 for the uncentred series, and 0.01 for the centred
    series. These errors are the reason for the use of another series.
    """
    assert in_float32("taylor-uncentred", 0.15)[0] < 1e-5
    assert min(in_float32("taylor-uncentred", 1.0, terms)[0] for terms in (25, 37, 60, 90, 128)) > 1.0
    assert in_float32("taylor", 0.3)[0] < 1e-5
    assert 1e-2 < min(in_float32("taylor", 1.0, terms)[0] for terms in (40, 60, 90, 128)) < 1.0


@pytest.mark.parametrize("height", HEIGHTS_UM)
def test_automatic_plans_meet_the_tolerance_for_all_height_ranges(surfaces, height):
    surface = surfaces[height]
    for tolerance in (1e-2, 1e-3):
        rho = wd.spectral_reflectance(*surface.arguments, coherence=WINDOW, tolerance=tolerance)
        assert surface.error_of(rho) <= tolerance


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.05, 1.0, 5.0])
@pytest.mark.parametrize("method", ["jacobi-anger", "power", "low-rank"])
def test_series_of_bounded_functions_are_accurate_at_all_heights(surfaces, method, height):
    assert surfaces[height].library(method) <= 5e-5
    assert surfaces[height].series(method, np.float64) <= 1e-8


@pytest.mark.parametrize(
    ("method", "fair", "broken", "double"),
    [("taylor-uncentred", 0.3, 1.0, 2.5), ("taylor", 0.3, 1.6, 5.0)],
)
def test_taylor_series_fail_above_a_height_range(surfaces, method, fair, broken, double):
    """At a height range where a Taylor series fails in float32, it must still be accurate in float64.

    In float64 it must fail at a height range that is 2.5 to 3 times larger.
    """
    assert surfaces[fair].library(method) <= 1e-4
    assert surfaces[broken].library(method) > 1.0
    assert surfaces[broken].series(method, np.float64) <= 1e-4
    assert surfaces[double].series(method, np.float64) > 1.0


def test_the_published_number_of_terms_fails_at_1_um(surfaces):
    assert surfaces[0.3].series("taylor-uncentred", np.float32, methods.PUBLISHED_TERMS) <= 1e-4
    for dtype in (np.float32, np.float64):
        assert surfaces[1.0].series("taylor-uncentred", dtype, methods.PUBLISHED_TERMS) > 1.0


@pytest.mark.parametrize(("method", "height"), [("taylor-uncentred", 1.0), ("taylor", 1.6)])
def test_a_series_that_fails_is_refused_or_reported(surfaces, method, height):
    arguments = surfaces[height].arguments
    for call in (wd.spectral_reflectance, lambda *a, **k: wd.reflectance(*a[:3], **k)):
        with pytest.raises(ValueError, match=r"Taylor series cannot meet tolerance=0\.01: (float32|\d+ terms).*strict"):
            call(*arguments, coherence=WINDOW, method=method)
        with pytest.warns(wd.WarpdiffWarning, match=r"Taylor series cannot meet.*height range") as caught:
            values = call(*arguments, coherence=WINDOW, method=method, strict=False)
        assert sum("scalar diffraction" not in str(one.message) for one in caught) == 1
        assert np.isfinite(values).all()
        assert values.min() >= 0.0
