"""Published measurements that are downloaded on demand, public as ``wd.datasets``.

In: the name of a data set.
Out: a ``HeightField`` as measured. The folder in the environment variable ``WARPDIFF_DATA`` is searched before a
download. The package does not import Warp, the library for GPU kernels.

Examples:
    >>> import warpdiff as wd
    >>> wd.datasets.info("corn_snake_scan").extent_um
    65.0
"""

from warpdiff.datasets.download import fetch
from warpdiff.datasets.registry import Dataset, info

__all__ = ["Dataset", "fetch", "info"]
