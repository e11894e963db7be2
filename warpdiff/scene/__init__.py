"""Meshes, cameras and lights, on the host and on a device.

In: mesh files or trimesh objects, a camera, lights.
Out: vertices with normals and tangents, the same on a device, grids that spare shadow rays.
"""
