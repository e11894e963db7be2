"""Plots against the wavelength or an angle: efficiencies of orders, and reflectance spectra."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Ge

from warpdiff.core import validation
from warpdiff.core.angles import signed_angles_deg
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref, renaming
from warpdiff.evaluate.orders import OrderEfficiencies  # noqa: TC001 (the decorator checks its instances)
from warpdiff.evaluate.reflectance_spectra import ReflectanceSpectra
from warpdiff.optics import colorimetry
from warpdiff.plot.axes import LINE_COLOURS, axes_for, clean_grid, line_style, start_at_zero
from warpdiff.request.signatures import checked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

# Maximum luminance of the colour of a line, relative to the white background. The value is derived from the minimum
# contrast of 3 that WCAG 2 requires of graphics. WCAG 2 adds 0.05 to both luminances of a contrast, so that the
# contrast is at least (1 + 0.05)/(0.3 + 0.05) = 3.
_LINE_LUMINANCE = 0.3
# A band below the wavelength axis shows the colour of each wavelength. `_BAND_HEIGHT` is the height of the band
# relative to the height of the plot, and `_BAND_COLOURS` the number of colours in the band.
_BAND_HEIGHT, _BAND_COLOURS = 0.03, 256
# Least divisor by which an RGB colour is divided to normalise it, which prevents a division by zero for black.
_LEAST_RGB = 1e-9
# Maximum number of diffraction orders that a plot against the view angle labels with their numbers. The value is
# limited by space: more labels overlap.
_MOST_NAMED = 25
Against = Literal["wavelength", "angle", "incidence"]


@checked
def orders(
    efficiencies: OrderEfficiencies, *, ax: Axes | None = None, against: Against | None = None,
    count: Annotated[int, Ge(1)] = 7, errors: ArrayLike | None = None, title: str | None = None,
) -> Axes:  # fmt: skip
    """Plot the efficiencies of diffraction orders against the wavelength, the view angle or the incidence.

    Args:
        efficiencies: Result of :func:`warpdiff.order_efficiencies`.
        ax: Axes to draw into; None makes a figure.
        against: ``"wavelength"`` draws a line per order. ``"angle"`` draws each order at the angle at which it leaves
            the surface, with a colour per wavelength. ``"incidence"`` draws a line per order over the angle of the
            light, for several lights. None selects ``"incidence"`` for several lights, ``"wavelength"`` for one light
            and several wavelengths, and ``"angle"`` for one light and one wavelength.
        count: Number of orders that are drawn as lines, at least 1; the strongest orders are drawn.
        errors: Error of the efficiencies at each wavelength, shape (m,), drawn as bars if ``against`` is ``"angle"``;
            None draws no bars.
        title: Title; None names the plotted quantity and, for a single wavelength, the wavelength.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: ``against`` does not suit the result: ``"incidence"`` requires several lights and one wavelength;
            ``"wavelength"`` and ``"angle"`` require one light. The error is also raised if ``errors`` does not have one
            number per wavelength.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.blazed(2.5, 0.25)
        >>> result = wd.order_efficiencies(grating, (0, 0, 1), np.linspace(400.0, 700.0, 31))
        >>> axes = wd.plot.orders(result)
        >>> axes.get_xlabel()
        'wavelength [nm]'
    """
    has_lights = efficiencies.to_light.ndim > 1
    if against is None:
        against = "incidence" if has_lights else "wavelength" if len(efficiencies.wavelengths_nm) > 1 else "angle"
    if has_lights != (against == "incidence"):
        number, shape = ("one light", "(3,)") if has_lights else ("several lights", "(k, 3)")
        raise ArgumentValueError(
            f"{ref('against', against)} requires the efficiencies for {number}, got an array of shape "
            f"{efficiencies.efficiencies.shape}: compute them with {ref('to_light')} of shape {shape}"
        )
    if against == "incidence" and len(efficiencies.wavelengths_nm) > 1:
        raise ArgumentValueError(
            f"{ref('against', against)} requires one wavelength, got {len(efficiencies.wavelengths_nm)}: compute the "
            "efficiencies for one wavelength"
        )
    bars = None if errors is None else validation.finite_array(errors, "errors", most=validation.MOST)
    if bars is not None and (bars.shape != efficiencies.wavelengths_nm.shape or bars.min() < 0.0):
        raise ArgumentValueError(
            f"{ref('errors')} must have the shape {efficiencies.wavelengths_nm.shape}, one number of at least 0 per "
            f"wavelength, got {errors!r:.60}"
        )
    ax = axes_for(ax, width=6.4, height=4.0)
    if against == "wavelength":
        text = _draw_over_wavelengths(ax, efficiencies, count)
    elif against == "incidence":
        text = _draw_over_incidence(ax, efficiencies, count)
    else:
        text = _draw_over_angles(ax, efficiencies, bars)
    ax.set_ylabel("efficiency [% of the incident power]")
    start_at_zero(ax)
    ax.set_title(text if title is None else title)
    clean_grid(ax)
    return ax


@checked
def spectra(
    source: ReflectanceSpectra | ArrayLike, values: ArrayLike | None = None, *, ax: Axes | None = None,
    labels: Sequence[str] | None = None, title: str | None = None,
) -> Axes:  # fmt: skip
    """Plot reflectance spectra against the wavelength; a band below the axis shows the colours of visible wavelengths.

    Args:
        source: Result of :func:`warpdiff.reflectance_spectra`, or wavelengths [nm], shape (m,).
        values: Reflectances at these wavelengths, shape (m,) or (n, m); None if ``source`` is a result.
        ax: Axes to draw into; None makes a figure.
        labels: Names of the n spectra in the legend; None states the view angles of a result.
        title: Title; None is "Reflectance spectra", or "Reflectance spectrum".

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: The shapes of the arguments differ.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.2, samples=128)
        >>> to_view = [(0.2, 0, 1), (0.25, 0, 1)]
        >>> spectra = wd.reflectance_spectra(grating, (0, 0, 1), to_view, np.arange(300.0, 701.0, 5.0))
        >>> wd.plot.spectra(spectra).get_ylabel()
        'relative reflectance'
    """
    if isinstance(source, ReflectanceSpectra):
        if values is not None:
            raise ArgumentValueError(f"{ref('values')} are part of the result, got both: remove {ref('values')}")
        wavelengths, rows = source.wavelengths_nm, source.values
        if labels is None and len(rows) > 1:
            labels = [f"view at {angle:.3g}°" for angle in signed_angles_deg(source.to_view)]
    else:
        if values is None:
            raise ArgumentTypeError(
                f"{ref('source')} must be the result of reflectance_spectra, or wavelengths with {ref('values')}, got "
                f"{type(source).__name__} alone"
            )
        with renaming({"wavelengths_nm": "source"}):
            wavelengths = colorimetry.check_wavelengths(source)
        rows = np.atleast_2d(validation.finite_array(values, "values"))
    if rows.ndim != 2 or rows.shape[1] != len(wavelengths):
        raise ArgumentValueError(
            f"{ref('values')} must have the shape ({len(wavelengths)},) or (n, {len(wavelengths)}), got {rows.shape}"
        )
    if labels is not None and not (
        validation.is_sequence(labels) and len(labels) == len(rows) and all(isinstance(label, str) for label in labels)
    ):
        raise ArgumentValueError(f"{ref('labels')} must be {len(rows)} strings, one per spectrum, got {labels!r:.60}")
    ax = axes_for(ax, width=6.4, height=4.0)
    order = np.argsort(wavelengths)
    for index, row in enumerate(rows):
        ax.plot(
            wavelengths[order], row[order], label=None if labels is None else labels[index],
            **line_style(len(ax.lines)),
        )  # fmt: skip
    ax.set_xlabel("wavelength [nm]")
    ax.set_ylabel("relative reflectance")
    ax.margins(x=0.0)
    start_at_zero(ax)
    name = "Reflectance spectra" if len(rows) > 1 else "Reflectance spectrum"
    ax.set_title(name if title is None else title)
    clean_grid(ax)
    _add_colours(ax)
    if labels is not None:
        ax.legend(frameon=False)
    return ax


def _add_colours(ax: Axes) -> None:
    """Add a band that shows the colour of each visible wavelength, below the axis of a plot against the wavelength."""
    (low, high), ends = ax.get_xlim(), ax.get_ylim()
    first, last = max(low, colorimetry.LAMBDA_MIN_NM), min(high, colorimetry.LAMBDA_MAX_NM)
    if first >= last:
        return
    wavelengths = np.linspace(first, last, _BAND_COLOURS)
    rgb = _spectral_rgb(wavelengths)
    # The largest component of a colour is small at the ends of the visible range. Each colour is divided by the square
    # root of this component. Dark colours become brighter, so that the band fades to black slowly.
    colours = colorimetry.srgb_encode(rgb / np.sqrt(np.maximum(rgb.max(axis=1, keepdims=True), _LEAST_RGB)))
    ax.imshow(
        colours[None], extent=(first, last, -_BAND_HEIGHT, 0.0), transform=ax.get_xaxis_transform(), aspect="auto",
        clip_on=False, interpolation="bilinear", zorder=3,
    )  # fmt: skip
    ax.set_xlim(low, high)
    ax.set_ylim(ends)
    ax.tick_params(axis="x", length=0.0, pad=10.0)


def _draw_over_wavelengths(ax: Axes, result: OrderEfficiencies, count: int) -> str:
    """Draw a line for each of the strongest orders against the wavelength; return the title of the plot."""
    _draw_lines(ax, result, result.wavelengths_nm, result.efficiencies, result.to_view[..., 0], count)
    ax.set_xlabel("wavelength [nm]")
    _add_colours(ax)
    return f"Efficiency of the orders{_of_all(result, count)}"


def _draw_over_incidence(ax: Axes, result: OrderEfficiencies, count: int) -> str:
    """Draw a line for each of the strongest orders against the angle of the light; return the title of the plot."""
    angles = signed_angles_deg(result.to_light)
    _draw_lines(ax, result, angles, result.efficiencies[:, 0], result.to_view[:, 0, :, 0], count)
    ax.set_xlabel("angle of the light from the normal [°], negative towards −x")
    return f"Efficiency of the orders at {result.wavelengths_nm[0]:g} nm{_of_all(result, count)}"


def _draw_lines(
    ax: Axes, result: OrderEfficiencies, positions: NDArray[np.float64], efficiencies: NDArray[np.float64],
    components: NDArray[np.float64], count: int,
) -> None:  # fmt: skip
    """Draw a line for each of the strongest orders, and a legend.

    Args:
        ax: Axes to draw into.
        result: Order efficiencies, with the numbers of the orders.
        positions: Wavelengths or angles, shape (m,).
        efficiencies: Efficiencies of n orders, shape (m, n).
        components: x component of the direction of each order, shape (m, n); NaN where an order is evanescent.
        count: Number of lines.
    """
    strongest = np.argsort(-efficiencies.max(axis=0), kind="stable")[:count]
    order = np.argsort(positions)
    values = 100.0 * np.where(np.isnan(components), np.nan, efficiencies)
    # In the legend, the orders are sorted by their numbers, not by their efficiencies.
    for index, column in enumerate(sorted(strongest.tolist())):
        marker = "o" if len(order) < 3 else None
        ax.plot(
            positions[order], values[order, column], label=_name(result, column), marker=marker, **line_style(index)
        )
    ax.margins(x=0.0)
    kind = "order (y, x)" if result.orders.any(axis=0).all() else "order"
    ax.legend(title=kind, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _of_all(result: OrderEfficiencies, count: int) -> str:
    """Return the end of a plot's title, which states how many diffraction orders are drawn; empty if all are drawn."""
    total = len(result.orders)
    return f", the {count} strongest of {total}" if total > count else ""


