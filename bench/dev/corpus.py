"""Comparison of all results before and after a change of the code, which must be equal to the bit.

::

    python -m bench.dev.corpus --write before.npz
    python -m bench.dev.corpus --compare before.npz

The script uses only public names, and imports the package that is installed for this Python. In an environment with the
wheel of another version, the script writes the arrays of that version. ``public_names`` maps public names that have
changed since version 0.1.0. The modules ``corpus_pictures``, ``corpus_surfaces`` and ``corpus_files`` have the test
cases.

The cases cover all kinds of coherence, methods, sample counts, lights, materials, textures, cameras and files, with one
thread and with two. The values of a case include the numbers of its plan, such as wavelengths and terms of series.
Texts are not compared, except for names of objects. Surfaces are small and synthetic. Other processors or other
versions of libraries may round differently. Write and compare the arrays on the same machine, in environments with the
same versions of all libraries.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.dev.corpus_files import baked_lobes, baked_spectrum, mesh_files, pages, saved_pictures, sequences
from bench.dev.corpus_inputs import (
    ABOVE,
    MEDIUM,
    SIDE,
    SIZE,
    SMALL,
    SOURCE,
    box,
    box_view,
    disc_view,
    fingers,
    tube_view,
    two_geometries,
)
from bench.dev.corpus_pictures import (
    SAMPLED_METHODS,
    explicit_plan,
    explicit_tangents,
    loaded_sky,
    materials_by_geometry,
    picture,
    previews,
    resized_renderer,
    sampled_picture,
    sky_picture,
    successive_pictures,
    tube_picture,
)
from bench.dev.corpus_surfaces import (
    direction_colours,
    height_files,
    maps,
    material_colours,
    normalised_energy,
    orders,
    repeats,
    spectra,
    surfaces,
)
from bench.dev.public_names import wd

if TYPE_CHECKING:
    from bench.dev.corpus_values import Case

# Numbers of threads with which each test case is computed.
THREADS = (1, 2)

CASES: dict[str, Case] = {
    "refined picture": tube_picture(), "picture to 1e-1": tube_picture(tolerance=1e-1),
    "footprints alone": tube_picture(tolerance=1e-1, refine=False),
    "four subpixel cells": tube_picture(tolerance=1e-1, samples_per_pixel=4), "points": tube_picture(footprint=False),
    "sixteen points per pixel": tube_picture(footprint=False, samples_per_pixel=16),
    "centred window": tube_picture(coherence=wd.Coherence("centred"), view=tube_view(**SMALL)),
    "source": tube_picture(tolerance=1e-1, coherence=SOURCE),
    "periods": picture(
        wd.meshes.disc, lambda: wd.gratings.lamellar(2.5, 0.14), disc_view(),
        coherence=wd.Coherence("replicas", periods=(1, 10)),
    ),
    "direct sum": picture(
        wd.meshes.disc, lambda: wd.gratings.sinusoidal(2.5, 0.14), disc_view(width=12, height=9), method="direct",
        coherence=wd.Coherence(sigma_um=4.0), tolerance=1e-1,
    ),
    **{f"{method}, sampled": sampled_picture(method) for method in SAMPLED_METHODS},
    "table of powers": tube_picture(method="power", integration="table", tolerance=1e-1),
    "sampled footprints": tube_picture(
        method="low-rank", integration="sampled", view=tube_view(**SMALL), tolerance=1e-1
    ),
    # The picture of the snake has a texture, two lights, shadows, overlapping scales and all layers.
    "snake": picture(
        wd.meshes.snake, fingers, wd.View((0.5, 1.1, 1.2), (0.1, 0.0, 0.2), fov_y_deg=20.0, **SIZE), [ABOVE, SIDE],
        layers=("normal", "depth", "geometry"), tolerance=3e-2,
    ),
    # The picture of the box has flat faces with a texture, and an orthographic camera.
    "box": picture(
        box, lambda: wd.gratings.disc("CD", tracks=4, length_um=12.8, pitch_um=0.09), box_view(),
        wd.DirectionalLight((0.5, 1.0, 1.5), illuminant="FL11"), smooth=False, pigment=300.0, samples_per_pixel=4,
    ),
    "explicit tangents": explicit_tangents, "renderer": successive_pictures,
    "few directions": direction_colours(50, wd.Coherence()),
    "many directions": direction_colours(40_000, wd.Coherence(), illuminant="FL2", tolerance=3e-2),
    "many directions, centred": direction_colours(33_000, wd.Coherence("centred"), tolerance=3e-2), "spectra": spectra,
    "maps": maps, "surfaces": surfaces,
    # The following test cases use features that version 0.1 lacks.
    "explicit plan": explicit_plan, "previews": previews, "resized renderer": resized_renderer,
    "point light": picture(
        two_geometries, fingers, tube_view(), [wd.PointLight((1.2, 1.4, 0.4), power=2.0, illuminant="FL2"), SIDE],
        tolerance=1e-1,
    ),
    "disc light": tube_picture(
        wd.DirectionalLight((0.1, 0.9, 1.2), angular_diameter_deg=3.0), tolerance=1e-1, view=tube_view(**MEDIUM)
    ),
    "wide disc light": tube_picture(
        [wd.DirectionalLight((0.1, 0.9, 1.2), angular_diameter_deg=20.0), SIDE], tube_view(**SMALL), tolerance=1e-1
    ),
    "disc light, unrefined": tube_picture(
        wd.DirectionalLight((0.1, 0.9, 1.2), angular_diameter_deg=3.0), tolerance=1e-1, refine=False
    ),
    "sky": sky_picture(with_sun=False), "sky with a sun": sky_picture(with_sun=True, refine=False),
    "sky from a file": loaded_sky,
    "metal": tube_picture(
        wd.DirectionalLight((0.1, 0.9, 1.2), illuminant=wd.Spectrum.daylight(6000.0)), tolerance=1e-1,
        material=wd.Material.metal("Au"),
    ),
    "materials by geometry": materials_by_geometry, "material colours": material_colours,
    "normalised energy, picture": tube_picture(energy="normalised", tolerance=1e-1, view=tube_view(**MEDIUM)),
    "normalised energy, directions": normalised_energy, "orders": orders, "periods of a field": repeats,
    "height files": height_files, "mesh files": mesh_files, "saved pictures": saved_pictures,
    "baked lobes": baked_lobes, "baked spectrum": baked_spectrum, "pages": pages, "sequences": sequences,
}  # fmt: skip


# Functions that write the values of all test cases to a file, or compare them with the values in an earlier file.


def compute(names: list[str]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Compute all values of the named test cases.

    The keys of the values are "case/threads/name". The second result is a list of failures: exceptions, and values that
    depend on the number of threads.
    """
    values: dict[str, np.ndarray] = {}
    failures = []
    for name in names:
        by_threads = []
        for threads in THREADS:
            begin = time.perf_counter()
            try:
                arrays = {what: np.asarray(value) for what, value in CASES[name](threads).items()}
            except Exception as error:
                traceback.print_exc()
                failures.append(f"{name}, threads={threads}: {type(error).__name__}: {error}")
                continue
            seconds = time.perf_counter() - begin
            by_threads.append(arrays)
            values |= {f"{name}/{threads}/{what}": array for what, array in arrays.items()}
            print(f"{digest(arrays)}  {seconds:5.1f} s  {name}, threads={threads}", flush=True)
        if len(by_threads) == len(THREADS):
            failures += [f"{name} depends on the number of threads: {line}" for line in differences(*by_threads)]
    return values, failures


