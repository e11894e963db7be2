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
from warpdiff.device import launch, load

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
# Rays of a level that is blurred for footprints, in a standard deviation of all its blur; the widest of these [rad].
_BLURRED_RAYS_PER_WIDTH = 1.3
_WIDEST = 0.4
# Look-ups blur by what remains between two levels: its variance is at most 1.3² spacings squared.
_REMAINDERS, _MOST_REMAINDER = 24, 1.75
# Deviations of the blur that its taps reach.
_REACHED = 2.7
_POSITIONS = 64
# Variance within one of several parts of a footprint, times their number.
_WITHIN = 1.2
# Entries of the basis from one node to the next; it is linear between them.
_ENTRIES = 8
# Of the largest |κ|: all but the mirror's coefficient vanish below.
_SMALLEST_KAPPA = 1e-3
# Positions between two nodes that colour weights are made for.
_FRACTIONS = 32
_SLICE = 32
# What a sample of the spectrum costs besides its multiply-adds, in as many of them: by itself, and for each neighbour.
_A_SAMPLE, _A_NEIGHBOUR = 800.0, 20.0
_LOG_RED, _LOG_BLUE = (math.log(1e3 / end) for end in (spectrum.LAMBDA_MAX_NM, spectrum.LAMBDA_MIN_NM))
# Nodes an octave and rays in a standard deviation of the blur, of which either errs as much as the other.
RUNGS = ((8, 0.9), (12, 1.0), (16, 1.1), (24, 1.3), (32, 1.5), (48, 1.8), (64, 2.1))
MIN_NODES, MAX_NODES = 4, 512
# Orders so many standard deviations of the blur apart hardly touch.
_APART = 4.0
# A table that is much larger than a processor's caches is no faster than sampling.
MOST_MEGABYTES = 200.0
# What a height field keeps of them: some for other lights and views, or a search's last attempts.
_MOST_KEPT_MEGABYTES = 512.0
# Samples of the colour curves from one node to the next.
_PROJECTED = 64
_BLURRED = 16
# Errors of the colour curves count relative to them, down to this share of the largest: they vanish at both ends.
_DIM = 0.005


@dataclass(frozen=True)
class Layout:
    """Where the nodes of a table lie.

    Attributes:
        nodes: Nodes an octave.
        log_low: ln t of the first node.
        rays: Rays of each level and octave.
        widths: What these are blurred by [rad].
        divisions: Samples from one node to the next, of each octave.
        highest: Largest frequency that is looked up [1/µm].
    """

    nodes: int
    log_low: float
    rays: tuple[tuple[int, ...], ...]
    widths: tuple[tuple[float, ...], ...]
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
        divisions = np.maximum(np.ceil(tops * step / (_ALONG * width)), 1.0)
        narrow = np.maximum(np.ceil(2.0 * math.pi * tops / width * plan.rays_per_width), _FEWEST_RAYS)
        rays, widths = [narrow], [np.zeros(octaves)]
        first = 2.0 * math.pi / narrow
        levels = math.ceil(2.0 * math.log2(_WIDEST / float(first.min()))) + 1 if plan.footprint else 0
        for level in range(levels):
            # An octave that is blurred enough already goes on as it is.
            blurred = np.minimum(first * 2.0 ** (level / 2.0), np.maximum(_WIDEST, first))
            total = np.hypot(width / tops, blurred)
            fewer = np.ceil(2.0 * math.pi / total * _BLURRED_RAYS_PER_WIDTH)
            rays.append(np.clip(fewer, _FEWEST_RAYS, narrow))
            widths.append(blurred)
        return cls(
            plan.nodes,
            log_low,
            tuple(tuple(each.astype(int).tolist()) for each in rays),
            tuple(tuple(each.tolist()) for each in widths),
            tuple(divisions.astype(int).tolist()),
            highest,
        )

    @property
    def firsts(self) -> NDArray[np.int64]:
        """The row of each level's and octave's ray 0, and at the end the number of all rows."""
        from warpdiff.kernels.polar import REACH

        counts = (np.asarray(self.rays).ravel() + 2 * REACH) * self.nodes
        first = np.append(np.full(len(counts), REACH * self.nodes), 0)
        return np.asarray(np.concatenate([[0], np.cumsum(counts)]) + first)

    def source(self, level: int, octave: int) -> int:
        """The widest level that another can be made from: what it lacks of the blur spans its rays."""
        width = self.widths[level][octave]
        spacings = [2.0 * math.pi / rays[octave] for rays in self.rays[:level]]
        lacking = [width**2 - each[octave] ** 2 for each in self.widths[:level]]
        return max((k for k in range(level) if lacking[k] >= spacings[k] ** 2), default=0)

    @property
    def rows(self) -> int:
        """Rows of the table."""
        return int(self.firsts[-1])

    @property
    def samples(self) -> int:
        """Samples of the spectrum that fill it."""
        return sum(ray * d * (self.nodes + 2) for ray, d in zip(self.rays[0], self.divisions, strict=True))


