"""Efficiencies of the diffraction orders of a periodic height field, relative to the incident power.

A grating reflects the share η = R(θd) (1 + ωi·ωr)² |H|² / (cos θi cos θr w²) of the incident power into an order. ωi
and ωr are the unit vectors to the light and along the order, with the angles θi and θr from the normal, and θd is half
of the angle between ωi and ωr. R is the reflectance, H the Fourier coefficient of the order, and w the normal component
of −ωi − ωr. The share η is the absolute BRDF (Stam 1999) without a coherence window, integrated over the order. Orders
differ in w, so that the coefficient H of each order is required at a different κ = w/λ. FFTs are computed at a few κ
only, and H is interpolated between them.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Protocol

import numpy as np
from annotated_types import Interval

from warpdiff.core import memory, validation
from warpdiff.core.angles import angles_deg
from warpdiff.core.table import Table, save_table
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.diffraction import chebyshev, energy_normalisation
from warpdiff.heightfield.field import check_whole
from warpdiff.heightfield.theory_verdict import verdict_on
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import check_covers, check_reflection, reflectances
from warpdiff.request.settings import Energy  # noqa: TC001 (its values are described at run time)
from warpdiff.request.signatures import checked

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.heightfield.theory_verdict import TheoryVerdict
    from warpdiff.optics.materials import Material


# ``order_efficiencies`` warns if the sum of Stam's efficiencies deviates from the reflected power by more than this
# share of that power. The value was chosen from gratings with a larger deviation: nine in ten of them have an order
# whose efficiency differs from the rigorous solution by more than a tenth of the reflected power.
_MOST_DEVIATION = 0.2
# The sum of the efficiencies is divided by the reflectance of a flat surface. This reflectance counts as at least this
# number, because the reflectance of an antireflective film may be 0 up to rounding.
_LEAST_REFLECTANCE = 1e-12
# Measured memory of `order_efficiencies` [bytes]. `_BYTES_A_SAMPLE` is per height sample, and `_BYTES_A_LINE` is per
# order and wavelength. `_BYTES_A_TERM` is per order and per term of the polynomials that interpolate Fourier
# coefficients over κ = w/λ.
_BYTES_A_SAMPLE, _BYTES_A_LINE, _BYTES_A_TERM = 100, 120, 16
# Several directions to the light share Fourier transforms of the height field if their matrices for the energy
# normalisation (see ``_OrderMatrix``) have at most this number of elements in total. The value is limited by memory.
_MOST_TOGETHER = 100_000


@dataclass(frozen=True, eq=False)
class OrderEfficiencies:
    """Efficiencies of diffraction orders; the index ``[m_y, m_x]`` selects one order at all m wavelengths.

    Arrays of a call with k directions to the light have a leading axis of length k.

    Attributes:
        wavelengths_nm: Wavelengths [nm], shape (m,).
        to_light: Unit vector to the light, shape (3,), or unit vectors, shape (k, 3).
        orders: Pairs (m_y, m_x) of all orders that propagate for at least one wavelength and light, sorted, shape
            (n, 2).
        to_view: Unit vectors ωr of the reflected orders, shape (m, n, 3) or (k, m, n, 3); NaN where an order is
            evanescent.
        efficiencies: Reflected power of each order relative to the incident power, shape (m, n) or (k, m, n); 0 where
            an order is evanescent.
        verdict: Verdict on how wrong scalar diffraction may be for the height field, at the light and the wavelength
            with the largest expected error.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> orders = wd.order_efficiencies(grating, (0, 0, 1), 550.0)
        >>> orders
        OrderEfficiencies(7 orders, 1 wavelengths, 550 to 550 nm)
        >>> orders.orders.tolist()
        [[0, -3], [0, -2], [0, -1], [0, 0], [0, 1], [0, 2], [0, 3]]
    """

    wavelengths_nm: NDArray[np.float64]
    to_light: NDArray[np.float64]
    orders: NDArray[np.int64]
    to_view: NDArray[np.float64]
    efficiencies: NDArray[np.float64]
    verdict: TheoryVerdict

    def __repr__(self) -> str:
        low, high = self.wavelengths_nm.min(), self.wavelengths_nm.max()
        wavelengths = f"{len(self.wavelengths_nm)} wavelengths, {low:g} to {high:g} nm"
        lights = f", {len(self.to_light)} lights" if self.to_light.ndim > 1 else ""
        return f"OrderEfficiencies({len(self.orders)} orders, {wavelengths}{lights})"

    def __getitem__(self, order: tuple[int, int]) -> NDArray[np.float64]:
        """Return the efficiency of order (m_y, m_x) at m wavelengths, shape (m,), or for k lights, shape (k, m).

        The efficiency is 0 where the order is evanescent.
        """
        pair = validation.order(order)
        return np.asarray(self.efficiencies[..., np.all(self.orders == pair, axis=1)].sum(axis=-1))

    def table(self, count: int | None = None) -> Table:
        """Return a table with a row per light, wavelength and order that propagates.

        Columns with ``theta`` are angles of the light or of the order from the normal (0 to 90°). Columns with ``phi``
        are angles around the normal from the x axis (−180 to 180°). Further columns are the wavelength, the numbers
        (m_y, m_x) of the order, and the efficiency of the order.

        Args:
            count: Number of orders of each light and wavelength, at least 1; the strongest orders are selected. None
                selects all orders.

        Raises:
            ValueError: ``count`` is less than 1.

        Examples:
            >>> grating = wd.gratings.sinusoidal(1.0, 0.1)
            >>> print(wd.order_efficiencies(grating, (0, 0, 1), 600.0).table())
            light_theta_deg  light_phi_deg  wavelength_nm  m_y  m_x  view_theta_deg  view_phi_deg  efficiency
                          0              0            600    0   -1           36.87           180   0.0088...
                          0              0            600    0    0               0             0    0.022...
                          0              0            600    0    1           36.87             0   0.0088...
        """
        lights, views = np.atleast_2d(self.to_light), self.to_view.reshape(-1, *self.to_view.shape[-3:])
        values = self.efficiencies.reshape(views.shape[:-1])
        lives = ~np.isnan(views[..., 0])
        if count is not None:
            # `strongest` has the indices of the orders of each light and wavelength, by decreasing efficiency. The
            # indices that sort `strongest` are the ranks of the orders.
            strongest = np.argsort(np.where(lives, -values, np.inf), axis=-1, kind="stable")
            lives &= np.argsort(strongest, axis=-1) < validation.count(count, "count")
        light, wavelength, order = np.nonzero(lives)
        (light_theta, light_phi), (theta, phi) = angles_deg(lights), angles_deg(views[light, wavelength, order])
        return Table(
            {
                "light_theta_deg": light_theta[light], "light_phi_deg": light_phi[light],
                "wavelength_nm": self.wavelengths_nm[wavelength], "m_y": self.orders[order, 0],
                "m_x": self.orders[order, 1], "view_theta_deg": theta, "view_phi_deg": phi,
                "efficiency": values[light, wavelength, order],
            }
        )  # fmt: skip

    save = save_table


@checked
def order_efficiencies(
    heightfield: HeightField, to_light: ArrayLike, wavelengths_nm: ArrayLike, *,
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None, material: Material | None = None,
    energy: Energy | None = None,
) -> OrderEfficiencies:  # fmt: skip
    """Return the absolute efficiencies of all propagating orders of an infinitely repeated height field, in float64.

    The direction of order (m_y, m_x) follows from the grating equation sin θi + sin θr = mλ/L: the x and y components
    of ωi + ωr are m_x λ/Lx and m_y λ/Ly. Lx and Ly are the sides of the period. ωi and ωr are the unit vectors to the
    light and along the order. The amplitude of the order is the Fourier coefficient r = −m_x, s = −m_y of exp(2πiκh),
    where κ = w/λ and h is the height. Masking is not included. In scalar theory the sum of the efficiencies is only
    approximately the reflectance R, and exceeds R for short periods at grazing angles.

    ``energy="normalised"`` multiplies the efficiencies by a(ωi) a(ωr). The factors a make the orders of a perfect
    mirror sum to 1 for every direction (Sinkhorn 1967). The result is reciprocal. For mirrors and metals, it is closer
    to rigorous solutions than Stam's efficiencies are. The efficiencies of orders within 5.7° of the horizon are
    reduced, down to 0 at the horizon, so that the efficiencies of all orders are continuous where an order begins to
    propagate.

    Args:
        heightfield: One period of the surface; a constant axis, which has a single sample, has order 0 only.
        to_light: Directions to the light in the local frame, above the horizon, shape (3,) or (k, 3); with (k, 3) the
            arrays of the result have a leading axis.
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
        material: Material of the surface; give it instead of ``ior``.
        energy: ``"stam"`` (Stam 1999) or ``"normalised"``. None normalises metals and perfect mirrors, which transmit
            no light, and uses Stam's efficiencies for other surfaces.

    Returns:
        Orders, their directions and efficiencies, and a verdict on the accuracy of scalar diffraction for this call.

    Warns:
        WarpdiffWarning: Scalar diffraction is invalid for this call, or Stam's efficiencies sum to less than 0.8 or
            more than 1.2 times the reflected power.

    Raises:
        TypeError: ``heightfield`` is not a height field, or an argument is not numeric.
        ValueError: An argument is out of its range, samples are missing, or the light is not above the horizon.
        MemoryError: The call requires more memory than is free; the message states the area that fits.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> orders = wd.order_efficiencies(grating, (0, 0, 1), [450.0, 550.0])
        >>> orders[0, 1].round(4)
        array([0.0119, 0.0095])
    """
    check_whole(heightfield)
    lights, is_single = validation.unit_directions(to_light, "to_light")
    if not len(lights):
        raise ArgumentValueError(f"{ref('to_light')} must hold at least one direction, got shape {lights.shape}")
    if lights[:, 2].min() <= HORIZON:
        raise ArgumentValueError(f"{ref('to_light')} must be above the horizon (z > 0), got {to_light!r}")
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    normal, material = check_reflection(ior, material)
    if material is not None:
        check_covers(material, float(wavelengths.min()), float(wavelengths.max()))
    energy = energy_or_default(energy, normal, material)
    orders, to_view = propagating(heightfield, lights, wavelengths)
    lives = ~np.isnan(to_view[..., 0])
    _warn_of_aliasing(heightfield, orders)
    efficiencies = np.zeros(lives.shape)
    energy_sums = np.ones(lives.shape[:2])
    for column, wavelength in enumerate(wavelengths * 1e-3):
        # Indices of the light and of the order, for each pair of a light and an order that propagates at this
        # wavelength.
        which, order = np.nonzero(lives[:, column])
        entering, views = lights[which], to_view[which, column, order]
        kappas = -(entering[:, 2] + views[:, 2]) / wavelength
        powers = np.abs(_coefficients(heightfield, -orders[order], kappas)) ** 2
        mirrors = powers * reflectance_factors.gain(entering, views, normal=1.0, masking=False, per_light_cosine=True)
        stam = mirrors
        if energy == "normalised":
            mirrors = _normalised(heightfield, lights, which, orders[order], views, mirrors, wavelength)
        flat = -2.0 * lights * [0.0, 0.0, 1.0]
        if material is not None:
            scattering_vectors = np.concatenate([-entering - views, flat])
            reflected = reflectances(material, scattering_vectors, 1e3 * wavelength * np.ones(1))[:, 0]
        else:
            cosines = np.append(np.linalg.norm(entering + views, axis=1) / 2.0, lights[:, 2])
            reflected = reflectance_factors.schlick(np.minimum(cosines, 1.0), normal)
        # The array `reflected` consists of two parts. The first part has the reflectance for each pair of a light and
        # an order, and the second part has the reflectance of a flat surface for each light.
        reflected, of_flat = np.split(reflected, [len(order)])
        efficiencies[which, column, order] = reflected * mirrors
        sums = np.bincount(which, reflected * stam, len(lights))
        energy_sums[:, column] = sums / np.maximum(of_flat, _LEAST_REFLECTANCE)
    is_opaque = normal == 1.0 if material is None else material.is_opaque
    # For each wavelength, the verdict uses the light for which the sum of the efficiencies deviates most from the
    # reflected power.
    worst = np.argmax(np.abs(energy_sums - 1.0), axis=0)
    energy_sums = energy_sums[worst, np.arange(len(wavelengths))]
    verdict = _verdict(heightfield, wavelengths, energy_sums, conserves=energy == "normalised" and is_opaque)
    _warn_of_theory(verdict, energy_sums, energy=energy)
    if is_single:
        return OrderEfficiencies(wavelengths, lights[0], orders, to_view[0], efficiencies[0], verdict)
    return OrderEfficiencies(wavelengths, lights, orders, to_view, efficiencies, verdict)


class Periodic(Protocol):
    """Periodic surface, with the properties from which ``propagating`` computes the directions of its orders."""

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of samples (y, x); an axis with one sample is constant."""
        ...

    @property
    def size_um(self) -> tuple[float, float]:
        """Size of one period (y, x) [µm]."""
        ...

    @property
    def height_range_um(self) -> float:
        """Difference of the largest and the smallest height [µm]."""
        ...


