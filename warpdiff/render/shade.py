"""``shade``: a picture of a mesh whose surface carries a height field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import forks, memory, validation
from warpdiff.core.warnings import warn
from warpdiff.kernels import refinement_levels
from warpdiff.lights.environment import Environment, Light, lobes_of_sky
from warpdiff.lights.light_types import DirectionalLight, PointLight, lobes_of
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.planner.strategy import directions_of, plan_for, warn_outside
from warpdiff.render.layers import check_layers, layers_of
from warpdiff.render.picture import Picture, load_kernels
from warpdiff.request.evaluation import Request
from warpdiff.request.plan import AUTOMATIC, has_table
from warpdiff.scene.camera import View
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables import polar_grid
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    import contextlib
    from collections.abc import Callable, Collection, Mapping

    import warp as wp
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.image.image import Image
    from warpdiff.lights.light_types import Lobe
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.plan import Plan
    from warpdiff.scene.mesh_import import Surface


def shade(
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
    progress: Callable[[float], None] | None = None,
    layers: Collection[str] = (),
) -> Image:
    """Render a mesh whose surface carries a height field.

    A pixel is the sum over the lights of power · XYZ(ρ, illuminant), a ratio of radiances, with the pigment's share
    where the mesh has a base colour. The mesh is seen from both sides.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene``, or a path to a mesh file. Its unit has nothing to do with µm.
        heightfield: The height field; its x axis lies along the tangent field.
        light: One light, or several.
        view: The camera.
        tolerance: Error of XYZ against max(‖XYZ‖, 1e-3 · Y*), in 99 % of the lit pixels and of the bright ones (Y at
            least 1e-3 · Y*); Y* is the 99th percentile of Y, or its luminance-weighted median if that is larger.
        method: ``"auto"``, ``"low-rank"``, ``"power"``, ``"jacobi-anger"``, ``"taylor"``, ``"taylor-uncentred"``, or
            ``"direct"`` (float64, slow and certain).
        coherence: The window, source or copies; None is averaged with σ = 16.25 µm.
        ior: Index of refraction, > 1; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
            Pictures are relative to what it reflects at normal incidence.
        material: What the mesh is made of, in place of ``ior``, or a mapping from the names of its geometries, each
            with its material; pictures are then relative to a perfect mirror. Below metals no pigment is seen.
        masking: Whether V-cavity masking and shadowing is included, where ``energy`` is ``"stam"``.
        energy: ``"stam"``, or ``"normalised"``, in place of masking: times a(ωi) a(ωr), the factors of
            :func:`order_efficiencies` with which a perfect mirror sends back what comes in. In pictures they are the
            same at all wavelengths, which send it back together; ``image.plan`` says how far from that single ones are,
            which ``image.error`` leaves out. It takes two seconds or more, once for a surface.
        pigment: Strength of the base colour (texture, vertex colours or plain) that lies under the height field.
        shadows: Whether lights are hidden by the mesh itself.
        smooth: Whether vertex normals are interpolated; otherwise facets are seen.
        tangents: The direction of the height field's x at each vertex, world frame, shape (n, 3), or one for all,
            shape (3,); what of it lies in the surface counts. None takes it from the texture coordinates.
        footprint: Whether a pixel shows the mean over what its filter sees, a Gaussian (0.5 pixel, cut at 1.5), rather
            than the colour in its centre: no aliasing, no speckle of orders that fall between pixels. The mean is taken
            from a table with levels where there is one, otherwise from many points. None is on for an averaged window
            and for a source, and off for others and for ``"direct"``.
        samples_per_pixel: Rays a pixel; 1 is its centre. Without footprints they are points under the same filter. With
            footprints they are the least number of cells that each pixel is split into: 1, 4, 16, … 4,096. What
            lies between the centres of pixels, and is thinner than they are wide, takes 4 or more to be seen.
        refine: Whether pixels whose parts differ by more than the tolerance allows are split, again and again, up to
            4,096 cells, or 1,024 where ``tolerance`` is 0.05 or more. Otherwise a picture with footprints promises
            nothing: ``image.error`` estimates what it errs by.
        plan: An explicit plan in place of ``tolerance``, ``method`` and ``coherence``; implies ``strict=False``.
        strict: Raise where the tolerance cannot be met, rather than warn.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Threads on the CPU; None is one a core. The picture does not depend on it.
        progress: Called with the share that is done, 0 to 1, from whichever thread did it, one at a time.
        layers: What else is asked for: any of ``"normal"``, ``"depth"`` and ``"geometry"``, for ``image.layers``.

    Returns:
        The picture; ``image.plan`` says what was computed and why.

    Raises:
        ValueError: A bad argument, a mesh without area or tangents, a tolerance out of reach; the message names it.
        FileNotFoundError: ``mesh`` is a path to nothing.
        MemoryError: More memory than is free; the message says what fits.
    """
    layers = check_layers(layers)
    wanted = PictureRequest.checked(
        heightfield, light, view, tolerance=tolerance, method=method, coherence=coherence, ior=ior, material=material,
        masking=masking, energy=energy, pigment=pigment, shadows=shadows, smooth=smooth, footprint=footprint,
        samples_per_pixel=samples_per_pixel, refine=refine, plan=plan, strict=strict, device=device, threads=threads,
        progress=progress,
    )  # fmt: skip
    device, workers = wanted.request.device, wanted.request.threads
    load_kernels(device)
    with picture_memory(view):
        surface = prepare_surface(mesh, tangents=tangents)
        image = _drawn(wanted, surface, view, progress)
        if layers:
            told = layers_of(surface, view, layers, smooth=wanted.smooth, device=device, threads=workers)
            image = replace(image, layers=told)
    warn_unconverged(image.plan)
    return image


def _drawn(wanted: PictureRequest, surface: Surface, view: View, progress: Callable[[float], None] | None) -> Image:
    """The picture of a mesh that is ready, by a plan for what its pixels see."""
    request = wanted.request
    picture = wanted.frame(surface, view)
    wanted.set_lights(picture, wanted.lobes)
    if any(each.sky is not None for each in wanted.lobes):
        # From anywhere.
        direction_range, sample, count = directions_of(request)
    else:
        direction_range, count, sample = picture.measure_directions(request.heightfield, request.coherence)
    if request.plan is not None:
        warn_outside(request.plan, request.heightfield, direction_range)
    found = wanted.planned(direction_range, sample, count)
    if found.method == "direct":
        picture.sum_directly(request.heightfield, found, progress=progress)
    else:
        lookup = ColourLookup(
            request.heightfield, found, direction_range, device=request.device, threads=request.threads
        )
        picture.integrate(lookup, tolerance=found.tolerance, refine=wanted.refine, progress=progress)
    return picture.image(found)


# What a picture takes while it is made, as measured, of any kind.
_BYTES_PER_PIXEL = 210
# Points in a pixel: 256 by 256 settle whatever a picture can show, and more would be drawn for ever.
_MOST_SAMPLES = 2**16
# The share of the pixels that may err by more than the tolerance, and of those at edges by more than theirs.
_MOST_UNCONVERGED, _MOST_UNCONVERGED_EDGES = 0.01, 0.05


@dataclass(frozen=True)
class PictureRequest:
    """A checked request for pictures.

    Attributes:
        request: What it has in common with other requests.
        lights: One or several.
        pigment: Strength of the base colour.
        shadows: Whether the mesh may hide the lights.
        smooth: Whether vertex normals are interpolated.
        samples: Rays a pixel.
        refine: Whether pixels are split until they keep the tolerance.
    """

    request: Request
    lights: list[Light]
    pigment: float
    shadows: bool
    smooth: bool
    samples: int
    refine: bool

    @classmethod
    def checked(
        cls,
        heightfield: Any,
        light: Any,
        view: Any,
        *,
        pigment: Any,
        shadows: Any,
        smooth: Any,
        footprint: Any,
        samples_per_pixel: Any,
        refine: Any,
        **common: Any,
    ) -> PictureRequest:
        """Refuse what is no such thing, before anything is computed; ``common`` is as ``Request.checked`` has it."""
        request = Request.checked(heightfield, by_geometry=True, **common)
        lights = listed(light)
        lobes = lobes_for(lights, request, refine=validation.flag(refine, "refine"))
        validation.instance(view, View, "view")
        validation.flag(shadows, "shadows")
        validation.flag(smooth, "smooth")
        pigment = validation.number(pigment, "pigment", least=0.0)
        samples = validation.count(samples_per_pixel, "samples_per_pixel")
        if samples > _MOST_SAMPLES:
            raise ValueError(f"samples_per_pixel must be at most {_MOST_SAMPLES}, got {samples}")
        require_picture_memory(view, request.device)
        blurred = _takes_footprints(footprint, request)
        most = refinement_levels.rays_at(refinement_levels.MOST_LEVEL)
        if blurred and samples > most:
            raise ValueError(
                f"samples_per_pixel must be at most {most} where pixels show means, got {samples}; "
                "footprint=False takes more points"
            )
        check_light_sizes(lobes, request.coherence, means=blurred)
        plan = request.plan if request.plan is None else replace(request.plan, footprint=blurred)
        illuminated = IlluminatedMaterial.of(
            [name for each in lobes for name in each.illuminants], request.materials.values()
        )
        request = replace(request, plan=plan, footprint=blurred, illuminated=illuminated)
        return cls(request, lights, pigment, shadows, smooth, samples, refine)

    @forks.cached_property
    def lobes(self) -> list[Lobe]:
        """The lobes of the lights."""
        return lobes_for(self.lights, self.request, refine=self.refine)

    def frame(self, surface: Surface, view: View, **options: Any) -> Picture:
        """The arrays of a picture."""
        # Cells beyond its edge are in the filters of its outermost pixels.
        margin = int(self.request.footprint and (self.refine or self.samples > 1))
        return Picture(
            surface, view, smooth=self.smooth, samples=self.samples, means=self.request.footprint, margin=margin,
            materials_of_faces=self.materials_of_faces(surface), device=self.request.device,
            threads=self.request.threads, **options,
        )  # fmt: skip

    def materials_of_faces(self, surface: Surface) -> NDArray[np.int32] | None:
        """Which of several materials each face is of; None where there is one."""
        if "" in self.request.materials:
            return None
        named, known = surface.geometry_names, list(self.request.materials)
        if lacking := sorted(set(named) - set(known)) or sorted(set(known) - set(named)):
            raise ValueError(
                f"material must name each of the mesh's geometries, {', '.join(map(repr, sorted(set(named))))}, and no "
                f"others, got {', '.join(map(repr, known))}: see {lacking[0]!r}"
            )
        return np.array([known.index(name) for name in named], dtype=np.int32)[surface.geometries]

    def planned(self, direction_range: DirectionRange, sample: DirectionSample, count: float) -> Plan:
        """The plan that was given, or one for directions: one with a table where lights have a size.

        Where no table keeps the tolerance for single directions, lights have the best one, and skies, whose cells are
        wide, a small one.
        """
        request = self.request
        plan = request.plan or plan_for(request, direction_range, sample, count)
        if not plan.uses_footprints and any(each.has_extent for each in self.lobes):
            method = plan.method if has_table(plan.method, plan.coherence) else AUTOMATIC
            if any(each.deviations is not None for each in self.lobes):
                by_table = replace(request, plan=None, method=f"{method}/table", tolerance=plan.tolerance, strict=False)
                plan = plan_for(by_table, direction_range, sample, count)
            else:
                nodes, azimuths_per_width = (
                    polar_grid.smallest_sufficient_size(plan) or polar_grid.table_sizes(plan.coherence)[-1]
                )
                plan = replace(
                    plan, method=method, rings_per_octave=nodes, azimuths_per_width=azimuths_per_width, footprint=True
                )
        return request.with_energy(plan)

    def set_lights(self, picture: Picture, lights: list[Lobe]) -> None:
        """Set a picture's lights."""
        request, energy = self.request, self.request.energy_factors
        picture.set_lights(
            lights, request.coherence, request.heightfield.size_um[0] * request.heightfield.size_um[1],
            normal=request.normal_reflectance, materials=tuple(request.materials.values()), masking=request.masking,
            energy=None if energy is None else energy.values, pigment=self.pigment, shadows=self.shadows,
        )  # fmt: skip


