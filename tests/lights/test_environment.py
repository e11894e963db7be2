"""Environments: mirrors and gratings under them, pigment and shadows, and skies as backgrounds of pictures.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. ρ is the reflectance relative to a flat mirror, and σ the standard deviation of the coherence
window.
"""

import copy
import dataclasses
import math

import numpy as np
import pytest
import trimesh
from conftest import slow, write_image

import warpdiff as wd
from bench.truth.sky_sums import SkySums
from warpdiff.lights import sky_distribution, sky_grid
from warpdiff.lights.sky_grid import extract_suns
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import colour_science
from warpdiff.render import picture

WINDOW = wd.Coherence(sigma_um=8.0)
UNDER = {"coherence": WINDOW, "tolerance": 1e-1, "ior": math.inf, "refine": False, "pigment": 0.0}


def middles(height):
    """Return directions to the pixels of an environment map, (height, 2 height, 3), and their solid angles."""
    polar = (np.arange(height) + 0.5) / height * math.pi
    azimuth = ((np.arange(2 * height) + 0.5) / height - 1.0) * math.pi
    level = np.sin(polar)[:, None]
    along = [level * np.sin(azimuth), np.cos(polar)[:, None] + 0.0 * azimuth, -level * np.cos(azimuth)]
    edges = np.cos(np.arange(height + 1) / height * math.pi)
    return np.stack(along, axis=-1), (edges[:-1] - edges[1:])[:, None] * math.pi / height


def spectrum_of_a_sky(sigma_um):
    """Return the spectrum of a grey sky's reflection under a coherence window, D65 over λ², and the factor of its
    brightness.

    The factor is the mean of 4πσ²/λ², weighted by the contribution of each wavelength to Y.
    """
    nm, products = np.arange(380.0, 781.0), colorimetry.colour_products("D65")[:, 1]
    d65 = colour_science().SDS_ILLUMINANTS["D65"].copy()
    spectrum = wd.Spectrum(nm, np.interp(nm, d65.wavelengths, d65.values) / nm**2)
    return spectrum, 4.0 * math.pi * sigma_um**2 * (products / (nm * 1e-3) ** 2).sum() / products.sum()


def seen_at(degrees):
    """Return an orthographic camera of a few pixels whose axis is at an angle of ``degrees`` to the z-axis, and along
    no coordinate axis.
    """
    angle = math.radians(degrees)
    eye = (4 * math.sin(angle) * 0.6, 4 * math.sin(angle) * 0.8, 4 * math.cos(angle))
    return wd.View.orthographic(eye, (0, 0, 0), up=(0, 1, 0.3), extent_y=0.3, width=4, height=3)


@pytest.mark.parametrize(
    ("degrees", "tolerance", "within"), [slow(40.0, 3e-2, 0.015), slow(40.0, 1e-1, 0.02), (80.0, 1e-1, 0.02)]
)
def test_colours_under_a_sky_are_sums_of_the_reflectance_over_all_directions(degrees, tolerance, within, square):
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.08)
    along = middles(64)[0]
    grey = 1.0 + 0.8 * along[..., 1] + 0.5 * np.sin(3.0 * along[..., 0] + 1.0)
    window = wd.Coherence(sigma_um=4.0)
    view = seen_at(degrees)
    sky = wd.Environment(np.repeat(grey[..., None], 3, axis=2), directions=1024)
    result = wd.shade(square, heightfield, sky, view, **UNDER | {"coherence": window, "tolerance": tolerance}).xyz
    # All pixels have the same colour, but different samples of the sky. Their mean has less noise than a single pixel,
    # so that the error of the mean is mainly that of the colour table.
    result = result.mean(axis=(0, 1))
    # The exact colour is a sum over directions to a grey sky of radiance L with the spectrum of D65. A solid angle dω
    # adds ρ L dω / Ω to the reflected radiance, where Ω = λ²/(4πσ²) is the solid angle of the light to which ρ refers.
    # The grid has equal steps of the direction's x and y components, so that dω = dx dy / cos θ.
    step = 0.0125
    x, y = np.meshgrid(np.arange(-1.0 + step / 2, 1.0, step), np.arange(-1.0 + step / 2, 1.0, step))
    inside = x**2 + y**2 < 1.0
    lights = np.stack([x[inside], y[inside], np.sqrt(1.0 - x[inside] ** 2 - y[inside] ** 2)], axis=-1)
    spectrum, per_luminance = spectrum_of_a_sky(4.0)
    rho = wd.reflectance(
        heightfield, lights, np.array(view.eye) / np.linalg.norm(view.eye), illuminant=spectrum, coherence=window,
        ior=math.inf,
    )  # fmt: skip
    radiance = 1.0 + 0.8 * lights[:, 1] + 0.5 * np.sin(3.0 * lights[:, 0] + 1.0)
    exact = step**2 * per_luminance * (radiance / lights[:, 2]) @ rho
    assert result == pytest.approx(exact, rel=within)


