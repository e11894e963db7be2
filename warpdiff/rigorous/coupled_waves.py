"""Coupled-wave solutions of one-dimensional reliefs by the package meent, which is tested on a flat surface first.

The relief is cut into layers that are constant along z. Coupled-wave analysis (Moharam and Gaylord 1995) expands the
electric and magnetic fields in each layer as Fourier series along x with the orders (harmonics) −N to N. For p
polarisation it uses the inverse rule (Granet and Guizal 1996; Lalanne and Morris 1996; Li 1996).

The substrate is the material below the layers. Two properties of meent 0.13 matter here. It expects indices of
refraction n − ik. For p polarisation, a substrate with a complex index gives wrong efficiencies. An absorbing substrate
is therefore replaced by a layer so thick that no light returns from its lower end.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.colorimetry import NM_PER_UM
from warpdiff.optics.materials import reflectance_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.optics.materials import Material

    Array = NDArray[np.float64]

# Power that returns from the lower end of the layer that replaces an absorbing substrate, relative to the power that
# enters the layer. The value was chosen so that this power is about as small as rounding errors.
_RETURNED = 1e-13
# A substrate counts as transparent if the imaginary part k of its index of refraction is at most this value. A
# substrate with larger k is replaced by a layer that absorbs all light. For smaller k, this layer would be about 1 cm
# thick or thicker.
_TRANSPARENT = 1e-4
# Largest accepted difference between the solver's reflectance of a flat surface and that of Fresnel's equations. The
# value is far above rounding errors of float64.
_FLAT_ERROR = 1e-6
# Before use, the solver is tested on a flat layer: thickness of this layer [µm], and largest order N of the Fourier
# series of the electric and magnetic fields.
_FLAT_UM, _FLAT_HARMONICS = 0.1, 2


class Solution(NamedTuple):
    """Efficiencies of the reflected and of the transmitted diffraction orders −N to N, shape (2N + 1,) each."""

    reflected: Array
    transmitted: Array


def load_meent() -> Any:
    """Return the package meent, or raise an error that states how to install it."""
    try:
        import meent
    except ImportError:
        raise ImportError("rigorous solutions require the package meent: pip install 'warpdiff[rigorous]'") from None
    return meent


def layers_of(heights_um: Array, most: int) -> tuple[list[NDArray[np.bool_]], list[float]]:
    """Cut a relief into layers, from the top layer to the lowest one.

    Args:
        heights_um: Heights of one period [µm], shape (n,). The height is constant from each sample to the next one.
        most: Largest number of layers. A relief with more different heights is replaced by a staircase of this number
            of equal steps.

    Returns:
        For each layer, the mask of the samples that the material fills, shape (n,); and the thickness of each layer
        [µm].
    """
    levels = np.unique(heights_um)
    if len(levels) > most + 1:
        levels = np.linspace(levels[0], levels[-1], most + 1)
    middles = (levels[1:] + levels[:-1]) / 2.0
    # The material fills a sample of a layer if the height of the sample is above the middle of the layer. A comparison
    # with the top of the layer would depend on rounding errors, because many heights are equal to the top.
    tops = [heights_um > middle for middle in middles[::-1]]
    return tops, np.diff(levels)[::-1].tolist()


def solve(
    layers: list[NDArray[np.bool_]], thicknesses_um: list[float], period_um: float, *, wavelength_um: float,
    angle_rad: float, index: complex, polarisation: int, harmonics: int,
) -> Solution:  # fmt: skip
    """Return the efficiencies of all orders of one grating for one wavelength and one polarisation.

    Args:
        layers: Masks of the samples that the material fills, one mask of shape (n,) per layer, the top layer first.
        thicknesses_um: Thicknesses of the layers [µm].
        period_um: Period along x [µm].
        wavelength_um: Wavelength [µm].
        angle_rad: Angle of incidence θ [rad]; the direction to the light is (sin θ, 0, cos θ).
        index: Index n + ik of the material, which also fills the space below the layers.
        polarisation: 0 for s, the electric field along the grooves, and 1 for p.
        harmonics: Largest order N of the Fourier series of the fields.

    Raises:
        ValueError: The equations of the solver are singular.
    """
    meent = load_meent()
    below, bottom = [], index.real
    if index.imag > _TRANSPARENT:
        # This layer replaces an absorbing substrate. Light crosses the layer twice, and its power decreases with the
        # path z as exp(−4πkz/λ). The thickness is such that the fraction `_RETURNED` of the power remains.
        below = [-math.log(_RETURNED) * wavelength_um / (8.0 * math.pi * index.imag)]
        bottom = 1.0
    count = len(layers[0]) if layers else 2
    masks = [*layers, *(np.ones(count, dtype=bool) for _ in below)]
    cell = np.where(np.array(masks).reshape(-1, 1, count), np.conj(index), 1.0 + 0.0j)
    try:
        result = meent.call_mee(
            backend=0, pol=polarisation, n_top=1.0, n_bot=bottom, theta=-angle_rad, fto=[harmonics, 0],
            wavelength=wavelength_um, period=[period_um, 1.0], ucell=cell, thickness=[*thicknesses_um, *below],
            fourier_type=1,
        ).conv_solve()  # fmt: skip
    except np.linalg.LinAlgError:
        raise ArgumentValueError(
            f"{ref('wavelengths_nm')} has a wavelength of {NM_PER_UM * wavelength_um:.6g} nm, at which the equations "
            "of the solver are singular, probably because an order is exactly at the horizon: change the wavelength or "
            "the direction to the light slightly"
        ) from None
    return Solution(np.ravel(result.de_ri).real, np.ravel(result.de_ti).real)


def check_on_a_flat_surface(material: Material, index: complex, wavelength_nm: float, angle_rad: float) -> None:
    """Raise an error if the solver does not reproduce Fresnel's reflectance of a flat surface."""
    for number, name in ((0, "s"), (1, "p")):
        flat = solve(
            [np.ones(2, dtype=bool)], [_FLAT_UM], 1.0, wavelength_um=1e-3 * wavelength_nm, angle_rad=angle_rad,
            index=index, polarisation=number, harmonics=_FLAT_HARMONICS,
        ).reflected  # fmt: skip
        cosine = np.array([math.cos(angle_rad)])
        expected = reflectance_at(material, np.array([wavelength_nm]), cosine, "s" if name == "s" else "p")[0]
        if not abs(flat[_FLAT_HARMONICS] - expected) <= _FLAT_ERROR:
            raise RuntimeError(
                f"the installed meent gives the reflectance {flat[_FLAT_HARMONICS]:.6f} of a flat surface of "
                f"{material} for {name} polarisation, but Fresnel's equations give {expected:.6f}: install a version "
                "that the extra 'rigorous' names"
            )
