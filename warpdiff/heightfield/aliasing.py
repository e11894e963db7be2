"""Aliasing of a height field's samples: the power of exp(2πiκh) beyond half a cycle a sample folds back."""

from __future__ import annotations

import math
import weakref
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField

# |κ| at which the surface is judged: normal incidence and view at 380 nm [1/µm].
_KAPPA = 2.0 / 0.38
# A part of a large scan stands for it; its edges are faded out.
_SAMPLES = 512
_RING = 0.1
_cache: weakref.WeakKeyDictionary[HeightField, tuple[np.ndarray, np.ndarray]] = weakref.WeakKeyDictionary()


def coarsest_pitch_um(heightfield: HeightField) -> float:
    """The larger pitch of the axes that vary [µm]; an axis of one sample is constant, and 0 if both are."""
    return max((pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True) if n > 1), default=0.0)


def folded_power(heightfield: HeightField, frequency: float) -> float:
    """Power that folds back onto coefficients at a frequency [1/µm], relative to theirs, at most 1.

    What lies beyond the limit cannot be seen; it is taken to be as strong as what lies just within, which holds for
    spectra that fall.
    """
    pitch = coarsest_pitch_um(heightfield)
    if pitch == 0.0 or heightfield.height_range_um == 0.0:
        return 0.0
    limit = 1.0 / (2.0 * pitch)
    if frequency >= limit:
        return 1.0
    radius, power = _spectrum(heightfield)
    at_limit = (radius >= (1.0 - _RING) * limit) & (radius <= limit)
    at_edge = np.abs(radius - frequency) <= _RING * limit
    if not at_limit.any() or not at_edge.any() or power[at_edge].mean() <= 0.0:
        return 0.0
    return float(min(1.0, power[at_limit].mean() / power[at_edge].mean()))


@np.errstate(under="ignore")
def _spectrum(heightfield: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [1/µm] and powers of the coefficients of a part of the height field, flat arrays."""
    if heightfield not in _cache:
        part = heightfield.heights_um[:_SAMPLES, :_SAMPLES]
        field = np.exp(2j * math.pi * _KAPPA * part)
        for axis, n in enumerate(part.shape):
            if n < heightfield.shape[axis]:
                fade = np.hanning(n + 2)[1:-1]
                field = field * (fade[:, None] if axis == 0 else fade)
        q = [np.fft.fftfreq(n, pitch) for n, pitch in zip(part.shape, heightfield.pitch_um, strict=True)]
        power = np.abs(np.fft.fft2(field)) ** 2
        _cache[heightfield] = np.hypot(q[0][:, None], q[1]).ravel(), power.ravel()
    return _cache[heightfield]
