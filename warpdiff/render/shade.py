"""``shade``: a picture of a mesh whose surface carries a height field."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Unpack

from warpdiff.core.progress import Progress, reporter
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ref
from warpdiff.planner.strategy import directions_of
from warpdiff.render.layers import layers_of
from warpdiff.render.picture import load_kernels
from warpdiff.render.picture_inputs import PictureInputs, picture_memory
from warpdiff.request.settings import SinglePictureSettings
from warpdiff.request.signatures import accepts
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables.lookup import ColourLookup, Lookups

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from warpdiff.image.image import Image
    from warpdiff.lights.base import Light
    from warpdiff.render.picture_inputs import SurfacesOfMesh
    from warpdiff.request.keywords import SinglePictureKeywords
    from warpdiff.request.plan import Plan
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface


@accepts(SinglePictureSettings)
def shade(
    mesh: Any, heightfield: SurfacesOfMesh, lights: Light | Sequence[Light], view: View, *, progress: Progress = None,
    **settings: Unpack[SinglePictureKeywords],
) -> Image:  # fmt: skip
    """Render a mesh whose surface carries a height field.

    A pixel is the sum over the lights of power · XYZ(ρ, illuminant), a ratio of radiances. Where the mesh has a base
    colour, the light of the pigment is added. The mesh is visible from both sides.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene``, or the path of a mesh file. Mesh units are arbitrary and
            independent of µm. ``copy()`` of trimesh drops the normals of a mesh; ``copy(include_cache=True)`` keeps
            them.
        heightfield: The height field; its x axis lies along the tangent field. For several surfaces, a mapping from
            parts of the mesh to height fields, to :class:`warpdiff.Surface`, or to None for a plain, matte surface with
            the mesh's base colour. A part is the name of a geometry or of a material, both as ``"geometry/material"``,
            or ``"*"`` for the rest.
        lights: One light, or several.
        view: Camera and size of the picture.
        progress: Callable that gets the share that is done, 0 to 1, from any thread, one call at a time; True shows a
            bar. An exception that it raises cancels the picture.

    Returns:
        The picture; ``image.plan`` states what was computed and why. With several surfaces it is a mapping from parts
        to plans, and colours are relative to a perfect mirror under ``coherence``.

    Raises:
        ValueError: A bad argument, or a mesh without area or tangents; the message names it.
        ToleranceError: The tolerance cannot be met, and ``strict`` is True.
        FileNotFoundError: The mesh file does not exist.
        MemoryError: More memory than is free; the message states what fits.

    Examples:
        This picture is so small that it does not meet its tolerance:

        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> wd.shade(body, grating, light, view, tolerance=0.1)
        Image(32 × 18 pixels, 21 % illuminated, estimated error 3.2 at the 99th percentile)
    """
    checked = SinglePictureSettings(**settings)
    inputs = PictureInputs.of(heightfield, lights, view, checked)
    progress = reporter(progress, "shade")
    device, threads = inputs.evaluation.device, inputs.evaluation.threads
    load_kernels(device)
    with picture_memory(view):
        surface = prepare_surface(mesh, tangents=checked.tangents)
        image = _render(inputs, surface, view, progress)
        if checked.layers:
            layers = tuple(checked.layers)
            image = replace(
                image, layers=layers_of(surface, view, layers, smooth=checked.smooth, device=device, threads=threads)
            )
    warn_unconverged(image)
    if image.mask.any() and not image.illuminated.any():
        warn(
            f"none of the {ref('lights')} illuminates a visible point of the mesh, so that all pixels are black: check "
            f"{ref('to_light')}, which points from the surface towards the light, and {ref('view')}"
        )
    return image


def _render(inputs: PictureInputs, surface: Surface, view: View, progress: Callable[[float], None] | None) -> Image:
    """Render a prepared mesh, after choosing a plan for the directions that the pixels of each surface require."""
    picture = inputs.picture(surface, view)
    picture.set_lights(inputs.parts)
    plans: list[Plan] = []
    lookups: list[ColourLookup | None] = []
    for index, own in enumerate(inputs.surfaces.values()):
        if own.is_plain:
            lookups.append(None)
            continue
        count: float
        if all(part.has_lobes for part in own.parts):
            direction_range, sample, count = picture.measure_directions(own.evaluation.heightfield, index)
        else:
            # Light from a sky comes from the whole hemisphere, so that the plan must cover all directions.
            direction_range, sample, count = directions_of(own.evaluation)
        plans.append(own.planned(direction_range, sample, count))
        lookups.append(own.lookup(plans[-1], direction_range))
    if plans[0].method == "direct":
        picture.render_directly(inputs.evaluation.heightfield, plans[0], progress=progress)
    else:
        picture.render(Lookups(lookups), tolerance=min(plan.tolerance for plan in plans), progress=progress)
    return inputs.image(picture, plans)


def warn_unconverged(image: Image) -> None:
    """Warn if too many pixels of a picture are expected to exceed its tolerance."""
    report = image.report
    if report is not None and not report.is_converged:
        warn(
            f"{100.0 * report.unconverged_share:.2g} % of the illuminated pixels are expected to exceed "
            f"{ref('tolerance', report.tolerance)}, and {100.0 * report.unconverged_edge_share:.2g} % of those at "
            "edges to exceed three times the tolerance: see image.error; render a larger picture, or move the camera "
            "closer"
        )