def _draw_over_angles(ax: Axes, result: OrderEfficiencies, errors: NDArray[np.float64] | None) -> str:
    """Draw each order at its angle from the normal, in the colour of its wavelength; return the title of the plot."""
    many = len(result.wavelengths_nm) > len(LINE_COLOURS)
    is_named = np.count_nonzero(~np.isnan(result.to_view[..., 0])) <= _MOST_NAMED
    for row in np.argsort(result.wavelengths_nm).tolist():
        wavelength = float(result.wavelengths_nm[row])
        live = ~np.isnan(result.to_view[row, :, 0])
        angles = signed_angles_deg(result.to_view[row, live])
        values = 100.0 * result.efficiencies[row, live]
        colour = wavelength_colour(wavelength)
        ax.vlines(angles, 0.0, values, color=colour, linewidth=1.6)
        ax.plot(angles, values, "o", color=colour, markersize=5.0, label=None if many else f"{wavelength:g} nm")
        bar = 0.0 if errors is None else 100.0 * float(errors[row])
        if errors is not None:
            ax.errorbar(angles, values, bar, fmt="none", ecolor=colour, elinewidth=0.8, capsize=3.0)
        if is_named:
            for column, angle, value in zip(np.flatnonzero(live).tolist(), angles, values, strict=True):
                ax.annotate(
                    _name(result, column), (angle, value + bar), xytext=(0, 4), textcoords="offset points", ha="center",
                    fontsize="small", color="black" if len(result.wavelengths_nm) == 1 else colour,
                )  # fmt: skip
    ax.set_xlabel("angle of the order from the normal [°], negative towards −x")
    ax.set_xlim(-90.0, 90.0)
    ax.set_xticks(range(-90, 91, 30))
    ax.margins(y=0.12)
    if not many and len(result.wavelengths_nm) > 1:
        ax.legend(frameon=False)
    if len(result.wavelengths_nm) == 1:
        return f"Orders at {result.wavelengths_nm[0]:g} nm"
    return "Orders at their angles"


