"""Arrays for what rays see: of a picture's pixels, and of tiles, which threads take parts of again and again."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpdiff import supersample
from warpdiff.work import side_by_side

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.launches import Chain


@dataclass(frozen=True)
class Seen:
    """What rays see: the mesh, and under the last light whether it is hidden, deflections, directions to it, gains."""

    pixels: Any
    hidden: wp.array
    deflections: wp.array
    to_lights: wp.array
    gains: wp.array
    footprints: wp.array

    @classmethod
    def by(cls, rays: int, *, device: wp.Device, means: bool, coloured: bool = False) -> Seen:
        """Arrays for so many rays, with footprints if they show ``means``, with base colours if ``coloured``."""
        import warp as wp

        from warpdiff.kernels.scene import Footprint, Pixels

        def empty(dtype: Any, size: int = rays) -> Any:
            return wp.empty(size, dtype=dtype, device=device)

        pixels = Pixels()
        pixels.nearest = empty(wp.uint64, 0)
        pixels.hit, pixels.face, pixels.place = empty(wp.int32), empty(wp.int32), empty(wp.vec2f)
        for name in ("tangent", "bitangent", "normal", "to_view", "shadow_origin"):
            setattr(pixels, name, empty(wp.vec3f))
        pixels.base_colour = empty(wp.vec3f, rays * coloured)
        footprints = empty(Footprint, rays if means else 0)
        return cls(pixels, empty(wp.bool), empty(wp.vec3d), empty(wp.vec3f), empty(wp.float32), footprints)

    @property
    def directions(self) -> tuple[wp.array, wp.array, wp.array]:
        """Deflections, directions to the light and gains."""
        return self.deflections, self.to_lights, self.gains


@dataclass(frozen=True)
class Room:
    """Arrays for rays of tiles.

    Attributes:
        seen: What they see.
        colours: Theirs.
        left_out: What a table leaves out of them.
        tiles: By the number of a tile's rays, the pixels that have the tiles.
    """

    seen: Seen
    colours: wp.array
    left_out: wp.array
    tiles: dict[int, wp.array]

    @classmethod
    def by(cls, rays: int, *, leaves_out: bool, device: wp.Device) -> Room:
        """Room for so many rays."""
        import warp as wp

        left_out = wp.empty(rays * leaves_out, dtype=wp.float32, device=device)
        colours = wp.empty(rays, dtype=wp.vec3f, device=device)
        of_tiles = {kind.rays for kind in supersample.KINDS}
        tiles = {each: wp.empty(rays // each, dtype=wp.int32, device=device) for each in of_tiles}
        return cls(Seen.by(rays, device=device, means=True), colours, left_out, tiles)


class SharedRoom:
    """A room on the CPU, of which each thread takes a part: the launches over one are those over all.

    Attributes:
        room: All of it.
        parts: How many there are.
    """

    def __init__(self, parts: int, *, leaves_out: bool, device: wp.Device) -> None:
        """So many parts."""
        import warp as wp

        from warpdiff.kernels.lookup import RUN

        self.parts, self._run = parts, RUN
        # Whole tiles of any kind, and whole runs of look-ups.
        whole = math.lcm(*(kind.rays for kind in supersample.KINDS), RUN)
        self._size = -(-supersample.MOST_RAYS // whole) * whole
        rays = parts * self._size
        self.room = Room.by(rays, leaves_out=leaves_out, device=device)
        self.room.seen.pixels.nearest = wp.empty(rays, dtype=wp.uint64, device=device)
        self._nearest = self.room.seen.pixels.nearest.numpy()
        self._tiles = {of_tile: tiles.numpy() for of_tile, tiles in self.room.tiles.items()}
        self._colours, self._gains = self.room.colours.numpy(), self.room.seen.gains.numpy()
        # Appending to and taking from a list are atomic.
        self._free = [part * self._size for part in range(parts)]

    def meet(
        self,
        batches: Sequence[supersample.Batch],
        chains: Sequence[Chain],
        nearest: NDArray[np.uint64],
        *,
        threads: int,
    ) -> None:
        """Launch the chain of each kind over the tiles of batches, of whose rays ``nearest`` tells the faces.

        It adds colours to zeros, on so many threads, for each of which there is a part.
        """
        parts = [(batch, part) for batch in batches for part in batch.parts(threads)]
        # The largest first, so that threads finish together.
        parts.sort(key=lambda each: -len(each[1]) * each[0].kind.rays)

        def work(each: tuple[supersample.Batch, range]) -> None:
            batch, part = each
            kind, pixels = batch.kind, batch.pixels[part.start : part.stop]
            first = self._free.pop()
            end = first + len(pixels) * kind.rays
            tile = first // kind.rays
            self._tiles[kind.rays][tile : tile + len(pixels)] = pixels
            if not kind.even:
                ray = batch.first_ray + part.start * kind.rays
                self._nearest[first:end] = nearest[ray : ray + end - first]
            self._colours[first:end] = 0.0
            # Look-ups take whole runs.
            self._gains[end : -(-end // self._run) * self._run] = 0.0
            chains[kind.index].launch(range(first, end))
            self._free.append(first)

        side_by_side(work, parts, threads=threads)


# Those that no picture is in, with and without arrays for what is left out, and how many are kept: to make one takes as
# long as to look up thousands of pixels.
_free: dict[bool, list[SharedRoom]] = {False: [], True: []}
_MOST_FREE = 2


@contextlib.contextmanager
def shared_room(parts: int, *, leaves_out: bool, device: wp.Device) -> Iterator[SharedRoom]:
    """A room of so many parts or more that nobody else is in."""
    free = _free[leaves_out]
    try:
        room = free.pop()
    except IndexError:
        room = None
    if room is None or room.parts < parts:
        room = SharedRoom(parts, leaves_out=leaves_out, device=device)
    yield room
    free.append(room)
    del free[_MOST_FREE:]
