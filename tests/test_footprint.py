"""Footprints: a pixel shows the mean of what its filter sees, as the same picture of many rays a pixel does."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import warp as wp

import warpdiff as wd
from warpdiff import colour_table, meshes, supersample
from warpdiff.frame import Frame
from warpdiff.integration import Integrator
from warpdiff.kernels import directions, tiles
from warpdiff.kernels.scene import Footprint
from warpdiff.launches import launch_in_turn

SHORT = wd.Coherence(sigma_um=3.25)
SOURCE = wd.Coherence("source", angular_diameter_deg=2.0)
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))
# Of 144, P99 of the best pictures was their own noise: 0.25, and 0.06 against these.
RAYS = 1024


@pytest.fixture(scope="module")
def fingers():
    return wd.gratings.fingers(size_um=12.8, seed=4)


@pytest.fixture(scope="module")
def tube():
    return meshes.tube(segments_along=64, segments_around=48)


def view():
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=96, height=72)


@pytest.fixture(scope="module")
def pictures(tube, fingers):
    """With footprints, with points, and with many points."""
    blurred = wd.shade(tube, fingers, LIGHT, view(), coherence=SHORT)
    plan = dataclasses.replace(blurred.plan, footprint=False)
    points = wd.shade(tube, fingers, LIGHT, view(), plan=plan)
    finer = dataclasses.replace(plan, nodes=64, rays_per_width=2.0)
    return blurred, points, wd.shade(tube, fingers, LIGHT, view(), plan=finer, samples_per_pixel=RAYS)


def errors(image, exact):
    """Of pixels that lie wholly inside the lit surface."""
    inside = (exact.coverage == 1.0) & image.lit
    size = np.linalg.norm(exact.xyz[inside], axis=1)
    floor = 1e-3 * np.percentile(exact.xyz[inside][:, 1], 99.0)
    return np.linalg.norm(image.xyz[inside] - exact.xyz[inside], axis=1) / np.maximum(size, floor)


def to_first_order(spreads):
    """Footprints of which nothing but their spreads is known, (n, 4)."""
    return wp.array(np.pad(spreads, [(0, 0), (0, 4)]), dtype=Footprint, device="cpu")


def test_it_is_on_where_it_is_not_said(pictures):
    blurred, points, _ = pictures
    assert blurred.plan.footprint
    assert "range of (u, v)" in str(blurred.plan)
    assert not points.plan.footprint


def test_a_pixel_shows_its_mean(pictures):
    blurred, points, exact = pictures
    ours, theirs = errors(blurred, exact), errors(points, exact)
    assert len(ours) > 500
    # So few pixels see (u, v) turn by a tenth of themselves and more; larger pictures are judged in bench/.
    assert np.median(ours) < 4e-2
    assert np.median(ours) < 0.2 * np.median(theirs)
    assert np.percentile(ours, 90.0) < 0.4 * np.percentile(theirs, 90.0)


@pytest.mark.parametrize("angle_deg", [-1e-5, 0.0, 1e-5, -0.02, 180.0])
def test_rays_are_a_circle(fingers, angle_deg):
    """A full turn meets what a turn begins with, however wide the footprint."""
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank/table", tolerance=0.1)
    plan = dataclasses.replace(plan, footprint=True)
    device = wp.get_device("cpu")
    integrator = Integrator(fingers, plan, plan.scope, device=device, threads=1)
    found = []
    for degrees in (angle_deg, angle_deg + 0.05):
        angle = np.radians(degrees)
        uv = 0.6 * np.array([np.cos(angle), np.sin(angle)])
        deflection = wp.array([[*uv, -1.6]], dtype=wp.vec3d, device=device)
        spread = to_first_order([[*(0.03 * uv[::-1] * [-1.0, 1.0]), 0.0, 0.0]])
        xyz = wp.zeros(1, dtype=wp.vec3f, device=device)
        gain = wp.ones(1, dtype=wp.float32, device=device)
        integrator.add(deflection, None, gain, "D65", xyz, footprints=spread)
        found.append(xyz.numpy()[0])
    np.testing.assert_allclose(found[0], found[1], rtol=0.05)


@pytest.mark.parametrize(("window", "blurred"), [(SHORT, True), (SHORT, False), (SOURCE, True)])
def test_a_colour_does_not_depend_on_those_beside_it(fingers, window, blurred, rng):
    """Look-ups of a run are computed abreast, and where a run begins depends on the number of threads.

    What compilers leave over from vectors they round otherwise: one of two thousand took another row or weight then.
    """
    plan = wd.plan(fingers, coherence=window, method="low-rank/table", tolerance=0.1, strict=False)
    device = wp.get_device("cpu")
    integrator = Integrator(fingers, dataclasses.replace(plan, footprint=True), plan.scope, device=device, threads=1)
    count = 100_000
    # Any of these runs has a last one that is not whole.
    runs = (256, 1, 7, 61)
    deflections = np.concatenate([rng.uniform(-0.9, 0.9, (count, 2)), rng.uniform(-1.9, -0.5, (count, 1))], axis=1)
    spreads = rng.normal(0.0, 0.03, (count, 4)) * rng.choice([0.1, 1.0, 5.0], (count, 1))
    gains = np.where(rng.uniform(size=count) < 0.8, rng.uniform(size=count), 0.0)
    to_lights = wp.array(np.tile([0.3, 0.1, 0.9], (count, 1)), dtype=wp.vec3f, device=device)
    footprints = to_first_order(spreads) if blurred else None
    given = wp.array(deflections, dtype=wp.vec3d, device=device)
    factors = wp.array(gains, dtype=wp.float32, device=device)
    found = []
    for run in runs:
        xyz = wp.zeros(count, dtype=wp.vec3f, device=device)
        step = integrator.steps(given, to_lights, factors, "D65", xyz, footprints)[0]
        step = dataclasses.replace(step, inputs=[*step.inputs[:-1], run], block=run)
        launch_in_turn([step], count, device=device, threads=1, slice_size=count)
        found.append(xyz.numpy())
    for each in found[1:]:
        np.testing.assert_array_equal(each, found[0])
    assert np.count_nonzero(found[0][:, 1]) > count / 2


@pytest.mark.parametrize(
    ("widest", "turn", "median", "most"),
    [(0.04, 0.05, 4.5e-3, 1.2e-2), (0.12, 0.05, 6e-3, 2.5e-2), (0.05, 0.2, 0.018, 0.11)],
)
def test_means_are_those_of_points(fingers, rng, widest, turn, median, most):
    """Of footprints that are lines, along and aslant, of which wide ones take fewer nodes and have a skew."""
    count = 200
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank/table", tolerance=0.02)
    sampled = wd.plan(fingers, coherence=SHORT, method="low-rank", tolerance=1e-3)
    device = wp.get_device("cpu")
    angles, sizes = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.5, 0.9, count)
    along = sizes[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    aside = along[:, ::-1] * [-1.0, 1.0]
    spreads = rng.uniform(0.3 * widest, widest, (count, 1)) * along + rng.uniform(-turn, turn, (count, 1)) * aside

    def colours(made, uv, footprints):
        xyz = wp.zeros(len(uv), dtype=wp.vec3f, device=device)
        deflections = np.column_stack([uv, np.full(len(uv), -1.5)])
        of = (
            wp.array(deflections, dtype=wp.vec3d, device=device),
            None,
            wp.ones(len(uv), dtype=wp.float32, device=device),
        )
        Integrator(fingers, made, plan.scope, device=device, threads=2).add(*of, "D65", xyz, footprints=footprints)
        return xyz.numpy().astype(np.float64)

    footprints = to_first_order(np.column_stack([spreads, np.zeros((count, 2))]))
    found = colours(dataclasses.replace(plan, footprint=True), along, footprints)
    places, weights = np.polynomial.hermite_e.hermegauss(120)
    seen = along[:, None] + places[:, None] * spreads[:, None]
    of_points = colours(sampled, seen.reshape(-1, 2), None).reshape(count, -1, 3)
    exact = np.einsum("p,npc->nc", weights / weights.sum(), of_points)
    relative = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert np.median(relative) < median
    assert np.percentile(relative, 90.0) < most


@pytest.mark.parametrize(
    ("w", "gain", "bend", "shares"),
    [
        (0.1, 0.0, 0.0, (0.85, 0.65)),
        (0.0, 0.25, 0.0, (0.25, 0.25)),
        (0.0, 0.0, 0.006, (0.7, 0.7)),
        (0.05, 0.1, 0.003, (0.65, 0.55)),
    ],
)
def test_means_lie_where_it_is_brighter(fingers, rng, w, gain, bend, shares):
    """Where w, the gain or the slope of (u, v) change over pixels: against sums of points, errors fall to such shares.

    The first of what tells where means lie, and the second of what (u, v) has in common with w beside it.
    """
    count, deviation = 150, supersample.FILTER_DEVIATION
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank/table", tolerance=0.02)
    sampled = wd.plan(fingers, coherence=SHORT, method="low-rank", tolerance=1e-3)
    angles, sizes = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.5, 0.9, count)
    # Constants and slopes along rows and columns of (u, v, w) and of the gain, and what (u, v) bends.
    linear = np.zeros((count, 4, 3))
    linear[:, 0, 0], linear[:, 1, 0], linear[:, 2, 0] = sizes * np.cos(angles), sizes * np.sin(angles), 1.5
    linear[:, 3, 0] = 1.0
    linear[:, :, 1:] = rng.normal(size=(count, 4, 2)) * np.array([0.03, 0.03, w, gain])[:, None]
    bends = rng.normal(size=(count, 2, 2)) * bend

    def seen(x, y):
        """Deflections and gains at places in the pixels."""
        found = np.einsum("nck,kp->npc", linear, np.stack([np.ones_like(x), x, y]))
        found[:, :, :2] += np.einsum("nck,kp->npc", bends, np.stack([x * x, y * y]))
        return found[:, :, :3] * [1.0, 1.0, -1.0], np.maximum(found[:, :, 3], 1e-3)

    def colours(made, deflections, gains, footprints=None):
        xyz = wp.zeros(gains.size, dtype=wp.vec3f, device="cpu")
        of = (
            wp.array(deflections.reshape(-1, 3), dtype=wp.vec3d, device="cpu"),
            None,
            wp.array(gains.ravel(), dtype=wp.float32, device="cpu"),
        )
        integrator = Integrator(fingers, made, plan.scope, device=wp.get_device("cpu"), threads=2)
        integrator.add(*of, "D65", xyz, footprints=footprints)
        return xyz.numpy().astype(np.float64)

    places, weights = np.polynomial.hermite_e.hermegauss(24)
    x, y = (deviation * each.ravel() for each in np.meshgrid(places, places))
    share = np.outer(weights, weights).ravel() / weights.sum() ** 2
    exact = np.einsum("p,npc->nc", share, colours(sampled, *seen(x, y)).reshape(count, -1, 3))
    # Pictures of 3 × 3 pixels, of which the middle ones are looked at.
    y, x = np.mgrid[-1.0:2.0, -1.0:2.0]
    deflections, gains = seen(x.ravel(), y.ravel())
    footprints = wp.empty(9 * count, dtype=Footprint, device="cpu")
    given = [
        wp.array(deflections.reshape(-1, 3), dtype=wp.vec3d, device="cpu"),
        wp.array(gains.ravel(), dtype=wp.float32, device="cpu"),
        wp.full(9 * count, 1, dtype=wp.int32, device="cpu"),
    ]
    wp.launch(directions.spread_pixels, (1, 1), [*given, 3, 3, deviation, 0, 9 * count], [footprints], device="cpu")
    whole = footprints.numpy()[4::9]
    errors = []
    for counted in (4, 6, 8):
        # The spread alone, where the mean lies, and what it has in common with w.
        footprint = wp.array(np.where(np.arange(8) < counted, whole, 0.0), dtype=Footprint, device="cpu")
        table = dataclasses.replace(plan, footprint=True)
        found = colours(table, np.ascontiguousarray(deflections[:, 4]), gains[:, 4].copy(), footprint)
        errors.append(np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1))
    medians = np.median(errors, axis=1)
    assert medians[1] < shares[0] * medians[0]
    assert medians[2] < shares[1] * medians[0]
    # Of many orders at once little is left that goes in proportion.
    ends = np.percentile(errors, 90.0, axis=1)
    assert max(ends[1:]) < 0.85 * ends[0]


def footprint_of(along, down, bend, deviation):
    """Its eight numbers, (8, …), from changes along rows and columns, (4, …), and half the second differences, (2, …).

    The fourth of the changes is that of the gain times w², relative to it.
    """
    more = [np.clip(each[3], -0.5 / deviation, 0.5 / deviation) for each in (along, down)]
    aside = more[0] * along[:2] + more[1] * down[:2] + bend
    with_w = along[2] * along[:2] + down[2] * down[:2]
    return np.concatenate([deviation * along[:2], deviation * down[:2], deviation**2 * aside, deviation**2 * with_w])


def footprint_by_hand(deflections, gains, hit, row, column, deviation):
    """What ``spread_pixels`` finds of one pixel of a picture."""
    height, width = hit.shape
    changes, bend, w = [], np.zeros(2), -deflections[row, column, 2]
    for down, right in ((0, 1), (1, 0)):
        found = {}
        for sign in (-1, 1):
            y, x = row + sign * down, column + sign * right
            if hit[row, column] and 0 <= y < height and 0 <= x < width and hit[y, x]:
                pair = gains[y, x], gains[row, column]
                change = (deflections[y, x] - deflections[row, column]) * [1.0, 1.0, -1.0]
                # Of the gain times w², relative to it, and none from or to what is not lit.
                relative = 2.0 * (pair[0] - pair[1]) / sum(pair) + 2.0 * change[2] / w if min(pair) > 0.0 else 0.0
                found[sign] = sign * np.append(change, relative)
        size = {sign: np.hypot(*each[:2]) for sign, each in found.items()}
        if len(found) == 2:
            bent = found[1][:2] - found[-1][:2]
            if np.hypot(*bent) < min(size.values()):
                changes.append((found[1] + found[-1]) / 2.0)
                bend += bent / 2.0
            else:
                changes.append(found[-1] if size[-1] < size[1] else found[1])
        else:
            changes.append(next(iter(found.values()), np.zeros(4)))
    return footprint_of(*changes, bend, deviation)


@pytest.mark.parametrize("size", [(1, 1, 1), (1, 1, 70), (1, 40, 1), (7, 3, 3), (4, 5, 5), (1, 9, 100)], ids=str)
@pytest.mark.parametrize("slices", [1, 5])
def test_footprints_follow_from_those_beside(size, slices, rng):
    """In pictures, and in tiles of rays one after the other."""
    y, x = np.mgrid[: size[1], : size[2]]
    deflections = np.stack([0.01 * x + 0.002 * y, 0.02 * y - 0.003 * x, -1.5 + 0.01 * x - 0.004 * y], axis=-1)
    deflections = deflections + rng.normal(size=(*size, 3)) * rng.choice([1e-4, 1e-2], (*size, 1))
    gains = np.maximum(rng.normal(1.0, 0.4, size), 0.0).astype(np.float32)
    hit = (rng.uniform(size=size) < 0.8) * (np.arange(size[1]) % 5 != 4)[:, None]
    deviation = 0.48
    found = wp.full(hit.size, 7.0, dtype=Footprint, device="cpu")
    given = [
        wp.array(deflections.reshape(-1, 3), dtype=wp.vec3d, device="cpu"),
        wp.array(gains.ravel(), dtype=wp.float32, device="cpu"),
        wp.array(hit.ravel(), dtype=wp.int32, device="cpu"),
    ]
    for begin, end in itertools.pairwise(np.linspace(0, hit.size, slices + 1).astype(int)):
        inputs = [*given, size[2], size[1], deviation, int(begin), int(end - begin)]
        wp.launch(directions.spread_pixels, (1, 1), inputs, [found], device="cpu")
    for place, one in zip(np.ndindex(size), found.numpy(), strict=True):
        of_picture = deflections[place[0]], gains[place[0]].astype(np.float64), hit[place[0]]
        expected = footprint_by_hand(*of_picture, *place[1:], deviation) if hit[place] else np.zeros(8)
        np.testing.assert_allclose(one, expected, rtol=1e-4, atol=1e-7)


def test_nodes_are_skipped_under_smooth_lights_alone():
    per_log = 32.0 / np.log(2.0)
    assert all(colour_table._is_smooth(name, per_log) for name in ("D65", "D50", "A", "E"))
    assert not any(colour_table._is_smooth(name, per_log) for name in ("FL2", "FL11", "HP1"))


@pytest.mark.parametrize(("is_lines", "own", "worst"), [(False, 1.1, 0.03), (False, 1.8, 0.015), (True, 0.8, 0.05)])
def test_few_rays_blur_a_line(is_lines, own, worst):
    """A Gaussian anywhere between rays, as a spline through its values on them, blurred by few of the coefficients.

    Of a source's lines that spline itself is 3 % of their peak off.
    """
    made = colour_table.blending("cpu", is_lines=is_lines)
    weights, lengths = made.weights.numpy().astype(np.float64), made.lengths.numpy()
    variances = np.arange(len(weights)) / made.per_variance
    np.testing.assert_allclose(weights.sum(axis=2), 1.0, atol=1e-6)
    on_rays = np.arange(-24, 25)
    between = 0.75 * np.eye(49) + 0.125 * (np.eye(49, k=1) + np.eye(49, k=-1))
    for index in range(2, len(weights), 7):
        count, variance = lengths[index], own**2 + variances[index]
        for which in range(0, weights.shape[1], 9):
            fraction = (which + 0.5) / weights.shape[1] - 0.5
            places = np.arange(count) - (count - 1) / 2.0 - fraction
            if not is_lines:
                moments = weights[index, which, :count] @ np.stack([places, places**2], axis=1)
                np.testing.assert_allclose(moments, [0.0, variances[index] + 0.25], atol=1e-5)
            # The rays' numbers, so that the middle ones are those that count.
            first = 24 - count // 2
            for line in on_rays[first] - places[0] + np.linspace(-6.0, 6.0, 49):
                values = np.exp(-0.5 * ((on_rays - line) / own) ** 2) / own
                coefficients = np.linalg.solve(between, values)
                found = weights[index, which, :count] @ coefficients[first : first + count]
                away = on_rays[first] - places[0] - line
                exact = np.exp(-0.5 * away**2 / variance) / np.sqrt(variance)
                assert abs(found - exact) * np.sqrt(variance) < worst


def test_a_flat_surface_has_none(fingers):
    disc = meshes.disc(inner_radius=0.0, outer_radius=1.0, segments=32, rings=3)
    along_x = np.tile([1.0, 0.0, 0.0], (len(disc.vertices), 1))
    camera = wd.View.orthographic((0.3, 0, 2), (0, 0, 0), extent_y=0.5, width=16, height=12)
    plan = wd.shade(disc, fingers, LIGHT, camera, coherence=SHORT, tangents=along_x).plan
    images = [wd.shade(disc, fingers, LIGHT, camera, plan=plan, tangents=along_x, footprint=on) for on in (True, False)]
    np.testing.assert_allclose(images[0].xyz, images[1].xyz, rtol=2e-3)


def test_more_rays_share_the_footprint(tube, fingers, pictures):
    blurred, _, exact = pictures
    both = wd.shade(tube, fingers, LIGHT, view(), plan=blurred.plan, samples_per_pixel=4)
    rays = wd.shade(tube, fingers, LIGHT, view(), plan=blurred.plan, samples_per_pixel=4, footprint=False)
    assert np.median(errors(both, exact)) < 0.3 * np.median(errors(rays, exact))
    assert both.coverage.max() == 1.0
    assert np.any((both.coverage > 0.0) & (both.coverage < 1.0))


def test_rays_on_a_grid_come_closer(tube, fingers, pictures):
    """The more parts a pixel's mean has, the better."""
    blurred, _, exact = pictures
    plan = dataclasses.replace(blurred.plan, tolerance=0.5)
    images = [wd.shade(tube, fingers, LIGHT, view(), plan=plan, samples_per_pixel=n) for n in (4, 9, 25)]
    for quantile in (50.0, 95.0):
        found = [np.percentile(errors(each, exact), quantile) for each in images]
        assert found[0] > found[1] > found[2]
    assert np.median(errors(images[2], exact)) < 1.5e-2


