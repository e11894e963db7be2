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
# An order is sought between these shares of the period that is expected: neighbouring orders look like half of it.
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
SEAM = wd.Coherence("centred", centre_um=(0.0, 0.0))
FLOOR = "3 × 3 by floor, on the seam"

# What differs from the published result, and why.
BLAZED_DIFFERS = (
    "Full sampling agrees within 0.3 nm, and its variance is smaller, as the grid of angles is fine: 0.0025° are 0.4 "
    "nm at 380 nm. What is left is the slope of the gain over an order's lobe, which changes sign with the side of "
    "the light. Copies agree just as well if nothing is interpolated. The published 2.4 nm too much of copies is the "
    "interpolation's: a blaze has stronger coefficients on one side of an order than on the other, and those pull the "
    "peak. Linear interpolation finds nearly the published mean. The variance of 248 in the author's log, 16 nm, is "
    "reproduced by none of these ways."
)
SCAN_DIFFERS = (
    "The published 1144 nm is what one window on the patch's seam sees: the transform's origin lies in the corner, "
    "and the published sum has no phase that moves the window away. The same sum, 3 × 3 coefficients by floor(), "
    "finds it here, levelled or not. The averaged form, which no position enters, has its strongest first order "
    "elsewhere, and another one with light from the other side: heights are no small part of a wavelength, so that "
    "opposite orders differ, and there two lines are so equal that the peak moves from one to the other along the "
    "spectrum. A variance below a nm² says that all wavelengths find the same line of speckle, not that the period is "
    "known as well. The published number of copies, 1052 nm with a deviation of 7 nm, is not reproduced: without "
    "interpolation, and linearly, they find the averaged form's line. The sinc lacks a phase, too, and is the "
    "transform of the patch with its halves swapped, which finds the seam's line again."
)
WINDOWS_DIFFER = (
    "Published is one number; here are windows all over the scan, each by the median over the wavelengths. One window "
    "tells periods apart by d²/(2√2πσ), 8 nm, and they spread over 150 nm, in a few groups: fingers do not stand "
    "evenly, the scan's spectrum around its first order is a family of lines, drawn on the right, and which of them "
    "is the brightest under a window is a matter of place and phase, that is, of speckle. The published value lies in "
    "one group, that of the windows near the seam and of some that are not. A single period for this skin would be "
    "the middle of a distribution a tenth of it wide, whatever digits a peak search gives."
)
COPIES_DIFFER = (
    "Whole copies in step are a grating of the cut's side L and reflect at L/r alone, in grey. On a blazed grating, "
    "cut to whole periods, that is right. A natural grating is not periodic: the period that copies find jumps by a "
    "tenth with a micrometre of the cut, while a window of as much of the same place hardly moves, and on the right "
    "they show darkness between lines where the skin has none. A published value by copies is thus one of its cut."
)
GRATINGS_DIFFER = (
    "Exposures and the conversion to sRGB are ours, as the published ones are not on record: relative to the 99th "
    "percentile of luminance. A pixel is the mean of 3 × 3 directions. Gratings of one dimension have all their light "
    "on a line as wide as the window's lobe, 0.2°, which a narrow window makes wider. The illuminant is D65, once, "
    "before the integral."
)
STEPS_DIFFER = (
    "Published is a plain sum over equal steps; the library takes as many samples equally spaced in 1/λ, with weights "
    "of cubic interpolation. Numbers are errors against a converged map. An order passes within 1 to 5 nm, so that a "
    "step of 10 nm loses orders between samples, which weights cannot bring back: noise on the scan, gaps in the "
    "blaze's spectra. That is why the number of wavelengths follows from a tolerance here, and is not asked for."
)
SIGMAS_DIFFER = (
    "Averaged over the window's place, maps get smooth as σ falls; under one window, as published, they keep its "
    "speckle, with grains of the lobe's size, 1/σ. Windows of 45 µm and more reach round the patch: coefficients 1/65 "
    "µm apart come apart, and between them it is dark, which single directions see and these pixels, means of 3 × 3, "
    "do not. They are no more maps of the skin, and both forms are the same."
)
TERMS_DIFFER = (
    "N is the largest power. Numbers are errors against a converged map. The published series counts heights from the "
    "lowest one, which doubles the argument to 2π · 2/0.38 · 0.38 = 12: it diverges up to N = 12, before it "
    "converges, and 25 terms are wrong near the mirror direction, where the published bound promised 9e-8. Counted "
    "from the middle of their range half of the terms are enough. Float32 is no limit at this height."
)
INCIDENCES_DIFFER = (
    "The pattern moves with the mirror direction along −x in the sines of the angles, as the grating equation has it, "
    "and keeps its form but for the gain and w. The published formula has no masking, without which maps grow bright "
    "at the rim."
)
METHODS_DIFFER = (
    "As published are the 3 × 3 coefficients by floor(), the copies by interpolation and Stam's rainbow; all these "
    "integrate over steps of 5 nm. Neighbours by floor() are a window on the seam, off centre by half a coefficient, "
    "with grains that no window has. Copies show the patch's own lattice; interpolated linearly, amplitudes of random "
    "phase are averaged and grains lose light in between. Stam's analytic model knows one period and no heights: "
    "lines of equal strength at all v, right in angle for a regular grating and of no use for the skin; with CIE "
    "colours and the orders' powers (Stam, cie) it equals the library on the blaze, and leaves out what is not an "
    "order of the tracks on the others. Copies of the blaze are as many as fill 65 µm."
)
ORDERS_DIFFER = (
    "The shortcut takes the wavelengths L|u|/n and L|v|/n at which an order of the patch falls on the direction, and "
    "counts them alike. They crowd towards blue, as 1/λ²: a blue tint everywhere, in the table as Z. Near the mirror "
    "direction they are few, of one or two wavelengths each: rings of pure red, purple and cyan, and within |u| = "
    "0.38/65 none at all: black. Weights λ² take the tint away, not the rings. Where coefficients overlap in a window "
    "there is light between them; the library integrates it, and is white around the mirror."
)
LIGHTS_DIFFER = (
    "The published pictures are on another mesh, with a measured field of the fingers' directions, which are not at "
    "hand: the body is this library's snake, with the pattern of a corn snake. Shadows are traced, and a pixel is the "
    "mean over what it sees, where the published shader takes the pixel's centre."
)
ZOOM_DIFFERS = (
    "Far away a pixel sees all colours of a scale and is their mean, near white; nearer it sees the colours of single "
    "places, blue towards the highlight and red away from it. A shader that takes the pixel's centre shows these "
    "colours from afar, too, as noise."
)
PIGMENT_DIFFERS = (
    "The pigment lies under the layer in the same units, where a white one is some 1e-4 of the mirror, as the orders "
    "are; the published derivation has none. A factor, 0.05, makes it a dark skin's."
)
TANGENTS_DIFFER = (
    "Dispersion across the body, as the fingers of the real skin have it, spreads colours to both sides of a "
    "highlight; along the body it moves them along the highlight's line. The published field follows the measured "
    "fingers; here it follows the texture coordinates."
)
STAM_DIFFERS = (
    "As in the published comparison Stam's shader is right in angle on the disc, though its rainbow has three "
    "parabolas for a spectrum, from 0.5 to 1 µm, and the orders' strength is free; with CIE colours the spectra lie "
    "where the library has them, without the haze of the pits. On the skin it has lines of full colour, and colour "
    "where the library has none; the highlight's haze and the broad orders of an irregular grating are missing. Its "
    "pixels are points: it has no mean over a footprint."
)


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
        raw: The scan as it was measured, if there is one.
    """

    folder: Path
    quick: bool
    raw: wd.HeightField | None

    @functools.cached_property
    def scan(self) -> wd.HeightField | None:
        """The levelled scan."""
        return None if self.raw is None else self.raw.levelled(order=2)

    def some(self, settings: tuple[Any, ...]) -> tuple[Any, ...]:
        """All settings, or every third if quick."""
        return settings[:: 3 if self.quick else 1]

    def pixels(self, count: int) -> int:
        """A size in pixels, a third of it if quick; odd, so that a map has a row in the plane of incidence."""
        return (count // 3 if self.quick else count) | 1

    @functools.cached_property
    def natural(self) -> wd.HeightField:
        """The scan, the middle of it if quick, or synthetic fingers in its place."""
        if self.scan is None:
            return wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
        return self.scan.cropped(32.0) if self.quick else self.scan

    @property
    def natural_name(self) -> str:
        """What it is called."""
        return "fingers" if self.scan is None else "Elaphe"


def at_angle(degrees: ArrayLike) -> Floats:
    """Unit vectors in the plane of incidence, at angles from the normal towards +x."""
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)


def view_angles(longest_nm: float, shortest_nm: float, count: int, wavelength_nm: Floats) -> Floats:
    """View angles [degrees] at which first orders of periods [nm] between two lie."""
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


def library(
    heightfield: wd.HeightField, *, opposite: bool = False, **options: Any
) -> Callable[[Floats, Floats, Floats], Floats]:
    """The library's ρ, for :func:`first_order`; ``opposite`` turns light and views by 180° about the normal."""
    rotated = np.array([-1.0, -1.0, 1.0]) if opposite else np.ones(3)
    return lambda light, views, wavelengths: wd.spectral_reflectance(
        heightfield, light * rotated, views * rotated, wavelengths, masking=False, **options
    )


