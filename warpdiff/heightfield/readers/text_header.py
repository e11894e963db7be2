"""Header of a text export: search for sizes, pitches, the unit of heights, the channel and missing-sample codes."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING

from warpdiff.heightfield.readers import text_facts, text_keys, text_statements, text_units
from warpdiff.heightfield.readers.text_facts import Facts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.heightfield.readers.text_statements import Signs, Statement
    from warpdiff.heightfield.readers.text_table import Form

# Number of header lines that are searched for facts such as sizes and units: the last lines before the numbers.
_MOST_LINES = 400
# A header line with more characters than this is not searched for facts such as sizes, because longer lines are free
# text.
MOST_LENGTH = 400
# A header line with more numbers than this value states no sizes; it is a row of a table.
_MOST_NUMBERS = 4
_WHOLE = re.compile(r"\d{1,9}(?:\.0*)?")
_CHANNEL = re.compile(
    r"(?:channel|kanal|canal|canale|kanał|kanál|канал|チャンネル|チャネル|通道|채널)\s*[:=;,\t]\s*(?P<name>.+)",
    re.IGNORECASE,
)
_ASPECT = re.compile(r"\baspect(?: ratio)?\b[\s:=]*(?!1(?:[.,]0*)?(?:\s*[:/]\s*1(?:[.,]0*)?)?\s*$)\d", re.IGNORECASE)


def is_statement(line: str) -> bool:
    """Whether a header line states a fact, such as "heights in nm". Other lines may contain headings of columns."""
    return any(sign in line for sign in ":=") or re.search(r"\bin\b", line) is not None


def facts_of(header: Sequence[str], form: Form, signs: Signs) -> Facts:
    """Return the facts (sizes, pitches, units, channel) that the lines of a header state."""
    facts = Facts()
    lines = [_plain(line, form) for line in header[-_MOST_LINES:] if len(line) <= MOST_LENGTH]
    for line in lines:
        text_units.add_unit(facts, line, signs)
    unnamed: list[tuple[int, float]] = []
    for index, line in enumerate(lines):
        key, _, value = line.partition(":") if ":" in line else line.partition("=")
        if value.strip():
            facts.metadata.setdefault(key.strip(), value.strip())
        if (match := _CHANNEL.match(line)) and not facts.channel:
            facts.channel = match["name"].strip().strip('"')[:60]
        if _ASPECT.search(line):
            facts.add("aspect", 1.0, text_statements.quoted(line), names_axis=False)
        statements = list(text_statements.statements_of(line))
        for statement in statements:
            length = _add_statement(facts, statement, line, signs)
            if length is not None and len(statements) == 1:
                unnamed.append((index, length))
    facts.decide()
    # The program Gwyddion writes width and height in two lines before the line with the unit of the heights. The texts
    # before both numbers (keys) are in the language of the user. They are therefore recognised by the order of the
    # three lines.
    if not facts.has_scale and not facts.unclear_size and len(unnamed) == 2 and unnamed[1][0] == unnamed[0][0] + 1:
        below = text_units.LINE.fullmatch(lines[unnamed[1][0] + 1]) if unnamed[1][0] + 1 < len(lines) else None
        if below and text_keys.words_of(below["key"]) == "value units":
            facts.size_x, facts.size_y = unnamed[0][1], unnamed[1][1]
            facts.add("size_x", facts.size_x, text_statements.quoted(lines[unnamed[0][0]]), names_axis=False)
            facts.add("size_y", facts.size_y, text_statements.quoted(lines[unnamed[1][0]]), names_axis=False)
    return facts


def _plain(line: str, form: Form) -> str:
    """Return a header line without comment signs and quotes.

    Separate cells for a key, a value and a unit are joined to "key: value unit". Characters that have several forms in
    Unicode, such as µ, Å, ㎚ and the wide colon, get the usual form.
    """
    line = unicodedata.normalize("NFKC", line.strip().lstrip("#%;/*'!\\ \t").strip()).replace("μ", "µ")
    if form.separator in (",", ";", "\t") and form.separator in line:
        cells = [cell.strip('"') for cell in form.cells(line)]
        filled = [cell for cell in cells if cell]
        if len(filled) in (2, 3) and not any(sign in filled[0] for sign in ":="):
            return f"{filled[0]}: {' '.join(filled[1:])}"
    return line.replace('"', "")


def _add_statement(facts: Facts, statement: Statement, line: str, signs: Signs) -> float | None:
    """Add to ``facts`` the numbers that a header line states, such as a size or a number of columns.

    If the words before a single number are no known key, and the number is a length, return it [µm]; otherwise None.
    """
    if text_keys.states_no_data(statement.words):
        _add_no_data(facts, statement, line, signs)
        return None
    key, measures = statement.key, statement.measures
    for measure in measures:
        sign = text_statements.certain_sign(measure.number)
        if sign and (measure.unit is not None or key.kind):
            facts.signs.setdefault(sign, text_statements.quoted(line))
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
    """Whether all numbers in a header line are whole and have no unit, as numbers of rows and columns do."""
    units = statement.units(facts.lateral if statement.key.kind != "count" else None)
    return all(
        unit is None and measure.counts != "other" and _WHOLE.fullmatch(measure.number)
        for unit, measure in zip(units, statement.measures, strict=True)
    )


def _add_counts(facts: Facts, statement: Statement, line: str) -> None:
    """Add to ``facts`` the numbers of columns and rows that a header line states, if it is clear which is which."""
    key, measures = statement.key, statement.measures
    axes = ["x" if measure.counts == "columns" else "y" if measure.counts == "rows" else "" for measure in measures]
    if not any(axes):
        is_pair = len(measures) == 2 and not key.axis and (key.kind != "" or not statement.words)
        axes = list(statement.axes() or "xy") if is_pair else [key.axis] * len(measures)
    elif axes == ["y"]:
        # A line that states only a number of lines is ignored. In "Header: 5 lines", for example, the number is not
        # that of the rows of the matrix.
        return
    for axis, measure in zip(axes, measures, strict=True):
        if axis and _WHOLE.fullmatch(measure.number):
            facts.counts.append((axis, int(float(measure.number)), text_statements.quoted(line)))


def _add_no_data(facts: Facts, statement: Statement, line: str, signs: Signs) -> None:
    """Add to ``facts`` the codes of missing samples that a line states.

    A line such as "Missing: 6" may state how many samples are missing, and not their code. This is possible only if the
    number is whole and positive.
    """
    is_code = text_keys.states_code(statement.words)
    for measure in statement.measures:
        value = text_statements.value_of(measure.number, signs)
        if value is not None and not measure.counts and (is_code or measure.unit is None):
            is_certain = is_code or _WHOLE.fullmatch(measure.number) is None
            facts.no_data.append((value, is_certain, text_statements.quoted(line)))


def _add_lengths(facts: Facts, statement: Statement, line: str, signs: Signs) -> None:
    """Add to ``facts`` the sizes or pitches that a header line states, or the reason why the line is not clear."""
    key = statement.key
    # In a size such as "6 µm (12 px)" or "0.006 mm (6 µm)", the number in brackets is a number of samples or the same
    # size in another unit.
    pixels = [measure for measure in statement.measures if measure.counts == "pixels"]
    if pixels and len(pixels) < len(statement.measures):
        statement = statement.without(pixels)
    values = [text_statements.value_of(measure.number, signs) for measure in statement.measures]
    units, axes = statement.units(facts.lateral), statement.axes()
    lengths = [unit * value for unit, value in zip(units, values, strict=True) if None not in (unit, value)]  # type: ignore[operator]
    if (
        len(lengths) == 2
        and lengths[1] > 0.0
        and abs(lengths[0] / lengths[1] - 1.0) <= text_facts.MOST_DIFFERENCE
        and axes is None
    ):
        lengths, axes = lengths[:1], [key.axis]
    if len(values) > _MOST_NUMBERS:
        return
    if None in values:
        facts.unclear_size = (
            facts.unclear_size or f"the sign in {text_statements.quoted(line)} may not be a decimal sign"
        )
    elif all(unit is None for unit in units):
        facts.without_unit = facts.without_unit or f"{text_statements.quoted(line)} has no unit of length"
    elif (
        statement.has_two_units
        or axes is None
        or len(lengths) != len(axes)
        or any(measure.counts for measure in statement.measures)
    ):
        facts.unclear_size = facts.unclear_size or f"{text_statements.quoted(line)} is not clear"
    elif min(lengths) > 0.0:
        kind = "pitch" if key.kind == "pitch" else "size"
        for axis, length in zip(axes, lengths, strict=True):
            names_axis = key.names_axis or len(axes) == 2 or axis != key.axis
            if not axis and kind == "size":
                facts.add("size_of_both", length, text_statements.quoted(line), names_axis=False)
            for letter in axis or ("xy" if kind == "pitch" else ""):
                facts.add(f"{kind}_{letter}", length, text_statements.quoted(line), names_axis=names_axis)
