"""The direct sum equals an explicit average over the positions of the coherence window; kernels equal the direct sum.

(u, v, w) is the scattering vector. Its component w is along the normal.
"""

import functools

import numpy as np
import pytest
from conftest import coherence_of, hemisphere, relative_errors, slow

import warpdiff as wd
from warpdiff.diffraction import direct_sum, fourier_coefficients

WAVELENGTHS_UM = np.array([0.39, 0.46, 0.53, 0.61, 0.7, 0.77])


def windowed_sum(heightfield, sigma_um, scattering_vector, wavelength, centre):
    """Return |Σ g e^{ik(wh + ux + vy)} / Σ g|² for a Gaussian coherence window g at ``centre``, (y, x) in µm.

    The sum covers all samples of the repeated patch within 8σ of the centre.
    """
    u, v, w = scattering_vector
    (ny, nx), (dy, dx), (length_y, length_x) = heightfield.shape, heightfield.pitch_um, heightfield.size_um
    copies_y, copies_x = (int(np.ceil(8.0 * sigma_um / length)) + 1 for length in heightfield.size_um)
    h = np.tile(heightfield.heights_um, (2 * copies_y + 1, 2 * copies_x + 1))
    y = ((np.arange(h.shape[0]) - copies_y * ny) * dy)[:, None]
    x = ((np.arange(h.shape[1]) - copies_x * nx) * dx)[None, :]
    assert length_y > 0
    assert length_x > 0
    g = np.exp(-((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / (2.0 * sigma_um**2))
    phase = 2.0 * np.pi / wavelength * (w * h + u * x + v * y)
    return abs(np.sum(g * np.exp(1j * phase)) / g.sum()) ** 2


@pytest.fixture
def small(rng):
    """Return a rough patch of 1.2 × 1.1 µm with unequal sides and pitches."""
    return wd.HeightField(rng.uniform(0.0, 0.25, (12, 10)), (0.1, 0.11))


def test_the_averaged_power_is_the_mean_over_all_window_positions(small, rng):
    sigma = 0.6
    lights, views = hemisphere(rng, 4), hemisphere(rng, 4)
    for scattering_vector in -(lights + views):
        mean = np.mean(
            [
                windowed_sum(small, sigma, scattering_vector, 0.5, (j * 0.1, i * 0.11))
                for j in range(small.shape[0])
                for i in range(small.shape[1])
            ]
        )
        value = direct_sum.window_power(
            small, wd.Coherence("averaged", sigma), scattering_vector[None], np.array([0.5])
        )
        assert value[0, 0] == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("centre", [None, (0.0, 0.0), (0.337, -0.82)])
def test_the_centred_power_is_that_of_one_window(small, rng, centre):
    sigma = 0.6
    place = (6 * 0.1, 5 * 0.11) if centre is None else centre
    lights, views = hemisphere(rng, 6), hemisphere(rng, 6)
    for scattering_vector in -(lights + views):
        expected = windowed_sum(small, sigma, scattering_vector, 0.6, place)
        coherence = wd.Coherence("centred", sigma, centre_um=centre)
        value = direct_sum.window_power(small, coherence, scattering_vector[None], np.array([0.6]))
        assert value[0, 0] == pytest.approx(expected, rel=1e-9)


FORMS = {
    "averaged": wd.Coherence("averaged"), "centred": wd.Coherence("centred"),
    "sun": wd.Coherence("source", angular_diameter_deg=0.53), "lamp": wd.Coherence("source", angular_diameter_deg=3.0),
    "one-copy": wd.Coherence("replicas", periods=(1, 1)), "12-copies": wd.Coherence("replicas", periods=(3, 4)),
    "200-copies": wd.Coherence("replicas", periods=(1, 200)),
}  # fmt: skip
METHODS = ("low-rank", "power", "jacobi-anger", "taylor")
# Tested pairs of coherence and method. The method "power" is only available if the powers of Fourier coefficients add:
# for an averaged coherence window and for a source.
PAIRS = [
    pytest.param(coherence, method, id=f"{name}-{method}")
    for name, coherence in FORMS.items()
    for method in METHODS
    if coherence.adds_powers or method != "power"
]


@functools.cache
def exact_spectra(heightfield, coherence, count, *, in_plane=False):
    """Return random directions to light and viewer, and their spectra by the direct sum.

    Results are cached, because the tests of all methods use them.
    """
    rng = np.random.default_rng(20140)
    lights, views = hemisphere(rng, count), hemisphere(rng, count)
    # A quarter of the directions is near the mirror direction, where the reflectance is largest.
    views[::4] = views[::4] * 0.03 + lights[::4] * np.array([-1.0, -1.0, 1.0])
    if in_plane:
        # Surfaces that are constant along y reflect only within the plane of incidence. Every second view is therefore
        # moved into this plane.
        views[1::2, 1] = -lights[1::2, 1]
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    options = {"coherence": coherence, "masking": False, "method": "direct"}
    return lights, views, wd.spectral_reflectance(heightfield, lights, views, 1e3 * WAVELENGTHS_UM, **options)


def agreement(heightfield, coherence, count, method, device, *, in_plane=False):
    """Return the largest error of spectra by ``method`` for random directions, divided by the allowed error.

    Errors are differences from the direct sum. The allowed error of the spectrum of a direction is 1e-4 of its largest
    value. For dark spectra it is 1e-8 of the largest value of all spectra, if this is larger.
    """
    lights, views, exact = exact_spectra(heightfield, coherence, count, in_plane=in_plane)
    # The plan (numbers of wavelengths and terms) is made for the three directions with the largest |(u, v)|, the least
    # |w| and the largest |w|. For so few directions it is an upper-bound plan, whose terms suffice for all directions
    # of this test.
    uv, w = np.hypot(*(lights + views)[:, :2].T), (lights + views)[:, 2]
    ends = [uv.argmax(), w.argmin(), w.argmax()]
    options = {"coherence": coherence, "method": method}
    plan = wd.plan(heightfield, lights[ends], views[ends], tolerance=1e-4, **options)
    assert not plan.is_measured
    result = wd.spectral_reflectance(
        heightfield, lights, views, 1e3 * WAVELENGTHS_UM, plan=plan, masking=False, device=device
    )
    bar = 1e-4 * np.maximum(exact.max(axis=1, keepdims=True), 1e-4 * exact.max())
    return float(np.max(np.abs(result - exact) / bar))


@pytest.fixture(scope="module")
def scan_crops(scan):
    """Return a large crop of a measured surface for coherence windows, a small one for "source" and "replicas".

    The small crop saves time, because direct sums for these two kinds are slow.
    """
    return scan.cropped(9.0), scan.cropped(6.25)


@pytest.fixture(scope="module")
def fingers():
    """Return a large and a small patch of synthetic snake skin (finger-like bumps).

    The large one is for coherence windows, the small one for the kinds "source" and "replicas".
    """
    return tuple(wd.gratings.fingers(size_um=size, seed=1) for size in (8.0, 6.4))


@pytest.fixture(scope="module")
def row():
    """Return a grating with one row of height samples; it is constant along y."""
    return wd.gratings.blazed(2.5, 0.25)


@pytest.mark.parametrize(("coherence", "method"), PAIRS)
def test_kernel_equals_direct_sum_on_the_scan(scan_crops, coherence, method, device):
    heightfield, count = (scan_crops[0], 40) if coherence.sigma_um else (scan_crops[1], 24)
    assert agreement(heightfield, coherence, count, method, device) <= 1.0


@pytest.mark.parametrize(("coherence", "method"), PAIRS)
def test_kernel_equals_direct_sum_on_fingers(fingers, coherence, method, device):
    heightfield = fingers[0 if coherence.sigma_um else 1]
    assert agreement(heightfield, coherence, 24, method, device) <= 1.0


@pytest.mark.parametrize(("coherence", "method"), PAIRS)
def test_kernel_equals_direct_sum_on_one_row(row, coherence, method, device):
    assert row.shape[0] == 1
    assert agreement(row, coherence, 64, method, device, in_plane=True) <= 1.0


@pytest.mark.parametrize("kind", ["averaged", "centred"])
@pytest.mark.parametrize("sigma_um", [0.8, 3.0])
def test_neighbourhoods_larger_than_the_spectrum_of_the_patch_are_accurate(kind, sigma_um, rng):
    """For a short coherence window, more Fourier coefficients contribute to a direction than the patch has.

    Look-ups must then repeat the coefficients periodically.
    """
    heightfield = wd.HeightField(rng.uniform(0.0, 0.1, (24, 40)), (0.09, 0.07))
    lights, views = hemisphere(rng, 16), hemisphere(rng, 16)
    options = {"coherence": wd.Coherence(kind, sigma_um), "tolerance": 1e-4}
    exact = wd.spectral_reflectance(heightfield, lights, views, [420.0, 650.0], method="direct", **options)
    result = wd.spectral_reflectance(heightfield, lights, views, [420.0, 650.0], **options)
    np.testing.assert_allclose(result, exact, rtol=1e-3, atol=1e-4 * np.percentile(exact, 99.0))


def test_kernel_equals_direct_sum_for_moved_windows(rng):
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.08, seed=5)
    lights, views = hemisphere(rng, 12), hemisphere(rng, 12)
    for centre in ((0.0, 0.0), (1.7, 4.2)):
        coherence = wd.Coherence("centred", 2.0, centre_um=centre)
        options = {"coherence": coherence, "tolerance": 1e-4}
        exact = wd.spectral_reflectance(heightfield, lights, views, 550.0, method="direct", **options)
        result = wd.spectral_reflectance(heightfield, lights, views, 550.0, **options)
        np.testing.assert_allclose(result, exact, rtol=2e-3, atol=1e-4 * exact.max())


# By kind of coherence: the coherence, the patch size in µm and the number of directions. Patches and numbers of
# directions are small, because the direct sum requires thousands of wavelengths if diffraction orders are narrow. A
# source near the horizon requires the largest number of wavelengths.
COLOURED = {
    "averaged": (wd.Coherence("averaged", 5.0), 4.5, 10),
    "centred": (wd.Coherence("centred", 5.0), 6.4, 16),
    "source": (wd.Coherence("source", angular_diameter_deg=3.0), (3.06, 1.8), 8),
    "replicas": (wd.Coherence("replicas", periods=(2, 3)), (3.06, 1.8), 14),
}


@pytest.mark.parametrize("kind", ["averaged", slow("centred"), "source", "replicas"])
def test_colours_meet_the_tolerance(kind, rng):
    """The 99th percentile of the colour errors in the tested directions must be within the tolerance of the call."""
    coherence, size_um, count = COLOURED[kind]
    heightfield = wd.gratings.fingers(size_um=size_um, pitch_um=0.09, seed=2)
    lowest = 0.2 if kind == "source" else 0.05
    lights, views = hemisphere(rng, count, lowest), hemisphere(rng, count, lowest)
    exact = wd.reflectance(heightfield, lights, views, coherence=coherence, method="direct", tolerance=1e-3)
    for tolerance in (1e-1, 1e-2, 1e-3):
        result = wd.reflectance(heightfield, lights, views, coherence=coherence, tolerance=tolerance)
        assert np.percentile(relative_errors(result, exact), 99.0) <= tolerance


def test_the_direct_method_does_not_use_the_series(monkeypatch):
    """The direct sum must work without series of exp(2πiκh), because it validates the methods that use them."""
    monkeypatch.setattr(fourier_coefficients, "series_coefficients", None)
    heightfield = wd.HeightField(np.zeros((4, 4)), 0.05)
    value = wd.spectral_reflectance(heightfield, (0, 0, 1), (0, 0, 1), 550.0, method="direct")
    assert value.dtype == np.float64
    assert value[0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("kind", ["averaged", "centred", "source", "replicas"])
def test_colours_stay_the_same_if_x_and_y_are_exchanged(kind, row, rng):
    """A row of samples must have the same colours as a column of them, if light and viewer are exchanged likewise."""
    coherence = coherence_of(kind, sigma_um=5.0)
    turned = coherence_of(kind, sigma_um=5.0, periods=(3, 2))
    column = wd.HeightField(row.heights_um.T, row.pitch_um[::-1])
    lights, views = hemisphere(rng, 6, 0.3), hemisphere(rng, 6, 0.3)
    options = {"method": "direct", "tolerance": 1e-2}
    expected = wd.reflectance(row, lights, views, coherence=coherence, **options)
    exchanged = lights[:, [1, 0, 2]], views[:, [1, 0, 2]]
    result = wd.reflectance(column, *exchanged, coherence=turned, **options)
    np.testing.assert_allclose(result, expected, rtol=1e-8, atol=1e-12)
    assert np.ptp(expected[:, 1]) > 0.0
