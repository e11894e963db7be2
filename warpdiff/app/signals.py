"""Signals that end the command line: soon, with nothing left behind, and with an exit code that says which.

The library itself handles no signals.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from warpdiff.app import standard_streams
from warpdiff.core import file_writing

if TYPE_CHECKING:
    from collections.abc import Sequence

# What unwinding may take.
_GRACE_S = 0.4
_SWEEPS, _BETWEEN_SWEEPS_S = 20, 0.005


class Interruption:
    """Meets signals from when it is made, for as long as the process lives.

    The first one raises ``KeyboardInterrupt`` in the main thread, which lets contexts end. Compilers do not return for
    seconds and imports may swallow what is raised, so that another thread, which the system itself tells, ends the
    process where that takes longer. Exit codes are 128 and the signal's number: 130, 143 or 129.
    """

    def __init__(self, signals: Sequence[signal.Signals]) -> None:
        self._signals = signals
        self._code: int | None = None
        self._returned = False
        self._leaving = threading.RLock()
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._swallowed
        # What is registered first runs last.
        atexit.register(self._ignore)
        # What others write for a while, as compilers do, goes with the process; those that it starts inherit this.
        with contextlib.suppress(OSError):
            self._temporary = tempfile.TemporaryDirectory(prefix="warpdiff-", ignore_cleanup_errors=True)
            os.environ["TMPDIR"] = tempfile.tempdir = self._temporary.name
        self._told, self._bell = socket.socketpair()
        self._bell.setblocking(False)
        signal.set_wakeup_fd(self._bell.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._watch, name="warpdiff-signals", daemon=True).start()
        for each in signals:
            signal.signal(each, self._meet)

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
        """All is written and tidied up: the command's own code stands while Python takes itself down."""
        for each in self._signals:
            signal.signal(each, signal.SIG_IGN)

    def _meet(self, number: int, _frame: Any) -> None:
        """Run by the main thread, between two of its instructions."""
        if self._returned:
            self._leave(128 + number)
        if self._code is None:
            self._code = 128 + number
            raise KeyboardInterrupt

    def _swallowed(self, told: Any) -> None:
        """Python swallows what is raised in a finalizer, and says so at length; the watching thread does without."""
        if not issubclass(told.exc_type, KeyboardInterrupt):
            self._unraisable(told)

    def _watch(self) -> None:
        """Run by a thread of its own, which must import nothing: the main thread may hold the lock for that."""
        number = 0
        while number not in self._signals:
            number = self._told.recv(1)[0]
        time.sleep(_GRACE_S)
        self._leave(128 + number)

    def _leave(self, code: int) -> NoReturn:
        """End the process, whatever other threads are doing, after its unfinished files are gone."""
        # Whoever comes second waits for the first to end all.
        with self._leaving:
            try:
                _hold_other_threads()
                # One of them may be about to write still.
                for _ in range(_SWEEPS):
                    file_writing.discard_unfinished()
                    left = self._folders()
                    for folder in left:
                        shutil.rmtree(folder, ignore_errors=True)
                    if not left:
                        break
                    time.sleep(_BETWEEN_SWEEPS_S)
            finally:
                os._exit(code)

    def _folders(self) -> list[Path]:
        """Folders of this process that are still there."""
        found = [Path(self._temporary.name)] if self._temporary is not None else []
        # Warp builds in folders that it names after the process.
        kernels = getattr(getattr(sys.modules.get("warp"), "config", None), "kernel_cache_dir", None)
        if kernels:
            found += Path(kernels).glob(f"*_p{os.getpid()}_t*")
        return [folder for folder in found if folder.exists()]


def _hold_other_threads() -> None:
    """From now on other threads wait for ever where they would make a file or a folder."""
    this, never = threading.get_ident(), threading.Lock()
    never.acquire()

    def hook(event: str, _: Any) -> None:
        if event in ("open", "os.mkdir", "os.rename") and threading.get_ident() != this:
            never.acquire()

    sys.addaudithook(hook)
