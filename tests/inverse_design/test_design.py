"""Designs of surfaces: losses and exchanges of pixels against independent sums, limits of manufacture, and errors."""

import math
from unittest import mock

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.core import memory
from warpdiff.inverse_design import design_result, design_search, pixel_exchange, rigorous_check
from warpdiff.inverse_design.design_result import achieved_values, uniformity_error
from warpdiff.inverse_design.first_heights import first_heights
from warpdiff.inverse_design.goal import Goal, lab
from warpdiff.inverse_design.pixel_exchange import PixelExchange, coefficients_of, edge_moves
from warpdiff.inverse_design.rigorous_check import _colour
from warpdiff.optics import colorimetry

MIRROR = {"ior": math.inf}
UP = (0.0, 0.0, 1.0)
ORDERS = [(0, m) for m in (-1, 0, 1)]
GREEN, RED = (0.275, 0.55, 0.092), (0.463, 0.25, 0.034)


def colours(**options):
    return [
        wd.Target.colour(GREEN, UP, wd.direction(20.0), **MIRROR, **options),
        wd.Target.colour(RED, UP, wd.direction(35.0), **MIRROR, **options),
    ]


def pixels(count=24, pixel_um=0.4, samples=2):
    return wd.profiles.Pixels(pixel_um, np.zeros((1, count)), samples=samples)


def heights(shape, levels=4, depth=0.24, seed=1):
    return np.random.default_rng(seed).integers(0, levels, shape), depth


