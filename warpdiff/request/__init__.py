"""Settings of the public functions, plans of computations, and ranges of directions.

In: keyword arguments and directions of a call.
Out: checked settings, a ``Plan``, a ``DirectionRange`` and samples of directions.
"""
