"""Mutation score: how many one-token faults of the sources, drawn at random, do the tests detect?

``python -m bench.dev.mutants --minutes 60`` copies the checkout into a temporary folder. It records once which lines
and kernels each test executes. It then applies one change after the other and runs the tests that execute it, the most
specific first. Changes are drawn by a commit hash; each package has a share by its code lines. Two hand-made faults of
each C++ header run the same way and are counted apart. An interrupted run continues where it ended.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib.util
import json
import math
import multiprocessing
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from bench.dev.mutant_sites import NATIVE, PACKAGES, Mutant, draw, header_mutants

ROOT = Path(__file__).resolve().parents[2]
TREES = Path(tempfile.gettempdir(), "warpdiff-mutants", hashlib.sha256(str(ROOT).encode()).hexdigest()[:8])
# Tests that may run; others are of interfaces, files and signals.
TESTS = tuple(
    f"tests/{name}"
    for name in (
        "optics/", "diffraction/", "evaluate/", "planner/", "kernels/", "properties/", "tables/", "lights/", "render/",
        "baked/", "device/", "request/", "scene/", "robustness/test_bad_input.py", "robustness/test_refusals.py",
        "robustness/test_memory.py",
    )
)  # fmt: skip
# Limit: time after which a change has timed out, relative to its tests' time, and to compile kernels [s].
PATIENCE, COMPILE_S = 4.0, 60.0
# Limit: address space of a process [bytes]: changes of sizes would exhaust the machine.
MEMORY = 12 << 30
# Processes that run tests are forks of one that has imported the slow packages, but not this one.
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["pytest", "hypothesis", "numpy.testing", "scipy.special", "trimesh", "warp"])
# Exit code of a process that would test another package; none of pytest's.
NOT_THE_COPY = 99
DETECTED = ("killed", "timed out")
Tests = dict[str, dict[str, Any]]


def environment(tree: Path) -> dict[str, str]:
    """Return the environment of tests in a copy, with a cache of kernels and temporary files of their own."""
    data = os.environ.get("WARPDIFF_DATA") or str(ROOT.parent / "shared" / "data")
    temporary = tree.parent / "tmp"
    temporary.mkdir(exist_ok=True)
    return os.environ | {
        "PYTHONPATH": str(tree), "WARP_CACHE_PATH": str(tree.parent / "kernels"), "WARPDIFF_DATA": data,
        "TMPDIR": str(temporary),
    }  # fmt: skip


def copy_tree(tree: Path) -> dict[str, str]:
    """Copy the files of the checkout; return a hash of each test file, and of all sources under the name ``""``."""
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0")
    names = [name for name in sorted(names) if (ROOT / name).is_file()]
    # Caches stay: they hold the times or the hashes of what they were compiled from.
    for path in [path for path in tree.rglob("*.py") if path.is_file() and not path.is_symlink()]:
        path.unlink()
    digests, sources = {}, hashlib.sha256()
    for name in names:
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tree / name)
        content = (ROOT / name).read_bytes()
        if re.fullmatch(r"tests/.*/test_\w+\.py", name):
            digests[name] = hashlib.sha256(content).hexdigest()
        elif name.startswith(("warpdiff/", "kernels/")):
            sources.update(name.encode() + content)
    # An installed package finds its kernels elsewhere.
    if not (tree / "warpdiff" / "kernels").exists():
        (tree / "warpdiff" / "kernels").symlink_to("../kernels", target_is_directory=True)
    return {**digests, "": sources.hexdigest()}


def compile_sources(tree: Path) -> None:
    """Compile the copy's sources by their contents: changes within a second may leave times and sizes equal."""
    mode = ["--invalidation-mode", "checked-hash"]
    command = [sys.executable, "-m", "compileall", "-q", "-f", *mode, "warpdiff", "kernels", "bench"]
    subprocess.run(command, cwd=tree, check=True)


