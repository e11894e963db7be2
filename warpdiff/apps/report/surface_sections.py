"""Sections of a report about the surface itself: its file and cleaning, roughness, and periods."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.apps.report.html_parts import RIGHT, facts_table, listed, paragraph, table_of, text_of
from warpdiff.apps.report.result_texts import absent_text, parameter_text
from warpdiff.heightfield.roughness import with_error

if TYPE_CHECKING:
    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.apps.report.report_numbers import JsonObject

# Largest number of entries that the page lists from the metadata of a scan. It was chosen because some instruments
# write hundreds of entries.
_MOST_METADATA = 30
# Largest length of an entry of the metadata on the page [characters]; longer entries are cut. The length is limited
# because some entries contain whole logs.
_MOST_TEXT = 200


def surface_section(data: ReportData, numbers: JsonObject) -> str:
    """Return the HTML text about the file, its metadata, the settings and the cleaning."""
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
    """Return a text that lists the lengths and units that the user stated for a scan, or that its file states them."""
    names = [f"{name} = {value}" for name, value in arguments.items() if name not in ("channel", "rows")]
    return f"stated by the user: {', '.join(names)}" if names else "from the file"


def _extent(size_um: tuple[float, float]) -> str:
    return f"{size_um[1]:.4g} × {size_um[0]:.4g} µm (x × y)"


def _clipped(value: str) -> str:
    return value if len(value) <= _MOST_TEXT else f"{value[:_MOST_TEXT]}…"


def roughness_section(data: ReportData) -> str:
    """Return the HTML table of roughness parameters."""
    roughness = data.roughness
    if roughness is None:
        return absent_text(data, "roughness")
    table = table_of(
        ["Parameter", "Meaning", "Value ± standard error" + RIGHT, ""],
        [(p.name, p.meaning, parameter_text(p), p.reason) for p in roughness],
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


def periods_section(data: ReportData) -> str:
    """Return the HTML table of periods."""
    if not data.periods:
        return absent_text(data, "periods")
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
