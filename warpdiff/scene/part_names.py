"""Parts of a mesh by name: keys such as ``"gold"``, ``"lid/silver"`` and ``"*"`` select faces.

A part has the faces of one geometry with one material. A key is the name of a geometry, the name of a material, both
names as ``geometry/material``, or ``"*"`` for all parts that no other key names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from warpdiff.core.wording import ArgumentValueError, did_you_mean, listed, ref

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray


REST = "*"


class _Part(NamedTuple):
    """Names of the geometry and of the material of a part of a mesh."""

    geometry: str
    material: str

    def __str__(self) -> str:
        return "/".join(filter(None, self)) or "the whole mesh"

    def precedence(self, key: str) -> int | None:
        """Return the precedence with which a key (a name or ``"*"``) selects this part; None if it does not select it.

        The highest precedence is 0.
        """
        matches = key == str(self), key in self, key == REST
        return matches.index(True) if any(matches) else None


class NamedFaces(Protocol):
    """Mesh whose faces belong to named geometries and named materials."""

    @property
    def geometries(self) -> NDArray[np.int32]:
        """For each face, the index of its geometry in ``geometry_names``."""

    @property
    def geometry_names(self) -> tuple[str, ...]:
        """Names of the geometries, which all differ."""

    @property
    def materials(self) -> NDArray[np.int32]:
        """For each face, the index of its material in ``material_names``; −1 without one."""

    @property
    def material_names(self) -> tuple[str, ...]:
        """Names of the materials, which all differ."""


def key_of_faces(surface: NamedFaces, keys: Sequence[str], argument: str) -> NDArray[np.int32]:
    """Return for each face the index of the key (name of a part of the mesh) that selects the face.

    A key ``geometry/material`` takes precedence over the name of a geometry or of a material. Both take precedence over
    ``"*"``.

    Args:
        surface: The mesh.
        keys: Names that select parts of the mesh; all differ.
        argument: Name of the argument that contains the keys, for messages.

    Returns:
        Shape (m,) for m faces.

    Raises:
        ValueError: A key selects no part, or is the name of a geometry and also of a material of faces of another
            geometry; a part has no key, or two keys of the same precedence.
    """
    pairs = np.stack([surface.geometries, surface.materials])
    numbers, part_of_faces = np.unique(pairs, axis=1, return_inverse=True)
    materials = (*surface.material_names, "")  # the index −1 of a face without a material selects the last name
    parts = [_Part(surface.geometry_names[geometry], materials[material]) for geometry, material in numbers.T]
    for key in keys:
        _check_key(key, parts, argument)
    key_of_parts = [_key_of(part, keys, argument) for part in parts]
    if missing := [part for part, key in zip(parts, key_of_parts, strict=True) if key is None]:
        raise ArgumentValueError(
            f"{ref(argument)} must have a surface for each part of the mesh, got none for {_listed(missing)}: add "
            f"{REST!r} for all other parts; None makes them plain"
        )
    return np.array(key_of_parts, dtype=np.int32)[part_of_faces.ravel()]


def _check_key(key: str, parts: Sequence[_Part], argument: str) -> None:
    """Raise an error if a key selects no part of the mesh, or is the name of both a geometry and a material."""
    selected = [part for part in parts if part.precedence(key) is not None]
    if not selected and key != REST:
        names = [name for part in parts for name in (*part, str(part)) if name]
        raise ArgumentValueError(
            f"{ref(argument)} must have names of parts of the mesh as keys, which are {_listed(parts)}, got {key!r}"
            f"{did_you_mean(key, names)}"
        )
    by_geometry, by_material = ([part for part in selected if part[place] == key] for place in (0, 1))
    if by_geometry and by_material and by_geometry != by_material and key not in map(str, parts):
        raise ArgumentValueError(
            f"{ref(argument)} must have unique names as keys, got {key!r}, the name of a geometry "
            f"({_listed(by_geometry)}) and of a material ({_listed(by_material)}): give keys geometry/material"
        )


def _key_of(part: _Part, keys: Sequence[str], argument: str) -> int | None:
    """Return the index of the key that selects a part of the mesh; None if no key selects it."""
    ranked = sorted((rank, index) for index, key in enumerate(keys) if (rank := part.precedence(key)) is not None)
    if len(ranked) > 1 and ranked[0][0] == ranked[1][0]:
        raise ArgumentValueError(
            f"{ref(argument)} must have one surface for each part of the mesh, got the keys {keys[ranked[0][1]]!r} and "
            f"{keys[ranked[1][1]]!r} for '{part}': add the key '{part}'"
        )
    return ranked[0][1] if ranked else None


def _listed(parts: Iterable[_Part]) -> str:
    """Return the names of mesh parts for a message."""
    return listed([f"'{part}'" for part in parts])