def blazed_period(**options: Any) -> Floats:
    """Periods [nm] of the blazed grating at the wavelengths; options are those of ``wd.spectral_reflectance``."""
    heightfield = wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM)
    return periods_at(first_order(library(heightfield, **options), BLAZED_UM)[2], WAVELENGTHS)


def written(periods: Floats) -> str:
    """Mean and variance, as published."""
    return f"{periods.mean():.3f} ({periods.var():.3f})"


# Periods.


def ways(
    heightfield: wd.HeightField, raw: wd.HeightField | None, *, periods: tuple[int, int]
) -> dict[str, tuple[str, Any, float]]:
    """The ways to the periods: which published number they stand beside, ρ, and the grid [degrees] they can afford."""
    repeated = wd.Coherence("replicas", periods=periods)
    many = f"{periods[0]} × {periods[1]} copies"
    other = library(heightfield, opposite=True, strict=False)
    coarse = 0.005 if heightfield.shape[0] == 1 else 0.02
    found: dict[str, tuple[str, Any, float]] = {
        f"averaged, {method}": ("full", library(heightfield, method=method, strict=False), GRID_DEG)
        for method in ("low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred")
    }
    found |= {
        "averaged, light from the other side": ("full", other, GRID_DEG),
        "centred on the middle": ("full", library(heightfield, coherence=wd.Coherence("centred"), strict=False), GRID_DEG),
        "centred on the seam": ("full", library(heightfield, coherence=SEAM, strict=False), GRID_DEG),
        FLOOR: ("full", functools.partial(variants.neighbours, heightfield, masking=False), coarse),
        "source of 0.53°": ("full", library(heightfield, coherence=wd.Coherence("source"), strict=False), GRID_DEG),
        f"{many}, exact": ("periods", library(heightfield, coherence=repeated, tolerance=1e-3, strict=False), GRID_DEG),
    }  # fmt: skip
    if raw is not None:
        found["centred on the seam, not levelled"] = ("full", library(raw, coherence=SEAM, strict=False), GRID_DEG)
    for interpolation in ("linear", "sinc"):
        rho = functools.partial(
            variants.periods, heightfield, count=periods, interpolation=interpolation, masking=False
        )
        found[f"{many}, {interpolation}"] = ("periods", rho, coarse)
    return found


