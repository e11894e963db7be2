"""Plots of height fields: map, profile and power spectrum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge, Gt

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.cleaning_methods import Axis  # noqa: TC001 (the decorator checks its instances)
from warpdiff.heightfield.field import HeightField  # noqa: TC001 (the decorator checks its instances)
from warpdiff.heightfield.spectral_lines import WindowedSpectrum
from warpdiff.plot.axes import (
    LINE_COLOURS,
    MISSING,
    add_colour_bar,
    add_scale_bar,
    axes_for,
    clean_grid,
    length_unit,
    map_size,
)
from warpdiff.request.signatures import checked

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from warpdiff.heightfield.periods import Period

# Fraction of a height field's total power that the plot of its power spectrum shows. Higher frequencies are cut off.
# The value was chosen because these frequencies contain only noise.
_SHOWN_POWER = 0.999
# The frequency axes in the plot of a power spectrum extend at least to this multiple of the highest frequency of the
# periods that the plot marks. The value is more than 1, so that these marks are not at the edge of the plot.
_AROUND_PERIODS = 1.4
# Lower end of the colour range in the plot of a power spectrum. At the fraction `_DARKEST` of all frequencies, the
# power is below this end and is drawn darkest. The end is at most `_POWER_RANGE` times the largest power.
_DARKEST, _POWER_RANGE = 0.3, 1e-2
# Smallest power on the power axis, relative to the largest power. It applies to the power spectrum of a height field
# that is constant along x or y, which is plotted as a line.
_LINE_RANGE = 1e-7
# A profile may be drawn below a map of heights. `_PROFILE` is the height of the profile, and `_GAP` the height of the
# gap between map and profile, both relative to the width of the map.
_PROFILE, _GAP = 0.3, 0.24
# Lower bound of a power density before its logarithm is drawn, which prevents a logarithm of 0.
_LEAST_POWER = 1e-30
# Mean slope to which the heights of a map are scaled before the map is shaded as a relief. The value was chosen because
# brightness saturates at slopes of about 1, the slope of the light's direction. If doubled, steep walls of grooves look
# as if they were even steeper.
_RELIEF_SLOPE = 0.5
# Marker shapes of matplotlib for the periods in a power spectrum, the strongest period first.
_MARKERS = "osD^vph*"


@checked
def height_map(
    heightfield: HeightField, *, ax: Axes | None = None, profile_along: Axis | None = None,
    at_um: float | None = None, is_shaded: bool = False, cmap: str = "cividis", title: str | None = None,
) -> Axes:  # fmt: skip
    """Plot the heights as a map with a scale bar and a colour bar, x to the right and y up.

    Heights are in nm, or in µm if their range is at least 1 µm. Missing samples are white.

    Args:
        heightfield: Height field.
        ax: Axes to draw into; None makes a figure.
        profile_along: Axis of a profile below the map, ``"x"`` or ``"y"``; None draws no profile. If you pass ``ax``,
            leave space below these axes, or draw :func:`warpdiff.plot.profile` into other axes.
        at_um: Position of the profile on the other axis [µm]; None is the middle.
        is_shaded: Whether the map is shaded as a relief in oblique light from the upper left. Slopes are exaggerated or
            reduced to a mean of 27°.
        cmap: Name of a colour map of matplotlib.
        title: Title; None states the size of the field.

    Returns:
        The axes of the map.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: ``at_um`` is outside of the field.

    Examples:
        >>> import warpdiff as wd
        >>> axes = wd.plot.height_map(wd.gratings.fingers(size_um=12.8), profile_along="x")
        >>> axes.get_title()
        'Heights, 12.8 × 12.8 µm'
    """
    unit, factor = length_unit(heightfield.height_range_um)
    line = None if profile_along is None else _Line.of(heightfield, profile_along, at_um)
    (ly, lx), (ny, nx) = heightfield.size_um, heightfield.shape
    # A field that is constant along an axis has only one sample along this axis. The map of heights shows such a field
    # as a band.
    is_band = min(ny, nx) == 1 < max(ny, nx)
    extent_y, extent_x = (lx / 4.0 if is_band and ny == 1 else ly), (ly / 4.0 if is_band and nx == 1 else lx)
    width, height = map_size(extent_y, extent_x)
    below = 0.0 if line is None else (_PROFILE + _GAP) * width + 0.4
    ax = axes_for(ax, width=max(width + 2.0, 3.6), height=height + below + 0.9)
    values = factor * np.ma.masked_invalid(heightfield.heights_um)
    picture = ax.imshow(
        values, cmap=_with_gaps(cmap), origin="lower", extent=(0.0, extent_x, 0.0, extent_y), interpolation="nearest",
        aspect="equal",
    )  # fmt: skip
    if is_shaded and min(ny, nx) > 1 and heightfield.mean_slope > 0.0:
        colours = _shaded(heightfield, np.asarray(picture.to_rgba(values)))
        ax.imshow(colours, origin="lower", extent=picture.get_extent(), interpolation="nearest")
    ax.set_xlabel("x [µm]" if nx > 1 or not is_band else "constant along x")
    ax.set_ylabel("y [µm]" if ny > 1 or not is_band else "constant along y")
    if is_band:
        (ax.set_yticks if ny == 1 else ax.set_xticks)([])
    gaps = int(np.count_nonzero(heightfield.missing))
    size = f"{lx:.3g} µm" if is_band and ny == 1 else f"{ly:.3g} µm" if is_band else f"{lx:.3g} × {ly:.3g} µm"
    ax.set_title(
        (f"Heights, {size}" + (f", {gaps} samples missing (white)" if gaps else "")) if title is None else title
    )
    add_colour_bar(ax, picture, f"height [{unit}]")
    if not is_band:
        add_scale_bar(ax, extent_x)
    if line is not None:
        _add_profile(ax, line, unit, factor, extent_x / extent_y)
    return ax


def _shaded(heightfield: HeightField, colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the RGBA colours (ny, nx, 4) of a height map, shaded as a relief; missing samples keep their colour."""
    from matplotlib.colors import LightSource

    dy, dx = heightfield.pitch_um
    lowest = float(np.nanmin(heightfield.heights_um))
    # matplotlib's ``LightSource`` assumes that the rows of a map run downwards. In a height map the rows run upwards,
    # so that the argument dy is negative.
    result = LightSource(azdeg=315.0, altdeg=45.0).shade_rgb(
        colours[..., :3], np.nan_to_num(heightfield.heights_um, nan=lowest), blend_mode="soft",
        vert_exag=_RELIEF_SLOPE / heightfield.mean_slope, dx=dx, dy=-dy,
    )  # fmt: skip
    return np.where(heightfield.missing[..., None], colours, np.dstack([result, colours[..., 3]]))


