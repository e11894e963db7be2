"""``export_html``: a page without a server, of a mesh whose surface carries baked lobes."""

from __future__ import annotations

import html
import io
import json
import re
from importlib import metadata, resources
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.apps.web_page.packing import Arrays, octahedral, quantised
from warpdiff.baked.lobe_table import LARGEST_W, BakedLobes, mirror_power, normal_reflectance
from warpdiff.core import files, memory, validation
from warpdiff.image import display_transform
from warpdiff.lights.base import MOST_POWER, lobes_of
from warpdiff.lights.directional import ONE_LOBE_DEG, DirectionalLight
from warpdiff.lights.point import PointLight
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.scene.camera import View
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike

    from warpdiff.scene.mesh_import import Surface

# Of a light from the mesh's centre, in radii: its shadow map is one picture of what lies before it.
_NEAREST = 1.1
# Texels along a side of the page's grid over (u, v), and frames that a picture at rest adds up.
_SIZE, _FRAMES = 1024, 1024
# The zeroth order's wavelengths: as many as a page has look-ups left for.
_WAVELENGTHS = 10
# Of what the mean plane reflects at each of them.
_ENTRIES_OF_W = 512
_MOST_LIGHTS = 8
_BACKGROUND = (0.11, 0.11, 0.12)
_PARTS = {
    "RESAMPLE": "resample.frag", "SHARPEN": "sharpen.frag", "SURFACE_VERT": "surface.vert",
    "SURFACE_FRAG": "surface.frag", "DISPLAY": "display.frag", "SCRIPT": "page.js",
}  # fmt: skip


def export_html(
    path: str | os.PathLike[str],
    mesh: Any,
    lobes: BakedLobes,
    light: DirectionalLight | PointLight | Sequence[DirectionalLight | PointLight],
    view: View,
    *,
    ior: float | None = None,
    masking: bool = True,
    pigment: float = 1.0,
    shadows: bool = True,
    smooth: bool = True,
    tangents: ArrayLike | None = None,
    exposure: float | None = None,
    title: str = "warpdiff",
) -> Path:
    """Write one HTML file that shows a mesh whose surface carries baked lobes, in any browser with WebGL 2.

    It asks for nothing else, from this machine or any other. The body is turned, moved and approached, its lights are
    turned and its exposure is set by hand. A picture at rest adds up 1,024 frames, each with places of its own in the
    pixels, and then is that of :func:`warpdiff.shade` but for quantisation, edges of shadows, and footprints narrower
    than the page's grid over (u, v) resolves: it says how narrow.

    Args:
        path: Where to; it ends in ``.html`` or ``.htm``.
        mesh: As in :func:`warpdiff.shade`.
        lobes: What :func:`warpdiff.bake` made.
        light: One light, or several, under the illuminant of ``lobes``, up to 5° wide where these are averaged; those
            at a place are at least 1.1 radii of the mesh's bounding sphere from its centre.
        view: The first view, a perspective one; its size is that of the reader's window.
        ior: Index of refraction, > 1; ``math.inf`` is a perfect mirror, None is 1.5, or what the material of the lobes
            says.
        masking: Whether V-cavity masking and shadowing is included.
        pigment: Strength of the base colour that lies under the height field.
        shadows: Whether lights are hidden by the mesh itself, by maps of 4096 × 4096 texels.
        smooth: Whether vertex normals are interpolated; otherwise facets are seen.
        tangents: As in :func:`warpdiff.shade`.
        exposure: Linear factor; None is found when the page opens, for its first picture.
        title: Of the page.

    Returns:
        The path.

    Raises:
        ValueError: A bad argument, a mesh without area or tangents, lights of another illuminant.
    """
    target = validation.path(path, "path")
    if target.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"path must end in .html or .htm, got {str(path)!r}")
    validation.instance(lobes, BakedLobes, "lobes")
    lights = _check_lights(light, lobes)
    validation.instance(view, View, "view")
    if view.extent_y is not None:
        raise ValueError("view must be a perspective one, got an orthographic one")
    normal = normal_reflectance(lobes, ior)
    pigment = validation.number(pigment, "pigment", least=0.0)
    masking, shadows, smooth = (
        validation.flag(value, name) for name, value in (("masking", masking), ("shadows", shadows), ("smooth", smooth))
    )
    if exposure is not None:
        validation.positive(exposure, "exposure")
    if not isinstance(title, str):
        raise TypeError(f"title must be a string, got {type(title).__name__}")
    files.check_folder(target.parent, "path")
    with memory.as_memory_error("export_html()", "take a smaller mesh"):
        surface = prepare_surface(mesh, tangents=tangents)
        _check_places(lights, surface)
        arrays = Arrays()
        header = _add_mesh(arrays, surface) | _add_lobes(arrays, lobes) | _add_display(arrays)
        # No light comes through a material to what lies below it.
        pigmented = pigment > 0.0 and surface.has_base_colour and not lobes.has_material
        header |= {
            "view": {name: getattr(view, name) for name in ("eye", "target", "up", "fov_y_deg")},
            "lights": [
                {"to_light": each.to_light, "position": each.position, "power": each.power,
                 "deviation": 0.0 if each.deviations is None else float(np.linalg.norm(each.deviations[0]))}
                for given in lights for each in lobes_of(given, single_lobe=True)
            ],
            "exposure": exposure, "frames": _FRAMES, "mean_shown": display_transform.MEAN_SHOWN["aces"],
            "smooth": smooth, "masking": masking, "shadows": shadows and not surface.is_convex,
            "normal_reflectance": normal, "rgb_to_xyz": colorimetry.RGB_TO_XYZ.tolist(),
            "pigment_white": (pigment / normal * _white(lobes)).tolist() if pigmented else None,
            "arrays": arrays.told, "told": _told(lobes),
        }  # fmt: skip
        page = _filled(header, arrays, title)
        with files.atomic_write(target, suffix=".html") as temporary:
            temporary.write_text(page, encoding="utf-8")
    return target


