"""Comparison of a picture with a reference, by the error measure to which ``tolerance`` refers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Gt

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.image.error_model import luminance_floor
from warpdiff.image.image import Image

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Comparison:
    """Errors of a picture relative to a reference, the result of :func:`warpdiff.compare`.

    Attributes:
        error: Relative error of each pixel, shape (height, width), float64; 0 outside ``pixels``.
        pixels: Mask of the compared pixels, shape (height, width).
        tolerance: Relative error with which ``share_beyond_tolerance`` and ``reported_share`` compare the errors of
            pixels.
        p50: Median of the errors of the compared pixels.
        p90: 90th percentile of the errors of the compared pixels.
        p99: 99th percentile of the errors of the compared pixels.
        share_beyond_tolerance: Fraction of the compared pixels whose error exceeds the tolerance.
        reported_share: Among the pixels whose error exceeds the tolerance, the fraction whose estimated error
            (``image.error``) exceeds the tolerance, too. None if the picture has no estimated errors, or if no pixel
            exceeds the tolerance.
        luminance_ratio: Sum of the luminances Y of the compared pixels, divided by the same sum of the reference.

    Examples:
        >>> import warpdiff as wd
        >>> import numpy as np
        >>> reference = np.full((4, 4, 3), 0.5)
        >>> comparison = wd.compare(1.02 * reference, reference, tolerance=0.1)
        >>> round(comparison.p99, 3), comparison.share_beyond_tolerance
        (0.02, 0.0)
    """

    error: NDArray[np.float64]
    pixels: NDArray[np.bool_]
    tolerance: float
    p50: float
    p90: float
    p99: float
    share_beyond_tolerance: float
    reported_share: float | None
    luminance_ratio: float

    def as_dict(self) -> dict[str, float | int | None]:
        """Return the numbers of the comparison by name, for a JSON file; the arrays of the comparison are omitted."""
        return {
            "pixels": int(self.pixels.sum()), "tolerance": self.tolerance, "p50": self.p50, "p90": self.p90,
            "p99": self.p99, "share_beyond_tolerance": self.share_beyond_tolerance,
            "reported_share": self.reported_share, "luminance_ratio": self.luminance_ratio,
        }  # fmt: skip

    def __repr__(self) -> str:
        return (
            f"Comparison({int(self.pixels.sum()):,} pixels, P50 / P90 / P99 of errors {self.p50:.2g} / "
            f"{self.p90:.2g} / {self.p99:.2g}, {100.0 * self.share_beyond_tolerance:.2g} % beyond {self.tolerance:g}, "
            f"luminance × {self.luminance_ratio:.3g})"
        )


def compare(
    image: Image | ArrayLike, reference: Image | ArrayLike, *, tolerance: Annotated[float, Gt(0.0)] | None = None,
    pixels: ArrayLike | None = None,
) -> Comparison:  # fmt: skip
    """Compare a picture with a reference, with the same error measure as ``tolerance``.

    The error of a pixel is ‖ΔXYZ‖ / max(‖XYZ‖, 1e-3 · Y*), with XYZ and Y* of the reference. Y is the luminance of a
    pixel. Y* is the 99th percentile of Y over all pixels, or the median of Y weighted by Y if this median is larger.

    Args:
        image: The picture: an :class:`~warpdiff.Image`, or linear CIE XYZ from any method, shape (height, width, 3).
        reference: The reference, of the same size.
        tolerance: Tolerance with which errors are compared; None uses the tolerance of ``image``.
        pixels: Mask of the pixels to compare, shape (height, width). None compares all pixels that are not black in
            the reference, including partly covered pixels at edges of the mesh.

    Raises:
        ValueError: The sizes differ, no pixel is compared, or ``tolerance`` is missing.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> reference = np.full((4, 4, 3), 0.5)
        >>> wd.compare(1.02 * reference, reference, tolerance=0.1)
        Comparison(16 pixels, P50 / P90 / P99 of errors 0.02 / 0.02 / 0.02, 0 % beyond 0.1, luminance × 1.02)
    """
    xyz, exact = _xyz(image, "image"), _xyz(reference, "reference")
    if xyz.shape != exact.shape:
        raise ArgumentValueError(
            f"{ref('image')} and {ref('reference')} must have the same size, got {xyz.shape[1]} × {xyz.shape[0]} "
            f"and {exact.shape[1]} × {exact.shape[0]} pixels"
        )
    if tolerance is None:
        report = image.report if isinstance(image, Image) else None
        if report is None:
            raise ArgumentValueError(f"{ref('tolerance')} is required, as {ref('image')} has none of its own")
        tolerance = report.tolerance
    tolerance = validation.positive(tolerance, "tolerance")
    compared: NDArray[np.bool_] = np.asarray(exact.any(axis=2))
    if pixels is not None:
        compared = validation.finite_array(pixels, "pixels", flags=True) != 0.0
        if compared.shape != exact.shape[:2]:
            raise ArgumentValueError(f"{ref('pixels')} must have the shape {exact.shape[:2]}, got {compared.shape}")
    if not compared.any():
        raise ArgumentValueError(f"{ref('pixels')}: no pixel is compared, as the reference is black or the mask empty")
    floor = luminance_floor(exact[compared][:, 1])
    error = np.zeros(exact.shape[:2])
    size = np.maximum(np.linalg.norm(exact[compared], axis=1), floor)
    error[compared] = np.linalg.norm(xyz[compared] - exact[compared], axis=1) / size
    beyond = np.asarray(compared & (error > tolerance))
    reported = float(np.mean(image.error[beyond] > tolerance)) if isinstance(image, Image) and beyond.any() else None
    p50, p90, p99 = np.percentile(error[compared], (50.0, 90.0, 99.0)).tolist()
    ratio = float(xyz[compared][:, 1].sum() / max(exact[compared][:, 1].sum(), floor))
    return Comparison(error, compared, tolerance, p50, p90, p99, float(beyond.sum() / compared.sum()), reported, ratio)


def _xyz(picture: Image | ArrayLike, name: str) -> NDArray[np.float64]:
    """Return the linear XYZ of a picture or of an array, checked, shape (height, width, 3)."""
    result = validation.finite_array(picture.xyz if isinstance(picture, Image) else picture, name)
    if result.ndim != 3 or result.shape[2] != 3:
        raise ArgumentValueError(
            f"{ref(name)} must be an Image or linear XYZ of shape (height, width, 3), got shape {result.shape}"
        )
    return result
