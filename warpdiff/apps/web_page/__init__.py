"""Pages that need no server: a mesh with baked lobes, and the program that draws it in a browser by WebGL 2.

In: a mesh, baked lobes, lights, a view.
Out: one HTML file.
"""
