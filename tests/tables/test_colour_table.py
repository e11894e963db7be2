"""Colour tables, compared with the float64 reference, closed forms and sampled integration.

A ring is a circle of constant |(u, v)| in the polar grid of a table, and an azimuth is a line of constant polar angle.
An octave is the set of rings between one radius and twice this radius. (u, v, w) is the scattering vector. A row is the
table's entry at one ring and azimuth. It has weights of basis functions of w for X, Y and Z. A plan has the numbers of
a computation.
"""

import dataclasses
import itertools

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, launch, relative_errors, slow

import warpdiff as wd
from bench.truth import reference
from warpdiff.kernels import coefficient_sum
from warpdiff.kernels import spectrum_sampling as kernels
from warpdiff.kernels.colour_lookup import FILTER_REACH, lookup
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.tables import colour_curves, colour_table
from warpdiff.tables.lookup import ColourLookup
from warpdiff.tables.mip_layout import MipLayout

# This coherence window is so short that the diffraction orders of a 12.8 µm patch overlap. Each colour is then a sum of
# many orders.
SHORT = wd.Coherence(sigma_um=3.25)


def truth(heightfield, lights, views, coherence, tolerance=1e-4):
    """Return XYZ computed by the float64 reference."""
    scattering_vectors = -lights - views
    gains = reflectance_factors.gain(lights, views, normal=reflectance_factors.normal_reflectance(1.5), masking=True)
    return gains[:, None] * reference.colours(heightfield, scattering_vectors, lights, coherence, tolerance=tolerance)


@pytest.mark.parametrize(
    ("kind", "tolerance"), [("averaged", 2e-2), ("centred", 1e-1), slow("averaged", 1e-1), slow("centred", 2e-2)]
)
def test_a_table_meets_its_tolerance(fingers, kind, tolerance, rng):
    coherence = wd.Coherence(kind, 6.0)
    lights, views = hemisphere(rng, 100), hemisphere(rng, 100)
    options = {"tolerance": tolerance, "coherence": coherence, "method": "low-rank", "integration": "table"}
    plan = wd.plan(fingers, lights, views, **options)
    assert plan.rings_per_octave > 0
    assert plan.error <= tolerance
    result = wd.reflectance(fingers, lights, views, plan=plan)
    errors = relative_errors(result, truth(fingers, lights, views, coherence, tolerance=1e-3))
    assert np.percentile(errors, 99.0) <= tolerance
    assert np.percentile(errors, 99.0) >= 0.05 * plan.error


@pytest.mark.parametrize("kind", ["averaged", slow("centred")])
def test_more_rings_and_azimuths_have_smaller_errors(fingers, kind, rng):
    coherence = wd.Coherence(kind, 6.0)
    lights, views = hemisphere(rng, 60), hemisphere(rng, 60)
    exact = truth(fingers, lights, views, coherence)
    plan = wd.plan(fingers, lights, views, coherence=coherence, method="low-rank", tolerance=1e-3)
    errors = []
    for nodes, rays in ((12, 1.0), (24, 1.4), (48, 1.8), (80, 2.1)):
        sized = dataclasses.replace(plan, rings_per_octave=nodes, azimuths_per_width=rays)
        errors.append(np.percentile(relative_errors(wd.reflectance(fingers, lights, views, plan=sized), exact), 90.0))
    # The CIE colour-matching functions have kinks. Splines that are fitted to them have errors which decrease only in
    # proportion to the distance between their nodes. The nodes are the rings of a table, circles of constant |(u, v)|.
    assert all(finer < 0.6 * previews for previews, finer in itertools.pairwise(errors))
    assert errors[-1] < 5e-3


def test_the_smallest_tables_have_approximate_colours(fingers, rng):
    lights, views = hemisphere(rng, 200), hemisphere(rng, 200)
    plan = wd.plan(fingers, lights, views, coherence=SHORT, method="low-rank", tolerance=1e-2)
    exact = wd.reflectance(fingers, lights, views, plan=plan)
    for nodes in (4, 5, 7):
        # All table sizes have the same number of basis functions of w, the normal component of the scattering vector.
        # Each number would require another compiled kernel.
        sized = dataclasses.replace(plan, rings_per_octave=nodes, azimuths_per_width=1.1, w_basis_size=12)
        errors = relative_errors(wd.reflectance(fingers, lights, views, plan=sized), exact)
        assert np.median(errors) < 0.2
        assert errors.max() < 2.0


