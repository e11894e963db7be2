"""Numbers of a report: each part is computed separately, and what cannot be found has a reason instead."""

from __future__ import annotations

import contextlib
import math
import warnings
from dataclasses import dataclass, field, fields
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
from warpdiff.heightfield.theory_verdict import verdict_on
from warpdiff.optics.coherence import Coherence
from warpdiff.request.settings import SpectralSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from warpdiff.heightfield.periods import Periods
    from warpdiff.heightfield.roughness import Roughness
    from warpdiff.heightfield.theory_verdict import TheoryVerdict
    from warpdiff.image.image import Image
    from warpdiff.optics.spectra import Spectrum

_T = TypeVar("_T")
# Largest number of samples along an axis of the part of a field that optics and periods are computed from. Limit: 30 s
# on two cores. If doubled, the time is four times as long.
MOST_SAMPLES = 1536
# View angles of the colours [degrees]. The step is about half of the default coherence lobe.
ANGLES_DEG = np.arange(-89.5, 89.6, 0.25)
# Size of the reflectance map [pixels]. Limit: a third of a printed page at 150 dots per inch.
_MAP_PIXELS = 300
# Largest order whose angle is listed. Limit: higher ones are far below any noise.
_MOST_ORDER = 20
# Largest number of orders of the part of a field that optics are computed from: a square of 100 µm at 450 nm, which is
# wider than the default coherence window. Limit: seconds. If doubled, the time doubles.
_MOST_PATCH_ORDERS = 2e5
# Share of the field along an axis from which a part is the field: rounding.
_WHOLE = 0.999
# Number of orders up to which a field without a repetition counts as one period of a grating. Limit: a table of a page.
# Patches of rough surfaces have thousands.
_MOST_CELL_ORDERS = 60
# Angle of the light from the normal without ``to_light`` [degrees]: common in goniometers.
DEFAULT_INCIDENCE_DEG = 30.0
# Sine of the angle from the normal below which a light has no plane of its own. Limit: rounding of unit vectors.
_LEAST_SINE = 1e-9


@dataclass(frozen=True)
class Request:
    """Arguments of a report, checked.

    Attributes:
        heightfield: Field as given.
        to_light: Unit vector to the light, shape (3,), or None.
        to_view: Unit vector to the viewer of a measured spectrum, shape (3,), or None.
        wavelengths_nm: Wavelengths of the orders [nm], shape (m,).
        sigmas_um: Standard deviations of the coherence windows of the colours [µm].
        illuminant: Illuminant of the colours.
        measured: Measured curve, or None.
        settings: Settings of the evaluation by name.
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
    """Results of a report; `collect` fills them. A result that could not be found is None, and ``reasons`` says why.

    Attributes:
        request: Arguments of the report.
        part: Part of the field that periods are computed from, with gaps; the field unless it has many samples.
        to_light: Unit vector to the light, shape (3,).
        azimuth_deg: Azimuth of the plane of the view angles [degrees], above −90 and at most 90.
        periods: Periods of ``part``, strongest first.
        roughness: ISO 25178 parameters of the whole field.
        verdicts: Verdict at each wavelength.
        efficiencies: Efficiencies of the orders that are drawn.
        orders: Table of the orders.
        patch_um: Extent (y, x) of the part of the field that optics are computed from [µm].
        is_cell: Whether the field counts as one period of a grating: nothing repeats, and it has few orders.
        colours: CIE XYZ over the view angle by coherence window [µm], shape (n, 3) each.
        map: Reflectance map.
        comparison: Measured and computed curve.
        reasons: Reason why a result was not found, by the name of its attribute.
        warnings: Warnings, each once.
    """

    request: Request
    part: HeightField
    to_light: NDArray[np.float64]
    azimuth_deg: float = 0.0
    periods: Periods | None = None
    roughness: Roughness | None = None
    verdicts: tuple[TheoryVerdict, ...] | None = None
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
    def light_deg(self) -> float:
        """Angle of the light from the normal [degrees], positive towards +x, or +y where x is 0."""
        return float(signed_angles_deg(self.to_light))

    @property
    def is_flat(self) -> bool:
        """Whether the levelled field is flat, so that it has no spectrum."""
        return self.roughness is not None and self.roughness["Sq"].value == 0.0

    @property
    def is_cropped(self) -> bool:
        """Whether periods are those of a part of the field."""
        return self.part is not self.request.heightfield

    @property
    def has_patch(self) -> bool:
        """Whether optics are those of a part of the field."""
        shares = (own / whole for own, whole in zip(self.patch_um, self.request.heightfield.size_um, strict=True))
        return 0.0 < min(shares) < _WHOLE

    def attempt(self, name: str, compute: Callable[[], _T]) -> _T | None:
        """Return a result, or None with the reason in ``reasons``; its warnings are collected."""
        with self._collecting():
            try:
                return compute()
            except (ValueError, MemoryError) as error:
                self.reasons[name] = str(error)
                return None

    @contextlib.contextmanager
    def _collecting(self) -> Iterator[None]:
        """Collect the warnings of the package; others are issued as usual."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", WarpdiffWarning)
            yield
        for warning in caught:
            text = str(warning.message)
            if not issubclass(warning.category, WarpdiffWarning):
                warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
            elif text not in self.warnings:
                self.warnings.append(text)


