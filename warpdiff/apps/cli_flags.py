"""Flags of the commands of the command line: a function per command adds them to the command's parser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warpdiff as wd
from warpdiff.apps import cli_inputs
from warpdiff.apps.cli_options import COHERENCE_FLAGS, integer, number
from warpdiff.core.options import describe
from warpdiff.optics.coherence import Coherence
from warpdiff.request.settings import EvaluationSettings, PictureSettings, SinglePictureSettings, SpectralSettings

if TYPE_CHECKING:
    import argparse

    from warpdiff.apps.cli_options import Flags

# Help texts of the arguments that name a height field, and of those that name a mesh, in all commands.
_HEIGHT_FIELD_HELP = (
    "file of heights (an image of 8 or 16 bit grey or float, .npy, .npz, text, .x3p or a file of an instrument), or a "
    f"synthetic height field: one of {', '.join(cli_inputs.GRATINGS)}, with parameters of warpdiff.gratings, for "
    "example fingers:size_um=25.6,seed=3; pairs are written as 2.0x1.0"
)
_MESH_HELP = (
    "mesh file, which requires --tangents if it has no texture coordinates, or one of "
    f"{', '.join(cli_inputs.BODIES)}, with parameters of warpdiff.meshes, for example snake:tangent=along"
)


def add_demo(flags: Flags) -> None:
    """Add the flags of the command ``demo``."""
    demo = flags.parser
    demo.add_argument("-o", "--output", default="demo", metavar="FOLDER", help="folder of the pictures (default: demo)")
    demo.add_argument(
        "--data", metavar="FOLDER", help="folder with the real scan (default: $WARPDIFF_DATA, ../shared/data)"
    )
    demo.add_argument("--scale", type=number, default=1.0, help="factor on the pictures' sizes (default: 1)")
    flags.add(demo, describe(wd.Image.save))


def add_render(flags: Flags) -> None:
    """Add the flags of the command ``render``."""
    _add_picture(flags, SinglePictureSettings)
    _add_output(flags)
    flags.parser.add_argument(
        "--wavelengths-nm", type=number, nargs="+", metavar="NM",
        help="wavelengths of a spectral .exr file, which has the radiance of each pixel",
    )  # fmt: skip
    group = _add_environment(flags)
    group.add_argument("--environment-behind", action="store_true", help="show the environment as background of a PNG")


def _add_environment(flags: Flags) -> Any:
    """Add the flags of an environment light, and return their group in the help."""
    group = flags.group("environment")
    group.add_argument(
        "--environment", metavar="SKY",
        help="environment light: an EXR or HDR file in latitude and longitude, linear sRGB, or clear-sky, with "
        "parameters of warpdiff.Environment.clear_sky, for example clear-sky:sun_direction=1x1x0.5,ground_albedo=0.1",
    )  # fmt: skip
    loading = describe(wd.Environment.load)
    flags.add(group, loading, only=loading.keys() - {"path"}, prefix="environment-")
    return group


def add_sequence(flags: Flags) -> None:
    """Add the flags of the command ``sequence``."""
    _add_picture(flags, PictureSettings)
    _add_environment(flags)
    group = flags.group("frames")
    group.add_argument(
        "-o", "--output", required=True, metavar="FOLDER",
        help="folder of the frames; existing frames of the same sequence are not rendered again",
    )  # fmt: skip
    group.add_argument("--count", type=integer, help="number of frames (default: 36, or the rows of --path)")
    kind = group.add_mutually_exclusive_group()
    kind.add_argument("--turns", type=number, default=1.0, help="turns of the body or the lights (default: 1)")
    kind.add_argument(
        "--light-to", type=number, nargs=3, metavar=("X", "Y", "Z"),
        help="direction of the first light in the last frame; all lights move together, see warpdiff.light_sweep",
    )  # fmt: skip
    kind.add_argument("--path", metavar="FILE", help="the camera's path: a CSV file, see warpdiff.camera_path")
    at_rest = group.add_mutually_exclusive_group()
    at_rest.add_argument(
        "--lights-stay", action="store_true", help="the camera moves around the body; otherwise the body rotates"
    )
    at_rest.add_argument(
        "--lights-turn", action="store_true", help="the lights rotate around the body; otherwise the body rotates"
    )
    flags.add(group, describe(wd.sequence), only=("formats", "animation", "frames_per_second", "overwrite"))
    group.add_argument("--scheduler", metavar="ADDRESS", help="scheduler of a Dask cluster whose workers render")


def add_brdf(flags: Flags) -> None:
    """Add the flags of the command ``brdf``."""
    _add_height_field(flags, has_position=True)
    _add_evaluation(flags, EvaluationSettings)
    _add_saving(flags)
    _add_output(flags)
    group = flags.group("map")
    _add_incidence(group)
    flags.add(group, describe(wd.reflectance_map), only=("size", "samples_per_pixel"))


def _add_incidence(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--incidence-deg", type=number, default=0.0, help="light's angle from the normal (default: 0)")
    group.add_argument("--azimuth-deg", type=number, default=0.0, help="light's angle from the x axis (default: 0)")


def add_orders(flags: Flags) -> None:
    """Add the flags of the command ``orders``."""
    _add_height_field(flags, has_position=True)
    group = flags.group("orders")
    _add_incidence(group)
    _add_wavelengths(group, [550.0])
    group.add_argument(
        "--count", type=integer, default=20,
        help="number of orders per wavelength that are printed, the strongest ones (default: 20)",
    )  # fmt: skip
    flags.add(group, describe(wd.order_efficiencies), only=("ior", "energy"))
    _add_material(group)
    _add_csv(flags)


def add_angles(flags: Flags) -> None:
    """Add the flags of the command ``angles``."""
    _add_height_field(flags, has_position=True)
    group = flags.group("orders")
    _add_incidence(group)
    _add_wavelengths(group, [450.0, 550.0, 650.0])
    flags.add(group, describe(wd.order_angles), only=("most_order",))
    _add_csv(flags)


def add_spectrum(flags: Flags) -> None:
    """Add the flags of the command ``spectrum``."""
    _add_height_field(flags, has_position=True)
    group = flags.group("evaluation")
    flags.add(group, describe(SpectralSettings))
    flags.add(group, describe(Coherence), names=COHERENCE_FLAGS)
    _add_material(group)
    group = flags.group("spectrum")
    _add_incidence(group)
    group.add_argument("--view-deg", type=number, default=0.0, help="viewer's angle from the normal (default: 0)")
    group.add_argument(
        "--view-azimuth-deg", type=number, default=0.0, help="viewer's angle from the x axis (default: 0)"
    )
    group.add_argument("--from-nm", type=number, default=380.0, help="first wavelength, from 200 nm (default: 380)")
    group.add_argument("--to-nm", type=number, default=780.0, help="last wavelength (default: 780)")
    group.add_argument("--step-nm", type=number, default=5.0, help="step of the wavelengths (default: 5)")
    _add_csv(flags)


def add_report(flags: Flags) -> None:
    """Add the flags of the command ``report``."""
    _add_height_field(flags, has_position=True)
    _add_evaluation(flags, EvaluationSettings)
    flags.parser.add_argument(
        "-o", "--output", default="report", metavar="FOLDER", help="folder of the page and its files (default: report)"
    )
    group = flags.group("report")
    group.add_argument(
        "--compare", metavar="FILE",
        help="text of a measured curve, with a column wavelength_nm or angle_deg and a column of values",
    )  # fmt: skip
    group.add_argument("--incidence-deg", type=number, help="light's angle from the normal (default: 30)")
    group.add_argument(
        "--azimuth-deg", type=number, help="light's angle from the x axis (default: that of the strongest wave vector)"
    )
    group.add_argument(
        "--view-deg", type=number,
        help="view angle of a measured spectrum, in the plane of the light (default: the mirror direction)",
    )  # fmt: skip
    _add_wavelengths(group, [450.0, 550.0, 650.0])
    group.add_argument(
        "--sigmas-um", type=number, nargs="+", metavar="UM",
        help="coherence windows whose colours are shown (default: 5 16.25 50, at most a quarter of the size of a scan)",
    )  # fmt: skip
    flags.add(group, describe(wd.report), only=("title",))


def _add_wavelengths(group: argparse._ArgumentGroup, default: list[float]) -> None:
    group.add_argument(
        "--wavelengths-nm", type=number, nargs="+", default=default, metavar="NM",
        help=f"wavelengths, from 200 nm (default: {' '.join(f'{wavelength:g}' for wavelength in default)})",
    )  # fmt: skip


def _add_csv(flags: Flags) -> None:
    flags.parser.add_argument("--csv", metavar="FILE", help="also write all rows to a CSV file, with all digits")


def add_export_html(flags: Flags) -> None:
    """Add the flags of the command ``export-html``."""
    flags.parser.add_argument("output", metavar="OUT", help="the page, .html")
    flags.parser.add_argument("mesh", metavar="MESH", nargs="?", default="snake", help=f"{_MESH_HELP} (default: snake)")
    _add_height_field(flags, default="fingers")
    group = flags.group("lobes")
    flags.add(group, describe(wd.bake), only=("delta_e", "strict", "device", "threads"))
    flags.add(group, describe(Coherence), only=("kind", "sigma_um", "angular_diameter_deg"), names=COHERENCE_FLAGS)
    _add_material(group)
    _add_illuminant(group)
    group = flags.group("page")
    of_page = ("masking", "pigment", "shadows", "smooth", "exposure", "title")
    flags.add(group, describe(wd.export_html), only=of_page)
    flags.add(group, describe(PictureSettings), only=("ior", "tangents"))
    _add_scene(flags)


def add_info(flags: Flags) -> None:
    """Add the flags of the command ``info``."""
    _add_height_field(flags, has_position=True)
    flags.add(flags.parser, describe(EvaluationSettings), only=("tolerance",))


def add_view(flags: Flags) -> None:
    """Add the flags of the command ``view``."""
    view = flags.parser
    view.add_argument("mesh", nargs="*", metavar="MESH", help="mesh files that the page offers with the sample bodies")
    _add_height_field(flags, several=True)
    _add_map(flags)
    view.add_argument(
        "--environment", nargs="+", action="extend", default=[], metavar="FILE",
        help="environment lights that the page offers: EXR or HDR in latitude and longitude, linear sRGB",
    )  # fmt: skip
    view.add_argument("--port", type=integer, default=0, help="port of the server (default: pick a free port)")
    view.add_argument(
        "--host", default="127.0.0.1",
        help="address to listen on; for other machines the page's address contains a token (default: 127.0.0.1)",
    )  # fmt: skip
    view.add_argument("--no-browser", action="store_true", help="only print the page's address")
    flags.add(view, describe(EvaluationSettings), only=("device", "threads"))


def add_cache(flags: Flags) -> None:
    """Add the flags of the command ``cache``."""
    less = flags.parser.add_mutually_exclusive_group()
    less.add_argument("--trim-mib", type=number, metavar="MIB", help="limit the size; the last used files stay")
    less.add_argument("--clear", action="store_true", help="delete all files")


def _add_picture(flags: Flags, settings: type) -> None:
    """Add the flags of pictures: mesh, height field, tolerance and method, lights, camera and picture file."""
    flags.parser.add_argument("mesh", metavar="MESH", help=_MESH_HELP)
    _add_height_field(flags)
    flags.parser.add_argument(
        "--surface", action="append", metavar="PART=HEIGHTFIELD",
        help="height field of the parts with this geometry or material, or 'plain' for a surface with the "
        "material of the mesh; other parts have --heightfield; may be repeated",
    )  # fmt: skip
    _add_map(flags)
    _add_evaluation(flags, settings)
    _add_scene(flags)
    _add_saving(flags)


def _add_map(flags: Flags) -> None:
    """Add the flag ``--map`` of grating maps, which divide a surface into small rectangles with one grating each."""
    flags.parser.add_argument(
        "--map", action="append", metavar="NAME=VALUE",
        help="value of the dots of --heightfield over the texture coordinates: NAME is turn_deg, depth_scale or "
        "pitch_scale, and VALUE a number, a grey image, or IMAGE,BLACK,WHITE with the values of black and white; may "
        "be repeated",
    )  # fmt: skip


def _add_height_field(
    flags: Flags, *, default: str | None = None, several: bool = False, has_position: bool = False
) -> None:
    group = flags.group("height field")
    how: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []} if several else {"default": default}
    if has_position:
        group.add_argument("scan", metavar="HEIGHTFIELD", nargs="?", help="the same as --heightfield")
    else:
        how["required"] = default is None and not several
    group.add_argument(
        "--heightfield", metavar="HEIGHTFIELD",
        help=_HEIGHT_FIELD_HELP + (f" (default: {default})" if default else ""), **how,
    )  # fmt: skip
    loading = ("extent_um", "pitch_um", "height_range_um", "channel", "rows", "unit")
    flags.add(group, describe(wd.HeightField.load), only=loading)
    group.add_argument(
        "--level", type=integer, metavar="ORDER", help="subtract a polynomial of this order (1: a plane)"
    )
    group.add_argument("--despike", action="store_true", help="remove dust")
    group.add_argument("--fill", action="store_true", help="interpolate missing samples")
    group.add_argument("--crop-um", type=number, metavar="SIZE", help="keep a square of this size from the middle")
    group.add_argument("--periodic", action="store_true", help="make opposite edges match")


def _add_evaluation(flags: Flags, settings: type) -> None:
    group = flags.group("evaluation")
    flags.add(group, describe(settings))
    flags.add(group, describe(Coherence), names=COHERENCE_FLAGS)
    if settings is not EvaluationSettings:
        flags.add(group, describe(settings), only=("tangents",))
    _add_material(group)
    _add_illuminant(group)


def _add_material(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--material",
        help=f"material of the surface, instead of --ior: {', '.join(cli_inputs.METAL_SYMBOLS)}, an index of "
        "refraction, or a file of refractiveindex.info, YAML or CSV",
    )
    group.add_argument(
        "--film", nargs=2, metavar=("MATERIAL", "NM"), help="film on the material: its material and thickness in nm"
    )


def _add_illuminant(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--illuminant", default="D65",
        help="CIE illuminant or light source by name, temperature of a black body, such as 2856K, or a CSV file of "
        "wavelengths in nm and powers (default: D65)",
    )  # fmt: skip


def _add_scene(flags: Flags) -> None:
    """Add the flags of lights and camera."""
    group = flags.group("lights")
    group.add_argument(
        "--light", action="append", metavar="LIGHT",
        help="light: the direction towards it, X Y Z, or one of warpdiff's lights, KIND:name=value,…, for example "
        "directional:to_light=0x1x1,angular_diameter_deg=3 or point:position=0x2x1,power=4; may be repeated (default: "
        "a directional light from above and to the right of the camera)",
    )  # fmt: skip
    group = flags.group("camera")
    flags.add(group, describe(wd.View), defaults={"eye": None, "target": None})


def _add_saving(flags: Flags) -> None:
    group = flags.group("picture file")
    flags.add(group, describe(wd.Image.save))
    flags.add(group, describe(wd.sequence), only=("background",))


def _add_output(flags: Flags) -> None:
    flags.parser.add_argument(
        "-o", "--output", required=True, metavar="FILE", help="picture, .png (display) or .exr (linear XYZ and RGB)"
    )
