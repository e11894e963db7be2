"""The plan as numbers, and the range of directions that it holds for; no Warp.

In: directions of a call, numbers that a planner chose.
Out: a ``Plan``, a ``DirectionRange`` and samples of directions.
"""
