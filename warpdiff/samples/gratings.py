"""Synthetic height fields, each exactly one period of a periodic surface.

One-dimensional gratings vary along x and have one row. Depths and heights are peak to valley. Random gratings have the
argument ``seed``.

Examples:
    >>> import warpdiff as wd
    >>> wd.gratings.sinusoidal(period_um=2.0, depth_um=0.1).size_um[1]
    2.0
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield import scale_checks
from warpdiff.heightfield.field import HeightField

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["blazed", "bumps", "disc", "fingers", "lamellar", "sinusoidal"]

# Largest default pitch [µm], about a tenth of the shortest visible wavelength. If it was doubled, aliasing would cause
# errors in directions near the horizon.
_COARSEST_PITCH_UM = 0.04
# Distance from a ridge (row of finger-like bumps) beyond which the ridge does not contribute to the heights, in units
# of the distance between neighbouring ridges. The number was derived from the profile of a ridge, whose height at this
# distance is below 1e-40 of the height of its crest.
_RIDGE_REACH = 4.0


def sinusoidal(period_um: float, depth_um: float, *, samples: int | None = None) -> HeightField:
    """Make a sine grating, h = depth/2 · cos(2πx / period).

    Args:
        period_um: Period along x [µm], more than 0.
        depth_um: Peak-to-valley depth [µm], at least 0; exact for an even number of samples.
        samples: Number of samples per period, at least 2; None, the default, is 64, or more for a pitch of at most
            0.04 µm.

    Returns:
        One period, of shape (1, samples) and equal pitch along x and y.

    Raises:
        ValueError: An argument is out of its range.

    Examples:
        >>> import warpdiff as wd
        >>> wd.gratings.sinusoidal(period_um=2.0, depth_um=0.1)
        HeightField(1 × 64 samples (y × x), pitch 0.03125 × 0.03125 µm, size 0.03125 × 2 µm, height range 0.1 µm)
    """
    period, depth, n = _one_dimensional(period_um, depth_um, samples)
    return HeightField.of_known_scale(0.5 * depth * np.cos(2.0 * np.pi * np.arange(n) / n)[None, :], period / n)


def lamellar(period_um: float, depth_um: float, *, duty: float = 0.5, samples: int | None = None) -> HeightField:
    """Make a rectangular grating: the first round(duty · samples) samples at ``depth_um``, the others at 0.

    Args:
        period_um: Period along x [µm], more than 0.
        depth_um: Peak-to-valley depth [µm], at least 0.
        duty: Fraction of the period with the height ``depth_um``, between 0 and 1, default 0.5.
        samples: Number of samples per period, at least 2; None, the default, is 64, or more for a pitch of at most
            0.04 µm.

    Returns:
        One period, of shape (1, samples) and equal pitch along x and y.

    Raises:
        ValueError: An argument is out of its range, or the duty rounds to no sample or to all of them.

    Examples:
        >>> import warpdiff as wd
        >>> wd.gratings.lamellar(period_um=2.0, depth_um=0.1, duty=0.25, samples=8).heights_um
        array([[0.1, 0.1, 0. , 0. , 0. , 0. , 0. , 0. ]])
    """
    period, depth, n = _one_dimensional(period_um, depth_um, samples)
    duty = validation.number(duty, "duty", above=0.0, most=1.0)
    high = round(duty * n)
    if not 0 < high < n:
        raise ArgumentValueError(
            f"{ref('duty')} must leave at least one of {n} samples high and one low, got {duty:g}; change it, or "
            f"increase {ref('samples')}"
        )
    return HeightField.of_known_scale(np.where(np.arange(n) < high, depth, 0.0)[None, :], period / n)


def blazed(period_um: float, depth_um: float, *, samples: int | None = None) -> HeightField:
    """Make a sawtooth grating that rises with x, h_j = depth · j / samples, and drops at the end of the period.

    Args:
        period_um: Period along x [µm], more than 0.
        depth_um: Peak-to-valley depth of the continuous sawtooth [µm], at least 0. The depth of the samples is smaller
            by the factor 1 − 1/samples.
        samples: Number of samples per period, at least 2; None, the default, is 64, or more for a pitch of at most
            0.04 µm.

    Returns:
        One period, of shape (1, samples) and equal pitch along x and y.

    Raises:
        ValueError: An argument is out of its range.

    Examples:
        >>> import warpdiff as wd
        >>> wd.gratings.blazed(period_um=2.0, depth_um=0.4, samples=4).heights_um
        array([[0. , 0.1, 0.2, 0.3]])
    """
    period, depth, n = _one_dimensional(period_um, depth_um, samples)
    return HeightField.of_known_scale((depth * np.arange(n) / n)[None, :], period / n)


def _one_dimensional(period_um: float, depth_um: float, samples: int | None) -> tuple[float, float, int]:
    """Return the checked period, depth and number of samples of a one-dimensional grating."""
    period = validation.positive(period_um, "period_um")
    depth = validation.number(depth_um, "depth_um", least=0.0)
    if samples is None:
        # The number of samples is made even, so that one sample is exactly at the valley of a sine.
        samples = max(64, 2 * math.ceil(0.5 * period / _COARSEST_PITCH_UM - 1e-9))
    samples = validation.count(samples, "samples", least=2)
    memory.require_samples(1, samples, f"take {{share}} of {ref('period_um')}, or of {ref('samples')}")
    period = validation.number(period, "period_um", least=samples * validation.LEAST)
    scale_checks.warn_of_grating(period, depth_um=depth)
    return period, depth, samples


@dataclass(frozen=True)
class _DiscFormat:
    """Dimensions [µm] of an optical disc format, and lengths of its pits and lands (runs) [channel bits]."""

    track_pitch_um: float
    pit_width_um: float
    pit_depth_um: float
    channel_bit_um: float
    shortest_run: int
    longest_run: int
    growth: float
    """Base λ of the probabilities λ^−n of run lengths n, for a code at its capacity log2 λ."""


DiscKind = Literal["CD", "DVD", "Blu-ray"]
_DISCS = {
    "CD": _DiscFormat(1.6, 0.5, 0.126, 0.278, 3, 11, 1.456),
    "DVD": _DiscFormat(0.74, 0.32, 0.105, 0.1333, 3, 11, 1.456),
    "Blu-ray": _DiscFormat(0.32, 0.13, 0.063, 0.0745, 2, 8, 1.601),
}


def disc(
    kind: DiscKind = "CD", *, tracks: int | None = None, length_um: float = 25.6, pitch_um: float = _COARSEST_PITCH_UM,
    seed: int = 0,
) -> HeightField:  # fmt: skip
    """Make a patch of an optical disc, x radial and y along the tracks, with random data in its pits.

    Pits are stadium-shaped, and their walls are one sample wide. Pits and lands are m channel bits long; 3T in the
    table means m = 3. The number m is random with the probabilities g^−m of a run-length-limited code at its capacity
    log2 g (Immink 2004, *Codes for Mass Data Storage Systems*, ch. 4: 0.5418 bits for 3 to 11, 0.6793 for 2 to 8). The
    depth of pits is λ/(4n), a quarter wavelength in the plastic of index n.

    ======= =========== ========= ========= =========== ======== ==============================================
    kind    track pitch pit width pit depth channel bit runs     source
    ======= =========== ========= ========= =========== ======== ==============================================
    CD      1.6 µm      0.5 µm    126 nm    278 nm      3T–11T   ECMA-130: 1.2 m/s at 4.3218 Mbit/s, 780 nm, n = 1.55
    DVD     0.74 µm     0.32 µm   105 nm    133 nm      3T–11T   ECMA-267: 650 nm, n = 1.55
    Blu-ray 0.32 µm     0.13 µm   63 nm     74.5 nm     2T–8T    Blu-ray Disc Association, white paper 1.C: 25 GB
                                                                 layer, 405 nm, n = 1.6
    ======= =========== ========= ========= =========== ======== ==============================================

    Pit widths are not standardised; the values are typical of pressed discs.

    Args:
        kind: Format of the disc: ``"CD"`` (default), ``"DVD"`` or ``"Blu-ray"``.
        tracks: Number of tracks across the patch, at least 1; None, the default, makes the patch about 25.6 µm wide.
        length_um: Extent along the tracks [µm], default 25.6, at least four times the longest run.
        pitch_um: Largest distance of the samples [µm], default 0.04, at most half of a pit's width. A track has a whole
            number of samples.
        seed: Seed of the random data, at least 0, default 0.

    Returns:
        Heights from −depth (pits) to 0 (land), periodic in both directions.

    Raises:
        ValueError: An argument is out of its range, or the pitch is too coarse for the pits.

    Examples:
        >>> import warpdiff as wd
        >>> wd.gratings.disc("DVD", tracks=4, length_um=8.0)
        HeightField(200 × 76 samples (y × x), pitch 0.04 × 0.03895 µm, size 8 × 2.96 µm, height range 0.105 µm)
    """
    form = _DISCS[validation.choice(kind, "kind", get_args(DiscKind))]
    track_count = round(25.6 / form.track_pitch_um) if tracks is None else validation.count(tracks, "tracks")
    pitch = validation.positive(pitch_um, "pitch_um")
    if pitch > 0.5 * form.pit_width_um:
        raise ArgumentValueError(
            f"{ref('pitch_um')} must be at most half of a pit's width, {0.5 * form.pit_width_um:g} for {kind}, "
            f"got {pitch:g}"
        )
    least = 4.0 * form.longest_run * form.channel_bit_um
    length = validation.number(length_um, "length_um", least=least)
    rng = _generator(seed)
    across = math.ceil(form.track_pitch_um / pitch - 1e-9)
    along = math.ceil(length / pitch - 1e-9)
    bits = round(length / form.channel_bit_um)
    memory.require_samples(
        along,
        track_count * across,
        f"take {{share}} of {ref('tracks')}, of {ref('length_um')}, or a larger {ref('pitch_um')}",
    )
    dx, dy, bit = form.track_pitch_um / across, length / along, length / bits
    x = (np.arange(across) - across // 2) * dx
    y = np.arange(along) * dy
    heights = np.zeros((along, track_count * across))
    radius = 0.5 * form.pit_width_um
    for track in range(track_count):
        runs = _run_lengths(rng, bits, form)
        edges = np.concatenate([[0], np.cumsum(runs)]) * bit + rng.uniform(0.0, length)
        coverage = np.zeros((along, across))
        for start, stop in zip(edges[0:-1:2], edges[1::2], strict=True):
            half, middle = 0.5 * (stop - start), 0.5 * (start + stop)
            # The heights are computed only in the rows of samples near the pit, to save time.
            first, last = math.floor((middle - half) / dy) - 2, math.ceil((middle + half) / dy) + 2
            rows = np.arange(first, last + 1) % along
            offset = (y[rows] - middle + 0.5 * length) % length - 0.5 * length
            near = np.abs(offset) < half + dy
            rows, offset = rows[near], offset[near]
            # A pit is a stadium: the set of points within `radius` of a line segment. The round ends of the pit extend
            # beyond the segment. A pit that is shorter than wide is a circle.
            beyond = np.maximum(np.abs(offset) - max(half - radius, 0.0), 0.0)
            distance = np.hypot(beyond[:, None], x) - min(radius, half)
            coverage[rows] = np.maximum(coverage[rows], np.clip(0.5 - distance / pitch, 0.0, 1.0))
        heights[:, track * across : (track + 1) * across] = -form.pit_depth_um * coverage
    return HeightField.of_known_scale(heights, (dy, dx))


def _run_lengths(rng: np.random.Generator, bits: int, form: _DiscFormat) -> NDArray[np.int64]:
    """Return random lengths (runs) [channel bits] of alternate pits and lands, an even number with the sum ``bits``."""
    lengths = np.arange(form.shortest_run, form.longest_run + 1)
    weights = form.growth ** -lengths.astype(np.float64)
    weights /= weights.sum()
    runs = rng.choice(lengths, size=2 * round(0.5 * bits / float(weights @ lengths)), p=weights)
    # Randomly selected runs (pits or lands) are lengthened or shortened by one bit until the sum of all is ``bits``.
    # The track is then periodic.
    while (missing := bits - int(runs.sum())) != 0:
        step = 1 if missing > 0 else -1
        free = np.nonzero((runs + step >= form.shortest_run) & (runs + step <= form.longest_run))[0]
        runs[rng.choice(free)] += step
    return np.asarray(runs, dtype=np.int64)


def bumps(
    *, height_um: float = 0.15, width_um: float = 0.5, length_um: float = 1.0,
    spacing_um: float | tuple[float, float] = (2.0, 1.0), pitch_um: float = _COARSEST_PITCH_UM,
) -> HeightField:  # fmt: skip
    """Make one cell of a lattice of bumps; by default, those of the disc in Stam (1999, *Diffraction Shaders*).

    A bump is a paraboloid cap, height · (1 − (2x/width)² − (2y/length)²) where this is positive.

    Args:
        height_um: Height of a bump [µm], at least 0, default 0.15.
        width_um: Extent of a bump along x [µm], more than 0, default 0.5.
        length_um: Extent of a bump along y [µm], more than 0, default 1.
        spacing_um: Lattice spacing [µm], one number or a pair (y, x), at least the extent of a bump, default (2, 1).
        pitch_um: Largest distance of the samples [µm], default 0.04. A cell has a whole number of samples, at least
            two.

    Returns:
        One cell with the bump at its middle sample, heights from 0.

    Raises:
        ValueError: An argument is out of its range, or the bump does not fit into the cell.

    Examples:
        >>> import warpdiff as wd
        >>> wd.gratings.bumps(height_um=0.2).shape
        (50, 25)
    """
    height = validation.number(height_um, "height_um", least=0.0)
    extent = validation.positive(length_um, "length_um"), validation.positive(width_um, "width_um")
    spacing = validation.pair(spacing_um, "spacing_um")
    pitch = validation.positive(pitch_um, "pitch_um")
    for axis, name in enumerate(("length_um", "width_um")):
        if spacing[axis] < extent[axis]:
            raise ArgumentValueError(
                f"{ref(f'spacing_um[{axis}]')} must be at least {ref(name)} = {extent[axis]:g}, got {spacing[axis]:g}"
            )
    ny, nx = (max(2, math.ceil(side / pitch - 1e-9)) for side in spacing)
    memory.require_samples(ny, nx, f"take {{side}} of {ref('spacing_um')}, or a larger {ref('pitch_um')}")
    scale_checks.warn_of_grating(min(spacing), height_um=height)
    y = (np.arange(ny) - ny // 2) * (spacing[0] / ny)
    x = (np.arange(nx) - nx // 2) * (spacing[1] / nx)
    cap = 1.0 - (2.0 * y[:, None] / extent[0]) ** 2 - (2.0 * x / extent[1]) ** 2
    return HeightField.of_known_scale(height * np.maximum(cap, 0.0), (spacing[0] / ny, spacing[1] / nx))


@np.errstate(under="ignore")
def fingers(
    *, size_um: float | tuple[float, float] = 25.6, pitch_um: float | tuple[float, float] = 0.05,
    period_um: float = 1.1, length_um: float = 3.0, height_um: float = 0.3, seed: int = 0,
) -> HeightField:  # fmt: skip
    """Make quasi-periodic ridges of elongated bumps (nano-fingers), like those on the shed skin of a snake.

    The surface has parallel ridges along y. A ridge is a chain of fingers, which widen along +y from a narrow tip to
    the tip of the next finger, while the grooves between the ridges become narrower and deeper. The tips of
    neighbouring ridges form wavy rows. Positions, lengths and heights have random variations. The proportions were
    estimated by eye from atomic force microscope scans of *Elaphe guttata*.

    Args:
        size_um: Extent [µm], one number or a pair (y, x), at least one finger, default 25.6.
        pitch_um: Requested distance of the samples [µm], one number or a pair (dy, dx), at most an eighth of a finger,
            default 0.05. The actual pitch divides the size.
        period_um: Mean distance of the ridges along x [µm], default 1.1; the actual distance divides the size.
        length_um: Mean distance of the tips along y [µm], default 3; the actual distance divides the size.
        height_um: Highest minus lowest height [µm], exact, at least 0, default 0.3.
        seed: Seed of the random variations, at least 0, default 0.

    Returns:
        Heights, periodic in both directions. The mean of the highest and the lowest height is 0.

    Raises:
        ValueError: An argument is out of its range, or the patch has less than one finger or 8 samples per finger.

    Examples:
        >>> import warpdiff as wd
        >>> wd.gratings.fingers(size_um=12.8, seed=4)
        HeightField(256 × 256 samples (y × x), pitch 0.05 × 0.05 µm, size 12.8 × 12.8 µm, height range 0.3 µm)
    """
    size = validation.pair(size_um, "size_um")
    pitch = validation.pair(pitch_um, "pitch_um")
    period = validation.positive(period_um, "period_um")
    length = validation.positive(length_um, "length_um")
    height = validation.number(height_um, "height_um", least=0.0)
    if size[0] < length or size[1] < period:
        raise ArgumentValueError(
            f"{ref('size_um')} must be at least one finger, (y, x) = ({length:g}, {period:g}), got {size}"
        )
    if pitch[0] > length / 8.0 or pitch[1] > period / 8.0:
        raise ArgumentValueError(
            f"{ref('pitch_um')} must be at most an eighth of a finger, (y, x) = ({length / 8.0:g}, {period / 8.0:g}), "
            f"got {pitch}"
        )
    rng = _generator(seed)
    ny, nx = (round(side / step) for side, step in zip(size, pitch, strict=True))
    memory.require_samples(ny, nx, f"take {{side}} of {ref('size_um')}, or a larger {ref('pitch_um')}")
    scale_checks.warn_of_grating(period, height_um=height)
    dy, dx = size[0] / ny, size[1] / nx
    ridges, rows = round(size[1] / period), round(size[0] / length)
    # In the following code, x is in units of the distance between ridges of fingers, and y in units of the length of a
    # finger.
    x, y = np.arange(nx) * (ridges / nx), np.arange(ny) * (rows / ny)
    waves = np.arange(1, 4)
    angles = 2.0 * np.pi * (np.outer(np.arange(ridges) / ridges, waves) + rng.uniform(size=3))
    row_phase = (np.sin(angles) * rng.uniform(0.1, 0.3, size=3)).sum(axis=1)
    top = np.zeros((ny, nx))
    ground = np.zeros((ny, nx))
    weights = np.zeros((ny, nx))
    for ridge in range(ridges):
        tips = np.arange(rows) + row_phase[ridge] + rng.normal(0.0, 0.07, size=rows) + rng.normal(0.0, 0.12)
        position = rng.normal(0.0, 0.05) + rng.normal(0.0, 0.025, size=rows)
        rise = rng.normal(1.0, 0.05, size=rows)
        breadth = rng.normal(1.0, 0.07, size=rows)
        # For every y: the index of the finger at this y, and the position on the finger, from 0 at its tip to 1 at the
        # next tip.
        past = (y[:, None] - tips) % rows
        finger = np.argmin(past, axis=1)
        behind = past[np.arange(ny), finger]
        behind = behind / np.maximum(behind + np.min((tips - y[:, None]) % rows, axis=1), 1e-9)
        # A ridge of fingers is added only to the columns of samples near it. In other columns the height of the ridge
        # is smaller than rounding errors.
        near_columns = np.flatnonzero(np.abs((x - ridge + 0.5 * ridges) % ridges - 0.5 * ridges) < _RIDGE_REACH)
        aside = (x[near_columns] - ridge - position[finger][:, None] + 0.5 * ridges) % ridges - 0.5 * ridges
        half_width = (breadth[finger] * (0.12 + 0.34 * behind))[:, None]
        crest = (rise[finger] * (0.88 + 0.12 * np.sin(np.pi * behind)))[:, None]
        top[:, near_columns] = np.maximum(top[:, near_columns], crest * np.exp(-((np.abs(aside) / half_width) ** 2.3)))
        near = np.exp(-8.0 * aside**2)
        ground[:, near_columns] += near * (0.5 - 0.45 * behind**1.3)[:, None]
        weights[:, near_columns] += near
    ground /= weights
    heights = ground + (1.0 - ground) * top
    # The heights are blurred by a Gaussian, because a microscope tip of finite size and real fingers have round edges.
    spread = 0.06 * period
    factor_y = np.exp(-2.0 * (np.pi * spread * np.fft.fftfreq(ny, dy)) ** 2)
    factor_x = np.exp(-2.0 * (np.pi * spread * np.fft.rfftfreq(nx, dx)) ** 2)
    heights = np.fft.irfft2(np.fft.rfft2(heights) * factor_y[:, None] * factor_x, (ny, nx))
    heights -= 0.5 * (heights.max() + heights.min())
    return HeightField.of_known_scale(heights * (height / np.ptp(heights)), (dy, dx))


def _generator(seed: int) -> np.random.Generator:
    """Return NumPy's random generator for a checked ``seed``."""
    return np.random.default_rng(validation.count(seed, "seed", least=0))
