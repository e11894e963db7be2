"""Malformed mesh files of every format are rendered, or refused by one error with their path."""

import os
import re
import warnings
from pathlib import Path

import endurance
import numpy as np
import pytest
from fuzz_objects import HEIGHTFIELD, LIGHT, VIEW, malformed_meshes, plan

import warpdiff as wd
from warpdiff.scene import mesh_files

FORMATS = ("obj", "ply", "stl", "glb", "off", "gltf")
MESHES = list(malformed_meshes())
# Folder of additional mesh files outside of this repository, such as those of a mesh library.
MODELS = os.environ.get("WARPDIFF_MODELS")


def render(path, **options):
    """Render a small picture of a mesh file. Return the error message if the file is refused, or an empty text."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Ignore the package's own warnings, such as one about a missing texture.
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        try:
            image = wd.shade(path, HEIGHTFIELD, LIGHT, VIEW, plan=plan(), threads=1, **options)
        except ValueError as error:
            message = str(error)
        else:
            message = ""
            assert np.isfinite(image.xyz).all()
    assert not message or (str(path) in message and re.search(r"\bmesh\b", message) and "\n" not in message), message
    return message


def tangents_for(path, rng):
    """Return random tangents for a mesh file without texture coordinates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return rng.normal(size=(sum(part.source_count for part in mesh_files.load(path)), 3))


@pytest.mark.permanent("malformed mesh files of every format")
@pytest.mark.parametrize("suffix", FORMATS)
def test_malformed_meshes_are_rendered_or_refused(suffix, tries, tmp_path):
    for index, mesh in enumerate(tries.of(MESHES)):
        path = tmp_path / f"mesh{index}.{suffix}"
        try:
            with np.errstate(all="ignore"):
                mesh.export(path)
        except Exception:
            tries.number -= 1
            continue
        render(path)
    # More than half of the meshes must have been written and tried. A soak test (a run of a given duration) is not
    # checked, because a short one may end before it has tried so many.
    assert endurance.IS_SOAK or tries.number > len(MESHES) // 2


@pytest.mark.permanent("malformed mesh files of every format")
@pytest.mark.skipif(not MODELS, reason="WARPDIFF_MODELS is not set to a folder of mesh files")
def test_additional_mesh_files_are_rendered_or_refused(tries, rng):
    # Files that are not meshes must be refused by an error with their path, too.
    for path in tries.of(path for path in sorted(Path(MODELS).rglob("*")) if path.is_file()):
        if "texture coordinates" in render(path):
            render(path, tangents=tangents_for(path, rng))
