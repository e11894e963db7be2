"""Meshes and cameras, on the host and on a device.

In: mesh files or trimesh objects, a camera.
Out: vertices with normals and tangents, arrays on a device, hits of camera rays, and occluder grids (lists of the faces
that may block a light) for shadow rays.
"""
