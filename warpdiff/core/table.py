"""``Table``: named columns of a result, printed as text and written to CSV files."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, overload

import numpy as np

from warpdiff.core import files
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

# Maximum number of rows of a `Table` that ``str`` prints. If a table is longer, half of the printed rows are its first
# rows, and the other half are its last rows.
_MOST_PRINTED = 40
# Number of significant digits with which ``str`` prints floating-point numbers; integers are printed in full.
_DIGITS = 5


class Tabular(Protocol):
    """Result that can be shown as a table."""

    def table(self) -> Table:
        """Return the table of the result, with one column per quantity."""


def save_table(self: Table | Tabular, path: str | os.PathLike[str]) -> Path:  # noqa: D417 (self is the object)
    """Write the table to a CSV file with a header; an existing file is replaced once the new one is complete.

    Numbers have all of their digits, so that reading the file restores them exactly. The text is UTF-8.

    Args:
        path: File to write; its name ends in ``.csv``.

    Returns:
        The path of the file.

    Raises:
        ValueError: The name does not end in ``.csv``.
        OSError: The folder does not exist, or the file cannot be written.

    Examples:
        >>> import warpdiff as wd
        >>> wd.Table({"order": [0, 1]}).save("orders.csv").name
        'orders.csv'
        >>> wd.gratings.fingers(size_um=6.4).periods().save("periods.csv").name
        'periods.csv'
    """
    # This function is the method ``save`` of `Table` and of all results with a method ``table``.
    table = self if isinstance(self, Table) else self.table()
    target = check_csv(path)
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows(table.rows)
    with files.atomic_write(target) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8", newline="")
    return target


class Table(ReadOnlyArrays):
    """Table of a result with named columns; ``print`` shows the table, `save` writes it to a CSV file.

    The name of a column ends in its unit, as in ``wavelength_nm``; a column without a unit holds ratios, counts or
    texts. A table is a sequence of rows: ``table[0]`` is a row, and ``table["efficiency"]`` is a column.

    Args:
        columns: Columns by name, each of shape (n,).

    Raises:
        TypeError: ``columns`` is not a dictionary, or a column is not an array of numbers or texts.
        ValueError: There is no column, a column is not one-dimensional, or the columns differ in length.

    Examples:
        >>> import warpdiff as wd
        >>> table = wd.Table({"wavelength_nm": [450.0, 550.0], "reflectance": [0.25, 0.125]})
        >>> print(table)
        wavelength_nm  reflectance
                  450         0.25
                  550        0.125
        >>> table["reflectance"]
        array([0.25 , 0.125])
        >>> table.save("spectrum.csv").read_text().splitlines()
        ['wavelength_nm,reflectance', '450.0,0.25', '550.0,0.125']
    """

    def __init__(self, columns: Mapping[str, ArrayLike]) -> None:
        if not isinstance(columns, Mapping):
            raise ArgumentTypeError(f"{ref('columns')} must be a dictionary of arrays, got {type(columns).__name__}")
        self._columns: dict[str, NDArray[Any]] = {}
        for name, values in columns.items():
            try:
                column = np.array(values)
            except (TypeError, ValueError):
                # NumPy raises a TypeError or ValueError for nested lists of different lengths. The column then becomes
                # an array of the type "object", which the next check refuses.
                column = np.array(None)
            if column.dtype.kind not in "biufU":
                raise ArgumentTypeError(f"{ref('columns')}: {name!r} must be numbers or texts, got {column.dtype}")
            if column.ndim != 1:
                raise ArgumentValueError(f"{ref('columns')}: {name!r} must have shape (n,), got {column.shape}")
            column.setflags(write=False)
            self._columns[name] = column
        lengths = {len(column) for column in self._columns.values()}
        if len(lengths) != 1:
            raise ArgumentValueError(f"{ref('columns')} must have the same length, got {sorted(lengths)}")
        self._length = lengths.pop()

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns by name, read-only arrays of shape (n,)."""
        return dict(self._columns)

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """Rows as tuples of Python numbers and texts."""
        return list(zip(*(column.tolist() for column in self._columns.values()), strict=True))

    @overload
    def __getitem__(self, key: str) -> NDArray[Any]: ...

    @overload
    def __getitem__(self, key: int) -> tuple[Any, ...]: ...

    def __getitem__(self, key: str | int) -> NDArray[Any] | tuple[Any, ...]:
        """Return the column of the given name, or the row of the given index."""
        if isinstance(key, (int, np.integer)):
            return tuple(column[key].item() for column in self._columns.values())
        if key not in self._columns:
            known = ", ".join(map(repr, self._columns))
            raise KeyError(f"a table has the columns {known}, got {key!r}{did_you_mean(key, self._columns)}")
        return self._columns[key]

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return iter(self.rows)

    def __repr__(self) -> str:
        return f"Table({self._length} rows: {', '.join(self._columns)})"

    def __str__(self) -> str:
        """Return the table as text with aligned columns; the middle rows of a long table are omitted."""
        half = _MOST_PRINTED // 2
        shown = range(self._length)
        places = [*shown[:half], *shown[-half:]] if self._length > _MOST_PRINTED else [*shown]
        texts = [[name, *(_text(column[k]) for k in places)] for name, column in self._columns.items()]
        widths = [max(map(len, column)) for column in texts]
        lines = [
            "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
            for row in zip(*texts, strict=True)
        ]
        if len(places) < self._length:
            lines.insert(
                1 + half, f"… {self._length - len(places)} rows …".center(sum(widths) + 2 * len(widths) - 2).rstrip()
            )
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"

    save = save_table


def check_csv(path: str | os.PathLike[str]) -> Path:
    """Check the path of a CSV file to write, and return it: it must end in .csv, and its folder must exist."""
    return files.check_output(path, (".csv",))


def _text(value: Any) -> str:
    """Return an element of a column as printed text, which is empty for NaN."""
    if isinstance(value, np.floating):
        return "" if np.isnan(value) else f"{value:.{_DIGITS}g}"
    return str(value)
