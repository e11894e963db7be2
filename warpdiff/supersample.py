"""More rays where one footprint will not do: on pixels that differ much from those beside them.

What a footprint leaves out, all that is no Gaussian of (u, v), changes a pixel the more the steeper the picture is and
the less evenly (u, v) changes there. Such a pixel is met by a tile of rays, each with a narrower footprint of its own.
Where (u, v) changes evenly from pixel to pixel, what these see follows from what those around see, and none is cast.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.launches import Step, launch, launch_in_turn
from warpdiff.work import slices_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import warp as wp
    from numpy.typing import NDArray


# Of a Gaussian of 0.5 pixel cut at 1.5, along one axis: 0.5² (1 − 4.5 e^−4.5 / (1 − e^−4.5)) is its variance.
FILTER_DEVIATION = 0.5 * math.sqrt(1.0 - 4.5 * math.exp(-4.5) / (1.0 - math.exp(-4.5)))
# Error of a footprint's mean over the pixel's contrast with those beside it, where (u, v) is uneven: docs/decisions.md.
_ERROR_OF_CONTRAST = 0.06
# Deviation of the filters on a spiral, which falls with their number: a third wider than those of grids.
_OF_SPIRALS, _WIDEST_OF_SPIRALS = 0.9, 0.46
# Rays at a time: worth what comes before their launches, and bounded by their memory, of which a GPU has more.
_LEAST_RAYS, MOST_RAYS, _MOST_RAYS_ALONE = 8192, 32_768, 1 << 20
# Rays whose faces are found together, eight bytes each.
_MOST_FOUND = 1 << 26
# What errors are relative to at least: so much of the luminance that so many of the lit pixels exceed, as some tell.
FLOOR, EXCEEDED_BY = 1e-3, 0.01
TINY = float(np.finfo(np.float32).tiny)
_GLIMPSE = 16_384
# Pixels of a slice, each of which makes lists of its own.
_SLICE = 32_768


@dataclass(frozen=True)
class Tile:
    """Rays through one pixel, on a square grid about its centre, each with a Gaussian filter of its own.

    Distances, deviations and weights are those whose sum, integrated along lines of any direction, comes closest to the
    pixel's filter, in relative terms down to a tenth of its peak: to 5 % of the peak, and on average over a tenth of a
    pixel to 3 %.

    Attributes:
        across: Rays along each side.
        apart: Their distance [pixels].
        deviation: Of their own filters [pixels].
        weights: By the smaller and the larger of a ray's distances along the sides from the middle, in half of
            ``apart``.
    """

    across: int
    apart: float
    deviation: float
    weights: dict[tuple[int, int], float]

    @functools.cached_property
    def rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places (right, down) of the pixel's centre (n, 2), and weights (n,), which add up to 1."""
        halves = range(1 - self.across, self.across, 2)
        pairs = [(right, down) for down in halves for right in halves]
        weights = [self.weights[min(abs(x), abs(y)), max(abs(x), abs(y))] for x, y in pairs]
        return np.array(pairs) * (self.apart / 2.0), np.array(weights) / sum(weights)

    def on(self, device: wp.Device) -> tuple[wp.array, wp.array]:
        """The rays on a device."""
        return _on_device(self.across**2, device.alias)


_TILES = (
    Tile(2, 0.5, 0.42, {(1, 1): 0.25}),
    Tile(3, 0.525, 0.34, {(0, 0): 0.3035, (0, 2): 0.1234, (2, 2): 0.0507}),
    Tile(4, 0.525, 0.28, {(1, 1): 0.1706, (1, 3): 0.0372, (3, 3): 0.005}),
    Tile(5, 0.45, 0.22, {(0, 0): 0.1638, (0, 2): 0.099, (0, 4): 0.0214, (2, 2): 0.055, (2, 4): 0.016, (4, 4): 0.0016}),
)
# By their number of rays; other numbers make no grid.
TILES = {tile.across**2: tile for tile in _TILES}
# Pixels whose predicted error exceeds the tolerance by these factors take so many rays.
_TAKEN = ((1.0, TILES[9]), (3.0, TILES[25]))


