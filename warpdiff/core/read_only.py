"""``ReadOnlyArrays``: base of classes whose arrays stay read-only in copies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class ReadOnlyArrays:
    """Base of classes whose attributes are read-only arrays, or tuples and dictionaries of such arrays.

    ``pickle`` and ``copy.deepcopy`` of NumPy make writable copies. Objects also store numbers that were computed from
    their arrays. An edit of a writable copy would change the arrays but not these numbers, so that results would be
    inconsistent.
    """

    def __setstate__(self, state: Mapping[str, object]) -> None:
        """Set the attributes of a copy, and make their arrays read-only."""
        vars(self).update(state)
        for value in state.values():
            parts: Iterable[object] = (
                value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else (value,)
            )
            for part in parts:
                if isinstance(part, np.ndarray):
                    part.setflags(write=False)
