"""Pictures with several surfaces: each part of a mesh must have the colours of its own surface, in a common unit.

The unit is the light that a perfect mirror shows. A plan states how the colours of one surface are computed: the
method, the number of wavelengths and so on.
"""

import math
import pickle

import numpy as np
import pytest
import trimesh
from conftest import relative_errors
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.optics import colorimetry, reflectance_factors

BLAZED, WAVE = wd.gratings.blazed(2.0, 0.25), wd.gratings.sinusoidal(1.5, 0.1)
UNIT, SHORT = wd.Coherence(sigma_um=3.0), wd.Coherence(sigma_um=2.0)
LIGHT = wd.DirectionalLight((0.3, 0.0, 1.0))
VIEW = wd.View.orthographic((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), extent_y=2.2, width=48, height=16)
OPTIONS = {"coherence": UNIT, "tolerance": 0.1, "refine": False, "masking": False}


def scene(**materials):
    """Return three quads side by side.

    The arguments are the names of their geometries, each with the name of its material.
    """
    result = trimesh.Scene()
    for x, (name, material) in zip((-2.1, 0.0, 2.1), materials.items(), strict=True):
        corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        # The quads are slightly curved by their normals, so that a picture contains many directions.
        normals = corners * (0.1, 0.1, 0.0) + np.array([0.0, 0.0, 1.0])
        white = PBRMaterial(name=material, baseColorFactor=[255, 255, 255, 255])
        quad = trimesh.Trimesh(
            corners + np.array([x, 0.0, 0.0]), [[0, 1, 2], [0, 2, 3]], vertex_normals=normals, process=False,
            visual=TextureVisuals(uv=corners[:, :2], material=white),
        )  # fmt: skip
        result.add_geometry(quad, geom_name=name, node_name=name)
    return result


BODY = scene(left="gold", middle="silver", right="gold")
PARTS = np.repeat(np.arange(3), 16)


# The plan (numbers of the computation) of one part of the mesh is used for a picture in which all parts have this
# surface. The other parts have directions for which the plan was not made. The warning about these directions is
# expected.
@pytest.mark.filterwarnings("ignore:plan is used beyond")
@pytest.mark.parametrize("lights", [LIGHT, [LIGHT, wd.PointLight((0.0, 1.0, 3.0))]], ids=["one", "two"])
@pytest.mark.parametrize("points", [False, True], ids=["means", "points"])
def test_parts_equal_pictures_of_one_surface_in_the_unit_of_the_picture(lights, points):
    gold = wd.Material.metal("Au")
    surfaces = {
        "left": BLAZED,
        "middle": wd.Surface(WAVE, coherence=SHORT, ior=2.0),
        "*": wd.Surface(BLAZED, material=gold),
    }
    options = OPTIONS | {"footprint": not points, "pigment": 0.0}
    image = wd.shade(BODY, surfaces, lights, VIEW, **options)
    assert set(image.plan) == {"left", "middle", "*"}
    of_glass, of_index = (reflectance_factors.normal_reflectance(ior) for ior in (1.5, 2.0))
    singles = {
        0: ("left", BLAZED, {}, of_glass), 2: ("*", BLAZED, {"material": gold}, 1.0),
        1: ("middle", WAVE, {"coherence": None, "ior": 2.0}, of_index * (2.0 / 3.0) ** 2),
    }  # fmt: skip
    for part, (key, heightfield, changes, unit) in singles.items():
        one = wd.shade(BODY, heightfield, lights, VIEW, **options | changes, plan=image.plan[key])
        inside = np.flatnonzero(part == PARTS)[2:-2]
        expected = unit * one.xyz[2:-2, inside]
        assert expected.max() > 1e-4
        if points:
            np.testing.assert_allclose(image.xyz[2:-2, inside], expected, rtol=1e-5, atol=1e-6 * expected.max())
        else:
            # Colours are interpolated in a table. The extent of the table depends on the directions of all parts with
            # the surface. The tables of both pictures are therefore slightly different.
            assert (
                np.percentile(relative_errors(image.xyz[2:-2, inside].reshape(-1, 3), expected.reshape(-1, 3)), 99.0)
                <= OPTIONS["tolerance"]
            )


