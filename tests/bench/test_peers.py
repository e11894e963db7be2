"""Peers, the other programs in the benchmarks, must be correct, or comparisons with them would be meaningless.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. λ is the wavelength.
"""

import numpy as np
import pytest
from conftest import hemisphere, relative_errors

import warpdiff as wd
from bench.peers import drjit_peer, numpy_peer, raycasters, stam_analytic
from bench.truth import reference
from warpdiff import meshes
from warpdiff.optics import colorimetry, reflectance_factors

SERIES = {"numpy": numpy_peer, "drjit": drjit_peer}
FINE = {"wavelengths": 544, "terms": 16, "neighbour_extent": 1, "rounded": True, "centred": True}


def runs(peer):
    """Return a peer (another program in the benchmarks), or skip the test if the peer cannot run on this machine."""
    if reason := peer.available():
        pytest.skip(reason)
    return peer


def called(heightfield, lights, views, coherence):
    """Return scattering vectors, geometry factors (gains) and reference colours for n lights and n view directions."""
    gains = reflectance_factors.gain(lights, views, normal=reflectance_factors.normal_reflectance(1.5), masking=True)
    return -lights - views, gains, reference.reference_reflectance(heightfield, lights, views, coherence)


@pytest.mark.parametrize("kind", ["averaged", "centred"])
@pytest.mark.parametrize("name", SERIES)
def test_the_published_algorithm_converges_to_the_reference(name, kind, rng):
    heightfield, window = wd.gratings.fingers(size_um=12.8, pitch_um=0.08), wd.Coherence(kind)
    shade = runs(SERIES[name]).prepare(heightfield, window, **FINE)
    scattering_vectors, gains, exact = called(heightfield, hemisphere(rng, 40), hemisphere(rng, 40), window)
    for threads in (1, 2):
        assert np.percentile(relative_errors(shade(scattering_vectors, gains, threads), exact), 95.0) < 1e-3


@pytest.mark.parametrize("name", SERIES)
def test_rounding_finds_the_nearest_coefficient_and_floor_does_not(name, rng):
    # If the coherence window is much larger than the patch, the Fourier coefficient nearest to (u, v)/λ contributes
    # nearly all of the power. Here the peers use only one coefficient. They must find its index by rounding, not by
    # floor().
    heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.08)
    scattering_vectors, gains, exact = called(heightfield, hemisphere(rng, 40), hemisphere(rng, 40), wd.Coherence())
    errors = []
    for rounded in (True, False):
        setting = FINE | {"neighbour_extent": 0, "rounded": rounded}
        xyz = runs(SERIES[name]).prepare(heightfield, wd.Coherence(), **setting)(scattering_vectors, gains, 2)
        errors.append(np.median(np.linalg.norm(xyz - exact, axis=1) / np.linalg.norm(exact, axis=1)))
    assert errors[0] < 1e-2
    assert errors[1] > 0.1


def test_dr_jit_and_numpy_compute_the_same_at_the_published_setting(rng):
    heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.08)
    scattering_vectors, gains = -hemisphere(rng, 600) - hemisphere(rng, 600), rng.uniform(0.5, 2.0, 600)
    made = [runs(peer).prepare(heightfield, wd.Coherence(), **peer.PUBLISHED) for peer in SERIES.values()]
    first, second = (shade(scattering_vectors, gains, 2) for shade in made)
    np.testing.assert_allclose(first, second, atol=1e-4 * np.percentile(first, 99.0), rtol=1e-3)


def test_lines_of_a_grating_have_the_colours_of_the_reference():
    # In each direction, a regular grating reflects only narrow spectral lines, one per order. They are 7 nm wide in the
    # first order. The tested peer, an analytic model, treats them as infinitely narrow.
    heightfield, period = wd.gratings.lamellar(1.6, 0.126, duty=0.3), 1.6
    shade = runs(stam_analytic).prepare(heightfield, wd.Coherence(), colours="cie")
    angle = np.radians(np.linspace(-80.0, 80.0, 161))
    views = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    # Every second light is moved out of the plane of incidence by half the angular width of an order. This tests how
    # colours depend on v, the component of the scattering vector along the grooves.
    aside = 0.004 * (np.arange(161) % 2)
    lights = np.stack([np.full(161, 0.3), aside, np.sqrt(1.0 - 0.09 - aside**2)], axis=1)
    scattering_vectors, gains, exact = called(heightfield, lights, views, wd.Coherence())
    lines = period * np.abs(scattering_vectors[:, :1]) / np.arange(1, 8)
    clear = np.any((lines > 0.44) & (lines < 0.64), axis=1)
    mirror = np.abs(scattering_vectors[:, 0]) < 0.01
    assert np.count_nonzero(clear) > 40
    assert np.count_nonzero(mirror) >= 2
    away = np.linalg.norm(shade(scattering_vectors, gains, 1) - exact, axis=1)
    for where, most in ((clear, 4e-2), (mirror, 5e-2)):
        assert np.max(away[where] / np.linalg.norm(exact[where], axis=1)) < most
    assert np.median(away[clear] / np.linalg.norm(exact[clear], axis=1)) < 1e-2


def test_the_rainbow_follows_the_published_chapter():
    heightfield = wd.gratings.disc("CD", length_um=12.8)
    assert stam_analytic.grating_um(heightfield) == pytest.approx(1.6)
    shade = runs(stam_analytic).prepare(heightfield, wd.Coherence(), colours="rainbow")
    # u is the component of the scattering vector across the grooves. For the u of this test, the analytic model
    # reflects the wavelengths 0.75 µm and 0.375 µm. The model has no true colours: as published, its rainbow is
    # greenest at 0.75 µm, and black at 0.375 µm.
    scattering_vectors = np.array([[0.75 / 1.6, v, -1.5] for v in (0.0, 0.4)])
    red, green, blue = colorimetry.xyz_to_rgb(shade(scattering_vectors, np.ones(2), 1)).T
    assert np.all(green > 0.0)
    np.testing.assert_allclose(green[0], green[1], rtol=1e-6)
    np.testing.assert_allclose([red, blue], 0.0, atol=1e-5 * green[0])


@pytest.mark.parametrize("peer", [numpy_peer, drjit_peer, stam_analytic], ids=lambda peer: peer.__name__)
def test_other_coherences_are_refused(peer):
    with pytest.raises(ValueError, match="coherence must be"):
        runs(peer).prepare(wd.gratings.fingers(), wd.Coherence("source"), **peer.SETTINGS[0])


def test_too_coarse_a_height_field_is_refused():
    with pytest.raises(ValueError, match="heightfield must be finer"):
        numpy_peer.prepare(wd.gratings.fingers(pitch_um=0.13), wd.Coherence(), **FINE)


def test_all_casters_find_the_hits_of_brute_force():
    view = wd.View((0.4, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=48, height=36)
    rays = raycasters.rays_of(meshes.tube(segments_along=40, segments_around=24), view)
    exact, sure = raycasters.truth(rays, np.arange(48 * 36))
    assert np.count_nonzero(exact.hit & sure) > 100
    for name, caster in raycasters.casters(rays).items():
        for threads in (1, 2):
            caster.trace(threads)
            hits = caster.hits()
            np.testing.assert_array_equal(hits.hit[sure], exact.hit[sure], err_msg=name)
            both = sure & exact.hit
            cosine = np.abs(np.einsum("ij,ij->i", hits.normal[both], exact.normal[both]))
            np.testing.assert_allclose(cosine, 1.0, atol=1e-6, err_msg=name)
