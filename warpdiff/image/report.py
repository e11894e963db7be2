"""Reports on pictures: estimated errors and refinement of the pixels."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.image.error_model import share_beyond

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Factor by which pixels at edges may have a larger error than interior pixels. Edges are those of the mesh and of
# shadows. The value was chosen because means over the pixel filter converge slowly at edges.
EDGES_PER_TOLERANCE = 3.0
# Largest fractions of interior pixels and of edge pixels that may exceed their tolerance in a picture that counts as
# converged. Both values were chosen; if doubled, pictures with visible errors count as converged.
MOST_UNCONVERGED, MOST_UNCONVERGED_EDGES = 0.01, 0.05


@dataclass(frozen=True)
class Report:
    """Report on the errors and the refinement of a picture.

    Attributes:
        tolerance: Requested tolerance of the picture.
        errors: Median and 99th percentile of the estimated errors of the illuminated pixels.
        is_refined: Whether pixels were refined by subdivision. Without refinement, the error of pixels may exceed the
            tolerance.
        refined_share: Fraction of the covered pixels that were subdivided; with several lights, the largest fraction of
            all lights.
        unconverged_share: Expected fraction of the illuminated interior pixels whose error exceeds the tolerance; 0
            without refinement.
        unconverged_edge_share: Expected fraction of the pixels at edges, of the mesh or of shadows, whose error exceeds
            three times the tolerance; 0 without refinement.
        light_sample_count: Number of directions by which all lights together, such as skies, are represented.
        history: Steps that made the height field, see :attr:`warpdiff.HeightField.history`.

    Examples:
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> report = wd.shade(body, grating, light, view, tolerance=0.1).report
        >>> report.tolerance, report.is_refined
        (0.1, True)
    """

    tolerance: float
    errors: tuple[float, float]
    is_refined: bool
    refined_share: float
    unconverged_share: float
    unconverged_edge_share: float
    light_sample_count: int
    history: tuple[str, ...] = ()

    @property
    def is_converged(self) -> bool:
        """Whether at most 1 % of the interior pixels and 5 % of the edge pixels are expected to exceed their tolerance.

        The errors of edge pixels may be three times the tolerance. For a picture without refinement (see
        ``is_refined``) the value is True and guarantees nothing.
        """
        return self.unconverged_share <= MOST_UNCONVERGED and self.unconverged_edge_share <= MOST_UNCONVERGED_EDGES

    @property
    def verdict(self) -> str:
        """Sentence that says whether the picture meets its tolerance."""
        if not self.is_refined:
            return (
                f"Pixels were not refined: 99 % of the illuminated pixels have an estimated error of at most "
                f"{self.errors[1]:.2g}, for a tolerance of {self.tolerance:g}."
            )
        if self.is_converged:
            return (
                f"The picture meets its tolerance of {self.tolerance:g}: {100.0 * self.unconverged_share:.2g} % of the "
                f"interior pixels are expected to exceed it, and {100.0 * self.unconverged_edge_share:.2g} % of those "
                f"at edges three times as much."
            )
        return (
            f"The picture does not meet its tolerance of {self.tolerance:g} everywhere: see the unconverged pixels "
            "below, and image.error."
        )

    def __str__(self) -> str:
        rows = {
            "estimated error, median": f"{self.errors[0]:.1e}",
            "estimated error, 99th percentile": f"{self.errors[1]:.1e}",
            "pixels that were subdivided": f"{100.0 * self.refined_share:.3g} %",
            "unconverged pixels, interior": f"{100.0 * self.unconverged_share:.2g} %",
            "unconverged pixels, edges": f"{100.0 * self.unconverged_edge_share:.2g} %",
            "directions of the lights": f"{self.light_sample_count:,}",
        }
        lines = [self.verdict, *(f"  {label:34}{value}" for label, value in rows.items())]
        if self.history:
            lines += ["Height field:", *(f"  {step}" for step in self.history)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


def report_of(
    error: NDArray[np.float32], illuminated: NDArray[np.bool_], edges: NDArray[np.bool_] | None, *,
    tolerance: float, refined_share: float, light_sample_count: int,
) -> Report:  # fmt: skip
    """Return the report on a picture.

    Args:
        error: Estimated relative error of each pixel, shape (height, width).
        illuminated: Mask of the illuminated pixels, shape (height, width).
        edges: Mask of the pixels that contain an edge of the mesh or of a shadow, shape (height, width). None for a
            picture without refinement.
        tolerance: Requested tolerance of the picture.
        refined_share: Fraction of the covered pixels that were subdivided.
        light_sample_count: Number of directions by which all lights together are represented.
    """
    visible = error[illuminated]
    median, percentile_99 = np.percentile(visible, (50.0, 99.0)).tolist() if visible.size else (0.0, 0.0)
    inside = at_edges = 0.0
    if edges is not None:
        inside = share_beyond(error[illuminated & ~edges], tolerance)
        at_edges = share_beyond(error[illuminated & edges], EDGES_PER_TOLERANCE * tolerance)
    return Report(
        tolerance, (median, percentile_99), edges is not None, refined_share, inside, at_edges, light_sample_count
    )