@checked
def profile(
    heightfield: HeightField, *, ax: Axes | None = None, along: Axis = "x", at_um: float | None = None,
    label: str | None = None, title: str | None = None,
) -> Axes:  # fmt: skip
    """Plot the heights along a line that is parallel to the x axis or the y axis.

    Calls with the same ``ax`` draw several profiles into one plot.

    Args:
        heightfield: Height field.
        ax: Axes to draw into; None makes a figure.
        along: Axis of the profile: ``"x"`` (a row of samples) or ``"y"`` (a column).
        at_um: Position of the profile on the other axis [µm]; None is the middle.
        label: Name of the line in the legend; None draws no legend.
        title: Title; None states the position.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: ``at_um`` is outside of the field.

    Examples:
        >>> import warpdiff as wd
        >>> axes = wd.plot.profile(wd.gratings.blazed(2.0, 0.2), label="blazed")
        >>> axes = wd.plot.profile(wd.gratings.sinusoidal(2.0, 0.2), ax=axes, label="sine")
        >>> axes.get_ylabel()
        'height [nm]'
    """
    line = _Line.of(heightfield, along, at_um)
    ax = axes_for(ax, width=6.4, height=3.2)
    # If the axes already show a profile, the new profile is drawn in the unit of the existing height axis.
    unit, factor = length_unit(heightfield.height_range_um)
    if ax.get_ylabel() in ("height [nm]", "height [µm]"):
        unit, factor = length_unit(0.0 if ax.get_ylabel() == "height [nm]" else 1.0)
    ax.plot(
        line.positions_um, factor * line.heights_um, color=LINE_COLOURS[len(ax.lines) % len(LINE_COLOURS)], label=label
    )
    ax.set_xlabel(f"{along} [µm]")
    ax.set_ylabel(f"height [{unit}]")
    ax.set_title(line.title if title is None else title)
    ax.margins(x=0.0)
    clean_grid(ax)
    if label:
        ax.legend(frameon=False)
    return ax


