"""``Design``: a designed height field, with the requested and the achieved colours and efficiencies.

Manufacture rounds the edges of a relief. This rounding is computed by a convolution of the heights with a Gaussian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.table import Table
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.evaluate.orders import order_efficiencies
from warpdiff.evaluate.reflectance import reflectance
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.theory_verdict import verdict_on
from warpdiff.inverse_design.goal import LEAST_POWER, TRUNCATION, Goal, silenced
from warpdiff.inverse_design.rigorous_check import RigorousCheck, rigorous_values
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import DEFAULT_IOR, Material
from warpdiff.profiles.sampled_profiles import Pixels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.inverse_design.targets import Target
    from warpdiff.profiles.profile_base import Profile

    Array = NDArray[np.float64]

# The rounding of edges in manufacture is computed with a Gaussian. The number is the least number of height samples per
# standard deviation of this Gaussian. Fewer samples do not resolve it.
_PER_EDGE = 2.0
# Least standard deviation of the Gaussian that rounds edges, relative to the distance of the height samples of the
# design. The value is limited by time and memory: the number of samples along an axis that resolve the Gaussian is
# proportional to its reciprocal. At this value, the number of samples is 200 times that of the design.
_SHARPEST_EDGE = 0.01
# Measured peak memory while edges are rounded and efficiencies are computed [bytes per sample]. If doubled, sharp edges
# are refused whose samples would fit into memory.
_BYTES_PER_SAMPLE = 100.0
# Standard deviations of the Gaussian that rounds edges: those for which the robustness is computed by default [µm], and
# the largest accepted one, relative to the period. The latter is limited because wider Gaussians leave little of the
# relief.
_EDGE_WIDTHS_UM, _WIDEST_EDGE = (0.05, 0.1), 0.1
# Largest number of wavelengths of a colour for which Maxwell's equations are solved. The value is limited by the
# computing time, which is proportional to it.
_MOST_WAVELENGTHS = 401


@dataclass(frozen=True, eq=False)
class Design:
    """Result of :func:`warpdiff.design`.

    Attributes:
        heightfield: One period of the surface.
        parameters: Parameters of the profile, shape (p,): the heights of pixels [µm].
        levels_um: Heights of the equally spaced levels to which pixels are rounded [µm], shape (levels,); None without
            levels.
        targets: Targets of the design.
        achieved: Table with a row per requested value: number of the target, quantity (X, Y and Z times the exposure,
            or an order), requested and achieved value, and the error: ΔE2000 of the colour, the relative deviation from
            the mean of equal orders, or the difference of efficiencies.
        exposure: Common factor of all colours, which makes the sum of the squares of ΔE2000 least; 1 without colours.
        history: Table with the number of evaluations and the loss after each stage of the search, for each random
            start.
        loss: Loss of the design, the weighted sum of all errors that the search has minimised.

    Examples:
        >>> import math
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> pixels = wd.profiles.Pixels(0.5, np.zeros((1, 16)))
        >>> target = wd.Target.orders({(0, 1): 0.3, (0, -1): 0.3}, (0, 0, 1), 632.8, ior=math.inf)
        >>> result = wd.design(pixels, target, starts=1)
        >>> print(result.achieved)
        target     quantity  requested  achieved  error
             0   order 0, 1        0.3  ...
             0  order 0, -1        0.3  ...
    """

    heightfield: HeightField
    parameters: Array = field(repr=False)
    levels_um: Array | None
    targets: tuple[Target, ...]
    achieved: Table
    exposure: float
    history: Table
    loss: float
    _profile: Profile = field(repr=False)

    def __repr__(self) -> str:
        if isinstance(self._profile, Pixels):
            shape = " × ".join(str(n) for n in self._profile.pixels if n > 1) or "1"
            text = f"{shape} pixels of {self._profile.pixel_um:g} µm"
        else:
            text = f"{type(self._profile).__name__}"
        levels = f", {len(self.levels_um)} levels" if self.levels_um is not None else ""
        return f"Design({text}{levels}, depth {self.heightfield.height_range_um:.3g} µm)"

    @property
    def delta_e(self) -> Array:
        """ΔE2000 between requested colours and achieved colours times ``exposure``, shape (number of colours,)."""
        rows = np.char.equal(self.achieved["quantity"], "Y")
        return np.asarray(self.achieved["error"][rows])

    @property
    def uniformity_errors(self) -> Array:
        """Uniformity error of each target of equal orders, shape (n,): (largest − least)/(largest + least) efficiency.

        The error is 1 if all orders of a target are dark.
        """
        return np.array([uniformity_error(self._of(k)) for k, each in enumerate(self.targets) if each.kind == "equal"])

    @property
    def shares(self) -> Array:
        """Sum of the efficiencies of the orders of each target of orders, relative to all propagating orders."""
        result = []
        with silenced():
            for k, target in enumerate(self.targets):
                if target.kind != "colour":
                    result.append(self._of(k).sum() / Goal.efficiencies(target, self.heightfield).sum())
        return np.array(result)

    def _of(self, number: int) -> Array:
        """Return the achieved XYZ of a colour or efficiencies of orders, for the target with the index ``number``."""
        return np.asarray(self.achieved["achieved"][self.achieved["target"] == number])

    def report(self) -> str:
        """Return the requested and achieved values, their errors, and the verdict on scalar diffraction as text."""
        lines = [str(self), str(self.achieved)]
        if len(self.delta_e):
            lines.append(f"common exposure {self.exposure:.3g}; ΔE2000 {', '.join(f'{d:.2f}' for d in self.delta_e)}")
        lines += [f"uniformity error {value:.4f}" for value in self.uniformity_errors]
        lines += [f"share of the reflected power {value:.4f}" for value in self.shares]
        lines.append(f"scalar diffraction: {verdict_on(self.heightfield)}")
        return "\n".join(lines)

    def check_rigorously(
        self, *, material: Material | None = None, wavelengths: int = 21, max_harmonics: int = 256,
        progress: Progress = None,
    ) -> RigorousCheck:  # fmt: skip
        """Evaluate the targets by rigorous solutions for unpolarised light (extra ``rigorous``).

        The height field must have a single row or column, and all directions must be perpendicular to the grooves.
        Scalar diffraction is an approximation, so that a real foil differs from its design.

        Args:
            material: Material of the foil without a film; None is that of the targets, or aluminium if they are perfect
                mirrors, which have no rigorous solution here.
            wavelengths: Number of wavelengths of a colour, 5 to 401, by default 21. Efficiencies are interpolated
                between them.
            max_harmonics: Largest order N of the Fourier series of the fields, 8 to 2000, by default 256.
            progress: Function that is called with the finished fraction, 0 to 1; True shows a progress bar.

        Returns:
            Rigorous values compared with the requested ones, and the fraction of the solutions that have converged.

        Warns:
            WarpdiffWarning: Some solutions have not converged.

        Raises:
            ValueError: The surface or a direction has no rigorous solution here, or an argument is out of
                its range.
            ImportError: meent is not installed: ``pip install 'warpdiff[rigorous]'``.

        Examples:
            >>> import math
            >>> pixels = wd.profiles.Pixels(0.5, np.zeros((1, 16)))
            >>> target = wd.Target.equal([(0, -1), (0, 1)], (0, 0, 1), 632.8, ior=math.inf)
            >>> result = wd.design(pixels, target, levels=2, starts=1)
            >>> result.check_rigorously()  # doctest: +SKIP
            RigorousCheck(uniformity error 0.0...; converged at 100%)
        """
        report = reporter(progress, "rigorous check")
        count = validation.count(wavelengths, "wavelengths", least=5, most=_MOST_WAVELENGTHS)
        values, converged, change = rigorous_values(
            self.heightfield, self.targets, self._substance(material), count, max_harmonics, report
        )
        exposure = fitted_exposure(self.targets, values, self.exposure)
        table = _table(self.targets, values, exposure)
        shown = np.char.equal(table["quantity"], "Y")
        uniform = [uniformity_error(v) for v, t in zip(values, self.targets, strict=True) if t.kind == "equal"]
        if report is not None:
            report(1.0)
        if converged < 1.0:
            last = f"efficiencies changed by up to {change:.1e} of the incident power in the last doubling of harmonics"
            warn(
                f"{1.0 - converged:.0%} of the rigorous solutions have not converged: "
                f"{last if change < math.inf else 'harmonics could not be doubled'}; increase {ref('max_harmonics')}, "
                f"got {max_harmonics}"
            )
        return RigorousCheck(table, exposure, table["error"][shown], np.array(uniform), converged, change)

    def _substance(self, material: Material | None) -> Material:
        """Return the material for a check by Maxwell's equations: the argument, or else that of the targets."""
        if material is not None:
            validation.instance(material, Material, "material")
            return material
        optics = {(target.optics.material, target.optics.ior) for target in self.targets}
        if len(optics) > 1:
            raise ArgumentValueError(f"{ref('material')} must be given if targets have different materials, got None")
        substance, ior = next(iter(optics))
        if substance is None:
            return Material.metal("Al") if ior == math.inf else Material.dielectric(DEFAULT_IOR if ior is None else ior)
        return substance

    def robustness(
        self, *, depth_scales: Sequence[float] = (0.95, 1.05), edge_widths_um: Sequence[float] | None = None,
        tilts_deg: Sequence[float] = (0.25, 1.0),
    ) -> Table:  # fmt: skip
        """Return the errors of the design after changes of its depth, of the sharpness of its edges, and of its tilt.

        Args:
            depth_scales: Factors of all heights, 0.1 to 10.
            edge_widths_um: Standard deviations of the Gaussian that rounds all edges [µm], 0, or from a hundredth of
                the distance of samples to a tenth of the shorter period. None is those of 0.05 and 0.1 that are within
                this range.
            tilts_deg: Angles by which the surface is turned about the y axis [degrees], −20 to 20. All lights and
                viewers must remain above the horizon.

        Returns:
            Table with a row for the unchanged design and a row per change: kind and amount of the change, the largest
            ΔE2000 of a colour at the exposure of the design if there are colours, and the largest deviation of an
            order's efficiency if there are orders. This deviation is relative to the mean of equal orders, or a
            difference of efficiencies.

        Raises:
            ValueError: A number is out of its range, or a direction leaves the upper hemisphere.
            MemoryError: Samples that resolve an edge do not fit into memory.

        Examples:
            >>> import math
            >>> pixels = wd.profiles.Pixels(0.5, np.zeros((1, 16)))
            >>> target = wd.Target.orders({(0, 1): 0.3, (0, -1): 0.3}, (0, 0, 1), 632.8, ior=math.inf)
            >>> print(wd.design(pixels, target, starts=1).robustness(edge_widths_um=[0.05], tilts_deg=[1.0]))
            change  amount  order_error
              none       0  ...
             depth    0.95  ...
             depth    1.05  ...
             edges    0.05  ...
              tilt       1  ...
        """
        surface = self.heightfield
        least = min(size for n, size in zip(surface.shape, surface.size_um, strict=True) if n > 1)
        changes: list[tuple[str, float, HeightField, float]] = [("none", 0.0, surface, 0.0)]
        for scale in _numbers(depth_scales, "depth_scales", 0.1, 10.0):
            scaled = HeightField.of_known_scale(scale * surface.heights_um, surface.pitch_um)
            changes.append(("depth", scale, scaled, 0.0))
        widest = _WIDEST_EDGE * least
        if edge_widths_um is None:
            widths = [width for width in _EDGE_WIDTHS_UM if _sharpest_um(surface) <= width <= widest]
        else:
            widths = _numbers(edge_widths_um, "edge_widths_um", 0.0, widest, " µm, a tenth of the period")
        for width in widths:
            _check_edge(surface, width)
        changes += [("edges", width, _rounded(surface, width), 0.0) for width in widths]
        changes += [("tilt", angle, surface, angle) for angle in _numbers(tilts_deg, "tilts_deg", -20.0, 20.0)]
        rows = []
        with silenced():
            for name, amount, changed, angle in changes:
                errors = _errors(self.targets, achieved_values(changed, self.targets, angle), self.exposure)
                rows.append((name, amount, *errors))
        kinds = {"delta_e": "colour" in (t.kind for t in self.targets), "order_error": len(self.shares) > 0}
        columns = dict(zip(("change", "amount", *kinds), map(np.array, zip(*rows, strict=True)), strict=True))
        return Table({name: column for name, column in columns.items() if kinds.get(name, True)})


