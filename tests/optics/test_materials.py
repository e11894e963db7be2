"""Materials: Fresnel's equations, thin films (compared with characteristic matrices), files and flat surfaces."""

import dataclasses
import math
import re

import numpy as np
import pytest
from conftest import at_angle

import warpdiff as wd
from bench.truth import flat_materials, reference
from warpdiff.optics import colorimetry

UP = (0.0, 0.0, 1.0)
GOLD = wd.Material.metal("Au")
FILM = wd.Material.metal("Al").coated(wd.Material.dielectric(1.46), 180.0)
MATERIALS = {
    "glass": wd.Material.dielectric(1.5),
    **{symbol: wd.Material.metal(symbol) for symbol in ("Al", "Ag", "Au", "Cr", "Cu", "Ni")},
    "a film on aluminium": FILM,
    "an absorbing film on glass": wd.Material.dielectric(1.52).coated(wd.Material.metal("Cr"), 8.0),
    "less than air": wd.Material([500.0], 0.4),
}


@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("polarisation", [None, "s", "p"])
def test_reflectance_equals_that_of_characteristic_matrices(name, polarisation):
    material, angles = MATERIALS[name], np.array([0.0, 20.0, 45.0, 60.0, 75.0, 89.0])
    wavelengths = np.linspace(380.0, 780.0, 41)
    reflectances = material.reflectance(wavelengths, angles[:, None], polarisation=polarisation)
    expected = flat_materials.reflectance(
        material, 1e-3 * wavelengths, np.cos(np.radians(angles))[:, None], polarisation or "sp"
    )
    np.testing.assert_allclose(reflectances, expected, rtol=1e-9, atol=1e-12)


def test_glass_reflects_no_p_light_at_brewsters_angle_and_all_at_the_horizon():
    glass = wd.Material.dielectric(1.5)
    assert glass.reflectance(500.0, math.degrees(math.atan(1.5)), polarisation="p") == pytest.approx(0.0, abs=1e-12)
    assert glass.reflectance(500.0, 0.0) == pytest.approx(0.04)
    assert glass.reflectance(500.0, 90.0) == pytest.approx(1.0)


