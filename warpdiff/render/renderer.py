"""``Renderer``: many pictures of one surface. Lights and view may change from one picture to the next."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack

import warp as wp

from warpdiff.core import validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.device.devices import resolve_threads
from warpdiff.lights.base import listed
from warpdiff.render.map_inputs import naming_texture_coordinates
from warpdiff.render.picture import load_kernels
from warpdiff.render.picture_inputs import PictureInputs, picture_memory, require_picture_memory
from warpdiff.render.shade import warn_unconverged
from warpdiff.request.plan import Plan
from warpdiff.request.settings import PictureSettings
from warpdiff.request.signatures import accepts
from warpdiff.scene.camera import View
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from warpdiff.image.image import Image
    from warpdiff.lights.base import Light, LightPart
    from warpdiff.render.picture import Picture
    from warpdiff.render.picture_inputs import SurfacesOfMesh
    from warpdiff.request.keywords import PictureKeywords
    from warpdiff.scene.mesh_import import Surface
    from warpdiff.tables.lookup import Lookups


class Renderer:
    """Renderer for many pictures of a mesh whose surface carries a height field; lights and view may change.

    Each picture is that of :func:`warpdiff.shade` with ``plan=renderer.plan``. The plan, which covers light and view
    from any direction, the prepared mesh and the arrays are computed once. Visible points are computed again only when
    the view changes. On a GPU with drivers from CUDA 12.4 on, the launches of a picture are recorded as a CUDA graph.
    The next picture replays the graph without the host. Colours remain on the device until you read them::

        renderer = warpdiff.Renderer(mesh, heightfield, light, view, device="cuda")
        while True:
            show(renderer.draw(view=next_view()))

    Several threads may draw at the same time. Each thread has a separate picture, which begins with the first lights
    and view. On a GPU, where all launches share one stream, threads wait for each other.

    A renderer can be pickled, and draws the same pictures in another process. The pickle contains the inputs and the
    plan; tables are computed again.

    Attributes:
        plan: The plan, which states what is computed and why. With several surfaces, it is a mapping from parts of the
            mesh to plans.

    Examples:
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> coherence = wd.Coherence(sigma_um=5.0)
        >>> renderer = wd.Renderer(body, grating, light, view, coherence=coherence, tolerance=0.1)
        >>> renderer.draw(wd.DirectionalLight((0.0, 1.0, 1.0))).shape
        (18, 32)
        >>> renderer.image()
        Image(32 × 18 pixels, 21 % illuminated, estimated error 0.71 at the 99th percentile)
    """

    @accepts(PictureSettings)
    def __init__(
        self, mesh: Any, heightfield: SurfacesOfMesh, lights: Light | Sequence[Light], view: View,
        **settings: Unpack[PictureKeywords],
    ) -> None:  # fmt: skip
        """Prepare pictures, and draw the first one.

        The directions of later pictures are unknown. The tolerance is therefore met for all directions of the
        hemisphere, under the illuminants of these lights. The method ``"direct"`` is only for single pictures.

        Args:
            mesh: Mesh with texture coordinates or tangents: see :func:`warpdiff.shade`.
            heightfield: Height field, whose x axis lies along the tangents of the mesh, or a mapping from parts of the
                mesh to surfaces, as for :func:`warpdiff.shade`.
            lights: Lights of the first picture.
            view: Camera of the first picture.
        """
        checked = PictureSettings(**settings)
        if (checked.plan.method if isinstance(checked.plan, Plan) else checked.method) == "direct":
            raise ArgumentValueError(
                f"{ref('method', 'direct')} is for single pictures: use warpdiff.shade, or another {ref('method')}"
            )
        inputs = PictureInputs.of(heightfield, lights, view, checked)
        load_kernels(inputs.evaluation.device)
        with picture_memory(view), naming_texture_coordinates(inputs.has_map):
            surface = prepare_surface(mesh, tangents=checked.tangents, plain=inputs.plain)
        self._begin(inputs, surface, view)
        self.draw()

    @classmethod
    def _from_parts(
        cls, inputs: PictureInputs, surface: Surface, view: View, lookups: Lookups | None = None
    ) -> Renderer:
        """Return a renderer for inputs that are already checked and a mesh that is already prepared."""
        result = cls.__new__(cls)
        result._begin(inputs, surface, view, lookups)
        return result

    def _begin(
        self, inputs: PictureInputs, surface: Surface, view: View, lookups: Lookups | None = None
    ) -> None:  # fmt: skip
        """Choose the plans, and make colour tables and picture. ``lookups`` has the tables that exist already."""
        device = inputs.evaluation.device
        self._inputs, self._surface = inputs, surface
        with picture_memory(view):
            self._plans, made = inputs.planned(None)
            self._lookups = lookups or made
            self.plan = inputs.by_key(self._plans)
            self._recorded = records(device)
            self._mine = _ThreadPicture(
                functools.partial(inputs.picture, surface, view, device_driven=self._recorded),
                inputs.parts,
                view,
            )
        self._turn: contextlib.AbstractContextManager[object] = (
            threading.Lock() if self._recorded else contextlib.nullcontext()
        )

    @property
    def _tolerance(self) -> float:
        """Tolerance of the pictures."""
        return min(plan.tolerance for plan in self._plans)

    @property
    def _made_of(self) -> tuple[PictureInputs, list[Plan], Surface, View]:
        """Checked inputs, plans, mesh and the view of this thread's pictures, for the use of ``wd.adjoint.pixels``."""
        return self._inputs, self._plans, self._surface, self._mine.view

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures [pixels]."""
        return self._mine.view.width, self._mine.view.height

    def resized(self, view: View, *, refine: bool | None = None) -> Renderer:
        """Return another renderer of this surface, with the same plan and colour tables, for pictures of another size.

        Args:
            view: Camera of the new renderer's first picture.
            refine: As in :func:`warpdiff.shade`; None uses the setting of this renderer.

        Returns:
            A renderer with the first lights, the plan and the tables of this one.

        Raises:
            MemoryError: The pictures require more memory than is free; the message says what fits.
        """
        validation.instance(view, View, "view")
        require_picture_memory(view, self._inputs.evaluation.device)
        inputs = self._inputs.with_plans(self._plans)
        if refine is not None:
            inputs = inputs.refined(refine=validation.flag(refine, "refine"))
        return self._from_parts(inputs, self._surface, view, self._lookups)

    def __reduce__(self) -> tuple[Callable[..., Renderer], tuple[dict[str, Any]]]:
        return _unpickled, (self.__getstate__(),)

    def __getstate__(self) -> dict[str, Any]:
        """Return the inputs of the pictures for pickling: settings, plan, height field, lights, surface and view."""
        evaluation = self._inputs.evaluation
        # The default number of threads is the number of cores. It is not stored, because another machine may have
        # another number of cores.
        threads = None if evaluation.threads == resolve_threads(None) else evaluation.threads
        settings = replace(
            self._inputs.settings, plan=self.plan, tangents=None, footprint=evaluation.footprint,
            coherence=self._inputs.settings.coherence if isinstance(self._inputs.heightfield, Mapping) else None,
            device=evaluation.device.alias, threads=threads,
        )  # fmt: skip
        return {
            "settings": settings, "heightfield": self._inputs.heightfield, "lights": self._inputs.lights,
            "surface": self._surface, "view": self._mine.view,
        }  # fmt: skip

    def draw(
        self, lights: Light | Sequence[Light] | None = None, view: View | None = None, *, progress: Progress = None,
        previews: Mapping[float, Callable[[], object]] | None = None,
    ) -> wp.array:  # fmt: skip
        """Draw the next picture.

        Args:
            lights: Lights of this thread's pictures from now on; None uses the previous lights.
            view: Camera from now on, with the same size in pixels; None uses the previous camera.
            progress: As for :func:`warpdiff.shade`. On a GPU it is called once, after all launches. An exception that
                it raises cancels the picture; the next picture starts from scratch.
            previews: Callables by tolerances that are larger than the plan's tolerance. Each callable is called once
                the picture meets its tolerance, and :meth:`image` then returns that picture. Previews reuse all work
                and do not change the final picture. They have no effect on a GPU, or without refinement.

        Returns:
            XYZ on the device, shape (height, width) of ``wp.vec3f``. This thread's next picture overwrites the array.
            On a GPU the array may not be ready yet; ``numpy()`` synchronises.

        Examples:
            >>> import warpdiff as wd
            >>> body, light = wd.meshes.tube(), wd.DirectionalLight((0.3, 1.0, 0.8))
            >>> view = wd.View.fit(body, width=32, height=18)
            >>> grating, coherence = wd.gratings.sinusoidal(2.0, 0.1), wd.Coherence(sigma_um=5.0)
            >>> renderer = wd.Renderer(body, grating, light, view, coherence=coherence, tolerance=0.1)
            >>> renderer.draw(wd.PointLight((1.0, 2.0, 3.0))).numpy().shape
            (18, 32, 3)
        """
        progress = reporter(progress, "draw")
        mine = self._mine
        if mine.is_drawing:
            raise RuntimeError("draw() was called from its own progress or previews callable: call it afterwards")
        steps = self._preview_steps(mine, previews)
        parts = mine.parts
        if lights is not None:
            means = all(plan.uses_footprints for plan in self._plans)
            parts = self._inputs.parts_of(listed(lights), means=means)
        if view is not None:
            validation.instance(view, View, "view")
            if (view.width, view.height) != (mine.view.width, mine.view.height):
                raise ArgumentValueError(
                    f"{ref('view')} must have {mine.view.width} × {mine.view.height} pixels as before, got "
                    f"{view.width} × {view.height}; use renderer.resized(view) for another size"
                )
        with self._turn, picture_memory(mine.view):
            mine.is_drawn = False
            # If a light is not accepted, an error is raised here, and the previous lights and view stay in use.
            mine.picture.set_lights(parts)
            mine.parts = parts
            # A new view discards the hits of camera rays. New lights do not, because hits depend only on the view.
            if view is not None:
                mine.view = view
                mine.picture.set_view(view)
            mine.is_drawing = True
            try:
                if self._recorded:
                    self._replay(mine)
                    if progress is not None:
                        progress(1.0)
                else:
                    self._launch(mine, progress, steps)
            finally:
                mine.is_drawing = False
            mine.is_drawn, mine.tolerance = True, self._tolerance
        return mine.picture.xyz

    def image(self) -> Image:
        """Return a copy of this thread's last picture on the host.

        Examples:
            >>> import warpdiff as wd
            >>> body, light = wd.meshes.tube(), wd.DirectionalLight((0.3, 1.0, 0.8))
            >>> view = wd.View.fit(body, width=32, height=18)
            >>> grating, coherence = wd.gratings.sinusoidal(2.0, 0.1), wd.Coherence(sigma_um=5.0)
            >>> renderer = wd.Renderer(body, grating, light, view, coherence=coherence, tolerance=0.1)
            >>> renderer.image().xyz.shape
            (18, 32, 3)
        """
        if not self._mine.is_drawn:
            self.draw()
        with self._turn:
            plans = [replace(plan, tolerance=self._mine.tolerance) for plan in self._plans]
            image = self._inputs.image(self._mine.picture, plans)
        warn_unconverged(image)
        if not self._inputs.evaluation.device.is_cpu:
            return image
        return replace(image, xyz=image.xyz.copy(), illuminated=image.illuminated.copy())

    def _preview_steps(self, mine: _ThreadPicture, previews: object) -> list[tuple[float, Callable[[], None]]]:
        """Check the previews, and return their tolerances in descending order, each with a function to call.

        A preview is a picture at a larger tolerance. The function calls the callable of the preview. During this call,
        the picture counts as complete at its tolerance.
        """
        if previews is not None and not isinstance(previews, Mapping):
            raise ArgumentTypeError(
                f"{ref('previews')} must be a mapping from tolerances to callables, got {type(previews).__name__}"
            )
        # The mapping of previews (tolerances with callables) is copied, because its callables may change it while the
        # picture is drawn.
        callables = dict(previews or {})

        def show(tolerance: float) -> None:
            mine.is_drawn, mine.tolerance = True, tolerance
            try:
                callables[tolerance]()
            finally:
                mine.is_drawn = False

        for tolerance, function in callables.items():
            if not validation.number(tolerance, "previews", most=0.5) > self._tolerance:
                raise ArgumentValueError(
                    f"{ref('previews')} must have tolerances above the plan's {self._tolerance:g}, got "
                    f"{tolerance!r}: omit it"
                )
            if not callable(function):
                raise ArgumentTypeError(
                    f"{ref(f'previews[{tolerance!r}]')} must be callable, got {type(function).__name__}"
                )
        if not self._inputs.settings.refine:
            return []
        return [(tolerance, functools.partial(show, tolerance)) for tolerance in sorted(callables, reverse=True)]

    def _launch(
        self,
        mine: _ThreadPicture,
        progress: Callable[[float], None] | None = None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:
        """Launch the kernels that compute a picture."""
        mine.picture.render(self._lookups, tolerance=self._tolerance, progress=progress, previews=previews)

    def _replay(self, mine: _ThreadPicture) -> None:
        """Replay the recorded graph of a picture, if it is still valid. Otherwise draw once, and record a new graph."""
        needed = mine.picture.graph_key
        if mine.graph is not None and mine.graph_is_for == needed:
            wp.capture_launch(mine.graph)
            return
        # The old graph is deleted first, because drawing may free arrays that the old graph uses.
        mine.graph = None
        # The picture is drawn once before it is recorded. This loads kernels and makes arrays and tables, which cannot
        # be recorded.
        mine.picture.invalidate()
        self._launch(mine)
        mine.picture.invalidate()
        with wp.ScopedCapture(device=self._inputs.evaluation.device, force_module_load=False) as capture:
            self._launch(mine)
        mine.graph, mine.graph_is_for = capture.graph, needed


def _unpickled(state: dict[str, Any]) -> Renderer:
    """Return a renderer from its pickled inputs."""
    inputs = PictureInputs.of(state["heightfield"], state["lights"], state["view"], state["settings"])
    return Renderer._from_parts(inputs, state["surface"], state["view"])


class _ThreadPicture(threading.local):
    """Picture of one thread, which is made when the thread first draws.

    Attributes:
        picture: Camera rays, passes (computations of single lights), and sums of colours of this thread's pictures.
        parts: Parts of the lights with which this thread drew last.
        view: View with which this thread drew last.
        is_drawn: Whether the picture is complete.
        is_drawing: Whether the picture is being drawn.
        tolerance: Tolerance that the picture meets.
        graph: Recorded CUDA graph of the picture.
        graph_is_for: Key of the picture for which the graph was recorded; a picture with another key requires a new
            graph.
    """

    def __init__(self, make: Callable[[], Picture], parts: list[LightPart], view: View) -> None:
        self.picture, self.parts, self.view, self.is_drawn, self.tolerance = make(), parts, view, False, 0.0
        self.is_drawing = False
        self.graph: wp.Graph | None = None
        self.graph_is_for: tuple[Hashable, ...] = ()


def records(device: wp.Device) -> bool:
    """Return whether a device can record pictures as CUDA graphs.

    The loops over tiles (subdivided pixels) can only be recorded with a driver of CUDA 12.4 or later.
    """
    return bool(device.is_cuda and wp.is_conditional_graph_supported())
