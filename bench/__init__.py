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

# Other programs use threads of OpenMP. These threads sleep between calls. Threads that wait actively would slow down
# the methods that are timed next.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
