"""Plugin of pytest that records which lines of mutated packages, and which kernels, each test function executes.

``python -m pytest -p bench.dev.tests_by_line`` writes a JSON file per process into the folder that the environment
variable ``WARPDIFF_TESTS_BY_LINE`` names: test functions that passed, with their time, lines by file, and kernels.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import warp as wp

from bench.dev.mutant_sites import PACKAGES

if TYPE_CHECKING:
    from collections.abc import Generator
    from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
# A copy of the checkout has its kernels at two places.
_files = {
    str(ROOT / place / path.name): path.relative_to(ROOT).as_posix()
    for folder in PACKAGES.values()
    for place in (folder, f"warpdiff/{folder}")
    for path in (ROOT / folder).glob("*.py")
}
_executed: set[tuple[str, int | str]] = set()
_by_test: dict[str, set[tuple[str, int | str]]] = defaultdict(set)
_seconds: dict[str, float] = defaultdict(float)
_failed: set[str] = set()


def function_of(test: str) -> str:
    """Return the name of a test's function, without its parameters."""
    return test.partition("[")[0]


def _trace(frame: FrameType, _event: str, _argument: object) -> Any:
    path = _files.get(frame.f_code.co_filename)
    if path is None:
        return None

    def line(frame: FrameType, event: str, _argument: object) -> Any:
        if event == "line":
            _executed.add((path, frame.f_lineno))
        return line

    return line


def pytest_configure() -> None:
    """Record lines of all threads, and launches."""
    launch = wp.launch

    def recorded(kernel: Any, *arguments: Any, **options: Any) -> Any:
        _executed.add(("kernels", kernel.func.__name__))
        return launch(kernel, *arguments, **options)

    wp.launch = recorded
    threading.settrace(_trace)
    sys.settrace(_trace)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Record one test, with the fixtures that are made for it."""
    sys.settrace(_trace)
    _executed.clear()
    begin = time.process_time()
    result = yield
    name = function_of(item.nodeid)
    _by_test[name] |= _executed
    _seconds[name] += time.process_time() - begin
    return result


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Record failures, and tests that are skipped."""
    if report.failed:
        _failed.add(function_of(report.nodeid))


def pytest_sessionfinish() -> None:
    """Write what was recorded."""
    sys.settrace(None)
    result = {}
    for name, executed in _by_test.items():
        if name in _failed or not executed:
            continue
        lines = defaultdict(list)
        for path, line in sorted(executed, key=str):
            lines[path].append(line)
        result[name] = {"seconds": _seconds[name], "lines": lines}
    path = Path(os.environ["WARPDIFF_TESTS_BY_LINE"], f"{os.getpid()}.json")
    path.write_text(json.dumps(result), encoding="utf-8")
