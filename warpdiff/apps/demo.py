"""Demonstration pictures: a snake, compact discs, BRDF maps, and pictures of a real scan if its file is available."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import trimesh

from warpdiff import gratings, meshes
from warpdiff.core import files, validation
from warpdiff.core.wording import marked, ref
from warpdiff.datasets.download import read
from warpdiff.datasets.registry import info
from warpdiff.evaluate.reflectance import reflectance_map
from warpdiff.lights.directional import DirectionalLight
from warpdiff.optics.materials import Material
from warpdiff.render.shade import shade
from warpdiff.request.settings import DisplaySettings
from warpdiff.request.signatures import accepts
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.core.progress import Progress
    from warpdiff.heightfield.field import HeightField
    from warpdiff.image.image import Image
    from warpdiff.request.keywords import DisplayKeywords
    from warpdiff.samples.corn_snake import Tangent

_SCAN = info("corn_snake_scan")
SCAN = _SCAN.local_name
MESH = "fuze.obj"
# Tolerance of the pictures. It was chosen so that the whole demonstration requires about 30 s. If doubled, the pictures
# have twice the error.
_TOLERANCE = 5e-2


@dataclass(frozen=True)
class DemoPicture:
    """One picture of the demonstration.

    Attributes:
        name: Name of the file without suffix.
        title: Subject of the picture, in a few words.
        make: Function that computes the picture. Its argument is the progress callable.
        stops: Correction of the automatic exposure in stops; each stop is a factor of 2.
        background: Display-encoded RGB colour of the background, 0 to 1; None is transparent.
    """

    name: str
    title: str
    make: Callable[[Progress], Image]
    stops: float = 0.0
    background: tuple[float, float, float] | None = None


def data_folder(data: str | os.PathLike[str] | None = None) -> Path | None:
    """Return the folder of the real scan and mesh, or None if there is no such folder.

    The argument ``data`` names the folder. Without it, the environment variable ``WARPDIFF_DATA`` names the folder.
    Without both, the folder is ``../shared/data`` next to a checkout of the repository.

    Raises:
        FileNotFoundError: The folder that ``data`` or ``WARPDIFF_DATA`` names does not exist.
    """
    name = data or os.environ.get("WARPDIFF_DATA")
    folder = Path(name) if name else Path(__file__).resolve().parents[3] / "shared" / "data"
    if folder.is_dir():
        return folder
    if name:
        raise marked(
            FileNotFoundError, f"the data folder {folder} does not exist; check {ref('data')} or WARPDIFF_DATA"
        )
    return None


def cleaned_scan(path: str | os.PathLike[str]) -> HeightField:
    """Load the scan of a snake's skin, and return it after cleaning.

    The cleaning subtracts a polynomial of degree 2, removes spikes such as dust, and makes opposite edges match.
    """
    return read(_SCAN, path).levelled(order=2).despiked().periodic()


def pictures(data: Path | None, *, scale: float = 1.0) -> list[DemoPicture]:
    """Return the pictures of the demonstration.

    Args:
        data: Folder with the real scan and mesh. Pictures whose files are absent from the folder are omitted. None
            omits all pictures that need a file.
        scale: Factor on the width and height of each picture.
    """

    def pixels(count: int) -> int:
        return max(2, round(count * scale))

    fingers = gratings.fingers(size_um=64.0, pitch_um=0.08)
    cd = gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08)
    whole_snake = View((0.0, 3.4, 4.0), (-0.03, 0.02, 0.02), fov_y_deg=12.2, width=pixels(1000), height=pixels(550))
    half_snake = View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=12.2, width=pixels(1000), height=pixels(600))
    snake_lights = [DirectionalLight(towards, power=0.5) for towards in ((0.5, 0.75, -0.8), (-0.9, 0.7, 0.5))]
    discs_view = View((0.0, -3.0, 3.6), (0.0, 0.0, 0.0), fov_y_deg=24.0, width=pixels(1000), height=pixels(450))
    metals = {"Al": Material.metal("Al"), "Au": Material.metal("Au")}
    size = pixels(1000)

    def shaded(mesh: Callable[[], Any], *scene: Any, **options: Any) -> Callable[[Progress], Image]:
        # Each mesh is made only when its picture is rendered, because some meshes require seconds to make.
        return lambda progress: shade(mesh(), *scene, **options, tolerance=_TOLERANCE, progress=progress)

    def snake(heightfield: HeightField, view: View, tangent: Tangent = "around") -> Callable[[Progress], Image]:
        # The base colour of the snake (pigment) is dark. A bright one would reflect more light than the diffraction
        # orders, and hide them.
        return shaded(lambda: meshes.snake(tangent=tangent), heightfield, snake_lights, view, pigment=0.05)

    def two_discs() -> trimesh.Scene:
        scene = trimesh.Scene()
        for metal, x in (("Al", -1.05), ("Au", 1.05)):
            scene.add_geometry(meshes.disc().apply_translation([x, 0.0, 0.0]), geom_name=metal)
        return scene

    def over_hemisphere(heightfield: HeightField) -> Callable[[Progress], Image]:
        return lambda progress: reflectance_map(heightfield, (0.0, 0.0, 1.0), size=size, progress=progress)

    result = [
        DemoPicture("snake_fingers", "synthetic nano-fingers on a corn snake", snake(fingers, whole_snake)),
        DemoPicture(
            "disc_cd", "compact discs of aluminium and gold",
            shaded(
                two_discs, cd, DirectionalLight((0.1, 0.3, 1.0), angular_diameter_deg=3.0), discs_view, material=metals,
                pigment=0.0,
            ),
            background=(0.0, 0.0, 0.0),
        ),
        DemoPicture("map_cd", "BRDF map, compact disc", over_hemisphere(cd), -1.3),
        DemoPicture("map_fingers", "BRDF map, synthetic nano-fingers", over_hemisphere(fingers)),
    ]  # fmt: skip
    if data is not None and (data / SCAN).is_file():
        scan = cleaned_scan(data / SCAN)
        result += [
            DemoPicture(
                "snake_elaphe", "the scan of Elaphe guttata on the snake, its fingers along the body",
                snake(scan, half_snake), 1.0,
            ),
            DemoPicture(
                "snake_elaphe_across", "the scan of Elaphe guttata on the snake, its fingers across the body",
                snake(scan, half_snake, "along"), 0.4,
            ),
            DemoPicture("map_elaphe", "BRDF map, the scan", over_hemisphere(scan), -1.3),
        ]  # fmt: skip
        if (data / MESH).is_file():
            result.append(
                DemoPicture(
                    "fuze_elaphe",
                    "the scan on a textured bottle",
                    shaded(
                        lambda: data / MESH, scan,
                        [DirectionalLight((1.0, 1.0, 0.8)), DirectionalLight((0.2, 1.0, 0.3))],
                        View(
                            (0.2, 0.42, 0.2), (0.0, 0.0, 0.11), up=(0, 0, 1), fov_y_deg=27.0, width=pixels(750),
                            height=pixels(1000),
                        ),
                        pigment=0.25,
                    ),
                    -1.3,
                )
            )  # fmt: skip
    return result


@accepts(DisplaySettings)
def run(
    output: str | os.PathLike[str], *, data: str | os.PathLike[str] | None = None, scale: float = 1.0,
    say: Callable[[str], None] = lambda _line: None, progress: Progress = None, **settings: Unpack[DisplayKeywords],
) -> list[Path]:  # fmt: skip
    """Render the demonstration pictures into a folder.

    Args:
        output: Folder of the pictures; it is created if it does not exist.
        data: Folder with the real scan and mesh; None is ``WARPDIFF_DATA``, or ``../shared/data`` next to a checkout.
        scale: Factor on the width and height of each picture.
        say: Callable that gets one line of text per picture.
        progress: Callable that gets the finished fraction of each picture, 0 to 1; True shows a bar per picture.

    Returns:
        The paths of the pictures.
    """
    folder = Path(output)
    validation.positive(scale, "scale")
    DisplaySettings(**settings)
    inputs = data_folder(data)
    folder.mkdir(parents=True, exist_ok=True)
    files.check_folder(folder, "output")
    if inputs is None or not (inputs / SCAN).is_file():
        say(f"{SCAN} not found: synthetic gratings only; WARPDIFF_DATA names the folder with the scan")
    paths = []
    for picture in pictures(inputs, scale=scale):
        started = time.perf_counter()
        image = picture.make(progress)
        stops = picture.stops + settings.get("exposure_stops", 0.0)
        path = image.save(
            folder / f"{picture.name}.png", background=picture.background, **settings | {"exposure_stops": stops}
        )
        paths.append(path)
        say(f"{path}  {picture.title}  ({time.perf_counter() - started:.1f} s)")
    return paths
