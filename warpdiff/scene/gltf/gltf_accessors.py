"""Accessors of a glTF file: arrays of numbers in its buffers, checked before anything is allocated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import memory
from warpdiff.scene.gltf.gltf_values import Element, refuse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.gltf.gltf_buffers import Container

# NumPy types of the components of glTF arrays, by the number of the component type in the file.
_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
# Number of components of an array element, by the name of its type in the file. Vertices, indices and instances of
# meshes use only these types.
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
# Size of a number in the arrays that this module returns [bytes]. The numbers are float64 or int64.
_BYTES_PER_NUMBER = 8


def normalised(values: NDArray[Any], largest: float) -> NDArray[np.float64]:
    """Return integers divided by the largest integer of their type, as floats from −1 to 1."""
    return np.asarray(np.maximum(values.astype(np.float64) / largest, -1.0))


class Accessors:
    """Accessors of a glTF file, which describe the arrays in its buffers."""

    def __init__(self, container: Container) -> None:
        """Store the container of a glTF file. Arrays are read from it later."""
        self._container = container
        self._elements = container.root.elements("accessors")

    def __len__(self) -> int:
        return len(self._elements)

    def count(self, index: int, bytes_each: float) -> int:
        """Return the number of elements of an accessor, after a check that they fit into its buffer or free memory.

        Args:
            index: Index of the accessor.
            bytes_each: Memory that each element requires later [bytes]. It is used only if the accessor has no data in
                the file that confirm the number.
        """
        accessor = self._elements[index]
        count = accessor.integer("count", least=1)
        if "bufferView" in accessor:
            self._rows(accessor, count, _dtype(accessor), _WIDTHS.get(accessor.text("type"), 1))
        elif (needed := bytes_each * count) > memory.available():
            # The accessor has no data in the file that would confirm the number of elements, so that the number is
            # probably damaged. The error therefore does not say that the mesh is too large.
            accessor.refuse("count", f"must fit into memory, got {count}, which require {needed / 1e9:.2g} GB")
        return count

    def is_normalised(self, index: int) -> bool:
        """Return whether an accessor's integers stand for fractions of the largest integer of their type."""
        return self._elements[index].flag("normalized", default=False)

    def place(self, index: int) -> str:
        """Return the place of an accessor in the file, for messages."""
        return self._elements[index].place

    def vectors(self, index: int, widths: Sequence[int], *, normalise: bool = False) -> NDArray[np.float64]:
        """Return the vectors of an accessor, shape (n, k).

        Args:
            index: Index of the accessor.
            widths: Accepted numbers of components.
            normalise: Whether integers are always divided by the largest integer of their type.
        """
        values = self._read(index, widths)
        if values.dtype.kind != "f" and (normalise or self.is_normalised(index)):
            return normalised(values, float(np.iinfo(values.dtype).max))
        return values.astype(np.float64)

    def indices(self, index: int) -> NDArray[np.int64]:
        """Return the vertex indices of an accessor, shape (n,)."""
        values = self._read(index, (1,))
        if values.dtype.kind != "u":
            self._elements[index].refuse("componentType", "must be an unsigned integer for indices of vertices")
        return values[:, 0].astype(np.int64)

    def _read(self, index: int, widths: Sequence[int]) -> NDArray[Any]:
        """Return the numbers of an accessor in the type that they have in the file, shape (n, k)."""
        accessor = self._elements[index]
        dtype = _dtype(accessor)
        kind = accessor.text("type")
        width = _WIDTHS.get(kind, 0)
        if width not in widths:
            names = " or ".join(name for name, number in _WIDTHS.items() if number in widths)
            accessor.refuse("type", f"must be {names}, got {kind[:20]!r}")
        bytes_each = width * (dtype.itemsize + _BYTES_PER_NUMBER)
        count = self.count(index, bytes_each)
        values = self._rows(accessor, count, dtype, width) if "bufferView" in accessor else None
        needed = float(count * bytes_each)
        memory.require_memory(needed, f"the accessor {accessor.place} of {count} elements", "use a smaller mesh")
        sparse = accessor.element("sparse")
        if sparse is None:
            return np.zeros((count, width), dtype) if values is None else values
        result = np.zeros((count, width), dtype) if values is None else values.copy()
        number = sparse.integer("count", least=1, most=count)
        places = sparse.stated_element("indices")
        rows = self._rows(places, number, _dtype(places), 1)[:, 0]
        if rows.dtype.kind != "u" or rows.max() >= count:
            places.refuse("bufferView", f"must have indices from 0 to {count - 1}, got {rows.max()}")
        result[rows] = self._rows(sparse.stated_element("values"), number, dtype, width)
        return result

    def _rows(self, element: Element, count: int, dtype: np.dtype[Any], width: int) -> NDArray[Any]:
        """Return the numbers of an accessor as a view of its buffer, shape (count, width), without a copy."""
        view = element.integer("bufferView", most=len(self._container.views) - 1)
        data = self._container.view(view)
        size = dtype.itemsize * width
        offset = element.integer("byteOffset", 0)
        # In glTF, the buffer view states the stride (distance of neighbouring elements in bytes). Only buffer views of
        # vertex attributes have a stride.
        stride = self._container.stride(view) or size
        if stride < size:
            refuse(f"bufferViews[{view}].byteStride", f"must be at least {size}, got {stride}")
        end = offset + stride * (count - 1) + size
        if end > len(data):
            place = f"{element.place} of {count} elements ends at byte {end} of bufferViews[{view}]"
            refuse(place, f"and must end within its {len(data)} bytes")
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))


def _dtype(element: Element) -> np.dtype[Any]:
    """Return the type of the components of an accessor."""
    kind = element.integer("componentType")
    if kind not in _DTYPES:
        element.refuse("componentType", f"must be one of {', '.join(map(str, _DTYPES))}, got {kind}")
    return np.dtype(_DTYPES[kind])
