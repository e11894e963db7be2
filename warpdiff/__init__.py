"""Iridescent colours of diffraction gratings given as measured height fields, on NVIDIA Warp.

The map of the package, in the order in which data flows:

- ``heightfield``, ``gratings``: a measured or synthetic surface, and its cleaning; ``inpainting``, ``periods``,
  ``units``: its gaps, its waves, and whether its scale can be meant
- ``coherence``: the window, source or copies that limit the coherent part of the surface
- ``plans``: the numbers that kernels get; ``planning``, ``search``: from a tolerance to these, by bounds and by trying;
  ``scope``, ``pilots``, ``trial``: for which directions, on which of them, and against what; ``aliasing``: what the
  pitch cannot carry
- ``expansions``, ``fourier``: series of exp(2πiκh) that separate the wavelength from the heights; their transforms, in
  NumPy
- ``coefficients``, ``interpolation``, ``tables``: Fourier coefficients as functions of κ, in a basis fitted to them;
  between the orders; on a device
- ``meshes``, ``snake``, ``mesh_files``, ``surface``, ``view``, ``light``, ``scene``: what is looked at, from where,
  under which light
- ``kernels``: Warp kernels: ray casting, directions, spectral integration
- ``spectrum``, ``optics``: colour; Fresnel reflectance, gain and masking
- ``render``: ``shade``, a picture of a mesh; ``renderer``: many of one mesh, recorded on a GPU; ``frame``, ``rooms``,
  ``shadows``: what they launch, over which arrays; ``refinement``, ``splitting``: pixels into cells
- ``evaluate``: the reflectance at arrays of directions; ``direct``: the same by a sum that approximates nothing
- ``orders``: where the light of a periodic surface goes, in absolute terms; ``validity``: where scalar theory fails
- ``image``: the picture and its files; ``layers``: normals, depths and geometries beside it; ``files``: whole or not
  there; ``disk``: coefficients kept for the next process; ``cli``, ``demo``: the command line; ``interruption``,
  ``streams``: signals that end it, and where it writes
- ``device``, ``launches``, ``work``: where kernels run and when they are compiled; kernels in turn over slices; threads
- ``forks``: what a fork of the process waits for
- ``checks``, ``memory``, ``errors``: validation of arguments; whether there is room; the warning category
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# Forks wait for what other threads import below, once it is asked for.
from warpdiff.core import fork_safety as _forks  # noqa: F401

if TYPE_CHECKING:
    from warpdiff import gratings, meshes
    from warpdiff.core.errors import WarpdiffWarning
    from warpdiff.evaluate.directions import brdf, brdf_map, reflectance, spectral_reflectance
    from warpdiff.evaluate.orders import OrderEfficiencies, order_efficiencies
    from warpdiff.image.image import Image
    from warpdiff.optics.coherence import Coherence
    from warpdiff.planning.planner import plan
    from warpdiff.plans.plan import Plan
    from warpdiff.render.renderer import Renderer
    from warpdiff.render.shade import shade
    from warpdiff.scene.camera import View
    from warpdiff.scene.lights import DirectionalLight
    from warpdiff.surface.heightfield import HeightField

    __version__: str

__all__ = [
    "Coherence",
    "DirectionalLight",
    "HeightField",
    "Image",
    "OrderEfficiencies",
    "Plan",
    "Renderer",
    "View",
    "WarpdiffWarning",
    "brdf",
    "brdf_map",
    "gratings",
    "meshes",
    "order_efficiencies",
    "plan",
    "reflectance",
    "shade",
    "spectral_reflectance",
]

_MODULES = {
    "optics.coherence": ("Coherence",),
    "core.errors": ("WarpdiffWarning",),
    "evaluate.directions": ("brdf", "brdf_map", "reflectance", "spectral_reflectance"),
    "surface.heightfield": ("HeightField",),
    "image.image": ("Image",),
    "scene.lights": ("DirectionalLight",),
    "evaluate.orders": ("OrderEfficiencies", "order_efficiencies"),
    "planning.planner": ("plan",),
    "plans.plan": ("Plan",),
    "render.shade": ("shade",),
    "render.renderer": ("Renderer",),
    "scene.camera": ("View",),
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
