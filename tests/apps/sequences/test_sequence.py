"""Sequences: shots lie where they should, frames are the renderer's, and what was interrupted goes on."""

import dataclasses
import json
import pickle

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (as its own manual does)
import pytest
from PIL import Image

import warpdiff as wd

LIGHT = wd.DirectionalLight((0.3, 1.0, 0.4))
VIEW = wd.View((0.0, 2.0, 3.0), (0.1, 0.0, 0.0), fov_y_deg=50.0, width=40, height=30)


@pytest.fixture(scope="module")
def renderer():
    body = wd.meshes.tube(segments_along=24, segments_around=12)
    heightfield = wd.gratings.fingers(size_um=6.4)
    return wd.Renderer(
        body, heightfield, LIGHT, VIEW, tolerance=0.2, coherence=wd.Coherence(sigma_um=3.0), refine=False
    )


def pixels(path):
    return np.asarray(Image.open(path)).astype(int)


def test_a_turntable_turns_once_about_the_target():
    shots = wd.turntable(LIGHT, VIEW, count=8)
    assert shots[0] == wd.Shot((LIGHT,), VIEW)
    eyes = np.array([each.view.eye for each in shots]) - VIEW.target
    np.testing.assert_allclose(np.linalg.norm(eyes, axis=1), np.linalg.norm(eyes[0]))
    np.testing.assert_allclose(eyes.sum(axis=0)[[0, 2]], 0.0, atol=1e-9)
    np.testing.assert_allclose(eyes[:, 1], 2.0)
    # The light keeps its place to the camera, which goes clockwise, as the body turns counter-clockwise.
    towards = np.array([each.lights[0].to_light for each in shots])
    np.testing.assert_allclose(np.sum(towards * eyes, axis=1), towards[0] @ eyes[0])
    before, after = eyes[0, [0, 2]], eyes[1, [0, 2]]
    assert before[1] * after[0] - before[0] * after[1] < 0.0
    around = wd.turntable(LIGHT, VIEW, count=8, turns=-0.5, lights_follow=False)
    assert {each.lights for each in around} == {(LIGHT,)}
    # Half of a half turn, counter-clockwise as seen from above.
    np.testing.assert_allclose(around[4].view.eye, (3.1, 2.0, 0.1))


def test_a_sweep_goes_from_one_light_to_the_other_at_a_constant_pace():
    shots = wd.light_sweep(LIGHT, VIEW, (-1.0, 0.2, 0.3), count=7)
    towards = np.array([each.lights[0].to_light for each in shots])
    np.testing.assert_allclose(towards[0], LIGHT.to_light)
    np.testing.assert_allclose(towards[-1], np.array([-1.0, 0.2, 0.3]) / np.linalg.norm([-1.0, 0.2, 0.3]))
    np.testing.assert_allclose(np.sum(towards[1:] * towards[:-1], axis=1), towards[0] @ towards[1])
    with pytest.raises(ValueError, match="opposite"):
        wd.light_sweep(LIGHT, VIEW, tuple(-each for each in LIGHT.to_light))


