"""HTML text of a report: sections with tables, pictures and the reasons of what is absent."""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.apps.report.html_parts import RIGHT, facts_table, listed, paragraph, table_of, text_of, wide
from warpdiff.core.angles import direction, signed_angles_deg
from warpdiff.heightfield.roughness import with_error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.apps.report.report_figures import Figure
    from warpdiff.core.table import Table
    from warpdiff.heightfield.roughness import RoughnessParameter

# Number of orders of each wavelength on the page, the strongest ones. Limit: a table of a page; the file has all.
_MOST_ORDERS = 15
# Number of entries of the metadata of a file on the page. Limit: some instruments write hundreds.
_MOST_METADATA = 30
# Length of a text from the metadata [characters]. Limit: some contain whole logs.
_MOST_TEXT = 200
# Prefix of the names of pictures in the reasons of absent results.
_PICTURE = "picture of "
# Azimuth of the y axis [degrees].
_Y_DEG = 90.0
# Component of a direction across the plane of the light below which it is in the plane: 0.06°.
_IN_PLANE = 1e-3
# Height below which lengths are in nanometres [µm], and nanometres per micrometre.
_LEAST_MICROMETRES, _NM_PER_UM = 1.0, 1e3
_GRADES = {
    "reliable": "use colours and numbers",
    "qualitative": "use the positions of colours, and not their brightness",
    "invalid": "use nothing but the angles of orders",
}
_ABSENT = {
    "roughness": "Roughness parameters were not found",
    "periods": "No period was found",
    "verdicts": "The theory was not judged",
    "orders": "Orders were not computed",
    "colours": "Colours were not computed",
    "map": "The map was not computed",
    "comparison": "The comparison was not possible",
}


def page_of(data: ReportData, numbers: dict[str, Any], figures: list[Figure], names: list[str]) -> str:
    """Return the text of the page.

    Args:
        data: Results.
        numbers: Numbers of the report, as in the JSON file.
        figures: Pictures.
        names: Names of the other files of the report.
    """
    pictures = {figure.name: _figure(number, figure) for number, figure in enumerate(figures, 1)}
    pictures |= {
        name.removeprefix(_PICTURE): f'<p class="absent"><b>The picture cannot be drawn:</b> {text_of(reason)}.</p>\n'
        for name, reason in data.reasons.items()
        if name.startswith(_PICTURE)
    }
    sections = [
        ("Surface", _surface(data, numbers) + pictures.get("surface", "")),
        ("Roughness (ISO 25178-2)", _roughness(data)),
        ("Periods", _periods(data) + pictures.get("periods", "")),
        ("Reliability of scalar diffraction", _theory(data)),
        ("Diffraction orders", _orders(data) + pictures.get("orders", "")),
        ("Colours against the view angle", _absent(data, "colours") + pictures.get("colours", "") + _colours(data)),
        ("Reflectance map", _absent(data, "map") + pictures.get("map", "") + _map(numbers)),
    ]
    if data.request.measured is not None:
        sections.append(("Comparison with a measurement", _comparison(data) + pictures.get("comparison", "")))
    sections += [("Methods", _methods(data)), ("Files", _files(names))]
    body = "".join(
        f"<section>\n<h2>{n} {title}</h2>\n{text}</section>\n" for n, (title, text) in enumerate(sections, 1)
    )
    folder = resources.files("warpdiff.apps.report").joinpath("page")
    filling = {
        "VERSION": text_of(numbers["warpdiff"]), "TITLE": text_of(numbers["title"]),
        "DATE": text_of(numbers["made"][:10]),
        "STYLE": folder.joinpath("report.css").read_text(encoding="utf-8"),
        "BODY": f'<section class="summary">\n{facts_table(_summary(data))}</section>\n{_warnings(data)}{body}',
    }  # fmt: skip
    # All placeholders are replaced in one pass, so that a text of the user that looks like one is kept.
    template = folder.joinpath("report.html").read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda match: filling[match[1]], template)


