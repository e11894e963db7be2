"""Functions that take settings as keyword arguments: their signatures, their docstrings, and misspelt names."""

from __future__ import annotations

import functools
import inspect
import re
import textwrap
from typing import TYPE_CHECKING, Any, TypeVar

from warpdiff.core.options import describe
from warpdiff.core.wording import ArgumentTypeError, did_you_mean, ref

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.core.options import Option

Function = TypeVar("Function", bound="Callable[..., Any]")
# Limit: docstrings are as wide as the code.
_WIDTH = 120


def accepts(settings: type) -> Callable[[Function], Function]:
    """Make a function's ``**settings`` the fields of a class of settings.

    Signature and docstring list the fields, so that ``help``, IPython and Sphinx show them; an unknown name raises an
    error with the name that is nearest.

    Args:
        settings: One of the classes of :mod:`warpdiff.request.settings`.
    """

    def decorate(function: Function) -> Function:
        options = describe(settings)
        signature = inspect.signature(function)
        own = [each for each in signature.parameters.values() if each.kind is not each.VAR_KEYWORD]
        known = {*options, *(each.name for each in own)}
        name = function.__qualname__.removesuffix(".__init__")

        @functools.wraps(function)
        def call(*args: Any, **keywords: Any) -> Any:
            _check_names(name, keywords, known)
            return function(*args, **keywords)

        fields = [
            inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY, default=each.default)
            for each in options.values()
            if each.name not in signature.parameters
        ]
        call.__signature__ = signature.replace(parameters=[*own, *fields])  # type: ignore[attr-defined]
        call.__doc__ = _with_options(function.__doc__ or "", [options[each.name] for each in fields])
        return call  # type: ignore[return-value]

    return decorate


def checked(function: Function) -> Function:
    """Check the arguments of a function by its annotations, and misspelt names, before its body runs."""
    signature, name = inspect.signature(function), function.__qualname__

    @functools.wraps(function)
    def call(*args: Any, **keywords: Any) -> Any:
        _check_names(name, keywords, set(signature.parameters))
        bound = signature.bind(*args, **keywords)
        options = describe(function)
        for argument, value in bound.arguments.items():
            if argument in options:
                bound.arguments[argument] = options[argument].check(value)
        return function(*bound.args, **bound.kwargs)

    return call  # type: ignore[return-value]


def _check_names(function: str, keywords: dict[str, Any], known: set[str]) -> None:
    for keyword in keywords:
        if keyword not in known:
            raise ArgumentTypeError(
                f"{function}() has no argument {ref(keyword)}{did_you_mean(keyword, sorted(known))}"
            )


def _with_options(text: str, options: list[Option]) -> str:
    """Add options to the ``Args:`` section of a docstring."""
    text = inspect.cleandoc(text)
    entries = "\n".join(
        textwrap.fill(
            f"{each.name}: {each.help} {_facts(each)}", _WIDTH - 4, initial_indent=" " * 4, subsequent_indent=" " * 8,
            break_on_hyphens=False,
        )
        for each in options
    )  # fmt: skip
    section = re.search(r"^Args:\n(?:    .*\n|\n(?=    ))*", text + "\n", re.MULTILINE)
    if section:
        return f"{text[: section.end()].rstrip()}\n{entries}\n{text[section.end() :]}"
    return f"{text}\n\nArgs:\n{entries}\n"


def _facts(option: Option) -> str:
    """Return range, choices, unit and default of an option, in brackets."""
    facts = [each for each in (option.range, " | ".join(map(repr, option.choices)), option.unit) if each]
    return f"({'; '.join([*facts, f'default {option.default!r}'])})"
