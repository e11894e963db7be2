"""Function ``export_html``, which writes a web page that needs no server. The page shows a mesh with baked colours.

Baked lobes are the table of colours over all directions that ``warpdiff.bake`` makes of a height field.

The scattering vector (u, v, w) is −ωi − ωr for the unit vectors ωi to the light and ωr to the viewer, in the local
frame.
"""

from __future__ import annotations

import html
import io
import json
import math
import re
from importlib import metadata, resources
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge, Interval

from warpdiff.apps.web_page.packing import Arrays, octahedral, quantised
from warpdiff.baked.interpolation import ring_of_largest
from warpdiff.baked.lobe_table import LARGEST_W, BakedLobes, normal_reflectance, zeroth_order_power
from warpdiff.core import files, memory, validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.image import display_transform
from warpdiff.lights.base import MOST_POWER, Light
from warpdiff.lights.directional import ONE_LOBE_DEG, DirectionalLight
from warpdiff.lights.environment import Environment
from warpdiff.lights.point import PointLight
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.request.signatures import checked
from warpdiff.scene.camera import View  # noqa: TC001 (the decorator ``checked`` needs the class at run time)
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.request.settings import TangentRule
    from warpdiff.scene.mesh_import import Surface

# Smallest distance of a point light from the centre of the mesh, in radii of the mesh. The shadow map of a light covers
# only the half-space in front of the light, so that the light must be outside of the mesh.
_NEAREST = 1.1
# Texels per side of the Cartesian grid over (u, v) to which the page resamples the table of colours, and number of
# frames that the page averages while nothing moves. Twice the texels per side would require four times the graphics
# memory, and twice the frames would require twice the time.
_SIZE, _FRAMES = 1024, 1024
# Number of wavelengths over which a page sums the zeroth order. The number is limited because a page may use 64 texture
# fetches per fragment, and looking up baked colours needs most of them.
_WAVELENGTHS = 10
# Number of values of |w| at which the page has the power of the zeroth order; it interpolates linearly between them.
# w is the component of the scattering vector along the normal.
_ENTRIES_OF_W = 512
# Largest number of lights of a page. The number is limited because the page renders the mesh and a shadow map for every
# light in every frame.
_MOST_LIGHTS = 8
# Suffixes of the HTML file of an exported page.
SUFFIXES = (".html", ".htm")
_BACKGROUND = (0.11, 0.11, 0.12)
_PARTS = {
    "RESAMPLE": "resample.frag", "SHARPEN": "sharpen.frag", "SURFACE_VERT": "surface.vert",
    "SURFACE_FRAG": "surface.frag", "DISPLAY": "display.frag", "SCRIPT": "page.js",
}  # fmt: skip


