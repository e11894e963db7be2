"""Pictures of a report as data URIs, drawn by ``warpdiff.plot``: maps are PNG pictures, curves are SVG pictures."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from warpdiff import plot
from warpdiff.apps.report.report_data import ANGLES_DEG
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.periods import LEAST_SAMPLES
from warpdiff.image.display_transform import auto_exposure
from warpdiff.plot.axes import clean_grid, line_style
from warpdiff.request.settings import EvaluationSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.apps.report.measured_curve import CurveComparison
    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.evaluate.orders import OrderEfficiencies
    from warpdiff.image.image import Image

# Resolution of PNG pictures [dots per inch]. It was chosen so that a page has a few megabytes. If doubled, a page has
# four times as many.
_DPI = 150
# Largest number of samples along an axis of a height map. If a field has more samples, only every n-th sample is drawn.
# The number was chosen because more samples are not visible at 150 dots per inch.
_MOST_DRAWN = 1400
# Width of pictures of curves, and of pictures of maps, such as the height map [inches]. Both were chosen so that the
# text of the pictures is legible on a screen with a width of 400 pixels.
_WIDE, _SQUARE = 5.6, 5.4
# The report also shows the middle of a field enlarged, a square with the side `_ZOOM_UM` [µm]. This picture exists only
# if each side of the field is at least `_LEAST_FIELD` times as long as the side of the square.
_ZOOM_UM, _LEAST_FIELD = 10.0, 2.0
# Highest frequency in the enlarged plot of the power spectrum, relative to the frequency of the strongest period.
_SPECTRUM_PERIODS = 4.0
# Factor by which the second colour strip is brighter than the first one, so that it shows weak orders.
_BRIGHTER = 16.0
# Angles with a label below a colour strip [degrees].
_TICKS_DEG = range(-75, 76, 15)
# Largest angle between the x axis and a wave vector at which the wave vector counts as nearer to the x axis than to the
# y axis [degrees].
_NEARER_TO_Y_DEG = 45.0


class Figure(NamedTuple):
    """Picture of the web page of a report.

    Attributes:
        name: Name of the result that the picture shows.
        uris: Picture as a data URI, or two pictures side by side.
        alt: Description of the picture, for readers who cannot see it.
        caption: Text below the picture.
    """

    name: str
    uris: tuple[str, ...]
    alt: str
    caption: str


def figures_of(data: ReportData) -> list[Figure]:
    """Draw the pictures of all results. If a picture cannot be drawn, ``data.reasons`` has the reason."""
    drawings: dict[str, Callable[[], Figure]] = {"surface": lambda: _surface(data)}
    if data.periods is not None and not data.is_cell and not data.is_flat:
        drawings["periods"] = lambda: _spectrum(data)
    if (efficiencies := data.efficiencies) is not None:
        drawings["orders"] = lambda: _orders(data, efficiencies)
    if data.colours:
        drawings["colours"] = lambda: _colours(data)
    if (image := data.map) is not None:
        drawings["map"] = lambda: _map(data, image)
    if (comparison := data.comparison) is not None:
        drawings["comparison"] = lambda: _comparison(comparison)
    figures = (data.attempt(f"picture of {name}", draw) for name, draw in drawings.items())
    return [figure for figure in figures if figure is not None]


def _drawn(
    kind: Literal["png", "svg"], width: float, height: float, draw: Callable[[Any], object], *, rows: int = 1
) -> str:
    """Return a picture as a data URI. ``draw`` draws it into new axes, or into an array of axes for several rows."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    # The figure is not created by pyplot, so that the caller's current figure stays the same. With a fixed salt, the
    # names of elements in an SVG picture are the same in each run, so that equal reports give equal files.
    style = {"font.family": "DejaVu Sans", "font.size": 9.5, "axes.titlesize": 10.5, "svg.hashsalt": "warpdiff"}
    with mpl.rc_context(style):
        # A figure with a single plot needs no automatic layout, because empty margins are cut off when it is saved.
        canvas = Canvas(figsize=(width, height), dpi=_DPI, layout="constrained" if rows > 1 else None)
        draw(canvas.subplots(rows, 1))
        stream = io.BytesIO()
        metadata = {"Date": None} if kind == "svg" else {"Software": None}
        canvas.savefig(stream, format=kind, metadata=metadata, bbox_inches="tight", pad_inches=0.05)
    mime = "image/png" if kind == "png" else "image/svg+xml"
    return f"data:{mime};base64,{base64.b64encode(stream.getvalue()).decode()}"


