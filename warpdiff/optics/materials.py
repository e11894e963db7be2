"""Materials: reflectance of smooth surfaces by complex indices of refraction, with or without a thin film.

The reflectance of a flat boundary is computed by Fresnel's equations, and the reflectance of a thin film by Airy's sum
(Born and Wolf, Principles of Optics, sections 1.5, 1.6 and 14.4). Indices are n + ik, with k > 0 for absorption. Light
arrives through air.
"""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

import numpy as np

from warpdiff.core import validation
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.optics import colorimetry, refractive_index_files
from warpdiff.optics.reflectance_factors import normal_reflectance, schlick

if TYPE_CHECKING:
    import os
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

    _Complex = NDArray[np.complex128]

METALS = Path(__file__).with_name("metals.json")
Metal = Literal["Al", "Ag", "Au", "Cr", "Cu", "Ni"]
Polarisation = Literal["s", "p"]
# Largest thickness of a film [nm]. In thicker films, interference fringes are so narrow in wavelength that the
# wavelengths of a colour computation would miss them.
_THICKEST_FILM_NM = 1000.0
# A material with a larger imaginary part k of the index counts as opaque, so that a pigment (the base colour of the
# mesh) below it is invisible. At this k, the power of light of 500 nm falls to 1/e within 4 µm of the material. If the
# value was doubled, more materials would show the pigment below them.
_OPAQUE = 0.01
# Number of angles at which the transmittance of a surface is tabulated. Between these angles it is interpolated
# linearly. For Schlick's reflectance, the interpolated transmittance has an absolute error of at most 3e-6.
_TRANSMITTANCE_ANGLES = 1025

# Index of refraction if the caller gives neither an index nor a material: glass.
DEFAULT_IOR = 1.5


