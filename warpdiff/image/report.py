"""Reports: the errors and the refinement of a picture, as its rendering estimates them."""

from __future__ import annotations

import html
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.image.error_model import share_beyond

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Tolerance at edges of the mesh or of shadows over that of the interior (limit: no filter is converged there).
EDGES_PER_TOLERANCE = 3.0
# Shares of the interior pixels and of those at edges that may exceed their tolerance in a picture that can be trusted.
MOST_UNCONVERGED, MOST_UNCONVERGED_EDGES = 0.01, 0.05


@dataclass(frozen=True)
class Report:
    """Report on the errors and the refinement of a picture.

    Attributes:
        tolerance: Tolerance that the picture was rendered to.
        errors: Median and 99th percentile of the estimated errors of the illuminated pixels.
        is_refined: Whether pixels were refined; nothing is guaranteed otherwise.
        refined_share: Share of the covered pixels that were subdivided; for several lights, the largest.
        unconverged_share: Share of the illuminated interior pixels whose error is expected to exceed the tolerance; 0
            without refinement.
        unconverged_edge_share: Share of the pixels at edges, of the mesh or of shadows, whose error is expected to
            exceed three tolerances; 0 without refinement.
        light_sample_count: Number of directions and lobes that represent the lights.
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
        """Whether few pixels are expected to exceed their tolerance: 1 % of the interior and 5 % at edges.

        Without refinement no pixel is, as nothing is guaranteed then: see ``is_refined``.
        """
        return self.unconverged_share <= MOST_UNCONVERGED and self.unconverged_edge_share <= MOST_UNCONVERGED_EDGES

    @property
    def verdict(self) -> str:
        """Whether the picture can be trusted, in a sentence."""
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
    """Return the report on the estimated relative errors of pixels, arrays (height, width).

    ``edges`` tells through which of them an edge passes; None is a picture without refinement. The other arguments are
    those of :class:`Report`.
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
