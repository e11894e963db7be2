"""Light sources: directional lights, discs, point lights and environments, and the lobes that stand for them.

In: directions, positions, spectra, latitude-longitude images.
Out: lobes and sky maps for the kernels.
"""