@checked
def export_html(
    path: str | os.PathLike[str], mesh: Any, lobes: BakedLobes,
    lights: DirectionalLight | PointLight | Sequence[DirectionalLight | PointLight], view: View, *,
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None, masking: bool = True,
    pigment: Annotated[float, Ge(0.0)] = 1.0, shadows: bool = True, smooth: bool = True,
    tangents: TangentRule | ArrayLike | None = None,
    exposure: Annotated[float, Ge(validation.LEAST)] | None = None, title: str = "warpdiff",
) -> Path:  # fmt: skip
    """Write one HTML file that shows a mesh whose surface carries baked lobes, in any browser with WebGL 2.

    The file is complete: it loads nothing else. On the page you can rotate, pan and zoom, rotate the lights and set the
    exposure. A picture at rest accumulates 1,024 frames with jittered pixel positions. This average equals the picture
    of :func:`warpdiff.shade` except for quantisation, the edges of shadows, and pixel footprints that are narrower than
    the page's grid over (u, v); the page states the resolution of this grid.

    Args:
        path: File with the suffix ``.html`` or ``.htm``.
        mesh: Mesh, as for :func:`warpdiff.shade`.
        lobes: Table of :func:`warpdiff.bake`.
        lights: One to eight directional or point lights with the illuminant of ``lobes``. A disc light may have a
            diameter of at most 5°. A disc light requires lobes that were baked with a coherence of the kind
            ``"averaged"``. The page renders it as a Gaussian of the same variance, with a hard shadow. The distance of
            point lights from the mesh's centre is at least 1.1 radii of its bounding sphere. Environments are refused:
            use a directional light for the sun, ``DirectionalLight(sun_direction, angular_diameter_deg=0.53)``.
        view: First view, by a perspective camera. The size of the picture is that of the browser's window.
        ior: Index of refraction; ``math.inf`` is a perfect mirror. None is 1.5, or the material with which the lobes
            were baked.
        masking: Whether V-cavity masking and shadowing of the relief is included.
        pigment: Strength of the mesh's base colour (texture, vertex colours or plain), which lies under the relief.
        shadows: Whether the mesh can occlude the lights, by shadow maps of 4096 × 4096 texels.
        smooth: Whether vertex normals are interpolated; otherwise facets show.
        tangents: Direction of the height field's x axis, as for :func:`warpdiff.shade`.
        exposure: Linear factor of the light; None is automatic for the first picture of the page.
        title: Title of the page.

    Returns:
        The path of the file.

    Raises:
        ValueError: An argument is not accepted, the mesh has no area or no tangents, or a light has another illuminant.
        OSError: The file cannot be written; an existing file is unchanged.

    Examples:
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> lobes = wd.bake(grating, delta_e=20.0, coherence=wd.Coherence(sigma_um=2.0))
        >>> light, view = wd.DirectionalLight((0, 1, 1)), wd.View.fit(body, turning=True)
        >>> wd.export_html("page.html", body, lobes, light, view).name
        'page.html'
    """
    target = files.check_output(path, SUFFIXES)
    checked_lights = _check_lights(lights, lobes)
    if view.extent_y is not None:
        raise ArgumentValueError(f"{ref('view')} must be a perspective camera, got an orthographic one")
    normal = normal_reflectance(lobes, ior)
    with memory.as_memory_error("export_html()", f"use a {ref('mesh')} with fewer faces"):
        surface = prepare_surface(mesh, tangents=tangents)
        _check_positions(checked_lights, surface)
        arrays = Arrays()
        header = _add_mesh(arrays, surface) | _add_lobes(arrays, lobes) | _add_display(arrays)
        # A metal or a coated material transmits no light to the base colour of the mesh (pigment) below it.
        white = colorimetry.xyz_to_rgb(reflectance_factors.pigment_white(lobes.illuminant, lobes.coherence, 0.0))
        pigmented = pigment > 0.0 and surface.has_base_colour and not lobes.has_material
        header |= {
            "view": {name: getattr(view, name) for name in ("eye", "target", "up", "fov_y_deg")},
            "lights": [
                {"to_light": lobe.to_light, "position": lobe.position, "power": lobe.power,
                 "deviation": 0.0 if lobe.deviations is None else float(np.linalg.norm(lobe.deviations[0]))}
                for light in checked_lights for lobe in light.lobes()
            ],
            "exposure": exposure, "frames": _FRAMES, "mean_shown": display_transform.MEAN_SHOWN["aces"],
            "smooth": smooth, "masking": masking, "shadows": shadows and not surface.is_convex,
            "normal_reflectance": normal, "rgb_to_xyz": colorimetry.RGB_TO_XYZ.tolist(),
            "pigment_white": (pigment / normal * white).tolist() if pigmented else None,
            "arrays": arrays.entries, "description": _description(lobes),
        }  # fmt: skip
        page = _filled(header, arrays, title)
        with files.atomic_write(target, suffix=".html") as temporary:
            temporary.write_text(page, encoding="utf-8", newline="\n")
    return target


