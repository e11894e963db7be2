"""``GratingMap``: one grating whose direction, depth and pitch differ from dot to dot of a surface.

A grating map is a matrix of small rectangles (dots) over the texture coordinates of a mesh, as on a dot-matrix foil.
All dots have the same grating, the cell, but each dot has its own turn φ, depth scale d and pitch scale p. In a dot,
the cell is turned by φ, its heights are multiplied by d, and its lengths by p. The power spectrum of a dot at the
scattering vector (u, v, w) is therefore that of the cell at (p R(−φ) (u, v), d w), where R(−φ) turns by −φ. One table
of the power spectrum of the cell serves all dots.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core import csv_columns, files, forks, memory, validation
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.table import Table, save_table
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref, renaming
from warpdiff.heightfield.edge_checks import check_periodic
from warpdiff.heightfield.field import HeightField, check_whole
from warpdiff.heightfield.grey_levels import grey_levels

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.optics.coherence import Coherence

    # Type of the turns or scales of all dots (small rectangles) of a grating map: a number or an array; or the path of
    # a grey image; or a tuple of this path and the values for black and white.
    DotValues = ArrayLike | os.PathLike[str] | tuple[str | os.PathLike[str], float, float]

# Largest turn (rotation of a dot, a small rectangle) [degrees] that a grating map accepts: a hundred full turns. Larger
# numbers are probably no angles in degrees.
_MOST_TURN_DEG = 36_000.0
# Range of the depth scales and pitch scales of a grating map, the factors of the cell's heights and lengths. Depth
# scales may also be 0. A number beyond the range is probably a length instead of a factor.
LEAST_SCALE, MOST_SCALE = 1e-3, 1000.0
# Largest ratio of two pitch scales (factors of the cell's lengths) in a map of gratings. The value is limited by
# memory: the number of azimuth samples in the table of power spectra is proportional to this ratio.
MOST_PITCH_RATIO = 4.0
# Values of black and white in an image whose pixels are the turns [degrees] or depth scales of the dots (small
# rectangles) of a grating map. The value 180° was chosen because a symmetric grating has the same grooves after a
# rotation by 180°.
_BLACK_AND_WHITE = {"turn_deg": (0.0, 180.0), "depth_scale": (0.0, 1.0)}
# Measured peak memory while a grating map is made [bytes per dot (small rectangle)]: turns and scales in float64, four
# numbers in float32 for kernels, and temporary arrays. If doubled, maps that fit into memory are refused.
_BYTES_PER_DOT = 120.0


# Columns in the table of a grating map that state the row and the column of a dot (small rectangle) in the map.
_PLACES = ("row", "column")


class Dot(NamedTuple):
    """Grating of one dot (small rectangle) of a grating map, relative to the cell, the common grating of all dots.

    Attributes:
        turn_deg: Counter-clockwise turn [degrees].
        depth_scale: Factor of the heights.
        pitch_scale: Factor of the lengths.
    """

    turn_deg: float
    depth_scale: float
    pitch_scale: float


class GratingMap(ReadOnlyArrays):
    """Grating whose direction, depth and pitch differ from dot to dot of a surface, for pictures of a mesh.

    The dots are small rectangles, which form a matrix over the texture coordinates of the mesh. Row 0 is at v = 1 and
    column 0 at u = 0, as in an image. A ray has the grating of the dot that contains its hit. Dots have sharp edges,
    and the matrix is repeated beyond the texture coordinates 0 to 1. The edges of dots and the phase between dots do
    not diffract light.

    Turn, depth scale and pitch scale are each a number for all dots, an array with one number per dot, or a grey image.
    An image is the path of a file, or a tuple ``(path, black, white)`` of the path and the values of black and of full
    white. Values of grey levels are linear in between, without gamma. An image has unsigned integers of 8 or 16 bit, or
    floats from 0 to 1. If only the path is given, black and white are 0° and 180° for ``turn_deg``, and 0 and 1 for
    ``depth_scale``; ``pitch_scale`` requires the tuple.

    Pictures use ``Coherence("source")`` for a grating map, unless a coherence is stated for the surface or for the
    picture. If the pitch scale differs between dots, the coherence must be a source or an averaged window. Under an
    averaged window, colours are interpolated between tables for several pitch scales, within the tolerance.

    Args:
        cell: Height field of a dot with turn 0 and both scales 1. It is one patch or period whose opposite edges match.
        turn_deg: Turn of the cell from its tangent towards its bitangent [degrees], −36,000 to 36,000, shape (rows,
            columns) or one number, default 0. As viewed from outside, it is counter-clockwise, and clockwise where the
            texture is mirrored.
        depth_scale: Factor of the heights, 0 to 1000, shape (rows, columns) or one number, default 1.
        pitch_scale: Factor of all lengths in the surface, 0.001 to 1000, shape (rows, columns) or one number, default
            1. The largest one is at most 4 times the smallest one.

    Raises:
        TypeError: The cell is not a height field, or a value is neither a number, an array nor an image.
        ValueError: The shapes of the values differ, a value is NaN or out of its range, an image is not grey, or the
            edges of the cell do not match.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> cell = wd.gratings.sinusoidal(1.2, 0.15)
        >>> wd.GratingMap(cell, turn_deg=np.linspace(0.0, 90.0, 12).reshape(3, 4), pitch_scale=1.1)
        GratingMap(3 × 4 dots (rows × columns), turn 0° to 90°, depth scale 1, pitch scale 1.1)
    """

    def __init__(
        self, cell: HeightField, *, turn_deg: DotValues = 0.0, depth_scale: DotValues = 1.0,
        pitch_scale: DotValues = 1.0,
    ) -> None:  # fmt: skip
        with renaming({"heightfield": "cell"}):
            check_whole(cell)
            check_periodic(cell)
        self._cell = cell
        values = {
            "turn_deg": _checked(turn_deg, "turn_deg", least=-_MOST_TURN_DEG, most=_MOST_TURN_DEG),
            "depth_scale": _checked(depth_scale, "depth_scale", least=0.0, most=MOST_SCALE),
            "pitch_scale": _checked(pitch_scale, "pitch_scale", least=LEAST_SCALE, most=MOST_SCALE),
        }
        shapes = {name: value.shape for name, value in values.items() if value.ndim}
        if len(set(shapes.values())) > 1:
            listing = ", ".join(f"{ref(name)} {shape}" for name, shape in shapes.items())
            raise ArgumentValueError(
                f"{ref('turn_deg')}, {ref('depth_scale')} and {ref('pitch_scale')} must have the same shape (rows, "
                f"columns), or be one number each, got {listing}: resample them to one size"
            )
        self._shape: tuple[int, int] = next(iter(shapes.values()), (1, 1))  # type: ignore[assignment]
        rows, columns = self._shape
        memory.require_memory(_BYTES_PER_DOT * rows * columns, f"a map of {rows} × {columns} dots", "take fewer dots")
        self._values = {name: np.array(np.broadcast_to(value, self._shape)) for name, value in values.items()}
        for array in self._values.values():
            array.setflags(write=False)
        least, most = self._pitch_range
        if most > MOST_PITCH_RATIO * least:
            raise ArgumentValueError(
                f"{ref('pitch_scale')} must have a largest value of at most {MOST_PITCH_RATIO:g} times the smallest "
                f"one, got {least:g} to {most:g}: split the map into parts of the mesh, each with a map of its own"
            )
        shortest, longest = least * min(cell.pitch_um), most * max(cell.pitch_um)
        if not (shortest >= validation.LEAST and longest <= validation.MOST):
            raise ArgumentValueError(
                f"{ref('pitch_scale')} must make a pitch of {validation.LEAST:g} to {validation.MOST:g} µm, got "
                f"{least:g} to {most:g} for a cell with a pitch of {cell.pitch_um[0]:g} × {cell.pitch_um[1]:g} µm"
            )

    def __repr__(self) -> str:
        def text(name: str, unit: str = "") -> str:
            low, high = self._values[name].min(), self._values[name].max()
            return f"{low:g}{unit}" if low == high else f"{low:g}{unit} to {high:g}{unit}"

        return (
            f"GratingMap({self.shape[0]} × {self.shape[1]} dots (rows × columns), turn {text('turn_deg', '°')}, "
            f"depth scale {text('depth_scale')}, pitch scale {text('pitch_scale')})"
        )

    @property
    def cell(self) -> HeightField:
        """Common grating of all dots (rectangles of the map), with turn 0, depth scale 1 and pitch scale 1."""
        return self._cell

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns of the matrix of dots (small rectangles of a surface)."""
        return self._shape

    @property
    def turn_deg(self) -> NDArray[np.float64]:
        """Counter-clockwise turns of the dots (rectangles) of the map [degrees], shape (rows, columns), read-only."""
        return self._values["turn_deg"]

    @property
    def depth_scale(self) -> NDArray[np.float64]:
        """Factors of the heights of the dots (small rectangles) of the map, shape (rows, columns), read-only."""
        return self._values["depth_scale"]

    @property
    def pitch_scale(self) -> NDArray[np.float64]:
        """Factors of the lengths of the dots (small rectangles) of the map, shape (rows, columns), read-only."""
        return self._values["pitch_scale"]

    def dot(self, row: int, column: int) -> Dot:
        """Return the grating of one dot (small rectangle of the map), by its row and column.

        Args:
            row: Row of the dot, 0 to rows − 1, from the top.
            column: Column of the dot, 0 to columns − 1, from the left.

        Examples:
            >>> import warpdiff as wd
            >>> grating_map = wd.GratingMap(wd.gratings.sinusoidal(1.2, 0.15), turn_deg=[[0.0, 30.0]])
            >>> grating_map.dot(0, 1)
            Dot(turn_deg=30.0, depth_scale=1.0, pitch_scale=1.0)
        """
        validation.count(row, "row", least=0, most=self.shape[0] - 1)
        validation.count(column, "column", least=0, most=self.shape[1] - 1)
        return Dot(*(float(self._values[name][row, column]) for name in Dot._fields))

    def table(self) -> Table:
        """Return a table with a line per dot: row, column, ``turn_deg``, ``depth_scale`` and ``pitch_scale``.

        Dots are the small rectangles of the map. ``save("dots.csv")`` writes the table to a file, for programs that
        expose dots; :meth:`load` reads such a file.

        Examples:
            >>> import warpdiff as wd
            >>> print(wd.GratingMap(wd.gratings.sinusoidal(1.2, 0.15), turn_deg=[[0.0, 30.0]]).table())
            row  column  turn_deg  depth_scale  pitch_scale
              0       0         0            1            1
              0       1        30            1            1
        """
        places = dict(zip(_PLACES, np.indices(self.shape).reshape(2, -1), strict=True))
        return Table(places | {name: values.ravel() for name, values in self._values.items()})

    save = save_table

    @classmethod
    def load(cls, path: str | os.PathLike[str], cell: HeightField) -> GratingMap:
        """Read a grating map from a CSV file of ``save``, with a line per dot and any order of lines and columns.

        Args:
            path: File with the columns ``row`` and ``column``, which count from 0, and at least one of ``turn_deg``,
                ``depth_scale`` and ``pitch_scale``. Other columns are ignored.
            cell: Height field of a dot with turn 0 and both scales 1.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: A column is missing, dots are missing or occur twice, or values are out of their range.

        Examples:
            >>> import warpdiff as wd
            >>> cell = wd.gratings.sinusoidal(1.2, 0.15)
            >>> path = wd.GratingMap(cell, turn_deg=[[0.0, 30.0]]).save("dots.csv")
            >>> wd.GratingMap.load(path, cell)
            GratingMap(1 × 2 dots (rows × columns), turn 0° to 30°, depth scale 1, pitch scale 1)
        """
        validation.instance(cell, HeightField, "cell")
        file = validation.path(path, "path")
        with files.describing(file):
            columns = csv_columns.read(file, (*_PLACES, *Dot._fields))
            given = [name for name in Dot._fields if name in columns]
            if not given or any(name not in columns for name in _PLACES):
                raise ArgumentValueError(
                    f"{ref('path')} must have the columns row, column and at least one of {', '.join(Dot._fields)}, "
                    f"got {', '.join(columns) or 'none of them'}"
                )
            places = np.stack([columns[name] for name in _PLACES])
            count = places.shape[1]
            if not ((places >= 0.0) & (places < count) & (places % 1.0 == 0.0)).all():
                raise ArgumentValueError(
                    f"{ref('path')} must have whole numbers from 0 as row and column, below the number of lines, "
                    f"{count}: number the dots from 0, and add the missing ones"
                )
            rows, dots_of_row = (int(side) + 1 for side in places.max(axis=1))
            # The order of the dots (small rectangles) in the file has no effect.
            index = places[0] * dots_of_row + places[1]
            order = np.argsort(index)
            if rows * dots_of_row != count or not np.array_equal(index[order], np.arange(count)):
                raise ArgumentValueError(
                    f"{ref('path')} must have one line for each dot, got {count} lines for {rows} × {dots_of_row} "
                    "dots: add the missing dots, and remove those that occur twice"
                )
            shape = rows, dots_of_row
            return cls(cell, **{name: columns[name][order].reshape(shape) for name in given})

    @property
    def _pitch_range(self) -> tuple[float, float]:
        pitch = self.pitch_scale
        return float(pitch.min()), float(pitch.max())

    @property
    def has_one_pitch(self) -> bool:
        """Whether all dots (rectangles of the map) have the same pitch scale, the factor of lengths."""
        return self._pitch_range[0] == self._pitch_range[1]

    @property
    def has_one_shape(self) -> bool:
        """Whether all dots have the same pitch scale and depth scale, so that they differ only in their turn.

        Dots are small rectangles of the surface. Each dot has a copy of the same grating.
        """
        return self.has_one_pitch and float(np.ptp(self.depth_scale)) == 0.0

    @forks.cached_property
    def reference(self) -> HeightField:
        """The cell with the largest depth scale and pitch scale of the map; a table of its spectrum serves all dots.

        Dots are small rectangles of the surface. Relative to this field, no dot has a scale above 1. The scattering
        vectors at which dots read a table are therefore not longer than those of the surface: |(u, v)| and |w| are at
        most 2.
        """
        depth, pitch = float(self.depth_scale.max()), self._pitch_range[1]
        if depth == 1.0 and pitch == 1.0:
            return self.cell
        dy, dx = self.cell.pitch_um
        return HeightField.of_known_scale(depth * self.cell.heights_um, (pitch * dy, pitch * dx))

    def table_coherence(self, coherence: Coherence) -> Coherence:
        """Return the coherence for which the table of power spectra of :attr:`reference` is made.

        A source of the angular spread s blurs the scattering vectors of a dot (small rectangle of the map) by p s,
        where p is the pitch scale of the dot relative to :attr:`reference`. The table for a source is made with the
        blur of the smallest p. Look-ups for dots with a larger p add the rest of the blur, see :attr:`transforms`.
        """
        least, most = self._pitch_range
        if coherence.angular_diameter_deg is None or least == most:
            return coherence
        return replace(coherence, angular_diameter_deg=coherence.angular_diameter_deg * (least / most))

    @forks.cached_property
    def transforms(self) -> NDArray[np.float32]:
        """Numbers that transform scattering vectors, four per dot, shape (rows, columns, 4), float32.

        The four numbers are p cos φ, p sin φ, d, and the ratio of p to the smallest p of the map. φ is the turn of the
        dot, a small rectangle of the map. p and d are its pitch scale and depth scale relative to :attr:`reference`.
        """
        turn = np.radians(self.turn_deg % 360.0)
        least, most = self._pitch_range
        pitch = self.pitch_scale / most
        depth = self.depth_scale / (float(self.depth_scale.max()) or 1.0)
        numbers = [pitch * np.cos(turn), pitch * np.sin(turn), depth, self.pitch_scale / least]
        result = np.stack(numbers, axis=2).astype(np.float32)
        result.setflags(write=False)
        return result