def _takes_footprints(footprint: bool | None, request: Request) -> bool:
    """Whether pixels show means over what they see."""
    plan = request.plan
    method = request.method if plan is None else plan.method
    if footprint is not None:
        footprint = validation.flag(footprint, "footprint")
    if footprint and method == "direct":
        raise ValueError("footprint=True is not for method='direct', which sums single directions: use another method")
    if footprint is not None:
        return footprint
    return plan.footprint if plan is not None else request.coherence.adds_powers and method != "direct"


def require_picture_memory(view: View, device: wp.Device) -> None:
    """Refuse a picture that the host has no memory for."""
    if device.is_cpu:
        memory.require_memory(
            _BYTES_PER_PIXEL * view.width * view.height, f"a picture of {view.width} × {view.height} pixels",
            "take a view of at most {side} times the width and height",
        )  # fmt: skip


def picture_memory(view: View) -> contextlib.AbstractContextManager[None]:
    """A context that names the picture where memory for it fails."""
    remedy = "take a smaller view, mesh or heightfield, fewer samples_per_pixel, or a larger tolerance"
    return memory.as_memory_error(f"a picture of {view.width} × {view.height} pixels", remedy)


def warn_unconverged(plan: Plan) -> None:
    """Warn of a picture that does not keep its tolerance."""
    if plan.unconverged_share > _MOST_UNCONVERGED or plan.unconverged_edge_share > _MOST_UNCONVERGED_EDGES:
        warn(
            f"{100.0 * plan.unconverged_share:.2g} % of the lit pixels are expected to err by more than "
            f"tolerance={plan.tolerance:g}, and of those at edges {100.0 * plan.unconverged_edge_share:.2g} % by three times "
            "as much: see image.error, or render a larger picture, or look from closer, or give an Environment more "
            "directions, and its sun as a light of its own"
        )


