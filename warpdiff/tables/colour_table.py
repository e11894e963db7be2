"""Colour tables: XYZ under an illuminant over polar coordinates of (u, v). Construction and cache of the tables.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal. A ring of the polar grid is a circle of constant |(u, v)|;
the spectrum has rings of constant |(u, v)|/λ. "Source" means a light source of finite size (coherence of the kind
"source").
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core import forks, memory
from warpdiff.core.wording import ref
from warpdiff.device.devices import load
from warpdiff.device.kernel_calls import launch
from warpdiff.kernels import colour_lookup, spectrum_sampling
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import reflectance_at
from warpdiff.tables.colour_curves import colour_products
from warpdiff.tables.mip_layout import has_mip_levels, megabytes
from warpdiff.tables.polar_grid import MIDDLE_UM, inner_radius
from warpdiff.tables.spectrum_source import SpectrumSource, source_for
from warpdiff.tables.table_cache import TableCache

if TYPE_CHECKING:
    import types
    from collections.abc import Callable, Mapping

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan
    from warpdiff.tables.colour_curves import Projection
    from warpdiff.tables.mip_layout import MipLayout

# A look-up with a wide footprint may skip rings of the table (circles of constant |(u, v)|), for example every second
# one. The sum over the others cannot distinguish a constant from an oscillation with a period of two rings (aliasing).
# Two functions of ln λ must therefore have no such oscillation. For the colour curves (illuminant times colour-matching
# functions times reflectance), `_MOST_AT_ALIAS` is the upper limit of their Fourier transform at its frequency,
# relative to that at 0. For the power spectrum under the Gaussian of the look-up, `_SAFE_DEVIATIONS` is the least
# distance of its largest frequency from that frequency, in standard deviations of the Gaussian's Fourier transform.
# `_NO_DECIMATION` is a value of the field `decimation_scale` with which no ring is skipped.
_MOST_AT_ALIAS, _SAFE_DEVIATIONS, _NO_DECIMATION = 0.05, 4.2, 1e6
# `_ZEROTH_WAVELENGTHS` is the number of wavelengths at which look-ups integrate the zeroth order. For this integral,
# the reflectance of the material is tabulated at `_ZEROTH_ANGLES` values of cos θd. θd is half of the angle between the
# directions to the light and to the viewer.
_ZEROTH_WAVELENGTHS, _ZEROTH_ANGLES = 40, 512
# Number of azimuth samples (polar angles of (u, v)) that a CPU thread processes in one launch of a kernel while a table
# is computed.
_AZIMUTHS_OF_SLICE = 32


@dataclass(frozen=True, eq=False)
class ColourTable:
    """Table of the colours XYZ(u, v, w) = Σ_k c_k(u, v) f_k(w) under an illuminant, plus the zeroth order.

    Attributes:
        kernels: Kernels and struct types that are compiled for the number of functions f_k of w in the table.
        layout: Layout of the table, with only those mip levels whose rows are filled.
        fields: Values of the fields of the kernels' struct ``Colours`` by name, without the fields that the layout
            defines.
    """

    kernels: types.SimpleNamespace
    layout: MipLayout
    fields: Mapping[str, Any]

    @forks.cached_property
    def struct(self) -> Any:
        """Struct with the arrays and numbers of the table, which the kernels of look-ups read."""
        levels, device = self.layout.levels, self.fields["rows"].device
        result = self.kernels.Colours()
        result.first_rows = wp.array(self.layout.first_rows, dtype=wp.int32, device=device)
        result.azimuths = wp.array([grid.azimuths for grid in levels], dtype=wp.int32, device=device)
        result.blurs = wp.array(self.layout.level_blurs, dtype=wp.float32, device=device)
        for name, value in self.fields.items():
            setattr(result, name, value)
        return result

    @property
    def nbytes(self) -> int:
        """Size of the table's arrays [bytes]. On the CPU, only filled rows count, as unfilled rows occupy no memory."""
        values = [getattr(self.struct, name) for name in self.kernels.Colours.vars if name != "rows"]
        others: int = sum(value.capacity for value in values if isinstance(value, wp.array))
        rows = self.fields["rows"]
        count = self.layout.rows if rows.device.is_cpu else len(rows)
        return count * int(wp.types.type_size_in_bytes(self.kernels.row)) + others

    def with_mip_levels(self, **options: Any) -> ColourTable:
        """Return the table with mip levels, which are blurred copies of finer levels in the same array of rows."""
        result = replace(self, layout=self.layout.with_mip_levels())

        def blur(level: int, octave: int, values: wp.array) -> None:
            inputs = [result.struct, result.layout.source(level, octave), level, octave]
            azimuths = result.layout.levels[level].azimuths[octave]
            launch(self.kernels.blur, azimuths, inputs, [values], in_runs=True, **options)

        result.fill(range(1, len(result.layout.levels)), blur, **options)
        return result

    def without_zeroth_order(self) -> ColourTable:
        """Return a table whose look-ups exclude the zeroth order, the reflection of the mean plane of the surface."""
        return replace(self, fields={name: value for name, value in self.fields.items() if name != "zeroth_order"})

    def with_pitch_scales(self) -> ColourTable:
        """Return a table whose look-ups take the length of each direction to the light as a pitch scale.

        A grating map divides a surface into small areas (dots). The pitch scale of a dot is the factor by which its
        grating is stretched in the surface.
        """
        return replace(self, fields={**self.fields, "has_pitch_scales": True})

    def fill(self, levels: range, compute: Callable[[int, int, wp.array], None], **options: Any) -> None:
        """Fill the rows of some mip levels with the coefficients of splines.

        A row has the colour at one ring (circle of constant |(u, v)|) and azimuth (polar angle). ``compute`` writes the
        colours of one octave (factor of 2) of |(u, v)| in a level, through which the splines pass.
        """
        grid = self.layout.levels[0]
        values = wp.empty(max(grid.azimuths) * grid.rings, dtype=self.kernels.row, device=options["device"])
        for level in levels:
            for octave, azimuths in enumerate(self.layout.levels[level].azimuths):
                compute(level, octave, values)
                inputs, repeated = [values, self.struct, level, octave], azimuths + 2 * colour_lookup.HALF_TAPS
                launch(self.kernels.interpolate, repeated, inputs, [self.fields["rows"]], in_runs=True, **options)


