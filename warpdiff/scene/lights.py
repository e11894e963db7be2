"""Light sources: directional lights with an illuminant and a power."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from warpdiff.core import checks

# Squares of colours are float32.
_MOST_POWER = 1e12


@dataclass(frozen=True)
class DirectionalLight:
    """Light from infinitely far away.

    Attributes:
        to_light: Direction from the surface towards the light, world frame; it is normalised.
        illuminant: Name of the light's CIE illuminant.
        power: Linear factor, up to 1e12; at 1 a flat mirror in the mirror direction shows Y = 1.
    """

    to_light: tuple[float, float, float]
    _: KW_ONLY
    illuminant: str = "D65"
    power: float = 1.0

    def __post_init__(self) -> None:
        unit = checks.directions(checks.vector(self.to_light, "to_light"), "to_light")[0][0]
        object.__setattr__(self, "to_light", (float(unit[0]), float(unit[1]), float(unit[2])))
        if not isinstance(self.illuminant, str):
            raise TypeError(
                f"illuminant must be the name of a CIE illuminant, such as 'D65', got {type(self.illuminant).__name__}"
            )
        object.__setattr__(self, "power", checks.number(self.power, "power", least=0.0, most=_MOST_POWER))
