"""The figures of Single (2014), reproduced: periods measured by diffraction, reflectance maps and renderings.

The publication is Single, *An Interactive Shader for Natural Diffraction Gratings* (Bern 2014). The tables contain the
numbers of that publication, the numbers of this library, and those of the published methods, which ``variants``
computes. The report ``report.md`` is the text of ``thesis.md`` with the tables inserted. The text below each figure
explains the differences.

Periods are measured at an angle of incidence of 75°. At each of 401 wavelengths, the view angle at which the first
order is brightest is searched on a grid of angles. The grating equation then gives a period, d = λ/(sin θi + sin θr).
The tables contain the mean and the variance of the period over the wavelengths. Masking is off, because it shifts the
brightest angle.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.reproduce import variants
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Table = list[list[str]]

WAVELENGTHS = np.arange(380.0, 781.0)
# Text of the report, into which the tables are inserted.
TEXT = Path(__file__).with_suffix(".md")
# Angle of incidence from the normal [degrees], as in the publication (Single 2014).
INCIDENCE_DEG = 75.0
# Step of the view angles [degrees]. A step changes the measured period by 0.4 nm at a wavelength of 380 nm.
GRID_DEG = 0.0025
# Accepted ratio of a measured to the expected period: at most this value, and at least its inverse. The limit must be
# below 2. With a ratio of 2, the second order would count as the first order of half the period.
SOUGHT = 1.3
# Period of the blazed grating, and expected period of the scan of a snake's skin [µm].
BLAZED_UM, SCAN_PERIOD_UM = 2.5, 1.1
# Periods in the publication (Single 2014), by surface and by the sum that was used: over all coefficients of one patch
# ("full"), or for several repetitions of the patch ("periods"). Each text has the mean over the wavelengths [nm] and,
# in parentheses, the variance [nm²].
PUBLISHED = {
    ("blazed", "full"): "2499.997 (0.377)",
    ("blazed", "periods"): "2502.428 (0.390); in the author's log 2491.862 (248.044)",
    ("scan", "full"): "1144.262 (0.401)",
    ("scan", "periods"): "1052.308 (49.678)",
}
# Period of the scan in the publication (Single 2014) [nm].
PUBLISHED_SCAN_NM = 1144.262
CENTRED, SEAM = wd.Coherence("centred"), wd.Coherence("centred", centre_um=(0.0, 0.0))
FLOOR = "3 × 3 by floor, on the seam"


@dataclasses.dataclass(frozen=True)
class Setup:
    """Options and the scan from which the figures of the report are drawn.

    Attributes:
        folder: Folder to which the figures are written.
        quick: Whether figures are smaller, with fewer samples, for a test of the script.
        raw: Scan of a snake's skin as measured, or None if its file is absent.
    """

    folder: Path
    quick: bool
    raw: wd.HeightField | None

    @functools.cached_property
    def scan(self) -> wd.HeightField | None:
        """The scan after subtraction of a polynomial of order 2 (levelled), or None if its file is absent."""
        return None if self.raw is None else self.raw.levelled(order=2)

    def pixels(self, count: int) -> int:
        """Return an odd width of a picture: near ``count`` pixels, or near a third of ``count`` if ``quick`` is True.

        With an odd size, the middle row of a map lies in the plane of incidence.
        """
        return (count // 3 if self.quick else count) | 1

    @functools.cached_property
    def natural(self) -> wd.HeightField:
        """The scan of a snake's skin, its middle part if ``quick`` is True, or a synthetic skin if ``scan`` is None."""
        if self.scan is None:
            return wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
        return self.scan.cropped(32.0) if self.quick else self.scan

    @property
    def natural_name(self) -> str:
        """Name of the natural surface in figures: genus of the scanned snake, or "fingers" for the synthetic skin."""
        return "fingers" if self.scan is None else "Elaphe"


def at_angle(degrees: ArrayLike) -> Floats:
    """Return unit vectors in the plane of incidence, at angles from the normal towards +x."""
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


def view_angles(longest_nm: float, shortest_nm: float, count: int, wavelength_nm: Floats) -> Floats:
    """Return view angles [degrees] of the first order at one wavelength, for ``count`` grating periods in a range."""
    sines = wavelength_nm / np.linspace(longest_nm, shortest_nm, count) - math.sin(math.radians(INCIDENCE_DEG))
    return np.degrees(np.arcsin(sines))


