"""``shade``: pictures compared with a reference in float64, and properties that every picture must have."""

import dataclasses
import math
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh
from conftest import relative_errors, slow
from endurance import count
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

import warpdiff as wd
from bench.truth import pixel_reference, reference
from warpdiff import meshes
from warpdiff.scene.mesh_import import prepare_surface

PIXELS = 160
SNAKE_LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))
ABOVE = wd.DirectionalLight((0.0, 0.0, 1.0))
FLAT = wd.HeightField(np.zeros((4, 4)), 0.05)
WHITE = np.array([0.950423, 1.0, 1.088610])
SHORT = wd.Coherence("averaged", 3.0)
# Coherence window that is much wider than the patch. Diffraction orders are then narrow, and directions between orders
# receive only the tails of the orders' Gaussian lobes.
LONG = wd.Coherence("averaged", 16.25)


@pytest.fixture(scope="module")
def fingers():
    return wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=2)


@pytest.fixture(scope="module")
def small_fingers():
    """Return a surface like ``fingers`` with a quarter of its samples, because a direct sum over all would be slow."""
    return wd.gratings.fingers(size_um=3.2, pitch_um=0.09, seed=2)


@pytest.fixture(scope="module")
def snake():
    return meshes.tube(segments_along=64, segments_around=32)


def snake_view(width=96, height=72):
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=width, height=height)


def judge(mesh, heightfield, light, view, coherence, tolerances, *, pixels):
    """Return the errors of pictures at several tolerances, in ``pixels`` random pixels that cover the mesh evenly."""
    body = pixel_reference.Body.of(prepare_surface(mesh))
    result, truth, chosen = [], None, None
    for tolerance in tolerances:
        image = wd.shade(mesh, heightfield, light, view, tolerance=tolerance, coherence=coherence, footprint=False)
        if truth is None:
            chosen = pixel_reference.stratified(image.mask, pixels)
            given = body, heightfield, [light], view, chosen, coherence.kind, coherence.sigma_um
            truth = pixel_reference.reference_picture(*given, tolerance=min(tolerances))
        sure = ~truth.unsure
        np.testing.assert_array_equal(truth.hit[sure], image.mask.ravel()[chosen][sure])
        result.append(pixel_reference.picture_error(image.xyz.reshape(-1, 3)[chosen], truth))
    return result


TOLERANCES = (1e-1, 1e-2, 1e-3)
GRAZING_LIGHT = wd.DirectionalLight((0.9, 0.6, 0.2))


@pytest.mark.parametrize(
    ("kind", "sigma_um"), [("averaged", 16.25), ("centred", 3.0), slow("averaged", 3.0), slow("centred", 16.25)]
)
def test_pictures_are_within_their_tolerance(kind, sigma_um, snake, fingers):
    errors = judge(snake, fingers, SNAKE_LIGHT, snake_view(), wd.Coherence(kind, sigma_um), TOLERANCES, pixels=PIXELS)
    for tolerance, error in zip(TOLERANCES, errors, strict=True):
        print(f"{kind}, σ = {sigma_um:g} µm, tolerance {tolerance:g}: {error}")  # noqa: T201
        assert error.illuminated > 0.8 * PIXELS
        # Colours with a luminance below the floor f, a fraction of the luminance of the highlight, count as dark. The
        # highlight of the tube is so bright that most pixels are dark, but some pixels must be brighter than f.
        assert error.share_below < 0.99
        assert error.p99 <= tolerance
        assert error.below <= tolerance


def test_dim_pixels_of_sharp_orders_are_within_their_tolerance(snake, fingers):
    errors = judge(snake, fingers, GRAZING_LIGHT, snake_view(), LONG, TOLERANCES, pixels=PIXELS)
    assert all(error.below <= tolerance for tolerance, error in zip(TOLERANCES, errors, strict=True))


def mirror_view(size=9, extent=0.5):
    return wd.View.orthographic((0, 0, 2), (0, 0, 0), extent_y=extent, width=size, height=size)


def whole_disc(radius=1.0):
    return meshes.disc(inner_radius=0.0, outer_radius=radius, segments=32, rings=3)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3])
