"""Direct sum of the diffracted power ⟨|P|²⟩ in float64 over the height samples: slow, without approximations.

The sum has no expansion in κ = w/λ, no FFT and no table. At every wavelength exp(2πiκh) is computed for all height
samples h, and its Fourier coefficients are explicit sums over these samples. The result includes every coefficient
whose frequency is within eight standard deviations of the direction's frequency (u, v)/λ. For a finite number of
periods, there is no such neighbourhood: the spectrum is computed at the direction itself.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence

# Distance from the frequency q of a direction up to which the direct sum includes Fourier coefficients, in standard
# deviations of the Gaussian weight of a coefficient. The weight at this distance is e^−32.
_WIDTHS = 8.0
# Peak memory of the direct sum [bytes], per height sample and per Fourier coefficient. It was derived by adding the
# sizes of the arrays in the code.
_BYTES_PER_NUMBER = 64.0


@single_threaded_blas()
def window_power(
    heightfield: HeightField, coherence: Coherence, scattering_vectors: NDArray[np.float64],
    wavelengths_um: NDArray[np.float64], *, to_lights: NDArray[np.float64] | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the diffracted power ⟨|P|²⟩ of the height field under a coherence window, a source or a number of periods.

    Args:
        heightfield: Height field, one period of a periodic surface.
        coherence: Coherence window, light source of finite size, or periods.
        scattering_vectors: Scattering vectors (u, v, w) = −ωi − ωr, shape (n, 3).
        wavelengths_um: Wavelengths [µm], shape (m,).
        to_lights: Unit vectors ωi above the horizon, shape (n, 3); required for a source, which is foreshortened.
        progress: Function that is called with the finished share of the work, 0 to 1.

    Returns:
        ⟨|P|²⟩, float64, shape (n, m); 1 for a flat surface at u = v = 0.
    """
    if coherence.kind == "source" and to_lights is None:
        raise ArgumentValueError(f"{ref('to_lights')} must be given for a source, whose foreshortening depends on it")
    if coherence.kind != "replicas":
        _check_orders(heightfield, max((_cutoff(coherence, float(length)) for length in wavelengths_um), default=0.0))
    result = np.zeros((len(scattering_vectors), len(wavelengths_um)))
    for i, scattering_vector in enumerate(scattering_vectors):
        for k, wavelength in enumerate(wavelengths_um):
            q, kappa = scattering_vector[:2] / wavelength, scattering_vector[2] / wavelength
            field = np.exp(2j * math.pi * kappa * heightfield.heights_um)
            if coherence.kind == "replicas":
                result[i, k] = _periods_power(heightfield, coherence, field, q)
            else:
                to_light = to_lights[i] if coherence.kind == "source" and to_lights is not None else None
                result[i, k] = _coefficient_sum(heightfield, coherence, field, q, float(wavelength), to_light)
        if progress is not None:
            progress((i + 1) / len(scattering_vectors))
    return result