def periods_at(angles_deg: Floats, wavelengths_nm: Floats) -> Floats:
    """Return the periods d = λ/(sin θi + sin θr) [nm] for view angles [degrees] of the first order."""
    return wavelengths_nm / (math.sin(math.radians(INCIDENCE_DEG)) + np.sin(np.radians(angles_deg)))


def first_order(
    reflectance: Callable[[Floats, Floats, Floats], Floats], expected_um: float, *,
    wavelengths_nm: Floats = WAVELENGTHS, grid_deg: float = GRID_DEG,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Find the view angle at which the first order is brightest, at each wavelength.

    Args:
        reflectance: Function of ``to_light``, ``to_view`` and ``wavelengths_nm`` that returns the reflectance ρ, shape
            (n, m).
        expected_um: Expected period [µm].
        wavelengths_nm: Wavelengths [nm], shape (m,).
        grid_deg: Step of the view angles [degrees].

    Returns:
        View angles of the grid [degrees], shape (n,). Reflectances ρ at these angles, shape (n, m). View angle with the
        largest ρ at each wavelength [degrees], shape (m,).
    """
    sines = wavelengths_nm[[0, -1]] * 1e-3 / expected_um * (1.0 / SOUGHT, SOUGHT)
    low, high = np.degrees(np.arcsin(sines - math.sin(math.radians(INCIDENCE_DEG))))
    angles = np.arange(low, high, grid_deg)
    rho = reflectance(at_angle(INCIDENCE_DEG), at_angle(angles), wavelengths_nm)
    ratio = periods_at(angles[:, None], wavelengths_nm) / (1e3 * expected_um)
    sought = np.where((ratio > 1.0 / SOUGHT) & (ratio < SOUGHT), rho, 0.0)
    return angles, rho, angles[np.argmax(sought, axis=0)]


def library(
    heightfield: wd.HeightField, *, opposite: bool = False, **options: Any
) -> Callable[[Floats, Floats, Floats], Floats]:
    """Return a function that computes the reflectance of a height field by the library, for :func:`first_order`.

    With ``opposite``, light and views are rotated by 180° about the normal.
    """
    rotated = np.array([-1.0, -1.0, 1.0]) if opposite else np.ones(3)
    return lambda light, views, wavelengths: wd.spectral_reflectance(
        heightfield, light * rotated, views * rotated, wavelengths, masking=False, **options
    )


def blazed() -> wd.HeightField:
    """Return the blazed grating of the publication (Single 2014), with a period of 2.5 µm."""
    return wd.gratings.blazed(BLAZED_UM, 0.25)


def blazed_period(**options: Any) -> Floats:
    """Return measured periods of the blazed grating [nm]. ``options`` are arguments of ``wd.spectral_reflectance``."""
    return periods_at(first_order(library(blazed(), **options), BLAZED_UM)[2], WAVELENGTHS)


def written(periods: Floats) -> str:
    """Return a text with the mean and the variance of periods, in the format of the publication."""
    return f"{periods.mean():.3f} ({periods.var():.3f})"


# Functions that draw figures of the periods that are measured on height fields.


def methods_of(
    heightfield: wd.HeightField, raw: wd.HeightField | None, *, periods: tuple[int, int]
) -> dict[str, tuple[str, Any, float]]:
    """Return the compared methods that compute the reflectance of a height field, by name of the method.

    Each has its key in ``PUBLISHED``, its function for the reflectance, and the step of the view angles [degrees].
    """
    repeated = wd.Coherence("replicas", periods=periods)
    many = f"{periods[0]} × {periods[1]} periods"
    other = library(heightfield, opposite=True, strict=False)
    coarse = 0.005 if heightfield.shape[0] == 1 else 0.02
    result: dict[str, tuple[str, Any, float]] = {
        f"averaged, {method}": ("full", library(heightfield, method=method, strict=False), GRID_DEG)
        for method in ("low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred")
    }
    result |= {
        "averaged, light from the other side": ("full", other, GRID_DEG),
        "centred on the middle": ("full", library(heightfield, coherence=CENTRED, strict=False), GRID_DEG),
        "centred on the seam": ("full", library(heightfield, coherence=SEAM, strict=False), GRID_DEG),
        FLOOR: ("full", functools.partial(variants.neighbours, heightfield), coarse),
        "source of 0.53°": ("full", library(heightfield, coherence=wd.Coherence("source"), strict=False), GRID_DEG),
        f"{many}, exact": ("periods", library(heightfield, coherence=repeated, tolerance=1e-3, strict=False), GRID_DEG),
    }  # fmt: skip
    if raw is not None:
        result["centred on the seam, not levelled"] = ("full", library(raw, coherence=SEAM, strict=False), GRID_DEG)
    for interpolation in ("linear", "sinc"):
        rho = functools.partial(variants.periods, heightfield, count=periods, interpolation=interpolation)
        result[f"{many}, {interpolation}"] = ("periods", rho, coarse)
    return result


def period_figure(
    setup: Setup, name: str, heightfield: wd.HeightField, expected_um: float, shown: list[str], *,
    counts: tuple[int, int], raw: wd.HeightField | None = None,
) -> Table:  # fmt: skip
    """Draw the reflectance over wavelength and view angle by the methods ``shown``.

    Return a table of the grating periods that are measured by all methods.
    """
    from matplotlib import pyplot as plt

    wavelengths = WAVELENGTHS[::20] if setup.quick else WAVELENGTHS
    rows = [["method", "mean (variance) [nm, nm²]", "smallest, largest", "grid", "published"]]
    figure, axes = plt.subplots(1, len(shown), figsize=(4.0 * len(shown), 4.2), sharey=True)
    panels = iter(axes)
    for label, (kind, rho_of, finest) in methods_of(heightfield, raw, periods=counts).items():
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
    save(setup, figure, f"{name}_periods")
    return rows


def blazed_periods(setup: Setup) -> Table:
    """Draw the measurement of the blazed grating's period. Return a table of the periods by all methods."""
    shown = ["averaged, low-rank", FLOOR, "1 × 26 periods, exact", "1 × 26 periods, linear"]
    return period_figure(setup, "blazed", blazed(), BLAZED_UM, shown, counts=(1, 26))


def scan_periods(setup: Setup) -> Table:
    """Draw the measurement of the period of the scan. Return a table of the periods by all methods."""
    shown = ["averaged, low-rank", "centred on the middle", "centred on the seam", FLOOR, "1 × 1 periods, linear"]
    return period_figure(setup, "scan", setup.scan, SCAN_PERIOD_UM, shown, counts=(1, 1), raw=setup.raw)


def scan_windows(setup: Setup) -> Table:
    """Draw the periods measured under a centred window at many positions. Return a table of the periods' quantiles.

    The centred window is a Gaussian around one position of the scan; only heights below it interfere.
    """
    from matplotlib import pyplot as plt

    heightfield, wavelengths = setup.scan, WAVELENGTHS[:: 100 if setup.quick else 10]
    places = np.arange(0.0, heightfield.size_um[1], 22.0 if setup.quick else 5.0)

    def period(coherence: wd.Coherence, *, opposite: bool) -> float:
        rho = library(heightfield, coherence=coherence, opposite=opposite, strict=False)
        best = first_order(rho, SCAN_PERIOD_UM, wavelengths_nm=wavelengths, grid_deg=0.05)[2]
        return float(np.median(periods_at(best, wavelengths)))

    figure, axes = plt.subplots(1, 4, figsize=(19.0, 4.6), width_ratios=(1.0, 1.0, 1.2, 1.4))
    rows = [["light from", "windows", "5, 25, 50, 75, 95 % [nm]", "mean (variance)", "averaged form", "seam"]]
    for axis, opposite, colour in zip(axes, (False, True), ("#1b6cb5", "#e08214"), strict=False):
        side = "−x" if opposite else "+x"
        map_nm = np.array(
            [[period(wd.Coherence("centred", centre_um=(y, x)), opposite=opposite) for x in places] for y in places]
        )
        image = axis.pcolormesh(places, places, map_nm, cmap="viridis", vmin=1000.0, vmax=1200.0, shading="nearest")
        axis.set(title=f"period [nm], light from {side}", xlabel="centre of the window: x [µm]", ylabel="y [µm]")
        axis.set_aspect("equal")
        figure.colorbar(image, ax=axis, shrink=0.8)
        label = f"light from {side}"
        axes[2].hist(map_nm.ravel(), np.arange(900.0, 1301.0, 5.0), histtype="step", color=colour, lw=1.8, label=label)
        averaged = period(wd.Coherence(), opposite=opposite)
        axes[2].axvline(averaged, color=colour, linestyle=":", label=f"averaged form, {averaged:.0f} nm")
        shares = ", ".join(f"{share:.0f}" for share in np.percentile(map_nm, (5, 25, 50, 75, 95)))
        rows.append([side, str(map_nm.size), shares, written(map_nm), f"{averaged:.0f}", f"{map_nm[0, 0]:.0f}"])

        angles = view_angles(1300.0, 900.0, 600, np.array(550.0))
        views = at_angle(angles)
        for coherence, style, what in (
            (wd.Coherence(), {"lw": 1.8}, "averaged"),
            (SEAM, {"lw": 0.9, "ls": "--"}, "window on the seam"),
        ):
            rho = library(heightfield, coherence=coherence, opposite=opposite)(
                at_angle(INCIDENCE_DEG), views, np.array([550.0])
            )
            x = periods_at(angles, np.array(550.0))
            axes[3].plot(x, rho[:, 0] / rho.max(), color=colour, label=f"{what}, {label}", **style)
    for axis in axes[2:]:
        axis.axvline(PUBLISHED_SCAN_NM, color="#b2182b", label="published, 1144 nm")
        axis.set_xlabel("period of the first order [nm]")
        axis.set_xlim(950.0, 1250.0)
        axis.legend(fontsize=7, loc="upper left")
    axes[2].set(ylabel="windows", ylim=(0.0, 1.5 * axes[2].get_ylim()[1]))
    axes[3].set(ylabel="reflectance at 550 nm, of the largest", ylim=(0.0, 1.6))
    save(setup, figure, "scan_windows")
    return rows


# Functions that draw reflectance maps.


# Exposures of reflectance maps: `LINE` is for gratings that reflect all light into few lines or points of the map, and
# `AREA` is for other surfaces. The values were chosen by hand; larger values clip more pixels to white.
LINE, AREA = 0.04, 3.0


def mean_map(setup: Setup, heightfield: wd.HeightField) -> Floats:
    """Return XYZ of a reflectance map, NaN outside of the unit disc of view directions.

    A pixel is the mean over 9 directions, or has 1 direction if ``quick`` is True.
    """
    samples = 1 if setup.quick else 9
    image = wd.reflectance_map(heightfield, (0.0, 0.0, 1.0), size=setup.pixels(300), samples_per_pixel=samples)
    return np.where(image.coverage[..., None] == 1.0, image.xyz.astype(np.float64), np.nan)


def exposure(xyz: Floats) -> float:
    """Return a factor for XYZ: the inverse 99th percentile of the luminance, or of its maximum if the former is 0."""
    return 1.0 / float(np.nanpercentile(xyz[..., 1], 99.0) or np.nanmax(xyz[..., 1]))


def mosaic(setup: Setup, name: str, rows: list[list[tuple[str, Floats, float]]], *, inch: float) -> Table:
    """Draw rows of pictures. Each has a label, XYZ (NaN at transparent pixels) and a factor of XYZ (exposure)."""
    from matplotlib import pyplot as plt

    height, width = rows[0][0][1].shape[:2]
    size = inch * len(rows[0]) + 0.3, inch * len(rows) * (height / width + 0.16)
    figure, axes = plt.subplots(len(rows), len(rows[0]), squeeze=False, figsize=size)
    for axis, (label, xyz, factor) in zip(axes.flat, itertools.chain(*rows), strict=True):
        axis.axis("off")
        colours = colorimetry.srgb_encode(colorimetry.xyz_to_rgb(factor * np.nan_to_num(xyz, posinf=1e9, neginf=0.0)))
        alpha = ~np.isnan(xyz[..., :1])
        axis.imshow(np.concatenate([np.clip(colours, 0.0, 1.0), alpha], axis=2), interpolation="nearest")
        axis.set_title(label, fontsize=8, pad=3)
    save(setup, figure, name)
    return []


def map_gratings(setup: Setup) -> Table:
    """Draw reflectance maps of gratings."""
    fields = {
        "sine, 2 µm, 0.3 deep": (wd.gratings.sinusoidal(2.0, 0.3), LINE),
        "square, 2 µm, 0.12 deep": (wd.gratings.lamellar(2.0, 0.12), LINE),
        "blazed, 2.5 µm, 0.25 deep": (blazed(), LINE), "bumps, 2 × 1 µm": (wd.gratings.bumps(), LINE),
        "CD": (wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08), AREA),
        "DVD": (wd.gratings.disc("DVD"), AREA), "fingers": (wd.gratings.fingers(size_um=32.0, pitch_um=0.08), AREA),
        setup.natural_name: (setup.natural, AREA),
    }  # fmt: skip
    tiles = []
    for name, (heightfield, factor) in fields.items():
        xyz = mean_map(setup, heightfield)
        tiles.append((name, xyz, factor * exposure(xyz)))
    return mosaic(setup, "map_gratings", [tiles[:4], tiles[4:]], inch=3.0)


