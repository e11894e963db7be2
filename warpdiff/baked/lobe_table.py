"""``BakedLobes``: table of a height field's colours in all directions, and its file; the height field is not needed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.baked import quantisation, table_files
from warpdiff.baked.interpolation import PolarGrid
from warpdiff.core import files, forks, memory, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import check_reflection
from warpdiff.optics.spectra import Spectrum

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

FORMAT = "warpdiff baked lobes, version 2"
LARGEST_W = 2.0
# |κ| of the zeroth order's entries end at that of the largest |w| and the shortest wavelength [1/µm].
LARGEST_KAPPA = 1e3 * LARGEST_W / colorimetry.LAMBDA_MIN_NM
MOST_W_BASIS = 16
_ZEROTH_WAVELENGTHS = 40
# What a look-up takes, as measured.
_BYTES_PER_LOOK_UP = 400
_MOST_RINGS, _MOST_OCTAVES, _MOST_AZIMUTHS = 512, 64, 2**20
_MOST_SIZE, _LONGEST_UM = 2048, 10.0
_KINDS = ("averaged", "source")


@dataclass(frozen=True, eq=False)
class BakedLobes:
    """Table of a height field's colours in all directions: XYZ(u, v, w) = w² Σ_k c_k(u, v) f_k(w) + the zeroth order.

    f_k are principal functions of |w|. c_k are coefficients for X, Y and Z at the nodes of a polar grid: a periodic
    cubic B-spline interpolates around each ring, and a cubic in ln |(u, v)| between rings. The zeroth order is
    |H₀₀(w/λ)|² times a Gaussian at each wavelength. Colours are for a geometry factor of 1; :meth:`reflectance`
    multiplies by it. With a material, the colours include its reflectance R(θd, λ).

    Attributes:
        coherence: Averaged window or source. Lobes of a source are those at normal incidence; at oblique incidence they
            keep their power but are too wide.
        illuminant: Name of an illuminant, or a ``Spectrum``.
        tolerance: Requested 99th percentile of ΔE2000.
        error: Measured 99th percentile of ΔE2000 over directions of the whole hemisphere.
        grid: Polar grid of the nodes.
        functions: f_k at equal steps of |w| from 0 to 2, shape (entries, K), float32; linear in between.
        scale: Magnitude of the largest coefficient.
        exponents: Magnitude of each node's coefficients for X, Y and Z, shape (nodes, 3), uint8: 255 is ``scale``, each
            step less is an eighth of an octave less.
        mantissas: Coefficients in 127ths of that magnitude, shape (nodes, 3, K), int8; or in 32767ths, int16, for lobes
            whose brightness varies strongly with w.
        zeroth: |H₀₀|² at equal steps of |κ| from 0 to 2 / 0.38 µm, shape (entries,), float32; linear in between.
        reflectances: R of the material at equal steps of cos θd from 0 to 1 and of the wavelength from 380 to 780 nm,
            shape (angles, wavelengths), float32, linear in between; None without a material.
    """

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
        nodes = self.grid.nodes
        count = np.shape(self.mantissas)[-1] if np.ndim(self.mantissas) else 0
        if not 1 <= count <= MOST_W_BASIS:
            shape = np.shape(self.mantissas)
            raise ArgumentValueError(f"{ref('mantissas')} must have 1 to {MOST_W_BASIS} functions, got shape {shape}")
        for name in ("functions", "zeroth"):
            if np.ndim(getattr(self, name)) == 0 or len(getattr(self, name)) < 2:
                raise ArgumentValueError(f"{ref(name)} must have at least two entries")
        table_files.check(
            self, functions=(np.float32, (len(self.functions), count)), exponents=(np.uint8, (nodes, 3)),
            mantissas=(np.int16 if self.mantissas.dtype == np.int16 else np.int8, (nodes, 3, count)),
            zeroth=(np.float32, (len(self.zeroth),)),
        )  # fmt: skip
        if self.reflectances is not None:
            table_files.check(self, reflectances=(np.float32, np.shape(self.reflectances)))
            if self.reflectances.ndim != 2 or min(self.reflectances.shape) < 2:
                shape = self.reflectances.shape
                raise ArgumentValueError(f"{ref('reflectances')} must have shape (angles, wavelengths), got {shape}")

    @property
    def bytes(self) -> int:
        """Size of the table [bytes]."""
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
        """The splines' coefficients at the nodes, shape (nodes, 3, K)."""
        return quantisation.dequantise(self.scale, self.exponents, self.mantissas)

    def colours(self, scattering_vectors: ArrayLike, *, zeroth_order: bool = True) -> NDArray[np.float32]:
        """Colours of scattering vectors, for a geometry factor of 1.

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
        at_uv = self.grid.interpolated(self.coefficients, uvw[:, :2])
        w = np.minimum(np.abs(uvw[:, 2]), LARGEST_W)
        colours = np.einsum("nck,nk->nc", at_uv, _linear(self.functions, w / LARGEST_W)) * (w * w)[:, None]
        result: NDArray[np.float64] = np.maximum(colours, 0.0)
        if zeroth_order:
            result += self._zeroth_order(uvw[:, :2], w)
        return np.asarray(result, dtype=np.float32)

    def cartesian(self, size: int = 1024) -> NDArray[np.float32]:
        """Coefficients on a Cartesian grid over (u, v), at the centres of its cells; 0 outside the disc |(u, v)| ≤ 2.

        Args:
            size: Number of cells from −2 to 2 along each axis, 2 to 2048.

        Returns:
            Coefficients, shape (size, size, 3, K), float32; the first index goes along v, the second along u.
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
            result[row, inside] = self.grid.interpolated(self.coefficients, at)
        return result

    def reflectance(
        self, to_light: ArrayLike, to_view: ArrayLike, *, ior: float | None = None, masking: bool = True
    ) -> NDArray[np.float32]:
        """Colours of the reflectance, as :func:`warpdiff.reflectance` computes them, up to :attr:`error`.

        Args:
            to_light: Directions to the light in the local frame, shape (3,) or (n, 3), of any length.
            to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3), of any length; a single
                direction broadcasts.
            ior: Index of refraction, above 1; ``math.inf`` is a perfect mirror, None is 1.5. None with a material.
            masking: Whether to include V-cavity masking and shadowing.

        Returns:
            CIE XYZ, shape (n, 3), or (3,) for single directions, float32.
        """
        lights, views, single = validation.light_and_view(to_light, to_view)
        normal = normal_reflectance(self, ior)
        gains = reflectance_factors.gain(lights, views, normal=normal, masking=validation.flag(masking, "masking"))
        result = (gains[:, None] * self.colours(-lights - views)).astype(np.float32)
        return result[0] if single else result

    def _zeroth_order(self, uv: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the mean plane reflects, for a gain of 1, where it is not nothing."""
        result = np.zeros((len(uv), 3))
        wavenumbers, weights = colorimetry.uniform_quadrature(_ZEROTH_WAVELENGTHS, self.illuminant)
        square = uv[:, 0] ** 2 + uv[:, 1] ** 2
        for tau, weight in zip(wavenumbers, weights, strict=True):
            exponent = 0.5 * square / self.lobe_variance(1.0 / tau)
            near = np.flatnonzero(exponent < 24.0)
            result[near] += (zeroth_order_power(self, w[near], tau) * np.exp(-exponent[near]))[:, None] * weight
        return result

    def lobe_variance(self, wavelength_um: float) -> float:
        """Variance of a lobe in (u, v) along each axis, at a wavelength [µm], above 0 and at most 10."""
        wavelength_um = validation.positive(wavelength_um, "wavelength_um", most=_LONGEST_UM)
        if self.coherence.sigma_um is None:
            return self.coherence.spread**2
        return wavelength_um**2 / (8.0 * (math.pi * self.coherence.sigma_um) ** 2)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the table to a file; an existing file is replaced only after the new one is complete.

        The file is a compressed ``.npz`` of NumPy. It holds the arrays ``functions``, ``exponents``, ``mantissas`` and
        ``zeroth``, with a material also ``reflectances``, and for a ``Spectrum`` also ``illuminant_nm`` and
        ``illuminant_values``. It also holds ``format``, ``coherence`` (kind), ``width`` (σ in µm, or the source's
        diameter in degrees), ``illuminant`` (name), ``tolerance``, ``error``, ``rings``, ``rays`` (azimuth samples) and
        ``scale``.

        Args:
            path: Path of the file, ending in ``.npz``.

        Returns:
            The path.
        """
        coherence = self.coherence
        width = coherence.angular_diameter_deg if coherence.sigma_um is None else coherence.sigma_um
        arrays: dict[str, Any] = {
            "format": FORMAT, "coherence": coherence.kind, "width": width, "illuminant": str(self.illuminant),
            "tolerance": self.tolerance, "error": self.error, "rings": self.grid.rings,
            "rays": np.array(self.grid.azimuths, dtype=np.int64), "scale": self.scale, "functions": self.functions,
            "exponents": self.exponents, "mantissas": self.mantissas, "zeroth": self.zeroth,
        }  # fmt: skip
        if self.reflectances is not None:
            arrays["reflectances"] = self.reflectances
        if isinstance(self.illuminant, Spectrum):
            arrays |= {"illuminant_nm": self.illuminant.wavelengths_nm, "illuminant_values": self.illuminant.values}
        return files.save_arrays(path, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> BakedLobes:
        """Read a table from a file of :meth:`save`.

        Args:
            path: Path of the file.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file is damaged or of another format.
        """
        with table_files.loaded(path, FORMAT, "BakedLobes") as arrays:
            return cls._from_arrays(arrays)

    @classmethod
    def _from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> BakedLobes:
        kind: Any = str(arrays["coherence"])
        width = float(arrays["width"])
        is_source = kind == "source"
        coherence = Coherence(
            kind, sigma_um=None if is_source else width, angular_diameter_deg=width if is_source else None
        )
        rings, azimuths = int(arrays["rings"]), arrays["rays"]
        if not 1 <= rings <= _MOST_RINGS or azimuths.dtype != np.int64 or not 1 <= azimuths.size <= _MOST_OCTAVES:
            raise ValueError("rings and rays must describe a polar grid")
        if azimuths.ndim != 1 or azimuths.min() < 4 or azimuths.max() > _MOST_AZIMUTHS:
            raise ValueError(f"rays must be 4 to {_MOST_AZIMUTHS}")
        illuminant: str | Spectrum = str(arrays["illuminant"])
        if "illuminant_nm" in arrays:
            illuminant = Spectrum(arrays["illuminant_nm"], arrays["illuminant_values"], str(illuminant))
        return cls(
            coherence, illuminant, float(arrays["tolerance"]), float(arrays["error"]),
            PolarGrid(rings, tuple(azimuths.tolist())), arrays["functions"], float(arrays["scale"]),
            arrays["exponents"], arrays["mantissas"], arrays["zeroth"], arrays.get("reflectances"),
        )  # fmt: skip


def normal_reflectance(lobes: BakedLobes, ior: float | None) -> float:
    """R(0) of an index of refraction, None for 1.5; 1 of a material, which no index may be given beside."""
    if not lobes.has_material:
        return check_reflection(ior, None)[0]
    if ior is not None:
        raise ArgumentValueError(f"{ref('ior')} must be None for lobes that were baked with a material, got {ior!r}")
    return 1.0


def zeroth_order_power(lobes: BakedLobes, w: NDArray[np.float64], wavenumber: float) -> NDArray[np.float64]:
    """Power of the zeroth order at |w| and 1/λ [1/µm], at the peak of its lobe, for a geometry factor of 1."""
    power = _linear(lobes.zeroth[:, None], w * wavenumber / LARGEST_KAPPA)[:, 0]
    if lobes.reflectances is None:
        return power
    low, high = colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM
    at = np.full(1, (1e3 / wavenumber - low) / (high - low))
    # In the mirror direction cos θd is half of w.
    return np.asarray(power * _linear(_linear(lobes.reflectances.T, at).T, w / LARGEST_W)[:, 0])


def _linear(entries: NDArray[Any], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows between entries (n, m) at equal steps, at shares of the whole range from 0 to 1."""
    at = share * (len(entries) - 1)
    first = np.clip(at.astype(np.int64), 0, len(entries) - 2)
    t = (at - first)[:, None]
    return np.asarray((1.0 - t) * entries[first] + t * entries[first + 1])