def summary_text(numbers: dict[str, Any], warnings: Sequence[str]) -> str:
    """Return the main results as lines of text."""
    lines = [numbers["title"]]
    lines += [
        f"{row['parameter']:<16}{_value(row['value'], row['standard_error'])} {row['unit']}"
        for row in numbers.get("roughness", ())
        if row["parameter"] in ("Sq", "Sal") and row["value"] is not None
    ]
    periods = numbers.get("periods")
    period = _value(periods[0]["period_um"], periods[0]["standard_error_um"]) + " µm" if periods else "none found"
    lines.append(f"{'period':<16}{period}")
    theory = [f"{row['grade']} at {row['wavelength_nm']:g} nm" for row in numbers.get("theory", ())]
    lines += [f"{'scalar theory':<16}{', '.join(theory)}"] if theory else []
    absent = {name: reason for name, reason in numbers["not_found"].items() if name != "periods"}
    lines += [f"{'not found':<16}{name}: {reason}" for name, reason in absent.items()]
    if warnings:
        lines.append(f"{'warnings':<16}{len(warnings)}, on the page")
    return "\n".join(lines)


def _value(value: float, error: float | None) -> str:
    return f"{value:.4g}" if error is None else with_error(value, error)


def _absent(data: ReportData, name: str) -> str:
    """Return the reason of a result that was not found; an empty text if it was."""
    if name not in data.reasons:
        return ""
    return f'<p class="absent"><b>{_ABSENT[name]}:</b> {text_of(data.reasons[name])}.</p>\n'


def _figure(number: int, figure: Figure) -> str:
    kind = "" if figure.is_wide else ' class="narrow"'
    return (
        f'<figure{kind}><img src="{figure.uri}" alt="{text_of(figure.alt)}">\n'
        f"<figcaption><b>Figure {number}.</b> {text_of(figure.caption)}</figcaption></figure>\n"
    )


def _grade(grade: str) -> str:
    return f'<span class="grade {grade}">{grade}</span>'


def _summary(data: ReportData) -> list[tuple[str, str]]:
    field = data.request.heightfield
    (ny, nx), (ly, lx), (dy, dx) = field.shape, field.size_um, field.pitch_um
    facts = [(
        "Field", f"{lx:.4g} × {ly:.4g} µm (x × y), {nx} × {ny} samples, pitch {1e3 * dx:.4g} × {1e3 * dy:.4g} nm",
    )]  # fmt: skip
    if data.roughness is not None:
        facts.append(
            ("Roughness", f"Sq {text_of(_shown(data.roughness['Sq']))}, Sal {text_of(_shown(data.roughness['Sal']))}")
        )
    facts.append(("Strongest period", text_of(data.periods[0]) if data.periods else "none"))
    if data.verdicts:
        worst = max(data.verdicts, key=lambda verdict: verdict.error)
        facts.append(("Scalar theory", f"{_grade(worst.grade)} {text_of(str(worst).partition(' ')[2])}"))
    facts.append(("Light", text_of(_light(data))))
    return facts


def _warnings(data: ReportData) -> str:
    if not data.warnings:
        return ""
    return f'<section class="absent">\n<h3>Warnings</h3>\n{listed(data.warnings)}</section>\n'


def _light(data: ReportData) -> str:
    return (
        f"{data.light_deg:.3g}° from the normal, in the plane at the azimuth {data.azimuth_deg:.1f}° from the x axis; "
        f"illuminant {data.request.illuminant}"
    )


def _axis(data: ReportData) -> str:
    """Return the axis that tells the sign of view angles."""
    return "x" if data.azimuth_deg < _Y_DEG else "y"


