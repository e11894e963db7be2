"""Controls of the viewer's page: options of the library with labels, groups and sliders.

The type, the choices, the unit and the meaning of a control come from the description of its option. An option of a
picture or of its display that has no entry in :func:`controls` gets a control from its description alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from warpdiff.core import validation
from warpdiff.core.options import Kind, Option, describe
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.lights.directional import ONE_LOBE_DEG, DirectionalLight
from warpdiff.lights.environment import Environment
from warpdiff.optics.coherence import DEFAULT_SIGMA_UM, Coherence
from warpdiff.optics.materials import DEFAULT_IOR
from warpdiff.request.settings import TANGENT_RULES, DisplaySettings, PictureSettings
from warpdiff.samples import gratings
from warpdiff.scene.camera import View

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

BODIES = {"snake": "snake", "tube": "tube", "disc": "disc", "card": "card"}
# Names of long sample meshes, on which the height field's x axis can point around the mesh or along it.
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
# Labels of the values of the option ``tangents`` that are names of rules, not vectors.
RULES = {rule: rule.replace("around-", "around world ") if len(rule) > 1 else f"world {rule}" for rule in TANGENT_RULES}
# Options of pictures and of their display that have no control of the same name on the page.
EXCLUDED = (
    # Several controls together set each of these options: the controls of coherence, of material, and of the height
    # field's x axis.
    *("coherence", "material", "tangents"),
    # Options that the command line of ``warpdiff view`` sets.
    *("device", "threads"),
    # Options that the viewer sets, because it refines a picture in stages until the tolerance is met.
    *("tolerance", "refine", "strict", "plan"),
    # Options that the library's planner selects automatically, from the tolerance and the coherence.
    *("integration", "footprint", "samples_per_pixel"),
    # Options of the display. Another control selects automatic or locked exposure. The gamut is sRGB, which browsers
    # assume, and saved files have 8 bits per channel.
    *("exposure", "gamut", "bits"),
)
_SKY = "Environment"
# Value of the control "environment" that selects the computed clear sky instead of a file.
CLEAR_SKY = "clear sky"
# Label and help text of the two controls that set the height field's x axis, "along" and "tangent".
_X_AXIS = "x axis of the height field", "Direction of the height field's x axis on the body."
_DIRECTIONS = {0: "64", 16: "16", 256: "256", 1024: "1024"}
_TOLERANCES = {0.1: "1e-1", 0.03: "3e-2", 0.01: "1e-2"}
_DISPLAYS = {"aces": "ACES 2.0", "colorimetric": "colorimetric", "clip": "clipped"}
# Picture heights that the page offers [pixels].
_ROWS = {240: "240", 360: "360", 480: "480", 720: "720", 960: "960"}
# Names of arguments of the library that no control sets, as error messages on the page print them.
_WORDS = {
    "lights": "light", "heightfield": "height field", "to_light": "direction of the light", "view": "camera",
    "tangents": _X_AXIS[0],
}  # fmt: skip
_UNITS = {"um": "µm", "deg": "°"}
# Lowest value, highest value and step of a slider; None is no slider.
Slider = tuple[float, float, float] | None
_JSON_TYPES = {str: "string", int: "integer", float: "number", bool: "boolean"}


@dataclass(frozen=True)
class Control:
    """Control of the page.

    Attributes:
        option: Description of the library's option that the control sets: type, choices, meaning, unit and default.
        group: Heading of the group that contains the control.
        label: Text next to the control.
        slider: Lowest value, highest value and step, for a number.
        log: Whether the slider is logarithmic.
        shown_if: Conditions for showing the control and using its value: names of other controls, each with the values
            that fulfil the condition.
        default: Initial value; None is the default of the option.
        labels: Texts of the choices by value; empty prints the option's values.
        name: Name of the control on the page; empty is the option's name.
        call: Library call that gets the value as an argument: ``"picture"``, ``"display"``, ``"coherence"``,
            ``"heightfield"``, ``"light"`` or ``"environment"``; empty if the viewer uses the value in another way.
        element: Index of the value in an option that is a pair (y, x); None if the value is the whole option.
    """

    option: Option
    group: str
    label: str
    slider: Slider = None
    log: bool = False
    shown_if: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    default: Any = None
    labels: Mapping[Any, str] = field(default_factory=dict)
    name: str = ""
    call: str = ""
    element: int | None = None

    def __post_init__(self) -> None:
        default = self.option.default if self.default is None else self.default
        # Empty attributes get their values from the option: name, default and labels. They are set in the dictionary of
        # the object, because a frozen dataclass does not allow assignments.
        vars(self).update(
            name=self.name or self.option.name,
            default=default if self.element is None or not isinstance(default, tuple) else default[self.element],
            labels=self.labels or {choice: str(choice) for choice in self.option.choices},
        )

    def check(self, value: Any) -> Any:
        """Return a value if the control accepts it; raise an error with the control's name otherwise."""
        if self.labels:
            # A page may send a list, which cannot be looked up in a dictionary. The type of the value is therefore
            # checked first.
            if type(value) not in (str, int, float) or value not in self.labels:
                names = ", ".join(map(repr, self.labels.values()))
                raise ArgumentValueError(f"{ref(self.name)} must be one of {names}, got {value!r:.60}")
            return next(choice for choice in self.labels if choice == value)
        # Error messages say "on or off" instead of True or False, because users of the page may not know Python.
        kinds, rule = (bool, "on or off") if self.slider is None else ((int, float), "a number")
        if not isinstance(value, kinds) or (self.slider and isinstance(value, bool)):
            raise ArgumentTypeError(f"{ref(self.name)} must be {rule}, got {value!r:.60}")
        if self.slider is None:
            return value
        low, high, _ = self.slider
        number = validation.number(value, self.name, least=low, most=high)
        return round(number) if self.option.kind in ("integer", "integers") else number

    def is_shown(self, values: Mapping[str, Any]) -> bool:
        """Whether the page shows this control for the given values of all controls. A hidden control has no effect."""
        return all(values.get(name) in choices for name, choices in self.shown_if.items())

    @property
    def argument(self) -> str:
        """Name of the argument that the control sets, as in the library's messages, for example ``periods[0]``."""
        return self.option.name if self.element is None else f"{self.option.name}[{self.element}]"

    @property
    def schema(self) -> dict[str, Any]:
        """Description of the control for the page, by the keys of JSON Schema, with further keys in ``"x-ui"``."""
        low, high, step = self.slider or (None, None, None)
        kind = "integer" if self.option.kind in ("integer", "integers") else _JSON_TYPES[type(self.default)]
        described = {
            "name": self.name, "title": self.label, "description": _plain(self.option.help), "type": kind,
            "enum": list(self.labels) or None, "minimum": low, "maximum": high, "default": self.default,
        }  # fmt: skip
        unit = self.option.unit or _UNITS.get(self.option.name.rpartition("_")[2], "")
        ui = {
            "group": self.group, "labels": list(self.labels.values()), "step": step, "log": self.log, "unit": unit,
            "shown_if": self.shown_if,
        }  # fmt: skip
        return {key: value for key, value in described.items() if value is not None} | {"x-ui": ui}


