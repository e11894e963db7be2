"""``Plan``: the numbers of a computation with predicted errors, and the coherences that each method supports."""

from __future__ import annotations

import html
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, get_args

from warpdiff.core import files, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.diffraction.coefficient_basis import METHODS as EXPANDED
from warpdiff.diffraction.coefficient_basis import POWER_METHODS, holds_powers
from warpdiff.diffraction.phase_series import EXPANSIONS, MAX_TERMS
from warpdiff.heightfield.theory_verdict import Reason, TheoryVerdict, theory_wavelength_nm
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.colorimetry import LONGEST_NM, SHORTEST_NM
from warpdiff.request.directions import DirectionRange

if TYPE_CHECKING:
    import os
    from pathlib import Path

# Format of saved plans (numbers of computations), written to each file. The number increases when a field of a plan
# changes its name or meaning.
_FORMAT = "warpdiff plan 2"
# Largest size of a file that is read as a plan (numbers of a computation) [bytes]. A plan has about 1 kB. A much larger
# file is therefore not a plan, and raises an error.
_MOST_BYTES = 1 << 20
METHODS = ("auto", *EXPANDED, "direct")
AUTOMATIC = "low-rank"
LABELS = {
    "low-rank": "Low-rank basis",
    "power": "Chebyshev series of the powers",
    **{name: f"{expansion.label} series" for name, expansion in EXPANSIONS.items()},
}
# Measured speeds of one CPU core [multiply-adds per second]. The first speed is for sums over wavelengths and for the
# computation of colour tables. The second speed is for look-ups in them, which the memory slows down. The speeds
# convert predicted costs to the times that a plan reports.
_SUMMED_PER_SECOND, _LOOKED_UP_PER_SECOND = 9e9, 2.7e9
# Smallest and largest number of rings of a colour table per octave of |(u, v)|. A ring is a circle of samples around
# (u, v) = 0, and an octave is a factor of 2.
MIN_RINGS, MAX_RINGS = 4, 512
# A colour table has functions of w, the normal component of the scattering vector. Their number is a multiple of
# `W_BASIS_STEP`, and at most `MOST_W_BASIS`. Kernels are compiled separately for each number of functions that occurs.
# A smaller step would cause more compilations.
W_BASIS_STEP, MOST_W_BASIS = 4, 32
# Smallest and largest accepted value of each field of a plan that states for which directions and wavelengths a plan is
# valid. The limit 2.001 is for components of the scattering vector: each is the sum of components of two unit vectors,
# plus rounding.
_SCOPE = {
    **dict.fromkeys(("max_uv", "min_w", "max_w"), (0.0, 2.001)),
    **dict.fromkeys(("max_order_rate", "height_range_um"), (0.0, validation.MOST)),
    **dict.fromkeys(("lambda_min_nm", "lambda_max_nm"), (SHORTEST_NM, LONGEST_NM)),
}
_ERRORS = ("truncation", "neighbourhood", "quadrature", "rounding")


