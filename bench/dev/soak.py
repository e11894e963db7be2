"""Reliability: what is tried many times, for as long as there is time, and how often something went wrong.

It runs the permanent tests of a checkout, again and again: ``make soak MINUTES=5``, or
``python -m bench.dev.soak --minutes 5``.
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
# Beyond its time, for what is begun.
GRACE_S = 900.0


class Row(NamedTuple):
    """What is told of a row of the table."""

    tried: int
    wrong: int
    skipped: int


def rows(cases: Iterable[Xml.Element]) -> dict[str, Row]:
    """What was tried, by rows, from the test cases of a report in JUnit's format."""
    found: dict[str, Row] = defaultdict(lambda: Row(0, 0, 0))
    for case in cases:
        said = {each.get("name"): each.get("value", "") for each in case.iter("property")}
        # Files that are skipped as a whole, for want of a package, are in no row.
        if "row" not in said:
            continue
        row = found[said["row"]]
        skipped = case.find("skipped") is not None
        wrong = case.find("failure") is not None or case.find("error") is not None
        tried = 0 if skipped else int(said.get("tried", 1))
        found[said["row"]] = Row(row.tried + tried, row.wrong + wrong, row.skipped + skipped)
    return dict(found)


def table(found: dict[str, Row]) -> str:
    """As Markdown; a test that fails is one that went wrong, as it ends there."""
    lines = ["| what | tried | behaved | wrong |", "| --- | --- | --- | --- |"]
    for name, row in found.items():
        skipped = f" ({row.skipped} skipped)" if row.skipped else ""
        lines.append(f"| {name} | {row.tried:,}{skipped} | {row.tried - row.wrong:,} | {row.wrong} |")
    return "\n".join(lines)


def run(end: float, *, seed: int) -> dict[str, Row]:
    """Run all of them once, until ``end`` at most, seconds since the epoch."""
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
            sys.exit(f"it still ran {GRACE_S / 60.0:g} minutes after its time: something hangs")
        if done not in (0, 1):
            sys.exit("the tests could not be run")
        found = rows(Xml.parse(report).iter("testcase"))  # noqa: S314 (written by the tests themselves)
    if done and not any(row.wrong for row in found.values()):
        sys.exit("a test failed that is in no row")
    return found


def main() -> int:
    """Run the permanent tests and print the table; 1 if something went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="for so long (60)")
    options = parser.parse_args()
    begin = time.time()
    end = begin + 60.0 * options.minutes
    found: dict[str, Row] = {}
    # As often as there is time for, each time with other random numbers.
    for number in itertools.count():
        for name, row in run(end, seed=int(end) + number).items():
            found[name] = Row(*np.add(found.get(name, Row(0, 0, 0)), row).tolist())
        if time.time() >= end:
            break
    print(f"\n{(time.time() - begin) / 60.0:.0f} minutes on {os.cpu_count()} cores:\n\n{table(found)}")
    return int(any(row.wrong for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
