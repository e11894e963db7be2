"""First heights of the pixels of a design: by iterative Fourier transforms for orders, by waves for colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.evaluate.orders import propagating
from warpdiff.inverse_design.goal import places_of
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.inverse_design.targets import Target
    from warpdiff.profiles.sampled_profiles import Pixels

    Array = NDArray[np.float64]

# Number of iterations of the Fourier transforms that compute the first heights. The value was chosen because the
# amplitudes of the orders no longer change visibly after 200 iterations.
_ITERATIONS = 200
# Exponent of the feedback. Each iteration transforms amplitudes of orders to heights and back. Before the next one, an
# amplitude is multiplied by the ratio of its requested to its reached value, to this power. The value was chosen
# because amplitudes oscillate with an exponent of 1.
_FEEDBACK = 0.5
# First heights for colours are a sum of waves and noise: amplitude of a wave if there are two colours, and standard
# deviation of the noise, relative to the depth. With this amplitude, the sum of two waves extends over the whole depth.
# The noise makes the starts differ.
_WAVE, _NOISE = 0.25, 0.04
# Wavelengths [nm] among which the dominant wavelength of a colour is searched. Beyond this range, the hue of light
# hardly changes with the wavelength.
_HUES_NM = np.arange(430.0, 651.0, 5.0)


def first_heights(profile: Pixels, targets: list[Target], depth_um: float, rng: np.random.Generator) -> Array:
    """Return random first heights of pixels [µm], from 0 to the depth, shape (ny · nx,).

    For orders, the heights come from iterative Fourier transforms (Gerchberg and Saxton 1972; Wyrowski and Bryngdahl
    1988) for the first target. For colours, the heights are a sum of waves, one per colour, which diffracts the
    dominant wavelength of the colour in the direction of its target.
    """
    colours = [target for target in targets if target.kind == "colour"]
    if colours:
        return _waves(profile, colours, depth_um, rng)
    heights = _fourier(profile, targets[0], rng)
    return np.asarray(np.clip(heights, 0.0, depth_um).ravel())


def _fourier(profile: Pixels, target: Target, rng: np.random.Generator) -> Array:
    surface = profile.surface(profile.start)
    ny, nx = profile.pixels
    orders, views = propagating(surface, target.to_light[None], np.array([target.wavelength_nm]))
    view = views[0, 0, places_of(target, surface)]
    del orders
    # The variable `goal` is the requested amplitude |H| of the Fourier coefficient of each order. The efficiency of an
    # order at the angle θ from the normal is about |H|²/cos θ. The width of the pixels weakens high orders by the
    # factor `size`.
    shares = np.where(np.isnan(target.requested), 1.0, target.requested)
    size = np.prod([np.sinc(target.pairs[:, axis] / n) for axis, n in enumerate((ny, nx))], axis=0)
    goal = np.sqrt(shares * np.maximum(view[:, 2], HORIZON)) / np.maximum(np.abs(size), 0.1)
    goal /= np.linalg.norm(goal)
    place = tuple((-target.pairs % [ny, nx]).T)
    amplitudes, phases = goal.copy(), rng.uniform(0.0, 2.0 * np.pi, len(goal))
    for _ in range(_ITERATIONS):
        spectrum = np.zeros((ny, nx), dtype=np.complex128)
        spectrum[place] = amplitudes * np.exp(1j * phases)
        wave = np.fft.fft2(spectrum)
        reached = np.fft.ifft2(np.exp(1j * np.angle(wave)))[place]
        phases = np.angle(reached)
        powers = np.abs(reached) / max(float(np.linalg.norm(reached)), 1e-12)
        amplitudes = amplitudes * (np.maximum(goal, 1e-6) / np.maximum(powers, 1e-6)) ** _FEEDBACK
        amplitudes /= np.linalg.norm(amplitudes)
    # A surface of the height h reflects the wave exp(−2πi|κ|h). Here |κ| is |w|/λ, and |w| is the sum of the z
    # components of the directions to light and viewer. A phase of 2π therefore is a height of `cycle_um` = 1/|κ|.
    return np.asarray((-np.angle(wave) % (2.0 * np.pi)) / (2.0 * np.pi) * target.cycle_um)


def _waves(profile: Pixels, targets: list[Target], depth_um: float, rng: np.random.Generator) -> Array:
    products = colorimetry.products_by_colour_science("D65")
    rows = np.searchsorted(colorimetry.VISIBLE_NM, _HUES_NM)
    hues = products[rows] / np.linalg.norm(products[rows], axis=1, keepdims=True)
    ny, nx = profile.pixels
    y, x = ((np.arange(n) + 0.5) * profile.pixel_um for n in (ny, nx))
    heights = np.full((ny, nx), 0.5 * depth_um)
    for target in targets:
        dominant_um = 1e-3 * _HUES_NM[int(np.argmax(hues @ target.requested))]
        u, v = (target.to_light + target.to_view)[:2] / dominant_um
        phase = 2.0 * np.pi * (u * x[None, :] + v * y[:, None] * (ny > 1)) + rng.uniform(0.0, 2.0 * np.pi)
        heights += _WAVE * depth_um * np.cos(phase) * (2.0 / len(targets)) ** 0.5
    heights += _NOISE * depth_um * rng.normal(size=heights.shape)
    return np.asarray(np.clip(heights, 0.0, depth_um).ravel())
