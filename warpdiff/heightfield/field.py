"""``HeightField``: heights on a regular grid, with methods that load, save, clean, crop and describe them.

The module ``height_samples`` has the array and its checks, ``cleaning_methods`` the methods that change heights.

The sample ``heights_um[j, i]`` is at x = i·dx, y = j·dy: rows run along y, columns along x. Pairs are in the order (y,
x), lengths in µm. Every method that changes heights returns a new `HeightField`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.heightfield import cleaning, diagnostics, periods, roughness
from warpdiff.heightfield.cleaning_methods import CleaningMethods
from warpdiff.heightfield.height_samples import check_no_gaps
from warpdiff.heightfield.readers import reader_registry, topography_reader
from warpdiff.heightfield.writers import height_writers

if TYPE_CHECKING:
    import os
    from pathlib import Path

    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.readers.reader_registry import FileContent, Source

Rows = reader_registry.Rows


class HeightField(CleaningMethods):
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
        WarpdiffWarning: Heights contain a code for missing data, such as −9999. The warning also follows if no
            diffracting surface has the scale of the field, which suggests a wrong unit: a pitch or a height range below
            0.1 nm, a pitch above 2 µm, a size below half a wavelength, or a mean slope above 10. The message names the
            probable unit and its factor.

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
        - ``.gds``: a layout for lithography (extra ``lithography``). Each layer contains the samples of one height
          level; its number is that of the level, from 0 at the lowest. Rectangles of each layer cover its samples;
          sample (j, i) covers i·dx to (i + 1)·dx along x, and the same along y. A label on each layer states its
          height. Rectangles have four vertices and no holes. Coordinates are rounded to 1 nm.
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

        A period causes a narrow maximum (line) of the power spectrum of the heights. The power of the line must exceed
        the spectrum at lower and at higher frequencies of the same direction, so much that noise has such a line with a
        probability of less than 0.5 %. Stronger waviness or tilt therefore does not hide a period. Rough surfaces have
        no period, because their spectra have no lines, whatever their autocorrelation is. A wave whose phase varies has
        one period, at its mean frequency. Missing samples do not count.

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
        - Sdr is the area of the surface minus the area of its projection, relative to the area of the projection.
          Triangles connect the samples. Four neighbouring samples form two triangles in two ways, and Sdr uses the mean
          area of both ways.
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


def check_whole(heightfield: HeightField) -> None:
    """Raise an error if an argument is not a height field, or if it is a height field with missing samples."""
    validation.instance(heightfield, HeightField, "heightfield")
    check_no_gaps(heightfield, "heightfield")