def make_design(
    profile: Profile, targets: tuple[Target, ...], x: Array, log_exposure: float, levels_um: Array | None, loss: float,
    history: Table,
) -> Design:  # fmt: skip
    """Return the design with the parameters ``x``, evaluated by public functions, which may issue warnings."""
    surface = profile.height_field(x)
    values = achieved_values(surface, targets)
    exposure = fitted_exposure(targets, values, math.exp(log_exposure))
    achieved = _table(targets, values, exposure)
    return Design(surface, x, levels_um, targets, achieved, exposure, history, loss, profile)


def achieved_values(surface: HeightField, targets: Sequence[Target], tilt_deg: float = 0.0) -> list[Array]:
    """Return XYZ or efficiencies of each target, for a surface that is turned about the y axis.

    A target is a requested colour, or the requested efficiencies of some orders.
    """
    angle = math.radians(tilt_deg)
    turn = np.array(
        [[math.cos(angle), 0.0, -math.sin(angle)], [0.0, 1.0, 0.0], [math.sin(angle), 0.0, math.cos(angle)]]
    )
    result = []
    for target in targets:
        optics, light, view = target.optics, turn @ target.to_light, turn @ target.to_view
        if min(light[2], view[2]) <= 0.0:
            raise ArgumentValueError(
                f"{ref('tilts_deg')} must leave all directions above the horizon, got {tilt_deg:g}"
            )
        if target.kind == "colour":
            xyz = reflectance(
                surface, light, view, illuminant=optics.illuminant, coherence=optics.coherence, ior=optics.ior,
                material=optics.material, masking=optics.masking, tolerance=TRUNCATION,
            )  # fmt: skip
            result.append(np.asarray(xyz, dtype=np.float64))
        else:
            orders = order_efficiencies(
                surface, light, target.wavelength_nm, ior=optics.ior, material=optics.material, energy=optics.energy
            )
            result.append(np.array([orders[int(y), int(x)][0] for y, x in target.pairs]))
    return result


