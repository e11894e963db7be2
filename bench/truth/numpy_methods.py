"""NumPy implementations of the methods that the stability suite compares.

The methods are series expansions in float32 and float64, sums over wavelengths at fixed steps, and sums over fixed
numbers of neighbouring Fourier coefficients. The coefficients are computed by ``fourier_coefficients`` and
``phase_series`` of ``warpdiff.diffraction``. The sums over coefficients are computed here, in NumPy.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. |P|² is the power that the surface diffracts
into a direction, relative to a flat mirror in its mirror direction.
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np

import warpdiff as wd
from bench.truth import coherent_sums, reference
from bench.truth.errors import FLOOR, reference_luminance
from warpdiff.diffraction import fourier_coefficients
from warpdiff.diffraction.phase_series import EXPANSIONS, MAX_TERMS
from warpdiff.optics import colorimetry

SERIES = ("taylor-uncentred", "taylor", "jacobi-anger")
METHODS = (*SERIES, "power", "low-rank")
# Number of terms of the Taylor series in the publication (Single 2014), n = 0 … 36.
PUBLISHED_TERMS = 37
# Exponent at which the Gaussian of a coherence window is truncated. The value was derived from the rounding error
# of float64, because exp(−36) is 2e-16.
DEPTH = 36.0
# Luminance below which the library treats a direction as dark, relative to the luminance of a mirror.
DARK = 1e-10
# Largest number of values in a temporary array. The value is limited by memory.
CHUNK = 1 << 21


def best_effort(call, *args, **keywords):
    """Return the result of a library call, even if it cannot meet its tolerance."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        return call(*args, **keywords, strict=False)


def outcome(call, *args, **keywords):
    """Call a function of the library; return the result, and the text of its error or of its warnings.

    The result is None after an error. The text is empty if there is neither an error nor a warning.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", wd.WarpdiffWarning)
        # Warnings about the limits of scalar diffraction are ignored, because here only errors of the computation are
        # measured.
        warnings.filterwarnings("ignore", "scalar diffraction is", wd.WarpdiffWarning)
        try:
            result = call(*args, **keywords)
        except ValueError as error:
            return None, str(error)
    return result, "; ".join(
        str(warning.message) for warning in caught if issubclass(warning.category, wd.WarpdiffWarning)
    )


# Error measures of colours and spectra.


def percentile_99(errors):
    """Return the 99th percentile; infinity if the percentile lies at or between values that are infinite or NaN."""
    finite = np.where(np.isfinite(errors), errors, np.inf)
    with np.errstate(invalid="ignore"):
        percentile = float(np.percentile(finite, 99.0))
    return math.inf if math.isnan(percentile) else percentile


def colour_error(xyz, truth):
    """Return the 99th percentile of ‖ΔXYZ‖ / max(‖XYZ‖, f), with a floor f of luminance; both arguments are (n, 3)."""
    floor = max(FLOOR * reference_luminance(truth[:, 1]), DARK)
    with np.errstate(all="ignore"):
        moved = np.linalg.norm(np.asarray(xyz, dtype=np.float64) - truth, axis=1)
    return percentile_99(moved / np.maximum(np.linalg.norm(truth, axis=1), floor))


def spectral_error(rho, truth):
    """Return the 99th percentile of |Δρ| / max(ρ, f) for reflectances ρ; f is a thousandth of ρ's 99th percentile."""
    floor = max(1e-3 * np.percentile(truth, 99.0), DARK)
    with np.errstate(all="ignore"):
        moved = np.abs(np.asarray(rho, dtype=np.float64) - truth)
    return percentile_99(moved / np.maximum(truth, floor))


# Surfaces and directions of the compared methods.


