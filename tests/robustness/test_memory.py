"""Calls that require more than the free memory are refused before work begins. Smaller calls are not refused."""

import dataclasses
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp

import warpdiff as wd
from warpdiff.core import memory

SETTING = """
import resource, time
import numpy as np
import warpdiff as wd

heightfield = wd.gratings.fingers(size_um=6.4, seed=1)
short = wd.Coherence(sigma_um=3.25)
mesh = wd.meshes.tube(segments_along=24, segments_around=16)
light = wd.DirectionalLight((0.1, 0.9, 1.2))

def view(size):
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), width=size, height=size)

def shade(size):
    return wd.shade(mesh, heightfield, light, view(size), coherence=short, tolerance=0.2, threads=1)

def limit(size):
    resource.setrlimit(resource.RLIMIT_AS, (int(size), -1))
"""
LARGE = """
# The file is sparse: its zeros need no disk space.
np.lib.format.open_memmap("scan.npy", mode="w+", dtype=np.float32, shape=(20000, 20000))
limit(4 << 30)
rough = wd.HeightField(np.resize(np.random.default_rng(0).normal(size=(7, 6000)) * 0.05, (6000, 6000)), 0.05)
calls = {
    "picture of 16384 × 16384 pixels": lambda: shade(16384),
    "picture of 16000 × 16000 pixels": lambda: wd.Renderer(mesh, heightfield, light, view(16000), coherence=short),
    "map of 16384 × 16384 pixels": lambda: wd.reflectance_map(heightfield, (0, 0, 1), size=16384),
    "samples_per_pixel=256": lambda: wd.reflectance_map(heightfield, (0, 0, 1), size=1024, samples_per_pixel=256),
    "cell of 6000 × 6000 samples": lambda: wd.order_efficiencies(rough, (0, 0, 1), [500.0]),
    "heightfield of 6000 × 6000 samples": lambda: wd.plan(rough),
    "periods() of a field of 6000 × 6000 samples": rough.periods,
    "heights_um of 20000 × 20000 samples": lambda: wd.HeightField(np.broadcast_to(0.0, (20000, 20000)), 0.05),
    "'scan.npy' of 20000 × 20000 samples": lambda: wd.HeightField.load("scan.npy", pitch_um=0.05),
    "cell of 500 × 500 samples with 576048001 orders": lambda: wd.order_efficiencies(
        wd.HeightField(np.zeros((500, 500)), 12.0), (0, 0, 1), [500.0]
    ),
    "direct sum of 1 × 1.8e+15 coefficients": lambda: wd.spectral_reflectance(
        wd.gratings.sinusoidal(1.0, 0.1), (0, 0, 1), (0, 0, 1), [500.0], method="direct",
        coherence=wd.Coherence(sigma_um=1e-15),
    ),
    "call of 50000 directions at 10000 wavelengths": lambda: wd.brdf(
        heightfield, (0, 0, 1), np.ones((50000, 3)), np.linspace(400.0, 700.0, 10000)
    ),
}
for message, call in calls.items():
    began = time.process_time()
    try:
        call()
    except MemoryError as error:
        assert message in str(error) and "GB are free: take" in str(error), error
    else:
        raise AssertionError(message)
    assert time.process_time() - began < 2.0, message
shade(40)
"""
JUST = """
from warpdiff.render import picture_inputs as render

shade(64)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
needed = render._BYTES_PER_PIXEL * 600**2
limit(used + 0.95 * needed)
try:
    shade(600)
except MemoryError as error:
    assert "picture of 600 × 600 pixels" in str(error), error
else:
    raise AssertionError
limit(used + 1.15 * needed)
shade(600)
"""

