"""Random height fields, coherence models and directions: results are finite, not negative and symmetric."""

import math

import numpy as np
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

import warpdiff as wd
from bench.truth.numpy_methods import outcome

# The random examples of Hypothesis have a fixed seed, so that a failure occurs on every machine.
SETTINGS = settings(
    derandomize=True, deadline=None, max_examples=25, database=None, suppress_health_check=[HealthCheck.too_slow]
)
# Parts of the error messages with which random arguments may be refused. Any other error fails the test.
REFUSALS = ("crop the height field", "heights are in µm", "so fine that a colour requires", "cannot meet tolerance")


def log_uniform(low, high):
    return st.floats(math.log(low), math.log(high)).map(lambda x: min(max(math.exp(x), low), high))


@st.composite
def height_fields(draw):
    """Return a random height field: rough, smooth or flat, at most 0.6 µm high, with 1 to 24 samples per axis.

    Higher fields would require more terms of the Taylor series, and each number of terms compiles another kernel. They
    are tested in tests/planner/test_regimes.py.
    """
    ny, nx = draw(st.one_of(
        st.sampled_from([(1, 1), (1, 2), (2, 1), (1, 24), (24, 1), (2, 2)]),
        st.tuples(st.integers(1, 24), st.integers(1, 24)),
    ))  # fmt: skip
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    heights = rng.uniform(-0.5, 0.5, (ny, nx))
    if draw(st.booleans()):
        x, y = np.arange(nx) / nx, np.arange(ny)[:, None] / ny
        heights = np.cos(2.0 * np.pi * (x + rng.integers(3) * y)) / 2.0
    scale = draw(st.one_of(st.sampled_from([0.0, 1e-12, 1e-6, 0.3, 0.6]), log_uniform(1e-3, 0.6)))
    pitch = draw(st.tuples(log_uniform(0.02, 0.3), log_uniform(0.02, 0.3)))
    return wd.HeightField.of_known_scale(heights * scale + draw(st.sampled_from([0.0, -1.0, 10.0, -1000.0])), pitch)


@st.composite
def vectors(draw, count):
    """Return random vectors, most of them above the horizon. Lengths differ, and components may be 0, tiny or huge."""
    component = st.one_of(
        st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-300, -1e-300, 1e-30, 1e-8, -1e-8, 1e-6, 1e30, 1e300]),
        st.floats(-1.0, 1.0),
    )
    vector = st.tuples(component, component, component).filter(any)
    # Most vectors are above the horizon, because reflectances below it are 0.
    upward = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), log_uniform(1e-5, 3.0))
    return np.array([draw(st.one_of(upward, upward, vector)) for _ in range(count)])


coherences = st.one_of(
    st.builds(wd.Coherence, st.sampled_from(["averaged", "centred"]), log_uniform(0.1, 1000.0)),
    st.builds(lambda d: wd.Coherence("source", angular_diameter_deg=d), log_uniform(1e-3, 30.0)),
    st.builds(lambda ny, nx: wd.Coherence("replicas", periods=(ny, nx)), log_uniform(1.0, 5000.0).map(round),
              log_uniform(1.0, 5000.0).map(round)),
)  # fmt: skip
wavelengths = st.lists(log_uniform(250.0, 10_000.0), min_size=1, max_size=4)
reciprocal = coherences.filter(lambda each: each.kind != "source")


def computed(call, *arguments, **keywords):
    """Return the result of ``call`` with the arguments, or None if it is refused for a known reason."""
    values, message = outcome(call, *arguments, **keywords, strict=False)
    if values is None:
        event("refused")
        assert any(each in message for each in REFUSALS), message
        return None
    assert np.isfinite(values).all()
    assert values.min(initial=0.0) >= 0.0
    return values


def nearly(a, b):
    """Check that two results are equal to float32 accuracy, except where both are dark."""
    np.testing.assert_allclose(a, b, rtol=3e-3, atol=3e-5 * max(float(a.max()), float(b.max()), 1e-30))


@SETTINGS
@given(st.data())
def test_spectra_are_finite_and_not_negative(data):
    heightfield, coherence, nanometres = data.draw(height_fields()), data.draw(coherences), data.draw(wavelengths)
    count = data.draw(st.sampled_from([1, 3, 20]))
    lights, views = data.draw(vectors(count)), data.draw(vectors(count))
    rho = computed(
        wd.spectral_reflectance, heightfield, lights, views, nanometres, coherence=coherence,
        tolerance=data.draw(st.sampled_from([1e-1, 1e-2, 1e-4])), masking=data.draw(st.booleans()),
        ior=data.draw(st.sampled_from([1.5, 1.0001, math.inf])),
    )  # fmt: skip
    if rho is None:
        return
    assert rho.shape == (count, len(nanometres))
    assert rho.dtype == np.float32
    below = (lights[:, 2] <= 0.0) | (views[:, 2] <= 0.0)
    assert np.all(rho[below] == 0.0)
    event("lit" if rho.max() > 0.0 else "dark")


