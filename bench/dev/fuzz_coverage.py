"""Coverage of the library's blocks of source code for fuzzing: its modules are compiled with a counter in each block.

A counter is much cheaper than ``sys.settrace``, which calls a function for each line, and it does not need
``sys.monitoring`` of Python 3.12.
"""

from __future__ import annotations

import ast
import builtins
import sys
from array import array
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from types import CodeType, ModuleType

# Largest number of blocks of source code whose executions can be counted. The library has about a sixth of this number.
_MOST_BLOCKS = 1 << 16
# Number of executions of each block of source code since the last reset. The two variables share their memory: compiled
# modules increase the elements of the first, and the second is a NumPy array.
_counters = array("I", bytes(4 * _MOST_BLOCKS))
_counts = np.frombuffer(_counters, np.uint32)
# Bit for the number of executions of a block by one file. Numbers in the same range have the same bit. The ranges are
# 1, 2, 3, 4 to 7, 8 to 15, and so on up to 128 and more.
_BITS = np.array([0, 1, 2, *(1 << min(n.bit_length(), 8) for n in range(3, 256))], np.uint16)
_NAME = "fuzz_counters"


class Coverage:
    """Executed blocks of source code, each with the ranges of numbers of executions by one file, such as 4 to 7."""

    def __init__(self) -> None:
        self._bits = np.zeros(_MOST_BLOCKS, np.uint16)

    def __len__(self) -> int:
        return int(np.count_nonzero(self._bits))

    @staticmethod
    def reset() -> None:
        """Set the counters of executions of all code blocks to zero."""
        _counts[: _Loader.blocks] = 0

    def adds(self) -> bool:
        """Add the code blocks that were executed since the last reset.

        Return whether one of them is new, or its number of executions is in a new range.
        """
        executed = np.flatnonzero(_counts[: _Loader.blocks])
        bits = _BITS[np.minimum(_counts[executed], 255)]
        known = self._bits[executed]
        self._bits[executed] = known | bits
        return bool((bits & ~known).any())


class _Loader(SourceFileLoader):
    """Import loader that compiles a module with counters of executed code blocks, and uses no stored bytecode.

    Attributes:
        blocks: Number of blocks in all compiled modules.
    """

    blocks = 0

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path))
        for node in list(ast.walk(tree)):
            for name in () if isinstance(node, (ast.Module, ast.ClassDef)) else ("body", "orelse", "finalbody"):
                block = getattr(node, name, None)
                if isinstance(block, list):
                    setattr(node, name, list(_with_counters(block)))
        return compile(tree, path, "exec", dont_inherit=True)


def _with_counters(block: list[ast.stmt]) -> Iterable[ast.stmt]:
    """Yield the statements of a block, with a counter at its start and after each statement with inner blocks."""
    is_start = True
    for statement in block:
        is_text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
        if is_start and not is_text:
            counter = ast.parse(f"{_NAME}[{_Loader.blocks}] += 1").body[0]
            for node in ast.walk(counter):
                ast.copy_location(node, statement)
            yield counter
            _Loader.blocks += 1
        yield statement
        is_start = hasattr(statement, "body") or (is_start and is_text)


class _Finder:
    """Import finder that gives the modules of the library the loader with counters of executed code blocks."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the module's specification with the loader, or None for modules of other packages."""
        if name.partition(".")[0] != "warpdiff":
            return None
        specification = PathFinder.find_spec(name, path, target)
        if specification is not None and isinstance(specification.loader, SourceFileLoader):
            specification.loader = _Loader(name, specification.loader.path)
        return specification


def install() -> None:
    """Let imported modules of the library be compiled with counters of code blocks. Call this before their import."""
    vars(builtins)[_NAME] = _counters
    finder: Any = _Finder
    sys.meta_path.insert(0, finder)