@dataclass(frozen=True, eq=False)
class Material(ReadOnlyArrays):
    """Material with a complex index of refraction n + ik, interpolated linearly, and at most one thin film.

    Two materials are equal if their numbers are equal.

    Attributes:
        wavelengths_nm: Wavelengths of the table [nm], increasing, 100 to 10,000, shape (m,). A single one applies to
            all wavelengths.
        n: Real parts of the index, 0.001 to 100, shape (m,) or one number.
        k: Imaginary parts of the index, 0 to 100, shape (m,) or one number.
        name: Name in messages and ``print``.
        source: Origin of the numbers, and their licence.
        film: Material of the film; None is no film.
        film_nm: Thickness of the film [nm], 0 to 1000.

    Examples:
        >>> import warpdiff as wd
        >>> gold = wd.Material.metal("Au")
        >>> gold.reflectance([450.0, 650.0], angle_deg=0.0).round(2)
        array([0.41, 0.96])
        >>> print(wd.Material.metal("Al").coated(wd.Material.dielectric(1.38), 100.0))
        aluminium under 100 nm of n = 1.38
    """

    wavelengths_nm: ArrayLike = field(repr=False)
    n: ArrayLike = field(repr=False)
    k: ArrayLike = field(default=0.0, repr=False)
    name: str = "material"
    source: str = field(default="", repr=False)
    film: Material | None = None
    film_nm: float = 0.0
    _key: tuple[object, ...] = field(init=False, repr=False)
    # Whether the reflectance depends on the angle of incidence; it does not for the materials of ``fixed_reflectance``.
    has_angles: ClassVar[bool] = True

    def __post_init__(self) -> None:
        wavelengths = colorimetry.check_wavelengths(self.wavelengths_nm)
        if np.any(np.diff(wavelengths) <= 0.0):
            raise ArgumentValueError(f"{ref('wavelengths_nm')} must be strictly increasing")
        object.__setattr__(self, "wavelengths_nm", wavelengths)
        for name, least in (("n", 1e-3), ("k", 0.0)):
            values = np.atleast_1d(validation.finite_array(getattr(self, name), name))
            if values.shape not in (wavelengths.shape, (1,)):
                raise ArgumentValueError(
                    f"{ref(name)} must have one number, or one per wavelength, {wavelengths.shape}, got {values.shape}"
                )
            values = np.array(np.broadcast_to(values, wavelengths.shape))
            if values.min() < least or values.max() > 100.0:
                raise ArgumentValueError(
                    f"{ref(name)} must lie within {least:g} to 100, got {values.min():g} to {values.max():g}"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        wavelengths.setflags(write=False)
        for name in ("name", "source"):
            if not isinstance(getattr(self, name), str):
                raise ArgumentTypeError(f"{ref(name)} must be a string, got {type(getattr(self, name)).__name__}")
        validation.instance(self.film, Material, "film", optional=True)
        thickness = validation.number(self.film_nm, "film_nm", least=0.0, most=_THICKEST_FILM_NM)
        if self.film is not None and self.film.film is not None:
            raise ArgumentValueError(f"{ref('film')} must be a material without a film of its own, got {self.film}")
        object.__setattr__(self, "film_nm", thickness if self.film is not None else 0.0)
        numbers = [np.asarray(column).tobytes() for column in (wavelengths, self.n, self.k)]
        object.__setattr__(self, "_key", (*numbers, self.film, self.film_nm))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Material) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __str__(self) -> str:
        return self.name if self.film is None else f"{self.name} under {self.film_nm:g} nm of {self.film.name}"

    @classmethod
    def dielectric(cls, n: float) -> Material:
        """Return a transparent material.

        Args:
            n: Index of refraction at all wavelengths, more than 1.

        Examples:
            >>> import warpdiff as wd
            >>> glass = wd.Material.dielectric(1.5)
            >>> print(f"{glass.reflectance(550.0, 0.0):.3f}")
            0.040
        """
        return cls([550.0], [validation.number(n, "n", above=1.0)], name=f"n = {n:g}")

    @classmethod
    def metal(cls, symbol: Metal) -> Material:
        """Return a measured metal; its ``source`` names the measurement.

        Args:
            symbol: Chemical symbol: Al, Ag, Au, Cr, Cu or Ni.

        Examples:
            >>> import warpdiff as wd
            >>> print(wd.Material.metal("Cu"))
            copper
        """
        return _metals()[validation.choice(symbol, "symbol", get_args(Metal))]

    @classmethod
    def from_nk(
        cls, wavelengths_nm: ArrayLike, n: ArrayLike, k: ArrayLike = 0.0, *, name: str = "material"
    ) -> Material:
        """Return a material with a table of its index of refraction n + ik, linear between wavelengths.

        Args:
            wavelengths_nm: Wavelengths [nm], increasing, 100 to 10,000, shape (m,).
            n: Real parts, 0.001 to 100, shape (m,) or one number.
            k: Imaginary parts, 0 to 100, shape (m,) or one number, by default 0.
            name: Name in messages and ``print``.

        Examples:
            >>> import warpdiff as wd
            >>> chitin = wd.Material.from_nk([380.0, 780.0], [1.58, 1.55], name="chitin")
            >>> print(f"{chitin.reflectance(580.0, 0.0):.4f}")
            0.0485
        """
        return cls(wavelengths_nm, n, k, name=name)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Material:
        r"""Load a material from a file of refractiveindex.info, in YAML (tables, formulas 1 to 9) or in CSV.

        Args:
            path: Path of the file: YAML with suffix ``.yml`` or ``.yaml``, otherwise CSV with columns or blocks of
                wavelengths [µm, or nm if the header says so], n and k. Rows outside 100 to 10,000 nm are cut off.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file has no index of refraction that can be read, or a row that does not consist of a
                wavelength and numbers; the message names the line.

        Examples:
            >>> import pathlib, tempfile
            >>> import warpdiff as wd
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "glass.csv"
            >>> _ = file.write_text("wl,n\n0.38,1.53\n0.78,1.51\n")
            >>> print(wd.Material.from_file(file))
            glass
        """
        file = validation.path(path, "path")
        wavelengths_nm, n, k, source = refractive_index_files.read(file)
        try:
            return cls(wavelengths_nm, n, k, name=file.stem, source=source)
        except ValueError as error:
            raise ArgumentValueError(f"{ref('path')}: {file.name}: {error}") from None

    def coated(self, film: Material, thickness_nm: float) -> Material:
        """Return this material with a thin film on it.

        Args:
            film: Material of the film, without a film of its own.
            thickness_nm: Thickness of the film [nm], more than 0 and at most 1000.

        Examples:
            >>> import warpdiff as wd
            >>> print(wd.Material.metal("Cr").coated(wd.Material.dielectric(2.4), 60.0))
            chromium under 60 nm of n = 2.4
        """
        validation.instance(film, Material, "film")
        thickness = validation.number(thickness_nm, "thickness_nm", above=0.0, most=_THICKEST_FILM_NM)
        if self.film is not None:
            raise ArgumentValueError(
                f"{ref('film')} cannot be added to {self}, which has a film already: only one film layer is supported"
            )
        return Material(self.wavelengths_nm, self.n, self.k, self.name, self.source, film, thickness)

    def reflectance(
        self, wavelengths_nm: ArrayLike, angle_deg: ArrayLike, *, polarisation: Polarisation | None = None
    ) -> NDArray[np.float64]:
        """Power reflectance R of a flat surface in air.

        Args:
            wavelengths_nm: Wavelengths [nm], within the table.
            angle_deg: Angles of incidence from the normal [degrees], 0 to 90; they broadcast against the wavelengths.
            polarisation: ``"s"``, perpendicular to the plane of incidence, or ``"p"``, parallel to it; None is
                unpolarised light, the mean of both.

        Returns:
            R, 0 to 1, in the broadcast shape.

        Examples:
            >>> import warpdiff as wd
            >>> wd.Material.dielectric(1.5).reflectance(550.0, [0.0, 56.31], polarisation="p").round(3)
            array([0.04, 0.  ])
        """
        wavelengths = validation.finite_array(wavelengths_nm, "wavelengths_nm")
        angles = validation.finite_array(angle_deg, "angle_deg")
        if angles.size and (angles.min() < 0.0 or angles.max() > 90.0):
            raise ArgumentValueError(
                f"{ref('angle_deg')} must lie within 0 to 90, got {angles.min():g} to {angles.max():g}"
            )
        if polarisation is not None:
            validation.choice(polarisation, "polarisation", get_args(Polarisation))
        try:
            np.broadcast_shapes(wavelengths.shape, angles.shape)
        except ValueError:
            raise ArgumentValueError(
                f"{ref('wavelengths_nm')} and {ref('angle_deg')} must broadcast, got shapes {wavelengths.shape} and "
                f"{angles.shape}"
            ) from None
        if wavelengths.size:
            colorimetry.check_wavelengths(wavelengths.ravel())
            check_covers(self, float(wavelengths.min()), float(wavelengths.max()))
        return reflectance_at(self, wavelengths, np.cos(np.radians(angles)), polarisation)

    @property
    def is_opaque(self) -> bool:
        """Whether the material transmits no visible light to a pigment (base colour of the mesh) below it."""
        return bool(np.max(index_at(self, colorimetry.VISIBLE_NM).imag) > _OPAQUE)


