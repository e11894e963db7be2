"""Faults for mutation testing: one-token changes of Python sources, and two faults per C++ header, listed in a file.

Mutation testing makes one small change in the program at a time, and checks whether the tests detect the change.
"""

from __future__ import annotations

import ast
import hashlib
import io
import keyword
import re
import tokenize
from collections import Counter
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

# Packages whose sources are mutated, and their folders below the root of a checkout.
PACKAGES = {
    "optics": "warpdiff/optics", "diffraction": "warpdiff/diffraction", "evaluate": "warpdiff/evaluate",
    "planner": "warpdiff/planner", "kernels": "kernels",
}  # fmt: skip
NATIVE = "kernels/native"

# Replacements of tokens of source code that make a fault, old to new. If a token has several replacements, a hash of
# the line with the token selects one. Names of functions are replaced only where the function is called.
PAIRS = (
    "min max", "minimum maximum", "argmin argmax", "any all", "sin cos", "floor ceil", "== !=", "and or", "True False",
    "+ -", "* /", "& |", "<< >>", "+= -=", "*= /=", "|= &=", "break continue",
)  # fmt: skip
TOKENS = {old: (new,) for pair in PAIRS for old, new in (pair.split(), pair.split()[::-1])} | {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"), "is": ("is not",), "is not": ("is",),
    "not": ("",), "~": ("",), "//": ("/",), "%": ("*",), "**": ("*",),
}  # fmt: skip
# Functions whose calls get no faults, because these calls only make messages or types, or set options of the compiler.
# Tests need not detect a fault in such a call.
UNTOUCHED = {"warn", "ref", "repr", "isinstance", "set_module_options", "options"}

# File that lists the faults of headers, one per line: the name of a header, a colon, and a text that contains
# «old|new». A fault replaces the text «old» by the text «new». The whole text with «old» in it occurs exactly once in
# the header.
FAULTS = Path(__file__).with_name("header_faults.txt")


@dataclass(frozen=True)
class Mutant:
    """One fault for mutation testing: a change at one place of a source file.

    Attributes:
        package: Package of the file, or ``"native"`` for a header.
        path: Path of the file below the root of the checkout.
        begin: Index of the first byte that is replaced.
        old: Text that is replaced.
        new: Replacement text.
        line: Line number of the change.
        names: Function, method, class or variables whose definition contains the changed line; for a header, the name
            of its file.
        identity: Text by which the same change is recognised in other commits. It contains no path and no line number.
    """

    package: str
    path: str
    begin: int
    old: str
    new: str
    line: int
    names: tuple[str, ...]
    identity: str

    def apply(self, source: bytes) -> bytes:
        """Apply the change to the unchanged source of the file, and return the result."""
        return source[: self.begin] + self.new.encode() + source[self.begin + len(self.old.encode()) :]


def definitions(tree: ast.Module) -> Iterator[tuple[tuple[str, ...], ast.stmt]]:
    """Return the top-level statements of a module, and the methods of its classes, with the names that each defines."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield (node.name,), node
            methods = node.body if isinstance(node, ast.ClassDef) else []
            yield from (((f"{node.name}.{m.name}",), m) for m in methods if isinstance(m, ast.FunctionDef))
        else:
            names = [part for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)]
            yield tuple(part.id for part in names), node


def _skipped(node: ast.AST) -> list[ast.AST | None]:
    """Return the parts of a syntax node that are never changed: annotations, decorators, messages and imports."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return [*node.decorator_list, getattr(node, "returns", None)]
    if isinstance(node, (ast.arg, ast.AnnAssign)):
        return [node.annotation]
    name = ast.unparse(node.func).rpartition(".")[2] if isinstance(node, ast.Call) else ""
    is_message = name in UNTOUCHED or name.endswith(("Error", "Warning"))
    is_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    is_strict = isinstance(node, ast.keyword) and node.arg == "strict"
    is_other = isinstance(node, (ast.Raise, ast.Import, ast.ImportFrom))
    return [node] if is_message or is_types or is_strict or is_other else []


