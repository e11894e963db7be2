"""Disk cache: exact contents, size limit, damaged files, and pictures that do not depend on the cache."""

import io
import os
import subprocess
import sys

import numpy as np
import pytest
from endurance import count

import warpdiff as wd
from warpdiff.core import disk_cache

ROW = "cache files: damaged, or left by killed processes"
HEIGHTS = np.arange(12.0).reshape(3, 4)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Use a temporary cache folder, and cache all results, even those that are computed quickly."""
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(disk_cache, "_LEAST_SECONDS", 0.0)
    return tmp_path / "cache"


def counted(value):
    calls = []

    def make():
        calls.append(value)
        return {"rows": np.full((2, 3), value, dtype=np.float32), "step": 0.25}

    return calls, make


def test_stored_arrays_are_read_again(folder):
    calls, make = counted(1.0)
    first = disk_cache.cached_on_disk("key", HEIGHTS, make)
    again = disk_cache.cached_on_disk("key", HEIGHTS, make)
    assert len(calls) == 1
    np.testing.assert_array_equal(first["rows"], again["rows"])
    assert again["rows"].dtype == np.float32
    assert again["step"] == 0.25
    assert [path.suffix for path in folder.iterdir()] == [".npz"]


@pytest.mark.usefixtures("folder")
def test_arrays_of_objects_which_could_never_be_read_again_are_refused():
    with pytest.raises(TypeError, match="cannot be read from the cache: names"):
        disk_cache.cached_on_disk("key", HEIGHTS, lambda: {"names": ("mesh", None), "step": 0.25})


@pytest.mark.parametrize(("key", "heights"), [("other", HEIGHTS), ("key", HEIGHTS + 1.0), ("key", HEIGHTS.T)])
def test_other_keys_and_heights_have_their_own_files(folder, key, heights):
    disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])
    assert disk_cache.cached_on_disk(key, heights, counted(2.0)[1])["rows"][0, 0] == 2.0
    assert len(list(folder.iterdir())) == 2


@pytest.mark.usefixtures("folder")
def test_files_written_by_other_code_are_not_read(tmp_path, monkeypatch):
    """Cache files of another release, or written before a change of the code, must not be read."""
    digests = []
    for text in ("ORDER = 1", "ORDER = 2", "ORDER = 2"):
        (tmp_path / "series.py").write_text(text)
        digests.append(disk_cache._code_digest.__wrapped__(tmp_path))
    assert digests[0] != digests[1] == digests[2]
    for number, digest in enumerate(digests):
        monkeypatch.setattr(disk_cache, "_code_digest", lambda *_, value=digest: value)
        arrays = disk_cache.cached_on_disk("key", HEIGHTS, counted(float(number))[1])
        assert arrays["rows"][0, 0] == min(number, 1)


def archive(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def damaged(whole, rng):
    """Yield damaged versions of a cache file: other contents, truncated files and files with changed bytes."""
    sound = archive(rows=np.ones((2, 3), np.float32), step=0.25)
    yield from (b"", b"PK\x03\x04 no archive", bytes(4096), sound)
    yield archive(rows=np.ones((2, 3), np.float32))
    yield archive(rows=np.ones((3, 2), np.float64), step=0.25)
    yield archive(rows=np.full((2, 3), np.nan, np.float32), step=np.inf)
    for at in range(8, 40, 2):
        # Bytes of the headers in a ZIP archive, which state its version, encryption and compression, are changed one at
        # a time.
        for header in (b"PK\x03\x04", b"PK\x01\x02"):
            for start in (0, whole.index(b"PK")):
                content = bytearray(whole[start:])
                content[content.index(header) + at - 4] ^= 0x41
                yield bytes(content)
    yield from (whole[:size] for size in range(0, len(whole), 29))
    for _ in range(count(400, 12_000)):
        content = bytearray(whole)
        content[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        yield bytes(content)


@pytest.mark.permanent(ROW, shares=10)
def test_a_damaged_file_is_replaced(folder, rng, tries):
    disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])
    path = next(folder.iterdir())
    whole = path.read_bytes()
    disk_cache.cached_on_disk("other", HEIGHTS, counted(2.0)[1])
    other = next(file for file in folder.iterdir() if file != path)
    for content in tries.of((other.read_bytes(), *damaged(whole, rng))):
        path.write_bytes(content)
        calls, make = counted(1.0)
        for _ in range(2):
            arrays = disk_cache.cached_on_disk("key", HEIGHTS, make)
            np.testing.assert_array_equal(arrays["rows"], np.ones((2, 3), np.float32))
            assert arrays["step"] == 0.25
        # After a cache file was damaged, its arrays must be computed only once. The file must then be valid again.
        assert len(calls) == 1
        assert path.read_bytes() == whole


@pytest.mark.permanent(ROW)
def test_a_folder_instead_of_a_cache_file_is_ignored(folder):
    disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])
    path = next(folder.iterdir())
    path.unlink()
    path.mkdir()
    assert disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])["step"] == 0.25


@pytest.mark.permanent(ROW)
def test_old_temporary_files_of_killed_processes_are_removed(folder, tries):
    disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])
    kill = "import os, signal; from pathlib import Path; from warpdiff.core.files import atomic_write\n"
    kill += f"with atomic_write(Path({str(folder)!r}, 'a'), suffix='.part'): os.kill(os.getpid(), signal.SIGKILL)"
    for _ in tries.of(range(count(1, 5))):
        for _one_old_and_one_young in range(2):
            subprocess.run([sys.executable, "-c", kill], check=False)
    (folder / "mine.part").touch()
    old, young, *_ = (file for file in folder.iterdir() if file.name.startswith(".warpdiff"))
    for file in (old, folder / "mine.part"):
        os.utime(file, (1e9, 1e9))
    disk_cache.cached_on_disk("other", HEIGHTS, counted(1.0)[1])
    assert not old.exists()
    # The cache must not delete recent temporary files, because another process may still be writing them. It must not
    # delete files of other programs either.
    assert young.exists()
    assert (folder / "mine.part").exists()


@pytest.mark.usefixtures("folder")
def test_a_read_only_cache_folder_is_used(monkeypatch):
    disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])

    def denied(*_args):
        raise PermissionError

    monkeypatch.setattr(os, "utime", denied)
    calls, make = counted(1.0)
    disk_cache.cached_on_disk("key", HEIGHTS, make)
    assert not calls


def test_without_a_home_folder_nothing_is_cached(monkeypatch):
    def none():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("WARPDIFF_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(disk_cache.Path, "home", none)
    monkeypatch.setattr(disk_cache, "_LEAST_SECONDS", 0.0)
    assert disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])["step"] == 0.25


def test_the_oldest_files_are_removed_from_a_full_cache(folder, monkeypatch):
    monkeypatch.setattr(disk_cache, "MOST_BYTES", 1600)
    for index in range(5):
        disk_cache.cached_on_disk(index, HEIGHTS, counted(float(index))[1])
        for age, path in enumerate(sorted(folder.iterdir(), key=lambda file: file.stat().st_mtime, reverse=True)):
            os.utime(path, (1e9 - age, 1e9 - age))
    assert 1 <= len(list(folder.iterdir())) <= 3
    calls, make = counted(9.0)
    disk_cache.cached_on_disk(4, HEIGHTS, make)
    disk_cache.cached_on_disk(0, HEIGHTS, make)
    assert len(calls) == 1


def test_the_cache_can_be_disabled_and_its_errors_are_ignored(tmp_path, monkeypatch):
    monkeypatch.setattr(disk_cache, "_LEAST_SECONDS", 0.0)
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", "")
    monkeypatch.chdir(tmp_path)
    assert disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])["step"] == 0.25
    assert not list(tmp_path.iterdir())
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(blocked))
    assert disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])["step"] == 0.25
    assert blocked.read_text() == "not a folder"


def test_results_that_are_computed_quickly_are_not_cached(tmp_path, monkeypatch):
    monkeypatch.setenv("WARPDIFF_CACHE_DIR", str(tmp_path / "cache"))
    disk_cache.cached_on_disk("key", HEIGHTS, counted(1.0)[1])
    assert not (tmp_path / "cache").exists()


@pytest.mark.permanent(ROW)
def test_pictures_do_not_depend_on_the_cache(folder):
    lights = np.array([[0.1, 0.2, 0.97]])
    views = np.array([[-0.3, 0.1, 0.95]])
    grating = wd.gratings.fingers(size_um=6.4, seed=3)
    first = wd.reflectance(grating, lights, views)
    assert list(folder.iterdir())
    for content in (None, archive(rows=np.ones(3)), b""):
        for path in folder.iterdir():
            path.write_bytes(path.read_bytes() if content is None else content)
        again = wd.HeightField(grating.heights_um, grating.pitch_um)
        np.testing.assert_array_equal(first, wd.reflectance(again, lights, views))
