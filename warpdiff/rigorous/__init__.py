"""Rigorous order efficiencies of one-dimensional gratings, by the package meent (extra ``rigorous``)."""
