"""The graph of imports, read from the syntax trees: for the rule of imports, and for ``docs/architecture.md``.

``python tests/import_graph.py --write`` makes the parts of that page anew that are made from the code.
"""

from __future__ import annotations

import ast
import functools
import re
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
# Where the package's parts lie in a checkout.
FOLDERS = {"warpdiff": "warpdiff", "warpdiff.kernels": "kernels"}


class Import(NamedTuple):
    """One module that another one imports: at its ``"top"``, in a ``"function"``, or for ``"types"`` alone."""

    module: str
    where: str
    line: int


@functools.cache
def modules() -> dict[str, Path]:
    """Files of the package by their dotted names; a folder's own name is its ``__init__``."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            names = path.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join((package, *names)).removesuffix(".__init__")] = path
    return found


@functools.cache
def imports(name: str) -> tuple[Import, ...]:
    """Everything that a module imports; of the package, whole modules rather than names in them."""
    found = []

    def walk(node: ast.AST, where: str) -> None:
        for child in ast.iter_child_nodes(node):
            inner = where
            if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
                inner = "function"
            elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                inner = "types"
            if isinstance(child, ast.Import):
                found.extend(Import(each.name, where, child.lineno) for each in child.names)
            elif isinstance(child, ast.ImportFrom):
                whole = [f"{child.module}.{each.name}" for each in child.names]
                of = {each if each in modules() else str(child.module) for each in whole}
                found.extend(Import(each, where, child.lineno) for each in sorted(of))
            walk(child, inner)

    walk(ast.parse(modules()[name].read_text(encoding="utf-8")), "top")
    return tuple(found)


def room_of(name: str) -> str:
    """The room of a module of the package; ``"the public names"`` for what lies above all rooms."""
    parts = name.split(".")
    if len(parts) > 1 and (parts[1] in rooms() or f"warpdiff.{parts[1]}" in FOLDERS):
        return parts[1]
    return "the public names"


@functools.cache
def rooms() -> tuple[str, ...]:
    """Folders of warpdiff/ that hold modules."""
    return tuple(
        sorted(path.parent.name for path in (ROOT / "warpdiff").glob("*/__init__.py") if not path.parent.is_symlink())
    )


class Room(NamedTuple):
    """What a room's docstring says: what it is, what comes in, what goes out, and whom it may import."""

    summary: str
    taken: str
    given: str
    may_import: tuple[str, ...]


@functools.cache
def room(name: str) -> Room:
    """A room by its docstring."""
    text = ast.get_docstring(ast.parse(modules()[f"warpdiff.{name}"].read_text(encoding="utf-8"))) or ""
    found = re.fullmatch(r"(.+?)\n\nIn: (.+?)\nOut: (.+?)\nMay import: (.+?)\.", text, re.DOTALL)
    if not found:
        raise ValueError(
            f"warpdiff/{name}/__init__.py: a summary, In:, Out: and May import: are expected, got {text!r}"
        )
    summary, taken, given, may_import = (" ".join(each.split()) for each in found.groups())
    return Room(summary, taken, given, () if may_import == "nothing" else tuple(may_import.split(", ")))


def closure(name: str) -> set[str]:
    """Modules that importing one imports, packages above them included."""
    found: set[str] = set()
    left = [name]
    while left:
        each = left.pop()
        if each in found:
            continue
        found.add(each)
        if each in modules():
            above = each.rpartition(".")[0]
            left += [above] if above else []
            left += [given.module for given in imports(each) if given.where == "top"]
    return found


def edges() -> dict[str, set[str]]:
    """Rooms that rooms import, for types, too: the kernels as one, and neither public names nor measurements."""
    nodes = {*rooms(), "kernels"}
    found: dict[str, set[str]] = {each: set() for each in sorted(nodes)}
    for name in modules():
        here = room_of(name)
        if here in nodes:
            there = {room_of(each.module) for each in imports(name) if each.module in modules()}
            found[here] |= (there & nodes) - {here}
    return found


def order(given: dict[str, set[str]]) -> list[str]:
    """Nodes such that each comes after those that it imports; raises ValueError where there is a circle."""
    done: list[str] = []
    while len(done) < len(given):
        ready = sorted(each for each in given if each not in done and given[each] <= set(done))
        if not ready:
            raise ValueError(f"these import each other in a circle: {sorted(set(given) - set(done))}")
        done += ready
    return done


def drawing() -> str:
    """The way of the data: who takes what others make, as far as it does not follow from the other arrows."""
    given = edges()

    def reached(name: str) -> set[str]:
        return given[name] | {far for near in given[name] for far in reached(near)}

    lines = ["```mermaid", "flowchart TD"]
    for name in order(given):
        text = "Warp kernels" if name == "kernels" else room(name).given.rstrip(".").replace("``", "")
        lines.append(f'    {name}["<b>{name}</b><br>{text}"]')
    for name in order(given):
        near = given[name] - {far for each in given[name] for far in reached(each)}
        lines += [f"    {each} --> {name}" for each in sorted(near)]
    return "\n".join([*lines, "```"])


def plan_of_the_house() -> str:
    """Each room with its files, by the first lines of their docstrings."""
    blocks = []
    for name in [*(each for each in order(edges()) if each != "kernels"), "kernels"]:
        if name == "kernels":
            head = "**kernels/** Warp kernels and their native parts. May import: kernels."
        else:
            said = room(name)
            allowed = ", ".join(said.may_import) or "nothing"
            head = f"**{name}/** {said.summary} In: {said.taken} Out: {said.given} May import: {allowed}."
        package = f"warpdiff.{name}."
        files = [
            f"- `{each.removeprefix(package)}`: {first_line(each)}" for each in modules() if each.startswith(package)
        ]
        blocks.append("\n".join([head, "", *files]))
    native = [f"- `{path.name}`: {first_sentence(path)}" for path in sorted((ROOT / "kernels" / "native").glob("*.h"))]
    blocks.append("\n".join(["**kernels/native/** C++ that kernels call, an algorithm each.", "", *native]))
    return "\n\n".join(blocks)


def first_sentence(path: Path) -> str:
    """The first sentence of a header's first comment."""
    text = path.read_text(encoding="utf-8").partition("\n\n")[0].partition("\n//\n")[0]
    comment = text.replace("\n// ", " ").removeprefix("// ")
    return re.split(r"(?<=[.:]) ", comment)[0].rstrip(":.") + "."


def first_line(name: str) -> str:
    """The first line of a module's docstring."""
    return (ast.get_docstring(ast.parse(modules()[name].read_text(encoding="utf-8"))) or "").partition("\n")[0]


def page() -> str:
    """The page with its made parts as they are to be."""
    text = PAGE.read_text(encoding="utf-8")
    for mark, made in (("drawing", drawing()), ("house", plan_of_the_house())):
        begin, end = f"<!-- {mark}, made by tests/import_graph.py -->", f"<!-- end of {mark} -->"
        if text.count(begin) != 1 or text.count(end) != 1:
            raise ValueError(f"{PAGE.name} must hold {begin!r} and {end!r} once each")
        head, _, rest = text.partition(begin)
        text = f"{head}{begin}\n{made}\n{end}{rest.partition(end)[2]}"
    return text


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit(__doc__)
    PAGE.write_text(page(), encoding="utf-8")
