"""Reference colours of pixels in NumPy and float64, and errors of pictures; shares no code with the library."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bench.truth.brute_force import intersect, pixel_rays, shading_frame
from bench.truth.coherent_sums import step_of
from bench.truth.errors import FLOOR, reference_luminance
from bench.truth.reference import fresnel, products, reference_reflectance

# Matrix from XYZ to linear sRGB (IEC 61966-2-1).
XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


class Body(NamedTuple):
    """A mesh in world coordinates with normals, tangents, handedness and texture coordinates at its vertices.

    The handedness is −1 where the texture mapping is mirrored, and 1 elsewhere. The texture is sRGB with 8 bits, and
    row 0 of the texture is at v = 1.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    handedness: np.ndarray
    uvs: np.ndarray
    texture: np.ndarray | None = None

    @classmethod
    def of(cls, surface, texture=None):
        """Return a body with the arrays of a mesh that the library has prepared."""
        fields = (getattr(surface, name) for name in ("normals", "tangents", "handedness", "uvs"))
        place = surface.vertices.astype(np.float64) * surface.radius + surface.centre
        return cls(place, surface.faces, *(field.astype(np.float64) for field in fields), texture)


class Pixels(NamedTuple):
    """Reference colours of pixels of a picture.

    Attributes:
        xyz: XYZ, shape (k, 3).
        hit: Whether the ray through the centre of the pixel hits the mesh.
        illuminated: Whether at least one light illuminates the hit.
        unsure: Whether rounding to float32 may change whether the ray hits the mesh, or whether the hit is in shadow.
        cos_geometric: Cosine between the last light and the face normal on the viewer's side.
    """

    xyz: np.ndarray
    hit: np.ndarray
    illuminated: np.ndarray
    unsure: np.ndarray
    cos_geometric: np.ndarray


def bilinear(texture, uv):
    """Return linear RGB of an sRGB texture (h, w, 3) at texture coordinates (k, 2), bilinearly interpolated."""
    encoded = np.asarray(texture, dtype=np.float64) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    height, width = linear.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5
    total = 0.0
    for dy in (0, 1):
        for dx in (0, 1):
            column, row = np.floor(x).astype(int) + dx, np.floor(y).astype(int) + dy
            weight = (1.0 - np.abs(x - column)) * (1.0 - np.abs(y - row))
            total = total + weight[:, None] * linear[row % height, column % width]
    return total


def pigment_colour(base, to_light, to_view, heightfield, step, illuminant, ior):
    """Return XYZ of the diffuse pigment under the diffracting surface, for base colours (k, 3) in linear RGB."""
    grid = np.arange(380, 781) * 1e-3
    if step.kind == "source":
        weight = np.full(len(grid), 2.0 * step.spread**2)
    elif step.kind == "replicas":
        patch = math.prod(heightfield.shape) * float(heightfield.pitch_um[0]) * float(heightfield.pitch_um[1])
        weight = grid**2 / (math.pi * patch * math.prod(step.periods))
    else:
        weight = grid**2 / (4.0 * math.pi**2 * step.sigma_um**2)
    # A white pigment has the chromaticity of the illuminant. Its luminance is a mean of `weight` over the wavelengths,
    # in which each wavelength counts by its share of the illuminant's Y.
    spectrum = products(illuminant)
    white = (weight @ spectrum[:, 1]) * spectrum.sum(axis=0)
    xyz = (base * (XYZ_TO_RGB @ white)) @ np.linalg.inv(XYZ_TO_RGB).T
    under = (1.0 - fresnel(to_light[:, 2], ior)) * (1.0 - fresnel(to_view[:, 2], ior)) * to_light[:, 2]
    return (under / fresnel(1.0, ior))[:, None] * xyz


