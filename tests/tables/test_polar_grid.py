"""Polar grids of (u, v), and the zeroth order, which tables on these grids do not contain.

(u, v) is the tangential part of the scattering vector. The zeroth order is the specular reflection of the mean plane. A
polar grid has rings (circles of constant |(u, v)|) with azimuth samples; an octave is a range of rings up to twice the
radius.
"""

import dataclasses
import math

import numpy as np
import pytest
import warp as wp

import warpdiff as wd
from warpdiff.baked import interpolation
from warpdiff.tables.mip_layout import MipLayout
from warpdiff.tables.polar_grid import PolarGrid
from warpdiff.tables.spectrum_source import source_for
from warpdiff.tables.zeroth_order import ZerothOrder


def test_samples_lie_on_rings_of_equal_ratios():
    grid = PolarGrid(3, math.log(0.2), (4, 8, 8))
    places = grid.places()
    assert len(places) == grid.nodes == 3 * (4 + 8 + 8)
    radii = np.hypot(*places.T)
    np.testing.assert_allclose(radii[grid.starts[:-1]], 0.2 * 2.0 ** (np.arange(9) / 3.0))
    for begin, end in zip(grid.starts[:-1], grid.starts[1:], strict=True):
        turns = np.arctan2(*places[begin:end, ::-1].T) / (2.0 * math.pi) % 1.0
        np.testing.assert_allclose(turns, np.arange(end - begin) / (end - begin), atol=1e-12)
        np.testing.assert_allclose(radii[begin:end], radii[begin])


def test_grids_of_baked_lobes_end_one_ring_beyond_a_radius_of_2():
    grid = interpolation.grid_for(0.02, 12, 1.0)
    ring = interpolation.ring_of_largest(grid.rings, grid.azimuths)
    assert grid.radii.ravel()[ring] == pytest.approx(2.0, rel=1e-12)
    assert ring == grid.radii.size - 2


@pytest.mark.parametrize("coherence", [wd.Coherence(sigma_um=3.25), wd.Coherence("source", angular_diameter_deg=2.0)])
def test_rows_of_mip_levels_are_stored_one_after_another(coherence):
    """The rows of all mip levels (blurred copies of a table) must be stored one after another without gaps.

    All mip levels have the rings (circles of constant |(u, v)|) of level 0, and at most its number of azimuth samples.
    Before and after the rows of each octave of |(u, v)| there are additional rows, which repeat the last and the first
    azimuth samples of the octave.
    """
    plan = wd.plan(wd.HeightField(np.zeros((8, 8)), 0.09), coherence=coherence, method="low-rank")
    plan = dataclasses.replace(plan, rings_per_octave=8, azimuths_per_width=0.9)
    layout = MipLayout.for_plan(plan, 4.0).with_mip_levels()
    rows = layout.first_rows
    assert rows.shape == (len(layout.levels), len(layout.levels[0].azimuths))
    counts = np.diff([*rows.ravel(), layout.rows + rows[0, 0]]) / plan.rings_per_octave
    azimuths = np.array([grid.azimuths for grid in layout.levels])
    np.testing.assert_array_equal(counts.reshape(azimuths.shape) - azimuths, 2 * rows[0, 0] / plan.rings_per_octave)
    assert np.all(np.diff(azimuths[1:], axis=0) <= 0)
    assert {(grid.rings, grid.log_radius) for grid in layout.levels} == {
        (plan.rings_per_octave, layout.levels[0].log_radius)
    }
    assert np.all(np.diff(layout.level_blurs, axis=0) >= 0.0)


@pytest.mark.parametrize("coherence", [wd.Coherence(sigma_um=3.25), wd.Coherence("source", angular_diameter_deg=2.0)])
def test_two_computations_of_the_zeroth_order_agree(coherence):
    """The zeroth order of a colour table must equal that of baked lobes (colours exported for other renderers).

    Baking computes the zeroth order in another way, from a histogram of heights.
    """
    surface = wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=3)
    plan = wd.plan(surface, coherence=coherence, method="low-rank", tolerance=1e-2, strict=False)
    plan = dataclasses.replace(plan, rings_per_octave=8, azimuths_per_width=0.9)
    source = source_for(surface, plan, plan.direction_range, device=wp.get_device("cpu"), threads=1)
    ends = source.zeroth.least_kappa, source.zeroth.largest_kappa
    counted = ZerothOrder.of_heights(surface, coherence, ends, 1024)
    kappas = np.linspace(*ends, 300)
    np.testing.assert_allclose(source.zeroth.at(kappas), counted.at(kappas), atol=5e-4)
    assert source.zeroth.lobe_variance(0.5) == counted.lobe_variance(0.5)


def test_the_lobe_variance_follows_from_the_coherence():
    """The variance of a lobe (the peak of a diffraction order) must follow from the coherence.

    A window has the lobe exp(−4π²σ²|q|²) with q = (u, v)/λ. For a light source of finite size, the lobe does not depend
    on λ.
    """
    power = np.ones(2, dtype=np.float32)
    averaged, source = (
        ZerothOrder(power, 0.0, 1.0, coherence) for coherence in (wd.Coherence(sigma_um=3.0), wd.Coherence("source"))
    )
    assert averaged.lobe_variance(0.6) == pytest.approx(0.6**2 / (8.0 * math.pi**2 * 9.0))
    assert source.lobe_variance(0.4) == source.lobe_variance(0.7) == source.coherence.spread**2
