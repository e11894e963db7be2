"""Comparison of ``HeightField.load`` with independent programs, on a folder of files of instruments and text exports.

``python -m bench.reproduce.instrument_files FOLDER`` prints a line for each file, and counts. The command requires the
extra ``scans``. Test files are in the repositories ContactEngineering/SurfaceTopography (test/file_format_examples),
AFM-SPM/AFMReader (tests/resources), fredericjs/surfalize (tests/test_files), heike/x3ptools and OpenFMC/x3p.

The independent programs are Gwyddion's importers (package gwyddionpy with its extra converter, if it is installed) for
binary files, a plain reading of the binary member for .x3p, and SurfaceTopography for texts. Shape, size (within 1e-4),
missing samples and heights (within 1e-3 of the height range, up to a constant) must be equal, without a flip of an
axis.
"""

from __future__ import annotations

import argparse
import gzip
import io
import math
import re
import warnings
import zipfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff.heightfield.readers.length_units import factor_of

TEXTS = (".txt", ".csv", ".asc", ".gz", ".hfm")
# Suffixes of scans of heights that the library refuses to read. The other programs cannot open these files either. A
# file with such a suffix counts as a scan, although no other program confirms it.
REFUSED_SCANS = (".nms", ".h5-jpk")
# Suffixes of files in the folder that do not come from instruments. These files are skipped.
OTHERS = (".yaml", ".npy", ".py", ".nc", ".list", ".log", ".sh")
SIZE_TOLERANCE, HEIGHT_TOLERANCE = 1e-4, 1e-3
_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}


class Reading(NamedTuple):
    """Heights [µm] that a program reads from a file, top row first, NaN if missing; size (Ly, Lx) of the field [µm]."""

    heights_um: np.ndarray
    size_um: tuple[float, float]


def gwyddion_readings(path: Path) -> list[Reading]:
    """Return the height fields that Gwyddion reads from a file; each is a channel of the file in metres."""
    try:
        import gwyddionpy
    except ImportError:
        return []
    try:
        channels = gwyddionpy.load(str(path)).channels.values()
    except Exception:
        return []
    return [
        Reading(1e6 * channel.data, (1e6 * channel.yreal, 1e6 * channel.xreal))
        for channel in channels
        if channel.si_unit_xy == channel.si_unit_z == "m"
    ]


def plain_x3p(path: Path) -> list[Reading]:
    """Return the height field of an .x3p file, a zip archive with a binary file of heights.

    Regular expressions find the sizes, the number format and the sample spacings in the XML header of the archive.
    """
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if "__MACOSX" not in name]
        header = archive.read(next(name for name in names if name.endswith("main.xml"))).decode()
        header = re.sub("<!--.*?-->", "", header, flags=re.DOTALL)
        member = [name for name in names if name.endswith("data.bin")]
        if not member or "SUR" not in header:
            return []
        axes = {axis: re.search(f"<{axis}>.*?</{axis}>", header, re.DOTALL) for axis in ("CX", "CY", "CZ")}
        step = {axis: re.search("<Increment>(.*?)<", match[0]) for axis, match in axes.items() if match}
        nx, ny = (int(re.search(f"<Size{axis}>(.*?)<", header)[1]) for axis in "XY")  # type: ignore[index]
        dtype = np.dtype(_TYPES[re.search("<DataType>(.)", axes["CZ"][0])[1]])  # type: ignore[index]
        heights = np.frombuffer(archive.read(member[0]), dtype)[: nx * ny].reshape(ny, nx).astype(float)
        if dtype.kind == "i":
            heights *= float(step["CZ"][1])  # type: ignore[index]
        valid = [name for name in names if name.endswith("valid.bin")]
        if valid:
            bits = np.unpackbits(np.frombuffer(archive.read(valid[0]), np.uint8), bitorder="little")
            heights[bits[: nx * ny].reshape(ny, nx) == 0] = math.nan
        heights[np.isinf(heights)] = math.nan
    return [Reading(1e6 * heights, (1e6 * ny * float(step["CY"][1]), 1e6 * nx * float(step["CX"][1])))]  # type: ignore[index]


