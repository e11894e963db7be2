"""``Relief``: a height field or an outline as the functions with derivatives use it."""

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

# Number of samples that an outline counts as having along x. Limit: its coefficients of all orders are distinct, and
# orders are at most some thousands.
_OUTLINE_SAMPLES = 2**40
# Number of coefficients that are computed together, of a height field or of one vertex of an outline. Limit: memory.
_SITES_TOGETHER = 8192


@dataclass(frozen=True)
class _Lattice:
    """Size of one period of an outline; see ``Periodic``."""

    shape: tuple[int, int]
    size_um: tuple[float, float]
    height_range_um: float


@dataclass(frozen=True)
class Relief:
    """One period of a surface.

    Attributes:
        surface: Height field or outline.
        shape: Numbers of samples (y, x); one sample is a constant axis.
        size_um: Size (y, x) [µm].
        scale_um: Half of the height range [µm].
    """

    surface: HeightField | Outline
    shape: tuple[int, int]
    size_um: tuple[float, float]
    scale_um: float

    @classmethod
    def of(cls, surface: HeightField | Outline) -> Relief:
        """Check a height field or an outline."""
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
        """Whether the surface is an outline."""
        return isinstance(self.surface, Outline)

    @property
    def variable(self) -> str:
        """Name of the variable of the surface itself."""
        return "vertices" if self.is_outline else "heights_um"

    @property
    def variable_shape(self) -> tuple[int, ...]:
        """Shape of the variable of the surface itself."""
        return (len(self.surface.heights_um), 2) if self.is_outline else self.shape

    @property
    def lattice(self) -> Periodic:
        """Size and constant axes, on which the directions of orders depend."""
        if isinstance(self.surface, HeightField):
            return self.surface
        return _Lattice((1, 2), self.size_um, self.surface.height_range_um)

    @property
    def sites_together(self) -> int:
        """Number of coefficients that are computed together."""
        return max(_SITES_TOGETHER // len(self.surface.heights_um), 16) if self.is_outline else _SITES_TOGETHER

    @property
    def samples(self) -> int:
        """Number of heights that are stored."""
        return int(self.surface.heights_um.size)

    def terms(self, sites: Sites, kappas: NDArray[np.float64], count: int) -> SurfaceTerms:
        """Return the coefficients at sites and nodes of |κ| [1/µm]; ``count`` terms expand those of a height field."""
        if isinstance(self.surface, Outline):
            return OutlineTerms(self.surface, sites, kappas)
        return HeightTerms(self.surface.heights_um, sites, kappas, count)
