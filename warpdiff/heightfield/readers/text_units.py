"""Header lines of text files that state a unit of heights, a unit of positions x and y, or a factor of heights."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from warpdiff.heightfield.readers import length_units, text_keys, text_statements
from warpdiff.heightfield.readers.text_keys import UNIT
from warpdiff.heightfield.readers.text_statements import NUMBER, quoted

if TYPE_CHECKING:
    from warpdiff.heightfield.readers.text_facts import Facts
    from warpdiff.heightfield.readers.text_statements import Signs

# Matches a header line "key: value"; the separator may also be an equals sign, a semicolon or a tab.
LINE = re.compile(r"(?P<key>[^:=;\t]*[^\W\d_][^:=;\t]*?)\s*[:=;\t]\s*(?P<value>.*)")
_PER_COUNT = r"(?:\s*(?:/|per\b)\s*(?:lsb|digit|count|bit|dn|level|unit|step|inc|increment)s?\b)"
# Matches the value of a line that states a unit of heights, such as "nm", "10 nm" or "0.5 nm/LSB".
_VALUE = re.compile(rf"(?:(?P<number>{NUMBER})\s*)?(?P<unit>{UNIT})(?P<per>{_PER_COUNT})?", re.IGNORECASE)
_CONVERSION = re.compile(
    rf"height conversion factor\s*\(\s*-?>?\s*(?P<unit>{UNIT})\s*\)\s*[:=]\s*(?P<number>{NUMBER})", re.IGNORECASE
)
_HEIGHTS_IN = re.compile(
    rf"\b(?:z|heights?|höhen?|hauteurs?|altezz[ae]|alturas?|topography|depths?|elevations?|values?|data)\b"
    rf"[^\[(\d]{{0,30}}?(?:[\[(]\s*(?P<bracket>{UNIT})(?:{_PER_COUNT})?\s*[\])]"
    rf"|\bin\s+(?:units?\s+of\s+)?(?:(?P<number>{NUMBER})\s*)?(?P<word>{UNIT})\b)",
    re.IGNORECASE,
)
_ENDS_IN_NUMBER = re.compile(rf"[:=]\s*{NUMBER}\s*$")
_ONE = re.compile(r"\+?1(?:[.,]0*)?(?:[eE][-+]?0+)?")
# Matches a sentence with a factor of the heights, such as "Multiply values by 0.5" or "z = value * 0.5".
_MULTIPLY = re.compile(
    rf"\b(?:multipl(?:y|ied|iz)|divided?\b|scaled by\b).*{NUMBER}|\bvalues?\s*[*×]|[*×]\s*values?\b", re.IGNORECASE
)
# Matches a line that states the height of one count of the instrument's converter, such as "1 LSB = 0.5 nm".
_COUNT_IS = re.compile(
    rf"1\s*(?:lsb|digit|count|bit|dn)\s*(?:=|:|is)\s*(?P<number>{NUMBER})\s*(?P<unit>{UNIT})\W*", re.IGNORECASE
)


def add_unit(facts: Facts, line: str, signs: Signs) -> None:
    """Add to ``facts`` the unit of heights, the unit of x and y, or the factor of heights that a header line states."""
    if match := _CONVERSION.search(line) or _COUNT_IS.fullmatch(line):
        _add_unit_z(facts, line, match["unit"], match["number"], signs)
        return
    match = LINE.fullmatch(line)
    key, text = (match["key"], match["value"].strip().strip("[]();, ").strip()) if match else ("", "")
    words, value = text_keys.words_of(key), _VALUE.fullmatch(text)
    if text_keys.states_unit_xy(words) and length_units.factor_of(text) is not None:
        _add_unit_xy(facts, line, text)
    elif words == "z amplitude" and value is not None and value["number"]:
        # The program WSxM writes the range of the heights ("Z Amplitude") with a unit, which is also the unit of the
        # heights.
        _add_unit_z(facts, line, value["unit"], None, signs)
    elif text and text_keys.states_unit_z(words, is_plain=value is not None and not value["number"]):
        _add_stated_unit(facts, line, words, text, signs)
    elif text_keys.states_factor(words) or (value is not None and value["number"] and value["per"]):
        _add_factor(facts, line, key, text, signs)
    elif _MULTIPLY.search(line):
        facts.factor_line = quoted(line)
    # A line such as "Height [µm]: 10" states the size of the field along y, and not the unit of the heights.
    elif not _ENDS_IN_NUMBER.search(line):
        _add_heights_in(facts, line, signs)


def _add_unit_xy(facts: Facts, line: str, text: str) -> None:
    """Add to ``facts`` the unit of lengths along x, y or both; two different units contradict each other."""
    unit = length_units.factor_of(text)
    if facts.lateral not in (None, unit):
        facts.unclear_size = f"{quoted(line)} contradicts another unit"
    facts.lateral = unit


def _add_stated_unit(facts: Facts, line: str, words: str, text: str, signs: Signs) -> None:
    """Add the unit of the heights from a header line "key: value" whose key says that the value is this unit."""
    value = _VALUE.fullmatch(text)
    if value is not None or length_units.factor_of(text) is not None:
        name, number = (value["unit"], value["number"]) if value is not None else (text, None)
        _add_unit_z(facts, line, name, number, signs)
        if words in text_keys.GLOBAL_UNITS and not number:
            facts.global_unit = length_units.factor_of(name)
    elif not _add_heights_in(facts, line, signs):
        has_length = any(length_units.factor_of(token) is not None for token in re.findall(UNIT, text))
        if has_length and (text[0].isdigit() or not re.search(r"[/^\d]", text)):
            facts.unclear_unit = f"{quoted(line)} is not clear"
        else:
            facts.not_length = facts.not_length or text


def _add_heights_in(facts: Facts, line: str, signs: Signs) -> bool:
    """Add to ``facts`` the unit in a text such as "heights in nm" or "Z [µm]"; return whether there is such a text."""
    has_unit = False
    for match in _HEIGHTS_IN.finditer(line):
        text = match["bracket"] or match["word"]
        if length_units.factor_of(text) is not None:
            _add_unit_z(facts, line, text, match["number"], signs)
            has_unit = True
    return has_unit


def _add_unit_z(facts: Facts, line: str, text: str, number: str | None, signs: Signs) -> None:
    """Add to ``facts`` a unit of the heights, or a multiple such as "0.5 nm", that a header line states."""
    unit, factor = length_units.factor_of(text), 1.0 if number is None else text_statements.value_of(number, signs)
    if unit is None:
        facts.not_length = facts.not_length or text
    elif factor is None or not factor > 0.0:
        facts.unclear_unit = f"{quoted(line)} is not clear"
    else:
        facts.units.setdefault(factor * unit, quoted(line))


def _add_factor(facts: Facts, line: str, key: str, text: str, signs: Signs) -> None:
    """Add a factor of the heights: a length per count of the instrument is a unit; other factors are not applied."""
    value = _VALUE.fullmatch(text)
    in_key = re.search(rf"[\[(]\s*(?P<unit>{UNIT}){_PER_COUNT}\s*[\])]", key, re.IGNORECASE)
    if value is not None and value["number"] and value["per"]:
        _add_unit_z(facts, line, value["unit"], value["number"], signs)
    elif in_key is not None and re.fullmatch(NUMBER, text):
        _add_unit_z(facts, line, in_key["unit"], text, signs)
    elif re.match(NUMBER, text) and not _ONE.fullmatch(text):
        facts.factor_line = quoted(line)
