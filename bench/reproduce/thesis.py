"""The published evaluation, reproduced: periods measured by diffraction, BRDF maps and renderings, one figure each.

Single, *An Interactive Shader for Natural Diffraction Gratings* (Bern 2014), is compared with this library. The tables
contain the published numbers; ``variants`` computes the published methods. The text below each figure states and
explains the differences. All figures are on one page, ``index.html``, and in one picture, ``contact_sheet.png``.

Periods: the angle of incidence is 75°. At each of 401 wavelengths the view angle of the brightest first order is
searched on a grid, and the grating equation gives a period, d = λ/(sin θi + sin θr). The tables contain its mean and
variance over the wavelengths. Masking is off, because it shifts peaks.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import html
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.reproduce import variants
from warpdiff.optics import colorimetry, reflectance_factors

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

WAVELENGTHS = np.arange(380.0, 781.0)
INCIDENCE_DEG = 75.0
GRID_DEG = 0.0025
# Search range of an order, as factors on the expected period: neighbouring orders look like half of it.
SOUGHT = 1.3
BLAZED_UM, BLAZED_DEPTH_UM, SCAN_PERIOD_UM = 2.5, 0.25, 1.1
# Means and variances over the wavelengths [nm, nm²], as published.
PUBLISHED = {
    ("blazed", "full"): "2499.997 (0.377)",
    ("blazed", "periods"): "2502.428 (0.390); in the author's log 2491.862 (248.044)",
    ("scan", "full"): "1144.262 (0.401)",
    ("scan", "periods"): "1052.308 (49.678)",
}
PUBLISHED_SCAN_NM = 1144.262
CENTRED, SEAM = wd.Coherence("centred"), wd.Coherence("centred", centre_um=(0.0, 0.0))
FLOOR = "3 × 3 by floor, on the seam"

# Differences from the published results, and their reasons.
BLAZED_DIFFERS = (
    "Full sampling agrees within 0.3 nm. Its variance is smaller, because the grid of angles is fine: 0.0025° "
    "correspond to 0.4 nm at 380 nm. The remaining difference is the slope of the gain over the lobe of an order, "
    "which changes sign with the side of the light. Periods agree equally well without interpolation. The published "
    "excess of 2.4 nm is due to interpolation: the coefficients of a blaze are stronger on one side of an order "
    "than on the other, and shift the peak. Linear interpolation finds nearly the published mean. None of the "
    "methods reproduces the variance of 248 in the author's log, 16 nm."
)
SCAN_DIFFERS = (
    "The published 1144 nm is the result of one window on the patch's seam: the transform's origin lies in the "
    "corner, and the published sum has no phase that moves the window. The same sum, 3 × 3 coefficients by floor(), "
    "finds it here, levelled or not. The averaged form does not depend on a position. Its strongest first order "
    "lies elsewhere, and at another place for light from the other side: heights are not small compared with a "
    "wavelength, so opposite orders differ. Two lines are nearly equal there, and the peak changes from one to the "
    "other along the spectrum. A variance below a nm² means that all wavelengths find the same line of speckle, not "
    "that the period is known with this accuracy. The published value by periods, 1052 nm with a deviation of 7 nm, "
    "is not reproduced: without interpolation, and with linear interpolation, periods find the line of the averaged "
    "form. The sinc lacks a phase, too. It is the transform of the patch with its halves swapped, which finds the "
    "seam's line again."
)
WINDOWS_DIFFER = (
    "The published result is one number. These maps show windows at many positions of the scan, each by the median "
    "over the wavelengths. One window distinguishes periods that differ by d²/(2√2πσ), 8 nm, but the periods spread "
    "over 150 nm, in a few groups. The fingers are not evenly spaced: the scan's spectrum around its first order is "
    "a family of lines (right). Position and phase, that is speckle, decide which line is the brightest under a "
    "window. The published value lies in one group, that of the windows near the seam and of some others. A single "
    "period for this skin is the middle of a distribution with a width of a tenth of it, whatever digits a peak "
    "search gives."
)
REPLICAS_DIFFER = (
    "Whole periods of a crop are a grating with the crop's side L, and reflect at L/r alone (grey). For a blazed "
    "grating, cropped to whole periods, that is correct. A natural grating is not periodic: the period that is "
    "found jumps by a tenth when the crop changes by a micrometre, while a window of the same size and position "
    "hardly changes. On the right there is darkness between lines where the skin has none. A published value by "
    "periods is therefore a value of its crop."
)
GRATINGS_DIFFER = (
    "Exposures and the conversion to sRGB are ours, because the published ones are not documented: relative to the "
    "99th percentile of luminance. A pixel is the mean of 3 × 3 directions. One-dimensional gratings reflect on a "
    "line with the width of the window's lobe, 0.2°, which a narrow window widens. The illuminant is D65, applied "
    "once, before the integral."
)
STEPS_DIFFER = (
    "The published method is a plain sum over equal steps. The library uses the same number of samples, equally "
    "spaced in 1/λ, with weights of cubic interpolation. Numbers are errors against a converged map. An order "
    "passes within 1 to 5 nm, so a step of 10 nm loses orders between samples, which no weights can restore: noise "
    "on the scan, gaps in the spectra of the blaze. Therefore the number of wavelengths follows from a tolerance "
    "here, and is not an option."
)
SIGMAS_DIFFER = (
    "Averaged over the window's position, maps become smooth as σ decreases. Under one window, as published, they "
    "keep its speckle, with grains of the lobe's size, 1/σ. Windows of 45 µm and more extend around the patch: "
    "coefficients at a distance of 1/65 µm separate, and it is dark between them. Single directions show this; "
    "these pixels, means of 3 × 3, do not. Such maps no longer describe the skin, and both forms are equal."
)
TERMS_DIFFER = (
    "N is the largest power. Numbers are errors against a converged map. The published series counts heights from "
    "the lowest one, which doubles the argument to 2π · 2/0.38 · 0.38 = 12: it diverges up to N = 12, before it "
    "converges. 25 terms are wrong near the mirror direction, where the published bound promised 9e-8. With heights "
    "counted from the middle of their range, half of the terms are sufficient. Float32 is no limit at this height."
)
INCIDENCES_DIFFER = (
    "The pattern moves with the mirror direction along −x in the sines of the angles, according to the grating "
    "equation. Its form changes only by the gain and w. The published formula has no masking, without which maps "
    "become bright at the rim."
)
METHODS_DIFFER = (
    "As published are the 3 × 3 coefficients by floor(), the periods by interpolation, and Stam's rainbow. All of "
    "these integrate over steps of 5 nm. Neighbours by floor() are a window on the seam, off centre by half a "
    "coefficient, with grains that no window has. Periods show the patch's own lattice. With linear interpolation, "
    "amplitudes of random phase are averaged, and grains lose light in between. Stam's analytic model has one "
    "period and no heights: lines of equal strength at all v. Its angles are correct for a regular grating, and "
    "meaningless for the skin. With CIE colours and the powers of the orders (Stam, cie) it equals the library on "
    "the blaze; on the others it excludes everything but the orders of the tracks. The periods of the blaze fill 65 "
    "µm."
)
ORDERS_DIFFER = (
    "The shortcut uses the wavelengths L|u|/n and L|v|/n at which an order of the patch falls on the direction, "
    "with equal weights. They are denser towards blue, as 1/λ²: a blue tint everywhere (Z in the table). Near the "
    "mirror direction there are few, with one or two wavelengths each: rings of pure red, purple and cyan, and "
    "black within |u| = 0.38/65, where there are none. Weights λ² remove the tint, but not the rings. Where "
    "coefficients overlap in a window there is light between them. The library integrates it, and is white around "
    "the mirror direction."
)
LIGHTS_DIFFER = (
    "The published pictures show another mesh, with a measured field of the fingers' directions; neither is "
    "available. The body is this library's snake, with the pattern of a corn snake. Shadows are traced. A pixel is "
    "the mean over its footprint, where the published shader uses the centre of the pixel."
)
ZOOM_DIFFERS = (
    "From far away a pixel covers all colours of a scale and shows their mean, near white. From near it shows the "
    "colours of single places, blue towards the highlight and red away from it. A shader that uses the centre of "
    "the pixel shows these colours from far away, too, as noise."
)
PIGMENT_DIFFERS = (
    "The pigment lies under the layer, in the same units. A white pigment has about 1e-4 of the mirror's "
    "brightness, like the orders. The published derivation has none. A factor of 0.05 makes it that of a dark skin."
)
TANGENTS_DIFFER = (
    "Dispersion across the body, like that of the fingers of the real skin, spreads colours to both sides of a "
    "highlight. Along the body it moves them along the highlight's line. The published field follows the measured "
    "fingers; here it follows the texture coordinates."
)
STAM_DIFFERS = (
    "As in the published comparison, the angles of Stam's shader are correct on the disc. Its rainbow approximates "
    "the spectrum by three parabolas, from 0.5 to 1 µm, and the strength of the orders is a free parameter. With "
    "CIE colours the spectra lie where those of the library lie, without the haze of the pits. On the skin it has "
    "lines of full colour, and colour where the library has none; the highlight's haze and the broad orders of an "
    "irregular grating are missing. Its pixels are points, without a mean over a footprint."
)


@dataclasses.dataclass(frozen=True)
class Figure:
    """A figure or table of the page.

    Attributes:
        name: Name of the file without suffix.
        title: Title of the figure.
        differs: Differences from the published result, and their reasons.
        table: Rows of cells of a table below the picture; the first is the header.
    """

    name: str
    title: str
    differs: str
    table: list[list[str]] = dataclasses.field(default_factory=list)


@dataclasses.dataclass(frozen=True)
class Setup:
    """Inputs of the figures.

    Attributes:
        folder: Folder of the figures.
        quick: Whether sizes are small.
        raw: Scan as measured; None if it is absent.
    """

    folder: Path
    quick: bool
    raw: wd.HeightField | None

    @functools.cached_property
    def scan(self) -> wd.HeightField | None:
        """The levelled scan."""
        return None if self.raw is None else self.raw.levelled(order=2)

    def subset(self, settings: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return all settings, or every third if quick."""
        return settings[:: 3 if self.quick else 1]

    def pixels(self, count: int) -> int:
        """Return a size in pixels, a third of it if quick; odd, so that a map has a row in the plane of incidence."""
        return (count // 3 if self.quick else count) | 1

    @functools.cached_property
    def natural(self) -> wd.HeightField:
        """Scan, its middle if quick, or synthetic fingers if it is absent."""
        if self.scan is None:
            return wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
        return self.scan.cropped(32.0) if self.quick else self.scan

    @property
    def natural_name(self) -> str:
        """Name of the natural surface."""
        return "fingers" if self.scan is None else "Elaphe"


def at_angle(degrees: ArrayLike) -> Floats:
    """Return unit vectors in the plane of incidence, at angles from the normal towards +x."""
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


def view_angles(longest_nm: float, shortest_nm: float, count: int, wavelength_nm: Floats) -> Floats:
    """Return view angles [degrees] of the first orders of periods [nm] between two."""
    sines = wavelength_nm / np.linspace(longest_nm, shortest_nm, count) - math.sin(math.radians(INCIDENCE_DEG))
    return np.degrees(np.arcsin(sines))


def periods_at(angles_deg: Floats, wavelengths_nm: Floats) -> Floats:
    """D = λ/(sin θi + sin θr) [nm] of the first order."""
    return wavelengths_nm / (math.sin(math.radians(INCIDENCE_DEG)) + np.sin(np.radians(angles_deg)))


def first_order(
    reflectance: Callable[[Floats, Floats, Floats], Floats],
    expected_um: float,
    *,
    wavelengths_nm: Floats = WAVELENGTHS,
    grid_deg: float = GRID_DEG,
) -> tuple[Floats, Floats, Floats]:
    """Find the brightest first order at each wavelength.

    Args:
        reflectance: ρ(to_light, to_view, wavelengths_nm), shape (n, m).
        expected_um: Expected period [µm].
        wavelengths_nm: Wavelengths [nm], shape (m,).
        grid_deg: Step of the view angles [degrees].

    Returns:
        View angles [degrees], (n,); ρ, (n, m); view angles of the largest ρ [degrees], (m,).
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
    """Return the library's ρ for :func:`first_order`; ``opposite`` rotates light and views by 180° about the normal."""
    rotated = np.array([-1.0, -1.0, 1.0]) if opposite else np.ones(3)
    return lambda light, views, wavelengths: wd.spectral_reflectance(
        heightfield, light * rotated, views * rotated, wavelengths, masking=False, **options
    )


def blazed_period(**options: Any) -> Floats:
    """Return periods [nm] of the blazed grating; options are those of ``wd.spectral_reflectance``."""
    heightfield = wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM)
    return periods_at(first_order(library(heightfield, **options), BLAZED_UM)[2], WAVELENGTHS)


