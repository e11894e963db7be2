"""Files of one frame, drawn in this process or by workers of a Dask cluster: the bytes are the same.

Workers (https://distributed.dask.org) may join or leave.
"""

from __future__ import annotations

import pickle
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from warpdiff.apps.sequences.shots import Shot
    from warpdiff.render.renderer import Renderer

# How often a frame may be lost with its worker, or all that was sent there.
_RETRIES = 5
# Frames that are given out for each thread of a worker: what comes back waits to be written.
_AHEAD = 2


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


def draw_frame(job: FrameJob, renderer: Renderer, shot: Shot) -> dict[str, bytes]:
    """Return the contents of a frame's files by suffix."""
    renderer.draw(shot.lights, shot.view)
    image = renderer.image()
    with tempfile.TemporaryDirectory(prefix="warpdiff-") as folder:
        return {
            suffix: image.save(Path(folder) / f"frame{suffix}", **job.saving[suffix]).read_bytes()
            for suffix in job.suffixes
        }


# The renderer of a worker by the key of its sequence: only the last one stays.
_renderers: dict[str, Renderer] = {}
_making = threading.Lock()


def draw_in_worker(job: FrameJob, pickled: bytes, shot: Shot) -> dict[str, bytes]:
    """Return the same in a worker, which makes the renderer once for all frames that it draws."""
    with _making:
        if job.key not in _renderers:
            _renderers.clear()
            _renderers[job.key] = pickle.loads(pickled)  # noqa: S301 (the caller's own, as all that Dask carries)
        renderer = _renderers[job.key]
    return draw_frame(job, renderer, shot)


def draw_by_workers(
    client: Any, job: FrameJob, pickled: bytes, shots: Mapping[int, Shot]
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Frames by their index, in the order in which they are ready; the first error ends it.

    The renderer goes to each worker once. A frame whose worker is lost goes to another one; where all that hold the
    renderer are lost, it is sent again.
    """
    from distributed import CancelledError, as_completed

    remaining = dict(shots)
    for attempt in range(_RETRIES + 1):
        sent = client.scatter(pickled, broadcast=True, hash=False)
        waiting = iter(tuple(remaining.items()))
        index_of: dict[str, int] = {}

        def submit(count: int, waiting: Any = waiting, sent: Any = sent, index_of: Any = index_of) -> list[Any]:
            futures = []
            for (index, shot), _ in zip(waiting, range(count), strict=False):
                future = client.submit(draw_in_worker, job, sent, shot, pure=False, retries=_RETRIES)
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
            # What was scattered is gone with its workers, and cannot be computed again.
            if attempt == _RETRIES:
                raise
        finally:
            ready.clear()
        if not remaining:
            return
