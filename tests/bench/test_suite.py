"""The benchmark suite (``python -m bench``): comparisons of runs, refusals and files, but not its measurements."""

import csv
import json
import os

import numpy as np
import pytest

import warpdiff as wd
from bench import __main__ as command
from bench import inputs
from bench.suite import runner
from bench.suite.scenes import Directions, scenes
from bench.truth import reference


def results(path, **figures):
    """Write a file of benchmark results, with (value, least, most) for each measured quantity."""
    path.write_text(json.dumps({"figures": {name: [*values, "s"] for name, values in figures.items()}}))
    return path


def test_changes_are_distinguished_from_noise(tmp_path):
    old = results(
        tmp_path / "old.json", steady=(1.0, 0.9, 1.1), noisy=(1.0, 0.5, 2.0), slower=(1.0, 0.98, 1.02),
        little=(1.0, 1.0, 1.0), none=(0.0, 0.0, 0.0), gone=(1.0, 1.0, 1.0),
    )  # fmt: skip
    new = results(
        tmp_path / "new.json", steady=(1.15, 1.05, 1.2), noisy=(1.9, 1.0, 2.5), slower=(3.0, 2.9, 3.1),
        little=(1.05, 1.05, 1.05), none=(0.1, 0.1, 0.1), added=(1.0, 1.0, 1.0),
    )  # fmt: skip
    lines = runner.compare(old, new)
    assert lines[0] == "2 of 5 figures changed by more than their noise and 10 %."
    assert lines[1].startswith("none: 0 to 0.1 s")
    assert lines[2] == "slower: 1 to 3 s, 3.00 times"
    assert lines[3:] == ["removed: gone", "new: added"]
    assert runner.compare(old, old) == ["0 of 6 figures changed by more than their noise and 10 %."]


def test_the_command_line_compares_two_runs_and_refuses_other_files(tmp_path, capsys):
    path = results(tmp_path / "a.json", one=(1.0, 1.0, 1.0))
    assert command.main(["--compare", str(path), str(path)]) == 0
    assert "0 of 1 figures changed" in capsys.readouterr().out
    assert command.main(["--compare", str(path), str(tmp_path / "none.json")]) == 2
    assert "none.json does not exist" in capsys.readouterr().err
    (tmp_path / "b.json").write_text("{}")
    assert command.main(["--compare", str(path), str(tmp_path / "b.json")]) == 2
    assert "is not the results.json" in capsys.readouterr().err


def test_unknown_parts_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"--filter must name parts out of previews, pareto, .* got nonsense"):
        runner.run(tmp_path / "folder", parts=["pareto", "nonsense"])
    assert not (tmp_path / "folder").exists()


def test_an_unwritable_folder_is_refused_before_measuring(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner.importlib.util, "find_spec", lambda _name: True)
    monkeypatch.chdir(tmp_path)
    # The root user may write to any folder, so ``os.access`` is replaced by a function that denies it.
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert command.main(["--filter", "pareto"]) == 2
    assert "is not writable; use another one" in capsys.readouterr().err


def test_each_figure_is_one_line(tmp_path):
    runner.write_csv(tmp_path / "results.csv", {"a/b": [1.0, 0.9, 1.2, "µs"], "c, d": [2.0, 2.0, 2.0, "error"]})
    with (tmp_path / "results.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [
        ["figure", "value", "least", "most", "unit"],
        ["a/b", "1.0", "0.9", "1.2", "µs"],
        ["c, d", "2.0", "2.0", "2.0", "error"],
    ]


def test_a_run_states_its_machine():
    machine = runner.machine(runner.Setting(True, None, 2, None, 3))
    assert machine["warpdiff"] == wd.__version__
    assert machine["threads"] == 2
    assert machine["packages"]["numpy"] == np.__version__
    assert machine["processor"]
    json.dumps(machine)


def test_a_subset_of_directions_is_spread_over_all():
    n = np.arange(10.0)
    subset = Directions(np.stack([n] * 3, axis=1), np.stack([n] * 3, axis=1), n).subset(4)
    np.testing.assert_array_equal(subset.gains, [0, 3, 6, 9])
    assert len(subset.subset(100).gains) == 4


@pytest.fixture(scope="module")
def fingers(tmp_path_factory):
    """Return the benchmark's scene with synthetic nano-fingers, which is used if the data folder contains no scan."""
    empty = tmp_path_factory.mktemp("empty")
    assert inputs.scan(empty) is None
    (result,) = [scene for scene in scenes(empty) if scene.name == "fingers"]
    return result


def test_a_scene_is_charted_on_the_pixels_of_its_picture(fingers):
    """The benchmark's chart of a scene must use the directions of the illuminated pixels of the scene's picture.

    The colours of the reference in these directions must equal the colours of the pixels.
    """
    assert [coherence.kind for coherence in fingers.coherences] == ["averaged", "centred", "source"]
    window = fingers.coherences[0]
    directions, illuminated = fingers.directions(window, width=48)
    view = fingers.view(48)
    image = wd.shade(fingers.mesh, fingers.heightfield, fingers.light, view, coherence=window, footprint=False)
    np.testing.assert_array_equal(np.flatnonzero(image.illuminated.ravel()), illuminated)
    subset = directions.subset(20)
    exact = subset.gains[:, None] * reference.colours(
        fingers.heightfield, subset.scattering_vectors, subset.to_lights, window, tolerance=1e-3
    )
    ours = image.xyz.reshape(-1, 3)[illuminated][np.linspace(0, len(illuminated) - 1, 20).astype(int)]
    floor = 1e-3 * np.percentile(image.xyz[image.illuminated][:, 1], 99.0)
    error = np.linalg.norm(ours - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor)
    assert np.max(error) < 2e-2


def test_a_method_of_the_user_is_a_peer():
    """A method that the user supplies must appear in charts under its own name. It must be called without settings."""
    from bench.peers import numpy_peer
    from bench.suite import pareto

    setting = runner.Setting(True, None, 1, None, 1, runner.user_peer("bench.peers.numpy_peer:prepare"))
    peer, settings = pareto.peers(wd.Coherence(sigma_um=3.0), setting)["bench.peers.numpy_peer:prepare"]
    assert settings == [{}]
    assert peer.prepare is numpy_peer.prepare
    assert pareto.label({}) == "default"
    assert pareto.style("bench.peers.numpy_peer:prepare")[2] == "bench.peers.numpy_peer:prepare"


@pytest.mark.parametrize("text", ["nowhere:prepare", "bench.inputs", "bench.inputs:nothing", "bench.inputs:HELP", ":x"])
def test_a_users_method_that_cannot_be_imported_is_refused(text):
    with pytest.raises(ValueError, match=f"--peer must name a function|--peer must be module:function.*{text}"):
        runner.user_peer(text)
