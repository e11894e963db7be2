"""Measurements of speed and accuracy, and what they are measured against.

- ``suite``: ``warpdiff bench``. Its parts, each with ``measure``, ``numbers`` and ``chart``: ``previews``, ``pareto``,
  ``frames``, ``rays``, ``scaling``, ``stability``, ``validity``; what these share: ``scenes``, ``timing``, ``errors``,
  ``figures``, ``inputs``; the programs beside ours: ``peers``
- to run by themselves, ``python bench/NAME.py``: ``crops``, pictures against their truth, ``published``,
  ``tolerance_sweep``, ``tight_plans``, ``plan_cost``, ``picture_error``, ``cold_start``; ``corpus``, whether a change
  leaves everything the same to the bit; ``thesis``, the published
  evaluation, with its ``variants``
- references, which share no code with the kernels and serve the tests, too: ``reference`` (float64), ``brute_force``
  (rays), ``numpy_methods``
- ``configurations``, random calls, and ``judge``, which judges calls on directions that no plan has read
- baselines: ``numba_published``, the published algorithm; ``multiply_adds``, what the machine can do
"""

import os

# Threads that spin between calls would take other methods' time.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
