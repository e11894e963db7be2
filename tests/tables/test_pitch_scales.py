"""Look-ups in one table for all pitch scales of a grating map, under a light source of finite size.

A grating map is an array of dots. The pitch scale of a dot multiplies all lengths of its height field, relative to the
cell, the height field of the map. In a look-up, the length of the vector to the light is the pitch scale. Colours are
compared with direct sums.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp
from conftest import hemisphere

import warpdiff as wd
from warpdiff.device.devices import resolve_device
from warpdiff.optics import reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.tables.lookup import ColourLookup

SOURCE = wd.Coherence("source", angular_diameter_deg=3.0)
SCALES = np.array([0.7, 1.0, 1.4])


def test_one_table_serves_all_pitch_scales(rng: np.random.Generator) -> None:
    """Colours of stretched height fields must be those of one table at scaled (u, v), blurred by a scaled light source.

    (u, v) is the tangential part of the scattering vector. Near the mirror direction, the table has no colours, and a
    look-up sums over wavelengths instead.
    """
    cell = wd.gratings.fingers(size_um=(3.0, 1.2), pitch_um=0.06)
    scales = np.repeat(SCALES, 12)
    lights, views = hemisphere(rng, len(scales)), hemisphere(rng, len(scales))
    # If light or view is near the horizon, diffraction orders pass a direction quickly as the wavelength changes.
    # Direct sums then need many wavelengths and are slow, so that such directions are avoided.
    lights, views = (np.where(d[:, 2:] < 0.5, d + np.array([0.0, 0.0, 1.0]), d) for d in (lights, views))
    lights, views = (d / np.linalg.norm(d, axis=1)[:, None] for d in (lights, views))
    options = {"coherence": SOURCE, "ior": np.inf, "masking": False, "strict": False}
    exact = np.zeros((len(scales), 3))
    for scale in SCALES:
        field = wd.HeightField.of_known_scale(cell.heights_um, tuple(scale * pitch for pitch in cell.pitch_um))
        own = scales == scale
        exact[own] = wd.reflectance(field, lights[own], views[own], method="direct", tolerance=1e-2, **options)
    grating_map = wd.GratingMap(cell, pitch_scale=SCALES[None, :])
    options |= {"coherence": grating_map.table_coherence(SOURCE)}
    sampled = wd.plan(grating_map.reference, tolerance=0.01, method="low-rank", **options)
    table = replace(sampled, rings_per_octave=32, azimuths_per_width=2.25, least_weight=1e-8)
    device = resolve_device("cpu")
    lateral = (scales / SCALES.max())[:, None] * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    gains = reflectance_factors.gain(lights, views, normal=1.0, masking=False, per_light_cosine=True)
    floor = 1e-3 * np.percentile(exact[:, 1], 99.0)
    for plan, most in ((table, 0.1), (sampled, 0.01)):
        lookup = ColourLookup(
            grating_map.reference, plan, plan.direction_range, pitch_scales=True, device=device, threads=1
        )
        xyz = wp.zeros(len(scales), dtype=wp.vec3f, device=device)
        lookup.accumulate(
            wp.array(-lateral * (lights + views), dtype=wp.vec3d, device=device),
            wp.array((scales / SCALES.min())[:, None] * lights, dtype=wp.vec3f, device=device),
            wp.array(gains, dtype=wp.float32, device=device), IlluminatedMaterial("D65", None), xyz,
        )  # fmt: skip
        errors = np.linalg.norm(xyz.numpy() - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor)
        for scale in SCALES:
            assert np.percentile(errors[scales == scale], 90.0) < most, (plan.rings_per_octave, scale)
            assert np.median(errors[scales == scale]) < 0.2 * most, (plan.rings_per_octave, scale)
