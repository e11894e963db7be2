"""Verdicts on scalar diffraction, compared with rigorous solutions and closed forms, and functions that report them."""

import json
import math
import warnings

import numpy as np
import pytest
from conftest import at_angle
from scipy import special

import warpdiff as wd
from bench.reproduce.theory_verdict import judged
from bench.suite.validity import STORED
from warpdiff.heightfield import theory_verdict
from warpdiff.heightfield.theory_verdict import INVALID, QUALITATIVE, TheoryVerdict, verdict_on

UP = (0.0, 0.0, 1.0)
USUAL = {
    "sine": wd.gratings.sinusoidal(2.0, 0.25), "lamellar": wd.gratings.lamellar(2.0, 0.25),
    "blazed": wd.gratings.blazed(2.0, 0.25), "fingers": wd.gratings.fingers(size_um=12.8),
    "bumps": wd.gratings.bumps(), "CD": wd.gratings.disc("CD", tracks=4, length_um=14.0),
    "Blu-ray": wd.gratings.disc("Blu-ray", tracks=4, length_um=4.0),
}  # fmt: skip


@pytest.mark.parametrize("energy", [None, "stam"])
def test_verdicts_meet_their_targets_against_rigorous_solutions(energy):
    """The shares of right and wrong verdicts must meet their targets for gratings with known rigorous solutions.

    A verdict on scalar diffraction states its expected error.

    The test uses every thirteenth of 748 gratings. ``bench/reproduce/theory_verdict.py`` uses all of them.
    """
    for name, shares in judged(energy, step=13).items():
        if name.endswith("all"):
            assert shares.wrong_of_reliable <= 0.025, name
            assert shares.reliable_of_right >= 0.8, name
            assert 0.1 < shares.qualitative <= 0.35, name
            assert shares.wrong_of_invalid >= 0.8, name


@pytest.mark.parametrize(("case", "make"), [
    ("Sine, perfect mirror", lambda *size: wd.gratings.sinusoidal(*size, samples=128)),
    ("Square grooves, perfect mirror", lambda *size: wd.gratings.lamellar(*size, samples=512)),
    ("Sawtooth, perfect mirror", lambda *size: wd.gratings.blazed(*size, samples=512)),
])  # fmt: skip
def test_normalised_orders_of_mirrors_are_nearer_to_rigorous_solutions(case, make):
    """For mirror gratings, ``energy="normalised"`` must have smaller errors than ``energy="stam"``.

    Errors are differences from the efficiencies of rigorous solutions. The grooves are at most a quarter of the
    wavelength deep.
    """
    stored = json.loads(STORED.read_text())
    rows = iter(stored["cases"][case]["first_order_and_efficiencies"])
    errors = []
    for i, period in enumerate(stored["periods"]):
        for j, depth in enumerate(stored["depths"]):
            for angle in stored["angles_deg"]:
                first, *efficiencies = next(rows)
                # To save time, only every third grating period, two groove depths and oblique incidence are tested.
                if i % 3 or j not in (2, 5) or angle == 0.0:
                    continue
                heightfield = make(period, depth)
                results = [
                    wd.order_efficiencies(heightfield, at_angle(angle), 1000.0, ior=math.inf, energy=energy)
                    for energy in ("stam", "normalised")
                ]
                right = np.array(efficiencies) * stored["unit"]
                ours = [[orders[0, first + n][0] for n in range(len(right))] for orders in results]
                errors.append(np.max(np.abs(np.array(ours) - right), axis=1))
    stam, normalised = np.array(errors).T
    assert np.quantile(normalised, 0.9) < np.quantile(stam, 0.9)
    assert normalised.mean() < 0.75 * stam.mean()


