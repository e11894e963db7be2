"""Measured spectra and goniometer curves in text files, which a report compares with computed curves."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from warpdiff.core import files, validation
from warpdiff.core.text_encodings import decoded
from warpdiff.core.wording import ArgumentValueError, ref, renaming
from warpdiff.heightfield.readers import text_table
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import NDArray

    from warpdiff.heightfield.readers.text_table import Block, Form

Against = Literal["wavelength_nm", "angle_deg"]
_AXES: tuple[Against, Against] = ("wavelength_nm", "angle_deg")
# Largest size of the text file of a curve [bytes], about a million rows. If doubled, a wrong file is read for longer
# before it is refused.
_MOST_BYTES = 64 << 20
# Least number of measured values in a curve. The correlation of only two values with any computed curve would be 1 or
# −1, and therefore meaningless.
_LEAST_ROWS = 3
# Upper limit of the view angles from the normal [degrees]. At 90° the view direction is at the horizon.
_MOST_DEG = 90.0
# Words that mark a column as errors of the measured values, anywhere in the name of the column.
_ERROR = re.compile(r"error|uncertainty|std|sigma|deviation")
_REMEDY = "name the columns in the first line, for example wavelength_nm,reflectance or angle_deg,power"


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Measured values over the wavelength or over the view angle.

    Attributes:
        path: Path of the text file.
        name: Name of the column that contains the measured values.
        against: Name of the column that contains the positions, ``wavelength_nm`` or ``angle_deg``.
        positions: Wavelengths [nm] or view angles from the normal [degrees], increasing, shape (n,).
        values: Measured values in the unit of the file, shape (n,).
        errors: Errors of the measured values, shape (n,); None if the file has none.
        wavelength_nm: Wavelength of a goniometer curve [nm]; None if the file does not state it.
        view_deg: View angle of a spectrum [degrees]; None if the file does not state it.
        skipped: Number of lines that were skipped because a number is missing.
    """

    path: Path
    name: str
    against: Against
    positions: NDArray[np.float64]
    values: NDArray[np.float64]
    errors: NDArray[np.float64] | None
    wavelength_nm: float | None
    view_deg: float | None
    skipped: int


def read_curve(path: str | os.PathLike[str]) -> MeasuredCurve:
    """Read a measured curve from a text file with named columns.

    The separator of the columns and the decimal sign are recognised. Case, blanks and brackets in the names of columns
    do not matter: ``Wavelength (nm)`` is read as ``wavelength_nm``.

    Args:
        path: Text file with a column ``wavelength_nm`` or ``angle_deg``, one column of measured values, and optionally
            one column of the errors of these values, with ``error``, ``std`` or ``uncertainty`` in its name.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: A required column is missing, or fewer than three lines contain all numbers.
    """
    file = validation.path(path, "compare")
    with renaming({"path": "compare"}), files.naming_file(file):
        data = text_table.unpacked(file, _MOST_BYTES)
    if len(data) > _MOST_BYTES:
        raise _refusal(file, f"has more than {_MOST_BYTES} bytes", "give a table of one curve")
    lines = text_table.lines_of(decoded(data))
    form = text_table.form_of(lines)
    if form is None:
        raise _refusal(file, "has no rows of numbers", _REMEDY)
    block = max(text_table.blocks_of(lines, form), key=lambda part: part.values.size)
    return _curve_of(file, _names(file, block, form), block.values)


def _refusal(file: Path, what: str, remedy: str) -> ArgumentValueError:
    """Return the error for a file of a measured curve that cannot be used, with the reason and a remedy."""
    return ArgumentValueError(f"{ref('compare')}: {str(file)!r} {what}; {remedy}")


def _names(file: Path, block: Block, form: Form) -> list[str]:
    """Return the names of the columns from the header of a text file, in lower case with underscores."""
    count = block.values.shape[1]
    for line in reversed(block.header):
        cells = form.cells(line.lstrip("#%; "))
        if len(cells) == count:
            return [re.sub(r"\W+", "_", cell.lower().replace("°", "deg").strip('"')).strip("_") for cell in cells]
    raise _refusal(file, f"has no line with the names of its {count} columns", _REMEDY)


