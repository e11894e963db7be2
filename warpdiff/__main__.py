"""Entry point of the command line: ``warpdiff`` and ``python -m warpdiff``."""

import os
import signal
import sys

# Windows has no signal SIGHUP, so only the signals that exist are handled.
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def main() -> int:
    """Run the command line as a process, and return the exit code."""
    # The parent process may have set a signal to be ignored, as ``nohup`` does with SIGHUP. Such a signal stays
    # ignored.
    signals = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    for handled in signals:
        # A signal at this point ends the process at once, because no unfinished files exist yet that it would have to
        # delete.
        signal.signal(handled, lambda number, _frame: os._exit(128 + number))
    # The module ``process`` is imported only after the handlers of the signals are set, because its import takes time,
    # and a signal may arrive meanwhile.
    from warpdiff.apps.process import Interruption, prepare_streams

    prepare_streams()
    interruption = Interruption(signals)
    try:
        from warpdiff.apps import cli

        code = cli.main()
    except SystemExit as stop:
        # argparse raises SystemExit after printing the help, and after an error in the flags.
        code = int(stop.code or 0)
    except BaseException:
        # If a signal interrupts an import, the import may raise another error, such as ImportError. That error is not
        # shown.
        if not interruption.is_interrupted:
            raise
        code = 1
    return interruption.finish(code)


if __name__ == "__main__":
    sys.exit(main())
