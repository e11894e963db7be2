"""Objects of trimesh as parts of a scene: their arrays, colours, materials and names."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.optics.colorimetry import srgb_decode
from warpdiff.scene.mesh_geometry import FaceGeometry, unit
from warpdiff.scene.scene_parts import Appearance, ScenePart, TextureMap, unique_names

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from PIL import Image
    from trimesh.visual.material import PBRMaterial

    from warpdiff.scene.scene_parts import AlphaMode

_WHITE = (1.0, 1.0, 1.0, 1.0)
# Textures of trimesh's materials that have no effect on pictures: attribute of the material, and name in warnings.
_PBR_MAPS = {"normalTexture": "normal map", "occlusionTexture": "occlusion"}
# Features of materials in .mtl files that have no effect on pictures: keyword in the file, and name in warnings.
_MTL_MAPS = {
    "map_d": "texture of transparency", "map_pm": "texture of metallic", "map_pr": "texture of roughness",
    "map_ke": "texture of emission", "norm": "normal map", "map_bump": "bump map", "bump": "bump map",
}  # fmt: skip
# Alpha modes, by their names in trimesh and in glTF.
_ALPHA_MODES: dict[str, AlphaMode] = {"MASK": "mask", "BLEND": "blend"}


def parts_of(mesh: Any) -> list[ScenePart]:
    """Return the parts of a ``trimesh.Trimesh`` or a ``trimesh.Scene``."""
    import trimesh

    if isinstance(mesh, trimesh.Trimesh):
        placed = [("", mesh, np.eye(4))]
    elif isinstance(mesh, trimesh.Scene):
        nodes = ((mesh.graph[node][1], mesh.graph[node][0]) for node in mesh.graph.nodes_geometry)
        placed = [
            (str(name), mesh.geometry[name], np.asarray(transform, dtype=np.float64))
            for name, transform in nodes
            if isinstance(mesh.geometry[name], trimesh.Trimesh)
        ]
    else:
        raise ArgumentTypeError(
            f"{ref('mesh')} must be a trimesh.Trimesh, a trimesh.Scene or a path, got {type(mesh).__name__}"
        )
    if not placed:
        raise ArgumentValueError(f"{ref('mesh')} must have triangles, got a scene or file without any")
    appearances = _appearances([geometry for _, geometry, _ in placed])
    return [
        _part(geometry, name, appearance, transform)
        for (name, geometry, transform), appearance in zip(placed, appearances, strict=True)
    ]


def _part(mesh: Any, name: str, appearance: Appearance | None, transform: NDArray[np.float64]) -> ScenePart:
    """Return a mesh of trimesh as a part of a scene, with its arrays, its material and its transform."""
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    uvs = getattr(mesh.visual, "uv", None)
    sets: dict[int, NDArray[np.float64]] = {}
    if uvs is not None and np.ndim(uvs) == 2 and len(uvs) == len(vertices) and np.shape(uvs)[1] >= 2:
        sets[0] = np.array(uvs[:, :2], dtype=np.float64)
    with np.errstate(all="ignore"):  # vertices that are not finite are refused later
        normals = _own_normals(mesh, vertices, faces)
    part = ScenePart(
        geometry=name, appearance=appearance, vertices=vertices, faces=faces, source=np.arange(len(vertices)),
        source_count=len(vertices), normals=normals,
        uvs=sets, transform=transform,
    )  # fmt: skip
    return _with_colours(part, mesh.visual)


def _with_colours(part: ScenePart, visual: Any) -> ScenePart:
    """Return a part with its vertex colours. If faces have colours, vertices are duplicated for each face."""
    if visual.kind == "vertex":
        return replace(part, colours=_linear_rgba(visual.vertex_colors))
    if visual.kind == "face":
        colours = np.repeat(_linear_rgba(visual.face_colors), 3, axis=0)
        return replace(part.with_separate_corners(), colours=colours)
    if hasattr(visual, "material") and getattr(visual, "face_materials", None) is not None:
        raise ArgumentValueError(
            f"{ref('mesh')} must have one material per geometry, got face materials; split it by material, or bake "
            "them into one texture"
        )
    return part


def _linear_rgba(colours: Any) -> NDArray[np.float64]:
    """Convert colours of 8 bits in sRGB to linear RGBA."""
    shares = np.asarray(colours) / 255.0
    return np.concatenate([srgb_decode(shares[:, :3]), shares[:, 3:]], axis=1)


def _appearances(meshes: list[Any]) -> list[Appearance | None]:
    """Return the materials of meshes. Meshes with the same material get the same object."""
    materials: list[Any] = []
    numbers = []
    for mesh in meshes:
        material = getattr(mesh.visual, "material", None)
        known = (number for number, other in enumerate(materials) if other is material)
        number = None if material is None else next(known, len(materials))
        if number == len(materials):
            materials.append(material)
        numbers.append(number)
    names = unique_names((_name(material) for material in materials), "material")
    appearances = [_appearance(material, name) for material, name in zip(materials, names, strict=True)]
    return [None if number is None else appearances[number] for number in numbers]


def _name(material: Any) -> str | None:
    """Return the name of a material, or None."""
    name = getattr(material, "name", None)
    return str(name) if name else None


def _appearance(material: Any, name: str) -> Appearance:
    """Return the appearance that a material object of trimesh describes."""
    from trimesh.visual import DEFAULT_COLOR
    from trimesh.visual.material import PBRMaterial, color_image

    if isinstance(material, PBRMaterial):
        # The colour factor of a glTF material is linear. It multiplies the texture after decoding from sRGB.
        factor, image = material.baseColorFactor, material.baseColorTexture
        colour = None
        if factor is not None:
            shares = np.asarray(factor, dtype=np.float64) / 255.0
            colour = (*shares[:3].tolist(), float(shares[3]) if len(shares) > 3 else 1.0)
        elif image is not None:
            colour = _WHITE
        return Appearance(
            name, base_colour=colour, base_texture=None if image is None else TextureMap(image),
            metallic=1.0 if material.metallicFactor is None else float(material.metallicFactor),
            roughness=_stated_roughness(material), emission=_emission(material.emissiveFactor, name),
            metallic_roughness_texture=_map(material.metallicRoughnessTexture),
            emission_texture=_map(material.emissiveTexture),
            alpha_mode=_ALPHA_MODES.get(str(material.alphaMode).upper(), "opaque"),
            alpha_cutoff=0.5 if material.alphaCutoff is None else float(material.alphaCutoff),
            not_rendered=tuple(label for key, label in _PBR_MAPS.items() if getattr(material, key) is not None),
        )  # fmt: skip
    read = _MtlFactors.of(getattr(material, "kwargs", None) or {}, name)
    factors: dict[str, Any] = {
        "metallic": read.metallic, "roughness": read.roughness, "emission": read.emission,
        "not_rendered": read.not_rendered,
    }  # fmt: skip
    image, diffuse = getattr(material, "image", None), getattr(material, "diffuse", None)
    # trimesh gives a mesh without a material a texture of 2 × 2 grey pixels, which is ignored here.
    if image is not None and image.size == (2, 2) and np.array_equal(np.asarray(image), np.asarray(color_image())):
        return Appearance(name, **factors)
    plain: tuple[float, float, float, float] | None
    if read.colour is not None:
        own = np.array(read.colour)
        red, green, blue = np.where((own >= 0.0) & (own <= 1.0), srgb_decode(own), own).tolist()
        plain = (red, green, blue, 1.0)
    elif diffuse is None or np.array_equal(diffuse, DEFAULT_COLOR):
        plain = None
    else:
        shares = np.asarray(diffuse, dtype=np.float64) / 255.0
        plain = (*srgb_decode(shares[:3]).tolist(), float(shares[3]) if len(shares) > 3 else 1.0)
    # The diffuse colour (Kd) of a material does not multiply the texture. It only replaces an unreadable texture.
    return Appearance(
        name, base_colour=plain if image is None else _WHITE, base_texture=_map(image),
        fallback_colour=None if image is None else plain, **factors,
    )  # fmt: skip


def _map(image: Image.Image | None) -> TextureMap | None:
    """Return a texture that uses the first set of texture coordinates and is repeated; None without an image."""
    return None if image is None else TextureMap(image)


def _stated_roughness(material: PBRMaterial) -> float | None:
    """Return the roughness of a material of trimesh; None if the material states neither metallic nor roughness."""
    stated = material.metallicFactor, material.roughnessFactor, material.metallicRoughnessTexture
    if all(value is None for value in stated):
        return None
    return 1.0 if material.roughnessFactor is None else float(material.roughnessFactor)


def _emission(values: Any, name: str) -> tuple[float, float, float]:
    """Return the emission of a material of trimesh; zeros if the material states none."""
    if values is None:
        return (0.0, 0.0, 0.0)
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape != (3,):
        raise ArgumentValueError(
            f"{ref('mesh')}'s material {name!r} must have an emission of 3 numbers, got the shape {numbers.shape}; "
            "correct its emissiveFactor"
        )
    return cast("tuple[float, float, float]", tuple(numbers.tolist()))


class _MtlFactors(NamedTuple):
    """Factors of a material of an .mtl file.

    ``Pm`` and ``Pr`` are the metallic and the roughness of the metallic-roughness model, and ``Ke`` is the emission.
    ``Ks`` and ``Ns`` belong to the Phong model, whose normalisation the format does not define. Materials that have
    only ``Ks`` and ``Ns`` are therefore matte.
    """

    colour: tuple[float, float, float] | None
    metallic: float
    roughness: float | None
    emission: tuple[float, float, float]
    not_rendered: tuple[str, ...]

    @classmethod
    def of(cls, keys: dict[str, Any], name: str) -> _MtlFactors:
        """Return metallic, roughness, emission and colour of a material from the values of its .mtl file.

        Args:
            keys: Values of the material by their keywords in the .mtl file, in lower case.
            name: Name of the material.

        Raises:
            ValueError: A factor is not finite.
        """
        features = [label for key, label in _MTL_MAPS.items() if key in keys]
        numbers: dict[str, tuple[float, ...]] = {}
        for key, count in (("kd", 3), ("pm", 1), ("pr", 1), ("ke", 3), ("d", 1), ("tr", 1)):
            if key not in keys:
                continue
            try:
                values = tuple(float(value) for value in np.atleast_1d(keys[key]))
            except ValueError:
                values = ()
            if len(values) != count:
                text = " ".join(map(str, np.atleast_1d(keys[key])))
                features.append(f"the unreadable value {text[:40]!r} of {key.capitalize()}")
                continue
            if not np.isfinite(values).all():
                raise ArgumentValueError(
                    f"{ref('mesh')}'s material {name!r} must have a finite {key.capitalize()}, got "
                    f"{', '.join(f'{value:g}' for value in values)}; correct the .mtl file"
                )
            numbers[key] = values
        # By the specification, a material with Tr 1 is invisible. Files with Tr 1 come from programs that write the
        # opacity instead, so that the material is opaque.
        if numbers.get("d", (1.0,))[0] < 1.0 or 0.0 < numbers.get("tr", (0.0,))[0] < 1.0:
            features.append("transparency")
        colour = numbers.get("kd")
        if colour is not None and all(0.0 <= value <= 1.0 for value in colour):
            colour = None  # trimesh has read these correctly
        (metallic,), (roughness,) = numbers.get("pm", (0.0,)), numbers.get("pr", (1.0,))
        is_matte = "pm" not in numbers and "pr" not in numbers
        return cls(
            cast("tuple[float, float, float] | None", colour), metallic, None if is_matte else roughness,
            cast("tuple[float, float, float]", numbers.get("ke", (0.0, 0.0, 0.0))), tuple(features),
        )  # fmt: skip


def _own_normals(mesh: Any, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Return the vertex normals of the input mesh, shape (n, 3), or None if trimesh computed them.

    trimesh stores normals of the file and computed normals in the same attribute. If it has computed normals, its cache
    also has the angles of faces, but these angles may have been computed for another reason. If the cache has angles,
    normals count as computed if they have the values that trimesh would compute.
    """
    normals = mesh.vertex_normals if "vertex_normals" in mesh._cache else None
    worked_out = normals is None or "face_angles" in mesh._cache
    if worked_out and _has_facets(mesh):
        facets = np.zeros(vertices.shape)
        facets[faces] = mesh.face_normals[:, None]
        return facets
    if normals is None or np.shape(normals) != vertices.shape:
        return None
    normals = np.asarray(normals, dtype=np.float64)
    normals = unit(np.where(np.isfinite(normals), normals, 0.0).T)
    if not worked_out:
        return normals.T
    if vertices.ndim != 2 or not len(faces) or not 0 <= faces.min() <= faces.max() < len(vertices):
        return None
    corners = np.ascontiguousarray(faces.T)
    # The stored normals are first compared with computed normals at the vertices of a few faces. All vertices are
    # compared only if these agree.
    some = np.zeros(len(vertices), dtype=np.bool_)
    some[faces[:: len(faces) // 16 + 1]] = True
    for at in (some, np.ones_like(some)):
        beside = corners.compress(at.take(corners).any(axis=0), axis=1)
        computed = unit(FaceGeometry(vertices.T, beside).angle_weighted_normals(beside, len(vertices)))
        if not np.allclose(normals[:, at], computed[:, at], atol=1e-6):
            return normals.T
    return None


def _has_facets(mesh: Any) -> bool:
    """Return whether a mesh is from an unmerged STL file, which has one normal per face and no other normals."""
    source = getattr(mesh, "source", None)
    return getattr(source, "file_type", None) == "stl" and len(mesh.vertices) == 3 * len(mesh.faces)
