"""Cost model: multiply-adds of sampled wavelengths, of look-ups and of making a table.

What else they cost is counted in as many multiply-adds. ``Plan`` turns these into seconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.diffraction.coefficient_basis import holds_powers
from warpdiff.kernels import coefficient_sum
from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, LAMBDA_MIN_NM
from warpdiff.tables import coefficient_table, mip_layout, polar_grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.request.plan import Plan

# Of 1/λ [1/µm].
SPAN = 1e3 / LAMBDA_MIN_NM - 1e3 / LAMBDA_MAX_NM
# What a wavelength costs besides its multiply-adds, in as many of them: by itself, for each term of the basis, for each
# neighbour, and for the copies' factor. Fitted to times on two cores, of which they explain all but a factor of 1.5.
_COST_OF_WAVELENGTH, _COST_OF_TERM, _COST_OF_NEIGHBOUR, _COST_OF_INTERFERENCE = 340.0, 16.0, 20.0, 280.0
# Azimuths and nodes that a line shows on.
_AZIMUTHS_OF_LINE, _RINGS_OF_LINE = 7.0, 3.0
# What a sample of the spectrum costs besides its multiply-adds, in as many of them: by itself, for powers or for either
# part of amplitudes, and for each neighbour; what a line costs; what a number of a row that is filtered and written.
_COST_OF_SAMPLE, _COST_OF_SAMPLES_NEIGHBOUR, _COST_OF_LINE, _COST_OF_NUMBER = 150.0, 4.0, 20.0, 35.0
# Multiply-adds of a projection, which are made of SIMD alone, in those of all other kernels.
_COST_OF_DENSE_MULTIPLY_ADD = 0.2


def wavelength_count(plan: Plan, order_rate: float, w: float) -> float:
    """How many wavelengths a direction takes."""
    per_lateral, per_w, constant = plan.bandwidth_um
    return SPAN * (per_lateral * order_rate + per_w * w + constant) + 1.0


def sampling_multiply_adds(
    heightfield: HeightField, plan: Plan, order_rates: NDArray[np.float64], w: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
) -> float:  # fmt: skip
    """Predicted multiply-adds of a direction, in the mean over directions of some lateral and |w|."""
    lanes = coefficient_table.lanes_of(plan.terms)
    parts = 1 if holds_powers(plan.method, adds_powers=plan.coherence.adds_powers) else 2
    samples: NDArray[np.float64] = np.full(len(w), max(plan.wavelengths, 1.0))
    if plan.adaptive and plan.wavelengths:
        needed = [
            wavelength_count(plan, float(order_rate), float(w_size))
            for order_rate, w_size in zip(order_rates, w, strict=True)
        ]
        samples = np.minimum(samples, np.asarray(needed) * 2.0 ** (0.5 / 4.0))
    if plan.coherence.kind == "replicas":
        neighbours: float = coefficient_sum.TAPS**2 if heightfield.shape[0] > 1 else coefficient_sum.TAPS
    else:
        radius = math.sqrt(-math.log(plan.least_weight) / coefficient_table.falloff_um2(plan.coherence, 0.5))
        widths = [
            2.0 * radius * length if n > 1 else 1.0
            for n, length in zip(heightfield.shape, heightfield.size_um, strict=True)
        ]
        neighbours = math.prod(widths)
    per_sample = (
        _COST_OF_WAVELENGTH
        + _COST_OF_TERM * lanes * min(1.0, neighbours)
        + neighbours * (_COST_OF_NEIGHBOUR + parts * lanes)
    )
    if plan.coherence.kind == "replicas":
        per_sample += _COST_OF_INTERFERENCE * plan.subdivisions
    return float(np.average(samples, weights=weights) * per_sample)


def look_up_multiply_adds(plan: Plan) -> float:
    """The multiply-adds of a look-up."""
    return 9.0 * 3.0 * (plan.w_basis_size or coefficient_table.lanes_of(plan.terms))


def table_multiply_adds(heightfield: HeightField, plan: Plan) -> float:
    """The cost of making a table, in the multiply-adds of ``Plan``."""
    layout = mip_layout.layout_of(plan)
    parts = 1 if plan.coherence.adds_powers else 2
    lanes = coefficient_table.lanes_of(plan.terms)
    if plan.coherence.kind == "source":
        lines = 2.0 * math.pi * layout.highest**2 * math.prod(heightfield.size_um)
        sampling = lines * _AZIMUTHS_OF_LINE * (_COST_OF_LINE + 2.0 * _RINGS_OF_LINE * lanes)
    else:
        neighbours = (
            math.pi
            * -math.log(plan.least_weight)
            / coefficient_table.falloff_um2(plan.coherence)
            * math.prod(heightfield.size_um)
        )
        sampling = layout.samples * (
            parts * _COST_OF_SAMPLE + neighbours * (_COST_OF_SAMPLES_NEIGHBOUR + parts * lanes)
        )
    # About as many powers as terms, or twice as many of amplitudes, and as many functions of w, for X, Y and Z.
    powers = parts * plan.terms
    projection = layout.levels[0].nodes * polar_grid.ring_count(plan.rings_per_octave) * powers * (powers + 3.0)
    return sampling + _COST_OF_DENSE_MULTIPLY_ADD * projection + _COST_OF_NUMBER * layout.rows * 3.0 * powers