def test_a_flat_mirror_is_white(tolerance):
    image = wd.shade(whole_disc(), FLAT, ABOVE, mirror_view(), ior=math.inf, tolerance=tolerance)
    assert image.mask.all()
    error = np.linalg.norm(image.xyz - WHITE, axis=2) / np.linalg.norm(WHITE)
    assert error.max() <= tolerance


def test_the_illuminant_changes_the_white():
    for name in ("A", "D50"):
        light = wd.DirectionalLight((0, 0, 1), illuminant=name)
        image = wd.shade(whole_disc(), FLAT, light, mirror_view(), footprint=False)
        white = reference.products(name).sum(axis=0)
        np.testing.assert_allclose(image.xyz, np.broadcast_to(white, image.xyz.shape), rtol=1e-5)


@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
def test_the_colours_of_several_lights_add_up(snake, fingers):
    lights = [
        SNAKE_LIGHT,
        wd.DirectionalLight((-1.0, 0.7, 0.6), illuminant="A", power=0.4),
        wd.DirectionalLight((1.0, 0.2, 0.3), power=2.5),
    ]
    view = snake_view(48, 36)
    options = {"coherence": SHORT, "tolerance": 0.1}
    # All pictures use the same plan (method, number of wavelengths and so on). With separate plans, the wavelengths
    # would depend on the lights of each picture.
    together = wd.shade(snake, fingers, lights, view, **options)
    alone = [wd.shade(snake, fingers, light, view, plan=together.plan) for light in lights]
    # A picture with one light is refined until it meets the tolerance. With several lights, only the sum must meet the
    # tolerance, so that the picture differs slightly from the sum of the pictures.
    expected = sum(image.xyz for image in alone)
    np.testing.assert_array_equal(together.illuminated, expected[..., 1] > 0.0)
    away = relative_errors(together.xyz[together.illuminated], expected[together.illuminated])
    assert np.percentile(away, 99.0) < 0.1
    assert np.median(away) < 0.01
    doubled = wd.shade(snake, fingers, dataclasses.replace(lights[1], power=0.8), view, plan=together.plan)
    np.testing.assert_allclose(doubled.xyz, 2.0 * alone[1].xyz, rtol=1e-6)
    dark = wd.shade(snake, fingers, dataclasses.replace(lights[1], power=0.0), view, plan=together.plan)
    assert not dark.xyz.any()


@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
def test_a_light_below_the_horizon_adds_nothing(fingers):
    view = wd.View((0.3, -1.5, 2.0), (0, 0, 0), width=24, height=18)
    for to_light in ((0.3, 0.1, -1.0), (1.0, 0.0, 0.0), (0.2, 0.4, -1e-9)):
        image = wd.shade(whole_disc(), fingers, wd.DirectionalLight(to_light), view, coherence=SHORT)
        assert image.mask.any()
        assert not image.xyz.any()


def test_both_sides_are_visible(fingers):
    """The back of a disc must be rendered like its front: colours from behind must equal the float64 reference."""
    light, eye = np.array([0.3, 0.2, 0.9]), np.array([0.4, -0.5, 2.0])
    flip = np.array([1.0, 1.0, -1.0])
    images = [
        wd.shade(
            whole_disc(), fingers, wd.DirectionalLight(light * side), coherence=SHORT, footprint=False,
            view=wd.View(eye * side, (0, 0, 0), up=(1, 0, 0), width=25, height=25),
        )
        for side in (1.0, flip)
    ]  # fmt: skip
    assert images[1].xyz[images[1].mask][:, 1].min() > 0.0
    pixels = np.arange(25 * 25)
    body = pixel_reference.Body.of(prepare_surface(whole_disc()))
    behind = wd.View(eye * flip, (0, 0, 0), up=(1, 0, 0), width=25, height=25)
    lights = [wd.DirectionalLight(light * flip)]
    truth = pixel_reference.reference_picture(body, fingers, lights, behind, pixels, "averaged", 3.0, tolerance=1e-2)
    error = pixel_reference.picture_error(images[1].xyz.reshape(-1, 3), truth)
    assert error.p99 <= 1e-2
    assert error.below <= 1e-2


