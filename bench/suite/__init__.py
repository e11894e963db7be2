"""Charts of ``python -m bench`` and their numbers.

``runner`` makes all charts in one run. One module measures and draws each chart, by its functions ``measure``,
``numbers`` and ``chart``: ``previews``, ``pareto``, ``frames``, ``rays``, ``scaling``, ``stability`` and ``validity``.
These modules share ``scenes``, ``timing`` and ``figures``.
"""
