"""Process of the command line: signals, exit codes and standard streams. The library itself handles no signals.

A signal leaves no files behind, and the exit code names it. Standard streams may be closed, full, or unable to encode
every character.
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

# Attempts to delete folders that other threads still write into; 0.1 s in total.
_SWEEPS, _BETWEEN_SWEEPS_S = 20, 0.005


class Interruption:
    """Handles signals from its construction to the end of the process.

    The first signal raises ``KeyboardInterrupt`` in the main thread, which lets contexts end; a second one ends the
    process at once. Python runs both between two instructions of the main thread, so that a long native call, such as
    a compilation, returns first. Exit codes are 128 plus the signal's number: 130, 143 or 129.
    """

    def __init__(self, signals: Sequence[signal.Signals]) -> None:
        self._signals = signals
        self._code: int | None = None
        self._returned = False
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._swallowed
        # The function that is registered first runs last.
        atexit.register(self._ignore)
        # Temporary files of other packages, such as compilers, go with the process; child processes inherit the folder.
        with contextlib.suppress(OSError):
            self._temporary = tempfile.TemporaryDirectory(prefix="warpdiff-", ignore_cleanup_errors=True)
            os.environ["TMPDIR"] = tempfile.tempdir = self._temporary.name
        for number in signals:
            signal.signal(number, self._handle)

    @property
    def is_interrupted(self) -> bool:
        """Whether there was a signal."""
        return self._code is not None

    def finish(self, code: int) -> int:
        """Flush the standard streams and return the command's code, or end the process if it was interrupted."""
        # From now on a signal ends the process at once.
        self._returned = True
        is_complete = flush_streams()
        if self._code is not None:
            self._leave(self._code)
        return code if is_complete else code or 1

    def _ignore(self) -> None:
        """All is written and tidied up: the command's own code stands while Python shuts down."""
        for number in self._signals:
            signal.signal(number, signal.SIG_IGN)

    def _handle(self, number: int, _frame: Any) -> None:
        if self._returned or self._code is not None:
            self._leave(128 + number)
        self._code = 128 + number
        raise KeyboardInterrupt

    def _swallowed(self, unraisable: Any) -> None:
        """Python discards what is raised in a finalizer; there an interruption ends the process at once."""
        if self._code is not None and issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._leave(self._code)
        self._unraisable(unraisable)

    def _leave(self, code: int) -> NoReturn:
        """End the process, whatever other threads are doing, after its unfinished files are deleted."""
        try:
            files.discard_unfinished()
            # A thread that compiles may write into a folder while it is deleted.
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
        """Temporary folders of this process that still exist."""
        folders = [Path(self._temporary.name)] if self._temporary is not None else []
        # Warp builds in folders that it names after the process.
        kernels = getattr(getattr(sys.modules.get("warp"), "config", None), "kernel_cache_dir", None)
        if kernels:
            folders += Path(kernels).glob(f"*_p{os.getpid()}_t*")
        return [folder for folder in folders if folder.exists()]


def prepare_streams() -> None:
    """Open standard streams that are closed; characters that an encoding lacks become question marks."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # Otherwise a picture would be opened under this number, and messages would be written into it.
            os.open(os.devnull, os.O_RDWR)
        if number and getattr(sys, name) is None:
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115 (of a number, for good)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def flush_streams() -> bool:
    """Flush both output streams; returns whether standard output has accepted everything."""
    is_complete = True
    for stream in (sys.stderr, sys.stdout):
        try:
            stream.flush()
        except OSError as error:
            is_complete = stream is not sys.stdout
            if not is_complete and not isinstance(error, BrokenPipeError):
                os.write(2, f"warpdiff: standard output: {error.strerror}\n".encode())
            # Python flushes again when it ends, and would report the failure.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return is_complete