def _check_lights(lights: Any, lobes: BakedLobes) -> list[DirectionalLight | PointLight]:
    """Return the lights as a list; raise one error that names all lights that a page cannot show."""
    result = [lights] if isinstance(lights, Light) else lights
    if not isinstance(result, (list, tuple)) or not 1 <= len(result) <= _MOST_LIGHTS:
        raise ArgumentTypeError(
            f"{ref('lights')} must be a DirectionalLight or a PointLight, or a sequence of 1 to {_MOST_LIGHTS} of "
            f"them, got {lights!r:.60}"
        )
    most, remedy = ONE_LOBE_DEG, "several lights for a wide disc, or lobes of a source"
    if lobes.coherence.kind != "averaged":
        most, remedy = 0.0, "points instead of discs, as the lobes' source has a diameter"
    refused: dict[str, str] = {}
    for index, light in enumerate(result):
        validation.instance(light, Light, f"lights[{index}]")
        name = ref(f"lights[{index}]")
        if type(light) is DirectionalLight and light.angular_diameter_deg > most:
            refused[f"{name} ({light.angular_diameter_deg:g}°)"] = remedy
        elif isinstance(light, Environment):
            refused[f"{name} (Environment)"] = "a DirectionalLight for a sky's sun, or render a sequence under the sky"
        elif type(light) not in (DirectionalLight, PointLight):
            refused[f"{name} ({type(light).__name__})"] = "a PointLight or a DirectionalLight for other kinds"
    if refused:
        raise ArgumentValueError(
            f"{ref('lights')} must be point lights, or directional lights of at most {most:g}° in diameter, on a page "
            f"of lobes of kind {lobes.coherence.kind!r}, got {', '.join(refused)}; use "
            f"{'; '.join(dict.fromkeys(refused.values()))}"
        )
    for index, light in enumerate(result):
        if light.illuminant != lobes.illuminant:
            raise ArgumentValueError(
                f"{ref(f'lights[{index}].illuminant')} must be the illuminant of {ref('lobes')}, "
                f"{str(lobes.illuminant)!r}, got {str(light.illuminant)!r}: bake with the illuminant of the light"
            )
    return list(result)


def _check_positions(lights: Sequence[DirectionalLight | PointLight], surface: Surface) -> None:
    """Raise an error for point lights that are too close to the mesh, or too powerful for float32 numbers."""
    for index, light in enumerate(lights):
        if not isinstance(light, PointLight):
            continue
        distance = float(np.linalg.norm(np.subtract(light.position, surface.centre))) / surface.radius
        if distance < _NEAREST:
            raise ArgumentValueError(
                f"{ref(f'lights[{index}].position')} must be at least {_NEAREST:g} radii of the mesh, "
                f"{surface.radius:g}, from its centre, {tuple(surface.centre.tolist())}, got {distance:.3g} radii: "
                "move it outwards"
            )
        if light.power > MOST_POWER * surface.radius**2:
            raise ArgumentValueError(
                f"{ref(f'lights[{index}].power')} must be at most {MOST_POWER:g} times the square of the mesh's "
                f"radius, {surface.radius:g}, got {light.power:g}"
            )


def _add_mesh(arrays: Arrays, surface: Surface) -> dict[str, Any]:
    """Store the vertices of the mesh, scaled to the unit sphere, and its base colour in the arrays of the page.

    Returns:
        The entries of the page's header that describe the arrays.
    """
    count = len(surface.vertices)
    arrays.add_differences("positions", quantised(surface.vertices, -1.0, 1.0))
    arrays.add_differences("normals", octahedral(_defined_normals(surface)))
    arrays.add_differences("tangents", octahedral(surface.tangents))
    arrays.add_differences("faces", surface.faces.reshape(-1, 1))
    header: dict[str, Any] = {
        "vertices": count, "closed": surface.is_closed, "radius": surface.radius, "centre": surface.centre.tolist(),
    }  # fmt: skip
    if (surface.handedness < 0.0).any():
        arrays.add("handedness", "int8", surface.handedness.astype(np.int8).tobytes())
    if not surface.is_opaque:
        warn(f"{ref('mesh')} has transparent materials, which a page draws opaque")
    header["plain_colour"] = [*_encoded(surface.plain_colour.clip(0.0, None)).tolist(), 255]
    if surface.is_textured:
        import PIL.Image

        texture = _encoded(_only_texture(surface))
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


