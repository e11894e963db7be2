"""Choice of the writer of a height field by the suffix of the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import files
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.writers.gds_layout import write_gds
from warpdiff.heightfield.writers.grey_image import dose_curve, write_grey
from warpdiff.heightfield.writers.height_levels import levels_of
from warpdiff.heightfield.writers.stl_solid import write_stl

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SUFFIXES = (".npz", ".gds", ".png", ".stl")


def check(path: str | os.PathLike[str], dose: object) -> tuple[Path, Array | None]:
    """Check the path of a file and the calibration of a resist, before heights are rounded."""
    target = files.check_output(path, SUFFIXES)
    if dose is not None and (suffix := target.suffix.lower()) != ".png":
        raise ArgumentValueError(
            f"{ref('dose')} must not be given for {suffix} files, got a curve: only .png files have doses"
        )
    return target, None if dose is None else dose_curve(dose)


def write(
    target: Path, heights_um: Array, pitch_um: tuple[float, float], levels: object, curve: Array | None,
    history: tuple[str, ...],
) -> None:  # fmt: skip
    """Round heights to ``levels`` and write them to a file; the arguments are those of `HeightField.save`."""
    suffix = target.suffix.lower()
    if suffix == ".gds":
        write_gds(target, levels_of(heights_um, levels), pitch_um)
        return
    heights = heights_um if levels is None else levels_of(heights_um, levels).rounded_um
    if suffix == ".png":
        write_grey(target, heights, pitch_um, curve)
    elif suffix == ".stl":
        write_stl(target, heights, pitch_um)
    else:
        arrays = {"heights_um": heights, "pitch_um": pitch_um, "history": np.array(history, dtype=np.str_)}
        files.save_arrays(target, arrays, compressed=False)
