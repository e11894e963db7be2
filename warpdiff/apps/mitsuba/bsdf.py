"""BSDF plug-in ``warpdiff`` for Mitsuba 3: path tracing with baked lobes, the tables that ``warpdiff.bake`` makes.

In Mitsuba's spectral variants, each wavelength λ of a ray looks up the power spectrum (``BakedSpectrum``) at q = (u,
v)/λ and κ = w/λ. In RGB variants a ray looks up colours (``BakedLobes``) at (u, v) and w. (u, v, w) is the scattering
vector. Both look-ups give the absolute BRDF f of ``warpdiff.brdf``:

    f cos θo = R(θd) M (1 + ωi·ωo)² / (cos θi w²) · D.

The unit vectors ωi and ωo point away from the surface along the incoming and the outgoing path, at the angles θi and θo
from the normal. R is Schlick's power reflectance, θd half of the angle between ωi and ωo, M the masking factor, and D
the density of the reflected power over (u, v), which integrates to 1. ⟨|P|²⟩ is the normalised diffracted power, as in
``warpdiff.brdf``. For a coherence window of standard deviation σ, D is 4πσ²/λ² ⟨|P|²⟩. For a source with the angular
spread s, D is ⟨|P|²⟩ / 2πs². Scalar diffraction does not conserve energy, so the reflected power may exceed the
incident power. The reflected power divided by the incident power is the sum of the efficiencies of
``warpdiff.order_efficiencies``.

Outgoing directions are drawn in two steps. First q is drawn, either from the table's cells in proportion to their power
or from the Gaussian lobe of the zeroth order, the reflection of the mean plane. Second, ωo follows from ωi + ωo = −λ q
along the surface; solid angles are dω = λ²/cos θo dq. The sampling uses one of the ray's wavelengths, which is drawn at
random. The density of a direction is the mean of the densities at all wavelengths of the ray (hero wavelengths, Wilkie
et al. 2014).
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np

import warpdiff as wd
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.materials import DEFAULT_IOR

# Type of Mitsuba's values, arrays and modules. Which classes these are depends on Mitsuba's variant, which is set at
# run time.
Variant: TypeAlias = Any

NAME = "warpdiff"
# An outgoing direction is drawn either from the lobe of the zeroth order or from the table of the other orders. `_EVEN`
# is the part of the table's probability that is spread evenly over the disc of (u, v), so that no order is missed. The
# probability of drawing from the lobe of the zeroth order is from `_LEAST_MIRROR` to `_MOST_MIRROR`. These numbers
# change only the noise.
_EVEN, _LEAST_MIRROR, _MOST_MIRROR = 0.05, 0.05, 0.9
# Texels per side of the table of colours over (u, v). The number is limited because twice as many texels per side
# require four times the memory.
_SIZE = 1024
# Directions are drawn from the table's cells in proportion to their powers at one κ = w/λ, or to their colours at one
# w. `_TYPICAL_KAPPA` is this κ, as a fraction of the tabulated range, and `_TYPICAL_W` is this w. These numbers change
# only the noise.
_TYPICAL_KAPPA, _TYPICAL_W = 0.5, 1.4
# Smallest cosine of the angle between a direction and the normal; for smaller cosines the BSDF is 0. Without this
# limit, the geometry factor would diverge at the horizon.
_LEAST_COSINE = 1e-4


def register_mitsuba_bsdf(name: str = NAME) -> None:
    """Register the plug-in with Mitsuba, for its current variant.

    A scene then uses the BSDF ``{"type": "warpdiff", "filename": "lobes.npz"}``. The options ``ior`` (default 1.5) and
    ``masking`` (default True) of the BSDF are those of :func:`warpdiff.shade`. Spectral variants read a file of
    ``BakedSpectrum.save``. RGB variants read a file of ``BakedLobes.save``, baked with ``Coherence("source")``. The
    tangent is the direction along the mesh in which the first texture coordinate increases and the second one is
    constant. Only the outside of the surface reflects. A ``twosided`` BSDF around the plug-in reflects on both sides.

    Args:
        name: Name of the plug-in, an identifier.

    Raises:
        ImportError: Mitsuba is not installed: ``pip install 'warpdiff[mitsuba]'``.
        RuntimeError: Mitsuba's variant is not set, is monochromatic, or is polarised.

    Examples:
        >>> import warpdiff as wd
        >>> import mitsuba  # doctest: +SKIP
        >>> mitsuba.set_variant("llvm_ad_spectral")  # doctest: +SKIP
        >>> wd.register_mitsuba_bsdf()  # doctest: +SKIP
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ArgumentValueError(f"{ref('name')} must be an identifier, of letters, digits and '_', got {name!r}")
    try:
        import mitsuba as mi
    except ImportError as error:
        raise ImportError(f"Mitsuba 3 is not installed: pip install 'warpdiff[mitsuba]' ({error})") from error
    variant = mi.variant()
    if variant is None or "mono" in variant or "polarized" in variant:
        raise RuntimeError(
            f"Mitsuba's variant must be RGB or spectral, without polarisation, got {variant}: call "
            "mitsuba.set_variant('llvm_ad_spectral') or another one first"
        )
    mi.register_bsdf(name, _bsdf_class(_spectrum if mi.is_spectral else _colours))


