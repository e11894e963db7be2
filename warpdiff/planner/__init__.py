"""Planner: selects the numbers of a computation (a plan) from a tolerance, by upper bounds or by a search.

A call is one call of a public function, such as ``wd.reflectance``, with all its directions.

In: a height field, a tolerance, the range of the directions of a call, and a sample of these directions.
Out: a ``Plan`` that meets the tolerance, or a ``ToleranceError`` that names a remedy.
"""
