"""Clear skies from formulas: luminance of a cloudless sky (CIE), disc of the sun, and diffuse ground."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.lights.base import orthonormal_pair
from warpdiff.lights.sky_grid import ROWS, grid_directions
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Azimuth of the sun in the image, from −z towards +x [rad]. At this azimuth, the sun is in the middle of a column of
# the image's pixels.
SUN_AZIMUTH = 0.5 * math.pi / ROWS
# Parameters of type 12 of the CIE standard general sky, "clear sky, low illuminance turbidity" (CIE S 011/E:2003, ISO
# 15469:2004, table 1). a and b describe the gradation (luminance by the angle from the zenith), and c, d and e the
# indicatrix (luminance by the angle from the sun).
_A, _B, _C, _D, _E = -1.0, -0.32, 10.0, -3.0, 0.45
# Coefficients of formulas for illuminances [klx], with the sun at the altitude h. The sun has the illuminance 127.5
# exp(−0.21 / sin h), normal to its direction. The clear sky has the illuminance 0.8 + 15.5 √sin h on the horizontal
# (IES, Recommended Practice for the Calculation of Daylight Availability, Journal of the IES 13, 1984).
_SUN_KLX, _EXTINCTION, _SKY_KLX, _SKY_KLX_OF_SINE = 127.5, 0.21, 0.8, 15.5
# Standard deviation of the sun's directions along one axis [rad]. It is that of a uniform disc with the sun's diameter
# of 0.53°: a quarter of the diameter.
SUN_DEVIATION = math.radians(0.53) / 4.0
# Largest angle between the sun and a pixel of the sky's image at which the pixel gets a part of the sun's power [rad].
# It is the height of 3.5 rows of the image. Pixels farther away would get less than 1e-5 of the power.
_SUN_REACH = 3.5 * math.pi / ROWS
# Colour temperatures of CIE daylight [K]: light of a blue sky, and light of the sun behind the atmosphere.
_SKY_K, _SUN_K = 15_000.0, 5_500.0


def clear_sky_radiance(sun_altitude: float, sun: float, ground_albedo: float) -> NDArray[np.float64]:
    """Return the image of a clear sky with the sun at SUN_AZIMUTH: linear sRGB radiance, shape (ROWS, 2 ROWS, 3).

    Without the sun, the sky has an illuminance of π on the horizontal.

    Args:
        sun_altitude: Angle of the sun above the horizon [rad], above 0.
        sun: Linear factor of the sun.
        ground_albedo: Fraction of the light that the ground reflects.
    """
    # The image has the same pixels as the grid on which environments store a sky, so that it is not resampled.
    # Resampling would spread the power of the sun over more pixels.
    along = grid_directions()
    solid = np.repeat(
        -np.diff(np.cos(np.arange(ROWS + 1) / ROWS * math.pi))[:, None] * math.pi / ROWS, 2 * ROWS, axis=1
    )
    level_of_sun = math.cos(sun_altitude)
    towards = np.array([
        level_of_sun * math.sin(SUN_AZIMUTH), math.sin(sun_altitude), -level_of_sun * math.cos(SUN_AZIMUTH)
    ])  # fmt: skip
    above = slice(0, ROWS // 2)
    luminance = relative_luminance(along[above], towards)
    luminance *= math.pi / (luminance * along[above, :, 1] * solid[above]).sum()
    sun_power = sun * math.pi * illuminance_ratio(sun_altitude)
    sky_rgb, sun_rgb = _daylight(_SKY_K), _daylight(_SUN_K)
    radiance = np.empty((ROWS, 2 * ROWS, 3))
    radiance[above] = luminance[..., None] * sky_rgb
    radiance[ROWS // 2 :] = ground_albedo * (sky_rgb + sun_power * towards[1] / math.pi * sun_rgb)
    near = along @ towards > math.cos(_SUN_REACH)
    shares = _shares_of_sun(along[near], solid[near], towards)
    radiance[near] += (sun_power * shares / solid[near])[:, None] * sun_rgb
    return radiance


def relative_luminance(along: NDArray[np.float64], to_sun: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the luminance of the sky in directions above the horizon, relative to the luminance of the zenith.

    By CIE S 011/E:2003 the relative luminance is f(χ) φ(Z) / (f(Zs) φ(0)). The gradation is φ(Z) = 1 + a
    exp(b / cos Z). The indicatrix is f(χ) = 1 + c (exp(d χ) − exp(d π/2)) + e cos² χ. Z is the direction's angle to the
    zenith, χ its angle to the sun, and Zs the sun's angle to the zenith; y is up.

    Args:
        along: Unit vectors of the directions, shape (..., 3).
        to_sun: Unit vector to the sun, shape (3,).
    """

    def gradation(cosine: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.asarray(1.0 + _A * np.exp(_B / np.maximum(cosine, 1e-9)))

    def indicatrix(cosine: NDArray[np.float64] | float) -> NDArray[np.float64]:
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        return np.asarray(1.0 + _C * (np.exp(_D * angle) - math.exp(_D * math.pi / 2.0)) + _E * np.square(cosine))

    of_zenith = indicatrix(float(to_sun[1])) * gradation(1.0)
    return np.asarray(indicatrix(along @ to_sun) * gradation(along[..., 1]) / of_zenith)


def illuminance_ratio(sun_altitude: float) -> float:
    """Return the sun's illuminance, normal to its direction, relative to the sky's illuminance on the horizontal."""
    sine = math.sin(sun_altitude)
    return _SUN_KLX * math.exp(-_EXTINCTION / sine) / (_SKY_KLX + _SKY_KLX_OF_SINE * math.sqrt(sine))


def _shares_of_sun(
    along: NDArray[np.float64], solid: NDArray[np.float64], towards: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the fraction of the sun's power of each pixel, with the mean direction and the variance of the sun's disc.

    A pixel is 0.35° wide. If the fractions were proportional to the disc's area in each pixel, the sun would become 18
    to 28 % wider. Among all fractions with the required mean and variance, this function selects those with the largest
    entropy. They are proportional to s exp(θ·x), where s is the solid angle of a pixel. The vector x has the pixel's
    two offsets from the sun and its squared distance. The three parameters θ minimise a convex function.
    """
    from scipy.optimize import minimize

    away = np.arccos(np.clip(along @ towards, -1.0, 1.0)) / SUN_DEVIATION
    moments = np.column_stack([along @ orthonormal_pair(towards).T / SUN_DEVIATION, away**2 - 2.0])

    def shares(theta: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        exponents = moments @ theta
        weights = solid * np.exp(exponents - exponents.max())
        return weights / weights.sum(), float(exponents.max() + np.log(weights.sum()))

    def means(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(shares(theta)[0] @ moments)

    def covariance(theta: NDArray[np.float64]) -> NDArray[np.float64]:
        of_pixels, mean = shares(theta)[0], means(theta)
        return np.asarray((of_pixels[:, None] * moments).T @ moments - np.outer(mean, mean))

    solution = minimize(
        lambda theta: shares(theta)[1], [0.0, 0.0, -0.5], jac=means, hess=covariance, method="trust-exact",
        options={"gtol": 1e-9},
    )  # fmt: skip
    return shares(solution.x)[0]


def _daylight(temperature_k: float) -> NDArray[np.float64]:
    """Return the linear sRGB colour of CIE illuminant D at a colour temperature; its luminance is 1 (CIE 15:2004)."""
    t = 1e3 / temperature_k
    if temperature_k <= 7_000.0:
        x = 0.244063 + 0.09911 * t + 2.9678 * t**2 - 4.6070 * t**3
    else:
        x = 0.237040 + 0.24748 * t + 1.9018 * t**2 - 2.0064 * t**3
    y = 2.870 * x - 3.000 * x**2 - 0.275
    return colorimetry.xyz_to_rgb(np.array([x / y, 1.0, (1.0 - x - y) / y]))
