"""The published algorithm in Numba, ``numba_published``, with the interface of a peer."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from bench.peers import numba_published, series

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    import warpdiff as wd

DEFAULT_UM = 16.25
PUBLISHED = series.PUBLISHED
# Its squares begin at 3 × 3.
SETTINGS = [setting for setting in series.SETTINGS if setting["neighbour_extent"] > 0]


@functools.lru_cache(maxsize=4)
def _tables(heightfield: wd.HeightField, terms: int, *, centred: bool) -> numba_published.Tables:
    """Tables of all settings with this number of terms."""
    return numba_published.tables(heightfield, terms=terms, centred=centred, frequency=series.FREQUENCY)


def available() -> str | None:
    """None: importing this module requires Numba."""
    return None


def prepare(heightfield: wd.HeightField, coherence: wd.Coherence, **setting: Any) -> Callable[..., NDArray[np.float32]]:
    """Return a function that shades directions: ``shade(scattering_vectors, gains, threads)`` to XYZ (n, 3)."""
    if coherence.sigma_um != DEFAULT_UM:
        raise ValueError(f"coherence must have the default window, σ = {DEFAULT_UM} µm, got {coherence}")
    options = dict(setting)
    tables = _tables(heightfield, options.pop("terms"), centred=options.pop("centred"))
    powers = coherence.kind == "averaged"

    def shade(scattering_vectors: NDArray[np.float64], gains: NDArray[np.float64], threads: int) -> NDArray[np.float32]:
        numba.set_num_threads(threads)
        return numba_published.shade(tables, scattering_vectors, gains, powers=powers, **options)

    # Refuses what it cannot do before anything is timed.
    shade(np.zeros((1, 3)), np.ones(1), 1)
    return shade
