"""``Measured``: measured orders, spectra or colours, and the predictions that a fit compares with them."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, get_args

import numpy as np

from warpdiff.adjoint.linearised import Linearised
from warpdiff.adjoint.order_derivatives import order_efficiencies
from warpdiff.adjoint.spectral_derivatives import reflectance, spectral_reflectance
from warpdiff.adjoint.surfaces import Relief
from warpdiff.core import files, validation
from warpdiff.core.angles import direction
from warpdiff.core.wording import ArgumentValueError, ref, renaming
from warpdiff.evaluate.orders import propagating
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import check_covers, check_reflection
from warpdiff.request.settings import Energy

if TYPE_CHECKING:
    import os
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.profiles.outline import Outline

    Array = NDArray[np.float64]

_LIGHT, _VIEW = ("light_theta_deg", "light_phi_deg"), ("view_theta_deg", "view_phi_deg")
# Columns of the CSV files, which are those of the tables of results, by the kind of data.
COLUMNS = {
    "orders": (*_LIGHT, "wavelength_nm", "m_y", "m_x", "efficiency"),
    "spectra": (*_LIGHT, *_VIEW, "wavelength_nm", "relative_reflectance"),
    "colours": (*_LIGHT, *_VIEW, "X", "Y", "Z"),
}


class _Grid(NamedTuple):
    """Distinct rows of an array, and the index of each row among them."""

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
        """Return the values that a surface would have, shape (n,), with their derivatives.

        Args:
            surface: Height field or outline.
            wrt: Variables of the derivatives, as in ``warpdiff.adjoint``.
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
            efficiencies: Reflected power relative to the incident power, shape (n,).
            ior: Index of refraction; None is 1.5 unless a material is given.
            material: Material of the surface.
            energy: ``"stam"`` or ``"normalised"``, as for :func:`warpdiff.order_efficiencies`.

        Raises:
            ValueError: Shapes do not match, or an argument is out of its range.
        """
        values = _values(efficiencies, "efficiencies")
        pairs = validation.finite_array(orders, "orders", ndim=2)
        if pairs.shape != (len(values), 2) or np.any(pairs != np.rint(pairs)):
            raise ArgumentValueError(f"{ref('orders')} must be integers of shape ({len(values)}, 2), got {pairs.shape}")
        lights = _grid(validation.unit_directions(to_light, "to_light")[0], len(values), "to_light")
        wavelengths = _wavelengths(wavelengths_nm, len(values))
        _check_optics(ior, material, wavelengths.rows, energy=energy)
        if lights.rows[:, 2].min() <= HORIZON:
            raise ArgumentValueError(f"{ref('to_light')} must be above the horizon (z > 0)")

        def predict(surface: HeightField | Outline, wrt: tuple[str, ...]) -> Linearised:
            known, _ = propagating(Relief.of(surface).lattice, lights.rows, wavelengths.rows[:, 0])
            matches = np.all(known == pairs[:, None], axis=2)
            result = order_efficiencies(
                surface, lights.rows, wavelengths.rows[:, 0], wrt=wrt, ior=ior, material=material, energy=energy
            )
            # An order that is evanescent everywhere has no power.
            places = (lights.which, wavelengths.which, np.argmax(matches, axis=1))
            return _picked(result, places, matches.any(axis=1))

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
            reflectances: ρ as of :func:`warpdiff.spectral_reflectance`, shape (n,).
            coherence: Window or source; None is an averaged window of σ = 16.25 µm.
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
            xyz: CIE XYZ as of :func:`warpdiff.reflectance`, shape (n, 3).
            illuminant: Illuminant under which the colours were measured.
            coherence: Window or source; None is an averaged window of σ = 16.25 µm.
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

        The columns decide the kind of the data. They are those of the tables that
        :class:`warpdiff.OrderEfficiencies` and :class:`warpdiff.ReflectanceSpectra` save; others are ignored.

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
            energy: Energy of orders.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: Columns are missing, or a cell is not a number.

        Examples:
            >>> import math
            >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
            >>> path = wd.order_efficiencies(grating, (0, 0, 1), 550.0).save("orders.csv")
            >>> wd.Measured.from_csv(path, ior=math.inf)
            Measured(orders, 7 values)
        """
        # Options that the kind of the data does not use are checked, too.
        validation.instance(coherence, Coherence, "coherence", optional=True)
        validation.flag(masking, "masking")
        colorimetry.check_illuminant(illuminant)
        if energy is not None:
            validation.choice(energy, "energy", get_args(Energy))
        file = validation.path(path, "path")
        with files.describing(file):
            return cls._of_columns(
                _columns(file), illuminant=illuminant, coherence=coherence, ior=ior, material=material,
                masking=masking, energy=energy,
            )  # fmt: skip

    @classmethod
    def _of_columns(
        cls, columns: dict[str, Array], *, illuminant: str | Spectrum, coherence: Coherence | None, ior: float | None,
        material: Material | None, masking: bool, energy: Energy | None,
    ) -> Measured:  # fmt: skip
        """Return the measured data in the columns of a file, whose names decide the kind of the data."""
        kind = next((kind for kind, names in COLUMNS.items() if set(names) <= set(columns)), None)
        if kind is None:
            wanted_columns = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in COLUMNS.items())
            raise ArgumentValueError(
                f"{ref('path')} must have the columns of one kind of data ({wanted_columns}), got {', '.join(columns)}"
            )
        light = direction(columns[_LIGHT[0]], columns[_LIGHT[1]])
        if kind == "orders":
            pairs = np.stack([columns["m_y"], columns["m_x"]], axis=1)
            return cls.orders(
                light, columns["wavelength_nm"], pairs, columns["efficiency"], ior=ior, material=material, energy=energy
            )
        view = direction(columns[_VIEW[0]], columns[_VIEW[1]])
        if kind == "spectra":
            return cls.spectra(
                light, view, columns["wavelength_nm"], columns["relative_reflectance"], coherence=coherence, ior=ior,
                material=material, masking=masking,
            )  # fmt: skip
        xyz = np.stack([columns[name] for name in "XYZ"], axis=1)
        return cls.colours(
            light, view, xyz, illuminant=illuminant, coherence=coherence, ior=ior, material=material, masking=masking
        )


