"""Grating maps: pictures must equal those of meshes with one part per dot, and refinement must find edges of dots.

A grating map is an array of small rectangles (dots). All dots have the same height field; each dot turns it and scales
its depth and pitch. The reference is a mesh with one part per dot, each with its own height field. Refinement divides
pixels into subpixel cells.
"""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest
import trimesh
from grating_maps import LIGHT, VIEW, card, error_of, parts_of

import warpdiff as wd
from warpdiff.render import device_tiles
from warpdiff.render.picture_inputs import PictureInputs
from warpdiff.request.settings import PictureSettings
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables.pitch_ladder import PitchLadder

SINE = wd.gratings.sinusoidal(1.2, 0.15, samples=32)
FINGERS = wd.gratings.fingers(size_um=6.4, pitch_um=0.1)
WIDE_SOURCE = wd.Coherence("source", angular_diameter_deg=4.0)


def _map(cell: wd.HeightField, shape: tuple[int, int], *, seed: int = 0, pitch: bool = True) -> wd.GratingMap:
    """Return a grating map with gratings (dots) that differ in direction, depth and pitch.

    Dots are small rectangles of a surface, each with a grating.

    Most dots diffract light of ``LIGHT`` into ``VIEW``.
    """
    rng = np.random.default_rng(seed)
    turn = rng.uniform(85.0, 95.0, shape) if cell is SINE else rng.uniform(0.0, 360.0, shape)
    scale = rng.uniform(0.75, 1.3, shape) if pitch else 1.0
    return wd.GratingMap(cell, turn_deg=turn, depth_scale=rng.uniform(0.3, 1.0, shape), pitch_scale=scale)


@pytest.mark.parametrize(
    ("cell", "coherence"),
    [
        (SINE, WIDE_SOURCE),
        (FINGERS, wd.Coherence("source", angular_diameter_deg=3.0)),
        (FINGERS, wd.Coherence(sigma_um=5.0)),
        (FINGERS, wd.Coherence("centred")),
        (FINGERS, wd.Coherence("replicas", periods=(2, 2))),
    ],
    ids=["1-D source", "source", "averaged", "centred", "periods"],
)
def test_a_map_equals_one_part_per_dot(cell: wd.HeightField, coherence: wd.Coherence) -> None:
    """Dots (gratings) of a map must have the colours of mesh parts with turned tangents and scaled height fields.

    A grating map divides a surface into small rectangles (dots), each with a turned and scaled copy of one grating.
    """
    grating_map = _map(cell, (3, 4), pitch=coherence.kind == "source")
    options: dict[str, Any] = {"coherence": coherence, "tolerance": 1e-2, "footprint": False, "ior": np.inf}
    image = wd.shade(card(), grating_map, LIGHT, VIEW, **options)
    scene, surfaces, tangents = parts_of(grating_map, coherence)
    parts = wd.shade(scene, surfaces, LIGHT, VIEW, tangents=tangents, **options)
    # Both pictures sum over nearly the same wavelengths. The errors of these sums are therefore equal, and cancel in
    # the difference.
    assert np.percentile(error_of(image, parts.xyz), 99.0) < 1e-3


@pytest.mark.parametrize("cell", [SINE, FINGERS], ids=["1-D", "2-D"])
@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((3, 4), {"integration": "sampled", "tolerance": 0.05}),
        ((3, 4), {"integration": "table", "tolerance": 0.1}),
        ((1, 2), {"integration": "table", "tolerance": 0.1}),
    ],
    ids=["sampled", "tables", "two pitches"],
)
def test_pitches_differ_under_an_averaged_window(
    cell: wd.HeightField, shape: tuple[int, int], options: dict[str, Any]
) -> None:
    """Colours that are interpolated between windows of different widths must equal those of one part per dot."""
    coherence = wd.Coherence(sigma_um=4.0)
    grating_map = _map(cell, shape, seed=4)
    ladder = PitchLadder.of(grating_map.pitch_scale, coherence, options["tolerance"])
    assert len(ladder.octaves) == (2 if shape == (1, 2) else {0.05: 10, 0.1: 9}[options["tolerance"]])
    options = {"coherence": coherence, "footprint": False, "strict": False, "ior": np.inf} | options
    image = wd.shade(card(), grating_map, LIGHT, VIEW, **options)
    scene, surfaces, tangents = parts_of(grating_map, coherence)
    parts = wd.shade(scene, surfaces, LIGHT, VIEW, tangents=tangents, **options)
    # With the coherence window of the largest dot for all dots, the median error would be above 0.1.
    assert np.percentile(error_of(image, parts.xyz), 99.0) < options["tolerance"]
    assert isinstance(image.plan, wd.Plan)
    assert image.plan.coherence == coherence
    assert bool(image.plan.rings_per_octave) == (options["integration"] == "table")


