"""Function ``shade``, which renders a picture of a mesh whose surface carries a height field."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from warpdiff.core.progress import Progress, reporter
from warpdiff.core.threads import subprogress
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.render.layers import LIGHT, directed, expanded, layers_of, lights_of, names_of
from warpdiff.render.map_inputs import naming_texture_coordinates
from warpdiff.render.picture import load_kernels
from warpdiff.render.picture_inputs import PictureInputs, picture_memory
from warpdiff.render.spectral_pictures import check_pigment, check_spectral, spectra_of
from warpdiff.request.settings import SinglePictureSettings
from warpdiff.request.signatures import accepts
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import NDArray

    from warpdiff.image.image import Image
    from warpdiff.lights.base import Light, LightPart
    from warpdiff.render.picture_inputs import SurfacesOfMesh
    from warpdiff.request.keywords import SinglePictureKeywords
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface


@accepts(SinglePictureSettings)
def shade(
    mesh: Any, heightfield: SurfacesOfMesh, lights: Light | Sequence[Light], view: View, *, progress: Progress = None,
    **settings: Unpack[SinglePictureKeywords],
) -> Image:  # fmt: skip
    """Render a mesh whose surface carries a height field.

    The colour of a pixel is the sum over the lights of power · XYZ(ρ, illuminant), where the relative reflectance ρ is
    a ratio of radiances. Where the mesh has a base colour, the light of the pigment is added. The mesh is visible from
    both sides.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene``, or the path of a mesh file. Mesh units are arbitrary and
            independent of µm. ``copy()`` of trimesh drops the normals of a mesh; ``copy(include_cache=True)`` keeps
            them.
        heightfield: The height field; its x axis lies along the tangent field. For several surfaces, a mapping from
            parts of the mesh to height fields, to :class:`warpdiff.Surface`, or to None for a plain surface with the
            mesh's base colour, metallic, roughness and emission. A part is the name of a geometry or of a material,
            both as ``"geometry/material"``, or ``"*"`` for all parts that no other key names.
        lights: One light, or several.
        view: Camera and size of the picture.
        progress: Callable that gets the finished fraction, 0 to 1, from any thread, one call at a time; True shows a
            bar. An exception that it raises cancels the picture.

    Returns:
        The picture; ``image.plan`` states what was computed and why. With several surfaces it is a mapping from parts
        to plans, and colours are relative to a perfect mirror under ``coherence``.

    Raises:
        ValueError: An argument is not accepted, or a mesh has no area or no tangents; the message names it.
        ToleranceError: The tolerance cannot be met, and ``strict`` is True.
        FileNotFoundError: The mesh file does not exist.
        MemoryError: The picture requires more memory than is free; the message states what fits.

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
    request = LayerRequest.of(checked.layers, inputs)
    spectral = None
    if checked.wavelengths_nm is not None:
        spectral = replace(inputs.evaluation, wavelengths_nm=np.asarray(checked.wavelengths_nm))
        check_spectral(spectral, inputs.parts, view)
        if len(inputs.surfaces) > 1:
            raise ArgumentValueError(
                f"{ref('wavelengths_nm')} must not be given for several surfaces, got the parts "
                f"{', '.join(map(repr, inputs.surfaces))}: give one {ref('heightfield')}"
            )
    progress = reporter(progress, "shade")
    load_kernels(inputs.evaluation.device)
    with picture_memory(view):
        with naming_texture_coordinates(inputs.has_map):
            surface = prepare_surface(mesh, tangents=checked.tangents, plain=inputs.plain)
        if spectral is not None:
            (own,) = inputs.surfaces.values()
            check_pigment(own.settings.pigment, has_base_colour=surface.has_base_colour)
        colours = progress if spectral is None else subprogress(progress, 0.0, _PROGRESS_OF_COLOURS)
        image = request.added_to(_render(inputs, surface, view, colours, request), inputs, surface, view)
        if spectral is not None:
            picture = inputs.picture(surface, view)
            picture.set_lights(inputs.parts)
            spectra = spectra_of(picture, spectral, subprogress(progress, _PROGRESS_OF_COLOURS, 1.0))
            image = replace(image, spectra=spectra, wavelengths_nm=spectral.wavelengths_nm)
    warn_unconverged(image)
    if image.mask.any() and not image.illuminated.any():
        warn(
            f"none of the {ref('lights')} illuminates a visible point of the mesh, so that all pixels are black: check "
            f"{ref('to_light')}, which points from the surface towards the light, and {ref('view')}"
        )
    return image


