"""Cleaning of arrays of heights (ny, nx): levelling, dust removal, cropping, resampling, and matching of edges."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Largest memory that methods of `HeightField` require, by the name of the method [bytes per sample of the field]. The
# numbers were measured, and do not include the memory of the field. If doubled, fields are refused that would fit into
# memory.
_BYTES_PER_SAMPLE = {
    "levelled": 34.0, "despiked": 88.0, "periodic": 62.0, "periods": 107.0, "whole_periods": 107.0, "roughness": 115.0,
}  # fmt: skip
# `HeightField.periodic` makes opposite edges match by subtracting the smooth part of Moisan's decomposition. Opposite
# edges count as unequal if the standard deviation of the smooth part, relative to that of the heights, exceeds this
# value. Patches with many features have a smaller ratio. If doubled, large changes of the surface happen without a
# warning.
MOST_CHANGE = 0.4


def require_memory(method: str, shape: tuple[int, int]) -> None:
    """Raise ``MemoryError`` if a method of `HeightField` requires more memory than is free."""
    ny, nx = shape
    memory.require_memory(
        _BYTES_PER_SAMPLE[method] * ny * nx, f"{ref(f'{method}()')} of a field of {ny} × {nx} samples",
        f"take {{share}} of its area, by {ref('cropped()')}, or a coarser pitch",
    )  # fmt: skip


def level(heights: NDArray[np.float64], missing: NDArray[np.bool_], order: int) -> NDArray[np.float64]:
    """Return heights minus the least-squares polynomial of total degree ``order`` in x and y."""
    # The fitted functions are products of orthonormal polynomials in y and in x. If no sample is missing, these
    # products are orthonormal too. Their scalar products with the heights are then the least-squares coefficients,
    # without a system of equations.
    along_y, along_x = (_polynomials(n, order) for n in heights.shape)
    with single_threaded_blas():
        coefficients = along_y.T @ np.where(missing, 0.0, heights) @ along_x
        fitted = np.add.outer(np.arange(along_y.shape[1]), np.arange(along_x.shape[1])) <= order
        if missing.any():
            # If samples are missing, the fitted polynomials are not orthogonal on the known samples. Their scalar
            # products then make a small system of equations, which is solved.
            squares = [(base[:, :, None] * base[:, None, :]) for base in (along_y, along_x)]
            products = np.einsum("yab,yx,xcd->acbd", squares[0], ~missing, squares[1], optimize=True)
            coefficients[fitted] = np.linalg.lstsq(products[fitted][:, fitted], coefficients[fitted], rcond=None)[0]
        coefficients[~fitted] = 0.0
        trend = along_y @ coefficients @ along_x.T
    return np.asarray(heights - trend)


def _polynomials(samples: int, order: int) -> NDArray[np.float64]:
    """Return polynomials of increasing degree, orthonormal on equally spaced samples, shape (samples, number)."""
    x = np.linspace(-1.0, 1.0, samples) if samples > 1 else np.zeros(1)
    return np.linalg.qr(np.polynomial.legendre.legvander(x, min(order, samples - 1)))[0]


def despike(
    measured: NDArray[np.float64], missing: NDArray[np.bool_], pitch_um: tuple[float, float], threshold: float,
    size_um: float,
) -> NDArray[np.float64]:  # fmt: skip
    """Return heights in which dust and other narrow elevations are replaced, see `HeightField.despiked`."""
    from scipy import ndimage

    coarsest = max((pitch for n, pitch in zip(measured.shape, pitch_um, strict=True) if n > 1), default=0.0)
    if size_um < coarsest:
        raise ArgumentValueError(
            f"{ref('size_um')} must be at least the pitch of {coarsest:.4g} µm, got {size_um:.4g}: the background is "
            f"an average over neighbouring samples; give {ref('size_um', float(f'{2.0 * coarsest:.3g}'))} or more"
        )
    heights = np.where(missing, 0.0, measured)
    spikes = np.zeros(heights.shape, dtype=bool)
    for _ in range(3):
        known = ~(spikes | missing)
        valid = known.astype(np.float64)
        weight = np.maximum(_blurred(valid, pitch_um, size_um), 1e-9)
        residual = heights - _blurred(heights * valid, pitch_um, size_um) / weight
        lower, median, upper = np.quantile(residual[known], (0.025, 0.5, 0.975))
        scale = max(upper - median, median - lower) / 1.96
        # On a flat field, the differences between the heights and the smooth background are only rounding errors of the
        # convolution. Such a field has no spikes.
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
        # Spikes are filled by Gaussian averages of decreasing width. If a narrow Gaussian around a spike covers hardly
        # any known height, the average of the wider Gaussian remains.
        weight = np.maximum(_blurred(valid, pitch_um, spread), 0.0)
        filled = (_blurred(heights * valid, pitch_um, spread) + 0.02 * filled) / (weight + 0.02)
    if known.any():
        # The filled heights are weighted means of known heights and therefore lie between the smallest and the largest
        # of them. Rounding errors of the Fourier transforms may move a mean outside of this range, so that it is
        # clipped to the range.
        filled = np.clip(filled, np.min(heights[known]), np.max(heights[known]))
    return np.where(spikes, filled, measured)


@np.errstate(under="ignore")
def _blurred(values: NDArray[np.float64], pitch_um: tuple[float, float], spread_um: float) -> NDArray[np.float64]:
    """Convolve ``values`` (ny, nx) with a Gaussian; values outside the field count as zero.

    The Gaussian is sampled in space, where it is positive at every pitch. If it were sampled in the frequency domain,
    it would become a sinc with negative lobes at a coarse pitch.
    """
    from scipy import fft

    # The convolution by Fourier transforms is periodic. Zeros are appended over four standard deviations of the
    # Gaussian, so that samples at one edge do not affect those at the opposite edge.
    padded = tuple(
        1 if n == 1 else fft.next_fast_len(n + math.ceil(min(4.0 * spread_um / pitch, n)), real=True)
        for n, pitch in zip(values.shape, pitch_um, strict=True)
    )
    kernels = [
        np.exp(-0.5 * (np.fft.fftfreq(n, 1.0 / n) * pitch / spread_um) ** 2)
        for n, pitch in zip(padded, pitch_um, strict=True)
    ]
    spectrum = np.fft.rfft2(values, padded)
    # The convolution kernels along both axes are symmetric, so that their Fourier transforms are real.
    spectrum *= np.fft.fft(kernels[0]).real[:, None] / np.sum(kernels[0])
    spectrum *= np.fft.rfft(kernels[1]).real / np.sum(kernels[1])
    return np.fft.irfft2(spectrum, padded)[: values.shape[0], : values.shape[1]]


def smooth_part(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smooth part of Moisan's decomposition, which `HeightField.periodic` subtracts.

    At each edge of the field, the smooth part has half of the jump between opposite edges.
    """
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


