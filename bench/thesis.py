"""The published evaluation, reproduced: periods found by diffraction, BRDF maps and renderings, one figure each.

Single, *An Interactive Shader for Natural Diffraction Gratings* (Bern 2014), is laid beside this library: what that
work published as numbers stands in the tables, and what it computes differently is computed here too, by ``variants``.
Every figure says below what differs, and why. All of them are on one page, ``index.html``, and in one picture,
``contact_sheet.png``.

Periods: light falls in at 75°; at each of 401 wavelengths the view angle of the brightest first order is sought on a
grid, and the grating equation makes a period of it, d = λ/(sin θi + sin θr). Its mean and variance over the wavelengths
are tabled. Masking is off, for it shifts peaks.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import html
import math
import os
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from warpdiff import optics, spectrum

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "bench"))

SCAN = "elaphe_65um.png"
WAVELENGTHS = np.arange(380.0, 781.0)
INCIDENCE_DEG = 75.0
GRID_DEG = 0.0025
# An order is sought between these shares of the period that is expected: neighbouring orders look like half of it.
SOUGHT = 1.3
BLAZED_UM, BLAZED_DEPTH_UM, SCAN_PERIOD_UM = 2.5, 0.25, 1.1
# Means and variances over the wavelengths [nm, nm²], as published.
PUBLISHED = {
    ("blazed", "full"): "2499.997 (0.377)",
    ("blazed", "copies"): "2502.428 (0.390); in the author's log 2491.862 (248.044)",
    ("scan", "full"): "1144.262 (0.401)",
    ("scan", "copies"): "1052.308 (49.678)",
}
PUBLISHED_SCAN_NM = 1144.262


@dataclasses.dataclass(frozen=True)
class Figure:
    """A figure or table of the page.

    Attributes:
        name: Its file's name without suffix.
        title: What it shows.
        differs: What differs from the published result, and why.
        table: Rows of cells, the header first, of a table below the picture.
    """

    name: str
    title: str
    differs: str
    table: list[list[str]] = dataclasses.field(default_factory=list)


@dataclasses.dataclass(frozen=True)
class Setup:
    """What the figures are made of.

    Attributes:
        folder: Where they are written.
        quick: Whether small sizes will do.
        scan: The levelled scan, if there is one.
    """

    folder: Path
    quick: bool
    scan: wd.HeightField | None

    def pixels(self, count: int) -> int:
        """A size in pixels, a third of it if quick."""
        return count // 3 if self.quick else count

    @functools.cached_property
    def natural(self) -> wd.HeightField:
        """The scan, or synthetic fingers in its place."""
        return self.scan or wd.gratings.fingers(size_um=32.0, pitch_um=0.08)

    @property
    def natural_name(self) -> str:
        """What it is called."""
        return "Elaphe" if self.scan else "fingers"


def at_angle(degrees: ArrayLike) -> Floats:
    """Unit vectors in the plane of incidence, at angles from the normal towards +x."""
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


def periods_at(angles_deg: Floats, wavelengths_nm: Floats) -> Floats:
    """d = λ/(sin θi + sin θr) [nm] of the first order."""
    return wavelengths_nm / (math.sin(math.radians(INCIDENCE_DEG)) + np.sin(np.radians(angles_deg)))


def first_order(
    reflectance: Callable[[Floats, Floats, Floats], Floats],
    expected_um: float,
    *,
    wavelengths_nm: Floats = WAVELENGTHS,
    grid_deg: float = GRID_DEG,
) -> tuple[Floats, Floats, Floats]:
    """Seek the brightest first order at each wavelength.

    Args:
        reflectance: ρ(to_light, to_view, wavelengths_nm), shape (n, m).
        expected_um: About what period [µm].
        wavelengths_nm: Wavelengths [nm], shape (m,).
        grid_deg: Distance of the view angles that are tried [degrees].

    Returns:
        The view angles that are tried [degrees], (n,); ρ, (n, m); those at which it is largest [degrees], (m,).
    """
    sines = wavelengths_nm[[0, -1]] * 1e-3 / expected_um * (1.0 / SOUGHT, SOUGHT)
    low, high = np.degrees(np.arcsin(sines - math.sin(math.radians(INCIDENCE_DEG))))
    angles = np.arange(low, high, grid_deg)
    rho = reflectance(at_angle(INCIDENCE_DEG), at_angle(angles), wavelengths_nm)
    ratio = periods_at(angles[:, None], wavelengths_nm) / (1e3 * expected_um)
    sought = np.where((ratio > 1.0 / SOUGHT) & (ratio < SOUGHT), rho, 0.0)
    return angles, rho, angles[np.argmax(sought, axis=0)]


def library(hf: wd.HeightField, **options: Any) -> Callable[[Floats, Floats, Floats], Floats]:
    """The library's ρ, for :func:`first_order`."""
    return lambda light, views, wavelengths: wd.spectral_reflectance(
        hf, light, views, wavelengths, masking=False, **options
    )


