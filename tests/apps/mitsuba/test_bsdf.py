"""The BSDF plug-in for Mitsuba 3: compared with ``wd.brdf`` and order efficiencies, and tested by Mitsuba.

Mitsuba's own chi-square test compares the sampled directions with the sampling density. ``make test-mitsuba`` installs
the requirements. Mitsuba's compiled variants (``llvm_…``) need LLVM 17 or newer, because older versions crash.
"""

import glob
import os
import re

import numpy as np
import pytest
from conftest import hemisphere

import warpdiff as wd


def _llvm():
    """Return the path of an LLVM library of version 17 or newer, or None."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    result = [named] if named else glob.glob("/usr/lib/*/libLLVM*.so*")  # noqa: PTH207
    versions = {path: max(map(int, re.findall(r"\d+", os.path.basename(path))), default=0) for path in result}  # noqa: PTH119
    new = {path: version for path, version in versions.items() if version >= 17}
    return named or max(new, key=new.get, default=None)


LLVM = _llvm()
if LLVM:
    os.environ["DRJIT_LIBLLVM_PATH"] = LLVM

mi = pytest.importorskip("mitsuba", reason="pip install 'warpdiff[mitsuba]'")
import drjit as dr  # noqa: E402

pytestmark = pytest.mark.mitsuba
WINDOW = wd.Coherence(sigma_um=3.0)
SUN = wd.Coherence("source", angular_diameter_deg=2.0)
LIGHT = np.array([0.3, 0.1, 0.9]) / np.linalg.norm([0.3, 0.1, 0.9])
WAVELENGTHS = [450.0, 530.0, 600.0, 680.0]
needs_llvm = pytest.mark.skipif(not LLVM, reason="no LLVM of 17 or newer: name one in DRJIT_LIBLLVM_PATH")


@pytest.fixture(scope="module")
def spectrum_file(fingers, tmp_path_factory):
    return wd.bake_spectrum(fingers, coherence=WINDOW, size=1024).save(
        tmp_path_factory.mktemp("baked") / "spectrum.npz"
    )


@pytest.fixture(scope="module")
def lobes_file(fingers, tmp_path_factory):
    baked = wd.bake(fingers, coherence=SUN, delta_e=4.0)
    return baked.save(tmp_path_factory.mktemp("baked") / "lobes.npz")


def bsdf_of(path, variant, **options):
    mi.set_variant(variant)
    wd.register_mitsuba_bsdf()
    return mi.load_dict({"type": "warpdiff", "filename": str(path), **options})


def interaction(count=None, to_light=LIGHT):
    """Return Mitsuba's record of one surface hit, or of ``count`` hits, with the direction to the light.

    In spectral variants, the record has the four ``WAVELENGTHS``.
    """
    si = mi.SurfaceInteraction3f() if count is None else dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(*map(float, to_light))
    if mi.is_spectral:
        si.wavelengths = mi.Spectrum(*WAVELENGTHS)
    return si


def test_a_spectrum_is_evaluated_as_the_absolute_brdf(fingers, spectrum_file):
    bsdf = bsdf_of(spectrum_file, "scalar_spectral", masking=False)
    views = hemisphere(np.random.default_rng(3), 60, lowest=0.1)
    # A third of the 60 view directions are near the mirror direction, where the BRDF is largest.
    views[:20] = LIGHT * [-1.0, -1.0, 1.0] + np.random.default_rng(4).normal(0.0, 0.02, (20, 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    exact = wd.brdf(fingers, LIGHT, views, WAVELENGTHS, coherence=WINDOW, tolerance=3e-3) * views[:, 2:]
    context, si = mi.BSDFContext(), interaction()
    result = np.array([np.array(bsdf.eval(context, si, mi.Vector3f(*map(float, each)))) for each in views])
    relative = np.abs(result - exact) / np.maximum(exact, 1e-2 * np.percentile(exact, 90.0))
    # The baked spectrum is blurred, because its cells are as wide as a quarter of the standard deviation of a
    # diffraction order (lobe). Errors of 5 % are therefore allowed.
    assert np.percentile(relative, 95.0) < 0.05


def test_sample_weights_are_values_divided_by_densities(spectrum_file):
    bsdf = bsdf_of(spectrum_file, "scalar_spectral")
    rng, context, si, drawn = np.random.default_rng(6), mi.BSDFContext(), interaction(), 0
    for _ in range(60):
        sample, weight = bsdf.sample(context, si, float(rng.uniform()), mi.Point2f(*map(float, rng.uniform(size=2))))
        if sample.pdf > 0.0:
            drawn += 1
            value, density = bsdf.eval_pdf(context, si, sample.wo)
            assert density == pytest.approx(sample.pdf, rel=1e-4)
            np.testing.assert_allclose(np.array(weight), np.array(value) / density, rtol=1e-3, atol=1e-7)
    assert drawn > 20


def test_values_below_the_horizon_are_zero(spectrum_file):
    bsdf = bsdf_of(spectrum_file, "scalar_spectral")
    below = mi.Vector3f(0.1, 0.2, -0.9)
    assert not np.any(np.array(bsdf.eval(mi.BSDFContext(), interaction(), below)))
    assert bsdf.pdf(mi.BSDFContext(), interaction(to_light=[0.1, 0.1, -0.9]), mi.Vector3f(*map(float, LIGHT))) == 0.0


def test_colours_equal_those_of_baked_lobes(lobes_file):
    bsdf = bsdf_of(lobes_file, "scalar_rgb", ior=1.5)
    views = hemisphere(np.random.default_rng(8), 200, lowest=0.1)
    baked = wd.BakedLobes.load(lobes_file)
    solid_angle = 2.0 * np.pi * SUN.spread**2
    exact = baked.reflectance(LIGHT, views) * 0.04 / (solid_angle * LIGHT[2])
    to_rgb = np.array(
        [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
    )
    exact = exact @ to_rgb.T * views[:, 2:]
    result = np.array(
        [np.array(bsdf.eval(mi.BSDFContext(), interaction(), mi.Vector3f(*map(float, v)))) for v in views]
    )
    size = np.linalg.norm(exact, axis=1)
    relative = np.linalg.norm(result - exact, axis=1) / np.maximum(size, 1e-2 * np.percentile(size, 95.0))
    assert np.median(relative) < 0.02
    assert np.percentile(relative, 90.0) < 0.1


def chi_square(bsdf):
    """Run Mitsuba's chi-square test of ``sample`` against ``pdf``, with cells of directions smaller than the orders."""

    def sample(numbers):
        count = dr.width(numbers)
        result, _ = bsdf.sample(mi.BSDFContext(), interaction(count), numbers.x, mi.Point2f(numbers.y, numbers.z))
        return result.wo, dr.select(result.pdf > 0.0, 1.0, 0.0)

    test = mi.chi2.ChiSquareTest(
        domain=mi.chi2.SphericalDomain(), sample_func=sample,
        pdf_func=lambda wo: bsdf.pdf(mi.BSDFContext(), interaction(dr.width(wo)), wo), sample_dim=3,
        sample_count=1_000_000, res=201, ires=48,
    )  # fmt: skip
    return test.run(0.01, 1), test.p_value