@dataclass(frozen=True)
class LayerRequest:
    """Layers (additional arrays) of a picture that the caller requested, after checks against its lights.

    Attributes:
        names: Names of the layers. If there is one layer per light, its name includes the index of the light.
        parts: For each light, the parts that are rendered one after the other; empty if no layer shows the colours
            under a single light.
        directed: Parts with a single direction that a layer shows, one for each light of ``layers.lights_of``.
    """

    names: tuple[str, ...]
    parts: tuple[list[LightPart], ...]
    directed: tuple[LightPart, ...]

    @classmethod
    def of(cls, names: Collection[str], inputs: PictureInputs) -> LayerRequest:
        """Check the names of layers against the inputs of the picture, before any kernel runs.

        A layer is an additional array of a picture, such as the depths of its pixels.
        """
        every = expanded(tuple(names), inputs.lights, inputs.parts)
        apart = any(name.partition(".")[0] == LIGHT for name in every)
        of_light = [inputs.parts_of_light(index) for index in range(len(inputs.lights) * apart)]
        directions = [directed(inputs.parts_of_light(index), name) for index, name in lights_of(every).items()]
        return cls(every, tuple(of_light), tuple(directions))

    def added_to(
        self, rendered: tuple[Image, list[NDArray[np.float32]]], inputs: PictureInputs, surface: Surface, view: View
    ) -> Image:
        """Return a picture with its layers.

        Args:
            rendered: Picture, and its colours under each part of ``parts``.
            inputs: Inputs of the picture.
            surface: The prepared mesh.
            view: Camera of the picture.
        """
        image, xyz_by_part = rendered
        if not self.names:
            return image
        colours = iter(xyz_by_part)
        computed: dict[str, NDArray[Any]] = {
            f"{LIGHT}.{index}": sum((next(colours) for _ in parts[1:]), next(colours))
            for index, parts in enumerate(self.parts)
        }
        of_points = [name for name in self.names if name not in computed]
        if of_points:
            points = inputs.of_points(self.directed).picture(surface, view)
            points.set_lights(self.directed)
            computed |= layers_of(points, of_points)
        layers = {name: computed[name] for name in self.names}
        return replace(image, layers=layers, names=names_of(surface, self.names))


def _render(
    inputs: PictureInputs, surface: Surface, view: View, progress: Callable[[float], None] | None, request: LayerRequest
) -> tuple[Image, list[NDArray[np.float32]]]:
    """Render a prepared mesh, after choosing plans for the directions that occur on each of its surfaces.

    A plan holds the numbers of a computation, such as wavelengths. The second result has the colours under each part of
    ``request.parts``.
    """
    parts = [part for of_light in request.parts for part in of_light]
    xyz_by_part: list[NDArray[np.float32]] = []
    if parts:
        inputs = replace(inputs, parts=parts)
    picture = inputs.picture(surface, view)
    picture.set_lights(inputs.parts)
    # Light from a sky comes from the whole hemisphere. Plans (numbers of computations) must then cover all directions,
    # and none are measured.
    has_sky = not all(part.has_lobes for part in inputs.parts)
    plans, lookups = inputs.planned(None if has_sky else picture.measure_directions(inputs.heightfields))
    collected = xyz_by_part if parts else None
    if plans[0].method == "direct":
        picture.render_directly(inputs.evaluation.heightfield, plans[0], progress=progress, xyz_by_part=collected)
    else:
        tolerance = min(plan.tolerance for plan in plans)
        picture.render(lookups, tolerance=tolerance, progress=progress, xyz_by_part=collected)
    return inputs.image(picture, plans), xyz_by_part


# Fraction of the work for a spectral picture [0 to 1] that is reported as finished when its colours are complete. Other
# values would change only the display of the progress.
_PROGRESS_OF_COLOURS = 0.5


def warn_unconverged(image: Image) -> None:
    """Warn if too many pixels of a picture are expected to exceed its tolerance."""
    report = image.report
    if report is not None and not report.is_converged:
        warn(
            f"{100.0 * report.unconverged_share:.2g} % of the illuminated interior pixels are expected to exceed "
            f"{ref('tolerance', report.tolerance)}, and {100.0 * report.unconverged_edge_share:.2g} % of those at "
            "edges to exceed three times the tolerance: see image.error; render a larger picture, or move the camera "
            "closer"
        )
