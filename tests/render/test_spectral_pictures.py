"""Spectral pictures: radiances equal reflectance spectra and integrate to the colours; other programs can read them."""

import warnings

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import pytest
import trimesh

import warpdiff as wd
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import colour_science

HF = wd.gratings.fingers(size_um=6.4, pitch_um=0.08)
BODY = wd.meshes.tube(segments_along=24, segments_around=16)
VIEW = wd.View.fit(BODY, (0.0, 0.4, 1.0), width=16, height=9)
LIGHT = wd.DirectionalLight((0.3, 1.0, 0.8), illuminant="E", power=2.0)
WINDOW = wd.Coherence(sigma_um=2.0)
WAVELENGTHS_NM = np.array([380.0, 455.5, 550.0, 700.123456])
OPTIONS = {"coherence": WINDOW, "tolerance": 0.05, "wavelengths_nm": WAVELENGTHS_NM}


def spectra_of(image, index, light, **options):
    """Return the expected spectra of a picture under one of its lights, for the directions that its layers store."""
    to_light = image.layers[f"to_light.{index}"]
    lit = to_light.any(axis=2)
    result = np.zeros((*lit.shape, len(WAVELENGTHS_NM)))
    values = wd.spectral_reflectance(HF, to_light[lit], image.layers["to_view"][lit], WAVELENGTHS_NM, **options)
    result[lit] = light.power * values * colorimetry.relative_powers(light.illuminant, WAVELENGTHS_NM)
    return result


@pytest.mark.parametrize(
    "options",
    [{}, {"method": "direct", "tolerance": 0.05}, {"material": wd.Material.metal("Au")}],
    ids=["table", "direct", "material"],
)
def test_spectra_are_those_of_the_local_directions(options):
    lights = [LIGHT, wd.DirectionalLight((-0.4, 0.5, 0.8), illuminant="D65")]
    options = {"coherence": WINDOW, "tolerance": 1e-2, **options}
    view = wd.View.fit(BODY, (0.0, 0.4, 1.0), width=8, height=5)
    image = wd.shade(BODY, HF, lights, view, wavelengths_nm=WAVELENGTHS_NM, layers=["to_light", "to_view"], **options)
    assert image.spectra.shape == (5, 8, 4)
    assert image.spectra.dtype == np.float32
    np.testing.assert_array_equal(image.wavelengths_nm, WAVELENGTHS_NM)
    expected = sum(spectra_of(image, index, light, **options) for index, light in enumerate(lights))
    np.testing.assert_allclose(image.spectra, expected, atol=1e-2 * expected.max())
    assert np.count_nonzero(image.spectra.any(axis=2)) > 5


@pytest.mark.parametrize("illuminant", ["E", "D65", wd.Spectrum.blackbody(2856.0)], ids=str)
def test_spectra_integrate_to_the_colours(illuminant):
    light = wd.DirectionalLight(LIGHT.to_light, illuminant=illuminant)
    nm = np.arange(380.0, 781.0, 4.0)
    image = wd.shade(BODY, HF, light, VIEW, coherence=WINDOW, tolerance=1e-2, wavelengths_nm=nm, samples_per_pixel=2)
    observer = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = observer.copy().align(colour_science().SpectralShape(380, 780, 4)).values
    xyz = image.spectra @ curves / curves[:, 1].sum()
    assert wd.compare(xyz, image.xyz, tolerance=1e-2).p99 < 1e-2


def test_a_material_per_geometry():
    scene = trimesh.Scene()
    for name, x in (("left", -1.5), ("right", 1.5)):
        shift = trimesh.transformations.translation_matrix((x, 0.0, 0.0))
        scene.add_geometry(wd.meshes.disc(segments=16, rings=2), node_name=name, geom_name=name, transform=shift)
    light, view = wd.DirectionalLight((0.0, 0.0, 1.0)), wd.View((0, 0, 9), (0, 0, 0), width=16, height=8)
    metals = {"left": wd.Material.metal("Au"), "right": wd.Material.metal("Ag")}

    def render(material):
        return wd.shade(scene, HF, light, view, material=material, pigment=0.0, layers=["geometry"], **OPTIONS)

    image = render(metals)
    for index, name in enumerate(metals):
        alone = render(dict.fromkeys(metals, metals[name]))
        inside = image.layers["geometry"] == index
        np.testing.assert_allclose(image.spectra[inside], alone.spectra[inside], rtol=1e-6)
    assert image.spectra[image.layers["geometry"] == 0].sum() > 0.0


