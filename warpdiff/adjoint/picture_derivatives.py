"""Pictures with exact derivatives of the XYZ of their illuminated pixels.

The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval

from warpdiff.adjoint import reflection
from warpdiff.adjoint.linearised import linearised
from warpdiff.adjoint.picture_model import PictureModel
from warpdiff.adjoint.spectral_model import SURFACE
from warpdiff.adjoint.surfaces import Relief
from warpdiff.adjoint.variables import available, check_variables, differentiable
from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.planner.refusals import warn_of_darkness
from warpdiff.render.picture_samples import LitPixels, samples_of
from warpdiff.render.renderer import Renderer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.adjoint.linearised import Derivatives, Linearised
    from warpdiff.heightfield.field import HeightField
    from warpdiff.lights.base import Light
    from warpdiff.profiles.outline import Outline
    from warpdiff.render.picture_samples import PictureSamples


class _PictureCall:
    """Samples of one picture, and the functions that compute its colours and their derivatives."""

    def __init__(
        self, samples: PictureSamples, relief: Relief, names: tuple[str, ...], ior: float, tolerance: float
    ) -> None:
        self._relief, self._names, self._ior = relief, names, ior
        numbers = np.cumsum(samples.illuminated.ravel()) - 1
        self._groups = _joined(samples.lobes)
        self._pixels = [numbers[group.pixels] for group in self._groups]
        self._pigment = samples.pigment
        self._model = None
        if self._groups:
            self._model = PictureModel(relief, self._groups, samples.inputs.evaluation.coherence, tolerance)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each variable with respect to which derivatives are requested, by its name."""
        return {name: self._relief.variable_shape if name in SURFACE else () for name in self._names}

    def value(self) -> NDArray[np.float64]:
        """Return XYZ of the illuminated pixels, shape (n, 3)."""
        if self._model is None:
            return self._pigment.copy()
        return self._pigment + self._of_pixels(self._model.values)

    def adjoint(self, adjoints: NDArray[np.float64]) -> Derivatives:
        """Return the adjoints (derivatives of a loss) of the requested variables from those of the pixels' XYZ."""
        result = {name: np.zeros(shape) for name, shape in self.shapes.items()}
        if self._model is None:
            return result
        of_groups = [adjoints[pixels] for pixels in self._pixels]
        if set(self._names) - {"ior"}:
            of_surface = self._model.adjoint(of_groups)
            for name in self._names:
                if name in SURFACE:
                    result[name] = of_surface
                elif name == "height_scale":
                    result[name] = np.asarray(np.sum(self._scaling * of_surface))
        if "ior" in self._names:
            slopes = self._by_ior()
            products = [np.sum(own * slope) for own, slope in zip(of_groups, slopes, strict=True)]
            result["ior"] = np.asarray(np.sum(products))
        return result

    def tangent(self, changes: Derivatives) -> NDArray[np.float64]:
        """Return the change of the value (XYZ of the pixels), to first order, for changes of variables."""
        result = np.zeros_like(self._pigment)
        if self._model is None:
            return result
        of_surface = [changes[name] for name in changes if name in SURFACE]
        if "height_scale" in changes:
            of_surface.append(changes["height_scale"] * self._scaling)
        if of_surface:
            result += self._of_pixels(self._model.tangent(np.sum(of_surface, axis=0)))
        if "ior" in changes:
            result += changes["ior"] * self._of_pixels(self._by_ior())
        return result

    @property
    def _scaling(self) -> NDArray[np.float64]:
        """Change of the surface (heights or vertices) per unit of the variable ``height_scale``."""
        heights = np.asarray(self._relief.surface.heights_um)
        if self._relief.is_outline:
            return np.stack([np.zeros_like(heights), heights], axis=1)
        return heights

    def _by_ior(self) -> list[NDArray[np.float64]]:
        """Return derivatives of XYZ by the index of refraction, (n, 3) per group of one illuminant and material."""
        assert self._model is not None  # noqa: S101 (callers have checked it)
        result = []
        for group, xyz in zip(self._groups, self._model.values, strict=True):
            cosines = np.minimum(0.5 * np.linalg.norm(group.scattering_vectors, axis=1), 1.0)
            reflected = reflection.schlick(cosines, self._ior, relative=True)
            slopes = reflected.partials[reflection.IOR_VARIABLES.index("ior")] / reflected.value
            result.append(xyz * slopes[:, None])
        return result

    def _of_pixels(self, colours: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the colours of the n illuminated pixels, shape (n, 3).

        ``colours`` has XYZ of the samples of each group; a group has one illuminant and material. All samples of a
        pixel are added.
        """
        result = np.zeros_like(self._pigment)
        for pixels, xyz in zip(self._pixels, colours, strict=True):
            for channel in range(3):
                result[:, channel] += np.bincount(pixels, xyz[:, channel], minlength=len(result))
        return result


def _joined(lobes: list[LitPixels]) -> list[LitPixels]:
    """Join the samples of all lobes (parts of lights) that have the same illuminant and material into one group."""
    kinds = dict.fromkeys(lobe.illuminated for lobe in lobes)
    return [LitPixels.joined([lobe for lobe in lobes if lobe.illuminated == kind]) for kind in kinds]


@differentiable
def pixels(
    renderer: Renderer, heightfield: HeightField | Outline, lights: Light | Sequence[Light], *,
    wrt: Sequence[str] = ("heights_um",), tolerance: Annotated[float, Interval(ge=1e-5, le=0.5)] = 1e-2,
) -> Linearised:  # fmt: skip
    """Return the colours of the illuminated pixels of a picture with derivatives, in float64.

    The picture is that of ``renderer`` without refinement: one sample per pixel. Directions, shadows, footprints and
    geometry factors are computed once and are constants. The colours are linear in the powers of the Fourier
    coefficients of the surface. The derivatives include all steps from the heights to the colours.

    The first axis of the value counts the illuminated pixels row by row: ``picture[image.illuminated] = value`` writes
    the values into a picture, with ``image = renderer.image()`` under the same lights.

    Without footprints and under an averaged window, the colours are sums over rings of a polar grid of frequencies. A
    ring is a circle of constant |(u, v)|/λ. The grid becomes finer until the colours of some pixels agree with sums
    over wavelengths. All other pictures are sums over wavelengths, which require more time.

    Args:
        renderer: Renderer of the mesh, made with ``refine=False``. Its view, coherence, material and other options
            apply. It remains unchanged.
        heightfield: Height field, or an outline, at which the picture is differentiated. It replaces the height field
            of the renderer, whose directions do not depend on it.
        lights: Directional lights, point lights, or discs of at most 5°.
        wrt: Names of the variables of the derivatives: ``"heights_um"`` of a height field, ``"vertices"`` of an
            outline, ``"height_scale"``, or ``"ior"``, by default the heights.
        tolerance: Relative error of the colours, 1e-5 to 0.5, by default 1e-2.

    Returns:
        CIE XYZ of the illuminated pixels, shape (n, 3), with its derivatives.

    Raises:
        ValueError: The picture has no derivative: refined pixels, several samples per pixel, several surfaces,
            normalised energy, skies, wide discs, or a coherence of the kind ``"centred"`` or ``"replicas"``. The error
            is also raised if a variable has no derivative; the message lists the variables that have derivatives.
        MemoryError: The call requires more memory than is free.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> options = {"coherence": wd.Coherence(sigma_um=5.0), "footprint": False, "refine": False}
        >>> renderer = wd.Renderer(body, grating, light, view, **options)
        >>> value, vjp, jvp = wd.adjoint.pixels(renderer, grating, light)
        >>> image = renderer.image()
        >>> value.shape == image.xyz[image.illuminated].shape
        True
        >>> luminance = np.zeros_like(value)
        >>> luminance[:, 1] = 1.0
        >>> vjp(luminance)["heights_um"].shape
        (1, 64)
    """
    validation.instance(renderer, Renderer, "renderer")
    relief = Relief.of(heightfield)
    samples = samples_of(renderer, lights)
    evaluation, settings = samples.inputs.evaluation, samples.inputs.settings
    if not evaluation.coherence.adds_powers:
        raise ArgumentValueError(
            f"{ref('renderer')} must have a coherence of kind 'averaged' or 'source', got "
            f"{evaluation.coherence.kind!r}: pictures of other kinds have no derivative; use reflectance"
        )
    has_material = settings.material is not None or samples.has_pigment
    names = available("pixels", ior=settings.ior, has_material=has_material, is_outline=relief.is_outline)
    names = check_variables("pixels", wrt, names)
    if not samples.illuminated.any():
        warn_of_darkness()
    call = _PictureCall(samples, relief, names, reflection.index_of(settings.ior), tolerance)
    return linearised(call.value(), call.shapes, call.adjoint, call.tangent)
