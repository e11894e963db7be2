"""One-token changes of Python sources and of C++ headers, and their draw for a mutation run."""

from __future__ import annotations

import ast
import hashlib
import io
import keyword
import marshal
import tokenize
from collections import Counter
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

from bench.dev.header_faults import FAULTS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

# Strata of the draw: package, and its folder below the root of a checkout.
PACKAGES = {
    "optics": "warpdiff/optics", "diffraction": "warpdiff/diffraction", "evaluate": "warpdiff/evaluate",
    "planner": "warpdiff/planner", "kernels": "kernels",
}  # fmt: skip
NATIVE = "kernels/native"

# Tokens, old to new; a hash selects one of several.
TOKENS = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"), "==": ("!=",), "!=": ("==",),
    "is": ("is not",), "is not": ("is",), "and": ("or",), "or": ("and",), "not": ("",), "~": ("",), "True": ("False",),
    "False": ("True",), "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",), "//": ("/",), "%": ("*",), "**": ("*",),
    "&": ("|",), "|": ("&",), "<<": (">>",), ">>": ("<<",), "+=": ("-=",), "-=": ("+=",), "*=": ("/=",),
    "/=": ("*=",), "|=": ("&=",), "&=": ("|=",), "break": ("continue",), "continue": ("break",),
}  # fmt: skip
FUNCTIONS = {
    old: new
    for pair in ("min max", "minimum maximum", "argmin argmax", "any all", "sin cos", "floor ceil")
    for old, new in (pair.split(), pair.split()[::-1])
}
# Calls without targets: messages, names in messages, types, and options of the compiler.
UNTOUCHED = {"warn", "ref", "repr", "isinstance", "set_module_options", "options"}
# Calls whose first two arguments may change places.
UNORDERED = {"min", "max", "minimum", "maximum", "hypot", "zip", "allclose", "isclose", "dot", "gcd", "lcm", "cw_mul"}

# Line, from 1, and byte in it.
Place = tuple[int, int]


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Attributes:
        package: Stratum of the draw, or ``"native"`` for a header.
        path: File below the root of the checkout.
        begin: First byte that is replaced.
        old: Text that is replaced.
        new: Text in its place.
        line: Line of the change.
        lines: Lines of the statement that is changed.
        definition: Innermost function or class around it, or the variable that it defines; of a header its name.
        at_import: Whether the code runs when the module is imported.
        identity: Text that names the change on other commits, too: it has no line number.
    """

    package: str
    path: str
    begin: int
    old: str
    new: str
    line: int
    lines: range
    definition: str
    at_import: bool
    identity: str

    @property
    def key(self) -> str:
        """Name of the change in files of results."""
        return hashlib.sha256(self.identity.encode()).hexdigest()[:16]

    def apply(self, source: bytes) -> bytes:
        """Return the source with the change."""
        end = self.begin + len(self.old.encode())
        if source[self.begin : end] != self.old.encode():
            raise ValueError(f"{self.path}: byte {self.begin} does not begin {self.old!r}")
        return source[: self.begin] + self.new.encode() + source[end:]

    def is_equivalent(self, source: bytes) -> bool:
        """Return whether the changed source compiles to the same code."""
        return self.path.endswith(".py") and _code(source) == _code(self.apply(source))


def _code(source: bytes) -> bytes:
    """Byte code of a module without docstrings and places in the file."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if hasattr(node, "lineno"):
            node.lineno, node.col_offset, node.end_lineno, node.end_col_offset = 1, 0, 1, 0
    return marshal.dumps(compile(tree, "", "exec", optimize=2))


def _begin(node: ast.AST) -> Place:
    return node.lineno, node.col_offset


def _end(node: ast.AST) -> Place:
    return node.end_lineno, node.end_col_offset