def _values(values: object, name: str) -> Array:
    """Return measured values, at least one, as an array of shape (n,)."""
    array = validation.finite_array(values, name, ndim=1, most=validation.MOST)
    if not array.size:
        raise ArgumentValueError(f"{ref(name)} must have at least one value")
    return array


def _check_optics(
    ior: float | None, material: Material | None, wavelengths_nm: Array, *, coherence: Coherence | None = None,
    masking: bool = True, energy: Energy | None = None,
) -> None:  # fmt: skip
    """Raise an error for invalid optics, before a fit starts."""
    check_reflection(ior, material)
    if material is not None:
        check_covers(material, float(wavelengths_nm.min()), float(wavelengths_nm.max()))
    validation.instance(coherence, Coherence, "coherence", optional=True)
    validation.flag(masking, "masking")
    if energy is not None:
        validation.choice(energy, "energy", get_args(Energy))


def _columns(path: Path) -> dict[str, Array]:
    """Return the numeric columns of a CSV file by their names."""
    if not path.is_file():
        raise FileNotFoundError(f"path: {str(path)!r} is not a file")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ArgumentValueError(f"{ref('path')}: {str(path)!r} is not a CSV file: {error}") from None
    known = {name for names in COLUMNS.values() for name in names}
    result = {}
    for name in rows[0] if rows else ():
        if name in known:
            try:
                result[name] = np.array([float(row[name]) for row in rows])
            except (TypeError, ValueError):
                result[name] = np.array([np.nan])
            if not np.isfinite(result[name]).all():
                raise ArgumentValueError(f"{ref('path')}: column {name!r} must contain finite numbers in each row")
    return result


def _grid(rows: Array, count: int, name: str) -> _Grid:
    """Return the distinct rows of an array with one row per value, or with one row for all values."""
    if len(rows) not in (1, count):
        raise ArgumentValueError(f"{ref(name)} must have one row, or one per value, {count}, got {len(rows)}")
    distinct, index = np.unique(np.broadcast_to(rows, (count, rows.shape[1])), axis=0, return_inverse=True)
    return _Grid(distinct, index.ravel())


def _wavelengths(wavelengths_nm: ArrayLike, count: int) -> _Grid:
    return _grid(colorimetry.check_wavelengths(wavelengths_nm)[:, None], count, "wavelengths_nm")


def _pairs(to_light: ArrayLike, to_view: ArrayLike, count: int) -> _Grid:
    lights, views, _ = validation.light_and_view(to_light, to_view)
    return _grid(np.concatenate([lights, views], axis=1), count, "to_view")


def _picked(result: Linearised, places: tuple[NDArray[np.int64], ...], exists: NDArray[np.bool_]) -> Linearised:
    """Return elements of a linearised value as a linearised vector; elements that do not exist are 0."""
    value, vjp, jvp = result

    def adjoint(adjoints: ArrayLike) -> dict[str, Array]:
        full = np.zeros(value.shape)
        np.add.at(full, places, np.where(exists, adjoints, 0.0))
        return vjp(full)

    def tangent(**changes: ArrayLike) -> Array:
        return np.where(exists, jvp(**changes)[places], 0.0)

    return Linearised(np.where(exists, value[places], 0.0), adjoint, tangent)
