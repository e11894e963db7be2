"""Plain surfaces must equal the metallic-roughness model, as computed by NumPy from glTF 2.0, appendix B.

A plain surface has no height field, and reflects by base colour, metallic and roughness.
"""

import math

import numpy as np
import pytest
import trimesh
from plain_specification import (
    OPTIONS,
    POINTS,
    SURFACES,
    VIEW,
    brdf,
    quad,
    white_luminance,
)
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.optics import colorimetry
from warpdiff.render import device_tiles, renderer

# Metallic, roughness and linear base colour of the parts of the test scene. The roughness of the last part is below the
# smallest roughness that is rendered.
MATERIALS = [
    (0.0, 0.3, (0.8, 0.5, 0.2)), (0.0, 1.0, (0.2, 0.6, 0.9)), (1.0, 0.25, (0.9, 0.7, 0.3)), (1.0, 0.7, (0.5, 0.5, 0.5)),
    (0.4, 0.5, (0.3, 0.8, 0.4)), (1.0, 0.0, (1.0, 1.0, 1.0)),
]  # fmt: skip


def material(name, metallic, roughness, colour, emission=None):
    # trimesh stores factors in 8 bits, so that the test's colours are rounded to multiples of 1/255.
    return PBRMaterial(
        name=name, baseColorFactor=[*(round(255 * value) for value in colour), 255], metallicFactor=metallic,
        roughnessFactor=roughness, emissiveFactor=emission,
    )  # fmt: skip


def scene(materials=MATERIALS, bend=0.25, size=2.1):
    """Return quads side by side, one per material, and a grating far away, which no picture shows."""
    result = trimesh.Scene()
    for index, own in enumerate(materials):
        x = size * (index - 0.5 * (len(materials) - 1))
        result.add_geometry(quad(x, material(f"m{index}", *own), bend), geom_name=f"q{index}")
    result.add_geometry(quad(0.0, None, y=-4.0), geom_name="grating")
    return result


def parts_of(image):
    """Return rows and columns of the pixels of each part of the scene."""
    geometry = image.layers["geometry"]
    return [np.nonzero((geometry == number) & image.mask) for number in range(len(MATERIALS))]


@pytest.mark.parametrize(
    "light", [wd.DirectionalLight((0.2, 0.1, 1.0), power=3.0), wd.PointLight((0.5, 0.7, 3.0), power=20.0)],
    ids=["directional", "point"],
)  # fmt: skip
def test_pixels_have_the_brdf_of_the_specification(light):
    layers = ["geometry", "to_light", "to_view", "position"]
    # If interpolated normals differ from face normals, the origins of shadow rays move. Directions to a point light
    # would then change, so that the normals are not bent for a point light.
    body = scene(bend=0.0 if isinstance(light, wd.PointLight) else 0.25)
    image = wd.shade(body, SURFACES, light, VIEW, **POINTS, layers=layers)
    for own, pixels in zip(MATERIALS, parts_of(image), strict=True):
        to_light, to_view = (image.layers[name][pixels].astype(float) for name in ("to_light.0", "to_view"))
        power = np.full(len(to_light), 3.0)
        if isinstance(light, wd.PointLight):
            power = 20.0 / np.sum((np.array(light.position) - image.layers["position"][pixels]) ** 2, axis=1)
        reflected = math.pi * brdf(to_light, to_view, *own) * to_light[:, 2:] * power[:, None]
        expected = white_luminance() * reflected @ colorimetry.RGB_TO_XYZ.T
        assert len(expected) > 100
        error = np.linalg.norm(image.xyz[pixels] - expected, axis=1) / np.linalg.norm(expected, axis=1)
        # The layers have the directions in float32. Near the mirror direction of a smooth metal, the model changes so
        # fast with the direction that this rounding is visible.
        assert np.max(error) <= 1e-3


def test_a_smooth_metal_has_the_peak_luminance_of_a_mirror_of_the_unit():
    body, view = (
        scene([(1.0, 0.0, (1, 1, 1))], bend=0.0),
        wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.0, width=4, height=4),
    )
    image = wd.shade(body, SURFACES, wd.DirectionalLight((0.0, 0.0, 1.0)), view, **POINTS)
    np.testing.assert_allclose(image.xyz[..., 1], 1.0, rtol=1e-3)