def _skipped(node: ast.AST) -> list[ast.AST | None]:
    """Parts of a node that are no targets: annotations, decorators, messages, imports for type checkers."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return [*node.decorator_list, getattr(node, "returns", None)]
    if isinstance(node, (ast.arg, ast.AnnAssign)):
        return [node.annotation]
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return [node]
    if isinstance(node, ast.Call):
        name = ast.unparse(node.func).rpartition(".")[2]
        return [node] if name in UNTOUCHED or name.endswith(("Error", "Warning")) else []
    is_imports = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    return [node] if is_imports or isinstance(node, (ast.Raise, ast.Import, ast.ImportFrom)) else []


def _token_changes(text: str, indices: set[Place]) -> Iterator[tuple[Place, str, str]]:
    """Place, old and new text of changed tokens."""
    lines = text.splitlines()
    types = {tokenize.OP, tokenize.NAME, tokenize.NUMBER, tokenize.STRING}
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type in types]
    for before, token, after in zip(tokens, tokens[1:], tokens[2:], strict=False):
        line = lines[token.start[0] - 1]
        place = token.start[0], len(line[: token.start[1]].encode())
        old = "is not" if (token.string, after.string) == ("is", "not") else token.string
        is_keyword = keyword.iskeyword(before.string) and before.string not in {"True", "False", "None"}
        is_unary = is_keyword or (before.type == tokenize.OP and before.string not in {")", "]", "}"})
        if token.type == tokenize.NUMBER:
            yield place, old, changed_number(ast.literal_eval(old), is_index=place in indices)
        elif old in FUNCTIONS and after.string == "(":
            yield place, old, FUNCTIONS[old]
        elif old == "not" and (before.string == "is" or after.string == "in"):
            continue
        elif old in TOKENS and not (old in {"+", "*", "%"} and tokenize.STRING in {before.type, after.type}):
            choices = TOKENS[old] if not is_unary or old[0].isalpha() or old == "~" else ("",) * (old == "-")
            if choices:
                digest = hashlib.sha256(f"{line.strip()}{place[1]}".encode()).digest()
                yield place, old, choices[digest[0] % len(choices)]


def _swap(node: ast.AST, source: bytes, starts: list[int]) -> tuple[Place, str, str] | None:
    """The first two arguments of a call in the other order, if they are of one kind."""
    if not isinstance(node, ast.Call) or len(node.args) < 2 or type(node.args[0]) is not type(node.args[1]):
        return None
    first, second = node.args[:2]
    if ast.unparse(node.func).rpartition(".")[2] in UNORDERED or isinstance(first, (ast.Starred, ast.Constant)):
        return None
    places = [starts[line - 1] + column for line, column in (_begin(first), _end(first), _begin(second), _end(second))]
    a, between, b = (source[i:j].decode() for i, j in pairwise(places))
    return (_begin(first), a + between + b, b + between + a) if a != b else None


def changed_number(value: complex, *, is_index: bool = False) -> str:
    """Return another number of the same type: the next integer or a neighbouring index, or 1.1 times a float."""
    if isinstance(value, int):
        return str(int(not value) if is_index else value + 1)
    return repr(type(value)(f"{value * 1.1 if value else 1.0:.6g}"))


def mutants_of(root: Path, package: str) -> list[Mutant]:
    """Return all changes of a package's Python files."""
    result: list[Mutant] = []
    counts: Counter[str] = Counter()
    for path in sorted((root / PACKAGES[package]).glob("*.py")):
        source = path.read_bytes()
        lines = source.decode().splitlines()
        starts = [0, *accumulate(len(line) for line in source.splitlines(keepends=True))]
        tree = ast.parse(source)
        nodes = list(ast.walk(tree))
        statements, definitions, in_functions = {}, {}, set()
        # Outer nodes come before inner ones.
        for node in nodes:
            if isinstance(node, ast.stmt):
                body = getattr(node, "body", None)
                end = max(body[0].lineno - 1, node.lineno) if body else node.end_lineno
                statement = range(node.lineno, end + 1)
                statements |= dict.fromkeys(statement, statement)
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            if node in tree.body and isinstance(target, ast.Name):
                definitions |= dict.fromkeys(statement, target.id)
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                definitions |= dict.fromkeys(range(node.lineno, node.end_lineno + 1), node.name)
            if isinstance(node, ast.FunctionDef):
                in_functions.update(range(node.body[0].lineno, node.end_lineno + 1))
        holders = [node.slice for node in nodes if isinstance(node, ast.Subscript)]
        holders += [node.value for node in nodes if isinstance(node, ast.keyword) and node.arg == "axis"]
        indices = {_begin(part) for node in holders for part in ast.walk(node) if isinstance(part, ast.Constant)}
        skipped = [(_begin(part), _end(part)) for node in nodes for part in _skipped(node) if part]
        swaps = [swap for node in nodes if (swap := _swap(node, source, starts))]
        for (line, column), old, new in (*_token_changes(source.decode(), indices), *swaps):
            if any(begin <= (line, column) < end for begin, end in skipped):
                continue
            text = f"{package}|{definitions.get(line, '')}|{lines[line - 1].strip()}|{old}|{new}"
            counts[text] += 1
            result.append(
                Mutant(
                    package, path.relative_to(root).as_posix(), starts[line - 1] + column, old, new, line,
                    statements[line], definitions.get(line, ""), line not in in_functions, f"{text}|{counts[text]}",
                )
            )  # fmt: skip
    return result


def code_lines(root: Path, package: str) -> int:
    """Return the number of lines of a package that are neither blank nor comments nor docstrings."""
    total = 0
    for path in (root / PACKAGES[package]).glob("*.py"):
        text = path.read_text(encoding="utf-8")
        nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Expr)]
        texts = {
            n for node in nodes if isinstance(node.value, ast.Constant) for n in range(node.lineno, node.end_lineno + 1)
        }
        lines = enumerate(text.splitlines(), 1)
        total += sum(bool(line.strip()) and not line.lstrip().startswith("#") and n not in texts for n, line in lines)
    return total


def draw(root: Path, seed: str, count: int) -> list[Mutant]:
    """Draw changes of all packages, each package's share by its code lines, in an order in which any part is fair.

    A change has the same place in the order on another commit that has it, so that draws of one seed are comparable.
    """
    sizes = [code_lines(root, package) for package in PACKAGES]
    # Rounded sums, so that shares add up to the count.
    ends = [0, *(round(count * size / sum(sizes)) for size in accumulate(sizes))]
    ranked = []
    for package, begin, end in zip(PACKAGES, ends, ends[1:], strict=False):
        order = sorted(
            mutants_of(root, package), key=lambda mutant: hashlib.sha256((seed + mutant.identity).encode()).digest()
        )
        ranked += [((rank + 0.5) / (end - begin), mutant) for rank, mutant in enumerate(order[: end - begin])]
    return [mutant for _, mutant in sorted(ranked, key=lambda pair: pair[0])]


def header_mutants(root: Path) -> Iterator[Mutant]:
    """Return the hand-made faults of the C++ headers; the old text must occur exactly once."""
    for header, old, new in FAULTS:
        source = (root / NATIVE / header).read_bytes()
        if source.count(old.encode()) != 1:
            raise ValueError(f"{header}: {old!r} occurs {source.count(old.encode())} times, not once")
        begin = source.index(old.encode())
        line = source.count(b"\n", 0, begin) + 1
        identity = f"native|{header}|{old}|{new}"
        yield Mutant(
            "native", f"{NATIVE}/{header}", begin, old, new, line, range(line, line + 1), header, False, identity
        )