class _Table:
    """Table of a baked spectrum (powers) or of baked lobes (colours), in arrays of Mitsuba's current variant.

    The table is a square grid with the coordinates q = (u, v)/λ for a spectrum, and (u, v) for colours. The power (or
    colour) at a grid point is a sum of functions, each multiplied by a coefficient of this point. The argument of the
    functions is κ = w/λ for a spectrum and w for colours.

    Attributes:
        largest: Largest coordinate of the grid along each axis.
        size: Number of cells along each side of the grid.
        grid: Coefficients of the functions over the grid, one channel per coefficient.
        functions: Functions of κ or w, one channel per function.
        entries: Number of samples of each function.
        first: κ or w of the first sample.
        span: Difference of κ or w between the last and the first sample.
        zeroth: Power (or colour) of the zeroth order at each sample of κ (or w).
        deviation: Standard deviation of the Gaussian lobe of the zeroth order, in the unit of the grid's coordinates.
        peak: Maximum density of the zeroth order's lobe, 1/(2π deviation²).
        per_cell: Density of a uniform distribution over one cell, 1 divided by the cell's area.
        distribution: Probability with which the sampling of outgoing directions selects each cell.
    """

    def __init__(
        self, grid: Variant, functions: Variant, zeroth: Variant, *, largest: float, first: float, span: float,
        deviation: float, typical: Variant,
    ) -> None:  # fmt: skip
        import mitsuba as mi

        self.largest, self.first, self.span, self.deviation = largest, first, span, deviation
        self.peak = 1.0 / (2.0 * math.pi * deviation**2)
        self.size = grid.shape[0]
        self.grid = mi.Texture2f(mi.TensorXf(np.ascontiguousarray(grid, dtype=np.float32)))
        self.functions = mi.Texture1f(mi.TensorXf(np.ascontiguousarray(functions, dtype=np.float32)))
        self.entries = len(functions)
        self.zeroth = mi.Texture1f(mi.TensorXf(np.ascontiguousarray(zeroth, dtype=np.float32).reshape(len(zeroth), -1)))
        self.per_cell = (self.size / (2.0 * largest)) ** 2
        power = np.maximum(typical, 0.0)
        # Look-ups interpolate linearly between cells, so that a dark cell next to a bright one also reflects light.
        # Each cell therefore has the sampling probability of its brightest neighbour.
        for axis in (0, 1):
            power = np.maximum.reduce([np.roll(power, step, axis) for step in (-1, 0, 1)])
        centres = (np.arange(self.size) + 0.5) / self.size * 2.0 - 1.0
        inside = np.hypot(*np.meshgrid(centres, centres)) <= 1.0 + 2.0 / self.size
        even = inside / inside.sum()
        total = power.sum()
        share = power / total if total > 0.0 else even
        cells = ((1.0 - _EVEN) * share + _EVEN * even).astype(np.float32)
        self.distribution = mi.DiscreteDistribution2D(mi.TensorXf(cells))

    def at(self, value: Variant, entries: int) -> Variant:
        """Return the texture coordinate, 0 to 1, of a value of κ = w/λ or w; the texture has ``entries`` texels."""
        import drjit as dr

        share = dr.clip((value - self.first) / self.span, 0.0, 1.0)
        return (share * (entries - 1) + 0.5) / entries

    def zeroth_at(self, value: Variant) -> Variant:
        """Return the zeroth order's power at a value of κ = w/λ; in RGB variants, its colour at a value of w."""
        import mitsuba as mi

        return self.zeroth.eval(mi.Float(self.at(value, self.zeroth.shape[0])))

    def coefficients(self, x: Variant, y: Variant) -> Variant:
        """Return the interpolated coefficients of the table at the coordinates (x, y) of its grid."""
        import mitsuba as mi

        scale = 0.5 / self.largest
        return self.grid.eval(mi.Point2f(x * scale + 0.5, y * scale + 0.5))

    def functions_at(self, value: Variant) -> Variant:
        """Return the values of all basis functions of the table (baked lobes) at a value of κ = w/λ or w."""
        import mitsuba as mi

        return self.functions.eval(mi.Float(self.at(value, self.entries)))

    def gaussian(self, x: Variant, y: Variant) -> Variant:
        """Return the density of the zeroth order's Gaussian lobe at the coordinates (x, y) of the table's grid."""
        import drjit as dr

        return self.peak * dr.exp((x * x + y * y) * (-0.5 / self.deviation**2))

    def cell_density(self, x: Variant, y: Variant) -> Variant:
        """Return the probability density with which sampling selects the coordinates (x, y) of the table's grid."""
        import drjit as dr
        import mitsuba as mi

        scale = 0.5 * self.size / self.largest
        column, row = x * scale + 0.5 * self.size, y * scale + 0.5 * self.size
        inside = (column >= 0.0) & (row >= 0.0) & (column < self.size) & (row < self.size)
        place = mi.Point2u(
            mi.UInt32(dr.clip(column, 0.0, self.size - 1.0)), mi.UInt32(dr.clip(row, 0.0, self.size - 1.0))
        )
        return dr.select(inside, self.distribution.pdf(place) * self.per_cell, 0.0)