def mean_colour(image, number):
    """Return the mean colour of one part of the scene over the middle rows of pixels, without pixels at its edges."""
    rows = slice(round(0.35 * len(image.xyz)), round(0.65 * len(image.xyz)))
    columns = np.flatnonzero((image.layers["geometry"][rows] == number).all(axis=0))[2:-2]
    return image.xyz[rows, columns].mean(axis=(0, 1))


def hemisphere(count=400):
    """Return directions of a hemisphere, and for each its solid angle times cos θ.

    The directions are a midpoint rule in (sin²θ, azimuth).
    """
    square = (np.arange(count) + 0.5) / count
    azimuth = 2.0 * math.pi * (np.arange(2 * count) + 0.5) / (2 * count)
    radius = np.sqrt(square)[:, None]
    directions = np.stack(
        [radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1.0 - radius**2) + 0.0 * azimuth], axis=-1
    )
    return directions.reshape(-1, 3), math.pi / (2 * count * count)


@pytest.mark.parametrize("slant_deg", [0.0, 60.0])
def test_under_an_even_sky_the_reflected_light_is_the_albedo_of_the_specification_and_at_most_1(slant_deg):
    materials = [(m, r, (1.0, 1.0, 1.0)) for m, r in ((0.0, 0.4), (0.0, 1.0), (1.0, 0.3), (1.0, 0.6), (1.0, 1.0))]
    slant = math.radians(slant_deg)
    eye = np.array([0.0, -5.0 * math.sin(slant), 5.0 * math.cos(slant)])
    view = wd.View.orthographic(eye, (0.0, 0.0, 0.0), extent_y=1.5, width=160, height=20)
    sky = wd.Environment(np.ones((4, 8, 3)))
    image = wd.shade(
        scene(materials, bend=0.0), SURFACES, sky, view, **OPTIONS | {"shadows": False, "refine": False},
        samples_per_pixel=64, layers=["geometry"],
    )  # fmt: skip
    directions, weight = hemisphere(800)
    for number, own in enumerate(materials):
        mean = mean_colour(image, number)[1]
        expected = weight * brdf(directions, np.array([[0.0, math.sin(slant), math.cos(slant)]]), *own)[:, 1].sum()
        assert mean == pytest.approx(expected, rel=0.01)
        # For metals, the model conserves energy. For a white dielectric, the diffuse part and the reflection together
        # reach 1.02 at 60°.
        assert mean <= (1.005 if own[0] == 1.0 else 1.03)


def test_under_a_sky_with_bright_and_dark_sides_the_light_is_that_of_a_sum_over_the_hemisphere():
    rows, columns = np.meshgrid(np.arange(32), np.arange(64), indexing="ij")
    radiance = 0.2 + np.exp(-0.5 * (((rows - 12) / 5.0) ** 2 + ((columns - 48) / 7.0) ** 2))
    sky = wd.Environment(np.stack([radiance, 0.5 * radiance + 0.2, 0.3 + 0.0 * radiance], axis=-1))
    view = wd.View.orthographic((0, -3, 5), (0, 0, 0), extent_y=1.5, width=160, height=20)
    image = wd.shade(
        scene(bend=0.0), SURFACES, sky, view, **OPTIONS | {"shadows": False, "refine": False}, samples_per_pixel=64,
        layers=["geometry"],
    )  # fmt: skip
    directions, weight = hemisphere(800)
    polar, azimuth = np.arccos(directions[:, 1]), np.arctan2(directions[:, 0], -directions[:, 2])
    at = polar / math.pi * 32 - 0.5, ((azimuth / (2.0 * math.pi) + 0.5) * 64 - 0.5)
    row, column = np.clip(np.floor(at[0]).astype(int), 0, 30), np.floor(at[1]).astype(int)
    s, t = np.clip(at[0] - row, 0.0, 1.0)[:, None], (at[1] - column)[:, None]
    texels = sky.radiance_rgb
    seen = sum(
        a * b * texels[row + i, (column + j) % 64] for i, a in ((0, 1 - s), (1, s)) for j, b in ((0, 1 - t), (1, t))
    )
    to_view = np.array([[0.0, -3.0, 5.0]]) / math.sqrt(34.0)
    for number, own in enumerate(MATERIALS[:-1]):
        mean = mean_colour(image, number)
        reflected = weight * (brdf(directions, to_view, *own) * seen).sum(axis=0)
        np.testing.assert_allclose(mean, reflected @ colorimetry.RGB_TO_XYZ.T, rtol=0.02)


