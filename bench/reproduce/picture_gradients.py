"""Accuracy and cost of gradients of pictures.

::

    python -m bench.reproduce.picture_gradients path/to/scan.png

The scan is rendered on a straight tube that fills the picture, under a directional light. A pixel shows the colour at
one point, without a filter over the pixel's area. In the output, "sampled" is the gradient of a picture whose colours
are sums over wavelengths. Otherwise, colours are interpolated in a table over polar coordinates of the scattering
vector. The gradients are compared with central differences. The differences use two functions: ``wd.reflectance`` at
the directions of the pixels, with numerical settings (a plan) for a tolerance of 1e-3, and ``wd.shade`` with the
settings of the renderer. A central difference changes the heights by smooth random noise. It yields a difference of
colours for each pixel. The loss is a sum over pixels with these differences as weights. Its derivative is then a sum of
squares, in which the contributions of pixels cannot cancel.

Costs are seconds of processor time of all threads, the least of three measurements. "Library" is the cost of
``wd.shade`` with a plan given, for a surface that the library has not cached.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import TYPE_CHECKING
from unittest import mock

import numpy as np
from scipy import ndimage

import warpdiff as wd
from warpdiff.adjoint import picture_model
from warpdiff.render.picture_samples import samples_of

if TYPE_CHECKING:
    from collections.abc import Callable

LIGHT = wd.DirectionalLight((0.35, 0.9, 0.3))
# Change of the heights for the central differences [µm]. Smaller changes have larger errors: the library fits new basis
# functions for each surface, and the change of the fit is divided by this value. With larger changes, the colours are
# not linear in the heights.
STEP_UM = 3e-3
OPTIONS = {"footprint": False, "refine": False, "ior": np.inf}


def renderer_of(scan: wd.HeightField, size: tuple[int, int]) -> tuple[wd.Renderer, object, wd.View]:
    """Return a renderer of a tube that fills the picture, with its mesh and its view."""
    tube = wd.meshes.tube(radius=0.8, length=8.0, bend_deg=0.0, tangent="along")
    view = wd.View((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), width=size[0], height=size[1])
    return wd.Renderer(tube, scan, LIGHT, view, **OPTIONS), tube, view


def changed(scan: wd.HeightField, change_um: np.ndarray) -> wd.HeightField:
    """Return the scan with a change of its heights."""
    return wd.HeightField.of_known_scale(scan.heights_um + change_um, scan.pitch_um)


def seconds(function: Callable, *arguments: object, **options: object) -> tuple[float, object]:
    """Return the processor time of a call in seconds, and its result."""
    start = time.process_time()
    result = function(*arguments, **options)
    return time.process_time() - start, result


def by_wavelengths(renderer: wd.Renderer, scan: wd.HeightField) -> object:
    """Return the picture with derivatives. Its colours are sums over wavelengths, not look-ups in a colour table."""
    with mock.patch.object(picture_model, "_SIZES", ()):
        return wd.adjoint.pixels(renderer, scan, LIGHT)


def accuracy(scan: wd.HeightField) -> None:
    """Print the errors of the gradient of a picture of 320 × 240 pixels with respect to the heights."""
    renderer, tube, view = renderer_of(scan, (320, 240))
    image = renderer.image()
    rng = np.random.default_rng(3)
    result = wd.adjoint.pixels(renderer, scan, LIGHT)
    weights = rng.normal(size=result.value.shape)
    gradient = result.vjp(weights)["heights_um"]
    sampled = by_wavelengths(renderer, scan).vjp(weights)["heights_um"]
    print(f"{len(weights)} illuminated pixels")
    print(f"gradient against the sampled one, l2: {np.linalg.norm(gradient - sampled) / np.linalg.norm(sampled):.1e}")
    (lit,) = samples_of(renderer, LIGHT).lobes
    views = -lit.scattering_vectors - lit.to_lights
    plan = wd.plan(scan, lit.to_lights, views, ior=np.inf, tolerance=1e-3, strict=False)
    scale = lit.gains / wd_gain(lit.to_lights, views)

    def reflected(change_um: np.ndarray) -> np.ndarray:
        surface = changed(scan, change_um)
        xyz = wd.reflectance(surface, lit.to_lights, views, ior=np.inf, plan=plan)
        return scale[:, None] * xyz.astype(np.float64)

    def shaded(change_um: np.ndarray) -> np.ndarray:
        picture = wd.shade(tube, changed(scan, change_um), LIGHT, view, plan=renderer.plan, **OPTIONS)
        return picture.xyz[image.illuminated].astype(np.float64)

    print("| difference of | directional derivative | error | tangent, l2 error |")
    print("| --- | --- | --- | --- |")
    for _ in range(3):
        direction = ndimage.gaussian_filter(rng.normal(size=scan.shape), 4, mode="wrap")
        direction /= np.abs(direction).max()
        tangent = result.jvp(heights_um=direction)
        for name, function in (("reflectance", reflected), ("shade", shaded)):
            difference = (function(STEP_UM * direction) - function(-STEP_UM * direction)) / (2.0 * STEP_UM)
            own = float(np.sum(result.vjp(difference)["heights_um"] * direction))
            expected, off = float(np.sum(difference**2)), np.linalg.norm(tangent - difference)
            print(f"| {name} | {own:.6g} | {own / expected - 1:+.1e} | {off / np.linalg.norm(difference):.1e} |")


def wd_gain(lights: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Return the geometry factors of a perfect mirror for pairs of unit vectors to the light and to the viewer."""
    from warpdiff.optics.reflectance_factors import gain

    return gain(lights, views, normal=1.0, masking=True)


def cost(scan: wd.HeightField, size: tuple[int, int]) -> None:
    """Print the cost of a picture and its gradient, relative to ``wd.shade`` for a surface without cached tables."""
    renderer, tube, view = renderer_of(scan, size)
    # The noise that is added to the heights differs from run to run. For a surface that an earlier run used, the
    # library would read the colour tables from its disk cache, and the measured time would be too short.
    rng = np.random.default_rng()
    library, values, gradients = [], [], []
    for _ in range(3):
        new = changed(scan, 1e-9 * rng.normal(size=scan.shape))
        library.append(seconds(wd.shade, tube, new, LIGHT, view, plan=renderer.plan, **OPTIONS)[0])
        spent, result = seconds(wd.adjoint.pixels, renderer, new, LIGHT)
        values.append(spent)
        gradients.append(seconds(result.vjp, rng.normal(size=result.value.shape))[0])
    both = min(np.add(values, gradients))
    print(
        f"| {size[0]} × {size[1]}, {len(result.value)} illuminated | {min(library):.2f} | {min(values):.2f} | "
        f"{both:.2f} | {both / min(library):.2f} |", flush=True,
    )  # fmt: skip


def main() -> None:
    """Print the accuracy and the cost of gradients of pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scan", help="image of heights, 65 µm wide with a range of 0.375 µm")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    scan = wd.HeightField.load(arguments.scan, extent_um=65.0, height_range_um=0.375).levelled(order=2)
    accuracy(scan)
    print("| picture | library, new surface | value | value and gradient | ratio |")
    print("| --- | --- | --- | --- | --- |")
    for size in ((320, 240), (640, 480)):
        cost(scan, size)


if __name__ == "__main__":
    main()
