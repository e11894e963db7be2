"""HTML text of a report: sections with tables and pictures, or with the reason why a result is absent."""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.apps.report.html_parts import RIGHT, Html, facts_table, listed, paragraph, table_of, text_of
from warpdiff.heightfield.roughness import has_large_error, with_error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.apps.report.report_figures import Figure
    from warpdiff.apps.report.report_numbers import JsonObject
    from warpdiff.core.table import Table
    from warpdiff.heightfield.roughness import RoughnessParameter

# Largest number of orders that the page lists for each wavelength, the strongest ones. It was chosen so that the table
# fits on a page; the CSV file has all orders.
_MOST_ORDERS = 15
# Largest number of entries that the page lists from the metadata of a scan. It was chosen because some instruments
# write hundreds of entries.
_MOST_METADATA = 30
# Largest length of an entry of the metadata on the page [characters]; longer entries are cut. The length is limited
# because some entries contain whole logs.
_MOST_TEXT = 200
# Prefix that distinguishes absent pictures from absent results in the names of `ReportData.reasons`.
_PICTURE = "picture of "
# Note at an efficiency that is smaller than its error.
_NOT_DISTINGUISHABLE = "not distinguishable from zero"
# Azimuth of the y axis [degrees].
_Y_DEG = 90.0
# The direction of a diffraction order counts as in the plane of the light and the normal if the end of its unit vector
# is at most this far from the plane. The number is the sine of 0.06°.
_IN_PLANE = 1e-3
# Height [µm] below which the page states heights in nanometres, and number of nanometres per micrometre.
_LEAST_MICROMETRES, _NM_PER_UM = 1.0, 1e3
_GRADES = (
    "Reliable: use colours, and efficiencies that exceed their error. Qualitative: use the positions of colours, and "
    "not their brightness. Invalid: use nothing but the angles of orders."
)
# Sentences that explain why scalar diffraction has an error, by the reason in the verdict.
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
_ABSENT = {
    "roughness": "Roughness parameters were not found",
    "periods": "No period was found",
    "verdicts": "The theory was not judged",
    "orders": "Orders were not computed",
    "colours": "Colours were not computed",
    "map": "The map was not computed",
    "comparison": "The comparison was not possible",
}


