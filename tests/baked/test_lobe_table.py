"""Baked lobes and spectra, compared with closed forms, the float64 reference and the original height fields.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. σ is the standard deviation of the coherence window.
"""

import dataclasses
import math

import numpy as np
import pytest
from conftest import hemisphere
from scipy.special import jv

import warpdiff as wd
from bench.truth import reference
from warpdiff.baked import interpolation, quantisation
from warpdiff.optics import colorimetry, reflectance_factors

WINDOW, WIDE = wd.Coherence(sigma_um=2.0), wd.Coherence(sigma_um=1.5)
TOLERANCE = 2.0


@pytest.fixture(scope="module")
def lobes(fingers):
    return wd.bake(fingers, coherence=WINDOW, delta_e=TOLERANCE)


@pytest.fixture(scope="module")
def spectrum(fingers):
    return wd.bake_spectrum(fingers, coherence=WIDE, size=512, tolerance=1e-2)


@pytest.fixture(scope="module")
def small_spectrum(fingers):
    """Return a baked spectrum (table of diffracted powers) with so few cells that file tests are fast."""
    return wd.bake_spectrum(fingers, coherence=WIDE, size=64, tolerance=0.1)


def test_colours_are_within_the_requested_difference(fingers, lobes):
    """Baked lobes are a table of colours. Its colours must differ from the reference by at most the requested ΔE2000.

    The reference is computed in float64. The 200 compared directions have not been used by baking. Half of them are
    drawn with probabilities in proportion to their luminance, so that bright directions are included.
    """
    rng = np.random.default_rng(91)
    lights, views = hemisphere(rng, 20_000), hemisphere(rng, 20_000)
    luminance = lobes.reflectance(lights, views)[:, 1].astype(float)
    places = np.concatenate([np.arange(100), rng.choice(20_000, 100, replace=False, p=luminance / luminance.sum())])
    lights, views = lights[places], views[places]
    gains = reflectance_factors.gain(lights, views, normal=reflectance_factors.normal_reflectance(1.5), masking=True)
    exact = gains[:, None] * reference.colours(fingers, -lights - views, lights, WINDOW, tolerance=1e-3)
    exposed = (0.2 / np.maximum(exact[:, 1], 1e-3 * np.percentile(exact[:, 1], 99.0)))[:, None]
    differences = colorimetry.colour_difference(exposed * lobes.reflectance(lights, views), exposed * exact)
    assert np.percentile(differences, 99.0) <= TOLERANCE
    assert np.median(differences) <= 0.25 * TOLERANCE
    assert 0.0 < lobes.error <= TOLERANCE


def test_an_illuminant_is_part_of_the_colours_and_of_the_file(fingers, tmp_path):
    incandescent = wd.Spectrum.blackbody(2856.0)
    baked = wd.bake(fingers, coherence=WIDE, illuminant=incandescent, delta_e=4.0)
    loaded = wd.BakedLobes.load(baked.save(tmp_path / "lobes.npz"))
    assert (loaded.illuminant, str(loaded.illuminant)) == (incandescent, "black body of 2856 K")
    rng = np.random.default_rng(95)
    lights, views = hemisphere(rng, 150), hemisphere(rng, 150)
    exact = wd.reflectance(fingers, lights, views, coherence=WIDE, illuminant=incandescent).astype(float)
    exposed = 0.2 / exact[:, 1:2]
    differences = colorimetry.colour_difference(exposed * loaded.reflectance(lights, views), exposed * exact)
    assert np.median(differences) <= 1.0


