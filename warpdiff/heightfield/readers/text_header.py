"""Facts of the header of a text export: sizes and pitches with their units, unit of heights, channel, gaps."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield.readers import length_units, text_keys, text_statements
from warpdiff.heightfield.readers.reader_registry import refusal
from warpdiff.heightfield.readers.text_keys import UNIT
from warpdiff.heightfield.readers.text_statements import NUMBER

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from warpdiff.heightfield.readers.text_statements import Signs, Statement
    from warpdiff.heightfield.readers.text_table import Form

# Number of header lines that are searched for facts: the last ones before the numbers.
_MOST_LINES = 400
# Largest relative difference of two statements of the same length that count as equal. If doubled, contradictions pass
# more often.
_MOST_DIFFERENCE = 1e-3
# Number of characters above which a header line is not searched. Limit: longer lines are free text.
MOST_LENGTH = 400
# Number of characters of a header line that an error message quotes. Limit: a longer message is unreadable.
_MOST_QUOTED = 80
# Largest ratio of the pitches along x and y that is accepted from a header. A larger one suggests that the header
# states the range of the heights and not a size. If doubled, more such ranges are mistaken for sizes.
_MOST_ASPECT = 50.0
# Largest relative difference between the size that a header states and its number of samples times its pitch. If
# doubled, more contradictions are accepted.
_MOST_RATIO = 0.01
# Absolute value above which a code of missing samples is compared with a tolerance, and that relative tolerance: such
# codes are limits of number types, which programs round. Limit: no height has this size in any unit.
_LEAST_ROUNDED_CODE, _MOST_CODE_DIFFERENCE = 1e30, 1e-5
# Number of numbers in a line above which it is no statement of sizes, but a row of a table.
_MOST_NUMBERS = 4
_PER_COUNT = r"(?:\s*(?:/|per\b)\s*(?:lsb|digit|count|bit|dn|level|unit|step|inc|increment)s?\b)"
# Matches the value of a line that states a unit of heights, such as "nm", "[nm]", "10 nm" or "0.5 nm/LSB".
_UNIT_VALUE = re.compile(rf"(?:(?P<number>{NUMBER})\s*)?(?P<unit>{UNIT})(?P<per>{_PER_COUNT})?", re.IGNORECASE)
_LINE = re.compile(r"(?P<key>[^:=;\t]*[^\W\d_][^:=;\t]*?)\s*[:=;\t]\s*(?P<value>.*)")
_CONVERSION = re.compile(
    rf"height conversion factor\s*\(\s*-?>?\s*(?P<unit>{UNIT})\s*\)\s*[:=]\s*(?P<number>{NUMBER})", re.IGNORECASE
)
_HEIGHTS_IN = re.compile(
    rf"\b(?:z|heights?|höhen?|hauteurs?|altezz[ae]|alturas?|topography|depths?|elevations?|values?|data)\b"
    rf"[^\[(\d]{{0,30}}?(?:[\[(]\s*(?P<bracket>{UNIT})(?P<per>{_PER_COUNT})?\s*[\])]"
    rf"|\bin\s+(?:units?\s+of\s+)?(?:(?P<number>{NUMBER})\s*)?(?P<word>{UNIT})\b)",
    re.IGNORECASE,
)
_ENDS_IN_NUMBER = re.compile(rf"[:=]\s*(?P<number>{NUMBER})\s*$")
# Matches a sentence such as "Multiply values by 0.5".
_MULTIPLY = re.compile(rf"\b(?:multipl(?:y|ied|iz)|divided?\b).*{NUMBER}", re.IGNORECASE)
_CHANNEL = re.compile(
    r"(?:channel|kanal|canal|canale|kanał|kanál|канал|チャンネル|チャネル|通道|채널)\s*[:=;,\t]\s*(?P<name>.+)",
    re.IGNORECASE,
)
_ASPECT = re.compile(r"\baspect(?: ratio)?\b[\s:=]*(?!1(?:[.,]0*)?(?:\s*[:/]\s*1(?:[.,]0*)?)?\s*$)\d", re.IGNORECASE)


@dataclass
class Facts:
    """Facts that the header of a text states. Lengths are in µm. None means that the header does not state a fact.

    Attributes:
        size_x: Width of the field.
        size_y: Height of the field.
        size_of_both: Size of the field, if the header states one size for both axes.
        pitch_x: Distance of samples along x.
        pitch_y: Distance of samples along y.
        counts: Number of columns ("x") and rows ("y"), each with its header line.
        units: Sizes of all units that the header states for the heights. Several ones contradict each other.
        factor_line: Line with a factor of the heights that is not applied. The file is refused. An empty string if
            there is none.
        not_length: Unit of the values if it is no unit of length, such as V; an empty string if there is none.
        lateral: Size of the unit of the positions along x and y.
        global_unit: Size of the unit of all numbers of the file, heights and positions, if there is one.
        channel: Name of the channel; an empty string if it is not stated.
        no_data: Numbers that the header states as codes of missing samples, each with its line.
        metadata: Lines "key: value", as text.
        signs: Decimal signs of the header's numbers that are certainly no thousands signs.
        unclear_size: Reason why a line about the size or the pitch was not read, for an error message.
        without_unit: Reason why a line about the size or the pitch without a unit was not read.
        unclear_unit: Reason why a line about the unit of the heights was not read, for an error message.
    """

    size_x: float | None = None
    size_y: float | None = None
    size_of_both: float | None = None
    pitch_x: float | None = None
    pitch_y: float | None = None
    counts: list[tuple[str, int, str]] = field(default_factory=list)
    units: dict[float, str] = field(default_factory=dict)
    factor_line: str = ""
    not_length: str = ""
    lateral: float | None = None
    global_unit: float | None = None
    channel: str = ""
    no_data: list[tuple[float, str]] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    signs: dict[str, str] = field(default_factory=dict)
    unclear_size: str = ""
    without_unit: str = ""
    unclear_unit: str = ""
    _stated: dict[str, list[tuple[bool, float, str]]] = field(default_factory=dict)

    def add(self, name: str, length: float, line: str, *, names_axis: bool) -> None:
        """Add the length that a header line states for the fact ``name``, a size or a pitch.

        ``names_axis`` is whether the key of the line names x or y. Such statements outweigh keys like "Height" or
        "Spacing".
        """
        self._stated.setdefault(name, []).append((names_axis, length, line))

    def decide(self) -> None:
        """Set each size and pitch for which the header lines state equal lengths; contradictory lines set nothing."""
        for name, statements in self._stated.items():
            strongest = max(names_axis for names_axis, *_ in statements)
            strong = sorted((length, line) for names_axis, length, line in statements if names_axis == strongest)
            if strong[-1][0] <= (1.0 + _MOST_DIFFERENCE) * strong[0][0]:
                setattr(self, name, strong[0][0])
            else:
                self.unclear_size = self.unclear_size or f"{strong[0][1]} contradicts {strong[-1][1]}"
        if self.size_of_both is not None and "aspect" in self._stated:
            self.unclear_size = f"{self._stated['aspect'][0][2]} states an aspect ratio"

    def line_of(self, name: str) -> str:
        """Return the quoted line that states a size or a pitch."""
        return next(line for _, length, line in self._stated[name] if length == getattr(self, name))

    def merge(self, first: Facts) -> None:
        """Take the facts that this header does not state from those of the file's first header."""
        if not self.has_scale and not self.unclear_size:
            for name in (
                "size_x",
                "size_y",
                "size_of_both",
                "pitch_x",
                "pitch_y",
                "unclear_size",
                "without_unit",
                "_stated",
            ):
                setattr(self, name, getattr(first, name))
        if not self.units and not self.not_length and not self.unclear_unit:
            self.units, self.unclear_unit = first.units, first.unclear_unit
        self.factor_line = self.factor_line or first.factor_line
        self.no_data = self.no_data or first.no_data
        self.signs = {**first.signs, **self.signs}

    @property
    def has_scale(self) -> bool:
        """Whether the header states the size, or the pitch, along both axes."""
        return None not in (self.size_x, self.size_y) or None not in (self.pitch_x, self.pitch_y)

    @property
    def unit(self) -> float | None:
        """Size of the unit of heights [µm]; None if the header does not state one, or states two different ones."""
        return next(iter(self.units)) if len(self.units) == 1 and not self.unclear_unit else None

    @property
    def why_no_unit(self) -> str:
        """Reason why the unit of the heights is not known, for an error message; or an empty string."""
        if len(self.units) > 1:
            lines = list(self.units.values())
            return f"{lines[0]} contradicts {lines[1]}" if lines[0] != lines[1] else f"{lines[0]} states two units"
        return self.unclear_unit


