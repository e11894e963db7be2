"""Rendering of a frame's files, in this process or by workers of a Dask cluster; both give identical files.

Workers (https://distributed.dask.org) may join or leave the cluster during a sequence.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import pickle
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpdiff.core.caching import LruCache
from warpdiff.image.display_transform import exposure_factor
from warpdiff.image.image import write_exr
from warpdiff.lights.environment import Environment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from warpdiff.apps.sequences.shots import Shot
    from warpdiff.image.image import Image
    from warpdiff.lights.base import Light
    from warpdiff.render.renderer import Renderer
    from warpdiff.request.settings import DisplaySettings

# Number of times that a frame, or the pickled renderer, is sent to workers again after a worker was lost. The number is
# limited so that a worker that always crashes ends the sequence. If doubled, the error of such a sequence appears
# later.
_RETRIES = 5
# Number of frames that are sent to the workers in advance, per thread of a worker. The number is limited because
# finished frames wait in memory until they are written. If doubled, they require twice the memory.
_AHEAD = 2
# Number of environment lights whose device arrays of 7 MB each are kept. With 2, an environment that is the same in
# all frames is uploaded only once. If doubled, the arrays require twice the memory.
_MOST_SKIES = 2


@dataclass(frozen=True)
class FrameJob:
    """Description of the work that all frames of a sequence share.

    Attributes:
        key: Hash of all inputs of the frames: renderer, shots (lights and camera of each frame) and options.
        suffixes: Suffixes of each frame's files: ``".png"``, ``".exr"``.
        shown: Options of the display, with the exposure of all PNG files.
        background: Background of PNG files; None is transparent.
        exr_scale: Linear factor of the colours of EXR files.
    """

    key: str
    suffixes: tuple[str, ...]
    shown: DisplaySettings
    background: tuple[float, float, float] | None
    exr_scale: float

    def save(self, image: Image, path: Path) -> None:
        """Write a frame to a file with one of the suffixes."""
        if path.suffix == ".png":
            image.save(path, background=self.background, **dataclasses.asdict(self.shown))
        else:
            write_exr(image, path, self.shown, factor=self.exr_scale, preview=exposure_factor(self.shown, ()))


class FrameRenderer:
    """Renderer of the frames of a sequence, which limits the memory of environment lights.

    Attributes:
        renderer: Renderer that draws each frame.
    """

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self._skies: LruCache[Environment] = LruCache(_MOST_SKIES)

    def draw(self, shot: Shot, progress: Callable[[float], None] | None = None) -> Image:
        """Return the picture of a shot, which has the lights and the camera of one frame."""
        lights = [self._transient(light) for light in shot.lights]
        self.renderer.draw(lights, shot.view, progress=progress)
        return self.renderer.image()

    def _transient(self, light: Light) -> Light:
        """Return a copy of an environment light; return other lights unchanged.

        An environment keeps device arrays of 7 MB as long as it exists. The environments of the shots (lights of the
        frames) exist during the whole sequence, so their copies are rendered instead. Only the last few copies are
        kept, and the arrays of older copies are freed.
        """
        if not isinstance(light, Environment):
            return light
        return self._skies.get_or_make(light, functools.partial(copy.copy, light))


def draw_frame(
    job: FrameJob, renderer: FrameRenderer, shot: Shot, progress: Callable[[float], None] | None = None
) -> dict[str, bytes]:
    """Draw one frame, and return the contents of its files by suffix."""
    image = renderer.draw(shot, progress)
    contents = {}
    with tempfile.TemporaryDirectory(prefix="warpdiff-") as folder:
        for suffix in job.suffixes:
            path = Path(folder) / f"frame{suffix}"
            job.save(image, path)
            contents[suffix] = path.read_bytes()
    return contents


# Renderer and shots (lights and camera of each frame) of the sequence that this worker process drew last, by the key of
# the sequence, a hash of all inputs.
_sequences: dict[str, tuple[FrameRenderer, Sequence[Shot]]] = {}
_making = threading.Lock()


def draw_in_worker(job: FrameJob, pickled: bytes, index: int) -> dict[str, bytes]:
    """Draw one frame in a worker process, and return the contents of its files by suffix.

    Args:
        job: Work that all frames share.
        pickled: Pickle of the renderer and the shots (lights and camera of each frame). A worker unpickles it once per
            sequence.
        index: Index of the frame.
    """
    with _making:
        if job.key not in _sequences:
            _sequences.clear()
            renderer, shots = pickle.loads(pickled)  # noqa: S301 (Dask itself unpickles data of the same caller)
            _sequences[job.key] = FrameRenderer(renderer), shots
        frame_renderer, shots = _sequences[job.key]
    return draw_frame(job, frame_renderer, shots[index])


def draw_by_workers(
    client: Any, job: FrameJob, renderer: Renderer, shots: Sequence[Shot], indices: Sequence[int]
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Yield the index and the files of each frame, in the order in which workers finish them.

    Each worker receives the renderer and the shots (lights and camera of each frame) once, in one pickle, in which the
    shots share the images of environments. If a worker is lost, another worker draws its frame. If all workers with the
    pickle are lost, the pickle is sent again. The first error of a frame ends the iteration.
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
            # At this point, no worker has the pickle of renderer and shots (lights and cameras of the frames) any more.
            # Dask cannot recompute data that was sent from here, so that the next attempt sends the pickle again.
            if attempt == _RETRIES:
                raise
        finally:
            ready.clear()
        if not remaining:
            return
