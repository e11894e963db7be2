"""Vertices and faces that the extension KHR_draco_mesh_compression compresses, decoded by the package DracoPy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.scene.gltf.gltf_accessors import normalised
from warpdiff.scene.gltf.gltf_values import refuse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.scene.gltf.gltf_accessors import Accessors
    from warpdiff.scene.gltf.gltf_buffers import Container
    from warpdiff.scene.gltf.gltf_values import Element

EXTENSION = "KHR_draco_mesh_compression"
# Largest value of each integer type of compressed attributes, by the number of the type in Draco files.
_LARGEST = {1: 127.0, 2: 255.0, 3: 32767.0, 4: 65535.0}


def decoded_primitive(
    compressed: Element, attributes: dict[str, int], container: Container, accessors: Accessors
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Decode a primitive of a mesh; return the vertex indices of its triangles' corners, and its attributes by name.

    Args:
        compressed: JSON object of the extension KHR_draco_mesh_compression.
        attributes: Indices of the accessors of the primitive's attributes, by name.
        container: Buffers of the file.
        accessors: Accessors of the file, which state the attributes whose integers are normalised.
    """
    try:
        import DracoPy
    except ImportError:
        raise ArgumentValueError(
            f"{ref('mesh')} is compressed by the extension {EXTENSION}, which requires the package DracoPy: "
            "pip install 'warpdiff[gltf]'"
        ) from None

    data = container.view(compressed.integer("bufferView", most=len(container.views) - 1))
    try:
        mesh = DracoPy.decode(bytes(data))
        faces = np.asarray(mesh.faces).astype(np.int64).reshape(-1)
    except Exception as error:
        # For damaged data, DracoPy raises errors of its own classes and of other classes. All are caught.
        refuse(compressed.place, f"must be sound Draco data: {str(error) or type(error).__name__}")
    numbers = compressed.stated_element("attributes")
    result = {}
    for name in numbers.values:
        if name not in attributes:
            continue
        number = numbers.integer(name)
        try:
            attribute = mesh.get_attribute_by_unique_id(number)
            kind = int(attribute["data_type"])
            values = np.asarray(attribute["data"])
            values = values.reshape(len(values), -1).astype(np.float64)
        except Exception as error:
            numbers.refuse(name, f"must be an attribute of the Draco data: {str(error) or type(error).__name__}")
        # DracoPy returns integers as float32. Their original type is therefore read from the attribute's description.
        is_share = name.startswith("COLOR") or accessors.is_normalised(attributes[name])
        result[name] = normalised(values, _LARGEST[kind]) if is_share and kind in _LARGEST else values
    return faces, result
