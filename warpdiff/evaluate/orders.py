"""Efficiencies of the diffraction orders of a periodic height field, relative to the incident power.

A grating reflects the share η = R(θd) (1 + ωi·ωr)² |H|² / (cos θi cos θr w²) of the incident power into an order. The
share is the absolute BRDF (Stam 1999) without a window, integrated over the order. Each order has its own w, and
therefore requires H at its own κ = w/λ. FFTs are computed at a few κ only, and H is interpolated between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval

from warpdiff.core import memory, validation
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


# Relative deviation of the sum of all Stam efficiencies from the reflected power above which a call warns. Limit: nine
# in ten of the gratings with a larger deviation have an order that is wrong by more than a tenth of the reflected
# power.
_MOST_DEVIATION = 0.2
# Smallest reflectance of a flat surface by which a sum over orders is divided. That of an antireflective film may be 0
# up to rounding.
_LEAST_REFLECTANCE = 1e-12
# Measured memory of a call [bytes]: per height sample; per order and wavelength; and per order and term of the
# polynomials that interpolate over κ.
_BYTES_A_SAMPLE, _BYTES_A_LINE, _BYTES_A_TERM = 100, 120, 16


@dataclass(frozen=True, eq=False)
class OrderEfficiencies:
    """Efficiencies of diffraction orders; indexing by ``[m_y, m_x]`` gives those of one order, shape (m,).

    Attributes:
        wavelengths_nm: Wavelengths [nm], shape (m,).
        orders: Pairs (m_y, m_x) of all orders that propagate at one wavelength or more, shape (n, 2), sorted.
        to_view: Unit vectors ωr of the reflected orders, shape (m, n, 3); NaN where an order is evanescent.
        efficiencies: Reflected power of each order relative to the incident power, shape (m, n); 0 where an order is
            evanescent.
        verdict: Verdict on how wrong scalar diffraction may be for the height field and the light, at the worst of the
            wavelengths.

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
    orders: NDArray[np.int64]
    to_view: NDArray[np.float64]
    efficiencies: NDArray[np.float64]
    verdict: TheoryVerdict

    def __repr__(self) -> str:
        low, high = self.wavelengths_nm.min(), self.wavelengths_nm.max()
        wavelengths = f"{len(self.wavelengths_nm)} wavelengths, {low:g} to {high:g} nm"
        return f"OrderEfficiencies({len(self.orders)} orders, {wavelengths})"

    def __getitem__(self, order: tuple[int, int]) -> NDArray[np.float64]:
        """Return the efficiency of order (m_y, m_x) at each wavelength, shape (m,); 0 for evanescent orders."""
        pair = [validation.count(m, "order", least=-(2**31)) for m in order]
        return np.asarray(self.efficiencies[:, np.all(self.orders == pair, axis=1)].sum(axis=1))


