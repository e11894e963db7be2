"""Order efficiencies with exact derivatives, and the warnings about points where they have none.

κ = w/λ, where w is the normal component of the scattering vector and λ the wavelength. θ is the angle of an order from
the normal. The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity. A kink is a
point at which a function is continuous and its derivative is not.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval

from warpdiff.adjoint.coefficient_rows import CoefficientRows, add_rows
from warpdiff.adjoint.linearised import linearised
from warpdiff.adjoint.order_model import OrderModel
from warpdiff.adjoint.reflection import index_of
from warpdiff.adjoint.series_length import kappa_range, term_count
from warpdiff.adjoint.sites import Sites
from warpdiff.adjoint.surfaces import Relief
from warpdiff.adjoint.variables import available, check_variables, differentiable
from warpdiff.core import memory, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.diffraction import energy_normalisation
from warpdiff.evaluate.orders import energy_or_default, propagating
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import check_covers, check_reflection
from warpdiff.request.settings import Energy  # noqa: TC001 (its values are described at run time)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.adjoint.linearised import Derivatives, Linearised
    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import Material
    from warpdiff.profiles.outline import Outline

# Truncation error of the series of Fourier coefficients from which order efficiencies are computed. It equals the
# rounding errors of float64.
_TRUNCATION = 1e-13
# Cosine of the angle θ of an order from the normal below which the order counts as being at the horizon; it is then
# within 0.06° of the horizon, and the user is warned. Efficiencies are proportional to 1/cos θ there, and their
# derivatives to 1/cos³ θ, so that derivatives are valid for tiny changes only.
_AT_HORIZON = 1e-3
# Names of the variables of derivatives whose change moves diffraction orders across the horizon.
_MOVING = ("pitch_um", "period_um", "to_light", "wavelengths_nm")
# Names of the variables of derivatives that have one element per wavelength.
_PER_WAVELENGTH = ("wavelengths_nm", "n", "k")
# Memory of a call [bytes]: per height sample, and per element of the matrices of efficiencies. Each wavelength has a
# matrix with one row per direction to the light and one column per order.
_BYTES_PER_SAMPLE, _BYTES_PER_ELEMENT = 120.0, 250.0


class _OrderCall:
    """Orders and Fourier coefficients for all lights and wavelengths of one call of ``order_efficiencies``."""

    def __init__(
        self, relief: Relief, lights: NDArray[np.float64], wavelengths: NDArray[np.float64], *, normalised: bool,
        ior: float, material: Material | None,
    ) -> None:  # fmt: skip
        """Find the diffraction orders that propagate, and compute their Fourier coefficients."""
        orders, views = propagating(relief.lattice, lights, wavelengths)
        self._lives = ~np.isnan(views[..., 0])
        self._relief, self._lights, self._wavelengths = relief, lights, wavelengths
        self._check_count(normalised=normalised)
        self._models = {
            (light, column): OrderModel(
                lights[light], orders[self._lives[light, column]], float(wavelengths[column]), relief.size_um,
                (relief.shape[0] == 1, relief.shape[1] == 1), normalised=normalised, ior=ior, material=material,
            )
            for light in range(len(lights)) for column in range(len(wavelengths))
        }  # fmt: skip
        kappas = np.concatenate([model.kappas for model in self._models.values()])
        low, high = kappa_range(float(kappas.min()), float(kappas.max()), relief.scale_um)
        terms = term_count(2.0 * math.pi * high * relief.scale_um, _TRUNCATION)
        count = term_count(2.0 * math.pi * (high - low) * relief.scale_um, _TRUNCATION)
        sites = Sites(relief.shape, *np.concatenate([model.indices for model in self._models.values()]).T)
        needed = _BYTES_PER_SAMPLE * relief.samples + sites.count * (32.0 * terms + 48.0 * count)
        memory.require_memory(needed, f"a gradient by {sites.count} coefficients", "take {share} of its area")
        self._rows = CoefficientRows(sites.count, (low, high), count, powers=True, together=relief.sites_together)
        with single_threaded_blas():
            self._terms = relief.terms(sites, self._rows.nodes, terms)
            self._rows.fill(self._terms)
        ends = np.cumsum([len(model.kappas) for model in self._models.values()])[:-1]
        self._places = dict(zip(self._models, np.split(sites.places, ends), strict=True))

    def value(self) -> NDArray[np.float64]:
        """Return the order efficiencies, shape (lights, wavelengths, orders); 0 where an order does not propagate."""
        result = np.zeros(self._lives.shape)
        for place, model in self._models.items():
            rows = self._rows.rows[0][self._places[place]]
            polynomials, slopes = self._rows.polynomials(model.kappas), self._rows.slopes(model.kappas)
            powers, of_kappa = (np.einsum("pk,pk->p", rows, basis) for basis in (polynomials, slopes))
            result[place][self._lives[place]] = model.value(powers, of_kappa)
        return result

    @single_threaded_blas()
    def adjoint(self, adjoints: NDArray[np.float64], names: tuple[str, ...]) -> Derivatives:
        """Return the adjoints of the variables ``names`` from the adjoints of the efficiencies.

        An adjoint is the derivative of a scalar loss. That of the k directions to the light has the shape (k, 3).
        """
        result = {name: np.zeros(self._shape(name)) for name in names}
        rows = self._rows.empty(zero=True)
        is_surface = self._relief.variable in names
        for place, model in self._models.items():
            own = adjoints[place][self._lives[place]]
            for name, index, slope in self._slopes(place, names):
                result[name][index] += slope @ own
            if is_surface:
                factors = model.power_adjoints(own)[:, None]
                add_rows(self._places[place], factors * self._rows.polynomials(model.kappas), rows[0])
        if is_surface:
            result[self._relief.variable] = self._terms.adjoint(self._rows.adjoint(self._terms, rows))
        return result

    @single_threaded_blas()
    def tangent(self, changes: Derivatives) -> NDArray[np.float64]:
        """Return the changes of the order efficiencies, to first order, for changes of variables by their names."""
        result = np.zeros(self._lives.shape)
        names = tuple(changes)
        rows = None
        if self._relief.variable in changes:
            rows = self._rows.tangent(self._terms, self._terms.tangent(changes[self._relief.variable]))[0]
        for place, model in self._models.items():
            own = np.zeros(int(self._lives[place].sum()))
            for name, index, slope in self._slopes(place, names):
                own += np.atleast_1d(changes[name].reshape(self._shape(name))[index]) @ slope
            if rows is not None:
                basis = self._rows.polynomials(model.kappas)
                own += model.power_tangent(np.einsum("pk,pk->p", rows[self._places[place]], basis))
            result[place][self._lives[place]] = own
        return result

    def _shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a variable's array, such as (lights, 3) for directions, and (1,) for a single number."""
        shapes = {
            "to_light": (len(self._lights), 3), "pitch_um": (2,), self._relief.variable: self._relief.variable_shape,
        }  # fmt: skip
        return shapes.get(name, (len(self._wavelengths) if name in _PER_WAVELENGTH else 1,))

    def _slopes(
        self, place: tuple[int, int], names: tuple[str, ...]
    ) -> Iterator[tuple[str, slice | int, NDArray[np.float64]]]:
        """Yield the derivatives of the n efficiencies of one light and wavelength with respect to each variable.

        ``place`` has the indices of the light and of the wavelength. Each result is the name of a variable, the indices
        of its p elements on which these efficiencies depend, and the derivatives, shape (p, n).
        """
        others = [name for name in names if name != self._relief.variable]
        if not others:
            return
        slopes, (light, column) = self._models[place].slopes(), place
        for name in others:
            if name == "to_light":
                unit = self._lights[light]
                project = (np.eye(3) - np.outer(unit, unit))[:, :2]
                yield name, light, project @ np.stack([slopes["light_x"], slopes["light_y"]])
            elif name == "pitch_um":
                lengths = np.stack([slopes["length_y"], slopes["length_x"]])
                yield name, slice(None), lengths * np.reshape(self._relief.shape, (2, 1))
            elif name == "wavelengths_nm":
                yield name, slice(column, column + 1), 1e-3 * slopes["wavelength_um"][None]
            elif name == "period_um":
                yield name, slice(None), slopes["length_x"][None]
            else:
                index = slice(column, column + 1) if name in _PER_WAVELENGTH else slice(None)
                yield name, index, slopes[name][None]

    def _check_count(self, *, normalised: bool) -> None:
        """Raise an error for too many normalised orders, or if efficiency matrices require more memory than is free."""
        most = int(self._lives.sum(axis=-1).max())
        if normalised and most > energy_normalisation.MOST_EXACT:
            raise ArgumentValueError(
                f"{ref('energy', 'normalised')} has derivatives for at most {energy_normalisation.MOST_EXACT} orders, "
                f"because factors of more orders are interpolated on a grid; {most} propagate: use "
                f"{ref('energy', 'stam')}, or a smaller {ref('heightfield')}"
            )
        sets = self._lives.shape[0] * self._lives.shape[1]
        memory.require_memory(
            _BYTES_PER_ELEMENT * sets * most * (most if normalised else 1), f"derivatives of {sets} sets of orders",
            "take {share} of the wavelengths and directions at a time",
        )  # fmt: skip

    def warn_of_kinks(self) -> None:
        """Warn if an order at some light and wavelength is at the horizon, or just below it, where derivatives jump."""
        lattice, count = self._relief.lattice, 0
        for light, wavelength_um in itertools.product(self._lights, 1e-3 * self._wavelengths):
            tangents2 = np.zeros((1, 1))
            for axis, (length, samples) in enumerate(zip(lattice.size_um, lattice.shape, strict=True)):
                component = light[1 - axis]
                first, last = ((component + end) * length / wavelength_um for end in (-1.0, 1.0))
                orders = np.arange(math.floor(first), math.ceil(last) + 1) if samples > 1 else np.zeros(1)
                tangents2 = tangents2 + ((orders * wavelength_um / length - component) ** 2).reshape(
                    (-1, 1) if axis == 0 else (1, -1)
                )
            count += bool(np.any(np.abs(1.0 - tangents2) < _AT_HORIZON**2))
        if count:
            warn(
                f"{count} of {len(self._models)} sets of orders have an order at the horizon, where efficiencies have "
                f"a kink: derivatives by {', '.join(_MOVING)} are those of the orders that propagate"
            )