def controls(
    meshes: Sequence[str] = (), heights: Sequence[str] = (), environments: Sequence[str] = ()
) -> dict[str, Control]:
    """Return all controls of the page by name.

    Args:
        meshes: Names of mesh files that the page offers.
        heights: Names of files of height fields that the page offers.
        environments: Names of files of environment lights that the page offers.
    """
    bodies, surfaces, named_skies = _files(meshes) | BODIES, _files(heights) | GRATINGS, _files(environments)
    skies, none = named_skies | {CLEAR_SKY: "clear sky with a sun"}, {"none": "none"}
    # The first choice of a control is its default. If there are environment files, the page starts with the first file
    # and no other light. Otherwise the page starts with a directional light.
    lights = (none if environments else {}) | {"directional": "directional", "point": "point"} | none
    others = tuple(name for name in bodies if name not in LONG_BODIES)
    picture, window, display = describe(PictureSettings), describe(Coherence), describe(DisplaySettings)
    light, sky, clear = describe(DirectionalLight), describe(Environment.load), describe(Environment.clear_sky)
    methods = {method: method for method in picture["method"].choices if method != "direct"}
    any_light, any_window = {"light": ("directional", "point")}, {"coherence": ("averaged", "centred")}
    averaged, source, replicas = ({"coherence": (kind,)} for kind in ("averaged", "source", "replicas"))
    any_sky = averaged | {"environment": tuple(skies)}
    any_file, clear_sky = averaged | {"environment": tuple(named_skies)}, averaged | {"environment": (CLEAR_SKY,)}
    waves = "sinusoidal", "lamellar", "blazed"
    entries = [
        _own("mesh", "Body", "mesh", "Mesh whose surface carries the height field.", labels=bodies),
        _own("along", "Body", *_X_AXIS, shown_if={"mesh": LONG_BODIES},
             labels={"around": "around the body", "along": "along the body"} | RULES),
        _own("tangent", "Body", *_X_AXIS, shown_if={"mesh": others}, labels={"texture": "texture's u"} | RULES),
        Control(picture["pigment"], "Body", "pigment", (0.0, 2.0, 0.01), default=0.05, call="picture"),
        Control(picture["smooth"], "Body", "smooth normals", call="picture"),
        _own("surface", "Surface", "height field", "Height field on the body's surface.", labels=surfaces),
        _of_gratings("size_um", "size", (6.4, 64.0, 0.1), "fingers"),
        _of_gratings("period_um", "period", (0.6, 4.0, 0.01), "fingers"),
        _of_gratings("length_um", "length", (0.8, 6.0, 0.01), "fingers"),
        _of_gratings("height_um", "height", (0.0, 2.0, 0.01), "fingers"),
        _of_gratings("height_um", "height", (0.0, 1.0, 0.005), "bumps"),
        _of_gratings("width_um", "width along x", (0.1, 2.0, 0.01), "bumps"),
        _of_gratings("length_um", "length along y", (0.1, 2.0, 0.01), "bumps"),
        *(_of_gratings("spacing_um", f"spacing along {axis}", (0.5, 8.0, 0.01), "bumps",
                       name=f"bumps_spacing_{axis}_um", element=element) for element, axis in enumerate("yx")),
        _of_gratings("period_um", "period", (0.3, 20.0, 0.01), *waves, log=True, default=2.0),
        _of_gratings("depth_um", "depth", (0.0, 2.0, 0.005), *waves, default=0.25),
        _of_gratings("duty", "duty cycle", (0.05, 0.95, 0.01), "lamellar"),
        _of_gratings("kind", "kind", None, "disc"),
        _of_gratings("length_um", "length", (16.0, 64.0, 0.1), "disc"),
        _of_gratings("seed", "seed", (0, 999, 1), "fingers", "disc"),
        _own("environment", _SKY, "environment", "Sky or room.", shown_if=averaged,
             labels=skies | none if environments else none | skies),
        Control(sky["rotation_deg"], _SKY, "rotation", (-180.0, 180.0, 0.1), shown_if=any_file,
                name="environment_rotation_deg", call="environment"),
        _own("sun_azimuth_deg", _SKY, "sun's azimuth", "Angle about +y, from the front to the right.", 60.0,
             slider=(-180.0, 180.0, 0.1), shown_if=clear_sky),
        _own("sun_elevation_deg", _SKY, "sun's elevation", "Angle above the horizon.", 45.0, slider=(1.0, 90.0, 0.1),
             shown_if=clear_sky),
        Control(clear["ground_albedo"], _SKY, "albedo of the ground", (0.0, 1.0, 0.01), shown_if=clear_sky,
                name="environment_ground_albedo", call="environment"),
        Control(sky["scale"], _SKY, "scale", (0.01, 100.0, 0.01), log=True, shown_if=any_sky,
                name="environment_scale", call="environment"),
        Control(sky["directions"], _SKY, "directions per pixel", shown_if=any_sky, default=0, labels=_DIRECTIONS,
                name="environment_directions", call="environment"),
        # The default of the light's power is 10,000: in the mirror direction of a surface, an environment of radiance 1
        # looks about as bright as a directional light of power 10,000.
        Control(light["power"], _SKY, "power of the light", (1.0, 1e6, 1.0), log=True, shown_if=any_sky | any_light,
                default=1e4, name="light_power", call="light"),
        _own("environment_behind", _SKY, "show as background", "Whether it is the background.", True, shown_if=any_sky),
        _own("light", "Light", "light", "Kind of light.", labels=lights),
        _own("azimuth_deg", "Light", "azimuth", "Angle about +y, from the front to the right.", 150.0,
             slider=(-180.0, 180.0, 0.1), shown_if=any_light),
        _own("elevation_deg", "Light", "elevation", "Angle above the horizon.", 60.0, slider=(-90.0, 90.0, 0.1),
             shown_if=any_light),
        _own("distance", "Light", "distance", "Distance of the light from the body's centre.", 2.0, "body radii",
             slider=(1.1, 20.0, 0.01), log=True, shown_if={"light": ("point",)}),
        # Previews (unrefined pictures) approximate a disc light by a single Gaussian of directions. The slider ends at
        # the largest diameter for which this approximation is accepted.
        Control(light["angular_diameter_deg"], "Light", "angular diameter", (0.0, ONE_LOBE_DEG, 0.01),
                shown_if=averaged | {"light": ("directional",)}, name="light_diameter_deg", call="light"),
        Control(light["illuminant"], "Light", "illuminant", shown_if=any_light, labels=ILLUMINANTS, call="light"),
        Control(picture["shadows"], "Light", "shadows", call="picture"),
        Control(window["kind"], "Optics", "coherence", name="coherence", call="coherence"),
        Control(window["sigma_um"], "Optics", "σ", (1.0, 100.0, 0.05), log=True, shown_if=any_window,
                default=DEFAULT_SIGMA_UM, call="coherence"),
        Control(window["angular_diameter_deg"], "Optics", "angular diameter of the source", (0.1, 20.0, 0.01), log=True,
                shown_if=source, default=0.53, name="source_diameter_deg", call="coherence"),
        *(Control(window["periods"], "Optics", f"periods along {axis}", (1, 50, 1), shown_if=replicas, default=2,
                  name=f"periods_{axis}", call="coherence", element=element) for element, axis in enumerate("yx")),
        _own("material", "Optics", "material", "Material of the surface.", labels=MATERIALS),
        Control(picture["ior"], "Optics", "index of refraction", (1.01, 4.0, 0.01), default=DEFAULT_IOR,
                call="picture", shown_if={"material": ("dielectric",)}),
        Control(picture["energy"], "Optics", "energy", call="picture"),
        Control(picture["masking"], "Optics", "masking and shadowing", shown_if={"energy": ("stam",)}, call="picture"),
        Control(describe(View)["height"], "Picture", "picture height", default=360, labels=_ROWS),
        Control(picture["tolerance"], "Picture", "tolerance", default=0.03, labels=_TOLERANCES),
        Control(picture["method"], "Picture", "method", labels=methods, call="picture"),
        Control(display["display"], "Picture", "display", labels=_DISPLAYS, call="display"),
        Control(display["exposure_stops"], "Picture", "exposure", (-8.0, 8.0, 0.1), call="display"),
        _own("lock_exposure", "Picture", "lock the exposure", "Whether the automatic exposure stays.", False),
        _own("background", "Picture", "background", "Encoded grey level.", 0.1, slider=(0.0, 1.0, 0.01)),
    ]  # fmt: skip
    for settings, call in ((PictureSettings, "picture"), (DisplaySettings, "display")):
        known = {control.option.name for control in entries if control.call == call} | set(EXCLUDED)
        entries += _further(settings, call, known)
    return {control.name: control for control in entries}


