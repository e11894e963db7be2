"""Profiles: the surfaces that their parameters define, and derivatives compared with finite differences."""

import numpy as np
import pytest

import warpdiff as wd

PROFILES = {
    "Samples": lambda: wd.profiles.Samples(wd.gratings.sinusoidal(2.0, 0.1, samples=9)),
    "Pixels": lambda: wd.profiles.Pixels(0.5, np.linspace(0.0, 0.2, 6).reshape(2, 3), samples=3),
    "ScanModes": lambda: wd.profiles.ScanModes(wd.gratings.bumps(), 1.1, (0.01, -0.02), 0.03),
    "Polygon": lambda: wd.profiles.Polygon([(0.1, 0.0), (0.3, 0.1), (0.3, 0.05), (0.8, 0.02)], 2.0),
    "Trapezoid": lambda: wd.profiles.Trapezoid(0.14, 0.4, 0.05, 2.0),
}


def variables_of(profile, x):
    surface = profile.surface(x)
    if isinstance(surface, wd.profiles.Outline):
        return {"vertices": np.stack([surface.positions, surface.heights_um], axis=1), "period_um": surface.period_um}
    return {"heights_um": surface.heights_um}


@pytest.mark.parametrize("name", PROFILES)
def test_pushforward_is_the_derivative_and_pullback_its_transpose(name, rng):
    profile = PROFILES[name]()
    assert len(profile.names) == len(profile.start) == len(profile.bounds)
    x, dx = profile.start, 1e-4 * rng.normal(size=len(profile.start))
    base, moved = variables_of(profile, x), variables_of(profile, x + dx)
    changes = profile.pushforward(x, dx)
    assert set(changes) == set(profile.wrt) == set(base)
    adjoints = {key: rng.normal(size=np.shape(change)) for key, change in changes.items()}
    for key, change in changes.items():
        # Surfaces are linear functions of the parameters, so that finite differences are exact up to rounding.
        np.testing.assert_allclose(moved[key] - base[key], change, atol=1e-14)
    forward = sum(np.sum(adjoints[key] * changes[key]) for key in changes)
    assert forward == pytest.approx(profile.pullback(x, adjoints) @ dx, rel=1e-12)


@pytest.mark.parametrize("name", PROFILES)
def test_bounds_are_surfaces(name, rng):
    profile = PROFILES[name]()
    low, high = profile.bounds.T
    for x in (low, high, *rng.uniform(low, high, (20, len(low)))):
        profile.surface(x)
    assert profile.height_field(profile.start).height_range_um > 0.0


def test_trapezoids_have_their_duty_and_walls_exactly():
    profile = wd.profiles.Trapezoid(0.2, 0.3, 0.04, 2.5)
    outline = profile.surface([0.2, 0.3, 0.04, 2.5])
    np.testing.assert_allclose(np.diff(outline.positions), [0.04, 0.26, 0.04], atol=1e-15)
    # At the middle of each sloped wall, the ridge has half of its height. Its mean height is therefore duty cycle times
    # depth.
    assert outline.height_field(20_000).heights_um.mean() == pytest.approx(0.3 * 0.2, rel=1e-4)


def test_equivalent_trapezoids_have_the_same_orders():
    profile = wd.profiles.Trapezoid(0.14, 0.42, 0.04, 2.0)
    (other,) = profile.equivalents(profile.start)
    surfaces = profile.surface(profile.start), profile.surface(other)
    values = [wd.adjoint.order_efficiencies(surface, (0.3, 0, 1), 550.0, wrt=()).value for surface in surfaces]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: wd.profiles.Trapezoid(0.1, 0.5, 0.4, 2.0), "wall must be"),
        (lambda: wd.profiles.Trapezoid(0.0, 0.5, 0.02, 2.0), "depth_um must be"),
        (lambda: wd.profiles.Trapezoid(0.1, 0.5, 0.02, -1.0), "period_um"),
        (lambda: wd.profiles.Polygon([0.0, 1.0], 2.0), "vertices"),
        (lambda: wd.profiles.Polygon([(0.0, 0.0, 0.0)] * 2, 2.0), r"shape \(k, 2\)"),
        (lambda: wd.profiles.Pixels(0.5, [0.0, 1.0]), "levels"),
        (lambda: wd.profiles.Pixels(0.5, np.zeros((0, 4))), "levels must have at least one pixel"),
        (lambda: wd.profiles.Samples(wd.gratings.bumps()).surface([1.0]), "one number per parameter"),
        (lambda: wd.profiles.ScanModes(wd.gratings.bumps(), 20.0), "scale must lie within 0 to 10"),
    ],
)
def test_invalid_arguments_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_objectives_have_the_gradient_of_the_loss():
    profile = PROFILES["Trapezoid"]()

    def evaluate(surface, wrt):
        return wd.adjoint.reflectance(surface, (0.1, 0, 1), (0.2, 0, 1), wrt=wrt, coherence=wd.Coherence(sigma_um=1.0))

    function = wd.adjoint.objective(profile, evaluate, lambda value: (np.sum(value**2), 2.0 * value))
    loss, gradient = function(profile.start)
    for k, step in enumerate(1e-6 * np.eye(len(gradient))):
        difference = (function(profile.start + step)[0] - function(profile.start - step)[0]) / 2e-6
        # The tolerance is the accuracy of a central difference in float64.
        assert gradient[k] == pytest.approx(difference, rel=1e-5, abs=1e-6 * loss)
    with pytest.raises(TypeError, match="profile"):
        wd.adjoint.objective(None, evaluate, None)


def orders(surface, wrt):
    return wd.adjoint.order_efficiencies(surface, (0, 0, 1), 550.0, wrt=wrt)


@pytest.mark.parametrize(
    ("evaluate", "loss", "message"),
    [
        (lambda _surface, _wrt: 3.0, None, "evaluate must return a result of wd.adjoint"),
        (lambda surface, _wrt: orders(surface, ()), None, "vertices, period_um are missing"),
        (None, lambda value: value.sum(), "loss must return a number and its gradient"),
        (None, lambda value: (value, value), "loss must return a number and its gradient"),
        (None, lambda value: (value.sum(), np.ones(3)), "must have the shape of the value"),
    ],
)
def test_results_of_functions_of_an_objective_are_checked(evaluate, loss, message):
    grating = wd.profiles.Trapezoid(0.1, 0.4, 0.05, 2.0)
    function = wd.adjoint.objective(
        grating, evaluate or orders, loss or (lambda value: (value.sum(), np.ones_like(value)))
    )
    with pytest.raises((TypeError, ValueError), match=message):
        function(grating.start)
