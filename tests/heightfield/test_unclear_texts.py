"""Texts of heights whose header or numbers may be read in two ways: they are read only if one way is possible."""

from pathlib import Path
from typing import Any

import height_texts
import numpy as np
import pytest

from warpdiff.heightfield.field import HeightField

RNG = np.random.default_rng(3)
HEIGHTS = np.round(RNG.normal(0.0, 20.0, (9, 12)), 3)
LARGE = np.round(RNG.normal(0.0, 900.0, (9, 12)), 2)
GAP = HEIGHTS.copy()
GAP[2, 3] = np.nan
GROUPED = RNG.integers(1000, 9999, (9, 12)) / 1000
SIZE, UNIT = "Width: 6 µm\nHeight: 3.6 µm\n", "Z unit: nm\n"
PITCH = (0.4, 0.5)


def table(values: np.ndarray = HEIGHTS, separator: str = "\t", form: str = "{:.3f}", **options: str) -> str:
    """Return the text of a matrix of heights, with tabs and three decimals."""
    return height_texts.table(values, separator, form=form, **options)


def with_code(code: str) -> str:
    """Return the text of the matrix of heights, in which a code for missing data replaces one sample."""
    return table(GAP, gap=code)


def points(form: str = "{x:.1f}\t{y:.1f}\t{z}", noise: float = 0.0) -> str:
    """Return the text of points x, y, z [µm, µm, nm] with random displacements of ``noise`` pitches."""
    rng = np.random.default_rng(0)
    return "\n".join(
        form.format(i=i, j=j, x=0.5 * (i + noise * rng.normal()), y=0.4 * (j + noise * rng.normal()), z=HEIGHTS[j, i])
        for j in range(9) for i in range(12)
    )  # fmt: skip


