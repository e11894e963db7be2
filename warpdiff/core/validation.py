"""Validation of arguments before any kernel runs; an error names the argument, the value, the rule and the remedy."""

from __future__ import annotations

import errno
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard, TypeVar, cast

import numpy as np

from warpdiff.core import memory
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, did_you_mean, ref

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import ArrayLike, NDArray

_Choice = TypeVar("_Choice", bound=str | int)
# Largest and smallest accepted magnitude of a number, in any unit. Powers of numbers beyond these limits overflow or
# underflow.
MOST, LEAST = 1e15, 1e-15
# Largest accepted integer, which is the largest number of the type int64; larger integers would overflow.
MOST_COUNT = 2**63 - 1
# Memory that the checks of an array require [bytes per number]: the copy, and masks. If doubled, arrays are refused
# that would fit into memory.
_BYTES_PER_NUMBER = 12.0
# Largest size of an array (number of elements) that is accepted without comparing its memory with the free memory. The
# comparison takes 0.1 ms, which is too long for small arrays.
_MOST_UNCHECKED = 1_000_000
# Largest magnitude of the number of a diffraction order. No period of a grating has so many orders.
_MOST_ORDER = 2**31
# Vectors that look like angles in degrees cause a warning. They look so if three conditions are met. Each component of
# all vectors is ±1 or a multiple of `_ROUND_DEGREES`. The largest magnitude of all components is from `_LEAST_DEGREES`
# to `_MOST_DEGREES`. At least one vector has two components that are not 0. The numbers were chosen because vectors of
# other lengths that are meant as directions rarely meet these conditions.
_ROUND_DEGREES, _LEAST_DEGREES, _MOST_DEGREES = 5.0, 10.0, 360.0


def finite_array(
    value: object, name: str, *, ndim: int | None = None, gaps: bool = False, most: float = math.inf,
    flags: bool = False, bytes_per_number: float = _BYTES_PER_NUMBER,
) -> NDArray[np.float64]:  # fmt: skip
    """Return a value as a new float64 array after checks. Masked elements become NaN.

    Args:
        value: Array of real numbers.
        name: Name of the argument for error messages.
        ndim: Required number of dimensions; None accepts any.
        gaps: Whether NaN is accepted.
        most: Largest accepted magnitude.
        flags: Whether True and False are accepted, as 1 and 0.
        bytes_per_number: Memory that the caller requires [bytes per number], which must be free.
    """
    try:
        numbers = np.asarray(value)
    except (TypeError, ValueError):
        numbers = None  # NumPy raises an error for rows of different lengths
    if numbers is not None and numbers.dtype.kind == "b" and not flags:
        raise ArgumentTypeError(f"{ref(name)} must be an array of real numbers, got True or False")
    if numbers is None or numbers.dtype.kind not in "biuf":
        raise ArgumentTypeError(f"{ref(name)} must be an array of real numbers, got {type(value).__name__}")
    if numbers.size > _MOST_UNCHECKED:
        # A view of an array, such as ``numpy.broadcast_to`` returns, requires little memory itself, but its copy may
        # not fit.
        memory.require_memory(
            bytes_per_number * numbers.size, f"{ref(name)} of shape {numbers.shape}", "take fewer numbers"
        )
    array = np.array(numbers, dtype=np.float64)
    if isinstance(value, np.ma.MaskedArray):
        # The array may contain any number at a masked element, for example an instrument's code for "no signal".
        array[np.ma.getmaskarray(value)] = np.nan
    if ndim is not None and array.ndim != ndim:
        raise ArgumentValueError(f"{ref(name)} must be a {ndim}-D array, got shape {array.shape}")
    bad = np.isinf(array) if gaps else ~np.isfinite(array)
    if bad.any():
        kind = "infinite" if gaps else "NaN, masked or infinite" if np.ma.is_masked(value) else "NaN or infinite"
        raise ArgumentValueError(f"{ref(name)} must be finite, got {int(np.count_nonzero(bad))} {kind} value(s)")
    if (beyond := (array > most) | (array < -most)).any():
        raise ArgumentValueError(f"{ref(name)} must lie within ±{most:g}, got {array[beyond][0]:g}")
    return array


def range_text(above: float | None, least: float | None, most: float | None) -> str:
    """Return the accepted range of a number in words, such as ``"more than 0 and at most 0.5"``; empty if unbounded."""
    words = (("more than", above), ("at least", least), ("at most", most))
    numbers = (
        (word, bound if isinstance(bound, int) else f"{bound:g}")
        for word, bound in words
        if bound not in (None, math.inf)
    )
    return " and ".join(f"{word} {bound}" for word, bound in numbers)


