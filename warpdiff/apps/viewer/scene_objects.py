"""Objects that the pictures of the viewer's pages share: surfaces, height fields, lights and renderers, in caches.

A renderer refines a picture by dividing pixels into smaller cells until the colours meet the tolerance. A plan states
how colours are computed: the method, the number of wavelengths, the number of series terms and so on.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, cast

import warpdiff as wd
from warpdiff.apps.viewer import page_bodies
from warpdiff.core import disk_cache
from warpdiff.core.caching import LruCache
from warpdiff.lights.environment import with_settings

if TYPE_CHECKING:
    from collections.abc import Callable

    import warp as wp

    from warpdiff.apps.viewer.page_calls import Scene
    from warpdiff.scene.mesh_import import Surface

# Largest memory of all cached renderers [bytes], and approximate memory of one renderer per pixel [bytes]. If the first
# number is doubled, the viewer requires more memory; if the second is doubled, fewer renderers are cached.
_MOST_BYTES, _BYTES_PER_PIXEL = 1.5e9, 300
# Names of the options of an environment light that do not change its radiance maps. Lights that differ only in these
# options share the maps.
_SKY_SETTINGS = ("rotation_deg", "scale", "directions")


class SceneObjects:
    """Objects of scenes (meshes, height fields, lights, renderers), made at the first use and cached.

    A key of a cache is the text of the library call that makes the object.

    Attributes:
        device: Warp device on which pictures are rendered.
        threads: Number of CPU threads.
    """

    def __init__(self, *, device: wp.Device, threads: int) -> None:
        self.device, self.threads = device, threads
        self._surfaces: LruCache[Surface] = LruCache(4)
        self._environments: LruCache[wd.Environment] = LruCache(2)
        self._skies: LruCache[wd.Environment] = LruCache(4)
        self._height_fields: LruCache[wd.HeightField] = LruCache(8)
        self._bases: LruCache[wd.Renderer] = LruCache(6)
        self._renderers: LruCache[wd.Renderer] = LruCache(8, _MOST_BYTES, _bytes_of)

    def surface(self, scene: Scene) -> Surface:
        """Return the prepared mesh of a scene."""
        tangents = dict(scene.options).get("tangents")
        key = str(scene.mesh), tangents
        return self._surfaces.get_or_make(key, lambda: page_bodies.surface_of(scene.mesh, tangents))

    def height_field(self, scene: Scene) -> wd.HeightField:
        """Return the height field of a scene."""
        call = scene.heightfield
        return self._height_fields.get_or_make(str(call), lambda: page_bodies.height_field_of(call))

    def lights(self, scene: Scene) -> list[Any]:
        """Return the light and the environment light of a scene. An unchanged environment light is the same object."""
        lights = [] if scene.light is None else [scene.light.make()]
        if (sky := scene.sky) is None:
            return lights

        def make() -> wd.Environment:
            options = dict(sky.options)
            settings = {name: options.pop(name) for name in _SKY_SETTINGS if name in options}
            bare = dataclasses.replace(sky, options=tuple(options.items()))
            made: wd.Environment = self._environments.get_or_make(str(bare), bare.make)
            return with_settings(made, **{name: getattr(made, name) for name in _SKY_SETTINGS} | settings)

        return [*lights, self._skies.get_or_make(str(sky), make)]

    def renderer(self, scene: Scene, view: wd.View, *, refine: bool, report: Callable[[], None]) -> wd.Renderer:
        """Return a renderer of a scene from the cache, or make it.

        Args:
            scene: Scene without its view.
            view: Camera, whose size is the size of the pictures.
            refine: Whether the renderer divides pixels into smaller cells until the colours meet the tolerance.
            report: Function that is called before a slow preparation.
        """
        key = str(scene.mesh), str(scene.surface), str(scene.options), *_illuminants(scene), scene.tolerance

        def make() -> wd.Renderer:
            base = self._bases.get_or_make(key, lambda: self._base(scene, report))
            return base.resized(view, refine=refine)

        return self._renderers.get_or_make((*key, refine, view.width, view.height), make)

    def _base(self, scene: Scene, report: Callable[[], None]) -> wd.Renderer:
        """Make a renderer of small pictures, from which renderers of any picture size are derived.

        The disk cache stores the plan of this renderer (method, number of wavelengths and so on), because planning
        requires seconds.
        """
        report()
        heightfield, surface, options = self.height_field(scene), self.surface(scene), scene.shading
        # A plan (method, number of wavelengths and so on) depends on the spectra of the lights, but not on their
        # directions. The simplified lights of an unrefined preview are therefore sufficient here.
        lights = self.lights(scene.at(None))
        options.pop("tangents", None)
        options |= {"device": self.device.alias, "threads": self.threads, "refine": False}
        view = page_bodies.framed(surface, 16, 12)
        if scene.dots:
            # A plan (method, number of wavelengths and so on) for a grating map depends on its dots, small rectangles
            # with one grating each. The cached plan of a single grating would not suffice.
            dots = wd.GratingMap(heightfield, **dict(scene.dots))
            return wd.Renderer(surface, dots, lights, view, tolerance=scene.tolerance, **options)
        made: list[wd.Renderer] = []

        def plan() -> dict[str, Any]:
            made.append(wd.Renderer(surface, heightfield, lights, view, tolerance=scene.tolerance, **options))
            # The viewer shows one height field on the whole mesh. The renderer therefore has a single plan (method,
            # number of wavelengths and so on), and not one plan per part of the mesh.
            return {"plan": cast("wd.Plan", made[0].plan).to_json()}

        # The viewer makes one plan (method, number of wavelengths and so on) for pictures with and without shadows,
        # because shadows do not change a plan.
        planned = tuple((name, value) for name, value in scene.options if name != "shadows")
        key = "plan", str(planned), *_illuminants(scene), scene.tolerance, heightfield.pitch_um, self.device.alias
        arrays = disk_cache.cached_on_disk(key, heightfield.heights_um, plan)
        if made:
            return made[0]
        return wd.Renderer(surface, heightfield, lights, view, plan=wd.Plan.from_json(str(arrays["plan"])), **options)


def _bytes_of(renderer: wd.Renderer) -> float:
    width, height = renderer.size
    return float(_BYTES_PER_PIXEL * width * height)


def _illuminants(scene: Scene) -> tuple[str, ...]:
    """Return texts that identify the spectra of a scene's lights, including those of an environment and its sun."""
    named = () if scene.light is None else (str(dict(scene.light.options).get("illuminant", "D65")),)
    # The spectra of an environment light depend on its image file. Those of a clear sky do not depend on the position
    # of the sun.
    paths = () if scene.sky is None else (operand for operand in scene.sky.operands if isinstance(operand, str))
    return named if scene.sky is None else (*named, scene.sky.function, *paths)