def period_figure(
    setup: Setup,
    name: str,
    heightfield: wd.HeightField,
    expected_um: float,
    shown: list[str],
    *,
    periods: tuple[int, int],
    raw: wd.HeightField | None = None,
) -> tuple[Any, list[list[str]]]:
    """Reflectance over wavelength and angle for the ways that are shown, and the table of all of them."""
    from matplotlib import pyplot as plt

    wavelengths = WAVELENGTHS[::20] if setup.quick else WAVELENGTHS
    rows = [["method", "mean (variance) [nm, nm²]", "smallest, largest", "grid", "published"]]
    figure, axes = plt.subplots(1, len(shown), figsize=(4.0 * len(shown), 4.2), sharey=True)
    panels = iter(axes)
    for label, (kind, rho_of, finest) in ways(heightfield, raw, periods=periods).items():
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
    """The blazed grating's."""
    shown = ["averaged, low-rank", FLOOR, "1 × 26 copies, exact", "1 × 26 copies, linear"]
    heightfield = wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM)
    figure, table = period_figure(setup, "blazed", heightfield, BLAZED_UM, shown, periods=(1, 26))
    made = Figure("periods_blazed", "Periods: a blazed grating of 2500 nm", BLAZED_DIFFERS, table)
    return save(setup, figure, made)