def _check_lights(light: Any, lobes: BakedLobes) -> list[DirectionalLight | PointLight]:
    kinds = DirectionalLight | PointLight
    lights = [light] if isinstance(light, kinds) else light
    if not isinstance(lights, (list, tuple)) or not 1 <= len(lights) <= _MOST_LIGHTS:
        raise TypeError(
            f"light must be a DirectionalLight or a PointLight, or a sequence of 1 to {_MOST_LIGHTS} of them, got "
            f"{light!r}"
        )
    for index, each in enumerate(lights):
        if not isinstance(each, PointLight):
            validation.instance(each, DirectionalLight, f"light[{index}]")
        most = ONE_LOBE_DEG if lobes.coherence.kind == "averaged" else 0.0
        if isinstance(each, DirectionalLight) and each.angular_diameter_deg > most:
            raise ValueError(
                f"light[{index}].angular_diameter_deg must be at most {most:g} on a page of lobes of kind "
                f"{lobes.coherence.kind!r}, got {each.angular_diameter_deg:g}: give several lights, or bake lobes of a "
                "source"
            )
        if each.illuminant != lobes.illuminant:
            raise ValueError(
                f"light[{index}].illuminant must be that of lobes, {lobes.illuminant!r}, got {each.illuminant!r}"
            )
    return list(lights)


def _check_places(lights: Sequence[DirectionalLight | PointLight], surface: Surface) -> None:
    """Refuse lights within the mesh, and those that are brighter than the page's numbers hold."""
    for index, each in enumerate(lights):
        if not isinstance(each, PointLight):
            continue
        away = float(np.linalg.norm(np.subtract(each.position, surface.centre))) / surface.radius
        if away < _NEAREST:
            raise ValueError(
                f"light[{index}].position must be at least {_NEAREST:g} radii of the mesh, {surface.radius:g}, from "
                f"its centre, {tuple(surface.centre.tolist())}, got one of {away:.3g}: move it outwards"
            )
        if each.power > MOST_POWER * surface.radius**2:
            raise ValueError(
                f"light[{index}].power must be at most {MOST_POWER:g} times the square of the mesh's radius, "
                f"{surface.radius:g}, got {each.power:g}"
            )


def _add_mesh(arrays: Arrays, surface: Surface) -> dict[str, Any]:
    """The mesh in the unit sphere, its base colour, and how to read them."""
    count = len(surface.vertices)
    arrays.add_differences("positions", quantised(surface.vertices, -1.0, 1.0))
    arrays.add_differences("normals", octahedral(_defined_normals(surface)))
    arrays.add_differences("tangents", octahedral(surface.tangents))
    arrays.add_differences("faces", surface.faces.reshape(-1, 1))
    header: dict[str, Any] = {
        "vertices": count,
        "closed": surface.is_closed,
        "radius": surface.radius,
        "centre": surface.centre.tolist(),
    }
    if (surface.handedness < 0.0).any():
        arrays.add("handedness", "int8", surface.handedness.astype(np.int8).tobytes())
    texture = np.rint(255.0 * colorimetry.srgb_encode(surface.texture)).astype(np.uint8)
    header["plain_colour"] = [*texture[0, 0].tolist(), 255]
    if texture.shape[0] * texture.shape[1] > 1:
        import PIL.Image

        file = io.BytesIO()
        PIL.Image.fromarray(texture).save(file, "png", optimize=True)
        arrays.add("texture", "bytes", file.getvalue())
        low, high = surface.uvs.min(axis=0), surface.uvs.max(axis=0)
        span = np.maximum(high - low, 1e-6)
        arrays.add_differences("uvs", quantised(surface.uvs, low, low + span))
        header |= {"uv_low": low.tolist(), "uv_span": span.tolist()}
    if surface.vertex_colours is not None:
        own = (surface.vertex_colours >= 0.0).all(axis=1, keepdims=True)
        colours = np.rint(255.0 * colorimetry.srgb_encode(surface.vertex_colours))
        arrays.add_differences("colours", np.hstack([colours, own]))
    return header


