"""Tables of the power spectrum on rays, from which a colour is a sum over an octave's nodes.

The spectrum under a window, averaged or centred, is smooth: its Fourier transform is the surface's autocorrelation
under exp(−r²/4σ²). A table that resolves it, in logarithmic polar coordinates, holds the integral over λ of any number
of orders in some twenty nodes, and serves every light and view. It is made once for a height field and a coherence.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import spectrum, tables
from warpdiff.coefficients import holds_powers
from warpdiff.device import launch

if TYPE_CHECKING:
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField
    from warpdiff.planning import Plan
    from warpdiff.scope import Scope

KINDS = ("averaged", "centred")
# Samples along a ray, in standard deviations of the spectrum's blur: a sum of Gaussians so far apart is constant to
# 2 exp(−2π²/1.25²) = 7e-6.
_ALONG = 1.25
# The spectrum is flat to (1/50)²/2 = 2e-4 within this share of a standard deviation.
_FLAT = 0.02
_FEWEST_RAYS = 16
# Entries of the basis from one node to the next; it is linear between them.
_ENTRIES = 8
# Of the largest |κ|: all but the mirror's coefficient vanish below.
_SMALLEST_KAPPA = 1e-3
# Positions between two nodes that colour weights are made for.
_FRACTIONS = 64
_SLICE = 32
# What a sample of the spectrum costs besides its multiply-adds, in as many of them: by itself, and for each neighbour.
_A_SAMPLE, _A_NEIGHBOUR = 800.0, 20.0
_LOG_RED, _LOG_BLUE = (math.log(1e3 / end) for end in (spectrum.LAMBDA_MAX_NM, spectrum.LAMBDA_MIN_NM))
# Nodes an octave and rays in a standard deviation of the blur, of which either errs as much as the other.
RUNGS = ((8, 0.9), (12, 1.0), (16, 1.1), (24, 1.3), (32, 1.5), (48, 1.8), (64, 2.1))
MIN_NODES, MAX_NODES = 4, 512
# A table that is much larger than a processor's caches is no faster than sampling.
MOST_MEGABYTES = 200.0
# Samples of the colour curves from one node to the next.
_PROJECTED = 64
# Errors of the colour curves count relative to them, down to this share of the largest: they vanish at both ends.
_DIM = 0.005


@dataclass(frozen=True)
class Layout:
    """Where the nodes of a table lie.

    Attributes:
        nodes: Nodes an octave.
        log_low: ln t of the first node.
        rays: Rays of each octave.
        divisions: Samples from one node to the next, of each octave.
        highest: Largest frequency that is looked up [1/µm].
    """

    nodes: int
    log_low: float
    rays: tuple[int, ...]
    divisions: tuple[int, ...]
    highest: float

    @classmethod
    def of(cls, plan: Plan, highest: float) -> Layout:
        """The layout for a plan and the largest frequency."""
        width = blur(plan.coherence.sigma_um or 0.0)
        step = math.log(2.0) / plan.nodes
        # A colour takes up to three nodes beyond its octave.
        top = math.log(max(highest, width)) + 3.0 * step
        octaves = math.ceil((top - math.log(_FLAT * width)) / math.log(2.0))
        log_low = top - octaves * math.log(2.0)
        tops = np.exp(log_low + math.log(2.0) * (np.arange(octaves) + 1.0))
        rays = np.maximum(np.ceil(2.0 * math.pi * tops / width * plan.rays_per_width), _FEWEST_RAYS)
        divisions = np.maximum(np.ceil(tops * step / (_ALONG * width)), 1.0)
        return cls(
            plan.nodes, log_low, tuple(rays.astype(int).tolist()), tuple(divisions.astype(int).tolist()), highest
        )

    @property
    def rows(self) -> int:
        """Rows of the table."""
        return sum(self.rays) * self.nodes

    @property
    def samples(self) -> int:
        """Samples of the spectrum that fill it."""
        return sum(ray * d * (self.nodes + 2) for ray, d in zip(self.rays, self.divisions, strict=True))


def blur(sigma_um: float) -> float:
    """Standard deviation of the power spectrum's blur under a window [1/µm]."""
    return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * sigma_um)


def serves(method: str, coherence: Coherence) -> bool:
    """Whether tables can be made for an expansion and a coherence."""
    return coherence.kind in KINDS and holds_powers(method, adds_powers=coherence.adds_powers) == coherence.adds_powers


def node_count(nodes: int) -> int:
    """Nodes that a colour takes of a table with so many an octave."""
    return math.ceil((_LOG_BLUE - _LOG_RED) / math.log(2.0) * nodes) + 3