@pytest.mark.parametrize("count", [2, 3, 5, 7, 12])
def test_any_number_of_rays_is_no_worse_than_one(tube, fingers, pictures, count):
    blurred, _, exact = pictures
    one = wd.shade(tube, fingers, LIGHT, view(), plan=dataclasses.replace(blurred.plan, tolerance=0.5))
    several = wd.shade(tube, fingers, LIGHT, view(), plan=blurred.plan, samples_per_pixel=count)
    # Two or three on a line or a triangle are no better a filter than a mean of second order over one.
    worst = 1.25 if count < 4 else 1.0
    for quantile in (50.0, 95.0):
        assert np.percentile(errors(several, exact), quantile) < worst * np.percentile(errors(one, exact), quantile)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16, 30, 200])
def test_rays_have_the_filters_width(count):
    places, weights, deviation = supersample.rays_of(count)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ places, 0.0, atol=1e-12)
    spread = np.sqrt(np.mean(weights @ places**2) + deviation**2)
    assert spread == pytest.approx(supersample.FILTER_DEVIATION, rel=0.03)


def test_neither_threads_nor_silhouettes_matter(tube, fingers, pictures):
    blurred = pictures[0]
    assert np.all(np.isfinite(blurred.xyz))
    assert np.all(blurred.xyz >= 0.0)
    one = wd.shade(tube, fingers, LIGHT, view(), plan=blurred.plan, threads=1)
    three = wd.shade(tube, fingers, LIGHT, view(), plan=blurred.plan, threads=3)
    np.testing.assert_array_equal(one.xyz, three.xyz)
    np.testing.assert_array_equal(one.xyz, blurred.xyz)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "low-rank"}, "use method='auto' or 'low-rank/table'"),
        ({"method": "direct"}, "footprint=True takes a table"),
        ({"coherence": wd.Coherence("replicas", copies=(2, 2))}, "asks for a table"),
    ],
)
def test_what_has_no_table_has_no_footprints(tube, fingers, arguments, message):
    with pytest.raises(ValueError, match=message):
        wd.shade(tube, fingers, LIGHT, view(), footprint=True, **arguments)