UNFORESEEN = """
import dataclasses
from warpdiff.core import memory

plan = wd.plan(heightfield, coherence=short, method="low-rank", integration="table", tolerance=0.2)
wd.reflectance(heightfield, (0, 0, 1), (0.1, 0.2, 1.0), plan=plan)
memory.require_memory = lambda *_: None
fine = dataclasses.replace(plan, azimuths_per_width=300.0)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
limit(used + (1 << 28))
try:
    wd.reflectance(heightfield, (0, 0, 1), (0.1, 0.2, 1.0), plan=fine)
except MemoryError as error:
    message = str(error)
    assert message.startswith("reflectance() requires another ") and "GB are free: take a larger" in message, error
else:
    raise AssertionError
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="this system does not report free memory")
@pytest.mark.parametrize(
    "code",
    [pytest.param(LARGE, marks=pytest.mark.slow), JUST, UNFORESEEN],
    ids=["large", "just too large, and just not", "not foreseen"],
)
def test_requests_larger_than_memory_are_refused_at_once(code, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SETTING + code], cwd=tmp_path,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_failed_allocations_raise_the_messages_of_the_library():
    message = r"it requires another \S+ GB at once, and \S+ GB are free: take less"
    with pytest.raises(MemoryError, match=message), memory.as_memory_error("it", "take less"):
        np.empty(10**15)
    with pytest.raises(MemoryError, match=message), memory.as_memory_error("it", "take less"):
        wp.empty((2**30, 2**20), dtype=wp.float32, device="cpu")
    with (
        pytest.raises(MemoryError, match="it requires more memory than is free"),
        memory.as_memory_error("it", "take less"),
    ):
        raise MemoryError
    for error in (MemoryError("a picture requires about 9 GB, and 1 GB are free"), RuntimeError("failed")):
        with pytest.raises(type(error)) as raised, memory.as_memory_error("it", "take less"):
            raise error
        assert raised.value is error


def test_sample_meshes_that_exceed_the_memory_raise_a_clear_error(monkeypatch):
    """A failed allocation must raise the same error as an estimate of the memory that exceeds the free memory.

    An allocation fails if the estimate was too small.
    """
    monkeypatch.setattr(memory, "require_faces", lambda *_: None)
    for call in (lambda: wd.meshes.tube(segments_along=1 << 45), lambda: wd.meshes.disc(segments=1 << 45)):
        with pytest.raises(MemoryError, match=r"a body of this many faces requires another .* GB are free: take fewer"):
            call()


def test_tables_of_plans_that_are_too_fine_are_refused(monkeypatch):
    heightfield = wd.gratings.fingers(size_um=6.4, seed=3)
    plan = wd.plan(heightfield, coherence=wd.Coherence(sigma_um=3.25), integration="table", tolerance=0.2)
    fine = dataclasses.replace(plan, rings_per_octave=2 * plan.rings_per_octave)
    monkeypatch.setattr(memory, "available", lambda: 1e5)
    with pytest.raises(MemoryError, match=f"table of rings_per_octave={fine.rings_per_octave}"):
        wd.reflectance(heightfield, (0, 0, 1), (0.1, 0.2, 1.0), plan=fine)


def test_tables_of_very_small_sources_are_refused():
    heightfield = wd.gratings.fingers(size_um=6.4, seed=3)
    source = wd.Coherence("source", angular_diameter_deg=5.0)
    plan = wd.plan(heightfield, coherence=source, integration="table", tolerance=0.2)
    for changes in ({}, {"azimuths_per_width": 1e9}, {"rings_per_octave": 28}):
        small = wd.Coherence("source", angular_diameter_deg=1e-15)
        with pytest.raises(
            MemoryError, match=r"table of rings_per_octave=\d+ and azimuths_per_width=.* GB are free: take"
        ):
            wd.reflectance(
                heightfield, (0, 0, 1), (0.1, 0.2, 1.0), plan=dataclasses.replace(plan, coherence=small, **changes)
            )


def test_wavelengths_of_very_many_periods_are_refused(monkeypatch):
    heightfield = wd.gratings.sinusoidal(1.0, 0.1)
    plan = wd.plan(
        heightfield, (0, 0, 1), (0.3, 0, 1), coherence=wd.Coherence("replicas", periods=(1, 100)), tolerance=0.2
    )
    monkeypatch.setattr(memory, "available", lambda: 1e9)
    many = dataclasses.replace(plan, wavelengths=10**8)
    with pytest.raises(MemoryError, match=r"a quadrature of \d+ wavelengths requires .* periods"):
        wd.reflectance(heightfield, (0, 0, 1), (0.3, 0, 1), plan=many)


@pytest.mark.parametrize(
    ("own", "folder", "files"),
    [("0::/job/step\n", "job", {"max": 3000, "current": 2500, "stat": "anon 2000\ninactive_file 400\n"}),
     ("9:cpu:/job\n8:memory:/elsewhere\n0::/\n", "memory",
      {"limit_in_bytes": 3000, "usage_in_bytes": 2500, "stat": "inactive_file 1\ntotal_inactive_file 400\n"})],
    ids=["version 2, of a group above", "version 1, in a container"],
)  # fmt: skip
def test_the_memory_limit_of_a_container_is_the_free_memory(own, folder, files, tmp_path, monkeypatch):
    (tmp_path / "own").write_text(own)
    (tmp_path / "job" / "step").mkdir(parents=True)
    (tmp_path / "job" / "step" / "memory.max").write_text("max\n")
    (tmp_path / folder).mkdir(exist_ok=True)
    for name, content in files.items():
        (tmp_path / folder / f"memory.{name}").write_text(str(content))
    monkeypatch.setattr(memory, "_OWN_GROUPS", tmp_path / "own")
    monkeypatch.setattr(memory, "_GROUPS", tmp_path)
    memory._limits_of_groups.cache_clear()
    try:
        assert memory.available() == 900.0
        with pytest.raises(MemoryError, match=r"heights_um of 20 × 20 .* are free: take 0\.16 of the area"):
            wd.HeightField(np.zeros((20, 20)), 0.05)
    finally:
        memory._limits_of_groups.cache_clear()


def test_systems_that_do_not_report_memory_refuse_no_request(monkeypatch):
    monkeypatch.setattr(Path, "read_text", lambda _: "")
    assert memory.available() == math.inf
