"""The rendering thread of the viewer: progressive refinement, newest request first, no work for closed pages."""

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
from warpdiff.apps.viewer.controls import checked, controls
from warpdiff.apps.viewer.page_calls import NamedFiles, PageRequest
from warpdiff.apps.viewer.session import Studio, stages_to
from warpdiff.lights import sky_distribution

KNOWN = controls()
VALUES = checked(
    KNOWN, {"mesh": "disc", "surface": "blazed", "height": 240, "tolerance": 0.1, "sigma_um": 2.0, "azimuth_deg": 20.0}
)
WAIT_S = 120.0


def page_request(generation, *, moving=False, **values):
    return PageRequest(generation, VALUES | values, None, 0.25, moving, (0.5, 0.5))


@pytest.fixture(scope="module")
def studio():
    return Studio(NamedFiles(), VALUES, threads=1)


class Page:
    def __init__(self, studio):
        self.messages = queue.Queue()
        self.studio, self.session = studio, studio.session(lambda *sent: self.messages.put(sent))

    def until(self, holds):
        """Return all messages to the page up to the first for which ``holds`` is true; acknowledge each picture."""
        received = []
        while not received or not holds(received[-1][0]):
            received.append(self.messages.get(timeout=WAIT_S))
            if received[-1][0]["kind"] == "picture":
                self.studio.acknowledge(self.session)
        return received

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.studio.leave(self.session)


def is_last(message):
    return message.get("last") is True


def test_pictures_get_finer_at_rest_and_the_last_equals_that_of_the_renderer(studio):
    with Page(studio) as page:
        studio.request(page.session, page_request(1, tolerance=0.03, energy="normalised"))
        messages = page.until(lambda message: message["kind"] == "map")
        pictures = [part for part in messages if part[0]["kind"] == "picture"]
        assert [message["tolerance"] for message, _ in pictures] == [None, 0.1, 0.03]
        assert [message["type"] for message, _ in pictures] == ["image/jpeg", "image/jpeg", "image/png"]
        assert pictures[2][0]["error"]["p99"] <= pictures[1][0]["error"]["p99"] < 3 * 0.1
        assert messages[-1][0]["angles"]["light"]["theta_deg"] == pytest.approx(
            np.degrees(np.arccos(pictures[2][0]["to_light"][2])), abs=0.5
        )
        last, data = pictures[2]
        made = {}
        lines = last["python"].replace("renderer.image().save(", "shown = renderer.image().display(")
        exec(lines.replace('"picture.png", ', ""), made)  # noqa: S102 (the viewer's own lines)
        pixels = np.asarray(Image.open(io.BytesIO(data)))
        assert np.abs(pixels - np.round(255.0 * made["shown"])).max() <= 1


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


def test_environments_illuminate_a_body_and_fill_its_background(sky, monkeypatch, tmp_path):
    monkeypatch.setattr("warpdiff.apps.viewer.session._REPORT_S", 0.0)
    files = NamedFiles(environments=(sky,))
    known = controls([], [], ["a sky.exr"])
    # The page, its Python lines and its command each make a table of colours. A short coherence window makes the table
    # small, which saves several seconds.
    small = {"sigma_um": 1.5, "environment_directions": 256, "shadows": False, "light": "none", "environment": "file 0"}
    values = checked(known, dict(VALUES) | small)
    studio = Studio(files, values, threads=1)
    with Page(studio) as page:
        rotated = values | {"environment_rotation_deg": 90.0, "environment_scale": 2.0}
        studio.request(page.session, PageRequest(1, rotated, None, 0.25, False, (0.5, 0.5)))
        messages = page.until(lambda message: message["kind"] == "map")
        (first, _), (last, data) = (part for part in messages if part[0]["kind"] == "picture")
        assert (first["tolerance"], last["tolerance"]) == (None, 0.1)
        assert [message["share"] for message, _ in messages if message["kind"] == "progress"]
        assert set(messages[-1][0]["angles"]) == {"view"}
        made = {}
        lines = last["python"].replace("renderer.image().save(", "shown = renderer.image().display(")
        exec(lines.replace('"picture.png", ', ""), made)  # noqa: S102 (the viewer's own lines)
        pixels = np.asarray(Image.open(io.BytesIO(data))).astype(int)
        assert np.abs(pixels - np.round(255.0 * made["shown"])).max() <= 1
        assert made["environment"].rotation_deg == 90.0
        # The saved file must equal the picture on the page. The command line that the page shows chooses its own number
        # of wavelengths and series terms, so that its picture is only similar.
        saved = Image.open(io.BytesIO(studio.saved(page.session, "png")))
        assert np.abs(np.asarray(saved)[..., :3].astype(int) - pixels).max() <= 1
        monkeypatch.chdir(tmp_path)
        command = shlex.split(last["command"])
        assert cli.main(command[1:]) == 0
        assert np.percentile(np.abs(np.asarray(Image.open("picture.png")) - pixels), 99.0) <= 8
        # Without ``environment_behind``, the background has a single colour. The second picture reuses the arrays of
        # the sky on the device.
        uploads, upload = [], sky_distribution.upload_sky
        monkeypatch.setattr(
            sky_distribution, "upload_sky", lambda *operands: uploads.append(operands) or upload(*operands)
        )
        values, camera = rotated | {"environment_behind": False}, wd.View((0.5, 2.0, 3.0), (0.0, 0.0, 0.0))
        studio.request(page.session, PageRequest(2, values, camera, 0.25, False, (0.5, 0.5)))
        (*_, (_, plain)) = page.until(is_last)
        corner = np.asarray(Image.open(io.BytesIO(plain)))[0, 0].astype(int)
        assert np.ptp(corner) == 0
        assert not np.array_equal(corner, pixels[0, 0])
        assert not uploads