def written(periods: Floats) -> str:
    """Return mean and variance as text, in the published format."""
    return f"{periods.mean():.3f} ({periods.var():.3f})"


# Periods.


def methods_of(
    heightfield: wd.HeightField, raw: wd.HeightField | None, *, periods: tuple[int, int]
) -> dict[str, tuple[str, Any, float]]:
    """Return methods by name: kind of published number, ρ, and the step of the grid [degrees]."""
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
        FLOOR: ("full", functools.partial(variants.neighbours, heightfield, masking=False), coarse),
        "source of 0.53°": ("full", library(heightfield, coherence=wd.Coherence("source"), strict=False), GRID_DEG),
        f"{many}, exact": ("periods", library(heightfield, coherence=repeated, tolerance=1e-3, strict=False), GRID_DEG),
    }  # fmt: skip
    if raw is not None:
        result["centred on the seam, not levelled"] = ("full", library(raw, coherence=SEAM, strict=False), GRID_DEG)
    for interpolation in ("linear", "sinc"):
        rho = functools.partial(
            variants.periods, heightfield, count=periods, interpolation=interpolation, masking=False
        )
        result[f"{many}, {interpolation}"] = ("periods", rho, coarse)
    return result


def period_figure(
    setup: Setup,
    name: str,
    heightfield: wd.HeightField,
    expected_um: float,
    shown: list[str],
    *,
    counts: tuple[int, int],
    raw: wd.HeightField | None = None,
) -> tuple[Any, list[list[str]]]:
    """Draw reflectance over wavelength and angle for the shown methods, and return the table of all methods."""
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
    return figure, rows


