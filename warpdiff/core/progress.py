"""Progress of long computations, which is reported to a callable of the caller or shown as a progress bar."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from warpdiff.core.wording import ArgumentTypeError, ref

Progress = Callable[[float], None] | bool | None
# Time after which a progress bar appears [s]. If doubled, a user waits 2 s without a sign of progress.
_DELAY_S = 1.0


class _Bar:
    """Progress bar of the package tqdm. A call with the finished fraction of the work updates the bar."""

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
    """Return a callable that reports progress, or None.

    Args:
        progress: Callable, which is returned unchanged; True makes a progress bar; None and False report nothing.
        name: Label of the progress bar.
    """
    if isinstance(progress, bool):
        return _Bar(name) if progress else None
    if progress is not None and not callable(progress):
        raise ArgumentTypeError(f"{ref('progress')} must be True, a callable or None, got {type(progress).__name__}")
    return progress
