"""Fuzzed arguments: Hypothesis strategies for all options, and calls of every public function with them.

A Hypothesis strategy describes random values of an argument.
"""

import ast
import dataclasses
import doctest
import functools
import inspect
import math
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
from conftest import public_members
from fuzz_objects import (
    ANYTHING,
    COUNTS,
    HEIGHTFIELD,
    LIGHT,
    MESH,
    MOST_PERIODS,
    NUMBERS,
    OBJECTS,
    PERIOD,
    SHORT,
    TEXTS,
    UP,
    VIEW,
    axes,
    designed,
    efficiencies,
    fitted,
    lobes,
    measured,
    orders_target,
    picture,
    plan,
    renderer,
    simple_plan,
    still,
    topography,
    trapezoid,
)
from hypothesis import strategies as st

import warpdiff as wd
from warpdiff.core.options import SPELLINGS, Option, describe
from warpdiff.lights.base import Light
from warpdiff.request.settings import SinglePictureSettings

_SETTINGS = describe(SinglePictureSettings)


def options_of(function) -> list[Option]:
    """Return the options of a public callable, including the settings that it shares with other functions."""
    return [
        _SETTINGS.get(name, option) if option.kind == "object" else option
        for name, option in describe(function).items()
    ]


def strategy(option: Option) -> st.SearchStrategy:
    """Return a Hypothesis strategy for the values of one option.

    Raises:
        KeyError: ``OBJECTS`` has no strategy for an object of this name.
    """
    # Fuzzed values of ``progress`` are never callable, because an error in the caller's own function would look like a
    # refusal of an argument.
    anything = [value for value in ANYTHING if option.name != "progress" or not callable(value)]
    return st.one_of(st.sampled_from(anything), *[_of_its_kind(option)] * 2)


def _of_its_kind(option: Option) -> st.SearchStrategy:
    """Return a Hypothesis strategy for values of an option's type, including extreme values and the option's limits."""
    simple = {
        "flag": st.sampled_from([0, 1, "yes", "no", np.bool_(0), True, False]),
        "choice": st.sampled_from([*option.choices, *SPELLINGS, "x"]),
        "choices": st.lists(
            st.sampled_from(
                [*option.choices, *(f"{name}.{k}" for name in option.indexed for k in (0, 9)), "x", 1, None]
            ),
            max_size=3,
        ),
        "text": TEXTS,
    }
    if option.kind == "object":
        return OBJECTS[option.name]
    if option.kind in simple:
        return simple[option.kind]
    one = COUNTS if option.kind.startswith("integer") else NUMBERS
    # A count, such as a number of wavelengths, is legal but slow at its upper limit. Therefore only the next larger
    # count is tested, which must be refused.
    steps = {option.gt: (0, 1), option.ge: (-1, 0), option.le: (1,) if one is COUNTS else (0, 1)}
    limits = [bound + step for bound in steps if bound not in (None, math.inf) for step in steps[bound]]
    one = st.one_of(one, st.sampled_from(limits)) if limits else one
    if option.kind in ("integer", "number"):
        return one
    length = option.length or 2
    pairs = st.one_of(st.lists(one, min_size=length, max_size=length), st.lists(one, max_size=4))
    return st.one_of(one, pairs) if option.kind == "pair" else pairs