@pytest.mark.parametrize("pitch", [False, True])
def test_footprints_are_turned_and_scaled(pitch: bool) -> None:
    """Means over footprints of pixels must equal those of a mesh with one part per dot.

    A dot is a small rectangle of a grating map, with one grating. A footprint is the range of scattering vectors that a
    pixel covers.
    """
    coherence = wd.Coherence(sigma_um=5.0)
    # Colours of twelve pitch scales are interpolated between nine tables.
    grating_map = _map(FINGERS, (3, 4), pitch=pitch)
    options: dict[str, Any] = {"coherence": coherence, "tolerance": 0.05, "refine": False, "ior": np.inf}
    image = wd.shade(card(), grating_map, LIGHT, VIEW, **options)
    assert isinstance(image.plan, wd.Plan)
    assert image.plan.uses_footprints
    scene, surfaces, tangents = parts_of(grating_map, coherence)
    parts = wd.shade(scene, surfaces, LIGHT, VIEW, tangents=tangents, **options)
    errors = error_of(image, parts.xyz)
    assert np.median(errors) < 0.01
    assert np.percentile(errors, 95.0) < 0.05


@pytest.mark.parametrize(
    ("cell", "coherence", "shape"),
    [(SINE, WIDE_SOURCE, (3, 4)), (FINGERS, wd.Coherence(sigma_um=5.0), (3, 4)), (SINE, WIDE_SOURCE, (9, 12))],
    ids=["source", "averaged", "small dots"],
)
def test_refinement_finds_the_edges_of_dots(
    cell: wd.HeightField, coherence: wd.Coherence, shape: tuple[int, int]
) -> None:
    """A refined picture must equal one with 1,024 subpixel cells per pixel, also at edges of dots (gratings).

    Dots are the small rectangles of a grating map, each with one grating. If they are few, the reference has no map,
    but a mesh with one part per dot.
    """
    grating_map = _map(cell, shape, pitch=coherence.kind == "source")
    options: dict[str, Any] = {"coherence": coherence, "strict": False, "ior": np.inf}
    image = wd.shade(card(), grating_map, LIGHT, VIEW, tolerance=0.05, **options)
    many = options | {"tolerance": 1e-2, "samples_per_pixel": 1024, "refine": False}
    if shape == (3, 4):
        scene, surfaces, tangents = parts_of(grating_map, coherence)
        exact = wd.shade(scene, surfaces, LIGHT, VIEW, tangents=tangents, **many)
    else:
        exact = wd.shade(card(), grating_map, LIGHT, VIEW, **many)
    errors = error_of(image, exact.xyz)
    assert np.percentile(errors, 97.0) < 0.05
    inside = image.illuminated & (image.coverage > 0.999)
    assert np.mean(errors <= image.error[inside] + 1e-3) > 0.9


def test_bright_dots_beside_dark_ones_are_found() -> None:
    """Pixels next to bright dots (gratings) of a grating map must be accurate.

    Dots are small rectangles of a surface. The filter of a pixel extends beyond the next pixel, so that bright dots
    there contribute to dark pixels.
    """
    rng = np.random.default_rng(2)
    turns, depths = rng.uniform(0.0, 360.0, (6, 8)), rng.choice([0.0, 1.0], (6, 8), p=[0.7, 0.3])
    grating_map = wd.GratingMap(FINGERS, turn_deg=turns, depth_scale=depths)
    options: dict[str, Any] = {"coherence": wd.Coherence(sigma_um=5.0), "strict": False}
    view = dataclasses.replace(VIEW, width=40, height=30)
    image = wd.shade(card(), grating_map, LIGHT, view, tolerance=0.05, **options)
    exact = wd.shade(card(), grating_map, LIGHT, view, tolerance=1e-2, samples_per_pixel=256, **options)
    assert np.percentile(error_of(image, exact.xyz), 97.0) < 0.05


def test_the_border_of_a_map_does_not_depend_on_coordinates_of_other_parts() -> None:
    """A map repeats only if its own part has texture coordinates beyond 0 to 1.

    If it repeated, subpixel cells at the border would contain light of the dots on the opposite side.
    """
    grating_map = wd.GratingMap(SINE, turn_deg=90.0, depth_scale=np.array([[1.0, 0.0, 0.0, 0.0]]))
    surfaces = {"map": wd.Surface(grating_map, coherence=WIDE_SOURCE), "other": None}
    pictures = []
    for most in (1.0, 1.5):
        scene = trimesh.Scene()
        for name, left, to in (("map", 0.0, 1.0), ("other", 1.2, most)):
            part = card(left=left, right=left + 1.0)
            part.visual.uv = to * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
            scene.add_geometry(part, geom_name=name, node_name=name)
        image = wd.shade(scene, surfaces, LIGHT, VIEW, samples_per_pixel=16, refine=False, strict=False, tolerance=0.1)
        pictures.append(image.xyz)
    assert pictures[0].max() > 0.0
    np.testing.assert_array_equal(*pictures)