def has_time_per_preview(monkeypatch, seconds):
    """Set the time limits for previews (unrefined pictures), so that their sizes do not depend on the machine."""
    for name in ("_MOVING_S", "_LEAST_MOVING_S"):
        monkeypatch.setattr(f"warpdiff.apps.viewer.session.{name}", seconds)


def test_a_released_control_is_refined_immediately(studio, monkeypatch):
    # Previews have the full size. Only then can the first picture after a drag refine the last preview.
    has_time_per_preview(monkeypatch, WAIT_S)
    with Page(studio) as page:
        studio.request(page.session, page_request(1, moving=True))
        page.until(lambda message: message["kind"] == "picture")
        # The user drags a slider, and releases it at the value of the last preview, or slightly beyond it. In both
        # cases the first picture after the release is refined.
        for generation, azimuth_deg in ((2, 20.0), (4, 31.0)):
            studio.request(page.session, page_request(generation, azimuth_deg=azimuth_deg))
            ((first, _), *_) = (part for part in page.until(is_last) if part[0]["kind"] == "picture")
            assert (first["generation"], first["tolerance"]) == (generation, 0.1)
            studio.request(page.session, page_request(generation + 1, moving=True, azimuth_deg=30.0))
            page.until(
                lambda message, after=generation: message["kind"] == "picture" and message["generation"] == after + 1
            )
            # If a control changes without a preceding drag, the first picture is an unrefined preview.
        page.until(is_last)
        studio.request(page.session, page_request(7, azimuth_deg=20.0))
        page.until(is_last)
        studio.request(page.session, page_request(8, azimuth_deg=-20.0))
        ((first, _), *_) = (part for part in page.until(is_last) if part[0]["kind"] == "picture")
        assert first["tolerance"] is None


def test_a_click_in_a_finished_picture_reports_angles_without_rendering(studio):
    with Page(studio) as page:
        studio.request(page.session, page_request(1))
        before = page.until(lambda message: message["kind"] == "map")[-1][0]
        studio.request(page.session, dataclasses.replace(page_request(2), probe=(0.5, 0.8)))
        ((message, _),) = page.until(lambda message: message["kind"] == "map")
        assert message["generation"] == 2
        assert message["at"][1] > before["at"][1] + 0.04


def delayed(is_delayed):
    """Return a replacement of ``Renderer.draw``, whose first refined picture waits until it is cancelled.

    Also return a queue of the views whose pictures have begun.
    """
    draw, begun = wd.Renderer.draw, queue.Queue()

    def slow(self, light, view, *, progress, previews=None):
        if self._inputs.settings.refine and is_delayed(view) and not begun.qsize():
            begun.put(view)
            give_up = time.monotonic() + WAIT_S
            while time.monotonic() < give_up:
                progress(0.5)
                time.sleep(0.001)
        return draw(self, light, view, progress=progress, previews=previews)

    return slow, begun


def test_a_picture_that_is_out_of_date_is_cancelled(studio, monkeypatch):
    slow, begun = delayed(lambda view: view.width == 60)
    with Page(studio) as page:
        studio.request(page.session, page_request(1))
        page.until(is_last)
        monkeypatch.setattr(wd.Renderer, "draw", slow)
        studio.request(page.session, page_request(2, azimuth_deg=30.0))
        begun.get(timeout=WAIT_S)
        begun.put(None)
        studio.request(page.session, page_request(3, azimuth_deg=40.0))
        messages = [message for message, _ in page.until(lambda part: is_last(part) and part["generation"] == 3)]
        assert [part["tolerance"] for part in messages if part["kind"] == "picture" and part["generation"] == 2] == [
            None
        ]


