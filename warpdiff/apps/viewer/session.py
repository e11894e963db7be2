"""Progressive pictures for pages: at once while something moves, finer and finer at rest, and none that is out of date.

One thread draws for all pages, in turns, so that pages share tables and memory does not grow with their number. A page
says what it wants under a generation, a number that it counts up; of what it wants the newest counts. A picture at rest
whose page has gone on to another generation is abandoned in the midst of its kernels.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import statistics
import threading
import time
import traceback
import warnings
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff.apps.viewer import encoding, page_bodies
from warpdiff.apps.viewer.page_calls import NamedFiles, Scene
from warpdiff.core import disk_cache, validation
from warpdiff.core.caching import LruCache
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.image.display_transform import MEAN_SHOWN
from warpdiff.lights.environment import rotated

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from warpdiff.apps.viewer.page_calls import Call
    from warpdiff.scene.mesh_import import Surface

# Of pictures at rest, before that of the tolerance itself.
TOLERANCES = (0.1, 0.03)
# How long nothing must change, while a pointer is still down, before a picture is refined.
_REST_S = 0.15
# Pictures that a page has not shown yet.
_MOST_IN_FLIGHT = 2
# A picture while something moves is to take so long at most; where it would take longer, it has fewer pixels, but at
# least 320 × 240 as long as such a picture comes in time for twelve a second.
_MOVING_S, _LEAST_MOVING_S = 0.065, 0.08
_SCALES = (1.0, 0.75, 0.5, 0.375)
_LEAST_PIXELS = 320 * 240
# How many of these tell how long the next takes, as one may be late by chance; it has more pixels where that is
# expected to leave room, so that sizes do not go to and fro.
_TIMED, _ROOM = 5, 0.8
# Of renderers that are kept, and of their pixels, some.
_MOST_BYTES, _BYTES_PER_PIXEL = 1.5e9, 300
MAP_SIZE = 192
# How often a page is told how much of a picture is drawn.
_TOLD_S = 0.5
# Of a pixel that a body fills.
_WHOLE = 0.999


class _AbandonedError(Exception):
    """Raised in the midst of a picture that nobody waits for."""


@dataclass(frozen=True)
class Wanted:
    """What a page wants to see.

    Attributes:
        generation: Counted up by the page with every change.
        values: Of all controls.
        camera: Eye, target, up and vertical field of view [degrees]; None is one that frames the body.
        aspect: Width over height.
        moving: Whether a pointer is down, so that more changes may come at once.
        probe: Where in the picture angles are told, from its left and its top, 0 to 1.
    """

    generation: int
    values: Mapping[str, Any]
    camera: tuple[Any, Any, Any, float] | None
    aspect: float
    moving: bool
    probe: tuple[float, float]


class Stage(NamedTuple):
    """One of the pictures of a generation: refined to a tolerance, or by one look-up a pixel where that is None."""

    tolerance: float | None
    last: bool = False


def stages_to(tolerance: float) -> list[Stage]:
    """Pictures on the way to one of a tolerance; after them comes what there is to say of a place in the last."""
    return [Stage(None), *(Stage(each) for each in TOLERANCES if each > tolerance), Stage(tolerance, last=True)]


@dataclass(eq=False)
class Session:
    """What one page wants and has; its fields are the drawing thread's, but for ``wanted``, ``in_flight``, ``open``.

    Attributes:
        send: Called from the drawing thread with a description, and with bytes or None.
        wanted: The newest.
        in_flight: Pictures sent that the page has not shown.
        open: Whether the page is there.
        begun: The generation whose stages are gone through.
        stage: The next of them.
        drawn_at: When the first of them was drawn.
        seen: What the last picture was drawn for.
        factor: The automatic exposure of the last picture at rest, or of the first one.
        shown: The last picture, and how it is saved.
    """

    send: Callable[[dict[str, Any], bytes | None], None]
    wanted: Wanted | None = None
    in_flight: int = 0
    open: bool = True
    begun: int = -1
    stage: int = 0
    drawn_at: float = 0.0
    seen: Wanted | None = None
    factor: float | None = None
    shown: tuple[wd.Image, dict[str, Any]] | None = None


def _bytes_of(renderer: wd.Renderer) -> float:
    width, height = renderer.size
    return float(_BYTES_PER_PIXEL * width * height)


@dataclass
class _Made:
    """What is kept between pictures, by what tells it apart."""

    surfaces: LruCache[Surface] = field(default_factory=lambda: LruCache(4))
    environments: LruCache[wd.Environment] = field(default_factory=lambda: LruCache(2))
    skies: LruCache[wd.Environment] = field(default_factory=lambda: LruCache(4))
    height_fields: LruCache[wd.HeightField] = field(default_factory=lambda: LruCache(8))
    bases: LruCache[wd.Renderer] = field(default_factory=lambda: LruCache(6))
    renderers: LruCache[wd.Renderer] = field(default_factory=lambda: LruCache(8, _MOST_BYTES, _bytes_of))


class Studio:
    """The thread that draws for all pages."""

    def __init__(
        self, files: NamedFiles, values: Mapping[str, Any], *, device: Any = None, threads: int | None = None
    ) -> None:
        """Begin to draw, for pages that will be there and are likely to begin with these values."""
        self.files, self._likely = files, values
        self._device, self._threads = resolve_device(device), resolve_threads(threads)
        self._sessions: list[Session] = []
        self._changed = threading.Condition()
        self._made = _Made()
        # What the last unrefined pictures took over the root of their pixels [s]: a part is the same for all sizes.
        self._took: deque[float] = deque(maxlen=_TIMED)
        # Of the last of them.
        self._last_pixels = math.inf
        self._thread = threading.Thread(target=self._run, name="warpdiff-view", daemon=True)
        self._thread.start()

    def session(self, send: Callable[[dict[str, Any], bytes | None], None]) -> Session:
        """Draw for one more page; ``send`` is called from the drawing thread."""
        result = Session(send)
        with self._changed:
            self._sessions.append(result)
        return result

    def leave(self, session: Session) -> None:
        """A page is gone."""
        with self._changed:
            session.open = False
            if session in self._sessions:
                self._sessions.remove(session)
            self._changed.notify()

    def want(self, session: Session, wanted: Wanted) -> None:
        """Set what a page wants from now on."""
        with self._changed:
            session.wanted = wanted
            self._changed.notify()

    @staticmethod
    def wanted(*operands: Any, **options: Any) -> Wanted:
        """What a page wants, see :class:`Wanted`."""
        return Wanted(*operands, **options)

    @staticmethod
    def saved(session: Session, kind: str) -> bytes:
        """The picture that a page shows, as a file."""
        if session.shown is None:
            raise ValueError("there is no picture to save yet")
        return encoding.saved(*session.shown[:1], kind, session.shown[1])

    def acknowledge(self, session: Session) -> None:
        """A page has shown a picture."""
        with self._changed:
            session.in_flight = max(session.in_flight - 1, 0)
            self._changed.notify()

    def _prepare(self) -> None:
        """Make what first pictures take, whatever their size."""
        scene = Scene.of(self._likely, self.files)
        view = page_bodies.framed(self._surface(scene), 16, 12)
        image = self._renderer(scene, view, refine=False, say=lambda: None).image()
        encoding.encoded(encoding.shown(image, exact=False, background=(0, 0, 0)), lossless=False)

    def _run(self) -> None:
        # What fails here fails again for a page, and is told there.
        with warnings.catch_warnings(), contextlib.suppress(Exception):
            warnings.simplefilter("ignore")
            self._prepare()
        while True:
            session, wanted, index = self._next()
            try:
                with warnings.catch_warnings(record=True) as told:
                    warnings.simplefilter("ignore")
                    warnings.simplefilter("always", wd.WarpdiffWarning)
                    self._serve(session, wanted, index)
                if told:
                    words = list(dict.fromkeys(str(each.message) for each in told))
                    session.send({"kind": "warning", "generation": wanted.generation, "text": "\n".join(words)}, None)
            except _AbandonedError:
                continue
            except Exception as error:
                # One page's error reaches no other, and does not end the thread.
                expected = isinstance(error, (ValueError, TypeError, OSError, MemoryError))
                text = str(error) if expected else f"{type(error).__name__}: {error}"
                if not expected:
                    traceback.print_exc()
                session.send({"kind": "error", "generation": wanted.generation, "text": text}, None)
                session.stage = len(stages_to(wanted.values["tolerance"])) + 1

    def _next(self) -> tuple[Session, Wanted, int]:
        """Wait for the next picture: first ones before finer ones, pages in turns."""
        with self._changed:
            while True:
                waits: list[float] = []
                found: list[tuple[bool, Session, Wanted]] = []
                for session in self._sessions:
                    wanted = session.wanted
                    if wanted is None or session.in_flight >= _MOST_IN_FLIGHT:
                        continue
                    pictures = len(stages_to(wanted.values["tolerance"]))
                    if session.begun != wanted.generation:
                        session.begun = wanted.generation
                        # Where only another place is asked for, pictures go on; after the last, they stand.
                        is_seen = not wanted.moving and session.seen is not None and _alike(session.seen, wanted)
                        session.stage = min(session.stage, pictures) if is_seen else 0
                    if session.stage == 0 and _is_let_go(session, wanted):
                        session.stage = 1
                    if session.stage > pictures:
                        continue
                    left = session.drawn_at + _REST_S - time.monotonic() if wanted.moving and session.stage else 0.0
                    if left > 0.0:
                        waits.append(left)
                    else:
                        found.append((session.stage > 0, session, wanted))
                if found:
                    _, session, wanted = min(found, key=lambda each: each[0])
                    self._sessions.remove(session)
                    self._sessions.append(session)
                    return session, wanted, session.stage
                self._changed.wait(min(waits, default=None))

    def _goes_on(self, session: Session, wanted: Wanted, index: int) -> bool:
        """Whether a page still waits for a stage, and no other page for its first picture."""
        newest = session.wanted
        if not session.open or newest is None:
            return False
        if index == 0:
            # What moves is drawn to the end, or nothing would be seen of it.
            return not _is_let_go(session, newest)
        others = (each for each in tuple(self._sessions) if each is not session and each.in_flight < _MOST_IN_FLIGHT)
        return newest.generation == wanted.generation and not any(
            each.wanted is not None and each.begun != each.wanted.generation for each in others
        )

    def _watch(self, session: Session, wanted: Wanted, index: int) -> Callable[[float], None]:
        """What is called with the share of a picture that is drawn: it tells the page, or abandons the picture."""
        told_at = time.monotonic()

        def watch(share: float) -> None:
            nonlocal told_at
            if not self._goes_on(session, wanted, index):
                raise _AbandonedError
            if time.monotonic() - told_at > _TOLD_S:
                told_at = time.monotonic()
                session.send({"kind": "progress", "generation": wanted.generation, "share": share}, None)

        return watch

    def _serve(self, session: Session, wanted: Wanted, index: int) -> None:
        """Draw pictures from a stage on and send them, or what there is to say of the last one."""
        watch = self._watch(session, wanted, index)
        scene = Scene.of(wanted.values, self.files)
        stages = stages_to(scene.tolerance)
        body = self._surface(scene)
        scene = scene.placed(body.centre.tolist(), body.radius)
        full = _view(wanted, body)
        if index == len(stages):
            self._send_angles_and_map(session, wanted, scene, full, watch)
            session.stage = index + 1
            return
        begin = time.perf_counter()
        view = full if index else self._smaller(full)
        drawn = scene.at(stages[index].tolerance)

        def say() -> None:
            session.send({"kind": "preparing", "generation": wanted.generation, "tolerance": drawn.tolerance}, None)

        renderer = self._renderer(drawn, view, refine=index > 0, say=say)
        lights = self._lights(drawn)
        built = time.perf_counter()
        description = {
            "kind": "picture",
            "generation": wanted.generation,
            "width": view.width,
            "height": view.height,
            "camera": {"eye": view.eye, "target": view.target, "up": view.up, "fov_y_deg": view.fov_y_deg},
            "body": {"centre": body.centre.tolist(), "radius": body.radius},
            "to_light": scene.to_light,
        }

        def send() -> None:
            """Send the picture of the next stage as it is drawn."""
            stage = stages[session.stage]
            image = renderer.image()
            ready = time.perf_counter()
            how = self._exposed(session, wanted, image, moving=wanted.moving and stage.tolerance is None)
            shown_how = how | _behind(scene, lights, view)
            pixels = encoding.shown(image, exact=stage.last, **shown_how)
            displayed = time.perf_counter()
            data = encoding.encoded(pixels, lossless=stage.last)
            errors = image.error[image.illuminated]
            seconds = np.diff([begin, built, ready, displayed, time.perf_counter()]).tolist()
            told: dict[str, Any] = {
                "stage": session.stage, "tolerance": stage.tolerance, "last": stage.last,
                "seconds": dict(zip(("prepare", "draw", "display", "encode"), seconds, strict=True)),
                "type": "image/png" if stage.last else "image/jpeg",
                "error": dict(zip(("median", "p99"), np.percentile(errors, (50.0, 99.0)).tolist(), strict=True))
                if errors.size else None,
            }  # fmt: skip
            if stage.tolerance is not None:
                told["plan"] = str(image.plan)
                told["python"] = scene.python(view, scene.tolerance, how)
                told["command"] = scene.command(view, scene.tolerance, how, self.files)
            session.seen, session.shown = wanted, (image, shown_how)
            with self._changed:
                session.in_flight += 1
                session.drawn_at = time.monotonic()
            session.stage += 1
            session.send(description | told, data)

        # What is refined goes on from one tolerance to the next, but for an environment.
        last = len(stages) - 1 if index and scene.sky is None else index
        on_the_way = {each.tolerance: send for each in stages[index:last] if each.tolerance is not None}
        renderer.draw(lights, view, progress=watch, previews=on_the_way)
        # Where nothing is to be split, there is nothing on the way.
        session.stage = last
        send()
        if not index:
            self._took.append((time.perf_counter() - built) / math.sqrt(view.width * view.height))

    def _smaller(self, view: wd.View) -> wd.View:
        """A view of the largest size that is drawn in time."""
        pixels = view.width * view.height
        least = min(math.sqrt(_LEAST_PIXELS / pixels), 1.0)
        took = statistics.median(self._took) if self._took else 0.0

        def is_in_time(scale: float) -> bool:
            most = _LEAST_MOVING_S
            if scale > least:
                most = _MOVING_S * (_ROOM if scale**2 * pixels > self._last_pixels else 1.0)
            return took * scale * math.sqrt(pixels) <= most

        scales = sorted({*_SCALES, least}, reverse=True)
        scale = next(filter(is_in_time, scales), scales[-1])
        width, height = (max(round(scale * each), 1) for each in (view.width, view.height))
        self._last_pixels = width * height
        return dataclasses.replace(view, width=width, height=height)

    def _exposed(self, session: Session, wanted: Wanted, image: wd.Image, *, moving: bool) -> dict[str, Any]:
        """How a picture is displayed: while something moves, as the last one at rest, or it would flicker."""
        display = wanted.values["display"]
        if session.factor is None or not (moving or wanted.values["held"]):
            session.factor = min(image.auto_exposure, validation.MOST * 1e-6)
        factor = session.factor * MEAN_SHOWN[display] / MEAN_SHOWN["aces"]
        grey = wanted.values["background"]
        return {
            "display": display,
            "exposure": float(f"{factor * 2.0 ** wanted.values['exposure_stops']:.6g}"),
            "background": (grey, grey, grey),
        }

    def _surface(self, scene: Scene) -> Surface:
        tangents = dict(scene.options).get("tangents")
        key = str(scene.mesh), tangents
        return self._made.surfaces.get_or_make(key, lambda: page_bodies.surface_of(scene.mesh, tangents))

    def _height_field(self, scene: Scene) -> wd.HeightField:
        return self._made.height_fields.get_or_make(
            str(scene.heightfield), lambda: _kept_height_field(scene.heightfield)
        )

    def _lights(self, scene: Scene) -> list[Any]:
        """The light, and after it the environment."""
        found = [] if scene.light is None else [scene.light.make()]
        if (sky := scene.sky) is None:
            return found

        def make() -> wd.Environment:
            (path,) = sky.operands
            loaded = self._made.environments.get_or_make(path, lambda: wd.Environment.load(path))
            return rotated(loaded, **{"rotation_deg": 0.0, "scale": 1.0, "directions": None} | dict(sky.options))

        return [*found, self._made.skies.get_or_make(str(sky), make)]

    def _renderer(self, scene: Scene, view: wd.View, *, refine: bool, say: Callable[[], None]) -> wd.Renderer:
        """A renderer of pictures of a size; ``say`` is called where that takes long."""
        of = str(scene.mesh), str(scene.heightfield), str(scene.options), *_illuminants(scene), scene.tolerance

        def make() -> wd.Renderer:
            base = self._made.bases.get_or_make(of, lambda: self._base(scene, say))
            return base.resized(view, refine=refine)

        return self._made.renderers.get_or_make((*of, refine, view.width, view.height), make)

    def _base(self, scene: Scene, say: Callable[[], None]) -> wd.Renderer:
        """What renderers of any size share; its plan is found again on disk, as to make one takes seconds."""
        say()
        heightfield, surface, options = self._height_field(scene), self._surface(scene), scene.shading
        # Of lights their spectra alone are asked for.
        lights = self._lights(scene.at(None))
        options.pop("tangents", None)
        options |= {"device": self._device.alias, "threads": self._threads, "refine": False}
        view = page_bodies.framed(surface, 16, 12)
        begun: list[wd.Renderer] = []

        def plan() -> dict[str, Any]:
            begun.append(wd.Renderer(surface, heightfield, lights, view, tolerance=scene.tolerance, **options))
            return {"plan": json.dumps(dataclasses.asdict(begun[0].plan))}

        # No plan asks whether there are shadows.
        of_plan = tuple(each for each in scene.options if each[0] != "shadows")
        asked = "plan", str(of_plan), *_illuminants(scene), scene.tolerance, heightfield.pitch_um, self._device.alias
        found = disk_cache.cached_on_disk(asked, heightfield.heights_um, plan)
        if begun:
            return begun[0]
        for name in ("method", "coherence"):
            options.pop(name, None)
        return wd.Renderer(surface, heightfield, lights, view, plan=_plan_of(str(found["plan"])), **options)

    def _send_angles_and_map(
        self, session: Session, wanted: Wanted, scene: Scene, view: wd.View, watch: Callable[[float], None]
    ) -> None:
        """Send directions at the probe, and the reflectance in all directions for the light there."""
        image, how = session.shown or (None, {})
        place = None
        if image is not None:
            whole = image.coverage > _WHOLE
            place = _nearest(whole & image.illuminated, wanted.probe) or _nearest(whole, wanted.probe)
        light = wd.DirectionalLight(scene.to_light) if scene.light is None else scene.light.make()
        local = place and page_bodies.local_directions(
            self._surface(scene), view, light, *place, smooth=wanted.values["smooth"], device=self._device,
            threads=self._threads,
        )  # fmt: skip
        found: dict[str, Any] = {"kind": "map", "generation": wanted.generation, "angles": None}
        if not local or not place:
            session.send(found | {"text": "no surface in the picture"}, None)
            return
        found["at"] = [(place[0] + 0.5) / view.width, (place[1] + 0.5) / view.height]
        found["angles"] = {"light": _angles(local.to_light), "view": _angles(local.to_view)}
        found["to_view"] = local.to_view
        if scene.light is None:
            del found["angles"]["light"]
            session.send(found | {"text": "the map is of a light, and there is none but the environment"}, None)
            return
        if local.to_light[2] <= 1e-3:
            session.send(found | {"text": "the light is below the horizon here"}, None)
            return
        shading = scene.shading
        options = {name: shading[name] for name in ("ior", "material", "masking", "energy") if name in shading}
        assert image is not None  # noqa: S101 (there is a place in it)
        disc = wd.reflectance_map(
            self._height_field(scene), local.to_light, size=MAP_SIZE, plan=image.plan, illuminant=light.illuminant,
            device=self._device.alias, threads=self._threads, progress=watch, **options,
        )  # fmt: skip
        pixels = encoding.shown(disc, exact=False, display=how["display"])
        session.send(found | {"type": "image/png"}, encoding.encoded(pixels, lossless=True))


def _kept_height_field(call: Call) -> wd.HeightField:
    """A height field; gratings are found again on disk, as fingers take half a second of a first picture."""
    if call.on is not None or not call.function.startswith("gratings."):
        made: wd.HeightField = call.make()
        return made

    def arrays() -> dict[str, Any]:
        heightfield = call.make()
        return {"heights_um": heightfield.heights_um, "pitch_um": np.array(heightfield.pitch_um)}

    found = disk_cache.cached_on_disk(("height field", wd.__version__, str(call)), np.zeros(0), arrays)
    return wd.HeightField.of_known_scale(found["heights_um"], tuple(found["pitch_um"].tolist()))


def _alike(one: Wanted, other: Wanted) -> bool:
    """Whether two have the same picture."""
    return dataclasses.replace(one, generation=0, moving=False, probe=other.probe) == dataclasses.replace(
        other, generation=0, moving=False
    )


def _behind(scene: Scene, lights: list[Any], view: wd.View) -> dict[str, Any]:
    """The environment as a picture's background, where it is one."""
    return {"background": lights[-1].background(view) / np.float32(scene.normal)} if scene.is_behind else {}


