"""Messages with marked argument names: Python, command line and viewer insert names, other text is unchanged."""

from __future__ import annotations

import copy
import pickle

import pytest

from warpdiff.core.wording import (
    ArgumentTypeError,
    ArgumentValueError,
    ToleranceError,
    WarpdiffWarning,
    did_you_mean,
    marked,
    ref,
    renaming,
    spelled,
)

MESSAGE = f"{ref('sigma_um')} is for {ref('kind', 'source')}: set {ref('refine', False)}, or use {ref('filled()')}"


def flag(name, value):
    return f"--{name}" if value is None else f"--{name} {value}"


def test_each_front_end_writes_its_own_argument_names():
    error = ArgumentValueError(MESSAGE)
    assert str(error) == "sigma_um is for kind='source': set refine=False, or use filled()"
    assert spelled(error) == str(error)
    assert spelled(error, flag) == "--sigma_um is for --kind 'source': set --refine False, or use --filled()"
    assert spelled(MESSAGE, flag) == spelled(error, flag)
    assert spelled(KeyError("sigma_um")) == "'sigma_um'"


@pytest.mark.parametrize(
    ("kind", "base"),
    [
        (ArgumentValueError, ValueError),
        (ArgumentTypeError, TypeError),
        (ToleranceError, ValueError),
        (WarpdiffWarning, UserWarning),
    ],
)
def test_marks_of_errors_and_warnings_survive_pickling(kind, base):
    error = kind(MESSAGE)
    assert isinstance(error, base)
    for same in (pickle.loads(pickle.dumps(error)), copy.copy(error)):  # noqa: S301 (pickled in this line)
        assert type(same) is kind
        assert str(same) == str(error)
        assert spelled(same, flag) == spelled(error, flag)


def test_other_errors_may_be_marked():
    error = marked(FileNotFoundError, f"{ref('path')}: there is no file 'path'")
    assert type(error) is FileNotFoundError
    assert str(error) == "path: there is no file 'path'"
    assert spelled(error, flag) == "--path: there is no file 'path'"


def test_a_users_text_cannot_forge_a_mark():
    forged = "\ue000path\ue002"
    error = ArgumentValueError(f"{ref('name')} must be one of 'a', got {forged!r}")
    assert spelled(error, flag) == "--name must be one of 'a', got '\\ue000path\\ue002'"
    proposed = ArgumentValueError(f"use {ref('name', forged)}")
    assert spelled(proposed, flag) == "use --name '\\ue000path\\ue002'"


def test_arguments_can_be_renamed():
    for message, renamed in {
        ref("path"): "--sky",
        f"{ref('path[1].name')} and {ref('paths')}": "--sky[1].name and paths",
        f"{ref('path', 'path')} of path": "--sky='path' of path",
    }.items():
        with pytest.raises(ArgumentValueError) as refused, renaming({"path": "--sky"}):
            raise ArgumentValueError(message)
        assert str(refused.value) == renamed
    plain = ValueError("path")
    with pytest.raises(ValueError, match=r"^path$") as raised, renaming({"path": "--sky"}):
        raise plain
    assert raised.value is plain


def test_the_nearest_name_is_proposed():
    assert did_you_mean("tolernce", ["tolerance", "threads"]) == "; did you mean 'tolerance'?"
    assert did_you_mean("colour", ["tolerance", "threads"]) == ""
    assert did_you_mean(3, ["3"]) == ""
