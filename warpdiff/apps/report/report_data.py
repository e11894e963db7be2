"""Results of a report. Each result is computed separately; if it is absent, the reason is stored instead."""

from __future__ import annotations

import contextlib
import math
import warnings
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from warpdiff.apps.report.measured_curve import CurveComparison, MeasuredCurve, compare_curves
from warpdiff.core.angles import direction, signed_angles_deg
from warpdiff.core.table import Table
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.evaluate.order_angles import order_angles
from warpdiff.evaluate.orders import OrderEfficiencies, order_efficiencies
from warpdiff.evaluate.reflectance import reflectance, reflectance_map, spectral_reflectance
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.periods import LEAST_SAMPLES
from warpdiff.heightfield.theory_verdict import verdict_on
from warpdiff.optics.coherence import Coherence
from warpdiff.request.settings import SpectralSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from warpdiff.heightfield.periods import Periods
    from warpdiff.heightfield.roughness import Roughness
    from warpdiff.heightfield.theory_verdict import TheoryVerdict
    from warpdiff.image.image import Image
    from warpdiff.optics.spectra import Spectrum

_T = TypeVar("_T")
# Largest number of samples along an axis of the field from which periods and diffraction are computed; a larger field
# is cropped to its middle. The number was chosen so that a report takes 30 s on two cores. If doubled, the time is four
# times as long.
MOST_SAMPLES = 1536
# View angles for which a report computes colours [degrees]. The step between two angles is about half of the angular
# width of a diffraction order with the default coherence window.
ANGLES_DEG = np.arange(-89.5, 89.6, 0.25)
# Width and height of the reflectance map [pixels]. It was chosen so that the map fills a third of the width of a
# printed page at 150 dots per inch.
_MAP_PIXELS = 300
# Largest number m of a diffraction order of a period in the table of the orders. It was chosen because orders with
# larger m are far weaker than the noise of a scan.
_MOST_ORDER = 20
# Largest number of diffraction orders of the field from which diffraction is computed; a larger field is cropped to its
# middle. At 450 nm this middle is a square of 100 µm, which is wider than the default coherence window. The number was
# chosen so that the computation takes seconds. If doubled, the time doubles.
_MOST_PATCH_ORDERS = 2e5
# Smallest length of the cropped field, relative to the length of the uncropped field, at which the field counts as not
# cropped. The ratio is below 1 because lengths are rounded.
_WHOLE = 0.999
# A field in which no wave repeats counts as one period of a grating if the grating has at most this number of
# diffraction orders. The number was chosen so that the table of these orders fits on a page. Patches of rough surfaces
# have thousands of orders.
_MOST_CELL_ORDERS = 60
# Angle of the light from the normal if the caller gives no ``to_light`` [degrees]. It was chosen because this angle is
# common in goniometers.
DEFAULT_INCIDENCE_DEG = 30.0
# Heights in a file of integers may be clipped. A report warns if more than this fraction of the samples have the
# smallest or the largest integer. The fraction is above 0 because a scan that is scaled to the range of the integers
# has at least one sample at each end. If doubled, small clipped peaks are not reported.
_MOST_CLIPPED = 1e-4
# Least sine of the angle between the light and the normal for which both define a plane of incidence. Smaller sines may
# be rounding errors of unit vectors.
_LEAST_SINE = 1e-9
# Default standard deviations σ of the coherence windows [µm]: that of daylight, and a shorter and a longer one.
_SIGMAS_UM = (5.0, 16.25, 50.0)
# Least size of a scan, in units of σ, at which its edges have little weight in the window.
PATCH_IN_SIGMAS = 4.0


