"""Reference colours and spectra of directions in NumPy and float64; shares no code with the library.

``coherent_sums`` computes the power that a surface diffracts for a scattering vector. Here the power is multiplied by
the gain (geometry factor C and masking M) and integrated over λ. The integral is refined until it converges. Tests
compare this reference with the direct sum (``warpdiff.diffraction.direct_sum``), which is too slow for pictures.
``pixel_reference`` has colours of pixels.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from bench.truth import flat_materials
from bench.truth.coherent_sums import BLUEST, REDDEST, step_of, sum_for

# Number of Gauss-Legendre nodes per cell of the quadrature over τ = 1/λ, which divides the range into cells. Cells are
# halved until the integral converges.
POINTS = 8
# Smallest number of cells into which the quadrature divides the range of τ = 1/λ.
FEWEST_CELLS = 8
# Largest number of cells of the quadrature over τ = 1/λ. The value is limited by memory; a reference that requires more
# cells is refused.
MOST_CELLS = 1 << 19


def gain(to_light, to_view, *, ior=1.5, masking=True, source=False):
    """Return the gain C·M, by which the diffracted power is multiplied, for unit vectors (n, 3) in the local frame.

    C is a geometry factor, divided by cos θi if ``source`` is True. M is the masking and shadowing by the relief. The
    gain is 0 where the direction to the light or to the viewer is below the surface.
    """
    illuminated = (to_light[:, 2] > 0.0) & (to_view[:, 2] > 0.0)
    result = np.zeros(len(illuminated))
    i, r = to_light[illuminated], to_view[illuminated]
    half = (i + r) / np.linalg.norm(i + r, axis=1, keepdims=True)
    cos_d = np.sum(r * half, axis=1)
    result[illuminated] = fresnel(cos_d, ior) / fresnel(1.0, ior) * (1.0 + np.sum(i * r, axis=1)) ** 2
    result[illuminated] /= (i[:, 2] + r[:, 2]) ** 2 * r[:, 2]
    if masking:
        shadowing = 2.0 * half[:, 2] * np.minimum(r[:, 2], i[:, 2]) / cos_d
        result[illuminated] *= np.minimum(1.0, shadowing)
    if source:
        result[illuminated] /= i[:, 2]
    return result


def fresnel(cosine, ior):
    """Return the power reflectance of a dielectric by Schlick's approximation of the Fresnel equations."""
    normal = 1.0 if math.isinf(ior) else ((ior - 1.0) / (ior + 1.0)) ** 2
    return normal + (1.0 - normal) * (1.0 - cosine) ** 5


