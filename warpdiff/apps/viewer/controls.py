"""What a page of the viewer may set: each control once, with its range, for the page that shows it and for its check.

A new control is one entry of :func:`controls`, and one line of ``scene.py`` that says what it is for.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from warpdiff.lights.light_types import ONE_LOBE_DEG
from warpdiff.optics.coherence import DEFAULT_SIGMA_UM, KINDS
from warpdiff.request.plan import METHODS

if TYPE_CHECKING:
    from collections.abc import Sequence

BODIES = {"snake": "snake", "tube": "tube", "disc": "disc"}
# Those that have a direction along the body, besides that around it.
LONG_BODIES = ("snake", "tube")
GRATINGS = {
    "fingers": "nano-fingers", "bumps": "bumps", "sinusoidal": "sinusoidal", "lamellar": "lamellar", "blazed": "blazed",
    "disc": "optical disc",
}  # fmt: skip
ILLUMINANTS = {
    "D65": "daylight, D65", "D50": "daylight, D50", "A": "incandescent, A", "E": "equal energy, E",
    "FL2": "fluorescent, FL2", "FL11": "fluorescent, three bands, FL11", "LED-B3": "LED, B3",
}  # fmt: skip
METALS = {
    "Al": "aluminium", "Ag": "silver", "Au": "gold", "Cr": "chromium", "Cu": "copper", "Ni": "nickel",
}  # fmt: skip
MATERIALS = {"dielectric": "dielectric", "mirror": "perfect mirror"} | METALS
ENERGIES = {"stam": "Stam's", "normalised": "normalised"}
AXES = {"x": "world x", "y": "world y", "z": "world z"}
# Rows of a picture at rest.
HEIGHTS = (240, 360, 480, 720, 960)
# Of an environment, from how many a pixel sums its light where it is not by the tolerance.
DIRECTIONS = (256, 1024, 4096)
# The one that is most exact is for single pictures.
_METHODS = {name: name for name in METHODS if "/" not in name and name != "direct"}


@dataclass(frozen=True)
class Control:
    """A number on a slider, a choice, or a switch.

    Attributes:
        name: What settings call it.
        label: What the page calls it.
        group: Under which heading it stands.
        default: Its value at first.
        choices: By value, what the page calls it; none for numbers and switches.
        least: Of a number.
        most: Of a number.
        step: Of a number; whole ones make an integer.
        unit: Of a number.
        ratio: Whether the slider goes in equal ratios.
        shown: Of other controls, the values with which this one has a meaning.
    """

    name: str
    label: str
    group: str
    default: Any
    choices: tuple[tuple[Any, str], ...] = ()
    least: float = 0.0
    most: float = 0.0
    step: float = 0.0
    unit: str = ""
    ratio: bool = False
    shown: tuple[tuple[str, tuple[Any, ...]], ...] = ()

    def checked(self, value: Any) -> Any:
        """Return a value if it is one of this control's."""
        if self.choices:
            # Hashing what came from outside might fail.
            if type(value) not in (str, int, float) or value not in [each for each, _ in self.choices]:
                raise ValueError(f"{self.name} must be one of {', '.join(repr(each) for each, _ in self.choices)}")
            return value
        if isinstance(self.default, bool):
            if not isinstance(value, bool):
                raise ValueError(f"{self.name} must be true or false")  # noqa: TRY004 (bad input has one kind here)
            return value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{self.name} must be a number")  # noqa: TRY004
        # An integer of a thousand digits is none that a float holds.
        if not (self.least <= value <= self.most):
            raise ValueError(f"{self.name} must lie within {self.least:g} to {self.most:g}")
        return round(value) if isinstance(self.default, int) else float(value)


def _choice(name: str, label: str, group: str, choices: dict[Any, str], default: Any = None, **more: Any) -> Control:
    first = next(iter(choices)) if default is None else default
    return Control(name, label, group, first, choices=tuple(choices.items()), **more)


def _number(
    name: str, label: str, group: str, default: float, least: float, most: float, step: float, unit: str = "",
    **more: Any,
) -> Control:  # fmt: skip
    return Control(name, label, group, default, least=least, most=most, step=step, unit=unit, **more)


