"""Random calls of ``reflectance``: surfaces, coherence, directions and tolerances, each from its index and a seed.

Coherence forms and tolerances take turns, so that every run of ``len(STRATA)`` indices has one of each; all else is
drawn. The design's error of a picture judges a call, a direction for a pixel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

import warpdiff as wd

KINDS = ("averaged", "centred", "source", "replicas")
# Copies have lobes that only a spectrum resolves: two tolerances are asked of them.
STRATA = [(kind, t) for kind in KINDS for t in (1e-1, 1e-2, 1e-3, 1e-4) if kind != "replicas" or t >= 1e-2]
SURFACES = ("scan", "fingers", "sinusoidal", "lamellar", "blazed", "disc", "bumps")
LAYOUTS = ("random", "mirror", "orders", "mixed")
DIRECTIONS = 128
STEEPEST_DEG = 85.0
LOWEST = math.cos(math.radians(STEEPEST_DEG))
# Just within what 380 nm and |(u, v)| = 2 ask for.
COARSEST_PITCH_UM = 0.0945
# The reference sums a patch of copies sample by sample, and their lobes one by one.
MOST_PATCH_SAMPLES = 1 << 14
MOST_IN_STEP_UM = 3000.0
OTHER_ILLUMINANTS = ("A", "C", "D50", "E")
# What is asked of the reference is half of a call's tolerance, and half of this at most.
TRUTH_TOLERANCE = 1e-3
# The reference settles to this share of a mirror's Y, and f is no smaller.
LEAST = 1e-10


class Configuration(NamedTuple):
    """One call, and in words what it is."""

    index: int
    seed: int
    hf: wd.HeightField
    coherence: wd.Coherence
    tolerance: float
    to_light: np.ndarray  # (n, 3)
    to_view: np.ndarray  # (n, 3)
    illuminant: str
    surface: str
    layout: str

    @property
    def stratum(self):
        return self.coherence.kind, self.tolerance

    @property
    def arguments(self):
        """Those of ``reflectance`` and of ``plan``, by name."""
        return {
            "hf": self.hf,
            "to_light": self.to_light,
            "to_view": self.to_view,
            "tolerance": self.tolerance,
            "coherence": self.coherence,
            "illuminant": self.illuminant,
        }

    def __str__(self):
        incidence = np.degrees(np.arccos(np.clip(self.to_light[:, 2], -1.0, 1.0)))
        pitch = " × ".join(f"{p:.3g}" for p in self.hf.pitch_um)
        size = " × ".join(f"{s:.3g}" for s in self.hf.size_um)
        return (
            f"{self.surface}, {size} µm, pitch {pitch}, height range {self.hf.height_range_um:.3g} µm; {self.coherence}"
            f"; tolerance {self.tolerance:g}; {self.layout}, incidence {incidence.min():.0f}° to {incidence.max():.0f}°"
            f"; {self.illuminant}"
        )


def configuration(index, seed=0, scan=None):
    """The configuration of an index; a scan is a height field to crop, without which fingers stand in for it."""
    rng = np.random.default_rng([seed, index])
    kind, tolerance = STRATA[index % len(STRATA)]
    name = SURFACES[rng.integers(len(SURFACES))]
    hf, name = surface(rng, name, scan, small=kind == "replicas")
    coherence = a_coherence(rng, kind, hf)
    layout = LAYOUTS[rng.integers(len(LAYOUTS))]
    lights, views, layout = directions(rng, hf, coherence, layout)
    illuminant = OTHER_ILLUMINANTS[rng.integers(len(OTHER_ILLUMINANTS))] if rng.random() < 0.1 else "D65"
    return Configuration(index, seed, hf, coherence, tolerance, lights, views, illuminant, name, layout)


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def surface(rng, name, scan, *, small=False):
    """A height field of a kind, of a height range of 0.02 to 3 µm, and its name; small ones have few samples."""
    seed = int(rng.integers(1 << 30))
    if name == "scan" and scan is not None:
        size = log_uniform(rng, 2.0, 30.0)
        place = tuple(rng.uniform(0.0, length - size - 0.1) for length in scan.size_um)
        hf = scan.cropped(size, offset_um=place)
        if rng.random() < 0.3 or hf.heights_um.size > MOST_PATCH_SAMPLES >= (size / COARSEST_PITCH_UM) ** 2:
            hf = hf.resampled(rng.uniform(hf.pitch_um[0], 0.09) if not small else 0.09)
    elif name in {"scan", "fingers"}:
        name = "fingers"
        period, length = log_uniform(rng, 0.8, 2.0), log_uniform(rng, 1.0, 5.0)
        size = tuple(max(log_uniform(rng, 2.0, 30.0), least) for least in (1.1 * length, 1.1 * period))
        pitch = 0.09 if small else rng.uniform(0.05, 0.09)
        hf = wd.gratings.fingers(size_um=size, pitch_um=pitch, period_um=period, length_um=length, seed=seed)
    elif name in {"sinusoidal", "blazed"}:
        hf = getattr(wd.gratings, name)(log_uniform(rng, 0.5, 20.0), 1.0)
    elif name == "lamellar":
        hf = wd.gratings.lamellar(log_uniform(rng, 0.5, 20.0), 1.0, duty=rng.uniform(0.1, 0.9))
    elif name == "disc":
        kind = ("CD", "DVD", "Blu-ray")[rng.integers(3)]
        track, least, pitch = {"CD": (1.6, 12.3, 0.09), "DVD": (0.74, 5.9, 0.09), "Blu-ray": (0.32, 2.4, 0.064)}[kind]
        tracks, length = max(1, round(log_uniform(rng, 2.0, 25.6) / track)), log_uniform(rng, least, 25.6)
        if not small:
            pitch = rng.uniform(0.04, pitch)
        hf = wd.gratings.disc(kind, tracks=tracks, length_um=length, pitch_um=pitch, seed=seed)
        name = f"disc {kind}"
    else:
        length, width = log_uniform(rng, 0.3, 3.0), log_uniform(rng, 0.3, 3.0)
        spacing = length * log_uniform(rng, 1.0, 3.0), width * log_uniform(rng, 1.0, 3.0)
        hf = wd.gratings.bumps(width_um=width, length_um=length, spacing_um=spacing, pitch_um=rng.uniform(0.04, 0.09))
    heights, pitch = hf.heights_um, hf.pitch_um
    if small:
        heights = fewer(heights)
    scale = np.ptp(heights)
    if scale == 0.0:
        heights, scale = heights + np.cos(2.0 * np.pi * np.arange(heights.shape[1]) / heights.shape[1]), 2.0
    return wd.HeightField(heights * (log_uniform(rng, 0.02, 3.0) / scale), pitch), name


def fewer(heights):
    """A corner of the heights with no more samples than the reference sums over."""
    ny, nx = heights.shape
    while ny * nx > MOST_PATCH_SAMPLES:
        ny, nx = (ny - ny // 8, nx) if ny >= nx else (ny, nx - nx // 8)
    return heights[:ny, :nx]


def a_coherence(rng, kind, hf):
    """A window, source or number of copies."""
    if kind == "source":
        return wd.Coherence(kind, angular_diameter_deg=log_uniform(rng, 0.1, 3.0))
    if kind == "replicas":
        most = [max(1.0, min(3000.0, MOST_IN_STEP_UM / length)) for length in hf.size_um]
        return wd.Coherence(kind, copies=tuple(max(1, round(log_uniform(rng, 1.0, each))) for each in most))
    centre = None
    if kind == "centred" and rng.random() < 0.5:
        centre = tuple(float(rng.uniform(0.0, length)) for length in hf.size_um)
    return wd.Coherence(kind, log_uniform(rng, 3.0, 65.0), centre_um=centre)


def directions(rng, hf, coherence, layout):
    """Lights and views, and in words how they lie: one light or many, views anywhere, by the mirror, by orders."""
    one = rng.random() < 0.5
    count = 1 if one else DIRECTIONS
    # Uniform in the angle of incidence; views uniform over the hemisphere.
    theta, phi = np.radians(rng.uniform(0.0, STEEPEST_DEG, count)), rng.uniform(0.0, 2.0 * np.pi, count)
    lights = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    lights = np.broadcast_to(lights, (DIRECTIONS, 3)).copy()
    spread = math.radians(log_uniform(rng, 0.3, 30.0))
    kinds = np.array(LAYOUTS[:3])[rng.integers(3, size=DIRECTIONS)] if layout == "mixed" else [layout] * DIRECTIONS
    views = np.array(
        [a_view(rng, kind, light, spread, hf, coherence) for kind, light in zip(kinds, lights, strict=True)]
    )
    words = {
        "random": "views anywhere",
        "mirror": f"views within some {math.degrees(spread):.2g}° of the mirror direction",
        "orders": "views by orders",
        "mixed": f"views anywhere, within some {math.degrees(spread):.2g}° of the mirror direction and by orders",
    }
    return lights, views, f"{'one light' if one else 'a light a view'}, {words[layout]}"


def a_view(rng, kind, light, spread, hf, coherence):
    """A unit vector not beyond the steepest view."""
    mirror = np.array([-light[0], -light[1], light[2]])
    while True:
        z, phi = rng.uniform(LOWEST, 1.0), rng.uniform(0.0, 2.0 * np.pi)
        view = np.array([math.sqrt(1.0 - z * z) * math.cos(phi), math.sqrt(1.0 - z * z) * math.sin(phi), z])
        if kind == "mirror":
            # The mirror direction may itself lie at the steepest one; half of its neighbours do not.
            view = mirror + spread * rng.normal(size=3)
            view /= np.linalg.norm(view)
        elif kind == "orders":
            view = by_an_order(rng, light, view, hf, coherence)
        if view is not None and view[2] >= LOWEST:
            return view


def by_an_order(rng, light, view, hf, coherence):
    """A view by the order that is nearest at a random wavelength, some widths of its lobe away; None below."""
    wavelength = rng.uniform(0.38, 0.78)
    lengths = np.array([hf.size_um[1], hf.size_um[0]])
    orders = np.rint(-(light + view)[:2] / wavelength * lengths)
    # An axis of one sample is constant: it has no order but 0.
    orders[[hf.shape[1] == 1, hf.shape[0] == 1]] = 0.0
    if coherence.kind == "replicas":
        width = wavelength / (lengths * np.array(coherence.copies[::-1]))
    elif coherence.kind == "source":
        width = coherence.spread
    else:
        width = wavelength / (2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um)
    across = -light[:2] - wavelength * orders / lengths + width * rng.normal(size=2)
    square = float(across @ across)
    return None if square >= 1.0 else np.array([*across, math.sqrt(1.0 - square)])


class Figure(NamedTuple):
    """The error of a call: the larger of two percentiles 99."""

    value: float
    bright: float  # of ‖ΔXYZ‖ / max(‖XYZ‖, f) where Y >= f
    dim: float  # of ‖ΔXYZ‖ / f where Y < f
    share_dim: float
    white: float  # percentile 99 of Y
    errors: np.ndarray  # of each direction


def figure(xyz, truth):
    """The design's error of a picture, of XYZ against the truth, both (n, 3) and all lit, but for f's lower limit."""
    moved = np.linalg.norm(xyz - truth, axis=1)
    moved[~np.isfinite(moved)] = np.inf
    white = float(np.percentile(truth[:, 1], 99.0))
    floor = max(1e-3 * white, LEAST)
    above = truth[:, 1] >= floor
    errors = moved / np.where(above, np.maximum(np.linalg.norm(truth, axis=1), floor), floor)
    bright, dim = (percentile_99(errors[mask]) for mask in (above, ~above))
    return Figure(max(bright, dim), bright, dim, float(np.mean(~above)), white, errors)


def percentile_99(values):
    """Percentile 99, infinite where one of the two values that it lies between is."""
    if len(values) == 0:
        return 0.0
    with np.errstate(invalid="ignore"):
        found = float(np.percentile(values, 99.0))
    return math.inf if math.isnan(found) else found


def truth_tolerance(tolerance):
    """What is asked of the reference for a call's tolerance."""
    return 0.5 * min(tolerance, TRUTH_TOLERANCE)