@checked
def power_spectrum(
    heightfield: HeightField, *, ax: Axes | None = None, count: Annotated[int, Ge(1)] = 3, cmap: str = "magma",
    most_frequency: Annotated[float, Gt(0.0)] | None = None, title: str | None = None,
) -> Axes:  # fmt: skip
    """Plot the power spectrum of the heights and mark the periods that :meth:`~warpdiff.HeightField.periods` finds.

    The field is levelled, missing samples are filled, and a Hann window is applied. For a field with several samples
    along both axes, the plot is a map of the power over both spatial frequencies; each period is marked at its
    frequency and at the opposite frequency. For a field that is constant along an axis, the power is drawn as a line.

    Args:
        heightfield: Height field.
        ax: Axes to draw into; None makes a figure.
        count: Largest number of periods that are marked, at least 1.
        cmap: Name of a colour map of matplotlib.
        most_frequency: Highest frequency on the axes of a map [1/µm]; None shows nearly all power, and all periods.
        title: Title; None states the number of periods.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.

    Examples:
        >>> import warpdiff as wd
        >>> axes = wd.plot.power_spectrum(wd.gratings.fingers(size_um=12.8))
        >>> axes.get_xlabel()
        'spatial frequency along x [1/µm]'
    """
    periods = heightfield.periods(count)
    levelled = heightfield.levelled(1)
    levelled = levelled.filled() if levelled.missing.any() else levelled
    spectrum = WindowedSpectrum(levelled.heights_um)
    density = spectrum.power * float(
        np.prod([p for n, p in zip(levelled.shape, levelled.pitch_um, strict=True) if n > 1])
    )
    frequencies = [
        np.fft.fftshift(np.fft.fftfreq(n, pitch))
        for n, pitch in zip(levelled.shape, levelled.pitch_um, strict=True)
    ]  # fmt: skip
    name = f"{len(periods)} period{'s' * (len(periods) > 1)} marked" if periods else "no period"
    if min(levelled.shape) > 1:
        ax = axes_for(ax, width=6.0, height=5.0)
        _draw_plane(ax, density, frequencies, periods, cmap, most_frequency)
    else:
        ax = axes_for(ax, width=6.4, height=3.6)
        axis = int(levelled.shape[1] > 1)
        _draw_line(ax, density.ravel(), frequencies[axis], periods, "yx"[axis])
    ax.set_title(f"Power spectrum, {name}" if title is None else title)
    if periods:
        # The legend is below the axes, because marks of periods may be anywhere in the spectrum.
        ax.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False, fontsize="small", markerscale=0.6
        )
    return ax


def _draw_plane(
    ax: Axes, density: NDArray[np.float64], frequencies: list[NDArray[np.float64]], periods: tuple[Period, ...],
    cmap: str, most_frequency: float | None,
) -> None:  # fmt: skip
    """Draw the power spectrum of a field with several samples along both axes as a map, and mark the periods."""
    from matplotlib.colors import LogNorm

    fy, fx = frequencies
    half = [0.5 * (f[1] - f[0]) for f in frequencies]
    radius = np.hypot(fy[:, None], fx[None, :]).ravel()
    order = np.argsort(radius)
    shares = np.cumsum(density.ravel()[order])
    limit = float(radius[order][min(np.searchsorted(shares, _SHOWN_POWER * shares[-1]), len(order) - 1)])
    limit = max(limit, _AROUND_PERIODS * max((np.hypot(*period.frequency) for period in periods), default=0.0))
    if most_frequency is not None:
        limit = most_frequency
    if not limit > 0.0:
        # The spectrum of a flat field has no power. The axes of its plot extend to the highest frequency of the
        # samples.
        limit = float(radius[order][-1])
    shown = density.ravel()[radius <= limit]
    most = max(float(shown.max()), _LEAST_POWER)
    least = min(max(float(np.quantile(shown, _DARKEST)), _LEAST_POWER), _POWER_RANGE * most)
    picture = ax.imshow(
        np.maximum(density, least), origin="lower", cmap=cmap, norm=LogNorm(least, most), interpolation="nearest",
        extent=(fx[0] - half[1], fx[-1] + half[1], fy[0] - half[0], fy[-1] + half[0]),
    )  # fmt: skip
    # Both axes of the map of the power spectrum show the same range of frequencies. If the highest frequency of the
    # samples along an axis is within this range, the axis ends at this frequency.
    for set_limits, f, step in ((ax.set_xlim, fx, half[1]), (ax.set_ylim, fy, half[0])):
        edge = min(limit, float(step - f[0]))
        set_limits(-edge, edge)
    for index, period in enumerate(periods):
        qy, qx = period.frequency
        ax.plot(
            [qx, -qx], [qy, -qy], linestyle="", marker=_MARKERS[index % len(_MARKERS)], markersize=13.0,
            markerfacecolor="none", markeredgecolor="#56B4E9", markeredgewidth=1.8, label=_words(period),
        )  # fmt: skip
    ax.set_facecolor("black")
    ax.set_xlabel("spatial frequency along x [1/µm]")
    ax.set_ylabel("spatial frequency along y [1/µm]")
    add_colour_bar(ax, picture, "power spectral density [µm⁴]", extend="min")


