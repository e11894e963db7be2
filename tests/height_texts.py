"""Texts of matrices of heights, as programs of instruments export them."""

import numpy as np


def table(values: np.ndarray, separator: str = " ", decimal: str = ".", gap: str = "NaN", form: str = "{:.4g}") -> str:
    """Return the text of a matrix of heights: one line per row. ``gap`` is the text of missing samples."""
    lines = [
        separator.join(gap if np.isnan(value) else form.format(value).replace(".", decimal) for value in row)
        for row in values
    ]
    return "\n".join(lines) + "\n"
