"""Sequences of pictures: shots of a turntable, a moving light or a camera path, their frames, and animations.

In: a renderer, shots, a folder, a Dask client.
Out: files of frames, which are the same whichever worker renders them.
"""