def test_a_plan_without_a_table_has_none(tube, fingers):
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank")
    with pytest.raises(ValueError, match="footprint=True takes a table"):
        wd.shade(tube, fingers, LIGHT, view(), plan=plan, footprint=True)


def test_steep_pixels_take_more_rays(tube, fingers, pictures):
    """They err less than without, and no more pixels take them than need be."""
    blurred, _, exact = pictures
    lax = wd.shade(tube, fingers, LIGHT, view(), plan=dataclasses.replace(blurred.plan, tolerance=0.5))
    some = wd.shade(tube, fingers, LIGHT, view(), plan=dataclasses.replace(blurred.plan, tolerance=0.03))
    shares = [each.plan.supersampled for each in (lax, some, blurred)]
    assert 0.0 <= shares[0] < 0.1 < shares[1] < shares[2] <= 1.0
    assert "took more rays" in str(blurred.plan)
    for quantile in (50.0, 90.0, 99.0):
        found = [np.percentile(errors(each, exact), quantile) for each in (lax, some, blurred)]
        # All three look up the same table: what is left is what rays add.
        assert found[2] <= found[1] < 0.9 * found[0]
    np.testing.assert_array_equal(lax.coverage, blurred.coverage)


def test_lights_add_up(tube, fingers, pictures):
    plan = pictures[0].plan
    other = wd.DirectionalLight((-0.7, 0.6, 0.8), power=0.4)
    alone = [wd.shade(tube, fingers, light, view(), plan=plan).xyz for light in (LIGHT, other)]
    both = wd.shade(tube, fingers, [LIGHT, other], view(), plan=plan)
    np.testing.assert_allclose(both.xyz, alone[0] + alone[1], rtol=1e-5, atol=1e-12)
    assert 0.0 < both.plan.supersampled <= 1.0