def table_for(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, illuminated: IlluminatedMaterial, *,
    device: wp.Device, threads: int,
) -> ColourTable:  # fmt: skip
    """Return the colour table for a plan and for the directions of a call, from the cache if possible.

    A plan has the numbers of a computation. The table has mip levels (blurred copies) only if the plan requires them,
    even if the cached table has more. Results therefore depend on the plan and not on earlier calls.
    """
    cache = TableCache.of(heightfield)
    source = source_for(heightfield, plan, direction_range, device=device, threads=threads)
    key = source.key, illuminated
    options: dict[str, Any] = {"device": device, "threads": threads, "slice_size": _AZIMUTHS_OF_SLICE}
    # The colour table is read from the cache only once, because another thread may replace the entry of the cache at
    # any time.
    table = cache.colours.get(key)
    if table is None:
        table = _made(source, plan, illuminated, cache, **options)
        cache.colours.put(key, table)
    if not has_mip_levels(plan):
        return replace(table, layout=source.layout)
    if len(table.layout.levels) == 1:
        table = table.with_mip_levels(**options)
        cache.colours.put(key, table)
    return table


def function_count(
    heightfield: HeightField, plan: Plan, direction_range: DirectionRange, illuminated: IlluminatedMaterial, *,
    device: wp.Device, threads: int,
) -> int:  # fmt: skip
    """Return the number of functions of w in the colour table of a plan; w is the scattering vector's normal part."""
    source = source_for(heightfield, plan, direction_range, device=device, threads=threads)
    return int(source.projection(plan, illuminated).w_basis.shape[1])


def _made(
    source: SpectrumSource, plan: Plan, illuminated: IlluminatedMaterial, cache: TableCache, **options: Any
) -> ColourTable:
    """Compute a new colour table with mip level 0 only, which is not blurred."""
    projection, samples = source.projection(plan, illuminated), cache.spectra.get(source.key)
    memory.require_memory(
        1e6 * megabytes(plan) + (source.sampled_bytes if samples is None else 0.0),
        f"a table of rings_per_octave={plan.rings_per_octave} and azimuths_per_width={plan.azimuths_per_width}",
        f"take a larger {ref('tolerance')}, or a {ref('plan')} with {{share}} of the rings",
    )  # fmt: skip
    grid, count, device = source.layout.levels[0], projection.w_basis.shape[1], options["device"]
    kernels = colour_lookup.lookup(count, source.has_lines)
    needed = [*source.kernels(count), kernels.interpolate, kernels.integrate]
    if any(len(terms) > 1 for terms in projection.octaves):
        needed.append(spectrum_sampling.adder(count))
    load([*needed, kernels.blur] if has_mip_levels(plan) else needed, device)
    if samples is None:
        # The spectrum depends neither on the illuminant nor on the material. It is cached for tables with other
        # illuminants and materials. The cache has room for one spectrum. To save memory, it is emptied before the next
        # spectrum is computed.
        cache.spectra.clear()
        samples = source.sampled(**options)
        cache.spectra.put(source.key, samples)
    curves = wp.array(projection.weights, dtype=wp.vec3f, device=device)
    flat = [matrix.reshape(-1, count) for matrix in projection.matrices]
    matrices = [wp.array(matrix, dtype=kernels.w_basis, device=device) for matrix in flat]
    project_octave = source.projector(samples, curves, **options)

    def project(_level: int, octave: int, values: wp.array) -> None:
        terms = projection.octaves[octave]
        if terms[0].factors is None:
            project_octave(octave, matrices[terms[0].projection], values)
            return
        summand = wp.empty(grid.azimuths[octave] * grid.rings, dtype=kernels.row, device=device)
        for index, term in enumerate(terms):
            project_octave(octave, matrices[term.projection], summand)
            inputs = [summand, wp.array(term.factors, dtype=wp.float32, device=device), index == 0]
            launch(spectrum_sampling.adder(count), grid.azimuths[octave], inputs, [values], **options)

    result = ColourTable(kernels, source.layout, _fields(source, projection, illuminated, kernels, device))
    result.fill(range(1), project, **options)
    return result


