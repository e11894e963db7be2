"""Spectral pictures: the radiance of each pixel at given wavelengths, as sums over lights and rays."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.evaluate.spectral_values import SpectralSum
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import check_covers
from warpdiff.planner.refusals import warn_outside
from warpdiff.planner.strategy import plan_for

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.base import LightPart
    from warpdiff.render.picture import Picture
    from warpdiff.request.evaluation import Evaluation
    from warpdiff.scene.camera import View

# Memory of a spectral picture per pixel and wavelength [bytes]: one float32 value.
_BYTES_PER_VALUE = 4


def check_spectral(evaluation: Evaluation, parts: Sequence[LightPart], view: View) -> None:
    """Raise an error if spectra of lights or materials lack the wavelengths, or if memory does not suffice."""
    wavelengths = np.asarray(evaluation.wavelengths_nm)
    for spectrum in dict.fromkeys(spectrum for part in parts for spectrum in part.spectra):
        colorimetry.relative_powers(spectrum, wavelengths)
    for material in evaluation.materials.values():
        if material is not None:
            check_covers(material, float(wavelengths.min()), float(wavelengths.max()))
    memory.require_memory(
        _BYTES_PER_VALUE * view.width * view.height * len(wavelengths),
        f"a picture of {view.width} × {view.height} pixels at {len(wavelengths)} wavelengths",
        "take {share} of the wavelengths",
    )


def check_pigment(pigment: float, *, has_base_colour: bool) -> None:
    """Raise an error if the base colour of the mesh would be visible, because its spectrum is not known."""
    if pigment > 0.0 and has_base_colour:
        raise ArgumentValueError(
            f"{ref('pigment')} must be 0 with {ref('wavelengths_nm')} for a mesh with a base colour, which has no "
            f"spectrum, got {pigment:g}"
        )


def spectra_of(
    picture: Picture, evaluation: Evaluation, progress: Callable[[float], None] | None
) -> NDArray[np.float32]:
    """Return the spectra of a picture of single directions at m wavelengths, shape (height, width, m).

    The radiance at a wavelength λ is the sum over the lights of power · ρ(λ) S(λ) / S̄. Here ρ is the relative
    reflectance, and S̄ is the mean of the illuminant S with the luminous efficiency ȳ as weight. The integral of the
    radiance with the observer's curves is then the colour of the pixel.

    Args:
        picture: Picture whose lights are set.
        evaluation: Checked inputs, with the wavelengths.
        progress: Callable that gets the finished fraction; None reports nothing.
    """
    wavelengths, heightfield = np.asarray(evaluation.wavelengths_nm), evaluation.heightfield
    ((direction_range, sample, count),) = picture.measure_directions([heightfield])
    band = {"lambda_min_nm": float(wavelengths.min()), "lambda_max_nm": float(wavelengths.max())}
    direction_range = replace(direction_range, **band)
    if evaluation.plan is None:
        plan = plan_for(evaluation, direction_range, sample, count)
    else:
        plan = evaluation.plan
        warn_outside(plan, heightfield, direction_range, compares_rates=False)
    terms = SpectralSum(
        heightfield, plan, direction_range, wavelengths, device=evaluation.device, threads=evaluation.threads
    )
    spectra = np.zeros((picture.rays.size, len(wavelengths)), dtype=np.float32)
    for index, share in picture.sampled(progress):
        scattering_vectors, to_lights, gains = picture.sampler.directions()
        finishes = picture.context.finishes_of_hits()
        for finish, (illuminated,) in enumerate(picture.illuminated(index)):
            of_finish = gains if finishes is None else np.where(finishes == finish, gains, np.float32(0.0))
            terms.add_to(
                spectra, scattering_vectors, to_lights, of_finish, illuminated.material,
                colorimetry.relative_powers(illuminated.illuminant, wavelengths),
                progress=share if finishes is None else None,
            )  # fmt: skip
    return spectra.reshape(picture.view.height, picture.view.width, len(wavelengths))
