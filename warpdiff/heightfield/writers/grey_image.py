"""16-bit grey images for grey-scale lithography: the samples are heights, or doses of an exposure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import files, validation
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# The calibration curve of a resist gives a dose for each depth, up to a largest depth. Depths may exceed it by this
# relative amount, because differences of heights have rounding errors.
_DEPTH_TOLERANCE = 1e-9
# Largest sample of a 16-bit image.
_WHITE = 65535


def dose_curve(dose: object) -> NDArray[np.float64]:
    """Check and return the calibration curve of a resist: depths [µm] and doses (0 to 1), shape (n, 2)."""
    curve = validation.finite_array(dose, "dose", ndim=2, most=validation.MOST)
    if curve.shape[1:] != (2,) or len(curve) < 2:
        raise ArgumentValueError(f"{ref('dose')} must be at least two pairs of depth and dose, got shape {curve.shape}")
    if np.any(np.diff(curve[:, 0]) <= 0.0) or curve[:, 1].min() < 0.0 or curve[:, 1].max() > 1.0:
        raise ArgumentValueError(
            f"{ref('dose')} must have increasing depths and doses within 0 to 1, got depths "
            f"{curve[:, 0].tolist()!s:.60} and doses {curve[:, 1].tolist()!s:.60}"
        )
    return curve


def write_grey(
    target: Path, heights_um: NDArray[np.float64], pitch_um: tuple[float, float], curve: NDArray[np.float64] | None
) -> None:
    """Write a grey image whose samples are proportional to heights, or to the doses that ``curve`` gives for depths."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    low, high = float(heights_um.min()), float(heights_um.max())
    texts = {"pitch_um (y x)": f"{pitch_um[0]:.17g} {pitch_um[1]:.17g}", "height_range_um": f"{high - low:.17g}"}
    if curve is None:
        shares = (heights_um - low) / (high - low) if high > low else np.zeros_like(heights_um)
        texts["samples"] = "height above the lowest point"
    else:
        depths = high - heights_um
        slack = _DEPTH_TOLERANCE * (high - low)
        if curve[0, 0] > slack or curve[-1, 0] < high - low - slack:
            raise ArgumentValueError(
                f"{ref('dose')} must cover the depths 0 to {high - low:g} µm, got {curve[0, 0]:g} to {curve[-1, 0]:g} "
                "µm: measure the curve over all depths"
            )
        shares = np.interp(depths, curve[:, 0], curve[:, 1])
        texts["samples"] = "dose, 65535 is the dose 1"
    info = PngInfo()
    for name, text in texts.items():
        info.add_text(name, text)
    samples = np.rint(_WHITE * shares).astype(np.uint16)
    with files.atomic_write(target, suffix=".png") as temporary:
        Image.fromarray(samples).save(temporary, format="PNG", pnginfo=info)
