"""HTML text of a report: its page of sections and pictures, and the summary in plain text."""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING

from warpdiff.apps.report import optics_sections, surface_sections
from warpdiff.apps.report.html_parts import facts_table, listed, paragraph, text_of
from warpdiff.apps.report.result_texts import absent_text, grade_text, light_text, parameter_text, value_text
from warpdiff.heightfield.roughness import has_large_error

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.apps.report.report_figures import Figure
    from warpdiff.apps.report.report_numbers import JsonObject
    from warpdiff.heightfield.roughness import RoughnessParameter

# Prefix that distinguishes absent pictures from absent results in the names of `ReportData.reasons`.
_PICTURE = "picture of "


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
        ("Surface", surface_sections.surface_section(data, numbers) + pictures.get("surface", "")),
        ("Roughness (ISO 25178-2)", surface_sections.roughness_section(data)),
        ("Periods", surface_sections.periods_section(data) + pictures.get("periods", "")),
        ("Reliability of scalar diffraction", optics_sections.theory_section(data)),
        ("Diffraction orders", optics_sections.orders_section(data) + pictures.get("orders", "")),
        (
            "Colours against the view angle",
            absent_text(data, "colours") + pictures.get("colours", "") + optics_sections.colours_section(data),
        ),
        ("Reflectance map", absent_text(data, "map") + pictures.get("map", "") + optics_sections.map_section(numbers)),
    ]
    if data.request.measured is not None:
        sections.append(
            ("Comparison with a measurement", optics_sections.comparison_section(data) + pictures.get("comparison", ""))
        )
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
    # therefore not replaced.
    template = folder.joinpath("report.html").read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda match: filling[match[1]], template)


def summary_text(numbers: JsonObject, warnings: Sequence[str]) -> str:
    """Return the main results of a report as lines of plain text."""
    lines = [numbers["title"]]
    lines += [
        f"{row['parameter']:<16}{value_text(row['value'], row['standard_error'])} {row['unit']}"
        for row in numbers.get("roughness", ())
        if row["parameter"] in ("Sq", "Sal")
        and row["value"] is not None
        and not has_large_error(row["value"], row["standard_error"])
    ]
    periods = numbers.get("periods")
    period = value_text(periods[0]["period_um"], periods[0]["standard_error_um"]) + " µm" if periods else "none found"
    lines.append(f"{'period':<16}{period}")
    theory = [f"{row['grade']} at {row['wavelength_nm']:g} nm" for row in numbers.get("theory", ())]
    lines += [f"{'scalar theory':<16}{', '.join(theory)}"] if theory else []
    absent = {name: reason for name, reason in numbers["not_found"].items() if name != "periods"}
    lines += [f"{'not found':<16}{name}: {reason}" for name, reason in absent.items()]
    if warnings:
        lines.append(f"{'warnings':<16}{len(warnings)}, on the page")
    return "\n".join(lines)


def _figure(number: int, figure: Figure) -> str:
    kind = ' class="pair"' if len(figure.uris) > 1 else ""
    images = "".join(f'<img src="{uri}" alt="{text_of(figure.alt)}">' for uri in figure.uris)
    return (
        f"<figure{kind}><div>{images}</div>\n"
        f"<figcaption><b>Figure {number}.</b> {text_of(figure.caption)}</figcaption></figure>\n"
    )


def _summary(data: ReportData, numbers: JsonObject) -> list[tuple[str, str]]:
    field = data.request.heightfield
    (ny, nx), (ly, lx), (dy, dx) = field.shape, field.size_um, field.pitch_um
    facts = [(
        "Field", f"{lx:.4g} × {ly:.4g} µm (x × y), {nx} × {ny} samples, pitch {1e3 * dx:.4g} × {1e3 * dy:.4g} nm",
    )]  # fmt: skip
    if data.roughness is not None:
        shown = [
            f"{p.name} {parameter_text(p)}"
            for p in data.roughness
            if p.name in ("Sq", "Sal") and not _has_large_error(p)
        ]
        facts.append(("Roughness", text_of(", ".join(shown))))
    facts.append(("Strongest period", text_of(data.periods[0]) if data.periods else "none"))
    if data.verdicts:
        worst = max(data.verdicts, key=lambda verdict: verdict.error)
        of_incident = ""
        if data.efficiency_errors is not None:
            error = data.efficiency_errors[data.verdicts.index(worst)]
            of_incident = f" ({100.0 * error:.2g} % of the incident light)"
        facts.append(
            ("Scalar theory", f"{grade_text(worst.grade)} {text_of(str(worst).partition(' ')[2] + of_incident)}")
        )
    facts += [("Material", text_of(_material(numbers))), ("Light", text_of(light_text(data)))]
    return facts


def _warnings(data: ReportData) -> str:
    if not data.warnings:
        return ""
    return f'<section class="absent">\n<h3>Warnings</h3>\n{listed(data.warnings)}</section>\n'


def _material(numbers: JsonObject) -> str:
    settings = numbers["settings"]
    if settings["material"] is not None:
        return f"{settings['material']}, unpolarised light"
    return f"index of refraction {settings['ior']}, unpolarised light"


def _has_large_error(parameter: RoughnessParameter) -> bool:
    """Whether the standard error of a roughness parameter exceeds half of its value, or the parameter has no value."""
    return parameter.value is None or has_large_error(parameter.value, parameter.standard_error)


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
