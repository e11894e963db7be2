"""Mutation score: share of one-token faults in the sources that the tests detect, for one commit or several.

``python -m bench.dev.mutants COMMIT ... --seed COMMIT --minutes 60`` exports each commit into a folder. The command
records once which functions and kernels each test executes. After that, the command makes one change (fault) at a time
and runs the tests that execute the changed code; tests of the changed module come first. If no test fails, the change
is not detected. The seed determines the changes. With ``--headers``, the changes are two faults per C++ header instead.
Changes of the commits alternate, so that the scores are comparable even if the run is interrupted. The same command
continues an interrupted run.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import inspect
import json
import multiprocessing
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from itertools import accumulate, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import warp as wp
from scipy.stats import binomtest

from bench.dev.baseline import export
from bench.dev.mutant_sites import NATIVE, PACKAGES, Mutant, definitions, draw, header_mutants

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
# Test folders and files that mutation testing uses. Tests of interfaces, files and signals are excluded.
TESTS = [*PACKAGES, "adjoint", "properties", "tables", "lights", "render", "baked", "device", "request", "scene"]
TESTS += ["robustness/test_bad_input.py", "robustness/test_refusals.py", "robustness/test_memory.py"]
# Time after which the tests of a changed program count as timed out: `PATIENCE` times the largest total time of these
# tests without a change, plus `COMPILE_S` seconds for the compilation of kernels.
PATIENCE, COMPILE_S = 4.0, 60.0
# Largest address space of a test process [bytes]. The value is limited by the memory, which a changed array size could
# otherwise exhaust.
MEMORY = 12 << 30
# Test processes are forks of a server process, which has already imported the slow packages. The server does not import
# warpdiff, because each fork imports it from changed sources.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["pytest", "hypothesis", "numpy.testing", "scipy.special", "trimesh", "warp"])


class Recorder:
    """Plugin of pytest that records the time and failure of each test, and the functions and kernels it executes."""

    def __init__(self, tree: Path, output: Path) -> None:
        self._folders, self._output = (f"{tree}/warpdiff/", f"{tree}/kernels/"), output
        self._tests: dict[str, dict[str, Any]] = defaultdict(lambda: {"seconds": 0.0, "names": [], "failed": False})
        self._names: set[str] = set()
        threading.settrace(self._trace)

    def _trace(self, frame: FrameType, _event: str, _argument: object) -> None:
        code = frame.f_code
        if code is wp.launch.__code__:
            self._names.add(frame.f_locals["kernel"].func.__qualname__.partition(".<locals>")[0])
        elif code.co_flags & inspect.CO_OPTIMIZED and code.co_filename.startswith(self._folders):
            self._names.add(code.co_qualname.partition(".<locals>")[0])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Record the execution of one test, including its fixtures."""
        self._names.clear()
        sys.settrace(self._trace)
        begin = time.process_time()
        result = yield
        test = self._tests[item.nodeid.partition("[")[0]]
        test["seconds"] += time.process_time() - begin
        test["names"] = sorted(self._names.union(test["names"]))
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record whether a test failed."""
        self._tests[report.nodeid.partition("[")[0]]["failed"] |= report.failed

    def pytest_sessionfinish(self) -> None:
        """Write the record of all tests to a file."""
        sys.settrace(None)
        self._output.write_text(json.dumps(self._tests), encoding="utf-8")


def pytest_of_copy(tree: Path, tests: list[str], record: Path | None) -> None:
    """Run tests in the exported copy of a commit until a test fails. With ``record``, run all tests and record them.

    This function runs in a forked process, and ends this process when the tests end.
    """
    os.setsid()
    os.chdir(tree)
    data = os.environ.get("WARPDIFF_DATA") or str(ROOT.parent / "shared" / "data")
    os.environ.update(WARP_CACHE_PATH=f"{tree}-kernels", WARPDIFF_DATA=data)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    log = os.open(f"{tree}.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    # Modules of ``bench`` are removed from memory, because the exported copy of the commit has its own versions of
    # them.
    for name in [name for name in sys.modules if name.partition(".")[0] == "bench"]:
        del sys.modules[name]
    sys.path[:] = [str(tree), *(path for path in sys.path if Path(path).resolve() != ROOT)]
    options = ["-q", "--tb=no", "-p", "no:cacheprovider", f"--basetemp={tree}-tmp", *([] if record else ["-x"])]
    sys.exit(pytest.main([*options, *tests], [Recorder(tree, record)] if record else None))


def run_pytest(tree: Path, tests: list[str], limit_s: float | None, record: Path | None = None) -> str:
    """Run tests in the exported copy of a commit, in a separate process.

    Return ``"survived"``, ``"timed out"``, or the name of the test that failed.
    """
    process = PROCESSES.Process(target=pytest_of_copy, args=(tree, tests, record))
    process.start()
    process.join(limit_s)
    if process.exitcode is None:
        os.killpg(process.pid, signal.SIGKILL)
        return "timed out"
    log = Path(f"{tree}.log").read_text(encoding="utf-8", errors="replace")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+?)(?:\[.*)?(?: - .*)?$", log, re.MULTILINE)
    return "survived" if process.exitcode == 0 else failed[1] if failed else f"exit {process.exitcode}"


class Run:
    """Exported copy of one commit, with its recorded tests and the results of the faults that were tried."""

    def __init__(self, commit: str, seed: str, most_s: float, output: Path) -> None:
        self.commit, self._most_s, self.tree = commit, most_s, output.resolve() / commit[:10]
        tests, self._log = Path(f"{self.tree}_tests.json"), Path(f"{self.tree}_{seed[:10]}.jsonl")
        # All files are exported again, because an interrupted run may have left a change in the copy.
        export(commit, self.tree)
        if not (self.tree / "warpdiff" / "kernels").exists():
            (self.tree / "warpdiff" / "kernels").symlink_to("../kernels", target_is_directory=True)
        if not tests.exists():
            places = [f"tests/{name}" for name in TESTS if (self.tree / "tests" / name).exists()]
            result = run_pytest(self.tree, places, None, tests)
            if result.startswith("exit") or not json.loads(tests.read_text(encoding="utf-8")):
                tests.unlink(missing_ok=True)
                sys.exit(f"error: the tests of {commit} could not be recorded ({result}); see {self.tree}.log")
        recorded = json.loads(tests.read_text(encoding="utf-8"))
        self._tests = {name: test for name, test in recorded.items() if not test["failed"]}
        self._executed = {name for test in self._tests.values() for name in test["names"]}
        self._uses = dict(self._used_names())
        self._log.touch()
        lines = [json.loads(line) for line in self._log.read_text(encoding="utf-8").splitlines()]
        self._by_identity = {record["identity"]: record for record in lines}

    @property
    def records(self) -> list[dict[str, Any]]:
        """Result of each fault that was tried; for a fault that was tried twice, the later result."""
        return list(self._by_identity.values())

    def _used_names(self) -> Iterator[tuple[str, set[str]]]:
        """Yield the name of each function, class and variable of the library, with the names that its definition uses.

        Top-level statements that define nothing run at import; the names in them count as used by every definition of
        the module.
        """
        for path in (self.tree / NATIVE).glob("*.h"):
            yield path.name, set(re.findall(r'#include "(\w+\.h)"', path.read_text(encoding="utf-8")))
        for path in [*self.tree.glob("warpdiff/**/*.py"), *self.tree.glob("kernels/*.py")]:
            parts = list(definitions(ast.parse(path.read_bytes())))
            shared = set().union(*(_names_in(node) for defined, node in parts if not defined))
            yield from ((name, _names_in(node) | shared) for defined, node in parts for name in defined)

    def tests_of(self, mutant: Mutant) -> list[str]:
        """Return the tests to run for a fault, in four groups; in each group, fast tests come first.

        The groups are the tests of the module's test file, those of other files in the test folder of its package that
        import the module, other tests of this folder, and all others. The list ends when a limit of the total time is
        reached. The last two groups have only tests that execute the changed definition. The execution of constants,
        structs and functions of kernels is not recorded. For a fault in one of these, the last two groups have the
        tests that execute code which uses it.
        """
        reached = newer = set(mutant.names)
        while newer := newer - self._executed:
            used = {name if name.endswith(".h") else name.rpartition(".")[2] for name in newer}
            newer = {name for name, names in self._uses.items() if not names.isdisjoint(used)} - reached
            reached = reached | newer
        folder = f"tests/{'kernels' if mutant.package == 'native' else mutant.package}/"
        stem = Path(mutant.path).stem
        texts = {path: path.read_text(encoding="utf-8") for path in (self.tree / folder).glob("test_*.py")}
        imports = re.compile(rf"^(?:from|import)\b.*\b{stem}\b", re.MULTILINE)
        importing = {f"{folder}{path.name}" for path, text in texts.items() if imports.search(text)}
        ranked = []
        for name, test in self._tests.items():
            is_own, imports_it = name.startswith(f"{folder}test_{stem}.py"), name.partition("::")[0] in importing
            if is_own or imports_it or not reached.isdisjoint(test["names"]):
                ranked.append((not is_own, not imports_it, not name.startswith(folder), test["seconds"], name))
        ranked.sort()
        ends = accumulate(seconds for *_, seconds, _ in ranked)
        return [name for (*_, seconds, name), end in zip(ranked, ends, strict=True) if end - seconds < self._most_s]

    def has_result(self, mutant: Mutant, *, again: bool) -> bool:
        """Whether the fault was tried before. With ``again``, only detected faults count as tried."""
        record = self._by_identity.get(mutant.identity)
        return record is not None and not (again and record["result"] == "survived")

    def test(self, mutant: Mutant) -> None:
        """Make the fault in the copy, run the tests for it, record the result, and undo the fault."""
        begin, path, tests = time.perf_counter(), self.tree / mutant.path, self.tests_of(mutant)
        source = path.read_bytes()
        path.write_bytes(mutant.apply(source))
        changed = path.read_text(encoding="utf-8").splitlines()[mutant.line - 1].strip()
        result = run_pytest(self.tree, tests, COMPILE_S + PATIENCE * self._most_s) if tests else "survived"
        path.write_bytes(source)
        # To decide whether a compiled file is current, Python compares the size and the modification time of its source
        # with stored values. The time is in whole seconds, so that both values may be equal although the source has
        # changed. The compiled file is therefore deleted.
        Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)
        record = {
            "result": result, "package": mutant.package, "place": f"{mutant.path}:{mutant.line}", "changed": changed,
            "tests": len(tests), "seconds": round(time.perf_counter() - begin, 1), "identity": mutant.identity,
        }  # fmt: skip
        self._by_identity[mutant.identity] = record
        with self._log.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record, ensure_ascii=False) + "\n")
        print(self.commit[:10], *record.values(), flush=True)


def _names_in(node: ast.AST) -> set[str]:
    """Return the names, attributes and header file names that occur in a syntax node."""
    names = {getattr(part, "id", "") or getattr(part, "attr", "") for part in ast.walk(node)}
    headers = {str(part.value) for part in ast.walk(node) if isinstance(part, ast.Constant)}
    return names - {""} | {name for name in headers if name.endswith(".h")}


def table(records: list[dict[str, Any]]) -> str:
    """Return a Markdown report: scores by package and for faults of headers, and a table of undetected changes."""
    lines = ["| package | changes | detected | score | 95 % interval |", "| --- | --- | --- | --- | --- |"]
    for name in ("all", *PACKAGES, "native"):
        group = [r for r in records if r["package"] == name or (name == "all" and r["package"] != "native")]
        survived = [r["result"] == "survived" for r in group]
        if survived:
            detected, count = survived.count(False), len(survived)
            low, high = binomtest(detected, count).proportion_ci(method="wilson")
            lines.append(f"| {name} | {count} | {detected} | {detected / count:.1%} | {low:.1%} to {high:.1%} |")
    lines += ["", "| survivor | changed line |", "| --- | --- |"]
    survivors = [(r["place"], r["changed"].replace("|", "\\|")) for r in records if r["result"] == "survived"]
    return "\n".join(lines + [f"| {place} | `{changed}` |" for place, changed in sorted(survivors)])


def main() -> None:
    """Test one-token changes of the source code until all are tested or the time is over, and print mutation scores."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("commits", nargs="+", help="commits whose sources and tests are used")
    parser.add_argument("--seed", default="HEAD", help="commit whose hash determines the changes (default: HEAD)")
    parser.add_argument("--count", type=int, default=400, help="number of changes (default: 400)")
    parser.add_argument(
        "--packages", nargs="+", choices=PACKAGES, default=PACKAGES, help="packages to change (default: all)"
    )
    parser.add_argument("--headers", action="store_true", help="make the header faults instead")
    parser.add_argument(
        "--again", action="store_true", help="try undetected changes of an interrupted or earlier run again"
    )
    parser.add_argument(
        "--minutes", type=float, default=1e9, help="time after which no change begins (default: no limit)"
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="processor time of the tests of one change (default: 20)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("bench_results/mutants"),
        help="output folder (default: bench_results/mutants)",
    )
    options = parser.parse_args()
    end = time.monotonic() + 60.0 * options.minutes
    command = ["git", "-C", str(ROOT), "rev-parse", options.seed, *options.commits]
    seed, *commits = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    options.output.mkdir(parents=True, exist_ok=True)
    runs = [Run(commit, seed, options.seconds, options.output) for commit in commits]
    draws = [
        header_mutants(run.tree) if options.headers else draw(run.tree, seed, options.packages)[: options.count]
        for run in runs
    ]
    for mutants in zip_longest(*draws):
        for run, mutant in zip(runs, mutants, strict=True):
            if mutant and not run.has_result(mutant, again=options.again) and time.monotonic() < end:
                run.test(mutant)
    for run in runs:
        print(f"\nCommit {run.commit}, seed {seed}\n\n{table(run.records)}")


if __name__ == "__main__":
    main()