@checked
def order_efficiencies(
    heightfield: HeightField, to_light: ArrayLike, wavelengths_nm: ArrayLike, *,
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None, material: Material | None = None,
    energy: Energy | None = None,
) -> OrderEfficiencies:  # fmt: skip
    """Return the absolute efficiencies of all propagating orders of an infinitely repeated height field, in float64.

    The direction of order (m_y, m_x) follows from the grating equation sin θi + sin θr = mλ/L: the x and y components
    of ωi + ωr are m_x λ/Lx and m_y λ/Ly. The amplitude of the order is the Fourier coefficient r = −m_x, s = −m_y of
    exp(2πiκh). Masking is not included. In scalar theory the sum of the efficiencies is R only approximately, and
    exceeds it for short periods at grazing angles.

    ``energy="normalised"`` multiplies the efficiencies by a(ωi) a(ωr). The factors a make the orders of a perfect
    mirror sum to 1 for every direction (Sinkhorn 1967). The result is reciprocal, and closer to rigorous solutions for
    mirrors and metals.
    Orders within 5.7° of the horizon have a smaller weight, down to 0 at the horizon, so that efficiencies are
    continuous where an order begins to propagate.

    Args:
        heightfield: One period of the surface; a constant axis, which has a single sample, has order 0 only.
        to_light: Direction to the light in the local frame, above the horizon, shape (3,).
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
        material: Material of the surface instead of ``ior``.
        energy: ``"stam"`` (Stam 1999) or ``"normalised"``. None normalises metals and perfect mirrors, which transmit
            no light, and uses Stam's efficiencies for other surfaces.

    Returns:
        Orders, their directions and efficiencies, and the verdict on them.

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
    light = validation.unit_directions(validation.vector(to_light, "to_light"), "to_light")[0]
    if light[0, 2] <= HORIZON:
        raise ArgumentValueError(f"{ref('to_light')} must be above the horizon (z > 0), got {to_light!r}")
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    normal, material = check_reflection(ior, material)
    if material is not None:
        check_covers(material, float(wavelengths.min()), float(wavelengths.max()))
    if energy is None:
        energy = "normalised" if (normal == 1.0 if material is None else material.is_opaque) else "stam"
    # An order m propagates only if |mλ/L − c| < 1 along each axis, where c is the component of ωi along the axis. This
    # limits the orders at the shortest wavelength. Pairs are in the order (y, x).
    ranges = []
    for length, n, component in zip(heightfield.size_um, heightfield.shape, light[0, 1::-1], strict=True):
        most_orders = length / (np.min(wavelengths, initial=math.inf) * 1e-3) if n > 1 else 0.0
        ranges.append((math.ceil((component - 1.0) * most_orders), math.floor((component + 1.0) * most_orders) + 1))
    samples, lines = heightfield.shape[0] * heightfield.shape[1], math.prod(end - begin for begin, end in ranges)
    terms = _term_count(math.pi * heightfield.height_range_um / (np.min(wavelengths, initial=math.inf) * 1e-3))
    memory.require_memory(
        _BYTES_A_SAMPLE * samples + lines * (_BYTES_A_LINE * len(wavelengths) + _BYTES_A_TERM * terms),
        f"a cell of {heightfield.shape[0]} × {heightfield.shape[1]} samples with {lines} orders at "
        f"{len(wavelengths)} wavelengths",
        "take at most {share} of the area, or fewer wavelengths at a time",
    )
    orders = np.stack(np.meshgrid(*(np.arange(*bounds) for bounds in ranges), indexing="ij"), axis=-1).reshape(-1, 2)
    tangential = orders[:, ::-1] * (wavelengths[:, None, None] * 1e-3 / heightfield.size_um[::-1]) - light[0, :2]
    upward = 1.0 - np.sum(tangential**2, axis=-1)
    lives = upward > HORIZON**2
    propagates = lives.any(axis=0)
    orders, tangential = orders[propagates], tangential[:, propagates]
    upward, lives = upward[:, propagates], lives[:, propagates]
    _warn_of_aliasing(heightfield, orders)
    to_view = np.full((*lives.shape, 3), np.nan)
    to_view[lives] = np.column_stack([tangential[lives], np.sqrt(upward[lives])])
    efficiencies = np.zeros(lives.shape)
    energy_sums = np.ones(len(wavelengths))
    for row, wavelength in enumerate(wavelengths * 1e-3):
        live = lives[row]
        views = to_view[row, live]
        lights = np.broadcast_to(light, views.shape)
        powers = np.abs(_coefficients(heightfield, -orders[live], -(light[0, 2] + views[:, 2]) / wavelength)) ** 2
        mirrors = powers * reflectance_factors.gain(lights, views, normal=1.0, masking=False, per_light_cosine=True)
        stam = mirrors
        if energy == "normalised":
            mirrors = _normalised(heightfield, light[0], orders[live], views, mirrors, wavelength)
        if material is not None:
            scattering_vectors = np.concatenate([-lights - views, [[0.0, 0.0, -2.0 * light[0, 2]]]])
            reflected = reflectances(material, scattering_vectors, 1e3 * wavelength * np.ones(1))[:, 0]
        else:
            cosines = np.append(np.linalg.norm(lights + views, axis=1) / 2.0, light[0, 2])
            reflected = reflectance_factors.schlick(np.minimum(cosines, 1.0), normal)
        efficiencies[row, live] = reflected[:-1] * mirrors
        # The last entry of `reflected` is the reflectance of a flat surface for the same light.
        energy_sums[row] = np.sum(reflected[:-1] * stam) / max(reflected[-1], _LEAST_REFLECTANCE)
    is_opaque = normal == 1.0 if material is None else material.is_opaque
    verdict = _verdict(heightfield, wavelengths, energy_sums, conserves=energy == "normalised" and is_opaque)
    _warn_of_theory(verdict, energy_sums, energy=energy)
    return OrderEfficiencies(wavelengths, orders, to_view, efficiencies, verdict)


def _verdict(
    heightfield: HeightField, wavelengths_nm: NDArray[np.float64], energy_sums: NDArray[np.float64], *, conserves: bool
) -> TheoryVerdict:
    """Return the verdict with the largest error at three wavelengths of a call.

    They are the shortest, the longest, and the one at which the sum over orders deviates most from the reflected
    power.
    """
    rows = {np.argmin(wavelengths_nm), np.argmax(wavelengths_nm), np.argmax(np.abs(energy_sums - 1.0))}
    verdicts = (
        verdict_on(heightfield, float(wavelengths_nm[row]), conserves=conserves, energy_sum=float(energy_sums[row]))
        for row in sorted(rows)
    )
    return max(verdicts, key=lambda verdict: verdict.error)


def _warn_of_theory(verdict: TheoryVerdict, energy_sums: NDArray[np.float64], *, energy: Energy) -> None:
    """Warn if the verdict is invalid, or if Stam's efficiencies sum to much more or less than the reflected power."""
    worst = float(energy_sums[np.argmax(np.abs(energy_sums - 1.0))])
    if energy == "stam" and abs(worst - 1.0) > _MOST_DEVIATION:
        warn(f"scalar diffraction is {verdict} (the orders sum to {worst:.3g} times that power): {verdict.remedy}")
    elif verdict.grade == "invalid":
        warn(f"scalar diffraction is {verdict}: {verdict.remedy}")