def blur(sigma_um: float) -> float:
    """Standard deviation of the power spectrum's blur under a window [1/µm]."""
    return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * sigma_um)


def serves(method: str, coherence: Coherence) -> bool:
    """Whether tables can be made for an expansion and a coherence."""
    return coherence.kind in KINDS and holds_powers(method, adds_powers=coherence.adds_powers) == coherence.adds_powers


def node_count(nodes: int) -> int:
    """Nodes that a colour takes of a table with so many an octave."""
    return math.ceil((_LOG_BLUE - _LOG_RED) / math.log(2.0) * nodes) + 3


def expected_error(nodes: int, *, few: bool = False) -> float:
    """Error of colours from a table of a surface with many orders in sight, or with a few that stand apart."""
    return float((0.024 if few else 0.008) * (20.0 / nodes) ** 1.7)


def stand_apart(hf: HeightField, coherence: Coherence) -> bool:
    """Whether a patch is so small that its orders are further apart than the spectrum's blur spreads them."""
    lengths = [length for n, length in zip(hf.shape, hf.size_um, strict=True) if n > 1]
    return max(lengths, default=0.0) * _APART * blur(coherence.sigma_um or 0.0) < 1.0


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
    return Layout.of(plan, reached.frequency).rows * _width(hf, plan, reached) * 4e-6


def _width(hf: HeightField, plan: Plan, reached: tables.Reached) -> int:
    """Length of a row."""
    terms = plan.terms if plan.coherence.adds_powers else len(_chebyshev_kappas(hf, _kappas(reached)))
    return tables.lanes_of(terms)


def load_kernels(hf: HeightField, plan: Plan, scope: Scope, device: wp.Device) -> None:
    """Begin to load the kernels that make a plan's table and look it up."""
    from warpdiff.kernels import polar as kernels

    width = _width(hf, plan, tables.Reached.by(plan.scope.joined(scope)))
    target = kernels.lookup(width)
    resample = kernels.resampler(tables.lanes_of(plan.terms), plan.coherence.adds_powers, width)
    needed = [resample, target.integrate, target.interpolate]
    load([*needed, target.blur] if plan.footprint else needed, device)


def multiply_adds(plan: Plan) -> float:
    """Those of a direction."""
    return node_count(plan.nodes) * 6.0 * tables.lanes_of(plan.terms)


def table_for(hf: HeightField, plan: Plan, scope: Scope, *, device: wp.Device, threads: int) -> tuple[Any, Any]:
    """The kernel that integrates, and the struct that it reads, for a plan and for what a call has beyond it."""
    reached = tables.Reached.by(plan.scope.joined(scope))
    held = tables.kept(hf).polar

    def key(footprint: bool) -> Any:
        numbers = (plan.terms, plan.least_weight, plan.nodes, plan.rays_per_width)
        return device.alias, plan.method, plan.coherence, numbers, reached, footprint

    if key(plan.footprint) in held:
        held[key(plan.footprint)] = held.pop(key(plan.footprint))
        return held[key(plan.footprint)]
    layout = Layout.of(plan, reached.frequency)
    # Levels are added to a table that has none.
    sharp = held.get(key(False))
    held[key(plan.footprint)] = _made(hf, plan, scope, reached, layout, sharp, device=device, threads=threads)
    while len(held) > 1 and sum(struct.rows.capacity for _, struct in held.values()) > _MOST_KEPT_MEGABYTES * 1e6:
        held.pop(next(iter(held)))
    return held[key(plan.footprint)]


