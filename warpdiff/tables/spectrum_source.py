"""Sources of colour tables: the spectrum under a window, sampled, or the lines of an endless surface, gathered."""

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

# |κ| of the basis from this share of the largest on: all coefficients but the zeroth order vanish below.
_SMALLEST_KAPPA = 1e-3
# Share of the tolerance that functions of w may omit at most. Cardinal polynomials sum to less than each of them.
_FUNCTIONS_SHARE, _CARDINALS_SHARE = 0.5, 0.05
# Coefficients that tell how much each term matters, and the least that it matters, relative to the largest.
_ROWS_FOR_TERM_SIZES, _LEAST_TERM_SIZE = 4096, 1e-3
# Entries of the zeroth order over |κ|.
_ZEROTH_ENTRIES = 2048
# Memory per line while lines are listed, as counted [bytes].
_BYTES_PER_LINE = 80.0
# Standard deviations of a line's blur in angle at which it ends.
_LINE_RADIUS_SIGMAS = 4.5


@dataclass(frozen=True)
class SpectrumKey:
    """Key of the source of a colour table: all that it depends on besides the heights.

    Attributes:
        device: Name of the device.
        coefficient_range: The range of its coefficients. All others are numbers of the plan.
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
    """The power spectrum from which a colour table is projected: what is known before any of it is sampled.

    Attributes:
        key: What the source depends on.
        layout: Grids of the table, with level 0 alone.
        table: Coefficients on the device.
        basis: Terms that rows of the spectrum consist of.
        at_kappas: For amplitudes, the basis at the |κ| at which rows hold powers, (length of a row, lanes); zeros for
            powers.
        zeroth: The zeroth order, which rows exclude unless it is empty.
        phase: Largest rate at which powers turn with ln λ [rad].
        projections: Projections that were made, by illuminant and material.
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
        """The kernels that :meth:`sampled` and :meth:`projector` launch."""

    @abstractmethod
    def sampled(self, **options: Any) -> Any:
        """Sample the spectrum, for any illuminant and material."""

    @abstractmethod
    def projector(self, samples: Any, curves: wp.array, **options: Any) -> Callable[[int, wp.array, wp.array], None]:
        """Return a function that projects samples to level 0.

        Args:
            samples: What :meth:`sampled` returned.
            curves: What rings count for X, Y and Z.
            options: Options of ``launch``, among them the device.

        Returns:
            Function of one octave, of a matrix of :attr:`Projection.matrices` on the device, and of the octave's rows.
        """

    def projection(self, plan: Plan, illuminated: IlluminatedMaterial) -> Projection:
        """The projection for an illuminant and a material, made or found again."""
        if illuminated not in self.projections:
            self.projections[illuminated] = make_projection(plan, self.basis, illuminated, self.layout)
        return self.projections[illuminated]

    @property
    def sampled_bytes(self) -> float:
        """Bytes of the samples; lines are gathered octave by octave."""
        return 0.0 if self.has_lines else 4.0 * len(self.at_kappas) * self.layout.spectrum.nodes

    def projection_kernels(self, w_basis_size: int) -> Any:
        """Kernels and types of the projection to a number of functions of w."""
        return spectrum_sampling.projector(len(self.at_kappas), w_basis_size)


