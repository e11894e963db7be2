"""Random inputs of plans, for ``bench/dev/tight_plans.py``: surface, coherence, tolerance and directions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff.apps import demo

if TYPE_CHECKING:
    from pathlib import Path

# Number of directions of a call. The library makes a plan (numbers of wavelengths and terms) for these directions.
PLANNED = 40_000
# Smallest cosine of the angle between random directions and the normal; the angle is at most 85°.
LOWEST = math.cos(math.radians(85.0))
KINDS = ("averaged", "centred", "source", "replicas")
# Tolerances of the configurations. Replicated patches are not tried at tolerances below 1e-2, because the float64
# reference of such patches would take too long.
TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3)
REPLICAS_TOLERANCES = (1e-1, 3e-2, 1e-2)
PITCH_UM = 0.09  # sample spacing of the synthetic surfaces [µm]


class Configuration(NamedTuple):
    """Inputs of a plan (numbers of wavelengths and terms): surface, coherence, tolerance and directions."""

    surface: str
    heightfield: wd.HeightField
    coherence: wd.Coherence
    tolerance: float
    lights: np.ndarray  # directions to the light, shape (40000, 3)
    views: np.ndarray

    def __str__(self) -> str:
        return f"{self.surface} | {self.coherence.kind} | {self.tolerance:g}"


def surfaces(data: Path | None) -> dict[str, wd.HeightField]:
    """Return height fields by name; they include crops of the scan of a snake's skin if its file is available."""
    result = {
        f"fingers {size:g} µm": wd.gratings.fingers(size_um=size, pitch_um=PITCH_UM) for size in (6.4, 12.8, 25.6)
    }
    result |= {
        f"fingers {size:g} µm, {height:g} µm high": wd.gratings.fingers(
            size_um=size, pitch_um=PITCH_UM, height_um=height, seed=1
        )
        for size, height in ((12.8, 1.0), (6.4, 3.0))
    }
    result["blazed 5 µm"] = wd.gratings.blazed(5.0, 0.8)
    result["disc 12.8 µm"] = wd.gratings.disc("CD", length_um=12.8, pitch_um=0.08)
    if data is not None and (data / demo.SCAN).is_file():
        scan = demo.cleaned_scan(data / demo.SCAN)
        result |= {f"scan {size:g} µm": scan.cropped(size) for size in (6.5, 12.5, 25.0)}
        result["scan 65 µm"] = scan
    else:
        print(f"{demo.SCAN} is not available: only synthetic surfaces are used")
    return result


def configurations(data: Path | None, count: int, seed: int) -> list[Configuration]:
    """Return random inputs of plans. Kinds of coherence alternate; surfaces and tolerances occur equally often."""
    rng = np.random.default_rng(seed)
    fields = surfaces(data)
    # The float64 reference sums every height sample of a replicated patch, so that only small patches are used.
    small = [name for name, heightfield in fields.items() if math.prod(heightfield.shape) <= 1 << 14]
    remaining: dict[Any, list[Any]] = {}

    def draw(which: Any, among: Any) -> Any:
        if not remaining.get(which):
            remaining[which] = list(rng.permutation(len(among)))
        return list(among)[remaining[which].pop()]

    result = []
    for index in range(count):
        kind = KINDS[index % len(KINDS)]
        periods = kind == "replicas"
        surface = draw((periods, "surface"), small if periods else fields)
        tolerance = draw((kind, "tolerance"), REPLICAS_TOLERANCES if periods else TOLERANCES)
        pair = None
        if periods:
            most = 40 if fields[surface].shape[0] == 1 else 12
            pair = (1 if fields[surface].shape[0] == 1 else int(rng.integers(2, most)), int(rng.integers(2, most)))
        # Half of the calls have one light direction, as for a reflectance map. The other calls have a light direction
        # for each view direction, as for a picture.
        one = _upper(rng, 1) if rng.random() < 0.5 else None
        light = _upper(rng, PLANNED) if one is None else np.repeat(one, PLANNED, axis=0)
        coherence = wd.Coherence(kind, periods=pair)
        result.append(Configuration(surface, fields[surface], coherence, tolerance, light, _upper(rng, PLANNED)))
    return result


def _upper(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return random unit vectors up to 85° from the normal, with a uniform density per solid angle."""
    z, phi = rng.uniform(LOWEST, 1.0, count), rng.uniform(0.0, 2.0 * math.pi, count)
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)