def _defined_normals(surface: Surface) -> Any:
    """Vertex normals; where no direction is defined, that of one of its faces."""
    normals = surface.normals.astype(np.float64)
    corners = surface.vertices[surface.faces].astype(np.float64)
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    of_faces /= np.maximum(np.linalg.norm(of_faces, axis=1, keepdims=True), 1e-30)
    vague = np.linalg.norm(normals, axis=1) < 0.5
    for corner in range(3):
        at = surface.faces[:, corner]
        here = vague[at]
        normals[at[here]] = of_faces[here]
    return normals


def _add_lobes(arrays: Arrays, lobes: BakedLobes) -> dict[str, Any]:
    """The lobes as they are baked, their functions of w in fours, and the zeroth order's wavelengths."""
    arrays.add("exponents", "bytes", np.ascontiguousarray(lobes.exponents.T).tobytes())
    arrays.add(
        "mantissas", lobes.mantissas.dtype.name, np.ascontiguousarray(lobes.mantissas.transpose(1, 2, 0)).tobytes()
    )
    entries, count = lobes.functions.shape
    fours = np.zeros((-(-count // 4), entries, 4), dtype=np.float32)
    for k in range(count):
        fours[k // 4, :, k % 4] = lobes.functions[:, k]
    arrays.add("functions", "float32", fours.tobytes())
    wavenumbers, weights = colorimetry.uniform_quadrature(_WAVELENGTHS, lobes.illuminant)
    w = np.linspace(0.0, LARGEST_W, _ENTRIES_OF_W)
    zeroth = np.stack([mirror_power(lobes, w, tau) for tau in wavenumbers.tolist()])
    arrays.add("zeroth", "float32", zeroth.astype(np.float32).tobytes())
    return {
        "lobes": {
            "rings": lobes.grid.rings, "rays": list(lobes.grid.rays), "ring_of_largest": lobes.grid.ring_of_largest,
            "functions": count, "scale": lobes.scale, "size": _SIZE,
        },
        "variances": [lobes.lobe_variance(1.0 / tau) for tau in wavenumbers.tolist()],
        "weights": weights.tolist(),
    }  # fmt: skip


def _add_display(arrays: Arrays) -> dict[str, Any]:
    """The table of ACES, the largest chroma by hue, and what the compression of chroma takes."""
    tables = display_transform.tables("srgb")
    arrays.add_differences("display", np.rint(65_535.0 * tables.aces))
    arrays.add("most_chroma", "float32", tables.most_chroma.astype(np.float32).tobytes())
    return {
        "display": {
            "white": tables.white, "toe": tables.toe, "kept": [tables.unchanged, tables.compressed],
            "background": colorimetry.srgb_decode(_BACKGROUND).tolist(),
            **{name: np.asarray(matrix).tolist() for name, matrix in tables.matrices.items()},
        }
    }  # fmt: skip


def _white(lobes: BakedLobes) -> Any:
    """Linear sRGB of what a white pigment of strength 1 sends back, ∫ G S x̄ȳz̄ dλ / ∫ S ȳ dλ."""
    grid_um = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64) * 1e-3
    solid_angle = reflectance_factors.pigment_solid_angle(grid_um, lobes.coherence, 0.0)
    return colorimetry.xyz_to_rgb(solid_angle @ colorimetry.colour_products(lobes.illuminant))


def _told(lobes: BakedLobes) -> str:
    narrowest = 2.0 * LARGEST_W / _SIZE
    return (
        f"Drag to turn, with two fingers or the right button to move, wheel to approach; the disc is the light. "
        f"{lobes.coherence}, {lobes.illuminant}. What is nearer than {narrowest:.2g} in (u, v) is not told apart: from "
        f"nearer by, nothing new is seen. Made with warpdiff."
    )


def _filled(header: dict[str, Any], arrays: Arrays, title: str) -> str:
    """The page."""
    folder = resources.files("warpdiff.apps.web_page").joinpath("page")
    page = folder.joinpath("page.html").read_text(encoding="utf-8")
    background = "#" + "".join(f"{round(255.0 * each):02x}" for each in _BACKGROUND)
    # In JSON within a script element nothing may look like its end.
    filling = {
        "VERSION": metadata.version("warpdiff"), "TITLE": html.escape(title), "BACKGROUND": background,
        "HEADER": json.dumps(header).replace("<", "\\u003c"), "DATA": arrays.base64(),
        **{name: folder.joinpath(file).read_text(encoding="utf-8") for name, file in _PARTS.items()},
    }  # fmt: skip
    # One pass: what is filled in is not looked at again.
    return re.sub("@([A-Z_]+)@", lambda found: filling[found[1]], page)
