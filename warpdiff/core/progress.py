"""Progress of long work: a callable of the caller, or a progress bar."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from warpdiff.core.wording import ArgumentTypeError, ref

Progress = Callable[[float], None] | bool | None
# Shortest work that shows a bar [s]. If doubled, a user waits two seconds without a sign of progress.
_DELAY_S = 1.0


class _Bar:
    """Progress bar by tqdm, over the finished share of the work."""

    def __init__(self, name: str) -> None:
        if "ipykernel" in sys.modules:
            from tqdm.auto import tqdm
        else:
            from tqdm import tqdm

        self._bar: Any = tqdm(
            total=1.0, desc=name, delay=_DELAY_S, leave=False,
            bar_format="{desc}  {bar}  {percentage:3.0f} %  {remaining}",
        )  # fmt: skip

    def __call__(self, share: float) -> None:
        self._bar.update(share - self._bar.n)
        if share >= 1.0:
            self._bar.close()


def reporter(progress: Progress, name: str) -> Callable[[float], None] | None:
    """Return a callable that reports progress: ``progress`` itself, a bar for True, or None for None and False."""
    if isinstance(progress, bool):
        return _Bar(name) if progress else None
    if progress is not None and not callable(progress):
        raise ArgumentTypeError(f"{ref('progress')} must be True, a callable or None, got {type(progress).__name__}")
    return progress
