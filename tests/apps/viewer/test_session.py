"""The thread that draws for the viewer's pages: finer and finer, the newest first, and never for nobody."""

from __future__ import annotations

import dataclasses
import io
import math
import queue
import shlex
import time
from collections import deque

import numpy as np
import pytest
from PIL import Image

import warpdiff as wd
from warpdiff.apps import cli
from warpdiff.apps.viewer import page_bodies
from warpdiff.apps.viewer.controls import checked, controls
from warpdiff.apps.viewer.page_calls import Call, NamedFiles, Scene
from warpdiff.apps.viewer.session import Studio, Wanted, stages_to
from warpdiff.device.devices import resolve_device
from warpdiff.scene.mesh_import import prepare_surface

KNOWN = controls()
VALUES = checked(
    KNOWN, {"mesh": "disc", "surface": "blazed", "height": 240, "tolerance": 0.1, "sigma_um": 4.0, "azimuth_deg": 20.0}
)
WAIT_S = 120.0


def wanted(generation, *, moving=False, **values):
    return Wanted(generation, VALUES | values, None, 0.25, moving, (0.5, 0.5))


@pytest.fixture(scope="module")
def studio():
    return Studio(NamedFiles(), VALUES, threads=1)


class Page:
    def __init__(self, studio):
        self.got = queue.Queue()
        self.studio, self.session = studio, studio.session(lambda *told: self.got.put(told))

    def until(self, holds):
        """All that is told until something holds; each picture is shown at once."""
        found = []
        while not found or not holds(found[-1][0]):
            found.append(self.got.get(timeout=WAIT_S))
            if found[-1][0]["kind"] == "picture":
                self.studio.acknowledge(self.session)
        return found

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.studio.leave(self.session)


def is_last(told):
    return told.get("last") is True


def test_pictures_get_finer_at_rest_and_are_the_renderer_s(studio):
    with Page(studio) as page:
        studio.want(page.session, wanted(1, tolerance=0.03, energy="normalised"))
        told = page.until(lambda each: each["kind"] == "map")
        pictures = [each for each in told if each[0]["kind"] == "picture"]
        assert [each["tolerance"] for each, _ in pictures] == [None, 0.1, 0.03]
        assert [each["type"] for each, _ in pictures] == ["image/jpeg", "image/jpeg", "image/png"]
        assert pictures[2][0]["error"]["p99"] <= pictures[1][0]["error"]["p99"] < 3 * 0.1
        assert told[-1][0]["angles"]["light"]["theta_deg"] == pytest.approx(
            np.degrees(np.arccos(pictures[2][0]["to_light"][2])), abs=0.5
        )
        last, data = pictures[2]
        made = {}
        lines = last["python"].replace("renderer.image().save(", "shown = renderer.image().display(")
        exec(lines.replace('"picture.png", ', ""), made)  # noqa: S102 (it is ours)
        found = np.asarray(Image.open(io.BytesIO(data)))
        assert np.abs(found - np.round(255.0 * made["shown"])).max() <= 1


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    radiance = np.full((8, 16, 3), 0.2, dtype=np.float32)
    radiance[1, 3] = 20.0, 10.0, 5.0
    path = tmp_path_factory.mktemp("sky") / "a sky.exr"
    oiio = pytest.importorskip("OpenImageIO")
    out = oiio.ImageOutput.create(str(path))
    out.open(str(path), oiio.ImageSpec(16, 8, 3, "float"))
    out.write_image(radiance)
    out.close()
    return path