@pytest.mark.parametrize("tile", supersample.TILES.values(), ids=str)
@pytest.mark.parametrize("angle_deg", [0.0, 22.5, 45.0])
def test_tiles_stand_for_the_filter(tile, angle_deg):
    """Along a line through the pixel, the sum of their Gaussians is a Gaussian of 0.5 pixel that ends at 1.5."""
    places, weights = tile.rays
    assert weights.sum() == pytest.approx(1.0)
    across = places @ [np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))]
    x = np.linspace(-1.2, 1.2, 49)
    ours = np.exp(-0.5 * ((x[:, None] - across) / tile.deviation) ** 2) @ weights / tile.deviation
    y = np.linspace(-1.5, 1.5, 3001)
    inside = x[:, None] ** 2 + y**2 <= 1.5**2
    exact = (np.exp(-2.0 * (x[:, None] ** 2 + y**2)) * inside).sum(axis=1)
    whole = np.linspace(-1.5, 1.5, 301)
    total = (np.exp(-2.0 * (whole[:, None] ** 2 + y**2)) * (whole[:, None] ** 2 + y**2 <= 1.5**2)).sum()
    exact *= np.sqrt(2.0 * np.pi) / (total * (whole[1] - whole[0]))
    np.testing.assert_allclose(ours, exact, atol=0.05 * exact.max())


