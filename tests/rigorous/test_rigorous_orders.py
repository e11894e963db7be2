"""Rigorous efficiencies against published tables, another method, Fresnel's equations and energy conservation."""

import json
import math

import numpy as np
import pytest

import warpdiff as wd
from bench.reproduce import rigorous_tables as tables
from bench.suite.validity import ANGLES, STORED, UNIT
from warpdiff.inverse_design.design_result import achieved_values
from warpdiff.inverse_design.rigorous_check import rigorous_values
from warpdiff.rigorous import coupled_waves, rigorous_orders

pytest.importorskip("meent", reason="meent is not installed")
UP = (0.0, 0.0, 1.0)
ALUMINIUM = wd.Material.metal("Al")


@pytest.mark.parametrize("harmonics", [10, 20])
def test_published_coupled_waves_of_a_metal_grating(harmonics):
    cases = [case for case in tables.VALUES if case.harmonics == harmonics and case.source.startswith("Lalanne")]
    assert {case.polarisation for case in cases} == {0, 1}
    for case in cases:
        reflected = tables.metal_grating(case.depth_um, case.polarisation, harmonics).reflected
        np.testing.assert_allclose(reflected[harmonics + case.order], case.value, atol=1e-5)


@pytest.mark.slow
def test_all_published_values():
    assert len(tables.VALUES) >= 20
    for case in tables.VALUES:
        if case.source == "Li 1993":
            solution = tables.sine_grating(case.polarisation, case.harmonics)
        else:
            solution = tables.metal_grating(case.depth_um, case.polarisation, case.harmonics)
        side = solution.transmitted if case.transmitted else solution.reflected
        assert abs(side[case.harmonics + case.order] - case.value) <= tables.LIMIT, case


def test_sines_of_glass_equal_those_of_boundary_integrals():
    """Efficiencies by coupled waves must equal those by boundary integrals, an independent method (gratinglab)."""
    stored = json.loads(STORED.read_text())
    rows = iter(stored["cases"]["Sine, n = 1.5"]["first_order_and_efficiencies"])
    compared = 0
    for i, period in enumerate(stored["periods"]):
        for j, depth in enumerate(stored["depths"]):
            for angle in ANGLES:
                first, *powers = next(rows)
                if (i, j, angle) not in ((5, 5, 30.0), (7, 4, 60.0), (2, 6, 0.0)):
                    continue
                grating = wd.gratings.sinusoidal(period, depth, samples=128)
                light = (math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle)))
                result = wd.rigorous_order_efficiencies(grating, light, 1000.0, ior=1.5, layers=12)
                assert result.converged.all()
                for k, power in enumerate(powers):
                    np.testing.assert_allclose(result[0, first + k][0], UNIT * power, atol=2e-3)
                    compared += 1
    assert compared >= 6


def test_orders_have_the_signs_and_the_sum_of_scalar_diffraction():
    light = wd.direction(20.0)
    blazed = wd.HeightField(np.repeat([[0.0, 0.07, 0.14, 0.21]], 4, axis=1), (1.0, 0.15))
    rigorous = wd.rigorous_order_efficiencies(blazed, light, 600.0, material=ALUMINIUM)
    scalar = wd.order_efficiencies(blazed, light, 600.0, material=ALUMINIUM)
    np.testing.assert_array_equal(rigorous.orders, scalar.orders)
    np.testing.assert_allclose(rigorous.to_view, scalar.to_view)
    assert np.argmax(rigorous.efficiencies) == np.argmax(scalar.efficiencies)
    assert rigorous.efficiencies.max() > 0.5 > 2.0 * rigorous[0, 1][0]
    np.testing.assert_allclose(rigorous.efficiencies, scalar.efficiencies, atol=0.08)
    np.testing.assert_allclose(rigorous.efficiencies, (rigorous.efficiencies_s + rigorous.efficiencies_p) / 2.0)
    table = rigorous.table()
    assert len(table) == len(scalar.orders)
    np.testing.assert_allclose(rigorous[0, -1], table["efficiency"][table["m_x"] == -1])


def test_flat_surfaces_reflect_as_fresnel_says_and_glass_conserves_energy():
    flat = wd.HeightField(np.zeros((1, 4)), (1.0, 0.25))
    light = wd.direction(50.0)
    for material in (ALUMINIUM, wd.Material.dielectric(1.7), wd.Material.from_nk([550.0], [1.5], [0.01])):
        result = wd.rigorous_order_efficiencies(flat, light, 550.0, material=material)
        for part, name in ((result.efficiencies_s, "s"), (result.efficiencies_p, "p")):
            place = int(np.flatnonzero(result.orders[:, 1] == 0)[0])
            np.testing.assert_allclose(part[0, place], material.reflectance(550.0, 50.0, polarisation=name), atol=1e-6)
            np.testing.assert_allclose(np.delete(part[0], place), 0.0, atol=1e-9)
    layers, thicknesses = coupled_waves.layers_of(np.array([0.0, 0.1, 0.3, 0.1]), 8)
    for polarisation in (0, 1):
        both = coupled_waves.solve(layers, thicknesses, 1.5, wavelength_um=0.5, angle_rad=0.3, index=1.5 + 0.0j,
                                   polarisation=polarisation, harmonics=12)  # fmt: skip
        np.testing.assert_allclose(both.reflected.sum() + both.transmitted.sum(), 1.0, atol=1e-8)


def test_a_solver_that_is_wrong_on_a_flat_surface_is_refused(monkeypatch):
    wrong = coupled_waves.Solution(np.full(5, 0.5), np.zeros(5))
    monkeypatch.setattr(coupled_waves, "solve", lambda *_arguments, **_options: wrong)
    with pytest.raises(RuntimeError, match=r"reflectance 0\.500000 of a flat surface of aluminium for s polarisation"):
        wd.rigorous_order_efficiencies(wd.gratings.lamellar(1.0, 0.1), UP, 550.0, material=ALUMINIUM)