def collect(request: Request, progress: Callable[[float], None]) -> ReportData:
    """Compute all parts of a report.

    Args:
        request: Arguments of the report.
        progress: Function that is called with the finished share, 0 to 1.
    """
    part = central_part(request.heightfield)
    data = ReportData(request, part, np.array([0.0, 0.0, 1.0]))
    data.periods = data.attempt("periods", part.periods)
    if data.periods is not None and not data.periods:
        data.reasons["periods"] = "no wave repeats at least three times in this field and stands out from its roughness"
    progress(0.2)
    data.is_cell = not data.periods and _order_count(part, float(request.wavelengths_nm.min())) <= _MOST_CELL_ORDERS
    # A plane fitted to a single period of a grating is a part of it.
    data.roughness = data.attempt("roughness", lambda: request.heightfield.roughness(0 if data.is_cell else 1))
    progress(0.3)
    _set_geometry(data)
    optical = data.attempt("optics", lambda: _patch(_optical(part), float(request.wavelengths_nm.min())))
    if optical is None:
        for name in ("verdicts", "orders", "colours", "map", "comparison"):
            data.reasons[name] = data.reasons["optics"]
        return data
    data.patch_um = optical.size_um
    data.verdicts = data.attempt(
        "verdicts", lambda: tuple(verdict_on(optical, nm) for nm in request.wavelengths_nm.tolist())
    )
    progress(0.4)
    data.attempt("orders", lambda: _add_orders(data, optical))
    progress(0.55)
    views = direction(ANGLES_DEG, data.azimuth_deg)
    for index, sigma in enumerate(request.sigmas_um):
        # A plan is for one coherence window.
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


def central_part(heightfield: HeightField) -> HeightField:
    """Return the field, or the part in its middle if it has too many samples along an axis."""
    if max(heightfield.shape) <= MOST_SAMPLES:
        return heightfield
    size = [min(n, MOST_SAMPLES) * pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True)]
    return heightfield.cropped((size[0], size[1]))


def _order_count(part: HeightField, wavelength_nm: float) -> float:
    """Return the number of orders of a field that is one period, at all angles of the light."""
    counts = [2e3 * size / wavelength_nm + 1.0 for n, size in zip(part.shape, part.size_um, strict=True) if n > 1]
    return math.prod(counts)


def _optical(part: HeightField) -> HeightField:
    """Return a new field without gaps. Caches of the given one are not used, so that all warnings are issued again."""
    whole = part.filled() if part.missing.any() else part
    return HeightField.of_known_scale(whole.heights_um, whole.pitch_um)


def _set_geometry(data: ReportData) -> None:
    """Set the light and the plane of the view angles; by default the plane that contains the strongest wave vector."""
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
    """Return the azimuth of the strongest wave vector [degrees], above −90 and at most 90; the x axis without one.

    It is rounded to 0.1°. A field of a single column has the y axis.
    """
    try:
        periods = central_part(heightfield).periods()
    except (ValueError, MemoryError):
        # The report states the reason.
        periods = None
    if not periods:
        return 0.0 if heightfield.shape[1] > 1 else 90.0
    azimuth = round(periods[0].direction_deg, 1) + 0.0
    # −90° is the same plane as 90°.
    return 90.0 if azimuth == -90.0 else azimuth


def _add_orders(data: ReportData, optical: HeightField) -> None:
    """Add the table of the orders, and the efficiencies that are drawn."""
    request = data.request
    light, wavelengths = data.to_light, request.wavelengths_nm
    material = {name: request.settings[name] for name in ("ior", "material") if request.settings.get(name) is not None}
    result = order_efficiencies(optical, light, wavelengths, **material)
    flat = HeightField.of_known_scale([[0.0]], 1.0)
    # The error of a verdict is relative to the power that a flat surface reflects.
    errors = [min(verdict_on(optical, nm).error, 1.0) for nm in wavelengths.tolist()]
    model = np.array(errors) * order_efficiencies(flat, light, wavelengths, **material).efficiencies[:, 0]
    if data.periods:
        data.orders, data.efficiencies = _of_periods(data, data.periods, result, model)
        return
    if data.is_cell:
        table = result.table()
        row = np.searchsorted(wavelengths, table["wavelength_nm"])
        data.orders, data.efficiencies = Table({**table.columns, "model_error": model[row]}), result
        return
    mirror = result[0, 0]
    rest = result.efficiencies.sum(axis=1) - mirror
    data.orders = Table({
        "wavelength_nm": np.repeat(wavelengths, 2),
        "part": np.tile(["mirror direction", "scattered"], len(wavelengths)),
        "efficiency": np.stack([mirror, rest], axis=1).ravel(), "model_error": np.repeat(model, 2),
    })  # fmt: skip


def _patch(optical: HeightField, wavelength_nm: float) -> HeightField:
    """Return the middle of a field that has too many orders, or the field itself."""
    if _order_count(optical, wavelength_nm) <= _MOST_PATCH_ORDERS:
        return optical
    axes = sum(n > 1 for n in optical.shape)
    most = 5e-4 * wavelength_nm * _MOST_PATCH_ORDERS ** (1.0 / axes)
    ly, lx = (min(max(most, pitch), size) for pitch, size in zip(optical.pitch_um, optical.size_um, strict=True))
    return optical.cropped((ly, lx))


def _of_periods(
    data: ReportData, periods: Periods, result: OrderEfficiencies, model: NDArray[np.float64]
) -> tuple[Table, OrderEfficiencies]:
    """Return the orders of the periods of a field, and the efficiencies of the strongest period's orders.

    The field has orders of its own, which are much denser. Those nearer to an order of a period than half of the
    distance of its orders are summed.
    """
    angles = order_angles(periods, data.to_light, data.request.wavelengths_nm, most_order=_MOST_ORDER)
    numbers = np.array([(wave, m) for wave in range(len(periods)) for m in range(-_MOST_ORDER, _MOST_ORDER + 1)])
    # The mirror direction is that of all periods.
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
    """Return the orders of a period in a table as efficiencies of a grating along x."""
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
    """Compute what was measured, and compare both."""
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
