"""``HeightField``: heights on a regular grid, with methods that load, save, clean, crop and describe them.

The sample ``heights_um[j, i]`` is at x = i·dx, y = j·dy: rows run along y, columns along x. Pairs are in the order (y,
x), lengths in µm. Every method that changes heights returns a new `HeightField`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from warpdiff.core import forks, memory, validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield import cleaning, diagnostics, inpainting, periods, roughness, scale_checks
from warpdiff.heightfield.readers import reader_registry, topography_reader
from warpdiff.heightfield.writers import height_writers

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.readers.reader_registry import FileContent, Source

Axis = Literal["y", "x"]
Rows = reader_registry.Rows

# Largest memory that is required, as measured: bytes per sample while a field is made from an array, and bytes per
# missing sample while gaps are filled. If doubled, fields are refused that would fit into memory.
_BYTES_MADE, _BYTES_PER_GAP = 13.0, 700.0
# Root mean square change of the heights by `HeightField.periodic`, relative to their standard deviation, above which
# that method warns. Patches with many features have a smaller change.
_MOST_CHANGE = 0.4


class HeightField:
    """One period, or one patch, of a surface, as heights on a regular grid; immutable.

    Two height fields are equal only if they are the same object, so that a field can be the key of a dictionary.

    Samples may be missing, for example where an instrument had no signal. Methods that measure and describe the surface
    exclude them. Rendering and evaluation require all samples, see `filled`.

    Args:
        heights_um: Surface heights [µm], shape (ny, nx), rows along y. The array is copied. One row is a
            one-dimensional grating, constant along y. NaN, or a masked element of a ``numpy.ma.MaskedArray``, is a
            missing sample.
        pitch_um: Distance of the samples [µm], one number or a pair (dy, dx).

    Warns:
        WarpdiffWarning: Heights contain a code for missing data, such as −9999. Or no diffracting surface has the scale
            of the field, which suggests a wrong unit: a pitch or a height range below 0.1 nm, a pitch above 2 µm, a
            size below half a wavelength, or a mean slope above 10. The message names the probable unit and its factor.

    Raises:
        TypeError: An argument is not numeric.
        ValueError: The heights are not a non-empty 2-D array, contain infinities or only missing samples, or the pitch
            is not positive.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> x = np.arange(100) * 0.02
        >>> wd.HeightField(0.1 * np.cos(np.pi * x)[None, :], pitch_um=0.02)
        HeightField(1 × 100 samples (y × x), pitch 0.02 × 0.02 µm, size 0.02 × 2 µm, height range 0.2 µm)
    """

    def __init__(self, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> None:
        self._set(heights_um, pitch_um)
        scale_checks.warn_of_scale(self)

    @classmethod
    def of_known_scale(cls, heights_um: ArrayLike, pitch_um: float | tuple[float, float]) -> HeightField:
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

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], *, extent_um: float | tuple[float, float] | None = None,
        pitch_um: float | tuple[float, float] | None = None, height_range_um: float | None = None,
        channel: str | None = None, rows: Rows | None = None, unit: str | None = None,
    ) -> HeightField:  # fmt: skip
        """Read a height field from a file.

        Suffix and content select the reader: ``.npz`` as :meth:`save` writes it, ``.npy``, text, ``.x3p``, and files of
        instruments (extra ``scans``). Files with any other suffix are read as grey images by OpenImageIO.
        :func:`~warpdiff.heightfield.readers.reader_registry.register_reader` adds readers.

        Size, pitch, unit, missing samples and metadata come from the file if it states them. Integer samples have no
        unit: the largest value of their type (255 or 65535) is the height ``height_range_um``, even if the file does
        not use it. Floating-point samples of images and ``.npy`` files are heights in µm; NaN is a missing sample.

        Args:
            path: Path of a grey image, of a ``.npy`` or ``.npz`` file, of a text, or of an instrument's file.
            extent_um: Size of the field [µm]: one number, which is the width along x of a field with square samples, or
                a pair (Ly, Lx).
            pitch_um: Distance of the samples [µm], one number or a pair (dy, dx). Give exactly one of ``extent_um``
                and ``pitch_um``, and neither for a file that states its pitch or size.
            height_range_um: Height of the full scale of integer samples [µm]; not for floating-point samples.
            channel: Name of a channel, one of :meth:`channels`. None, the default, selects the first channel with
                heights.
            rows: Orientation: ``"down"`` puts row 0 of the file at y = 0, ``"up"`` makes row 0 the top of the picture,
                so that the surface has the handedness of the specimen. None is ``"up"`` for instruments and for texts
                that state a unit, and ``"down"`` for images and arrays.
            unit: Unit of the numbers of a text that does not state it: ``"nm"``, ``"um"``, ``"mm"``, ``"m"``,
                ``"Å"`` or ``"pm"``. Without a pitch it also is the unit of the positions x and y.

        Returns:
            The height field, in float64. The scale of a ``.npz`` file is not checked.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file cannot be read, is a colour image or a profile, or contains infinities (in a text,
                ``inf`` is a missing sample); its size or pitch is not given exactly once; or it has no channel of the
                given name.

        Examples:
            >>> import pathlib, tempfile
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "scan.npy"
            >>> np.save(file, 0.05 * np.random.default_rng(0).standard_normal((64, 64)))
            >>> wd.HeightField.load(file, extent_um=10.0).size_um
            (10.0, 10.0)
        """
        reader_registry.check_texts(channel, unit)
        file = reader_registry.existing(path)
        content, name = reader_registry.read(file, channel)
        orientation = reader_registry.rows_of(content, rows)
        heights = reader_registry.heights_of(content, file, height_range_um, unit)
        pitch = reader_registry.pitch_of(content, file, extent_um, pitch_um, unit)
        arguments = {
            "extent_um": extent_um, "pitch_um": pitch_um, "height_range_um": height_range_um, "channel": channel,
            "rows": rows, "unit": unit,
        }  # fmt: skip
        source = reader_registry.Source(
            str(file), name, orientation, dict(content.metadata),
            {key: str(value) for key, value in arguments.items() if value is not None},
            reader_registry.clipped_share(content.samples),
        )  # fmt: skip
        try:
            return cls._of_content(content, heights, pitch, source)
        except (ArgumentValueError, ArgumentTypeError) as error:
            raise ArgumentValueError(f"{ref('path')}: {str(file)!r}: {error}") from None

    @classmethod
    def _of_content(
        cls, content: FileContent, heights_um: NDArray[np.float64], pitch_um: float | tuple[float, float],
        source: Source,
    ) -> HeightField:  # fmt: skip
        """Return a height field of heights that were read from a file; the field also stores its source."""
        make = cls.of_known_scale if content.is_known_scale else cls
        field = make(heights_um[::-1] if source.rows == "up" else heights_um, pitch_um)
        field._source = source
        field._history = content.notes
        return field

    @classmethod
    def channels(cls, path: str | os.PathLike[str]) -> tuple[str, ...]:
        r"""List the channels of heights in a file, the default channel first.

        Args:
            path: Path of a file of heights.

        Returns:
            Names that :meth:`load` accepts as ``channel``; an empty tuple for formats that contain one array without a
            name.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file cannot be read.

        Examples:
            >>> import pathlib, tempfile
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "scan.txt"
            >>> table = "# Channel: {}\n# Width: 3 µm\n# Height: 2 µm\n# Value units: nm\n1 2 3\n4 5 6\n"
            >>> _ = file.write_text(table.format("Trace") + table.format("Retrace"), encoding="utf-8")
            >>> wd.HeightField.channels(file)
            ('Trace', 'Retrace')
        """
        return reader_registry.channels_of(reader_registry.existing(path))

    @classmethod
    def from_topography(cls, topography: Any, *, rows: Rows = "up") -> HeightField:
        """Make a height field from a topography of the library SurfaceTopography.

        Args:
            topography: A two-dimensional topography with a size and a unit of length.
            rows: Orientation: ``"up"``, the default, makes row 0 the top of the picture, as for :meth:`load`.

        Returns:
            The height field, in float64. Masked samples are missing.

        Raises:
            TypeError: The object is no topography.
            ValueError: The topography is a line scan, or has no size or unit.

        Examples:
            >>> from types import SimpleNamespace
            >>> scan = SimpleNamespace(  # as SurfaceTopography.Topography(heights, (1.0, 2.0), unit="um")
            ...     heights=lambda: np.array([[0.0, 0.1], [0.2, 0.3]]), physical_sizes=(1.0, 2.0), unit="um", dim=2
            ... )
            >>> wd.HeightField.from_topography(scan).pitch_um
            (1.0, 0.5)
        """
        content = topography_reader.content_of(topography)
        if content.pitch_um is None or not content.has_unit:
            raise ArgumentValueError(
                f"{ref('topography')} must have a size and a unit, got size {topography.physical_sizes} and unit "
                f"{topography.unit!r}; pass its heights to HeightField"
            )
        orientation = reader_registry.rows_of(content, rows)
        try:
            source = reader_registry.Source("", "", orientation, dict(content.metadata), {}, 0.0)
            return cls._of_content(content, content.samples, content.pitch_um, source)
        except (ArgumentValueError, ArgumentTypeError) as error:
            raise ArgumentValueError(f"{ref('topography')}: {error}") from None

    def save(
        self, path: str | os.PathLike[str], *, levels: int | ArrayLike | None = None, dose: ArrayLike | None = None
    ) -> Path:
        """Write the height field to a file whose suffix selects the format.

        - ``.npz``: the arrays ``heights_um`` (NaN where a sample is missing), ``pitch_um`` (dy, dx) and ``history``,
          which :meth:`load` restores exactly.
        - ``.gds``: a layout for lithography (extra ``lithography``). The layer number is that of the level, from 0 at
          the lowest. Rectangles of each layer cover its samples; sample (j, i) covers i·dx to (i + 1)·dx along x, and
          the same along y. A label on each layer states its height. Rectangles have four vertices and no holes.
          Coordinates are rounded to 1 nm.
        - ``.png``: a 16-bit grey image for grey-scale lithography; row 0 is y = 0. Samples are proportional to the
          height, from 0 at the lowest to 65535 at the highest point, or to the dose of the depth below the highest
          point. Texts in the file state pitch and height range.
        - ``.stl``: a closed solid in µm. Samples are vertices, joined by triangles, and the first row and column are
          repeated at the end. Vertical walls become slopes of one sample.

        An existing file is replaced only once the new one is complete.

        Args:
            path: File to write; its name ends in ``.npz``, ``.gds``, ``.png`` or ``.stl``.
            levels: Heights are rounded to these levels: a number of equally spaced levels from the lowest to the
                highest point, 2 to 256, or increasing heights [µm]. None, the default, does not round; GDS layouts
                then require a field with at most 256 different heights.
            dose: Calibration of a resist for ``.png``: increasing depths [µm] and their doses (0 to 1, where 1 is
                65535), shape (n, 2), linear in between. None writes heights.

        Returns:
            The path of the file.

        Raises:
            ValueError: The name has another suffix, an argument is out of its range or does not belong to the format,
                or samples are missing (except in ``.npz``).
            ImportError: gdstk is not installed: ``pip install 'warpdiff[lithography]'``.
            OSError: The folder does not exist, or the file cannot be written.

        Examples:
            >>> import pathlib, tempfile
            >>> folder = pathlib.Path(tempfile.mkdtemp())
            >>> path = wd.gratings.bumps().save(folder / "bumps.npz")
            >>> wd.HeightField.load(path).shape
            (50, 25)
            >>> path = wd.gratings.bumps().save(folder / "bumps.png", levels=16)
            >>> wd.HeightField.load(path, pitch_um=0.1, height_range_um=0.3).shape
            (50, 25)
        """
        target, curve = height_writers.check(path, dose)
        if levels is not None or target.suffix.lower() != ".npz":
            check_whole(self)
        height_writers.write(target, self._heights_um, self._pitch_um, levels, curve, self._history)
        return target

    @property
    def heights_um(self) -> NDArray[np.float64]:
        """Heights [µm], shape (ny, nx), read-only; NaN where a sample is missing."""
        return self._heights_um

    @property
    def source(self) -> Source | None:
        """File, channel, orientation of rows, and metadata of the instrument; None for heights from an array.

        Fields that methods return have the same source, except for the results of `flipped` and `rotated`, which have
        none.
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

    def filled(self) -> HeightField:
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

    def levelled(self, order: int = 1) -> HeightField:
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

    def despiked(self, threshold: float = 3.0, *, size_um: float = 1.0) -> HeightField:
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
        so that ``np.mean(after.heights_um != before.heights_um)`` is the replaced share of a field without gaps.
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

    def cropped(
        self, size_um: float | tuple[float, float], *, offset_um: tuple[float, float] | None = None
    ) -> HeightField:
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

    def flipped(self, axis: Axis) -> HeightField:
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
        result = HeightField.of_known_scale(np.flip(self._heights_um, "yx".index(axis)), self.pitch_um)
        return result._after(self, f"Flipped along {axis}.")

    def rotated(self, quarter_turns: int = 1) -> HeightField:
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
        result = HeightField.of_known_scale(np.ascontiguousarray(np.rot90(self._heights_um, -turns)), pitch)
        return result._after(self, f"Rotated by {90 * turns}° counter-clockwise.")

    def resampled(self, pitch_um: float | tuple[float, float]) -> HeightField:
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
        check_whole(self)
        field = HeightField.of_known_scale(*cleaning.resample(self._heights_um, self.pitch_um, pitch))
        field._source = self._source
        return field._after(
            self, f"Resampled to a pitch of {field.pitch_um[0]:.4g} × {field.pitch_um[1]:.4g} µm (y × x)."
        )

    def periodic(self) -> HeightField:
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
        if change > _MOST_CHANGE * self.rms_um:
            warn(
                f"{ref('periodic()')} changed heights by {change:.3g} µm (root mean square), "
                f"{100.0 * change / self.rms_um:.0f} % of their standard deviation, and their range from "
                f"{self.height_range_um:.3g} to {result.height_range_um:.3g} µm; level the field first with "
                f"{ref('levelled()')}, or cut it with {ref('whole_periods()')}"
            )
        return result

    def whole_periods(self) -> HeightField:
        """Crop the field to whole periods of its strongest wave, so that opposite edges match.

        The wave is the strongest one that `periods` returns; it repeats at least three times. Along each axis, the
        result has as many whole periods as the field contains, rounded to whole samples. An axis along which the field
        contains less than one period stays unchanged. Crop before levelling: a plane fitted to a part of a period is
        tilted.

        Returns:
            The part that begins at the first sample, at the same pitch.

        Raises:
            ValueError: No wave repeats at least three times.

        Examples:
            >>> heights = 0.1 * np.cos(np.pi * 0.02 * np.arange(730))
            >>> wd.HeightField(heights[None, :], pitch_um=0.02).whole_periods().size_um[1]
            14.0
        """
        cleaning.require_memory("whole_periods", self.shape)
        result, period = periods.cut_whole(self)
        (ly, lx) = result.size_um
        return result._after(self, f"Cut to {ly:.4g} × {lx:.4g} µm (y × x), whole periods of {period}.")

    def periods(self, count: int = 3) -> periods.Periods:
        """Find the strongest periods: waves of any direction that repeat at least three times, with their harmonics.

        A period causes a narrow maximum (line) of the spectrum. Noise has such a line with a probability of less than
        0.5 %. The power of the line must exceed the spectrum at lower and at higher frequencies of the same direction.
        Stronger waviness or tilt therefore does not hide a period. Rough surfaces have no period, because their spectra
        have no lines, whatever their autocorrelation is. A wave whose phase varies has one period, at its mean
        frequency. Missing samples do not count.

        The length of a period is much more precise than the resolution of the Fourier transform. Its standard error
        includes noise, steps between scan lines, and the variation of the period over the field. A field that is a
        single period, as the functions of `gratings` make it, repeats nothing, so that the result is empty.

        Args:
            count: Largest number of periods, at least 1, default 3. Waves that explain less than 0.1 % of the variance
                are excluded.

        Returns:
            Periods, a tuple sorted by the variance that they explain; empty if nothing repeats. Its ``table()`` prints
            them, and ``save("periods.csv")`` writes them to a file.

        Raises:
            ValueError: ``count`` is less than 1.

        Examples:
            >>> heights = 0.1 * np.cos(np.pi * 0.02 * np.arange(730))
            >>> print(wd.HeightField(heights[None, :], pitch_um=0.02).periods(1)[0])
            2.00000... ± 0.00000... µm at 0°
        """
        count = validation.count(count, "count")
        cleaning.require_memory("periods", self.shape)
        return periods.Periods(periods.fit(self, count))

    def roughness(self, order: int = 1) -> roughness.Roughness:
        """Measure areal surface texture parameters of ISO 25178-2 with standard errors: Sa, Sq, Sdq, Sdr, Sal and Str.

        Heights are relative to a least-squares polynomial, which is subtracted first. No further filter is applied:
        only the pitch and the size of the field limit the scales of the roughness. Missing samples do not count.

        - Sa and Sq are the mean magnitude and the root mean square of the heights.
        - Sdq is the root mean square gradient, from differences of neighbouring samples.
        - Sdr is the area of the surface minus the area of its projection, relative to the latter. Triangles connect the
          samples. Four neighbouring samples form two triangles in two ways, and Sdr uses the mean area of both ways.
        - Sal is the shortest lag at which the autocorrelation is 0.2 of its value at lag 0.
        - Str is Sal divided by the longest lag, over all directions, at which the autocorrelation falls to this value.

        Standard errors are from a jackknife over parts of the field (blocks). They estimate the standard deviation of a
        parameter among fields of the same size on the same surface. Errors by the calibration and the noise of the
        instrument are not included.

        Args:
            order: Degree of the polynomial, at least 0, default 1, a plane; 0 subtracts the mean only.

        Returns:
            The parameters. Each parameter has a standard error, or the reason why it has none.

        Raises:
            ValueError: ``order`` is negative.

        Examples:
            >>> x = np.arange(500) * 0.02
            >>> wave = wd.HeightField(np.tile(0.1 * np.cos(2 * np.pi * x), (40, 1)), pitch_um=0.02)
            >>> wave.roughness()["Sq"]
            RoughnessParameter(Sq 0.0707... ± 0.0... µm)
        """
        order = validation.count(order, "order", least=0)
        cleaning.require_memory("roughness", self.shape)
        return roughness.measure(self, order)

    def summary(self) -> diagnostics.HeightFieldSummary:
        """Describe the field: size, pitch, range, roughness, slope, periods, and validity of scalar diffraction.

        Examples:
            >>> print(wd.gratings.sinusoidal(2.0, 0.1).summary())
            size              2 × ...
        """
        return diagnostics.summarise(self)

    def _with_heights(self, heights: NDArray[np.float64]) -> HeightField:
        """Return a field with other heights, and with the pitch and the source of this field."""
        field = HeightField.of_known_scale(heights, self.pitch_um)
        field._source = self._source
        return field

    def _after(self, origin: HeightField, step: str) -> HeightField:
        """Set the history of this field to that of the field ``origin`` plus one step; return this field."""
        self._history = (*origin._history, step)
        return self


def check_whole(heightfield: HeightField) -> None:
    """Raise an error if an argument of a call is not a height field, or has missing samples."""
    validation.instance(heightfield, HeightField, "heightfield")
    if count := heightfield._missing_count:
        raise ArgumentValueError(
            f"{ref('heightfield')} must have all samples, but {count} of {heightfield.missing.size} are missing (NaN "
            f"or masked): fill them with {ref('filled()')}, or cut out a part without gaps with {ref('cropped()')}"
        )
