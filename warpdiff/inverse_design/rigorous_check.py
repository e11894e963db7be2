"""Colours and efficiencies of a design by rigorous solutions of Maxwell's equations instead of scalar diffraction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.colour_sampling import sampling
from warpdiff.adjoint.reflection import index_of
from warpdiff.adjoint.spectral_model import Illumination
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.inverse_design.goal import SEARCH_TRUNCATION, silenced
from warpdiff.inverse_design.transposition import transposed_field, transposed_targets
from warpdiff.optics import colorimetry
from warpdiff.rigorous.rigorous_orders import ACROSS, rigorous_order_efficiencies

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.core.table import Table
    from warpdiff.heightfield.field import HeightField
    from warpdiff.inverse_design.targets import Target
    from warpdiff.optics.materials import Material

    Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RigorousCheck:
    """Colours and efficiencies that a design achieves by rigorous solutions of Maxwell's equations.

    Attributes:
        achieved: Table like ``Design.achieved``, with rigorous values; the exposure of colours is fitted to the
            rigorous values.
        exposure: Common factor of all colours.
        delta_e: ΔE2000 of the colours, shape (number of colours,).
        uniformity_errors: (largest − least)/(largest + least) of each target of equal orders.
        converged: Fraction of the rigorous solutions that have converged, 0 to 1.
        change: Largest change of an efficiency in the last doubling of the number of harmonics (orders of the Fourier
            series of the fields); infinite if ``max_harmonics`` permits no doubling at a wavelength.
    """

    achieved: Table
    exposure: float
    delta_e: Array
    uniformity_errors: Array
    converged: float
    change: float

    def __repr__(self) -> str:
        parts = [f"ΔE2000 {value:.2f}" for value in self.delta_e]
        parts += [f"uniformity error {value:.3f}" for value in self.uniformity_errors]
        return f"RigorousCheck({', '.join(parts) or 'orders'}; converged at {self.converged:.0%})"


def rigorous_values(
    surface: HeightField, targets: Sequence[Target], material: Material, count: int, max_harmonics: int,
    report: Callable[[float], None] | None,
) -> tuple[list[Array], float, float]:  # fmt: skip
    """Return rigorous XYZ or efficiencies of each target, the fraction of converged solutions, and the largest change.

    The change is that of an efficiency in the last doubling of the number of harmonics.

    A surface with a single column of samples is solved with x and y exchanged.
    """
    along = "y"
    if surface.shape[1] == 1 < surface.shape[0]:
        surface, targets, along = transposed_field(surface), transposed_targets(targets), "x"
    for k, target in enumerate(targets):
        if max(abs(target.to_light[1]), abs(target.to_view[1])) > ACROSS:
            raise ArgumentValueError(
                f"{ref(f'targets[{k}]')} must have directions perpendicular to the grooves ({along} = 0), got a "
                f"component {along} of {target.to_light[1]:g} to the light and {target.to_view[1]:g} to the viewer"
            )
    # Maxwell's equations are solved at the wavelengths `nodes` [nm] for colours. Colours with the same direction to the
    # light use the same solutions, which contain all orders.
    nodes = np.linspace(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, count)
    keys = [(*t.to_light, *(nodes if t.kind == "colour" else [t.wavelength_nm])) for t in targets]
    solved, flags, changes = {}, [], []
    distinct = list(dict.fromkeys(keys))
    for number, key in enumerate(distinct):
        with silenced():
            solved[key] = rigorous_order_efficiencies(
                surface, key[:3], key[3:], material=material, max_harmonics=max_harmonics,
                progress=None if report is None else _part(report, number, len(distinct)),
            )  # fmt: skip
        flags.append(solved[key].converged)
        changes.append(solved[key].changes)
    values: list[Array] = []
    for target, key in zip(targets, keys, strict=True):
        result = solved[key]
        if target.kind == "colour":
            values.append(_colour(target, surface.size_um, nodes, result.orders[:, 1], result.efficiencies))
        else:
            values.append(np.array([result[int(y), int(x)][0] for y, x in target.pairs]))
    return values, float(np.concatenate(flags).mean()), float(np.concatenate(changes).max())


def _part(report: Callable[[float], None], number: int, count: int) -> Callable[[float], None]:
    return lambda share: report((number + share) / count)


def _colour(
    target: Target, size_um: tuple[float, float], nodes: Array, orders: NDArray[np.int64], efficiencies: Array
) -> Array:
    """Return XYZ of a target from rigorous efficiencies of n orders at the m wavelengths ``nodes``, shape (m, n).

    In Stam's theory, the reflectance ρ is the sum over orders of C R|H|² times a Gaussian weight, which depends on the
    coherence. C is the geometry factor, R is the reflectance of a flat surface, and |H|² is the power of a Fourier
    coefficient. The efficiency of an order in this theory is C R|H|²/cos θi. C R|H|² is therefore replaced by the
    rigorous efficiency times cos θi, or for an extended source by the rigorous efficiency alone.

    Efficiencies are interpolated between few wavelengths, because they are smooth except where orders begin to
    propagate. The Gaussian weights vary fast with the wavelength, if the coherence is long. They are computed at many
    wavelengths.
    """
    from scipy.interpolate import PchipInterpolator

    optics = target.optics
    is_source = optics.coherence.kind == "source"
    light, view = target.to_light[None], target.to_view[None]
    wavelengths, quadrature = sampling(
        light, view, 0.0, size_um, optics.coherence, None, optics.illuminant, SEARCH_TRUNCATION
    )
    pairs = Illumination(light, view, wavelengths, optics.coherence, index_of(None), None, masking=False).pairs(
        slice(0, 1)
    )
    at = np.clip(wavelengths, nodes[0], nodes[-1])
    powers = np.maximum(PchipInterpolator(nodes, efficiencies, axis=0)(at), 0.0)
    # The order m belongs to the Fourier coefficient of index r = −m, whose frequency is r/L for the period L.
    distance = pairs.centres[:, :1] + orders / size_um[1]
    rho = (powers * np.exp(-pairs.forms[:, :1] * distance**2)).sum(axis=1)
    return np.asarray((1.0 if is_source else target.to_light[2]) * rho @ quadrature)
