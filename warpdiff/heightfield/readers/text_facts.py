"""Facts in the header of a text file of heights, and the pitch, missing samples and unit that follow from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield.readers.reader_registry import refusal

if TYPE_CHECKING:
    from pathlib import Path

# A header may state a length twice. Both statements count as equal up to this relative difference. If doubled, more
# contradictions are accepted.
MOST_DIFFERENCE = 1e-3
# Largest ratio of the pitches along x and y that is accepted from a header. A larger ratio suggests that a "height" in
# the header is the range of the heights and not a size. If doubled, more ranges of heights are mistaken for sizes.
_MOST_ASPECT = 50.0
# Largest relative difference between the size that a header states and the product of the stated number of samples and
# pitch. If doubled, more contradictions are accepted.
_MOST_RATIO = 0.01
# Codes of missing samples may be limits of number types, such as the largest float32, which programs round. A sample
# equals a code above `_LEAST_ROUNDED_CODE` in magnitude if they differ by at most `_MOST_CODE_DIFFERENCE`, relative to
# the code. Smaller codes must be equal exactly. Real heights are far below `_LEAST_ROUNDED_CODE` in any unit.
_LEAST_ROUNDED_CODE, _MOST_CODE_DIFFERENCE = 1e30, 1e-5


@dataclass
class Facts:
    """Facts that the header of a text states. Lengths are in µm. None means that the header does not state a fact.

    Attributes:
        size_x: Width of the field.
        size_y: Height of the field.
        size_of_both: Size of the field, if the header states one size for both axes.
        pitch_x: Distance of samples along x.
        pitch_y: Distance of samples along y.
        counts: Number of columns ("x") and rows ("y"), each with its header line.
        units: Sizes of all units that the header states for the heights, with their header lines. Several units
            contradict each other.
        factor_line: Header line with a factor of the heights that is not applied, so that the file is refused; an empty
            string if there is no such line.
        not_length: Unit of the values if the unit is not a length, such as V; otherwise an empty string.
        lateral: Size of the unit of the positions along x and y.
        global_unit: Size of the unit of all numbers of the file, heights and positions, if the header states such a
            unit.
        channel: Name of the channel; an empty string if it is not stated.
        no_data: Numbers that the header states as codes of missing samples, with their header lines. A flag states
            whether the number is certainly a code and not a number of samples.
        metadata: Values of header lines "key: value", as text by key.
        signs: Decimal signs of the header's numbers that are certainly no thousands signs.
        unclear_size: Reason why a line about the size or the pitch was not read, for an error message.
        without_unit: Reason why a line about the size or the pitch without a unit was not read.
        unclear_unit: Reason why a line about the unit of the heights was not read, for an error message.
    """

    size_x: float | None = None
    size_y: float | None = None
    size_of_both: float | None = None
    pitch_x: float | None = None
    pitch_y: float | None = None
    counts: list[tuple[str, int, str]] = field(default_factory=list)
    units: dict[float, str] = field(default_factory=dict)
    factor_line: str = ""
    not_length: str = ""
    lateral: float | None = None
    global_unit: float | None = None
    channel: str = ""
    no_data: list[tuple[float, bool, str]] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    signs: dict[str, str] = field(default_factory=dict)
    unclear_size: str = ""
    without_unit: str = ""
    unclear_unit: str = ""
    _stated: dict[str, list[tuple[bool, float, str]]] = field(default_factory=dict)

    def add(self, name: str, length: float, line: str, *, names_axis: bool) -> None:
        """Add the length that a header line states for ``name``, the size or the pitch along an axis.

        ``names_axis`` is whether the key of the line names x or y. Keys such as "Height" or "Spacing" name no axis.
        Lines with such keys are ignored if another line states the same size or pitch with a key that names an axis.
        """
        self._stated.setdefault(name, []).append((names_axis, length, line))

    def decide(self) -> None:
        """Set each size and pitch for which the header lines state equal lengths; note the lines that contradict."""
        for name, statements in self._stated.items():
            strongest = max(names_axis for names_axis, *_ in statements)
            strong = sorted((length, line) for names_axis, length, line in statements if names_axis == strongest)
            if strong[-1][0] <= (1.0 + MOST_DIFFERENCE) * strong[0][0]:
                setattr(self, name, strong[0][0])
            else:
                self.unclear_size = self.unclear_size or f"{strong[0][1]} contradicts {strong[-1][1]}"
        if self.size_of_both is not None and "aspect" in self._stated:
            self.unclear_size = f"{self._stated['aspect'][0][2]} states an aspect ratio"

    def line_of(self, name: str) -> str:
        """Return the header line that states a size or a pitch, in quotes."""
        return next(line for _, length, line in self._stated[name] if length == getattr(self, name))

    def merge(self, first: Facts) -> None:
        """Copy each fact that this header does not state from ``first``, the facts of the first header of the file."""
        if not self.has_scale and not self.unclear_size:
            for name in (
                "size_x",
                "size_y",
                "size_of_both",
                "pitch_x",
                "pitch_y",
                "unclear_size",
                "without_unit",
                "_stated",
            ):
                setattr(self, name, getattr(first, name))
        if not self.units and not self.not_length and not self.unclear_unit:
            self.units, self.unclear_unit = first.units, first.unclear_unit
        self.factor_line = self.factor_line or first.factor_line
        self.no_data = self.no_data or first.no_data
        self.signs = {**first.signs, **self.signs}

    @property
    def has_scale(self) -> bool:
        """Whether the header states the size, or the pitch, along both axes."""
        return None not in (self.size_x, self.size_y) or None not in (self.pitch_x, self.pitch_y)

    @property
    def unit(self) -> float | None:
        """Size of the unit of heights [µm]; None if the header does not state a unit, or states two different units."""
        return next(iter(self.units)) if len(self.units) == 1 and not self.unclear_unit else None

    @property
    def why_no_unit(self) -> str:
        """Reason why the unit of the heights is not known, for an error message; an empty string if it is known."""
        if len(self.units) > 1:
            lines = list(self.units.values())
            return f"{lines[0]} contradicts {lines[1]}" if lines[0] != lines[1] else f"{lines[0]} states two units"
        return self.unclear_unit


def require_length(file: Path, facts: Facts) -> None:
    """Raise an error if the header states a unit of the values that is not a length."""
    if facts.not_length and facts.unit is None:
        raise refusal(file, f"has values in {facts.not_length[:20]!r}, which is no unit of length; export the heights")


def without_codes(file: Path, heights: np.ndarray, facts: Facts) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return heights with NaN instead of the codes of missing samples, and sentences for the history of the field."""
    notes = []
    for code, is_certain, line in facts.no_data:
        difference = _MOST_CODE_DIFFERENCE if abs(code) > _LEAST_ROUNDED_CODE else 0.0
        is_code = np.isclose(heights, code, rtol=difference, atol=0.0)
        count = int(np.count_nonzero(is_code))
        if count and not is_certain:
            raise refusal(
                file, f"has {count} sample(s) equal to the number in the line {line}, which may be a code of missing "
                "samples; write NaN for them, or delete the line"
            )  # fmt: skip
        if count:
            heights = np.where(is_code, np.nan, heights)
            notes.append(f"Loaded: read {count} sample(s) as missing, as the header states in the line {line}.")
    return heights, tuple(notes)


