"""Charts of ``python -m bench`` and their numbers.

``runner`` makes all charts in one run. Each part has the functions ``measure``, ``numbers`` and ``chart``. The parts
are ``previews``, ``pareto``, ``frames``, ``rays``, ``scaling``, ``stability`` and ``validity``. They share ``scenes``,
``timing`` and ``figures``.
"""