def scan_periods(setup: Setup) -> Figure:
    """The scan's."""
    shown = ["averaged, low-rank", "centred on the middle", "centred on the seam", FLOOR, "1 × 1 copies, linear"]
    figure, table = period_figure(setup, "scan", setup.scan, SCAN_PERIOD_UM, shown, periods=(1, 1), raw=setup.raw)
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
        found = np.array(
            [[period(wd.Coherence("centred", centre_um=(y, x)), opposite=opposite) for x in places] for y in places]
        )
        image = axis.pcolormesh(places, places, found, cmap="viridis", vmin=1000.0, vmax=1200.0, shading="nearest")
        axis.set(title=f"period [nm], light from {side}", xlabel="centre of the window: x [µm]", ylabel="y [µm]")
        axis.set_aspect("equal")
        figure.colorbar(image, ax=axis, shrink=0.8)
        label = f"light from {side}"
        axes[2].hist(found.ravel(), np.arange(900.0, 1301.0, 5.0), histtype="step", color=colour, lw=1.8, label=label)
        averaged = period(wd.Coherence(), opposite=opposite)
        axes[2].axvline(averaged, color=colour, linestyle=":", label=f"averaged form, {averaged:.0f} nm")
        shares = ", ".join(f"{each:.0f}" for each in np.percentile(found, (5, 25, 50, 75, 95)))
        rows.append([side, str(found.size), shares, written(found), f"{averaged:.0f}", f"{found[0, 0]:.0f}"])

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
        setup, figure, Figure("scan_windows", "The period depends on where the window lies", WINDOWS_DIFFER, rows)
    )


def scan_copies(setup: Setup) -> Figure:
    """Why whole copies fail on a natural grating: the period is that of the cut."""
    from matplotlib import pyplot as plt

    heightfield, wavelengths = setup.scan, np.array([450.0, 550.0, 650.0])
    sizes = np.arange(24.0, 65.1, 20.0 if setup.quick else 1.5)
    periods = wd.Coherence("replicas", periods=(4, 4))

    def period(cut: wd.HeightField, coherence: wd.Coherence) -> float:
        rho = library(cut, coherence=coherence, strict=False)
        best = first_order(rho, SCAN_PERIOD_UM, wavelengths_nm=wavelengths, grid_deg=0.01)[2]
        return float(np.median(periods_at(best, wavelengths)))

    found = {
        "4 × 4 copies of a cut": [period(heightfield.cropped(size), periods) for size in sizes],
        # As much of the surface, under a smooth window that repeats nothing.
        "one window, σ a quarter of the cut": [
            period(heightfield, wd.Coherence("centred", size / 4.0)) for size in sizes
        ],
    }
    figure, axes = plt.subplots(1, 2, figsize=(14.0, 4.8))
    rows = [["24 to 65 µm", "mean (variance) [nm, nm²]", "distance from L/r, mean of 0 … 0.5 orders"]]
    for (label, periods), colour in zip(found.items(), ("#c51b7d", "black"), strict=True):
        axes[0].plot(sizes, periods, "o", color=colour, markersize=4, label=label)
        orders = 1e3 * sizes / np.array(periods)
        rows.append([label, written(np.array(periods)), f"{np.abs(orders - np.rint(orders)).mean():.3f}"])
    for order in range(18, 73):
        axes[0].plot(sizes, 1e3 * sizes / order, color="#bbbbbb", lw=0.6, zorder=0)
    angles, green = view_angles(1250.0, 950.0, 3000, np.array(550.0)), np.array([550.0])
    for coherence, colour in ((periods, "#c51b7d"), (wd.Coherence(), "black")):
        rho = library(heightfield, coherence=coherence, strict=False)(at_angle(INCIDENCE_DEG), at_angle(angles), green)[
            :, 0
        ]
        axes[1].plot(periods_at(angles, green), rho / rho.max(), color=colour, lw=1.0, label=str(coherence))
    axes[0].set(xlabel="side L of the cut [µm]; grey: L/r", ylabel="period found [nm]", ylim=(900.0, 1300.0))
    axes[1].set(xlabel="period of the first order [nm]", ylabel="reflectance at 550 nm, of the largest")
    for axis in axes:
        axis.legend(fontsize=8, loc="upper right")
    return save(setup, figure, Figure("scan_copies", "Whole copies have the periods of the cut", COPIES_DIFFER, rows))