def _thinned(heightfield: HeightField) -> HeightField:
    """Return a field for the height map, with only every n-th sample if the height map cannot show all samples."""
    steps = [-(-n // _MOST_DRAWN) for n in heightfield.shape]
    if max(steps) == 1:
        return heightfield
    heights = heightfield.heights_um[:: steps[0], :: steps[1]]
    (dy, dx) = heightfield.pitch_um
    return HeightField.of_known_scale(heights, (dy * steps[0], dx * steps[1]))


def _surface(data: ReportData) -> Figure:
    field = data.request.heightfield
    ny, nx = field.shape
    direction = data.periods[0].direction_deg if data.periods else 0.0
    along: Literal["x", "y"] = "y" if nx == 1 or (ny > 1 and abs(direction) > _NEARER_TO_Y_DEG) else "x"
    if min(ny, nx) == 1:
        # A field of one row or one column is drawn as a curve.
        uri = _drawn("svg", _WIDE, 2.6, lambda ax: plot.profile(field, ax=ax, along=along))
        caption = f"Heights of the field, constant along {'y' if along == 'x' else 'x'}."
        return Figure("surface", (uri,), "Profile of the heights", caption)
    parts = [field]
    if min(field.size_um) >= _LEAST_FIELD * _ZOOM_UM:
        parts.append(field.cropped(_ZOOM_UM))

    def drawn(part: HeightField) -> str:
        return _drawn(
            "png", *_map_size(part),
            lambda ax: plot.height_map(_thinned(part), ax=ax, profile_along=along, is_shaded=True),
        )  # fmt: skip

    zoom = f" Second picture: the middle {_ZOOM_UM:g} µm." if len(parts) > 1 else ""
    caption = (
        "Heights of the field, shaded as a relief in light from the upper left, and a profile along "
        f"{along} at the dashed line. Row 0 of the field is at y = 0, at the bottom.{zoom}"
    )
    return Figure("surface", tuple(map(drawn, parts)), "Map of the heights, and a profile", caption)


def _map_size(field: HeightField) -> tuple[float, float]:
    """Return width and height of the figure of a height map [inches], from the sides of the field."""
    ratio = min(max(field.size_um[0] / field.size_um[1], 0.25), 1.5)
    return _SQUARE + 0.4, 0.85 * _SQUARE * ratio + 0.6


def _spectrum(data: ReportData) -> Figure:
    part = data.part
    text = "Power spectral density of the heights minus a fitted plane, with a Hann window."
    alt = "Power spectrum of the heights"
    if data.periods:
        text += " Marks show the periods of the table, at their frequency and at the opposite frequency."
    if min(part.shape) == 1:
        uri = _drawn("svg", _WIDE, 3.3, lambda ax: plot.power_spectrum(part, ax=ax, title=""))
        return Figure("periods", (uri,), alt, text)
    limits: list[float | None] = [None]
    if data.periods:
        nearest = _SPECTRUM_PERIODS / data.periods[0].period_um
        highest = 0.5 / min(part.pitch_um)
        if nearest < highest:
            limits = [nearest, highest]
            text += (
                f" First picture: up to {_SPECTRUM_PERIODS:g} times the frequency of the strongest period. Second "
                "picture: the whole spectrum. Spots with fewer than "
                f"{LEAST_SAMPLES:g} samples per period, beyond {1.0 / (LEAST_SAMPLES * max(part.pitch_um)):.3g} per µm "
                "along an axis, may be artefacts of sampling."
            )

    def drawn(most: float | None) -> str:
        return _drawn(
            "png", _SQUARE + 0.8, _SQUARE,
            lambda ax: plot.power_spectrum(part, ax=ax, most_frequency=most, title=""),
        )  # fmt: skip

    return Figure("periods", tuple(map(drawn, limits)), alt, text)


def _orders(data: ReportData, efficiencies: OrderEfficiencies) -> Figure:
    errors = data.efficiency_errors
    uri = _drawn(
        "svg", _WIDE, 3.4, lambda ax: plot.orders(efficiencies, ax=ax, against="angle", errors=errors, title="")
    )
    caption = (
        "Efficiencies of the orders of the field as one period of a grating, at their angles."
        if data.is_cell or not data.periods
        else f"Efficiencies of the orders of the strongest period, {data.periods[0].period_um:.4g} µm, at their angles."
    )
    caption += " Bars are the error of scalar diffraction." if errors is not None else ""
    return Figure("orders", (uri,), "Efficiencies of the orders against their angles", caption)


def _exposure(luminances: NDArray[np.floating[Any]]) -> float:
    """Return the automatic exposure of luminances, rounded to two digits."""
    return float(f"{auto_exposure(luminances[luminances > 0.0], 'aces'):.2g}")


def _strips(data: ReportData) -> list[tuple[float, NDArray[np.float64], float]]:
    """Return the strips of colours against the view angle: σ of the coherence window [µm], XYZ, and exposure."""
    return [(sigma, xyz, _exposure(xyz[:, 1])) for sigma, xyz in data.colours.items()]


def _colours(data: ReportData) -> Figure:
    strips = _strips(data)
    sigma, xyz, exposure = strips[len(strips) // 2]
    strips.append((sigma, xyz, _BRIGHTER * exposure))

    def draw(axes: Any) -> None:
        for ax, (sigma, xyz, exposure) in zip(axes, strips, strict=True):
            plot.colour_strip(
                xyz, data.to_light, angles_deg=ANGLES_DEG, azimuth_deg=data.azimuth_deg, ax=ax, exposure=exposure,
                title=f"coherence window σ = {sigma:.3g} µm, exposure {exposure:g}",
            )  # fmt: skip
            ax.set_xticks(_TICKS_DEG)
        for ax in axes[:-1]:
            ax.set_xlabel("")

    uri = _drawn("png", _WIDE, 1.3 * len(strips) + 0.2, draw, rows=len(strips))
    caption = (
        f"Colour against the view angle in the plane at the azimuth {data.azimuth_deg:.1f}°, for coherence windows of "
        "different size. The exposure is the factor by which Y is multiplied. The last strip is "
        f"{_BRIGHTER:g} times as bright, so that weak orders are visible."
    )
    return Figure("colours", (uri,), "Colours against the view angle", caption)


def _map(data: ReportData, image: Image) -> Figure:
    # Orders are much brighter than the light between them. The first map has the exposure of the colours against the
    # view angle, which shows the colours of orders, and the second one shows the light between them.
    exposures = [_exposure(image.xyz[..., 1])]
    if strips := _strips(data):
        exposures.insert(0, strips[len(strips) // 2][2])
    coherence = EvaluationSettings(**data.request.settings).effective_coherence

    def at(exposure: float) -> str:
        title = f"exposure {exposure:g}"
        return _drawn(
            "png", _SQUARE, _SQUARE,
            lambda ax: plot.reflectance_map(image, data.to_light, ax=ax, exposure=exposure, title=title),
        )  # fmt: skip

    caption = (
        f"Colour of the reflectance in all view directions ({coherence}), for a light at {abs(data.light_deg):.3g}° "
        "from the normal. The centre is the normal of the surface, the rim the horizon. A circle marks the light, and "
        "a cross its mirror direction. The first picture has the exposure of the colours against the view angle."
    )
    return Figure("map", tuple(map(at, exposures)), "Colours of the reflectance over the hemisphere", caption)


def _comparison(comparison: CurveComparison) -> Figure:
    measured = comparison.measured
    is_spectrum = measured.against == "wavelength_nm"
    scaled = comparison.scale * comparison.computed

    def draw(ax: Any) -> None:
        if is_spectrum:
            plot.spectra(measured.positions, scaled, ax=ax, labels=["computed, scaled"], title="")
        else:
            ax.plot(measured.positions, scaled, label="computed, scaled", **line_style(0))
            ax.set_xlabel("view angle from the normal [°]")
            ax.margins(x=0.0)
            clean_grid(ax)
        style = {"fmt": "o", "color": line_style(1)["color"], "markersize": 3.5, "elinewidth": 1.0}
        ax.errorbar(measured.positions, measured.values, measured.errors, label="measured", **style)
        ax.set_ylabel(measured.name.replace("_", " "))
        ax.set_ylim(bottom=min(0.0, float(np.min(measured.values))), top=None)
        ax.autoscale(axis="y")
        ax.legend(frameon=False)

    uri = _drawn("svg", _WIDE, 3.6, draw)
    caption = (
        f"Measured values of {measured.path.name}, and the computed {comparison.what}, multiplied by the factor in the "
        "table."
    )
    return Figure("comparison", (uri,), "Measured and computed curve", caption)
