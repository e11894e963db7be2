"""Bounds: calls too small for a search meet their tolerance; each of these broke it once."""

import math
import warnings

import numpy as np
import pytest
from conftest import hemisphere

import warpdiff as wd
from bench.truth import judge, reference


def ratio(heightfield, lights, views, tolerance, **options):
    """The error over the tolerance."""
    with warnings.catch_warnings():
        # Of the model, which serves no such surface.
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        assert not wd.plan(heightfield, lights, views, tolerance=tolerance, **options).is_measured
    xyz = wd.reflectance(heightfield, lights, views, tolerance=tolerance, **options)
    coherence, illuminant = options.get("coherence", wd.Coherence()), options.get("illuminant", "D65")
    exact = reference.reference_reflectance(
        heightfield, lights, views, coherence, tolerance=0.1 * min(tolerance, 1e-3), illuminant=illuminant
    )
    return judge.figure(xyz, exact).value / tolerance


def line_grating(levels, period_um):
    """Heights [µm] along x, one period."""
    return wd.HeightField.of_known_scale(np.asarray(levels)[None], (1.0, period_um / len(levels)))


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
def test_third_orders_of_a_shallow_sine(rng, tolerance):
    """Their powers grow as κ⁶, and grazing views see the low end of κ: in float32 powers err by themselves."""
    heightfield = line_grating(0.05 * np.cos(2.0 * np.pi * np.arange(32) / 32), 1.5)
    x, z = -rng.uniform(0.45, 0.65, 98), rng.uniform(0.05, 0.1, 98)
    lights = np.stack([x, np.sqrt(1.0 - x * x - z * z), z], axis=1)
    lights, views = np.repeat(lights, 2, axis=0)[:100], np.repeat(lights * [1.0, -1.0, 1.0], 2, axis=0)[:100]
    # Two dark ones that widen the range of κ.
    lights[-2:], views[-2:] = [0.076, 0.064, 0.995], [-0.345, 0.588, 0.732]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    assert ratio(heightfield, lights, views, tolerance) <= 0.5


@pytest.mark.parametrize(("height_um", "illuminant"), [(3.0, "HP2"), (5.5, "FL12")])
def test_two_tall_levels_in_the_mirror_direction(rng, height_um, illuminant):
    """Spectra oscillate as the height, under lines."""
    heightfield = line_grating(np.repeat([height_um, 0.0], 32), 4.0)
    lights = hemisphere(rng, 40, 0.95)
    assert ratio(heightfield, lights, lights * [-1.0, -1.0, 1.0], 1e-4, illuminant=illuminant) <= 0.5


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2])
def test_the_haze_about_a_sun(rng, tolerance):
    """All that is seen is the tail of the mirror's lobe, a millionth of it and less."""
    source = wd.Coherence("source")
    away, turn = rng.uniform(5.2, 7.2, 120) * source.spread, rng.uniform(0.0, 2.0 * math.pi, 120)
    views = np.stack([away * np.cos(turn), away * np.sin(turn), np.sqrt(1.0 - away**2)], axis=1)
    lights = np.broadcast_to([0.0, 0.0, 1.0], views.shape)
    assert ratio(wd.HeightField(np.zeros((8, 8)), 0.1), lights, views, tolerance, coherence=source) <= 0.5


@pytest.mark.parametrize("illuminant", ["FL11", "HP1"])
def test_maps_under_lines(illuminant):
    """Orders pass between lines of the illuminant."""
    heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.08, seed=4)
    rng = np.random.default_rng(3)
    lights = np.broadcast_to([0.0, 0.0, 1.0], (200, 3))
    assert ratio(heightfield, lights, hemisphere(rng, 200, 0.3), 1e-4, illuminant=illuminant) <= 0.5