# Maps.


@dataclasses.dataclass(frozen=True)
class Disc:
    """The pixels of ``wd.reflectance_map`` as directions, for what the library has no map of.

    Attributes:
        size: Width and height [pixels].
        mask: Those within, shape (size, size).
        views: Their directions, shape (n, 3).
    """

    size: int
    mask: NDArray[np.bool_]
    views: Floats

    @classmethod
    def of(cls, size: int, *, neighbour_extent: float = 1.0) -> Disc:
        """The disc of all directions, or its square of −reach … reach."""
        axis = neighbour_extent * ((2.0 * np.arange(size) + 1.0) / size - 1.0)
        x, y = np.meshgrid(axis, -axis)
        mask = x * x + y * y < 1.0
        views = np.stack([x[mask], y[mask], np.sqrt(1.0 - x[mask] ** 2 - y[mask] ** 2)], axis=1)
        return cls(size, mask, views)

    def image(self, xyz: Floats) -> Floats:
        """Colours (n, 3) in their places, nan outside."""
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
    """XYZ of a map, nan outside."""
    return np.where(image.coverage[..., None] == 1.0, image.xyz.astype(np.float64), np.nan)


def mean_map(setup: Setup, heightfield: wd.HeightField, light: Floats, pixels: int, **options: Any) -> Floats:
    """XYZ of a map, each pixel the mean of 3 × 3 directions, of one if quick, nan outside."""
    samples = 1 if setup.quick else 9
    return of_map(
        wd.reflectance_map(heightfield, light, size=setup.pixels(pixels), samples_per_pixel=samples, **options)
    )


def exposure(xyz: Floats) -> float:
    """1 over the 99th percentile of luminance, or over the largest where that is 0."""
    return 1.0 / float(np.nanpercentile(xyz[..., 1], 99.0) or np.nanmax(xyz[..., 1]))


def strip(xyz: Floats) -> Floats:
    """The middle rows of a map."""
    half = len(xyz) / 2.0
    return xyz[math.floor(half * (1.0 - STRIP)) : math.ceil(half * (1.0 + STRIP))]


def error_of(xyz: Floats, truth: Floats) -> str:
    """P99 of ‖ΔXYZ‖ / max(‖XYZ‖, a thousandth of the 99th percentile of Y)."""
    least = 1e-3 * np.nanpercentile(truth[..., 1], 99.0)
    difference = np.linalg.norm(xyz - truth, axis=-1) / np.maximum(np.linalg.norm(truth, axis=-1), least)
    return f"{np.nanpercentile(difference, 99.0):.1e}"


def mosaic(
    setup: Setup, made: Figure, rows: list[tuple[str, list[tuple[str, Floats, float]]]], *, inch: float
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
    return save(setup, figure, made)


def map_gratings(setup: Setup) -> Figure:
    """Each grating."""
    made = {
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
    for name, (heightfield, factor) in made.items():
        xyz = mean_map(setup, heightfield, LIGHT, 300)
        tiles.append((name, xyz, factor * exposure(xyz)))
    return mosaic(
        setup, Figure("map_gratings", "Maps: gratings", GRATINGS_DIFFER), [("", tiles[:4]), ("", tiles[4:])], inch=3.0
    )


def map_steps(setup: Setup) -> Figure:
    """Wavelength steps: the published sum and the library's weights for the same number of samples."""
    disc = Disc.of(setup.pixels(210))
    rows, table = [], [["P99 of the error", *(f"{step} nm" for step in STEPS_NM)]]
    for name, heightfield, cut, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), strip, LINE),
        (setup.natural_name, setup.natural, np.asarray, AREA),
    ):
        truth = of_map(wd.reflectance_map(heightfield, LIGHT, size=disc.size, tolerance=1e-3))
        exposed = factor * exposure(truth)
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
            labels = [f"{step} nm: {error_of(image, truth)}" for step, image in zip(STEPS_NM, images, strict=True)]
            tiles = [(label, cut(image), exposed) for label, image in zip(labels, images, strict=True)]
            rows.append((f"{name}\n{title}", tiles))
            table.append([f"{name}, {title}", *(label.split(": ")[1] for label in labels)])
    return mosaic(setup, Figure("map_steps", "Maps: wavelength steps", STEPS_DIFFER, table), rows, inch=2.2)


