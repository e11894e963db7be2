"""Fuzzed arguments of the command line: documented exit codes, one line of error message, no traceback."""

import argparse
import functools
import warnings

import numpy as np
import pytest
from endurance import examples, seconds_left
from hypothesis import given
from hypothesis import strategies as st

import warpdiff as wd
from warpdiff.apps import cli
from warpdiff.core import memory

SMALL = ["--heightfield", "blazed", "--tolerance", "0.1", "--sigma-um", "3"]
FRAME = ["disc.ply", *SMALL, "--width", "4", "--height", "3"]
# Valid arguments with which each command runs quickly.
COMMANDS = {
    "render": [*FRAME, "-o", "a.png"], "brdf": [*SMALL, "--size", "4", "-o", "a.png"],
    "sequence": [*FRAME, "--count", "2", "-o", "frames"], "info": ["--heightfield", "blazed", "--tolerance", "0.1"],
    "orders": ["blazed"], "angles": ["blazed"], "spectrum": [*SMALL, "--step-nm", "100"], "cache": [],
}  # fmt: skip
VALUES = [
    *("", "x", "nan", "inf", "-inf", "-1", "0", "-0", "1e300", "1e-300", "5e-324", "9" * 400, "1e15", "1e-15", "0x10"),
    *("1,5", "٣", "½", "\udcff", "--", "-", "1", "3", "1000000000", "0.1", "sinusoidal", "a.npy", "gaps.npy", "no.png"),
    *("/dev/null", "no/such/b.png", ".", "b.exr", "b.jpg", "disc.ply", "centred", "source", "replicas", "FL11"),
    *("taylor", "direct", "table", "normalized", "cuda", "a" * 5000, "3000K", "directional:to_light=0x0x0"),
    *("point:position=0x1x2", "point:power=x", "fingers:size_um=3", "snake:segments=1e9", "sinusoidal:x"),
]


def actions(command):
    """Return the arguments of a command, except those that end it immediately or print tracebacks."""
    parser = cli._parser([command])
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return [action for action in commands.choices[command]._actions if action.dest not in ("help", "debug")]


def written(action, draw):
    """Return the words of a command line that give random values to one option."""
    count = 0 if action.nargs == 0 else action.nargs if isinstance(action.nargs, int) else 1
    return [*action.option_strings[:1], *(draw(st.sampled_from(VALUES)) for _ in range(count))]


@pytest.mark.permanent("arguments of the command line", shares=3)
@pytest.mark.parametrize("command", COMMANDS)
def test_fuzzed_arguments_end_as_documented(command, tries, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "cache"))
    # With little free memory, arguments that require much memory are refused on every machine.
    monkeypatch.setattr(memory, "available", lambda: 5e8)
    # With a short coherence window, the library makes its plan (method, number of wavelengths and so on) several
    # seconds faster.
    monkeypatch.setattr(wd, "plan", functools.partial(wd.plan, coherence=wd.Coherence(sigma_um=3.0)))
    wd.meshes.disc(segments=8, rings=1).export("disc.ply")
    waves = 0.05 * np.sin(np.arange(12.0))[None, :] + np.zeros((9, 1))
    np.save("a.npy", waves)
    np.save("gaps.npy", np.where(waves > 0.04, np.nan, waves))

    one_or_two = st.lists(
        st.sampled_from(actions(command)), min_size=1, max_size=2, unique_by=lambda action: action.dest
    )

    def end(fuzzed):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                code = cli.main([command, *COMMANDS[command], *fuzzed])
        except SystemExit as stopped:
            code = stopped.code
        error = capfd.readouterr().err
        assert code in (0, 2) or (code == 1 and "MemoryError" in error), (code, fuzzed, error)
        assert "Traceback" not in error
        assert code == 0 or "warpdiff" in error.splitlines()[-1]

    @examples(6, 85)
    @given(st.data())
    def attempt(data):
        for _ in range(3):
            fuzzed = [text for action in data.draw(one_or_two) for text in written(action, data.draw)]
            # Hypothesis continues to draw examples (random arguments) after the time limit, so late examples are
            # skipped.
            if seconds_left():
                tries.number += 1
                end(fuzzed)

    attempt()