def test_a_material_is_part_of_the_colours_and_of_the_file(tmp_path):
    """Baked colours of gold must equal the float64 reference.

    The reference computes reflectances from characteristic matrices, and shares no code with the library.
    """
    gold = wd.Material.metal("Au")
    small = wd.gratings.fingers(size_um=6.4, seed=4)
    baked = wd.bake(small, coherence=WIDE, material=gold, delta_e=3.0)
    rng = np.random.default_rng(92)
    lights, views = hemisphere(rng, 90), hemisphere(rng, 90)
    # In every tenth pair of directions to light and viewer, the view is the mirror direction, where the zeroth order
    # dominates.
    views[::10] = lights[::10] * [-1.0, -1.0, 1.0]
    exact = reference.reference_reflectance(small, lights, views, WIDE, tolerance=1e-3, material=gold)
    exposed = (0.2 / np.maximum(exact[:, 1], 1e-3 * np.percentile(exact[:, 1], 90.0)))[:, None]
    differences = colorimetry.colour_difference(exposed * baked.reflectance(lights, views), exposed * exact)
    assert np.percentile(differences, 98.0) <= 3.0
    loaded = wd.BakedLobes.load(baked.save(tmp_path / "gold.npz"))
    np.testing.assert_array_equal(loaded.reflectance(lights, views), baked.reflectance(lights, views))
    assert "with a material" in str(loaded)
    with pytest.raises(ValueError, match="ior must be None for lobes that were baked with a material"):
        baked.reflectance(lights, views, ior=1.5)
    with pytest.raises(ValueError, match=r"material must be opaque, got n = 1\.5"):
        wd.bake(small, coherence=WINDOW, material=wd.Material.dielectric(1.5))


