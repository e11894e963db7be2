"""The coefficients of a height field on a device, as the spectral kernels read them; kept for the next call."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import fourier

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.heightfield import HeightField
    from warpdiff.planning import Plan

# Rows of the table are padded to whole SIMD registers, and each length is a kernel of its own.
_LANES = 8
# Tables that a height field keeps: a light or a view that moves asks for the same one again.
_KEPT = 4
_cache: weakref.WeakKeyDictionary[HeightField, dict[Any, Table]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class Table:
    """Kernels and the struct they read.

    Attributes:
        integrate: Kernel that integrates over λ to XYZ.
        sample: Kernel that evaluates given wavelengths.
        arguments: Their first argument.
    """

    integrate: Any
    sample: Any
    arguments: Any


def table_for(hf: HeightField, plan: Plan, frequency: float, *, device: wp.Device, threads: int) -> Table:
    """The table for a plan that serves |(u, v)|/λ up to ``frequency`` [1/µm], built or found again."""
    # Rounded up, so that the small changes of a moving light or view meet the same table.
    block = fourier.Block.covering(hf, math.ceil(2.0 * frequency + 0.1) / 2.0, plan.reach)
    key = (device.alias, block, plan.terms, plan.reach, plan.coherence)
    kept = _cache.setdefault(hf, {})
    if key in kept:
        kept[key] = kept.pop(key)
    else:
        kept[key] = _build(hf, plan, block, device=device, threads=threads)
        while len(kept) > _KEPT:
            kept.pop(next(iter(kept)))
    return kept[key]


def _build(hf: HeightField, plan: Plan, block: fourier.Block, *, device: wp.Device, threads: int) -> Table:
    import warp as wp

    from warpdiff.kernels import spectral

    coherence = plan.coherence
    lanes = _LANES * math.ceil(plan.terms / _LANES)
    kernels = spectral.kernels(lanes, coherence.kind == "centred")
    series = fourier.taylor_coefficients(hf, plan.terms, block, threads=threads, dtype=np.complex64)
    if coherence.kind == "centred":
        series *= _centre_phase(hf, plan, block)[:, :, None]
    rows = np.zeros((*block.count, 2, lanes), dtype=np.float32)
    rows[:, :, 0, : plan.terms] = series.real
    rows[:, :, 1, : plan.terms] = series.imag

    table = kernels.Table()
    table.rows = wp.array(rows.reshape(-1, lanes), dtype=kernels.row, device=device)
    table.basis_scale = kernels.row(*[1.0 / max(n, 1) for n in range(lanes)])
    table.count_y, table.count_x = block.count
    table.origin_y, table.origin_x = block.origin
    table.reach_y, table.reach_x = plan.reach
    table.length_y, table.length_x = hf.size_um
    table.falloff_y, table.falloff_x = (coherence.falloff_um2 / length**2 for length in hf.size_um)
    table.height_scale = fourier.height_middle_and_half_range(hf)[1]
    return Table(kernels.integrate, kernels.sample, table)


def _centre_phase(hf: HeightField, plan: Plan, block: fourier.Block) -> np.ndarray:
    """exp(−2πi q_rs·x_c), which moves the window from the patch's corner to x_c."""
    middle = ((hf.shape[0] // 2) * hf.pitch_um[0], (hf.shape[1] // 2) * hf.pitch_um[1])
    centre = plan.coherence.centre_um or middle
    s, r = block.orders()
    turns = s[:, None] * (centre[0] / hf.size_um[0]) + r[None, :] * (centre[1] / hf.size_um[1])
    return np.exp(-2j * math.pi * turns)