def two_discs():
    upper = whole_disc(0.3).apply_translation([0.0, 0.0, 0.6])
    return trimesh.Scene([whole_disc(), upper])


def test_shadows_equal_those_of_brute_force():
    view = wd.View((0.0, -2.0, 1.6), (0, 0, 0.2), width=40, height=30)
    light = wd.DirectionalLight((0.3, 0.2, 1.0))
    # With a short coherence window, all view directions receive diffracted light, so that only shadows are black.
    options = {"coherence": wd.Coherence("averaged", 0.3), "footprint": False}
    shadowed = wd.shade(two_discs(), FLAT, light, view, **options)
    open_ = wd.shade(two_discs(), FLAT, light, view, shadows=False, plan=shadowed.plan)
    body, pixels = pixel_reference.Body.of(prepare_surface(two_discs())), np.arange(40 * 30)
    truth = pixel_reference.reference_picture(body, FLAT, [light], view, pixels, "averaged", 0.3, tolerance=1e-2)
    sure, illuminated = (a.reshape(30, 40) for a in (~truth.unsure, truth.illuminated))
    black = shadowed.xyz[..., 1] == 0.0
    np.testing.assert_array_equal(black[sure & shadowed.mask], ~illuminated[sure & shadowed.mask])
    assert np.count_nonzero(black & shadowed.mask) > 40
    assert np.all(open_.xyz[..., 1][open_.mask] > 0.0)
    np.testing.assert_array_equal(open_.xyz[~black], shadowed.xyz[~black])


