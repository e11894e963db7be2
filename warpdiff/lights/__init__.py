"""Light sources: directional lights, disc lights, point lights and environments, with the passes that sample them.

In: directions, positions, spectra, latitude-longitude images.
Out: lobes and sky maps for the kernels.
"""
