"""Cache of tables: its size in bytes, its keys, and tables with and without mip levels.

A table stores the colours of a surface by scattering vector. Its mip levels are blurred copies. A plan has the numbers
of a computation, from which a table is made.
"""

import ast
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import warp as wp

import warpdiff as wd
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.tables import colour_table
from warpdiff.tables.table_cache import TableCache

PACKAGE = Path(wd.__file__).parent
OPTIONS = {"device": wp.get_device("cpu"), "threads": 2}
D65, A = IlluminatedMaterial("D65"), IlluminatedMaterial("A")
COHERENCES = [
    wd.Coherence(sigma_um=3.25),
    wd.Coherence("centred", 3.25),
    wd.Coherence("source", angular_diameter_deg=3.0),
]


@pytest.fixture
def heightfield():
    """Return a height field for which no colour table is cached."""
    return wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=7)


def plan_of(heightfield, coherence):
    plan = wd.plan(heightfield, coherence=coherence, method="low-rank", tolerance=0.1, strict=False)
    return dataclasses.replace(plan, rings_per_octave=8, azimuths_per_width=0.9)


def table(heightfield, plan, illuminated=D65):
    return colour_table.table_for(heightfield, plan, plan.direction_range, illuminated, **OPTIONS)


def arrays_of(struct):
    values = [getattr(struct, name) for name in struct._cls.vars]
    return [value for value in values if isinstance(value, wp.array) and value.ptr]


@pytest.mark.parametrize("coherence", COHERENCES, ids=str)
def test_the_size_of_the_cache_is_that_of_its_distinct_arrays(heightfield, coherence):
    """The size of the cache must be the total size of its arrays, each of which counts once.

    Arrays of tables have space for mip levels (blurred copies). This space counts only after the levels have been
    computed.
    """
    plan = plan_of(heightfield, coherence)
    blurred = dataclasses.replace(plan, footprint=True)
    requests = [(plan, D65), (blurred, D65), (plan, A), (plan, D65), (blurred, A)]
    cache = TableCache.of(heightfield).colours
    for request, illuminated in requests:
        table(heightfield, request, illuminated)
    cached = list(cache._values.values())
    assert len(cached) == 2
    arrays = {array.ptr: array for entry in cached for array in arrays_of(entry.struct)}
    if not coherence.adds_powers:
        # A table of amplitudes (centred window) cannot be blurred. It has only mip level 0, so that the part of its
        # arrays for other levels stays unused.
        unfilled = {entry.fields["rows"].ptr: entry.layout.rows for entry in cached}
        arrays = {ptr: array[: unfilled.get(ptr, len(array))] for ptr, array in arrays.items()}
    assert cache.nbytes == sum(array.size * wp.types.type_size_in_bytes(array.dtype) for array in arrays.values())
    assert all(len(entry.layout.levels) > 1 for entry in cached) == coherence.adds_powers


def test_a_table_without_levels_stays_without_them(heightfield):
    """A call without mip levels must get the same table after another call has added mip levels to the cached table."""
    plan = plan_of(heightfield, COHERENCES[0])
    before = table(heightfield, plan)
    levels = table(heightfield, dataclasses.replace(plan, footprint=True))
    after = table(heightfield, plan)
    assert levels.struct.azimuths.shape[0] > 1
    for one in (before, after):
        assert one.struct.azimuths.shape[0] == 1
        assert one.fields["rows"] is levels.fields["rows"]
    np.testing.assert_array_equal(after.struct.first_rows.numpy(), levels.struct.first_rows.numpy()[:1])
    without = after.without_zeroth_order().struct
    assert without.rows is after.struct.rows
    assert not without.zeroth_order
    assert len(after.struct.zeroth_order)


def test_equal_plans_share_a_table(heightfield):
    """Plans (numbers of a computation) with equal values must share a table of colours in the cache.

    The keys of the cache are frozen dataclasses, which are equal if their values are.
    """
    plan = plan_of(heightfield, COHERENCES[0])
    first = table(heightfield, plan)
    again = table(heightfield, dataclasses.replace(plan), IlluminatedMaterial("D65"))
    assert again.fields["rows"] is first.fields["rows"]
    cache = TableCache.of(heightfield)
    keys = [key for name in ("coefficients", "rows", "sources", "spectra") for key in getattr(cache, name)._values]
    assert len(keys) >= 4
    assert all(dataclasses.is_dataclass(key) and type(key).__dataclass_params__.frozen for key in keys)
    assert all(dataclasses.is_dataclass(part) for key in cache.colours._values for part in key)


def test_keys_of_caches_contain_no_identities_of_objects_and_no_texts():
    """Keys of caches must not contain the ``id`` or the text of an object.

    An ``id`` may be used again after its object is deleted, and different objects may have equal texts.
    """
    for package, names in {"tables": {"id", "str", "repr", "hash"}, "baked": {"id", "repr", "hash"}}.items():
        for path in sorted((PACKAGE / package).glob("*.py")):
            calls = [
                node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)
            ]
            called = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
            assert not called & names, path
