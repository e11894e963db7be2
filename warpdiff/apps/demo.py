"""The demonstration: a snake, a disc, BRDF maps, and, where the real inputs are present, the scan."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import trimesh

from warpdiff import gratings, meshes
from warpdiff.apps.data_folder import data_folder
from warpdiff.core import files, validation
from warpdiff.evaluate.reflectance import reflectance_map
from warpdiff.heightfield.field import HeightField
from warpdiff.image.display_transform import DISPLAYS, GAMUTS
from warpdiff.lights.light_types import DirectionalLight
from warpdiff.optics.materials import Material
from warpdiff.render.shade import shade
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from warpdiff.image.image import Image

# The scan does not record its vertical range; the published preprocessing takes 0 to 255 as 0 to 0.375 µm.
SCAN = "elaphe_65um.png"
SCAN_EXTENT_UM = 65.0
SCAN_HEIGHT_RANGE_UM = 0.375
MESH = "fuze.obj"


@dataclass(frozen=True)
class Picture:
    """One picture of the demonstration.

    Attributes:
        name: Its file's name without suffix.
        what: What it shows.
        make: Computes it; takes a progress callback.
        stops: Doublings of light on top of the automatic exposure.
        background: What is behind, linear; None is transparent.
    """

    name: str
    what: str
    make: Callable[..., Image]
    stops: float = 0.0
    background: tuple[float, float, float] | None = None


def cleaned_scan(path: str | os.PathLike[str]) -> HeightField:
    """The scan of a snake's skin without its waviness, its dust and its mismatched edges."""
    scan = HeightField.load(path, extent_um=SCAN_EXTENT_UM, height_range_um=SCAN_HEIGHT_RANGE_UM)
    return scan.levelled(order=2).despiked().periodic()


