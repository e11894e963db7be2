"""Spectral reflectance and colours with exact derivatives.

ρ is the relative reflectance, and ⟨|P|²⟩ the diffracted power. κ = w/λ, where w is the normal component of the
scattering vector and λ the wavelength. The adjoint of a quantity is the derivative of a scalar loss with respect to it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval

from warpdiff.adjoint import colour_sampling
from warpdiff.adjoint.coefficient_series import CoefficientSeries, SeriesSize
from warpdiff.adjoint.gaussian_lobes import block_of, exponent_of
from warpdiff.adjoint.linearised import linearised
from warpdiff.adjoint.period_sums import PeriodSums
from warpdiff.adjoint.power_sums import LobeSums
from warpdiff.adjoint.reflection import index_of, kinks
from warpdiff.adjoint.spectral_model import MOST_KEPT, PAIRS_TOGETHER, SURFACE, Illumination, SpectralModel
from warpdiff.adjoint.surfaces import Relief
from warpdiff.adjoint.variables import available, check_variables, differentiable
from warpdiff.core import memory, validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.field import HeightField
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import check_covers, check_reflection
from warpdiff.planner.refusals import warn_of_darkness

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.adjoint.linearised import Derivatives, Linearised
    from warpdiff.adjoint.power_sums import PowerSums
    from warpdiff.adjoint.sites import Block
    from warpdiff.optics.materials import Material
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.profiles.outline import Outline

Truncation = Annotated[float, Interval(ge=1e-13, le=1e-2)]

# Memory of a call [bytes]: per height sample; per pair of a direction and a wavelength that is computed at once; per
# pair whose derivatives are stored; and per pair for its value, adjoint and tangent.
_BYTES_PER_SAMPLE, _BYTES_PER_PAIR, _BYTES_PER_KEPT, _BYTES_PER_VALUE = 120.0, 900.0, 80.0, 40.0
_REMEDY = "take a larger truncation, {share} of the area of heightfield, or smaller angles"


class SpectralCall:
    """Checked arguments of one call, and the parts of its result that do not depend on wavelengths."""

    def __init__(
        self, function: str, heightfield: HeightField | Outline, to_light: ArrayLike, to_view: ArrayLike, *,
        wrt: Sequence[str], coherence: Coherence | None, ior: float | None, material: Material | None, masking: bool,
        truncation: float,
    ) -> None:  # fmt: skip
        self._relief, self._truncation = Relief.of(heightfield), truncation
        self._coherence = coherence or Coherence()
        _, self._material = check_reflection(ior, material)
        names = available(
            function, coherence=self._coherence, ior=ior, material=material, is_outline=self._relief.is_outline
        )
        self._names = check_variables(function, wrt, names)
        self._ior, self._masking = index_of(ior), validation.flag(masking, "masking")
        self._lights, self._views, self.is_single = validation.light_and_view(to_light, to_view)
        # The arrays are copied, so that derivatives remain valid if the caller changes the arrays later.
        self._vectors = {"to_light": np.array(to_light, float), "to_view": np.array(to_view, float)}
        self._above = (self._lights[:, 2] > HORIZON) & (self._views[:, 2] > HORIZON)
        if len(self._above) and not self._above.any():
            warn_of_darkness()
        lights, views = self._lights[self._above], self._views[self._above]
        if self._masking and (count := kinks(lights, views)) and {"to_light", "to_view"} & set(self._names):
            warn(
                f"{count} of {len(self._lights)} pairs of directions are at the kink of the masking, where both have "
                "the same angle from the normal or masking begins: derivatives by directions are those for a light "
                "nearer to the horizon, or without masking"
            )

    @property
    def _has_slopes(self) -> bool:
        """Whether derivatives are requested with respect to other variables than the surface."""
        return bool(set(self._names) - set(SURFACE))

    def covers(self, low_nm: float, high_nm: float) -> None:
        """Raise an error if the refractive index of the material is not known in a range of wavelengths."""
        if self._material is not None:
            check_covers(self._material, low_nm, high_nm)

    def shapes(self, wavelength_count: int) -> dict[str, tuple[int, ...]]:
        """Return the shape of each requested variable by its name."""
        shapes = {
            self._relief.variable: self._relief.variable_shape, "pitch_um": (2,), "n": (wavelength_count,),
            "k": (wavelength_count,), **{name: array.shape for name, array in self._vectors.items()},
        }  # fmt: skip
        return {name: shapes.get(name, ()) for name in self._names}

    def sampling(self, illuminant: str | Spectrum) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the m wavelengths [nm] at which colours are sampled, shape (m,), and their weights in XYZ, (m, 3)."""
        return colour_sampling.sampling(
            self._lights[self._above], self._views[self._above], self._relief.scale_um, self._relief.size_um,
            self._coherence, self._material, illuminant, self._truncation,
        )  # fmt: skip

    def evaluate(self, wavelengths_nm: NDArray[np.float64], weights: NDArray[np.float64] | None = None) -> Linearised:
        """Return the relative reflectance ρ of n pairs of directions at m wavelengths, shape (n, m), with derivatives.

        With weights of shape (m, 3), the value is ρ @ ``weights``, which are colours.
        """
        above = self._above
        illumination = Illumination(
            self._lights[above], self._views[above], wavelengths_nm, self._coherence, self._ior, self._material,
            self._masking,
        )  # fmt: skip
        columns = len(wavelengths_nm) if weights is None else weights.shape[1]
        self._require_values(len(illumination.lights), len(wavelengths_nm))
        value = np.zeros((len(above), columns))
        model = None
        if above.any():
            model = SpectralModel(illumination, self._sums(illumination), self._relief.shape)
            rho = model.value(with_slopes=self._has_slopes)
            value[above] = rho if weights is None else rho @ weights
        shapes = self.shapes(len(wavelengths_nm))

        def adjoint(adjoints: NDArray[np.float64]) -> Derivatives:
            if model is None:
                return {name: np.zeros(shape) for name, shape in shapes.items()}
            rows = adjoints.reshape(value.shape)[above]
            result = model.adjoint(rows if weights is None else rows @ weights.T, self._names)
            return {name: self._to_argument(name, array) for name, array in result.items()}

        def tangent(changes: Derivatives) -> NDArray[np.float64]:
            result = np.zeros_like(value)
            if model is not None:
                rho = model.tangent({name: self._of_argument(name, array) for name, array in changes.items()})
                result[above] = rho if weights is None else rho @ weights
            return result.reshape(shape)

        shape = value.shape[1:] if self.is_single else value.shape
        return linearised(value.reshape(shape), shapes, adjoint, tangent)

    def _sums(self, illumination: Illumination) -> PowerSums:
        """Return an object that computes the diffracted power ⟨|P|²⟩ of the surface.

        If this requires too much memory, ``MemoryError`` is raised before the computation.
        """
        relief = self._relief
        if self._coherence.periods is not None:
            if not isinstance(relief.surface, HeightField):
                raise ArgumentValueError(
                    f"{ref('coherence')} of periods requires samples, got an outline: use its height_field()"
                )
            return PeriodSums(relief.surface, self._coherence.periods)
        exponent, kappas, block = exponent_of(self._truncation), (math.inf, 0.0), None
        for part in illumination.parts():
            pairs = illumination.pairs(part)
            own = block_of(pairs, exponent, relief.shape, relief.size_um)
            block = own if block is None else block.joined(own)
            kappas = min(kappas[0], float(pairs.kappas.min())), max(kappas[1], float(pairs.kappas.max()))
        assert block is not None  # noqa: S101 (there is a part if any direction is above the horizon)
        powers = self._coherence.adds_powers
        size = SeriesSize.of(relief, kappas, self._truncation, powers=powers)
        self._require(illumination, block, size.terms, size.count, powers=powers)
        series = CoefficientSeries(relief, block, size, powers=powers)
        centre, moving = self._centre()
        return LobeSums(series.terms, series.rows, block, series.sites, relief.size_um, exponent, centre, moving)

    def _require_values(self, directions: int, wavelengths: int) -> None:
        """Raise ``MemoryError`` if the values of all pairs of a direction and a wavelength do not fit into memory."""
        needed = _BYTES_PER_VALUE * directions * wavelengths + _BYTES_PER_SAMPLE * self._relief.samples
        what = f"a gradient at {directions} directions and {wavelengths} wavelengths"
        memory.require_memory(needed, what, "take {share} of the directions or of the area of heightfield")

    def _require(self, illumination: Illumination, block: Block, terms: int, count: int, *, powers: bool) -> None:
        """Raise ``MemoryError`` if the value and its derivatives require more memory than is free."""
        wavelengths = len(illumination.wavelengths_nm)
        pairs = len(illumination.lights) * wavelengths
        pairs_kept = min(pairs, MOST_KEPT) if self._has_slopes else 0
        pairs_together = min(pairs, max(PAIRS_TOGETHER, wavelengths))
        ny, nx = self._relief.shape
        sites = min(block.size, ny * (nx // 2 + 1))
        parts = 1 if powers else 3
        needed = (
            _BYTES_PER_SAMPLE * self._relief.samples + 32.0 * terms * sites
            + 8.0 * parts * count * (2 * sites + 3 * block.size)
            + (_BYTES_PER_PAIR + 16.0 * count) * pairs_together + _BYTES_PER_KEPT * pairs_kept
            + _BYTES_PER_VALUE * pairs
        )  # fmt: skip
        memory.require_memory(needed, f"a gradient by {block.shape[0]} × {block.shape[1]} coefficients", _REMEDY)

    def _centre(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the centre of a coherence window relative to the size of the patch, and its fixed coordinates [µm].

        A centre that the caller states in µm is fixed. The default centre moves if the size of the patch changes; its
        fixed coordinates are (0, 0).
        """
        ny, nx = self._relief.shape
        if self._coherence.centre_um is None:
            return ((ny // 2) / ny, (nx // 2) / nx), (0.0, 0.0)
        y, x = self._coherence.centre_um
        return (y / self._relief.size_um[0], x / self._relief.size_um[1]), (y, x)

    def _to_argument(self, name: str, array: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert adjoints of unit vectors to adjoints of the caller's directions; return other adjoints unchanged."""
        if name not in self._vectors:
            return array
        unit = self._lights if name == "to_light" else self._views
        result = np.zeros_like(unit)
        result[self._above] = array
        lengths = validation.lengths(self._vectors[name])
        result = (result - unit * np.sum(unit * result, axis=1, keepdims=True)) / lengths
        return np.asarray(result if len(lengths) == len(unit) else result.sum(axis=0))

    def _of_argument(self, name: str, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert a change of the caller's directions to that of their unit vectors: the transpose of ``_to_argument``.

        Only directions above the horizon are returned. Changes of other variables are returned unchanged.
        """
        if name not in self._vectors:
            return change
        unit = self._lights if name == "to_light" else self._views
        result = np.atleast_2d(change) / validation.lengths(self._vectors[name])
        return np.asarray((result - unit * np.sum(unit * result, axis=1, keepdims=True))[self._above])


@differentiable
def spectral_reflectance(
    heightfield: HeightField | Outline, to_light: ArrayLike, to_view: ArrayLike, wavelengths_nm: ArrayLike, *,
    wrt: Sequence[str] = ("heights_um",), coherence: Coherence | None = None,
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None, material: Material | None = None,
    masking: bool = True, truncation: Truncation = 1e-8,
) -> Linearised:  # fmt: skip
    """Return the relative reflectance of :func:`warpdiff.spectral_reflectance` with exact derivatives, in float64.

    The derivatives are closed formulas, without finite differences. The gradient with respect to all heights takes
    about as much time as the value. The derivatives require the series of all Fourier coefficients in memory. A call
    that requires more memory than is free raises an error before it starts.

    Args:
        heightfield: Height field, or an outline, whose Fourier coefficients are exact.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length.
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        wrt: Names of the variables of the derivatives: ``"heights_um"`` and ``"pitch_um"`` of a height field,
            ``"vertices"`` and ``"period_um"`` of an outline, ``"height_scale"``,
            ``"sigma_um"``, ``"angular_diameter_deg"``, ``"to_light"``, ``"to_view"``, ``"ior"``, ``"n"``, ``"k"`` or
            ``"film_nm"``, by default the heights.
        coherence: Coherence window, source or periods; None is an averaged window of σ = 16.25 µm. With periods, the
            call sums over all samples for each direction and wavelength, which takes longer.
        ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
        material: Material of the surface instead of ``ior``.
        masking: Whether V-cavity masking and shadowing is included, by default True.
        truncation: Largest error of ρ by truncated series and sums, 1e-13 to 1e-2, by default 1e-8. It is relative to ρ
            of a flat mirror that reflects the light to the viewer. Darker directions have larger relative errors.

    Returns:
        ρ, shape (n, m), or (m,) for single directions, with its derivatives.

    Warns:
        WarpdiffWarning: Pairs of directions are at a kink of the masking, or all directions are below the horizon.

    Raises:
        ValueError: An argument is out of its range, or a variable has no derivative. The message then lists the
            variables that have derivatives.
        MemoryError: The call requires more memory than is free.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> rho, vjp, jvp = wd.adjoint.spectral_reflectance(grating, (0, 0, 1), (0, 0, 1), [450.0, 650.0])
        >>> rho.round(3)
        array([0.324, 0.608])
        >>> gradient = vjp([1.0, 0.0])["heights_um"]
        >>> gradient.shape == grating.shape
        True
        >>> bool(np.isclose(np.sum(gradient * grating.heights_um), jvp(heights_um=grating.heights_um)[0]))
        True
    """
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    call = SpectralCall(
        "spectral_reflectance", heightfield, to_light, to_view, wrt=wrt, coherence=coherence, ior=ior,
        material=material, masking=masking, truncation=truncation,
    )  # fmt: skip
    call.covers(float(wavelengths.min()), float(wavelengths.max()))
    return call.evaluate(wavelengths)


@differentiable
def reflectance(
    heightfield: HeightField | Outline, to_light: ArrayLike, to_view: ArrayLike, *,
    wrt: Sequence[str] = ("heights_um",), illuminant: str | Spectrum = "D65", coherence: Coherence | None = None,
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None, material: Material | None = None,
    masking: bool = True, truncation: Truncation = 1e-4,
) -> Linearised:  # fmt: skip
    """Return the colour of the reflectance of :func:`warpdiff.reflectance` with exact derivatives, in float64.

    A colour is a sum over wavelengths that are close enough for ``truncation``. The derivatives are those of the sum.

    Args:
        heightfield: Height field, or an outline, whose Fourier coefficients are exact.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length.
        wrt: Names of the variables of the derivatives: ``"heights_um"`` and ``"pitch_um"`` of a height field,
            ``"vertices"`` and ``"period_um"`` of an outline, ``"height_scale"``,
            ``"sigma_um"``, ``"angular_diameter_deg"``, ``"to_light"``, ``"to_view"``, ``"ior"`` or ``"film_nm"``, by
            default the heights.
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.
        coherence: Coherence window, source or periods; None is an averaged window of σ = 16.25 µm.
        ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given.
        material: Material of the surface instead of ``ior``.
        masking: Whether V-cavity masking and shadowing is included, by default True.
        truncation: Largest error of XYZ by truncated series and sums, 1e-13 to 1e-2, by default 1e-4. It is relative to
            XYZ of a flat mirror that reflects the light to the viewer. Darker directions have larger relative errors.

    Returns:
        CIE XYZ, shape (n, 3), or (3,) for single directions, with its derivatives.

    Warns:
        WarpdiffWarning: Pairs of directions are at a kink of the masking, or all directions are below the horizon.

    Raises:
        ValueError: An argument is out of its range, or a variable has no derivative. The message then lists the
            variables that have derivatives.
        MemoryError: The call requires more memory than is free.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> xyz, vjp, _ = wd.adjoint.reflectance(grating, (0, 0, 1), (0, 0, 1), wrt=("height_scale", "ior"))
        >>> xyz.round(3)
        array([0.477, 0.495, 0.362])
        >>> print(f"{vjp([0.0, 1.0, 0.0])['height_scale']:.3f}")
        -0.761
    """
    colorimetry.check_illuminant(illuminant)
    call = SpectralCall(
        "reflectance", heightfield, to_light, to_view, wrt=wrt, coherence=coherence, ior=ior, material=material,
        masking=masking, truncation=truncation,
    )  # fmt: skip
    call.covers(float(colorimetry.LAMBDA_MIN_NM), float(colorimetry.LAMBDA_MAX_NM))
    return call.evaluate(*call.sampling(illuminant))