def test_estimates_of_a_sine_are_their_closed_forms():
    """A verdict on scalar diffraction estimates an error for each reason: steep, narrow and deep grooves.

    For a sine of period P and depth d, the estimates must equal closed forms.

    The estimate of "steep" is proportional to the root mean square slope πd/(√2 P). The estimate of "narrow" is
    proportional to 1 − Σ J_m²(πd/λ) over |m| < P/2λ, where J_m are Bessel functions. The estimate of "deep" is
    proportional to (4πs/λ)² λ/P, with the mean square height s² = d²/8.
    """
    period, depth, wavelength = 3.0, 0.3, 0.5
    errors = theory_verdict.errors_of(wd.gratings.sinusoidal(period, depth, samples=600), wavelength)
    slope = math.pi * depth / (math.sqrt(2.0) * period)
    orders = np.arange(-3, 4)  # orders m with |m| λ/P at most 0.5
    narrow = 1.0 - np.sum(special.jv(orders, math.pi * depth / wavelength) ** 2)
    deep = 16.0 * math.pi**2 * depth**2 / 8.0 / (wavelength * period)
    assert errors["steep"] == pytest.approx(0.22 * slope, rel=1e-6)
    assert errors["narrow"] == pytest.approx(narrow / 0.7, rel=1e-6)
    assert errors["deep"] == pytest.approx(0.05 * deep, rel=1e-3)
    assert errors["undersampled"] == 0.0


def test_the_energy_deviation_of_heights_equals_that_of_the_sum_of_orders():
    """The deviation of the sum of all order efficiencies from the reflected power is estimated from the heights alone.

    The estimate must equal the largest deviation over twelve light directions, for a mirror and for glass. No order is
    near the horizon.
    """
    heightfield = wd.gratings.bumps(spacing_um=(1.53, 1.37), height_um=0.15)
    worst = [0.0, 0.0]
    for angle in (0.0, 30.0, 60.0):
        for x, y in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            sine = math.sin(math.radians(angle))
            for place, ior in enumerate((math.inf, 1.5)):
                light = (sine * x, sine * y, math.cos(math.radians(angle)))
                orders = wd.order_efficiencies(heightfield, light, 550.0, ior=ior, energy="stam")
                assert np.nanmin(orders.to_view[0, :, 2]) > 0.1
                flat = 1.0 if place == 0 else 0.04 + 0.96 * (1.0 - light[2]) ** 5
                worst[place] = max(worst[place], abs(orders.efficiencies.sum() / flat - 1.0))
    assert theory_verdict.energy_deviations(heightfield, 0.55) == pytest.approx(worst, rel=1e-3)


def test_a_flat_surface_has_an_estimated_error_of_0():
    verdict = wd.HeightField([[0.2, 0.2]], 1.0).summary().verdict
    assert verdict.error == 0.0
    assert str(verdict) == "reliable at 550 nm: orders may be wrong by 0 % of the reflected power"


def test_the_verdict_does_not_depend_on_pitch_size_position_or_gaps():
    """A field of 20 periods must have nearly the same verdict on scalar diffraction as one period.

    The field of 20 periods is shifted and raised, and has one missing sample.
    """
    single = verdict_on(wd.gratings.bumps(spacing_um=(2.0, 1.5), height_um=0.2)).error
    one = wd.gratings.bumps(spacing_um=(2.0, 1.5), height_um=0.2, pitch_um=0.025)
    many = wd.HeightField(np.roll(np.tile(one.heights_um, (4, 5)), (7, 11), (0, 1)) + 5.0, one.pitch_um)
    assert verdict_on(one).error == pytest.approx(single, rel=0.05)
    assert verdict_on(many).error == pytest.approx(single, rel=0.15)
    gaps = many.heights_um.copy()
    gaps[3, 5] = np.nan
    assert verdict_on(wd.HeightField(gaps, one.pitch_um)).error == pytest.approx(single, rel=0.2)


REASONS = {
    "deep": wd.gratings.sinusoidal(40.0, 6.0, samples=4000), "narrow": wd.gratings.sinusoidal(0.9, 0.3),
    "undersampled": wd.gratings.sinusoidal(1.0, 5.0), "steep": wd.gratings.sinusoidal(6.0, 2.0, samples=800),
    "energy": wd.gratings.lamellar(1.3, 0.4),
}  # fmt: skip


@pytest.mark.parametrize("reason", REASONS)
def test_each_reason_is_named(reason):
    verdict = REASONS[reason].summary().verdict
    assert verdict.reason == reason
    assert verdict.grade != "reliable"
    assert str(verdict).endswith(f"because {theory_verdict._REASONS[reason]}")


def test_a_wall_is_not_undersampled():
    """A vertical wall lies between two samples. It must not count as undersampled, whatever its height.

    A slope with equally large steps between all samples must count as undersampled.
    """
    for depth in (0.3, 3.0):
        assert theory_verdict._undersampled_share(wd.gratings.lamellar(5.0, depth), 0.55) == 0.0
    assert theory_verdict._undersampled_share(wd.gratings.blazed(2.0, 6.0, samples=24), 0.55) > 0.4


