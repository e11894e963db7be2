"""From a tolerance to a plan: by bounds, and by trying what is cheaper on some of the directions.

In: a height field, a tolerance, a range and a sample of directions.
Out: a ``Plan`` that keeps the tolerance, or a refusal with its remedy.
"""