def test_a_quarter_wave_film_with_the_square_root_of_the_index_reflects_nothing():
    coated = wd.Material.dielectric(2.25).coated(wd.Material.dielectric(1.5), 550.0 / 4.0 / 1.5)
    assert coated.reflectance(550.0, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert coated.reflectance(400.0, 0.0) > 0.02


def test_metals_have_their_colours():
    """Metals must have their known colours.

    Gold (Johnson and Christy) reflects red and absorbs blue. Aluminium (McPeak) reflects 91 to 92 % of green.
    """
    assert GOLD.reflectance([450.0, 650.0], 0.0).tolist() == pytest.approx([0.408, 0.955], abs=0.01)
    assert wd.Material.metal("Al").reflectance(550.0, 0.0) == pytest.approx(0.916, abs=2e-3)
    assert "Johnson" in GOLD.source
    assert "CC0" in GOLD.source


def test_materials_with_equal_numbers_are_equal():
    assert wd.Material.dielectric(1.5) == wd.Material.dielectric(1.5)
    assert hash(FILM) == hash(wd.Material.metal("Al").coated(wd.Material.dielectric(1.46), 180.0))
    assert wd.Material.dielectric(1.5) != wd.Material.dielectric(1.6)
    assert wd.Material.metal("Al") != FILM
    assert str(FILM) == "aluminium under 180 nm of n = 1.46"
    assert repr(GOLD) == "Material(name='gold', film=None, film_nm=0.0)"


SITE_YAML = """# this file is part of refractiveindex.info database
REFERENCES: |
    A. Body. <i>Of metals</i>
COMMENTS: "none"
DATA:
  - type: tabulated nk
    data: |
        0.3 1.2 3.0
        0.8 2.2 5.0
"""
FORMULA = """REFERENCES: "A. Glassmaker"
DATA:
  - type: formula 2
    wavelength_range: 0.3 2.5
    coefficients: 0 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653
  - type: tabulated k
    data: |
        0.300 2.8607E-06
        2.500 1.2E-06
"""
FILES = {
    "metal.yml": (SITE_YAML, 1.7, 4.0), "bk7.yaml": (FORMULA, 1.51852, 0.0),
    "blocks.csv": ("wl,n\n0.3,1.2\n0.8,2.2\n\nwl,k\n0.3,3\n0.8,5\n", 1.7, 4.0),
    "columns.csv": ("wavelength [nm],n,k\n300,1.2,3\n800,2.2,5\n", 1.7, 4.0),
    "cauchy.yml": ("DATA:\n  - type: formula 5\n    wavelength_range: 0.3 1\n    coefficients: 1.4 0.0121 -2\n", 1.44,
                   0.0),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_files_of_the_database_are_read(name, tmp_path):
    text, n, k = FILES[name]
    (tmp_path / name).write_text(text)
    material = wd.Material.from_file(tmp_path / name)
    expected = wd.Material([550.0], n, k)
    assert material.name == name.partition(".")[0]
    np.testing.assert_allclose(material.reflectance(550.0, 30.0), expected.reflectance(550.0, 30.0), rtol=1e-3)


def test_a_material_file_states_its_source(tmp_path):
    (tmp_path / "metal.yml").write_text(SITE_YAML)
    assert wd.Material.from_file(tmp_path / "metal.yml").source == "A. Body. Of metals"


BAD_FILES = {
    "": "the file has no index of refraction n", "wl,n\n": "the file has no index of refraction n",
    "wl,q\n1,2\n": "columns must be a wavelength, n and k", "wl,k\n0.3,1\n": "the file has no index of refraction n",
    "0.3,nan\n": "must be finite", "0.3,-1\n0.8,-1\n": "n must lie within",
    "3e-5,1\n": "no wavelength within 100 to 10000 nm, but covers 0.03 to 0.03 nm: wavelengths must be in µm",
    "wl,n,k\n0.3,1,3\n0.5,0.7x,6\n": "line 3 must have 3 numbers .wavelength, n, k., got '0.5 0.7x 6'",
    "wl,n,k\n0.3,1,3\n0.5,0.7\n": "line 3 must have 3 numbers", "wl,n\n0.3,1\n\n0.5,0.7,6\n": "line 4 must have 2",
    "O.3,1\n": "line 1 must have 2 numbers", "wl,n\n0.3,1_0\n": "line 2 must have 2 numbers",
}  # fmt: skip


def test_a_formula_that_has_no_index_at_some_wavelengths_is_refused(tmp_path):
    """A formula without a real index of refraction at some wavelengths must be refused.

    The tested index is n² = λ/µm − 1, which is not real below 1 µm.
    """
    text = "DATA:\n  - type: formula 3\n    wavelength_range: 0.3 2.5\n    coefficients: -1 1 1\n"
    (tmp_path / "a.yml").write_text(text)
    with pytest.raises(ValueError, match="formula 3 must have a finite index of refraction at all wavelengths"):
        wd.Material.from_file(tmp_path / "a.yml")


@pytest.mark.parametrize("text", BAD_FILES)
def test_files_without_a_material_are_refused(text, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=BAD_FILES[text]):
        wd.Material.from_file(tmp_path / "a.csv")
    (tmp_path / "a.yml").write_text(text)
    with pytest.raises(ValueError, match="no entry such as '- type: tabulated nk'"):
        wd.Material.from_file(tmp_path / "a.yml")


def test_a_row_that_is_no_row_is_refused_with_its_line(tmp_path):
    """Each invalid row of a YAML table of refractive indices must be refused with its line.

    Each tested row has one fault: a stray letter, a missing or extra number, or a decimal comma.
    """
    file = tmp_path / "a.yml"
    for row in ("0.5 2.0x 4.0", "O.5 2.0 4.0", "0.5 2.0", "0.5 2.0 4.0 0.1", "0,5 2.0 4.0", "0.5 - 4.0"):
        file.write_text(SITE_YAML.replace("        0.8 2.2", f"        {row}\n        0.8 2.2"))
        with pytest.raises(ValueError, match=re.escape(f"line 9 must have 3 numbers (wavelength, n, k), got {row!r}")):
            wd.Material.from_file(file)
    # Comments, blank lines and the sections that follow a table are no rows of the table.
    file.write_text(
        SITE_YAML.replace("        0.8", "\n        # by hand\n        0.8") + "SPECS:\n    n_is_absolute: true\n"
    )
    assert np.asarray(wd.Material.from_file(file).wavelengths_nm).tolist() == [300.0, 800.0]


def test_a_table_from_x_rays_to_the_far_infrared_is_read_in_its_middle(tmp_path):
    rows = ["0.0001 1.0 0.0", "0.05 0.9 0.1", "0.1 0.3 1.0", "0.5 0.77 6.08", "10.0 25.0 90.0", "200.0 400.0 480.0"]
    text = "DATA:\n  - type: tabulated nk\n    data: |\n" + "".join(f"        {row}\n" for row in rows)
    (tmp_path / "metal.yml").write_text(text)
    material = wd.Material.from_file(tmp_path / "metal.yml")
    assert np.asarray(material.wavelengths_nm).tolist() == pytest.approx([100.0, 500.0, 10_000.0])
    assert np.asarray(material.n).tolist() == pytest.approx([0.3, 0.77, 25.0])


# Each entry has the number of a formula, its coefficients as in the database, a wavelength [µm], the index of
# refraction as published elsewhere, and the usual difference between measurements. Sources of the indices, in this
# order: Malitson (1965), data sheet of Schott N-BK7, catalogue of BK7 of 1996, Zernike (1964) at two wavelengths, a
# textbook's Cauchy fit of BK7, Edlén (1966), Salzberg and Villa (1957), CRC Handbook for AgBr and urea.
PUBLISHED = [
    (1, "0 0.6961663 0.0684043 0.4079426 0.1162414 0.8974794 9.896161", 0.587561, 1.45846, 1e-5),
    (2, "0 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653", 0.4861327, 1.52238, 1e-5),
    (3, "2.2718929 -1.0108077E-2 2 1.0592509E-2 -2 2.0816965E-4 -4 -7.6472538E-6 -6 4.9240991E-7 -8", 0.5875618,
     1.51680, 1e-5),
    (4, "2.259276 0.01008956 0 0.012942625 1 13.00522 2 400 1", 1.064, 1.4938, 1e-4),
    (4, "2.259276 0.01008956 0 0.012942625 1 13.00522 2 400 1", 0.532, 1.5124, 2e-4),
    (5, "1.5046 0.0042 -2", 0.5875618, 1.5168, 1e-4),
    (6, "0 0.05792105 238.0185 0.00167917 57.362", 0.6328, 1.0002765, 1e-7),
    (7, "3.41983 0.159906 -0.123109 1.26878E-6 -1.95104E-9", 9.9, 3.4179, 4e-3),
    (8, "0.452505 0.09939 0.070537 -0.000150", 0.5893, 2.253, 5e-3),
    (9, "2.51527 0.0240 0.0300 0.020 1.52 0.8771", 0.5893, 1.602, 5e-3),
]  # fmt: skip


@pytest.mark.parametrize(("number", "coefficients", "um", "n", "difference"), PUBLISHED)
def test_formulas_give_published_indices(number, coefficients, um, n, difference, tmp_path):
    text = f"DATA:\n  - type: formula {number}\n    wavelength_range: 0.4 12\n    coefficients: {coefficients}\n"
    (tmp_path / "a.yml").write_text(text.replace("0.4 12", "0.48 1.2" if um < 1.2 else "2.4 12"))
    material = wd.Material.from_file(tmp_path / "a.yml")
    assert np.interp(1e3 * um, material.wavelengths_nm, material.n) == pytest.approx(n, abs=difference)


def test_formulas_with_wrong_coefficients_are_refused(tmp_path):
    text = "DATA:\n  - type: formula {}\n    wavelength_range: 0.4 1\n    coefficients: {}\n"
    for number, coefficients, message in (
        ("9", "1 2 3", "formula 9 must have 6 coefficients, got 3"),
        ("5", "1.5" + 11 * " 0", "formula 5 must have 1 to 11 coefficients, got 12"),
        ("7", "3.4" + 6 * " 0", "formula 7 must have 1 to 6 coefficients, got 7"),
        ("3", "1 0.1x 2", "coefficients of formula 3 must be numbers, got '1 0.1x 2'"),
        ("10", "1", "formula 10 is not supported: use a table, or formula 1 to 9"),
    ):
        (tmp_path / "a.yml").write_text(text.format(number, coefficients))
        with pytest.raises(ValueError, match=re.escape(message)):
            wd.Material.from_file(tmp_path / "a.yml")


BAD = {
    "ior must not be given with material": lambda: wd.reflectance(flat(), UP, UP, ior=1.5, material=GOLD),
    "n must be a finite number, more than 1": lambda: wd.Material.dielectric(1.0),
    "symbol must be one of 'Al', 'Ag'": lambda: wd.Material.metal("Fe"),
    "k must lie within 0 to 100": lambda: wd.Material([500.0], 1.5, -0.1),
    "k must have one number": lambda: wd.Material([500.0, 600.0], 1.5, [0.1, 0.2, 0.3]),
    "strictly increasing": lambda: wd.Material([600.0, 500.0], 1.5),
    "only one film layer is supported": lambda: FILM.coated(GOLD, 10.0),
    "thickness_nm must be a finite number, more than 0 and at most 1000": lambda: GOLD.coated(GOLD, 2000.0),
    "film must be a material without": lambda: wd.Material([500.0], 1.5, film=FILM, film_nm=10.0),
    "is tabulated from 400 to 600 nm": lambda: wd.reflectance(
        flat(), UP, UP, material=wd.Material([400.0, 600.0], [1.5, 1.5])
    ),
    "angle_deg must lie within 0 to 90": lambda: GOLD.reflectance(500.0, [10.0, 91.0]),
    "k must lie within 0 to 100, got 1 to 101": lambda: wd.Material([500.0, 600.0], 1.5, [1.0, 101.0]),
    "is tabulated from 450 to 650 nm": lambda: wd.Material([450.0, 650.0], [1.5, 1.5]).reflectance([500.0, 700.0], 0.0),
    "must broadcast": lambda: GOLD.reflectance([500.0, 600.0], [0.0, 1.0, 2.0]),
    "material must cover 150 to 150 nm": lambda: GOLD.reflectance(150.0, 0.0),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_materials_are_refused(message):
    with pytest.raises(ValueError, match=message):
        BAD[message]()


def flat():
    return wd.HeightField(np.zeros((64, 64)), 0.09)


def mirrored(material, angle):
    """Return XYZ of a flat surface of a material in the mirror direction, summed over wavelengths in steps of 1 nm."""
    wavelengths = np.arange(380, 781)
    reflected = flat_materials.reflectance(material, 1e-3 * wavelengths, math.cos(math.radians(angle)))
    to_light, to_view = at_angle(angle)[None], at_angle(-angle)[None]
    gain = reference.gain(to_light, to_view, ior=math.inf)[0]
    return gain * reflected @ colorimetry.colour_products()


@pytest.mark.parametrize("name", ["Au", "Cr", "glass", "a film on aluminium"])
@pytest.mark.parametrize("nodes", [0, 32], ids=["sampled", "table"])
def test_a_flat_material_has_its_colour_at_every_angle(name, nodes):
    """In the mirror direction, the colour of a flat material must equal the integral of its reflectance R(θ, λ) over λ.

    This must hold for sums over sampled wavelengths and for look-ups in a table of colours.
    """
    heightfield, angles = flat(), (0.0, 30.0, 60.0, 75.0)
    plan = dataclasses.replace(
        wd.plan(heightfield, method="low-rank", coherence=wd.Coherence(sigma_um=4.0)), rings_per_octave=nodes,
        azimuths_per_width=1.3 * (nodes > 0),
    )  # fmt: skip
    lights, views = at_angle(np.array(angles)), at_angle(-np.array(angles))
    xyz = wd.reflectance(heightfield, lights, views, plan=plan, material=MATERIALS[name])
    expected = np.array([mirrored(MATERIALS[name], angle) for angle in angles])
    np.testing.assert_allclose(xyz, expected, rtol=3e-3)


def test_all_evaluations_agree_on_gold():
    heightfield, wavelengths = wd.gratings.blazed(2.5, 0.25), np.array([450.0, 550.0, 650.0])
    to_light, to_view = at_angle(20.0), at_angle(-7.0)
    half = (to_light + to_view) / np.linalg.norm(to_light + to_view)
    reflected = flat_materials.reflectance(GOLD, 1e-3 * wavelengths, half @ to_view)
    options = {"coherence": wd.Coherence(sigma_um=5.0)}
    mirror = wd.spectral_reflectance(heightfield, to_light, to_view, wavelengths, ior=math.inf, **options)
    for method in ("auto", "direct"):
        rho = wd.spectral_reflectance(
            heightfield, to_light, to_view, wavelengths, material=GOLD, method=method, **options
        )
        np.testing.assert_allclose(rho, reflected * mirror, rtol=1e-4)
    absolute = wd.brdf(heightfield, to_light, to_view, wavelengths, ior=math.inf, **options)
    gold = wd.brdf(heightfield, to_light, to_view, wavelengths, material=GOLD, **options)
    np.testing.assert_allclose(gold, reflected * absolute, rtol=1e-4)
    orders = wd.order_efficiencies(heightfield, to_light, wavelengths, material=GOLD, energy="stam")
    mirrors = wd.order_efficiencies(heightfield, to_light, wavelengths, ior=math.inf, energy="stam")
    halves = to_light + orders.to_view
    cosines = np.linalg.norm(halves, axis=-1) / 2.0
    expected = flat_materials.reflectance(GOLD, 1e-3 * wavelengths[:, None], cosines) * mirrors.efficiencies
    np.testing.assert_allclose(orders.efficiencies, np.where(np.isfinite(cosines), expected, 0.0), rtol=1e-9)