def measured_tests(tree: Path, digests: dict[str, str], output: Path, jobs: int) -> Tests:
    """Return time, lines and kernels of each test function that passes; files of tests that changed are measured."""
    path = output / "tests.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"digests": {}, "tests": {}}
    same = {name for name, digest in digests.items() if known["digests"].get(name) == digest}
    changed = [name for name in digests if name.startswith(TESTS) and (name not in same or "" not in same)]
    if changed:
        folder = tree.parent / "tests"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        command = [sys.executable, "-m", "pytest", "-q", "-n", str(jobs), "--dist", "loadfile"]
        variables = environment(tree) | {"WARPDIFF_TESTS_BY_LINE": str(folder)}
        subprocess.run([*command, "-p", "bench.dev.tests_by_line", *changed], cwd=tree, env=variables, check=False)
        tests = {name: test for name, test in known["tests"].items() if name.partition("::")[0] in same - {*changed}}
        for report in sorted(folder.glob("*.json")):
            tests |= json.loads(report.read_text(encoding="utf-8"))
        known = {"digests": digests, "tests": tests}
        path.write_text(json.dumps(known), encoding="utf-8")
    return dict(known["tests"])


class Selection:
    """Selects the tests of a change."""

    def __init__(self, tests: Tests, most_s: float) -> None:
        self._tests, self._most_s = tests, most_s
        self._lines = {
            name: {path: set(lines) for path, lines in test["lines"].items()} for name, test in tests.items()
        }
        self._names: dict[str, set[str]] = {}
        self._kernels: set[str] = set()
        self._sources = {path: path.read_text(encoding="utf-8") for path in sorted((ROOT / "kernels").glob("*.py"))}
        for source in self._sources.values():
            self._read(ast.parse(source), ())

    def _read(self, node: ast.AST, outer: tuple[str, ...]) -> None:
        """Record which names functions, structs and constants of kernels use; functions use those around them."""
        name = getattr(node, "name", "")
        if isinstance(node, ast.Assign) and not outer and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
        if name:
            used = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            used |= {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)}
            self._names.setdefault(name, set()).update(used, outer)
            if any("kernel" in ast.unparse(decorator) for decorator in getattr(node, "decorator_list", ())):
                self._kernels.add(name)
        for child in ast.iter_child_nodes(node):
            self._read(child, (*outer, name) if name else outer)

    def _kernels_of(self, mutant: Mutant) -> set[str]:
        """Kernels that use the definition or the header that is changed, directly or through others."""
        used_by = {mutant.definition}
        if mutant.package == "native":
            headers = {mutant.definition}
            for _ in range(4):
                for path in (ROOT / NATIVE).glob("*.h"):
                    if any(f'#include "{name}"' in path.read_text(encoding="utf-8") for name in headers):
                        headers.add(path.name)
            texts = [text for text in self._sources.values() if any(f'"{name}"' in text for name in headers)]
            used_by = {name for name in self._kernels if any(f"def {name}(" in text for text in texts)}
        while more := {name for name, used in self._names.items() if used & used_by} - used_by:
            used_by |= more
        return used_by & self._kernels

    def of(self, mutant: Mutant) -> tuple[list[str], float]:
        """Return test functions, and their time without the change [s].

        Those of the module's own file, or that execute the changed line or launch a kernel that it changes, come first, the most specific of
        them before others and fast ones before slow ones. Other functions that execute the module follow.
        """
        kernels = self._kernels_of(mutant) if mutant.package in {"kernels", "native"} else set()
        stem, folder = Path(mutant.path).stem, "kernels" if mutant.package == "native" else mutant.package
        ranked = []
        for name, lines in self._lines.items():
            executed = lines.get(mutant.path, set())
            hits = bool(executed & set(mutant.lines)) or bool(kernels & lines.get("kernels", set()))
            places = (f"tests/{folder}/test_{stem}.py", f"tests/{folder}/", "tests/properties/", "")
            place = next(number for number, prefix in enumerate(places) if name.startswith(prefix))
            if hits or executed or place == 0 or (mutant.at_import and place == 1):
                ranked.append((not hits and place > 0, place, self._tests[name]["seconds"], name))
        selected, total = [], 0.0
        for *_, seconds, name in sorted(ranked):
            if not selected or total + seconds <= self._most_s:
                selected.append(name)
                total += seconds
        return selected, total


