"""Contrast of pixels to their neighbours: estimated errors of pixels with one ray each, and marks of pixels to
subdivide.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import itertools

import numpy as np
import pytest
import warp as wp
from conftest import launch

from warpdiff.kernels import pixel_contrast, refinement_levels

# Weight of the pixel filter at a diagonal neighbour, relative to the weight at a horizontal or vertical neighbour.
ASLANT = refinement_levels.FILTER_SHARES[0] / refinement_levels.FILTER_SHARES[1]


def texture_contrast(base, colours, hit, near, place):
    """Return the part of a pixel's contrast (colour difference to its neighbours) that the base colour causes.

    The part is the norm of the pixel's own colour times the largest relative change of the base colour to a neighbour.
    """
    if sum(hit[other] for other in near) < 2:
        return 0.0
    change = max(np.linalg.norm(base[other] - base[place]) for other in near if hit[other])
    return np.linalg.norm(colours[place]) * change / np.linalg.norm(base[place])


def map_contrast(maps, colours, hit, near, own):
    """Return the part of a pixel's contrast that textures cause by changes of metallic, roughness and emission."""
    metallic, roughness, emission = maps
    changes = [
        4.0 * abs(roughness[place] - roughness[own]) / max(roughness[own], 0.05)
        + abs(metallic[place] - metallic[own])
        + np.linalg.norm(emission[place] - emission[own]) / np.linalg.norm(emission[own])
        for place in near
        if hit[place]
    ]
    return max(changes) * np.linalg.norm(colours[own])


def estimate_by_hand(colours, uv, hit, floor, bound, base=None, maps=None):
    """Compute the result of the kernel ``estimate_errors`` in Python, pixel by pixel."""
    height, width = hit.shape
    result, marks, size = np.zeros((height, width)), np.zeros((height, width), bool), np.linalg.norm
    for row, column in np.ndindex(height, width):
        near = [(y, x) for y in range(row - 1, row + 2) for x in range(column - 1, column + 2)]
        near = [(y, x) for y, x in near if 0 <= y < height and 0 <= x < width]
        hits = [hit[place] for place in near]
        rim = any(hits) and not all(hits)
        if hit[row, column]:
            steps = [(abs(y - row) + abs(x - column), size(colours[y, x] - colours[row, column])) for y, x in near
                     if hit[y, x]]  # fmt: skip
            contrast = max([step if away == 1 else ASLANT * step for away, step in steps])
            if all(away != 1 for away, _ in steps):
                # If the rays of the neighbours to the left, right, top and bottom all miss the mesh, the pixel has no
                # contrast, and its own colour is used instead.
                contrast = size(colours[row, column])
            share = 1.0
            if len(near) == 9 and all(hits):
                d = uv[row - 1 : row + 2, column - 1 : column + 2] - uv[row, column]
                along, down = max(size(d[1, 0]), size(d[1, 2])), max(size(d[0, 1]), size(d[2, 1]))
                corners = [size(d[i, j] - d[i, 1] - d[1, j]) for i in (0, 2) for j in (0, 2)]
                uneven = max(
                    size(d[1, 0] + d[1, 2]) / along, size(d[0, 1] + d[2, 1]) / down, max(corners) / max(along, down)
                )
                wide = max(along, down) / max(size(uv[row, column]), 1e-3)
                share = (
                    refinement_levels.CONTRAST_BASE
                    + refinement_levels.CONTRAST_PER_UNEVENNESS * uneven
                    + refinement_levels.CONTRAST_PER_CHANGE * wide
                )
            result[row, column] = min(share, 1.0) * contrast
            if base is not None or maps is not None:
                explained = 0.0 if base is None else texture_contrast(base, colours, hit, near, (row, column))
                explained += 0.0 if maps is None else map_contrast(maps, colours, hit, near, (row, column))
                explained = min(contrast, explained)
                result[row, column] = max(result[row, column], refinement_levels.CONTRAST_OF_TEXTURE * explained)
        limit = bound * max(size(colours[row, column]) if hit[row, column] else 0.0, floor)
        marks[row, column] = any(hits) and (rim or result[row, column] > limit)
    return result, marks


@pytest.mark.parametrize("size", [(1, 1), (1, 70), (41, 1), (3, 5), (20, 33), (9, 100)], ids=str)
@pytest.mark.parametrize("slices", [1, 6])
@pytest.mark.parametrize("textures", ["", "base colour", "maps", "base colour and maps"])
def test_errors_are_estimated_from_neighbouring_pixels(size, slices, textures, rng):
    is_textured, has_maps = "base" in textures, "maps" in textures
    colours = rng.lognormal(0.0, 1.0, (*size, 3)).astype(np.float32)
    # The kernel estimates the error of a pixel differently at the rim of the mesh and where (u, v) changes irregularly
    # between pixels. This picture has both: every sixth row of pixels misses the mesh, and (u, v) is noisy.
    hit = (rng.uniform(size=size) < 0.9) & (np.arange(size[0]) % 6 != 3)[:, None]
    y, x = np.mgrid[: size[0], : size[1]]
    uv = np.stack([0.3 + 0.01 * x + 0.002 * y, 0.02 * y], axis=-1)
    uv += rng.choice([0.0, 1e-4, 1e-3], (*size, 1), p=[0.9, 0.07, 0.03])
    scattering_vectors = np.concatenate([uv, np.zeros((*size, 1))], axis=-1)
    base = rng.uniform(0.1, 1.0, (*size, 3)).astype(np.float32)
    gloss = rng.choice([0.5, 0.51, 0.02], (*size, 4), p=[0.8, 0.15, 0.05]).astype(np.float32)
    emission = rng.choice([0.5, 0.52], (*size, 3)).astype(np.float32)
    maps = (gloss[..., 0], gloss[..., 1], emission)
    given = [
        wp.array(colours.reshape(-1, 3), dtype=wp.vec3f, device="cpu"),
        wp.array(scattering_vectors.reshape(-1, 3), dtype=wp.vec3d, device="cpu"),
        wp.array(hit.ravel(), dtype=wp.int32, device="cpu"),
        wp.array(base.reshape(-1, 3) if is_textured else np.zeros((0, 3)), dtype=wp.vec3f, device="cpu"),
        wp.array(gloss.reshape(-1, 4) if has_maps else np.zeros((0, 4)), dtype=wp.vec4f, device="cpu"),
        wp.array(emission.reshape(-1, 3) if has_maps else np.zeros((0, 3)), dtype=wp.vec3f, device="cpu"),
        size[1], wp.array([0.8], dtype=wp.float32, device="cpu"),
        0.3, False, True,
    ]  # fmt: skip
    result = wp.full(hit.size, 7.0, dtype=wp.float32, device="cpu")
    wanted = wp.full(hit.size, 7, dtype=wp.uint8, device="cpu")
    for begin, end in itertools.pairwise(np.linspace(0, hit.size, slices + 1).astype(int)):
        inputs = [*given, int(begin), int(end - begin)]
        launch(pixel_contrast.estimate_errors, (1, 1), inputs, [result, wanted], device="cpu")
    expected, is_wanted = estimate_by_hand(
        colours, uv, hit, 0.8, 0.3, base if is_textured else None, maps if has_maps else None
    )
    np.testing.assert_allclose(result.numpy().reshape(size), expected, rtol=2e-3, atol=1e-6)
    near = np.abs(expected - 0.3 * np.maximum(np.linalg.norm(colours, axis=2), 0.8)) < 1e-3
    np.testing.assert_array_equal(wanted.numpy().reshape(size)[~near], is_wanted[~near])