def _name(result: OrderEfficiencies, column: int) -> str:
    """Return the label of an order: its number, or the pair (m_y, m_x) if there are orders along both axes."""
    m_y, m_x = result.orders[column].tolist()
    both = np.asarray(result.orders.any(axis=0))
    if both.all():
        return f"({m_y}, {m_x})".replace("-", "−")
    return f"{m_y if both[0] else m_x:+d}".replace("-", "−") if (m_y or m_x) else "0"


def wavelength_colour(wavelength_nm: float) -> NDArray[np.float64]:
    """Return a colour for a wavelength that is dark enough for a line on white; grey for invisible wavelengths."""
    if not colorimetry.LAMBDA_MIN_NM <= wavelength_nm <= colorimetry.LAMBDA_MAX_NM:
        return np.full(3, 0.45)
    (rgb,) = _spectral_rgb(np.array([wavelength_nm]))
    luminance = float(colorimetry.rgb_to_xyz(rgb)[1])
    return colorimetry.srgb_encode(rgb * min(1.0 / rgb.max(), _LINE_LUMINANCE / luminance))


def _spectral_rgb(wavelengths_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear sRGB colours of m visible wavelengths, shape (m, 3), limited to components from 0 to 1."""
    rgb = np.clip(colorimetry.xyz_to_rgb(colorimetry.colour_products("D65")), 0.0, None)
    return np.stack([np.interp(wavelengths_nm, colorimetry.VISIBLE_NM, channel) for channel in (rgb / rgb.max()).T], 1)
