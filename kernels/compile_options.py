"""Compile options of kernels: flags, and the headers with their native functions."""

import functools
import re
from pathlib import Path
from typing import Any

import warp as wp

# Sums over vectors are as long as a table's rows: the first two flags let these be reordered into SIMD lanes. They are
# the parts of fast-math that do so and leave NaN and infinity defined. The last two make the first picture come sooner:
# Warp's headers, which each thread that compiles precompiles, take 1.1 s instead of 1.7 without a type that no kernel
# has, and a module 0.05 to 0.1 s less when their templates are instantiated beforehand.
_FLAGS = (
    "-O3 -march=native -mreassociate -fno-signed-zeros -ffp-contract=fast -DWP_NO_BFLOAT16= -fpch-instantiate-templates"
)
NATIVE = Path(__file__).resolve().parent / "native"


@functools.cache
def headers(name: str) -> tuple[Path, ...]:
    """A header of this package and all that it includes."""
    path = NATIVE / name
    included = re.findall(r'^#include "(\w+\.h)"', path.read_text(encoding="utf-8"), re.MULTILINE)
    return tuple(dict.fromkeys([path, *(header for inner in included for header in headers(inner))]))


def options(*names: str, **others: Any) -> dict[str, Any]:
    """Module options of kernels whose native functions lie in headers of ``native``.

    The folder is named to all modules: with other options Warp's own headers are precompiled once more. A header that
    has changed makes Warp compile the module again.
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
