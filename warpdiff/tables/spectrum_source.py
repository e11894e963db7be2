"""Power spectra from which colour tables are computed: a sampled spectrum, or a sum of spectral lines.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. A row of a spectrum has the weights of basis
functions of κ (basis terms), whose weighted sum is the power at one point of the grid of q = (u, v)/λ. "Source" means a
light source of finite size (coherence of the kind "source").
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import warp as wp

from warpdiff.core import memory
from warpdiff.core.wording import ref
from warpdiff.device.kernel_calls import launch
from warpdiff.diffraction import chebyshev
from warpdiff.kernels import spectrum_sampling
from warpdiff.kernels.colour_lookup import FILTER_REACH
from warpdiff.tables.coefficient_table import CoefficientRange, Table, lanes_of, table_for
from warpdiff.tables.colour_curves import Projection, SpectrumBasis, make_projection
from warpdiff.tables.footprint_weights import LINE_TAPS, SPECTRUM_TAPS, TapRule
from warpdiff.tables.mip_layout import MipLayout
from warpdiff.tables.table_cache import TableCache
from warpdiff.tables.zeroth_order import ZerothOrder

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Smallest |κ| = |w|/λ of the basis functions of a spectrum, as a share of the largest |κ|. At smaller |κ|, all
# diffraction orders except the zeroth order are negligible.
_SMALLEST_KAPPA = 1e-3
# Permitted errors by the limited number of functions of w in a colour table, as shares of the tolerance; w is the
# normal component of the scattering vector. `_FUNCTIONS_SHARE` is for spectra in which powers |H|² of Fourier
# coefficients add. `_CARDINALS_SHARE` is for other spectra, which are interpolated by polynomials in |κ| = |w|/λ. A sum
# of the terms of such a polynomial may be much smaller than its single terms, so that an error of a term counts more.
_FUNCTIONS_SHARE, _CARDINALS_SHARE = 0.5, 0.05
# Each Fourier coefficient is a weighted sum of basis functions (terms). `_ROWS_FOR_TERM_SIZES` is the number of
# coefficients from which the typical size of the weight of each term is computed. `_LEAST_TERM_SIZE` is the smallest
# size that is assumed, relative to the largest size of all terms.
_ROWS_FOR_TERM_SIZES, _LEAST_TERM_SIZE = 4096, 1e-3
# Number of values of |κ| = |w|/λ at which the power of the zeroth order is tabulated.
_ZEROTH_ENTRIES = 2048
# Peak memory of the list of spectral lines while it is made [bytes per line]. It was derived by adding the sizes of the
# arrays in the code.
_BYTES_PER_LINE = 80.0
# The Gaussian blur of a spectral line along the azimuth is truncated at this angle from the line [standard deviations
# of the blur].
_LINE_RADIUS_SIGMAS = 4.5


@dataclass(frozen=True)
class SpectrumKey:
    """Cache key of the spectrum of a colour table: everything on which the spectrum depends except the heights.

    Attributes:
        device: Name of the device.
        coefficient_range: Range of spatial frequencies and of |κ| = |w|/λ of the Fourier coefficients. All further
            attributes are those of the plan with the same names.
    """

    device: str
    coefficient_range: CoefficientRange
    method: str
    coherence: Coherence
    terms: int
    least_weight: float
    rings_per_octave: int
    azimuths_per_width: float
    w_basis_size: int
    tolerance: float


@dataclass(frozen=True, eq=False)
class SpectrumSource(ABC):
    """Power spectrum from which a colour table is computed: all its parameters, but not the samples of the spectrum.

    Attributes:
        key: Cache key of the spectrum.
        layout: Grids of the table, with mip level 0 only.
        table: Table of Fourier coefficients on the device.
        basis: Basis functions in which the rows of the spectrum are expanded.
        at_kappas: If amplitudes add, basis functions of the coefficients at several |κ| = |w|/λ, shape (number of |κ|,
            padded number of basis functions). The powers at these |κ| form a row of the spectrum. If powers add, the
            array contains zeros.
        zeroth: Zeroth order, which is stored separately from the rows. If amplitudes add, its array of powers is empty,
            and the rows include the zeroth order.
        phase: Angular frequency of the fastest oscillation of a power as a function of ln λ [rad per unit of ln λ].
        projections: Conversions of the spectrum to colours that were computed already, by illuminant and material.
    """

    has_lines: ClassVar[bool]
    tap_rule: ClassVar[TapRule]

    key: SpectrumKey
    layout: MipLayout
    table: Table
    basis: SpectrumBasis
    at_kappas: NDArray[np.float32]
    zeroth: ZerothOrder
    phase: float
    projections: dict[IlluminatedMaterial, Projection] = field(default_factory=dict)

    @abstractmethod
    def kernels(self, w_basis_size: int) -> list[Any]:
        """Return all kernels that sample the spectrum and convert it to colours; callers load these kernels."""

    @abstractmethod
    def sampled(self, **options: Any) -> Any:
        """Return the samples of the spectrum, which do not depend on the illuminant and the material."""

    @abstractmethod
    def projector(self, samples: Any, curves: wp.array, **options: Any) -> Callable[[int, wp.array, wp.array], None]:
        """Return a function that converts (projects) spectrum samples to the colours in mip level 0 of a colour table.

        Args:
            samples: Result of :meth:`sampled`.
            curves: Weights with which the rings (circles of constant |(u, v)|/λ) of the spectrum contribute to X, Y and
                Z, on the device.
            options: Options of ``launch``, which include the device.

        Returns:
            Function with three arguments: index of the octave of |(u, v)|, one of :attr:`Projection.matrices` on the
            device, and array for the rows of the octave, to which the function writes.
        """

    def projection(self, plan: Plan, illuminated: IlluminatedMaterial) -> Projection:
        """Return the cached weights that convert the spectrum to colours for an illuminant and a material."""
        if illuminated not in self.projections:
            self.projections[illuminated] = make_projection(plan, self.basis, illuminated, self.layout)
        return self.projections[illuminated]

    @property
    def sampled_bytes(self) -> float:
        """Size of the spectrum samples [bytes]; 0 for spectral lines, which are added while colours are computed."""
        return 0.0 if self.has_lines else 4.0 * len(self.at_kappas) * self.layout.spectrum.nodes

    def projection_kernels(self, w_basis_size: int) -> Any:
        """Return the kernels and types that convert rows of the spectrum to colours with a number of functions of w."""
        return spectrum_sampling.projector(len(self.at_kappas), w_basis_size)


class WindowedSpectrum(SpectrumSource):
    """Power spectrum under an averaged or centred coherence window, sampled on a polar grid of frequencies."""

    has_lines, tap_rule = False, SPECTRUM_TAPS

    @property
    def _sampler(self) -> Any:
        width, lanes = self.at_kappas.shape
        return spectrum_sampling.resampler(lanes, self.table.coefficients.rows.shape[2] == 1, width)

    def kernels(self, w_basis_size: int) -> list[Any]:
        """Return the kernels that sample the spectrum and that convert two octaves of the frequency to colours."""
        return [self._sampler.resample, self.projection_kernels(w_basis_size).project]

    def sampled(self, **options: Any) -> list[wp.array]:
        """Return the sampled rows of the power spectrum, by octave of the frequency, azimuth and ring (radius).

        The result also contains, for each octave, the index of its first row and its number of azimuth samples.
        """
        grid, sampler, arguments, device = self.layout.spectrum, self._sampler, self.table.arguments, options["device"]
        excluded = arguments.origin_y * arguments.count_x + arguments.origin_x if len(self.zeroth.power) else -1
        bases = wp.array(np.ascontiguousarray(self.at_kappas.T), dtype=sampler.row, device=device)
        values = wp.empty(grid.nodes, dtype=sampler.row, device=device)
        starts, highest = grid.starts[: -1 : grid.rings].tolist(), self.layout.highest
        for octave, (azimuths, divisions) in enumerate(zip(grid.azimuths, self.layout.divisions, strict=True)):
            log_low, start = grid.log_radius + octave * math.log(2.0), starts[octave]
            inputs = [arguments, bases, azimuths, grid.rings, log_low, divisions, highest, excluded, start]
            launch(sampler.resample, azimuths, inputs, [values], **options)
        return [values, *(wp.array(counts, dtype=wp.int32, device=device) for counts in (starts, grid.azimuths))]

    def projector(self, samples: Any, curves: wp.array, **options: Any) -> Callable[[int, wp.array, wp.array], None]:
        """Return a function that converts samples of the spectrum, in two octaves of the frequency, to colours."""
        azimuths, terms, rings = self.layout.levels[0].azimuths, len(self.basis.sizes), self.layout.spectrum.rings
        # Working memory for the projection to colours. Each azimuth sample has room for the values on all rings
        # (circles) of one octave of the frequency and on some rings of the next octave. On the CPU, the threads use
        # only the beginning of this memory. The unused part of the allocation occupies no memory.
        length = rings + len(curves) - 1 + FILTER_REACH
        sequence = wp.empty(azimuths[-1] * length, dtype=samples[0].dtype, device=options["device"])

        def project(octave: int, matrix: wp.array, rows: wp.array) -> None:
            kernels = self.projection_kernels(len(matrix.dtype()))
            inputs = [*samples, matrix, curves, terms, rings, octave, length, sequence]
            launch(kernels.project, azimuths[octave] // kernels.abreast, inputs, [rows], in_runs=True, **options)

        return project


class Lines(NamedTuple):
    """Spectral lines of all Fourier coefficients except the zeroth order, sorted by the angle of their frequency.

    Attributes:
        rows: For each line, index of the row of its coefficient in the table of coefficients.
        angles: Angle of each frequency vector q, from 0 to 2π [rad].
        log_frequencies: Natural logarithm of each |q|, with |q| in 1/µm.
    """

    rows: NDArray[np.int32]
    angles: NDArray[np.float64]
    log_frequencies: NDArray[np.float64]


# Number of samples of the polar grid to which each spectral line is added. Predictions of the computing time use this
# number. It was derived as 2 × 7 azimuth samples on each of 3 rings (circles).
NODES_OF_LINE = 42.0


class LineSpectrum(SpectrumSource):
    """Power spectrum of an infinite surface under a light source of finite size: one line per Fourier coefficient.

    The line is at the frequency of the coefficient.
    """

    has_lines, tap_rule = True, LINE_TAPS

    @property
    def _sampler(self) -> Any:
        return spectrum_sampling.gatherer(self.at_kappas.shape[1])

    def kernels(self, w_basis_size: int) -> list[Any]:
        """Return two kernels: one adds spectral lines to a polar grid, one converts the sums to colours."""
        return [self._sampler.gather, self.projection_kernels(w_basis_size).project_lines]

    def sampled(self, **_options: Any) -> Lines:
        """Return the spectral lines up to the largest frequency of a look-up, without adding them to a grid."""
        arguments, highest = self.table.arguments, self.layout.highest
        lengths = arguments.length_y, arguments.length_x
        most = math.prod(2.0 * highest * length + 1.0 for length in lengths)
        memory.require_memory(
            _BYTES_PER_LINE * most, f"a table of {most:.3g} lines",
            f"take {ref('integration', 'sampled')}, or {{share}} of the area of {ref('heightfield')}",
        )  # fmt: skip
        s, r = (np.arange(-math.floor(highest * length), math.floor(highest * length) + 1) for length in lengths)
        qy, qx = s[:, None] / lengths[0], r[None, :] / lengths[1]
        squared = qy**2 + qx**2
        inside = (squared <= highest**2) & (squared > 0.0)
        # The coefficients of a sampled surface are periodic in the frequency. Spectral lines beyond the Nyquist limit
        # of the pitch therefore use the coefficients of lower frequencies.
        rows = (s + arguments.origin_y) % arguments.count_y
        columns = (r + arguments.origin_x) % arguments.count_x
        coefficient_rows = (rows[:, None] * arguments.count_x + columns[None, :])[inside].astype(np.int32)
        angles = (np.arctan2(qy, qx) % (2.0 * math.pi))[inside]
        order = np.argsort(angles, kind="stable")
        return Lines(coefficient_rows[order], angles[order], 0.5 * np.log(squared[inside][order]))

    def projector(self, samples: Any, curves: wp.array, **options: Any) -> Callable[[int, wp.array, wp.array], None]:
        """Return a function that adds spectral lines in one octave of |(u, v)| to a grid, and makes colours of them."""
        grid, sampler, terms, device = self.layout.spectrum, self._sampler, len(self.basis.sizes), options["device"]
        rings = grid.rings + len(curves) - 1 + 2 * FILTER_REACH

        def project(octave: int, matrix: wp.array, rows: wp.array) -> None:
            azimuths, blur = grid.azimuths[octave], self.layout.blurs[octave]
            kernels = self.projection_kernels(len(matrix.dtype()))
            log_begin = grid.log_radius + (octave - (FILTER_REACH + 1) / grid.rings) * math.log(2.0)
            places = (samples.log_frequencies - log_begin) * (grid.rings / math.log(2.0))
            inside = np.flatnonzero((places > -0.5) & (places < rings - 0.5))
            angles = samples.angles[inside]
            # Angles are periodic: the blur of a spectral line near the angle 0 extends to angles below 2π, and vice
            # versa. Copies of such lines, with angles changed by 2π, are therefore added at the other end of the range
            # of angles.
            far = _LINE_RADIUS_SIGMAS * blur
            after, before = np.searchsorted(angles, far), np.searchsorted(angles, 2.0 * math.pi - far)
            rotated = np.concatenate([angles[before:] - 2.0 * math.pi, angles, angles[:after] + 2.0 * math.pi])
            repeated = inside[
                np.concatenate([np.arange(before, len(inside)), np.arange(len(inside)), np.arange(after)])
            ]
            at = 2.0 * math.pi * np.arange(azimuths) / azimuths
            numbers = [rotated, places[repeated], np.exp(-2.0 * samples.log_frequencies[repeated])]
            ends = [np.searchsorted(rotated, at - far), np.searchsorted(rotated, at + far)]
            inputs = [
                self.table.arguments.rows, wp.array(samples.rows[repeated], dtype=wp.int32, device=device),
                *(wp.array(column, dtype=wp.float32, device=device) for column in numbers),
                *(wp.array(column, dtype=wp.int32, device=device) for column in ends), rings, blur,
            ]  # fmt: skip
            values = wp.empty(azimuths * rings, dtype=sampler.row, device=device)
            launch(sampler.gather, azimuths, inputs, [values], **options)
            inputs = [values, matrix, curves, terms, grid.rings, rings]
            launch(kernels.project_lines, azimuths // kernels.abreast, inputs, [rows], **options)

        return project


def source_type(coherence: Coherence) -> type[SpectrumSource]:
    """Return the class of power spectra for a coherence: spectral lines for the kind "source", otherwise samples."""
    return LineSpectrum if coherence.kind == "source" else WindowedSpectrum


def source_for(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, *, device: wp.Device, threads: int
) -> SpectrumSource:
    """Return the power spectrum for a plan (the numbers of a computation) and the directions of a call.

    The spectrum is taken from the cache if possible.
    """
    coefficient_range = CoefficientRange.covering(plan.direction_range.joined(direction_range))
    key = SpectrumKey(
        device.alias, coefficient_range, plan.method, plan.coherence, plan.terms, plan.least_weight,
        plan.rings_per_octave, plan.azimuths_per_width, plan.w_basis_size, plan.tolerance,
    )  # fmt: skip

    def make() -> SpectrumSource:
        return _made(
            heightfield, plan, table_for(heightfield, plan, direction_range, device=device, threads=threads), key
        )

    return TableCache.of(heightfield).sources.get_or_make(key, make)


def _made(heightfield: HeightField, plan: Plan, table: Table, key: SpectrumKey) -> SpectrumSource:
    """Return a power spectrum whose values have not been sampled yet.

    It already has the polar grid for these values, the basis functions of κ = w/λ in which they are expanded, and the
    power of the zeroth order.
    """
    coefficients, at, coherence = table.coefficients, table.arguments, plan.coherence
    count = min(plan.terms, coefficients.terms)
    lanes = lanes_of(count)
    high = key.coefficient_range.kappa_high
    kappas = max(key.coefficient_range.kappa_low, _SMALLEST_KAPPA * high), high
    kind = source_type(coherence)
    if coherence.adds_powers:

        def basis_at(some_kappas: NDArray[np.float64]) -> NDArray[np.float64]:
            return coefficients.basis_at(some_kappas)[:, :count]

        sizes = _term_sizes(coefficients.rows[:, :, 0, :count])
        basis = SpectrumBasis(basis_at, kappas, sizes, _FUNCTIONS_SHARE, kind.has_lines)
        own = coefficients.rows[at.origin_y, at.origin_x, 0, :count].astype(np.float64)
        power = np.maximum(basis_at(np.linspace(*kappas, _ZEROTH_ENTRIES)) @ own, 0.0).astype(np.float32)
        at_kappas = np.zeros((lanes, lanes), dtype=np.float32)
    else:
        # If amplitudes add, the zeroth order interferes with other orders and has no power of its own. The array of its
        # powers is therefore empty.
        power = np.zeros(0, dtype=np.float32)
        # Powers |H|² of Fourier coefficients are interpolated over κ = w/λ from Chebyshev nodes. Their number is
        # derived from the fastest oscillation of a power over κ.
        argument = math.pi * (kappas[1] - kappas[0]) * heightfield.height_range_um
        node_count = math.ceil(argument + 4.0 * argument ** (1.0 / 3.0) + 2.0)
        nodes = chebyshev.nodes(*kappas, node_count)

        def cardinals_at(some_kappas: NDArray[np.float64]) -> NDArray[np.float64]:
            return chebyshev.cardinals(some_kappas, *kappas, node_count)

        basis = SpectrumBasis(cardinals_at, kappas, np.ones(node_count), _CARDINALS_SHARE)
        at_kappas = np.zeros((lanes_of(node_count), lanes), dtype=np.float32)
        at_kappas[:node_count, :count] = coefficients.basis_at(nodes)[:, :count]
    layout = MipLayout.for_plan(plan, key.coefficient_range.frequency)
    phase = 2.0 * math.pi * high * heightfield.height_range_um
    return kind(key, layout, table, basis, at_kappas, ZerothOrder(power, *kappas, coherence), phase)


def _term_sizes(rows: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the typical size of the weight of each basis function (term) of Fourier coefficients, shape (terms,).

    A row of ``rows`` has the weights of one coefficient. The size is the root mean square over the rows, after each row
    is divided by its norm.
    """
    flat = rows.reshape(-1, rows.shape[2])
    sampled_rows = flat[:: max(1, len(flat) // _ROWS_FOR_TERM_SIZES)].astype(np.float64)
    norms = np.linalg.norm(sampled_rows, axis=1, keepdims=True)
    sizes = np.sqrt(np.mean((sampled_rows / np.where(norms > 0.0, norms, 1.0)) ** 2, axis=0))
    return np.asarray(np.maximum(sizes, _LEAST_TERM_SIZE * sizes.max()))
