"""Conversion of angles to unit vectors, and of unit vectors to angles."""

import math

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.core.angles import angles_deg, signed_angles_deg


def test_directions_have_the_components_of_their_angles():
    np.testing.assert_allclose(wd.direction(60.0, 90.0), [0.0, math.sqrt(0.75), 0.5], atol=1e-15)
    np.testing.assert_allclose(wd.direction(-60.0), [-math.sqrt(0.75), 0.0, 0.5], atol=1e-15)
    assert wd.direction(0.0).shape == (3,)
    assert wd.direction([[0.0], [10.0]], [0.0, 90.0, 180.0]).shape == (2, 3, 3)


def test_angles_are_those_that_directions_were_made_from(rng):
    theta, phi = rng.uniform(1.0, 89.0, 50), rng.uniform(-179.0, 179.0, 50)
    found_theta, found_phi = angles_deg(wd.direction(theta, phi))
    # ``angles_deg`` rounds angles to ten decimal places, so that errors of up to 5e-11 degrees are expected.
    np.testing.assert_allclose(found_theta, theta, rtol=0.0, atol=6e-11)
    np.testing.assert_allclose(found_phi, phi, rtol=0.0, atol=6e-11)
    assert angles_deg(wd.direction(20.0))[0] == 20.0
    signed = np.array([-80.0, -1.0, 0.0, 30.0])
    for azimuth in (0.0, 90.0):
        np.testing.assert_allclose(signed_angles_deg(wd.direction(signed, azimuth)), signed, atol=1e-12)


def test_the_normal_has_the_azimuth_zero():
    assert [float(angle) for angle in angles_deg(np.array([-0.0, -0.0, 1.0]))] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((91.0,), "theta_deg must be -90 to 90 degrees, got ±91"), ((0.0, 361.0), "phi_deg must be -360 to 360 degrees"),
     (([0.0, 1.0], [1.0, 2.0, 3.0]), r"theta_deg and phi_deg must have the same shape, got \(2,\) and \(3,\)")],
)  # fmt: skip
def test_angles_out_of_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        wd.direction(*arguments)
