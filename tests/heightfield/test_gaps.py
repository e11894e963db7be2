"""Missing samples of height fields: marked, filled accurately, ignored by cleaning, and refused by rendering."""

from pathlib import Path

import numpy as np
import pytest
from conftest import slow

import warpdiff as wd
from warpdiff import gratings
from warpdiff.apps import cli
from warpdiff.core.validation import finite_array
from warpdiff.heightfield import inpainting

PITCH = (0.1, 0.08)
SHAPE = (50, 60)
Y, X = np.meshgrid(np.arange(SHAPE[0]) * PITCH[0], np.arange(SHAPE[1]) * PITCH[1], indexing="ij")
# Missing samples: a disc away from the edges of the field.
GAP = np.hypot(Y - 2.0, X - 2.6) < 0.75
# Invalid height in µm that an instrument writes for samples without a signal.
NO_SIGNAL = 1000.0


def gappy(heights: np.ndarray, gap: np.ndarray = GAP) -> wd.HeightField:
    return wd.HeightField(np.ma.MaskedArray(np.where(gap, NO_SIGNAL, heights), gap), PITCH)


def waves() -> np.ndarray:
    return 0.05 * np.sin(2.0 * np.pi * X / 2.4) * np.cos(2.0 * np.pi * Y / 3.0)


def test_masked_and_nan_samples_are_missing() -> None:
    heights = waves()
    masked = gappy(heights)
    marked = wd.HeightField(np.where(GAP, np.nan, heights), PITCH)
    for field in (masked, marked):
        np.testing.assert_array_equal(field.missing, GAP)
        np.testing.assert_array_equal(np.isnan(field.heights_um), GAP)
        np.testing.assert_array_equal(field.heights_um[~GAP], heights[~GAP])
        assert field.height_range_um == np.ptp(heights[~GAP])
        assert field.rms_um == pytest.approx(np.std(heights[~GAP]))
        # The heights are 0.05 · sin(2πx/2.4) · cos(2πy/3.0) in µm. Their slopes along x and y are at most 0.131 and
        # 0.105, so that the slope is at most 0.17.
        assert 0.0 < field.mean_slope < 0.17
        assert 0.0 < field.rms_slope < 0.17
        assert f"{GAP.sum()} missing" in repr(field)
        assert f"missing           {GAP.sum()} samples" in str(field.summary())
    assert "missing" not in str(gratings.bumps().summary())
    # A mask without marked samples means that none is missing. Integer arrays can be masked, too.
    assert not wd.HeightField(np.ma.MaskedArray(heights), PITCH).missing.any()
    assert wd.HeightField(np.ma.MaskedArray([[1, 9999]], [[False, True]]), 1.0).height_range_um == 0.0


def test_no_heights_at_all_and_masks_elsewhere_are_refused() -> None:
    with pytest.raises(ValueError, match=r"at least one height, got 3000 NaN or masked"):
        gappy(waves(), np.ones(SHAPE, dtype=np.bool_))
    with pytest.raises(ValueError, match="at least one height"):
        gappy(waves()).cropped(0.5, offset_um=(1.8, 2.4))
    with pytest.raises(ValueError, match="to_light must be finite, got 1 NaN, masked or infinite"):
        finite_array(np.ma.MaskedArray([0.0, 1.0, 1.0], [False, True, False]), "to_light")


def test_the_error_of_a_filled_gap_is_within_the_documented_bound() -> None:
    heights = waves()
    filled = gappy(heights).filled()
    assert not filled.missing.any()
    np.testing.assert_array_equal(filled.heights_um[~GAP], heights[~GAP])
    laplacian = np.zeros(SHAPE)
    for axis, pitch in enumerate(PITCH):
        laplacian += (np.roll(heights, 1, axis) + np.roll(heights, -1, axis) - 2.0 * heights) / pitch**2
    error = np.abs(filled.heights_um - heights).max()
    assert 0.1 < error / (1.5**2 / 8.0 * np.abs(laplacian[GAP]).max()) < 1.0
    plane = 0.3 * X - 0.2 * Y + 5.0
    np.testing.assert_allclose(gappy(plane).filled().heights_um, plane, atol=1e-9)


def test_filling_solves_laplaces_equation_up_to_the_edges() -> None:
    # Half of the field and some single samples are missing. In the filled field, each missing sample must be the mean
    # of its four neighbours, weighted by 1/pitch².
    gap = (Y > 3.0) | (np.random.default_rng(5).random(SHAPE) < 0.1)
    field = gappy(waves(), gap)
    filled = field.filled().heights_um
    balance = np.zeros(SHAPE)
    for axis, pitch in enumerate(PITCH):
        flow = np.diff(np.pad(filled, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], mode="edge"), axis=axis)
        balance += np.diff(flow, axis=axis) / pitch**2
    assert np.abs(balance[gap]).max() < 1e-7 * np.abs(balance[~gap]).max()
    assert filled.min() >= np.nanmin(field.heights_um)
    assert filled.max() <= np.nanmax(field.heights_um)
    np.testing.assert_array_equal(wd.HeightField([[np.nan, 2.0, np.nan]], 1.0).filled().heights_um, 2.0)


GAPS = {
    "half": np.add.outer(np.zeros(300), np.arange(301)) > 150,
    "all but a corner": np.add.outer(np.arange(300), np.arange(301)) > 0,
    "stripes": np.add.outer(np.zeros(300), np.arange(301) % 20) > 9,
    "single samples": np.random.default_rng(3).random((300, 301)) < 0.7,
    "islands": np.random.default_rng(3).random((300, 301)) > 1e-3,
}