def _shown(parameter: RoughnessParameter) -> str:
    """Return value, error and unit of a parameter; heights are in nanometres."""
    if parameter.value is None:
        return "not determined"
    is_small = parameter.unit == "µm" and parameter.name in ("Sa", "Sq") and parameter.value < _LEAST_MICROMETRES
    factor, unit = (_NM_PER_UM, "nm") if is_small else (1.0, parameter.unit)
    error = None if parameter.standard_error is None else factor * parameter.standard_error
    return f"{_value(factor * parameter.value, error)} {unit}".rstrip()


def _surface(data: ReportData, numbers: dict[str, Any]) -> str:
    field = data.request.heightfield
    missing = int(np.count_nonzero(field.missing))
    share = 100.0 * missing / field.missing.size
    facts = [
        (
            "Height range",
            f"{1e3 * field.height_range_um:.4g} nm (no error: the range grows with the size of the field)",
        ),
        ("Missing samples", f"{missing} ({share:.2g} %), interpolated for optics" if missing else "none"),
    ]
    source = numbers["surface"]["source"]
    if source is None:
        facts.insert(0, ("Source", "an array of heights in µm"))
    else:
        place = "the top of the picture, the largest y" if source["rows"] == "up" else "y = 0"
        entries = list(source["metadata"].items())
        more = [("Metadata", f"{len(entries) - _MOST_METADATA} further entries are in report.json")]
        facts = [
            ("File", text_of(source["file"] or "a topography in memory")),
            ("Channel", text_of(source["channel"] or "the only one of the file")),
            ("Unit", "µm, converted from the unit of the file or as stated by the user"),
            ("Row 0 of the file", place), *facts,
            *((_clipped(name), text_of(_clipped(value))) for name, value in entries[:_MOST_METADATA]),
            *(more if len(entries) > _MOST_METADATA else []),
        ]  # fmt: skip
    history = "<h3>Cleaning</h3>\n" + (
        listed(field.history, "ol") if field.history else paragraph("The heights are unchanged.")
    )
    part = ""
    if data.is_cropped:
        part = paragraph(f"Periods are those of the middle of the field, {_extent(data.part.size_um)}.")
    if data.has_patch:
        part += paragraph(
            f"Reliability, orders and colours are those of the middle of the field, {_extent(data.patch_um)}, because "
            "the field is large."
        )
    return facts_table(facts) + history + part


def _extent(size_um: tuple[float, float]) -> str:
    return f"{size_um[1]:.4g} × {size_um[0]:.4g} µm (x × y)"


def _clipped(value: str) -> str:
    return value if len(value) <= _MOST_TEXT else f"{value[:_MOST_TEXT]}…"


def _roughness(data: ReportData) -> str:
    roughness = data.roughness
    if roughness is None:
        return _absent(data, "roughness")
    rows = [(p.name, p.meaning, _shown(p), p.reason) for p in roughness]
    notes = any(p.reason for p in roughness)
    table = table_of(
        ["Parameter", "Meaning", "Value ± standard error" + RIGHT, *([""] if notes else [])],
        rows if notes else [row[:3] for row in rows],
    )
    blocks = roughness.blocks[0] * roughness.blocks[1]
    levelled = "mean" if roughness.order == 0 else f"least-squares polynomial of degree {roughness.order}"
    text = f"Heights are relative to the {levelled}. No filter was applied."
    if blocks > 1:
        text += f" Standard errors are from {blocks} parts of the field (jackknife)."
    if roughness.lay_deg is not None:
        text += f" The autocorrelation decays slowest, along the lay, at {roughness.lay_deg:.0f}° from the x axis."
    return table + paragraph(text)


def _periods(data: ReportData) -> str:
    if not data.periods:
        return _absent(data, "periods")
    rows = []
    for k, period in enumerate(data.periods, 1):
        angle = round(period.direction_deg, 1) + 0.0
        rows.append((
            k, f"{with_error(period.period_um, period.standard_error_um)} µm", f"{angle:.1f}°".replace("-", "−"),
            f"{1e3 * period.harmonics_um[0]:.3g} nm", f"{100.0 * period.share:.3g} %",
            "constant phase" if period.is_coherent else "phase varies",
        ))  # fmt: skip
    numbers = ("No.", "Period ± standard error", "Direction", "Amplitude", "Share of variance")
    names = [*(name + RIGHT for name in numbers), "Wave"]
    return table_of(names, rows) + paragraph(
        "The direction is that of the wave vector, from x towards y. The error of a period includes its variation over "
        "the field. Directions, amplitudes and shares describe this field alone and have no error."
    )


