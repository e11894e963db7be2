"""``BakedLobes``: table of a height field's colours in all directions, and its file; the height field is not needed.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. K is the number of functions of w in a
table. Nodes are the samples of (u, v) on the rings of a polar grid. H₀₀ is the amplitude of the zeroth order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from warpdiff.baked import quantisation, table_files
from warpdiff.baked.interpolation import interpolated, lobe_grid
from warpdiff.core import forks, memory, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import check_reflection
from warpdiff.optics.spectra import Spectrum
from warpdiff.tables.polar_grid import PolarGrid
from warpdiff.tables.zeroth_order import ZerothOrder, between_entries

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Largest |w| of a scattering vector (u, v, w). It occurs if light and view are both along the normal.
LARGEST_W = 2.0
# Largest |κ| at which the zeroth order is tabulated [1/µm]. It is derived from κ = w/λ: the largest |w|, divided by the
# shortest visible wavelength.
LARGEST_KAPPA = 1e3 * LARGEST_W / colorimetry.LAMBDA_MIN_NM
# Largest number of functions of w in a table. The number is limited because a shader of another renderer stores the
# values of all functions in its registers.
MOST_W_BASIS = 16
# Number of wavelengths whose sum is the colour of the zeroth diffraction order in baked lobes.
_ZEROTH_WAVELENGTHS = 40
# Measured memory of a look-up [bytes per direction].
_BYTES_PER_LOOK_UP = 400
# The polar grid of colours in a file may have at most these numbers of rings (circles) per octave (doubling of the
# radius), of octaves, and of azimuth samples per ring. A file with larger numbers counts as damaged.
_MOST_RINGS, _MOST_OCTAVES, _MOST_AZIMUTHS = 512, 64, 2**20
# Largest values of arguments. `_MOST_SIZE` is the largest number of cells per side of a Cartesian grid. `_LONGEST_UM`
# is the longest wavelength for which the variance of a lobe (the peak of a diffraction order) is computed [µm].
_MOST_SIZE, _LONGEST_UM = 2048, 10.0
_KINDS = ("averaged", "source")


@dataclass(frozen=True, eq=False)
class BakedLobes(table_files.SavedTable):
    """Table of a height field's colours in all directions: XYZ(u, v, w) = w² Σ_k c_k(u, v) f_k(w) + the zeroth order.

    The f_k are principal functions of |w|. The c_k are coefficients for X, Y and Z at the nodes of a polar grid: a
    periodic cubic B-spline interpolates along each ring, and a cubic polynomial in ln |(u, v)| between rings. The power
    of the zeroth order at a wavelength λ is |H₀₀(w/λ)|² times a Gaussian, where H₀₀(κ) is the mean of exp(2πiκh) over
    the surface. Colours are for a geometry factor C·M of 1; :meth:`reflectance` multiplies by this factor. With a
    material, the colours include its reflectance R(θd, λ), where θd is half of the angle between ωi and ωr.

    Files contain the arrays ``functions``, ``exponents``, ``mantissas`` and ``zeroth``, with a material also
    ``reflectances``, and for a ``Spectrum`` also ``illuminant_nm`` and ``illuminant_values``. Files also contain
    ``coherence`` (kind), ``width`` (σ in µm, or the source's diameter in degrees), ``illuminant`` (name),
    ``tolerance``, ``error``, ``rings``, ``rays`` (azimuth samples) and ``scale``.

    Attributes:
        coherence: Averaged window or source. Lobes of a source are computed for normal incidence; at oblique incidence
            they have the correct power but are too wide.
        illuminant: Name of an illuminant, or a ``Spectrum``.
        tolerance: Requested 99th percentile of ΔE2000.
        error: Measured 99th percentile of ΔE2000 over directions to light and viewer on the whole hemisphere.
        grid: Polar grid of the nodes.
        functions: f_k at equally spaced |w| from 0 to 2, for linear interpolation, shape (entries, K), float32.
        scale: Magnitude of the largest coefficient.
        exponents: Largest magnitude of each node's coefficients for X, Y and Z, shape (nodes, 3), uint8. A value n
            means the magnitude ``scale`` · 2^((n − 255)/8).
        mantissas: Coefficients in units of 1/127 of the magnitude in ``exponents``, shape (nodes, 3, K), int8; or in
            units of 1/32767 of it, int16, for lobes with a brightness that varies strongly with w.
        zeroth: |H₀₀|² at equally spaced |κ| from 0 to 2 / 0.38 µm, for linear interpolation, shape (entries,), float32.
        reflectances: R of the material at equally spaced cos θd from 0 to 1 and wavelengths from 380 to 780 nm, for
            linear interpolation, shape (angles, wavelengths), float32; None without a material.

    Examples:
        >>> import warpdiff as wd
        >>> lobes = wd.bake(wd.gratings.sinusoidal(2.0, 0.1), delta_e=20.0, coherence=wd.Coherence(sigma_um=2.0))
        >>> lobes.save("lobes.npz").name
        'lobes.npz'
        >>> wd.BakedLobes.load("lobes.npz").bytes == lobes.bytes
        True
    """

    FORMAT = "warpdiff baked lobes, version 2"

    coherence: Coherence
    illuminant: str | Spectrum
    tolerance: float
    error: float
    grid: PolarGrid
    functions: NDArray[np.float32]
    scale: float
    exponents: NDArray[np.uint8]
    mantissas: NDArray[np.int8] | NDArray[np.int16]
    zeroth: NDArray[np.float32]
    reflectances: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        validation.instance(self.coherence, Coherence, "coherence")
        if self.coherence.kind not in _KINDS:
            raise ArgumentValueError(
                f"{ref('coherence')} must be of kind {' or '.join(_KINDS)}, got {self.coherence.kind!r}"
            )
        colorimetry.check_illuminant(self.illuminant)
        validation.positive(self.tolerance, "tolerance")
        validation.number(self.error, "error", least=0.0)
        validation.positive(self.scale, "scale")
        if not isinstance(self.grid, PolarGrid):
            raise ArgumentTypeError(f"{ref('grid')} must be a PolarGrid, got {type(self.grid).__name__}")
        if self.grid != lobe_grid(self.grid.rings, self.grid.azimuths):
            raise ArgumentValueError(f"{ref('grid')} must end one ring beyond |(u, v)| = 2, got {self.grid}")
        nodes = self.grid.nodes
        count = np.shape(self.mantissas)[-1] if np.ndim(self.mantissas) else 0
        if not 1 <= count <= MOST_W_BASIS:
            shape = np.shape(self.mantissas)
            raise ArgumentValueError(f"{ref('mantissas')} must have 1 to {MOST_W_BASIS} functions, got shape {shape}")
        table_files.check(
            self, functions=(np.float32, (None, count)), exponents=(np.uint8, (nodes, 3)), zeroth=(np.float32, (None,)),
            mantissas=(np.int16 if self.mantissas.dtype == np.int16 else np.int8, (nodes, 3, count)),
        )  # fmt: skip
        if self.reflectances is not None:
            table_files.check(self, reflectances=(np.float32, (None, None)))

    @property
    def bytes(self) -> int:
        """Size of the table of colours [bytes]."""
        arrays = (self.functions, self.exponents, self.mantissas, self.zeroth, self.reflectances)
        return sum(array.nbytes for array in arrays if array is not None)

    def __repr__(self) -> str:
        size = f"{self.functions.shape[1]} functions of w at {self.grid.nodes} nodes, {self.bytes / 1e6:.2g} MB"
        return f"BakedLobes({self.coherence}, {self.illuminant}, {size}, error {self.error:.2g} ΔE2000)"

    def __str__(self) -> str:
        material = ", with a material" if self.has_material else ""
        return (
            f"Baked lobes, {self.coherence}, under {self.illuminant}{material}: {self.functions.shape[1]} functions of "
            f"w at {self.grid.nodes} nodes of (u, v), {self.grid.rings} rings per octave with up to "
            f"{self.grid.azimuths[-1]} azimuth samples, {self.bytes / 1e6:.2g} MB. 99th-percentile ΔE2000 over the "
            f"hemisphere: {self.error:.2g}, requested: {self.tolerance:g}."
        )

    @property
    def has_material(self) -> bool:
        """Whether the colours include the reflectance of a material."""
        return self.reflectances is not None

    @forks.cached_property
    def coefficients(self) -> NDArray[np.float32]:
        """Spline coefficients of X, Y and Z at samples (nodes) of (u, v), for K functions of w, shape (nodes, 3, K)."""
        return quantisation.dequantise(self.scale, self.exponents, self.mantissas)

    def colours(self, scattering_vectors: ArrayLike, *, zeroth_order: bool = True) -> NDArray[np.float32]:
        """Return the colours of scattering vectors, for a geometry factor of 1.

        Args:
            scattering_vectors: (u, v, w) = −ωi − ωr, shape (n, 3).
            zeroth_order: Whether to include the zeroth order.

        Returns:
            CIE XYZ, shape (n, 3), float32.
        """
        uvw = validation.finite_array(scattering_vectors, "scattering_vectors", ndim=2, most=2.0 * LARGEST_W)
        if uvw.shape[1] != 3:
            raise ArgumentValueError(f"{ref('scattering_vectors')} must have shape (n, 3), got {uvw.shape}")
        validation.flag(zeroth_order, "zeroth_order")
        memory.require_memory(
            _BYTES_PER_LOOK_UP * len(uvw),
            f"{ref('scattering_vectors')} of {len(uvw)} rows",
            "take at most {share} of them",
        )
        at_uv = interpolated(self.grid, self.coefficients, uvw[:, :2])
        w = np.minimum(np.abs(uvw[:, 2]), LARGEST_W)
        colours = np.einsum("nck,nk->nc", at_uv, between_entries(self.functions, w / LARGEST_W)) * (w * w)[:, None]
        result: NDArray[np.float64] = np.maximum(colours, 0.0)
        if zeroth_order:
            result += self._zeroth_order(uvw[:, :2], w)
        return np.asarray(result, dtype=np.float32)

    def cartesian(self, size: int = 1024) -> NDArray[np.float32]:
        """Return the coefficients c_k of the functions of w on a Cartesian grid over (u, v); 0 for |(u, v)| > 2.

        Args:
            size: Number of cells from −2 to 2 along each axis, 2 to 2048.

        Returns:
            Coefficients at the centres of the cells, shape (size, size, 3, K), float32; the first index is along v, the
            second along u.
        """
        validation.count(size, "size", least=2, most=_MOST_SIZE)
        memory.require_memory(
            4.0 * size * size * self.coefficients[0].size, f"a grid of {ref('size', size)}", "take at most {side} of it"
        )
        axis = ((np.arange(size) + 0.5) / size * 2.0 - 1.0) * LARGEST_W
        result = np.zeros((size, size, *self.coefficients.shape[1:]), dtype=np.float32)
        for row, v in enumerate(axis):
            inside = np.flatnonzero(np.hypot(axis, v) <= LARGEST_W)
            at = np.column_stack([axis[inside], np.full(len(inside), v)])
            result[row, inside] = interpolated(self.grid, self.coefficients, at)
        return result

    def reflectance(
        self, to_light: ArrayLike, to_view: ArrayLike, *, ior: float | None = None, masking: bool = True
    ) -> NDArray[np.float32]:
        """Return colours like :func:`warpdiff.reflectance`, but from the table, with the error that ``error`` states.

        Args:
            to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
            to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length; a single
                direction broadcasts.
            ior: Index of refraction, above 1; ``math.inf`` is a perfect mirror. None means 1.5. Lobes that were baked
                with a material accept only None.
            masking: Whether to include V-cavity masking and shadowing.

        Returns:
            CIE XYZ, shape (n, 3), or (3,) for single directions, float32.
        """
        lights, views, single = validation.light_and_view(to_light, to_view)
        normal = normal_reflectance(self, ior)
        gains = reflectance_factors.gain(lights, views, normal=normal, masking=validation.flag(masking, "masking"))
        result = (gains[:, None] * self.colours(-lights - views)).astype(np.float32)
        return result[0] if single else result

    @property
    def _zeroth(self) -> ZerothOrder:
        return ZerothOrder(self.zeroth, 0.0, LARGEST_KAPPA, self.coherence)

    def _zeroth_order(self, uv: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return XYZ of the zeroth order for a geometry factor of 1, shape (n, 3)."""
        result = np.zeros((len(uv), 3))
        wavenumbers, weights = colorimetry.uniform_quadrature(_ZEROTH_WAVELENGTHS, self.illuminant)
        square = uv[:, 0] ** 2 + uv[:, 1] ** 2
        for tau, weight in zip(wavenumbers, weights, strict=True):
            exponent = 0.5 * square / self.lobe_variance(1.0 / tau)
            near = np.flatnonzero(exponent < 24.0)
            result[near] += (zeroth_order_power(self, w[near], tau) * np.exp(-exponent[near]))[:, None] * weight
        return result

    def lobe_variance(self, wavelength_um: float) -> float:
        """Return the variance of a diffraction order's lobe (peak) along u or v at a wavelength of at most 10 µm."""
        wavelength_um = validation.positive(wavelength_um, "wavelength_um", most=_LONGEST_UM)
        return self._zeroth.lobe_variance(wavelength_um)

    def _arrays(self) -> dict[str, Any]:
        coherence = self.coherence
        width = coherence.angular_diameter_deg if coherence.sigma_um is None else coherence.sigma_um
        arrays: dict[str, Any] = {
            "coherence": coherence.kind, "width": width, "illuminant": str(self.illuminant),
            "tolerance": self.tolerance, "error": self.error, "rings": self.grid.rings,
            "rays": np.array(self.grid.azimuths, dtype=np.int64), "scale": self.scale, "functions": self.functions,
            "exponents": self.exponents, "mantissas": self.mantissas, "zeroth": self.zeroth,
        }  # fmt: skip
        if self.reflectances is not None:
            arrays["reflectances"] = self.reflectances
        if isinstance(self.illuminant, Spectrum):
            arrays |= {"illuminant_nm": self.illuminant.wavelengths_nm, "illuminant_values": self.illuminant.values}
        return arrays

    @classmethod
    def _from_arrays(cls, arrays: dict[str, Any]) -> Self:
        kind: Any = str(arrays["coherence"])
        width: dict[str, Any] = {"angular_diameter_deg" if kind == "source" else "sigma_um": float(arrays["width"])}
        rings, azimuths = int(arrays["rings"]), arrays["rays"]
        if not 1 <= rings <= _MOST_RINGS or azimuths.dtype != np.int64 or not 1 <= azimuths.size <= _MOST_OCTAVES:
            raise ValueError("rings and rays must describe a polar grid")
        if azimuths.ndim != 1 or azimuths.min() < 4 or azimuths.max() > _MOST_AZIMUTHS:
            raise ValueError(f"rays must be 4 to {_MOST_AZIMUTHS}")
        illuminant: str | Spectrum = str(arrays["illuminant"])
        if "illuminant_nm" in arrays:
            illuminant = Spectrum(arrays["illuminant_nm"], arrays["illuminant_values"], str(illuminant))
        return cls(
            Coherence(kind, **width), illuminant, float(arrays["tolerance"]), float(arrays["error"]),
            lobe_grid(rings, tuple(azimuths.tolist())), arrays["functions"], float(arrays["scale"]),
            arrays["exponents"], arrays["mantissas"], arrays["zeroth"], arrays.get("reflectances"),
        )  # fmt: skip


def normal_reflectance(lobes: BakedLobes, ior: float | None) -> float:
    """Return the reflectance R(0) at normal incidence for an index of refraction; None means 1.5.

    For lobes with a baked material, return 1, because their colours already include its reflectance.
    """
    if not lobes.has_material:
        return check_reflection(ior, None)[0]
    if ior is not None:
        raise ArgumentValueError(f"{ref('ior')} must be None for lobes that were baked with a material, got {ior!r}")
    return 1.0


def zeroth_order_power(lobes: BakedLobes, w: NDArray[np.float64], wavenumber: float) -> NDArray[np.float64]:
    """Return the peak power of the zeroth order at |w| and 1/λ [1/µm], for a geometry factor of 1, shape (n,)."""
    power = lobes._zeroth.at(w * wavenumber)
    if lobes.reflectances is None:
        return power
    low, high = colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM
    at = np.full(1, (1e3 / wavenumber - low) / (high - low))
    # The reflectance depends on θd, half the angle between light and view. In the mirror direction, cos θd is |w|/2.
    reflectances = between_entries(between_entries(lobes.reflectances.T, at).T, w / LARGEST_W)[:, 0]
    return np.asarray(power * reflectances)
