"""Warnings about height fields that are not levelled or whose edges do not match, if this changes their colours."""

import warnings

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.heightfield.edge_checks import warn_of_edges

BIG = wd.gratings.fingers(size_um=25.6, pitch_um=0.1, seed=3)
PATCH = BIG.cropped(18.0).levelled()
U = np.linspace(-0.5, 0.5, 180)
GROOVES = 0.05 * np.tanh(4.0 * np.sin(2.0 * np.pi * np.arange(200) / 57.7 + 1.2))
FEW = np.tile(GROOVES, (200, 1)) + 0.002 * np.random.default_rng(0).normal(size=(200, 200))
WIDE, NARROW = wd.Coherence(), wd.Coherence(sigma_um=0.3)


def tilted(amount: float) -> wd.HeightField:
    """Return a rough patch plus a tilted plane, whose standard deviation is ``amount`` times that of the patch."""
    return wd.HeightField(PATCH.heights_um + amount * PATCH.rms_um * U / np.std(U), PATCH.pitch_um)


def messages(field: wd.HeightField, coherence: wd.Coherence = WIDE) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_edges(field, coherence, 0.78)
    return [str(each.message) for each in caught]


def test_a_tilt_above_the_roughness_is_warned_of_once() -> None:
    field = tilted(3.0)
    (message,) = messages(field)
    assert "heightfield is not levelled" in message
    assert "remove the tilt with levelled()" in message
    assert messages(field) == []
    assert messages(field.levelled()) == []
    assert messages(tilted(0.3)) == []


def test_few_grooves_that_are_cut_are_warned_of_where_windows_reach_the_edges() -> None:
    (message,) = messages(wd.HeightField(FEW, 0.05))
    assert "opposite edges of heightfield do not match along x" in message
    assert "whole_periods()" in message
    field = wd.HeightField(FEW, 0.05)
    for coherence in (NARROW, wd.Coherence("centred", sigma_um=1.0), wd.Coherence("replicas", periods=(1, 1)),
                      wd.Coherence("source", angular_diameter_deg=20.0)):  # fmt: skip
        assert messages(field, coherence) == []
    assert len(messages(field, wd.Coherence("replicas", periods=(1, 5)))) == 1


@pytest.mark.parametrize("make", [
    lambda: BIG, lambda: PATCH, lambda: wd.gratings.blazed(2.0, 0.3), lambda: wd.gratings.lamellar(2.0, 0.3),
    lambda: wd.HeightField(np.tile(np.arange(40.0) % 20.0, (3, 1)) * 0.01, 0.05), lambda: wd.HeightField([[0.2]], 0.1),
    lambda: wd.HeightField([[0.0, 0.1]], 0.1), lambda: wd.HeightField(FEW, 0.05).whole_periods().periodic(),
])  # fmt: skip
def test_gratings_and_rough_patches_are_not_warned_of(make) -> None:
    assert messages(make()) == []


@pytest.mark.filterwarnings("ignore:scalar diffraction", "ignore:a pitch of")
def test_reflectance_and_shade_warn() -> None:
    body, light = wd.meshes.tube(), wd.DirectionalLight((0.3, 1.0, 0.8))
    view = wd.View.fit(body, width=16, height=9)
    options = {"tolerance": 0.3, "coherence": wd.Coherence(sigma_um=1.0)}
    for call in (wd.reflectance, wd.plan):
        with pytest.warns(wd.WarpdiffWarning, match="not levelled"):
            call(tilted(9.0).cropped(6.0), (0, 0, 1), (0.1, 0, 1), **options)
    cut = tilted(0.0).cropped(3.0)
    image = wd.shade(body, cut, light, view, refine=False, **options)
    assert image.report.history == cut.history
    assert "Height field:" in str(image.report)
    assert cut.history[0] in str(image.report)