def test_environments_light_a_body_and_stand_behind_it(sky, monkeypatch, tmp_path):
    monkeypatch.setattr("warpdiff.apps.viewer.session._TOLD_S", 0.0)
    files = NamedFiles(environments=(sky,))
    known = controls([], [], ["a sky.exr"])
    values = checked(
        known,
        dict(VALUES) | {"environment_directions": 256, "shadows": False, "light": "none"},
    )
    studio = Studio(files, values, threads=1)
    with Page(studio) as page:
        rotated = values | {"environment_rotation_deg": 90.0, "environment_scale": 2.0}
        studio.want(page.session, Wanted(1, rotated, None, 0.25, False, (0.5, 0.5)))
        told = page.until(lambda each: each["kind"] == "map")
        (first, _), (last, data) = (each for each in told if each[0]["kind"] == "picture")
        assert (first["tolerance"], last["tolerance"]) == (None, 0.1)
        assert [each["share"] for each, _ in told if each["kind"] == "progress"]
        assert set(told[-1][0]["angles"]) == {"view"}
        made = {}
        lines = last["python"].replace("renderer.image().save(", "shown = renderer.image().display(")
        exec(lines.replace('"picture.png", ', ""), made)  # noqa: S102 (it is ours)
        found = np.asarray(Image.open(io.BytesIO(data))).astype(int)
        assert np.abs(found - np.round(255.0 * made["shown"])).max() <= 1
        assert made["environment"].rotation_deg == 90.0
        # The file is the same, and so is the command's but for its plan.
        saved = Image.open(io.BytesIO(studio.saved(page.session, "png")))
        assert np.abs(np.asarray(saved)[..., :3].astype(int) - found).max() <= 1
        monkeypatch.chdir(tmp_path)
        command = shlex.split(last["command"])
        assert cli.main(command[1:]) == 0
        assert np.percentile(np.abs(np.asarray(Image.open("picture.png")) - found), 99.0) <= 8
        # It is seen where nothing is before it.
        studio.want(page.session, Wanted(2, rotated | {"environment_behind": False}, None, 0.25, False, (0.5, 0.5)))
        (*_, (_, plain)) = page.until(is_last)
        corner = np.asarray(Image.open(io.BytesIO(plain)))[0, 0].astype(int)
        assert np.ptp(corner) == 0
        assert not np.array_equal(corner, found[0, 0])


def test_a_scene_takes_a_light_or_an_environment_or_both(sky):
    known, files = controls([], [], ["a sky.exr"]), NamedFiles(environments=(sky,))
    scene = Scene.of(checked(known, {"light": "near"}), files).placed((0.0, 0.0, 0.0), 1.0)
    light = scene.light.make()
    assert light.power == pytest.approx(1e4 * np.dot(light.position, light.position))
    words = scene.command(wd.View((0, 1, 3), (0, 0, 0)), 0.1, {"background": (0, 0, 0)}, files).split()
    assert {"--point-light", "--environment", "--environment-behind"} < set(words)
    assert "--background" not in words
    assert scene.at(None).shading["shadows"] is False
    with pytest.raises(ValueError, match="there is no light"):
        Scene.of(VALUES | {"light": "none"}, NamedFiles())


def test_what_is_let_go_is_refined_at_once(studio):
    with Page(studio) as page:
        studio.want(page.session, wanted(1, moving=True))
        page.until(lambda each: each["kind"] == "picture")
        # Where it was seen, or a little beyond.
        for generation, azimuth_deg in ((2, 20.0), (4, 31.0)):
            studio.want(page.session, wanted(generation, azimuth_deg=azimuth_deg))
            ((first, _), *_) = (each for each in page.until(is_last) if each[0]["kind"] == "picture")
            assert (first["generation"], first["tolerance"]) == (generation, 0.1)
            studio.want(page.session, wanted(generation + 1, moving=True, azimuth_deg=30.0))
            page.until(lambda each, after=generation: each["kind"] == "picture" and each["generation"] == after + 1)
        # What is set otherwise is seen unrefined before.
        page.until(is_last)
        studio.want(page.session, wanted(7, azimuth_deg=20.0))
        page.until(is_last)
        studio.want(page.session, wanted(8, azimuth_deg=-20.0))
        ((first, _), *_) = (each for each in page.until(is_last) if each[0]["kind"] == "picture")
        assert first["tolerance"] is None


def test_another_place_in_a_picture_that_stands_is_told_without_drawing_it_again(studio):
    with Page(studio) as page:
        studio.want(page.session, wanted(1))
        before = page.until(lambda each: each["kind"] == "map")[-1][0]
        studio.want(page.session, dataclasses.replace(wanted(2), probe=(0.5, 0.8)))
        ((told, _),) = page.until(lambda each: each["kind"] == "map")
        assert told["generation"] == 2
        assert told["at"][1] > before["at"][1] + 0.04


def held_up(held):
    """A way to draw that is held up in the first refined picture until it is abandoned, and where it says so."""
    draw, begun = wd.Renderer.draw, queue.Queue()

    def slow(self, light, view, *, progress, previews=None):
        if self._wanted.refine and held(view) and not begun.qsize():
            begun.put(view)
            give_up = time.monotonic() + WAIT_S
            while time.monotonic() < give_up:
                progress(0.5)
                time.sleep(0.001)
        return draw(self, light, view, progress=progress, previews=previews)

    return slow, begun


def test_a_picture_that_is_out_of_date_is_abandoned(studio, monkeypatch):
    slow, begun = held_up(lambda view: view.width == 60)
    with Page(studio) as page:
        studio.want(page.session, wanted(1))
        page.until(is_last)
        monkeypatch.setattr(wd.Renderer, "draw", slow)
        studio.want(page.session, wanted(2, azimuth_deg=30.0))
        begun.get(timeout=WAIT_S)
        begun.put(None)
        studio.want(page.session, wanted(3, azimuth_deg=40.0))
        told = [each for each, _ in page.until(lambda each: is_last(each) and each["generation"] == 3)]
        assert [each["tolerance"] for each in told if each["kind"] == "picture" and each["generation"] == 2] == [None]


