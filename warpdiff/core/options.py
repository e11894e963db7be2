"""Descriptions of options, for Python, the command line, the viewer, the reference documentation and fuzz tests.

An option is a field of a frozen dataclass, or an argument of a public function. The annotation of the field or argument
states type, range and unit. The ``Attributes:`` or ``Args:`` section of the docstring states the meaning.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import itertools
import math
import re
import sys
import types
import typing
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from typing import Annotated, Any, Literal

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

if typing.TYPE_CHECKING:
    from collections.abc import Callable

Kind = Literal["flag", "integer", "number", "choice", "choices", "text", "pair", "numbers", "integers", "object"]
# Accepted American spellings of the values of options, with the British spelling that the library uses.
SPELLINGS = {"normalized": "normalised", "centered": "centred", "taylor-uncentered": "taylor-uncentred"}
# Largest number of digits of the index in a name such as "light.0". Python refuses to convert numbers of more than
# 4,300 digits, and nine digits suffice for any list of lights.
_MOST_DIGITS = 9
_PACKAGE = f"{__name__.partition('.')[0]}."
REQUIRED: Any = inspect.Parameter.empty


@dataclass(frozen=True)
class Names:
    """Annotation of a collection of names, for names that are known at run time only.

    Attributes:
        choices: Accepted names.
        indexed: Names among them that an index may follow, as in ``"light.0"``.
    """

    choices: tuple[str, ...]
    indexed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Option:
    """One option: its name, type, range, unit, default and meaning.

    Attributes:
        name: Name of the option in Python.
        kind: Type of the option. ``"flag"`` is a bool, ``"choice"`` is one of ``choices``, ``"choices"`` is a tuple of
            them, ``"pair"`` is one number or a pair (y, x), ``"numbers"`` and ``"integers"`` are tuples of ``length``
            elements, ``"object"`` is anything else.
        default: Default value; ``REQUIRED`` if there is none.
        help: Meaning of the option, in plain text.
        choices: Accepted values of an option of kind ``"choice"`` or ``"choices"``. American spellings are accepted,
            too, but not listed here.
        indexed: Choices that an index may follow, as in ``"light.0"``.
        length: Number of elements of a tuple; 0 for other kinds.
        gt: Exclusive lower bound, or None.
        ge: Inclusive lower bound, or None.
        le: Inclusive upper bound, or None.
        unit: Unit of the value; empty if it has none.
        optional: Whether None is accepted.
        instance_of: Class of the package that an ``"object"`` must be an instance of; None accepts any object.
    """

    name: str
    kind: Kind
    default: Any
    help: str
    choices: tuple[Any, ...] = ()
    length: int = 0
    indexed: tuple[str, ...] = ()
    gt: float | None = None
    ge: float | None = None
    le: float | None = None
    unit: str = ""
    optional: bool = False
    instance_of: type | None = None

    @property
    def dashed(self) -> str:
        """Name of the option with dashes, as on the command line."""
        return self.name.replace("_", "-")

    @property
    def range(self) -> str:
        """Accepted range of the value in words, such as ``"more than 0 and at most 0.5"``; empty if there is none."""
        return validation.range_text(self.gt, self.ge, self.le)

    def check(self, value: object) -> Any:
        """Return a value converted to the type of this option; a wrong value raises an error that names the option."""
        if value is None and self.optional:
            return None
        return getattr(self, f"_check_{self.kind}")(value)

    def _check_object(self, value: object) -> object:
        if self.instance_of is not None:
            validation.instance(value, self.instance_of, self.name)
        return value

    def _check_flag(self, value: object) -> bool:
        return validation.flag(value, self.name)

    def _check_choice(self, value: object) -> Any:
        value = SPELLINGS.get(value, value) if isinstance(value, str) else value
        if self.indexed and isinstance(value, str):
            name, _, index = value.partition(".")
            if name in self.indexed and index.isdecimal() and len(index) <= _MOST_DIGITS:
                return f"{name}.{int(index)}"
        return validation.choice(value, self.name, self.choices)

    def _check_choices(self, value: object) -> tuple[str | int, ...]:
        if not validation.is_sequence(value):
            raise ArgumentTypeError(
                f"{ref(self.name)} must be a tuple or list of {', '.join(map(repr, self.choices))}, got {value!r:.60}"
            )
        return tuple(dict.fromkeys(self._check_choice(name) for name in value))

    def _check_pair(self, value: object) -> float | tuple[float, ...]:
        if not validation.is_sequence(value):
            return self._check_number(value)
        if len(value) != 2:
            raise ArgumentValueError(f"{ref(self.name)} must be one number or a pair (y, x), got {len(value)} values")
        return tuple(map(self._check_number, value))

    def _check_text(self, value: object) -> str:
        if not isinstance(value, str):
            raise ArgumentTypeError(f"{ref(self.name)} must be a string, got {type(value).__name__}")
        return value

    def _check_integer(self, value: object) -> int:
        least = -validation.MOST_COUNT if self.ge is None else int(self.ge)
        most = validation.MOST_COUNT if self.le is None else int(self.le)
        return validation.count(value, self.name, least=least, most=most)

    def _check_number(self, value: object) -> float:
        above = -math.inf if self.gt is None else self.gt
        least = -math.inf if self.ge is None else self.ge
        most = validation.MOST if self.le is None else self.le
        return validation.number(value, self.name, above=above, least=least, most=most)

    def _check_integers(self, value: object) -> tuple[int, ...]:
        if not validation.is_sequence(value) or len(value) != self.length:
            kind = "a pair (y, x) of" if self.length == 2 else self.length
            raise ArgumentValueError(f"{ref(self.name)} must be {kind} integers, got {value!r:.60}")
        return tuple(
            replace(self, name=f"{self.name}[{index}]")._check_integer(number) for index, number in enumerate(value)
        )

    def _check_numbers(self, value: object) -> tuple[float, ...]:
        return validation.numbers(value, self.name, length=self.length)


def _describe_annotation(name: str, annotation: Any, default: object, text: str) -> Option:
    """Return the option of an annotation such as ``Annotated[float, Gt(0.0), Unit("µm")] | None``."""
    optional = False
    facts: dict[str, Any] = {"gt": None, "ge": None, "le": None, "unit": "", "choices": (), "indexed": ()}
    while True:
        origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
        if origin is Annotated:
            annotation = arguments[0]
            for metadata, fact in itertools.product(arguments[1:], facts):
                if (value := getattr(metadata, fact, None)) is not None:
                    facts[fact] = value
        elif origin in (typing.Union, types.UnionType) and type(None) in arguments:
            optional = True
            rest = tuple(argument for argument in arguments if argument is not type(None))
            annotation = rest[0] if len(rest) == 1 else typing.Union[rest]  # noqa: UP007 (the members are a tuple)
        elif origin in (typing.Union, types.UnionType):
            annotation = _Pair if set(arguments) == {float, tuple[float, float]} else object
        else:
            break
    kind: Kind = _KINDS.get(annotation, "object")
    choices: tuple[str | int, ...] = facts.pop("choices")
    length = 0
    inner = arguments[0] if len(arguments) == 1 or arguments[1:] == (...,) else None
    if choices:
        kind = "choices"
    elif origin is Literal:
        kind, choices = "choice", choices_of(annotation)
    elif typing.get_origin(inner) is Literal:
        kind, choices = "choices", choices_of(inner)
    elif annotation is _Pair:
        kind = "pair"
    elif origin is tuple and set(arguments) in ({int}, {float}):
        kind, length = "integers" if int in arguments else "numbers", len(arguments)
    ours = isinstance(annotation, type) and annotation.__module__.startswith(_PACKAGE) and annotation is not _Unknown
    instance_of = annotation if kind == "object" and ours else None
    return Option(
        name, kind, default, text, choices=choices, length=length, optional=optional, instance_of=instance_of, **facts
    )


def choices_of(literal: Any) -> tuple[str | int, ...]:
    """Return the values of a ``Literal``, from which American spellings are omitted."""
    return tuple(value for value in typing.get_args(literal) if value not in SPELLINGS)


class _Anything(type):
    """Metaclass of a class that has every attribute.

    Modules that only type checkers import do not exist at run time. Such a class replaces them while annotations are
    evaluated.
    """

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return cls


class _Pair:
    """Placeholder for the annotation ``float | tuple[float, float]``."""


class _Unknown(metaclass=_Anything):
    """Placeholder for a type that only type checkers import, and for its attributes and subscripts."""

    def __class_getitem__(cls, _: object) -> type[_Unknown]:
        return cls


class _Names(dict[str, object]):
    """Namespace for evaluating annotations; names that only type checkers import have a placeholder as their value."""

    def __init__(self, owner: type | Callable[..., object]) -> None:
        self._modules = [sys.modules[base.__module__] for base in getattr(owner, "__mro__", (owner,))]

    def __missing__(self, name: str) -> object:
        for module in (*self._modules, builtins):
            if hasattr(module, name):
                return getattr(module, name)
        return _Unknown


_KINDS: dict[object, Kind] = {bool: "flag", int: "integer", float: "number", str: "text"}
_SECTION = re.compile(r"^( *)(?:Args|Attributes):\n((?:\1 {4}.*\n|\s*\n)*)", re.MULTILINE)


def documented(owner: type | Callable[..., object]) -> dict[str, str]:
    """Return the entries of the ``Args:`` and ``Attributes:`` sections of a docstring as one-line texts, by name."""
    texts: dict[str, str] = {}
    for base in reversed(owner.__mro__ if isinstance(owner, type) else (owner,)):
        for section in _SECTION.finditer(inspect.cleandoc(base.__doc__ or "") + "\n"):
            for entry in re.split(r"\n(?=    \w)", "\n" + section[2].rstrip()):
                name, colon, text = entry.strip().partition(":")
                if colon and name.isidentifier():
                    texts[name] = " ".join(text.split())
    return texts


@functools.cache
def describe(owner: type | Callable[..., object]) -> dict[str, Option]:
    """Return the options of a dataclass (its fields) or of a function (its arguments), by name.

    If the function has an attribute ``__settings__``, the arguments include the fields of the class that this attribute
    names. The decorator :func:`warpdiff.request.signatures.accepts` sets the attribute.
    """
    hints = typing.get_type_hints(owner, include_extras=True, localns=_Names(owner))
    texts = documented(owner)
    if is_dataclass(owner):
        defaults = {
            field.name: REQUIRED if field.default is MISSING else field.default for field in fields(owner) if field.init
        }
    else:
        defaults = {
            name: parameter.default
            for name, parameter in inspect.signature(owner).parameters.items()
            if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
            and name not in ("self", "cls")
        }
    settings = getattr(owner, "__settings__", None)
    shared = {name: option for name, option in (describe(settings) if settings else {}).items() if name not in hints}
    return {
        name: shared.get(name) or _describe_annotation(name, hints.get(name, object), default, texts.get(name, ""))
        for name, default in defaults.items()
    }


class Checked:
    """Base class of frozen dataclasses that check each field by its annotation.

    A subclass may add rules that concern several fields.
    """

    def __post_init__(self) -> None:
        owner: Callable[..., object] = type(self)
        for option in describe(owner).values():
            object.__setattr__(self, option.name, option.check(getattr(self, option.name)))