@differentiable
def order_efficiencies(
    heightfield: HeightField | Outline, to_light: ArrayLike, wavelengths_nm: ArrayLike, *,
    wrt: Sequence[str] = ("heights_um",), ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None,
    material: Material | None = None, energy: Energy | None = None,
) -> Linearised:  # fmt: skip
    """Return the efficiencies of :func:`warpdiff.order_efficiencies` with exact derivatives, in float64.

    Derivatives of normalised efficiencies follow from the equations of the energy balance by implicit differentiation.

    Args:
        heightfield: One period of the surface: a height field, or an outline, whose Fourier coefficients are exact.
        to_light: Directions to the light in the local frame, above the horizon, shape (3,) or (k, 3).
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        wrt: Names of the variables of the derivatives: ``"heights_um"`` and ``"pitch_um"`` of a height field,
            ``"vertices"`` and ``"period_um"`` of an outline, ``"height_scale"``, ``"to_light"``, ``"ior"``, ``"n"``,
            ``"k"``, ``"film_nm"`` or ``"wavelengths_nm"``, by default the heights.
        ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
        material: Material of the surface instead of ``ior``.
        energy: ``"stam"`` or ``"normalised"``, for at most 600 orders. None normalises metals and perfect mirrors.

    Returns:
        Efficiencies, shape (m, n), or (k, m, n) for several lights, with their derivatives. The n orders are those of
        :func:`warpdiff.order_efficiencies`, in the same sequence.

    Warns:
        WarpdiffWarning: An order is at the horizon and ``wrt`` has variables that move it, a wavelength is at a kink of
            the index of refraction, or the energy balance has not converged.

    Raises:
        ValueError: An argument is out of its range, a variable has no derivative, or normalised orders are too many.
        MemoryError: The call requires more memory than is free.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> efficiencies, vjp, _ = wd.adjoint.order_efficiencies(grating, (0, 0, 1), 550.0, wrt=("pitch_um", "ior"))
        >>> efficiencies.round(4)
        array([[0.    , 0.0008, 0.0095, 0.0196, 0.0095, 0.0008, 0.    ]])
        >>> adjoints = vjp([[0, 0, 0, 0, 1, 0, 0]])
        >>> print(f"order 1 grows by {adjoints['ior']:.4f} per unit of the index")
        order 1 grows by 0.0303 per unit of the index
    """
    relief = Relief.of(heightfield)
    lights, is_single = validation.unit_directions(to_light, "to_light")
    if not len(lights) or lights[:, 2].min() <= HORIZON:
        raise ArgumentValueError(f"{ref('to_light')} must be above the horizon (z > 0), got {to_light!r}")
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    normal, _ = check_reflection(ior, material)
    if material is not None:
        check_covers(material, float(wavelengths.min()), float(wavelengths.max()))
    names = check_variables(
        "order_efficiencies", wrt,
        available("order_efficiencies", ior=ior, material=material, is_outline=relief.is_outline),
    )  # fmt: skip
    normalised = energy_or_default(energy, normal, material) == "normalised"
    call = _OrderCall(relief, lights, wavelengths, normalised=normalised, ior=index_of(ior), material=material)
    if set(names) & set(_MOVING):
        call.warn_of_kinks()
    if material is not None and "wavelengths_nm" in names:
        _warn_of_table(material, wavelengths)
    value = call.value()
    shape = value.shape[1:] if is_single else value.shape
    per_nm, lengths = (len(wavelengths),), validation.lengths(to_light)
    shapes = dict.fromkeys(_PER_WAVELENGTH, per_nm) | {
        relief.variable: relief.variable_shape,
        "pitch_um": (2,),
        "to_light": np.shape(to_light),
    }

    def adjoint(adjoints: NDArray[np.float64]) -> Derivatives:
        result = call.adjoint(adjoints.reshape(value.shape), names)
        if "to_light" in result:
            result["to_light"] = result["to_light"] / lengths
        return result

    def tangent(changes: Derivatives) -> NDArray[np.float64]:
        if "to_light" in changes:
            changes = changes | {"to_light": np.atleast_2d(changes["to_light"]) / lengths}
        return call.tangent(changes).reshape(shape)

    return linearised(value.reshape(shape), {name: shapes.get(name, ()) for name in names}, adjoint, tangent)


def _warn_of_table(material: Material, wavelengths_nm: NDArray[np.float64]) -> None:
    """Warn of wavelengths at table entries of the index of refraction, where the interpolated index has a kink."""
    # The first and the last entry of a table of refractive indices are no kinks, because the index is not known beyond
    # them.
    tables = [np.asarray(part.wavelengths_nm)[1:-1] for part in (material, material.film) if part is not None]
    count = int(np.isin(wavelengths_nm, np.concatenate(tables)).sum())
    if count:
        warn(
            f"{count} of {len(wavelengths_nm)} wavelengths are entries of the table of {ref('material')}, where its "
            "index has a kink: derivatives by wavelengths_nm are those towards longer wavelengths"
        )