def _made(
    hf: HeightField,
    plan: Plan,
    scope: Scope,
    reached: tables.Reached,
    layout: Layout,
    sharp: tuple[Any, Any] | None,
    *,
    device: wp.Device,
    threads: int,
) -> tuple[Any, Any]:
    """A new table; its first level may be at hand."""
    import warp as wp

    from warpdiff.kernels import polar as kernels

    base = tables.table_for(hf, plan, scope, device=device, threads=threads)
    found, powers = base.coefficients, plan.coherence.adds_powers
    terms = min(plan.terms, found.terms)
    lanes = tables.lanes_of(terms)
    kappas = _kappas(reached)
    at_nodes = np.zeros(0) if powers else _chebyshev_kappas(hf, kappas)
    width = lanes if powers else tables.lanes_of(len(at_nodes))
    target = kernels.lookup(width)
    resample = kernels.resampler(lanes, powers, width)
    struct = target.Polar()
    struct.nodes, struct.log_low, struct.entries = layout.nodes, layout.log_low, _ENTRIES
    struct.per_log = per_log = layout.nodes / math.log(2.0)
    struct.first_red = (_LOG_RED - layout.log_low) * per_log
    # The red end of the nearest directions takes the second node, and a spline there begins one before it.
    struct.least_uv = math.exp(layout.log_low + 2.0 / per_log - _LOG_RED)
    struct.rays = wp.array(layout.rays, dtype=wp.int32, device=device)
    struct.widths = wp.array(layout.widths, dtype=wp.float32, device=device)
    struct.firsts = wp.array(layout.firsts[:-1].reshape(np.shape(layout.rays)), dtype=wp.int32, device=device)

    struct.first_entry = (layout.log_low - math.log(kappas[0])) * per_log * _ENTRIES
    entries = math.ceil(math.log(kappas[1] / kappas[0]) * per_log * _ENTRIES) + 2
    at = kappas[0] * np.exp(np.arange(entries) / (per_log * _ENTRIES))
    basis = np.zeros((entries, width), dtype=np.float32)
    bases = np.zeros((width, lanes), dtype=np.float32)
    if powers:
        basis[:, :terms] = found.basis_at(at)[:, :terms]
    else:
        basis[:, : len(at_nodes)] = _cardinals(at, at_nodes)
        bases[: len(at_nodes), :terms] = found.basis_at(at_nodes)[:, :terms]
    struct.basis = wp.array(basis, dtype=target.row, device=device)
    struct.rows = wp.empty(layout.rows, dtype=target.row, device=device)
    if sharp is not None:
        wp.copy(struct.rows, sharp[1].rows, count=len(sharp[1].rows))
    at_kappas = wp.array(bases, dtype=base.arguments.rows.dtype, device=device)
    values = wp.empty(max(layout.rays[0]) * layout.nodes, dtype=target.row, device=device)
    options: dict[str, Any] = {"device": device, "threads": threads}
    for octave, divisions in enumerate(layout.divisions):
        for level, rays in enumerate(layout.rays):
            if level == 0 and sharp is None:
                inputs = [base.arguments, at_kappas, struct, octave, divisions, layout.highest]
                launch(resample, rays[octave], inputs, [values], slice_size=_SLICE, **options)
            elif level > 0:
                source = layout.source(level, octave)
                launch(target.blur, rays[octave], [struct, source, level, octave], [values], **options)
            if level > 0 or sharp is None:
                repeated = rays[octave] + 2 * kernels.REACH
                launch(target.interpolate, repeated, [values, struct, level, octave], [struct.rows], **options)
    return target.integrate, struct


