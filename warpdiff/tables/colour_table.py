"""Colour tables in polar coordinates of (u, v): construction and cache."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core import memory
from warpdiff.core.wording import ref
from warpdiff.device.devices import load
from warpdiff.device.kernel_calls import launch
from warpdiff.diffraction import chebyshev
from warpdiff.kernels import colour_lookup, spectrum_sampling
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import reflectance_at
from warpdiff.tables import coefficient_table, line_spectrum
from warpdiff.tables.colour_curves import Projection, SeparableTerm, SpectrumBasis, colour_products, make_projection
from warpdiff.tables.polar_grid import LOG_RED, MIDDLE_UM, MipLayout, has_mip_levels, inner_radius, megabytes

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Look-ups skip nodes where colours are smooth: of a light that shows less than this of them at the frequency that every
# second node takes for none, and so many deviations from what else is in them.
_MOST_AT_ALIAS, _SAFE_DEVIATIONS, _NO_DECIMATION = 0.05, 4.2, 1e6
# Of the largest |κ|: all but the mirror's coefficient vanish below.
_SMALLEST_KAPPA = 1e-3
# What functions of w may leave out where it is most, as a share of the tolerance: cardinal polynomials add up to less
# than each of them.
_FUNCTIONS_SHARE, _CARDINALS_SHARE = 0.5, 0.05
# Of the coefficients, those that tell how much each term matters, and what is too little of it to leave out.
_ROWS_FOR_TERM_SIZES, _LEAST_TERM_SIZE = 4096, 1e-3
# The mean plane's lobe: entries over |κ|, linear between them, and wavelengths.
_ZEROTH_ENTRIES, _ZEROTH_WAVELENGTHS = 2048, 40
# Of a material's reflectance, by cos θd.
_ZEROTH_ANGLES = 512
_ROWS_OF_SLICE = 32


@dataclass(frozen=True)
class _Source:
    """The source of a table: coefficients, and the rows of the spectrum that they become.

    Attributes:
        key: What tells it from others.
        layout: Where its nodes lie.
        base: The table of coefficients.
        terms: What rows consist of.
        at_kappas: For amplitudes, the basis at the |κ| at which rows hold powers, (length of a row, lanes).
        zeroth_order: Of powers, the mean plane's, which rows leave out, at ``_ZEROTH_ENTRIES`` equally spaced |κ|.
        lobe2: Variance of a coefficient's lobe in frequency [1/µm²]; 0 for a source, whose is one of (u, v).
        phase: How fast powers turn with ln λ at most [rad].
        coherence: What the table is for.
    """

    key: Any
    layout: MipLayout
    base: coefficient_table.Table
    terms: SpectrumBasis
    at_kappas: NDArray[np.float32]
    zeroth_order: NDArray[np.float32]
    lobe2: float
    phase: float
    coherence: Coherence

    @property
    def excluded(self) -> int:
        """Where the mean plane's coefficient lies among the rows of ``base``; −1 where it stays in."""
        arguments = self.base.arguments
        return int(arguments.origin_y * arguments.count_x + arguments.origin_x) if len(self.zeroth_order) else -1

    @property
    def sampled_bytes(self) -> float:
        """Bytes of the spectrum's rows; lines are gathered as they are needed."""
        return 0.0 if self.is_line_spectrum else 4.0 * len(self.at_kappas) * float(self.layout.starts[-1])

    @property
    def is_line_spectrum(self) -> bool:
        """Whether rows hold the lines of an endless surface."""
        return self.coherence.kind == "source"

    @property
    def sampler(self) -> Any:
        """The kernel that samples the spectrum, or that gathers its lines, and the type of its rows."""
        width, lanes = self.at_kappas.shape
        if self.is_line_spectrum:
            return spectrum_sampling.gatherer(lanes)
        return spectrum_sampling.resampler(lanes, self.base.coefficients.rows.shape[2] == 1, width)


