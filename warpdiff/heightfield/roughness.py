"""Areal surface texture parameters of ISO 25178-2 with standard errors: Sa, Sq, Sdq, Sdr, Sal and Str."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.table import Table, save_table
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, did_you_mean, ref
from warpdiff.heightfield import autocorrelation
from warpdiff.heightfield.blocks import blocks_of, standard_error

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from warpdiff.heightfield.autocorrelation import Decay
    from warpdiff.heightfield.blocks import Block
    from warpdiff.heightfield.field import HeightField

# A levelled field counts as flat up to this root mean square height, relative to the largest height before levelling.
# The value is limited by rounding errors of the subtracted polynomial. If doubled, no measured field changes, because
# its noise is far larger.
_ROUNDING = 1e-10
# Standard errors come from a jackknife over rectangular blocks of the field. The number is the least length of a block
# along an axis, in decay lengths of the autocorrelation. It was fitted by bench/reproduce/iso_25178.py, so that two
# standard errors contain the value of the surface in 95 % of fields. If halved, blocks depend on each other and
# standard errors are too small.
_DECAYS_PER_BLOCK = 5.0
# Largest number of blocks into which a field is divided to estimate standard errors: along each axis of a field, and
# along a profile (single row or column of samples). More blocks would gain little: a standard error from 8 × 8 blocks
# has itself an error of only 9 %.
_MOST_BLOCKS, _MOST_BLOCKS_OF_PROFILE = 8, 32
# Least number of blocks of the field from which a standard error is estimated: with 2 × 2 blocks, these are the
# quarters of the field. If halved, the standard error is known only to a factor of 4.
_LEAST_BLOCKS = 4
# The autocorrelation is first estimated from at most this number of samples along an axis. In larger fields, groups of
# neighbouring samples are averaged for this estimate. The value is limited by time: the Fourier transform of twice as
# many samples along both axes takes 0.2 s.
_COARSE = 1024
# The region of lags in which the autocorrelation exceeds `autocorrelation.THRESHOLD` is estimated first. The
# autocorrelation is then computed at lags up to this factor times the extent of the region. A factor above 1 is
# necessary because the extent is an estimate. If doubled, the Fourier transforms of the autocorrelation take longer.
_MARGIN = 1.3
# A field with grooves is divided into blocks for the standard errors. The number is the largest angle between the
# grooves and an axis [degrees] at which the blocks are stripes along this axis. Stripes are necessary because parts of
# a field along the same groove resemble each other. The value is half of the angle between an axis and the diagonal.
_ALONG_AXIS_DEG = 22.5
# If the standard error of a roughness parameter, relative to the parameter, exceeds this value, the result states a
# reason for the large error. The value was chosen because two such standard errors are as large as the parameter.
_LARGE_ERROR = 0.5
# Least standard error that is printed as a number, relative to the parameter; a smaller error is printed as an upper
# bound. The value was chosen so that printed values have at most seven digits.
_LEAST_SHOWN = 1e-6

_MEANINGS = {
    "Sa": "arithmetical mean height",
    "Sq": "root mean square height",
    "Sdq": "root mean square gradient",
    "Sdr": "developed interfacial area ratio",
    "Sal": "autocorrelation length",
    "Str": "texture aspect ratio",
}
# Reasons for a standard error above `_LARGE_ERROR`, by the name of the roughness parameter. Near its minimum, the
# autocorrelation changes slowly with distance, so that the distance at which it falls to the threshold has a large
# error.
_REASONS_OF_LARGE_ERRORS = {
    "Sal": f"the autocorrelation falls only just below {autocorrelation.THRESHOLD} there, or not at all in some parts",
    "Str": f"the autocorrelation falls only just below {autocorrelation.THRESHOLD}, or not at all in some parts",
}
# Roughness parameters that follow from sums over the samples of a field, without the autocorrelation of the heights.
_FROM_SUMS = ("Sa", "Sq", "Sdq", "Sdr")
_UNITS = {"Sa": "µm", "Sq": "µm", "Sdq": "", "Sdr": "%", "Sal": "µm", "Str": ""}


@dataclass(frozen=True)
class RoughnessParameter:
    """One roughness parameter of ISO 25178-2; ``print`` shows its value with the standard error.

    Attributes:
        name: Name in ISO 25178-2, such as ``"Sa"``.
        meaning: Name in words.
        unit: Unit of the value and of the standard error; an empty string for a ratio.
        value: Value of the parameter; None if the field does not determine it.
        standard_error: Standard error of the value, as an estimate for the whole surface from which the field is cut;
            None if it cannot be estimated.
        reason: Reason why the value or the standard error is None, or why the error is more than half of the value;
            otherwise an empty string.
    """

    name: str
    meaning: str
    unit: str
    value: float | None
    standard_error: float | None
    reason: str = ""

    def __str__(self) -> str:
        if self.value is None:
            return f"not determined: {self.reason}"
        unit = f" {self.unit}" if self.unit else ""
        if self.standard_error is None:
            return f"{self.value:.4g}{unit}, no standard error: {self.reason}"
        return f"{with_error(self.value, self.standard_error)}{unit}"

    def __repr__(self) -> str:
        return f"RoughnessParameter({self.name} {self})"


@dataclass(frozen=True)
class Roughness:
    """Areal surface texture parameters of ISO 25178-2; ``print`` shows all, indexing by name returns one.

    Attributes:
        parameters: Sa, Sq, Sdq, Sdr, Sal and Str.
        order: Degree of the polynomial that was subtracted from the heights first.
        blocks: Numbers of blocks along (y, x) into which the field was divided to estimate the standard errors.
        lay_deg: Azimuth of the lay, the direction of grooves or scratches [degrees], from x towards y, 0 to 180. It is
            the azimuth at which the autocorrelation decays most slowly. None for a profile or a flat field.

    Examples:
        >>> import warpdiff as wd
        >>> roughness = wd.gratings.fingers(size_um=25.6).roughness()
        >>> roughness["Sq"]
        RoughnessParameter(Sq 0.0... ± 0.0... µm)
        >>> roughness["Sq"].unit
        'µm'
    """

    parameters: tuple[RoughnessParameter, ...]
    order: int
    blocks: tuple[int, int]
    lay_deg: float | None

    def __getitem__(self, name: str) -> RoughnessParameter:
        """Return the parameter with a name of ISO 25178-2, such as ``"Sa"``."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise ArgumentValueError(
            f"{ref('name')} must be one of {', '.join(_MEANINGS)}, got {name!r}{did_you_mean(name, _MEANINGS)}"
        )

    def __iter__(self) -> Iterator[RoughnessParameter]:
        return iter(self.parameters)

    def __str__(self) -> str:
        return "\n".join(f"{parameter.name:<4} {parameter}" for parameter in self.parameters)

    def table(self) -> Table:
        """Return a table with a row per roughness parameter; NaN if a parameter has no value or no standard error.

        Examples:
            >>> import warpdiff as wd
            >>> wd.gratings.sinusoidal(2.0, 0.1).roughness().table()["parameter"].tolist()
            ['Sa', 'Sq', 'Sdq', 'Sdr', 'Sal', 'Str']
        """
        numbers = {
            name: [math.nan if value is None else value for value in values]
            for name, values in (
                ("value", [parameter.value for parameter in self]),
                ("standard_error", [parameter.standard_error for parameter in self]),
            )
        }
        texts = {name: [getattr(parameter, name) for parameter in self] for name in ("unit", "meaning", "reason")}
        return Table({"parameter": [parameter.name for parameter in self], **numbers, **texts})

    save = save_table