def controls(
    meshes: Sequence[str] = (), heights: Sequence[str] = (), environments: Sequence[str] = ()
) -> dict[str, Control]:
    """All controls by name, with files that were named when the viewer was started, by their names on the page."""
    bodies = {f"file {index}": name for index, name in enumerate(meshes)} | BODIES
    surfaces = {f"file {index}": name for index, name in enumerate(heights)} | GRATINGS
    named = tuple(each for each in bodies if each not in LONG_BODIES)

    def of(*kinds: str) -> tuple[tuple[str, tuple[Any, ...]], ...]:
        return (("surface", kinds),)

    waves = of("sinusoidal", "lamellar", "blazed")
    body, surface, light, optics, picture = "Body", "Surface", "Light", "Optics", "Picture"
    found = [
        _choice("mesh", "mesh", body, bodies),
        _choice("along", "height field's x", body, {"around": "around the body", "along": "along the body"} | AXES,
                shown=(("mesh", LONG_BODIES),)),
        _choice("tangent", "height field's x", body, {"texture": "texture's u"} | AXES, shown=(("mesh", named),)),
        _number("pigment", "pigment", body, 0.05, 0.0, 2.0, 0.01),
        Control("smooth", "smooth normals", body, default=True),
        _choice("surface", "height field", surface, surfaces),
        _number("fingers_size_um", "size", surface, 25.6, 6.4, 64.0, 0.1, "µm", shown=of("fingers")),
        _number("fingers_period_um", "period", surface, 1.1, 0.6, 4.0, 0.01, "µm", shown=of("fingers")),
        _number("fingers_length_um", "length", surface, 3.0, 0.8, 6.0, 0.01, "µm", shown=of("fingers")),
        _number("fingers_height_um", "height", surface, 0.3, 0.0, 2.0, 0.01, "µm", shown=of("fingers")),
        _number("bumps_height_um", "height", surface, 0.15, 0.0, 1.0, 0.005, "µm", shown=of("bumps")),
        _number("bumps_width_um", "width, along x", surface, 0.5, 0.1, 2.0, 0.01, "µm", shown=of("bumps")),
        _number("bumps_length_um", "length, along y", surface, 1.0, 0.1, 2.0, 0.01, "µm", shown=of("bumps")),
        _number("bumps_spacing_x_um", "spacing along x", surface, 1.0, 0.5, 8.0, 0.01, "µm", shown=of("bumps")),
        _number("bumps_spacing_y_um", "spacing along y", surface, 2.0, 0.5, 8.0, 0.01, "µm", shown=of("bumps")),
        _number("period_um", "period", surface, 2.0, 0.3, 20.0, 0.01, "µm", ratio=True, shown=waves),
        _number("depth_um", "depth", surface, 0.25, 0.0, 2.0, 0.005, "µm", shown=waves),
        _number("duty", "share that is high", surface, 0.5, 0.05, 0.95, 0.01, shown=of("lamellar")),
        _choice("disc_kind", "kind", surface, {"CD": "CD", "DVD": "DVD", "Blu-ray": "Blu-ray"}, shown=of("disc")),
        _number("disc_length_um", "length", surface, 25.6, 16.0, 64.0, 0.1, "µm", shown=of("disc")),
        _number("seed", "seed", surface, 0, 0, 999, 1, shown=of("fingers", "disc")),
        *(_of_environments(environments) if environments else ()),
        _choice("light", "light", light,
                {**({"none": "none"} if environments else {}), "far": "far away", "near": "at a place"}),
        _number("azimuth_deg", "azimuth", light, 150.0, -180.0, 180.0, 0.1, "°", shown=(("light", ("far", "near")),)),
        _number("elevation_deg", "elevation", light, 60.0, -90.0, 90.0, 0.1, "°", shown=(("light", ("far", "near")),)),
        _number("distance", "distance from the body's centre", light, 2.0, 1.1, 20.0, 0.01, "its radii", ratio=True,
                shown=(("light", ("near",)),)),
        # Wider ones are several lights.
        _number("light_diameter_deg", "diameter", light, 0.0, 0.0, ONE_LOBE_DEG, 0.01, "°",
                shown=(("light", ("far",)), ("coherence", ("averaged",)))),
        _choice("illuminant", "illuminant", light, ILLUMINANTS, shown=(("light", ("far", "near")),)),
        Control("shadows", "shadows", light, default=True),
        _choice("coherence", "coherence", optics, {each: each for each in KINDS}),
        _number("sigma_um", "σ", optics, DEFAULT_SIGMA_UM, 1.0, 100.0, 0.05, "µm", ratio=True,
                shown=(("coherence", ("averaged", "centred")),)),
        _number("angular_diameter_deg", "source's diameter", optics, 0.53, 0.1, 20.0, 0.01, "°", ratio=True,
                shown=(("coherence", ("source",)),)),
        _number("copies_y", "copies along y", optics, 2, 1, 50, 1, shown=(("coherence", ("replicas",)),)),
        _number("copies_x", "copies along x", optics, 2, 1, 50, 1, shown=(("coherence", ("replicas",)),)),
        _choice("material", "material", optics, MATERIALS),
        _number("ior", "index of refraction", optics, 1.5, 1.01, 4.0, 0.01, shown=(("material", ("dielectric",)),)),
        _choice("energy", "energy", optics, ENERGIES),
        Control("masking", "masking and shadowing of the relief", optics, default=True,
                shown=(("energy", ("stam",)),)),
        _choice("height", "rows", picture, {each: str(each) for each in HEIGHTS}, 360),
        _choice("tolerance", "tolerance", picture, {0.1: "1e-1", 0.03: "3e-2", 0.01: "1e-2"}, 0.03),
        _choice("method", "method", picture, _METHODS),
        _choice("display", "display", picture,
                {"aces": "ACES 2.0", "colorimetric": "colorimetric", "clip": "clipped"}),
        _number("exposure_stops", "exposure", picture, 0.0, -8.0, 8.0, 0.1, "stops"),
        Control("held", "hold the automatic exposure", picture, default=False),
        _number("background", "background", picture, 0.1, 0.0, 1.0, 0.01),
    ]  # fmt: skip
    return {each.name: each for each in found}