def blazed_periods(setup: Setup) -> Figure:
    """Periods of the blazed grating."""
    shown = ["averaged, low-rank", FLOOR, "1 × 26 periods, exact", "1 × 26 periods, linear"]
    heightfield = wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM)
    figure, table = period_figure(setup, "blazed", heightfield, BLAZED_UM, shown, counts=(1, 26))
    description = Figure("periods_blazed", "Periods: a blazed grating of 2500 nm", BLAZED_DIFFERS, table)
    return save(setup, figure, description)


def scan_periods(setup: Setup) -> Figure:
    """Periods of the scan."""
    shown = ["averaged, low-rank", "centred on the middle", "centred on the seam", FLOOR, "1 × 1 periods, linear"]
    figure, table = period_figure(setup, "scan", setup.scan, SCAN_PERIOD_UM, shown, counts=(1, 1), raw=setup.raw)
    return save(setup, figure, Figure("periods_scan", "Periods: the scan of Elaphe", SCAN_DIFFERS, table))


def scan_windows(setup: Setup) -> Figure:
    """The first-order period under windows all over the scan."""
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
    return save(
        setup, figure, Figure("scan_windows", "The period depends on the position of the window", WINDOWS_DIFFER, rows)
    )


def scan_replicas(setup: Setup) -> Figure:
    """Whole periods of a natural grating: the measured period is that of the crop."""
    from matplotlib import pyplot as plt

    heightfield, wavelengths = setup.scan, np.array([450.0, 550.0, 650.0])
    sizes = np.arange(24.0, 65.1, 20.0 if setup.quick else 1.5)
    replicas = wd.Coherence("replicas", periods=(4, 4))

    def period(cut: wd.HeightField, coherence: wd.Coherence) -> float:
        rho = library(cut, coherence=coherence, strict=False)
        best = first_order(rho, SCAN_PERIOD_UM, wavelengths_nm=wavelengths, grid_deg=0.01)[2]
        return float(np.median(periods_at(best, wavelengths)))

    curves = {
        "4 × 4 periods of a crop": [period(heightfield.cropped(size), replicas) for size in sizes],
        # A smooth window of the same size, without replication.
        "one window, σ a quarter of the crop": [
            period(heightfield, wd.Coherence("centred", size / 4.0)) for size in sizes
        ],
    }
    figure, axes = plt.subplots(1, 2, figsize=(14.0, 4.8))
    rows = [["24 to 65 µm", "mean (variance) [nm, nm²]", "distance from L/r, mean, 0 … 0.5 orders"]]
    for (label, periods), colour in zip(curves.items(), ("#c51b7d", "black"), strict=True):
        axes[0].plot(sizes, periods, "o", color=colour, markersize=4, label=label)
        orders = 1e3 * sizes / np.array(periods)
        rows.append([label, written(np.array(periods)), f"{np.abs(orders - np.rint(orders)).mean():.3f}"])
    for order in range(18, 73):
        axes[0].plot(sizes, 1e3 * sizes / order, color="#bbbbbb", lw=0.6, zorder=0)
    angles, green = view_angles(1250.0, 950.0, 3000, np.array(550.0)), np.array([550.0])
    for coherence, colour in ((replicas, "#c51b7d"), (wd.Coherence(), "black")):
        rho = library(heightfield, coherence=coherence, strict=False)(at_angle(INCIDENCE_DEG), at_angle(angles), green)[
            :, 0
        ]
        axes[1].plot(periods_at(angles, green), rho / rho.max(), color=colour, lw=1.0, label=str(coherence))
    axes[0].set(xlabel="side L of the crop [µm]; grey: L/r", ylabel="measured period [nm]", ylim=(900.0, 1300.0))
    axes[1].set(xlabel="period of the first order [nm]", ylabel="reflectance at 550 nm, of the largest")
    for axis in axes:
        axis.legend(fontsize=8, loc="upper right")
    return save(
        setup, figure, Figure("scan_replicas", "Whole periods have the periods of the crop", REPLICAS_DIFFER, rows)
    )


