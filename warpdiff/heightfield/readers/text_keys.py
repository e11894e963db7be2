"""Keys of header lines "key: value" in text files of heights, by the fact that they state, such as size or unit."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from warpdiff.heightfield.readers import length_units

Kind = Literal["size", "pitch", "count", "size or count", ""]
Axis = Literal["x", "y", ""]

# Matches a word that may be a unit of length, with both Unicode characters of µ.
UNIT = r"[A-Za-zµμÅåÂ\u212b][A-Za-zµμÅåèö]*"
# Matches the unit in the key of a header line, such as "Width (µm)", "X length in µm" or "Size X/µm".
IN_KEY = re.compile(
    rf"[\[(]\s*(?P<bracket>{UNIT})\s*(?P<per>/\s*(?:pixel|pix|px|point|sample))?\s*[\])]"
    rf"|(?:\s*/\s*|\s+in\s+)(?P<word>{UNIT})(?=\W*$)"
)


def _names(*lines: str) -> frozenset[str]:
    """Return the set of keys of header lines that a string lists, separated by vertical bars."""
    return frozenset("|".join(lines).split("|"))


# Keys of header lines ("key: value") that state a size, in lower case, as usual programs write them in many languages.
# The list has all translations of the program Gwyddion.
_WIDTH = _names(
    "width|breite|largeur|larghezza|ancho|anchura|largura|bredd|bredde|szerokość|šířka|ширина|genişlik|szélesség",
    "leveys|幅|폭|宽度|field width|image width|scan width",
)
_HEIGHT = _names(
    "height|höhe|hoehe|hauteur|altezza|alto|altura|höjd|høyde|højde|wysokość|výška|высота|yükseklik|magasság",
    "korkeus|高さ|높이|高度|field height|image height|scan height",
)
_SIZES = _names(
    "size|scan size|scansize|scan range|extent|field of view|fov|image size|field size|physical size|area|scan area"
)
# Keys of header lines that state a size only if they also name an axis, such as "x range".
_SIZES_OF_AXIS = _names("amplitude|range|length|l|real|dimension|scan length|taille|tamaño|größe")
_PITCHES = _names(
    "pixel size|pixelsize|pixel pitch|pixel spacing|lateral sampling|sampling interval|sampling distance",
    "sample spacing|spacing|point spacing|point distance|grid spacing|lateral spacing|lateral step|xy calibration",
    "xy justierung|dxy|xy step|xy pitch|camera res|camera resolution|pixelgröße|pixelabstand|punktabstand",
    "taille de pixel|tamaño de píxel|dimensione pixel|tamanho do pixel",
)
# Keys of header lines that state a pitch (distance of samples) only if they also name an axis. Without an axis, "step"
# and "pitch" may state the step of the focus along z.
_PITCHES_OF_AXIS = _names("d|δ|step|step size|pitch|increment|sampling|interval|pixel")
_OWN_PITCHES: dict[str, Axis] = {"pixel width": "x", "pixel height": "y"}
_OF_ROWS = re.compile(r"(?:line|row)s? (?=spacing|distance|pitch|step)")
_OF_COLUMNS = re.compile(r"(?:column|point)s? (?=spacing|distance|pitch|step)")
_COUNTS: dict[str, Axis] = {
    **dict.fromkeys(("w", "columns", "cols", "ncols", "number of columns", "num columns", "numcols"), "x"),
    **dict.fromkeys(("horizontal", "horizont", "spalten", "number of points per line"), "x"),
    **dict.fromkeys(("samples/line", "samps/line", "points/line", "samples per line", "points per line"), "x"),
    **dict.fromkeys(("h", "rows", "nrows", "lines", "number of rows", "number of lines", "num rows", "numrows"), "y"),
    **dict.fromkeys(("vertical", "vertikal", "zeilen"), "y"),
}
# Keys of header lines that state a number of samples: along an axis if they also name this axis, otherwise along both
# axes. The keys "n", "res" and "dim" must name an axis.
_COUNTS_OF_AXIS = _names(
    "n|res|dim|pixel|pixels|points|samples|resolution|number of pixels|number of points|image size|size|grid",
    "data points",
)
_UNITS_Z = _names(
    "value units|value unit|values unit|z unit|z units|zunit|unit z|units z|unit|units|height unit|height units",
    "heightunit|unit of height|unit of heights|data unit|data units|einheit|einheiten|z einheit|einheit z|höheneinheit",
    "unité|unités|unità|unità valore|unidad|unidades|unidades de valor|jednotky hodnot|единицы измерения",
    "値の単位|값 단위|单位|z axis unit|vertical unit|vertical units",
)
# Keys of header lines that state the unit of the heights only if their value is a unit without a number. In "z: nm" the
# key states a unit, in "z: 5 nm" it does not.
_WEAK_UNITS_Z = _names("heights|values|z")
_UNITS_XY = re.compile(r"(?:x|y|xy|lateral) units?|units? (?:x|y|xy)")
GLOBAL_UNITS = _names("units|einheiten|unités")
_FACTORS = _names("factor|scale factor|conversion factor|multiplier|bit2nm|zscale")
_FACTOR_OF_HEIGHTS = re.compile(
    r"\b(?:z|heights?|values?|data|höhen?)\b.*(?:scal(?:e|ing)\b|factor|faktor|multipl|skalierung)"
    r"|\bscale z\b"
)
_NO_DATA = re.compile(
    r"\b(?:no ?data|missing|invalid|void|bad|lost|fill ?value|undefined|masked|dummy|null|nan|out of range|fehlwert)"
)
_CODE = re.compile(r"value|code|marked|replaced|wert")
_AXIS_WORDS = r"(?:pixelsize|pixels?|size|range|length|real|res|dim|step|pitch|samples|scale|spacing|extent)"
_GLUED = re.compile(rf"([xy])({_AXIS_WORDS})|({_AXIS_WORDS}|[dnlδ∆])([xy])")


class Key(NamedTuple):
    """Fact that the key of a header line states about the matrix of heights.

    Attributes:
        kind: Whether the key states a size, a pitch or a number of samples. Keys such as "x size" state a size or, if
            the number has no unit, a number of samples.
        axis: Axis of the fact; an empty string for both axes.
        names_axis: Whether the key names the axis x or y. Such a key has priority over keys like "Height".
    """

    kind: Kind
    axis: Axis = ""
    names_axis: bool = False


def words_of(key: str) -> str:
    """Return the key of a header line as in the lists of keys: in lower case, without units, hyphens, underscores."""
    match = IN_KEY.search(key)
    if match is not None and (match["bracket"] or length_units.factor_of(match["word"]) is not None):
        key = f"{key[: match.start()]} {key[match.end() :]}"
    text = re.sub(r"[_\-()\[\]:=]", " ", key).lower()
    return " ".join(text.split()).strip(" ,;:=.|")


def key_of(text: str, *, per_pixel: bool = False) -> Key:
    """Return the fact (size, pitch or count, and axis) that a key states; ``kind`` is empty if the key is not known.

    Args:
        text: Key of a header line "key: value", as :func:`words_of` returns it.
        per_pixel: Whether the value has a unit per pixel, such as nm/pixel.
    """
    axis, base = _axis_and_base(text)
    result = Key("")
    if text in _COUNTS:
        result = Key("count", _COUNTS[text], names_axis=True)
    elif text in _WIDTH or text in _HEIGHT:
        result = Key("size or count", "x" if text in _WIDTH else "y")
    elif text in _OWN_PITCHES or _OF_ROWS.search(text) is not None:
        result = Key("pitch", _OWN_PITCHES.get(text, "y"), names_axis=True)
    elif (
        (per_pixel and not re.search(r"\bz\b|height", text)) or base in _PITCHES or _OF_COLUMNS.search(text) is not None
    ):
        result = Key("pitch", axis, names_axis=bool(axis))
    elif axis and base in _PITCHES_OF_AXIS:
        result = Key("pitch", axis, names_axis=True)
    elif base in _SIZES or (axis and base in _SIZES_OF_AXIS):
        kind: Kind = "size or count" if base in _COUNTS_OF_AXIS else "size"
        result = Key(kind, axis, names_axis=bool(axis))
    elif base in _COUNTS_OF_AXIS and (base not in ("n", "res", "dim") or axis):
        result = Key("count", axis, names_axis=bool(axis))
    return result


def _axis_and_base(text: str) -> tuple[Axis, str]:
    """Return the axis that the key of a header line names, an empty string for none, and the key without this axis."""
    axes, base = [], []
    for word in text.split():
        glued = _GLUED.fullmatch(word)
        if word in ("x", "y"):
            axes.append(word)
        elif glued is not None:
            axes.append(glued[1] or glued[4])
            base.append((glued[2] or glued[3]).replace("∆", "δ"))
        elif word not in ("along", "in", "axis", "direction"):
            base.append(word)
    return (axes[0], " ".join(base)) if len(axes) == 1 else ("", text)  # type: ignore[return-value]


def unit_in_key(key: str) -> tuple[float | None, bool]:
    """Return the size [µm] of the unit in a key, None without a unit of length, and whether the unit is per pixel.

    The key is the text before the colon of a header line "key: value".
    """
    match = IN_KEY.search(key)
    if match is None:
        return None, False
    return length_units.factor_of(match["bracket"] or match["word"]), match["per"] is not None


def states_unit_z(words: str, *, is_plain: bool) -> bool:
    """Whether a key states the unit of heights. Keys such as "z" do so only if the value has no number (is plain).

    The key is the text before the colon of a header line "key: value".
    """
    return words in _UNITS_Z or (is_plain and words in _WEAK_UNITS_Z)


def states_unit_xy(words: str) -> bool:
    """Whether the key of a header line states the unit of the positions x and y."""
    return _UNITS_XY.fullmatch(words) is not None


def states_factor(words: str) -> bool:
    """Whether the key of a header line states a factor between the numbers of the file and the heights."""
    return words in _FACTORS or _FACTOR_OF_HEIGHTS.search(words) is not None


def states_no_data(words: str) -> bool:
    """Whether the key of a header line states the code of missing samples, or how many samples are missing."""
    return _NO_DATA.search(words) is not None


def states_code(words: str) -> bool:
    """Whether the key of a header line about missing samples states their code, and not their number."""
    return _CODE.search(words) is not None
