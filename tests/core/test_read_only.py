"""Copies by pickle and deepcopy have read-only arrays, as their originals."""

import copy
import pickle

import numpy as np
import pytest

import warpdiff as wd

CELL = wd.gratings.sinusoidal(1.2, 0.15, samples=8)
OBJECTS = {
    "GratingMap": (wd.GratingMap(CELL, turn_deg=[[0.0, 30.0]]), ("turn_deg", "depth_scale", "transforms")),
    "HeightField": (CELL, ("heights_um", "missing")),
    "Outline": (wd.profiles.Outline([0.0, 1.0], [0.0, 0.1], 2.0), ("positions", "heights_um")),
    "Spectrum": (wd.Spectrum([380.0, 780.0], [1.0, 2.0]), ("wavelengths_nm", "values")),
    "Material": (wd.Material([380.0, 780.0], [1.5, 1.4]), ("wavelengths_nm", "n", "k")),
    "Environment": (wd.Environment(np.ones((2, 4, 3))), ("radiance_rgb",)),
    "View": (wd.View((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)), ()),
    "Table": (wd.Table({"a": [1.0, 2.0]}), ()),
}


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])  # noqa: S301
def test_copies_are_read_only(name, copied):
    original, attributes = OBJECTS[name]
    if name == "View":
        original.frame()
    arrays = [getattr(original, attribute) for attribute in attributes]
    again = copied(original)
    copies = [getattr(again, attribute) for attribute in attributes]
    copies += {"View": lambda: list(again.frame()[:4]), "Table": lambda: [again["a"]]}.get(name, list)()
    assert copies
    assert not any(array.flags.writeable for array in copies)
    for array, other in zip(arrays, copies, strict=False):
        np.testing.assert_array_equal(array, other)
    assert repr(again) == repr(original)
