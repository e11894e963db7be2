"""Native headers (C++): each header is included, is listed as a build dependency, and compiles with a plain C++
compiler.
"""

import ast
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import warp as wp

from warpdiff.kernels import compile_options

HEADERS = sorted(compile_options.NATIVE.glob("*.h"))
MODULES = sorted(compile_options.NATIVE.parent.glob("*.py"))
COMPILER = next((snippets for name in ("c++", "g++", "clang++") if (snippets := shutil.which(name))), None)


def calls(path, name):
    """Yield all calls of a function in a Python file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] == name:
            yield node


def text(node):
    """Return the text of a string or f-string, with 0 for each inserted value."""
    if isinstance(node, ast.Constant):
        return node.value
    return "".join(part.value if isinstance(part, ast.Constant) else "0" for part in node.values)


def named(path):
    """Return the native headers that the kernels of a Python module include, directly or through other headers."""
    names = [text(node) for call in calls(path, "options") for node in call.args]
    return {header for name in names for header in compile_options.headers(name)}


def test_every_header_is_included_and_is_a_build_dependency():
    used = set().union(*(named(path) for path in MODULES))
    assert used == set(HEADERS)
    build = compile_options.options("footprint_lookup.h", "point_lookup.h")["extra_build_options"]
    names = [path.name for path in build.extra_build_dependencies]
    assert sorted(names) == [
        "colour_of_w.h", "fast_math.h", "footprint_lookup.h", "point_lookup.h", "quadratic_spline.h", "ring_sum.h",
        "simd.h",
    ]  # fmt: skip


def test_each_native_function_in_python_is_one_call_of_a_header_function():
    snippets = [text(node.args[0]) for path in MODULES for node in calls(path, "func_native")]
    assert len(snippets) > 10
    for snippet in snippets:
        assert re.fullmatch(r"(return )?warpdiff::(\w+)(<[\w, ]+>)?\(.*\);", snippet, re.DOTALL), snippet
        assert snippet.count("warpdiff::") == snippet.count(";") == 1, snippet
        name = re.search(r"warpdiff::(\w+)", snippet)[1]
        assert any(re.search(rf"\b{name}\(", header.read_text(encoding="utf-8")) for header in HEADERS), name


@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler on this machine")
def test_headers_compile_with_a_plain_compiler(tmp_path):
    source = tmp_path / "all.cpp"
    includes = ["builtin.h", *(path.name for path in HEADERS)]
    source.write_text("#define WP_NO_CRT\n" + "".join(f'#include "{name}"\n' for name in includes), encoding="utf-8")
    folders = ["-isystem", Path(wp.__file__).parent / "native", "-I", compile_options.NATIVE]
    flags = ["-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-Wno-unknown-pragmas"]
    done = subprocess.run([COMPILER, *flags, *folders, source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