def described(value: object) -> str:
    """Return a text with type and value of an argument, such as ``str 'low'``, for messages about a wrong type."""
    return type(value).__name__ if value is None else f"{type(value).__name__} {value!r:.40}"


def number(
    value: object, name: str, *, above: float = -math.inf, least: float = -math.inf, most: float = MOST
) -> float:
    """Return ``value`` as a finite float that fulfils ``above`` < value and ``least`` <= value <= ``most``."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ArgumentTypeError(f"{ref(name)} must be a number, got {described(value)}")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not (-MOST <= result <= most and above < result and least <= result):
        kind = "a number" if most == math.inf else "a finite number"
        bounds = range_text(
            above if above > -math.inf else None,
            least if least > -math.inf else None,
            most if most < MOST or MOST < abs(result) < math.inf else None,
        )
        raise ArgumentValueError(f"{ref(name)} must be {kind}{f', {bounds}' if bounds else ''}, got {value!r}")
    return result


def positive(value: object, name: str, *, most: float = MOST) -> float:
    """Return ``value`` as a positive finite float from ``LEAST`` (1e-15) to ``most``."""
    result = number(value, name, above=0.0, most=most)
    if result < LEAST:
        raise ArgumentValueError(f"{ref(name)} must be at least {LEAST:g}, got {result:g}")
    return result


def count(value: object, name: str, *, least: int = 1, most: int = MOST_COUNT) -> int:
    """Return ``value`` as an integer from ``least`` to ``most``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ArgumentTypeError(f"{ref(name)} must be an integer, got {described(value)}")
    if not least <= value <= most:
        bounds = range_text(
            None, least if least > -MOST_COUNT else None, most if most < MOST_COUNT or value > most else None
        )
        raise ArgumentValueError(f"{ref(name)} must be an integer, {bounds}, got {value}")
    return int(value)


def is_sequence(value: object) -> TypeGuard[tuple[object, ...] | list[object] | np.ndarray]:
    """Whether ``value`` is a tuple, a list, or an array of at least one dimension."""
    return isinstance(value, (tuple, list)) or (isinstance(value, np.ndarray) and value.ndim > 0)


def pair(value: object, name: str) -> tuple[float, float]:
    """Return a positive scalar, or a pair in the order (y, x), as a pair of positive floats."""
    if is_sequence(value):
        if len(value) != 2:
            raise ArgumentValueError(f"{ref(name)} must be one number or a pair (y, x), got {len(value)} values")
        return positive(value[0], f"{name}[0]"), positive(value[1], f"{name}[1]")
    single = positive(value, name)
    return single, single


def order(value: object) -> tuple[int, int]:
    """Return a diffraction order (m_y, m_x) as a pair of integers."""
    if not is_sequence(value) or len(value) != 2:
        raise ArgumentTypeError(f"{ref('order')} must be a pair of integers (m_y, m_x), got {described(value)}")
    return count(value[0], "order", least=-_MOST_ORDER), count(value[1], "order", least=-_MOST_ORDER)


def vector(value: object, name: str) -> NDArray[np.float64]:
    """Return ``value`` as a finite float64 vector of shape (3,)."""
    array = finite_array(value, name)
    if array.shape != (3,):
        raise ArgumentValueError(f"{ref(name)} must be a vector of 3 numbers, got shape {array.shape}")
    return array


def numbers(value: object, name: str, *, length: int) -> tuple[float, ...]:
    """Return ``value`` as a tuple of ``length`` finite floats."""
    array = finite_array(value, name, most=MOST)
    if array.shape != (length,):
        raise ArgumentValueError(
            f"{ref(name)} must be {'a pair (y, x)' if length == 2 else f'{length} numbers'}, got shape {array.shape}"
        )
    return tuple(array.tolist())


def directions(value: object, name: str) -> tuple[NDArray[np.float64], bool]:
    """Return directions as unit vectors, shape (n, 3), and whether ``value`` was one direction of shape (3,)."""
    array = finite_array(value, name)
    if array.ndim not in (1, 2) or array.shape[-1] != 3:
        raise ArgumentValueError(f"{ref(name)} must have shape (3,) or (n, 3), got {array.shape}")
    single = array.ndim == 1
    array = np.atleast_2d(array)
    # Each vector is first divided by the magnitude of its largest component. The squares of its components are then
    # neither too small nor too large for float64, and their sum gives the length.
    largest = np.max(np.abs(array), axis=1, keepdims=True, initial=0.0)
    if not np.all(largest > 0.0):
        raise ArgumentValueError(
            f"{ref(name)} must not contain zero vectors, got {int(np.sum(largest == 0.0))} of {len(array)}"
        )
    array /= largest
    array /= np.linalg.norm(array, axis=1, keepdims=True)
    return array, single