def fitted_exposure(targets: Sequence[Target], values: list[Array], first: float) -> float:
    """Return the factor of all colours that makes the sum of the squares of ΔE2000 least; 1 without colours."""
    from scipy.optimize import minimize_scalar

    pairs = [(v, t.requested) for v, t in zip(values, targets, strict=True) if t.kind == "colour"]
    if not pairs:
        return 1.0
    colours, requested = (np.stack(part) for part in zip(*pairs, strict=True))

    def total(log_exposure: float) -> float:
        return float((colorimetry.colour_difference(colours * math.exp(log_exposure), requested) ** 2).sum())

    centre = math.log(first)
    result = minimize_scalar(total, bounds=(centre - 2.0, centre + 2.0), method="bounded", options={"xatol": 1e-6})
    return math.exp(float(result.x))


def uniformity_error(efficiencies: Array) -> float:
    """Return (largest − least)/(largest + least) of the efficiencies of orders; 1, the maximum, if all are dark."""
    total = float(efficiencies.max() + efficiencies.min())
    return float(np.ptp(efficiencies)) / total if total > LEAST_POWER else 1.0


def _errors(targets: Sequence[Target], values: list[Array], exposure: float) -> tuple[float, float]:
    """Return the largest ΔE2000 and the largest error of an order's efficiency; NaN without colours or orders."""
    table = _table(targets, values, exposure)
    is_order = np.array([targets[k].kind != "colour" for k in table["target"]])
    parts = table["error"][~is_order], np.abs(table["error"][is_order])
    first, second = (float(part.max()) if len(part) else math.nan for part in parts)
    return first, second


