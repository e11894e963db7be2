"""Methods of `HeightField` that return a field with other heights or another grid: cleaning, cropping, rotation."""

from __future__ import annotations

from typing import Literal, Self, get_args

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ref
from warpdiff.heightfield import cleaning, inpainting
from warpdiff.heightfield.height_samples import HeightSamples, check_no_gaps

Axis = Literal["y", "x"]

# Measured peak memory while gaps are filled [bytes per missing sample]. If doubled, fields are refused that would fit
# into memory.
_BYTES_PER_GAP = 700.0


class CleaningMethods(HeightSamples):
    """Methods that clean, crop, rotate and resample heights.

    Each method returns a new field. Its history has one more step.
    """

    def filled(self) -> Self:
        """Fill missing samples with the harmonic surface through the samples around them (membrane inpainting).

        The five-point Laplacian vanishes in the gaps, and the slope across the edges of the field is zero. Filled
        heights lie between the lowest and the highest sample around a gap. A plane is restored exactly in a gap that
        does not touch the edges. In a long gap of the width w with parallel rims, the error of the heights is at most
        w²/8 times the largest Laplacian of the true heights. Level and despike first: a dust grain at the rim of a gap
        raises the filled heights.

        Returns:
            The field without gaps, of the same shape. Samples that are not missing keep their values exactly.

        Examples:
            >>> wd.HeightField([[0.0, 0.1, np.nan, 0.3]], pitch_um=1.0).filled().heights_um.round(3)
            array([[0. , 0.1, 0.2, 0.3]])
        """
        memory.require_memory(
            _BYTES_PER_GAP * self._missing_count,
            f"{ref('filled()')} of {self._missing_count} missing samples",
            f"take {{share}} of the field, by {ref('cropped()')}, or a coarser pitch",
        )
        result = self._with_heights(inpainting.harmonic(self._heights_um, self.pitch_um))
        return result._after(self, f"Filled: replaced {self._missing_count} missing samples by a harmonic surface.")

    def levelled(self, order: int = 1) -> Self:
        """Subtract the least-squares polynomial of total degree ``order``: tilt (1), bow (2), or the mean alone (0).

        Args:
            order: Highest total degree, at least 0, default 1; along an axis of n samples it is at most n − 1.

        Returns:
            The field with heights of zero mean.

        Raises:
            ValueError: ``order`` is negative.

        Examples:
            >>> print(wd.HeightField([[0.0, 0.1, 0.2, 0.3]], pitch_um=1.0).levelled().height_range_um < 1e-9)
            True
        """
        order = validation.count(order, "order", least=0)
        cleaning.require_memory("levelled", self.shape)
        result = self._with_heights(cleaning.level(self._heights_um, self._missing, order))
        return result._after(
            self,
            f"Levelled: subtracted a polynomial of degree {order}, which changed the range from "
            f"{self.height_range_um:.3g} to {result.height_range_um:.3g} µm.",
        )

    def despiked(self, threshold: float = 3.0, *, size_um: float = 1.0) -> Self:
        """Remove dust grains and bright scratches: replace elevations that stand out from their surroundings.

        The score of a sample is its height above a smooth background in units of a robust scale. The background is a
        Gaussian convolution of standard deviation ``size_um`` without the spikes that were detected before; it is
        computed up to three times. Heights above the background have a median and quantiles at 2.5 % and 97.5 %. The
        scale is the larger distance from the median to one of these quantiles, divided by 1.96. For Gaussian roughness
        the scale equals the standard deviation. (The median absolute deviation is zero for a rectangular grating and
        would flag all its ridges.) Samples with a score above ``threshold`` are spikes, and so are samples connected
        with them whose score exceeds 0.8 ``threshold``. Spikes and the samples next to them are filled by normalised
        convolutions from coarse to fine (Knutsson and Westin 1993). Pits and cracks are not removed, because the
        deepest points of a relief often look like them.

        Level the field first, because tilt counts as height. Samples that are not replaced keep their values exactly,
        so that ``np.mean(after.heights_um != before.heights_um)`` is the replaced fraction of a field without gaps.
        Elevations that belong to the surface and cover less than about 3 % of it are mistaken for dust.

        Args:
            threshold: Score above which a sample is a spike, more than 0, default 3.
            size_um: Standard deviation of the background [µm], at least the pitch, default 1. It should be about the
                distance between the features of the surface.

        Returns:
            The cleaned field, of the same shape; unchanged if nothing stands out.

        Raises:
            ValueError: An argument is not positive, or ``size_um`` is smaller than the pitch.

        Examples:
            >>> heights = wd.gratings.fingers(size_um=6.4).heights_um.copy()
            >>> heights[40:44, 60:64] += 1.0
            >>> round(wd.HeightField(heights, pitch_um=0.05).despiked().height_range_um, 2)
            0.3
        """
        threshold = validation.positive(threshold, "threshold")
        size = validation.positive(size_um, "size_um")
        cleaning.require_memory("despiked", self.shape)
        result = self._with_heights(
            cleaning.despike(self._heights_um, self._missing, self.pitch_um, threshold=threshold, size_um=size)
        )
        replaced = np.count_nonzero((result._heights_um != self._heights_um) & ~self._missing)
        return result._after(
            self,
            f"Despiked with threshold={threshold:g} and size_um={size:g}: replaced {replaced} samples "
            f"({100.0 * replaced / self._heights_um.size:.2g} %).",
        )

    def cropped(self, size_um: float | tuple[float, float], *, offset_um: tuple[float, float] | None = None) -> Self:
        """Cut out a rectangle, rounded to whole samples; an axis with one sample stays unchanged.

        Args:
            size_um: Extent of the rectangle [µm], one number or a pair (y, x).
            offset_um: Position (y, x) of the first sample of the rectangle [µm]; None, the default, centres the
                rectangle.

        Returns:
            The rectangle, at the same pitch.

        Raises:
            ValueError: The rectangle is smaller than a sample, extends beyond the field, or has only missing samples.

        Examples:
            >>> wd.gratings.fingers(size_um=12.8).cropped(6.4, offset_um=(0.0, 0.0)).shape
            (128, 128)
        """
        heights, first = cleaning.crop(self._heights_um, self.pitch_um, size_um, offset_um)
        result = self._with_heights(heights)
        (ly, lx), (y, x) = result.size_um, (start * pitch for start, pitch in zip(first, self.pitch_um, strict=True))
        return result._after(self, f"Cropped to {ly:.4g} × {lx:.4g} µm (y × x) from ({y:.4g}, {x:.4g}) µm.")

    def flipped(self, axis: Axis) -> Self:
        """Mirror the field by reversing the order of its samples along one axis.

        Args:
            axis: Axis that is reversed: ``"x"`` (the order of the columns) or ``"y"`` (the order of the rows).

        Returns:
            The mirrored field, of the same shape and pitch.

        Examples:
            >>> wd.HeightField([[0.0, 0.1, 0.2]], pitch_um=1.0).flipped("x").heights_um
            array([[0.2, 0.1, 0. ]])
        """
        axis = validation.choice(axis, "axis", get_args(Axis))
        result = self.of_known_scale(np.flip(self._heights_um, "yx".index(axis)), self.pitch_um)
        return result._after(self, f"Flipped along {axis}.")

    def rotated(self, quarter_turns: int = 1) -> Self:
        """Rotate the field counter-clockwise as viewed from +z, with x to the right and y up.

        One quarter turn makes a grating whose heights vary along y from a grating whose heights vary along x.

        Args:
            quarter_turns: Number of quarter turns, default 1; negative numbers turn clockwise.

        Returns:
            The rotated field. An odd number of quarter turns swaps both pitches and both sizes.

        Examples:
            >>> wd.gratings.blazed(2.0, 0.1).rotated().shape
            (64, 1)
        """
        turns = validation.count(quarter_turns, "quarter_turns", least=-validation.MOST_COUNT) % 4
        pitch = self.pitch_um[::-1] if turns % 2 else self.pitch_um
        # numpy.rot90 assumes that the first row of an array is at the top. In a height field the first row is at the
        # bottom, so that the sign of the turns is reversed.
        result = self.of_known_scale(np.ascontiguousarray(np.rot90(self._heights_um, -turns)), pitch)
        return result._after(self, f"Rotated by {90 * turns}° counter-clockwise.")

    def resampled(self, pitch_um: float | tuple[float, float]) -> Self:
        """Resample to another pitch by a Fourier series, as one period of a periodic surface.

        Args:
            pitch_um: Requested pitch [µm], one number or a pair (dy, dx). The actual pitch is the nearest pitch that
                divides the size of the field, which does not change. An axis with one sample stays unchanged.

        Returns:
            The field with round(L / pitch) samples along each axis; spatial frequencies above 1 / (2 · pitch), which
            the new samples cannot represent, are removed.

        Raises:
            ValueError: The pitch is not positive, or larger than the field, or samples are missing.

        Examples:
            >>> wd.gratings.sinusoidal(2.0, 0.1).resampled(0.1).shape
            (1, 20)
        """
        pitch = validation.pair(pitch_um, "pitch_um")
        check_no_gaps(self, "heightfield")
        field = self.of_known_scale(*cleaning.resample(self._heights_um, self.pitch_um, pitch))
        field._source = self._source
        return field._after(
            self, f"Resampled to a pitch of {field.pitch_um[0]:.4g} × {field.pitch_um[1]:.4g} µm (y × x)."
        )

    def periodic(self) -> Self:
        """Make opposite edges match, which removes the bright cross along the axes of the spectrum.

        The result is the periodic part of Moisan's periodic-plus-smooth decomposition (2011, J. Math. Imaging Vis. 39,
        161–179). The subtracted smooth part is harmonic except at the edges. At each edge it has half of the jump
        between opposite edges. The size and the mean height of the field do not change. Level and despike first,
        because the change increases with the jump. Do not use this method for a field that is periodic already: it
        would change the field slightly. Cut a grating of few periods with `whole_periods` instead, because this method
        would bend it.

        Missing samples stay missing. For missing samples at the edges, the heights of `filled` determine the jump.

        Returns:
            The periodic part, of the same shape.

        Warns:
            WarpdiffWarning: The root mean square change exceeds 0.4 of the standard deviation of the heights.

        Examples:
            >>> patch = wd.gratings.fingers(size_um=12.8).cropped(6.0).levelled()
            >>> patch.periodic().shape == patch.shape
            True
        """
        cleaning.require_memory("periodic", self.shape)
        smooth = cleaning.smooth_part(self.filled().heights_um)
        result = self._with_heights(self._heights_um - smooth)
        change = float(np.sqrt(np.mean(smooth[~self.missing] ** 2)))
        result = result._after(self, f"Made periodic: changed heights by {change:.3g} µm (root mean square).")
        if change > cleaning.MOST_CHANGE * self.rms_um:
            warn(
                f"{ref('periodic()')} changed heights by {change:.3g} µm (root mean square), "
                f"{100.0 * change / self.rms_um:.0f} % of their standard deviation, and their range from "
                f"{self.height_range_um:.3g} to {result.height_range_um:.3g} µm; level the field first with "
                f"{ref('levelled()')}, or cut it with {ref('whole_periods()')}; if it is levelled, waves longer than "
                "the field remain, and light near the mirror direction is uncertain"
            )
        return result
