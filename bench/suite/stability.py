"""Stability chart: errors of methods and of the automatic choice of a method in eight regimes, one panel each.

A regime is a range of one parameter in which some methods fail. A panel is a diagram of the chart.

``stability_regimes`` computes the errors. This module measures, draws and summarises the panels.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.suite import figures
from bench.suite.stability_regimes import (
    ALL,
    AUTOMATIC,
    AUTOMATIC_CENTRED,
    AUTOMATIC_SOURCE,
    CUBICS,
    EQUAL,
    FACING,
    FLOAT64,
    FLOOR,
    NEAREST,
    ORDER_WISE,
    PLAIN,
    PQ,
    PQ64,
    PUBLISHED,
    REGIMES,
    RESAMPLED,
    ROUNDED,
    SAMPLED,
    SERIES,
    SINGLE,
    SMALL,
    STEPS,
    TOLERANCE,
    Panel,
)

if TYPE_CHECKING:
    from pathlib import Path

    from bench.suite.runner import Setting

# Colours of curves, similar to those of ColorBrewer. Related methods have similar hues.
RED, ORANGE, BLUE, TEAL, PURPLE = "#b2182b", "#e08214", "#1b6cb5", "#1a9879", "#7b4fa3"
BROWN, SAND, GREEN, LIME, CYAN, PINK, ROSE, GREY = (
    "#8c510a", "#d8a657", "#1b7837", "#7fbf7b", "#0096b4", "#c51b7d", "#ee9cca", "#555555",
)  # fmt: skip
DOTTED, DASHED = (0, (1, 1.2)), (0, (4, 2))
# Styles of the curves in the chart, by the group and the name of a curve in the legend.
STYLES: dict[str, dict[str, dict[str, object]]] = {
    "Automatic choice": {
        AUTOMATIC: {"color": "black", "linewidth": 3.0, "zorder": 10},
        AUTOMATIC_CENTRED: {"color": "black", "linewidth": 2.0, "linestyle": (0, (4, 1.2)), "zorder": 9},
        AUTOMATIC_SOURCE: {"color": "black", "linewidth": 2.2, "linestyle": DOTTED, "zorder": 9},
    },
    "Series (a)": {
        SERIES["taylor-uncentred"]: {"color": RED}, PUBLISHED: {"color": RED, "linestyle": DOTTED, "linewidth": 1.6},
        SERIES["taylor"]: {"color": ORANGE}, SERIES["jacobi-anger"]: {"color": BLUE}, SERIES["power"]: {"color": TEAL},
        SERIES["low-rank"]: {"color": PURPLE},
    },
    "Wavelengths (b, c, d, e, h)": {
        STEPS[5.0]: {"color": BROWN}, STEPS[1.0]: {"color": SAND}, ORDER_WISE: {"color": CYAN},
        EQUAL: {"color": BROWN, "linewidth": 2.4}, EQUAL + SMALL: {"color": BROWN, "linestyle": DOTTED},
        CUBICS: {"color": BLUE}, CUBICS + SMALL: {"color": BLUE, "linestyle": DOTTED},
    },
    "Neighbours, geometry (b, c, e, f)": {
        FLOOR: {"color": GREEN}, ROUNDED: {"color": LIME}, SINGLE: {"color": PINK}, FACING: {"color": CYAN},
        SAMPLED: {"color": GREY, "linestyle": DASHED, "linewidth": 1.2}, RESAMPLED: {"color": BLUE},
    },
    "Periods (g)": {
        PQ: {"color": PINK}, PQ64: {"color": PINK, "linestyle": DASHED, "linewidth": 1.2}, PLAIN: {"color": ROSE},
        NEAREST: {"color": CYAN},
    },
}  # fmt: skip
# Smallest and largest error on the error axis of the charts.
LEAST, MOST = 1e-9, 30.0
TINT = "#fbe3e0"


def style_of(name: str) -> dict[str, object]:
    """Return the style of a curve, by its name. Curves of a series expansion in float64 are dashed."""
    styles = {label: style for group in STYLES.values() for label, style in group.items()}
    if name in styles:
        return {"linewidth": 1.9, **styles[name]}
    return {**styles[name.removesuffix(FLOAT64)], "linestyle": DASHED, "linewidth": 1.2}


def draw(panels: list[Panel], folder: Path) -> None:
    """Draw all panels with their legend, and write the chart."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure, axes = figures.pyplot().subplots(2, 4, figsize=(17.0, 10.4), sharey=True)
    for letter, axis, panel in zip("abcdefgh", axes.flat, panels, strict=True):
        axis.set(xscale="log", yscale="log", xlim=(panel.x.min(), panel.x.max()), ylim=(LEAST, MOST))
        axis.axhspan(TOLERANCE, MOST, color=TINT, zorder=-1, linewidth=0)
        axis.axhline(TOLERANCE, color="#c0392b", linewidth=1.2, zorder=1)
        for name, values in panel.curves.items():
            curve(axis, panel, np.array(values), style_of(name), panel.warned.get(name, []))
        axis.set_title(f"{letter}   {panel.title}", loc="left", pad=8)
        axis.set_xlabel(panel.axis)
        axis.set_xticks(panel.ticks, [written(tick) for tick in panel.ticks])
        axis.minorticks_off()
        axis.text(
            0.98, 0.025, panel.note, transform=axis.transAxes, ha="right", va="bottom", fontsize=8.5, color=GREY,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5, "alpha": 0.8}, zorder=12,
        )  # fmt: skip
        axis.grid(which="major", color="#00000014", linewidth=0.8)
        axis.set_axisbelow(True)
    powers = range(-9, 2, 2)
    axes[0, 0].set_yticks([10.0**power for power in powers], [f"$10^{{{power}}}$" for power in powers])
    for axis in axes[:, 0]:
        axis.set_ylabel("error, 99th percentile")
    marks = [
        Line2D([], [], label="library, float32", color=GREY, linewidth=1.9),
        Line2D([], [], label="the same in float64", color=GREY, linestyle=DASHED, linewidth=1.2),
        Line2D([], [], label="beyond the scale, infinite or NaN", color=GREY, linestyle="", marker="x"),
        Line2D([], [], label="warned or refused", color="black", linewidth=1.0, marker="o", mfc="white"),
        Patch(facecolor=TINT, edgecolor="#c0392b", label="error above 1e-2: fails"),
    ]
    groups = {
        title: [Line2D([], [], label=name, **style_of(name)) for name in styles] for title, styles in STYLES.items()
    }
    groups["Marks"] = marks
    for x, (title, handles) in zip((0.03, 0.185, 0.355, 0.55, 0.725, 0.855), groups.items(), strict=True):
        legend = figure.legend(
            handles=handles, title=title, loc="upper left", bbox_to_anchor=(x, 0.188), frameon=False, fontsize=9,
            title_fontproperties={"weight": "bold", "size": 9.5}, alignment="left", handlelength=2.4,
        )  # fmt: skip
        legend.set_in_layout(False)
    figure.tight_layout(rect=(0.0, 0.19, 1.0, 1.0), w_pad=1.4, h_pad=2.0)
    figures.save(figure, folder, "stability")


