"""A request: what the caller of any function asks for, checked once and carried from there on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from warpdiff.core import forks, validation
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.diffraction import energy_normalisation
from warpdiff.heightfield.field import check_whole
from warpdiff.optics import colorimetry
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import IlluminatedMaterial, check_materials
from warpdiff.request.plan import METHODS, Plan, check_method, check_tolerance

if TYPE_CHECKING:
    import numpy as np
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import Material


@dataclass(frozen=True)
class Request:
    """How exactly, by what, under which light and where something is to be computed.

    Attributes:
        heightfield: Of what.
        tolerance: Error of XYZ, or of ρ.
        method: A legal name.
        coherence: The window, source or copies: what was given, an explicit plan's, or the default.
        normal_reflectance: R(0) of the index of refraction; 1 of a material.
        materials: Those by name of a geometry; one has none, ``""``, and None is that of the index of refraction.
        masking: Whether V-cavity masking is included.
        energy: One of ``energy_normalisation.FORMS``.
        plan: An explicit plan.
        strict: Whether a tolerance that cannot be met is an error.
        device: The Warp device.
        threads: Threads on the CPU.
        illuminated: Illuminants with the materials that they fall on, of which the worst counts.
        wavelengths_nm: In place of an integral over λ.
        footprint: Whether pixels show means over what they see.
    """

    heightfield: HeightField
    tolerance: float
    method: str
    coherence: Coherence
    normal_reflectance: float
    materials: dict[str, Material | None]
    masking: bool
    plan: Plan | None
    strict: bool
    device: wp.Device
    threads: int
    illuminated: tuple[IlluminatedMaterial, ...] = (IlluminatedMaterial("D65"),)
    wavelengths_nm: NDArray[Any] | None = None
    footprint: bool = False
    energy: str = "stam"

    @classmethod
    def checked(
        cls,
        heightfield: Any,
        *,
        tolerance: Any,
        method: Any,
        coherence: Any,
        ior: Any,
        masking: Any,
        strict: Any,
        device: Any,
        threads: Any,
        plan: Any = None,
        progress: Any = None,
        material: Any = None,
        by_geometry: bool = False,
        illuminants: tuple[Any, ...] = (),
        wavelengths_nm: NDArray[np.float64] | None = None,
        energy: Any = "stam",
    ) -> Request:
        """Refuse what is no such thing, before anything is computed; wavelengths are checked by who takes them.

        Materials may be given ``by_geometry``, as a mapping from its name.
        """
        check_whole(heightfield)
        check_tolerance(tolerance)
        validation.choice(method, "method", METHODS)
        validation.instance(coherence, Coherence, "coherence", optional=True)
        check_method(method, coherence or Coherence())
        validation.flag(strict, "strict")
        validation.flag(masking, "masking")
        validation.choice(energy, "energy", energy_normalisation.FORMS)
        validation.callback(progress, "progress")
        workers = resolve_threads(threads)
        on = resolve_device(device)
        for name in illuminants:
            colorimetry.check_illuminant(name)
        band = (float(colorimetry.LAMBDA_MIN_NM), float(colorimetry.LAMBDA_MAX_NM))
        if wavelengths_nm is not None:
            band = (float(wavelengths_nm.min()), float(wavelengths_nm.max()))
        normal, materials = check_materials(ior, material, band, by_geometry=by_geometry)
        illuminated = IlluminatedMaterial.of(illuminants or ("D65",), materials.values())
        if plan is not None:
            _check_plan(plan, coherence, colour=wavelengths_nm is None)
        return cls(
            heightfield=heightfield, tolerance=tolerance, method=method,
            coherence=plan.coherence if plan is not None else coherence or Coherence(), normal_reflectance=normal,
            materials=materials, masking=masking and energy == "stam", plan=plan, strict=strict, device=on,
            threads=workers, illuminated=illuminated, wavelengths_nm=wavelengths_nm, energy=energy,
        )  # fmt: skip

    @forks.cached_property
    def energy_factors(self) -> energy_normalisation.AchromaticFactors | None:
        """What colours are multiplied by where energy is normalised."""
        return None if self.energy == "stam" else energy_normalisation.achromatic_factors(self.heightfield)

    def with_energy(self, plan: Plan) -> Plan:
        """A plan that says what the energy of this request leaves out; itself, if it does."""
        spread = 0.0 if self.energy_factors is None else self.energy_factors.spread
        return plan if plan.energy_spread == spread else replace(plan, energy_spread=spread)

    @property
    def integrates(self) -> bool:
        """Whether colours are asked for, which are integrals over λ."""
        return self.wavelengths_nm is None


def _check_plan(plan: Any, coherence: Coherence | None, *, colour: bool) -> None:
    """Refuse an explicit plan that the call cannot use."""
    if not isinstance(plan, Plan):
        raise TypeError(
            f"plan must be a warpdiff.Plan, such as warpdiff.plan(heightfield) returns, got {type(plan).__name__}"
        )
    if coherence is not None and coherence != plan.coherence:
        raise ValueError("coherence differs from the one in plan=; give one of them, or dataclasses.replace the plan's")
    if colour and plan.wavelengths == 0:
        raise ValueError(
            "plan has no wavelengths, it was made for given ones; make one with warpdiff.plan(heightfield)"
        )