def unevenness(around):
    """By how much changes of (u, v) over 3 × 3 pixels differ, relative to them."""
    around = around - around[1, 1]
    size = np.linalg.norm
    along = max(size(around[1, 0]), size(around[1, 2]))
    down = max(size(around[0, 1]), size(around[2, 1]))
    corners = [size(around[i, j] - around[i, 1] - around[1, j]) for i in (0, 2) for j in (0, 2)]
    return max(
        size(around[1, 0] + around[1, 2]) / along,
        size(around[0, 1] + around[2, 1]) / down,
        max(corners) / max(along, down),
    )


def classes_by_hand(colours, deflections, gains, floor, bounds):
    """What ``classify`` finds of a picture, pixel by pixel."""
    height, width = gains.shape
    found = np.zeros((height, width), np.uint8)
    for row, column in zip(*np.nonzero(gains > 0.0), strict=True):
        contrast, dark = 0.0, 0
        for y, x in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            if 0 <= y < height and 0 <= x < width:
                if gains[y, x] > 0.0:
                    contrast = max(contrast, np.linalg.norm(colours[y, x] - colours[row, column]))
                else:
                    dark = 1
        relative = contrast / max(np.linalg.norm(colours[row, column]), floor)
        inside = 0 < row < height - 1 and 0 < column < width - 1
        all_lit = inside and np.all(gains[row - 1 : row + 2, column - 1 : column + 2] > 0.0)
        uneven = unevenness(deflections[row - 1 : row + 2, column - 1 : column + 2, :2]) if all_lit else 1.0
        share = min(tiles.SMOOTH + tiles.PER_UNEVEN * uneven, 1.0)
        exceeded = sum(share * relative > bound for bound in bounds)
        even = all_lit and uneven * relative <= tiles.EVENLY * bounds[0]
        found[row, column] = 3 * exceeded + dark - even if exceeded else 1
    return found