def _spectrum(filename: str) -> _Table:
    """Return the power spectrum over q = (u, v)/λ and κ = w/λ from a file of ``BakedSpectrum.save``."""
    baked = wd.BakedSpectrum.load(filename)
    deviation = 1.0 / (2.0 * math.sqrt(2.0) * math.pi * baked.sigma_um)
    span = baked.largest_kappa - baked.least_kappa
    entry = round(_TYPICAL_KAPPA * (len(baked.functions) - 1))
    # The baked powers are multiplied by this factor. The products are the density of the reflected power over the
    # frequency q = (u, v)/λ, which integrates to 1. This density is λ² times the density over (u, v).
    scale = 4.0 * math.pi * baked.sigma_um**2
    return _Table(
        scale * baked.powers, baked.functions, baked.zeroth, largest=baked.largest_q, first=baked.least_kappa,
        span=span, deviation=deviation, typical=baked.powers @ baked.functions[entry],
    )  # fmt: skip


def _colours(filename: str) -> _Table:
    """Return the table of colours for RGB variants, over (u, v) and w, from a file of ``BakedLobes``.

    The channels of its grid are the coefficients of the first basis function for red, green and blue, then those of the
    second, and so on.
    """
    import mitsuba as mi

    baked = wd.BakedLobes.load(filename)
    if baked.has_material:
        raise ArgumentValueError(
            f"{ref('filename')}: {filename!r} holds lobes of a material: bake without one, and set {ref('ior')}"
        )
    if baked.coherence.kind != "source":
        raise ArgumentValueError(
            f"{ref('filename')}: {filename!r} holds lobes of a window, whose solid angle changes with the wavelength: "
            "bake them with coherence=warpdiff.Coherence('source'), or use a spectral variant and a BakedSpectrum"
        )
    to_rgb = np.array([mi.xyz_to_srgb(mi.Color3f(*axis)) for axis in np.eye(3).tolist()]).reshape(3, 3).T
    deviation = baked.coherence.spread
    grid = baked.cartesian(_SIZE)
    w = np.linspace(0.0, 2.0, len(baked.functions))
    above = np.column_stack([np.zeros((len(w), 2)), -w])
    zeroth = baked.colours(above) - baked.colours(above, zeroth_order=False)
    entry = round(_TYPICAL_W / 2.0 * (len(w) - 1))
    return _Table(
        np.einsum("dc,yxck->yxkd", to_rgb, grid).reshape(_SIZE, _SIZE, -1) / (2.0 * math.pi * deviation**2),
        baked.functions * (w * w)[:, None], zeroth @ to_rgb.T, largest=2.0, first=0.0, span=2.0, deviation=deviation,
        typical=grid[:, :, 1] @ baked.functions[entry],
    )  # fmt: skip