def table_for(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, illuminated: IlluminatedMaterial, *,
    device: wp.Device, threads: int,
) -> tuple[Any, Any]:  # fmt: skip
    """The kernel that looks colours up, and the struct that it reads, for a plan and for what a call has beyond it."""
    cache = coefficient_table.table_cache(heightfield)
    colours, spectra = cache.colours, cache.spectra
    source, projection = _prepared(heightfield, plan, direction_range, illuminated, device=device, threads=threads)
    key, level0_key = (*source.key, illuminated, has_mip_levels(plan)), (*source.key, illuminated, False)
    options: dict[str, Any] = {"device": device, "threads": threads}
    # Other threads may make the same meanwhile, or let it go.
    entry = colours.get(key)
    if entry is None:
        entry = colours.get(level0_key)
        if entry is None:
            rows = spectra.get(source.key)
            memory.require_memory(
                1e6 * megabytes(plan) + (source.sampled_bytes if rows is None else 0.0),
                f"a table of rings_per_octave={plan.rings_per_octave} and azimuths_per_width={plan.azimuths_per_width}",
                f"take a larger {ref('tolerance')}, or a {ref('plan')} with {{share}} of the rings",
            )  # fmt: skip
            _load_kernels(source, projection, plan, device)
            if rows is None:
                # The last one serves other illuminants and materials.
                spectra.clear()
                rows = (
                    line_spectrum.lines_of(source.base.arguments, source.layout.highest)
                    if source.is_line_spectrum
                    else _sampled(source, **options)
                )
                spectra.put(source.key, rows)
            entry = _coloured(source, projection, rows, illuminated, **options)
            colours.put(level0_key, entry)
        if key != level0_key:
            # Levels are added to colours that have none, whose rows both then have.
            kernel, table, _ = entry
            colours.put(level0_key, (kernel, table, 0.0))
            entry = _blurred(
                source.layout.with_mip_levels(), table, is_line_spectrum=source.is_line_spectrum, **options
            )
        colours.put(key, entry)
    return entry[:2]


def function_count(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, illuminated: IlluminatedMaterial, *,
    device: wp.Device, threads: int,
) -> int:  # fmt: skip
    """Functions of w that colours of a plan's table share."""
    return int(
        _prepared(heightfield, plan, direction_range, illuminated, device=device, threads=threads)[1].w_basis.shape[1]
    )


def _load_kernels(source: _Source, projection: Projection, plan: Plan, device: wp.Device) -> None:
    count = projection.w_basis.shape[1]
    target = colour_lookup.lookup(count, source.is_line_spectrum)
    projector = spectrum_sampling.projector(len(source.at_kappas), count)
    if source.is_line_spectrum:
        needed = [source.sampler.gather, projector.project_lines]
    else:
        needed = [source.sampler.resample, projector.project]
    if any(len(terms) > 1 for terms in projection.octaves):
        needed.append(spectrum_sampling.adder(count))
    needed += [target.interpolate, target.integrate]
    load([*needed, target.blur] if has_mip_levels(plan) else needed, device)


def _prepared(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, illuminated: IlluminatedMaterial, *,
    device: wp.Device, threads: int,
) -> tuple[_Source, Projection]:  # fmt: skip
    """Prepare layout, terms and projection, before any rows are made."""
    coefficient_range = coefficient_table.CoefficientRange.covering(plan.direction_range.joined(direction_range))
    numbers = (
        plan.terms, plan.least_weight, plan.rings_per_octave, plan.azimuths_per_width, plan.w_basis_size,
        plan.tolerance,
    )  # fmt: skip
    key = device.alias, plan.method, plan.coherence, numbers, coefficient_range

    def make() -> tuple[_Source, dict[IlluminatedMaterial, Projection]]:
        return _source(heightfield, plan, direction_range, key, coefficient_range, device=device, threads=threads), {}

    source, projections = coefficient_table.table_cache(heightfield).prepared.get_or_make(key, make)
    if illuminated not in projections:
        projections[illuminated] = make_projection(plan, source.terms, illuminated, source.layout)
    return source, projections[illuminated]


