"""The installed warpdiff under the public names of version 0.2, also where it is version 0.1.0, the baseline.

``from bench.dev.public_names import wd`` imports the package that this Python has installed, never the source folder
next to ``bench``. For version 0.1.0 the tables below add the new names to the old package; nothing else changes. For
newer versions the package is passed through unchanged.
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

# Public functions, new name to old name. A function not listed here has the same name in both versions.
FUNCTIONS = {"reflectance_map": "brdf_map"}
# Keyword arguments, new name to old name. Each new name has one old name, whichever function takes it.
ARGUMENTS = {
    "heightfield": "hf",
    "lights": "light",
    "periods": "copies",  # of Coherence
    "delta_e": "tolerance",  # of bake
    "previews": "coarser",  # of Renderer.draw
}
# Functions and methods whose arguments are renamed.
RENAMED_FUNCTIONS = (
    "bake", "bake_spectrum", "brdf", "brdf_map", "camera_path", "export_html", "order_efficiencies", "plan",
    "reflectance", "shade", "spectral_reflectance", "turntable",
)  # fmt: skip
RENAMED_METHODS = (("Coherence", "__init__"), ("Renderer", "__init__"), ("Renderer", "draw"), ("Shot", "__init__"))
# Attributes and methods of public classes: class, new name, old name.
ATTRIBUTES = (
    ("Environment", "background", "seen"), ("Image", "illuminated", "lit"), ("Shot", "lights", "light"),
)  # fmt: skip
# Fields of a plan and of its coherence, old name to new name. A field not listed here has the same name in both.
PLAN_FIELDS = {
    "nodes": "rings_per_octave", "rays_per_width": "azimuths_per_width", "functions": "w_basis_size",
    "lit_by": "light_sample_count", "unsettled": "unconverged_share", "unsettled_edges": "unconverged_edge_share",
    "split": "refined_share", "judged": "validation_size", "searched": "is_measured", "max_lateral": "max_order_rate",
}  # fmt: skip
COHERENCE_FIELDS = {"copies": "periods"}
# Numbers of a picture's report, with those of a plan without a picture; they were fields of the plan until version 0.2.
REPORT_FIELDS = {
    "light_sample_count": 0, "refined_share": 0.0, "unconverged_share": 0.0, "unconverged_edge_share": 0.0,
    "errors": (0.0, 0.0),
}  # fmt: skip


def is_baseline(package: ModuleType) -> bool:
    """Whether a package has the old names."""
    return bool(package.__version__ == BASELINE)


def plan_numbers(plan: Any, report: Any = None) -> dict[str, Any]:
    """Fields of a plan, of its coherence and of a picture's report, by their new names."""
    fields = dataclasses.asdict(plan)
    if not is_baseline(wd):
        fields |= {name: getattr(report, name, value) for name, value in REPORT_FIELDS.items()}
    coherence = fields.pop("coherence")
    if is_baseline(wd):
        fields = {PLAN_FIELDS.get(name, name): value for name, value in fields.items()}
        coherence = {COHERENCE_FIELDS.get(name, name): value for name, value in coherence.items()}
    return fields | {f"coherence.{name}": value for name, value in coherence.items()}


def _installed() -> Any:
    # The root of the checkout is on the path for the sake of ``bench``; its ``warpdiff`` folder must not be found.
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
    """A function that takes new keyword arguments besides its old ones."""

    @functools.wraps(function)
    def call(*positional: Any, **keywords: Any) -> Any:
        # method="low-rank", integration="table" was method="low-rank/table".
        integration = keywords.pop("integration", "auto")
        if integration != "auto":
            keywords["method"] = f"{keywords['method']}/{integration}"
        return function(*positional, **{ARGUMENTS.get(name, name): value for name, value in keywords.items()})

    return call


wd: Any = _installed()
