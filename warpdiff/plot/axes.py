"""Elements that all plots share: new axes, colours of lines, units of heights, scale bars and colour bars."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from warpdiff.core.wording import ArgumentTypeError, ref

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Colours of lines: the palette of Okabe and Ito (2008), which colour-blind readers can distinguish. The yellow of the
# palette is omitted, because it is too pale on white.
LINE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
# Line styles of matplotlib for plots with many lines. After all colours of lines have been used, the colours repeat
# with the next line style.
LINE_STYLES = ("-", "--", ":", "-.")
# `FAINT` is the colour of grid lines and backgrounds, a light grey. `MISSING` is the colour of missing samples in
# height maps.
FAINT, MISSING = "0.85", "white"
# Maximum length of a scale bar, relative to the width of its map. The value was chosen because a longer bar hides more
# of the map.
_LONGEST_BAR = 0.25
# Length of the longer side of a map (of heights, for example) in a new figure [inches].
_MAP_INCHES = 4.3
# The length of a scale bar [µm] is one of these numbers times a power of ten.
_ROUND_LENGTHS = (1.0, 2.0, 5.0)
# Smallest difference of the highest and the lowest height [µm] at which plots show heights in µm instead of nm, and
# number of nanometres per micrometre.
_LEAST_MICROMETRES, _NM_PER_UM = 1.0, 1e3


def check_matplotlib(subject: str = "plots require") -> None:
    """Raise an error that begins with ``subject`` if matplotlib is not installed."""
    try:
        import matplotlib.axes  # noqa: F401
    except ImportError as error:
        raise ImportError(f"{subject} matplotlib ({error}): pip install 'warpdiff[plot]'") from error


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
    check_matplotlib()
    from matplotlib.axes import Axes

    if ax is None:
        # The figure is made by pyplot, which shows it in notebooks and also works on computers without a display.
        import matplotlib.pyplot as plt

        ax = plt.subplots(figsize=(width, height), dpi=120, layout="constrained")[1]
    elif not isinstance(ax, Axes):
        raise ArgumentTypeError(
            f"{ref('ax')} must be matplotlib axes, got {type(ax).__name__}: pass one element of plt.subplots()[1]"
        )
    return ax


def line_style(index: int) -> dict[str, Any]:
    """Return matplotlib's keyword arguments for the colour and the style of the line with index ``index``, from 0."""
    count = len(LINE_COLOURS)
    return {
        "color": LINE_COLOURS[index % count], "linestyle": LINE_STYLES[(index // count) % len(LINE_STYLES)],
    }  # fmt: skip


def length_unit(range_um: float) -> tuple[str, float]:
    """Return the unit of an axis of heights, and the factor that converts µm to this unit.

    The unit is ``"µm"`` if the highest and the lowest height differ by at least 1 µm, otherwise ``"nm"``.
    """
    return ("µm", 1.0) if range_um >= _LEAST_MICROMETRES else ("nm", _NM_PER_UM)


def round_length(most: float) -> float:
    """Return the largest number that is 1, 2 or 5 times a power of ten and at most ``most``, a positive number."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(mantissa * power for mantissa in _ROUND_LENGTHS if mantissa * power <= most * (1.0 + 1e-9))


def clean_grid(ax: Axes) -> None:
    """Draw faint grid lines behind the data, and hide the frame at the top and on the right."""
    ax.grid(color=FAINT, linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def start_at_zero(ax: Axes) -> None:
    """Let the y axis begin at 0, for quantities that cannot be negative."""
    _, top = ax.get_ylim()
    if top > 0.0 and ax.get_yscale() == "linear":
        ax.set_ylim(0.0, top)


def add_scale_bar(ax: Axes, width_um: float) -> None:
    """Draw a scale bar into the lower left corner of a map.

    Args:
        ax: Axes whose x axis is in µm.
        width_um: Width of the map [µm].
    """
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    length = round_length(_LONGEST_BAR * width_um)
    unit, factor = length_unit(length)
    bar = AnchoredSizeBar(
        ax.transData, length, f"{factor * length:g} {unit}", "lower left", pad=0.4, borderpad=0.7, sep=4.0,
        frameon=True, color="black", size_vertical=0.012 * width_um, label_top=True,
    )  # fmt: skip
    bar.patch.set(alpha=0.85, linewidth=0.0)
    ax.add_artist(bar)


def add_colour_bar(ax: Axes, picture: Any, label: str, *, extend: str = "neither") -> Any:
    """Draw a colour bar to the right of a map, as high as the map, and return the colour bar.

    Args:
        ax: Axes of the map.
        picture: Picture that ``ax.imshow`` returned.
        label: Text at the bar: a quantity with its unit.
        extend: Ends of the bar beyond which values exist: ``"neither"``, ``"min"``, ``"max"`` or ``"both"``.
    """
    bar = ax.figure.colorbar(picture, cax=ax.inset_axes((1.025, 0.0, 0.045, 1.0)), extend=extend)
    bar.set_label(label)
    bar.outline.set_visible(False)
    return bar


def map_size(extent_y: float, extent_x: float) -> tuple[float, float]:
    """Return the width and height of a height map [inches]; their ratio is that of the field, but at most 4 to 1."""
    ratio = min(max(extent_y / extent_x, 0.25), 4.0)
    return (_MAP_INCHES, _MAP_INCHES * ratio) if ratio <= 1.0 else (_MAP_INCHES / ratio, _MAP_INCHES)


def outlined(colour: str = "white", behind: str = "black") -> dict[str, Any]:
    """Return matplotlib's keyword arguments for a text with an outline, which is legible on any background."""
    from matplotlib.patheffects import withStroke

    return {"color": colour, "path_effects": [withStroke(linewidth=2.0, foreground=behind)]}