def pitch_of(facts: Facts, nx: int, ny: int) -> tuple[tuple[float, float] | None, str]:
    """Return the pitch (dy, dx) [µm] that a header states, or None and the reason, for an error message."""
    if facts.unclear_size:
        return None, facts.unclear_size
    for axis, count in (("x", nx), ("y", ny)):
        if contradict(getattr(facts, f"size_{axis}"), getattr(facts, f"pitch_{axis}"), count):
            return None, (
                f"{facts.line_of(f'size_{axis}')} contradicts {facts.line_of(f'pitch_{axis}')} for {count} samples"
            )
    dx = facts.pitch_x or (facts.size_x / nx if facts.size_x else None)
    dy = facts.pitch_y or (facts.size_y / ny if facts.size_y else None)
    # A header may state one size without an axis. This size is used only if both axes have equally many samples,
    # because its axis is ambiguous otherwise.
    reason = facts.without_unit
    if facts.size_of_both is not None and nx == ny:
        dx, dy = dx or facts.size_of_both / nx, dy or facts.size_of_both / ny
    elif facts.size_of_both is not None:
        reason = f"{facts.line_of('size_of_both')} states one size for {nx} × {ny} samples (x × y)"
    # The "height" in a header may be the range of the heights and not the size along y. This is probable if the pitch
    # along y is more than 50 times the pitch along x, or less than 1/50 of it.
    is_likely = dx is not None and dy is not None and dx / _MOST_ASPECT <= dy <= dx * _MOST_ASPECT
    return ((dy, dx), "") if is_likely else (None, reason)  # type: ignore[return-value]


def contradict(size: float | None, pitch: float | None, count: int) -> bool:
    """Whether a size contradicts a pitch: neither ``count`` nor ``count`` − 1 times the pitch is the size."""
    if size is None or pitch is None:
        return False
    return not (1.0 - _MOST_RATIO) * (count - 1) <= size / pitch <= (1.0 + _MOST_RATIO) * count
