"""One frame as files, drawn here or by a worker elsewhere: the same bytes."""

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
    """What all frames of a sequence share.

    Attributes:
        key: A hash of all that tells.
        suffixes: Of a frame's files: ``".png"``, ``".exr"``.
        how: How they are saved, by suffix: keyword arguments of ``Image.save``.
    """

    key: str
    suffixes: tuple[str, ...]
    how: Mapping[str, Mapping[str, Any]]


def drawn(job: FrameJob, renderer: Renderer, shot: Shot) -> dict[str, bytes]:
    """A frame's files by their suffixes."""
    renderer.draw(shot.light, shot.view)
    image = renderer.image()
    with tempfile.TemporaryDirectory(prefix="warpdiff-") as folder:
        return {
            suffix: image.save(Path(folder) / f"frame{suffix}", **job.how[suffix]).read_bytes()
            for suffix in job.suffixes
        }


# The renderer of a worker, by the key of its sequence: another one takes its place.
_kept: dict[str, Renderer] = {}
_making = threading.Lock()


def drawn_by_worker(job: FrameJob, pickled: bytes, shot: Shot) -> dict[str, bytes]:
    """The same where the renderer has to be made first, once for all frames that come here."""
    with _making:
        if job.key not in _kept:
            _kept.clear()
            _kept[job.key] = pickle.loads(pickled)  # noqa: S301 (the caller's own, as all that Dask carries)
        renderer = _kept[job.key]
    return drawn(job, renderer, shot)
