"""Descriptions of options: one for Python, the command line, the viewer, the reference and fuzz tests.

An option is a field of a frozen dataclass, or an argument of a public function: its annotation states type, range and
unit, and the ``Attributes:`` or ``Args:`` section of the docstring states its meaning.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import math
import re
import sys
import types
import typing
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, Literal

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

Kind = Literal["flag", "integer", "number", "choice", "choices", "text", "pair", "numbers", "integers", "object"]
# American spellings that are accepted, with the spelling that the library uses.
SPELLINGS = {"normalized": "normalised", "centered": "centred", "taylor-uncentered": "taylor-uncentred"}
_PACKAGE = f"{__name__.partition('.')[0]}."
REQUIRED: Any = inspect.Parameter.empty


@dataclass(frozen=True)
class Option:
    """One option: its name, type, range, unit, default and meaning.

    Attributes:
        name: The name in Python.
        kind: The type: ``"choices"`` are several of the choices, ``"pair"`` is one number or a pair (y, x),
            ``"numbers"`` or ``"integers"`` are a tuple of ``length``, ``"object"`` is anything else.
        default: The default; ``REQUIRED`` if there is none.
        help: The meaning, in plain text.
        choices: The values of a ``"choice"``, without American spellings.
        length: The length of a tuple; 0 for other kinds.
        gt: Exclusive lower bound; None is none.
        ge: Inclusive lower bound; None is none.
        le: Inclusive upper bound; None is none.
        unit: The unit; empty if it has none.
        optional: Whether None is accepted.
        instance_of: Of an ``"object"``, the class of the package that it must be an instance of; None accepts anything.
    """

    name: str
    kind: Kind
    default: Any
    help: str
    choices: tuple[Any, ...] = ()
    length: int = 0
    gt: float | None = None
    ge: float | None = None
    le: float | None = None
    unit: str = ""
    optional: bool = False
    instance_of: type | None = None

    @property
    def dashed(self) -> str:
        """The name with dashes, as flags of the command line have it."""
        return self.name.replace("_", "-")

    @property
    def range(self) -> str:
        """The accepted range, such as ``"1e-05 to 0.5"``; empty if there is none."""
        return validation.range_text(self.gt, self.ge, self.le)

    def check(self, value: Any) -> Any:
        """Return a value in the type of this option; raise an error that names it otherwise."""
        if value is None and self.optional:
            return None
        return getattr(self, f"_check_{self.kind}")(value)

    def _check_object(self, value: Any) -> Any:
        if self.instance_of is not None:
            validation.instance(value, self.instance_of, self.name)
        return value

    def _check_flag(self, value: Any) -> bool:
        return validation.flag(value, self.name)

    def _check_choice(self, value: Any) -> Any:
        value = SPELLINGS.get(value, value) if isinstance(value, str) else value
        return validation.choice(value, self.name, self.choices)

    def _check_choices(self, value: Any) -> tuple[str, ...]:
        if not validation.is_sequence(value):
            raise ArgumentTypeError(
                f"{ref(self.name)} must be a tuple or list of {', '.join(map(repr, self.choices))}, got {value!r:.60}"
            )
        return tuple(dict.fromkeys(self._check_choice(name) for name in value))

    def _check_pair(self, value: Any) -> Any:
        if not validation.is_sequence(value):
            return self._check_number(value)
        if len(value) != 2:
            raise ArgumentValueError(f"{ref(self.name)} must be one number or a pair (y, x), got {len(value)} values")
        return tuple(map(self._check_number, value))

    def _check_text(self, value: Any) -> str:
        if not isinstance(value, str):
            raise ArgumentTypeError(f"{ref(self.name)} must be a string, got {type(value).__name__}")
        return value

    def _check_integer(self, value: Any) -> int:
        least = -validation.MOST_COUNT if self.ge is None else int(self.ge)
        most = validation.MOST_COUNT if self.le is None else int(self.le)
        return validation.count(value, self.name, least=least, most=most)

    def _check_number(self, value: Any) -> float:
        above = -math.inf if self.gt is None else self.gt
        least = -math.inf if self.ge is None else self.ge
        most = validation.MOST if self.le is None else self.le
        return validation.number(value, self.name, above=above, least=least, most=most)

    def _check_integers(self, value: Any) -> tuple[int, ...]:
        if not validation.is_sequence(value) or len(value) != self.length:
            kind = "a pair (y, x) of" if self.length == 2 else self.length
            raise ArgumentValueError(f"{ref(self.name)} must be {kind} integers, got {value!r:.60}")
        return tuple(
            replace(self, name=f"{self.name}[{index}]")._check_integer(number) for index, number in enumerate(value)
        )

    def _check_numbers(self, value: Any) -> tuple[float, ...]:
        return validation.numbers(value, self.name, length=self.length)


def _describe_annotation(name: str, annotation: Any, default: Any, text: str) -> Option:
    """Return the option of an annotation such as ``Annotated[float, Gt(0.0), Unit("µm")] | None``."""
    optional = False
    found: dict[str, Any] = {"gt": None, "ge": None, "le": None, "unit": ""}
    while True:
        origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
        if origin is Annotated:
            annotation = arguments[0]
            for each in arguments[1:]:
                for bound in ("gt", "ge", "le", "unit"):
                    value = getattr(each, bound, None)
                    found[bound] = found[bound] if value is None else value
        elif origin in (typing.Union, types.UnionType) and type(None) in arguments:
            optional = True
            rest = tuple(each for each in arguments if each is not type(None))
            annotation = rest[0] if len(rest) == 1 else typing.Union[rest]  # noqa: UP007 (a tuple of them)
        elif origin in (typing.Union, types.UnionType):
            annotation = _Pair if set(arguments) == {float, tuple[float, float]} else object
        else:
            break
    kind: Kind = _KINDS.get(annotation, "object")
    choices: tuple[Any, ...] = ()
    length = 0
    inner = arguments[0] if len(arguments) == 1 or arguments[1:] == (...,) else None
    if origin is Literal:
        kind, choices = "choice", tuple(each for each in arguments if each not in SPELLINGS)
    elif typing.get_origin(inner) is Literal:
        kind, choices = "choices", tuple(each for each in typing.get_args(inner) if each not in SPELLINGS)
    elif annotation is _Pair:
        kind = "pair"
    elif origin is tuple and set(arguments) in ({int}, {float}):
        kind, length = "integers" if int in arguments else "numbers", len(arguments)
    ours = isinstance(annotation, type) and annotation.__module__.startswith(_PACKAGE) and annotation is not _Unknown
    instance_of = annotation if kind == "object" and ours else None
    return Option(
        name, kind, default, text, choices=choices, length=length, optional=optional, instance_of=instance_of, **found
    )


class _Anything(type):
    """Let a class answer for every attribute of a module that is imported for type checkers only."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return cls