def _illuminants(scene: Scene) -> tuple[str, ...]:
    """What light a scene has; an environment's suns have spectra of their own."""
    named = () if scene.light is None else (str(dict(scene.light.options).get("illuminant", "D65")),)
    return named if scene.sky is None else (*named, *map(str, scene.sky.operands))


def _is_let_go(session: Session, wanted: Wanted) -> bool:
    """Whether what moved in the last picture moves no more: it is refined at once, as it is all but there."""
    return session.seen is not None and session.seen.moving and not wanted.moving


def _view(wanted: Wanted, body: Surface) -> wd.View:
    """The view of a page at rest."""
    height = wanted.values["height"]
    width = max(round(wanted.aspect * height), 1)
    if wanted.camera is None:
        return page_bodies.framed(body, width, height)
    eye, target, up, fov = wanted.camera
    return wd.View(eye, target, up=up, fov_y_deg=fov, width=width, height=height)


def _plan_of(text: str) -> wd.Plan:
    """A plan as it was written down."""

    def plain(told: dict[str, Any]) -> dict[str, Any]:
        return {name: tuple(value) if isinstance(value, list) else value for name, value in told.items()}

    told = plain(json.loads(text))
    told["coherence"] = wd.Coherence(**plain(told["coherence"]))
    return wd.Plan(**told)


def _nearest(mask: Any, probe: Sequence[float]) -> tuple[int, int] | None:
    """The pixel (column, row) of a body that is nearest to a place in the picture."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return None
    height, width = mask.shape
    nearest = int(np.argmin((columns + 0.5 - probe[0] * width) ** 2 + (rows + 0.5 - probe[1] * height) ** 2))
    return int(columns[nearest]), int(rows[nearest])


def _angles(direction: Sequence[float]) -> dict[str, float]:
    """Angles from the normal and from the height field's x [degrees]."""
    x, y, z = direction
    return {
        "theta_deg": float(np.degrees(np.arccos(np.clip(z, -1.0, 1.0)))),
        "phi_deg": float(np.degrees(np.arctan2(y, x))),
    }
