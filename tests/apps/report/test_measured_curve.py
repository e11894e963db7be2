"""Files of measured curves: columns by their names, refusals, and the scale of a computed curve."""

import numpy as np
import pytest

from warpdiff.apps.report.measured_curve import compare_curves, read_curve


def write(folder, text, name="curve.csv"):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def test_a_spectrum_has_its_columns_by_name(tmp_path):
    curve = read_curve(write(tmp_path, "wavelength_nm,reflectance\n600,0.2\n400,0.1\n500,0.3\n"))
    assert curve.against == "wavelength_nm"
    assert curve.name == "reflectance"
    assert curve.positions.tolist() == [400.0, 500.0, 600.0]
    assert curve.values.tolist() == [0.1, 0.3, 0.2]
    assert curve.errors is None
    assert curve.wavelength_nm is None


def test_a_goniometer_curve_may_have_units_decimal_commas_errors_and_one_wavelength(tmp_path):
    text = "# laser\nPower;Angle [°];Power std;Wavelength (nm)\n" + "".join(
        f"{value};{angle};0,5;632,8\n" for value, angle in (("1,5", -10), ("2,5", 0), ("", 5), ("3,5", 10))
    )
    curve = read_curve(write(tmp_path, text))
    assert (curve.against, curve.name, curve.wavelength_nm) == ("angle_deg", "power", 632.8)
    assert curve.positions.tolist() == [-10.0, 0.0, 10.0]
    assert curve.values.tolist() == [1.5, 2.5, 3.5]
    assert curve.errors.tolist() == [0.5] * 3
    assert curve.skipped == 1


def test_a_spectrum_may_state_its_view_angle(tmp_path):
    rows = "".join(f"{nm},-12,{nm / 1000}\n" for nm in (400, 500, 600))
    curve = read_curve(write(tmp_path, f"wavelength_nm,angle_deg,rho\n{rows}"))
    assert (curve.against, curve.view_deg) == ("wavelength_nm", -12.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n2,3\n3,4\n", "must have a column wavelength_nm or angle_deg, got 'a', 'b'; name the columns"),
        ("1,2\n2,3\n3,4\n", "has no line with the names of its 2 columns"),
        ("nothing here\n", "has no rows of numbers"),
        ("wavelength_nm,r\n500,1\n600,2\n", "must have at least 3 rows of numbers, got 2"),
        ("wavelength_nm,r,s\n500,1,1\n600,2,2\n700,3,3\n", "must have one column of values"),
        ("angle_deg,r\n-95,1\n0,2\n10,3\n", "must have angles above -90 and below 90, got -95"),
        ("wavelength_nm,r\n50,1\n60,2\n70,3\n", "50"),
        ("angle_deg,wavelength_nm,r\n0,500,1\n1,600,2\n2,700,3\n", "must have one of wavelength_nm and angle_deg that"),
    ],
)
def test_other_texts_are_refused_with_a_reason(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read_curve(write(tmp_path, text))


def test_a_file_that_does_not_exist_names_the_argument(tmp_path):
    with pytest.raises(FileNotFoundError, match="compare: there is no file"):
        read_curve(tmp_path / "absent.csv")


def test_the_scale_is_that_of_least_squares_with_its_error(tmp_path, rng):
    x = np.linspace(400.0, 700.0, 301)
    computed = np.exp(-(((x - 550.0) / 40.0) ** 2))
    values = 3.0 * computed + rng.normal(0.0, 0.05, x.shape)
    rows = "".join(f"{a},{b}\n" for a, b in zip(x, values, strict=True))
    comparison = compare_curves(read_curve(write(tmp_path, f"wavelength_nm,r\n{rows}")), computed, "test")
    # The error of a scale that is fitted to noise of 0.05 is that over the norm of the curve.
    assert comparison.scale_error == pytest.approx(0.05 / np.linalg.norm(computed), rel=0.2)
    assert abs(comparison.scale - 3.0) < 4.0 * comparison.scale_error
    assert comparison.residual == pytest.approx(0.05 / values.max(), rel=0.2)
    assert comparison.correlation > 0.99
    with pytest.raises(ValueError, match="computed values are zero"):
        compare_curves(comparison.measured, 0.0 * computed, "test")