def test_files_have_the_layout_of_fichet_2021_and_are_read_by_colour_science(tmp_path):
    image = wd.shade(BODY, HF, LIGHT, VIEW, layers=["normal"], **OPTIONS)
    path = image.save(tmp_path / "a.exr")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = colour_science().io.read_spectral_image_Fichet2021
    components, specification = read(str(path), additional_data=True)
    assert list(components) == ["S0"]
    np.testing.assert_array_equal(components["S0"][0], WAVELENGTHS_NM)
    np.testing.assert_array_equal(components["S0"][1], image.spectra)
    assert specification.is_emissive
    assert not specification.is_polarised
    spec = oiio.ImageBuf(str(path)).spec()
    assert {"R", "G", "B", "A", "S0.380,000000nm", "S0.700,123456nm"} <= set(spec.channelnames)
    assert spec.getattribute("spectralLayoutVersion") == "1.0"
    assert spec.getattribute("emissiveUnits") == "W.m^-2.sr^-1"
    copy = wd.Image.load(path)
    np.testing.assert_array_equal(copy.spectra, image.spectra)
    np.testing.assert_array_equal(copy.wavelengths_nm, WAVELENGTHS_NM)
    assert wd.Image.load(wd.shade(BODY, HF, LIGHT, VIEW, tolerance=0.1).save(tmp_path / "b.exr")).spectra is None


COLOURED = wd.meshes.snake(scale_rows=5, ventrals=8)
GLASS = wd.Material([400.0, 800.0], [1.5, 1.4])
REFUSED = {
    "footprint": ({"footprint": True}, "footprint must be None or False with wavelengths_nm, got True: give samples"),
    "energy": ({"energy": "normalised"}, "energy must be 'stam' with wavelengths_nm, .* got 'normalised'"),
    "table": ({"integration": "table"}, "integration must be 'auto' or 'sampled' with wavelengths_nm.* got 'table'"),
    "order": ({"wavelengths_nm": [500.0, 450.0]}, r"wavelengths_nm must increase in steps .*, got \[500.0, 450.0\]"),
    "unit": ({"wavelengths_nm": 0.5}, "wavelengths_nm must lie within 100 to 10000 nm, got 0.5 to 0.5: give"),
    "illuminant": (
        {"wavelengths_nm": 1500.0}, "wavelengths_nm must lie within the range of the illuminant 'E', 360 to 830"
    ),
    "material": ({"material": GLASS, "wavelengths_nm": 390.0}, "material must cover"),
    "disc": (
        {"lights": wd.DirectionalLight((0, 1, 1), angular_diameter_deg=3.0)},
        r"lights\[0\] has an extent and requires footprints, which .* wavelengths_nm, .* excludes",
    ),
    "sky": ({"lights": wd.Environment(np.ones((2, 4, 3)))}, r"lights\[0\] has an extent and requires footprints"),
    "pigment": ({"mesh": COLOURED}, "pigment must be 0 with wavelengths_nm for a mesh with a base colour.*, got 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_unsupported_combinations_are_refused_before_the_picture_is_drawn(case, monkeypatch):
    monkeypatch.setattr("warpdiff.render.shade._render", lambda *_: pytest.fail("drawing has begun"))
    options, message = REFUSED[case]
    options = {"mesh": BODY, "lights": LIGHT, **OPTIONS, **options}
    with pytest.raises(ValueError, match=message):
        wd.shade(heightfield=HF, view=VIEW, **options)
