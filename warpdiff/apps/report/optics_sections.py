"""Sections of a report about diffraction: scalar theory, orders, colours, reflectance map, measured curve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.apps.report.html_parts import RIGHT, Html, facts_table, paragraph, table_of, text_of
from warpdiff.apps.report.report_data import PATCH_IN_SIGMAS
from warpdiff.apps.report.result_texts import absent_text, axis_of, grade_text, light_text
from warpdiff.heightfield.roughness import with_error

if TYPE_CHECKING:
    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.apps.report.report_numbers import JsonObject
    from warpdiff.core.table import Table

# Largest number of orders that the page lists for each wavelength, the strongest ones. It was chosen so that the table
# fits on a page; the CSV file has all orders.
_MOST_ORDERS = 15
# Text in the table of orders for an efficiency that is smaller than its error.
_NOT_DISTINGUISHABLE = "not distinguishable from zero"
# The table of orders lists signed angles only if all orders are in the plane of the light and the normal. The number is
# the largest distance of the end of an order's unit vector from this plane, the sine of an angle of 0.06°.
_IN_PLANE = 1e-3
# Explanation of the three grades of reliability of scalar diffraction, as HTML text.
_GRADES = (
    "Reliable: use colours, and efficiencies that exceed their error. Qualitative: use the positions of colours, and "
    "not their brightness. Invalid: use nothing but the angles of orders."
)
# Sentences that explain why scalar diffraction is inaccurate, by the name of the reason that the library gives.
_CAUSES = {
    "energy": (
        " Scalar diffraction does not conserve energy: the efficiencies of all orders sum to more or less than the "
        "reflected light."
    ),
    "narrow": (
        " Features narrower than two wavelengths are components of the relief with periods below two wavelengths, "
        "where light no longer follows the scalar theory."
    ),
}


def theory_section(data: ReportData) -> str:
    """Return the HTML table of the reliability of scalar diffraction at each wavelength."""
    if not data.verdicts:
        return absent_text(data, "verdicts")
    powers, errors = data.flat_powers, data.efficiency_errors
    rows, names = [], ["Wavelength" + RIGHT, "Grade", "Error, share of reflected light" + RIGHT]
    for k, verdict in enumerate(data.verdicts):
        of_incident: list[str] = []
        if powers is not None and errors is not None:
            of_incident = [f"{100.0 * powers[k]:.2g} %", f"{100.0 * errors[k]:.2g} %"]
        rows.append([
            f"{verdict.wavelength_nm:g} nm", Html(grade_text(verdict.grade)),
            f"{100.0 * min(verdict.error, 1.0):.2g} %", *of_incident,
            verdict.explanation if verdict.error > 0.0 else "none",
        ])  # fmt: skip
    names += (
        []
        if powers is None
        else ["Reflected share of incident light" + RIGHT, "Error, share of incident light" + RIGHT]
    )
    worst = max(data.verdicts, key=lambda verdict: verdict.error)
    remedy = "" if worst.grade == "reliable" else f" Remedy: {worst.remedy}."
    causes = "".join(text for name, text in _CAUSES.items() if any(v.reason == name for v in data.verdicts))
    return (
        table_of([*names, "Largest cause"], rows)
        + paragraph(_GRADES + remedy)
        + paragraph(
            "The error is that of the efficiency of one order, and the reflected light that of a flat surface. In a "
            "test with rigorous solutions of Maxwell's equations, 19 of 20 gratings had at most twice the stated error."
            + causes
        )
    )  # fmt: skip


def orders_section(data: ReportData) -> str:
    """Return the HTML table of the strongest diffraction orders."""
    table = data.orders
    if table is None:
        return absent_text(data, "orders")
    light = f"The light is {light_text(data)}."
    if "part" in table.columns:
        parts = [
            (
                f"{nm:g} nm", part, f"{with_error(100.0 * efficiency, 100.0 * error)} %",
                "" if efficiency > error or not error else _NOT_DISTINGUISHABLE,
            )
            for nm, part, efficiency, error in table.rows
        ]  # fmt: skip
        names = ["Wavelength" + RIGHT, "Part", "Efficiency ± error of the theory" + RIGHT, ""]
        return table_of(names, parts) + paragraph(
            f"{light} Nothing repeats in this field, so that it has no orders of its own. The orders of a repeated "
            "scan depend on its size. The table has the power in the mirror direction, and all other reflected power."
        )
    is_period, is_plane = "order" in table.columns, _is_plane(data, table)
    kinds = [
        "Wavelength", *(["Period"] if is_period and len(np.unique(table["period_um"])) > 1 else []),
        "Order" if is_period or not np.any(table["m_y"]) else "Order (x, y)",
        "Angle θ ± standard error" if is_period else "Angle θ", *([] if is_plane else ["Azimuth φ"]),
        "Efficiency ± error of the theory",
    ]  # fmt: skip
    rows, left = _order_rows(table, is_plane=is_plane)
    text = f"{light} Efficiencies are shares of the incident light. They are those of scalar theory, with the "
    text += "reflectance of unpolarised light. Angles θ are from the normal"
    if is_plane:
        text += f", in the plane of the light, negative towards −{axis_of(data)}."
    else:
        text += ", and azimuths φ are from x towards y."
    if is_period:
        text += (
            " The error of an angle follows from the error of the period. An efficiency that is smaller than its error "
            "is not distinguishable from zero. The efficiency of an order is the sum over "
            "all directions nearer to it than half of the distance between two orders. It includes scattered light."
        )
    else:
        text += (
            " Nothing repeats in this field, so that it counts as exactly one period of a grating. Angles therefore "
            "have no error except that of the scale of the field."
        )
    if left:
        text += f" {left} weaker orders are in orders.csv."
    return table_of([*(kind + RIGHT for kind in kinds), ""], rows) + paragraph(text)


def _is_plane(data: ReportData, table: Table) -> bool:
    """Whether the directions of all orders are in the plane of the light and the normal."""
    offsets = np.radians(table["view_phi_deg"] - data.azimuth_deg)
    return bool(np.all(np.abs(np.sin(offsets) * np.sin(np.radians(table["view_theta_deg"]))) < _IN_PLANE))


def _order_rows(table: Table, *, is_plane: bool) -> tuple[list[list[str]], int]:
    """Return table rows of the strongest diffraction orders per wavelength, and the number of orders without a row."""
    columns = table.columns
    is_period = "order" in columns
    has_periods = is_period and len(np.unique(columns["period_um"])) > 1
    angles = columns["angle_deg" if is_plane else "view_theta_deg"]
    rows, left = [], 0
    for nm in np.unique(columns["wavelength_nm"]):
        own = np.flatnonzero(columns["wavelength_nm"] == nm)
        strongest = own[np.argsort(-columns["efficiency"][own], kind="stable")][:_MOST_ORDERS]
        left += len(own) - len(strongest)
        for k in np.sort(strongest).tolist():
            row = {name: column[k] for name, column in columns.items()}
            angle = f"{angles[k]:.3f}°"
            if is_period:
                error = row["standard_error_deg"]
                angle = f"{with_error(angles[k], error)}°" if error > 0.0 else f"{angles[k]:.1f}° (exact)"
            rows.append([
                f"{nm:g} nm", *([f"{row['period_um']:.4g} µm"] if has_periods else []), _order_name(row, columns),
                angle, *([] if is_plane else [f"{row['view_phi_deg']:.1f}°"]),
                f"{with_error(100.0 * row['efficiency'], 100.0 * row['model_error'])} %",
                "" if row["is_above_error"] or not row["model_error"] else _NOT_DISTINGUISHABLE,
            ])  # fmt: skip
    return [[cell.replace("-", "−") for cell in row] for row in rows], left


def _order_name(row: JsonObject, columns: JsonObject) -> str:
    """Return the number of a diffraction order as text, or both numbers if the field varies along x and y."""
    numbers = [row["order"]] if "order" in row else [row[name] for name in ("m_x", "m_y") if np.any(columns[name])]
    texts = [f"{int(number):+d}" if number else "0" for number in numbers]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})" if texts else "0"


def colours_section(data: ReportData) -> str:
    """Return the HTML text about the colours against the view angle; empty without colours."""
    if not data.colours:
        return ""
    tolerance = data.request.settings.get("tolerance", 0.01)
    repeated = [f"{sigma:g}" for sigma in data.colours if PATCH_IN_SIGMAS * sigma > max(data.patch_um) * (1.0 + 1e-9)]
    text = ""
    if repeated and not data.is_cell and not data.is_flat:
        text = (
            f" Windows with σ = {', '.join(repeated)} µm are wider than the field, so that the field is repeated. "
            "Fine stripes around the mirror direction are orders of this repetition."
        )
    return paragraph(
        "The coherence window is the part of the surface whose light interferes, a Gaussian of standard deviation σ. A "
        "larger window separates orders better, because its lobes are narrower. Daylight and artificial light have "
        "σ = 16.25 µm. By default, σ is at most a quarter of the size of a scan. The page “Coherence length” of "
        "warpdiff's documentation has other lights. View angles θ are positive "
        f"towards +{axis_of(data)}. The numerical error of XYZ is at most {100.0 * tolerance:g} % for 99 % of the "
        "directions. The error of scalar diffraction is stated above. Differences between parts of the surface are not "
        f"included.{text}"
    )


def map_section(numbers: JsonObject) -> str:
    """Return the HTML text about the error of the reflectance map; empty without a map."""
    if "map_error" not in numbers:
        return ""
    return paragraph(
        f"The numerical error of XYZ is at most {100.0 * numbers['map_error']:.2g} % for 99 % of the directions, "
        "without the error of scalar diffraction."
    )


def comparison_section(data: ReportData) -> str:
    """Return the HTML text about the comparison with a measured curve."""
    comparison = data.comparison
    if comparison is None:
        return absent_text(data, "comparison")
    measured = comparison.measured
    skipped = f", {measured.skipped} rows without a value were skipped" if measured.skipped else ""
    count = f"{len(measured.positions)} values{skipped}"
    facts = [
        (
            "Measurement",
            f"{text_of(measured.path.name)}, column {text_of(measured.name)}, {count}",
        ),
        ("Computed", text_of(comparison.what)),
        (
            "Factor of the computed values",
            f"{with_error(comparison.scale, comparison.scale_error)} (standard error of the fit)",
        ),
        ("Residual", f"{100.0 * comparison.residual:.2g} % of the largest measured value (root mean square)"),
        (
            "Correlation",
            f"{comparison.correlation:.3f}"
            if np.isfinite(comparison.correlation)
            else "not defined: a curve is constant",
        ),
    ]
    return facts_table(facts) + paragraph(
        "The factor is fitted, because the measured and the computed curve have different units. Residual and "
        "correlation describe these values alone and have no error."
        + ("" if measured.errors is not None else " The file states no errors of the measured values.")
    )
