"""Charts of ``python -m bench`` and their numbers.

``runner`` makes all charts in one run. Each chart has a module, whose functions ``measure``, ``numbers`` and ``chart``
measure and draw it: ``previews``, ``pareto``, ``frames``, ``rays``, ``scaling``, ``stability`` and ``validity``. These
modules share ``scenes``, ``timing`` and ``figures``. ``stability_regimes`` computes the errors of ``stability``.
"""