def expected_error(nodes: int) -> float:
    """Error of colours from a table of a surface with many orders in sight; with a few it is three times as much."""
    return float(0.008 * (20.0 / nodes) ** 1.7)


def rungs_for(tolerance: float) -> tuple[tuple[int, float], ...]:
    """The sizes that may keep a tolerance, the smallest first."""
    return tuple(rung for rung in RUNGS if expected_error(rung[0]) <= tolerance)


def making_multiply_adds(hf: HeightField, plan: Plan) -> float:
    """What a table costs to make, in the multiply-adds of ``Plan``."""
    layout = Layout.of(plan, tables.Reached.by(plan.scope).frequency)
    exponent = -math.log(plan.least_weight)
    neighbours = math.pi * exponent / tables.falloff_um2(plan.coherence) * math.prod(hf.size_um)
    parts = 1 if plan.coherence.adds_powers else 2
    return layout.samples * (_A_SAMPLE + neighbours * (_A_NEIGHBOUR + 2.0 * parts * tables.lanes_of(plan.terms)))


def megabytes(hf: HeightField, plan: Plan) -> float:
    """Size of a table."""
    reached = tables.Reached.by(plan.scope)
    terms = plan.terms if plan.coherence.adds_powers else len(_chebyshev_kappas(hf, _kappas(reached)))
    return Layout.of(plan, reached.frequency).rows * tables.lanes_of(terms) * 4e-6


def multiply_adds(plan: Plan) -> float:
    """Those of a direction."""
    return node_count(plan.nodes) * 6.0 * tables.lanes_of(plan.terms)


def table_for(hf: HeightField, plan: Plan, scope: Scope, *, device: wp.Device, threads: int) -> tuple[Any, Any]:
    """The kernel that integrates, and the struct that it reads, for a plan and for what a call has beyond it."""
    import warp as wp

    from warpdiff.kernels import polar as kernels

    reached = tables.Reached.by(plan.scope.joined(scope))
    layout = Layout.of(plan, reached.frequency)
    key = (device.alias, plan.method, plan.coherence, plan.terms, plan.least_weight, reached, layout)
    held = tables.kept(hf).polar
    if key in held:
        held[key] = held.pop(key)
        return held[key]

    base = tables.table_for(hf, plan, scope, device=device, threads=threads)
    found = base.coefficients
    terms = min(plan.terms, found.terms)
    lanes, powers = tables.lanes_of(terms), plan.coherence.adds_powers
    kappas = _kappas(reached)
    at_nodes = np.zeros(0) if powers else _chebyshev_kappas(hf, kappas)
    width = lanes if powers else tables.lanes_of(len(at_nodes))
    target = kernels.lookup(width)
    struct = target.Polar()
    struct.nodes, struct.log_low, struct.entries = layout.nodes, layout.log_low, _ENTRIES
    struct.per_log, struct.log_red = layout.nodes / math.log(2.0), _LOG_RED
    # The red end of the nearest directions takes the second node, and a spline there begins one before it.
    struct.least_uv = math.exp(layout.log_low + 2.0 / struct.per_log - _LOG_RED)
    struct.rays = wp.array(layout.rays, dtype=wp.int32, device=device)
    struct.firsts = wp.array(np.cumsum([0, *layout.rays]), dtype=wp.int32, device=device)
    struct.log_kappa = math.log(kappas[0])
    entries = math.ceil(math.log(kappas[1] / kappas[0]) * struct.per_log * _ENTRIES) + 2
    at = kappas[0] * np.exp(np.arange(entries) / (struct.per_log * _ENTRIES))
    basis = np.zeros((entries, width), dtype=np.float32)
    bases = np.zeros((width, lanes), dtype=np.float32)
    if powers:
        basis[:, :terms] = found.basis_at(at)[:, :terms]
    else:
        basis[:, : len(at_nodes)] = _cardinals(at, at_nodes)
        bases[: len(at_nodes), :terms] = found.basis_at(at_nodes)[:, :terms]
    struct.basis = wp.array(basis, dtype=target.row, device=device)
    struct.rows = wp.empty(layout.rows, dtype=target.row, device=device)
    resample = kernels.resampler(lanes, powers, width)
    at_kappas = wp.array(bases, dtype=base.arguments.rows.dtype, device=device)
    filtered = wp.empty(layout.rows, dtype=target.row, device=device)
    options = {"device": device, "threads": threads, "slice_size": _SLICE}
    for octave, (rays, divisions) in enumerate(zip(layout.rays, layout.divisions, strict=True)):
        inputs = [base.arguments, at_kappas, struct, octave, divisions, layout.highest]
        launch(resample, rays, inputs, [struct.rows], **options)
        launch(target.interpolate, rays, [struct, octave], [filtered], **options)
    struct.rows = filtered
    held[key] = target.integrate, struct
    while len(held) > tables.KEPT:
        held.pop(next(iter(held)))
    return held[key]


