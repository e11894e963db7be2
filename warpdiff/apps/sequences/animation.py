"""Animated files (WebP, APNG, GIF), written by Pillow from PNG frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from warpdiff.core import files, validation
from warpdiff.core.wording import ArgumentValueError, marked, ref

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from PIL.Image import Image

_WRITERS: dict[str, tuple[str, dict[str, Any]]] = {
    ".webp": ("WEBP", {"quality": 90, "method": 4}), ".png": ("PNG", {}), ".gif": ("GIF", {"disposal": 2}),
}  # fmt: skip


def check_target(path: Any, suffixes: Sequence[str]) -> Path:
    """Check whether an animated file can be written, and return its path.

    Args:
        path: Path that the user gave.
        suffixes: Suffixes of the frames' files. They must include ``".png"``, because the animation is made from PNG
            frames.

    Raises:
        ValueError: The suffix is unknown, or there are no PNG frames.
        OSError: The file cannot be written to this path.
    """
    target = validation.path(path, "animation")
    if target.suffix.lower() not in _WRITERS:
        raise ArgumentValueError(f"{ref('animation')} must end in {', '.join(_WRITERS)}, got {target.name!r}")
    if ".png" not in suffixes:
        raise ArgumentValueError(
            f"{ref('animation')} is made of PNG frames, but {ref('formats')} is {', '.join(suffixes)}: add '.png' to it"
        )
    files.check_folder(target.parent, "animation")
    if target.is_dir():
        raise marked(IsADirectoryError, f"{ref('animation')}: {target} is a folder; name a file")
    return target


def write(target: Path, frames: Sequence[Path], frames_per_second: float) -> None:
    """Write the pictures of several files as the frames of one animated file, which repeats endlessly.

    Frames are loaded one at a time. Whether Pillow keeps them all in memory depends on the format.
    """
    kind, options = _WRITERS[target.suffix.lower()]
    first, *rest = frames
    with files.atomic_write(target, suffix=target.suffix.lower()) as temporary:
        _opened(first).save(
            temporary, kind, save_all=True, append_images=_Opened(rest), duration=1000.0 / frames_per_second, loop=0,
            **options,
        )  # fmt: skip


def _opened(path: Path) -> Image:
    from PIL import Image

    with Image.open(path, formats=("PNG",)) as picture:
        picture.load()
        # Pillow cannot write animated files with 16 bits per channel, so that frames are converted to 8 bits.
        return picture.convert("RGBA" if "A" in picture.getbands() else "RGB")


class _Opened:
    """Sequence of frames that opens one file at a time. It can be iterated twice, as some writers of Pillow do."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths

    def __iter__(self) -> Iterator[Image]:
        return map(_opened, self._paths)
