"""``rigorous_order_efficiencies``: efficiencies of the orders of one-dimensional gratings by Maxwell's equations.

Coupled-wave analysis expands the electric and magnetic fields as Fourier series with the orders (harmonics) −N to N.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval

from warpdiff.core import validation
from warpdiff.core.angles import angles_deg
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.table import Table, save_table
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref, renaming
from warpdiff.evaluate.orders import propagating
from warpdiff.heightfield.field import check_whole
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import DEFAULT_IOR, Material, check_covers, check_reflection, index_at
from warpdiff.request.signatures import checked
from warpdiff.rigorous import coupled_waves

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField

    Array = NDArray[np.float64]

# The number N of harmonics, the orders of the Fourier series of the fields, is doubled until the efficiency of no
# diffraction order changes by more than `_CHANGE`, a fraction of the incident power. For periods above `_LONG_PERIOD`
# wavelengths, which have many weak orders, the limit is `_CHANGE_OF_LONG_PERIODS`. Both limits were chosen as the
# accuracy of published tables of efficiencies.
_CHANGE, _CHANGE_OF_LONG_PERIODS, _LONG_PERIOD = 5e-3, 1e-2, 20.0
# Least difference between the index of a material and that of air, 1. A surface with a smaller difference reflects
# nothing, and the equations of the solver may be singular.
_LIKE_AIR = 1e-9
# The solver begins with N harmonics of the fields. N is `_FIRST` times the highest diffraction order that propagates,
# plus `_BEYOND`. Both were chosen because with fewer harmonics, the first doubling of N always changes the efficiencies
# too much.
_FIRST, _BEYOND = 1.25, 6
# Largest component of the unit vector to the light along the grooves that counts as 0. The value is limited by rounding
# errors.
ACROSS = 1e-9


@dataclass(frozen=True, eq=False)
class RigorousEfficiencies:
    """Rigorous efficiencies of the reflected orders; the index ``[m_y, m_x]`` selects one order at all m wavelengths.

    Attributes:
        wavelengths_nm: Wavelengths [nm], shape (m,).
        to_light: Unit vector to the light, shape (3,).
        orders: Pairs (0, m_x) of the orders that propagate at one wavelength at least, sorted, shape (n, 2).
        to_view: Unit vectors of the orders, shape (m, n, 3); NaN where an order is evanescent.
        efficiencies: Reflected power relative to the incident power, for unpolarised light, the mean of both
            polarisations, shape (m, n).
        efficiencies_s: Efficiencies for s polarisation, with the electric field along the grooves, shape (m, n).
        efficiencies_p: Efficiencies for p polarisation, with the magnetic field along the grooves, shape (m, n).
        harmonics: Largest order N of the Fourier series of the fields, at each wavelength, shape (m,).
        changes: Largest change of an efficiency in the last doubling of ``harmonics``, relative to the incident power,
            shape (m,); infinite where ``max_harmonics`` permits no doubling.
        converged: Whether ``changes`` is at most 5e-3, or 1e-2 for periods above 20 wavelengths, shape (m,).

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.lamellar(1.0, 0.05, samples=16)
        >>> orders = wd.rigorous_order_efficiencies(grating, (0, 0, 1), 600.0)  # doctest: +SKIP
        >>> orders  # doctest: +SKIP
        RigorousEfficiencies(3 orders, 1 wavelengths, converged at 1)
    """

    wavelengths_nm: Array
    to_light: Array
    orders: NDArray[np.int64]
    to_view: Array
    efficiencies: Array
    efficiencies_s: Array
    efficiencies_p: Array
    harmonics: NDArray[np.int64]
    changes: Array
    converged: NDArray[np.bool_]

    def __repr__(self) -> str:
        count = len(self.wavelengths_nm)
        return (
            f"RigorousEfficiencies({len(self.orders)} orders, {count} wavelengths, converged at {self.converged.sum()})"
        )

    def __getitem__(self, order: tuple[int, int]) -> Array:
        """Return the efficiency of order (m_y, m_x) for unpolarised light, shape (m,); 0 where it is evanescent."""
        pair = validation.order(order)
        return np.asarray(self.efficiencies[:, np.all(self.orders == pair, axis=1)].sum(axis=-1))

    def table(self) -> Table:
        """Return a table of angles, efficiencies and convergence, with a row for each propagating order and wavelength.

        Examples:
            >>> grating = wd.gratings.lamellar(1.0, 0.05, samples=16)
            >>> wd.rigorous_order_efficiencies(grating, (0, 0, 1), 600.0).table().columns.keys()  # doctest: +SKIP
            dict_keys(['wavelength_nm', 'm_y', 'm_x', 'view_theta_deg', ..., 'harmonics', 'change', 'converged'])
        """
        wavelength, order = np.nonzero(~np.isnan(self.to_view[..., 0]))
        theta, phi = angles_deg(self.to_view[wavelength, order])
        return Table(
            {
                "wavelength_nm": self.wavelengths_nm[wavelength], "m_y": self.orders[order, 0],
                "m_x": self.orders[order, 1], "view_theta_deg": theta, "view_phi_deg": phi,
                "efficiency": self.efficiencies[wavelength, order],
                "efficiency_s": self.efficiencies_s[wavelength, order],
                "efficiency_p": self.efficiencies_p[wavelength, order], "harmonics": self.harmonics[wavelength],
                "change": self.changes[wavelength], "converged": self.converged[wavelength],
            }
        )  # fmt: skip

    save = save_table


@checked
def rigorous_order_efficiencies(
    heightfield: HeightField, to_light: ArrayLike, wavelengths_nm: ArrayLike, *,
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None, material: Material | None = None,
    layers: int = 24, max_harmonics: int = 256, progress: Progress = None,
) -> RigorousEfficiencies:  # fmt: skip
    """Return the efficiencies of the reflected orders of a one-dimensional grating by coupled-wave analysis.

    The package meent solves Maxwell's equations for both polarisations (extra ``rigorous``). Before each use it must
    reproduce the reflectance of a flat surface. The fields are Fourier series with 2N + 1 harmonics. N is doubled until
    no efficiency changes by more than 5e-3 of the incident power, or 1e-2 for periods above 20 wavelengths. A result
    that has not converged is returned with a warning.

    The time of each wavelength is proportional to the number of layers and to the cube of N: a second for a period of
    three wavelengths, and one to two minutes for a period of fifty wavelengths.

    Args:
        heightfield: One period with a single row of samples, constant along y. The height is constant from each sample
            to the next one, so that walls are vertical.
        to_light: Direction to the light, perpendicular to the grooves (y = 0), above the horizon, shape (3,).
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        ior: Index of refraction of a transparent material; None is 1.5 unless a material is given.
        material: Material of the surface instead of ``ior``, without a film.
        layers: Largest number of layers into which the relief is cut, 1 to 1000, by default 24. A relief with more
            different heights becomes a staircase.
        max_harmonics: Largest N, the order of the Fourier series of the fields, 8 to 2000, by default 256.
        progress: Function that is called with the finished fraction, 0 to 1; True shows a progress bar.

    Returns:
        Efficiencies for both polarisations and their mean, with the convergence at each wavelength.

    Warns:
        WarpdiffWarning: The orders of some wavelengths have not converged.

    Raises:
        ValueError: An argument is out of its range, the field has several rows, the light is not perpendicular to the
            grooves, or the material is a perfect mirror or has a film.
        ImportError: meent is not installed: ``pip install 'warpdiff[rigorous]'``.
        RuntimeError: The installed meent does not reproduce the reflectance of a flat surface.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.lamellar(1.0, 0.05, samples=16)
        >>> aluminium = wd.Material.metal("Al")
        >>> rigorous = wd.rigorous_order_efficiencies(grating, (0, 0, 1), 600.0, material=aluminium)  # doctest: +SKIP
        >>> rigorous[0, 1].round(2)  # doctest: +SKIP
        array([0.2...])
    """
    check_whole(heightfield)
    if heightfield.shape[0] != 1:
        raise ArgumentValueError(
            f"{ref('heightfield')} must have a single row, a grating that is constant along y, got "
            f"{heightfield.shape[0]} rows: two-dimensional reliefs have no rigorous solution here"
        )
    unit, is_single = validation.unit_directions(to_light, "to_light")
    if not is_single or unit[0, 2] <= HORIZON or abs(unit[0, 1]) > ACROSS:
        raise ArgumentValueError(
            f"{ref('to_light')} must be one direction (x, 0, z) above the horizon, perpendicular to the grooves, got "
            f"{to_light!r:.60}"
        )
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    substance = _substance(ior, material, wavelengths)
    most = validation.count(layers, "layers", most=1000)
    limit = validation.count(max_harmonics, "max_harmonics", least=8, most=2000)
    report = reporter(progress, "rigorous")
    coupled_waves.load_meent()
    orders, views = propagating(heightfield, unit, wavelengths)
    if np.abs(orders[:, 1]).max(initial=0) + _BEYOND > limit:
        raise ArgumentValueError(
            f"{ref('max_harmonics')} must be at least {np.abs(orders[:, 1]).max() + _BEYOND} for the orders that "
            f"propagate, got {limit}: increase it, or use a shorter period"
        )
    angle = math.atan2(unit[0, 0], unit[0, 2])
    relief = coupled_waves.layers_of(heightfield.heights_um[0], most)
    indices = index_at(substance, wavelengths)
    if (like_air := np.abs(indices - 1.0) < _LIKE_AIR).any():
        raise ArgumentValueError(
            f"{ref('ior' if material is None else 'material')} must have an index that differs from that of air, got 1 "
            f"at {wavelengths[like_air][0]:g} nm: omit this wavelength"
        )
    parts: list[tuple[Array, Array, int, float, bool]] = []
    for column, wavelength in enumerate(wavelengths.tolist()):
        index = complex(indices[column])
        coupled_waves.check_on_a_flat_surface(substance, index, wavelength, angle)
        own = orders[~np.isnan(views[0, column, :, 0]), 1]
        grating = (*relief, heightfield.size_um[1])
        parts.append(_converged(grating, 1e-3 * wavelength, angle, index, own, limit))
        if report is not None:
            report((column + 1.0) / len(wavelengths))
    results = np.zeros((2, len(wavelengths), len(orders)))
    for column, (s, p, *_) in enumerate(parts):
        lives = ~np.isnan(views[0, column, :, 0])
        results[:, column, lives] = s, p
    harmonics, changes, converged = (np.array([part[k] for part in parts]) for k in (2, 3, 4))
    if not converged.all():
        _warn_of_harmonics(harmonics, changes, converged)
    return RigorousEfficiencies(
        wavelengths, unit[0], orders, views[0], results.mean(axis=0), results[0], results[1], harmonics, changes,
        converged,
    )  # fmt: skip


def _warn_of_harmonics(harmonics: NDArray[np.int64], changes: Array, converged: NDArray[np.bool_]) -> None:
    """Warn of wavelengths without convergence; state how much efficiencies changed when N was last doubled."""
    once, twice = ~converged & np.isinf(changes), ~converged & np.isfinite(changes)
    reasons = []
    if twice.any():
        reasons.append(
            f"{int(twice.sum())} changed by up to {changes[twice].max():.2g} in the last doubling to "
            f"{harmonics[twice].max()} harmonics; increase {ref('max_harmonics')} to at least "
            f"{2 * harmonics[twice].max()}"
        )
    if once.any():
        reasons.append(
            f"{int(once.sum())} were computed once, with {harmonics[once].max()} harmonics: {ref('max_harmonics')} "
            f"permits no doubling; increase it to at least {2 * harmonics[once].max()}"
        )
    warn(
        f"orders of {int(np.sum(~converged))} of {len(converged)} wavelengths have not converged: {'; '.join(reasons)}"
    )


def _substance(ior: float | None, material: Material | None, wavelengths: Array) -> Material:
    """Return the material of a surface, after checks that the solver supports it."""
    normal, substance = check_reflection(ior, material)
    if substance is None:
        if normal == 1.0:
            raise ArgumentValueError(
                f"{ref('ior', math.inf)} is a perfect mirror, which has no layers: give a metal as {ref('material')}"
            )
        with renaming({"n": "ior"}):
            return Material.dielectric(DEFAULT_IOR if ior is None else ior)
    if substance.film is not None:
        raise ArgumentValueError(f"{ref('material')} must have no film, got {substance}: use its substrate")
    check_covers(substance, float(wavelengths.min()), float(wavelengths.max()))
    return substance


def _converged(
    grating: tuple[list[NDArray[np.bool_]], list[float], float], wavelength_um: float, angle_rad: float, index: complex,
    orders: NDArray[np.int64], limit: int,
) -> tuple[Array, Array, int, float, bool]:  # fmt: skip
    """Double the number of harmonics until the efficiencies of a grating converge.

    Args:
        grating: Layers, their thicknesses [µm] and the period [µm], as for `coupled_waves.solve`.
        wavelength_um: Wavelength [µm].
        angle_rad: Angle of incidence [rad].
        index: Complex index of refraction of the material.
        orders: Orders m_x that propagate, shape (n,).
        limit: Largest number N of harmonics.

    Returns:
        Efficiencies for s and for p polarisation, shape (n,) each, the last N, the largest change of an efficiency in
        the last doubling, and whether this change is small enough for convergence.
    """
    masks, thicknesses, period = grating
    most = _CHANGE_OF_LONG_PERIODS if period > _LONG_PERIOD * wavelength_um else _CHANGE
    harmonics = min(max(int(_FIRST * np.abs(orders).max()) + _BEYOND, 8), limit)
    last: Array | None = None
    change = math.inf
    while True:
        both = np.stack([
            coupled_waves.solve(
                masks, thicknesses, period, wavelength_um=wavelength_um, angle_rad=angle_rad, index=index,
                polarisation=polarisation, harmonics=harmonics,
            ).reflected[orders + harmonics]
            for polarisation in (0, 1)
        ])  # fmt: skip
        if last is not None:
            change = float(np.abs(both - last).max())
        if change <= most or 2 * harmonics > limit:
            return both[0], both[1], harmonics, change, change <= most
        last, harmonics = both, 2 * harmonics