# Functions that draw rendered bodies.


# Exposure of rendered bodies, relative to the exposure of reflectance maps.
RENDERED = 10.0
LIGHT = wd.DirectionalLight((0.5, 0.75, -0.8))
# Point on the snake's back at which a diffraction order is visible; the camera looks at it.
COLOURED = (-0.453, 0.190, -0.137)


def render_zoom(setup: Setup) -> Table:
    """Draw pictures of the snake with decreasing fields of view."""
    snake, tiles = wd.meshes.snake(ventrals=65 if setup.quick else 130), []
    size = {"width": setup.pixels(420), "height": setup.pixels(250)}
    for fov in (12.2, 5.0, 2.0, 0.8):
        view = wd.View((-1.6, 2.2, 2.6), COLOURED, fov_y_deg=fov, **size)
        samples = 1 if setup.quick else 4
        image = wd.shade(snake, setup.natural, LIGHT, view, tolerance=3e-2, samples_per_pixel=samples, pigment=0.05)
        illuminated = np.where(image.illuminated[..., None], image.xyz, np.nan)
        tiles.append((f"{fov:g}° of view", image.xyz, RENDERED * exposure(illuminated)))
    return mosaic(setup, "render_zoom", [tiles[:2], tiles[2:]], inch=4.2)


# Functions that write the report.


