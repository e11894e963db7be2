"""Entry point of the command line: ``warpdiff`` and ``python -m warpdiff``."""

import os
import signal
import sys

# Windows has no SIGHUP.
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def main() -> int:
    """Run the command line as a process; returns the exit code."""
    # A signal that the process was started to ignore, as by nohup, stays ignored.
    signals = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    for handled in signals:
        # No files exist yet that would have to be deleted.
        signal.signal(handled, lambda number, _frame: os._exit(128 + number))
    # Few modules are imported before signals are handled, because imports take time.
    from warpdiff.apps.process import Interruption, prepare_streams

    prepare_streams()
    interruption = Interruption(signals)
    try:
        from warpdiff.apps import cli

        code = cli.main()
    except SystemExit as stop:
        # argparse ends so after help and after wrong options.
        code = int(stop.code or 0)
    except BaseException:
        # Imports may turn an interruption into an error of their own.
        if not interruption.is_interrupted:
            raise
        code = 1
    return interruption.finish(code)


if __name__ == "__main__":
    sys.exit(main())
