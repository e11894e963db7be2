"""Text files of heights with random separators, number formats, gaps and encodings are read exactly or refused."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from endurance import SEED, count

from warpdiff.heightfield.field import HeightField

# Units of length that a text file may use, with their sizes [µm].
UNITS = {"nm": 1e-3, "µm": 1.0, "mm": 1e3}
# Formats of numbers. Each has the standard deviation of the random heights that are written in this format.
FORMS = {"{:.0f}": 50.0, "{:.2f}": 20.0, "{:.4f}": 1.0, "{:.5e}": 1e-3, "{:.5E}": 1e-3, "{:.6g}": 1e-2}
SEPARATORS = ("\t", ";", ",", " ", "  ", ", ", "; ")
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252")


class Export(NamedTuple):
    """A text file of heights, and the result that ``HeightField.load`` must return.

    Attributes:
        text: Text of the file.
        options: Arguments of ``HeightField.load``, for what the text does not state.
        heights: Expected heights [µm], in the order of the text.
        pitch: Expected sample spacing (dy, dx) [µm].
    """

    text: str
    options: dict[str, Any]
    heights: np.ndarray
    pitch: tuple[float, float]


def numbers(values: np.ndarray, form: str, decimal: str) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers as texts in a format, and the numbers that these texts state after rounding."""
    texts = np.array([form.format(value) for value in values.ravel()]).reshape(values.shape)
    written = texts.astype(float)
    return np.char.replace(np.char.replace(texts, ".", decimal), "E", "D" if decimal == "." else "E"), written


def matrix(rng: np.random.Generator) -> Export:
    """Return a text with a matrix of heights, with or without a header."""
    ny, nx = int(rng.integers(2, 12)), int(rng.integers(4, 12))
    form = str(rng.choice(list(FORMS)))
    separator = str(rng.choice(SEPARATORS))
    decimal = "," if separator.strip() != "," and rng.random() < 0.4 else "."
    texts, values = numbers(FORMS[form] * rng.normal(size=(ny, nx)), form, decimal)
    gaps = ("NaN", "BAD", "---", "No Data") if separator.isspace() else ("NaN", "BAD", "---", "No Data", "")
    is_gap = rng.random((ny, nx)) < rng.choice([0.0, 0.05, 0.3])
    texts = np.where(is_gap, str(rng.choice(gaps)), texts)
    if rng.random() < 0.2 and not separator.isspace():
        texts = np.char.add(np.char.add('"', texts), '"')
    end = separator.strip(" ") if rng.random() < 0.15 else ""
    unit = str(rng.choice(list(UNITS)))
    header, options = [
        ("", {"unit": unit, "pitch_um": (0.5, 0.25)}),
        (f"heights in {unit}\n", {"pitch_um": (0.5, 0.25)}),
        (f"# Channel: Z\n# Width: {nx * 0.25:g} µm\n# Height: {ny * 500} nm\n# Value units: {unit}\n", {}),
        (f"Columns: {nx}\nRows: {ny}\nPixel size X = 0.25 µm\nPixel size Y = 0.5 µm\nZ unit: {unit}\n", {}),
    ][rng.integers(4)]
    text = header + "\n".join(separator.join(row) + end for row in texts)
    return Export(text, options, UNITS[unit] * np.where(is_gap, np.nan, values), (0.5, 0.25))


def points(rng: np.random.Generator) -> Export:
    """Return a text with a list of points x, y, z on a grid, in any order. Some points of the grid may be absent."""
    ny, nx = rng.integers(4, 20, 2)
    (dx, dy), offset = rng.choice([0.1, 0.25, 1.37], 2), rng.normal(size=2)
    separator = str(rng.choice(["\t", ";", ",", " "]))
    decimal = "," if separator != "," and rng.random() < 0.3 else "."
    lateral, unit = (str(rng.choice(list(UNITS))) for _ in range(2))
    header = [
        f"X [{lateral}]{separator}Y [{lateral}]{separator}Z [{unit}]\n", f"x({lateral}) y({lateral}) z({unit})\n",
        f"x_{lateral}{separator}y_{lateral}{separator}z_{unit}\n",
    ][rng.integers(3)]  # fmt: skip
    j, i = np.mgrid[:ny, :nx]
    texts, values = numbers(20.0 * rng.normal(size=(ny, nx)), "{:.3f}", decimal)
    is_absent = rng.random((ny, nx)) < rng.choice([0.0, 0.2])
    # Points in the corners of the grid are never absent, because the reader derives the size of the grid from them.
    is_absent[[0, -1], [0, -1]] = False
    x, y = (numbers(offset[k] + step * n, "{:.5f}", decimal)[0] for k, (step, n) in enumerate(((dx, i), (dy, j))))
    rows = np.array([separator.join(row) for row in zip(x[~is_absent], y[~is_absent], texts[~is_absent], strict=True)])
    text = header + "\n".join(rng.permutation(rows) if rng.random() < 0.5 else rows)
    heights = UNITS[unit] * np.where(is_absent, np.nan, values)
    return Export(text, {}, heights, (dy * UNITS[lateral], dx * UNITS[lateral]))


@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
@pytest.mark.permanent("random text exports", shares=5)
def test_random_exports_are_read_exactly_or_refused(tries, tmp_path):
    path, refusals = tmp_path / "a.txt", []
    for index in tries.of(range(count(40, 50_000))):
        rng = np.random.default_rng([SEED or 3, index])
        export = (matrix if rng.random() < 0.6 else points)(rng)
        line_end = str(rng.choice(["\n", "\r\n", "\r"]))
        path.write_bytes(export.text.replace("\n", line_end).encode(str(rng.choice(ENCODINGS))))
        try:
            scan = HeightField.load(path, **export.options)
        except ValueError as error:
            refusals.append(str(error))
            continue
        # A file with a matrix has row 0 at the top of the picture. In a loaded field with rows "up", row 0 is at the
        # bottom, so that the order of the rows is reversed. A list of points begins with the smallest y, which is also
        # row 0 of the loaded field. The order of its rows is therefore not reversed.
        is_down = scan.source.rows == "up" and export.text[:1] not in "Xx"
        heights = scan.heights_um[::-1] if is_down else scan.heights_um
        np.testing.assert_allclose(heights, export.heights, rtol=1e-12, err_msg=f"{index}: {export.text[:300]!r}")
        np.testing.assert_allclose(scan.pitch_um, export.pitch, rtol=1e-4)
    # A few files may be refused, because they are ambiguous. If all rows end with empty cells, for example, a column of
    # missing samples cannot be distinguished from separators at the ends of rows.
    assert all(message.startswith(f"path: '{path}'") for message in refusals)
    assert len(refusals) <= 1 + 0.05 * tries.number