def test_what_moves_is_drawn_no_faster_than_it_is_shown_and_refined_once_it_rests(studio, monkeypatch):
    with Page(studio) as page:
        studio.want(page.session, wanted(1))
        page.until(is_last)
        # As on a slower machine.
        for name in ("_MOVING_S", "_LEAST_MOVING_S"):
            monkeypatch.setattr(f"warpdiff.apps.viewer.session.{name}", 1e-6)
        for generation in range(2, 10):
            studio.want(page.session, wanted(generation, moving=True, azimuth_deg=3.0 * generation))
            time.sleep(0.05)
        time.sleep(0.5)
        moving = [told for told, _ in page.got.queue if told["kind"] == "picture"]
        assert len(moving) == 2
        assert {each["tolerance"] for each in moving} == {None}
        assert moving[0]["height"] < 240
        page.until(lambda told: is_last(told) and told["generation"] == 9)


def test_what_moves_has_as_many_pixels_as_come_in_time():
    studio = object.__new__(Studio)
    full = wd.View((0, 1, 3), (0, 0, 0), width=640, height=480)
    # Seconds of a picture, a part of them for whatever size; below 320 × 240 only where twelve a second are not kept.
    for fixed, of_all, expected in ((0.01, 0.03, 640), (0.02, 0.06, 480), (0.04, 0.14, 320), (0.04, 0.3, 240)):
        studio._took, studio._last_pixels, sizes = deque(maxlen=5), math.inf, []
        for index in range(16):
            view = studio._smaller(full)
            sizes.append(view.width)
            # Every eighth is late, which changes nothing.
            late = 0.2 * (index % 8 == 7)
            pixels = view.width * view.height
            studio._took.append((fixed + of_all * pixels / (640 * 480) + late) / math.sqrt(pixels))
        assert set(sizes[6:]) == {expected}, sizes


def test_an_error_is_told_and_ends_nothing(studio):
    with Page(studio) as page, Page(studio) as other:
        studio.want(page.session, wanted(1, surface="bumps", bumps_width_um=2.0))
        studio.want(other.session, wanted(1))
        told = page.until(lambda each: each["kind"] == "error")[-1][0]
        assert "spacing_um" in told["text"]
        assert other.until(is_last)
        studio.want(page.session, wanted(2))
        assert page.until(is_last)
        assert other.got.empty() or all(each["kind"] == "map" for each, _ in other.got.queue)


def test_a_page_s_first_picture_does_not_wait_for_the_finest_of_another(studio, monkeypatch):
    slow, begun = held_up(lambda _: True)
    with Page(studio) as page, Page(studio) as other:
        monkeypatch.setattr(wd.Renderer, "draw", slow)
        studio.want(page.session, wanted(1))
        page.until(lambda each: each["kind"] == "picture")
        begun.get(timeout=WAIT_S)
        begun.put(None)
        studio.want(other.session, wanted(1, azimuth_deg=50.0))
        first = other.until(lambda each: each["kind"] == "picture")[-1][0]
        assert first["tolerance"] is None
        assert page.until(is_last)
        assert other.until(is_last)


def test_stages_end_with_the_tolerance():
    for tolerance in (0.5, 0.1, 0.03, 0.01):
        first, *finer = stages_to(tolerance)
        assert first.tolerance is None
        assert [each.tolerance for each in finer] == sorted({each.tolerance for each in finer}, reverse=True)
        assert finer[-1] == (tolerance, True)
        assert not any(each.last for each in (first, *finer[:-1]))


def test_sample_bodies_are_found_again_on_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("warpdiff.core.disk_cache._LEAST_SECONDS", 0.0)
    call = Call.of("meshes.tube", segments_along=12, segments_around=6)
    first = page_bodies.surface_of(call, None)
    assert len(list(tmp_path.iterdir())) == 1
    make = Call.make
    # Studios of other tests may still draw.
    monkeypatch.setattr(Call, "make", lambda each: pytest.fail("it is kept") if each is call else make(each))
    again = page_bodies.surface_of(call, None)
    for name, value in vars(first).items():
        assert type(getattr(again, name)) is type(value), name
        np.testing.assert_array_equal(getattr(again, name), value)
    assert prepare_surface(again) is again


