"""Display transforms of bands of light, and of pictures: hues, steps between colours, channels at their ends.

    python -m bench.studies.display [--scale 0.5]

Bands 10, 30 and 60 nm wide, at 430, 435, … 680 nm, of D65, Y from 0.02 to 2, as sRGB. Hue is OKLab's, against that
of the band itself, unclipped, and says nothing where a colour is shown as white; a step is that between bands 5 nm
apart. Then the demonstration's disc and snake.
"""

from __future__ import annotations

import argparse
import functools
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.app import demo
from warpdiff.image import display_transform as transform
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from collections.abc import Callable

    Floats = np.ndarray

LUMINANCES = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
WIDTHS_NM = (10, 30, 60)
PICTURES = ("disc_cd", "snake_fingers")
# Of linear AP1 (ACEScg) from XYZ of D65, by Bradford's adaptation.
XYZ_TO_AP1 = np.array(
    [[1.6605226, -0.3152991, -0.2415097], [-0.6599356, 1.6083953, 0.0172914], [0.0090026, -0.0035645, 0.9135643]]
)


def bands() -> Floats:
    """XYZ, (widths, luminances, centres, 3)."""
    products, wavelengths = colorimetry.colour_products("D65"), np.arange(380, 781)
    xyz = np.array(
        [
            [products[np.abs(wavelengths - centre) <= 0.5 * width].sum(axis=0) for centre in range(430, 681, 5)]
            for width in WIDTHS_NM
        ]
    )
    return (xyz / xyz[..., 1:2])[:, None] * np.array(LUMINANCES)[:, None, None]


def apart_deg(one: Floats, other: Floats) -> Floats:
    """Between hues."""
    return np.abs((one - other + 180.0) % 360.0 - 180.0)


def hues_deg(lab: Floats) -> Floats:
    """Of OKLab."""
    return np.degrees(np.arctan2(lab[..., 2], lab[..., 1]))


def curve(ratio: Floats, kept: float, largest: float, power: float) -> Floats:
    """The Reference Gamut Compression's: ``largest`` becomes 1, and what is below ``kept`` stays."""
    scale = (largest - kept) / (((1.0 - kept) / (largest - kept)) ** -power - 1.0) ** (1.0 / power)
    beyond = np.maximum(ratio - kept, 0.0) / scale
    return np.where(ratio < kept, ratio, kept + scale * beyond / (1.0 + beyond**power) ** (1.0 / power))


def reference(xyz: Floats) -> Floats:
    """The Reference Gamut Compression of ACES 1.3: each component of AP1 by itself."""
    rgb = xyz @ XYZ_TO_AP1.T
    peak = rgb.max(axis=1, keepdims=True)
    limits = zip((0.815, 0.803, 0.880), (1.147, 1.264, 1.312), strict=True)
    distance = (peak - rgb) / peak
    by_channel = [curve(distance[:, k], kept, largest, 1.2) for k, (kept, largest) in enumerate(limits)]
    return peak * (1.0 - np.stack(by_channel, axis=1)) @ np.linalg.inv(XYZ_TO_AP1).T


def towards_white(xyz: Floats, to_rgb: Floats, kept: float, *, peak: bool) -> Floats:
    """Along a straight line to the white of the same luminance, or of the same largest component."""
    rgb = xyz @ to_rgb.T
    white = rgb.max(axis=1, keepdims=True) if peak else xyz[:, 1:2]
    distance = ((white - rgb) / white).max(axis=1, keepdims=True)
    share = np.where(distance > kept, curve(distance, kept, max(1.01 * distance.max(), 1.05), 1.2) / distance, 1.0)
    return (white + (rgb - white) * share) @ np.linalg.inv(to_rgb).T


def shown_after(compress: Callable[[Floats], Floats], xyz: Floats) -> Floats:
    """ACES after a compression."""
    flat = xyz.reshape(-1, 3)
    return transform.aces(compress(flat), "srgb").reshape(xyz.shape)


def variants() -> dict[str, Callable[[Floats], Floats]]:
    """From XYZ to encoded sRGB, by name."""
    p3 = transform.GAMUTS["display-p3"].xyz_to_rgb
    spaces = {"sRGB": colorimetry.XYZ_TO_RGB, "Display P3": p3, "AP1": XYZ_TO_AP1}
    made: dict[str, Callable[[Floats], Floats]] = {
        "clipped": lambda xyz: transform.shown(xyz, "clip", "srgb"),
        "colorimetric": lambda xyz: transform.shown(xyz, "colorimetric", "srgb"),
        "ACES as it is": functools.partial(shown_after, lambda xyz: xyz),
        "ACES after its RGC": functools.partial(shown_after, reference),
    }
    for name, to_rgb in spaces.items():
        for peak in (False, True):
            compress = functools.partial(towards_white, to_rgb=to_rgb, kept=0.8, peak=peak)
            made[f"ACES, to white in {name}, {'peak' if peak else 'Y'} kept"] = functools.partial(shown_after, compress)
    made["ACES, OKLab chroma (ours)"] = lambda xyz: transform.shown(xyz, "aces", "srgb")
    made["the same by the table"] = lambda xyz: transform.shown(xyz, "aces", "srgb", exact=False)
    return made


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="factor on the pictures' sizes (default: 1)")
    options = parser.parse_args()

    light = bands()
    of_light = hues_deg(transform.oklab(light))
    steps = apart_deg(of_light[..., 1:], of_light[..., :-1])
    print(f"largest step of the light itself: {steps.max():.1f}°\n")
    print("| variant | hue, median ° (by width and Y) | P95 | largest | largest step ° | chroma | at 0 | at 255 |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for name, show in variants().items():
        encoded = show(light)
        lab = transform.oklab(colorimetry.rgb_to_xyz(colorimetry.srgb_decode(encoded)))
        hues = hues_deg(lab)
        errors, steps = apart_deg(hues, of_light), apart_deg(hues[..., 1:], hues[..., :-1])
        cells, levels = np.median(errors, axis=-1), np.round(255.0 * encoded)
        ends = [f"{np.mean(levels == end):.3f}" for end in (0, 255)]
        print(
            f"| {name} | {np.median(errors):.1f} ({cells.min():.1f} to {cells.max():.1f}) | "
            f"{np.percentile(errors, 95):.1f} | {errors.max():.1f} | {steps.max():.1f} | "
            f"{np.hypot(lab[..., 1], lab[..., 2]).mean():.3f} | {' | '.join(ends)} |"
        )

    print("\n| picture, channels of what is lit | at 0, clipped | ACES | at 255, clipped | ACES |")
    print("| --- | --- | --- | --- | --- |")
    for picture in demo.pictures(None, scale=options.scale):
        if picture.name in PICTURES:
            image = picture.make(None)
            # At the same exposure.
            exposure = image.auto_exposure * 2.0**picture.stops
            levels = [
                np.round(255.0 * image.display(each, exposure=exposure)[image.lit, :3]) for each in ("clip", "aces")
            ]
            ends = [f"{np.mean(each == end):.4f}" for end in (0, 255) for each in levels]
            print(f"| {picture.name} | {' | '.join(ends)} |")


if __name__ == "__main__":
    main()