def _files(names: Sequence[str]) -> dict[str, str]:
    return {f"file {index}": name for index, name in enumerate(names)}


def _own(name: str, group: str, label: str, text: str, default: Any = None, unit: str = "", **more: Any) -> Control:
    """Return a control for a value that is not an option of the library: a choice, a flag or a number.

    With the argument ``labels``, the control is a choice, and the first label is its default.
    """
    labels = more.get("labels")
    kind: Kind = "choice" if labels else "flag" if isinstance(default, bool) else "number"
    return Control(Option(name, kind, next(iter(labels or (default,))), text, unit=unit), group, label, **more)


def _of_gratings(argument: str, label: str, slider: Slider, *kinds: str, **more: Any) -> Control:
    """Return the control of an argument of synthetic gratings. The page shows it while one of ``kinds`` is selected."""
    option = describe(getattr(gratings, kinds[0]))[argument]
    more = {"name": f"{kinds[0]}_{argument}"} | more
    return Control(option, "Surface", label, slider, shown_if={"surface": kinds}, call="heightfield", **more)


def _further(settings: type, call: str, known: set[str]) -> list[Control]:
    """Return controls for the options of a class that are flags, choices or bounded numbers, except ``known`` ones.

    Args:
        settings: Class of settings.
        call: Library call that accepts the settings, as in :class:`Control`.
        known: Names of options that have a control, or need none.
    """
    result = []
    for option in describe(settings).values():
        slider: Slider = None
        low, high = option.gt if option.ge is None else option.ge, option.le
        if option.kind in ("integer", "number") and low is not None and high is not None:
            step = 1 if option.kind == "integer" else (high - low) / 200.0
            slider = (low if option.ge is not None else low + step, high, step)
        if option.name not in known and not option.optional and (slider or option.kind in ("flag", "choice")):
            result.append(Control(option, "Picture", option.name.replace("_", " "), slider, call=call))
    return result


