"""Reflectance for arrays of light and view directions: XYZ, spectra, the absolute BRDF, maps over all views."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, Unpack, cast

import numpy as np
import warp as wp
from annotated_types import Ge

from warpdiff.core import memory, validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.diffraction import direct_sum, energy_normalisation
from warpdiff.evaluate.reflectance_spectra import ReflectanceSpectra
from warpdiff.evaluate.spectral_values import SpectralSum
from warpdiff.image.error_model import lengths, relative_errors
from warpdiff.image.image import Image
from warpdiff.image.report import report_of
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial, check_reflection, reflectances
from warpdiff.planner.refusals import warn_of_darkness, warn_outside
from warpdiff.planner.strategy import plan_for
from warpdiff.request.directions import DirectionRange, DirectionSample
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import BrdfSettings, EvaluationSettings, SpectralSettings
from warpdiff.request.signatures import accepts
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.request.keywords import BrdfKeywords, EvaluationKeywords, PlannedKeywords, SpectralKeywords
    from warpdiff.request.plan import Plan

# The direct method (sums over all height samples) halves the step between wavelengths until XYZ has converged. This
# means that the change of XYZ, relative to XYZ, is at most this share of the tolerance.
_DIRECT_SETTLED = 0.05
# Maximum number of wavelengths of the direct method. The value is limited by computing time, which is proportional to
# it; one direction with so many wavelengths requires several seconds.
_DIRECT_MOST_WAVELENGTHS = 20_000
# Measured memory of calls of ``reflectance`` and similar functions [bytes]. Each direction requires
# `_BYTES_PER_DIRECTION`. In a spectrum, each pair of a direction and a wavelength requires `_BYTES_PER_VALUE` in
# addition. Each direction of a reflectance map requires `_BYTES_OF_MAP`.
_BYTES_PER_DIRECTION, _BYTES_PER_VALUE, _BYTES_OF_MAP = 170, 16, 190
_REMEDY = "take a larger tolerance, fewer directions at a time, or a smaller heightfield"


@accepts(SpectralSettings)
def spectral_reflectance(
    heightfield: HeightField, to_light: ArrayLike, to_view: ArrayLike, wavelengths_nm: ArrayLike, *,
    progress: Progress = None, **settings: Unpack[SpectralKeywords],
) -> NDArray[Any]:  # fmt: skip
    """Return the relative reflectance ρ(λ), which is 1 for a flat mirror in its mirror direction at normal incidence.

    ρ = C·M·⟨|P|²⟩ (Single 2014, eq. 3.16, with the corrections of ``docs/decisions/scalar_diffraction.md``). C is the
    geometry factor, M is masking and shadowing, and P is the windowed sum of the phases of all surface points. ρ is a
    ratio of radiances, without a further cosine, and is not bounded by 1.

    Args:
        heightfield: Height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length; a single direction
            broadcasts.
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        progress: Function that is called with the finished share, 0 to 1, by one thread at a time; True shows a
            progress bar.

    Returns:
        ρ, shape (n, m), or (m,) for single directions; float32, but float64 for ``method="direct"``. ρ is 0 if the
        direction to the light or to the viewer is at or below the horizon.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> wd.spectral_reflectance(grating, (0, 0, 1), (0.0, 0.0, 1.0), [450.0, 650.0]).round(3)
        array([0.324, 0.608], dtype=float32)
    """
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    request = Evaluation.of(heightfield, SpectralSettings(**settings), wavelengths_nm=wavelengths)
    progress = reporter(progress, "spectral reflectance")
    with memory.as_memory_error("spectral_reflectance()", _REMEDY):
        call = _Call(request, to_light, to_view)
        return call.single(call.spectra(progress=progress))


@accepts(SpectralSettings)
def reflectance_spectra(
    heightfield: HeightField, to_light: ArrayLike, to_view: ArrayLike, wavelengths_nm: ArrayLike, *,
    progress: Progress = None, **settings: Unpack[SpectralKeywords],
) -> ReflectanceSpectra:  # fmt: skip
    """Return the spectra of :func:`warpdiff.spectral_reflectance` with their directions, as a table that can be saved.

    Args:
        heightfield: Height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length; a single direction
            broadcasts.
        wavelengths_nm: Wavelengths, each at least 200 nm, shape (m,) or one number.
        progress: Function that is called with the finished share, 0 to 1, by one thread at a time; True shows a
            progress bar.

    Returns:
        Reflectance spectra; :func:`warpdiff.plot.spectra` draws them.

    Raises:
        ValueError: An argument is out of its range.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> wd.reflectance_spectra(grating, (0, 0, 1), (0, 0, 1), [450.0, 550.0]).save("spectrum.csv").name
        'spectrum.csv'
    """
    values = spectral_reflectance(heightfield, to_light, to_view, wavelengths_nm, progress=progress, **settings)
    lights, views, _ = validation.light_and_view(to_light, to_view)
    wavelengths = colorimetry.check_wavelengths(wavelengths_nm)
    return ReflectanceSpectra(wavelengths, lights, views, np.atleast_2d(values))


@accepts(EvaluationSettings)
def reflectance(
    heightfield: HeightField, to_light: ArrayLike, to_view: ArrayLike, *, illuminant: str | Spectrum = "D65",
    progress: Progress = None, **settings: Unpack[EvaluationKeywords],
) -> NDArray[Any]:  # fmt: skip
    """Return the colour of the reflectance, ∫ ρ S x̄ȳz̄ dλ / ∫ S ȳ dλ over 380 to 780 nm (Single 2014, eq. 3.20).

    ρ is the reflectance of :func:`warpdiff.spectral_reflectance`, S is the spectrum of the illuminant, and x̄, ȳ and z̄
    are the CIE colour-matching functions.

    Args:
        heightfield: Height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length; a single direction
            broadcasts.
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.
        progress: Function that is called with the finished share, 0 to 1, by one thread at a time; True shows a
            progress bar.

    Returns:
        CIE XYZ, shape (n, 3), or (3,) for single directions; float32, but float64 for ``method="direct"``. A flat
        mirror at normal incidence has the colour of the illuminant, Y = 1.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> wd.reflectance(grating, (0, 0, 1), [(0.0, 0.0, 1.0), (0.3, 0.0, 1.0)]).round(3)
        array([[0.477, 0.495, 0.362],
               [0.033, 0.037, 0.   ]], dtype=float32)
    """
    request = Evaluation.of(heightfield, EvaluationSettings(**settings), illuminants=(illuminant,))
    progress = reporter(progress, "reflectance")
    with memory.as_memory_error("reflectance()", _REMEDY):
        call = _Call(request, to_light, to_view)
        return call.single(call.colours(progress=progress))


@accepts(EvaluationSettings)
def reflectance_map(
    heightfield: HeightField, to_light: ArrayLike, *, size: Annotated[int, Ge(2)] = 512,
    illuminant: str | Spectrum = "D65", samples_per_pixel: Annotated[int, Ge(1)] = 1, progress: Progress = None,
    **settings: Unpack[EvaluationKeywords],
) -> Image:  # fmt: skip
    """Render the colours of the reflectance over all view directions for one light direction.

    The picture is the unit disc of the points (sin θr cos φr, sin θr sin φr), with x to the right and y up. θr is the
    angle of a view direction from the normal, and φr its angle around the normal.

    Args:
        heightfield: Height field.
        to_light: Direction to the light in the local frame, shape (3,), above the horizon.
        size: Width and height of the picture [pixels].
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.
        samples_per_pixel: Number of view directions per pixel, a square number. The colour of the pixel is the mean of
            the colours in these directions. With 1, the only direction is the one at the pixel centre.
        progress: Function that is called with the finished share, 0 to 1; True shows a progress bar.

    Returns:
        Reflectance map; its mask is the disc.

    Raises:
        ValueError: An argument is out of its range, or the light is not above the horizon.
        ToleranceError: The tolerance cannot be met, and ``strict`` is True.
        MemoryError: The map requires more memory than is free; the message states the largest map that fits.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> wd.reflectance_map(grating, (0, 0, 1), size=32)
        Image(32 × 32 pixels, 79 % illuminated, estimated error 0.001 at the 99th percentile)
    """
    request = Evaluation.of(heightfield, EvaluationSettings(**settings), illuminants=(illuminant,))
    progress = reporter(progress, "reflectance map")
    light, single = validation.unit_directions(to_light, "to_light")
    if not single:
        raise ArgumentValueError(f"{ref('to_light')} must have shape (3,) for a map, got {np.shape(to_light)}")
    if light[0, 2] <= HORIZON:
        raise ArgumentValueError(
            f"{ref('to_light')} must lie above the horizon (z > 0), got {np.asarray(to_light).tolist()}"
        )
    size = validation.count(size, "size", least=2)
    across = math.isqrt(validation.count(samples_per_pixel, "samples_per_pixel"))
    if across * across != samples_per_pixel:
        raise ArgumentValueError(f"{ref('samples_per_pixel')} must be a square number, got {samples_per_pixel}")
    count = across * size
    if count * count > memory.MOST_ELEMENTS:
        raise ArgumentValueError(
            f"{ref('size')} × {ref('size')} × {ref('samples_per_pixel')} must be at most {memory.MOST_ELEMENTS}, got "
            f"{size} × "
            f"{size} × {samples_per_pixel}"
        )
    memory.require_memory(
        _BYTES_OF_MAP * count * count, f"a map of {size} × {size} pixels with samples_per_pixel={across * across}",
        "take at most {side} times the size, or {share} of the samples",
    )  # fmt: skip
    with memory.as_memory_error(f"a map of {size} × {size} pixels", _REMEDY):
        axis = (2.0 * np.arange(count) + 1.0) / count - 1.0
        x, y = np.meshgrid(axis, -axis)
        radius2 = x * x + y * y
        inside = radius2 < 1.0
        views = np.stack([x[inside], y[inside], np.sqrt(1.0 - radius2[inside])], axis=1)
        call = _Call(request, light, views)
        colours = np.zeros((count, count, 3), dtype=np.float32)
        colours[inside] = call.colours(progress=progress)
    xyz = colours.reshape(size, across, size, across, 3).mean(axis=(1, 3))
    coverage = inside.reshape(size, across, size, across).mean(axis=(1, 3), dtype=np.float32)
    mask = coverage > 0.0
    error = np.zeros(mask.shape, dtype=np.float32)
    error[mask] = relative_errors(call.plan.error * lengths(xyz[mask]), xyz[mask])
    tolerance = call.plan.tolerance
    report = report_of(error, mask, None, tolerance=tolerance, refined_share=0.0, light_sample_count=1)
    report = replace(report, history=heightfield.history)
    return Image(xyz=xyz, mask=mask, illuminated=mask, coverage=coverage, error=error, plan=call.plan, report=report)


@accepts(BrdfSettings)
def brdf(
    heightfield: HeightField, to_light: ArrayLike, to_view: ArrayLike, wavelengths_nm: ArrayLike, *,
    progress: Progress = None, **settings: Unpack[BrdfKeywords],
) -> NDArray[Any]:  # fmt: skip
    """Return the absolute BRDF [1/sr] (Stam 1999), without masking and shadowing.

    The BRDF is R(θd) · (1 + ωi·ωr)² / (cos θi cos θr w²) · ⟨|P|²⟩ times a factor of the coherence, where ωi and ωr are
    the unit vectors to the light and to the viewer, and θd is half of the angle between ωi and ωr. The factor of the
    coherence is 4πσ²/λ² for a window, 1/(2π √det Σs) for a source with the covariance Σs, and A N1 N2/λ² for N1 × N2
    periods of a patch with the area A. For a window g, ⟨|P|²⟩ times this factor is the mean of
    |∫ g e^{ik(wh + ux + vy)}|² / (λ² ∫ g²).

    The BRDF is reciprocal, except for a source. Scalar diffraction does not conserve energy exactly: the sum over the
    orders exceeds the reflectance R slightly for shallow profiles, and greatly for short periods at grazing angles.

    Args:
        heightfield: Height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3).
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3).
        wavelengths_nm: Wavelengths [nm], shape (m,) or one number.
        progress: Function that is called with the finished share, 0 to 1; True shows a progress bar.

    Returns:
        BRDF, shape (n, m), or (m,) for single directions; float32, but float64 for ``method="direct"``.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> wd.brdf(grating, (0, 0, 1), (0.3, 0.0, 1.0), [550.0]).shape
        (1,)
    """
    checked = BrdfSettings(**settings)
    common = cast("PlannedKeywords", {name: value for name, value in settings.items() if name != "energy"})
    relative = spectral_reflectance(
        heightfield, to_light, to_view, wavelengths_nm, masking=False, progress=progress, **common
    )
    lights, views, single = validation.light_and_view(to_light, to_view)
    wavelengths_um = colorimetry.check_wavelengths(wavelengths_nm) * 1e-3
    cos_light = np.where(lights[:, 2] > HORIZON, lights[:, 2], 1.0)
    scale = reflectance_factors.brdf_scale(
        cos_light, wavelengths_um, checked.effective_coherence, heightfield.size_um[0] * heightfield.size_um[1]
    )
    scale *= check_reflection(checked.ior, checked.material)[0]
    illuminated = (lights[:, 2] > HORIZON) & (views[:, 2] > HORIZON)
    if checked.energy == "normalised" and illuminated.any():
        scale[illuminated] *= energy_normalisation.between(
            heightfield, lights[illuminated], views[illuminated], 1e3 * wavelengths_um
        )
    return np.asarray(relative * (scale[0] if single else scale).astype(relative.dtype))


class _Call:
    """Pairs of light and view directions of a call of ``reflectance`` or ``brdf``, with geometry factors and a plan.

    The plan holds the numbers of the computation, such as the number of wavelengths.
    """

    def __init__(self, request: Evaluation, to_light: ArrayLike, to_view: ArrayLike) -> None:
        self._lights, self._views, self._is_single = validation.light_and_view(to_light, to_view)
        directions = len(self._lights)
        values = 0 if request.wavelengths_nm is None else len(request.wavelengths_nm)
        memory.require_memory(
            directions * (_BYTES_PER_DIRECTION + _BYTES_PER_VALUE * values),
            f"a call of {directions} directions" + f" at {values} wavelengths" * (values > 0),
            "take at most {share} of them at a time",
        )
        self._request = request
        self._where = {"device": request.device, "threads": request.threads}
        self._scattering_vectors = -self._lights - self._views
        self._gains = reflectance_factors.gain(
            self._lights, self._views, normal=request.normal_reflectance, masking=request.masking,
            per_light_cosine=request.coherence.kind == "source",
        )  # fmt: skip
        illuminated = self._gains > 0.0
        if directions and not illuminated.any():
            warn_of_darkness()
        energy = request.energy_factors
        if energy is not None:
            self._gains[illuminated] *= energy.between(self._lights[illuminated], self._views[illuminated])
        self._scope = DirectionRange.of(
            request.heightfield, request.coherence, self._scattering_vectors, self._lights, illuminated,
            request.wavelengths_nm,
        )  # fmt: skip
        if request.plan is None:
            sample = DirectionSample.among(self._scattering_vectors, self._lights, self._gains)
            self.plan = plan_for(request, self._scope, sample, float(np.count_nonzero(illuminated)))
        else:
            self.plan = request.plan
            warn_outside(self.plan, request.heightfield, self._scope, compares_rates=request.integrates)
        self.plan = request.with_energy(self.plan)

    def single(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return ``values``, which have one row per pair of directions, or the only row if the caller gave one pair."""
        return np.asarray(values[0]) if self._is_single else values

    def spectra(self, *, progress: Callable[[float], None] | None) -> NDArray[Any]:
        """Return the relative reflectance ρ of n pairs of directions at m wavelengths, shape (n, m)."""
        wavelengths_nm = np.asarray(self._request.wavelengths_nm)
        terms = SpectralSum(self._request.heightfield, self.plan, self._scope, wavelengths_nm, **self._where)
        material = self._request.illuminated[0].material
        return terms.spectra(self._scattering_vectors, self._lights, self._gains, material, progress=progress)

    def colours(self, *, progress: Callable[[float], None] | None) -> NDArray[Any]:
        """Return the XYZ of n pairs of directions, shape (n, 3)."""
        heightfield, (illuminated,) = self._request.heightfield, self._request.illuminated
        if self.plan.method == "direct":
            return direct_colour(
                heightfield, self._scattering_vectors, self._lights, self._gains, self.plan, illuminated,
                progress=progress,
            )  # fmt: skip
        lookup = ColourLookup(heightfield, self.plan, self._scope, **self._where)
        xyz = wp.zeros(len(self._lights), dtype=wp.vec3f, device=self._request.device)
        lookup.accumulate(*self._on_device(), illuminated, xyz, progress=progress)
        return np.asarray(xyz.numpy())

    def _on_device(self) -> tuple[wp.array, wp.array, wp.array]:
        """Return scattering vectors, directions to the light and geometry factors of all pairs as device arrays."""
        device = self._request.device
        return (
            wp.array(self._scattering_vectors, dtype=wp.vec3d, device=device),
            wp.array(self._lights.astype(np.float32), dtype=wp.vec3f, device=device),
            wp.array(self._gains.astype(np.float32), dtype=wp.float32, device=device),
        )


