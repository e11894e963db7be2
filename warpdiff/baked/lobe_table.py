"""``BakedLobes``: colours of a height field in all directions, as a table that needs no height field, and its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.baked import quantisation, table_files
from warpdiff.baked.interpolation import PolarGrid
from warpdiff.core import forks, memory, validation
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
_MIRROR_WAVELENGTHS = 40
# What a look-up takes, as measured.
_BYTES_A_LOOK_UP = 400
_MOST_RINGS, _MOST_OCTAVES, _MOST_RAYS = 512, 64, 2**20
_MOST_SIZE, _LONGEST_UM = 2048, 10.0
_KINDS = ("averaged", "source")


@dataclass(frozen=True, eq=False)
class BakedLobes:
    """Colours of a height field in all directions, XYZ(u, v, w) = w² Σ_k c_k(u, v) f_k(w), and the zeroth order beside.

    The functions f_k are the principal ones of |w| of all (u, v), the coefficients c_k, three of each, for X, Y and Z,
    lie at the nodes of a polar grid: a periodic cubic B-spline around each ring, and cubics in ln |(u, v)| from ring to
    ring. The mean plane's lobe, brighter than others by orders of magnitude, is |H₀₀(w/λ)|² times a Gaussian at each
    wavelength. Everything is for a gain C·M of 1; :meth:`reflectance` multiplies by it. With a material its reflectance
    R(θd, λ) is within the colours, and C is without it.

    Attributes:
        coherence: The window, averaged, or the source. Of a source lobes are those of light from above, and
            keep their power where it comes aslant, where they would be narrower.
        illuminant: Name of an illuminant, or a ``Spectrum``.
        tolerance: Percentile 99 of ΔE2000 that was asked for.
        error: What was measured, on directions all over the hemisphere.
        grid: Where the nodes lie.
        functions: f_k at equal steps of |w| from 0 to 2, shape (entries, K), float32; linear in between.
        scale: The size of the largest of all coefficients.
        exponents: Of each node's coefficients for X, Y and Z, eighths of an octave below ``scale`` from 255 on, shape
            (nodes, 3), uint8.
        mantissas: The coefficients in 127ths of that size, shape (nodes, 3, K), int8; or, where lobes are much
            brighter at some w than at others, in 32767ths, int16.
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
            raise ValueError(f"coherence must be of kind {' or '.join(_KINDS)}, got {self.coherence.kind!r}")
        colorimetry.check_illuminant(self.illuminant)
        validation.positive(self.tolerance, "tolerance")
        validation.number(self.error, "error", least=0.0)
        validation.positive(self.scale, "scale")
        if not isinstance(self.grid, PolarGrid):
            raise TypeError(f"grid must be a PolarGrid, got {type(self.grid).__name__}")
        nodes = self.grid.nodes
        count = np.shape(self.mantissas)[-1] if np.ndim(self.mantissas) else 0
        if not 1 <= count <= MOST_W_BASIS:
            raise ValueError(
                f"mantissas must be of 1 to {MOST_W_BASIS} functions, got shape {np.shape(self.mantissas)}"
            )
        for name in ("functions", "zeroth"):
            if np.ndim(getattr(self, name)) == 0 or len(getattr(self, name)) < 2:
                raise ValueError(f"{name} must have at least two entries")
        table_files.check(
            self,
            functions=(np.float32, (len(self.functions), count)),
            exponents=(np.uint8, (nodes, 3)),
            mantissas=(np.int16 if self.mantissas.dtype == np.int16 else np.int8, (nodes, 3, count)),
            zeroth=(np.float32, (len(self.zeroth),)),
        )
        if self.reflectances is not None:
            table_files.check(self, reflectances=(np.float32, np.shape(self.reflectances)))
            if self.reflectances.ndim != 2 or min(self.reflectances.shape) < 2:
                raise ValueError(f"reflectances must have shape (angles, wavelengths), got {self.reflectances.shape}")

    @property
    def bytes(self) -> int:
        """Size of the table."""
        arrays = (self.functions, self.exponents, self.mantissas, self.zeroth, self.reflectances)
        return sum(each.nbytes for each in arrays if each is not None)

    def __str__(self) -> str:
        material = ", with a material" if self.has_material else ""
        return (
            f"Baked lobes, {self.coherence}, under {self.illuminant}{material}: {self.functions.shape[1]} functions of "
            f"w at {self.grid.nodes} nodes of (u, v), {self.grid.rings} rings an octave with up to "
            f"{self.grid.rays[-1]} rays, {self.bytes / 1e6:.2g} MB. Percentile 99 of ΔE2000 over the hemisphere "
            f"{self.error:.2g}, of {self.tolerance:g} asked for."
        )

    @property
    def has_material(self) -> bool:
        """Whether the reflectance of a material is within the colours."""
        return self.reflectances is not None

    @forks.cached_property
    def coefficients(self) -> NDArray[np.float32]:
        """The splines' coefficients at the nodes, shape (nodes, 3, K)."""
        return quantisation.dequantise(self.scale, self.exponents, self.mantissas)

    def colours(self, scattering_vectors: ArrayLike, *, zeroth_order: bool = True) -> NDArray[np.float32]:
        """XYZ of deflections for a gain of 1.

        Args:
            scattering_vectors: (u, v, w) = −ωi − ωr, shape (n, 3).
            zeroth_order: Whether the mean plane's lobe is among them.

        Returns:
            CIE XYZ, shape (n, 3), float32.
        """
        given = validation.finite_array(scattering_vectors, "scattering_vectors", ndim=2, most=2.0 * LARGEST_W)
        if given.shape[1] != 3:
            raise ValueError(f"deflections must have shape (n, 3), got {given.shape}")
        validation.flag(zeroth_order, "zeroth_order")
        memory.require_memory(
            _BYTES_A_LOOK_UP * len(given), f"a look-up of {len(given)} deflections", "take at most {share} of them"
        )
        at_uv = self.grid.interpolated(self.coefficients, given[:, :2])
        w = np.minimum(np.abs(given[:, 2]), LARGEST_W)
        found = np.einsum("nck,nk->nc", at_uv, _linear(self.functions, w / LARGEST_W)) * (w * w)[:, None]
        result: NDArray[np.float64] = np.maximum(found, 0.0)
        if zeroth_order:
            result += self._zeroth_order(given[:, :2], w)
        return np.asarray(result, dtype=np.float32)

    def cartesian(self, size: int = 1024) -> NDArray[np.float32]:
        """The coefficients on a Cartesian grid over (u, v), at the centres of its cells; 0 outside the disc.

        Args:
            size: Cells from −2 to 2 along either axis, 2 to 2048.

        Returns:
            Shape (size, size, 3, K), float32; the first index goes along v, the second along u.
        """
        if not 2 <= validation.count(size, "size") <= _MOST_SIZE:
            raise ValueError(f"size must be 2 to {_MOST_SIZE}, got {size}")
        memory.require_memory(
            4.0 * size * size * self.coefficients[0].size, f"a grid of size={size}", "take at most {side} of it"
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
        """Colour of the reflectance, as :func:`warpdiff.reflectance` has it, within :attr:`error`.

        Args:
            to_light: Directions to the light in the local frame, shape (3,) or (n, 3); normalised here.
            to_view: Directions to the viewer, the same; one and many broadcast.
            ior: Index of refraction, > 1; ``math.inf`` is a perfect mirror, None is 1.5, or what the material says.
            masking: Whether V-cavity masking and shadowing is included.

        Returns:
            CIE XYZ, shape (n, 3), or (3,) for single directions, float32.
        """
        lights, one_light = validation.directions(to_light, "to_light")
        views, one_view = validation.directions(to_view, "to_view")
        if len(lights) != len(views) and 1 not in (len(lights), len(views)):
            raise ValueError(
                f"to_light and to_view must hold the same number of directions, or one, got {len(lights)} and "
                f"{len(views)}"
            )
        shape = (max(len(lights), len(views)) if len(lights) and len(views) else 0, 3)
        lights, views = np.broadcast_to(lights, shape), np.broadcast_to(views, shape)
        normal = normal_reflectance(self, ior)
        gains = reflectance_factors.gain(lights, views, normal=normal, masking=validation.flag(masking, "masking"))
        result = (gains[:, None] * self.colours(-lights - views)).astype(np.float32)
        return result[0] if one_light and one_view else result

    def _zeroth_order(self, uv: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the mean plane reflects, for a gain of 1, where it is not nothing."""
        result = np.zeros((len(uv), 3))
        wavenumbers, weights = colorimetry.uniform_quadrature(_MIRROR_WAVELENGTHS, self.illuminant)
        square = uv[:, 0] ** 2 + uv[:, 1] ** 2
        for tau, weight in zip(wavenumbers, weights, strict=True):
            exponent = 0.5 * square / self.lobe_variance(1.0 / tau)
            near = np.flatnonzero(exponent < 24.0)
            result[near] += (mirror_power(self, w[near], tau) * np.exp(-exponent[near]))[:, None] * weight
        return result

    def lobe_variance(self, wavelength_um: float) -> float:
        """The variance of a lobe in (u, v) along either axis at a wavelength [µm]."""
        wavelength_um = validation.positive(wavelength_um, "wavelength_um", most=_LONGEST_UM)
        if self.coherence.sigma_um is None:
            return self.coherence.spread**2
        return wavelength_um**2 / (8.0 * (math.pi * self.coherence.sigma_um) ** 2)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the table; an existing file is replaced only once the new one is complete.

        The file is NumPy's ``.npz``, compressed, of the arrays ``functions``, ``exponents``, ``mantissas`` and
        ``zeroth``, of ``reflectances`` where there is a material, and of ``format``, ``coherence`` (kind), ``width`` (σ
        in µm, or the source's diameter in degrees), ``illuminant`` (name), ``tolerance``, ``error``, ``rings``,
        ``rays`` and ``scale``; for a ``Spectrum`` also of ``illuminant_nm`` and ``illuminant_values``.

        Args:
            path: Where to; it ends in ``.npz``.

        Returns:
            The path.
        """
        coherence = self.coherence
        width = coherence.angular_diameter_deg if coherence.sigma_um is None else coherence.sigma_um
        told: dict[str, Any] = {
            "format": FORMAT, "coherence": coherence.kind, "width": width, "illuminant": str(self.illuminant),
            "tolerance": self.tolerance, "error": self.error, "rings": self.grid.rings,
            "rays": np.array(self.grid.rays, dtype=np.int64), "scale": self.scale, "functions": self.functions,
            "exponents": self.exponents, "mantissas": self.mantissas, "zeroth": self.zeroth,
        }  # fmt: skip
        if self.reflectances is not None:
            told["reflectances"] = self.reflectances
        if isinstance(self.illuminant, Spectrum):
            told |= {"illuminant_nm": self.illuminant.wavelengths_nm, "illuminant_values": self.illuminant.values}
        return table_files.save(path, told)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> BakedLobes:
        """Read what :meth:`save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is no such file, or damaged.
        """
        with table_files.loaded(path, FORMAT, "BakedLobes") as found:
            return cls._of_file(found)

    @classmethod
    def _of_file(cls, found: dict[str, NDArray[Any]]) -> BakedLobes:
        kind, width = str(found["coherence"]), float(found["width"])
        is_source = kind == "source"
        coherence = Coherence(
            kind, sigma_um=None if is_source else width, angular_diameter_deg=width if is_source else None
        )
        rings, rays = int(found["rings"]), found["rays"]
        if not 1 <= rings <= _MOST_RINGS or rays.dtype != np.int64 or not 1 <= rays.size <= _MOST_OCTAVES:
            raise ValueError("rings and rays must be those of a grid")
        if rays.ndim != 1 or rays.min() < 4 or rays.max() > _MOST_RAYS:
            raise ValueError(f"rays must be 4 to {_MOST_RAYS}")
        illuminant: str | Spectrum = str(found["illuminant"])
        if "illuminant_nm" in found:
            illuminant = Spectrum(found["illuminant_nm"], found["illuminant_values"], str(illuminant))
        return cls(
            coherence, illuminant, float(found["tolerance"]), float(found["error"]),
            PolarGrid(rings, tuple(rays.tolist())), found["functions"], float(found["scale"]), found["exponents"],
            found["mantissas"], found["zeroth"], found.get("reflectances"),
        )  # fmt: skip


def normal_reflectance(lobes: BakedLobes, ior: float | None) -> float:
    """R(0) of an index of refraction, None for 1.5; 1 of a material, which no index may be given beside."""
    if not lobes.has_material:
        return check_reflection(ior, None)[0]
    if ior is not None:
        raise ValueError("ior must not be given beside lobes that were baked with a material")
    return 1.0


def mirror_power(lobes: BakedLobes, w: NDArray[np.float64], wavenumber: float) -> NDArray[np.float64]:
    """What the mean plane reflects at |w| where its lobe is highest, for a gain of 1 and 1/λ [1/µm]."""
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