def _normalised(
    heightfield: HeightField, light: NDArray[np.float64], orders: NDArray[np.int64], views: NDArray[np.float64],
    mirrors: NDArray[np.float64], wavelength_um: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the normalised efficiencies of a mirror's propagating orders for one light, from those of Stam, (n,)."""
    if len(orders) > energy_normalisation.MOST_EXACT:
        wavelength_nm = 1e3 * wavelength_um
        factors = energy_normalisation.factors_around(heightfield, wavelength_nm).risen(views, wavelength_nm)
        return np.asarray(mirrors * factors / (mirrors @ factors))
    # The energy normalisation balances a matrix of efficiencies. Its rows are all incident directions whose orders
    # leave in the same directions as those of the light: they differ from the light by whole orders. Its columns are
    # these outgoing directions.
    steps = wavelength_um / np.asarray(heightfield.size_um[::-1])
    shift_ranges = [
        range(-math.ceil(2.0 / step) - 1, math.ceil(2.0 / step) + 2) if n > 1 else range(1)
        for step, n in zip(steps, heightfield.shape[::-1], strict=True)
    ]
    shifts = np.stack(np.meshgrid(*shift_ranges, indexing="ij"), axis=-1).reshape(-1, 2)
    entering = light[:2] + shifts * steps
    upward = 1.0 - np.sum(entering**2, axis=1)
    lives = upward > HORIZON**2
    shifts, entering, cosines = shifts[lives], entering[lives], np.sqrt(upward[lives])
    indices = -(shifts[:, None, ::-1] + orders[None, :, :]).reshape(-1, 2)
    w = cosines[:, None] + views[:, 2]
    powers = np.abs(_coefficients(heightfield, indices, -w.ravel() / wavelength_um)).reshape(w.shape) ** 2
    matrix = powers * energy_normalisation.stam(cosines[:, None], views[:, 2], entering @ views[:, :2].T)
    rows, columns = energy_normalisation.rise(cosines), energy_normalisation.rise(views[:, 2])
    first, second = energy_normalisation.balanced(matrix, rows, columns)
    own = np.flatnonzero(~shifts.any(axis=1))[0]
    result = first[own] * second * matrix[own]
    # For a light near the horizon, the normalised orders sum to less than 1. The rest of its power goes to the mirror
    # direction, order 0.
    result[~orders.any(axis=1)] += 1.0 - rows[own]
    return np.asarray(result)


@single_threaded_blas()
def _coefficients(
    heightfield: HeightField, indices: NDArray[np.int64], kappas: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return Fourier coefficients H_rs(κ), each at its own κ, with an error of about 1e-13, shape (n,).

    A phase that all coefficients have in common is omitted. ``indices`` are the pairs (s, r), shape (n, 2), and
    ``kappas`` is the κ of each pair [1/µm], shape (n,).
    """
    heights = heightfield.heights_um - (heightfield.heights_um.max() + heightfield.heights_um.min()) / 2.0
    # The range of κ between which coefficients are interpolated. It is never empty, because the zeroth order always
    # propagates. Its least width of 1e-9 avoids a division by zero for a single order.
    middle, half = (kappas.max() + kappas.min()) / 2.0, max(np.ptp(kappas), 1e-9) / 2.0
    # Over this range of κ, exp(2πiκh) is a series of Chebyshev polynomials in κ, whose terms decrease fast beyond the
    # index `argument`.
    argument = math.pi * half * heightfield.height_range_um
    count = _term_count(argument)
    low, high = middle - half, middle + half
    weights = chebyshev.cardinals(kappas, low, high, count)
    rows, columns = (indices % heightfield.shape).T
    result = np.zeros(len(kappas), dtype=np.complex128)
    for node, weight in zip(chebyshev.nodes(low, high, count), weights.T, strict=True):
        spectra = np.fft.ifft2(np.exp(2j * math.pi * node * heights))
        result += weight * spectra[rows, columns]
    return result


def _term_count(argument: float) -> int:
    """Return the number of Chebyshev polynomials in g that represent exp(ixg) for |g| <= 1; ``argument`` is x."""
    return math.ceil(argument + 10.0 * math.cbrt(argument)) + 16


def _warn_of_aliasing(heightfield: HeightField, orders: NDArray[np.int64]) -> None:
    """Warn if orders propagate that the samples cannot represent: their power appears in lower orders (aliasing)."""
    for name, axis in (("y", 0), ("x", 1)):
        largest = int(np.max(np.abs(orders[:, axis]), initial=0))
        if 2 * largest > heightfield.shape[axis] > 1:
            warn(
                f"orders up to {largest} propagate along {name}, but {heightfield.shape[axis]} samples represent half "
                "as many: higher orders alias onto lower ones; scan at a finer pitch, or use HeightField.resampled() "
                "if the surface is smooth"
            )
