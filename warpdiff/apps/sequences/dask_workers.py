"""Frames drawn by the workers of a Dask cluster (https://distributed.dask.org), which may join or leave."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from warpdiff.apps.sequences.frames import FrameJob, draw_in_worker

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from warpdiff.apps.sequences.shots import Shot

# How often a frame may be lost with its worker, or all that was sent there.
_RETRIES = 5
# Frames that are given out for each thread of a worker: what comes back waits to be written.
_AHEAD = 2


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