@pytest.mark.parametrize("diameter_deg", [1.2, 20.0])
def test_under_a_disc_the_light_is_that_of_a_sum_over_the_disc(diameter_deg):
    towards = np.array([0.1, 0.0, 1.0]) / math.sqrt(1.01)
    light = wd.DirectionalLight(tuple(towards), angular_diameter_deg=diameter_deg)
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=1.5, width=160, height=20)
    image = wd.shade(scene(bend=0.0), SURFACES, light, view, **OPTIONS | {"shadows": False}, layers=["geometry"])
    radius, count = math.radians(0.5 * diameter_deg), 200
    x, y = np.meshgrid(*2 * [(np.arange(count) + 0.5) / count * 2.0 - 1.0])
    edge = 2.0 * math.sin(0.5 * radius)
    square = edge**2 * (x**2 + y**2)
    axes = np.array([[1.0, 0.0, -0.1], [0.0, math.sqrt(1.01), 0.0]]) / math.sqrt(1.01)
    directions = (1.0 - 0.5 * square)[..., None] * towards
    directions = directions + np.sqrt(np.maximum(1.0 - 0.25 * square, 0.0))[..., None] * edge * (
        x[..., None] * axes[0] + y[..., None] * axes[1]
    )
    directions = directions[x**2 + y**2 < 1.0]
    for number, own in enumerate(MATERIALS[:-1]):
        mean = mean_colour(image, number)
        f = brdf(directions, np.array([[0.0, 0.0, 1.0]]), *own) * directions[:, 2:]
        expected = math.pi * white_luminance() * f.mean(axis=0) @ colorimetry.RGB_TO_XYZ.T
        np.testing.assert_allclose(mean, expected, rtol=0.02)


def test_many_lights_from_which_cells_choose_add_up_to_all_lights():
    rng = np.random.default_rng(5)
    lights = [wd.DirectionalLight((x, y, 1.0), power=0.1) for x, y in rng.normal(scale=0.7, size=(70, 2))]
    body = scene(MATERIALS[:5], bend=0.0)
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=1.5, width=80, height=10)
    options = OPTIONS | {"shadows": False, "layers": ["geometry"]}
    chosen = wd.shade(body, SURFACES, lights, view, **options)
    summed = wd.shade(body, SURFACES, lights, view, **options | {"refine": False})
    for number in range(5):
        np.testing.assert_allclose(mean_colour(chosen, number), mean_colour(summed, number), rtol=0.02)


def ball(own):
    """Return a ball with exact normals, and a grating far away."""
    sphere = trimesh.creation.icosphere(5, 1.0)
    sphere = trimesh.Trimesh(
        sphere.vertices, sphere.faces, vertex_normals=sphere.vertices, process=False,
        visual=TextureVisuals(uv=sphere.vertices[:, :2], material=material("ball", *own)),
    )  # fmt: skip
    grating = quad(0.0, None, y=-4.0)
    return trimesh.Scene({"ball": sphere, "grating": grating})


@pytest.mark.filterwarnings("ignore:mesh's texture coordinates")
@pytest.mark.parametrize("roughness", [0.15, 0.4])
def test_small_highlights_meet_the_tolerance(roughness):
    body, light = ball((1.0, roughness, (1.0, 1.0, 1.0))), wd.DirectionalLight((0.3, 0.5, 1.0))
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.4, width=24, height=24)
    image = wd.shade(body, SURFACES, light, view, **OPTIONS | {"shadows": False})
    truth = wd.shade(body, SURFACES, light, view, **POINTS | {"shadows": False}, samples_per_pixel=1024)
    inside = truth.coverage > 0.999
    floor = 1e-3 * np.percentile(truth.xyz[inside, 1], 99.0)
    change = np.linalg.norm(image.xyz - truth.xyz, axis=-1)[inside]
    error = change / np.maximum(np.linalg.norm(truth.xyz, axis=-1)[inside], floor)
    assert truth.xyz[..., 1].max() > 20.0 * np.median(truth.xyz[inside, 1])
    assert np.percentile(error, 99.0) <= 0.1
    assert np.mean(error <= image.error[inside] + 0.01) >= 0.9


