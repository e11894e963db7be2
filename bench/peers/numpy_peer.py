"""The published algorithm (Single 2014) in NumPy.

Operations are vectorised over directions and neighbouring Fourier coefficients, with a loop over wavelengths.
Directions are evaluated in chunks that are so large that the interpreter's overhead is negligible. Several chunks are
evaluated in parallel by threads, because NumPy releases the interpreter's lock.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.peers.series import PUBLISHED, SETTINGS, Series, series

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    import warpdiff as wd

__all__ = ["PUBLISHED", "SETTINGS", "available", "prepare"]

# Number of directions that a thread evaluates at once. The value was chosen because larger arrays exceed the caches of
# the processor, and with smaller arrays the overhead of the Python interpreter dominates.
CHUNK = 512


def available() -> str | None:
    """Return None, which means that the program can run: NumPy is always installed."""
    return None


def prepare(heightfield: wd.HeightField, coherence: wd.Coherence, **setting: Any) -> Callable[..., NDArray[np.float32]]:
    """Return a function that computes colours of directions, for one setting of :func:`bench.peers.series.series`.

    Args:
        heightfield: Height field.
        coherence: Gaussian coherence window, of the kind averaged or centred.
        setting: One of ``SETTINGS``: numbers of wavelengths, of terms and of neighbouring Fourier coefficients.

    Returns:
        A function ``shade(scattering_vectors, gains, threads)`` of arrays (n, 3) and (n,) that returns XYZ (n, 3).
    """
    made = series(heightfield, coherence, **setting)

    def shade(scattering_vectors: NDArray[np.float64], gains: NDArray[np.float64], threads: int) -> NDArray[np.float32]:
        xyz = np.empty((len(gains), 3), dtype=np.float32)

        def run(first: int) -> None:
            part = slice(first, first + CHUNK)
            xyz[part] = gains[part, None] * _chunk(made, scattering_vectors[part])

        with ThreadPoolExecutor(max_workers=threads) as pool:
            list(pool.map(run, range(0, len(gains), CHUNK)))
        return xyz

    return shade


def _chunk(made: Series, scattering_vectors: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return XYZ of one chunk of directions, before multiplication by geometry factors (gains)."""
    terms = made.rows.shape[2]
    # Arrays of positions and weights of Fourier coefficients have the shape (directions, wavelengths, coefficients
    # along one axis).
    offsets = np.arange(-made.neighbour_extent, made.neighbour_extent + 1, dtype=np.float32)
    near, gaussians = [], []
    for axis, (length, falloff) in enumerate(zip(made.lengths_um, made.falloff, strict=True)):
        q = np.float32(scattering_vectors[:, 1 - axis] * length)[:, None] * made.wavenumbers
        nearest = np.floor(q + np.float32(made.shift))
        near.append(nearest.astype(np.intp) + made.origin[axis])
        gaussians.append(np.exp(np.float32(-falloff) * ((nearest - q)[:, :, None] + offsets) ** 2))
    middle = near[0] * made.columns + near[1]
    square = (offsets[:, None] * made.columns + offsets).ravel().astype(np.intp)
    w_powers = np.float32(scattering_vectors[:, 2])[:, None] ** np.arange(terms, dtype=np.float32)
    result = np.zeros((len(scattering_vectors), 3), dtype=np.float32)
    for k, colour in enumerate(made.colours):
        rows = made.rows.take(middle[:, k, None] + square, axis=0)
        basis = made.factors[k] * w_powers
        amplitudes = np.matmul(rows.reshape(len(basis), -1, terms), basis[:, :, None]).reshape(len(basis), -1, 2)
        weights = (gaussians[0][:, k, :, None] * gaussians[1][:, k, None, :]).reshape(len(basis), -1)
        if made.powers:
            power = np.einsum("nac,nac,na->n", amplitudes, amplitudes, weights)
        else:
            power = np.square(np.einsum("nac,na->nc", amplitudes, weights)).sum(axis=1)
        result += power[:, None] * colour
    return result
