"""The height field: heights on a regular grid, with methods that load, save, clean, cut and describe them.

A sample ``heights_um[j, i]`` lies at x = i·dx, y = j·dy: rows along y, columns along x. Pairs are in the order (y, x),
lengths in µm. Every transform returns a new `HeightField`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from warpdiff.core import files, forks, memory, validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, marked, ref
from warpdiff.heightfield import cleaning, diagnostics, inpainting, periods, readers

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

Axis = Literal["y", "x"]

# Memory per sample, as measured: of methods besides the field itself, and of making a field from an array.
_BYTES_PER_SAMPLE = {"levelled": 34.0, "despiked": 88.0, "periodic": 62.0, "periods": 107.0, "whole_periods": 107.0}
_BYTES_MADE, _BYTES_PER_GAP = 13.0, 700.0
_SAMPLES_AT_ONCE = 2**18
# Change by periodic(), root mean square, relative to the heights' standard deviation, from which it warns.
_MOST_CHANGE = 0.4


class HeightField:
    """One period (or one patch) of a surface, as heights on a regular grid; immutable.

    Two height fields are equal only if they are the same object, so that one can be a key of a dictionary.

    Samples may be missing, where a profilometer had no signal. Methods that measure and describe the surface exclude
    them; rendering and evaluation require all samples, see `filled`.

    Args:
        heights_um: Surface heights [µm], shape (ny, nx), rows along y. The array is copied. One row is a
            one-dimensional grating, constant along y. NaN, or a masked element of a ``numpy.ma.MaskedArray``, is a
            missing sample.
        pitch_um: Distance of the samples [µm], one number or a pair (dy, dx).

    Warns:
        WarpdiffWarning: The scale is that of no diffracting surface, which suggests a wrong unit: a height range below
            0.1 nm (but not 0) or above the size, or a mean slope above 5.

    Raises:
        TypeError: An argument is not numeric.
        ValueError: The heights are not a non-empty 2-D array, contain infinities or nothing but missing samples, or the
            pitch is not positive.
    """

    def __init__(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        self._set(heights_um, pitch_um)
        diagnostics.warn_of_scale(self)

    @classmethod
    def of_known_scale(cls, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> HeightField:
        """Make a height field without the check of its scale.

        Args:
            heights_um: Surface heights [µm], shape (ny, nx), as for the class itself.
            pitch_um: Distance of the samples [µm], one number or a pair (dy, dx).
        """
        field = cls.__new__(cls)
        field._set(heights_um, pitch_um)
        return field

    def _set(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        """Check the arguments and set the attributes."""
        if isinstance(heights_um, np.ndarray) and heights_um.ndim == 2:
            ny, nx = heights_um.shape
            memory.require_memory(
                _BYTES_MADE * ny * nx,
                f"{ref('heights_um')} of {ny} × {nx} samples",
                f"take {{share}} of the area, or a larger {ref('pitch_um')}",
            )
        heights = validation.finite_array(heights_um, "heights_um", ndim=2, gaps=True, most=validation.MOST)
        if heights.size == 0:
            raise ArgumentValueError(f"{ref('heights_um')} must have at least one sample, got shape {heights.shape}")
        missing = np.isnan(heights)
        if missing.all():
            raise ArgumentValueError(
                f"{ref('heights_um')} must have at least one height, got {heights.size} NaN or masked sample(s)"
            )
        for array in (heights, missing):
            array.setflags(write=False)
        self._heights_um, self._missing = heights, missing
        # Every call of a picture asks for them.
        self._missing_count = int(np.count_nonzero(missing))
        self._height_range_um = float(np.nanmax(heights) - np.nanmin(heights))
        self._pitch_um = validation.pair(pitch_um, "pitch_um")

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, extent_um: float | tuple[float, float] | None = None,
        pitch_um: float | tuple[float, float] | None = None, height_range_um: float | None = None,
    ) -> HeightField:  # fmt: skip
        """Read a height field from a file.

        The suffix selects the reader: ``.npz`` as :meth:`save` writes it, ``.npy``, and a grey image (any format that
        OpenImageIO reads) for every other suffix. :func:`warpdiff.heightfield.readers.register_reader` adds readers.

        Rows keep the order of the file and are not flipped. Integer samples have no unit: the full scale of their type
        (255 or 65535) stands for ``height_range_um``, even if the file does not use all of it. Floating-point samples
        are heights in µm; NaN is a missing sample.

        Args:
            path: Grey image, ``.npy`` or ``.npz`` file of heights.
            extent_um: Size of the field [µm]: one number, its width along x, for square samples, or a pair (Ly, Lx).
            pitch_um: Distance of the samples [µm], one number or a pair (dy, dx). Give exactly one of ``extent_um``
                and ``pitch_um``, and neither for a ``.npz`` file, which states its pitch.
            height_range_um: Height of the full scale of integer samples [µm]; not for floating-point samples.

        Returns:
            The height field, in float64. The scale of a ``.npz`` file is not checked.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file cannot be read, is a colour image, is not two-dimensional or contains infinities, or
                its scale is not given exactly once.
        """
        file = validation.path(path, "path")
        if not file.exists():
            raise marked(
                FileNotFoundError,
                f"{ref('path')}: there is no file {str(file)!r}; check the name and the working directory",
            )
        if not file.is_file():
            raise ArgumentValueError(f"{ref('path')}: {str(file)!r} is not a file; give a grey image, .npy or .npz")
        heights, own_pitch = readers.read(file, height_range_um)
        pitch = readers.pitch_of(file, own_pitch, heights.shape, extent_um, pitch_um)
        try:
            return cls(heights, pitch) if own_pitch is None else cls.of_known_scale(heights, pitch)
        except (ArgumentValueError, ArgumentTypeError) as error:
            raise ArgumentValueError(f"{ref('path')}: {str(file)!r}: {error}") from None

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the height field to a NumPy ``.npz`` file, which :meth:`load` restores exactly.

        The file contains the arrays ``heights_um`` (NaN where a sample is missing) and ``pitch_um`` (dy, dx). An
        existing file is replaced only once the new one is complete.

        Args:
            path: File to write; its name ends in ``.npz``.

        Returns:
            The path of the file.

        Raises:
            ValueError: The name does not end in ``.npz``.
            OSError: The folder does not exist, or the file cannot be written.
        """
        return files.save_arrays(path, {"heights_um": self._heights_um, "pitch_um": self._pitch_um}, compressed=False)

    @property
    def heights_um(self) -> NDArray[np.float64]:
        """Heights [µm], shape (ny, nx), read-only; NaN where a sample is missing."""
        return self._heights_um

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Mask of the missing samples, shape (ny, nx), read-only."""
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
        return float(np.std(self._heights_um[~self._missing] if self._missing_count else self._heights_um))

    @property
    @np.errstate(under="ignore")
    def rms_slope(self) -> float:
        """Root mean square of the slope between neighbouring samples, without those across the edges."""
        total = 0.0
        for axis in (0, 1):
            if self.shape[axis] > 1:
                squares = (np.diff(self._heights_um, axis=axis) / self.pitch_um[axis]) ** 2
                known = squares[~np.isnan(squares)]
                total += float(np.mean(known)) if known.size else 0.0
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
        (ny, nx), (dy, dx), (ly, lx) = self.shape, self.pitch_um, self.size_um
        gaps = f", {self._missing_count} missing" if self._missing_count else ""
        return (
            f"HeightField({ny} × {nx} samples (y × x), pitch {dy:.4g} × {dx:.4g} µm, size {ly:.4g} × {lx:.4g} µm, "
            f"height range {self.height_range_um:.4g} µm{gaps})"
        )

    def filled(self) -> HeightField:
        """Fill missing samples with the harmonic surface through the samples around them, like a soap film on a frame.

        The five-point Laplacian vanishes there, and no slope crosses the field's edges (Laplace's equation; membrane
        inpainting). Filled heights lie between the lowest and the highest ones around a gap, and a plane is met exactly
        in a gap that does not touch the edges. In a gap that fits between two lines w apart, no sample has an error of
        more than w²/8 of the largest Laplacian of the true heights. Level and despike first: a bump beside a gap
        reaches into it.

        Returns:
            The field without gaps, of the same shape. Samples that are not missing keep their values exactly.
        """
        memory.require_memory(
            _BYTES_PER_GAP * self._missing_count,
            f"{ref('filled()')} of {self._missing_count} missing samples",
            f"take {{share}} of the field, by {ref('cropped()')}, or a coarser pitch",
        )
        return self._with_heights(inpainting.harmonic(self._heights_um, self.pitch_um))

    def levelled(self, order: int = 1) -> HeightField:
        """Subtract the least-squares polynomial of total degree ``order``: tilt (1), bow (2), or the mean alone (0).

        Args:
            order: Highest total degree, at least 0, default 1; along an axis of n samples it is at most n − 1.

        Returns:
            The field with heights of zero mean.

        Raises:
            ValueError: ``order`` is negative.
        """
        order = validation.count(order, "order", least=0)
        self._require_memory("levelled")
        return self._with_heights(cleaning.level(self._heights_um, self._missing, order))

    def despiked(self, threshold: float = 3.0, *, size_um: float = 1.0) -> HeightField:
        """Remove dust grains and bright scratches: elevations that stand out are replaced from their surroundings.

        The score of a sample is its height above a smooth background (a normalised Gaussian convolution of spread
        ``size_um`` that excludes the spikes found so far; three rounds), in units of a robust scale: the distance
        from the median of those heights to their 2.5 % or 97.5 % quantile, whichever is larger, over 1.96. That is
        the standard deviation for Gaussian roughness; the usual median absolute deviation is zero for a rectangular
        grating, and would flag all its ridges. Samples above ``threshold`` and their connected surroundings above 0.8
        of it, slightly dilated, are filled by normalised convolutions from coarse to fine (Knutsson and Westin 1993).
        Only elevations are removed: pits and cracks belong to the surface, and the deepest points of a relief often
        look like them.

        Level the field first, as tilt counts as height. Samples that are not replaced keep their values exactly, so
        ``np.mean(after.heights_um != before.heights_um)`` is the share replaced where none are missing. Elevations that
        belong to the surface and cover less than about 3 % of it are mistaken for dust.

        Args:
            threshold: Score from which a sample is a spike, more than 0, default 3.
            size_um: Spread of the background [µm], more than 0, default 1; about the distance of the surface's own
                features.

        Returns:
            The cleaned field, of the same shape; unchanged where nothing stands out.

        Raises:
            ValueError: An argument is not positive.
        """
        threshold = validation.positive(threshold, "threshold")
        size = validation.positive(size_um, "size_um")
        self._require_memory("despiked")
        return self._with_heights(
            cleaning.despike(self._heights_um, self._missing, self.pitch_um, threshold=threshold, size_um=size)
        )

    def cropped(
        self, size_um: float | tuple[float, float], *, offset_um: tuple[float, float] | None = None
    ) -> HeightField:
        """Cut out a rectangle, rounded to whole samples; an axis of one sample stays unchanged.

        Args:
            size_um: Extent of the rectangle [µm], one number or a pair (y, x).
            offset_um: Position (y, x) of its first sample [µm]; None, the default, centres it.

        Returns:
            The rectangle, at the same pitch.

        Raises:
            ValueError: The rectangle is smaller than a sample, extends beyond the field, or has no height.
        """
        size = validation.pair(size_um, "size_um")
        if offset_um is not None and not (validation.is_sequence(offset_um) and len(offset_um) == 2):
            raise ArgumentValueError(f"{ref('offset_um')} must be a pair (y, x) or None, got {offset_um!r}")
        slices: list[slice] = []
        for axis, name in enumerate("yx"):
            samples, pitch = self.shape[axis], self.pitch_um[axis]
            if samples == 1:
                slices.append(slice(0, 1))
                continue
            count = round(size[axis] / pitch)
            if count < 1 or count > samples:
                raise ArgumentValueError(
                    f"{ref('size_um')} along {name} must be from {pitch:.4g} to {samples * pitch:.4g}, "
                    f"got {size[axis]:.6g}"
                )
            first = (samples - count) // 2
            if offset_um is not None:
                first = round(validation.number(offset_um[axis], f"offset_um[{axis}]") / pitch)
            if first < 0 or first + count > samples:
                raise ArgumentValueError(
                    f"{ref('offset_um')} along {name} must be from 0 to {(samples - count) * pitch:.4g} for this size, "
                    f"got {first * pitch:.6g}"
                )
            slices.append(slice(first, first + count))
        return self._with_heights(self._heights_um[slices[0], slices[1]])

    def flipped(self, axis: Axis) -> HeightField:
        """Mirror the field by reversing the order of its samples along one axis.

        Args:
            axis: Axis that is reversed: ``"x"`` (the order of the columns) or ``"y"`` (the order of the rows).

        Returns:
            The mirrored field, of the same shape and pitch.
        """
        return self._with_heights(
            np.flip(self._heights_um, "yx".index(validation.choice(axis, "axis", get_args(Axis))))
        )

    def rotated(self, quarter_turns: int = 1) -> HeightField:
        """Rotate the field counter-clockwise, seen from +z with x to the right and y up.

        Heights that vary along x vary along y after one quarter turn; the direction of a wave vector grows by 90°.

        Args:
            quarter_turns: Number of quarter turns, default 1; negative numbers turn clockwise.

        Returns:
            The rotated field. An odd number of quarter turns swaps the pair of pitches and the pair of sizes.
        """
        turns = validation.count(quarter_turns, "quarter_turns", least=-validation.MOST_COUNT) % 4
        pitch = self.pitch_um[::-1] if turns % 2 else self.pitch_um
        # Rows go up with y, and down for NumPy.
        return HeightField.of_known_scale(np.ascontiguousarray(np.rot90(self._heights_um, -turns)), pitch)

    def resampled(self, pitch_um: float | tuple[float, float]) -> HeightField:
        """Interpolate, or band-limit, to another pitch by Fourier series, as one period of a periodic surface.

        Args:
            pitch_um: Requested pitch [µm], one number or a pair (dy, dx). The actual pitch is the nearest one that
                divides the size, which does not change; an axis of one sample stays unchanged.

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
            samples, size = self.shape[axis], self.size_um[axis]
            if samples == 1:
                continue
            count = round(size / pitch[axis])
            if count < 1:
                raise ArgumentValueError(
                    f"{ref('pitch_um')} along {name} must be at most the size {size:.4g}, got {pitch[axis]:.6g}"
                )
            if count != samples:
                memory.require_samples(
                    heights.size // samples,
                    count,
                    f"take a {ref('pitch_um')} along {name} that is larger by 1/{{share}}",
                )
                heights = cleaning.resample_axis(heights, count, axis)
                actual[axis] = size / count
        return HeightField.of_known_scale(heights, (actual[0], actual[1]))

    def periodic(self) -> HeightField:
        """Make opposite edges match, so that the spectrum has no bright cross along its axes.

        The result is the periodic part of Moisan's periodic-plus-smooth decomposition (2011, J. Math. Imaging Vis. 39,
        161–179): a smooth field is subtracted, harmonic except at the edges, where it takes up half of the jump at each
        edge. Size and mean do not change. Level and despike first, because the change grows with the jump. A field that
        is periodic already does not need it and would change slightly; a grating of few periods is bent: cut it with
        `whole_periods` instead.

        Missing samples stay missing; at the edges they count as `filled` ones.

        Returns:
            The periodic part, of the same shape.

        Warns:
            WarpdiffWarning: Heights change by more than 0.4 of their standard deviation, root mean square.
        """
        self._require_memory("periodic")
        smooth = cleaning.smooth_part(self.filled().heights_um)
        result = self._with_heights(self._heights_um - smooth)
        change = float(np.sqrt(np.mean(smooth[~self.missing] ** 2)))
        if change > _MOST_CHANGE * self.rms_um:
            warn(
                f"{ref('periodic()')} changed heights by {change:.3g} µm (root mean square), "
                f"{100.0 * change / self.rms_um:.0f} % of their standard deviation, and their range from "
                f"{self.height_range_um:.3g} to {result.height_range_um:.3g} µm; level the field first with "
                f"{ref('levelled()')}, or cut it with {ref('whole_periods()')}"
            )
        return result

    def whole_periods(self) -> HeightField:
        """Cut the field to whole periods of its strongest wave, so that opposite edges match except for rounding.

        The wave is the strongest of `periods` that is no waviness. The result has as many periods as fit along each
        axis, to the nearest sample; an axis along which the wave drifts by less than a period stays unchanged. Cut
        before levelling: a plane that is fitted to parts of periods is tilted.

        Returns:
            The part that begins at the first sample, at the same pitch.

        Raises:
            ValueError: There is no such wave.
        """
        self._require_memory("whole_periods")
        return periods.cut_whole(self)

    def periods(self, count: int = 3) -> tuple[periods.Period, ...]:
        """Fit the strongest periods: waves of any length and direction with their harmonics, by least squares.

        Waves are fitted one after the other, each with a tilt to the residual of those before. Missing samples have no
        weight. The precision of a length is a small part of what a Fourier coefficient resolves, and it has a standard
        error. In a field that is a single period, as `gratings` make it, nothing repeats: it counts as waviness.

        Args:
            count: Largest number of periods, at least 1, default 3. Waves that explain less than 0.1 % of the variance
                are excluded.

        Returns:
            Periods, sorted by the variance that they explain; empty for a flat field.

        Raises:
            ValueError: ``count`` is less than 1.
        """
        count = validation.count(count, "count")
        self._require_memory("periods")
        return periods.fit(self, count)

    def summary(self) -> diagnostics.HeightFieldSummary:
        """Describe the field: size, pitch, range, roughness, slope, periods, and validity of scalar diffraction."""
        return diagnostics.summarise(self)

    def _with_heights(self, heights: NDArray[np.float64]) -> HeightField:
        """Make a field of other heights at the same pitch."""
        return HeightField.of_known_scale(heights, self.pitch_um)

    def _require_memory(self, method: str) -> None:
        """Refuse a method that needs more memory than there is."""
        ny, nx = self.shape
        memory.require_memory(
            _BYTES_PER_SAMPLE[method] * ny * nx, f"{ref(f'{method}()')} of a field of {ny} × {nx} samples",
            f"take {{share}} of its area, by {ref('cropped()')}, or a coarser pitch",
        )  # fmt: skip


def check_whole(heightfield: Any) -> None:
    """Refuse what is no height field, or lacks samples."""
    validation.instance(heightfield, HeightField, "heightfield")
    if count := heightfield._missing_count:
        raise ArgumentValueError(
            f"{ref('heightfield')} must have all samples, but {count} of {heightfield.missing.size} are missing (NaN "
            f"or masked): fill them with {ref('filled()')}, or cut out a part without gaps with {ref('cropped()')}"
        )