def test_default_coherence_of_maps_is_a_source() -> None:
    options: dict[str, Any] = {"tolerance": 0.1, "strict": False, "footprint": False}
    grating_map = wd.GratingMap(SINE, turn_deg=90.0)
    image = wd.shade(card(), grating_map, LIGHT, VIEW, **options)
    assert isinstance(image.plan, wd.Plan)
    assert image.plan.coherence == wd.Coherence("source")
    # The coherence of a grating map is a light source by default. A map must not change the coherence of other
    # surfaces. The colours of a picture are relative to a perfect mirror; the coherence must not change this reference
    # either.
    scene, _, _ = parts_of(wd.GratingMap(SINE, turn_deg=[[0.0, 0.0]]), wd.Coherence())
    surfaces = {"dot 0 0": grating_map, "dot 0 1": SINE}
    image = wd.shade(scene, surfaces, LIGHT, VIEW, **options)
    assert {key: plan.coherence.kind for key, plan in image.plan.items()} == {
        "dot 0 0": "source", "dot 0 1": "averaged",
    }  # fmt: skip
    # The plan (method, number of wavelengths and so on) of a picture with a grating map must be accepted in a second
    # call of ``shade``, and must give the same picture.
    again = wd.shade(scene, surfaces, LIGHT, VIEW, plan=image.plan, footprint=False)
    np.testing.assert_array_equal(again.xyz, image.xyz)


def test_maps_of_several_parts_are_independent() -> None:
    """Each part of a mesh must have its own grating map, and a part without a map must not be affected.

    A grating map divides a surface into small rectangles with one grating each.
    """
    scene, _, tangents = parts_of(wd.GratingMap(SINE, turn_deg=np.zeros((1, 3))), wd.Coherence())
    fields = [_map(FINGERS, (3, 4), pitch=False), _map(FINGERS, (2, 5), seed=1, pitch=False), FINGERS]
    options: dict[str, Any] = {"tolerance": 0.01, "footprint": False, "coherence": wd.Coherence(sigma_um=5.0)}
    surfaces = {f"dot 0 {column}": field for column, field in enumerate(fields)}
    image = wd.shade(scene, surfaces, LIGHT, VIEW, tangents=tangents, **options)
    # First and last column of pixels of each mesh part in the picture, one pixel inside of the edges of the part.
    half = VIEW.width / VIEW.height * 4.0 * np.tan(np.radians(6.0))
    edges = (np.linspace(-0.5, 0.5, 4) / half + 1.0) * VIEW.width / 2.0
    for index, (key, field) in enumerate(surfaces.items()):
        alone = wd.shade(scene, {"*": None, key: field}, LIGHT, VIEW, tangents=tangents, **options)
        columns = slice(int(edges[index]) + 2, int(edges[index + 1]) - 1)
        own, exact = image.xyz[6:-6, columns], alone.xyz[6:-6, columns]
        assert np.max(np.abs(own - exact)) < 0.02 * np.max(exact)
        assert np.max(exact) > 0.0


def test_renderers_of_maps_draw_the_pictures_of_shade_and_can_be_pickled() -> None:
    grating_map = _map(SINE, (3, 4))
    options: dict[str, Any] = {"tolerance": 0.1, "strict": False, "coherence": WIDE_SOURCE}
    renderer = wd.Renderer(card(), grating_map, LIGHT, VIEW, **options)
    first = renderer.image()
    exact = wd.shade(card(), grating_map, LIGHT, VIEW, **options | {"tolerance": 1e-2})
    assert np.percentile(error_of(first, exact.xyz), 95.0) < 0.1
    copy = pickle.loads(pickle.dumps(renderer))  # noqa: S301 (made here)
    np.testing.assert_array_equal(copy.image().xyz, first.xyz)


def test_the_device_algorithms_draw_the_same_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """The algorithms for GPUs, run on the CPU, must find the same dots (gratings) and edges as those for the CPU.

    Dots are the small rectangles of a grating map, each with one grating.
    """
    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 1 << 15)
    grating_map, view = _map(SINE, (3, 4)), VIEW
    settings = PictureSettings(tolerance=0.1, coherence=WIDE_SOURCE, strict=False, device="cpu")
    inputs = PictureInputs.of(grating_map, LIGHT, view, settings)
    surface = prepare_surface(card())
    pictures = []
    for device_driven in (False, True):
        picture = inputs.picture(surface, view, device_driven=device_driven)
        picture.set_lights(inputs.parts)
        plans, lookups = inputs.planned(None)
        picture.render(lookups, tolerance=0.1)
        pictures.append(inputs.image(picture, plans))
    errors = error_of(pictures[1], pictures[0].xyz)
    assert np.percentile(errors, 95.0) < 1e-2


