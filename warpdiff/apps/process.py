"""Signals, exit codes and standard streams of the command line's process. The library itself handles no signals.

A process that a signal ends deletes its unfinished files, and its exit code is 128 plus the signal's number. Messages
are also safe if a standard stream is closed or full, or cannot encode every character.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from warpdiff.core import files

if TYPE_CHECKING:
    from collections.abc import Sequence

# Number of attempts to delete the temporary folders, and pause between two attempts. All attempts together take 0.1 s.
# Several attempts are necessary, because other threads may still write into the folders. If one of the values is
# doubled, an interrupted process ends up to 0.1 s later.
_SWEEPS, _BETWEEN_SWEEPS_S = 20, 0.005


class Interruption:
    """Signal handler that is active from its construction to the end of the process.

    The first signal raises ``KeyboardInterrupt`` in the main thread, so that context managers clean up. A second signal
    ends the process at once. Python calls the handler only between two instructions of the main thread: a long native
    call, such as a compilation, returns first. Exit codes are 128 plus the signal's number: 129, 130 or 143.
    """

    def __init__(self, signals: Sequence[signal.Signals]) -> None:
        self._signals = signals
        self._code: int | None = None
        self._returned = False
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._swallowed
        # Functions registered with atexit run in reverse order. ``_ignore``, which disables the signals, is registered
        # first and therefore runs last.
        atexit.register(self._ignore)
        # Compilers and other programs that this process starts put their temporary files into the folder of ``TMPDIR``.
        # This process sets ``TMPDIR`` to a folder of its own, which it deletes at its end.
        with contextlib.suppress(OSError):
            self._temporary = tempfile.TemporaryDirectory(prefix="warpdiff-", ignore_cleanup_errors=True)
            os.environ["TMPDIR"] = tempfile.tempdir = self._temporary.name
        for number in signals:
            signal.signal(number, self._handle)

    @property
    def is_interrupted(self) -> bool:
        """Whether the process has received a signal."""
        return self._code is not None

    def finish(self, code: int) -> int:
        """Flush the standard streams and return the exit code; end the process if a signal interrupted the command.

        Args:
            code: Exit code of the command. It becomes 1 if standard output cannot be written.
        """
        # From now on, a signal ends the process at once instead of raising an exception.
        self._returned = True
        is_complete = flush_streams()
        if self._code is not None:
            self._leave(self._code)
        return code if is_complete else code or 1

    def _ignore(self) -> None:
        """Ignore signals while Python shuts down, so that they do not replace the command's exit code."""
        for number in self._signals:
            signal.signal(number, signal.SIG_IGN)

    def _handle(self, number: int, _frame: Any) -> None:
        if self._returned or self._code is not None:
            self._leave(128 + number)
        self._code = 128 + number
        raise KeyboardInterrupt

    def _swallowed(self, unraisable: Any) -> None:
        """End the process if a signal raised ``KeyboardInterrupt`` in a finalizer, where Python would ignore it."""
        if self._code is not None and issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._leave(self._code)
        self._unraisable(unraisable)

    def _leave(self, code: int) -> NoReturn:
        """Delete unfinished files and temporary folders, and end the process without waiting for its other threads."""
        try:
            files.discard_unfinished()
            # Another thread, such as a compilation, may write into a folder while the folder is deleted. The deletion
            # is then repeated.
            for _ in range(_SWEEPS):
                folders = self._folders()
                for folder in folders:
                    shutil.rmtree(folder, ignore_errors=True)
                if not folders:
                    break
                time.sleep(_BETWEEN_SWEEPS_S)
        finally:
            os._exit(code)

    def _folders(self) -> list[Path]:
        """Return the temporary folders of this process that still exist."""
        folders = [Path(self._temporary.name)] if self._temporary is not None else []
        # Warp compiles kernels in temporary folders. The names of the folders contain the process id, by which this
        # process finds its own folders.
        kernels = getattr(getattr(sys.modules.get("warp"), "config", None), "kernel_cache_dir", None)
        if kernels:
            folders += Path(kernels).glob(f"*_p{os.getpid()}_t*")
        return [folder for folder in folders if folder.exists()]


def prepare_streams() -> None:
    """Replace closed standard streams by the null device, and characters that the encoding lacks by "?"."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # The null device occupies the file descriptor of the closed stream. Otherwise the next opened file, such as
            # a picture, would get this descriptor, and messages would be written into that file.
            os.open(os.devnull, os.O_RDWR)
        if number and getattr(sys, name) is None:
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115 (the stream is never closed)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def flush_streams() -> bool:
    """Flush standard error and standard output, and return whether standard output was written completely."""
    is_complete = True
    for stream in (sys.stderr, sys.stdout):
        try:
            stream.flush()
        except OSError as error:
            is_complete = stream is not sys.stdout
            if not is_complete and not isinstance(error, BrokenPipeError):
                os.write(2, f"warpdiff: standard output: {error.strerror}\n".encode())
            # Python flushes both streams again at the end of the process, and would print an error message of its own
            # for the stream that could not be flushed here. This stream is connected to the null device, so that it can
            # be flushed without an error.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return is_complete
