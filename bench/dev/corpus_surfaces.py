"""Test cases of ``bench/dev/corpus.py`` without pictures: colours, spectra, orders, maps, and height fields."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image as Pixels

from bench.dev.corpus_inputs import SOURCE, WAVELENGTHS_NM, coated_metal, directions, fingers
from bench.dev.corpus_values import attributes, map_values, named, plan_values
from bench.dev.public_names import wd

if TYPE_CHECKING:
    from bench.dev.corpus_values import Case, Values

SUMMARY_NUMBERS = (
    "shape", "size_um", "pitch_um", "height_range_um", "rms_um", "rms_slope", "mean_slope", "max_uv", "scalar_error",
    "missing",
)  # fmt: skip
PERIOD_NUMBERS = (
    "period_um", "standard_error_um", "direction_deg", "harmonics_um", "share", "frequency", "is_coherent",
    "is_resolved",
)  # fmt: skip


def normalised_energy(threads: int) -> Values:
    """Compute spectra, colours and a reflectance map for a mirror, copper and the default material.

    They have the energy normalisation, which scales the efficiencies of the orders of a perfect mirror to a sum of 1.
    """
    options: Values = {"energy": "normalised", "threads": threads}
    metal = wd.Material.metal("Cu")
    surface = fingers()
    lights, views = directions(40)
    return {
        "brdf": wd.brdf(surface, lights, views, WAVELENGTHS_NM, ior=float("inf"), **options),
        "brdf of a metal": wd.brdf(surface, lights, views, WAVELENGTHS_NM, material=metal, **options),
        "xyz": wd.reflectance(surface, lights, views, material=metal, **options),
        **named("map", map_values(wd.reflectance_map(surface, (0.3, 0.2, 1.0), size=24, **options))),
    }


def direction_colours(count: int, coherence: Any, **options: Any) -> Case:
    """Return a test case that computes the colours of ``count`` random directions."""
    return lambda threads: {
        "xyz": wd.reflectance(
            heightfield=fingers(), to_light=directions(count)[0], to_view=directions(count)[1], coherence=coherence,
            threads=threads, **options,
        )
    }  # fmt: skip


def spectra(threads: int) -> Values:
    """Compute relative and absolute spectra for all limits of interference (coherence), and order efficiencies."""
    coherences = (wd.Coherence(), wd.Coherence("centred"), SOURCE, wd.Coherence("replicas", periods=(2, 2)))
    values: Values = {}
    for coherence in coherences:
        options: Values = {"coherence": coherence, "threads": threads}
        values[f"{coherence.kind}.relative"] = wd.spectral_reflectance(
            fingers(), *directions(40), WAVELENGTHS_NM, **options
        )
        values[f"{coherence.kind}.absolute"] = wd.brdf(fingers(), *directions(40), WAVELENGTHS_NM, **options)
    orders = wd.order_efficiencies(wd.gratings.sinusoidal(2.0, 0.3), (0.3, 0.1, 1.0), WAVELENGTHS_NM)
    return values | {"orders": orders.orders, "efficiencies": orders.efficiencies}


def orders(_: int) -> Values:
    """Compute the order efficiencies of gratings of a metal, of a coated metal and of a perfect mirror.

    The efficiencies of the mirror are computed with the energy normalisation, and those of the coated metal without it.
    """
    names = ("wavelengths_nm", "orders", "to_view", "efficiencies")
    light = (0.3, 0.1, 1.0)
    calls = {
        "metal": (wd.gratings.blazed(2.0, 0.3), {"material": wd.Material.metal("Au")}),
        "coated": (wd.gratings.lamellar(1.5, 0.1), {"material": coated_metal(), "energy": "stam"}),
        "mirror": (wd.gratings.bumps(), {"ior": float("inf"), "energy": "normalised"}),
    }
    values: Values = {}
    for name, (surface, options) in calls.items():
        result = wd.order_efficiencies(heightfield=surface, to_light=light, wavelengths_nm=WAVELENGTHS_NM, **options)
        values |= named(name, attributes(result, names)) | {f"{name}.of order (0, 1)": result[0, 1]}
    return values


def maps(threads: int) -> Values:
    """Compute reflectance maps over all view directions, with one and with four directions per pixel."""
    surface = wd.gratings.bumps()
    one, four = (
        wd.reflectance_map(
            heightfield=surface, to_light=(0.3, 0.2, 1.0), size=64, samples_per_pixel=samples, threads=threads
        )
        for samples in (1, 4)
    )
    return map_values(one) | named("four", map_values(four))


def material_colours(threads: int) -> Values:
    """Compute a coated metal's colours under two illuminants, its spectra, and the reflectance of a flat surface."""
    lights, views = directions(60)
    material = coated_metal()
    options: Values = {"material": material, "threads": threads}
    angles = np.linspace(0.0, 89.0, 7)[:, None]
    return {
        "flat": np.stack([material.reflectance(WAVELENGTHS_NM, angles, polarisation=which) for which in "sp"]),
        "black body": wd.reflectance(fingers(), lights, views, illuminant=wd.Spectrum.blackbody(2900.0), **options),
        "daylight": wd.reflectance(fingers(), lights, views, illuminant=wd.Spectrum.daylight(5000.0), **options),
        "relative": wd.spectral_reflectance(fingers(), lights, views, WAVELENGTHS_NM, **options),
    }


