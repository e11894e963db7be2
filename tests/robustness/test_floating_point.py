"""Valid arguments cause no floating-point error, although NumPy is set to raise on each one; underflow gives zero."""

import numpy as np
import pytest

import warpdiff as wd

SHORT = wd.Coherence(sigma_um=3.25)
SOURCE = wd.Coherence("source", angular_diameter_deg=4.0)
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))


@pytest.fixture(autouse=True)
def raising():
    with np.errstate(all="raise"):
        yield


@pytest.fixture(scope="module")
def fingers():
    with np.errstate(all="raise"):
        return wd.gratings.fingers(size_um=6.4, seed=1)


def view():
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), width=40, height=30)


def test_surfaces_and_meshes_cause_no_floating_point_error(fingers):
    heights = np.array(fingers.heights_um)
    heights[10, 10] += 5.0
    despiked = wd.HeightField(heights, fingers.pitch_um).despiked()
    np.testing.assert_allclose(despiked.heights_um, fingers.heights_um, atol=0.1)
    assert not wd.HeightField(np.zeros((40, 40)), 0.1).despiked().heights_um.any()
    assert len(wd.meshes.snake().faces) > 0
    assert wd.HeightField(np.full((4, 4), 1e-200) * np.arange(4), 0.05).rms_um == 0.0


@pytest.mark.parametrize("coherence", [SHORT, SOURCE], ids=["averaged", "source"])
@pytest.mark.parametrize("method", ["auto", "taylor", "taylor-uncentred"])
def test_reflectances_cause_no_floating_point_error(fingers, coherence, method):
    to_view = np.random.default_rng(0).normal(size=(300, 3))
    to_view[:, 2] = np.abs(to_view[:, 2]) + 0.05
    options = {"coherence": coherence, "method": method, "tolerance": 0.2, "strict": False}
    assert np.isfinite(wd.reflectance(fingers, (0.3, 0.1, 1.0), to_view, **options)).all()


# A light with a power of 1e-300 has the power 0 in float32. The warning that no light illuminates the picture is then
# correct. It is therefore ignored.
@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
@pytest.mark.parametrize("power", [1e-300, 1e-40, 1e-20, 1e12])
def test_pictures_of_any_power_are_finite(fingers, power, tmp_path):
    light = wd.DirectionalLight(LIGHT.to_light, power=power)
    mesh = wd.meshes.tube(segments_along=24, segments_around=16)
    image = wd.shade(mesh, fingers, light, view(), coherence=SHORT, tolerance=0.2)
    assert np.isfinite(image.xyz).all()
    assert np.isfinite(image.error).all()
    for name in ("a.png", "a.exr"):
        assert image.save(tmp_path / name).is_file()