EMPTY_FIRST = np.hstack([np.full((9, 1), np.nan), HEIGHTS])
# Unclear text files that are read correctly: the text, the expected heights in µm from the top of the picture, and the
# options of ``load``.
READ: dict[str, tuple[str, np.ndarray, dict[str, Any]]] = {
    # Texts with thousands separators and decimal signs in numbers.
    "thousands and decimals in a size": (f"X Size: 6,000.0 nm\nY Size: 3,600.0 nm\n{UNIT}{table()}", HEIGHTS, {}),
    "apostrophes in a size": (f"X Size: 6'000 nm\nY Size: 3’600 nm\n{UNIT}{table()}", HEIGHTS, {}),
    "a decimal comma that is no separator": (f"Pixel size: 0,5 x 0,4 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "a decimal point above decimal commas": (f"{SIZE}{UNIT}{table(decimal=',')}", HEIGHTS, {}),
    "three decimals in the heights": (
        f"X Size: 6,0 µm\nY Size: 3,6 µm\n{UNIT}{table(GROUPED, decimal=',')}", GROUPED, {}
    ),
    "thousands between tabs": (table(LARGE, form="{:,.2f}"), LARGE, {"unit": "nm", "pitch_um": PITCH}),
    "thousands between blanks": (table(LARGE, "  ", form="{:,.2f}"), LARGE, {"unit": "nm", "pitch_um": PITCH}),
    "thousands in quotes": (table(LARGE, ",", form='"{:,.2f}"'), LARGE, {"unit": "nm", "pitch_um": PITCH}),
    "spaces between thousands": (
        table(LARGE, ";", form="{:,.2f}").replace(".", "d").replace(",", "\xa0").replace("d", ","), LARGE,
        {"unit": "nm", "pitch_um": PITCH},
    ),
    "narrow spaces between thousands": (
        table(LARGE, ";", form="{:,.2f}").replace(",", "\u202f"), LARGE, {"unit": "nm", "pitch_um": PITCH}
    ),
    "points between thousands": (
        table(LARGE, ";", form="{:,.2f}").replace(".", "d").replace(",", ".").replace("d", ","), LARGE,
        {"unit": "nm", "pitch_um": PITCH},
    ),
    "apostrophes between thousands": (
        table(LARGE, form="{:,.2f}").replace(",", "'"), LARGE, {"unit": "nm", "pitch_um": PITCH}
    ),
    # Texts with two lengths or two axes in one line, in different orders.
    "axes in brackets before": (f"Pixel size (x): 0.5 µm, (y): 0.4 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "axes in brackets behind": (f"Lateral sampling: 0.5 µm/px (x), 0.4 µm/px (y)\n{UNIT}{table()}", HEIGHTS, {}),
    "axes in words": (f"Sampling distance: 0.5 µm in x, 0.4 µm in y\n{UNIT}{table()}", HEIGHTS, {}),
    "axes as keys": (f"Sampling interval: X 0.5 um Y 0.4 um\n{UNIT}{table()}", HEIGHTS, {}),
    "two keys": (f"xsize 6 um ysize 3.6 um\n{UNIT}{table()}", HEIGHTS, {}),
    "lines and points": (f"Line spacing: 0.4 µm\nPoint spacing: 0.5 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "rows and columns": (f"Row pitch: 400 nm\nColumn pitch: 500 nm\n{UNIT}{table()}", HEIGHTS, {}),
    "an order behind": (f"Scan size: 3.6 x 6 µm (height x width)\n{UNIT}{table()}", HEIGHTS, {}),
    "an order before": (f"Pixel size (y x x): 0.4 x 0.5 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "an order instead of a key": (f"Height x Width: 3.6 x 6 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "an order of rows": (f"Field size (rows, columns): 3.6 µm, 6 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "an order of steps": (f"Step (x,y): 0.5 µm, 0.4 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "numbers of samples in brackets": (
        f"Width: 6 µm (12 px)\nHeight: 0.0036 mm (3.6 µm) ± 0.1 µm\n{UNIT}{table()}", HEIGHTS, {}
    ),
    # Texts whose header keys contain units, in different spellings.
    "units in brackets": (f"Size X [um] = 6\nSize Y (um): 3.6\n{UNIT}{table()}", HEIGHTS, {}),
    "units in words": (f"Width in mm: 0.006\nSize Y/µm 3.6\n{UNIT}{table()}", HEIGHTS, {}),
    "ranges": (f"X-Range: 6 µm\nY_Range: 3.6 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "scales per pixel": (f"X Scale: 500 nm/pixel\nΔy = 0.4 µm\n{UNIT}{table()}", HEIGHTS, {}),
    "units of one character": (f"Width: 6 ㎛\nHeight: 3600 ㎚\n{UNIT}{table()}", HEIGHTS, {}),
    "positions with a unit in the corner": (
        UNIT + "y / x [µm]\t" + "\t".join(f"{0.5 * i:.1f}" for i in range(12)) + "\n"
        + "".join(f"{0.4 * (8 - j):.1f}\t{line}\n" for j, line in enumerate(table().splitlines())), HEIGHTS, {},
    ),
    # Texts with codes for missing samples, or with empty columns.
    "a code that is called fill value": (f"{SIZE}{UNIT}_FillValue = -32768\n{with_code('-32768')}", GAP, {}),
    "a code of no data": (f"{SIZE}{UNIT}NODATA_value -9999\n{with_code('-9999')}", GAP, {}),
    "a code of zero": (f"{SIZE}{UNIT}No-data value: 0\n{with_code('0')}", GAP, {}),
    "a code that is rounded": (f"{SIZE}{UNIT}NoData: 3.4028235e+38\n{with_code('3.40282346638529e+38')}", GAP, {}),
    "a code in a word": (f"{SIZE}{UNIT}Invalid = 999.9\n{with_code('999.9')}", GAP, {}),
    "a number of missing samples": (f"{SIZE}{UNIT}Missing: 6\n{table()}", HEIGHTS, {}),
    "two codes": (f"{SIZE}{UNIT}No-data values: -9999, -8888\n{with_code('-8888')}", GAP, {}),
    "a code of points": (
        "No-data value: -1\nx[um]\ty[um]\tz[nm]\n" + points().replace(f"\t{HEIGHTS[2, 3]}", "\t-1"), GAP[::-1], {}
    ),
    "an empty first column": (
        f"Pixel size: 0.5 x 0.4 µm\n{UNIT}" + "".join(f";{line}\n" for line in table(separator=";").splitlines()),
        EMPTY_FIRST, {},
    ),
    "an empty first column that is not counted": (
        f"Columns: 12\n{SIZE}{UNIT}" + "".join(f";{line}\n" for line in table(separator=";").splitlines()), HEIGHTS, {}
    ),
    "infinity": (f"{SIZE}{UNIT}{with_code('Inf')}", GAP, {}),
    # Texts whose unit of heights includes a number, such as 0.1 nm.
    "a number of units": (f"Height unit: 0.1 nm\n{SIZE}{table(10.0 * HEIGHTS)}", HEIGHTS, {}),
    "units of": (f"Heights in units of 10 nm\n{SIZE}{table(0.1 * HEIGHTS, form='{:.4f}')}", HEIGHTS, {}),
    "a length per count": (f"Z scale: 0.5 nm/LSB\n{SIZE}{table(2.0 * HEIGHTS)}", HEIGHTS, {}),
    "a length per count in the key": (f"Height scale [nm/digit] = 0.25\n{SIZE}{table(4.0 * HEIGHTS)}", HEIGHTS, {}),
    "a length of a count": (f"1 LSB = 0.5 nm\n{SIZE}{table(2.0 * HEIGHTS)}", HEIGHTS, {}),
    "a factor of one": (f"{SIZE}{UNIT}Z scale: 1.000\n{table()}", HEIGHTS, {}),
    # Lists of points x, y, z with different names of columns.
    "rows and columns of points": ("row,col,z [nm]\n" + points("{j},{i},{z}"), HEIGHTS, {"pitch_um": PITCH}),
    "lines and pixels of points": ("line;pixel;z [nm]\n" + points("{j};{i};{z}"), HEIGHTS, {"pitch_um": PITCH}),
    "Zeile and Spalte": ("Zeile;Spalte;Höhe [nm]\n" + points("{j};{i};{z}"), HEIGHTS, {"pitch_um": PITCH}),
    "iy and ix": ("iy ix z[nm]\n" + points("{j} {i} {z}"), HEIGHTS[::-1], {"pitch_um": PITCH}),
    "a value in the first column": (
        "Value,X,Y\n" + points("{z},{i},{j}"), HEIGHTS[::-1], {"unit": "nm", "pitch_um": PITCH}
    ),
    # Lists of points whose positions have noise, or are rounded to single precision.
    "noise of positions": ("x[um]\ty[um]\tz[nm]\n" + points("{x:.9f}\t{y:.9f}\t{z}", 1e-3), HEIGHTS[::-1], {}),
    "little noise of positions": ("x[um]\ty[um]\tz[nm]\n" + points("{x:.12f}\t{y:.12f}\t{z}", 1e-7), HEIGHTS[::-1], {}),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_clear_texts_are_read(tmp_path: Path, name: str) -> None:
    text, heights, options = READ[name]
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    scan = HeightField.load(tmp_path / "a.txt", **options)
    assert scan.source is not None
    picture = scan.heights_um[::-1] if scan.source.rows == "up" else scan.heights_um
    np.testing.assert_allclose(picture, 1e-3 * heights, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(scan.pitch_um, PITCH, rtol=1e-4)


# Channel, width, height and unit of the heights as the program Gwyddion writes them in its languages.
GWYDDION = (
    ("Channel:", "Width:", "Height:", "Value units:"), ("Kanál:", "Šířka:", "Výška:", "Jednotky hodnot:"),
    ("Kanal:", "Breite:", "Höhe:", "Einheiten:"), ("Canal:", "Anchura:", "Altura:", "Value units:"),
    ("Canal :", "Largeur :", "Hauteur :", "Unités :"), ("Canale:", "Larghezza:", "Altezza:", "unità valore:"),
    ("チャネル：", "幅:", "高さ：", "値の単位:"), ("채널:", "폭:", "높이:", "값 단위:"),
    ("Canal:", "Largura:", "Altura:", "Unidades de valor:"), ("Канал:", "Ширина:", "Высота:", "Единицы измерения:"),
)  # fmt: skip


@pytest.mark.parametrize("words", GWYDDION, ids=[words[1].strip(" :") for words in GWYDDION])
def test_headers_of_gwyddion_are_read_in_all_its_languages(tmp_path: Path, words: tuple[str, str, str, str]) -> None:
    channel, width, height, unit = words
    header = f"# {channel} Topo\n# {width} 6,00 µm\n# {height} 3,60 µm\n# {unit} nm\n"
    (tmp_path / "a.txt").write_text(header + table(decimal=","), encoding="utf-8")
    assert HeightField.channels(tmp_path / "a.txt") == ("Topo",)
    scan = HeightField.load(tmp_path / "a.txt")
    np.testing.assert_allclose(scan.heights_um[::-1], 1e-3 * HEIGHTS)
    np.testing.assert_allclose(scan.pitch_um, PITCH)


ASK_PITCH, ASK_UNIT = "exactly one of extent_um .* neither .*", "unit must be given: .*"
# Texts that are refused, or for which the caller must state a size or unit: the text, the error and the options.
UNCLEAR: dict[str, tuple[str, str, dict[str, Any]]] = {
    "a comma in a size": (f"Width: 6,000 nm\nHeight: 3,600 nm\n{UNIT}{table()}", ASK_PITCH + "'Width: 6,000 nm'", {}),
    "a point in a size": (
        f"Breite: 6.000 nm\nHöhe: 3.600 nm\n{UNIT}{table(decimal=',')}", ASK_PITCH + r"'Breite: 6\.000 nm'", {}
    ),
    "a comma in a size of whole heights": (f"Pixel size: 1,000 nm\n{UNIT}{table(form='{:.0f}')}", ASK_PITCH, {}),
    "three digits behind all commas": (
        f"X Size: 6,000 µm\nY Size: 3,600 µm\n{UNIT}{table(GROUPED, decimal=',')}", ASK_PITCH + "'X Size: 6,000 µm'", {}
    ),
    "a comma between two numbers": (f"Pixel size: 0.5, 0.4 µm\n{UNIT}{table()}", ASK_PITCH + "is not clear", {}),
    "a list with commas": (f"Spacing: 1,2 µm\n{UNIT}{table()}", ASK_PITCH + "may not be a decimal sign", {}),
    "commas in heights": (
        f"Width: 6.00 µm\nHeight: 3.60 µm\n{UNIT}{table(GROUPED, decimal=',')}", "',' may separate thousands", {}
    ),
    "points in heights": (
        f"Width: 6,00 µm\nHeight: 3,60 µm\n{UNIT}{table(GROUPED)}", r"'\.' may separate thousands.*'Width: 6,00 µm'", {}
    ),
    "commas in some heights": ("987\t1,234\t2,345\n3,456\t4,567\t12\n", "',' may separate thousands", {"unit": "nm"}),
    "two axes without an order": (f"Pixel size: 0.5 µm (y: 0.4 µm)\n{UNIT}{table()}", ASK_PITCH + "is not clear", {}),
    "an unknown order": (f"Pixel size: 0.4 x 0.5 µm (slow x fast)\n{UNIT}{table()}", ASK_PITCH + "slow x fast", {}),
    "an aspect ratio": (f"Scan size: 6 µm\nAspect ratio: 5:3\n{UNIT}{table()}", ASK_PITCH + "Aspect ratio", {}),
    "a range": (f"Scan range X: 0 to 6 um\nScan range Y: 0 to 3.6 um\n{UNIT}{table()}", ASK_PITCH + "0 to 6 um", {}),
    "a size that is one number": (f"Scan size: 6 µm\n{UNIT}{table()}", ASK_PITCH + "one size for 12 × 9 samples", {}),
    "a size without a unit": (f"x-length = 6\ny-length = 3.6\n{UNIT}{table()}", ASK_PITCH + "has no unit", {}),
    "two units of positions": (f"X unit: mm\nY unit: µm\nWidth: 6\nHeight: 3\n{UNIT}{table()}", ASK_PITCH, {}),
    "a size that contradicts a pitch": (
        f"Pixel size: 0.1 µm\n{SIZE}{UNIT}{table()}", ASK_PITCH + "'Width: 6 µm' contradicts 'Pixel size: 0.1 µm'", {}
    ),
    "an empty last column that is needed": (
        f"{SIZE}Pixel size X: 0.5 µm\n{UNIT}" + table(HEIGHTS[:, :11], ";").replace("\n", ";\n"),
        "empty .* last column", {},
    ),
    "a multiplier": (f"{SIZE}{UNIT}Z multiplier: 1e-3\n{table()}", "factor .* 'Z multiplier: 1e-3'", {}),
    "a sentence with a factor": (f"{SIZE}{UNIT}Multiply values by 0.5\n{table()}", "'Multiply values by 0.5'", {}),
    "a scale that may be a range": (f"{SIZE}{UNIT}Z scale: 100 nm\n{table()}", "'Z scale: 100 nm'", {}),
    "a factor of points": ("Z scale: 0.5\nx[um]\ty[um]\tz[nm]\n" + points(), "'Z scale: 0.5'", {}),
    "a code that may be a number of samples": (
        f"{SIZE}{UNIT}Missing: 6\n{with_code('6.000')}", "may be a code of missing samples", {}
    ),
    "a unit in the key that contradicts another": (
        f"Width (nm): 6 µm\nHeight: 3.6 µm\n{UNIT}{table()}", ASK_PITCH + "Width", {}
    ),
    "a factor of values": (f"{SIZE}z = value * 0.5\n{table()}", "factor of its heights", {"unit": "nm"}),
    "a unit that contradicts a scale": (
        f"{SIZE}{UNIT}Z scale: 0.5 nm/LSB\n{table()}", ASK_UNIT + "'Z unit: nm' contradicts 'Z scale: 0.5 nm/LSB'", {}
    ),
    "a unit that contradicts a heading": (
        "Z unit: 10 nm\nx[um]\ty[um]\tz[nm]\n" + points(), ASK_UNIT + "contradicts the heading", {}
    ),
    "headings i and j": ("i j z\n" + points("{i} {j} {z}"), "columns 'i', 'j', 'z'; name them", {"unit": "nm"}),
    "unknown headings": ("a;b;z\n" + points("{i};{j};{z}"), "columns 'a', 'b', 'z'; name them", {"unit": "nm"}),
    "positions with much noise": ("x[um]\ty[um]\tz[nm]\n" + points("{x}\t{y}\t{z}", 0.05), "grid; interpolate", {}),
    "a hexagonal grid": (
        "x[um] y[um] z[nm]\n" + "".join(f"{i + j % 2 / 2} {0.8 * j:.1f} 1\n" for j in range(6) for i in range(7)),
        "at 42 of the", {},
    ),
    "a Wyko export": ("Wyko ASCII Data File Format 0\t1\t1\nX Size\t3\n" + table(), "lines run along y", {}),
    **{
        f"{line}": (f"{line}\n{SIZE}{UNIT}{table()}", "header states 24 in the line", {})
        for line in ("24 x 9 pixels", "xres=24 yres=9", "columns 24 rows 9", "NX 24 NY 9", "9 rows, 24 columns",
                     "Resolution: 24x9", "Pixels: 24 x 9", "X-Pixels: 24", "nx = 24, ny = 9", "Samples/line: 24",
                     "Lines x Points: 9 x 24")
    },
    **{
        f"unit {unit}": (f"{SIZE}Value units: {unit}\n{table()}", "which is no unit of length", {})
        for unit in ("%", "a.u.", "nm/V", "nm²", "Nm", "arb. units")
    },
}  # fmt: skip


@pytest.mark.parametrize("name", UNCLEAR)
def test_unclear_texts_are_refused_with_their_line(tmp_path: Path, name: str) -> None:
    text, message, options = UNCLEAR[name]
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        HeightField.load(tmp_path / "a.txt", **options)


def test_changes_of_the_reader_are_in_the_history(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(f"{SIZE}{UNIT}Missing value: -1\n{with_code('-1')}", encoding="utf-8")
    scan = HeightField.load(tmp_path / "a.txt")
    assert scan.history == (
        "Loaded: read 1 sample(s) as missing, as the header states in the line 'Missing value: -1'.",
    )
    assert scan.missing.sum() == 1
    wsxm = "WSxM file copyright UAM\nX Amplitude: 6 µm\nY Amplitude: 3.6 µm\nZ Amplitude: 17.5 nm\n"
    (tmp_path / "b.txt").write_text(wsxm + table(HEIGHTS[::-1, ::-1]), encoding="utf-8")
    scan = HeightField.load(tmp_path / "b.txt")
    np.testing.assert_allclose(scan.heights_um[::-1], 1e-3 * HEIGHTS)
    assert "reversed the rows and the columns" in scan.history[0]
    assert "row 0 of the picture in 'b.txt' at the top, the largest y" in scan.summary().orientation