def spherical(subdivisions=3):
    """Return an icosphere with separate corners for each face, and spherical texture coordinates without a seam."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    corners = ball.vertices[ball.faces.ravel()]
    u = np.arctan2(corners[:, 1], corners[:, 0]).reshape(-1, 3) / (2.0 * np.pi)
    u = u - np.round(u - u[:, :1])
    uv = np.stack([u.ravel(), np.arcsin(np.clip(corners[:, 2], -1, 1)) / np.pi + 0.5], axis=1)
    faces = np.arange(len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners, faces, visual=TextureVisuals(uv=uv), process=False)


def test_a_convex_body_needs_no_shadow_rays(fingers):
    view = wd.View((2.0, 1.5, 1.0), (0, 0, 0), width=48, height=40)
    light = wd.DirectionalLight((0.2, 1.0, 0.6))
    images = [wd.shade(spherical(), fingers, light, view, shadows=on, coherence=SHORT) for on in (True, False)]
    np.testing.assert_array_equal(images[0].xyz, images[1].xyz)
    assert prepare_surface(spherical()).is_convex


def test_the_background_is_black_and_unmasked(snake, fingers):
    image = wd.shade(snake, fingers, SNAKE_LIGHT, snake_view(), coherence=SHORT)
    assert image.xyz.shape == (72, 96, 3)
    assert image.xyz.dtype == np.float32
    assert image.mask.dtype == bool
    assert 0.05 < image.mask.mean() < 0.6
    np.testing.assert_array_equal(image.coverage > 0.0, image.mask)
    assert not image.xyz[~image.mask].any()
    alone = wd.shade(snake, fingers, SNAKE_LIGHT, snake_view(), coherence=SHORT, refine=False)
    np.testing.assert_array_equal(alone.coverage, alone.mask)
    away = wd.shade(snake, fingers, SNAKE_LIGHT, wd.View((0, 2, 0), (0, 4, 0), up=(1, 0, 0), width=8, height=6))
    assert not away.mask.any()
    assert not away.xyz.any()


@pytest.mark.parametrize("samples", [1, 3])
def test_pictures_are_the_same_bit_for_bit(samples, snake, fingers):
    # The picture has more pixels than the slice that one thread renders at a time, so that several threads render it.
    view = snake_view(96, 72)
    options = {"coherence": SHORT, "samples_per_pixel": samples}
    first = wd.shade(snake, fingers, SNAKE_LIGHT, view, threads=1, **options)
    for threads in (1, 2, 5, None):
        again = wd.shade(snake, fingers, SNAKE_LIGHT, view, threads=threads, **options)
        np.testing.assert_array_equal(again.xyz, first.xyz)
        np.testing.assert_array_equal(again.coverage, first.coverage)


def test_many_samples_per_pixel_change_only_the_rim():
    """With 16 samples per pixel, only pixels at the rim of the mesh may be partly covered.

    The mean colour must be that with one sample per pixel.
    """
    disc = whole_disc()
    view = wd.View((0.5, -1.2, 2.2), (0, 0, 0), fov_y_deg=60.0, width=64, height=48)
    # With a short coherence window, a flat surface reflects light into one broad lobe (range of directions), so that
    # colours change little within a pixel.
    options = {"coherence": wd.Coherence("averaged", 0.4), "tolerance": 1e-3, "footprint": False}
    light = wd.DirectionalLight((-0.3, 0.6, 1.2))
    one = wd.shade(disc, FLAT, light, view, **options)
    many = wd.shade(disc, FLAT, light, view, samples_per_pixel=16, **options)
    partial = (many.coverage > 0.0) & (many.coverage < 1.0)
    assert many.coverage.min() == 0.0
    assert many.coverage.max() == 1.0
    np.testing.assert_allclose(16.0 * many.coverage, np.round(16.0 * many.coverage), atol=1e-6)
    # The filter has a radius of 1.5 pixels, so pixels more than two pixels from the rim of the mesh are completely
    # inside or outside.
    inside, outside = one.mask.copy(), ~one.mask
    for shift in np.ndindex(5, 5):
        moved = np.roll(one.mask, (shift[0] - 2, shift[1] - 2), axis=(0, 1))
        inside &= moved
        outside &= ~moved
    assert partial.any()
    assert not np.any(partial & (inside | outside))
    assert np.all(many.coverage[inside] == 1.0)
    np.testing.assert_array_equal(many.mask, many.coverage > 0.0)
    assert not many.xyz[many.coverage == 0.0].any()
    ratio = many.xyz[inside][:, 1] / one.xyz[inside][:, 1]
    assert abs(ratio.mean() - 1.0) < 5e-3
    assert np.abs(ratio - 1.0).max() < 0.1


TEXTURE = np.array([[[230, 40, 20], [10, 200, 90]], [[30, 60, 250], [255, 255, 255]]], np.uint8)


def textured_quad(texture=TEXTURE):
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    uv = np.array([[0.1, -0.3], [1.3, -0.3], [1.3, 0.9], [0.1, 0.9]])
    visual = TextureVisuals(uv=uv, material=SimpleMaterial(image=Image.fromarray(texture)))
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


@pytest.mark.parametrize(("sigma_um", "ior", "illuminant"), [(16.25, 1.5, "D65"), (4.0, 2.2, "A")])
def test_pigment_follows_its_formula(sigma_um, ior, illuminant, fingers):
    view = wd.View((0.4, -1.6, 2.0), (0, 0, 0), width=16, height=12)
    light = wd.DirectionalLight((0.5, 0.8, 1.0), illuminant=illuminant, power=1.7)
    quad = textured_quad()
    options = {"coherence": wd.Coherence("averaged", sigma_um), "ior": ior, "tolerance": 1e-3, "footprint": False}
    bare, half, whole = (wd.shade(quad, fingers, light, view, pigment=p, **options).xyz for p in (0.0, 0.5, 1.0))
    body = pixel_reference.Body.of(prepare_surface(quad), TEXTURE)
    given = body, fingers, [light], view, np.arange(16 * 12), "averaged", sigma_um
    truth = [pixel_reference.reference_picture(*given, tolerance=1e-3, ior=ior, pigment=p) for p in (0.0, 1.0)]
    under = (truth[1].xyz - truth[0].xyz).reshape(12, 16, 3)
    # The pigment's colour is the difference of two float32 pictures. Its error includes their rounding errors, which
    # are proportional to the brighter picture.
    np.testing.assert_allclose(whole - bare, under, rtol=2e-4, atol=1e-7 * bare.max() + 1e-6 * under.max())
    np.testing.assert_allclose(half - bare, (whole - bare) / 2.0, rtol=1e-4, atol=2e-7 * bare.max())
    error = pixel_reference.picture_error(whole.reshape(-1, 3), truth[1])
    assert error.p99 <= 1e-3
    plain = quad.copy()
    plain.visual = TextureVisuals(uv=quad.visual.uv)
    np.testing.assert_array_equal(wd.shade(plain, fingers, light, view, **options).xyz, bare)


def test_pigment_is_filtered_with_the_picture():
    """The light from the pigment, a part of a pixel's colour, must not depend on the number of samples per pixel."""
    quad = textured_quad(np.full((2, 2, 3), 180, np.uint8))
    view = mirror_view(6, 1.0)
    light = wd.DirectionalLight((0.5, 0.3, 1.0))
    one, many = (wd.shade(quad, FLAT, light, view, samples_per_pixel=n, coherence=LONG).xyz for n in (1, 8))
    assert one.min() > 0.0
    np.testing.assert_allclose(many, one, rtol=1e-5)


