"""Planner: converts a tolerance to a plan by upper bounds, and by a search on sampled directions.

In: a height field, a tolerance, a range and a sample of directions.
Out: a ``Plan`` that meets the tolerance, or a ``ToleranceError`` with its remedy.
"""
