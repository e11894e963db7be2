"""Meshes and cameras, on the host and on a device.

In: mesh files or trimesh objects, a camera.
Out: vertices with normals and tangents, their copy on a device, grids that reduce the cost of shadow rays.
"""
