"""Colour curves: spline weights that turn rows of the power spectrum into colours, and shared functions of w."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.threads import single_threaded_blas
from warpdiff.diffraction import chebyshev
from warpdiff.optics import colorimetry
from warpdiff.optics.colorimetry import VISIBLE_NM
from warpdiff.optics.materials import IlluminatedMaterial, reflectance_at
from warpdiff.request.plan import MOST_W_BASIS, W_BASIS_STEP
from warpdiff.tables.polar_grid import LOG_RED, ring_count

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.optics.materials import Material
    from warpdiff.request.plan import Plan
    from warpdiff.tables.mip_layout import MipLayout

# Entries of the functions of w, between which they are cubics: 32 an oscillation and more.
_ENTRIES_OVER_W = 160
# Where colours are this share of the largest, errors count as there.
_LEAST_SCALE_OVER_W = 1e-2
# Samples of the colour curves from one node to the next.
_SAMPLES_PER_NODE = 64
# Errors of the colour curves count relative to them, down to this share of the largest: they vanish at both ends.
_LEAST_SCALE = 0.005
# Colour curves hold a material's reflectance at this cos θd. What it is elsewhere, relative to that, is a sum of
# products of a function of |(u, v)| and of one of λ and w, which may leave out this share of the tolerance.
_MIDDLE_COSINE, _PRODUCTS_SHARE = 0.8, 0.02
# Polynomials of cos θd stand for a reflectance, with this error. Their roots: the fewest serve metals, and the most
# films that resonate next to the horizon.
_POLYNOMIALS_ERR, _FEWEST_ROOTS, _MOST_ROOTS = 1e-6, 32, 512
# They hold no less of it than this share of its largest value, as films reflect nothing at some wavelengths.
_LEAST_SHARE = 0.3


@dataclass(frozen=True)
class SpectrumBasis:
    """The terms that rows of the spectrum consist of.

    Attributes:
        basis_at: The functions of |κ| that a row's numbers multiply, for |κ| (n,) of shape (n, terms).
        kappas: The range of |κ| [1/µm].
        sizes: How much each term matters, (terms,).
        share: Of the tolerance, what functions of w may leave out.
        holds_lines: Whether rows are densities of lines over frequency, which over (u, v) are λ⁻² of it.
    """

    basis_at: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    kappas: tuple[float, float]
    sizes: NDArray[np.float64]
    share: float
    holds_lines: bool = False


@dataclass(frozen=True)
class SeparableTerm:
    """A part of one octave's colours: a projection of the spectrum, times a number for each node of |(u, v)|.

    Attributes:
        projection: Index of the projection, which octaves may share.
        factors: The number for each ring of the octave, shape (rings,); None is 1.
    """

    projection: int
    factors: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class Projection:
    """The weights that turn rows of the spectrum into colours.

    Attributes:
        ws: |w| at equal steps.
        w_basis: Functions of these that all colours share, shape (entries, m).
        weights: What rings count for X, Y and Z, shape (rings, 3).
        matrices: For each projection, for each ring from the one before a colour's own to its blue end and beyond, and
            for each term, the coefficients of the functions of w, shape (rings, terms, m).
        octaves: For each octave of |(u, v)| the products whose sum its colours are: a single one without a material.
    """

    ws: NDArray[np.float64]
    w_basis: NDArray[np.float32]
    weights: NDArray[np.float32]
    matrices: tuple[NDArray[np.float32], ...]
    octaves: tuple[tuple[SeparableTerm, ...], ...]


@single_threaded_blas()
def make_projection(
    plan: Plan, terms: SpectrumBasis, illuminated: IlluminatedMaterial, layout: MipLayout
) -> Projection:
    """The projection for a plan's nodes and its functions of w, or as many of these as its tolerance asks for.

    As cos θd = |(u, v, w)|/2, a material's R(θd, λ) is a function of λ, of w and of a node's |(u, v)|: it is within the
    integral over λ, and look-ups do not know of it.
    """
    # The range of |w| whose |κ| at all wavelengths are within the terms'.
    low, high = terms.kappas[0] * colorimetry.LAMBDA_MAX_NM * 1e-3, terms.kappas[1] * colorimetry.LAMBDA_MIN_NM * 1e-3
    ws, per_um = _places(plan.rings_per_octave, low, high)
    weights = colour_weights(plan.rings_per_octave, illuminated, lines=terms.holds_lines)
    count = len(terms.sizes)
    kappas = np.clip(ws[:, None] * per_um, *terms.kappas)
    basis = terms.basis_at(kappas.ravel()).reshape(len(ws), len(per_um), count)
    functions, octaves = _material_products(
        illuminated.material, plan.rings_per_octave, _PRODUCTS_SHARE * plan.tolerance, layout, low, high
    )
    sized = basis * terms.sizes * np.linalg.norm(weights, axis=1)[:, None]
    matrix = np.concatenate(
        [(sized * (size * over_w)[:, :, None]).reshape(len(ws), -1) for over_w, size in functions], axis=1
    )
    norms = np.linalg.norm(matrix, axis=1)
    relative = 1.0 / np.maximum(norms, _LEAST_SCALE_OVER_W * norms.max())[:, None]
    # A singular value decomposition, by the eigenvectors of so small a matrix that threads of a library, which wait for
    # each other at every step, do not make it longer where a core is not theirs.
    matrix *= relative
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    squares, left = np.maximum(values, 0.0), vectors[:, ::-1]
    # Largest omission of the first 0, 1, … functions over all |w|, because a call may use a single |w|.
    remaining = np.sqrt(np.append(np.cumsum(squares * vectors**2, axis=1).max(axis=0)[::-1], 0.0))
    needed = int(np.argmax(remaining <= terms.share * plan.tolerance))
    m = plan.w_basis_size or min(W_BASIS_STEP * math.ceil(max(needed, 1) / W_BASIS_STEP), MOST_W_BASIS)
    w_basis = left[:, :m] / relative
    matrices = tuple(
        np.einsum("wm,wi,wil->ilm", left[:, :m] * relative, over_w, basis, optimize=True).astype(np.float32)
        for over_w, _ in functions
    )
    return Projection(ws, w_basis.astype(np.float32), weights.astype(np.float32), matrices, octaves)


def _on_curve(material: Material, wavelengths_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of a material's reflectance that colour curves hold, a function of the wavelength alone."""
    # A material that reflects nothing, such as air, is black relative to any colour.
    most = reflectance_at(material, VISIBLE_NM, np.array(_MIDDLE_COSINE)).max() or 1.0
    reflectances = reflectance_at(material, wavelengths_nm, np.array(_MIDDLE_COSINE))
    return np.asarray(np.maximum(reflectances, _LEAST_SHARE * most))


