"""Reflectances and pictures with materials, compared with a float64 reference that uses characteristic matrices."""

import numpy as np
import pytest
import trimesh
from conftest import hemisphere, relative_errors, slow

import warpdiff as wd
from bench.truth import reference

SHORT = wd.Coherence(sigma_um=3.0)
GOLD, SILVER = wd.Material.metal("Au"), wd.Material.metal("Ag")
MATERIALS = {"gold": GOLD, "a film on glass": wd.Material.dielectric(1.5).coated(wd.Material.dielectric(2.3), 90.0)}


@pytest.mark.parametrize("name", ["gold", slow("a film on glass")])
@pytest.mark.parametrize(
    ("coherence", "tolerance"), [(SHORT, 2e-2), slow(wd.Coherence("source", angular_diameter_deg=1.5), 8e-2)], ids=str
)
def test_a_table_of_a_material_meets_its_tolerance(name, coherence, tolerance, fingers, rng):
    """Colour tables with the reflectance R(θd, λ) of a material must meet their tolerance.

    θd is half of the angle between light and viewer. R can be included in a table over the scattering vector (u, v, w),
    because cos θd = |(u, v, w)|/2.
    """
    lights, views = hemisphere(rng, 80), hemisphere(rng, 80)
    options = {"coherence": coherence, "material": MATERIALS[name], "tolerance": tolerance}
    plan = wd.plan(fingers, lights, views, method="low-rank", integration="table", **options)
    assert plan.rings_per_octave > 0
    result = wd.reflectance(fingers, lights, views, plan=plan, material=MATERIALS[name])
    exact = reference.reference_reflectance(fingers, lights, views, coherence, tolerance=1e-3, material=MATERIALS[name])
    assert np.percentile(relative_errors(result, exact), 99.0) <= tolerance
    mirror = reference.reference_reflectance(fingers, lights[:20], views[:20], coherence, tolerance=1e-2, ior=np.inf)
    assert np.median(np.linalg.norm(mirror - exact[:20], axis=1) / np.linalg.norm(exact[:20], axis=1)) > 0.1


@pytest.mark.slow
def test_replicated_periods_of_gold_meet_their_tolerance(fingers, rng):
    heightfield, coherence = fingers.cropped(4.0), wd.Coherence("replicas", periods=(3, 5))
    lights, views = hemisphere(rng, 40), hemisphere(rng, 40)
    result = wd.reflectance(heightfield, lights, views, coherence=coherence, material=GOLD)
    exact = reference.reference_reflectance(heightfield, lights, views, coherence, tolerance=1e-3, material=GOLD)
    assert np.max(np.linalg.norm(result - exact, axis=1) / np.linalg.norm(exact, axis=1)) < 1e-2


def test_a_material_without_reflection_is_black_with_a_table(fingers, rng):
    air = wd.Material.from_nk([500.0], [1.0], [0.0])
    lights, views = hemisphere(rng, 40), hemisphere(rng, 40)
    plan = wd.plan(fingers, lights, views, coherence=SHORT, method="low-rank", integration="table")
    # A material without reflection is not exactly black. The table represents the dependence on cos θd by polynomials,
    # whose sum has a rounding error.
    assert np.abs(wd.reflectance(fingers, lights, views, plan=plan, material=air)).max() < 1e-20


def scene():
    """Return a scene of two tubes, one above the other."""
    result = trimesh.Scene()
    for name, y in (("upper", 0.9), ("lower", -0.9)):
        tube = wd.meshes.tube(segments_along=48, segments_around=36)
        tube.apply_translation([0.0, y, 0.0])
        result.add_geometry(tube, geom_name=name)
    return result


VIEW = wd.View((0, 0, 4), (0, 0, 0), width=56, height=42)
LIGHTS = [wd.DirectionalLight((0.3, 0.4, 1.0)), wd.DirectionalLight((-0.6, 0.2, 0.5), illuminant="A")]