def crop(
    heights: NDArray[np.float64], pitch_um: tuple[float, float], size_um: object, offset_um: object
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Return the heights in a rectangle, and the first row and column of the rectangle; see `HeightField.cropped`.

    The result is a view of the array ``heights``, not a copy.
    """
    size = validation.pair(size_um, "size_um")
    if offset_um is not None and not (validation.is_sequence(offset_um) and len(offset_um) == 2):
        raise ArgumentValueError(f"{ref('offset_um')} must be a pair (y, x) or None, got {offset_um!r}")
    slices: list[slice] = []
    for axis, name in enumerate("yx"):
        samples, pitch = heights.shape[axis], pitch_um[axis]
        if samples == 1:
            slices.append(slice(0, 1))
            continue
        count = round(size[axis] / pitch)
        if count < 1 or count > samples:
            raise ArgumentValueError(
                f"{ref('size_um')} along {name} must be from {pitch:.4g} to {samples * pitch:.4g}, got {size[axis]:.6g}"
            )
        first = (samples - count) // 2
        if validation.is_sequence(offset_um):
            first = round(validation.number(offset_um[axis], f"offset_um[{axis}]") / pitch)
        if first < 0 or first + count > samples:
            raise ArgumentValueError(
                f"{ref('offset_um')} along {name} must be from 0 to {(samples - count) * pitch:.4g} for this size, "
                f"got {first * pitch:.6g}"
            )
        slices.append(slice(first, first + count))
    return heights[slices[0], slices[1]], (slices[0].start, slices[1].start)


def resample(
    heights: NDArray[np.float64], pitch_um: tuple[float, float], new_pitch_um: object
) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Return heights at the nearest possible pitch to ``new_pitch_um``, and this pitch, see `HeightField.resampled`."""
    requested = validation.pair(new_pitch_um, "pitch_um")
    actual = list(pitch_um)
    for axis, name in enumerate("yx"):
        samples = heights.shape[axis]
        size = samples * pitch_um[axis]
        if samples == 1:
            continue
        count = round(size / requested[axis])
        if count < 1:
            raise ArgumentValueError(
                f"{ref('pitch_um')} along {name} must be at most the size {size:.4g}, got {requested[axis]:.6g}"
            )
        if count != samples:
            memory.require_samples(
                heights.size // samples,
                count,
                f"take a {ref('pitch_um')} along {name} that is larger by 1/{{share}}",
            )
            heights = resample_axis(heights, count, axis)
            actual[axis] = size / count
    return heights, (actual[0], actual[1])


def resample_axis(heights: NDArray[np.float64], count: int, axis: int) -> NDArray[np.float64]:
    """Resample one axis of a periodic real array to ``count`` samples by its Fourier series."""
    old_count = heights.shape[axis]
    spectrum = np.moveaxis(np.fft.rfft(heights, axis=axis), axis, -1)
    common = min(old_count, count)
    result = np.zeros((*spectrum.shape[:-1], count // 2 + 1), dtype=np.complex128)
    result[..., : common // 2 + 1] = spectrum[..., : common // 2 + 1]
    if common % 2 == 0:
        # The Fourier coefficient at the Nyquist limit of the coarser sampling represents both frequencies ±common/2. In
        # the Fourier series of the finer sampling, the coefficient at this frequency represents only one of them. It is
        # therefore halved from the coarser to the finer sampling, and doubled in the other direction.
        result[..., common // 2] *= 0.5 if count > old_count else 2.0
    resampled = np.fft.irfft(result, count, axis=-1) * (count / old_count)
    return np.moveaxis(resampled, -1, axis)