def finger_rows(length_um, height_um=0.3, pitch_um=0.05):
    """Return a height field with a single row of samples across finger-like bumps (``gratings.fingers``).

    The diffraction orders of the row lie in one plane. A view direction that moves in the plane of incidence crosses
    one order after the other.
    """
    heightfield = wd.gratings.fingers(
        size_um=(3.2, length_um), pitch_um=(0.2, pitch_um), period_um=min(1.1, length_um), seed=5
    )
    row = heightfield.heights_um[:1] - heightfield.heights_um[0].min()
    return wd.HeightField(row * (height_um / np.ptp(row)), heightfield.pitch_um[1])


def in_plane(count, largest, seed=0):
    """Return random directions to light and viewer in the xz-plane, both (count, 3).

    The component u of the scattering vector has a log-uniform magnitude from 0.02 to ``largest``.
    """
    rng = np.random.default_rng(seed)
    u = np.exp(rng.uniform(math.log(0.02), math.log(largest), count))
    # Here u is sin θi + sin θr, with the angles θi of the light and θr of the viewer from the normal. Both sines must
    # be between −0.97 and 0.97.
    light = rng.uniform(np.maximum(-0.97, u - 0.97), np.minimum(0.97, u + 0.97))
    x = np.stack([light, u - light]) * rng.choice([-1.0, 1.0], count)
    pair = np.stack([x, np.zeros_like(x), np.sqrt(1.0 - x**2)], axis=-1)
    return pair[0], pair[1]


def hemisphere_pairs(count, lowest=0.1, seed=0):
    """Return random directions to light and viewer, both (count, 3), on the hemisphere above the surface.

    Their components z along the normal are at least ``lowest``.
    """
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(lowest, 1.0, (2, count)), rng.uniform(0.0, 2.0 * np.pi, (2, count))
    s = np.sqrt(1.0 - z * z)
    pair = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)
    return pair[0], pair[1]


def with_lateral(count, order_rate, seed=0):
    """Return random directions to light and viewer, both (count, 3).

    The tangential part of their scattering vectors, (u, v), has the length ``order_rate``, which must be below 2.
    """
    rng = np.random.default_rng(seed)
    lights = []
    while len(lights) < count:
        # Projected onto the surface, the direction to the light lies in the unit disc, and so does the view. The sum of
        # both projections is fixed. The projection of the light therefore lies in the intersection of the unit disc and
        # a second disc, whose centre is this sum.
        x = -order_rate / 2.0 + (1.0 - order_rate / 2.0) * rng.uniform(-1.0, 1.0)
        y = math.sqrt(1.0 - order_rate**2 / 4.0) * rng.uniform(-1.0, 1.0)
        if max(math.hypot(x, y), math.hypot(x + order_rate, y)) < 1.0 - 1e-4 * (2.0 - order_rate):
            lights.append((x, y))
    tangential = np.stack([lights, -np.array(lights) - [order_rate, 0.0]])
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    turn = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    tangential = np.einsum("abn,knb->kna", turn, tangential)
    z = np.sqrt(np.maximum(1.0 - np.sum(tangential**2, axis=2), 0.0))
    pair = np.concatenate([tangential, z[:, :, None]], axis=2)
    return pair[0], pair[1]


def at_elevation(count, elevation_deg, spread_deg=None, seed=0):
    """Return random directions to light and viewer, both (count, 3), at an elevation above the horizon.

    The azimuths of the viewer are uniform, or normally distributed around the mirror direction with the standard
    deviation ``spread_deg``.
    """
    rng = np.random.default_rng(seed)
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    away = rng.uniform(0.0, 2.0 * np.pi, count) if spread_deg is None else np.radians(rng.normal(0, spread_deg, count))
    azimuths = np.stack([phi, phi + np.pi + away])
    across, z = math.cos(math.radians(elevation_deg)), math.sin(math.radians(elevation_deg))
    pair = np.stack([across * np.cos(azimuths), across * np.sin(azimuths), np.full((2, count), z)], axis=-1)
    return pair[0], pair[1]


