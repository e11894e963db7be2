"""Checks of grating maps before a picture is computed, and the coherence (how far light interferes) of their surfaces.

A grating map divides a surface into small rectangles (dots). Each dot has its own rotation, depth and pitch of one
grating.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ToleranceError, ref
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.fixed_reflectance import spectral_change
from warpdiff.optics.materials import Material
from warpdiff.request.plan import Plan
from warpdiff.scene.mesh_import import HOW_TO_GET_TANGENTS
from warpdiff.tables.pitch_ladder import PitchLadder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from numpy.typing import NDArray

    from warpdiff.heightfield.grating_map import GratingMap
    from warpdiff.lights.surface_optics import SurfaceOptics
    from warpdiff.request.evaluation import Evaluation
    from warpdiff.request.settings import PictureSettings
    from warpdiff.scene.mesh_import import Surface as Mesh


def settings_of_map(grating_map: GratingMap, settings: PictureSettings) -> PictureSettings:
    """Check the options of a surface with a grating map, and return them with a coherence that suits the map.

    If neither a coherence nor a plan is given, the coherence is ``Coherence("source")``.

    Raises:
        ValueError: An option is not supported for grating maps.
    """
    method = settings.plan.method if isinstance(settings.plan, Plan) else settings.method
    refused = {
        "method": "direct" if method == "direct" else None,
        "energy": "normalised" if settings.energy == "normalised" else None,
        "wavelengths_nm": getattr(settings, "wavelengths_nm", None),
    }
    remedies = {
        "method": "give another method",
        "energy": "give 'stam'",
        "wavelengths_nm": "omit it, or give the height field of one dot instead of the map",
    }
    for name, value in refused.items():
        if value is not None:
            raise ArgumentValueError(
                f"{ref(name)} must not be {_text(value)} with a GratingMap, which is not supported: {remedies[name]}"
            )
    if settings.coherence is None and settings.plan is None:
        settings = replace(settings, coherence=Coherence("source"))
    kind = settings.effective_coherence.kind
    if kind not in ("source", "averaged") and not grating_map.has_one_pitch:
        low, high = float(grating_map.pitch_scale.min()), float(grating_map.pitch_scale.max())
        raise ArgumentValueError(
            f"{ref('coherence')} must be of kind 'source' or 'averaged' for a GratingMap whose {ref('pitch_scale')} "
            f"differs between dots, from {low:g} to {high:g}, got {kind!r}: give one of these, or one pitch scale"
        )
    if not grating_map.has_one_shape:
        _check_materials(settings)
    return settings


def ladder_of(grating_map: GratingMap | None, evaluation: Evaluation) -> PitchLadder | None:
    """Return the ladder of tables for dots with different pitch scales; None if one table serves all dots.

    A grating map divides a surface into small rectangles (dots). Colours of a dot are interpolated between the tables
    of a ladder, which are made for several lengths of the coherence window.
    """
    if grating_map is None or grating_map.has_one_pitch or evaluation.coherence.kind != "averaged":
        return None
    tolerance = evaluation.tolerance if evaluation.plan is None else evaluation.plan.tolerance
    return PitchLadder.of(grating_map.pitch_scale, evaluation.coherence, tolerance)


def coherence_of_table(grating_map: GratingMap, evaluation: Evaluation) -> Coherence:
    """Return the coherence of the table of a map. With a ladder of tables, it is that of the longest window.

    A grating map divides a surface into small rectangles (dots). A ladder is a set of tables for several lengths of the
    coherence window.
    """
    ladder = ladder_of(grating_map, evaluation)
    if ladder is None:
        return grating_map.table_coherence(evaluation.coherence)
    return ladder.coherences[0]


def _check_materials(settings: PictureSettings) -> None:
    """Raise an error for materials whose spectrum changes with the angle by more than the tolerance."""
    materials = settings.material.values() if isinstance(settings.material, Mapping) else [settings.material]
    tolerance = settings.plan.tolerance if isinstance(settings.plan, Plan) else settings.tolerance
    for material in materials:
        if isinstance(material, Material) and (change := spectral_change(material)) > tolerance:
            raise ArgumentValueError(
                f"{ref('material')} must have a spectrum that changes with the angle by at most {ref('tolerance')} "
                f"for a GratingMap whose {ref('depth_scale')} or {ref('pitch_scale')} differs between dots, got "
                f"{material} with a change of {change:.2g} for {ref('tolerance', tolerance)}: give a larger "
                f"{ref('tolerance')}, {ref('ior')}, or a map of {ref('turn_deg')} alone"
            )


def _text(value: object) -> str:
    return repr(value) if isinstance(value, str) else "given"


def check_texture_coordinates(
    mesh: Mesh, optics: Iterable[SurfaceOptics], surface_of_faces: NDArray[np.int32] | None
) -> None:
    """Raise an error if a face of a surface with a grating map has no texture coordinates.

    Args:
        mesh: The prepared mesh.
        optics: Optics of the surfaces.
        surface_of_faces: Index of each face's surface, shape (m,); None if all faces have the same surface.
    """
    if mesh.lacks_uvs is None:
        return
    for index, surface in enumerate(optics):
        faces = mesh.lacks_uvs if surface_of_faces is None else mesh.lacks_uvs & (surface_of_faces == index)
        if surface.grating_map is not None and faces.any():
            name = mesh.geometry_names[mesh.geometries[int(np.argmax(faces))]]
            raise ArgumentValueError(
                f"{ref('mesh')} must have texture coordinates for a GratingMap, but {int(np.count_nonzero(faces))} "
                f"faces of {name!r} have none: unwrap the mesh, or give one height field instead of a map"
            )


@contextlib.contextmanager
def naming_depth_scale(grating_map: GratingMap | None) -> Iterator[None]:
    """Context in which errors about the height range of a map's deepest dot name the argument ``depth_scale``.

    A grating map divides a surface into small rectangles (dots), each with a depth of its own.
    """
    try:
        yield
    except ArgumentValueError as error:
        if grating_map is None or "height range" not in str(error):
            raise
        depth, range_um = float(grating_map.depth_scale.max()), grating_map.cell.height_range_um
        limit, remedy = "", ""
        if isinstance(error, ToleranceError):
            limit, remedy = f" for this {ref('tolerance')}", f", or give a larger {ref('tolerance')}"
        raise type(error)(
            f"{ref('depth_scale')} must be smaller{limit}, got up to {depth:g} for a cell with a height range of "
            f"{range_um:.3g} µm, which makes dots of {depth * range_um:.3g} µm: reduce it, or flatten the cell{remedy}"
        ) from None


@contextlib.contextmanager
def naming_texture_coordinates(has_map: Collection[bool]) -> Iterator[None]:
    """Context in which errors about a mesh without tangents state that grating maps require texture coordinates.

    ``has_map`` states for each surface of the mesh whether it has a grating map.
    """
    try:
        yield
    except ArgumentValueError as error:
        if HOW_TO_GET_TANGENTS not in error.marked or not any(has_map):
            raise
        if all(has_map):
            raise ArgumentValueError(
                f"{ref('mesh')} must have texture coordinates for a GratingMap, but it has faces without: unwrap the "
                "mesh, or give one height field instead of a map"
            ) from None
        raise ArgumentValueError(
            f"{error.marked}; parts with a GratingMap require texture coordinates: unwrap them"
        ) from None
