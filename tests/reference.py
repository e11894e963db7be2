"""The second tier of truth: colours of directions and of pixels in NumPy and float64; shares no code with the library.

Coefficients H_rs(κ) come from FFTs of exp(2πiκh) at Chebyshev nodes in κ and are interpolated between them to
rounding; all of them within eight widths of a direction count, and the integral over λ is refined until it settles.
What a test proves against ``method="direct"`` is fast enough to judge whole pictures.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from brute_force import intersect, pixel_rays, shading_frame

WIDTHS = 8.0
# Gauss and Legendre's three points on (0, 1).
POINTS = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
POINT_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
MOST_PAIRS = 200_000
# A mirror has Y = 1. What lies eight widths from everything ends in a step that no quadrature resolves.
LEAST = 1e-10
# IEC 61966-2-1.
XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


class Coefficients:
    """H_rs(κ) of a height field for κ between two bounds [1/µm] and |q_rs| up to a frequency [1/µm]."""

    def __init__(self, hf, kind, sigma, kappas, frequency, centre=None):
        self.kind, self.lengths = kind, tuple(float(n) * float(d) for n, d in zip(hf.shape, hf.pitch_um, strict=True))
        self.falloff = (4.0 if kind == "averaged" else 2.0) * (math.pi * sigma) ** 2
        self.cut = WIDTHS / math.sqrt(2.0 * self.falloff)
        self.low, high = min(kappas), max(kappas)
        self.half = max((high - self.low) / 2.0, 1e-9)
        heights = np.asarray(hf.heights_um, dtype=np.float64)
        # Mid-range, whose phase is common to all coefficients, off: the argument in κ is then the least.
        heights = heights - (heights.max() + heights.min()) / 2.0
        argument = 2.0 * math.pi * self.half * np.abs(heights).max()
        self.terms = math.ceil(argument + 4.0 * argument ** (1.0 / 3.0) + 10.0)

        self.most = [math.ceil((frequency + self.cut) * length) + 1 for length in self.lengths]
        s, r = (np.arange(-most, most + 1) for most in self.most)
        index = np.ix_(s % hf.shape[0], r % hf.shape[1])
        angles = math.pi * (np.arange(self.terms) + 0.5) / self.terms
        rows = np.zeros((s.size, r.size, 2, self.terms))
        for angle in angles:
            kappa = self.low + self.half * (1.0 + math.cos(angle))
            sampled = np.fft.ifft2(np.exp(2j * math.pi * kappa * heights))[index]
            share = np.cos(np.arange(self.terms) * angle) * (2.0 / self.terms)
            share[0] /= 2.0
            rows[:, :, 0] += sampled.real[:, :, None] * share
            rows[:, :, 1] += sampled.imag[:, :, None] * share
        self.rows = rows.reshape(-1, 2, self.terms)
        if centre is None:
            centre = tuple((n // 2) * d for n, d in zip(hf.shape, hf.pitch_um, strict=True))
        turns = s[:, None] * centre[0] / self.lengths[0] + r[None, :] * centre[1] / self.lengths[1]
        self.phase = np.exp(-2j * math.pi * (turns % 1.0)).ravel()
        reach = [math.ceil(self.cut * length + 0.5) for length in self.lengths]
        grid = np.meshgrid(*(np.arange(-n, n + 1) for n in reach), indexing="ij")
        self.offsets = np.stack([g.ravel() for g in grid])

    def power(self, deflection, tau):
        """⟨|P|²⟩ of one (u, v, w) at wavenumbers τ = 1/λ [1/µm], shape (m,)."""
        step = max(1, MOST_PAIRS // self.offsets.shape[1])
        return np.concatenate([self._power(deflection, tau[k : k + step]) for k in range(0, len(tau), step)])

    def _power(self, deflection, tau):
        u, v, w = deflection
        position = np.clip((w * tau - self.low) / self.half - 1.0, -1.0, 1.0)
        basis = np.cos(np.arccos(position)[:, None] * np.arange(self.terms))
        distance2 = 0.0
        orders = []
        for frequency, length, offsets in zip((v * tau, u * tau), self.lengths, self.offsets, strict=True):
            orders.append(np.rint(frequency * length).astype(np.int64)[:, None] + offsets)
            distance2 = distance2 + (frequency[:, None] - orders[-1] / length) ** 2
        node, which = np.nonzero(distance2 <= self.cut**2)
        s, r = (order[node, which] for order in orders)
        at = (s + self.most[0]) * (2 * self.most[1] + 1) + r + self.most[1]
        gaussian = np.exp(-self.falloff * distance2[node, which])
        value = np.einsum("pck,pk->pc", self.rows[at], basis[node])
        if self.kind == "averaged":
            return np.bincount(node, gaussian * np.sum(value**2, axis=1), len(tau))
        amplitude = (value[:, 0] + 1j * value[:, 1]) * self.phase[at] * gaussian
        re, im = np.bincount(node, amplitude.real, len(tau)), np.bincount(node, amplitude.imag, len(tau))
        return re**2 + im**2


def gain(to_light, to_view, *, ior=1.5, masking=True):
    """C·M of unit vectors (n, 3) in the local frame; 0 where one is not above the surface."""
    lit = (to_light[:, 2] > 0.0) & (to_view[:, 2] > 0.0)
    result = np.zeros(len(lit))
    i, r = to_light[lit], to_view[lit]
    half = (i + r) / np.linalg.norm(i + r, axis=1, keepdims=True)
    cos_d = np.sum(r * half, axis=1)
    result[lit] = fresnel(cos_d, ior) / fresnel(1.0, ior) * (1.0 + np.sum(i * r, axis=1)) ** 2
    result[lit] /= (i[:, 2] + r[:, 2]) ** 2 * r[:, 2]
    if masking:
        shadowing = 2.0 * half[:, 2] * np.minimum(r[:, 2], i[:, 2]) / cos_d
        result[lit] *= np.minimum(1.0, shadowing)
    return result


def fresnel(cosine, ior):
    """Schlick's power reflectance."""
    normal = 1.0 if math.isinf(ior) else ((ior - 1.0) / (ior + 1.0)) ** 2
    return normal + (1.0 - normal) * (1.0 - cosine) ** 5