def test_a_sun_in_a_black_sky_equals_a_sum_over_its_directions(square):
    # A pixel of the sky is 1.4° wide, and radiances are interpolated linearly between pixel centres. The sun, a single
    # pixel, is therefore a pyramid over 2 × 2 pixels.
    heightfield, window = wd.gratings.fingers(size_um=6.4, pitch_um=0.08), wd.Coherence(sigma_um=3.0)
    spectrum, per_luminance = spectrum_of_a_sky(3.0)
    row, column, view = 50, 130, seen_at(20.0)
    radiance = np.zeros((128, 256, 3))
    radiance[row, column] = 1e3
    offset = np.linspace(-1.0, 1.0, 26)[1:-1]
    down, right = np.meshgrid(offset, offset, indexing="ij")
    weight = (1.0 - np.abs(down)) * (1.0 - np.abs(right)) * (2.0 / 25.0) ** 2 * (math.pi / 128.0) ** 2
    polar, azimuth = (row + 0.5 + down) / 128.0 * math.pi, ((column + 0.5 + right) / 128.0 - 1.0) * math.pi
    azimuth = azimuth - math.radians(150.0)
    along = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], axis=-1
    ).reshape(-1, 3)
    rho = wd.reflectance(
        heightfield, along, np.array(view.eye) / 4.0, illuminant=spectrum, coherence=window, ior=math.inf,
        tolerance=3e-2,
    )  # fmt: skip
    exact = 1e3 * per_luminance * (weight * np.sin(polar)).ravel() @ rho
    sky = wd.Environment(radiance, rotation_deg=150.0, directions=64)
    result = wd.shade(square, heightfield, sky, view, **UNDER | {"coherence": window, "tolerance": 3e-2}).xyz[1, 1]
    assert np.linalg.norm(result - exact) < 0.04 * np.linalg.norm(exact)


def test_a_mirror_under_an_even_sky_is_as_bright_as_the_sky(square):
    degrees, under = 50.0, UNDER | {"masking": False, "coherence": wd.Coherence(sigma_um=4.0)}
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    colours = {}
    for name, rgb in {"white": (1.0, 1.0, 1.0), "red": (0.8, 0.3, 0.1)}.items():
        sky = wd.Environment(np.tile(rgb, (4, 8, 1)), directions=512)
        colours[name] = wd.shade(square, flat, sky, seen_at(degrees), **under).rgb[1, 1]
    assert colours["white"][1] == pytest.approx(1.0, abs=2e-3)
    gold = wd.Material.metal("Au")
    even = wd.Environment(np.ones((4, 8, 3)), directions=512)
    options = under | {"ior": None}
    shown = [
        wd.shade(square, flat, even, seen_at(degrees), **options, material=material).xyz[1, 1]
        for material in (gold, wd.Material([500.0], 1e-3, 100.0))
    ]
    nm = np.arange(380.0, 781.0)
    exact = gold.reflectance(nm, degrees) @ colorimetry.colour_products("D65")
    white = colorimetry.colour_products("D65").sum(axis=0)
    assert shown[0] / shown[1] == pytest.approx(exact / white, abs=2e-3)
    assert colours["red"] == pytest.approx([0.8, 0.3, 0.1], abs=3e-3)