# The curves of the last plan serve all of its illuminants, and any number of functions.
@functools.lru_cache(maxsize=1)
def _material_products(
    material: Material | None, rings_per_octave: int, share: float, layout: MipLayout, low: float, high: float
) -> tuple[tuple[tuple[NDArray[np.float64], float], ...], tuple[tuple[SeparableTerm, ...], ...]]:
    """Functions of (w, λ) with how large the numbers that multiply them are at most, and their products by octave.

    The products of one octave add up to R relative to what colour curves hold of it, but for a share, over a range of
    |w|. Octaves of small |(u, v)| share a function.
    """
    ws, per_um = _places(rings_per_octave, low, high)
    grid = layout.levels[0]
    if material is None:
        return ((np.ones((len(ws), len(per_um))), 1.0),), ((SeparableTerm(0),),) * len(grid.azimuths)
    wavelengths = np.clip(1e3 / per_um, colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM)
    at_roots = _ratios_at_roots(material, wavelengths)

    def ratio(uv: NDArray[np.float64]) -> NDArray[np.float64]:
        cosines = 0.5 * np.sqrt(uv[:, None] ** 2 + ws**2)
        ratios = chebyshev.cardinals(cosines.ravel(), 0.0, 1.0, len(at_roots)) @ at_roots
        return np.asarray(ratios.reshape(*cosines.shape, -1))

    centre: NDArray[np.float64] = ratio(np.zeros(1))[0]
    functions: list[tuple[NDArray[np.float64], float]] = []
    octaves: list[tuple[SeparableTerm, ...]] = []
    shared: SeparableTerm | None = None
    # Beyond 2 there is no |(u, v)|.
    for uv in np.minimum(grid.radii, 2.0):
        if np.abs(ratio(uv[-1:]) - centre).max() <= share:
            if shared is None:
                shared = SeparableTerm(len(functions))
                functions.append((centre, 1.0))
            octaves.append((shared,))
            continue
        values = ratio(uv).reshape(len(uv), -1)
        # A singular value decomposition by the smaller side.
        left = np.linalg.eigh(values @ values.T)[1][:, ::-1]
        right = left.T @ values
        rank = 1
        while rank < len(uv) and np.abs(values - left[:, :rank] @ right[:rank]).max() > share:
            rank += 1
        first = len(functions)
        octaves.append(tuple(SeparableTerm(first + j, left[:, j].astype(np.float32)) for j in range(rank)))
        functions += [(right[j].reshape(centre.shape).copy(), float(np.abs(left[:, j]).max())) for j in range(rank)]
    return tuple(functions), tuple(octaves)