def pictures(data: Path | None, *, scale: float = 1.0) -> list[Picture]:
    """The pictures that can be made with these inputs, at ``scale`` times their size."""

    def pixels(count: int) -> int:
        return max(2, round(count * scale))

    fingers = gratings.fingers(size_um=64.0, pitch_um=0.08)
    cd = gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08)
    whole_snake = View((0.0, 3.4, 4.0), (-0.03, 0.02, 0.02), fov_y_deg=12.2, width=pixels(600), height=pixels(330))
    half_snake = View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=12.2, width=pixels(600), height=pixels(360))
    snake_lights = [DirectionalLight(towards, power=0.5) for towards in ((0.5, 0.75, -0.8), (-0.9, 0.7, 0.5))]
    disc_view = View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=40.0, width=pixels(480), height=pixels(340))
    discs_view = View((0.0, -3.0, 3.6), (0.0, 0.0, 0.0), fov_y_deg=24.0, width=pixels(720), height=pixels(320))
    size = pixels(400)

    def snake(heightfield: HeightField, view: View, tangent: str = "around") -> Callable[..., Image]:
        # A pigment reflects about as much as the orders of diffraction: iridescent snakes are dark ones.
        return lambda progress: shade(
            meshes.snake(tangent=tangent),
            heightfield,
            snake_lights,
            view,
            tolerance=3e-2,
            pigment=0.05,
            progress=progress,
        )

    def discs(progress: Callable[[float], None] | None) -> Image:
        both = trimesh.Scene()
        for metal, x in (("Al", -1.05), ("Au", 1.05)):
            both.add_geometry(meshes.disc().apply_translation([x, 0.0, 0.0]), geom_name=metal)
        lamp = DirectionalLight((0.1, 0.3, 1.0), angular_diameter_deg=3.0)
        material = {metal: Material.metal(metal) for metal in ("Al", "Au")}
        return shade(both, cd, lamp, discs_view, material=material, pigment=0.0, tolerance=3e-2, progress=progress)

    def spectra(progress: Callable[[float], None] | None) -> Image:
        lamp, blazed = DirectionalLight((0.1, 0.3, 1.0), angular_diameter_deg=5.0), gratings.blazed(2.5, 0.25)
        metal = Material.metal("Al")
        return shade(
            meshes.disc(), blazed, lamp, disc_view, material=metal, pigment=0.0, tolerance=3e-2, progress=progress
        )

    def over_hemisphere(
        heightfield: HeightField, to_light: tuple[float, float, float] = (0.0, 0.0, 1.0)
    ) -> Callable[..., Image]:
        return lambda progress: reflectance_map(heightfield, to_light, size=size, progress=progress)

    made = [
        Picture("snake_fingers", "synthetic nano-fingers on a corn snake", snake(fingers, whole_snake)),
        Picture("disc_cd", "compact discs of aluminium and gold under a lamp", discs, background=(0.0, 0.0, 0.0)),
        Picture("disc_blazed", "spectra of a blazed grating of 2.5 µm on a disc", spectra, background=(1.0, 1.0, 1.0)),
        Picture("map_sinusoidal", "BRDF map, sine of 2 µm", over_hemisphere(gratings.sinusoidal(2.0, 0.3)), -5.0),
        Picture("map_blazed", "BRDF map, blazed grating of 2.5 µm", over_hemisphere(gratings.blazed(2.5, 0.25)), -4.0),
        Picture("map_cd", "BRDF map, compact disc", over_hemisphere(cd), -1.3),
        Picture("map_fingers", "BRDF map, synthetic nano-fingers", over_hemisphere(fingers)),
    ]
    if data is not None and (data / SCAN).is_file():
        scan = cleaned_scan(data / SCAN)
        made += [
            Picture(
                "snake_elaphe",
                "the scan of Elaphe guttata on the snake, its fingers along the body",
                snake(scan, half_snake),
                1.0,
            ),
            Picture(
                "snake_elaphe_across",
                "the same with its fingers across the body",
                snake(scan, half_snake, "along"),
                0.4,
            ),
            Picture("map_elaphe", "BRDF map, the scan", over_hemisphere(scan), -1.3),
        ]
        if (data / MESH).is_file():
            made.append(
                Picture(
                    "fuze_elaphe",
                    "the scan on a textured bottle",
                    lambda progress: shade(
                        data / MESH,
                        scan,
                        [DirectionalLight((1.0, 1.0, 0.8)), DirectionalLight((0.2, 1.0, 0.3))],
                        View(
                            (0.2, 0.42, 0.2),
                            (0.0, 0.0, 0.11),
                            up=(0, 0, 1),
                            fov_y_deg=27.0,
                            width=pixels(360),
                            height=pixels(480),
                        ),
                        pigment=0.25,
                        tolerance=3e-2,
                        progress=progress,
                    ),
                    -1.3,
                )
            )
    return made


def run(
    output: str | os.PathLike[str],
    *,
    data: str | os.PathLike[str] | None = None,
    scale: float = 1.0,
    display: str = "aces",
    gamut: str = "srgb",
    say: Callable[[str], None] = lambda _line: None,
    progress: Callable[[str], Callable[[float], None] | None] = lambda _name: None,
) -> list[Path]:
    """Render the demonstration into a folder, which is made if need be.

    Args:
        output: The folder.
        data: Folder with the real inputs; None looks in ``WARPDIFF_DATA``, then ``../shared/data``.
        scale: Factor on the pictures' sizes.
        display: How they are shown, as :meth:`warpdiff.Image.display` has it.
        gamut: Of which display.
        say: Called with a line a picture.
        progress: Called with a picture's name, returns its progress callback.

    Returns:
        The files written.
    """
    folder = Path(output)
    validation.positive(scale, "scale")
    validation.choice(display, "display", DISPLAYS)
    validation.choice(gamut, "gamut", tuple(GAMUTS))
    inputs = data_folder(data)
    folder.mkdir(parents=True, exist_ok=True)
    files.check_folder(folder, "output")
    if inputs is None or not (inputs / SCAN).is_file():
        say(f"{SCAN} not found: synthetic gratings only; --data or WARPDIFF_DATA names the folder with the scan")
    written = []
    for picture in pictures(inputs, scale=scale):
        started = time.perf_counter()
        image = picture.make(progress(picture.name))
        path = image.save(
            folder / f"{picture.name}.png", display=display, gamut=gamut, exposure_stops=picture.stops,
            background=picture.background,
        )  # fmt: skip
        written.append(path)
        say(f"{path}  {picture.what}  ({time.perf_counter() - started:.1f} s)")
    return written