@needs_llvm
@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_rgb"])
def test_samples_follow_their_density(variant, request, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = request.getfixturevalue("spectrum_file" if "spectral" in variant else "lobes_file")
    passed, probability = chi_square(bsdf_of(path, variant))
    assert passed, probability


@needs_llvm
@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_mean_sample_weights_equal_the_sum_of_order_efficiencies(fingers, spectrum_file, degrees):
    """The mean weight (BRDF · cos θo / density) of sampled directions must lie between two sums of order efficiencies.

    The larger sum contains all orders. The smaller sum excludes orders near the horizon, because the horizon cuts off a
    part of their light.
    """
    bsdf = bsdf_of(spectrum_file, "llvm_ad_spectral", masking=False)
    angle, count = np.radians(degrees), 1_000_000
    to_light = (float(np.sin(angle)), 0.0, float(np.cos(angle)))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    _, weights = bsdf.sample(mi.BSDFContext(), interaction(count, to_light), sampler.next_1d(), sampler.next_2d())
    weights = np.array(weights).reshape(4, count)
    result, noise = weights.mean(axis=1), weights.std(axis=1) / np.sqrt(count)
    orders = wd.order_efficiencies(fingers, to_light, WAVELENGTHS)
    # The lobe of an order is the narrow range of directions into which it reflects light. The smaller sum contains only
    # orders whose lobes are completely above the horizon. The efficiencies of the other orders are proportional to
    # 1/cos θr, which diverges at the horizon.
    clear = np.nan_to_num(orders.to_view[..., 2]) > 0.15
    least = (orders.efficiencies * clear).sum(axis=1)
    assert np.all(result > least - 4.0 * noise - 0.01 * least)
    assert np.all(result < orders.efficiencies.sum(axis=1) + 4.0 * noise + 0.02 * least)


def test_files_of_the_other_kind_are_refused(spectrum_file, lobes_file, fingers, tmp_path):
    with pytest.raises(Exception, match=r"path must be a file that BakedLobes\.save wrote"):
        bsdf_of(spectrum_file, "scalar_rgb")
    with pytest.raises(Exception, match=r"path must be a file that BakedSpectrum\.save wrote"):
        bsdf_of(lobes_file, "scalar_spectral")
    window = wd.bake(fingers, coherence=WINDOW, delta_e=8.0).save(tmp_path / "window.npz")
    with pytest.raises(Exception, match="solid angle changes with the wavelength"):
        bsdf_of(window, "scalar_rgb")


def test_variants_without_colours_are_refused():
    mi.set_variant("scalar_spectral_polarized")
    with pytest.raises(RuntimeError, match="without polarisation"):
        wd.register_mitsuba_bsdf()