@SETTINGS
@given(st.data())
def test_every_method_gives_finite_values(data):
    heightfield, coherence = data.draw(height_fields()), data.draw(coherences)
    methods = ["low-rank", "jacobi-anger", "taylor", "taylor-uncentred"] + ["power"] * coherence.adds_powers
    lights, views = data.draw(vectors(3)), data.draw(vectors(3))
    rho = computed(
        wd.spectral_reflectance, heightfield, lights, views, [400.0, 700.0], coherence=coherence,
        method=data.draw(st.sampled_from(methods)),
    )  # fmt: skip
    assert rho is None or rho.shape == (3, 2)


@settings(SETTINGS, max_examples=15)
@given(st.data())
def test_colours_are_finite_and_not_negative(data):
    heightfield, coherence = data.draw(height_fields()), data.draw(coherences)
    count = data.draw(st.sampled_from([1, 3, 20]))
    xyz = computed(
        wd.reflectance, heightfield, data.draw(vectors(count)), data.draw(vectors(count)), coherence=coherence
    )
    if xyz is not None:
        assert xyz.shape == (count, 3)
        assert xyz.dtype == np.float32


@settings(SETTINGS, max_examples=15)
@given(st.data())
def test_a_single_direction_gives_the_same_values_as_a_row_of_many(data):
    heightfield, coherence, nanometres = data.draw(height_fields()), data.draw(coherences), data.draw(wavelengths)
    light, view = data.draw(vectors(1))[0], data.draw(vectors(1))[0]
    one = computed(wd.spectral_reflectance, heightfield, light, view, nanometres, coherence=coherence)
    if one is None:
        return
    many = computed(wd.spectral_reflectance, heightfield, [light, light], view, nanometres, coherence=coherence)
    assert one.shape == (len(nanometres),)
    np.testing.assert_array_equal(np.broadcast_to(one, many.shape), many)


@SETTINGS
@given(st.data())
def test_the_brdf_is_reciprocal(data):
    heightfield, coherence, nanometres = data.draw(height_fields()), data.draw(reciprocal), data.draw(wavelengths)
    lights, views = data.draw(vectors(3)), data.draw(vectors(3))
    there = computed(wd.brdf, heightfield, lights, views, nanometres, coherence=coherence, tolerance=1e-4)
    if there is not None:
        nearly(there, computed(wd.brdf, heightfield, views, lights, nanometres, coherence=coherence, tolerance=1e-4))


@SETTINGS
@given(st.data())
def test_a_constant_height_changes_nothing(data):
    heightfield, coherence, nanometres = data.draw(height_fields()), data.draw(coherences), data.draw(wavelengths)
    lights, views = data.draw(vectors(3)), data.draw(vectors(3))
    # The test adds a constant to all heights. The heights are first rounded to multiples of 2⁻²⁰ µm, so that the
    # addition has no rounding error.
    heights = np.round((heightfield.heights_um - heightfield.heights_um.min()) * 2.0**20) / 2.0**20
    raised = heights + data.draw(st.sampled_from([1.0, -3.5, 100.0]))
    here, there = (
        computed(
            wd.spectral_reflectance, wd.HeightField.of_known_scale(each, heightfield.pitch_um), lights, views,
            nanometres, coherence=coherence, tolerance=1e-4,
        )
        for each in (heights, raised)
    )  # fmt: skip
    if here is not None:
        nearly(here, there)


@SETTINGS
@given(st.data())
def test_mirroring_surface_and_directions_changes_nothing(data):
    heightfield, coherence, nanometres = data.draw(height_fields()), data.draw(coherences), data.draw(wavelengths)
    lights, views = data.draw(vectors(3)), data.draw(vectors(3))
    # Mirroring x → −x keeps the position of the first height sample, and reverses the order of the others.
    flipped = wd.HeightField.of_known_scale(np.roll(heightfield.heights_um[:, ::-1], 1, axis=1), heightfield.pitch_um)
    if coherence.kind == "centred":
        # The coherence window is centred on a sample. For a centre between samples, Fourier coefficients at and beyond
        # the Nyquist limit have phases that depend on the sign of the frequency, so that mirroring would change the
        # result.
        centre = tuple((n // 3) * pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True))
        coherence = wd.Coherence("centred", coherence.sigma_um, centre_um=centre)
        mirrored = wd.Coherence("centred", coherence.sigma_um, centre_um=(centre[0], -centre[1]))
    else:
        mirrored = coherence
    if coherence.kind == "replicas":
        # The kind "replicas" sums over whole periods. Here the mirrored surface is also shifted by one height sample,
        # which changes only the phase of the reflected wave.
        flipped = wd.HeightField.of_known_scale(heightfield.heights_um[:, ::-1], heightfield.pitch_um)
    mirror = np.array([-1.0, 1.0, 1.0])
    here = computed(
        wd.spectral_reflectance, heightfield, lights, views, nanometres, coherence=coherence, tolerance=1e-4
    )
    if here is None:
        return
    there = computed(
        wd.spectral_reflectance, flipped, lights * mirror, views * mirror, nanometres, coherence=mirrored,
        tolerance=1e-4,
    )  # fmt: skip
    nearly(here, there)