def _fields(
    source: SpectrumSource, projection: Projection, illuminated: IlluminatedMaterial, kernels: types.SimpleNamespace,
    device: wp.Device,
) -> dict[str, Any]:  # fmt: skip
    """Return the fields of the struct ``Colours`` by name, except those of the layout, before rows are filled."""
    grid, zeroth, coherence = source.layout.levels[0], source.zeroth, source.key.coherence
    per_log = grid.rings / math.log(2.0)
    # ``lobe2`` is the variance of the peak of a diffraction order in (u, v), divided by the squared wavelength. For a
    # light source of finite size it is 0: the peaks of orders then have the same width in (u, v) at all wavelengths,
    # which ``spread2`` describes.
    lobe2 = 0.0 if source.has_lines else zeroth.lobe_variance(1.0)
    wavenumbers, weights = colorimetry.uniform_quadrature(_ZEROTH_WAVELENGTHS, illuminated.illuminant)
    reflectances = np.zeros((len(weights), 0))
    if illuminated.material is not None:
        angles = np.linspace(0.0, 1.0, _ZEROTH_ANGLES)
        reflectances = reflectance_at(illuminated.material, 1e3 / wavenumbers[::-1, None], angles)
    # Table rows for all mip levels (blurred copies) are allocated now, although only level 0 is filled. On the CPU,
    # allocated rows occupy no memory until they are written.
    layout = source.layout.with_mip_levels() if coherence.adds_powers else source.layout
    return {
        "rows": wp.empty(layout.rows, dtype=kernels.row, device=device),
        "w_basis": wp.array(projection.w_basis, dtype=kernels.w_basis, device=device),
        "least_w": projection.ws[0], "per_w": 1.0 / (projection.ws[1] - projection.ws[0]),
        "rings_per_octave": grid.rings, "octaves_per_ring": (1.0 + 1e-6) / grid.rings, "rings_per_log": per_log,
        "ring_of_one": -grid.log_radius * per_log,
        "decimation_scale":
            source.phase / (_SAFE_DEVIATIONS * per_log) if _is_smooth(illuminated, per_log) else _NO_DECIMATION,
        # ``least_uv`` is the smallest |(u, v)| of a look-up; smaller values are replaced by it. It lies above the
        # innermost ring, because the spline of a look-up also uses the ring (circle) with the next smaller radius.
        "least_uv": math.exp(grid.log_radius + 2.0 / per_log),
        "lobe2": lobe2, "lobe_uv": math.sqrt(lobe2) * MIDDLE_UM,
        "zeroth_order": wp.array(zeroth.power, dtype=wp.float32, device=device),
        "least_kappa": zeroth.least_kappa,
        "per_kappa": (len(zeroth.power) - 1) / (zeroth.largest_kappa - zeroth.least_kappa),
        "wavenumbers": wp.array(wavenumbers[::-1].copy(), dtype=wp.float32, device=device),
        "weights": wp.array(weights[::-1].copy(), dtype=wp.vec3f, device=device),
        "reflectances": wp.array(reflectances, dtype=wp.float32, device=device),
        "line_blurs2": wp.array(np.square(source.layout.blurs), dtype=wp.float32, device=device),
        "spread2": coherence.spread**2, "inner_radius2": inner_radius(coherence) ** 2,
    }  # fmt: skip


def _is_smooth(illuminated: IlluminatedMaterial, per_log: float) -> bool:
    """Whether sums over every second ring (circle) of a colour table are accurate: colour curves are smooth in ln λ.

    A colour curve is illuminant times colour-matching function times reflectance.
    """
    products = colour_products(illuminated)
    logs = np.log(np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1))
    remainder = np.abs(np.exp(1j * math.pi * per_log * logs) @ products) / products.sum(axis=0)
    return bool(remainder.max() < _MOST_AT_ALIAS)
