"""Charts of ``python -m bench`` and their numbers.

``runner`` makes all of them in one run. The parts have ``measure``, ``numbers`` and ``chart``: ``previews``,
``pareto``, ``frames``, ``rays``, ``scaling``, ``stability``, ``validity``. They share ``scenes``, ``timing`` and
``figures``.
"""