def blazed_period(**options: Any) -> Floats:
    """Periods [nm] of the blazed grating at the wavelengths; options are those of ``wd.spectral_reflectance``."""
    hf = wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM)
    return periods_at(first_order(library(hf, **options), BLAZED_UM)[2], WAVELENGTHS)


def written(periods: Floats) -> str:
    """Mean and variance, as published."""
    return f"{periods.mean():.3f} ({periods.var():.3f})"


# Periods.


def ways(hf: wd.HeightField, *, copies: tuple[int, int]) -> dict[str, tuple[str, Any, float]]:
    """The ways to the periods: which published number they stand beside, ρ, and the grid [degrees] they can afford."""
    import variants

    seam = wd.Coherence("centred", centre_um=(0.0, 0.0))
    repeated = wd.Coherence("replicas", copies=copies)
    many = f"{copies[0]} × {copies[1]} copies"
    found: dict[str, tuple[str, Any, float]] = {
        f"averaged, {method}": ("full", library(hf, method=method, strict=False), GRID_DEG)
        for method in ("low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred")
    }
    found |= {
        "centred on the middle": ("full", library(hf, coherence=wd.Coherence("centred"), strict=False), GRID_DEG),
        "centred on the seam": ("full", library(hf, coherence=seam, strict=False), GRID_DEG),
        "3 × 3 by floor, seam (as published)": (
            "full", functools.partial(variants.neighbours, hf, masking=False), 0.02,
        ),
        "source of 0.53°": ("full", library(hf, coherence=wd.Coherence("source"), strict=False), GRID_DEG),
        f"{many}, exact": ("copies", library(hf, coherence=repeated, strict=False), GRID_DEG),
    }  # fmt: skip
    for interpolation in ("linear", "sinc"):
        rho = functools.partial(variants.copies, hf, count=copies, interpolation=interpolation, masking=False)
        found[f"{many}, {interpolation}"] = ("copies", rho, 0.02)
    return found


def period_figure(
    setup: Setup, name: str, hf: wd.HeightField, expected_um: float, shown: list[str], *, copies: tuple[int, int]
) -> list[list[str]]:
    """Draw reflectance over wavelength and angle for the ways that are shown; returns the table of all of them."""
    from matplotlib import pyplot as plt

    wavelengths = WAVELENGTHS[::20] if setup.quick else WAVELENGTHS
    rows = [["method", "mean (variance) [nm, nm²]", "smallest, largest", "grid", "published"]]
    figure, axes = plt.subplots(1, len(shown), figsize=(4.0 * len(shown), 4.2), sharey=True)
    panels = iter(axes)
    for label, (kind, rho_of, finest) in ways(hf, copies=copies).items():
        grid = max(finest, 0.04) if setup.quick else finest
        angles, rho, best = first_order(rho_of, expected_um, wavelengths_nm=wavelengths, grid_deg=grid)
        periods = periods_at(best, wavelengths)
        spread = f"{periods.min():.1f}, {periods.max():.1f}"
        rows.append([label, written(periods), spread, f"{grid:g}°", PUBLISHED[name, kind]])
        if label not in shown:
            continue
        axis = next(panels)
        every = max(1, len(angles) // 600)
        floor = np.log10(np.maximum(rho[::every], 1e-6 * rho.max()))
        axis.pcolormesh(wavelengths, angles[::every], floor, cmap="magma", shading="nearest", rasterized=True)
        axis.plot(wavelengths, best, color="#4fc3f7", linewidth=1.6, label="brightest")
        mean = wavelengths / periods.mean() - math.sin(math.radians(INCIDENCE_DEG))
        axis.plot(wavelengths, np.degrees(np.arcsin(mean)), "--", color="white", linewidth=1.0, label="mean period")
        axis.set_title(f"{label}\n{written(periods)} nm", fontsize=9)
        axis.set_xlabel("wavelength [nm]")
    axes[0].set_ylabel("view angle [°]")
    axes[0].legend(loc="upper left", fontsize=8)
    save(setup, figure, f"periods_{name}")
    return rows


def blazed_periods(setup: Setup) -> Figure:
    """The blazed grating's."""
    shown = [
        "averaged, low-rank",
        "3 × 3 by floor, seam (as published)",
        "1 × 26 copies, exact",
        "1 × 26 copies, linear",
    ]
    hf = wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM)
    table = period_figure(setup, "blazed", hf, BLAZED_UM, shown, copies=(1, 26))
    return Figure("periods_blazed", "Periods of a blazed grating of 2500 nm", "", table)


