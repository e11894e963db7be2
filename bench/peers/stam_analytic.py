"""The analytic diffraction shader of a regular grating, in which every order is a line at nλ = d|u|.

The model of Stam, *Simulating Diffraction*, GPU Gems (2004), chapter 8, has parallel tracks at a distance d. For a
component u of the scattering vector across the tracks, only the wavelengths d|u|/n are reflected, n = 1 … 7. The module
has two forms.

- ``"rainbow"`` is the form in Stam's chapter. Orders have equal strength for all components v along the tracks.
  Wavelengths from 0.5 to 1 µm are coloured by three parabolas, max(0, 1 − x²). A white highlight exp(−(r u/w)²) is
  added. The chapter defines neither the brightness of the orders nor r. In this module the mean luminance of the orders
  is that of exact colours in random directions, and the highlight is as wide as the lobe of a Gaussian coherence
  window.
- ``"cie"`` has the same lines, with four factors that Stam's form omits: the power |H_n0|² of each order, computed from
  the heights; the dependence on v by the Gaussian of the window; CIE colours; and the geometry factors (gains).

With q = u/λ, order n contributes |H_n0|² λ²/(2√π σ|u|) exp(−(2πσv/λ)²) to the integral over λ. This is the integral of
the averaged window's Gaussian exp(−(2πσ(q − n/d))²) with dλ = λ² dq/|u|. The order 0 reflects all wavelengths in the
same direction, and is summed at eight wavelengths.

H_n0 is the Fourier coefficient of order n of exp(2πiκh), with the heights h and κ = w/λ.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from warpdiff.optics import colorimetry

try:
    # Numba must be imported before colour-science. Without SciPy, colour-science installs a substitute for SciPy that
    # Numba would use.
    import numba
except ImportError:
    numba = None

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SETTINGS: list[dict[str, Any]] = [{"colours": "rainbow"}, {"colours": "cie"}]
# Number of diffraction orders to each side of the zeroth order.
ORDERS = 7
# Number of wavelengths at which the zeroth order is summed, and number of values of κ = w/λ at which the power of an
# order is tabulated. w is the component of the scattering vector along the normal.
MIRROR_WAVELENGTHS, NODES = 8, 128
# Largest |κ| = |w|/λ [1/µm]. |w| is 2 if light and view are along the normal; the shortest wavelength is 0.38 µm.
LARGEST_KAPPA = 2.0 / 0.38
# Positions of the maxima of the red, green and blue parabolas in 2λ − 1 (λ in µm), and inverse of the half-width of all
# three parabolas. The numbers are from Stam's chapter in GPU Gems.
PARABOLAS, NARROWNESS = (0.75, 0.5, 0.25), 4.0
# Number of random directions in which the brightness of Stam's rainbow colours is determined. The value was chosen; if
# it is halved, the mean luminance has more noise.
CALIBRATING = 2000


def available() -> str | None:
    """Return None, or the reason why the shader cannot run."""
    return None if numba else "Numba, which compiles the analytic shader, is not installed: pip install numba"


def grating_um(heightfield: wd.HeightField) -> float:
    """Return the grating period d along x [µm], from the strongest order.

    Scans have noise with a power that falls as 1/frequency, so that an order of low frequency would always be the
    strongest. The power of each order is therefore multiplied by its frequency before the comparison.
    """
    power = np.sum(np.abs(np.fft.rfft(heightfield.heights_um, axis=1)) ** 2, axis=0)
    return float(heightfield.size_um[1] / np.argmax(power * np.arange(len(power))))


def prepare(
    heightfield: wd.HeightField, coherence: wd.Coherence, *, colours: str, period_um: float | None = None
) -> Callable[..., NDArray[np.float32]]:
    """Return a function that computes colours of directions by Stam's shader.

    Args:
        heightfield: Height field of a grating along x.
        coherence: Gaussian coherence window of the kind averaged.
        colours: ``"rainbow"`` or ``"cie"``.
        period_um: Distance d of the tracks [µm]; None means the result of :func:`grating_um`.

    Returns:
        A function ``shade(scattering_vectors, gains, threads)`` of arrays (n, 3) and (n,) that returns XYZ (n, 3).
    """
    if coherence.kind != "averaged" or coherence.sigma_um is None:
        raise ValueError(f"coherence must be an averaged window, got {coherence}")
    if colours not in ("rainbow", "cie"):
        raise ValueError(f"colours must be 'rainbow' or 'cie', got {colours!r}")
    period = grating_um(heightfield) if period_um is None else period_um
    sigma = coherence.sigma_um
    if colours == "rainbow":
        # The rainbow's highlight is exp(−(r u/w)²). The factor r is chosen for 550 nm and |w| = 2, the mirror direction
        # at normal incidence. There the highlight equals the Gaussian of the coherence window.
        roughness = 2.0 * 2.0 * math.pi * sigma / 0.55
        run = functools.partial(_kernels()[0], period, roughness, colorimetry.RGB_TO_XYZ)
        fixed: tuple[Any, ...] = (_brightness(heightfield, coherence, run),)
    else:
        products = np.ascontiguousarray(colorimetry.colour_products())
        nodes = np.linspace(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, MIRROR_WAVELENGTHS)
        mirror = colorimetry.quadrature_weights(nodes)
        run = functools.partial(_kernels()[1], period, sigma, products, nodes * 1e-3, mirror)
        fixed = (order_powers(heightfield, period),)

    def shade(scattering_vectors: NDArray[np.float64], gains: NDArray[np.float64], threads: int) -> NDArray[np.float32]:
        numba.set_num_threads(threads)
        xyz = np.empty((len(gains), 3), dtype=np.float32)
        run(*fixed, np.float64(scattering_vectors), np.float64(gains), xyz)
        return xyz

    return shade


def order_powers(heightfield: wd.HeightField, period_um: float) -> NDArray[np.float64]:
    """Return powers |H_n0|² of orders n = −7 … 7 at equal steps of κ = w/λ from 0 to −2/0.38 /µm, shape (NODES, 15).

    The frequency of order n is n/d, where d is the distance of the tracks. The frequencies of the height field's orders
    are multiples of 1/Lx, where Lx is its length. The order with the nearest frequency is used.
    """
    orders = np.rint(np.arange(-ORDERS, ORDERS + 1) * heightfield.size_um[1] / period_um).astype(int)
    result = np.empty((NODES, len(orders)))
    for node, kappa in enumerate(np.linspace(0.0, -LARGEST_KAPPA, NODES)):
        mean = np.exp(2j * math.pi * kappa * heightfield.heights_um).mean(axis=0)
        result[node] = np.abs(np.fft.ifft(mean)[orders % heightfield.shape[1]]) ** 2
    return result


def _brightness(heightfield: wd.HeightField, coherence: wd.Coherence, run: Callable[..., None]) -> float:
    """Return a factor by which the colours of the rainbow are multiplied.

    With this factor, the mean luminance of the rainbow over random directions is that of :func:`warpdiff.reflectance`
    for the same directions. The mean of the rainbow excludes its highlight.
    """
    rng = np.random.default_rng(0)
    z, phi = rng.uniform(0.05, 1.0, (2, CALIBRATING)), rng.uniform(0.0, 2.0 * math.pi, (2, CALIBRATING))
    s = np.sqrt(1.0 - z * z)
    lights, views = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=2)
    exact = wd.reflectance(heightfield, lights, views, tolerance=3e-2, coherence=coherence)[:, 1]
    colours = np.empty((CALIBRATING, 3), dtype=np.float32)
    run(1.0, -lights - views, np.zeros(CALIBRATING), colours)
    return float(exact.mean() / colours[:, 1].mean())


@functools.cache
def _kernels() -> tuple[Any, Any]:
    """Return the compiled functions of the shader's two forms, ``"rainbow"`` and ``"cie"``."""

    @numba.njit(parallel=True, fastmath=True, error_model="numpy")
    def rainbow(period, roughness, to_xyz, scale, scattering_vectors, gains, xyz_out):
        for i in numba.prange(len(gains)):
            u, w = abs(scattering_vectors[i, 0]), scattering_vectors[i, 2]
            red = green = blue = 0.0
            for n in range(1, ORDERS + 1):
                # Stam's chapter states the parabolas for red, green and blue as functions of 2λ − 1 (λ in µm).
                at = 2.0 * period * u / n - 1.0
                red += max(0.0, 1.0 - (NARROWNESS * (at - PARABOLAS[0])) ** 2)
                green += max(0.0, 1.0 - (NARROWNESS * (at - PARABOLAS[1])) ** 2)
                blue += max(0.0, 1.0 - (NARROWNESS * (at - PARABOLAS[2])) ** 2)
            highlight = gains[i] * math.exp(-((roughness * u / w) ** 2))
            for c in range(3):
                orders = to_xyz[c, 0] * red + to_xyz[c, 1] * green + to_xyz[c, 2] * blue
                white = to_xyz[c, 0] + to_xyz[c, 1] + to_xyz[c, 2]
                xyz_out[i, c] = scale * orders + highlight * white

    @numba.njit(parallel=True, fastmath=True, error_model="numpy")
    def cie(period, sigma, products, wavelengths, mirror, powers, scattering_vectors, gains, xyz_out):
        falloff = (2.0 * math.pi * sigma) ** 2
        per_kappa = (len(powers) - 1) / LARGEST_KAPPA
        for i in numba.prange(len(gains)):
            u, v, w = scattering_vectors[i]
            x = y = z = 0.0
            side = 1 if u > 0.0 else -1
            for n in range(1, ORDERS + 1):
                wavelength = period * abs(u) / n
                place = 1e3 * wavelength - 380.0
                exponent = falloff * (v / wavelength) ** 2
                if place < 0.0 or place >= 400.0 or exponent > 80.0:
                    continue
                k = int(place)
                share = place - k
                node = -w / wavelength * per_kappa
                below = int(node)
                rest = node - below
                order = ORDERS + side * n
                power = (1.0 - rest) * powers[below, order] + rest * powers[below + 1, order]
                # The variable `length` is the integral of the coherence window's Gaussian over λ. Its unit is nm,
                # because the CIE functions are tabulated at steps of 1 nm.
                length = 1e3 * wavelength * wavelength / (2.0 * math.sqrt(math.pi) * sigma * abs(u))
                power *= length * math.exp(-exponent)
                x += power * ((1.0 - share) * products[k, 0] + share * products[k + 1, 0])
                y += power * ((1.0 - share) * products[k, 1] + share * products[k + 1, 1])
                z += power * ((1.0 - share) * products[k, 2] + share * products[k + 1, 2])
            for k in range(len(wavelengths)):
                exponent = falloff * (u * u + v * v) / wavelengths[k] ** 2
                if exponent < 80.0:
                    node = -w / wavelengths[k] * per_kappa
                    below = min(int(node), len(powers) - 2)
                    rest = node - below
                    power = (1.0 - rest) * powers[below, ORDERS] + rest * powers[below + 1, ORDERS]
                    power *= math.exp(-exponent)
                    x += power * mirror[k, 0]
                    y += power * mirror[k, 1]
                    z += power * mirror[k, 2]
            xyz_out[i, 0] = gains[i] * x
            xyz_out[i, 1] = gains[i] * y
            xyz_out[i, 2] = gains[i] * z

    return rainbow, cie
