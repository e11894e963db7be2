"""Tables of the Fourier coefficients of a height field on a device, in the layout that kernels read, with a cache.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. A coefficient is a Fourier coefficient of
exp(2πiκh), a function of κ. It is a sum of basis functions of κ (terms) with weights: those of a series of exp(2πiκh),
or functions that are fitted to the series. A row of a table has the weights of one coefficient. A plan has the numbers
of a computation, such as its wavelengths and terms. "Source" means a light source of finite size (coherence of the kind
"source").
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core import disk_cache, memory
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ref
from warpdiff.diffraction import coefficient_basis, fourier_coefficients, gridding_kernel
from warpdiff.diffraction.coefficient_basis import Coefficients
from warpdiff.diffraction.phase_series import EXPANSIONS, check_cycles
from warpdiff.kernels import coefficient_sum
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import reflectance_table
from warpdiff.tables.table_cache import TableCache

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.diffraction.fourier_coefficients import Block, Grid
    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Number of float32 values in a SIMD register. The length of a table row is padded to a multiple of this number, so that
# loops over a row fill whole registers. Each padded length requires separately compiled kernels.
LANES = 8
# Smallest number of wavelengths in a quadrature. A quadrature is a numerical integral over the wavelength.
_FEWEST_WAVELENGTHS = 16
# The power in a direction is a sum of Fourier coefficients with Gaussian weights. A table contains all coefficients
# whose weight in any direction is at least this number. A plan (the numbers of a computation) may exclude more
# coefficients from sums, by a larger least weight. Plans that differ only in this weight can therefore share a table.
_LEAST_EXTENT_WEIGHT = 1e-14
# Smallest number of intervals between the wavelengths of an integral, for replicated patches. The value is limited by
# the interpolation of the power of one patch, which uses cubics through four neighbouring wavelengths.
_FEWEST_INTERVALS = 4
# An integral over the wavelength (quadrature) may have only certain numbers of wavelengths. The value is the number of
# permitted sizes from one size to twice that size. Computations with the same size share a quadrature. With more
# permitted sizes, they would share it less often.
SETS_PER_OCTAVE = 4
# Measured peak memory while the wavelengths and weights of an integral over the wavelength are computed
# [bytes per wavelength].
_BYTES_PER_WAVELENGTH = 370.0
# Number of values of cos θd at which the reflectance of a material is tabulated; θd is half of the angle between the
# directions to the light and to the viewer. The error of linear interpolation between these values is at most 1e-4; it
# is largest near the horizon.
_ANGLES = 513
# Measured peak memory while Fourier coefficients are computed [bytes]. A coefficient is a series in κ = w/λ, to which
# basis functions may be fitted. `_BYTES_OF_SERIES` and `_BYTES_OF_FIT` are bytes per coefficient and term, for the
# series and for the fit. `_BYTES_PER_SAMPLE` is the number of bytes per frequency of the Fourier transform; each thread
# adds `_BYTES_OF_THREAD` per frequency.
_BYTES_OF_SERIES, _BYTES_OF_FIT, _BYTES_PER_SAMPLE, _BYTES_OF_THREAD = 16.0, 36.0, 8.0, 18.0


@dataclass(frozen=True)
class CoefficientRange:
    """Range of frequencies q and of |κ| for which coefficients are stored, rounded up to coarse steps.

    q is the spatial frequency (u, v)/λ, and κ is w/λ, where (u, v, w) is the scattering vector. The range includes all
    visible wavelengths. Small movements of a light or a camera leave the range unchanged, so that the cached
    coefficients remain valid.

    Attributes:
        frequency: Largest |q| [1/µm].
        kappa_low: Smallest |κ| [1/µm].
        kappa_high: Largest |κ| [1/µm].
    """

    frequency: float
    kappa_low: float
    kappa_high: float

    @classmethod
    def covering(cls, direction_range: DirectionRange) -> CoefficientRange:
        """Return the range of Fourier coefficients for a range of directions and wavelengths."""
        shortest = min(direction_range.lambda_min_nm, colorimetry.LAMBDA_MIN_NM)
        longest = max(direction_range.lambda_max_nm, colorimetry.LAMBDA_MAX_NM)
        return cls(
            math.ceil(2.0 * direction_range.max_uv * 1e3 / shortest + 0.1) / 2.0,
            max(0.0, math.floor(4.0 * direction_range.min_w * 1e3 / longest - 0.1) / 4.0),
            math.ceil(2.0 * direction_range.max_w * 1e3 / shortest + 0.1) / 2.0,
        )


@dataclass(frozen=True)
class CoefficientsKey:
    """Cache key of the Fourier coefficients of a height field: everything on which they depend except its heights.

    Attributes:
        block: Range of the orders (r, s) whose coefficients are stored.
        kappas: Smallest and largest |κ| = |w|/λ [1/µm].
        method: One of ``coefficient_basis.METHODS``.
        terms: Number of terms of the series of exp(2πiκh), from which the coefficients are computed.
        fits_powers: Whether a basis is fitted to powers |H|² of the coefficients H instead of amplitudes H.
        is_tapered: Whether coefficients are also computed at half orders of the patch, as the coherence "replicas" (a
            finite number of periods) requires. The height samples are then weighted before the Fourier transform
            (`Grid.taper`).
    """

    block: Block
    kappas: tuple[float, float]
    method: str
    terms: int
    fits_powers: bool
    is_tapered: bool


@dataclass(frozen=True)
class RowsKey:
    """Cache key of the coefficient rows on a device: everything on which the rows depend except the heights.

    A row has the weights of basis functions of κ (terms) for one Fourier coefficient.

    Attributes:
        device: Name of the device.
        block: Range of the orders (r, s) whose coefficients are stored.
        coefficient_range: Range of spatial frequencies and of |κ| = |w|/λ.
        method: One of ``coefficient_basis.METHODS``.
        terms: Number of basis terms in the row of each coefficient.
        kind: Kind of coherence. For the kind "centred", rows contain the phase of the window's position.
        centre_um: Position (y, x) of a centred window [µm]; None is the centre of the patch.
    """

    device: str
    block: Block
    coefficient_range: CoefficientRange
    method: str
    terms: int
    kind: str
    centre_um: tuple[float, float] | None


@dataclass(frozen=True)
class Table:
    """Table of Fourier coefficients on a device, with the kernels that compute colours and reflectances from it.

    Attributes:
        integrate: Kernel that integrates the spectrum over λ to colours XYZ.
        sample: Kernel that computes the reflectance ρ at wavelengths that the caller selects.
        arguments: Struct with the arrays and numbers of the table; the first argument of both kernels.
        coefficients: Fourier coefficients on the host, from which the table was made.
    """

    integrate: Any
    sample: Any
    arguments: Any
    coefficients: Coefficients


def lanes_of(terms: int) -> int:
    """Return the padded length of a table row with weights of ``terms`` basis functions, a multiple of ``LANES``."""
    return LANES * math.ceil(terms / LANES)


def coefficients_for(
    heightfield: HeightField, method: str, coherence: Coherence, direction_range: DirectionRange,
    neighbour_extent: tuple[int, int], *, terms: int, threads: int, to_fit: bool = False,
) -> tuple[Coefficients, Block, Grid]:  # fmt: skip
    """Return the Fourier coefficients for a range of directions, from the cache if possible, with their frequencies.

    The result has three parts: the coefficients, a ``Block`` and a ``Grid``. The ``Grid`` defines the frequencies, and
    the ``Block`` states at which of them coefficients are stored. The size and the position of a coherence window have
    no effect on the coefficients.

    Args:
        heightfield: Height field whose coefficients are returned.
        method: One of ``coefficient_basis.METHODS``.
        coherence: Coherence, which selects the grid of frequencies and whether powers |H|² or amplitudes H are fitted.
        direction_range: Range of directions and wavelengths.
        neighbour_extent: Number of coefficients along (y, x) on either side of the frequency q = (u, v)/λ of a
            direction that look-ups may read.
        terms: Number of terms of a series of exp(2πiκh); the fit of a basis selects its own number.
        threads: Number of Fourier transforms that run in parallel.
        to_fit: Whether the caller needs the series only to fit basis functions to it. The series is then stored in a
            cache of one entry.
    """
    coefficient_range = CoefficientRange.covering(direction_range)
    kappas = 0.0 if method in EXPANSIONS else coefficient_range.kappa_low, coefficient_range.kappa_high
    check_cycles(heightfield, kappas[1])
    grid = grid_for(heightfield, coherence)
    block = fourier_coefficients.Block.covering(grid, coefficient_range.frequency, neighbour_extent)
    if method not in EXPANSIONS:
        terms = coefficient_basis.series_terms(heightfield, kappas)
    key = CoefficientsKey(
        block, kappas, method, terms, coherence.adds_powers and method not in EXPANSIONS, grid.taper is not None
    )

    @single_threaded_blas()
    def arrays() -> dict[str, Any]:
        ny, nx = heightfield.shape
        stored_terms = float(math.prod(block.count) * terms)
        per_sample = _BYTES_PER_SAMPLE + _BYTES_OF_THREAD * min(threads, terms)
        memory.require_memory(
            max(_BYTES_OF_SERIES * stored_terms + per_sample * math.prod(block.shape),
                0.0 if method in EXPANSIONS else _BYTES_OF_FIT * stored_terms),
            f"{ref('heightfield')} of {ny} × {nx} samples at {block.count[0]} × {block.count[1]} frequencies",
            f"take {{share}} of its area, by {ref('cropped()')}",
        )  # fmt: skip
        if method in EXPANSIONS:
            made = coefficient_basis.of_series(heightfield, method, grid, block, kappas, terms=terms, threads=threads)
        else:
            series, _, _ = coefficients_for(
                heightfield, "jacobi-anger", coherence, direction_range, neighbour_extent, terms=terms, threads=threads,
                to_fit=True,
            )  # fmt: skip
            made = coefficient_basis.fitted(heightfield, method, series, kappas, adds_powers=coherence.adds_powers)
        return vars(made)

    def make() -> Coefficients:
        return Coefficients(**disk_cache.cached_on_disk((key, heightfield.pitch_um), heightfield.heights_um, arrays))

    cache = TableCache.of(heightfield)
    if to_fit and key not in cache.coefficients:
        return cache.fitted_to.get_or_make(key, make), block, grid
    if method in EXPANSIONS and key not in cache.coefficients:
        series = cache.fitted_to.get(key)
        if series is not None:
            cache.coefficients.put(key, series)
        # ``cache.fitted_to`` contains the Fourier coefficients as series, to which basis functions were fitted last.
        # Two cached series would require twice the memory. ``fitted_to`` is therefore emptied: its series was moved to
        # ``cache.coefficients``, or is no longer needed.
        cache.fitted_to.clear()
    return cache.coefficients.get_or_make(key, make), block, grid


def grid_for(heightfield: HeightField, coherence: Coherence) -> Grid:
    """Return the grid of frequencies at which Fourier coefficients are computed for a kind of coherence."""
    if coherence.kind != "replicas":
        return fourier_coefficients.patch_grid(heightfield)
    return fourier_coefficients.fine_grid(
        heightfield, lambda nu: gridding_kernel.kernel_transform(nu, coefficient_sum.TAPS)
    )


def kernels_for(method: str, coherence: Coherence, terms: int) -> Any:
    """Return the kernels that sum Fourier coefficients, for table rows with weights of ``terms`` basis functions."""
    powers = coefficient_basis.holds_powers(method, adds_powers=coherence.adds_powers)
    return coefficient_sum.kernels(lanes_of(terms), coherence.kind, powers)


def table_for(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, *, device: wp.Device, threads: int
) -> Table:
    """Return the table of Fourier coefficients for a plan and the directions of a call, from the cache if possible.

    A plan has the numbers of a computation, such as the number of terms.
    """
    coherence = plan.coherence
    # Basis functions are fitted for a range of directions. Here it is the range of the plan, extended if the directions
    # of the call exceed it. All calls within the range of a plan therefore use the same basis functions.
    direction_range = plan.direction_range.joined(direction_range)
    coefficients, block, grid = coefficients_for(
        heightfield, plan.method, coherence, direction_range, neighbour_extent(plan, heightfield), terms=plan.terms,
        threads=threads,
    )  # fmt: skip
    terms = min(plan.terms, coefficients.terms)
    lanes = lanes_of(terms)
    kernels = kernels_for(plan.method, coherence, terms)
    table = kernels.Table()
    coefficient_range = CoefficientRange.covering(direction_range)
    key = RowsKey(device.alias, block, coefficient_range, plan.method, terms, coherence.kind, coherence.centre_um)

    def make() -> tuple[wp.array, wp.array]:
        rows = coefficients.rows[..., :terms]
        if coherence.kind == "centred":
            rows = _rotated(rows, _centre_phase(heightfield, coherence, block))
        padded = np.zeros((*rows.shape[:3], lanes), dtype=np.float32)
        padded[..., :terms] = rows
        basis = np.zeros((len(coefficients.basis), lanes), dtype=np.float32)
        basis[:, :terms] = coefficients.basis[:, :terms]
        return (
            wp.array(padded.reshape(-1, lanes), dtype=kernels.row, device=device),
            wp.array(basis, dtype=kernels.row, device=device),
        )

    table.rows, table.basis = TableCache.of(heightfield).rows.get_or_make(key, make)
    table.kappa_low, table.steps = coefficients.kappa_low, 1.0 / coefficients.step
    table.count_y, table.count_x = block.count
    table.origin_y, table.origin_x = block.origin
    table.length_y, table.length_x = grid.lengths_um
    if coherence.periods is not None:
        table.periods_y, table.periods_x = coherence.periods
        table.patch_y, table.patch_x = heightfield.size_um
        _set_taps(table, kernels, heightfield, device)
        return Table(kernels.integrate, kernels.sample, table, coefficients)
    table.exponent = -math.log(plan.least_weight)
    falloff = falloff_um2(coherence)
    table.across, table.along = (falloff / length**2 for length in grid.lengths_um)
    if coherence.kind == "source":
        table.spread = coherence.spread
    return Table(kernels.integrate, kernels.sample, table, coefficients)


def without_zeroth_order(table: Table) -> Table:
    """Set the zeroth order (the mean plane's reflection) of a table to 0, in a copy of its rows; return the table."""
    arguments = table.arguments
    rows = arguments.rows.numpy().copy()
    rows[arguments.origin_y * arguments.count_x + arguments.origin_x] = 0.0
    arguments.rows = wp.array(rows, dtype=arguments.rows.dtype, device=arguments.rows.device)
    return table


def falloff_um2(coherence: Coherence, wavelength_um: float = 1.0) -> float:
    """Return the factor a [µm²] of the Gaussian weight exp(−a |q − q_rs|²) of a Fourier coefficient.

    q is the frequency of a direction, and q_rs is the frequency of the coefficient. For an averaged coherence window,
    the weight multiplies powers, and the factor is 4π²σ², where σ is the standard deviation of the window. For a
    centred window, the weight multiplies amplitudes, and the factor is 2π²σ². For a light source with the spread s (the
    standard deviation of its directions), the weight multiplies powers, and the factor at normal incidence is λ²/2s².
    """
    if coherence.sigma_um is None:
        return wavelength_um**2 / (2.0 * coherence.spread**2)
    return (4.0 if coherence.kind == "averaged" else 2.0) * (math.pi * coherence.sigma_um) ** 2


def radius(plan: Plan) -> float:
    """Return the distance from q = (u, v)/λ up to which a direction may use Fourier coefficients of a table [1/µm]."""
    falloff = falloff_um2(plan.coherence, plan.lambda_min_nm * 1e-3)
    return math.sqrt(-math.log(min(plan.least_weight, _LEAST_EXTENT_WEIGHT)) / falloff)


def neighbour_extent(plan: Plan, heightfield: HeightField) -> tuple[int, int]:
    """Return how many Fourier coefficients a table must contain on either side of q = (u, v)/λ, along (y, x).

    All plans whose least Gaussian weight of coefficients is above ``_LEAST_EXTENT_WEIGHT`` have the same extent, so
    that they share one fitted basis.
    """
    if plan.coherence.kind == "replicas":
        return coefficient_sum.TAPS, coefficient_sum.TAPS
    # For a light source of finite size at oblique incidence, the coefficients that contribute to a direction lie within
    # an ellipse. The kernels sum over a parallelogram that contains the ellipse. It extends farther than the ellipse by
    # up to the factor √2.
    around = radius(plan) * (math.sqrt(2.0) if plan.coherence.kind == "source" else 1.0)
    rows, columns = (math.ceil(around * length + 0.5) for length in grid_for(heightfield, plan.coherence).lengths_um)
    return rows, columns


def quadrature_for(heightfield: HeightField, plan: Plan, illuminated: IlluminatedMaterial, *, device: wp.Device) -> Any:
    """Return the struct ``Quadrature``: the wavelengths of a plan, with weights for an illuminant and a material."""
    per_lateral, per_w, constant = plan.bandwidth_um
    largest = per_lateral * plan.max_order_rate + per_w * plan.max_w + constant
    counts = [plan.wavelengths]
    # The bandwidth of a direction is the number of wavelengths that it requires per unit of 1/λ. Directions with a
    # smaller bandwidth use sets of fewer wavelengths. The smallest useful set suffices for the constant part of the
    # bandwidth, which every direction requires.
    levels = math.floor(SETS_PER_OCTAVE * (math.log2(largest) - math.log2(constant))) if plan.adaptive else 0
    for level in range(1, levels + 1):
        fewer = wavelength_set_size(plan.wavelengths * 2.0 ** (-level / SETS_PER_OCTAVE))
        if fewer >= counts[-1]:
            break
        counts.append(fewer)
    if plan.coherence.kind == "replicas":
        counts = [max(count - 1, _FEWEST_INTERVALS) * plan.subdivisions + 1 for count in counts]
    memory.require_memory(
        _BYTES_PER_WAVELENGTH * sum(counts), f"a quadrature of {sum(counts)} wavelengths",
        f"take {{share}} of the wavelengths of {ref('plan')} or of the periods of {ref('coherence')}, or a smaller "
        f"{ref('heightfield')}",
    )  # fmt: skip
    geometric = plan.coherence.kind == "source"
    sets = [colorimetry.uniform_quadrature(count, illuminated.illuminant, geometric=geometric) for count in counts]
    result = coefficient_sum.Quadrature()
    wavenumbers, weights = (np.concatenate(parts) for parts in zip(*sets, strict=True))
    result.wavenumbers = wp.array(wavenumbers, dtype=wp.float64, device=device)
    result.weights = wp.array(weights.astype(np.float32), dtype=wp.vec3f, device=device)
    reflectances = (
        np.zeros((0, 0)) if illuminated.material is None else reflectance_table(illuminated.material, _ANGLES)
    )
    result.reflectances = wp.array(reflectances, dtype=wp.float32, device=device)
    result.least_nm = colorimetry.LAMBDA_MIN_NM
    result.firsts = wp.array(np.cumsum([0, *counts]).astype(np.int32), dtype=wp.int32, device=device)
    result.subdivisions = plan.subdivisions
    lengths = heightfield.size_um if plan.coherence.kind == "replicas" else (1.0, 1.0)
    result.per_v, result.per_u = (per_lateral * length / largest for length in lengths)
    result.per_w, result.constant = per_w / largest, constant / largest
    return result


def wavelength_set_size(count: float) -> int:
    """Return the smallest permitted number of wavelengths of an integral that is at least 98 % of ``count``."""
    steps = math.ceil(SETS_PER_OCTAVE * math.log2(max(count, 1.0) / _FEWEST_WAVELENGTHS) - 0.1)
    return int(_FEWEST_WAVELENGTHS * 2.0 ** (max(steps, 0) / SETS_PER_OCTAVE) + 0.5)


@functools.cache
def _taps(count: int) -> NDArray[np.float32]:
    return gridding_kernel.tap_polynomials(count).astype(np.float32)


def _set_taps(table: Any, kernels: Any, heightfield: HeightField, device: wp.Device) -> None:
    """Store the gridding kernel, weights that interpolate between Fourier coefficients, in the struct of their table.

    The weights are stored as polynomials of the position between two coefficients. Along an axis with a single height
    sample, a constant weight of 1 replaces the polynomials.
    """
    taps = _taps(coefficient_sum.TAPS)
    constant_x = np.zeros((1, coefficient_sum.TAPS), dtype=np.float32)
    constant_x[0, 0] = 1.0
    along_x = taps.T if heightfield.shape[1] > 1 else constant_x
    table.taps_x = wp.array(np.ascontiguousarray(along_x), dtype=kernels.taps, device=device)
    along_y = taps if heightfield.shape[0] > 1 else np.ones((1, 1), dtype=np.float32)
    table.taps_y = wp.array(along_y, dtype=wp.float32, device=device)


def _rotated(rows: NDArray[np.float32], phase: NDArray[np.complex128]) -> NDArray[np.float32]:
    """Return the rows of Fourier amplitudes, multiplied by one phase factor per coefficient, shape (my, mx).

    ``rows`` has the series of the real and of the imaginary part of each amplitude, shape (my, mx, 2, terms).
    """
    cosine, sine = (part.astype(np.float32)[:, :, None] for part in (phase.real, phase.imag))
    re, im = rows[:, :, 0], rows[:, :, 1]
    return np.stack([re * cosine - im * sine, re * sine + im * cosine], axis=2)


def _centre_phase(heightfield: HeightField, coherence: Coherence, block: Block) -> NDArray[np.complex128]:
    """Return exp(−2πi q_rs·x_c), a factor of each Fourier coefficient that moves the origin to x_c.

    The origin is the corner of the patch before, and the centre x_c of the coherence window afterwards. q_rs is the
    frequency of the coefficient (r, s).
    """
    middle = [n // 2 * pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True)]
    centre = coherence.centre_um or middle
    s, r = block.orders()
    turns = s[:, None] * (centre[0] / heightfield.size_um[0]) + r[None, :] * (centre[1] / heightfield.size_um[1])
    return np.asarray(np.exp(-2j * math.pi * turns))
