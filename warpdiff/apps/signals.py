"""Signals that end the command line, with nothing left behind and an exit code that names the signal.

The library itself handles no signals.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from warpdiff.apps import standard_streams
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
        # What is registered first runs last.
        atexit.register(self._ignore)
        # Temporary files of other packages, such as compilers, go with the process; child processes inherit the folder.
        with contextlib.suppress(OSError):
            self._temporary = tempfile.TemporaryDirectory(prefix="warpdiff-", ignore_cleanup_errors=True)
            os.environ["TMPDIR"] = tempfile.tempdir = self._temporary.name
        for each in signals:
            signal.signal(each, self._handle)

    @property
    def is_met(self) -> bool:
        """Whether there was a signal."""
        return self._code is not None

    def finish(self, code: int) -> int:
        """Flush what the command has written and return its code, or end as interrupted if it was."""
        # From now on a signal ends the process at once.
        self._returned = True
        whole = standard_streams.flush()
        if self._code is not None:
            self._leave(self._code)
        return code if whole else code or 1

    def _ignore(self) -> None:
        """All is written and tidied up: the command's own code stands while Python shuts down."""
        for each in self._signals:
            signal.signal(each, signal.SIG_IGN)

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
        found = [Path(self._temporary.name)] if self._temporary is not None else []
        # Warp builds in folders that it names after the process.
        kernels = getattr(getattr(sys.modules.get("warp"), "config", None), "kernel_cache_dir", None)
        if kernels:
            found += Path(kernels).glob(f"*_p{os.getpid()}_t*")
        return [folder for folder in found if folder.exists()]
