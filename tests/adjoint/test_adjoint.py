"""``wd.adjoint``: vjp is the transpose of jvp, values equal those of plain functions, and wrong names raise errors.

Functions of ``wd.adjoint`` return a value and two functions for its derivatives. J is the matrix of derivatives of the
value with respect to the variables. jvp multiplies a change of the variables by J; vjp multiplies by the transpose Jᵀ.
"""

import functools
import math

import numpy as np
import pytest
import trimesh
from conftest import coherence_of, hemisphere, noise

import warpdiff as wd
from warpdiff.adjoint import variables
from warpdiff.adjoint.coefficient_rows import CoefficientRows, add_rows
from warpdiff.adjoint.gaussian_lobes import GaussianLobes, Pairs, block_of, exponent_of
from warpdiff.adjoint.height_terms import HeightTerms
from warpdiff.adjoint.sites import Sites
from warpdiff.core import memory

FIELD = noise((9, 14), (0.11, 0.13))
WAVELENGTHS = [430.0, 610.0]
KINDS = ("averaged", "source", "centred", "replicas")
FILM = wd.Material.metal("Cr").coated(wd.Material.dielectric(1.4), 90.0)


def coherence(kind):
    return coherence_of(kind, sigma_um=0.5, angular_diameter_deg=12.0)


def directions(rng, count=3):
    return hemisphere(rng, count, 0.4), hemisphere(rng, count, 0.4)


def changes_for(adjoints, rng):
    return {name: rng.normal(size=array.shape) for name, array in adjoints.items()}


def check_transpose(linearised, rng):
    """Check ⟨y, J x⟩ = ⟨Jᵀ y, x⟩ for random x and y.

    J is the matrix of derivatives: jvp gives J x, and vjp gives Jᵀ y. The check is made for each variable alone, and
    for all variables together.
    """
    y = rng.normal(size=linearised.value.shape)
    adjoints = linearised.vjp(y)
    changes = changes_for(adjoints, rng)
    total = 0.0
    for name, change in changes.items():
        expected = np.sum(adjoints[name] * change)
        scale = np.sum(np.abs(adjoints[name] * change))
        assert abs(np.sum(y * linearised.jvp(**{name: change})) - expected) <= 1e-12 * scale, name
        total += expected
    assert np.sum(y * linearised.jvp(**changes)) == pytest.approx(total, rel=1e-11)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("optics", [{"ior": 1.4}, {"material": FILM}])
def test_tangents_of_spectra_are_the_transposes_of_adjoints(kind, optics, rng):
    names = variables.available("spectral_reflectance", coherence=coherence(kind), is_outline=False, **optics)
    result = wd.adjoint.spectral_reflectance(
        FIELD, *directions(rng), WAVELENGTHS, wrt=names, coherence=coherence(kind), **optics
    )
    check_transpose(result, rng)


@pytest.mark.parametrize("kind", ["averaged", "source"])
def test_tangents_of_colours_are_the_transposes_of_adjoints(kind, rng):
    names = variables.available("reflectance", coherence=coherence(kind), ior=1.4, is_outline=False)
    light = hemisphere(rng, 1, 0.4)[0] * 2.0
    result = wd.adjoint.reflectance(FIELD, light, directions(rng)[1], wrt=names, coherence=coherence(kind), ior=1.4)
    check_transpose(result, rng)


@pytest.mark.parametrize("energy", ["stam", "normalised"])
@pytest.mark.parametrize("optics", [{"ior": 1.4}, {"material": FILM}])
def test_tangents_of_orders_are_the_transposes_of_adjoints(energy, optics, rng):
    names = variables.available("order_efficiencies", is_outline=False, **optics)
    lights = directions(rng, 2)[0] * 1.5
    check_transpose(wd.adjoint.order_efficiencies(FIELD, lights, WAVELENGTHS, wrt=names, energy=energy, **optics), rng)


def test_transforms_and_their_transposes(rng):
    s, r = rng.integers(-30, 30, (2, 50))
    for shape in ((9, 14), (8, 7), (1, 6), (5, 1)):
        sites = Sites(shape, s, r)
        values, adjoints = rng.normal(size=shape), rng.normal(size=(sites.count, 2)) @ [1.0, 1j]
        transform = sites.transform(values)
        full = np.fft.ifft2(values)[s % shape[0], r % shape[1]]
        own = np.concatenate([transform, np.conj(transform)])[sites.places]
        np.testing.assert_allclose(own, full, atol=1e-15)
        forward = np.sum((np.conj(adjoints) * transform).real)
        assert forward == pytest.approx(np.sum(sites.transposed(adjoints) * values), rel=1e-12)


