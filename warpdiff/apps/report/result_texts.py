"""Texts that several sections of a report use: values with errors, light, and reasons for absent results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpdiff.apps.report.html_parts import text_of
from warpdiff.heightfield.roughness import with_error

if TYPE_CHECKING:
    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.heightfield.roughness import RoughnessParameter

# Azimuth of the y axis [degrees].
_Y_DEG = 90.0
# Height [µm] below which the page states heights in nanometres, and number of nanometres per micrometre.
_LEAST_MICROMETRES, _NM_PER_UM = 1.0, 1e3
# First words of the paragraph about an absent result.
_ABSENT = {
    "roughness": "Roughness parameters were not found",
    "periods": "No period was found",
    "verdicts": "The theory was not judged",
    "orders": "Orders were not computed",
    "colours": "Colours were not computed",
    "map": "The map was not computed",
    "comparison": "The comparison was not possible",
}


def value_text(value: float, error: float | None) -> str:
    """Return a value with its standard error as text; an error of None is omitted."""
    return f"{value:.4g}" if error is None else with_error(value, error)


def absent_text(data: ReportData, name: str) -> str:
    """Return an HTML paragraph with the reason why a result is absent; an empty text if the result exists."""
    if name not in data.reasons:
        return ""
    return f'<p class="absent"><b>{_ABSENT[name]}:</b> {text_of(data.reasons[name])}.</p>\n'


def grade_text(grade: str) -> str:
    """Return the HTML text of the grade of reliability of scalar diffraction: reliable, qualitative or invalid."""
    return f'<span class="grade {grade}">{grade}</span>'


def light_text(data: ReportData) -> str:
    """Return the direction and the spectrum of the light as text."""
    axis = axis_of(data)
    side = f" on the side of {'+' if data.light_deg > 0.0 else '−'}{axis}" if data.light_deg else ""
    return (
        f"θ = {abs(data.light_deg):.3g}° from the normal{side}, in the plane at the azimuth "
        f"φ = {data.azimuth_deg:.1f}° from x towards y; illuminant {data.request.illuminant}"
    )


def axis_of(data: ReportData) -> str:
    """Return the name of the axis towards which view angles are positive."""
    return "x" if data.azimuth_deg < _Y_DEG else "y"


def parameter_text(parameter: RoughnessParameter) -> str:
    """Return value, error and unit of a roughness parameter as text; heights below 1 µm are in nanometres."""
    if parameter.value is None:
        return "not determined"
    is_small = parameter.unit == "µm" and parameter.name in ("Sa", "Sq") and parameter.value < _LEAST_MICROMETRES
    factor, unit = (_NM_PER_UM, "nm") if is_small else (1.0, parameter.unit)
    error = None if parameter.standard_error is None else factor * parameter.standard_error
    return f"{value_text(factor * parameter.value, error)} {unit}".rstrip()
