"""Damaged files are read, or refused with their name; no other files are opened. Each reader has valid files to damage.

The files are damaged by the mutations of ``bench/dev/fuzz.py``: few in the default tests, and many in a soak test (a
long run of the tests with random inputs).
"""

import contextlib
import gzip
import inspect
import io
import json
import os
import random
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from endurance import SEED, count, seconds_left
from PIL import Image

if os.name != "posix":
    pytest.skip("memory limits require POSIX", allow_module_level=True)
import warpdiff as wd
from bench.dev import fuzz, fuzz_mutations, fuzz_targets
from warpdiff.heightfield.readers import reader_registry
from warpdiff.scene import mesh_files

GROUPS = {
    "damaged scans": ("text", "x3p", "npy", "npz", "image"), "damaged meshes, under 4 GB": ("mesh",),
    "damaged glTF, under 4 GB": ("gltf",),
    "damaged layouts, under 4 GB": ("gds",),
    "damaged tables, pictures and messages": (
        "index", "spectrum", "measured", "dots", "curve", "camera", "plan", "lobes", "spectra", "picture",
        "environment", "message",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    "group",
    [pytest.param(name, marks=pytest.mark.permanent(name, shares=20), id=name.split(",")[0]) for name in GROUPS],
)
def test_damaged_files_are_read_or_refused_by_their_name(group, tries):
    names, limit = list(GROUPS[group]), seconds_left()
    results = fuzz.run(
        names, executions=count(120 // len(names) + 10, 10**9), seconds=min(limit / len(names), 1e6), seed=SEED or 24
    )
    tries.number = sum(result["executions"] for result in results)
    reasons = [(result["target"], failure["reason"]) for result in results for failure in result["failures"]]
    assert not reasons, "run python -m bench.dev.fuzz, which stores the files"
    assert tries.number >= len(names)


def test_every_reader_has_a_group():
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(fuzz_targets.BY_NAME)


@pytest.mark.parametrize("target", fuzz_targets.TARGETS, ids=lambda target: target.name)
def test_the_valid_files_of_each_reader_are_small_and_are_read(target, recwarn):
    files = sorted(target.folder.iterdir())
    assert files
    for path in files:
        assert path.stat().st_size <= 50_000
        target.read(path)
    recwarn.clear()


def test_every_registered_and_public_reader_has_a_corpus():
    tested = {title for target in fuzz_targets.TARGETS for title in target.reads}
    # Formats that the optional package SurfaceTopography reads are excluded, because the tests cannot write such files.
    formats = {entry.title for entry in reader_registry.registered() if not entry.extra}
    assert len(formats) >= 5
    assert not formats - tested
    methods = {
        f"{name}.{method}" for name in wd.__all__ if inspect.isclass(kind := getattr(wd, name))
        for method in ("load", "from_file", "from_csv") if hasattr(kind, method)
    }  # fmt: skip
    assert len(methods) >= 9
    assert not methods - tested
    takes_path = {
        name for name in wd.__all__ if inspect.isfunction(function := getattr(wd, name))
        and {"path", "compare"} & set(inspect.signature(function).parameters)
    }  # fmt: skip
    # ``export_html`` has a path, but writes a web page instead of reading a file.
    assert not takes_path - tested - {"export_html"}
    suffixes = {path.suffix for name in ("mesh", "gltf") for path in fuzz_targets.BY_NAME[name].folder.iterdir()}
    # Reading 3MF and COLLADA needs additional packages, so that these formats have no test files.
    assert {".gltf", ".glb", *mesh_files._BY_TRIMESH} - suffixes == {".3mf", ".dae"}


def _with_member(data, name, old, new):
    """Return an archive with a replacement of bytes in one of its files, and with correct checksums."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(stream, "w") as target:
        for member in source.namelist():
            content = source.read(member)
            target.writestr(member, content.replace(old, new) if member == name else content)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("target", "name", "damage"),
    [("measured", "orders.csv", lambda data: data.replace(b"500", b"nan")),
     ("camera", "path.csv", lambda data: data.replace(b"1,0,3", b"1e308,0,3").replace(b"0,0,3", b"-1e308,0,3")),
     ("plan", "plan.json", lambda data: data.replace(b'"kind": "averaged"', b'"kind": "x"')),
     ("lobes", "lobes.npz", lambda data: data[:-14] + bytes(6 * [255]) + data[-8:]),
     ("npz", "filled.npz", lambda data: _with_member(data, "history.npy", b"<U57", b"<U  ")),
     ("spectra", "spectrum.npz",
      lambda data: _with_member(data, "powers.npy", b"(16, 16, 8), }         ", b"(16, 16, 2147483648), }")),
     ("environment", "sky.exr", lambda data: data.replace(b"chlist", b"\x83L\x9fist"))],
)  # fmt: skip
def test_errors_that_fuzzing_once_found_without_a_name_have_it(target, name, damage, tmp_path):
    reader = fuzz_targets.BY_NAME[target]
    content = (reader.folder / name).read_bytes()
    assert damage(content) != content
    (tmp_path / name).write_bytes(damage(content))
    with pytest.raises(ValueError, match=name.replace(".", r"\.")):
        reader.read(tmp_path / name)


def test_a_formula_of_a_constant_has_an_index_at_all_wavelengths(tmp_path):
    text = "DATA:\n  - type: formula 1\n    wavelength_range: 0.3 2.5\n    coefficients: 3\n"
    (tmp_path / "constant.yml").write_text(text, encoding="utf-8")
    assert set(wd.Material.from_file(tmp_path / "constant.yml").n) == {2.0}


def _faulty(fault):
    """Return a reader that refuses all files, after a call of ``fault`` if a file has no word "Wavelength"."""

    def read(path):
        text = path.read_bytes()
        if b"Wavelength" not in text:
            fault()
        raise ValueError(f"{path.name} is refused")

    return read


@pytest.mark.parametrize(
    ("fault", "reason"),
    [(lambda: {}["x"], "KeyError"), (lambda: bytearray(8 << 40), "memory beyond the limit"),
     (lambda: (_ for _ in ()).throw(ValueError("no")), "does not name the file")],
    ids=["exception", "memory", "unnamed"],
)  # fmt: skip
def test_the_fuzzer_detects_faults(fault, reason, tmp_path):
    target = fuzz_targets.Target("curve", _faulty(fault), ())
    result = fuzz.fuzz(target, tmp_path, executions=500, seconds=20.0, seed=1, outside=[])
    assert len(result["failures"]) == fuzz._MOST_FAILURES
    assert all(reason in failure["reason"] for failure in result["failures"])
    assert list(tmp_path.iterdir()) == []


def test_crashes_and_hangs_end_a_reader_and_keep_its_file(monkeypatch, tmp_path):
    script = tmp_path / "crash.py"
    script.write_text("import pathlib, os; pathlib.Path('a.txt').write_text('x'); os.abort()", encoding="utf-8")
    monkeypatch.setattr(fuzz, "FAILURES", tmp_path / "failures")
    monkeypatch.setattr(fuzz, "WORKER", (str(script),))
    (result,) = fuzz.run(["text"], executions=1, seconds=1.0, seed=1)
    assert "exit code -6" in result["failures"][0]["reason"]
    assert (Path(result["failures"][0]["file"]) / "a.txt").read_text(encoding="utf-8") == "x"


def test_inputs_with_new_coverage_are_mutated_again():
    (result,) = fuzz.run(["index"], executions=400, seconds=60.0, seed=3)
    assert result["inputs"] > len(list(fuzz_targets.BY_NAME["index"].folder.iterdir()))
    assert result["blocks"] > 80


_INSTRUMENTED = """
from bench.dev import fuzz_coverage
fuzz_coverage.install()
from warpdiff.core import wording
coverage = fuzz_coverage.Coverage()
for count, is_new in ((1, True), (1, False), (5, True), (6, False)):
    coverage.reset()
    for _ in range(count):
        wording.ref("path")
    assert coverage.adds() == is_new, count
assert len(coverage) == 1
assert wording.ref.__doc__.startswith("Mark the name")
"""


def test_coverage_counts_blocks_by_their_order_of_magnitude():
    environment = os.environ | {"PYTHONPATH": str(fuzz.ROOT)}
    subprocess.run([sys.executable, "-c", _INSTRUMENTED], env=environment, check=True)


def _is_png(data):
    with Image.open(io.BytesIO(data)) as picture:
        picture.load()
    return True


@pytest.mark.parametrize(
    ("file", "least", "is_valid"),
    [("x3p/export-binary.x3p", 40, lambda data: zipfile.ZipFile(io.BytesIO(data)).testzip() is None),
     ("message/draw.json", 40, lambda data: isinstance(json.loads(data), dict)),
     ("text/export-small.txt.gz", 40, lambda data: bool(gzip.decompress(data))),
     ("npy/scan-uint8.npy", 5, lambda data: np.load(io.BytesIO(data)) is not None),
     ("image/scan-uint8.png", 15, _is_png),
     ("gds/foil.gds", 40, lambda data: fuzz_mutations.gds_content(fuzz_mutations.gds_records(data)) == data)],
    ids=["zip", "JSON", "gzip", "NumPy", "PNG", "GDS"],
)  # fmt: skip
def test_structured_mutations_keep_sizes_and_checksums(file, least, is_valid):
    rng = random.Random(1)  # noqa: S311 (not for secrets)
    content = (fuzz_targets.CORPUS / file).read_bytes()
    data = [fuzz_mutations.mutated(content, [], rng) for _ in range(100)]
    assert len(set(data)) > 80
    valid = 0
    for damaged in data:
        with contextlib.suppress(Exception):
            valid += is_valid(damaged)
    # Most damaged files must still have valid sizes and checksums. The others are those of which single bytes were
    # damaged, about a third.
    assert valid > least
