"""Readers of refractive index files of refractiveindex.info, in YAML or CSV."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.files import read_text
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

# Number of wavelengths at which a formula is tabulated, from 0.1 to 10 µm in equal ratios; linear in between.
_STEPS = 512
_BLOCK = re.compile(r"^\s*-\s*type:\s*(?P<type>[a-z0-9 ]+?)\s*$", re.MULTILINE)
_TAGS = re.compile(r"<[^>]*>")

Table = tuple["NDArray[np.float64]", "NDArray[np.float64]"]


def read(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], str]:
    """Return wavelengths [nm], n, k and the literature reference of a file.

    Raises:
        OSError: The file does not exist, or cannot be read.
        ValueError: The file has no index of refraction that can be read.
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
    return 1e3 * um, n, k, source


def _shared_wavelengths(tables: dict[str, Table]) -> NDArray[np.float64]:
    """Wavelengths [µm] of the tables of n and k, within the range that both cover."""
    if "n" not in tables:
        raise ValueError("the file has no index of refraction n")
    columns = [wavelengths for wavelengths, _ in tables.values()]
    low, high = max(column[0] for column in columns), min(column[-1] for column in columns)
    wavelengths = np.unique(np.concatenate(columns))
    wavelengths = wavelengths[(wavelengths >= low) & (wavelengths <= high)]
    if not len(wavelengths):
        raise ValueError("n and k have no wavelengths in common")
    return np.asarray(wavelengths)


def _yaml(text: str) -> tuple[dict[str, Table], str]:
    """Read the tables and formulas of a YAML file, which lists them by type, and its literature reference."""
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
            rows = _rows([line.split() for line in body.split("\n")], 1 + len(columns))
            for column, name in enumerate(columns):
                tables[name] = _ordered(rows[:, 0], rows[:, 1 + column])
        elif kind.startswith("formula "):
            tables["n"] = _formula(kind.removeprefix("formula ").strip(), body)
        else:
            raise ValueError(f"data of type {kind!r} are not supported: use a table, or formula 1, 2, 3 or 5")
    reference = re.search(r"^REFERENCES:\s*\|?\s*(.*?)^(?=[A-Z]+:)", text, re.MULTILINE | re.DOTALL)
    source = " ".join(_TAGS.sub("", reference[1]).split()).strip("\"' ") if reference else ""
    return tables, source


def _formula(number: str, body: str) -> Table:
    """Tabulate a formula of refractiveindex.info; c holds its ``coefficients`` in their order."""
    if number not in _FORMULAS:
        raise ValueError(f"formula {number} is not supported: use a table, or formula 1, 2, 3 or 5")
    numbers = {}
    for name, key in (("wavelength_range", "(?:wavelength_range|range)"), ("coefficients", "coefficients")):
        line = re.search(rf"^\s*{key}:[ \t]*([^\n]*)$", body, re.MULTILINE)
        if line is None:
            raise ValueError(f"formula {number} has no {name}")
        numbers[name] = [float(word) for word in line[1].split()]
    limits, c = numbers["wavelength_range"], numbers["coefficients"]
    if len(limits) != 2 or not 0.0 < limits[0] < limits[1] < math.inf or len(c) < 1:
        raise ValueError(f"formula {number} must have a wavelength_range of two numbers and at least one coefficient")
    um = np.geomspace(max(limits[0], 0.1), min(limits[1], 10.0), _STEPS)
    with np.errstate(all="ignore"):
        n = _FORMULAS[number](um, c[0], list(zip(c[1::2], c[2::2], strict=False)))
    if not np.all(np.isfinite(n)):
        raise ValueError(f"formula {number} must have a finite index of refraction at all wavelengths")
    return um, n


def _sellmeier(
    um: NDArray[np.float64], first: float, pairs: list[tuple[float, float]], *, squared: bool
) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(1.0 + first + sum(b * um**2 / (um**2 - (c**2 if squared else c)) for b, c in pairs)))


_FORMULAS: dict[str, Callable[[NDArray[np.float64], float, list[tuple[float, float]]], NDArray[np.float64]]] = {
    "1": lambda um, first, pairs: _sellmeier(um, first, pairs, squared=True),
    "2": lambda um, first, pairs: _sellmeier(um, first, pairs, squared=False),
    "3": lambda um, first, pairs: np.sqrt(first + sum(c * um**power for c, power in pairs)),
    "5": lambda um, first, pairs: np.asarray(first + sum(c * um**power for c, power in pairs)),
}


def _csv(text: str) -> dict[str, Table]:
    """Read a CSV file with columns of wavelength, n and perhaps k, or with one block for n and one for k."""
    tables: dict[str, Table] = {}
    names, rows, scale = ["n", "k"], list[list[str]](), 1.0

    def finish() -> None:
        if not rows:
            return
        values = _rows(rows, min(1 + len(names), *map(len, rows)))
        for column, name in enumerate(names[: values.shape[1] - 1]):
            tables[name] = _ordered(scale * values[:, 0], values[:, 1 + column])
        rows.clear()

    for line in text.split("\n"):
        cells = [cell.strip() for cell in re.split(r"[,;\t]", line)]
        if not any(cells) or cells[0].startswith("#"):
            continue
        if _number(cells[0]) is None:
            finish()
            names = [cell.lower() for cell in cells[1:]]
            if not set(names) <= {"n", "k"} or not names:
                raise ValueError(f"columns must be a wavelength, n and k, got {line.strip()!r}")
            scale = 1e-3 if "nm" in cells[0].lower() else 1.0
        else:
            rows.append(cells)
    finish()
    return tables


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _rows(lines: list[list[str]], columns: int) -> NDArray[np.float64]:
    """Return the lines that begin with ``columns`` numbers, as an array."""
    rows = []
    for cells in lines:
        numbers = [_number(cell) for cell in cells[:columns]]
        if len(numbers) == columns and None not in numbers:
            rows.append(numbers)
    if not rows or columns < 2:
        raise ValueError("the file has no line with a wavelength and an index of refraction")
    values = np.array(rows, dtype=np.float64)
    if not np.all(np.isfinite(values)):
        raise ValueError("all numbers must be finite")
    return values


def _ordered(um: NDArray[np.float64], values: NDArray[np.float64]) -> Table:
    """Return a table sorted by wavelength, without duplicates."""
    wavelengths, first = np.unique(um, return_index=True)
    return wavelengths, values[first]
