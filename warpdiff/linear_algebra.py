"""NumPy's linear algebra on one thread.

Its library's other threads wait for a next call by spinning: beside kernels that compile, or slices that are rendered,
they only take a core. And sums over fewer or more threads need not be the same to the bit.
"""

from __future__ import annotations

import functools
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def on_one_thread() -> Iterator[None]:
    """What is done within takes one thread of the library."""
    with _libraries().limit(limits=1):
        yield


@functools.cache
def _libraries() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