def energy_or_default(energy: Energy | None, normal: float, material: Material | None) -> Energy:
    """Return the option ``energy``; None is replaced by ``"normalised"`` for an opaque surface, else by ``"stam"``.

    Without a material, a surface is opaque if ``normal``, its reflectance at normal incidence, is 1.
    """
    if energy is not None:
        return energy
    return "normalised" if (normal == 1.0 if material is None else material.is_opaque) else "stam"


def propagating(
    heightfield: Periodic, lights: NDArray[np.float64], wavelengths: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the orders that propagate for at least one light and wavelength, and their directions.

    Args:
        heightfield: One period of the surface.
        lights: Unit vectors to the lights, shape (k, 3).
        wavelengths: Wavelengths [nm], shape (m,).

    Returns:
        Pairs (m_y, m_x), shape (n, 2), and unit vectors of the orders, shape (k, m, n, 3), NaN where an order is
        evanescent.
    """
    # An order m propagates only if |mλ/L − c| < 1 along each axis. L is the length of the period along the axis, and c
    # is the component of the direction to the light along the axis. Most orders propagate at the shortest wavelength,
    # which therefore sets the ranges of m_y and m_x.
    ranges = []
    for length, n, components in zip(heightfield.size_um, heightfield.shape, lights[:, 1::-1].T, strict=True):
        most_orders = length / (np.min(wavelengths, initial=math.inf) * 1e-3) if n > 1 else 0.0
        ranges.append((
            math.ceil((components.min() - 1.0) * most_orders), math.floor((components.max() + 1.0) * most_orders) + 1
        ))  # fmt: skip
    samples, lines = heightfield.shape[0] * heightfield.shape[1], math.prod(end - begin for begin, end in ranges)
    terms = _term_count(math.pi * heightfield.height_range_um / (np.min(wavelengths, initial=math.inf) * 1e-3))
    memory.require_memory(
        _BYTES_A_SAMPLE * samples + len(lights) * lines * (_BYTES_A_LINE * len(wavelengths) + _BYTES_A_TERM * terms),
        f"a cell of {heightfield.shape[0]} × {heightfield.shape[1]} samples with {lines} orders at "
        f"{len(wavelengths)} wavelengths" + f" for {len(lights)} lights" * (len(lights) > 1),
        "take at most {share} of the area, or fewer wavelengths or lights at a time",
    )
    orders = np.stack(np.meshgrid(*(np.arange(*bounds) for bounds in ranges), indexing="ij"), axis=-1).reshape(-1, 2)
    steps = orders[:, ::-1] * (wavelengths[:, None, None] * 1e-3 / heightfield.size_um[::-1])
    # The x and y components of the orders' unit vectors, shape (lights, wavelengths, orders, 2).
    tangential = steps - lights[:, None, None, :2]
    upward = 1.0 - np.sum(tangential**2, axis=-1)
    lives = upward > HORIZON**2
    propagates = lives.any(axis=(0, 1))
    orders, tangential = orders[propagates], tangential[..., propagates, :]
    upward, lives = upward[..., propagates], lives[..., propagates]
    to_view = np.full((*lives.shape, 3), np.nan)
    to_view[lives] = np.column_stack([tangential[lives], np.sqrt(upward[lives])])
    return orders, to_view


def _verdict(
    heightfield: HeightField, wavelengths_nm: NDArray[np.float64], energy_sums: NDArray[np.float64], *, conserves: bool
) -> TheoryVerdict:
    """Return the verdict with the largest error, of the verdicts at three wavelengths.

    The three wavelengths are the shortest, the longest, and the one at which the sum of the efficiencies deviates most
    from the reflected power.
    """
    rows = {np.argmin(wavelengths_nm), np.argmax(wavelengths_nm), np.argmax(np.abs(energy_sums - 1.0))}
    verdicts = (
        verdict_on(heightfield, float(wavelengths_nm[row]), conserves=conserves, energy_sum=float(energy_sums[row]))
        for row in sorted(rows)
    )
    return max(verdicts, key=lambda verdict: verdict.error)


def _warn_of_theory(verdict: TheoryVerdict, energy_sums: NDArray[np.float64], *, energy: Energy) -> None:
    """Warn if scalar diffraction is invalid, or if the efficiencies do not sum to the reflected power.

    The sum of Stam's efficiencies may deviate from it by up to 20 % without a warning.
    """
    worst = float(energy_sums[np.argmax(np.abs(energy_sums - 1.0))])
    if energy == "stam" and abs(worst - 1.0) > _MOST_DEVIATION:
        warn(f"scalar diffraction is {verdict} (the orders sum to {worst:.3g} times that power): {verdict.remedy}")
    elif verdict.grade == "invalid":
        warn(f"scalar diffraction is {verdict}: {verdict.remedy}")


def _normalised(
    heightfield: HeightField, lights: NDArray[np.float64], which: NDArray[np.int64], orders: NDArray[np.int64],
    views: NDArray[np.float64], mirrors: NDArray[np.float64], wavelength_um: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Return normalised efficiencies of the orders of a perfect mirror, computed from Stam's efficiencies.

    Args:
        heightfield: One period of the surface.
        lights: Unit vectors to the lights, shape (k, 3).
        which: Index of the light that causes each order, increasing, shape (n,).
        orders: Pairs (m_y, m_x), shape (n, 2).
        views: Unit vectors of the orders, shape (n, 3).
        mirrors: Stam's efficiencies of the orders, shape (n,).
        wavelength_um: Wavelength [µm].

    Returns:
        Normalised efficiencies, shape (n,).
    """
    starts = np.searchsorted(which, np.arange(len(lights) + 1))
    parts = [slice(begin, end) for begin, end in itertools.pairwise(starts.tolist())]
    result = np.empty(len(which))
    matrices: list[_OrderMatrix] = []
    for light, part in zip(lights, parts, strict=True):
        if part.stop - part.start > energy_normalisation.MOST_EXACT:
            wavelength_nm = 1e3 * wavelength_um
            factors = energy_normalisation.factors_around(heightfield, wavelength_nm)
            weights = factors.risen(views[part], wavelength_nm)
            result[part] = mirrors[part] * weights / (mirrors[part] @ weights)
        else:
            matrices.append(_OrderMatrix(heightfield, light, part, orders[part], views[part], wavelength_um))
        # The matrices of order efficiencies of many directions to the light share one set of Fourier transforms of the
        # height field, which saves time.
        if matrices and (part is parts[-1] or sum(matrix.size for matrix in matrices) > _MOST_TOGETHER):
            indices = np.concatenate([matrix.indices for matrix in matrices])
            w = np.concatenate([matrix.w.ravel() for matrix in matrices])
            powers = np.abs(_coefficients(heightfield, indices, -w / wavelength_um)) ** 2
            ends = np.cumsum([matrix.size for matrix in matrices])[:-1]
            for matrix, own in zip(matrices, np.split(powers, ends), strict=True):
                result[matrix.part] = matrix.efficiencies(own)
            matrices = []
    return result


class _OrderMatrix:
    """Matrix of a perfect mirror's efficiencies for one light; the energy normalisation scales its rows and columns.

    Columns of the matrix are the outgoing directions of the light's orders. Rows are all incident directions whose
    orders have the same outgoing directions; one of these incident directions is the light.

    Attributes:
        part: Slice of the orders of this light in the list of the orders of all lights.
        indices: Pair (s, r) of the Fourier coefficient of each element, shape (rows · columns, 2).
        w: Sum of the cosines of the incident and the outgoing direction of each element, shape (rows, columns).
    """

    def __init__(
        self, heightfield: HeightField, light: NDArray[np.float64], part: slice, orders: NDArray[np.int64],
        views: NDArray[np.float64], wavelength_um: float,
    ) -> None:  # fmt: skip
        steps = wavelength_um / np.asarray(heightfield.size_um[::-1])
        shift_ranges = [
            range(-math.ceil(2.0 / step) - 1, math.ceil(2.0 / step) + 2) if n > 1 else range(1)
            for step, n in zip(steps, heightfield.shape[::-1], strict=True)
        ]
        shifts = np.stack(np.meshgrid(*shift_ranges, indexing="ij"), axis=-1).reshape(-1, 2)
        entering = light[:2] + shifts * steps
        upward = 1.0 - np.sum(entering**2, axis=1)
        lives = upward > HORIZON**2
        shifts, self._entering, self._cosines = shifts[lives], entering[lives], np.sqrt(upward[lives])
        self._own = np.flatnonzero(~shifts.any(axis=1))[0]
        self._is_mirror, self._views, self.part = ~orders.any(axis=1), views, part
        self.indices = -(shifts[:, None, ::-1] + orders[None, :, :]).reshape(-1, 2)
        self.w = self._cosines[:, None] + views[:, 2]

    @property
    def size(self) -> int:
        """Number of elements of the matrix, rows times columns."""
        return int(self.w.size)

    def efficiencies(self, powers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the normalised efficiencies of the light's orders, for a perfect mirror.

        ``powers`` are the squared magnitudes |H|² of the Fourier coefficients of all elements, shape (rows · columns,).
        """
        cosines, views = self._cosines, self._views
        stam = energy_normalisation.stam(cosines[:, None], views[:, 2], self._entering @ views[:, :2].T)
        matrix = powers.reshape(self.w.shape) * stam
        rows, columns = energy_normalisation.rise(cosines), energy_normalisation.rise(views[:, 2])
        first, second = energy_normalisation.balanced(matrix, rows, columns)
        result = first[self._own] * second * matrix[self._own]
        # If the light is near the horizon, the normalised orders sum to less than 1. The remaining power of the light
        # goes to the mirror direction, which is order 0.
        result[self._is_mirror] += 1.0 - rows[self._own]
        return np.asarray(result)


@single_threaded_blas()
def _coefficients(
    heightfield: HeightField, indices: NDArray[np.int64], kappas: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return n Fourier coefficients H_rs(κ), each at its own κ = w/λ, with an error of about 1e-13, shape (n,).

    Heights are measured from the middle of their range. This changes the phase of the coefficients, but not their
    power. ``indices`` are the pairs (s, r), shape (n, 2), and ``kappas`` is the κ of each pair [1/µm], shape (n,).
    """
    heights = heightfield.heights_um - (heightfield.heights_um.max() + heightfield.heights_um.min()) / 2.0
    # Centre and half of the width of the range of κ = w/λ in which Fourier coefficients are interpolated. The width is
    # at least 1e-9, because a single order has only one κ, and a width of 0 would cause a division by zero.
    middle, half = (kappas.max() + kappas.min()) / 2.0, max(np.ptp(kappas), 1e-9) / 2.0
    # In this range of κ = w/λ, exp(2πiκh) is a series of Chebyshev polynomials in κ. The terms of this series decrease
    # fast from the index `argument` on. The required number of terms is therefore computed from `argument`.
    argument = math.pi * half * heightfield.height_range_um
    count = _term_count(argument)
    low, high = middle - half, middle + half
    weights = chebyshev.cardinals(kappas, low, high, count)
    rows, columns = (indices % heightfield.shape).T
    result = np.zeros(len(kappas), dtype=np.complex128)
    field = np.empty(heights.shape, dtype=np.complex128)
    for node, weight in zip(chebyshev.nodes(low, high, count), weights.T, strict=True):
        # Separate cosines and sines require half of the time of a complex exponential.
        phases = 2.0 * math.pi * node * heights
        np.cos(phases, out=field.real)
        np.sin(phases, out=field.imag)
        spectra = np.fft.ifft2(field)
        result += weight * spectra[rows, columns]
    return result


def _term_count(argument: float) -> int:
    """Return the number of Chebyshev polynomials in g that represent exp(ixg) for |g| <= 1 and x = ``argument``."""
    return math.ceil(argument + 10.0 * math.cbrt(argument)) + 16


def _warn_of_aliasing(heightfield: HeightField, orders: NDArray[np.int64]) -> None:
    """Warn if orders propagate that the height samples cannot represent; their power aliases to lower orders."""
    for name, axis in (("y", 0), ("x", 1)):
        largest = int(np.max(np.abs(orders[:, axis]), initial=0))
        if 2 * largest > heightfield.shape[axis] > 1:
            warn(
                f"orders up to {largest} propagate along {name}, but {heightfield.shape[axis]} samples represent half "
                "as many: higher orders alias onto lower ones; scan at a finer pitch, or use HeightField.resampled() "
                "if the surface is smooth"
            )