def test_tangents_rotate_the_height_field(fingers):
    """A rotation of the tangents by 90° about the normal must equal a rotation of the height field by 90°."""
    disc = whole_disc()
    view = wd.View((0.3, -0.8, 2.0), (0, 0, 0), width=40, height=30)
    count = len(disc.vertices)
    # With the tangent along +y, the x-axis of the height field is along +y, and its y-axis along −x.
    rotated = wd.HeightField(np.rot90(fingers.heights_um, -1), fingers.pitch_um)
    options = {"coherence": SHORT, "tolerance": 3e-4, "refine": False}
    light = wd.DirectionalLight((0.1, 0.4, 1.0))
    along_x, along_y = ([[1.0, 0.0, 0.0]] * count, [[0.0, 1.0, 0.0]] * count)
    first = wd.shade(disc, fingers, light, view, tangents=along_y, **options).xyz
    second = wd.shade(disc, rotated, light, view, tangents=along_x, **options).xyz
    np.testing.assert_allclose(first, second, rtol=1e-3, atol=1e-6 * first.max())
    other = wd.shade(disc, fingers, light, view, tangents=along_x, **options).xyz
    assert np.abs(other - first).max() > 0.1 * first.max()


def test_each_face_of_a_flat_mirror_has_one_colour():
    """With ``smooth=False``, each face of a flat mirror must have a single colour in an orthographic view."""
    tube = meshes.tube(bend_deg=0.0, segments_along=12, segments_around=6)
    view = wd.View.orthographic((0.0, 3.0, 0.6), (0, 0, 0), up=(1, 0, 0), extent_y=2.0, width=40, height=120)
    options = {"coherence": wd.Coherence("averaged", 0.3), "shadows": False, "refine": False}
    facets, smooth = (wd.shade(tube, FLAT, SNAKE_LIGHT, view, smooth=s, **options) for s in (False, True))
    np.testing.assert_array_equal(facets.mask, smooth.mask)
    colours = {tuple(c) for c in np.round(np.log(facets.xyz[facets.mask][:, :1].astype(np.float64) + 1e-30), 3)}
    assert len(colours) <= len(tube.faces)
    assert len({tuple(c) for c in np.round(np.log(smooth.xyz[smooth.mask][:, :1] + 1e-30), 3)}) > 2 * len(colours)


@pytest.mark.parametrize("kind", ["averaged", slow("centred")])
def test_the_direct_method_agrees_with_the_automatic_one(kind, snake, small_fingers):
    view = wd.View((0.0, 0.5, 1.1), (0.0, 0.0, 0.0), fov_y_deg=14.0, width=8, height=6)
    options = {"coherence": wd.Coherence(kind, 3.0), "tolerance": 1e-2, "footprint": False}
    auto = wd.shade(snake, small_fingers, SNAKE_LIGHT, view, **options)
    exact = wd.shade(snake, small_fingers, SNAKE_LIGHT, view, method="direct", **options)
    assert exact.plan.method == "direct"
    assert auto.mask.sum() > 20
    np.testing.assert_array_equal(auto.mask, exact.mask)
    assert np.percentile(relative_errors(auto.xyz[auto.mask], exact.xyz[auto.mask]), 99.0) <= 1e-2


