"""Benchmarks: measurements of speed and accuracy, reference results, and other programs for comparison.

- ``suite``: the charts of ``python -m bench``
- ``reproduce``: other figures, each ``python -m bench.reproduce.NAME``
- ``dev``: tools for checking changes, each ``python -m bench.dev.NAME``
- ``truth``: reference results by code that is independent of the Warp kernels, also used by the tests; random calls of
  the library and their errors
- ``peers``: other programs and baselines for comparison
- ``inputs``: location of the measured height fields
"""

import os

# Some of the compared programs use OpenMP threads. With this setting, idle OpenMP threads sleep. Otherwise they would
# wait actively on the cores, and slow down the method that is timed next.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
