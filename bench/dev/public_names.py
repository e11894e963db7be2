"""Import of the installed warpdiff under the public names of version 0.2, even if version 0.1.0 is installed.

``from bench.dev.public_names import wd`` imports the package that is installed for this Python, never the source folder
next to ``bench``. If that package is version 0.1.0, the baseline, the new names are added to it. Newer versions are not
modified.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import operator
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

BASELINE = "0.1.0"
ROOT = Path(__file__).resolve().parents[2]

# Public functions that were renamed after version 0.1.0, new name to old name.
FUNCTIONS = {"reflectance_map": "brdf_map"}
# Keyword arguments that were renamed after version 0.1.0, new name to old name. The mapping applies to every function
# that has an argument of the new name.
ARGUMENTS = {
    "heightfield": "hf",
    "lights": "light",
    "periods": "copies",  # old name of the argument of Coherence
    "delta_e": "tolerance",  # old name of the argument of bake
    "previews": "coarser",  # old name of the argument of Renderer.draw
}
# Functions and methods of which an argument was renamed after version 0.1.0.
RENAMED_FUNCTIONS = (
    "bake", "bake_spectrum", "brdf", "brdf_map", "camera_path", "export_html", "order_efficiencies", "plan",
    "reflectance", "shade", "spectral_reflectance", "turntable",
)  # fmt: skip
RENAMED_METHODS = (("Coherence", "__init__"), ("Renderer", "__init__"), ("Renderer", "draw"), ("Shot", "__init__"))
# Attributes and methods that were renamed after version 0.1.0: class, new name, old name.
ATTRIBUTES = (
    ("Environment", "background", "seen"), ("Image", "illuminated", "lit"), ("Shot", "lights", "light"),
)  # fmt: skip
# Attributes of a plan and of its coherence that were renamed after version 0.1.0, old name to new name.
PLAN_FIELDS = {
    "nodes": "rings_per_octave", "rays_per_width": "azimuths_per_width", "functions": "w_basis_size",
    "lit_by": "light_sample_count", "unsettled": "unconverged_share", "unsettled_edges": "unconverged_edge_share",
    "split": "refined_share", "judged": "validation_size", "searched": "is_measured", "max_lateral": "max_order_rate",
}  # fmt: skip
COHERENCE_FIELDS = {"copies": "periods"}
# Attributes of a picture's report that belonged to the plan in version 0.1.0, with their values for a plan without a
# picture.
REPORT_FIELDS = {
    "light_sample_count": 0, "refined_share": 0.0, "unconverged_share": 0.0, "unconverged_edge_share": 0.0,
    "errors": (0.0, 0.0),
}  # fmt: skip


def is_baseline(package: ModuleType) -> bool:
    """Return whether a package is version 0.1.0, which has the old names."""
    return bool(package.__version__ == BASELINE)


def plan_numbers(plan: Any, report: Any = None) -> dict[str, Any]:
    """Return the attributes of a plan, of its coherence and of a picture's report, under the names of version 0.2."""
    fields = dataclasses.asdict(plan)
    if not is_baseline(wd):
        fields |= {name: getattr(report, name, value) for name, value in REPORT_FIELDS.items()}
    coherence = fields.pop("coherence")
    if is_baseline(wd):
        fields = {PLAN_FIELDS.get(name, name): value for name, value in fields.items()}
        coherence = {COHERENCE_FIELDS.get(name, name): value for name, value in coherence.items()}
    return fields | {f"coherence.{name}": value for name, value in coherence.items()}


def _installed() -> Any:
    # The root of the checkout is on the import path because ``bench`` lies in it. The root is removed from the path, so
    # that its ``warpdiff`` folder is not imported instead of the installed package.
    sys.path[:] = [entry for entry in sys.path if Path(entry).resolve() != ROOT]
    package = importlib.import_module("warpdiff")
    if is_baseline(package):
        _add_new_names(package)
    return package


def _add_new_names(package: Any) -> None:
    for name in RENAMED_FUNCTIONS:
        setattr(package, name, _with_new_arguments(getattr(package, name)))
    for owner, method in RENAMED_METHODS:
        cls = getattr(package, owner)
        setattr(cls, method, _with_new_arguments(getattr(cls, method)))
    for owner, new, old in ATTRIBUTES:
        cls = getattr(package, owner)
        is_method = callable(getattr(cls, old, None))
        setattr(cls, new, getattr(cls, old) if is_method else property(operator.attrgetter(old)))
    for new, old in FUNCTIONS.items():
        setattr(package, new, getattr(package, old))


def _with_new_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a wrapper of a function of version 0.1.0 that also accepts the present names of keyword arguments."""

    @functools.wraps(function)
    def call(*positional: Any, **keywords: Any) -> Any:
        # In version 0.1.0, method="low-rank/table" meant method="low-rank" with integration="table".
        integration = keywords.pop("integration", "auto")
        if integration != "auto":
            keywords["method"] = f"{keywords['method']}/{integration}"
        return function(*positional, **{ARGUMENTS.get(name, name): value for name, value in keywords.items()})

    return call


wd: Any = _installed()