def _curve_of(file: Path, names: list[str], values: NDArray[np.float64]) -> MeasuredCurve:
    """Return the measured curve of a table with named columns, sorted by wavelength or by view angle."""
    listed = ", ".join(map(repr, names[:8]))
    axes = {name: names.index(name) for name in _AXES if name in names}
    if not axes:
        raise _refusal(file, f"must have a column wavelength_nm or angle_deg, got {listed}", _REMEDY)
    errors = [k for k, name in enumerate(names) if _ERROR.search(name)]
    rest = [k for k in range(len(names)) if k not in axes.values() and k not in errors]
    if len(rest) != 1 or len(errors) > 1:
        raise _refusal(file, f"must have one column of values, and at most one of errors, got {listed}", _REMEDY)
    used = [*axes.values(), *rest, *errors]
    is_whole = np.isfinite(values[:, used]).all(axis=1)
    rows = values[is_whole]
    if len(rows) < _LEAST_ROWS:
        raise _refusal(file, f"must have at least {_LEAST_ROWS} rows of numbers, got {len(rows)}", _REMEDY)
    varying = [name for name, k in axes.items() if np.ptp(rows[:, k]) > 0.0]
    if len(varying) != 1:
        raise _refusal(
            file, f"must have one of wavelength_nm and angle_deg that varies, got {len(varying)}",
            "keep the rows of one curve",
        )  # fmt: skip
    against: Against = "wavelength_nm" if varying[0] == "wavelength_nm" else "angle_deg"
    constants = {name: float(rows[0, k]) for name, k in axes.items() if name not in varying}
    rows = rows[np.argsort(rows[:, axes[against]], kind="stable")]
    positions = rows[:, axes[against]]
    if "wavelength_nm" in axes:
        with files.holding("wavelengths_nm", file):
            colorimetry.check_wavelengths(rows[:, axes["wavelength_nm"]])
    if "angle_deg" in axes and float(np.max(np.abs(rows[:, axes["angle_deg"]]))) >= _MOST_DEG:
        raise _refusal(
            file, f"must have angles above -90 and below 90, got {positions[np.argmax(np.abs(positions))]:g}",
            "angles are from the normal of the surface",
        )  # fmt: skip
    return MeasuredCurve(
        file, names[rest[0]], against, positions, rows[:, rest[0]], rows[:, errors[0]] if errors else None,
        constants.get("wavelength_nm"), constants.get("angle_deg"), int(np.count_nonzero(~is_whole)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class CurveComparison:
    """Comparison of a measured curve with a computed curve, which is scaled by a factor from a least-squares fit.

    Attributes:
        measured: Measured curve.
        computed: Computed values at the positions of the measured curve, shape (n,), before scaling.
        scale: Factor by which the computed values fit the measured values best.
        scale_error: Standard error of ``scale``, estimated from the residuals of the fit.
        residual: Root mean square difference of the measured and the scaled computed values, relative to the largest
            magnitude of the measured values.
        correlation: Correlation coefficient of the measured and the computed values; NaN if either curve is constant.
        what: Name of the computed quantity, which the page shows.
    """

    measured: MeasuredCurve
    computed: NDArray[np.float64]
    scale: float
    scale_error: float
    residual: float
    correlation: float
    what: str


def compare_curves(measured: MeasuredCurve, computed: NDArray[np.float64], what: str) -> CurveComparison:
    """Fit a factor between a computed and a measured curve by least squares.

    If all errors of the measured values are positive, each value has the weight 1/error².

    Args:
        measured: Measured curve.
        computed: Computed values at the positions of the measured curve, shape (n,).
        what: Name of the computed quantity, which the page shows.

    Raises:
        ValueError: All computed values are zero.
    """
    values = np.asarray(computed, dtype=np.float64)
    is_weighted = measured.errors is not None and bool(np.all(measured.errors > 0.0))
    weights = measured.errors**-2.0 if is_weighted and measured.errors is not None else np.ones(len(values))
    power = float(np.sum(weights * values**2))
    if not power > 0.0:
        raise ArgumentValueError("the computed values are zero at all measured positions, so that no scale fits them")
    scale = float(np.sum(weights * values * measured.values)) / power
    residuals = measured.values - scale * values
    variance = float(np.sum(weights * residuals**2)) / (len(values) - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = float(np.corrcoef(values, measured.values)[0, 1])
    largest = float(np.max(np.abs(measured.values)))
    residual = float(np.sqrt(np.mean(residuals**2))) / largest if largest > 0.0 else float("nan")
    return CurveComparison(
        measured, values, scale, float(np.sqrt(variance / power)), residual, correlation, what,
    )  # fmt: skip
