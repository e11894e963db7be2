"""``Renderer``: pictures of one surface, one after the other."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.core import validation
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.planner.strategy import directions_of, warn_outside
from warpdiff.render.picture import load_kernels
from warpdiff.render.shade import (
    PictureRequest,
    check_light_sizes,
    listed,
    lobes_for,
    picture_memory,
    require_picture_memory,
    warn_unconverged,
)
from warpdiff.request.evaluation import Request
from warpdiff.scene.camera import View
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    from warpdiff.heightfield.field import HeightField
    from warpdiff.image.image import Image
    from warpdiff.lights.environment import Light
    from warpdiff.lights.light_types import Lobe
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.render.picture import Picture
    from warpdiff.request.plan import Plan
    from warpdiff.scene.mesh_import import Surface


class Renderer:
    """Pictures of a mesh whose surface carries a height field, under lights and views that change.

    Each is that of :func:`warpdiff.shade` with ``plan=renderer.plan``. What does not change is done once: the plan,
    which is for light and view from anywhere, the mesh and the arrays, and what is seen, until the view changes. On a
    GPU the launches of a picture are recorded, too, as a CUDA graph (with drivers from CUDA 12.4 on), which the next
    one replays without the host; the colours stay where they are until they are asked for::

        renderer = warpdiff.Renderer(mesh, heightfield, light, view, device="cuda")
        while True:
            show(renderer.draw(view=next_view()))

    Threads may draw at once: each has a picture of its own, which begins with the first lights and view, and neither
    sees nor changes those of others. On a GPU, whose launches all go to one stream, they take turns.

    A renderer can be pickled, and draws the same pictures in another process: what it is made of and its plan go along,
    tables are made there.

    Attributes:
        plan: What is computed and why.
    """

    def __init__(
        self,
        mesh: Any,
        heightfield: HeightField,
        light: Light | Sequence[Light],
        view: View,
        *,
        tolerance: float = 1e-2,
        method: str = "auto",
        coherence: Coherence | None = None,
        ior: float | None = None,
        material: Material | Mapping[str, Material] | None = None,
        masking: bool = True,
        energy: str = "stam",
        pigment: float = 1.0,
        shadows: bool = True,
        smooth: bool = True,
        tangents: ArrayLike | None = None,
        footprint: bool | None = None,
        samples_per_pixel: int = 1,
        refine: bool = True,
        plan: Plan | None = None,
        strict: bool = True,
        device: Any = None,
        threads: int | None = None,
    ) -> None:
        """Prepare pictures; the arguments are those of :func:`warpdiff.shade`.

        The tolerance is met for directions all over the hemisphere, as those of the pictures are not known, under the
        illuminants of these lights. The method ``"direct"`` is for single pictures.
        """
        wanted = PictureRequest.checked(
            heightfield, light, view, tolerance=tolerance, method=method, coherence=coherence, ior=ior, material=material,
            masking=masking, energy=energy, pigment=pigment, shadows=shadows, smooth=smooth, footprint=footprint,
            samples_per_pixel=samples_per_pixel, refine=refine, plan=plan, strict=strict, device=device,
            threads=threads,
        )  # fmt: skip
        if (method if plan is None else plan.method) == "direct":
            raise ValueError("method='direct' is for single pictures: use warpdiff.shade, or another method")
        request = wanted.request
        load_kernels(request.device)
        with picture_memory(view):
            surface = prepare_surface(mesh, tangents=tangents)
        self._begin(wanted, surface, view)
        self.draw()

    def _begin(self, wanted: PictureRequest, surface: Surface, view: View, lookup: ColourLookup | None = None) -> None:
        """Do all that does not change; an integrator by the same plan has its tables."""
        request = wanted.request
        self._wanted, self._surface = wanted, surface
        with picture_memory(view):
            direction_range, sample, count = directions_of(request)
            if request.plan is not None:
                warn_outside(request.plan, request.heightfield, direction_range)
            self.plan = wanted.planned(direction_range, sample, count)
            self._lookup = lookup or ColourLookup(
                request.heightfield, self.plan, direction_range, device=request.device, threads=request.threads
            )
            self._recorded = records(request.device)
            self._mine = _ThreadPicture(
                functools.partial(wanted.frame, surface, view, device_driven=self._recorded or None),
                wanted.lobes,
                view,
            )
        self._turn: Any = threading.Lock() if self._recorded else contextlib.nullcontext()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        return self._mine.view.width, self._mine.view.height

    def resized(self, view: View, *, refine: bool | None = None) -> Renderer:
        """Another renderer of the same surface by the same plan and tables, for pictures of another size.

        Args:
            view: The camera that it begins with.
            refine: As in :func:`warpdiff.shade`; None is as it is here.

        Returns:
            The other one, whose pictures are those that this one would draw of such views.

        Raises:
            MemoryError: More memory than is free; the message says what fits.
        """
        validation.instance(view, View, "view")
        require_picture_memory(view, self._wanted.request.device)
        refine = self._wanted.refine if refine is None else validation.flag(refine, "refine")
        result = object.__new__(Renderer)
        request = replace(self._wanted.request, plan=self.plan)
        result._begin(replace(self._wanted, request=request, refine=refine), self._surface, view, self._lookup)
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        request = {each.name: getattr(self._wanted.request, each.name) for each in fields(Request)}
        device, threads = request.pop("device").alias, request.pop("threads")
        # Of a core each, there may be another number elsewhere.
        of_all = None if threads == resolve_threads(None) else threads
        wanted = {each.name: getattr(self._wanted, each.name) for each in fields(PictureRequest)} | {"request": None}
        return _again, (request | {"plan": self.plan}, wanted, device, of_all, self._surface, self._mine.view)

    def draw(
        self,
        light: Light | Sequence[Light] | None = None,
        view: View | None = None,
        *,
        progress: Callable[[float], None] | None = None,
        previews: Mapping[float, Callable[[], object]] | None = None,
    ) -> wp.array:
        """Draw the next picture.

        Args:
            light: This thread's lights from now on; None leaves them as they are.
            view: Its view from now on, with as many pixels; None leaves it as it is.
            progress: As in :func:`warpdiff.shade`, on the CPU; on a GPU it is called once all is launched. What it
                raises ends the picture, as for a view that nobody waits for any more; the next one begins anew.
            previews: By tolerances above the plan's, what is called on the way to it once the picture keeps each:
                :meth:`image` is then that picture. What was computed for it serves the next, and the last one is the
                same to the bit. On the CPU, where pixels are split; elsewhere nothing is on the way.

        Returns:
            XYZ on the device, shape (height, width) of ``wp.vec3f``, which this thread's next picture overwrites. A GPU
            may still be at it: ``numpy()`` waits, and what is launched on the same stream comes after.
        """
        validation.callback(progress, "progress")
        mine = self._mine
        if mine.is_drawing:
            raise RuntimeError("draw() was called by what it calls itself, progress or coarser: call it afterwards")
        on_the_way = self._on_the_way(mine, previews)
        wanted, lights = self._wanted, mine.lights
        if light is not None:
            lights = lobes_for(listed(light), wanted.request, refine=wanted.refine)
        check_light_sizes(lights, wanted.request.coherence, means=self.plan.uses_footprints)
        if view is not None:
            validation.instance(view, View, "view")
            if (view.width, view.height) != (mine.view.width, mine.view.height):
                raise ValueError(
                    f"view must have {mine.view.width} × {mine.view.height} pixels as before, got "
                    f"{view.width} × {view.height}; another size takes another Renderer"
                )
        with self._turn, picture_memory(mine.view):
            # What is seen stays as it is, if the view does.
            if view is not None:
                mine.view = view
                mine.frame.set_view(view)
            mine.lights, mine.drawn = lights, False
            self._wanted.set_lights(mine.frame, lights)
            mine.is_drawing = True
            try:
                if self._recorded:
                    self._replay(mine)
                    if progress is not None:
                        progress(1.0)
                else:
                    self._launch(mine, progress, on_the_way)
            finally:
                mine.is_drawing = False
            mine.drawn, mine.tolerance = True, self.plan.tolerance
        return mine.frame.xyz

    def image(self) -> Image:
        """This thread's last picture, with what it covers, on the host, where no later one changes it."""
        if not self._mine.drawn:
            self.draw()
        with self._turn:
            image = self._mine.frame.image(replace(self.plan, tolerance=self._mine.tolerance))
        warn_unconverged(image.plan)
        if not self._wanted.request.device.is_cpu:
            return image
        return replace(image, xyz=image.xyz.copy(), illuminated=image.illuminated.copy())

    def _on_the_way(self, mine: _ThreadPicture, previews: Any) -> list[tuple[float, Callable[[], None]]]:
        """Checked tolerances, the largest first, with what is called at each."""
        if previews is not None and not isinstance(previews, Mapping):
            raise TypeError(f"coarser must be a mapping from tolerances to callables, got {type(previews).__name__}")
        # What is called may change what was given.
        asked = dict(previews or {})

        def tell(tolerance: float) -> None:
            mine.drawn, mine.tolerance = True, tolerance
            try:
                asked[tolerance]()
            finally:
                mine.drawn = False

        for tolerance, reached in asked.items():
            if not validation.number(tolerance, "previews", most=0.5) > self.plan.tolerance:
                raise ValueError(
                    f"coarser must be above the plan's {self.plan.tolerance:g}, got {tolerance!r}: omit it"
                )
            if not callable(reached):
                raise TypeError(f"coarser[{tolerance!r}] must be callable, got {type(reached).__name__}")
        if not self._wanted.refine:
            return []
        return [(each, functools.partial(tell, each)) for each in sorted(asked, reverse=True)]

    def _launch(
        self,
        mine: _ThreadPicture,
        progress: Callable[[float], None] | None = None,
        on_the_way: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:
        """Launch what a picture takes."""
        mine.frame.integrate(
            self._lookup, tolerance=self.plan.tolerance, refine=self._wanted.refine, progress=progress,
            previews=on_the_way,
        )  # fmt: skip

    def _replay(self, mine: _ThreadPicture) -> None:
        """Launch it as it was recorded, where the same launches will do."""
        needed = (*mine.frame.launches_depend_on, *(name for each in mine.lights for name in each.illuminants))
        if mine.graph is not None and mine.graph_is_for == needed:
            wp.capture_launch(mine.graph)
            return
        # Arrays of the last one may go.
        mine.graph = None
        # What ran once finds its kernels loaded and its arrays and tables made.
        mine.frame.invalidate_gbuffer()
        self._launch(mine)
        mine.frame.invalidate_gbuffer()
        with wp.ScopedCapture(device=self._wanted.request.device, force_module_load=False) as capture:
            self._launch(mine)
        mine.graph, mine.graph_is_for = capture.graph, needed


def _again(
    request: dict[str, Any], wanted: dict[str, Any], device: str, threads: int | None, surface: Surface, view: View
) -> Renderer:
    """A renderer that was pickled."""
    result = object.__new__(Renderer)
    same = Request(**request, device=resolve_device(device), threads=resolve_threads(threads))
    result._begin(PictureRequest(**wanted | {"request": same}), surface, view)
    return result


class _ThreadPicture(threading.local):
    """A thread's picture, made when it first asks for it.

    Attributes:
        frame: Its arrays.
        lights: The last.
        view: The last.
        drawn: Whether it was drawn.
        is_drawing: Whether it is being drawn.
        tolerance: For which.
        graph: Its launches as they were recorded.
        graph_is_for: What these depend on.
    """

    def __init__(self, make: Callable[[], Picture], lights: list[Lobe], view: View) -> None:
        self.frame, self.lights, self.view, self.drawn, self.tolerance = make(), lights, view, False, 0.0
        self.is_drawing = False
        self.graph: Any = None
        self.graph_is_for: tuple[Any, ...] = ()


def records(device: wp.Device) -> bool:
    """Whether a device can record and replay a picture, whose loops end when no pixel is left to be split."""
    return bool(device.is_cuda and wp.is_conditional_graph_supported())