def test_a_flat_mirror_equals_its_closed_form():
    flat = wd.HeightField(np.zeros((8, 8)), 0.09)
    baked = wd.bake(flat, coherence=WINDOW)
    # The views are around the mirror direction, because a flat mirror is dark elsewhere.
    views = np.array([math.sin(0.3), 0.0, math.cos(0.3)]) + np.random.default_rng(5).normal(0.0, 0.03, (200, 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    light = np.array([[-math.sin(0.3), 0.0, math.cos(0.3)]])
    wavelengths = np.arange(380.0, 781.0)
    q2 = np.sum((light + views)[:, :2] ** 2, axis=1)[:, None] / (1e-3 * wavelengths) ** 2
    colours = np.exp(-((2.0 * math.pi * WINDOW.sigma_um) ** 2) * q2) @ colorimetry.colour_products("D65")
    gains = reflectance_factors.gain(np.broadcast_to(light, views.shape), views, normal=0.04, masking=True)
    exact = gains[:, None] * colours
    np.testing.assert_allclose(baked.reflectance(light, views), exact, rtol=2e-3, atol=1e-4 * exact.max())


def test_a_smaller_delta_e_needs_more_bytes(fingers, lobes):
    rough = wd.bake(fingers, coherence=WINDOW, delta_e=8.0)
    assert rough.error <= 8.0
    assert rough.bytes < lobes.bytes


def test_lobes_of_a_source_are_baked_for_normal_incidence():
    bumps = wd.gratings.bumps(height_um=0.1, width_um=0.4, length_um=0.6, spacing_um=(1.0, 0.75))
    sun = wd.Coherence("source", angular_diameter_deg=12.0)
    baked = wd.bake(bumps, coherence=sun, delta_e=10.0)
    views = hemisphere(np.random.default_rng(7), 150)
    above = np.array([0.0, 0.0, 1.0])
    exact = wd.reflectance(bumps, above, views, coherence=sun, method="low-rank", tolerance=3e-3)
    exposed = (0.2 / np.maximum(exact[:, 1], 1e-3 * np.percentile(exact[:, 1], 99.0)))[:, None]
    differences = colorimetry.colour_difference(exposed * baked.reflectance(above, views), exposed * exact)
    assert np.percentile(differences, 95.0) <= 10.0


def test_a_cartesian_grid_has_the_same_values(lobes):
    grid = lobes.cartesian(256)
    assert grid.shape == (256, 256, 3, lobes.functions.shape[1])
    row, column = 140, 77
    uv = np.array([[column + 0.5, row + 0.5]]) / 128.0 * 2.0 - 2.0
    w = 1.1
    at_w = lobes.functions[round(w / 2.0 * (len(lobes.functions) - 1))]
    w = round(w / 2.0 * (len(lobes.functions) - 1)) / (len(lobes.functions) - 1) * 2.0
    expected = lobes.colours([[*uv[0], -w]], zeroth_order=False)[0]
    np.testing.assert_allclose(np.maximum(w * w * grid[row, column] @ at_w, 0.0), expected, rtol=1e-4)
    assert not grid[0, 0].any(), "outside the disc there is nothing"


def test_a_baked_spectrum_equals_the_reflectance_of_directions(fingers, spectrum):
    rng = np.random.default_rng(17)
    lights, views = hemisphere(rng, 400, lowest=0.2), hemisphere(rng, 400, lowest=0.2)
    wavelength = 520.0
    exact = wd.spectral_reflectance(fingers, lights, views, wavelength, coherence=WIDE, ior=math.inf, masking=False)
    uvw = -(lights + views) / (wavelength * 1e-3)
    size = len(spectrum.powers)
    place = (uvw[:, :2] / spectrum.largest_q + 1.0) * size / 2.0 - 0.5
    cell = np.floor(place).astype(int)
    t = place - cell
    kappas = np.linspace(spectrum.least_kappa, spectrum.largest_kappa, len(spectrum.functions))
    at_kappa = [np.interp(-uvw[:, 2], kappas, function) for function in spectrum.functions.T]
    power = np.zeros(len(uvw))
    for i in (0, 1):
        for j in (0, 1):
            weight = (t[:, 0] if i else 1.0 - t[:, 0]) * (t[:, 1] if j else 1.0 - t[:, 1])
            power += weight * np.einsum("nk,kn->n", spectrum.powers[cell[:, 1] + j, cell[:, 0] + i], np.array(at_kappa))
    lobe = np.exp(-((2.0 * math.pi * WIDE.sigma_um) ** 2) * np.sum(uvw[:, :2] ** 2, axis=1))
    power += np.interp(-uvw[:, 2], kappas, spectrum.zeroth) * lobe
    gains = reflectance_factors.gain(lights, views, normal=1.0, masking=False)
    relative = np.abs(gains * power - exact[:, 0]) / np.maximum(exact[:, 0], 1e-2 * np.percentile(exact, 99.0))
    # Baking averages the spectrum over cells as wide as a quarter of the standard deviation of a diffraction order
    # (lobe). This blurs the spectrum, so errors of up to 5 % are allowed.
    assert np.percentile(relative, 90.0) < 0.05
    assert np.sum(gains * power) == pytest.approx(np.sum(exact), rel=0.02)


def test_the_powers_of_a_sine_add_up_to_squared_bessel_functions():
    """Order m of a sine grating has the power J_m², with Bessel functions J_m. The baked spectrum must contain it.

    The sum over all cells of the spectrum is multiplied by 4πσ², because the integral of the lobe of an order is
    1/(4πσ²), where σ is the standard deviation of the coherence window. The baked cells exclude the zeroth order.
    """
    sine = wd.gratings.sinusoidal(2.0, 0.2)
    baked = wd.bake_spectrum(sine, coherence=WINDOW, size=256, tolerance=1e-3)
    kappas = np.linspace(baked.least_kappa, baked.largest_kappa, len(baked.functions))
    orders = np.arange(-10, 11)
    inside = (np.abs(orders / 2.0) < baked.largest_q) & (orders != 0)
    for kappa in (1.0, 3.0):
        functions = np.array([np.interp(kappa, kappas, f) for f in baked.functions.T])
        # A grating of one row has only the order 0 along y, so that the sum over all cells is the sum over the orders
        # along x.
        cell = (2.0 * baked.largest_q / 256) ** 2
        total = 4.0 * math.pi * WINDOW.sigma_um**2 * float((baked.powers @ functions).sum()) * cell
        argument = 2.0 * math.pi * kappa * 0.1
        assert total == pytest.approx(float(np.sum(jv(orders[inside], argument) ** 2)), rel=2e-3)
        assert np.interp(kappa, kappas, baked.zeroth) == pytest.approx(float(jv(0, argument) ** 2), abs=1e-4)


@pytest.mark.parametrize("name", ["lobes", "small_spectrum"])
def test_files_restore_all_fields(name, request, tmp_path):
    baked = request.getfixturevalue(name)
    path = baked.save(tmp_path / "a.npz")
    loaded = type(baked).load(path)
    for field in dataclasses.fields(baked):
        one, other = getattr(baked, field.name), getattr(loaded, field.name)
        assert np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other, field.name
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["lobes", "small_spectrum"])
def test_files_without_baked_lobes_are_refused(name, request, tmp_path):
    baked = request.getfixturevalue(name)
    whole = baked.save(tmp_path / "a.npz").read_bytes()
    rng = np.random.default_rng(3)
    damaged = [whole[: len(whole) // 2], b"", b"PK\x03\x04", rng.bytes(500)]
    for _ in range(12):
        changed = bytearray(whole)
        for at in rng.integers(0, len(whole), 40):
            changed[at] ^= 255
        damaged.append(bytes(changed))
    path = tmp_path / "b.npz"
    for data in damaged:
        path.write_bytes(data)
        with pytest.raises(ValueError, match="path must be a file"):
            type(baked).load(path)
    other = {"lobes": wd.BakedSpectrum, "small_spectrum": wd.BakedLobes}[name]
    with pytest.raises(ValueError, match="format is 'warpdiff baked"):
        other.load(tmp_path / "a.npz")
    with pytest.raises(FileNotFoundError):
        type(baked).load(tmp_path / "none.npz")


def test_files_with_other_arrays_are_refused(lobes, tmp_path):
    path = lobes.save(tmp_path / "a.npz")
    with np.load(path) as archive:
        arrays = dict(archive)
    changes = {
        "mantissas": arrays["mantissas"][:-1], "exponents": arrays["exponents"].astype(np.int64),
        "functions": np.full_like(arrays["functions"], np.nan), "rays": np.array([16, -5]), "rings": 0,
        "illuminant": "none", "scale": -1.0, "zeroth": np.zeros(0, np.float32),
    }  # fmt: skip
    for name, value in changes.items():
        np.savez(path, **(arrays | {name: value}))
        with pytest.raises(ValueError, match=r"path must be a file that BakedLobes\.save wrote"):
            wd.BakedLobes.load(path)


def test_quantisation_errors_are_at_most_half_a_step():
    rng = np.random.default_rng(2)
    values = (rng.normal(size=(500, 3, 4)) * 10.0 ** rng.uniform(-7.0, 0.0, (500, 1, 1))).astype(np.float32)
    largest = np.abs(values).max(axis=2, keepdims=True)
    for dtype in (np.int8, np.int16):
        decoded = quantisation.dequantise(*quantisation.quantise(values, dtype))
        assert np.all(np.abs(decoded - values) <= 0.5 / np.iinfo(dtype).max * 1.1 * largest)


def test_a_polar_grid_interpolates_lobes_of_its_design_width():
    """Interpolation on a polar grid of (u, v) must reproduce peaks (lobes) of the width for which the grid is made.

    The error may be at most 0.02 of the peak of a lobe. Along the radius, the width of the test lobes is a tenth of
    |(u, v)|. Lobes of orders in colour tables are at least this wide along the radius, because they contain a range of
    wavelengths.
    """
    width = 0.02
    grid = interpolation.grid_for(width, 16, 1.0)
    angles, radii = np.array([0.3, 2.0, 4.4]), np.array([1.1, 0.5, 1.7])

    def lobes_at(uv):
        away = np.arctan2(uv[:, 1], uv[:, 0])[:, None] - angles
        away = (away + math.pi) % (2.0 * math.pi) - math.pi
        size = np.hypot(*uv.T)[:, None]
        return np.exp(-0.5 * (away * size / width) ** 2 - 0.5 * (np.log(size / radii) / 0.1) ** 2).astype(np.float32)

    coefficients = interpolation.spline_coefficients(grid, lobes_at(grid.places()))
    uv = np.random.default_rng(1).uniform(-1.4, 1.4, (20_000, 2))
    assert np.abs(interpolation.interpolated(grid, coefficients, uv) - lobes_at(uv)).max() < 0.02


def test_unsupported_arguments_of_bake_are_refused():
    sine = wd.gratings.sinusoidal(2.0, 0.1)
    with pytest.raises(ValueError, match="coherence must be of kind 'averaged'"):
        wd.bake_spectrum(sine, coherence=wd.Coherence("source"))
    with pytest.raises(
        ValueError, match=r"coherence must be shorter to be baked: .* σ = 1000 µm requires [0-9,]+ wave"
    ):
        wd.bake(sine, coherence=wd.Coherence(sigma_um=1000.0))
