"""Examples in the docstrings of public names: every name has at least one, and all of them run."""

from __future__ import annotations

import doctest
import inspect
from typing import TYPE_CHECKING

import numpy as np
import pytest
from conftest import public_members
from small_pictures import draw_reports_roughly

import warpdiff as wd

if TYPE_CHECKING:
    from collections.abc import Iterator

OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public_names() -> list[str]:
    """Return the names in ``wd.__all__`` and the public functions of public modules such as ``wd.gratings``."""
    names = list(wd.__all__)
    for name in wd.__all__:
        value = getattr(wd, name)
        if inspect.ismodule(value):
            functions = inspect.getmembers(value, inspect.isfunction)
            own = getattr(
                value, "__all__", [key for key, function in functions if function.__module__ == value.__name__]
            )
            names += [f"{name}.{key}" for key in own if not key.startswith("_")]
    return names


def members(name: str) -> Iterator[tuple[str, object]]:
    """Yield the object of a public name. For a class, also yield its public methods and properties."""
    value: object = wd
    for part in name.split("."):
        value = getattr(value, part)
    yield name, value
    if isinstance(value, type):
        for key, member in public_members(value).items():
            yield f"{name}.{key}", getattr(member, "__func__", member)


def examples(name: str, value: object) -> doctest.DocTest:
    """Return the examples in the docstring of an object; plain attributes have no docstring of their own."""
    has_docstring = callable(value) or isinstance(value, property) or inspect.ismodule(value)
    text = inspect.getdoc(value) or "" if has_docstring else ""
    return doctest.DocTestParser().get_doctest(text, {"np": np, "wd": wd}, name, None, None)


@pytest.mark.parametrize("name", public_names())
def test_public_name_has_an_example(name):
    """Check that the docstring of a public name contains an example; examples in its methods do not count."""
    _, value = next(members(name))
    assert examples(name, value).examples, f"the docstring of {name} has no example"


@pytest.mark.parametrize("name", public_names())
def test_examples_run(name, tmp_path, monkeypatch):
    """The examples of a name and of its methods must print the stated output. They run in a temporary folder."""
    monkeypatch.chdir(tmp_path)
    draw_reports_roughly(monkeypatch)
    runner = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False)
    report: list[str] = []
    # NumPy must print numbers in its default format, which packages that other tests have imported may have changed.
    with np.printoptions(legacy=False):
        for member, value in members(name):
            runner.run(examples(member, value), out=report.append)
    assert not runner.failures, "".join(report)