def text_readings(path: Path) -> list[Reading]:
    """Return the height fields that SurfaceTopography reads from a text file.

    If the file states no unit of length, the unit is nm; if it states no size, the sample spacing is one unit.
    """
    from SurfaceTopography.IO import open_topography

    try:
        data = path.read_bytes()
        if path.suffix == ".gz":
            data = gzip.decompress(data)
        channel = open_topography(io.BytesIO(data)).default_channel
        if channel.dim != 2:
            return []
        sizes = {} if channel.physical_sizes is not None else {"physical_sizes": tuple(map(float, channel.nb_grid_pts))}
        topography = channel.topography(**sizes)
    except Exception:
        return []
    factor = 1e-3 if topography.unit is None else factor_of(topography.unit) or math.nan
    heights = np.ma.filled(np.ma.asarray(topography.heights(), float), math.nan).T
    size = topography.physical_sizes
    return [Reading(factor * heights, (factor * size[1], factor * size[0]))]


def agree(field: wd.HeightField, reading: Reading, *, is_text: bool) -> bool:
    """Whether a height field equals the reading of the same file by an independent program."""
    heights = field.heights_um
    # In a reading by another program, the first row is the top row of the picture. If the attribute `rows` of a file is
    # "up", the library's field has the bottom row first, and is reversed here. A text file with columns x, y and z does
    # not state which row is at the top. Both orders are therefore accepted for text files.
    pictures = [heights[::-1] if field.source is not None and field.source.rows == "up" else heights]
    if is_text:
        pictures.append(heights)
    if heights.shape != reading.heights_um.shape:
        return False
    if not np.allclose(field.size_um, reading.size_um, rtol=SIZE_TOLERANCE, atol=0.0):
        return False
    for picture in pictures:
        known = np.isfinite(picture) & np.isfinite(reading.heights_um)
        # Gwyddion replaces missing samples by finite heights, and marks these samples in a separate channel. Such a
        # reading is compared at all samples that are not missing in the field of the library.
        if not is_text and np.isfinite(reading.heights_um).all():
            known = np.isfinite(picture)
        elif not np.array_equal(np.isnan(picture), np.isnan(reading.heights_um)):
            continue
        difference = picture[known] - reading.heights_um[known]
        if np.ptp(difference) <= HEIGHT_TOLERANCE * np.ptp(picture[known]):
            return True
    return False


def judged(path: Path) -> tuple[str, str]:
    """Read a file by the library and by an independent program.

    Return a verdict on the library's reading, and a text with the size and heights that the library read, or with its
    error message.
    """
    is_text = path.suffix.lower() in TEXTS
    try:
        if path.suffix.lower() == ".x3p":
            readings = plain_x3p(path)
        else:
            readings = text_readings(path) if is_text else gwyddion_readings(path)
    except Exception:
        readings = []
    attempts = ({}, {"unit": "nm"}, {"unit": "nm", "pitch_um": 1e-3}) if is_text else ({},)
    for options in attempts:
        try:
            field = wd.HeightField.load(path, **options)
        except ValueError as error:
            if is_text and "must be given" in str(error) and options != attempts[-1]:
                continue
            reason = str(error).replace(f"path: {str(path)!r} ", "")[:100]
            is_scan = bool(readings) or path.suffix.lower() in REFUSED_SCANS
            return ("refused" if is_scan and not is_text else "no map"), reason
        break
    stated = ", ".join(f"{name} stated" for name in options)
    text = f"{field.shape[0]} × {field.shape[1]}, {field.size_um[0]:.6g} × {field.size_um[1]:.6g} µm, range "
    text += f"{field.height_range_um:.5g} µm, {int(field.missing.sum())} missing {stated}"
    if not readings:
        return "no judge", text
    return ("right" if any(agree(field, each, is_text=is_text) for each in readings) else "WRONG"), text


def main() -> None:
    """Print the verdict on each file of the folder, and the count of each verdict."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    warnings.simplefilter("ignore")
    counts: dict[str, Counter[str]] = {"files of instruments": Counter(), "texts": Counter()}
    for path in sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix.lower() not in OTHERS):
        verdict, text = judged(path)
        counts["texts" if path.suffix.lower() in TEXTS else "files of instruments"][verdict] += 1
        print(f"{verdict:9} {path.relative_to(folder)}: {text}")
    for kind, numbers in counts.items():
        scans = sum(count for verdict, count in numbers.items() if verdict != "no map")
        shown = ", ".join(f"{count} {verdict}" for verdict, count in sorted(numbers.items()))
        print(f"{kind}: {scans} height scans: {shown}")


if __name__ == "__main__":
    main()
