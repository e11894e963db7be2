"""`Table`: printed text, columns, CSV files, and errors for arguments that are refused."""

import csv

import numpy as np
import pytest

import warpdiff as wd


def test_a_file_restores_every_number_exactly(tmp_path):
    numbers = np.array([1.0 / 3.0, -1e-300, 6.02214076e23, np.nan, 5e-324])
    table = wd.Table({"x_um": numbers, "m": np.arange(-2, 3), "name": list('a,"é '), "live": numbers > 0.0})
    path = table.save(tmp_path / "table.csv")
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_array_equal([float(row["x_um"]) for row in rows], numbers)
    assert [int(row["m"]) for row in rows] == [-2, -1, 0, 1, 2]
    assert [row["name"] for row in rows] == list('a,"é ')
    assert [row["live"] for row in rows] == ["True", "False", "True", "False", "True"]
    assert b"\r" not in path.read_bytes()


def test_text_has_aligned_columns_and_five_digits():
    table = wd.Table({"wavelength_nm": [450.0, 550.0], "efficiency": [0.123456789, np.nan], "m": [-1, 0]})
    assert str(table).splitlines() == [
        "wavelength_nm  efficiency   m",
        "          450     0.12346  -1",
        "          550               0",
    ]
    assert repr(table) == "Table(2 rows: wavelength_nm, efficiency, m)"
    assert table._repr_html_() == f"<pre>{table}</pre>"


def test_long_tables_are_printed_without_the_rows_in_the_middle():
    lines = str(wd.Table({"number": np.arange(1000)})).splitlines()
    assert len(lines) == 42
    assert lines[20].strip() == "19"
    assert lines[21].strip() == "… 960 rows …"
    assert lines[22].strip() == "980"


def test_a_table_is_a_sequence_of_rows_with_named_columns():
    table = wd.Table({"m": [0, 1], "efficiency": [0.5, 0.25]})
    assert list(table) == table.rows == [(0, 0.5), (1, 0.25)]
    assert (len(table), table[0], table[-1]) == (2, (0, 0.5), (1, 0.25))
    with pytest.raises(IndexError):
        table[2]
    assert list(table.columns) == ["m", "efficiency"]
    assert not table["m"].flags.writeable
    with pytest.raises(KeyError, match="did you mean 'efficiency'"):
        table["eficiency"]


@pytest.mark.parametrize(
    ("columns", "error", "message"),
    [({"a": [1.0, 2.0], "b": [1.0]}, ValueError, r"columns must have the same length, got \[1, 2\]"),
     ({}, ValueError, "columns must have the same length"),
     ({"a": [[1.0]]}, ValueError, r"columns: 'a' must have shape \(n,\), got \(1, 1\)"),
     ({"a": [None]}, TypeError, "columns: 'a' must be numbers or texts, got object")],
)  # fmt: skip
def test_columns_that_make_no_table_are_refused(columns, error, message):
    with pytest.raises(error, match=message):
        wd.Table(columns)


def test_files_that_cannot_be_written_are_refused_and_nothing_is_left(tmp_path):
    table = wd.Table({"m": [0]})
    with pytest.raises(ValueError, match=r"path must end in \.csv, got 'x\.txt'"):
        table.save("x.txt")
    with pytest.raises(FileNotFoundError, match=r"path: the folder .* does not exist"):
        table.save(tmp_path / "absent" / "x.csv")
    assert not list(tmp_path.iterdir())


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = wd.Table({"m": [0]}).save(tmp_path / "x.csv")

    def full(*_args, **_keywords):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_text", full)
    with pytest.raises(OSError, match="No space left"):
        wd.Table({"m": [1]}).save(path)
    assert path.read_text() == "m\n0\n"
    assert list(tmp_path.iterdir()) == [path]
