"""Errors and warnings that know which words in them name arguments, so that each front end prints its own word.

A message marks each name of an argument by :func:`ref`. Python prints ``tolerance``, the command line ``--tolerance``,
the viewer the label of its control. The marks are two characters of Unicode's private area, which ``repr`` escapes in
what a user gave.
"""

from __future__ import annotations

import contextlib
import difflib
import re
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

_E = TypeVar("_E", bound=Exception)

_BEGIN, _VALUE, _END = "\ue000", "\ue001", "\ue002"
_MARKED = re.compile(f"{_BEGIN}([^{_VALUE}{_END}]*)(?:{_VALUE}([^{_END}]*))?{_END}")


def ref(name: str, value: object = None) -> str:
    """Mark the name of an argument in a message, with a value that it may be set to.

    Args:
        name: The name in Python; a method ends in ``()``, an element or attribute stands behind it, as in
            ``lights[1].power``.
        value: What the message proposes for it; None proposes nothing.
    """
    return f"{_BEGIN}{name}{_END}" if value is None else f"{_BEGIN}{name}{_VALUE}{value!r}{_END}"


def python_word(name: str, value: str | None) -> str:
    """Write an argument as Python does: ``tolerance``, or ``method='auto'``."""
    return name if value is None else f"{name}={value}"


def spelled(message: object, word: Callable[[str, str | None], str] = python_word) -> str:
    """Write a message, an error or a warning with each argument's name as ``word(name, value)``."""
    text = getattr(message, "marked", None) or str(message)
    return _MARKED.sub(lambda match: word(match[1], match[2]), text)


class _MarkedError(Exception):
    """Keep the marked text beside the plain one."""

    def __init__(self, marked: str = "") -> None:
        self.marked = marked
        super().__init__(spelled(marked))

    def __reduce__(self) -> tuple[type[_MarkedError], tuple[str]]:
        return type(self), (self.marked,)


class ArgumentValueError(_MarkedError, ValueError):
    """Raised for an argument of a value that is not accepted."""


class ArgumentTypeError(_MarkedError, TypeError):
    """Raised for an argument of a type that is not accepted."""


def marked(kind: type[_E], message: str) -> _E:
    """Return an error of another class, such as ``MemoryError``, whose message marks arguments by :func:`ref`."""
    error = kind(spelled(message))
    error.__dict__["marked"] = message
    return error


class ToleranceError(ArgumentValueError):
    """Raised where a tolerance cannot be met; the message names the cause and the remedy."""


class WarpdiffWarning(_MarkedError, UserWarning):
    """Something was repaired, excluded, or cannot be trusted; the message says what, by how much, and the remedy."""


@contextlib.contextmanager
def renaming(words: Mapping[str, str]) -> Iterator[None]:
    """Within it, errors name arguments by other words, such as ``path`` by ``--environment``."""

    def renamed(match: re.Match[str]) -> str:
        name = re.split(r"[^\w-]", match[1], maxsplit=1)[0]
        return match[0].replace(name, words[name], 1) if name in words else match[0]

    try:
        yield
    except Exception as error:
        if not hasattr(error, "marked"):
            raise
        raise marked(type(error), _MARKED.sub(renamed, error.marked)) from None


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return ``"; did you mean …?"`` for the known name that is nearest, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=1) if isinstance(name, str) else []
    return f"; did you mean {near[0]!r}?" if near else ""
