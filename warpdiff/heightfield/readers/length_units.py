"""Sizes of units of length [µm], by the symbols and words that files use for them."""

from __future__ import annotations

import html
import unicodedata

from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref

# Size [µm] of each unit whose symbol the argument ``unit`` of `HeightField.load` accepts.
SYMBOLS = {"m": 1e6, "cm": 1e4, "mm": 1e3, "um": 1.0, "µm": 1.0, "nm": 1e-3, "Å": 1e-4, "pm": 1e-6}
_WORDS = {
    "micron": 1.0, "microns": 1.0, "micrometer": 1.0, "micrometre": 1.0, "mikrometer": 1.0, "micromètre": 1.0,
    "nanometer": 1e-3, "nanometre": 1e-3, "nanomètre": 1e-3, "millimeter": 1e3, "millimetre": 1e3, "millimètre": 1e3,
    "centimeter": 1e4, "centimetre": 1e4, "meter": 1e6, "metre": 1e6, "mètre": 1e6, "picometer": 1e-6,
    "picometre": 1e-6, "angstrom": 1e-4, "ångstrom": 1e-4, "ångström": 1e-4, "angström": 1e-4, "nanómetro": 1e-3,
    "micrómetro": 1.0, "нм": 1e-3, "мкм": 1.0, "мм": 1e3, "纳米": 1e-3, "微米": 1.0, "毫米": 1e3,
}  # fmt: skip


def factor_of(text: str) -> float | None:
    """Return the size [µm] of a unit by its symbol or name in a file; None if the text is no unit of length."""
    # Unicode has several characters for µ and Å, and single characters for units such as ㎚. The normal form replaces
    # them by the usual ones. "Âµ" is a micro sign in UTF-8 that was decoded as Latin-1.
    name = unicodedata.normalize("NFKC", html.unescape(text)).strip().strip("[](){}.").strip()
    name = name.replace("μ", "µ").replace("Âµ", "µ")
    if name in SYMBOLS:
        return SYMBOLS[name]
    lower = name.lower()
    # Symbols in capital letters, such as NM, are accepted, but "Nm" is a unit of torque and "Mm" a million metres.
    if lower in SYMBOLS and len(name) > 1 and name.isupper():
        return SYMBOLS[lower]
    if lower == "å":
        return SYMBOLS["Å"]
    return _WORDS.get(lower) or _WORDS.get(lower.removesuffix("s"))


def factor_um(unit: object, name: str) -> float:
    """Return the size [µm] of the unit ``unit``; raise an error that names the argument if the unit is not known."""
    if not isinstance(unit, str):
        raise ArgumentTypeError(f"{ref(name)} must be a string, got {type(unit).__name__}")
    factor = factor_of(unit)
    if factor is None:
        raise ArgumentValueError(
            f"{ref(name)} must be one of {', '.join(SYMBOLS)}, got {unit!r}{did_you_mean(unit, SYMBOLS)}"
        )
    return factor