@dataclass(frozen=True)
class Request:
    """Checked arguments of a report.

    Attributes:
        heightfield: Height field that the caller passes.
        to_light: Unit vector to the light, shape (3,); None for the default of `warpdiff.report`.
        to_view: Unit vector to the viewer of a measured spectrum, shape (3,); None for the default of
            `warpdiff.report`.
        wavelengths_nm: Wavelengths [nm] for which the report lists diffraction orders and the expected error of scalar
            diffraction, shape (m,).
        sigmas_um: Standard deviations of the coherence windows for which colours are computed [µm]; empty until
            they are chosen by the size of the field.
        illuminant: Illuminant of the colours.
        measured: Measured curve; None if there is no measurement.
        settings: Other keyword arguments of `warpdiff.report`, by name.
    """

    heightfield: HeightField
    to_light: NDArray[np.float64] | None
    to_view: NDArray[np.float64] | None
    wavelengths_nm: NDArray[np.float64]
    sigmas_um: tuple[float, ...]
    illuminant: str | Spectrum
    measured: MeasuredCurve | None
    settings: dict[str, Any]


@dataclass
class ReportData:
    """Results of a report, computed by `collect`. An absent result is None, and ``reasons`` has the reason.

    Attributes:
        request: Checked arguments of the report.
        part: Height field from which periods are computed; missing samples are not interpolated. A field with too many
            samples is cropped to its middle.
        to_light: Unit vector to the light, shape (3,).
        azimuth_deg: Azimuth of the plane of the view angles [degrees], above −90 and at most 90.
        periods: Periodic waves in ``part``, strongest first.
        roughness: ISO 25178 parameters of the whole field.
        verdicts: Verdict on scalar diffraction at each wavelength: expected error of an order's efficiency, and its
            reason.
        flat_powers: Power that a flat surface of the material reflects at each wavelength, relative to the incident
            power, shape (m,).
        efficiencies: Efficiencies of the orders that the picture of the orders shows.
        orders: Table of the diffraction orders. For a field without orders, the table has the power in the mirror
            direction and the scattered power.
        patch_um: Size (y, x) of the field from which diffraction is computed [µm], after cropping.
        is_cell: Whether the field counts as one period of a grating, because nothing repeats in it and it has few
            orders.
        colours: CIE XYZ at the view angles `ANGLES_DEG`, shape (n, 3), by the standard deviation of the coherence
            window [µm].
        map: Colours of the reflectance over all view directions, as an image.
        comparison: Comparison of the user's file ``compare``, a measured spectrum or goniometer curve, with the
            computed one; None without such a file.
        reasons: Reason why a result is absent, by the name of its attribute.
        warnings: Texts of all warnings during the computations, each once.
    """

    request: Request
    part: HeightField
    to_light: NDArray[np.float64]
    azimuth_deg: float = 0.0
    periods: Periods | None = None
    roughness: Roughness | None = None
    verdicts: tuple[TheoryVerdict, ...] | None = None
    flat_powers: NDArray[np.float64] | None = None
    efficiencies: OrderEfficiencies | None = None
    orders: Table | None = None
    patch_um: tuple[float, float] = (0.0, 0.0)
    is_cell: bool = False
    colours: dict[float, NDArray[np.float64]] = field(default_factory=dict)
    map: Image | None = None
    comparison: CurveComparison | None = None
    reasons: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    @property
    def efficiency_errors(self) -> NDArray[np.float64] | None:
        """Error of an order's efficiency at each wavelength, relative to the incident power; None if it is unknown."""
        if self.flat_powers is None or not self.verdicts:
            return None
        return _efficiency_errors(self.verdicts, self.flat_powers)

    @property
    def light_deg(self) -> float:
        """Angle of the light from the normal [degrees], positive towards +x, or towards +y if its x component is 0."""
        return float(signed_angles_deg(self.to_light))

    @property
    def is_flat(self) -> bool:
        """Whether the levelled field is flat. A flat field has no power spectrum."""
        return self.roughness is not None and self.roughness["Sq"].value == 0.0

    @property
    def is_cropped(self) -> bool:
        """Whether periods are computed from the middle of the field, because the field has too many samples."""
        return self.part is not self.request.heightfield

    @property
    def has_patch(self) -> bool:
        """Whether diffraction is computed from the middle of the field, because the field has too many orders."""
        shares = (own / whole for own, whole in zip(self.patch_um, self.request.heightfield.size_um, strict=True))
        return 0.0 < min(shares) < _WHOLE

    def attempt(self, name: str, compute: Callable[[], _T]) -> _T | None:
        """Return the result of ``compute``; if it fails, return None and store the reason in ``reasons[name]``."""
        with self._collecting():
            try:
                return compute()
            except (ValueError, MemoryError) as error:
                self.reasons[name] = str(error)
                return None

    @contextlib.contextmanager
    def _collecting(self) -> Iterator[None]:
        """Collect the warnings of this package in ``warnings``; issue all other warnings as usual."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", WarpdiffWarning)
            yield
        for warning in caught:
            text = str(warning.message)
            if not issubclass(warning.category, WarpdiffWarning):
                warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
            elif text not in self.warnings:
                self.warnings.append(text)


def _with_windows(data: ReportData) -> Request:
    """Return the arguments of a report with coherence windows where they leave them open.

    Wider windows than a scan would show its repetition. Reflectance map and comparison use the middle window.
    """
    # A profile, or a scan of few lines, is narrow along one axis. Its windows reach over the repeated lines.
    sides = [side for side in data.patch_um if side >= 0.5 * max(data.patch_um)]
    request, most = data.request, math.inf if data.is_cell else min(sides) / PATCH_IN_SIGMAS
    sigmas_um = request.sigmas_um or tuple(sorted({min(sigma, most) for sigma in _SIGMAS_UM}))
    settings = request.settings
    if settings.get("coherence") is None and settings.get("plan") is None:
        settings = settings | {"coherence": Coherence(sigma_um=sigmas_um[len(sigmas_um) // 2])}
    return replace(request, sigmas_um=sigmas_um, settings=settings)


def collect(request: Request, progress: Callable[[float], None]) -> ReportData:
    """Compute all results of a report.

    Args:
        request: Checked arguments of the report.
        progress: Function that is called with the finished fraction of the work, 0 to 1.
    """
    part = central_part(request.heightfield)
    data = ReportData(request, part, np.array([0.0, 0.0, 1.0]))
    data.periods = data.attempt("periods", part.periods)
    if data.periods is not None and not data.periods:
        data.reasons["periods"] = "no wave repeats at least three times in this field and stands out from its roughness"
    data.warnings += _doubts(data)
    progress(0.2)
    data.is_cell = not data.periods and _order_count(part, float(request.wavelengths_nm.min())) <= _MOST_CELL_ORDERS
    # A single period of a grating may be a tilted plane, such as a blazed groove. Subtraction of the tilt would remove
    # this groove. Only the mean is therefore subtracted from such a field.
    data.roughness = data.attempt("roughness", lambda: request.heightfield.roughness(0 if data.is_cell else 1))
    progress(0.3)
    _set_geometry(data)
    optical = data.attempt("optics", lambda: _patch(_optical(part), float(request.wavelengths_nm.min())))
    if optical is None:
        for name in ("verdicts", "orders", "colours", "map", "comparison"):
            data.reasons[name] = data.reasons["optics"]
        return data
    data.patch_um = optical.size_um
    data.request = request = _with_windows(data)
    data.verdicts = data.attempt(
        "verdicts", lambda: tuple(verdict_on(optical, nm) for nm in request.wavelengths_nm.tolist())
    )
    progress(0.4)
    data.attempt("orders", lambda: _add_orders(data, optical))
    progress(0.55)
    views = direction(ANGLES_DEG, data.azimuth_deg)
    for index, sigma in enumerate(request.sigmas_um):
        # The caller's plan holds numbers of wavelengths and terms for another coherence window. It is not valid for
        # these colours.
        settings = request.settings | {"coherence": Coherence(sigma_um=sigma), "plan": None}
        xyz = data.attempt(
            "colours",
            lambda settings=settings: reflectance(  # type: ignore[misc]
                optical, data.to_light, views, illuminant=request.illuminant, **settings
            ),
        )
        if xyz is not None:
            data.colours[sigma] = np.asarray(xyz, dtype=np.float64)
        progress(0.55 + 0.15 * (index + 1) / len(request.sigmas_um))
    data.map = data.attempt(
        "map",
        lambda: reflectance_map(
            optical, data.to_light, size=_MAP_PIXELS, illuminant=request.illuminant, **request.settings,
            progress=lambda share: progress(0.7 + 0.2 * share),
        ),
    )  # fmt: skip
    if request.measured is not None:
        measured = request.measured
        data.comparison = data.attempt("comparison", lambda: _compared(data, optical, measured))
    progress(0.95)
    return data


def _doubts(data: ReportData) -> list[str]:
    """Return warnings about clipped heights, and about periods with fewer than three samples along an axis."""
    source = data.request.heightfield.source
    texts = []
    if source is not None and source.clipped > _MOST_CLIPPED:
        texts.append(
            f"{100.0 * source.clipped:.2g} % of the samples have the smallest or the largest integer of the file. "
            "Their heights may be clipped."
        )
    texts += [
        f"The period of {period.period_um:.3g} µm has fewer than {LEAST_SAMPLES:g} samples along an axis. It may be an "
        "artefact of sampling or of resampling."
        for period in data.periods or ()
        if not period.is_resolved
    ]
    return texts


def central_part(heightfield: HeightField) -> HeightField:
    """Return a height field, cropped to its middle if it has too many samples along an axis."""
    if max(heightfield.shape) <= MOST_SAMPLES:
        return heightfield
    size = [min(n, MOST_SAMPLES) * pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True)]
    return heightfield.cropped((size[0], size[1]))


def _order_count(part: HeightField, wavelength_nm: float) -> float:
    """Return the number of diffraction orders of a field that repeats as one period of a grating.

    The number counts the orders that propagate for at least one angle of the light.
    """
    counts = [2e3 * size / wavelength_nm + 1.0 for n, size in zip(part.shape, part.size_um, strict=True) if n > 1]
    return math.prod(counts)


def _optical(part: HeightField) -> HeightField:
    """Return a copy of a height field, in which missing samples are interpolated.

    The copy has no results from earlier computations, so that all warnings are issued again.
    """
    whole = part.filled() if part.missing.any() else part
    return HeightField.of_known_scale(whole.heights_um, whole.pitch_um)


def _set_geometry(data: ReportData) -> None:
    """Set the direction to the light and the plane of the view angles.

    By default, this plane contains the normal and the strongest wave vector of the field.
    """
    azimuth = wave_azimuth_deg(data.part)
    light = data.request.to_light
    if light is None:
        data.to_light, data.azimuth_deg = direction(DEFAULT_INCIDENCE_DEG, azimuth), azimuth
        return
    data.to_light = light
    if math.hypot(light[0], light[1]) > _LEAST_SINE:
        azimuth = math.degrees(math.atan2(light[1], light[0]))
        azimuth -= 180.0 * math.ceil((azimuth - 90.0) / 180.0)
    data.azimuth_deg = azimuth


def wave_azimuth_deg(heightfield: HeightField) -> float:
    """Return the azimuth of the strongest wave vector of a field [degrees], above −90 and at most 90.

    The azimuth is rounded to 0.1°. If nothing repeats in the field, the result is the azimuth of the x axis, or of the
    y axis for a field of a single column.
    """
    try:
        periods = central_part(heightfield).periods()
    except (ValueError, MemoryError):
        # If the periods cannot be computed, the error is ignored here. `collect` also computes them, and stores the
        # same error, so that the page states the reason.
        periods = None
    if not periods:
        return 0.0 if heightfield.shape[1] > 1 else 90.0
    azimuth = round(periods[0].direction_deg, 1) + 0.0
    # The azimuths −90° and 90° describe the same plane.
    return 90.0 if azimuth == -90.0 else azimuth


def _efficiency_errors(verdicts: Sequence[TheoryVerdict], flat_powers: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the error of an order's efficiency at each wavelength, relative to the incident power.

    A verdict on scalar diffraction states this error relative to the power that a flat surface reflects. The result is
    this error times ``flat_powers``.
    """
    return np.array([min(verdict.error, 1.0) for verdict in verdicts]) * flat_powers


