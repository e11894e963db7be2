"""Sequences of frames: positions of cameras and lights, frames equal to those of the renderer, and resumption."""

import dataclasses
import json
import math
import pickle
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import pytest
from PIL import Image

import warpdiff as wd
from warpdiff.apps.sequences import frames
from warpdiff.apps.sequences.sequence import _is_whole
from warpdiff.image.picture_files import ends_as_png
from warpdiff.lights.environment import with_settings
from warpdiff.request.settings import DisplaySettings

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
    # Lights keep their position relative to the camera. The camera moves clockwise, so the mesh appears to turn
    # counter-clockwise.
    towards = np.array([each.lights[0].to_light for each in shots])
    np.testing.assert_allclose(np.sum(towards * eyes, axis=1), towards[0] @ eyes[0])
    before, after = eyes[0, [0, 2]], eyes[1, [0, 2]]
    assert before[1] * after[0] - before[0] * after[1] < 0.0
    around = wd.turntable(LIGHT, VIEW, count=8, turns=-0.5, lights_follow=False)
    assert {each.lights for each in around} == {(LIGHT,)}
    # In frame 4 of the half turn, the camera has rotated by a quarter turn, counter-clockwise as seen from above.
    np.testing.assert_allclose(around[4].view.eye, (3.1, 2.0, 0.1))
    # A camera fitted with ``turning=True`` shows the whole mesh in all frames of a turntable. Here the camera moves
    # around one end of the mesh.
    body = wd.meshes.tube()
    for shot in wd.turntable(
        LIGHT, wd.View.fit(body, target=body.vertices[0], width=40, height=30, turning=True), count=7
    ):
        frame = shot.view.frame()
        rays = body.vertices - frame.origin
        depth = -rays @ frame.back
        assert np.abs(rays @ frame.right / depth).max() < frame.half_width
        assert np.abs(rays @ frame.up / depth).max() < frame.half_height


def test_a_sweep_moves_from_one_direction_to_the_other_at_constant_speed():
    shots = wd.light_sweep(LIGHT, VIEW, (-1.0, 0.2, 0.3), count=7)
    towards = np.array([each.lights[0].to_light for each in shots])
    np.testing.assert_allclose(towards[0], LIGHT.to_light)
    np.testing.assert_allclose(towards[-1], np.array([-1.0, 0.2, 0.3]) / np.linalg.norm([-1.0, 0.2, 0.3]))
    np.testing.assert_allclose(np.sum(towards[1:] * towards[:-1], axis=1), towards[0] @ towards[1])
    with pytest.raises(ValueError, match="opposite"):
        wd.light_sweep(LIGHT, VIEW, tuple(-each for each in LIGHT.to_light))


def test_point_lights_sweep_about_the_target_and_skies_about_the_vertical():
    lamp, sky = wd.PointLight((0.1, 2.0, 0.0), power=3.0), wd.Environment.clear_sky((1.0, 1.0, 0.0))
    disc = dataclasses.replace(LIGHT, angular_diameter_deg=3.0)
    # The point light moves along a quarter circle around the target (point in the middle of the view), at its initial
    # distance.
    shots = wd.light_sweep([lamp, disc], VIEW, (0.0, 0.0, 5.0), count=3)
    half = math.sqrt(2.0)
    positions = [each.lights[0].position for each in shots]
    np.testing.assert_allclose(positions, [(0.1, 2, 0), (0.1, half, half), (0.1, 0, 2)], atol=1e-12)
    # While the point light moves, the direction to the disc light rotates about +x by a quarter turn.
    x, y, z = disc.to_light
    np.testing.assert_allclose(shots[-1].lights[1].to_light, (x, -z, y), atol=1e-12)
    assert {(each.lights[0].power, each.lights[1].angular_diameter_deg) for each in shots} == {(3.0, 3.0)}
    assert {each.view for each in shots} == {VIEW}
    turning = wd.light_sweep([sky, disc], VIEW, turns=0.5, count=2)
    assert turning[0].lights == (sky, disc)
    # A rotation of the lights by a quarter turn, counter-clockwise from above, moves the sun from +x to −z.
    expected = wd.Environment.clear_sky((0.0, 1.0, -1.0))
    assert turning[1].lights[0].rotation_deg == pytest.approx(expected.rotation_deg)
    np.testing.assert_allclose(turning[1].lights[1].to_light, (z, y, -x))
    # If the camera is upside down, lights rotate in the opposite direction.
    below = wd.light_sweep(sky, dataclasses.replace(VIEW, up=(0.0, -1.0, 0.0)), turns=-0.5, count=2)
    assert below[1].lights[0].rotation_deg == pytest.approx(expected.rotation_deg)


