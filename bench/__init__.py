"""Measurements of speed and accuracy, and what they are measured against.

- ``suite``: the charts of ``python -m bench``
- ``reproduce``: other figures, each ``python -m bench.reproduce.NAME``
- ``dev``: tools for checking changes, each ``python -m bench.dev.NAME``
- ``truth``: references that share no code with the kernels and serve the tests, too; random calls, and their judge
- ``peers``: other programs and baselines, beside ours
- ``inputs``: where real inputs are found
"""

import os

# Threads that spin between calls would take other methods' time.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
