"""Reference of textures for tests: continuation outside of the image, and bilinear interpolation."""

import numpy as np


def continued(index, size, wrap):
    """Return the index of the texel that replaces an index beyond the image, by the wrap mode of the texture."""
    if wrap == "repeat":
        return index % size
    if wrap == "clamp":
        return np.clip(index, 0, size - 1)
    return np.where(index // size % 2 == 0, index % size, size - 1 - index % size)


def bilinear(texels, wrap, u, v):
    """Return colours of a texture by bilinear interpolation; row 0 is at v = 1."""
    height, width = texels.shape[:2]
    if wrap[0] == "clamp":
        u = np.clip(u, 0.0, 1.0)
    if wrap[1] == "clamp":
        v = np.clip(v, 0.0, 1.0)
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    right, down = (x - column)[..., None], (y - row)[..., None]

    def at(rows, columns):
        return texels[continued(rows, height, wrap[1]), continued(columns, width, wrap[0])]

    upper = (1.0 - right) * at(row, column) + right * at(row, column + 1)
    lower = (1.0 - right) * at(row + 1, column) + right * at(row + 1, column + 1)
    return (1.0 - down) * upper + down * lower
