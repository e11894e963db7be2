"""``Relief``: a height field or an outline, with the properties that the functions with derivatives require."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from warpdiff.adjoint.height_terms import HeightTerms, offset_and_scale
from warpdiff.adjoint.outline_terms import OutlineTerms
from warpdiff.core.wording import ArgumentTypeError, ref
from warpdiff.heightfield.field import HeightField, check_whole
from warpdiff.profiles.outline import Outline

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.adjoint.sites import Sites
    from warpdiff.adjoint.surface_terms import SurfaceTerms
    from warpdiff.evaluate.orders import Periodic

# Number of samples along x that an outline counts as having. The number is larger than any order. Different orders of
# an outline therefore have different Fourier coefficients, without aliasing.
_OUTLINE_SAMPLES = 2**40
# Number of Fourier coefficients that are computed at once, divided by the number of vertices for an outline. The value
# is limited by memory: if it is doubled, the computation requires twice the memory.
_SITES_TOGETHER = 8192


@dataclass(frozen=True)
class _Lattice:
    """Shape and size of one period of a profile that is given as a polygon, with the attributes of ``Periodic``."""

    shape: tuple[int, int]
    size_um: tuple[float, float]
    height_range_um: float


@dataclass(frozen=True)
class Relief:
    """One period of a surface: a height field or an outline.

    Attributes:
        surface: Height field or outline.
        shape: Numbers of samples (y, x); a surface with one sample along an axis is constant along this axis.
        size_um: Size (y, x) [µm].
        scale_um: Half of the height range [µm].
    """

    surface: HeightField | Outline
    shape: tuple[int, int]
    size_um: tuple[float, float]
    scale_um: float

    @classmethod
    def of(cls, surface: HeightField | Outline) -> Relief:
        """Check that the argument is a height field without missing samples, or an outline, and return its relief."""
        scale = offset_and_scale(surface.heights_um)[1] if isinstance(surface, (HeightField, Outline)) else 0.0
        if isinstance(surface, Outline):
            return cls(surface, (1, _OUTLINE_SAMPLES), (surface.period_um, surface.period_um), scale)
        if not isinstance(surface, HeightField):
            raise ArgumentTypeError(
                f"{ref('heightfield')} must be a warpdiff.HeightField or a warpdiff.profiles.Outline, got "
                f"{type(surface).__name__}"
            )
        check_whole(surface)
        return cls(surface, surface.shape, surface.size_um, scale)

    @property
    def is_outline(self) -> bool:
        """Whether the surface is an outline, the polygon of a profile."""
        return isinstance(self.surface, Outline)

    @property
    def variable(self) -> str:
        """Name of the variable that is the surface itself: ``"heights_um"`` or ``"vertices"``."""
        return "vertices" if self.is_outline else "heights_um"

    @property
    def variable_shape(self) -> tuple[int, ...]:
        """Shape of the variable that is the surface itself: the heights, or the vertices."""
        return (len(self.surface.heights_um), 2) if self.is_outline else self.shape

    @property
    def lattice(self) -> Periodic:
        """Size of the period and its constant axes, which determine the directions of diffraction orders."""
        if isinstance(self.surface, HeightField):
            return self.surface
        return _Lattice((1, 2), self.size_um, self.surface.height_range_um)

    @property
    def sites_together(self) -> int:
        """Number of Fourier coefficients that are computed at once."""
        return max(_SITES_TOGETHER // len(self.surface.heights_um), 16) if self.is_outline else _SITES_TOGETHER

    @property
    def samples(self) -> int:
        """Number of heights that are stored: samples of a height field, or vertices of an outline."""
        return int(self.surface.heights_um.size)

    def terms(self, sites: Sites, kappas: NDArray[np.float64], count: int) -> SurfaceTerms:
        """Return the Fourier coefficients at the frequencies ``sites``, for the values ``kappas`` of |κ| [1/µm].

        For a height field, the coefficients are series of ``count`` terms. For an outline, they are exact.
        """
        if isinstance(self.surface, Outline):
            return OutlineTerms(self.surface, sites, kappas)
        return HeightTerms(self.surface.heights_um, sites, kappas, count)
