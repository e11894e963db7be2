"""Synthetic height fields and sample bodies, public as ``wd.gratings`` and ``wd.meshes``, which do not import Warp.

In: periods, depths, sizes, random seeds.
Out: height fields and meshes.
"""