def _source(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, key: Any,
    coefficient_range: coefficient_table.CoefficientRange, *, device: wp.Device, threads: int,
) -> _Source:  # fmt: skip
    """The source of a plan's table."""
    base = coefficient_table.table_for(heightfield, plan, direction_range, device=device, threads=threads)
    coefficients = base.coefficients
    count = min(plan.terms, coefficients.terms)
    lanes = coefficient_table.lanes_of(count)
    kappas = _kappas(coefficient_range)
    if plan.coherence.adds_powers:

        def basis_at(at: NDArray[np.float64]) -> NDArray[np.float64]:
            return coefficients.basis_at(at)[:, :count]

        terms = SpectrumBasis(basis_at, kappas, _sizes(coefficients.rows[:, :, 0, :count]), _FUNCTIONS_SHARE)
        own = coefficients.rows[base.arguments.origin_y, base.arguments.origin_x, 0, :count].astype(np.float64)
        zeroth_order = np.maximum(basis_at(np.linspace(*kappas, _ZEROTH_ENTRIES)) @ own, 0.0).astype(np.float32)
        at_kappas = np.zeros((lanes, lanes), dtype=np.float32)
    else:
        # Amplitudes of the mean plane and of others do not come apart.
        zeroth_order = np.zeros(0, dtype=np.float32)
        # As many nodes as a power's oscillations take.
        argument = math.pi * (kappas[1] - kappas[0]) * heightfield.height_range_um
        count_of_nodes = math.ceil(argument + 4.0 * argument ** (1.0 / 3.0) + 2.0)
        nodes = chebyshev.nodes(*kappas, count_of_nodes)

        def cardinals_at(at: NDArray[np.float64]) -> NDArray[np.float64]:
            return chebyshev.cardinals(at, *kappas, count_of_nodes)

        terms = SpectrumBasis(cardinals_at, kappas, np.ones(count_of_nodes), _CARDINALS_SHARE)
        at_kappas = np.zeros((coefficient_table.lanes_of(len(nodes)), lanes), dtype=np.float32)
        at_kappas[: len(nodes), :count] = coefficients.basis_at(nodes)[:, :count]
    layout = MipLayout.for_plan(plan, coefficient_range.frequency)
    lobe2 = 0.0 if plan.coherence.sigma_um is None else 0.5 / coefficient_table.falloff_um2(plan.coherence)
    phase = 2.0 * math.pi * kappas[1] * heightfield.height_range_um
    return _Source(key, layout, base, terms, at_kappas, zeroth_order, lobe2, phase, plan.coherence)


