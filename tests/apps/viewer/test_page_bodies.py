"""Sample meshes of the viewer: disk cache, framing by the camera, and local directions."""

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.apps.viewer import page_bodies
from warpdiff.apps.viewer.page_calls import Call
from warpdiff.device.devices import resolve_device
from warpdiff.scene.mesh_import import prepare_surface


def test_sample_bodies_are_cached_on_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("warpdiff.core.disk_cache._LEAST_SECONDS", 0.0)
    call = Call.of("meshes.tube", segments_along=12, segments_around=6)
    first = page_bodies.surface_of(call, None)
    assert len(list(tmp_path.iterdir())) == 1
    make = Call.make
    # The replaced ``Call.make`` fails only for the tested mesh, because rendering threads of other tests may make other
    # meshes.
    monkeypatch.setattr(
        Call, "make", lambda other: pytest.fail("the cache is not used") if other is call else make(other)
    )
    cached = page_bodies.surface_of(call, None)
    for name, value in vars(first).items():
        assert type(getattr(cached, name)) is type(value), name
        np.testing.assert_array_equal(getattr(cached, name), value)
    assert prepare_surface(cached) is cached


def test_a_framed_body_fills_the_picture_and_is_not_cut_off():
    for name in ("disc", "tube"):
        surface = prepare_surface(getattr(wd.meshes, name)())
        for width, height in ((80, 60), (40, 60)):
            view = page_bodies.framed(surface, width, height)
            renderer = wd.Renderer(
                surface, wd.gratings.blazed(2.0, 0.1), wd.DirectionalLight((0, 1, 1)), view, tolerance=0.5,
                coherence=wd.Coherence(sigma_um=2.0), refine=False,
            )  # fmt: skip
            mask = renderer.image().mask
            rows, columns = np.nonzero(mask)
            assert not np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).any()
            assert max(np.ptp(rows) / height, np.ptp(columns) / width) > 0.75


def test_the_local_direction_to_a_light_at_the_eye_equals_the_view_direction():
    surface = prepare_surface(wd.meshes.tube())
    view = page_bodies.framed(surface, 40, 30)
    options = {"smooth": True, "device": resolve_device(None), "threads": 1}
    for column, row in ((14, 14), (25, 14)):
        near = page_bodies.local_directions(surface, view, wd.PointLight(view.eye), column, row, **options)
        np.testing.assert_allclose(near.to_light, near.to_view, atol=1e-5)
        towards = np.subtract(view.eye, surface.centre)
        far = page_bodies.local_directions(surface, view, wd.DirectionalLight(towards), column, row, **options)
        assert np.linalg.norm(np.subtract(far.to_light, near.to_light)) > 1e-3