def is_statement(line: str) -> bool:
    """Whether a header line states a fact, such as "heights in nm". Otherwise it may contain headings of columns."""
    return any(sign in line for sign in ":=") or re.search(r"\bin\b", line) is not None


def quoted(line: str) -> str:
    """Return a header line in quotes, shortened, for an error message."""
    line = " ".join(line.split())
    return repr(line if len(line) <= _MOST_QUOTED else f"{line[:_MOST_QUOTED]} …")


def facts_of(header: Sequence[str], form: Form, signs: Signs) -> Facts:
    """Return the facts (sizes, pitches, units, channel) that the lines of a header state."""
    facts = Facts()
    lines = [plain(line, form) for line in header[-_MOST_LINES:] if len(line) <= MOST_LENGTH]
    for line in lines:
        _add_unit(facts, line, signs)
    unnamed: list[tuple[int, float]] = []
    for index, line in enumerate(lines):
        key, _, value = line.partition(":") if ":" in line else line.partition("=")
        if value.strip():
            facts.metadata.setdefault(key.strip(), value.strip())
        if (match := _CHANNEL.match(line)) and not facts.channel:
            facts.channel = match["name"].strip().strip('"')[:60]
        if _ASPECT.search(line):
            facts.add("aspect", 1.0, quoted(line), names_axis=False)
        statements = list(text_statements.statements_of(line))
        for statement in statements:
            length = _add_statement(facts, statement, line, signs)
            if length is not None and len(statements) == 1:
                unnamed.append((index, length))
    facts.decide()
    # The program Gwyddion writes width and height in two lines before the unit of the heights. It translates the keys
    # of these lines, so that they are recognised by their order.
    if not facts.has_scale and not facts.unclear_size and len(unnamed) == 2 and unnamed[1][0] == unnamed[0][0] + 1:
        below = _LINE.fullmatch(lines[unnamed[1][0] + 1]) if unnamed[1][0] + 1 < len(lines) else None
        if below and text_keys.words_of(below["key"]) == "value units":
            facts.size_x, facts.size_y = unnamed[0][1], unnamed[1][1]
            facts.add("size_x", facts.size_x, quoted(lines[unnamed[0][0]]), names_axis=False)
            facts.add("size_y", facts.size_y, quoted(lines[unnamed[1][0]]), names_axis=False)
    return facts


