"""Cache of the tables of one height field, while it lives: the last ones that were asked for.

Moving lights and views ask for the same tables again, and a search for tables of a few sizes. Keys are values, frozen
dataclasses of all that a table depends on besides the heights.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

from warpdiff.core.caching import LruCache

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.diffraction.coefficient_basis import Coefficients
    from warpdiff.heightfield.field import HeightField
    from warpdiff.tables.colour_table import ColourTable
    from warpdiff.tables.spectrum_source import SpectrumSource

# Limits: number of sets of coefficients, of their copies on devices and of sources; bytes of all colour tables, some
# for other lights and views, or a search's last attempts.
MOST_CACHED, MOST_BYTES = 4, 1e9
_caches: weakref.WeakKeyDictionary[HeightField, TableCache] = weakref.WeakKeyDictionary()


class TableCache:
    """Tables of one height field.

    Attributes:
        coefficients: Coefficients on the host.
        fitted_to: The series that the last basis was fitted to, until another series is asked for.
        rows: Rows and basis of coefficients on devices.
        sources: Sources of colour tables, before their spectra are sampled.
        spectra: Samples of the last spectrum, which serves other illuminants and materials.
        colours: Colour tables; no two of them share an array, so that the cache counts each array once.
    """

    def __init__(self) -> None:
        self.coefficients: LruCache[Coefficients] = LruCache(MOST_CACHED)
        self.fitted_to: LruCache[Coefficients] = LruCache(1)
        self.rows: LruCache[tuple[wp.array, wp.array]] = LruCache(MOST_CACHED)
        self.sources: LruCache[SpectrumSource] = LruCache(MOST_CACHED)
        self.spectra: LruCache[Any] = LruCache(1)
        self.colours: LruCache[ColourTable] = LruCache(most_bytes=MOST_BYTES, bytes_of=lambda table: table.nbytes)

    @classmethod
    def of(cls, heightfield: HeightField) -> TableCache:
        """The cache of a height field."""
        return _caches.setdefault(heightfield, cls())