# Maps.


@dataclasses.dataclass(frozen=True)
class Disc:
    """Pixels of ``wd.reflectance_map`` as directions, for maps that the library does not make.

    Attributes:
        size: Width and height [pixels].
        mask: Pixels within the disc, shape (size, size).
        views: Directions of these pixels, shape (n, 3).
    """

    size: int
    mask: NDArray[np.bool_]
    views: Floats

    @classmethod
    def of(cls, size: int, *, extent: float = 1.0) -> Disc:
        """Return the disc of all directions, or its square of −extent … extent."""
        axis = extent * ((2.0 * np.arange(size) + 1.0) / size - 1.0)
        x, y = np.meshgrid(axis, -axis)
        mask = x * x + y * y < 1.0
        views = np.stack([x[mask], y[mask], np.sqrt(1.0 - x[mask] ** 2 - y[mask] ** 2)], axis=1)
        return cls(size, mask, views)

    def image(self, xyz: Floats) -> Floats:
        """Return a picture of colours (n, 3), nan outside."""
        result = np.full((self.size, self.size, 3), np.nan)
        result[self.mask] = xyz
        return result


LIGHT = np.array([0.0, 0.0, 1.0])
STEPS_NM = (1, 5, 10, 25, 50, 100)
SIGMAS_UM = (3.25, 6.5, 15.0, 30.0, 45.0, 65.0)
# The largest powers n of the published series, whose first is 0.
TAYLOR = (0, 1, 4, 9, 10, 23, 25, 39)
# Exposures, as the demonstration's: gratings of one dimension have all their light on a line.
LINE, AREA = 0.04, 3.0
STRIP = 0.1


def of_map(image: wd.Image) -> Floats:
    """Return XYZ of a map, nan outside."""
    return np.where(image.coverage[..., None] == 1.0, image.xyz.astype(np.float64), np.nan)


def mean_map(setup: Setup, heightfield: wd.HeightField, light: Floats, pixels: int, **options: Any) -> Floats:
    """Return XYZ of a map, each pixel the mean of 3 × 3 directions (one if quick), nan outside."""
    samples = 1 if setup.quick else 9
    return of_map(
        wd.reflectance_map(heightfield, light, size=setup.pixels(pixels), samples_per_pixel=samples, **options)
    )