@dataclass(frozen=True, repr=False)
class Plan:
    """Numbers of a computation, such as the number of wavelengths, with predicted errors and costs.

    ``dataclasses.replace(plan, terms=9)`` returns a plan with another number; pass that plan as ``plan=``. Errors and
    ``tolerance`` are relative errors of XYZ. (u, v, w) is the scattering vector.

    Attributes:
        method: Name of the expansion of exp(2πiκh) in κ = w/λ, or ``"direct"``.
        coherence: Coherence: a window, a source size or a number of periods.
        tolerance: Accepted error, 1e-5 to 0.5.
        terms: Number of terms of the expansion, 1 to 128.
        least_weight: Smallest Gaussian weight, 0 to 1, with which a Fourier coefficient contributes to a direction.
            Coefficients with a smaller weight are excluded.
        wavelengths: Number of wavelength samples over 380 to 780 nm, equally spaced in 1/λ, or in log λ for a source. 0
            for a spectrum, because the caller chooses the wavelengths of a spectrum.
        subdivisions: For ``"replicas"``, number of samples of the interference factor of the periods, per sample of the
            power of one patch.
        bandwidth_um: Numbers (a, b, c): a direction requires a · rate + b · |w| + c wavelength samples per unit of 1/λ.
            The rate is |(u, v)| for a window. For a source, (u, v) is stretched along the foreshortening. For replicas
            of a patch with the sides Lx and Ly, the rate is |(u Lx, v Ly)|.
        adaptive: Whether directions of small bandwidth use fewer wavelength samples.
        rings_per_octave: Rings per octave of the polar table that replaces the integral over λ; 0 samples wavelengths.
        azimuths_per_width: Azimuth samples of the polar table per standard deviation of the spectrum's blur.
        w_basis_size: Number of functions of w that the table's colours share, a multiple of 4. If it is 0, the
            tolerance determines the number.
        footprint: Whether pixels show means over the range of (u, v) that each pixel covers. If powers add, the means
            are computed from mip levels of the table, otherwise from many points.
        energy_spread: Root mean square deviation of the reflected power of single wavelengths and directions from the
            incident power where energy is normalised; not part of ``error``. 0 for ``energy="stam"``.
        max_uv: Largest |(u, v)| for which the plan is valid.
        max_order_rate: Largest rate, as ``bandwidth_um`` defines it, for which the plan is valid.
        min_w: Smallest |w| for which the plan is valid.
        max_w: Largest |w| for which the plan is valid.
        lambda_min_nm: Shortest wavelength for which the plan is valid [nm].
        lambda_max_nm: Longest wavelength for which the plan is valid [nm].
        height_range_um: Largest height range for which the plan is valid [µm].
        truncation: Predicted error of the truncated expansion.
        neighbourhood: Predicted error by the Fourier coefficients that ``least_weight`` excludes.
        quadrature: Predicted error of the integral over λ; 0 for a spectrum.
        rounding: Predicted error of float32 arithmetic.
        aliasing: Power of the height field beyond the Nyquist limit of its pitch, which aliases onto the steepest
            directions, relative to the power in these directions. The aliasing is a property of the data and not part
            of ``error``.
        scalar_error: Expected error of scalar diffraction at 550 nm, or at the nearest wavelength of a spectrum, as a
            share of the reflected power. It is a property of the surface and not part of ``error``.
        scalar_reason: Reason of the scalar error: ``"steep"``, ``"deep"``, ``"narrow"``, ``"energy"`` or
            ``"undersampled"``.
        multiply_adds: Predicted cost per direction [multiply-adds], the mean over the sampled directions.
        is_measured: Whether the errors were measured on validation directions. Otherwise they are typical errors of
            plans whose parameters are upper bounds.
        validation_size: Number of validation directions.
        table_multiply_adds: Predicted cost of making the table [multiply-adds]; 0 without a table.

    Examples:
        >>> import dataclasses
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(period_um=2.0, depth_um=0.1)
        >>> plan = wd.plan(grating, (0, 0, 1), (0, 0, 1), tolerance=0.01)
        >>> plan.error <= plan.tolerance
        True
        >>> dataclasses.replace(plan, wavelengths=64).wavelengths
        64
    """

    method: str
    coherence: Coherence
    tolerance: float
    terms: int
    least_weight: float
    wavelengths: int
    subdivisions: int
    bandwidth_um: tuple[float, float, float]
    adaptive: bool
    rings_per_octave: int
    azimuths_per_width: float
    w_basis_size: int
    footprint: bool
    energy_spread: float
    max_uv: float
    max_order_rate: float
    min_w: float
    max_w: float
    lambda_min_nm: float
    lambda_max_nm: float
    height_range_um: float
    truncation: float
    neighbourhood: float
    quadrature: float
    rounding: float
    aliasing: float
    scalar_error: float
    scalar_reason: Reason
    multiply_adds: float
    is_measured: bool
    validation_size: int
    table_multiply_adds: float

    def __post_init__(self) -> None:
        validation.choice(self.method, "method", (*EXPANDED, "direct"))
        validation.instance(self.coherence, Coherence, "coherence")
        validation.number(self.azimuths_per_width, "azimuths_per_width", least=0.0)
        if validation.count(self.rings_per_octave, "rings_per_octave", least=0):
            validation.positive(self.azimuths_per_width, "azimuths_per_width")
            if not MIN_RINGS <= self.rings_per_octave <= MAX_RINGS:
                raise ArgumentValueError(
                    f"{ref('rings_per_octave')} must be 0, or {MIN_RINGS} to {MAX_RINGS}, got {self.rings_per_octave}"
                )
        if (
            validation.count(self.w_basis_size, "w_basis_size", least=0) % W_BASIS_STEP
            or self.w_basis_size > MOST_W_BASIS
        ):
            raise ArgumentValueError(
                f"{ref('w_basis_size')} must be a multiple of {W_BASIS_STEP} up to {MOST_W_BASIS}, or 0, got "
                f"{self.w_basis_size}"
            )
        if validation.flag(self.footprint, "footprint"):
            check_footprint(self.method)
        check_method(self.method, "table" if self.rings_per_octave else "sampled", self.coherence)
        validation.number(self.tolerance, "tolerance", least=1e-5, most=0.5)
        if not 1 <= validation.count(self.terms, "terms") <= MAX_TERMS:
            raise ArgumentValueError(f"{ref('terms')} must be 1 to {MAX_TERMS}, got {self.terms}")
        weight = validation.number(self.least_weight, "least_weight", above=0.0)
        if weight >= 1.0:
            raise ArgumentValueError(
                f"{ref('least_weight')} must be less than 1, got {weight:g}: no coefficient has more"
            )
        for name, (least, most) in _SCOPE.items():
            validation.number(getattr(self, name), name, least=least, most=most)
        for name in (*_ERRORS, "energy_spread", "aliasing", "scalar_error", "multiply_adds", "table_multiply_adds"):
            # Predicted errors may have any finite value, because the error bound of a series that diverges may be very
            # large.
            validation.number(getattr(self, name), name, least=0.0, most=sys.float_info.max)
        validation.choice(self.scalar_reason, "scalar_reason", get_args(Reason))
        validation.flag(self.is_measured, "is_measured")
        validation.count(self.validation_size, "validation_size", least=0)
        bandwidth = validation.finite_array(self.bandwidth_um, "bandwidth_um", most=validation.MOST)
        if bandwidth.shape != (3,) or bandwidth.min() < 0.0 or bandwidth[2] == 0.0:
            raise ArgumentValueError(
                f"{ref('bandwidth_um')} must be three numbers >= 0, the last > 0, got {self.bandwidth_um!r}"
            )
        validation.flag(self.adaptive, "adaptive")
        validation.count(self.subdivisions, "subdivisions")
        if validation.count(self.wavelengths, "wavelengths", least=0):
            validation.count(self.wavelengths, "wavelengths", least=2)

    @property
    def error(self) -> float:
        """Predicted relative error: the sum of ``predicted_errors``, without ``aliasing`` and ``scalar_error``."""
        return float(sum(self.predicted_errors.values()))

    @property
    def predicted_errors(self) -> dict[str, float]:
        """Predicted errors by the name of their source, such as ``"truncation"``; their sum is ``error``."""
        return {name: getattr(self, name) for name in _ERRORS}

    @property
    def uses_footprints(self) -> bool:
        """Whether table look-ups compute means over the range of (u, v) of a pixel by mip levels (blurred tables)."""
        return self.footprint and self.rings_per_octave > 0 and self.coherence.adds_powers

    @property
    def microseconds(self) -> float:
        """Estimated time to evaluate one direction [µs] on one CPU core."""
        return 1e6 * self.multiply_adds / (_LOOKED_UP_PER_SECOND if self.rings_per_octave else _SUMMED_PER_SECOND)

    @property
    def table_seconds(self) -> float:
        """Estimated time to make the colour table [s] on one CPU core, once for all calls; 0 without a table."""
        return self.table_multiply_adds / _SUMMED_PER_SECOND

    @property
    def direction_range(self) -> DirectionRange:
        """Range of directions and wavelengths for which the plan is valid."""
        return DirectionRange(
            self.max_uv, self.max_order_rate, self.min_w, self.max_w, self.lambda_min_nm, self.lambda_max_nm
        )

    def __repr__(self) -> str:
        integration = f"{self.rings_per_octave} rings per octave" if self.rings_per_octave else f"{self.wavelengths} λ"
        size = "" if self.method == "direct" else f", {self.terms} terms, {integration}"
        return f"Plan({self.method}, {self.coherence}, tolerance {self.tolerance:g}, error {self.error:.1e}{size})"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"

    @property
    def theory(self) -> TheoryVerdict:
        """Verdict on how wrong scalar diffraction may be for the height field of the plan."""
        wavelength_nm = theory_wavelength_nm(self.lambda_min_nm, self.lambda_max_nm)
        return TheoryVerdict(self.scalar_error, self.scalar_reason, wavelength_nm)

    @property
    def verdict(self) -> str:
        """Sentence that states whether the plan meets its tolerance, and how its error was estimated."""
        if self.method == "direct":
            exact = "the direct sum is exact up to the integral over λ"
            return f"The plan meets its tolerance of {self.tolerance:g}: {exact}."
        how = "typical of its bounds"
        if self.is_measured:
            how = f"measured on {self.validation_size} validation directions"
        meets = "meets" if self.error <= self.tolerance else "does not meet"
        return f"The plan {meets} its tolerance of {self.tolerance:g}: predicted error {self.error:.1e}, {how}."

    def __str__(self) -> str:
        rows = {"coherence": str(self.coherence)}
        if self.method == "direct":
            rows["method"] = "direct sum over the height samples in float64"
        else:
            rows |= {
                "method": f"{LABELS[self.method]}, {self.terms} terms",
                "directions": f"|(u, v)| up to {self.max_uv:.3g}, |w| {self.min_w:.3g} to {self.max_w:.3g}",
            }
            if self.coherence.kind != "replicas":
                rows["neighbours"] = f"those of weight {self.least_weight:.1e} or more"
            rows |= self._integration_rows()
            rows["predicted errors"] = ", ".join(f"{name} {error:.1e}" for name, error in self.predicted_errors.items())
            rows["cost"] = (
                f"{self.multiply_adds:.2g} multiply-adds per direction, {self.microseconds:.2g} µs on one core"
                + (f", after {self.table_seconds:.2g} s for the table" if self.rings_per_octave else "")
            )
        if self.energy_spread:
            rows["energy"] = (
                "Energy is normalised over all wavelengths together; the reflected power of single wavelengths "
                f"deviates by {self.energy_spread:.2g}"
            )
        rows["aliasing"] = (
            f"{self.aliasing:.1e} of the power of the steepest directions lies beyond the pitch's Nyquist limit"
        )
        rows["scalar diffraction"] = str(self.theory)
        return "\n".join([self.verdict, *(f"  {label:20}{text}" for label, text in rows.items())])

    def _integration_rows(self) -> dict[str, str]:
        """Return label and text of the line of a printed plan about the integral over λ; nothing for a spectrum."""
        if self.rings_per_octave:
            grid = f"{self.rings_per_octave} rings per octave, {self.azimuths_per_width:g} azimuths per lobe width"
            shared = f", {self.w_basis_size} functions of w" if self.w_basis_size else ""
            pixels = ", mip levels for footprints" if self.uses_footprints else ""
            return {"integral over λ": f"polar colour table: {grid}{shared}{pixels}"}
        if not self.wavelengths:
            return {}
        spacing = "log λ" if self.coherence.kind == "source" else "1/λ"
        asides = [f"each divided by {self.subdivisions} for the periods' factor"] if self.subdivisions > 1 else []
        asides += ["fewer for directions of less bandwidth"] if self.adaptive else []
        aside = f" ({', '.join(asides)})" if asides else ""
        return {"integral over λ": f"{self.wavelengths} wavelengths equally spaced in {spacing}{aside}"}

    def to_json(self) -> str:
        """Return the plan as JSON, from which :meth:`from_json` makes an equal plan.

        Examples:
            >>> import warpdiff as wd
            >>> plan = wd.plan(wd.gratings.sinusoidal(period_um=2.0, depth_um=0.1), (0, 0, 1), (0, 0, 1))
            >>> wd.Plan.from_json(plan.to_json()) == plan
            True
        """
        return json.dumps({"format": _FORMAT} | asdict(self), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Plan:
        """Return the plan of a text that :meth:`to_json` wrote.

        Args:
            text: JSON text that :meth:`to_json` returned.

        Raises:
            ValueError: The text is damaged, or is not a plan of this version; the message names the field.

        Examples:
            >>> import warpdiff as wd
            >>> plan = wd.plan(wd.gratings.blazed(period_um=2.0, depth_um=0.2), (0, 0, 1), (0, 0, 1))
            >>> wd.Plan.from_json(plan.to_json()).method == plan.method
            True
        """

        def with_tuples(values: Mapping[str, Any]) -> dict[str, Any]:
            return {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}

        if not isinstance(text, str):
            raise ArgumentTypeError(f"{ref('text')} must be a string, got {type(text).__name__}")
        names, of_coherence = ({field.name for field in fields(owner)} for owner in (cls, Coherence))
        try:
            entries = json.loads(text)
            is_plan = entries.pop("format") == _FORMAT and set(entries) == names
            is_plan = is_plan and entries["coherence"].keys() == of_coherence
        except (ValueError, TypeError, AttributeError, KeyError, RecursionError):
            is_plan = False
        if not is_plan:
            raise ArgumentValueError(
                f"{ref('text')} must be a plan that Plan.to_json of this version wrote, got {text!r:.40}"
            )
        try:
            return cls(**with_tuples(entries | {"coherence": Coherence(**with_tuples(entries["coherence"]))}))
        except ArgumentTypeError as error:
            raise ArgumentValueError(error.marked) from None

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the plan to a JSON file, from which :meth:`load` reads an equal plan.

        Args:
            path: File to write; its name ends in ``.json``. An existing file is replaced.

        Returns:
            The path of the file.

        Examples:
            >>> import pathlib, tempfile
            >>> import warpdiff as wd
            >>> plan = wd.plan(wd.gratings.sinusoidal(period_um=2.0, depth_um=0.1), (0, 0, 1), (0, 0, 1))
            >>> path = plan.save(pathlib.Path(tempfile.mkdtemp()) / "plan.json")
            >>> wd.Plan.load(path) == plan
            True
        """
        target = validation.path(path, "path")
        if target.suffix.lower() != ".json":
            raise ArgumentValueError(f"{ref('path')} must end in .json, got {str(path)!r}")
        files.check_folder(target.parent, "path")
        with files.atomic_write(target) as temporary:
            temporary.write_text(self.to_json(), encoding="utf-8", newline="\n")
        return target

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Plan:
        """Read a plan from a JSON file that :meth:`save` wrote.

        Args:
            path: JSON file that :meth:`save` wrote.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file is damaged, or was not written by :meth:`save`; the message names the field.
        """
        file = validation.path(path, "path")
        text = files.read_text(file, _MOST_BYTES)
        with files.describing(file), files.holding("text", file):
            return cls.from_json(text)


def check_method(method: str, integration: str, coherence: Coherence) -> None:
    """Raise an error if a coherence does not support a method, or a colour table for that method."""
    if _is_legal(method, integration, coherence):
        return
    why = f"cannot be used with {ref('kind', coherence.kind)}, whose coefficients add as amplitudes, not as powers"
    if integration == "table":
        why = f"has no table for {ref('kind', coherence.kind)}"
    legal = [name for name in METHODS if _is_legal(name, integration, coherence)]
    others = f"use one of {', '.join(map(repr, legal))}" if legal else f"use {ref('integration', 'sampled')}"
    raise ArgumentValueError(f"{ref('method', method)} {why}: {others}")


def check_footprint(method: str) -> None:
    """Raise an error for ``method="direct"``, which cannot compute means over the footprints of pixels."""
    if method == "direct":
        raise ArgumentValueError(
            f"{ref('footprint', True)} cannot be used with {ref('method', 'direct')}, which sums single directions: "
            "remove one of them"
        )


def _is_legal(method: str, integration: str, coherence: Coherence) -> bool:
    """Whether a method can be used with a kind of coherence and with a method of integrating over λ."""
    if method in POWER_METHODS and not coherence.adds_powers:
        return False
    if integration != "table":
        return True
    return coherence.kind != "replicas" if method == "auto" else method != "direct" and has_table(method, coherence)


def has_table(expansion: str, coherence: Coherence) -> bool:
    """Whether colour tables can be computed from an expansion of exp(2πiκh) under a coherence of the light.

    Tables exist if the coefficients that the expansion provides are added in the way that the coherence requires:
    powers for averaged windows and light sources, amplitudes for centred windows. Replicated periods have no table.
    """
    return (
        coherence.kind != "replicas"
        and holds_powers(expansion, adds_powers=coherence.adds_powers) == coherence.adds_powers
    )


def plan_text(plan: Plan | Mapping[str, Plan]) -> str:
    """Return the text of a plan, or the texts of several plans, each below the name of its part of the mesh."""
    if isinstance(plan, Mapping):
        return "\n\n".join(f"{part}\n{text}" for part, text in plan.items())
    return str(plan)
