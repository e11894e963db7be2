"""Web pages without a server: a mesh with baked lobes, and the WebGL 2 program that renders it.

In: a mesh, baked lobes, lights, a view.
Out: one HTML file.
"""
