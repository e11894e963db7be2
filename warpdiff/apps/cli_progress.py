"""Progress of a command: a bar if standard error is a terminal, otherwise lines of text at growing intervals."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import TracebackType
    from typing import Self, TextIO

# Time from the start of a command to the first display of its progress, and between two updates of a progress bar [s].
# Before a command starts, Python imports modules for up to 1 s, so a user waits for at most 2 s until the first
# display. If doubled, the user waits for up to 3 s.
_FIRST_S = 1.0
# Longest interval between two lines of text [s]. It was chosen so that the progress of a command that runs for a day
# has 150 lines. If doubled, it has half as many lines.
_MOST_BETWEEN_LINES_S = 600.0


class CommandProgress:
    """Display of a running command's progress on standard error. A call of the object sets the finished fraction.

    A thread draws the display, because planning and compilation report no progress for many seconds. Commands that
    take less than a second display nothing.
    """

    def __init__(self, command: str) -> None:
        self._command, self._share = command, 0.0
        self._stream: TextIO = sys.stderr
        self._begin = time.monotonic()
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._bar: Any = None
        self._thread = threading.Thread(target=self._run, name="warpdiff-progress", daemon=True)

    def __call__(self, share: float) -> None:
        """Set the finished fraction of the command's work, 0 to 1."""
        self._share = share

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _traceback: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def print(self, text: str, stream: TextIO) -> None:
        """Print a line to a stream immediately. A progress bar is erased first, so that the texts do not mix."""
        with self._lock:
            if self._bar is not None:
                self._bar.clear()
            print(text, file=stream, flush=True)

    def _run(self) -> None:
        """Draw the display until the command ends. A closed standard error ends the display, not the command."""
        with contextlib.suppress(OSError, ValueError):
            if self._stream.isatty():
                self._draw_bar()
            else:
                self._write_lines()

    def _draw_bar(self) -> None:
        if self._ended.wait(_FIRST_S):
            return
        from tqdm import tqdm

        with self._lock:
            # The elapsed time that the bar shows counts from the start of the command, not from the first display of
            # the bar.
            self._bar = tqdm(
                total=1.0, desc=self._command, file=self._stream, leave=False, delay=_FIRST_S,
                bar_format="{desc}  {bar}  {percentage:3.0f} %  {elapsed}",
            )  # fmt: skip
            self._bar.start_t -= time.monotonic() - self._begin
        try:
            while True:
                with self._lock:
                    self._bar.n = self._share
                    self._bar.refresh()
                if self._ended.wait(_FIRST_S):
                    return
        finally:
            with self._lock:
                self._bar.close()
                self._bar = None

    def _write_lines(self) -> None:
        interval = _FIRST_S
        while not self._ended.wait(interval):
            elapsed = time.monotonic() - self._begin
            with self._lock:
                print(
                    f"warpdiff {self._command}: {100.0 * self._share:.0f} % after {elapsed:.0f} s",
                    file=self._stream,
                    flush=True,
                )
            # The interval until the next line equals the time elapsed so far, so that lines appear after 1, 2, 4, 8 s
            # and so on.
            interval = min(elapsed, _MOST_BETWEEN_LINES_S)
