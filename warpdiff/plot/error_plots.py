"""Plots of errors: the estimated error of each pixel, and the predicted errors and the cost of a plan.

A plan states how colours are computed: the method, the number of wavelengths, the number of series terms and so on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Gt

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.image.image import Image  # noqa: TC001 (the decorator checks its instances)
from warpdiff.plot.axes import FAINT, LINE_COLOURS, add_colour_bar, axes_for, map_size
from warpdiff.request.plan import Plan  # noqa: TC001 (the decorator checks its instances)
from warpdiff.request.signatures import checked

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The colours of an error image range from the tolerance divided by this number to the tolerance times this number. The
# value was chosen. If doubled, more errors have different colours, but errors near the tolerance are harder to
# distinguish.
_ERROR_RANGE = 30.0
# Start of the logarithmic error axis in the plot of the errors that a plan (numbers of a computation) predicts,
# relative to the tolerance. Smaller errors have bars of length 0.
_LEAST_BAR = 1e-4


@checked
def error_image(
    image: Image, *, ax: Axes | None = None, tolerance: Annotated[float, Gt(0.0)] | None = None,
    title: str | None = None,
) -> Axes:  # fmt: skip
    """Plot the estimated relative error of each pixel, with the tolerance in the middle of the colours.

    Pixels that meet the tolerance are blue and purple, and the other pixels are orange. The background and pixels
    without light are grey.

    Args:
        image: Picture of :func:`warpdiff.shade`, :class:`warpdiff.Renderer` or :func:`warpdiff.reflectance_map`.
        ax: Axes to draw into; None makes a figure.
        tolerance: Tolerance to mark; None is the tolerance with which the picture was computed.
        title: Title; None states the percentage of pixels that meet the tolerance.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.
        ValueError: ``tolerance`` is missing for a picture from a file.

    Examples:
        >>> import warpdiff as wd
        >>> picture = wd.reflectance_map(wd.gratings.sinusoidal(2.0, 0.1), (0, 0, 1), size=32)
        >>> wd.plot.error_image(picture).get_title()
        'Estimated error: 100 % of the pixels meet the tolerance of 0.01'
    """
    if tolerance is None:
        if image.report is None:
            raise ArgumentValueError(
                f"{ref('tolerance')} is required for a picture from a file, got None: give the tolerance to mark"
            )
        tolerance = image.report.tolerance
    tolerance = validation.positive(tolerance, "tolerance")
    rows, columns = image.mask.shape
    width, height = map_size(rows, columns)
    ax = axes_for(ax, width=1.25 * width + 2.0, height=1.25 * height + 0.9)
    from matplotlib.colors import LogNorm

    shown = np.ma.masked_where(~image.illuminated, np.maximum(image.error, 1e-30))
    picture = ax.imshow(
        shown, cmap="PuOr_r", norm=LogNorm(tolerance / _ERROR_RANGE, tolerance * _ERROR_RANGE),
        interpolation="nearest",
    )  # fmt: skip
    ax.set_facecolor(FAINT)
    ax.set_xlabel("column of pixels")
    ax.set_ylabel("row of pixels")
    bar = add_colour_bar(ax, picture, "estimated relative error", extend="both")
    bar.ax.axhline(tolerance, color="black", linewidth=1.6)
    bar.ax.annotate(
        f"tolerance {tolerance:g}", (0.5, tolerance), xycoords=("axes fraction", "data"), xytext=(0, 3),
        textcoords="offset points", ha="center", va="bottom", rotation=90.0, fontsize="small",
    )  # fmt: skip
    errors = image.error[image.illuminated]
    share = 100.0 * float(np.mean(errors <= tolerance)) if errors.size else 100.0
    text = f"Estimated error: {share:.3g} % of the pixels meet the tolerance of {tolerance:g}"
    ax.set_title(text if title is None else title)
    return ax


@checked
def plan(plan: Plan, *, ax: Axes | None = None, title: str | None = None) -> Axes:
    """Plot the errors that a plan predicts, by their source; a line marks the tolerance, the title states the cost.

    A plan states how colours are computed: the method, the number of wavelengths, the number of series terms and so on.

    Args:
        plan: Plan, for example of :func:`warpdiff.plan` or ``image.plan``.
        ax: Axes to draw into; None makes a figure.
        title: Title; None states whether the plan meets its tolerance, and how long the computation takes.

    Returns:
        The axes.

    Raises:
        ImportError: matplotlib is not installed.

    Examples:
        >>> import warpdiff as wd
        >>> axes = wd.plot.plan(wd.plan(wd.gratings.sinusoidal(2.0, 0.1)))
        >>> axes.get_xlabel()
        'predicted relative error of the colour'
    """
    ax = axes_for(ax, width=6.4, height=3.2)
    errors = plan.predicted_errors | {"total": plan.error}
    names, values = list(errors)[::-1], list(errors.values())[::-1]
    least = _LEAST_BAR * plan.tolerance
    colours = [LINE_COLOURS[0] if name != "total" else "0.25" for name in names]
    ax.barh(names, [max(value, least) for value in values], left=None, color=colours, height=0.62)
    ax.set_xscale("log")
    most = max(2.0 * plan.tolerance, 2.0 * plan.error)
    ax.set_xlim(least, most * 3.0)
    for index, value in enumerate(values):
        text = f"{value:.1e}" if value > 0.0 else "0"
        ax.annotate(
            text, (max(value, least), index), xytext=(5, 0), textcoords="offset points", va="center", fontsize="small",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip
    ax.axvline(plan.tolerance, zorder=0.9, color=LINE_COLOURS[1], linewidth=1.8, linestyle="--")
    ax.annotate(
        f"tolerance {plan.tolerance:g}", (plan.tolerance, 1.0), xycoords=ax.get_xaxis_transform(), xytext=(4, -2),
        textcoords="offset points", color=LINE_COLOURS[1], va="top", fontsize="small",
    )  # fmt: skip
    ax.set_xlabel("predicted relative error of the colour")
    ax.grid(axis="x", color=FAINT, linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    ax.set_title(_summary(plan) if title is None else title, fontsize="medium")
    return ax


def _summary(plan: Plan) -> str:
    """Return the title for the plot of a plan: method, computing time, and whether it meets its tolerance.

    A plan states how colours are computed, for example with how many wavelengths.
    """
    meets = "meets" if plan.error <= plan.tolerance or plan.method == "direct" else "does not meet"
    terms = "" if plan.method == "direct" else f", {plan.terms} terms"
    table = f", table {_seconds(plan.table_seconds)}" if plan.table_seconds > 0.0 else ""
    cost = f"{_seconds(1e-6 * plan.microseconds)} per direction on one core{table}"
    return f"The plan {meets} its tolerance of {plan.tolerance:g}\n{plan.method}{terms}: {cost}"


def _seconds(value: float) -> str:
    """Return a time in seconds as a text with two significant digits, in s, ms, µs or ns."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{float(f'{value / size:.2g}'):g} {unit}"
    return f"{value / 1e-9:.2g} ns"