def test_the_horizon_cuts_the_zeroth_order_of_a_mirror_under_an_even_sky(square):
    flat, view = wd.HeightField(np.zeros((32, 32)), 0.09), seen_at(85.0)
    sky = wd.Environment(np.ones((4, 8, 3)), directions=16)
    result = wd.shade(square, flat, sky, view, masking=False, **UNDER).xyz[1, 1, 1]
    # The reflection is a Gaussian over the scattering vector (u, v), the lobe. The exact Y is the share of the lobe
    # above the horizon. The integral is a sum over equal steps of the light's angle, with dω cos θ = du dv.
    nm, radius = np.arange(380.0, 781.0), math.sin(math.radians(85.0))
    deviation = 1e-3 * nm[:, None] / (2.0 * math.sqrt(2.0) * math.pi * 8.0)
    step = math.pi / 2.0 / 4000.0
    angle = (np.arange(4000) + 0.5) * step
    u, w = np.sin(angle) - radius, np.cos(angle) + math.cos(math.radians(85.0))
    gain = (0.5 * (u**2 + w**2) / w) ** 2 / math.cos(math.radians(85.0))
    shares = (gain * np.exp(-0.5 * (u / deviation) ** 2)).sum(axis=1) * step / math.sqrt(2.0 * math.pi)
    products = colorimetry.colour_products("D65")[:, 1]
    exact = (shares / deviation[:, 0]) @ products / products.sum()
    assert exact < 0.8
    assert result == pytest.approx(exact, rel=0.02)


def test_a_rotated_sky_is_rotated_in_a_mirror(square):
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    view, along = seen_at(40.0), middles(32)[0]
    mirrored = np.array([-view.eye[0], -view.eye[1], view.eye[2]]) / 4.0
    turn = math.radians(70.0)
    before = [
        mirrored[0] * math.cos(turn) - mirrored[2] * math.sin(turn), mirrored[1],
        mirrored[0] * math.sin(turn) + mirrored[2] * math.cos(turn),
    ]  # fmt: skip
    patch = np.repeat((along @ before > math.cos(math.radians(25.0)))[..., None].astype(float), 3, axis=2) + 1e-3
    shown = [
        wd.shade(square, flat, wd.Environment(patch, rotation_deg=degrees, directions=32), view, **UNDER).xyz[1, 1, 1]
        for degrees in (0.0, 70.0, -70.0)
    ]
    assert shown[1] > 0.5
    assert max(shown[0], shown[2]) < 0.05


def test_a_sky_is_visible_behind_a_picture(square):
    along = middles(32)[0]
    sky = wd.Environment(0.5 + 0.5 * along, scale=2.0)
    view = wd.View((0.3, 0.2, 5.0), (0, 0, 0), fov_y_deg=70, width=12, height=8)
    behind = sky.background(view)
    frame = view.frame()
    for row, column in ((0, 0), (3, 7), (7, 11)):
        x = frame.half_width * (2.0 * (column + 0.5) / 12 - 1.0)
        y = frame.half_height * (1.0 - 2.0 * (row + 0.5) / 8)
        towards = x * frame.right + y * frame.up - frame.back
        assert behind[row, column] == pytest.approx(1.0 + towards / np.linalg.norm(towards), abs=0.01)
    picture = wd.shade(square, wd.HeightField(np.zeros((8, 8)), 0.09), wd.DirectionalLight((0, 0, 1)), view, **UNDER)
    shown = picture.display(display="clip", exposure=0.5, background=behind)
    empty = ~picture.mask
    linear = 0.5 * behind[empty]
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    assert np.abs(shown[empty] - np.clip(encoded, 0.0, 1.0)).max() < 2e-3
    with pytest.raises(ValueError, match=r"background must be a colour .* or radiances of 12 × 8 pixels, got shape"):
        picture.display(background=np.ones((4, 4, 3)))