def reflectance_at(
    material: Material,
    wavelengths_nm: NDArray[np.float64],
    cosine: NDArray[np.float64],
    polarisation: Polarisation | None = None,
) -> NDArray[np.float64]:
    """Return the power reflectance R at wavelengths [nm] and cosines of the angle of incidence, which broadcast."""
    cosine = np.clip(cosine, 0.0, 1.0) if material.has_angles else np.ones_like(cosine)
    media = [index_at(medium, wavelengths_nm) for medium in (material.film, material) if medium is not None]
    # Cosines of the angle of refraction in each medium, by Snell's law. They are complex in an absorbing medium. The
    # principal square root belongs to the wave that decays into the medium.
    along2 = 1.0 - cosine * cosine
    indices = [np.ones_like(media[0]), *media]
    cosines = [cosine + 0j, *(np.sqrt(1.0 - along2 / (index * index) + 0j) for index in media)]
    result: NDArray[np.float64] = np.zeros(np.broadcast_shapes(np.shape(wavelengths_nm), np.shape(cosine)))
    polarisations: tuple[Polarisation, ...] = get_args(Polarisation) if polarisation is None else (polarisation,)
    for component in polarisations:
        amplitude, *below = (
            _fresnel(first, second, one, other, component)
            for first, second, one, other in zip(indices, indices[1:], cosines, cosines[1:], strict=False)
        )
        if below:
            # Airy's formula sums all reflections between the two boundaries of the film.
            below[0] = below[0] * np.exp(4j * np.pi * material.film_nm / wavelengths_nm * indices[1] * cosines[1])
            amplitude = (amplitude + below[0]) / (1.0 + amplitude * below[0])
        result = result + np.abs(amplitude) ** 2 / len(polarisations)
    return np.asarray(result)


