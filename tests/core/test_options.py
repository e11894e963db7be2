"""Descriptions of options, from annotations and docstrings, and the values that options accept."""

from __future__ import annotations

import math
from collections.abc import Collection  # noqa: TC003 (evaluated when fields are described)
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pytest
from annotated_types import Ge, Gt, Interval, Unit

from warpdiff.core.options import REQUIRED, Checked, Names, Option, describe
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, spelled
from warpdiff.optics.coherence import Coherence

if TYPE_CHECKING:
    from decimal import Decimal

    import absent

Spelling = Literal["normalised", "normalized", "plain"]


@dataclass(frozen=True, kw_only=True)
class Base(Checked):
    """Test class whose options the class ``Group`` inherits. Tests compare the parsed descriptions below.

    Attributes:
        tolerance: Error that is accepted.
        kind: Meaning of the base.
    """

    tolerance: Annotated[float, Interval(ge=1e-5, le=0.5)] = 1e-2
    kind: Spelling = "plain"


@dataclass(frozen=True, kw_only=True)
class Group(Base):
    """Test class with one option of each type. Tests compare the parsed descriptions below.

    Attributes:
        length_um: Length of the window
            along both axes, ``None`` for
            all of it: see below.
        kind: Meaning of the group.
    """

    length_um: Annotated[float, Gt(0.0), Unit("µm")] | None = None
    count: Annotated[int, Ge(2)] | None = 3
    pitch: float | tuple[float, float] = 1.0
    size: tuple[int, int] = (1, 2)
    centre: tuple[float, float, float] | None = None
    layers: Collection[Literal["normal", "depth"]] = ()
    parts: Annotated[Collection[str], Names(("whole", "light"), indexed=("light",))] = ()
    formats: tuple[Literal["png", "exr"], ...] = ("png",)
    bits: Literal[8, 16] = 8
    strict: bool = True
    title: str = ""
    coherence: Coherence | None = None
    anything: Any = None
    absent: absent.Thing | Decimal | None = None
    other: int | str = 1
    required: int
    derived: int = field(init=False, default=0)


def function(self, first, second: Annotated[int, Unit("pixels")] = 2, *rest, third: bool | None = None, **more):
    """Have arguments of several kinds. Tests compare their descriptions, which are parsed from this text.

    Args:
        first: One.
        second: Two: with a colon.

            And a paragraph.
        third:
            Three.

    Returns:
        Nothing: not an argument.
    """


def test_options_are_described_by_the_annotations_of_fields():
    options = describe(Group)
    assert list(options)[:3] == ["tolerance", "kind", "length_um"]
    assert "derived" not in options
    assert options["length_um"] == Option(
        "length_um", "number", None, "Length of the window along both axes, ``None`` for all of it: see below.",
        gt=0.0, unit="µm", optional=True,
    )  # fmt: skip
    assert options["count"] == Option("count", "integer", 3, "", ge=2, optional=True)
    assert options["size"] == Option("size", "integers", (1, 2), "", length=2)
    assert options["centre"] == Option("centre", "numbers", None, "", length=3, optional=True)
    assert options["layers"] == Option("layers", "choices", (), "", choices=("normal", "depth"))
    assert options["parts"] == Option("parts", "choices", (), "", choices=("whole", "light"), indexed=("light",))
    assert options["formats"] == Option("formats", "choices", ("png",), "", choices=("png", "exr"))
    assert options["bits"] == Option("bits", "choice", 8, "", choices=(8, 16))
    assert options["coherence"] == Option("coherence", "object", None, "", optional=True, instance_of=Coherence)
    assert options["required"].default is REQUIRED
    kinds = {name: options[name].kind for name in ("pitch", "strict", "title", "anything", "absent", "other")}
    assert list(kinds.values()) == ["pair", "flag", "text", "object", "object", "object"]


def test_redefined_options_have_the_new_description_and_no_american_spellings():
    option = describe(Group)["kind"]
    assert option == Option("kind", "choice", "plain", "Meaning of the group.", choices=("normalised", "plain"))
    assert describe(Base)["kind"].help == "Meaning of the base."
    assert describe(Group)["tolerance"].range == "at least 1e-05 and at most 0.5"


def test_options_are_described_by_the_arguments_of_functions():
    assert describe(function) == {
        "first": Option("first", "object", REQUIRED, "One."),
        "second": Option("second", "integer", 2, "Two: with a colon. And a paragraph.", unit="pixels"),
        "third": Option("third", "flag", None, "Three.", optional=True),
    }
    assert describe(function)["second"].range == ""