def direct_colour(
    heightfield: HeightField, scattering_vectors: NDArray[np.float64], to_lights: NDArray[np.float64],
    gains: NDArray[np.float64], plan: Plan, lit_material: IlluminatedMaterial, *,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Return XYZ by the direct sum over height samples; the number of wavelengths increases until XYZ converges.

    The first number of wavelengths is that of ``plan``, which suffices for any surface with these directions. It is so
    large that no diffraction order falls between two wavelengths. The step in 1/λ is then halved repeatedly.
    """
    result = np.zeros((len(gains), 3))
    illuminated = np.flatnonzero(gains > 0.0)
    unconverged = 0

    def powers(index: int, wavelengths_nm: NDArray[np.float64]) -> NDArray[np.float64]:
        one = slice(index, index + 1)
        power = direct_sum.window_power(
            heightfield, plan.coherence, scattering_vectors[one], wavelengths_nm * 1e-3, to_lights=to_lights[one]
        )
        return np.asarray(power[0] * reflectances(lit_material.material, scattering_vectors[one], wavelengths_nm)[0])

    for done, i in enumerate(illuminated.tolist()):
        count = plan.wavelengths * plan.subdivisions
        values = powers(i, colorimetry.wavelengths_uniform_in_wavenumber(count))
        colour = values @ colorimetry.uniform_quadrature(count, lit_material.illuminant)[1]
        settled = False
        while not settled and 2 * count < _DIRECT_MOST_WAVELENGTHS:
            count = 2 * count - 1
            finer = colorimetry.wavelengths_uniform_in_wavenumber(count)
            refined = np.empty(count)
            refined[::2] = values
            refined[1::2] = powers(i, finer[1::2])
            values, before = refined, colour
            colour = values @ colorimetry.uniform_quadrature(count, lit_material.illuminant)[1]
            change = float(np.linalg.norm(colour - before))
            settled = change <= _DIRECT_SETTLED * plan.tolerance * float(np.linalg.norm(colour))
        unconverged += not settled
        result[i] = gains[i] * colour
        if progress is not None:
            progress((done + 1) / len(illuminated))
    if unconverged:
        warn(
            f"the direct sum of {unconverged} of {len(illuminated)} directions has not converged at "
            f"{_DIRECT_MOST_WAVELENGTHS} wavelengths, the limit: use a larger {ref('tolerance')}, or "
            "warpdiff.spectral_reflectance"
        )
    return result