def with_error(value: float, standard_error: float) -> str:
    """Return a value and its standard error as text; the standard error has two significant digits.

    An error below a millionth of the value is printed as an upper bound, such as ``<0.001``.
    """
    if value == standard_error == 0.0:
        return "0 ± 0"
    least = max(_LEAST_SHOWN * abs(value), _LEAST_SHOWN**2)
    # If the error is printed as an upper bound, this bound is a power of ten.
    bound = 10.0 ** math.ceil(math.log10(least))
    is_bound = standard_error < bound
    digits = min(max(-math.floor(math.log10(bound)) if is_bound else 1 - math.floor(math.log10(standard_error)), 0), 12)
    return f"{value:.{digits}f} ± {f'<{bound:.{digits}f}' if is_bound else f'{standard_error:.{digits}f}'}"


@single_threaded_blas()
def measure(heightfield: HeightField, order: int) -> Roughness:
    """Return the roughness parameters of a field; `HeightField.roughness` describes them."""
    levelled = heightfield.levelled(order)
    known = ~levelled.missing
    heights = np.where(known, levelled.heights_um, 0.0)
    largest = float(np.max(np.abs(heightfield.heights_um[known])))
    if levelled.rms_um <= _ROUNDING * largest or levelled.rms_um == 0.0:
        return _flat(order)
    pitch = heightfield.pitch_um
    decay = _coarse_decay(heights, known, pitch)
    counts = _block_counts(heights.shape, pitch, decay)
    blocks = blocks_of(levelled.shape, counts)
    sums = np.stack([_sums(heights, known, block, pitch) for block in blocks])
    with np.errstate(divide="ignore", invalid="ignore"):
        values = {name: float(v) for name, v in zip(_FROM_SUMS, _from_sums(sums.sum(axis=0)), strict=True)}
        without = dict(
            zip(_FROM_SUMS, _from_sums((sums.sum(axis=0) - sums).T if len(sums) > 1 else sums.T), strict=True)
        )
    decay, decays = _decays(heights, known, blocks, pitch, decay)
    values |= {"Sal": decay.fastest_um, "Str": decay.fastest_um / decay.slowest_um}
    without["Sal"] = np.array([part.fastest_um for part in decays])
    without["Str"] = np.array([part.fastest_um / part.slowest_um if part.is_closed else math.nan for part in decays])
    is_profile = min(levelled.shape) == 1
    missing_values = _missing_values(values, decay, is_profile=is_profile)
    parameters = []
    for name, value in values.items():
        if name in missing_values:
            parameters.append(_parameter(name, None, None, missing_values[name]))
        elif len(blocks) < _LEAST_BLOCKS or not np.isfinite(without[name]).all():
            parameters.append(_parameter(name, value, None, _no_error(len(blocks))))
        else:
            error = standard_error(without[name])
            reason = _REASONS_OF_LARGE_ERRORS.get(name, "") if has_large_error(value, error) else ""
            parameters.append(_parameter(name, value, error, reason))
    return Roughness(tuple(parameters), order, counts, None if is_profile else decay.slowest_deg)