def _table(targets: Sequence[Target], values: list[Array], exposure: float) -> Table:
    rows: list[tuple[int, str, float, float, float]] = []
    for k, (target, value) in enumerate(zip(targets, values, strict=True)):
        if target.kind == "colour":
            shown = exposure * value
            error = float(colorimetry.colour_difference(shown, target.requested))
            rows += [
                (k, name, float(a), float(b), error) for name, a, b in zip("XYZ", target.requested, shown, strict=True)
            ]
            continue
        names = [f"order {y}, {x}" for y, x in target.pairs]
        is_equal = target.kind == "equal"
        # If all orders of a target are dark, their mean efficiency is 0. `LEAST_POWER` avoids a division by 0, and the
        # deviation is −1.
        errors = value / max(float(value.mean()), LEAST_POWER) - 1.0 if is_equal else value - target.requested
        requested = np.full(len(value), value.mean()) if is_equal else target.requested
        rows += list(zip([k] * len(names), names, requested.tolist(), value.tolist(), errors.tolist(), strict=True))
    columns = ("target", "quantity", "requested", "achieved", "error")
    return Table(dict(zip(columns, map(np.array, zip(*rows, strict=True)), strict=True)))


def _numbers(values: ArrayLike, name: str, low: float, high: float, origin: str = "") -> list[float]:
    """Return the numbers in an argument as a list, after a check of their range.

    ``origin`` is the unit of the limit ``high`` and the reason for it, for the error message.
    """
    array = validation.finite_array(values, name, ndim=1)
    if array.size and (array.min() < low or array.max() > high):
        raise ArgumentValueError(f"{ref(name)} must lie within {low:g} to {high:g}{origin}, got {array.tolist()!s:.60}")
    return [float(value) for value in array]


