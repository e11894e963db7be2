"""Loss of all targets of a design, with its exact gradient by the parameters of a profile.

A group is a list of targets that are evaluated together: all colours with equal optics, or one target of orders. The
values of a group are the XYZ of its colours, shape (n, 3), or the efficiencies of its orders, shape (n,). The exposure
is the common factor of all colours. The adjoint of a quantity is the derivative of the loss with respect to it.
Normalised efficiencies are those of Stam's theory times factors, so that all orders of a perfect mirror sum to 1.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.adjoint.order_derivatives import order_efficiencies as order_derivatives
from warpdiff.adjoint.spectral_derivatives import reflectance
from warpdiff.adjoint.surfaces import Relief
from warpdiff.core.wording import ArgumentValueError, WarpdiffWarning, ref
from warpdiff.evaluate.orders import propagating
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.inverse_design.targets import Target
    from warpdiff.profiles.outline import Outline
    from warpdiff.profiles.profile_base import Profile

    Array = NDArray[np.float64]

# Weight in the loss of the mean squared deviation of efficiencies, relative to the mean efficiency of a target. With
# this weight, a deviation of 1 % of all orders counts as much as a colour difference of 1 in CIE Lab.
_PER_DEVIATION = 1e4
# Weight of the power that a target of equal orders lacks, relative to the power that a flat surface reflects. The value
# was chosen so that 1 % more power is worth a deviation of 2.2 % of all orders. Larger weights make orders less equal.
_PER_LOST_SHARE = 500.0
# Weight of the logarithm of the exposure (common factor of all colours) in the loss. Dark designs require a large
# exposure. The value was chosen so that a design that is twice as bright may have a colour error of 4.6 in CIE Lab.
# Larger weights make colours wrong.
_PER_EXPOSURE = 30.0
# All orders of a target count as dark if the sum of their efficiencies is at most this value. The value is far above
# the rounding errors of powers, about 1e-16 per order, which must not count as equal orders. If doubled, no design
# changes.
LEAST_POWER = 1e-12
# Constant δ of CIE Lab (CIE 15). Lab's function of X, Y and Z is linear where their ratio to the white is at most δ³.
_DELTA = 6.0 / 29.0
# Accepted relative error of computed colours: during the search for a design, and for the final design.
SEARCH_TRUNCATION, TRUNCATION = 1e-3, 1e-4
# Natural logarithms of the exposure (common factor of all colours) that are tried to estimate the best exposure.
_LOG_EXPOSURES = np.linspace(-4.0, 14.0, 181)


class Loss(NamedTuple):
    """Loss and its derivatives.

    Attributes:
        value: The loss.
        adjoints: Derivatives of the loss by the values (colours or efficiencies) of each group of targets.
        of_exposure: Derivative of the loss by the logarithm of the exposure, the common factor of all colours.
    """

    value: float
    adjoints: list[Array]
    of_exposure: float


def lab(xyz: Array) -> tuple[Array, Array]:
    """Return CIE Lab of XYZ, shape (..., 3), for the white D65 with Y = 1, and the derivatives by XYZ, (..., 3, 3)."""
    white = colorimetry.colour_products("D65").sum(axis=0)
    ratio = np.maximum(xyz / white, 0.0)
    is_linear = ratio <= _DELTA**3
    root = np.cbrt(np.where(is_linear, 1.0, ratio))
    f = np.where(is_linear, ratio / (3.0 * _DELTA**2) + 4.0 / 29.0, root)
    slopes = np.where(is_linear, 1.0 / (3.0 * _DELTA**2), 1.0 / (3.0 * root**2)) / white
    matrix = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
    return f @ matrix.T - [16.0, 0.0, 0.0], matrix * slopes[..., None, :]


class Goal:
    """Targets of a design in groups that are evaluated together, and their loss.

    Attributes:
        groups: Targets of each group: all colours with equal optics, or one target of orders.
        factors: Ratios of normalised (energy-conserving) efficiencies to Stam's efficiencies for each group of orders,
            shape (n,). They change slowly with the surface, so that the search treats them as constants.
        has_colours: Whether there is a target of a colour.
    """

    def __init__(self, targets: Sequence[Target]) -> None:
        by_optics: dict[object, list[Target]] = {}
        for target in targets:
            by_optics.setdefault(target.optics if target.kind == "colour" else id(target), []).append(target)
        self.groups = list(by_optics.values())
        self.factors = [np.ones(len(group[0].pairs)) for group in self.groups]
        self.has_colours = any(target.kind == "colour" for target in targets)

    def values(
        self, surface: HeightField | Outline, wrt: tuple[str, ...] = (), *, truncation: float = SEARCH_TRUNCATION
    ) -> tuple[list[Array], Callable[[list[Array]], dict[str, Array]]]:
        """Return the values (colours or efficiencies) of each group of targets, and a function for derivatives.

        The function converts derivatives of the loss by these values to derivatives by the variables ``wrt`` of the
        surface. Efficiencies are those of Stam's theory times ``factors``.
        """
        values: list[Array] = []
        pulls: list[Callable[[Array], dict[str, Array]]] = []
        for group, factors in zip(self.groups, self.factors, strict=True):
            optics = group[0].optics
            if group[0].kind == "colour":
                lights, views = (
                    np.stack([getattr(target, name) for target in group]) for name in ("to_light", "to_view")
                )
                result = reflectance(
                    surface, lights, views, wrt=wrt, illuminant=optics.illuminant, coherence=optics.coherence,
                    ior=optics.ior, material=optics.material, masking=optics.masking, truncation=truncation,
                )  # fmt: skip
                values.append(result.value)
                pulls.append(result.vjp)
                continue
            result = order_derivatives(
                surface, group[0].to_light, group[0].wavelength_nm, wrt=wrt, ior=optics.ior, material=optics.material,
                energy="stam",
            )  # fmt: skip
            places = places_of(group[0], surface)
            values.append(factors * result.value[0, places])

            def pull(
                adjoint: Array, result: object = result, places: NDArray[np.int64] = places, factors: Array = factors
            ) -> dict[str, Array]:
                full = np.zeros(result.value.shape)  # type: ignore[attr-defined]
                full[0, places] = factors * adjoint
                return result.vjp(full)  # type: ignore[attr-defined, no-any-return]

            pulls.append(pull)

        def pullback(adjoints: list[Array]) -> dict[str, Array]:
            parts = [pull(adjoint) for pull, adjoint in zip(pulls, adjoints, strict=True)]
            return {name: np.sum([part[name] for part in parts], axis=0) for name in parts[0]}

        return values, pullback

    def update_factors(self, surface: HeightField | Outline) -> None:
        """Set ``factors`` to the ratios of normalised (energy-conserving) to Stam's efficiencies of a surface."""
        for k, group in enumerate(self.groups):
            optics = group[0].optics
            if group[0].kind == "colour" or optics.energy == "stam":
                continue
            plain, normalised = (
                self.efficiencies(group[0], surface, energy)[places_of(group[0], surface)]
                for energy in ("stam", optics.energy)
            )
            self.factors[k] = np.divide(normalised, plain, out=np.ones_like(plain), where=plain > 0.0)

    @staticmethod
    def efficiencies(target: Target, surface: HeightField | Outline, energy: str | None = None) -> Array:
        """Return the efficiencies of all orders that propagate for the light and wavelength of a target, shape (n,)."""
        optics = target.optics
        result = order_derivatives(
            surface, target.to_light, target.wavelength_nm, wrt=("height_scale",), ior=optics.ior,
            material=optics.material, energy=energy or optics.energy,  # type: ignore[arg-type]
        )  # fmt: skip
        return np.asarray(result.value[0])

    def costs(self, values: list[Array], log_exposure: float) -> Array:
        """Return the loss for the values of all groups of targets: efficiencies, shape (n,), or colours, shape (n, 3).

        ``log_exposure`` is the logarithm of the common factor of all colours. The values may be those of several
        surfaces, along leading axes: shapes (..., n) or (..., n, 3). The loss then has the shape (...).
        """
        total = np.asarray(_PER_EXPOSURE * log_exposure if self.has_colours else 0.0)
        for group, value in zip(self.groups, values, strict=True):
            if group[0].kind == "colour":
                requested = lab(np.stack([target.requested for target in group]))[0]
                difference = lab(math.exp(log_exposure) * value)[0] - requested
                total = total + (difference * difference).sum(axis=(-2, -1))
            elif group[0].kind == "orders":
                scale = _PER_DEVIATION / (value.shape[-1] * float(group[0].requested.mean()) ** 2)
                total = total + scale * ((value - group[0].requested) ** 2).sum(axis=-1)
            else:
                # The relative deviation of an efficiency η is η / mean − 1. The mean square over n orders is
                # n Σ η² / (Σ η)² − 1. Its largest value is n − 1, if all power is in one order. If all orders are dark,
                # the mean is 0, and the deviation is set to n, so that dark orders do not count as equal.
                count, power = value.shape[-1], value.sum(axis=-1)
                ratio = count * (value * value).sum(axis=-1) / np.maximum(power, LEAST_POWER) ** 2
                deviation = np.where(power > LEAST_POWER, ratio - 1.0, count)
                total = total + _PER_DEVIATION * deviation + _PER_LOST_SHARE * (1.0 - power / group[0].flat_reflectance)
        return np.asarray(total)

    def loss(self, values: list[Array], log_exposure: float) -> Loss:
        """Return the loss for the values (colours or efficiencies) of all groups of targets, with its derivatives."""
        adjoints, of_exposure = [], 0.0
        for group, value in zip(self.groups, values, strict=True):
            if group[0].kind == "colour":
                adjoint, slope = _colour_adjoint(group, value, log_exposure)
                of_exposure += slope
            else:
                adjoint = _order_adjoint(group[0], value)
            adjoints.append(adjoint)
        if self.has_colours:
            of_exposure += _PER_EXPOSURE
        return Loss(float(self.costs(values, log_exposure)), adjoints, of_exposure)

    def best_log_exposure(self, values: list[Array]) -> float:
        """Return the logarithm of the exposure (common factor of all colours) with the least loss, in steps of 0.1."""
        if not self.has_colours:
            return 0.0
        losses = [self.costs(values, log_exposure) for log_exposure in _LOG_EXPOSURES.tolist()]
        return float(_LOG_EXPOSURES[int(np.argmin(losses))])

    def objective(self, profile: Profile) -> Callable[[Array], tuple[float, Array]]:
        """Return a function that computes the loss and its gradient for a profile.

        The argument of the function contains the parameters of the profile and, as its last element, the logarithm of
        the exposure, the common factor of all colours.
        """

        def function(z: Array) -> tuple[float, Array]:
            values, pullback = self.values(profile.surface(z[:-1]), profile.wrt)
            loss = self.loss(values, float(z[-1]))
            return loss.value, np.append(profile.pullback(z[:-1], pullback(loss.adjoints)), loss.of_exposure)

        return function