def test_sums_under_lobes_and_their_transposes(rng):
    count, exponent = 300, exponent_of(1e-13)
    forms = np.stack(
        [rng.uniform(1.0, 9.0, count), rng.uniform(-0.5, 0.5, count), rng.uniform(1.0, 9.0, count)], axis=1
    )
    pairs = Pairs(rng.normal(0.0, 1.5, (count, 2)), forms, rng.uniform(2.0, 4.0, count))
    block = block_of(pairs, exponent, FIELD.shape, FIELD.size_um)
    sites = Sites(FIELD.shape, *block.orders())
    rows = CoefficientRows(sites.count, (2.0, 4.0), 12, powers=True, together=100)
    rows.fill(HeightTerms(FIELD.heights_um, sites, rows.nodes, 20))
    lobes = GaussianLobes(rows, block, sites.places, FIELD.size_um, exponent)
    change, adjoints = rng.normal(size=rows.rows[0].shape), rng.normal(size=count)
    spread = np.zeros((block.size, rows.terms))
    lobes.spread(pairs, adjoints, spread)
    folded = np.zeros_like(change)
    add_rows(sites.places, spread, folded)
    forward, transposed = adjoints @ lobes.sums(pairs, change), np.sum(folded * change)
    assert abs(forward - transposed) <= 1e-12 * np.sum(np.abs(folded * change))


@pytest.mark.parametrize("kind", KINDS)
def test_values_equal_those_of_the_direct_method(kind, rng):
    lights, views = directions(rng)
    settings = {"coherence": coherence(kind), "material": FILM}
    value = wd.adjoint.spectral_reflectance(
        FIELD, lights, views, WAVELENGTHS, truncation=1e-13, wrt=(), **settings
    ).value
    exact = wd.spectral_reflectance(FIELD, lights, views, WAVELENGTHS, method="direct", **settings)
    np.testing.assert_allclose(value, exact, rtol=1e-10, atol=1e-13 * exact.max())


@pytest.mark.parametrize("kind", KINDS)
def test_colours_equal_those_of_the_direct_method(kind):
    settings = {"coherence": coherence(kind), "illuminant": "A"}
    light, views = (0.2, 0.1, 1.0), [(0.0, 0.0, 1.0), (0.5, 0.2, 1.0)]
    value = wd.adjoint.reflectance(FIELD, light, views, truncation=1e-6, wrt=(), **settings).value
    exact = wd.reflectance(FIELD, light, views, method="direct", tolerance=1e-4, **settings)
    np.testing.assert_allclose(value, exact, atol=1e-4 * exact.max())


