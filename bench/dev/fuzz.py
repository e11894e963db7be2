"""Fuzzing of the readers of files and messages, guided by the coverage of their source lines.

::

    python -m bench.dev.fuzz --minutes 10                        # all readers, ten minutes in total
    python -m bench.dev.fuzz --targets gltf x3p --executions 1000000

Each reader starts from the valid files in ``tests/corpus``. A mutated file that executes a new pair of consecutive
source lines is added to the files that are mutated. A reader must return a valid result or refuse the file with an
error that names it. These are failures: an exception of another type, a crash, more than 20 s for a file, allocation
beyond 4 GB, network access, a subprocess, and a file opened outside of the folder. Files that fail are stored in
``fuzz_failures/``.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.dev.fuzz_mutations import mutated

if TYPE_CHECKING:
    from types import FrameType

    from bench.dev.fuzz_targets import Target

ROOT = Path(__file__).resolve().parents[2]
FAILURES = ROOT / "fuzz_failures"
# Arguments of Python that start the process that reads.
WORKER = ("-m", "bench.dev.fuzz")
# Largest address space of the process that reads [bytes], and longest time for a file [s]. Valid files need a
# thousandth of both.
MOST_BYTES, MOST_S = 4 << 30, 20
# Share of the executions whose coverage is recorded. Python traces lines about five times slower than it runs them.
_TRACED = 0.2
# Largest number of mutated files that are mutated again, for one reader.
_MOST_INPUTS = 2000
# Number of failures of one reader after which it is no longer executed.
_MOST_FAILURES = 10


class Coverage:
    """Pairs of consecutive source lines that were executed in the files of a reader."""

    def __init__(self, sources: tuple[str, ...]) -> None:
        self._parts = tuple(f"warpdiff/{part}" for part in sources)
        self._is_own: dict[str, bool] = {}
        self._pairs: set[tuple[int, int, int]] = set()
        self._new = 0

    def __len__(self) -> int:
        return len(self._pairs)

    def _enter(self, frame: FrameType, _event: str, _argument: Any) -> Any:
        name = frame.f_code.co_filename
        if name not in self._is_own:
            path = name.replace("\\", "/")
            self._is_own[name] = any(part in path for part in self._parts)
        if not self._is_own[name]:
            return None
        code, previous = id(frame.f_code), 0

        def line(frame: FrameType, event: str, _: Any) -> Any:
            nonlocal previous
            if event == "line":
                pair = code, previous, frame.f_lineno
                previous = frame.f_lineno
                if pair not in self._pairs:
                    self._pairs.add(pair)
                    self._new += 1
            return line

        return line

    @contextlib.contextmanager
    def recorded(self) -> Any:
        """Context that records executed lines. It returns a function for the number of new pairs."""
        self._new = 0
        sys.settrace(self._enter)
        try:
            yield lambda: self._new
        finally:
            sys.settrace(None)


def watch(folder: Path, failures: list[str]) -> None:
    """Record network access, subprocesses, and opened files outside of the folder, Python's folders and ``/proc``."""
    allowed = [folder, *(Path(name).resolve() for name in {sys.prefix, sys.base_prefix, *sys.path}), Path("/proc")]
    allowed += [ROOT / "warpdiff", ROOT / "kernels", Path("/sys/fs/cgroup")]

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        # The event loop of asyncio has a pair of sockets, which are not connected to a network.
        if event.startswith(("socket.connect", "socket.getaddrinfo", "urllib.", "subprocess.", "os.system")):
            failures.append(event)
        if event == "open" and isinstance(arguments[0], (str, bytes)):
            path = Path(os.fsdecode(arguments[0])).resolve()
            if not any(path.is_relative_to(parent) for parent in allowed):
                failures.append(f"opens {path}")

    sys.addaudithook(hook)


def problem(target: Target, path: Path, names: list[str]) -> str:
    """Read a file, and return the description of a failure, or an empty string."""
    try:
        target.read(path)
    except target.errors as error:
        text = str(error)
        is_asked = path.stem.startswith("export") and ("extent_um" in text or "unit" in text)
        if target.is_named and not is_asked and not any(name in text for name in names):
            return f"does not name the file: {error!r}"
    except FileNotFoundError as error:
        return "" if any(name in str(error) for name in names) else repr(error)
    except MemoryError as error:
        return "" if "free" in str(error) else f"memory beyond the limit: {error!r}"
    except Exception as error:
        return repr(error)
    return ""


