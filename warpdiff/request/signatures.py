"""Functions that accept settings as keyword arguments: signatures, docstrings, and errors for misspelt names."""

from __future__ import annotations

import functools
import inspect
import re
import textwrap
from typing import TYPE_CHECKING, Any, TypeVar

from warpdiff.core.options import describe
from warpdiff.core.wording import ArgumentTypeError, did_you_mean, ref

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from warpdiff.core.options import Option

Function = TypeVar("Function", bound="Callable[..., Any]")
# Line width of generated docstrings [characters], equal to the line width of the code.
_WIDTH = 120


def accepts(settings: type) -> Callable[[Function], Function]:
    """Return a decorator that replaces ``**settings`` in a function's signature by the fields of a settings class.

    The signature and the docstring of the function then list the fields, so that ``help``, IPython and Sphinx show
    them. An unknown name raises an error that suggests the most similar name.

    Args:
        settings: One of the classes of :mod:`warpdiff.request.settings`.
    """

    def decorate(function: Function) -> Function:
        options = describe(settings)
        signature = inspect.signature(function)
        own = [parameter for parameter in signature.parameters.values() if parameter.kind is not parameter.VAR_KEYWORD]
        known = {*options, *(parameter.name for parameter in own)}
        name = function.__qualname__.removesuffix(".__init__")

        @functools.wraps(function)
        def call(*args: object, **keywords: object) -> object:
            _check_names(name, keywords, known)
            return function(*args, **keywords)

        fields = [
            inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=option.default)
            for option in options.values()
            if option.name not in signature.parameters
        ]
        call.__settings__ = settings  # type: ignore[attr-defined]
        call.__signature__ = signature.replace(parameters=[*own, *fields])  # type: ignore[attr-defined]
        call.__doc__ = _with_options(function.__doc__ or "", [options[field.name] for field in fields])
        return call  # type: ignore[return-value]

    return decorate


def checked(function: Function) -> Function:
    """Return ``function`` with a check of its arguments: their names, and whether their values fit the annotations."""
    signature, name = inspect.signature(function), function.__qualname__

    @functools.wraps(function)
    def call(*args: object, **keywords: object) -> object:
        _check_names(name, keywords, set(signature.parameters))
        bound = signature.bind(*args, **keywords)
        options = describe(function)
        for argument, value in bound.arguments.items():
            if argument in options:
                bound.arguments[argument] = options[argument].check(value)
        return function(*bound.args, **bound.kwargs)

    return call  # type: ignore[return-value]


def _check_names(function: str, keywords: Mapping[str, object], known: set[str]) -> None:
    for keyword in keywords:
        if keyword not in known:
            raise ArgumentTypeError(
                f"{function}() has no argument {ref(keyword)}{did_you_mean(keyword, sorted(known))}"
            )


def _with_options(text: str, options: list[Option]) -> str:
    """Add options to the ``Args:`` section of a docstring; append this section if the docstring has none."""
    text = inspect.cleandoc(text)
    entries = "\n".join(
        textwrap.fill(
            f"{option.name}: {option.help} {_facts(option)}", _WIDTH - 4, initial_indent=" " * 4,
            subsequent_indent=" " * 8, break_on_hyphens=False,
        )
        for option in options
    )  # fmt: skip
    section = re.search(r"^Args:\n(?:    .*\n|\n(?=    ))*", text + "\n", re.MULTILINE)
    if section:
        return f"{text[: section.end()].rstrip()}\n{entries}\n{text[section.end() :]}"
    return f"{text}\n\nArgs:\n{entries}\n"


def _facts(option: Option) -> str:
    """Return the range, choices, unit and default of an option as text in brackets, for a docstring."""
    facts = list(filter(None, (option.range, " | ".join(map(repr, option.choices)), option.unit)))
    return f"({'; '.join([*facts, f'default {option.default!r}'])})"
