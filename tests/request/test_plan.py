"""Plans: their numbers for a tolerance, their text, and their effect on results.

A plan has the numbers of a computation, such as wavelengths and terms of a series. It is made for a range of
directions. For few directions, its numbers are upper bounds, which suffice for any surface. For many directions, the
library searches smaller numbers by trials (tests on sampled directions).
"""

import dataclasses
import json
import math
import warnings

import numpy as np
import pytest
from conftest import at_angle, coherence_of, hemisphere, relative_errors, slow

import warpdiff as wd
from bench.truth import reference
from bench.truth.errors import FLOOR, reference_luminance
from warpdiff.diffraction import fourier_coefficients
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.optics import reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.tables import coefficient_table

UP = [0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def rough() -> wd.HeightField:
    """Return a small patch with structure along both axes, sampled finely enough for all directions."""
    return wd.gratings.fingers(size_um=6.4, seed=3)


def test_a_plan_covers_the_range_of_its_directions(rough, rng):
    # The range of directions of a plan does not depend on its method. Plans (numbers of computations) for the method
    # "direct" are tested, because they need no search and are made quickly.
    whole = wd.plan(rough, method="direct")
    assert (whole.max_uv, whole.max_w, whole.lambda_min_nm) == (2.0, 2.0, 380.0)

    light = at_angle(30.0)
    for half in (wd.plan(rough, light, method="direct"), wd.plan(rough, None, light, method="direct")):
        assert half.max_uv == pytest.approx(1.5)
        assert half.max_w == pytest.approx(1.0 + math.cos(math.radians(30.0)))

    both = wd.plan(rough, light, at_angle(-30.0))
    assert both.max_uv == pytest.approx(0.0, abs=1e-12)
    assert both.max_w == pytest.approx(2.0 * math.cos(math.radians(30.0)))

    lights, views = hemisphere(rng, 50), hemisphere(rng, 50)
    many = wd.plan(rough, lights, views)
    total = lights + views
    assert many.max_uv == pytest.approx(np.hypot(total[:, 0], total[:, 1]).max())
    assert many.max_w == pytest.approx(total[:, 2].max())


@pytest.mark.parametrize("below", [[0.0, 0.0, -1.0], [0.6, 0.0, -0.8]])
def test_directions_below_the_horizon_need_no_wavelengths(rough, below):
    assert wd.plan(rough, [UP, below], UP) == wd.plan(rough, UP, UP)
    with pytest.warns(wd.WarpdiffWarning, match=r"above the horizon \(z > 0\), so that all results are 0"):
        nothing = wd.plan(rough, below, UP)
    assert (nothing.max_uv, nothing.max_w) == (0.0, 0.0)


def test_a_plan_for_the_hemisphere_is_valid_for_any_direction(rough, rng):
    whole = wd.plan(rough, method="direct")
    for light, view in zip(hemisphere(rng, 20), hemisphere(rng, 20), strict=True):
        one, half = wd.plan(rough, light, view), wd.plan(rough, light, method="direct")
        for name in ("max_uv", "max_order_rate", "max_w"):
            assert getattr(one, name) <= getattr(half, name) <= getattr(whole, name)
        assert one.min_w >= half.min_w >= whole.min_w
        assert one.direction_range.joined(half.direction_range) == half.direction_range


@pytest.mark.parametrize("kind", ["averaged", "centred"])
def test_a_smaller_tolerance_never_reduces_the_numbers_of_a_plan(rough, kind):
    coherence = wd.Coherence(kind, 6.5)
    tolerances = (0.5, 0.1, 1e-2, 1e-3, 1e-4)
    for plans in (
        [wd.plan(rough, at_angle(20.0), at_angle(35.0), tolerance=t, coherence=coherence) for t in tolerances],
        # With many directions and large tolerances, the method "auto" would use tables of colours. Plans (numbers of
        # computations) with tables have other numbers than plans that sample wavelengths.
        [wd.plan(rough, tolerance=t, coherence=coherence, method="low-rank") for t in tolerances],
    ):
        for name in ("terms", "wavelengths", "multiply_adds"):
            values = [getattr(plan, name) for plan in plans]
            assert values == sorted(values)
            assert values[0] < values[-1]
        # If a search selects a plan (numbers of the computation), the errors of the plan are measured. They are not
        # compared, because the plan for the larger tolerance may by chance have the smaller error.
        names = ("least_weight",) if plans[0].is_measured else ("least_weight", "quadrature", "neighbourhood", "error")
        for name in names:
            values = [getattr(plan, name) for plan in plans]
            assert values == sorted(values, reverse=True)
        for plan in plans:
            assert plan.is_measured == (len(set(plan.direction_range.kappas)) > 1 and plan.min_w == 0.0)
            assert plan.error <= plan.tolerance


@pytest.mark.parametrize(
    "coherence",
    [wd.Coherence(sigma_um=4.0), wd.Coherence("centred", 4.0), slow(wd.Coherence("source", angular_diameter_deg=0.53)),
     slow(wd.Coherence("replicas", periods=(2, 3)))],
    ids=lambda each: each.kind,
)  # fmt: skip
def test_a_search_is_cheaper_than_bounds(rough, coherence, rng):
    """The plan of a search must cost less than an upper-bound plan, and must meet the tolerance.

    A plan has the numbers of a computation. An upper-bound plan suffices for any surface.

    The plan must also meet the tolerance on directions that the search has not tried. The error that the plan predicts
    must be at most ten times the measured error.
    """
    lights, views = hemisphere(rng, 40_000), hemisphere(rng, 40_000)
    few = wd.plan(rough, lights[:8], views[:8], coherence=coherence, method="low-rank")
    plan = wd.plan(rough, lights, views, coherence=coherence, method="low-rank")
    assert plan.is_measured
    assert not few.is_measured
    samples = dataclasses.replace(few, max_uv=plan.max_uv, max_order_rate=plan.max_order_rate)
    assert plan.multiply_adds < samples.multiply_adds
    # For replicated periods, the computation of exact colours requires 0.1 s per direction. Fewer directions are
    # therefore tested than for other kinds of coherence.
    apart = 650 if coherence.kind == "replicas" else 240
    for part in (slice(0, 39_000 // apart), slice(1000, 40_000, apart)):
        exact = reference.reference_reflectance(rough, lights[part], views[part], coherence, tolerance=1e-3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = wd.reflectance(rough, lights[part], views[part], plan=plan)
        floor = FLOOR * reference_luminance(exact[:, 1])
        error = np.linalg.norm(result - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor)
        assert np.percentile(error, 99.0) <= plan.tolerance
        bright = exact[:, 1] >= floor
        measured = max(np.percentile(error[some], 99.0) for some in (bright, ~bright))
        assert plan.error <= 10.0 * max(measured, 0.01 * plan.tolerance)


@pytest.mark.parametrize("kind", ["averaged", "centred", "source", "replicas"])
def test_the_plan_does_not_depend_on_threads(rough, kind):
    options = {"tolerance": 0.1, "coherence": coherence_of(kind, 4.0, periods=(2, 2))}
    assert wd.plan(rough, at_angle(40.0), threads=1, **options) == wd.plan(rough, at_angle(40.0), threads=2, **options)


def test_a_plan_reads_as_a_table(rough):
    plan = wd.plan(rough, at_angle(20.0), tolerance=3e-3, coherence=wd.Coherence(sigma_um=3.0), method="low-rank")
    text = str(plan)
    # The first line of the text of a plan (numbers of a computation) must say whether results can be trusted.
    assert text.splitlines()[0] == (
        f"The plan meets its tolerance of 0.003: predicted error {plan.error:.1e}, measured on {plan.validation_size} "
        "validation directions."
    )
    assert text.splitlines()[-1].startswith("  scalar diffraction  qualitative at 550 nm")
    for part in (
        "averaged window with σ = 3 µm",
        "Low-rank basis",
        f"|(u, v)| up to {plan.max_uv:.3g}",
        f"|w| {plan.min_w:.3g} to {plan.max_w:.3g}",
        f"{plan.terms} terms",
        f"those of weight {plan.least_weight:.1e} or more",
        f"{plan.wavelengths} wavelengths equally spaced in 1/λ (fewer for",
        f"truncation {plan.truncation:.1e}, neighbourhood {plan.neighbourhood:.1e}, quadrature",
        f"{plan.aliasing:.1e} of the power",
        f"{plan.multiply_adds:.2g} multiply-adds per direction, {plan.microseconds:.2g} µs on one core",
    ):
        assert part in text
    table = wd.plan(rough, at_angle(20.0), tolerance=1e-1, coherence=wd.Coherence(sigma_um=3.0))
    assert f"{table.rings_per_octave} rings per octave" in str(table)
    assert f"after {table.table_seconds:.2g} s for the table" in str(table)
    assert "typical of its bounds" in str(wd.plan(rough, UP, UP))
    assert "direct sum" in str(wd.plan(rough, method="direct"))
    assert "does not meet its tolerance" in str(dataclasses.replace(plan, truncation=1.0))
    assert "wavelengths equally" not in str(dataclasses.replace(plan, wavelengths=0))
    source = str(wd.plan(rough, at_angle(20.0), UP, coherence=wd.Coherence("source")))
    assert "source of 0.53° in diameter" in source
    assert "equally spaced in log λ" in source
    periods = str(wd.plan(rough, at_angle(20.0), UP, coherence=wd.Coherence("replicas", periods=(1, 200))))
    assert "1 × 200 periods" in periods
    assert "for the periods' factor" in periods
    assert "neighbours" not in periods


@pytest.mark.parametrize("kind", ["averaged", "replicas"])
def test_a_saved_plan_is_the_same_plan(rough, kind, tmp_path):
    coherence = wd.Coherence(kind, periods=(2, 3) if kind == "replicas" else None)
    plan = wd.plan(rough, at_angle(20.0), UP, coherence=coherence)
    assert wd.Plan.load(plan.save(tmp_path / "plan.json")) == plan


@pytest.mark.parametrize(
    ("change", "message"),
    [({"format": "another"}, "must be a plan"), ({"terms": 0}, "terms must be an integer, at least 1, got 0"),
     ({"coherence": 3}, "must be a plan"), ({"more": 1}, "must be a plan"),
     ({"coherence": [field.name for field in dataclasses.fields(wd.Coherence)]}, "must be a plan"),
     ({"adaptive": 1}, "adaptive must be True or False"), ({"method": "direct", "footprint": True}, "footprint=True")],
    ids=str,
)  # fmt: skip
def test_a_damaged_plan_is_refused(rough, change, message, tmp_path):
    path = wd.plan(rough, UP, UP).save(tmp_path / "plan.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ValueError, match=message):
        wd.Plan.load(path)
    for text in (path.read_text()[:-5], 100_000 * "["):
        with pytest.raises(ValueError, match="must be a plan"):
            wd.Plan.from_json(text)


@pytest.mark.parametrize("kind", ["averaged", "centred"])
def test_results_use_the_number_of_terms_of_the_plan(rough, kind):
    light, view, wavelength_um = at_angle(25.0), at_angle(-5.0), 0.5
    coherence = wd.Coherence(kind, 3.25)
    full = wd.plan(rough, light, view, coherence=coherence, method="jacobi-anger")
    plan = dataclasses.replace(full, terms=5)
    u, v, w = -(light + view)

    # The expected reflectance is computed in float64. Each Fourier coefficient is the series in κ = w/λ that the plan
    # (the numbers of a computation) selects, with five terms. All coefficients of the patch are summed.
    block = fourier_coefficients.Block(rough.shape, (0, 0), rough.shape)
    expansion = EXPANSIONS[plan.method]
    series = fourier_coefficients.series_coefficients(rough, expansion, plan.terms, block)
    half_range = expansion.offset_and_scale(rough)[1]
    basis = expansion.basis(2.0 * math.pi * w / wavelength_um * half_range, plan.terms)
    s, r = block.orders()
    (length_y, length_x), a = rough.size_um, coefficient_table.falloff_um2(coherence)
    gaussian = np.exp(-a * (v / wavelength_um - s / length_y) ** 2)[:, None]
    gaussian = gaussian * np.exp(-a * (u / wavelength_um - r / length_x) ** 2)
    if kind == "averaged":
        power = np.sum(np.abs(series @ basis) ** 2 * gaussian)
    else:
        centre_y, centre_x = (n // 2 * pitch for n, pitch in zip(rough.shape, rough.pitch_um, strict=True))
        phase = np.exp(-2j * math.pi * (s[:, None] * centre_y / length_y + r * centre_x / length_x))
        power = np.abs(np.sum((series @ basis) * gaussian * phase)) ** 2
    normal = reflectance_factors.normal_reflectance(1.5)
    gain = reflectance_factors.gain(light[None], view[None], normal=normal, masking=True)[0]

    result = wd.spectral_reflectance(rough, light, view, 1e3 * wavelength_um, plan=plan)[0]
    assert result == pytest.approx(gain * power, rel=1e-4)
    assert result != pytest.approx(wd.spectral_reflectance(rough, light, view, 500.0, plan=full)[0], rel=1e-2)


@pytest.mark.parametrize("kind", ["averaged", "source", "replicas"])
def test_results_use_the_numbers_of_the_plan(rough, kind):
    light, view = at_angle(25.0), at_angle(-5.0)
    coherence = {
        "averaged": wd.Coherence(sigma_um=3.25),
        "source": wd.Coherence("source", angular_diameter_deg=2.0),
        "replicas": wd.Coherence("replicas", periods=(1, 40)),
    }[kind]
    full = wd.plan(rough, light, view, coherence=coherence)
    expected = wd.reflectance(rough, light, view, plan=full)
    changes = [{"wavelengths": 3}, {"terms": 1}]
    changes.append({"subdivisions": 1, "wavelengths": 64} if kind == "replicas" else {"least_weight": 0.5})
    for changed in changes:
        result = wd.reflectance(rough, light, view, plan=dataclasses.replace(full, **changed))
        assert np.linalg.norm(result - expected) > 1e-2 * np.linalg.norm(expected)
    more = dataclasses.replace(full, terms=full.terms + 8, least_weight=1e-13, wavelengths=4 * full.wavelengths)
    result = wd.reflectance(rough, light, view, plan=more)
    assert np.linalg.norm(result - expected) < full.tolerance * np.linalg.norm(expected)


def test_the_plan_that_a_call_makes_is_the_one_that_plan_returns(rough):
    light, view = at_angle(25.0), hemisphere(np.random.default_rng(1), 9)
    plan = wd.plan(rough, light, view, tolerance=3e-2)
    result = wd.reflectance(rough, light, view, tolerance=3e-2)
    np.testing.assert_array_equal(result, wd.reflectance(rough, light, view, plan=plan))
    image = wd.reflectance_map(rough, light, size=8, tolerance=3e-2)
    again = wd.reflectance_map(rough, light, size=8, plan=image.plan)
    assert again.plan is image.plan
    np.testing.assert_array_equal(image.xyz, again.xyz)


def test_plans_are_compared_by_value_and_cannot_be_changed(rough):
    one, two = (wd.plan(rough, tolerance=0.3) for _ in range(2))
    assert one == two
    assert hash(one) == hash(two)
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.terms = 3


def test_one_row_is_constant_along_y():
    """A height field of one row must have no orders outside the plane y = 0 and no aliasing, at any pitch along y."""
    row = wd.gratings.sinusoidal(16.0, 0.1, samples=512)
    coarse = wd.HeightField(row.heights_um, (0.5, row.pitch_um[1]))
    views = np.array([[0.0, 0.8, 0.6], [0.1, 0.0, 1.0], [0.05, 0.0001, 1.0]])
    for method in ("auto", "direct"):
        thin, thick = (wd.spectral_reflectance(each, UP, views, [400.0], method=method) for each in (row, coarse))
        np.testing.assert_allclose(thick, thin, rtol=1e-4, atol=1e-30)
        assert thick[0] < 1e-30


def test_results_of_an_explicit_plan_do_not_depend_on_other_directions(rough, rng):
    """Results by a plan that the caller gives must not depend on the other directions of the call.

    The series uses basis functions that are fitted to the height field. The fit must depend only on the range of
    directions in the plan, not on the directions themselves.
    """
    lights, views = hemisphere(rng, 60), hemisphere(rng, 60)
    plan = wd.plan(rough, lights, views)
    together = wd.reflectance(rough, lights, views, plan=plan)
    alone = [wd.reflectance(rough, light, view, plan=plan) for light, view in zip(lights[:9], views[:9], strict=True)]
    np.testing.assert_array_equal(together[:9], alone)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3])
def test_directions_use_only_as_many_wavelengths_as_they_require(rough, rng, tolerance):
    """Directions with small |(u, v)| must use fewer wavelengths, and still meet the tolerance."""
    lights = hemisphere(rng, 200)
    views = lights * [-1.0, -1.0, 1.0] + rng.normal(scale=0.3, size=(200, 3)) * rng.uniform(size=(200, 1))
    views[:, 2] = np.abs(views[:, 2])
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    total = lights + views
    ends = [np.argmax(np.hypot(total[:, 0], total[:, 1])), np.argmin(total[:, 2]), np.argmax(total[:, 2])]
    # The plan (numbers of the computation) is made for only three directions. Its numbers are therefore upper bounds,
    # because a search would take longer than it saves.
    plan = wd.plan(rough, lights[ends], views[ends], tolerance=tolerance)
    assert not plan.is_measured
    assert plan.adaptive
    finest = dataclasses.replace(plan, adaptive=False, wavelengths=8 * plan.wavelengths)
    result, exact = (wd.reflectance(rough, lights, views, plan=each) for each in (plan, finest))
    assert np.percentile(relative_errors(result, exact), 99.0) <= tolerance
    quadrature = coefficient_table.quadrature_for(rough, plan, IlluminatedMaterial("D65"), device="cpu")
    sizes = np.diff(quadrature.firsts.numpy())
    assert sizes[0] == plan.wavelengths
    assert len(sizes) >= 3
    assert np.all(np.diff(sizes) < 0)
    plan = dataclasses.replace(plan, adaptive=False)
    fixed = coefficient_table.quadrature_for(rough, plan, IlluminatedMaterial("D65"), device="cpu")
    assert fixed.firsts.numpy().tolist() == [0, plan.wavelengths]


def test_pixels_of_a_map_can_be_means(rough):
    """A pixel of a reflectance map with ``samples_per_pixel`` must be the mean over a grid of directions.

    Its coverage must be the share of these directions within the unit disc.
    """
    light = [0.2, 0.1, 1.0]
    fine = wd.reflectance_map(rough, light, size=36, tolerance=3e-2)
    means = wd.reflectance_map(rough, light, size=12, samples_per_pixel=9, plan=fine.plan)
    np.testing.assert_allclose(means.xyz, fine.xyz.reshape(12, 3, 12, 3, 3).mean(axis=(1, 3)), rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(means.coverage, fine.mask.reshape(12, 3, 12, 3).mean(axis=(1, 3)), rtol=1e-6)
    assert np.any((means.coverage > 0.0) & (means.coverage < 1.0))