def _places(rings_per_octave: int, low: float, high: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Entries of |w| of a range, and 1/λ at the nodes that a colour uses, of this number per octave."""
    per_um = np.exp(LOG_RED + (np.arange(ring_count(rings_per_octave)) - 1.0) * math.log(2.0) / rings_per_octave)
    return np.linspace(low, high, _ENTRIES_OVER_W), per_um


def _ratios_at_roots(material: Material, wavelengths_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """A reflectance relative to what colour curves hold of it, at as many Chebyshev roots of cos θd as tell it all."""

    def at_roots(count: int) -> NDArray[np.float64]:
        roots = chebyshev.nodes(0.0, 1.0, count)[:, None]
        return np.asarray(reflectance_at(material, wavelengths_nm, roots) / _on_curve(material, wavelengths_nm))

    count = _FEWEST_ROOTS
    result = at_roots(count)
    while count < _MOST_ROOTS:
        finer, between = at_roots(2 * count), chebyshev.nodes(0.0, 1.0, 2 * count)
        if np.abs(chebyshev.cardinals(between, 0.0, 1.0, count) @ result - finer).max() <= _POLYNOMIALS_ERR:
            break
        count, result = 2 * count, finer
    return result


@functools.lru_cache(maxsize=64)
def colour_weights(rings: int, illuminated: IlluminatedMaterial, *, lines: bool = False) -> NDArray[np.float64]:
    """Projections of colour curves on the splines of this number of nodes per octave.

    Args:
        rings: Rings per octave of the table.
        illuminated: The illuminant, and the material whose reflectance at a middle angle the curves hold.
        lines: Whether rows are densities of lines over frequency, which over (u, v) are λ⁻² of it.

    Returns:
        Shape (ring_count(rings), 3); times the spectrum's values from the ring before the red end on they
        add up to XYZ.
    """
    products = colour_products(illuminated)
    if lines:
        products = products / (1e-3 * np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1))[:, None] ** 2
    result = _projected(products, rings)
    # A spectrum without features keeps its colour to rounding.
    return np.asarray(result * products.sum(axis=0) / (math.log(2.0) / rings * result.sum(axis=0)))


def colour_products(illuminated: IlluminatedMaterial) -> NDArray[np.float64]:
    """S·x̄ȳz̄ at 1 nm, times what colour curves hold of a material's reflectance, shape (401, 3)."""
    products = colorimetry.colour_products(illuminated.illuminant)
    return products if illuminated.material is None else products * _on_curve(illuminated.material, VISIBLE_NM)[:, None]


def _projected(products: NDArray[np.float64], rings_per_octave: int) -> NDArray[np.float64]:
    """The splines' coefficients that come closest to the colour curves, shape (ring_count(rings_per_octave), 3)."""
    count = ring_count(rings_per_octave)
    # Nodes beyond the band see darkness there, and their splines' share of it.
    places = (np.arange((count + 4) * _SAMPLES_PER_NODE) + 0.5) / _SAMPLES_PER_NODE - 2.0
    at = 1e3 * np.exp(-(LOG_RED + (places - 1.0) * (math.log(2.0) / rings_per_octave)))
    # dλ = λ d ln λ; there is darkness beyond either end.
    curves = at[:, None] * np.stack([np.interp(at, VISIBLE_NM, c, left=0.0, right=0.0) for c in products.T], axis=1)
    size = np.linalg.norm(curves, axis=1)
    weights = 1.0 / np.maximum(size, _LEAST_SCALE * size.max())[:, None]
    splines = spline(places[:, None] - np.arange(count)) * weights
    gram = splines.T @ splines
    gram += 1e-12 * np.trace(gram) * np.eye(count)
    return np.asarray(np.linalg.solve(gram, splines.T @ (curves * weights)))


def spline(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quadratic B-spline."""
    away = np.abs(x)
    return np.where(away < 0.5, 0.75 - away**2, 0.5 * np.maximum(1.5 - away, 0.0) ** 2)