def test_lab_is_that_of_colour_science_with_its_derivatives():
    import colour

    rng = np.random.default_rng(0)
    xyz = np.concatenate([rng.uniform(0.02, 1.2, (20, 3)), rng.uniform(0.0, 0.008, (5, 3))])
    white = colour.XYZ_to_xy(colorimetry.colour_products("D65").sum(axis=0))
    labs, slopes = lab(xyz)
    np.testing.assert_allclose(labs, colour.XYZ_to_Lab(xyz, white), atol=0.02)
    step = 1e-7
    for axis in range(3):
        moved = lab(xyz + step * np.eye(3)[axis])[0]
        np.testing.assert_allclose((moved - labs) / step, slopes[..., axis], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("kind", ["colour", "orders", "equal", "both"])
def test_gradient_of_the_loss_is_that_of_differences(kind):
    wanted = {
        "colour": colours(coherence=wd.Coherence(sigma_um=3.0)),
        "orders": [wd.Target.orders({(0, 1): 0.3, (0, 0): 0.1}, UP, 550.0, **MIRROR, energy="stam")],
        "equal": [wd.Target.equal(ORDERS, UP, 632.8, **MIRROR)],
    }
    targets = wanted.get(kind) or wanted["colour"] + wanted["equal"]
    profile, rng = pixels(12), np.random.default_rng(2)
    z = np.append(rng.uniform(0.0, 0.2, 12), 1.2 if kind in ("colour", "both") else 0.0)
    function = Goal(targets).objective(profile)
    _, gradient = function(z)
    for k in (0, 5, 11, *([12] if kind in ("colour", "both") else [])):
        step = 1e-6 * np.eye(13)[k]
        slope = (function(z + step)[0] - function(z - step)[0]) / 2e-6
        np.testing.assert_allclose(gradient[k], slope, rtol=2e-5, atol=1e-4 * np.abs(gradient).max())


@pytest.mark.parametrize("shape", [(1, 24), (6, 8)])
def test_exchange_computes_the_values_of_the_library(shape):
    """Values of a design by explicit sums over its pixels must equal ``reflectance`` and ``order_efficiencies``."""
    profile = wd.profiles.Pixels(0.5, np.zeros(shape), samples=3)
    narrow = wd.Coherence(sigma_um=2.0)
    targets = [
        *colours(coherence=narrow),
        wd.Target.equal(ORDERS, wd.direction(10.0), 550.0, material=wd.Material.metal("Al")),
    ]
    levels, depth = heights(shape)
    surface = profile.surface((depth * levels / 3).ravel())
    goal = Goal(targets)
    goal.update_factors(surface)
    exchange = PixelExchange(goal, profile, 4)
    powers = np.abs((exchange.by_level(levels) * exchange._phases(depth)).sum(axis=1)) ** 2
    xyz, orders = exchange.values(powers)
    expected = achieved_values(surface, targets)
    np.testing.assert_allclose(xyz, expected[:2], rtol=5e-3, atol=5e-3 * np.max(expected[:2]))
    np.testing.assert_allclose(orders, expected[2], rtol=1e-6, atol=1e-9)


def test_exchange_never_raises_the_loss_and_keeps_runs():
    profile = pixels(24, samples=1)
    goal = Goal([wd.Target.equal(ORDERS, UP, 632.8, **MIRROR, energy="stam")])
    exchange = PixelExchange(goal, profile, 2)
    levels = np.repeat([[0, 1, 0, 1, 1, 0]], 4, axis=1)
    rng = np.random.default_rng(0)

    def loss(index, depth):
        return float(goal.costs(goal.values(profile.surface((depth * index / 1.0).ravel()))[0], 0.0))

    better, depth, _ = exchange.run(levels, 0.0, (0.1, 0.2), rng, edge_moves(3))
    first = min(loss(levels, each) for each in np.linspace(0.1, 0.2, 21))
    assert loss(better, depth) < first - 1.0
    row = np.roll(better[0], -int(np.flatnonzero(np.diff(better[0]))[0]) - 1)
    runs = np.diff(np.flatnonzero(np.append(True, np.append(np.diff(row) != 0, True))))
    assert runs.min() >= 3
    assert loss(exchange.run(better, 0.0, (depth, depth), rng)[0], depth) <= loss(better, depth) + 1e-9


def test_edges_move_only_between_runs_that_remain_long_enough():
    allowed = edge_moves(2)
    levels = np.array([[0, 0, 0, 1, 1, 2, 2, 2]])
    expected = [[2], [], [1], [], [], [1], [], [0]]
    assert [allowed(levels, 0, i) for i in range(8)] == expected
    assert allowed(np.zeros((1, 4), dtype=int), 0, 1) == []


def test_splitter_meets_its_limits_and_repeats():
    target = wd.Target.equal(ORDERS, UP, 632.8, **MIRROR)
    result = wd.design(pixels(), target, levels=4, depth_um=(0.15, 0.3), least_feature_um=0.8, starts=1, seed=3)
    assert result.uniformity_errors[0] < 0.05
    assert result.shares[0] > 0.65  # twelve features scatter the rest into other orders
    assert 0.15 <= result.levels_um[-1] <= 0.3
    np.testing.assert_allclose(np.diff(result.levels_um), result.levels_um[-1] / 3)
    assert set(np.round(result.heightfield.heights_um.ravel(), 9)) <= set(np.round(result.levels_um, 9))
    # Each ridge or groove must be at least 0.8 µm wide, which is 4 samples. ``row`` begins at a step between two
    # levels.
    row = result.heightfield.heights_um[0]
    row = np.roll(row, -int(np.flatnonzero(np.diff(row))[0]) - 1)
    assert np.diff(np.flatnonzero(np.append(True, np.append(np.diff(row) != 0, True)))).min() >= 4
    again = wd.design(pixels(), [target], levels=4, depth_um=(0.15, 0.3), least_feature_um=0.8, starts=1, seed=3)
    np.testing.assert_array_equal(result.heightfield.heights_um, again.heightfield.heights_um)
    plain = wd.order_efficiencies(result.heightfield, UP, 632.8, **MIRROR)
    np.testing.assert_allclose(result.achieved["achieved"], [plain[pair][0] for pair in ORDERS])
    table = result.robustness(depth_scales=[0.9], edge_widths_um=[0.2], tilts_deg=[1.0])
    assert table["change"].tolist() == ["none", "depth", "edges", "tilt"]
    deeper = wd.HeightField.of_known_scale(0.9 * result.heightfield.heights_um, result.heightfield.pitch_um)
    scaled = wd.order_efficiencies(deeper, UP, 632.8, **MIRROR)
    values = np.array([scaled[pair][0] for pair in ORDERS])
    np.testing.assert_allclose(table["order_error"][1], np.abs(values / values.mean() - 1.0).max())
    assert np.all(table["order_error"][1:] > table["order_error"][0])
    assert "delta_e" not in table.columns
    assert "share of the reflected power" in result.report()
    assert f"scalar diffraction: {result.heightfield.summary().verdict}" in result.report()


@pytest.mark.parametrize("levels", [2, 4])
def test_equal_orders_without_order_0_are_bright(levels):
    """A design of equal orders must reflect most light into these orders.

    All orders of a flat surface except order 0 are dark, and thus equal. Such a surface must not count as the best
    design.
    """
    target = wd.Target.equal([(0, -1), (0, 1)], UP, 632.8, **MIRROR)
    result = wd.design(wd.profiles.Pixels(0.5, np.zeros((1, 16))), target, levels=levels, starts=2)
    assert result.shares[0] > 0.7
    assert result.uniformity_errors[0] < 0.05
    goal = Goal([target])
    dark, one = goal.costs([np.zeros(2)], 0.0), goal.costs([np.array([0.4, 0.0])], 0.0)
    assert dark > one > goal.costs([np.array([0.2, 0.2])], 0.0)
    assert uniformity_error(np.zeros(2)) == uniformity_error(np.array([0.4, 0.0])) == 1.0


def test_american_spellings_are_converted():
    for target in (
        wd.Target.equal(ORDERS, UP, 550.0, energy="normalized", **MIRROR),
        wd.Target.orders({(0, 1): 0.3}, UP, 550.0, energy="normalized", **MIRROR),
    ):
        assert target.optics.energy == "normalised"


@pytest.mark.parametrize(("change", "reason"), [(0.02, "changed by up to 2.0e-02"), (np.inf, "could not be doubled")])
def test_rigorous_checks_warn_if_solutions_have_not_converged(change, reason):
    target = wd.Target.orders({(0, 0): 0.3}, UP, 632.8, **MIRROR)
    result = wd.design(wd.profiles.Pixels(0.2, np.zeros((1, 8))), target, starts=1)
    message = f"25% of the rigorous solutions have not converged: .*{reason}"
    values = mock.patch.object(design_result, "rigorous_values", return_value=([np.array([0.3])], 0.75, change))
    with values, pytest.warns(wd.WarpdiffWarning, match=message):
        check = result.check_rigorously()
    assert check.converged == 0.75


def test_default_widths_of_edges_are_those_that_the_period_permits():
    target = wd.Target.orders({(0, 0): 0.3}, UP, 632.8, **MIRROR, energy="stam")
    for period, expected in ((0.4, []), (0.8, [0.05]), (1.6, [0.05, 0.1])):
        result = wd.design(wd.profiles.Pixels(period / 8, np.zeros((1, 8))), target, starts=1)
        table = result.robustness()
        np.testing.assert_array_equal(table["amount"][table["change"] == "edges"], expected)
    with pytest.raises(ValueError, match=r"edge_widths_um must lie within 0 to 0\.16 µm, a tenth of the period, got"):
        result.robustness(edge_widths_um=[0.2])


@pytest.mark.parametrize("coherence", [wd.Coherence(sigma_um=400.0), wd.Coherence("source", angular_diameter_deg=0.02)])
def test_rigorous_colours_sample_the_narrow_peaks_of_a_long_coherence(coherence):
    """Rigorous colours must equal sums over so many wavelengths that no peak of the spectrum lies between them."""
    target = wd.Target.colour(GREEN, UP, wd.direction(17.0), coherence=coherence, **MIRROR)
    nodes, orders = np.linspace(380.0, 780.0, 5), np.arange(-5, 6)
    arguments = target, (1.0, 2.0), nodes, orders, np.full((5, 11), 0.1)
    xyz = _colour(*arguments)

    numbers, weights = colorimetry.uniform_quadrature(40_001, "D65", geometric=coherence.kind == "source")
    with mock.patch.object(rigorous_check, "sampling", return_value=(1e3 / numbers, weights)):
        expected = _colour(*arguments)
    np.testing.assert_allclose(xyz, expected, rtol=5e-3)


def test_colours_have_one_exposure(monkeypatch):
    monkeypatch.setattr(design_search, "_MOST_ITERATIONS", 60)
    profile = wd.profiles.Pixels(0.25, np.zeros((1, 64)), samples=2)
    result = wd.design(profile, colours(coherence=wd.Coherence(sigma_um=8.0)), starts=2)
    assert result.delta_e.max() < 1.5
    shown = [
        wd.reflectance(result.heightfield, UP, wd.direction(angle), coherence=wd.Coherence(sigma_um=8.0), **MIRROR,
                       tolerance=1e-4)
        for angle in (20.0, 35.0)
    ]  # fmt: skip
    differences = colorimetry.colour_difference(result.exposure * np.array(shown), np.array([GREEN, RED]))
    np.testing.assert_allclose(differences, result.delta_e, atol=0.01)
    for factor in (0.997, 1.003):
        other = colorimetry.colour_difference(factor * result.exposure * np.array(shown), np.array([GREEN, RED]))
        assert (other**2).sum() > (differences**2).sum()


def test_outlines_are_designed_within_their_bounds():
    profile = wd.profiles.Trapezoid(depth_um=0.1, duty=0.5, wall=0.02, period_um=2.0)
    target = wd.Target.orders({(0, 0): 0.0, (0, 1): 0.4, (0, -1): 0.4}, UP, 550.0, **MIRROR)
    result = wd.design(profile, target, starts=2)
    low, high = profile.bounds.T
    assert np.all((result.parameters >= low) & (result.parameters <= high))
    assert np.abs(result.achieved["error"]).max() < 0.03
    assert repr(result).startswith("Design(Trapezoid, depth 0.1")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"levels": 1}, ValueError, "levels must be an integer, at least 2"),
        ({"depth_um": (0.3, 0.2)}, ValueError, "depth_um must be a range from a smaller to a larger depth"),
        ({"depth_um": 0.0}, ValueError, "depth_um must be a finite number, more than 0"),
        ({"least_feature_um": 0.3}, ValueError, "least_feature_um must be at least the size of a pixel, 0.4 µm"),
        ({"least_feature_um": 2.0}, ValueError, "least_feature_um is 5 pixels, which must divide"),
        ({"starts": 0}, ValueError, "starts must be an integer, at least 1"),
        ({"targets": []}, ValueError, "targets must have at least one target"),
        ({"targets": ["green"]}, TypeError, r"targets\[0\] must be a warpdiff.Target, got str"),
        ({"targets": [wd.Target.equal([(0, 40)], UP, 550.0)]}, ValueError, r"orders that propagate, got \(0, 40\)"),
        ({"targets": [wd.Target.equal([(1, 0)], UP, 550.0)]}, ValueError, "order 0 along a constant axis"),
        ({"profile": wd.profiles.Trapezoid(0.1, 0.5, 0.02, 2.0), "levels": 2}, ValueError, "only Pixels have levels"),
    ],
)  # fmt: skip
def test_refused_before_the_search(options, error, message):
    arguments = {"profile": pixels(), "targets": [wd.Target.equal(ORDERS, UP, 550.0)]} | options
    profile, targets = arguments.pop("profile"), arguments.pop("targets")
    with pytest.raises(error, match=message):
        wd.design(profile, targets, **arguments)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: wd.Target.colour((0.1, 0.2, -0.1), UP, UP), ValueError, "xyz must be positive"),
        (lambda: wd.Target.colour(GREEN, UP, (1, 0, -1)), ValueError, "to_view must be one direction"),
        (lambda: wd.Target.colour(GREEN, [UP, UP], UP), ValueError, "to_light must be one direction"),
        (lambda: wd.Target.colour(GREEN, UP, UP, coherence=wd.Coherence("centred")), ValueError, "or a source"),
        (lambda: wd.Target.orders([0.3], UP, 550.0), TypeError, "efficiencies must be a dictionary"),
        (lambda: wd.Target.orders({(0, 1): 0.3}, UP, 550.0), ValueError, "add up to more than 0 and at most 0.04"),
        (lambda: wd.Target.orders({(0, 0.5): 0.01}, UP, 550.0), ValueError, "efficiencies must be 1 to 100000 pairs"),
        (lambda: wd.Target.equal([(0, 1), (0, 1)], UP, 550.0), ValueError, "orders must be different orders"),
        (lambda: wd.Target.equal([], UP, 550.0), ValueError, "orders must be 1 to 100000 pairs"),
        (lambda: wd.Target.equal(ORDERS, UP, 550.0, energy="no"), ValueError, "energy must be one of"),
        (lambda: wd.Target.orders({(0, 1e300): 0.1}, UP, 550.0), ValueError, "efficiencies must lie within ±1e\\+09"),
        (lambda: wd.Target.equal([(0, 10**19)], UP, 550.0), ValueError, "orders must lie within ±1e\\+09, got 1e\\+19"),
        (lambda: wd.Target.colour((1e300, 0.5, 0.5), UP, UP), ValueError, "X and Z of at most 200, got .*divide"),
    ],
)  # fmt: skip
def test_refused_targets(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_coefficients_beyond_the_pixels_repeat_with_samples():
    """Fourier coefficients of a pixelated surface must equal explicit Fourier sums over the samples of its heights."""
    profile = wd.profiles.Pixels(0.3, np.zeros((4, 6)), samples=2)
    levels, depth = heights((4, 6))
    surface = profile.surface((depth * levels / 3).ravel())
    target = wd.Target.equal([(1, -2), (0, 1)], wd.direction(15.0, 40.0), 450.0, **MIRROR, energy="stam")
    part = coefficients_of([target], np.ones(2), surface)
    exchange = PixelExchange(Goal([target]), profile, 4)
    amplitudes = (exchange.by_level(levels) * exchange._phases(depth)).sum(axis=1)
    for (s, r), kappa, amplitude in zip(part.orders, part.kappas, amplitudes, strict=True):
        direct = np.fft.ifft2(np.exp(-2j * np.pi * kappa * surface.heights_um))[s, r]
        np.testing.assert_allclose(amplitude, direct, atol=1e-12)


def test_fourier_starts_have_the_orders_of_the_target():
    """A search starts from heights that are computed by Fourier transforms, and these heights must have bright orders.

    All target orders are on the same side of the normal. Mirrored heights would be bright on the other side, where the
    orders must be dark.
    """
    profile = wd.profiles.Pixels(0.4, np.zeros((8, 30)), samples=2)
    pairs = [(1, 1), (0, 3)]
    target = wd.Target.equal(pairs, UP, 632.8, **MIRROR)
    for seed in range(3):
        first = first_heights(profile, [target], target.cycle_um, np.random.default_rng(seed))
        orders = wd.order_efficiencies(profile.height_field(first), UP, 632.8, **MIRROR)
        assert min(orders[pair][0] for pair in pairs) > 0.2
        assert max(orders[-y, -x][0] for y, x in pairs) < 0.1


def test_levels_wrap_only_at_a_cycle_of_the_phase(monkeypatch):
    """A height above the highest level may only become the lowest level if both reflect light with the same phase.

    The levels of this test are too shallow for this. If heights became the lowest level, the design would be flat.
    """
    monkeypatch.setattr(pixel_exchange, "_MOST_PRODUCTS", 0.0)
    target = wd.Target.orders({(0, 1): 0.3, (0, -1): 0.3}, UP, 632.8, **MIRROR, energy="stam")
    result = wd.design(wd.profiles.Pixels(0.5, np.zeros((1, 8))), target, levels=2, depth_um=0.05, starts=1)
    assert np.ptp(result.parameters) == pytest.approx(0.05)
    assert result.achieved["achieved"].min() > 0.05


def test_least_features_hold_after_the_exchange():
    """Every feature of a design must be at least ``least_feature_um`` wide, after the final exchange of pixels.

    In this design, exchanges of single pixels would lower the loss, but would make narrower features.
    """
    profile = wd.profiles.Pixels(0.2, np.zeros((1, 48)), samples=1)
    target = wd.Target.equal([(0, m) for m in range(-3, 4)], UP, 632.8, **MIRROR, energy="stam")
    for seed in range(2):
        result = wd.design(profile, target, levels=2, least_feature_um=0.8, starts=1, seed=seed)
        row = result.parameters
        row = np.roll(row, -int(np.flatnonzero(np.diff(row))[0]) - 1)
        assert np.diff(np.flatnonzero(np.append(True, np.append(np.diff(row) != 0, True)))).min() >= 4


@pytest.mark.parametrize("width", [1e-5, 1e-7, 1e-320])
def test_edges_far_below_a_sample_are_refused(width, monkeypatch):
    target = wd.Target.equal(ORDERS, UP, 632.8, **MIRROR)
    result = wd.design(pixels(), target, starts=1)
    with pytest.raises(ValueError, match=r"edge_widths_um must be 0, or at least 0\.002 µm, .* give 0 for sharp edges"):
        result.robustness(edge_widths_um=[width])
    monkeypatch.setattr(memory, "available", lambda: 1e5)
    with pytest.raises(MemoryError, match=r"edge_widths_um of 0\.002 µm with 9600 samples requires about"):
        result.robustness(edge_widths_um=[0.002])


def test_columns_are_designed_like_rows():
    """A grating along y must have the results of the same grating along x, with exchanged orders."""
    options = {"levels": 4, "starts": 1, "least_feature_um": 0.8}
    row = wd.design(pixels(), wd.Target.equal(ORDERS, UP, 632.8, **MIRROR), **options)
    column = wd.profiles.Pixels(0.4, np.zeros((24, 1)), samples=2)
    result = wd.design(column, wd.Target.equal([(m, 0) for _, m in ORDERS], UP, 632.8, **MIRROR), **options)
    assert result.heightfield.shape == (48, 1)
    np.testing.assert_array_equal(result.heightfield.heights_um.T, row.heightfield.heights_um)
    for own, other in zip(*(each.robustness(tilts_deg=[]) for each in (result, row)), strict=True):
        assert own[:2] == other[:2]
        assert own[2] == pytest.approx(other[2], abs=1e-9)
    tilted = wd.design(column, wd.Target.equal([(0, 0)], (0.0, 0.1, 1.0), 632.8, **MIRROR), starts=1)
    oblique = wd.design(column, wd.Target.equal([(0, 0)], (0.1, 0.0, 1.0), 632.8, **MIRROR), starts=1)
    with pytest.raises(ValueError, match=r"targets\[0\] must have directions perpendicular to the grooves \(x = 0\)"):
        oblique.check_rigorously()
    solve = mock.Mock(side_effect=LookupError)
    with mock.patch.object(rigorous_check, "rigorous_order_efficiencies", solve), pytest.raises(LookupError):
        tilted.check_rigorously()
    surface, light = solve.call_args.args[:2]
    assert surface.shape == (1, 48)
    np.testing.assert_allclose(light, wd.Target.equal([(0, 0)], (0.1, 0.0, 1.0), 500.0).to_light)
