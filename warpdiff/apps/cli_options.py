"""Flags of the command line, made from the descriptions of options; a flag is the Python name with dashes."""

from __future__ import annotations

import argparse
import itertools
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from warpdiff.core.options import REQUIRED
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from warpdiff.core.options import Option


def integer(text: str) -> int:
    """Return the integer of a text."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be an integer, got {text!r}") from None


def number(text: str) -> float:
    """Return the number of a text."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}") from None


def lengths(text: str) -> list[float]:
    """Return the numbers of a text such as ``0.3x0.15``, ``0.3,0.15`` or ``0.3``."""
    return [number(part) for part in re.split(r"[x×,]", text)]


_TYPES: dict[str, Callable[[str], Any]] = {
    "integer": integer, "integers": integer, "number": number, "numbers": number, "pair": lengths,
}  # fmt: skip
_METAVARS = {"number": "X", "integer": "N", "text": "TEXT", "choice": "NAME", "choices": "NAME", "object": "VALUE"}


# Arrays of which the command line takes three numbers.
VECTORS = ("tangents", "background")
# Flags of a coherence that are not the argument's name with dashes.
COHERENCE_FLAGS = {"kind": "--coherence", "angular_diameter_deg": "--source-diameter-deg"}
# Methods of a height field, with the flags that call them and the argument that a flag gives.
CLEANING = {
    "cropped": ("--crop-um", "size_um"), "levelled": ("--level", "order"), "despiked": ("--despike", None),
    "filled": ("--fill", None), "periodic": ("--periodic", None),
}  # fmt: skip


class Flags:
    """The flags of one command, and what its messages call each argument.

    Attributes:
        parser: The command's parser.
        words: The command line's words by the names of arguments in Python.
    """

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser
        self.words: dict[str, str] = {}
        self._stored: set[str] = set()

    def group(self, title: str) -> Any:
        """Return a group of flags with a title in the help."""
        return self.parser.add_argument_group(title)

    def add(
        self, group: Any, options: Mapping[str, Option], *, only: Iterable[str] | None = None,
        names: Mapping[str, str] | None = None, defaults: Mapping[str, Any] | None = None, prefix: str = "",
    ) -> None:  # fmt: skip
        """Add a flag for each option.

        Args:
            group: Group of the help that lists them.
            options: Options by name.
            only: Names of those that get a flag; None is all that a flag can express.
            names: Flags that differ from the name in Python.
            defaults: Defaults of the command that differ from the library's.
            prefix: Beginning of the flags' names and of the attributes that values are stored in.
        """
        stored = prefix.replace("-", "_")
        chosen = [
            option for option in options.values() if (option.kind != "object" if only is None else option.name in only)
        ]
        # The help of one option may mention another one.
        for option in chosen:
            negation = "no-" if option.kind == "flag" and option.default is True else ""
            flag = (names or {}).get(option.name) or f"--{negation}{prefix}{option.dashed}"
            self.words[f"{stored}{option.name}"] = flag
        for option in chosen:
            default = (defaults or {}).get(option.name, option.default)
            self._stored.add(f"{stored}{option.name}")
            how: dict[str, Any] = {"dest": f"{stored}{option.name}", "default": argparse.SUPPRESS}
            if option.kind == "flag" and option.optional:
                how["action"] = argparse.BooleanOptionalAction
            elif option.kind == "flag":
                how |= {"action": "store_const", "const": option.default is not True}
            else:
                how |= {"required": default is REQUIRED, **_shape(option)}
            how["help"] = help_text(option, default, self.words)
            group.add_argument(self.words[how["dest"]], **how)

    def finish(self, **words: str) -> None:
        """Store the words with what is parsed; further words are by Python's names."""
        self.parser.set_defaults(words=self.words | words, stored=frozenset(self._stored))


def _shape(option: Option) -> dict[str, Any]:
    """Return type, number and placeholder of the values of a flag."""
    if option.name in VECTORS:
        return {"type": number, "nargs": 3, "metavar": ("X", "Y", "Z")}
    kind = integer if isinstance((option.choices or [""])[0], int) else _TYPES.get(option.kind, str)
    placeholder: Any = _METAVARS.get(option.kind, "X")
    if option.kind not in ("numbers", "integers", "pair", "choices"):
        return {"type": kind, "metavar": placeholder}
    length = 2 if option.kind == "pair" else option.length
    placeholder = {2: ("Y", "X"), 3: ("X", "Y", "Z")}.get(length, placeholder)
    return {"type": kind, "metavar": placeholder, "nargs": option.length or "+"}


def help_text(option: Option, default: Any, words: Mapping[str, str]) -> str:
    """Return the meaning, the range or choices, and the default of an option, in the command line's words."""

    def code(match: re.Match[str]) -> str:
        name, equals, value = match[1].partition("=")
        if name == "math.inf":
            return "inf"
        return word(name, value if equals else None, words) if name in words else match[1]

    text = re.sub(r":\w+:`~?([^`]*)`", r"\1()", option.help)
    text = re.sub(r"``([^`]*)``", code, text)
    text = re.sub(r"(?<![\w.])None (?:is|are) ", "without it: ", text).replace("Whether ", "", 1)
    if option.kind == "flag" and option.default is True:
        text = f"turn off: {text}"
    facts = [", ".join(map(str, option.choices)), option.range]
    if option.kind != "flag" and default is not None and default is not REQUIRED:
        facts.append(f"default: {' '.join(map(str, default)) if isinstance(default, (tuple, list)) else default}")
    facts = [fact for fact in facts if fact]
    # argparse reads % as the beginning of a format.
    return (f"{text} ({'; '.join(facts)})" if facts else text).replace("%", "%%")


def given(options: argparse.Namespace, described: Mapping[str, Option], prefix: str = "") -> dict[str, Any]:
    """Return the arguments that flags gave, by name, in Python's types; raise an error that names a wrong one."""
    values = vars(options)
    result = {}
    for option in described.values():
        key = f"{prefix.replace('-', '_')}{option.name}"
        if key in values and key in options.stored:
            value = values[key]
            if option.kind == "pair":
                value = list(itertools.chain.from_iterable(value))
                if len(value) > 2:
                    raise ArgumentValueError(f"{ref(key)} must be one number or two, got {len(value)}")
                value = value[0] if len(value) == 1 else tuple(value)
            value = tuple(value) if isinstance(value, list) else value
            result[option.name] = replace(option, name=key).check(value)
    return result


def word(name: str, value: str | None, words: Mapping[str, str]) -> str:
    """Write an argument as the command line does: ``--tolerance``, or ``--method auto``."""
    first, last = re.split(r"[\[.]", name, maxsplit=1)[0], name.rpartition(".")[2]
    flag = words.get(name) or words.get(last) or words.get(first, first)
    if value is None:
        return flag
    if value in ("True", "False"):
        positive = flag.replace("--no-", "--", 1)
        return positive if value == "True" else positive.replace("--", "--no-", 1)
    shown = value.strip("'").strip("()").replace(",", "") if value.startswith(("'", "(")) else value
    return f"{flag} {shown}" if flag.startswith("--") else f"{flag}={value}"
