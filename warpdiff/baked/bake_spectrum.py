"""``bake_spectrum``: tabulates the power spectrum over q = (u, v)/λ, for renderers that sample wavelengths.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge, Interval

from warpdiff.baked.spectrum_table import BakedSpectrum
from warpdiff.core import memory
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.materials import DEFAULT_IOR
from warpdiff.planner.strategy import directions_of, plan_for
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings
from warpdiff.request.signatures import checked
from warpdiff.tables import coefficient_table
from warpdiff.tables.zeroth_order import ZerothOrder

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence

# A spectrum is stored as sums of products: a coefficient for q = (u, v)/λ times a function of κ = w/λ. This is the
# number of equally spaced |κ| at which these functions and the power of the zeroth order are tabulated.
_ENTRIES = 512


@checked
def bake_spectrum(
    heightfield: HeightField, *, size: Annotated[int, Interval(ge=16, le=8192)] = 1024,
    tolerance: Annotated[float, Interval(ge=1e-5, le=0.5)] = 1e-2, coherence: Coherence | None = None,
    device: Any = None, threads: Annotated[int, Ge(1)] | None = None,
) -> BakedSpectrum:  # fmt: skip
    """Bake the power spectrum of all directions and visible wavelengths.

    A renderer that samples wavelengths looks up the spectrum at q = (u, v)/λ and κ = w/λ. The table divides a square of
    q into cells. Each cell contains the mean over its area, so that narrow lobes (peaks of diffraction orders) are
    blurred but retain their power. With 1,024 cells per side and σ = 16.25 µm, the width of a cell is 1.5 times the
    standard deviation of a lobe.

    Args:
        heightfield: Height field whose power spectrum is baked.
        size: Number of cells along each side.
        tolerance: Largest error from the truncated sum over functions of κ, relative as for
            :func:`warpdiff.spectral_reflectance`.
        coherence: Averaged window, whose lobes have the same width in q at all wavelengths; None has σ = 16.25 µm.
        device: Warp device, ``"cpu"`` or ``"cuda"``; None is the CPU.
        threads: Threads on the CPU; None is one per core.

    Returns:
        Table of the power spectrum.

    Raises:
        ValueError: An argument is out of its range, or the coherence is not an averaged window.
        MemoryError: The table requires more memory than is free; the message states the size that fits.

    Examples:
        >>> import warpdiff as wd
        >>> window = wd.Coherence(sigma_um=2.0)
        >>> spectrum = wd.bake_spectrum(wd.gratings.sinusoidal(2.0, 0.1), size=16, tolerance=0.1, coherence=window)
        >>> spectrum.coherence
        Coherence(kind='averaged', sigma_um=2.0, centre_um=None, angular_diameter_deg=None, periods=None)
    """
    settings = PlanSettings(
        tolerance=tolerance, method="low-rank", coherence=coherence, ior=DEFAULT_IOR, device=device, threads=threads
    )
    request = Evaluation.of(heightfield, settings)
    window = request.coherence
    if window.kind != "averaged":
        raise ArgumentValueError(f"{ref('coherence')} must be of kind 'averaged' for a spectrum, got {window.kind!r}")
    with memory.as_memory_error("bake_spectrum()", f"take a smaller {ref('size')}"):
        direction_range, sample, _ = directions_of(request)
        plan = plan_for(request, direction_range, sample, float(len(sample)))
        table = coefficient_table.table_for(
            heightfield, plan, direction_range, device=request.device, threads=request.threads
        )
        coefficients = table.coefficients
        terms = min(plan.terms, coefficients.terms)
        memory.require_memory(
            8.0 * size * size * terms, f"a spectrum of {size} × {size} cells", "take {side} of the size"
        )
        kappa_range = coefficient_table.CoefficientRange.covering(plan.direction_range.joined(direction_range))
        ends = kappa_range.kappa_low, kappa_range.kappa_high
        along = 2.0 * math.pi * (window.sigma_um or 0.0)
        largest = direction_range.max_uv * 1e3 / direction_range.lambda_min_nm
        at = table.arguments
        rows = coefficients.rows[:, :, 0, :terms].copy()
        rows[at.origin_y, at.origin_x] = 0.0
        across_y = _shares(size, largest, (np.arange(at.count_y) - at.origin_y) / at.length_y, along)
        across_x = _shares(size, largest, (np.arange(at.count_x) - at.origin_x) / at.length_x, along)
        powers = np.empty((size, size, terms), dtype=np.float32)
        for term in range(terms):
            powers[:, :, term] = across_y @ rows[:, :, term] @ across_x.T
    functions = coefficients.basis_at(np.linspace(*ends, _ENTRIES))[:, :terms].astype(np.float32)
    zeroth = ZerothOrder.of_heights(heightfield, window, ends, _ENTRIES).power
    return BakedSpectrum(float(window.sigma_um or 0.0), largest, powers, *ends, functions, zeroth)


def _shares(size: int, largest: float, orders: NDArray[np.float64], falloff: float) -> NDArray[np.float32]:
    """Return the mean of each diffraction order's Gaussian lobe over each cell of an axis, shape (size, orders).

    The cells are ``size`` equal intervals of q from −``largest`` to ``largest``. The lobe (peak) of an order is exp(−(a
    (q − q_r))²). Here q_r is the order's frequency, an element of ``orders`` [1/µm], and a is ``falloff`` [µm].
    """
    from scipy.special import erf

    edges = np.linspace(-largest, largest, size + 1)
    below = erf(falloff * (edges[:, None] - orders))
    scale = math.sqrt(math.pi) / (2.0 * falloff * (edges[1] - edges[0]))
    return np.asarray(scale * np.diff(below, axis=0), dtype=np.float32)