@functools.cache
def products(illuminant):
    """Return the products S·x̄ȳz̄ of an illuminant S and the CIE functions, divided by ΣSȳ; 380 to 780 nm, (401, 3)."""
    import colour

    shape = colour.SpectralShape(380, 780, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    values = observer * colour.SDS_ILLUMINANTS[illuminant].copy().align(shape).values[:, None]
    return values / values[:, 1].sum()


@functools.lru_cache(maxsize=24)
def quadrature(cells, illuminant):
    """Return wavenumbers τ [1/µm] and weights (m, 3) of a quadrature with cells of equal length in τ.

    In each cell the integrand is a product: a polynomial in τ through the values at the nodes, times the tabulated
    colour products. The colour products are interpolated linearly between wavelengths that are whole numbers of nm. The
    weights integrate the product over λ exactly. Colours are defined as sums over wavelengths that are whole numbers of
    nm, in which the first and the last wavelength count fully. In the integral these two count half. The two ends of
    the range are therefore additional nodes, and the weights of these nodes are half of the colour products.
    """
    x, _ = np.polynomial.legendre.leggauss(POINTS)
    edges = np.linspace(REDDEST, BLUEST, cells + 1)
    half, middles = (edges[1] - edges[0]) / 2.0, (edges[:-1] + edges[1:]) / 2.0
    # The integrand is not smooth at the edges of cells and at wavelengths that are whole numbers of nm, where the
    # tabulated colour products have kinks. The integral is therefore divided at all of these places. In each part the
    # integrand is smooth, and a Gauss rule with 6 points integrates it.
    pieces = np.unique(np.concatenate([1e3 / edges[1:-1], np.arange(380.0, 781.0)]))
    middle = (pieces[:-1] + pieces[1:]) / 2.0
    cell = np.clip(((1e3 / middle - REDDEST) / (2.0 * half)).astype(np.int64), 0, cells - 1)
    to_cardinals = np.linalg.inv(np.polynomial.legendre.legvander(x, POINTS - 1))
    table = products(illuminant)
    weights = np.zeros((3, cells, POINTS))
    for at, share in zip(*np.polynomial.legendre.leggauss(6), strict=True):
        places = middle + at * np.diff(pieces) / 2.0
        measure = share * np.diff(pieces) / 2.0
        cardinals = np.polynomial.legendre.legvander((1e3 / places - middles[cell]) / half, POINTS - 1) @ to_cardinals
        for c in range(3):
            curve = np.interp(places, np.arange(380, 781), table[:, c]) * measure
            for point in range(POINTS):
                weights[c, :, point] += np.bincount(cell, curve * cardinals[:, point], cells)
    nodes = (middles[:, None] + half * x).ravel()
    return np.append(nodes, [BLUEST, REDDEST]), np.concatenate([weights.reshape(3, -1).T, table[[0, -1]] / 2.0])


def reference_spectral(
    heightfield, to_light, to_view, wavelengths_um, coherence="averaged", sigma=16.25, *, ior=1.5, material=None,
    masking=True, centre=None,
):  # fmt: skip
    """Return reflectances ρ for directions to light and viewer (n, 3) in the local frame, at m wavelengths.

    The result has the shape (n, m).

    The coherence (how far light interferes) is a name, such as "averaged", with ``sigma`` [µm], or a coherence object.
    """
    step = step_of(coherence, sigma, centre)
    wavelengths = np.asarray(wavelengths_um, dtype=np.float64)
    ior = math.inf if material is not None else ior
    gains = gain(to_light, to_view, ior=ior, masking=masking, source=step.kind == "source")
    result = np.zeros((len(gains), len(wavelengths)))
    illuminated = np.flatnonzero(gains)
    if illuminated.size == 0:
        return result
    scattering_vectors = -to_light - to_view
    sums = sum_for(heightfield, step, scattering_vectors[illuminated], wavelengths.min(), wavelengths.max())
    for i in illuminated:
        result[i] = gains[i] * sums.power(scattering_vectors[i], to_light[i], 1.0 / wavelengths)
        result[i] *= reflected(material, to_light[i], to_view[i], wavelengths)
    return result


def reflected(material, to_light, to_view, wavelengths_um):
    """Return the Fresnel reflectance for one pair of directions to light and view, or 1 without a material.

    The angle of incidence is half of the angle between the two directions.
    """
    if material is None:
        return 1.0
    half = (to_light + to_view) / np.linalg.norm(to_light + to_view)
    return flat_materials.reflectance(material, wavelengths_um, half @ to_view)


def colours(heightfield, scattering_vectors, to_light, step, *, tolerance, illuminant="D65", material=None):
    """Return XYZ for scattering vectors (n, 3): ∫ ⟨|P|²⟩ S x̄ȳz̄ dλ / ∫ S ȳ dλ, with diffracted power ⟨|P|²⟩.

    S is the spectrum of the illuminant.

    The cells of the quadrature are halved until XYZ changes by less than a twentieth of the tolerance.
    """
    result = np.zeros((len(scattering_vectors), 3))
    if len(scattering_vectors) == 0:
        return result
    sums = sum_for(heightfield, step, scattering_vectors, 0.38, 0.78)
    for index, (scattering_vector, light) in enumerate(zip(scattering_vectors, to_light, strict=True)):
        # A narrow peak may lie between the nodes of a quadrature. Two quadratures must therefore agree, the second with
        # cells of half the size. Numbers of cells are powers of 2, so that few different quadratures are computed.
        largest, least = sums.resolution(scattering_vector, light)
        cells = 1 << math.ceil(math.log2(max((BLUEST - REDDEST) / largest, FEWEST_CELLS)) - 1.0)
        before = None
        while True:
            if cells > MOST_CELLS:
                why = "converge" if before is not None else f"fit in {MOST_CELLS} cells"
                raise AssertionError(f"the integral over λ does not {why} for {scattering_vector}, light {light}")
            tau, weights = quadrature(cells, illuminant)
            now = (
                sums.power(scattering_vector, light, tau)
                * reflected(material, light, -scattering_vector - light, 1.0 / tau)
            ) @ weights
            size = max(np.linalg.norm(now), least)
            if before is not None and np.linalg.norm(now - before) <= tolerance / 20.0 * size:
                break
            before, cells = now, 2 * cells
        result[index] = now
    return result


def reference_reflectance(
    heightfield, to_light, to_view, coherence="averaged", sigma=16.25, *, tolerance=1e-3, illuminant="D65", ior=1.5,
    material=None, masking=True, centre=None,
):  # fmt: skip
    """Return XYZ for directions to light and viewer (n, 3) in the local frame, shape (n, 3).

    The coherence (how far light interferes) is a name, such as "averaged", with ``sigma`` [µm], or a coherence object.
    """
    step = step_of(coherence, sigma, centre)
    ior = math.inf if material is not None else ior
    gains = gain(to_light, to_view, ior=ior, masking=masking, source=step.kind == "source")
    result = np.zeros((len(gains), 3))
    illuminated = gains > 0.0
    xyz = colours(
        heightfield, -(to_light + to_view)[illuminated], to_light[illuminated], step, tolerance=tolerance,
        illuminant=illuminant, material=material,
    )  # fmt: skip
    result[illuminated] = gains[illuminated, None] * xyz
    return result