@pytest.mark.parametrize(
    ("coherence", "reflection"),
    [(wd.Coherence(sigma_um=2.0), {"ior": 1.5}), (wd.Coherence(sigma_um=5.0), {"ior": math.inf}),
     (wd.Coherence(sigma_um=2.0), {"material": wd.Material.metal("Cu")}),
     (wd.Coherence("source", angular_diameter_deg=4.0), {"ior": 1.5})],
    ids=["glass", "mirror", "copper", "source"],
)  # fmt: skip
def test_luminance_relative_to_a_white_plain_surface_is_that_of_the_brdf(coherence, reflection):
    """The luminance relative to a white plain surface must be π ∫ f Ω S ȳ dλ / ∫ Ω S ȳ dλ.

    f is the absolute BRDF, S the illuminant, ȳ the luminous efficiency, and Ω a weight, proportional to λ² for a
    coherence window.
    """
    image = wd.shade(
        BODY, {"middle": wd.Surface(WAVE, coherence=coherence, pigment=0.0, **reflection), "*": None}, LIGHT, VIEW,
        **OPTIONS | {"tolerance": 1e-3, "footprint": False}, layers=["to_light", "to_view"],
    )  # fmt: skip
    row, columns = 8, [np.flatnonzero(part == PARTS)[8] for part in (0, 1)]
    to_lights, to_views = (image.layers[name][row, columns].astype(np.float64) for name in ("to_light.0", "to_view"))
    nm = colorimetry.VISIBLE_NM
    values = wd.brdf(WAVE, to_lights[1], to_views[1], nm, coherence=coherence, tolerance=1e-3, **reflection)
    solid = np.ones(len(nm)) if coherence.kind == "source" else nm**2
    weights = solid * colorimetry.colour_products("D65")[:, 1]
    expected = math.pi * np.sum(values * weights) / np.sum(weights) * to_lights[1, 2]
    white, colour = image.xyz[row, columns, 1] / (to_lights[0, 2], 1.0)
    assert expected > 1e-3
    assert colour / white == pytest.approx(expected, rel=1e-2)


def test_under_an_even_sky_a_mirror_and_a_white_plain_surface_show_the_sky():
    sky = wd.Environment(np.ones((4, 8, 3)))
    mirror = wd.Surface(wd.HeightField([[0.0]], 1.0), coherence=SHORT, ior=math.inf)
    options = OPTIONS | {"shadows": False, "samples_per_pixel": 256}
    image = wd.shade(BODY, {"middle": mirror, "*": None}, sky, VIEW, **options)
    white = colorimetry.colour_products("D65").sum(axis=0)
    for part in range(3):
        inside = image.xyz[4:-4, np.flatnonzero(part == PARTS)[4:-4]].reshape(-1, 3).mean(axis=0)
        np.testing.assert_allclose(inside, white, rtol=0.03)


@pytest.mark.parametrize("illuminant", ["D65", "A", "FL11"])
@pytest.mark.parametrize(
    "coherence",
    [wd.Coherence(sigma_um=2.0), wd.Coherence("centred", 8.0), wd.Coherence("source", angular_diameter_deg=2.0),
     wd.Coherence("replicas", periods=(1, 9))],
    ids=lambda each: each.kind,
)  # fmt: skip
def test_a_white_pigment_has_the_chromaticity_of_the_illuminant(coherence, illuminant):
    white = reflectance_factors.pigment_white(illuminant, coherence, 3.0)
    products = colorimetry.colour_products(illuminant)
    np.testing.assert_allclose(white / white.sum(), products.sum(axis=0) / products.sum(), rtol=1e-12)
    solid_angle = reflectance_factors.pigment_solid_angle(1e-3 * colorimetry.VISIBLE_NM, coherence, 3.0)
    assert white[1] == pytest.approx(float(solid_angle @ products[:, 1]), rel=1e-12)