def _coefficient_sum(
    heightfield: HeightField, coherence: Coherence, field: NDArray[np.complex128], q: NDArray[np.float64],
    wavelength: float, to_light: NDArray[np.float64] | None,
) -> float:  # fmt: skip
    """Return Σ |H|² e^(−a d²) over the Fourier coefficients H near q, or |Σ H e^(−a d²)|² for a centred window.

    d is the distance in frequency of a coefficient from q = (u, v)/λ, and a is the falloff of the Gaussian weight.
    """
    # The Gaussian weight of a Fourier coefficient at the frequency q_rs is exp(−a (d² + (d·t)²/cos²θi)). d is the
    # distance vector q − q_rs from the frequency q of the direction, and θi is the angle of the light from the normal.
    # For a source, t is the tangential part of the direction to the light: the disc of the source, projected to the
    # surface, is shorter along t. Windows are isotropic, and t = 0.
    tangential, cos_light = (0.0, 0.0), 1.0
    if to_light is not None:
        tangential, cos_light = (float(to_light[0]), float(to_light[1])), float(to_light[2])
    falloff, cutoff = _falloff(coherence, wavelength), _cutoff(coherence, wavelength)
    # Largest distances along x and y of the summed Fourier coefficients from the frequency q of a direction. For a
    # light source of finite size, let t be the component of the direction to the light along an axis; otherwise t is 0.
    # The Gaussian weight is narrower along this axis by the factor √(1 − t²), and so is the largest distance.
    cutoff_x, cutoff_y = (cutoff * math.sqrt(1.0 - t**2) for t in tangential)
    ny, nx = heightfield.shape
    length_y, length_x = heightfield.size_um
    qx, qy = q
    r = np.arange(math.ceil((qx - cutoff_x) * length_x), math.floor((qx + cutoff_x) * length_x) + 1)
    s = np.arange(math.ceil((qy - cutoff_y) * length_y), math.floor((qy + cutoff_y) * length_y) + 1)
    # Along an axis with a single sample, the heights are constant, and only order 0 exists.
    r = r if nx > 1 else r[r == 0]
    s = s if ny > 1 else s[s == 0]
    # The phase of a Fourier sum is 2π times the product of two indices over the number of samples. The modulus removes
    # whole turns from the phase, because float64 would lose digits of large phases.
    along_x = np.exp(2j * math.pi * (np.outer(np.arange(nx), r) % nx) / nx)
    along_y = np.exp(2j * math.pi * (np.outer(s, np.arange(ny)) % ny) / ny)
    coefficients = along_y @ field @ along_x / (ny * nx)
    dx, dy = qx - r[None, :] / length_x, qy - s[:, None] / length_y
    slant = (dx * tangential[0] + dy * tangential[1]) / cos_light
    gaussian = np.exp(-falloff * (dx**2 + dy**2 + slant**2))
    if coherence.adds_powers:
        return float(np.sum(np.abs(coefficients) ** 2 * gaussian))
    if coherence.centre_um is None:
        centre_y, centre_x = (ny // 2) * heightfield.pitch_um[0], (nx // 2) * heightfield.pitch_um[1]
    else:
        centre_y, centre_x = coherence.centre_um
    phase = s[:, None] * centre_y / length_y + r[None, :] * centre_x / length_x
    return float(abs(np.sum(coefficients * gaussian * np.exp(-2j * math.pi * phase))) ** 2)


def _falloff(coherence: Coherence, wavelength: float) -> float:
    """Return the factor a [µm²] of the Gaussian weight exp(−a d²) of a Fourier coefficient.

    d is the distance of the coefficient from the frequency q of the direction [1/µm].
    """
    if coherence.kind == "source":
        return wavelength**2 / (2.0 * coherence.spread**2)
    return (4.0 if coherence.kind == "averaged" else 2.0) * (math.pi * (coherence.sigma_um or 0.0)) ** 2


def _cutoff(coherence: Coherence, wavelength: float) -> float:
    """Return up to which distance in frequency [1/µm] from q = (u, v)/λ the sum includes Fourier coefficients."""
    # The standard deviation of the Gaussian weight exp(−a d²) is 1/√(2a).
    return _WIDTHS / math.sqrt(2.0 * _falloff(coherence, wavelength))


def _check_orders(heightfield: HeightField, cutoff: float) -> None:
    """Raise ``MemoryError`` if the direct sum requires more memory than is free.

    ``cutoff`` is the distance in frequency [1/µm] from a direction up to which Fourier coefficients are summed.
    """
    rows, columns = (
        2.0 * cutoff * length + 1.0 if n > 1 else 1.0
        for n, length in zip(heightfield.shape, heightfield.size_um, strict=True)
    )
    ny, nx = heightfield.shape
    memory.require_memory(
        _BYTES_PER_NUMBER * (rows * ny + columns * nx + rows * columns + ny * nx),
        f"the direct sum of {rows:.3g} × {columns:.3g} coefficients of {ny} × {nx} samples",
        "take another method, a larger sigma_um of coherence, or {share} of heightfield's area",
    )


def _periods_power(
    heightfield: HeightField, coherence: Coherence, field: NDArray[np.complex128], q: NDArray[np.float64]
) -> float:
    """Return the power |P|² of finitely many periods of a patch at the frequency q of a direction.

    The result is the power of one period times the interference factors of the periods along y and x.
    """
    ny, nx = heightfield.shape
    pitch_y, pitch_x = heightfield.pitch_um
    along_x = np.exp(2j * math.pi * q[0] * pitch_x * np.arange(nx))
    along_y = np.exp(2j * math.pi * q[1] * pitch_y * np.arange(ny))
    power = float(abs(along_y @ field @ along_x / (ny * nx)) ** 2)
    periods_y, periods_x = coherence.periods or (1, 1)
    return (
        power
        * _interference(q[0] * heightfield.size_um[1], periods_x)
        * _interference(q[1] * heightfield.size_um[0], periods_y)
    )


def _interference(turns: float, periods: int) -> float:
    """Return the interference factor [sin(πNt)/(N sin(πt))]² of N periods, with a phase of t turns per period."""
    # Whole turns are subtracted from the phase before it is multiplied by N. They do not change the result, but float64
    # would lose digits of large phases.
    part = math.pi * (turns - round(turns))
    if part == 0.0:
        return 1.0
    return (math.sin(periods * part) / (periods * math.sin(part))) ** 2
