"""Tables for skies: mean colours over Gaussian cells of (u, v), by w, as a tree."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core import memory
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ref
from warpdiff.diffraction import chebyshev
from warpdiff.kernels import sky_sum
from warpdiff.kernels.structs import Footprint
from warpdiff.optics.colorimetry import LAMBDA_MIN_NM
from warpdiff.tables import polar_grid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.tables.lookup import ColourLookup

# Distances of cells: near the mirror direction such a share of what they are per |(u, v)| further out; deviations of
# their Gaussians over their distance, which leave ripples of 1.4 %; how far out they lie.
_NEAR, _WIDTH, _FARTHEST = 0.1, 0.5, 2.05
# Squares of phases from entry to entry of w: a chord errs by an eighth of that. Entries of w, at least and at most.
_MOST_PHASE2, _FEWEST_ENTRIES, _MOST_ENTRIES = 0.025, 24, 256
_LEAST_W = 1e-3
# Entries come from polynomials in w through look-ups: so many more than a height field's oscillations take, for a film.
_MORE_LOOK_UPS = 10
# Deviation of a footprint that holds all of the zeroth order's lobe.
_WIDE = 0.5
_BYTES_PER_ROW = 120.0


def table_for(lookup: ColourLookup, illuminated: Sequence[Sequence[IlluminatedMaterial]], directions: int) -> Any:
    """Return the struct ``SkyTable`` of a look-up, made or found again.

    Args:
        lookup: The look-up.
        illuminated: Spectra by material.
        directions: Greatest number of cells.
    """
    key = tuple(map(tuple, illuminated)), directions
    return lookup.derived.get_or_make(key, lambda: _sky_table(lookup, illuminated, directions))


@single_threaded_blas()
def _sky_table(lookup: ColourLookup, illuminated: Sequence[Sequence[IlluminatedMaterial]], directions: int) -> Any:
    """Make a table, each row of which is a look-up over the footprint that is the cell.

    The zeroth order, whose lobe is narrower than others, has a cell of its own, the first one. Look-ups of a sky's
    spectra have tables of their own, as these are far larger.
    """
    device = lookup.device
    lookups = lookup.with_zeroth_order(zeroth_order=True), lookup.with_zeroth_order(zeroth_order=False)
    lobe_uv = polar_grid.blur(lookup.plan.coherence) * polar_grid.MIDDLE_UM
    places, footprints = cells(directions)
    nodes, spans, order = tree(directions)
    phase = 2.0 * math.pi * lookup.heightfield.height_range_um * 2e3 / LAMBDA_MIN_NM
    entries = min(max(math.ceil(phase / math.sqrt(_MOST_PHASE2)), _FEWEST_ENTRIES), _MOST_ENTRIES)
    memory.require_memory(
        _BYTES_PER_ROW * (len(nodes) + 1) * entries * len(illuminated),
        f"{ref('lights')} with an environment of {directions} directions", f"take {{share}} of {ref('directions')}",
    )  # fmt: skip
    half = 0.5 * phase
    count = min(math.ceil(half + 4.0 * half ** (1.0 / 3.0) + _MORE_LOOK_UPS), entries)
    colours = _cell_colours(
        lookups, places, footprints, chebyshev.nodes(_LEAST_W, 2.0, count), illuminated, device=device
    )
    rows = colours[:, 1:][:, order] * places[order, 3].reshape(-1, 1, 1)
    # Of each node the mean over its cells. One more is beyond the last.
    rows = np.concatenate([rows, np.zeros_like(rows[:, :1])], axis=1)
    rows = np.add.reduceat(rows, spans.ravel(), axis=1)[:, ::2] / nodes[:, 3].reshape(-1, 1, 1)
    rows = np.concatenate([colours[:, :1], rows], axis=1)
    between = chebyshev.cardinals(np.linspace(0.0, 2.0, entries), _LEAST_W, 2.0, count).astype(np.float32)
    rows = np.maximum(between @ rows, 0.0)
    ends = np.searchsorted(spans[:, 0], spans[:, 1])
    result = sky_sum.SkyTable()
    result.nodes = wp.array(np.concatenate([[[0.0, 0.0, lobe_uv, 1.0]], nodes]), dtype=wp.vec4f, device=device)
    result.ends = wp.array(np.concatenate([[1], ends + 1]), dtype=wp.int32, device=device)
    result.rows = wp.array(rows.reshape(-1, 3, 3), dtype=wp.mat33f, device=device)
    result.entries = entries
    return result


def _cell_colours(
    lookups: tuple[ColourLookup, ColourLookup], places: NDArray[np.float32], footprints: NDArray[np.float32],
    ws: NDArray[np.float64], illuminated: Sequence[Sequence[IlluminatedMaterial]], *, device: wp.Device,
) -> NDArray[np.float32]:  # fmt: skip
    """Mean XYZ of the zeroth order and over cells at some |w|, (materials, 1 + cells, len(ws), 3 · spectra)."""
    # The zeroth order is what comes with it of all that is near, without what comes without it.
    places = np.concatenate([np.zeros((1, 4), dtype=np.float32), places])
    footprints = np.concatenate([np.diag([_WIDE, _WIDE]).reshape(1, 4).astype(np.float32), footprints])
    scattering_vectors = np.empty((len(places), len(ws), 3))
    scattering_vectors[:, :, :2] = places[:, None, :2]
    scattering_vectors[:, :, 2] = -ws
    count = len(places) * len(ws)
    spreads = wp.array(np.repeat(footprints, len(ws), axis=0), dtype=Footprint, device=device)
    vectors = wp.array(scattering_vectors.reshape(-1, 3), dtype=wp.vec3d, device=device)
    to_lights = wp.zeros(count, dtype=wp.vec3f, device=device)
    gains = wp.full(count, 1.0, dtype=wp.float32, device=device)
    result = np.empty((len(illuminated), *scattering_vectors.shape, len(illuminated[0])), dtype=np.float32)
    for material, spectra in enumerate(illuminated):
        # Table by table, as not all of them may be kept.
        for spectrum, light in enumerate(spectra):
            total_xyz, colours = (wp.zeros(count, dtype=wp.vec3f, device=device) for _ in lookups)
            lookups[0].accumulate(vectors, to_lights, gains, light, total_xyz, footprints=spreads, among=range(len(ws)))
            lookups[1].accumulate(vectors, to_lights, gains, light, colours, footprints=spreads)
            cell_xyz = colours.numpy().reshape(scattering_vectors.shape)
            cell_xyz[0] = 2.0 * math.pi * _WIDE**2 * (total_xyz.numpy()[: len(ws)] - cell_xyz[0])
            result[material, ..., spectrum] = cell_xyz
    return result.reshape(*result.shape[:3], -1)


@functools.lru_cache(maxsize=16)
def tree(most: int) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
    """Nodes of a tree of cells, parents first: (u, v), deviation and area, (n, 4).

    Then where the cells of each begin and end, (n, 2), and in which order these are cells. Nodes have four children,
    halves of halves across their longer axes, of as many cells.
    """
    places = cells(most)[0].astype(np.float64)
    count = len(places)
    order, starts = np.arange(count), np.zeros(1, dtype=np.int64)
    spans = [np.stack([order, order + 1], axis=1)]
    while len(starts) < count:
        of_level = np.stack([starts, np.append(starts[1:], count)], axis=1)
        spans.append(of_level[of_level[:, 1] - of_level[:, 0] > 1])
        for _ in range(2):
            order, starts = _halve_runs(places[:, :2], order, starts)
    cell_spans = np.concatenate(spans)
    cell_spans = cell_spans[np.lexsort((-cell_spans[:, 1], cell_spans[:, 0]))]
    ordered = places[order]
    area = ordered[:, 3]
    moments = np.stack(
        [area, area * ordered[:, 0], area * ordered[:, 1], area * (ordered[:, 2] ** 2 + 0.5 * _square(ordered))], axis=1
    )
    sums = np.concatenate([np.zeros((1, 4)), moments.cumsum(axis=0)])
    total = sums[cell_spans[:, 1]] - sums[cell_spans[:, 0]]
    middle = total[:, 1:3] / total[:, :1]
    variance = total[:, 3] / total[:, 0] - 0.5 * _square(middle)
    nodes = np.column_stack([middle, np.sqrt(variance), total[:, 0]]).astype(np.float32)
    return nodes, cell_spans, order


def _square(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """|(u, v)|²."""
    return np.asarray(places[:, 0] ** 2 + places[:, 1] ** 2)


def _halve_runs(
    places: NDArray[np.float64], order: NDArray[np.int64], starts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Runs of places, in order, halved across their longer axes where they have several; where these start."""
    counts = np.diff(np.append(starts, len(order)))
    run = np.repeat(np.arange(len(starts)), counts)
    x, y = (places[order] - (np.add.reduceat(places[order], starts, axis=0) / counts[:, None])[run]).T
    xx, xy, yy = (np.add.reduceat(products, starts) for products in (x * x, x * y, y * y))
    angle = (0.5 * np.arctan2(2.0 * xy, xx - yy))[run]
    order = order[np.lexsort((x * np.cos(angle) + y * np.sin(angle), run))]
    return order, np.sort(np.concatenate([starts, (starts + (counts + 1) // 2)[counts > 1]]))


@functools.lru_cache(maxsize=16)
def cells(most: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """At most so many cells, (u, v), deviation and area, (n, 4), and their footprints, (n, 4).

    They lie on rings, as far apart as these: the same near the mirror direction, and further out in proportion to
    |(u, v)|, as orders are. Areas are such that the Gaussians are even together (least squares).
    """
    from scipy.special import ive

    low, high = math.log(0.01), math.log(3.0)
    for _ in range(30):
        middle = 0.5 * (low + high)
        if sum(_rings(math.exp(middle))[1]) <= most:
            high = middle
        else:
            low = middle
    radii, counts, distances = (np.array(array) for array in _rings(math.exp(high)))
    deviations = _WIDTH * distances
    nominal = 2.0 * math.pi * radii * distances / counts
    nominal[0] = math.pi * distances[0] ** 2 / 4.0
    # Means over azimuth of the Gaussians of each ring.
    at = np.concatenate([np.linspace(0.0, radii[3], 60), np.geomspace(radii[3], radii[-2], 12 * len(radii))])[:, None]
    means = ive(0, at * radii / deviations**2) * np.exp(-0.5 * ((at - radii) / deviations) ** 2)
    means *= counts * nominal / (2.0 * math.pi * deviations**2)
    regularisation = 1e-2 * np.eye(len(radii))
    targets = np.concatenate([np.ones(len(at)), regularisation.sum(axis=1)])
    areas = nominal * np.linalg.lstsq(np.concatenate([means, regularisation]), targets, rcond=None)[0]
    places, footprints = [], []
    for ring, (radius, number, deviation) in enumerate(zip(radii, counts, deviations, strict=True)):
        angle = (np.arange(number) + 0.5 * (ring % 2)) * 2.0 * math.pi / number
        cosine, sine = np.cos(angle), np.sin(angle)
        alike = np.ones(number)
        places.append(np.stack([radius * cosine, radius * sine, deviation * alike, areas[ring] * alike], axis=-1))
        footprints.append(deviation * np.stack([cosine, sine, -sine, cosine], axis=-1))
    result = np.concatenate(places).astype(np.float32), np.concatenate(footprints).astype(np.float32)
    for array in result:
        array.setflags(write=False)
    return result


def _rings(spread: float) -> tuple[list[float], list[int], list[float]]:
    """Radii of rings, how many cells lie on each, and how far apart."""
    radii, counts, distances = [0.0], [1], [_NEAR * spread]

    def distance(radius: float) -> float:
        return spread * math.hypot(_NEAR, radius)

    while radii[-1] < _FARTHEST:
        last = radii[-1]
        radius = last + distance(last + 0.5 * distance(last))
        radii.append(radius)
        distances.append(distance(radius))
        counts.append(max(round(2.0 * math.pi * radius / distances[-1]), 1))
    return radii, counts, distances