def weights_for(plan: Plan, illuminant: str, *, device: wp.Device) -> Any:
    """The struct ``ColourWeights`` of the kernels, for a plan and an illuminant."""
    import warp as wp

    from warpdiff.kernels import polar as kernels

    ratios = _ratios(plan.nodes) if plan.footprint else (0.0,)
    sets = [colour_weights(plan.nodes, illuminant, ratio) for ratio in ratios]
    margins = [(each.shape[1] - sets[0].shape[1]) // 2 for each in sets]
    padded = np.zeros((len(sets), *sets[-1].shape), dtype=np.float32)
    for index, (each, margin) in enumerate(zip(sets, margins, strict=True)):
        begin = margins[-1] - margin
        padded[index, :, begin : begin + each.shape[1]] = each
    result = kernels.ColourWeights()
    result.weights = wp.array(padded, dtype=wp.vec3f, device=device)
    result.margins = wp.array(margins, dtype=wp.int32, device=device)
    result.first = ratios[min(1, len(ratios) - 1)] ** 2
    return result


def _ratios(nodes: int) -> tuple[float, ...]:
    """Deviations in ln λ that colour weights are blurred by."""
    first = math.log(2.0) / nodes
    return (0.0, *(first * 2.0 ** (k / 2.0) for k in range(math.ceil(2.0 * math.log2(_WIDEST / first)) + 1)))


def blending(device: wp.Device) -> Any:
    """The struct ``Blending`` of the kernels."""
    import warp as wp

    from warpdiff.kernels import polar as kernels

    result = kernels.Blending()
    weights, reaches = _blends(kernels.REACH)
    result.weights = wp.array(weights, dtype=wp.float32, device=device)
    result.reaches = wp.array(reaches, dtype=wp.int32, device=device)
    result.per_variance = (_REMAINDERS - 1) / _MOST_REMAINDER
    result.parts = wp.array(_parts(kernels.MOST_PARTS), dtype=wp.float32, device=device)
    return result


@functools.cache
def _parts(most: int) -> NDArray[np.float64]:
    """The normal distribution as 1 … ``most`` narrower ones: their variance, places and weights, (most, 3, most).

    Places and weights are those of Gauss and Hermite, so that moments up to 2 count − 1 are kept.
    """
    result = np.zeros((most, 3, most))
    for count in range(1, most + 1):
        within = min(1.0, _WITHIN / count)
        places, weights = np.polynomial.hermite_e.hermegauss(count)
        result[count - 1, 0] = within
        result[count - 1, 1, :count] = math.sqrt(1.0 - within) * places
        result[count - 1, 2, :count] = weights / weights.sum()
    return result


@functools.cache
def _blends(reach: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Weights of the rays around an angle, (variances, fractions, 2 reach + 1), and how far those reach that count."""
    fine = np.arange(-512, 513) / 64.0
    spline = _spline(fine)
    offsets = np.arange(-reach, reach + 1)
    weights = np.zeros((_REMAINDERS, _POSITIONS, 2 * reach + 1))
    reaches = np.zeros(_REMAINDERS, dtype=np.int32)
    for index in range(_REMAINDERS):
        variance = index / (_REMAINDERS - 1) * _MOST_REMAINDER
        blurred = spline
        if variance > 0.0:
            gaussian = np.exp(-0.5 * fine**2 / variance)
            blurred = np.convolve(spline, gaussian / gaussian.sum(), mode="same")
        reaches[index] = 1 if index == 0 else min(math.ceil(_REACHED * math.sqrt(variance + 0.25)), reach)
        for position in range(_POSITIONS):
            f = (position + 0.5) / _POSITIONS - 0.5
            each = np.interp(offsets - f, fine, blurred) * (np.abs(offsets) <= reaches[index])
            weights[index, position] = each / each.sum()
    return weights, reaches


@functools.lru_cache(maxsize=64)
def colour_weights(nodes: int, illuminant: str, ratio: float = 0.0) -> NDArray[np.float32]:
    """Projections of colour curves on the splines of so many nodes an octave.

    Args:
        nodes: Nodes an octave.
        illuminant: A name.
        ratio: Standard deviation in ln λ by which the curves are blurred.

    Returns:
        Shape (fractions, node_count(nodes) and twice a margin, 3); times a table's rows they add up to XYZ. A fraction
        is where the red end lies between the second node behind the margin and its neighbours, from −½ to ½.
    """
    step = math.log(2.0) / nodes
    margin = math.ceil(_REACHED * ratio / step)
    products = spectrum.colour_products(illuminant)
    fractions = (np.arange(_FRACTIONS) + 0.5) / _FRACTIONS - 0.5
    if ratio == 0.0:
        result = np.stack([_projected(products, nodes, fraction) for fraction in fractions])
    else:
        result = _blurred_and_interpolated(products, nodes, ratio, margin, fractions)
    # A spectrum without features keeps its colour to rounding.
    result *= products.sum(axis=0) / (step * result.sum(axis=1, keepdims=True))
    return result.astype(np.float32)


def _curves(products: NDArray[np.float64], places: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Colour curves over ln λ at so many nodes from the red end; darkness beyond either end."""
    at = 1e3 * np.exp(-(_LOG_RED + places * step))
    lambdas = np.arange(spectrum.LAMBDA_MIN_NM, spectrum.LAMBDA_MAX_NM + 1, dtype=np.float64)
    # dλ = λ d ln λ.
    found = np.stack([np.interp(at, lambdas, c, left=0.0, right=0.0) for c in products.T], axis=1)
    return np.asarray(at[:, None] * found)


def _projected(products: NDArray[np.float64], nodes: int, fraction: float) -> NDArray[np.float64]:
    """The splines' coefficients that come closest to the colour curves, shape (node_count(nodes), 3)."""
    count = node_count(nodes)
    # Nodes beyond the band see darkness there, and their splines' share of it.
    places = (np.arange((count + 4) * _PROJECTED) + 0.5) / _PROJECTED - 2.0
    curves = _curves(products, places - 1.0 - fraction, math.log(2.0) / nodes)
    size = np.linalg.norm(curves, axis=1)
    weights = 1.0 / np.maximum(size, _DIM * size.max())[:, None]
    splines = _spline(places[:, None] - np.arange(count)) * weights
    gram = splines.T @ splines
    gram += 1e-12 * np.trace(gram) * np.eye(count)
    return np.asarray(np.linalg.solve(gram, splines.T @ (curves * weights)))


def _blurred_and_interpolated(
    products: NDArray[np.float64], nodes: int, ratio: float, margin: int, fractions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The splines through blurred colour curves, shape (fractions, node_count(nodes) + 2 margin, 3)."""
    step = math.log(2.0) / nodes
    count = node_count(nodes) + 2 * margin
    beyond = margin + 8
    fine = np.arange(-beyond * _BLURRED, (count - margin + 8) * _BLURRED + 1) / _BLURRED
    away = np.arange(-margin * _BLURRED, margin * _BLURRED + 1) / _BLURRED
    gaussian = np.exp(-0.5 * (away * step / ratio) ** 2)
    curves = _curves(products, fine, step)
    blurred = [np.convolve(c, gaussian / gaussian.sum(), mode="same") for c in curves.T]
    taps = np.arange(-6, 7)
    # The interpolating filter of the quadratic spline.
    inverse = math.sqrt(2.0) * (2.0 * math.sqrt(2.0) - 3.0) ** np.abs(taps)
    places = np.arange(count)[:, None] + taps - 1.0 - margin
    return np.stack(
        [np.stack([np.interp(places - fraction, fine, c) @ inverse for c in blurred], axis=1) for fraction in fractions]
    )


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