class _Pair:
    """Stand for ``float | tuple[float, float]``."""


class _Unknown(metaclass=_Anything):
    """Stand for a type that is imported for type checkers only."""

    def __class_getitem__(cls, _: Any) -> type[_Unknown]:
        return cls


class _Names(dict[str, Any]):
    """Resolve the names in annotations of a class or function; what only type checkers import is ``_Unknown``."""

    def __init__(self, owner: Any) -> None:
        self._modules = [sys.modules[base.__module__] for base in getattr(owner, "__mro__", (owner,))]

    def __missing__(self, name: str) -> Any:
        for module in (*self._modules, builtins):
            if hasattr(module, name):
                return getattr(module, name)
        return _Unknown


_KINDS: dict[Any, Kind] = {bool: "flag", int: "integer", float: "number", str: "text"}
_SECTION = re.compile(r"^( *)(?:Args|Attributes):\n((?:\1 {4}.*\n|\s*\n)*)", re.MULTILINE)


def documented(owner: Any) -> dict[str, str]:
    """Return the entries of the ``Args:`` and ``Attributes:`` sections of a docstring, by name, each in one line."""
    found: dict[str, str] = {}
    for base in reversed(owner.__mro__ if isinstance(owner, type) else (owner,)):
        for section in _SECTION.finditer(inspect.cleandoc(base.__doc__ or "") + "\n"):
            for entry in re.split(r"\n(?=    \w)", "\n" + section[2].rstrip()):
                name, colon, text = entry.strip().partition(":")
                if colon and name.isidentifier():
                    found[name] = " ".join(text.split())
    return found


@functools.cache
def describe(owner: Any) -> dict[str, Option]:
    """Return the options of a dataclass (its fields) or of a function (its arguments), by name."""
    hints = typing.get_type_hints(owner, include_extras=True, localns=_Names(owner))
    texts = documented(owner)
    if is_dataclass(owner):
        given = {
            field.name: REQUIRED if field.default is MISSING else field.default for field in fields(owner) if field.init
        }
    else:
        given = {
            each.name: each.default
            for each in inspect.signature(owner).parameters.values()
            if each.kind in (each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY) and each.name not in ("self", "cls")
        }
    return {
        name: _describe_annotation(name, hints.get(name, object), default, texts.get(name, ""))
        for name, default in given.items()
    }


class Checked:
    """Check every field of a frozen dataclass once it is made, by its description; rules for two fields are its own."""

    def __post_init__(self) -> None:
        owner: Any = type(self)
        for option in describe(owner).values():
            object.__setattr__(self, option.name, option.check(getattr(self, option.name)))