def _encoded(colours: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return linear colours in 8 bits of sRGB."""
    return np.rint(255.0 * colorimetry.srgb_encode(colours)).astype(np.uint8)


def _only_texture(surface: Surface) -> NDArray[np.float32]:
    """Return the texture of a mesh that has one image, linear RGB; raise an error if it has several."""
    textures = {id(texture.texels): texture for texture in surface.textures if texture is not None}
    if len(textures) > 1:
        raise ArgumentValueError(
            f"{ref('mesh')} must have at most one texture image in a page, got {len(textures)}: bake them into one"
        )
    (texture,) = textures.values()
    if texture.wrap != ("repeat", "repeat"):
        raise ArgumentValueError(
            f"{ref('mesh')} must have a texture that is repeated in a page, got {texture.wrap[0]!r} along u and "
            f"{texture.wrap[1]!r} along v: give texture coordinates of 0 to 1 and the continuation 'repeat'"
        )
    return texture.texels[..., :3]


def _defined_normals(surface: Surface) -> Any:
    """Return vertex normals, shape (n, 3). Where a normal is undefined, that of one of the vertex's faces is used."""
    normals = surface.normals.astype(np.float64)
    corners = surface.vertices[surface.faces].astype(np.float64)
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face_normals /= np.maximum(np.linalg.norm(face_normals, axis=1, keepdims=True), 1e-30)
    is_undefined = np.linalg.norm(normals, axis=1) < 0.5
    for corner in range(3):
        vertices = surface.faces[:, corner]
        faces = is_undefined[vertices]
        normals[vertices[faces]] = face_normals[faces]
    return normals


def _add_lobes(arrays: Arrays, lobes: BakedLobes) -> dict[str, Any]:
    """Store the baked lobes (table of colours over all directions) in the arrays of the page.

    The arrays are basis functions of w, their coefficients for each (u, v), and the power of the zeroth order. Four
    functions share a texel.

    Returns:
        The entries of the page's header that describe the baked lobes.
    """
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
    zeroth = np.stack([zeroth_order_power(lobes, w, tau) for tau in wavenumbers.tolist()])
    arrays.add("zeroth", "float32", zeroth.astype(np.float32).tobytes())
    return {
        "lobes": {
            "rings": lobes.grid.rings, "rays": list(lobes.grid.azimuths),
            "ring_of_largest": ring_of_largest(lobes.grid.rings, lobes.grid.azimuths),
            "functions": count, "scale": lobes.scale, "size": _SIZE,
        },
        "variances": [lobes.lobe_variance(1.0 / tau) for tau in wavenumbers.tolist()],
        "weights": weights.tolist(),
    }  # fmt: skip


def _add_display(arrays: Arrays) -> dict[str, Any]:
    """Store the tables of the display transform in the page's arrays: ACES 2.0, and the largest chroma of each hue.

    Returns:
        The entries of the page's header with the constants of the display transform.
    """
    arrays.add_differences("display", np.rint(65_535.0 * display_transform.aces_table("srgb")))
    arrays.add("most_chroma", "float32", display_transform.most_chroma()[1].astype(np.float32).tobytes())
    return {
        "display": {
            "white": display_transform.WHITE, "toe": display_transform.TOE,
            "chromaLimits": [display_transform.UNCHANGED, display_transform.COMPRESSED],
            "background": colorimetry.srgb_decode(_BACKGROUND).tolist(),
            **{name: matrix.tolist() for name, matrix in display_transform.MATRICES.items()},
        }
    }  # fmt: skip


def _description(lobes: BakedLobes) -> str:
    return (
        "Drag to rotate. Drag with two fingers or the right button to pan, use the wheel to zoom. Drag the disc to "
        f"rotate the lights. {lobes.coherence}, {lobes.illuminant}. Resolution in (u, v): "
        f"{2.0 * LARGEST_W / _SIZE:.2g}. Made with warpdiff."
    )


def _filled(header: dict[str, Any], arrays: Arrays, title: str) -> str:
    """Return the HTML text of the page: the template with header, arrays, shaders and script inserted."""
    folder = resources.files("warpdiff.apps.web_page").joinpath("page")
    page = folder.joinpath("page.html").read_text(encoding="utf-8")
    background = "#" + "".join(f"{round(255.0 * component):02x}" for component in _BACKGROUND)
    # The header is JSON inside a script element. Its "<" are escaped, because a text with "</script>" would end the
    # element.
    filling = {
        "VERSION": metadata.version("warpdiff"), "TITLE": html.escape(title), "BACKGROUND": background,
        "HEADER": json.dumps(header).replace("<", "\\u003c"), "DATA": arrays.base64(),
        **{name: folder.joinpath(file).read_text(encoding="utf-8") for name, file in _PARTS.items()},
    }  # fmt: skip
    # All placeholders are replaced in one pass. A text in an inserted array or script that looks like a placeholder is
    # therefore not replaced.
    return re.sub("@([A-Z_]+)@", lambda match: filling[match[1]], page)
