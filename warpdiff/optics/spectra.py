"""Spectra of light sources: measurements, black bodies and phases of daylight."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import validation
from warpdiff.core.files import read_text
from warpdiff.core.read_only import ReadOnlyArrays
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

if TYPE_CHECKING:
    import os

    from numpy.typing import ArrayLike

# Constant c₂ of Planck's law [nm K], from CIE 15.
_SECOND_RADIATION_CONSTANT = 1.4388e7
# Range of correlated colour temperatures for which the CIE formula for phases of daylight is valid [K].
_DAYLIGHT_K = (4000.0, 25_000.0)


def colour_science() -> Any:
    """Return the package colour-science, which is imported at its first use only, because the import is slow."""
    with warnings.catch_warnings(), np.printoptions():
        # The import of colour-science has two side effects, which are prevented here. It warns of absent optional
        # packages, which warpdiff does not use, and it changes NumPy's print options.
        warnings.simplefilter("ignore")
        import colour

    return colour


@dataclass(frozen=True, eq=False)
class Spectrum(ReadOnlyArrays):
    """Relative spectral power distribution for ``illuminant=``, interpolated linearly.

    Two spectra are equal if their numbers are equal. Spectral lines narrower than 1 nm keep their power in colours.
    Wavelengths outside 380 to 780 nm are kept, and have no effect on colours.

    Attributes:
        wavelengths_nm: Wavelengths [nm], increasing, covering 380 to 780, with steps of any size, shape (m,), m > 1.
        values: Relative powers, at least 0, shape (m,).
        name: Name in messages and ``print``.

    Examples:
        >>> import warpdiff as wd
        >>> diode = wd.Spectrum([380.0, 580.0, 780.0], [0.0, 1.0, 0.2], name="LED")
        >>> light = wd.DirectionalLight([0.0, 0.0, 1.0], illuminant=diode)
        >>> print(light.illuminant)
        LED
    """

    wavelengths_nm: ArrayLike = field(repr=False)
    values: ArrayLike = field(repr=False)
    name: str = "spectrum"
    _key: tuple[bytes, bytes] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        wavelengths = np.atleast_1d(validation.finite_array(self.wavelengths_nm, "wavelengths_nm"))
        values = np.atleast_1d(validation.finite_array(self.values, "values", most=validation.MOST))
        if wavelengths.ndim != 1 or wavelengths.shape != values.shape or len(wavelengths) < 2:
            raise ArgumentValueError(
                f"{ref('wavelengths_nm')} and {ref('values')} must have the same shape (m,), m > 1, got "
                f"{wavelengths.shape} and {values.shape}"
            )
        if np.any(np.diff(wavelengths) <= 0.0):
            raise ArgumentValueError(f"{ref('wavelengths_nm')} must be strictly increasing")
        if wavelengths[0] > 380.0 or wavelengths[-1] < 780.0:
            raise ArgumentValueError(
                f"{ref('wavelengths_nm')} must cover 380 to 780 nm, got {wavelengths[0]:g} to {wavelengths[-1]:g} nm"
            )
        if values.min() < 0.0:
            raise ArgumentValueError(f"{ref('values')} must not be negative, got {values.min():g}")
        inside = (wavelengths >= 400.0) & (wavelengths <= 700.0)
        visible = np.interp(np.concatenate([np.arange(400.0, 701.0), wavelengths[inside]]), wavelengths, values)
        if (brightest := visible.max()) <= validation.LEAST:
            raise ArgumentValueError(
                f"{ref('values')} must exceed {validation.LEAST:g} between 400 and 700 nm, got {brightest:g} at most"
            )
        if not isinstance(self.name, str):
            raise ArgumentTypeError(f"{ref('name')} must be a string, got {type(self.name).__name__}")
        for name, array in (("wavelengths_nm", wavelengths), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "_key", (wavelengths.tobytes(), values.tobytes()))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Spectrum) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __str__(self) -> str:
        return self.name

    @classmethod
    def blackbody(cls, temperature_k: float) -> Spectrum:
        """Return the spectrum of a black body by Planck's law.

        Args:
            temperature_k: Temperature [K], 500 to 100,000; filaments have 2700 to 3200.

        Examples:
            >>> import warpdiff as wd
            >>> print(wd.Spectrum.blackbody(2856.0))
            black body of 2856 K
        """
        kelvin = validation.number(temperature_k, "temperature_k", least=500.0, most=1e5)
        nm = np.arange(360.0, 831.0)
        # Spectral powers are divided by the power at 560 nm, which prevents overflow.
        exponents = _SECOND_RADIATION_CONSTANT / kelvin * (1.0 / nm - 1.0 / 560.0)
        ratio = np.expm1(-_SECOND_RADIATION_CONSTANT / (kelvin * 560.0)) / np.expm1(
            -_SECOND_RADIATION_CONSTANT / (kelvin * nm)
        )
        return cls(nm, (560.0 / nm) ** 5 * np.exp(-exponents) * ratio, name=f"black body of {kelvin:g} K")

    @classmethod
    def daylight(cls, temperature_k: float) -> Spectrum:
        """Return the spectrum of a phase of daylight (CIE 15).

        Args:
            temperature_k: Correlated colour temperature [K], 4000 to 25,000.

        Examples:
            >>> import warpdiff as wd
            >>> print(wd.Spectrum.daylight(6500.0))
            daylight of 6500 K
        """
        kelvin = validation.number(temperature_k, "temperature_k", least=_DAYLIGHT_K[0], most=_DAYLIGHT_K[1])
        colour = colour_science()
        distribution = colour.sd_CIE_illuminant_D_series(colour.temperature.CCT_to_xy_CIE_D(kelvin))
        return cls(distribution.wavelengths, np.maximum(distribution.values, 0.0), name=f"daylight of {kelvin:g} K")

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> Spectrum:
        r"""Load a spectrum from a text file.

        Args:
            path: Path of the file: two columns, wavelength [nm] and relative power, separated by commas, semicolons or
                whitespace. Lines without two numbers are ignored.

        Raises:
            OSError: The file does not exist, or cannot be read.
            ValueError: The file has no such columns.

        Examples:
            >>> import pathlib, tempfile
            >>> import warpdiff as wd
            >>> file = pathlib.Path(tempfile.mkdtemp()) / "diode.csv"
            >>> _ = file.write_text("nm,power\n380,0.1\n580,1\n780,0.2\n")
            >>> print(wd.Spectrum.from_csv(file))
            diode
        """
        file = validation.path(path, "path")
        rows = []
        for line in read_text(file).splitlines():
            try:
                rows.append([float(cell) for cell in re.split(r"[,;\s]+", line.strip())[:2]])
            except ValueError:
                continue
        rows = [row for row in rows if len(row) == 2]
        if len(rows) < 2:
            raise ArgumentValueError(
                f"{ref('path')}: {file.name} must have two columns of numbers, wavelength [nm] and power"
            )
        table = np.array(rows)
        try:
            return cls(table[:, 0], table[:, 1], name=file.stem)
        except ValueError as error:
            raise ArgumentValueError(f"{ref('path')}: {file.name}: {error}") from None
