"""Readers of refractive index files of refractiveindex.info, in YAML or CSV.

No row of a table is ignored. A row that does not consist of a wavelength and the numbers of the other columns raises an
error that names the line. Only rows beyond the wavelengths that a `warpdiff.Material` accepts, 100 to 10,000 nm, are
removed.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.files import read_text
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.colorimetry import LONGEST_NM, NM_PER_UM, SHORTEST_NM

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Lines = list[tuple[int, list[str]]]

# Shortest and longest wavelength that a material accepts [µm], from the limits in `warpdiff.optics.colorimetry`.
_LEAST_UM, _MOST_UM = SHORTEST_NM / NM_PER_UM, LONGEST_NM / NM_PER_UM
# Number of wavelengths at which the index of a formula is tabulated. Consecutive wavelengths have equal ratios. Between
# them, the index is interpolated linearly. If the number was halved, the index of the glass N-BK7 would be wrong by up
# to 4e-5.
_STEPS = 512
# Constant in Herzberger's formula for the index of refraction [µm²]. It is a part of the formula's definition.
_HERZBERGER_UM2 = 0.028
_BLOCK = re.compile(r"^\s*-\s*type:\s*(?P<type>[a-z0-9 ]+?)\s*$", re.MULTILINE)
_TAGS = re.compile(r"<[^>]*>")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)

Table = tuple["NDArray[np.float64]", "NDArray[np.float64]"]


def read(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], str]:
    """Return wavelengths [nm], n, k and the literature reference of a file.

    Raises:
        OSError: The file does not exist, or cannot be read.
        ValueError: The file has no index of refraction that can be read, or a row that does not consist of a wavelength
            and numbers.
    """
    text = read_text(file)
    try:
        if file.suffix.lower() in {".yml", ".yaml"}:
            tables, source = _yaml(text)
        else:
            tables, source = _csv(text), ""
        um = _shared_wavelengths(tables)
    except (ValueError, OverflowError) as error:
        raise ArgumentValueError(f"{ref('path')}: {file.name}: {error}") from None
    n = np.interp(um, *tables["n"])
    k = np.interp(um, *tables["k"]) if "k" in tables else np.zeros_like(um)
    return NM_PER_UM * um, n, k, source


def _shared_wavelengths(tables: dict[str, Table]) -> NDArray[np.float64]:
    """Return all wavelengths [µm] of the tables of n and k that both tables cover and that a material accepts."""
    if "n" not in tables:
        raise ValueError("the file has no index of refraction n")
    columns = [wavelengths for wavelengths, _ in tables.values()]
    low, high = max(column[0] for column in columns), min(column[-1] for column in columns)
    if low > high:
        raise ValueError("n and k have no wavelengths in common")
    wavelengths = np.unique(np.concatenate(columns))
    wavelengths = wavelengths[(wavelengths >= max(low, _LEAST_UM)) & (wavelengths <= min(high, _MOST_UM))]
    if not len(wavelengths):
        raise ValueError(
            f"the file has no wavelength within {SHORTEST_NM:g} to {LONGEST_NM:g} nm, but covers {NM_PER_UM * low:g} "
            f"to {NM_PER_UM * high:g} nm: wavelengths must be in µm, or the header of a CSV file must say nm"
        )
    return np.asarray(wavelengths)


def _yaml(text: str) -> tuple[dict[str, Table], str]:
    """Return tables of n and k from a YAML file, and its literature reference. A table of n may come from a formula."""
    blocks = list(_BLOCK.finditer(text))
    if not blocks:
        raise ValueError(
            "the file has no entry such as '- type: tabulated nk' or '- type: formula 1', as refractiveindex.info has"
        )
    tables: dict[str, Table] = {}
    for index, block in enumerate(blocks):
        end = blocks[index + 1].start() if index + 1 < len(blocks) else len(text)
        body, kind = text[block.end() : end], block["type"]
        if kind.startswith("tabulated "):
            columns = kind.removeprefix("tabulated ").strip()
            if columns not in {"nk", "n", "k"}:
                raise ValueError(
                    f"data of type {kind!r} are not supported: use 'tabulated nk', 'tabulated n' or 'tabulated k'"
                )
            lines = _data_lines(body, text.count("\n", 0, block.end()) + 1)
            rows = _rows(lines, ["wavelength", *columns])
            for column, name in enumerate(columns):
                tables[name] = _ordered(rows[:, 0], rows[:, 1 + column])
        elif kind.startswith("formula "):
            tables["n"] = _formula(kind.removeprefix("formula ").strip(), body)
        else:
            raise ValueError(f"data of type {kind!r} are not supported: use a table, or formula 1 to 9")
    reference = re.search(r"^REFERENCES:\s*\|?\s*(.*?)^(?=[A-Z]+:)", text, re.MULTILINE | re.DOTALL)
    source = " ".join(_TAGS.sub("", reference[1]).split()).strip("\"' ") if reference else ""
    return tables, source


def _data_lines(body: str, first_line: int) -> Lines:
    """Return the rows of the table in a block of a YAML file, split into words, with their line numbers.

    The rows are the lines below ``data:`` that are indented further than the line with ``data:``.
    """
    lines: Lines = []
    indent = -1
    for number, line in enumerate(body.split("\n"), start=first_line):
        stripped = line.strip()
        depth = len(line) - len(line.lstrip())
        if indent < 0:
            if stripped.startswith("data:"):
                indent = depth
        elif stripped and not stripped.startswith("#"):
            if depth <= indent:
                break
            lines.append((number, stripped.split()))
    return lines


def _formula(number: str, body: str) -> Table:
    """Return a table of the index n by a formula of refractiveindex.info, with the coefficients in the file."""
    if number not in _FORMULAS:
        raise ValueError(f"formula {number} is not supported: use a table, or formula 1 to 9")
    numbers = {}
    for name, key in (("wavelength_range", "(?:wavelength_range|range)"), ("coefficients", "coefficients")):
        line = re.search(rf"^\s*{key}:[ \t]*([^\n]*)$", body, re.MULTILINE)
        if line is None:
            raise ValueError(f"formula {number} has no {name}")
        numbers[name] = [_number(word) for word in line[1].split("#")[0].split()]
        if None in numbers[name]:
            raise ValueError(f"{name} of formula {number} must be numbers, got {line[1].strip()!r}")
    limits, c = (np.array(values, dtype=np.float64) for values in numbers.values())
    if len(limits) != 2 or not 0.0 < limits[0] < limits[1] < np.inf or len(c) < 1:
        raise ValueError(f"formula {number} must have a wavelength_range of two numbers and at least one coefficient")
    evaluate, counts = _FORMULAS[number]
    if len(c) not in counts:
        raise ValueError(f"formula {number} must have {_range_text(counts)} coefficients, got {len(c)}")
    low, high = max(limits[0], _LEAST_UM), min(limits[1], _MOST_UM)
    if low >= high:
        return limits, np.ones(2)
    um = np.geomspace(low, high, _STEPS)
    with np.errstate(all="ignore"):
        # A formula whose coefficients are all zero, except for the constant, returns a single number.
        n = np.broadcast_to(evaluate(um, np.pad(c, (0, counts[-1] - len(c)))), um.shape)
    if not np.all(np.isfinite(n)):
        raise ValueError(f"formula {number} must have a finite index of refraction at all wavelengths")
    return um, n


def _range_text(counts: range) -> str:
    return f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"


def _pair_sum(
    c: NDArray[np.float64], first: int, term: Callable[[float, float], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the sum of ``term(a, b)`` over pairs (a, b) of consecutive coefficients of a dispersion formula.

    The pairs begin at the index ``first``. Pairs with a = 0 contribute nothing.
    """
    return np.asarray(sum(term(a, b) for a, b in zip(c[first::2], c[first + 1 :: 2], strict=True) if a != 0.0))