def test_environment_files_are_read_and_invalid_ones_are_refused(tmp_path, square):
    given = np.random.default_rng(7).random((8, 16, 3)).astype(np.float32)
    for name, pixels in {"sky.exr": given, "dark.exr": 0.0 * given, "nan.exr": given * math.nan}.items():
        write_image(tmp_path / name, pixels)
    assert np.array_equal(wd.Environment.load(tmp_path / "sky.exr").radiance_rgb, given)
    with pytest.raises(ValueError, match=r"dark\.exr' must have a component above 0"):
        wd.Environment.load(tmp_path / "dark.exr")
    with pytest.raises(ValueError, match=r"nan\.exr' must be finite"):
        wd.Environment.load(tmp_path / "nan.exr")
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(ValueError, match="cannot be read as an image"):
        wd.Environment.load(tmp_path / "text.exr")
    with pytest.raises(FileNotFoundError, match="path: there is no file"):
        wd.Environment.load(tmp_path / "none.exr")
    sky, flat = wd.Environment(given), wd.HeightField(np.zeros((8, 8)), 0.09)
    for coherence in (wd.Coherence("source"), wd.Coherence("centred")):
        with pytest.raises(ValueError, match=r"lights\[0\] must not be an Environment for coherence of kind"):
            wd.shade(square, flat, sky, seen_at(20.0), coherence=coherence)
    with pytest.raises(ValueError, match=r"lights\[0\] has an extent and requires footprints, .*, got Environment\("):
        wd.shade(square, flat, sky, seen_at(20.0), footprint=False)


@dataclasses.dataclass(frozen=True)
class RayOfASky(wd.DirectionalLight):
    """Directional light whose illuminant is a spectral radiance divided by λ², like a ray of a sky."""

    def lobes(self):
        return tuple(dataclasses.replace(lobe, is_of_sky=True) for lobe in super().lobes())


def test_pigment_and_shadows_under_a_sky_equal_those_under_many_lights():
    # The mesh is like an open book, whose halves occlude a part of the sky for each other.
    corners = [[0, 0, -1], [0, 0, 1], [1, 1, 1], [1, 1, -1], [-1, 1, 1], [-1, 1, -1]]
    texture = trimesh.visual.TextureVisuals(
        uv=[[0, 0], [0, 1], [1, 1], [1, 0], [1, 1], [1, 0]],
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[200, 120, 60, 255]),
    )
    book = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 5, 4]], visual=texture, process=False)
    flat = wd.HeightField(np.zeros((8, 8)), 0.09)
    view = wd.View((0.3, 4, 0.5), (0, 0.5, 0), fov_y_deg=22, width=16, height=8)
    along, solid = middles(12)
    grey = 1.2 + along[..., 0]
    sky = wd.Environment(np.repeat(grey[..., None], 3, axis=2), directions=640)
    options = UNDER | {"ior": 1.5, "smooth": False}
    result = [wd.shade(book, flat, sky, view, **options | {"pigment": each}).xyz for each in (0.0, 1.0)]
    spectrum, per_luminance = spectrum_of_a_sky(8.0)
    lamps = [
        RayOfASky(tuple(towards), illuminant=spectrum, power=radiance * share * per_luminance)
        for towards, radiance, share in zip(
            along.reshape(-1, 3), grey.ravel(), np.broadcast_to(solid, grey.shape).ravel(), strict=True
        )
        if towards[1] > -0.8
    ]
    options |= {"footprint": False}
    exact = [wd.shade(book, flat, lamps, view, **options | {"pigment": each}).xyz for each in (0.0, 1.0)]
    below, expected = result[1] - result[0], exact[1] - exact[0]
    visible = expected[..., 1] > 0.0
    assert visible.sum() > 60
    away = np.linalg.norm(below[visible] - expected[visible], axis=1) / np.linalg.norm(expected[visible], axis=1)
    # The reference picture has a directional light every 15°, which is either completely visible or completely
    # occluded. This limits the accuracy of the reference.
    assert np.median(away) < 0.05
    assert np.percentile(away, 90.0) < 0.09