def check_light_sizes(lights: Sequence[Lobe], window: Coherence, *, means: bool) -> None:
    """Refuse lights of a size where it is the coherence's, or where pixels show no means over directions."""
    if not any(each.has_extent for each in lights):
        return
    if window.kind == "source":
        raise ValueError(
            "light: angular_diameter_deg is given beside coherence of kind='source', whose size is that of all lights: "
            "give one of them"
        )
    if not (means and window.adds_powers):
        raise ValueError(
            f"light: angular_diameter_deg, or an Environment, takes footprints, which pictures of coherence "
            f"{window.kind!r} lack, or which footprint=False or method='direct' leaves out: give several lights of "
            "angular_diameter_deg=0"
        )


def listed(light: Any) -> list[Any]:
    """One or several lights as a list."""
    lights = [light] if isinstance(light, Light) else light
    if not isinstance(lights, Sequence) or not lights:
        raise TypeError(
            "light must be a DirectionalLight, a PointLight, an Environment, or a non-empty sequence of them, got "
            f"{light!r}"
        )
    return list(lights)


def lobes_for(lights: Sequence[Any], request: Request, *, refine: bool) -> list[Lobe]:
    """The lobes of lights, which are checked.

    Where pictures are not refined, which are turned by hand, a disc is one of them if it can be.
    """
    window = request.coherence
    tolerance = request.tolerance if request.plan is None else request.plan.tolerance
    result: list[Lobe] = []
    for index, each in enumerate(lights):
        if isinstance(each, Environment):
            if window.kind != "averaged" or window.sigma_um is None:
                raise ValueError(
                    f"light[{index}]: an Environment takes coherence of kind='averaged', got kind={window.kind!r}"
                )
            result += lobes_of_sky(each, window.sigma_um, tolerance)
            continue
        if not isinstance(each, PointLight):
            validation.instance(each, DirectionalLight, f"light[{index}]")
        colorimetry.check_illuminant(each.illuminant, f"light[{index}].illuminant")
        result += lobes_of(each, window.sigma_um, single_lobe=not refine)
    return result
