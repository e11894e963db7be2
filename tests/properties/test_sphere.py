"""No direction on the sphere gives NaN, infinity or a negative value, for any method and any coherence model."""

import itertools
import math

import numpy as np
import pytest
from conftest import slow

import warpdiff as wd
from bench.truth.numpy_methods import best_effort

COHERENCES = {
    "averaged": wd.Coherence(), "averaged, short": wd.Coherence(sigma_um=0.3),
    "averaged, long": wd.Coherence(sigma_um=1000.0), "centred": wd.Coherence("centred", 2.0),
    "source": wd.Coherence("source"), "source, wide": wd.Coherence("source", angular_diameter_deg=30.0),
    "one copy": wd.Coherence("replicas", periods=(1, 1)), "periods": wd.Coherence("replicas", periods=(3, 5000)),
}  # fmt: skip
METHODS = ("auto", "low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred")
CASES = [
    (name, method)
    for name, method in itertools.product(("averaged", "centred", "source", "periods"), METHODS)
    if method != "power" or COHERENCES[name].adds_powers
] + [(name, "auto") for name in ("averaged, short", "averaged, long", "source, wide", "one copy")]
# Elevations in degrees from zenith to nadir, with values very close to the horizon.
ELEVATIONS_DEG = [90.0, 89.999, 60.0, 30.0, 5.0, 0.1, 1e-3, 1e-4, 1e-7, 0.0, -1e-7, -1e-3, -0.1, -45.0, -90.0]


def sphere():
    """Return unit vectors over the whole sphere. Coordinate axes are exact."""
    exact = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0.6, 0, 0.8), (0, -0.6, 0.8)]
    rings = [
        (math.cos(e) * math.cos(phi), math.cos(e) * math.sin(phi), math.sin(e))
        for e in np.radians(ELEVATIONS_DEG)
        for phi in (0.0, 2.5)
    ]
    return np.array(exact + rings)


def pairs():
    """Return all pairs (light, view) of the unit vectors of ``sphere``, and pairs of opposite and mirrored vectors."""
    one = sphere()
    lights, views = (np.array(each) for each in zip(*itertools.product(one, one), strict=True))
    return np.concatenate([lights, one, one]), np.concatenate([views, -one, one * [-1.0, -1.0, 1.0]])


@pytest.fixture(scope="module")
def rough():
    return wd.gratings.fingers(size_um=3.2, pitch_um=0.09, seed=3)


def check(values, lights, views):
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
    above = (lights[:, 2] > 0.0) & (views[:, 2] > 0.0)
    assert np.all(values[~above] == 0.0)
    assert values[above].max() > 0.0


@pytest.mark.parametrize(
    ("name", "method"), [case if case[1] in ("auto", "low-rank", "taylor") else slow(*case) for case in CASES]
)
def test_spectra_are_finite_and_not_negative_over_the_sphere(rough, name, method):
    lights, views = pairs()
    rho = best_effort(
        wd.spectral_reflectance, rough, lights, views, [380.0, 555.0, 780.0], coherence=COHERENCES[name], method=method
    )
    assert rho.shape == (len(lights), 3)
    check(rho, lights, views)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["averaged, short", "averaged, long", "centred", "source", "periods"])
@pytest.mark.parametrize("nanometres", [100.0, 10_000.0])
def test_the_brdf_at_extreme_wavelengths_is_finite_and_not_negative(rough, name, nanometres):
    lights, views = pairs()
    values = best_effort(wd.brdf, rough, lights, views, nanometres, coherence=COHERENCES[name])
    check(values, lights, views)


@pytest.mark.parametrize(
    ("name", "method"),
    [("averaged", "taylor-uncentred"), ("periods", "taylor"), *((name, "auto") for name in COHERENCES)],
)
def test_colours_are_finite_and_not_negative_over_the_sphere(rough, name, method):
    lights, views = pairs()
    few = slice(None, None, 11)
    # Directions near the horizon are excluded, because a light source of finite size there requires thousands of
    # wavelengths per direction.
    if COHERENCES[name].kind == "source":
        up = np.abs(lights[:, 2]) > 0.08
        lights, views = lights[up], views[up]
    coherence = wd.Coherence("replicas", periods=(2, 50)) if name == "periods" else COHERENCES[name]
    xyz = best_effort(wd.reflectance, rough, lights[few], views[few], coherence=coherence, method=method)
    assert xyz.shape == (len(lights[few]), 3)
    check(xyz, lights[few], views[few])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method"),
    [("averaged", "taylor"), ("averaged", "taylor-uncentred"), ("averaged", "jacobi-anger"), ("averaged", "power")]
    + [(name, "auto") for name in COHERENCES],
)
def test_spectra_of_a_deep_surface_are_finite_and_not_negative(name, method):
    """For a deep surface, all methods must give finite and not negative values.

    At the height range of 5 µm, float32 overflows in Taylor series. The library uses these series only if ``method``
    selects them.
    """
    heightfield = wd.HeightField.of_known_scale(np.random.default_rng(4).uniform(-5.0, 0.0, (12, 10)), 0.09)
    lights, views = (each[::3] for each in pairs())
    rho = best_effort(
        wd.spectral_reflectance, heightfield, lights, views, [380.0, 780.0], coherence=COHERENCES[name], method=method
    )
    check(rho, lights, views)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 2)])
@pytest.mark.parametrize("name", ["averaged", "centred", "source", "periods"])
def test_spectra_of_small_patches_are_finite_and_not_negative(shape, name, rng):
    heightfield = wd.HeightField(rng.uniform(-0.1, 0.1, shape), 0.09)
    lights, views = pairs()
    rho = best_effort(wd.spectral_reflectance, heightfield, lights, views, [380.0, 780.0], coherence=COHERENCES[name])
    check(rho, lights, views)


def test_maps_under_grazing_light_are_finite_and_not_negative(rough):
    for light in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.02], [0.6, 0.6, 1e-4]):
        image = best_effort(wd.reflectance_map, rough, light, size=33)
        assert np.isfinite(image.xyz).all()
        assert image.xyz.min() >= 0.0


@pytest.mark.parametrize("name", [name for name, each in COHERENCES.items() if each.kind != "source"])
def test_the_brdf_is_reciprocal_over_the_sphere(rough, name):
    lights, views = pairs()
    lights, views = lights[::5], views[::5]
    there, back = (
        best_effort(wd.brdf, rough, *pair, [450.0, 650.0], coherence=COHERENCES[name], tolerance=1e-4)
        for pair in ((lights, views), (views, lights))
    )
    np.testing.assert_allclose(there, back, rtol=1e-3, atol=1e-6 * there.max())