def surfaces(_: int) -> Values:
    """Collect synthetic height fields, and the results of all methods that clean them.

    For one cleaned height field, also collect its summary, and the numbers of wavelengths and terms for its
    reflectance.
    """
    rng = np.random.default_rng(3)
    fields = {
        "fingers": fingers(), "bumps": wd.gratings.bumps(), "blazed": wd.gratings.blazed(2.0, 0.3),
        "disc": wd.gratings.disc("DVD", tracks=4, length_um=12.8, pitch_um=0.06),
    }  # fmt: skip
    heights = fields["fingers"].heights_um + 0.02 * np.arange(fields["fingers"].shape[1]) ** 1.1
    heights[rng.random(heights.shape) < 1e-3] += 2.0
    heights[30:33, 40:44] = np.nan
    rough = wd.HeightField(heights, 0.09).filled()
    fields |= {"levelled": rough.levelled(2), "despiked": rough.levelled(2).despiked(), "cropped": rough.cropped(6.0)}
    fields |= {"resampled": rough.resampled(0.2), "periodic": rough.levelled(2).periodic()}
    values: Values = {name: field.heights_um for name, field in fields.items()}
    values |= named("summary", attributes(fields["periodic"].summary(), SUMMARY_NUMBERS))
    return values | plan_values(wd.plan(fields["periodic"], tolerance=1e-1, strict=False))


def repeats(_: int) -> Values:
    """Find the periods of a noisy crossed grating with missing heights, and crop the grating to whole periods."""
    rng = np.random.default_rng(17)
    y, x = np.mgrid[:160, :200] * 0.1
    heights = 0.2 * np.cos(2.0 * np.pi * x / 2.3) + 0.1 * np.cos(2.0 * np.pi * (y + 0.2 * x) / 3.1)
    heights += 0.05 * np.cos(4.0 * np.pi * x / 2.3) + 0.02 * rng.standard_normal(heights.shape)
    heights[50:60, 70:90] = np.nan
    field = wd.HeightField(heights, 0.1)
    values: Values = {"whole periods": field.filled().whole_periods().heights_um}
    for index, period in enumerate(field.periods(3)):
        values |= named(f"period {index}", attributes(period, PERIOD_NUMBERS))
    return values


def height_files(_: int) -> Values:
    """Load height fields from 8-bit and 16-bit images, a floating-point TIFF, and a .npy file with missing heights."""
    rng = np.random.default_rng(23)
    heights = rng.random((24, 24)).astype(np.float32)
    gaps = heights.astype(np.float64)
    gaps[3:5, 6:9] = np.nan
    values: Values = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Pixels.fromarray((255.0 * heights).astype(np.uint8)).save(folder / "byte.png")
        Pixels.fromarray((65_535.0 * heights).astype(np.uint16)).save(folder / "word.png")
        Pixels.fromarray(heights).save(folder / "float.tiff")
        np.save(folder / "gaps.npy", gaps)
        calls = {
            "byte.png": {"pitch_um": 0.1, "height_range_um": 0.7},
            "word.png": {"extent_um": 2.4, "height_range_um": 0.7},
            "float.tiff": {"pitch_um": (0.2, 0.1)},
            "gaps.npy": {"pitch_um": 0.09},
        }
        for file, options in calls.items():
            field = wd.HeightField.load(folder / file, **options)
            values |= named(file, attributes(field, ("heights_um", "missing", "pitch_um", "size_um")))
    return values
