"""Factors of the relative reflectance: reflectance R(0) at normal incidence, and gains of pairs of directions.

A gain is the factor between the diffracted power and the relative reflectance. R(θ) is the reflectance of a flat
surface at the angle θ by Schlick's formula.
"""

import math

import numpy as np
import pytest
from conftest import at_angle, hemisphere

import warpdiff as wd
from warpdiff.optics import reflectance_factors

ANGLES = np.array([0.0, 10.0, 45.0, 70.0, 85.0])


def schlick(cosine, normal):
    return normal + (1.0 - normal) * (1.0 - cosine) ** 5


@pytest.mark.parametrize(("ior", "reflectance"), [(1.5, 0.04), (3.0, 0.25), (math.inf, 1.0)])
def test_the_reflectance_at_normal_incidence_follows_from_the_index(ior, reflectance):
    assert reflectance_factors.normal_reflectance(ior) == pytest.approx(reflectance, rel=1e-12)


def test_a_surface_without_an_index_and_a_material_is_glass_of_index_1_5():
    flat = wd.HeightField(np.zeros((8, 8)), 0.09)
    arguments = flat, at_angle(70.0), at_angle(-70.0)
    np.testing.assert_array_equal(wd.reflectance(*arguments), wd.reflectance(*arguments, ior=1.5))


@pytest.mark.parametrize("masking", [False, True])
@pytest.mark.parametrize("normal", [0.04, 1.0])
def test_a_flat_mirror_shows_the_radiance_of_a_source(masking, normal):
    """In the mirror direction, the gain must be R(θ)/R(0) · cos θ, and R(θ)/R(0) for a source of finite size.

    The gain is the factor between diffracted power and relative reflectance. A flat surface masks no light.
    """
    lights, views = at_angle(ANGLES), at_angle(-ANGLES)
    ratio = schlick(np.cos(np.radians(ANGLES)), normal) / normal
    options = {"normal": normal, "masking": masking}
    gains = reflectance_factors.gain(lights, views, **options)
    np.testing.assert_allclose(gains, ratio * np.cos(np.radians(ANGLES)), rtol=1e-12)
    gains = reflectance_factors.gain(lights, views, **options, per_light_cosine=True)
    np.testing.assert_allclose(gains, ratio, rtol=1e-12)


def test_gains_follow_equation_3_15_and_the_masking_of_cook_and_torrance(rng):
    """Gains, the factors from diffracted power to reflectance, must equal equation 3.15 of Single (2014).

    If masking is enabled, they must also have the masking factor of Cook and Torrance.
    """
    lights, views = hemisphere(rng, 200), hemisphere(rng, 200)
    half = (lights + views) / np.linalg.norm(lights + views, axis=1, keepdims=True)
    cos_i, cos_r, cos_h = lights[:, 2], views[:, 2], half[:, 2]
    cos_d = np.sum(half * lights, axis=1)
    overlap = 1.0 + np.sum(lights * views, axis=1)
    expected = schlick(cos_d, 0.04) / 0.04 * overlap**2 / ((cos_i + cos_r) ** 2 * cos_r)
    np.testing.assert_allclose(reflectance_factors.gain(lights, views, normal=0.04, masking=False), expected, rtol=1e-9)
    expected *= np.minimum(1.0, np.minimum(2.0 * cos_h * cos_r / cos_d, 2.0 * cos_h * cos_i / cos_d))
    np.testing.assert_allclose(reflectance_factors.gain(lights, views, normal=0.04, masking=True), expected, rtol=1e-9)
