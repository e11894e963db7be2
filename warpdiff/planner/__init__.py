"""Planner: converts the tolerance of a call to a plan, by upper bounds or by a search on sampled directions.

In: a height field, a tolerance, a range of directions and a sample of these directions.
Out: a ``Plan`` that meets the tolerance, or a ``ToleranceError`` that names a remedy.
"""
