"""Files of one frame, drawn in this process or by a worker: the bytes are the same."""

from __future__ import annotations

import pickle
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from warpdiff.apps.sequences.shots import Shot
    from warpdiff.render.renderer import Renderer


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