def _token_changes(text: str, starts: list[int]) -> Iterator[tuple[int, str, str]]:
    """Return byte position, old text and new text of each possible token change.

    ``starts`` are the byte positions at which the lines of ``text`` begin.
    """
    types = {tokenize.OP, tokenize.NAME, tokenize.NUMBER, tokenize.STRING}
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type in types]
    for before, token, after in zip(tokens, tokens[1:], tokens[2:], strict=False):
        row, column = token.start
        old = "is not" if (token.string, after.string) == ("is", "not") else token.string
        choices = TOKENS.get(old, ())
        is_keyword = keyword.iskeyword(before.string) and before.string not in {"True", "False", "None"}
        is_unary = is_keyword or (before.type == tokenize.OP and before.string not in {")", "]", "}"})
        if token.type == tokenize.NUMBER:
            choices = (changed_number(ast.literal_eval(old)),)
        elif old.isidentifier() and not keyword.iskeyword(old):
            choices *= after.string == "("
        elif old == "not" and (before.string == "is" or after.string == "in"):
            choices = ()
        elif token.type == tokenize.OP and is_unary:
            choices = ("",) * (old in {"-", "~"})
        elif old in {"+", "*", "%"} and tokenize.STRING in {before.type, after.type}:
            choices = ()
        if choices:
            digest = hashlib.sha256(f"{token.line.strip()}{column}".encode()).digest()
            begin = starts[row - 1] + len(token.line[:column].encode())
            yield begin, old, choices[digest[0] % len(choices)]


def changed_number(value: complex) -> str:
    """Return a changed number: integers 0 and 1 are swapped, larger integers increase by 1, floats by 10 %."""
    if isinstance(value, int):
        return str(value + 1 if value > 1 else 1 - value)
    return repr(type(value)(f"{value * 1.1 if value else 1.0:.6g}"))


def mutants_of(root: Path, package: str) -> Iterator[Mutant]:
    """Return all possible one-token changes of a package's Python files."""
    counts: Counter[str] = Counter()
    for path in sorted((root / PACKAGES[package]).glob("*.py")):
        source = path.read_bytes()
        tree, lines = ast.parse(source), source.decode().splitlines()
        starts = [0, *accumulate(len(line) for line in source.splitlines(keepends=True))]
        skipped = [_span(part, starts) for node in ast.walk(tree) for part in _skipped(node) if part]
        names: dict[int, tuple[str, ...]] = {}
        for defined, part in definitions(tree):
            names |= dict.fromkeys(range(part.lineno, part.end_lineno + 1), defined)
        for begin, old, new in _token_changes(source.decode(), starts):
            if not any(first <= begin < last for first, last in skipped):
                line = source.count(b"\n", 0, begin) + 1
                identity = "|".join((package, *names[line], lines[line - 1].strip(), old, new))
                counts[identity] += 1
                place = package, path.relative_to(root).as_posix(), begin
                yield Mutant(*place, old, new, line, names[line], f"{identity}|{counts[identity]}")


def _span(node: ast.AST, starts: list[int]) -> tuple[int, int]:
    """Return the byte range of a syntax node: positions of its first byte and of the byte after its last byte."""
    return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset


def header_mutants(root: Path) -> Iterator[Mutant]:
    """Return the faults of the C++ headers that the file lists. Each listed text must occur once in its header."""
    for fault in FAULTS.read_text(encoding="utf-8").splitlines():
        header, _, text = fault.partition(": ")
        before, old, new, after = re.split("[«|»]", text)
        parts = (root / NATIVE / header).read_text(encoding="utf-8").split(before + old + after)
        if len(parts) != 2:
            raise ValueError(f"{fault!r} must describe one place, and describes {len(parts) - 1}")
        source = parts[0] + before
        place = "native", f"{NATIVE}/{header}", len(source.encode()), old, new, source.count("\n") + 1
        yield Mutant(*place, (header,), f"native|{fault}")


def draw(root: Path, seed: str, packages: Iterable[str] = PACKAGES) -> list[Mutant]:
    """Return all possible changes of some packages in random order, so that the first n are a random sample.

    The changes are sorted by a hash of the seed and of the text ``identity``, which recognises a change in other
    commits. With the same seed, a change that exists in two commits has the same hash in both, so that samples of two
    commits contain mostly the same changes.
    """
    mutants = (mutant for package in packages for mutant in mutants_of(root, package))
    return sorted(mutants, key=lambda mutant: hashlib.sha256((seed + mutant.identity).encode()).digest())
