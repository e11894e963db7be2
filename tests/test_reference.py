"""The reference that judges pictures equals the direct sum, which judges points, in every regime."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from conftest import hemisphere

import warpdiff as wd

WAVELENGTHS_UM = np.array([0.381, 0.47, 0.56, 0.66, 0.779])
DIRECTIONS = 48  # times five wavelengths: more than 200 points of every regime


def rough():
    return wd.HeightField(np.random.default_rng(3).uniform(0.0, 0.5, (24, 20)), (0.09, 0.08))


REGIMES = {
    "sinusoidal": (lambda: wd.gratings.sinusoidal(1.6, 0.4), 16.25),
    "blazed": (lambda: wd.gratings.blazed(2.0, 0.3), 16.25),
    "flat": (lambda: wd.HeightField(np.zeros((6, 5)), 0.09), 16.25),
    "fingers": (lambda: wd.gratings.fingers(size_um=3.6, pitch_um=0.09, seed=4), 16.25),
    "fingers, short window": (lambda: wd.gratings.fingers(size_um=3.6, pitch_um=0.09, seed=4), 1.5),
    "rough": (rough, 16.25),
    "rough, short window": (rough, 0.8),
}


@pytest.mark.parametrize("kind", ["averaged", "centred"])
@pytest.mark.parametrize("name", REGIMES)
def test_spectra_equal_the_direct_sum(name, kind, rng):
    make, sigma = REGIMES[name]
    hf = make()
    lights, views = hemisphere(rng, DIRECTIONS), hemisphere(rng, DIRECTIONS)
    # A third near the mirror direction, a third near an order: random directions fall between sharp ones.
    third = DIRECTIONS // 3
    views[:third] = views[:third] * 0.01 + lights[:third] * np.array([-1.0, -1.0, 1.0])
    near = slice(third, 2 * third)
    order = rng.integers(-1, 2, (third, 2)) / np.array(hf.size_um[::-1]) * 0.56
    across = -lights[near, :2] - order
    across *= np.minimum(1.0, 0.95 / np.linalg.norm(across, axis=1, keepdims=True))
    views[near] = np.column_stack([across, np.sqrt(1.0 - np.sum(across**2, axis=1))])
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    exact = wd.spectral_reflectance(
        hf, lights, views, 1e3 * WAVELENGTHS_UM, method="direct", coherence=wd.Coherence(kind, sigma)
    )
    found = reference.reference_spectral(hf, lights, views, WAVELENGTHS_UM, kind, sigma)
    assert exact.size >= 200
    error = np.abs(found - exact) / np.maximum(exact, 1e-3 * np.percentile(exact, 99.0))
    assert error.max() <= 1e-6
    assert np.count_nonzero(exact > 1e-6 * exact.max()) > 20


@pytest.mark.parametrize("kind", ["averaged", "centred"])
def test_colours_equal_the_direct_sum(kind, rng):
    hf = wd.gratings.fingers(size_um=3.6, pitch_um=0.09, seed=4)
    lights, views = hemisphere(rng, 12), hemisphere(rng, 12)
    exact = wd.reflectance(hf, lights, views, method="direct", coherence=wd.Coherence(kind, 3.0), tolerance=1e-4)
    found = reference.reference_reflectance(hf, lights, views, kind, 3.0, tolerance=1e-4)
    np.testing.assert_allclose(found, exact, rtol=1e-4, atol=1e-7 * exact.max())


def test_a_moved_window(rng):
    hf = wd.gratings.fingers(size_um=3.6, pitch_um=0.09, seed=4)
    lights, views = hemisphere(rng, 8), hemisphere(rng, 8)
    coherence = wd.Coherence("centred", 2.0, centre_um=(0.7, 2.9))
    exact = wd.spectral_reflectance(hf, lights, views, [450.0, 700.0], method="direct", coherence=coherence)
    found = reference.reference_spectral(hf, lights, views, [0.45, 0.7], "centred", 2.0, centre=(0.7, 2.9))
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-9 * exact.max())


def test_white():
    flat = wd.HeightField(np.zeros((4, 4)), 0.05)
    up = np.array([[0.0, 0.0, 1.0]])
    white = reference.reference_reflectance(flat, up, up, tolerance=1e-6, ior=np.inf)[0]
    np.testing.assert_allclose(white, [0.950423, 1.0, 1.088610], atol=1e-6)
