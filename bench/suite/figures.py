"""Style of the charts, and functions that write their files and label their curves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.files import atomic_write

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

GREY = "#555555"
# Colours of Okabe and Ito, which colour-blind readers can distinguish. Black and brown are added to the palette.
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE, BROWN = (
    "#000000", "#e69f00", "#56b4e9", "#009e73", "#0072b2", "#d55e00", "#cc79a7", "#8c510a",
)  # fmt: skip


def pyplot() -> Any:
    """Return Matplotlib's pyplot with the style of these charts, without a display."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update({
        "font.family": "DejaVu Sans", "font.size": 10, "axes.titlesize": 11, "axes.titleweight": "bold",
        "axes.titlelocation": "left", "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": GREY,
        "svg.hashsalt": "warpdiff",
    })  # fmt: skip
    return plt


def save(figure: Any, folder: Path, name: str) -> Path:
    """Write a figure atomically as PNG and SVG. Return the path of the PNG file."""
    folder.mkdir(parents=True, exist_ok=True)
    for suffix, options in ((".svg", {"metadata": {"Date": None}}), (".png", {"dpi": 110})):
        with atomic_write(folder / f"{name}{suffix}") as unfinished:
            figure.savefig(unfinished, format=suffix[1:], **options)
    pyplot().close(figure)
    return folder / f"{name}.png"


def label_ends(axis: Any, ends: Sequence[tuple[float, float, str, str]], *, gap: float = 0.052) -> None:
    """Write the labels of curves at the right edge of logarithmic axes, without overlap, with leader lines.

    Args:
        axis: Axes with their limits set.
        ends: Last points of the curves with their labels: (x, y, name, colour), in data coordinates.
        gap: Least distance of two labels, as a share of the axis' height.
    """
    low, high = map(math.log10, axis.get_ylim())
    first, last = map(math.log10, axis.get_xlim())
    order = sorted(ends, key=lambda end: end[1])
    places = [float(np.clip((math.log10(max(y, 1e-300)) - low) / (high - low), 0.0, 0.97)) for _, y, _, _ in order]
    apart = list(places)
    for k in range(1, len(apart)):
        apart[k] = max(apart[k], apart[k - 1] + gap)
    excess = max((apart[-1] if apart else 0.0) - 0.97, 0.0)
    apart = [place - excess for place in apart]
    for k in range(len(apart) - 2, -1, -1):
        apart[k] = min(apart[k], apart[k + 1] - gap)
    for (x, _, name, colour), at, place in zip(order, apart, places, strict=True):
        start = (math.log10(x) - first) / (last - first)
        axis.annotate(
            name, xy=(start, place), xytext=(1.03, at), xycoords="axes fraction", textcoords="axes fraction",
            color=colour, va="center", fontsize=8.5, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "alpha": 0.5, "shrinkA": 1, "shrinkB": 3},
        )  # fmt: skip
