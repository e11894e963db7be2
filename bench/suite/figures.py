"""Shared look of the charts, and how they are written."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.files import atomic_write

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

GREY = "#555555"
# Okabe and Ito's colours, which the colour-blind tell apart, and black.
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE, BROWN = (
    "#000000", "#e69f00", "#56b4e9", "#009e73", "#0072b2", "#d55e00", "#cc79a7", "#8c510a",
)  # fmt: skip


def pyplot() -> Any:
    """Matplotlib's pyplot in the look of these charts, without a display."""
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
    """Write a figure as PNG and SVG, each under another name until it is whole; returns the PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    for suffix, options in ((".svg", {"metadata": {"Date": None}}), (".png", {"dpi": 110})):
        with atomic_write(folder / f"{name}{suffix}") as unfinished:
            figure.savefig(unfinished, format=suffix[1:], **options)
    pyplot().close(figure)
    return folder / f"{name}.png"


def label_ends(axis: Any, ends: Sequence[tuple[float, float, str, str]], *, gap: float = 0.052) -> None:
    """Write names (x, y, name, colour) beside the right edge of logarithmic axes, apart, with lines to where they end.

    Args:
        axis: With its limits set.
        ends: Where curves end, in data.
        gap: Least distance of two names, as a share of the axis.
    """
    low, high = (math.log10(each) for each in axis.get_ylim())
    left, right = (math.log10(each) for each in axis.get_xlim())
    order = sorted(ends, key=lambda each: each[1])
    places = [float(np.clip((math.log10(max(y, 1e-300)) - low) / (high - low), 0.0, 0.97)) for _, y, _, _ in order]
    apart = list(places)
    for k in range(1, len(apart)):
        apart[k] = max(apart[k], apart[k - 1] + gap)
    excess = max((apart[-1] if apart else 0.0) - 0.97, 0.0)
    apart = [each - excess for each in apart]
    for k in range(len(apart) - 2, -1, -1):
        apart[k] = min(apart[k], apart[k + 1] - gap)
    for (x, _, name, colour), at, place in zip(order, apart, places, strict=True):
        start = (math.log10(x) - left) / (right - left)
        axis.annotate(
            name, xy=(start, place), xytext=(1.03, at), xycoords="axes fraction", textcoords="axes fraction",
            color=colour, va="center", fontsize=8.5, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "alpha": 0.5, "shrinkA": 1, "shrinkB": 3},
        )  # fmt: skip