def save(setup: Setup, figure: Any, name: str) -> None:
    """Write a figure to a file of the folder of figures, and close it."""
    from matplotlib import pyplot as plt

    figure.tight_layout()
    figure.savefig(setup.folder / f"{name}.png", dpi=90)
    plt.close(figure)


# Functions that draw a figure and return its table. `OF_THE_SCAN` has the functions that require the scan file.
FIGURES: tuple[Callable[[Setup], Table], ...] = (blazed_periods, scan_periods, scan_windows, map_gratings, render_zoom)
OF_THE_SCAN = (scan_periods, scan_windows)


def main() -> int:
    """Write all figures and the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("thesis"), help="folder for the figures (default: thesis)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument("--quick", action="store_true", help="draw small figures in less than a minute")
    names = [make.__name__ for make in FIGURES]
    parser.add_argument("--only", choices=names, default=names, nargs="+", help="draw only these figures")
    options = parser.parse_args()
    import matplotlib as mpl

    mpl.use("Agg")
    raw = inputs.scan(options.data)
    if raw is None:
        print(f"The scan is not in {inputs.folder(options.data)}: its figures are skipped or show synthetic fingers")
    options.output.mkdir(parents=True, exist_ok=True)
    setup = Setup(options.output, options.quick, raw)
    report, *sections = TEXT.read_text(encoding="utf-8").split("\n## ")
    for make, section in zip(FIGURES, sections, strict=True):
        if make.__name__ not in options.only or (make in OF_THE_SCAN and raw is None):
            continue
        begin = time.perf_counter()
        rows = ["| " + " | ".join(row) + " |" for row in make(setup)]
        rows[1:1] = ["| --- " * (rows[0].count("|") - 1) + "|"] if rows else []
        report += "\n## " + section.replace("<!-- table -->", "\n".join(rows))
        print(f"{options.output / make.__name__}.png  ({time.perf_counter() - begin:.0f} s)", flush=True)
    (options.output / "report.md").write_text(report, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
