"""Array of the samples of a height field: checks of the array, and properties such as the height range."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np

from warpdiff.core import forks, memory, validation
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield import diagnostics, scale_checks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.readers.reader_registry import Source

# Measured peak memory while a height field is made from an array [bytes per sample]. If doubled, fields are refused
# that would fit into memory.
_BYTES_MADE = 13.0


class HeightSamples(ReadOnlyArrays):
    """Heights on a regular grid with their pitch, source and history; the base of `HeightField`.

    The array is read-only. Methods that change heights make a new object.
    """

    def __init__(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        self._set(heights_um, pitch_um)
        scale_checks.warn_of_scale(self._heights_um, self._pitch_um)

    @classmethod
    def of_known_scale(cls, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> Self:
        """Make a height field without a check for codes of missing data and for wrong units.

        Args:
            heights_um: Surface heights [µm], shape (ny, nx), as for the constructor of the class.
            pitch_um: Distance of the samples [µm], one number or a pair (dy, dx).

        Examples:
            >>> wd.HeightField.of_known_scale([[0.0, 0.0, 9.0, 9.0]], pitch_um=0.1).height_range_um
            9.0
        """
        field = cls.__new__(cls)
        field._set(heights_um, pitch_um)
        return field

    def _set(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        """Check the arguments of a new field and set its attributes."""
        if isinstance(heights_um, np.ndarray) and heights_um.ndim == 2:
            ny, nx = heights_um.shape
            memory.require_memory(
                _BYTES_MADE * ny * nx,
                f"{ref('heights_um')} of {ny} × {nx} samples",
                f"take {{share}} of the area, or a larger {ref('pitch_um')}",
            )
        heights = validation.finite_array(heights_um, "heights_um", ndim=2, gaps=True)
        scale_checks.check_magnitude(heights, validation.MOST)
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
        # The number of missing samples and the height range are stored, because every computation of a picture reads
        # them.
        self._missing_count = int(np.count_nonzero(missing))
        self._height_range_um = float(np.nanmax(heights) - np.nanmin(heights))
        self._pitch_um = validation.pair(pitch_um, "pitch_um")
        self._source: Source | None = None
        self._history: tuple[str, ...] = ()

    @property
    def heights_um(self) -> NDArray[np.float64]:
        """Heights [µm], shape (ny, nx), read-only; NaN where a sample is missing."""
        return self._heights_um

    @property
    def source(self) -> Source | None:
        """File, channel, orientation of rows, and metadata of the instrument; None for heights from an array.

        Methods that return a new field keep its source, except `flipped` and `rotated`, whose results have none.
        """
        return self._source

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
        """Extent (Ly, Lx) [µm]: number of samples times pitch. For a periodic field, it is the length of one period."""
        return self.shape[0] * self.pitch_um[0], self.shape[1] * self.pitch_um[1]

    @property
    def history(self) -> tuple[str, ...]:
        """Steps that made the field from the original one, in their order, as sentences. Pictures store this history.

        Examples:
            >>> for step in wd.gratings.fingers(size_um=12.8).cropped(6.4).levelled().history:
            ...     print(step)
            Cropped to 6.4 × 6.4 µm (y × x) from (3.2, 3.2) µm.
            Levelled: subtracted a polynomial of degree 1, which changed the range from 0.273 to 0.271 µm.
        """
        return self._history

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
        """Root mean square slope between neighbouring samples, without slopes across the edges of the field."""
        return diagnostics.rms_slope(self._heights_um, self.pitch_um)

    @forks.cached_property
    @np.errstate(under="ignore")
    def mean_slope(self) -> float:
        """Mean absolute slope between neighbouring samples of the periodic field, also across the edges."""
        return diagnostics.mean_slope(self._heights_um, self.pitch_um)

    def __repr__(self) -> str:
        (ny, nx), (dy, dx), (ly, lx) = self.shape, self.pitch_um, self.size_um
        gaps = f", {self._missing_count} missing" if self._missing_count else ""
        return (
            f"HeightField({ny} × {nx} samples (y × x), pitch {dy:.4g} × {dx:.4g} µm, size {ly:.4g} × {lx:.4g} µm, "
            f"height range {self.height_range_um:.4g} µm{gaps})"
        )

    def _with_heights(self, heights: NDArray[np.float64]) -> Self:
        """Return a field with other heights, and with the pitch and the source of this field."""
        field = self.of_known_scale(heights, self.pitch_um)
        field._source = self._source
        return field

    def _after(self, origin: HeightSamples, step: str) -> Self:
        """Set the history of this field to that of the field ``origin`` plus one step; return this field."""
        self._history = (*origin._history, step)
        return self


def check_no_gaps(samples: HeightSamples, name: str) -> None:
    """Raise an error if a height field that a caller passes as an argument has missing samples.

    Args:
        samples: The height field.
        name: Name of the argument, for the message.
    """
    if count := samples._missing_count:
        raise ArgumentValueError(
            f"{ref(name)} must have all samples, but {count} of {samples.missing.size} are missing (NaN or masked): "
            f"fill them with {ref('filled()')}, or cut out a part without gaps with {ref('cropped()')}"
        )
