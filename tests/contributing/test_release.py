"""Checks before a release, and the workflow files. Their steps must be make targets and Python modules that exist."""

import re
from pathlib import Path

import pytest

from bench.dev import licences, release_check

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TARGETS = set(re.findall(r"^([a-z-]+):.*## ", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def commands(text):
    """Return the commands of a workflow file, with each value of the matrix ``target``."""
    (values,) = re.findall(r"target: \[(.*?)\]", text) or [""]
    lines = re.findall(r"run: (.*)", text)
    return [
        line.replace("${{ matrix.target }}", value) for line in lines
        for value in (values.split(", ") if "matrix.target" in line else [""])
    ]  # fmt: skip


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_steps_of_workflows_are_targets_and_modules_that_exist(path):
    text = path.read_text(encoding="utf-8")
    lines = commands(text)
    assert lines
    for line in lines:
        words = line.split()
        if words[0] == "make":
            assert words[1] in TARGETS, line
        else:
            assert words[0].endswith("python"), line
            assert words[2] in ("pip", "pytest") or (ROOT / f"{words[2].replace('.', '/')}.py").is_file(), line
        for steps in re.findall(r'(?:STEPS="|--steps )([a-z -]+?)(?:"| --|$)', line):
            assert set(steps.split()) <= set(release_check.STEPS), line
    # Each job must have a time limit, and may only read the repository.
    assert text.count("runs-on:") == text.count("timeout-minutes:")
    assert re.search(r"^permissions:\n  contents: read$", text, re.MULTILINE)
    assert text.count("actions/checkout") == text.count("persist-credentials: false")


def test_the_workflows_test_all_systems_pythons_and_versions():
    text = (ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8")
    for name in ("ubuntu-latest", "macos-latest", "windows-latest", "test-lowest", "test-newest", "test-prerelease"):
        assert name in text
    assert re.search(r'python: \["3\.11", .*"3\.14"\]', text)
    published = (ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8")
    assert "id-token: write" in published
    assert "password" not in published.replace("no password is stored", "")


def test_licences_are_accepted_by_their_expression():
    for text in (
        "MIT", "BSD License", "Apache-2.0 OR GPL-3.0-only", "MIT AND (Zlib OR GPL-2.0)",
        "Apache-2.0 WITH LLVM-exception",
    ):  # fmt: skip
        assert licences.is_accepted(text), text
    for text in (
        "", "GPL-3.0-only", "MIT AND GPL-3.0", "Proprietary", "LGPL-3.0 OR AGPL-3.0",
        "GPL-3.0-only AND (Zlib OR MIT)", "GPL-2.0-only AND (MIT OR Apache-2.0)",
        "(MIT OR GPL-3.0) AND (GPL-2.0 OR AGPL-3.0)",
    ):  # fmt: skip
        assert not licences.is_accepted(text), text


def test_the_licences_of_the_installed_dependencies_are_accepted(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["licences"])
    assert licences.main() == 0
    assert "numpy" in capsys.readouterr().out
    monkeypatch.setattr(licences, "ACCEPTED", licences.ACCEPTED - {"mit license", "mit"})
    assert licences.main() == 1
    assert "trimesh" in capsys.readouterr().err


def test_the_report_names_what_failed_and_what_was_not_tried(monkeypatch, capsys):
    def fails():
        raise release_check.FailedError("two builds differ")

    def absent():
        raise release_check.NotTriedError("no Chromium")

    monkeypatch.setattr(release_check, "STEPS", {"a": lambda: "3 files", "b": absent, "c": fails, "d": fails})
    monkeypatch.setattr("sys.argv", ["release_check", "--steps", "a", "b"])
    assert release_check.main() == 0
    report = capsys.readouterr().out
    for text in ("| a | passed | 3 files |", "- b: no Chromium", "- c: not selected", "Windows, macOS and ARM"):
        assert text in report
    monkeypatch.setattr("sys.argv", ["release_check", "--steps", "a", "c"])
    assert release_check.main() == 1
    assert "| c | FAILED | two builds differ |" in capsys.readouterr().out


def test_the_changelog_begins_with_the_version(monkeypatch):
    assert release_check.check_version() == release_check.PROJECT["version"]
    monkeypatch.setitem(release_check.PROJECT, "version", "9.9")
    with pytest.raises(release_check.FailedError, match=r"begins with .*, and the version is 9\.9"):
        release_check.check_version()