def page_of(data: ReportData, numbers: JsonObject, figures: list[Figure], names: list[str]) -> str:
    """Return the HTML text of the page.

    Args:
        data: Results of the report.
        numbers: Numbers of the report, as in the JSON file.
        figures: Pictures of the results.
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
        "BODY": f'<section class="summary">\n{facts_table(_summary(data, numbers))}</section>\n{_warnings(data)}{body}',
    }  # fmt: skip
    # All placeholders of the template are replaced in one pass. A text of the user that looks like a placeholder is
    # therefore kept.
    template = folder.joinpath("report.html").read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda match: filling[match[1]], template)


def summary_text(numbers: JsonObject, warnings: Sequence[str]) -> str:
    """Return the main results of a report as lines of plain text."""
    lines = [numbers["title"]]
    lines += [
        f"{row['parameter']:<16}{_value(row['value'], row['standard_error'])} {row['unit']}"
        for row in numbers.get("roughness", ())
        if row["parameter"] in ("Sq", "Sal")
        and row["value"] is not None
        and not has_large_error(row["value"], row["standard_error"])
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
    """Return an HTML paragraph with the reason why a result is absent; an empty text if the result exists."""
    if name not in data.reasons:
        return ""
    return f'<p class="absent"><b>{_ABSENT[name]}:</b> {text_of(data.reasons[name])}.</p>\n'


def _figure(number: int, figure: Figure) -> str:
    kind = ' class="pair"' if len(figure.uris) > 1 else ""
    images = "".join(f'<img src="{uri}" alt="{text_of(figure.alt)}">' for uri in figure.uris)
    return (
        f"<figure{kind}><div>{images}</div>\n"
        f"<figcaption><b>Figure {number}.</b> {text_of(figure.caption)}</figcaption></figure>\n"
    )


def _grade(grade: str) -> str:
    return f'<span class="grade {grade}">{grade}</span>'


def _summary(data: ReportData, numbers: JsonObject) -> list[tuple[str, str]]:
    field = data.request.heightfield
    (ny, nx), (ly, lx), (dy, dx) = field.shape, field.size_um, field.pitch_um
    facts = [(
        "Field", f"{lx:.4g} × {ly:.4g} µm (x × y), {nx} × {ny} samples, pitch {1e3 * dx:.4g} × {1e3 * dy:.4g} nm",
    )]  # fmt: skip
    if data.roughness is not None:
        shown = [f"{p.name} {_shown(p)}" for p in data.roughness if p.name in ("Sq", "Sal") and not _has_large_error(p)]
        facts.append(("Roughness", text_of(", ".join(shown))))
    facts.append(("Strongest period", text_of(data.periods[0]) if data.periods else "none"))
    if data.verdicts:
        worst = max(data.verdicts, key=lambda verdict: verdict.error)
        of_incident = ""
        if data.efficiency_errors is not None:
            error = data.efficiency_errors[data.verdicts.index(worst)]
            of_incident = f" ({100.0 * error:.2g} % of the incident light)"
        facts.append(("Scalar theory", f"{_grade(worst.grade)} {text_of(str(worst).partition(' ')[2] + of_incident)}"))
    facts += [("Material", text_of(_material(numbers))), ("Light", text_of(_light(data)))]
    return facts


def _warnings(data: ReportData) -> str:
    if not data.warnings:
        return ""
    return f'<section class="absent">\n<h3>Warnings</h3>\n{listed(data.warnings)}</section>\n'


def _light(data: ReportData) -> str:
    axis = _axis(data)
    side = f" on the side of {'+' if data.light_deg > 0.0 else '−'}{axis}" if data.light_deg else ""
    return (
        f"θ = {abs(data.light_deg):.3g}° from the normal{side}, in the plane at the azimuth "
        f"φ = {data.azimuth_deg:.1f}° from x towards y; illuminant {data.request.illuminant}"
    )


def _material(numbers: JsonObject) -> str:
    settings = numbers["settings"]
    if settings["material"] is not None:
        return f"{settings['material']}, unpolarised light"
    return f"index of refraction {settings['ior']}, unpolarised light"


def _has_large_error(parameter: RoughnessParameter) -> bool:
    """Whether the standard error of a parameter exceeds half of its value, or the parameter has no value."""
    return parameter.value is None or has_large_error(parameter.value, parameter.standard_error)


def _axis(data: ReportData) -> str:
    """Return the name of the axis towards which view angles are positive."""
    return "x" if data.azimuth_deg < _Y_DEG else "y"


def _shown(parameter: RoughnessParameter) -> str:
    """Return value, error and unit of a roughness parameter as text; heights below 1 µm are in nanometres."""
    if parameter.value is None:
        return "not determined"
    is_small = parameter.unit == "µm" and parameter.name in ("Sa", "Sq") and parameter.value < _LEAST_MICROMETRES
    factor, unit = (_NM_PER_UM, "nm") if is_small else (1.0, parameter.unit)
    error = None if parameter.standard_error is None else factor * parameter.standard_error
    return f"{_value(factor * parameter.value, error)} {unit}".rstrip()


def _surface(data: ReportData, numbers: JsonObject) -> str:
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
            *([("SHA-256", source["sha256"])] if source["sha256"] else []),
            ("Channel", text_of(source["channel"] or "the only one of the file")),
            ("Size and unit", text_of(_stated(source["stated_by_user"]))),
            ("Row 0 of the file", place), *facts,
            *((_clipped(name), text_of(_clipped(value))) for name, value in entries[:_MOST_METADATA]),
            *(more if len(entries) > _MOST_METADATA else []),
        ]  # fmt: skip
    settings = ", ".join(f"{name} = {value}" for name, value in numbers["settings"].items() if value is not None)
    facts.append(("Settings", text_of(settings)))
    plane = "the mean" if data.is_cell else "a fitted plane"
    history = "<h3>Cleaning</h3>\n" + (
        listed(field.history, "ol")
        if field.history
        else paragraph("The heights were not cleaned. Tilt, dust, scan-line steps and noise count as relief.")
    )
    history += paragraph(
        f"Roughness and power spectrum are of the heights minus {plane}. Diffraction is of the heights unchanged."
    )
    part = ""
    if data.is_cropped:
        part = paragraph(f"Periods are computed from the middle of the field, {_extent(data.part.size_um)}.")
    if data.has_patch:
        part += paragraph(
            f"Reliability, orders and colours are computed from the middle of the field, {_extent(data.patch_um)}, "
            "because the field is large."
        )
    return facts_table(facts) + history + part


def _stated(arguments: dict[str, str]) -> str:
    """Return a text that lists the sizes and units that the user has stated, or says that the file states them."""
    names = [f"{name} = {value}" for name, value in arguments.items() if name not in ("channel", "rows")]
    return f"stated by the user: {', '.join(names)}" if names else "from the file"


def _extent(size_um: tuple[float, float]) -> str:
    return f"{size_um[1]:.4g} × {size_um[0]:.4g} µm (x × y)"


def _clipped(value: str) -> str:
    return value if len(value) <= _MOST_TEXT else f"{value[:_MOST_TEXT]}…"


def _roughness(data: ReportData) -> str:
    roughness = data.roughness
    if roughness is None:
        return _absent(data, "roughness")
    table = table_of(
        ["Parameter", "Meaning", "Value ± standard error" + RIGHT, ""],
        [(p.name, p.meaning, _shown(p), p.reason) for p in roughness],
    )
    blocks = roughness.blocks[0] * roughness.blocks[1]
    levelled = "mean" if roughness.order == 0 else f"least-squares polynomial of degree {roughness.order}"
    text = f"Heights are relative to the {levelled}. No filter was applied."
    if blocks > 1:
        text += f" Standard errors are from {blocks} parts of the field (jackknife)."
    if roughness.lay_deg is not None:
        text += (
            " The lay is the direction of grooves or scratches, along which the autocorrelation decays slowest: "
            f"{roughness.lay_deg:.0f}° from the x axis. It describes this field alone and has no error."
        )
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
            "constant" if period.is_coherent else "varies",
            "" if period.is_resolved else "fewer than 3 samples per period: may be an artefact of sampling",
        ))  # fmt: skip
    numbers = ("No.", "Period ± standard error", "Direction", "Amplitude", "Share of variance")
    names = [*(name + RIGHT for name in numbers), "Phase", ""]
    return table_of(names, rows) + paragraph(
        "The period is the mean over the field. Its error is that of the mean of the whole surface, not the spread of "
        "single ridges. The direction is that of the wave vector, from x towards y. The amplitude is that of the "
        "fundamental sine. If the phase varies, the distance of neighbouring ridges varies over the field, and the "
        "amplitude is that of a sine with the variance of the wave. The rest of the variance is roughness, waviness "
        "and features that do not repeat. Directions, amplitudes and shares describe this field alone and have no "
        "error."
    )


def _theory(data: ReportData) -> str:
    if not data.verdicts:
        return _absent(data, "verdicts")
    powers, errors = data.flat_powers, data.efficiency_errors
    rows, names = [], ["Wavelength" + RIGHT, "Grade", "Error, share of reflected light" + RIGHT]
    for k, verdict in enumerate(data.verdicts):
        of_incident: list[str] = []
        if powers is not None and errors is not None:
            of_incident = [f"{100.0 * powers[k]:.2g} %", f"{100.0 * errors[k]:.2g} %"]
        rows.append([
            f"{verdict.wavelength_nm:g} nm", Html(_grade(verdict.grade)), f"{100.0 * min(verdict.error, 1.0):.2g} %",
            *of_incident,
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


def _orders(data: ReportData) -> str:
    table = data.orders
    if table is None:
        return _absent(data, "orders")
    light = f"The light is {_light(data)}."
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
        text += f", in the plane of the light, negative towards −{_axis(data)}."
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
    """Return the lines of the table for the strongest orders of each wavelength, and the number of the other orders."""
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


def _colours(data: ReportData) -> str:
    if not data.colours:
        return ""
    tolerance = data.request.settings.get("tolerance", 0.01)
    repeated = [f"{sigma:g}" for sigma in data.colours if 4.0 * sigma > max(data.patch_um)]
    text = ""
    if repeated and not data.is_cell and not data.is_flat:
        text = (
            f" Windows with σ = {', '.join(repeated)} µm are wider than the field, so that the field is repeated. "
            "Fine stripes around the mirror direction are orders of this repetition."
        )
    return paragraph(
        "The coherence window is the part of the surface whose light interferes, a Gaussian of standard deviation σ. A "
        "larger window separates orders better, because its lobes are narrower. For daylight and artificial light use "
        "σ = 16.25 µm. The page “Coherence length” of warpdiff's documentation has other lights. View angles θ are "
        "positive "
        f"towards +{_axis(data)}. The numerical error of XYZ is at most {100.0 * tolerance:g} % for 99 % of the "
        "directions. The error of scalar diffraction is stated above. Differences between parts of the surface are not "
        f"included.{text}"
    )


def _map(numbers: JsonObject) -> str:
    if "map_error" not in numbers:
        return ""
    return paragraph(
        f"The numerical error of XYZ is at most {100.0 * numbers['map_error']:.2g} % for 99 % of the directions, "
        "without the error of scalar diffraction."
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
        "The factor is fitted, because the measured and the computed curve have different units. Residual and "
        "correlation describe these values alone and have no error."
        + ("" if measured.errors is not None else " The file states no errors of the measured values.")
    )


def _methods(data: ReportData) -> str:
    settings = data.request.settings
    mirror = "a flat surface" if settings.get("material") is None else "a perfect mirror"
    masking = ["Colours include V-cavity masking: ridges hide relief from light and viewer (Cook and Torrance 1982)."]
    if not settings.get("masking", True):
        masking = ["Colours do not include masking, the effect that ridges hide relief from light and viewer."]
    return listed([
        "Sa, Sq, Sdq, Sdr, Sal and Str follow ISO 25178-2:2021. Sdq is from differences of neighbouring samples.",
        "Sdr is the mean of both triangulations of each cell of four samples.",
        "Sal and Str are from the autocorrelation of the measured samples, with the threshold 0.2.",
        "Standard errors describe the variation between fields of the surface, not the calibration of the instrument.",
        "Sizes and pitches are from the file or from the user, and have no error.",
        "Periods are maxima of the power spectrum that noise alone would reach with a probability below 0.5 %.",
        "Reflectances are computed by scalar diffraction from the heights as a phase grating (Stam 1999).",
        "The Fresnel factor is that of unpolarised light. Other polarisation and multiple scattering are not included.",
        *masking,
        f"Colours are CIE XYZ under {data.request.illuminant}. At normal incidence, {mirror} has Y = 1.",
        "They are shown in sRGB by the display transform ACES 2.0 (Academy of Motion Picture Arts and Sciences 2024).",
    ])  # fmt: skip


def _files(names: Sequence[str]) -> str:
    return paragraph(
        "The numbers of this page, with all digits, are in these files in the same folder: "
        f"{', '.join(names)}. Lengths are in µm, wavelengths in nm, angles in degrees, and efficiencies are ratios."
    )
