"""Dots of grating maps at hits, and transforms of samples to the frames of dots, compared with NumPy."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall, launch_pipeline
from warpdiff.kernels import dot_transforms
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

ROWS, COLUMNS = 3, 5


def _scene(rays: int, rng: np.random.Generator) -> tuple[Camera, SurfaceArrays, Pixels, np.ndarray]:
    """Return a camera above a triangle with linear texture coordinates, hits on it, and the coordinates of the hits."""
    mesh, pixels, camera = SurfaceArrays(), Pixels(), Camera()
    corners = np.array([[-3.0, -3.0, 0.0], [5.0, -3.0, 0.0], [-3.0, 5.0, 0.0]], dtype=np.float32)
    mesh.positions = wp.array(corners, dtype=wp.vec3f, device="cpu")
    mesh.faces = wp.array(np.array([[0, 1, 2]], dtype=np.int32), dtype=wp.int32, device="cpu")
    # The texture coordinates of a point (x, y) are (x, y).
    mesh.uvs = wp.array(corners[:, :2].copy(), dtype=wp.vec2f, device="cpu")
    place = rng.dirichlet(np.ones(3), rays)
    hit = np.ones(rays, dtype=np.int32)
    hit[3::7] = 0
    pixels.hit = wp.array(hit, dtype=wp.int32, device="cpu")
    pixels.face = wp.array(hit - 1, dtype=wp.int32, device="cpu")
    pixels.place = wp.array(place[:, :2].astype(np.float32), dtype=wp.vec2f, device="cpu")
    pixels.to_view = wp.array(np.tile([0.0, 0.0, 1.0], (rays, 1)).astype(np.float32), dtype=wp.vec3f, device="cpu")
    # An orthographic camera whose pixels are 0.5 wide and 0.25 high.
    axes = [[0.0, 0.0, 10.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [2.0, 1.0, 0.0]]
    camera.axes = wp.array(np.array(axes), dtype=wp.vec3d, device="cpu")
    camera.orthographic, camera.width, camera.height = True, 8, 8
    return camera, mesh, pixels, place @ corners[:, :2]


def _dots(uv: np.ndarray) -> np.ndarray:
    column = np.floor((uv[:, 0] % 1.0) * COLUMNS)
    row = ROWS - 1 - np.floor((uv[:, 1] % 1.0) * ROWS)
    return (row * COLUMNS + column).astype(int)


def _found(
    camera: Camera, mesh: SurfaceArrays, pixels: Pixels, shape: tuple[int, int], across: int, *, repeats: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Return the dots at all hits, and the shares of the subpixel cells in up to four dots."""
    rays = len(pixels.hit)
    outputs = [wp.zeros(rays, dtype=dtype, device="cpu") for dtype in (wp.int32, wp.vec4f)]
    call = KernelCall(dot_transforms.find_dots, [camera, mesh, pixels, *shape, repeats, across], outputs, in_runs=True)
    launch_pipeline([call], rays, device=wp.get_device("cpu"), threads=1)
    return outputs[0].numpy(), outputs[1].numpy()


def test_dots_at_hits_repeat_and_row_0_is_on_top(rng: np.random.Generator) -> None:
    camera, mesh, pixels, uv = _scene(500, rng)
    dots, shares = _found(camera, mesh, pixels, (ROWS, COLUMNS), 1)
    hit = pixels.hit.numpy() != 0
    assert np.all(dots[~hit] == -1)
    # A dot is a small rectangle of a grating map. Points that are closer to the edge of a dot than the rounding error
    # may be on either side of it.
    away = np.min(np.abs((uv * [COLUMNS, ROWS]) % 1.0 - 0.5), axis=1) < 0.499
    np.testing.assert_array_equal(dots[hit & away], _dots(uv)[hit & away])
    np.testing.assert_array_equal(shares, np.tile([1.0, 0.0, 0.0, 0.0], (500, 1)))


