"""Values and derivatives of ``wd.adjoint`` must equal those of explicit sums, for random surfaces, directions and
optics.

The reference computes derivatives by complex steps: f'(x) = Im f(x + ih)/h for a tiny h, without cancellation.
"""

import math
import warnings

import complex_step
import numpy as np
import pytest
from conftest import hemisphere, slow

import warpdiff as wd

KINDS = ("averaged", "source", "centred", "replicas")
# Seeds of random configurations. Two seeds run by default. The slow tests run all 50 for each kind of coherence.
SEEDS = [*range(2), *(slow(seed) for seed in range(2, 50))]
ORDER_SEEDS = [*range(2), *(slow(seed) for seed in range(2, 25))]
# First and last wavelength of the tables of refractive indices [nm]. The tables have only these two entries, so that
# the index is linear in between and has no kink.
TABLE_NM = 300.0, 900.0
# Largest accepted error of a derivative, relative to the largest derivative with respect to the same variable.
MOST_ERROR, MOST_ERROR_OF_HEIGHTS = 1e-8, 1e-10
HEIGHTS_TRIED = 4


def surface(rng):
    shape = int(rng.choice([1, rng.integers(4, 8)])), int(rng.integers(5, 12))
    pitch = rng.uniform(0.1, 0.3, 2)
    return wd.HeightField.of_known_scale(rng.normal(0.0, 0.08, shape), tuple(pitch))


def directions(rng, heightfield, wavelength_nm):
    """Return a direction to a light, and a direction to a viewer that is near a diffraction order, where reflectance is
    not tiny.
    """
    steps = 1e-3 * wavelength_nm / np.array(heightfield.size_um)[::-1]
    for _ in range(1000):
        light = hemisphere(rng, 1, 0.35)[0]
        order = rng.integers(-3, 4, 2) * (np.array(heightfield.shape)[::-1] > 1)
        x, y = order * steps + rng.normal(0.0, 0.03, 2) - light[:2]
        if x * x + y * y < 0.85:
            return light * rng.uniform(0.5, 2.0), np.array([x, y, np.sqrt(1.0 - x * x - y * y)]) * rng.uniform(0.5, 2.0)
    raise AssertionError("no order propagates")


def optics(rng):
    """Return a random material or index of refraction: arguments for the library, and parameters for the reference."""
    which = rng.integers(4)
    if which == 0:
        ior = float(rng.uniform(1.2, 2.5))
        return {"ior": ior}, {"ior": ior}
    if which == 1:
        return {"ior": math.inf}, {"ior": np.inf}
    n, k = rng.uniform(0.3, 3.0, (2, 2))
    metal, reference = wd.Material.from_nk(TABLE_NM, n, k), {"n": n, "k": k}
    if which == 3:
        film_n, film_k, thickness = rng.uniform(1.2, 2.0, 2), rng.uniform(0.0, 0.2, 2), float(rng.uniform(20.0, 300.0))
        metal = metal.coated(wd.Material.from_nk(TABLE_NM, film_n, film_k), thickness)
        reference |= {"film_nm": thickness, "film_n": film_n, "film_k": film_k}
    return {"material": metal}, reference


def with_indices(p, wavelength_nm):
    """Return the parameters ``p`` of the reference with the indices of refraction at a wavelength added."""
    if "n" not in p:
        return p
    share = (wavelength_nm - TABLE_NM[0]) / (TABLE_NM[1] - TABLE_NM[0])
    at = {key: p[key][0] + share * (p[key][1] - p[key][0]) for key in ("n", "k", "film_n", "film_k") if key in p}
    film = [(at["film_n"], at["film_k"])] if "film_n" in at else []
    return p | {"indices": [*film, (at["n"] + p.get("n_change", 0.0), at["k"] + p.get("k_change", 0.0))]}


def error_of(result, exact, scale):
    """Return the largest error of derivatives, relative to the largest exact one, or to 1e-4 of ``scale`` if larger.

    ``scale`` is the size of the terms whose sum is the derivative.
    """
    return np.max(np.abs(result - exact)) / max(np.max(np.abs(exact)), 1e-4 * scale)


def indices_of(name, heightfield, rng):
    if name == "heights_um":
        return [tuple(rng.integers(heightfield.shape)) for _ in range(HEIGHTS_TRIED)]
    return {"pitch_um": range(2), "to_light": range(3), "to_view": range(3)}.get(name, [None])