def plain(line: str, form: Form) -> str:
    """Return a header line without comment signs and quotes.

    Separate cells for a key, a value and a unit are joined to "key: value unit". Characters with several forms, such
    as µ, Å, ㎚ and the wide colon, get the usual one.
    """
    line = unicodedata.normalize("NFKC", line.strip().lstrip("#%;/*'!\\ \t").strip()).replace("μ", "µ")
    if form.separator in (",", ";", "\t") and form.separator in line:
        cells = [cell.strip('"') for cell in form.cells(line)]
        filled = [cell for cell in cells if cell]
        if len(filled) in (2, 3) and not any(sign in filled[0] for sign in ":="):
            return f"{filled[0]}: {' '.join(filled[1:])}"
    return line.replace('"', "")


def _add_unit(facts: Facts, line: str, signs: Signs) -> None:
    """Add the unit of heights, or of lengths along x and y, that a line states, or a factor of the heights."""
    if match := _CONVERSION.search(line):
        _add_unit_z(facts, line, match["unit"], match["number"], signs)
        return
    match = _LINE.fullmatch(line)
    words = text_keys.words_of(match["key"]) if match else ""
    text = match["value"].strip().strip("[]();, ").strip() if match else ""
    value = _UNIT_VALUE.fullmatch(text)
    if text_keys.states_unit_xy(words) and value and (unit := length_units.factor_of(value["unit"])) is not None:
        if facts.lateral not in (None, unit):
            facts.unclear_size = f"{quoted(line)} contradicts another unit"
        facts.lateral = unit
    elif words == "z amplitude" and value is not None and value["number"]:
        # The program WSxM writes the range of the heights ("Z Amplitude") with a unit, which is also the unit of the
        # heights.
        _add_unit_z(facts, line, value["unit"], None, signs)
    elif text and text_keys.states_unit_z(words, is_plain=value is not None and not value["number"]):
        if value is not None or length_units.factor_of(text) is not None:
            name, number = (value["unit"], value["number"]) if value is not None else (text, None)
            _add_unit_z(facts, line, name, number, signs)
            if words in text_keys.GLOBAL_UNITS and not number:
                facts.global_unit = length_units.factor_of(name)
        elif not _add_heights_in(facts, line, signs):
            tokens = re.findall(UNIT, text)
            if any(length_units.factor_of(token) is not None for token in tokens) and not re.search(r"[/^²³\d]", text):
                facts.unclear_unit = f"{quoted(line)} is not clear"
            else:
                facts.not_length = facts.not_length or text
    elif text_keys.states_factor(words):
        _add_factor(facts, line, match["key"], text, signs)  # type: ignore[index]
    elif _MULTIPLY.search(line):
        facts.factor_line = quoted(line)
    # A line such as "Height [µm]: 10" states the size of the field along y, and not the unit of the heights.
    elif not _ENDS_IN_NUMBER.search(line):
        _add_heights_in(facts, line, signs)