@pytest.mark.parametrize("powers", [True, False])
@pytest.mark.parametrize(
    ("counts", "lengths", "falloff"),
    [
        ((40, 44), (6.0, 5.0), 22.0),  # patch with a moderate number of neighbouring coefficients
        ((64, 64), (9.0, 9.0), 2.5),  # patch with more rows and columns than a SIMD vector has elements
        ((5, 3), (2.0, 1.6), 2.0),  # patch so small that periodic coefficients occur several times
        ((1, 48), (0.02, 6.0), 22.0),
        ((48, 1), (6.0, 0.02), 22.0),
    ],
    ids=str,
)
def test_azimuth_samples_are_sums_of_gaussians_projected_on_splines(powers, counts, lengths, falloff, rng):
    """Samples of the spectrum along azimuths (polar angles) must equal sums over all Fourier coefficients.

    The spectrum is projected on splines. Each coefficient has a Gaussian weight by its distance from the sample. The
    kernel's samples are compared with sums in float64.
    """
    lanes, width, nodes, divisions, rays = 8, 8 if powers else 16, 8, 4, 8
    parts = 1 if powers else 2
    rows = rng.normal(size=(*counts, parts, lanes)).astype(np.float32)
    if powers:
        rows = np.square(rows)
    sampler = kernels.resampler(lanes, powers, width)
    table = coefficient_sum.kernels(lanes, "averaged" if powers else "centred", powers).Table()
    table.rows = wp.array(rows.reshape(-1, lanes), dtype=wp.types.vector(lanes, wp.float32), device="cpu")
    table.count_y, table.count_x = counts
    table.origin_y, table.origin_x = (count // 2 for count in counts)
    table.length_y, table.length_x = lengths
    table.exponent = 20.0
    table.across, table.along = (falloff / length**2 for length in lengths)
    at_kappas = rng.normal(size=(lanes, width)).astype(np.float32)
    excluded = (counts[0] // 2) * counts[1] + counts[1] // 2 if powers else -1
    log_low, highest = np.log(rng.uniform(1.2, 1.3)), 1.8
    values = wp.empty(rays * nodes, dtype=sampler.row, device="cpu")
    inputs = [
        table, wp.array(at_kappas, dtype=sampler.row, device="cpu"), rays, nodes, log_low, divisions, highest, excluded,
        0, 0,
    ]  # fmt: skip
    launch(sampler.resample, dim=rays, inputs=inputs, outputs=[values], device="cpu")

    coefficients = rows.reshape(-1, parts, lanes).astype(float)
    if powers:
        coefficients[excluded] = 0.0
    coefficients = coefficients.reshape(*counts, parts, lanes)
    offsets = (np.arange(-divisions - divisions // 2, (nodes + 1) * divisions - divisions // 2) + 0.5) / divisions
    t = np.exp(log_low + offsets * np.log(2.0) / nodes)
    angles = 2.0 * np.pi * np.arange(rays) / rays
    expected = np.zeros((rays, nodes, width))
    for ray, k in itertools.product(range(rays), np.flatnonzero(t <= highest)):
        q = t[k] * np.array([np.sin(angles[ray]), np.cos(angles[ray])]) * lengths
        near = [np.arange(-24, 25) + round(place) for place in q]
        of_rows, of_columns = (
            np.exp(-falloff / length**2 * (neighbours - place) ** 2)
            for neighbours, place, length in zip(near, q, lengths, strict=True)
        )
        within = ((neighbours + count // 2) % count for neighbours, count in zip(near, counts, strict=True))
        around = coefficients[np.ix_(*within)]
        sums = np.einsum("y,x,yxpl->pl", of_rows, of_columns, around)
        value = sums[0] if powers else np.sum((sums @ at_kappas) ** 2, axis=0)
        expected[ray] += colour_curves.spline(offsets[k] - np.arange(nodes))[:, None] * value
    expected *= np.log(2.0) / (nodes * divisions)
    peak = np.abs(expected).max()
    # The kernel excludes Fourier coefficients with a weight below exp(−20), which causes errors of up to 1e-6 of the
    # peak.
    np.testing.assert_allclose(values.numpy().reshape(expected.shape), expected, atol=1e-6 * peak)


@pytest.mark.parametrize("octaves", [2, 3])
@pytest.mark.parametrize(
    ("nodes", "w_basis_size", "reach"),
    [(4, 4, FILTER_REACH), (7, 12, FILTER_REACH), (7, 12, 0), (8, 20, FILTER_REACH)],
)
def test_colour_rows_are_sums_over_the_splines_of_the_spectrum(nodes, w_basis_size, reach, octaves, rng):
    """Colours that the kernel computes must equal float64 sums over spline coefficients of the spectrum.

    A recursive filter computes the coefficients from samples of the spectrum, which is 0 beyond its last octave of the
    frequency. The filter begins ``reach`` samples beyond the samples that colours require. Over this distance, the
    error of the filter's first value decays. With ``reach`` = 0, the first value itself must be correct.
    """
    lanes, terms, coarse = 8, 5, 16
    rays = [coarse, 2 * coarse, 4 * coarse]
    taps = colour_curves.ring_count(nodes)
    rows = rng.normal(size=(sum(rays) * nodes, lanes)).astype(np.float32)
    starts = nodes * (np.cumsum(rays) - rays)
    if octaves == 2:
        # The memory behind the samples of the last octave (of the frequency) belongs to other data and must not be
        # read, so it is NaN.
        rows[starts[2] :] = np.nan
    matrices = rng.normal(size=(taps, terms, w_basis_size)).astype(np.float32)
    weights = rng.normal(size=(taps, 3)).astype(np.float32)
    projector = kernels.projector(lanes, w_basis_size)
    length = nodes + taps - 1 + reach
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)
    colours = wp.zeros(rays[1] * nodes, dtype=lookup(w_basis_size).row, device="cpu")
    groups = rays[1] // projector.abreast
    inputs = [
        wp.array(rows, dtype=row_t, device="cpu"), wp.array(starts[:octaves], dtype=wp.int32, device="cpu"),
        wp.array(rays[:octaves], dtype=wp.int32, device="cpu"),
        wp.array(matrices.reshape(-1, w_basis_size), dtype=projector.w_basis, device="cpu"),
        wp.array(weights, dtype=wp.vec3f, device="cpu"), terms, nodes, 0, length,
        wp.empty(rays[1] * length, dtype=row_t, device="cpu"), 0, groups,
    ]  # fmt: skip
    launch(projector.project, dim=1, inputs=inputs, outputs=[colours], device="cpu")

    own, following, further = (
        rows[start : start + count * nodes].reshape(count, nodes, lanes).astype(float)
        for start, count in zip(starts, rays, strict=True)
    )
    halfway = sum(
        share / 2048.0 * (np.roll(own, away, axis=0) + np.roll(own, -1 - away, axis=0))
        for away, share in enumerate((1225.0, -245.0, 49.0, -5.0))
    )
    refined = np.stack([own, halfway], axis=1).reshape(2 * coarse, nodes, lanes)
    beyond = further[::2] if octaves == 3 else np.zeros((2 * coarse, nodes, lanes))
    sequence = np.concatenate([np.zeros((2 * coarse, 1, lanes)), refined, following, beyond], axis=1)
    sequence = np.pad(sequence, [(0, 0), (0, max(length - sequence.shape[1], 0)), (0, 0)])[:, :length]
    away = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
    splines = np.einsum("jk,rkl->rjl", np.sqrt(2.0) * (2.0 * np.sqrt(2.0) - 3.0) ** away, sequence)
    windows = np.stack([splines[:, k : k + taps, :terms] for k in range(nodes)], axis=1)
    expected = np.einsum("ic,ilm,rkil->rkcm", weights, matrices, windows).reshape(-1, 3 * w_basis_size)
    np.testing.assert_allclose(colours.numpy(), expected, atol=2e-6 * np.abs(expected).max())


def test_points_are_splines_through_the_rows(fingers, rng):
    """Look-ups of single directions must equal sums in float64 of table rows, weighted by splines.

    The equality must also hold at the limits of octaves (factors of 2) of |(u, v)|, and at an azimuth of 0.
    """
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank", integration="table", tolerance=0.1)
    options = {"device": wp.get_device("cpu"), "threads": 1}
    table = colour_table.table_for(fingers, plan, plan.direction_range, IlluminatedMaterial("D65"), **options).struct
    firsts, rays = table.first_rows.numpy()[0], table.azimuths.numpy()[0]
    # An octave is a set of rings over a factor of two in |(u, v)|. ``seams`` are the indices of the rings (circles) at
    # which the last two octaves begin.
    last = len(rays) * table.rings_per_octave - table.ring_of_one
    seams = last - table.rings_per_octave * np.arange(1, 3)
    anywhere = rng.uniform(seams[1] - 3.0, last - 3.0, 300)
    logs = np.concatenate([anywhere, np.repeat(seams, 50) + rng.uniform(-2, 2, 100)])
    angles = np.where(rng.random(400) < 0.8, rng.uniform(0.0, 1.0, 400), rng.uniform(-1e-3, 1e-3, 400)) * 2.0 * np.pi
    uv = np.exp2(logs / table.rings_per_octave)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    scattering_vectors = np.column_stack([uv, rng.uniform(-1.9, -1.0, 400)])
    xyz = wp.zeros(400, dtype=wp.vec3f, device="cpu")
    arrays = [
        wp.array(scattering_vectors, dtype=wp.vec3d), wp.empty(400, dtype=wp.vec3f), wp.ones(400, dtype=wp.float32),
    ]  # fmt: skip
    ColourLookup(fingers, plan, plan.direction_range, **options).accumulate(*arrays, IlluminatedMaterial("D65"), xyz)

    turns = (angles / (2.0 * np.pi)) % 1.0
    places = logs + table.ring_of_one
    summed = 0.0
    for m, j in itertools.product((-1, 0, 1), repeat=2):
        node = np.rint(places).astype(int) + m
        octave = node // table.rings_per_octave
        ray = np.rint(turns * rays[octave]).astype(int) + j
        row = table.rows.numpy()[firsts[octave] + ray * table.rings_per_octave + node - octave * table.rings_per_octave]
        weight = colour_curves.spline(places - node) * colour_curves.spline(turns * rays[octave] - ray)
        summed += weight[:, None, None] * row.reshape(len(row), 3, -1)
    steps = (-scattering_vectors[:, 2] - table.least_w) * table.per_w
    entries = np.arange(table.w_basis.shape[0])
    at_w = np.stack([np.interp(steps, entries, function) for function in table.w_basis.numpy().T], axis=1)
    expected = np.maximum(np.einsum("nck,nk->nc", summed, at_w), 0.0)
    assert np.max(relative_errors(xyz.numpy(), expected)) < 5e-4


def test_colours_of_a_mirror_equal_the_illuminant_and_sampled_colours():
    flat = wd.HeightField(np.zeros((64, 64)), 0.09)
    plan = wd.plan(flat, method="low-rank")
    up = np.array([0.0, 0.0, 1.0])
    tabled = dataclasses.replace(plan, rings_per_octave=24, azimuths_per_width=1.3)
    result = wd.reflectance(flat, up, up, plan=tabled, ior=np.inf)
    np.testing.assert_allclose(result, colorimetry.colour_products().sum(axis=0), rtol=2e-3)
    tilted = np.array([np.sin(0.5), 0.0, np.cos(0.5)])
    mirrored = tilted * [-1.0, 1.0, 1.0]
    sampled = wd.reflectance(flat, tilted, mirrored, plan=plan)
    np.testing.assert_allclose(wd.reflectance(flat, tilted, mirrored, plan=tabled), sampled, rtol=2e-3)


@pytest.mark.parametrize("nodes", [8, 24, 64])
@pytest.mark.parametrize("illuminant", ["D65", "A", "E"])
def test_weights_reproduce_white_and_a_linear_spectrum(nodes, illuminant):
    weights = colour_curves.colour_weights(nodes, IlluminatedMaterial(illuminant))
    step = np.log(2.0) / nodes
    products = colorimetry.colour_products(illuminant)
    white = products.sum(axis=0)
    np.testing.assert_allclose(weights.sum(axis=0) * step, white, rtol=1e-5)
    # Each ring (circle of constant frequency) of the spectrum has a spline. For a spectrum that is linear in ln λ, the
    # mean weighted by the spline equals the value at the centre of the spline.
    exact = np.log(1e3 / np.arange(380.0, 781.0)) @ products / white
    places = np.log(1e3 / 780.0) + step * (np.arange(len(weights)) - 1.0)
    np.testing.assert_allclose(places @ weights * step / white, exact, atol=0.5 * step)


def test_basis_functions_of_w_reproduce_all_terms():
    """The basis functions of w, which all colours share, must reproduce each term of the power spectrum.

    A term is a function of κ = w/λ; w is the normal component of the scattering vector. At the wavelength of one ring
    (circle of constant frequency) of the spectrum, a weighted sum of the basis functions must equal the term as a
    function of w.
    """
    kappas = (0.5, 5.0)

    def basis_at(at):
        return np.stack([np.cos(2.0 * np.pi * n * 0.15 * at) for n in range(6)], axis=1)

    plan = wd.plan(wd.HeightField(np.zeros((8, 8)), 0.08), method="low-rank")
    plan = dataclasses.replace(plan, rings_per_octave=16, azimuths_per_width=1.1)
    terms, layout = colour_curves.SpectrumBasis(basis_at, kappas, np.ones(6), 0.2), MipLayout.for_plan(plan, 4.0)
    projection = colour_curves.make_projection(plan, terms, IlluminatedMaterial("D65"), layout)
    weights = colour_curves.colour_weights(16, IlluminatedMaterial("D65"))
    node = 12
    per_um = 1e3 / 780.0 * 2.0 ** ((node - 1) / 16)
    inside = (projection.ws * per_um > kappas[0]) & (projection.ws * per_um < kappas[1])
    for term in range(6):
        for c in range(3):
            expected = weights[node, c] * basis_at(projection.ws * per_um)[:, term]
            matrix = projection.matrices[projection.octaves[0][0].projection]
            actual = projection.weights[node, c] * (projection.w_basis @ matrix[node, term])
            assert np.max(np.abs(expected - actual)[inside]) < 2e-2 * np.max(np.abs(weights[:, c]))


def test_the_number_of_threads_does_not_change_colours(fingers, rng):
    lights, views = hemisphere(rng, 500), hemisphere(rng, 500)
    plan = wd.plan(fingers, method="low-rank", integration="table", tolerance=1e-1, coherence=SHORT)
    one = wd.reflectance(fingers, lights, views, plan=plan, threads=1)
    copy = wd.HeightField(fingers.heights_um, fingers.pitch_um)
    np.testing.assert_array_equal(one, wd.reflectance(copy, lights, views, plan=plan, threads=3))


def test_many_directions_use_a_table_and_few_do_not(fingers):
    light = (0.2, 0.1, 1.0)
    few = wd.reflectance_map(fingers, light, size=24, tolerance=1e-1, coherence=SHORT)
    many = wd.reflectance_map(fingers, light, size=400, tolerance=1e-1, coherence=SHORT)
    assert few.plan.rings_per_octave == 0
    assert many.plan.rings_per_octave > 0
    assert "polar colour table" in str(many.plan)
    exact = wd.reflectance_map(fingers, light, size=400, tolerance=1e-3, method="low-rank", coherence=SHORT)
    errors = relative_errors(many.xyz[many.mask], exact.xyz[exact.mask])
    assert np.percentile(errors, 99.0) <= 1e-1


def test_a_table_that_cannot_meet_its_tolerance_is_refused(fingers, rng):
    lights, views = hemisphere(rng, 200), hemisphere(rng, 200)
    arguments = {"tolerance": 1e-4, "method": "low-rank", "integration": "table", "coherence": SHORT}
    with pytest.raises(ValueError, match="rings per octave are too few"):
        wd.reflectance(fingers, lights, views, **arguments)
    with pytest.warns(wd.WarpdiffWarning, match="rings per octave are too few"):
        wd.reflectance(fingers, lights, views, strict=False, **arguments)


@pytest.mark.parametrize(
    ("method", "coherence"),
    [("jacobi-anger", wd.Coherence("source", angular_diameter_deg=0.5)),
     ("low-rank", wd.Coherence("replicas", periods=(2, 2))),
     ("jacobi-anger", wd.Coherence()),
     ("power", wd.Coherence("centred"))],
    ids=str,
)  # fmt: skip
def test_coherences_and_methods_without_a_table_are_refused(fingers, method, coherence):
    up = (0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match=f"method='{method}' .*: use (one of|integration=)"):
        wd.reflectance(fingers, up, up, method=method, integration="table", coherence=coherence)


def test_a_spectrum_has_no_table(fingers):
    up = (0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="integration must not be 'table' for a spectrum"):
        wd.spectral_reflectance(fingers, up, up, [500.0], method="low-rank", integration="table")


@pytest.mark.parametrize("size", [(64, 1), (1, 64)])
def test_tables_of_one_dimensional_surfaces_are_accurate(size, rng):
    heights = 0.2 * np.sin(2.0 * np.pi * np.arange(64) / 64.0).reshape(size)
    heightfield = wd.HeightField(heights, 2.5 / 64.0)
    lights, views = hemisphere(rng, 300), hemisphere(rng, 300)
    # The coherence window is small, because the size of a colour table is proportional to its square.
    window = wd.Coherence(sigma_um=3.0)
    plan = wd.plan(heightfield, lights, views, method="low-rank", tolerance=1e-3, coherence=window)
    sampled = wd.reflectance(heightfield, lights, views, plan=plan)
    tabled = dataclasses.replace(plan, rings_per_octave=64, azimuths_per_width=2.1)
    result = wd.reflectance(heightfield, lights, views, plan=tabled)
    assert np.percentile(relative_errors(result, sampled), 90.0) < 2e-2