def _add_orders(data: ReportData, optical: HeightField) -> None:
    """Compute the table of the orders, and the efficiencies for the picture of the orders."""
    request = data.request
    light, wavelengths = data.to_light, request.wavelengths_nm
    material = {name: request.settings[name] for name in ("ior", "material") if request.settings.get(name) is not None}
    flat = HeightField.of_known_scale([[0.0]], 1.0)
    data.flat_powers = order_efficiencies(flat, light, wavelengths, **material).efficiencies[:, 0]
    result = order_efficiencies(optical, light, wavelengths, **material)
    model = _efficiency_errors([verdict_on(optical, nm) for nm in wavelengths.tolist()], data.flat_powers)
    if data.periods:
        table, data.efficiencies = _of_periods(data, data.periods, result, model)
        data.orders = _judged(table)
        return
    if data.is_cell:
        table = result.table()
        row = np.searchsorted(wavelengths, table["wavelength_nm"])
        data.orders, data.efficiencies = _judged(Table({**table.columns, "model_error": model[row]})), result
        return
    mirror = result[0, 0]
    rest = result.efficiencies.sum(axis=1) - mirror
    data.orders = Table({
        "wavelength_nm": np.repeat(wavelengths, 2),
        "part": np.tile(["mirror direction", "scattered"], len(wavelengths)),
        "efficiency": np.stack([mirror, rest], axis=1).ravel(), "model_error": np.repeat(model, 2),
    })  # fmt: skip


