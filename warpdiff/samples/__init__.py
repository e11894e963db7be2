"""Synthetic height fields and sample bodies, public as ``wd.gratings`` and ``wd.meshes``; no Warp.

In: periods, depths, sizes, random seeds.
Out: height fields and meshes.
"""