def near_resonance(heightfield, away, wavelength_um, seed=7):
    """Return directions to light and viewer, both (n, 3), near resonances of a row of heights that is repeated along x.

    At a resonance, the phase between neighbouring repetitions is a whole number of turns. Here the phase differs from a
    whole number by up to ``away`` turns. The directions are in the xz-plane.
    """
    rng = np.random.default_rng(seed)
    orders = np.tile([-12, -7, -5, -3, -2, -1, 1, 2, 3, 4, 6, 9], 4)
    turns = orders + away * rng.choice([-1.0, 1.0], len(orders)) * rng.uniform(0.7, 1.0, len(orders))
    light = np.array([0.2, 0.0, math.sqrt(0.96)])
    x = -turns * wavelength_um / heightfield.size_um[1] - light[0]
    x = x[np.abs(x) < 0.97]
    views = np.stack([x, np.zeros_like(x), np.sqrt(1.0 - x**2)], axis=1)
    return np.broadcast_to(light, views.shape), views


# Series of the power spectrum under an averaged Gaussian coherence window.


class Rows(NamedTuple):
    """Fourier coefficients of a height field, or their powers, as sums of basis functions of κ = w/λ.

    Each coefficient has a row of numbers, by which the basis functions are multiplied.
    """

    values: np.ndarray  # complex amplitudes or real powers, shape (my, mx, terms)
    basis: object  # function of κ (m,) that returns the basis functions, shape (m, terms)
    origin: tuple[int, int]


def rows_for(heightfield, method, terms, *, kappas, dtype=np.float64):
    """Return all Fourier coefficients of a height field, or their powers, as functions of κ = w/λ in a range.

    The numbers are float32 or float64. With the method "exact", the coefficients are accurate to rounding errors.
    """
    block = fourier_coefficients.Block(heightfield.shape, (0, 0), heightfield.shape)
    complex_type = np.complex64 if dtype == np.float32 else np.complex128
    if method in SERIES:
        expansion = EXPANSIONS[method]
        scale = 2.0 * math.pi * expansion.offset_and_scale(heightfield)[1]
        values = fourier_coefficients.series_coefficients(heightfield, expansion, terms, block, dtype=complex_type)
        return Rows(values, lambda kappa: expansion.basis(scale * kappa, terms).astype(dtype), block.origin)
    # The methods "power", "low-rank" and "exact" interpolate between values of the Fourier coefficients at Chebyshev
    # nodes in κ. For "power", the number of nodes is the number of terms of the series. For "exact" and "low-rank",
    # there are so many nodes that interpolation errors are rounding errors.
    middle, half = (kappas[0] + kappas[1]) / 2.0, max((kappas[1] - kappas[0]) / 2.0, 1e-9)
    argument = math.pi * half * heightfield.height_range_um * (1.0 if method == "exact" else 2.0)
    count = terms if method == "power" else coherent_sums.chebyshev_terms(argument) + 6
    nodes = coherent_sums.chebyshev_nodes(count)
    values = np.stack(
        [np.fft.ifft2(np.exp(2j * np.pi * (middle + half * x) * heightfield.heights_um)) for x in nodes], axis=-1
    )
    values = np.abs(values) ** 2 if method != "exact" else values
    to_series = np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, count - 1)).T
    if method == "low-rank":
        flat = values.reshape(-1, count)
        scaled = flat / np.maximum(np.abs(flat).max(axis=1, keepdims=True), 1e-26)
        functions = np.linalg.svd(scaled, full_matrices=False)[2][:terms].T
        values, to_series = values @ functions, functions.T @ to_series

    def basis(kappa):
        # By rounding, values of κ may lie slightly outside of the interpolation range. Such values are moved to the
        # ends of the range.
        position = np.clip((kappa - middle) / half, -1.0, 1.0)
        chebyshev = np.polynomial.chebyshev.chebvander(position, count - 1)
        return (chebyshev @ to_series.T).astype(dtype)

    kind = complex_type if method == "exact" else dtype
    return Rows(values.astype(kind), basis, (0, 0))


