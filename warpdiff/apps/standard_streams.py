"""The standard streams of the command line, which may be closed, full, or unable to hold every character."""

from __future__ import annotations

import io
import os
import sys


def prepare() -> None:
    """Open what is closed, and let characters that a stream's encoding lacks be question marks."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # Or a picture would be opened under this number, and messages be written into it.
            os.open(os.devnull, os.O_RDWR)
        if number and getattr(sys, name) is None:
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115 (of a number, for good)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def flush() -> bool:
    """Write what is left to be written; returns whether standard output got it all."""
    whole = True
    for stream in (sys.stderr, sys.stdout):
        try:
            stream.flush()
        except OSError as error:
            whole = stream is not sys.stdout
            if not whole and not isinstance(error, BrokenPipeError):
                os.write(2, f"warpdiff: standard output: {error.strerror}\n".encode())
            # Python flushes again when it ends, and would say that it failed.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return whole