def test_not_converged_is_a_result():
    steep = wd.gratings.lamellar(1.0, 0.6, samples=16)
    silver, harmonics = wd.Material.metal("Ag"), 16
    with pytest.warns(wd.WarpdiffWarning, match=r"1 of 1 wavelengths have not converged: 1 changed by up to 0\.\d+ in"):
        result = wd.rigorous_order_efficiencies(steep, UP, 600.0, material=silver, max_harmonics=harmonics)
    assert not result.converged.any()
    assert np.isfinite(result.changes[0])
    assert result.changes[0] > 5e-3


def test_solutions_without_a_doubling_are_named_as_such():
    """If the number of harmonics was never doubled at a wavelength, the stored change is infinite.

    The warning must not report this infinite value as a change in the last doubling. It must still report the changes
    at other wavelengths.
    """
    long = wd.gratings.lamellar(8.0, 0.05, samples=16)
    with pytest.warns(wd.WarpdiffWarning, match="not converged: 1 were computed once, with 22 harmonics: .* least 44$"):
        result = wd.rigorous_order_efficiencies(long, UP, 600.0, material=ALUMINIUM, max_harmonics=40)
    np.testing.assert_array_equal(result.changes, [np.inf])
    with pytest.warns(wd.WarpdiffWarning) as caught:
        rigorous_orders._warn_of_harmonics(
            np.array([22, 32, 64]), np.array([np.inf, 0.02, 0.5]), np.array([False, False, True])
        )
    message = str(caught[0].message)
    assert "2 of 3 wavelengths" in message
    assert "1 changed by up to 0.02 in the last doubling to 32 harmonics" in message
    assert "inf" not in message


def test_layers_are_levels_or_a_staircase():
    heights = np.array([0.0, 0.1, 0.1, 0.3])
    masks, thicknesses = coupled_waves.layers_of(heights, 4)
    np.testing.assert_allclose(thicknesses, [0.2, 0.1])
    assert [mask.tolist() for mask in masks] == [[False, False, False, True], [False, True, True, True]]
    masks, thicknesses = coupled_waves.layers_of(np.linspace(0.0, 1.0, 101), 5)
    np.testing.assert_allclose(thicknesses, 0.2)
    assert [int(mask.sum()) for mask in masks] == [10, 30, 50, 70, 90]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"heightfield": wd.gratings.bumps()}, "heightfield must have a single row"),
        ({"to_light": (0.0, 0.3, 1.0)}, r"to_light must be one direction \(x, 0, z\)"),
        ({"to_light": (0.0, 0.0, -1.0)}, r"to_light must be one direction \(x, 0, z\)"),
        ({"ior": math.inf}, "is a perfect mirror, which has no layers"),
        ({"material": ALUMINIUM.coated(wd.Material.dielectric(1.4), 50.0)}, "material must have no film"),
        ({"layers": 0}, "layers must be an integer, at least 1"),
        ({"max_harmonics": 8, "heightfield": wd.gratings.lamellar(20.0, 0.1)}, "max_harmonics must be at least"),
    ],
)
def test_refused_before_the_solution(options, message):
    arguments = {"heightfield": wd.gratings.lamellar(1.0, 0.1), "to_light": UP} | options
    with pytest.raises(ValueError, match=message):
        wd.rigorous_order_efficiencies(arguments.pop("heightfield"), arguments.pop("to_light"), 550.0, **arguments)


def test_designs_are_checked_rigorously():
    pixels = wd.profiles.Pixels(0.8, np.zeros((1, 8)), samples=4)
    equal = wd.Target.equal([(0, -1), (0, 0), (0, 1)], UP, 632.8, ior=math.inf)
    result = wd.design(pixels, equal, levels=4, starts=1)
    check = result.check_rigorously()
    direct = wd.rigorous_order_efficiencies(result.heightfield, UP, 632.8, material=ALUMINIUM)
    np.testing.assert_allclose(check.achieved["achieved"], [direct[0, m][0] for m in (-1, 0, 1)])
    assert check.converged == 1.0
    assert check.uniformity_errors[0] < 0.25
    # Scalar diffraction is accurate for shallow grooves with a long period. Its colour must nearly equal that by the
    # rigorous solver.
    grooves = wd.gratings.lamellar(5.0, 0.05, samples=40)
    coherence = wd.Coherence(sigma_um=3.0)
    target = wd.Target.colour((0.3, 0.5, 0.1), UP, wd.direction(5.0), material=ALUMINIUM, coherence=coherence)
    scalar = achieved_values(grooves, [target])[0]
    rigorous = rigorous_values(grooves, [target], ALUMINIUM, 9, 64, None)[0][0]
    np.testing.assert_allclose(rigorous, scalar, rtol=0.04)


def test_singular_equations_of_the_solver_are_a_clear_error() -> None:
    """Equations may be singular where an order is exactly at the horizon, and for a material with the index of air."""
    to_light, grating = (0.5, 0.0, math.sqrt(0.75)), wd.gratings.lamellar(1.0, 0.1)
    with pytest.raises(ValueError, match=r"wavelengths_nm has a wavelength of 500 nm, .*singular.*change the"):
        wd.rigorous_order_efficiencies(grating, to_light, [500.0], ior=1.5)
    air = wd.Material([500.0], [1.0], [0.0])
    with pytest.raises(ValueError, match="material must have an index that differs from that of air, got 1 at 500 nm"):
        wd.rigorous_order_efficiencies(grating, (0, 0, 1), [500.0], material=air)
