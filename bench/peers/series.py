"""Taylor series of Fourier coefficients and a quadrature in λ, for all programs with the published algorithm.

The programs in NumPy, Numba and Dr.Jit compute the same sum (Single 2014, eqs. 3.8, 3.20 and 3.24). Wavelengths are
equally spaced. At each wavelength the series is evaluated for a square block of Fourier coefficients around the
frequency (u, v)/λ. A Gaussian weights these coefficients. The integral over λ is a rectangle rule.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. w is the component along the normal. An averaged window is a Gaussian coherence window whose
results are averaged over all its positions, so that the powers of coefficients add. A centred window has one position,
so that the amplitudes add.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.diffraction import fourier_coefficients
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.optics import colorimetry
from warpdiff.tables.coefficient_table import falloff_um2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    import warpdiff as wd

# Largest spatial frequency |(u, v)|/λ [1/µm] for which Fourier coefficients are stored: light and view are at the
# horizon on the same side, and λ is 380 nm.
FREQUENCY = 2.0 / 0.38
# Largest accepted ``neighbour_extent``, the number of neighbouring Fourier coefficients on each side of the central
# one. Memory limits the value: the stored block of coefficients extends by this number beyond the largest frequency.
MOST_REACH = 4

# Setting of the publication (Single 2014): 81 wavelengths, terms n = 0 … 36 of the Taylor series, and 3 × 3 Fourier
# coefficients around the one that floor() selects. Heights are relative to the lowest height.
PUBLISHED: dict[str, Any] = {"wavelengths": 81, "terms": 37, "neighbour_extent": 1, "rounded": False, "centred": False}
# Settings from cheap to accurate: number of wavelengths, number of terms of the Taylor series, and number of
# neighbouring coefficients on each side of the central one. Unlike in the publication, heights are relative to the
# middle of their range, and the central coefficient is the nearest one. The same error of the colours then requires
# fewer terms and coefficients. The first setting uses only the central coefficient. It suits patches that are small
# compared with the coherence window.
_SHAPES = ((192, 12, 0), (41, 8, 1), (81, 12, 1), (136, 12, 1), (192, 12, 1), (272, 16, 1), (384, 16, 2))
SETTINGS: list[dict[str, Any]] = [
    {"wavelengths": wavelengths, "terms": terms, "neighbour_extent": neighbour_extent, "rounded": True, "centred": True}
    for wavelengths, terms, neighbour_extent in _SHAPES
]


@dataclass(frozen=True, eq=False)
class Series:
    """Taylor series of a height field's Fourier coefficients, with the quadrature over λ, for one setting.

    The height h is written as offset + a·g, where a is the scale of the heights and |g| <= 1. There are m wavelengths.

    Attributes:
        rows: Real and imaginary parts of iⁿ DFT{gⁿ} for all n, with g = (h − offset)/a, shape (my·mx, 2, terms).
        columns: Number mx of columns of coefficients.
        origin: Row and column of the zeroth order, (y, x).
        lengths_um: Lengths Ly and Lx [µm]; the position of a frequency q among the coefficients is q·L.
        falloff: Factors f of the Gaussian weight exp(−f d²) along y and x, where d is the distance in numbers of
            coefficients.
        factors: (2πa/λ)ⁿ/n!, shape (m, terms); their products with wⁿ are the basis functions of the series.
        wavenumbers: 1/λ [1/µm], shape (m,).
        colours: Contribution of each wavelength to XYZ, shape (m, 3).
        neighbour_extent: Number of neighbouring coefficients on either side of the central one.
        shift: Number that is added to the position (u, v)/λ·L before floor(): 0, or 0.5 to round.
        powers: Whether powers |H|² are summed (averaged window), instead of amplitudes H (centred window).
    """

    rows: NDArray[np.float32]
    columns: int
    origin: tuple[int, int]
    lengths_um: tuple[float, float]
    falloff: tuple[float, float]
    factors: NDArray[np.float32]
    wavenumbers: NDArray[np.float32]
    colours: NDArray[np.float32]
    neighbour_extent: int
    shift: float
    powers: bool


def series(
    heightfield: wd.HeightField, coherence: wd.Coherence, *,
    wavelengths: int, terms: int, neighbour_extent: int, rounded: bool, centred: bool,
) -> Series:  # fmt: skip
    """Compute the Taylor series of a height field's Fourier coefficients for one setting.

    Args:
        heightfield: Height field.
        coherence: Gaussian coherence window, of the kind averaged or centred.
        wavelengths: Number of wavelengths between 380 and 780 nm.
        terms: Number of terms of the Taylor series, n = 0 … terms − 1.
        neighbour_extent: Number of neighbouring coefficients on either side of the central one, 0 to 4.
        rounded: Whether the position (u, v)/λ is rounded to the central coefficient, instead of by floor().
        centred: Whether heights are relative to the middle of their range, instead of to the lowest height.

    Returns:
        The series.
    """
    if coherence.kind not in ("averaged", "centred"):
        raise ValueError(f"coherence must be a window, 'averaged' or 'centred', got {coherence.kind!r}")
    if not 0 <= neighbour_extent <= MOST_REACH:
        raise ValueError(f"neighbour_extent must be 0 to {MOST_REACH}, got {neighbour_extent}")
    rows, block, lengths, scale = rows_of(heightfield, terms, centred)
    nodes = np.linspace(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, wavelengths)
    products = colorimetry.colour_products()
    grid = np.linspace(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM, len(products))
    colours = np.stack([np.interp(nodes, grid, products[:, c]) for c in range(3)], axis=1)
    falloff = falloff_um2(coherence)
    return Series(
        rows=rows, columns=block.count[1], origin=block.origin, lengths_um=lengths,
        falloff=(falloff / lengths[0] ** 2, falloff / lengths[1] ** 2),
        factors=np.float32(EXPANSIONS["taylor"].basis(scale * 1e3 / nodes, terms)), wavenumbers=np.float32(1e3 / nodes),
        colours=np.float32(colours / colours[:, 1].sum()), neighbour_extent=neighbour_extent,
        shift=0.5 if rounded else 0.0, powers=coherence.adds_powers,
    )  # fmt: skip


@functools.lru_cache(maxsize=3)
def rows_of(
    heightfield: wd.HeightField, terms: int, centred: bool
) -> tuple[NDArray[np.float32], fourier_coefficients.Block, tuple[float, float], float]:
    """Return the Taylor terms of a :class:`Series`, the block of stored Fourier coefficients, the lengths and a scale.

    The lengths are Ly and Lx [µm]. The scale is 2πa [µm], where a is the scale of the heights in :class:`Series`.
    """
    grid = fourier_coefficients.patch_grid(heightfield)
    block = fourier_coefficients.Block.covering(grid, FREQUENCY, (MOST_REACH + 1,) * 2)
    if any(count == period for count, period in zip(block.count, block.shape, strict=True)):
        raise ValueError(f"heightfield must be finer, got {heightfield!r}: use heightfield.resampled()")
    expansion = EXPANSIONS["taylor" if centred else "taylor-uncentred"]
    made = fourier_coefficients.series_coefficients(heightfield, expansion, terms, block, dtype=np.complex64)
    # The phases of the coefficients are made relative to the centre of the patch, where a centred coherence window is.
    # An averaged window sums |coefficient|², which is independent of phases.
    s, r = block.orders()
    ny, nx = heightfield.shape
    turns = s[:, None] * (ny // 2 / ny) + r * (nx // 2 / nx)
    made *= np.exp(-2j * math.pi * turns)[:, :, None].astype(np.complex64)
    rows = np.stack([made.real, made.imag], axis=2).reshape(-1, 2, terms)
    return rows, block, grid.lengths_um, 2.0 * math.pi * expansion.offset_and_scale(heightfield)[1]