def _bsdf_class(table_of: Variant) -> Variant:
    """Return the class of the BSDF plug-in for Mitsuba's current variant.

    Args:
        table_of: Function that returns the table of baked colours or powers in a file, given the file's name.
    """
    import drjit as dr
    import mitsuba as mi

    spectral = bool(mi.is_spectral)

    class WarpdiffBSDF(mi.BSDF):  # type: ignore[misc]
        """BSDF of a height field from baked tables; the module's docstring has the formulas."""

        def __init__(self, props: Variant) -> None:
            mi.BSDF.__init__(self, props)
            self._table = table_of(str(props["filename"]))
            index = float(props.get("ior", DEFAULT_IOR))
            self._normal = 1.0 if math.isinf(index) else ((index - 1.0) / (index + 1.0)) ** 2
            self._masking = bool(props.get("masking", True))
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.Anisotropic
            self.m_components = [flags]
            self.m_flags = flags

        def _scales(self, si: Variant) -> list[Variant]:
            """Return the factors from grid coordinates to (u, v): the ray's wavelengths [µm]; 1 in RGB variants."""
            if not spectral:
                return [mi.Float(1.0)]
            return [1e-3 * si.wavelengths[k] for k in range(dr.size_v(mi.Spectrum))]

        def _reflectance(self, cosine: Variant) -> Variant:
            """Return Schlick's approximation of the power reflectance at the cosine of an angle of incidence."""
            rest = 1.0 - dr.minimum(cosine, 1.0)
            return self._normal + (1.0 - self._normal) * rest * rest * rest * rest * rest

        def _mirror_share(self, cos_i: Variant, scale: Variant) -> Variant:
            """Return the probability with which the sampling draws from the zeroth order's lobe, for one wavelength.

            The probability is the power of the zeroth order in the mirror direction, limited to the range from 0.05 to
            0.9.
            """
            power = self._table.zeroth_at(2.0 * cos_i / scale)
            return dr.clip(power[1] if len(power) == 3 else power[0], _LEAST_MIRROR, _MOST_MIRROR)

        def _density(self, si: Variant, wo: Variant) -> Variant:
            """Return the density with which the sampling draws the direction ``wo`` [1/sr]."""
            table, total = self._table, mi.Float(0.0)
            scales = self._scales(si)
            for scale in scales:
                x, y = -(si.wi.x + wo.x) / scale, -(si.wi.y + wo.y) / scale
                share = self._mirror_share(si.wi.z, scale)
                density = share * table.gaussian(x, y) + (1.0 - share) * table.cell_density(x, y)
                total += density / (scale * scale)
            return total * wo.z / len(scales)

        def _value(self, si: Variant, wo: Variant) -> Variant:
            """Return the BRDF times cos θo for the direction ``wo``."""
            table, wi = self._table, si.wi
            half = wi + wo
            w, overlap = half.z, 0.5 * dr.squared_norm(half)
            cos_d = dr.sqrt(0.5 * overlap)
            factor = self._reflectance(cos_d) * overlap * overlap / (wi.z * w * w)
            if self._masking:
                factor *= dr.minimum(1.0, dr.minimum(wi.z, wo.z) * w * dr.sqrt(2.0 / overlap) / cos_d)
            values = []
            for scale in self._scales(si):
                x, y, at = -half.x / scale, -half.y / scale, w / scale
                coefficients, functions = table.coefficients(x, y), table.functions_at(at)
                zeroth, lobe = table.zeroth_at(at), table.gaussian(x, y)
                channels = len(zeroth)
                for channel in range(channels):
                    power = mi.Float(0.0)
                    for k in range(len(functions)):
                        power += coefficients[channels * k + channel] * functions[k]
                    # Interpolated power may be slightly negative and is set to 0. RGB colours outside of the sRGB gamut
                    # stay negative.
                    power = dr.maximum(power, 0.0) if spectral else power
                    values.append(factor * (power + zeroth[channel] * lobe) / (scale * scale))
            return mi.Spectrum(*values) if spectral else mi.Color3f(*values)

        def _is_visible(self, si: Variant, wo: Variant, active: Variant) -> Variant:
            return active & (si.wi.z > _LEAST_COSINE) & (wo.z > _LEAST_COSINE)

        def sample(
            self, _ctx: Variant, si: Variant, sample1: Variant, sample2: Variant, active: Variant = True
        ) -> Variant:
            """Draw a direction; return a ``BSDFSample3f``, and the BRDF times cos θo divided by the density."""
            scales, table = self._scales(si), self._table
            at = sample1 * len(scales)
            scale = scales[-1]
            for k in range(len(scales) - 1):
                scale = dr.select((at >= k) & (at < k + 1), scales[k], scale)
            remainder = at - dr.floor(at)
            is_mirror = remainder < self._mirror_share(si.wi.z, scale)
            lobe = mi.warp.square_to_std_normal(sample2)
            place, _, within = table.distribution.sample(sample2)
            cell = 2.0 * table.largest / table.size
            x = dr.select(is_mirror, lobe.x * table.deviation, (place.x + within.x) * cell - table.largest)
            y = dr.select(is_mirror, lobe.y * table.deviation, (place.y + within.y) * cell - table.largest)
            wo_x, wo_y = -si.wi.x - scale * x, -si.wi.y - scale * y
            up2 = 1.0 - wo_x * wo_x - wo_y * wo_y
            wo = mi.Vector3f(wo_x, wo_y, dr.sqrt(dr.maximum(up2, 0.0)))
            visible = self._is_visible(si, wo, active)
            density = dr.select(visible, self._density(si, wo), 0.0)
            visible &= density > 0.0
            result = dr.zeros(mi.BSDFSample3f) if dr.is_jit_v(mi.Float) else mi.BSDFSample3f()
            result.wo, result.pdf, result.eta = wo, density, 1.0
            result.sampled_component = 0
            result.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            return result, dr.select(visible, self._value(si, wo) / dr.select(visible, density, 1.0), 0.0)

        def eval(self, _ctx: Variant, si: Variant, wo: Variant, active: Variant = True) -> Variant:
            """Return the BRDF times cos θo for the direction ``wo``."""
            return dr.select(self._is_visible(si, wo, active), self._value(si, wo), 0.0)

        def pdf(self, _ctx: Variant, si: Variant, wo: Variant, active: Variant = True) -> Variant:
            """Return the density with which ``sample`` draws the direction ``wo`` [1/sr]."""
            return dr.select(self._is_visible(si, wo, active), self._density(si, wo), 0.0)

        def eval_pdf(self, ctx: Variant, si: Variant, wo: Variant, active: Variant = True) -> Variant:
            """Return the BRDF times cos θo, and the sampling density."""
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def to_string(self) -> str:
            """Return the name of the plug-in and the size of its table of baked colours or powers."""
            return f"WarpdiffBSDF[{self._table.size} × {self._table.size} cells]"

    return WarpdiffBSDF