def _colour_adjoint(group: list[Target], xyz: Array, log_exposure: float) -> tuple[Array, float]:
    """Return the derivatives of the sum of squared distances in CIE Lab between requested and achieved colours.

    The first result has the derivatives by XYZ, shape (n, 3). The second is the derivative by the logarithm of the
    exposure, the common factor of all colours.
    """
    exposure = math.exp(log_exposure)
    requested = lab(np.stack([target.requested for target in group]))[0]
    labs, slopes = lab(exposure * xyz)
    by_exposed = np.einsum("ni,nij->nj", 2.0 * (labs - requested), slopes)
    return exposure * by_exposed, float((by_exposed * exposure * xyz).sum())


def _order_adjoint(target: Target, efficiencies: Array) -> Array:
    """Return the derivatives of a target's part of the loss by the efficiencies of its orders, shape (n,)."""
    count = len(efficiencies)
    if target.kind == "orders":
        scale = _PER_DEVIATION / (count * float(target.requested.mean()) ** 2)
        return np.asarray(2.0 * scale * (efficiencies - target.requested))
    power = max(float(efficiencies.sum()), LEAST_POWER)
    squares = float((efficiencies * efficiencies).sum())
    by_deviation = 2.0 * count * (efficiencies - squares / power) / power**2
    return np.asarray(_PER_DEVIATION * by_deviation - _PER_LOST_SHARE / target.flat_reflectance)


def places_of(target: Target, surface: HeightField | Outline) -> NDArray[np.int64]:
    """Return the indices of the orders of a target among those that propagate; raise an error for an evanescent one."""
    lattice = Relief.of(surface).lattice
    known, _ = propagating(lattice, target.to_light[None], np.array([target.wavelength_nm]))
    is_same = np.all(known == target.pairs[:, None], axis=2)
    if not (exists := is_same.any(axis=1)).all():
        absent, (size_y, size_x) = target.pairs[~exists][0], lattice.size_um
        raise ArgumentValueError(
            f"{ref('targets')} must be orders that propagate, got ({absent[0]}, {absent[1]}) at "
            f"{target.wavelength_nm:g} nm for a period of {size_y:g} × {size_x:g} µm (y × x): use a longer period, and "
            "order 0 along a constant axis"
        )
    return np.asarray(np.argmax(is_same, axis=1))


class silenced(warnings.catch_warnings):  # noqa: N801 (a context, like its base class)
    """Context that hides the library's warnings, which concern surfaces that are only tried and not the result."""

    def __enter__(self) -> None:
        """Ignore warnings."""
        super().__enter__()
        warnings.simplefilter("ignore", WarpdiffWarning)