def _add_heights_in(facts: Facts, line: str, signs: Signs) -> bool:
    """Add the units in texts such as "heights in nm" or "Z [µm]", and return whether there is one."""
    has_unit = False
    for match in _HEIGHTS_IN.finditer(line):
        text = match["bracket"] or match["word"]
        if length_units.factor_of(text) is not None:
            _add_unit_z(facts, line, text, match["number"], signs)
            has_unit = True
    return has_unit


def _add_unit_z(facts: Facts, line: str, text: str, number: str | None, signs: Signs) -> None:
    """Add a unit of the heights, or a number of such units."""
    unit, factor = length_units.factor_of(text), 1.0 if number is None else text_statements.value_of(number, signs)
    if unit is None:
        facts.not_length = facts.not_length or text
    elif factor is None or not factor > 0.0:
        facts.unclear_unit = f"{quoted(line)} is not clear"
    else:
        facts.units.setdefault(factor * unit, quoted(line))


def _add_factor(facts: Facts, line: str, key: str, text: str, signs: Signs) -> None:
    """Add a factor of the heights: a length per count is a unit, and other factors except 1 are not applied."""
    value = _UNIT_VALUE.fullmatch(text)
    in_key = re.search(rf"[\[(]\s*(?P<unit>{UNIT}){_PER_COUNT}\s*[\])]", key, re.IGNORECASE)
    if value is not None and value["number"] and value["per"]:
        _add_unit_z(facts, line, value["unit"], value["number"], signs)
    elif in_key is not None and re.fullmatch(NUMBER, text):
        _add_unit_z(facts, line, in_key["unit"], text, signs)
    elif re.match(NUMBER, text) and not re.fullmatch(r"\+?1(?:[.,]0*)?(?:[eE][-+]?0+)?", text):
        facts.factor_line = quoted(line)


