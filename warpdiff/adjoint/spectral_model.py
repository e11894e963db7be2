"""Relative reflectance ρ = g R ⟨|P|²⟩ for pairs of directions at wavelengths, with its derivatives.

g is the geometry factor C·M, R the reflectance, and ⟨|P|²⟩ the sum over Fourier coefficients near q = (u, v)/λ at
κ = w/λ, for the scattering vector (u, v, w) and the wavelength λ. θd is half of the angle between the directions to
light and viewer. The sum has the weights exp(−a dᵀQd) for the distance d of a coefficient's frequency from q.

The tangent is the change of ρ to first order. The adjoint of a quantity is the derivative of a scalar loss with respect
to this quantity. Derivatives with respect to numbers and directions are computed for each pair, and adjoint and tangent
use the same array. The derivative with respect to the surface would be too large an array, because a surface has a
million variables. The surface therefore has separate functions for adjoint and tangent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint import power_sums, reflection
from warpdiff.adjoint.gaussian_lobes import Pairs
from warpdiff.adjoint.power_sums import KAPPA, L_X, L_Y, M_XX, M_XY, M_YY, Q_X, Q_Y, VALUE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from warpdiff.adjoint.jets import Jet
    from warpdiff.adjoint.linearised import Derivatives
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material

# Number of pairs of a direction and a wavelength that are computed at once. The value is limited by memory: a pair
# requires about 700 bytes.
PAIRS_TOGETHER = 1 << 18
# Largest number of pairs (a direction and a wavelength) whose derivatives are stored after the value has been computed.
# The value is limited by memory: a pair requires 72 bytes.
MOST_KEPT = 1 << 23
# Names of the variables that are the surface itself: heights of a height field, or vertices of an outline (polygon).
# Their adjoint and tangent are computed for all directions and wavelengths in one step.
SURFACE = ("heights_um", "vertices")


@dataclass(frozen=True)
class Illumination:
    """Pairs of directions to light and viewer above the horizon, wavelengths, and optical settings of a call.

    Attributes:
        lights: Unit vectors to the light, shape (n, 3).
        views: Unit vectors to the viewer, shape (n, 3).
        wavelengths_nm: Wavelengths [nm], shape (m,).
        coherence: Coherence of the light.
        ior: Index of refraction, which is used if there is no material.
        material: Material of the surface, or None.
        masking: Whether V-cavity masking is included.
    """

    lights: NDArray[np.float64]
    views: NDArray[np.float64]
    wavelengths_nm: NDArray[np.float64]
    coherence: Coherence
    ior: float
    material: Material | None
    masking: bool

    @property
    def wavenumbers(self) -> NDArray[np.float64]:
        """Wavenumbers 1/λ [1/µm], shape (m,)."""
        return np.asarray(1e3 / self.wavelengths_nm)

    @property
    def falloffs(self) -> NDArray[np.float64]:
        """Factor a of the Gaussian weights exp(−a dᵀQd) of Fourier coefficients at each wavelength, shape (m,).

        d is the distance in frequency [1/µm]. The unit of a is µm².
        """
        if self.coherence.kind == "source":
            return np.asarray((1e-3 * self.wavelengths_nm / self.coherence.spread) ** 2 / 2.0)
        factor = 4.0 if self.coherence.kind == "averaged" else 2.0
        return np.full(len(self.wavelengths_nm), factor * (math.pi * (self.coherence.sigma_um or 1.0)) ** 2)

    def shapes(self, part: slice) -> NDArray[np.float64]:
        """Return the elements Q_xx, Q_xy, Q_yy of the matrix Q of the Gaussian weights per direction, shape (n, 3).

        For a light source of finite size, its foreshortening on the surface determines Q. For a coherence window, Q is
        the unit matrix.
        """
        if self.coherence.kind != "source":
            return np.tile([1.0, 0.0, 1.0], (len(self.lights[part]), 1))
        x, y = (self.lights[part, :2] / self.lights[part, 2:]).T
        return np.stack([1.0 + x * x, x * y, 1.0 + y * y], axis=1)

    def parts(self) -> Iterator[slice]:
        """Yield slices of the directions that have at most ``PAIRS_TOGETHER`` pairs of a direction and a wavelength.

        A slice has at least one direction.
        """
        size = max(PAIRS_TOGETHER // len(self.wavelengths_nm), 1)
        for first in range(0, len(self.lights), size):
            yield slice(first, min(first + size, len(self.lights)))

    def pairs(self, part: slice) -> Pairs:
        """Return the pairs of the directions ``part`` with all wavelengths, sorted by direction."""
        half, per_um = self.lights[part] + self.views[part], self.wavenumbers
        centres = -half[:, None, :2] * per_um[:, None]
        forms = self.shapes(part)[:, None] * self.falloffs[:, None]
        return Pairs(centres.reshape(-1, 2), forms.reshape(-1, 3), np.outer(half[:, 2], per_um).ravel())

    def gains(self, part: slice) -> tuple[Jet, Jet]:
        """Return the geometry factor g, and cos θd, of the directions ``part``, with derivatives by both directions.

        θd is half of the angle between the directions to light and viewer.
        """
        return reflection.geometry(
            self.lights[part], self.views[part], masking=self.masking,
            per_light_cosine=self.coherence.kind == "source",
        )  # fmt: skip

    def reflectances(self, cosines: NDArray[np.float64]) -> Jet:
        """Return the reflectance R and its derivatives at n cosines of θd and m wavelengths, shape (n, m).

        θd is half of the angle between the directions to light and viewer. Without a material, R does not depend on the
        wavelength, and the shape is (n, 1).
        """
        if self.material is None:
            return reflection.schlick(cosines[:, None], self.ior, relative=True)
        grid = np.repeat(cosines[:, None], len(self.wavelengths_nm), axis=1)
        return reflection.fresnel(grid, self.material, np.tile(self.wavelengths_nm, (len(cosines), 1)))


class SpectralModel:
    """Relative reflectance ρ of n pairs of directions at m wavelengths, with adjoint and tangent."""

    def __init__(self, illumination: Illumination, sums: power_sums.PowerSums, samples: tuple[int, int]) -> None:
        """Set the directions, the wavelengths and the surface.

        Args:
            illumination: Directions, wavelengths and optics.
            sums: Object that computes the diffracted power ⟨|P|²⟩ of the surface.
            samples: Numbers of samples (y, x). The size of the surface is the pitch times these numbers.
        """
        self._illumination, self._sums, self._samples = illumination, sums, samples
        # Stored powers ⟨|P|²⟩ and their derivatives. The directions are processed in parts. A key is the index of the
        # first direction of a part.
        self._columns: dict[int, NDArray[np.float64]] = {}

    def value(self, *, with_slopes: bool) -> NDArray[np.float64]:
        """Return the relative reflectance ρ of the n pairs of directions at the m wavelengths, shape (n, m).

        ``with_slopes`` states whether derivatives with respect to numbers or directions will be requested later. The
        powers ⟨|P|²⟩ and their derivatives are then computed together, and are stored for the first ``MOST_KEPT`` pairs
        of a direction and a wavelength.
        """
        illumination = self._illumination
        result = np.empty((len(illumination.lights), len(illumination.wavelengths_nm)))
        for part in illumination.parts():
            pairs = illumination.pairs(part)
            if with_slopes and part.stop * len(illumination.wavelengths_nm) <= MOST_KEPT:
                columns = self._sums.derivatives(pairs)
                self._columns[part.start], sums = columns, columns[:, VALUE]
            else:
                sums = self._sums.sums(pairs)
            result[part] = sums.reshape(result[part].shape)
            result[part] *= self._factors(part)
        return result

    def adjoint(self, adjoints: NDArray[np.float64], names: tuple[str, ...]) -> Derivatives:
        """Return the adjoints of the variables ``names`` from the adjoints of the reflectance ρ, shape (n, m).

        The adjoint (derivative of a loss) of a direction to the light or viewer has the shape (n, 3).
        """
        result: Derivatives = {}
        others = tuple(name for name in names if name not in SURFACE)
        for name in names:
            if name in SURFACE:
                result[name] = self._sums.adjoint(
                    (self._illumination.pairs(part), (adjoints[part] * self._factors(part)).ravel())
                    for part in self._illumination.parts()
                )
        for part in self._illumination.parts() if others else ():
            for name, slope in self._slopes(part, others).items():
                if name in ("to_light", "to_view"):
                    here = np.einsum("nm,pnm->np", adjoints[part], slope)
                    result.setdefault(name, np.zeros_like(self._illumination.lights))[part] = here
                else:
                    spec = "nm,pnm->m" if name in ("n", "k") else "nm,pnm->p"
                    result[name] = result.get(name, np.zeros(())) + np.einsum(spec, adjoints[part], slope)
        return result

    def tangent(self, changes: Derivatives) -> NDArray[np.float64]:
        """Return the change of the reflectance ρ, shape (n, m), for changes of variables.

        The change of a direction has the shape (n, 3).
        """
        illumination = self._illumination
        result = np.zeros((len(illumination.lights), len(illumination.wavelengths_nm)))
        others = tuple(name for name in changes if name not in SURFACE)
        of_surface = [self._sums.tangent(changes[name]) for name in changes if name in SURFACE]
        for part in illumination.parts():
            for change in of_surface:
                result[part] += self._factors(part) * change(illumination.pairs(part)).reshape(result[part].shape)
            for name, slope in self._slopes(part, others).items() if others else ():
                change_of = changes[name]
                if name in ("to_light", "to_view"):
                    result[part] += np.einsum("pnm,np->nm", slope, change_of[part])
                elif name in ("n", "k"):
                    result[part] += slope[0] * change_of
                else:
                    result[part] += np.einsum("pnm,p->nm", slope, np.atleast_1d(change_of))
        return result

    def _factors(self, part: slice) -> NDArray[np.float64]:
        """Return geometry factor times reflectance, g R, for the directions ``part``, shape (n, m).

        Without a material, the shape is (n, 1).
        """
        gain, cosine = self._illumination.gains(part)
        return np.asarray(gain.value[:, None] * self._illumination.reflectances(cosine.value).value)

    def _slopes(self, part: slice, names: tuple[str, ...]) -> Derivatives:
        """Return the derivatives of the reflectance ρ for the directions ``part`` by each variable, shape (p, n, m).

        p is the number of elements of the variable.
        """
        illumination, pairs = self._illumination, self._illumination.pairs(part)
        gain, cosine = illumination.gains(part)
        reflected = illumination.reflectances(cosine.value)
        g, shape = gain.value[:, None], (len(cosine.value), len(illumination.wavelengths_nm))
        columns = self._columns.get(part.start)
        columns = np.moveaxis(self._sums.derivatives(pairs) if columns is None else columns, 1, 0).reshape(-1, *shape)
        slopes, powers = g * reflected.value * columns[:VALUE], columns[VALUE]
        result: Derivatives = {}
        by_optics = dict(zip(self._optics, g * powers * reflected.partials, strict=True))
        if "height_scale" in names:
            result["height_scale"] = (slopes[KAPPA] * pairs.kappas.reshape(shape))[None]
        if "pitch_um" in names:
            result["pitch_um"] = slopes[[L_Y, L_X]] * np.reshape(self._samples, (2, 1, 1))
        if "period_um" in names:
            result["period_um"] = slopes[[L_X]]
        if "sigma_um" in names:
            per_sigma = 2.0 * illumination.falloffs / (illumination.coherence.sigma_um or 1.0)
            result["sigma_um"] = ((slopes[M_XX] + slopes[M_YY]) * per_sigma)[None]
        if "angular_diameter_deg" in names:
            along = self._along(slopes, illumination.shapes(part))
            result["angular_diameter_deg"] = (-2.0 / (illumination.coherence.angular_diameter_deg or 1.0) * along)[None]
        for name in ("ior", "n", "k", "film_nm"):
            if name in names:
                result[name] = by_optics[name][None]
        if "to_light" in names or "to_view" in names:
            per_um = illumination.wavenumbers
            common = np.stack([-slopes[Q_X] * per_um, -slopes[Q_Y] * per_um, slopes[KAPPA] * per_um])
            own = (
                gain.partials[:, :, None] * (reflected.value * powers)
                + cosine.partials[:, :, None] * by_optics["cosine"]
            )
            if "to_view" in names:
                result["to_view"] = own[3:] + common
            if "to_light" in names:
                result["to_light"] = own[:3] + common + self._through_source(part, slopes)
        return result

    @property
    def _optics(self) -> tuple[str, ...]:
        material = self._illumination.material
        return reflection.IOR_VARIABLES if material is None else reflection.MATERIAL_VARIABLES

    def _along(self, slopes: NDArray[np.float64], shapes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the change of the reflectance ρ, (n, m), for changes of the elements of the matrix Q, shape (n, 3).

        Q determines the shape of the Gaussian weights exp(−a dᵀQd) of Fourier coefficients.
        """
        by_form = slopes[[M_XX, M_XY, M_YY]]
        return np.asarray(np.einsum("pnm,np->nm", by_form, shapes) * self._illumination.falloffs)

    def _through_source(self, part: slice, slopes: NDArray[np.float64]) -> NDArray[np.float64] | float:
        """Return the part of the derivatives of ρ by the direction to the light that the matrix Q causes.

        Q is the shape of the Gaussian weights exp(−a dᵀQd) of Fourier coefficients. It describes the foreshortening of
        a source, which changes with the direction. Without a source, the part is 0.
        """
        if self._illumination.coherence.kind != "source":
            return 0.0
        light = self._illumination.lights[part]
        x, y = (light[:, :2] / light[:, 2:]).T
        zero, per_z = np.zeros_like(x), 1.0 / light[:, 2]
        by_x = per_z[:, None] * np.stack([2.0 * x, y, zero], axis=1)
        by_y = per_z[:, None] * np.stack([zero, x, 2.0 * y], axis=1)
        by_z = -per_z[:, None] * np.stack([2.0 * x * x, 2.0 * x * y, 2.0 * y * y], axis=1)
        return np.stack([self._along(slopes, change) for change in (by_x, by_y, by_z)])
