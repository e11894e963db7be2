"""Pictures of a mesh: G-buffer, colours, and adaptive refinement of pixels that one ray does not resolve.

In: a mesh, a height field, lights, a view.
Out: an ``Image``; from a ``Renderer`` any number of pictures of one mesh. The G-buffer has the hits of camera rays.
"""
