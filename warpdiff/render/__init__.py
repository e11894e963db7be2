"""Pictures of a mesh: G-buffer, colours, and adaptive supersampling of what one ray does not tell.

In: a mesh, a height field, lights, a view.
Out: an ``Image``; from a ``Renderer`` many of one mesh.
"""