def test_a_renderer_draws_the_pictures_of_shade_and_can_be_pickled():
    surfaces = {"silver": WAVE, "left/gold": wd.Surface(BLAZED, coherence=SHORT), "*": None}
    renderer = wd.Renderer(BODY, surfaces, LIGHT, VIEW, **OPTIONS)
    other = wd.DirectionalLight((-0.3, 0.2, 1.0))
    expected = wd.shade(BODY, surfaces, other, VIEW, **OPTIONS, plan=renderer.plan)
    for each in (renderer, pickle.loads(pickle.dumps(renderer))):  # noqa: S301 (own bytes)
        each.draw(other)
        np.testing.assert_array_equal(each.image().xyz, expected.xyz)
    assert set(renderer.plan) == {"silver", "left/gold"}
    small = renderer.resized(wd.View.orthographic((0, 0, 5.0), (0, 0, 0), extent_y=2.2, width=12, height=4))
    assert small.image().xyz.shape == (4, 12, 3)


def test_one_key_for_all_parts_gives_the_same_colours_as_several_keys():
    surface = wd.Surface(WAVE, coherence=SHORT, ior=2.0, pigment=0.7)
    one = wd.Renderer(BODY, {"*": surface}, LIGHT, VIEW, **OPTIONS)
    several = wd.shade(BODY, {"left": surface, "*": surface}, LIGHT, VIEW, **OPTIONS)
    np.testing.assert_allclose(one.image().xyz, several.xyz, rtol=0.1, atol=1e-3 * several.xyz.max())
    copy = pickle.loads(pickle.dumps(one))  # noqa: S301 (own bytes)
    np.testing.assert_array_equal(copy.image().xyz, one.image().xyz)


def test_plans_state_the_coherence_of_the_unit():
    surfaces = {"left": wd.Surface(WAVE, coherence=SHORT, ior=2.0), "middle": None, "*": BLAZED}
    first = wd.shade(BODY, surfaces, LIGHT, VIEW, **OPTIONS)
    unstated = {name: value for name, value in OPTIONS.items() if name != "coherence"}
    again = wd.shade(BODY, surfaces, LIGHT, VIEW, **unstated, plan=first.plan)
    np.testing.assert_array_equal(again.xyz, first.xyz)
    plans = {"left": first.plan["left"], "*": first.plan["*"]}
    with pytest.raises(ValueError, match=r"coherence must be given, because the plans .* differ: averaged window"):
        wd.shade(BODY, {"left": WAVE, "*": BLAZED}, LIGHT, VIEW, **unstated, plan=plans)


@pytest.mark.parametrize(
    ("surfaces", "message"),
    [
        ({"Gold": WAVE, "*": None}, r"keys, which are 'left/gold', .* got 'Gold'; did you mean 'gold'\?"),
        ({"gold": WAVE}, r"for each part of the mesh, got none for 'middle/silver'.*: add '\*'"),
        ({"gold": WAVE, "left": BLAZED, "*": None}, r"got the keys 'gold' and 'left' for 'left/gold': add the key"),
        ({"*": None}, "must have a height field for at least one part, got none"),
        ({"*": 5}, r"heightfield\['\*'\] must be a HeightField, a GratingMap, a Surface or None, got int"),
        ({5: WAVE}, "must have names of parts as keys, got int"),
        ({"left": WAVE, "*": wd.Surface(WAVE, coherence=wd.Coherence("centred", 2.0))}, "all or none have footprints"),
    ],
)
def test_invalid_surfaces_are_refused(surfaces, message):
    with pytest.raises((ValueError, TypeError), match=message):
        wd.shade(BODY, surfaces, LIGHT, VIEW, **OPTIONS)


def test_a_name_of_a_geometry_and_of_another_material_is_refused():
    body = scene(gold="silver", middle="gold", right="silver")
    with pytest.raises(ValueError, match=r"got 'gold', the name of a geometry \('gold/silver'\) and of a material"):
        wd.shade(body, {"gold": WAVE, "*": None}, LIGHT, VIEW, **OPTIONS)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "direct"}, "several surfaces, for which method='direct' is not supported"),
        ({"plan": {"right": None}}, r"plan must have the keys of heightfield, 'left', '\*', got 'right'"),
        ({"material": {"nothing": wd.Material.metal("Au")}}, "material must have the keys of heightfield"),
    ],
)
def test_options_that_do_not_suit_several_surfaces_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        wd.shade(BODY, {"left": WAVE, "*": BLAZED}, LIGHT, VIEW, **OPTIONS | options)