def exposure(xyz: Floats) -> float:
    """Return 1 over the 99th percentile of luminance, or over the largest if that is 0."""
    return 1.0 / float(np.nanpercentile(xyz[..., 1], 99.0) or np.nanmax(xyz[..., 1]))


def strip(xyz: Floats) -> Floats:
    """Return the middle rows of a map."""
    half = len(xyz) / 2.0
    return xyz[math.floor(half * (1.0 - STRIP)) : math.ceil(half * (1.0 + STRIP))]


def error_of(xyz: Floats, exact: Floats) -> str:
    """P99 of ‖ΔXYZ‖ / max(‖XYZ‖, a thousandth of the 99th percentile of Y)."""
    least = 1e-3 * np.nanpercentile(exact[..., 1], 99.0)
    difference = np.linalg.norm(xyz - exact, axis=-1) / np.maximum(np.linalg.norm(exact, axis=-1), least)
    return f"{np.nanpercentile(difference, 99.0):.1e}"


def mosaic(
    setup: Setup, description: Figure, rows: list[tuple[str, list[tuple[str, Floats, float]]]], *, inch: float
) -> Figure:
    """Draw rows of pictures, each a label, XYZ with nan where it is transparent, and an exposure."""
    from matplotlib import pyplot as plt

    columns = max(len(row) for _, row in rows)
    shapes = [row[0][1].shape for _, row in rows]
    heights = [shape[0] / shape[1] + 0.16 for shape in shapes]
    figure, axes = plt.subplots(
        len(rows), columns, squeeze=False, figsize=(inch * columns + 0.3, inch * sum(heights)), height_ratios=heights
    )
    for line, (title, row) in zip(axes, rows, strict=True):
        for axis in line:
            axis.axis("off")
        line[0].text(-0.04, 0.5, title, transform=line[0].transAxes, rotation=90, ha="right", va="center", fontsize=9)
        for axis, (label, xyz, factor) in zip(line, row, strict=False):
            colours = colorimetry.srgb_encode(
                colorimetry.xyz_to_rgb(factor * np.nan_to_num(xyz, posinf=1e9, neginf=0.0))
            )
            alpha = ~np.isnan(xyz[..., :1])
            axis.imshow(np.concatenate([np.clip(colours, 0.0, 1.0), alpha], axis=2), interpolation="nearest")
            axis.set_title(label, fontsize=8, pad=3)
    return save(setup, figure, description)


def map_gratings(setup: Setup) -> Figure:
    """Maps of gratings."""
    fields = {
        "sine, 2 µm, 0.3 deep": (wd.gratings.sinusoidal(2.0, 0.3), LINE),
        "square, 2 µm, 0.12 deep": (wd.gratings.lamellar(2.0, 0.12), LINE),
        "blazed, 2.5 µm, 0.25 deep": (wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), LINE),
        "bumps, 2 × 1 µm": (wd.gratings.bumps(), LINE),
        "CD": (wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08), AREA),
        "DVD": (wd.gratings.disc("DVD"), AREA),
        "fingers": (wd.gratings.fingers(size_um=32.0, pitch_um=0.08), AREA),
        setup.natural_name: (setup.natural, AREA),
    }
    tiles = []
    for name, (heightfield, factor) in fields.items():
        xyz = mean_map(setup, heightfield, LIGHT, 300)
        tiles.append((name, xyz, factor * exposure(xyz)))
    return mosaic(
        setup, Figure("map_gratings", "Maps: gratings", GRATINGS_DIFFER), [("", tiles[:4]), ("", tiles[4:])], inch=3.0
    )


def map_steps(setup: Setup) -> Figure:
    """Maps by wavelength steps: the published sum, and the library's weights for the same number of samples."""
    disc = Disc.of(setup.pixels(210))
    rows, table = [], [["P99 of the error", *(f"{step} nm" for step in STEPS_NM)]]
    for name, heightfield, cut, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), strip, LINE),
        (setup.natural_name, setup.natural, np.asarray, AREA),
    ):
        exact = of_map(wd.reflectance_map(heightfield, LIGHT, size=disc.size, tolerance=1e-3))
        exposed = factor * exposure(exact)
        rho = wd.spectral_reflectance(heightfield, LIGHT, disc.views, WAVELENGTHS, tolerance=1e-3)
        plan = wd.plan(heightfield, LIGHT, method="low-rank", tolerance=1e-3, strict=False)
        published, ours = [], []
        for step in STEPS_NM:
            products = colorimetry.colour_products()[::step]
            published.append(disc.image(rho[:, ::step] @ (products / products[:, 1].sum())))
            fewer = dataclasses.replace(
                plan, wavelengths=400 // step + 1, adaptive=False, rings_per_octave=0, footprint=False
            )
            ours.append(of_map(wd.reflectance_map(heightfield, LIGHT, size=disc.size, plan=fewer)))
        for title, images in (("plain sum", published), ("library", ours)):
            labels = [f"{step} nm: {error_of(image, exact)}" for step, image in zip(STEPS_NM, images, strict=True)]
            tiles = [(label, cut(image), exposed) for label, image in zip(labels, images, strict=True)]
            rows.append((f"{name}\n{title}", tiles))
            table.append([f"{name}, {title}", *(label.split(": ")[1] for label in labels)])
    return mosaic(setup, Figure("map_steps", "Maps: wavelength steps", STEPS_DIFFER, table), rows, inch=2.2)