def reference_picture(
    body, heightfield, lights, view, pixels, coherence="averaged", sigma=16.25, *, tolerance=1e-3, ior=1.5,
    masking=True, pigment=1.0, shadows=True, smooth=True, chunk=64,
):  # fmt: skip
    """Return reference colours of pixels of a picture. Indices run along rows from the top left.

    Args:
        body: A ``Body``.
        heightfield: Height field.
        lights: Objects with ``to_light``, ``illuminant`` and ``power``.
        view: Camera.
        pixels: Indices of pixels, shape (k,).
        coherence: Name of a kind of coherence, or a coherence object.
        sigma: Standard deviation of the coherence window [µm], if ``coherence`` is a name.
        tolerance: Tolerance of the reference; the integral over λ converges to a twentieth of the tolerance.
        ior: Index of refraction.
        masking: Whether the gain includes the factor for masking and shadowing by the relief.
        pigment: Strength of the pigment under the diffracting surface.
        shadows: Whether shadow rays are traced.
        smooth: Whether normals are interpolated.
        chunk: Number of rays that are intersected with all faces at a time.
    """
    step = step_of(coherence, sigma, None)
    fov = None if view.extent_y else view.fov_y_deg
    size = {"width": view.width, "height": view.height, "fov_y_deg": fov, "extent_y": view.extent_y}
    origins, directions = (a[pixels] for a in pixel_rays(view.eye, view.target, view.up, **size))
    _, face, bary, margin = intersect(origins, directions, body.vertices, body.faces, chunk)
    hit = face >= 0
    unsure = margin < 1e-5
    face, bary, directions = face[hit], bary[hit], directions[hit]
    fields = {"normals": body.normals, "tangents": body.tangents, "handedness": body.handedness}
    t, b, n = shading_frame(face, bary, directions, body.vertices, body.faces, **fields, smooth=smooth)
    corners = body.faces[face]
    places = body.vertices[corners]
    point = np.einsum("kc,kcd->kd", bary, places)
    geometric = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
    side = np.where(np.sum(geometric * directions, axis=1) > 0.0, -1.0, 1.0)[:, None]
    start = point
    if smooth:
        # Where the surface is convex, shadow rays start outside of the flat face. The starting point is interpolated
        # between the tangent planes at the corners of the face (Hanika 2021, "Hacking the shadow terminator").
        outward = side[:, :, None] * body.normals[corners]
        below = np.minimum(np.sum((point[:, None] - places) * outward, axis=2), 0.0)
        start = np.einsum("kc,kcd->kd", bary, point[:, None] - below[:, :, None] * outward)
    extent = np.linalg.norm(np.ptp(body.vertices, axis=0)) / 2.0
    start = start + 1e-5 * extent * side * geometric
    to_view = np.stack([np.sum(axis * -directions, axis=1) for axis in (t, b, n)], axis=1)

    xyz = np.zeros((len(pixels), 3))
    any_lit = np.zeros(len(pixels), dtype=bool)
    cos_geometric = np.zeros(len(pixels))
    for light in lights:
        world = np.asarray(light.to_light)
        to_light = np.stack([axis @ world for axis in (t, b, n)], axis=1)
        illuminated = (to_light[:, 2] > 0.0) & (to_view[:, 2] > 0.0)
        doubt = np.abs(to_light[:, 2]) < 1e-5
        if shadows:
            rays = np.broadcast_to(world, (np.count_nonzero(illuminated), 3))
            occluded, _, _, nearness = intersect(start[illuminated], rays, body.vertices, body.faces, chunk)
            doubt[illuminated] |= nearness < 1e-4
            illuminated[illuminated] = ~np.isfinite(occluded)
        contribution = np.zeros((len(face), 3))
        contribution[illuminated] = reference_reflectance(
            heightfield, to_light[illuminated], to_view[illuminated], step, tolerance=tolerance,
            illuminant=light.illuminant, ior=ior, masking=masking,
        )  # fmt: skip
        if pigment > 0.0 and body.texture is not None:
            base = bilinear(body.texture, np.einsum("kc,kcd->kd", bary, body.uvs[corners])[illuminated])
            under = pigment_colour(
                base, to_light[illuminated], to_view[illuminated], heightfield, step, light.illuminant, ior
            )
            contribution[illuminated] += pigment * under
        xyz[hit] += light.power * contribution
        any_lit[hit] |= illuminated
        unsure[hit] |= doubt
        cos_geometric[hit] = (side * geometric) @ world
    return Pixels(xyz, hit, any_lit, unsure, cos_geometric)


class PictureError(NamedTuple):
    """Error of a picture, estimated from a random sample of its pixels."""

    median: float
    p99: float
    below: float  # 99th percentile of ‖ΔXYZ‖ / f of the illuminated pixels with Y < f
    share_below: float
    illuminated: int
    unsure: int

    def __str__(self):
        return (
            f"median {self.median:.1e}, P99 {self.p99:.1e}; {100.0 * self.share_below:.1f} % of {self.illuminated} "
            f"illuminated pixels below f with P99 {self.below:.1e}; {self.unsure} pixels excluded at edges"
        )


def stratified(mask, count, seed=0):
    """Return indices of ``count`` random pixels of a mask, evenly distributed over the rows of the mask.

    The pixels of the mask, in row order, are divided into ``count`` equal parts. One pixel is drawn from each part.
    """
    inside = np.flatnonzero(mask)
    edges = np.linspace(0.0, len(inside), count + 1)
    places = np.random.default_rng(seed).uniform(edges[:-1], edges[1:]).astype(int)
    return inside[np.unique(np.minimum(places, len(inside) - 1))]


def picture_error(xyz, truth):
    """Return the error of a picture's XYZ (k, 3) relative to the reference ``truth``, over illuminated pixels."""
    use = truth.illuminated & ~truth.unsure
    exact, moved = truth.xyz[use], np.linalg.norm(xyz[use] - truth.xyz[use], axis=1)
    floor = FLOOR * reference_luminance(exact[:, 1])
    above = exact[:, 1] >= floor
    error = moved[above] / np.maximum(np.linalg.norm(exact[above], axis=1), floor)
    below = np.percentile(moved[~above] / floor, 99.0) if not above.all() else 0.0
    unsure = int(np.count_nonzero(truth.unsure & truth.hit))
    return PictureError(
        float(np.median(error)), float(np.percentile(error, 99.0)), float(below), float(np.mean(~above)), len(exact),
        unsure,
    )  # fmt: skip
