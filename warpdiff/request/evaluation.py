"""``Evaluation``: checked settings with all defaults resolved, for the planner and the kernels.

A plan holds the numbers of a computation, such as the number of wavelengths. The planner selects it unless the caller
gives an explicit plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from warpdiff.core import forks, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.diffraction import energy_normalisation
from warpdiff.heightfield.edge_checks import warn_of_edges
from warpdiff.heightfield.field import check_whole
from warpdiff.heightfield.grating_map import GratingMap
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import IlluminatedMaterial, check_materials
from warpdiff.request.plan import Plan

if TYPE_CHECKING:
    import numpy as np
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.request.settings import CommonSettings


@dataclass(frozen=True)
class Evaluation:
    """Resolved settings of a call: surface, accuracy, method, light and device.

    Attributes:
        heightfield: Height field whose colours or spectra are computed.
        tolerance: Accepted relative error of XYZ, or of ρ for a spectrum.
        method: Method, one of ``settings.Method``: an expansion of exp(2πiκh) in κ = w/λ, or the direct sum.
        integration: Method of integrating over the wavelength, one of ``settings.Integration``.
        coherence: Coherence of the caller's plan. Without a plan, coherence of the settings. Without both, the default.
        normal_reflectance: Reflectance at normal incidence of the index of refraction; 1 for a material.
        materials: Materials by the name of a geometry. A single material has the name ``""``. A value of None selects
            the index of refraction.
        masking: Whether V-cavity masking is included.
        energy: ``"stam"``, or ``"normalised"`` if diffraction orders are scaled to sum to the reflected power.
        plan: Plan that the caller gave, or None if the planner selects one.
        strict: Whether a tolerance that cannot be met is an error.
        device: Warp device that runs the kernels.
        threads: Number of threads on the CPU.
        illuminated: Pairs of illuminant and material that occur in the call. A plan must meet the tolerance for each
            pair.
        wavelengths_nm: Wavelengths of a spectrum [nm]; None integrates over the wavelength.
        footprint: Whether a pixel shows the mean of the colours over the pixel filter, and not only at its centre.
    """

    heightfield: HeightField
    tolerance: float
    method: str
    integration: str
    coherence: Coherence
    normal_reflectance: float
    materials: dict[str, Material | None]
    masking: bool
    energy: str
    plan: Plan | None
    strict: bool
    device: wp.Device
    threads: int
    illuminated: tuple[IlluminatedMaterial, ...]
    wavelengths_nm: NDArray[np.float64] | None = None
    footprint: bool = False

    @classmethod
    def of(
        cls, heightfield: HeightField, settings: CommonSettings, *,
        illuminants: tuple[colorimetry.Illuminant, ...] = (), wavelengths_nm: NDArray[np.float64] | None = None,
        by_geometry: bool = False, footprint: bool = False,
    ) -> Evaluation:  # fmt: skip
        """Resolve the checked settings of a call for a height field: replace None by the defaults.

        ``by_geometry`` states whether the setting ``material`` may be a mapping from the names of a mesh's geometries
        to materials.
        """
        if isinstance(heightfield, GratingMap):
            raise ArgumentTypeError(
                f"{ref('heightfield')} must be a warpdiff.HeightField, got a GratingMap, which pictures of a mesh "
                "support, but not reflectances, baked tables, web pages and Mitsuba: give its cell, or use shade()"
            )
        check_whole(heightfield)
        for illuminant in illuminants:
            colorimetry.check_illuminant(illuminant)
        band_nm = (float(colorimetry.LAMBDA_MIN_NM), float(colorimetry.LAMBDA_MAX_NM))
        if wavelengths_nm is not None:
            band_nm = (float(wavelengths_nm.min()), float(wavelengths_nm.max()))
        normal, materials = check_materials(settings.ior, settings.material, band_nm, by_geometry=by_geometry)
        plan = getattr(settings, "plan", None)
        if plan is not None:
            validation.instance(plan, Plan, "plan")
        if wavelengths_nm is None and plan is not None and plan.wavelengths == 0:
            raise ArgumentValueError(
                f"{ref('plan')} has no wavelengths, as it was made for a spectrum; make one with "
                "warpdiff.plan(heightfield)"
            )
        energy = getattr(settings, "energy", "stam")
        warn_of_edges(heightfield, settings.effective_coherence, 1e-3 * band_nm[1])
        return cls(
            heightfield=heightfield, tolerance=settings.tolerance, method=settings.method,
            integration=settings.integration, coherence=settings.effective_coherence, normal_reflectance=normal,
            materials=materials, masking=getattr(settings, "masking", False) and energy == "stam", energy=energy,
            plan=plan, strict=settings.strict, device=resolve_device(settings.device),
            threads=resolve_threads(settings.threads),
            illuminated=IlluminatedMaterial.of(illuminants or ("D65",), materials.values()),
            wavelengths_nm=wavelengths_nm, footprint=footprint,
        )  # fmt: skip

    @property
    def conserves_energy(self) -> bool:
        """Whether all orders sum to the reflected power: energy is normalised, and no surface transmits light."""
        materials = self.materials.values()
        opaque = all(
            self.normal_reflectance == 1.0 if material is None else material.is_opaque for material in materials
        )
        return self.energy == "normalised" and opaque

    @forks.cached_property
    def energy_factors(self) -> energy_normalisation.AchromaticFactors | None:
        """Factors that multiply colours so that orders sum to the reflected power; None for ``energy="stam"``."""
        return None if self.energy == "stam" else energy_normalisation.achromatic_factors(self.heightfield)

    def with_energy(self, plan: Plan) -> Plan:
        """Return a copy of a plan with the field ``energy_spread`` of this evaluation.

        It states by how much the reflected power of single wavelengths deviates if energy is normalised.
        """
        spread = 0.0 if self.energy_factors is None else self.energy_factors.spread
        return plan if plan.energy_spread == spread else replace(plan, energy_spread=spread)

    @property
    def integrates(self) -> bool:
        """Whether the result is a colour, which is an integral over the wavelength λ, and not a spectrum."""
        return self.wavelengths_nm is None