def _judged(table: Table) -> Table:
    """Return a table of orders with two more columns: signed angle, and whether the efficiency exceeds its error."""
    angles = signed_angles_deg(direction(table["view_theta_deg"], table["view_phi_deg"]))
    return Table({**table.columns, "angle_deg": angles, "is_above_error": table["efficiency"] > table["model_error"]})


def _patch(optical: HeightField, wavelength_nm: float) -> HeightField:
    """Return a field, cropped to its middle if it has too many diffraction orders."""
    if _order_count(optical, wavelength_nm) <= _MOST_PATCH_ORDERS:
        return optical
    axes = sum(n > 1 for n in optical.shape)
    most = 5e-4 * wavelength_nm * _MOST_PATCH_ORDERS ** (1.0 / axes)
    ly, lx = (min(max(most, pitch), size) for pitch, size in zip(optical.pitch_um, optical.size_um, strict=True))
    return optical.cropped((ly, lx))


def _of_periods(
    data: ReportData, periods: Periods, result: OrderEfficiencies, model: NDArray[np.float64]
) -> tuple[Table, OrderEfficiencies]:
    """Return the table of the orders of all periods, and the efficiencies of the orders of the strongest period.

    The efficiencies in ``result`` are those of a grating whose one period is the whole field. The orders of this
    grating are much denser than the orders of the periods that were measured in the field. The efficiency of a dense
    order is added to the nearest order of a measured period, if the distance is at most half of the shortest wave
    vector.
    """
    angles = order_angles(periods, data.to_light, data.request.wavelengths_nm, most_order=_MOST_ORDER)
    numbers = np.array([(wave, m) for wave in range(len(periods)) for m in range(-_MOST_ORDER, _MOST_ORDER + 1)])
    # Order 0 of every period is the mirror direction, so that it is listed once.
    numbers = numbers[(numbers[:, 0] == 0) | (numbers[:, 1] != 0)]
    waves = np.array([period.frequency for period in periods])
    centres = numbers[:, 1:] * waves[numbers[:, 0]]
    own = result.orders / np.array(data.patch_um)
    radius = 0.5 * float(np.min(np.hypot(*waves.T)))
    nearest = np.empty(len(own), dtype=int)
    is_near = np.empty(len(own), dtype=bool)
    for chunk in np.array_split(np.arange(len(own)), max(len(own) // 4096, 1)):
        distances = np.hypot(
            own[chunk, :1] - centres[:, 0], own[chunk, 1:] - centres[:, 1]
        )  # fmt: skip
        nearest[chunk] = np.argmin(distances, axis=1)
        is_near[chunk] = np.min(distances, axis=1) <= radius
    sums = np.stack([
        np.bincount(nearest[is_near], row[is_near], len(numbers)) for row in result.efficiencies
    ])  # fmt: skip
    place = {tuple(pair): k for k, pair in enumerate(numbers.tolist())}
    wave_of = {period.period_um: k for k, period in reversed(list(enumerate(periods)))}
    rows: dict[str, list[float]] = {name: [] for name in (
        "wavelength_nm", "period_um", "order", "view_theta_deg", "view_phi_deg", "standard_error_deg", "efficiency",
        "model_error",
    )}  # fmt: skip
    for period, nm, order, theta, phi, error in angles.rows:
        wave = wave_of[period]
        if order == 0 and wave > 0:
            continue
        row = int(np.argmin(np.abs(data.request.wavelengths_nm - nm)))
        values = (nm, period, order, theta, phi, error, sums[row, place[wave, order]], model[row])
        for name, value in zip(rows, values, strict=True):
            rows[name].append(value)
    table = Table({name: np.array(values) for name, values in rows.items()})
    return table, _of_grating(table, periods[0].period_um, result)


def _of_grating(table: Table, period_um: float, result: OrderEfficiencies) -> OrderEfficiencies:
    """Return the efficiencies of the diffraction orders of one period in the table, in a form that can be plotted.

    The table lists an order by its number m. The result lists the same order as (0, m), an order of a grating along x.
    """
    is_own = table["period_um"] == period_um
    orders = np.unique(table["order"][is_own]).astype(int)
    wavelengths = result.wavelengths_nm
    to_view = np.full((len(wavelengths), len(orders), 3), np.nan)
    efficiencies = np.zeros(to_view.shape[:2])
    rows = np.argmin(np.abs(table["wavelength_nm"][is_own][:, None] - wavelengths), axis=1)
    columns = np.searchsorted(orders, table["order"][is_own])
    to_view[rows, columns] = direction(table["view_theta_deg"][is_own], table["view_phi_deg"][is_own])
    efficiencies[rows, columns] = table["efficiency"][is_own]
    pairs = np.stack([np.zeros(len(orders), dtype=int), orders], axis=1)
    return OrderEfficiencies(wavelengths, result.to_light, pairs, to_view, efficiencies, result.verdict)


def _compared(data: ReportData, optical: HeightField, measured: MeasuredCurve) -> CurveComparison:
    """Compute the quantity that the user has measured, and compare the computed with the measured curve."""
    request = data.request
    names = {option.name for option in fields(SpectralSettings)}
    spectral = {name: value for name, value in request.settings.items() if name in names}
    if measured.against == "angle_deg":
        views = direction(measured.positions, data.azimuth_deg)
        if measured.wavelength_nm is None:
            xyz = reflectance(optical, data.to_light, views, illuminant=request.illuminant, **request.settings)
            return compare_curves(measured, xyz[:, 1], f"luminance Y under {request.illuminant}")
        nm = measured.wavelength_nm
        spectra = spectral_reflectance(optical, data.to_light, views, nm, **spectral)
        return compare_curves(measured, np.ravel(spectra), f"relative reflectance at {nm:g} nm")
    view, text = request.to_view, "the given view direction"
    if view is None and measured.view_deg is not None:
        view, text = direction(measured.view_deg, data.azimuth_deg), f"a view at {measured.view_deg:g}°"
    elif view is None:
        view, text = data.to_light * [-1.0, -1.0, 1.0], "the mirror direction"
    spectrum = spectral_reflectance(optical, data.to_light, view, measured.positions, **spectral)
    return compare_curves(measured, np.ravel(spectrum), f"relative reflectance in {text}")