def map_sigmas(setup: Setup) -> Figure:
    """Widths of the window."""
    rows = []
    for name, heightfield, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), LINE),
        (setup.natural_name, setup.natural, AREA),
    ):
        for kind in ("averaged", "centred"):
            tiles = []
            for sigma in setup.some(SIGMAS_UM):
                options = {"coherence": wd.Coherence(kind, sigma), "tolerance": 3e-2, "strict": False}
                xyz = mean_map(setup, heightfield, LIGHT, 210, **options)
                tiles.append((f"σ = {sigma:g} µm", xyz, factor * exposure(xyz)))
            rows.append((f"{name}\n{kind}", tiles))
            if name == "blazed":
                break
    return mosaic(setup, Figure("map_sigmas", "Maps: widths of the window", SIGMAS_DIFFER), rows, inch=2.2)


def map_terms(setup: Setup) -> Figure:
    """Terms of the Taylor series, with heights as they are, as published, and centred."""
    heightfield, size = setup.natural, setup.pixels(180)
    truth = of_map(wd.reflectance_map(heightfield, LIGHT, size=size, tolerance=1e-3))
    rows, table = [], [["P99 of the error", *(f"N = {last}" for last in setup.some(TAYLOR))]]
    for title, method in (("as published", "taylor-uncentred"), ("centred", "taylor")):
        plan = wd.plan(heightfield, LIGHT, method=method, tolerance=1e-3, strict=False)
        tiles, errors = [], []
        for last in setup.some(TAYLOR):
            fewer = dataclasses.replace(plan, terms=last + 1, adaptive=False, rings_per_octave=0, footprint=False)
            image = of_map(wd.reflectance_map(heightfield, LIGHT, size=size, plan=fewer))
            errors.append(error_of(image, truth))
            tiles.append((f"N = {last}: {errors[-1]}", image, AREA * exposure(truth)))
        rows.append((title, tiles))
        table.append([title, *errors])
    return mosaic(setup, Figure("map_terms", "Maps: terms of the Taylor series", TERMS_DIFFER, table), rows, inch=1.9)


def map_incidences(setup: Setup) -> Figure:
    """Angles of incidence."""
    rows = []
    for name, heightfield, factor in (
        ("blazed", wd.gratings.blazed(BLAZED_UM, BLAZED_DEPTH_UM), LINE),
        (setup.natural_name, setup.natural, AREA),
    ):
        tiles = []
        for angle in setup.some((0.0, 10.0, 20.0)):
            xyz = mean_map(setup, heightfield, at_angle(angle), 300)
            tiles.append((f"{angle:g}°", xyz, factor * exposure(xyz)))
        rows.append((name, tiles))
    return mosaic(setup, Figure("map_incidences", "Maps: angles of incidence", INCIDENCES_DIFFER), rows, inch=3.0)


def map_methods(setup: Setup) -> Figure:
    """Full sampling, copies and Stam's analytic model."""
    disc = Disc.of(setup.pixels(120))
    wavelengths = WAVELENGTHS[:: 20 if setup.quick else 5]
    weights = colorimetry.quadrature_weights(wavelengths)
    scattering_vectors = -LIGHT - disc.views
    gains = reflectance_factors.gain(
        np.broadcast_to(LIGHT, disc.views.shape),
        disc.views,
        normal=reflectance_factors.normal_reflectance(1.5),
        masking=True,
    )
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
        images["copies, exact"] = of_map(
            wd.reflectance_map(heightfield, LIGHT, size=disc.size, coherence=many, tolerance=3e-2)
        )
        for how in ("linear", "sinc"):
            rho = variants.periods(heightfield, LIGHT, disc.views, wavelengths, count=periods, interpolation=how)
            images[f"copies, {how}"] = disc.image(rho @ weights)
        for colours in ("rainbow", "cie"):
            found = variants.stam_directions(heightfield, scattering_vectors, gains, colours=colours)
            images[f"Stam, {colours}"] = disc.image(found)
        # The rainbow's brightness is that of the true colours; its own highest percentile is a white highlight.
        exposures = {label: exposure(image) for label, image in images.items()}
        exposures["Stam, rainbow"] = exposures["averaged"]
        rows.append((name, [(label, image, factor * exposures[label]) for label, image in images.items()]))
    return mosaic(setup, Figure("map_methods", "Maps: methods", METHODS_DIFFER), rows, inch=1.9)


