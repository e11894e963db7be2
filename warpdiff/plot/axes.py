"""Common parts of all plots: new axes, colours, units of lengths, scale bars and colour bars."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from warpdiff.core.wording import ArgumentTypeError, ref

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colours of lines by Okabe and Ito (2008), which colour-blind readers distinguish, without their yellow, which is too
# pale on white.
LINE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
# Second mark of lines, for prints without colours and after all colours are used.
LINE_STYLES = ("-", "--", ":", "-.")
# Colour of grid lines, and of samples without a value.
FAINT, MISSING = "0.85", "0.75"
# Largest length of a scale bar, as a share of the width of the plot. Limit: it is a mark, not an axis.
_LONGEST_BAR = 0.25
# Mantissas of the lengths of scale bars.
_ROUND_LENGTHS = (1.0, 2.0, 5.0)
# Height range [µm] from which heights are shown in µm, and nanometres per micrometre.
_LEAST_MICROMETRES, _NM_PER_UM = 1.0, 1e3


def axes_for(ax: Axes | None, *, width: float, height: float) -> Axes:
    """Return the axes that a plot draws into.

    Args:
        ax: Axes of the caller; None makes a figure.
        width: Width of the new figure [inches].
        height: Height of the new figure [inches].

    Raises:
        ImportError: matplotlib is not installed.
        TypeError: ``ax`` is no axes of matplotlib.
    """
    try:
        from matplotlib.axes import Axes
    except ImportError as error:
        raise ImportError(f"plots require matplotlib ({error}): pip install 'warpdiff[plot]'") from error
    if ax is None:
        # pyplot shows the figure in notebooks, and chooses a backend without windows where there is no display.
        import matplotlib.pyplot as plt

        return plt.subplots(figsize=(width, height), dpi=120, layout="constrained")[1]
    if not isinstance(ax, Axes):
        raise ArgumentTypeError(
            f"{ref('ax')} must be matplotlib axes, got {type(ax).__name__}: pass one element of plt.subplots()[1]"
        )
    return ax


def line_style(index: int) -> dict[str, Any]:
    """Return matplotlib's keywords for the colour and the style of a line, by its index."""
    count = len(LINE_COLOURS)
    return {
        "color": LINE_COLOURS[index % count], "linestyle": LINE_STYLES[(index // count) % len(LINE_STYLES)],
    }  # fmt: skip


def length_unit(range_um: float) -> tuple[str, float]:
    """Return the unit in which a range of heights is shown, and its number per micrometre."""
    return ("µm", 1.0) if range_um >= _LEAST_MICROMETRES else ("nm", _NM_PER_UM)


def round_length(most: float) -> float:
    """Return the largest length 1, 2 or 5 × 10ⁿ that is at most ``most``, which is positive."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(mantissa * power for mantissa in _ROUND_LENGTHS if mantissa * power <= most * (1.0 + 1e-9))


def clean_grid(ax: Axes) -> None:
    """Show faint grid lines behind the data, and no frame at the top and on the right."""
    ax.grid(color=FAINT, linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def add_scale_bar(ax: Axes, width_um: float) -> None:
    """Draw a scale bar into the lower left corner of a map.

    Args:
        ax: Axes whose x axis is in µm.
        width_um: Width of the map [µm].
    """
    from matplotlib.patches import Rectangle

    length = round_length(_LONGEST_BAR * width_um)
    unit, factor = length_unit(length)
    share, left, bottom, thickness, margin = length / width_um, 0.045, 0.05, 0.014, 0.02
    text = ax.text(
        left + 0.5 * share, bottom + thickness + 0.012, f"{factor * length:g} {unit}", transform=ax.transAxes,
        ha="center", va="bottom", fontsize="medium", color="black", zorder=5,
    )  # fmt: skip
    # The box behind bar and text must be as wide as the wider of both.
    half = max(0.5 * share, 0.058)
    ax.add_patch(
        Rectangle(
            (left + 0.5 * share - half - margin, bottom - margin), 2.0 * (half + margin), thickness + 0.105,
            transform=ax.transAxes, facecolor="white", alpha=0.85, linewidth=0.0, zorder=4,
        )
    )  # fmt: skip
    ax.add_patch(
        Rectangle((left, bottom), share, thickness, transform=ax.transAxes, color="black", linewidth=0.0, zorder=5)
    )
    text.set_clip_on(False)
