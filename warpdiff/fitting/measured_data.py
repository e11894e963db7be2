"""``Measured``: measured orders, spectra or colours, and the predictions that a fit compares with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.adjoint.linearised import Linearised
from warpdiff.adjoint.order_derivatives import order_efficiencies
from warpdiff.adjoint.spectral_derivatives import reflectance, spectral_reflectance
from warpdiff.adjoint.surfaces import Relief
from warpdiff.core import csv_columns, files, validation
from warpdiff.core.angles import direction
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref, renaming
from warpdiff.evaluate.orders import propagating
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import check_covers, check_reflection
from warpdiff.request.settings import Energy, check_energy

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.profiles.outline import Outline

    Array = NDArray[np.float64]

_LIGHT, _VIEW = ("light_theta_deg", "light_phi_deg"), ("view_theta_deg", "view_phi_deg")
# Names of the columns of CSV files with measured data, by the kind of data. Files that the results of this package save
# have the same names of columns.
COLUMNS = {
    "orders": (*_LIGHT, "wavelength_nm", "m_y", "m_x", "efficiency"),
    "spectra": (*_LIGHT, *_VIEW, "wavelength_nm", "relative_reflectance"),
    "colours": (*_LIGHT, *_VIEW, "X", "Y", "Z"),
}


# Efficiencies (reflected over incident power) above this value are probably in percent. An order reflects at most the
# incident power, so that its efficiency is at most 1. The margin of 0.5 allows for noise.
_LARGEST_EFFICIENCY = 1.5


class _Grid(NamedTuple):
    """Distinct rows of an array with a row per measured value, and the index of the distinct row of each value."""

    rows: Array
    which: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured values with the geometry and the optics at which they were measured.

    Attributes:
        kind: ``"orders"``, ``"spectra"`` or ``"colours"``.
        values: Measured values, shape (n,). X, Y and Z of a colour are three consecutive values.

    Examples:
        >>> import warpdiff as wd
        >>> measured = wd.Measured.orders((0, 0, 1), 550.0, [(0, -1), (0, 0), (0, 1)], [0.01, 0.02, 0.01])
        >>> measured
        Measured(orders, 3 values)
    """

    kind: str
    values: Array
    _predict: Callable[[HeightField | Outline, tuple[str, ...]], Linearised] = field(repr=False)

    def __repr__(self) -> str:
        return f"Measured({self.kind}, {len(self.values)} values)"

    def predict(self, surface: HeightField | Outline, wrt: tuple[str, ...] = ()) -> Linearised:
        """Return the values that would be measured on a surface, shape (n,), with their derivatives.

        Args:
            surface: Height field or outline.
            wrt: Names of the variables of the derivatives, as in ``warpdiff.adjoint``.
        """
        with renaming({"heightfield": "surface"}):
            return self._predict(surface, wrt)

    @classmethod
    def orders(
        cls, to_light: ArrayLike, wavelengths_nm: ArrayLike, orders: ArrayLike, efficiencies: ArrayLike, *,
        ior: float | None = None, material: Material | None = None, energy: Energy | None = None,
    ) -> Measured:  # fmt: skip
        """Return measured efficiencies of diffraction orders.

        Args:
            to_light: Directions to the light, shape (3,) or (n, 3).
            wavelengths_nm: Wavelength of each efficiency [nm], one number or shape (n,).
            orders: Pairs (m_y, m_x), shape (n, 2).
            efficiencies: Reflected power relative to the incident power, shape (n,). The prediction of an order that
                does not propagate is 0.
            ior: Index of refraction; None is 1.5 unless a material is given.
            material: Material of the surface.
            energy: ``"stam"`` or ``"normalised"``, as for :func:`warpdiff.order_efficiencies`.

        Warns:
            WarpdiffWarning: Efficiencies look like percent.

        Raises:
            ValueError: Shapes do not match, or an argument is out of its range.
        """
        values = _values(efficiencies, "efficiencies")
        if values.max() > _LARGEST_EFFICIENCY:
            warn(
                f"{ref('efficiencies')} must be at most about 1, got {values.max():g}: divide percent by 100, and "
                "powers by the incident power"
            )
        pairs = validation.finite_array(orders, "orders", ndim=2)
        if pairs.shape != (len(values), 2) or np.any(pairs != np.rint(pairs)):
            raise ArgumentValueError(f"{ref('orders')} must be integers of shape ({len(values)}, 2), got {pairs.shape}")
        lights = _grid(validation.unit_directions(to_light, "to_light")[0], len(values), "to_light")
        wavelengths = _wavelengths(wavelengths_nm, len(values))
        _check_optics(ior, material, wavelengths.rows)
        energy = None if energy is None else check_energy(energy)
        if lights.rows[:, 2].min() <= HORIZON:
            raise _below_horizon("to_light", lights.rows[:, 2])

        def predict(surface: HeightField | Outline, wrt: tuple[str, ...]) -> Linearised:
            known, views = propagating(Relief.of(surface).lattice, lights.rows, wavelengths.rows[:, 0])
            matches = np.all(known == pairs[:, None], axis=2)
            column = np.argmax(matches, axis=1)
            lives = matches.any(axis=1)
            if len(known):
                lives &= ~np.isnan(views[lights.which, wavelengths.which, column, 0])
            result = order_efficiencies(
                surface, lights.rows, wavelengths.rows[:, 0], wrt=wrt, ior=ior, material=material, energy=energy
            )
            return _picked(result, (lights.which, wavelengths.which, column), lives)

        return cls("orders", values, predict)

    @classmethod
    def spectra(
        cls, to_light: ArrayLike, to_view: ArrayLike, wavelengths_nm: ArrayLike, reflectances: ArrayLike, *,
        coherence: Coherence | None = None, ior: float | None = None, material: Material | None = None,
        masking: bool = True,
    ) -> Measured:  # fmt: skip
        """Return measured relative reflectances at angles and wavelengths.

        Args:
            to_light: Directions to the light, shape (3,) or (n, 3).
            to_view: Directions to the viewer, shape (3,) or (n, 3).
            wavelengths_nm: Wavelength of each reflectance [nm], one number or shape (n,).
            reflectances: Relative reflectances ρ, as in :func:`warpdiff.spectral_reflectance`, shape (n,).
            coherence: Coherence window or source; None is an averaged window of σ = 16.25 µm.
            ior: Index of refraction; None is 1.5 unless a material is given.
            material: Material of the surface.
            masking: Whether V-cavity masking is included.

        Raises:
            ValueError: Shapes do not match, or an argument is out of its range.
        """
        values = _values(reflectances, "reflectances")
        directions = _pairs(to_light, to_view, len(values))
        wavelengths = _wavelengths(wavelengths_nm, len(values))
        _check_optics(ior, material, wavelengths.rows, coherence=coherence, masking=masking)

        def predict(surface: HeightField | Outline, wrt: tuple[str, ...]) -> Linearised:
            result = spectral_reflectance(
                surface, directions.rows[:, :3], directions.rows[:, 3:], wavelengths.rows[:, 0], wrt=wrt,
                coherence=coherence, ior=ior, material=material, masking=masking,
            )  # fmt: skip
            return _picked(result, (directions.which, wavelengths.which), np.ones(len(values), dtype=bool))

        return cls("spectra", values, predict)

    @classmethod
    def colours(
        cls, to_light: ArrayLike, to_view: ArrayLike, xyz: ArrayLike, *, illuminant: str | Spectrum = "D65",
        coherence: Coherence | None = None, ior: float | None = None, material: Material | None = None,
        masking: bool = True,
    ) -> Measured:  # fmt: skip
        """Return measured colours at angles.

        Args:
            to_light: Directions to the light, shape (3,) or (n, 3).
            to_view: Directions to the viewer, shape (3,) or (n, 3).
            xyz: CIE XYZ, as in :func:`warpdiff.reflectance`, shape (n, 3).
            illuminant: Illuminant under which the colours were measured.
            coherence: Coherence window or source; None is an averaged window of σ = 16.25 µm.
            ior: Index of refraction; None is 1.5 unless a material is given.
            material: Material of the surface.
            masking: Whether V-cavity masking is included.

        Raises:
            ValueError: Shapes do not match, or an argument is out of its range.
        """
        values = validation.finite_array(xyz, "xyz", ndim=2, most=validation.MOST)
        if values.shape[1] != 3 or not values.size:
            raise ArgumentValueError(f"{ref('xyz')} must have shape (n, 3), got {values.shape}")
        directions = _pairs(to_light, to_view, len(values))
        colorimetry.check_illuminant(illuminant)
        _check_optics(ior, material, colorimetry.VISIBLE_NM, coherence=coherence, masking=masking)
        rows, columns = np.repeat(directions.which, 3), np.tile(np.arange(3), len(values))

        def predict(surface: HeightField | Outline, wrt: tuple[str, ...]) -> Linearised:
            result = reflectance(
                surface, directions.rows[:, :3], directions.rows[:, 3:], wrt=wrt, illuminant=illuminant,
                coherence=coherence, ior=ior, material=material, masking=masking,
            )  # fmt: skip
            return _picked(result, (rows, columns), np.ones(values.size, dtype=bool))

        return cls("colours", values.ravel(), predict)

    @classmethod
    def from_csv(
        cls, path: str | os.PathLike[str], *, illuminant: str | Spectrum = "D65", coherence: Coherence | None = None,
        ior: float | None = None, material: Material | None = None, masking: bool = True, energy: Energy | None = None,
    ) -> Measured:  # fmt: skip
        """Read measured data from a CSV file, whose first line names the columns.

        The columns determine the kind of the data. They are the columns of the tables that
        :class:`warpdiff.OrderEfficiencies` and :class:`warpdiff.ReflectanceSpectra` save; other columns are ignored.
        Separators are commas, semicolons or tabs. With semicolons and tabs, numbers may have decimal commas. Names of
        columns may have units in brackets, such as ``wavelength [µm]`` or ``efficiency (%)``, and cells may have
        percent signs. Empty lines and comments (#) are skipped.

        - orders: ``light_theta_deg``, ``light_phi_deg``, ``wavelength_nm``, ``m_y``, ``m_x``, ``efficiency``
        - spectra: ``light_theta_deg``, ``light_phi_deg``, ``view_theta_deg``, ``view_phi_deg``, ``wavelength_nm``,
          ``relative_reflectance``
        - colours: ``light_theta_deg``, ``light_phi_deg``, ``view_theta_deg``, ``view_phi_deg``, ``X``, ``Y``, ``Z``

        Args:
            path: Path of the file.
            illuminant: Illuminant of colours.
            coherence: Coherence of spectra and colours.
            ior: Index of refraction.
            material: Material of the surface.
            masking: Whether V-cavity masking is included in spectra and colours.
            energy: Energy of orders, ``"stam"`` or ``"normalised"``.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: Columns are missing, a cell is empty or not a number, or a line has too many cells.

        Examples:
            >>> import math
            >>> import warpdiff as wd
            >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
            >>> path = wd.order_efficiencies(grating, (0, 0, 1), 550.0).save("orders.csv")
            >>> wd.Measured.from_csv(path, ior=math.inf)
            Measured(orders, 7 values)
        """
        # All options are checked, also those that this kind of data does not use.
        _check_optics(ior, material, None, coherence=coherence, masking=masking, energy=energy)
        colorimetry.check_illuminant(illuminant)
        file = validation.path(path, "path")
        with files.describing(file):
            names = dict.fromkeys(name for columns in COLUMNS.values() for name in columns)
            columns = csv_columns.read(file, names)
            kinds = [kind for kind, required in COLUMNS.items() if set(required) <= set(columns)]
            if len(kinds) != 1:
                rule = "; ".join(f"{kind}: {', '.join(required)}" for kind, required in COLUMNS.items())
                raise ArgumentValueError(
                    f"{ref('path')} must have the columns of one kind of data ({rule}), got "
                    f"{', '.join(columns) or 'none of them'}"
                )
            (kind,) = kinds
            light = direction(columns[_LIGHT[0]], columns[_LIGHT[1]])
            if kind == "orders":
                pairs = np.stack([columns["m_y"], columns["m_x"]], axis=1)
                return cls.orders(
                    light, columns["wavelength_nm"], pairs, columns["efficiency"], ior=ior, material=material,
                    energy=energy,
                )  # fmt: skip
            view = direction(columns[_VIEW[0]], columns[_VIEW[1]])
            if kind == "spectra":
                return cls.spectra(
                    light, view, columns["wavelength_nm"], columns["relative_reflectance"], coherence=coherence,
                    ior=ior, material=material, masking=masking,
                )  # fmt: skip
            xyz = np.stack([columns[name] for name in "XYZ"], axis=1)
            return cls.colours(
                light, view, xyz, illuminant=illuminant, coherence=coherence, ior=ior, material=material,
                masking=masking,
            )  # fmt: skip