def _sharpest_um(surface: HeightField) -> float:
    """Return the least accepted standard deviation of the Gaussian that rounds edges [µm]."""
    pitches = [pitch for n, pitch in zip(surface.shape, surface.pitch_um, strict=True) if n > 1]
    return _SHARPEST_EDGE * max(pitches, default=0.0)


def _check_edge(surface: HeightField, width_um: float) -> None:
    """Raise an error for edges that are too sharp for the samples of a surface, or whose samples exceed memory."""
    if width_um == 0.0:
        return
    if width_um < (least := _sharpest_um(surface)):
        raise ArgumentValueError(
            f"{ref('edge_widths_um')} must be 0, or at least {least:g} µm, a hundredth of the distance of samples, got "
            f"{width_um:g}: give 0 for sharp edges"
        )
    pairs = zip(surface.shape, surface.pitch_um, strict=True)
    count = math.prod(n * max(math.ceil(_PER_EDGE * pitch / width_um), 1) for n, pitch in pairs if n > 1)
    memory.require_memory(
        _BYTES_PER_SAMPLE * count, f"{ref('edge_widths_um')} of {width_um:g} µm with {count} samples",
        "give wider edges, or a profile with fewer pixels",
    )  # fmt: skip


def _rounded(surface: HeightField, width_um: float) -> HeightField:
    """Return a periodic surface convolved with a Gaussian, at a pitch that resolves the Gaussian.

    ``width_um`` is the standard deviation of the Gaussian [µm].
    """
    if width_um == 0.0:
        return surface
    heights, pitches = surface.heights_um, []
    for axis, (n, pitch) in enumerate(zip(surface.shape, surface.pitch_um, strict=True)):
        finer = max(math.ceil(_PER_EDGE * pitch / width_um), 1) if n > 1 else 1
        heights = np.repeat(heights, finer, axis=axis)
        pitches.append(pitch / finer)
    y, x = (np.fft.fftfreq(n, pitch) for n, pitch in zip(heights.shape, pitches, strict=True))
    weights = np.exp(-2.0 * (np.pi * width_um) ** 2 * (y[:, None] ** 2 + x[None, :] ** 2))
    heights = np.fft.ifft2(np.fft.fft2(heights) * weights).real
    return HeightField.of_known_scale(heights, (pitches[0], pitches[1]))