def map_sigmas(setup: Setup) -> Figure:
    """Maps by the width of the window."""
    rows = []
    for name, heightfield, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), LINE),
        (setup.natural_name, setup.natural, AREA),
    ):
        for kind in ("averaged", "centred"):
            tiles = []
            for sigma in setup.subset(SIGMAS_UM):
                options = {"coherence": wd.Coherence(kind, sigma), "tolerance": 3e-2, "strict": False}
                xyz = mean_map(setup, heightfield, LIGHT, 210, **options)
                tiles.append((f"σ = {sigma:g} µm", xyz, factor * exposure(xyz)))
            rows.append((f"{name}\n{kind}", tiles))
            if name == "blazed":
                break
    return mosaic(setup, Figure("map_sigmas", "Maps: widths of the window", SIGMAS_DIFFER), rows, inch=2.2)


def map_terms(setup: Setup) -> Figure:
    """Maps by the terms of the Taylor series, with heights as published, and centred."""
    heightfield, size = setup.natural, setup.pixels(180)
    exact = of_map(wd.reflectance_map(heightfield, LIGHT, size=size, tolerance=1e-3))
    rows, table = [], [["P99 of the error", *(f"N = {last}" for last in setup.subset(TAYLOR))]]
    for title, method in (("as published", "taylor-uncentred"), ("centred", "taylor")):
        plan = wd.plan(heightfield, LIGHT, method=method, tolerance=1e-3, strict=False)
        tiles, errors = [], []
        for last in setup.subset(TAYLOR):
            fewer = dataclasses.replace(plan, terms=last + 1, adaptive=False, rings_per_octave=0, footprint=False)
            image = of_map(wd.reflectance_map(heightfield, LIGHT, size=size, plan=fewer))
            errors.append(error_of(image, exact))
            tiles.append((f"N = {last}: {errors[-1]}", image, AREA * exposure(exact)))
        rows.append((title, tiles))
        table.append([title, *errors])
    return mosaic(setup, Figure("map_terms", "Maps: terms of the Taylor series", TERMS_DIFFER, table), rows, inch=1.9)


def map_incidences(setup: Setup) -> Figure:
    """Maps by the angle of incidence."""
    rows = []
    for name, heightfield, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), LINE),
        (setup.natural_name, setup.natural, AREA),
    ):
        tiles = []
        for angle in setup.subset((0.0, 10.0, 20.0)):
            xyz = mean_map(setup, heightfield, at_angle(angle), 300)
            tiles.append((f"{angle:g}°", xyz, factor * exposure(xyz)))
        rows.append((name, tiles))
    return mosaic(setup, Figure("map_incidences", "Maps: angles of incidence", INCIDENCES_DIFFER), rows, inch=3.0)


def map_methods(setup: Setup) -> Figure:
    """Maps by full sampling, periods and Stam's analytic model."""
    disc = Disc.of(setup.pixels(120))
    wavelengths = WAVELENGTHS[:: 20 if setup.quick else 5]
    weights = colorimetry.quadrature_weights(wavelengths)
    scattering_vectors = -LIGHT - disc.views
    gains = reflectance_factors.gain(
        np.broadcast_to(LIGHT, disc.views.shape), disc.views, normal=reflectance_factors.normal_reflectance(1.5),
        masking=True,
    )  # fmt: skip
    rows = []
    for name, heightfield, periods, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), (1625, 26), LINE),
        ("CD", wd.gratings.disc("CD"), (2, 2), AREA),
        (setup.natural_name, setup.natural, (1, 1), AREA),
    ):
        images = {
            "averaged": of_map(wd.reflectance_map(heightfield, LIGHT, size=disc.size)),
            "centred": of_map(
                wd.reflectance_map(heightfield, LIGHT, size=disc.size, coherence=wd.Coherence("centred"))
            ),
            "3 × 3 by floor": disc.image(variants.neighbours(heightfield, LIGHT, disc.views, wavelengths) @ weights),
        }
        many = wd.Coherence("replicas", periods=periods)
        images["periods, exact"] = of_map(
            wd.reflectance_map(heightfield, LIGHT, size=disc.size, coherence=many, tolerance=3e-2)
        )
        for how in ("linear", "sinc"):
            rho = variants.periods(heightfield, LIGHT, disc.views, wavelengths, count=periods, interpolation=how)
            images[f"periods, {how}"] = disc.image(rho @ weights)
        for colours in ("rainbow", "cie"):
            xyz = variants.stam_directions(heightfield, scattering_vectors, gains, colours=colours)
            images[f"Stam, {colours}"] = disc.image(xyz)
        # The rainbow has the exposure of the exact colours; its own highest percentile is a white highlight.
        exposures = {label: exposure(image) for label, image in images.items()}
        exposures["Stam, rainbow"] = exposures["averaged"]
        rows.append((name, [(label, image, factor * exposures[label]) for label, image in images.items()]))
    return mosaic(setup, Figure("map_methods", "Maps: methods", METHODS_DIFFER), rows, inch=1.9)


