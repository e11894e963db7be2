"""What is kept on disk: found again to the bit, under a limit, and never in the way."""

from __future__ import annotations

import numpy as np
import pytest

import warpdiff as wd
from warpdiff import disk

HEIGHTS = np.arange(12.0).reshape(3, 4)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for it, and everything worth keeping."""
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.setattr(disk, "_LEAST_SECONDS", 0.0)
    return tmp_path / "kept"


def counted(value):
    calls = []

    def make():
        calls.append(value)
        return {"rows": np.full((2, 3), value, dtype=np.float32), "step": 0.25}

    return calls, make


def test_what_is_kept_is_found_again(folder):
    calls, make = counted(1.0)
    first = disk.kept_on_disk("key", HEIGHTS, make)
    again = disk.kept_on_disk("key", HEIGHTS, make)
    assert len(calls) == 1
    np.testing.assert_array_equal(first["rows"], again["rows"])
    assert again["rows"].dtype == np.float32
    assert again["step"] == 0.25
    assert [each.suffix for each in folder.iterdir()] == [".npz"]


@pytest.mark.parametrize(("key", "heights"), [("other", HEIGHTS), ("key", HEIGHTS + 1.0), ("key", HEIGHTS.T)])
def test_another_question_has_another_answer(folder, key, heights):
    disk.kept_on_disk("key", HEIGHTS, counted(1.0)[1])
    assert disk.kept_on_disk(key, heights, counted(2.0)[1])["rows"][0, 0] == 2.0
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 no archive", None])
def test_a_damaged_file_is_made_anew(folder, damage):
    disk.kept_on_disk("key", HEIGHTS, counted(1.0)[1])
    path = next(folder.iterdir())
    path.write_bytes(path.read_bytes()[:-40] if damage is None else damage)
    calls, make = counted(1.0)
    assert disk.kept_on_disk("key", HEIGHTS, make)["rows"][0, 0] == 1.0
    assert len(calls) == 1


def test_the_oldest_go_where_it_is_full(folder, monkeypatch):
    import os

    monkeypatch.setattr(disk, "_MOST_BYTES", 1600)
    for index in range(5):
        disk.kept_on_disk(index, HEIGHTS, counted(float(index))[1])
        for age, path in enumerate(sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime, reverse=True)):
            os.utime(path, (1e9 - age, 1e9 - age))
    assert 1 <= len(list(folder.iterdir())) <= 3
    calls, make = counted(9.0)
    disk.kept_on_disk(4, HEIGHTS, make)
    disk.kept_on_disk(0, HEIGHTS, make)
    assert len(calls) == 1


def test_it_can_be_turned_off_and_may_fail(tmp_path, monkeypatch):
    monkeypatch.setattr(disk, "_LEAST_SECONDS", 0.0)
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", "")
    monkeypatch.chdir(tmp_path)
    assert disk.kept_on_disk("key", HEIGHTS, counted(1.0)[1])["step"] == 0.25
    assert not list(tmp_path.iterdir())
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(blocked))
    assert disk.kept_on_disk("key", HEIGHTS, counted(1.0)[1])["step"] == 0.25
    assert blocked.read_text() == "not a folder"


def test_what_is_fast_is_not_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "kept"))
    disk.kept_on_disk("key", HEIGHTS, counted(1.0)[1])
    assert not (tmp_path / "kept").exists()


def test_pictures_are_the_same_with_it(folder):
    lights = np.array([[0.1, 0.2, 0.97]])
    views = np.array([[-0.3, 0.1, 0.95]])
    grating = wd.gratings.fingers(size_um=6.4, seed=3)
    first = wd.reflectance(grating, lights, views)
    assert list(folder.iterdir())
    again = wd.HeightField(grating.heights_um, grating.pitch_um)
    np.testing.assert_array_equal(first, wd.reflectance(again, lights, views))