REFERENCE_NAMES = {"n": "n_change", "k": "k_change"}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_spectral_derivatives(kind, seed):
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    heightfield, wavelengths = surface(rng), rng.uniform(400.0, 700.0, 2)
    pairs = [directions(rng, heightfield, wavelength) for wavelength in wavelengths]
    lights, views = (np.array(vectors) for vectors in zip(*pairs, strict=True))
    settings, p = optics(rng)
    masking = bool(rng.integers(2))
    if kind == "source":
        p["angular_diameter_deg"] = float(rng.uniform(3.0, 20.0))
        coherence = wd.Coherence(kind, angular_diameter_deg=p["angular_diameter_deg"])
    elif kind == "replicas":
        p["periods"] = tuple(int(count) for count in rng.integers(1, 5, 2))
        coherence = wd.Coherence(kind, periods=p["periods"])
    else:
        p["sigma_um"] = float(rng.uniform(0.2, 1.5))
        if kind == "centred" and rng.integers(2):
            p["centre_um"] = tuple(float(centre) for centre in rng.uniform(0.0, 1.0, 2))
        coherence = wd.Coherence(kind, p["sigma_um"], p.get("centre_um"))
    p |= {"heights_um": heightfield.heights_um, "pitch_um": np.array(heightfield.pitch_um), "height_scale": 1.0}
    p |= {"n_change": 0.0, "k_change": 0.0}
    names = wd.adjoint.variables.available(
        "spectral_reflectance", coherence=coherence, ior=settings.get("ior"), material=settings.get("material"),
        is_outline=False,
    )  # fmt: skip
    value, vjp, _ = wd.adjoint.spectral_reflectance(
        heightfield, lights, views, wavelengths, wrt=names, coherence=coherence, masking=masking, truncation=1e-13,
        **settings,
    )  # fmt: skip

    def reference(q, j):
        own = with_indices(q, wavelengths[j])
        return complex_step.spectral_reflectance(own, kind, wavelengths[j], masking=masking)

    places = [(i, j) for i in range(2) for j in range(2)]
    of_pair = {i: p | {"to_light": lights[i], "to_view": views[i]} for i in range(2)}
    exact = np.array([[reference(of_pair[i], j) for j in range(2)] for i in range(2)])
    np.testing.assert_allclose(value, exact.real, rtol=1e-9, atol=1e-12 * np.abs(exact).max())
    weights = rng.normal(size=value.shape)
    adjoints = vjp(weights)
    for name in names:
        # If only the mirror order contributes to a direction, the derivative with respect to a pitch may be far below
        # the reflectance divided by the pitch. The error of this derivative is then compared with the size of the
        # summands that cancel in it.
        result, expected, scale = [], [], np.abs(weights * value).max() if name == "pitch_um" else 0.0
        key = REFERENCE_NAMES.get(name, name)
        for index in indices_of(name, heightfield, rng):
            slopes = {
                (i, j): weights[i, j] * complex_step.derivative(lambda q, j=j: reference(q, j), of_pair[i], key, index)
                for i, j in places
            }
            scale = max(scale, *np.abs(list(slopes.values())))
            if name in ("to_light", "to_view"):
                result += [adjoints[name][i, index] for i in range(2)]
                expected += [slopes[i, 0] + slopes[i, 1] for i in range(2)]
            elif name in ("n", "k"):
                result += [adjoints[name][j] for j in range(2)]
                expected += [slopes[0, j] + slopes[1, j] for j in range(2)]
            else:
                result.append(adjoints[name] if index is None else adjoints[name][index])
                expected.append(sum(slopes.values()))
        error = error_of(np.array(result), np.array(expected), scale)
        assert error <= (MOST_ERROR_OF_HEIGHTS if name == "heights_um" else MOST_ERROR), (name, error)


@pytest.mark.parametrize("energy", ["stam", "normalised"])
@pytest.mark.parametrize("seed", ORDER_SEEDS)
def test_derivatives_of_orders(energy, seed):
    rng = np.random.default_rng([seed, len(energy)])
    heightfield = surface(rng)
    light, wavelength_nm = hemisphere(rng, 1, 0.35)[0] * 1.7, float(rng.uniform(400.0, 700.0))
    settings, p = optics(rng)
    p |= {
        "heights_um": heightfield.heights_um, "pitch_um": np.array(heightfield.pitch_um), "height_scale": 1.0,
        "to_light": light, "wavelengths_nm": wavelength_nm, "n_change": 0.0, "k_change": 0.0,
    }  # fmt: skip
    names = wd.adjoint.variables.available(
        "order_efficiencies", ior=settings.get("ior"), material=settings.get("material"), is_outline=False
    )
    value, vjp, _ = wd.adjoint.order_efficiencies(
        heightfield, light, wavelength_nm, wrt=names, energy=energy, **settings
    )
    with warnings.catch_warnings():
        # With so few height samples, diffraction orders alias. They alias in the same way in the library and in the
        # reference, so that the warning is not relevant here.
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        orders = wd.order_efficiencies(heightfield, light, wavelength_nm, ior=math.inf, energy="stam").orders
    weights = rng.normal(size=value.shape)
    adjoints = vjp(weights)

    def reference(q):
        own = with_indices(q, q["wavelengths_nm"])
        return complex_step.order_efficiencies(own, orders, q["wavelengths_nm"], normalised=energy == "normalised")

    np.testing.assert_allclose(value[0], reference(p).real, rtol=1e-10, atol=1e-13)
    for name in names:
        places = list(indices_of(name, heightfield, rng))
        slopes = [
            weights[0] * complex_step.derivative(reference, p, REFERENCE_NAMES.get(name, name), index)
            for index in places
        ]  # fmt: skip
        result = [adjoints[name].ravel()[0] if index is None else adjoints[name][index] for index in places]
        # If only order 0 propagates, the derivatives are 0, and the reference has only the rounding errors of the
        # value.
        scale = max(np.max(np.abs(slopes)), np.abs(weights * value).max())
        error = error_of(np.array(result), np.sum(slopes, axis=1), scale)
        assert error <= (MOST_ERROR_OF_HEIGHTS if name == "heights_um" else MOST_ERROR), (name, error)
