"""Cache of the last tables of each height field, which is deleted together with the height field.

Pictures with moving lights or cameras reuse the same tables. A search for a plan tries tables of a few sizes, which the
cache keeps for later calls. Keys are frozen dataclasses of everything on which a table depends, except the heights.
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

# Limits of the cache of a height field. `MOST_CACHED` is the largest number of tables of each kind (each attribute of
# :class:`TableCache`), except colour tables. `MOST_BYTES` is the largest total size of the colour tables [bytes].
# Memory is proportional to these numbers.
MOST_CACHED, MOST_BYTES = 4, 1e9
_caches: weakref.WeakKeyDictionary[HeightField, TableCache] = weakref.WeakKeyDictionary()


class TableCache:
    """Cached tables of one height field.

    Attributes:
        coefficients: Fourier coefficients on the host.
        fitted_to: Series of the coefficients to which the last basis functions were fitted. It is moved to
            ``coefficients`` or deleted when a caller requests coefficients as a series.
        rows: Rows of Fourier coefficients on devices, with their basis functions.
        sources: Descriptions of the power spectra for colour tables, without the samples of these spectra.
        spectra: Samples of the power spectrum that was computed last, from which tables for other illuminants and
            materials can be computed.
        colours: Colour tables. No two of them share an array, so that their sizes add up to the memory in use.
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
        """Return the cache of a height field; create it at the first call."""
        return _caches.setdefault(heightfield, cls())