def test_flags_of_the_command_line_have_dashes():
    assert describe(Group)["length_um"].dashed == "length-um"


ACCEPTED = [
    ("tolerance", np.float32(0.25), 0.25),
    ("tolerance", 1e-5, 1e-5),
    ("length_um", None, None),
    ("count", np.int8(2), 2),
    ("kind", "normalized", "normalised"),
    ("pitch", 2, 2.0),
    ("pitch", np.array([1, 2]), (1.0, 2.0)),
    ("size", [3, 4], (3, 4)),
    ("centre", (1, 2, 3), (1.0, 2.0, 3.0)),
    ("layers", ["depth", "normal", "depth"], ("depth", "normal")),
    ("parts", ["light.01", "whole", "light", "light.1"], ("light.1", "whole", "light")),
    ("formats", (), ()),
    ("bits", 16, 16),
    ("bits", np.int64(16), 16),
    ("strict", np.bool_(False), False),
    ("title", "a", "a"),
    ("anything", math, math),
]


@pytest.mark.parametrize(("name", "value", "result"), ACCEPTED)
def test_values_are_converted_to_the_type_of_the_option(name, value, result):
    made = getattr(Group(required=1, **{name: value}), name)
    assert made == result
    assert type(made) is type(result)


REFUSED = [
    ("tolerance", 0.6, ArgumentValueError, "must be a finite number, at least 1e-05 and at most 0.5, got 0.6"),
    ("tolerance", True, ArgumentTypeError, "must be a number, got bool True"),
    ("tolerance", None, ArgumentTypeError, "must be a number, got NoneType"),
    ("length_um", 0, ArgumentValueError, "must be a finite number, more than 0, got 0"),
    ("count", 1, ArgumentValueError, "must be an integer, at least 2, got 1"),
    ("count", 2.0, ArgumentTypeError, "must be an integer, got float 2.0"),
    ("kind", "plane", ArgumentValueError, "must be one of 'normalised', 'plain', got 'plane'; did you mean 'plain'?"),
    ("kind", ["plain"], ArgumentValueError, "must be one of 'normalised', 'plain', got ['plain']"),
    ("pitch", (1, 2, 3), ArgumentValueError, "must be one number or a pair (y, x), got 3 values"),
    ("pitch", "wide", ArgumentTypeError, "must be a number, got str 'wide'"),
    ("size", 3, ArgumentValueError, "must be a pair (y, x) of integers, got 3"),
    ("centre", (1, 2), ArgumentValueError, "must be 3 numbers, got shape (2,)"),
    ("layers", "normal", ArgumentTypeError, "must be a tuple or list of 'normal', 'depth', got 'normal'"),
    ("layers", ["albedo"], ArgumentValueError, "must be one of 'normal', 'depth', got 'albedo'"),
    ("parts", ["whole.1"], ArgumentValueError, "must be one of 'whole', 'light', got 'whole.1'; did you mean 'whole'?"),
    ("parts", ["light.x"], ArgumentValueError, "must be one of 'whole', 'light', got 'light.x'; did you mean 'light'?"),
    ("parts", ["light." + 10 * "1"], ArgumentValueError, "must be one of 'whole', 'light', got 'light.1111111111'"),
    ("bits", True, ArgumentValueError, "must be one of 8, 16, got True"),
    ("strict", 1, ArgumentTypeError, "must be True or False, got 1"),
    ("title", None, ArgumentTypeError, "must be a string, got NoneType"),
    ("coherence", "averaged", ArgumentTypeError, "must be a warpdiff.Coherence, got str"),
]


@pytest.mark.parametrize(("name", "value", "error", "message"), REFUSED)
def test_invalid_values_are_refused_by_the_name_of_the_option(name, value, error, message):
    with pytest.raises(error) as refused:
        Group(required=1, **{name: value})
    assert str(refused.value) == f"{name} {message}"
    assert spelled(refused.value, lambda word, _: f"<{word}>") == f"<{name}> {message}"


def test_an_element_of_a_pair_is_refused_by_its_index():
    with pytest.raises(ArgumentTypeError, match=r"^size\[1\] must be an integer, got float 2\.5$"):
        Group(required=1, size=(1, 2.5))
