"""Command ``python -m bench``: charts of speed against accuracy of the library and of other programs.

Run the command from a checkout of the repository.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from bench import inputs
from bench.suite import runner

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLES = """examples:
  python -m bench --quick --output charts
  python -m bench --compare before/results.json after/results.json"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the charts, or compare the numbers that two earlier calls of the benchmark saved. Return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m bench", description="Chart speed against accuracy, compared with other programs.",
        epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("-o", "--output", default="bench_results", metavar="FOLDER", help="(default: bench_results)")
    parser.add_argument("--quick", action="store_true", help="draw all charts in two minutes, with few points")
    parser.add_argument("--filter", nargs="+", metavar="PART", help=f"run only these parts: {' '.join(runner.PARTS)}")
    parser.add_argument(
        "--peer", metavar="MODULE:FUNCTION", help="add your own method, see bench.suite.runner.user_peer"
    )
    parser.add_argument("--data", type=Path, metavar="FOLDER", help=inputs.HELP)
    parser.add_argument("--device", help="device: cpu (default) or cuda")
    parser.add_argument("--threads", type=int, help="CPU threads, also of peers (default: one per core)")
    parser.add_argument(
        "--compare", type=Path, nargs=2, metavar=("OLD", "NEW"),
        help="list the figures of two results.json that differ by more than their noise",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        if options.compare:
            print("\n".join(runner.compare(*options.compare)))
            return 0
        report = runner.run(
            Path(options.output), quick=options.quick, parts=options.filter, device=options.device,
            threads=options.threads, data=options.data, peer=options.peer,
        )  # fmt: skip
    except (ValueError, OSError) as error:
        print(f"python -m bench: {error}", file=sys.stderr)
        return 2
    print(f"wrote {report.resolve()}, with results.json and results.csv in the same folder")
    return 0


if __name__ == "__main__":
    sys.exit(main())