def _words(period: Period) -> str:
    return f"period {period}"


def _draw_line(
    ax: Axes, density: NDArray[np.float64], frequencies: NDArray[np.float64], periods: tuple[Period, ...], axis: str
) -> None:
    """Draw the power spectrum of a field that is constant along x or y: a line plot with marks of the periods."""
    positive = frequencies > 0.0
    # The power at negative frequencies equals the power at positive frequencies. The plotted line is therefore twice
    # the density at positive frequencies, which integrates to the variance of the heights.
    ax.loglog(frequencies[positive], 2.0 * np.maximum(density[positive], _LEAST_POWER), color=LINE_COLOURS[0])
    for index, period in enumerate(periods):
        ax.axvline(
            float(np.hypot(*period.frequency)), color=LINE_COLOURS[1 + index], linestyle="--", label=_words(period)
        )
    top = 2.0 * max(float(density.max()), _LEAST_POWER)
    ax.set_ylim(_LINE_RANGE * top, 3.0 * top)
    ax.margins(x=0.0)
    clean_grid(ax)
    ax.set_xlabel(f"spatial frequency along {axis} [1/µm]")
    ax.set_ylabel("power spectral density [µm³]")


class _Line:
    """Profile of a height field along a line that is parallel to the x axis or the y axis.

    Attributes:
        along: Axis of the profile, ``"x"`` or ``"y"``.
        positions_um: Positions of the samples on the axis ``along`` [µm], shape (n,).
        heights_um: Heights [µm], shape (n,); NaN where a sample is missing.
        at_um: Position of the line on the other axis [µm]; None if the field is constant along the other axis.
    """

    def __init__(
        self, along: Axis, positions_um: NDArray[np.float64], heights_um: NDArray[np.float64], at_um: float | None
    ) -> None:
        self.along, self.positions_um, self.heights_um, self.at_um = along, positions_um, heights_um, at_um

    @classmethod
    def of(cls, heightfield: HeightField, along: Axis, at_um: float | None) -> _Line:
        """Return the profile through the samples nearest to ``at_um`` on the other axis [µm]; None is the middle."""
        other = 0 if along == "x" else 1
        count, pitch = heightfield.shape[other], heightfield.pitch_um[other]
        size = heightfield.size_um[other]
        if at_um is not None and not 0.0 <= validation.number(at_um, "at_um") <= size:
            raise ArgumentValueError(f"{ref('at_um')} must be 0 to {size:.4g}, the size of the field, got {at_um:g}")
        index = count // 2 if at_um is None else min(round(at_um / pitch), count - 1)
        heights = heightfield.heights_um[index] if other == 0 else heightfield.heights_um[:, index]
        positions = heightfield.pitch_um[1 - other] * np.arange(len(heights), dtype=np.float64)
        return cls(along, positions, heights, index * pitch if count > 1 else None)

    @property
    def title(self) -> str:
        """Title of a plot of the profile."""
        other = "y" if self.along == "x" else "x"
        return f"Profile along {self.along}" + ("" if self.at_um is None else f" at {other} = {self.at_um:.3g} µm")


def _add_profile(ax: Axes, line: _Line, unit: str, factor: float, ratio: float) -> None:
    """Draw a profile below a map, and the profile's line into the map; ``ratio`` is the map's width over its height."""
    if line.at_um is not None:
        draw = ax.axhline if line.along == "x" else ax.axvline
        draw(line.at_um, color="white", linewidth=2.4)
        draw(line.at_um, color="black", linewidth=1.2, linestyle="--")
    below = ax.inset_axes((0.0, -(_PROFILE + _GAP) * ratio, 1.0, _PROFILE * ratio))
    below.plot(line.positions_um, factor * line.heights_um, color=LINE_COLOURS[0])
    below.set_xlim(ax.get_xlim() if line.along == "x" else ax.get_ylim())
    below.set_xlabel(f"{line.along} [µm]")
    below.set_ylabel(f"height [{unit}]")
    below.set_title(line.title, fontsize="medium")
    clean_grid(below)


def _with_gaps(cmap: str) -> Any:
    """Return matplotlib's colour map of this name, with white for missing samples."""
    import matplotlib as mpl

    if cmap not in mpl.colormaps:
        raise ArgumentValueError(f"{ref('cmap')} must be the name of a colour map of matplotlib, got {cmap!r}")
    return mpl.colormaps[cmap].with_extremes(bad=MISSING)
