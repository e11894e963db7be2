"""The direct sum: ⟨|P|²⟩ in float64 from the height samples themselves, slow and certain.

There is no expansion in κ, no FFT and no table: at every wavelength exp(2πiκh) is formed for all samples, and every
coefficient within eight widths of the direction is an explicit sum over them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField

_WIDTHS = 8.0


def window_power(
    hf: HeightField,
    coherence: Coherence,
    deflections: NDArray[np.float64],
    wavelengths_um: NDArray[np.float64],
    *,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float64]:
    """⟨|P|²⟩ of the height field under the coherence window.

    Args:
        hf: The height field, taken as periodic.
        coherence: The window.
        deflections: (u, v, w) = −ωi − ωr, shape (n, 3).
        wavelengths_um: Wavelengths [µm], shape (m,).
        progress: Called with the share that is done.

    Returns:
        Shape (n, m), float64; 1 for a flat surface at u = v = 0.
    """
    # The Gaussian exp(−a q²) has the standard deviation 1/√(2a).
    cut = _WIDTHS / math.sqrt(2.0 * coherence.falloff_um2)
    ny, nx = hf.shape
    length_y, length_x = hf.size_um
    rows, columns = np.arange(ny), np.arange(nx)
    if coherence.centre_um is None:
        centre_y, centre_x = (ny // 2) * hf.pitch_um[0], (nx // 2) * hf.pitch_um[1]
    else:
        centre_y, centre_x = coherence.centre_um
    result = np.zeros((len(deflections), len(wavelengths_um)))
    for i, (u, v, w) in enumerate(deflections):
        for k, wavelength in enumerate(wavelengths_um):
            qx, qy = u / wavelength, v / wavelength
            r = np.arange(math.ceil((qx - cut) * length_x), math.floor((qx + cut) * length_x) + 1)
            s = np.arange(math.ceil((qy - cut) * length_y), math.floor((qy + cut) * length_y) + 1)
            # An axis of one sample is constant: it has no order but 0.
            r = r if nx > 1 else r[r == 0]
            s = s if ny > 1 else s[s == 0]
            if r.size == 0 or s.size == 0:
                continue
            field = np.exp(2j * math.pi * (w / wavelength) * hf.heights_um)
            # Orders are reduced modulo the samples before they meet π, so that large ones lose no digits.
            along_x = np.exp(2j * math.pi * (np.outer(columns, r) % nx) / nx)
            along_y = np.exp(2j * math.pi * (np.outer(s, rows) % ny) / ny)
            coefficients = along_y @ field @ along_x / (ny * nx)
            distance2 = (qy - s[:, None] / length_y) ** 2 + (qx - r[None, :] / length_x) ** 2
            gaussian = np.exp(-coherence.falloff_um2 * distance2)
            if coherence.kind == "averaged":
                result[i, k] = np.sum(np.abs(coefficients) ** 2 * gaussian)
            else:
                phase = s[:, None] * centre_y / length_y + r[None, :] * centre_x / length_x
                result[i, k] = abs(np.sum(coefficients * gaussian * np.exp(-2j * math.pi * phase))) ** 2
        if progress is not None:
            progress((i + 1) / len(deflections))
    return result
