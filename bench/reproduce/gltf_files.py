"""Comparison of the reader of glTF files with an independent reading, on a folder of glTF files.

``python -m bench.reproduce.gltf_files FOLDER [--truth TRUTH.jsonl]`` prints a table for each subfolder, and the files
that are refused or differ. Test files are in the repositories KhronosGroup/glTF-Sample-Assets,
KhronosGroup/glTF-Blender-IO (tests), donmccurdy/glTF-Transform, CesiumGS/gltf-pipeline and vpenades/SharpGLTF.

The file of the independent reading has a JSON object per line, with sums over all triangles in world coordinates, for
example by glTF-Transform:

- ``path``, and ``ok`` (whether the other program reads the file)
- ``tri`` (number of triangles), ``pos`` (sum of their centres), ``area``, ``nrm`` (sum of unit normals)
- ``uv`` and ``uvtri``: sum of texture coordinates of the base colour after its texture transform, v downwards, and
  number of triangles that have such coordinates; ``uvraw`` and ``uvrawtri`` for TEXCOORD_0, ``col`` and ``coltri`` for
  COLOR_0
- ``mats``: number of triangles by ``name#index`` of the material, or ``default``

Sums over the corners of a triangle are divided by 3. Tolerances are relative to the size of each quantity.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.scene import mesh_files

if TYPE_CHECKING:
    from warpdiff.scene.scene_parts import ScenePart

# Largest accepted relative differences between the library and another program that reads the same glTF file: of
# positions, of texture coordinates, and of normals and colours. Positions are rounded to float32, and normals and
# colours may be quantised.
POSITION_TOLERANCE, UV_TOLERANCE, VECTOR_TOLERANCE = 1e-3, 2e-3, 4e-3


def sums_of(parts: list[ScenePart]) -> dict[str, Any]:
    """Return sums over the triangles of a scene that the library reads, as another program computes them for it."""
    result: dict[str, Any] = {"tri": 0, "area": 0.0, "uvtri": 0, "uvrawtri": 0, "coltri": 0, "mats": Counter()}
    for name, width in (("pos", 3), ("uv", 2), ("uvraw", 2), ("col", 3), ("nrm", 3)):
        result[name] = np.zeros(width)
    for part in (part.placed() for part in parts):
        faces, count = part.faces, len(part.faces)
        corners = part.vertices[faces]
        result["tri"] += count
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        result["area"] += 0.5 * float(np.linalg.norm(cross, axis=1).sum())
        result["pos"] += corners.mean(axis=1).sum(axis=0)
        result["mats"]["default" if part.appearance is None else part.appearance.name] += count
        normals = part.normals / np.maximum(np.linalg.norm(part.normals, axis=1, keepdims=True), 1e-300)
        result["nrm"] += normals[faces].mean(axis=1).sum(axis=0)
        texture = None if part.appearance is None else part.appearance.base_texture
        for name, number, transform in (
            ("uvraw", 0, np.eye(2, 3)),
            ("uv", -1 if texture is None else texture.uv_set, np.eye(2, 3) if texture is None else texture.transform),
        ):
            if number in part.uvs:
                uvs = part.uvs[number] @ transform[:, :2].T + transform[:, 2]
                mean = uvs[faces].mean(axis=1).sum(axis=0)
                result[name] += (mean[0], count - mean[1])
                result[f"{name}tri"] += count
        if part.colours is not None:
            result["col"] += part.colours[faces, :3].mean(axis=1).sum(axis=0)
            result["coltri"] += count
    return result


def compared(sums: dict[str, Any], truth: dict[str, Any]) -> dict[str, bool]:
    """Return, for each sum over a scene's triangles, whether the library and the other program agree.

    Sums of quantities that the glTF file does not have, such as colours, are absent.
    """
    count = truth["tri"]

    def close(name: str, size: float, tolerance: float) -> bool:
        difference = np.abs(sums[name] - np.array(truth[name], dtype=float))
        return bool(sums["tri"] == count and np.all(difference <= tolerance * size * count))

    mean = np.abs(np.array(truth["pos"], dtype=float)).max() / count
    size = max(np.sqrt(max(truth["area"], 1e-12) / count), mean)
    is_area_right = abs(sums["area"] - truth["area"]) <= 2.0 * POSITION_TOLERANCE * truth["area"] + 1e-12
    result = {"triangles": sums["tri"] == count, "positions": close("pos", size, POSITION_TOLERANCE) and is_area_right}
    for label, name in (("base UV", "uv"), ("TEXCOORD_0", "uvraw")):
        if truth[f"{name}tri"]:
            size = 1.0 + np.abs(truth[name]).max() / count
            result[label] = sums[f"{name}tri"] == truth[f"{name}tri"] and close(name, size, UV_TOLERANCE)
    if truth["coltri"]:
        result["colours"] = sums["coltri"] == truth["coltri"] and close("col", 1.0, VECTOR_TOLERANCE)
    result["normals"] = close("nrm", 1.0, VECTOR_TOLERANCE)
    result["materials"] = sorted(sums["mats"].values()) == sorted(number for number in truth["mats"].values() if number)
    result["all"] = all(result.values())
    return result


def main() -> None:
    """Print how many files of each subfolder are read correctly, and which files are not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--truth", type=Path, help="file of independent readings, a JSON object per line")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    truths = {}
    if options.truth is not None:
        entries = map(json.loads, options.truth.read_text().splitlines())
        truths = {str(Path(entry["path"])): entry for entry in entries}
    tables: dict[str, Counter[str]] = {}
    totals: dict[str, Counter[str]] = {}
    for path in sorted(path for path in options.folder.rglob("*") if path.suffix.lower() in (".gltf", ".glb")):
        group = path.relative_to(options.folder).parts[0]
        right, total = tables.setdefault(group, Counter()), totals.setdefault(group, Counter())
        truth = truths.get(str(path))
        if truth is not None and not (truth["ok"] and truth["tri"] and truth["area"]):
            truth = None
        judged = truths == {} or truth is not None
        total["files" if judged else "without truth"] += 1
        try:
            sums = sums_of(mesh_files.load(path))
        except (ValueError, MemoryError) as error:
            print(f"{'REFUSED' if judged else 'refused'} {path}: {str(error).replace(str(path), '')[:150]}")
            continue
        right["opens" if judged else "opens, without truth"] += 1
        if truth is None:
            continue
        verdicts = compared(sums, truth)
        for name, is_right in verdicts.items():
            total[name] += 1
            right[name] += is_right
        if not verdicts["all"]:
            print(f"DIFFERS {path}: {', '.join(name for name, is_right in verdicts.items() if not is_right)}")
    for group, total in totals.items():
        right = tables[group]
        shown = ", ".join(f"{name} {right[name]}/{count}" for name, count in total.items() if name in right)
        extra = f"; {total['without truth']} without truth, {right['opens, without truth']} of these open"
        print(
            f"{group}: {total['files']} files: opens {right['opens']}, {shown}{extra if total['without truth'] else ''}"
        )


if __name__ == "__main__":
    main()
