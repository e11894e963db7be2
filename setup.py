"""Finds what is shipped: the packages below warpdiff/, and kernels/ as a part of it."""

from setuptools import find_packages, setup

FOUND = find_packages(include=["warpdiff", "warpdiff.*", "kernels", "kernels.*"])
setup(packages=[name if name.startswith("warpdiff") else f"warpdiff.{name}" for name in FOUND])