def reflectances(
    material: Material | None, scattering_vectors: NDArray[np.float64], wavelengths_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return R(θd, λ), shape (n, m), for n scattering vectors and m wavelengths [nm]; cos θd = |(u, v, w)|/2.

    (u, v, w) = −ωi − ωr is a scattering vector, and θd is half of the angle between ωi and ωr. Without a material the
    result is 1, because the geometry factors (gains) already contain Schlick's reflectance.
    """
    if material is None:
        return np.ones((1, 1))
    return reflectance_at(material, wavelengths_nm, np.linalg.norm(scattering_vectors, axis=1)[:, None] / 2.0)


def check_covers(material: Material, low_nm: float, high_nm: float, name: str = "material") -> None:
    """Raise ``ValueError`` if the index table of a material, or of its film, does not cover a range of wavelengths."""
    for part in (material, material.film):
        table = np.zeros(1) if part is None else np.asarray(part.wavelengths_nm)
        if part is not None and len(table) > 1 and (low_nm < table[0] or high_nm > table[-1]):
            raise ArgumentValueError(
                f"{ref(name)} must cover {low_nm:g} to {high_nm:g} nm, but {part.name!r} is tabulated from "
                f"{table[0]:g} to {table[-1]:g} nm"
            )


def index_at(material: Material, wavelengths_nm: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return n + ik of a material without its film at wavelengths [nm]; beyond its table, n + ik is constant."""
    table, n, k = (np.asarray(column) for column in (material.wavelengths_nm, material.n, material.k))
    return np.asarray(np.interp(wavelengths_nm, table, n) + 1j * np.interp(wavelengths_nm, table, k))


def _fresnel(
    first: _Complex, second: _Complex, cosine: _Complex, next_cosine: _Complex, polarisation: Polarisation
) -> _Complex:
    """Return Fresnel's amplitude reflectance at a boundary, from index and cosine of the angle in both media."""
    a, b = (first * cosine, second * next_cosine) if polarisation == "s" else (second * cosine, first * next_cosine)
    total = a + b
    # The divisor is 0 only for grazing incidence on the boundary between media with equal indices. It is then replaced
    # by 1.
    return np.asarray((a - b) / np.where(total == 0.0, 1.0, total))


@functools.cache
def _metals() -> dict[str, Material]:
    """Return the metals in the data file ``metals.json``, by chemical symbol."""
    tables = json.loads(METALS.read_text(encoding="utf-8"))
    return {
        symbol: Material(
            table["wavelengths_nm"], table["n"], table["k"], table["name"], f"{table['source']}; {table['licence']}"
        )
        for symbol, table in tables.items()
    }


@dataclass(frozen=True)
class IlluminatedMaterial:
    """Illuminant and the material that it illuminates. Colours are computed separately for each combination.

    Attributes:
        illuminant: Name or spectrum of the illuminant.
        material: Material; None if the geometry factors (gains) already contain Schlick's reflectance.
    """

    illuminant: colorimetry.Illuminant
    material: Material | None = None

    @classmethod
    def of(
        cls, illuminants: Iterable[colorimetry.Illuminant], materials: Iterable[Material | None]
    ) -> tuple[IlluminatedMaterial, ...]:
        """Return all combinations of one of ``illuminants`` and one of ``materials``, without duplicates."""
        return tuple(dict.fromkeys(itertools.starmap(cls, itertools.product(illuminants, materials))))


@functools.lru_cache(maxsize=64)
def reflectance_table(material: Material, angles: int) -> NDArray[np.float32]:
    """Return the reflectance of a material at equally spaced cosines and at 380, 381, … 780 nm, shape (angles, 401).

    The cosines are those of the angle of incidence, from 0 to 1.
    """
    cosines = np.linspace(0.0, 1.0, angles)[:, None]
    result = reflectance_at(material, colorimetry.VISIBLE_NM, cosines).astype(np.float32)
    result.setflags(write=False)
    return result


def check_reflection(ior: object, material: Any) -> tuple[float, Material | None]:
    """Return R(0), to which the relative reflectance ρ of a surface refers, and the material or None.

    R(0) is the reflectance at normal incidence that follows from the index of refraction ``ior``. With a material, R(0)
    is 1, and ρ is relative to a perfect mirror.
    """
    if material is None:
        return normal_reflectance(DEFAULT_IOR if ior is None else ior), None
    validation.instance(material, Material, "material")
    _check_no_ior(ior)
    return 1.0, material


def check_materials(
    ior: object, material: Any, band_nm: tuple[float, float], *, by_geometry: bool
) -> tuple[float, dict[str, Material | None]]:
    """Return R(0) as `check_reflection` does, and the materials by name.

    A name is that of a geometry (part of a mesh) that has the material; a single material has the name ``""``. With
    ``by_geometry`` the argument ``material`` may be a mapping from such names to materials. The table of each material
    must cover ``band_nm``, from the shortest to the longest wavelength of the call.
    """
    if not (by_geometry and isinstance(material, Mapping)):
        normal, one = check_reflection(ior, material)
        if one is not None:
            check_covers(one, *band_nm)
        return normal, {"": one}
    _check_no_ior(ior)
    if not material:
        raise ArgumentValueError(
            f"{ref('material')} must map the names of the mesh's geometries to materials, got {{}}"
        )
    for name, of_geometry in material.items():
        if not isinstance(name, str):
            raise ArgumentTypeError(
                f"{ref('material')} must have names of geometries as keys, got {type(name).__name__}"
            )
        validation.instance(of_geometry, Material, f"material[{name!r}]")
        check_covers(of_geometry, *band_nm, f"material[{name!r}]")
    return 1.0, dict(material)


def _check_no_ior(ior: object) -> None:
    if ior is not None:
        raise ArgumentValueError(
            f"{ref('ior')} must not be given with {ref('material')}, got {ior!r}: remove one of them"
        )


def transmittances(normal: float, material: Material | None) -> NDArray[np.float64]:
    """Return the transmittance 1 − R of a surface above a pigment (base colour), in linear RGB, shape (n, 3).

    The n rows are for equally spaced cosines of the angle of incidence, from 0 to 1. Without a material, R is Schlick's
    reflectance. Opaque materials transmit nothing. For other materials, with or without a film, 1 − R is averaged over
    the wavelengths separately for red, green and blue. The weight of a wavelength is its contribution to the colour of
    a white pigment under D65.
    """
    cosines = np.linspace(0.0, 1.0, _TRANSMITTANCE_ANGLES)
    if material is None:
        through = np.repeat((1.0 - schlick(cosines, normal))[:, None], 3, axis=1)
        return np.asarray(through)
    if material.is_opaque:
        return np.zeros((len(cosines), 3))
    transmittance = 1.0 - reflectance_at(material, colorimetry.VISIBLE_NM, cosines[:, None])
    weights = colorimetry.xyz_to_rgb(colorimetry.VISIBLE_NM[:, None] ** 2 * colorimetry.colour_products("D65"))
    return np.asarray(np.clip(transmittance @ weights / weights.sum(axis=0), 0.0, 1.0))