def test_a_path_is_read_from_a_file(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text(
        "eye_x,eye_y,eye_z,target_x,target_y,target_z,fov_y_deg\n0,2,3,0,0,0,50\n1,2,3,0,0,0,40\n2,2,3,0,0,0,30\n"
    )
    shots = wd.camera_path(path, LIGHT, VIEW)
    assert [each.view.eye for each in shots] == [(0.0, 2.0, 3.0), (1.0, 2.0, 3.0), (2.0, 2.0, 3.0)]
    assert [each.view.fov_y_deg for each in shots] == [50.0, 40.0, 30.0]
    between = wd.camera_path(path, LIGHT, VIEW, count=5)
    np.testing.assert_allclose([each.view.eye[0] for each in between], [0.0, 0.5, 1.0, 1.5, 2.0], atol=1e-12)
    for text, message in (
        ("", "must begin with columns"),
        ("eye_x,eye_y\n1,2\n", "must begin with columns"),
        ("eye_x,eye_y,eye_z,target_x,target_y,target_z\n1,2,3,4,5\n", "row 1"),
        ("eye_x,eye_y,eye_z,target_x,target_y,target_z\n1,2,3,4,5,nan\n", "finite"),
        ("eye_x,eye_y,eye_z,target_x,target_y,target_z\n1,2,3,1,2,3\n", "frame 0"),
        ("eye_x,eye_y,eye_z,target_x,target_y,target_z\n", "1 to"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            wd.camera_path(path, LIGHT, VIEW)


def test_frames_are_the_renderer_s_at_one_exposure(renderer, tmp_path):
    shots = wd.turntable(LIGHT, VIEW, count=5)
    shares = []
    paths = wd.sequence(renderer, shots, tmp_path / "turn", formats=[".png", ".exr"], progress=shares.append)
    assert [each.name for each in paths] == [f"frame_{k:04d}{end}" for end in (".png", ".exr") for k in range(5)]
    np.testing.assert_allclose(shares, np.arange(6) / 5)
    exposure = json.loads((tmp_path / "turn" / "sequence.json").read_text())["exposure"]
    for index, shot in enumerate(shots):
        renderer.draw(shot.lights, shot.view)
        expected = renderer.image().save(tmp_path / "expected.png", exposure=exposure)
        np.testing.assert_array_equal(pixels(paths[index]), pixels(expected))
        xyz = oiio.ImageBuf(str(paths[5 + index])).get_pixels(oiio.FLOAT)[..., 4:7]
        np.testing.assert_array_equal(xyz, renderer.image().xyz)
    factors = []
    for shot in shots:
        renderer.draw(shot.lights, shot.view)
        factors.append(renderer.image().auto_exposure)
    assert min(factors) <= exposure <= max(factors)


def test_what_was_interrupted_goes_on_and_nothing_is_drawn_twice(renderer, tmp_path, monkeypatch):
    shots = wd.turntable(LIGHT, VIEW, count=6)
    whole = [path.read_bytes() for path in wd.sequence(renderer, shots, tmp_path / "whole")]

    def interrupt(share):
        if share > 0.5:
            raise KeyboardInterrupt

    folder = tmp_path / "turn"
    with pytest.raises(KeyboardInterrupt):
        wd.sequence(renderer, shots, folder, progress=interrupt)
    assert len(list(folder.glob("frame_*"))) == 4
    # One was cut off by a full disk elsewhere, one is of another size.
    (folder / "frame_0001.png").write_bytes(whole[1][:-20])
    Image.new("RGBA", (4, 4)).save(folder / "frame_0002.png")
    drawn = []
    draw = wd.Renderer.draw
    monkeypatch.setattr(wd.Renderer, "draw", lambda self, lights, view: drawn.append(view) or draw(self, lights, view))
    # A renderer like it in another process.
    paths = wd.sequence(pickle.loads(pickle.dumps(renderer)), shots, folder)  # noqa: S301 (our own)
    assert drawn == [shots[index].view for index in (1, 2, 4, 5)]
    assert [path.read_bytes() for path in paths] == whole
    assert {path.name for path in folder.iterdir()} == {"sequence.json", *(path.name for path in paths)}


def test_frames_of_another_sequence_are_not_mixed_in(renderer, tmp_path):
    shots = wd.turntable(LIGHT, VIEW, count=3)
    wd.sequence(renderer, shots, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    other = wd.turntable(LIGHT, VIEW, count=2)
    for changes in (
        {"shots": other},
        {"display": "clip"},
        {"exposure_stops": 1.0},
        {"exposure": 2},
        {"background": (0, 0, 0)},
        {"bits": 16},
        {"renderer": renderer.resized(VIEW, refine=True)},
    ):
        with pytest.raises(ValueError, match="another sequence"):
            wd.sequence(**{"renderer": renderer, "shots": shots, "folder": tmp_path} | changes)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    wd.sequence(renderer, other, tmp_path, exposure=2, overwrite=True)
    wd.sequence(renderer, other, tmp_path, exposure=2.0)
    assert sorted(path.name for path in tmp_path.glob("frame_*")) == ["frame_0000.png", "frame_0001.png"]
    (tmp_path / "sequence.json").write_text("{")
    with pytest.raises(ValueError, match="another sequence"):
        wd.sequence(renderer, other, tmp_path)


@pytest.mark.parametrize("suffix", [".webp", ".png", ".gif"])
def test_an_animated_file_shows_every_frame(renderer, tmp_path, suffix):
    shots = wd.turntable(LIGHT, VIEW, count=4)
    target = tmp_path / f"turn{suffix}"
    paths = wd.sequence(
        renderer, shots, tmp_path / "turn", animation=target, frames_per_second=10.0, background=(0.0, 0.0, 0.0)
    )
    with Image.open(target) as film:
        assert film.n_frames == 4
        assert film.info["loop"] == 0
        for index in range(4):
            film.seek(index)
            # Lossy ones and palettes differ a little.
            difference = np.abs(np.asarray(film.convert("RGB")).astype(int) - pixels(paths[index])[..., :3])
            assert difference.mean() < {".png": 1e-9, ".webp": 3.0, ".gif": 6.0}[suffix]
            assert film.info["duration"] == pytest.approx(100.0)
    with pytest.raises(ValueError, match="animation"):
        wd.sequence(renderer, shots, tmp_path / "turn", animation=tmp_path / "turn.mp4")
    with pytest.raises(ValueError, match="formats"):
        wd.sequence(renderer, shots, tmp_path / "exr", formats=[".exr"], animation=target)


def test_shots_of_another_size_are_refused(renderer, tmp_path):
    larger = dataclasses.replace(VIEW, width=80)
    with pytest.raises(ValueError, match=r"shots\[0\].view must have 40 × 30"):
        wd.sequence(renderer, wd.turntable(LIGHT, larger, count=2), tmp_path)
    assert not list(tmp_path.iterdir())