def has_large_error(value: float, error: float | None) -> bool:
    """Whether the standard error of a roughness parameter is more than half as large as the parameter."""
    return error is not None and error > _LARGE_ERROR * abs(value)


def _parameter(name: str, value: float | None, error: float | None, reason: str = "") -> RoughnessParameter:
    return RoughnessParameter(name, _MEANINGS[name], _UNITS[name], value, error, reason)


def _flat(order: int) -> Roughness:
    """Return the roughness parameters of a flat field."""
    flat = "the levelled field is flat"
    heights = [_parameter(name, 0.0, None, flat) for name in _FROM_SUMS]
    return Roughness((*heights, *(_parameter(name, None, None, flat) for name in ("Sal", "Str"))), order, (1, 1), None)


def _no_error(blocks: int) -> str:
    """Return the reason why a parameter has no standard error, if the field is divided into this number of blocks."""
    if blocks < _LEAST_BLOCKS:
        return "the field is too small to be split into four independent parts"
    return "the autocorrelation of a part of the field does not decay"


def _missing_values(values: dict[str, float], decay: Decay, *, is_profile: bool) -> dict[str, str]:
    """Return the reasons why some roughness parameters have no value, by the name of the parameter."""
    reasons = {
        name: "no two measured samples are neighbours" for name in ("Sdq", "Sdr") if not math.isfinite(values[name])
    }
    if math.isnan(decay.fastest_um):
        reasons["Sal"] = reasons["Str"] = (
            f"the autocorrelation does not fall to {autocorrelation.THRESHOLD} within half of the field; scan a larger "
            "field"
        )
    elif is_profile:
        reasons["Str"] = "the field is a profile, which has one direction"
    elif not decay.is_closed:
        reasons["Str"] = (
            f"the autocorrelation does not fall to {autocorrelation.THRESHOLD} along {decay.slowest_deg:.0f}° within "
            f"half of the field, as along the grooves of a grating; Str is at most {values['Str']:.2g}"
        )
    return reasons


