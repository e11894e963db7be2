"""Values of glTF's JSON, which are checked when they are read. Errors name their path, such as ``nodes[3].mesh``."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, NoReturn

from warpdiff.core.text_encodings import decoded
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Sequence

# Largest accepted magnitude of a number in a glTF file. It is limited because products of larger numbers could
# overflow.
_MOST_NUMBER = 1e100
# Largest accepted integer in a glTF file. It is limited because JSON has numbers of double precision, which do not
# represent all larger integers exactly.
_MOST_INTEGER = 2**53


def refuse(place: str, rule: str) -> NoReturn:
    """Raise an error about a value of the file.

    Args:
        place: Place of the value in the file, such as ``nodes[3].mesh``.
        rule: Verb phrase with the rule and the value, such as "must be a string, got 5".
    """
    raise ArgumentValueError(f"{ref('mesh')} must be a sound glTF file: {place} {rule}")


def _shown(value: object) -> str:
    """Return the beginning of a value as JSON text, for messages."""
    text = repr(value)
    return text if len(text) <= 40 else text[:39] + "…"


class Element:
    """JSON object of a glTF file, with its path in the file.

    The methods return the member ``name`` of the object, after a check of its type and range. An error about a value
    names the path of the value.
    """

    __slots__ = ("place", "values")

    def __init__(self, values: object, place: str) -> None:
        """Check that ``values`` is a JSON object."""
        if not isinstance(values, dict):
            refuse(place or "the JSON", f"must be an object, got {_shown(values)}")
        self.values: dict[str, Any] = values
        self.place = place

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def where(self, name: str) -> str:
        """Return the path of the JSON member ``name`` in the file, such as ``nodes[3].mesh``."""
        return f"{self.place}.{name}" if self.place else name

    def refuse(self, name: str, rule: str) -> NoReturn:
        """Raise an error about one of the values of the object; see :func:`refuse`."""
        refuse(self.where(name), rule)

    def integer(self, name: str, default: int | None = None, *, least: int = 0, most: int = _MOST_INTEGER) -> int:
        """Return the JSON member ``name``, an integer from ``least`` to ``most``, or ``default``.

        An error is raised if the file does not state the member and there is no default.
        """
        if name not in self.values and default is not None:
            return default
        return self._integer(self._stated(name), self.where(name), least, most)

    def index(self, name: str, count: int) -> int | None:
        """Return the JSON member ``name``, an index from 0 to ``count`` − 1, or None if the file states none."""
        return self.integer(name, most=count - 1) if name in self.values else None

    def indices(self, name: str, count: int) -> list[int]:
        """Return the JSON member ``name``, a list of indices from 0 to ``count`` − 1; empty if the file states none."""
        return [
            self._integer(value, f"{self.where(name)}[{number}]", 0, count - 1)
            for number, value in enumerate(self._list(name))
        ]

    def number(self, name: str, default: float, *, least: float = -_MOST_NUMBER, most: float = _MOST_NUMBER) -> float:
        """Return the JSON member ``name``, a number from ``least`` to ``most``; ``default`` if the file states none."""
        if name not in self.values:
            return default
        value = self._number(self.values[name], self.where(name))
        if not least <= value <= most:
            self.refuse(name, f"must be from {least:g} to {most:g}, got {value:g}")
        return value

    def numbers(self, name: str, default: Sequence[float] | None = None) -> list[float]:
        """Return the JSON member ``name``, a list of finite numbers, or ``default`` if the file states none.

        The list must be as long as ``default``. Without a default, it may have any length.
        """
        if default is not None and name not in self.values:
            return list(default)
        values = self._list(name)
        if default is not None and len(values) != len(default):
            self.refuse(name, f"must have {len(default)} numbers, got {len(values)}")
        return [self._number(value, f"{self.where(name)}[{number}]") for number, value in enumerate(values)]

    def text(self, name: str, default: str = "") -> str:
        """Return the JSON member ``name``, a string, or ``default`` if the file states none."""
        value = self.values.get(name, default)
        if not isinstance(value, str):
            self.refuse(name, f"must be a string, got {_shown(value)}")
        return str(value)

    def texts(self, name: str) -> list[str]:
        """Return the JSON member ``name``, a list of strings; empty if the file states none."""
        values = self._list(name)
        for number, value in enumerate(values):
            if not isinstance(value, str):
                refuse(f"{self.where(name)}[{number}]", f"must be a string, got {_shown(value)}")
        return values

    def flag(self, name: str, default: bool) -> bool:
        """Return the JSON member ``name``, a truth value, or ``default`` if the file states none."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            self.refuse(name, f"must be true or false, got {_shown(value)}")
        return value

    def element(self, name: str) -> Element | None:
        """Return the JSON member ``name``, a JSON object, or None if the file states none."""
        return Element(self.values[name], self.where(name)) if name in self.values else None

    def stated_element(self, name: str) -> Element:
        """Return the JSON member ``name``, a JSON object; raise an error if the file states none."""
        return Element(self._stated(name), self.where(name))

    def elements(self, name: str) -> list[Element]:
        """Return the JSON member ``name``, a list of JSON objects; empty if the file states none."""
        return [Element(value, f"{self.where(name)}[{number}]") for number, value in enumerate(self._list(name))]

    def extension(self, name: str) -> Element | None:
        """Return the JSON object of a glTF extension in this object, or None if the extension is not used here."""
        extensions = self.element("extensions")
        return None if extensions is None else extensions.element(name)

    def _stated(self, name: str) -> object:
        if name not in self.values:
            refuse(self.place or "the JSON", f"must have a value {name!r}")
        return self.values[name]

    def _list(self, name: str) -> list[Any]:
        values = self.values.get(name, [])
        if not isinstance(values, list):
            self.refuse(name, f"must be a list, got {_shown(values)}")
        return values

    @staticmethod
    def _integer(value: object, place: str, least: int, most: int) -> int:
        # Some exporters write integers with a decimal point, such as 24.0.
        is_whole = isinstance(value, float) and math.isfinite(value) and value.is_integer()
        if isinstance(value, bool) or not (isinstance(value, int) or is_whole):
            refuse(place, f"must be an integer, got {_shown(value)}")
        number = int(value)  # type: ignore[call-overload]
        if most < least:
            refuse(place, f"refers to an element that does not exist, number {number}")
        if not least <= number <= most:
            refuse(place, f"must be an integer from {least} to {most}, got {_shown(number)}")
        return int(number)

    @staticmethod
    def _number(value: object, place: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= _MOST_NUMBER:
            refuse(place, f"must be a finite number, got {_shown(value)}")
        return float(value)


def parsed(data: bytes) -> Element:
    """Parse the text of a glTF file, and return it as a JSON object."""
    try:
        return Element(json.loads(decoded(data)), "")
    except ArgumentValueError:
        raise
    except ValueError as error:
        refuse("its JSON", f"cannot be parsed: {error}")
    except RecursionError:
        refuse("its JSON", "is nested too deeply")
