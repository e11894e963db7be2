"""Iridescent colours of diffraction gratings given as measured height fields, on NVIDIA Warp.

Packages, from the lowest layer to the highest; a package imports only packages above it in this list.
``docs/contributing/package_map.md`` describes them and follows one pixel through them.

- ``core``: validation, caches, threads, files, forks
- ``device``: Warp devices and launches of kernels; ``optics``: coherence, materials, spectra, colorimetry
- ``heightfield``: measured height fields; ``samples``: synthetic gratings and sample bodies
- ``datasets``: published measurements, downloaded on demand
- ``diffraction``: series of exp(2πiκh) and their Fourier coefficients
- ``request``: plans and ranges of directions; ``image``: pictures and their files; ``scene``: meshes and cameras
- ``tables``: coefficients and colours on a device; ``planner``: from a tolerance to a plan; ``lights``: light sources
- ``evaluate``: reflectance at arrays of directions; ``baked``: tables for other renderers
- ``plot``: plots of height fields and results with matplotlib
- ``render``: pictures of a mesh; ``apps``: command line, viewer, web page, report, sequences, Mitsuba

``kernels`` holds the Warp kernels.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

# Importing this module registers a hook: ``os.fork`` then waits until no other thread is importing a module. Public
# names are imported at their first use, on any thread, so an import may be running when the process forks.
from warpdiff.core import forks as _forks  # noqa: F401

if TYPE_CHECKING:
    from warpdiff.apps.mitsuba.bsdf import register_mitsuba_bsdf
    from warpdiff.apps.report.scan_report import ScanReport, report
    from warpdiff.apps.sequences.sequence import sequence
    from warpdiff.apps.sequences.shots import Shot, camera_path, light_sweep, turntable
    from warpdiff.apps.web_page.export_html import export_html
    from warpdiff.baked.bake_lobes import bake
    from warpdiff.baked.bake_spectrum import bake_spectrum
    from warpdiff.baked.lobe_table import BakedLobes
    from warpdiff.baked.spectrum_table import BakedSpectrum
    from warpdiff.core.angles import direction
    from warpdiff.core.table import Table
    from warpdiff.core.wording import ToleranceError, WarpdiffWarning
    from warpdiff.evaluate.order_angles import order_angles
    from warpdiff.evaluate.orders import OrderEfficiencies, order_efficiencies
    from warpdiff.evaluate.reflectance import (
        brdf,
        reflectance,
        reflectance_map,
        reflectance_spectra,
        spectral_reflectance,
    )
    from warpdiff.evaluate.reflectance_spectra import ReflectanceSpectra
    from warpdiff.heightfield.field import HeightField
    from warpdiff.heightfield.periods import Period, Periods
    from warpdiff.heightfield.roughness import Roughness
    from warpdiff.image.comparison import Comparison, compare
    from warpdiff.image.display_transform import to_srgb
    from warpdiff.image.image import Image
    from warpdiff.image.report import Report
    from warpdiff.lights.directional import DirectionalLight
    from warpdiff.lights.environment import Environment
    from warpdiff.lights.point import PointLight
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.planner.strategy import plan
    from warpdiff.render.renderer import Renderer
    from warpdiff.render.shade import shade
    from warpdiff.request.plan import Plan
    from warpdiff.samples import bodies as meshes
    from warpdiff.samples import gratings
    from warpdiff.scene.camera import View

    from . import datasets, plot

    __version__: str

# In a checkout, the folder ``kernels/`` lies next to this package. In an installed package, it lies inside.
if not Path(__path__[0], "kernels").is_dir():
    __path__.append(str(Path(__path__[0]).parent))

__all__ = [
    "BakedLobes", "BakedSpectrum", "Coherence", "Comparison", "DirectionalLight", "Environment", "HeightField", "Image",
    "Material", "OrderEfficiencies", "Period", "Periods", "Plan", "PointLight", "ReflectanceSpectra", "Renderer",
    "Report", "Roughness", "ScanReport", "Shot", "Spectrum", "Table", "ToleranceError", "View", "WarpdiffWarning",
    "bake", "bake_spectrum", "brdf", "camera_path", "compare", "datasets", "direction", "export_html", "gratings",
    "light_sweep", "meshes", "order_angles", "order_efficiencies", "plan", "plot", "reflectance", "reflectance_map",
    "reflectance_spectra", "register_mitsuba_bsdf", "report", "sequence", "shade", "spectral_reflectance", "to_srgb",
    "turntable",
]  # fmt: skip

_MODULES = {
    "baked.bake_lobes": ("bake",), "baked.bake_spectrum": ("bake_spectrum",), "baked.lobe_table": ("BakedLobes",),
    "baked.spectrum_table": ("BakedSpectrum",), "apps.mitsuba.bsdf": ("register_mitsuba_bsdf",),
    "optics.coherence": ("Coherence",), "optics.materials": ("Material",), "optics.spectra": ("Spectrum",),
    "core.wording": ("ToleranceError", "WarpdiffWarning"),
    "evaluate.reflectance": (
        "brdf", "reflectance_map", "reflectance", "reflectance_spectra", "spectral_reflectance",
    ),
    "evaluate.reflectance_spectra": ("ReflectanceSpectra",), "core.table": ("Table",),
    "core.angles": ("direction",), "evaluate.order_angles": ("order_angles",),
    "heightfield.field": ("HeightField",), "heightfield.periods": ("Period", "Periods"), "image.image": ("Image",),
    "heightfield.roughness": ("Roughness",), "image.display_transform": ("to_srgb",), "image.report": ("Report",),
    "image.comparison": ("Comparison", "compare"),
    "lights.environment": ("Environment",), "lights.directional": ("DirectionalLight",),
    "lights.point": ("PointLight",), "evaluate.orders": ("OrderEfficiencies", "order_efficiencies"),
    "planner.strategy": ("plan",), "request.plan": ("Plan",), "render.shade": ("shade",),
    "render.renderer": ("Renderer",), "scene.camera": ("View",), "apps.sequences.sequence": ("sequence",),
    "apps.sequences.shots": ("Shot", "camera_path", "light_sweep", "turntable"),
    "apps.report.scan_report": ("ScanReport", "report"), "apps.web_page.export_html": ("export_html",),
}  # fmt: skip
_ALIASES = {"datasets": "datasets", "plot": "plot", "gratings": "samples.gratings", "meshes": "samples.bodies"}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name at its first use. ``import warpdiff`` itself is therefore fast."""
    if name in _MODULE_OF:
        value = getattr(import_module(f"warpdiff.{_MODULE_OF[name]}"), name)
    elif name in _ALIASES:
        value = import_module(f"warpdiff.{_ALIASES[name]}")
    elif name == "__version__":
        value = import_module("importlib.metadata").version("warpdiff")
    else:
        raise AttributeError(f"module 'warpdiff' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