def _add_statement(facts: Facts, statement: Statement, line: str, signs: Signs) -> float | None:
    """Add to ``facts`` the numbers that a line states. If its key is not known, return its length [µm] instead."""
    if kind := text_keys.states_no_data(statement.words):
        _add_no_data(facts, statement, line, kind == "value", signs)
        return None
    key, measures = statement.key, statement.measures
    for measure in measures:
        sign = text_statements.certain_sign(measure.number)
        if sign and (measure.unit is not None or key.kind):
            facts.signs.setdefault(sign, quoted(line))
    is_counted = measures[-1].counts == "pixels" and all(measure.counts == "" for measure in measures[:-1])
    if (
        (is_counted and not statement.units(None)[0])
        or all(m.counts in ("pixels", "columns", "rows") for m in measures)
        or (key.kind in ("count", "size or count") and _are_counts(statement, facts))
    ):
        _add_counts(facts, statement, line)
        return None
    if key.kind in ("count", "") or all(measure.counts for measure in measures):
        is_length = key.kind == "" and len(measures) == 1 and not measures[0].counts
        unit = statement.units(None)[0] if is_length else None
        value = text_statements.value_of(measures[0].number, signs)
        return unit * value if unit is not None and value is not None and value > 0.0 else None
    _add_lengths(facts, statement, line, signs)
    return None


def _are_counts(statement: Statement, facts: Facts) -> bool:
    """Whether all numbers of a statement are whole and have no unit."""
    units = statement.units(facts.lateral if statement.key.kind != "count" else None)
    return all(
        unit is None and measure.counts != "other" and re.fullmatch(r"\d{1,9}(?:\.0*)?", measure.number)
        for unit, measure in zip(units, statement.measures, strict=True)
    )


def _add_counts(facts: Facts, statement: Statement, line: str) -> None:
    """Add the numbers of columns and rows that a line states, if their axes are clear."""
    key, measures = statement.key, statement.measures
    axes = ["x" if measure.counts == "columns" else "y" if measure.counts == "rows" else "" for measure in measures]
    if not any(axes):
        is_pair = len(measures) == 2 and not key.axis and (key.kind != "" or not statement.words)
        axes = list(statement.axes() or "xy") if is_pair else [key.axis] * len(measures)
    elif axes == ["y"]:
        # A number of lines alone, such as "Header: 5 lines", may not be that of the matrix.
        return
    for axis, measure in zip(axes, measures, strict=True):
        if axis and re.fullmatch(r"\d{1,9}(?:\.0*)?", measure.number):
            facts.counts.append((axis, int(float(measure.number)), quoted(line)))


def _add_no_data(facts: Facts, statement: Statement, line: str, is_code: bool, signs: Signs) -> None:  # noqa: FBT001
    """Add the code of missing samples that a line states.

    A word such as "Missing" alone may also state how many samples are missing: then the number is whole and positive.
    """
    number = statement.measures[0].number
    value = text_statements.value_of(number, signs)
    if len(statement.measures) != 1 or statement.measures[0].counts or value is None:
        return
    if is_code or not re.fullmatch(r"\d{1,9}", number):
        facts.no_data.append((value, quoted(line)))