def pytest_process(tree: Path, names: list[str], log: Path) -> None:
    """Run test functions until one fails, in a process forked for them; the exit code is that of pytest."""
    os.setsid()
    os.chdir(tree)
    os.environ.update(environment(tree))
    tempfile.tempdir, sys.dont_write_bytecode = None, True
    # Pytest imports the package for its filters of warnings before it changes the path.
    sys.path[:] = [str(tree), *(path for path in sys.path if Path(path).resolve() != ROOT)]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    package = importlib.util.find_spec("warpdiff.kernels")
    if package is None or not str(package.origin).startswith(str(tree)):
        os._exit(NOT_THE_COPY)
    with log.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    options = ["-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist"]
    code = pytest.main([*options, f"--basetemp={tree.parent / 'tmp' / tree.name}", *names])
    sys.stdout.flush()
    os._exit(code)


def run_tests(tree: Path, names: list[str], limit_s: float) -> tuple[str, str]:
    """Run test functions until one fails; return ``"survived"``, ``"killed"`` or ``"timed out"``, and that function."""
    log = tree.parent / f"{tree.name}.log"
    process = PROCESSES.Process(target=pytest_process, args=(tree, names, log))
    process.start()
    process.join(limit_s)
    if process.exitcode is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.join()
        return "timed out", ""
    if process.exitcode == NOT_THE_COPY:
        raise RuntimeError(f"tests import another warpdiff than that of {tree}")
    # No test failed, or none was there to run.
    if process.exitcode in {0, 5}:
        return "survived", ""
    text = log.read_text(encoding="utf-8", errors="replace")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+?)(?:\[.*)?(?: - .*)?$", text, re.MULTILINE)
    return "killed", failed[1] if failed else f"exit {process.exitcode}"


def run_mutant(mutant: Mutant, tree: Path, selection: Selection) -> dict[str, Any]:
    """Apply a change in a copy, run its tests, and return a record of the result."""
    begin = time.perf_counter()
    path = tree / mutant.path
    source = path.read_bytes()
    text, changed = (part.decode().splitlines()[mutant.line - 1].strip() for part in (source, mutant.apply(source)))
    names, tests_s = selection.of(mutant)
    result, killer = "survived", ""
    if mutant.is_equivalent(source):
        result = "equivalent"
    elif names:
        path.write_bytes(mutant.apply(source))
        try:
            result, killer = run_tests(tree, names, COMPILE_S + PATIENCE * tests_s)
        finally:
            path.write_bytes(source)
    return {
        "key": mutant.key, "package": mutant.package, "path": mutant.path, "line": mutant.line, "old": mutant.old,
        "new": mutant.new, "text": text, "changed": changed, "result": result, "killer": killer, "tests": len(names),
        "seconds": round(time.perf_counter() - begin, 2),
    }  # fmt: skip


def wilson(detected: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's formula."""
    if count == 0:
        return 0.0, 1.0
    z2, share = 1.96**2, detected / count
    middle = (share + z2 / (2 * count)) / (1.0 + z2 / count)
    half = math.sqrt(share * (1.0 - share) * z2 / count + (z2 / (2 * count)) ** 2) / (1.0 + z2 / count)
    return middle - half, middle + half


def summary(records: list[dict[str, Any]], judged: dict[str, str]) -> list[dict[str, Any]]:
    """Return a row for each package, for all drawn changes, and for the headers' faults."""
    groups = {package: [r for r in records if r["package"] == package] for package in (*PACKAGES, "native")}
    groups = {**groups, "all drawn": [r for r in records if r["package"] != "native"]}
    rows = []
    for name, group in groups.items():
        results = Counter(r["result"] for r in group)
        detected = sum(results[result] for result in DETECTED)
        reasons = [judged.get(r["key"], "") for r in group if r["result"] == "survived"]
        equivalent = sum(reason.startswith("equivalent") for reason in reasons)
        count = detected + results["survived"]
        low, high = wilson(detected, count)
        rows.append({
            "package": name, "changes": count, "detected": detected, "timed out": results["timed out"],
            "survived": results["survived"], "judged equivalent": equivalent, "score": detected / max(count, 1),
            "interval": [low, high], "score without equivalent": detected / max(count - equivalent, 1),
        })  # fmt: skip
    return rows


def write_report(output: Path, seed: str, records: list[dict[str, Any]], judged: dict[str, str]) -> str:
    """Write ``mutants.json`` and ``mutants.md``; return the table of scores."""
    rows = summary(records, judged)
    survivors = sorted((r for r in records if r["result"] == "survived"), key=lambda r: (r["path"], r["line"]))
    content = {"seed": seed, "packages": rows, "survivors": survivors}
    (output / "mutants.json").write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
    head = ["package", "changes", "detected", "survived", "equivalent", "score", "95 % interval", "without equivalent"]
    lines = [f"| {' | '.join(head)} |", "|" + " --- |" * len(head)]
    for row in rows:
        low, high = row["interval"]
        lines.append(
            f"| {row['package']} | {row['changes']} | {row['detected']} | {row['survived']} | "
            f"{row['judged equivalent']} | {row['score']:.1%} | {low:.1%} to {high:.1%} | "
            f"{row['score without equivalent']:.1%} |"
        )
    table = "\n".join(lines)
    listed = ["", "| survivor | line | changed line | judged |", "| --- | --- | --- | --- |"]
    for r in survivors:
        cells = (f"{r['path']}:{r['line']}", f"`{r['text']}`", f"`{r['changed']}`", judged.get(r["key"], ""))
        listed.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    (output / "mutants.md").write_text("\n".join([f"Seed {seed}", "", table, *listed, ""]), encoding="utf-8")
    return table


def in_turns(first: list[Mutant], second: list[Mutant]) -> list[Mutant]:
    """Return two lists as one, evenly mixed, so that any part of it has both."""
    ranked = [((rank + 0.5) / len(part), mutant) for part in (first, second) for rank, mutant in enumerate(part)]
    return [mutant for _, mutant in sorted(ranked, key=lambda pair: pair[0])]


def main() -> int:
    """Run changes until all are done or the time is over, and print the scores."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=400, help="number of drawn changes (400)")
    parser.add_argument("--seed", help="commit hash that draws them (HEAD)")
    parser.add_argument("--packages", nargs="+", choices=[*PACKAGES, "native"], help="run only these (all)")
    parser.add_argument("--jobs", type=int, default=2, help="number of changes at a time (2)")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no change after this time (no limit)")
    parser.add_argument("--seconds", type=float, default=20.0, help="processor time of the tests of one change (20)")
    parser.add_argument("--output", type=Path, default=Path("bench_results/mutants"), help="(bench_results/mutants)")
    parser.add_argument("--judged", type=Path, help='JSON file: "equivalent: why" or "accepted: why" by key')
    parser.add_argument("--again", action="store_true", help="run survivors that are not judged again")
    options = parser.parse_args()
    end = time.monotonic() + 60.0 * options.minutes
    head = ["git", "rev-parse", "HEAD"]
    seed = options.seed or subprocess.run(head, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
    mutants = in_turns(draw(ROOT, seed, options.count), list(header_mutants(ROOT)))
    mutants = [mutant for mutant in mutants if not options.packages or mutant.package in options.packages]
    options.output.mkdir(parents=True, exist_ok=True)
    judged = json.loads(options.judged.read_text(encoding="utf-8")) if options.judged else {}
    log = options.output / "results.jsonl"
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    records = {record["key"]: record for record in map(json.loads, lines)}
    again = {key for key, r in records.items() if options.again and r["result"] == "survived" and key not in judged}
    trees = [TREES / f"tree{job}" for job in range(options.jobs)]
    digests = [copy_tree(tree) for tree in trees]
    selection = Selection(measured_tests(trees[0], digests[0], options.output.resolve(), options.jobs), options.seconds)
    for tree in trees:
        compile_sources(tree)
    lock = threading.Lock()

    def run(mutant: Mutant) -> None:
        if time.monotonic() > end:
            return
        with lock:
            tree = trees.pop()
        record = run_mutant(mutant, tree, selection)
        with lock:
            trees.append(tree)
            records[mutant.key] = record
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record, ensure_ascii=False) + "\n")
            print(*(record[name] for name in ("result", "seconds", "path", "line", "changed", "killer")), flush=True)

    # Survivors come first.
    mutants.sort(key=lambda mutant: mutant.key not in again)
    with ThreadPoolExecutor(options.jobs) as executor:
        list(executor.map(run, [mutant for mutant in mutants if mutant.key not in records or mutant.key in again]))
    drawn = {mutant.key for mutant in mutants}
    print(write_report(options.output, seed, [r for key, r in records.items() if key in drawn], judged))
    return 0


if __name__ == "__main__":
    sys.exit(main())