@pytest.mark.parametrize("settings", [{}, {"ior": math.inf}, {"material": FILM, "energy": "normalised"}])
def test_orders_equal_those_of_the_library(settings):
    lights = [(0.2, 0.1, 1.0), (-0.5, 0.4, 1.0)]
    value = wd.adjoint.order_efficiencies(FIELD, lights, WAVELENGTHS, wrt=(), **settings).value
    exact = wd.order_efficiencies(FIELD, lights, WAVELENGTHS, **settings).efficiencies
    np.testing.assert_allclose(value, exact, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("kind", ["averaged", "source", "centred"])
@pytest.mark.parametrize("truncation", [1e-2, 1e-4, 1e-8])
def test_truncation_is_the_largest_relative_error(kind, truncation, rng):
    views = hemisphere(rng, 20, 0.3)
    arguments = (FIELD, (0.2, 0.1, 1.0), views, WAVELENGTHS)
    settings = {"coherence": coherence(kind), "wrt": ("heights_um",)}
    exact = wd.adjoint.spectral_reflectance(*arguments, truncation=1e-13, **settings)
    rough = wd.adjoint.spectral_reflectance(*arguments, truncation=truncation, **settings)
    assert np.abs(rough.value - exact.value).max() <= truncation * exact.value.max()
    weights = rng.normal(size=exact.value.shape)
    gradients = [result.vjp(weights)["heights_um"] for result in (rough, exact)]
    assert np.abs(gradients[0] - gradients[1]).max() <= truncation * np.abs(gradients[1]).max()


@pytest.mark.parametrize("depth_um", [1e-4, 1.0, 10.0, 30.0])
def test_series_are_long_enough_for_any_depth(depth_um):
    """Order efficiencies must be accurate for gratings of any depth.

    Rounding errors of Bessel functions must not end the series of deep gratings after too few terms.
    """
    grating = wd.gratings.sinusoidal(40.0, depth_um, samples=512)
    value = wd.adjoint.order_efficiencies(grating, (0.3, 0.0, 1.0), [450.0, 600.0], wrt=()).value
    exact = wd.order_efficiencies(grating, (0.3, 0.0, 1.0), [450.0, 600.0]).efficiencies
    np.testing.assert_allclose(value, exact, rtol=1e-9, atol=1e-13)


def test_gradients_by_heights_and_by_their_scale_agree(rng):
    """The derivative with respect to a common factor of all heights, ``height_scale``, must equal Σ h ∂/∂h.

    The sum is over the derivatives with respect to the single heights h.
    """
    result = wd.adjoint.reflectance(FIELD, *directions(rng), wrt=("heights_um", "height_scale"))
    adjoints = result.vjp(rng.normal(size=result.value.shape))
    assert np.sum(adjoints["heights_um"] * FIELD.heights_um) == pytest.approx(adjoints["height_scale"], rel=1e-6)


def test_flat_surfaces_have_derivatives():
    flat = wd.HeightField(np.zeros((4, 4)), 0.5)
    value, vjp, _ = wd.adjoint.spectral_reflectance(flat, (0.1, 0.0, 1.0), (-0.1, 0.0, 1.0), 500.0)
    assert value[0] > 0.5
    # The power of a flat surface in the mirror direction is a maximum, so that its derivatives with respect to the
    # heights are 0.
    np.testing.assert_allclose(vjp([1.0])["heights_um"], 0.0, atol=1e-9)


def test_directions_below_the_horizon_have_no_reflectance():
    views, names = [(0.0, 0.0, 1.0), (1.0, 0.0, -0.2)], ("to_view", "heights_um")
    value, vjp, jvp = wd.adjoint.spectral_reflectance(
        FIELD, (0, 0.1, 1), views, 500.0, wrt=names, coherence=coherence("averaged")
    )
    assert value[0, 0] > 0.0
    assert value[1, 0] == 0.0
    np.testing.assert_array_equal(vjp([[1.0], [1.0]])["to_view"][1], 0.0)
    assert jvp(to_view=np.ones((2, 3)))[1, 0] == 0.0
    with pytest.warns(wd.WarpdiffWarning, match="horizon"):
        dark = wd.adjoint.spectral_reflectance(FIELD, (0, 0, 1), views[1], 500.0)
    np.testing.assert_array_equal(dark.vjp([1.0])["heights_um"], np.zeros(FIELD.shape))
    assert dark.jvp(heights_um=np.ones(FIELD.shape)).shape == (1,)


WITHOUT_DERIVATIVE = [
    ({"wrt": ("duty",)}, "Trapezoid"), ({"wrt": ("heights",)}, "did you mean 'heights_um'"),
    ({"wrt": ("levelled",)}, "levelled field"), ({"wrt": ("despiked",)}, "cleaned field"),
    ({"wrt": ("filled",)}, "filled field"), ({"wrt": ("rgb",)}, "XYZ"), ({"wrt": ("uint8",)}, "XYZ"),
    ({"wrt": ("periods",)}, "integer"), ({"wrt": ("missing",)}, "no height"),
    ({"wrt": ("angular_diameter_deg",)}, 'requires: coherence "source"'),
    ({"wrt": ("sigma_um",), "coherence": wd.Coherence("source")}, 'requires: coherence "averaged"'),
    ({"wrt": ("n",)}, "contains 'n', which has no derivative here"),
    ({"wrt": ("film_nm",)}, "requires: material with a film"),
    ({"wrt": ("ior",), "ior": math.inf}, "requires: finite index"), ({"wrt": ("vertices",)}, "requires: outline"),
    ({"wrt": ("ior",), "material": FILM}, "requires: finite index"),
    ({"wrt": ("wavelengths_nm",)}, "no derivative here"),
    ({"method": "power"}, "truncation"), ({"plan": None}, "truncation"), ({"tolerance": 0.1}, "truncation"),
    ({"integration": "table"}, "truncation"), ({"energy": "normalised"}, "energy='stam'"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "message"), WITHOUT_DERIVATIVE)
def test_a_variable_without_derivative_raises_and_lists_those_that_have_one(arguments, message):
    for function, more in ((wd.adjoint.spectral_reflectance, (500.0,)), (wd.adjoint.reflectance, ())):
        with pytest.raises(ValueError, match=message) as caught:
            function(FIELD, (0, 0, 1), (0, 0, 1), *more, **arguments)
        assert "has derivatives by heights_um" in str(caught.value)


def test_orders_have_derivatives_by_wavelengths_but_not_by_the_coherence():
    with pytest.raises(ValueError, match="order_efficiencies has derivatives by heights_um"):
        wd.adjoint.order_efficiencies(FIELD, (0, 0, 1), 500.0, wrt=("sigma_um",))
    with pytest.raises(ValueError, match="requires: material"):
        wd.adjoint.order_efficiencies(FIELD, (0, 0, 1), 500.0, wrt=("n",))


def test_arguments_are_checked(rng):
    call = (FIELD, (0.0, 0.1, 1.0), (0.0, 0.0, 1.0), 500.0)
    with pytest.raises(TypeError, match="must be a tuple of names"):
        wd.adjoint.spectral_reflectance(*call, wrt="heights_um")
    with pytest.raises(ValueError, match="truncation"):
        wd.adjoint.spectral_reflectance(*call, truncation=1e-15)
    with pytest.raises(TypeError, match="did you mean"):
        wd.adjoint.spectral_reflectance(*call, truncatoin=1e-8)
    with pytest.raises(TypeError, match="HeightField or a warpdiff"):
        wd.adjoint.spectral_reflectance(np.zeros((3, 3)), *call[1:])
    with pytest.raises(ValueError, match="above the horizon"):
        wd.adjoint.order_efficiencies(FIELD, (0, 1, -1), 500.0)
    missing = FIELD.heights_um.copy()
    missing[2, 3] = np.nan
    with pytest.raises(ValueError, match="missing"):
        wd.adjoint.spectral_reflectance(wd.HeightField(missing, 0.1), *call[1:])
    result = wd.adjoint.spectral_reflectance(*call)
    with pytest.raises(ValueError, match="shape of the value"):
        result.vjp([1.0, 2.0])
    with pytest.raises(TypeError, match="no argument height_um; did you mean 'heights_um'"):
        result.jvp(height_um=FIELD.heights_um)
    with pytest.raises(ValueError, match="must have the shape"):
        result.jvp(heights_um=rng.normal(size=3))
    outline = wd.profiles.Outline([0.0, 0.5], [0.0, 0.1], 1.0)
    with pytest.raises(ValueError, match="requires samples"):
        wd.adjoint.spectral_reflectance(outline, *call[1:], wrt=(), coherence=coherence("replicas"))
    deep = wd.gratings.sinusoidal(40.0, 60.0, samples=512)
    with pytest.raises(ValueError, match="terms; at most 800"):
        wd.adjoint.spectral_reflectance(deep, (0, 0.1, 1), [(0, 0, 1), (0.9, 0, 0.1)], [300.0, 700.0], wrt=())
    with pytest.raises(ValueError, match="wavelengths; at most"):
        wd.adjoint.reflectance(FIELD, (0, 0, 1), (0.5, 0, 1), truncation=1e-13, coherence=wd.Coherence(sigma_um=500.0))


OUTLINE = wd.profiles.Outline([0.0, 0.3, 0.6], [0.0, 0.1, 0.05], 1.3)
# Arguments with which a function of ``wd.adjoint`` has a derivative with respect to a variable, by the name of the
# variable. For other variables, the default arguments suffice.
NEEDED = {
    "angular_diameter_deg": {"coherence": coherence("source")}, "sigma_um": {"coherence": coherence("centred")},
    "n": {"material": FILM}, "k": {"material": FILM}, "film_nm": {"material": FILM},
}  # fmt: skip


@functools.cache
def picture():
    """Return a renderer of a flat square."""
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
    view, light = wd.View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), width=4, height=3), wd.DirectionalLight((0.0, 0.1, 1.0))
    return wd.Renderer(mesh, noise((8, 9), (0.09, 0.09)), light, view, footprint=False, refine=False, tolerance=0.1)


