"""Cleaning of heights: levelling, removing dust, resampling, and the periodic part; functions of arrays (ny, nx)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.threads import single_threaded_blas

if TYPE_CHECKING:
    from numpy.typing import NDArray


def level(heights: NDArray[np.float64], missing: NDArray[np.bool_], order: int) -> NDArray[np.float64]:
    """Subtract the least-squares polynomial of total degree ``order``."""
    # Tensor products of bases that are orthonormal on the samples are orthonormal: without gaps projections are the
    # least-squares solution, with no system to solve and none to be ill-conditioned.
    along_y, along_x = (_polynomials(n, order) for n in heights.shape)
    with single_threaded_blas():
        coefficients = along_y.T @ np.where(missing, 0.0, heights) @ along_x
        fitted = np.add.outer(np.arange(along_y.shape[1]), np.arange(along_x.shape[1])) <= order
        if missing.any():
            # Gaps make them oblique; their scalar products over the known samples are a few numbers.
            squares = [(base[:, :, None] * base[:, None, :]) for base in (along_y, along_x)]
            products = np.einsum("yab,yx,xcd->acbd", squares[0], ~missing, squares[1], optimize=True)
            coefficients[fitted] = np.linalg.lstsq(products[fitted][:, fitted], coefficients[fitted], rcond=None)[0]
        coefficients[~fitted] = 0.0
        trend = along_y @ coefficients @ along_x.T
    return np.asarray(heights - trend)


def _polynomials(samples: int, order: int) -> NDArray[np.float64]:
    """Return polynomials of rising degree, orthonormal on equidistant samples, as columns of (samples, degrees)."""
    x = np.linspace(-1.0, 1.0, samples) if samples > 1 else np.zeros(1)
    return np.linalg.qr(np.polynomial.legendre.legvander(x, min(order, samples - 1)))[0]


def despike(
    measured: NDArray[np.float64], missing: NDArray[np.bool_], pitch_um: tuple[float, float], threshold: float,
    size_um: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Replace elevations that stand out of the surface, see `HeightField.despiked`."""
    from scipy import ndimage

    heights = np.where(missing, 0.0, measured)
    spikes = np.zeros(heights.shape, dtype=bool)
    for _ in range(3):
        known = ~(spikes | missing)
        valid = known.astype(np.float64)
        weight = np.maximum(_blurred(valid, pitch_um, size_um), 1e-9)
        residual = heights - _blurred(heights * valid, pitch_um, size_um) / weight
        lower, median, upper = np.quantile(residual[known], (0.025, 0.5, 0.975))
        scale = max(upper - median, median - lower) / 1.96
        # Rounding noise of the convolution must not become a scale: on a flat field nothing stands out.
        if scale <= 1e-9 * max(float(np.max(np.abs(heights))), 1e-9):
            break
        score = np.where(missing, 0.0, (residual - median) / scale)
        outliers = ndimage.binary_propagation(score > threshold, mask=score > 0.8 * threshold)
        if np.array_equal(outliers, spikes):
            break
        spikes = outliers
    if not spikes.any():
        return measured
    spikes |= _blurred(spikes.astype(np.float64), pitch_um, 0.1 * size_um) > 0.02
    spikes &= ~missing
    known = ~(spikes | missing)
    valid = known.astype(np.float64)
    filled = np.full(heights.shape, np.mean(heights[known if known.any() else ~missing]))
    for spread in size_um * 2.0 ** np.arange(1, -4, -1):
        # Where a fine scale has next to no weight, the coarser one's value stands.
        weight = np.maximum(_blurred(valid, pitch_um, spread), 0.0)
        filled = (_blurred(heights * valid, pitch_um, spread) + 0.02 * filled) / (weight + 0.02)
    return np.where(spikes, filled, measured)


@np.errstate(under="ignore")
def _blurred(values: NDArray[np.float64], pitch_um: tuple[float, float], spread_um: float) -> NDArray[np.float64]:
    """Convolve ``values`` (ny, nx) with a Gaussian, taking zero outside of the field."""
    from scipy import fft

    # Padding by four spreads keeps the convolution from wrapping around.
    padded = tuple(
        1 if n == 1 else fft.next_fast_len(n + math.ceil(min(4.0 * spread_um / pitch, n)), real=True)
        for n, pitch in zip(values.shape, pitch_um, strict=True)
    )
    factors = [
        np.exp(-2.0 * (np.pi * spread_um * frequencies(n, pitch)) ** 2)
        for n, pitch, frequencies in zip(padded, pitch_um, (np.fft.fftfreq, np.fft.rfftfreq), strict=True)
    ]
    spectrum = np.fft.rfft2(values, padded)
    spectrum *= factors[0][:, None]
    spectrum *= factors[1]
    return np.fft.irfft2(spectrum, padded)[: values.shape[0], : values.shape[1]]


def smooth_part(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what `HeightField.periodic` subtracts: a field that takes up half of the edges' jump at each edge."""
    ny, nx = heights.shape
    jumps = np.zeros(heights.shape)
    across_y = heights[0] - heights[-1]
    across_x = heights[:, 0] - heights[:, -1]
    jumps[0] += across_y
    jumps[-1] -= across_y
    jumps[:, 0] += across_x
    jumps[:, -1] -= across_x
    laplacian = (
        4.0 - 2.0 * np.cos(2.0 * np.pi * np.fft.fftfreq(ny))[:, None] - 2.0 * np.cos(2.0 * np.pi * np.fft.rfftfreq(nx))
    )
    laplacian[0, 0] = 1.0
    spectrum = np.fft.rfft2(jumps) / laplacian
    spectrum[0, 0] = 0.0
    return np.fft.irfft2(spectrum, heights.shape)


def resample_axis(heights: NDArray[np.float64], count: int, axis: int) -> NDArray[np.float64]:
    """Resample one axis of a periodic real array to ``count`` samples by its Fourier series."""
    old_count = heights.shape[axis]
    spectrum = np.moveaxis(np.fft.rfft(heights, axis=axis), axis, -1)
    common = min(old_count, count)
    result = np.zeros((*spectrum.shape[:-1], count // 2 + 1), dtype=np.complex128)
    result[..., : common // 2 + 1] = spectrum[..., : common // 2 + 1]
    if common % 2 == 0:
        # The Nyquist term stands for ±common/2 in the coarser series, but for one of the two in the finer.
        result[..., common // 2] *= 0.5 if count > old_count else 2.0
    resampled = np.fft.irfft(result, count, axis=-1) * (count / old_count)
    return np.moveaxis(resampled, -1, axis)