WAVY = wd.HeightField(0.05 * np.sin(np.arange(120.0)).reshape(1, -1) + np.zeros((8, 1)), 0.1)
# Classes that are not called with random arguments. Only the library creates objects of most of these classes. Errors
# and warnings accept any text.
MADE_BY_THE_LIBRARY = {"BakedLobes", "BakedSpectrum", "Comparison", "Image", "OrderEfficiencies", "Period"}
MADE_BY_THE_LIBRARY |= {"Periods", "ReflectanceSpectra", "Report", "Roughness", "ScanReport", "ToleranceError"}
MADE_BY_THE_LIBRARY |= {"WarpdiffWarning", "Fit", "Measured", "Minimum", "Design", "Target", "RigorousEfficiencies"}
# Methods that only the renderer calls are not fuzzed, because their arguments are already checked.
CALLED_BY_PICTURES = {"lobes", "parts", "table_coherence"}
# Objects on which methods are called, by class. Methods of the classes in ``FUZZED_OWNERS`` are also called on random
# objects of these classes.
OWNERS = {
    "Environment": lambda: wd.Environment(np.ones((2, 4, 3)), directions=16),
    "Material": lambda: wd.Material.metal("Au"),
    "HeightField": lambda: WAVY, "Image": picture, "Plan": plan, "Renderer": renderer, "View": lambda: VIEW,
    "BakedLobes": lobes, "Comparison": lambda: wd.compare(np.ones((2, 3, 3)), np.ones((2, 3, 3)), tolerance=0.1),
    "OrderEfficiencies": efficiencies, "Periods": lambda: wd.Periods([PERIOD]),
    "RigorousEfficiencies": lambda: wd.RigorousEfficiencies(
        np.array([500.0]), np.eye(3)[2], np.zeros((1, 2), dtype=int), np.eye(3)[2].reshape(1, 1, 3),
        *(np.ones((1, 1)) for _ in range(3)), np.array([8]), np.array([0.0]), np.array([True]),
    ),
    "Roughness": WAVY.roughness, "Fit": fitted, "Measured": measured, "Design": designed,
    "Table": lambda: wd.Table({"number": [1.0]}), "GratingMap": lambda: wd.GratingMap(HEIGHTFIELD),
    "ReflectanceSpectra": lambda: wd.ReflectanceSpectra(np.ones(1), np.eye(3)[2:], np.eye(3)[2:], np.ones((1, 1))),
    "BakedSpectrum": functools.cache(lambda: wd.bake_spectrum(HEIGHTFIELD, coherence=SHORT, size=16, tolerance=0.1)),
}  # fmt: skip
FUZZED_OWNERS = {"HeightField": "heightfield", "View": "view"}
# Legal values for arguments that are not fuzzed in a call. ``LEGAL_OF`` overrides them for single functions.
LEGAL = {
    "cell": HEIGHTFIELD, "row": 0, "column": 0,
    "heightfield": HEIGHTFIELD, "mesh": MESH, "lights": LIGHT, "view": VIEW, "to_light": UP,
    "to_view": UP, "wavelengths_nm": [500.0], "coherence": SHORT, "eye": (0.0, 0.0, 5.0), "target": (0.0, 0.0, 0.0),
    "extent_y": 1.0, "period_um": 1.0, "depth_um": 0.1, "path": Path("a.npy"), "heights_um": [[0.0, 0.1], [0.1, 0.0]],
    "pitch_um": 0.1, "size": 4, "tolerance": 0.1, "scale_rows": 5, "ventrals": 8, "segments": 3, "rings": 1,
    "segments_along": 12, "segments_around": 3, "shots": [wd.Shot((LIGHT,), VIEW)], "folder": "frames",
    "scattering_vectors": [[0.1, 0.2, -1.5]], "radiance_rgb": np.ones((2, 4, 3)), "directions": 16,
    "topography": topography(), "xyz": [0.1, 0.2, 0.3], "theta_deg": 30.0, "columns": {"number": [1.0]},
    "position": (0.0, 0.0, 2.0), "delta_e": 10.0, "n": 1.5, "angle_deg": 30.0, "sun_direction": (1.0, 1.0, 0.0),
}  # fmt: skip
LEGAL_OF = {
    "gratings.fingers": {"size_um": 6.4}, "HeightField.cropped": {"size_um": 0.5}, "Image.save": {"path": "a.png"},
    "export_html": {"path": "a.html"}, "BakedLobes.save": {"path": "a.npz"}, "BakedSpectrum.save": {"path": "a.npz"},
    "HeightField.save": {"path": "a.npz"}, "Plan.save": {"path": "a.json"}, "Plan.load": {"path": "plan.json"},
    "bake_spectrum": {"size": 16}, "Environment.load": {"path": "sky.exr"},
    "HeightField.load": {"path": "integers.npy", "height_range_um": 0.3},
    "compare": {"image": np.ones((2, 3, 3)), "reference": np.ones((2, 3, 3))},
    "Spectrum": {"wavelengths_nm": [300.0, 900.0], "values": [1.0, 2.0]},
    "Material.coated": {"film": wd.Material.dielectric(1.4), "thickness_nm": 100.0},
}  # fmt: skip
LEGAL_OF |= {
    f"{name}.save": {"path": "a.csv"}
    for name in ("OrderEfficiencies", "Periods", "ReflectanceSpectra", "RigorousEfficiencies", "Roughness", "Table")
}
LEGAL_OF |= {
    "order_angles": {"source": PERIOD}, "plot.colour_strip": {"source": np.ones((2, 3)), "angles_deg": [0.0, 10.0]},
    "plot.spectra": {"source": [500.0], "values": [0.5]},
}  # fmt: skip
LEGAL_OF |= {
    "Measured.orders": {"orders": [(0, 1)], "efficiencies": [0.1]}, "Measured.spectra": {"reflectances": [0.1]},
    "Measured.colours": {"xyz": [[0.1, 0.2, 0.3]]}, "Measured.from_csv": {"path": "orders.csv"},
    "Measured.predict": {"surface": HEIGHTFIELD}, "fit": {"sd": 0.1, "starts": 1},
    "adjoint.objective": {"evaluate": print, "loss": print},
    "Target.orders": {"efficiencies": {(0, 1): 0.01}, "wavelength_nm": 500.0},
    "Target.equal": {"orders": [(0, 1)], "wavelength_nm": 500.0}, "design": {"starts": 1},
    "measure_layout": {"path": "foil.gds"},
    "hidden_pictures": {
        "first": np.eye(3), "second": np.ones((3, 3)), "eyes": [(0, 0, 8), (5, 1, 6)], "to_light": (0.0, 0.6, 0.8),
        "cell": wd.gratings.sinusoidal(1.3, 0.2), "width": 1.0,
    },
    "rigorous_order_efficiencies": {"heightfield": wd.gratings.lamellar(1.0, 0.1, samples=8), "layers": 1},
}  # fmt: skip
LEGAL_BY_CALL = {"renderer": renderer, "lobes": lobes, "ax": axes, "efficiencies": efficiencies}
# Arguments of single public functions, with functions that make a legal value of the argument for each call. They
# override ``LEGAL_BY_CALL``.
LEGAL_OF_BY_CALL = {
    "fit": {"profile": trapezoid, "measured": measured},
    "design": {"profile": lambda: wd.profiles.Pixels(0.5, np.zeros((1, 4))), "targets": lambda: [orders_target()]},
    "adjoint.objective": {"profile": trapezoid},
    "plot.plan": {"plan": simple_plan}, "plot.error_image": {"image": still}, "plot.reflectance_map": {"source": still},
}  # fmt: skip


