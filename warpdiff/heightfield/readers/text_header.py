"""Facts of the header of a text export: sizes and pitches with their units, unit of heights, channel, columns."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from warpdiff.heightfield.readers import length_units

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from warpdiff.heightfield.readers.text_table import Form

# Number of header lines that are searched for facts: the last ones before the numbers.
_MOST_LINES = 400
# Largest relative difference of two statements of the same length that count as equal. If doubled, contradictions pass
# more often.
_MOST_DIFFERENCE = 1e-3
# Number of characters above which a header line is not searched. Limit: longer lines are free text.
_MOST_LENGTH = 400
_NUMBER = r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eEdD][-+]?\d+)?"
_UNIT = r"[A-Za-zµμÅåÂ\u212b][A-Za-zµμÅåèö]*"
_PER_PIXEL = r"\s*/\s*(?:pixel|pix|px|sample|samples|pt|point)\b"
# Matches a key with a number and perhaps a unit, such as "Width: 10 µm", "pixel size=0.1 um" or "XY calibration 277.3
# nm/pixel".
_STATEMENT = re.compile(
    rf"(?P<key>[^\W\d_][^:=;\t]*?)\s*[:=\t;]\s*(?P<number>{_NUMBER})(?![\w.,]*[.:/]\d)"
    rf"(?:\s*[;,\t]?\s*[\[(]?(?P<unit>{_UNIT})[\])]?(?P<per>{_PER_PIXEL})?)?"
)
_SPACED = re.compile(
    rf"(?P<key>[^\W\d_][^:=;\t\d]*?)\s+(?P<number>{_NUMBER})\s*(?P<unit>{_UNIT})(?P<per>{_PER_PIXEL})?$"
)
# Matches a key with two numbers, such as "Scan size: 10 x 8 µm" or "Size = 10 µm × 8 µm".
_PAIR = re.compile(
    rf"(?P<key>[^\W\d_][^:=]*?)\s*[:=]\s*(?P<x>{_NUMBER})\s*(?P<unit_x>{_UNIT})?\s*(?:[x×*]|by)\s*(?P<y>{_NUMBER})\s*"
    rf"(?P<unit_y>{_UNIT})\b"
)
_WORD = re.compile(rf"(?P<key>[^\W\d_][^:=;\t]*?)\s*[:=;\t]\s*(?P<unit>{_UNIT}|\[[^\]]+\])\s*;*$")
_FACTOR = re.compile(
    rf"height conversion factor\s*\(\s*-?>?\s*(?P<unit>{_UNIT})\s*\)\s*[:=]\s*(?P<number>{_NUMBER})", re.IGNORECASE
)
_HEIGHTS_IN = re.compile(
    rf"(?:\b(?:z|heights?|höhen?|hauteurs?|altezz[ae]|alturas?|topography|depths?|elevations?|values?|data)\b)"
    rf"[^\[(\d]{{0,30}}(?:[\[(]\s*(?P<bracket>{_UNIT})\s*[\])]|\bin\s+(?P<word>{_UNIT}))",
    re.IGNORECASE,
)
_Z_AMPLITUDE = re.compile(rf"z amplitude\s*:\s*{_NUMBER}\s*(?P<unit>{_UNIT})$", re.IGNORECASE)
_ENDS_IN_NUMBER = re.compile(r"[:=]\s*[-+\d.,]+\s*$")
_CHANNEL = re.compile(
    r"(?:channel|kanal|canal|canale|kanał|kanál|канал|チャンネル|通道)\s*[:=;,\t]\s*(?P<name>.+)", re.IGNORECASE
)
_IN_KEY = re.compile(rf"[\[(]\s*(?P<unit>{_UNIT})\s*(?P<per>{_PER_PIXEL})?\s*[\])]")
_COLUMN = re.compile(r"^(?P<axis>[xyz])\b|^(?P<other>[xyz])_", re.IGNORECASE)


def _names(*lines: str) -> frozenset[str]:
    """Return the set of keys in lines of text; vertical bars separate the keys of a line."""
    return frozenset("|".join(lines).split("|"))


# Keys of header lines, in lower case, by the fact that they state: width, height, pitch, number of samples, unit or
# factor. They are the words of common programs and languages.
_WIDTH = _names(
    "width|breite|largeur|larghezza|ancho|anchura|largura|bredd|bredde|szerokość|šířka|ширина|genişlik|szélesség",
    "leveys|幅|宽度|x amplitude|x size|size x|xsize|x range|range x|x scan size|scan size x|x scan range|scan range x",
    "x length|length x|lx|xreal|x extent|extent x|x dimension|field width|image width|scan width",
)
_HEIGHT = _names(
    "height|höhe|hoehe|hauteur|altezza|alto|altura|höjd|høyde|højde|wysokość|výška|высота|yükseklik|magasság",
    "korkeus|高さ|y amplitude|y size|size y|ysize|y range|range y|y scan size|scan size y|y scan range|scan range y",
    "高度|y length|length y|ly|yreal|y extent|extent y|y dimension|field height|image height|scan height",
)
_BOTH_SIZES = _names(
    "size|scan size|scansize|scan range|extent|field of view|fov|image size|field size|physical size|area|scan area"
)
_PITCH_X = _names(
    "pixel size x|x pixel size|pixel width|dx|x step|step x|x step size|step size x|x pitch|pitch x|x spacing",
    "spacing x|x increment|increment x|x-increment|x sampling|sampling x|x interval|xpixelsize|pixelsizex",
)
_PITCH_Y = _names(
    "pixel size y|y pixel size|pixel height|dy|y step|step y|y step size|step size y|y pitch|pitch y|y spacing",
    "spacing y|y increment|increment y|y-increment|y sampling|sampling y|y interval|ypixelsize|pixelsizey",
)
# Keys of the pitch along both axes. "Step" and "pitch" alone are not among them, because they may state the step of the
# focus along z.
_BOTH_PITCHES = _names(
    "pixel size|pixelsize|pixel pitch|lateral sampling|sampling interval|sampling distance|sample spacing|spacing",
    "point spacing|grid spacing|lateral spacing|lateral step|xy calibration|xy-calibration|xy-justierung|dxy",
    "xy step|xy pitch|camera res|camera resolution|pixelgröße|taille de pixel",
)
_COUNTS_X = _names(
    "w|nx|columns|cols|number of columns|num columns|horizontal|horizont.|x pixels|pixels x|x-pixels|xres",
    "samples/line|points x|x points|x samples|xdim|x size|size x|xsize",
)
_COUNTS_Y = _names(
    "h|ny|rows|lines|number of rows|number of lines|num rows|vertical|vertikal|y pixels|pixels y|y-pixels|yres",
    "points y|y points|y samples|ydim|y size|size y|ysize",
)
_UNITS_Z = _names(
    "value units|value unit|values unit|z unit|z units|z-unit|zunit|unit z|units z|unit|units|height unit|height units",
    "heightunit|unit of height|unit of heights|data unit|data units|einheit|einheiten",
    "z einheit|höheneinheit|unité|unités|unità|unidad|unidades|z-axis unit|z axis unit|heights|values|z",
)
_UNITS_XY = _names(
    "x unit|y unit|xy unit|xy units|x units|y units|lateral unit|lateral units|x-unit|y-unit|unit x|unit y"
)
_FACTORS = _names("z scale|z-scale|zscale|scale z|z factor|z-factor|factor|scale factor|height scale|multiplier|bit2nm")
_GLOBAL_UNITS = _names("units|einheiten|unités")


@dataclass
class Facts:
    """Facts that the header of a text states. Lengths are in µm. None means that the header does not state a fact.

    Attributes:
        size_x: Width of the field.
        size_y: Height of the field.
        size_of_both: Size of the field, if the header states one size for both axes.
        pitch_x: Distance of samples along x.
        pitch_y: Distance of samples along y.
        count_x: Number of columns.
        count_y: Number of rows.
        units: Sizes of all units that the header states for the heights. Several ones contradict each other.
        factor_key: Key of a factor by which the program scales heights. The factor is not applied, and the file is
            refused. An empty string if there is none.
        not_length: Unit of the values if it is no unit of length, such as V; an empty string if there is none.
        factor: Height of a value of 1, if the header states it as a "height conversion factor".
        lateral: Size of the unit of the positions along x and y.
        global_unit: Size of the unit of all numbers of the file, heights and positions, if there is one.
        channel: Name of the channel; an empty string if it is not stated.
        metadata: Lines "key: value", as text.
    """

    size_x: float | None = None
    size_y: float | None = None
    size_of_both: float | None = None
    pitch_x: float | None = None
    pitch_y: float | None = None
    count_x: int | None = None
    count_y: int | None = None
    units: set[float] = field(default_factory=set)
    factor_key: str = ""
    not_length: str = ""
    factor: float | None = None
    lateral: float | None = None
    global_unit: float | None = None
    channel: str = ""
    metadata: dict[str, str] = field(default_factory=dict)
    _stated: dict[str, list[tuple[bool, float]]] = field(default_factory=dict)

    def add(self, name: str, length: float, *, names_axis: bool) -> None:
        """Add the length that a header line states for the fact ``name``, a size or a pitch.

        ``names_axis`` is whether the key of the line names x or y. Such statements outweigh keys like "Height" or
        "Spacing".
        """
        self._stated.setdefault(name, []).append((names_axis, length))

    def decide(self) -> None:
        """Set each size and pitch for which the header lines state equal lengths; contradictory lines set nothing."""
        for name, statements in self._stated.items():
            strongest = max(names_axis for names_axis, _ in statements)
            lengths = [length for names_axis, length in statements if names_axis == strongest]
            if max(lengths) <= (1.0 + _MOST_DIFFERENCE) * min(lengths):
                setattr(self, name, lengths[0])

    @property
    def has_scale(self) -> bool:
        """Whether the header states the size, or the pitch, along both axes."""
        return None not in (self.size_x, self.size_y) or None not in (self.pitch_x, self.pitch_y)

    @property
    def unit(self) -> float | None:
        """Size of the unit of heights [µm]; None if the header does not state one, or states two different ones."""
        if self.factor is not None:
            return self.factor
        return next(iter(self.units)) if len(self.units) == 1 else None


def is_statement(line: str) -> bool:
    """Whether a header line states a fact, such as "heights in nm". Otherwise it may contain headings of columns."""
    return any(sign in line for sign in ":=") or re.search(r"\bin\b", line) is not None


def value_of(text: str) -> float:
    """Return the value of a number in a header; its decimal sign is a point or a comma."""
    return float(text.replace(",", ".").upper().replace("D", "E"))


def facts_of(header: Sequence[str], form: Form) -> Facts:
    """Return the facts (sizes, pitches, units, channel) that the lines of a header state."""
    facts = Facts()
    lines = [_plain(line, form) for line in header[-_MOST_LINES:] if len(line) <= _MOST_LENGTH]
    for line in lines:
        _add_unit(facts, line)
    unnamed: list[tuple[int, float]] = []
    for index, line in enumerate(lines):
        key, _, value = line.partition(":") if ":" in line else line.partition("=")
        if value.strip():
            facts.metadata.setdefault(key.strip(), value.strip())
        if (match := _CHANNEL.match(line)) and not facts.channel:
            facts.channel = match["name"].strip().strip('"')[:60]
        if pair := _PAIR.match(line):
            _add_pair(facts, pair)
            continue
        matches = list(_STATEMENT.finditer(line)) or [match for match in [_SPACED.match(line)] if match]
        for match in matches:
            length = _add_number(facts, match)
            if length is not None and len(matches) == 1:
                unnamed.append((index, length))
    facts.decide()
    # The program Gwyddion writes width and height in two lines before the unit of the heights. It translates the keys
    # of these lines, so that they are recognised by their order.
    if not facts.has_scale and len(unnamed) == 2 and unnamed[1][0] == unnamed[0][0] + 1:
        match = _WORD.match(lines[unnamed[1][0] + 1]) if unnamed[1][0] + 1 < len(lines) else None
        if match and _words(match["key"]) == "value units":
            facts.size_x, facts.size_y = unnamed[0][1], unnamed[1][1]
    return facts


def _plain(line: str, form: Form) -> str:
    """Return a header line without comment signs and quotes.

    Separate cells for a key, a value and a unit are joined to "key: value unit".
    """
    line = line.strip().lstrip("#%;/*'!\\ \t").strip()
    if form.separator in (",", ";", "\t") and form.separator in line:
        cells = [cell.strip('"') for cell in form.cells(line)]
        filled = [cell for cell in cells if cell]
        if len(filled) in (2, 3) and not any(sign in filled[0] for sign in ":="):
            return f"{filled[0]}: {' '.join(filled[1:])}"
    return line.replace('"', "")


def _words(key: str) -> str:
    """Return a key as sets such as `_UNITS_XY` list it: in lower case, and without units in brackets."""
    return " ".join(_IN_KEY.sub("", key).replace("_", " ").lower().strip(" ,;-").split())


def _add_unit(facts: Facts, line: str) -> None:
    """Add the unit of heights, or of lengths along x and y, that a line states."""
    # The program WSxM writes the range of the heights ("Z Amplitude") with a unit, which is also the unit of the
    # heights.
    amplitude = _Z_AMPLITUDE.match(line)
    if match := _FACTOR.search(line):
        unit = length_units.factor_of(match["unit"])
        facts.factor = None if unit is None else unit * value_of(match["number"])
    elif (match := amplitude or _WORD.match(line)) is not None:
        key, text = "z" if amplitude else _words(match["key"]), match["unit"]
        unit = length_units.factor_of(text)
        if key in _UNITS_XY:
            facts.lateral = facts.lateral if unit is None else unit
        elif key in _UNITS_Z and unit is None:
            facts.not_length = facts.not_length or text
        elif key in _UNITS_Z and unit is not None:
            facts.units.add(unit)
            facts.global_unit = unit if key in _GLOBAL_UNITS else facts.global_unit
    # A line such as "Height [µm]: 10" states the size of the field along y, and not the unit of the heights.
    elif not _ENDS_IN_NUMBER.search(line):
        texts = (match["bracket"] or match["word"] for match in _HEIGHTS_IN.finditer(line))
        facts.units.update(unit for unit in map(length_units.factor_of, texts) if unit is not None)


def _add_pair(facts: Facts, match: re.Match[str]) -> None:
    """Add to ``facts`` the sizes or pitches along x and y that a line with two numbers states."""
    key = _words(match["key"])
    unit_y = length_units.factor_of(match["unit_y"])
    unit_x = unit_y if match["unit_x"] is None else length_units.factor_of(match["unit_x"])
    if unit_x is None or unit_y is None:
        return
    x, y = unit_x * value_of(match["x"]), unit_y * value_of(match["y"])
    kind = "size" if key in _BOTH_SIZES else "pitch" if key in _BOTH_PITCHES else ""
    if kind:
        facts.add(f"{kind}_x", x, names_axis=True)
        facts.add(f"{kind}_y", y, names_axis=True)


def _add_number(facts: Facts, match: re.Match[str]) -> float | None:
    """Add to ``facts`` the number that a line states. If its key is not known, return its length [µm] instead."""
    inner = _IN_KEY.search(match["key"])
    text = match["unit"] or (inner["unit"] if inner else None)
    key, number = _words(match["key"]), value_of(match["number"])
    unit = facts.lateral if text is None else length_units.factor_of(text)
    if text is None and key in _FACTORS and number != 1.0:
        facts.factor_key = match["key"]
    if text is None and facts.lateral is None and 0 < number < 2**31 and number == int(number):
        facts.count_x = int(number) if key in _COUNTS_X else facts.count_x
        facts.count_y = int(number) if key in _COUNTS_Y else facts.count_y
        return None
    if unit is None or not number > 0.0:
        return None
    length = unit * number
    per_pixel = match["per"] or (inner["per"] if inner else None)
    names_axis = bool(re.search(r"^[dl]?[xy]|\b[xy]\b", key))
    is_pitch = key in _BOTH_PITCHES or bool(per_pixel)
    if key in _WIDTH and not per_pixel:
        facts.add("size_x", length, names_axis=names_axis)
    elif key in _HEIGHT and not per_pixel:
        facts.add("size_y", length, names_axis=names_axis)
    elif key in _PITCH_X or key in _PITCH_Y:
        facts.add("pitch_x" if key in _PITCH_X else "pitch_y", length, names_axis=True)
    elif is_pitch:
        facts.add("pitch_x", length, names_axis=False)
        facts.add("pitch_y", length, names_axis=False)
    elif key in _BOTH_SIZES:
        facts.size_of_both = length
    elif text is not None:
        return length
    return None


@dataclass
class Columns:
    """Indices of the columns of x, y and z, and the sizes of their units [µm]; None for a column without a unit."""

    positions: tuple[int, int, int]
    units: tuple[float | None, float | None, float | None]


def columns_of(header: Sequence[str], form: Form, width: int) -> Columns | None:
    """Return the columns of x, y and z by their headings in the last header lines; None without such headings."""
    lines = [line for line in header[-3:] if len(line) <= _MOST_LENGTH]
    for index in range(len(lines) - 1, -1, -1):
        for cells in _cells(lines[index], form):
            axes: dict[str, int] = {}
            for position, cell in enumerate(cells):
                match = _COLUMN.match(cell)
                if match:
                    axes.setdefault((match["axis"] or match["other"]).lower(), position)
                elif re.match(r"(?:height|höhe|hauteur)\b", cell, re.IGNORECASE):
                    axes.setdefault("z", position)
            if set(axes) == set("xyz") and len(cells) <= width:
                below = next(iter(_cells(lines[index + 1], form)), []) if index + 1 < len(lines) else []
                texts = below if len(below) == len(cells) else cells
                positions = axes["x"], axes["y"], axes["z"]
                x, y, z = (_unit_of_cell(texts[k], is_alone=texts is below) for k in positions)
                return Columns(positions, (x, y, z))
    return None


def _cells(line: str, form: Form) -> Iterator[list[str]]:
    """Yield the cells of a header line, split by the separator of the numbers, and then by other common separators."""
    line = line.strip().lstrip("#%;/*'!\\ \t").strip()
    if form.separator is not None:
        yield [cell.strip('" ') for cell in form.cells(line)]
    for separator in (";", ",", "\t"):
        if separator in line:
            yield [cell.strip('" ') for cell in line.split(separator) if cell.strip()]
    # A name and its unit are joined before the line is split at white space, for headings such as "X [nm] Y [nm] Z
    # [nm]", "x(µm) y(µm) z(nm)" and "x in um  y in um  z in nm".
    joined = re.sub(r"\s*(?:/|\bin\b)\s*", "/", re.sub(r"\s+([\[(])", r"\1", line))
    yield joined.split()


def _unit_of_cell(cell: str, *, is_alone: bool) -> float | None:
    """Return the size [µm] of the unit in the heading of a column; None if the heading has no unit of length."""
    if is_alone:
        return length_units.factor_of(cell)
    match = re.search(rf"[\[(/_,]\s*({_UNIT})\s*[\])]?$|\bin\s+({_UNIT})$|\s({_UNIT})$", cell)
    return length_units.factor_of(next(filter(None, match.groups()))) if match else None