def windowed_powers(
    heightfield, lights, views, wavelengths_um, *, sigma, method="exact", terms=None, dtype=np.float64,
    neighbour_extent=None, floor=False,
):  # fmt: skip
    """Return diffracted powers ⟨|P|²⟩, averaged over all positions of a Gaussian coherence window, shape (n, m).

    Args:
        heightfield: Height field.
        lights: Unit vectors to the light (n, 3).
        views: Unit vectors to the viewer (n, 3).
        wavelengths_um: Wavelengths [µm], shape (m,).
        sigma: Standard deviation of the coherence window [µm].
        method: One of ``METHODS`` or "exact".
        terms: Number of terms of the series; ignored by "exact".
        dtype: Floating-point type of coefficients and sums. Positions among the coefficients are computed in the type
            of ``lights``.
        neighbour_extent: Number of Fourier coefficients on either side of the central coefficient; None means all
            coefficients that contribute.
        floor: Whether the index of the central coefficient is rounded down by floor(), instead of to the nearest
            integer.
    """
    scattering_vectors = -(lights + views)
    tau = (1.0 / np.asarray(wavelengths_um)).astype(lights.dtype)
    kappa = np.outer(scattering_vectors[:, 2], tau).ravel()
    rows = rows_for(heightfield, method, terms, kappas=(kappa.min(), kappa.max()), dtype=dtype)
    falloff = 4.0 * (math.pi * sigma) ** 2
    axes = []
    for length, n, across in zip(
        heightfield.size_um, heightfield.shape, (scattering_vectors[:, 1], scattering_vectors[:, 0]), strict=True
    ):
        position = np.outer(across, tau).ravel() * length
        near = np.floor(position) if floor else np.rint(position)
        most = math.ceil(math.sqrt(DEPTH / falloff) * length + 0.5) if neighbour_extent is None else neighbour_extent
        # Along an axis with one height sample, the surface is constant, and only the diffraction order 0 exists.
        order = near[:, None] + np.arange(-most, most + 1, dtype=near.dtype) if n > 1 else np.zeros((len(near), 1))
        distance = (order - position[:, None]) / length if n > 1 else np.zeros((len(near), 1))
        axes.append((order.astype(np.int64) % n, np.exp(-falloff * distance**2).astype(dtype)))
    (y, weight_y), (x, weight_x) = axes
    result = np.empty(len(kappa))
    step = max(1, CHUNK // (y.shape[1] * x.shape[1] * rows.values.shape[2]))
    for first in range(0, len(kappa), step):
        part = slice(first, first + step)
        basis = rows.basis(kappa[part].astype(np.float64))
        with np.errstate(all="ignore"):
            values = np.einsum("pyxt,pt->pyx", rows.values[y[part][:, :, None], x[part][:, None, :]], basis)
            values = np.abs(values) ** 2 if np.iscomplexobj(values) else np.maximum(values, 0)
            result[part] = np.einsum("pyx,py,px->p", values, weight_y[part], weight_x[part])
    return result.reshape(len(scattering_vectors), len(tau))


def series_reflectance(heightfield, lights, views, wavelengths_um, **keywords):
    """Return reflectances ρ, shape (n, m), by a series expansion. ``keywords`` are arguments of ``windowed_powers``."""
    return reference.gain(lights, views)[:, None] * windowed_powers(
        heightfield, lights, views, wavelengths_um, **keywords
    )


def most_terms(heightfield, method, kappa, tolerance=1e-13):
    """Return the number of terms that a method's series of exp(2πiκh) requires for a tolerance at κ = ``kappa``.

    h are the heights. The number is at most the library's limit.
    """
    if method in SERIES:
        expansion = EXPANSIONS[method]
        return expansion.term_count(2.0 * math.pi * kappa * expansion.offset_and_scale(heightfield)[1], tolerance)
    return min(coherent_sums.chebyshev_terms(math.pi * kappa * heightfield.height_range_um) + 6, MAX_TERMS)


def single_precision(heightfield, lights, views, wavelengths_um, *, sigma):
    """Return the reflectance ρ, computed in float32 throughout, as in a shader."""
    i, r = lights.astype(np.float32), views.astype(np.float32)
    return series_reflectance(heightfield, i, r, wavelengths_um, sigma=sigma, dtype=np.float32)


# Integrals over the wavelength λ.


def fixed_steps(step_nm):
    """Return wavelengths [nm] at fixed steps from 380 nm on, and colour weights (m, 3).

    The weights are samples of the illuminant times the CIE functions, as in the method of Single (2014), which does not
    use quadrature weights.
    """
    wavelengths = np.arange(380.0, 780.0 + 1e-9, step_nm)
    table = reference.products("D65")
    weights = np.stack([np.interp(wavelengths, np.arange(380.0, 781.0), table[:, c]) for c in range(3)], axis=1)
    return wavelengths, weights / weights[:, 1].sum()


def fixed_step_colour(heightfield, lights, views, step_nm, coherence):
    """Return XYZ as a plain sum over wavelengths at a fixed step; reflectances are those of the float64 reference."""
    wavelengths, weights = fixed_steps(step_nm)
    return reference.reference_spectral(heightfield, lights, views, wavelengths * 1e-3, coherence) @ weights


def wavenumber_colour(heightfield, lights, views, count, coherence):
    """Return XYZ as a sum over equal steps of 1/λ, with the library's weights and the reference's reflectances."""
    wavenumbers, weights = colorimetry.uniform_quadrature(count, "D65")
    return reference.reference_spectral(heightfield, lights, views, 1.0 / wavenumbers, coherence) @ weights


def unforeshortened_colour(heightfield, lights, views, source):
    """Return XYZ under a light source without foreshortening, as a sum with steps of 1 nm.

    The spread of the source in (u, v) is then a disc for every direction to the light. With foreshortening, it would be
    an ellipse.
    """
    wavelengths, weights = fixed_steps(1.0)
    sums = coherent_sums.sum_for(heightfield, source, -(lights + views), 0.38, 0.78)
    up = np.array([0.0, 0.0, 1.0])
    powers = np.array([sums.power(scattering_vector, up, 1e3 / wavelengths) for scattering_vector in -(lights + views)])
    return reference.gain(lights, views, source=True)[:, None] * (powers @ weights)


def order_wise_colour(heightfield, lights, views, *, sigma):
    """Return XYZ as a sum over Fourier coefficients, with one wavelength per coefficient.

    As λ changes, the frequency (u, v)/λ moves along a straight line of the frequency plane. The wavelength of a
    coefficient is the one at which this frequency is nearest to the coefficient's frequency. The summand is the power
    of the coefficient at this wavelength, times the integral of the coefficient's Gaussian over λ.
    """
    table = reference.products("D65")
    scattering_vectors = -(lights + views)
    kappas = np.outer(
        [scattering_vectors[:, 2].min(), scattering_vectors[:, 2].max()], [coherent_sums.BLUEST, coherent_sums.REDDEST]
    )
    rows = rows_for(heightfield, "exact", None, kappas=(kappas.min(), kappas.max()))
    gains, result = reference.gain(lights, views), np.zeros((len(lights), 3))
    for at, (u, v, w) in enumerate(scattering_vectors):
        square = u * u + v * v
        radius = math.sqrt(DEPTH / 4.0) / (math.pi * sigma)
        ends = [
            np.arange(
                math.ceil((min(ends) - radius) * length),
                math.floor((max(ends) + radius) * length) + 1,
            )
            for ends, length in (
                ((v / 0.38, v / 0.78), heightfield.size_um[0]),
                ((u / 0.38, u / 0.78), heightfield.size_um[1]),
            )
        ]
        s, r = (grid.ravel() for grid in np.meshgrid(*ends, indexing="ij"))
        qy, qx = s / heightfield.size_um[0], r / heightfield.size_um[1]
        tau = (qx * u + qy * v) / square
        across = qx**2 + qy**2 - tau**2 * square
        is_visible = (tau >= coherent_sums.REDDEST) & (tau <= coherent_sums.BLUEST)
        use = is_visible & (4.0 * (math.pi * sigma) ** 2 * across < DEPTH)
        if not use.any():
            continue
        s, r, tau, across = s[use], r[use], tau[use], across[use]
        values = np.einsum(
            "pt,pt->p", rows.values[s % heightfield.shape[0], r % heightfield.shape[1]], rows.basis(w * tau)
        )
        width = 1.0 / (2.0 * math.sqrt(2.0) * math.pi * sigma * math.sqrt(square))
        # The interval dλ = dτ/τ² is in nm, because the CIE functions are tabulated at steps of 1 nm.
        area = np.abs(values) ** 2 * np.exp(-4.0 * (math.pi * sigma) ** 2 * across)
        area *= math.sqrt(2.0 * math.pi) * width / tau**2 * 1e3
        curves = np.stack([np.interp(1e3 / tau, np.arange(380.0, 781.0), table[:, c]) for c in range(3)], axis=1)
        result[at] = gains[at] * area @ curves
    return result


# Factors of replicated patches: ratio of |P|² of N periods to |P|² of one period.


def published_replicas(turns, periods, dtype=np.float64):
    """Return the ratio of the power |P|² of N periods to that of one, as |(p + iq)/N|² of Single (2014, eq. 3.47).

    In the publication, the sum p + iq is over n = 0 … N and has N + 1 terms. Here the sum ends at N − 1, so that it has
    one term per period. ``turns`` is the phase between neighbouring periods, in turns.
    """
    angle = (2.0 * math.pi * np.asarray(turns)).astype(dtype)
    last, one, half = dtype(periods - 1), dtype(1), dtype(0.5)
    with np.errstate(all="ignore"):
        fall = one - np.cos(angle)
        p = half + half * (np.cos(angle * last) - np.cos(angle * (last + one))) / fall
        q = (np.sin(angle * (last + one)) - np.sin(angle * last) - np.sin(angle)) / (2 * fall)
        return (p * p + q * q) / dtype(periods) ** 2


def plain_replicas(turns, periods, dtype=np.float64):
    """Return the ratio [sin(πNt)/(N sin(πt))]² of the power |P|² of N periods to that of one, by direct evaluation.

    The phase between neighbouring periods is t turns. The number t is not reduced to its distance from an integer.
    Integers t, for which the quotient is 0/0, are not treated separately.
    """
    angle = (math.pi * np.asarray(turns)).astype(dtype)
    with np.errstate(all="ignore"):
        return (np.sin(dtype(periods) * angle) / (dtype(periods) * np.sin(angle))) ** 2


def nearest_orders_power(heightfield, scattering_vector, wavelength_um, neighbour_extent):
    """Return the diffracted power |P|² of a height field with one row, for a scattering vector between orders.

    The amplitude is interpolated between those of the 2·neighbour_extent + 1 nearest diffraction orders.
    """
    n, length = heightfield.shape[1], heightfield.size_um[1]
    coefficients = np.fft.ifft(np.exp(2j * np.pi * scattering_vector[2] / wavelength_um * heightfield.heights_um[0]))
    t = scattering_vector[0] / wavelength_um * length
    order = round(t) + np.arange(-neighbour_extent, neighbour_extent + 1)
    away = math.pi * (t - order)
    kernel = np.where(away == 0.0, 1.0, np.sin(away) / (n * np.sin(np.where(away == 0.0, 1.0, away) / n)))
    return abs(np.sum(coefficients[order % n] * kernel * np.exp(1j * away * (n - 1) / n))) ** 2
