"""The coefficients of a height field on a device, as the spectral kernels read them; kept for the next call."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import fourier, spectrum
from warpdiff.expansions import EXPANSIONS, check_cycles
from warpdiff.planning import bandwidth_um

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.heightfield import HeightField
    from warpdiff.planning import Plan

# Rows of the table are padded to whole SIMD registers, and each length is a kernel of its own.
_LANES = 8
# Distance in x of the entries that the basis is interpolated from: the cubic errs by 0.023 · step⁴, 2e-8.
_BASIS_STEP = 1.0 / 32.0
# A Taylor basis far beyond its range, which is computed on request only, stays within float32.
_LARGEST = 1e30
_FEWEST_WAVELENGTHS = 16
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


def table_for(
    hf: HeightField, plan: Plan, max_uv: float, max_w: float, max_wavenumber: float, *, device: wp.Device, threads: int
) -> Table:
    """The table for a plan, built or found again.

    Args:
        hf: The height field.
        plan: Series, number of terms, neighbourhood and window.
        max_uv: Largest |(u, v)| to serve.
        max_w: Largest |w| to serve.
        max_wavenumber: Largest 1/λ to serve [1/µm].
        device: Where the table lies.
        threads: Transforms to run side by side.
    """
    # Rounded up, so that the small changes of a moving light or view, and all visible wavelengths, meet the same table.
    max_wavenumber = max(max_wavenumber, 1e3 / spectrum.LAMBDA_MIN_NM)
    frequency = math.ceil(2.0 * max_uv * max_wavenumber + 0.1) / 2.0
    kappa = math.ceil(2.0 * max_w * max_wavenumber + 0.1) / 2.0
    check_cycles(hf, kappa)
    block = fourier.Block.covering(hf, frequency, plan.reach)
    key = (device.alias, block, kappa, plan.method, plan.terms, plan.reach, plan.coherence)
    kept = _cache.setdefault(hf, {})
    if key in kept:
        kept[key] = kept.pop(key)
    else:
        kept[key] = _build(hf, plan, block, kappa, device=device, threads=threads)
        while len(kept) > _KEPT:
            kept.pop(next(iter(kept)))
    return kept[key]


def quadrature_for(hf: HeightField, plan: Plan, illuminant: str, *, device: wp.Device) -> Any:
    """The struct ``Quadrature`` of the spectral kernels, for a plan and an illuminant."""
    import warp as wp

    from warpdiff.kernels import spectral

    parts = bandwidth_um(hf, plan.coherence, plan.tolerance)
    largest = parts[0] * plan.max_uv + parts[1] * plan.max_w + parts[2]
    counts = [plan.wavelengths]
    # As many sets as the constant part leaves room for; a set of a few wavelengths is not worth a choice.
    levels = math.floor(2.0 * math.log2(largest / parts[2])) if plan.adaptive else 0
    for level in range(1, levels + 1):
        fewer = math.ceil(plan.wavelengths * 2.0 ** (-level / 2.0))
        if fewer < _FEWEST_WAVELENGTHS:
            break
        counts.append(fewer)
    sets = [spectrum.uniform_quadrature(count, illuminant) for count in counts]
    result = spectral.Quadrature()
    result.wavenumbers = wp.array(np.concatenate([nodes for nodes, _ in sets]), dtype=wp.float64, device=device)
    weights = np.concatenate([each for _, each in sets]).astype(np.float32)
    result.weights = wp.array(weights, dtype=wp.vec3f, device=device)
    result.firsts = wp.array(np.cumsum([0, *counts]).astype(np.int32), dtype=wp.int32, device=device)
    result.per_uv, result.per_w, result.constant = (part / largest for part in parts)
    return result


def _build(
    hf: HeightField, plan: Plan, block: fourier.Block, kappa: float, *, device: wp.Device, threads: int
) -> Table:
    import warp as wp

    from warpdiff.kernels import spectral

    coherence = plan.coherence
    lanes = _LANES * math.ceil(plan.terms / _LANES)
    kernels = spectral.kernels(lanes, coherence.kind == "centred")
    expansion = EXPANSIONS[plan.method]
    series = fourier.series_coefficients(hf, expansion, plan.terms, block, threads=threads, dtype=np.complex64)
    if coherence.kind == "centred":
        series *= _centre_phase(hf, plan, block)[:, :, None]
    rows = np.zeros((*block.count, 2, lanes), dtype=np.float32)
    rows[:, :, 0, : plan.terms] = series.real
    rows[:, :, 1, : plan.terms] = series.imag

    table = kernels.Table()
    table.rows = wp.array(rows.reshape(-1, lanes), dtype=kernels.row, device=device)
    turns = 2.0 * math.pi * expansion.offset_and_scale(hf)[1]
    steps = np.arange(-1, math.ceil(turns * kappa / _BASIS_STEP) + 3)
    basis = np.zeros((len(steps), lanes), dtype=np.float32)
    basis[:, : plan.terms] = np.clip(expansion.basis(-_BASIS_STEP * steps, plan.terms), -_LARGEST, _LARGEST)
    table.basis = wp.array(basis, dtype=kernels.row, device=device)
    table.basis_steps = turns / _BASIS_STEP
    table.count_y, table.count_x = block.count
    table.origin_y, table.origin_x = block.origin
    table.reach_y, table.reach_x = plan.reach
    table.length_y, table.length_x = lengths = fourier.axis_lengths_um(hf)
    table.falloff_y, table.falloff_x = falloff = [coherence.falloff_um2 / length**2 for length in lengths]
    table.shrink_y, table.shrink_x = (math.exp(-2.0 * each) for each in falloff)
    return Table(kernels.integrate, kernels.sample, table)


def _centre_phase(hf: HeightField, plan: Plan, block: fourier.Block) -> np.ndarray:
    """exp(−2πi q_rs·x_c), which moves the window from the patch's corner to x_c."""
    middle = ((hf.shape[0] // 2) * hf.pitch_um[0], (hf.shape[1] // 2) * hf.pitch_um[1])
    centre = plan.coherence.centre_um or middle
    s, r = block.orders()
    turns = s[:, None] * (centre[0] / hf.size_um[0]) + r[None, :] * (centre[1] / hf.size_um[1])
    return np.exp(-2j * math.pi * turns)