def digest(values: dict[str, np.ndarray]) -> str:
    """Return a hash of the names, types, shapes and bits of all values that the test cases have computed."""
    result = hashlib.sha256()
    for name, value in sorted(values.items()):
        result.update(f"{name} {value.dtype} {value.shape} ".encode())
        result.update(np.ascontiguousarray(value).tobytes())
    return result.hexdigest()[:16]


def differences(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> list[str]:
    """Return a line of text for each value of the test cases that differs in at least one bit from its old version."""
    lines = [f"{name}: only {'new' if name in new else 'old'}" for name in sorted(set(old) ^ set(new))]
    for name in sorted(set(old) & set(new)):
        a, b = old[name], new[name]
        if a.dtype != b.dtype or a.shape != b.shape:
            lines.append(f"{name}: {a.dtype} {a.shape} is now {b.dtype} {b.shape}")
        elif a.tobytes() != b.tobytes():
            lines.append(f"{name}: {_difference(a, b)}")
    return lines


def _difference(a: np.ndarray, b: np.ndarray) -> str:
    if a.ndim == 0:
        return f"{a} is now {b}"
    share = f"{np.mean(a != b):.2g} of the values differ"
    if a.dtype.kind != "f":
        return share
    largest = np.nanmax(np.where(np.isfinite(a), np.abs(a), 0.0))
    return f"{share}, by at most {np.nanmax(np.abs(np.float64(a) - b)):.2g}; the largest value is {largest:.3g}"


def main() -> int:
    """Write the values, or compare them with an earlier file. Return 1 if a value differs or a test case fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--write", type=Path, metavar="FILE", help="write the reference to this .npz file")
    action.add_argument("--compare", type=Path, metavar="FILE", help="compare with the reference in this .npz file")
    parser.add_argument("--only", nargs="+", metavar="CASE", choices=list(CASES), help="compute only these cases")
    options = parser.parse_args()
    # The disk cache is disabled, because it may contain tables of another version of the package.
    os.environ["WARPDIFF_CACHE_DIR"] = ""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    folder = Path(wd.__file__).parent
    print(f"warpdiff {wd.__version__} in {folder}, Python {sys.version.split()[0]}, NumPy {np.__version__}", flush=True)
    begin = time.perf_counter()
    names = options.only or list(CASES)
    values, lines = compute(names)
    seconds = time.perf_counter() - begin
    print(f"{len(names)} cases, {len(values)} arrays, {digest(values)} for all, {seconds:.0f} s")
    if options.write:
        np.savez_compressed(options.write, **values)
    else:
        with np.load(options.compare) as archive:
            before = {name: archive[name] for name in archive if name.split("/")[0] in names}
        lines += differences(before, values)
        if not lines:
            print("all values are equal to the bit")
    print("\n".join(lines))
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
