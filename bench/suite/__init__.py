"""Every chart of ``python -m bench``, with its numbers.

``runner`` makes them in one run. Its parts have ``measure``, ``numbers`` and ``chart``: ``previews``, ``pareto``,
``frames``, ``rays``, ``scaling``, ``stability``, ``validity``; what these share: ``scenes``, ``timing``, ``figures``.
"""