def _checked(
    value: object, name: str, *, least: float, most: float
) -> NDArray[np.float64]:  # fmt: skip
    """Return turns or scales of dots from a number, an array or an image: shape (rows, columns), or () for a number.

    Dots are the small rectangles of a grating map.
    """
    if _is_image(value):
        numbers = _from_image(value, name)
    else:
        numbers = validation.finite_array(value, name, most=1e9, bytes_per_number=_BYTES_PER_DOT)
    if numbers.ndim not in (0, 2) or numbers.size == 0:
        raise ArgumentValueError(
            f"{ref(name)} must be one number, or have shape (rows, columns) with at least one dot, got shape "
            f"{numbers.shape}"
        )
    bad = ~((numbers >= least) & (numbers <= most))
    if bad.any():
        bounds = validation.range_text(None, least, most)
        raise ArgumentValueError(
            f"{ref(name)} must be {bounds}, got {numbers[bad][0]:g} at {int(np.count_nonzero(bad))} of {bad.size} dots"
        )
    return numbers


def _is_image(value: object) -> bool:
    """Whether a value is the path of an image, or a tuple that begins with a path."""
    first = value[0] if isinstance(value, tuple) and value else value
    return isinstance(first, (str, os.PathLike))


def _from_image(value: Any, name: str) -> NDArray[np.float64]:
    """Return turns or scales of dots from a grey image; they are linear between the values of black and of white.

    Dots are the small rectangles of a grating map. Each dot has the value of one pixel of the image.
    """
    ends = _BLACK_AND_WHITE.get(name)
    if isinstance(value, tuple):
        if len(value) != 3:
            raise ArgumentTypeError(
                f"{ref(name)} must be (path, black, white) for an image, got a tuple of {len(value)} values"
            )
        value, *given = value
        black, white = (
            validation.number(number, f"{name}[{place}]", least=-_MOST_TURN_DEG, most=_MOST_TURN_DEG)
            for place, number in enumerate(given, start=1)
        )
        ends = black, white
    if ends is None:
        raise ArgumentValueError(
            f"{ref(name)} must state the values of black and white for an image, got {str(value)!r} alone: give "
            "(path, black, white), such as ('pitch.png', 0.8, 1.25)"
        )
    return np.asarray(ends[0] + (ends[1] - ends[0]) * grey_levels(value, name))
