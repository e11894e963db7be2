"""Colour curves: spline weights that convert a power spectrum to XYZ, and functions of w that colours share.

A colour curve is a product as a function of the wavelength. Its factors are the spectrum of an illuminant, a CIE
colour-matching function and the reflectance of a material. (u, v, w) is the scattering vector −ωi − ωr, where ωi and ωr
are the unit vectors to the light and to the viewer. The component w is along the normal. A ring is a circle of constant
|(u, v)|/λ in the polar grid of the power spectrum; the radii of neighbouring rings have a constant ratio. An
octave is the set of rings between one radius and twice this radius.

θd is half of the angle between the directions to the light and to the viewer, so that cos θd = |(u, v, w)|/2.
"""

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

# Number of values of |w| at which the functions of w of a colour table are tabulated. w is the normal component of the
# scattering vector. Each oscillation of a function has at least 32 values. Cubics interpolate between these values.
_ENTRIES_OVER_W = 160
# A colour table has only a limited number of functions of w, the normal component of the scattering vector. The
# truncation of these functions causes an error. The error at each |w| is divided by the magnitude of the colours at
# this |w|, or by this share of their largest magnitude over all |w|, whichever is larger.
_LEAST_SCALE_OVER_W = 1e-2
# Number of wavelengths at which the colour curves (illuminant times colour-matching function times reflectance) are
# sampled between two neighbouring knots of their splines. The splines, which have one knot per ring of the table
# (circle of constant |(u, v)|), are fitted to these samples.
_SAMPLES_PER_NODE = 64
# Splines are fitted to colour curves (illuminant times colour-matching function times reflectance). Errors of the fit
# are relative to the values of a curve, which vanish at both ends of the visible range. The divisor of an error is
# therefore at least this share of the largest value of the curve.
_LEAST_SCALE = 0.005
# Colour curves include the reflectance of the material at one angle θd, which is half of the angle between the
# directions to the light and to the viewer. `_MIDDLE_COSINE` is its cosine. The reflectance at another angle divided by
# this reflectance is approximated by a sum of products: a function of |(u, v)| times a function of λ and w.
# `_PRODUCTS_SHARE` is the largest error of the sum, as a share of the tolerance.
_MIDDLE_COSINE, _PRODUCTS_SHARE = 0.8, 0.02
# The reflectance of a material, divided by its reflectance in the colour curves, is approximated by polynomials in cos
# θd through Chebyshev nodes. `_POLYNOMIALS_ERR` is the largest absolute error of this ratio. `_FEWEST_ROOTS` and
# `_MOST_ROOTS` are the smallest and the largest number of nodes. Metals need the fewest nodes; thin films with
# resonances near the horizon need the most.
_POLYNOMIALS_ERR, _FEWEST_ROOTS, _MOST_ROOTS = 1e-6, 32, 512
# Smallest reflectance in colour curves (illuminant times colour-matching function times reflectance), as a share of the
# largest reflectance. Smaller reflectances are replaced by it. Thin films reflect nothing at some wavelengths. Without
# the replacement, ratios to a reflectance of 0 would be infinite.
_LEAST_SHARE = 0.3


@dataclass(frozen=True)
class SpectrumBasis:
    """Basis functions of |κ| = |w|/λ, in which a power spectrum is expanded at each of its points.

    The component of the scattering vector along the normal is w. A row of numbers has the weights of the basis
    functions (terms) at one point of the spectrum.

    Attributes:
        basis_at: Function of an array of |κ|, shape (n,), that returns the basis functions there, shape (n, terms).
        kappas: Smallest and largest |κ| [1/µm].
        sizes: Typical magnitude of the weight of each basis function in the rows, relative to the other weights, shape
            (terms,).
        share: Permitted error of a colour table that expands colours in few functions of w, as a share of the
            tolerance.
        holds_lines: Whether rows are powers |H|² per unit area of spatial frequency, as under a light source of finite
            size. Colours require powers per unit area of (u, v). The weights of the colour curves then include the
            factor λ⁻², which converts the first to the second.
    """

    basis_at: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    kappas: tuple[float, float]
    sizes: NDArray[np.float64]
    share: float
    holds_lines: bool = False


