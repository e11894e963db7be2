"""Variables of derivatives: the functions that have derivatives with respect to each variable, and error messages."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, TypeVar

from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref
from warpdiff.request.signatures import checked

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material

Function = TypeVar("Function", bound="Callable[..., object]")

_ALL = ("order_efficiencies", "spectral_reflectance", "reflectance", "pixels")
_PLAIN = ("order_efficiencies", "spectral_reflectance", "reflectance")
_LOBES = ("spectral_reflectance", "reflectance")
_SPECTRA = ("order_efficiencies", "spectral_reflectance")
# Variables of derivatives: for each variable, the functions that have a derivative with respect to it, the shape of the
# derivative, and a condition on the arguments of the call.
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "heights_um": (_ALL, "(ny, nx)", "height field"),
    "vertices": (_ALL, "(k, 2): position in periods, height [µm]", "outline"),
    "height_scale": (_ALL, "()", ""),
    "pitch_um": (_PLAIN, "(2,), in the order (y, x)", "height field"),
    "period_um": (_PLAIN, "()", "outline"),
    "sigma_um": (_LOBES, "()", 'coherence "averaged" or "centred"'),
    "angular_diameter_deg": (_LOBES, "()", 'coherence "source"'),
    "to_light": (_PLAIN, "as the argument", ""),
    "to_view": (_LOBES, "as the argument", ""),
    "ior": (_ALL, "()", "finite index, no material; pixels: no base colour"),
    "n": (_SPECTRA, "(m,), one per wavelength", "material"),
    "k": (_SPECTRA, "(m,), one per wavelength", "material"),
    "film_nm": (_PLAIN, "()", "material with a film"),
    "wavelengths_nm": (("order_efficiencies",), "(m,)", ""),
}
# Names that users may take for variables, but that have no derivative, with the reason for the error message.
_WITHOUT = {
    "duty": "duty cycles of wd.gratings.lamellar move samples in steps; use wd.profiles.Trapezoid, whose duty is exact",
    "duty_cycle": "duty cycles of wd.gratings.lamellar move samples in steps; use wd.profiles.Trapezoid",
    "periods": "a number of periods is an integer",
    "rgb": "display colours are clipped; differentiate XYZ",
    "uint8": "display colours are rounded; differentiate XYZ",
    "despiked": "cleaning decides by thresholds; use 'heights_um' of the cleaned field",
    "filled": "filled samples are computed from others; use 'heights_um' of the filled field",
    "levelled": "a levelled field is computed from all samples; use 'heights_um' of the levelled field",
    "missing": "missing samples have no height",
    "masking": "masking is on or off",
}
# Arguments of the ordinary functions, such as `warpdiff.reflectance`, for which the functions with derivatives raise an
# error, with the reason.
_ARGUMENTS = {
    "method": "adjoints have one method of their own; use truncation",
    "integration": "adjoints integrate over sampled wavelengths; use truncation",
    "plan": "plans describe tables, which have no derivative; use truncation",
    "tolerance": "adjoints of single directions have no plan; use truncation",
    "energy": "factors of the normalised energy of colours are interpolated on a grid; use energy='stam'",
}


def differentiable(function: Function) -> Function:
    """Decorate a function so that it checks arguments; arguments in ``_ARGUMENTS`` raise an error with the reason."""
    inner, name = checked(function), function.__name__

    @functools.wraps(function)
    def call(*args: object, **keywords: object) -> object:
        for keyword in [key for key in keywords if key in _ARGUMENTS and key not in function.__annotations__]:
            if keyword != "energy" or keywords.pop("energy") != "stam":
                raise ArgumentValueError(
                    f"{ref(keyword)} has no derivative: {_ARGUMENTS[keyword]}. {_sentence(name, available(name))}"
                )
        return inner(*args, **keywords)

    return call  # type: ignore[return-value]


def available(
    function: str, *, coherence: Coherence | None = None, ior: float | None = None, material: Material | None = None,
    is_outline: bool | None = None, has_material: bool = False,
) -> tuple[str, ...]:  # fmt: skip
    """Return the names of the variables with respect to which a call of a function has derivatives.

    ``has_material`` states whether the reflectance depends on more than ``ior``, for example because parts of a mesh
    have materials.
    """
    absent = set()
    if coherence is not None:
        absent |= {"sigma_um"} if coherence.sigma_um is None else {"angular_diameter_deg"}
        absent |= {"angular_diameter_deg"} if coherence.angular_diameter_deg is None else set()
    if is_outline is not None:
        absent |= {"heights_um", "pitch_um"} if is_outline else {"vertices", "period_um"}
        has_material = has_material or material is not None
        absent |= {"ior"} if has_material or ior == math.inf else set()
        absent |= {"n", "k"} if material is None else set()
        absent |= {"film_nm"} if material is None or material.film is None else set()
    return tuple(name for name, (functions, _, _) in VARIABLES.items() if function in functions and name not in absent)


def check_variables(function: str, wrt: Sequence[str], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return ``wrt`` as a tuple without duplicates.

    Args:
        function: Name of the function, for messages.
        wrt: Names of the variables that the caller requests.
        names: Names of the variables that have a derivative.

    Raises:
        TypeError: ``wrt`` is a string or not a sequence of strings.
        ValueError: A name is not that of a variable with a derivative.
    """
    if not isinstance(wrt, (tuple, list)) or not all(isinstance(name, str) for name in wrt):
        raise ArgumentTypeError(f"{ref('wrt')} must be a tuple of names, such as ('heights_um',), got {wrt!r}")
    for name in wrt:
        if name not in names:
            reason = _WITHOUT.get(name, "")
            if name in VARIABLES:
                condition = VARIABLES[name][2]
                reason = f"it requires: {condition}" if condition and function in VARIABLES[name][0] else ""
            hint = f": {reason}" if reason else did_you_mean(name, names)
            raise ArgumentValueError(
                f"{ref('wrt')} contains {name!r}, which has no derivative here{hint}. {_sentence(function, names)}"
            )
    return tuple(dict.fromkeys(wrt))


def _sentence(function: str, names: tuple[str, ...]) -> str:
    return f"{function} has derivatives by {', '.join(names)}"


def table() -> str:
    """Return the documentation's table of all variables and the functions with their derivatives, in Markdown."""
    lines = [
        f"| variable | {' | '.join(f'`{function}`' for function in _ALL)} | shape | condition |",
        f"| --- |{' --- |' * (len(_ALL) + 2)}",
    ]
    for name, (functions, shape, condition) in VARIABLES.items():
        marks = " | ".join("yes" if function in functions else "–" for function in _ALL)
        lines.append(f"| `{name}` | {marks} | {shape} | {condition} |")
    return "\n".join(lines)