def write_files(folder: Path) -> None:
    """Write the files that the legal arguments refer to."""
    np.save(folder / "a.npy", WAVY.heights_um)
    np.save(folder / "integers.npy", np.arange(96, dtype=np.uint8).reshape(8, 12))
    np.save(folder / "gaps.npy", [[0.0, math.nan]])
    plan().save(folder / "plan.json")
    efficiencies().save(folder / "orders.csv")
    sky = oiio.ImageOutput.create(str(folder / "sky.exr"))
    sky.open(str(folder / "sky.exr"), oiio.ImageSpec(4, 2, 3, "float"))
    sky.write_image(np.ones((2, 4, 3), np.float32))
    sky.close()


def public():
    """Yield the name, the callable and the owning class (or None) of every public function, class and method."""
    for name in wd.__all__:
        member = getattr(wd, name)
        if inspect.ismodule(member):
            own = [key for key, value in vars(member).items() if getattr(value, "__module__", "") == member.__name__]
            for key in getattr(member, "__all__", own):
                if inspect.isfunction(getattr(member, key)) and not key.startswith("_"):
                    yield f"{name}.{key}", getattr(member, key), None
            continue
        if name not in MADE_BY_THE_LIBRARY:
            yield name, member, None
        if inspect.isclass(member):
            for key, value in public_members(member).items():
                is_public = key not in CALLED_BY_PICTURES
                if is_public and (inspect.isfunction(value) or isinstance(value, classmethod)):
                    yield f"{name}.{key}", getattr(member, key), None if isinstance(value, classmethod) else name


PUBLIC = {name: (function, owner) for name, function, owner in public()}


def example_of(function):
    """Return the arguments with which the docstring of a class of lights creates its first example."""
    source = "\n".join(example.source for example in doctest.DocTestParser().get_examples(function.__doc__))
    calls = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    first = next(node for node in calls if ast.unparse(node.func) == f"wd.{function.__name__}")
    arguments = [ast.literal_eval(value) for value in first.args]
    named = {keyword.arg: ast.literal_eval(keyword.value) for keyword in first.keywords}
    return inspect.signature(function).bind(*arguments, **named).arguments


def call(name, fuzzed):
    """Call a public function with the fuzzed arguments, and with legal values for all other arguments."""
    function, owner = PUBLIC[name]
    if name == "Plan":
        fuzzed_plan = dataclasses.replace(plan(), **fuzzed)
        return [str(fuzzed_plan), wd.reflectance(HEIGHTFIELD, UP, (0.1, 0.2, 1.0), plan=fuzzed_plan)]
    parameters = inspect.signature(function).parameters
    required = {key for key, parameter in parameters.items() if parameter.default is parameter.empty}
    is_light = inspect.isclass(function) and issubclass(function, Light)
    # Required arguments of a new light have the values of its example.
    arguments = example_of(function) if is_light and not required <= set(LEGAL) else {}
    for key, parameter in parameters.items():
        # Gratings are called with their default arguments instead of the legal values, because the defaults are
        # computed quickly.
        if key in LEGAL and (parameter.default is parameter.empty or not name.startswith("gratings.")):
            arguments[key] = LEGAL[key]
        elif key in LEGAL_BY_CALL and key not in fuzzed:
            arguments[key] = LEGAL_BY_CALL[key]()
    if "plan" in fuzzed:
        arguments.pop("coherence", None)
    if "extent_um" in fuzzed:
        arguments.pop("pitch_um")
    arguments |= LEGAL_OF.get(name, {}) | {key: make() for key, make in LEGAL_OF_BY_CALL.get(name, {}).items()} | fuzzed
    if arguments.get("coherence") is MOST_PERIODS and str(arguments.get("method")) == "direct":
        # The float64 direct sum over 100,000 periods requires a minute per direction, so 100 periods are used instead.
        arguments["coherence"] = wd.Coherence("replicas", periods=(1, 100))
    if owner is None:
        return function(**arguments)
    return function(arguments.pop("self", None) or OWNERS[owner](), **arguments)