def weights_for(_hf: HeightField, plan: Plan, illuminant: str, *, device: wp.Device) -> Any:
    """The struct ``ColourWeights`` of the kernels, for a plan and an illuminant."""
    import warp as wp

    from warpdiff.kernels import polar as kernels

    result = kernels.ColourWeights()
    result.weights = wp.array(colour_weights(plan.nodes, illuminant), dtype=wp.vec3f, device=device)
    return result


@functools.lru_cache(maxsize=16)
def colour_weights(nodes: int, illuminant: str) -> NDArray[np.float32]:
    """Projections of colour curves on the splines of so many nodes an octave.

    Returns:
        Shape (fractions, node_count(nodes), 3); times a table's rows they add up to XYZ. A fraction is where the red
        end lies between the second node and its neighbours, from −½ to ½.
    """
    step = math.log(2.0) / nodes
    count = node_count(nodes)
    products = spectrum.colour_products(illuminant)
    lambdas = np.arange(spectrum.LAMBDA_MIN_NM, spectrum.LAMBDA_MAX_NM + 1, dtype=np.float64)
    # Nodes beyond the band see darkness there, and their splines' share of it.
    places = (np.arange((count + 4) * _PROJECTED) + 0.5) / _PROJECTED - 2.0
    result = np.empty((_FRACTIONS, count, 3))
    for index in range(_FRACTIONS):
        fraction = (index + 0.5) / _FRACTIONS - 0.5
        at = 1e3 * np.exp(-(_LOG_RED + (places - 1.0 - fraction) * step))
        # dλ = λ d ln λ.
        curves = at[:, None] * np.stack([np.interp(at, lambdas, c, left=0.0, right=0.0) for c in products.T], axis=1)
        size = np.linalg.norm(curves, axis=1)
        weights = 1.0 / np.maximum(size, _DIM * size.max())[:, None]
        splines = _spline(places[:, None] - np.arange(count)) * weights
        gram = splines.T @ splines
        gram += 1e-12 * np.trace(gram) * np.eye(count)
        result[index] = np.linalg.solve(gram, splines.T @ (curves * weights))
    # A spectrum without features keeps its colour to rounding.
    result *= products.sum(axis=0) / (step * result.sum(axis=1, keepdims=True))
    return result.astype(np.float32)


def _spline(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quadratic B-spline."""
    away = np.abs(x)
    return np.where(away < 0.5, 0.75 - away**2, 0.5 * np.maximum(1.5 - away, 0.0) ** 2)


def _kappas(reached: tables.Reached) -> tuple[float, float]:
    """The range of |κ| of the basis."""
    return max(reached.kappa_low, _SMALLEST_KAPPA * reached.kappa_high), reached.kappa_high


def _chebyshev_kappas(hf: HeightField, kappas: tuple[float, float]) -> NDArray[np.float64]:
    """The |κ| between which a power is a polynomial: Chebyshev's nodes, as many as its oscillations take."""
    low, high = kappas
    argument = math.pi * (high - low) * hf.height_range_um
    count = math.ceil(argument + 4.0 * argument ** (1.0 / 3.0) + 2.0)
    angles = math.pi * (np.arange(count) + 0.5) / count
    return np.asarray((low + high) / 2.0 + (high - low) / 2.0 * np.cos(angles))


def _cardinals(kappas: NDArray[np.float64], nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Polynomials that are 1 at one of Chebyshev's nodes and 0 at the others, shape (len(kappas), len(nodes))."""
    count = len(nodes)
    order = np.arange(count)
    half = (nodes.max() - nodes.min()) / (2.0 * math.cos(math.pi / (2 * count))) if count > 1 else 1.0
    middle = (nodes.max() + nodes.min()) / 2.0
    transform = np.cos(np.outer(order, math.pi * (order + 0.5) / count)) * (2.0 / count)
    transform[0] /= 2.0
    position = np.clip((kappas - middle) / half, -1.0, 1.0)
    return np.asarray(np.cos(np.arccos(position)[:, None] * order) @ transform)