class Spotlight(wd.PointLight):
    """A kind of light that a user could define as a subclass, with an optional axis."""


def test_lights_that_cannot_be_rotated_are_refused():
    spotlight, tilted = Spotlight((0.0, 3.0, 0.0)), dataclasses.replace(VIEW, up=(0.1, 1.0, 0.0))
    sky = wd.Environment(np.ones((2, 4, 3)))
    for make, message in (
        (lambda: wd.turntable([LIGHT, spotlight], VIEW), r"lights\[1\] must be a .* got Spotlight; make"),
        (lambda: wd.turntable(sky, tilted), r"lights\[0\] is an Environment, which rotates about \+y only, got .*0.1"),
        (lambda: wd.light_sweep([LIGHT, sky], VIEW, (1.0, 0.0, 0.0)), r"lights\[1\] is an Environment"),
        (lambda: wd.light_sweep(sky, VIEW, (1.0, 0.0, 0.0)), r"lights\[0\] must be .* got Environment; give turns"),
        (lambda: wd.light_sweep(LIGHT, VIEW), "to_light or turns must be given, got neither: give one"),
        (lambda: wd.light_sweep(LIGHT, VIEW, (1, 0, 0), turns=1.0), "to_light or turns must be given, got both"),
        (lambda: wd.light_sweep(wd.PointLight(VIEW.target), VIEW, (1, 0, 0)), "position - view.target must not"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
    for lights in (spotlight, [sky, LIGHT]):
        shots = wd.turntable(lights, tilted, count=3, lights_follow=False)
        assert {each.lights for each in shots} == {shots[0].lights}


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


def test_frames_under_every_kind_of_light_equal_those_of_shade(tmp_path):
    """Frames under all kinds of light must equal those of ``shade``, also if a worker process renders them.

    The arrays of a sky must be the same objects in all shots (lights and camera of each frame).
    """
    body, heightfield = wd.meshes.tube(segments_along=12, segments_around=8), wd.gratings.blazed(2.0, 0.25)
    sky = wd.Environment.clear_sky((1.0, 1.0, 0.5), directions=16)
    # The power of the disc light makes it about as bright as the sky.
    disc = wd.DirectionalLight((0.3, 1.0, 0.4), angular_diameter_deg=3.0, power=300.0)
    lights = [sky, wd.PointLight((0.0, 3.0, 1.0), power=3e3), disc]
    view = wd.View.fit(body, width=16, height=12)
    options = {"coherence": wd.Coherence(sigma_um=0.6), "refine": False}
    renderer = wd.Renderer(body, heightfield, lights, view, tolerance=0.5, **options)
    turning, sweeping = wd.turntable(lights, view, count=2), wd.light_sweep(lights, view, turns=0.5, count=2)
    for name, shots in (("turn", turning), ("sweep", sweeping)):
        paths = wd.sequence(renderer, shots, tmp_path / name, formats=[".exr"], exposure=1e-2)
        assert not any("_parts" in vars(shot.lights[0]) for shot in shots[1:])
        for path, shot in zip(paths, shots, strict=True):
            exact = wd.shade(body, heightfield, shot.lights, shot.view, plan=renderer.plan, **options)
            exact.save(tmp_path / "exact.exr", exposure=1e-2)
            assert path.read_bytes() == (tmp_path / "exact.exr").read_bytes()
    assert turning[1].lights[0]._grid is sweeping[1].lights[0]._grid
    job = frames.FrameJob("key", (".exr",), DisplaySettings(exposure=1e-2), None, 1e-2)
    pickled = pickle.dumps((renderer, sweeping))
    assert len(pickled) < 1.5 * len(pickle.dumps((renderer, sweeping[:1])))
    assert frames.draw_in_worker(job, pickled, 1)[".exr"] == path.read_bytes()
    # A sequence with another sky image counts as another sequence, and so does one whose sky has the next smaller
    # floating-point number as its angle of rotation. Frames of different sequences must not be mixed in one folder.
    brighter = wd.Environment.clear_sky((1.0, 1.0, 0.5), directions=16, ground_albedo=0.3)
    rotated = with_settings(sky, math.nextafter(sky.rotation_deg, 0.0), 1.0, 16)
    for other in (brighter, rotated):
        with pytest.raises(ValueError, match="another sequence"):
            wd.sequence(renderer, [wd.Shot((other, *lights[1:]), view)] * 2, tmp_path / "sweep", formats=[".exr"])


def test_frames_equal_those_of_the_renderer_at_one_exposure(renderer, tmp_path):
    shots = wd.turntable(LIGHT, VIEW, count=5)
    shares = []
    paths = wd.sequence(renderer, shots, tmp_path / "turn", formats=[".png", ".exr"], progress=shares.append)
    assert [each.name for each in paths] == [f"frame_{k:04d}{end}" for end in (".png", ".exr") for k in range(5)]
    # ``progress`` is called during each frame and after each frame.
    assert shares == sorted(shares)
    assert len(shares) > 6
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert set((np.arange(6) / 5).tolist()) <= set(shares)
    exposure = json.loads((tmp_path / "turn" / "sequence.json").read_text())["exposure"]
    for index, shot in enumerate(shots):
        renderer.draw(shot.lights, shot.view)
        expected = renderer.image().save(tmp_path / "expected.png", exposure=exposure)
        np.testing.assert_array_equal(pixels(paths[index]), pixels(expected))
        linear = oiio.ImageBuf(str(paths[5 + index]))
        np.testing.assert_array_equal(linear.get_pixels(oiio.FLOAT)[..., 4:7], renderer.image().xyz)
        # The EXR files contain unscaled colours, and state the exposure of the PNG files.
        assert linear.spec().getattribute("warpdiff:preview_exposure") == pytest.approx(exposure, rel=1e-6)
    factors = []
    for shot in shots:
        renderer.draw(shot.lights, shot.view)
        factors.append(renderer.image().auto_exposure)
    assert min(factors) <= exposure <= max(factors)


def test_an_interrupted_sequence_is_resumed_without_rendering_frames_twice(renderer, tmp_path, monkeypatch):
    shots = wd.turntable(LIGHT, VIEW, count=6)
    whole = [path.read_bytes() for path in wd.sequence(renderer, shots, tmp_path / "whole")]

    def interrupt(share):
        if share >= 4.0 / 6.0:
            raise KeyboardInterrupt

    folder = tmp_path / "turn"
    with pytest.raises(KeyboardInterrupt):
        wd.sequence(renderer, shots, folder, progress=interrupt)
    assert len(list(folder.glob("frame_*"))) == 4
    # One of the four stored frames is truncated, and another one has a wrong picture size. Both must be rendered again.
    (folder / "frame_0001.png").write_bytes(whole[1][:-20])
    Image.new("RGBA", (4, 4)).save(folder / "frame_0002.png")
    drawn = []
    draw = wd.Renderer.draw

    def recorded(self, lights, view, **options):
        drawn.append(view)
        return draw(self, lights, view, **options)

    monkeypatch.setattr(wd.Renderer, "draw", recorded)
    # A copy of the renderer resumes the sequence, as if another process did.
    paths = wd.sequence(pickle.loads(pickle.dumps(renderer)), shots, folder)  # noqa: S301 (pickled in this line)
    assert drawn == [shots[index].view for index in (1, 2, 4, 5)]
    assert [path.read_bytes() for path in paths] == whole
    assert {path.name for path in folder.iterdir()} == {"sequence.json", *(path.name for path in paths)}


def test_only_the_ends_of_png_files_are_read(tmp_path, monkeypatch):
    path = tmp_path / "frame_0000.png"
    Image.new("RGBA", (VIEW.width, VIEW.height)).save(path)
    whole = path.read_bytes()
    monkeypatch.setattr(Path, "read_bytes", lambda _: pytest.fail("a whole file is read"))
    assert _is_whole(path, wd.Shot((LIGHT,), VIEW))
    assert ends_as_png(path)
    for end in (0, 5, 11, len(whole) - 12, len(whole) - 1):
        path.write_bytes(whole[:end])
        assert not ends_as_png(path)


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
            # Only the PNG animation is lossless: WebP and the colour palettes of GIF change the colours of the frames
            # slightly.
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