def test_shares_of_cells_in_dots_are_areas(rng: np.random.Generator) -> None:
    """A subpixel cell that overlaps up to two dots along each axis of a grating map has its exact shares in them.

    The shares are compared with the fractions of 200 × 200 points of the cell. The camera is rolled by 25°, so that
    cells are parallelograms in texture coordinates.
    """
    rays, across = 300, 4
    camera, mesh, pixels, uv = _scene(rays, rng)
    axes = camera.axes.numpy()
    roll = math.radians(25.0)
    axes[1] = [math.cos(roll), math.sin(roll), 0.0]
    axes[2] = [-math.sin(roll), math.cos(roll), 0.0]
    camera.axes = wp.array(axes, dtype=wp.vec3d, device="cpu")
    dots, shares = _found(camera, mesh, pixels, (ROWS, COLUMNS), across)
    steps = (np.arange(200) + 0.5) / 200 - 0.5
    right, up = (steps[:, None] * side * axes[axis, :2] / across for axis, side in ((1, 0.5), (2, 0.25)))
    hits = np.flatnonzero(pixels.hit.numpy())
    kinds = set()
    for ray in hits:
        inside = _dots((uv[ray] + right[:, None] + up[None]).reshape(-1, 2))
        row, column = divmod(int(dots[ray]), COLUMNS)
        own = [((row - k // 2) % ROWS) * COLUMNS + (column + k % 2) % COLUMNS for k in range(4)]
        expected = [np.mean(inside == dot) for dot in own]
        np.testing.assert_allclose(shares[ray], expected, atol=0.01)
        kinds.add(int(np.count_nonzero(shares[ray])))
    assert kinds >= {1, 2, 4}
    np.testing.assert_allclose(shares[hits].sum(axis=1), 1.0, atol=1e-6)


def test_maps_that_do_not_repeat_end_at_the_border(rng: np.random.Generator) -> None:
    """Without texture coordinates beyond 0 to 1, a cell at the border of the mesh has no share in the opposite dots."""
    camera, mesh, pixels, _ = _scene(4, rng)
    places = []
    for x, y in ((0.01, 0.5), (0.99, 0.5), (0.5, 0.01), (0.5, 0.99)):
        second, third = (x + 3.0) / 8.0, (y + 3.0) / 8.0
        places.append((1.0 - second - third, second))
    pixels.hit.fill_(1)
    pixels.face.fill_(0)
    pixels.place = wp.array(np.array(places, dtype=np.float32), dtype=wp.vec2f, device="cpu")
    dots, shares = _found(camera, mesh, pixels, (1, 1), 2, repeats=False)
    np.testing.assert_array_equal(dots, 0)
    np.testing.assert_array_equal(shares[:, 0], 1.0)
    dots, shares = _found(camera, mesh, pixels, (3, 3), 2, repeats=True)
    assert np.all(shares[:, 0] < 1.0)


def test_cells_of_exactly_two_dots_are_divided(rng: np.random.Generator) -> None:
    """A subpixel cell that has the size of two dots along each axis has a quarter of its area in each of four dots."""
    across = 2
    camera, mesh, pixels, _ = _scene(1, rng)
    pixels.hit.fill_(1)
    pixels.face.fill_(0)
    # The pixel is 0.5 wide and 0.25 high, so that its cells are 0.25 wide and 0.125 high. The middle is at an edge.
    pixels.place = wp.array(np.array([[1.0 - 3.25 / 8.0 - 3.5 / 8.0, 3.25 / 8.0]]), dtype=wp.vec2f, device="cpu")
    _, shares = _found(camera, mesh, pixels, (16, 8), across)
    np.testing.assert_allclose(shares, 0.25, atol=1e-4)


def test_cells_on_many_dots_look_them_up_at_different_positions(rng: np.random.Generator) -> None:
    """A pixel is divided into 4 × 4 cells, each of which overlaps many dots (small rectangles) of a grating map.

    The cells must find the share of the pixel to the left of an edge as accurately as 16 times as many cells would.
    """
    across = 4
    camera, mesh, pixels, _ = _scene(across**2, rng)
    pixels.hit.fill_(1)
    pixels.face.fill_(0)
    centres = (np.arange(across) + 0.5) / across - 0.5
    for edge in np.linspace(0.01, 0.49, 25):
        # The left edge of a dot, at the texture coordinate u = 0, lies within the pixel. Its distance from the pixel's
        # left edge is ``edge``; the pixel is 0.5 wide.
        x = np.tile(centres, across) * 0.5 + 0.25 - edge
        y = 0.1 - np.repeat(centres, across) * 0.25 * 0.01
        second, third = (x + 3.0) / 8.0, (y + 3.0) / 8.0
        place = np.column_stack([1.0 - second - third, second]).astype(np.float32)
        pixels.place = wp.array(place, dtype=wp.vec2f, device="cpu")
        dots, shares = _found(camera, mesh, pixels, (1, 1000), across)
        np.testing.assert_array_equal(shares[:, 0], 1.0)
        # Dots to the left of the edge have u < 0. Because the map repeats, their columns are near 1000.
        share = np.mean(dots >= 500)
        assert abs(share - edge / 0.5) <= 0.5 / across**2 + 1e-6


def test_samples_are_turned_and_scaled(rng: np.random.Generator) -> None:
    rays = 40
    turn, pitch, depth, ratio = math.radians(30.0), 0.8, 0.5, 1.25
    # The map has one row of two dots; the second dot is the one of interest, as the next dot along u.
    transforms = np.array(
        [[[9.0, 9.0, 9.0, 9.0], [pitch * math.cos(turn), pitch * math.sin(turn), depth, ratio]]], dtype=np.float32
    )
    vectors, lights = rng.normal(size=(rays, 3)), rng.normal(size=(rays, 3)).astype(np.float32)
    footprints = rng.normal(size=(rays, 4)).astype(np.float32)
    dots = np.zeros(rays, dtype=np.int32)
    dots[::3] = -1
    shares = np.tile(np.array([0.7, 0.3, 0.0, 0.0], dtype=np.float32), (rays, 1))
    shares[5:9] = [1.0, 0.0, 0.0, 0.0]
    faces = np.arange(rays, dtype=np.int32) % 2
    inputs = [
        wp.array(transforms, dtype=wp.vec4f, device="cpu"), wp.array(dots, dtype=wp.int32, device="cpu"),
        wp.array(shares, dtype=wp.vec4f, device="cpu"), 1,
        wp.array(faces, dtype=wp.int32, device="cpu"), wp.array([7, 9], dtype=wp.int32, device="cpu"), 9,
        wp.array(vectors, dtype=wp.vec3d, device="cpu"), wp.array(lights, dtype=wp.vec3f, device="cpu"),
        wp.array(footprints, dtype=Footprint, device="cpu"),
    ]  # fmt: skip
    outputs = [wp.zeros(rays, dtype=dtype, device="cpu") for dtype in (wp.vec3d, wp.vec3f, Footprint)]
    call = KernelCall(dot_transforms.transform_samples, inputs, outputs, in_runs=True)
    launch_pipeline([call], rays, device=wp.get_device("cpu"), threads=1)
    own = (dots == 0) & (faces == 1) & (shares[:, 1] > 0.0)
    back = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    exact = np.column_stack([pitch * vectors[:, :2] @ back.T, depth * vectors[:, 2]])
    np.testing.assert_allclose(outputs[0].numpy()[own], exact[own], rtol=1e-6, atol=1e-6)
    exact = ratio * np.column_stack([lights[:, :2] @ back.T, lights[:, 2]])
    np.testing.assert_allclose(outputs[1].numpy()[own], exact[own], rtol=1e-5, atol=1e-5)
    exact = (pitch * footprints.reshape(rays, 2, 2) @ back.T).reshape(rays, 4)
    np.testing.assert_allclose(outputs[2].numpy()[own], exact[own], rtol=1e-5, atol=1e-5)
    for output in outputs:
        assert np.all(output.numpy()[~own] == 0.0)


def test_gains_have_the_ratio_of_reflectances_at_half_the_angle_of_light_and_viewer(rng: np.random.Generator) -> None:
    """The ratio must be interpolated over the cosine of this angle, |(u, v, w)|/2, limited to 1."""
    rays, part = 60, 2
    vectors, gains, shares = rng.normal(size=(rays, 3)), rng.uniform(size=rays), rng.uniform(size=(rays, 4))
    lengths = np.concatenate([[0.0, 2.0, 2.1], rng.uniform(0.0, 2.0, rays - 3)])
    vectors *= (lengths / np.linalg.norm(vectors, axis=1))[:, None]
    for ratios in ([0.8, 0.4, 0.7, 1.0], []):
        result = wp.zeros(rays, dtype=wp.float32, device="cpu")
        inputs = [
            wp.array(ratios, dtype=wp.float32, device="cpu"), wp.array(vectors, dtype=wp.vec3d, device="cpu"),
            wp.array(gains, dtype=wp.float32, device="cpu"), wp.array(shares, dtype=wp.vec4f, device="cpu"), part,
        ]  # fmt: skip
        call = KernelCall(dot_transforms.scale_gains, inputs, [result], in_runs=True)
        launch_pipeline([call], rays, device=wp.get_device("cpu"), threads=1)
        ratio = np.interp(lengths / 2.0, np.linspace(0.0, 1.0, 4), ratios) if ratios else 1.0
        np.testing.assert_allclose(result.numpy(), gains * shares[:, part] * ratio, rtol=1e-5)