@pytest.mark.filterwarnings("ignore:.*of the pixels see more than")
@pytest.mark.parametrize("footprint", [True, False])
def test_each_geometry_has_its_material(footprint, fingers):
    options = {"coherence": SHORT, "tolerance": 1e-1, "footprint": footprint}
    both = wd.shade(scene(), fingers, LIGHTS, VIEW, material={"lower": SILVER, "upper": GOLD}, **options)
    of_one = {
        name: wd.shade(scene(), fingers, LIGHTS, VIEW, material=material, layers=["geometry"], plan=both.plan)
        for name, material in (("upper", GOLD), ("lower", SILVER))
    }
    for index, (name, alone) in enumerate(of_one.items()):
        inside = alone.layers["geometry"] == index
        assert inside.sum() > 100, name
        change = np.linalg.norm(both.xyz - alone.xyz, axis=-1)[inside]
        assert np.percentile(change / np.linalg.norm(alone.xyz, axis=-1)[inside].max(), 99.0) < 5e-3
    again = wd.Renderer(scene(), fingers, LIGHTS, VIEW, material={"lower": SILVER, "upper": GOLD}, plan=both.plan)
    np.testing.assert_array_equal(again.image().xyz, both.xyz)


def test_the_direct_sum_of_two_materials_equals_other_methods():
    heightfield, view = wd.gratings.sinusoidal(1.2, 0.1), wd.View((0, 0, 5), (0, 0, 0), width=16, height=12)
    options = {"coherence": SHORT, "material": {"lower": SILVER, "upper": GOLD}, "footprint": False, "tolerance": 1e-2}
    direct = wd.shade(scene(), heightfield, LIGHTS, view, method="direct", **options)
    result = wd.shade(scene(), heightfield, LIGHTS, view, **options)
    assert direct.xyz.max() > 0.0
    assert np.linalg.norm(result.xyz - direct.xyz, axis=-1).max() < 1e-2 * np.linalg.norm(direct.xyz, axis=-1).max()


def test_geometries_without_a_material_are_refused(fingers):
    with pytest.raises(ValueError, match="material must name each of the mesh's geometries, 'lower', 'upper', and no"):
        wd.shade(scene(), fingers, LIGHTS, VIEW, material={"upper": GOLD})
    with pytest.raises(ValueError, match="see 'middle'"):
        wd.shade(scene(), fingers, LIGHTS, VIEW, material={"upper": GOLD, "lower": GOLD, "middle": GOLD})
    with pytest.raises(TypeError, match=r"material\['upper'\] must be a warpdiff.Material"):
        wd.shade(scene(), fingers, LIGHTS, VIEW, material={"upper": "Au"})


def test_pigment_lies_under_glass_and_not_under_metal():
    """A pigment must be visible below glass, and must not be visible below an opaque metal.

    Light passes the surface of glass twice, and each time it is multiplied by 1 − R for the reflectance R.
    """
    body = wd.meshes.disc()
    body.visual = trimesh.visual.TextureVisuals(
        uv=body.visual.uv, material=trimesh.visual.material.SimpleMaterial(diffuse=(200, 60, 30, 255))
    )
    heightfield, view = wd.HeightField(np.zeros((8, 8)), 0.09), wd.View((0, -2, 3), (0, 0, 0), width=12, height=9)
    light = wd.DirectionalLight((0.4, 0.3, 1.0))

    def under(**options):
        with_it, without = (
            wd.shade(body, heightfield, light, view, pigment=p, footprint=False, **options).xyz for p in (1e4, 0.0)
        )
        return (with_it - without)[4, 6]

    # Without a material, Schlick's formula is used instead of Fresnel's equations. Transmittances differ by less than 1
    # %.
    np.testing.assert_allclose(under(material=wd.Material.dielectric(1.5)), 0.04 * under(ior=1.5), rtol=2e-2)
    assert np.all(under(material=GOLD) == 0.0)
