"""Cameras: orientation, framing, and invalid arguments."""

import dataclasses
import math

import numpy as np
import pytest
import trimesh

import warpdiff as wd
from warpdiff.scene.camera import View
from warpdiff.scene.mesh_import import prepare_surface

EYE, TARGET = (0.0, 0.0, 5.0), (0.0, 0.0, 0.0)


def test_the_camera_looks_along_its_minus_z():
    frame = View(EYE, TARGET).frame()
    np.testing.assert_allclose(frame.right, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(frame.up, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(frame.back, [0, 0, 1], atol=1e-15)
    np.testing.assert_array_equal(frame.origin, EYE)
    assert not frame.orthographic


def test_the_axes_are_right_handed_and_orthonormal(rng):
    for _ in range(20):
        eye, target, up = rng.normal(size=(3, 3)) * 10.0 ** rng.integers(-6, 7)
        frame = View(eye, target, up=up).frame()
        axes = np.stack([frame.right, frame.up, frame.back])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert frame.up @ up > 0.0


def test_the_field_of_view_is_vertical_and_pixels_are_square():
    frame = View(EYE, TARGET, fov_y_deg=60, width=200, height=100).frame()
    assert frame.half_height == pytest.approx(math.tan(math.radians(30)))
    assert frame.half_width == pytest.approx(2.0 * frame.half_height)


def test_the_orthographic_extent_is_the_image_height():
    view = View.orthographic(EYE, TARGET, extent_y=3.0, width=200, height=100)
    frame = view.frame()
    assert frame.orthographic
    assert (frame.half_width, frame.half_height) == (3.0, 1.5)
    assert (view.width, view.height) == (200, 100)


def test_views_are_compared_by_value_and_cannot_be_changed():
    assert View(np.array(EYE), list(TARGET)) == View(EYE, TARGET)
    assert len({View(EYE, TARGET), View(EYE, TARGET)}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        View(EYE, TARGET).width = 3
    assert dataclasses.replace(View(EYE, TARGET), width=3).width == 3


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [({"eye": (1, 2)}, ValueError, "eye must be 3 numbers"),
     ({"eye": "here"}, TypeError, "eye must be an array"),
     ({"up": (0, 0, -2e-9)}, ValueError, "up must not be parallel"),
     ({"up": (0, 0, 0)}, ValueError, "up must not contain zero"),
     ({"up": (0, 1e16, 0)}, ValueError, "up must lie within"),
     ({"fov_y_deg": 180}, ValueError, "fov_y_deg must be less than 180, got 180"),
     ({"height": True}, TypeError, "height must be an integer"),
     ({"extent_y": 1e-16}, ValueError, "extent_y must be at least 1e-15")],
)  # fmt: skip
def test_invalid_views_are_refused(changed, error, message):
    arguments = {"eye": EYE, "target": TARGET} | changed
    eye, target = arguments.pop("eye"), arguments.pop("target")
    with pytest.raises(error, match=message):
        View(eye, target, **arguments)


@pytest.mark.parametrize("extent_y", [0.0, -1.0, math.inf])
def test_invalid_extents_are_refused(extent_y):
    with pytest.raises(ValueError, match="extent_y must be"):
        View.orthographic(EYE, TARGET, extent_y=extent_y)


def shares(view, points):
    """Return the positions |x| and |y| at which points appear in the picture, shape (2, n); 1 is its edge."""
    frame = view.frame()
    rays = points - frame.origin
    depth = -rays @ frame.back
    return np.abs([rays @ frame.right / depth / frame.half_width, rays @ frame.up / depth / frame.half_height])


@pytest.mark.parametrize("direction", [None, (0, 0, 1e-200), (-1, 2, 3)])
@pytest.mark.parametrize("size", [{}, {"width": 100, "height": 300, "fov_y_deg": 70}])
def test_a_view_of_a_turning_mesh_contains_its_sphere(direction, size, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    ball.apply_translation((5, 6, 7))
    view = View.fit(ball, direction, **size, turning=True)
    np.testing.assert_allclose(view.target, (5, 6, 7), atol=1e-12)
    # The mesh is a ball. The sphere around its bounding box has √3 times the radius of the ball. The picture must
    # contain this sphere. The sphere touches the two edges of the picture that are nearer to its centre.
    largest = shares(view, math.sqrt(3.0) * (ball.vertices - (5, 6, 7)) + (5, 6, 7)).max(axis=1)
    assert 0.99 < largest.max() < 1.0
    expected = View((0, 0.6, 1) if direction is None else direction, (0, 0, 0)).frame().back
    np.testing.assert_allclose(view.frame().back, expected, atol=1e-12)
    ball.export(tmp_path / "ball.ply")
    for same in (trimesh.Scene(ball), prepare_surface(ball, tangents=(1, 2, 3)), tmp_path / "ball.ply"):
        again = View.fit(same, direction, **size, turning=True)
        np.testing.assert_allclose(again.eye, view.eye, rtol=1e-5)


@pytest.mark.parametrize("direction", [None, (0.3, 1.0, 0.2), (-1, 2, 3)])
@pytest.mark.parametrize("size", [{}, {"width": 100, "height": 300, "fov_y_deg": 70}])
@pytest.mark.parametrize("target", [None, (5.5, 6.0, 7.5)])
def test_a_view_of_a_mesh_fills_the_image(direction, size, target, tmp_path):
    """The mesh must leave a margin of 4 % at two opposite edges of the picture, or at one edge with ``target=``."""
    tube = wd.meshes.tube()
    tube.apply_transform(trimesh.transformations.translation_matrix((5, 6, 7)))
    view = View.fit(tube, direction, target=target, **size)
    frame = view.frame()
    rays = tube.vertices - frame.origin
    depth = -rays @ frame.back
    assert depth.min() > 0.0
    places = np.stack([rays @ frame.right / depth / frame.half_width, rays @ frame.up / depth / frame.half_height])
    assert np.abs(places).max() == pytest.approx(0.92, abs=1e-6)
    if target is None:
        # Without a target, the mesh is centred between two opposite edges of the picture: the left and the right edge,
        # or the top and the bottom edge if these are nearer to the mesh.
        limits = np.stack([-places.min(axis=1), places.max(axis=1)])
        assert limits.min(axis=0).max() == pytest.approx(0.92, abs=1e-6)
    else:
        assert view.target == target
    tube.export(tmp_path / "tube.ply")
    for same in (trimesh.Scene(tube), prepare_surface(tube, tangents=(1, 2, 3)), tmp_path / "tube.ply"):
        again = View.fit(same, direction, target=target, **size)
        np.testing.assert_allclose(again.eye, view.eye, rtol=1e-5)


@pytest.mark.parametrize(
    "points", [[[1.0, 2.0, 3.0]] * 2 + [[1.0, 2.0, 3.5]], [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]]
)
def test_a_view_of_a_line_is_in_front_of_it(points):
    line = trimesh.Trimesh(points, [[0, 1, 2]], process=False)
    for direction in ((0, 0, 1), (1, 0, 1)):
        view = View.fit(line, direction)
        assert (-(line.vertices - view.frame().origin) @ view.frame().back).min() > 0.0


def test_a_view_frames_a_mesh_around_a_target_and_along_any_up():
    box = trimesh.creation.box()
    centre, moved = View.fit(box, turning=True), View.fit(box, target=(0.3, 0.2, -0.1), turning=True)
    assert moved.target == (0.3, 0.2, -0.1)
    np.testing.assert_allclose(moved.frame().back, centre.frame().back, atol=1e-12)
    # All corners of the mesh must stay in the picture, for any rotation of the mesh around ``target``, the point in the
    # middle.
    for angle in np.linspace(0.0, 2.0 * math.pi, 24):
        turned = trimesh.transformations.rotation_matrix(angle, (0, 1, 0), moved.target)
        assert shares(moved, trimesh.transform_points(box.vertices, turned)).max() < 1.0
    view = View.fit(box, up=(0, 0, 2))
    np.testing.assert_allclose(view.frame().back, np.array([0, -1, 0.6]) / math.hypot(1, 0.6), atol=1e-12)
    # `View.fit` must ignore the colours and textures of the mesh, even if they are damaged.
    box.visual.face_colors = np.full((12, 3), 200)
    assert View.fit(box, turning=True) == centre


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [({"direction": (0, 0, 0)}, ValueError, "direction must not contain zero"),
     ({"direction": (0, -3, 0)}, ValueError, "up must not be parallel"),
     ({"direction": (1, 2)}, ValueError, "direction must be a vector of 3"),
     ({"up": (0, 0, 0)}, ValueError, "up must not contain zero"),
     ({"fov_y_deg": 180}, ValueError, "fov_y_deg must be less than 180"),
     ({"height": 0}, ValueError, "height must be an integer"),
     ({"target": "there"}, TypeError, "target must be an array"),
     ({"mesh": "no.obj"}, FileNotFoundError, r"the mesh file 'no\.obj' does not exist"),
     ({"mesh": None}, TypeError, "mesh must be a trimesh.Trimesh")],
)  # fmt: skip
def test_invalid_arguments_of_fit_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        View.fit(**{"mesh": trimesh.creation.box()} | arguments)
