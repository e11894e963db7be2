"""Layers of pictures: name, type of the values, channels, and describing text of each layer.

A layer is an additional array of a picture, such as the depth or the normal of each pixel. It is one entry of
``LAYERS``. It is also one entry of ``VALUES`` in ``render/layers.py``, unless its values are numbers of the faces of
the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class LayerFormat:
    """Format of a layer, which has one value per pixel.

    Attributes:
        meaning: Meaning of the values, for the reference pages of the documentation.
        channels: Suffixes of the EXR channels that hold the values.
        empty: Value of pixels whose central ray hits no mesh, or whose hit the light does not reach.
        dtype: Type of the values.
        by_light: Whether each light has a layer of its own: ``"light.0"``, ``"light.1"``, …
        is_colour: Whether the values are CIE XYZ. EXR files then also have R, G and B.
        faces: If the layer shows a number that belongs to the visible face, the name of the attribute of the prepared
            mesh that has one number per face; otherwise empty.
        names: Name of the attribute of the prepared mesh with the texts for which the numbers of ``faces`` stand,
            otherwise empty.
    """

    meaning: str
    channels: tuple[str, ...]
    empty: float = 0.0
    dtype: type = np.float32
    by_light: bool = False
    is_colour: bool = False
    faces: str = ""
    names: str = ""

    def shaped(self, values: NDArray[np.generic], shape: tuple[int, int]) -> NDArray[np.generic]:
        """Return values of shape (n, channels) or (n,) as a picture; layers with one channel have two dimensions."""
        return values.astype(self.dtype).reshape(*shape, *([len(self.channels)] if len(self.channels) > 1 else []))


_VECTOR, _COLOUR = ("X", "Y", "Z"), ("XYZ.X", "XYZ.Y", "XYZ.Z")
LAYERS = {
    "normal": LayerFormat("unit shading normal on the viewer's side, world frame", _VECTOR),
    "tangent": LayerFormat("unit vector along the height field's x axis, world frame", _VECTOR),
    "bitangent": LayerFormat("unit vector along the height field's y axis, world frame", _VECTOR),
    "depth": LayerFormat(
        "distance along the ray from the eye, or from the plane through the eye of an orthographic camera [the mesh's "
        "unit]; infinite in the background", ("Z",), np.inf,
    ),
    "position": LayerFormat("position of the hit, world frame [the mesh's unit]", _VECTOR),
    "uv": LayerFormat("texture coordinates, v upwards", ("U", "V")),
    "albedo": LayerFormat("base colour, linear sRGB", ("R", "G", "B")),
    "geometry": LayerFormat(
        "index of the scene's geometry, in the order of its nodes; −1 in the background. ``names`` has the names",
        ("Y",), -1, np.int32, faces="geometries", names="geometry_names",
    ),
    "to_view": LayerFormat("unit vector to the viewer in the local frame (tangent, bitangent, normal)", _VECTOR),
    "to_light": LayerFormat(
        "unit vector to the light in the local frame; 0 where the light does not reach the hit", _VECTOR, by_light=True
    ),
    "scattering": LayerFormat(
        "scattering vector (u, v, w), −(``to_light`` + ``to_view``)", ("U", "V", "W"), by_light=True
    ),
    "light": LayerFormat("CIE XYZ under one light, whose sum is the picture", _COLOUR, by_light=True, is_colour=True),
}  # fmt: skip
BY_LIGHT = tuple(name for name, layer in LAYERS.items() if layer.by_light)


def layer_format(name: str) -> LayerFormat:
    """Return the format of a layer by its name, which may end in the index of a light, as ``"light.0"`` does.

    A layer is an additional array of a picture, such as the depths of its pixels.
    """
    return LAYERS[name.partition(".")[0]]


def layer_of(channel: str) -> str:
    """Return the name of the layer of an EXR channel such as ``"light.0.R"``; an empty string if no layer has it.

    A layer is an additional array of a picture, such as the depths of its pixels.
    """
    name, _, rest = channel.partition(".")
    layer = LAYERS.get(name)
    if layer is None:
        return ""
    return f"{name}.{rest.partition('.')[0]}" if layer.by_light else name
