"""Test cases of ``bench/dev/corpus.py`` that render pictures."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from bench.dev.corpus_inputs import (
    ABOVE,
    MEDIUM,
    SIDE,
    SIZE,
    SMALL,
    box,
    box_view,
    coated_metal,
    fingers,
    radiances,
    tube,
    tube_view,
    two_geometries,
)
from bench.dev.corpus_values import image_values, named
from bench.dev.public_names import wd

if TYPE_CHECKING:
    from collections.abc import Callable

    from bench.dev.corpus_values import Case, Values

# Methods that can sum over wavelength samples instead of using a colour table, which stores colours by scattering
# vector.
SAMPLED_METHODS = ("low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred")


def picture(
    body: Callable[[], Any], surface: Callable[[], Any], view: Any, lights: Any = ABOVE, **options: Any
) -> Case:
    """Return a test case that renders a body with a height field."""
    return lambda threads: image_values(
        wd.shade(body(), lights=lights, heightfield=surface(), view=view, threads=threads, **options)
    )


def tube_picture(lights: Any = ABOVE, view: Any = None, **options: Any) -> Case:
    """Return a test case that renders a tube with a synthetic height field of a snake's skin."""
    return picture(tube, fingers, view or tube_view(), lights, **options)


def sampled_picture(method: str) -> Case:
    """Return a test case that renders a small picture of the tube by integration over sampled wavelengths."""
    return tube_picture(
        method=method, integration="sampled", refine=False, footprint=False, view=tube_view(**SMALL), tolerance=3e-2
    )


def explicit_tangents(threads: int) -> Values:
    """Render a sphere, as a perfect mirror without masking, with explicit tangents instead of texture coordinates."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    tangents = np.cross([0.0, 1.0, 0.0], ball.vertices + np.array([1e-3, 0.0, 0.0]))
    view = wd.View((0.0, 0.5, 4.0), (0.0, 0.0, 0.0), **SIZE)
    grating = wd.gratings.blazed(2.5, 0.25)
    options = {"tangents": tangents, "ior": float("inf"), "masking": False, "shadows": False, "tolerance": 0.2}
    return image_values(wd.shade(ball, grating, ABOVE, view, threads=threads, **options))


def explicit_plan(threads: int) -> Values:
    """Render with given numerical settings: the library's own plan with two additional terms of the series.

    A plan has the numbers of a computation, such as wavelengths and terms of a series.
    """
    surface = fingers()
    plan = wd.plan(heightfield=surface, tolerance=3e-2, threads=threads)
    changed = dataclasses.replace(plan, terms=plan.terms + 2)
    return image_values(wd.shade(tube(), surface, ABOVE, tube_view(**MEDIUM), plan=changed, threads=threads))


def successive_pictures(threads: int) -> Values:
    """Render two pictures with the same renderer, with other lights and another camera in the second picture."""
    options = {"lights": ABOVE, "view": tube_view(), "tolerance": 3e-2, "threads": threads}
    renderer = wd.Renderer(tube(), heightfield=fingers(), **options)
    first = image_values(renderer.image())
    view = wd.View((0.4, 1.2, 2.0), (0.0, 0.0, 0.0), fov_y_deg=27.0, **SIZE)
    renderer.draw(lights=[SIDE, ABOVE], view=view)
    return first | named("second", image_values(renderer.image()))


def previews(threads: int) -> Values:
    """Collect a renderer's unfinished pictures (previews) at tolerances of 0.3 and 0.1, and the final picture."""
    renderer = wd.Renderer(tube(), fingers(), ABOVE, tube_view(**MEDIUM), tolerance=2e-2, threads=threads)
    completed: Values = {}

    def complete(tolerance: float) -> None:
        completed.update(named(f"{tolerance:g}", image_values(renderer.image())))

    renderer.draw(SIDE, previews={at: lambda at=at: complete(at) for at in (0.3, 0.1)})
    return completed | image_values(renderer.image())


def resized_renderer(threads: int) -> Values:
    """Render a smaller picture with the numerical settings (plan) and the tables of a larger picture."""
    renderer = wd.Renderer(tube(), fingers(), [ABOVE, SIDE], tube_view(), tolerance=1e-1, refine=False, threads=threads)
    return image_values(renderer.resized(tube_view(**MEDIUM), refine=True).image())


def sky_picture(*, with_sun: bool, **options: Any) -> Case:
    """Return a test case that renders the tube under a sky, with the sky as background."""

    def draw(threads: int) -> Values:
        sky = wd.Environment(radiances(with_sun=with_sun), rotation_deg=30.0, scale=0.7, directions=100)
        view = tube_view(width=16, height=12)
        image = wd.shade(tube(), fingers(), [sky, SIDE], view, tolerance=1e-1, threads=threads, **options)
        return image_values(image) | {"background": sky.background(view)}

    return draw


def loaded_sky(threads: int) -> Values:
    """Render the box under a sky from an EXR file. The tolerance determines the number of sky directions."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sky.exr"
        image = oiio.ImageOutput.create(str(path))
        image.open(str(path), oiio.ImageSpec(64, 32, 3, oiio.FLOAT))
        image.write_image(radiances(with_sun=True).astype(np.float32))
        image.close()
        sky = wd.Environment.load(path, rotation_deg=-75.0)
    view = box_view(**SMALL)
    return image_values(wd.shade(box(), fingers(), sky, view, tolerance=0.3, refine=False, threads=threads))


def materials_by_geometry(threads: int) -> Values:
    """Render a scene of a coated metal geometry and a dielectric geometry, under lights of different spectra."""
    materials = {"tube": coated_metal(), "box": wd.Material.dielectric(1.7)}
    lights = [ABOVE, wd.DirectionalLight((1.0, 1.0, 0.5), illuminant=wd.Spectrum.blackbody(2900.0))]
    image = wd.shade(
        two_geometries(), fingers(), lights, tube_view(), material=materials, tolerance=1e-1, layers=("geometry",),
        threads=threads,
    )  # fmt: skip
    return image_values(image)
