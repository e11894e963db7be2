"""Signatures of all public names and commands as a text, and the check that the changelog lists every change of them.

::

    python -m bench.dev.public_signatures            # compare with public_api.txt
    python -m bench.dev.public_signatures --write    # store the signatures after a change

The text has one line for each function, class, method, property, field and flag of a command. ``--write`` refuses a
change of a name that the changelog's first section does not contain, so that users learn of each change.
"""

from __future__ import annotations

import argparse
import dataclasses
import enum
import inspect
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import warpdiff as wd
from warpdiff.apps import cli

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
STORED = Path(__file__).with_name("public_api.txt")
CHANGELOG = ROOT / "CHANGELOG.md"
# Pattern of the memory address in the text of some default values of arguments, such as functions.
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")
# Methods that are part of the public interface although their names begin with an underscore.
_OPERATORS = ("__call__", "__len__", "__iter__", "__getitem__", "__add__", "__mul__")


def signatures() -> list[str]:
    """Return one line for each public function, class, method, property and field, sorted by name."""
    lines: list[str] = []
    for name in wd.__all__:
        value = getattr(wd, name)
        if inspect.ismodule(value):
            lines += [f"{name}: module", *_of_module(name, value)]
        else:
            lines += _of(name, value)
    lines += _of_commands()
    return sorted(set(lines), key=lambda line: (re.split(r"[(: ]", line)[0], line))


def _of_commands() -> Iterator[str]:
    """Yield a line for each command of the command line and for each of its flags, with the choices of the flag."""
    for name in cli._COMMANDS:
        yield f"warpdiff-{name}: command"
        commands = next(each for each in cli._parser([name])._actions if isinstance(each, argparse._SubParsersAction))
        for action in commands.choices[name]._actions:
            flag = max(action.option_strings, key=len, default=action.dest)
            choices = f" {{{', '.join(map(str, action.choices))}}}" if action.choices else ""
            yield f"warpdiff-{name}.{flag}: flag{choices}"


def _of_module(prefix: str, module: ModuleType) -> Iterator[str]:
    names = getattr(module, "__all__", None) or [
        name for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]  # fmt: skip
    for name in names:
        yield from _of(f"{prefix}.{name}", getattr(module, name))


def _of(name: str, value: object) -> Iterator[str]:
    """Yield a line with the signature of a public object, and one for each of its members."""
    if not inspect.isclass(value):
        yield f"{name}{_signature(value)}" if callable(value) else f"{name} = {_plain(repr(value))}"
        return
    bases = [base.__name__ for base in value.__bases__ if base is not object and not base.__name__.startswith("_")]
    yield f"{name}: class({', '.join(bases)})"
    if not issubclass(value, (Exception, enum.Enum)):
        yield f"{name}.__init__{_signature(value)}"
    fields = {field.name: field for field in dataclasses.fields(value)} if dataclasses.is_dataclass(value) else {}
    for member in fields:
        if not member.startswith("_"):
            yield f"{name}.{member}: field"
    for member in dir(value):
        if (member.startswith("_") and member not in _OPERATORS) or member in fields:
            continue
        static = inspect.getattr_static(value, member)
        owner = next((kind for kind in value.__mro__ if member in vars(kind)), value)
        # Members of Python's own classes, such as those of tuples and exceptions, do not belong to this package.
        if not owner.__module__.startswith("warpdiff") or (member in _OPERATORS and owner is not value):
            continue
        yield from _of_member(f"{name}.{member}", static, getattr(value, member))


def _of_member(name: str, static: object, value: object) -> Iterator[str]:
    if isinstance(static, (classmethod, staticmethod)):
        yield f"{name}{_signature(value)}: {type(static).__name__}"
    elif inspect.isfunction(static):
        yield f"{name}{_signature(static)}"
    elif isinstance(static, property) or hasattr(static, "__get__"):
        yield f"{name}: property"
    else:
        yield f"{name} = {_plain(repr(static))}"


def _signature(value: Callable[..., object]) -> str:
    """Return the names, kinds and defaults of a function's arguments as a text.

    Annotations are excluded, because their texts differ between versions of Python.
    """
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return "(...)"
    bare = [parameter.replace(annotation=inspect.Parameter.empty) for parameter in signature.parameters.values()]
    text = str(signature.replace(parameters=bare, return_annotation=inspect.Signature.empty))
    return _plain(text)


def _plain(text: str) -> str:
    return " ".join(_ADDRESS.sub("", text).split())


def changed_names(old: list[str], new: list[str]) -> list[str]:
    """Return the public names whose signatures differ between two lists of lines, sorted."""
    return sorted({re.split(r"[(: ]", line)[0] for line in set(old) ^ set(new)})


def unlisted(names: list[str], changelog: str) -> list[str]:
    """Return the changed public names that the first section of a changelog does not contain.

    A member counts as listed if the section contains its last part, such as ``load`` of ``HeightField.load``, and the
    class. A new class with all of its members is listed by its own name.
    """
    sections = re.split(r"^## ", changelog, flags=re.MULTILINE)
    words = set(re.findall(r"\w+", sections[1])) if len(sections) > 1 else set()
    result = []
    for name in names:
        parent = name.rpartition(".")[0]
        is_of_listed = parent in names and set(re.findall(r"\w+", parent)) <= words
        if not is_of_listed and not set(re.findall(r"\w+", name.removesuffix(".__init__"))) <= words:
            result.append(name)
    return result


def main() -> int:
    """Compare the signatures with the stored text, or store them. Return 1 if they differ or a change is not listed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="store the signatures")
    options = parser.parse_args()
    new = signatures()
    old = STORED.read_text(encoding="utf-8").splitlines() if STORED.is_file() else new
    names = changed_names(old, new)
    missing = unlisted(names, CHANGELOG.read_text(encoding="utf-8"))
    for name in names:
        print(f"changed: {name}{' (not in the changelog)' if name in missing else ''}")
    if missing:
        print(f"list these names in the first section of CHANGELOG.md: {', '.join(missing)}", file=sys.stderr)
        return 1
    if options.write:
        STORED.write_text("\n".join(new) + "\n", encoding="utf-8", newline="\n")
        return 0
    if names:
        print("store the signatures: python -m bench.dev.public_signatures --write", file=sys.stderr)
    return int(bool(names))


if __name__ == "__main__":
    sys.exit(main())