def _retro(um: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return n by the formula of Lorentz and Lorenz ("Retro"), which gives (n² − 1)/(n² + 2)."""
    share = c[0] + c[1] * um**2 / (um**2 - c[2]) + c[3] * um**2
    return np.asarray(np.sqrt((1.0 + 2.0 * share) / (1.0 - share)))


def _herzberger(um: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    inverse = 1.0 / (um**2 - _HERZBERGER_UM2)
    return np.asarray(c[0] + c[1] * inverse + c[2] * inverse**2 + c[3] * um**2 + c[4] * um**4 + c[5] * um**6)


# Functions that compute the index of refraction from wavelengths [µm] and coefficients, by the number of the formula;
# and the permitted numbers of coefficients. Missing coefficients are 0. Definitions: "Dispersion formulas" of the
# refractiveindex.info database.
_FORMULAS: dict[str, tuple[Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]], range]] = {
    # Sellmeier formula; resonances are given as wavelengths [µm].
    "1": (
        lambda um, c: np.sqrt(1.0 + c[0] + _pair_sum(c, 1, lambda b, a: b * um**2 / (um**2 - a**2))),
        range(1, 18),
    ),
    # Sellmeier formula; resonances are given as squared wavelengths [µm²].
    "2": (lambda um, c: np.sqrt(1.0 + c[0] + _pair_sum(c, 1, lambda b, a: b * um**2 / (um**2 - a))), range(1, 18)),
    # Polynomial in the wavelength, with any exponents.
    "3": (lambda um, c: np.sqrt(c[0] + _pair_sum(c, 1, lambda b, power: b * um**power)), range(1, 18)),
    # Formula of refractiveindex.info itself: two resonances and a polynomial.
    "4": (
        lambda um, c: np.sqrt(
            c[0]
            + sum(c[i] * um ** c[i + 1] / (um**2 - c[i + 2] ** c[i + 3]) for i in (1, 5) if c[i] != 0.0)
            + _pair_sum(c, 9, lambda b, power: b * um**power)
        ),
        range(1, 18),
    ),
    # Cauchy's formula is a polynomial for n. The formulas above are for n².
    "5": (lambda um, c: c[0] + _pair_sum(c, 1, lambda b, power: b * um**power), range(1, 12)),
    # Formula for gases, with resonances in 1/µm².
    "6": (lambda um, c: 1.0 + c[0] + _pair_sum(c, 1, lambda b, a: b / (a - um**-2.0)), range(1, 12)),
    "7": (_herzberger, range(1, 7)),
    "8": (_retro, range(1, 5)),
    # Formula that the database calls "Exotic", for materials that no other formula represents.
    "9": (
        lambda um, c: np.sqrt(c[0] + c[1] / (um**2 - c[2]) + c[3] * (um - c[4]) / ((um - c[4]) ** 2 + c[5])),
        range(6, 7),
    ),
}


def _csv(text: str) -> dict[str, Table]:
    """Read a text file with columns of wavelength, n and perhaps k, or with one block for n and one for k."""
    tables: dict[str, Table] = {}
    names, rows, scale = list[str](), list[tuple[int, list[str]]](), 1.0

    def finish() -> None:
        if not rows:
            return
        columns = names or ["n", "k"][: max(len(rows[0][1]) - 1, 1)]
        values = _rows(rows, ["wavelength", *columns])
        for column, name in enumerate(columns):
            tables[name] = _ordered(scale * values[:, 0], values[:, 1 + column])
        rows.clear()

    for number, line in enumerate(text.split("\n"), start=1):
        cells = [cell.strip() for cell in (re.split(r"[,;\t]", line) if re.search(r"[,;\t]", line) else line.split())]
        while cells and not cells[-1]:
            cells.pop()
        if not cells or cells[0].startswith("#"):
            continue
        if all(_number(cell) is None for cell in cells):
            finish()
            # Cells that begin with a bracket are not names of columns, but units, such as "[nm]" in "wl [nm]".
            names = [cell.lower() for cell in cells[1:] if not cell.startswith(("[", "("))]
            if not set(names) <= {"n", "k"} or not names:
                raise ValueError(f"columns must be a wavelength, n and k, got {line.strip()!r} in line {number}")
            scale = 1.0 / NM_PER_UM if "nm" in line.lower() else 1.0
        else:
            rows.append((number, cells))
    finish()
    return tables


def _number(cell: str) -> float | None:
    return float(cell) if _NUMBER.fullmatch(cell) else None


def _rows(lines: Lines, columns: list[str]) -> NDArray[np.float64]:
    """Return a table of numbers from lines of text, one number per column.

    A line that does not consist of one number per column raises an error that names the line.
    """
    rows = []
    for line, cells in lines:
        numbers = [_number(cell) for cell in cells]
        if len(numbers) != len(columns) or None in numbers:
            raise ValueError(
                f"line {line} must have {len(columns)} numbers ({', '.join(columns)}), got {' '.join(cells)!r:.60}"
            )
        rows.append(numbers)
    if not rows:
        raise ValueError("the file has no line with a wavelength and an index of refraction")
    values = np.array(rows, dtype=np.float64)
    if not np.all(np.isfinite(values)):
        bad = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
        raise ValueError(f"all numbers must be finite, got {' '.join(lines[bad][1])!r} in line {lines[bad][0]}")
    return values


def _ordered(um: NDArray[np.float64], values: NDArray[np.float64]) -> Table:
    """Return an index table sorted by wavelength. Rows of equal wavelengths are replaced by one row, their mean."""
    wavelengths, place, count = np.unique(um, return_inverse=True, return_counts=True)
    return wavelengths, np.asarray(np.bincount(place, values) / count)
