"""Sequences of pictures: shots of a turntable, a moving light or a camera's path, their frames, and an animated file.

In: a renderer, shots, a folder, a client of Dask.
Out: files of frames, the same whoever drew them.
"""
