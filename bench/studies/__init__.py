"""Questions asked once and again, each answered by ``python -m bench.studies.NAME``.

- ``crops``: pictures against their truth; ``picture_error``: against the reference; ``dolly``: flicker as the
  camera moves
- ``tolerance_sweep``: random calls against their tolerance; ``tight_plans``, ``plan_cost``: what plans leave and take
- ``published``, ``thesis``, ``variants``: the published algorithm and evaluation
- ``materials``, ``energy``: metals and sums over orders against rigorous solvers and closed forms
- ``lights``: lights of a size and environments against many directions, and what they take
- ``display``: variants of the display transform, and what it does to narrow bands of light
- ``path_traced``: baked lobes in Mitsuba beside ``shade``
- ``viewer``: pictures a second while dragging, and how soon finer ones come, in a real browser
- ``frames_on_paper``: the parts of what a long sequence takes
- ``cold_start``, ``multiply_adds``: a new process; what the machine can do
- ``corpus``: whether a change leaves everything the same to the bit
- ``soak``, ``sanitize``: what may go wrong, for an hour; native functions under sanitizers
"""
