"""Cost model: predicted multiply-adds of sums over wavelengths, of look-ups in colour tables and of making such tables.

A plan holds the numbers of a computation, such as the number of wavelengths. A table holds the colours of a surface,
sampled over (u, v), from which look-ups interpolate. Operations that are not multiply-adds count as the number of
multiply-adds that require the same time. ``Plan`` converts multiply-adds to seconds. The constants were fitted to times
on two cores; the model predicts these times within a factor of 1.5.

The planner compares predicted costs, and prefers a table above a certain number of directions. If one constant is
doubled, this number changes by less than a factor of 2. "Source" means a light source of finite size (coherence of the
kind "source").
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from warpdiff.diffraction.coefficient_basis import holds_powers
from warpdiff.kernels import coefficient_sum
from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, LAMBDA_MIN_NM, NM_PER_UM
from warpdiff.tables import coefficient_table, lookup, mip_layout, polar_grid, spectrum_source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.request.plan import Plan

_Numbers = TypeVar("_Numbers", float, "NDArray[np.float64]")

# Length of the visible band in 1/λ [1/µm].
SPAN = NM_PER_UM / LAMBDA_MIN_NM - NM_PER_UM / LAMBDA_MAX_NM
# Costs of a sum over Fourier coefficients [multiply-adds], in addition to the products of the sum itself. The first
# cost is per wavelength, or per sample of the interference factor of replicated patches. The second cost is per term of
# the series in which a coefficient is expanded, and the same cost is added per coefficient. Both were fitted to times.
_COST_OF_WAVELENGTH, _COST_OF_STEP = 340.0, 18.0
# Cost of sampling the power spectrum of a surface for a colour table [multiply-adds], in addition to the products of
# the sum over Fourier coefficients. The cost is per sample of the spectrum. For a light source of finite size, whose
# spectrum is a sum of lines, it is per spectral line. It was fitted to times.
_COST_OF_SAMPLE = 150.0
# Costs of computing a colour table from the power spectrum of a surface [multiply-adds]. The first cost is for
# filtering and writing one number of the table. The second cost is for one product in the conversion (projection) of
# the spectrum to colours. It is below 1, because the loop of the projection uses SIMD instructions only. Both were
# fitted to times.
_COST_OF_ROW_COLOUR, _COST_OF_DENSE_MULTIPLY_ADD = 105.0, 0.2


def wavelength_count(plan: Plan, order_rate: _Numbers, w: _Numbers) -> _Numbers:
    """Return the number of wavelengths that each direction requires, from its order rate and |w|.

    The order rate is how fast orders pass a direction as 1/λ changes. w is the normal component of the scattering
    vector.
    """
    per_rate, per_w, constant = plan.bandwidth_um
    return SPAN * (per_rate * order_rate + per_w * w + constant) + 1.0


def sampling_multiply_adds(
    heightfield: HeightField, plan: Plan, order_rates: NDArray[np.float64], w: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
) -> float:  # fmt: skip
    """Predict the multiply-adds per direction with sampled wavelengths (without a table), as a mean over directions."""
    lanes = coefficient_table.lanes_of(plan.terms)
    parts = 1 if holds_powers(plan.method, adds_powers=plan.coherence.adds_powers) else 2
    samples: NDArray[np.float64] = np.full(len(w), max(plan.wavelengths, 1.0))
    if plan.adaptive and plan.wavelengths:
        # Only certain numbers of wavelengths are available, with a constant ratio between consecutive numbers. The
        # smallest sufficient one of these numbers is used. On average, it exceeds the required number by the square
        # root of this ratio.
        needed = wavelength_count(plan, order_rates, w)
        samples = np.minimum(samples, needed * 2.0 ** (0.5 / coefficient_table.SETS_PER_OCTAVE))
    factors = 1
    if plan.coherence.kind == "replicas":
        neighbours: float = coefficient_sum.TAPS**2 if heightfield.shape[0] > 1 else coefficient_sum.TAPS
        factors += plan.subdivisions
    else:
        # For a light source of finite size, the radius within which Fourier coefficients are summed depends on the
        # wavelength. The radius at 0.5 µm, a typical wavelength, is used.
        radius = math.sqrt(-math.log(plan.least_weight) / coefficient_table.falloff_um2(plan.coherence, 0.5))
        neighbours = math.prod(
            2.0 * radius * length if n > 1 else 1.0
            for n, length in zip(heightfield.shape, heightfield.size_um, strict=True)
        )
    per_sample = (
        _COST_OF_WAVELENGTH * factors
        + _COST_OF_STEP * (lanes * min(1.0, neighbours) + neighbours)
        + neighbours * parts * lanes
    )
    return float(np.average(samples, weights=weights) * per_sample)


def look_up_multiply_adds(plan: Plan) -> float:
    """Predict the multiply-adds of one look-up in a colour table."""
    return lookup.MULTIPLY_ADDS_OF_FUNCTION * (plan.w_basis_size or coefficient_table.lanes_of(plan.terms))


def table_multiply_adds(heightfield: HeightField, plan: Plan) -> float:
    """Predict the multiply-adds of computing the colour table of a plan."""
    layout = mip_layout.layout_of(plan)
    parts = 1 if plan.coherence.adds_powers else 2
    lanes = coefficient_table.lanes_of(plan.terms)
    area = math.prod(heightfield.size_um)
    if plan.coherence.kind == "source":
        lines = 2.0 * math.pi * layout.highest**2 * area
        sampling = lines * (_COST_OF_SAMPLE + spectrum_source.NODES_OF_LINE * lanes)
    else:
        neighbours = math.pi * area * -math.log(plan.least_weight) / coefficient_table.falloff_um2(plan.coherence)
        sampling = layout.samples * parts * (_COST_OF_SAMPLE + neighbours * lanes)
    # A row of the sampled power spectrum has about one number per basis function (term). If amplitudes of Fourier
    # coefficients add, it has two numbers per term. A table needs about as many functions of w (the normal component of
    # the scattering vector) as such a row has numbers, and stores X, Y and Z for each function.
    powers = parts * plan.terms
    rings = polar_grid.ring_count(plan.rings_per_octave)
    projection = layout.levels[0].nodes * rings * powers * (powers + 2.0)
    return sampling + _COST_OF_DENSE_MULTIPLY_ADD * projection + _COST_OF_ROW_COLOUR * layout.rows * powers