def _sizes(rows: NDArray[np.float32]) -> NDArray[np.float64]:
    """How much each term matters, relative to rows (my, mx, terms)."""
    flat = rows.reshape(-1, rows.shape[2])
    sampled_rows = flat[:: max(1, len(flat) // _ROWS_FOR_TERM_SIZES)].astype(np.float64)
    norms = np.linalg.norm(sampled_rows, axis=1, keepdims=True)
    sizes = np.sqrt(np.mean((sampled_rows / np.where(norms > 0.0, norms, 1.0)) ** 2, axis=0))
    return np.asarray(np.maximum(sizes, _LEAST_TERM_SIZE * sizes.max()))


def _sampled(source: _Source, *, device: wp.Device, threads: int) -> Any:
    """The spectrum's rows, octave after octave, azimuth after azimuth."""
    layout, sampler = source.layout, source.sampler
    bases = wp.array(np.ascontiguousarray(source.at_kappas.T), dtype=sampler.row, device=device)
    values = wp.empty(int(layout.starts[-1]), dtype=sampler.row, device=device)
    for octave, (azimuths, divisions) in enumerate(zip(layout.spectrum_azimuths, layout.divisions, strict=True)):
        log_low, start = layout.log_low + octave * math.log(2.0), int(layout.starts[octave])
        inputs = [
            source.base.arguments, bases, azimuths, layout.rings_per_octave, log_low, divisions, layout.highest,
            source.excluded, start,
        ]  # fmt: skip
        launch(sampler.resample, azimuths, inputs, [values], device=device, threads=threads, slice_size=_ROWS_OF_SLICE)
    return values


def _coloured(
    source: _Source, projection: Projection, spectrum_rows: Any, illuminated: IlluminatedMaterial, *, device: wp.Device,
    threads: int,
) -> tuple[Any, Any, float]:  # fmt: skip
    """The kernel, the table of colours without levels, and its size."""
    layout, count = source.layout, projection.w_basis.shape[1]
    target = colour_lookup.lookup(count, source.is_line_spectrum)
    table = target.Colours()
    table.w_basis = wp.array(projection.w_basis, dtype=target.w_basis, device=device)
    table.least_w, table.per_w = projection.ws[0], 1.0 / (projection.ws[1] - projection.ws[0])
    table.rings_per_octave, table.octaves_per_ring = layout.rings_per_octave, (1.0 + 1e-6) / layout.rings_per_octave
    table.rings_per_log = per_log = layout.rings_per_octave / math.log(2.0)
    table.ring_of_one = (LOG_RED - layout.log_low) * per_log
    table.decimation_scale = (
        source.phase / (_SAFE_DEVIATIONS * per_log) if _is_smooth(illuminated, per_log) else _NO_DECIMATION
    )
    # The spline there begins one before it.
    table.least_uv = math.exp(layout.log_low + 2.0 / per_log - LOG_RED)
    table.lobe_uv = math.sqrt(source.lobe2) * MIDDLE_UM
    table.zeroth_order = wp.array(source.zeroth_order, dtype=wp.float32, device=device)
    table.least_kappa, highest = source.terms.kappas
    table.per_kappa = (_ZEROTH_ENTRIES - 1) / (highest - table.least_kappa)
    table.lobe2 = source.lobe2
    wavenumbers, weights = colorimetry.uniform_quadrature(_ZEROTH_WAVELENGTHS, illuminated.illuminant)
    table.wavenumbers = wp.array(wavenumbers[::-1].copy(), dtype=wp.float32, device=device)
    table.weights = wp.array(weights[::-1].copy(), dtype=wp.vec3f, device=device)
    reflectances = np.zeros((len(weights), 0))
    if illuminated.material is not None:
        angles = np.linspace(0.0, 1.0, _ZEROTH_ANGLES)
        reflectances = reflectance_at(illuminated.material, 1e3 / wavenumbers[::-1, None], angles)
    table.reflectances = wp.array(reflectances, dtype=wp.float32, device=device)
    if source.is_line_spectrum:
        table.line_blurs2 = wp.array(np.square(layout.blurs), dtype=wp.float32, device=device)
        table.spread2 = source.coherence.spread**2
        table.inner_radius2 = inner_radius(source.coherence) ** 2
    # Levels come behind, if any: until then theirs is no memory on the CPU.
    table.rows = wp.empty(layout.with_mip_levels().rows, dtype=target.row, device=device)
    fill = _filler(source, projection, spectrum_rows, device=device, threads=threads)
    _fill(table, target, layout, 0, fill, device=device, threads=threads)
    return target.integrate, table, _megabytes(layout, count)


def _filler(
    source: _Source, projection: Projection, spectrum_rows: Any, *, device: wp.Device, threads: int
) -> Callable[[int, int, Any], None]:
    """What puts the sharp colours of an octave on its azimuths."""
    layout, count, terms = source.layout, projection.w_basis.shape[1], len(source.terms.sizes)
    rings = layout.rings_per_octave
    projector = spectrum_sampling.projector(len(source.at_kappas), count)
    curves = wp.array(projection.weights, dtype=wp.vec3f, device=device)
    options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _ROWS_OF_SLICE}
    before = len(projection.weights) - 1
    matrices_on_device: dict[int, wp.array] = {}

    def matrices_of(product: SeparableTerm) -> wp.array:
        """The matrices of a product on the device: octaves share them."""
        key = id(product.matrices)
        if key not in matrices_on_device:
            flat = product.matrices.reshape(-1, count)
            matrices_on_device[key] = wp.array(flat, dtype=projector.w_basis, device=device)
        return matrices_on_device[key]

    def project_lines(octave: int, matrices: wp.array, rows: wp.array) -> None:
        begin = layout.log_low + (octave - (colour_lookup.FILTER_REACH + 1) / rings) * math.log(2.0)
        row_count = rings + before + 2 * colour_lookup.FILTER_REACH
        values = line_spectrum.gathered(
            spectrum_rows, source.base.arguments.rows, source.sampler, log_begin=begin,
            per_log=rings / math.log(2.0),
            rings=row_count, azimuths=layout.azimuths[0][octave], blur=layout.blurs[octave], **options,
        )  # fmt: skip
        inputs = [values, matrices, curves, terms, rings, row_count]
        launch(projector.project_lines, layout.azimuths[0][octave] // projector.abreast, inputs, [rows], **options)

    # Room for each azimuth, of which a slice on the CPU only takes that of its first ones: what is left is no memory
    # yet.
    length = rings + before + colour_lookup.FILTER_REACH
    sequence, starts, azimuths = None, None, None
    if not source.is_line_spectrum:
        sequence = wp.empty(layout.azimuths[0][-1] * length, dtype=spectrum_rows.dtype, device=device)
        starts = wp.array(layout.starts[:-1], dtype=wp.int32, device=device)
        azimuths = wp.array(layout.spectrum_azimuths, dtype=wp.int32, device=device)

    def project(octave: int, matrices: wp.array, rows: wp.array) -> None:
        inputs = [spectrum_rows, starts, azimuths, matrices, curves, terms, rings, octave, length, sequence]
        groups = layout.azimuths[0][octave] // projector.abreast
        launch(projector.project, groups, inputs, [rows], in_runs=True, **options)

    def fill(_level: int, octave: int, rows: wp.array) -> None:
        terms_of_octave = projection.octaves[octave]
        project_octave = project_lines if source.is_line_spectrum else project
        if terms_of_octave[0].factors is None:
            project_octave(octave, matrices_of(terms_of_octave[0]), rows)
            return
        values = wp.empty(layout.azimuths[0][octave] * rings, dtype=projector.row, device=device)
        for index, product in enumerate(terms_of_octave):
            project_octave(octave, matrices_of(product), values)
            factors = wp.array(product.factors, dtype=wp.float32, device=device)
            inputs = [values, factors, index == 0]
            launch(spectrum_sampling.adder(count), layout.azimuths[0][octave], inputs, [rows], **options)

    return fill


def _megabytes(layout: MipLayout, functions: int) -> float:
    """Size of the rows of a table that are filled."""
    return layout.rows * 3 * functions * 4e-6


def _blurred(
    layout: MipLayout, level0: Any, *, is_line_spectrum: bool, device: wp.Device, threads: int
) -> tuple[Any, Any, float]:
    """A table with mip levels, from one without, whose rows have room for them."""
    count = len(level0.w_basis.dtype())
    target = colour_lookup.lookup(count, is_line_spectrum)
    table = _copied(level0, target, excluding="first_rows azimuths blurs")
    options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _ROWS_OF_SLICE}

    def fill(level: int, octave: int, rows: Any) -> None:
        inputs = [table, layout.source(level, octave), level, octave]
        launch(target.blur, layout.azimuths[level][octave], inputs, [rows], in_runs=True, **options)

    _fill(table, target, layout, 1, fill, device=device, threads=threads)
    return target.integrate, table, _megabytes(layout, count)


def _copied(table: Any, target: Any, *, excluding: str) -> Any:
    """A struct with the fields of another but for some."""
    result = target.Colours()
    for name in set(target.Colours.vars).difference(excluding.split()):
        setattr(result, name, getattr(table, name))
    return result


def without_zeroth_order(table: Any, coherence: Coherence) -> Any:
    """The same table of colours, whose look-ups leave out what the mean plane reflects."""
    target = colour_lookup.lookup(len(table.w_basis.dtype()), coherence.kind == "source")
    return _copied(table, target, excluding="zeroth_order")


def _fill(
    table: Any, target: Any, layout: MipLayout, first_level: int, fill: Callable[[int, int, Any], None], *,
    device: wp.Device, threads: int,
) -> None:  # fmt: skip
    """Make the rows of a layout's mip levels; ``fill`` computes those of a level and an octave."""
    table.azimuths = wp.array(layout.azimuths, dtype=wp.int32, device=device)
    table.blurs = wp.array(layout.level_blurs, dtype=wp.float32, device=device)
    table.first_rows = wp.array(
        layout.first_rows[:-1].reshape(np.shape(layout.azimuths)), dtype=wp.int32, device=device
    )
    options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _ROWS_OF_SLICE}
    rows = wp.empty(max(layout.azimuths[0]) * layout.rings_per_octave, dtype=target.row, device=device)
    for level in range(first_level, len(layout.azimuths)):
        for octave, azimuths in enumerate(layout.azimuths[level]):
            fill(level, octave, rows)
            inputs = [rows, table, level, octave]
            repeated = azimuths + 2 * colour_lookup.HALF_TAPS
            launch(target.interpolate, repeated, inputs, [table.rows], in_runs=True, **options)


def _is_smooth(illuminated: IlluminatedMaterial, per_log: float) -> bool:
    """Whether colours under a light are so smooth in ln λ that every second node tells their mean; lines are not."""
    products = colour_products(illuminated)
    logs = np.log(np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1))
    remainder = np.abs(np.exp(1j * math.pi * per_log * logs) @ products) / products.sum(axis=0)
    return bool(remainder.max() < _MOST_AT_ALIAS)


def _kappas(limits: coefficient_table.CoefficientRange) -> tuple[float, float]:
    """The range of |κ| of the basis."""
    return max(limits.kappa_low, _SMALLEST_KAPPA * limits.kappa_high), limits.kappa_high
