"""The peaks of periodic gratings are at the angles of the grating equation, sin θi + sin θr = mλ/d.

H_r0 is the Fourier coefficient of order r along x of exp(2πiκh), with the heights h and κ = w/λ.
"""

import math

import numpy as np
import pytest
from conftest import at_angle, slow

import warpdiff as wd

# Gratings with their period along x [µm]. None means that the whole field is one period.
GRATINGS = {
    "sinusoidal": (lambda: wd.gratings.sinusoidal(2.0, 0.3), 2.0),
    "lamellar": (lambda: wd.gratings.lamellar(1.2, 0.15), 1.2),
    "blazed": (lambda: wd.gratings.blazed(2.5, 0.25), 2.5), "CD": (lambda: wd.gratings.disc("CD"), 1.6),
    "DVD": (lambda: wd.gratings.disc("DVD"), 0.74), "Blu-ray": (lambda: wd.gratings.disc("Blu-ray"), 0.32),
    "bumps": (wd.gratings.bumps, None),
}  # fmt: skip
INCIDENCES_DEG = (0.0, 20.0, 45.0, 60.0, 75.0)
WAVELENGTHS_UM = (0.40, 0.50, 0.60, 0.70)


def efficiency(heightfield, order_index, kappa):
    """Return |H_r0|², computed by NumPy's Fourier transform."""
    return abs(np.fft.ifft(np.exp(2j * np.pi * kappa * heightfield.heights_um).mean(axis=0))[order_index]) ** 2


@pytest.mark.parametrize("name", ["sinusoidal", "lamellar", "blazed", "CD", slow("DVD"), "Blu-ray", "bumps"])
def test_peaks_are_at_the_angles_of_the_grating_equation(name):
    make, period = GRATINGS[name]
    heightfield = make()
    if period is None:
        period = heightfield.size_um[1]
    plan = wd.plan(heightfield, tolerance=1e-3, masking=False)
    away = np.arange(-0.4, 0.41, 0.02)
    checked = 0
    for wavelength in WAVELENGTHS_UM:
        peaks = []
        for theta_i in INCIDENCES_DEG:
            for order in (-3, -2, -1, 1, 2, 3):
                sine = order * wavelength / period - math.sin(math.radians(theta_i))
                if abs(sine) > math.sin(math.radians(70.0)):
                    continue
                expected = math.degrees(math.asin(sine))
                w = -math.cos(math.radians(theta_i)) - math.cos(math.radians(expected))
                if efficiency(heightfield, -order * round(heightfield.size_um[1] / period), w / wavelength) >= 1e-2:
                    peaks.append((theta_i, order, expected))
        if not peaks:
            continue
        lights, _, expected = np.array(peaks).T
        views = expected[:, None] + away
        rho = wd.spectral_reflectance(
            heightfield, at_angle(np.repeat(lights, len(away))), at_angle(views.ravel()), 1e3 * wavelength,
            masking=False, plan=plan,
        ).reshape(views.shape)  # fmt: skip
        for each, theta, (theta_i, order, angle) in zip(rho, views, peaks, strict=True):
            top = int(np.argmax(each))
            assert 0 < top < len(theta) - 1, (theta_i, wavelength, order)
            left, middle, right = each[top - 1 : top + 2]
            peak = theta[top] + 0.02 * (left - right) / (2.0 * (left - 2.0 * middle + right))
            assert abs(peak - angle) <= 0.05, (theta_i, wavelength, order, peak - angle)
            checked += 1
    assert checked >= 4