@pytest.mark.slow
def test_a_bright_rectangle_of_the_sky_on_a_tube_equals_a_sum_over_directions():
    # In this view of a tube, the scattering vector (u, v) changes much more along one direction of a pixel than along
    # the other (elongated footprints). Some diffraction orders are partly below the horizon of the surface.
    view = wd.View((1.5, 2, 4), (0, 0, 0), fov_y_deg=4.4, width=20, height=15)
    heightfield, window = wd.gratings.fingers(size_um=6.4, pitch_um=0.08), wd.Coherence(sigma_um=4.0)
    along = middles(64)[0]
    grey = np.where((np.abs(along[..., 1] - 0.3) < 0.25) & (along[..., 0] > 0.4), 2.5, 0.03)
    sums = SkySums(wd.meshes.tube(), heightfield, view, window, shadows=False)
    pixels = sums.interior()[::9]
    assert len(pixels) > 6
    # The reference is a sum over directions with a noise of 2 %. The limits of errors below include this noise.
    exact = sums.under_sky(pixels, grey, 640, 1)
    sky = wd.Environment(np.repeat(grey[..., None], 3, axis=2), directions=4096)
    options = UNDER | {"coherence": window, "ior": None, "shadows": False, "strict": False}
    for refine, median, most in ((False, 0.04, 0.2), (True, 0.06, 0.15)):
        result = wd.shade(wd.meshes.tube(), heightfield, sky, view, **options | {"refine": refine})
        at = pixels[:, 0], pixels[:, 1]
        away = np.linalg.norm(result.xyz[at] - exact, axis=1) / np.linalg.norm(exact, axis=1)
        assert np.median(away) < median
        assert away.max() < most
        # In pixels with an error above 0.1, the estimate ``image.error`` must be at least half of the error.
        assert (result.error[at] > 0.5 * away)[away > 0.1].all()
    assert np.percentile(away, 90.0) < 0.1


def test_no_sun_is_extracted_from_a_uniform_sky():
    # By rounding, the mean radiance of a uniform region of a sky differs slightly from the radiance of its pixels. This
    # difference must not be mistaken for a sun.
    sky = np.full((64, 128, 3), 0.7, dtype=np.float32)
    sky[:20] = 1.19
    assert not extract_suns(sky)[1]
    sky[40, 60] = 1e5
    grid, suns = extract_suns(sky)
    assert len(suns) == 1
    assert grid.max() == pytest.approx(1.19, rel=1e-5)


