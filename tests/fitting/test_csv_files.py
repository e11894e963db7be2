"""CSV files of measured data must be read in all usual forms: encodings, separators, units, percent and empty cells."""

import numpy as np
import pytest

import warpdiff as wd

HEADING = "light_theta_deg,light_phi_deg,wavelength_nm,m_y,m_x,efficiency"
ROWS = "10,0,550,0,-1,0.0625\n10,0,550,0,0,0.25\n"
PLAIN = f"{HEADING}\n{ROWS}"
PERCENT = PLAIN.replace("efficiency", "efficiency [%]").replace("0.0625", "6.25 %").replace("0.25", "25")


def read(tmp_path, text, encoding="utf-8"):
    file = tmp_path / "data.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return wd.Measured.from_csv(file)


def german(text):
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (PLAIN, "utf-8-sig"), (PLAIN, "utf-16"), (PLAIN.replace("\n", "\r\n"), "utf-8"), (german(PLAIN), "utf-8-sig"),
        (PLAIN.replace(",", "\t"), "utf-8"), (german(PLAIN).replace(";", "\t"), "cp1252"),
        (f"sep=;\n{german(PLAIN)}", "utf-8"), (f"# spectrometer 3\n\n{PLAIN}\n\n", "utf-8"),
        (PLAIN + ",,,,,\n", "utf-8"), (PLAIN.replace("\n", ",\n"), "utf-8"),
        (PLAIN.replace(HEADING, "Light theta [deg],light-phi (°), Wavelength [nm] ,M_y,m_x,Efficiency"), "cp1252"),
        (f"note,{PLAIN.replace('10,', 'a,10,')}", "utf-8"),
        (PLAIN.replace("wavelength_nm", '"wavelength_nm"'), "utf-8"),
        (PLAIN.replace("wavelength_nm", "wavelength [µm]").replace("550", "0.55"), "utf-8"),
        (PLAIN.replace("efficiency", "efficiency (%)").replace("0.0625", "6.25").replace("0.25", "25"), "utf-8"),
        (PLAIN.replace("0.0625", "6.25 %").replace("0.25", "25%"), "utf-8"),
        (f"note,{PLAIN.replace('10,', chr(34) + 'two' + chr(10) + 'lines' + chr(34) + ',10,')}", "utf-8"),
        (german(PERCENT), "utf-8"),
    ],
)  # fmt: skip
def test_files_of_spreadsheets_are_read(tmp_path, text, encoding):
    measured = read(tmp_path, text, encoding)
    assert measured.kind == "orders"
    np.testing.assert_allclose(measured.values, [0.0625, 0.25])
    grating = wd.gratings.sinusoidal(2.0, 0.1)
    expected = wd.Measured.orders(wd.direction(10.0), 550.0, [(0, -1), (0, 0)], [0.0625, 0.25]).predict(grating).value
    np.testing.assert_allclose(measured.predict(grating).value, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("light_theta_deg,efficiency\n0,1\n", "columns of one kind of data"),
        ("a,b\n1,2\n", "got none of them"), ("", "is empty"), (f"{HEADING}\n", "at least one line of numbers"),
        (PLAIN.replace("0.0625", ""), "column 'efficiency' in line 2 must be a finite number, got an empty cell"),
        (PLAIN.replace(",0.25", ""), "column 'efficiency' in line 3 must be a finite number, got an empty cell"),
        (PLAIN.replace("0.25", "nan"), "line 3 must be a finite number, got 'nan'"),
        (PLAIN.replace("550", "green", 1), "column 'wavelength_nm' in line 2 must be a finite number, got 'green'"),
        (PLAIN.replace("0.0625", "0,0625"), "line 2 must have 6 cells, got 7: separate columns by semicolons"),
        (german(PLAIN).replace("0,0625", "1.000,5"), "got '1.000,5'"),
        (PLAIN.replace("550", "55 %", 1), "got '55 %'"),
        (PLAIN.replace("m_y", "m_x"), "column 'm_x' occurs 2 times"),
        (PLAIN.replace("wavelength_nm", "wavelength"), "columns of one kind of data"),
        (PLAIN.replace("wavelength_nm", "wavelength [eV]"), "columns of one kind of data"),
        (PLAIN.replace("wavelength_nm", "wavelength_nm [µm]"), "columns of one kind of data"),
        (b"\x89PNG\x00\x00\xff\xfe", "contains NUL characters"),
        (PLAIN.replace(",-1,", ",0.5,"), "orders must be integers"),
    ],
)  # fmt: skip
def test_errors_name_the_line_and_the_column(tmp_path, text, message):
    with pytest.raises(ValueError, match=message.replace("[", r"\[").replace("(", r"\(")):
        read(tmp_path, text)


def test_missing_files_and_files_of_two_kinds_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"path: .* is not a file"):
        wd.Measured.from_csv(tmp_path)
    both = "light_theta_deg,light_phi_deg,view_theta_deg,view_phi_deg,wavelength_nm,relative_reflectance,X,Y,Z\n"
    with pytest.raises(ValueError, match="columns of one kind"):
        read(tmp_path, both + "0,0,0,0,550,0.5,0.4,0.5,0.3\n")


@pytest.mark.usefixtures("unreadable_files")
def test_errors_of_the_system_name_the_file(tmp_path):
    path = tmp_path / "measured.csv"
    path.touch()
    with pytest.raises(OSError, match=r"path: '.*measured\.csv' cannot be read: Input/output error"):
        wd.Measured.from_csv(path)


def test_small_letters_are_positions_and_no_colours(tmp_path):
    columns = "light_theta_deg,light_phi_deg,view_theta_deg,view_phi_deg,X,Y,Z,x,y,z\n"
    assert read(tmp_path, columns + "0,0,0,0,0.4,0.5,0.3,7,8,9\n").values.tolist() == [0.4, 0.5, 0.3]