@pytest.mark.parametrize("size", [(1, 1), (1, 70), (41, 1), (3, 5), (20, 33), (9, 100)], ids=str)
@pytest.mark.parametrize("slices", [1, 6])
def test_steep_pixels_are_told_by_those_beside_them(size, slices, rng):
    colours = rng.lognormal(0.0, 1.0, (*size, 3)).astype(np.float32)
    # Some rows see nothing at all.
    gains = (rng.uniform(size=size) - 0.3 - (np.arange(size[0]) % 4 == 3)[:, None]).astype(np.float32)
    # Here and there (u, v) goes on as it did.
    y, x = np.mgrid[: size[0], : size[1]]
    deflections = np.stack([0.01 * x + 0.002 * y, 0.02 * y, 0.0 * x], axis=-1)
    deflections[..., :2] += rng.choice([0.0, 1e-5, 1e-3], (*size, 1), p=[0.9, 0.07, 0.03])
    bounds = np.array([0.5, 1.5], np.float32)
    found = wp.empty(gains.size, dtype=wp.uint8, device="cpu")
    given = [wp.array(colours.reshape(-1, 3), dtype=wp.vec3f, device="cpu")]
    given += [wp.array(deflections.reshape(-1, 3), dtype=wp.vec3d, device="cpu"), wp.array(gains.ravel(), device="cpu")]
    given += [size[1], *(wp.array(each, dtype=wp.float32, device="cpu") for each in ([0.8], bounds))]
    for begin, end in itertools.pairwise(np.linspace(0, gains.size, slices + 1).astype(int)):
        wp.launch(directions.classify, (1, 1), [*given, int(begin), int(end - begin)], [found], device="cpu")
    expected = classes_by_hand(colours, deflections, gains, 0.8, bounds)
    np.testing.assert_array_equal(found.numpy().reshape(size), expected)
    # And listed, where that does not begin with the picture.
    begins, part = gains.size // 3, 50
    lists = wp.zeros((6, gains.size), dtype=wp.int32, device="cpu")
    counts = wp.zeros((-(-(gains.size - begins) // part), 7), dtype=wp.int32, device="cpu")
    for begin in range(begins, gains.size, part):
        inputs = [*given, begins, part, begin, min(part, gains.size - begin)]
        wp.launch(directions.list_steep, (1, 1), inputs, [found, lists, counts], device="cpu")
    flat = expected.ravel()[begins:]
    assert counts.numpy()[:, -1].sum() == np.count_nonzero(flat)
    for kind in range(6):
        listed = [lists.numpy()[kind, begins + k * part :][:count] for k, count in enumerate(counts.numpy()[:, kind])]
        np.testing.assert_array_equal(np.concatenate(listed), begins + np.flatnonzero(flat == kind + 2))


@pytest.mark.parametrize("with_lights", [True, False])
def test_rays_fan_out_along_parabolas(with_lights, rng):
    """What changes as a parabola is met exactly, with the footprints that are its slopes."""
    width, height = 9, 7
    y, x = np.mgrid[:height, :width].astype(np.float64)

    def parabolas(count):
        return rng.normal(size=(count, 6)) * [1.0, 0.1, 0.1, 0.01, 0.01, 0.01]

    def at(terms, x, y):
        return terms @ np.stack([np.ones_like(x), x, y, x * x, x * y, y * y]).reshape(6, -1)

    of_uvw, of_light = parabolas(3), parabolas(3)
    of_gain = np.abs(parabolas(1)) + 0.1
    flat = [at(terms, x, y).T for terms in (of_uvw, of_light, of_gain)]
    arrays = [
        wp.array(values, dtype=dtype, device="cpu")
        for values, dtype in zip((*flat[:2], flat[2].ravel()), (wp.vec3d, wp.vec3f, wp.float32), strict=True)
    ]
    pixels = np.array([width + 1, -1, 3 * width + 4, 5 * width + 7], dtype=np.int32)
    tile = supersample.TILES[25]
    places, _ = tile.rays
    count = len(pixels) * len(places)
    found = [wp.full(count, 7.0, dtype=dtype, device="cpu") for dtype in (wp.vec3d, wp.vec3f, wp.float32, Footprint)]
    hit = wp.full(count, 7, dtype=wp.int32, device="cpu")
    inputs = [*arrays, wp.array(pixels, dtype=wp.int32, device="cpu"), wp.array(places, dtype=wp.vec2d, device="cpu")]
    inputs += [width, tile.deviation, with_lights]
    for first, run in ((0, 1), (1, 3)):
        wp.launch(directions.fan_out, (1, 1), [*inputs, first, run], [*found, hit], device="cpu")
    deflections, to_lights, gains, footprints = (each.numpy().reshape(len(pixels), 25, -1) for each in found)
    np.testing.assert_array_equal(hit.numpy().reshape(-1, 25)[:, 0], np.where(pixels < 0, 0, 1))
    np.testing.assert_array_equal(gains[1], 0.0)
    for k in (0, 2, 3):
        right, down = pixels[k] % width + places[:, 0], pixels[k] // width + places[:, 1]
        np.testing.assert_allclose(deflections[k], at(of_uvw, right, down).T, atol=2e-6)
        np.testing.assert_allclose(gains[k], at(of_gain, right, down).T, rtol=1e-5)
        if with_lights:
            np.testing.assert_allclose(to_lights[k], at(of_light, right, down).T, atol=2e-6)
        terms = np.concatenate([of_uvw * [[1.0], [1.0], [-1.0]], of_gain])
        _, a, b, aa, ab, bb = terms[:, :, None].transpose(1, 0, 2)
        slopes = np.stack([a + 2 * aa * right + ab * down, b + ab * right + 2 * bb * down])
        w, gain = (at(terms[c : c + 1], right, down)[0] for c in (2, 3))
        slopes[:, 3] = slopes[:, 3] / gain + 2.0 * slopes[:, 2] / np.where(w > 0.0, w, np.inf)
        expected = footprint_of(*slopes, (aa + bb)[:2], tile.deviation)
        np.testing.assert_allclose(footprints[k], expected.T, atol=1e-6)


# What may be uneven goes with what pixels may err by: 1e-2, and 1e-1 of the source.
@pytest.mark.parametrize(("kind", "most"), [("averaged", 5e-3), ("source", 2e-2)])
def test_rays_that_fan_out_see_what_rays_that_are_cast_see(tube, fingers, kind, most, monkeypatch):
    if kind == "source":
        plan = wd.plan(fingers, coherence=SOURCE, method="low-rank/table", tolerance=0.1, strict=False)
    else:
        plan = wd.plan(fingers, coherence=SHORT, method="low-rank/table", tolerance=1e-2)
    plan = dataclasses.replace(plan, footprint=True)
    close = wd.View((0.0, 0.5, 0.75), (0.0, 0.0, 0.0), width=480, height=360)
    numbers = []

    def all_cast(*arguments, **options):
        lit, batches = list_up(*arguments, **options)
        numbers.append({each.kind.index: len(each.pixels) for each in batches})
        rays, found = 0, []
        for each in batches:
            kind = supersample.KINDS[each.kind.index + each.kind.even]
            found.append(supersample.Batch(kind, each.pixels, rays))
            rays = found[-1].end_ray
        return lit, found

    found = wd.shade(tube, fingers, LIGHT, close, plan=plan)
    list_up = supersample.batches
    monkeypatch.setattr(supersample, "batches", all_cast)
    # Faces are to find the rays of each batch by itself.
    meet = Frame._meet_tiles
    monkeypatch.setattr(
        Frame, "_meet_tiles", lambda self, batches: np.concatenate([meet(self, [alone(each)]) for each in batches])
    )
    expected = wd.shade(tube, fingers, LIGHT, close, plan=plan)
    (listed,) = numbers
    even = sum(count for index, count in listed.items() if supersample.KINDS[index].even)
    assert even > 0.2 * sum(listed.values())
    error = errors(found, expected)
    assert np.count_nonzero(error) > 0.5 * even
    assert np.percentile(error[error > 0.0], 99) < most


def test_rays_whose_faces_take_too_much_memory_are_met_in_parts(tube, fingers, monkeypatch):
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank/table", tolerance=1e-2)
    plan = dataclasses.replace(plan, footprint=True)
    expected = wd.shade(tube, fingers, LIGHT, view(), plan=plan)
    monkeypatch.setattr(supersample, "_MOST_FOUND", 1000)
    found = wd.shade(tube, fingers, LIGHT, view(), plan=plan)
    assert found.plan.supersampled > 0.3
    np.testing.assert_array_equal(found.xyz, expected.xyz)


def alone(batch):
    return supersample.Batch(batch.kind, batch.pixels, 0)