@dataclass(frozen=True)
class SeparableTerm:
    """Summand of the colours in one octave of |(u, v)|: the spectrum, converted by a matrix, times a factor per ring.

    A ring is a circle of constant |(u, v)|.

    Attributes:
        projection: Index of the matrix in ``Projection.matrices``; several octaves may share a matrix.
        factors: Factor for each ring of the octave, shape (rings,); None is 1.
    """

    projection: int
    factors: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class Projection:
    """Weights that convert rows of the power spectrum to colours.

    Attributes:
        ws: Tabulated values of |w|, equally spaced, shape (entries,).
        w_basis: Functions of w that all colours of a table share, at the values ``ws``, shape (entries, m).
        weights: Spline coefficients of the colour curves: weights in X, Y and Z of the rings (circles of constant |(u,
            v)|/λ) that contribute to one colour, shape (rings, 3).
        matrices: Each matrix has the coefficients of the functions of w for each ring and basis term, shape
            (rings, terms, m). The colour at one |(u, v)| requires the rings |(u, v)|/λ from the longest visible
            wavelength to the shortest, and one ring more at each end.
        octaves: For each octave of |(u, v)|, the summands (separable terms) whose sum is the octave's colours. Without
            a material there is a single summand.
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
    """Return the weights that convert the power spectrum on the rings of a table to colours.

    A ring is a circle of constant |(u, v)|. A plan has the numbers of a computation. If it does not set the number of
    functions of w, its tolerance determines the number. The angle θd is half of the angle between the directions to the
    light and to the viewer. Because cos θd = |(u, v, w)|/2, the reflectance R(θd, λ) of a material is a function of λ,
    w and the radius |(u, v)| of a ring. The integral over λ therefore includes R, and look-ups need no material.
    """
    # Smallest and largest |w| for which |κ| = |w|/λ is within the range of the basis functions at all visible
    # wavelengths.
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
    # The functions of w are left singular vectors of `matrix`, which has one row per |w|. They are computed as the
    # eigenvectors of the small Gram matrix of `matrix`. NumPy's singular value decomposition of the large matrix uses
    # several threads, and is slow if other processes occupy the cores.
    matrix *= relative
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    squares, left = np.maximum(values, 0.0), vectors[:, ::-1]
    # Element n of `remaining` is the truncation error if colours are sums of the first n functions of w only. It is the
    # largest error over all |w| and not the mean, because a call may use a single |w|.
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
    """Return the reflectance of a material that colour curves include: at one angle θd, with a positive lower limit."""
    # If the largest reflectance is 0, as for air, the number 1 replaces it, because it is a divisor later.
    most = reflectance_at(material, VISIBLE_NM, np.array(_MIDDLE_COSINE)).max() or 1.0
    reflectances = reflectance_at(material, wavelengths_nm, np.array(_MIDDLE_COSINE))
    return np.asarray(np.maximum(reflectances, _LEAST_SHARE * most))


# Only the result of the last call is cached. The result does not depend on the illuminant or on the number of functions
# of w in the table. Tables of one material that are computed one after the other therefore share it.
@functools.lru_cache(maxsize=1)
def _material_products(
    material: Material | None, rings_per_octave: int, share: float, layout: MipLayout, low: float, high: float
) -> tuple[tuple[tuple[NDArray[np.float64], float], ...], tuple[tuple[SeparableTerm, ...], ...]]:
    """Approximate a material's reflectance, divided by the one in the colour curves, by sums of separable terms.

    A separable term is a factor for each ring (circle of constant |(u, v)|) times a function of (w, λ). The absolute
    error of the ratio is at most ``share`` for |w| from ``low`` to ``high``. Octaves of small |(u, v)|, where the
    reflectance hardly changes, share one function of (w, λ).

    Returns:
        Functions of (w, λ), each with its largest factor over all rings; and the separable terms of each octave.
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
    # The outermost rings (circles of constant |(u, v)|) of the grid may have a larger |(u, v)| than 2, which no
    # direction has. These rings use the reflectance at |(u, v)| = 2.
    for uv in np.minimum(grid.radii, 2.0):
        if np.abs(ratio(uv[-1:]) - centre).max() <= share:
            if shared is None:
                shared = SeparableTerm(len(functions))
                functions.append((centre, 1.0))
            octaves.append((shared,))
            continue
        values = ratio(uv).reshape(len(uv), -1)
        # The singular value decomposition of `values` is computed by the eigenvectors of the Gram matrix of `values`,
        # which is smaller than `values`.
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
    """Return equally spaced |w| from ``low`` to ``high``, and the wavenumbers 1/λ [1/µm] that one colour sums.

    At a fixed (u, v), each ring (circle of radius |(u, v)|/λ) of the spectrum belongs to one wavenumber. The result has
    the wavenumbers of all rings that contribute to one colour.
    """
    per_um = np.exp(LOG_RED + (np.arange(ring_count(rings_per_octave)) - 1.0) * math.log(2.0) / rings_per_octave)
    return np.linspace(low, high, _ENTRIES_OVER_W), per_um