def map_orders(setup: Setup) -> Figure:
    """The shortcut by wavelengths of orders, and the library without it."""
    heightfield = setup.natural
    rows = []
    table = [["mean colour, Y = 1: X, Z", "whole disc", "within 0.05 to 0.25 of the mirror direction"]]
    colours: dict[str, list[str]] = {}
    for name, neighbour_extent in (("whole disc", 1.0), ("around the mirror direction", 0.25)):
        disc = Disc.of(setup.pixels(240), neighbour_extent=neighbour_extent)
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
        chosen = (radius > 0.05) & (radius < neighbour_extent)
        for label, xyz in images.items():
            # Every direction's colour counts alike, or the mirror's tail would be all.
            mean = (xyz[chosen] / np.maximum(xyz[chosen, 1:2], 1e-12)).clip(0.0, 10.0).mean(axis=0)
            colours.setdefault(label, []).append(f"{mean[0]:.2f}, {mean[2]:.2f}")
        exposed = AREA * exposure(disc.image(images["library"])) * (1.0 if neighbour_extent == 1.0 else 0.3)
        rows.append((name, [(label, disc.image(xyz), exposed) for label, xyz in images.items()]))
    table += [[label, *values] for label, values in colours.items()]
    return mosaic(
        setup, Figure("map_orders", "Maps: wavelengths at which an order falls", ORDERS_DIFFER, table), rows, inch=3.0
    )


# Renderings.


def pictures(setup: Setup, made: Figure, views: list[tuple[str, dict[str, Any]]]) -> Figure:
    """Draw renderings of the snake: labels, and what differs from the usual arguments of ``wd.shade``."""
    tiles = []
    for label, options in views:
        arguments: dict[str, Any] = {
            "mesh": snake(setup), "heightfield": setup.natural, "light": LIGHTS["right, behind"], "view": camera(setup),
            "tolerance": 3e-2, "samples_per_pixel": 1 if setup.quick else 4, "pigment": 0.05,
        }  # fmt: skip
        image = wd.shade(**(arguments | options))
        tiles.append((label, image.xyz, RENDERED * exposure(np.where(image.illuminated[..., None], image.xyz, np.nan))))
    rows = [("", tiles[first : first + 2]) for first in range(0, len(tiles), 2)]
    return mosaic(setup, made, rows, inch=4.2)


LIGHTS = {
    "left, behind": wd.DirectionalLight((-0.9, 0.7, 0.5)),
    "right, behind": wd.DirectionalLight((0.5, 0.75, -0.8)),
    "above": wd.DirectionalLight((0.0, 1.0, 0.1)),
    "front": wd.DirectionalLight((0.1, 0.6, 1.0)),
}
RENDERED = 10.0
# A place of the back with an order in sight.
COLOURED = (-0.453, 0.190, -0.137)


@functools.cache
def body(tangent: str, ventrals: int) -> Any:
    """The snake."""
    return wd.meshes.snake(tangent=tangent, ventrals=ventrals)


def snake(setup: Setup, tangent: str = "around") -> Any:
    """The snake, with fewer scales if quick."""
    return body(tangent, 65 if setup.quick else 130)


def camera(setup: Setup, target: tuple[float, float, float] = (-0.56, 0.06, 0.07), fov_deg: float = 12.2) -> wd.View:
    """The view of the front half of the snake, or nearer."""
    return wd.View((-1.6, 2.2, 2.6), target, fov_y_deg=fov_deg, width=setup.pixels(420), height=setup.pixels(250))


