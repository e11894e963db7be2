"""Statements in header lines of text files, such as "Size: 5 µm x 4 µm": a key, and one or two numbers with units."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from warpdiff.heightfield.readers import length_units, text_keys
from warpdiff.heightfield.readers.text_keys import UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from warpdiff.heightfield.readers.text_keys import Axis, Key

# Number of characters of a header line that an error message quotes. The value was chosen because longer messages are
# hard to read.
_MOST_QUOTED = 80
# Matches a plain number, or a number with thousands signs, with or without a decimal sign.
NUMBER = (
    r"[-+]?(?:\d{1,3}(?:,\d{3})+\.\d+|\d{1,3}(?:\.\d{3})+,\d+|\d{1,3}(?:(?:,\d{3}){2,}|(?:\.\d{3}){2,})"
    r"|\d+(?:\.\d*|,\d+)?|[.,]\d+)(?:[eEdD][-+]?\d+)?"
)
_NUMBER = re.compile(rf"(?<![\w.,])(?P<number>{NUMBER})(?![.,:]?\d)")
_UNIT = re.compile(
    rf"\s*[;,\t)]?\s*(?P<open>[\[(])?\s*(?P<word>{UNIT})(?P<power>\^?-?\d)?(?!\w)"
    r"(?P<per>\s*(?:/|per\b)\s*(?:pixel|pix|px|sample|pt|point)s?\b)?(?P<other>\s*/\s*[^\W\d]\w*)?(?(open)\s*[\])])"
)
# Matches the beginning of a unit that does not begin with a letter: "%", or a letter that was damaged in the file.
_STRANGE_UNIT = re.compile(r"\s*[^\s\d,;:=()\[\]|/×*+\-–—….~]")
_PIXELS = frozenset(("px", "pix", "pixel", "pixels", "pts", "points", "samples", "píxeles", "pixeles"))
_COLUMNS, _ROWS = frozenset(("columns", "cols")), frozenset(("rows", "lines"))
# Words that may occur between the two numbers of a size in a header line, such as "x" and "by"; they are neither units
# nor keys (names of quantities).
_LINKS = frozenset(("x", "y", "by", "to", "and", "und", "et", "along", "in", "per", "axis", "direction", "at", "of"))
_PRODUCT = re.compile(r"\s*(?:[x×*]|by)\s*", re.IGNORECASE)
_LABEL = r"[(\s:]*(?:along |in )?\b([xy])\b(?:[ -](?:axis|direction))?[)\s]*[:=]?\s*"
_FIRST_LABEL = re.compile(r"(?:^|[\s(:=,;])(?:along |in )?([xy])[)\s]*[:=]?\s*$", re.IGNORECASE)
_LATER_LABEL = re.compile(rf"(?:[\s,;()]|\band\b)*{_LABEL}$", re.IGNORECASE)
_LABEL_BEHIND = re.compile(_LABEL, re.IGNORECASE)
_WORDS_X = "x|width|breite|w|columns|points|pixels|horizontal"
_WORDS_Y = "y|height|höhe|h|rows|lines|vertical"
# Matches text that says which of the two numbers of a size is along x, such as "(height x width)", "(x, y)" or "X/Y".
_ORDER = re.compile(
    rf"[(\[]?\b(?:(?P<x>{_WORDS_X})\s*[x×*,/]\s*(?:{_WORDS_Y})|(?P<y>{_WORDS_Y})\s*[x×*,/]\s*(?:{_WORDS_X}))\b[)\]]?",
    re.IGNORECASE,
)
# Matches two words in brackets that do not name x and y, such as "(slow x fast)". They state the order of the two
# numbers of a size, but not which of them is along x.
_OTHER_ORDER = re.compile(r"[(\[]\s*\w+\s*[x×*,/]\s*\w+\s*[)\]]", re.IGNORECASE)
_CLOSE_PRODUCT = re.compile(r"(?<=\d)\s*([x×*])\s*(?=\d)", re.IGNORECASE)
_TOLERANCE = re.compile(rf"(?:±|\+/-)\s*{NUMBER}\s*(?:{UNIT})?")


def quoted(line: str) -> str:
    """Return a header line in quotes, shortened, for an error message."""
    line = " ".join(line.split())
    return repr(line if len(line) <= _MOST_QUOTED else f"{line[:_MOST_QUOTED]} …")


class Signs(NamedTuple):
    """Decimal sign and thousands sign in the numbers of a text; an empty string for a sign that does not occur."""

    decimal: str
    thousands: str = ""


def value_of(text: str, signs: Signs) -> float | None:
    """Return the value of a number in a header; None if its comma or point may be a decimal or a thousands sign.

    The result is also None if the comma may separate two numbers.
    """
    points, commas = text.count("."), text.count(",")
    if points and commas:
        text = text.replace("," if text.rfind(".") > text.rfind(",") else ".", "")
    elif points + commas > 1:
        text = text.replace(".", "").replace(",", "")
    elif points + commas == 1:
        sign = "." if points else ","
        whole, _, digits = text.lstrip("+-").partition(sign)
        is_grouped = re.fullmatch(r"[1-9]\d{0,2}", whole) is not None and re.fullmatch(r"\d{3}", digits) is not None
        if is_grouped and sign == signs.thousands:
            text = text.replace(sign, "")
        elif sign != signs.decimal and whole.strip("0"):
            may_be_list = sign == "," and signs.decimal == "."
            if may_be_list or (is_grouped and sign != (signs.decimal or ".")):
                return None
    return float(text.replace(",", ".").upper().replace("D", "E"))


def certain_sign(text: str) -> str:
    """Return the decimal sign of a number; an empty string without a sign, or if it may be a thousands sign."""
    signs = re.findall(r"[.,]", text)
    if not signs or len(signs) != signs.count(signs[0]):
        return signs[-1] if signs else ""
    return "" if len(signs) > 1 or re.fullmatch(r"[-+]?[1-9]\d{0,2}[.,]\d{3}", text) else signs[0]


@dataclass
class Measure:
    """A number in a header line, with its unit.

    Attributes:
        number: Text of the number.
        unit: Size of the number's unit of length [µm]; None without a unit of length.
        per_pixel: Whether the unit is per pixel.
        counts: "pixels", "columns" or "rows" if the number counts them; "other" if it has another unit; otherwise an
            empty string.
    """

    number: str
    unit: float | None = None
    per_pixel: bool = False
    counts: str = ""


@dataclass
class Statement:
    """A key of a header line with the numbers that belong to it.

    Attributes:
        text: Text of the key.
        measures: Numbers with their units.
        between: Texts between consecutive numbers.
        tail: Text after the last number.
    """

    text: str
    measures: list[Measure]
    between: list[str] = field(default_factory=list)
    tail: str = ""

    @property
    def words(self) -> str:
        """Key of the header line, without units, axes, and words in brackets that name the order of two numbers."""
        return text_keys.words_of(_ORDER.sub(" ", self.text))

    @property
    def key(self) -> Key:
        """Meaning of the key in a header line: a size, a pitch or a number of samples, and its axis."""
        per_pixel = self._unit_of_key()[1] or any(measure.per_pixel for measure in self.measures)
        key = text_keys.key_of(self.words, per_pixel=per_pixel)
        # Words such as "(x, y)", which name the order of two numbers, also name the axes of a key such as "Step", the
        # text before the numbers.
        order = _ORDER.search(self.text)
        if key.kind or len(self.measures) != 2 or order is None:
            return key
        if not self.words and not re.search(r"\bx\W+y\b|\by\W+x\b", order[0].lower()):
            return text_keys.Key("size or count", "", names_axis=True)
        return text_keys.key_of(f"x {self.words}")._replace(axis="")

    @property
    def has_two_units(self) -> bool:
        """Whether the key of a header line and one of its numbers have different units."""
        of_key = self._unit_of_key()[0]
        return of_key is not None and any(measure.unit not in (None, of_key) for measure in self.measures)

    def _unit_of_key(self) -> tuple[float | None, bool]:
        return text_keys.unit_in_key(self.text)

    def units(self, lateral: float | None) -> list[float | None]:
        """Return the size of the unit of each number [µm].

        A number without a unit of its own gets the unit of the next number that has one, or else the unit in the key
        (text before the numbers), or else ``lateral``, the unit of all positions along x and y. None if there is no
        such unit.
        """
        of_key = self._unit_of_key()[0]
        result: list[float | None] = []
        later = None
        for measure in reversed(self.measures):
            later = later if measure.unit is None else measure.unit
            result.append(later or of_key or lateral)
        return result[::-1]

    def without(self, measures: Sequence[Measure]) -> Statement:
        """Return the statement without some of its numbers; if one number remains, all later texts become its tail."""
        rest = [measure for measure in self.measures if measure not in measures]
        tail = self.tail if len(rest) > 1 else "".join([*self.between, self.tail])
        return Statement(self.text, rest, self.between[: len(rest) - 1], tail)

    def axes(self) -> list[Axis] | None:
        """Return the axis of each number in a header line, an empty string for both axes; None if this is unclear."""
        named = self.key.axis
        if len(self.measures) == 1:
            behind = _LABEL_BEHIND.match(self.tail)
            return [named or (behind[1].lower() if behind else "")]  # type: ignore[list-item]
        if len(self.measures) != 2:
            return None
        order = _ORDER.search(self.text) or _ORDER.search(self.tail)
        if order is not None:
            return ["x", "y"] if order["x"] else ["y", "x"]
        if _OTHER_ORDER.search(self.text) or _OTHER_ORDER.search(self.tail):
            return None
        first, second = _FIRST_LABEL.search(self.text), _LATER_LABEL.fullmatch(self.between[0])
        if first is not None and second is not None and not _PRODUCT.fullmatch(self.between[0]):
            labels = [first[1].lower(), second[1].lower()]
        else:
            first, second = _LABEL_BEHIND.match(self.between[0]), _LABEL_BEHIND.match(self.tail)
            labels = [first[1].lower(), second[1].lower()] if first is not None and second is not None else []
        if sorted(labels) == ["x", "y"]:
            return labels  # type: ignore[return-value]
        return ["x", "y"] if not named and not labels and _PRODUCT.fullmatch(self.between[0]) else None


def statements_of(line: str) -> Iterator[Statement]:
    """Yield the statements of a header line, such as "Size: 5 µm x 4 µm", each with a key and its numbers."""
    line = _CLOSE_PRODUCT.sub(r" \1 ", _TOLERANCE.sub("", line))
    parts = list(_parts(line))
    if not parts:
        return
    texts, measures = [text for text, _ in parts[:-1]], [measure for _, measure in parts[:-1]]
    tail = parts[-1][0]
    start, text = 0, texts[0]
    for k in range(1, len(measures)):
        before, key = _split(texts[k])
        if _states_key(key, measures[k]):
            yield Statement(text, measures[start:k], texts[start + 1 : k], before)
            start, text = k, key
    yield Statement(text, measures[start:], texts[start + 1 :], tail)


def _states_key(text: str, measure: Measure) -> bool:
    """Whether the text between two numbers of a header line is a known key, to which the second number belongs."""
    words = text_keys.words_of(text)
    is_resolution = measure.per_pixel and len(words.split()) > 1
    return bool(text_keys.key_of(words).kind) or (is_resolution and text_keys.key_of(words, per_pixel=True).names_axis)


def _split(text: str) -> tuple[str, str]:
    """Split the text between two numbers into text that belongs to the first, and the key of the second number.

    The numbers are those of a header line. The key of a number is the text before it that names the quantity.

    The key of a number is the text before it that names the quantity.
    """
    match = re.search(r"^(.*?(?:[,;|\t)]|\s{2,}))([^,;|\t]*)$", text)
    return (match[1], match[2]) if match is not None and match[2].strip(" :=)") else ("", text)


def _parts(line: str) -> Iterator[tuple[str, Measure]]:
    """Yield the text before each number and the number with its unit, and finally the text after the last number."""
    end = 0
    previous = ""
    count = 0
    for match in _NUMBER.finditer(line):
        if match.start() < end:
            continue
        text = line[end : match.start()]
        measure = Measure(match["number"])
        end = match.end()
        follow = _UNIT.match(line, end)
        if follow is not None:
            has_key = bool(text_keys.key_of(text_keys.words_of(text or previous)).kind)
            if _add_unit(measure, follow, has_count=has_key):
                end = follow.end()
        elif _STRANGE_UNIT.match(line, end) is not None:
            measure.counts = "other"
        previous = text
        count += 1
        yield text, measure
    if count:
        yield line[end:], Measure("")


def _add_unit(measure: Measure, match: re.Match[str], *, has_count: bool) -> bool:
    """Set the unit of a number to the word after it if this word is a unit; return whether the word is a unit."""
    word = match["word"].lower()
    unit = length_units.factor_of(match["word"])
    if match["power"] or match["other"]:
        measure.counts = "other"
    elif unit is not None:
        measure.unit, measure.per_pixel = unit, match["per"] is not None
    elif word in _PIXELS:
        measure.counts = "pixels"
    elif word in _COLUMNS or word in _ROWS:
        if has_count:
            return False
        measure.counts = "columns" if word in _COLUMNS else "rows"
    elif word in _LINKS or match["open"] or re.search(r"[,;\t]", match[0]) or text_keys.key_of(word).kind:
        return False
    else:
        measure.counts = "other"
    return True
