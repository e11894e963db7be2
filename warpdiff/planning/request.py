"""A request: what the caller of any function asks for, checked once and carried from there on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from warpdiff.compute.device import resolve_device, resolve_threads
from warpdiff.core import checks, fork_safety
from warpdiff.fourier import energy_balance
from warpdiff.optics import colorimetry
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import LitMaterial, check_materials
from warpdiff.plans.plan import METHODS, Plan, check_method, check_tolerance
from warpdiff.surface.heightfield import check_whole

if TYPE_CHECKING:
    import numpy as np
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.optics.materials import Material
    from warpdiff.surface.heightfield import HeightField


@dataclass(frozen=True)
class Request:
    """How exactly, by what, under which light and where something is to be computed.

    Attributes:
        hf: Of what.
        tolerance: Error of XYZ, or of ρ.
        method: A legal name.
        coherence: The window, source or copies: what was given, an explicit plan's, or the default.
        normal_reflectance: R(0) of the index of refraction; 1 of a material.
        materials: Those by name of a geometry; one has none, ``""``, and None is that of the index of refraction.
        masking: Whether V-cavity masking is included.
        energy: One of ``energy_balance.FORMS``.
        plan: An explicit plan.
        strict: Whether a tolerance that cannot be met is an error.
        device: The Warp device.
        threads: Threads on the CPU.
        lit: Illuminants with the materials that they fall on, of which the worst counts.
        wavelengths_nm: In place of an integral over λ.
        footprint: Whether pixels show means over what they see.
    """

    hf: HeightField
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
    lit: tuple[LitMaterial, ...] = (LitMaterial("D65"),)
    wavelengths_nm: NDArray[Any] | None = None
    footprint: bool = False
    energy: str = "stam"

    @classmethod
    def checked(
        cls,
        hf: Any,
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
        check_whole(hf)
        check_tolerance(tolerance)
        checks.choice(method, "method", METHODS)
        checks.instance(coherence, Coherence, "coherence", optional=True)
        check_method(method, coherence or Coherence())
        checks.flag(strict, "strict")
        checks.flag(masking, "masking")
        checks.choice(energy, "energy", energy_balance.FORMS)
        checks.callback(progress, "progress")
        workers = resolve_threads(threads)
        on = resolve_device(device)
        for name in illuminants:
            colorimetry.check_illuminant(name)
        band = (float(colorimetry.LAMBDA_MIN_NM), float(colorimetry.LAMBDA_MAX_NM))
        if wavelengths_nm is not None:
            band = (float(wavelengths_nm.min()), float(wavelengths_nm.max()))
        normal, materials = check_materials(ior, material, band, by_geometry=by_geometry)
        lit = LitMaterial.of(illuminants or ("D65",), materials.values())
        if plan is not None:
            _check_plan(plan, coherence, colour=wavelengths_nm is None)
        return cls(
            hf=hf, tolerance=tolerance, method=method,
            coherence=plan.coherence if plan is not None else coherence or Coherence(), normal_reflectance=normal,
            materials=materials, masking=masking and energy == "stam", plan=plan, strict=strict, device=on,
            threads=workers, lit=lit, wavelengths_nm=wavelengths_nm, energy=energy,
        )  # fmt: skip

    @fork_safety.cached_property
    def energy_factors(self) -> energy_balance.AchromaticFactors | None:
        """What colours are multiplied by where energy is normalised."""
        return None if self.energy == "stam" else energy_balance.achromatic_factors(self.hf)

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
        raise TypeError(f"plan must be a warpdiff.Plan, such as warpdiff.plan(hf) returns, got {type(plan).__name__}")
    if coherence is not None and coherence != plan.coherence:
        raise ValueError("coherence differs from the one in plan=; give one of them, or dataclasses.replace the plan's")
    if colour and plan.wavelengths == 0:
        raise ValueError("plan has no wavelengths, it was made for given ones; make one with warpdiff.plan(hf)")
