"""Benchmarks: measurements of speed and accuracy, their references, and other programs.

- ``suite``: the charts of ``python -m bench``
- ``reproduce``: other figures, each ``python -m bench.reproduce.NAME``
- ``dev``: tools for checking changes, each ``python -m bench.dev.NAME``
- ``truth``: references that share no code with the kernels and serve the tests, too; random calls and their errors
- ``peers``: other programs and baselines for comparison
- ``inputs``: folder of the real inputs
"""

import os

# OpenMP threads sleep between calls. Threads that wait actively would slow down the other methods.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
