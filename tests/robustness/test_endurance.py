"""Tests that run only in a soak test (a long run): memory over thousands of calls, concurrent compilations."""

import hashlib
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from endurance import IS_SOAK

import warpdiff as wd

if not IS_SOAK:
    pytest.skip("make soak runs these tests", allow_module_level=True)
FOLDER = Path(__file__).parent
MOST_GROWTH = 100 << 20


def varied(rng):
    """Call a randomly chosen public function with small random arguments."""
    heightfield = wd.gratings.fingers(size_um=6.4, seed=int(rng.integers(2**31)))
    coherence = wd.Coherence(sigma_um=rng.uniform(2.0, 4.0))
    options = {"coherence": coherence, "tolerance": 0.2, "threads": int(rng.integers(1, 5)), "strict": False}
    directions = rng.normal((0.0, 0.0, 2.0), size=(2, 40, 3))
    match rng.integers(5):
        case 0:
            return wd.reflectance(heightfield, directions[0], directions[1], **options)
        case 1:
            return wd.spectral_reflectance(
                heightfield, directions[0], directions[1], rng.uniform(400.0, 700.0, 3), **options
            )
        case 2:
            return wd.reflectance_map(
                heightfield, directions[0, 0] * [1, 1, 0] + [0, 0, 9.0], size=int(rng.integers(4, 40)), **options
            )
        case 3:
            return wd.order_efficiencies(wd.gratings.sinusoidal(rng.uniform(1.0, 9.0), 0.1), (0.0, 0.0, 1.0), [500.0])
    mesh = wd.meshes.tube(segments_along=int(rng.integers(12, 40)), segments_around=int(rng.integers(4, 40)))
    view = wd.View(tuple(rng.normal((0.0, 0.0, 3.0))), (0, 0, 0), width=int(rng.integers(4, 60)), height=30)
    return wd.shade(mesh, heightfield, wd.DirectionalLight((0.1, 0.9, 1.2)), view, **options)


@pytest.mark.permanent("varied calls and thread counts: memory and threads remain constant", shares=20)
@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
def test_memory_does_not_grow(rng, tries):
    def resident_bytes():
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    for _ in range(200):
        varied(rng)
    before = resident_bytes()
    for _ in tries.of(range(2000)):
        varied(rng)
    assert resident_bytes() - before < MOST_GROWTH


PICTURE = "import hashlib, test_forks as t; print(hashlib.sha256(t.picture().tobytes()).hexdigest())"


@pytest.mark.permanent("concurrent processes that start with empty caches")
def test_processes_that_start_simultaneously_render_the_same_picture(tries, tmp_path):
    from robustness import test_forks

    folders = {"WARP_CACHE_PATH": str(tmp_path / "kernels"), "WARPDIFF_CACHE_DIR": str(tmp_path / "cache")}
    tries.number = 8
    running = [
        subprocess.Popen([sys.executable, "-c", PICTURE], cwd=FOLDER, env=os.environ | folders, stdout=subprocess.PIPE)
        for _ in range(8)
    ]
    pictures = {process.communicate(timeout=300)[0].decode().splitlines()[-1] for process in running}
    assert pictures == {hashlib.sha256(test_forks.picture().tobytes()).hexdigest()}