def lengths(vectors: ArrayLike) -> NDArray[np.float64]:
    """Return the lengths of vectors, shape (3,) or (n, 3), as shape (n, 1), without overflow of their squares."""
    array = np.atleast_2d(np.asarray(vectors, dtype=np.float64))
    largest = np.max(np.abs(array), axis=1, keepdims=True, initial=0.0)
    return np.asarray(largest * np.linalg.norm(array / largest, axis=1, keepdims=True))


def unit_directions(value: object, name: str) -> tuple[NDArray[np.float64], bool]:
    """Return unit vectors, and whether the caller gave a single vector; warn if vectors look like angles in degrees."""
    result = directions(value, name)
    if _look_like_degrees(np.atleast_2d(np.asarray(value, dtype=np.float64))):
        first = ", ".join(f"{component:g}" for component in np.atleast_2d(np.asarray(value, dtype=np.float64))[0])
        warn(
            f"{ref(name)} ({first}) looks like angles in degrees, but it is a vector (x, y, z): for θ from the normal "
            "and φ around it, it is (sin θ cos φ, sin θ sin φ, cos θ)"
        )
    return result


def _look_like_degrees(vectors: NDArray[np.float64]) -> bool:
    """Whether all components of vectors, shape (n, 3), look like round angles in degrees, or are ±1.

    A vector with a single component that is not 0, such as (0, 0, 45), is a direction along an axis and does not count.
    """
    if not vectors.size or not _LEAST_DEGREES <= max(vectors.max(), -vectors.min()) <= _MOST_DEGREES:
        return False
    sizes = np.abs(vectors)
    is_round = (sizes % _ROUND_DEGREES == 0.0) | (sizes == 1.0)
    return bool(is_round.all() and np.any(np.count_nonzero(sizes, axis=1) > 1))


def light_and_view(to_light: object, to_view: object) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Return the directions to light and viewer as unit vectors (n, 3), and whether both were single vectors."""
    lights, one_light = unit_directions(to_light, "to_light")
    views, one_view = unit_directions(to_view, "to_view")
    if len(lights) != len(views) and 1 not in (len(lights), len(views)):
        raise ArgumentValueError(
            f"{ref('to_light')} and {ref('to_view')} must hold the same number of directions, or one, got "
            f"{len(lights)} and {len(views)}"
        )
    shape = (max(len(lights), len(views)) if len(lights) and len(views) else 0, 3)
    return np.broadcast_to(lights, shape), np.broadcast_to(views, shape), one_light and one_view


def choice(value: object, name: str, options: Collection[_Choice]) -> _Choice:
    """Return ``value`` if it is one of ``options``."""
    value = int(value) if isinstance(value, np.integer) else value
    if not isinstance(value, (str, int)) or isinstance(value, bool) or value not in options:
        near = did_you_mean(value, [option for option in options if isinstance(option, str)])
        raise ArgumentValueError(f"{ref(name)} must be one of {', '.join(map(repr, options))}, got {value!r}{near}")
    return cast("_Choice", value)


def path(value: object, name: str) -> Path:
    """Return ``value`` as a path; raise an error for other types and for file names that the system does not accept."""
    if not isinstance(value, (str, os.PathLike)):
        raise ArgumentTypeError(f"{ref(name)} must be a string or a path, got {type(value).__name__}")
    try:
        os.lstat(value)
    except (ValueError, OSError) as error:
        # The operating system refuses file names that contain NUL characters or unpaired surrogates, or are thousands
        # of characters long.
        if isinstance(error, ValueError) or error.errno == errno.ENAMETOOLONG:
            raise ArgumentValueError(f"{ref(name)} must be a name that a file can have, got {value!r}") from None
    return Path(os.fsdecode(value))


def instance(value: object, kind: type, name: str, *, optional: bool = False) -> None:
    """Raise an error if a value is not an instance of ``kind``, a class of the package; ``optional`` accepts None."""
    if not isinstance(value, kind) and not (optional and value is None):
        raise ArgumentTypeError(f"{ref(name)} must be a warpdiff.{kind.__name__}, got {type(value).__name__}")


def flag(value: object, name: str) -> bool:
    """Return ``value`` as a bool. Other types raise an error, because a string such as ``"no"`` would count as true."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentTypeError(f"{ref(name)} must be True or False, got {value!r}")
    return bool(value)