def test_emission_of_1_is_the_luminance_of_a_white_surface_that_faces_the_brightest_light():
    body = trimesh.Scene()
    body.add_geometry(quad(-1.1, material("lamp", 0.0, 1.0, (0, 0, 0), [1.0, 0.5, 0.25]), 0.0), geom_name="lamp")
    body.add_geometry(
        quad(1.1, PBRMaterial(name="matte", baseColorFactor=[255] * 4, emissiveFactor=[0.0, 2.0, 0.0]), 0.0),
        geom_name="matte",
    )
    body.add_geometry(quad(0.0, None, y=-4.0), geom_name="grating")
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.0, width=32, height=8)
    below = wd.DirectionalLight((0.0, 0.0, -1.0), power=4.0)
    weak = wd.PointLight((0.0, 0.0, -1e4), power=2.0)
    for options in (POINTS, OPTIONS):
        for lights in (below, [weak, below]):
            image = wd.shade(body, SURFACES, lights, view, **options)
            for columns, emission in ((slice(9, 14), (1.0, 0.5, 0.25)), (slice(18, 23), (0.0, 2.0, 0.0))):
                expected = 4.0 * white_luminance() * colorimetry.RGB_TO_XYZ @ np.array(emission)
                np.testing.assert_allclose(
                    image.xyz[2:-2, columns].reshape(-1, 3), np.tile(expected, (20, 1)), rtol=1e-4
                )
    sky = wd.shade(body, SURFACES, wd.Environment(np.ones((4, 8, 3))), view, **OPTIONS | {"shadows": False})
    colour = sky.xyz[2:-2, 18:23].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(colour, colorimetry.RGB_TO_XYZ @ np.array([1.0, 3.0, 1.0]), rtol=0.03)


def lamps():
    """Return a metal quad that emits light, a matte quad that does not, and a grating outside of all views.

    A scene must have at least one height field, which the grating has.
    """
    body = trimesh.Scene()
    body.add_geometry(quad(-1.1, material("lamp", 1.0, 0.4, (1, 0.5, 0), [0.1, 0.05, 0.0])), geom_name="lamp")
    body.add_geometry(quad(1.1, material("table", 0.0, 0.6, (0.2, 0.4, 0.6))), geom_name="table")
    body.add_geometry(quad(0.0, None, y=-4.0), geom_name="grating")
    return body


SMALL = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.0, width=24, height=8)
LIGHTS = [wd.DirectionalLight((0.2, 0.1, 1.0)), wd.PointLight((0.5, 0.5, 3.0), power=4.0)]


@pytest.mark.parametrize("options", [POINTS, OPTIONS | {"refine": False}], ids=["points", "means"])
def test_a_picture_is_the_sum_of_its_lights_and_the_emission(options):
    image = wd.shade(lamps(), SURFACES, LIGHTS, SMALL, **options, layers=["light"])
    dark = wd.shade(lamps(), SURFACES, wd.DirectionalLight((0.0, 0.0, -1.0)), SMALL, **options)
    # The point light has a power of 4 at a distance of about 3, so that it is weaker than the directional light.
    expected = image.layers["light.0"] + image.layers["light.1"] + dark.xyz
    assert dark.xyz[4, 8, 1] > 0.0
    np.testing.assert_allclose(image.xyz, expected, rtol=1e-5, atol=1e-9)


def test_recorded_pictures_equal_those_of_shade(monkeypatch):
    monkeypatch.setattr(renderer, "records", lambda _: True)
    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 1 << 15)
    sky = wd.Environment.clear_sky((0.3, 0.8, 1.0))
    drawn = wd.Renderer(lamps(), SURFACES, LIGHTS[:1], SMALL, **OPTIONS, threads=1)
    for lights in (LIGHTS[1:], [wd.DirectionalLight((0.4, 0.0, 1.0), power=2.0)], LIGHTS, [sky]):
        drawn.draw(lights)
        result, expected = drawn.image(), wd.shade(lamps(), SURFACES, lights, SMALL, **OPTIONS, plan=drawn.plan)
        assert expected.illuminated.sum() > 100
        change = np.linalg.norm(result.xyz - expected.xyz, axis=-1) / np.linalg.norm(expected.xyz, axis=-1).max()
        assert np.percentile(change, 90.0) <= (1e-2 if lights == [sky] else 1e-6)
