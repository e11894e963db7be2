"""Run native functions on real tables under AddressSanitizer and UndefinedBehaviorSanitizer.

::

    python -m bench.dev.sanitize

The system's compiler compiles Warp's generated source of every module that a picture uses again, with both sanitizers.
The cases of the corpus then call these functions instead of Warp's: a tube and a snake, footprints, points, a source,
periods of a patch, shadows and subdivided pixels. It requires Linux and ``g++`` with its sanitizers. A finding ends the
process and names the line of the header.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import types
from pathlib import Path
from typing import Any

import warp as wp

from bench.dev import corpus
from warpdiff.device import kernel_calls
from warpdiff.kernels.compile_options import NATIVE

CASES = ("footprints alone", "points", "source", "periods", "centred window", "snake", "box", "many directions")
COMPILER = shutil.which("g++") or "g++"
CHECKED = "address,undefined"
FLAGS = (
    "-std=c++17", "-O1", "-g", "-march=native", f"-fsanitize={CHECKED}", "-fno-sanitize-recover=all",
    # Rows of floats are read as vectors that need not lie at multiples of their size; warnings are the tests'.
    # Warp chooses between what branches have set by copies of both, of which one may not be set.
    "-fno-sanitize=alignment,bool", "-fno-omit-frame-pointer", "-fPIC", "-shared", "-w",
)  # fmt: skip


class Sanitized:
    """Kernels' functions as the system's compiler makes them, by their modules."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._libraries = folder, {}
        # Threads that record their launches ask at once.
        self._lock = threading.Lock()
        self.called: set[str] = set()

    def function(self, kernel: Any) -> Any:
        """That of a kernel."""
        module = kernel.module
        with self._lock:
            if module not in self._libraries:
                self._libraries[module] = self._compiled(module)
            library, source = self._libraries[module]
        key = re.escape(kernel.key)
        name = re.search(rf"\b({key}(_[0-9a-f]+)?_cpu_forward)\(", source)
        if name is None:
            raise RuntimeError(f"no function of {kernel.key} in what Warp made of its module")
        self.called.add(kernel.key)
        return getattr(library, name[1])

    def _compiled(self, module: Any) -> tuple[ctypes.CDLL, str]:
        """Warp's source of a module, and the library that is made of it."""
        folder = self._folder / str(len(self._libraries))
        # As launches on the CPU take it, one thread after the other.
        block_dim, module.options["block_dim"] = module.options["block_dim"], 1
        wp.compile_aot_module(module, device="cpu", module_dir=folder)
        module.options["block_dim"] = block_dim
        (source,) = folder.glob("*.cpp")
        library = folder / "sanitized.so"
        paths = ["-isystem", Path(wp.__file__).parent / "native", "-I", NATIVE, source, "-o", library]
        # What Warp itself answers, such as a check that fails, is not to be called.
        stubs = folder / "stubs.c"
        texts = [path.read_text(encoding="utf-8") for path in (Path(wp.__file__).parent / "native").glob("*.h")]
        texts.append(source.read_text(encoding="utf-8"))
        names = {name for text in texts for name in re.findall(r"\b_?wp_\w+", text)}
        lines = [f'void {name}(void) {{ puts("{name} was called"); abort(); }}' for name in sorted(names)]
        stubs.write_text("\n".join(["#include <stdio.h>", "#include <stdlib.h>", *lines]))
        objects = folder / "stubs.o"
        subprocess.run([COMPILER, "-x", "c", "-w", "-fPIC", "-c", stubs, "-o", objects], check=True)
        subprocess.run([COMPILER, *FLAGS, *paths, objects], check=True)
        return ctypes.CDLL(str(library)), source.read_text(encoding="utf-8")


def run(folder: Path) -> None:
    """Compute all cases by sanitized functions."""
    sanitized = Sanitized(folder)
    init = kernel_calls._Recorded.__init__

    def make(self: Any, step: kernel_calls.KernelCall) -> None:
        init(self, step)
        self._launch.hooks = types.SimpleNamespace(forward=sanitized.function(step.kernel))

    kernel_calls._Recorded.__init__ = make  # type: ignore[method-assign]
    for name in CASES:
        corpus.CASES[name](2)
        print(f"{name}: no findings in {len(sanitized.called)} kernels so far", flush=True)
    print("kernels:", *sorted(sanitized.called))


def main() -> int:
    """Start a process that the sanitizers' libraries are loaded in first."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--inside", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        run(Path(options.inside))
        return 0
    libraries = [
        subprocess.run(
            [COMPILER, f"-print-file-name={name}"], check=True, capture_output=True, text=True
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    environment = os.environ | {
        "LD_PRELOAD": ":".join(libraries), "WARPDIFF_CACHE_DIR": "",
        # Python and its libraries keep what they have until the end; their own calls are not what is looked at.
        "ASAN_OPTIONS": "detect_leaks=0:detect_stack_use_after_return=0", "UBSAN_OPTIONS": "print_stacktrace=1",
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-W", "ignore", "-m", "bench.dev.sanitize", "--inside", folder]
        return subprocess.run(command, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
