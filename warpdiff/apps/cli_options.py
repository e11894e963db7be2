"""Flags of the command line, generated from the descriptions of the Python functions' options.

The name of a flag is the option's Python name with dashes instead of underscores, for example ``--delta-e``.
"""

from __future__ import annotations

import argparse
import itertools
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from warpdiff.core.options import REQUIRED
from warpdiff.core.wording import ArgumentValueError, did_you_mean, ref
from warpdiff.request.settings import TANGENT_RULES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from warpdiff.core.options import Option


def integer(text: str) -> int:
    """Convert the text after a flag to an integer. argparse shows the message if the text is wrong."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be an integer, got {text!r}") from None


def number(text: str) -> float:
    """Convert the text after a flag to a number. argparse shows the message if the text is wrong."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, got {text!r}") from None


def lengths(text: str) -> list[float]:
    """Return the numbers of a text such as ``0.3x0.15``, ``0.3,0.15`` or ``0.3``."""
    return [number(part) for part in re.split(r"[x×,]", text)]


def tangents(text: str) -> str | list[float]:
    """Return the value of ``--tangents``: the name of a rule, or the three numbers of a vector.

    In Python, the same option also accepts an array of vectors.
    """
    if text in TANGENT_RULES:
        return text
    words = text.split()
    if len(words) != 3 or not all(map(_is_number, words)):
        raise argparse.ArgumentTypeError(
            f"must be one of {', '.join(TANGENT_RULES)}, or three numbers X Y Z, got {text!r}"
            f"{did_you_mean(text, TANGENT_RULES)}"
        )
    return [float(word) for word in words]


def _is_number(text: str) -> bool:
    """Return whether a word of the command line is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


_TYPES: dict[str, Callable[[str], Any]] = {
    "integer": integer, "integers": integer, "number": number, "numbers": number, "pair": lengths,
}  # fmt: skip
_METAVARS = {"number": "X", "integer": "N", "text": "TEXT", "choice": "NAME", "choices": "NAME", "object": "VALUE"}


# Flags for those arguments of ``Coherence`` whose flag is not the argument's name with dashes.
COHERENCE_FLAGS = {"kind": "--coherence", "angular_diameter_deg": "--source-diameter-deg"}
# Cleaning methods of ``HeightField``: the flag that calls the method, and the argument that gets the flag's value.
CLEANING = {
    "cropped": ("--crop-um", "size_um"), "levelled": ("--level", "order"), "despiked": ("--despike", None),
    "filled": ("--fill", None), "periodic": ("--periodic", None),
}  # fmt: skip


class Flags:
    """Flags of one command, and the names by which its error messages refer to Python arguments.

    Attributes:
        parser: Parser of the command.
        words: Names on the command line, such as ``--tolerance``, by the arguments' names in Python.
    """

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser
        self.words: dict[str, str] = {}
        self._stored: set[str] = set()

    def group(self, title: str) -> Any:
        """Return a new group of flags; the command's help lists the flags of a group below the group's title."""
        return self.parser.add_argument_group(title)

    def add(
        self, group: Any, options: Mapping[str, Option], *, only: Iterable[str] | None = None,
        names: Mapping[str, str] | None = None, defaults: Mapping[str, Any] | None = None, prefix: str = "",
    ) -> None:  # fmt: skip
        """Add a flag to the command for each of several options of the Python functions.

        Args:
            group: Group of the help that lists the flags.
            options: Descriptions of options by name.
            only: Names of the options that get a flag; None selects all options that a flag can express.
            names: Names of flags that differ from the option's name with dashes, by option.
            defaults: Default values of the command that differ from the library's, by option.
            prefix: Prefix of the flags' names and of the attributes of the parsed arguments.
        """
        stored = prefix.replace("-", "_")
        chosen = [
            option for option in options.values() if (option.kind != "object" if only is None else option.name in only)
        ]
        # The names of all flags are stored before any help text is written, because one help text may mention another
        # flag.
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
        """Store the name of the flag of each Python argument with the parsed arguments, for error messages.

        ``words`` has the names of the flags that are not generated from descriptions of options, by Python argument.
        """
        self.parser.set_defaults(words=self.words | words, stored=frozenset(self._stored))


def _shape(option: Option) -> dict[str, Any]:
    """Return the arguments of ``add_argument`` of argparse for a flag: type, number and placeholder of its values."""
    if option.name == "tangents":
        return {"type": tangents, "metavar": "RULE or X Y Z"}
    kind = integer if isinstance((option.choices or [""])[0], int) else _TYPES.get(option.kind, str)
    placeholder: Any = _METAVARS.get(option.kind, "X")
    if option.kind not in ("numbers", "integers", "pair", "choices"):
        return {"type": kind, "metavar": placeholder}
    length = 2 if option.kind == "pair" else option.length
    placeholder = {2: ("Y", "X"), 3: ("X", "Y", "Z")}.get(length, placeholder)
    return {"type": kind, "metavar": placeholder, "nargs": option.length or "+"}


def help_text(option: Option, default: Any, words: Mapping[str, str]) -> str:
    """Return the help text of a flag: meaning, range or choices, and default. The text names options by their flags."""

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
    # argparse formats help texts with the % operator, so that a literal % must be doubled.
    return (f"{text} ({'; '.join(facts)})" if facts else text).replace("%", "%%")


def given(options: argparse.Namespace, described: Mapping[str, Option], prefix: str = "") -> dict[str, Any]:
    """Return the Python arguments that the user's flags set, by name, after a check of each value.

    Args:
        options: Parsed arguments of the command.
        described: Descriptions of the options to return, by name.
        prefix: Prefix of the flags' names.

    Raises:
        ValueError: A value is out of range; the message names its flag.
    """
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


def with_joined_vectors(arguments: Sequence[str]) -> list[str]:
    """Join flags of vectors and their values, such as ``--tangents=1 0 0``, and move them directly after the command.

    The flags are ``--tangents`` and ``--light``. Their value is either one word or several numbers. If the words were
    separate, argparse would accept a mesh file after them as another value, and would mistake ``-1e-3`` for a flag. It
    would also not accept a mesh file after a flag if the mesh file is optional.
    """
    others: list[str] = []
    joined: list[str] = []
    rest = list(arguments)
    while rest:
        argument = rest.pop(0)
        words = []
        if argument in {"--tangents", "--light"}:
            words = list(itertools.takewhile(_is_number, rest)) or [word for word in rest[:1] if word[:1] != "-"]
        if words:
            joined.append(f"{argument}={' '.join(words)}")
            del rest[: len(words)]
        else:
            others.append(argument)
    return [*others[:1], *joined, *others[1:]]


def word(name: str, value: str | None, words: Mapping[str, str]) -> str:
    """Return an argument as the user types it on the command line: ``--tolerance``, or ``--method auto``.

    Args:
        name: Name of the argument in Python, possibly with an index or an attribute.
        value: Value of the argument in Python notation; None for the name alone.
        words: Names on the command line by Python's names.
    """
    first, last = re.split(r"[\[.]", name, maxsplit=1)[0], name.rpartition(".")[2]
    flag = words.get(name) or words.get(last) or words.get(first, first)
    if value is None:
        return flag
    if value in ("True", "False"):
        positive = flag.replace("--no-", "--", 1)
        return positive if value == "True" else positive.replace("--", "--no-", 1)
    shown = value.strip("'").strip("()").replace(",", "") if value.startswith(("'", "(")) else value
    return f"{flag} {shown}" if flag.startswith("--") else f"{flag}={value}"
