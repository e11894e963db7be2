"""What is found of a picture's directions on a device against the same by NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere

import warpdiff as wd
from warpdiff.compute.device import resolve_device
from warpdiff.compute.pipeline import launch_pipeline
from warpdiff.plans.direction_range import DirectionRange, DirectionSample, sample_ranks, stratified
from warpdiff.render.direction_statistics import BLOCK, DirectionStatistics

WINDOWS = [
    wd.Coherence(),
    wd.Coherence("source", angular_diameter_deg=0.5),
    wd.Coherence("replicas", copies=(2, 5)),
]


def same(some, others):
    for name in ("deflections", "to_lights", "gains", "weights"):
        np.testing.assert_allclose(getattr(some, name), getattr(others, name), rtol=1e-15)


@pytest.mark.parametrize("share", [0.9, 0.01, 0.0])
@pytest.mark.parametrize("coherence", WINDOWS, ids=lambda each: each.kind)
def test_scope_and_sample_are_those_of_all(coherence, share, device, rng):
    hf = wd.HeightField(rng.uniform(size=(16, 40)), pitch_um=(0.2, 0.1))
    count = 20_011
    to_lights = hemisphere(rng, count).astype(np.float32)
    deflections = -to_lights - hemisphere(rng, count)
    gains = np.where(rng.uniform(size=count) < share, rng.uniform(0.1, 1.0, count), 0.0).astype(np.float32)
    expected = DirectionRange.of(hf, coherence, deflections, to_lights, gains > 0.0)
    expected_some = DirectionSample.among(deflections, to_lights, gains)
    dtypes = (wp.vec3d, wp.vec3f, wp.float32)
    arrays = [
        wp.array(each, dtype=dtype, device=device)
        for each, dtype in zip((deflections, to_lights, gains), dtypes, strict=True)
    ]
    for threads in (1, 3):
        summary = DirectionStatistics(hf, coherence, count, device=resolve_device(device))
        launch_pipeline([summary.step(*arrays)], count, device=resolve_device(device), threads=threads)
        scope, lit, some = summary.found()
        assert lit == np.count_nonzero(gains)
        for name in ("max_uv", "max_lateral", "min_w", "max_w"):
            assert getattr(scope, name) == pytest.approx(getattr(expected, name), rel=1e-14)
        same(some, expected_some)


def test_parts_of_a_picture_are_surveyed_alone(device, rng):
    hf = wd.HeightField(rng.uniform(size=(16, 40)), pitch_um=(0.2, 0.1))
    count, among = 20 * BLOCK, range(3 * BLOCK, 17 * BLOCK - 100)
    to_lights = hemisphere(rng, count).astype(np.float32)
    deflections = -to_lights - hemisphere(rng, count)
    gains = rng.uniform(0.1, 1.0, count).astype(np.float32)
    seen = slice(among.start, among.stop)
    # What lies elsewhere may be anything.
    given = [np.full_like(each, np.nan) for each in (deflections, to_lights, gains)]
    for each, values in zip(given, (deflections, to_lights, gains), strict=True):
        each[seen] = values[seen]
    dtypes = (wp.vec3d, wp.vec3f, wp.float32)
    arrays = [wp.array(each, dtype=dtype, device=device) for each, dtype in zip(given, dtypes, strict=True)]
    summary = DirectionStatistics(hf, wd.Coherence(), among.stop, device=resolve_device(device))
    step = summary.step(*(each[: among.stop] for each in arrays))
    launch_pipeline([step], among, device=resolve_device(device), threads=2)
    scope, lit, some = summary.found(among=among)
    assert lit == len(among)
    assert scope.max_w == pytest.approx(np.abs(deflections[seen, 2]).max(), rel=1e-14)
    expected = DirectionSample.among(deflections[seen], to_lights[seen], gains[seen])
    same(some, expected)


@pytest.mark.parametrize("count", [0, 5, 4095, 4096, 20_000, 300_000])
def test_half_of_a_large_call_is_not_looked_at(count):
    ranks = sample_ranks(count)
    assert np.all(np.diff(ranks) > 0)
    if count < 4096:
        np.testing.assert_array_equal(ranks, np.arange(count))
    else:
        assert 2000 < len(ranks) <= min(count // 2, 8192)


def test_no_stride_meets_a_picture_at_the_same_columns():
    columns = stratified(512 * 512, 512) % 512
    assert len(np.unique(columns)) > 250
    assert abs(np.corrcoef(np.arange(len(columns)), columns)[0, 1]) < 0.2
