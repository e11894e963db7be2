"""Height fields: loading, levelling, removing dust, filling, cropping, resampling, making periodic, and describing.

A sample ``heights_um[j, i]`` lies at x = i·dx, y = j·dy. Pairs are in the order (y, x), lengths in µm. Every
transform returns a new `HeightField`.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from warpdiff.core import forks, memory, openimageio, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.heightfield import inpainting, periods, scalar_validity, unit_check
from warpdiff.optics.colorimetry import LAMBDA_MIN_NM

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray


# What methods take of a sample, as measured, besides the field itself, and what making one from an array does; a file's
# samples are there besides, in their own type.
_BYTES_A_SAMPLE = {
    "levelled": 34.0, "despiked": 88.0, "periodic": 62.0, "periods": 107.0, "whole_periods": 107.0,
    "dominant_periods_um": 49.0,
}  # fmt: skip
_BYTES_MADE, _BYTES_READ = 13.0, 28.0
_BYTES_A_GAP = 700.0
_SAMPLES_AT_ONCE = 2**18
# Of periods that a summary tells.
_MOST_STANDARD_ERROR, _LEAST_SHARE = 0.01, 0.01
# Of periodic(): the root mean square, over the heights' standard deviation, that passes without a word.
_MOST_CHANGE = 0.4


@dataclass(frozen=True)
class HeightFieldSummary:
    """Contents of a height field, and how far it can be trusted; `str` of it is a few lines to print.

    Attributes:
        shape: Samples (ny, nx).
        size_um: Extent (Ly, Lx) [µm].
        pitch_um: Distance of the samples (dy, dx) [µm].
        height_range_um: Highest minus lowest height [µm].
        rms_um: Standard deviation of the heights [µm].
        rms_slope: Root mean square of the slope (a ratio).
        mean_slope: Mean absolute slope (a ratio), which walls change no more than their height.
        periods: What repeats: those of `HeightField.periods` that are no waviness, have a standard error of 1 % at most
            and explain 1 % of the variance at least. Of a field that is one period there are none.
        max_uv: Largest component of (u, v) = −ωi − ωr that the pitch supports at 380 nm: λ / (2 · pitch). From 2 on
            the whole hemisphere of lights and views is free of aliasing.
        scalar_error: How wrong scalar diffraction can be at 550 nm, see `validity.error_bound`.
        missing: Number of samples without a height.
    """

    shape: tuple[int, int]
    size_um: tuple[float, float]
    pitch_um: tuple[float, float]
    height_range_um: float
    rms_um: float
    rms_slope: float
    mean_slope: float
    periods: tuple[periods.Period, ...]
    max_uv: float
    scalar_error: float
    missing: int

    def __str__(self) -> str:
        """Return the summary as lines of text."""
        ny, nx = self.shape
        repeats = ", ".join(map(str, self.periods)) or "none that it holds three of"
        slope_deg = math.degrees(math.atan(self.rms_slope))
        supported = "the whole hemisphere" if self.max_uv >= 2.0 else f"|u|, |v| up to {self.max_uv:.2f}"
        share = 100.0 * self.missing / (nx * ny)
        gaps = [f"missing           {self.missing} samples ({share:.2g} %)"] if self.missing else []
        return "\n".join(
            [
                f"size              {self.size_um[1]:.4g} × {self.size_um[0]:.4g} µm (x × y), {nx} × {ny} samples",
                f"pitch             {1e3 * self.pitch_um[1]:.4g} × {1e3 * self.pitch_um[0]:.4g} nm (x × y)",
                *gaps,
                f"height range      {self.height_range_um:.4g} µm, rms {self.rms_um:.4g} µm",
                f"slope             rms {self.rms_slope:.3g} ({slope_deg:.1f}°), mean {self.mean_slope:.3g}",
                f"periods           {repeats}",
                f"supports          {supported} at {LAMBDA_MIN_NM} nm",
                f"scalar theory     {scalar_validity.told(self.scalar_error)}",
            ]
        )


class HeightField:
    """One period (or one patch) of a surface, as heights on a regular grid; immutable.

    Two height fields are equal only if they are the same object, so that one can be a key of a dictionary.

    Samples may be missing, as where a profilometer had no signal. What is measured and described here leaves them out;
    what is rendered or evaluated must have none, see `filled`.

    Args:
        heights_um: Surface heights [µm], shape (ny, nx), rows along y. It is copied. One row is a one-dimensional
            grating, constant along y. NaN, or masked in a ``numpy.ma.MaskedArray``, is a missing sample.
        pitch_um: Distance of the samples [µm], one number or a pair (dy, dx).

    Warns:
        WarpdiffWarning: The scale is no diffracting surface's, as where heights are in another unit than the pitch: a
            range below 0.1 nm that is not 0 or above the size, or a mean slope above 5.

    Raises:
        TypeError: An argument is not numeric.
        ValueError: The heights are not a non-empty 2-D array, hold infinities or nothing but missing samples, or the
            pitch is not positive.
    """

    def __init__(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        self._take(heights_um, pitch_um)
        unit_check.warn_of_scale(self)

    @classmethod
    def of_known_scale(cls, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> HeightField:
        """Make one whose scale is meant, whatever it is: without a warning."""
        field = cls.__new__(cls)
        field._take(heights_um, pitch_um)
        return field

    def _take(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        """Check and keep the arguments."""
        if isinstance(heights_um, np.ndarray) and heights_um.ndim == 2:
            ny, nx = heights_um.shape
            memory.require_memory(
                _BYTES_MADE * ny * nx,
                f"heights_um of {ny} × {nx} samples",
                "take {share} of the area, or a coarser pitch",
            )
        heights = validation.finite_array(heights_um, "heights_um", ndim=2, gaps=True, most=validation.MOST)
        if heights.size == 0:
            raise ValueError(f"heights_um must hold at least one sample, got shape {heights.shape}")
        missing = np.isnan(heights)
        if missing.all():
            raise ValueError(f"heights_um must hold at least one height, got {heights.size} NaN or masked sample(s)")
        for array in (heights, missing):
            array.setflags(write=False)
        self._heights_um, self._missing = heights, missing
        # Every call of a picture asks for them.
        self._missing_count = int(np.count_nonzero(missing))
        self._height_range_um = float(np.nanmax(heights) - np.nanmin(heights))
        self._pitch_um = validation.pair(pitch_um, "pitch_um")

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        extent_um: float | None = None,
        pitch_um: float | tuple[float, float] | None = None,
        height_range_um: float | None = None,
    ) -> HeightField:
        """Read a height field from a grey image (any format OpenImageIO reads) or a NumPy ``.npy`` file.

        Rows are taken in the file's order, not flipped. Integer samples say nothing of their unit: their type's full
        scale (255 or 65535) is taken as ``height_range_um``, even if the file does not use all of it. Floating-point
        samples are heights in µm; NaN is a missing one.

        Args:
            path: The file.
            extent_um: Width of the image along x [µm]; samples are then square.
            pitch_um: Distance of the samples [µm], one number or a pair (dy, dx); give this or ``extent_um``.
            height_range_um: Height of the integer type's full scale [µm]; for integer samples only.

        Returns:
            The heights, float64, shape (ny, nx).

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file cannot be read, is a colour image, is not two-dimensional, holds infinities, or the
                scale is missing or given twice.
        """
        if (extent_um is None) == (pitch_um is None):
            given = "neither" if extent_um is None else "both"
            raise ValueError(
                f"give exactly one of extent_um (width along x) and pitch_um (a sample's size), got {given}"
            )
        file = validation.path(path, "path")
        if not file.exists():
            raise FileNotFoundError(f"path: there is no file {str(file)!r}; check the name and the working directory")
        if not file.is_file():
            raise ValueError(f"path: {str(file)!r} is not a file; give a grey image or a .npy file")
        samples = _read_npy(file) if file.suffix.lower() == ".npy" else _read_image(file)
        heights = _in_micrometres(samples, file, height_range_um)
        if extent_um is not None:
            pitch_um = validation.positive(extent_um, "extent_um") / heights.shape[1]
        pitch = validation.pair(pitch_um, "pitch_um")
        try:
            return cls(heights, pitch)
        except ValueError as error:
            raise ValueError(f"path: {str(file)!r}: {error}") from None

    @property
    def heights_um(self) -> NDArray[np.float64]:
        """Heights [µm], shape (ny, nx), read-only; NaN where a sample is missing."""
        return self._heights_um

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Where samples are missing, shape (ny, nx), read-only."""
        return self._missing

    @property
    def pitch_um(self) -> tuple[float, float]:
        """Distance of the samples (dy, dx) [µm]."""
        return self._pitch_um

    @property
    def shape(self) -> tuple[int, int]:
        """Number of samples (ny, nx)."""
        ny, nx = self._heights_um.shape
        return ny, nx

    @property
    def size_um(self) -> tuple[float, float]:
        """Extent (Ly, Lx) [µm]: samples times pitch, which is one period of a periodic field."""
        return self.shape[0] * self.pitch_um[0], self.shape[1] * self.pitch_um[1]

    @property
    def height_range_um(self) -> float:
        """Highest minus lowest height [µm]."""
        return self._height_range_um

    @forks.cached_property
    @np.errstate(under="ignore")
    def rms_um(self) -> float:
        """Standard deviation of the heights [µm]."""
        return float(np.std(self._known()))

    @property
    @np.errstate(under="ignore")
    def rms_slope(self) -> float:
        """Root mean square of the slope between neighbouring samples, without those across the edges."""
        total = 0.0
        for axis in (0, 1):
            if self.shape[axis] > 1:
                total += _mean_known((np.diff(self._heights_um, axis=axis) / self.pitch_um[axis]) ** 2)
        return math.sqrt(total)

    @forks.cached_property
    @np.errstate(under="ignore")
    def mean_slope(self) -> float:
        """Mean absolute slope between neighbouring samples of the periodic field, across the edges as well."""
        heights, (dy, dx), ny = self._heights_um, self.pitch_um, self.shape[0]
        total, count = 0.0, 0
        # A large field's slopes do not fit beside it. An axis of one sample has no neighbour but itself.
        for rows in np.array_split(np.arange(ny), -(-heights.size // _SAMPLES_AT_ONCE)):
            block = heights[rows]
            along_y, along_x = heights[(rows + 1) % ny] - block, np.roll(block, -1, axis=1) - block
            slopes = np.sqrt((along_y / dy) ** 2 + (along_x / dx) ** 2)
            known = slopes[~np.isnan(slopes)]
            total, count = total + float(np.sum(known)), count + known.size
        return total / count if count else 0.0

    def __repr__(self) -> str:
        ny, nx = self.shape
        ly, lx = self.size_um
        gaps = f", {self._missing_count} missing" if self._missing_count else ""
        return (
            f"HeightField({ny} × {nx} samples (y × x), {ly:.4g} × {lx:.4g} µm, "
            f"height range {self.height_range_um:.4g} µm{gaps})"
        )

    def filled(self) -> HeightField:
        """Fill missing samples with the harmonic surface through those around them, as a soap film spans a frame.

        There the five-point Laplacian vanishes, and no slope crosses the field's edges (Laplace's equation; the
        membrane of inpainting). Filled heights lie between the lowest and the highest ones around a gap, and a plane is
        met exactly in a gap that does not touch the edges. In one that fits between two lines w apart no sample is off
        by more than w²/8 of the largest Laplacian of the true heights. Level and despike first: a bump beside a gap
        reaches into it.

        Returns:
            The field without gaps, of the same shape; samples that are not missing keep their values exactly.
        """
        memory.require_memory(
            _BYTES_A_GAP * self._missing_count, f"filled() of {self._missing_count} missing samples",
            "take {share} of the field, by cropped(), or a coarser pitch",
        )  # fmt: skip
        return HeightField.of_known_scale(inpainting.harmonic(self._heights_um, self.pitch_um), self.pitch_um)

    def levelled(self, order: int = 1) -> HeightField:
        """Subtract the least-squares polynomial of total degree ``order``: tilt (1), bow (2), or the mean alone (0).

        Args:
            order: Highest total degree; along an axis of n samples it is n − 1 at most.

        Returns:
            Heights of zero mean.

        Raises:
            ValueError: ``order`` is negative.
        """
        order = validation.count(order, "order", least=0)
        self._require_memory("levelled")
        # Tensor products of bases that are orthonormal on the samples are orthonormal: without gaps projections are the
        # least-squares solution, with no system to solve and none to be ill-conditioned.
        along_y, along_x = (_polynomials(n, order) for n in self.shape)
        with single_threaded_blas():
            coefficients = along_y.T @ np.where(self.missing, 0.0, self._heights_um) @ along_x
            taken = np.add.outer(np.arange(along_y.shape[1]), np.arange(along_x.shape[1])) <= order
            if self._missing_count:
                # Gaps make them oblique; their scalar products over the samples that are there are a few.
                squares = [(base[:, :, None] * base[:, None, :]) for base in (along_y, along_x)]
                products = np.einsum("yab,yx,xcd->acbd", squares[0], ~self.missing, squares[1], optimize=True)
                coefficients[taken] = np.linalg.lstsq(products[taken][:, taken], coefficients[taken], rcond=None)[0]
            coefficients[~taken] = 0.0
            trend = along_y @ coefficients @ along_x.T
        return HeightField.of_known_scale(self._heights_um - trend, self.pitch_um)

    def despiked(self, threshold: float = 3.0, *, size_um: float = 1.0) -> HeightField:
        """Remove dust grains and bright scratches: what stands out of the surface is replaced from its surroundings.

        A sample's score is its height above a smooth background (a normalised Gaussian convolution of spread
        ``size_um`` that leaves out the spikes found so far; three rounds), in units of a robust scale: the distance
        from the median of those heights to their 2.5 % or 97.5 % quantile, whichever is larger, over 1.96. That is
        the standard deviation for Gaussian roughness; the usual median absolute deviation is zero for a rectangular
        grating, and would flag all its ridges. Samples above ``threshold`` and their connected surroundings above 0.8
        of it, slightly dilated, are filled by normalised convolutions from coarse to fine (Knutsson and Westin 1993).
        Only elevations are removed: pits and cracks belong to the surface, and the deepest points of a relief often
        look like them.

        Level the field first, as tilt counts as height. Samples that are not replaced keep their values exactly, so
        ``np.mean(after.heights_um != before.heights_um)`` is the share replaced where none are missing. Elevations that
        belong to the surface and cover less than some 3 % of it are taken for dust.

        Args:
            threshold: Score from which a sample is a spike, > 0.
            size_um: Spread of the background [µm], about the distance of the surface's own features.

        Returns:
            The cleaned field, of the same shape; unchanged where nothing stands out.

        Raises:
            ValueError: An argument is not positive.
        """
        from scipy import ndimage

        threshold = validation.positive(threshold, "threshold")
        size = validation.positive(size_um, "size_um")
        self._require_memory("despiked")
        heights = np.where(self.missing, 0.0, self._heights_um)
        spikes = np.zeros(self.shape, dtype=bool)
        for _ in range(3):
            known = ~(spikes | self.missing)
            valid = known.astype(np.float64)
            weight = np.maximum(self._blurred(valid, size), 1e-9)
            residual = heights - self._blurred(heights * valid, size) / weight
            lower, median, upper = np.quantile(residual[known], (0.025, 0.5, 0.975))
            scale = max(upper - median, median - lower) / 1.96
            # Rounding noise of the convolution must not become a scale: on a flat field nothing stands out.
            if scale <= 1e-9 * max(float(np.max(np.abs(heights))), 1e-9):
                break
            score = np.where(self.missing, 0.0, (residual - median) / scale)
            found = ndimage.binary_propagation(score > threshold, mask=score > 0.8 * threshold)
            if np.array_equal(found, spikes):
                break
            spikes = found
        if not spikes.any():
            return HeightField.of_known_scale(self._heights_um, self.pitch_um)
        spikes |= self._blurred(spikes.astype(np.float64), 0.1 * size) > 0.02
        spikes &= ~self.missing
        known = ~(spikes | self.missing)
        valid = known.astype(np.float64)
        filled = np.full(self.shape, np.mean(heights[known]) if known.any() else np.mean(self._known()))
        for spread in size * 2.0 ** np.arange(1, -4, -1):
            # Where a fine scale sees next to nothing, the coarser one's value stands.
            weight = np.maximum(self._blurred(valid, spread), 0.0)
            filled = (self._blurred(heights * valid, spread) + 0.02 * filled) / (weight + 0.02)
        return HeightField.of_known_scale(np.where(spikes, filled, self._heights_um), self.pitch_um)

    def cropped(
        self, size_um: float | tuple[float, float], *, offset_um: tuple[float, float] | None = None
    ) -> HeightField:
        """Cut out a rectangle, rounded to whole samples; an axis of one sample is kept as it is.

        Args:
            size_um: Extent of the result [µm], one number or a pair (y, x).
            offset_um: Position (y, x) of its first sample [µm]; None centres it.

        Returns:
            The rectangle, at the same pitch.

        Raises:
            ValueError: The rectangle is smaller than a sample, reaches outside of the field, or holds no height.
        """
        size = validation.pair(size_um, "size_um")
        if offset_um is not None and not (validation.is_sequence(offset_um) and len(offset_um) == 2):
            raise ValueError(f"offset_um must be a pair (y, x) or None, got {offset_um!r}")
        slices: list[slice] = []
        for axis, name in enumerate("yx"):
            have, pitch = self.shape[axis], self.pitch_um[axis]
            if have == 1:
                slices.append(slice(0, 1))
                continue
            wanted = round(size[axis] / pitch)
            if wanted < 1 or wanted > have:
                raise ValueError(
                    f"size_um along {name} must be from {pitch:.4g} to {have * pitch:.4g}, got {size[axis]:.6g}"
                )
            first = (have - wanted) // 2
            if offset_um is not None:
                first = round(validation.number(offset_um[axis], f"offset_um[{axis}]") / pitch)
            if first < 0 or first + wanted > have:
                raise ValueError(
                    f"offset_um along {name} must be from 0 to {(have - wanted) * pitch:.4g} for this size, "
                    f"got {first * pitch:.6g}"
                )
            slices.append(slice(first, first + wanted))
        return HeightField.of_known_scale(self._heights_um[slices[0], slices[1]], self.pitch_um)

    def resampled(self, pitch_um: float | tuple[float, float]) -> HeightField:
        """Interpolate, or band-limit, to another pitch by Fourier series, as one period of a periodic surface.

        Args:
            pitch_um: The pitch wanted [µm], one number or a pair (dy, dx). The actual one is the nearest that divides
                the size, which is kept exactly; an axis of one sample is kept as it is.

        Returns:
            The field with round(L / pitch) samples along each axis.

        Raises:
            ValueError: The pitch is not positive, or larger than the field, or samples are missing.
        """
        pitch = validation.pair(pitch_um, "pitch_um")
        check_whole(self)
        heights = self._heights_um
        actual = list(self.pitch_um)
        for axis, name in enumerate("yx"):
            have, size = self.shape[axis], self.size_um[axis]
            if have == 1:
                continue
            wanted = round(size / pitch[axis])
            if wanted < 1:
                raise ValueError(f"pitch_um along {name} must be at most the size {size:.4g}, got {pitch[axis]:.6g}")
            if wanted != have:
                memory.require_samples(
                    heights.size // have, wanted, f"take a pitch_um along {name} that is larger by 1/{{share}}"
                )
                heights = _resampled_axis(heights, wanted, axis)
                actual[axis] = size / wanted
        return HeightField.of_known_scale(heights, (actual[0], actual[1]))

    def periodic(self) -> HeightField:
        """Make opposite edges match, so that the spectrum has no bright cross along its axes.

        The periodic part of Moisan's periodic-plus-smooth decomposition (2011, J. Math. Imaging Vis. 39, 161–179):
        a smooth field, harmonic but for the edges where it takes up half of their jump each, is subtracted. Size and
        mean stay as they are. Level and despike first, as the less there is to take up the less is changed; a field
        that is periodic already does not need it and would be changed a little, and a grating of few periods is bent:
        `whole_periods` cuts it instead.

        Missing samples stay so; at the edges they count as `filled` ones.

        Returns:
            The periodic part, of the same shape.

        Warns:
            WarpdiffWarning: Heights change by more than 0.4 of their standard deviation, root mean square.
        """
        self._require_memory("periodic")
        heights = self.filled().heights_um
        ny, nx = self.shape
        jumps = np.zeros(self.shape)
        across_y = heights[0] - heights[-1]
        across_x = heights[:, 0] - heights[:, -1]
        jumps[0] += across_y
        jumps[-1] -= across_y
        jumps[:, 0] += across_x
        jumps[:, -1] -= across_x
        laplacian = (
            4.0
            - 2.0 * np.cos(2.0 * np.pi * np.fft.fftfreq(ny))[:, None]
            - 2.0 * np.cos(2.0 * np.pi * np.fft.rfftfreq(nx))
        )
        laplacian[0, 0] = 1.0
        spectrum = np.fft.rfft2(jumps) / laplacian
        spectrum[0, 0] = 0.0
        smooth = np.fft.irfft2(spectrum, self.shape)
        result = HeightField.of_known_scale(self._heights_um - smooth, self.pitch_um)
        change = float(np.sqrt(np.mean(smooth[~self.missing] ** 2)))
        if change > _MOST_CHANGE * self.rms_um:
            warn(
                f"periodic() changed heights by {change:.3g} µm (root mean square), {100.0 * change / self.rms_um:.0f} "
                f"% of their standard deviation, and their range from {self.height_range_um:.3g} to "
                f"{result.height_range_um:.3g} µm; level the field first, or cut it by whole_periods()"
            )
        return result

    def whole_periods(self) -> HeightField:
        """Cut the field to whole periods of its strongest wave, so that opposite edges match but for rounding.

        That is the strongest of `periods` that is no waviness. Along each axis the largest number of periods is kept,
        to the nearest sample; an axis along which the wave drifts by less than a period stays as it is. Cut before
        levelling: a plane that is fitted to parts of periods is tilted.

        Returns:
            The part from the first sample on, at the same pitch.

        Raises:
            ValueError: There is no such wave.
        """
        self._require_memory("whole_periods")
        return periods.whole(self)

    def periods(self, count: int = 3) -> tuple[periods.Period, ...]:
        """Fit the strongest periods: waves of any length and direction with their harmonics, by least squares.

        One after the other, each to what the ones before leave over, with a tilt. Missing samples count for nothing. A
        length is found to a small part of what a Fourier coefficient resolves, and has a standard error. Of one period,
        as `gratings` make it, nothing tells that it repeats: it counts as waviness.

        Args:
            count: How many at most; what explains less than 0.1 % of the variance is none.

        Returns:
            Periods, those that explain most first; empty for a flat field.

        Raises:
            ValueError: ``count`` is less than 1.
        """
        count = validation.count(count, "count")
        self._require_memory("periods")
        return periods.fitted(self, count)

    def dominant_periods_um(self, count: int = 3) -> tuple[tuple[float, float], ...]:
        """Return the strongest periods, as local maxima of |FFT(h)|² over frequencies q.

        A peak within a quarter of a stronger one's frequency is taken for a part of it. Resolution is that of the
        frequencies, one per patch; `periods` fits them. On a scan the waviness may come first: level it with a higher
        order to leave it out.

        Args:
            count: How many at most.

        Returns:
            Pairs (period [µm], direction of the wave vector from x towards y in (−90°, 90°]), strongest first; empty
            for a flat field.

        Raises:
            ValueError: ``count`` is less than 1.
        """
        count = validation.count(count, "count")
        self._require_memory("dominant_periods_um")
        ny, nx = self.shape
        along_y = np.fft.fftfreq(ny, self.pitch_um[0])[:, None]
        along_x = np.fft.fftfreq(nx, self.pitch_um[1])[None, :]
        heights = self.filled().heights_um
        power = np.abs(np.fft.fft2(heights - np.mean(heights)) / (ny * nx)) ** 2
        is_peak = power > 1e-20 * max(float(np.max(np.abs(heights))) ** 2, 1e-300)
        for shift in ((0, 1), (1, -1), (1, 0), (1, 1)):
            if (ny == 1 and shift[0]) or (nx == 1 and shift[1]):
                continue
            is_peak &= power >= np.roll(power, shift, (0, 1))
            is_peak &= power >= np.roll(power, (-shift[0], -shift[1]), (0, 1))
        # The heights are real, so of q and −q one is enough.
        is_peak &= (along_x > 0.0) | ((along_x == 0.0) & (along_y > 0.0)) | (2.0 * along_x * self.pitch_um[1] == -1.0)
        rows, columns = np.nonzero(is_peak)
        order = np.argsort(-power[rows, columns], kind="stable")
        chosen: list[tuple[float, float]] = []
        for index in order:
            q = np.array([along_y[rows[index], 0], along_x[0, columns[index]]])
            if q[1] < 0.0 or (q[1] == 0.0 and q[0] < 0.0):
                q = -q
            if all(min(math.dist(q, p), math.dist(q, (-p[0], -p[1]))) > 0.25 * math.hypot(*p) for p in chosen):
                chosen.append((float(q[0]), float(q[1])))
            if len(chosen) == count:
                break
        return tuple((1.0 / math.hypot(qy, qx), math.degrees(math.atan2(qy, qx)) + 0.0) for qy, qx in chosen)

    def summary(self) -> HeightFieldSummary:
        """Return size, pitch, range, roughness, slope, periods and the directions that the pitch supports."""
        sampled = [self.pitch_um[axis] for axis in (0, 1) if self.shape[axis] > 1]
        return HeightFieldSummary(
            shape=self.shape,
            size_um=self.size_um,
            pitch_um=self.pitch_um,
            height_range_um=self.height_range_um,
            rms_um=self.rms_um,
            rms_slope=self.rms_slope,
            mean_slope=self.mean_slope,
            periods=tuple(
                each
                for each in self.periods()
                if not each.is_waviness
                and each.standard_error_um <= _MOST_STANDARD_ERROR * each.period_um
                and each.share >= _LEAST_SHARE
            ),
            max_uv=1e-3 * LAMBDA_MIN_NM / (2.0 * max(sampled)) if sampled else math.inf,
            scalar_error=scalar_validity.error_bound(self.rms_um, self.mean_slope),
            missing=self._missing_count,
        )

    def _require_memory(self, method: str) -> None:
        """Refuse what takes more than there is."""
        ny, nx = self.shape
        memory.require_memory(
            _BYTES_A_SAMPLE[method] * ny * nx, f"{method}() of a field of {ny} × {nx} samples",
            "take {share} of its area, by cropped(), or a coarser pitch",
        )  # fmt: skip

    def _known(self) -> NDArray[np.float64]:
        """Heights that are not missing; flat if some are."""
        return self._heights_um[~self._missing] if self._missing_count else self._heights_um

    @np.errstate(under="ignore")
    def _blurred(self, values: NDArray[np.float64], spread_um: float) -> NDArray[np.float64]:
        """Convolve ``values`` (ny, nx) with a Gaussian, taking zero outside of the field."""
        from scipy import fft

        # Padding by four spreads keeps the convolution from wrapping around.
        padded = tuple(
            1 if n == 1 else fft.next_fast_len(n + math.ceil(min(4.0 * spread_um / pitch, n)), real=True)
            for n, pitch in zip(self.shape, self.pitch_um, strict=True)
        )
        factors = [
            np.exp(-2.0 * (np.pi * spread_um * frequencies(n, pitch)) ** 2)
            for n, pitch, frequencies in zip(padded, self.pitch_um, (np.fft.fftfreq, np.fft.rfftfreq), strict=True)
        ]
        spectrum = np.fft.rfft2(values, padded)
        spectrum *= factors[0][:, None]
        spectrum *= factors[1]
        return np.fft.irfft2(spectrum, padded)[: self.shape[0], : self.shape[1]]


def check_whole(heightfield: Any) -> None:
    """Refuse what is no height field, or lacks samples."""
    validation.instance(heightfield, HeightField, "heightfield")
    count = heightfield._missing_count
    if count:
        raise ValueError(
            f"heightfield must have all samples, got {count} of {heightfield.missing.size} missing (NaN or masked); fill them with "
            "heightfield.filled(), or cut out a part without gaps with heightfield.cropped()"
        )


def _mean_known(values: NDArray[np.float64]) -> float:
    """The mean of what is not NaN; 0 of nothing."""
    known = values[~np.isnan(values)]
    return float(np.mean(known)) if known.size else 0.0


def _polynomials(samples: int, order: int) -> NDArray[np.float64]:
    """Return polynomials of rising degree, orthonormal on equidistant samples, as columns of (samples, degrees)."""
    x = np.linspace(-1.0, 1.0, samples) if samples > 1 else np.zeros(1)
    return np.linalg.qr(np.polynomial.legendre.legvander(x, min(order, samples - 1)))[0]


def _resampled_axis(heights: NDArray[np.float64], wanted: int, axis: int) -> NDArray[np.float64]:
    """Resample one axis of a periodic real array to ``wanted`` samples by its Fourier series."""
    have = heights.shape[axis]
    spectrum = np.moveaxis(np.fft.rfft(heights, axis=axis), axis, -1)
    kept = min(have, wanted)
    result = np.zeros((*spectrum.shape[:-1], wanted // 2 + 1), dtype=np.complex128)
    result[..., : kept // 2 + 1] = spectrum[..., : kept // 2 + 1]
    if kept % 2 == 0:
        # The Nyquist term stands for ±kept/2 in the coarser series, but for one of the two in the finer.
        result[..., kept // 2] *= 0.5 if wanted > have else 2.0
    resampled = np.fft.irfft(result, wanted, axis=-1) * (wanted / have)
    return np.moveaxis(resampled, -1, axis)


def _read_npy(file: Path) -> NDArray[Any]:
    """Return the array in a ``.npy`` file."""
    try:
        with file.open("rb") as stream:
            shape = _shape_of_npy(stream)
    except Exception as error:
        raise _unreadable_npy(file, error) from None
    _require_for_file(file, shape)
    try:
        with file.open("rb") as stream:
            array = np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as error:
        raise _unreadable_npy(file, error) from None
    if array.ndim != 2 or array.size == 0:
        raise ValueError(f"path: {str(file)!r} has shape {array.shape}; save one array of shape (ny, nx)")
    return array


def _unreadable_npy(file: Path, error: Exception) -> ValueError:
    """Headers are Python's text, and raise whatever its parser stumbles over."""
    return ValueError(
        f"path: {str(file)!r} cannot be read as .npy ({error}); write it with numpy.save, as plain numbers"
    )


def _shape_of_npy(stream: BinaryIO) -> tuple[int, ...]:
    """The shape that a ``.npy`` file's header tells; () where less follows, or its form is not known."""
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version = np.lib.format.read_magic(stream)
    if version not in read:
        return ()
    shape, _, dtype = read[version](stream)
    begin = stream.tell()
    return shape if math.prod(shape) * dtype.itemsize <= stream.seek(0, os.SEEK_END) - begin else ()


def _require_for_file(file: Path, shape: tuple[int, ...]) -> None:
    """Refuse a file of more samples than there is memory for."""
    if len(shape) == 2:
        memory.require_memory(
            _BYTES_READ * math.prod(shape), f"path: {str(file)!r} of {shape[0]} × {shape[1]} samples",
            "take {share} of its area, or save it at a coarser pitch",
        )  # fmt: skip


def _read_image(file: Path) -> NDArray[Any]:
    """Return the samples of a grey image in the file's own type, shape (ny, nx)."""
    with openimageio.in_use() as oiio:
        image = oiio.ImageInput.open(str(file))
        if image is None:
            raise ValueError(
                f"path: {str(file)!r} cannot be read as an image ({_reason(oiio)}); give a grey image or .npy"
            )
        try:
            return _samples_of(image, file)
        finally:
            image.close()


def _samples_of(image: Any, file: Path) -> NDArray[Any]:
    """The samples of an open image, which must be one grey image."""
    spec = image.spec()
    channels = spec.nchannels
    if channels != 1:
        kind = "a grey image with alpha" if channels == 2 else f"a colour image ({channels} channels)"
        raise ValueError(f"path: {str(file)!r} is {kind}; save its heights as one grey channel, 8-bit, 16-bit or float")
    _require_for_file(file, (spec.height, spec.width))
    samples = image.read_image("unknown")  # the file's own type: nothing is converted
    if samples is None or image.has_error:
        raise ValueError(f"path: {str(file)!r} is damaged ({_reason(image)}); export the image again")
    if image.seek_subimage(1, 0):
        raise ValueError(f"path: {str(file)!r} holds several images; save the one with the heights by itself")
    return np.asarray(samples)[..., 0]


def _reason(source: Any) -> str:
    """What OpenImageIO says, as one line; it may cite the file's own bytes."""
    try:
        return " ".join(source.geterror().split())
    except UnicodeDecodeError:
        return "its header is damaged"


def _in_micrometres(samples: NDArray[Any], file: Path, height_range_um: float | None) -> NDArray[np.float64]:
    """Return samples as heights [µm]: integers by their full scale, floating-point numbers as they are."""
    if samples.dtype in (np.uint8, np.uint16):
        full = int(np.iinfo(samples.dtype).max)
        if height_range_um is None:
            raise ValueError(
                f"height_range_um must be given: {str(file)!r} has integer samples without a unit; it is the height "
                f"[µm] that the full scale 0 to {full} stands for"
            )
        scale = validation.positive(height_range_um, "height_range_um") / full
        return np.asarray(np.multiply(samples, scale, dtype=np.float64))
    if samples.dtype.kind != "f":
        raise ValueError(
            f"path: {str(file)!r} has samples of type {samples.dtype}; save uint8, uint16, or floating-point µm"
        )
    if height_range_um is not None:
        raise ValueError(
            f"height_range_um must not be given: {str(file)!r} has floating-point samples, which are in µm already"
        )
    heights = samples.astype(np.float64)
    bad = int(np.count_nonzero(np.isinf(heights)))
    if bad:
        raise ValueError(f"path: {str(file)!r} has {bad} infinite sample(s); save missing ones as NaN")
    return heights
