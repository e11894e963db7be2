"""Scenes of the charts. Times, errors and previews of a scene are those of the pixels of one picture of it."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import warpdiff as wd
from bench import inputs
from warpdiff import meshes
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.lights.surface_optics import SurfaceOptics
from warpdiff.optics import reflectance_factors
from warpdiff.render.picture import Picture
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

# Refractive index of the surfaces of all scenes.
IOR = 1.5
# Width of the pictures whose pixels are timed [pixels].
WIDTH = 960
# Number of illuminated pixels of a frame. The time per frame is estimated as the time per pixel times this number.
FRAME_PIXELS = 150_000


class Directions(NamedTuple):
    """Directions to the light, scattering vectors (u, v, w), both (n, 3), and geometry factors (gains), (n,)."""

    to_lights: np.ndarray
    scattering_vectors: np.ndarray
    gains: np.ndarray

    def subset(self, count: int) -> Directions:
        """Return at most ``count`` of the directions, at equal steps in the list of all directions."""
        chosen = np.linspace(0, len(self.gains) - 1, min(count, len(self.gains))).astype(int)
        return Directions(*(array[chosen] for array in self))


@dataclass(frozen=True, eq=False)
class Scene:
    """A body with a height field, under one light.

    Attributes:
        name: Name in files.
        title: Title in charts.
        make: Function that returns a new object of the height field, for which the library has cached nothing.
        mesh: Mesh of the body.
        light: Light.
        eye, target, fov_y_deg: Position, target and vertical field of view [degrees] of the camera, as three
            attributes.
        coherences: Limits of interference (coherence windows or sources) in the charts of the scene.
    """

    name: str
    title: str
    make: Callable[[], wd.HeightField]
    mesh: Any
    light: wd.DirectionalLight
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_y_deg: float
    coherences: tuple[wd.Coherence, ...]

    @functools.cached_property
    def heightfield(self) -> wd.HeightField:
        """Height field of the scene. All accesses return the same object."""
        return self.make()

    def view(self, width: int) -> wd.View:
        """Return the camera for a picture of ``width`` pixels."""
        return wd.View(self.eye, self.target, fov_y_deg=self.fov_y_deg, width=width, height=3 * width // 4)

    def directions(self, coherence: wd.Coherence, width: int = WIDTH) -> tuple[Directions, np.ndarray]:
        """Return the directions of the illuminated pixels of a picture, and the indices of these pixels (n,)."""
        return directions(self.mesh, self.light, self.view(width), self.heightfield, coherence)


def directions(
    mesh: Any, light: wd.DirectionalLight, view: wd.View, heightfield: wd.HeightField, coherence: wd.Coherence
) -> tuple[Directions, np.ndarray]:
    """Return the directions of the illuminated pixels of a picture, and the indices of these pixels (n,)."""
    optics = SurfaceOptics(coherence, 1.0, reflectance_factors.normal_reflectance(IOR))
    picture = Picture(prepare_surface(mesh), view, [optics], device=resolve_device(None), threads=resolve_threads(None))
    picture.set_lights(light.parts(coherence, single_lobe=True, name="light"))
    picture.measure_directions([heightfield])
    scattering_vectors, to_lights, gains = picture.sampler.directions()
    illuminated = np.flatnonzero(gains > 0.0)
    return Directions(
        np.float64(to_lights[illuminated]), scattering_vectors[illuminated], np.float64(gains[illuminated])
    ), illuminated


def scenes(data: Path | None) -> list[Scene]:
    """Return all scenes. A synthetic grating with nano-fingers replaces the scan if its file is absent."""
    tube = meshes.tube(segments_along=128, segments_around=64)
    on_tube: dict[str, Any] = {
        "mesh": tube, "light": wd.DirectionalLight((0.1, 0.9, 1.2)), "eye": (0.0, 1.6, 3.1), "target": (0.0, 0.0, 0.0),
        "fov_y_deg": 27.0,
    }  # fmt: skip
    on_disc: dict[str, Any] = {
        "mesh": meshes.disc(), "light": wd.DirectionalLight((0.15, 0.9, 1.0)), "eye": (0.0, -1.9, 2.3),
        "target": (0.0, -0.05, 0.0), "fov_y_deg": 40.0,
    }  # fmt: skip
    averaged, centred = wd.Coherence(), wd.Coherence("centred")
    source = wd.Coherence("source", angular_diameter_deg=0.53)

    def fingers() -> wd.HeightField:
        return wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=2)

    def disc() -> wd.HeightField:
        # The patch of the synthetic disc is 64 µm long, about as long as the measured scan. In a shorter patch, the
        # coherence window would contain several repetitions of the same pits.
        return wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08)

    measured = inputs.scan(data)
    result = [
        Scene(
            "fingers", "synthetic fingers, 25.6 µm", fingers, **on_tube,
            coherences=(averaged,) if measured else (averaged, centred, source),
        ),
        Scene("disc", "compact disc, 64 µm", disc, **on_disc, coherences=(averaged,)),
    ]  # fmt: skip
    if measured:
        skin = functools.partial(measured.levelled, order=2)
        result.insert(0, Scene("skin", "scan of skin, 65 µm", skin, **on_tube, coherences=(averaged, centred, source)))
    return result
