"""Progressive rendering for the viewer's pages: previews, then pictures of decreasing tolerance.

A page shows previews during a movement: while the user drags with a mouse button or a finger down, which moves the
camera or changes the value of a control.

One thread draws for all pages in turn. Pages therefore share tables, and memory does not grow with their number. Each
request of a page has a generation, a number that the page increases with every change. Only the newest request of a
page is drawn. If a page sends a newer request while its full-size picture is rendered, the picture is cancelled after
the running kernel.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import statistics
import threading
import time
import traceback
import warnings
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff.apps.viewer import encoding, page_bodies
from warpdiff.apps.viewer.controls import arguments, word
from warpdiff.apps.viewer.page_calls import Scene
from warpdiff.apps.viewer.scene_objects import SceneObjects
from warpdiff.core import validation
from warpdiff.core.options import describe
from warpdiff.core.wording import ArgumentValueError, spelled
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.image.display_transform import MEAN_SHOWN
from warpdiff.request.settings import EvaluationSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from warpdiff.apps.viewer.page_calls import NamedFiles, PageRequest

# Tolerances of the pictures that are drawn between a preview and the picture with the requested tolerance.
TOLERANCES = (0.1, 0.03)
# Time for which a page must be idle while a mouse button is still down, before its picture is refined [s]. The time is
# limited because users notice a delay of twice this time.
_REST_S = 0.15
# Largest number of pictures that were sent to a page and not shown by it yet. The number is limited because twice the
# number doubles the delay on a slow connection.
_MOST_IN_FLIGHT = 2
# Time limits for rendering a preview while the user drags [s]. A preview that is expected to exceed `_MOVING_S` gets
# fewer pixels, but not fewer than `_LEAST_PIXELS`. If a preview of this size is expected to exceed `_LEAST_MOVING_S`,
# it gets still fewer pixels. The limits correspond to about 15 and 12 pictures per second.
_MOVING_S, _LEAST_MOVING_S = 0.065, 0.08
# Factors by which the width and height of a preview may be reduced while the user drags the camera or a control.
_SCALES = (1.0, 0.75, 0.5, 0.375)
# Number of pixels to which a preview may be reduced to meet the time limit `_MOVING_S` while the user drags.
_LEAST_PIXELS = 320 * 240
# The median time of the last `_TIMED` previews (unrefined pictures) predicts the time of the next preview. The size of
# previews increases only if the predicted time is less than `_HEADROOM` times the time limit. Without this margin, the
# size would change back and forth.
_TIMED, _HEADROOM = 5, 0.8
# Width and height of the reflectance map [pixels]. The size is limited because twice the width and height require four
# times the time.
MAP_SIZE = 192
# Shortest time between two progress messages to a page [s].
_REPORT_S = 0.5
# Smallest coverage at which a pixel counts as completely covered by the mesh. It is below 1 because of rounding errors.
_FULL_COVERAGE = 0.999


class _CancelledError(Exception):
    """Exception by which a progress callable cancels a picture that its page no longer needs."""


class Stage(NamedTuple):
    """One of the successive pictures that answer a page's request, each more accurate than the one before.

    Attributes:
        tolerance: Tolerance to which the picture is refined; None is a preview with one sample per pixel.
        last: Whether the picture has the requested tolerance.
    """

    tolerance: float | None
    last: bool = False


def stages_to(tolerance: float) -> list[Stage]:
    """Return the stages of a request for a picture: a preview, intermediate tolerances, and the requested tolerance."""
    return [Stage(None), *(Stage(larger) for larger in TOLERANCES if larger > tolerance), Stage(tolerance, last=True)]


@dataclass(eq=False)
class Session:
    """State of one page.

    Several threads use ``request``, ``in_flight`` and ``open``. Only the drawing thread uses the other attributes.

    Attributes:
        send: Function that sends a message to the page. Its arguments are a description and the bytes of a file or
            None. The drawing thread calls ``send``.
        request: Newest request of the page.
        in_flight: Number of sent pictures that the page has not shown yet.
        open: Whether the page is connected.
        generation: Generation (number) of the request whose stages are drawn.
        stage: Index of the next stage to draw; see :class:`Stage`.
        drawn_at: Time at which the last picture was sent, by ``time.monotonic`` [s].
        drawn_request: Request that the last picture answered.
        exposure: Automatic exposure factor of the last picture that was not a preview during a drag.
        picture: The last picture, with the options of its display transform.
    """

    send: Callable[[dict[str, Any], bytes | None], None]
    request: PageRequest | None = None
    in_flight: int = 0
    open: bool = True
    generation: int = -1
    stage: int = 0
    drawn_at: float = 0.0
    drawn_request: PageRequest | None = None
    exposure: float | None = None
    picture: tuple[wd.Image, dict[str, Any]] | None = None


class Studio:
    """Renderer for all open pages of the viewer, with its own thread."""

    def __init__(
        self, files: NamedFiles, values: Mapping[str, Any], *, device: Any = None, threads: int | None = None
    ) -> None:
        """Start the thread, which first renders a picture with default values to fill the caches.

        Args:
            files: Files that the page offers.
            values: Initial values of the page's controls.
            device: Warp device, as in :func:`warpdiff.shade`.
            threads: Number of CPU threads, as in :func:`warpdiff.shade`.
        """
        self.files, self._likely_values = files, values
        self._objects = SceneObjects(device=resolve_device(device), threads=resolve_threads(threads))
        self._sessions: list[Session] = []
        self._changed = threading.Condition()
        # Rendering times of the last previews, each divided by the square root of the preview's number of pixels [s].
        # Part of the time does not depend on the number of pixels, so that the square root predicts better than the
        # number itself.
        self._times: deque[float] = deque(maxlen=_TIMED)
        # Number of pixels of the last preview (unrefined picture).
        self._last_pixels = math.inf
        self._thread = threading.Thread(target=self._run, name="warpdiff-view", daemon=True)
        self._thread.start()

    def session(self, send: Callable[[dict[str, Any], bytes | None], None]) -> Session:
        """Add a page, and return its session. The drawing thread calls ``send`` to send messages to the page."""
        result = Session(send)
        with self._changed:
            self._sessions.append(result)
        return result

    def leave(self, session: Session) -> None:
        """Remove a page that has disconnected."""
        with self._changed:
            session.open = False
            if session in self._sessions:
                self._sessions.remove(session)
            self._changed.notify()

    def request(self, session: Session, request: PageRequest) -> None:
        """Replace a page's request for a picture by a newer request."""
        with self._changed:
            session.request = request
            self._changed.notify()

    @staticmethod
    def saved(session: Session, suffix: str) -> bytes:
        """Return the bytes of a file with the last picture of a page. ``suffix`` is ``png`` or ``exr``."""
        if session.picture is None:
            raise ArgumentValueError("there is no picture to save yet")
        image, display = session.picture
        return encoding.saved(image, suffix, display)

    def acknowledge(self, session: Session) -> None:
        """Record that a page has shown one more of the pictures that were sent to it."""
        with self._changed:
            session.in_flight = max(session.in_flight - 1, 0)
            self._changed.notify()

    def _prepare(self) -> None:
        """Render a small picture, so that the caches contain what the first picture of a page needs."""
        scene = Scene.of(self._likely_values, self.files)
        view = page_bodies.framed(self._objects.surface(scene), 16, 12)
        image = self._objects.renderer(scene, view, refine=False, report=lambda: None).image()
        encoding.encoded(encoding.displayed(image, exact=False, background=(0, 0, 0)), lossless=False)

    def _run(self) -> None:
        # Errors are ignored here. They occur again with the first request of a page, and are then sent to it.
        with warnings.catch_warnings(), contextlib.suppress(Exception):
            warnings.simplefilter("ignore")
            self._prepare()
        while True:
            session, request, index = self._next()
            label = word(self.files.controls, request.values)
            try:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("ignore")
                    warnings.simplefilter("always", wd.WarpdiffWarning)
                    self._serve(session, request, index)
                if caught:
                    texts = dict.fromkeys(spelled(warning.message, label) for warning in caught)
                    session.send(_message("warning", request, text="\n".join(texts)), None)
            except _CancelledError:
                continue
            except Exception as error:
                # An error is sent only to the page whose request caused it. The thread continues with other requests.
                expected = isinstance(error, (ValueError, TypeError, OSError, MemoryError))
                text = spelled(error, label) if expected else f"{type(error).__name__}: {error}"
                if not expected:
                    traceback.print_exc()
                session.send(_message("error", request, text=text), None)
                session.stage = len(stages_to(request.values["tolerance"])) + 1

    def _next(self) -> tuple[Session, PageRequest, int]:
        """Wait for the next picture to draw, and return its page, request and stage.

        A stage is one of the successive pictures that answer a request of a page.

        Previews precede refined pictures, and pages take turns.
        """
        with self._changed:
            while True:
                waits: list[float] = []
                ready: list[tuple[bool, Session, PageRequest]] = []
                for session in self._sessions:
                    request = session.request
                    if request is None or session.in_flight >= _MOST_IN_FLIGHT:
                        continue
                    pictures = len(stages_to(request.values["tolerance"]))
                    if session.generation != request.generation:
                        session.generation = request.generation
                        # The page shows the directions to light and viewer at a point of the body, the probe. If only
                        # the probe has moved, the picture remains valid: it is not drawn again, and its refinement
                        # continues.
                        is_drawn = not request.moving and _has_same_picture(session.drawn_request, request)
                        session.stage = min(session.stage, pictures) if is_drawn else 0
                    if session.stage == 0 and _is_released(session, request) and session.picture:
                        # After a drag, the last preview is refined at once if it has the full size.
                        # Otherwise, a preview of the full size comes first.
                        session.stage = int(len(session.picture[0].mask) == request.values["height"])
                    if session.stage > pictures:
                        continue
                    wait = session.drawn_at + _REST_S - time.monotonic() if request.moving and session.stage else 0.0
                    if wait > 0.0:
                        waits.append(wait)
                    else:
                        ready.append((session.stage > 0, session, request))
                if ready:
                    _, session, request = min(ready, key=lambda candidate: candidate[0])
                    self._sessions.remove(session)
                    self._sessions.append(session)
                    return session, request, session.stage
                self._changed.wait(min(waits, default=None))

    def _is_current(self, session: Session, request: PageRequest, index: int) -> bool:
        """Whether to finish a picture: its request is the page's newest, and no other page waits for a preview."""
        newest = session.request
        if not session.open or newest is None:
            return False
        if index == 0 and request.moving:
            # A preview during a drag is finished even if a newer request has arrived. If each new request cancelled the
            # preview, the page would show no picture until the drag ends.
            return not _is_released(session, newest)
        others = [
            other for other in tuple(self._sessions) if other is not session and other.in_flight < _MOST_IN_FLIGHT
        ]
        return newest.generation == request.generation and not any(
            other.request is not None and other.generation != other.request.generation for other in others
        )

    def _progress(self, session: Session, request: PageRequest, index: int) -> Callable[[float], None]:
        """Return the progress callable of a picture, which sends progress to the page and cancels outdated pictures."""
        reported_at = time.monotonic()

        def progress(share: float) -> None:
            nonlocal reported_at
            if not self._is_current(session, request, index):
                raise _CancelledError
            if time.monotonic() - reported_at > _REPORT_S:
                reported_at = time.monotonic()
                session.send(_message("progress", request, share=share), None)

        return progress

    def _serve(self, session: Session, request: PageRequest, index: int) -> None:
        """Draw and send the pictures (stages) of a request, starting at the stage with the index ``index``.

        If all pictures were sent, send the directions to light and viewer at the probe, a point that the user selects,
        and the reflectance map instead.
        """
        progress = self._progress(session, request, index)
        scene = Scene.of(request.values, self.files)
        stages = stages_to(scene.tolerance)
        body = self._objects.surface(scene)
        scene = scene.placed(body.centre.tolist(), body.radius)
        full = page_bodies.resting_view(request, body)
        if index == len(stages):
            self._send_angles_and_map(session, request, scene, full, progress)
            session.stage = index + 1
            return
        begin = time.perf_counter()
        view = self._smaller(full) if index == 0 and request.moving else full
        previewed = scene.at(stages[index].tolerance)

        def report() -> None:
            session.send(_message("preparing", request, tolerance=previewed.tolerance), None)

        renderer = self._objects.renderer(previewed, view, refine=index > 0, report=report)
        lights = self._objects.lights(previewed)
        built = time.perf_counter()
        description = _message(
            "picture", request, width=view.width, height=view.height, to_light=scene.to_light,
            camera={"eye": view.eye, "target": view.target, "up": view.up, "fov_y_deg": view.fov_y_deg},
            body={"centre": body.centre.tolist(), "radius": body.radius},
        )  # fmt: skip

        def send() -> None:
            """Send the current picture of the renderer to the page, as the picture of the next stage (tolerance)."""
            stage = stages[session.stage]
            image = renderer.image()
            ready = time.perf_counter()
            saving = self._display_options(session, request, image, moving=request.moving and stage.tolerance is None)
            behind = {"background": lights[-1].background(view) / np.float32(scene.normal)} if scene.is_behind else {}
            display = saving | behind
            pixels = encoding.displayed(image, exact=stage.last, **display)
            displayed = time.perf_counter()
            data = encoding.encoded(pixels, lossless=stage.last)
            errors = image.error[image.illuminated]
            seconds = np.diff([begin, built, ready, displayed, time.perf_counter()]).tolist()
            result: dict[str, Any] = {
                "stage": session.stage, "tolerance": stage.tolerance, "last": stage.last,
                "seconds": dict(zip(("prepare", "draw", "display", "encode"), seconds, strict=True)),
                "type": "image/png" if stage.last else "image/jpeg",
                "error": dict(zip(("median", "p99"), np.percentile(errors, (50.0, 99.0)).tolist(), strict=True))
                if errors.size else None,
            }  # fmt: skip
            if stage.tolerance is not None:
                result["plan"] = f"{image.report}\n\n{image.plan}"
                result["python"] = scene.python(view, scene.tolerance, saving)
                result["command"] = scene.command(view, scene.tolerance, saving)
            session.drawn_request, session.picture = request, (image, display)
            with self._changed:
                session.in_flight += 1
                session.drawn_at = time.monotonic()
            session.stage += 1
            session.send(description | result, data)

        # Without an environment light, one call of the renderer draws all remaining stages (pictures of decreasing
        # tolerance), each of which refines the previous one. With an environment, each stage is a call of its own,
        # because stages sample different numbers of directions.
        last = len(stages) - 1 if index and scene.sky is None else index
        previews = {stage.tolerance: send for stage in stages[index:last] if stage.tolerance is not None}
        renderer.draw(lights, view, progress=progress, previews=previews)
        # The renderer skips intermediate stages (pictures of larger tolerances) if no pixel needs refinement. The last
        # stage is sent in any case.
        session.stage = last
        send()
        if not index:
            self._times.append((time.perf_counter() - built) / math.sqrt(view.width * view.height))

    def _smaller(self, view: wd.View) -> wd.View:
        """Return the camera of a preview: ``view`` with as many pixels as the time limits during a drag allow."""
        pixels = view.width * view.height
        least = min(math.sqrt(_LEAST_PIXELS / pixels), 1.0)
        expected = statistics.median(self._times) if self._times else 0.0

        def is_in_time(scale: float) -> bool:
            most = _LEAST_MOVING_S
            if scale > least:
                most = _MOVING_S * (_HEADROOM if scale**2 * pixels > self._last_pixels else 1.0)
            return expected * scale * math.sqrt(pixels) <= most

        scales = sorted({*_SCALES, least}, reverse=True)
        scale = next(filter(is_in_time, scales), scales[-1])
        width, height = (max(round(scale * side), 1) for side in (view.width, view.height))
        self._last_pixels = width * height
        return dataclasses.replace(view, width=width, height=height)

    def _display_options(
        self, session: Session, request: PageRequest, image: wd.Image, *, moving: bool
    ) -> dict[str, Any]:
        """Return the options of a picture's display transform.

        While the user drags (``moving``), and if the user has locked the exposure, the exposure of an earlier picture
        is used.
        """
        if session.exposure is None or not (moving or request.values["lock_exposure"]):
            session.exposure = min(image.auto_exposure, validation.MOST * 1e-6)
        factor = session.exposure * MEAN_SHOWN[request.values["display"]] / MEAN_SHOWN["aces"]
        shown = arguments(self.files.controls, request.values, "display")
        exposure = float(f"{factor * 2.0 ** shown.pop('exposure_stops', 0.0):.6g}")
        return shown | {"exposure": exposure, "background": 3 * (request.values["background"],)}

    def _send_angles_and_map(
        self, session: Session, request: PageRequest, scene: Scene, view: wd.View, progress: Callable[[float], None]
    ) -> None:
        """Send the directions to light and viewer at the probe, and the reflectance map for this light.

        The probe is a point on the mesh that the user selects.
        """
        image, display = session.picture or (None, {})
        pixel = None
        if image is not None:
            full = image.coverage > _FULL_COVERAGE
            pixel = page_bodies.nearest_pixel(full & image.illuminated, request.probe) or page_bodies.nearest_pixel(
                full, request.probe
            )
        light = wd.DirectionalLight(scene.to_light) if scene.light is None else scene.light.make()
        local = pixel and page_bodies.local_directions(
            self._objects.surface(scene), view, light, *pixel, smooth=request.values["smooth"],
            device=self._objects.device, threads=self._objects.threads,
        )  # fmt: skip
        message = _message("map", request, angles=None)
        if not local or not pixel:
            session.send(message | {"text": "No surface is visible."}, None)
            return
        message["at"] = [(pixel[0] + 0.5) / view.width, (pixel[1] + 0.5) / view.height]
        message["angles"] = {
            "light": page_bodies.angles_deg(local.to_light),
            "view": page_bodies.angles_deg(local.to_view),
        }
        message["to_view"] = local.to_view
        if scene.light is None:
            del message["angles"]["light"]
            session.send(message | {"text": "A reflectance map requires a light besides the environment."}, None)
            return
        if local.to_light[2] <= 1e-3:
            session.send(message | {"text": "The light is below the horizon at this point."}, None)
            return
        assert image is not None  # noqa: S101 (``pixel`` comes from the image)
        options = {name: value for name, value in scene.shading.items() if name in describe(EvaluationSettings)}
        # The plan of a grating map is made for the depths and pitches of its dots, and not for the cell.
        plan = None if scene.dots else image.plan
        disc = wd.reflectance_map(
            self._objects.height_field(scene), local.to_light, size=MAP_SIZE, plan=plan,
            illuminant=light.illuminant, device=self._objects.device.alias, threads=self._objects.threads,
            progress=progress, **options,
        )  # fmt: skip
        # The reflectance map has its own automatic exposure and no background.
        shown = {name: value for name, value in display.items() if name not in ("exposure", "background")}
        pixels = encoding.displayed(disc, exact=False, **shown)
        session.send(message | {"type": "image/png"}, encoding.encoded(pixels, lossless=True))


def _message(kind: str, request: PageRequest, **more: Any) -> dict[str, Any]:
    return {"kind": kind, "generation": request.generation, **more}


def _has_same_picture(drawn: PageRequest | None, request: PageRequest) -> bool:
    """Whether two requests have the same picture. Their numbers, probe points and ``moving`` (a drag) may differ."""
    return drawn is not None and request == dataclasses.replace(
        drawn, generation=request.generation, moving=request.moving, probe=request.probe
    )


def _is_released(session: Session, request: PageRequest) -> bool:
    """Whether a drag has just ended: the last picture was drawn during the drag, and the new request follows it."""
    return session.drawn_request is not None and session.drawn_request.moving and not request.moving
