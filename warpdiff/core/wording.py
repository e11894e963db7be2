"""Errors and warnings with marked names of arguments, so that Python, command line and viewer print different names.

The function :func:`ref` marks the name of an argument in a message. Python prints ``tolerance``, the command line
prints ``--tolerance``, and the viewer prints the label of the control that sets the argument. The marks are characters
of Unicode's private use area. Messages contain the user's values as ``repr``, which escapes such characters.
"""

from __future__ import annotations

import contextlib
import difflib
import re
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

_E = TypeVar("_E", bound=Exception)

# Largest number of names that a message lists. It was chosen because longer lists are hard to read.
_MOST_NAMES = 12
_BEGIN, _VALUE, _END = "\ue000", "\ue001", "\ue002"
_MARKED = re.compile(f"{_BEGIN}([^{_VALUE}{_END}]*)(?:{_VALUE}([^{_END}]*))?{_END}")


def ref(name: str, value: object = None) -> str:
    """Mark the name of an argument in a message, optionally with a value.

    Args:
        name: The name in Python. A method ends in ``()``; an element or attribute follows the name, as in
            ``lights[1].power``.
        value: Value of the argument that the message mentions; None mentions no value.
    """
    return f"{_BEGIN}{name}{_END}" if value is None else f"{_BEGIN}{name}{_VALUE}{value!r}{_END}"


def python_word(name: str, value: str | None) -> str:
    """Return the name of an argument, or name and value, in Python notation: ``tolerance`` or ``method='auto'``."""
    return name if value is None else f"{name}={value}"


def spelled(message: object, word: Callable[[str, str | None], str] = python_word) -> str:
    """Return the text of an error or a warning, in which ``word(name, value)`` has replaced each marked argument."""
    text = getattr(message, "marked", None) or str(message)
    return _MARKED.sub(lambda match: word(match[1], match[2]), text)


class _MarkedError(Exception):
    """Error with two forms of its message: a plain text, and ``marked``, in which arguments are marked."""

    def __init__(self, marked: str = "") -> None:
        self.marked = marked
        super().__init__(spelled(marked))

    def __reduce__(self) -> tuple[type[_MarkedError], tuple[str]]:
        return type(self), (self.marked,)


class ArgumentValueError(_MarkedError, ValueError):
    """Error for an argument whose value is not accepted."""


class ArgumentTypeError(_MarkedError, TypeError):
    """Error for an argument whose type is not accepted."""


def marked(kind: type[_E], message: str) -> _E:
    """Return an error of class ``kind``, such as ``MemoryError``. In its message, :func:`ref` has marked arguments."""
    error = kind(spelled(message))
    error.__dict__["marked"] = message
    return error


class ToleranceError(ArgumentValueError):
    """Error that is raised if the requested tolerance cannot be met. The message names the cause and the remedy.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(period_um=2.0, depth_um=2.0)
        >>> try:
        ...     wd.plan(grating, (0, 0, 1), (0, 0, 1), method="taylor", tolerance=1e-5)
        ... except wd.ToleranceError as error:
        ...     print(error)
        the Taylor series cannot meet tolerance=1e-05: ...
    """


class WarpdiffWarning(_MarkedError, UserWarning):
    """Warning that data were changed or excluded, or that a result is unreliable; the message states the remedy.

    Examples:
        >>> import warnings
        >>> import warpdiff as wd
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     field = wd.HeightField([[0.0, 150.0]], pitch_um=1.0)  # heights in nm by mistake
        >>> print(caught[0].message)
        heights_um has a range of 150 µm, more than the size of 2 µm; are heights in nanometres? ...
    """


@contextlib.contextmanager
def renaming(words: Mapping[str, str]) -> Iterator[None]:
    """Context in which errors name arguments differently, for example ``--environment`` instead of ``path``."""

    def renamed(match: re.Match[str]) -> str:
        name = re.split(r"[^\w-]", match[1], maxsplit=1)[0]
        return match[0].replace(name, words[name], 1) if name in words else match[0]

    try:
        yield
    except Exception as error:
        if not hasattr(error, "marked"):
            raise
        raise marked(type(error), _MARKED.sub(renamed, error.marked)) from None


def listed(names: Sequence[str], separator: str = ", ", rest: str = " and {} more") -> str:
    """Return at most twelve names as text for a message.

    If there are more names, the text ends in ``rest``, in which their number replaces ``{}``.
    """
    more = len(names) - _MOST_NAMES
    return separator.join(names[:_MOST_NAMES]) + (rest.format(more) if more > 0 else "")


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return ``"; did you mean …?"`` with the element of ``known`` that is most similar to ``name``.

    The text is empty if no element is similar, or if ``name`` is not a string.
    """
    near = difflib.get_close_matches(name, list(known), n=1) if isinstance(name, str) else []
    return f"; did you mean {near[0]!r}?" if near else ""
