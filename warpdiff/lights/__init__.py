"""Light sources: directional lights, disc lights, point lights and environments, with the passes that sample them.

In: directions, positions and spectra of lights, and latitude-longitude images of skies.
Out: lobes (Gaussians of directions) and grids of the sky for the kernels.
"""