def written(tick: float) -> str:
    """Return the text at an axis tick, for a value on the x axis."""
    return f"{tick:g}" if tick >= 2e-3 else f"$10^{{{round(math.log10(tick))}}}$"


def curve(axis: Any, panel: Panel, errors: np.ndarray, style: dict[str, object], warned: list[int]) -> None:
    """Draw one curve of a panel. Crosses at the upper edge mark errors beyond the range of the axis."""
    x = panel.x
    beyond = errors >= MOST
    y = np.clip(errors, LEAST * 1e-3, MOST)
    if warned:
        axis.plot(x, y, color=style["color"], linewidth=1.0, zorder=9)
        axis.plot(
            x[warned], np.minimum(y[warned], MOST / 1.5), "o", mfc="white", mec="black", markersize=5.5, zorder=11
        )
        y[warned] = np.nan
    axis.plot(x, y, solid_capstyle="round", **style)
    if beyond.any() and not warned:
        edge = np.full(np.count_nonzero(beyond), MOST / 1.4)
        axis.plot(x[beyond], edge, "x", color=style["color"], markersize=5, markeredgewidth=1.4, zorder=8)


def measure(setting: Setting) -> dict[str, Any]:
    """Measure the errors in all panels (diagrams) of the chart.

    A quick run computes only every fifth value on the x axis, without the slow values at the ends.
    """
    results = {}
    for regime in REGIMES:
        setting.say(f"stability: {regime.__name__}")
        panel = regime(slice(2, None, 5) if setting.quick else ALL)
        results[regime.__name__] = panel._replace(x=np.asarray(panel.x).tolist())._asdict()
    return results


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the errors of the library's automatic choice of a method, one error per value of the x axis, by name.

    Each error is stored as a list [error, error, error, unit], because other charts have lists [median, minimum,
    maximum, unit].
    """
    return {
        f"stability/{regime}/{name}/{x:.3g}": [error] * 3 + ["error"]
        for regime, panel in results.items()
        for name in (AUTOMATIC, AUTOMATIC_CENTRED, AUTOMATIC_SOURCE)
        for x, error in zip(panel["x"], panel["curves"].get(name, []), strict=False)
    }


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw all panels in one chart.

    Return the chart's name and a sentence about the errors of the automatic choice.
    """
    panels = [Panel(**{**panel, "x": np.array(panel["x"])}) for panel in results.values()]
    draw(panels, folder)
    worst, warnings, points = 0.0, 0, 0
    for panel in panels:
        for name in (AUTOMATIC, AUTOMATIC_CENTRED, AUTOMATIC_SOURCE):
            warned = panel.warned.get(name, [])
            accepted = [error for at, error in enumerate(panel.curves.get(name, [])) if at not in warned]
            worst, warnings, points = max([worst, *accepted]), warnings + len(warned), points + len(accepted)
    text = (
        f"Every other method fails in some regime. At a tolerance of 1e-2, the automatic choice has an error of at "
        f"most {worst:.1e} at {points} points, and warns or refuses at {warnings} others."
    )
    return {"stability": text}