@pytest.mark.parametrize("name", GAPS)
@pytest.mark.parametrize("pitch", [(0.1, 0.1), slow((0.1, 1.0)), (3.0, 0.1)])
def test_large_gaps_are_filled_in_as_few_steps_as_small_ones(name: str, pitch, monkeypatch, rng) -> None:
    # The heights in gaps solve linear equations. The method of conjugate gradients with a multigrid preconditioner
    # solves them in at most 40 steps. Without the preconditioner it would need more than 1000.
    monkeypatch.setattr(inpainting, "_MOST_STEPS", 40)
    heights = np.where(GAPS[name], np.nan, 0.01 * rng.standard_normal(GAPS[name].shape))
    filled = wd.HeightField.of_known_scale(heights, pitch).filled().heights_um
    padded = np.pad(filled, 1, mode="edge")
    beside = [padded[2:, 1:-1] + padded[:-2, 1:-1], padded[1:-1, 2:] + padded[1:-1, :-2]]
    weights = [(min(pitch) / distance) ** 2 for distance in pitch]
    balance = sum(weight * (pair - 2.0 * filled) for weight, pair in zip(weights, beside, strict=True))
    assert np.abs(balance[GAPS[name]]).max() < 1e-7


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_levelling_is_not_disturbed_by_a_gap(order: int) -> None:
    trend = {0: 7.0, 1: 0.3 * X - 0.2 * Y, 2: 0.1 * X * Y - 0.05 * Y**2, 3: 0.01 * X**2 * Y}
    total = sum((np.broadcast_to(trend[degree], SHAPE) for degree in range(order + 1)), np.zeros(SHAPE))
    result = gappy(total).levelled(order)
    np.testing.assert_array_equal(result.missing, GAP)
    np.testing.assert_allclose(result.heights_um[~GAP], 0.0, atol=1e-12)
    # Levelling with gaps equals the least-squares solution over the existing samples, computed by NumPy.
    rough = gappy(waves() + total)
    terms = [X**i * Y**j for i in range(order + 1) for j in range(order + 1 - i)]
    matrix = np.stack([term[~GAP] for term in terms], axis=1)
    known = rough.heights_um[~GAP]
    expected = known - matrix @ np.linalg.lstsq(matrix, known, rcond=None)[0]
    np.testing.assert_allclose(rough.levelled(order).heights_um[~GAP], expected, atol=1e-12)


@pytest.mark.filterwarnings("ignore:periodic")
def test_despiking_and_making_periodic_preserve_gaps() -> None:
    grain = 0.6 * np.clip(1.0 - 4.0 * np.hypot(Y - 4.0, X - 0.8), 0.0, 1.0)
    dirty = gappy(waves() + grain)
    clean = dirty.despiked()
    np.testing.assert_array_equal(clean.missing, GAP)
    assert clean.height_range_um < 0.12
    assert dirty.height_range_um > 0.3
    changed = (clean.heights_um != dirty.heights_um) & ~GAP
    assert changed[grain > 0.1].all()
    assert not changed[grain == 0.0].mean() > 0.02
    # ``periodic()`` subtracts a smooth surface that depends only on samples at the edges. A gap elsewhere has no
    # effect.
    whole = wd.HeightField(waves(), PITCH).periodic()
    np.testing.assert_allclose(gappy(waves()).periodic().heights_um[~GAP], whole.heights_um[~GAP])
    np.testing.assert_array_equal(gappy(waves()).periodic().missing, GAP)
    at_edge = gappy(waves(), X > 4.3).periodic()
    np.testing.assert_array_equal(at_edge.missing, X > 4.3)
    np.testing.assert_array_equal(gappy(waves()).cropped((2.0, 2.4)).missing, GAP[15:35, 15:45])
    (period,) = gappy(0.05 * waves() + 0.04 * np.sin(2.0 * np.pi * X / 0.7)).periods()
    assert period.period_um == pytest.approx(0.7, rel=0.01)


@pytest.mark.parametrize(
    "use",
    [lambda heightfield: heightfield.resampled(0.2), wd.plan,
     lambda heightfield: wd.reflectance(heightfield, (0, 0, 1), (0, 0, 1)),
     lambda heightfield: wd.order_efficiencies(heightfield, (0, 0, 1), 550.0),
     lambda heightfield: wd.shade(wd.meshes.tube(), heightfield, wd.DirectionalLight((0, 0, 1)),
                                  wd.View((0, 0, 5), (0, 0, 0))),
     lambda heightfield: wd.Renderer(wd.meshes.tube(), heightfield, wd.DirectionalLight((0, 0, 1)),
                                     wd.View((0, 0, 5), (0, 0, 0)))],
    ids=["resampled", "plan", "reflectance", "order_efficiencies", "shade", "Renderer"],
)  # fmt: skip
def test_gaps_are_refused_by_rendering_and_resampling(use) -> None:
    message = rf"heightfield must have all samples, but {GAP.sum()} of 3000 are missing.*fill them with filled\(\)"
    with pytest.raises(ValueError, match=message):
        use(gappy(waves()))


def test_files_may_contain_nan(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", np.where(GAP, np.nan, waves()))
    np.testing.assert_array_equal(wd.HeightField.load(tmp_path / "scan.npy", pitch_um=PITCH).missing, GAP)


def test_the_command_line_reports_gaps_and_fills_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "scan.npy", np.where(GAP, np.nan, waves()))
    options = ["info", "--heightfield", str(tmp_path / "scan.npy"), "--pitch-um", "0.1", "--tolerance", "0.3"]
    assert cli.main(options) == 0
    output = capsys.readouterr().out
    assert f"missing           {GAP.sum()} samples" in output
    assert "--fill" in output
    assert cli.main([*options, "--fill"]) == 0
    assert "missing" not in capsys.readouterr().out