def map_orders(setup: Setup) -> Figure:
    """Maps by the wavelengths of orders, and by the library."""
    heightfield = setup.natural
    rows = []
    table = [["mean colour, Y = 1: X, Z", "whole disc", "within 0.05 to 0.25 of the mirror direction"]]
    colours: dict[str, list[str]] = {}
    for name, extent in (("whole disc", 1.0), ("around the mirror direction", 0.25)):
        disc = Disc.of(setup.pixels(240), extent=extent)
        rho = wd.spectral_reflectance(heightfield, LIGHT, disc.views, WAVELENGTHS, tolerance=1e-3)
        scattering_vectors = -LIGHT - disc.views
        images = {
            "where orders fall": variants.order_colour(rho, scattering_vectors, heightfield.size_um),
            "the same, weighted by λ²": variants.order_colour(
                rho, scattering_vectors, heightfield.size_um, jacobian=True
            ),
            "library": wd.reflectance(heightfield, LIGHT, disc.views),
        }
        radius = np.hypot(disc.views[:, 0], disc.views[:, 1])
        chosen = (radius > 0.05) & (radius < extent)
        for label, xyz in images.items():
            # Directions have equal weights, or the tail of the mirror reflection would dominate.
            mean = (xyz[chosen] / np.maximum(xyz[chosen, 1:2], 1e-12)).clip(0.0, 10.0).mean(axis=0)
            colours.setdefault(label, []).append(f"{mean[0]:.2f}, {mean[2]:.2f}")
        exposed = AREA * exposure(disc.image(images["library"])) * (1.0 if extent == 1.0 else 0.3)
        rows.append((name, [(label, disc.image(xyz), exposed) for label, xyz in images.items()]))
    table += [[label, *values] for label, values in colours.items()]
    return mosaic(
        setup, Figure("map_orders", "Maps: wavelengths at which an order falls", ORDERS_DIFFER, table), rows, inch=3.0
    )


# Renderings.


def renderings(setup: Setup, description: Figure, views: list[tuple[str, dict[str, Any]]]) -> Figure:
    """Draw renderings of the snake from labels and arguments of ``wd.shade`` that differ from the usual ones."""
    tiles = []
    for label, options in views:
        arguments: dict[str, Any] = {
            "mesh": snake(setup), "heightfield": setup.natural, "lights": LIGHTS["right, behind"],
            "view": camera(setup), "tolerance": 3e-2, "samples_per_pixel": 1 if setup.quick else 4, "pigment": 0.05,
        }  # fmt: skip
        image = wd.shade(**(arguments | options))
        tiles.append((label, image.xyz, RENDERED * exposure(np.where(image.illuminated[..., None], image.xyz, np.nan))))
    rows = [("", tiles[first : first + 2]) for first in range(0, len(tiles), 2)]
    return mosaic(setup, description, rows, inch=4.2)


LIGHTS = {
    "left, behind": wd.DirectionalLight((-0.9, 0.7, 0.5)), "right, behind": wd.DirectionalLight((0.5, 0.75, -0.8)),
    "above": wd.DirectionalLight((0.0, 1.0, 0.1)), "front": wd.DirectionalLight((0.1, 0.6, 1.0)),
}  # fmt: skip
RENDERED = 10.0
# Position on the back at which an order is visible.
COLOURED = (-0.453, 0.190, -0.137)


@functools.cache
def body(tangent: str, ventrals: int) -> Any:
    """Return the snake."""
    return wd.meshes.snake(tangent=tangent, ventrals=ventrals)


def snake(setup: Setup, tangent: str = "around") -> Any:
    """Return the snake, with fewer scales if quick."""
    return body(tangent, 65 if setup.quick else 130)


def camera(setup: Setup, target: tuple[float, float, float] = (-0.56, 0.06, 0.07), fov_deg: float = 12.2) -> wd.View:
    """Return the view of the front half of the snake, or a closer one."""
    return wd.View((-1.6, 2.2, 2.6), target, fov_y_deg=fov_deg, width=setup.pixels(420), height=setup.pixels(250))


def render_lights(setup: Setup) -> Figure:
    """Renderings by the direction of the light."""
    return renderings(
        setup,
        Figure("render_lights", "Renderings: light from several directions", LIGHTS_DIFFER),
        [(name, {"lights": light, "pigment": 0.01}) for name, light in setup.subset(tuple(LIGHTS.items()))],
    )


def render_zoom(setup: Setup) -> Figure:
    """Renderings from decreasing distances."""
    views = [(f"{fov:g}° of view", {"view": camera(setup, COLOURED, fov)}) for fov in (12.2, 5.0, 2.0, 0.8)]
    return renderings(setup, Figure("render_zoom", "Renderings: decreasing distance", ZOOM_DIFFERS), views)


def render_pigment(setup: Setup) -> Figure:
    """Renderings with and without the texture."""
    views = [("pigment, 0.05", {}), ("no pigment", {"pigment": 0.0})]
    return renderings(
        setup, Figure("render_pigment", "Renderings: with the pigment's texture and without", PIGMENT_DIFFERS), views
    )


def render_tangents(setup: Setup) -> Figure:
    """Renderings with the tangent field around the body and along it."""
    views = [
        (f"dispersion {tangent} the body", {"mesh": snake(setup, tangent), "pigment": 0.0})
        for tangent in ("around", "along")
    ]
    return renderings(
        setup,
        Figure("render_tangents", "Renderings: tangent field across the body and along it", TANGENTS_DIFFER),
        views,
    )