def _plain(text: str) -> str:
    """Return the help text of an option without reStructuredText markup."""
    return re.sub(r":\w+:`~?([^`]*)`|``([^`]*)``", lambda match: (match[1] or match[2]).replace('"', ""), text)


def described(known: dict[str, Control]) -> list[dict[str, Any]]:
    """Return the descriptions of all controls, which the page receives as JSON."""
    return [control.schema for control in known.values()]


def defaults(known: dict[str, Control]) -> dict[str, Any]:
    """Return the initial value of each control by name."""
    return {name: control.default for name, control in known.items()}


def checked(known: dict[str, Control], values: Any) -> dict[str, Any]:
    """Return a checked value for each control by name; controls that are absent from ``values`` get their default."""
    if not isinstance(values, dict):
        raise ArgumentTypeError("the values of the controls must be a JSON object")
    if unknown := [str(name)[:40] for name in values if name not in known]:
        raise ArgumentValueError(f"there is no control {unknown[0]!r}")
    return defaults(known) | {name: known[name].check(value) for name, value in values.items()}


def arguments(known: dict[str, Control], values: Mapping[str, Any], call: str) -> dict[str, Any]:
    """Return the keyword arguments that the shown controls set in a library call, without default values.

    Args:
        known: All controls by name.
        values: Value of each control by name.
        call: Library call, as in :class:`Control`.
    """
    result: dict[str, Any] = {}
    standard: dict[str, Any] = {}
    for control in known.values():
        if control.call == call and control.is_shown(values):
            option, value = control.option, values[control.name]
            result[option.name] = value if control.element is None else (*result.get(option.name, ()), value)
            # An argument is omitted from the call if its value equals the default of the library. If the library's
            # default is None, the value is compared with the control's default instead, which is the value that the
            # library uses for None.
            is_none = option.default is None and control.element is None
            standard[option.name] = control.default if is_none else option.default
    return {name: value for name, value in result.items() if value != standard[name]}


def word(known: dict[str, Control], values: Mapping[str, Any]) -> Callable[[str, str | None], str]:
    """Return a function that replaces the name of an argument in a message by the label of the control that sets it."""
    labels = _WORDS | {control.name: control.label for control in known.values()}
    for control in known.values():
        if control.call and control.is_shown(values):
            labels[control.argument] = control.label
            labels.setdefault(control.option.name, control.label.partition(" along ")[0])

    def write(name: str, value: str | None) -> str:
        first, last = re.split(r"[\[.(]", name, maxsplit=1)[0], name.rpartition(".")[2]
        label = labels.get(name) or labels.get(last) or labels.get(first, name)
        return label if value is None else f"{label} = {value.strip(chr(39))}"

    return write