def _sums(
    heights: NDArray[np.float64], known: NDArray[np.bool_], block: Block, pitch_um: tuple[float, float]
) -> NDArray[np.float64]:
    """Return the nine sums over a block of the field from which `_from_sums` computes the parameters.

    The first three sums are over the samples of the block. The other sums are over pairs of neighbouring samples, and
    over quadruples of 2 × 2 samples. A pair or quadruple belongs to the block that contains its first sample.
    """
    rows, columns = (slice(part.start, part.stop + 1) for part in block)
    own = heights[block]
    part, measured = heights[rows, columns], known[rows, columns]
    dy, dx = pitch_um
    ny, nx = own.shape
    along_x = np.diff(part, axis=1) / dx
    along_y = np.diff(part, axis=0) / dy
    pairs_x, pairs_y = measured[:, 1:] & measured[:, :-1], measured[1:] & measured[:-1]
    squares_x, squares_y = along_x**2, along_y**2
    if min(heights.shape) == 1:
        # A profile (single row or column of samples) is a surface that is constant across it. The ratio of the areas of
        # surface and projection is therefore the ratio of their lengths along the profile.
        squares, pairs = (squares_x, pairs_x) if heights.shape[0] == 1 else (squares_y, pairs_y)
        excess, cells = float(np.sum(_excess(squares[pairs]))), int(np.count_nonzero(pairs))
    else:
        whole = pairs_x[1:] & pairs_x[:-1]
        # Each diagonal splits a square of four neighbouring samples into two triangles. The surface area over the
        # square is the mean over both diagonals, which is half of the sum of all four triangles.
        excess = 0.25 * sum(
            float(np.sum(_excess((x + y)[whole])))
            for x in (squares_x[:-1], squares_x[1:])
            for y in (squares_y[:, :-1], squares_y[:, 1:])
        )
        cells = int(np.count_nonzero(whole))
    return np.array([
        np.count_nonzero(known[block]), np.sum(np.abs(own)), np.sum(own**2),
        np.count_nonzero(pairs_x[:ny]), np.sum(squares_x[:ny][pairs_x[:ny]]),
        np.count_nonzero(pairs_y[:, :nx]), np.sum(squares_y[:, :nx][pairs_y[:, :nx]]), cells, excess,
    ])  # fmt: skip