def _ratios_at_roots(material: Material, wavelengths_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ratios of a material's reflectance to its reflectance at one angle θd, at Chebyshev nodes of cos θd.

    θd is half of the angle between light and view. The colour curves include the reflectance at the one angle.
    """

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
    """Return the coefficients of splines that are fitted to illuminant times colour-matching functions times material.

    Args:
        rings: Number of rings (circles of constant |(u, v)|/λ) per octave (factor of 2) of the radius.
        illuminated: Illuminant, and the material whose reflectance at cos θd = `_MIDDLE_COSINE` the curves include.
        lines: Whether rows of the power spectrum are powers per unit area of frequency, as ``holds_lines`` of
            :class:`SpectrumBasis` states.

    Returns:
        Weights of consecutive rings, shape (ring_count(rings), 3). The first ring is one ring below the ring of the
        longest visible wavelength. XYZ is the sum of these weights times the spectrum at the rings.
    """
    products = colour_products(illuminated)
    if lines:
        products = products / (1e-3 * np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1))[:, None] ** 2
    result = _projected(products, rings)
    # A constant power spectrum must have the exact colour of white, up to rounding. The weights with which the rings
    # (circles of constant |(u, v)|/λ) of the spectrum contribute to a colour are scaled accordingly.
    return np.asarray(result * products.sum(axis=0) / (math.log(2.0) / rings * result.sum(axis=0)))


def colour_products(illuminated: IlluminatedMaterial) -> NDArray[np.float64]:
    """Return the products S·x̄·R, S·ȳ·R and S·z̄·R at steps of 1 nm, shape (401, 3).

    S is the spectrum of the illuminant, and R is the reflectance that :func:`_on_curve` returns.
    """
    products = colorimetry.colour_products(illuminated.illuminant)
    return products if illuminated.material is None else products * _on_curve(illuminated.material, VISIBLE_NM)[:, None]


def _projected(products: NDArray[np.float64], rings_per_octave: int) -> NDArray[np.float64]:
    """Return the coefficients of splines that are fitted to the colour curves by least squares.

    A colour curve is illuminant times colour-matching function times reflectance. The shape is
    (ring_count(rings_per_octave), 3).
    """
    count = ring_count(rings_per_octave)
    # The splines at both ends extend beyond the visible range, and the fit includes the wavelengths there. At these
    # wavelengths, the colour curves are 0.
    places = (np.arange((count + 4) * _SAMPLES_PER_NODE) + 0.5) / _SAMPLES_PER_NODE - 2.0
    at = 1e3 * np.exp(-(LOG_RED + (places - 1.0) * (math.log(2.0) / rings_per_octave)))
    # The colour curves are multiplied by λ, because the splines are functions of ln λ, and dλ = λ d ln λ.
    curves = at[:, None] * np.stack([np.interp(at, VISIBLE_NM, c, left=0.0, right=0.0) for c in products.T], axis=1)
    size = np.linalg.norm(curves, axis=1)
    weights = 1.0 / np.maximum(size, _LEAST_SCALE * size.max())[:, None]
    splines = spline(places[:, None] - np.arange(count)) * weights
    gram = splines.T @ splines
    gram += 1e-12 * np.trace(gram) * np.eye(count)
    return np.asarray(np.linalg.solve(gram, splines.T @ (curves * weights)))


def spline(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quadratic B-spline at distances from its centre, in units of the knot spacing."""
    away = np.abs(x)
    return np.where(away < 0.5, 0.75 - away**2, 0.5 * np.maximum(1.5 - away, 0.0) ** 2)
