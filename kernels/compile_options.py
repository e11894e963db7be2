"""Compile options of kernels: compiler flags, and the C++ headers of ``native`` that the kernels call."""

import functools
import re
from pathlib import Path
from typing import Any

import warp as wp

# Compiler flags for the CPU. -mreassociate and -fno-signed-zeros let the compiler reorder sums over the rows of a table
# into SIMD lanes; NaN and infinity remain defined. The last two flags shorten compilation. Without bfloat16, which no
# kernel uses, each compiling thread precompiles Warp's headers in 1.1 s instead of 1.7 s. Instantiated templates in the
# precompiled headers save 0.05 to 0.1 s per module.
_FLAGS = (
    "-O3 -march=native -mreassociate -fno-signed-zeros -ffp-contract=fast -DWP_NO_BFLOAT16= -fpch-instantiate-templates"
)
NATIVE = Path(__file__).resolve().parent / "native"


@functools.cache
def headers(name: str) -> tuple[Path, ...]:
    """Return the paths of a header in ``native`` and of all headers that it includes."""
    path = NATIVE / name
    included = re.findall(r'^#include "(\w+\.h)"', path.read_text(encoding="utf-8"), re.MULTILINE)
    return tuple(dict.fromkeys([path, *(header for inner in included for header in headers(inner))]))


def options(*names: str, **others: Any) -> dict[str, Any]:
    """Return module options for kernels whose native functions are in headers of ``native``.

    All modules have the same include folder, because Warp precompiles its own headers once for each folder. The headers
    are recorded as dependencies, so that Warp compiles a module again if one of them has changed.
    """
    includes = "".join(f'#include "{name}"\n' for name in names)
    build = wp.ModuleBuildOptions(
        extra_cpu_include_dirs=[NATIVE],
        extra_cuda_include_dirs=[NATIVE],
        extra_cpu_preamble=includes,
        extra_cuda_preamble=includes,
        extra_build_dependencies=list(dict.fromkeys(path for name in names for path in headers(name))),
    )
    return {"enable_backward": False, "cpu_compiler_flags": _FLAGS, "extra_build_options": build, **others}