BODIES = {
    "tube": (meshes.tube(segments_along=64, segments_around=32), snake_view(32, 24)),
    "disc": (meshes.disc(segments=64, rings=4), wd.View((0.0, -1.9, 2.3), (0, 0, 0), width=32, height=24)),
    "ball": (spherical(2), wd.View((2.0, 1.5, 1.0), (0, 0, 0), width=32, height=24)),
    "bottle": (None, wd.View((0.2, 0.42, 0.2), (0, 0, 0.11), up=(0, 0, 1), fov_y_deg=27.0, width=24, height=32)),
}


@pytest.mark.parametrize("name", BODIES)
def test_illuminated_pixels_are_finite_and_positive(name, request):
    """Pixels in shadow must be black, and illuminated pixels must have a finite colour above 0.

    A pixel counts as illuminated if light and eye are above the surface by its interpolated normal and by its face
    normal.
    """
    mesh, view = BODIES[name]
    mesh = mesh or request.getfixturevalue("fuze_path")
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.09, seed=2)
    # The coherence window is as short as the finger-like bumps of the surface, so that diffraction orders overlap.
    # Otherwise, directions between orders would be so dark that float32 numbers become 0.
    coherence = wd.Coherence("averaged", 1.2)
    light = wd.DirectionalLight((0.4, 0.9, 0.7))
    # Without refinement, each pixel has one ray, through its centre, and cannot be partly in shadow.
    image = wd.shade(mesh, heightfield, light, view, coherence=coherence, pigment=0.0, tolerance=0.1, refine=False)
    assert np.all(np.isfinite(image.xyz))
    assert image.xyz.min() >= 0.0
    pixels = np.flatnonzero(image.mask)
    # Only hits and shadows of the float64 reference are used. Its height field is flat, because this saves time.
    body = pixel_reference.Body.of(prepare_surface(mesh))
    truth = pixel_reference.reference_picture(body, FLAT, [light], view, pixels, "averaged", 0.05, tolerance=0.5)
    luminance = image.xyz[..., 1].ravel()[pixels]
    above = truth.illuminated & (truth.cos_geometric > 0.0) & ~truth.unsure
    assert np.count_nonzero(above) > 0.3 * len(pixels)
    assert np.all(luminance[above] > 0.0)
    dark = truth.hit & ~truth.illuminated & ~truth.unsure
    assert not luminance[dark].any()