@pytest.mark.parametrize(
    ("mesh", "options", "message"),
    [
        (card(uvs=False), {"tangents": (1.0, 0.0, 0.0)}, "mesh must have texture coordinates for a GratingMap.*unwrap"),
        (card(uvs=False), {}, "mesh must have texture coordinates for a GratingMap, but it has faces without: unwrap"),
        (card(), {"method": "direct"}, "method must not be 'direct' with a GratingMap.*give another method"),
        (card(), {"energy": "normalised"}, "energy must not be 'normalised' with a GratingMap.*give 'stam'"),
        (card(), {"wavelengths_nm": [500.0]}, "wavelengths_nm must not be given with a GratingMap.*omit it"),
        (
            card(),
            {"coherence": wd.Coherence("centred")},
            "coherence must be of kind 'source' or 'averaged' for a GratingMap .*from 0.8 to 1.2, got 'centred': give",
        ),
        (card(), {"coherence": wd.Coherence("replicas", periods=(2, 2))}, "got 'replicas'"),
    ],
)
def test_unsupported_options_have_one_clear_error(mesh: Any, options: dict[str, Any], message: str) -> None:
    grating_map = wd.GratingMap(SINE, pitch_scale=[[0.8, 1.2]])
    with pytest.raises(ValueError, match=message):
        wd.shade(mesh, grating_map, LIGHT, VIEW, **options)


@pytest.mark.parametrize(
    ("scale", "remedy"), [(100.0, "or give a larger tolerance"), (1000.0, "reduce it, or flatten the cell$")]
)
def test_errors_of_deep_dots_name_the_depth_scale(scale: float, remedy: str) -> None:
    grating_map = wd.GratingMap(SINE, depth_scale=scale)
    with pytest.raises(ValueError, match=f"depth_scale must be smaller.* got up to {scale:g} .*{remedy}") as error:
        wd.shade(card(), grating_map, LIGHT, VIEW, tolerance=0.1)
    assert "direct" not in str(error.value)
    assert "levelled" not in str(error.value)


def test_texture_coordinates_may_be_absent_where_there_is_no_map() -> None:
    scene = card(uvs=True, right=0.5).scene()
    scene.add_geometry(card(uvs=False, left=0.5), geom_name="plain", node_name="plain")
    name = next(key for key in scene.geometry if key != "plain")
    surfaces = {name: wd.GratingMap(SINE, turn_deg=90.0), "plain": SINE}
    options: dict[str, Any] = {"tolerance": 0.1, "strict": False, "footprint": False, "tangents": (1.0, 0.0, 0.0)}
    wd.shade(scene, surfaces, LIGHT, VIEW, **options)
    surfaces = {name: SINE, "plain": wd.GratingMap(SINE, turn_deg=90.0)}
    with pytest.raises(ValueError, match="2 faces of 'plain' have none"):
        wd.shade(scene, surfaces, LIGHT, VIEW, **options)
    with pytest.raises(ValueError, match="parts with a GratingMap require texture coordinates: unwrap them"):
        wd.shade(scene, surfaces, LIGHT, VIEW, **options | {"tangents": None})


def test_metals_reflect_less_at_oblique_angles() -> None:
    """A grating map on a metal must have the colours of a mesh with one part per dot (grating).

    Dots are the small rectangles of the map. The colour tables of the mesh parts contain the metal's reflectance at
    each angle. The table of the map has one spectrum for all angles, so that the spectrum must change little with the
    angle.
    """
    coherence, light = wd.Coherence(sigma_um=5.0), wd.DirectionalLight((0.3, 1.5, 1.0))
    grating_map = _map(FINGERS, (3, 4), pitch=False)
    options: dict[str, Any] = {"tolerance": 1e-2, "footprint": False, "material": wd.Material.metal("Cr")}
    image = wd.shade(card(), grating_map, light, VIEW, coherence=coherence, **options)
    scene, surfaces, tangents = parts_of(grating_map, coherence)
    parts = wd.shade(scene, surfaces, light, VIEW, tangents=tangents, coherence=coherence, **options)
    errors = error_of(image, parts.xyz)
    # The reflectance spectrum of chromium changes by 2e-3 between 0° and 35°, and its luminance changes by 1 %.
    assert np.percentile(errors, 99.0) < 4e-3
    with pytest.raises(ValueError, match="material must have a spectrum that changes with the angle by at most"):
        wd.shade(card(), grating_map, light, VIEW, **options | {"material": wd.Material.metal("Au")})
