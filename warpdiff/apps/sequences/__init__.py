"""Sequences of pictures: shots of a turntable, a moving light or a camera path, their frames, and animations.

In: a renderer, shots, a folder, a Dask client.
Out: files of frames. Their contents do not depend on the worker that rendered them.
"""