@pytest.mark.parametrize("shape", [(256, 4096), (2048, 300), (512, 100), (100, 1024), (600, 1200), (100, 150)])
def test_a_sky_of_any_proportions_keeps_the_power_of_a_bright_pixel(shape, monkeypatch):
    monkeypatch.setattr(sky_grid, "_MOST_SUNS", 0)
    height, width = shape
    solid = 2.0 * math.pi / width * np.diff(-np.cos(np.arange(height + 1) / height * math.pi))
    on_grid = np.diff(-np.cos(np.arange(513) / 512 * math.pi))[:, None, None] * 2.0 * math.pi / 1024
    # Interpolation of the sky's image on a grid conserves the power of a pixel only approximately. The sum of the
    # interpolation weights depends on the position of the pixel between the cells of the grid, by up to 1.2 % here.
    row = height // 2 + height // 9
    for column in (0, *range(width // 4, width // 4 + 5), width - 1):
        sky = np.zeros((*shape, 3), dtype=np.float32)
        sky[row, column] = (1e4, 2e4, 3e4)
        grid, suns = extract_suns(sky)
        assert not suns
        assert grid.shape == (512, 1024, 3)
        np.testing.assert_allclose((grid * on_grid).sum(axis=(0, 1)), solid[row] * sky[row, column], rtol=2e-2)


@pytest.mark.parametrize(("shape", "count"), [((64, 128), 1), ((512, 128), 1), ((512, 100), 0), ((50, 1024), 0)])
def test_the_longer_side_of_a_pixel_determines_the_extent_of_a_sun(shape, count):
    # With 64 rows or 128 columns, a pixel has a side of 2.8°; with 50 rows or 100 columns, a side of 3.6°. The largest
    # sun has a radius of 4.5°, which is 1.5 times the side of a pixel of 3.0°.
    sky = np.full((*shape, 3), 0.5, dtype=np.float32)
    sky[shape[0] // 2, shape[1] // 2] = 1e5
    assert len(extract_suns(sky)[1]) == count


def test_a_second_picture_under_the_same_sky_uploads_nothing_and_reuses_the_recording(square, monkeypatch):
    uploads, keys = [], []
    upload, set_lights = sky_distribution.upload_sky, picture.Picture.set_lights

    def counted(*args):
        uploads.append(args)
        return upload(*args)

    def followed(self, *args, **options):
        set_lights(self, *args, **options)
        keys.append(self.graph_key)

    monkeypatch.setattr(sky_distribution, "upload_sky", counted)
    monkeypatch.setattr(picture.Picture, "set_lights", followed)
    flat, lights = wd.HeightField(np.zeros((8, 8)), 0.09), [wd.Environment(np.ones((4, 8, 3)), directions=16)]
    renderer = wd.Renderer(square, flat, lights, seen_at(20.0), **UNDER)
    first = renderer.draw(lights).numpy().copy()
    second = renderer.draw(lights, seen_at(20.0)).numpy()
    assert len(uploads) == 1
    assert len(keys) == 3
    assert len(set(keys)) == 1
    np.testing.assert_array_equal(first, second)
    # A picture of the same sky in another view must reuse the sky's arrays on the device. An equal sky that is another
    # object must get new arrays, and kernel launches must then be recorded again.
    wd.shade(square, flat, lights, seen_at(20.0), **UNDER)
    assert len(uploads) == 1
    renderer.draw(wd.Environment(np.ones((4, 8, 3)), directions=16))
    assert len(uploads) == 2
    assert keys[-1] != keys[0]


def test_an_environment_caches_few_parts_and_its_copies_none():
    sky = wd.Environment(0.5 + 0.5 * middles(16)[0], directions=16)

    def parts(environment, sigma_um):
        coherence = wd.Coherence(sigma_um=sigma_um)
        return environment.parts(coherence, single_lobe=False, name="lights[0]")

    first = parts(sky, 8.0)
    assert parts(sky, 8.0) is first
    others = [parts(sky, sigma_um) for sigma_um in (4.0, 5.0, 6.0, 7.0)]
    assert len({id(each[0].grid) for each in others} | {id(first[0].grid)}) == 5
    assert parts(sky, 7.0) is others[-1]
    again = parts(sky, 8.0)
    assert again is not first
    np.testing.assert_array_equal(again[0].grid.powers, first[0].grid.powers)
    copied = copy.copy(sky)
    assert "_parts" not in vars(copied)
    np.testing.assert_array_equal(parts(copied, 8.0)[0].grid.powers, first[0].grid.powers)
    assert repr(copied) == "Environment(16 × 32 pixels, rotation_deg=0, scale=1, directions=16)"
    assert copied != sky


@pytest.mark.parametrize("light", ["sky", "disc"])
def test_the_rays_of_a_pixel_share_its_samples(light, square):
    """More rays per pixel must not change the noise of a pixel.

    The number of samples of a light per pixel does not depend on the number of rays; the rays of a pixel share these
    samples.
    """
    flat, view = wd.gratings.fingers(size_um=6.4, pitch_um=0.08), seen_at(40.0)
    lights = wd.DirectionalLight((0.3, 0.5, 1.0), angular_diameter_deg=20.0)
    if light == "sky":
        lights = wd.Environment(np.repeat(1.0 + 0.8 * middles(16)[0][..., 1:2], 3, axis=2), directions=64)
    spread = []
    for samples in (1, 4, 64):
        image = wd.shade(square, flat, lights, view, **UNDER, samples_per_pixel=samples)
        spread.append(float(np.std(image.xyz[..., 1]) / image.xyz[..., 1].mean()))
    # The more random directions to a disc light are drawn, the less each of them is blurred. The noise may therefore
    # increase, up to a factor of 2.
    assert max(spread[1:]) < 2.0 * spread[0]


@pytest.mark.parametrize("channel", range(3))
def test_a_sky_of_one_primary_colour_illuminates_a_surface(channel, square):
    radiance = np.zeros((4, 8, 3))
    radiance[..., channel] = 1.0
    image = wd.shade(square, wd.gratings.sinusoidal(1.0, 0.05), wd.Environment(radiance), seen_at(10.0), **UNDER)
    assert image.illuminated.all()
    assert np.argmax(image.rgb.mean(axis=(0, 1))) == channel