@functools.cache
def _on_device(rays: int, device: str) -> tuple[wp.array, wp.array]:
    """Those of a tile of so many, on the device of a name."""
    import warp as wp

    places, weights = TILES[rays].rays
    return wp.array(places, dtype=wp.vec2d, device=device), wp.array(weights, dtype=wp.float32, device=device)


@functools.cache
def rays_of(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Rays through one pixel, each with a filter of its own: places (n, 2), weights (n,) and the filters' deviation.

    One has the pixel's filter. Numbers that make no grid lie on a spiral of golden angles (Vogel 1979), as far out as a
    Gaussian is wide that makes the pixel's filter with theirs.
    """
    if count == 1:
        return np.zeros((1, 2)), np.ones(1), FILTER_DEVIATION
    if count in TILES:
        return *TILES[count].rays, TILES[count].deviation
    deviation = min(_OF_SPIRALS * count**-0.36, _WIDEST_OF_SPIRALS)
    index = np.arange(count)
    radius = np.sqrt(-np.log(1.0 - (index + 0.5) / count))
    angle = index * math.pi * (3.0 - math.sqrt(5.0))
    places = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    places -= places.mean(axis=0)
    places *= math.sqrt((FILTER_DEVIATION**2 - deviation**2) / np.mean(places**2))
    return places, np.full(count, 1.0 / count), deviation


@dataclass(frozen=True)
class Kind:
    """Pixels that are met in the same way.

    Attributes:
        index: Among ``KINDS``; ``classify`` numbers them from 2 on.
        tile: The rays that each of them takes.
        even: Whether what these see follows from what those around the pixel see.
        shadows: Whether a shadow's edge may pass through them; otherwise all pixels beside them are lit.
    """

    index: int
    tile: Tile
    even: bool
    shadows: bool

    @property
    def rays(self) -> int:
        """How many a pixel takes."""
        return self.tile.across**2


# Room for the rays of any tile, in whole vectors of eight floats.
LANES = -(-max(tile.across**2 for _, tile in _TAKEN) // 8) * 8
KINDS = tuple(Kind(3 * i + s, tile, s == 0, s == 2) for i, (_, tile) in enumerate(_TAKEN) for s in range(3))


@dataclass(frozen=True)
class Batch:
    """Pixels of one kind, by their numbers, (n,), whose rays come after so many of others, unless it is even."""

    kind: Kind
    pixels: NDArray[np.int32]
    first_ray: int

    @property
    def end_ray(self) -> int:
        """The ray after its last one."""
        return self.first_ray + (0 if self.kind.even else len(self.pixels) * self.kind.rays)

    def parts(self, threads: int) -> Iterator[range]:
        """Ranges of the pixels to be met at a time."""
        rays = self.kind.rays
        return slices_of(len(self.pixels), least=_LEAST_RAYS // rays, most=MOST_RAYS // rays, threads=threads)


def most_threads(pixels: int) -> int:
    """How many threads the tiles of so many pixels are worth, at most."""
    return -(-pixels * max(kind.rays for kind in KINDS) // _LEAST_RAYS)


def groups(batches: list[Batch]) -> Iterator[list[Batch]]:
    """The batches together, or in parts where the faces of all their rays would take too much memory."""
    if batches and batches[-1].end_ray <= _MOST_FOUND:
        yield batches
        return
    for batch in batches:
        size = _MOST_FOUND // batch.kind.rays
        for first in range(0, len(batch.pixels), size):
            yield [Batch(batch.kind, batch.pixels[first : first + size], 0)]


@functools.lru_cache(maxsize=16)
def _bounds(tolerance: float, device: str) -> wp.array:
    """The contrasts from which pixels take more rays, on the device of a name."""
    import warp as wp

    bounds = [above * tolerance / _ERROR_OF_CONTRAST for above, _ in _TAKEN]
    return wp.array(bounds, dtype=wp.float32, device=device)


def batches(
    colours: wp.array,
    deflections: wp.array,
    gains: wp.array,
    width: int,
    tolerance: float,
    *,
    among: range,
    device: wp.Device,
    threads: int,
) -> tuple[int, list[Batch]]:
    """How many pixels of a picture are lit, and those whose predicted error exceeds the tolerance.

    ``among`` is which of them there may be.
    """
    import warp as wp

    from warpdiff.kernels import directions

    if not among:
        return 0, []
    # How bright a picture is, a part of it tells.
    apart = _apart(len(gains))
    some = slice(-(-among.start // apart) * apart, among.stop, apart)
    bright = colours.numpy()[some, 1][gains.numpy()[some] > 0.0]
    least = 0.0
    if len(bright):
        rank = len(bright) - 1 - int(EXCEEDED_BY * len(bright))
        least = FLOOR * float(np.partition(bright, rank)[rank])
    floor = wp.array(np.array([max(least, TINY)], dtype=np.float32), dtype=wp.float32, device=device, copy=False)
    starts = among[::_SLICE]

    def empty(shape: Any, dtype: Any = wp.int32) -> Any:
        return wp.empty(shape, dtype=dtype, device=device)

    lists, counts = empty((len(KINDS), len(gains))), empty((len(starts), len(KINDS) + 1))
    inputs = [colours, deflections, gains, width, floor, _bounds(tolerance, device.alias), among.start, _SLICE]
    step = Step(directions.list_steep, inputs, [empty(len(gains), wp.uint8), lists, counts], in_runs=True)
    launch_in_turn([step], among, device=device, threads=threads, slice_size=_SLICE)
    listed, numbers = lists.numpy(), counts.numpy()
    found, rays = [], 0
    for kind in KINDS:
        of_kind = zip(starts, numbers[:, kind.index], strict=True)
        pixels = np.concatenate([listed[kind.index, start : start + count] for start, count in of_kind])
        if len(pixels):
            found.append(Batch(kind, pixels, rays))
            rays = found[-1].end_ray
    return int(numbers[:, -1].sum()), found


def _apart(pixels: int) -> int:
    """How far those are apart that tell how bright a picture is: an odd step does not stay in some columns."""
    return pixels // _GLIMPSE | 1


class Queue:
    """The same for a device that lists these pixels, and works the lists off, without the host.

    Attributes:
        most_rays: Those that are met at a time, tiles of any kind filling them.
    """

    def __init__(self, pixels: int, lights: int, tolerance: float, *, device: wp.Device, threads: int) -> None:
        """Room for the lists of a picture, one light after the other."""
        import warp as wp

        from warpdiff.kernels import steep

        def empty(shape: Any, dtype: Any = wp.int32) -> Any:
            return wp.empty(shape, dtype=dtype, device=device)

        self._device = device
        self._options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _SLICE, "in_runs": True}
        self._bounds = _bounds(tolerance, device.alias)
        self._tallies, self._floor = empty(steep.GROUPS * (1 + steep.BINS)), empty(1, wp.float32)
        self._classes = empty(pixels, wp.uint8)
        self._lists, self._counts = empty((len(KINDS), pixels)), empty((lights, len(KINDS) + 1))
        self._taken, self._left = empty(len(KINDS)), empty(1)
        whole = math.lcm(*(kind.rays for kind in KINDS))
        self.most_rays = -(-min(max(kind.rays for kind in KINDS) * pixels, _MOST_RAYS_ALONE) // whole) * whole

    @property
    def lights(self) -> int:
        """How many lights there is room for."""
        return len(self._counts)

    @property
    def counts(self) -> tuple[int, int]:
        """How many pixels are lit, and how many of them were listed, summed over all lights."""
        listed = self._counts.numpy().sum(axis=0)
        return int(listed[-1]), int(listed[:-1].sum())

    def list_up(self, which: int, colours: wp.array, deflections: wp.array, gains: wp.array, width: int) -> None:
        """List the pixels under one light whose predicted error exceeds the tolerance."""
        import warp as wp

        from warpdiff.kernels import directions, steep

        counts = self._counts[which]
        for each in (self._tallies, counts, self._taken):
            each.zero_()
        pixels = len(gains)
        apart = _apart(pixels)
        launch(steep.tally, -(-pixels // apart), [colours, gains, apart], [self._tallies], **self._options)
        wp.launch(steep.find_floor, dim=1, inputs=[self._tallies], outputs=[self._floor], device=self._device)
        inputs = [colours, deflections, gains, width, self._floor, self._bounds]
        launch(directions.classify, pixels, inputs, [self._classes], **self._options)
        launch(steep.list_up, pixels, [self._classes], [self._lists, counts], **self._options)

    def work_off(self, which: int, kind: Kind, steps: Sequence[Step], tiles: wp.array, of_rays: wp.array) -> None:
        """Launch what meets as many pixels of a kind as there is room for in ``tiles`` until none is left; −1 is none.

        The colours of the rays are added to zeros in ``of_rays``.
        """
        import warp as wp

        from warpdiff.kernels import steep

        counts = self._counts[which]

        def go_on(count: int) -> None:
            inputs, outputs = [counts, kind.index, count], [self._taken, self._left]
            wp.launch(steep.go_on, dim=1, inputs=inputs, outputs=outputs, device=self._device)

        def meet() -> None:
            inputs = [self._lists, counts, self._taken, kind.index]
            launch(steep.take, len(tiles), inputs, [tiles], **self._options)
            of_rays.zero_()
            launch_in_turn(steps, len(tiles) * kind.rays, device=self._device, threads=1)
            go_on(len(tiles))

        go_on(0)
        wp.capture_while(self._left, meet)


def tiles_of(batches: Sequence[Batch], width: int, height: int, device: wp.Device) -> Any:
    """The struct ``Tiles`` of the kernels for these batches of a picture of this size, rays batch after batch."""
    import warp as wp

    from warpdiff.kernels import scene

    first_rays = np.empty(width * height, dtype=np.int32)
    # Rows begin with words of their own.
    marks = np.zeros((height, -(-width // 64) * 64), dtype=np.bool_)
    ends = np.zeros(len(KINDS), dtype=np.int32)
    for batch in batches:
        if batch.kind.even:
            continue
        marks[batch.pixels // width, batch.pixels % width] = True
        first_rays[batch.pixels] = np.arange(batch.first_ray, batch.end_ray, batch.kind.rays, dtype=np.int32)
        ends[batch.kind.index] = batch.end_ray
    words = np.packbits(marks, bitorder="little").view(np.uint64)
    result = scene.Tiles()
    result.marks = wp.array(words, dtype=wp.uint64, device=device, copy=False)
    result.first_rays = wp.array(first_rays, dtype=wp.int32, device=device, copy=False)
    result.ends = wp.array(np.maximum.accumulate(ends), dtype=wp.int32, device=device, copy=False)
    result.across, result.apart = _grids(device.alias)
    return result


@functools.cache
def _grids(device: str) -> tuple[wp.array, wp.array]:
    """Rays along a side of each kind, and their distance, on the device of a name."""
    import warp as wp

    across = wp.array([kind.tile.across for kind in KINDS], dtype=wp.int32, device=device)
    return across, wp.array([kind.tile.apart for kind in KINDS], dtype=wp.float64, device=device)


def add(colours: wp.array, xyz: wp.array, *, among: range, device: wp.Device, threads: int) -> None:
    """Add a light's colours to some of a picture's."""
    from warpdiff.kernels import directions

    step = Step(directions.accumulate, [colours], [xyz], in_runs=True)
    launch_in_turn([step], among, device=device, threads=threads, slice_size=_SLICE)