def render_stam(setup: Setup) -> Figure:
    """Renderings by Stam's analytic model and by the library, on a disc and on the skin."""
    side = setup.pixels(260)
    of_disc = wd.View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=40.0, width=side, height=side * 7 // 10)
    cd = wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08)
    rows = []
    for name, mesh, heightfield, light, view, factor in (
        ("CD", wd.meshes.disc(), cd, wd.DirectionalLight((0.15, 0.9, 1.0)), of_disc, 6.0),
        ("skin", snake(setup), setup.natural, LIGHTS["right, behind"], camera(setup), RENDERED),
    ):
        image = wd.shade(mesh, heightfield, light, view, pigment=0.0, tolerance=3e-2)
        colours = {
            f"Stam, {how}": variants.stam_picture(mesh, heightfield, light, view, colours=how)
            for how in ("rainbow", "cie")
        }
        colours["library"] = image.xyz
        tiles = []
        for label, xyz in colours.items():
            exposed = factor * exposure(np.where(image.illuminated[..., None], xyz, np.nan))
            tiles.append((label, xyz, exposed))
        rows.append((name, tiles))
    return mosaic(
        setup, Figure("render_stam", "Renderings: Stam's analytic model and the library", STAM_DIFFERS), rows, inch=4.0,
    )  # fmt: skip


# The page.


def save(setup: Setup, figure: Any, description: Figure) -> Figure:
    """Write a figure and close it; returns its description."""
    from matplotlib import pyplot as plt

    figure.suptitle(description.title, fontsize=12)
    figure.tight_layout()
    figure.savefig(setup.folder / f"{description.name}.png", dpi=90)
    plt.close(figure)
    return description


# Functions that draw the figures, and whether they require the scan.
SECTIONS: tuple[tuple[Callable[[Setup], Figure], bool], ...] = (
    (blazed_periods, False), (scan_periods, True), (scan_windows, True), (scan_replicas, True), (map_gratings, False),
    (map_steps, False), (map_sigmas, False), (map_terms, False), (map_incidences, False), (map_methods, False),
    (map_orders, False), (render_lights, False), (render_zoom, False), (render_pigment, False),
    (render_tangents, False), (render_stam, False),
)  # fmt: skip


def contact_sheet(setup: Setup, figures: list[Figure]) -> None:
    """Write all figures into one picture, each in the shortest column."""
    from PIL import Image

    columns, width, gap = 3, 900, 24
    ends, placed = [0] * columns, []
    for figure in figures:
        with Image.open(setup.folder / f"{figure.name}.png") as picture:
            small = picture.convert("RGB").resize((width, round(picture.height * width / picture.width)), Image.LANCZOS)
        column = int(np.argmin(ends))
        placed.append((small, (column * (width + gap), ends[column])))
        ends[column] += small.height + gap
    sheet = Image.new("RGB", (columns * (width + gap) - gap, max(ends)), "white")
    for small, at in placed:
        sheet.paste(small, at)
    sheet.save(setup.folder / "contact_sheet.png")


def page(figures: list[Figure]) -> str:
    """Return the page of all figures in HTML."""
    parts = [
        "<!doctype html><meta charset='utf-8'><title>The published evaluation, reproduced</title>",
        "<style>body{font:15px sans-serif;max-width:1200px;margin:2em auto}img{max-width:100%}</style>",
        "<style>td,th{padding:.2em .8em;text-align:left;border-bottom:1px solid #ccc}</style>",
        "<h1>The published evaluation, reproduced</h1>",
    ]
    for figure in figures:
        parts.append(
            f"<h2>{html.escape(figure.title)}</h2><img src='{figure.name}.png' alt='{html.escape(figure.title)}'>"
        )
        for at, row in enumerate(figure.table):
            tag = "td" if at else "th"
            cells = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
            parts.append(("" if at else "<table>") + f"<tr>{cells}</tr>")
        parts.append("</table>" if figure.table else "")
        parts.append(f"<p><b>Differences and their reasons.</b> {html.escape(figure.differs)}</p>")
    return "\n".join(parts)


def main() -> int:
    """Write all figures and the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("thesis"), help="folder for the figures (thesis)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument("--quick", action="store_true", help="small sizes, in less than a minute")
    parser.add_argument(
        "--only", choices=[function.__name__ for function, _ in SECTIONS], nargs="+", help="only these figures"
    )
    options = parser.parse_args()
    import matplotlib as mpl

    mpl.use("Agg")
    raw = inputs.scan(options.data)
    if raw is None:
        print(f"The scan is not in {inputs.folder(options.data)}: figures are skipped or show synthetic fingers")
    options.output.mkdir(parents=True, exist_ok=True)
    setup = Setup(options.output, options.quick, raw)
    figures = []
    for make, needs_scan in SECTIONS:
        if (needs_scan and raw is None) or make.__name__ not in (options.only or [make.__name__]):
            continue
        begin = time.perf_counter()
        figures.append(make(setup))
        print(f"{options.output / figures[-1].name}.png  {figures[-1].title}  ({time.perf_counter() - begin:.0f} s)")
        for row in figures[-1].table:
            print("| " + " | ".join(row) + " |", flush=True)
    contact_sheet(setup, figures)
    (options.output / "index.html").write_text(page(figures), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