@pytest.mark.parametrize("name", variables.VARIABLES)
def test_the_table_of_derivatives_is_true(name):
    """The table of the documentation states for each function and variable whether a derivative exists.

    A function must accept the variables for which the table says "yes" in its column, and refuse all others.
    """
    row = next(line for line in variables.table().splitlines() if f"| `{name}` |" in line)
    marks = [cell.strip() == "yes" for cell in row.split("|")[2:6]]
    surface = OUTLINE if name in ("vertices", "period_um") else FIELD
    light, view = (0.0, 0.1, 1.0), (0.1, 0.0, 1.0)
    needed = NEEDED.get(name, {})
    optics = {key: value for key, value in needed.items() if key != "coherence"}
    calls = [
        lambda: wd.adjoint.order_efficiencies(surface, light, 500.0, wrt=(name,), **optics),
        lambda: wd.adjoint.spectral_reflectance(surface, light, view, 500.0, wrt=(name,), **needed),
        lambda: wd.adjoint.reflectance(surface, light, view, wrt=(name,), **needed),
        lambda: wd.adjoint.pixels(picture(), surface, wd.DirectionalLight(light), wrt=(name,)),
    ]
    for has_derivative, call in zip(marks, calls, strict=True):
        if has_derivative:
            result = call()
            (adjoint,) = result.vjp(np.ones_like(result.value)).values()
            assert np.isfinite(adjoint).all()
        else:
            with pytest.raises(ValueError, match="has no derivative"):
                call()


