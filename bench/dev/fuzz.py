"""Fuzzing of the readers of files and messages, guided by the coverage of the library's source code.

::

    python -m bench.dev.fuzz --minutes 10                        # all readers, ten minutes in total
    python -m bench.dev.fuzz --targets gltf x3p --executions 1000000

Each reader starts from the valid files in ``tests/corpus``. A mutated file is a randomly changed copy. It is mutated
further if it reaches a new block of source code, or executes a block a different number of times, by order of
magnitude. A reader must return a valid result or refuse the file with an error that names it. These are failures: an
exception of another type, a crash, more than 20 s for a file, allocation beyond 4 GB, network access, a subprocess, and
a file opened outside of the folder. Files that fail are stored in ``fuzz_failures/``.
"""

from __future__ import annotations

import argparse
import functools
import gc
import json
import math
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

from bench.dev import fuzz_coverage
from bench.dev.fuzz_mutations import mutated

if TYPE_CHECKING:
    from bench.dev.fuzz_targets import Target

ROOT = Path(__file__).resolve().parents[2]
FAILURES = ROOT / "fuzz_failures"
# Arguments of Python that start the worker process, in which the mutated files are read.
WORKER = ("-m", "bench.dev.fuzz")
# Largest address space of the worker process, which reads the files [bytes], and longest time for a file [s]. Valid
# files need a thousandth of both.
MOST_BYTES, MOST_S = 4 << 30, 20
# Largest number of versions of one valid file (itself and mutated copies) from which further mutations start.
_MOST_INPUTS = 500
# A mutated file is cut to twice the size of the valid file, but not to less than this size [bytes]. Without a limit,
# files grow from mutation to mutation, and readers need longer for them.
_LEAST_BYTES = 2048
# Number of failures of one reader of files after which no more files are read by it.
_MOST_FAILURES = 10


def watch(folder: Path, failures: list[str]) -> None:
    """Append a text to ``failures`` whenever a reader of files does something that it must not do.

    It must not access the network, start a subprocess, or open a file outside of ``folder``, of the folders of Python
    and of the library, of ``/proc`` and of ``/sys/fs/cgroup``.
    """
    allowed = [folder, *(Path(name).resolve() for name in {sys.prefix, sys.base_prefix, *sys.path}), Path("/proc")]
    allowed += [ROOT / "warpdiff", ROOT / "kernels", Path("/sys/fs/cgroup")]

    @functools.lru_cache(maxsize=4096)
    def is_allowed(name: str | bytes) -> bool:
        path = Path(os.fsdecode(name)).resolve()
        return any(path.is_relative_to(parent) for parent in allowed)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            if isinstance(arguments[0], (str, bytes)) and not is_allowed(arguments[0]):
                failures.append(f"opens {os.fsdecode(arguments[0])}")
        # The event "socket.connect" is a failure, but the creation of sockets is not: the event loop of asyncio creates
        # a pair of sockets without a network connection.
        elif event.startswith(("socket.connect", "socket.getaddrinfo", "urllib.", "subprocess.", "os.system")):
            failures.append(event)

    sys.addaudithook(hook)


def problem(target: Target, path: Path, names: list[str]) -> str:
    """Read a file by the reader ``target``; return the description of a failure, or an empty string."""
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
    """Read randomly changed files by one reader; return failures, and counts of read files and of executed code blocks.

    The result is a dictionary.
    """
    valid = {path.name: path.read_bytes() for path in sorted(target.folder.iterdir())}
    for name, content in valid.items():
        (folder / name).write_bytes(content)
    names = list(valid)
    rng, coverage, failures = random.Random(seed), fuzz_coverage.Coverage(), []  # noqa: S311 (not for secrets)
    inputs = {name: [content] for name, content in valid.items()}
    for name in valid:
        coverage.reset()
        problem(target, folder / name, names)
        coverage.adds()
    begin, cpu_begin, alarm, count, name = time.monotonic(), time.process_time(), -math.inf, 0, names[0]
    while count < executions and (now := time.monotonic()) - begin < seconds and len(failures) < _MOST_FAILURES:
        if now - alarm > 1.0:
            # The alarm signal ends this process if the reader hangs. The file then remains in the folder.
            signal.alarm(MOST_S)
            alarm = now
        previous, name = name, rng.choice(names)
        if previous != name:
            # The previous file is restored to its valid content, because the next file may refer to it.
            (folder / previous).write_bytes(valid[previous])
        data, path = mutated(rng.choice(inputs[name]), inputs[name], rng), folder / name
        data = data[: max(2 * len(valid[name]), _LEAST_BYTES)]
        path.write_bytes(data)
        count += 1
        coverage.reset()
        failure = problem(target, path, names)
        if coverage.adds() and len(inputs[name]) < _MOST_INPUTS:
            inputs[name].append(data)
        if failure or outside:
            reasons = filter(None, (failure, *outside))
            failures += [{"file": name, "content": data.hex(), "reason": reason} for reason in reasons]
            outside.clear()
    signal.alarm(0)
    for name in valid:
        (folder / name).unlink()
    return {
        "executions": count, "failures": failures, "inputs": sum(map(len, inputs.values())), "blocks": len(coverage),
        "seconds": round(time.process_time() - cpu_begin, 1),
    }  # fmt: skip


def work(options: argparse.Namespace) -> None:
    """Fuzz the readers of files in this process, in the current folder, and print one line of JSON for each reader."""
    import resource

    fuzz_coverage.install()
    from bench.dev.fuzz_targets import BY_NAME

    warnings.simplefilter("ignore")
    folder, outside = Path.cwd(), []
    # Slow imports and caches are loaded before the limits apply.
    for name in options.targets:
        for path in BY_NAME[name].folder.iterdir():
            problem(BY_NAME[name], path, [])
    # Objects of the imported modules exist until the process ends. The garbage collector no longer visits these
    # objects, which saves time.
    gc.collect()
    gc.freeze()
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
    """Fuzz readers of files in a separate process, and return the results of the readers, with crashes and hangs.

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
                # If a reader hangs or crashes, the last mutated file is still in the folder. All other files there have
                # their valid content.
                reason = "hangs" if done.returncode == -signal.SIGALRM else f"exit code {done.returncode}"
                name = targets[len(results)] if len(results) < len(targets) else targets[-1]
                kept = FAILURES / f"{name}-interrupted"
                shutil.copytree(folder, kept, dirs_exist_ok=True)
                failure = {"file": str(kept), "content": "", "reason": f"{reason}: {done.stderr[-2000:]}"}
                results.append({"target": name, "executions": 0, "failures": [failure], "inputs": 0, "blocks": 0})
    return results


def store(results: list[Any]) -> None:
    """Write the mutated files on which a reader failed into a folder, and print the reasons of the failures."""
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
    print("| reader | executions | failures | inputs | blocks | peak memory [MB] | per second of processor time |")
    print(f"{7 * '| --- '}|")
    is_clean = True
    for name in names:
        results = run([name], executions=options.executions, seconds=seconds, seed=options.seed)
        store(results)
        for result in results:
            rate = result["executions"] / max(result.get("seconds", 0.0), 1e-3)
            cells = (result["executions"], len(result["failures"]), result["inputs"], result["blocks"])
            row = " | ".join(f"{cell:,}" for cell in (*cells, result.get("peak_mb", 0), round(rate)))
            print(f"| {name} | {row} |", flush=True)
            is_clean = is_clean and not result["failures"]
    return 0 if is_clean else 1


if __name__ == "__main__":
    sys.exit(main())
