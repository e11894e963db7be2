"""Finds the packages: those below ``warpdiff/``, and ``kernels/``, which is installed as ``warpdiff.kernels``.

An editable install puts the checkout on the import path. There ``warpdiff/__init__.py`` finds ``kernels/`` itself. The
import hook that setuptools installs otherwise comes too late: a folder named ``warpdiff`` beside a script, such as a
clone, would be imported as a namespace package without contents.
"""

import sys

from setuptools import find_packages, setup

LIBRARY = find_packages(include=["warpdiff", "warpdiff.*"])
if "editable_wheel" in sys.argv:
    setup(packages=LIBRARY, package_dir={"": "."})
else:
    KERNELS = [f"warpdiff.{name}" for name in find_packages(include=["kernels", "kernels.*"])]
    setup(packages=LIBRARY + KERNELS, package_dir={"warpdiff": "warpdiff", "warpdiff.kernels": "kernels"})