def scan_periods(setup: Setup) -> Figure:
    """The scan's."""
    shown = ["averaged, low-rank", "centred on the seam", "3 × 3 by floor, seam (as published)", "1 × 1 copies, linear"]
    table = period_figure(setup, "scan", setup.natural, SCAN_PERIOD_UM, shown, copies=(1, 1))
    return Figure("periods_scan", "Periods of the Elaphe scan", "", table)


# Pictures.


def save(setup: Setup, figure: Any, name: str) -> None:
    """Write a figure and forget it."""
    from matplotlib import pyplot as plt

    figure.tight_layout()
    figure.savefig(setup.folder / f"{name}.png", dpi=90)
    plt.close(figure)


SECTIONS: tuple[tuple[Callable[[Setup], Figure], bool], ...] = ((blazed_periods, False), (scan_periods, True))


def page(figures: list[Figure]) -> str:
    """The contact sheet in HTML."""
    parts = [
        "<!doctype html><meta charset='utf-8'><title>The published evaluation, reproduced</title>",
        "<style>body{font:15px sans-serif;max-width:1200px;margin:2em auto}img{max-width:100%}"
        "td,th{padding:.2em .8em;text-align:left;border-bottom:1px solid #ccc}</style>",
        "<h1>The published evaluation, reproduced</h1>",
    ]
    for each in figures:
        parts.append(f"<h2>{html.escape(each.title)}</h2><img src='{each.name}.png' alt='{html.escape(each.title)}'>")
        for at, row in enumerate(each.table):
            tag = "td" if at else "th"
            cells = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
            parts.append(("" if at else "<table>") + f"<tr>{cells}</tr>")
        parts.append("</table>" if each.table else "")
        parts.append(f"<p><b>What differs, and why.</b> {html.escape(each.differs)}</p>")
    return "\n".join(parts)


def main() -> int:
    """Write all figures and the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("thesis"), help="folder for the figures (thesis)")
    parser.add_argument("--data", type=Path, help="folder with the scan; default WARPDIFF_DATA or ../shared/data")
    parser.add_argument("--quick", action="store_true", help="small sizes, in less than a minute")
    parser.add_argument("--only", choices=[each.__name__ for each, _ in SECTIONS], nargs="+", help="only these figures")
    options = parser.parse_args()
    import matplotlib as mpl

    mpl.use("Agg")
    data = options.data or Path(os.environ.get("WARPDIFF_DATA") or ROOT.parent / "shared" / "data")
    scan = None
    if (data / SCAN).is_file():
        scan = wd.HeightField.load(data / SCAN, extent_um=65.0, height_range_um=0.375).levelled(order=2)
    else:
        print(f"{SCAN} is not in {data}: its figures are skipped or show synthetic fingers")
    options.output.mkdir(parents=True, exist_ok=True)
    setup = Setup(options.output, options.quick, scan)
    figures = []
    for make, needs_scan in SECTIONS:
        if (needs_scan and scan is None) or make.__name__ not in (options.only or [make.__name__]):
            continue
        begin = time.perf_counter()
        figures.append(make(setup))
        print(f"{options.output / figures[-1].name}.png  {figures[-1].title}  ({time.perf_counter() - begin:.0f} s)")
        for row in figures[-1].table:
            print("| " + " | ".join(row) + " |", flush=True)
    (options.output / "index.html").write_text(page(figures), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