def _values(values: object, name: str) -> Array:
    """Return measured values as an array of shape (n,); raise an error if there is none."""
    array = validation.finite_array(values, name, ndim=1, most=validation.MOST)
    if not array.size:
        raise ArgumentValueError(f"{ref(name)} must have at least one value")
    return array


def _check_optics(
    ior: float | None, material: Material | None, wavelengths_nm: Array | None, *, coherence: Coherence | None = None,
    masking: bool = True, energy: Energy | None = None,
) -> None:  # fmt: skip
    """Raise an error before a fit starts if a material, an index of refraction or a coherence is invalid.

    ``wavelengths_nm`` is None if the wavelengths are not known yet.
    """
    check_reflection(ior, material)
    if material is not None and wavelengths_nm is not None:
        check_covers(material, float(wavelengths_nm.min()), float(wavelengths_nm.max()))
    validation.instance(coherence, Coherence, "coherence", optional=True)
    validation.flag(masking, "masking")
    if energy is not None:
        check_energy(energy)


def _below_horizon(name: str, heights: Array) -> Exception:
    """Return the error for directions of which at least one is not above the horizon; ``heights`` are z components."""
    return ArgumentValueError(
        f"{ref(name)} must be above the horizon (z > 0), got z = {heights.min():.3g} after normalisation: nothing is "
        "measured there; remove the value"
    )