def test_the_belly_shows_no_seam(fingers):
    """The picture must show no seam where the texture begins and ends, on the belly of the snake.

    Neighbouring pixels on both sides of the seam must not differ more than other neighbouring pixels.
    """
    tube = meshes.tube(bend_deg=0.0, segments_along=96, segments_around=64)
    # The view is from below, and the seam lies on the border between the two middle columns of the picture.
    view = wd.View.orthographic((0, -2, 0), (0, 0, 0), up=(1, 0, 0), extent_y=1.2, width=48, height=64)
    view = dataclasses.replace(view, extent_y=0.2 * 64 / 48)
    light = wd.DirectionalLight((0.2, -1.0, 0.3))
    image = wd.shade(tube, fingers, light, view, coherence=wd.Coherence("averaged", 1.2), tolerance=1e-2)
    assert image.mask[:, 12:36].all()
    logarithm = np.log(image.xyz[..., 1].astype(np.float64))[:, 12:36]
    step = np.abs(np.diff(logarithm, axis=1)).mean(axis=0)
    seam = 23 - 12
    assert step[seam] <= 1.2 * step[seam - 4 : seam + 5].max()
    # A kink at the seam would show in second differences of the logarithm of Y, but not in first differences.
    bend = np.abs(np.diff(logarithm, 2, axis=1)).mean(axis=0)
    assert bend[seam - 1 : seam + 1].max() <= 1.5 * bend.max(initial=0.0, where=np.arange(bend.size) // 2 != seam // 2)


def test_an_explicit_plan_is_honoured(snake, fingers):
    view = snake_view(32, 24)
    fine = wd.shade(snake, fingers, SNAKE_LIGHT, view, coherence=SHORT, tolerance=3e-2, refine=False)
    coarse_plan = dataclasses.replace(fine.plan, terms=3, wavelengths=9)
    coarse = wd.shade(snake, fingers, SNAKE_LIGHT, view, plan=coarse_plan, refine=False)
    assert coarse.plan == coarse_plan
    assert np.abs(coarse.xyz - fine.xyz).max() > 0.05 * fine.xyz.max()
    again = wd.shade(snake, fingers, SNAKE_LIGHT, view, plan=fine.plan, refine=False)
    np.testing.assert_array_equal(again.xyz, fine.xyz)
    with pytest.raises(ValueError, match="coherence"):
        wd.shade(snake, fingers, SNAKE_LIGHT, view, plan=fine.plan, coherence=LONG)


@pytest.mark.parametrize("options", [{}, {"threads": 3, "samples_per_pixel": 2}, {"method": "direct"}])
def test_progress_grows_to_one(options, snake, small_fingers):
    size = (4, 3) if "method" in options else (96, 72)
    view = wd.View((0.0, 0.5, 1.1), (0.0, 0.0, 0.0), fov_y_deg=14.0, width=size[0], height=size[1])
    visible = []
    lights = [SNAKE_LIGHT, wd.DirectionalLight((-0.5, 1.0, 0.4))]
    wd.shade(snake, small_fingers, lights, view, coherence=SHORT, tolerance=0.1, progress=visible.append, **options)
    assert len(visible) > 3
    assert np.all(np.diff(visible) >= 0.0)
    assert visible[0] > 0.0
    assert visible[-1] == 1.0


@pytest.mark.permanent("forks, process pools, callbacks that render or raise")
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_progress_may_render_or_fail(threads):
    heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
    mesh, light = wd.meshes.tube(segments_along=24, segments_around=16), wd.DirectionalLight((0.1, 0.9, 1.2))
    camera = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), width=160, height=120)
    plan = wd.plan(
        heightfield, coherence=wd.Coherence(sigma_um=3.25), method="low-rank", integration="table", tolerance=0.2
    )
    expected = wd.shade(mesh, heightfield, light, camera, plan=plan, threads=threads).xyz
    nested = []

    def render(_):
        nested.append(wd.shade(mesh, heightfield, light, camera, plan=plan, threads=threads).xyz)

    def fail(_):
        raise ZeroDivisionError

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            wd.shade(mesh, heightfield, light, camera, plan=plan, threads=threads, progress=fail)
        result = wd.shade(mesh, heightfield, light, camera, plan=plan, threads=threads, progress=render).xyz
        np.testing.assert_array_equal(result, expected)
    assert len(nested) > 1
    for each in nested:
        np.testing.assert_array_equal(each, expected)


@pytest.mark.permanent("concurrent rendering threads", shares=2)
def test_threads_that_render_at_once_draw_the_same(tries):
    heightfield = wd.gratings.fingers(size_um=6.4, seed=2)
    mesh, light = wd.meshes.tube(segments_along=24, segments_around=16), wd.DirectionalLight((0.1, 0.9, 1.2))
    together = threading.Barrier(8)

    def render(index, wait=True):
        camera = wd.View((0.1 * index, 1.6, 3.1), (0.0, 0.0, 0.0), width=40, height=30)
        if wait:
            together.wait(60.0)
        return wd.shade(mesh, heightfield, light, camera, coherence=wd.Coherence(sigma_um=1.5), tolerance=0.2).xyz

    expected = [render(index, wait=False) for index in range(8)]
    for _ in tries.of(range(count(1, 15))):
        tries.number += 7
        with ThreadPoolExecutor(8) as pool:
            result = list(pool.map(render, range(8)))
        np.testing.assert_array_equal(result, expected)