def _theory(data: ReportData) -> str:
    if not data.verdicts:
        return _absent(data, "verdicts")
    rows = [
        f'<tr><td class="number">{verdict.wavelength_nm:g} nm</td><td>{_grade(verdict.grade)}</td>'
        f'<td class="number">{100.0 * min(verdict.error, 1.0):.2g} %</td><td>{text_of(_GRADES[verdict.grade])}</td>'
        f'<td class="note">{text_of(verdict.explanation if verdict.error > 0.0 else "none")}</td></tr>\n'
        for verdict in data.verdicts
    ]
    head = (
        '<tr><th class="number">Wavelength</th><th>Grade</th><th class="number">Expected error</th><th>Use</th>'
        "<th>Largest cause</th></tr>"
    )
    worst = max(data.verdicts, key=lambda verdict: verdict.error)
    remedy = "" if worst.grade == "reliable" else f" Remedy: {worst.remedy}."
    return wide(f"<thead>{head}</thead>\n<tbody>\n{''.join(rows)}</tbody>") + paragraph(
        "The expected error is that of the efficiency of an order, as a share of the power that a flat surface "
        f"reflects. Compared with rigorous solutions, 19 of 20 gratings had at most twice this error.{remedy}"
    )


def _orders(data: ReportData) -> str:
    table = data.orders
    if table is None:
        return _absent(data, "orders")
    light = f"The light is {_light(data)}."
    if "part" in table.columns:
        parts = [
            (f"{nm:g} nm", part, f"{with_error(100.0 * efficiency, 100.0 * error)} %")
            for nm, part, efficiency, error in table.rows
        ]
        names = ["Wavelength" + RIGHT, "Part", "Efficiency ± error of the theory" + RIGHT]
        return table_of(names, parts) + paragraph(
            f"{light} Nothing repeats in this field, so that it has no orders of its own. The orders of a repeated "
            "scan depend on its size. The table has the power in the mirror direction, and all other reflected power."
        )
    is_period, is_plane = "order" in table.columns, _is_plane(data, table)
    kinds = [
        "Wavelength", *(["Period"] if is_period else []),
        "Order" if is_period or not np.any(table["m_y"]) else "Order (x, y)",
        "Angle ± standard error" if is_period else "Angle", *([] if is_plane else ["Azimuth"]),
        "Efficiency ± error of the theory",
    ]  # fmt: skip
    rows, left = _order_rows(table, is_plane=is_plane)
    text = f"{light} Efficiencies are relative to the incident power. Angles are from the normal"
    if is_plane:
        text += f", in the plane of the light, negative towards −{_axis(data)}."
    else:
        text += ", and azimuths are from x towards y."
    if is_period:
        text += (
            " The error of an angle follows from that of the period. The efficiency of an order is the sum over all "
            "directions that are nearer to it than half of the distance of two orders; it includes scattered light."
        )
    else:
        text += (
            " Nothing repeats in this field, so that it counts as exactly one period of a grating. Angles therefore "
            "have no error but that of the scale of the field."
        )
    if left:
        text += f" {left} weaker orders are in orders.csv."
    return table_of([kind + RIGHT for kind in kinds], rows) + paragraph(text)


def _is_plane(data: ReportData, table: Table) -> bool:
    """Whether all orders are in the plane of the light."""
    offsets = np.radians(table["view_phi_deg"] - data.azimuth_deg)
    return bool(np.all(np.abs(np.sin(offsets) * np.sin(np.radians(table["view_theta_deg"]))) < _IN_PLANE))


