"""Endurance test: repeat the tests with the marker ``permanent`` for a number of minutes, and count failures.

Run ``make soak MINUTES=5``, or ``python -m bench.dev.soak --minutes 5``.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree as Xml

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

ROOT = Path(__file__).resolve().parents[2]
# Time after the planned end for which tests may still be running [s]. A test that is still running after this time
# counts as hanging. The value was chosen by hand; if it is doubled, a hanging test is reported later.
GRACE_S = 900.0


class Row(NamedTuple):
    """Numbers of test cases, failures and skipped tests in one row of the report's table."""

    cases: int
    failed: int
    skipped: int


def rows(cases: Iterable[Xml.Element]) -> dict[str, Row]:
    """Return the counts of a JUnit file's test cases, by row of the report's table.

    The property "row" of a test case contains the name of its row.
    """
    result: dict[str, Row] = defaultdict(lambda: Row(0, 0, 0))
    for case in cases:
        properties = {entry.get("name"): entry.get("value", "") for entry in case.iter("property")}
        # A test file that is skipped because a package is missing has no property "row", and is not counted.
        if "row" not in properties:
            continue
        row = result[properties["row"]]
        skipped = case.find("skipped") is not None
        failed = case.find("failure") is not None or case.find("error") is not None
        count = 0 if skipped else int(properties.get("tried", 1))
        result[properties["row"]] = Row(row.cases + count, row.failed + failed, row.skipped + skipped)
    return dict(result)


def table(results: dict[str, Row]) -> str:
    """Return the numbers of test cases and failures as a Markdown table; a failing test counts as one failed case."""
    lines = ["| test | cases | passed | failed |", "| --- | --- | --- | --- |"]
    for name, row in results.items():
        skipped = f" ({row.skipped} skipped)" if row.skipped else ""
        lines.append(f"| {name} | {row.cases:,}{skipped} | {row.cases - row.failed:,} | {row.failed} |")
    return "\n".join(lines)


def run(end: float, *, seed: int) -> dict[str, Row]:
    """Run all tests marked ``permanent`` once, but not longer than until ``end`` [seconds since the epoch].

    Return the numbers of test cases, failures and skipped tests by row of the report's table.
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [
            sys.executable, "-m", "pytest", "-m", "permanent", f"--junitxml={report}", "-o", "junit_family=xunit1",
        ]  # fmt: skip
        environment = os.environ | {"WARPDIFF_SOAK": str(end), "WARPDIFF_SOAK_SEED": str(seed)}
        try:
            done = subprocess.run(
                command, cwd=ROOT, env=environment, check=False, timeout=end - time.time() + GRACE_S
            ).returncode
        except subprocess.TimeoutExpired:
            sys.exit(f"the tests were still running {GRACE_S / 60.0:g} minutes after the end: a test hangs")
        if done not in (0, 1):
            sys.exit("the tests could not be run")
        result = rows(Xml.parse(report).iter("testcase"))  # noqa: S314 (written by the tests themselves)
    if done and not any(row.failed for row in result.values()):
        sys.exit("a test failed that belongs to no row of the table")
    return result


def main() -> int:
    """Run the tests marked ``permanent`` and print the table. Return 1 if a test failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="duration in minutes (default: 60)")
    options = parser.parse_args()
    begin = time.time()
    end = begin + 60.0 * options.minutes
    results: dict[str, Row] = {}
    # All tests are repeated until the requested time is over. Each repetition has another random seed.
    for number in itertools.count():
        for name, row in run(end, seed=int(end) + number).items():
            results[name] = Row(*np.add(results.get(name, Row(0, 0, 0)), row).tolist())
        if time.time() >= end:
            break
    print(f"\n{(time.time() - begin) / 60.0:.0f} minutes on {os.cpu_count()} cores:\n\n{table(results)}")
    return int(any(row.failed for row in results.values()))


if __name__ == "__main__":
    sys.exit(main())
