"""Height fields with parameters (profiles): all samples, square pixels, or scale, tilt and bow of a scan.

The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField, check_whole
from warpdiff.profiles.profile_base import HEIGHT_MARGIN_UM, Profile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]


class _SampledProfile(Profile):
    """Height field of a fixed pitch, whose heights are linear functions of the parameters."""

    def __init__(
        self, names: tuple[str, ...], start: ArrayLike, bounds: ArrayLike, pitch_um: tuple[float, float]
    ) -> None:
        super().__init__(names, start, bounds)
        self._pitch_um = pitch_um

    @property
    def wrt(self) -> tuple[str, ...]:
        """Names of the properties of the surface that depend on the parameters: only its heights."""
        return ("heights_um",)

    def surface(self, x: ArrayLike) -> HeightField:
        """Return the height field for the parameter values ``x``, shape (p,)."""
        return HeightField.of_known_scale(self._heights(self.check(x)), self._pitch_um)

    def height_field(self, x: ArrayLike) -> HeightField:
        """Return the height field for the parameter values ``x``, shape (p,)."""
        return self.surface(x)

    def pullback(self, x: ArrayLike, adjoints: Mapping[str, Array]) -> Array:
        """Return the adjoints (derivatives of a loss) of the parameters, shape (p,), from those of the heights."""
        self.check(x)
        return self._transposed(adjoints["heights_um"])

    def pushforward(self, x: ArrayLike, dx: ArrayLike) -> dict[str, Array]:
        """Return the changes of the heights for a change ``dx`` of the parameters, shape (p,)."""
        self.check(x)
        return {"heights_um": self._heights(self.check(dx))}

    @abstractmethod
    def _heights(self, x: Array) -> Array:
        """Return the heights [µm], shape (ny, nx), for the parameter values ``x``, shape (p,)."""

    @abstractmethod
    def _transposed(self, heights: Array) -> Array:
        """Return the derivatives of a loss by the parameters, shape (p,), from those by the heights, shape (ny, nx)."""


class Samples(_SampledProfile):
    """All heights of a height field as parameters, row by row.

    Args:
        heightfield: Start values; its pitch is fixed.

    Examples:
        >>> import warpdiff as wd
        >>> profile = wd.profiles.Samples(wd.gratings.sinusoidal(2.0, 0.1, samples=8))
        >>> len(profile.names), profile.names[1]
        (8, 'height_um[0, 1]')
    """

    def __init__(self, heightfield: HeightField) -> None:
        check_whole(heightfield)
        self._shape = heightfield.shape
        heights = heightfield.heights_um.ravel()
        names = tuple(f"height_um[{j}, {i}]" for j, i in np.ndindex(self._shape))
        bounds = np.stack([heights - HEIGHT_MARGIN_UM, heights + HEIGHT_MARGIN_UM], axis=1)
        super().__init__(names, heights, bounds, heightfield.pitch_um)

    def _heights(self, x: Array) -> Array:
        return x.reshape(self._shape)

    def _transposed(self, heights: Array) -> Array:
        return heights.ravel()


class Pixels(_SampledProfile):
    """Heights of square pixels as parameters, row by row.

    A single row of pixels makes a grating that is constant along y, and a single column one that is constant along x.

    Args:
        pixel_um: Size of a pixel [µm].
        levels: Heights of the pixels [µm], the start values, shape (ny, nx).
        samples: Number of samples along each side of a pixel, at least 1, by default 4; a single row has one sample
            along y, and a single column one along x.

    Raises:
        ValueError: The pixels are not a matrix with at least one pixel, or a number is out of its range.

    Attributes:
        pixel_um: Size of a pixel [µm].
        pixels: Numbers of pixels (ny, nx).
        samples: Number of samples along each side of a pixel.

    Examples:
        >>> import warpdiff as wd
        >>> profile = wd.profiles.Pixels(0.5, [[0.0, 0.1], [0.1, 0.0]], samples=2)
        >>> profile.surface(profile.start).heights_um[0]
        array([0. , 0. , 0.1, 0.1])
    """

    def __init__(self, pixel_um: float, levels: ArrayLike, samples: int = 4) -> None:
        heights = validation.finite_array(levels, "levels", ndim=2, most=validation.MOST)
        if not heights.size:
            raise ArgumentValueError(f"{ref('levels')} must have at least one pixel, got shape {heights.shape}")
        self.samples, self.pixels = validation.count(samples, "samples"), heights.shape
        self.pixel_um = validation.positive(pixel_um, "pixel_um")
        ny, nx = heights.shape
        self._along_y = self.samples if ny > 1 else 1
        self._along_x = self.samples if nx > 1 or ny == 1 else 1
        names = tuple(f"level_um[{j}, {i}]" for j, i in np.ndindex(heights.shape))
        flat = heights.ravel()
        bounds = np.stack([flat - HEIGHT_MARGIN_UM, flat + HEIGHT_MARGIN_UM], axis=1)
        super().__init__(names, flat, bounds, (self.pixel_um / self._along_y, self.pixel_um / self._along_x))

    def _heights(self, x: Array) -> Array:
        rows = np.repeat(x.reshape(self.pixels), self._along_y, axis=0)
        return np.asarray(np.repeat(rows, self._along_x, axis=1))

    def _transposed(self, heights: Array) -> Array:
        ny, nx = self.pixels
        return np.asarray(heights.reshape(ny, self._along_y, nx, self._along_x).sum(axis=(1, 3)).ravel())


class ScanModes(_SampledProfile):
    """Scale, tilt and bow of a scan (a measured height field) as parameters.

    The calibration of an instrument leaves these parameters uncertain.
    The heights are scale · h + tilt_y · y + tilt_x · x + bow · (x² + y² − mean), where x and y run from −½ to ½ over
    the patch.

    Args:
        heightfield: The scan h.
        scale: Start value of the scale, 0 to 10, by default 1.
        tilt: Start values of the tilts (y, x) over the patch [µm], −10 to 10, by default 0.
        bow: Start value of the bow [µm], −10 to 10, by default 0.

    Examples:
        >>> import warpdiff as wd
        >>> profile = wd.profiles.ScanModes(wd.gratings.bumps())
        >>> profile.names
        ('scale', 'tilt_y_um', 'tilt_x_um', 'bow_um')
    """

    def __init__(
        self, heightfield: HeightField, scale: float = 1.0, tilt: tuple[float, float] = (0.0, 0.0), bow: float = 0.0
    ) -> None:
        check_whole(heightfield)
        y, x = ((np.arange(n) + 0.5) / n - 0.5 for n in heightfield.shape)
        y, x = np.meshgrid(y, x, indexing="ij")
        square = y * y + x * x
        self._modes = np.stack([heightfield.heights_um, y, x, square - square.mean()])
        start = [
            validation.number(scale, "scale"), *validation.numbers(tilt, "tilt", length=2),
            validation.number(bow, "bow"),
        ]  # fmt: skip
        margin = [[-HEIGHT_MARGIN_UM, HEIGHT_MARGIN_UM]] * 3
        names = ("scale", "tilt_y_um", "tilt_x_um", "bow_um")
        super().__init__(names, start, [[0.0, 10.0], *margin], heightfield.pitch_um)

    def _heights(self, x: Array) -> Array:
        return np.asarray(np.tensordot(x, self._modes, axes=1))

    def _transposed(self, heights: Array) -> Array:
        return np.asarray(np.tensordot(self._modes, heights, axes=2))
