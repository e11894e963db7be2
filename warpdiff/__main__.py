"""``warpdiff`` and ``python -m warpdiff``."""

import os
import signal
import sys

# Windows has no SIGHUP.
_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def main() -> int:
    """Run the command line as a process of its own; returns the exit code."""
    # What was started to ignore one, as nohup does, goes on.
    signals = [each for each in _SIGNALS if signal.getsignal(each) is not signal.SIG_IGN]
    for each in signals:
        # There is nothing to tidy up yet.
        signal.signal(each, lambda number, _frame: os._exit(128 + number))
    # Few modules are imported before signals are handled, because imports take time.
    from warpdiff.apps import standard_streams
    from warpdiff.apps.signals import Interruption

    standard_streams.prepare()
    interruption = Interruption(signals)
    try:
        from warpdiff.apps import cli

        code = cli.main()
    except SystemExit as stop:
        # Of help, or of options that are wrong.
        code = int(stop.code or 0)
    except BaseException:
        # Imports may turn an interruption into an error of their own.
        if not interruption.is_met:
            raise
        code = 1
    return interruption.finish(code)


if __name__ == "__main__":
    sys.exit(main())
