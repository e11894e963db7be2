"""Pictures of a report as data URIs, drawn by ``warpdiff.plot``: maps are PNG pictures, curves are SVG pictures."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from warpdiff import plot
from warpdiff.apps.report.report_data import ANGLES_DEG
from warpdiff.heightfield.field import HeightField
from warpdiff.plot.axes import clean_grid, line_style

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.apps.report.measured_curve import CurveComparison
    from warpdiff.apps.report.report_data import ReportData
    from warpdiff.evaluate.orders import OrderEfficiencies
    from warpdiff.image.image import Image

# Resolution of PNG pictures [dots per inch]. Limit: a page has a few megabytes. If doubled, it has four times as many.
_DPI = 150
# Largest number of samples along an axis of a height map; larger fields are thinned. Limit: at 150 dots per inch, more
# samples are not visible.
_MOST_DRAWN = 1400
# Width of pictures of curves, and of pictures of maps [inches].
_WIDE, _SQUARE = 8.6, 5.4
# Azimuth of a wave vector, without its sign, above which it is nearer to the y axis than to the x axis [degrees].
_NEARER_TO_Y_DEG = 45.0


class Figure(NamedTuple):
    """Picture of the web page of a report.

    Attributes:
        name: Name of the result that the picture shows.
        uri: Picture as a data URI.
        alt: Description of the picture, for readers who cannot see it.
        caption: Text below the picture.
        is_wide: Whether the picture takes the whole width of the page.
    """

    name: str
    uri: str
    alt: str
    caption: str
    is_wide: bool = True


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
    """Call ``draw`` with new axes, or with an array of axes for several rows, and return the picture as a data URI."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    # The figure is not created by pyplot, so that the caller's current figure stays the same. With a fixed salt, the
    # names of elements in an SVG picture are the same in each run.
    style = {"font.family": "DejaVu Sans", "font.size": 9.5, "axes.titlesize": 10.5, "svg.hashsalt": "warpdiff"}
    with mpl.rc_context(style):
        # A single plot needs no automatic layout, because its empty margins are cut off when it is saved.
        canvas = Canvas(figsize=(width, height), dpi=_DPI, layout="constrained" if rows > 1 else None)
        draw(canvas.subplots(rows, 1))
        stream = io.BytesIO()
        metadata = {"Date": None} if kind == "svg" else {"Software": None}
        canvas.savefig(stream, format=kind, metadata=metadata, bbox_inches="tight", pad_inches=0.05)
    mime = "image/png" if kind == "png" else "image/svg+xml"
    return f"data:{mime};base64,{base64.b64encode(stream.getvalue()).decode()}"


def _thinned(heightfield: HeightField) -> HeightField:
    """Return a field for the height map, with every n-th sample if there are more than are visible."""
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
    profile = along if min(ny, nx) > 1 else None
    # A field of one row or one column is drawn as a curve.
    uri = (
        _drawn("svg", _WIDE, 2.6, lambda ax: plot.profile(field, ax=ax, along=along))
        if profile is None
        else _drawn(
            "png",
            *_map_size(field),
            lambda ax: plot.height_map(_thinned(field), ax=ax, profile_along=profile, is_shaded=True),
        )
    )
    caption = "Heights of the field" + (
        f", constant along {'y' if along == 'x' else 'x'}."
        if profile is None
        else ", shaded as a relief in light from the upper left, and a profile along "
        f"{along} at the dashed line. Row 0 of the field is at y = 0, at the bottom."
    )
    return Figure("surface", uri, "Map of the heights, and a profile", caption, is_wide=profile is None)


def _map_size(field: HeightField) -> tuple[float, float]:
    """Return width and height of the figure of a height map [inches], from the sides of the field."""
    ratio = min(max(field.size_um[0] / field.size_um[1], 0.25), 1.5)
    return _SQUARE + 0.4, 0.85 * _SQUARE * ratio + 0.6


def _spectrum(data: ReportData) -> Figure:
    part = data.part
    is_plane = min(part.shape) > 1
    uri = _drawn(
        "png" if is_plane else "svg", _SQUARE + 0.8 if is_plane else _WIDE, _SQUARE if is_plane else 3.3,
        lambda ax: plot.power_spectrum(part, ax=ax),
    )  # fmt: skip
    caption = "Power spectral density of the levelled heights with a Hann window." + (
        " Marks show the periods of the table, at their frequency and at the opposite frequency."
        if data.periods
        else ""
    )
    return Figure("periods", uri, "Power spectrum of the heights", caption, is_wide=not is_plane)


def _orders(data: ReportData, efficiencies: OrderEfficiencies) -> Figure:
    uri = _drawn("svg", _WIDE, 3.0, lambda ax: plot.orders(efficiencies, ax=ax, against="angle", title=""))
    caption = (
        "Efficiencies of the orders of the field as one period of a grating, at their angles."
        if data.is_cell or not data.periods
        else f"Efficiencies of the orders of the strongest period, {data.periods[0].period_um:.4g} µm, at their angles."
    )
    return Figure("orders", uri, "Efficiencies of the orders against their angles", caption)


def _colours(data: ReportData) -> Figure:
    def draw(axes: Any) -> None:
        strips = np.atleast_1d(axes)
        for ax, (sigma, xyz) in zip(strips, data.colours.items(), strict=True):
            plot.colour_strip(
                xyz, data.to_light, angles_deg=ANGLES_DEG, azimuth_deg=data.azimuth_deg, ax=ax,
                title=f"coherence window σ = {sigma:g} µm",
            )  # fmt: skip
        for ax in strips[:-1]:
            ax.set_xlabel("")

    count = len(data.colours)
    uri = _drawn("png", _WIDE, 1.25 * count + 0.2, draw, rows=count)
    caption = (
        f"Colour against the view angle in the plane at the azimuth {data.azimuth_deg:.1f}°, for coherence windows of "
        "different size. The exposure of each strip is automatic, so that strips show hues and not brightness."
    )
    return Figure("colours", uri, "Colours against the view angle", caption)


def _map(data: ReportData, image: Image) -> Figure:
    uri = _drawn(
        "png", _SQUARE, _SQUARE, lambda ax: plot.reflectance_map(image, data.to_light, ax=ax, title="")
    )  # fmt: skip
    caption = (
        "Colour of the reflectance in all view directions, for a light at "
        f"{abs(data.light_deg):.3g}° from the normal. The centre is the normal of the surface, the rim the horizon."
    )
    return Figure("map", uri, "Colours of the reflectance over the hemisphere", caption, is_wide=False)


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
    return Figure("comparison", uri, "Measured and computed curve", caption)