@functools.cache
def products(illuminant):
    """S·x̄ȳz̄ at 380, 381, … 780 nm over ΣSȳ, shape (401, 3), from colour-science itself."""
    import colour

    shape = colour.SpectralShape(380, 780, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    values = observer * colour.SDS_ILLUMINANTS[illuminant].copy().align(shape).values[:, None]
    return values / values[:, 1].sum()


def quadrature(cell_nm, illuminant):
    """Wavelengths [µm] and weights (m, 3): three points a cell of the linear interpolant, end points at full weight."""
    edges = np.linspace(380.0, 780.0, round(400.0 / cell_nm) + 1)
    nodes = np.concatenate([(edges[:-1, None] + np.diff(edges)[:, None] * POINTS).ravel(), [380.0, 780.0]])
    measure = np.concatenate([(np.diff(edges)[:, None] * POINT_WEIGHTS).ravel(), [0.5, 0.5]])
    table = products(illuminant)
    curves = [np.interp(nodes, np.arange(380, 781), table[:, c]) for c in range(3)]
    return nodes * 1e-3, measure[:, None] * np.stack(curves, axis=1)


def coefficients_for(hf, deflections, kind, sigma, shortest, longest, centre=None):
    """The coefficients that deflections (n, 3) reach between two wavelengths [µm]."""
    w = deflections[:, 2]
    kappas = np.array([w.min() / shortest, w.max() / shortest, w.min() / longest, w.max() / longest])
    frequency = np.hypot(deflections[:, 0], deflections[:, 1]).max() / shortest
    return Coefficients(hf, kind, sigma, kappas, frequency, centre)


def reference_spectral(
    hf, to_light, to_view, wavelengths_um, kind="averaged", sigma=16.25, *, ior=1.5, masking=True, centre=None
):
    """ρ of unit vectors (n, 3) in the local frame, shape (n, m)."""
    wavelengths = np.asarray(wavelengths_um, dtype=np.float64)
    deflections = -to_light - to_view
    table = coefficients_for(hf, deflections, kind, sigma, wavelengths.min(), wavelengths.max(), centre)
    power = np.stack([table.power(each, 1.0 / wavelengths) for each in deflections])
    return gain(to_light, to_view, ior=ior, masking=masking)[:, None] * power


def colours(hf, deflections, kind, sigma, *, tolerance, illuminant="D65", centre=None):
    """∫ ⟨|P|²⟩ S x̄ȳz̄ dλ / ∫ S ȳ dλ of deflections (n, 3), shape (n, 3).

    The step is halved until XYZ moves by less than a twentieth of the tolerance.
    """
    result = np.zeros((len(deflections), 3))
    if len(deflections) == 0:
        return result
    table = coefficients_for(hf, deflections, kind, sigma, 0.38, 0.78, centre)
    # Nodes at first no further apart than two of the narrowest widths in 1/λ, so that no order falls between them.
    narrowest = 1.0 / (2.0 * math.sqrt(2.0) * math.pi * sigma * 2.0)
    first_cell = min(4.0, 3.0 * 2.0 * narrowest * 0.38**2 * 1e3)
    for index, deflection in enumerate(deflections):
        before, cell = None, 400.0 / math.ceil(400.0 / first_cell)
        while True:
            wavelengths, weights = quadrature_cached(cell, illuminant)
            now = table.power(deflection, 1.0 / wavelengths) @ weights
            size = max(np.linalg.norm(now), LEAST)
            if before is not None and np.linalg.norm(now - before) <= tolerance / 20.0 * size:
                break
            before, cell = now, cell / 2.0
            if cell < 1e-3:
                raise AssertionError(f"the integral over λ does not settle for {deflection}")
        result[index] = now
    return result


quadrature_cached = functools.cache(quadrature)


def reference_reflectance(
    hf, to_light, to_view, kind="averaged", sigma=16.25, *, tolerance=1e-3, illuminant="D65", ior=1.5, masking=True,
    centre=None,
):  # fmt: skip
    """XYZ of unit vectors (n, 3) in the local frame, shape (n, 3)."""
    gains = gain(to_light, to_view, ior=ior, masking=masking)
    result = np.zeros((len(gains), 3))
    lit = gains > 0.0
    deflections = -(to_light + to_view)[lit]
    found = colours(hf, deflections, kind, sigma, tolerance=tolerance, illuminant=illuminant, centre=centre)
    result[lit] = gains[lit, None] * found
    return result


class Body(NamedTuple):
    """A mesh in world coordinates with its vertex fields; the texture is sRGB, 8 bits, row 0 at v = 1."""

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    handedness: np.ndarray
    uvs: np.ndarray
    texture: np.ndarray | None = None

    @classmethod
    def of(cls, surface, texture=None):
        """The arrays of a prepared surface, which are inputs here as the height field is."""
        fields = (getattr(surface, name) for name in ("normals", "tangents", "handedness", "uvs"))
        place = surface.vertices.astype(np.float64) * surface.radius + surface.centre
        return cls(place, surface.faces, *(field.astype(np.float64) for field in fields), texture)


class Pixels(NamedTuple):
    """XYZ of pixels (k, 3); which are hit; which are lit by any light; where float32 may well decide otherwise."""

    xyz: np.ndarray
    hit: np.ndarray
    lit: np.ndarray
    unsure: np.ndarray
    cos_geometric: np.ndarray  # of the last light, on the viewer's side


def bilinear(texture, uv):
    """Linear RGB of an sRGB texture (h, w, 3) that repeats, at (k, 2)."""
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


def pigment_colour(base, to_light, to_view, sigma, illuminant, ior):
    """XYZ of linear base colours (k, 3) under the diffraction layer."""
    grid = np.arange(380, 781) * 1e-3
    white = (grid**2 / (4.0 * math.pi**2 * sigma**2)) @ products(illuminant)
    xyz = (base * (XYZ_TO_RGB @ white)) @ np.linalg.inv(XYZ_TO_RGB).T
    under = (1.0 - fresnel(to_light[:, 2], ior)) * (1.0 - fresnel(to_view[:, 2], ior)) * to_light[:, 2]
    return (under / fresnel(1.0, ior))[:, None] * xyz


def reference_picture(
    body, hf, lights, view, pixels, kind="averaged", sigma=16.25, *, tolerance=1e-3, ior=1.5, masking=True,
    pigment=1.0, shadows=True, smooth=True, chunk=64,
):  # fmt: skip
    """The given pixels of a picture, by index along rows from the top left.

    Args:
        body: A ``Body``.
        hf: The height field.
        lights: Objects with ``to_light``, ``illuminant`` and ``power``.
        view: The camera.
        pixels: Indices, shape (k,).
        kind: Of the coherence.
        sigma: Of the coherence [µm].
        tolerance: The integral over λ settles to a twentieth of it.
        ior: Index of refraction.
        masking: Whether to mask.
        pigment: Strength of the texture.
        shadows: Whether to cast shadow rays.
        smooth: Whether to interpolate normals.
        chunk: Rays that meet all faces at a time.
    """
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
        # The shadow terminator of Hanika 2021: onto the tangent planes of the corners where the surface is convex.
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
        lit = (to_light[:, 2] > 0.0) & (to_view[:, 2] > 0.0)
        doubt = np.abs(to_light[:, 2]) < 1e-5
        if shadows:
            rays = np.broadcast_to(world, (np.count_nonzero(lit), 3))
            occluded, _, _, nearness = intersect(start[lit], rays, body.vertices, body.faces, chunk)
            doubt[lit] |= nearness < 1e-4
            lit[lit] = ~np.isfinite(occluded)
        contribution = np.zeros((len(face), 3))
        contribution[lit] = reference_reflectance(
            hf, to_light[lit], to_view[lit], kind, sigma, tolerance=tolerance, illuminant=light.illuminant, ior=ior,
            masking=masking,
        )  # fmt: skip
        if pigment > 0.0 and body.texture is not None:
            base = bilinear(body.texture, np.einsum("kc,kcd->kd", bary, body.uvs[corners])[lit])
            under = pigment_colour(base, to_light[lit], to_view[lit], sigma, light.illuminant, ior)
            contribution[lit] += pigment * under
        xyz[hit] += light.power * contribution
        any_lit[hit] |= lit
        unsure[hit] |= doubt
        cos_geometric[hit] = (side * geometric) @ world
    return Pixels(xyz, hit, any_lit, unsure, cos_geometric)


class PictureError(NamedTuple):
    """The design's error of a picture, on a sample of its pixels."""

    median: float
    p99: float
    below: float  # 99th percentile of ‖ΔXYZ‖ / f of the lit pixels with Y < f
    share_below: float
    lit: int
    unsure: int

    def __str__(self):
        return (
            f"median {self.median:.1e}, P99 {self.p99:.1e}; {100.0 * self.share_below:.1f} % of {self.lit} lit pixels "
            f"below f, there P99 {self.below:.1e}; {self.unsure} left out at edges"
        )


def stratified(mask, count, seed=0):
    """Indices of ``count`` pixels of a mask, one drawn from each of as many runs of equal length along the rows."""
    inside = np.flatnonzero(mask)
    edges = np.linspace(0.0, len(inside), count + 1)
    places = np.random.default_rng(seed).uniform(edges[:-1], edges[1:]).astype(int)
    return inside[np.unique(np.minimum(places, len(inside) - 1))]


def picture_error(xyz, truth):
    """The error of XYZ (k, 3) against ``Pixels``; f is a thousandth of the 99th percentile of Y over the lit ones."""
    use = truth.lit & ~truth.unsure
    exact, moved = truth.xyz[use], np.linalg.norm(xyz[use] - truth.xyz[use], axis=1)
    floor = 1e-3 * np.percentile(exact[:, 1], 99.0)
    above = exact[:, 1] >= floor
    error = moved[above] / np.maximum(np.linalg.norm(exact[above], axis=1), floor)
    below = np.percentile(moved[~above] / floor, 99.0) if not above.all() else 0.0
    unsure = int(np.count_nonzero(truth.unsure & truth.hit))
    return PictureError(
        float(np.median(error)), float(np.percentile(error, 99.0)), float(below), float(np.mean(~above)), len(exact),
        unsure,
    )  # fmt: skip
