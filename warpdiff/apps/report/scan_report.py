"""Function ``report``, which writes the report of a height field: a web page, and its numbers as JSON and CSV."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Unpack

import numpy as np

from warpdiff.apps.report import report_page
from warpdiff.apps.report.measured_curve import read_curve
from warpdiff.apps.report.report_data import Request, collect
from warpdiff.apps.report.report_figures import figures_of
from warpdiff.apps.report.report_numbers import numbers_of, tables_of
from warpdiff.core import files, validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.plot.axes import check_matplotlib
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import EvaluationSettings
from warpdiff.request.signatures import accepts

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.apps.report.report_numbers import JsonObject
    from warpdiff.core.table import Table
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.request.keywords import EvaluationKeywords

# Largest number of coherence windows, and of wavelengths, of a report. Both were chosen so that the tables and pictures
# of all windows and wavelengths fit on one page.
_MOST_SIGMAS, _MOST_WAVELENGTHS = 6, 12


@dataclass(frozen=True, eq=False)
class ScanReport:
    """Files and numbers of a report; ``print`` shows its main results.

    Attributes:
        page: Path of the web page.
        paths: Paths of all files, the page first.
        numbers: Numbers of the report as dictionaries and lists, as in the JSON file; None where there is no number.
        reasons: Reasons why results are absent, by the name of the result.
        warnings: Warnings during the computations, each once. The page shows them; they are not issued as Python
            warnings.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> report = wd.report(grating, "report", sigmas_um=[2.0])
        >>> report.page.name, report.reasons["periods"][:38]
        ('report.html', 'no wave repeats at least three times i')
    """

    page: Path
    paths: tuple[Path, ...]
    numbers: JsonObject
    reasons: dict[str, str]
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        return f"ScanReport({str(self.page)!r}, {len(self.paths)} files, {len(self.warnings)} warnings)"

    def __str__(self) -> str:
        return report_page.summary_text(self.numbers, self.warnings)


@accepts(EvaluationSettings)
def report(
    heightfield: HeightField, folder: str | os.PathLike[str], *, to_light: ArrayLike | None = None,
    to_view: ArrayLike | None = None, wavelengths_nm: ArrayLike = (450.0, 550.0, 650.0),
    sigmas_um: Sequence[float] | None = None, compare: str | os.PathLike[str] | None = None,
    illuminant: str | Spectrum = "D65", title: str | None = None, progress: Progress = None,
    **settings: Unpack[EvaluationKeywords],
) -> ScanReport:  # fmt: skip
    """Write the report of a height field: one web page without links to other files, and files with its numbers.

    The page has the map of the heights and a profile, the cleaning steps, the ISO 25178 parameters, the power spectrum
    and its periods, the verdict on scalar diffraction (its expected error), the diffraction orders with their angles
    and efficiencies, colours against the view angle, and a reflectance map. Each number has its error, or the reason
    why it has none. If some of these results cannot be computed, the page states which are absent. The report requires
    the extra ``plot``.

    Missing samples are interpolated before diffraction is computed. Do all other cleaning first, see
    `HeightField.levelled`. Large fields are cropped to their middle: periods are computed from at most 1,536 samples
    along each axis, and diffraction from a square of about 100 µm.

    Args:
        heightfield: Height field after cleaning.
        folder: Folder of the files; it is created if it does not exist. Files of an earlier report are replaced.
        to_light: Direction to the light in the local frame, shape (3,). None is 30° from the normal, in the plane of
            the normal and the strongest wave vector.
        to_view: Direction to the viewer of a measured spectrum, shape (3,). None is the view angle in the file, or the
            mirror direction if the file states none.
        wavelengths_nm: Wavelengths for which orders and verdicts are computed [nm], shape (m,) or one number.
        sigmas_um: Standard deviations of the coherence windows whose colours are shown [µm], one to six. None is 5,
            16.25 and 50 µm, but for a scan at most a quarter of its shorter side. Reflectance map and comparison have
            the middle one of these windows, unless ``coherence`` or ``plan`` states another one.
        compare: Text file of a measured spectrum or goniometer curve, which is drawn over the computed curve. It has a
            column ``wavelength_nm`` or ``angle_deg``, one column of values, and optionally one with ``error`` in its
            name. View angles are from the normal in the plane of the light. They are positive towards +x, or towards +y
            if this plane contains the y axis.
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.
        title: Title of the page; None is the name of the file of the height field.
        progress: Function that is called with the finished fraction of the work, 0 to 1; True shows a progress bar.

    Returns:
        Paths of the files, and the numbers.

    Raises:
        ImportError: matplotlib is not installed.
        TypeError: An argument has the wrong type.
        ValueError: An argument is out of its range, or the measured curve cannot be read.
        OSError: A file cannot be written.

    Examples:
        >>> import warpdiff as wd
        >>> report = wd.report(wd.gratings.blazed(2.0, 0.2), "report", sigmas_um=[2.0])
        >>> [path.name for path in report.paths]
        ['report.html', 'report.json', 'roughness.csv', 'theory.csv', 'orders.csv', 'colours.csv']
    """
    validation.instance(heightfield, HeightField, "heightfield")
    if title is not None and not isinstance(title, str):
        raise ArgumentTypeError(f"{ref('title')} must be a string, got {title!r:.40}")
    check_matplotlib("a report requires")
    request = Request(
        heightfield, _direction(to_light, "to_light"), _direction(to_view, "to_view"), _wavelengths(wavelengths_nm),
        _sigmas(sigmas_um), illuminant, None if compare is None else read_curve(compare), dict(settings),
    )  # fmt: skip
    # A wrong setting must raise an error. Without this check, the page would only state the error as the reason why
    # results are absent.
    flat = HeightField.of_known_scale([[0.0]], 1.0)
    Evaluation.of(flat, EvaluationSettings(**settings), illuminants=(illuminant,))
    target = files.made_folder(folder)
    announce = reporter(progress, "report") or (lambda _: None)
    data = collect(request, announce)
    figures = figures_of(data)
    numbers = numbers_of(data, _title(heightfield) if title is None else title)
    tables = tables_of(data)
    page = report_page.page_of(data, numbers, figures, ["report.json", *(f"{key}.csv" for key in tables)])
    paths = _write(target, page, numbers, tables)
    announce(1.0)
    return ScanReport(paths[0], paths, numbers, dict(data.reasons), tuple(data.warnings))


def _direction(value: ArrayLike | None, name: str) -> NDArray[np.float64] | None:
    """Return a direction as a unit vector, and check that it is above the horizon; None stays None."""
    if value is None:
        return None
    unit: NDArray[np.float64] = validation.unit_directions(validation.vector(value, name), name)[0][0]
    if unit[2] <= HORIZON:
        raise ArgumentValueError(f"{ref(name)} must be above the horizon (z > 0), got {np.asarray(value).tolist()}")
    return unit


def _wavelengths(value: ArrayLike) -> NDArray[np.float64]:
    wavelengths = np.unique(colorimetry.check_wavelengths(value))
    if not 1 <= len(wavelengths) <= _MOST_WAVELENGTHS:
        raise ArgumentValueError(
            f"{ref('wavelengths_nm')} must be 1 to {_MOST_WAVELENGTHS} wavelengths, got {len(wavelengths)}"
        )
    return wavelengths


def _sigmas(value: Sequence[float] | None) -> tuple[float, ...]:
    if value is None:
        return ()
    sigmas = np.unique(np.atleast_1d(validation.finite_array(value, "sigmas_um", most=validation.MOST))).tolist()
    if not 1 <= len(sigmas) <= _MOST_SIGMAS or not all(sigma >= validation.LEAST for sigma in sigmas):
        raise ArgumentValueError(
            f"{ref('sigmas_um')} must be 1 to {_MOST_SIGMAS} numbers of at least {validation.LEAST:g}, got "
            f"{value!r:.60}"
        )
    return tuple(sigmas)


def _title(heightfield: HeightField) -> str:
    source = heightfield.source
    if source is None or not source.path:
        return "Height field"
    name = source.path.replace("\\", "/").rpartition("/")[2]
    return f"{name}, {source.channel}" if source.channel else name


def _write(target: Path, page: str, numbers: JsonObject, tables: dict[str, Table]) -> tuple[Path, ...]:
    """Write all files of a report, the page last; a complete new file replaces the file of an earlier report."""
    paths = [target / "report.json"]
    with files.atomic_write(paths[0]) as temporary:
        text = json.dumps(numbers, ensure_ascii=False, indent=1, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8", newline="\n")
    paths += [table.save(target / f"{name}.csv") for name, table in tables.items()]
    with files.atomic_write(target / "report.html", suffix=".html") as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")
    return target / "report.html", *paths
