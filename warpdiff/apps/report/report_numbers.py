"""Numbers of a report: dictionaries for the JSON file, and tables for the CSV files."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import math
from importlib import metadata
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.apps.report.report_data import ANGLES_DEG
from warpdiff.core.table import Table
from warpdiff.optics.materials import DEFAULT_IOR
from warpdiff.request.settings import EvaluationSettings

if TYPE_CHECKING:
    from warpdiff.apps.report.report_data import ReportData


# Object of JSON: its values are numbers, texts, lists and objects.
JsonObject = dict[str, Any]


def numbers_of(data: ReportData, title: str) -> JsonObject:
    """Return the content of the JSON file of a report; a number that does not exist is None."""
    request = data.request
    field = request.heightfield
    result: JsonObject = {
        "title": title,
        "warpdiff": metadata.version("warpdiff"),
        "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "surface": {
            "shape": list(field.shape), "size_um": list(field.size_um), "pitch_um": list(field.pitch_um),
            "height_range_um": field.height_range_um, "missing": int(np.count_nonzero(field.missing)),
            "source": _source(data),
        },
        "history": list(field.history),
        "periods_part_um": list(data.part.size_um), "optics_part_um": list(data.patch_um),
        "light": {
            "to_light": data.to_light.tolist(), "angle_deg": data.light_deg, "azimuth_deg": data.azimuth_deg,
            "illuminant": str(request.illuminant),
        },
        "settings": _settings(data),
        **{name: _rows(table) for name, table in tables_of(data).items() if name != "colours"},
    }  # fmt: skip
    if data.roughness is not None:
        result["roughness_order"] = data.roughness.order
        result["lay_deg"] = data.roughness.lay_deg
    if data.map is not None and data.map.report is not None:
        result["map_error"] = float(np.quantile(data.map.error[data.map.mask], 0.99))
    if data.comparison is not None:
        comparison = data.comparison
        result["fit"] = {
            "file": comparison.measured.path.name, "column": comparison.measured.name, "computed": comparison.what,
            "scale": comparison.scale, "scale_standard_error": comparison.scale_error,
            "residual": comparison.residual, "correlation": _number(comparison.correlation),
            "rows_without_value": comparison.measured.skipped,
        }  # fmt: skip
    return {**result, "not_found": dict(data.reasons), "warnings": list(data.warnings)}


def _source(data: ReportData) -> JsonObject | None:
    """Return the file, channel, orientation and metadata of a height field; None for a field from an array."""
    source = data.request.heightfield.source
    if source is None:
        return None
    return {
        "file": PurePath(source.path).name, "sha256": _sha256(Path(source.path)), "channel": source.channel,
        "rows": source.rows, "stated_by_user": dict(source.stated), "clipped_share": source.clipped,
        "metadata": {str(name): str(value) for name, value in source.metadata.items()},
    }  # fmt: skip


def _sha256(file: Path) -> str | None:
    """Return the SHA-256 of a file; None if it cannot be read."""
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


def _settings(data: ReportData) -> JsonObject:
    """Return the arguments of the report, and all settings of its optical computations including defaults, by name."""
    request = data.request
    settings = EvaluationSettings(**request.settings)
    values = {option.name: getattr(settings, option.name) for option in dataclasses.fields(settings)}
    if values["ior"] is None and values["material"] is None:
        values["ior"] = DEFAULT_IOR
    values["coherence"] = settings.effective_coherence
    return {
        "wavelengths_nm": request.wavelengths_nm.tolist(), "sigmas_um": list(request.sigmas_um),
        "illuminant": str(request.illuminant),
        **{name: _plain(value) for name, value in values.items()},
    }  # fmt: skip


def tables_of(data: ReportData) -> dict[str, Table]:
    """Return the tables of all results, by the names of their CSV files without ``.csv``."""
    tables: dict[str, Table] = {}
    if data.roughness is not None:
        tables["roughness"] = data.roughness.table()
    if data.periods:
        tables["periods"] = data.periods.table()
    if data.verdicts:
        errors = np.array([verdict.error for verdict in data.verdicts])
        unknown = np.full(len(errors), np.nan)
        tables["theory"] = Table({
            "wavelength_nm": [verdict.wavelength_nm for verdict in data.verdicts],
            "expected_error": errors,
            "flat_surface_efficiency": unknown if data.flat_powers is None else data.flat_powers,
            "efficiency_error": unknown if data.efficiency_errors is None else data.efficiency_errors,
            "grade": [verdict.grade for verdict in data.verdicts],
            "reason": [verdict.reason for verdict in data.verdicts],
        })  # fmt: skip
    if data.orders is not None:
        tables["orders"] = data.orders
    if data.colours:
        count = len(data.colours)
        xyz = np.concatenate(list(data.colours.values()))
        tables["colours"] = Table({
            "sigma_um": np.repeat(list(data.colours), len(ANGLES_DEG)), "angle_deg": np.tile(ANGLES_DEG, count),
            "X": xyz[:, 0], "Y": xyz[:, 1], "Z": xyz[:, 2],
        })  # fmt: skip
    if data.comparison is not None:
        comparison = data.comparison
        measured = comparison.measured
        columns = {
            measured.against: measured.positions, "measured": measured.values, "computed": comparison.computed,
            "computed_scaled": comparison.scale * comparison.computed,
        }  # fmt: skip
        if measured.errors is not None:
            columns["measured_error"] = measured.errors
        tables["comparison"] = Table(columns)
    return tables


def _rows(table: Table) -> list[JsonObject]:
    """Return the rows of a table as dictionaries."""
    names = list(table.columns)
    return [{name: _number(value) for name, value in zip(names, row, strict=True)} for row in table.rows]


def _plain(value: Any) -> Any:
    """Return a setting as a value of JSON, or as text if JSON has no such value."""
    is_plain = value is None or isinstance(value, (bool, int, str)) or (isinstance(value, float) and value < math.inf)
    return value if is_plain else str(value)


def _number(value: Any) -> Any:
    """Return a value, or None for a number that is not finite, because JSON has no such numbers."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
