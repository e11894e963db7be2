"""Readers of height field files. Each module registers its readers by suffix and content when it is imported."""

from warpdiff.heightfield.readers import image_reader as image_reader
from warpdiff.heightfield.readers import numpy_reader as numpy_reader
from warpdiff.heightfield.readers import text_reader as text_reader
from warpdiff.heightfield.readers import topography_reader as topography_reader
from warpdiff.heightfield.readers import x3p_reader as x3p_reader
from warpdiff.heightfield.readers.reader_registry import FileContent, register_reader

__all__ = ["FileContent", "register_reader"]