def fuzz(target: Target, folder: Path, *, executions: int, seconds: float, seed: int, outside: list[str]) -> Any:
    """Read mutated files of one reader, and return numbers of executions, failures and coverage by name."""
    valid = {path.name: path.read_bytes() for path in sorted(target.folder.iterdir())}
    for name, content in valid.items():
        (folder / name).write_bytes(content)
    names = list(valid)
    rng, coverage, failures = random.Random(seed), Coverage(target.sources), []  # noqa: S311 (not for secrets)
    inputs = list(valid.items())
    for name in valid:
        with coverage.recorded():
            problem(target, folder / name, names)
    begin, count = time.monotonic(), 0
    while count < executions and time.monotonic() - begin < seconds and len(failures) < _MOST_FAILURES:
        name, content = rng.choice(inputs)
        others = [other for other_name, other in rng.sample(inputs, min(3, len(inputs))) if other_name == name]
        data, path = mutated(content, others, rng), folder / name
        path.write_bytes(data)
        count += 1
        # The alarm signal ends this process if the reader hangs. The file then remains in the folder.
        signal.alarm(MOST_S)
        if rng.random() < _TRACED:
            with coverage.recorded() as new_pairs:
                failure = problem(target, path, names)
            if new_pairs() and len(inputs) < _MOST_INPUTS:
                inputs.append((name, data))
        else:
            failure = problem(target, path, names)
        signal.alarm(0)
        reasons = filter(None, (failure, *outside))
        failures += [{"file": name, "content": data.hex(), "reason": reason} for reason in reasons]
        outside.clear()
        path.write_bytes(valid[name])
    for name in valid:
        (folder / name).unlink()
    return {
        "executions": count, "failures": failures, "inputs": len(inputs), "pairs": len(coverage),
        "seconds": round(time.monotonic() - begin, 1),
    }  # fmt: skip


def work(options: argparse.Namespace) -> None:
    """Fuzz the readers in this process, in the current folder, and print one line of JSON for each."""
    import resource

    from bench.dev.fuzz_targets import BY_NAME

    warnings.simplefilter("ignore")
    folder, outside = Path.cwd(), []
    # Slow imports and caches are loaded before the limits apply.
    for name in options.targets:
        for path in BY_NAME[name].folder.iterdir():
            problem(BY_NAME[name], path, [])
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    watch(folder, outside)
    for name in options.targets:
        result = fuzz(
            BY_NAME[name], folder, executions=options.executions, seconds=options.seconds, seed=options.seed,
            outside=outside,
        )  # fmt: skip
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(json.dumps({"target": name, "peak_mb": round(peak)} | result), flush=True)


def run(targets: list[str], *, executions: int, seconds: float, seed: int) -> list[Any]:
    """Fuzz readers in a process of their own, and return the results of the readers, with crashes and hangs.

    Args:
        targets: Names of the readers.
        executions: Largest number of files for each reader.
        seconds: Longest time for each reader [s].
        seed: Random seed.
    """
    shared = Path("/dev/shm")  # noqa: S108 (a folder in memory, in which the temporary folder has a random name)
    results: list[Any] = []
    while len(results) < len(targets):
        left = targets[len(results) :]
        with tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else None) as folder:
            command = [
                sys.executable, *WORKER, "--worker", "--executions", str(executions), "--seconds", str(seconds),
                "--seed", str(seed), "--targets", *left,
            ]  # fmt: skip
            environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, check=False, errors="replace"
            )
            results += [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
            if done.returncode:
                # The folder contains the last file of the interrupted reader, and the valid files, which are unchanged.
                reason = "hangs" if done.returncode == -signal.SIGALRM else f"exit code {done.returncode}"
                name = targets[len(results)] if len(results) < len(targets) else targets[-1]
                kept = FAILURES / f"{name}-interrupted"
                shutil.copytree(folder, kept, dirs_exist_ok=True)
                failure = {"file": str(kept), "content": "", "reason": f"{reason}: {done.stderr[-2000:]}"}
                results.append({"target": name, "executions": 0, "failures": [failure], "inputs": 0, "pairs": 0})
    return results


def store(results: list[Any]) -> None:
    """Write the files that failed into a folder, and print the reasons."""
    for result in results:
        for number, failure in enumerate(result["failures"]):
            print(f"{result['target']}: {failure['file']}: {failure['reason']}", file=sys.stderr)
            if failure["content"]:
                target = FAILURES / result["target"] / f"{number}-{failure['file']}"
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(bytes.fromhex(failure["content"]))


def main() -> int:
    """Fuzz the readers and print a table. Return 1 if a file failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", nargs="+", help="readers (default: all)")
    parser.add_argument("--executions", type=int, default=10**9, help="files for each reader (default: no limit)")
    parser.add_argument("--minutes", type=float, help="time of all readers together (default: no limit)")
    parser.add_argument("--seconds", type=float, default=1e9, help="time of each reader")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="random seed (default: the time)")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(options)
        return 0
    from bench.dev.fuzz_targets import BY_NAME

    names = options.targets or list(BY_NAME)
    unknown = sorted(set(names) - set(BY_NAME))
    if unknown:
        parser.error(f"--targets must be among {', '.join(BY_NAME)}, got {', '.join(unknown)}")
    seconds = options.seconds if options.minutes is None else 60.0 * options.minutes / len(names)
    print(f"seed {options.seed}")
    print("| reader | executions | failures | inputs | line pairs | peak memory [MB] | per second |")
    print(f"{7 * '| --- '}|")
    is_clean = True
    for name in names:
        results = run([name], executions=options.executions, seconds=seconds, seed=options.seed)
        store(results)
        for result in results:
            rate = result["executions"] / max(result.get("seconds", 0.0), 1e-3)
            cells = (result["executions"], len(result["failures"]), result["inputs"], result["pairs"])
            row = " | ".join(f"{cell:,}" for cell in (*cells, result.get("peak_mb", 0), round(rate)))
            print(f"| {name} | {row} |", flush=True)
            is_clean = is_clean and not result["failures"]
    return 0 if is_clean else 1


if __name__ == "__main__":
    sys.exit(main())