def _excess(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return √(1 + s²) − 1 for squared slopes s², in a form without loss of digits at small slopes."""
    return np.asarray(squares / (1.0 + np.sqrt(1.0 + squares)))


def _from_sums(sums: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return Sa, Sq, Sdq and Sdr from the nine sums that `_sums` returns, shape (9,) or (9, n)."""
    samples, magnitudes, squares, pairs_x, squares_x, pairs_y, squares_y, cells, excess = sums
    gradient = np.where(pairs_x > 0.0, squares_x / pairs_x, 0.0) + np.where(pairs_y > 0.0, squares_y / pairs_y, 0.0)
    gradient = np.where(pairs_x + pairs_y > 0.0, gradient, np.nan)
    return [magnitudes / samples, np.sqrt(squares / samples), np.sqrt(gradient), 100.0 * excess / cells]


def _coarse_decay(heights: NDArray[np.float64], known: NDArray[np.bool_], pitch_um: tuple[float, float]) -> Decay:
    """Return the decay of the autocorrelation of a field; a large field is averaged over groups of samples first.

    The extents of the decay, the largest lags along y and x above the threshold, are in samples before averaging.
    """
    factors = tuple(-(-n // _COARSE) for n in heights.shape)
    if max(factors) > 1:
        rows, columns = (n // factor for n, factor in zip(heights.shape, factors, strict=True))
        shape = (rows, factors[0], columns, factors[1])
        part = np.s_[: rows * factors[0], : columns * factors[1]]
        counts = known[part].reshape(shape).sum(axis=(1, 3))
        heights = heights[part].reshape(shape).sum(axis=(1, 3)) / np.maximum(counts, 1)
        known = counts > 0
    coarse_pitch = pitch_um[0] * factors[0], pitch_um[1] * factors[1]
    whole = blocks_of((heights.shape[0], heights.shape[1]), (1, 1))[0]
    products, pairs = autocorrelation.lag_sums(heights, known, whole, _most_lags(heights.shape))
    decay = autocorrelation.decay_of(products, pairs, coarse_pitch, float(np.count_nonzero(known)))
    extents = decay.extents[0] * factors[0], decay.extents[1] * factors[1]
    return autocorrelation.Decay(decay.fastest_um, decay.slowest_um, decay.slowest_deg, decay.is_closed, extents)


def _most_lags(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return the largest lags (y, x) at which the autocorrelation is computed [samples]."""
    rows, columns = (0 if n == 1 else max(int(autocorrelation.MOST_LAG * n), 1) for n in shape)
    return rows, columns


def _block_counts(shape: tuple[int, ...], pitch_um: tuple[float, float], decay: Decay) -> tuple[int, int]:
    """Return the numbers of blocks along y and x, so that each block of the field is several decay lengths long."""
    if math.isnan(decay.fastest_um):
        return 1, 1
    most = _MOST_BLOCKS_OF_PROFILE if min(shape) == 1 else _MOST_BLOCKS
    counts = []
    for n, pitch, extent in zip(shape, pitch_um, decay.extents, strict=True):
        length = max(extent, decay.fastest_um / pitch) * _DECAYS_PER_BLOCK
        counts.append(1 if n == 1 else max(min(int(n / length), most), 1))
    if not decay.is_closed and min(shape) > 1:
        # The autocorrelation does not decay along grooves: two parts of a field that contain the same groove resemble
        # each other. The field is therefore divided only parallel to the grooves, so that each block contains whole
        # grooves. If the grooves are oblique, the field is divided into at most two blocks along each axis.
        across = [
            max(min(int(n * pitch / (decay.fastest_um * _DECAYS_PER_BLOCK)), most), 1)
            for n, pitch in zip(shape, pitch_um, strict=True)
        ]
        angle = min(decay.slowest_deg, 180.0 - decay.slowest_deg)
        if angle <= _ALONG_AXIS_DEG:
            counts = [across[0], 1]
        elif angle >= 90.0 - _ALONG_AXIS_DEG:
            counts = [1, across[1]]
        else:
            counts = [min(count, 2) for count in across]
    return counts[0], counts[1]


def _decays(
    heights: NDArray[np.float64], known: NDArray[np.bool_], blocks: list[Block], pitch_um: tuple[float, float],
    coarse: Decay,
) -> tuple[Decay, list[Decay]]:  # fmt: skip
    """Return the decay of the autocorrelation of a field, and, for each of its blocks, the decay without this block.

    ``coarse`` is the decay of the whole field, computed from averages over groups of samples. To save time, only lags
    near the region where the autocorrelation exceeds `autocorrelation.THRESHOLD` are computed. Along grooves, this
    region extends to the largest lags. For a field with grooves, only the fastest decay, across the grooves, is
    therefore computed, and the slowest decay is taken from ``coarse``.
    """
    if math.isnan(coarse.fastest_um):
        return coarse, []
    most = _most_lags(heights.shape)
    factors = tuple(-(-n // _COARSE) for n in heights.shape)
    extents = coarse.extents
    if not coarse.is_closed:
        extents = 2.0 * coarse.fastest_um / pitch_um[0], 2.0 * coarse.fastest_um / pitch_um[1]
    reach = _reach(extents, factors, most)
    samples = np.array([float(np.count_nonzero(known[block])) for block in blocks])
    while True:
        parts = [autocorrelation.lag_sums(heights, known, block, reach) for block in blocks]
        products, pairs = (np.stack([part[k] for part in parts]) for k in (0, 1))
        total = autocorrelation.decay_of(products.sum(axis=0), pairs.sum(axis=0), pitch_um, float(samples.sum()))
        if total.is_closed or not coarse.is_closed or reach == most:
            break
        reach = _reach((2.0 * reach[0], 2.0 * reach[1]), factors, most)
    without = [
        autocorrelation.decay_of(
            products.sum(axis=0) - products[k], pairs.sum(axis=0) - pairs[k], pitch_um,
            float(samples.sum() - samples[k]), autocorrelation.AZIMUTHS_OF_PART,
        )
        for k in range(len(blocks) if len(blocks) >= _LEAST_BLOCKS else 0)
    ]  # fmt: skip
    if not coarse.is_closed:
        total = autocorrelation.Decay(
            total.fastest_um, coarse.slowest_um, coarse.slowest_deg, is_closed=False, extents=coarse.extents
        )
    return total, without


def _reach(extents: tuple[float, float], factors: tuple[int, ...], most: tuple[int, int]) -> tuple[int, int]:
    """Return the largest lags (y, x) at which the autocorrelation is computed [samples].

    ``extents`` (y, x) are the extents of the region of lags in which the autocorrelation exceeds
    `autocorrelation.THRESHOLD`. The result is larger than this region by a margin, but at most ``most``.
    """
    rows, columns = (
        min(math.ceil(_MARGIN * extent) + 2 * factor, limit)
        for extent, factor, limit in zip(extents, factors, most, strict=True)
    )
    return rows, columns
