"""Files of one frame, drawn in this process or by workers of a Dask cluster: the bytes are the same.

Workers (https://distributed.dask.org) may join or leave.
"""

from __future__ import annotations

import copy
import functools
import pickle
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdiff.core.caching import LruCache
from warpdiff.lights.environment import Environment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from warpdiff.apps.sequences.shots import Shot
    from warpdiff.image.image import Image
    from warpdiff.lights.base import Light
    from warpdiff.render.renderer import Renderer

# How often a frame may be lost with its worker, or all that was sent there.
_RETRIES = 5
# Frames that are given out for each thread of a worker: what comes back waits to be written.
_AHEAD = 2
# Limit: skies whose arrays are kept, so that those at rest are not uploaded again.
_MOST_SKIES = 2


@dataclass(frozen=True)
class FrameJob:
    """The part of the work that all frames of a sequence share.

    Attributes:
        key: Hash of everything that the frames depend on.
        suffixes: Suffixes of a frame's files: ``".png"``, ``".exr"``.
        saving: Keyword arguments of ``Image.save`` by suffix.
    """

    key: str
    suffixes: tuple[str, ...]
    saving: Mapping[str, Mapping[str, Any]]


class FrameRenderer:
    """Draws the frames of a sequence.

    Attributes:
        renderer: The renderer.
    """

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self._skies: LruCache[Environment] = LruCache(_MOST_SKIES)

    def draw(self, shot: Shot, progress: Callable[[float], None] | None = None) -> Image:
        """Return the picture of a shot."""
        lights = [self._transient(light) for light in shot.lights]
        self.renderer.draw(lights, shot.view, progress=progress)
        return self.renderer.image()

    def _transient(self, light: Light) -> Light:
        """Return a light that no shot holds: the arrays of a sky, 14 MB, would stay with its shot."""
        if not isinstance(light, Environment):
            return light
        return self._skies.get_or_make(light, functools.partial(copy.copy, light))


def draw_frame(
    job: FrameJob, renderer: FrameRenderer, shot: Shot, progress: Callable[[float], None] | None = None
) -> dict[str, bytes]:
    """Return the contents of a frame's files by suffix."""
    image = renderer.draw(shot, progress)
    with tempfile.TemporaryDirectory(prefix="warpdiff-") as folder:
        return {
            suffix: image.save(Path(folder) / f"frame{suffix}", **job.saving[suffix]).read_bytes()
            for suffix in job.suffixes
        }


# The renderer and the shots of a worker by the key of its sequence: only the last ones stay.
_sequences: dict[str, tuple[FrameRenderer, Sequence[Shot]]] = {}
_making = threading.Lock()


def draw_in_worker(job: FrameJob, pickled: bytes, index: int) -> dict[str, bytes]:
    """Return the same in a worker, which makes the renderer once for all frames that it draws."""
    with _making:
        if job.key not in _sequences:
            _sequences.clear()
            renderer, shots = pickle.loads(pickled)  # noqa: S301 (the caller's own, as all that Dask carries)
            _sequences[job.key] = FrameRenderer(renderer), shots
        frame_renderer, shots = _sequences[job.key]
    return draw_frame(job, frame_renderer, shots[index])


def draw_by_workers(
    client: Any, job: FrameJob, renderer: Renderer, shots: Sequence[Shot], indices: Sequence[int]
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Frames by their index, in the order in which they are ready; the first error ends it.

    Renderer and shots go to each worker once, in one pickle, where the shots share the images of environments. A frame
    whose worker is lost goes to another one; where all that hold the pickle are lost, it is sent again.
    """
    from distributed import CancelledError, as_completed

    pickled = pickle.dumps((renderer, shots))
    remaining = dict.fromkeys(indices)
    for attempt in range(_RETRIES + 1):
        sent = client.scatter(pickled, broadcast=True, hash=False)
        waiting = iter(tuple(remaining))
        index_of: dict[str, int] = {}

        def submit(count: int, waiting: Any = waiting, sent: Any = sent, index_of: Any = index_of) -> list[Any]:
            futures = []
            for index, _ in zip(waiting, range(count), strict=False):
                future = client.submit(draw_in_worker, job, sent, index, pure=False, retries=_RETRIES)
                index_of[future.key] = index
                futures.append(future)
            return futures

        threads = sum(client.nthreads().values()) or 1
        ready = as_completed(submit(_AHEAD * threads))
        try:
            for future in ready:
                files = future.result()
                index = index_of.pop(future.key)
                yield index, files
                del remaining[index]
                future.release()
                for more in submit(1):
                    ready.add(more)
        except CancelledError:
            # Scattered data is lost with its workers, and cannot be computed again.
            if attempt == _RETRIES:
                raise
        finally:
            ready.clear()
        if not remaining:
            return