def _of_environments(names: Sequence[str]) -> list[Control]:
    """Of the sky that lights a body, beside its light or in place of it."""
    sky, files = "Environment", {f"file {index}": name for index, name in enumerate(names)}
    is_shown = (("environment", tuple(files)), ("coherence", ("averaged",)))
    counts = {0: "by the tolerance", **{each: str(each) for each in DIRECTIONS}}
    return [
        _choice("environment", "environment", sky, files | {"none": "none"}, shown=is_shown[1:]),
        _number("environment_rotation_deg", "rotation", sky, 0.0, -180.0, 180.0, 0.1, "°", shown=is_shown),
        _number("environment_scale", "scale", sky, 1.0, 0.01, 100.0, 0.01, ratio=True, shown=is_shown),
        _choice("environment_directions", "directions a pixel", sky, counts, shown=is_shown),
        # A mirror shows a radiance of 1 some ten thousand times as bright as a light of a power of 1.
        _number("light_power", "power of the light beside it", sky, 1e4, 1.0, 1e6, 1.0, ratio=True,
                shown=(*is_shown, ("light", ("far", "near")))),
        Control("environment_behind", "shown behind the body", sky, default=True, shown=is_shown),
    ]  # fmt: skip


def described(known: dict[str, Control]) -> list[dict[str, Any]]:
    """Controls as the page takes them, in JSON."""
    return [asdict(each) for each in known.values()]


def defaults(known: dict[str, Control]) -> dict[str, Any]:
    """Values at first."""
    return {name: each.default for name, each in known.items()}


def checked(known: dict[str, Control], values: Any) -> dict[str, Any]:
    """Values for all controls: those that are given, else defaults; a ``ValueError`` tells of any that is none."""
    if not isinstance(values, dict):
        raise ValueError("settings must be an object")  # noqa: TRY004
    if unknown := [str(each)[:40] for each in values if each not in known]:
        raise ValueError(f"there is no control {unknown[0]!r}")
    return defaults(known) | {name: known[name].checked(value) for name, value in values.items()}


def vector(value: Any, name: str) -> tuple[float, float, float]:
    """Three finite numbers from outside."""
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{name} must be three numbers")
    for each in value:
        if isinstance(each, bool) or not isinstance(each, (int, float)) or not math.isfinite(_float(each)):
            raise ValueError(f"{name} must be three finite numbers")
    return _float(value[0]), _float(value[1]), _float(value[2])


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf
