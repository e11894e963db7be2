"""Tables of Fourier coefficients in the cache: when they are fitted, reused, removed and deleted.

A plan has the numbers of a computation, such as the number of terms of the series that a table stores for each
coefficient.
"""

import dataclasses
import gc
import weakref

import numpy as np
import pytest
from conftest import at_angle

import warpdiff as wd
from warpdiff.diffraction import coefficient_basis
from warpdiff.tables import table_cache
from warpdiff.tables.table_cache import TableCache

UP = [0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def rough() -> wd.HeightField:
    """Return a small patch with structure along both axes, sampled finely enough for all directions."""
    return wd.gratings.fingers(size_um=6.4, seed=3)


@pytest.fixture
def builds(monkeypatch):
    """Return a list of the height fields to whose Fourier coefficients basis functions are fitted during the test."""
    built = []
    fitted = coefficient_basis.fitted

    def counted(heightfield, *args, **options):
        built.append(weakref.ref(heightfield))
        return fitted(heightfield, *args, **options)

    monkeypatch.setattr(coefficient_basis, "fitted", counted)
    return built


def test_coefficient_tables_are_cached_for_the_next_call(rough, builds):
    heightfield = wd.HeightField(rough.heights_um, rough.pitch_um)
    plan = wd.plan(heightfield, tolerance=0.3)
    assert len(builds) == 1
    first = wd.reflectance(heightfield, UP, UP, plan=plan)
    np.testing.assert_array_equal(wd.reflectance(heightfield, UP, UP, plan=plan), first)
    # Tables of coefficients are reused if only lights, index of refraction, wavelengths or the number of terms change.
    wd.reflectance(heightfield, at_angle(10.0), UP, plan=plan, ior=2.0)
    wd.spectral_reflectance(heightfield, UP, UP, [500.0, 600.0], plan=plan)
    wd.reflectance(heightfield, UP, UP, plan=dataclasses.replace(plan, terms=plan.terms - 1))
    assert len(builds) == 1
    # Another ``HeightField`` object with equal heights has its own tables of coefficients.
    wd.reflectance(wd.HeightField(rough.heights_um, rough.pitch_um), UP, UP, plan=plan)
    assert len(builds) == 2


def test_the_number_of_cached_tables_is_limited(rough, builds):
    heightfield = wd.HeightField(rough.heights_um, rough.pitch_um)
    plan = wd.plan(heightfield, tolerance=0.3)
    scopes = [dataclasses.replace(plan, max_uv=uv) for uv in (0.2, 0.6, 1.0, 1.4, 1.8)]
    for each in scopes:
        wd.reflectance(heightfield, UP, UP, plan=each)
    assert len(TableCache.of(heightfield).coefficients) == table_cache.MOST_CACHED
    assert len(builds) == 1 + len(scopes)
    # The cache contains the tables of coefficients that were used last. The table of the last plan is reused. The table
    # of the first plan has been removed from the cache, and is built again.
    wd.reflectance(heightfield, UP, UP, plan=scopes[-1])
    assert len(builds) == 1 + len(scopes)
    wd.reflectance(heightfield, UP, UP, plan=scopes[0])
    assert len(builds) == 2 + len(scopes)


def test_tables_are_deleted_with_their_height_field(rough, builds):
    heightfield = wd.HeightField(rough.heights_um, rough.pitch_um)
    wd.reflectance(heightfield, UP, UP, method="low-rank")
    gc.collect()
    before = len(table_cache._caches)
    del heightfield
    gc.collect()
    assert builds[0]() is None
    assert len(table_cache._caches) == before - 1


@pytest.mark.parametrize("height_um", [0.3, 0.31])
def test_no_series_is_computed_twice(height_um, monkeypatch):
    made = []
    of_series = coefficient_basis.of_series

    def counted(heightfield, method, grid, block, kappas, *, terms, threads):
        made.append((method, block, kappas, terms))
        return of_series(heightfield, method, grid, block, kappas, terms=terms, threads=threads)

    monkeypatch.setattr(coefficient_basis, "of_series", counted)
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", "")
    surface = wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=3)
    heights = surface.heights_um * (height_um / surface.height_range_um)
    heightfield = wd.HeightField.of_known_scale(heights, surface.pitch_um)
    wd.plan(heightfield, method="low-rank", integration="table", coherence=wd.Coherence(sigma_um=3.25))
    assert len(made) == len(set(made))
    assert len(TableCache.of(heightfield).fitted_to) == 0
