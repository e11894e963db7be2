"""Readers of height field files, in a registry by suffix and content; each reader is one module."""

from warpdiff.heightfield.readers import image_reader, numpy_reader, text_reader, topography_reader, x3p_reader
from warpdiff.heightfield.readers.reader_registry import FileContent, register_reader

__all__ = [
    "FileContent", "image_reader", "numpy_reader", "register_reader", "text_reader", "topography_reader", "x3p_reader",
]  # fmt: skip
