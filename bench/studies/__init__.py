"""Questions asked once and again, each answered by ``python -m warpdiff.bench.studies.NAME``.

- ``crops``: pictures against their truth; ``picture_error``: against the reference; ``dolly``: flicker as the
  camera moves
- ``tolerance_sweep``: random calls against their tolerance; ``tight_plans``, ``plan_cost``: what plans leave and take
- ``published``, ``thesis``, ``variants``: the published algorithm and evaluation
- ``cold_start``, ``multiply_adds``: a new process; what the machine can do
- ``corpus``: whether a change leaves everything the same to the bit
"""
