"""Colours of directions as sums over sampled wavelengths, as a linear function of the powers of Fourier coefficients.

q = (u, v)/λ is a frequency, for the wavelength λ and the scattering vector (u, v, w). A lobe is the Gaussian weight of
a coefficient. The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.colour_sampling import (
    LEAST_WAVELENGTHS,
    MOST_WAVELENGTHS,
    OF_GAUSSIAN,
    count_of_material,
    counts_of,
)
from warpdiff.adjoint.gaussian_lobes import Pairs
from warpdiff.core.warnings import warn
from warpdiff.kernels.thresholds import LOWEST, TINY
from warpdiff.optics import colorimetry
from warpdiff.optics.materials import reflectance_at

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from warpdiff.optics.coherence import Coherence
    from warpdiff.render.picture_samples import LitPixels

# Number of pairs of a direction and a wavelength that are computed at once. The number is limited by memory: a pair
# requires about 500 bytes.
PAIRS_TOGETHER = 1 << 18
# Smallest and largest visible wavenumber 1/λ [1/µm].
LOW, HIGH = 1e3 / colorimetry.LAMBDA_MAX_NM, 1e3 / colorimetry.LAMBDA_MIN_NM


class WavelengthSums:
    """Colours of directions as sums over sampled wavelengths, with Gaussian weights (lobes) of Fourier coefficients.

    Footprints widen the lobes; a footprint is the change of (u, v) over a pixel. The truncation error determines the
    number of wavelengths; directions with similar numbers use the same wavelengths. For a light less than 2° above the
    horizon, the number of wavelengths is that for 2°. One warning states how many directions require more wavelengths
    than ``MOST_WAVELENGTHS``.
    """

    def __init__(
        self, groups: list[LitPixels], coherence: Coherence, truncation: float, height_range_um: float
    ) -> None:
        """Choose the wavelengths for the directions of some groups.

        Args:
            groups: Directions by illuminant and material.
            coherence: Coherence of the light: an averaged window, or a source.
            truncation: Relative error of the integral over the wavelengths.
            height_range_um: Range of the heights [µm].
        """
        self._groups, self._coherence = groups, coherence
        self._is_source = coherence.kind == "source"
        undersampled = 0
        self._classes: list[list[tuple[NDArray[np.int64], int]]] = []
        for group in groups:
            counts = counts_of(self._rates(group, height_range_um), self._span, truncation)
            if group.illuminated.material is not None and len(counts):
                least = count_of_material(
                    LEAST_WAVELENGTHS, -group.scattering_vectors, group.illuminated.material,
                    group.illuminated.illuminant, truncation, geometric=self._is_source,
                )  # fmt: skip
                counts = np.maximum(counts, least)
            undersampled += int(np.count_nonzero(counts > MOST_WAVELENGTHS))
            counts = np.minimum(counts, MOST_WAVELENGTHS)
            # The number of wavelengths of a direction is rounded up to a power of √2, so that more directions use the
            # same wavelengths.
            octaves = np.ceil(2.0 * np.log2(counts / LEAST_WAVELENGTHS)).astype(np.int64)
            self._classes.append([])
            for k in np.unique(octaves).tolist():
                count = math.ceil(LEAST_WAVELENGTHS * 2.0 ** (k / 2.0))
                self._classes[-1].append((np.flatnonzero(octaves == k), count))
        if undersampled:
            warn(
                f"{undersampled} of {sum(len(group.gains) for group in groups)} samples require more than "
                f"{MOST_WAVELENGTHS} wavelengths, and their colours may be wrong: give a larger source or footprint"
            )

    @property
    def _span(self) -> float:
        return math.log(HIGH / LOW) if self._is_source else HIGH - LOW

    @property
    def pair_count(self) -> int:
        """Number of all pairs of a direction and a wavelength that the colours require."""
        return sum(len(chosen) * count for classes in self._classes for chosen, count in classes)

    def parts(self) -> Iterator[tuple[int, NDArray[np.int64], Pairs, NDArray[np.float64], NDArray[np.float64]]]:
        """Yield the pairs of n directions and m wavelengths, in parts that fit into memory.

        Each item is the index of the group of directions with one illuminant and material, the indices of the
        directions in it, the pairs, the factors by which the weighted sums of |H|² are multiplied, shape (n, m), and
        the weights that sum the products to XYZ, shape (m, 3).
        """
        for index, (group, classes) in enumerate(zip(self._groups, self._classes, strict=True)):
            for chosen, count in classes:
                wavenumbers, weights = colorimetry.uniform_quadrature(
                    count, group.illuminated.illuminant, geometric=self._is_source, signed=True
                )
                size = max(PAIRS_TOGETHER // count, 1)
                for first in range(0, len(chosen), size):
                    part = chosen[first : first + size]
                    pairs, factors = self._pairs(group.among(part), wavenumbers)
                    yield index, part, pairs, factors, weights

    def colours(self, sums: Callable[[Pairs], NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Return XYZ of the directions of each group, shape (n, 3).

        ``sums`` is a function of pairs (a direction and a wavelength). For each pair it returns the sum of the powers
        |H|² of Fourier coefficients with Gaussian weights.
        """
        result = [np.zeros((len(group.gains), 3)) for group in self._groups]
        for index, part, pairs, factors, weights in self.parts():
            result[index][part] = (sums(pairs).reshape(factors.shape) * factors) @ weights
        return result

    def adjoints(self, adjoints: list[NDArray[np.float64]]) -> Iterator[tuple[Pairs, NDArray[np.float64]]]:
        """Yield groups of pairs (direction, wavelength) with the adjoint of the power of each pair.

        ``adjoints`` are those of the XYZ of each direction, which is a sum of these powers over wavelengths.
        """
        for index, part, pairs, factors, weights in self.parts():
            yield pairs, ((adjoints[index][part] @ weights.T) * factors).ravel()

    def _variances(self, group: LitPixels, lowest: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the elements xx, xy and yy of two covariance matrices for each direction, shape (n, 3) each.

        The first matrix is the covariance that a coherence window causes in the frequency q = (u, v)/λ. The second
        matrix is the covariance that a light source and the pixel's footprint cause in (u, v). A direction to a light
        with a z component below ``lowest`` counts as having this z component.
        """
        count = len(group.gains)
        of_q, of_uv = np.zeros((count, 3)), np.zeros((count, 3))
        if group.footprints is not None:
            of_uv += group.footprints
        if self._is_source:
            # A source of finite size has the covariance s² (I − t tᵀ) of (u, v). s is the angular radius of the source
            # divided by √2 [radians], I is the unit matrix, and t has the x and y components of the direction to the
            # light.
            x, y = group.to_lights[:, 0], group.to_lights[:, 1]
            longest = np.minimum(1.0, math.sqrt(1.0 - lowest**2) / np.maximum(np.hypot(x, y), TINY))
            x, y = longest * x, longest * y
            of_uv += self._coherence.spread**2 * np.stack([1.0 - x * x, -x * y, 1.0 - y * y], axis=1)
        else:
            of_q += 1.0 / (8.0 * (math.pi * (self._coherence.sigma_um or 1.0)) ** 2) * np.array([1.0, 0.0, 1.0])
        return of_q, of_uv

    def _rates(self, group: LitPixels, height_range_um: float) -> NDArray[np.float64]:
        """Return the largest angular frequency of each direction's spectrum, as a function of 1/λ [rad·µm].

        For a light source of finite size, the spectrum is a function of ln λ instead [rad].
        """
        u, v, w = group.scattering_vectors.T
        # For a light near the horizon, the source is foreshortened to 0, and the result would become infinite. The
        # limit `LOWEST` prevents this.
        of_q, of_uv = self._variances(group, LOWEST)
        phase = -2.0 * math.pi * w * height_range_um
        # At the longest wavelength, the variance of q = (u, v)/λ is smallest. The diffraction orders are then
        # narrowest, and the spectrum oscillates fastest.
        xx, xy, yy = (of_q / LOW**2 + of_uv).T
        crossing = np.sqrt((yy * u * u - 2.0 * xy * u * v + xx * v * v) / (xx * yy - xy * xy))
        if self._is_source:
            return np.asarray(HIGH * phase + OF_GAUSSIAN * crossing)
        return np.asarray(phase + OF_GAUSSIAN * crossing / LOW)

    def _pairs(self, group: LitPixels, wavenumbers: NDArray[np.float64]) -> tuple[Pairs, NDArray[np.float64]]:
        """Return the pairs of n directions with m wavelengths, and factors (n, m) of their weighted sums of |H|²."""
        vectors = group.scattering_vectors
        of_q, of_uv = self._variances(group)
        xx, xy, yy = np.moveaxis(of_q[:, None] + of_uv[:, None] * wavenumbers[:, None] ** 2, 2, 0)
        determinants = xx * yy - xy * xy
        forms = 0.5 * np.stack([yy, -xy, xx], axis=-1) / determinants[..., None]
        factors = np.repeat(group.gains[:, None], len(wavenumbers), axis=1)
        if group.footprints is not None:
            # The footprint (range of (u, v)) of a pixel widens the lobe (Gaussian weight) of a Fourier coefficient. The
            # maximum of the lobe becomes lower, so that its integral is unchanged.
            own = of_q[:, None] + (of_uv - group.footprints)[:, None] * wavenumbers[:, None] ** 2
            factors *= np.sqrt((own[..., 0] * own[..., 2] - own[..., 1] ** 2) / determinants)
        if group.illuminated.material is not None:
            cosines = 0.5 * np.linalg.norm(vectors, axis=1)[:, None]
            factors *= reflectance_at(group.illuminated.material, 1e3 / wavenumbers, cosines)
        centres = vectors[:, None, :2] * wavenumbers[:, None]
        kappas = -vectors[:, None, 2] * wavenumbers
        return Pairs(centres.reshape(-1, 2), forms.reshape(-1, 3), kappas.ravel()), factors