def _add_lengths(facts: Facts, statement: Statement, line: str, signs: Signs) -> None:
    """Add to ``facts`` the sizes or pitches that a line states; a line that is not clear is named there."""
    key = statement.key
    # A second number in brackets, such as "6 µm (12 px)" or "0.006 mm (6 µm)", is a number of samples or the same size.
    pixels = [measure for measure in statement.measures if measure.counts == "pixels"]
    if pixels and len(pixels) < len(statement.measures):
        statement = statement.without(pixels)
    values = [text_statements.value_of(measure.number, signs) for measure in statement.measures]
    units, axes = statement.units(facts.lateral), statement.axes()
    lengths = [unit * value for unit, value in zip(units, values, strict=True) if None not in (unit, value)]  # type: ignore[operator]
    if (
        len(lengths) == 2
        and lengths[1] > 0.0
        and abs(lengths[0] / lengths[1] - 1.0) <= _MOST_DIFFERENCE
        and axes is None
    ):
        lengths, axes = lengths[:1], [key.axis]
    if len(values) > _MOST_NUMBERS:
        return
    if None in values:
        facts.unclear_size = facts.unclear_size or f"the sign in {quoted(line)} may not be a decimal sign"
    elif all(unit is None for unit in units):
        facts.without_unit = facts.without_unit or f"{quoted(line)} has no unit of length"
    elif axes is None or len(lengths) != len(axes) or any(measure.counts for measure in statement.measures):
        facts.unclear_size = facts.unclear_size or f"{quoted(line)} is not clear"
    elif min(lengths) > 0.0:
        kind = "pitch" if key.kind == "pitch" else "size"
        for axis, length in zip(axes, lengths, strict=True):
            names_axis = key.names_axis or len(axes) == 2 or axis != key.axis
            if not axis and kind == "size":
                facts.add("size_of_both", length, quoted(line), names_axis=False)
            for letter in axis or ("xy" if kind == "pitch" else ""):
                facts.add(f"{kind}_{letter}", length, quoted(line), names_axis=names_axis)


def require_length(file: Path, facts: Facts) -> None:
    """Raise an error if the header states that the values are no lengths."""
    if facts.not_length and facts.unit is None:
        raise refusal(file, f"has values in {facts.not_length[:20]!r}, which is no unit of length; export the heights")


def without_codes(heights: np.ndarray, facts: Facts) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return heights with NaN instead of the codes of missing samples, and sentences for the history of the field."""
    notes = []
    for code, line in facts.no_data:
        is_code = np.isclose(
            heights, code, rtol=_MOST_CODE_DIFFERENCE if abs(code) > _LEAST_ROUNDED_CODE else 0.0, atol=0.0
        )
        if count := int(np.count_nonzero(is_code)):
            heights = np.where(is_code, np.nan, heights)
            notes.append(f"Loaded: read {count} samples as missing, as the header states in the line {line}.")
    return heights, tuple(notes)


def pitch_of(facts: Facts, nx: int, ny: int) -> tuple[tuple[float, float] | None, str]:
    """Return the pitch (dy, dx) [µm] that a header states, and the reason if it states none, for an error message."""
    if facts.unclear_size:
        return None, facts.unclear_size
    for axis, count in (("x", nx), ("y", ny)):
        if contradict(getattr(facts, f"size_{axis}"), getattr(facts, f"pitch_{axis}"), count):
            return None, (
                f"{facts.line_of(f'size_{axis}')} contradicts {facts.line_of(f'pitch_{axis}')} for {count} samples"
            )
    dx = facts.pitch_x or (facts.size_x / nx if facts.size_x else None)
    dy = facts.pitch_y or (facts.size_y / ny if facts.size_y else None)
    # A header may state one size without an axis. It is used only if both axes have equally many samples, because it is
    # ambiguous otherwise.
    reason = facts.without_unit
    if facts.size_of_both is not None and nx == ny:
        dx, dy = dx or facts.size_of_both / nx, dy or facts.size_of_both / ny
    elif facts.size_of_both is not None:
        reason = f"{facts.line_of('size_of_both')} states one size for {nx} × {ny} samples (x × y)"
    # If the pitch along y is more than 50 times the pitch along x, or less than 1/50 of it, the "height" in the header
    # is probably the range of the heights and not the size along y.
    is_likely = dx is not None and dy is not None and dx / _MOST_ASPECT <= dy <= dx * _MOST_ASPECT
    return ((dy, dx), "") if is_likely else (None, reason)  # type: ignore[return-value]


def contradict(size: float | None, pitch: float | None, count: int) -> bool:
    """Whether a size contradicts a pitch: ``count`` pitches, or one less, do not give the size."""
    if size is None or pitch is None:
        return False
    return not (1.0 - _MOST_RATIO) * (count - 1) <= size / pitch <= (1.0 + _MOST_RATIO) * count