def _grid(rows: Array, count: int, name: str) -> _Grid:
    """Return the distinct rows of an array, and for each measured value the index of its row.

    A row contains the directions or the wavelength of a measured value. ``rows`` has one row per measured value, or one
    row for all values.
    """
    if len(rows) not in (1, count):
        raise ArgumentValueError(f"{ref(name)} must have one row, or one per value, {count}, got {len(rows)}")
    distinct, index = np.unique(np.broadcast_to(rows, (count, rows.shape[1])), axis=0, return_inverse=True)
    return _Grid(distinct, index.ravel())


def _wavelengths(wavelengths_nm: ArrayLike, count: int) -> _Grid:
    return _grid(colorimetry.check_wavelengths(wavelengths_nm)[:, None], count, "wavelengths_nm")


def _pairs(to_light: ArrayLike, to_view: ArrayLike, count: int) -> _Grid:
    lights, views, _ = validation.light_and_view(to_light, to_view)
    for name, directions in (("to_light", lights), ("to_view", views)):
        if len(directions) and directions[:, 2].min() <= HORIZON:
            raise _below_horizon(name, directions[:, 2])
    return _grid(np.concatenate([lights, views], axis=1), count, "to_view")


def _picked(result: Linearised, places: tuple[NDArray[np.int64], ...], exists: NDArray[np.bool_]) -> Linearised:
    """Return selected elements of computed values and of their derivatives, one element per measured value.

    Args:
        result: Array of computed values with its derivatives, as functions of ``warpdiff.adjoint`` return it.
        places: Indices of the elements, one index per measured value along each axis of the array.
        exists: Whether each element exists. An element that does not exist, such as an evanescent order, is 0.
    """
    value, vjp, jvp = result

    def adjoint(adjoint_of_value: ArrayLike) -> dict[str, Array]:
        array = validation.finite_array(adjoint_of_value, "adjoint_of_value")
        if array.shape != exists.shape:
            raise ArgumentValueError(
                f"{ref('adjoint_of_value')} must have the shape of the value, {exists.shape}, got {array.shape}"
            )
        full = np.zeros(value.shape)
        np.add.at(full, places, np.where(exists, array, 0.0))
        return vjp(full)

    def tangent(**changes: ArrayLike) -> Array:
        return np.where(exists, jvp(**changes)[places], 0.0)

    return Linearised(np.where(exists, value[places], 0.0), adjoint, tangent)