def _order_rows(table: Table, *, is_plane: bool) -> tuple[list[list[str]], int]:
    """Return the rows of the strongest orders of each wavelength, and the number of the others."""
    columns = table.columns
    is_period = "order" in columns
    angles = columns["view_theta_deg"]
    if is_plane:
        angles = signed_angles_deg(direction(angles, columns["view_phi_deg"]))
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
                f"{nm:g} nm", *([f"{row['period_um']:.4g} µm"] if is_period else []), _order_name(row, columns),
                angle, *([] if is_plane else [f"{row['view_phi_deg']:.1f}°"]),
                f"{with_error(100.0 * row['efficiency'], 100.0 * row['model_error'])} %",
            ])  # fmt: skip
    return [[cell.replace("-", "−") for cell in row] for row in rows], left


def _order_name(row: dict[str, Any], columns: dict[str, Any]) -> str:
    """Return the number of an order, or both numbers of a field with two axes."""
    numbers = [row["order"]] if "order" in row else [row[name] for name in ("m_x", "m_y") if np.any(columns[name])]
    texts = [f"{int(number):+d}" if number else "0" for number in numbers]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})" if texts else "0"


def _colours(data: ReportData) -> str:
    if not data.colours:
        return ""
    tolerance = data.request.settings.get("tolerance", 0.01)
    repeated = [f"{sigma:g}" for sigma in data.colours if 4.0 * sigma > max(data.patch_um)]
    text = ""
    if repeated and not data.is_cell and not data.is_flat:
        text = (
            f" Windows with σ = {', '.join(repeated)} µm are wider than the field, which is repeated there: fine "
            "stripes around the mirror direction are orders of this repetition."
        )
    return paragraph(
        "A larger window resolves orders better: its lobes are narrower. View angles are positive towards "
        f"+{_axis(data)}. The numerical error of XYZ is at most {100.0 * tolerance:g} % for 99 % of the directions. "
        f"The error of the theory is stated above. Differences between parts of the surface are not included.{text}"
    )


def _map(numbers: dict[str, Any]) -> str:
    if "map_error" not in numbers:
        return ""
    return paragraph(
        f"The numerical error of XYZ is at most {100.0 * numbers['map_error']:.2g} % for 99 % of the directions, "
        "without the error of the theory."
    )


def _comparison(data: ReportData) -> str:
    comparison = data.comparison
    if comparison is None:
        return _absent(data, "comparison")
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
        "The factor is fitted, because the units of both curves differ. Residual and correlation describe these values "
        "alone and have no error."
        + ("" if measured.errors is not None else " The file states no errors of the measured values.")
    )


def _methods(data: ReportData) -> str:
    return listed([
        "Sa, Sq, Sdq, Sdr, Sal and Str follow ISO 25178-2. Sdq is from differences of neighbouring samples.",
        "Sdr is the mean of both triangulations of each cell of four samples.",
        "Sal and Str are from the autocorrelation of the measured samples, with the threshold 0.2.",
        "Standard errors are those of another field of the same surface, without the calibration of the instrument.",
        "Sizes and pitches are those of the file or of the user, without an error.",
        "Periods are lines of the power spectrum that noise reaches with a probability below 0.5 %.",
        "Reflectances are those of scalar diffraction by the heights as a phase grating (Stam 1999).",
        "A Fresnel factor and, for colours, V-cavity masking are included.",
        "Polarisation and multiple scattering are not included.",
        f"Colours are CIE XYZ under {data.request.illuminant}, shown in sRGB by the display transform ACES 2.0.",
    ])  # fmt: skip


def _files(names: Sequence[str]) -> str:
    return paragraph(
        "The numbers of this page, with all digits, are in these files in the same folder: "
        f"{', '.join(names)}. Lengths are in µm, wavelengths in nm, angles in degrees, and efficiencies are ratios."
    )