class WindowedSpectrum(SpectrumSource):
    """Spectrum under a window, averaged or centred, sampled on the grid of frequencies."""

    has_lines, tap_rule = False, SPECTRUM_TAPS

    @property
    def _sampler(self) -> Any:
        width, lanes = self.at_kappas.shape
        return spectrum_sampling.resampler(lanes, self.table.coefficients.rows.shape[2] == 1, width)

    def kernels(self, w_basis_size: int) -> list[Any]:
        """The kernel that samples along azimuths, and the one that joins octaves of samples and projects them."""
        return [self._sampler.resample, self.projection_kernels(w_basis_size).project]

    def sampled(self, **options: Any) -> list[wp.array]:
        """Rows of the spectrum by octave, azimuth and ring; the first one and the number of azimuths of each octave."""
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
        """Project one octave of samples with the next one."""
        azimuths, terms, rings = self.layout.levels[0].azimuths, len(self.basis.sizes), self.layout.spectrum.rings
        # Space for each azimuth, of which a slice on the CPU only takes that of its first ones: the rest is no memory
        # yet.
        length = rings + len(curves) - 1 + FILTER_REACH
        sequence = wp.empty(azimuths[-1] * length, dtype=samples[0].dtype, device=options["device"])

        def project(octave: int, matrix: wp.array, rows: wp.array) -> None:
            kernels = self.projection_kernels(len(matrix.dtype()))
            inputs = [*samples, matrix, curves, terms, rings, octave, length, sequence]
            launch(kernels.project, azimuths[octave] // kernels.abreast, inputs, [rows], in_runs=True, **options)

        return project


class Lines(NamedTuple):
    """Lines of a spectrum but for the zeroth order, in the order of their angles.

    Attributes:
        rows: Rows of their coefficients in the table.
        angles: Angles of their frequencies, 0 to 2π.
        log_frequencies: ln |q|, |q| in 1/µm.
    """

    rows: NDArray[np.int32]
    angles: NDArray[np.float64]
    log_frequencies: NDArray[np.float64]


# Nodes of a table that a line of a source is added to. Derived: 7 azimuths and 3 rings, on both sides of each.
NODES_OF_LINE = 42.0


class LineSpectrum(SpectrumSource):
    """Spectrum of an endless surface under a source: one line at the frequency of each coefficient."""

    has_lines, tap_rule = True, LINE_TAPS

    @property
    def _sampler(self) -> Any:
        return spectrum_sampling.gatherer(self.at_kappas.shape[1])

    def kernels(self, w_basis_size: int) -> list[Any]:
        """The kernel that gathers lines on azimuths, and the one that projects these."""
        return [self._sampler.gather, self.projection_kernels(w_basis_size).project_lines]

    def sampled(self, **_options: Any) -> Lines:
        """The lines up to the largest frequency; they are gathered octave by octave."""
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
        # Beyond the pitch's limit they repeat.
        rows = (s + arguments.origin_y) % arguments.count_y
        columns = (r + arguments.origin_x) % arguments.count_x
        coefficient_rows = (rows[:, None] * arguments.count_x + columns[None, :])[inside].astype(np.int32)
        angles = (np.arctan2(qy, qx) % (2.0 * math.pi))[inside]
        order = np.argsort(angles, kind="stable")
        return Lines(coefficient_rows[order], angles[order], 0.5 * np.log(squared[inside][order]))

    def projector(self, samples: Any, curves: wp.array, **options: Any) -> Callable[[int, wp.array, wp.array], None]:
        """Gather the lines of one octave, and of what a colour takes beyond it, and project them."""
        grid, sampler, terms, device = self.layout.spectrum, self._sampler, len(self.basis.sizes), options["device"]
        rings = grid.rings + len(curves) - 1 + 2 * FILTER_REACH

        def project(octave: int, matrix: wp.array, rows: wp.array) -> None:
            azimuths, blur = grid.azimuths[octave], self.layout.blurs[octave]
            kernels = self.projection_kernels(len(matrix.dtype()))
            log_begin = grid.log_radius + (octave - (FILTER_REACH + 1) / grid.rings) * math.log(2.0)
            places = (samples.log_frequencies - log_begin) * (grid.rings / math.log(2.0))
            inside = np.flatnonzero((places > -0.5) & (places < rings - 0.5))
            angles = samples.angles[inside]
            # A turn, and what of it reaches beyond its ends.
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
    """The kind of spectrum under a coherence."""
    return LineSpectrum if coherence.kind == "source" else WindowedSpectrum


def source_for(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, *, device: wp.Device, threads: int
) -> SpectrumSource:
    """The source of a plan's table, and of what a call has beyond the plan's range, made or found again."""
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
    """A new source."""
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
        # The amplitude of the zeroth order cannot be separated from others.
        power = np.zeros(0, dtype=np.float32)
        # As many nodes as a power's oscillations require.
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
    """How much each term matters, relative to rows (my, mx, terms)."""
    flat = rows.reshape(-1, rows.shape[2])
    sampled_rows = flat[:: max(1, len(flat) // _ROWS_FOR_TERM_SIZES)].astype(np.float64)
    norms = np.linalg.norm(sampled_rows, axis=1, keepdims=True)
    sizes = np.sqrt(np.mean((sampled_rows / np.where(norms > 0.0, norms, 1.0)) ** 2, axis=0))
    return np.asarray(np.maximum(sizes, _LEAST_TERM_SIZE * sizes.max()))