def test_a_body_is_framed_whole():
    for name in ("disc", "tube"):
        surface = prepare_surface(getattr(wd.meshes, name)())
        for width, height in ((80, 60), (40, 60)):
            view = page_bodies.framed(surface, width, height)
            renderer = wd.Renderer(
                surface, wd.gratings.blazed(2.0, 0.1), wd.DirectionalLight((0, 1, 1)), view, tolerance=0.5,
                coherence=wd.Coherence(sigma_um=2.0), refine=False,
            )  # fmt: skip
            mask = renderer.image().mask
            rows, columns = np.nonzero(mask)
            assert not np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).any()
            assert max(np.ptp(rows) / height, np.ptp(columns) / width) > 0.75


def test_scenes_are_written_as_they_are_made():
    scene = Scene.of(VALUES | {"coherence": "source", "masking": False, "material": "mirror"}, NamedFiles())
    view = wd.View((0, 1, 3), (0, 0, 0), width=8, height=6)
    made = {}
    lines = scene.python(view, 0.5, {}).partition("renderer.image()")[0]
    # What is given, without drawing.
    exec(lines.replace("wd.Renderer(", "(lambda *operands, **options: (operands, options))("), made)  # noqa: S102
    operands, options = made["renderer"]
    assert operands[2:] == (scene.light.make(), view)
    assert options == {
        "tolerance": 0.5,
        "coherence": wd.Coherence("source", angular_diameter_deg=0.53),
        "ior": np.inf,
        "masking": False,
        "pigment": 0.05,
    }
    words = scene.command(view, 0.5, {"display": "clip"}, NamedFiles()).split()
    assert words[:4] == ["warpdiff", "render", "disc", "blazed:period_um=2.0,depth_um=0.25"]
    assert words[words.index("--ior") + 1] == "inf"
    assert {"--no-masking", "--angular-diameter-deg", "--display"} < set(words)
    # Normalised energy takes the place of masking, whatever that was before.
    scene = Scene.of(VALUES | {"energy": "normalised", "masking": False}, NamedFiles())
    assert dict(scene.options).keys() == {"coherence", "energy", "pigment"}
    words = scene.command(view, 0.5, {}, NamedFiles()).split()
    assert words[words.index("--energy") + 1] == "normalised"


def test_lights_of_a_scene_are_far_or_near_and_have_a_size():
    view = wd.View((0, 1, 3), (0, 0, 0), width=8, height=6)
    wide = Scene.of(VALUES | {"light_diameter_deg": 2.0}, NamedFiles())
    assert wide.placed((1.0, 2.0, 3.0), 2.0) is wide
    assert wide.light.make().angular_diameter_deg == 2.0
    words = wide.command(view, 0.5, {}, NamedFiles()).split()
    assert words[words.index("--light-diameter-deg") + 1] == "2.0"
    near = Scene.of(VALUES | {"light": "near", "distance": 3.0, "illuminant": "A"}, NamedFiles())
    light = near.placed((1.0, 2.0, 3.0), 2.0).light.make()
    away = np.subtract(light.position, (1.0, 2.0, 3.0))
    np.testing.assert_allclose(away, 6.0 * np.array(wide.light.make().to_light), atol=1e-5)
    assert (light.power, light.illuminant) == (36.0, "A")
    words = near.placed((1.0, 2.0, 3.0), 2.0).command(view, 0.5, {}, NamedFiles()).split()
    assert words[words.index("--point-light") + 1 :][:4] == [*map(str, light.position), "36.0"]


def test_a_light_at_the_eye_is_seen_where_it_is():
    surface = prepare_surface(wd.meshes.tube())
    view = page_bodies.framed(surface, 40, 30)
    options = {"smooth": True, "device": resolve_device(None), "threads": 1}
    for column, row in ((14, 15), (25, 16)):
        near = page_bodies.local_directions(surface, view, wd.PointLight(view.eye), column, row, **options)
        np.testing.assert_allclose(near.to_light, near.to_view, atol=1e-5)
        towards = np.subtract(view.eye, surface.centre)
        far = page_bodies.local_directions(surface, view, wd.DirectionalLight(towards), column, row, **options)
        assert np.linalg.norm(np.subtract(far.to_light, near.to_light)) > 1e-3


def test_metals_of_a_scene_are_written():
    scene = Scene.of(VALUES | {"material": "Au", "ior": 2.0}, NamedFiles())
    view = wd.View((0, 1, 3), (0, 0, 0), width=8, height=6)
    assert scene.shading["material"] == wd.Material.metal("Au")
    assert "material=wd.Material.metal('Au')" in scene.python(view, 0.5, {})
    words = scene.command(view, 0.5, {}, NamedFiles()).split()
    assert words[words.index("--material") + 1] == "Au"
    assert "--ior" not in words