def test_normalised_orders_have_derivatives_up_to_600_orders():
    large = wd.HeightField.of_known_scale(np.random.default_rng(0).normal(0.0, 0.05, (60, 60)), 0.2)
    with pytest.raises(ValueError, match="at most 600 orders"):
        wd.adjoint.order_efficiencies(large, (0, 0, 1), 500.0, ior=math.inf)
    assert wd.adjoint.order_efficiencies(large, (0, 0, 1), 500.0, ior=math.inf, energy="stam").value.sum() > 0.5


def test_too_much_memory_is_refused_before_work_starts(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 1e4)
    with pytest.raises(MemoryError, match="GB are free"):
        wd.adjoint.spectral_reflectance(FIELD, (0, 0.1, 1), (0.2, 0, 1), 500.0)
    with pytest.raises(MemoryError, match="GB are free"):
        wd.adjoint.order_efficiencies(noise((300, 300)), (0, 0.1, 1), 500.0)


def test_kinks_give_one_warning_with_their_number():
    views = [(-0.9, 0.0, 0.4), (0.9, 0.0, 0.4), (0.5, 0.0, 1.0)]
    with pytest.warns(wd.WarpdiffWarning, match="1 of 3 pairs of directions are at the kink"):
        wd.adjoint.spectral_reflectance(FIELD, (0.9, 0.1e-12, 0.4), views, 500.0, wrt=("to_view",))
    period = 1.0
    # At normal incidence, the first diffraction order leaves along the surface if the wavelength λ equals the period.
    grating = wd.gratings.sinusoidal(period, 0.1)
    for side in (-1e-8, 1e-8):
        with pytest.warns(wd.WarpdiffWarning, match="1 of 2 sets of orders have an order at the horizon"):
            wd.adjoint.order_efficiencies(grating, (0, 0, 1), [1e3 * period * (1.0 + side), 600.0], wrt=("pitch_um",))
    # Order efficiencies are smooth functions of the heights even if an order is at the horizon, so that no warning is
    # expected.
    wd.adjoint.order_efficiencies(grating, (0, 0, 1), [1e3 * period * (1.0 - 1e-8), 600.0])
    aluminium = wd.Material.metal("Al")
    node = float(np.asarray(aluminium.wavelengths_nm)[5])
    with pytest.warns(wd.WarpdiffWarning, match="1 of 1 wavelengths are entries of the table"):
        wd.adjoint.order_efficiencies(grating, (0, 0, 1), node, material=aluminium, wrt=("wavelengths_nm",))
