"""From rows of the power spectrum on spokes to colours: colour curves on splines, and the functions of w they share."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.blas_threads import on_one_thread
from warpdiff.optics import colorimetry
from warpdiff.plans.plan import FUNCTIONS, MOST_FUNCTIONS
from warpdiff.tables.polar_layout import LOG_RED, node_count

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.plans.plan import Plan

# Entries of the functions of w, between which they are cubics: 32 an oscillation and more.
_ENTRIES_OVER_W = 160
# Where colours are this share of the largest, errors count as there.
_LEAST_SCALE_OVER_W = 1e-2
# Samples of the colour curves from one node to the next.
_SAMPLES_PER_NODE = 64
# Errors of the colour curves count relative to them, down to this share of the largest: they vanish at both ends.
_LEAST_SCALE = 0.005


@dataclass(frozen=True)
class Terms:
    """The terms that rows of the spectrum consist of.

    Attributes:
        basis_at: The functions of |κ| that a row's numbers multiply, for |κ| (n,) of shape (n, terms).
        kappas: The range of |κ| [1/µm].
        sizes: How much each term matters, (terms,).
        share: Of the tolerance, what functions of w may leave out.
    """

    basis_at: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    kappas: tuple[float, float]
    sizes: NDArray[np.float64]
    share: float


@dataclass(frozen=True)
class Projection:
    """The weights that turn rows of the spectrum into colours.

    Attributes:
        ws: |w| at equal steps.
        functions: Functions of these that all colours share, shape (entries, m).
        matrices: For each node from the one before a colour's own to its blue end and beyond, and for each term, the
            coefficients of the functions, shape (nodes, terms, m).
        weights: What these count for X, Y and Z, shape (nodes, 3).
    """

    ws: NDArray[np.float64]
    functions: NDArray[np.float32]
    matrices: NDArray[np.float32]
    weights: NDArray[np.float32]


@on_one_thread()
def projection(plan: Plan, terms: Terms, illuminant: str) -> Projection:
    """The projection for a plan's nodes and its functions of w, or as many of these as its tolerance asks for."""
    # The range of |w| whose |κ| at all wavelengths are within the terms'.
    low, high = terms.kappas[0] * colorimetry.LAMBDA_MAX_NM * 1e-3, terms.kappas[1] * colorimetry.LAMBDA_MIN_NM * 1e-3
    ws = np.linspace(low, high, _ENTRIES_OVER_W)
    weights = colour_weights(plan.nodes, illuminant, lines=plan.coherence.kind == "source")
    per_um = np.exp(LOG_RED + (np.arange(len(weights)) - 1.0) * math.log(2.0) / plan.nodes)
    count = len(terms.sizes)
    kappas = np.clip(ws[:, None] * per_um, *terms.kappas)
    basis = terms.basis_at(kappas.ravel()).reshape(len(ws), len(per_um), count)
    matrix = (basis * terms.sizes * np.linalg.norm(weights, axis=1)[:, None]).reshape(len(ws), -1)
    norms = np.linalg.norm(matrix, axis=1)
    relative = 1.0 / np.maximum(norms, _LEAST_SCALE_OVER_W * norms.max())[:, None]
    # A singular value decomposition, by the eigenvectors of so small a matrix that threads of a library, which wait for
    # each other at every step, do not make it longer where a core is not theirs.
    matrix *= relative
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    squares, left = np.maximum(values, 0.0), vectors[:, ::-1]
    # What the first functions leave out, 0, 1, …, at the |w| where that is most: a call may see no other.
    remaining = np.sqrt(np.append(np.cumsum(squares * vectors**2, axis=1).max(axis=0)[::-1], 0.0))
    needed = int(np.argmax(remaining <= terms.share * plan.tolerance))
    m = plan.functions or min(FUNCTIONS * math.ceil(max(needed, 1) / FUNCTIONS), MOST_FUNCTIONS)
    functions = left[:, :m] / relative
    matrices = np.einsum("wm,wil->ilm", left[:, :m] * relative, basis)
    return Projection(ws, functions.astype(np.float32), matrices.astype(np.float32), weights.astype(np.float32))


@functools.lru_cache(maxsize=64)
def colour_weights(nodes: int, illuminant: str, *, lines: bool = False) -> NDArray[np.float64]:
    """Projections of colour curves on the splines of so many nodes an octave.

    Args:
        nodes: Nodes an octave.
        illuminant: A name.
        lines: Whether rows are densities of lines over frequency, which over (u, v) are λ⁻² of it.

    Returns:
        Shape (node_count(nodes), 3); times the spectrum's values from the node before the red end on they add up to
        XYZ.
    """
    products = colorimetry.colour_products(illuminant)
    if lines:
        products = products / (1e-3 * np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1))[:, None] ** 2
    result = _projected(products, nodes)
    # A spectrum without features keeps its colour to rounding.
    return np.asarray(result * products.sum(axis=0) / (math.log(2.0) / nodes * result.sum(axis=0)))


def _curves(products: NDArray[np.float64], places: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Colour curves over ln λ at so many nodes from the red end; darkness beyond either end."""
    at = 1e3 * np.exp(-(LOG_RED + places * step))
    lambdas = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64)
    # dλ = λ d ln λ.
    found = np.stack([np.interp(at, lambdas, c, left=0.0, right=0.0) for c in products.T], axis=1)
    return np.asarray(at[:, None] * found)


def _projected(products: NDArray[np.float64], nodes: int) -> NDArray[np.float64]:
    """The splines' coefficients that come closest to the colour curves, shape (node_count(nodes), 3)."""
    count = node_count(nodes)
    # Nodes beyond the band see darkness there, and their splines' share of it.
    places = (np.arange((count + 4) * _SAMPLES_PER_NODE) + 0.5) / _SAMPLES_PER_NODE - 2.0
    curves = _curves(products, places - 1.0, math.log(2.0) / nodes)
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
