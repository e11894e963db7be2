"""Iridescent colours of diffraction gratings given as measured height fields, on NVIDIA Warp.

Packages, from the lowest layer to the highest; a package imports only packages above it in this list.
``docs/contributing/package_map.md`` describes them and follows one pixel through them.

- ``core``: validation, caches, threads, files, forks
- ``device``: Warp devices and launches of kernels; ``optics``: coherence, materials, spectra, colorimetry
- ``heightfield``: measured height fields; ``samples``: synthetic gratings and sample bodies
- ``profiles``: surfaces with a few parameters
- ``datasets``: published measurements, downloaded on demand
- ``diffraction``: series of exp(2πiκh) and their Fourier coefficients
- ``request``: plans (choice of a method, numbers of wavelengths and of series terms) and ranges of directions
- ``image``: pictures and their files; ``scene``: meshes and cameras
- ``tables``: tables of Fourier coefficients and of colours on a device; ``planner``: plans that meet a tolerance
- ``lights``: light sources
- ``evaluate``: reflectance at arrays of directions; ``baked``: tables for other renderers
- ``adjoint``: exact derivatives of orders, spectra and colours; ``fitting``: fits of measured data
- ``plot``: plots of height fields and results with matplotlib
- ``render``: pictures of a mesh; ``apps``: command line, viewer, web page, report, sequences, Mitsuba

``kernels`` holds the Warp kernels.
"""

import re
from importlib import import_module
from pathlib import Path

# Importing this module registers a hook: ``os.fork`` then waits until no other thread is importing a module. Public
# names are imported at their first use, on any thread, so an import may be running when the process forks. The child
# process would then wait forever for the lock of this import.
from warpdiff.core import forks as _forks  # noqa: F401

# In a checkout, the folder ``kernels/`` lies next to this package. In an installed package, it lies inside.
if not Path(__path__[0], "kernels").is_dir():
    __path__.append(str(Path(__path__[0]).parent))

# Public names, each with the module or the package that it comes from. ``__init__.pyi`` lists them for type checkers
# too, in lines ``from MODULE import NAME as NAME``.
_LIST = Path(__path__[0], "__init__.pyi").read_text(encoding="utf-8")
_SOURCES = {name: module for module, name in re.findall(r"^from (\S+) import (\w+) as \2$", _LIST, re.MULTILINE)}

__all__ = sorted(_SOURCES)  # noqa: PLE0605 (a list of names)


def __getattr__(name: str) -> object:
    """Import a public name at its first use. ``import warpdiff`` itself is therefore fast."""
    if name in _SOURCES:
        source = import_module(_SOURCES[name])
        # For a name that is itself a module, such as ``plot``, ``_SOURCES`` names the package that contains this
        # module, such as ``warpdiff``. For any other name, it names the module that defines the name.
        is_package = hasattr(source, "__path__")
        value = import_module(f"{source.__name__}.{name}") if is_package else getattr(source, name)
    elif name == "__version__":
        value = import_module("importlib.metadata").version("warpdiff")
    else:
        raise AttributeError(f"module 'warpdiff' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
