"""Settings of the public functions, plans, and ranges of directions.

In: keyword arguments, directions of a call.
Out: checked settings, a ``Plan``, a ``DirectionRange`` and samples of directions.
"""
