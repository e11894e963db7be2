"""Iridescent colours of diffraction gratings given as measured height fields, on NVIDIA Warp.

The rooms of the package, in the order in which data flows; each says in its docstring what comes in, what goes out and
which rooms it may import. ``docs/architecture.md`` has the whole way, file by file.

- ``core``: checks, caches, threads, files, forks; ``compute``: devices and launches of kernels
- ``optics``: coherence, reflectance factors, colorimetry; ``surface``: height fields, measured or synthetic
- ``scene``: meshes, cameras, lights; ``fourier``: series of exp(2πiκh) and their transforms
- ``plans``: the numbers that kernels get, and for which directions; ``image``: pictures and their files
- ``tables``: coefficients and colours on a device; ``planning``: from a tolerance to a plan
- ``evaluate``: reflectance at arrays of directions; ``render``: pictures of a mesh
- ``sequences``: frames of turntables, moving lights and cameras; ``app``: the command line, and a page in the browser

``kernels`` holds the Warp kernels; ``gratings`` and ``meshes`` are public modules.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# Forks wait for what other threads import below, once it is asked for.
from warpdiff.core import fork_safety as _forks  # noqa: F401

if TYPE_CHECKING:
    from warpdiff import gratings, meshes
    from warpdiff.baking.bake import bake
    from warpdiff.baking.bake_spectrum import bake_spectrum
    from warpdiff.baking.baked_lobes import BakedLobes
    from warpdiff.baking.baked_spectrum import BakedSpectrum
    from warpdiff.bridges.mitsuba_bsdf import register_mitsuba_bsdf
    from warpdiff.core.errors import WarpdiffWarning
    from warpdiff.evaluate.directions import brdf, brdf_map, reflectance, spectral_reflectance
    from warpdiff.evaluate.orders import OrderEfficiencies, order_efficiencies
    from warpdiff.image.image import Image
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.planning.planner import plan
    from warpdiff.plans.plan import Plan
    from warpdiff.render.renderer import Renderer
    from warpdiff.render.shade import shade
    from warpdiff.scene.camera import View
    from warpdiff.scene.environment import Environment
    from warpdiff.scene.lights import DirectionalLight, PointLight
    from warpdiff.sequences.sequence import sequence
    from warpdiff.sequences.shots import Shot, camera_path, light_sweep, turntable
    from warpdiff.surface.heightfield import HeightField
    from warpdiff.surface.periods import Period
    from warpdiff.web.export_html import export_html

    __version__: str

__all__ = [
    "BakedLobes",
    "BakedSpectrum",
    "Coherence",
    "DirectionalLight",
    "Environment",
    "HeightField",
    "Image",
    "Material",
    "OrderEfficiencies",
    "Period",
    "Plan",
    "PointLight",
    "Renderer",
    "Shot",
    "Spectrum",
    "View",
    "WarpdiffWarning",
    "bake",
    "bake_spectrum",
    "brdf",
    "brdf_map",
    "camera_path",
    "export_html",
    "gratings",
    "light_sweep",
    "meshes",
    "order_efficiencies",
    "plan",
    "reflectance",
    "register_mitsuba_bsdf",
    "sequence",
    "shade",
    "spectral_reflectance",
    "turntable",
]

_MODULES = {
    "baking.bake": ("bake",),
    "baking.bake_spectrum": ("bake_spectrum",),
    "baking.baked_lobes": ("BakedLobes",),
    "baking.baked_spectrum": ("BakedSpectrum",),
    "bridges.mitsuba_bsdf": ("register_mitsuba_bsdf",),
    "optics.coherence": ("Coherence",),
    "optics.materials": ("Material",),
    "optics.spectra": ("Spectrum",),
    "core.errors": ("WarpdiffWarning",),
    "evaluate.directions": ("brdf", "brdf_map", "reflectance", "spectral_reflectance"),
    "surface.heightfield": ("HeightField",),
    "surface.periods": ("Period",),
    "image.image": ("Image",),
    "scene.environment": ("Environment",),
    "scene.lights": ("DirectionalLight", "PointLight"),
    "evaluate.orders": ("OrderEfficiencies", "order_efficiencies"),
    "planning.planner": ("plan",),
    "plans.plan": ("Plan",),
    "render.shade": ("shade",),
    "render.renderer": ("Renderer",),
    "scene.camera": ("View",),
    "sequences.sequence": ("sequence",),
    "sequences.shots": ("Shot", "camera_path", "light_sweep", "turntable"),
    "web.export_html": ("export_html",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name once it is asked for: the command line meets signals before anything slow is imported."""
    if name in _MODULE_OF:
        value = getattr(import_module(f"warpdiff.{_MODULE_OF[name]}"), name)
    elif name in ("gratings", "meshes"):
        value = import_module(f"warpdiff.{name}")
    elif name == "__version__":
        value = import_module("importlib.metadata").version("warpdiff")
    else:
        raise AttributeError(f"module 'warpdiff' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