def render_lights(setup: Setup) -> Figure:
    """Directions of the light."""
    return pictures(
        setup,
        Figure("render_lights", "Renderings: light from several directions", LIGHTS_DIFFER),
        [(name, {"light": light, "pigment": 0.01}) for name, light in setup.some(tuple(LIGHTS.items()))],
    )


def render_zoom(setup: Setup) -> Figure:
    """A series of closer views."""
    views = [(f"{fov:g}° of view", {"view": camera(setup, COLOURED, fov)}) for fov in (12.2, 5.0, 2.0, 0.8)]
    return pictures(setup, Figure("render_zoom", "Renderings: closer and closer", ZOOM_DIFFERS), views)


def render_pigment(setup: Setup) -> Figure:
    """With and without the texture."""
    views = [("pigment, 0.05", {}), ("no pigment", {"pigment": 0.0})]
    return pictures(
        setup, Figure("render_pigment", "Renderings: with the pigment's texture and without", PIGMENT_DIFFERS), views
    )


def render_tangents(setup: Setup) -> Figure:
    """The tangent field around the body and along it."""
    views = [
        (f"dispersion {tangent} the body", {"mesh": snake(setup, tangent), "pigment": 0.0})
        for tangent in ("around", "along")
    ]
    return pictures(
        setup,
        Figure("render_tangents", "Renderings: tangent field across the body and along it", TANGENTS_DIFFER),
        views,
    )


def render_stam(setup: Setup) -> Figure:
    """Stam's analytic model beside the library, on a disc and on the skin."""
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
        setup,
        Figure("render_stam", "Renderings: Stam's analytic model beside the library", STAM_DIFFERS),
        rows,
        inch=4.0,
    )


# The page.


def save(setup: Setup, figure: Any, made: Figure) -> Figure:
    """Write a figure and forget it; returns what it is."""
    from matplotlib import pyplot as plt

    figure.suptitle(made.title, fontsize=12)
    figure.tight_layout()
    figure.savefig(setup.folder / f"{made.name}.png", dpi=90)
    plt.close(figure)
    return made


# What is drawn, and whether it takes the scan.
SECTIONS: tuple[tuple[Callable[[Setup], Figure], bool], ...] = (
    (blazed_periods, False), (scan_periods, True), (scan_windows, True), (scan_copies, True), (map_gratings, False),
    (map_steps, False), (map_sigmas, False), (map_terms, False), (map_incidences, False), (map_methods, False),
    (map_orders, False), (render_lights, False), (render_zoom, False), (render_pigment, False),
    (render_tangents, False), (render_stam, False),
)  # fmt: skip


def contact_sheet(setup: Setup, figures: list[Figure]) -> None:
    """All figures in one picture, each in the column that is shortest yet."""
    from PIL import Image

    columns, width, gap = 3, 900, 24
    ends, placed = [0] * columns, []
    for each in figures:
        with Image.open(setup.folder / f"{each.name}.png") as picture:
            small = picture.convert("RGB").resize((width, round(picture.height * width / picture.width)), Image.LANCZOS)
        column = int(np.argmin(ends))
        placed.append((small, (column * (width + gap), ends[column])))
        ends[column] += small.height + gap
    sheet = Image.new("RGB", (columns * (width + gap) - gap, max(ends)), "white")
    for small, at in placed:
        sheet.paste(small, at)
    sheet.save(setup.folder / "contact_sheet.png")


def page(figures: list[Figure]) -> str:
    """The contact sheet in HTML."""
    parts = [
        "<!doctype html><meta charset='utf-8'><title>The published evaluation, reproduced</title>",
        "<style>body{font:15px sans-serif;max-width:1200px;margin:2em auto}img{max-width:100%}</style>",
        "<style>td,th{padding:.2em .8em;text-align:left;border-bottom:1px solid #ccc}</style>",
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
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument("--quick", action="store_true", help="small sizes, in less than a minute")
    parser.add_argument("--only", choices=[each.__name__ for each, _ in SECTIONS], nargs="+", help="only these figures")
    options = parser.parse_args()
    import matplotlib as mpl

    mpl.use("Agg")
    raw = inputs.scan(options.data)
    if raw is None:
        print(f"The scan is not in {inputs.folder(options.data)}: its figures are skipped or show synthetic fingers")
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