def test_previews_are_rendered_no_faster_than_shown_and_refined_after_the_movement(studio, monkeypatch):
    with Page(studio) as page:
        studio.request(page.session, page_request(1))
        page.until(is_last)
        # The viewer behaves as on a slow machine.
        has_time_per_preview(monkeypatch, 1e-6)
        give_up = time.monotonic() + WAIT_S
        generation, pictures = 2, 0
        while generation < 10 or pictures < 2:
            assert time.monotonic() < give_up
            studio.request(page.session, page_request(generation, moving=True, azimuth_deg=3.0 * generation))
            generation += 1
            time.sleep(0.05)
            pictures = sum(message["kind"] == "picture" for message, _ in page.messages.queue)
        time.sleep(0.5)
        moving = [message for message, _ in page.messages.queue if message["kind"] == "picture"]
        assert len(moving) == 2
        assert {message["tolerance"] for message in moving} == {None}
        assert moving[0]["height"] < 240
        # The first picture after the drag has full size and is unrefined.
        studio.request(page.session, page_request(generation, azimuth_deg=27.0))
        received = page.until(lambda message: is_last(message) and message["generation"] == generation)
        first, *_ = (part for part, _ in received if part["kind"] == "picture" and part["generation"] == generation)
        assert (first["tolerance"], first["height"]) == (None, 240)


def test_previews_have_as_many_pixels_as_the_frame_rate_allows():
    studio = object.__new__(Studio)
    full = wd.View((0, 1, 3), (0, 0, 0), width=640, height=480)
    # Each case has two times in seconds, ``fixed`` and ``of_all``, and the expected width of previews in pixels. A
    # picture of n pixels requires ``fixed`` plus ``of_all`` times n/(640 × 480). Widths below 320 are expected only if
    # a machine draws fewer than 12 pictures of 320 × 240 pixels per second.
    for fixed, of_all, expected in ((0.01, 0.03, 640), (0.02, 0.06, 480), (0.04, 0.14, 320), (0.04, 0.3, 240)):
        studio._times, studio._last_pixels, sizes = deque(maxlen=5), math.inf, []
        for index in range(16):
            view = studio._smaller(full)
            sizes.append(view.width)
            # Every eighth picture takes 0.2 s longer, which must not change the size of the previews.
            late = 0.2 * (index % 8 == 7)
            pixels = view.width * view.height
            studio._times.append((fixed + of_all * pixels / (640 * 480) + late) / math.sqrt(pixels))
        assert set(sizes[6:]) == {expected}, sizes


def test_an_error_is_reported_and_later_requests_are_served(studio):
    with Page(studio) as page, Page(studio) as other:
        studio.request(page.session, page_request(1, surface="bumps", bumps_width_um=2.0))
        studio.request(other.session, page_request(1))
        message = page.until(lambda message: message["kind"] == "error")[-1][0]
        assert message["text"] == "spacing along x must be at least width along x = 2, got 1"
        assert other.until(is_last)
        studio.request(page.session, page_request(2))
        assert page.until(is_last)
        assert other.messages.empty() or all(part["kind"] == "map" for part, _ in other.messages.queue)


def test_a_page_s_first_picture_does_not_wait_for_the_finest_of_another(studio, monkeypatch):
    slow, begun = delayed(lambda _: True)
    with Page(studio) as page, Page(studio) as other:
        monkeypatch.setattr(wd.Renderer, "draw", slow)
        studio.request(page.session, page_request(1))
        page.until(lambda message: message["kind"] == "picture")
        begun.get(timeout=WAIT_S)
        begun.put(None)
        studio.request(other.session, page_request(1, azimuth_deg=50.0))
        first = other.until(lambda message: message["kind"] == "picture")[-1][0]
        assert first["tolerance"] is None
        assert page.until(is_last)
        assert other.until(is_last)


def test_stages_end_with_the_tolerance():
    for tolerance in (0.5, 0.1, 0.03, 0.01):
        first, *finer = stages_to(tolerance)
        assert first.tolerance is None
        assert [stage.tolerance for stage in finer] == sorted({stage.tolerance for stage in finer}, reverse=True)
        assert finer[-1] == (tolerance, True)
        assert not any(stage.last for stage in (first, *finer[:-1]))