@pytest.mark.parametrize("name", USUAL)
def test_usual_surfaces_are_qualitative_and_not_warned_of(name):
    verdict = verdict_on(USUAL[name])
    assert QUALITATIVE < verdict.error < INVALID
    if name == "sine":
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            plan = wd.plan(USUAL[name], UP, (0.1, 0.0, 1.0))
        assert plan.theory == USUAL[name].summary().verdict == verdict


@pytest.mark.parametrize("call", ["plan", "reflectance", "shade", "order_efficiencies"])
def test_all_calls_warn_in_the_words_of_the_verdict(call):
    """Scalar diffraction is invalid for this deep grating, for all directions of light and view.

    Each public function must warn with the library's verdict on scalar diffraction: grade, wavelength, error and
    reason.
    """
    heightfield = wd.gratings.sinusoidal(1.0, 2.0, samples=16)
    tube = wd.meshes.tube(segments_along=12, segments_around=12)
    light, view = wd.DirectionalLight((0.1, 0.9, 1.2)), wd.View.fit(tube, width=8, height=6)
    calls = {
        "plan": lambda: wd.plan(heightfield, UP, UP, strict=False),
        "reflectance": lambda: wd.reflectance(heightfield, UP, UP, strict=False),
        "shade": lambda: wd.shade(tube, heightfield, light, view, strict=False, tolerance=0.5, refine=False),
        "order_efficiencies": lambda: wd.order_efficiencies(heightfield, UP, 550.0),
    }
    words = (
        "scalar diffraction is invalid at 550 nm: orders may be wrong by 100 % of the reflected power, because the "
        "phase changes by more than half a cycle between samples"
    )
    with pytest.warns(wd.WarpdiffWarning, match=words):
        calls[call]()
    assert f"scalar diffraction is {heightfield.summary().verdict}".startswith(words)


def test_orders_report_the_worst_verdict_of_their_wavelengths_and_their_sum():
    grating = wd.gratings.sinusoidal(2.9, 0.55)
    with pytest.warns(
        wd.WarpdiffWarning, match=r"the orders sum to 0\.743 times that power\): use positions of colours"
    ):
        orders = wd.order_efficiencies(grating, at_angle(30.0), [500.0, 900.0], ior=math.inf, energy="stam")
    assert orders.verdict.wavelength_nm == 500.0
    assert orders.verdict.error >= 1.1 * (1.0 - orders.efficiencies[0].sum())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        blazed = wd.gratings.blazed(2.0, 0.2)
        mirror = wd.order_efficiencies(blazed, at_angle(60.0), 500.0, ior=math.inf)
    with pytest.warns(wd.WarpdiffWarning, match="do not sum to the reflected power"):
        stam = wd.order_efficiencies(blazed, at_angle(60.0), 500.0, ior=math.inf, energy="stam")
    assert stam.verdict.error == pytest.approx(1.1 * (1.0 - stam.efficiencies.sum()))
    assert mirror.verdict.error < stam.verdict.error


def test_a_plan_file_restores_the_verdict(tmp_path):
    plan = wd.plan(wd.gratings.lamellar(2.0, 0.25), UP, UP)
    assert wd.Plan.load(plan.save(tmp_path / "plan.json")).theory == plan.theory
    assert plan.theory == TheoryVerdict(plan.scalar_error, plan.scalar_reason)
    assert str(plan.theory) in str(plan)


def test_spectra_are_judged_at_their_own_wavelengths():
    """The verdict on scalar diffraction of a spectrum must be made at the wavelengths of the spectrum.

    For the tested relief, scalar diffraction has the grade invalid for visible light. At wavelengths ten times as long,
    its grade is qualitative.
    """
    grating = wd.gratings.sinusoidal(40.0, 6.0, samples=2000)
    assert theory_verdict.theory_wavelength_nm(300.0, 700.0) == 550.0
    assert theory_verdict.theory_wavelength_nm(3000.0, 9000.0) == 3000.0
    assert verdict_on(grating).grade == "invalid"
    assert verdict_on(grating, 5500.0).grade == "qualitative"
    spectra = wd.spectral_reflectance(grating, UP, UP, [5000.0, 6000.0], strict=False)
    assert np.all(np.isfinite(spectra))
